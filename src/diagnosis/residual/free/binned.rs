//! What no effect of the catalogue has, on the light of pixels: curves over covariates, scored against what
//! the light takes over.
//!
//! Light that is free in time follows the events of every bin, so what they miss their thresholds by shows
//! little of a curve. Each bin is an effect of its own instead, with its efficient score and information, the
//! light adapted ([`FreeScene::score`]). Sizes come from one half of the blocks; what they gain in the other
//! half is the density of events' times when the light is estimated from everything else, with a step of the
//! light ([`FreeScene::gains`]), beyond what one size for all bins gains.
//!
//! Limits: instants without an event are left out; slopes change by no curve.

use super::super::laid::Laid;
use super::super::open::{Free, Open, is_sought};
use super::fit::{BY_CHANCE, Fit};
use super::places::{Dependences, Level};
use crate::dependence::{Dependence, Moved};
use nalgebra::{DMatrix, DVector};
use photocurrent_scene::free::{FreeScene, Predicted, Score};

/// What may be moved, and the standard deviation of a size before the recording: a share of a threshold,
/// seconds, events a second.
const MOVED: [(Moved, f64); 3] = [(Moved::Threshold, 0.5), (Moved::Stamps, 2e-3), (Moved::Rate, 100.0)];

/// Of what a curve over what the light does gains, so much counts: where edges pass fast, light that is free
/// in time errs by their slope, and six of 42 sound recordings gain 0.03 to 0.14 nats an event so; over
/// place and time none gains anything (`photocurrent-calibrate --scene pixels`).
const OF_LIGHT: f64 = 0.25;

/// Score and information of all bins in one half of the blocks.
#[derive(Clone)]
struct Half {
    score: DVector<f64>,
    information: DMatrix<f64>,
}

impl Half {
    /// Best sizes; none where nothing is known of them.
    fn sizes(&self, prior: f64) -> Option<DVector<f64>> {
        let bins = self.score.len();
        let held = DMatrix::identity(bins, bins) / (prior * prior);
        Some((&self.information + held).cholesky()?.solve(&-&self.score))
    }

    /// The best size that all bins have.
    fn one(&self, prior: f64) -> f64 {
        -self.score.sum() / (self.information.sum() + 1.0 / (prior * prior))
    }

    fn with(&self, other: &Half) -> Half {
        Half { score: &self.score + &other.score, information: &self.information + &other.information }
    }
}

/// A curve with its sizes: of all blocks, and for the blocks of each half by those of the other one.
struct Sized {
    dependence: Dependence,
    mean: f64,
    /// What it moves each event by, natural-log units, and what one size for all bins does.
    columns: [Vec<f32>; 2],
}

impl Level {
    /// Curves of everything that may be moved over every covariate, best first.
    ///
    /// # Errors
    /// When the fit's sensor cannot be applied.
    pub(super) fn binned<L: FreeScene>(&self, fit: &mut Fit<'_, L>) -> Result<Dependences, String> {
        fit.predict()?;
        let predicted = fit.predicted()?;
        fit.light.prepare(&predicted);
        let on = On::new(fit, &predicted, self);
        let mut curves: Vec<Sized> = Vec::new();
        for laid in self.laid.iter().filter(|laid| is_sought(laid.covariate)) {
            curves.extend(on.curves(laid));
        }
        let list = on.gained(curves);
        Ok(self.finished(fit.ground, list))
    }
}

/// A light, and the events that curves are over.
struct On<'a, 'b, L> {
    fit: &'a Fit<'b, L>,
    predicted: &'a [Predicted],
    level: &'a Level,
    /// Of each place its first event of the level, and how many.
    events: Vec<(usize, usize)>,
}

impl<'a, 'b, L: FreeScene> On<'a, 'b, L> {
    fn new(fit: &'a Fit<'b, L>, predicted: &'a [Predicted], level: &'a Level) -> On<'a, 'b, L> {
        let mut next = 0;
        let of_place = |(place, numbers): (usize, &Vec<usize>)| {
            let count = if fit.ground.is_measured(place) { numbers.len() } else { 0 };
            next += count;
            (next - count, count)
        };
        let events = fit.ground.events.iter().enumerate().map(of_place).collect();
        On { fit, predicted, level, events }
    }

    /// Columns of events as the light takes them: of each place and row, `effects` values.
    fn spread(&self, columns: &[&[f32]]) -> Vec<Vec<f32>> {
        let effects = columns.len();
        let of_place = |(of, (first, count)): (&Predicted, &(usize, usize))| {
            let (frames, events) = (of.frames.len(), of.events.len());
            let mut spread = vec![0.0; (frames + 2 * events + of.quiet.len()) * effects];
            for e in 0..*count {
                for (k, column) in columns.iter().enumerate() {
                    spread[(frames + e) * effects + k] = column[first + e];
                }
            }
            spread
        };
        self.predicted.iter().zip(&self.events).map(of_place).collect()
    }

    /// The half of the blocks that a place belongs to.
    fn half(&self, place: usize) -> Option<usize> {
        let (first, count) = self.events[place];
        (count > 0).then(|| (self.level.block[first] % 2) as usize)
    }

    /// What may be moved over one covariate.
    fn curves(&self, laid: &Laid) -> Vec<Sized> {
        let (events, threshold) = (&self.level.events, self.fit.ground.scales.threshold);
        let free: Vec<Free> =
            MOVED.iter().filter_map(|(moved, _)| Free::new(events, laid, *moved, threshold)).collect();
        let Some(bins) = free.first().map(|free| free.bins.at.len()) else { return Vec::new() };
        let columns: Vec<&[f32]> =
            free.iter().flat_map(|free| free.columns.iter().map(|column| &column.of[..])).collect();
        let effects = columns.len();
        let scores = self.fit.light.score(self.predicted, &self.spread(&columns), effects);
        let of_moved = |(n, free): (usize, &Free)| -> Option<Sized> {
            let (moved, prior) = MOVED[n];
            let first = n * bins;
            let none = Half { score: DVector::zeros(bins), information: DMatrix::zeros(bins, bins) };
            let mut halves = [none.clone(), none];
            for (place, found) in scores.iter().enumerate() {
                let (Some(Score { score, information, .. }), Some(half)) = (found, self.half(place)) else {
                    continue;
                };
                for i in 0..bins {
                    halves[half].score[i] += score[first + i];
                    for j in 0..bins {
                        halves[half].information[(i, j)] += information[(first + i) * effects + first + j];
                    }
                }
            }
            let whole = halves[0].with(&halves[1]).sizes(prior)?;
            let sizes = [halves[0].sizes(prior)?, halves[1].sizes(prior)?];
            let ones = halves.each_ref().map(|half| half.one(prior));
            // Of an event in one half by the sizes of the other one.
            let of = |sizes: &dyn Fn(usize, usize) -> f64| -> Vec<f32> {
                let column = |k: usize| {
                    let other = 1 - (self.level.block[k] % 2) as usize;
                    let by = |bin: usize| sizes(other, bin) * f64::from(free.columns[bin].of[k]);
                    (0..bins).map(by).sum::<f64>() as f32
                };
                (0..events.pixel.len()).map(column).collect()
            };
            let columns = [of(&|half, bin| sizes[half][bin]), of(&|half, _| ones[half])];
            let mean = free.mean(whole.as_slice());
            let dependence = Dependence {
                period_s: laid.period_ns.map(|period_ns| period_ns as f64 * 1e-9),
                at: free.bins.at.clone(),
                value: whole.iter().map(|value| value - mean).collect(),
                error: (0..bins).map(|bin| 0.5 * (sizes[0][bin] - sizes[1][bin]).abs()).collect(),
                ..Dependence::over(laid.covariate, moved)
            };
            Some(Sized { dependence, mean, columns })
        };
        free.iter().enumerate().filter_map(of_moved).collect()
    }

    /// What curves gain beyond one size for all bins.
    fn gained(&self, curves: Vec<Sized>) -> Vec<Open> {
        let columns: Vec<&[f32]> =
            curves.iter().flat_map(|curve| curve.columns.iter().map(|column| &column[..])).collect();
        let gains = self.fit.light.gains(self.predicted, &self.spread(&columns), &vec![1.0; columns.len()]);
        let blocks = self.level.block.iter().copied().max().map_or(0, |last| last as usize + 1);
        let events = self.level.events.pixel.len().max(1) as f64;
        let one = |(n, curve): (usize, Sized)| {
            let (mut of_blocks, mut counts) = (vec![0.0; blocks], vec![0.0; blocks]);
            let (mut all, mut same) = (0.0, 0.0);
            for (place, found) in gains.iter().enumerate() {
                let (first, count) = self.events[place];
                let Some(found) = found.as_ref().filter(|_| count > 0) else { continue };
                let block = self.level.block[first] as usize;
                of_blocks[block] += found[2 * n] - found[2 * n + 1];
                counts[block] += count as f64;
                (all, same) = (all + found[2 * n], same + found[2 * n + 1]);
            }
            let gain = (all - f64::max(same, 0.0)) / events;
            let mean = of_blocks.iter().sum::<f64>() / events;
            let spread = of_blocks.iter().zip(&counts).map(|(g, n)| (g - mean * n) * (g - mean * n));
            let gain_error = libm::sqrt(spread.sum::<f64>()) / events;
            let dependence = Dependence {
                taken: 1.0 - libm::exp(-2.0 * gain.max(0.0)),
                significance: gain / f64::max(gain_error, 1e-9),
                nats_per_event: gain,
                ..curve.dependence
            };
            let counts = if dependence.covariate.is_of_light() { OF_LIGHT } else { 1.0 };
            let control_gain = gain - counts * (gain - BY_CHANCE * gain_error);
            Open { dependence, mean: curve.mean, gain, gain_error, control_gain, located: None }
        };
        curves.into_iter().enumerate().map(one).collect()
    }
}
