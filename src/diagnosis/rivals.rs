//! Rival effects, which explain events nearly as well as the chosen one, compared by held-out frames.
//!
//! On a scene that follows events, effects that shift all of them alike differ in frames. Before a turning
//! fan a clock late by 1 ms gained less on the light of pixels than an exposure shorter by 2 ms, and predicts
//! held-out frames 5 dB better. The effect that predicts them best is selected.

use crate::candidates::{CANDIDATES, EffectScales};
use crate::heldout::HeldOutScore;
use crate::report::Finding;
use crate::stages::{EffectProposal, SceneDecision};
use crate::verdict::JoinedFindings;
use photocurrent_core::NodeError;
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;

/// Least gain of a rival, as a share of the chosen effect's. By the fan: 0.40.
const RIVAL_SHARE: f64 = 0.25;
/// The most of them.
const MOST_RIVALS: usize = 3;
/// A scene that follows a shift in time leaves a part of its size: larger ones are tried as long as frames
/// are predicted better, times the fitted one. The fan's clock was fitted at 0.4 ms.
const LARGER: [f64; 4] = [1.0, 1.6, 2.5, 4.0];

/// The findings with the scene's effect that predicts held-out frames best. It must be better by
/// `least_better_db` than the chosen one and than the description as it is, which reaches `stated_db`: a gain
/// over a wrong effect alone explains no frames. `after` computes the held-out score with findings.
///
/// # Errors
/// As `after`.
pub(crate) fn by_frames(
    case: &Case,
    (nominal, scales): (&Nominal, &EffectScales),
    decided: Option<&SceneDecision>,
    mut answer: JoinedFindings,
    (stated_db, least_better_db): (Option<f64>, f64),
    after: impl Fn(&[Finding]) -> Result<Option<HeldOutScore>, NodeError>,
) -> Result<JoinedFindings, NodeError> {
    let Some((decided, place, rivals)) = decided.and_then(|decided| {
        let place = answer.findings.iter().position(|one| !one.is_direct() && !is_random(&one.id))?;
        Some((decided, place, rivals(case, nominal, decided, &answer.findings[place])))
    }) else {
        return Ok(answer);
    };
    if rivals.is_empty() {
        return Ok(answer);
    }
    let chosen = answer.findings[place].clone();
    // A second effect was fitted with the first one applied.
    let others: Vec<Finding> = answer.findings.iter().filter(|one| one.is_direct()).cloned().collect();
    let psnr_db = |finding: &Finding| -> Result<Option<f64>, NodeError> {
        let with = [std::slice::from_ref(finding), &others].concat();
        Ok(after(&with)?.map(|prediction| prediction.psnr_db()))
    };
    let Some(of_chosen) = psnr_db(&chosen)? else { return Ok(answer) };
    let mut tried = vec![(of_chosen, chosen)];
    for rival in &rivals {
        let mut best: Option<(f64, Finding)> = None;
        for times in LARGER {
            let rival = if times == 1.0 { rival.clone() } else { larger(rival, times, nominal, scales) };
            let finding = Finding::from_proposal(case, nominal, &decided.name, &rival);
            let Some(db) = psnr_db(&finding)? else { break };
            if best.as_ref().is_some_and(|best| db <= best.0) {
                break;
            }
            best = Some((db, finding));
        }
        tried.extend(best);
    }
    tried.sort_by(|a, b| b.0.total_cmp(&a.0));
    let best = tried[0].0;
    if best > stated_db.map_or(of_chosen, |stated| of_chosen.max(stated)) + least_better_db {
        let near = tried.iter().skip(1).filter(|one| one.0 > best - least_better_db);
        let also_possible = near.map(|one| one.1.id.clone()).collect();
        let better = Finding { also_possible, ..tried[0].1.clone() };
        answer.set([vec![better], others].concat());
    }
    Ok(answer)
}

/// A proposal with its size multiplied, without an interval: another size was fitted.
fn larger(one: &EffectProposal, times: f64, nominal: &Nominal, scales: &EffectScales) -> EffectProposal {
    let candidate = &CANDIDATES[one.candidate];
    let size = times * candidate.effect_size(one.value, scales, nominal);
    EffectProposal { value: candidate.value(size, scales, nominal), ci95: None, ..one.clone() }
}

/// Other effects that explain about as much as a finding, largest gain first.
fn rivals(case: &Case, nominal: &Nominal, decided: &SceneDecision, finding: &Finding) -> Vec<EffectProposal> {
    let gain = |one: &EffectProposal| one.heldout_nats_per_event.unwrap_or(0.0);
    let own = decided.proposals.iter().filter(|one| one.id() == finding.id).map(gain).fold(0.0, f64::max);
    let is_rival = |one: &&EffectProposal| {
        let candidate = &CANDIDATES[one.candidate];
        one.id() != finding.id
            && !candidate.is_random
            && candidate.is_material(case, nominal, one.value)
            && gain(one) > RIVAL_SHARE * own
    };
    let mut rivals: Vec<EffectProposal> = decided.proposals.iter().filter(is_rival).cloned().collect();
    rivals.sort_by(|a, b| gain(b).total_cmp(&gain(a)).then(a.candidate.cmp(&b.candidate)));
    rivals.truncate(MOST_RIVALS);
    rivals
}

/// Is an effect random? It is then not undone, and held-out frames are no evidence for it.
pub(crate) fn is_random(id: &str) -> bool {
    CANDIDATES.iter().any(|candidate| candidate.id == id && candidate.is_random)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidates::Candidate;
    use crate::heldout::HeldOutScore;
    use crate::report::Verdict;
    use crate::testing;

    /// An effect that gains so many nats an event.
    fn proposal(id: &str, parameter: &str, value: f64, gain: f64) -> EffectProposal {
        EffectProposal {
            candidate: Candidate::number(id, parameter).unwrap(),
            value,
            passed: true,
            heldout_nats_per_event: Some(gain),
            ..EffectProposal::default()
        }
    }

    /// Frames that are predicted to so many dB.
    fn prediction(db: f64) -> HeldOutScore {
        HeldOutScore { square_error: libm::pow(10.0, -0.1 * db), peak_dn: 1.0, ..HeldOutScore::default() }
    }

    #[test]
    fn the_rival_that_predicts_frames_best_is_taken_where_it_is_clearly_better() {
        let case = testing::case();
        let nominal = case.nominal().unwrap();
        let scales = EffectScales::from_case(&case, &nominal);
        let exposure = proposal("exposure_time", "difference", -2e-3, 0.39);
        let clock = proposal("clock_offset", "offset", 1e-3, 0.16);
        let small = proposal("row_time", "row_time", 5e-5, 0.05);
        let decided =
            SceneDecision { proposals: vec![exposure.clone(), clock, small], ..SceneDecision::default() };
        let answer = || {
            let finding = Finding::from_proposal(&case, &nominal, "pixels", &exposure);
            let mut answer =
                JoinedFindings { verdict: Verdict::Consistent, findings: Vec::new(), unexplained: None };
            answer.set(vec![finding]);
            answer
        };
        let taken_over = |stated_db: f64, of_clock: f64| {
            let after = |with: &[Finding]| {
                // What gains an eighth as much is not tried.
                assert!(with[0].id != "row_time");
                // Of a clock that is late by 2 ms.
                let off = (with[0].values[0].1 - 2e-3).abs();
                let of_clock = of_clock - 1e3 * off;
                Ok(Some(prediction(if with[0].id == "clock_offset" { of_clock } else { 38.0 })))
            };
            by_frames(&case, (&nominal, &scales), Some(&decided), answer(), (Some(stated_db), 1.0), after)
                .unwrap()
        };
        let taken = |of_clock: f64| taken_over(34.0, of_clock);
        let better = taken(43.0);
        assert_eq!((better.verdict, &better.findings[0].id[..]), (Verdict::Named, "clock_offset"));
        assert!((better.findings[0].values[0].1 - 1.6e-3).abs() < 1e-9);
        assert_eq!(taken(38.9), answer());
        assert_eq!(taken(30.0), answer());
        // Without any effect frames are predicted as well.
        assert_eq!(taken_over(42.5, 43.0), answer());
    }
}
