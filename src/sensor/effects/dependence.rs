//! A dependence: what no other effect has a term for, as a curve over one variable.
//!
//! Where a sensor departs from its description in a way that the rest of the catalogue does not list, the
//! departure can still be measured: by how much thresholds, stamps, a leak or the response of the frame
//! pixel differ over the place on the array, the time, the phase of a rhythm, the light or the event
//! before. This is that curve. It is given at knots, linear between them and constant beyond; over a phase
//! it goes round. Or it is given as a formula: a constant and a form with an amplitude.
//!
//! Sources: none, it is a measurement; a diagnosis writes it where it finds a mismatch without a name.
//! Limits: one curve over one variable; a threshold is taken at the reset, so what changes while a pixel
//! waits for its next event is behind by that wait, and a dependence on the time since the last event is
//! not expressed. No curve takes a threshold below a twentieth of its value, as at zero a pixel would fire
//! without end.

use super::effect::Leak;
use super::sought::Search;
use super::{
    Chance, Effect, EffectDecl, EffectKind, History, ParameterDecl, Parameters, PixelEvent, Reading, Site,
    Stage, Thresholds, Unit,
};
use crate::form::Form;
use photocurrent_core::random::Random;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "dependence",
        stage: Stage::Comparator,
        about: "Something differs over one variable, by a curve that was measured",
        equation: "threshold * (1 + c), stamp + c, leak + c * threshold, loss with probability c, or frame \
                   signal * (1 + c), with c(variable) linear between knots, or constant + amplitude * \
                   form(variable)",
        parameters: &[
            ParameterDecl {
                name: "moves",
                unit: Unit::Choice(&MOVES),
                null: None,
                allowed: (0.0, 0.0),
                plausible: (0.0, 0.0),
                about: "what differs: both thresholds or one of them, the stamps, a leak (ON less OFF events \
                        a second), a share of events that is lost, or the frame pixel's signal",
            },
            ParameterDecl {
                name: "over",
                unit: Unit::Choice(&OVER),
                null: None,
                allowed: (0.0, 0.0),
                plausible: (0.0, 0.0),
                about: "over what: `radius` is 1 in a corner, `column_block` an eighth of the width, `time` \
                        seconds, `ac_phase` periods from time zero, `photocurrent` its natural logarithm \
                        when the last event left, `previous_polarity` 1 where the event before was of the \
                        same polarity and -1 where of the other; `time` and `ac_phase` of thresholds are \
                        those of the reset; a leak and the frame pixel's signal depend on the place alone",
            },
            ParameterDecl {
                name: "at",
                unit: Unit::List("of the variable"),
                null: None,
                allowed: (-1e9, 1e9),
                plausible: (-1e9, 1e9),
                about: "the knots, rising; at least one; not with `form`",
            },
            ParameterDecl {
                name: "by",
                unit: Unit::List("of what differs"),
                null: None,
                allowed: (-1e9, 1e9),
                plausible: (-1e9, 1e9),
                about: "the curve at the knots, or constant and amplitude of `form`: shares of a \
                        threshold, of events or of a signal as numbers, delays of stamps as texts such as \
                        \"50 us\", leaks as texts such as \"0.2 Hz\"",
            },
            ParameterDecl {
                name: "period",
                unit: Unit::Time,
                null: None,
                allowed: (1e-6, 1e3),
                plausible: (1e-4, 0.1),
                about: "the period of `ac_phase`; of nothing else",
            },
            ParameterDecl {
                name: "form",
                unit: Unit::Choice(&Form::NAMES),
                null: None,
                allowed: (0.0, 0.0),
                plausible: (0.0, 0.0),
                about: "a formula in the place of knots: `by` is then a constant and what is multiplied by \
                        x (`linear`), ln x (`logarithm`), x^s (`power`), exp(-x / s) (`relaxation`), \
                        x / (x + s) (`saturation`), 0 below s and 1 from there (`step`), or sin and cos of \
                        2 pi x (`sine`, two amplitudes), with x the variable; where that has no value, \
                        nothing differs",
            },
            ParameterDecl {
                name: "shape",
                unit: Unit::Number("of the variable"),
                null: None,
                allowed: (-1e9, 1e9),
                plausible: (-1e9, 1e9),
                about: "s of the forms that have one: a power, or a value of the variable",
            },
        ],
        covariate: "the variable",
        signature: "events or frames miss by an amount that is a function of the variable",
        confused_with: &["every effect whose size varies over the same variable"],
        source: "none: a measured curve",
        apart: &[],
        search: Search::Not("what no effect explains is measured as this curve"),
    },
    build,
};

/// No curve takes a threshold below this part of its value.
const LEAST_FACTOR: f64 = 0.05;

const MOVES: [&str; 7] =
    ["threshold", "threshold_on", "threshold_off", "delay", "leak", "loss", "frame_signal"];
const OVER: [&str; 10] = [
    "row",
    "row_parity",
    "column",
    "column_block",
    "radius",
    "time",
    "ac_phase",
    "photocurrent",
    "polarity",
    "previous_polarity",
];

/// What differs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Moved {
    /// ON, and OFF.
    Thresholds(bool, bool),
    Delay,
    Leak,
    Loss,
    FrameSignal,
}

/// Over what.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Variable {
    Row,
    RowParity,
    Column,
    ColumnBlock,
    Radius,
    Time,
    /// Of this period, nanoseconds.
    Phase(f64),
    Photocurrent,
    Polarity,
    PreviousPolarity,
}

impl Variable {
    /// Of the place alone; none where it is something else.
    fn of_place(self, site: &Site) -> Option<f64> {
        Some(match self {
            Variable::Row => f64::from(site.y),
            Variable::RowParity => f64::from(site.y % 2),
            Variable::Column => f64::from(site.x),
            Variable::ColumnBlock => f64::from(site.column_block()),
            Variable::Radius => site.radius(),
            _ => return None,
        })
    }

    /// Of place and instant.
    fn of_instant(self, site: &Site, t_ns: i64) -> Option<f64> {
        match self {
            Variable::Time => Some(t_ns as f64 * 1e-9),
            Variable::Phase(period_ns) => {
                let periods = t_ns as f64 / period_ns;
                Some(periods - periods.floor())
            }
            _ => self.of_place(site),
        }
    }
}

/// A curve over a variable.
#[derive(Clone, Debug, PartialEq)]
enum Curve {
    Knots(Knots),
    /// Shape number, constant and amplitudes of a form.
    Formula(Form, f64, Vec<f64>),
}

impl Curve {
    /// In the unit of what differs.
    fn value(&self, x: f64) -> f64 {
        match self {
            Curve::Knots(knots) => knots.value(x),
            Curve::Formula(form, shape, by) => {
                let parts = by[1..].iter().enumerate().map(|(n, size)| size * form.value(n, *shape, x));
                let value = by[0] + parts.sum::<f64>();
                if value.is_finite() { value } else { 0.0 }
            }
        }
    }
}

/// A curve that is linear between knots.
#[derive(Clone, Debug, PartialEq)]
struct Knots {
    at: Vec<f64>,
    by: Vec<f64>,
    /// Does it go round at 1?
    is_round: bool,
}

impl Knots {
    fn value(&self, x: f64) -> f64 {
        let last = self.at.len() - 1;
        let between = |a: (f64, f64), b: (f64, f64)| {
            if b.0 > a.0 { a.1 + (b.1 - a.1) * (x - a.0) / (b.0 - a.0) } else { b.1 }
        };
        let knot = |k: usize, round: f64| (self.at[k] + round, self.by[k]);
        let k = self.at.partition_point(|at| *at <= x);
        match k {
            0 if self.is_round => between(knot(last, -1.0), knot(0, 0.0)),
            k if k > last && self.is_round => between(knot(last, 0.0), knot(0, 1.0)),
            0 => self.by[0],
            k if k > last => self.by[last],
            k => between(knot(k - 1, 0.0), knot(k, 0.0)),
        }
    }
}

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    let id = KIND.decl.id;
    let moved = match parameters.need_choice("moves")? {
        "threshold" => Moved::Thresholds(true, true),
        "threshold_on" => Moved::Thresholds(true, false),
        "threshold_off" => Moved::Thresholds(false, true),
        "delay" => Moved::Delay,
        "leak" => Moved::Leak,
        "loss" => Moved::Loss,
        _ => Moved::FrameSignal,
    };
    let over = parameters.need_choice("over")?;
    let period_ns = parameters.get("period").map(|seconds| seconds * 1e9);
    let variable = match (over, period_ns) {
        ("ac_phase", Some(period_ns)) => Variable::Phase(period_ns),
        ("ac_phase", None) => return Err(format!("`effects.{id}` over `ac_phase` needs `period`")),
        (_, Some(_)) => {
            return Err(format!(
                "`effects.{id}.period` is the period of `ac_phase`, and this is over `{over}`"
            ));
        }
        ("row", None) => Variable::Row,
        ("row_parity", None) => Variable::RowParity,
        ("column", None) => Variable::Column,
        ("column_block", None) => Variable::ColumnBlock,
        ("radius", None) => Variable::Radius,
        ("time", None) => Variable::Time,
        ("photocurrent", None) => Variable::Photocurrent,
        ("polarity", None) => Variable::Polarity,
        (_, None) => Variable::PreviousPolarity,
    };
    let is_of_place = !matches!(
        variable,
        Variable::Time
            | Variable::Phase(_)
            | Variable::Photocurrent
            | Variable::Polarity
            | Variable::PreviousPolarity
    );
    let can_be = match moved {
        Moved::Thresholds(..) => variable != Variable::Polarity,
        Moved::Delay | Moved::Loss => {
            !matches!(variable, Variable::Photocurrent | Variable::PreviousPolarity)
        }
        Moved::Leak | Moved::FrameSignal => is_of_place,
    };
    if !can_be {
        let why = if variable == Variable::Polarity {
            "take `moves = \"threshold_on\"` or `\"threshold_off\"` over `row` with one knot, or \
             `effects.threshold_asymmetry`"
        } else {
            "`photocurrent effects dependence` lists what can be combined"
        };
        let moves = parameters.need_choice("moves")?;
        return Err(format!("`effects.{id}`: `{moves}` is not expressed over `{over}`; {why}"));
    }
    let unit = match moved {
        Moved::Delay => Unit::Time,
        Moved::Leak => Unit::Rate,
        _ => Unit::Number("fraction"),
    };
    let by = parameters.need_values("by", unit)?;
    let curve = match parameters.choice("form") {
        Some(form) => formula(parameters, form, by)?,
        None => knots(parameters, by, matches!(variable, Variable::Phase(_)))?,
    };
    Ok(Box::new(Dependence { moved, variable, curve }))
}

/// A formula of constant and amplitudes.
fn formula(parameters: &Parameters, name: &str, by: Vec<f64>) -> Result<Curve, String> {
    let id = KIND.decl.id;
    let form = Form::named(name).ok_or_else(|| format!("`effects.{id}.form`: no form is `{name}`"))?;
    if parameters.has_values("at") {
        return Err(format!("`effects.{id}`: knots (`at`) or a `form`, not both"));
    }
    let expected = 1 + form.amplitudes();
    if by.len() != expected {
        let found = by.len();
        return Err(format!(
            "`effects.{id}.by`: expected {expected} values of `{name}`, the constant first, found {found}"
        ));
    }
    match (form.shapes(), parameters.get("shape")) {
        (0, Some(_)) => Err(format!("`effects.{id}.shape`: `{name}` has no shape number")),
        (1, None) => Err(format!("`effects.{id}`: `{name}` needs `shape`")),
        (_, shape) => Ok(Curve::Formula(form, shape.unwrap_or(0.0), by)),
    }
}

/// A curve at knots.
fn knots(parameters: &Parameters, by: Vec<f64>, is_round: bool) -> Result<Curve, String> {
    let id = KIND.decl.id;
    if parameters.get("shape").is_some() {
        return Err(format!("`effects.{id}.shape` is a number of a `form`, and there is none"));
    }
    let at = parameters.need_values("at", Unit::Number("number"))?;
    if at.is_empty() || at.len() != by.len() {
        let (knots, values) = (at.len(), by.len());
        return Err(format!(
            "`effects.{id}`: expected as many values in `by` as knots in `at`, and at least one; found \
             {values} and {knots}"
        ));
    }
    if let Some(pair) = at.windows(2).find(|pair| pair[0] >= pair[1]) {
        return Err(format!(
            "`effects.{id}.at`: expected knots that rise, found {} before {}",
            pair[0], pair[1]
        ));
    }
    Ok(Curve::Knots(Knots { at, by, is_round }))
}

/// Something that differs over one variable.
#[derive(Clone, Debug, PartialEq)]
struct Dependence {
    moved: Moved,
    variable: Variable,
    curve: Curve,
}

impl Effect for Dependence {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn thresholds(
        &self,
        site: &Site,
        history: &History,
        _random: &mut Random,
        t_reset_ns: i64,
        thresholds: &mut Thresholds,
    ) {
        let Moved::Thresholds(is_on, is_off) = self.moved else { return };
        let factor = |x: f64| f64::max(1.0 + self.curve.value(x), LEAST_FACTOR);
        let [on, off] = match self.variable {
            Variable::PreviousPolarity => match history.last_event.map(|event| event.polarity > 0) {
                Some(true) => [factor(1.0), factor(-1.0)],
                Some(false) => [factor(-1.0), factor(1.0)],
                None => [1.0; 2],
            },
            Variable::Photocurrent => [factor(libm::log(f64::max(history.light, f64::MIN_POSITIVE))); 2],
            variable => [variable.of_instant(site, t_reset_ns).map_or(1.0, factor); 2],
        };
        if is_on {
            thresholds.on *= on;
        }
        if is_off {
            thresholds.off *= off;
        }
    }

    fn leak(&self, site: &Site, stated: &Thresholds) -> Leak {
        let rate_hz = match self.moved {
            Moved::Leak => self.variable.of_place(site).map_or(0.0, |x| self.curve.value(x)),
            _ => 0.0,
        };
        Leak { constant_per_s: rate_hz * stated.on, per_photocurrent_per_s: 0.0 }
    }

    fn keeps(&self, site: &Site, random: &mut Random, event: &PixelEvent) -> bool {
        self.moved != Moved::Loss || random.uniform() >= self.of_event(site, event)
    }

    fn stamp(&self, site: &Site, _random: &mut Random, event: &mut PixelEvent) {
        if self.moved == Moved::Delay {
            let late_ns = (self.of_event(site, event) * 1e9).round() as i64;
            event.t_in_ns += late_ns;
            event.t_off_ns += late_ns;
        }
    }

    fn charge(&self, site: &Site, _reading: &Reading, charge: f64) -> f64 {
        match (self.moved, self.variable.of_place(site)) {
            (Moved::FrameSignal, Some(x)) => charge * f64::max(1.0 + self.curve.value(x), LEAST_FACTOR),
            _ => charge,
        }
    }

    fn chance(&self) -> Option<Chance> {
        (self.moved == Moved::Loss).then(Chance::default)
    }
}

impl Dependence {
    fn of_event(&self, site: &Site, event: &PixelEvent) -> f64 {
        let x = match self.variable {
            Variable::Polarity => Some(f64::from(event.polarity)),
            variable => variable.of_instant(site, event.t_in_ns),
        };
        x.map_or(0.0, |x| self.curve.value(x))
    }
}

#[cfg(test)]
mod tests {
    use super::super::catalogue;
    use super::super::simulated::{MS, SITE, Samples, ideal_pixel, intervals_s, recorded, recorded_at};
    use super::super::testing::{described, site};
    use super::*;
    use serde_json::{Value, json};

    fn refused(given: Value) -> String {
        let kind = catalogue().into_iter().find(|kind| kind.decl.id == "dependence").unwrap();
        kind.read(given.as_object().unwrap()).err().expect("refused")
    }

    #[test]
    fn a_curve_is_linear_between_knots_constant_beyond_and_goes_round_over_a_phase() {
        let curve = |is_round| Knots { at: vec![0.2, 0.6], by: vec![1.0, 3.0], is_round };
        for (x, plain, round) in
            [(0.0, 1.0, 2.0), (0.2, 1.0, 1.0), (0.3, 1.5, 1.5), (0.6, 3.0, 3.0), (0.9, 3.0, 2.0)]
        {
            // Round: from 3 at 0.6 to 1 at 1.2, so 2 at 0.9 and 5/3 at 1.0.
            let round = if x == 0.0 { 5.0 / 3.0 } else { round };
            assert!((curve(false).value(x) - plain).abs() < 1e-12, "{x}");
            assert!((curve(true).value(x) - round).abs() < 1e-12, "{x}: {}", curve(true).value(x));
        }
        let one = Knots { at: vec![0.5], by: vec![0.1], is_round: true };
        assert!([0.0, 0.5, 0.9].iter().all(|x| (one.value(*x) - 0.1).abs() < 1e-12));
    }

    #[test]
    fn thresholds_of_odd_rows_differ_and_the_pace_on_a_ramp_with_them() {
        let ramp = Samples::of_log(200 * MS, |t| -1.0 + 20.0 * t);
        let given = json!({ "moves": "threshold_on", "over": "row_parity", "at": [0, 1], "by": [0.0, 0.3] });
        for (y, step) in [(4, 0.2), (5, 0.26)] {
            let effects = vec![described("dependence", given.clone())];
            let events = recorded_at(&site(3, y), ideal_pixel(), effects, &ramp, 200 * MS);
            assert!(intervals_s(&events).iter().all(|interval| (interval - step / 20.0).abs() < 1e-6), "{y}");
        }
        let down = Samples::of_log(200 * MS, |t| 3.0 - 20.0 * t);
        let events = recorded(ideal_pixel(), vec![described("dependence", given)], &down, 200 * MS);
        assert!(intervals_s(&events).iter().all(|interval| (interval - 0.01).abs() < 1e-6));
    }

    #[test]
    fn a_threshold_that_follows_light_is_that_of_the_light_when_the_last_event_left() {
        // log i grows from 0; thresholds 0.2 x (1 + 0.1 log i) step from event to event.
        let ramp = Samples::of_log(300 * MS, |t| 10.0 * t);
        let given = json!({ "moves": "threshold", "over": "photocurrent", "at": [0, 10], "by": [0.0, 1.0] });
        let events = recorded(ideal_pixel(), vec![described("dependence", given)], &ramp, 300 * MS);
        let mut log_light = 0.0;
        assert!(events.len() > 8);
        for event in &events {
            log_light += 0.2 * (1.0 + 0.1 * log_light);
            assert!((10.0 * event.t_in_ns as f64 * 1e-9 - log_light).abs() < 2e-5, "{log_light}");
        }
    }

    #[test]
    fn the_same_polarity_again_needs_another_threshold() {
        // Up by 1.0 and down again: the first OFF event follows an ON.
        let light = Samples::of_log(100 * MS, |t| if t < 0.05 { 20.0 * t } else { 2.0 - 20.0 * t });
        let given =
            json!({ "moves": "threshold", "over": "previous_polarity", "at": [-1, 1], "by": [0.5, 0.0] });
        let events = recorded(ideal_pixel(), vec![described("dependence", given)], &light, 100 * MS);
        let turn = events.iter().position(|event| event.polarity < 0).unwrap();
        let level = |t_ns: i64| {
            let t = t_ns as f64 * 1e-9;
            if t < 0.05 { 20.0 * t } else { 2.0 - 20.0 * t }
        };
        let steps: Vec<f64> =
            events.windows(2).map(|pair| level(pair[1].t_in_ns) - level(pair[0].t_in_ns)).collect();
        assert!((steps[turn - 1] + 0.3).abs() < 1e-4, "{}", steps[turn - 1]);
        assert!((steps[turn - 2] - 0.2).abs() < 1e-4 && (steps[turn] + 0.2).abs() < 1e-4);
    }

    #[test]
    fn a_formula_is_the_curve_of_many_knots() {
        let sine = |x: f64| {
            0.05 + 0.1 * libm::sin(core::f64::consts::TAU * x) - 0.2 * libm::cos(core::f64::consts::TAU * x)
        };
        let square = |x: f64| -0.02 + 0.3 * x * x;
        let many: Vec<f64> = (0..1000).map(|k| f64::from(k) / 1000.0).collect();
        for (over, formula, of) in [
            ("ac_phase", json!({ "form": "sine", "by": [0.05, 0.1, -0.2] }), &sine as &dyn Fn(f64) -> f64),
            ("radius", json!({ "form": "power", "shape": 2.0, "by": [-0.02, 0.3] }), &square),
        ] {
            let effect = |more: Value| {
                let mut given = json!({ "moves": "threshold", "over": over });
                more.as_object().unwrap().iter().for_each(|(key, value)| given[key] = value.clone());
                if over == "ac_phase" {
                    given["period"] = json!("10 ms");
                }
                described("dependence", given)
            };
            let by: Vec<f64> = many.iter().map(|x| of(*x)).collect();
            let [formula, curve] = [formula, json!({ "at": many, "by": by })].map(effect);
            for t_reset_ns in [0, 1_234_567, 27_100_000] {
                let threshold = |effect: &dyn Effect| {
                    let mut thresholds = Thresholds { on: 0.2, off: 0.2 };
                    let history = History::default();
                    effect.thresholds(&SITE, &history, &mut Random::new(1, &[]), t_reset_ns, &mut thresholds);
                    thresholds.on
                };
                assert!((threshold(&*formula) - threshold(&*curve)).abs() < 1e-6, "{over} {t_reset_ns}");
            }
        }
        // What has no value differs in nothing.
        let light = json!({ "moves": "threshold", "over": "row", "form": "logarithm", "by": [0.0, 0.1] });
        let mut thresholds = Thresholds { on: 0.2, off: 0.2 };
        let at = (&site(3, 0), &History::default());
        described("dependence", light).thresholds(at.0, at.1, &mut Random::new(1, &[]), 0, &mut thresholds);
        assert_eq!(thresholds.on, 0.2);
    }

    #[test]
    fn stamps_are_late_by_the_curve_and_both_of_an_event_alike() {
        let given = json!({
            "moves": "delay", "over": "ac_phase", "period": "10 ms",
            "at": [0.25, 0.75], "by": ["0 us", "80 us"]
        });
        let effect = described("dependence", given);
        for (t_ns, late_ns) in
            [(2_500_000, 0), (5_000_000, 40_000), (17_500_000, 80_000), (20_000_000, 40_000)]
        {
            let mut event = PixelEvent { t_in_ns: t_ns, t_off_ns: t_ns + 5_000, polarity: 1 };
            effect.stamp(&SITE, &mut Random::new(1, &[]), &mut event);
            assert_eq!((event.t_in_ns - t_ns, event.t_off_ns - event.t_in_ns), (late_ns, 5_000));
        }
    }

    #[test]
    fn a_leak_and_a_frame_signal_follow_the_place() {
        let leak = json!({ "moves": "leak", "over": "column", "at": [0, 15], "by": ["0 Hz", "30 Hz"] });
        let stated = Thresholds { on: 0.2, off: 0.25 };
        // Column 3 of 16: 6 Hz of ON thresholds.
        let found = described("dependence", leak).leak(&SITE, &stated);
        assert!((found.constant_per_s - 6.0 * 0.2).abs() < 1e-12);
        let signal = json!({ "moves": "frame_signal", "over": "radius", "at": [0, 1], "by": [0.0, -0.4] });
        let reading = Reading {
            frame: 0,
            previous_charge: 0.0,
            gain: 1.0,
            black_level: 0.0,
            saturation: f64::INFINITY,
        };
        let charge = described("dependence", signal).charge(&SITE, &reading, 10.0);
        assert!((charge - 10.0 * (1.0 - 0.4 * SITE.radius())).abs() < 1e-12);
    }

    #[test]
    fn events_are_lost_by_the_stated_share_and_only_there() {
        let given = json!({ "moves": "loss", "over": "polarity", "at": [-1, 1], "by": [0.3, 0.0] });
        let effect = described("dependence", given);
        let mut random = Random::new(5, &[]);
        let mut lost = [0; 2];
        for t in 0..20_000 {
            let polarity = if t % 2 == 0 { 1 } else { -1 };
            let event = PixelEvent { t_in_ns: t, t_off_ns: t, polarity };
            lost[usize::from(polarity < 0)] += usize::from(!effect.keeps(&SITE, &mut random, &event));
        }
        // Five standard deviations of 10,000 draws at 0.3.
        assert!(lost[0] == 0 && (f64::from(lost[1] as u32) - 3000.0).abs() < 230.0, "{lost:?}");
    }

    #[test]
    fn mistakes_state_what_was_found_and_expected() {
        let with = |changes: Value| {
            let mut given = json!({ "moves": "threshold", "over": "row", "at": [0, 9], "by": [0.0, 0.1] });
            changes.as_object().unwrap().iter().for_each(|(key, value)| given[key] = value.clone());
            refused(given)
        };
        for (changes, expected) in [
            (json!({ "over": "radios" }), "did you mean \"radius\"?"),
            (json!({ "at": [0, 9, 5] }), "as many values in `by` as knots in `at`"),
            (json!({ "at": [9, 0] }), "expected knots that rise, found 9 before 0"),
            (json!({ "at": 3 }), "expected a list such as [0.0, 0.1], found 3"),
            (json!({ "over": "ac_phase" }), "over `ac_phase` needs `period`"),
            (json!({ "period": "1 ms" }), "is the period of `ac_phase`"),
            (
                json!({ "moves": "leak", "over": "time", "by": ["0 Hz", "1 Hz"] }),
                "`leak` is not expressed over `time`",
            ),
            (json!({ "moves": "delay" }), "`effects.dependence.by`: expected a time such as"),
            (json!({ "by": ["1 us", "2 us"] }), "expected a number (fraction), found \"1 us\""),
            (json!({ "form": "linear" }), "knots (`at`) or a `form`, not both"),
            (json!({ "shape": 2.0 }), "is a number of a `form`, and there is none"),
        ] {
            let found = with(changes);
            assert!(found.contains(expected), "{found}");
        }
        assert_eq!(refused(json!({ "over": "row" })), "`effects.dependence` needs `moves`");
        let formula = |form: &str, shape: Option<f64>, by: &[f64]| {
            let mut given = json!({ "moves": "threshold", "over": "radius", "form": form, "by": by });
            shape.iter().for_each(|shape| given["shape"] = json!(shape));
            refused(given)
        };
        assert!(formula("power", None, &[0.0, 0.3]).contains("`power` needs `shape`"));
        assert!(formula("linear", Some(2.0), &[0.0, 0.3]).contains("`linear` has no shape number"));
        assert!(
            formula("sine", None, &[0.0, 0.3]).contains("expected 3 values of `sine`, the constant first")
        );
        assert!(formula("sinus", None, &[0.0]).contains("did you mean \"sine\"?"));
    }
}
