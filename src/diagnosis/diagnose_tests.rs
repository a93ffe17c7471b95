//! A whole diagnosis of small recordings, with something decided that is given beforehand.

use super::*;
use crate::stages::EffectProposal;
use crate::testing;

fn diagnosed(case: &Case, proposed: DecisionOutcome) -> Diagnosis {
    confirm(case, &ConfirmSetting::default(), check(case).unwrap(), proposed).unwrap()
}

fn clock(value: f64) -> DecisionOutcome {
    let candidate = CANDIDATES.iter().position(|one| one.id == "clock_offset").unwrap();
    let proposal = EffectProposal {
        candidate,
        score: 1.1,
        probability: 0.9,
        value,
        passed: true,
        heldout_nats_per_event: Some(0.5),
        ks: Some(0.02),
        ..EffectProposal::default()
    };
    DecisionOutcome::Decided(Box::new(SceneDecision {
        name: "picture".into(),
        detected: true,
        proposals: vec![proposal],
        nats_per_event: Some(-2.0),
        ks: Some(0.2),
        ..SceneDecision::default()
    }))
}

#[test]
fn a_named_effect_is_reported_fitted_and_proven() {
    let offset = serde_json::json!({"offset": "-700 us"});
    let effects = [("clock_offset".to_owned(), offset.as_object().unwrap().clone())].into_iter().collect();
    let case = testing::case_with(&effects);
    let found = diagnosed(&case, clock(-700e-6));
    let report = &found.report;
    assert_eq!(report.verdict, Verdict::Named);
    assert_eq!(report.effects[0].parameters["offset_s"].estimate, -700e-6);
    assert_eq!(report.sensor_fitted.as_deref(), Some("sensor.fitted.toml"));
    assert!(found.fitted.unwrap().effects.contains_key("clock_offset"));
    let psnr = report.fit.heldout_frame_psnr_db.unwrap();
    assert!(psnr.after > psnr.before, "{psnr:?}");
    assert_eq!(report.fit.heldout_nats_per_event, Some(BeforeAfter { before: -2.0, after: -1.5 }));
    assert_eq!(report.fit.calibration_ks, Some(BeforeAfter { before: 0.2, after: 0.02 }));
    assert_eq!(report.provenance.stages, ["integrity", "picture"]);
}

#[test]
fn what_predicts_held_out_frames_worse_is_withdrawn() {
    let found = diagnosed(&testing::case(), clock(3e-3));
    assert_eq!(
        (found.report.verdict, found.withdrawn),
        (Verdict::Consistent, vec!["clock_offset".to_owned()])
    );
}

#[test]
fn frames_are_no_evidence_of_what_is_random() {
    let DecisionOutcome::Decided(decided) = clock(3e-3) else { panic!("something is decided") };
    let candidate = CANDIDATES.iter().position(|one| one.id == "threshold_mismatch").unwrap();
    // Noise that is so wide predicts frames worse, and what it is about is not known of any pixel.
    let mismatch = EffectProposal { candidate, value: 0.3, ..decided.proposals[0].clone() };
    let both = SceneDecision { proposals: vec![mismatch], second: decided.proposals.clone(), ..*decided };
    let found = diagnosed(&testing::case(), DecisionOutcome::Decided(Box::new(both)));
    assert_eq!(found.report.effects[0].id, "threshold_mismatch");
    assert_eq!((found.report.effects.len(), found.withdrawn), (1, vec!["clock_offset".to_owned()]));
}

#[test]
fn a_nominal_recording_is_consistent_and_untested_effects_are_listed() {
    let found = diagnosed(&testing::case(), DecisionOutcome::NotAsked);
    assert_eq!(found.report.verdict, Verdict::Consistent);
    assert!(found.report.effects.is_empty() && found.fitted.is_none());
    assert!(found.report.fit.calibration_ks.is_none());
    assert!(found.report.not_testable.iter().any(|one| one.id == "second_pole"));
    assert!(found.report.not_testable.iter().all(|one| one.id != "hot_rows"));
}

#[test]
fn finding_nothing_where_the_scene_is_no_evidence_is_not_consistency() {
    let found = diagnosed(&testing::case(), DecisionOutcome::Nothing("too few events".into()));
    assert_eq!(found.report.verdict, Verdict::Insufficient);
    assert!(found.report.summary.contains("too few events"), "{}", found.report.summary);
    assert!(found.report.not_testable.iter().all(|one| one.why == "too few events"));
    let silent = DecisionOutcome::Decided(Box::new(SceneDecision {
        name: "picture".into(),
        ..SceneDecision::default()
    }));
    assert_eq!(diagnosed(&testing::case(), silent).report.verdict, Verdict::Consistent);
}

#[test]
fn finding_nothing_counts_where_an_effect_would_have_shown_at_its_usual_size() {
    let limit = |id: &str, minimal_detectable: f64| MinimumDetectable {
        id: id.into(),
        parameter: "offset_s".into(),
        minimal_detectable,
        usual: Some(5e-4),
        unit: "s".into(),
        ..MinimumDetectable::default()
    };
    let diagnosed_with = |detectability: Vec<MinimumDetectable>| {
        let other_scene = "the picture shows nothing".into();
        let silent =
            SceneDecision { name: "pixels".into(), other_scene, detectability, ..SceneDecision::default() };
        diagnosed(&testing::case(), DecisionOutcome::Decided(Box::new(silent))).report
    };
    let sees = diagnosed_with(vec![limit("clock_offset", 2e-4), limit("second_pole", 1e-3)]);
    assert_eq!(sees.verdict, Verdict::Consistent);
    assert!(sees.summary.contains("1 of 2 effects would be seen at their usual size"), "{}", sees.summary);
    assert!(sees.summary.contains("0 % of the events; the picture shows nothing)"), "{}", sees.summary);
    let blind = diagnosed_with(vec![limit("clock_offset", 6e-4), limit("second_pole", 1e-3)]);
    assert_eq!(blind.verdict, Verdict::Insufficient);
    assert!(blind.summary.contains("clock_offset (offset_s) from 600 us on, usual is 500 us"));
    // Which would, and from what size on.
    assert_eq!(blind.detectability.len(), 2);
}

#[test]
fn events_alone_are_insufficient_unless_a_direct_test_speaks() {
    let alone = Case { frames: None, ..testing::case() };
    let found = diagnosed(&alone, DecisionOutcome::NotAsked);
    assert_eq!(found.report.verdict, Verdict::Insufficient);
    assert!(found.report.summary.contains("0 frames"), "{}", found.report.summary);
}

#[test]
fn the_same_recording_gives_the_same_bytes() {
    let run = || diagnosed(&testing::case(), clock(1e-3)).report.to_json().unwrap();
    assert_eq!(run(), run());
}

#[test]
fn an_effect_that_the_description_states_is_no_finding() {
    let step = serde_json::json!({"step": "130 us"});
    let effects: crate::record::EffectParameters =
        [("timestamp_quantization".to_owned(), step.as_object().unwrap().clone())].into_iter().collect();
    let mut case = testing::case_with(&effects);
    // The stated resolution is that of the recorder: 1 ns.
    assert_eq!(
        diagnosed(&case, DecisionOutcome::NotAsked)
            .integrity
            .findings
            .iter()
            .map(|finding| finding.id)
            .collect::<Vec<_>>(),
        ["timestamp_quantization"]
    );
    case.sensor.effects = effects;
    assert!(diagnosed(&case, DecisionOutcome::NotAsked).integrity.findings.is_empty());
}
