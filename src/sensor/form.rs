//! Forms of formulas: what a curve over a variable may follow.

use serde::{Deserialize, Serialize};

/// A form of a formula over a variable x, with a shape number s.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Form {
    /// x.
    Linear,
    /// ln x.
    Logarithm,
    /// x^s.
    Power,
    /// exp(-x / s).
    Relaxation,
    /// x / (x + s).
    Saturation,
    /// 0 below s, 1 from s on.
    Step,
    /// sin and cos of 2 pi x.
    Sine,
}

impl Form {
    /// All of them.
    pub const ALL: [Form; 7] = [
        Form::Linear,
        Form::Logarithm,
        Form::Power,
        Form::Relaxation,
        Form::Saturation,
        Form::Step,
        Form::Sine,
    ];
    /// Their names in a description, in the same order.
    pub const NAMES: [&'static str; 7] =
        ["linear", "logarithm", "power", "relaxation", "saturation", "step", "sine"];

    /// The form of a name.
    pub fn named(name: &str) -> Option<Form> {
        Form::NAMES.iter().position(|other| *other == name).map(|n| Form::ALL[n])
    }

    /// How many amplitudes it has.
    pub fn amplitudes(self) -> usize {
        if self == Form::Sine { 2 } else { 1 }
    }

    /// How many shape numbers.
    pub fn shapes(self) -> usize {
        match self {
            Form::Linear | Form::Logarithm | Form::Sine => 0,
            Form::Power | Form::Relaxation | Form::Saturation | Form::Step => 1,
        }
    }

    /// The value of amplitude `n`'s part at `x`; not finite where x has none.
    pub fn value(self, n: usize, shape: f64, x: f64) -> f64 {
        match (self, n) {
            (Form::Linear, _) => x,
            (Form::Logarithm, _) => libm::log(x),
            (Form::Power, _) => libm::pow(x, shape),
            (Form::Relaxation, _) => libm::exp(-x / shape),
            (Form::Saturation, _) => x / (x + shape),
            (Form::Step, _) => f64::from(u8::from(x >= shape)),
            (Form::Sine, 0) => libm::sin(core::f64::consts::TAU * x),
            (Form::Sine, _) => libm::cos(core::f64::consts::TAU * x),
        }
    }
}

/// The curve through knots: `by` at `at`, which rise, linear between them, constant beyond; where it goes
/// round, the first follows the last at a distance of 1.
///
/// # Panics
/// Without knots, or with fewer values than knots.
pub fn through_knots(at: &[f64], by: &[f64], is_round: bool, x: f64) -> f64 {
    let last = at.len() - 1;
    let between = |a: (f64, f64), b: (f64, f64)| {
        if b.0 > a.0 { a.1 + (b.1 - a.1) * (x - a.0) / (b.0 - a.0) } else { b.1 }
    };
    let knot = |k: usize, round: f64| (at[k] + round, by[k]);
    let k = at.partition_point(|at| *at <= x);
    match k {
        0 if is_round => between(knot(last, -1.0), knot(0, 0.0)),
        k if k > last && is_round => between(knot(last, 0.0), knot(0, 1.0)),
        0 => by[0],
        k if k > last => by[last],
        k => between(knot(k - 1, 0.0), knot(k, 0.0)),
    }
}

/// A form with its shape number: a part of a formula.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Term {
    /// Its form.
    pub form: Form,
    /// The shape number; 0 of a form without one.
    pub shape: f64,
}

impl Term {
    /// What terms with these amplitudes, of one term after the other, add up to at `x`; not finite where one
    /// of them has no value.
    pub fn sum(terms: &[Term], amplitudes: &[f64], x: f64) -> f64 {
        let parts = terms
            .iter()
            .flat_map(|Term { form, shape }| (0..form.amplitudes()).map(move |n| form.value(n, *shape, x)));
        parts.zip(amplitudes).map(|(value, size)| size * value).sum()
    }

    /// How many amplitudes terms have together.
    pub fn amplitudes(terms: &[Term]) -> usize {
        terms.iter().map(|term| term.form.amplitudes()).sum()
    }

    /// How many numbers: amplitudes and shapes.
    pub fn numbers(terms: &[Term]) -> usize {
        Term::amplitudes(terms) + terms.iter().map(|term| term.form.shapes()).sum::<usize>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_description_and_a_report_name_a_form_alike() {
        for (form, name) in Form::ALL.into_iter().zip(Form::NAMES) {
            assert_eq!(serde_json::to_value(form).unwrap(), name);
            assert_eq!(Form::named(name), Some(form));
        }
        assert_eq!(Form::named("sinus"), None);
    }
}
