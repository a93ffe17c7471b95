//! The engine against another program: OpenEB's event simulator, driven by the same light (data/simulator).

use super::super::*;
use crate::effects::Site;
use crate::front_end::FrontEnd;
use photocurrent_core::sensor::Reset;

const LIGHT: &[u8] = include_bytes!("../../../../data/simulator/openeb_row_light.f32");
const EVENTS: &str = include_str!("../../../../data/simulator/openeb_row_events.csv");
const WIDTH: usize = 96;
const LIGHT_STEP_NS: i64 = 100_000;
const END_NS: i64 = 59_900_000;

/// (in-pixel time, ON?) of each pixel's events.
fn theirs() -> Vec<Vec<(i64, bool)>> {
    let mut pixels = vec![Vec::new(); WIDTH];
    for line in EVENTS.lines().skip(1) {
        let fields: Vec<i64> = line.split(',').map(|field| field.parse().unwrap()).collect();
        pixels[fields[0] as usize].push((fields[1], fields[2] == 1));
    }
    pixels
}

fn ours(reset: Reset) -> Vec<Vec<(i64, bool)>> {
    let light: Vec<f64> =
        LIGHT.chunks_exact(4).map(|bytes| f64::from(f32::from_le_bytes(bytes.try_into().unwrap()))).collect();
    let instants: Vec<i64> = (0..(light.len() / WIDTH) as i64).map(|k| k * LIGHT_STEP_NS).collect();
    let pixel = Pixel {
        front_end: FrontEnd { tau_0_s: 11.161933e-6, alpha_s: 27387.502754e-6 },
        threshold_on: 0.197_379_758_753_610_58,
        threshold_off: 0.178_597_764_133_313_66,
        latency_ns: 1000,
        latency_spread_ns: 0.0,
        refractory_ns: 0,
        log_step: LOG_STEP,
    };
    let chain = Chain { pixel, reset, effects: &[], tolerance: crate::forward::TOLERANCE };
    let row = |x: usize| {
        let photocurrent: Vec<f64> = light.iter().skip(x).step_by(WIDTH).copied().collect();
        let site = Site { x: x as u32, y: 36, width: WIDTH as u32, height: 72, seed: 0 };
        let fired =
            simulate(&chain, &site, &LinearLight::new(&instants, &photocurrent), 0, END_NS, &mut Noiseless);
        fired.into_iter().map(|fired| (fired.event.t_in_ns, fired.event.polarity > 0)).collect()
    };
    (0..WIDTH).map(row).collect()
}

/// Share of the events met by one of ours at the same place of the pixel's list, with the same sign, within 2
/// us.
fn met(ours: &[Vec<(i64, bool)>], theirs: &[Vec<(i64, bool)>]) -> f64 {
    let pairs = || ours.iter().zip(theirs).flat_map(|(ours, theirs)| ours.iter().zip(theirs));
    let total: usize = theirs.iter().map(Vec::len).sum();
    pairs().filter(|(a, b)| a.1 == b.1 && (a.0 - b.0).abs() <= 2000).count() as f64 / total as f64
}

#[test]
fn openeb_fires_the_same_events_at_the_same_times() {
    let (ours, theirs) = (ours(Reset::Advance), theirs());
    assert!(theirs.iter().map(Vec::len).sum::<usize>() > 1000);
    assert!(ours.iter().zip(&theirs).all(|(ours, theirs)| ours.len() == theirs.len()));
    // Their stamps are whole microseconds, and they step 20 us through the low-pass: 2 us hold both.
    assert_eq!(met(&ours, &theirs), 1.0);
}

#[test]
fn another_reset_rule_does_not_pass_for_theirs() {
    // The paper samples the reference anew, which misses what the voltage moves between firing and stamp.
    assert!(met(&ours(Reset::Resample), &theirs()) < 0.6);
}
