//! How late events are against frames, over the whole picture, row by row, and over time.
//!
//! For each shift of a grid, the events between two shifted mid-exposures are summed at every place and held
//! against the log change of the frames. The shift with the largest correlation is how late events are: +5 ms
//! means that events are stamped 5 ms after the frames saw the same change.

use super::draw::{Estimate, by_draws, top};
use super::panel::Panel;

/// Shifts to each side of none.
const SHIFTS: usize = 40;
/// The largest shift is so much of the time from frame to frame.
const REACH: f64 = 1.0;
/// A weaker correlation is none: clear scenes have 0.5 to 0.9.
const LEAST_CORRELATION: f64 = 0.15;
/// Values beyond this share of all are brought to it: one hot pixel would be the largest signal of the
/// picture otherwise.
const KEPT: f64 = 0.997;
/// Pairs of frames for a drift, at least.
const FEWEST_FOR_DRIFT: usize = 8;

/// How late events are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shift {
    /// How late, ns; negative = early.
    pub ns: Estimate,
    /// Correlation there, 0 to 1.
    pub correlation: f64,
    /// Correlation without a shift.
    pub correlation_at_none: f64,
    /// Pairs of frames that were compared.
    pub pairs: usize,
}

/// How the shift changes over the recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    /// Change of the shift, ns a second: microseconds a second are parts in a million.
    pub ns_per_s: Estimate,
    /// From the first pair of frames to the last, s.
    pub over_s: f64,
    /// The same from each half of the picture, in squares like a chessboard; zero where one shows none.
    pub halves_ns_per_s: (f64, f64),
    /// Correlation with that change, and without one.
    pub correlation: f64,
    /// See there.
    pub correlation_at_none: f64,
}

/// Sums of products of each unit (pair of frames and part of the picture) at each shift.
struct Curves {
    /// Shifts, ns.
    shifts: Vec<f64>,
    /// Middle of each unit's pair, ns, and its part of the picture.
    units: Vec<(f64, u16)>,
    /// [shift][unit]: sums of (event x frame, event x event, frame x frame).
    sums: Vec<[f64; 3]>,
    pairs: usize,
}

impl Curves {
    fn of(panel: &Panel) -> Option<Curves> {
        let period = panel.period_ns()? as f64;
        let shifts: Vec<f64> =
            (0..=2 * SHIFTS).map(|n| (n as f64 / SHIFTS as f64 - 1.0) * REACH * period).collect();
        let parts = panel.part_count();
        let (places, pairs) = (panel.places(), panel.pairs());
        let mut curves =
            Curves { sums: vec![[0.0; 3]; shifts.len() * pairs * parts], units: Vec::new(), shifts, pairs };
        let mut counts = vec![0.0f32; places];
        let mut pair = 0;
        for stretch in &panel.stretches {
            let summed = stretch.summed(1.0, 1.0);
            for frame in 1..stretch.mids_ns.len() {
                let (from, to) = (stretch.mids_ns[frame - 1] as f64, stretch.mids_ns[frame] as f64);
                curves.units.extend((0..parts).map(|part| (0.5 * (from + to), part as u16)));
                let change = centred(
                    stretch
                        .logs(frame)
                        .iter()
                        .zip(stretch.logs(frame - 1))
                        .map(|(after, before)| after - before)
                        .collect(),
                );
                for (n, shift) in curves.shifts.iter().enumerate() {
                    counts.fill(0.0);
                    if !(stretch.add_at(&summed, to + shift, 1.0, &mut counts)
                        && stretch.add_at(&summed, from + shift, -1.0, &mut counts))
                    {
                        continue;
                    }
                    counts.iter_mut().zip(&panel.pixels).for_each(|(count, pixels)| *count /= *pixels as f32);
                    let counts = centred(counts.clone());
                    let at = &mut curves.sums[(n * pairs + pair) * parts..][..parts];
                    for ((count, change), part) in counts
                        .iter()
                        .zip(&change)
                        .zip(&panel.parts)
                        .filter(|((_, change), _)| change.is_finite())
                    {
                        let (x, y) = (f64::from(*count), f64::from(*change));
                        let sums = &mut at[usize::from(*part)];
                        *sums = [sums[0] + x * y, sums[1] + x * x, sums[2] + y * y];
                    }
                }
                pair += 1;
            }
        }
        Some(curves)
    }

    /// Correlation at each shift, of units by weight.
    fn correlation(&self, weights: &[f64]) -> Vec<f64> {
        let of = |sums: &[[f64; 3]]| {
            let total = sums.iter().zip(weights).fold([0.0; 3], |total, (sums, w)| {
                [total[0] + w * sums[0], total[1] + w * sums[1], total[2] + w * sums[2]]
            });
            total[0] / (total[1] * total[2]).sqrt().max(1e-30)
        };
        self.sums.chunks(self.units.len().max(1)).map(of).collect()
    }

    /// The shift with the largest correlation, ns; none at an end or without a clear one.
    fn best(&self, weights: &[f64]) -> Option<f64> {
        let curve = self.correlation(weights);
        let at = top(&curve)?;
        let step = self.shifts[1] - self.shifts[0];
        (curve[at.round() as usize] >= LEAST_CORRELATION).then(|| self.shifts[0] + at * step)
    }

    /// Of units that `takes` takes.
    fn shift(&self, takes: impl Fn(&(f64, u16)) -> bool) -> Option<Estimate> {
        // Units where nothing happens are most of them: to draw among them would change nothing and cost
        // time.
        let has = |n: &usize| {
            takes(&self.units[*n])
                && (0..self.shifts.len()).any(|shift| self.sums[shift * self.units.len() + n][1] > 0.0)
        };
        let some: Vec<usize> = (0..self.units.len()).filter(has).collect();
        if some.len() < 2 {
            return None;
        }
        let few = Curves {
            shifts: self.shifts.clone(),
            units: some.iter().map(|n| self.units[*n]).collect(),
            sums: (0..self.shifts.len())
                .flat_map(|shift| some.iter().map(move |n| self.sums[shift * self.units.len() + n]))
                .collect(),
            pairs: self.pairs,
        };
        by_draws(some.len(), |weights| few.best(weights))
    }
}

/// Less its median, with the largest values brought in.
fn centred(mut values: Vec<f32>) -> Vec<f32> {
    let mut known: Vec<f32> = values.iter().copied().filter(|value| value.is_finite()).collect();
    if known.is_empty() {
        return values;
    }
    let half = known.len() / 2;
    let middle = *known.select_nth_unstable_by(half, f32::total_cmp).1;
    known.iter_mut().for_each(|value| *value = (*value - middle).abs());
    let last = ((known.len() - 1) as f64 * KEPT) as usize;
    let limit = *known.select_nth_unstable_by(last, f32::total_cmp).1;
    values.iter_mut().for_each(|value| *value = (*value - middle).clamp(-limit, limit));
    values
}

/// How late events are against the frames; none where the two do not clearly agree at any shift of up to a
/// frame period, or nothing moves.
pub fn offset(panel: &Panel) -> Option<Shift> {
    let curves = Curves::of(panel)?;
    let ns = curves.shift(|_| true)?;
    let all = curves.correlation(&vec![1.0; curves.units.len()]);
    let correlation = all.iter().copied().fold(0.0, f64::max);
    Some(Shift { ns, correlation, correlation_at_none: all[SHIFTS], pairs: curves.pairs })
}

/// Parts of time that a drift is fitted over.
const TIMES: usize = 8;
/// Changes of the shift over the whole time that are tried, to each side of none.
const CHANGES: usize = 20;
/// The largest of them, as a part of the time from frame to frame.
const LARGEST_CHANGE: f64 = 0.8;

/// Shifts to each side of the one without a change at which a change is looked for.
const NEAR: usize = 12;

/// Sums by part of the picture and part of time.
struct Drifting {
    /// Shifts, ns.
    shifts: Vec<f64>,
    /// Middle of each part of time, -0.5 to 0.5 of the whole.
    times: Vec<f64>,
    /// [shift][time][part].
    sums: Vec<[f64; 3]>,
    parts: usize,
    over_s: f64,
}

impl Drifting {
    fn of(curves: &Curves, parts: usize) -> Option<Drifting> {
        let (first, last) = (curves.units.first()?.0, curves.units.last()?.0);
        let over = last - first;
        if over <= 0.0 {
            return None;
        }
        let time_of = |at: f64| (((at - first) / over * TIMES as f64) as usize).min(TIMES - 1);
        let (mut times, mut counts) = (vec![0.0; TIMES], vec![0.0f64; TIMES]);
        curves.units.iter().for_each(|unit| {
            times[time_of(unit.0)] += (unit.0 - first) / over - 0.5;
            counts[time_of(unit.0)] += 1.0;
        });
        times.iter_mut().zip(&counts).for_each(|(time, count)| *time /= count.max(1.0));
        let mut sums = vec![[0.0; 3]; curves.shifts.len() * TIMES * parts];
        for (n, of_shift) in curves.sums.chunks(curves.units.len()).enumerate() {
            for ((at, part), [xy, xx, yy]) in curves.units.iter().zip(of_shift) {
                let sum = &mut sums[(n * TIMES + time_of(*at)) * parts + usize::from(*part)];
                *sum = [sum[0] + xy, sum[1] + xx, sum[2] + yy];
            }
        }
        Some(Drifting { shifts: curves.shifts.clone(), times, sums, parts, over_s: over * 1e-9 })
    }

    /// Sums by shift and time, of parts by weight (and of times by weight).
    fn total(&self, of_part: &[f64], of_time: &[f64]) -> Vec<[f64; 3]> {
        let one = |(n, sums): (usize, &[[f64; 3]])| {
            let weight = of_time[n % TIMES];
            sums.iter().zip(of_part).fold([0.0; 3], |total: [f64; 3], (sums, w)| {
                std::array::from_fn(|k| total[k] + weight * w * sums[k])
            })
        };
        self.sums.chunks(self.parts).enumerate().map(one).collect()
    }

    /// Correlation when the shift is `shift` in the middle and changes by `change` over the whole time, both
    /// in steps of shifts.
    fn correlation(&self, total: &[[f64; 3]], shift: f64, change: f64) -> f64 {
        let mut sum = [0.0; 3];
        for (n, time) in self.times.iter().enumerate() {
            let at = (shift + change * time).clamp(0.0, (self.shifts.len() - 1) as f64);
            let (whole, part) = (libm::floor(at) as usize, at - libm::floor(at));
            let (before, after) =
                (total[whole * TIMES + n], total[(whole + 1).min(self.shifts.len() - 1) * TIMES + n]);
            sum = std::array::from_fn(|k| sum[k] + before[k] + part * (after[k] - before[k]));
        }
        sum[0] / (sum[1] * sum[2]).sqrt().max(1e-30)
    }

    fn change(n: usize) -> f64 {
        (n as f64 / CHANGES as f64 - 1.0) * LARGEST_CHANGE * SHIFTS as f64 / REACH
    }

    /// The shift without a change that agrees best, of all.
    fn middle(&self) -> usize {
        let total = self.total(&vec![1.0; self.parts], &[1.0; TIMES]);
        let of: Vec<f64> =
            (0..self.shifts.len()).map(|shift| self.correlation(&total, shift as f64, 0.0)).collect();
        (0..of.len()).max_by(|a, b| of[*a].total_cmp(&of[*b])).unwrap_or(SHIFTS)
    }

    /// The change over the whole time that agrees best, in steps of shifts, at a shift near `middle`, with
    /// the correlation there and without a change; none at an end or without a clear one.
    fn best(&self, middle: usize, of_part: &[f64], of_time: &[f64]) -> Option<(f64, f64, f64)> {
        let total = self.total(of_part, of_time);
        let near = middle.saturating_sub(NEAR)..(middle + NEAR + 1).min(self.shifts.len());
        let over_shifts = |change: f64| {
            near.clone()
                .map(|shift| self.correlation(&total, shift as f64, change))
                .fold(f64::NEG_INFINITY, f64::max)
        };
        let curve: Vec<f64> = (0..=2 * CHANGES).map(|n| over_shifts(Drifting::change(n))).collect();
        let at = top(&curve)?;
        let most = curve[at.round() as usize];
        let step = Drifting::change(1) - Drifting::change(0);
        (most >= LEAST_CORRELATION).then(|| (Drifting::change(0) + at * step, most, curve[CHANGES]))
    }
}

/// How the shift changes over the recording: the change at which events and frames agree best, one for the
/// whole picture, while the parts of the picture (and eighths of the time) are drawn anew for its interval.
/// None below eight pairs, or where the two do not clearly agree.
pub fn drift(panel: &Panel) -> Option<Drift> {
    if panel.pairs() < FEWEST_FOR_DRIFT {
        return None;
    }
    let curves = Curves::of(panel)?;
    let parts = panel.part_count();
    let drifting = Drifting::of(&curves, parts)?;
    let (middle, always) = (drifting.middle(), vec![1.0; TIMES]);
    let (_, correlation, correlation_at_none) = drifting.best(middle, &vec![1.0; parts], &always)?;
    let per_s = (drifting.shifts[1] - drifting.shifts[0]) / drifting.over_s;
    // Parts that hold something, and after them the times.
    let has =
        |part: usize| (0..TIMES).any(|time| drifting.sums[(SHIFTS * TIMES + time) * parts + part][1] > 0.0);
    let some: Vec<usize> = (0..parts).filter(|part| has(*part)).collect();
    let of = |drawn: &[f64]| {
        let mut weights = vec![0.0; parts];
        some.iter().zip(drawn).for_each(|(part, weight)| weights[*part] = *weight);
        drifting.best(middle, &weights, &always).map(|found| found.0 * per_s)
    };
    let ns_per_s = by_draws(some.len(), of)?;
    let over_times = by_draws(TIMES, |drawn| {
        drifting.best(middle, &vec![1.0; parts], drawn).map(|found| found.0 * per_s)
    })?;
    let half = |takes: usize| {
        let weights: Vec<f64> = (0..parts)
            .map(|part| {
                f64::from(u8::from((part / super::panel::ACROSS + part % super::panel::ACROSS) % 2 == takes))
            })
            .collect();
        drifting.best(middle, &weights, &always).map_or(0.0, |found| found.0 * per_s)
    };
    let ci95 = (ns_per_s.ci95.0.min(over_times.ci95.0), ns_per_s.ci95.1.max(over_times.ci95.1));
    Some(Drift {
        ns_per_s: Estimate { ci95, ..ns_per_s },
        over_s: drifting.over_s,
        halves_ns_per_s: (half(0), half(1)),
        correlation,
        correlation_at_none,
    })
}

/// The largest correlation at any shift of up to a frame period, when events of each place are those of
/// another: `from` gives the place, [`super::NOWHERE`] for none.
pub fn agreement_from(panel: &Panel, from: &[u32]) -> f64 {
    /// Shifts to each side of none: fewer than for an offset, as only the height of the top counts.
    const COARSE: usize = 8;
    let Some(period) = panel.period_ns() else { return 0.0 };
    let (places, mut sums) = (panel.places(), vec![[0.0; 3]; 2 * COARSE + 1]);
    let (mut counts, mut moved) = (vec![0.0f32; places], vec![0.0f32; places]);
    for stretch in &panel.stretches {
        let summed = stretch.summed(1.0, 1.0);
        for frame in 1..stretch.mids_ns.len() {
            let (before, after) = (stretch.mids_ns[frame - 1] as f64, stretch.mids_ns[frame] as f64);
            let change = centred(
                stretch
                    .logs(frame)
                    .iter()
                    .zip(stretch.logs(frame - 1))
                    .map(|(after, before)| after - before)
                    .collect(),
            );
            for (n, sums) in sums.iter_mut().enumerate() {
                let shift = (n as f64 / COARSE as f64 - 1.0) * REACH * period as f64;
                counts.fill(0.0);
                if !(stretch.add_at(&summed, after + shift, 1.0, &mut counts)
                    && stretch.add_at(&summed, before + shift, -1.0, &mut counts))
                {
                    continue;
                }
                let of = |place: u32| {
                    counts
                        .get(place as usize)
                        .map_or(0.0, |count| count / panel.pixels[place as usize] as f32)
                };
                moved.iter_mut().zip(from).for_each(|(moved, from)| *moved = of(*from));
                for (count, change) in
                    centred(moved.clone()).iter().zip(&change).filter(|(_, change)| change.is_finite())
                {
                    let (x, y) = (f64::from(*count), f64::from(*change));
                    *sums = [sums[0] + x * y, sums[1] + x * x, sums[2] + y * y];
                }
            }
        }
    }
    sums.iter().map(|[xy, xx, yy]| xy / (xx * yy).sqrt().max(1e-30)).fold(0.0, f64::max)
}

/// How much later each row is exposed than the one before, ns: the shift by bands of rows, over rows. The
/// frames' middles must be those of row 0. None where too few bands move.
pub fn row_time(panel: &Panel) -> Option<Estimate> {
    /// Bands of rows that have a shift, at least.
    const FEWEST_BANDS: usize = 4;
    let curves = Curves::of(panel)?;
    let across = super::panel::ACROSS as u16;
    let bands = panel.part_count() as u16 / across;
    let mut points: Vec<(f64, f64, f64)> = Vec::new();
    for band in 0..bands {
        let rows: Vec<f64> = panel
            .rows
            .iter()
            .zip(&panel.parts)
            .filter(|(_, part)| **part / across == band)
            .map(|(row, _)| f64::from(*row))
            .collect();
        if let Some(found) = curves.shift(|unit| unit.1 / across == band) {
            let sigma =
                ((found.ci95.1 - found.ci95.0) / 3.92).max(0.02 * (curves.shifts[1] - curves.shifts[0]));
            points.push((rows.iter().sum::<f64>() / rows.len() as f64, found.value, sigma));
        }
    }
    if points.len() < FEWEST_BANDS {
        return None;
    }
    by_draws(points.len(), |weights| slope(&points, weights)).map(|found| {
        // Few bands draw too narrow an interval at times: that of their own errors is the least.
        let sigma = slope_error(&points);
        Estimate {
            ci95: (
                found.ci95.0.min(found.value - 1.96 * sigma),
                found.ci95.1.max(found.value + 1.96 * sigma),
            ),
            ..found
        }
    })
}

/// Of a straight line through points (x, y, sigma), by the median of slopes of pairs: a band with a wrong top
/// moves it little.
fn slope(points: &[(f64, f64, f64)], weights: &[f64]) -> Option<f64> {
    let mut slopes: Vec<(f64, f64)> = Vec::new();
    for (n, a) in points.iter().enumerate() {
        for (m, b) in points.iter().enumerate().skip(n + 1) {
            let weight = weights[n] * weights[m] * (b.0 - a.0).abs() / libm::hypot(a.2, b.2);
            if weight > 0.0 {
                slopes.push(((b.1 - a.1) / (b.0 - a.0), weight));
            }
        }
    }
    slopes.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * slopes.iter().map(|slope| slope.1).sum::<f64>();
    let mut below = 0.0;
    slopes
        .iter()
        .find(|slope| {
            below += slope.1;
            below >= half
        })
        .map(|slope| slope.0)
}

fn slope_error(points: &[(f64, f64, f64)]) -> f64 {
    let weight: f64 = points.iter().map(|point| 1.0 / (point.2 * point.2)).sum();
    let mean = points.iter().map(|point| point.0 / (point.2 * point.2)).sum::<f64>() / weight;
    (1.0 / points.iter().map(|point| (point.0 - mean) * (point.0 - mean) / (point.2 * point.2)).sum::<f64>())
        .sqrt()
}
