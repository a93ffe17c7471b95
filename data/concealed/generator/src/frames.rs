//! From collected charge to digital numbers: what the frames' own path adds.

use crate::random::Random;
use crate::sensor::Physics;

/// How numbers are kept: whole (u16) or in sixteenths of a DN (f32), as a converter with four more bits
/// would.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Numbers {
    Whole,
    Sixteenths,
}

/// How bright each pixel is behind the optics' falloff.
fn shades(physics: &Physics, width: usize, height: usize) -> Vec<f64> {
    let (cx, cy) = (0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0));
    let shade = |p: usize| {
        let (dx, dy) = ((p % width) as f64 - cx, (p / width) as f64 - cy);
        let r2 = (dx * dx + dy * dy) / (cx * cx + cy * cy);
        let root = 1.0 + r2 * (libm::pow(1.0 - physics.falloff, -0.5) - 1.0);
        1.0 / (root * root)
    };
    (0..width * height).map(shade).collect()
}

/// Digital numbers of all frames without anything random, rounding or steps of the gain.
pub fn expected(charge: &[Vec<f64>], physics: &Physics, width: usize) -> Vec<Vec<f64>> {
    let sensor = &physics.sensor;
    let full = sensor.saturation - sensor.black;
    let shades = shades(physics, width, charge.first().map_or(1, |frame| frame.len() / width));
    let number = |l: usize, p: usize| {
        let signal = sensor.gain * shades[p] * (charge[l][p] + physics.lag * charge[l.max(1) - 1][p]);
        let x = signal / full;
        let dn = sensor.black + signal + 4.0 * physics.nonlinearity * x * (1.0 - x) * full;
        dn.clamp(0.0, sensor.saturation)
    };
    (0..charge.len()).map(|l| (0..shades.len()).map(|p| number(l, p)).collect()).collect()
}

/// Digital numbers of all frames from their charges (photocurrent x s).
pub fn digitise(
    charge: &[Vec<f64>],
    physics: &Physics,
    width: usize,
    numbers: Numbers,
    random: &mut Random,
) -> Vec<Vec<f64>> {
    let sensor = &physics.sensor;
    let height = charge.first().map_or(1, |frame| frame.len() / width);
    let shades = shades(physics, width, height);
    let full = sensor.saturation - sensor.black;
    let mut factor = 1.0;
    let mut frames = Vec::with_capacity(charge.len());
    for (l, now) in charge.iter().enumerate() {
        // Before the first frame there was one much like it.
        let before = &charge[l.max(1) - 1];
        if physics.gain_sigma > 0.0 && l % physics.gain_every == 0 {
            factor = libm::exp(physics.gain_sigma * random.normal());
        }
        let number = |p: usize| {
            let collected = shades[p] * (now[p] + physics.lag * before[p]);
            let mut signal = factor * sensor.gain * collected;
            if sensor.full_well > 0.0 {
                signal += libm::sqrt(signal.max(0.0) * full / sensor.full_well) * random.normal();
            }
            let x = signal / full;
            signal += 4.0 * physics.nonlinearity * x * (1.0 - x) * full;
            let noise = if sensor.read_noise > 0.0 { sensor.read_noise * random.normal() } else { 0.0 };
            let dn = sensor.black + signal + noise;
            let kept = match numbers {
                Numbers::Whole => dn.round(),
                Numbers::Sixteenths => (16.0 * dn).round() / 16.0,
            };
            kept.clamp(0.0, sensor.saturation)
        };
        frames.push((0..width * height).map(number).collect());
    }
    frames
}
