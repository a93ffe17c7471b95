//! What the comparator has between events.

use super::*;
use crate::exposure::DigitalNumber;
use crate::forward::{LOG_STEP, Pixel};

const SITE: Site = Site { x: 0, y: 0, width: 1, height: 1, seed: 0 };
/// Log light rises by so much a second.
const RATE_PER_S: f64 = 40.0;

fn model(reset: Reset, refractory_ns: i64) -> Model {
    let pixel = Pixel {
        front_end: FrontEnd::IDEAL,
        threshold_on: 0.2,
        threshold_off: 0.25,
        latency_ns: 0,
        latency_spread_ns: 0.0,
        refractory_ns,
        log_step: LOG_STEP,
    };
    Model {
        pixel,
        reset,
        number: DigitalNumber { black_level: 0.0, gain: 1.0 },
        saturation_dn: 4095.0,
        read_noise_dn: 0.0,
        dn_per_electron: 0.0,
        threshold_noise: 0.0,
        row_time_ns: 0,
    }
}

#[test]
fn between_events_the_level_is_what_the_light_rose_by_since_the_reference() {
    for (reset, refractory_ns) in [(Reset::Resample, 1_000_000), (Reset::Advance, 0)] {
        let model = model(reset, refractory_ns);
        // A threshold takes 5 ms, and a reference is taken when the pixel is no longer held.
        let events: Vec<PixelEvent> = [5_000_000, 10_000_000 + refractory_ns]
            .map(|t| PixelEvent { t_in_ns: t, t_off_ns: t, polarity: 1 })
            .to_vec();
        let track = Track::new(&[0, 20_000_000], &[4.0, 4.0 + 0.02 * RATE_PER_S], 100_000);
        let quiet_ns = [2_000_000, 5_500_000, 8_000_000, 19_000_000];
        let look =
            Look { site: SITE, track: &track, seen: None, events: &events, frames: &[], quiet_ns: &quiet_ns };
        let mut out = Conditional::default();
        conditional(&model, &[], &look, &mut out);
        // An ideal front end follows within a nanosecond.
        assert!(out.excess.iter().all(|excess| excess.abs() < 1e-7), "{:?}", out.excess);
        assert_eq!(out.quiet.len(), quiet_ns.len());
        for (quiet, t_ns) in out.quiet.iter().zip(quiet_ns) {
            let last = events.iter().rev().find(|event| event.t_in_ns <= t_ns);
            let taken_ns = last.map_or(0, |event| event.t_in_ns + refractory_ns);
            let is_armed = t_ns >= taken_ns;
            assert_eq!((quiet.t_ns, quiet.is_armed), (t_ns, is_armed));
            if is_armed {
                let level = RATE_PER_S * (t_ns - taken_ns) as f64 * 1e-9;
                assert!((quiet.level - level).abs() < 1e-7, "{} is {level}", quiet.level);
                assert_eq!(quiet.reference_ns, taken_ns);
            }
            assert!((quiet.slope_per_s - RATE_PER_S).abs() < 1e-3 * RATE_PER_S, "{}", quiet.slope_per_s);
            assert_eq!((quiet.thresholds.on, quiet.thresholds.off), (0.2, 0.25));
        }
    }
}

#[test]
fn what_a_dependence_does_to_events_is_known_to_who_has_it() {
    use crate::effects::from_description;
    use crate::forward::{Chain, LinearLight, Noiseless, TOLERANCE, simulate};
    use serde_json::json;
    let site = Site { x: 3, y: 5, width: 16, height: 12, seed: 0 };
    let model = model(Reset::Resample, 200_000);
    let t_ns: Vec<i64> = (0..=20_000).map(|k| k * 10_000).collect();
    let log: Vec<f64> = t_ns.iter().map(|t| 4.0 + libm::sin(40.0 * *t as f64 * 1e-9)).collect();
    let light: Vec<f64> = log.iter().map(|log| libm::exp(*log)).collect();
    let track = Track::new(&t_ns, &log, 10_000);
    let phase = [0.0, 0.25, 0.5, 0.75];
    for given in [
        json!({ "moves": "threshold", "over": "row_parity", "at": [0, 1], "by": [0.0, 0.2] }),
        json!({ "moves": "threshold", "over": "time", "at": [0.0, 0.2], "by": [0.0, 0.3] }),
        json!({ "moves": "threshold_on", "over": "photocurrent", "at": [3, 5], "by": [0.2, -0.2] }),
        json!({ "moves": "threshold", "over": "previous_polarity", "at": [-1, 1], "by": [0.3, 0.0] }),
        json!({ "moves": "delay", "over": "ac_phase", "period": "7 ms", "at": phase,
            "by": ["0 us", "75 us", "150 us", "75 us"] }),
        json!({ "moves": "leak", "over": "radius", "at": [0, 1], "by": ["5 Hz", "40 Hz"] }),
    ] {
        let parameters = given.as_object().unwrap().clone();
        let effects = from_description(&[("dependence".into(), parameters)].into()).unwrap();
        let chain = Chain { pixel: model.pixel, reset: model.reset, effects: &effects, tolerance: TOLERANCE };
        let seen = LinearLight::new(&t_ns, &light);
        let events: Vec<PixelEvent> = simulate(&chain, &site, &seen, 0, 200_000_000, &mut Noiseless)
            .into_iter()
            .filter_map(|fired| fired.recorded)
            .collect();
        let worst = |effects: &[Box<dyn Effect>]| {
            let look = Look { site, track: &track, seen: None, events: &events, frames: &[], quiet_ns: &[] };
            let mut out = Conditional::default();
            conditional(&model, effects, &look, &mut out);
            out.excess.iter().fold(0.0, |most, excess| f64::max(most, excess.abs()))
        };
        // Stamps are undone to first order: of 150 us that grow by 43 us a millisecond 43 in a thousand are
        // left, at 40 natural-log units a second, at an event and at its reference.
        let (most, least) =
            if given["moves"] == "delay" { (2.0 * 40.0 * 150e-6 * 0.043, 2.5e-3) } else { (1e-4, 0.01) };
        let (with, without) = (worst(&effects), worst(&[]));
        assert!(events.len() > 8 && with < most && without > least, "{given}: {with} {without}");
    }
}
