//! Other readings of an edge spread function: a fitted Gaussian edge, and where the modulation transfer is
//! one half.

use super::spread::Rise;
use std::f64::consts::{PI, SQRT_2, TAU};

/// 10 to 90 % of a Gaussian edge, in standard deviations.
pub const TEN_TO_NINETY: f64 = 2.563_103_131_089_201;

/// 10-90 % width of the Gaussian edge `(1 + erf((d - m) / (sigma sqrt 2))) / 2` that fits best; NaN when the
/// fit does not settle.
pub fn gaussian_width(profile: &[(f64, f64)], rise: &Rise) -> f64 {
    let model = |d: f64, m: f64, sigma: f64| 0.5 * (1.0 + libm::erf((d - m) / (sigma * SQRT_2)));
    let cost = |m: f64, sigma: f64| {
        profile.iter().map(|(d, share)| share - model(*d, m, sigma)).map(|error| error * error).sum::<f64>()
    };
    let (mut m, mut sigma, mut damping) = (rise.half, (rise.width() / TEN_TO_NINETY).max(0.05), 1e-3);
    let mut best = cost(m, sigma);
    for _ in 0..60 {
        let (mut a, mut b, mut c, mut g, mut h) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (d, share) in profile {
            let z = (d - m) / sigma;
            let density = libm::exp(-0.5 * z * z) / (TAU.sqrt() * sigma);
            let (by_m, by_sigma, error) = (-density, -density * z, share - model(*d, m, sigma));
            a += by_m * by_m;
            b += by_m * by_sigma;
            c += by_sigma * by_sigma;
            g += by_m * error;
            h += by_sigma * error;
        }
        let (a, c) = (a * (1.0 + damping), c * (1.0 + damping));
        let determinant = a * c - b * b;
        if determinant.is_nan() || determinant <= 0.0 {
            return f64::NAN;
        }
        let (step_m, step_sigma) = ((c * g - b * h) / determinant, (a * h - b * g) / determinant);
        let new = cost(m + step_m, sigma + step_sigma);
        if sigma + step_sigma > 1e-3 && new <= best {
            (m, sigma, damping) = (m + step_m, sigma + step_sigma, damping / 10.0);
            best = new;
            if step_m.abs() + step_sigma.abs() < 1e-9 {
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e8 {
                break;
            }
        }
    }
    TEN_TO_NINETY * sigma
}

/// Samples per pixel of the line spread function.
const PER_PIXEL: f64 = 4.0;

/// The frequency at which the modulation transfer function is one half, cycles per pixel; NaN when it does
/// not fall so far below 1 cycle per pixel.
///
/// As in ISO 12233: derivative of the profile, Hamming window about the edge, Fourier transform, divided by
/// that of the difference of two neighbours.
pub fn mtf50(profile: &[(f64, f64)], half: f64) -> f64 {
    let (Some(first), Some(last)) = (profile.first(), profile.last()) else { return f64::NAN };
    let reach = (half - first.0).min(last.0 - half);
    let count = (reach * PER_PIXEL).floor() as i64;
    let value = |d: f64| {
        let after = profile.partition_point(|(at, _)| *at <= d).clamp(1, profile.len() - 1);
        let (a, b) = (profile[after - 1], profile[after]);
        a.1 + (b.1 - a.1) * (d - a.0) / (b.0 - a.0)
    };
    let derivative: Vec<(f64, f64)> = (-count..count)
        .map(|k| {
            let (a, b) = (k as f64 / PER_PIXEL, (k + 1) as f64 / PER_PIXEL);
            let middle = 0.5 * (a + b);
            let window = 0.54 + 0.46 * libm::cos(PI * middle / reach);
            (middle, window * (value(half + b) - value(half + a)))
        })
        .collect();
    let transfer = |frequency: f64| {
        let (mut re, mut im) = (0.0, 0.0);
        for (at, value) in &derivative {
            re += value * libm::cos(TAU * frequency * at);
            im += value * libm::sin(TAU * frequency * at);
        }
        let x = PI * frequency / PER_PIXEL;
        let difference = if x == 0.0 { 1.0 } else { libm::sin(x) / x };
        (re * re + im * im).sqrt() / difference
    };
    let full = transfer(0.0);
    let (step, mut before) = (0.005, 1.0);
    for k in 1..=200 {
        let now = transfer(f64::from(k) * step) / full;
        if now < 0.5 {
            return step * (f64::from(k) - (0.5 - now) / (before - now));
        }
        before = now;
    }
    f64::NAN
}
