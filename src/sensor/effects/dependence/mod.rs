//! A dependence: what no other effect has a term for, as a curve over one variable, or a product of two.
//!
//! Where a sensor departs from its description in a way that the rest of the catalogue does not list, the
//! departure can still be measured: by how much thresholds, their noise, stamps, a leak, the share of events
//! that is lost or the response of the frame pixel differ over the place on the array, the time, the phase
//! of a rhythm, the light or the events before. This is that curve. It is given at knots, linear between
//! them and constant beyond; over a phase it goes round. Or it is given as a formula: a constant and one or
//! two forms with an amplitude each. A second curve, of another variable, may multiply it.
//!
//! Sources: none, it is a measurement; a diagnosis writes it where it finds a mismatch without a name.
//! Limits: a threshold is taken at the reset, so what changes while a pixel waits for its next event is
//! behind by that wait, but over the time since the last event and the place in a burst, which are those of
//! the instant; stamps do not follow the event before. Slopes, gradients and neighbours' events are no
//! variables here: they are the light's, and a curve over them is nearly what light that is estimated wrongly
//! shows. No curve takes a threshold below a twentieth of its value, as at zero a pixel would fire without
//! end.

mod curve;
mod variable;

use super::effect::Leak;
use super::sought::Search;
use super::{
    Chance, Effect, EffectDecl, EffectKind, History, ParameterDecl, Parameters, PixelEvent, Reading, Site,
    Stage, Thresholds, Unit,
};
use crate::form::Form;
use curve::{Curve, ID, Knots, typical};
use photocurrent_core::random::Random;
use variable::{At, Needs, Variable};

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: ID,
        stage: Stage::Comparator,
        about: "Something differs over a variable, by a curve that was measured",
        equation: "threshold * (1 + c), ON / OFF threshold * (1 + c), threshold + c * normal, stamp + c, \
                   leak + c * threshold, loss with probability c, or frame signal * (1 + c), with \
                   c(variable) linear between knots, or constant + amplitude * form(variable), times a \
                   second curve",
        parameters: &[
            ParameterDecl {
                name: "moves",
                unit: Unit::Choice(&MOVES),
                null: None,
                allowed: (0.0, 0.0),
                plausible: (0.0, 0.0),
                about: "what differs: both thresholds, one of them or their ratio, the noise of each \
                        event's threshold, the stamps, a leak (ON less OFF events a second), a share of \
                        events that is lost, or the frame pixel's signal",
            },
            ParameterDecl {
                name: "over",
                unit: Unit::Choice(&Variable::NAMES),
                null: None,
                allowed: (0.0, 0.0),
                plausible: (0.0, 0.0),
                about: "over what: `radius` is 1 in a corner, `column_block` an eighth of the width, `time` \
                        seconds, `ac_phase` periods from time zero, `photocurrent` its natural logarithm \
                        when the last event left, `previous_polarity` 1 where the event before was of the \
                        same polarity and -1 where of the other, `time_since_last_event` seconds, \
                        `burst_index` the place in a run of events of one polarity with at most 10 ms \
                        between them, from 1; `time` and `ac_phase` of thresholds are those of the reset; a \
                        leak and the frame pixel's signal depend on the place alone, stamps on place, time \
                        and polarity, noise on place, time and light",
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
                        threshold, of events or of a signal and standard deviations (natural logarithm) as \
                        numbers, delays of stamps as texts such as \"50 us\", leaks as texts such as \
                        \"0.2 Hz\"",
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
            ParameterDecl {
                name: "plus",
                unit: Unit::Choice(&Form::NAMES),
                null: None,
                allowed: (0.0, 0.0),
                plausible: (0.0, 0.0),
                about: "a second form that is added; `by` then goes on with its amplitudes",
            },
            ParameterDecl {
                name: "plus_shape",
                unit: Unit::Number("of the variable"),
                null: None,
                allowed: (-1e9, 1e9),
                plausible: (-1e9, 1e9),
                about: "s of that form",
            },
            ParameterDecl {
                name: "times",
                unit: Unit::Choice(&Variable::NAMES),
                null: None,
                allowed: (0.0, 0.0),
                plausible: (0.0, 0.0),
                about: "a second variable, whose curve multiplies that of the first",
            },
            ParameterDecl {
                name: "times_at",
                unit: Unit::List("of the second variable"),
                null: None,
                allowed: (-1e9, 1e9),
                plausible: (-1e9, 1e9),
                about: "its knots, rising; at least one",
            },
            ParameterDecl {
                name: "times_by",
                unit: Unit::List("factors"),
                null: None,
                allowed: (-1e9, 1e9),
                plausible: (-1e9, 1e9),
                about: "its factors at the knots, numbers",
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

const MOVES: [&str; 9] = [
    "threshold",
    "threshold_on",
    "threshold_off",
    "threshold_ratio",
    "noise",
    "delay",
    "leak",
    "loss",
    "frame_signal",
];

/// What differs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Moved {
    /// ON, and OFF.
    Thresholds(bool, bool),
    /// ON over OFF.
    Ratio,
    Noise,
    Delay,
    Leak,
    Loss,
    FrameSignal,
}

impl Moved {
    fn named(name: &str) -> Moved {
        match name {
            "threshold" => Moved::Thresholds(true, true),
            "threshold_on" => Moved::Thresholds(true, false),
            "threshold_off" => Moved::Thresholds(false, true),
            "threshold_ratio" => Moved::Ratio,
            "noise" => Moved::Noise,
            "delay" => Moved::Delay,
            "leak" => Moved::Leak,
            "loss" => Moved::Loss,
            _ => Moved::FrameSignal,
        }
    }

    /// May it differ over a variable that needs this?
    fn takes(self, needs: Needs) -> bool {
        match self {
            Moved::Thresholds(..) | Moved::Ratio | Moved::Loss => true,
            Moved::Noise => matches!(needs, Needs::Place | Needs::Time | Needs::Light),
            Moved::Delay => matches!(needs, Needs::Place | Needs::Time | Needs::Polarity),
            Moved::Leak | Moved::FrameSignal => needs == Needs::Place,
        }
    }

    /// Of the numbers of its curve.
    fn unit(self) -> Unit {
        match self {
            Moved::Delay => Unit::Time,
            Moved::Leak => Unit::Rate,
            Moved::Noise => Unit::Number("ln"),
            _ => Unit::Number("fraction"),
        }
    }
}

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    let (moves, over) = (parameters.need_choice("moves")?, parameters.need_choice("over")?);
    let (moved, times) = (Moved::named(moves), parameters.choice("times"));
    let period_ns = parameters.get("period").map(|seconds| seconds * 1e9);
    if period_ns.is_some() && over != "ac_phase" && times != Some("ac_phase") {
        return Err(format!("`effects.{ID}.period` is the period of `ac_phase`, and this is over `{over}`"));
    }
    let variable = |name: &str| -> Result<Variable, String> {
        let variable = Variable::named(name, period_ns)
            .ok_or_else(|| format!("`effects.{ID}` over `{name}` needs `period`"))?;
        match moved.takes(variable.needs()) {
            true => Ok(variable),
            false => Err(format!(
                "`effects.{ID}`: `{moves}` is not expressed over `{name}`; `photocurrent effects {ID}` lists \
                 what can be combined"
            )),
        }
    };
    let is_round = |variable: Variable| matches!(variable, Variable::Phase(_));
    let first = variable(over)?;
    let curve = Curve::read(parameters, moved.unit(), is_round(first))?;
    let second = match times {
        Some(name) => {
            let second = variable(name)?;
            let by = parameters.need_values("times_by", Unit::Number("fraction"))?;
            Some((second, Knots::read(parameters, ("times_at", "times_by"), by, is_round(second))?))
        }
        None => match ["times_at", "times_by"].into_iter().find(|key| parameters.has_values(key)) {
            Some(key) => return Err(format!("`effects.{ID}.{key}` belongs to `times`, and there is none")),
            None => None,
        },
    };
    Ok(Box::new(Dependence { moved, first: (first, curve), second }))
}

/// Something that differs over a variable, or two.
#[derive(Clone, Debug, PartialEq)]
struct Dependence {
    moved: Moved,
    first: (Variable, Curve),
    second: Option<(Variable, Knots)>,
}

impl Dependence {
    /// The curve where the variables have a value, and nothing elsewhere.
    fn value(&self, at: &At<'_>) -> f64 {
        let (variable, curve) = &self.first;
        let Some(x) = variable.value(at) else { return 0.0 };
        match &self.second {
            None => curve.value(x),
            Some((second, knots)) => second.value(at).map_or(0.0, |y| curve.value(x) * knots.value(y)),
        }
    }

    /// Of a place alone.
    fn of_place(&self, site: &Site) -> f64 {
        self.value(&At { site, t_ns: 0, history: &History::default(), polarity: 1 })
    }

    fn needs(&self, needs: Needs) -> bool {
        self.first.0.needs() == needs
            || self.second.as_ref().is_some_and(|(second, _)| second.needs() == needs)
    }

    /// Thresholds as the curve has them.
    fn change(&self, site: &Site, history: &History, t_ns: i64, thresholds: &mut Thresholds) {
        let of = |polarity: i8| 1.0 + self.value(&At { site, t_ns, history, polarity });
        let factor = |polarity: i8| f64::max(of(polarity), LEAST_FACTOR);
        match self.moved {
            Moved::Thresholds(is_on, is_off) => {
                thresholds.on *= if is_on { factor(1) } else { 1.0 };
                thresholds.off *= if is_off { factor(-1) } else { 1.0 };
            }
            Moved::Ratio => {
                thresholds.on *= libm::sqrt(factor(1));
                thresholds.off /= libm::sqrt(factor(-1));
            }
            _ => {}
        }
    }
}

impl Effect for Dependence {
    fn id(&self) -> &'static str {
        ID
    }

    fn thresholds(
        &self,
        site: &Site,
        history: &History,
        random: &mut Random,
        t_reset_ns: i64,
        thresholds: &mut Thresholds,
    ) {
        if self.moved == Moved::Noise {
            let by = random.normal() * self.value(&At { site, t_ns: t_reset_ns, history, polarity: 1 });
            thresholds.on += by;
            thresholds.off += by;
        } else if !self.waits() {
            self.change(site, history, t_reset_ns, thresholds);
        }
    }

    fn waits(&self) -> bool {
        self.needs(Needs::Wait) && matches!(self.moved, Moved::Thresholds(..) | Moved::Ratio)
    }

    fn waiting(&self, site: &Site, history: &History, t_ns: i64, thresholds: &mut Thresholds) {
        if self.waits() {
            self.change(site, history, t_ns, thresholds);
        }
    }

    fn leak(&self, site: &Site, stated: &Thresholds) -> Leak {
        let rate_hz = if self.moved == Moved::Leak { self.of_place(site) } else { 0.0 };
        Leak { constant_per_s: rate_hz * stated.on, per_photocurrent_per_s: 0.0 }
    }

    fn keeps(&self, site: &Site, history: &History, random: &mut Random, event: &PixelEvent) -> bool {
        self.moved != Moved::Loss || {
            let at = At { site, t_ns: event.t_in_ns, history, polarity: event.polarity };
            random.uniform() >= self.value(&at)
        }
    }

    fn stamp(&self, site: &Site, _random: &mut Random, event: &mut PixelEvent) {
        if self.moved == Moved::Delay {
            let (history, polarity) = (&History::default(), event.polarity);
            let late_s = self.value(&At { site, t_ns: event.t_in_ns, history, polarity });
            let late_ns = (late_s * 1e9).round() as i64;
            event.t_in_ns += late_ns;
            event.t_off_ns += late_ns;
        }
    }

    fn charge(&self, site: &Site, _reading: &Reading, charge: f64) -> f64 {
        match self.moved {
            Moved::FrameSignal => charge * f64::max(1.0 + self.of_place(site), LEAST_FACTOR),
            _ => charge,
        }
    }

    fn chance(&self) -> Option<Chance> {
        match self.moved {
            Moved::Loss => Some(Chance::default()),
            Moved::Noise => {
                let second = self.second.as_ref().map_or(1.0, |(_, knots)| typical(&knots.by));
                Some(Chance { of_events: self.first.1.typical() * second, ..Chance::default() })
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests;
