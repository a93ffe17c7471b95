//! Decimal numbers of text files, kept as written, so that "1.123456789" seconds is 1,123,456,789 ns and not
//! the nearest binary fraction.
//!
//! A number is a whole mantissa of up to 19 digits and a power of ten. A stamp that fits into 64 bits of
//! nanoseconds needs no more digits than that; further ones only round, and half a nanosecond rounds away
//! from zero.

use crate::declared::TimeUnit;

/// sign * mantissa * 10^exponent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Decimal {
    negative: bool,
    mantissa: u64,
    exponent: i32,
    /// The first digit that found no place in the mantissa.
    next: u8,
}

/// Digits that always fit into 64 bits.
const DIGITS: u32 = 19;

impl Decimal {
    /// Reads all of `text`; `None` when it is anything but one finite decimal number.
    #[inline]
    pub(crate) fn read(text: &[u8]) -> Option<Decimal> {
        let (negative, mut rest) = match text.split_first()? {
            (b'-', rest) => (true, rest),
            (b'+', rest) => (false, rest),
            _ => (false, text),
        };
        let (mut mantissa, mut digits, mut exponent, mut next) = (0_u64, 0_u32, 0_i32, None);
        let (mut any, mut point) = (false, false);
        while let Some((&byte, after)) = rest.split_first() {
            match byte {
                b'0'..=b'9' => {
                    any = true;
                    let digit = byte - b'0';
                    if digits < DIGITS {
                        mantissa = mantissa * 10 + u64::from(digit);
                        // Zeros in front need no place.
                        digits += u32::from(mantissa != 0);
                        exponent = exponent.saturating_sub(i32::from(point));
                    } else {
                        next.get_or_insert(digit);
                        exponent = exponent.saturating_add(i32::from(!point));
                    }
                }
                b'.' if !point => point = true,
                b'e' | b'E' if any => {
                    exponent = exponent.saturating_add(power(after)?);
                    break;
                }
                _ => return None,
            }
            rest = after;
        }
        any.then_some(Decimal { negative, mantissa, exponent, next: next.unwrap_or(0) })
    }

    /// The number times 10^`shift`, rounded to the nearest whole one; `None` beyond 64 bits.
    #[inline]
    fn shifted(self, shift: i32) -> Option<i64> {
        let exponent = self.exponent.saturating_add(shift);
        let magnitude = if self.mantissa == 0 {
            0
        } else if exponent >= 0 {
            // A mantissa that lost digits has 19, so that any power of ten leads out of 64 bits: its next
            // digit counts only here.
            let power = 10_u64.checked_pow(exponent.unsigned_abs())?;
            self.mantissa.checked_mul(power)?.checked_add(u64::from(exponent == 0 && self.next >= 5))?
        } else {
            match 10_u64.checked_pow(exponent.unsigned_abs()) {
                Some(power) => {
                    self.mantissa / power + u64::from(self.mantissa % power >= power - self.mantissa % power)
                }
                None => 0,
            }
        };
        let magnitude = i64::try_from(magnitude).ok()?;
        Some(if self.negative { -magnitude } else { magnitude })
    }

    /// As a time, ns; `None` beyond 64 bits.
    #[inline]
    pub(crate) fn ns(self, unit: TimeUnit) -> Option<i64> {
        self.shifted(match unit {
            TimeUnit::S => 9,
            TimeUnit::Ms => 6,
            TimeUnit::Us => 3,
            TimeUnit::Ns => 0,
        })
    }

    /// Digits after the point as written (12.50 has two), so many that they say something: the step of the
    /// number is 10^-places.
    pub(crate) fn places(self) -> u32 {
        self.exponent.min(0).unsigned_abs()
    }

    /// Is it a whole number?
    pub(crate) fn is_whole(self) -> bool {
        self.exponent >= 0
            || 10_u64
                .checked_pow(self.exponent.unsigned_abs())
                .map_or(self.mantissa == 0, |power| self.mantissa.is_multiple_of(power))
    }

    /// The number divided by `scale` and rounded to the nearest whole one, halves up: the pixel that a
    /// coordinate lies in.
    pub(crate) fn pixel(self, scale: u32) -> Option<i64> {
        let millionths = self.shifted(6)?;
        let step = 1_000_000 * i64::from(scale.max(1));
        Some(millionths.checked_add(step / 2)?.div_euclid(step))
    }

    /// The nearest binary fraction, for judging magnitudes.
    pub(crate) fn value(self) -> f64 {
        let magnitude = self.mantissa as f64 * libm::pow(10.0, f64::from(self.exponent));
        if self.negative { -magnitude } else { magnitude }
    }
}

/// The power after an `e`.
fn power(text: &[u8]) -> Option<i32> {
    let (sign, digits) = match text.split_first()? {
        (b'-', rest) => (-1, rest),
        (b'+', rest) => (1, rest),
        _ => (1, text),
    };
    if digits.is_empty() || digits.len() > 6 || !digits.iter().all(u8::is_ascii_digit) {
        return None;
    }
    Some(sign * digits.iter().fold(0, |sum, digit| sum * 10 + i32::from(digit - b'0')))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ns(text: &str, unit: TimeUnit) -> Option<i64> {
        Decimal::read(text.as_bytes()).and_then(|number| number.ns(unit))
    }

    #[test]
    fn decimal_seconds_are_exact() {
        for (text, want) in [
            ("1.123456789", 1_123_456_789),
            ("0.000000001", 1),
            ("1469012345.123456789", 1_469_012_345_123_456_789),
            ("-2.5", -2_500_000_000),
            ("3e-3", 3_000_000),
            ("1.5E+1", 15_000_000_000),
            (".25", 250_000_000),
            ("7.", 7_000_000_000),
            ("0.1234567894999999999999999", 123_456_789),
            ("0.1234567895", 123_456_790),
            ("1469012345.1234567895", 1_469_012_345_123_456_790),
            ("00000000000000000000000001.5", 1_500_000_000),
            ("0.00000000000000000000000000000000000001", 0),
            ("0e400000", 0),
        ] {
            assert_eq!(ns(text, TimeUnit::S), Some(want), "{text}");
        }
        assert_eq!(ns("12.345", TimeUnit::Us), Some(12_345));
        assert_eq!(ns("9223372036854775807", TimeUnit::Ns), Some(i64::MAX));
    }

    #[test]
    fn what_is_no_number_or_too_large_is_refused() {
        for text in
            ["", "-", ".", "nan", "inf", "1 2", "1,5", "0x10", "1e", "1e+", "--1", "1..2", "e5", "1e1234567"]
        {
            assert_eq!(ns(text, TimeUnit::S), None, "{text}");
        }
        for text in ["9223372036.854775808", "1e30", "99999999999999999999", "9223372036854775808"] {
            assert_eq!(ns(text, TimeUnit::S), None, "{text}");
        }
    }

    #[test]
    fn a_coordinate_falls_into_the_nearest_pixel() {
        let pixel = |text: &str, scale| Decimal::read(text.as_bytes()).and_then(|number| number.pixel(scale));
        assert_eq!(pixel("12.4", 1), Some(12));
        assert_eq!(pixel("12.5", 1), Some(13));
        assert_eq!(pixel("-0.4", 1), Some(0));
        assert_eq!(pixel("-0.6", 1), Some(-1));
        assert_eq!(pixel("415", 32), Some(13), "12.97");
    }

    proptest! {
        #[test]
        fn every_nanosecond_survives_being_written_in_any_unit(
            ns_in in -9_000_000_000_000_000_000_i64..9_000_000_000_000_000_000,
        ) {
            for (unit, places) in [
                (TimeUnit::S, 9_usize), (TimeUnit::Ms, 6), (TimeUnit::Us, 3), (TimeUnit::Ns, 0),
            ] {
                let size = ns_in.unsigned_abs();
                let (whole, part) = (size / unit.ns() as u64, size % unit.ns() as u64);
                let sign = if ns_in < 0 { "-" } else { "" };
                let text = if places == 0 {
                    format!("{sign}{whole}")
                } else {
                    format!("{sign}{whole}.{part:0places$}")
                };
                prop_assert_eq!(ns(&text, unit), Some(ns_in), "{}", text);
            }
        }

        #[test]
        fn no_bytes_panic(
            bytes in proptest::collection::vec(
                prop_oneof![Just(b'.'), Just(b'e'), Just(b'-'), b'0'..=b'9', any::<u8>()], 0..40,
            ),
        ) {
            if let Some(number) = Decimal::read(&bytes) {
                let _ = (
                    number.ns(TimeUnit::S), number.pixel(32), number.value(), number.is_whole(),
                    number.places(),
                );
            }
        }
    }
}
