//! Fits size and gain of an effect to the residuals of events: Student-t noise with a threshold part and a
//! part that grows with the slope.

use photocurrent_scene::statistics::{MEDIAN_T, NU};
use std::ops::Range;

/// Standard deviation of residuals: `a` natural-log units (threshold), and `b` seconds times the slope
/// (stamps).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct EventNoise {
    /// Threshold part, natural-log units.
    pub a: f64,
    /// Stamp part, seconds.
    pub b: f64,
}

impl EventNoise {
    /// Scale of an event's residual.
    #[inline]
    pub(super) fn sigma(&self, slope_per_s: f64) -> f64 {
        libm::sqrt(self.a * self.a + self.b * self.b * slope_per_s * slope_per_s)
    }

    /// Largest distance of the residuals' probabilities under this noise from evenly spread ones (Kolmogorov
    /// and Smirnov).
    pub(super) fn distance(&self, residual: &[f64], slope_per_s: &[f64]) -> f64 {
        let mut probability: Vec<f64> = residual
            .iter()
            .zip(slope_per_s)
            .map(|(r, slope)| probability_t(r / self.sigma(*slope)))
            .collect();
        probability.sort_by(f64::total_cmp);
        let n = probability.len().max(1) as f64;
        let off = |(k, p): (usize, &f64)| f64::max(p - k as f64 / n, (k + 1) as f64 / n - p);
        probability.iter().enumerate().map(off).fold(0.0, f64::max)
    }

    /// From residuals: robust scales in eight bins of slope, fitted by `a^2 + b^2 slope^2`; at least `least`.
    pub(super) fn estimate(residual: &[f64], slope_per_s: &[f64], least: f64) -> EventNoise {
        EventNoise::in_order(residual, slope_per_s, &by_slope(slope_per_s), least)
    }

    fn in_order(residual: &[f64], slope_per_s: &[f64], order: &[usize], least: f64) -> EventNoise {
        const BINS: usize = 8;
        let mut points: Vec<(f64, f64)> = Vec::new();
        for bin in order.chunks(residual.len().div_ceil(BINS).max(1)) {
            let mut sizes: Vec<f64> = bin.iter().map(|&k| residual[k].abs()).collect();
            let middle = sizes.len() / 2;
            sizes.select_nth_unstable_by(middle, f64::total_cmp);
            let scale = sizes[middle] / MEDIAN_T;
            let slope = slope_per_s[bin[bin.len() / 2]];
            points.push((slope * slope, scale * scale));
        }
        // Relative errors: weights of one over the variance's square, two rounds.
        let (mut a2, mut b2) = (points.iter().map(|p| p.1).fold(f64::INFINITY, f64::min), 0.0);
        for _ in 0..4 {
            let (mut s, mut sx, mut sxx, mut sy, mut sxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for &(x, y) in &points {
                let variance = f64::max(a2 + b2 * x, 1e-12);
                let w = 1.0 / (variance * variance);
                s += w;
                sx += w * x;
                sxx += w * x * x;
                sy += w * y;
                sxy += w * x * y;
            }
            let determinant = s * sxx - sx * sx;
            let slope = if determinant > 1e-12 * s * sxx { (s * sxy - sx * sy) / determinant } else { 0.0 };
            b2 = slope.max(0.0);
            a2 = ((sy - b2 * sx) / s).max(least * least);
        }
        EventNoise { a: libm::sqrt(a2), b: libm::sqrt(b2) }
    }

    /// Log density of residuals.
    pub(super) fn log_density(&self, residual: &[f64], slope_per_s: &[f64]) -> f64 {
        residual
            .iter()
            .zip(slope_per_s)
            .map(|(r, slope)| log_t(r / self.sigma(*slope)) - libm::log(self.sigma(*slope)))
            .sum()
    }
}

/// Numbers of events by how fast the voltage moves.
fn by_slope(slope_per_s: &[f64]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..slope_per_s.len()).collect();
    order.sort_by(|&i, &j| slope_per_s[i].abs().total_cmp(&slope_per_s[j].abs()));
    order
}

/// Log density of Student's t with three degrees of freedom.
#[inline]
fn log_t(z: f64) -> f64 {
    const CONSTANT: f64 = -1.000_888_8;
    CONSTANT - 0.5 * (NU + 1.0) * libm::log1p(z * z / NU)
}

/// Probability of no more than `z` under Student's t with three degrees of freedom.
pub(super) fn probability_t(z: f64) -> f64 {
    let s = z / libm::sqrt(NU);
    0.5 + (s / (1.0 + s * s) + libm::atan(s)) / std::f64::consts::PI
}

/// Data of the residuals: events first, then frame values (of a scene known without them), each kind with its
/// own noise.
#[derive(Clone, Copy, Debug)]
pub(super) struct ResidualRows<'a> {
    /// How fast the voltage moves at events, ln/s; how bright frame values are, DN.
    pub slope: &'a [f64],
    /// Block of pixels; the last bit is the half that it belongs to.
    pub block: &'a [u32],
    /// Rows before this one are events.
    pub events: usize,
    /// Least noise, natural-log units.
    pub least: f64,
    /// Column of a picture that is too soft, with the bounds of its size: fitted with everything.
    pub soft: Option<SoftnessColumn<'a>>,
    /// Columns of the free parameters of the scene, per prior standard deviation: fitted with everything.
    pub free: &'a [EffectColumn],
}

/// Residual of each row where the picture is too soft, per unit size; sizes lie between `most` and 0.
#[derive(Clone, Copy, Debug)]
pub(super) struct SoftnessColumn<'a> {
    /// The column.
    pub column: &'a [f32],
    /// Its change of each log slope.
    pub log_slope: &'a [f32],
    /// At most so much, below 0.
    pub most: f64,
}

/// An effect's column and its change of each log slope, both per unit size.
#[derive(Clone, Debug, Default)]
pub(super) struct EffectColumn {
    /// Of residuals.
    pub of: Vec<f32>,
    /// Changes of log slopes; empty where it changes none.
    pub log_slope: Vec<f32>,
}

/// Least noise of frame values, DN: that of whole numbers.
const LEAST_DN: f64 = 0.3;

/// Noise of both kinds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RowNoise {
    events: EventNoise,
    frames: EventNoise,
}

impl RowNoise {
    /// Of events.
    pub(super) fn event_noise(&self) -> EventNoise {
        self.events
    }
}

/// Chosen rows, rising, in the order of their slopes.
struct ChosenRows {
    rows: Vec<usize>,
    slopes: Vec<f64>,
    events: Vec<usize>,
    frames: Vec<usize>,
}

impl ResidualRows<'_> {
    fn choose(&self, residual: &[f64], use_row: impl Fn(usize) -> bool) -> ChosenRows {
        let rows: Vec<usize> = (0..residual.len()).filter(|&k| use_row(k)).collect();
        let slopes: Vec<f64> = rows.iter().map(|&k| self.slope[k]).collect();
        let at = rows.partition_point(|&k| k < self.events);
        let (events, frames) = (by_slope(&slopes[..at]), by_slope(&slopes[at..]));
        ChosenRows { rows, slopes, events, frames }
    }

    /// Of chosen rows, with their residuals.
    fn noise(&self, chosen: &ChosenRows, residual: &[f64]) -> RowNoise {
        let at = chosen.events.len();
        let events = EventNoise::in_order(&residual[..at], &chosen.slopes[..at], &chosen.events, self.least);
        let frames = if chosen.frames.is_empty() {
            events
        } else {
            EventNoise::in_order(&residual[at..], &chosen.slopes[at..], &chosen.frames, LEAST_DN)
        };
        RowNoise { events, frames }
    }

    #[inline]
    fn sigma(&self, noise: &RowNoise, k: usize) -> f64 {
        if k < self.events { noise.events.sigma(self.slope[k]) } else { noise.frames.sigma(self.slope[k]) }
    }

    fn log(&self, noise: &RowNoise, k: usize, residual: f64) -> f64 {
        let sigma = self.sigma(noise, k);
        log_t(residual / sigma) - libm::log(sigma)
    }

    fn blocks(&self) -> usize {
        self.block.iter().copied().max().map_or(0, |last| last as usize + 1)
    }
}

/// Columns, fitted together.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct FittedColumns {
    /// Sizes, each in units of its column's own.
    pub size: Vec<f64>,
    /// Standard errors: half the difference between two halves of the blocks.
    pub error: Vec<f64>,
    /// Held-out gain, nats per event.
    pub gain: f64,
    /// Standard error of the gain, by blocks.
    pub gain_error: f64,
    /// Sizes of the free parameters of the scene ([`ResidualRows::free`]).
    pub free: Vec<f64>,
    /// Of one column, Fisher information of an event about its size: a small size gains half of this times
    /// its square, nats an event.
    pub information: f64,
}

/// Sizes and noise of a fit.
#[derive(Clone)]
struct SizesAndNoise {
    sizes: Vec<f64>,
    /// Of [`ResidualRows::free`].
    free: Vec<f64>,
    /// Of [`SoftnessColumn`].
    soft: f64,
    noise: RowNoise,
}

/// Fits columns together by iteratively reweighted least squares; returns sizes and noise.
pub(super) fn fit(
    residual: &[f64],
    rows: &ResidualRows<'_>,
    columns: &[&[f32]],
    use_row: impl Fn(usize) -> bool,
) -> (Vec<f64>, RowNoise) {
    let found = solve(residual, rows, columns, use_row);
    (found.sizes, found.noise)
}

fn solve(
    residual: &[f64],
    rows: &ResidualRows<'_>,
    columns: &[&[f32]],
    use_row: impl Fn(usize) -> bool,
) -> SizesAndNoise {
    let chosen = rows.choose(residual, use_row);
    let mut with: Vec<&[f32]> =
        columns.iter().copied().chain(rows.free.iter().map(|column| &column.of[..])).collect();
    let held = columns.len()..with.len();
    let split = |mut sizes: Vec<f64>, soft: f64, noise: RowNoise| {
        let free = sizes.split_off(held.start);
        SizesAndNoise { sizes, free, soft, noise }
    };
    let Some(soft) = rows.soft.filter(|soft| soft.most < 0.0) else {
        let (sizes, noise) = least_squares(residual, rows, &with, &held, &chosen);
        return split(sizes, 0.0, noise);
    };
    with.push(soft.column);
    let (mut sizes, noise) = least_squares(residual, rows, &with, &held, &chosen);
    with.pop();
    let size = sizes.pop().unwrap_or(0.0);
    if (soft.most..=0.0).contains(&size) {
        return split(sizes, size, noise);
    }
    let size = size.clamp(soft.most, 0.0);
    let (sizes, noise) = least_squares(&soft.without_softness(residual, size), rows, &with, &held, &chosen);
    split(sizes, size, noise)
}

impl SoftnessColumn<'_> {
    /// Residuals corrected for a size of it.
    fn without_softness(&self, residual: &[f64], size: f64) -> Vec<f64> {
        residual.iter().zip(self.column).map(|(r, column)| r + size * f64::from(*column)).collect()
    }
}

/// Residuals corrected for a picture that is too soft and for the free parameters of the scene.
pub(super) fn without_softness(residual: &[f64], rows: &ResidualRows<'_>) -> Vec<f64> {
    if rows.soft.is_none() && rows.free.is_empty() {
        return residual.to_vec();
    }
    let found = solve(residual, rows, &[], |_| true);
    let mut left =
        rows.soft.map_or_else(|| residual.to_vec(), |soft| soft.without_softness(residual, found.soft));
    for (column, size) in rows.free.iter().zip(&found.free) {
        left.iter_mut().zip(&column.of).for_each(|(left, column)| *left += size * f64::from(*column));
    }
    left
}

/// `held`: columns whose sizes have a standard deviation of 1 beforehand.
fn least_squares(
    residual: &[f64],
    rows: &ResidualRows<'_>,
    columns: &[&[f32]],
    held: &Range<usize>,
    chosen: &ChosenRows,
) -> (Vec<f64>, RowNoise) {
    let mut sizes = vec![0.0; columns.len()];
    let left = |sizes: &[f64]| -> Vec<f64> {
        chosen
            .rows
            .iter()
            .map(|&k| {
                residual[k]
                    + columns.iter().zip(sizes).map(|(column, size)| f64::from(column[k]) * size).sum::<f64>()
            })
            .collect()
    };
    let mut noise = rows.noise(chosen, &left(&sizes));
    if columns.is_empty() {
        return (sizes, noise);
    }
    for _ in 0..8 {
        let now = left(&sizes);
        let n = columns.len();
        let mut normal = nalgebra::DMatrix::<f64>::zeros(n, n);
        let mut right = nalgebra::DVector::<f64>::zeros(n);
        for (&k, r) in chosen.rows.iter().zip(&now) {
            let sigma = rows.sigma(&noise, k);
            let z = r / sigma;
            let weight = (NU + 1.0) / (NU + z * z) / (sigma * sigma);
            for i in 0..n {
                let a = f64::from(columns[i][k]);
                right[i] -= weight * a * r;
                for j in 0..=i {
                    normal[(i, j)] += weight * a * f64::from(columns[j][k]);
                }
            }
        }
        for i in held.clone() {
            normal[(i, i)] += 1.0;
            right[i] -= sizes[i];
        }
        for i in 0..n {
            normal[(i, i)] *= 1.0 + 1e-9;
            normal[(i, i)] += 1e-12;
            for j in 0..i {
                normal[(j, i)] = normal[(i, j)];
            }
        }
        let Some(step) = normal.cholesky().map(|factor| factor.solve(&right)) else { break };
        sizes.iter_mut().zip(step.iter()).for_each(|(size, step)| *size += step);
        if sizes.iter().zip(step.iter()).all(|(size, step)| step.abs() < 1e-3 * size.abs()) {
            break;
        }
        noise = rows.noise(chosen, &left(&sizes));
    }
    (sizes, noise)
}

/// Residuals with the logarithm of the slope at each event: the density of an event's time is that of its
/// residual times the slope. Frame values have none.
#[derive(Clone, Copy, Debug)]
pub(super) struct ResidualsAndSlopes<'a> {
    /// Residuals.
    pub residual: &'a [f64],
    /// Log slopes of the events.
    pub log_slope: &'a [f32],
    /// Their rows.
    pub rows: &'a ResidualRows<'a>,
}

impl ResidualsAndSlopes<'_> {
    fn log(&self, found: &SizesAndNoise, k: usize) -> f64 {
        let rows = self.rows;
        let soft = rows.soft.map_or((0.0, 0.0), |soft| {
            (f64::from(soft.column[k]), soft.log_slope.get(k).map_or(0.0, |log| f64::from(*log)))
        });
        let log_slope = self.log_slope.get(k).map_or(0.0, |log| f64::from(*log));
        let (mut residual, mut steeper) =
            (self.residual[k] + found.soft * soft.0, log_slope + found.soft * soft.1);
        for (column, size) in rows.free.iter().zip(&found.free) {
            residual += size * f64::from(column.of[k]);
            steeper += size * column.log_slope.get(k).map_or(0.0, |log| f64::from(*log));
        }
        rows.log(&found.noise, k, residual) + steeper
    }
}

/// Held-out gain of the residuals `left` over `before`, nats per event, and its standard error by blocks.
/// Noise is fitted to the other half of the blocks. Their rows differ by the free parameters of the scene
/// alone.
pub(super) fn gain_of(before: ResidualsAndSlopes<'_>, left: ResidualsAndSlopes<'_>) -> (f64, f64) {
    let rows = left.rows;
    let blocks = rows.blocks();
    let (mut gains, mut counts) = (vec![0.0; blocks], vec![0.0; blocks]);
    for half in 0..2_u32 {
        let train = |k: usize| rows.block[k] % 2 == half;
        let [with, plain] = [left, before].map(|rest| solve(rest.residual, rest.rows, &[], train));
        for k in (0..before.residual.len()).filter(|&k| !train(k)) {
            gains[rows.block[k] as usize] += left.log(&with, k) - before.log(&plain, k);
            counts[rows.block[k] as usize] += f64::from(u8::from(k < rows.events));
        }
    }
    mean_of_blocks(&gains, &counts)
}

/// Gain of each row by the residuals `left` over `before`, nats. Both use the noise (and softness) fitted to
/// `left`, so unchanged rows gain 0. Each has its own best free parameters of the scene.
pub(super) fn row_gains(before: ResidualsAndSlopes<'_>, left: ResidualsAndSlopes<'_>) -> Vec<f64> {
    let with = solve(left.residual, left.rows, &[], |_| true);
    let free = if left.rows.free.is_empty() {
        Vec::new()
    } else {
        solve(before.residual, before.rows, &[], |_| true).free
    };
    let plain = SizesAndNoise { sizes: Vec::new(), free, ..with.clone() };
    (0..before.residual.len()).map(|k| left.log(&with, k) - before.log(&plain, k)).collect()
}

/// Mean per event and its standard error.
fn mean_of_blocks(gains: &[f64], counts: &[f64]) -> (f64, f64) {
    let all: f64 = counts.iter().sum::<f64>().max(1.0);
    let gain = gains.iter().sum::<f64>() / all;
    let spread: f64 = gains.iter().zip(counts).map(|(g, n)| (g - gain * n) * (g - gain * n)).sum();
    (gain, libm::sqrt(spread) / all)
}

/// Residuals with no column, fitted on either half of the blocks.
pub(super) struct NullFit<'a> {
    residual: &'a [f64],
    rows: ResidualRows<'a>,
    halves: [SizesAndNoise; 2],
}

impl<'a> NullFit<'a> {
    /// Of residuals.
    pub(super) fn new(residual: &'a [f64], rows: ResidualRows<'a>) -> NullFit<'a> {
        let halves = [0_u32, 1].map(|half| solve(residual, &rows, &[], |k| rows.block[k] % 2 == half));
        NullFit { residual, rows, halves }
    }
}

impl NullFit<'_> {
    /// Held-out log-likelihood of an event's time, nats, of a density per second. `log_slope`: of the events.
    pub(super) fn nats_per_event(&self, log_slope: &[f32]) -> f64 {
        let rest = ResidualsAndSlopes { residual: self.residual, log_slope, rows: &self.rows };
        let events = self.rows.events.min(self.residual.len());
        let sum: f64 =
            (0..events).map(|k| rest.log(&self.halves[1 - (self.rows.block[k] % 2) as usize], k)).sum();
        sum / events.max(1) as f64
    }

    /// Fisher information of an event about the size of a column, under Student's t: that which free
    /// parameters of the scene cannot have.
    pub(super) fn information(&self, column: &EffectColumn) -> f64 {
        let events = self.rows.events.min(self.residual.len());
        let n = self.rows.free.len();
        let noise = &self.halves[0].noise;
        let (mut normal, mut right, mut own) =
            (nalgebra::DMatrix::<f64>::identity(n, n), nalgebra::DVector::<f64>::zeros(n), 0.0);
        // Frame values determine the parameters; their information on the column itself is not an event's.
        for k in 0..if n > 0 { self.residual.len() } else { events } {
            let weight = (NU + 1.0) / (NU + 3.0) / (self.rows.sigma(noise, k) * self.rows.sigma(noise, k));
            let of = f64::from(column.of[k]);
            own += weight * of * of;
            for i in 0..n {
                let a = weight * f64::from(self.rows.free[i].of[k]);
                right[i] += a * of;
                (0..n).for_each(|j| normal[(i, j)] += a * f64::from(self.rows.free[j].of[k]));
            }
        }
        let shared = normal.cholesky().map_or(0.0, |factor| factor.solve(&right).dot(&right));
        (own - shared).max(0.0) / events.max(1) as f64
    }
}

/// Gain of columns over none, on the half of the blocks that sizes and noise were not fitted to, nats an
/// event; size from all rows.
pub(super) fn heldout(plain: &NullFit<'_>, columns: &[&EffectColumn]) -> FittedColumns {
    let whole = plain;
    let NullFit { residual, rows, halves: plain } = plain;
    let blocks = rows.blocks();
    let mut gains = vec![0.0; blocks];
    let mut counts = vec![0.0; blocks];
    let mut halves = [Vec::new(), Vec::new()];
    let of: Vec<&[f32]> = columns.iter().map(|column| &column.of[..]).collect();
    let before = ResidualsAndSlopes { residual, log_slope: &[], rows };
    for half in 0..2_u32 {
        let train = |k: usize| rows.block[k] % 2 == half;
        let with = solve(residual, rows, &of, train);
        let plain = &plain[half as usize];
        let sum = |of: &dyn Fn(&EffectColumn) -> f64| {
            columns.iter().zip(&with.sizes).map(|(column, size)| of(column) * size).sum::<f64>()
        };
        let mut left = residual.to_vec();
        left.iter_mut().enumerate().for_each(|(k, left)| *left += sum(&|column| f64::from(column.of[k])));
        let steeper: Vec<f32> = (0..rows.events)
            .map(|k| sum(&|column| column.log_slope.get(k).map_or(0.0, |log| f64::from(*log))) as f32)
            .collect();
        let rest = ResidualsAndSlopes { residual: &left, log_slope: &steeper, rows };
        for k in (0..residual.len()).filter(|&k| !train(k)) {
            gains[rows.block[k] as usize] += rest.log(&with, k) - before.log(plain, k);
            counts[rows.block[k] as usize] += f64::from(u8::from(k < rows.events));
        }
        halves[half as usize] = with.sizes;
    }
    let SizesAndNoise { sizes: size, free, .. } = solve(residual, rows, &of, |_| true);
    let (gain, gain_error) = mean_of_blocks(&gains, &counts);
    let error = halves[0].iter().zip(&halves[1]).map(|(a, b)| 0.5 * (a - b).abs()).collect();
    let information = columns.first().map_or(0.0, |column| whole.information(column));
    FittedColumns { size, error, gain, gain_error, free, information }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::random::Random;

    const EVENTS: usize = 4_000;

    /// Slopes, blocks, noise of 0.02 and two columns that are partly alike.
    fn problem() -> (Vec<f64>, Vec<u32>, Vec<f64>, [Vec<f32>; 2]) {
        let mut random = Random::new(6, &[]);
        let slope: Vec<f64> = (0..EVENTS).map(|_| 20.0 * (1.0 + random.uniform())).collect();
        let block = (0..EVENTS as u32).map(|k| k % 32).collect();
        let noise = (0..EVENTS).map(|_| 0.02 * random.normal()).collect();
        let soft: Vec<f32> = (0..EVENTS).map(|_| random.normal() as f32).collect();
        let alike = soft.iter().map(|soft| 0.8 * soft + 0.6 * random.normal() as f32).collect();
        (slope, block, noise, [soft, alike])
    }

    fn rows<'a>(slope: &'a [f64], block: &'a [u32], soft: Option<SoftnessColumn<'a>>) -> ResidualRows<'a> {
        ResidualRows { slope, block, events: EVENTS, least: 1e-4, soft, free: &[] }
    }

    #[test]
    fn what_a_soft_picture_leaves_is_no_gain_of_what_looks_like_it() {
        let (slope, block, noise, [soft, alike]) = problem();
        let flat = vec![0.0; EVENTS];
        let residual: Vec<f64> =
            noise.iter().zip(&soft).map(|(noise, soft)| noise + 0.05 * f64::from(*soft)).collect();
        let column = EffectColumn { of: alike, log_slope: Vec::new() };
        let gain = |most: f64| {
            let soft = SoftnessColumn { column: &soft, log_slope: &flat, most };
            heldout(&NullFit::new(&residual, rows(&slope, &block, Some(soft))), &[&column])
        };
        let (without, with, half) = (gain(0.0), gain(-0.2), gain(-0.02));
        assert!(without.gain > 0.3, "{without:?}");
        assert!(with.gain.abs() < 0.01 && with.size[0].abs() < 0.003, "{with:?}");
        assert!(
            (0.05..without.gain).contains(&half.gain),
            "only as much is subtracted as is allowed: {half:?}"
        );
        let left = without_softness(
            &residual,
            &rows(&slope, &block, Some(SoftnessColumn { column: &soft, log_slope: &flat, most: -0.2 })),
        );
        left.iter().zip(&noise).for_each(|(left, noise)| assert!((left - noise).abs() < 0.01));
    }

    #[test]
    fn what_is_free_of_the_scene_is_no_gain_of_what_looks_like_it() {
        let (slope, block, noise, [free, alike]) = problem();
        let residual: Vec<f64> =
            noise.iter().zip(&free).map(|(noise, free)| noise + 0.05 * f64::from(*free)).collect();
        let columns = [EffectColumn { of: free, log_slope: Vec::new() }];
        let column = EffectColumn { of: alike, log_slope: Vec::new() };
        let without = heldout(&NullFit::new(&residual, rows(&slope, &block, None)), &[&column]);
        let with = heldout(
            &NullFit::new(&residual, ResidualRows { free: &columns, ..rows(&slope, &block, None) }),
            &[&column],
        );
        assert!(without.gain > 0.3, "{without:?}");
        assert!(
            with.gain.abs() < 0.01 && with.size[0].abs() < 0.003 && (with.free[0] + 0.05).abs() < 0.003,
            "{with:?}"
        );
        // Only the part of the column that is orthogonal to the parameter's determines its size: 0.36 of its
        // square.
        let plain = heldout(&NullFit::new(&noise, rows(&slope, &block, None)), &[&column]);
        let share = heldout(
            &NullFit::new(&noise, ResidualRows { free: &columns, ..rows(&slope, &block, None) }),
            &[&column],
        )
        .information
            / plain.information;
        assert!((share - 0.36).abs() < 0.03, "{share}");
    }

    #[test]
    fn too_much_blur_is_never_taken_for_softness() {
        let (slope, block, noise, [soft, _]) = problem();
        let flat = vec![0.0; EVENTS];
        let residual: Vec<f64> =
            noise.iter().zip(&soft).map(|(noise, soft)| noise - 0.05 * f64::from(*soft)).collect();
        let rows = rows(&slope, &block, Some(SoftnessColumn { column: &soft, log_slope: &flat, most: -0.2 }));
        assert_eq!(without_softness(&residual, &rows), residual);
    }

    #[test]
    fn a_voltage_that_moves_faster_makes_the_same_residuals_more_probable() {
        // The density of an event's time is that of its residual times the slope: half of the contrast, and
        // half of the residuals, gain nothing.
        let (slope, block, noise, _) = problem();
        let rows = rows(&slope, &block, None);
        let log = |by: f64| -> Vec<f32> { slope.iter().map(|slope| libm::log(by * slope) as f32).collect() };
        let half: Vec<f64> = noise.iter().map(|noise| 0.5 * noise).collect();
        let (full_log, half_log) = (log(1.0), log(0.5));
        let rest = |residual, log_slope| ResidualsAndSlopes { residual, log_slope, rows: &rows };
        let before = rest(&noise[..], &full_log[..]);
        let (gain, _) = gain_of(before, rest(&half, &half_log));
        assert!(gain.abs() < 1e-4, "{gain}");
        let (gain, _) = gain_of(before, rest(&noise, &half_log));
        assert!((gain + libm::log(2.0)).abs() < 1e-4, "{gain}");
        // To first order the same: a column that takes half of the residuals, and half of the slopes with it.
        let column = EffectColumn {
            of: noise.iter().map(|noise| -0.5 * *noise as f32).collect(),
            log_slope: vec![-0.5; EVENTS],
        };
        let found = heldout(&NullFit::new(&noise, rows), &[&column]);
        assert!((found.size[0] - 2.0).abs() < 0.1, "{found:?}");
    }
}
