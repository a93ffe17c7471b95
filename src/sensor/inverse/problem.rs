//! What one pixel's inverse problem consists of, and what makes it ill posed.

use crate::front_end::{FrontEnd, TauRule};
use crate::misfit::Misfit;

/// Smallest natural log of photocurrent that a solution may hold: 4e-18, dark for any unit in use.
pub const LOG_PHOTOCURRENT_MIN: f64 = -40.0;
/// Largest natural log of photocurrent that a solution may hold: 2e17, where squares still stay finite.
pub const LOG_PHOTOCURRENT_MAX: f64 = 40.0;

/// One frame's measurement at this pixel: a CIS row of Eq. (13).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameSample {
    /// Start of this row's exposure, seconds on the clock of the knots.
    pub start_s: f64,
    /// End of this row's exposure, after its start.
    pub end_s: f64,
    /// The measured digital number, black level included.
    pub dn: f64,
    /// The diagonal element of Omega_CIS: one over the variance of `dn`; the paper sets 1. Positive.
    pub weight: f64,
}

/// Everything measured and known about one pixel: Eqs. (1)-(8) with the cost of Eq. (13).
///
/// Unknown is `u_k = ln i_pd(k)` at each knot; the photocurrent holds from a knot to the next, `i(1)` before
/// the first and `i(N)` after the last. The cost, without a factor 1/2, is `evs_weight * sum_k (steps[k] -
/// (V(k) - V(k-1)))^2 + sum_l weight_l (dn_l - DN_l)^2`.
///
/// Times are `f64` seconds. A caller with nanosecond stamps subtracts an origin near the pixel's data first
/// (the first exposure's start, say) so that differences stay exact to far below a nanosecond.
///
/// The first knot has no EVS row: there `V = V_DC`, Eq. (6). In the paper it is the first event, whose own
/// step is then unused. A caller who puts an extra knot at the first exposure's start keeps that step as
/// well, and gets exactly the event-based double integral when the front end is ideal and one frame is given.
#[derive(Clone, Copy, Debug)]
pub struct PixelProblem<'a> {
    /// Knot times, seconds, strictly increasing. Empty means no event: one knot is then understood.
    pub t_s: &'a [f64],
    /// Signed log step measured from knot `k - 1` to knot `k` (plain, or compensated by
    /// [`crate::readout::compensated_step`]); as long as `t_s`. The first one is never read.
    pub steps: &'a [f64],
    /// The frame samples, at least one, in any order.
    pub frames: &'a [FrameSample],
    /// The diagonal of Omega_EVS: one over the variance of a step; the paper sets 1. Positive.
    pub evs_weight: f64,
    /// The low-pass of Eq. (3).
    pub front_end: FrontEnd,
    /// Which photocurrent sets an interval's time constant.
    pub tau_rule: TauRule,
    /// DN of a dark exposure.
    pub black_level: f64,
    /// DN per photocurrent and second, the G of Eq. (5). Positive.
    pub gain: f64,
}

/// Why a pixel's problem cannot be posed. The index counts from 0 in the slice that is named.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ProblemError {
    /// Events alone fix only ratios of photocurrent, never its level.
    #[error(
        "no frame sample: events alone leave the photocurrent's level open; give at least one exposure \
             of this pixel"
    )]
    NoFrames,
    /// `t_s` and `steps` are columns of one list.
    #[error("{knots} knot times but {steps} steps; give one signed step per knot (the first is not read)")]
    LengthMismatch {
        /// Length of `t_s`.
        knots: usize,
        /// Length of `steps`.
        steps: usize,
    },
    /// A NaN or an infinity.
    #[error("{quantity}[{index}] is not a finite number; drop or repair the sample before solving")]
    NonFinite {
        /// The field, as in [`PixelProblem`].
        quantity: &'static str,
        /// Its position; 0 for a single number.
        index: usize,
    },
    /// A weight or the gain is zero or negative, or a front-end parameter is negative.
    #[error("{quantity}[{index}] is {value}, which is out of range; {expected}")]
    OutOfRange {
        /// The field, as in [`PixelProblem`].
        quantity: &'static str,
        /// Its position; 0 for a single number.
        index: usize,
        /// What was given.
        value: f64,
        /// What would be right.
        expected: &'static str,
    },
    /// Two knots at one instant, or out of order.
    #[error(
        "t_s[{index}] does not come after the knot before it; sort the events and merge equal stamps by \
             adding their steps"
    )]
    KnotsNotIncreasing {
        /// The later of the two.
        index: usize,
    },
    /// An exposure without duration.
    #[error("frames[{index}] ends no later than it starts; check exposure time and row time")]
    EmptyExposure {
        /// Position in `frames`.
        index: usize,
    },
}

impl PixelProblem<'_> {
    /// The misfit whose EVS rows cost `evs_cost` and whose CIS rows cost `cis_cost`.
    pub(super) fn misfit(&self, evs_cost: f64, cis_cost: f64) -> Misfit {
        Misfit {
            event_square: evs_cost,
            events: self.t_s.len().saturating_sub(1),
            frame_square: cis_cost,
            frames: self.frames.len(),
        }
    }

    /// Checks every promise of the fields; the first broken one is returned.
    pub fn check(&self) -> Result<(), ProblemError> {
        if self.frames.is_empty() {
            return Err(ProblemError::NoFrames);
        }
        if self.t_s.len() != self.steps.len() {
            return Err(ProblemError::LengthMismatch { knots: self.t_s.len(), steps: self.steps.len() });
        }
        self.check_finite()?;
        self.check_ranges()?;
        if let Some(k) = (1..self.t_s.len()).find(|&k| self.t_s[k] <= self.t_s[k - 1]) {
            return Err(ProblemError::KnotsNotIncreasing { index: k });
        }
        match self.frames.iter().position(|frame| frame.end_s <= frame.start_s) {
            Some(index) => Err(ProblemError::EmptyExposure { index }),
            None => Ok(()),
        }
    }

    fn check_finite(&self) -> Result<(), ProblemError> {
        let finite = |quantity, index, value: f64| {
            if value.is_finite() { Ok(()) } else { Err(ProblemError::NonFinite { quantity, index }) }
        };
        for (index, &t) in self.t_s.iter().enumerate() {
            finite("t_s", index, t)?;
        }
        for (index, &step) in self.steps.iter().enumerate().skip(1) {
            finite("steps", index, step)?;
        }
        for (index, frame) in self.frames.iter().enumerate() {
            finite("frames.start_s", index, frame.start_s)?;
            finite("frames.end_s", index, frame.end_s)?;
            finite("frames.dn", index, frame.dn)?;
            finite("frames.weight", index, frame.weight)?;
        }
        finite("evs_weight", 0, self.evs_weight)?;
        finite("front_end.tau_0_s", 0, self.front_end.tau_0_s)?;
        finite("front_end.alpha_s", 0, self.front_end.alpha_s)?;
        finite("black_level", 0, self.black_level)?;
        finite("gain", 0, self.gain)
    }

    fn check_ranges(&self) -> Result<(), ProblemError> {
        let refuse = |quantity, index, value, expected| {
            Err(ProblemError::OutOfRange { quantity, index, value, expected })
        };
        for (index, frame) in self.frames.iter().enumerate() {
            if frame.weight <= 0.0 {
                return refuse("frames.weight", index, frame.weight, "leave an untrusted frame out instead");
            }
        }
        if self.evs_weight <= 0.0 {
            return refuse("evs_weight", 0, self.evs_weight, "pass no knots to ignore the events");
        }
        if self.gain <= 0.0 {
            return refuse("gain", 0, self.gain, "the gain of Eq. (5) is positive");
        }
        if self.front_end.tau_0_s < 0.0 {
            return refuse("front_end.tau_0_s", 0, self.front_end.tau_0_s, "0 is the ideal front end");
        }
        if self.front_end.alpha_s < 0.0 {
            return refuse("front_end.alpha_s", 0, self.front_end.alpha_s, "0 is the ideal front end");
        }
        Ok(())
    }
}

/// Where the iteration starts.
#[derive(Clone, Copy, Debug, Default)]
pub enum Start<'a> {
    /// From the frames, as in the paper: the measured steps, at the level that fits the digital numbers best.
    #[default]
    FromFrames,
    /// From a given log photocurrent per knot: a previous solution, or a test of the minimum's basin.
    /// Not used for a pixel without events, which has a closed form.
    LogPhotocurrent(&'a [f64]),
}

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolveOptions {
    /// Most steps tried before the pixel counts as not converged. Bright pixels need 4 to 8, dim ones 15.
    pub max_iterations: usize,
    /// Converged when an undamped step moves no log photocurrent by more than this (natural-log units).
    ///
    /// Convergence is linear, as a rule with a factor near 1/20, so what is left is far smaller than the last
    /// step. A step norm rather than a cost decrease: the decrease drowns in rounding first, above all in
    /// `f32`.
    pub step_tolerance: f64,
}

impl Default for SolveOptions {
    fn default() -> Self {
        SolveOptions { max_iterations: 100, step_tolerance: 1e-6 }
    }
}

/// How a solution came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Outcome {
    /// A minimum of the cost, or the closed form of a pixel without events.
    Converged,
    /// The iteration did not reach a minimum; this is the double-integral estimate instead: the measured
    /// steps through an ideal front end, at the level that fits the digital numbers best (an event-based
    /// double integral). A pixel whose frames lie at or below the black level has no photocurrent to fit: it
    /// comes out as [`LOG_PHOTOCURRENT_MIN`] everywhere.
    FellBack,
}

/// One pixel's result, borrowed from the workspace that computed it.
#[derive(Clone, Copy, Debug)]
pub struct Solution<'w> {
    /// `ln i_pd` per knot; one element for a pixel without events.
    pub log_photocurrent: &'w [f64],
    /// `V_FE` per knot, natural-log units.
    pub front_end_voltage: &'w [f64],
    /// Predicted digital number per frame sample.
    pub dn: &'w [f64],
    /// The cost of Eq. (13). For a double-integral estimate, that of the ideal front end (its EVS rows are
    /// then met exactly).
    pub cost: f64,
    /// The same in two parts: EVS rows as events, CIS rows as frames, each times its weight.
    pub misfit: Misfit,
    /// Accepted and refused steps tried, over all damping values.
    pub iterations: usize,
    /// Whether this is a minimum or the double-integral estimate.
    pub outcome: Outcome,
}

impl Solution<'_> {
    /// Whether the iteration reached a minimum (the opposite: this is the double-integral estimate).
    pub fn has_converged(&self) -> bool {
        self.outcome == Outcome::Converged
    }
}
