//! A whole diagnosis of small recordings, with roads that say what they are told.

use super::*;
use crate::testing;
use crate::verdict::Proposal;

fn quiet(case: &Case, roads: &[RoadKind]) -> Diagnosis {
    diagnose(case, &Setting::default(), roads, |_| ()).unwrap()
}

fn clock(value: f64) -> Road {
    let candidate = CANDIDATES.iter().position(|one| one.id == "clock_offset").unwrap();
    let proposal = Proposal { candidate, score: 9.0, probability: 0.9, value, passed: true, ..Proposal::default() };
    Road { name: "likelihood".into(), alarm: true, proposals: vec![proposal], nats_per_event: Some((-2.0, -1.5)), ..Road::default() }
}

#[test]
fn a_named_effect_is_reported_fitted_and_proven() {
    let offset = serde_json::json!({"offset": "-700 us"});
    let effects = [("clock_offset".to_owned(), offset.as_object().unwrap().clone())].into_iter().collect();
    let case = testing::case_with(&effects);
    let found = quiet(&case, &[RoadKind::new("likelihood", |_, _| Ok(clock(-700e-6)))]);
    let report = &found.report;
    assert_eq!(report.verdict, Verdict::Named);
    assert_eq!(report.effects[0].parameters["offset_s"].estimate, -700e-6);
    assert_eq!(report.sensor_fitted.as_deref(), Some("sensor.fitted.toml"));
    assert!(found.fitted.unwrap().effects.contains_key("clock_offset"));
    let psnr = report.fit.heldout_frame_psnr_db.unwrap();
    assert!(psnr.after > psnr.before, "{psnr:?}");
    let ks = report.fit.calibration_ks.unwrap();
    assert!(ks.after < 0.5 * ks.before, "{ks:?}");
    assert_eq!(report.provenance.stages, ["integrity", "likelihood"]);
}

#[test]
fn a_sound_recording_is_consistent_and_says_what_was_not_tested() {
    let found = quiet(&testing::case(), &[]);
    assert_eq!(found.report.verdict, Verdict::Consistent);
    assert!(found.report.effects.is_empty() && found.fitted.is_none());
    assert!(found.report.fit.calibration_ks.is_none() && found.comparison.unwrap().after().is_none());
    assert!(found.report.not_testable.iter().any(|one| one.id == "second_pole"));
    assert!(found.report.not_testable.iter().all(|one| one.id != "hot_rows"));
}

#[test]
fn a_road_that_fails_is_told_and_the_others_go_on() {
    let roads = [RoadKind::new("synthesis", |_, _| Err("no light".into())), RoadKind::new("likelihood", |_, _| Ok(clock(1e-3)))];
    let found = quiet(&testing::case(), &roads);
    assert_eq!(found.failed, ["synthesis: no light"]);
    assert_eq!(found.report.provenance.stages, ["integrity", "likelihood"]);
}

#[test]
fn silence_beside_a_test_that_could_not_be_made_is_not_consistency() {
    let silent = || RoadKind::new("likelihood", |_, _| Ok(Road { name: "likelihood".into(), ..Road::default() }));
    let failing = RoadKind::new("synthesis", |_, _| Err("too few events".into()));
    assert_eq!(quiet(&testing::case(), &[silent()]).report.verdict, Verdict::Consistent);
    let found = quiet(&testing::case(), &[failing, silent()]);
    assert_eq!(found.report.verdict, Verdict::Insufficient);
    assert!(found.report.summary.contains("too few events"), "{}", found.report.summary);
}

#[test]
fn events_alone_are_insufficient_unless_a_direct_test_speaks() {
    let alone = Case { frames: None, ..testing::case() };
    let found = quiet(&alone, &[RoadKind::new("likelihood", |_, _| Ok(clock(1e-3)))]);
    assert_eq!(found.report.verdict, Verdict::Insufficient);
    assert!(found.report.summary.contains("0 frames"), "{}", found.report.summary);
}

#[test]
fn the_same_recording_gives_the_same_bytes() {
    let run = || quiet(&testing::case(), &[RoadKind::new("likelihood", |_, _| Ok(clock(1e-3)))]).report.to_json().unwrap();
    assert_eq!(run(), run());
}

#[test]
fn an_effect_that_the_description_states_is_no_finding() {
    let step = serde_json::json!({"step": "130 us"});
    let effects: crate::record::Described = [("timestamp_quantization".to_owned(), step.as_object().unwrap().clone())].into_iter().collect();
    let mut case = testing::case_with(&effects);
    // The stated resolution is that of the recorder: 1 ns.
    assert_eq!(quiet(&case, &[]).integrity.findings.iter().map(|finding| finding.id).collect::<Vec<_>>(), ["timestamp_quantization"]);
    case.sensor.effects = effects;
    assert!(quiet(&case, &[]).integrity.findings.is_empty());
}
