//! Estimates the error of an alignment from events and the change of the frames, to a fraction of a pixel.
//!
//! From one frame to the next, the signed events of an event pixel count the change of the frames' logarithm
//! at its place, over the threshold. With counts e of pixel p, the frames' change C and the rate of its
//! events e', the residual is
//!
//! r = e + (late + later / light) e' - g C(place(p) + shift(p)),
//!
//! where g is the inverse of the threshold, one for rising and one for falling light. `late` is the delay of
//! the events, which is estimated as well. Light that moves in one direction leaves shift and delay open, and
//! the interval shows that. The shift is constant or affine over the array; Gauss-Newton steps with Huber's
//! weights, from the best of whole pixels.
//!
//! A dim pixel is later than a bright one, which looks like a shift along the motion: a part of the delay is
//! inverse to the light.
//!
//! Limits: shifts of up to three pixels; frames are compared in the middle of their exposures, blur smooths
//! their change; objects at another distance than the rest (parallax) are not one of the forms.

use crate::image::Image;
use nalgebra::{SMatrix, SVector};
use photocurrent_sensor::estimate::{Estimate, by_draws};
use rayon::prelude::*;

/// Parts of the array along either side: units of the bootstrap of errors.
pub const PARTS: usize = 8;
/// Unknowns: two gains, how late, how much later in dim light, the shift, its change along columns and along
/// rows.
const MOST: usize = 10;
/// The first of those of the shift.
const SHIFT: usize = 4;
/// Whole pixels that are tried to either side.
const WHOLE: i32 = 3;
/// Most steps, and the change, pixels, that ends them.
const STEPS: usize = 25;
const ENOUGH: f64 = 1e-3;
/// A step's longest shift, pixels.
const LONGEST: f64 = 0.5;
/// Huber's limit, in robust standard deviations.
const HUBER: f64 = 1.5;
/// Least number of samples.
const FEWEST: usize = 500;

type ShiftUnknowns = SVector<f64, MOST>;
type ShiftNormal = SMatrix<f64, MOST, MOST>;

/// One event pixel between two frames.
#[derive(Clone, Copy, Debug)]
pub struct ShiftSample {
    /// Which pair of frames.
    pub pair: u32,
    /// Part of the array, below [`PARTS`] squared.
    pub part: u16,
    /// Its place on the frames by the alignment, pixels.
    pub place: (f32, f32),
    /// Its place on the array, -1 to 1 along either side.
    pub at: (f32, f32),
    /// Signed events.
    pub count: f32,
    /// By how much that grows a period later.
    pub rate: f32,
    /// Inverse of the light there, 1 in usual light.
    pub dimness: f32,
}

/// How a shift varies over the array.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShiftForm {
    /// One for the array.
    Constant,
    /// One that changes along columns and rows.
    Affine,
}

/// A shift and its uncertainty.
#[derive(Clone, Debug)]
pub struct Misalignment {
    /// Shift of the places in the middle of the array, pixels of the frames, with 95 % intervals.
    pub shift: [Estimate; 2],
    /// How it changes from the middle to the right border, and to the lower one; 0 unless affine.
    pub slope: [[f64; 2]; 2],
    /// How much later events are, in periods, and how much later still in usual light (as much more as it is
    /// dimmer).
    pub late: [Estimate; 2],
    /// Squared residual of the changes, over that without a shift.
    pub left: f64,
}

impl Misalignment {
    /// The shift at a place of the array, pixels of the frames.
    pub fn at(&self, (u, v): (f64, f64)) -> (f64, f64) {
        let of = |axis: usize| self.shift[axis].value + self.slope[0][axis] * u + self.slope[1][axis] * v;
        (of(0), of(1))
    }
}

/// Changes of the frames and the events' counts.
pub struct ChangesAndEvents<'a> {
    /// Log change from one frame to the next, one picture a pair, smoothed as the counts are.
    pub changes: &'a [Image],
    /// Pixels of the event array between them.
    pub samples: &'a [ShiftSample],
}

/// Sums of one part of the array.
#[derive(Clone)]
struct PartSums {
    normal: ShiftNormal,
    right: ShiftUnknowns,
    cost: f64,
}

impl PartSums {
    fn empty() -> PartSums {
        PartSums { normal: ShiftNormal::zeros(), right: ShiftUnknowns::zeros(), cost: 0.0 }
    }

    fn add(&mut self, other: &PartSums, weight: f64) {
        self.normal += weight * other.normal;
        self.right += weight * other.right;
        self.cost += weight * other.cost;
    }
}

impl ShiftForm {
    fn unknowns(self) -> usize {
        match self {
            ShiftForm::Constant => SHIFT + 2,
            ShiftForm::Affine => MOST,
        }
    }
}

impl ChangesAndEvents<'_> {
    /// The shift of a form; none where too little changes.
    pub fn misalignment(&self, form: ShiftForm) -> Option<Misalignment> {
        if self.samples.len() < FEWEST {
            return None;
        }
        let (still, scale) = self.fitted(SHIFT, &ShiftUnknowns::zeros(), None)?;
        let (found, _) = self.fitted(form.unknowns(), &self.start(), Some(scale))?;
        let cost = |sums: &[PartSums]| sums.iter().map(|sums| sums.cost).sum::<f64>();
        let parts = self.sums(&found, form.unknowns(), scale);
        let left = cost(&parts) / cost(&self.sums(&still, SHIFT, scale));
        let parts: Vec<PartSums> = parts.into_iter().filter(|sums| sums.cost > 0.0).collect();
        let of = |unknown: usize| {
            by_draws(parts.len(), |weights| {
                let mut all = PartSums::empty();
                parts.iter().zip(weights).for_each(|(sums, weight)| all.add(sums, *weight));
                step(&all, form.unknowns()).map(|step| found[unknown] + step[unknown])
            })
        };
        let slope = |first: usize| [found[first], found[first + 1]];
        Some(Misalignment {
            shift: [of(SHIFT)?, of(SHIFT + 1)?],
            slope: [slope(SHIFT + 2), slope(SHIFT + 4)],
            late: [of(2)?, of(3)?],
            left,
        })
    }

    /// The highest correlation of counts and changes at any shift of whole pixels, -1 to 1.
    pub fn agreement(&self) -> f64 {
        self.whole_pixel_shift().1
    }

    /// Starting values: the whole pixels at which counts and changes correlate best.
    fn start(&self) -> ShiftUnknowns {
        let (place, _) = self.whole_pixel_shift();
        let mut start = ShiftUnknowns::zeros();
        (start[SHIFT], start[SHIFT + 1]) = (f64::from(place.0), f64::from(place.1));
        start
    }

    fn whole_pixel_shift(&self) -> ((i32, i32), f64) {
        let places: Vec<(i32, i32)> =
            (-WHOLE..=WHOLE).flat_map(|y| (-WHOLE..=WHOLE).map(move |x| (x, y))).collect();
        let correlation = |&(right, down): &(i32, i32)| {
            let mut sums = [0.0; 3];
            for sample in self.samples {
                let (x, y) = (f64::from(sample.place.0), f64::from(sample.place.1));
                let change = &self.changes[sample.pair as usize];
                let Some((change, ..)) = change.sample(x + f64::from(right), y + f64::from(down)) else {
                    continue;
                };
                let count = f64::from(sample.count);
                sums = [sums[0] + count * change, sums[1] + count * count, sums[2] + change * change];
            }
            sums[0] / (sums[1] * sums[2]).sqrt().max(f64::MIN_POSITIVE)
        };
        let all: Vec<f64> = places.par_iter().map(correlation).collect();
        let best = (0..all.len()).fold(all.len() / 2, |best, n| if all[n] > all[best] { n } else { best });
        (places[best], all[best])
    }

    /// The first `count` unknowns with the smallest residual, and its robust standard deviation.
    fn fitted(&self, count: usize, from: &ShiftUnknowns, scale: Option<f64>) -> Option<(ShiftUnknowns, f64)> {
        let mut found = *from;
        // Gains and lateness first, which are linear: the shift stays until these are known.
        let mut scale_now = scale.unwrap_or(f64::INFINITY);
        for n in 0..STEPS {
            let of = if n < 2 { SHIFT } else { count };
            let mut all = PartSums::empty();
            self.sums(&found, of, scale_now).iter().for_each(|sums| all.add(sums, 1.0));
            let step = step(&all, of)?;
            let longest = (SHIFT..MOST).fold(0.0, |most, k| f64::max(most, step[k].abs()));
            found += step * f64::min(1.0, LONGEST / longest.max(f64::MIN_POSITIVE));
            if scale.is_none() {
                scale_now = self.spread(&found);
            }
            if n >= 2 && longest < ENOUGH && step[2].abs() < ENOUGH {
                break;
            }
        }
        found.iter().all(|value| value.is_finite()).then_some((found, scale_now))
    }

    /// Robust standard deviation of the residuals.
    fn spread(&self, unknowns: &ShiftUnknowns) -> f64 {
        let samples = self.samples.iter();
        let mut left: Vec<f64> =
            samples.filter_map(|sample| self.residual(sample, unknowns).map(|(r, ..)| r.abs())).collect();
        (1.4826 * crate::statistics::median(&mut left)).max(1e-6)
    }

    /// The residual of a sample and its derivatives.
    fn residual(&self, sample: &ShiftSample, unknowns: &ShiftUnknowns) -> Option<(f64, ShiftUnknowns)> {
        let (u, v) = (f64::from(sample.at.0), f64::from(sample.at.1));
        let shift = |axis: usize| {
            unknowns[SHIFT + axis] + unknowns[SHIFT + 2 + axis] * u + unknowns[SHIFT + 4 + axis] * v
        };
        let place = (f64::from(sample.place.0) + shift(0), f64::from(sample.place.1) + shift(1));
        let (change, by_x, by_y) = self.changes[sample.pair as usize].sample(place.0, place.1)?;
        let (count, rate, dimness) =
            (f64::from(sample.count), f64::from(sample.rate), f64::from(sample.dimness));
        let sign = usize::from(change < 0.0);
        let residual = count + (unknowns[2] + unknowns[3] * dimness) * rate - unknowns[sign] * change;
        let mut by = ShiftUnknowns::zeros();
        by[sign] = -change;
        (by[2], by[3]) = (rate, rate * dimness);
        for (axis, slope) in [by_x, by_y].into_iter().enumerate() {
            let of = -unknowns[sign] * slope;
            (by[SHIFT + axis], by[SHIFT + 2 + axis], by[SHIFT + 4 + axis]) = (of, of * u, of * v);
        }
        Some((residual, by))
    }

    /// Normal equations of each part of the array, and Huber's cost, in squares of `scale`.
    fn sums(&self, unknowns: &ShiftUnknowns, count: usize, scale: f64) -> Vec<PartSums> {
        let add = |mut sums: Vec<PartSums>, sample: &ShiftSample| {
            if let Some((residual, by)) = self.residual(sample, unknowns) {
                let size = (residual / scale).abs();
                let weight = if size <= HUBER || !scale.is_finite() { 1.0 } else { HUBER / size };
                let part = &mut sums[usize::from(sample.part)];
                for row in 0..count {
                    for column in 0..=row {
                        part.normal[(row, column)] += weight * by[row] * by[column];
                    }
                    part.right[row] -= weight * by[row] * residual;
                }
                part.cost += if size <= HUBER { 0.5 * size * size } else { HUBER * (size - 0.5 * HUBER) };
            }
            sums
        };
        // Blocks of a fixed size, joined in their order: the same bits with any number of threads.
        let blocks: Vec<Vec<PartSums>> = self
            .samples
            .par_chunks(1 << 14)
            .map(|samples| samples.iter().fold(vec![PartSums::empty(); PARTS * PARTS], add))
            .collect();
        let mut all = vec![PartSums::empty(); PARTS * PARTS];
        for block in &blocks {
            all.iter_mut().zip(block).for_each(|(all, part)| all.add(part, 1.0));
        }
        all
    }
}

/// The Gauss-Newton step of the first `count` unknowns; none where its unknowns are not determined at all.
fn step(sums: &PartSums, count: usize) -> Option<ShiftUnknowns> {
    let mut normal = sums.normal;
    for row in 0..MOST {
        for column in row + 1..MOST {
            normal[(row, column)] = normal[(column, row)];
        }
        // Unknowns that do not take part stay; a light that never falls has no gain for that.
        if row >= count || normal[(row, row)] <= 0.0 {
            normal.row_mut(row).fill(0.0);
            normal.column_mut(row).fill(0.0);
            normal[(row, row)] = 1.0;
        } else {
            normal[(row, row)] *= 1.0 + 1e-9;
        }
    }
    let mut right = sums.right;
    (count..MOST).for_each(|row| right[row] = 0.0);
    normal.cholesky().map(|factor| factor.solve(&right))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 64;
    const GAINS: (f64, f64) = (5.0, 4.0);
    const LATE: (f64, f64) = (0.02, 0.01);

    /// Smooth changes that differ from pair to pair, and their gradient.
    fn change(pair: usize, x: f64, y: f64) -> f64 {
        let phase = 1.7 * pair as f64;
        0.3 * libm::sin(0.31 * x + 0.11 * y + phase) + 0.2 * libm::sin(0.08 * x - 0.27 * y + 2.0 * phase)
    }

    /// Counts of events whose places lie off by `shift`, exact; `rate` is what a scene that moves has.
    fn simulate_counts(shift: impl Fn(f64, f64) -> (f64, f64)) -> (Vec<Image>, Vec<ShiftSample>) {
        let (mut changes, mut samples) = (Vec::new(), Vec::new());
        for pair in 0..6 {
            let values =
                (0..SIDE * SIDE).map(|at| change(pair, (at % SIDE) as f64, (at / SIDE) as f64) as f32);
            changes.push(Image { width: SIDE, height: SIDE, values: values.collect() });
            for at in 0..SIDE * SIDE {
                let (x, y) = ((at % SIDE) as f64, (at / SIDE) as f64);
                let (u, v) = (2.0 * x / SIDE as f64 - 1.0, 2.0 * y / SIDE as f64 - 1.0);
                let (right, down) = shift(u, v);
                let now = change(pair, x + right, y + down);
                let rate = libm::sin(0.2 * x + 0.3 * y + pair as f64);
                let dimness = 1.0 + 0.5 * libm::sin(0.4 * x);
                let gain = if now < 0.0 { GAINS.1 } else { GAINS.0 };
                samples.push(ShiftSample {
                    pair: pair as u32,
                    part: (at / SIDE * PARTS / SIDE * PARTS + at % SIDE * PARTS / SIDE) as u16,
                    place: (x as f32, y as f32),
                    at: (u as f32, v as f32),
                    count: (gain * now - (LATE.0 + LATE.1 * dimness) * rate) as f32,
                    rate: rate as f32,
                    dimness: dimness as f32,
                });
            }
        }
        (changes, samples)
    }

    #[test]
    fn shifts_are_found_to_a_fraction_of_a_pixel_with_gains_and_lateness_open() {
        for (right, down) in [(0.0, 0.0), (0.4, -0.7), (-1.6, 1.3), (2.2, 0.1)] {
            let (changes, samples) = simulate_counts(|_, _| (right, down));
            let compared = ChangesAndEvents { changes: &changes, samples: &samples };
            let found = compared.misalignment(ShiftForm::Constant).unwrap();
            // Bilinear between pixels of waves of 20: a hundredth.
            let [x, y] = found.shift;
            assert!((x.value - right).abs() < 0.02 && (y.value - down).abs() < 0.02, "{found:?}");
            assert!(
                (found.late[0].value - LATE.0).abs() < 2e-3 && (found.late[1].value - LATE.1).abs() < 2e-3
            );
            assert!(x.ci95.0 <= x.value && x.value <= x.ci95.1);
            let is_shifted = (right, down) != (0.0, 0.0);
            assert!(!is_shifted || found.left < 0.1, "{}", found.left);
        }
    }

    #[test]
    fn a_shift_that_varies_over_the_array_is_found_as_one() {
        let (changes, samples) = simulate_counts(|u, v| (0.5 + 0.6 * u - 0.3 * v, -0.2 + 0.1 * u + 0.4 * v));
        let compared = ChangesAndEvents { changes: &changes, samples: &samples };
        let found = compared.misalignment(ShiftForm::Affine).unwrap();
        for (u, v) in [(0.0, 0.0), (1.0, 0.0), (-1.0, 1.0)] {
            let (x, y) = found.at((u, v));
            let (right, down) = (0.5 + 0.6 * u - 0.3 * v, -0.2 + 0.1 * u + 0.4 * v);
            assert!((x - right).abs() < 0.05 && (y - down).abs() < 0.05, "{u} {v}: {x} {y}");
        }
        assert!(compared.misalignment(ShiftForm::Constant).unwrap().left > 2.0 * found.left);
    }

    #[test]
    fn the_jacobian_is_that_of_differences() {
        let (changes, samples) = simulate_counts(|_, _| (0.0, 0.0));
        let compared = ChangesAndEvents { changes: &changes, samples: &samples };
        let unknowns =
            ShiftUnknowns::from_column_slice(&[5.0, 4.0, 0.1, 0.2, 0.3, -0.4, 0.05, 0.02, -0.03, 0.04]);
        for sample in samples.iter().skip(1300).step_by(977) {
            let Some((_, by)) = compared.residual(sample, &unknowns) else { continue };
            for k in 0..MOST {
                let at = |by: f64| {
                    let mut moved = unknowns;
                    moved[k] += by;
                    compared.residual(sample, &moved).unwrap().0
                };
                let numeric = (at(1e-5) - at(-1e-5)) / 2e-5;
                assert!((by[k] - numeric).abs() < 1e-4 * (1.0 + numeric.abs()), "{k}: {} {numeric}", by[k]);
            }
        }
    }

    #[test]
    fn light_that_moves_one_way_leaves_the_shift_along_it_open() {
        // Counts of a later instant are those of a place further on: shift and lateness are one.
        let (changes, mut samples) = simulate_counts(|_, _| (0.0, 0.0));
        let slope =
            |pair: usize, x: f64, y: f64| (change(pair, x + 0.01, y) - change(pair, x - 0.01, y)) / 0.02;
        for sample in &mut samples {
            let (x, y) = (f64::from(sample.place.0), f64::from(sample.place.1));
            let pair = sample.pair as usize;
            let now = change(pair, x, y);
            let gain = if now < 0.0 { GAINS.1 } else { GAINS.0 };
            sample.rate = (-20.0 * gain * slope(pair, x, y)) as f32;
            sample.dimness = (1.0 + 0.5 * libm::sin(0.4 * x)) as f32;
            let noise = 0.3 * libm::sin(12.9 * x + 78.2 * y + 37.7 * pair as f64);
            sample.count = (gain * now + noise) as f32;
        }
        let compared = ChangesAndEvents { changes: &changes, samples: &samples };
        let width = |one: &Estimate| one.ci95.1 - one.ci95.0;
        let [x, y] = compared.misalignment(ShiftForm::Constant).unwrap().shift;
        assert!(width(&x) > 10.0 * width(&y), "{x:?} {y:?}");
    }
}
