//! What to record next, so that what looks alike comes apart.

use crate::integrity::Integrity;
use crate::integrity::data::is_enough;
use crate::report::Verdict;
use crate::unstated::{self, without_scene};
use crate::verdict::Answer;
use photocurrent_scene::case::Case;
use photocurrent_sensor::effects::catalogue;

/// Advice for a diagnosis; nothing when there is nothing to separate.
pub(crate) fn next_experiments(case: &Case, answer: &Answer, integrity: &Integrity) -> Vec<String> {
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
    if answer.verdict == Verdict::Consistent && case.frame_count() > 0 {
        advice.push(
            "faster motion, sharper edges and a wider range of light make smaller effects visible".into(),
        );
    }
    if answer.verdict != Verdict::BrokenData && is_enough(case) {
        advice.extend(unstated::advice(&case.sensor));
    }
    advice
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
    fn a_pair_is_separated_by_the_word_of_the_one_that_has_it() {
        assert_eq!(
            apart("clock_drift", "clock_offset").unwrap(),
            "to separate clock_drift from clock_offset: a recording four times as long: a drift grows with it"
        );
        assert_eq!(apart("clock_offset", "clock_drift"), None);
    }
}
