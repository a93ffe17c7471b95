//! The catalogue as a whole: ids, declarations, reading.

use super::sought::{DELAY, Field, Measure, SHARE, Search, Signs, Size};
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
            assert!(
                !parameter.unit.is_number()
                    || parameter.allowed.0 <= least && least < most && most <= parameter.allowed.1,
                "{}.{}",
                decl.id,
                parameter.name
            );
            assert!(
                parameter.null.is_none_or(|null| null >= parameter.allowed.0 && null <= parameter.allowed.1),
                "{}.{}",
                decl.id,
                parameter.name
            );
        }
    }
}

#[test]
fn every_effect_is_sought_by_numbers_of_its_own_or_says_why_it_is_not() {
    for EffectKind { decl, .. } in catalogue() {
        match decl.search {
            Search::Not(why) => assert!(!why.is_empty(), "{}", decl.id),
            Search::For(numbers) => assert!(!numbers.is_empty(), "{}", decl.id),
        }
        for sought in decl.search.numbers() {
            let is_number =
                decl.parameter(sought.parameter).is_some_and(|parameter| parameter.unit.is_number());
            assert_eq!(is_number, sought.signs != Signs::Switch, "{}.{}", decl.id, sought.parameter);
            // A description's own value means nothing where a number has no null.
            let has_field = sought.field.is_some_and(|field| field != Field::Reset);
            let null = decl.parameter(sought.parameter).map_or(Some(0.0), |parameter| parameter.null);
            assert!(null.is_some() || has_field, "{}.{}", decl.id, sought.parameter);
            for (name, _) in sought.others {
                assert!(
                    decl.parameter(name).is_some()
                        && decl.search.numbers().iter().all(|other| other.parameter != *name),
                    "{}.{name}",
                    decl.id
                );
            }
            let others = sought
                .companion
                .map(|companion| (companion.id, companion.parameter))
                .into_iter()
                .chain(sought.spread_of);
            for (id, parameter) in others {
                let other =
                    catalogue().into_iter().find(|kind| kind.decl.id == id).expect("in the catalogue").decl;
                assert!(
                    id != decl.id && other.parameter(parameter).is_some(),
                    "{}: {id}.{parameter}",
                    decl.id
                );
            }
        }
    }
}

#[test]
fn pairs_that_a_further_recording_separates_are_of_the_catalogue_and_stand_once() {
    let mut pairs: Vec<[&str; 2]> = Vec::new();
    for EffectKind { decl, .. } in catalogue() {
        for (other, what) in decl.apart {
            assert!(
                EFFECT_IDS.contains(other) && *other != decl.id && !what.is_empty(),
                "{} {other}",
                decl.id
            );
            let mut pair = [decl.id, *other];
            pair.sort_unstable();
            assert!(!pairs.contains(&pair), "{pair:?} twice");
            pairs.push(pair);
        }
    }
}

#[test]
fn sizes_follow_their_measures_and_say_how() {
    let measure = |of: Measure| match of {
        Measure::Light => 50.0,
        Measure::StampWidth => 20e-6,
        _ => 4.0,
    };
    let size = Size::Over(&Size::Of(12.0, Measure::Threshold), Measure::Light);
    assert_eq!(
        (size.at(&measure), size.to_string().as_str()),
        (0.96, "12 x threshold / median photocurrent")
    );
    assert_eq!(
        (DELAY.at(&measure), DELAY.to_string().as_str()),
        (0.55 * 20e-6, "the larger of 0.000002 and 0.55 x width of a stamp")
    );
    assert_eq!(Size::Times(&SHARE, Measure::Rows).at(&measure), 0.004);
}

#[test]
fn effects_come_in_the_order_of_the_catalogue() {
    let effects = from_description(&described(
        json!({ "clock_offset": { "offset": "-6 ms" }, "leak_events": { "rate": "0.1 Hz" } }),
    ))
    .unwrap();
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
    assert_eq!(
        refused(json!({ "leak_events": { "rate": 0.1 } })),
        "`effects.leak_events.rate`: expected a rate such as \"10 kHz\", found 0.1"
    );
    assert_eq!(
        refused(json!({ "leak_events": { "rate": "-1 Hz" } })),
        "`effects.leak_events.rate`: expected 0 to 10000 Hz, found \"-1 Hz\""
    );
    assert_eq!(refused(json!({ "leak_events": {} })), "`effects.leak_events` needs `rate`");
}
