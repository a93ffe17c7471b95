//! The catalogue as a whole: ids, declarations, reading.

use super::*;
use photocurrent_core::sensor::EFFECT_IDS;
use serde_json::json;

fn described(text: Value) -> BTreeMap<String, Map<String, Value>> {
    serde_json::from_value(text).unwrap()
}

#[test]
fn every_id_is_known_to_the_sensor_description_and_stands_once_in_order_of_the_chain() {
    let ids: Vec<&str> = catalogue().iter().map(|kind| kind.decl.id).collect();
    for (k, id) in ids.iter().enumerate() {
        assert!(EFFECT_IDS.contains(id), "{id}");
        assert!(!ids[..k].contains(id), "{id} twice");
    }
}

#[test]
fn every_declaration_is_complete_and_its_plausible_values_are_allowed() {
    for EffectKind { decl, .. } in catalogue() {
        for text in [decl.about, decl.equation, decl.covariate, decl.signature, decl.source] {
            assert!(!text.is_empty(), "{}", decl.id);
        }
        for parameter in decl.parameters {
            let (least, most) = parameter.plausible;
            assert!(parameter.allowed.0 <= least && least < most && most <= parameter.allowed.1, "{}.{}", decl.id, parameter.name);
            assert!(parameter.null.is_none_or(|null| null >= parameter.allowed.0 && null <= parameter.allowed.1), "{}.{}", decl.id, parameter.name);
        }
    }
}

#[test]
fn effects_come_in_the_order_of_the_catalogue() {
    let effects = from_description(&described(json!({ "clock_offset": { "offset": "-6 ms" }, "leak_events": { "rate": "0.1 Hz" } }))).unwrap();
    assert_eq!(effects.iter().map(|effect| effect.id()).collect::<Vec<_>>(), ["leak_events", "clock_offset"]);
}

#[test]
fn mistakes_name_effect_key_found_and_expected() {
    let refused = |text| from_description(&described(text)).err().expect("refused");
    assert_eq!(
        refused(json!({ "leek_events": { "rate": "0.1 Hz" }, "clock_offset": { "ofset": "6 ms" } })),
        "`effects.leek_events`: the simulator knows no such effect; did you mean `leak_events`?\n\
         `ofset` is not a parameter of `effects.clock_offset`; did you mean `offset`?"
    );
    assert_eq!(refused(json!({ "leak_events": { "rate": 0.1 } })), "`effects.leak_events.rate`: expected a rate such as \"10 kHz\", found 0.1");
    assert_eq!(refused(json!({ "leak_events": { "rate": "-1 Hz" } })), "`effects.leak_events.rate`: expected 0 to 10000 Hz, found \"-1 Hz\"");
    assert_eq!(refused(json!({ "leak_events": {} })), "`effects.leak_events` needs `rate`");
}
