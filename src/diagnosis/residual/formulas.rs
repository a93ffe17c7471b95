//! Which formula a curve over a covariate follows.
//!
//! The bins of a curve ([`super::open`]) take any shape. A formula has a form and two or three numbers; it
//! is fitted to the same residuals, judged on the blocks that it was not fitted to, and compared by a
//! criterion like that of Schwarz: twice its held-out log-likelihood, less the logarithm of the number of
//! events for each number that was fitted. Events of one place of the scene err alike, so log-likelihoods
//! count as if standard errors were three times as large.
//!
//! Source: Schwarz, Estimating the dimension of a model (Annals of Statistics 6, 1978).

use super::Residuals;
use super::fit::{Column, Fitted, Plain, Rows, heldout};
use super::laid::Laid;
use super::open::moving;
use super::setting::ERRORS;
use crate::dependence::Dependence;
use crate::formula::{Formula, applies, tried};
use photocurrent_sensor::form::Form;

/// Formulas whose criterion is within this of the best one's are reported (Kass and Raftery, Bayes factors,
/// 1995: beyond 6 is strong).
const NEAR: f64 = 6.0;
/// A formula explains a curve that gains no more than so many times as much: otherwise it is a curve
/// without a formula.
const MOST_BETTER: f64 = 1.25;

/// Formulas of a curve, best first; none of a class, and where none explains the curve.
pub(crate) fn formulas(
    events: &Residuals,
    residual: &[f64],
    block: &[u32],
    laid: &[Laid],
    curve: &Dependence,
    threshold: f64,
    least: f64,
) -> Vec<Formula> {
    let Some(laid) = laid.iter().find(|laid| laid.covariate == curve.covariate) else { return Vec::new() };
    if curve.covariate.is_class() {
        return Vec::new();
    }
    // Events without a value keep what they have.
    let known: Vec<f64> = laid.at.iter().copied().filter(|x| x.is_finite()).collect();
    let (low, high) = known
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (f64::min(low, *x), f64::max(high, *x)));
    if high <= low {
        return Vec::new();
    }
    let rows =
        Rows { slope: &events.slope_per_s, block, events: residual.len(), least, soft: None, free: &[] };
    let plain = Plain::new(residual, rows);
    let column = |of: &dyn Fn(f64) -> f64| -> Column {
        let part = |x: f64| if x.is_finite() { of(x) } else { 0.0 };
        moving(events, curve.moved, threshold, |k| part(laid.at[k]), |k| part(laid.before[k]))
    };
    let whole = column(&|_| 1.0);
    let alone = heldout(&plain, &[&whole]).gain.max(0.0);
    let fitted = |form: Form, shape: f64| -> Option<(Formula, f64)> {
        let is_finite = known.iter().all(|x| form.value(0, shape, *x).is_finite());
        if !is_finite {
            return None;
        }
        let parts: Vec<Column> =
            (0..form.amplitudes()).map(|n| column(&|x| form.value(n, shape, x))).collect();
        let columns: Vec<&Column> = std::iter::once(&whole).chain(&parts).collect();
        let Fitted { size, error, gain, .. } = heldout(&plain, &columns);
        let amplitudes = size[1..].to_vec();
        let mean =
            |n: usize| known.iter().map(|x| form.value(n, shape, *x)).sum::<f64>() / known.len() as f64;
        // Only with the scene is known what is the same everywhere.
        let constant = match curve.is_with_scene {
            true => size[0],
            false => -amplitudes.iter().enumerate().map(|(n, size)| size * mean(n)).sum::<f64>(),
        };
        let gain = gain - alone;
        let numbers = (form.amplitudes() + form.shapes()) as f64;
        let count = known.len() as f64;
        let criterion = 2.0 * gain * count / (ERRORS * ERRORS) - numbers * libm::log(count);
        let errors = error[1..].to_vec();
        Some((Formula { form, shape, constant, amplitudes, errors, gain, probability: 0.0 }, criterion))
    };
    let best_of = |form: Form| {
        let tried = tried(form, low, high).into_iter().filter_map(|shape| fitted(form, shape));
        tried.max_by(|a, b| a.1.total_cmp(&b.1))
    };
    let applies = |form: &Form| applies(*form, curve.covariate, low, high);
    let mut found: Vec<(Formula, f64)> = Form::ALL.into_iter().filter(applies).filter_map(best_of).collect();
    found.sort_by(|a, b| b.1.total_cmp(&a.1));
    let Some(best) = found.first().map(|(_, criterion)| *criterion) else { return Vec::new() };
    found.retain(|(formula, criterion)| {
        best - criterion < NEAR && MOST_BETTER * formula.gain > curve.nats_per_event
    });
    let weight = |criterion: f64| libm::exp(0.5 * (criterion - best));
    let all: f64 = found.iter().map(|(_, criterion)| weight(*criterion)).sum();
    found
        .into_iter()
        .map(|(formula, criterion)| Formula { probability: weight(criterion) / all, ..formula })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::open::dependences;
    use super::super::open::tests::{events, laid};
    use super::*;
    use crate::covariates::Covariate;
    use crate::dependence::Moved;
    use photocurrent_core::random::Random;

    /// Formulas of the curve that is found first in residuals to which `change` of the variable was added,
    /// as a share of thresholds of 0.2.
    fn found(covariate: Covariate, range: (f64, f64), change: impl Fn(f64) -> f64) -> Vec<Formula> {
        found_by(covariate, range, change, false)
    }

    fn found_by(
        covariate: Covariate,
        range: (f64, f64),
        change: impl Fn(f64) -> f64,
        is_with_scene: bool,
    ) -> Vec<Formula> {
        let (events, block, mut residual) = events(8_000);
        let mut random = Random::new(9, &[]);
        let x: Vec<f64> = residual.iter().map(|_| range.0 + (range.1 - range.0) * random.uniform()).collect();
        for k in 0..residual.len() {
            residual[k] += 0.2 * f64::from(events.polarity[k]) * change(x[k]);
        }
        let laid = [laid(x, covariate)];
        let curves = dependences(&events, &residual, &block, &laid, 0.2, 1e-4);
        let curve = Dependence { is_with_scene, ..curves[0].dependence.clone() };
        assert_eq!(curve.moved, Moved::Threshold);
        formulas(&events, &residual, &block, &laid, &curve, 0.2, 1e-4)
    }

    #[test]
    fn the_formula_that_made_a_curve_is_found_with_its_numbers() {
        let line = found(Covariate::Time, (0.0, 0.2), |x| 0.05 + 1.5 * x);
        assert_eq!(line[0].form, Form::Linear, "{line:?}");
        assert!((line[0].amplitudes[0] - 1.5).abs() < 0.05, "{line:?}");
        // The mean is an effect of the catalogue.
        assert!((line[0].constant + 1.5 * 0.1).abs() < 0.01, "{line:?}");
        let with_scene = found_by(Covariate::Time, (0.0, 0.2), |x| 0.05 + 1.5 * x, true);
        assert!((with_scene[0].constant - 0.05).abs() < 0.01, "{with_scene:?}");

        let square = found(Covariate::Radius, (0.0, 1.0), |x| 0.3 * x * x);
        assert_eq!((square[0].form, square[0].shape), (Form::Power, 2.0), "{square:?}");
        assert!((square[0].amplitudes[0] - 0.3).abs() < 0.01, "{square:?}");

        // Sixteenths of the range are tried.
        let step = found(Covariate::Time, (0.0, 0.16), |x| if x < 0.1 { 0.0 } else { -0.2 });
        assert_eq!(step[0].form, Form::Step, "{step:?}");
        assert!(
            (step[0].shape - 0.1).abs() < 0.011 && (step[0].amplitudes[0] + 0.2).abs() < 0.01,
            "{step:?}"
        );

        // Those of time constants that are tried are a factor of 1.22 apart.
        let relaxed = found(Covariate::Time, (0.0, 0.2), |x| 0.3 * libm::exp(-x / 0.03));
        let one = relaxed.iter().find(|formula| formula.form == Form::Relaxation).expect("reported");
        assert!(
            (libm::log(one.shape / 0.03)).abs() < 0.25 && (one.amplitudes[0] - 0.3).abs() < 0.03,
            "{one:?}"
        );

        let sine =
            found(Covariate::AcPhase, (0.0, 1.0), |x| 0.1 * libm::sin(core::f64::consts::TAU * x + 0.4));
        assert_eq!(sine[0].form, Form::Sine);
        let [a, b] = [sine[0].amplitudes[0], sine[0].amplitudes[1]];
        assert!(
            (libm::hypot(a, b) - 0.1).abs() < 0.005 && (libm::atan2(b, a) - 0.4).abs() < 0.05,
            "{sine:?}"
        );
    }

    #[test]
    fn probabilities_of_what_is_reported_sum_to_one_and_a_zigzag_has_no_formula() {
        let line = found(Covariate::Time, (0.0, 0.2), |x| 0.5 * x);
        assert!((line.iter().map(|formula| formula.probability).sum::<f64>() - 1.0).abs() < 1e-9, "{line:?}");
        let zigzag = found(Covariate::Time, (0.0, 0.6), |x| {
            if ((x * 10.0) as usize).is_multiple_of(2) { 0.2 } else { -0.2 }
        });
        assert!(zigzag.is_empty(), "{zigzag:?}");
    }
}
