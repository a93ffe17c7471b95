//! Which recording to make next, so that two effects with similar evidence can be separated.

use crate::finding::UNNAMED;
use crate::integrity::Integrity;
use crate::integrity::data::is_enough;
use crate::report::{Evidence, Finding, MinimumDetectable, Verdict};
use crate::residual::separation::{ExplanationPair, Separation};
use crate::rivals::is_random;
use crate::stages::{EffectProposal, SceneDecision};
use crate::units::readable;
use crate::unstated::{self, without_scene};
use crate::verdict::JoinedFindings;
use photocurrent_core::{NodeError, Sensor};
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use photocurrent_sensor::effects::catalogue;

/// Two explanations and the recording that separates them.
#[derive(Clone, Debug)]
pub(crate) struct SeparatedExplanations {
    /// Ids, the better one first.
    pub ids: [String; 2],
    /// Predicted gain of the recordings that separate them.
    pub by: Separation,
}

impl SeparatedExplanations {
    /// As a sentence; none where the recording at hand separates them.
    fn sentence(&self, case: &Case, answer: &JoinedFindings) -> Option<String> {
        let [one, other] = &self.ids;
        let Separation { best, again, known, left } = self.by;
        let recorded_s = (case.span.1 - case.span.0) as f64 * 1e-9;
        if answer.verdict != Verdict::Ambiguous && again.seconds <= recorded_s {
            return None;
        }
        let takes = |seconds: f64| match seconds.is_finite() {
            true => readable(seconds, "s"),
            false => "more than an hour".to_owned(),
        };
        let what = match (best.seconds.is_finite(), best == again) {
            (false, _) => "no other speed, light or threshold does within an hour".to_owned(),
            (true, true) => format!("the same again, for {}", takes(again.seconds)),
            (true, false) => {
                format!(
                    "{}, for {}; the same again takes {}",
                    best.name,
                    takes(best.seconds),
                    takes(again.seconds)
                )
            }
        };
        Some(format!(
            "to separate {one} from {other} by three standard errors: {what}; {} in place of this scene \
             takes {} (both simulated on the light of this recording; of what known light shows, the \
             estimated scene leaves {} %)",
            known.name,
            takes(known.seconds),
            readable(100.0 * left, "")
        ))
    }
}

/// The two best explanations of a recording with their ids; none where there is one, or one of them is random
/// or has no description. `describe`: the description with findings, `curve`: with what has no name.
///
/// # Errors
/// As `separation`.
pub(crate) fn two_best(
    case: &Case,
    nominal: &Nominal,
    (decided, answer): (Option<&SceneDecision>, &JoinedFindings),
    describe: impl Fn(&[Finding]) -> Option<Sensor>,
    curve: Option<Sensor>,
    separation: impl Fn(&ExplanationPair<'_>) -> Result<Option<Separation>, NodeError>,
) -> Result<Option<SeparatedExplanations>, NodeError> {
    let Some(decided) = decided else { return Ok(None) };
    let first = answer.findings.iter().find(|one| !one.is_direct() && !is_random(&one.id));
    let (id, sensor, gain, gain_error) = match (first, &answer.unexplained, curve) {
        (Some(first), ..) => {
            let Some(sensor) = describe(std::slice::from_ref(first)) else { return Ok(None) };
            let (gain, error) = gain_of(&first.evidence);
            (first.id.clone(), sensor, gain, error)
        }
        (None, Some(unexplained), Some(curve)) => {
            let significance = unexplained.dependence.as_ref().map_or(1.0, |of| of.significance);
            (UNNAMED.to_owned(), curve, unexplained.nats, unexplained.nats / significance)
        }
        _ => return Ok(None),
    };
    let also = first.and_then(|first| first.also_possible.iter().find(|id| *id != UNNAMED));
    let is_other = |one: &&EffectProposal| {
        one.id() != id && !is_random(one.id()) && also.is_none_or(|also| one.id() == also)
    };
    let others = decided.proposals.iter().filter(is_other);
    let other =
        others.max_by(|a, b| a.probability.total_cmp(&b.probability).then(b.candidate.cmp(&a.candidate)));
    let Some(other) = other else { return Ok(None) };
    let finding = Finding::from_proposal(case, nominal, &decided.name, other);
    let Some(of_other) = describe(std::slice::from_ref(&finding)) else { return Ok(None) };
    // What an unnamed curve gains is over the effects already.
    let (taken, other_error) = if id == UNNAMED { (0.0, 0.0) } else { gain_of(&finding.evidence) };
    let pair = ExplanationPair {
        sensors: [&sensor, &of_other],
        gain: gain - taken,
        gain_error: libm::hypot(gain_error, other_error),
    };
    Ok(separation(&pair)?.map(|by| SeparatedExplanations { ids: [id, finding.id.clone()], by }))
}

/// Held-out gain, nats an event, with its standard error.
fn gain_of(evidence: &Evidence) -> (f64, f64) {
    let gain = evidence.heldout_nats_per_event.unwrap_or(0.0);
    let events = evidence.heldout_nats.map_or(0.0, |nats| nats / gain);
    let width = evidence.heldout_nats_ci95.map_or(0.0, |[low, high]| (high - low) / (2.0 * 1.96));
    (gain, if events > 0.0 { width / events } else { 0.0 })
}

/// Sentences of advice for a diagnosis. Empty when there is nothing to separate.
pub(crate) fn next_experiments(
    case: &Case,
    answer: &JoinedFindings,
    integrity: &Integrity,
    limits: &[MinimumDetectable],
    simulated: Option<&SeparatedExplanations>,
) -> Vec<String> {
    let mut advice: Vec<String> =
        simulated.and_then(|apart| apart.sentence(case, answer)).into_iter().collect();
    let is_simulated = |pair: [&String; 2]| {
        simulated.is_some_and(|apart| apart.ids.each_ref() == pair || [&apart.ids[1], &apart.ids[0]] == pair)
    };
    for finding in &answer.findings {
        let set = std::iter::once(&finding.id).chain(&finding.also_possible);
        // What has no name has no word of the catalogue.
        let set: Vec<&String> = set.filter(|id| *id != UNNAMED).collect();
        for (k, one) in set.iter().enumerate() {
            for other in &set[k + 1..] {
                let stated = catalogue_separation(one, other).or_else(|| catalogue_separation(other, one));
                let otherwise = || {
                    format!(
                        "to separate {one} from {other}: the same scene at another speed and in other light, \
                         as the two do not scale alike"
                    )
                };
                advice.extend(stated.or_else(|| (!is_simulated([one, other])).then(otherwise)));
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
/// Most limits that a sentence lists; `detectability` has all of them.
const MOST_STATED: usize = 4;

/// Effects that the estimated scene absorbs, with the smallest size that known light would show.
fn of_known_light(limits: &[MinimumDetectable]) -> Option<String> {
    let times =
        |one: &MinimumDetectable| one.minimal_detectable / one.of_known_light.unwrap_or(f64::INFINITY);
    let mut over: Vec<&MinimumDetectable> = limits.iter().filter(|one| times(one) >= TAKEN_OVER).collect();
    over.sort_by(|a, b| times(b).total_cmp(&times(a)));
    let mut stated: Vec<&MinimumDetectable> = Vec::new();
    for one in over {
        if stated.iter().all(|other| other.id != one.id) && stated.len() < MOST_STATED {
            stated.push(one);
        }
    }
    let one = |of: &&MinimumDetectable| {
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

/// How the catalogue separates effect `one` from effect `other`; `None` where it states nothing.
fn catalogue_separation(one: &str, other: &str) -> Option<String> {
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
            MinimumDetectable {
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
    fn what_separates_two_explanations_is_a_recording_and_how_long_it_takes() {
        use crate::residual::separation::SeparatingRecording;
        let case = crate::testing::case();
        let of = |best: (&'static str, f64), again: f64| {
            let one = |(name, seconds)| SeparatingRecording { name, seconds };
            let by = Separation {
                best: one(best),
                again: one(("the same again", again)),
                known: one(("a known target", 0.024)),
                left: 0.05,
            };
            SeparatedExplanations { ids: ["time_constant".into(), "clock_offset".into()], by }
        };
        let answer = |verdict: Verdict| JoinedFindings { verdict, findings: Vec::new(), unexplained: None };
        let sentence_of = |apart: &SeparatedExplanations, verdict| apart.sentence(&case, &answer(verdict));
        let dim = of(("the same scene in a tenth of the light", 0.2), 1.5);
        let sentence = sentence_of(&dim, Verdict::Named).unwrap();
        assert!(
            sentence.starts_with(
                "to separate time_constant from clock_offset by three standard errors: the same scene in a \
                 tenth of the light, for 200 ms; the same again takes 1.5 s; a known target in place of this \
                 scene takes 24 ms"
            ) && sentence.ends_with("leaves 5 %)"),
            "{sentence}"
        );
        // The recording of 60 ms separates them: a name needs no advice, a set does.
        let same = of(("the same again", 0.05), 0.05);
        assert_eq!(sentence_of(&same, Verdict::Named), None);
        assert!(
            sentence_of(&same, Verdict::Ambiguous).unwrap().contains(": the same again, for 50 ms; a known")
        );
        let none = of(("the same again", f64::INFINITY), f64::INFINITY);
        assert!(
            sentence_of(&none, Verdict::Ambiguous).unwrap().contains("does within an hour; a known target")
        );
    }

    #[test]
    fn a_pair_is_separated_by_the_word_of_the_one_that_has_it() {
        assert_eq!(
            catalogue_separation("clock_drift", "clock_offset").unwrap(),
            "to separate clock_drift from clock_offset: a recording four times as long: a drift grows with it"
        );
        assert_eq!(catalogue_separation("clock_offset", "clock_drift"), None);
    }
}
