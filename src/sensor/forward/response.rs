//! The comparator's input over one step, and where it crosses a threshold.
//!
//! A crossing is solved for, never rounded to a step. The plain front end has a closed form: a low-pass driven by a ramp
//! of `ln i`, plus a leak that is linear in time. Other front ends bring their own [`Response`].

use crate::comparator::fired_polarity;
use crate::front_end::{FrontEnd, settled_voltage, time_constant};

/// The comparator's input over one step, in natural-log units; times are seconds from the step's start.
pub(super) trait Response {
    /// The input at `t_s`, drift included.
    fn value(&self, t_s: f64) -> f64;

    /// Where the input may turn round between `from_s` and `to_s`, in time order.
    fn turning_points(&self, from_s: f64, to_s: f64) -> [Option<f64>; 2];

    /// Whether the input surely stays inside (low, high) from `from_s` to the step's end.
    fn stays_within(&self, _low: f64, _high: f64) -> bool {
        false
    }

    /// Crossing times are solved to this width, seconds; zero = to the last bit.
    fn resolution_s(&self) -> f64 {
        0.0
    }

    /// The first instant from `from_s` to `to_s` at which a threshold is crossed or already exceeded, and the polarity.
    fn first_crossing(&self, from_s: f64, to_s: f64, reference: f64, on: f64, off: f64) -> Option<(f64, i8)> {
        if self.stays_within(reference - off, reference + on) {
            return None;
        }
        if let Some(polarity) = fired_polarity(self.value(from_s), reference, on, off) {
            return Some((from_s, polarity));
        }
        let mut piece_start = from_s;
        // Between its ends and its turning points the input is monotone: a crossing shows at the end.
        for piece_end in self.turning_points(from_s, to_s).into_iter().chain([Some(to_s)]).flatten() {
            if let Some(polarity) = fired_polarity(self.value(piece_end), reference, on, off) {
                let level = reference + if polarity > 0 { on } else { -off };
                return Some((self.instant_of(level, piece_start, piece_end), polarity));
            }
            piece_start = piece_end;
        }
        None
    }

    /// Solves value(t) = level on a monotone piece by bisection.
    fn instant_of(&self, level: f64, from_s: f64, to_s: f64) -> f64 {
        let rises = self.value(to_s) >= self.value(from_s);
        let (mut low, mut high) = (from_s, to_s);
        loop {
            let middle = 0.5 * (low + high);
            if !(middle > low && middle < high) || high - low < self.resolution_s() {
                return high;
            }
            let is_past = if rises { self.value(middle) >= level } else { self.value(middle) <= level };
            if is_past {
                high = middle;
            } else {
                low = middle;
            }
        }
    }
}

/// The plain front end over one step: a low-pass driven by a ramp, and a leak.
pub(super) struct RampResponse {
    pub start: f64,
    pub settled: f64,
    pub slope: f64,
    pub tau_s: f64,
    pub drift: f64,
    pub drift_per_s: f64,
}

impl RampResponse {
    /// From `voltage`, with photocurrents `first` and `last` at the ends of a step of `length_s`. `ln i` is taken as linear, the
    /// time constant as that of the step's middle: both are exact for constant light and of second order else.
    pub fn new(front_end: &FrontEnd, voltage: f64, first: f64, last: f64, length_s: f64) -> Self {
        let settled = settled_voltage(first);
        let slope = (settled_voltage(last) - settled) / length_s;
        let tau_s = time_constant(front_end, 0.5 * (first + last));
        RampResponse { start: voltage, settled, slope, tau_s, drift: 0.0, drift_per_s: 0.0 }
    }

    /// `V(t) = L(t) - m tau + (V0 - L0 + m tau) exp(-t / tau)` for `dV/dt = (L - V) / tau` and `L = L0 + m t`.
    pub fn voltage(&self, t_s: f64) -> f64 {
        let ramp = self.settled + self.slope * t_s;
        if self.tau_s == 0.0 {
            return ramp;
        }
        let lag = self.slope * self.tau_s;
        ramp - lag + (self.start - self.settled + lag) * libm::exp(-t_s / self.tau_s)
    }
}

impl Response for RampResponse {
    fn value(&self, t_s: f64) -> f64 {
        self.voltage(t_s) + (self.drift + self.drift_per_s * t_s)
    }

    /// U' = m + l - (A / tau) exp(-t / tau) = 0 has at most one solution.
    fn turning_points(&self, from_s: f64, to_s: f64) -> [Option<f64>; 2] {
        let ratio = (self.start - self.settled + self.slope * self.tau_s) / ((self.slope + self.drift_per_s) * self.tau_s);
        if ratio <= 1.0 {
            return [None, None];
        }
        let at_s = self.tau_s * libm::log(ratio);
        [(at_s > from_s && at_s < to_s).then_some(at_s), None]
    }
}
