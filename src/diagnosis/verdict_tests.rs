//! What is claimed when tests agree, differ, or stand alone.

use super::*;
use crate::testing;

fn index(id: &str, parameter: &str) -> usize {
    CANDIDATES.iter().position(|candidate| candidate.id == id && candidate.parameter == parameter).unwrap()
}

fn proposal(id: &str, parameter: &str, score: f64, probability: f64, value: f64) -> Proposal {
    Proposal { candidate: index(id, parameter), score, probability, value, passed: score >= 1.0, ..Proposal::default() }
}

fn road(name: &str, proposals: Vec<Proposal>) -> Road {
    Road { name: name.into(), alarm: proposals.iter().any(|proposal| proposal.passed), proposals, ..Road::default() }
}

fn answer(roads: &[Road]) -> Answer {
    answer_with(&Integrity::default(), roads)
}

fn answer_with(integrity: &Integrity, roads: &[Road]) -> Answer {
    let case = testing::case();
    let nominal = case.nominal().unwrap();
    verdict(&case, &nominal, integrity, roads)
}

fn leak(score: f64, probability: f64) -> Proposal {
    proposal("leak_events", "rate", score, probability, 8.0)
}

fn asymmetry(score: f64, probability: f64) -> Proposal {
    proposal("threshold_asymmetry", "fraction", score, probability, 0.1)
}

#[test]
fn two_roads_that_agree_name_the_effect() {
    let roads = [road("likelihood", vec![leak(1.2, 0.5), asymmetry(1.1, 0.4)]), road("synthesis", vec![leak(1.1, 0.6), asymmetry(1.05, 0.3)])];
    let answer = answer(&roads);
    assert_eq!(answer.verdict, Verdict::Named);
    assert_eq!(answer.claims[0].id, "leak_events");
    assert!(answer.claims[0].also_possible.is_empty());
    assert_eq!(answer.claims[0].found_by, ["likelihood", "synthesis"]);
}

#[test]
fn two_sure_roads_that_differ_give_a_set_with_both() {
    let answer = answer(&[road("likelihood", vec![leak(5.0, 0.9)]), road("synthesis", vec![asymmetry(5.0, 0.8)])]);
    assert_eq!(answer.verdict, Verdict::Ambiguous);
    let claim = &answer.claims[0];
    let mut set = claim.also_possible.clone();
    set.push(claim.id);
    set.sort_unstable();
    assert_eq!(set, ["leak_events", "threshold_asymmetry"]);
    assert_eq!(answer.claims.len(), 1, "an ambiguity is one claim, not two");
}

#[test]
fn what_no_road_found_enough_for_or_none_believes_in_is_no_name() {
    let clock = |score: f64, probability: f64| proposal("clock_offset", "offset", score, probability, 1e-3);
    // Both believe in the asymmetry most, and neither found enough for it.
    let both = answer(&[road("likelihood", vec![asymmetry(0.9, 0.5), leak(5.0, 0.4)]), road("synthesis", vec![asymmetry(0.9, 0.5), clock(5.0, 0.4)])]);
    assert!(both.claims.iter().all(|claim| claim.id != "threshold_asymmetry" && !claim.also_possible.contains(&"threshold_asymmetry")), "{both:?}");
    assert_eq!(both.verdict, Verdict::Ambiguous);
    let nobody = answer(&[road("likelihood", vec![leak(5.0, 0.05)]), road("synthesis", vec![clock(5.0, 0.05)])]);
    assert_eq!(nobody.verdict, Verdict::Consistent);
}

#[test]
fn a_road_alone_needs_more_when_the_other_is_silent() {
    let silent = || Road { alarm: false, ..road("synthesis", vec![asymmetry(0.3, 0.5)]) };
    assert_eq!(answer(&[road("likelihood", vec![leak(8.0, 0.9)]), silent()]).verdict, Verdict::Consistent);
    assert_eq!(answer(&[road("likelihood", vec![leak(12.0, 0.9)]), silent()]).verdict, Verdict::Named);
    // When there is no other road its own alarm is all there is.
    assert_eq!(answer(&[road("likelihood", vec![leak(1.3, 0.9)])]).verdict, Verdict::Named);
}

#[test]
fn what_is_certain_but_immaterial_is_not_claimed() {
    let tiny = |value: f64| answer(&[road("likelihood", vec![proposal("time_constant", "tau_0", 50.0, 1.0, value)])]).verdict;
    // The description states 30 us; a microsecond more is nothing.
    assert_eq!(tiny(31e-6), Verdict::Consistent);
    assert_eq!(tiny(60e-6), Verdict::Named);
}

#[test]
fn a_second_effect_needs_both_roads_or_a_wide_margin() {
    let with_second = |name: &str, second: Proposal| Road { second: vec![second], ..road(name, vec![leak(9.0, 0.9)]) };
    let both = [with_second("likelihood", asymmetry(2.0, 0.9)), with_second("synthesis", asymmetry(2.0, 0.9))];
    assert_eq!(answer(&both).claims.len(), 2);
    let one = [with_second("likelihood", asymmetry(2.0, 0.9)), road("synthesis", vec![leak(9.0, 0.9)])];
    assert_eq!(answer(&one).claims.len(), 1);
    let wide = [with_second("likelihood", asymmetry(30.0, 0.9)), road("synthesis", vec![leak(9.0, 0.9)])];
    assert_eq!(answer(&wide).claims.len(), 2);
}

#[test]
fn a_direct_finding_is_named_and_a_stronger_term_stands_before_it() {
    let finding = Finding {
        id: "hot_pixels",
        parameters: vec![("fraction", 0.002), ("rate", 900.0)],
        statistic: 16.0,
        threshold: 8.0,
        share: 0.002,
        polarity: "on",
        pixels: vec![3],
        seen: String::new(),
        heldout: None,
    };
    let integrity = Integrity { findings: vec![finding], ..Integrity::default() };
    let alone = answer_with(&integrity, &[]);
    assert_eq!((alone.verdict, alone.claims[0].id), (Verdict::Named, "hot_pixels"));
    let joined = answer_with(&integrity, &[road("likelihood", vec![leak(40.0, 0.9)]), road("synthesis", vec![leak(30.0, 0.9)])]);
    let ids: Vec<&str> = joined.claims.iter().map(|claim| claim.id).collect();
    assert_eq!(ids, ["leak_events", "hot_pixels"]);
}

#[test]
fn nothing_over_its_alarm_is_consistent_and_something_unexplained_has_no_name() {
    assert_eq!(answer(&[road("likelihood", vec![leak(0.7, 0.9)])]).verdict, Verdict::Consistent);
    let unexplained = Unexplained { covariate: "frame_phase".into(), score: 3.0, ..Unexplained::default() };
    let found = answer(&[Road { alarm: true, unexplained: Some(unexplained), ..road("likelihood", Vec::new()) }]);
    assert!(found.claims.is_empty());
    assert_eq!(found.unexplained.map(|found| found.covariate), Some("frame_phase".to_owned()));
    assert_eq!(found.verdict, Verdict::Unnamed);
}

#[test]
fn what_shows_without_a_scene_has_no_name_unless_a_direct_test_has_one() {
    let law = Law {
        moved: crate::law::Moved::EventRate,
        covariate: crate::covariates::Covariate::RowParity,
        period_s: None,
        at: vec![0.0, 1.0],
        value: vec![0.1, -0.1],
        error: vec![0.01, 0.01],
        taken: 0.4,
        significance: 16.0,
        nats_per_change: 0.01,
    };
    let integrity = Integrity { laws: vec![law], ..Integrity::default() };
    let alone = answer_with(&integrity, &[road("likelihood", vec![leak(40.0, 0.9)])]);
    assert_eq!((alone.verdict, alone.claims.len()), (Verdict::Unnamed, 0));
    let told = alone.unexplained.unwrap();
    assert_eq!((told.covariate.as_str(), told.equation.as_str()), ("row_parity", "rate of events * (1 + c), c(row_parity) = +10.0 % at 0, -10.0 % at 1"));
    assert!(told.score >= 1.0);
    let hot = Finding {
        id: "hot_pixels",
        parameters: vec![],
        statistic: 9.0,
        threshold: 1.0,
        share: 0.1,
        polarity: "both",
        pixels: vec![3],
        seen: String::new(),
        heldout: None,
    };
    let beside = answer_with(&Integrity { findings: vec![hot], ..integrity }, &[]);
    assert_eq!((beside.verdict, beside.claims[0].id), (Verdict::Named, "hot_pixels"));
}

#[test]
fn what_is_hardly_believed_is_no_name() {
    let refit =
        |belief: f64, second: f64| Road { second: vec![proposal("black_level", "black_level_dn", 2.0, second, 9.0)], ..road("refit", vec![leak(3.0, belief)]) };
    let ids = |answer: &Answer| answer.claims.iter().map(|claim| claim.id).collect::<Vec<_>>();
    let hardly = answer(&[refit(0.15, 0.8)]);
    assert_eq!((hardly.verdict, ids(&hardly)), (Verdict::Unnamed, vec![]));
    assert_eq!(hardly.unexplained.map(|found| (found.covariate, found.hardly)), Some(("time_since_last_event".to_owned(), vec!["leak_events".to_owned()])));
    let random = answer(&[road("refit", Vec::new()), road("synthesis", vec![proposal("threshold_mismatch", "sigma", 40.0, 0.15, 0.02)])]);
    assert_eq!((random.verdict, random.unexplained.map(|found| found.hardly)), (Verdict::Unnamed, Some(vec!["threshold_mismatch".to_owned()])));
    assert_eq!(ids(&answer(&[refit(0.5, 0.1)])), ["leak_events"]);
    assert_eq!(ids(&answer(&[refit(0.5, 0.3)])), ["leak_events", "black_level"]);
}

#[test]
fn what_looks_like_a_direct_finding_is_its_remainder() {
    let finding = Finding {
        id: "event_loss",
        parameters: vec![("fraction", 0.2)],
        statistic: 50.0,
        threshold: 5.0,
        share: 0.2,
        polarity: "both",
        pixels: Vec::new(),
        seen: String::new(),
        heldout: None,
    };
    let integrity = Integrity { findings: vec![finding], ..Integrity::default() };
    let scale = || proposal("threshold_scale", "fraction", 60.0, 0.9, 0.2);
    let found = answer_with(&integrity, &[road("likelihood", vec![scale()]), road("synthesis", vec![scale()])]);
    assert_eq!(found.claims.iter().map(|claim| claim.id).collect::<Vec<_>>(), ["event_loss"]);
    // Something of another kind is named beside, if it is far over its alarm.
    let beside = |score: f64| answer_with(&integrity, &[road("likelihood", vec![leak(score, 0.9)])]).claims.len();
    assert_eq!((beside(2.0), beside(20.0)), (1, 2));
}

#[test]
fn the_refit_leads_and_the_others_speak_of_chance() {
    let refit = |first: f64, second: f64| road(crate::roads::REFIT, vec![leak(4.0, first), asymmetry(3.9, second)]);
    let others = |id: fn(f64, f64) -> Proposal| [road("likelihood", vec![id(5.0, 0.9)]), road("synthesis", vec![id(5.0, 0.9)])];
    let said = |refit: Road, others: [Road; 2]| answer(&[vec![refit], others.to_vec()].concat());
    let sure = said(refit(0.9, 0.02), others(asymmetry));
    assert_eq!((sure.verdict, sure.claims[0].id, sure.claims[0].belief), (Verdict::Named, "leak_events", Some(0.9)));
    let alone = answer(&[refit(0.55, 0.45)]);
    assert_eq!((alone.verdict, alone.claims[0].also_possible.as_slice()), (Verdict::Ambiguous, &["threshold_asymmetry"][..]));
    // What is believed more, and has not passed, is told beside what has.
    let failed = Proposal { passed: false, ..asymmetry(3.9, 0.6) };
    let beside = answer(&[road(crate::roads::REFIT, vec![failed, leak(4.0, 0.3)])]);
    assert_eq!((beside.claims[0].id, beside.claims[0].also_possible.as_slice()), ("leak_events", &["threshold_asymmetry"][..]));
    // Where the refit is silent, others may speak of chance only.
    let silent = || Road { alarm: false, ..road(crate::roads::REFIT, vec![leak(0.5, 0.9)]) };
    assert_eq!(said(silent(), others(leak)).verdict, Verdict::Consistent);
    let noise = |score: f64, probability: f64| proposal("threshold_mismatch", "sigma", score, probability, 0.04);
    assert_eq!(said(silent(), others(noise)).claims[0].id, "threshold_mismatch");
    // A second effect stands beside the first.
    let two = Road { second: vec![asymmetry(1.5, 0.9)], ..road(crate::roads::REFIT, vec![proposal("black_level", "black_level_dn", 5.0, 0.9, 30.0)]) };
    assert_eq!(answer(&[two]).claims.iter().map(|claim| claim.id).collect::<Vec<_>>(), ["black_level", "threshold_asymmetry"]);
}

#[test]
fn all_pixels_name_where_no_refit_does_and_a_second_beside_one_that_does() {
    let gradient = || proposal("threshold_gradient", "fraction", 2.0, 0.9, 0.1);
    let silent = Road { alarm: false, to_first_order: vec![gradient()], ..road(crate::roads::REFIT, Vec::new()) };
    let alone = answer(&[silent]);
    assert_eq!(alone.claims.iter().map(|claim| (claim.id, claim.found_by.clone())).collect::<Vec<_>>(), [("threshold_gradient", vec!["closures".to_owned()])]);
    // A variance needs another road that puts its name first.
    let mismatch = |score: f64| proposal("threshold_mismatch", "sigma", score, 0.5, 0.04);
    let spread = || Road { alarm: false, to_first_order: vec![mismatch(2.0)], ..road(crate::roads::REFIT, Vec::new()) };
    assert_eq!(answer(&[spread()]).verdict, Verdict::Consistent);
    assert_eq!(answer(&[spread(), road("synthesis", vec![mismatch(1.5)])]).claims[0].id, "threshold_mismatch");
    let refit =
        |second: Proposal| Road { second_to_first_order: vec![second], ..road(crate::roads::REFIT, vec![proposal("clock_drift", "rate", 4.0, 0.9, 0.01)]) };
    let said = |road: Road| answer(&[road]).claims.iter().map(|claim| claim.id).collect::<Vec<_>>();
    assert_eq!(said(refit(gradient())), ["clock_drift", "threshold_gradient"]);
    // What the first is taken for is its remainder.
    assert_eq!(said(refit(proposal("clock_offset", "offset", 2.0, 0.9, 1e-3))), ["clock_drift"]);
}
