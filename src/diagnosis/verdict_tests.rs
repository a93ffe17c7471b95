//! What is claimed when direct tests and a scene agree, differ, or stand alone.

use super::*;
use crate::dependence::Dependence;
use crate::testing;

fn proposal(id: &str, parameter: &str, score: f64, probability: f64, value: f64) -> EffectProposal {
    let candidate = CANDIDATES
        .iter()
        .position(|candidate| candidate.id == id && candidate.parameter == parameter)
        .unwrap();
    EffectProposal { candidate, score, probability, value, passed: score >= 1.0, ..EffectProposal::default() }
}

fn decided(proposals: Vec<EffectProposal>) -> SceneDecision {
    SceneDecision {
        name: "picture".into(),
        detected: proposals.iter().any(|proposal| proposal.passed),
        proposals,
        ..SceneDecision::default()
    }
}

fn joined_findings(decided: &SceneDecision) -> JoinedFindings {
    answer_with(&Integrity::default(), Some(decided))
}

fn answer_with(integrity: &Integrity, decided: Option<&SceneDecision>) -> JoinedFindings {
    let case = testing::case();
    let nominal = case.nominal().unwrap();
    verdict(&case, &nominal, integrity, decided)
}

fn ids(answer: &JoinedFindings) -> Vec<&str> {
    answer.findings.iter().map(|finding| &finding.id[..]).collect()
}

fn leak(score: f64, probability: f64) -> EffectProposal {
    proposal("leak_events", "rate", score, probability, 8.0)
}

fn asymmetry(score: f64, probability: f64) -> EffectProposal {
    proposal("threshold_asymmetry", "fraction", score, probability, 0.1)
}

#[test]
fn the_most_probable_is_named_with_what_is_nearly_as_probable() {
    let sure = joined_findings(&decided(vec![leak(1.1, 0.9), asymmetry(1.1, 0.02)]));
    assert_eq!(
        (sure.verdict, ids(&sure), sure.findings[0].evidence.posterior),
        (Verdict::Named, vec!["leak_events"], Some(0.9))
    );
    assert_eq!(sure.findings[0].evidence.found_by, ["picture"]);
    let unsure = joined_findings(&decided(vec![leak(1.1, 0.55), asymmetry(1.1, 0.45)]));
    assert_eq!((unsure.verdict, ids(&unsure)), (Verdict::Ambiguous, vec!["leak_events"]));
    assert_eq!(unsure.findings[0].also_possible, ["threshold_asymmetry"]);
}

#[test]
fn what_is_certain_but_immaterial_is_not_claimed() {
    let tiny = |value: f64| {
        joined_findings(&decided(vec![proposal("time_constant", "tau_0", 1.1, 1.0, value)])).verdict
    };
    // The description states 30 us; a microsecond more is nothing.
    assert_eq!(tiny(31e-6), Verdict::Consistent);
    assert_eq!(tiny(60e-6), Verdict::Named);
}

#[test]
fn a_second_effect_stands_behind_the_first_and_another_number_of_it_is_added() {
    let with =
        |second: EffectProposal| SceneDecision { second: vec![second], ..decided(vec![leak(1.05, 0.9)]) };
    assert_eq!(ids(&joined_findings(&with(asymmetry(1.6, 0.9)))), ["leak_events", "threshold_asymmetry"]);
    assert_eq!(ids(&joined_findings(&with(asymmetry(0.9, 0.9)))), ["leak_events"]);
    let pole = |parameter: &str, value: f64| proposal("time_constant", parameter, 1.1, 0.9, value);
    let both = joined_findings(&SceneDecision {
        second: vec![pole("alpha", 0.05)],
        ..decided(vec![pole("tau_0", 90e-6)])
    });
    assert_eq!((ids(&both), both.findings[0].values.len()), (vec!["time_constant"], 2));
}

#[test]
fn a_direct_finding_is_named_and_a_stronger_term_stands_before_it() {
    let finding = Departure {
        id: "hot_pixels",
        parameters: vec![("fraction", 0.002), ("rate", 900.0)],
        statistic: 16.0,
        threshold: 8.0,
        share: 0.002,
        polarity: "on",
        pixels: vec![3],
        seen: String::new(),
        heldout: None,
        ci95: Vec::new(),
    };
    let integrity = Integrity { findings: vec![finding], ..Integrity::default() };
    let alone = answer_with(&integrity, None);
    assert_eq!((alone.verdict, alone.findings[0].id.as_str()), (Verdict::Named, "hot_pixels"));
    let joined = answer_with(&integrity, Some(&decided(vec![leak(40.0, 0.9)])));
    assert_eq!(ids(&joined), ["leak_events", "hot_pixels"]);
}

#[test]
fn too_little_is_consistent_and_something_unexplained_has_no_name() {
    assert_eq!(joined_findings(&decided(vec![leak(0.7, 0.9)])).verdict, Verdict::Consistent);
    let unexplained = Unexplained { covariate: "frame_phase".into(), score: 3.0, ..Unexplained::default() };
    let found = joined_findings(&SceneDecision {
        detected: true,
        unexplained: Some(unexplained),
        ..decided(Vec::new())
    });
    assert!(found.findings.is_empty());
    assert_eq!(found.unexplained.map(|found| found.covariate), Some("frame_phase".to_owned()));
    assert_eq!(found.verdict, Verdict::Unnamed);
}

#[test]
fn what_shows_without_a_scene_has_no_name_unless_a_direct_test_has_one() {
    let dependence = Dependence {
        at: vec![0.0, 1.0],
        value: vec![0.1, -0.1],
        error: vec![0.01, 0.01],
        taken: 0.4,
        significance: 16.0,
        nats_per_event: 0.01,
        ..Dependence::empty_over(
            crate::covariates::Covariate::RowParity,
            crate::dependence::AffectedQuantity::EventRate,
        )
    };
    let integrity = Integrity { dependences: vec![dependence], ..Integrity::default() };
    let alone = answer_with(&integrity, Some(&decided(vec![leak(40.0, 0.9)])));
    assert_eq!((alone.verdict, alone.findings.len()), (Verdict::Unnamed, 0));
    let unexplained = alone.unexplained.unwrap();
    assert_eq!(
        (unexplained.covariate.as_str(), unexplained.equation.as_str()),
        ("row_parity", "rate of events * (1 + c), c(row_parity) = +10.0 % at 0, -10.0 % at 1")
    );
    assert!(unexplained.score >= 1.0);
    let hot = Departure {
        id: "hot_pixels",
        parameters: vec![],
        statistic: 9.0,
        threshold: 1.0,
        share: 0.1,
        polarity: "both",
        pixels: vec![3],
        seen: String::new(),
        heldout: None,
        ci95: Vec::new(),
    };
    let both = answer_with(&Integrity { findings: vec![hot], ..integrity }, None);
    assert_eq!((both.verdict, both.findings[0].id.as_str()), (Verdict::Named, "hot_pixels"));
}

#[test]
fn what_looks_like_a_direct_finding_is_its_remainder() {
    let finding = Departure {
        id: "event_loss",
        parameters: vec![("fraction", 0.2)],
        statistic: 50.0,
        threshold: 5.0,
        share: 0.2,
        polarity: "both",
        pixels: Vec::new(),
        seen: String::new(),
        heldout: None,
        ci95: Vec::new(),
    };
    let integrity = Integrity { findings: vec![finding], ..Integrity::default() };
    let scale = proposal("threshold_scale", "fraction", 60.0, 0.9, 0.2);
    assert_eq!(ids(&answer_with(&integrity, Some(&decided(vec![scale])))), ["event_loss"]);
    // Something of another kind is named as well.
    assert_eq!(
        ids(&answer_with(&integrity, Some(&decided(vec![leak(1.1, 0.9)])))),
        ["event_loss", "leak_events"]
    );
}
