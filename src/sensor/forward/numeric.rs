//! The front end that has no closed form: second pole, exponential transistor, slew limits, high-pass.
//!
//! Three states in a cascade: the low-pass `v1`, the second pole `v2`, the level `h` that a high-pass
//! subtracts. They are stiff (microseconds and milliseconds), so the method is implicit: Rodas3, a Rosenbrock
//! method of order 3 that is L-stable and needs no iteration (Sandu et al., "Benchmarking stiff ODE solvers
//! II", 1997); the Jacobian is triangular. Steps are chosen so that the estimated error stays below a
//! tolerance, [`TOLERANCE`] unless a caller asks for less. Inside a step the state is the same method with a
//! shorter step, so a crossing time is as good as the integration itself, not as an interpolation.
//!
//! Limits: time constants below [`TAU_LEAST_S`] are taken as that; it is far below a stamp's resolution.

use super::response::Response;
use crate::effects::{Drive, FrontEndModel};

/// Error allowed per step, natural-log units. At a slope of 1 ln/s this moves a crossing by 0.1 us; the
/// solution carried on is one order better than the estimate.
pub const TOLERANCE: f64 = 1e-7;

/// The shortest time constant, seconds.
const TAU_LEAST_S: f64 = 1e-9;

/// Steps are not cut below this, seconds, whatever the error: a tenth of the clock's nanosecond.
const STEP_LEAST_S: f64 = 1e-10;

/// Crossings are solved to a hundredth of a nanosecond.
const RESOLUTION_S: f64 = 1e-11;

const GAMMA: f64 = 0.5;

/// The three states, natural-log units.
pub(super) type State = [f64; 3];

/// What light does at one instant.
#[derive(Clone, Copy, Debug)]
struct Drives {
    settled: f64,
    settled_per_s: f64,
    tau_s: f64,
    tau_rate: f64,
    tau_2_s: f64,
    tau_2_rate: f64,
}

/// The front end's equations under light that is linear in time: photocurrent `first + slope_per_s t`.
#[derive(Clone, Copy, Debug)]
pub(super) struct System<'a> {
    pub model: &'a FrontEndModel,
    pub first: f64,
    pub slope_per_s: f64,
    /// Error allowed per step, natural-log units.
    pub tolerance: f64,
}

/// Rates and the nonzero part of the Jacobian that depends on the state.
struct Rates {
    f: State,
    j11: f64,
    f1_t: f64,
}

impl System<'_> {
    fn drives(&self, t_s: f64) -> Drives {
        let i = self.first + self.slope_per_s * t_s;
        let low_pass = self.model.low_pass;
        let tau_s = f64::max(low_pass.tau_0_s + low_pass.alpha_s / i, TAU_LEAST_S);
        let per_light = -self.slope_per_s / (i * i);
        let (tau_2_s, tau_2_rate) = match self.model.second_pole {
            Some(pole) => {
                (f64::max(pole.tau_s + pole.tau_light_s / i, TAU_LEAST_S), pole.tau_light_s * per_light)
            }
            None => (1.0, 0.0),
        };
        Drives {
            settled: libm::log(i),
            settled_per_s: self.slope_per_s / i,
            tau_s,
            tau_rate: low_pass.alpha_s * per_light,
            tau_2_s,
            tau_2_rate,
        }
    }

    fn rates(&self, at: &Drives, y: &State) -> Rates {
        let lag = at.settled - y[0];
        let (answer, gain) = match self.model.drive {
            Drive::SmallSignal => (lag, 1.0),
            Drive::LargeSignal => (-libm::expm1(-lag), libm::exp(-lag)),
        };
        let (mut f1, mut j11) = (answer / at.tau_s, -gain / at.tau_s);
        let mut f1_t = (gain * at.settled_per_s - f1 * at.tau_rate) / at.tau_s;
        if f1 > self.model.slew_up_per_s || f1 < -self.model.slew_down_per_s {
            f1 = if f1 > 0.0 { self.model.slew_up_per_s } else { -self.model.slew_down_per_s };
            (j11, f1_t) = (0.0, 0.0);
        }
        let f2 = if self.model.second_pole.is_some() { (y[0] - y[1]) / at.tau_2_s } else { 0.0 };
        let f3 = (self.before_high_pass(y) - y[2]) / self.model.high_pass_s;
        Rates { f: [f1, f2, f3], j11, f1_t }
    }

    fn before_high_pass(&self, y: &State) -> f64 {
        if self.model.second_pole.is_some() { y[1] } else { y[0] }
    }

    /// What the comparator sees of a state or, as it is linear, of its rates.
    pub(super) fn output(&self, y: &State) -> f64 {
        if self.model.high_pass_s.is_finite() {
            self.before_high_pass(y) - y[2]
        } else {
            self.before_high_pass(y)
        }
    }

    /// The output's rate of change.
    fn output_rate(&self, t_s: f64, y: &State) -> f64 {
        self.output(&self.rates(&self.drives(t_s), y).f)
    }

    /// One step of Rodas3 from `t_s` over `h`: the new state and the estimated error.
    pub(super) fn step(&self, t_s: f64, y: &State, h: f64) -> (State, f64) {
        let (here, there) = (self.drives(t_s), self.drives(t_s + h));
        let start = self.rates(&here, y);
        let has_second = self.model.second_pole.is_some();
        // Jacobian rows: [j11, 0, 0], [1, -1, 0] / tau_2, [0, 1, -1] / tau_h (or [1, 0, -1] without a second
        // pole).
        let to_second = if has_second { 1.0 / here.tau_2_s } else { 0.0 };
        let to_level = 1.0 / self.model.high_pass_s;
        let diagonal = 1.0 / (h * GAMMA);
        let solve = |rhs: State| -> State {
            let k1 = rhs[0] / (diagonal - start.j11);
            let k2 = (rhs[1] + to_second * k1) / (diagonal + to_second);
            let k3 = (rhs[2] + to_level * if has_second { k2 } else { k1 }) / (diagonal + to_level);
            [k1, k2, k3]
        };
        let f2_t = if has_second { -start.f[1] * here.tau_2_rate / here.tau_2_s } else { 0.0 };
        let in_time = [h * start.f1_t, h * f2_t, 0.0];
        let of = |f: &State, terms: &[(f64, &State)]| -> State {
            std::array::from_fn(|n| f[n] + terms.iter().map(|(weight, k)| weight * k[n]).sum::<f64>())
        };
        let k1 = solve(of(&start.f, &[(0.5, &in_time)]));
        let k2 = solve(of(&start.f, &[(4.0 / h, &k1), (1.5, &in_time)]));
        let y3 = of(y, &[(2.0, &k1)]);
        let k3 = solve(of(&self.rates(&there, &y3).f, &[(1.0 / h, &k1), (-1.0 / h, &k2)]));
        let y4 = of(&y3, &[(1.0, &k3)]);
        let k4 =
            solve(of(&self.rates(&there, &y4).f, &[(1.0 / h, &k1), (-1.0 / h, &k2), (-8.0 / 3.0 / h, &k3)]));
        let error = k4.iter().fold(0.0, |most, k| f64::max(most, k.abs()));
        (of(&y4, &[(1.0, &k4)]), error)
    }

    /// A step from `t_s`, at most `most_s` long, whose error is within the tolerance; `guess_s` becomes the
    /// guess for the next one.
    pub(super) fn controlled_step(
        &self,
        t_s: f64,
        y: &State,
        most_s: f64,
        guess_s: &mut f64,
    ) -> (State, f64) {
        let mut h = f64::min(*guess_s, most_s);
        loop {
            let (end, error) = self.step(t_s, y, h);
            let factor =
                if error == 0.0 { 5.0 } else { (0.9 * libm::cbrt(self.tolerance / error)).clamp(0.2, 5.0) };
            if error <= self.tolerance || h <= STEP_LEAST_S {
                // A step cut short by the end of the light's piece says little about the next one.
                let was_cut_short = h < *guess_s;
                *guess_s = f64::max(h * factor, if was_cut_short { *guess_s } else { STEP_LEAST_S });
                return (end, h);
            }
            h = f64::max(h * factor, STEP_LEAST_S);
            *guess_s = h;
        }
    }
}

/// One accepted step.
pub(super) struct NumericResponse<'a> {
    system: System<'a>,
    t_s: f64,
    start: State,
    length_s: f64,
    drift: f64,
    drift_per_s: f64,
    /// Output and rate at both ends, drift included.
    ends: [(f64, f64); 2],
}

impl<'a> NumericResponse<'a> {
    /// The step of `system` from `start` at `t_s` to `end` over `length_s`, with the drift of the
    /// comparator's input.
    pub(super) fn new(
        system: System<'a>,
        t_s: f64,
        start: State,
        end: &State,
        length_s: f64,
        drift: f64,
        drift_per_s: f64,
    ) -> Self {
        let first = (system.output(&start) + drift, system.output_rate(t_s, &start) + drift_per_s);
        let last = (
            system.output(end) + drift + drift_per_s * length_s,
            system.output_rate(t_s + length_s, end) + drift_per_s,
        );
        NumericResponse { system, t_s, start, length_s, drift, drift_per_s, ends: [first, last] }
    }
}

impl Response for NumericResponse<'_> {
    fn value(&self, t_s: f64) -> f64 {
        let drift = self.drift + self.drift_per_s * t_s;
        if t_s <= 0.0 {
            self.ends[0].0
        } else {
            self.system.output(&self.system.step(self.t_s, &self.start, t_s).0) + drift
        }
    }

    /// The turning points of the cubic with the same values and slopes at the ends.
    fn turning_points(&self, from_s: f64, to_s: f64) -> [Option<f64>; 2] {
        let [(u0, r0), (u1, r1)] = self.ends;
        let h = self.length_s;
        // Slope of the cubic in s = t / h: a s^2 + b s + c.
        let (a, b, c) =
            (3.0 * (2.0 * (u0 - u1) + h * (r0 + r1)), 2.0 * (3.0 * (u1 - u0) - h * (2.0 * r0 + r1)), h * r0);
        let root = libm::sqrt(b * b - 4.0 * a * c);
        let q = -0.5 * (b + if b < 0.0 { -root } else { root });
        let inside = |s: f64| Some(s * h).filter(|&t_s| t_s > from_s && t_s < to_s);
        match (inside(q / a), inside(c / q)) {
            (Some(first), Some(second)) => [Some(f64::min(first, second)), Some(f64::max(first, second))],
            (first, second) => [first.or(second), None],
        }
    }

    /// The cubic lies within its control points.
    fn stays_within(&self, low: f64, high: f64) -> bool {
        let [(u0, r0), (u1, r1)] = self.ends;
        let third = self.length_s / 3.0;
        let margin = 10.0 * self.system.tolerance;
        [u0, u0 + r0 * third, u1 - r1 * third, u1].iter().all(|u| *u > low + margin && *u < high - margin)
    }

    fn resolution_s(&self) -> f64 {
        RESOLUTION_S
    }
}
