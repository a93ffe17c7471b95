//! The sensor forward: light on one pixel goes in, events and frame values come out.
//!
//! The chain is the one that the inverse model undoes: photocurrent, logarithm, low-pass, comparator, in-pixel stamp,
//! readout latency, off-pixel stamp, refractory period, new reference. In contrast to the inverse model nothing is
//! extrapolated: the voltage really moves while the pixel is blind, and the reference is taken at the end.
//!
//! Light is given at instants and is linear between them. Each piece is cut into steps; within a step `ln i` is
//! taken as linear and the time constant as that of the step's middle, so the voltage has a closed form (a ramp
//! response) and the instant of a crossing is solved for, not rounded to the step. Halving `max_step_ns` quarters the error.
//!
//! Source: Eqs. (1)-(5) and Section 3; `V_ref` is latched at `t_off + t_rp` ("resample" reset).
//! Limits: one pixel, so no queue on the readout bus; no shot noise. Noise enters as a threshold that varies per event.

use crate::comparator::fired_polarity;
use crate::front_end::{FrontEnd, settled_voltage, time_constant};
use photocurrent_core::Exposure;

/// Light on one pixel: photocurrent at instants, linear between them, constant before the first and after the last.
#[derive(Clone, Copy, Debug)]
pub struct LinearLight<'a> {
    t_ns: &'a [i64],
    photocurrent: &'a [f64],
}

impl<'a> LinearLight<'a> {
    /// Takes photocurrents (positive) at instants in nanoseconds.
    ///
    /// # Panics
    ///
    /// When the slices are empty or differ in length, the instants do not increase, or a photocurrent is not positive
    /// and finite: its logarithm is needed everywhere.
    pub fn new(t_ns: &'a [i64], photocurrent: &'a [f64]) -> Self {
        assert!(!t_ns.is_empty() && t_ns.len() == photocurrent.len(), "light has one photocurrent per instant");
        assert!(t_ns.is_sorted_by(|before, after| before < after), "instants of light increase");
        assert!(photocurrent.iter().all(|&i| i > 0.0 && i.is_finite()), "photocurrent is positive and finite");
        LinearLight { t_ns, photocurrent }
    }

    /// The photocurrent at `t_ns`.
    pub fn at(&self, t_ns: i64) -> f64 {
        let after = self.t_ns.partition_point(|&instant| instant <= t_ns);
        match (after.checked_sub(1), self.t_ns.get(after)) {
            (None, _) => self.photocurrent[0],
            (Some(last), None) => self.photocurrent[last],
            (Some(before), Some(&next)) => {
                let share = (t_ns - self.t_ns[before]) as f64 / (next - self.t_ns[before]) as f64;
                self.photocurrent[before] * (1.0 - share) + self.photocurrent[after] * share
            }
        }
    }

    /// The exact integral over `exposure`, in photocurrent times seconds: Eq. (5) without its gain.
    pub fn integral(&self, exposure: Exposure) -> f64 {
        let mut sum = 0.0;
        let mut from = exposure.start.0;
        while from < exposure.end.0 {
            let after = self.t_ns.partition_point(|&instant| instant <= from);
            let to = self.t_ns.get(after).copied().unwrap_or(i64::MAX).min(exposure.end.0);
            sum += 0.5 * (self.at(from) + self.at(to)) * (to - from) as f64;
            from = to;
        }
        sum / 1e9
    }
}

/// What the simulated pixel is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pixel {
    /// The low-pass of Eq. (3).
    pub front_end: FrontEnd,
    /// Contrast threshold of an ON event, positive, natural-log units.
    pub threshold_on: f64,
    /// Contrast threshold of an OFF event, positive, natural-log units.
    pub threshold_off: f64,
    /// The part of the readout latency that is always there, nanoseconds, not negative.
    pub latency_ns: i64,
    /// Mean of the exponentially distributed part of the readout latency, nanoseconds, not negative.
    pub latency_spread_ns: f64,
    /// Refractory period after `t_off`, nanoseconds, not negative.
    pub refractory_ns: i64,
    /// Longest step of the low-pass, nanoseconds, positive; a small part of the shortest time of interest.
    pub max_step_ns: i64,
}

/// An event as the simulated pixel puts it out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelEvent {
    /// In-pixel time: when the comparator fired.
    pub t_in_ns: i64,
    /// Off-pixel time: when the event left the pixel array.
    pub t_off_ns: i64,
    /// +1 for ON, -1 for OFF.
    pub polarity: i8,
}

/// Where the simulated pixel gets its randomness from; the methods' defaults are "none".
pub trait PixelNoise {
    /// A number of [0, 1) for the next readout latency. Zero gives the constant latency alone.
    fn uniform(&mut self) -> f64 {
        0.0
    }

    /// Added to both thresholds from one event to the next, natural-log units.
    fn threshold_offset(&mut self) -> f64 {
        0.0
    }
}

/// A pixel without noise.
#[derive(Clone, Copy, Debug, Default)]
pub struct Noiseless;

impl PixelNoise for Noiseless {}

/// A threshold never falls below this, whatever noise is added: at zero a pixel would fire without end.
const THRESHOLD_FLOOR: f64 = 1e-6;

/// The events of one pixel from `start_ns` to `end_ns`, in time order.
///
/// The pixel starts settled (Eq. 6), armed, and with the reference at its voltage. Events whose `t_in` lies in the
/// span are put out even when their `t_off` does not.
///
/// # Panics
///
/// When `max_step_ns` is not positive.
pub fn simulate_events(pixel: &Pixel, light: &LinearLight<'_>, start_ns: i64, end_ns: i64, noise: &mut impl PixelNoise) -> Vec<PixelEvent> {
    assert!(pixel.max_step_ns > 0, "the step of the simulation is positive");
    let start_voltage = settled_voltage(light.at(start_ns));
    let mut state =
        State { voltage: start_voltage, reference: start_voltage, threshold_offset: noise.threshold_offset(), blind_until_ns: None, events: Vec::new() };
    let mut from = start_ns;
    while from < end_ns {
        let after = light.t_ns.partition_point(|&instant| instant <= from);
        let piece_end = light.t_ns.get(after).copied().unwrap_or(i64::MAX).min(end_ns);
        let to = piece_end.min(from.saturating_add(pixel.max_step_ns));
        state.advance(pixel, light, from, to, noise);
        from = to;
    }
    state.events
}

struct State {
    voltage: f64,
    reference: f64,
    threshold_offset: f64,
    blind_until_ns: Option<i64>,
    events: Vec<PixelEvent>,
}

impl State {
    /// One step of the low-pass, with as many events as fit in it.
    fn advance(&mut self, pixel: &Pixel, light: &LinearLight<'_>, from_ns: i64, to_ns: i64, noise: &mut impl PixelNoise) {
        let length_s = (to_ns - from_ns) as f64 / 1e9;
        let (first, last) = (light.at(from_ns), light.at(to_ns));
        let response = RampResponse::new(&pixel.front_end, self.voltage, first, last, length_s);
        let mut now_s = 0.0;
        loop {
            if let Some(until_ns) = self.blind_until_ns {
                if until_ns > to_ns {
                    break;
                }
                // Latched at a whole nanosecond, which can lie a fraction of one before `now`.
                now_s = f64::max(now_s, (until_ns - from_ns) as f64 / 1e9);
                self.reference = response.voltage(now_s);
                self.blind_until_ns = None;
            }
            let on = f64::max(pixel.threshold_on + self.threshold_offset, THRESHOLD_FLOOR);
            let off = f64::max(pixel.threshold_off + self.threshold_offset, THRESHOLD_FLOOR);
            let Some((fired_s, polarity)) = response.first_crossing(now_s, self.reference, on, off) else {
                break;
            };
            now_s = fired_s;
            let t_in_ns = from_ns + (fired_s * 1e9).round() as i64;
            let spread_ns = -pixel.latency_spread_ns * libm::log1p(-noise.uniform());
            let t_off_ns = t_in_ns + pixel.latency_ns + spread_ns.round() as i64;
            self.events.push(PixelEvent { t_in_ns, t_off_ns, polarity });
            self.threshold_offset = noise.threshold_offset();
            if t_off_ns + pixel.refractory_ns > t_in_ns {
                self.blind_until_ns = Some(t_off_ns + pixel.refractory_ns);
            } else {
                // Without blind time the reference is the threshold itself: no error adds up from rounded stamps.
                self.reference += if polarity > 0 { on } else { -off };
            }
        }
        self.voltage = response.voltage(length_s);
    }
}

/// The front-end voltage over one step: a low-pass driven by a ramp.
struct RampResponse {
    start: f64,
    settled: f64,
    slope: f64,
    tau_s: f64,
    length_s: f64,
}

impl RampResponse {
    fn new(front_end: &FrontEnd, voltage: f64, first: f64, last: f64, length_s: f64) -> Self {
        let settled = settled_voltage(first);
        let slope = (settled_voltage(last) - settled) / length_s;
        let tau_s = time_constant(front_end, 0.5 * (first + last));
        RampResponse { start: voltage, settled, slope, tau_s, length_s }
    }

    /// `V(t) = L(t) - m tau + (V0 - L0 + m tau) exp(-t / tau)` for `dV/dt = (L - V) / tau` and `L = L0 + m t`.
    fn voltage(&self, t_s: f64) -> f64 {
        let ramp = self.settled + self.slope * t_s;
        if self.tau_s == 0.0 {
            return ramp;
        }
        let lag = self.slope * self.tau_s;
        ramp - lag + (self.start - self.settled + lag) * libm::exp(-t_s / self.tau_s)
    }

    /// The first instant from `from_s` to the step's end at which a threshold is crossed, and the polarity.
    fn first_crossing(&self, from_s: f64, reference: f64, on: f64, off: f64) -> Option<(f64, i8)> {
        let mut piece_start = from_s;
        // Between its ends and its one possible turning point the voltage is monotone: a crossing shows at the end.
        for piece_end in [self.turning_point(from_s), Some(self.length_s)].into_iter().flatten() {
            if let Some(polarity) = fired_polarity(self.voltage(piece_end), reference, on, off) {
                let level = reference + if polarity > 0 { on } else { -off };
                return Some((self.instant_of(level, piece_start, piece_end), polarity));
            }
            piece_start = piece_end;
        }
        None
    }

    /// Where the voltage turns round after `from_s` and inside the step, if it does: V' = m - (A / tau) exp(-t / tau) = 0.
    fn turning_point(&self, from_s: f64) -> Option<f64> {
        let lag = self.slope * self.tau_s;
        let ratio = (self.start - self.settled + lag) / lag;
        let at_s = self.tau_s * libm::log(ratio);
        (at_s > from_s && at_s < self.length_s).then_some(at_s)
    }

    /// Solves V(t) = level on a monotone piece by bisection, to the last bit.
    fn instant_of(&self, level: f64, from_s: f64, to_s: f64) -> f64 {
        let rises = self.voltage(to_s) >= self.voltage(from_s);
        let (mut low, mut high) = (from_s, to_s);
        loop {
            let middle = 0.5 * (low + high);
            if !(middle > low && middle < high) {
                return high;
            }
            let is_past = if rises { self.voltage(middle) >= level } else { self.voltage(middle) <= level };
            if is_past {
                high = middle;
            } else {
                low = middle;
            }
        }
    }
}

#[cfg(test)]
#[path = "forward_tests.rs"]
mod tests;
