//! Efficient scores of effects, summed over pixels.

use super::super::table::probe;
use super::exact::bounded;
use super::fit::{FitData, PixelRows, STEP_NS, SceneFit};
use crate::candidates::{CANDIDATES, Signs};
use photocurrent_scene::free::{FreeScene, PixelPrediction, Score};
use photocurrent_scene::pixels::LEAST_RISE;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Side of the blocks whose scores are compared, pixels.
const SIDE: u32 = 4;
/// An effect that the light takes over but for this share is not seen.
const ABSORBED: f64 = 1e-9;

/// Predictions of all pixels with a step of an effect.
pub(super) struct StepColumns {
    pub rows: Vec<PixelRows>,
    /// With a step back, where the effect is nonlinear at its size; the base is without a step.
    pub back: Option<Vec<PixelRows>>,
    pub step: f64,
}

/// Scores of some effects.
pub(super) struct EffectScores {
    /// Numbers in [`CANDIDATES`].
    pub candidates: Vec<usize>,
    /// Best size beyond that which is applied; none where the light takes the effect over.
    pub sizes: Vec<Option<f64>>,
    /// Information on it, the light (and an effect that is free with it) adapted.
    pub information: Vec<f64>,
    /// The same where the light is known.
    pub known: Vec<f64>,
    /// Gain of that size with a step of the light, nats.
    pub gains: Vec<f64>,
    /// Best size over the standard error that differences between places show.
    agreement: Vec<f64>,
    /// For a single effect: prediction and column.
    pub column: Option<(Vec<PixelPrediction>, Vec<Vec<f32>>)>,
}

impl EffectScores {
    fn index_of(&self, candidate: usize) -> Option<usize> {
        self.candidates.iter().position(|n| *n == candidate)
    }

    /// Best size of an effect.
    pub(super) fn best_size(&self, candidate: usize) -> Option<f64> {
        self.sizes[self.index_of(candidate)?]
    }

    /// How well places agree on it, standard errors.
    pub(super) fn agreement(&self, candidate: usize) -> Option<f64> {
        Some(self.agreement[self.index_of(candidate)?])
    }
}

impl<L: FreeScene> FitData<'_, L> {
    /// Columns of unit steps: change of each pixel's rows, in the order of [`FreeScene::score`]. `base`:
    /// predictions without a step.
    pub(super) fn columns(&self, base: &[PixelRows], moved: &[StepColumns]) -> Vec<Vec<f32>> {
        let effects = moved.len();
        let threshold = self.scales.threshold;
        // As in the fit.
        let least = LEAST_RISE * threshold / (STEP_NS as f64 * 1e-9);
        let log_slope = |slope: f64| libm::log(f64::max(slope, least));
        let of_pixel = |place: usize| -> Vec<f32> {
            let plain = &base[place];
            let quiet = self.no_event_instants(place, plain);
            let (frames, events) = (plain.dn.len(), plain.excess.len());
            let mut columns = vec![0.0; (frames + 2 * events + quiet.len()) * effects];
            for (k, StepColumns { rows, back, step }) in moved.iter().enumerate() {
                let (with, plain) = (&rows[place], back.as_ref().map_or(plain, |back| &back[place]));
                let mut put = |row: usize, change: f64| columns[row * effects + k] = (change / step) as f32;
                (0..frames).for_each(|l| put(l, with.dn[l] - plain.dn[l]));
                for (row, (n, side)) in quiet.iter().enumerate() {
                    let change = with.quiet[*n][*side] - plain.quiet[*n][*side];
                    let sign = if *side == 0 { 1.0 } else { -1.0 };
                    put(frames + 2 * events + row, if change.is_finite() { sign * change } else { 0.0 });
                }
                for e in 0..events {
                    put(frames + e, with.excess[e] - plain.excess[e]);
                    put(
                        frames + events + e,
                        log_slope(with.slope_per_s[e]) - log_slope(plain.slope_per_s[e]),
                    );
                }
            }
            columns
        };
        (0..base.len()).into_par_iter().map(of_pixel).collect()
    }
}

impl<L: FreeScene> SceneFit<'_, L> {
    /// Scores of effects on the present light. `free`: an applied effect whose size may change too.
    pub(super) fn score_effects(
        &mut self,
        candidates: &[usize],
        free: Option<usize>,
    ) -> Result<EffectScores, String> {
        let prediction = self.predict()?;
        let mut wanted: Vec<usize> = candidates.to_vec();
        wanted.extend(free);
        // Steps of candidates: forward, and back where it bends at the size that it has.
        let mut kept: Vec<(usize, f64, Option<f64>)> = Vec::new();
        let mut prepared = vec![self.prepared(&self.trial)?];
        for candidate in wanted {
            let (step, from) = (probe(candidate), self.size_of(candidate));
            // One that cannot be combined with what is there is no candidate.
            let Ok(with) = self.prepared(&self.trial_with(candidate, from + step)) else { continue };
            let is_two_sided = CANDIDATES[candidate].signs == Signs::Both && with.kernel().is_some();
            let back = match is_two_sided {
                true => self.prepared(&self.trial_with(candidate, from - step)).ok(),
                false => None,
            };
            kept.push((candidate, step, back.as_ref().map(|_| -step)));
            prepared.push(with);
            prepared.extend(back);
        }
        let mut rows = self.rows(&prepared, &prediction.light).into_iter();
        let base = rows.next().unwrap_or_default();
        let moved: Vec<StepColumns> = kept
            .iter()
            .map(|(_, step, back)| StepColumns {
                rows: rows.next().unwrap_or_default(),
                back: back.and_then(|_| rows.next()),
                step: step - back.unwrap_or(0.0),
            })
            .collect();
        let kept: Vec<usize> = kept.into_iter().map(|(candidate, ..)| candidate).collect();
        let effects = kept.len();
        let columns = self.ground.columns(&base, &moved);
        let predicted = self.predicted()?;
        self.light.prepare(&predicted);
        let scores = self.light.score(&predicted, &columns, effects);
        let is_with_free = free.is_some() && kept.last().copied() == free;
        let mut scored = self.summed(kept, is_with_free, &scores);
        // Of one alone, whose size is corrected, nothing is ranked.
        match effects {
            1 => scored.column = Some((predicted, columns)),
            _ => scored.gains = self.column_gains(&scored, effects, &predicted, &columns),
        }
        Ok(scored)
    }

    /// Gain of each of `effects` columns at its best size with a step of the light, nats.
    fn column_gains(
        &self,
        scored: &EffectScores,
        effects: usize,
        predicted: &[PixelPrediction],
        columns: &[Vec<f32>],
    ) -> Vec<f64> {
        let size = |k: usize| {
            let (candidate, size) = (scored.candidates.get(k)?, scored.sizes.get(k).copied().flatten()?);
            let from = self.size_of(*candidate);
            Some(bounded(*candidate, from + size) - from)
        };
        let sizes: Vec<f64> = (0..effects).map(|k| size(k).unwrap_or(0.0)).collect();
        let mut gains = vec![0.0; effects];
        let of_pixels = self.light.gains(predicted, columns, &sizes);
        for (place, found) in of_pixels.iter().enumerate() {
            if let Some(found) = found.as_ref().filter(|_| self.ground.is_measured(place)) {
                gains.iter_mut().zip(found).for_each(|(to, gain)| *to += gain);
            }
        }
        gains
    }

    fn summed(
        &self,
        mut candidates: Vec<usize>,
        is_with_free: bool,
        scores: &[Option<Score>],
    ) -> EffectScores {
        let effects = candidates.len();
        let (mut score, mut information, mut known) =
            (vec![0.0; effects], vec![0.0; effects * effects], vec![0.0; effects]);
        let mut of_places: BTreeMap<(u32, u32), (Vec<f64>, Vec<f64>)> = BTreeMap::new();
        let width = self.ground.case.extent.width;
        for (place, found) in scores.iter().enumerate() {
            let Some(found) = found else { continue };
            if !self.ground.has_events(place) {
                continue;
            }
            let pixel = self.light.pixels()[place];
            let (x, y) = (pixel % width / SIDE, pixel / width / SIDE);
            let of_place = of_places.entry((y, x)).or_insert((vec![0.0; effects], vec![0.0; effects]));
            for k in 0..effects {
                score[k] += found.score[k];
                known[k] += found.known[k];
                of_place.0[k] += found.score[k];
                of_place.1[k] += found.information[k * effects + k];
            }
            information.iter_mut().zip(&found.information).for_each(|(to, v)| *to += v);
        }
        // The Schur complement on what is free with each.
        let free = is_with_free.then(|| effects - 1);
        candidates.truncate(free.unwrap_or(effects));
        let (mut sizes, mut informations, mut agreement) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..candidates.len() {
            let (mut s, mut i) = (score[k], information[k * effects + k]);
            if let Some(other) = free.filter(|other| information[other * effects + other] > 0.0) {
                let ratio = information[k * effects + other] / information[other * effects + other];
                s -= ratio * score[other];
                i -= ratio * information[k * effects + other];
            }
            let is_seen = i > ABSORBED * known[k] && i > 0.0;
            let size = -s / i;
            sizes.push((is_seen && size.is_finite()).then_some(size));
            informations.push(i.max(0.0));
            let scatter: f64 = of_places
                .values()
                .map(|(score, information)| {
                    let left = score[k] + information[k] * size;
                    left * left
                })
                .sum();
            agreement.push(if is_seen { size.abs() * i / scatter.sqrt().max(1e-300) } else { 0.0 });
        }
        known.truncate(candidates.len());
        let gains = Vec::new();
        EffectScores { candidates, sizes, information: informations, known, gains, agreement, column: None }
    }
}
