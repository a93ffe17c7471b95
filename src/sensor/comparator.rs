//! The comparator: when a change of the front-end voltage becomes an event.
//!
//! The pixel remembers a reference voltage and fires once the front-end voltage has moved away from it by a
//! contrast threshold, upwards (an ON event) or downwards (an OFF event).
//!
//! Source: Eq. (4). The paper's `c_down` is negative; here both thresholds are positive numbers and the
//! polarity carries the sign. Limits: no noise, no comparator delay; noise is the caller's, added to a
//! threshold.

/// An event of one pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelEvent {
    /// In-pixel time, ns: when the comparator fired.
    pub t_in_ns: i64,
    /// Off-pixel time, ns: when the event left the pixel array.
    pub t_off_ns: i64,
    /// +1 for ON, -1 for OFF.
    pub polarity: i8,
}

/// The polarity, +1 or -1, of the event that fires now, or `None` while the voltage stays inside both
/// thresholds.
///
/// All four arguments are in natural-log units. Both thresholds must be positive: then at most one side can
/// fire. A voltage exactly on a threshold fires, as in Eq. (4). A NaN voltage never fires.
///
/// ```
/// # use photocurrent_sensor::comparator::fired_polarity;
/// assert_eq!(fired_polarity(0.25, 0.0, 0.2, 0.3), Some(1));
/// assert_eq!(fired_polarity(-0.25, 0.0, 0.2, 0.3), None);
/// ```
pub fn fired_polarity(
    front_end_voltage: f64,
    reference_voltage: f64,
    threshold_on: f64,
    threshold_off: f64,
) -> Option<i8> {
    let change = front_end_voltage - reference_voltage;
    if change >= threshold_on {
        Some(1)
    } else if change <= -threshold_off {
        Some(-1)
    } else {
        None
    }
}

/// The signed log step an event of `polarity` (+1 or -1) stands for: the `c(k)` of Eq. (8).
pub fn signed_step(polarity: i8, threshold_on: f64, threshold_off: f64) -> f64 {
    if polarity > 0 { threshold_on } else { -threshold_off }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_voltage_on_the_threshold_fires() {
        assert_eq!(fired_polarity(0.5, 0.25, 0.25, 0.25), Some(1));
        assert_eq!(fired_polarity(0.0, 0.25, 0.25, 0.25), Some(-1));
    }

    #[test]
    fn a_voltage_inside_both_thresholds_is_silent() {
        assert_eq!(fired_polarity(0.249, 0.0, 0.25, 0.25), None);
        assert_eq!(fired_polarity(f64::NAN, 0.0, 0.25, 0.25), None);
    }

    #[test]
    fn swapping_polarity_swaps_the_thresholds() {
        for change in [-0.4, -0.25, -0.1, 0.0, 0.1, 0.25, 0.4] {
            let there = fired_polarity(change, 0.0, 0.2, 0.3);
            let mirrored = fired_polarity(-change, 0.0, 0.3, 0.2);
            assert_eq!(there, mirrored.map(|p| -p));
        }
    }

    #[test]
    fn the_step_has_the_sign_of_the_polarity() {
        assert_eq!(signed_step(1, 0.2, 0.3), 0.2);
        assert_eq!(signed_step(-1, 0.2, 0.3), -0.3);
    }
}
