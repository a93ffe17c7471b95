//! What something may differ over.

use super::super::{History, Site};
use crate::effects::BURST_GAP_NS;

/// A variable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Variable {
    Row,
    RowParity,
    Column,
    ColumnParity,
    ColumnBlock,
    Radius,
    Time,
    /// Of this period, nanoseconds.
    Phase(f64),
    Photocurrent,
    Polarity,
    PreviousPolarity,
    TimeSinceLastEvent,
    BurstIndex,
}

/// What must be given for a variable to have a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Needs {
    Place,
    Time,
    /// The pixel's light when its last event left.
    Light,
    Polarity,
    /// The last event, and of which polarity this one is.
    Past,
    /// The last event, and how long ago it was.
    Wait,
}

/// Where and when a variable has a value.
#[derive(Clone, Copy)]
pub(super) struct At<'a> {
    pub site: &'a Site,
    pub t_ns: i64,
    pub history: &'a History,
    /// +1 or -1.
    pub polarity: i8,
}

impl Variable {
    /// Their names in a description.
    pub(super) const NAMES: [&'static str; 13] = [
        "row",
        "row_parity",
        "column",
        "column_parity",
        "column_block",
        "radius",
        "time",
        "ac_phase",
        "photocurrent",
        "polarity",
        "previous_polarity",
        "time_since_last_event",
        "burst_index",
    ];

    /// The variable of a name; `period_ns`: of `ac_phase`. None where that is missing.
    pub(super) fn named(name: &str, period_ns: Option<f64>) -> Option<Variable> {
        Some(match name {
            "row" => Variable::Row,
            "row_parity" => Variable::RowParity,
            "column" => Variable::Column,
            "column_parity" => Variable::ColumnParity,
            "column_block" => Variable::ColumnBlock,
            "radius" => Variable::Radius,
            "time" => Variable::Time,
            "ac_phase" => Variable::Phase(period_ns?),
            "photocurrent" => Variable::Photocurrent,
            "polarity" => Variable::Polarity,
            "previous_polarity" => Variable::PreviousPolarity,
            "time_since_last_event" => Variable::TimeSinceLastEvent,
            _ => Variable::BurstIndex,
        })
    }

    pub(super) fn needs(self) -> Needs {
        match self {
            Variable::Row
            | Variable::RowParity
            | Variable::Column
            | Variable::ColumnParity
            | Variable::ColumnBlock
            | Variable::Radius => Needs::Place,
            Variable::Time | Variable::Phase(_) => Needs::Time,
            Variable::Photocurrent => Needs::Light,
            Variable::Polarity => Needs::Polarity,
            Variable::PreviousPolarity => Needs::Past,
            Variable::TimeSinceLastEvent | Variable::BurstIndex => Needs::Wait,
        }
    }

    /// Its value; none before the first event where it is of the last one.
    pub(super) fn value(self, at: &At<'_>) -> Option<f64> {
        let At { site, t_ns, history, polarity } = *at;
        let since_ns = |last_ns: i64| t_ns - last_ns;
        Some(match self {
            Variable::Row => f64::from(site.y),
            Variable::RowParity => f64::from(site.y % 2),
            Variable::Column => f64::from(site.x),
            Variable::ColumnParity => f64::from(site.x % 2),
            Variable::ColumnBlock => f64::from(site.column_block()),
            Variable::Radius => site.radius(),
            Variable::Time => t_ns as f64 * 1e-9,
            Variable::Phase(period_ns) => {
                let periods = t_ns as f64 / period_ns;
                periods - periods.floor()
            }
            Variable::Photocurrent => libm::log(f64::max(history.light, f64::MIN_POSITIVE)),
            Variable::Polarity => f64::from(polarity),
            Variable::PreviousPolarity => f64::from(history.last_event?.polarity * polarity),
            Variable::TimeSinceLastEvent => since_ns(history.last_event?.t_in_ns) as f64 * 1e-9,
            Variable::BurstIndex => {
                let goes_on = history
                    .last_event
                    .is_some_and(|last| last.polarity == polarity && since_ns(last.t_in_ns) <= BURST_GAP_NS);
                if goes_on { f64::from(history.burst_index + 1) } else { 1.0 }
            }
        })
    }
}
