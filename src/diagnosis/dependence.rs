//! A measured response curve over a covariate that no effect of the catalogue has.

use crate::covariates::Covariate;
use crate::formula::Formula;
use crate::record::EffectParameters;
use crate::report::{four_digits, six_digits};
use photocurrent_sensor::effects::from_description;
use photocurrent_sensor::form::through_knots;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

/// The effect of the catalogue that has any curve.
const EFFECT: &str = "dependence";

/// The quantity that a response curve changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AffectedQuantity {
    /// Both thresholds, as a share of them.
    Threshold,
    /// Stamps, seconds later.
    Stamps,
    /// Events that no light makes: ON less OFF, a second and a pixel.
    Rate,
    /// All events, as a share of their rate.
    EventRate,
}

impl AffectedQuantity {
    /// Where it enters, by the names of docs/formats.md.
    pub fn insertion(self) -> &'static str {
        match self {
            AffectedQuantity::Threshold | AffectedQuantity::EventRate => "comparator",
            AffectedQuantity::Stamps => "time",
            AffectedQuantity::Rate => "reset",
        }
    }

    /// Display of its values: factor, unit and decimal places.
    fn written(self) -> (f64, &'static str, usize) {
        match self {
            AffectedQuantity::Threshold | AffectedQuantity::EventRate => (100.0, " %", 1),
            AffectedQuantity::Stamps => (1e6, " us", 0),
            AffectedQuantity::Rate => (1.0, " Hz", 2),
        }
    }

    /// As an equation, for departures `c`.
    pub fn equation(self) -> &'static str {
        match self {
            AffectedQuantity::Threshold => "threshold * (1 + c)",
            AffectedQuantity::Stamps => "stamp + c",
            AffectedQuantity::Rate => "rate of ON less OFF events + c",
            AffectedQuantity::EventRate => "rate of events * (1 + c)",
        }
    }
}

/// A factor curve over a second covariate, which multiplies the first curve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SecondFactor {
    /// What it is over.
    pub covariate: Covariate,
    /// Mean of the covariate in each bin.
    pub at: Vec<f64>,
    /// Factors there, linear between; the largest in size is 1.
    pub by: Vec<f64>,
}

impl SecondFactor {
    /// The factor at a value of the covariate; 0 for a value that is not finite.
    pub(crate) fn value(&self, x: f64) -> f64 {
        if x.is_finite() { through_knots(&self.at, &self.by, false, x) } else { 0.0 }
    }
}

/// A response curve over a covariate, with its evidence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dependence {
    /// The quantity that it changes.
    pub moved: AffectedQuantity,
    /// The covariate that it depends on.
    pub covariate: Covariate,
    /// Of a rhythm, its period, seconds.
    pub period_s: Option<f64>,
    /// Mean of the covariate in each bin.
    pub at: Vec<f64>,
    /// Of a curve that is constant between steps, the first row or column of each bin but the lowest; of
    /// others, linear between `at`, empty.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub steps: Vec<f64>,
    /// By how much in each bin, less the mean of all: a share, seconds, or events a second.
    pub value: Vec<f64>,
    /// A second curve that multiplies it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub times: Option<SecondFactor>,
    /// Half the difference of the estimates from two halves of the pixels; for a rate of events, its standard
    /// error.
    pub error: Vec<f64>,
    /// Share of the residual squares that it removes, on pixels that it was not fitted to; for a rate of
    /// events, the share of the squares of counts.
    pub taken: f64,
    /// The same over its standard error from part to part of the array; of a rate of events, what its test
    /// measured.
    pub significance: f64,
    /// Held-out gain in log-likelihood, nats an event.
    pub nats_per_event: f64,
    /// Was the scene estimated along with it? Otherwise the scene has taken over a part of it.
    #[serde(default)]
    pub is_with_scene: bool,
    /// Formulas that explain it nearly as well as the best one, best first; none where none does.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub formulas: Vec<Formula>,
}

impl Dependence {
    /// A curve with no bins.
    pub fn empty_over(covariate: Covariate, moved: AffectedQuantity) -> Dependence {
        Dependence {
            moved,
            covariate,
            period_s: None,
            at: Vec::new(),
            steps: Vec::new(),
            value: Vec::new(),
            times: None,
            error: Vec::new(),
            taken: 0.0,
            significance: 0.0,
            nats_per_event: 0.0,
            is_with_scene: false,
            formulas: Vec::new(),
        }
    }

    /// As an equation: by the formulas that explain it, and with the measured curve.
    pub fn equation(&self) -> String {
        let name = self.covariate.name();
        let (scale, unit, digits) = self.moved.written();
        let of_formula = |formula: &Formula| {
            let equation = formula.equation((scale, unit), self.covariate, self.period_s);
            let c = if self.times.is_some() { "f" } else { "c" };
            format!(", {c}({name}) = {equation} (probability {:.2})", formula.probability)
        };
        let formulas = self.formulas.iter().map(of_formula).collect::<Vec<_>>().join(" or");
        let points: Vec<String> = (0..self.at.len())
            .map(|k| format!("{:+.digits$}{unit} {}", scale * self.value[k], self.bin_label(k)))
            .collect();
        let rhythm = self
            .period_s
            .map_or_else(String::new, |period_s| format!(" of {} Hz", four_digits(1.0 / period_s)));
        let measured = if formulas.is_empty() { "" } else { "; measured" };
        let c = self.times.as_ref().map_or("", |_| ", c = f * g");
        let of = if self.times.is_some() { "f" } else { "c" };
        let factor = self.times.as_ref().map_or_else(String::new, |SecondFactor { covariate, at, by }| {
            let points: Vec<String> =
                at.iter().zip(by).map(|(at, by)| format!("{by:+.2} at {}", four_digits(*at))).collect();
            format!(", g({}) = {}", covariate.name(), points.join(", "))
        });
        let (equation, points) = (self.moved.equation(), points.join(", "));
        format!("{equation}{c}{formulas}{measured}, {of}({name}){rhythm} = {points}{factor}")
    }

    /// The position of a bin as text.
    fn bin_label(&self, bin: usize) -> String {
        let first = |bin: usize| self.steps.get(bin).map(|step| four_digits(*step));
        match (bin.checked_sub(1).and_then(first), first(bin)) {
            (None, None) => format!("at {}", four_digits(self.at[bin])),
            (None, Some(next)) => format!("below {next}"),
            (Some(from), None) => format!("from {from} on"),
            (Some(from), Some(next)) => format!("from {from} to below {next}"),
        }
    }

    /// The parameters of the effect `dependence` that has this curve, for a recording that starts at
    /// `start_ns`; none where that effect does not express it.
    pub fn parameters(&self, start_ns: i64) -> Option<Map<String, Value>> {
        let start_s = start_ns as f64 * 1e-9;
        let moves = match self.moved {
            AffectedQuantity::Threshold => "threshold",
            AffectedQuantity::Stamps => "delay",
            AffectedQuantity::Rate => "leak",
            AffectedQuantity::EventRate => return None,
        };
        let mut knots = self.knots();
        let mut period = None;
        match self.covariate {
            // From the recording's start there, from its zero here.
            Covariate::Time => knots.iter_mut().for_each(|(at, _)| *at += start_s),
            Covariate::AcPhase => {
                let period_s = self.period_s?;
                knots.iter_mut().for_each(|(at, _)| *at = (*at + start_s / period_s).rem_euclid(1.0));
                knots.sort_by(|a, b| a.0.total_cmp(&b.0));
                period = Some(format!("{} ns", (period_s * 1e9).round()));
            }
            _ => {}
        }
        let by: Vec<Value> = knots
            .iter()
            .map(|(_, value)| match self.moved {
                AffectedQuantity::Stamps => json!(format!("{} ns", (value * 1e9).round())),
                AffectedQuantity::Rate => json!(format!("{} Hz", six_digits(*value))),
                AffectedQuantity::Threshold | AffectedQuantity::EventRate => json!(six_digits(*value)),
            })
            .collect();
        let at: Vec<f64> = knots.iter().map(|(at, _)| six_digits(*at)).collect();
        let given = json!({ "moves": moves, "over": self.covariate.name(), "at": at, "by": by });
        let Value::Object(mut given) = given else { return None };
        given.extend(period.map(|period| ("period".to_owned(), Value::from(period))));
        if let Some(SecondFactor { covariate, at, by }) = &self.times {
            let is_time = *covariate == Covariate::Time;
            let at = at.iter().map(|at| six_digits(if is_time { at + start_s } else { *at }));
            given.insert("times".to_owned(), json!(covariate.name()));
            given.insert("times_at".to_owned(), at.collect());
            given.insert("times_by".to_owned(), by.iter().map(|by| six_digits(*by)).collect());
        }
        let described = [(EFFECT.to_owned(), given.clone())].into();
        from_description(&described).ok().map(|_| given)
    }

    /// Places and values between which the curve is linear: with steps the last row or column before each and
    /// the first one behind it.
    fn knots(&self) -> Vec<(f64, f64)> {
        if self.steps.is_empty() {
            return self.at.iter().copied().zip(self.value.iter().copied()).collect();
        }
        let sides = |(step, of): (&f64, &[f64])| [(step - 1.0, of[0]), (*step, of[1])];
        let mut knots: Vec<(f64, f64)> =
            self.steps.iter().zip(self.value.windows(2)).flat_map(sides).collect();
        // A bin of one row begins and ends there.
        knots.dedup_by(|next, before| next.0 <= before.0);
        knots
    }

    /// Effects of a description with this curve; none where it cannot be expressed, or they have another one.
    pub fn apply_to_effects(&self, effects: &EffectParameters, start_ns: i64) -> Option<EffectParameters> {
        let given = self.parameters(start_ns)?;
        let mut effects = effects.clone();
        effects.insert(EFFECT.to_owned(), given).is_none().then_some(effects)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dependence(moved: AffectedQuantity, covariate: Covariate, period_s: Option<f64>) -> Dependence {
        Dependence {
            period_s,
            at: vec![0.25, 0.75],
            value: vec![-0.1, 0.1],
            error: vec![0.01; 2],
            taken: 0.5,
            significance: 9.0,
            nats_per_event: 0.3,
            is_with_scene: true,
            ..Dependence::empty_over(covariate, moved)
        }
    }

    #[test]
    fn a_curve_becomes_the_effect_that_has_it_on_the_clock_of_the_recording() {
        let of = |moved, covariate, period_s| {
            dependence(moved, covariate, period_s).parameters(3_000_000).map(Value::Object)
        };
        assert_eq!(
            of(AffectedQuantity::Threshold, Covariate::Radius, None).unwrap(),
            json!({ "moves": "threshold", "over": "radius", "at": [0.25, 0.75], "by": [-0.1, 0.1] })
        );
        // 3 ms are three tenths of 10 ms: 0.25 is 0.55, and 0.75 is 0.05, which comes first.
        assert_eq!(
            of(AffectedQuantity::Stamps, Covariate::AcPhase, Some(0.01)).unwrap(),
            json!({
                "moves": "delay", "over": "ac_phase", "at": [0.05, 0.55],
                "by": ["100000000 ns", "-100000000 ns"],
                "period": "10000000 ns"
            })
        );
        assert_eq!(
            of(AffectedQuantity::Threshold, Covariate::Time, None).unwrap()["at"],
            json!([0.253, 0.753])
        );
        assert_eq!(
            of(AffectedQuantity::Rate, Covariate::Row, None).unwrap()["by"],
            json!(["-0.1 Hz", "0.1 Hz"])
        );
        // Every variable that the effect has is one of the covariates by the same name.
        for covariate in [
            Covariate::Row,
            Covariate::RowParity,
            Covariate::Column,
            Covariate::ColumnBlock,
            Covariate::Photocurrent,
            Covariate::PreviousPolarity,
        ] {
            assert!(of(AffectedQuantity::Threshold, covariate, None).is_some(), "{covariate:?}");
        }
        // Steps between rows 3 and 4 and rows 4 and 5.
        let steps = Dependence {
            at: vec![1.5, 4.0, 6.5],
            steps: vec![4.0, 5.0],
            value: vec![0.0, 0.2, 0.1],
            ..dependence(AffectedQuantity::Threshold, Covariate::Row, None)
        };
        let given = steps.parameters(0).unwrap();
        assert_eq!((&given["at"], &given["by"]), (&json!([3.0, 4.0, 5.0]), &json!([0.0, 0.2, 0.1])));
        assert_eq!(
            steps.equation(),
            "threshold * (1 + c), c(row) = +0.0 % below 4, +20.0 % from 4 to below 5, +10.0 % from 5 on"
        );
        // What a pixel does not have at its reset.
        assert_eq!(of(AffectedQuantity::Stamps, Covariate::TimeSinceLastEvent, None), None);
        assert_eq!(of(AffectedQuantity::EventRate, Covariate::RowParity, None), None);
    }
}
