//! Thresholds per pixel and polarity, estimated with the scene.
//!
//! Let m be the relative deviation of a threshold. An event's excess over its signed threshold is then m plus
//! noise. The mean over a pixel's events of one polarity, with Student-t weights and shrunk by the variance
//! s^2 of m over pixels, is subtracted. s^2 is estimated by expectation maximisation. The common part of all
//! pixels is excluded, as far as it exceeds the standard error of their mean. Scene and thresholds are
//! estimated alternately.

use super::super::fit::EventNoise;
use photocurrent_scene::free::{PixelPrediction, PredictedEvent};
use photocurrent_scene::statistics::NU;

/// Least standard deviation of thresholds over pixels, as a share of them.
const LEAST: f64 = 1e-4;
/// Least noise of events, as a share of thresholds.
const LEAST_NOISE: f64 = 1e-3;
/// Rounds of weights and sizes.
const ROUNDS: usize = 4;
/// Standard errors within which the mean of all pixels counts as zero.
const BY_CHANCE: f64 = 2.0;
/// Fewer pixels than this have no differences.
const FEWEST: usize = 20;

/// Spread of thresholds over pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct PixelThresholds {
    /// Standard deviation over pixels, as a share of thresholds.
    pub spread: f64,
}

/// Events of one pixel and polarity.
#[derive(Clone, Copy, Debug, Default)]
struct PolarityGroup {
    /// Sum of weights, and of weighted excesses.
    weight: f64,
    sum: f64,
    /// Relative deviation of its threshold.
    size: f64,
    /// Common part of all pixels, excluded from these.
    common: f64,
}

/// Excess of an event in its own direction, as a share of its threshold.
fn threshold_share(event: &PredictedEvent) -> f64 {
    event.polarity * event.excess / event.threshold
}

fn side(event: &PredictedEvent) -> usize {
    usize::from(event.polarity < 0.0)
}

impl PixelThresholds {
    /// Re-estimates the spread, and subtracts each pixel's thresholds from the prediction, for each event
    /// with those estimated from the pixel's other events.
    pub(super) fn estimate(&mut self, predicted: &mut [PixelPrediction]) {
        let (groups, weights) = self.groups(predicted);
        let seen: Vec<&PolarityGroup> = groups.iter().flatten().filter(|group| group.weight > 0.0).collect();
        if seen.len() < FEWEST {
            return;
        }
        let precision = 1.0 / (self.spread * self.spread);
        let of = |group: &&PolarityGroup| group.size * group.size + 1.0 / (group.weight + precision);
        let variance = seen.iter().map(of).sum::<f64>() / seen.len() as f64;
        self.subtract((&groups, &weights), predicted);
        self.spread = variance.sqrt().max(LEAST);
    }

    /// Subtracts each pixel's thresholds from the prediction, with the present spread.
    pub(super) fn apply(&self, predicted: &mut [PixelPrediction]) {
        let (groups, weights) = self.groups(predicted);
        if groups.iter().flatten().filter(|group| group.weight > 0.0).count() >= FEWEST {
            self.subtract((&groups, &weights), predicted);
        }
    }

    fn subtract(
        &self,
        (groups, weights): (&[[PolarityGroup; 2]], &[f64]),
        predicted: &mut [PixelPrediction],
    ) {
        let precision = 1.0 / (self.spread * self.spread);
        let mut weights = weights.iter();
        for (of, groups) in predicted.iter_mut().zip(groups) {
            for event in &mut of.events {
                let group = &groups[side(event)];
                let own = weights.next().copied().unwrap_or(0.0);
                // An event is no evidence of what it is itself measured against: a pixel with few would have
                // thresholds that explain them whatever the scene is.
                let sum = group.sum - own * (threshold_share(event) - group.common);
                let size = sum / (group.weight - own + precision);
                event.excess -= event.polarity * event.threshold * size;
            }
        }
    }

    /// Sums of each pixel's thresholds, [place][ON, OFF], and the weight of every event.
    fn groups(&self, predicted: &[PixelPrediction]) -> (Vec<[PolarityGroup; 2]>, Vec<f64>) {
        let events =
            || predicted.iter().enumerate().flat_map(|(n, of)| of.events.iter().map(move |e| (n, e)));
        let slope: Vec<f64> = events().map(|(_, event)| event.slope_per_s / event.threshold).collect();
        let precision = 1.0 / (self.spread * self.spread);
        let mut groups = vec![[PolarityGroup::default(); 2]; predicted.len()];
        let mut weights = vec![0.0; slope.len()];
        let mut common = [0.0; 2];
        for _ in 0..ROUNDS {
            let left = |(place, event): (usize, &PredictedEvent)| {
                threshold_share(event) - common[side(event)] - groups[place][side(event)].size
            };
            let left: Vec<f64> = events().map(left).collect();
            let noise = EventNoise::estimate(&left, &slope, LEAST_NOISE);
            groups.iter_mut().for_each(|group| *group = [PolarityGroup::default(); 2]);
            for (k, (place, event)) in events().enumerate() {
                let sigma = noise.sigma(slope[k]);
                let z = left[k] / sigma;
                weights[k] = (NU + 1.0) / (NU + z * z) / (sigma * sigma);
                let group = &mut groups[place][side(event)];
                group.weight += weights[k];
                group.sum += weights[k] * threshold_share(event);
            }
            for (side, common) in common.iter_mut().enumerate() {
                *common = self.common_offset(&groups, side);
            }
            for group in &mut groups {
                for (group, common) in group.iter_mut().zip(common) {
                    group.common = common;
                    group.sum -= group.weight * common;
                    group.size = group.sum / (group.weight + precision);
                }
            }
        }
        (groups, weights)
    }

    /// Common deviation of one polarity's thresholds, beyond the standard error of the pixels' mean.
    fn common_offset(&self, groups: &[[PolarityGroup; 2]], side: usize) -> f64 {
        let variance = self.spread * self.spread;
        let (mut sum, mut weight) = (0.0, 0.0);
        for group in groups.iter().map(|group| group[side]).filter(|group| group.weight > 0.0) {
            let certain = 1.0 / (variance + 1.0 / group.weight);
            sum += certain * group.sum / group.weight;
            weight += certain;
        }
        if weight <= 0.0 || sum == 0.0 {
            return 0.0;
        }
        let mean = sum / weight;
        mean * f64::max(1.0 - BY_CHANCE * BY_CHANCE / weight / (mean * mean), 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::random::Random;

    /// Pixels with events whose thresholds differ by a standard deviation of `spread`, with noise of 1 %.
    fn predicted(spread: f64, offset: f64) -> Vec<PixelPrediction> {
        let mut random = Random::new(3, &[]);
        let mut pixel = || {
            let own = [random.normal() * spread, random.normal() * spread];
            let mut event = |k: usize| {
                let polarity = if k.is_multiple_of(2) { 1.0 } else { -1.0 };
                let excess = polarity * 0.2 * (own[k % 2] + offset + 0.01 * random.normal());
                PredictedEvent {
                    polarity,
                    threshold: 0.2,
                    excess,
                    slope_per_s: 30.0,
                    ..PredictedEvent::default()
                }
            };
            PixelPrediction { events: (0..24).map(&mut event).collect(), ..PixelPrediction::default() }
        };
        (0..200).map(|_| pixel()).collect()
    }

    fn root_mean_square(predicted: &[PixelPrediction]) -> f64 {
        let sizes: Vec<f64> = predicted.iter().flat_map(|of| of.events.iter().map(threshold_share)).collect();
        (sizes.iter().map(|size| size * size).sum::<f64>() / sizes.len() as f64).sqrt()
    }

    #[test]
    fn thresholds_of_pixels_are_found_with_their_spread_and_leave_the_noise() {
        let mut own = PixelThresholds { spread: 0.05 };
        let mut of = predicted(0.03, 0.0);
        (0..3).for_each(|_| own.estimate(&mut of.clone()));
        own.apply(&mut of);
        assert!((own.spread / 0.03 - 1.0).abs() < 0.1, "{}", own.spread);
        // Twelve events a pixel and polarity: the mean of eleven others has an eleventh of the square.
        let expected = 0.01 * (12.0_f64 / 11.0).sqrt();
        assert!((root_mean_square(&of) / expected - 1.0).abs() < 0.05, "{}", root_mean_square(&of));
    }

    #[test]
    fn what_all_pixels_share_is_left_to_other_effects() {
        let (mut own, mut of) = (PixelThresholds { spread: 0.05 }, predicted(0.0, 0.04));
        (0..8).for_each(|_| own.estimate(&mut of.clone()));
        own.apply(&mut of);
        assert!(own.spread < 0.004, "{}", own.spread);
        assert!((root_mean_square(&of) - 0.0412).abs() < 0.002, "{}", root_mean_square(&of));
    }
}
