//! Random effects, read off the same residuals: each as a further part of their distribution, with its gain in nats an event, so that it stands beside effects that have a column.
//!
//! With u = polarity times residual over threshold: thresholds that differ from pixel to pixel move the mean of u of a pixel, refractory periods that differ move it in proportion
//! to the slope; threshold noise and stamp noise widen it; an event without a crossing has any u between -2 and 0; after a lost event the next has a whole threshold more.
//!
//! Sizes are counted from those of the control, which are what a regularised picture and the stated noise leave.

use super::Residuals;
use super::fit::{EventNoise, NU};
use crate::candidates::{CANDIDATES, Scales};
use crate::nominal::Nominal;

/// One part of the distribution: its candidate, gain in nats an event, and size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Number in [`CANDIDATES`].
    pub candidate: usize,
    /// Held-out gain over the plain distribution, nats an event.
    pub gain: f64,
    /// Size: a standard deviation or a share, in the unit of the parts' own.
    pub size: f64,
}

/// What parts are measured on.
pub struct Ground<'a> {
    /// The events.
    pub events: &'a Residuals,
    /// Their residuals, natural-log units, with whatever was found applied.
    pub residual: &'a [f64],
    /// Blocks of held-out gains.
    pub block: &'a [u32],
    /// Mean threshold, natural-log units.
    pub threshold: f64,
    /// Least threshold noise.
    pub least: f64,
}

/// Events of a pixel below this are too few for its own mean.
const LEAST_OF_PIXEL: usize = 4;

/// All parts of a recording.
///
/// `noise`: of the plain distribution, usually the control's.
pub fn parts(ground: &Ground<'_>, noise: &EventNoise) -> Vec<Part> {
    let find = |id: &str| CANDIDATES.iter().position(|candidate| candidate.id == id && candidate.is_random);
    let own = ground.noise();
    let mut found = Vec::new();
    let mut push = |id: &str, (gain, size): (f64, f64)| {
        if let Some(candidate) = find(id) {
            found.push(Part { candidate, gain, size });
        }
    };
    push("threshold_mismatch", ground.of_pixels(&own, |_| 1.0));
    push("refractory_spread", ground.of_pixels(&own, |slope| slope.abs()));
    push("threshold_noise", ground.wider(noise, &EventNoise { a: own.a, b: noise.b }, own.a));
    push("timestamp_jitter", ground.wider(noise, &EventNoise { a: noise.a, b: own.b }, own.b));
    push("background_activity", ground.mixture(&own, &|u, _| if (-2.0..0.0).contains(&u) { 0.5 } else { 0.0 }));
    push("event_loss", ground.mixture(&own, &|u, sigma| (1..=4).map(|n| 0.5_f64.powi(n) * density((u - f64::from(n)) / sigma) / sigma).sum()));
    found
}

/// Density of Student's t with three degrees of freedom.
fn density(z: f64) -> f64 {
    let base = 1.0 + z * z / NU;
    0.367_552_596_947_861_4 / (base * base)
}

impl Ground<'_> {
    fn noise(&self) -> EventNoise {
        EventNoise::estimate(self.residual, &self.events.slope_per_s, self.least)
    }

    fn u(&self, k: usize) -> f64 {
        f64::from(self.events.polarity[k]) * self.residual[k] / self.threshold
    }

    fn sigma(&self, noise: &EventNoise, k: usize) -> f64 {
        noise.sigma(self.events.slope_per_s[k]) / self.threshold
    }

    /// Gain of a wider distribution, and its size.
    fn wider(&self, before: &EventNoise, after: &EventNoise, size: f64) -> (f64, f64) {
        let gain: f64 = (0..self.residual.len())
            .map(|k| {
                let (u, was, is) = (self.u(k), self.sigma(before, k), self.sigma(after, k));
                libm::log(density(u / is) / is) - libm::log(density(u / was) / was)
            })
            .sum();
        (gain / self.residual.len().max(1) as f64, size)
    }

    /// A mean of each pixel in proportion to `by` of the slope: gain of predicting each event from the others of its pixel, and the standard deviation over pixels.
    fn of_pixels(&self, noise: &EventNoise, by: impl Fn(f64) -> f64) -> (f64, f64) {
        let n = self.residual.len();
        let mut at = 0;
        let mut pixels: Vec<(std::ops::Range<usize>, f64, f64)> = Vec::new();
        while at < n {
            let end = (at..n).find(|&k| self.events.pixel[k] != self.events.pixel[at]).unwrap_or(n);
            if end - at >= LEAST_OF_PIXEL {
                let (mut s, mut sx) = (0.0, 0.0);
                for k in at..end {
                    let (x, weight) = (by(self.events.slope_per_s[k]), self.weight(noise, k));
                    s += weight * x * x;
                    sx += weight * x * self.u(k);
                }
                if s > 0.0 {
                    pixels.push((at..end, sx / s, s));
                }
            }
            at = end;
        }
        if pixels.len() < 20 {
            return (0.0, 0.0);
        }
        // Robust variance of the means beyond their own error, which is that of half of the events against the other half.
        let mut squares: Vec<f64> = Vec::new();
        let mut errors: Vec<f64> = Vec::new();
        let mut means: Vec<f64> = pixels.iter().map(|pixel| pixel.1).collect();
        means.sort_by(f64::total_cmp);
        let middle = means[means.len() / 2];
        for (range, mean, _) in &pixels {
            squares.push((mean - middle).abs());
            let half = |parity: usize| {
                let (mut s, mut sx) = (0.0, 0.0);
                for k in range.clone().filter(|k| k % 2 == parity) {
                    let (x, weight) = (by(self.events.slope_per_s[k]), self.weight(noise, k));
                    s += weight * x * x;
                    sx += weight * x * self.u(k);
                }
                sx / f64::max(s, 1e-300)
            };
            errors.push(0.5 * (half(0) - half(1)).abs());
        }
        squares.sort_by(f64::total_cmp);
        errors.sort_by(f64::total_cmp);
        let (spread, error) = (1.4826 * squares[squares.len() / 2], 1.4826 * errors[errors.len() / 2]);
        let variance = spread * spread - error * error;
        if variance <= 0.0 {
            return (0.0, 0.0);
        }
        let mut gain = 0.0;
        for (range, mean, weight) in &pixels {
            for k in range.clone() {
                let (x, own) = (by(self.events.slope_per_s[k]), self.weight(noise, k));
                let rest = weight - own * x * x;
                if rest <= 0.0 {
                    continue;
                }
                let others = (weight * mean - own * x * self.u(k)) / rest - middle;
                let shrunk = others * variance / (variance + 1.0 / rest);
                let (u, sigma) = (self.u(k) - middle * x, self.sigma(noise, k));
                let now = libm::hypot(0.0, sigma);
                gain += libm::log(density((u - shrunk * x) / now)) - libm::log(density(u / sigma));
            }
        }
        (gain / n as f64, libm::sqrt(variance))
    }

    fn weight(&self, noise: &EventNoise, k: usize) -> f64 {
        let sigma = self.sigma(noise, k);
        let z = self.u(k) / sigma;
        (NU + 1.0) / (NU + z * z) / (sigma * sigma)
    }

    /// A share of events of another distribution, by expectation and maximisation: gain, and the share.
    fn mixture(&self, noise: &EventNoise, other: &dyn Fn(f64, f64) -> f64) -> (f64, f64) {
        let densities: Vec<(f64, f64)> = (0..self.residual.len())
            .map(|k| {
                let (u, sigma) = (self.u(k), self.sigma(noise, k));
                (density(u / sigma) / sigma, other(u, sigma))
            })
            .collect();
        let n = densities.len().max(1) as f64;
        let mut share: f64 = 0.02;
        for _ in 0..60 {
            share = densities.iter().map(|(plain, other)| share * other / (share * other + (1.0 - share) * plain)).sum::<f64>() / n;
        }
        let gain: f64 = densities.iter().map(|(plain, other)| libm::log1p(share * (other / plain - 1.0))).sum();
        (gain / n, share)
    }
}

/// The parameter of a part's size beyond the control's, in the unit of its declaration.
pub fn value(part: &Part, control: f64, scales: &Scales, nominal: &Nominal, events_per_pixel_s: f64) -> f64 {
    let beyond = libm::sqrt(f64::max(part.size * part.size - control * control, 0.0));
    match CANDIDATES[part.candidate].id {
        "threshold_mismatch" => beyond * scales.threshold,
        // A fraction of the period, in log: standard deviation of u per slope is that of the period over the threshold.
        "refractory_spread" => beyond * scales.threshold / f64::max(nominal.pixel.refractory_ns as f64 * 1e-9, 50e-6),
        "background_activity" => f64::max(part.size - control, 0.0) * events_per_pixel_s,
        "event_loss" => f64::max(part.size - control, 0.0),
        _ => beyond,
    }
}
