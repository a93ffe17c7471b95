//! What to record next, so that what looks alike comes apart.

use crate::integrity::Integrity;
use crate::integrity::data::is_enough;
use crate::report::{Detectable, Verdict};
use crate::units::readable;
use crate::unstated::{self, without_scene};
use crate::verdict::Answer;
use photocurrent_scene::case::Case;
use photocurrent_sensor::effects::catalogue;

/// Advice for a diagnosis; nothing when there is nothing to separate.
pub(crate) fn next_experiments(
    case: &Case,
    answer: &Answer,
    integrity: &Integrity,
    limits: &[Detectable],
) -> Vec<String> {
    let mut advice = Vec::new();
    for finding in &answer.findings {
        let set: Vec<&String> = std::iter::once(&finding.id).chain(&finding.also_possible).collect();
        for (k, one) in set.iter().enumerate() {
            for other in &set[k + 1..] {
                advice.push(apart(one, other).or_else(|| apart(other, one)).unwrap_or_else(|| {
                    format!(
                        "to separate {one} from {other}: the same scene at another speed and in other \
                             light, as the two do not scale alike"
                    )
                }));
            }
        }
    }
    if answer.verdict == Verdict::Insufficient {
        // What the description lacks is stated, not recorded.
        let of_description = without_scene(&case.sensor);
        let is_recorded =
            |what: &&String| of_description.as_ref().is_none_or(|why| !what.contains(why.as_str()));
        advice
            .extend(integrity.lacking.iter().filter(is_recorded).map(|what| format!("record more: {what}")));
    }
    if answer.verdict == Verdict::BrokenData {
        advice.push(
            "record again, or repair the file: nothing can be said of a sensor whose data \
                     contradict themselves"
                .into(),
        );
    }
    if matches!(answer.verdict, Verdict::Consistent | Verdict::Insufficient) && is_enough(case) {
        advice.push(
            "faster motion, sharper edges and a wider range of light make smaller effects visible".into(),
        );
    }
    if matches!(answer.verdict, Verdict::Consistent | Verdict::Insufficient) {
        advice.extend(of_known_light(limits));
    }
    if answer.verdict != Verdict::BrokenData && is_enough(case) {
        advice.extend(unstated::advice(&case.sensor));
    }
    advice
}

/// An effect whose limit is this many times that of known light is mostly taken over by the estimated scene.
const TAKEN_OVER: f64 = 3.0;
/// So many of them are stated: more are in `detectability`.
const MOST_STATED: usize = 4;

/// Which effects the estimated scene takes over, and from what size on they would be seen were the light
/// known.
fn of_known_light(limits: &[Detectable]) -> Option<String> {
    let times = |one: &Detectable| one.minimal_detectable / one.of_known_light.unwrap_or(f64::INFINITY);
    let mut over: Vec<&Detectable> = limits.iter().filter(|one| times(one) >= TAKEN_OVER).collect();
    over.sort_by(|a, b| times(b).total_cmp(&times(a)));
    let mut stated: Vec<&Detectable> = Vec::new();
    for one in over {
        if stated.iter().all(|other| other.id != one.id) && stated.len() < MOST_STATED {
            stated.push(one);
        }
    }
    let one = |of: &&Detectable| {
        let [known, estimated] = [of.of_known_light?, of.minimal_detectable].map(|v| readable(v, &of.unit));
        Some(format!("{} ({}) from {known} on instead of {estimated}", of.id, of.parameter))
    };
    let list: Vec<String> = stated.iter().filter_map(one).collect();
    (!list.is_empty()).then(|| {
        format!(
            "a known target (`--scene`): the estimated scene takes over most of some effects, which known \
             light would show: {}",
            list.join(", ")
        )
    })
}

/// What separates an effect from another one, by the catalogue's word of the first.
fn apart(one: &str, other: &str) -> Option<String> {
    let kind = catalogue().into_iter().find(|kind| kind.decl.id == one)?;
    let (_, what) = kind.decl.apart.iter().find(|(id, _)| *id == other)?;
    Some(format!("to separate {one} from {other}: {what}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_an_estimated_scene_takes_over_is_stated_with_what_known_light_would_show() {
        let limit = |id: &str, parameter: &str, minimal_detectable: f64, of_known_light: Option<f64>| {
            let (id, parameter) = (id.to_owned(), parameter.to_owned());
            Detectable {
                id,
                parameter,
                minimal_detectable,
                of_known_light,
                usual: None,
                unit: "s".into(),
                estimate: None,
                standard_error: None,
            }
        };
        let limits = [
            limit("clock_offset", "offset_s", 3e-4, Some(2e-4)),
            limit("exposure_time", "delta_s", 3e-3, Some(1e-4)),
            limit("image_lag", "tau", 1e-3, Some(2e-4)),
            limit("row_time", "delta_s", 1e-5, None),
        ];
        let advice = of_known_light(&limits).unwrap();
        let ends = "exposure_time (delta_s) from 100 us on instead of 3 ms, image_lag (tau) from 200 us on \
                    instead of 1 ms";
        assert!(advice.ends_with(ends), "{advice}");
        assert_eq!(of_known_light(&limits[..1]), None);
    }

    #[test]
    fn a_pair_is_separated_by_the_word_of_the_one_that_has_it() {
        assert_eq!(
            apart("clock_drift", "clock_offset").unwrap(),
            "to separate clock_drift from clock_offset: a recording four times as long: a drift grows with it"
        );
        assert_eq!(apart("clock_offset", "clock_drift"), None);
    }
}
