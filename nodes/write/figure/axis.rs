//! An axis: its range, its ticks at round numbers, where a value stands.

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use std::ops::Range;

/// How many steps between ticks an axis should have, at most.
const MOST_STEPS: f64 = 8.0;

/// One axis.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Axis {
    range: Range<f64>,
    is_log: bool,
    ticks: Vec<f64>,
}

impl Axis {
    /// From the least to the greatest value. On a logarithmic axis ticks stand at 1, 2 and 5 times powers of
    /// ten.
    pub(crate) fn tight(values: impl Iterator<Item = f64>, is_log: bool) -> Axis {
        let range = range_of(values);
        if is_log && range.start > 0.0 {
            let (first, last) =
                (libm::log10(range.start).floor() as i32, libm::log10(range.end).ceil() as i32);
            let rounds =
                (first..=last).flat_map(|power| [1.0, 2.0, 5.0].map(|digit| digit * power_of_ten(power)));
            let slack = 1e-9 * range.end;
            let ticks =
                rounds.filter(|tick| (range.start - slack..=range.end + slack).contains(tick)).collect();
            return Axis { range, is_log: true, ticks };
        }
        Axis { ticks: round_numbers(&range), range, is_log: false }
    }

    /// The same, with a twentieth to spare at both ends.
    pub(crate) fn wide(values: impl Iterator<Item = f64>) -> Axis {
        let range = range_of(values);
        let spare = 0.05 * (range.end - range.start);
        let range = range.start - spare..range.end + spare;
        Axis { ticks: round_numbers(&range), range, is_log: false }
    }

    /// 0 at the start of the range, 1 at its end.
    fn share(&self, value: f64) -> f64 {
        let at = |value: f64| if self.is_log { libm::log10(value) } else { value };
        (at(value) - at(self.range.start)) / (at(self.range.end) - at(self.range.start))
    }
}

/// The range of values; one unit wide where all are equal, 0 to 1 where there is none.
fn range_of(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = values
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (value.min(low), value.max(high)));
    match () {
        () if low > high => 0.0..1.0,
        () if low == high => low - 0.5..high + 0.5,
        () => low..high,
    }
}

fn power_of_ten(power: i32) -> f64 {
    libm::pow(10.0, f64::from(power))
}

/// Multiples of 1, 2 or 5 times a power of ten.
fn round_numbers(range: &Range<f64>) -> Vec<f64> {
    let width = range.end - range.start;
    let power = power_of_ten(libm::log10(width / MOST_STEPS).floor() as i32);
    let step = [1.0, 2.0, 5.0, 10.0]
        .map(|digit| digit * power)
        .into_iter()
        .find(|step| width / step <= MOST_STEPS)
        .unwrap_or(width);
    let (first, last) = ((range.start / step).ceil() as i64, (range.end / step).floor() as i64);
    (first..=last).map(|k| k as f64 * step).collect()
}

impl From<Range<f64>> for Axis {
    fn from(range: Range<f64>) -> Axis {
        Axis { ticks: round_numbers(&range), range, is_log: false }
    }
}

impl Ranged for Axis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (from, to): (i32, i32)) -> i32 {
        from + (self.share(*value) * f64::from(to - from)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        self.ticks.clone()
    }

    fn range(&self) -> Range<f64> {
        self.range.clone()
    }
}

impl ValueFormatter<f64> for Axis {
    fn format(value: &f64) -> String {
        let text = format!("{value:.6}");
        let text = text.trim_end_matches('0').trim_end_matches('.');
        if text == "-0" { "0".into() } else { text.into() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ticks(axis: &Axis) -> Vec<String> {
        axis.ticks.iter().map(Axis::format).collect()
    }

    #[test]
    fn ticks_stand_at_round_numbers() {
        assert_eq!(
            ticks(&Axis::tight([0.0, 100.0].into_iter(), false)),
            ["0", "20", "40", "60", "80", "100"]
        );
        assert_eq!(
            ticks(&Axis::tight([-0.31, 0.33].into_iter(), false)),
            ["-0.3", "-0.2", "-0.1", "0", "0.1", "0.2", "0.3"]
        );
        assert_eq!(
            ticks(&Axis::tight([50.0, 1000.0].into_iter(), true)),
            ["50", "100", "200", "500", "1000"]
        );
    }

    #[test]
    fn equal_ratios_are_equally_far_apart_on_a_logarithmic_axis() {
        let axis = Axis::tight([10.0, 1000.0].into_iter(), true);
        assert_eq!([10.0, 100.0, 1000.0].map(|value| axis.map(&value, (0, 600))), [0, 300, 600]);
        // Where that cannot be, equal differences are.
        let axis = Axis::tight([0.0, 1000.0].into_iter(), true);
        assert_eq!(axis.map(&100.0, (0, 600)), 60);
    }

    #[test]
    fn one_value_and_none_have_an_axis_too() {
        assert_eq!(Axis::tight([3.0].into_iter(), false).range, 2.5..3.5);
        assert_eq!(Axis::wide(std::iter::empty()).range, -0.05..1.05);
    }
}
