//! A curve over a variable: knots, linear between them, or a formula.

use super::super::{Parameters, Unit};
use crate::form::{Form, Term, through_knots};

/// Id of the effect.
pub(super) const ID: &str = "dependence";

/// A curve over a variable.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Curve {
    Knots(Knots),
    /// Terms, then the constant and amplitudes.
    Formula(Vec<Term>, Vec<f64>),
}

impl Curve {
    /// In the unit of what differs.
    pub(super) fn value(&self, x: f64) -> f64 {
        match self {
            Curve::Knots(knots) => knots.value(x),
            Curve::Formula(terms, by) => {
                let value = by[0] + Term::sum(terms, &by[1..], x);
                if value.is_finite() { value } else { 0.0 }
            }
        }
    }

    /// About how large it is where nothing is known of the variable: the root mean square at its knots, or
    /// of its constant and amplitudes.
    pub(super) fn typical(&self) -> f64 {
        let (Curve::Knots(Knots { by, .. }) | Curve::Formula(_, by)) = self;
        typical(by)
    }

    /// The curve that `at` and `by`, or `form` and `by` describe, of values in `unit`; over a phase it goes
    /// round.
    pub(super) fn read(parameters: &Parameters, unit: Unit, is_round: bool) -> Result<Curve, String> {
        let by = parameters.need_values("by", unit)?;
        match parameters.choice("form") {
            Some(form) => formula(parameters, form, by),
            None => {
                for key in ["shape", "plus", "plus_shape"] {
                    if parameters.get(key).is_some() || parameters.choice(key).is_some() {
                        return Err(format!("`effects.{ID}.{key}` belongs to a `form`, and there is none"));
                    }
                }
                Ok(Curve::Knots(Knots::read(parameters, ("at", "by"), by, is_round)?))
            }
        }
    }
}

/// Root mean square.
pub(super) fn typical(by: &[f64]) -> f64 {
    libm::sqrt(by.iter().map(|by| by * by).sum::<f64>() / by.len() as f64)
}

/// A curve that is linear between knots.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Knots {
    pub(super) at: Vec<f64>,
    pub(super) by: Vec<f64>,
    /// Does it go round at 1?
    pub(super) is_round: bool,
}

impl Knots {
    pub(super) fn value(&self, x: f64) -> f64 {
        through_knots(&self.at, &self.by, self.is_round, x)
    }

    /// Knots at the list named first with the values `by` of the list named second.
    pub(super) fn read(
        parameters: &Parameters,
        (name_at, name_by): (&str, &str),
        by: Vec<f64>,
        is_round: bool,
    ) -> Result<Knots, String> {
        let at = parameters.need_values(name_at, Unit::Number("number"))?;
        if at.is_empty() || at.len() != by.len() {
            let (knots, values) = (at.len(), by.len());
            return Err(format!(
                "`effects.{ID}`: expected as many values in `{name_by}` as knots in `{name_at}`, and at \
                 least one; found {values} and {knots}"
            ));
        }
        if let Some(pair) = at.windows(2).find(|pair| pair[0] >= pair[1]) {
            return Err(format!(
                "`effects.{ID}.{name_at}`: expected knots that rise, found {} before {}",
                pair[0], pair[1]
            ));
        }
        Ok(Knots { at, by, is_round })
    }
}

/// A formula of constant and amplitudes.
fn formula(parameters: &Parameters, name: &str, by: Vec<f64>) -> Result<Curve, String> {
    if parameters.has_values("at") {
        return Err(format!("`effects.{ID}`: knots (`at`) or a `form`, not both"));
    }
    let term = |name: &str, key: &str| -> Result<Term, String> {
        let form = Form::named(name).ok_or_else(|| format!("`effects.{ID}`: no form is `{name}`"))?;
        match (form.shapes(), parameters.get(key)) {
            (0, Some(_)) => Err(format!("`effects.{ID}.{key}`: `{name}` has no shape number")),
            (1, None) => Err(format!("`effects.{ID}`: `{name}` needs `{key}`")),
            (_, shape) => Ok(Term { form, shape: shape.unwrap_or(0.0) }),
        }
    };
    let mut terms = vec![term(name, "shape")?];
    match (parameters.choice("plus"), parameters.get("plus_shape")) {
        (Some(plus), _) => terms.push(term(plus, "plus_shape")?),
        (None, Some(_)) => {
            return Err(format!("`effects.{ID}.plus_shape` belongs to `plus`, and there is none"));
        }
        (None, None) => {}
    }
    let (expected, found) = (1 + Term::amplitudes(&terms), by.len());
    if found != expected {
        let names =
            parameters.choice("plus").map_or_else(|| name.to_owned(), |plus| format!("{name} + {plus}"));
        return Err(format!(
            "`effects.{ID}.by`: expected {expected} values of `{names}`, the constant first, found {found}"
        ));
    }
    Ok(Curve::Formula(terms, by))
}
