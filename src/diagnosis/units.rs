//! Numbers with units as people write them: `954 us`, `3.2 %`, not `0.000954 s`.

use crate::report::four_digits;

/// A value of a report with its unit: times in s, ms, us or ns, rates in Hz or kHz, shares in percent; others
/// as they are. Four digits that count.
///
/// ```
/// use photocurrent_diagnosis::units::readable;
/// assert_eq!(readable(0.000_954, "s"), "954 us");
/// assert_eq!(readable(-0.0032, "s"), "-3.2 ms");
/// assert_eq!(readable(0.125, "fraction"), "12.5 %");
/// assert_eq!(readable(2500.0, "Hz"), "2.5 kHz");
/// assert_eq!(readable(0.0, "s"), "0 s");
/// ```
pub fn readable(value: f64, unit: &str) -> String {
    let steps: &[(f64, &str)] = match unit {
        "s" => &[(1.0, "s"), (1e-3, "ms"), (1e-6, "us"), (1e-9, "ns")],
        "Hz" => &[(1e6, "MHz"), (1e3, "kHz"), (1.0, "Hz")],
        "fraction" => &[(0.01, "%")],
        _ => &[(1.0, unit)],
    };
    let (scale, name) = if value == 0.0 {
        *steps.iter().find(|step| step.1 == unit).unwrap_or(&steps[0])
    } else {
        // A hair of rounding must not turn 1 ms into 1000 us.
        *steps.iter().find(|step| value.abs() >= step.0 * (1.0 - 1e-9)).unwrap_or(&steps[steps.len() - 1])
    };
    format!("{} {name}", four_digits(value / scale)).trim_end().to_owned()
}

/// The name of a parameter without the unit that its key ends with.
pub fn name_of(key: &str) -> &str {
    ["_s", "_hz"].iter().find_map(|end| key.strip_suffix(end)).unwrap_or(key)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_unit_is_the_largest_that_leaves_a_digit_before_the_point() {
        let of = |value: f64| readable(value, "s");
        assert_eq!(
            [of(1.0), of(0.999_999_999_99), of(0.001), of(35.3e-6), of(2e-10)],
            ["1 s", "1 s", "1 ms", "35.3 us", "0.2 ns"]
        );
        assert_eq!(
            [readable(0.0025, "Hz"), readable(-0.35, "fraction"), readable(1.5, ""), readable(3.0, "DN")],
            ["0.0025 Hz", "-35 %", "1.5", "3 DN"]
        );
        assert_eq!(
            [name_of("row_time_s"), name_of("rate_hz"), name_of("fraction")],
            ["row_time", "rate", "fraction"]
        );
    }
}
