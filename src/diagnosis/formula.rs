//! Parametric formulas for a measured response curve.

use crate::covariates::Covariate;
use crate::report::four_digits;
use photocurrent_sensor::form::{Form, Term};
use serde::{Deserialize, Serialize};

/// Does a form apply where the variable takes values from `low` to `high`?
pub(crate) fn applies(form: Form, covariate: Covariate, low: f64, high: f64) -> bool {
    let is_phase = covariate == Covariate::AcPhase;
    match form {
        Form::Sine => is_phase,
        _ if is_phase => false,
        Form::Logarithm => low > 0.0 && high > 2.0 * low,
        Form::Power => low >= 0.0,
        Form::Saturation => low >= 0.0 && high > 0.0,
        Form::Linear | Form::Relaxation | Form::Step => true,
    }
}

/// Shape numbers of a form to be tried where the variable takes values from `low` to `high`.
pub(crate) fn shape_values(form: Form, low: f64, high: f64) -> Vec<f64> {
    let range = high - low;
    let steps = |from: f64, to: f64| -> Vec<f64> {
        let at = |k: usize| from * libm::pow(to / from, k as f64 / (TRIED - 1) as f64);
        (0..TRIED).map(at).collect()
    };
    match form {
        Form::Linear | Form::Logarithm | Form::Sine => vec![0.0],
        Form::Power => vec![-2.0, -1.0, -0.5, 0.5, 1.5, 2.0, 3.0]
            .into_iter()
            .filter(|power| *power > 0.0 || low > 0.0)
            .collect(),
        Form::Relaxation => steps(range / 20.0, range),
        Form::Saturation => steps(high / 20.0, high),
        Form::Step => (1..TRIED).map(|k| low + range * k as f64 / TRIED as f64).collect(),
    }
}

/// Shape numbers of a form that are tried.
const TRIED: usize = 16;

/// A formula with its numbers: c(x) = constant + amplitude * form(x), and where it is a sum of two another
/// amplitude times another form.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Formula {
    /// Its form.
    pub form: Form,
    /// The shape number; 0 of a form without one.
    pub shape: f64,
    /// A second form that is added, whose amplitudes follow those of the first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plus: Option<Term>,
    /// In the unit of the changed quantity: a share, seconds or events per second. The mean of c over all
    /// events is 0.
    pub constant: f64,
    /// The same.
    pub amplitudes: Vec<f64>,
    /// Half the difference of the estimates from two halves of the pixels, for each amplitude.
    pub errors: Vec<f64>,
    /// Held-out gain in log-likelihood over no dependence, nats an event.
    pub gain: f64,
    /// Of the formulas that are reported, by their criterion.
    pub probability: f64,
}

impl Formula {
    /// As an equation in the variable's name; `scale` and `unit`: of the numbers as they are written.
    pub fn equation(
        &self,
        (scale, unit): (f64, &str),
        covariate: Covariate,
        period_s: Option<f64>,
    ) -> String {
        let number = |value: f64| format!("{}{unit}", four_digits(scale * value));
        let x = covariate.name();
        if let (Form::Sine, [sine, cosine]) = (self.form, &self.amplitudes[..]) {
            let (size, phase) = (libm::hypot(*sine, *cosine), libm::atan2(*cosine, *sine));
            let error = libm::hypot(self.errors[0], self.errors[1]);
            let of = period_s
                .map_or_else(|| x.to_owned(), |period_s| format!("{} Hz t", four_digits(1.0 / period_s)));
            let phase = format!("{} {}", if phase < 0.0 { "-" } else { "+" }, four_digits(phase.abs()));
            return format!("{} (+- {}) * sin(2 pi {of} {phase})", number(size), number(error));
        }
        let terms = std::iter::once(Term { form: self.form, shape: self.shape }).chain(self.plus);
        let written = |(term, (size, error)): (Term, (&f64, &f64))| {
            let sign = if *size < 0.0 { "-" } else { "+" };
            format!(" {sign} {} (+- {}) * {}", number(size.abs()), number(*error), format_term(&term, x))
        };
        let sum: String = terms.zip(self.amplitudes.iter().zip(&self.errors)).map(written).collect();
        format!("{}{sum}", number(self.constant))
    }
}

/// A term with one amplitude, of the variable `x`.
fn format_term(term: &Term, x: &str) -> String {
    let shape = four_digits(term.shape);
    match term.form {
        Form::Linear => x.to_owned(),
        Form::Logarithm => format!("ln({x})"),
        Form::Power => format!("{x}^{shape}"),
        Form::Relaxation => format!("exp(-{x} / {shape})"),
        Form::Saturation => format!("{x} / ({x} + {shape})"),
        Form::Step | Form::Sine => format!("({x} >= {shape})"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHARE: (f64, &str) = (100.0, " %");

    #[test]
    fn a_formula_is_written_with_numbers_and_units() {
        let formula = |form, shape, amplitudes: &[f64]| Formula {
            form,
            shape,
            plus: None,
            constant: -0.02,
            errors: vec![0.001; amplitudes.len()],
            amplitudes: amplitudes.to_vec(),
            gain: 0.3,
            probability: 0.9,
        };
        assert_eq!(
            formula(Form::Linear, 0.0, &[0.1]).equation(SHARE, Covariate::Time, None),
            "-2 % + 10 % (+- 0.1 %) * time"
        );
        assert_eq!(
            formula(Form::Power, 2.0, &[-0.1]).equation(SHARE, Covariate::Radius, None),
            "-2 % - 10 % (+- 0.1 %) * radius^2"
        );
        let plus = Some(Term { form: Form::Step, shape: 0.1 });
        let sum = Formula { plus, ..formula(Form::Linear, 0.0, &[0.1, -0.05]) };
        assert_eq!(
            sum.equation(SHARE, Covariate::Time, None),
            "-2 % + 10 % (+- 0.1 %) * time - 5 % (+- 0.1 %) * (time >= 0.1)"
        );
        // 0.03 sin(a) + 0.04 cos(a) = 0.05 sin(a + atan(4/3)).
        let sine = formula(Form::Sine, 0.0, &[0.03, 0.04]);
        assert_eq!(
            sine.equation(SHARE, Covariate::AcPhase, Some(0.005)),
            format!(
                "5 % (+- {} %) * sin(2 pi 200 Hz t + {})",
                four_digits(0.1 * 2.0_f64.sqrt()),
                four_digits(0.9272952)
            )
        );
    }
}
