//! Tests of dependences.

use super::super::catalogue;
use super::super::simulated::{MS, SITE, Samples, ideal_pixel, intervals_s, recorded, recorded_at};
use super::super::testing::{described, site};
use super::*;
use serde_json::{Value, json};

fn refused(given: Value) -> String {
    let kind = catalogue().into_iter().find(|kind| kind.decl.id == "dependence").unwrap();
    kind.read(given.as_object().unwrap()).err().expect("refused")
}

#[test]
fn a_curve_is_linear_between_knots_constant_beyond_and_goes_round_over_a_phase() {
    let curve = |is_round| Knots { at: vec![0.2, 0.6], by: vec![1.0, 3.0], is_round };
    for (x, plain, round) in
        [(0.0, 1.0, 2.0), (0.2, 1.0, 1.0), (0.3, 1.5, 1.5), (0.6, 3.0, 3.0), (0.9, 3.0, 2.0)]
    {
        // Round: from 3 at 0.6 to 1 at 1.2, so 2 at 0.9 and 5/3 at 1.0.
        let round = if x == 0.0 { 5.0 / 3.0 } else { round };
        assert!((curve(false).value(x) - plain).abs() < 1e-12, "{x}");
        assert!((curve(true).value(x) - round).abs() < 1e-12, "{x}: {}", curve(true).value(x));
    }
    let one = Knots { at: vec![0.5], by: vec![0.1], is_round: true };
    assert!([0.0, 0.5, 0.9].iter().all(|x| (one.value(*x) - 0.1).abs() < 1e-12));
}

#[test]
fn thresholds_of_odd_rows_differ_and_the_pace_on_a_ramp_with_them() {
    let ramp = Samples::of_log(200 * MS, |t| -1.0 + 20.0 * t);
    let given = json!({ "moves": "threshold_on", "over": "row_parity", "at": [0, 1], "by": [0.0, 0.3] });
    for (y, step) in [(4, 0.2), (5, 0.26)] {
        let effects = vec![described("dependence", given.clone())];
        let events = recorded_at(&site(3, y), ideal_pixel(), effects, &ramp, 200 * MS);
        assert!(intervals_s(&events).iter().all(|interval| (interval - step / 20.0).abs() < 1e-6), "{y}");
    }
    let down = Samples::of_log(200 * MS, |t| 3.0 - 20.0 * t);
    let events = recorded(ideal_pixel(), vec![described("dependence", given)], &down, 200 * MS);
    assert!(intervals_s(&events).iter().all(|interval| (interval - 0.01).abs() < 1e-6));
}

#[test]
fn a_threshold_that_follows_light_is_that_of_the_light_when_the_last_event_left() {
    // log i grows from 0; thresholds 0.2 x (1 + 0.1 log i) step from event to event.
    let ramp = Samples::of_log(300 * MS, |t| 10.0 * t);
    let given = json!({ "moves": "threshold", "over": "photocurrent", "at": [0, 10], "by": [0.0, 1.0] });
    let events = recorded(ideal_pixel(), vec![described("dependence", given)], &ramp, 300 * MS);
    let mut log_light = 0.0;
    assert!(events.len() > 8);
    for event in &events {
        log_light += 0.2 * (1.0 + 0.1 * log_light);
        assert!((10.0 * event.t_in_ns as f64 * 1e-9 - log_light).abs() < 2e-5, "{log_light}");
    }
}

#[test]
fn the_same_polarity_again_needs_another_threshold() {
    // Up by 1.0 and down again: the first OFF event follows an ON.
    let light = Samples::of_log(100 * MS, |t| if t < 0.05 { 20.0 * t } else { 2.0 - 20.0 * t });
    let given = json!({ "moves": "threshold", "over": "previous_polarity", "at": [-1, 1], "by": [0.5, 0.0] });
    let events = recorded(ideal_pixel(), vec![described("dependence", given)], &light, 100 * MS);
    let turn = events.iter().position(|event| event.polarity < 0).unwrap();
    let level = |t_ns: i64| {
        let t = t_ns as f64 * 1e-9;
        if t < 0.05 { 20.0 * t } else { 2.0 - 20.0 * t }
    };
    let steps: Vec<f64> =
        events.windows(2).map(|pair| level(pair[1].t_in_ns) - level(pair[0].t_in_ns)).collect();
    assert!((steps[turn - 1] + 0.3).abs() < 1e-4, "{}", steps[turn - 1]);
    assert!((steps[turn - 2] - 0.2).abs() < 1e-4 && (steps[turn] + 0.2).abs() < 1e-4);
}

#[test]
fn a_formula_is_the_curve_of_many_knots() {
    let sine = |x: f64| {
        0.05 + 0.1 * libm::sin(core::f64::consts::TAU * x) - 0.2 * libm::cos(core::f64::consts::TAU * x)
    };
    let square = |x: f64| -0.02 + 0.3 * x * x;
    let many: Vec<f64> = (0..1000).map(|k| f64::from(k) / 1000.0).collect();
    for (over, formula, of) in [
        ("ac_phase", json!({ "form": "sine", "by": [0.05, 0.1, -0.2] }), &sine as &dyn Fn(f64) -> f64),
        ("radius", json!({ "form": "power", "shape": 2.0, "by": [-0.02, 0.3] }), &square),
    ] {
        let effect = |more: Value| {
            let mut given = json!({ "moves": "threshold", "over": over });
            more.as_object().unwrap().iter().for_each(|(key, value)| given[key] = value.clone());
            if over == "ac_phase" {
                given["period"] = json!("10 ms");
            }
            described("dependence", given)
        };
        let by: Vec<f64> = many.iter().map(|x| of(*x)).collect();
        let [formula, curve] = [formula, json!({ "at": many, "by": by })].map(effect);
        for t_reset_ns in [0, 1_234_567, 27_100_000] {
            let threshold = |effect: &dyn Effect| {
                let mut thresholds = Thresholds { on: 0.2, off: 0.2 };
                let history = History::default();
                effect.thresholds(&SITE, &history, &mut Random::new(1, &[]), t_reset_ns, &mut thresholds);
                thresholds.on
            };
            assert!((threshold(&*formula) - threshold(&*curve)).abs() < 1e-6, "{over} {t_reset_ns}");
        }
    }
    // What has no value differs in nothing.
    let light = json!({ "moves": "threshold", "over": "row", "form": "logarithm", "by": [0.0, 0.1] });
    let mut thresholds = Thresholds { on: 0.2, off: 0.2 };
    let at = (&site(3, 0), &History::default());
    described("dependence", light).thresholds(at.0, at.1, &mut Random::new(1, &[]), 0, &mut thresholds);
    assert_eq!(thresholds.on, 0.2);
}

#[test]
fn stamps_are_late_by_the_curve_and_both_of_an_event_alike() {
    let given = json!({
        "moves": "delay", "over": "ac_phase", "period": "10 ms",
        "at": [0.25, 0.75], "by": ["0 us", "80 us"]
    });
    let effect = described("dependence", given);
    for (t_ns, late_ns) in [(2_500_000, 0), (5_000_000, 40_000), (17_500_000, 80_000), (20_000_000, 40_000)] {
        let mut event = PixelEvent { t_in_ns: t_ns, t_off_ns: t_ns + 5_000, polarity: 1 };
        effect.stamp(&SITE, &mut Random::new(1, &[]), &mut event);
        assert_eq!((event.t_in_ns - t_ns, event.t_off_ns - event.t_in_ns), (late_ns, 5_000));
    }
}

#[test]
fn a_leak_and_a_frame_signal_follow_the_place() {
    let leak = json!({ "moves": "leak", "over": "column", "at": [0, 15], "by": ["0 Hz", "30 Hz"] });
    let stated = Thresholds { on: 0.2, off: 0.25 };
    // Column 3 of 16: 6 Hz of ON thresholds.
    let found = described("dependence", leak).leak(&SITE, &stated);
    assert!((found.constant_per_s - 6.0 * 0.2).abs() < 1e-12);
    let signal = json!({ "moves": "frame_signal", "over": "radius", "at": [0, 1], "by": [0.0, -0.4] });
    let reading =
        Reading { frame: 0, previous_charge: 0.0, gain: 1.0, black_level: 0.0, saturation: f64::INFINITY };
    let charge = described("dependence", signal).charge(&SITE, &reading, 10.0);
    assert!((charge - 10.0 * (1.0 - 0.4 * SITE.radius())).abs() < 1e-12);
}

#[test]
fn events_are_lost_by_the_stated_share_and_only_there() {
    let given = json!({ "moves": "loss", "over": "polarity", "at": [-1, 1], "by": [0.3, 0.0] });
    let effect = described("dependence", given);
    let mut random = Random::new(5, &[]);
    let mut lost = [0; 2];
    for t in 0..20_000 {
        let polarity = if t % 2 == 0 { 1 } else { -1 };
        let event = PixelEvent { t_in_ns: t, t_off_ns: t, polarity };
        lost[usize::from(polarity < 0)] +=
            usize::from(!effect.keeps(&SITE, &History::default(), &mut random, &event));
    }
    // Five standard deviations of 10,000 draws at 0.3.
    assert!(lost[0] == 0 && (f64::from(lost[1] as u32) - 3000.0).abs() < 230.0, "{lost:?}");
}

/// Light whose logarithm falls from `height` by `slope_per_s`, and stands before.
fn ramp(slope_per_s: f64) -> Samples {
    Samples::of_log(200 * MS, move |t| slope_per_s * t)
}

#[test]
fn a_threshold_that_settles_while_the_pixel_waits_is_that_of_the_crossing() {
    // theta(w) = 0.2 (1 + 0.5 exp(-w / 5 ms)) meets a ramp of 20 ln/s at the root of 20 w = theta(w).
    let given = json!({
        "moves": "threshold", "over": "time_since_last_event",
        "form": "relaxation", "shape": 5e-3, "by": [0.0, 0.5]
    });
    let root = |slope: f64| {
        let (mut low, mut high) = (0.0_f64, 0.1);
        for _ in 0..60 {
            let w = 0.5 * (low + high);
            let is_below = slope * w < 0.2 * (1.0 + 0.5 * libm::exp(-w / 5e-3));
            (low, high) = if is_below { (w, high) } else { (low, w) };
        }
        low
    };
    for slope in [20.0, 60.0, 5.0] {
        let events =
            recorded(ideal_pixel(), vec![described("dependence", given.clone())], &ramp(slope), 200 * MS);
        let intervals = intervals_s(&events);
        assert!(intervals.len() >= 3);
        // The curve is constant over a sixty-fourth of the wait, or 10 us.
        for interval in intervals {
            assert!((interval / root(slope) - 1.0).abs() < 5e-3, "{slope}: {interval} {}", root(slope));
        }
    }
    // Falling light the same way: the OFF threshold is as far away.
    let events = recorded(ideal_pixel(), vec![described("dependence", given)], &ramp(-20.0), 200 * MS);
    assert!(intervals_s(&events).iter().all(|interval| (interval / root(20.0) - 1.0).abs() < 5e-3));
}

#[test]
fn a_burst_needs_more_from_event_to_event_and_ends_when_its_polarity_does() {
    let light = Samples::of_log(100 * MS, |t| if t < 0.05 { 40.0 * t } else { 4.0 - 40.0 * t });
    let given = json!({ "moves": "threshold", "over": "burst_index", "at": [1, 101], "by": [0.0, 10.0] });
    let events = recorded(ideal_pixel(), vec![described("dependence", given)], &light, 100 * MS);
    let turn = events.iter().position(|event| event.polarity < 0).unwrap();
    // 0.2, 0.22, 0.24 ... from one to the next, and 0.2 again for the first OFF.
    let level = |t_ns: i64| {
        let t = t_ns as f64 * 1e-9;
        if t < 0.05 { 40.0 * t } else { 4.0 - 40.0 * t }
    };
    let mut before = 0.0;
    for (n, event) in events[..turn].iter().enumerate() {
        let step = level(event.t_in_ns) - before;
        assert!((step - 0.2 * (1.0 + 0.1 * n as f64)).abs() < 1e-4, "{n}: {step}");
        before = level(event.t_in_ns);
    }
    assert!(turn > 4 && (level(events[turn].t_in_ns) - before + 0.2).abs() < 1e-4);
}

#[test]
fn a_product_has_the_first_curve_where_the_second_is_one() {
    let given = json!({
        "moves": "threshold_on", "over": "ac_phase", "period": "10 ms", "form": "sine", "by": [0.0, 0.1, 0.0],
        "times": "column_parity", "times_at": [0, 1], "times_by": [0.0, 1.0]
    });
    let effect = described("dependence", given);
    for (x, t_ns, expected) in [(2, 2_500_000, 0.2), (3, 2_500_000, 0.22), (3, 7_500_000, 0.18)] {
        let mut thresholds = Thresholds { on: 0.2, off: 0.2 };
        let history = History::default();
        effect.thresholds(&site(x, 0), &history, &mut Random::new(1, &[]), t_ns, &mut thresholds);
        assert!((thresholds.on - expected).abs() < 1e-12 && thresholds.off == 0.2, "{thresholds:?}");
    }
}

#[test]
fn a_ratio_keeps_the_product_of_both_thresholds() {
    let given = json!({ "moves": "threshold_ratio", "over": "row", "at": [0, 10], "by": [0.0, 0.44] });
    let mut thresholds = Thresholds { on: 0.2, off: 0.3 };
    let effect = described("dependence", given);
    effect.thresholds(&site(0, 10), &History::default(), &mut Random::new(1, &[]), 0, &mut thresholds);
    assert!((thresholds.on - 0.24).abs() < 1e-12 && (thresholds.on * thresholds.off - 0.06).abs() < 1e-12);
}

#[test]
fn noise_is_as_wide_as_its_curve_and_a_solver_is_given_its_width() {
    let given = json!({ "moves": "noise", "over": "row_parity", "at": [0, 1], "by": [0.0, 0.02] });
    let effect = described("dependence", given);
    let mut random = Random::new(7, &[2]);
    let mut draw = |y: u32| {
        let mut thresholds = Thresholds { on: 0.2, off: 0.25 };
        effect.thresholds(&site(3, y), &History::default(), &mut random, 0, &mut thresholds);
        thresholds.on - 0.2
    };
    assert!((0..50).all(|_| draw(2) == 0.0));
    let drawn: Vec<f64> = (0..20_000).map(|_| draw(3)).collect();
    let (mean, sigma) = super::super::testing::moments(&drawn);
    // Five standard errors of 20,000 draws.
    assert!(mean.abs() < 7.1e-4 && (sigma - 0.02).abs() < 5e-4, "{mean} {sigma}");
    let chance = effect.chance().unwrap();
    assert!((chance.of_events - 0.02 / 2.0_f64.sqrt()).abs() < 1e-12);
}

#[test]
fn what_the_simulator_fires_misses_nothing_through_the_same_dependence() {
    use crate::conditional::{Conditional, Look, Track, conditional};
    use crate::effects::BURST_GAP_NS;
    use crate::exposure::DigitalNumber;
    use crate::model::Model;
    use photocurrent_core::sensor::Reset;
    let light = Samples::of_log(100 * MS, |t| 0.8 * libm::sin(150.0 * t) + 0.4 * libm::cos(410.0 * t));
    let log: Vec<f64> = light.photocurrent.iter().map(|i| libm::log(*i)).collect();
    for given in [
        json!({ "moves": "threshold", "over": "time_since_last_event", "at": [0, 4e-3], "by": [0.3, -0.1] }),
        json!({ "moves": "threshold_ratio", "over": "burst_index", "form": "linear", "by": [0.0, 0.05] }),
        json!({
            "moves": "threshold", "over": "previous_polarity", "at": [-1, 1], "by": [0.2, 0.0],
            "times": "time_since_last_event", "times_at": [0, 5e-3], "times_by": [1.0, 0.0]
        }),
        json!({
            "moves": "threshold", "over": "time", "form": "linear", "by": [0.0, 0.5],
            "plus": "step", "plus_shape": 0.05
        }),
    ] {
        let mut given = given;
        if given.get("plus").is_some() {
            given["by"] = json!([0.0, 0.5, 0.1]);
        }
        let effects = vec![described("dependence", given.clone())];
        let events = recorded(ideal_pixel(), vec![described("dependence", given.clone())], &light, 100 * MS);
        assert!(events.len() > 40, "{given}");
        let model = Model {
            pixel: ideal_pixel(),
            reset: Reset::Resample,
            number: DigitalNumber { black_level: 0.0, gain: 1.0 },
            saturation_dn: 4095.0,
            read_noise_dn: 0.0,
            dn_per_electron: 0.0,
            threshold_noise: 0.0,
            row_time_ns: 0,
        };
        let track = Track::new(&light.t_ns, &log, 10_000);
        let look =
            Look { site: SITE, track: &track, seen: None, events: &events, frames: &[], quiet_ns: &[] };
        let mut out = Conditional::default();
        conditional(&model, &effects, &look, &mut out);
        // Within the parts that the simulator has the wait in: half of a sixty-fourth of 30 % of a threshold.
        // Where a burst ends, a threshold may fall below a voltage that waits: it fires then.
        for (k, excess) in out.excess.iter().enumerate() {
            let wait_ns = events[k].t_in_ns - if k > 0 { events[k - 1].t_in_ns } else { 0 };
            let is_end = (wait_ns - BURST_GAP_NS).abs() < 10;
            assert!(is_end || excess.abs() < 4e-3 * out.threshold[k], "{given}: {excess} {wait_ns}");
        }
        let mut without = Conditional::default();
        conditional(&model, &[], &look, &mut without);
        let mean = |of: &Conditional| of.excess.iter().map(|e| e.abs()).sum::<f64>() / of.excess.len() as f64;
        assert!(mean(&without) > 10.0 * mean(&out), "{given}: {} {}", mean(&without), mean(&out));
    }
}

#[test]
fn mistakes_state_what_was_found_and_expected() {
    let with = |changes: Value| {
        let mut given = json!({ "moves": "threshold", "over": "row", "at": [0, 9], "by": [0.0, 0.1] });
        changes.as_object().unwrap().iter().for_each(|(key, value)| given[key] = value.clone());
        refused(given)
    };
    for (changes, expected) in [
        (json!({ "over": "radios" }), "did you mean \"radius\"?"),
        (json!({ "at": [0, 9, 5] }), "as many values in `by` as knots in `at`"),
        (json!({ "at": [9, 0] }), "expected knots that rise, found 9 before 0"),
        (json!({ "at": 3 }), "expected a list such as [0.0, 0.1], found 3"),
        (json!({ "over": "ac_phase" }), "over `ac_phase` needs `period`"),
        (json!({ "period": "1 ms" }), "is the period of `ac_phase`"),
        (
            json!({ "moves": "leak", "over": "time", "by": ["0 Hz", "1 Hz"] }),
            "`leak` is not expressed over `time`",
        ),
        (json!({ "moves": "delay" }), "`effects.dependence.by`: expected a time such as"),
        (json!({ "by": ["1 us", "2 us"] }), "expected a number (fraction), found \"1 us\""),
        (json!({ "form": "linear" }), "knots (`at`) or a `form`, not both"),
        (json!({ "shape": 2.0 }), "`effects.dependence.shape` belongs to a `form`, and there is none"),
        (json!({ "times_by": [1.0] }), "`effects.dependence.times_by` belongs to `times`"),
        (json!({ "times": "column", "times_by": [1.0] }), "`effects.dependence` needs `times_at`"),
        (json!({ "moves": "noise", "over": "burst_index" }), "`noise` is not expressed over `burst_index`"),
    ] {
        let found = with(changes);
        assert!(found.contains(expected), "{found}");
    }
    assert_eq!(refused(json!({ "over": "row" })), "`effects.dependence` needs `moves`");
    let formula = |form: &str, shape: Option<f64>, by: &[f64]| {
        let mut given = json!({ "moves": "threshold", "over": "radius", "form": form, "by": by });
        shape.iter().for_each(|shape| given["shape"] = json!(shape));
        refused(given)
    };
    assert!(formula("power", None, &[0.0, 0.3]).contains("`power` needs `shape`"));
    assert!(formula("linear", Some(2.0), &[0.0, 0.3]).contains("`linear` has no shape number"));
    assert!(formula("sine", None, &[0.0, 0.3]).contains("expected 3 values of `sine`, the constant first"));
    assert!(formula("sinus", None, &[0.0]).contains("did you mean \"sine\"?"));
}
