//! What no effect of the catalogue has: curves over covariates, scored against what the scene takes over.
//!
//! A scene that is estimated from events follows those of every bin, so what they miss their thresholds by
//! shows little of a curve. Each bin is an effect of its own instead, with its efficient score and
//! information, the scene adapted ([`FreeScene::score`]). What sizes gain is the density of events' times
//! with a step of the scene ([`FreeScene::gains`]), beyond what one size for all bins gains. On one picture
//! sizes come from the events that take part in it, and gains are those of the events that do not. On the
//! light of pixels, which follows all of them, sizes come from one half of the blocks, and gains are those of
//! the other half when the light is estimated from everything else.
//!
//! Limits: instants without an event are left out; slopes change by no curve.

use super::super::laid::Laid;
use super::super::open::{Free, Open, is_sought};
use super::fit::{BY_CHANCE, Fit};
use super::places::{Dependences, Level, Observed};
use crate::covariates::Covariate;
use crate::dependence::{Dependence, Moved};
use nalgebra::{DMatrix, DVector};
use photocurrent_scene::free::{FreeScene, Predicted, Score};
use rayon::prelude::*;

/// What may be moved, and the standard deviation of a size before the recording: a share of a threshold,
/// seconds, events a second.
pub(super) const MOVED: [(Moved, f64); 3] =
    [(Moved::Threshold, 0.5), (Moved::Stamps, 2e-3), (Moved::Rate, 100.0)];

/// Of what a curve over what the light does gains, so much counts: where edges pass fast, light that is free
/// in time errs by their slope, and six of 42 sound recordings gain 0.03 to 0.14 nats an event so; over
/// place and time none gains anything (`photocurrent-calibrate --scene pixels`).
/// On one picture sound ones gain up to 0.12 so, over bursts and light (`--scene joint`).
const OF_LIGHT: f64 = 0.25;

/// What share of the gain of a curve counts.
pub(super) fn share_of(covariate: Covariate) -> f64 {
    if covariate.is_of_light() { OF_LIGHT } else { 1.0 }
}

/// On one picture so many curves are measured on events that take no part, those that gain most to first
/// order on the ones that do.
/// To spare time; not calibrated.
const MEASURED: usize = 16;

/// Score and information of all bins in one half of the blocks.
#[derive(Clone)]
pub(super) struct Half {
    pub score: DVector<f64>,
    pub information: DMatrix<f64>,
}

impl Half {
    /// Best sizes; none where nothing is known of them.
    pub(super) fn sizes(&self, prior: f64) -> Option<DVector<f64>> {
        let bins = self.score.len();
        let held = DMatrix::identity(bins, bins) / (prior * prior);
        Some((&self.information + held).cholesky()?.solve(&-&self.score))
    }

    /// Of what moves all bins by the rows of a matrix.
    pub(super) fn through(&self, by: &DMatrix<f64>) -> Half {
        Half { score: by.tr_mul(&self.score), information: by.tr_mul(&(&self.information * by)) }
    }

    /// The best size that all bins have.
    fn one(&self, prior: f64) -> f64 {
        -self.score.sum() / (self.information.sum() + 1.0 / (prior * prior))
    }

    /// What these sizes gain to first order beyond the best one for all bins, nats.
    fn gain(&self, prior: f64) -> f64 {
        let (one, sum) = (self.one(prior), self.score.sum());
        let all = self.sizes(prior).map_or(0.0, |sizes| -0.5 * self.score.dot(&sizes));
        all + 0.5 * one * sum
    }

    pub(super) fn with(&self, other: &Half) -> Half {
        Half { score: &self.score + &other.score, information: &self.information + &other.information }
    }
}

/// A curve with its sizes.
pub(super) struct Sized {
    pub dependence: Dependence,
    mean: f64,
    /// To first order, where they are estimated, nats.
    gain: f64,
    /// What it moves each event by, natural-log units, and what one size for all bins does.
    pub columns: [Vec<f32>; 2],
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
        let ground = fit.ground;
        let all = match L::IS_ONE {
            true => Some(Observed::of(fit, &predicted, |place| ground.has_events(place))?),
            false => None,
        };
        let on = On { fit, predicted: &predicted, observed: all.as_ref().unwrap_or(&self.measured) };
        let sought: Vec<&Laid> = on.observed.laid.iter().filter(|laid| is_sought(laid.covariate)).collect();
        let mut curves: Vec<Sized> = sought.into_par_iter().flat_map_iter(|laid| on.curves(laid)).collect();
        if L::IS_ONE {
            curves.sort_by(|a, b| b.gain.total_cmp(&a.gain));
            curves.truncate(MEASURED);
        }
        let mut list = on.gained(curves);
        list.sort_by(|a, b| b.beyond().total_cmp(&a.beyond()));
        list.iter_mut().take(1).filter(|best| best.beyond() > 0.0).for_each(|best| on.multiply(best));
        Ok(self.finished(fit.ground, list))
    }
}

/// A scene, and the events that curves are over.
pub(super) struct On<'a, 'b, L> {
    pub fit: &'a Fit<'b, L>,
    predicted: &'a [Predicted],
    pub observed: &'a Observed,
}

impl<L: FreeScene> On<'_, '_, L> {
    /// Columns of events as the scene takes them: of each place and row, `effects` values.
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
        self.predicted.iter().zip(&self.observed.of_places).map(of_place).collect()
    }

    /// The half of the blocks that a place belongs to.
    fn half(&self, place: usize) -> Option<usize> {
        let (first, count) = self.observed.of_places[place];
        (count > 0).then(|| (self.observed.block[first] % 2) as usize)
    }

    /// Score and information, by halves, of each so many columns.
    pub(super) fn halves(&self, columns: &[&[f32]], count: usize) -> Vec<[Half; 2]> {
        let effects = columns.len();
        let none = Half { score: DVector::zeros(count), information: DMatrix::zeros(count, count) };
        let mut all = vec![[none.clone(), none]; effects / count];
        let scores = self.fit.light.score(self.predicted, &self.spread(columns), effects);
        for (place, found) in scores.iter().enumerate() {
            let (Some(Score { score, information, .. }), Some(half)) = (found, self.half(place)) else {
                continue;
            };
            for (first, halves) in (0..effects).step_by(count).zip(&mut all) {
                let to = &mut halves[half];
                for i in 0..count {
                    to.score[i] += score[first + i];
                    for j in 0..count {
                        to.information[(i, j)] += information[(first + i) * effects + first + j];
                    }
                }
            }
        }
        all
    }

    /// What may be moved over one covariate.
    pub(super) fn curves(&self, laid: &Laid) -> Vec<Sized> {
        let (events, threshold) = (&self.observed.events, self.fit.ground.scales.threshold);
        let free: Vec<Free> =
            MOVED.iter().filter_map(|(moved, _)| Free::new(events, laid, *moved, threshold)).collect();
        let Some(bins) = free.first().map(|free| free.bins.at.len()) else { return Vec::new() };
        let columns: Vec<&[f32]> =
            free.iter().flat_map(|free| free.columns.iter().map(|column| &column.of[..])).collect();
        let of_moved = |((n, free), halves): ((usize, &Free), [Half; 2])| -> Option<Sized> {
            let (moved, prior) = MOVED[n];
            let both = halves[0].with(&halves[1]);
            let whole = both.sizes(prior)?;
            let sizes = [halves[0].sizes(prior)?, halves[1].sizes(prior)?];
            let error = (0..bins).map(|bin| 0.5 * (sizes[0][bin] - sizes[1][bin]).abs()).collect();
            // Of an event by sizes that it took no part in.
            let (sizes, ones) = match L::IS_ONE {
                true => ([whole.clone(), whole.clone()], [both.one(prior); 2]),
                false => (sizes, halves.each_ref().map(|half| half.one(prior))),
            };
            let of = |sizes: &dyn Fn(usize, usize) -> f64| -> Vec<f32> {
                let column = |k: usize| {
                    let other = 1 - (self.observed.block[k] % 2) as usize;
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
                error,
                ..Dependence::over(laid.covariate, moved)
            };
            Some(Sized { dependence, mean, gain: both.gain(prior), columns })
        };
        free.iter().enumerate().zip(self.halves(&columns, bins)).filter_map(of_moved).collect()
    }

    /// Of pairs of columns, nats an event of those that are held out: what both gain, and the standard error
    /// of the difference by blocks.
    pub(super) fn compared(&self, pairs: &[[&[f32]; 2]]) -> Vec<([f64; 2], f64)> {
        let columns: Vec<&[f32]> = pairs.iter().flatten().copied().collect();
        let gains = self.fit.light.gains(self.predicted, &self.spread(&columns), &vec![1.0; columns.len()]);
        let Observed { block, of_places, .. } = self.observed;
        let blocks = block.iter().copied().max().map_or(0, |last| last as usize + 1);
        let is_measured = |place: usize| of_places[place].1 > 0 && self.fit.ground.is_measured(place);
        let measured = (0..of_places.len()).filter(|place| is_measured(*place));
        let events = f64::max(measured.map(|place| of_places[place].1 as f64).sum(), 1.0);
        let one = |n: usize| {
            let (mut of_blocks, mut counts) = (vec![0.0; blocks], vec![0.0; blocks]);
            let mut both = [0.0; 2];
            for (place, found) in gains.iter().enumerate() {
                let (first, count) = of_places[place];
                let Some(found) = found.as_ref().filter(|_| is_measured(place)) else { continue };
                let block = block[first] as usize;
                let of = [found[2 * n], found[2 * n + 1]];
                of_blocks[block] += of[0] - of[1];
                counts[block] += count as f64;
                both.iter_mut().zip(of).for_each(|(sum, of)| *sum += of / events);
            }
            let mean = of_blocks.iter().sum::<f64>() / events;
            let spread = of_blocks.iter().zip(&counts).map(|(g, n)| (g - mean * n) * (g - mean * n));
            (both, libm::sqrt(spread.sum::<f64>()) / events)
        };
        (0..pairs.len()).map(one).collect()
    }

    /// What curves gain beyond one size for all bins.
    fn gained(&self, curves: Vec<Sized>) -> Vec<Open> {
        let pairs: Vec<[&[f32]; 2]> =
            curves.iter().map(|curve| curve.columns.each_ref().map(|column| &column[..])).collect();
        let compared = self.compared(&pairs);
        let one = |(curve, ([all, same], gain_error)): (Sized, ([f64; 2], f64))| {
            let gain = all - f64::max(same, 0.0);
            let dependence = Dependence {
                taken: 1.0 - libm::exp(-2.0 * gain.max(0.0)),
                significance: gain / f64::max(gain_error, 1e-9),
                nats_per_event: gain,
                ..curve.dependence
            };
            let control_gain = gain - share_of(dependence.covariate) * (gain - BY_CHANCE * gain_error);
            Open { dependence, mean: curve.mean, gain, gain_error, control_gain, located: None }
        };
        curves.into_iter().zip(compared).map(one).collect()
    }
}
