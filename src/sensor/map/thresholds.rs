//! Thresholds as unknowns, without the pull of the prior.
//!
//! A prior that takes its scale from the light itself likes small changes: light that moves half as far costs
//! it a quarter. As long as the thresholds are stated, events hold the light. Thresholds that may move give
//! way, and light and thresholds shrink together. But how far light moves is not what the prior knows
//! anything about. So its scale moves with the thresholds: its cost P counts as `P (stated / threshold)^2`,
//! which is the same for a light and a threshold twice as large, and only the frames decide. To first order
//! that is a prior mean of the thresholds off the stated ones, from the cost of the light of now:
//! `sigma^2 P share / threshold`, where `share` is each polarity's part of the way that all events together
//! have gone.

use super::problem::{MapProblem, Noise, Offsets};

/// What is to be expected of the thresholds' offsets, when the prior's cost is `prior_cost` at these
/// `offsets`.
pub(super) fn expected(problem: &MapProblem<'_>, prior_cost: f64, offsets: &Offsets) -> Offsets {
    let variance = problem.noise.threshold * problem.noise.threshold;
    if variance == 0.0 || problem.events.is_empty() {
        return Offsets::default();
    }
    let rising = problem.events.iter().filter(|event| event.polarity > 0).count() as f64;
    let falling = problem.events.len() as f64 - rising;
    let way = rising * (problem.sensor.threshold_on + offsets.on).abs()
        + falling * (problem.sensor.threshold_off + offsets.off).abs();
    let per_event = if way > 0.0 { variance * prior_cost / way } else { 0.0 };
    Offsets { reference: 0.0, on: per_event * rising, off: per_event * falling }
}

/// What the expectation subtracts twice the negative log of the posterior density.
pub(super) fn pulled(expected: &Offsets, offsets: &Offsets, noise: &Noise) -> f64 {
    let variance = noise.threshold * noise.threshold;
    if variance > 0.0 {
        2.0 * (expected.on * offsets.on + expected.off * offsets.off) / variance
    } else {
        0.0
    }
}
