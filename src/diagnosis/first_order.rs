//! What all pixels say of every effect to first order ([`crate::linear`]), and of what is drawn at random ([`crate::components`]), as proposals.
//!
//! The gates were set on recordings of the generator of `data/sealed` with another seed; docs/diagnosis.md says what they do elsewhere.

use crate::candidates::CANDIDATES;
use crate::components::{Component, Spread};
use crate::covariates::Covariate;
use crate::law::{Law, Moved};
use crate::linear::Linear;
use crate::report::Detectable;
use crate::verdict::Proposal;

/// Strengths from here on are at the end of what is tried: nothing agreed best there.
pub const LARGEST: f64 = 5.9;

/// Strengths that recordings without an effect seem to have, by candidate, as root mean squares; without knowledge all have the same.
pub struct Biases(pub Vec<f64>);

impl Biases {
    /// Where nothing is known.
    const UNKNOWN: f64 = 0.1;

    /// That of a candidate.
    pub fn of(&self, candidate: usize) -> f64 {
        self.0.get(candidate).copied().filter(|bias| *bias > 0.0).unwrap_or(Biases::UNKNOWN)
    }
}

/// What an effect must take away to first order, and be in standard errors, significance, and share of the parts of the array that it improves.
pub struct Gate {
    taken: f64,
    sigmas: f64,
    significance: f64,
    better: f64,
}

/// Where no refit passes.
pub const ALONE: Gate = Gate { taken: 0.05, sigmas: 3.5, significance: 3.0, better: 0.6 };
/// Beside one that does.
pub const BESIDE: Gate = Gate { taken: 0.02, sigmas: 3.5, significance: 3.5, better: 0.65 };
/// What an effect takes away more than another, as a logarithm, counts so much as a logarithm of belief.
const TAKEN_WEIGHT: f64 = 3.0;

/// Effects that noise of frames, the roughness of the light, or any loss of events look like: these need more than closures to be believed.
fn is_like_noise(id: &str) -> bool {
    matches!(id, "black_level" | "frame_nonlinearity" | "image_lag" | "exposure_time" | "reset_memory" | "vignetting" | "frame_coupling" | "lateral_inhibition")
}

/// All candidates of a regression, those that pass a gate marked. `value` is a parameter at a strength, in the unit of its declaration.
pub fn told(all: &[Linear], biases: &Biases, value: &dyn Fn(usize, f64) -> f64, gate: Gate) -> Vec<Proposal> {
    let passes = |one: &Linear| {
        one.taken > gate.taken
            && one.sigmas(biases.of(one.candidate)).abs() > gate.sigmas
            && one.significance > gate.significance
            && one.better > gate.better
            && one.strength.abs() < LARGEST
            && !is_like_noise(CANDIDATES[one.candidate].id)
    };
    let most = all.iter().filter(|one| passes(one)).map(|one| one.taken).fold(0.0, f64::max);
    let at = |one: &Linear, strength: f64| value(one.candidate, strength);
    let proposal = |one: &Linear| {
        let (a, b) = (at(one, one.strength - 1.96 * one.error), at(one, one.strength + 1.96 * one.error));
        Proposal {
            candidate: one.candidate,
            score: f64::max(one.taken / gate.taken, 0.0),
            probability: if passes(one) { libm::exp(TAKEN_WEIGHT * libm::log(one.taken / most)) } else { 0.0 },
            value: at(one, one.strength),
            ci95: Some([f64::min(a, b), f64::max(a, b)]),
            passed: passes(one),
            ..Proposal::default()
        }
    };
    all.iter().map(proposal).collect()
}

/// A variance of thresholds from pixel to pixel must be so many standard errors; simulated recordings without it reach 3.5, and 4.9 where light errs with history.
const LEAST_SPREAD: f64 = 4.5;
/// And one of delays from row to row, which come to 5 where the light is faster than its estimate.
const LEAST_SPREAD_OF_ROWS: f64 = 6.0;

/// Variances are told only where light errs with history by less than this share of the squares.
const MOST_HISTORY: f64 = 0.1;

/// What is drawn at random, from its variances, where `laws` do not say that light errs.
pub fn of_chance(components: &[Component], laws: &[Law]) -> Vec<Proposal> {
    let errs = laws.iter().any(|law| law.moved != Moved::Rate && law.covariate == Covariate::TimeSinceLastEvent && law.taken > MOST_HISTORY);
    let told = |one: &Component| {
        let (candidate, least) = match one.spread {
            Spread::ThresholdsOfPixels => (("threshold_mismatch", "sigma"), LEAST_SPREAD),
            Spread::DelaysOfRows => (("row_skew", "sigma"), LEAST_SPREAD_OF_ROWS),
        };
        let candidate = CANDIDATES.iter().position(|one| (one.id, one.parameter) == candidate)?;
        let root = |variance: f64| libm::sqrt(f64::max(variance, 0.0));
        (one.significance() > least && !errs).then(|| Proposal {
            candidate,
            score: one.significance() / least,
            probability: 0.5,
            value: root(one.variance),
            ci95: Some([root(one.variance - 1.96 * one.error), root(one.variance + 1.96 * one.error)]),
            passed: true,
            ..Proposal::default()
        })
    };
    components.iter().filter_map(told).collect()
}

/// What all pixels could have seen of an effect, to first order.
pub fn measured(one: &Linear, biases: &Biases, value: &dyn Fn(usize, f64) -> f64) -> Detectable {
    let candidate = &CANDIDATES[one.candidate];
    let (parameter, unit) = candidate.json_key();
    let error = libm::hypot(one.error, biases.of(one.candidate));
    let size =
        |strength: f64| if candidate.is_limit() { value(one.candidate, strength) } else { (value(one.candidate, strength) - value(one.candidate, 0.0)).abs() };
    Detectable {
        id: candidate.id.to_owned(),
        parameter,
        estimate: Some(value(one.candidate, one.strength)).filter(|_| !candidate.is_limit() && !unit.is_empty()),
        standard_error: Some(size(error)).filter(|_| !candidate.is_limit()),
        minimal_detectable: size(ALONE.sigmas * error),
        unit: unit.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn linear(id: &str, strength: f64, taken: f64) -> Linear {
        let candidate = CANDIDATES.iter().position(|one| one.id == id).unwrap();
        Linear { candidate, strength, error: 0.02, taken, significance: 6.0, better: 0.9 }
    }

    fn value(_: usize, strength: f64) -> f64 {
        strength
    }

    #[test]
    fn a_strength_counts_when_it_is_more_than_sound_recordings_have() {
        let all = [linear("threshold_scale", 0.4, 0.09), linear("black_level", 0.8, 0.2), linear("row_skew", 1.0, 0.01)];
        let passed = |bias: f64| -> Vec<bool> { told(&all, &Biases(vec![bias; CANDIDATES.len()]), &value, ALONE).iter().map(|one| one.passed).collect() };
        // What noise looks like never passes alone, and what takes away next to nothing neither.
        assert_eq!(passed(0.05), [true, false, false]);
        assert_eq!(passed(0.3), [false; 3]);
        let seen = measured(&all[0], &Biases(vec![0.3; CANDIDATES.len()]), &value);
        assert!((seen.minimal_detectable - ALONE.sigmas * libm::hypot(0.3, 0.02)).abs() < 1e-12 && seen.standard_error.is_some());
        assert!(measured(&linear("high_pass_front_end", 0.4, 0.1), &Biases(Vec::new()), &value).standard_error.is_none());
    }

    #[test]
    fn variances_are_told_with_their_size_and_not_where_light_errs() {
        let components = [
            Component { spread: Spread::ThresholdsOfPixels, variance: 4e-4, error: 4e-5 },
            Component { spread: Spread::DelaysOfRows, variance: 1e-8, error: 1e-8 },
        ];
        let found = of_chance(&components, &[]);
        assert_eq!(found.len(), 1);
        assert!(CANDIDATES[found[0].candidate].id == "threshold_mismatch" && (found[0].value - 0.02).abs() < 1e-12);
        let law = Law {
            moved: Moved::Threshold,
            covariate: Covariate::TimeSinceLastEvent,
            period_s: None,
            at: Vec::new(),
            value: Vec::new(),
            error: Vec::new(),
            taken: 0.3,
            significance: 5.0,
            nats_per_change: 0.1,
        };
        assert!(of_chance(&components, &[law]).is_empty());
    }
}
