//! Selects a formula for a curve over a covariate.
//!
//! The bins of a curve ([`super::open`]) take any shape. A formula has one or two forms and two or three
//! parameters. It is fitted to the same residuals, evaluated on held-out blocks, and compared by a criterion
//! like that of Schwarz: twice the held-out log-likelihood, less the log of the number of events per fitted
//! parameter. Events at one place of the scene have common errors, so log-likelihoods count as if standard
//! errors were three times as large.
//!
//! Source: Schwarz, Estimating the dimension of a model (Annals of Statistics 6, 1978).

use super::EventResiduals;
use super::fit::{EffectColumn, FittedColumns, NullFit, ResidualRows, heldout};
use super::laid::CovariateColumns;
use super::open::{SecondCurveFactors, moving};
use super::setting::ERRORS;
use crate::dependence::Dependence;
use crate::formula::{Formula, applies, shape_values};
use photocurrent_sensor::form::{Form, Term};

/// Formulas whose criterion is within this of the best one's are reported (Kass and Raftery, Bayes factors,
/// 1995: beyond 6 is strong).
const NEAR: f64 = 6.0;
/// Largest ratio of a curve's gain to that of its formula; above it the curve is reported without a formula.
const MOST_BETTER: f64 = 1.25;

/// A sum of two forms gains so many times as much as a curve at the most: the bins of a curve are coarse.
/// Not calibrated: it spares the time of sums that could not be near.
const LEFT_OVER: f64 = 1.05;

/// Formulas of a curve, best first; none of a class, and where none explains the curve.
pub(crate) fn formulas(
    events: &EventResiduals,
    residual: &[f64],
    block: &[u32],
    laid: &[CovariateColumns],
    curve: &Dependence,
    threshold: f64,
    least: f64,
) -> Vec<Formula> {
    let factors = SecondCurveFactors::from_curve(laid, curve);
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
    let slope = &events.slope_per_s[..];
    let rows = ResidualRows { slope, block, events: residual.len(), least, soft: None, free: &[] };
    let plain = NullFit::new(residual, rows);
    let column = |of: &dyn Fn(f64) -> f64| -> EffectColumn {
        let part = |x: f64| if x.is_finite() { of(x) } else { 0.0 };
        let here = |k: usize| factors.at(k) * part(laid.at[k]);
        moving(events, curve.moved, threshold, here, |k| {
            factors.factor_at_previous_event(k) * part(laid.before[k])
        })
    };
    let whole = column(&|_| 1.0);
    let alone = heldout(&plain, &[&whole]).gain.max(0.0);
    let fitted = |terms: &[Term]| -> Option<(Formula, f64)> {
        let part = |n: usize| {
            let mut sizes = vec![0.0; Term::amplitudes(terms)];
            sizes[n] = 1.0;
            move |x: f64| Term::sum(terms, &sizes, x)
        };
        let parts: Vec<_> = (0..Term::amplitudes(terms)).map(part).collect();
        if !parts.iter().all(|of| known.iter().all(|x| of(*x).is_finite())) {
            return None;
        }
        let columns: Vec<EffectColumn> = parts.iter().map(|of| column(of)).collect();
        let columns: Vec<&EffectColumn> = std::iter::once(&whole).chain(&columns).collect();
        let FittedColumns { size, error, gain, .. } = heldout(&plain, &columns);
        let amplitudes = size[1..].to_vec();
        let mean = |of: &dyn Fn(f64) -> f64| known.iter().map(|x| of(*x)).sum::<f64>() / known.len() as f64;
        // Only with the scene, or where something multiplies it, is known what is the same everywhere.
        let constant = match curve.is_with_scene || curve.times.is_some() {
            true => size[0],
            false => -amplitudes.iter().zip(&parts).map(|(size, of)| size * mean(of)).sum::<f64>(),
        };
        let (gain, count) = (gain - alone, known.len() as f64);
        let numbers = Term::numbers(terms) as f64;
        let criterion = 2.0 * gain * count / (ERRORS * ERRORS) - numbers * libm::log(count);
        let Term { form, shape } = terms[0];
        let (plus, errors) = (terms.get(1).copied(), error[1..].to_vec());
        Some((Formula { form, shape, plus, constant, amplitudes, errors, gain, probability: 0.0 }, criterion))
    };
    // The best shape of a form, in addition to a term that stands.
    let best_of = |form: Form, other: Option<Term>| {
        let with = |shape: f64| -> Vec<Term> { other.into_iter().chain([Term { form, shape }]).collect() };
        let tried = shape_values(form, low, high).into_iter().filter_map(|shape| fitted(&with(shape)));
        tried.max_by(|a, b| a.1.total_cmp(&b.1))
    };
    let forms: Vec<Form> =
        Form::ALL.into_iter().filter(|form| applies(*form, curve.covariate, low, high)).collect();
    let mut found: Vec<(Formula, f64)> = forms.iter().filter_map(|form| best_of(*form, None)).collect();
    // A sum can only be near the best form where that leaves something of the curve.
    let most = found.iter().map(|(one, _)| one.gain).fold(0.0, f64::max);
    let room = 2.0 * (LEFT_OVER * curve.nats_per_event - most) * known.len() as f64 / (ERRORS * ERRORS);
    let singles = if room > libm::log(known.len() as f64) - NEAR { &found[..] } else { &[] };
    let mut sums = two_form_sums(singles, &forms, best_of);
    found.append(&mut sums);
    near_best_formulas(found, curve)
}

/// Sums of two forms; the first ones have their best shapes. `best_of` fits a form in addition to a fixed
/// term.
fn two_form_sums(
    singles: &[(Formula, f64)],
    forms: &[Form],
    best_of: impl Fn(Form, Option<Term>) -> Option<(Formula, f64)>,
) -> Vec<(Formula, f64)> {
    let mut sums: Vec<(Formula, f64)> = Vec::new();
    for (n, (one, _)) in singles.iter().enumerate() {
        // A step may be there twice.
        for form in forms.iter().filter(|form| is_later(&singles[n..], **form) || **form == Form::Step) {
            let first = Term { form: one.form, shape: one.shape };
            let Some(second) = best_of(*form, Some(first)).and_then(|(sum, _)| sum.plus) else { continue };
            // Each as it is with the other one.
            sums.extend(best_of(one.form, Some(second)));
        }
    }
    sums
}

/// Formulas near the best one that explain the curve, best first, with their probabilities.
fn near_best_formulas(mut found: Vec<(Formula, f64)>, curve: &Dependence) -> Vec<Formula> {
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

/// Is a form later in the list than the first of these?
fn is_later(found: &[(Formula, f64)], form: Form) -> bool {
    found.iter().skip(1).any(|(other, _)| other.form == form)
}

#[cfg(test)]
mod tests {
    use super::super::open::dependences;
    use super::super::open::tests::{events, laid};
    use super::*;
    use crate::covariates::Covariate;
    use crate::dependence::AffectedQuantity;
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
        assert_eq!(curve.moved, AffectedQuantity::Threshold);
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
    fn a_sum_of_two_forms_is_found_where_neither_explains_the_curve() {
        let both = found(Covariate::Time, (0.0, 0.16), |x| 2.0 * x - if x < 0.08 { 0.0 } else { 0.25 });
        let best = &both[0];
        let forms = [Some(best.form), best.plus.map(|plus| plus.form)];
        assert!(forms.contains(&Some(Form::Linear)) && forms.contains(&Some(Form::Step)), "{both:?}");
        let of = |form: Form| best.amplitudes[usize::from(best.form != form)];
        assert!((of(Form::Linear) - 2.0).abs() < 0.1 && (of(Form::Step) + 0.25).abs() < 0.02, "{both:?}");
        // One form is enough for a line.
        let line = found(Covariate::Time, (0.0, 0.2), |x| 0.5 * x);
        assert_eq!((line[0].form, line[0].plus), (Form::Linear, None), "{line:?}");
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
