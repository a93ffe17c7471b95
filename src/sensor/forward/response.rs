//! The comparator's input over one step, and where it crosses a threshold.
//!
//! A crossing is solved for, never rounded to a step. The plain front end has a closed form
//! ([`super::steps`]), plus a leak that is linear in time. Other front ends bring their own [`Response`].

use super::steps::{Steps, Weights, pace};
use crate::comparator::fired_polarity;
use crate::elementary;

/// A move of Halley's method is the last when it is so short, as a share of the step and of the distance over
/// which the slope changes by itself: the error left is about its third power.
const LAST_MOVE: f64 = 1e-4;

/// A step that is shorter, in time constants, is the polynomial of seventh degree with the same input and
/// derivatives up to the third at both ends: off by 4e-7 of the voltage's way at most.
const SHORT_THETA: f64 = 1.2;

/// A turning point is found to this share of a step: the input there is then off by its square.
const LAST_TURN: f64 = 1e-8;

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
/// Inside, `s` is the share of the step's time, and sigma the share of its length in time constants.
pub(super) struct StepResponse {
    /// Voltage above the settled one at the start.
    ahead: f64,
    settled: f64,
    /// See [`Steps::course`].
    course: [f64; 4],
    theta: f64,
    /// See [`pace`].
    pace: [f64; 5],
    /// Of a short step: factors of `1, s, s^2 ...` of the input.
    short: Option<[f64; 8]>,
    length_s: f64,
    end: f64,
    /// Slope of the input over `s` at both ends.
    slopes: [f64; 2],
    drift: f64,
    drift_per_step: f64,
}

/// A voltage as near as this to the settled one has settled: rounding, not physics.
const SETTLED: f64 = 1e-14;

/// The comparator's input at a place, and its slope and curvature over `s`.
struct Local {
    value: f64,
    slope: f64,
    bend: f64,
}

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
        let settled = steps.settled[n];
        let ahead = voltage - settled;
        let ahead = if ahead.abs() < SETTLED { 0.0 } else { ahead };
        let drift_per_step = drift_per_s * steps.length_s[n];
        let [a, b, c] = [0, 1, 2].map(|k| steps.inside[k][n]);
        let pace = pace([steps.rate[n], a, b, c, steps.rate[n + 1]]);
        let (theta, slopes) = (steps.theta[n], steps.end_slopes(n, ahead));
        let short = (theta < SHORT_THETA).then(|| {
            let (bends, light_bends) = (steps.end_bends(n, ahead), steps.light_bends(n));
            // From derivatives over sigma to those over s, with those of sigma over s.
            let [a, b, c, d, e] = pace;
            let last = [a + b + c + d + e, b + 2.0 * c + 3.0 * d + 4.0 * e, 2.0 * c + 6.0 * d + 12.0 * e];
            let over_s = |slope: f64, end: usize, [one, two, three]: [f64; 3]| {
                let (bend, third) = (bends[end], theta * (light_bends[end] - bends[end]));
                let turned = bend * one * one + slope * two;
                [slope * one, turned, third * one * one * one + 3.0 * bend * one * two + slope * three]
            };
            let first = over_s(-theta * ahead, 0, [a, b, 2.0 * c]);
            let last = over_s(slopes[1] / last[0], 1, last);
            let mut factors = between_ends([settled + ahead, end], first, last);
            factors[0] += drift;
            factors[1] += drift_per_step;
            factors
        });
        StepResponse {
            ahead,
            settled,
            course: [0, 1, 2, 3].map(|k| steps.course[k][n]),
            theta,
            pace,
            short,
            length_s: steps.length_s[n],
            end,
            slopes: slopes.map(|slope| slope + drift_per_step),
            drift,
            drift_per_step,
        }
    }

    /// Sigma, its slope and its curvature.
    #[inline(always)]
    fn sigma(&self, s: f64) -> (f64, f64, f64) {
        let [a, b, c, d, e] = self.pace;
        (
            s * (a + s
                * (b * (1.0 / 2.0) + s * (c * (1.0 / 3.0) + s * (d * (1.0 / 4.0) + s * e * (1.0 / 5.0))))),
            a + s * (b + s * (c + s * (d + s * e))),
            b + s * (2.0 * c + s * (3.0 * d + s * 4.0 * e)),
        )
    }

    #[inline(always)]
    fn at(&self, s: f64) -> Local {
        match &self.short {
            Some(factors) => polynomial(factors, s),
            None if self.is_constant() => {
                let left = self.ahead * elementary::exp(-self.theta * s);
                let slope = -self.theta * left;
                Local {
                    value: self.settled + left + (self.drift + self.drift_per_step * s),
                    slope: slope + self.drift_per_step,
                    bend: -self.theta * slope,
                }
            }
            None => self.in_closed_form(s),
        }
    }

    /// Constant light: the voltage is an exponential.
    #[inline(always)]
    fn is_constant(&self) -> bool {
        self.course[0] == 0.0 && self.course[1] == 0.0
    }

    fn in_closed_form(&self, s: f64) -> Local {
        let (sigma, pace, gain) = self.sigma(s);
        let weights = Weights::after_one(self.theta * sigma);
        let [first, second, third, fourth] = self.course;
        let [one, two, three, four] = weights.powers;
        let left = self.ahead * weights.kept;
        let voltage = self.settled
            + left
            + sigma
                * (first * one + sigma * (second * two + sigma * (third * three + sigma * fourth * four)));
        // The slope is the low-pass of the light's slope, and of the jump at the start; so is the curvature.
        let slope = first * weights.constant
            + sigma * (2.0 * second * one + sigma * (3.0 * third * two + sigma * 4.0 * fourth * three))
            - self.theta * left;
        let bend = 2.0 * second * weights.constant
            + sigma * (6.0 * third * one + sigma * 12.0 * fourth * two)
            + self.theta * weights.kept * (first + self.theta * self.ahead);
        Local {
            value: voltage + (self.drift + self.drift_per_step * s),
            slope: slope * pace + self.drift_per_step,
            bend: bend * (pace * pace) + slope * gain,
        }
    }

    /// About where the input is `level`: on the exponential of constant light; otherwise on the cubic with
    /// the same values and slopes at the step's ends, taken as `s` over value, or on a part of a step the
    /// straight line.
    fn guess(&self, level: f64, from: (f64, f64), to: (f64, f64)) -> f64 {
        let rise = to.1 - from.1;
        let share = ((level - from.1) / rise).clamp(0.0, 1.0);
        let straight = from.0 + (to.0 - from.0) * share;
        if self.is_constant() && self.ahead != 0.0 {
            // Without a leak this is exact.
            let left = (level - self.drift - self.drift_per_step * straight - self.settled) / self.ahead;
            let settling = -elementary::ln(left) / self.theta;
            return if settling > from.0 && settling < to.0 { settling } else { straight };
        }
        if from.0 > 0.0 || to.0 < 1.0 {
            return straight;
        }
        let (first, last) = (rise / self.slopes[0], rise / self.slopes[1]);
        let cubic = share + share * (1.0 - share) * ((first - 1.0) * (1.0 - share) - (last - 1.0) * share);
        if cubic > 0.0 && cubic < 1.0 { cubic } else { straight }
    }
}

/// The polynomial of seventh degree with these values and first three derivatives at 0 and 1.
#[inline(always)]
fn between_ends(values: [f64; 2], first: [f64; 3], last: [f64; 3]) -> [f64; 8] {
    let low = [values[0], first[0], 0.5 * first[1], first[2] * (1.0 / 6.0)];
    // What is left at 1 of the value and of the derivatives, each over its factorial.
    let value = values[1] - (low[0] + low[1] + low[2] + low[3]);
    let slope = last[0] - (low[1] + 2.0 * low[2] + 3.0 * low[3]);
    let bend = 0.5 * last[1] - (low[2] + 3.0 * low[3]);
    let third = last[2] * (1.0 / 6.0) - low[3];
    [
        low[0],
        low[1],
        low[2],
        low[3],
        35.0 * value - 15.0 * slope + 5.0 * bend - third,
        -84.0 * value + 39.0 * slope - 14.0 * bend + 3.0 * third,
        70.0 * value - 34.0 * slope + 13.0 * bend - 3.0 * third,
        -20.0 * value + 10.0 * slope - 4.0 * bend + third,
    ]
}

/// A polynomial of seventh degree, its slope and its second derivative at `s`.
#[inline(always)]
fn polynomial(factors: &[f64; 8], s: f64) -> Local {
    let [a, b, c, d, e, f, g, h] = *factors;
    let (s2, s4) = (s * s, (s * s) * (s * s));
    Local {
        value: ((a + b * s) + (c + d * s) * s2) + ((e + f * s) + (g + h * s) * s2) * s4,
        slope: ((b + 2.0 * c * s) + (3.0 * d + 4.0 * e * s) * s2)
            + ((5.0 * f + 6.0 * g * s) + 7.0 * h * s2) * s4,
        bend: ((2.0 * c + 6.0 * d * s) + (12.0 * e + 20.0 * f * s) * s2) + (30.0 * g + 42.0 * h * s) * s4,
    }
}

impl Response for StepResponse {
    fn value(&self, t_s: f64) -> f64 {
        if t_s <= 0.0 {
            self.settled + self.ahead + self.drift
        } else if t_s >= self.length_s {
            self.end + (self.drift + self.drift_per_step)
        } else {
            self.at(t_s / self.length_s).value
        }
    }

    /// The voltage runs after the light, which rises or falls all through the step: it turns at most once,
    /// where it meets the light. A drift moves that instant and is far too slow to add another.
    fn turning_points(&self, from_s: f64, to_s: f64) -> [Option<f64>; 2] {
        let (mut low, mut high) = (from_s / self.length_s, to_s / self.length_s);
        let first = if from_s <= 0.0 { self.slopes[0] } else { self.at(low).slope };
        let last = if to_s >= self.length_s { self.slopes[1] } else { self.at(high).slope };
        if first == 0.0 || last == 0.0 || (first > 0.0) == (last > 0.0) {
            return [None, None];
        }
        let mut turn = low + (high - low) * first / (first - last);
        for _ in 0..60 {
            let here = self.at(turn);
            if (here.slope > 0.0) == (first > 0.0) {
                low = turn
            } else {
                high = turn
            }
            let newton = turn - here.slope / here.bend;
            let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
            let moved = (next - turn).abs();
            turn = next;
            if moved < LAST_TURN {
                break;
            }
        }
        [Some((turn * self.length_s).clamp(from_s, to_s)), None]
    }

    /// Halley's method, kept inside what is known to hold the crossing.
    fn instant_of(&self, level: f64, from: (f64, f64), to: (f64, f64)) -> f64 {
        let (mut low, mut high) = (from.0 / self.length_s, to.0 / self.length_s);
        let rises = to.1 > from.1;
        let mut s = self.guess(level, (low, from.1), (high, to.1));
        if self.is_constant() && self.drift_per_step == 0.0 {
            return (s * self.length_s).clamp(from.0, to.0);
        }
        // Halving alone needs 50 rounds to the last bit.
        for _ in 0..60 {
            let here = self.at(s);
            let over = here.value - level;
            if over == 0.0 {
                break;
            }
            if (over > 0.0) == rises {
                high = s
            } else {
                low = s
            }
            let newton = over / here.slope;
            // Half of what the slope changes by over Newton's move, as a share of it.
            let bent = 0.5 * newton * here.bend / here.slope;
            let moved = if bent.abs() < 0.5 { newton / (1.0 - bent) } else { newton };
            let is_inside = s - moved > low && s - moved < high;
            let next = if is_inside { s - moved } else { 0.5 * (low + high) };
            let is_last =
                is_inside && moved.abs() < LAST_MOVE && bent.abs() < LAST_MOVE || high - low < 1e-15;
            s = next;
            if is_last {
                break;
            }
        }
        (s * self.length_s).clamp(from.0, to.0)
    }
}
