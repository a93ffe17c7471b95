//! Random effects as variance components of the residuals, each with its gain in nats per event, comparable
//! with that of effects with a column.
//!
//! With u = polarity times residual over threshold: thresholds that differ between pixels are a size of the
//! threshold's column per pixel, refractory periods that differ one of the refractory period's. Threshold
//! noise and stamp noise widen u. An event without a crossing has any u between -2 and 0. After a lost event
//! the next one has one more threshold.
//!
//! Errors of a picture widen u too, but alike in all pixels at the same place of it. So only the share of the
//! squares that such pixels do not have in common ([`white_share`]) counts as noise of pixels.

use super::EventResiduals;
use super::fit::{EventNoise, ResidualRows, fit};
use crate::candidates::CANDIDATES;
use photocurrent_scene::SceneCell;
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::statistics::NU;
use photocurrent_scene::statistics::median;

/// One variance component: its candidate, gain in nats per event, and size.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct VarianceComponent {
    /// Number in [`CANDIDATES`].
    pub candidate: usize,
    /// Held-out gain over the plain distribution, nats an event.
    pub gain: f64,
    /// Size: a standard deviation or a share, in the unit of the parts' own.
    pub size: f64,
    /// Residuals corrected for its shifts; `None` where it only widens them.
    pub left: Option<Vec<f64>>,
}

/// Data of the fits: residuals, columns and blocks.
pub(super) struct ComponentData<'a> {
    /// The events.
    pub events: &'a EventResiduals,
    /// Their residuals, natural-log units, with whatever was found applied.
    pub residual: &'a [f64],
    /// Columns of the threshold's scale and of the refractory period, natural-log units per effect size.
    pub columns: [&'a [f32]; 2],
    /// Share of the squares that is noise of pixels, 0 to 1.
    pub white: f64,
    /// Mean threshold, natural-log units.
    pub threshold: f64,
    /// Can errors of the scene reach a part of a threshold?
    pub errs: bool,
    /// Least threshold noise.
    pub least: f64,
    /// Least gain of the spread of delays, nats an event.
    pub least_spread: f64,
}

/// Events of a pixel below this are too few for its own size.
const LEAST_OF_PIXEL: usize = 2;
/// And pixels below this for a spread of sizes.
const LEAST_PIXELS: usize = 20;
/// Residual share of squares below which differences between pixels explain the spread, and not noise of
/// single events.
const MOST_LEFT: f64 = 0.5;
/// Largest share of events with errors of the scene; above it no share would be left for noise.
const MOST_ERRS: f64 = 0.5;
/// Pairs of events below this are too few for a share.
const LEAST_PAIRS: usize = 200;

/// Share of the residual squares that pixels at the same place of the picture do not have in common, 0 to 1;
/// 0 where too few share one. Per event: `pixel`, `polarity`, and the cell of the picture (`cells`).
pub(super) fn white_share((pixel, polarity): (&[u32], &[i8]), residual: &[f64], cells: &[SceneCell]) -> f64 {
    let mut sizes: Vec<f64> = residual.iter().map(|r| r.abs()).collect();
    let most = 4.0 * median(&mut sizes);
    let mut order: Vec<((SceneCell, i8), u32, usize)> =
        (0..residual.len()).map(|k| ((cells[k], polarity[k]), pixel[k], k)).collect();
    order.sort_unstable();
    let (mut products, mut squares, mut pairs) = (0.0, 0.0, 0);
    for pair in order.windows(2).filter(|pair| pair[0].0 == pair[1].0 && pair[0].1 != pair[1].1) {
        let (a, b) = (residual[pair[0].2].clamp(-most, most), residual[pair[1].2].clamp(-most, most));
        products += a * b;
        squares += 0.5 * (a * a + b * b);
        pairs += 1;
    }
    if pairs < LEAST_PAIRS || squares == 0.0 { 0.0 } else { (1.0 - products / squares).clamp(0.0, 1.0) }
}

/// The effects that are differences between pixels, in the order of [`ComponentData::columns`].
pub(super) const SPREADS: [&str; 2] = [MISMATCH, SPREAD];
pub(super) const MISMATCH: &str = "threshold_mismatch";
const SPREAD: &str = "refractory_spread";

/// Fit of a distribution with a random effect to residuals.
struct WiderFit {
    /// Nats an event.
    gain: f64,
    size: f64,
    /// Residuals corrected for each pixel's shift or the mean shift; `None` without shifts.
    left: Option<Vec<f64>>,
}

/// All variance components of a recording.
///
/// `noise`: of the distribution without them, usually the control's.
pub(super) fn variance_components(ground: &ComponentData<'_>, noise: &EventNoise) -> Vec<VarianceComponent> {
    let find = |id: &str| CANDIDATES.iter().position(|candidate| candidate.id == id && candidate.is_random);
    let own = EventNoise::estimate(ground.residual, &ground.events.slope_per_s, ground.least);
    let mut found = Vec::new();
    let mut push = |id: &str, WiderFit { gain, size, left }: WiderFit| {
        if let Some(candidate) = find(id) {
            found.push(VarianceComponent { candidate, gain, size, left });
        }
    };
    let mismatch = ground.fit_pixel_spread(&own, ground.columns[0], true);
    let spread = ground.fit_pixel_spread(&own, ground.columns[1], false);
    // Noise of single events is what differences between pixels leave.
    let larger = if mismatch.gain > spread.gain { &mismatch } else { &spread };
    let rest = larger.left.clone().unwrap_or_else(|| ground.residual.to_vec());
    push(MISMATCH, mismatch);
    push(SPREAD, spread);
    let slope_square =
        median(&mut ground.events.slope_per_s.iter().map(|slope| slope * slope).collect::<Vec<f64>>());
    let left = EventNoise::estimate(&rest, &ground.events.slope_per_s, ground.least);
    let shared = libm::sqrt(1.0 - ground.white);
    let is_of_pixels = left.a * left.a + left.b * left.b * slope_square
        < MOST_LEFT * (own.a * own.a + own.b * own.b * slope_square);
    let before = if is_of_pixels {
        left
    } else {
        EventNoise { a: f64::max(noise.a, shared * left.a), b: f64::max(noise.b, shared * left.b) }
    };
    push(
        "threshold_noise",
        ground.fit_wider_noise(&rest, &before, &EventNoise { a: left.a, b: before.b }, left.a),
    );
    let of_stamps = ground.fit_wider_noise(&rest, &before, &EventNoise { a: before.a, b: left.b }, left.b);
    let of_comparators = ground.fit_delay_spread(noise).filter(|late| late.gain > of_stamps.gain);
    push("timestamp_jitter", of_comparators.unwrap_or(of_stamps));
    let early = |u: f64, _| if (-2.0..0.0).contains(&u) { 0.5 } else { 0.0 };
    let late = |u: f64, _| if (0.0..2.0).contains(&u) { 0.5 } else { 0.0 };
    // As many may come too early because the scene errs as come too late.
    let errs =
        if ground.errs { 2.0 * ground.mixture(&own, &late, 0.0).size.min(MOST_ERRS / 2.0) } else { 0.0 };
    push("background_activity", ground.mixture(&own, &early, errs));
    let lost = |u: f64, sigma: f64| {
        [0.5, 0.25, 0.125, 0.0625]
            .iter()
            .enumerate()
            .map(|(n, share)| share * density((u - 1.0 - n as f64) / sigma) / sigma)
            .sum()
    };
    push("event_loss", ground.mixture(&own, &lost, 0.0));
    found
}

/// Density of Student's t with three degrees of freedom.
fn density(z: f64) -> f64 {
    let base = 1.0 + z * z / NU;
    0.367_552_596_947_861_4 / (base * base)
}

impl ComponentData<'_> {
    fn u(&self, k: usize) -> f64 {
        f64::from(self.events.polarity[k]) * self.residual[k] / self.threshold
    }

    fn sigma(&self, noise: &EventNoise, k: usize) -> f64 {
        noise.sigma(self.events.slope_per_s[k]) / self.threshold
    }

    /// Gain of a wider distribution, and its size.
    fn fit_wider_noise(
        &self,
        residual: &[f64],
        before: &EventNoise,
        after: &EventNoise,
        size: f64,
    ) -> WiderFit {
        let slope = &self.events.slope_per_s;
        let gain = after.log_density(residual, slope) - before.log_density(residual, slope);
        WiderFit { gain: gain / residual.len().max(1) as f64, size, left: None }
    }

    /// Random comparator delays: residuals and their spread grow with the slope. Gain, standard deviation of
    /// the delay (s) and residuals corrected for the mean delay; `None` where delays do not vary.
    fn fit_delay_spread(&self, noise: &EventNoise) -> Option<WiderFit> {
        let slope = &self.events.slope_per_s;
        let column: Vec<f32> = slope.iter().map(|slope| -*slope as f32).collect();
        let rows =
            ResidualRows { slope, block: &[], events: slope.len(), least: self.least, soft: None, free: &[] };
        let (size, left) = fit(self.residual, &rows, &[&column], |_| true);
        let left = left.event_noise();
        if size[0] <= 0.0 {
            return None;
        }
        let rest: Vec<f64> =
            self.residual.iter().zip(slope).map(|(residual, slope)| residual - size[0] * slope).collect();
        let plain = EventNoise::estimate(self.residual, slope, self.least);
        let jitter = f64::min(left.b, size[0]);
        // Only what the spread adds is for this effect: a delay alone is another's.
        let alone = EventNoise { a: f64::max(left.a, noise.a), b: noise.b };
        let with = EventNoise { a: f64::max(left.a, noise.a), b: f64::max(left.b, noise.b) };
        if with.log_density(&rest, slope) - alone.log_density(&rest, slope)
            < self.least_spread * rest.len() as f64
        {
            return None;
        }
        let gain = (with.log_density(&rest, slope) - plain.log_density(self.residual, slope))
            / rest.len().max(1) as f64;
        Some(WiderFit { gain, size: jitter, left: Some(rest) })
    }

    /// A size of a column of each pixel's own, or of each of its polarities: gain of predicting each event
    /// from the others of its pixel, the standard deviation over pixels in effect sizes, and the residuals
    /// with each pixel's size applied.
    fn fit_pixel_spread(&self, noise: &EventNoise, column: &[f32], by_polarity: bool) -> WiderFit {
        let n = self.residual.len();
        let mut order: Vec<usize> = (0..n).collect();
        let key = |k: usize| (self.events.pixel[k], if by_polarity { self.events.polarity[k] } else { 0 });
        order.sort_by_key(|&k| (key(k), k));
        let sized = |events: &[usize]| {
            let (size, weight) = self.weighted_size(noise, column, events.iter().copied());
            (events.len() >= LEAST_OF_PIXEL && weight > 0.0).then(|| (events.to_vec(), size, weight))
        };
        let pixels: Vec<(Vec<usize>, f64, f64)> =
            order.chunk_by(|&a, &b| key(a) == key(b)).filter_map(sized).collect();
        let nothing = WiderFit { gain: 0.0, size: 0.0, left: Some(self.residual.to_vec()) };
        if pixels.len() < LEAST_PIXELS {
            return nothing;
        }
        let mut sizes: Vec<f64> = pixels.iter().map(|pixel| pixel.1).collect();
        let middle = median(&mut sizes);
        // Robust variance of the sizes beyond their own error, which is that of half of the events against
        // the other half.
        let mut far: Vec<f64> = pixels.iter().map(|pixel| (pixel.1 - middle).abs()).collect();
        let mut errors: Vec<f64> = pixels
            .iter()
            .map(|(events, ..)| {
                let half = |parity: usize| {
                    self.weighted_size(noise, column, events.iter().copied().skip(parity).step_by(2)).0
                };
                0.5 * (half(0) - half(1)).abs()
            })
            .collect();
        let (spread, error) = (1.4826 * median(&mut far), 1.4826 * median(&mut errors));
        let variance = spread * spread - error * error;
        if variance <= 0.0 {
            return nothing;
        }
        let mut left = self.residual.to_vec();
        let mut alike = self.residual.to_vec();
        for (events, size, weight) in &pixels {
            for &k in events {
                let (x, own) = (f64::from(column[k]), self.weight(noise, k));
                let rest = weight - own * x * x;
                if rest <= 0.0 {
                    continue;
                }
                let others = (weight * size + own * x * self.residual[k]) / rest - middle;
                alike[k] = self.residual[k] + x * middle;
                left[k] = alike[k] + x * others * variance / (variance + 1.0 / rest);
            }
        }
        // Each with the noise that it leaves; a size that all pixels share is no difference between them.
        let density = |residual: &[f64]| {
            let slope = &self.events.slope_per_s;
            EventNoise::estimate(residual, slope, self.least).log_density(residual, slope)
        };
        let gain = (density(&left) - density(&alike)) / n as f64;
        WiderFit { gain, size: libm::sqrt(variance), left: Some(left) }
    }

    /// The size of a column that some events of a pixel want, and its weight.
    fn weighted_size(
        &self,
        noise: &EventNoise,
        column: &[f32],
        events: impl Iterator<Item = usize>,
    ) -> (f64, f64) {
        let (mut weight, mut sum) = (0.0, 0.0);
        for k in events {
            let (x, own) = (f64::from(column[k]), self.weight(noise, k));
            weight += own * x * x;
            sum -= own * x * self.residual[k];
        }
        (sum / f64::max(weight, 1e-300), weight)
    }

    fn weight(&self, noise: &EventNoise, k: usize) -> f64 {
        let sigma = noise.sigma(self.events.slope_per_s[k]);
        let z = self.residual[k] / sigma;
        (NU + 1.0) / (NU + z * z) / (sigma * sigma)
    }

    /// A mixture with another distribution, by expectation maximisation: gain and share of the events. A
    /// share `errs` of all has errors of the scene, uniform within two thresholds.
    fn mixture(&self, noise: &EventNoise, other: &dyn Fn(f64, f64) -> f64, errs: f64) -> WiderFit {
        let densities: Vec<(f64, f64)> = (0..self.residual.len())
            .map(|k| {
                let (u, sigma) = (self.u(k), self.sigma(noise, k));
                let of_scene = if u.abs() < 2.0 { 0.25 } else { 0.0 };
                ((1.0 - errs) * density(u / sigma) / sigma + errs * of_scene, other(u, sigma))
            })
            .collect();
        let n = densities.len().max(1) as f64;
        let mut share: f64 = 0.02;
        for _ in 0..60 {
            share = densities
                .iter()
                .map(|(plain, other)| share * other / (share * other + (1.0 - share) * plain))
                .sum::<f64>()
                / n;
        }
        let gain: f64 =
            densities.iter().map(|(plain, other)| libm::log1p(share * (other / plain - 1.0))).sum();
        WiderFit { gain: gain / n, size: share, left: None }
    }
}

/// The parameter of a component's size beyond the control's, in the unit of its declaration. `effect_sizes`:
/// one effect size of the threshold's scale, as a share, and of the refractory period, s.
pub(super) fn component_parameter(
    part: &VarianceComponent,
    control: f64,
    threshold: f64,
    effect_sizes: (f64, f64),
    nominal: &Nominal,
    events_per_pixel_s: f64,
) -> f64 {
    let beyond = libm::sqrt(f64::max(part.size * part.size - control * control, 0.0));
    match CANDIDATES[part.candidate].id {
        MISMATCH => beyond * effect_sizes.0 * threshold,
        // In log of the period.
        SPREAD => {
            beyond * effect_sizes.1 / f64::max(nominal.pixel.refractory_ns as f64 * 1e-9, LEAST_REFRACTORY_S)
        }
        "background_activity" => f64::max(part.size - control, 0.0) * events_per_pixel_s,
        "event_loss" => f64::max(part.size - control, 0.0),
        _ => beyond,
    }
}

/// Where no refractory period is stated.
const LEAST_REFRACTORY_S: f64 = 50e-6;

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::random::Random;

    /// Gain and share of surplus events, where a share of the events misses by any part of two thresholds: on
    /// either side, or too early alone.
    fn events_too_many(share: f64, on_either_side: bool, errs: bool) -> (f64, f64) {
        let mut random = Random::new(4, &[]);
        let (count, threshold) = (6_000, 0.2);
        let mut events = EventResiduals::default();
        let mut residual = Vec::with_capacity(count);
        for k in 0..count {
            let polarity = if k % 2 == 0 { 1.0 } else { -1.0 };
            let far = if on_either_side { 4.0 * random.uniform() - 2.0 } else { -2.0 * random.uniform() };
            let missed = if random.uniform() < share { far } else { 0.01 * random.normal() };
            events.pixel.push(k as u32);
            events.polarity.push(polarity as i8);
            events.slope_per_s.push(10.0);
            residual.push(polarity * missed * threshold);
        }
        let column = vec![0.0; count];
        let columns = [&column[..], &column[..]];
        let ground = ComponentData {
            events: &events,
            residual: &residual,
            columns,
            white: 1.0,
            threshold,
            errs,
            least: 0.001 * threshold,
            least_spread: 0.01,
        };
        let found = variance_components(&ground, &EventNoise { a: 0.01 * threshold, b: 0.0 });
        let is_too_many = |part: &&VarianceComponent| CANDIDATES[part.candidate].id == "background_activity";
        found.iter().find(is_too_many).map_or((0.0, 0.0), |part| (part.gain, part.size))
    }

    #[test]
    fn what_comes_too_early_counts_as_far_as_less_comes_too_late() {
        // A scene that errs by parts of a threshold errs either way.
        let (alone, _) = events_too_many(0.05, true, false);
        let (gain, share) = events_too_many(0.05, true, true);
        assert!(alone > 0.03 && gain < 0.1 * alone && share < 0.005, "{alone} to {gain}, {share}");
        // Events without a crossing come too early alone.
        let (alone, _) = events_too_many(0.03, false, false);
        let (gain, share) = events_too_many(0.03, false, true);
        assert!(gain > 0.9 * alone && (share - 0.03).abs() < 0.006, "{alone} to {gain}, {share}");
    }
}
