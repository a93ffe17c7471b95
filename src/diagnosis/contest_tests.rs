//! What is believed of two effects that a refit cannot tell apart, on recordings whose effect is known.

use super::*;
use crate::candidates::{Candidate, Scales};
use crate::case::Case;
use crate::testing;
use serde_json::json;

fn index(id: &str) -> usize {
    CANDIDATES.iter().position(|candidate| candidate.id == id).unwrap()
}

fn proposal(id: &str, value: f64, score: f64, probability: f64) -> Proposal {
    Proposal { candidate: index(id), value, score, probability, passed: score >= 1.0, heldout_nats_per_event: Some(0.1), ..Proposal::default() }
}

fn refit(proposals: Vec<Proposal>) -> Road {
    Road { name: REFIT.into(), alarm: proposals.iter().any(|one| one.passed), proposals, ..Road::default() }
}

fn leaking() -> Case {
    let rate = json!({"rate": "25 Hz"});
    testing::case_with(&[("leak_events".to_owned(), rate.as_object().unwrap().clone())].into_iter().collect())
}

fn judged(case: &Case, mut roads: Vec<Road>) -> Road {
    let nominal = case.nominal().unwrap();
    let scales = Scales::of(case, &nominal);
    let ground = Ground::new(case, &nominal, &scales).unwrap();
    judge(ground.as_ref(), &mut roads).unwrap();
    roads.swap_remove(0)
}

#[test]
fn other_pixels_decide_and_withdraw_what_they_do_not_show() {
    let case = leaking();
    // The refit, on its own pixels, liked an offset of the clock better.
    let proposals = || vec![proposal("clock_offset", 2e-3, 2.2, 0.7), proposal("leak_events", 25.0, 2.0, 0.3)];
    let road = judged(&case, vec![refit(proposals())]);
    let [clock, leak] = &road.proposals[..] else { panic!("{:?}", road.proposals) };
    assert!(leak.probability > 0.6 * AMONG && leak.passed, "{leak:?} {clock:?}");
    assert!(!clock.passed && road.alarm, "{clock:?}");
    assert!((leak.probability + clock.probability - AMONG).abs() < 1e-12, "what takes part is not everything that could be");
    // Nothing is left to be told where nothing is shown, and without pixels to look at the refit's word stands.
    assert!(!judged(&case, vec![refit(proposals()[..1].to_vec())]).alarm);
    let mut alone = [refit(proposals())];
    judge(None, &mut alone).unwrap();
    assert!(alone[0].alarm && alone[0].proposals.iter().all(|one| one.passed) && alone[0].proposals[0].probability > alone[0].proposals[1].probability);
}

#[test]
fn what_all_pixels_name_and_a_second_effect_need_a_proof_as_well() {
    let case = leaking();
    let both = || vec![proposal("clock_offset", 2e-3, 2.0, 1.0), proposal("leak_events", 20.0, 1.9, 0.9)];
    let alone = judged(&case, vec![Road { to_first_order: both(), ..refit(Vec::new()) }]);
    assert_eq!(alone.to_first_order.iter().map(|one| one.passed).collect::<Vec<_>>(), [false, true]);
    assert!(alone.to_first_order[1].probability > 0.5 * AMONG_TO_FIRST_ORDER);
    // Beside the leak that it is, no fault of the clock shows anything.
    let second = vec![proposal("clock_offset", 2e-3, 2.0, 0.9), proposal("clock_drift", 0.05, 2.0, 0.1)];
    let beside = judged(&case, vec![Road { second, ..refit(vec![proposal("leak_events", 25.0, 4.0, 1.0)]) }]);
    assert!(beside.alarm && beside.second.iter().all(|one| !one.passed && one.probability == 0.0), "{:?}", beside.second);
}

#[test]
fn what_explains_almost_enough_is_believed_where_everything_gets_better() {
    let almost = |value: f64| judged(&leaking(), vec![refit(vec![proposal("leak_events", value, 0.8, 1.0)])]);
    let found = almost(25.0);
    assert!(found.alarm && found.proposals[0].passed && found.proposals[0].score == 1.0, "{:?}", found.proposals);
    assert!(!judged(&testing::case(), vec![refit(vec![proposal("leak_events", 25.0, 0.8, 1.0)])]).alarm);
}

#[test]
fn synthesis_is_heard_when_it_speaks() {
    let two = [proposal("leak_events", 8.0, 4.0, 0.5), proposal("threshold_asymmetry", 0.1, 4.0, 0.5)];
    let belief = |heard: &[Proposal]| believed(&two.each_ref().map(|one| (one, None)), heard);
    assert_eq!(belief(&[]), [0.5, 0.5]);
    let heard = belief(&[proposal("threshold_asymmetry", 0.1, 4.0, 0.9)]);
    // A logit: the ratio of beliefs is that of its voice, to its weight.
    assert!((heard[1] / heard[0] - libm::pow(0.9 / LEAST_SYNTHESIS, WEIGHTS.synthesis)).abs() < 1e-9, "{heard:?}");
}

#[test]
fn chance_keeps_its_own_belief_and_is_not_put_on() {
    let spread = Candidate::find("threshold_mismatch", "sigma").unwrap();
    let chance = Proposal { candidate: CANDIDATES.iter().position(|one| one.label() == spread.label()).unwrap(), ..proposal("leak_events", 0.02, 2.0, 0.5) };
    let road = judged(&testing::case(), vec![Road { to_first_order: vec![chance.clone()], ..refit(Vec::new()) }]);
    assert_eq!(road.to_first_order, [chance]);
}
