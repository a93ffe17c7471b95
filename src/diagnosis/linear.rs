//! What each effect of the catalogue explains to first order in its strength, seen by all pixels at once.
//!
//! The stated sensor, and the sensor with each effect, look at the recording's own light. By how much the changes of closures ([`crate::closures`]) differ between both is the
//! effect's *template*; what the recording's changes have beyond those of a simulated recording of the stated sensor is regressed on it. That asks nothing of single events,
//! so that effects too small to be seen in any pixel add up over the array; but it knows closures alone, and is exact for small effects only.
//!
//! Closures err from event to event, and an effect that moves events makes them err anew. Every template is therefore made twice, of light that is met at other instants,
//! and products are taken of one with the other: what each errs by for itself has no share in them.

use crate::candidates::{CANDIDATES, Scales, Signs, Trial};
use crate::case::Case;
use crate::components::{Component, components};
use crate::nominal::Nominal;
use crate::record::{Conditions, record};
use crate::regression::{Products, RIDGE, jackknife};
use crate::scene::Scene;
use crate::side::{PART_COUNT, Side, at_changes, differences, part_of, sampled};
use photocurrent_core::random::Random;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How well a candidate explains changes of closures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Linear {
    /// Number in [`CANDIDATES`].
    pub candidate: usize,
    /// Its strength.
    pub strength: f64,
    /// Standard error of that, from part to part of the array.
    pub error: f64,
    /// Share of the squares that it takes away, on pixels that it was not fitted to.
    pub taken: f64,
    /// The same over its standard error from part to part.
    pub significance: f64,
    /// Share of the parts that it improves.
    pub better: f64,
}

/// Of an array with more events than this only some blocks are looked at.
const MOST_EVENTS: usize = 24_000;
/// Templates are made twice, met at other instants: what they err by from event to event must not count as size.
const TWINS: [u64; 2] = [1, 3];
/// How long a pixel's light begins elsewhere, ns.
const INSTANT_NS: i64 = 1_000;
/// What moves closures by chance alone, or not to first order.
const HARDLY_SEEN: [&str; 4] = ["large_signal_front_end", "slew_limit", "readout_queue", "timestamp_quantization"];
/// Both templates of a candidate must agree by this, as a correlation, or neither says what it does.
const LEAST_AGREEMENT: f64 = 0.15;
/// Strength at which templates are made.
const STRENGTH: f64 = 0.5;

impl Linear {
    /// Its strength in standard errors, those of recordings without an effect (`bias`) among them.
    pub fn sigmas(&self, bias: f64) -> f64 {
        self.strength / f64::max(libm::hypot(self.error, bias), 1e-12)
    }
}

/// The strength at which a candidate's template is made.
fn made_at(candidate: usize) -> f64 {
    if CANDIDATES[candidate].signs == Signs::Switch { 1.0 } else { STRENGTH }
}

/// Templates of all candidates with events of their own, ready for any regression.
pub struct Templates {
    /// The candidate of each column.
    pub candidates: Vec<usize>,
    /// Variances of what is drawn at random.
    pub components: Vec<Component>,
    /// By part of the array and half of its pixels.
    parts: Vec<[Products; 2]>,
}

impl Templates {
    /// Of a recording.
    ///
    /// # Errors
    /// When effects cannot be combined.
    pub fn new(case: &Case, nominal: &Nominal, scales: &Scales, frame_noise: f64) -> Result<Templates, String> {
        let sample = sampled(case, MOST_EVENTS);
        let here = Side::new(case, nominal, &sample);
        let base = Trial::stated(nominal);
        // The same light met at other instants: what closures err by from event to event must be shared by no two of these.
        let again = |trial: &Trial, seed: u64| -> Result<Side, String> {
            let conditions = Conditions { seed, frame_share: frame_noise, ..Conditions::default() };
            let light = begun_elsewhere(&here.light, scales.threshold, seed);
            Ok(Side::new(&record(case, &trial.nominal, &sample, &light, &trial.effects, &conditions)?, nominal, &sample))
        };
        let stated = TWINS.map(|seed| again(&base, seed));
        let [Ok(first), Ok(second)] = &stated else { return Err("the stated sensor cannot be simulated".into()) };
        let mut columns: Vec<(usize, [Vec<f64>; 2])> = (0..CANDIDATES.len())
            .into_par_iter()
            .filter(|n| !CANDIDATES[*n].is_random && !HARDLY_SEEN.contains(&CANDIDATES[*n].id))
            .filter_map(|candidate| {
                let mut trial = base.clone();
                CANDIDATES[candidate].put_on(&mut trial, made_at(candidate), scales);
                let template = |seed: u64, stated: &Side| Some(differences(&here.changes, &again(&trial, seed).ok()?.changes, &stated.changes));
                Some((candidate, [template(TWINS[0], first)?, template(TWINS[1], second)?]))
            })
            .collect();
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).zip(&here.changes).map(|((a, b), change)| change.weight * a * b).sum::<f64>();
        columns.retain(|(_, [a, b])| product(a, b) > LEAST_AGREEMENT * libm::sqrt(product(a, a) * product(b, b)));
        columns.sort_by_key(|column| column.0);
        let control = again(&base, 2)?;
        let components = components(case, nominal, &sample, &here.changes, &control.changes);
        let own = at_changes(&here.changes, &control.changes);
        let mut parts: Vec<[Products; 2]> = (0..PART_COUNT).map(|_| std::array::from_fn(|_| Products::new(2 * columns.len()))).collect();
        let mut row: Vec<(usize, f64)> = Vec::with_capacity(columns.len());
        for (n, change) in here.changes.iter().enumerate() {
            let pixel = sample.pixels[change.place] as usize;
            let (x, y) = case.place(pixel);
            let Some(own) = own[n] else { continue };
            row.clear();
            row.extend((0..2).flat_map(|twin| columns.iter().map(move |column| column.1[twin][n])).enumerate());
            parts[part_of(case.extent, x, y)][(x + y) as usize % 2].add(&row, change.value - own, change.weight);
        }
        Ok(Templates {
            candidates: columns.iter().map(|column| column.0).collect(),
            components,
            parts: parts.iter().map(|part| part.each_ref().map(Products::of_twins)).collect(),
        })
    }

    /// What each candidate explains beside the candidates that are kept, what takes away most first.
    pub fn beside(&self, kept: &[usize]) -> Vec<Linear> {
        let kept: Vec<usize> = kept.iter().filter_map(|kept| self.candidates.iter().position(|candidate| candidate == kept)).collect();
        let mut all: Vec<Linear> = (0..self.candidates.len()).filter(|n| !kept.contains(n)).filter_map(|n| self.explained(&kept, n)).collect();
        all.sort_by(|a, b| b.taken.total_cmp(&a.taken).then(a.candidate.cmp(&b.candidate)));
        all
    }

    fn explained(&self, kept: &[usize], n: usize) -> Option<Linear> {
        let halves: [Products; 2] = std::array::from_fn(|half| sum(self.parts.iter().map(|part| &part[half])));
        let before = |column: usize| kept.contains(&column);
        let with = |column: usize| before(column) || column == n;
        // Only in the direction that is physics.
        let is_physics = |coefficient: f64| CANDIDATES[self.candidates[n]].signs == Signs::Both || coefficient > 0.0;
        let fits: [(Vec<f64>, Vec<f64>); 2] = std::array::from_fn(|half| {
            let without = halves[1 - half].solve(before, RIDGE);
            let full = halves[1 - half].solve(with, RIDGE);
            if is_physics(full[n]) { (without, full) } else { (without.clone(), without) }
        });
        let (mut left, mut gains, mut coefficients) = (0.0, Vec::new(), Vec::new());
        for part in &self.parts {
            if part[0].rows + part[1].rows == 0.0 {
                continue;
            }
            let mut gain = 0.0;
            for (half, (without, full)) in fits.iter().enumerate() {
                let base = part[half].left(without);
                left += base;
                gain += base - part[half].left(full);
            }
            gains.push(gain);
            let rest = sum(self.parts.iter().filter(|other| !std::ptr::eq(*other, part)).flatten());
            coefficients.push(rest.solve(with, RIDGE)[n]);
        }
        let count = gains.len() as f64;
        if count < 2.0 {
            return None;
        }
        let (mean, spread) = mean_and_spread(&gains);
        let strength = made_at(self.candidates[n]) * sum(self.parts.iter().flatten()).solve(with, RIDGE)[n];
        let error = made_at(self.candidates[n]) * jackknife(&coefficients);
        Some(Linear {
            candidate: self.candidates[n],
            strength,
            error,
            taken: count * mean / f64::max(left, 1e-300),
            significance: if spread > 0.0 { mean / spread * libm::sqrt(count) } else { 0.0 },
            better: gains.iter().filter(|gain| **gain > 0.0).count() as f64 / count,
        })
    }
}

/// Light whose pixels begin up to a threshold above or below, for an instant.
fn begun_elsewhere(light: &Scene, threshold: f64, seed: u64) -> Scene {
    Scene::from_pixels((0..light.len()).map(|n| {
        let (t, u) = light.pixel(n);
        let (mut t, mut u) = (t.to_vec(), u.to_vec());
        if t.len() > 1 && t[1] - t[0] > INSTANT_NS {
            t.insert(1, t[0] + INSTANT_NS);
            u.insert(1, u[0]);
            u[0] += threshold * (2.0 * Random::new(seed, &[n as u64, 7]).uniform() - 1.0);
        }
        (t, u, light.is_known[n])
    }))
}

fn sum<'a>(mut all: impl Iterator<Item = &'a Products>) -> Products {
    let mut sum = all.next().cloned().unwrap_or_else(|| Products::new(0));
    all.for_each(|other| sum.merge(other));
    sum
}

fn mean_and_spread(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (mean, libm::sqrt(values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / f64::max(n - 1.0, 1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::band::Band;
    use crate::candidates::Candidate;
    use crate::sample::Sample;
    use crate::scenes::MadeUp;
    use photocurrent_core::Extent;

    fn explained(case: &Case) -> Vec<Linear> {
        let nominal = case.nominal().unwrap();
        Templates::new(case, &nominal, &Scales::of(case, &nominal), 0.0).unwrap().beside(&[])
    }

    #[test]
    fn small_effects_are_found_with_their_sizes() {
        const HIDDEN: f64 = 0.6;
        let case = MadeUp::new(1, 0, Extent { width: 48, height: 36 }, 0.15).recording().unwrap();
        let (nominal, sample) = (case.nominal().unwrap(), Sample::all(&case, 4));
        let (scales, light) = (Scales::of(&case, &nominal), Band::scene(&case, &Band::all(&case, &nominal, &sample)));
        for (id, parameter) in [("black_level", "black_level_dn"), ("threshold_scale", "fraction"), ("threshold_gradient", "fraction"), ("clock_drift", "rate")]
        {
            let trial = Trial::with(&nominal, Candidate::find(id, parameter).unwrap(), HIDDEN, &scales);
            let conditions = Conditions { seed: 9, ..Conditions::default() };
            let found = explained(&record(&case, &trial.nominal, &sample, &light, &trial.effects, &conditions).unwrap());
            let own = found.iter().find(|one| CANDIDATES[one.candidate].id == id).unwrap_or_else(|| panic!("{id}"));
            // To first order, and the light is of the stated sensor: a tenth is left of 0.6.
            assert!((own.strength / HIDDEN - 1.0).abs() < 0.2, "{id}: {own:?}");
            assert!(own.taken > 0.5 * found[0].taken && own.significance > 2.0, "{id}: {own:?} beside {:?}", found[0]);
        }
    }

    #[test]
    fn a_sound_recording_has_strengths_near_nothing() {
        let found = explained(&MadeUp::new(1, 0, Extent { width: 48, height: 36 }, 0.15).recording().unwrap());
        assert!(found.len() > 10, "{}", found.len());
        // Of a strength of 1 an engineer would care; the tests above hide 0.6.
        let small = ["threshold_scale", "threshold_asymmetry", "threshold_gradient", "misalignment", "leak_events"];
        let seen: Vec<&Linear> = found.iter().filter(|one| small.contains(&CANDIDATES[one.candidate].id)).collect();
        assert!(seen.len() > 2 && seen.iter().all(|one| one.strength.abs() < 0.2), "{seen:?}");
    }
}
