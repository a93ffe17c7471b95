//! Quantities that a description lacks, the tests that need them, and how a user gets them.
//!
//! Every test needs thresholds and the frames' gain alone ([`photocurrent_scene::nominal`]). An absent
//! refractory period or latency counts as 0. Without the front end ([`front_end`]) direct tests assume the
//! ideal one, and no scene is compared. The residual of an event is the front end's voltage less reference
//! and threshold, so a lag, a bandwidth or its dependence on light would be attributed to another effect. The
//! report lists the omitted tests with the reason.

use crate::integrity::Departure;
use crate::report::NotTestable;
use crate::units::readable;
use photocurrent_core::Sensor;
use photocurrent_core::quantity::Duration;
use photocurrent_sensor::effects::{Stage, catalogue};

/// Fields of the front end that a description does not state, by their TOML paths; empty where both are
/// there.
pub fn front_end(sensor: &Sensor) -> Vec<&'static str> {
    let fields = [
        ("front_end.tau_0", sensor.front_end.tau_0.is_some()),
        ("front_end.alpha", sensor.front_end.alpha.is_some()),
    ];
    fields.into_iter().filter(|(_, is_stated)| !is_stated).map(|(path, _)| path).collect()
}

/// Why events are not compared with a scene; none where the front end is stated.
pub fn without_scene(sensor: &Sensor) -> Option<String> {
    let fields = front_end(sensor);
    (!fields.is_empty()).then(|| {
        format!(
            "{}: events are not compared with a scene, which needs the front end's answer to the light",
            not_stated(&fields)
        )
    })
}

/// Advice on missing quantities: what to state, the tests that it adds, and sources of the values. Sentences.
pub fn advice(sensor: &Sensor) -> Vec<String> {
    let fields = front_end(sensor);
    if fields.is_empty() {
        return Vec::new();
    }
    vec![format!(
        "state {} in the sensor description: adds the tests on a scene and their detection limits, and \
         separates a clock offset from a slow front end; {HOW}",
        fields.join(" and ")
    )]
}

/// Where the front end's numbers are from.
const HOW: &str = "values are in the maker's sheet (tau = 1 / (2 pi f) of a -3 dB bandwidth f: tau_0 in \
                   bright light, alpha = (tau - tau_0) x photocurrent in dim light) or come from a \
                   recording of a known target (docs/calibrate-sensor.md)";

/// Note on a constant delay of events.
pub const LATENESS: &str = "events that are late by one time have a clock that is off, or a front end and a \
                            readout that are slow; this recording does not separate the two";

fn not_stated(fields: &[&str]) -> String {
    format!("{} {} not stated", fields.join(" and "), if fields.len() == 1 { "is" } else { "are" })
}

/// Effects that are not tested because the description lacks a quantity: reason, gained test and source of
/// the value. `is_tested`: effects tested all the same. Empty for a complete description.
pub fn not_testable(sensor: &Sensor, is_tested: impl Fn(&str) -> bool) -> Vec<NotTestable> {
    let fields = front_end(sensor);
    if fields.is_empty() {
        return Vec::new();
    }
    let lacking = not_stated(&fields);
    let of_front_end = format!(
        "{lacking}: there is no lag or bandwidth to compare with, and the ideal front end was taken; stated \
         values would add this test, on a scene; {HOW}"
    );
    let on_a_scene = format!(
        "{lacking}: by how much an event misses its threshold on a scene follows from the front end's \
         voltage; stated values would add this test; {HOW}"
    );
    let mut all = offset(sensor, &lacking);
    let decls = catalogue().into_iter().map(|kind| kind.decl).filter(|decl| !is_tested(decl.id));
    all.extend(decls.map(|decl| NotTestable {
        id: decl.id.to_owned(),
        why: if decl.stage == Stage::FrontEnd { of_front_end.clone() } else { on_a_scene.clone() },
    }));
    all
}

/// A reason of [`not_testable`] without the sources of values, which [`advice`] lists once; `None` for
/// another reason.
pub fn reason_without_source(why: &str) -> Option<&str> {
    why.contains(" not stated: ").then(|| why.strip_suffix(HOW).map_or(why, |why| why.trim_end_matches("; ")))
}

/// A clock offset that the description states may be the lag of the front end that it does not state.
fn offset(sensor: &Sensor, lacking: &str) -> Vec<NotTestable> {
    let stated = sensor
        .effects
        .get("clock_offset")
        .and_then(|of| of.get("offset")?.as_str()?.parse::<Duration>().ok());
    let late = stated.filter(|offset| offset.ns() > 0).map(|offset| {
        let offset = readable(offset.seconds(), "s");
        let why = format!("the description states an offset of {offset}, and {lacking}: {LATENESS}; {HOW}");
        NotTestable { id: "clock_offset".into(), why }
    });
    late.into_iter().collect()
}

/// Another effect with the same evidence as a finding, not excluded by the description: its id, and the
/// reason as the end of a sentence.
///
/// A low-pass of unknown bandwidth delays events and weakens fast or dark changes. Thresholds look larger,
/// those of OFF events more; dark places have fewer events, and fast ones lose light. It makes no event early
/// and no threshold smaller.
pub fn alternative_explanation(sensor: &Sensor, finding: &Departure) -> Option<(&'static str, &'static str)> {
    if front_end(sensor).is_empty() {
        return None;
    }
    let value = |parameter: &str| finding.value(parameter).unwrap_or(0.0);
    let because = match finding.id {
        "clock_offset" if value("offset") > 0.0 => LATENESS,
        "dark_current" => "a front end that is slow in dim light weakens changes there, which looks alike",
        "threshold_scale" if value("fraction") > 0.0 => {
            "a front end that is slow weakens fast changes, which looks alike"
        }
        "threshold_asymmetry" if value("fraction") < 0.0 => {
            "a front end is slower in the dark, where OFF changes end, which looks alike"
        }
        // Lost light, not the shortest intervals.
        "refractory" if finding.heldout.is_some() => {
            "a front end that is slow weakens fast changes, which looks alike"
        }
        _ => return None,
    };
    Some(("time_constant", because))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidates::{CANDIDATES, Candidate};
    use crate::testing;
    use serde_json::json;

    /// As `photocurrent init` writes it: thresholds, refractory period, gain and row time.
    fn proposed() -> Sensor {
        let mut sensor = testing::sensor();
        (sensor.front_end.tau_0, sensor.front_end.alpha, sensor.readout.latency_min) = (None, None, None);
        sensor
    }

    fn late(seconds: f64) -> Departure {
        Departure::from_halves("clock_offset", ("offset", seconds), 100.0, 1000, String::new())
    }

    #[test]
    fn a_complete_description_leaves_nothing_out() {
        let sensor = testing::sensor();
        assert_eq!((front_end(&sensor).len(), without_scene(&sensor), advice(&sensor).len()), (0, None, 0));
        assert!(
            not_testable(&sensor, |_| false).is_empty()
                && alternative_explanation(&sensor, &late(3e-3)).is_none()
        );
        assert!(CANDIDATES.iter().all(|candidate| candidate.is_stated(&sensor)));
    }

    #[test]
    fn what_is_left_out_has_its_field_its_use_and_its_source() {
        let found = not_testable(&proposed(), |id| id == "leak_events");
        assert_eq!(found.len(), catalogue().len() - 1);
        for one in &found {
            assert!(one.why.contains("front_end.tau_0 and front_end.alpha are not stated"), "{}", one.why);
            assert!(
                reason_without_source(&one.why).is_some_and(|why| !why.contains("sheet"))
                    && one.why.contains("would add")
                    && one.why.contains("maker's sheet")
                    && one.why.contains("docs/calibrate-sensor.md"),
                "{}",
                one.why
            );
        }
        let with_alpha = Sensor {
            front_end: photocurrent_core::sensor::FrontEnd { tau_0: None, ..testing::sensor().front_end },
            ..proposed()
        };
        assert!(
            without_scene(&with_alpha).is_some_and(|why| why.starts_with("front_end.tau_0 is not stated"))
        );
        let unstated = |sensor: &Sensor| {
            CANDIDATES
                .iter()
                .filter(|candidate| !candidate.is_stated(sensor))
                .map(Candidate::label)
                .collect::<Vec<_>>()
        };
        assert_eq!(
            (unstated(&proposed()), unstated(&with_alpha)),
            (
                vec!["time_constant.tau_0".into(), "time_constant.alpha".into()],
                vec!["time_constant.tau_0".into()]
            )
        );
    }

    #[test]
    fn a_low_pass_makes_thresholds_larger_and_never_smaller() {
        let of = |id, parameter, value| {
            alternative_explanation(
                &proposed(),
                &Departure::from_halves(id, (parameter, value), 100.0, 1000, String::new()),
            )
            .map(|(id, _)| id)
        };
        assert_eq!(
            of("threshold_scale", "fraction", 0.2).zip(of("dark_current", "current", 3.0)),
            Some(("time_constant", "time_constant"))
        );
        assert_eq!(
            (
                of("threshold_scale", "fraction", -0.2),
                of("threshold_asymmetry", "fraction", 0.2),
                of("leak_events", "rate", 1.0)
            ),
            (None, None, None)
        );
        let of_intervals = Departure {
            heldout: None,
            ..Departure::from_halves("refractory", ("refractory", 1e-3), 100.0, 1000, String::new())
        };
        assert_eq!(
            (of("refractory", "refractory", 1e-3), alternative_explanation(&proposed(), &of_intervals)),
            (Some("time_constant"), None)
        );
    }

    #[test]
    fn lateness_is_a_clock_or_a_front_end_and_earliness_is_a_clock() {
        assert_eq!(alternative_explanation(&proposed(), &late(3e-3)), Some(("time_constant", LATENESS)));
        assert_eq!(alternative_explanation(&proposed(), &late(-3e-3)), None);
        let mut sensor = proposed();
        sensor
            .effects
            .insert("clock_offset".into(), json!({"offset": "3.3 ms"}).as_object().unwrap().clone());
        let stated = not_testable(&sensor, |_| true);
        assert_eq!(stated.len(), 1);
        assert!(
            reason_without_source(&stated[0].why).is_some()
                && stated[0].id == "clock_offset"
                && stated[0].why.contains("3.3 ms")
                && stated[0].why.contains("does not separate"),
            "{}",
            stated[0].why
        );
    }
}
