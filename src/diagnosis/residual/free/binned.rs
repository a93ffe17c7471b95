//! Curves over covariates that no effect of the catalogue has, scored with the scene adapted.
//!
//! A scene that is estimated from events absorbs most of a curve, so residuals show little of it. Each bin is
//! instead an effect of its own, with its efficient score and information ([`FreeScene::score`]). The gain of
//! sizes is that of the density of event times with a step of the scene ([`FreeScene::gains`]), beyond that
//! of one size for all bins. On one picture sizes come from the events that are fitted, gains from held-out
//! ones. On the light of pixels, which follows all events, sizes come from one half of the blocks. Gains are
//! those of the other half with the light estimated from everything else.
//!
//! Limits: instants without an event are left out; no curve changes slopes.

use super::super::laid::CovariateColumns;
use super::super::open::{BinColumns, CovariateCurve, is_sought};
use super::fit::{BY_CHANCE, SceneFit};
use super::places::{BaseFit, ObservedEvents, UnexplainedCurves};
use crate::covariates::Covariate;
use crate::dependence::{AffectedQuantity, Dependence};
use nalgebra::{DMatrix, DVector};
use photocurrent_scene::free::{FreeScene, PixelPrediction, Score};
use rayon::prelude::*;

/// Quantities that a curve may change, with the prior standard deviation of a size: a share of a threshold,
/// seconds, events per second.
pub(super) const MOVED: [(AffectedQuantity, f64); 3] =
    [(AffectedQuantity::Threshold, 0.5), (AffectedQuantity::Stamps, 2e-3), (AffectedQuantity::Rate, 100.0)];

/// Share of a light-dependent curve's gain that is counted. Where edges are fast, light that is free in time
/// has errors by their slope: six of 42 nominal recordings gain 0.03 to 0.14 nats per event; over place and
/// time none gains (`photocurrent-calibrate --scene pixels`). On one picture nominal ones gain up to 0.12,
/// over bursts and light (`--scene joint`).
const OF_LIGHT: f64 = 0.25;

/// Share of a curve's gain that is counted.
pub(super) fn share_of(covariate: Covariate) -> f64 {
    if covariate.is_of_light() { OF_LIGHT } else { 1.0 }
}

/// Number of curves evaluated on held-out events of one picture: those with the largest first-order gain on
/// fitted ones. To save time; not calibrated.
const MEASURED: usize = 16;

/// Score and information of all bins in one half of the blocks.
#[derive(Clone)]
pub(super) struct BinnedHalf {
    pub score: DVector<f64>,
    pub information: DMatrix<f64>,
}

impl BinnedHalf {
    /// Best sizes; `None` where they are not identifiable.
    pub(super) fn sizes(&self, prior: f64) -> Option<DVector<f64>> {
        let bins = self.score.len();
        let held = DMatrix::identity(bins, bins) / (prior * prior);
        Some((&self.information + held).cholesky()?.solve(&-&self.score))
    }

    /// Projected by the rows of a matrix.
    pub(super) fn project(&self, by: &DMatrix<f64>) -> BinnedHalf {
        BinnedHalf { score: by.tr_mul(&self.score), information: by.tr_mul(&(&self.information * by)) }
    }

    /// The best common size of all bins.
    fn common_size(&self, prior: f64) -> f64 {
        -self.score.sum() / (self.information.sum() + 1.0 / (prior * prior))
    }

    /// First-order gain of these sizes over the best common one, nats.
    fn gain(&self, prior: f64) -> f64 {
        let (one, sum) = (self.common_size(prior), self.score.sum());
        let all = self.sizes(prior).map_or(0.0, |sizes| -0.5 * self.score.dot(&sizes));
        all + 0.5 * one * sum
    }

    pub(super) fn plus(&self, other: &BinnedHalf) -> BinnedHalf {
        BinnedHalf { score: &self.score + &other.score, information: &self.information + &other.information }
    }
}

/// A curve with its sizes.
pub(super) struct SizedCurve {
    pub dependence: Dependence,
    mean: f64,
    /// To first order, where they are estimated, nats.
    gain: f64,
    /// Change of each event by the curve, natural-log units, and by one common size.
    pub columns: [Vec<f32>; 2],
}

impl BaseFit {
    /// Curves of everything that may be moved over every covariate, best first.
    ///
    /// # Errors
    /// When the fit's sensor cannot be applied.
    pub(super) fn binned<L: FreeScene>(
        &self,
        fit: &mut SceneFit<'_, L>,
    ) -> Result<UnexplainedCurves, String> {
        fit.predict()?;
        let predicted = fit.predicted()?;
        fit.light.prepare(&predicted);
        let ground = fit.ground;
        let all = match L::IS_ONE {
            true => Some(ObservedEvents::from_events(fit, &predicted, |place| ground.has_events(place))?),
            false => None,
        };
        let on = BinnedScene { fit, predicted: &predicted, observed: all.as_ref().unwrap_or(&self.measured) };
        let sought: Vec<&CovariateColumns> =
            on.observed.laid.iter().filter(|laid| is_sought(laid.covariate)).collect();
        let mut curves: Vec<SizedCurve> =
            sought.into_par_iter().flat_map_iter(|laid| on.curves(laid)).collect();
        if L::IS_ONE {
            curves.sort_by(|a, b| b.gain.total_cmp(&a.gain));
            curves.truncate(MEASURED);
        }
        let mut list = on.gained(curves);
        list.sort_by(|a, b| b.gain_beyond_control().total_cmp(&a.gain_beyond_control()));
        list.iter_mut()
            .take(1)
            .filter(|best| best.gain_beyond_control() > 0.0)
            .for_each(|best| on.multiply(best));
        Ok(self.finished(fit.ground, list))
    }
}

/// A scene, and the events of the curves.
pub(super) struct BinnedScene<'a, 'b, L> {
    pub fit: &'a SceneFit<'b, L>,
    predicted: &'a [PixelPrediction],
    pub observed: &'a ObservedEvents,
}

impl<L: FreeScene> BinnedScene<'_, '_, L> {
    /// Columns of events as the scene takes them: of each place and row, `effects` values.
    fn scene_columns(&self, columns: &[&[f32]]) -> Vec<Vec<f32>> {
        let effects = columns.len();
        let of_place = |(of, (first, count)): (&PixelPrediction, &(usize, usize))| {
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
    pub(super) fn halves(&self, columns: &[&[f32]], count: usize) -> Vec<[BinnedHalf; 2]> {
        let effects = columns.len();
        let none = BinnedHalf { score: DVector::zeros(count), information: DMatrix::zeros(count, count) };
        let mut all = vec![[none.clone(), none]; effects / count];
        let scores = self.fit.light.score(self.predicted, &self.scene_columns(columns), effects);
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

    /// Curves over one covariate, one per quantity.
    pub(super) fn curves(&self, laid: &CovariateColumns) -> Vec<SizedCurve> {
        let (events, threshold) = (&self.observed.events, self.fit.ground.scales.threshold);
        let free: Vec<BinColumns> =
            MOVED.iter().filter_map(|(moved, _)| BinColumns::new(events, laid, *moved, threshold)).collect();
        let Some(bins) = free.first().map(|free| free.bins.at.len()) else { return Vec::new() };
        let columns: Vec<&[f32]> =
            free.iter().flat_map(|free| free.columns.iter().map(|column| &column.of[..])).collect();
        let of_moved = |((n, free), halves): ((usize, &BinColumns), [BinnedHalf; 2])| -> Option<SizedCurve> {
            let (moved, prior) = MOVED[n];
            let both = halves[0].plus(&halves[1]);
            let whole = both.sizes(prior)?;
            let sizes = [halves[0].sizes(prior)?, halves[1].sizes(prior)?];
            let error = (0..bins).map(|bin| 0.5 * (sizes[0][bin] - sizes[1][bin]).abs()).collect();
            // Of an event by sizes that it took no part in.
            let (sizes, ones) = match L::IS_ONE {
                true => ([whole.clone(), whole.clone()], [both.common_size(prior); 2]),
                false => (sizes, halves.each_ref().map(|half| half.common_size(prior))),
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
            let mean = free.mean_over_events(whole.as_slice());
            let dependence = Dependence {
                period_s: laid.period_ns.map(|period_ns| period_ns as f64 * 1e-9),
                at: free.bins.at.clone(),
                value: whole.iter().map(|value| value - mean).collect(),
                error,
                ..Dependence::empty_over(laid.covariate, moved)
            };
            Some(SizedCurve { dependence, mean, gain: both.gain(prior), columns })
        };
        free.iter().enumerate().zip(self.halves(&columns, bins)).filter_map(of_moved).collect()
    }

    /// Gains of pairs of columns on held-out events, nats per event, and the standard error of their
    /// difference by blocks.
    pub(super) fn compared(&self, pairs: &[[&[f32]; 2]]) -> Vec<([f64; 2], f64)> {
        let columns: Vec<&[f32]> = pairs.iter().flatten().copied().collect();
        let gains =
            self.fit.light.gains(self.predicted, &self.scene_columns(&columns), &vec![1.0; columns.len()]);
        let ObservedEvents { block, of_places, .. } = self.observed;
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

    /// Gains of curves beyond one common size.
    fn gained(&self, curves: Vec<SizedCurve>) -> Vec<CovariateCurve> {
        let pairs: Vec<[&[f32]; 2]> =
            curves.iter().map(|curve| curve.columns.each_ref().map(|column| &column[..])).collect();
        let compared = self.compared(&pairs);
        let one = |(curve, ([all, same], gain_error)): (SizedCurve, ([f64; 2], f64))| {
            let gain = all - f64::max(same, 0.0);
            let dependence = Dependence {
                taken: 1.0 - libm::exp(-2.0 * gain.max(0.0)),
                significance: gain / f64::max(gain_error, 1e-9),
                nats_per_event: gain,
                ..curve.dependence
            };
            let control_gain = gain - share_of(dependence.covariate) * (gain - BY_CHANCE * gain_error);
            CovariateCurve { dependence, mean: curve.mean, gain, gain_error, control_gain, located: None }
        };
        curves.into_iter().zip(compared).map(one).collect()
    }
}
