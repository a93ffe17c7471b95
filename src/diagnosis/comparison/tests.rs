//! Small recordings with an effect, and with the right and a wrong one put on.

use super::*;
use crate::diagnose::{RoadKind, Setting, diagnose};
use crate::first_order::Biases;
use crate::record::Described as Effects;
use crate::refit::RefitSetting;
use crate::roads::from_refit;
use crate::search::search;
use crate::testing;
use photocurrent_core::Sensor;
use serde_json::json;

fn recorded(effects: serde_json::Value) -> Case {
    let effects: Effects = effects.as_object().unwrap().iter().map(|(id, of)| (id.clone(), of.as_object().unwrap().clone())).collect();
    testing::case_with(&effects)
}

fn claim(id: &'static str, parameter: &str, value: f64) -> Claim {
    let candidate = CANDIDATES.iter().position(|one| one.id == id && one.parameter == parameter).unwrap();
    let values = vec![(candidate, value, None)];
    Claim {
        id,
        also_possible: Vec::new(),
        values,
        score: 2.0,
        belief: None,
        found_by: Vec::new(),
        heldout_nats: None,
        heldout_nats_per_event: None,
        finding: None,
    }
}

fn compared(case: &Case, claims: &[Claim]) -> Comparison {
    let nominal = case.nominal().unwrap();
    Ground::new(case, &nominal, &Scales::of(case, &nominal)).unwrap().unwrap().compare(claims).unwrap()
}

fn ks(step: &Step) -> f64 {
    step.calibration.as_ref().unwrap().ks
}

#[test]
fn the_right_effect_takes_mismatch_away_and_a_wrong_one_does_not() {
    let case = recorded(json!({"leak_events": {"rate": "25 Hz"}}));
    let right = compared(&case, &[claim("leak_events", "rate", 25.0)]);
    let (before, after) = (right.before(), right.after().unwrap());
    let gain = right.gain(0, 1);
    assert!(gain.share > 0.4 && gain.share_ci95[0] > 0.2, "{gain:?}");
    assert!(gain.nats_ci95[0] > 0.0 && after.nats_per_event() > before.nats_per_event(), "{gain:?}");
    assert!(ks(after) < 0.3 * ks(before), "{} {}", ks(before), ks(after));
    // Frames are foretold better, although solve/pixel cannot undo a leak.
    assert!(after.kept_psnr_db.unwrap() > before.kept_psnr_db.unwrap() + 1.0, "{:?} {:?}", before.kept_psnr_db, after.kept_psnr_db);
    let wrong = compared(&case, &[claim("clock_offset", "offset", 400e-6)]);
    assert!(wrong.gain(0, 1).share < 0.5 * gain.share, "{:?}", wrong.gain(0, 1));
    assert!(wrong.after().unwrap().kept_psnr_db < before.kept_psnr_db);
    assert!(ks(wrong.after().unwrap()) > 0.6 * ks(before), "{}", ks(wrong.after().unwrap()));
    // However long the pixel waited, as fitted its events cost less.
    let cost = &right.dependences[0];
    assert_eq!((cost.quantity, cost.covariate.name()), (dependence::Quantity::Cost, "time_since_last_event"));
    assert!(cost.before.len() == 10 && cost.before.iter().zip(&cost.after).all(|(before, after)| after.value < before.value), "{cost:?}");
    // Without a claim the description as stated stands alone.
    let alone = compared(&case, &[]);
    assert!(alone.after().is_none() && alone.steps.len() == 1 && alone.dependences.is_empty());
    assert_eq!(alone.before().blocks, before.blocks);
}

#[test]
fn parts_add_up_to_the_whole() {
    let case = recorded(json!({"leak_events": {"rate": "25 Hz"}}));
    let found = compared(&case, &[claim("leak_events", "rate", 25.0)]);
    for step in &found.steps {
        let all = step.all();
        let over_time = step.by_time.iter().fold((0.0, 0.0), |sum, bin| (sum.0 + bin.0, sum.1 + bin.1));
        assert!((over_time.0 - all.events).abs() < 1e-9 * all.events && over_time.1 == all.count, "{over_time:?} {all:?}");
        let by_pixel: f64 = step.by_pixel.iter().map(|of| of.events).sum();
        assert!((by_pixel - all.events).abs() < 1e-9 * all.events);
    }
    let recorded: usize = (0..case.extent.pixels()).map(|pixel| case.events.of(pixel).len()).sum();
    assert_eq!(found.before().all().recorded, recorded as f64);
}

#[test]
fn a_gain_is_a_share_of_the_mismatch_an_event_and_its_interval_is_from_block_to_block() {
    let mut found = compared(&recorded(json!({})), &[claim("clock_offset", "offset", 400e-6)]);
    let mut put = |step: usize, blocks: &[(f64, f64)]| {
        let block = |&(events, nats): &(f64, f64)| Mismatch { events, count: 10.0, nats, recorded: 10.0, ..Mismatch::default() };
        found.steps[step].blocks = blocks.iter().map(block).collect();
    };
    put(0, &[(4.0, -5.0), (4.0, -5.0), (4.0, -5.0), (4.0, -5.0)]);
    put(1, &[(2.0, -4.0), (2.0, -4.0), (2.0, -4.0), (2.0, -4.0)]);
    let alike = found.gain(0, 1);
    assert_eq!((alike.share, alike.nats, alike.nats_per_event), (0.5, 4.0, 0.1));
    // Each block says the same: no interval.
    assert!((alike.share_ci95[1] - alike.share_ci95[0]).abs() < 1e-12 && (alike.nats_ci95[1] - alike.nats_ci95[0]).abs() < 1e-12);
    let mut put = |blocks: &[f64]| found.steps[1].blocks.iter_mut().zip(blocks).for_each(|(block, nats)| block.nats = *nats);
    put(&[-1.0, -5.0, -5.0, -5.0]);
    // Gains of 4, 0, 0 and 0: their sum has the standard error of four draws, twice the standard deviation of 2.
    let apart = found.gain(0, 1);
    assert!((apart.nats - 4.0).abs() < 1e-12 && (apart.nats_ci95[1] - 4.0 - 1.96 * 4.0).abs() < 1e-9, "{apart:?}");
}

#[test]
fn a_random_effect_shows_in_the_calibration_alone() {
    let case = recorded(json!({"event_loss": {"fraction": 0.35}}));
    let found = compared(&case, &[claim("event_loss", "fraction", 0.35)]);
    let (before, after) = (found.before(), found.after().unwrap());
    assert!(after.is_random && after.blocks == before.blocks && found.gain(0, 1).share == 0.0);
    assert!(ks(after) < 0.5 * ks(before), "{} {}", ks(before), ks(after));
}

#[test]
fn a_sound_recording_is_calibrated_and_threads_change_nothing() {
    let case = recorded(json!({}));
    let with = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| compared(&case, &[]));
    let (one, two) = (with(1), with(2));
    assert_eq!(one.before().blocks, two.before().blocks);
    assert_eq!(one.before().calibration, two.before().calibration);
    assert!(ks(one.before()) < 0.04, "{}", ks(one.before()));
}

#[test]
fn what_a_search_finds_gives_back_the_light() {
    let case = recorded(json!({"threshold_scale": {"fraction": 0.3}}));
    let run = |case: &Case, _: &Setting| {
        let nominal = case.nominal().unwrap();
        let few = RefitSetting { followed: 4, finished: 2, ..RefitSetting::default() };
        let setting = SearchSetting { zones: (3, 2), side: 4, refit: few, ..SearchSetting::default() };
        let scales = Scales::of(case, &nominal);
        let value = |candidate: usize, strength: f64| CANDIDATES[candidate].value(strength, &scales, &nominal);
        Ok(from_refit(&search(case, &nominal, &scales, &setting)?, &Biases(Vec::new()), &value))
    };
    let found = diagnose(&case, &Setting::default(), &[RoadKind::new("refit", run)], |_| ()).unwrap();
    assert_eq!(found.report.effects[0].id, "threshold_scale", "{}", found.report.summary);
    let (ks, psnr) = (found.report.fit.calibration_ks.unwrap(), found.report.fit.heldout_frame_psnr_db.unwrap());
    assert!(ks.after < 0.5 * ks.before && psnr.after > psnr.before, "{ks:?} {psnr:?}");
    let gain = found.comparison.unwrap().gain(0, 1);
    assert!(gain.share_ci95[0] > 0.3, "{gain:?}");
    // The true light is known here: root mean square error of the log light that the solver makes of the recording.
    let truth = testing::scene(&case);
    let error = |sensor: &Sensor| {
        let light = Scene::estimate(&case, &case.described(sensor).unwrap(), &Sample::all(&case, 4), &SceneSetting::default());
        let squares = (0..case.extent.pixels()).flat_map(|n| (4..52).map(move |ms| (n, ms * 1_000_000))).map(|(n, t)| {
            let off = light.at(n, t) - truth.at(n, t);
            off * off
        });
        libm::sqrt(squares.sum::<f64>() / (48 * case.extent.pixels()) as f64)
    };
    let (stated, fitted) = (error(&case.sensor), error(&found.fitted.unwrap()));
    assert!(fitted < 0.6 * stated, "{fitted} as fitted, {stated} as stated");
}

#[test]
fn blocks_stand_apart_from_those_of_the_refit() {
    let small = testing::case();
    let (sample, is_apart) = pixels(&small).unwrap();
    assert!(!is_apart && sample.len() == small.extent.pixels());
    let taken = Sample::blocks(&small, (2, 2), 2, 0, (0.0, 1e9));
    let apart = Sample::blocks_apart(&small, (2, 2), 2, 0, (0.0, 1e9), &taken);
    assert_eq!((taken.len(), apart.len()), (16, 16));
    assert!(apart.pixels.iter().all(|pixel| taken.place(*pixel as usize).is_none()));
}
