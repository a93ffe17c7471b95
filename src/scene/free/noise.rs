//! Noise of a scene's measurements: of events, and of frame values.

use super::predicted::{PixelPrediction, PredictedEvent, PredictedFrame};
use crate::case::Case;
use crate::nominal::Nominal;
use crate::statistics::{MEDIAN_NORMAL, MEDIAN_T, NU, median};
use rayon::prelude::*;

/// Threshold noise as a share of the threshold: initial value, and limits of its estimate.
const FIRST_SHARE: f64 = 0.02;
const SHARES: (f64, f64) = (0.003, 0.3);
/// Noise of thresholds that is always there, as a share of them.
pub const LEAST_SHARE: f64 = 0.01;
/// Noise of stamps, seconds.
const STAMP_S: f64 = 20e-6;
/// The light is estimated without an event that decides more than this of itself as if it decided this.
const MOST_LEVERAGE: f64 = 0.999;
/// Least slope, thresholds per second; slower ones count as this.
const LEAST_RISE_PER_S: f64 = 10.0;
/// The logarithm of a rise changes by no more than this with an effect.
pub(crate) const MOST_OF_RISE: f64 = 1.0;
/// Limits of the share of instants without an event at which one is missing for another reason than that
/// none was due.
const MISSING: (f64, f64) = (1e-3, 0.9);
/// Largest excess at an instant without an event, standard deviations; larger ones have another cause.
const FAR: f64 = 3.0;
/// Standard deviations beyond which a normal tail is computed by its expansion.
const FARTHEST: f64 = 8.0;
/// The probability of no event bends at least so much with the excess.
const LEAST_CURVATURE: f64 = 1e-3;
/// Frame values are whole or nearly: DN; and gains differ by a share.
const LEAST_DN: f64 = 0.3;
const LEAST_SIGNAL_SHARE: f64 = 0.002;

/// Contribution of an instant without an event to a Newton step.
pub(crate) struct QuietTerm {
    pub weight: f64,
    pub residual: f64,
    pub log_probability: f64,
}

/// Noise of events and of frame values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneNoise {
    /// Of thresholds, as a share of them.
    pub threshold_share: f64,
    /// Of stamps, seconds.
    pub stamp_s: f64,
    /// Variance of a dark frame value, DN^2.
    pub dark_dn2: f64,
    /// Increase of it per DN of signal, DN.
    pub shot_dn: f64,
    /// Share of the instants without an event at which one is missing for another reason than that none was
    /// due: a loss, or light that the scene does not follow.
    pub missing: f64,
}

impl SceneNoise {
    /// With frame noise ([`frame_noise`]).
    pub fn new((dark_dn2, shot_dn): (f64, f64)) -> SceneNoise {
        SceneNoise { threshold_share: FIRST_SHARE, stamp_s: STAMP_S, dark_dn2, shot_dn, missing: MISSING.0 }
    }

    /// Variance of an event's excess.
    pub(crate) fn event_variance(&self, event: &PredictedEvent) -> f64 {
        let threshold = self.threshold_share * event.threshold;
        let stamp = self.stamp_s * event.slope_per_s;
        let least = LEAST_SHARE * event.threshold;
        threshold * threshold + stamp * stamp + least * least
    }

    /// The share of thresholds in an event's variance: the rest is of stamps, and the density of a time that
    /// only stamps blur does not depend on how fast the voltage rises.
    pub(crate) fn share_of_thresholds(&self, event: &PredictedEvent) -> f64 {
        let stamp = self.stamp_s * event.slope_per_s;
        1.0 - stamp * stamp / self.event_variance(event)
    }

    /// Weight and residual of an instant at which an event did not fire, for a Newton step, and the
    /// logarithm of the probability that none did, nats.
    ///
    /// With z the excess in the event's direction over its standard deviation: Phi(-z) for the step, and
    /// (1 - e) Phi(-z) + e for the probability, where e is the share of missing events.
    pub(crate) fn quiet_term(&self, event: &PredictedEvent) -> QuietTerm {
        let deviation = self.event_variance(event).sqrt();
        let z = f64::max(event.polarity * event.excess / deviation, -FARTHEST);
        let silent = 0.5 * libm::erfc(z * core::f64::consts::FRAC_1_SQRT_2);
        let probability = (1.0 - self.missing) * silent + self.missing;
        let density = libm::exp(-0.5 * z * z) / (core::f64::consts::TAU).sqrt();
        // Of -log Phi(-z): its first derivative, and its second.
        let rate = if z < FARTHEST { density / silent } else { z + 1.0 / z };
        let bent = if z < FARTHEST { (rate * (rate - z)).max(LEAST_CURVATURE) } else { 1.0 };
        QuietTerm {
            weight: bent / (deviation * deviation),
            residual: event.polarity * rate / bent * deviation,
            log_probability: libm::log(probability),
        }
    }

    /// Variance of a frame value, DN^2.
    pub(crate) fn frame_variance(&self, signal_dn: f64) -> f64 {
        let share = LEAST_SIGNAL_SHARE * signal_dn;
        self.dark_dn2 + self.shot_dn * signal_dn.max(0.0) + LEAST_DN * LEAST_DN + share * share
    }

    /// Misfit of a frame value over its standard deviation.
    pub(crate) fn frame_misfit(&self, frame: &PredictedFrame) -> f64 {
        frame.residual_dn / self.frame_variance(frame.signal_dn).sqrt()
    }

    /// Log density of a frame value whose misfits have a Student-t distribution of this scale
    /// ([`frame_scale`]), nats.
    pub(crate) fn log_density_of_frame(&self, frame: &PredictedFrame, scale: f64) -> f64 {
        let misfit = self.frame_misfit(frame) / scale;
        -libm::log(scale) - 0.5 * (NU + 1.0) * libm::log1p(misfit * misfit / NU)
    }

    /// Scales the threshold noise to the excesses and to the posterior variance of the light.
    pub(crate) fn estimate_of_events(&mut self, predicted: &[PixelPrediction], left: &[Vec<f64>]) {
        let events = predicted.iter().zip(left).flat_map(|(of, left)| of.events.iter().zip(left));
        let relative: Vec<f64> = events
            .map(|(event, left)| (event.excess * event.excess + left) / self.event_variance(event))
            .collect();
        if relative.is_empty() {
            return;
        }
        // Expectation maximisation of a Student-t distribution's scale.
        let mut scale = 1.0;
        for _ in 0..10 {
            let weighted = |z: &f64| (NU + 1.0) * z / (NU + z / scale);
            scale = relative.iter().map(weighted).sum::<f64>() / relative.len() as f64;
        }
        self.threshold_share = (self.threshold_share * scale.sqrt()).clamp(SHARES.0, SHARES.1);
    }

    /// Sets the share of missing events to that of the instants without one at which the light is far beyond
    /// a threshold.
    ///
    /// Not by its likelihood, which is greatest where every such instant lacks an event (Phi <= 1), and none
    /// is a measurement any more.
    pub(crate) fn estimate_of_quiet(&mut self, predicted: &[PixelPrediction]) {
        let instants = predicted.iter().flat_map(|of| &of.quiet);
        let (far, all) = instants.fold((0, 0), |(far, all), quiet| {
            let is_far = quiet.polarity * quiet.excess > FAR * self.event_variance(quiet).sqrt();
            (far + usize::from(is_far), all + 1)
        });
        self.missing = (far as f64 / f64::max(all as f64, 1.0)).clamp(MISSING.0, MISSING.1);
    }

    /// Log densities of a pixel's events' times, each left out, and of none between them, nats. `event`: by
    /// how much the excess of each event and the logarithm of its rise change; `quiet`: the excess of each
    /// instant without one.
    pub(crate) fn log_density(
        &self,
        predicted: &PixelPrediction,
        leverage: &[f64],
        event: impl Fn(usize) -> [f64; 2],
        quiet: impl Fn(usize) -> f64,
    ) -> f64 {
        let fired = |(k, (of, leverage)): (usize, (&PredictedEvent, &f64))| {
            let [excess, log_rise] = event(k);
            let rise_per_s = of.rise_per_s * libm::exp(log_rise.clamp(-MOST_OF_RISE, MOST_OF_RISE));
            let of = PredictedEvent { excess: of.excess + excess, rise_per_s, ..*of };
            self.log_density_left_out(&of, *leverage)
        };
        let none = |(k, of): (usize, &PredictedEvent)| {
            self.quiet_term(&PredictedEvent { excess: of.excess + quiet(k), ..*of }).log_probability
        };
        predicted.events.iter().zip(leverage).enumerate().map(fired).sum::<f64>()
            + predicted.quiet.iter().enumerate().map(none).sum::<f64>()
    }

    /// How much more probable each event of a pixel is by one prediction than by another, nats, whatever its
    /// `leverage` is by both.
    pub(crate) fn event_gains(
        &self,
        with: &PixelPrediction,
        without: &PixelPrediction,
        leverage: impl Fn(usize) -> f64,
    ) -> Vec<f64> {
        let of = |(k, (with, without)): (usize, (&PredictedEvent, &PredictedEvent))| {
            self.log_density_left_out(with, leverage(k)) - self.log_density_left_out(without, leverage(k))
        };
        with.events.iter().zip(&without.events).enumerate().map(of).collect()
    }

    /// Log density of an event's excess, nats, when the light was estimated with it and the event has a
    /// `leverage` on it.
    pub(crate) fn log_density_left_out(&self, event: &PredictedEvent, leverage: f64) -> f64 {
        let left = 1.0 - leverage.clamp(0.0, MOST_LEVERAGE);
        let (excess, variance) = (event.excess / left, self.event_variance(event) / left);
        libm::log(rise(event))
            - 0.5 * libm::log(variance)
            - 0.5 * (NU + 1.0) * libm::log1p(excess * excess / variance / NU)
    }
}

/// How fast the voltage rises when an event fires, ln/s: at least so fast that it is no chance.
pub(crate) fn rise(event: &PredictedEvent) -> f64 {
    f64::max(event.rise_per_s, LEAST_RISE_PER_S * event.threshold)
}

/// Does it rise as fast as that?
pub(crate) fn is_rising(event: &PredictedEvent) -> bool {
    rise(event) == event.rise_per_s
}

/// The scale of a Student-t distribution of frame values' misfits: at least that of their noise.
pub(crate) fn frame_scale(misfits: &mut [f64]) -> f64 {
    let median = if misfits.is_empty() { 0.0 } else { median(misfits) };
    f64::max(median, MEDIAN_NORMAL) / MEDIAN_T
}

/// Levels of frame values that noise is estimated in.
const LEVELS: usize = 12;
/// Least number of differences in each.
const FEWEST: usize = 100;
/// Quantile of absolute differences that is used, and that of a normal distribution: remaining structure of
/// the scene makes some differences larger.
const QUANTILE: (f64, f64) = (0.2, 0.253_347);
/// Frame values at most, of those that are evenly spread.
const MOST_VALUES: usize = 300_000;

/// Variance of frame values, DN^2, as that of a dark one and what a signal of one DN adds, DN; at least what
/// the description states.
///
/// From differences that remove most of the scene: second differences along x of second differences along y,
/// the same of the change from frame to frame, and second differences in time. Of each level of brightness
/// the kind that leaves least counts, by a low quantile, as edges are in the minority.
///
/// Source: Immerkaer, Fast noise variance estimation, Computer Vision and Image Understanding 64 (1996), for
/// the first kind.
pub fn frame_noise(case: &Case, nominal: &Nominal) -> (f64, f64) {
    let stated = (nominal.read_noise_dn * nominal.read_noise_dn, nominal.dn_per_electron);
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    if case.frame_count() < 3 || width < 3 || height < 3 {
        return stated;
    }
    let step = (case.frame_count() * width * height / MOST_VALUES).max(1);
    let of_frame = |l: usize| -> Vec<AbsoluteDifferences> {
        let inner = (1..height - 1).flat_map(|y| (1..width - 1).map(move |x| (x, y)));
        inner
            .enumerate()
            .filter(|(n, _)| (n + l).is_multiple_of(step))
            .filter_map(|(_, (x, y))| AbsoluteDifferences::at(case, nominal, l, (x, y)))
            .collect()
    };
    let mut found: Vec<AbsoluteDifferences> =
        (1..case.frame_count() - 1).into_par_iter().flat_map_iter(of_frame).collect();
    found.sort_by(|a, b| a.signal_dn.total_cmp(&b.signal_dn));
    let size = (found.len() / LEVELS).max(FEWEST);
    let level = |level: &[AbsoluteDifferences]| {
        let least = (0..KINDS.len()).map(|kind| {
            let mut sizes: Vec<f64> = level.iter().map(|one| one.sizes[kind]).collect();
            let at = (QUANTILE.0 * sizes.len() as f64) as usize;
            let (_, size, _) = sizes.select_nth_unstable_by(at, f64::total_cmp);
            let deviation = *size / QUANTILE.1;
            deviation * deviation / KINDS[kind]
        });
        (level[level.len() / 2].signal_dn, least.fold(f64::INFINITY, f64::min))
    };
    let levels: Vec<(f64, f64)> = found.chunks_exact(size).map(level).collect();
    let (dark, shot) = line(&levels);
    (dark.max(stated.0), shot.max(stated.1))
}

/// Variances of the differences of independent values of variance 1.
const KINDS: [f64; 3] = [36.0, 54.0, 1.5];

/// Absolute differences around a value, in the order of [`KINDS`].
struct AbsoluteDifferences {
    /// Mean of 3 x 3 values, DN above black.
    signal_dn: f64,
    sizes: [f64; 3],
}

impl AbsoluteDifferences {
    /// None where a value is unknown or saturated.
    fn at(
        case: &Case,
        nominal: &Nominal,
        frame: usize,
        (x, y): (usize, usize),
    ) -> Option<AbsoluteDifferences> {
        const ALONG: [f64; 3] = [1.0, -2.0, 1.0];
        let width = case.extent.width as usize;
        let value = |frame: usize, x: usize, y: usize| {
            let dn = case.dn(frame, y * width + x);
            (dn < nominal.saturation_dn).then_some(dn)
        };
        let (mut sum, mut across, mut changing) = (0.0, 0.0, 0.0);
        for (dy, of_y) in ALONG.iter().enumerate() {
            for (dx, of_x) in ALONG.iter().enumerate() {
                let (x, y) = (x + dx - 1, y + dy - 1);
                let (here, around) =
                    (value(frame, x, y)?, 0.5 * (value(frame - 1, x, y)? + value(frame + 1, x, y)?));
                sum += here;
                across += of_x * of_y * here;
                changing += of_x * of_y * (here - around);
            }
        }
        let in_time = value(frame, x, y)? - 0.5 * (value(frame - 1, x, y)? + value(frame + 1, x, y)?);
        Some(AbsoluteDifferences {
            signal_dn: f64::max(sum / 9.0 - nominal.number.black_level, 0.0),
            sizes: [across.abs(), changing.abs(), in_time.abs()],
        })
    }
}

/// The line through variances at levels whose errors are shares of themselves, neither number negative.
pub(crate) fn line(levels: &[(f64, f64)]) -> (f64, f64) {
    let Some(least) = levels.iter().map(|level| level.1).min_by(f64::total_cmp) else { return (0.0, 0.0) };
    let (mut dark, mut shot) = (least, 0.0);
    for _ in 0..20 {
        let (mut s, mut sx, mut sxx, mut sy, mut sxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (x, y) in levels {
            let variance = f64::max(dark + shot * x, 1e-6);
            let w = 1.0 / (variance * variance);
            (s, sx, sxx, sy, sxy) = (s + w, sx + w * x, sxx + w * x * x, sy + w * y, sxy + w * x * y);
        }
        let determinant = s * sxx - sx * sx;
        let slope = if determinant > 1e-12 * s * sxx { (s * sxy - sx * sy) / determinant } else { 0.0 };
        shot = slope.max(0.0);
        dark = (sy - shot * sx) / s;
        if dark < 0.0 {
            (dark, shot) = (0.0, sxy / sxx);
        }
    }
    (dark, shot)
}
