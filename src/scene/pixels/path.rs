//! The Jacobian of one pixel's measurements by the coefficients of its light, a spline in time.
//!
//! Log light is a cubic B-spline that is evaluated at steady instants, linear between these. The voltage
//! follows it through the low-pass (Eqs. 1 to 3) with the time constant of each step's middle. Its derivative
//! is computed backwards from an instant until the low-pass has forgotten, with the time constant fixed.

use crate::picture::spline::{ORDER, weights};
use photocurrent_sensor::elementary::exp;
use photocurrent_sensor::front_end::FrontEnd;

/// Weight below which a derivative through the low-pass is neglected.
const FORGOTTEN: f64 = 1e-7;
/// Shorter time constants are this, seconds.
const TAU_LEAST_S: f64 = 1e-9;

/// Uniform cubic B-splines of time, at steady instants.
#[derive(Clone, Debug)]
pub(super) struct TimeSplines {
    /// The first instant, ns.
    pub start_ns: i64,
    /// Time between instants, ns.
    pub step_ns: i64,
    /// Number of instants.
    pub instants: usize,
    /// Weights of the four coefficients at each instant between two knots.
    of_phase: Vec<[f64; ORDER]>,
}

impl TimeSplines {
    /// With a knot every `per_knot` instants.
    pub(super) fn new(start_ns: i64, step_ns: i64, instants: usize, per_knot: usize) -> TimeSplines {
        let of_phase = (0..per_knot).map(|phase| weights(phase as f64 / per_knot as f64)).collect();
        TimeSplines { start_ns, step_ns, instants, of_phase }
    }

    /// Instants from knot to knot.
    pub(super) fn per_knot(&self) -> usize {
        self.of_phase.len()
    }

    /// Number of coefficients.
    pub(super) fn coefficients(&self) -> usize {
        (self.instants - 1) / self.per_knot() + ORDER
    }

    /// The instant at which a coefficient weighs most, ns from the first one; may lie outside.
    pub(super) fn middle_ns(&self, coefficient: usize) -> i64 {
        (coefficient as i64 - 1) * self.per_knot() as i64 * self.step_ns
    }

    /// Values at all instants.
    pub(super) fn values(&self, coefficients: &[f64], out: &mut Vec<f64>) {
        let per_knot = self.per_knot();
        out.clear();
        out.extend((0..self.instants).map(|k| {
            let four = &coefficients[k / per_knot..k / per_knot + ORDER];
            self.of_phase[k % per_knot].iter().zip(four).map(|(w, c)| w * c).sum::<f64>()
        }));
    }

    /// Derivatives by the coefficients out of those by the values from instant `low` to `high`, which are
    /// taken and left zero. `row` begins at coefficient `from`.
    fn gather(&self, by_value: &mut [f64], (low, high): (usize, usize), from: usize, row: &mut [f64]) {
        let per_knot = self.per_knot();
        for k in low..=high {
            let by = std::mem::take(&mut by_value[k]);
            let to = &mut row[k / per_knot - from..k / per_knot - from + ORDER];
            to.iter_mut().zip(&self.of_phase[k % per_knot]).for_each(|(to, w)| *to += by * w);
        }
    }

    /// The first coefficient of an instant, and the one behind its last.
    fn span(&self, low: usize, high: usize) -> (usize, usize) {
        (low / self.per_knot(), high / self.per_knot() + ORDER)
    }

    /// Place of an instant: the number of the step, below the last, and the share of it.
    fn knot_place(&self, t_ns: i64) -> (usize, f64) {
        let last = (self.instants - 1) as f64;
        let place = ((t_ns - self.start_ns) as f64 / self.step_ns as f64).clamp(0.0, last);
        let k = (place as usize).min(self.instants - 2);
        (k, place - k as f64)
    }
}

/// Rows of a Jacobian, one after another: each begins at a coefficient.
#[derive(Clone, Debug, Default)]
pub(super) struct JacobianRows {
    /// The first coefficient of each.
    pub from: Vec<usize>,
    start: Vec<usize>,
    values: Vec<f64>,
}

impl JacobianRows {
    pub(super) fn clear(&mut self) {
        self.from.clear();
        self.start.clear();
        self.values.clear();
    }

    pub(super) fn len(&self) -> usize {
        self.from.len()
    }

    pub(super) fn row(&self, row: usize) -> &[f64] {
        let end = self.start.get(row + 1).copied().unwrap_or(self.values.len());
        &self.values[self.start[row]..end]
    }

    /// A new row of zeros, to be filled.
    fn push(&mut self, (from, behind): (usize, usize)) -> &mut [f64] {
        let start = self.values.len();
        self.from.push(from);
        self.start.push(start);
        self.values.resize(start + behind - from, 0.0);
        &mut self.values[start..]
    }
}

/// The light of one pixel and the low-pass on its way through it.
#[derive(Clone, Debug, Default)]
pub(super) struct PixelPath {
    /// Log light at the instants.
    pub log: Vec<f64>,
    light: Vec<f64>,
    low_pass: FrontEnd,
    /// Of each step: the share of the voltage that is kept, and the lag over a ramp in units of the step.
    kept: Vec<f64>,
    lag: Vec<f64>,
    /// Room, zero between calls.
    by_value: Vec<f64>,
}

impl PixelPath {
    /// Sets `log` as the log light.
    pub(super) fn set_log_light(&mut self, splines: &TimeSplines, low_pass: FrontEnd) {
        self.low_pass = low_pass;
        self.light.clear();
        self.light.extend(self.log.iter().map(|u| exp(*u)));
        let step_s = splines.step_ns as f64 * 1e-9;
        self.kept.clear();
        self.lag.clear();
        for pair in self.log.windows(2) {
            let (kept, lag) = low_pass_over(low_pass, (pair[0], pair[1]), step_s);
            self.kept.push(kept);
            self.lag.push(lag);
        }
        self.by_value.resize(splines.instants, 0.0);
    }

    /// Adds `sign` times the derivative of the voltage at an instant by the values; returns the first and the
    /// last value with a derivative.
    fn voltage(&mut self, splines: &TimeSplines, t_ns: i64, sign: f64) -> (usize, usize) {
        let (k, share) = splines.knot_place(t_ns);
        let by = &mut self.by_value;
        let (mut left, mut high) = (sign, k);
        if share > 0.0 {
            let there = self.log[k] + (self.log[k + 1] - self.log[k]) * share;
            let seconds = share * splines.step_ns as f64 * 1e-9;
            let (kept, lag) = low_pass_over(self.low_pass, (self.log[k], there), seconds);
            by[k] += sign * ((1.0 - lag) * (1.0 - share) + lag - kept);
            by[k + 1] += sign * (1.0 - lag) * share;
            left = sign * kept;
            high = k + 1;
        }
        let mut low = k;
        while low > 0 && left.abs() > FORGOTTEN {
            let (kept, lag) = (self.kept[low - 1], self.lag[low - 1]);
            by[low] += left * (1.0 - lag);
            by[low - 1] += left * (lag - kept);
            left *= kept;
            low -= 1;
        }
        by[low] += left;
        (low, high)
    }

    /// The row of the voltage at an instant less that at an earlier one.
    pub(super) fn push_difference(
        &mut self,
        splines: &TimeSplines,
        [t_ns, before_ns]: [i64; 2],
        rows: &mut JacobianRows,
    ) {
        let (low, high) = self.voltage(splines, t_ns, 1.0);
        let (low_before, high_before) = self.voltage(splines, before_ns, -1.0);
        let (low, high) = (low.min(low_before), high.max(high_before));
        let span = splines.span(low, high);
        let row = rows.push(span);
        splines.gather(&mut self.by_value, (low, high), span.0, row);
    }

    /// The row of a frame value, DN: the light that an exposure collects, times `gain`.
    pub(super) fn push_exposure(
        &mut self,
        splines: &TimeSplines,
        [start_ns, end_ns]: [i64; 2],
        gain: f64,
        rows: &mut JacobianRows,
    ) {
        let place = |t_ns: i64| {
            let (k, share) = splines.knot_place(t_ns);
            k as f64 + share
        };
        let (begin, end) = (place(start_ns), place(end_ns));
        let (low, high) = (begin as usize, (end.ceil() as usize).min(splines.instants - 1));
        let scale = gain * splines.step_ns as f64 * 1e-9;
        for k in low..high {
            let (a, b) = (f64::max(begin, k as f64) - k as f64, f64::min(end, (k + 1) as f64) - k as f64);
            let of_next = 0.5 * (b * b - a * a);
            self.by_value[k] += scale * (b - a - of_next) * self.light[k];
            self.by_value[k + 1] += scale * of_next * self.light[k + 1];
        }
        let span = splines.span(low, high);
        let row = rows.push(span);
        splines.gather(&mut self.by_value, (low, high), span.0, row);
    }
}

/// The share of the voltage that the low-pass keeps over a piece of light from one log value to another, and
/// its lag behind a ramp in units of the piece.
fn low_pass_over(low_pass: FrontEnd, (from, to): (f64, f64), seconds: f64) -> (f64, f64) {
    let tau_s = f64::max(low_pass.tau_0_s + low_pass.alpha_s * exp(-0.5 * (from + to)), TAU_LEAST_S);
    let kept = exp(-seconds / tau_s);
    (kept, tau_s / seconds * (1.0 - kept))
}
