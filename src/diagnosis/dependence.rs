//! A curve over a covariate that no effect of the catalogue has, as it was measured.

use crate::covariates::Covariate;
use crate::formula::Formula;
use crate::record::Described;
use crate::report::{short, six_digits};
use photocurrent_sensor::effects::from_description;
use photocurrent_sensor::form::through_knots;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

/// The effect of the catalogue that has any curve.
const EFFECT: &str = "dependence";

/// What is moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Moved {
    /// Both thresholds, as a share of them.
    Threshold,
    /// Stamps, seconds later.
    Stamps,
    /// Events that no light makes: ON less OFF, a second and a pixel.
    Rate,
    /// All events, as a share of their rate.
    EventRate,
}

impl Moved {
    /// Where it enters, by the names of docs/formats.md.
    pub fn insertion(self) -> &'static str {
        match self {
            Moved::Threshold | Moved::EventRate => "comparator",
            Moved::Stamps => "time",
            Moved::Rate => "reset",
        }
    }

    /// How its numbers are written: times what, in which unit, and with how many digits behind the point.
    fn written(self) -> (f64, &'static str, usize) {
        match self {
            Moved::Threshold | Moved::EventRate => (100.0, " %", 1),
            Moved::Stamps => (1e6, " us", 0),
            Moved::Rate => (1.0, " Hz", 2),
        }
    }

    /// As an equation, for departures `c`.
    pub fn equation(self) -> &'static str {
        match self {
            Moved::Threshold => "threshold * (1 + c)",
            Moved::Stamps => "stamp + c",
            Moved::Rate => "rate of ON less OFF events + c",
            Moved::EventRate => "rate of events * (1 + c)",
        }
    }
}

/// A curve over a second covariate that multiplies the first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Factor {
    /// What it is over.
    pub covariate: Covariate,
    /// Mean of the covariate in each bin.
    pub at: Vec<f64>,
    /// Factors there, linear between; the largest in size is 1.
    pub by: Vec<f64>,
}

impl Factor {
    /// At a value of the covariate; 0 where it has none.
    pub(crate) fn value(&self, x: f64) -> f64 {
        if x.is_finite() { through_knots(&self.at, &self.by, false, x) } else { 0.0 }
    }
}

/// A curve over a covariate, and what it explains.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dependence {
    /// What it moves.
    pub moved: Moved,
    /// What it depends on.
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
    pub times: Option<Factor>,
    /// Half the difference of what two halves of the pixels say; of a rate of events, its standard error.
    pub error: Vec<f64>,
    /// Share of the squares that it removes, on pixels that it was not fitted to; of a rate of events, the
    /// share of those of counts.
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
    /// A curve without a point.
    pub fn over(covariate: Covariate, moved: Moved) -> Dependence {
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
            .map(|k| format!("{:+.digits$}{unit} {}", scale * self.value[k], self.place(k)))
            .collect();
        let rhythm =
            self.period_s.map_or_else(String::new, |period_s| format!(" of {} Hz", short(1.0 / period_s)));
        let measured = if formulas.is_empty() { "" } else { "; measured" };
        let c = self.times.as_ref().map_or("", |_| ", c = f * g");
        let of = if self.times.is_some() { "f" } else { "c" };
        let factor = self.times.as_ref().map_or_else(String::new, |Factor { covariate, at, by }| {
            let points: Vec<String> =
                at.iter().zip(by).map(|(at, by)| format!("{by:+.2} at {}", short(*at))).collect();
            format!(", g({}) = {}", covariate.name(), points.join(", "))
        });
        let (equation, points) = (self.moved.equation(), points.join(", "));
        format!("{equation}{c}{formulas}{measured}, {of}({name}){rhythm} = {points}{factor}")
    }

    /// Where a bin is.
    fn place(&self, bin: usize) -> String {
        let first = |bin: usize| self.steps.get(bin).map(|step| short(*step));
        match (bin.checked_sub(1).and_then(first), first(bin)) {
            (None, None) => format!("at {}", short(self.at[bin])),
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
            Moved::Threshold => "threshold",
            Moved::Stamps => "delay",
            Moved::Rate => "leak",
            Moved::EventRate => return None,
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
                Moved::Stamps => json!(format!("{} ns", (value * 1e9).round())),
                Moved::Rate => json!(format!("{} Hz", six_digits(*value))),
                Moved::Threshold | Moved::EventRate => json!(six_digits(*value)),
            })
            .collect();
        let at: Vec<f64> = knots.iter().map(|(at, _)| six_digits(*at)).collect();
        let given = json!({ "moves": moves, "over": self.covariate.name(), "at": at, "by": by });
        let Value::Object(mut given) = given else { return None };
        given.extend(period.map(|period| ("period".to_owned(), Value::from(period))));
        if let Some(Factor { covariate, at, by }) = &self.times {
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
    pub fn put_in(&self, effects: &Described, start_ns: i64) -> Option<Described> {
        let given = self.parameters(start_ns)?;
        let mut effects = effects.clone();
        effects.insert(EFFECT.to_owned(), given).is_none().then_some(effects)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dependence(moved: Moved, covariate: Covariate, period_s: Option<f64>) -> Dependence {
        Dependence {
            period_s,
            at: vec![0.25, 0.75],
            value: vec![-0.1, 0.1],
            error: vec![0.01; 2],
            taken: 0.5,
            significance: 9.0,
            nats_per_event: 0.3,
            is_with_scene: true,
            ..Dependence::over(covariate, moved)
        }
    }

    #[test]
    fn a_curve_becomes_the_effect_that_has_it_on_the_clock_of_the_recording() {
        let of = |moved, covariate, period_s| {
            dependence(moved, covariate, period_s).parameters(3_000_000).map(Value::Object)
        };
        assert_eq!(
            of(Moved::Threshold, Covariate::Radius, None).unwrap(),
            json!({ "moves": "threshold", "over": "radius", "at": [0.25, 0.75], "by": [-0.1, 0.1] })
        );
        // 3 ms are three tenths of 10 ms: 0.25 is 0.55, and 0.75 is 0.05, which comes first.
        assert_eq!(
            of(Moved::Stamps, Covariate::AcPhase, Some(0.01)).unwrap(),
            json!({
                "moves": "delay", "over": "ac_phase", "at": [0.05, 0.55],
                "by": ["100000000 ns", "-100000000 ns"],
                "period": "10000000 ns"
            })
        );
        assert_eq!(of(Moved::Threshold, Covariate::Time, None).unwrap()["at"], json!([0.253, 0.753]));
        assert_eq!(of(Moved::Rate, Covariate::Row, None).unwrap()["by"], json!(["-0.1 Hz", "0.1 Hz"]));
        // Every variable that the effect has is one of the covariates by the same name.
        for covariate in [
            Covariate::Row,
            Covariate::RowParity,
            Covariate::Column,
            Covariate::ColumnBlock,
            Covariate::Photocurrent,
            Covariate::PreviousPolarity,
        ] {
            assert!(of(Moved::Threshold, covariate, None).is_some(), "{covariate:?}");
        }
        // Steps between rows 3 and 4 and rows 4 and 5.
        let steps = Dependence {
            at: vec![1.5, 4.0, 6.5],
            steps: vec![4.0, 5.0],
            value: vec![0.0, 0.2, 0.1],
            ..dependence(Moved::Threshold, Covariate::Row, None)
        };
        let given = steps.parameters(0).unwrap();
        assert_eq!((&given["at"], &given["by"]), (&json!([3.0, 4.0, 5.0]), &json!([0.0, 0.2, 0.1])));
        assert_eq!(
            steps.equation(),
            "threshold * (1 + c), c(row) = +0.0 % below 4, +20.0 % from 4 to below 5, +10.0 % from 5 on"
        );
        // What a pixel does not have at its reset.
        assert_eq!(of(Moved::Stamps, Covariate::TimeSinceLastEvent, None), None);
        assert_eq!(of(Moved::EventRate, Covariate::RowParity, None), None);
    }
}
