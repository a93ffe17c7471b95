//! Claims about the misfit: measurements that are noisier than assumed show by how much.

use super::*;
use crate::front_end::FrontEnd;
use crate::misfit::Misfit;
use photocurrent_core::random::Random;
use photocurrent_core::sensor::Reset;

const SENSOR: MapSensor = MapSensor {
    front_end: FrontEnd::IDEAL,
    threshold_on: 0.2,
    threshold_off: 0.2,
    reset: Reset::Resample,
    refractory_ns: 50_000,
    gain: 1000.0,
    black_level_dn: 10.0,
    saturation_dn: f64::INFINITY,
};
const EVENT: f64 = 0.1;
const SIGMA_DN: f64 = 2.0;
const END_NS: i64 = 800_000_000;
const PERIOD_NS: i64 = 8_000_000;

/// Log light: up and down by 3.2 in 8 ms each, in straight lines.
fn log(t_ns: i64) -> f64 {
    let phase = t_ns.rem_euclid(2 * PERIOD_NS);
    3.0 + 3.2 * i64::min(phase, 2 * PERIOD_NS - phase) as f64 / PERIOD_NS as f64
}

/// What an ideal front end gives, to the microsecond: each event is `shaken` assumed standard deviations,
/// times a normal number, off its threshold. The reference is where light is as the blind time ends.
fn events(shaken: f64, random: &mut Random) -> Vec<PixelEvent> {
    let mut events = Vec::new();
    let (mut reference, mut off) = (log(0), shaken * EVENT * random.normal());
    let mut t_ns = 1_000;
    while t_ns < END_NS - 100_000 {
        let change = log(t_ns) - reference;
        if change > SENSOR.threshold_on * (1.0 + off) || -change > SENSOR.threshold_off * (1.0 + off) {
            let t_off_ns = t_ns + 10_000;
            events.push(PixelEvent { t_in_ns: t_ns, t_off_ns, polarity: if change > 0.0 { 1 } else { -1 } });
            t_ns = t_off_ns + SENSOR.refractory_ns;
            (reference, off) = (log(t_ns), shaken * EVENT * random.normal());
        }
        t_ns += 1_000;
    }
    events
}

/// The integral of light in straight lines, and `shaken` standard deviations of noise on it.
fn frames(shaken: f64, random: &mut Random) -> Vec<MapFrame> {
    let mut frame = |start_ns: i64| {
        let end_ns = start_ns + 3_000_000;
        let rise = log(end_ns) - log(start_ns);
        let light = (libm::exp(log(end_ns)) - libm::exp(log(start_ns))) / rise * 3e-3;
        let dn = SENSOR.black_level_dn + SENSOR.gain * light + shaken * SIGMA_DN * random.normal();
        MapFrame { start_ns, end_ns, dn, sigma_dn: SIGMA_DN, saturated: false }
    };
    (0..END_NS / PERIOD_NS).map(|l| frame(l * PERIOD_NS + 2_000_000)).collect()
}

/// The misfit of a pixel whose light is known from elsewhere, so that it cannot follow what is shaken.
fn misfit(event: f64, frame: f64) -> Misfit {
    let mut random = Random::new(21, &[]);
    let (events, frames) = (events(event, &mut random), frames(frame, &mut random));
    let hint = |t_ns: i64| Hint { t_ns, log_photocurrent: log(t_ns), variance: 1e-10, for_sigma: 1e-10 };
    // At every knot: also where events fire and where the reference is taken.
    let latch = |event: &PixelEvent| event.t_off_ns + SENSOR.refractory_ns;
    let mut known: Vec<i64> = (0..=END_NS / 250_000).map(|k| k * 250_000).collect();
    known.extend(events.iter().flat_map(|event| [event.t_in_ns, latch(event)]).filter(|t| *t < END_NS));
    known.sort_unstable();
    known.dedup();
    let hints: Vec<Hint> = known.into_iter().map(hint).collect();
    let problem = MapProblem {
        hints: &hints,
        noise: Noise { event: EVENT, ..Noise::default() },
        ..MapProblem::new(SENSOR, &events, &frames, (0, END_NS))
    };
    solve(&problem, &MapOptions::default(), &mut MapGroup::default()).outcome.misfit
}

#[test]
fn noise_that_is_so_many_times_the_assumed_one_gives_that_root_mean_square() {
    for (event, frame) in [(1.0, 1.0), (3.0, 0.5), (0.4, 4.0)] {
        let misfit = misfit(event, frame);
        assert!(misfit.events > 1_000 && misfit.frames == 100, "{misfit:?}");
        // A standard deviation from N values is good to 1 / sqrt(2 N): 2 % of 1,300, 7 % of 100. Three times
        // that.
        assert!((misfit.event_rms() / event - 1.0).abs() < 0.06, "{event}: {misfit:?}");
        assert!((misfit.frame_rms() / frame - 1.0).abs() < 0.21, "{frame}: {misfit:?}");
    }
}

#[test]
fn nothing_measured_has_no_root_mean_square() {
    assert!(Misfit::default().event_rms().is_nan() && Misfit::default().frame_rms().is_nan());
    let of_two = Misfit { frame_square: 18.0, frames: 2, ..Misfit::default() };
    assert_eq!(of_two.frame_rms(), 3.0);
}
