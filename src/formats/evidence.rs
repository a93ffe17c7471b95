//! What stamps of an unknown unit look like: said to the user, who decides.
//!
//! Nothing is taken from this silently. A unit is proposed where the magnitude is that of a clock since 1970,
//! or where only one unit gives a plausible rate, or where convention helps: whole numbers are mostly
//! microseconds, decimal fractions mostly seconds.

use crate::decimal::Decimal;
use crate::declared::TimeUnit;

/// Stamps of what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Of {
    /// Events.
    Events,
    /// Frames.
    Frames,
}

impl Of {
    fn word(self) -> &'static str {
        match self {
            Of::Events => "events",
            Of::Frames => "frames",
        }
    }

    /// The parameter that states their unit.
    fn parameter(self) -> &'static str {
        match self {
            Of::Events => "time_unit",
            Of::Frames => "stamps_unit",
        }
    }

    /// Rates that cameras have, per second.
    fn plausible(self) -> std::ops::RangeInclusive<f64> {
        match self {
            Of::Events => 20.0..=3e9,
            Of::Frames => 0.2..=50_000.0,
        }
    }
}

/// Name of a unit in parameters.
pub(crate) fn unit_name(unit: TimeUnit) -> &'static str {
    match unit {
        TimeUnit::S => "s",
        TimeUnit::Ms => "ms",
        TimeUnit::Us => "us",
        TimeUnit::Ns => "ns",
    }
}

/// Takes a unit in brackets off a name: `t [us]`.
pub(crate) fn unit_in_brackets(name: &mut String) -> Option<TimeUnit> {
    let mut unit = None;
    for (open, close) in [('[', ']'), ('(', ')')] {
        if let Some((before, after)) = name.clone().split_once(open) {
            unit = unit_named(after.trim_end_matches(close));
            *name = before.trim().into();
        }
    }
    unit
}

/// A unit by the names that files use.
pub(crate) fn unit_named(name: &str) -> Option<TimeUnit> {
    match name.trim().to_ascii_lowercase().as_str() {
        "s" | "sec" | "secs" | "second" | "seconds" => Some(TimeUnit::S),
        "ms" | "msec" | "millisecond" | "milliseconds" => Some(TimeUnit::Ms),
        "us" | "µs" | "μs" | "usec" | "microsecond" | "microseconds" => Some(TimeUnit::Us),
        "ns" | "nsec" | "nanosecond" | "nanoseconds" => Some(TimeUnit::Ns),
        _ => None,
    }
}

/// What the stamps look like, and the unit they probably have.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Evidence {
    /// For the message: "stamps run from 0 to 998000 ...".
    pub(crate) text: String,
    /// The unit that fits best, where one does.
    pub(crate) proposal: Option<TimeUnit>,
    /// Whose stamps.
    of: Of,
}

impl Evidence {
    /// What to do next, for the message.
    pub(crate) fn hint(&self) -> String {
        let name = self.of.parameter();
        match self.proposal {
            Some(unit) => {
                format!("state the unit of the stamps; `{name} = \"{}\"` looks right", unit_name(unit))
            }
            None => format!("state the unit of the stamps: `{name} = \"us\"` (or s, ms, ns)"),
        }
    }
}

/// Judges a sample of stamps in file order; `total` is how many the file holds, about.
pub(crate) fn of_decimals(sample: &[Decimal], total: f64, of: Of) -> Evidence {
    let values: Vec<f64> = sample.iter().map(|number| number.value()).collect();
    let places = sample.iter().map(|number| number.places()).max().unwrap_or(0);
    judge(&values, sample.iter().all(|number| number.is_whole()), places, total, of)
}

/// As [`of_decimals`], of stored numbers.
pub(crate) fn of_values(values: &[f64], whole: bool, total: f64, of: Of) -> Evidence {
    judge(values, whole, 0, total, of)
}

fn judge(values: &[f64], whole: bool, places: u32, total: f64, of: Of) -> Evidence {
    let finite: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for &value in &finite {
        (low, high) = (low.min(value), high.max(value));
    }
    if finite.is_empty() {
        return Evidence { text: "no stamp could be read".into(), proposal: None, of };
    }
    let mut sorted = finite.clone();
    sorted.sort_by(f64::total_cmp);
    sorted.dedup();
    let distinct = sorted.len();
    let form = match (whole, places) {
        (true, _) => "whole numbers".to_string(),
        (false, 0) => "numbers with a fraction".to_string(),
        (false, places) => format!("decimal numbers with up to {places} places"),
    };
    let mut text = format!(
        "stamps run from {low} to {high}, {form}, {distinct} distinct among {} looked at",
        finite.len()
    );
    let span = high - low;
    if span <= 0.0 {
        text += "; all are equal, so they do not show their unit";
        return Evidence { text, proposal: since_1970(low, whole), of };
    }
    let units = [TimeUnit::S, TimeUnit::Ms, TimeUnit::Us, TimeUnit::Ns];
    let rate = |unit: TimeUnit| total / (span * unit.ns() as f64 * 1e-9);
    let said: Vec<String> = units
        .iter()
        .map(|&unit| {
            format!(
                "{}: {} over {}",
                unit_name(unit),
                short(rate(unit), "/s"),
                short(span * unit.ns() as f64 * 1e-9, " s")
            )
        })
        .collect();
    text += &format!("; rate of {} if in {}", of.word(), said.join(", in "));
    let plausible: Vec<TimeUnit> =
        units.into_iter().filter(|&unit| of.plausible().contains(&rate(unit))).collect();
    let usual = if whole { TimeUnit::Us } else { TimeUnit::S };
    let proposal = since_1970(low, whole).or(match plausible.as_slice() {
        [one] => Some(*one),
        several => several.contains(&usual).then_some(usual),
    });
    Evidence { text, proposal, of }
}

/// The unit in which a stamp lies between 2001 and 2100, when it is as large as such stamps are.
fn since_1970(stamp: f64, whole: bool) -> Option<TimeUnit> {
    let seconds = 1e9..4.1e9;
    if seconds.contains(&stamp) && !whole {
        return Some(TimeUnit::S);
    }
    // Whole numbers of that size are as well microseconds since the camera was started.
    [TimeUnit::Ms, TimeUnit::Us, TimeUnit::Ns]
        .into_iter()
        .find(|unit| seconds.contains(&(stamp * unit.ns() as f64 * 1e-9)) && *unit != TimeUnit::Ms)
}

fn short(value: f64, unit: &str) -> String {
    if (1e-3..1e6).contains(&value) { format!("{value:.3}{unit}") } else { format!("{value:.2e}{unit}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn microseconds_seconds_and_clocks_since_1970_are_proposed() {
        let whole: Vec<f64> = (0..1000).map(|k| f64::from(k) * 13.0).collect();
        assert_eq!(of_values(&whole, true, 1000.0, Of::Events).proposal, Some(TimeUnit::Us));
        let seconds: Vec<f64> = (0..1000).map(|k| f64::from(k) * 1.3e-5).collect();
        assert_eq!(of_values(&seconds, false, 1000.0, Of::Events).proposal, Some(TimeUnit::S));
        assert_eq!(
            of_values(&[1.469e9 + 0.25, 1.469e9 + 0.5], false, 2.0, Of::Frames).proposal,
            Some(TimeUnit::S)
        );
        assert_eq!(
            of_values(&[1.469e18, 1.469e18 + 4e7], true, 2.0, Of::Frames).proposal,
            Some(TimeUnit::Ns)
        );
    }

    #[test]
    fn equal_stamps_show_no_unit() {
        let evidence = of_values(&[0.0; 1999], true, 1999.0, Of::Events);
        assert_eq!(evidence.proposal, None);
        assert!(evidence.text.contains("1 distinct among 1999"), "{}", evidence.text);
    }

    #[test]
    fn stamps_that_are_no_numbers_are_survived() {
        assert_eq!(of_values(&[f64::NAN, f64::INFINITY], false, 2.0, Of::Events).proposal, None);
    }
}
