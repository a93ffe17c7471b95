//! The comparator's input over one step, and where it crosses a threshold.
//!
//! A crossing is solved for, never rounded to a step. The plain front end has a closed form
//! ([`super::steps`]), plus a leak that is linear in time. Other front ends bring their own [`Response`].

use super::steps::{Steps, Weights};
use crate::comparator::fired_polarity;

/// Newton's steps shorter than this share of a step are the last: the error left is about its square.
const LAST_MOVE: f64 = 1e-6;

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

    /// The first instant from that of `from`, an instant and the input there, to `to_s` at which a threshold
    /// is crossed or already exceeded, and the polarity.
    fn first_crossing(
        &self,
        from: (f64, f64),
        to_s: f64,
        reference: f64,
        on: f64,
        off: f64,
    ) -> Option<(f64, i8)> {
        if self.stays_within(reference - off, reference + on) {
            return None;
        }
        if let Some(polarity) = fired_polarity(from.1, reference, on, off) {
            return Some((from.0, polarity));
        }
        let mut piece_start = from;
        // Between its ends and its turning points the input is monotone: a crossing shows at the end.
        for piece_end_s in self.turning_points(from.0, to_s).into_iter().chain([Some(to_s)]).flatten() {
            let piece_end = (piece_end_s, self.value(piece_end_s));
            if let Some(polarity) = fired_polarity(piece_end.1, reference, on, off) {
                let level = reference + if polarity > 0 { on } else { -off };
                return Some((self.instant_of(level, piece_start, piece_end), polarity));
            }
            piece_start = piece_end;
        }
        None
    }

    /// Solves value(t) = level on a monotone piece between two instants and the inputs there; by bisection.
    fn instant_of(&self, level: f64, from: (f64, f64), to: (f64, f64)) -> f64 {
        let rises = to.1 >= from.1;
        let (mut low, mut high) = (from.0, to.0);
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

/// The plain front end over one prepared step, and the drift of the comparator's input.
///
/// The trait's seconds become the share `sigma` of the step's length in time constants: inside the step time
/// is a parabola in sigma.
pub(super) struct StepResponse {
    /// Voltage above the settled one at the start.
    ahead: f64,
    settled: f64,
    slope: f64,
    bend: f64,
    theta: f64,
    /// How much sigma lags behind time: time / length = sigma + warp sigma (1 - sigma).
    warp: f64,
    length_s: f64,
    end: f64,
    /// Slope of the input over sigma at both ends.
    slopes: [f64; 2],
    drift: f64,
    drift_per_s: f64,
}

/// A voltage as near as this to the settled one has settled: rounding, not physics.
const SETTLED: f64 = 1e-14;

impl StepResponse {
    /// Step `n` from `voltage`, whose end is `end`.
    pub(super) fn new(
        steps: &Steps,
        n: usize,
        voltage: f64,
        end: f64,
        drift: f64,
        drift_per_s: f64,
    ) -> StepResponse {
        let (settled, middle) = (steps.settled[n], steps.middle[n]);
        let ahead = voltage - settled;
        let ahead = if ahead.abs() < SETTLED { 0.0 } else { ahead };
        let warp = (0.5 - middle) / (middle * (1.0 - middle));
        let drift_over_step = drift_per_s * steps.length_s[n];
        let slopes = steps.end_slopes(n, ahead);
        StepResponse {
            ahead,
            settled,
            slope: steps.slope[n],
            bend: steps.bend[n],
            theta: steps.theta[n],
            warp,
            length_s: steps.length_s[n],
            end,
            slopes: [slopes[0] + drift_over_step * (1.0 + warp), slopes[1] + drift_over_step * (1.0 - warp)],
            drift,
            drift_per_s,
        }
    }

    /// The root of the parabola between 0 and 1, in the form that loses no digits.
    fn sigma(&self, t_s: f64) -> f64 {
        let share = t_s / self.length_s;
        let sum = 1.0 + self.warp;
        2.0 * share / (sum + libm::sqrt(sum * sum - 4.0 * self.warp * share))
    }

    fn seconds(&self, sigma: f64) -> f64 {
        self.length_s * sigma * (1.0 + self.warp * (1.0 - sigma))
    }

    /// The comparator's input and its slope over sigma.
    fn at(&self, sigma: f64) -> (f64, f64) {
        let weights = Weights::after(self.theta * sigma);
        let (slope, bend) = (self.slope, self.bend * sigma);
        let voltage =
            self.settled + self.ahead * weights.kept + sigma * (slope * weights.slope + bend * weights.bend);
        let voltage_slope =
            slope * weights.constant + 2.0 * bend * weights.slope - self.theta * self.ahead * weights.kept;
        let drift_slope = self.drift_per_s * self.length_s * (1.0 + self.warp * (1.0 - 2.0 * sigma));
        (voltage + (self.drift + self.drift_per_s * self.seconds(sigma)), voltage_slope + drift_slope)
    }
}

impl Response for StepResponse {
    fn value(&self, t_s: f64) -> f64 {
        if t_s <= 0.0 {
            self.settled + self.ahead + self.drift
        } else if t_s >= self.length_s {
            self.end + (self.drift + self.drift_per_s * self.length_s)
        } else {
            self.at(self.sigma(t_s)).0
        }
    }

    /// The voltage runs after the light, which rises or falls all through the step: it turns at most once,
    /// where it meets the light. A drift moves that instant and is far too slow to add another.
    fn turning_points(&self, from_s: f64, to_s: f64) -> [Option<f64>; 2] {
        let first = if from_s <= 0.0 { self.slopes[0] } else { self.at(self.sigma(from_s)).1 };
        let last = if to_s >= self.length_s { self.slopes[1] } else { self.at(self.sigma(to_s)).1 };
        if first == 0.0 || last == 0.0 || (first > 0.0) == (last > 0.0) {
            return [None, None];
        }
        let (mut low, mut high) = (self.sigma(from_s), self.sigma(to_s));
        while high - low > 1e-12 {
            let middle = 0.5 * (low + high);
            if (self.at(middle).1 > 0.0) == (first > 0.0) { low = middle } else { high = middle }
        }
        [Some(self.seconds(high).clamp(from_s, to_s)), None]
    }

    /// Newton's method, kept inside what is known to hold the crossing.
    fn instant_of(&self, level: f64, from: (f64, f64), to: (f64, f64)) -> f64 {
        let (mut low, mut high) = (self.sigma(from.0), self.sigma(to.0));
        let rises = to.1 > from.1;
        let mut sigma = self.guess(level, (low, from.1), (high, to.1));
        // Halving alone needs 50 rounds to the last bit.
        for _ in 0..60 {
            let (value, slope) = self.at(sigma);
            if value == level {
                break;
            }
            if (value > level) == rises {
                high = sigma
            } else {
                low = sigma
            }
            let newton = sigma - (value - level) / slope;
            let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
            let is_last = (next - sigma).abs() < LAST_MOVE && next == newton || high - low < 1e-15;
            sigma = next;
            if is_last {
                break;
            }
        }
        self.seconds(sigma).clamp(from.0, to.0)
    }
}

impl StepResponse {
    /// Where the cubic with the same values and slopes at the step's ends, taken as sigma over value, has
    /// `level`; on a part of a step, the straight line.
    fn guess(&self, level: f64, from: (f64, f64), to: (f64, f64)) -> f64 {
        let rise = to.1 - from.1;
        let share = ((level - from.1) / rise).clamp(0.0, 1.0);
        let straight = from.0 + (to.0 - from.0) * share;
        if from.0 > 0.0 || to.0 < 1.0 {
            return straight;
        }
        let (first, last) = (rise / self.slopes[0], rise / self.slopes[1]);
        let cubic = share + share * (1.0 - share) * ((first - 1.0) * (1.0 - share) - (last - 1.0) * share);
        if cubic > 0.0 && cubic < 1.0 { cubic } else { straight }
    }
}
