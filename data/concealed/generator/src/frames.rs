//! From collected charge to digital numbers: what the frames' own path adds.

use crate::law::Law;
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
        let of_column = match physics.law {
            Some(Law::ColumnGain { slope }) => 1.0 + slope * dx / cx,
            _ => 1.0,
        };
        of_column / (root * root)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::sensor;
    use crate::field::{is_noisy, noise};
    use crate::plan::Plan;

    #[test]
    fn noisy_frames_of_the_plan_field_have_the_stated_variance() {
        let entries = Plan::Field.entries();
        for (index, entry) in entries.iter().enumerate().step_by(9) {
            let mut random = Random::named(&format!("variance {index}"));
            let mut sensor = sensor(index, entry, &mut random);
            noise(&mut sensor, is_noisy(index), entry, &mut random);
            sensor.gain = 1000.0;
            // 60 x 50 values at 4 % and at 60 % of full scale.
            for share in [0.04, 0.6] {
                let full = sensor.saturation - sensor.black;
                let signal = share * full;
                let physics = Physics::of(sensor.clone());
                let charge = vec![vec![signal / sensor.gain; 3000]];
                let dn = digitise(&charge, &physics, 60, Numbers::Sixteenths, &mut random)[0].clone();
                let mean = dn.iter().sum::<f64>() / 3000.0;
                let variance = dn.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / 3000.0;
                let shot = if sensor.full_well > 0.0 { signal / (sensor.full_well / full) } else { 0.0 };
                let stated = shot + sensor.read_noise * sensor.read_noise;
                // Rounding to sixteenths of noise, or of a constant; five standard errors of a variance.
                let rounding = if stated > 0.0 { 1.0 / (256.0 * 12.0) } else { 0.0 };
                let most = 5.0 * (2.0 / 3000.0f64).sqrt() * (stated + rounding) + 1e-9;
                assert!((variance - stated - rounding).abs() < most, "{index}: {variance} for {stated}");
                assert!((mean - sensor.black - signal).abs() < 0.04 + 5.0 * (stated / 3000.0).sqrt());
                let plain = expected(&charge, &physics, 60);
                assert!((plain[0][7] - sensor.black - signal).abs() < 1e-9);
            }
        }
    }
}
