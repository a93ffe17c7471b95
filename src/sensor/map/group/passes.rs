//! The two passes of [`super::super::smoother`] for eight pixels in step: exact thresholds, so five states.
//!
//! Pixels do different things at the same step, so every step does everything, and lanes choose: a measurement that a lane does not have weighs
//! nothing there and leaves its numbers as they are, to the last bit.

use super::super::chain::Slopes;
use super::super::state::{ON, R, S, State, Transition, U, V, Weight, each_state};
use super::stream::{EVENT, EXPOSE, FRAME, LATCH, LIGHT, SEGMENT};
use crate::scalar::Scalar;
use crate::wide::{Flags, WIDTH, Wide};
use multiversion::multiversion;

/// How many states.
const STATES: usize = ON;

/// One step at given unknowns: the segment that ends there, and what is measured there, linearised.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Line {
    pub slopes: Slopes<Wide>,
    /// What counts there: [`EVENT`], [`FRAME`], [`LIGHT`], `SILENCE` or nothing.
    pub sight: Flags,
    pub residual: Wide,
    pub variance: Wide,
}

/// The prior of the segment that ends at a step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Expected {
    pub correlation: Wide,
    /// 0 at steps without a segment.
    pub fresh: Wide,
    pub per_fresh: Wide,
    pub scale: Wide,
    pub per_scale: Wide,
    /// z less what the z before lets expect.
    pub surprise: Wide,
}

/// What the backward pass needs of a step of the forward one.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Kept {
    gain: [Wide; STATES],
    pull: Wide,
    /// Filtered change and the covariance's row of log light.
    change: Wide,
    row: [Wide; STATES],
}

/// The same of a damping.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Damped {
    gain: [Wide; STATES],
    pull: Wide,
}

/// What the passes are asked for.
pub(super) struct Ask<'a> {
    pub lines: &'a [Line],
    pub expected: &'a [Expected],
    /// What is at each step.
    pub what: &'a [Flags],
    /// What is seen as an event: with `SILENCE` in lanes where that counts.
    pub events: Flags,
    /// Levenberg's damping of each lane; 0 for none.
    pub damping: Wide,
    /// The first change that the prior expects, and the first reference's offset.
    pub first: Wide,
    pub offset: Wide,
    pub first_variance: f64,
    pub reference_variance: Wide,
}

/// Sums that make the evidence.
#[derive(Clone, Copy, Debug)]
pub(super) struct Evidence {
    /// Mantissa and exponent of the product of all information.
    mantissa: Wide,
    exponent: Wide,
    squares: Wide,
    count: Wide,
}

impl Evidence {
    /// Log of the marginal likelihood of a lane's measurements.
    pub fn log(&self, lane: usize) -> f64 {
        const LOG_TWO_PI: f64 = 1.837_877_066_409_345_3;
        let log_information = libm::log(self.mantissa.0[lane]) + self.exponent.0[lane] * std::f64::consts::LN_2;
        -0.5 * (self.count.0[lane] * LOG_TWO_PI - log_information + self.squares.0[lane])
    }

    #[inline(always)]
    fn add(&mut self, counts: Wide, innovation: Wide, weight: &Weight<Wide, STATES>) {
        self.count = self.count + counts;
        self.squares = self.squares + counts.equal(1.0, innovation * weight.pull, Wide::ZERO);
        let product = self.mantissa * counts.equal(1.0, weight.information, Wide::ONE);
        let (exponent, mantissa) = product.parts();
        self.exponent = self.exponent + exponent;
        self.mantissa = mantissa;
    }
}

/// What is known of the first step before any measurement, as in the solver of one pixel.
#[inline(always)]
fn begin(ask: &Ask<'_>) -> State<Wide, STATES> {
    let mut state = State::new();
    (state.x[U], state.x[V], state.x[R]) = (ask.first, ask.first, ask.first - ask.offset);
    for (a, b) in [(U, U), (U, V), (U, R), (V, V), (V, R), (R, R)] {
        state.p[a][b] = Wide::splat(ask.first_variance);
    }
    state.p[R][R] = state.p[R][R] + ask.reference_variance;
    state.p[1][1] = Wide::ONE;
    state
}

#[inline(always)]
fn forward<const DAMPED: bool, const KEEP: bool, const EVIDENCE: bool>(ask: &Ask<'_>, kept: &mut [Kept], dampings: &mut [Damped], evidence: &mut Evidence) {
    let mut state = begin(ask);
    let steps = ask.lines.len();
    let (lines, expected, what) = (&ask.lines[..steps], &ask.expected[..steps], &ask.what[..steps]);
    for j in 0..steps {
        let line = &lines[j];
        // Nothing moves before the first step: its segment keeps all as it is.
        let prior = &expected[j];
        state.predict(&Transition::new(prior.correlation, prior.scale, &line.slopes), prior.fresh, -prior.surprise);
        let choose = |event: Wide, frame: Wide, light: Wide| {
            let rest = line.sight.choose(FRAME, frame, line.sight.choose(LIGHT, light, Wide::ZERO));
            line.sight.any(ask.events, event, rest)
        };
        let mut cross = [Wide::ZERO; STATES];
        each_state!(a in 0, STATES => cross[a] = choose(state.at(a, V) - state.at(a, R), state.at(a, S), state.at(a, U)));
        let spread = choose(cross[V] - cross[R], cross[S], cross[U]) + line.variance;
        let innovation = choose(line.residual - (state.x[V] - state.x[R]), line.residual - state.x[S], line.residual - state.x[U]);
        let weight = state.take(cross, spread, innovation);
        if EVIDENCE {
            let counts = line.sight.choose(EVENT | FRAME, Wide::ONE, Wide::ZERO);
            evidence.add(counts, innovation, &weight);
        }
        let then = what[j];
        state.x[S] = then.choose(EXPOSE, Wide::ZERO, state.x[S]);
        each_state!(a in 0, STATES => state.set(a, S, then.choose(EXPOSE, Wide::ZERO, state.at(a, S))));
        state.x[R] = then.choose(LATCH, state.x[V], state.x[R]);
        each_state!(a in 0, R => state.set(a, R, then.choose(LATCH, state.at(a, V), state.at(a, R))));
        state.p[R][R] = then.choose(LATCH, state.p[V][V], state.p[R][R]);
        if DAMPED {
            // Once a knot, at the last of its steps.
            let next = what.get(j + 1).copied().unwrap_or(Flags([SEGMENT; WIDTH]));
            let damping = next.choose(SEGMENT, ask.damping, Wide::ZERO);
            let mut cross = [Wide::ZERO; STATES];
            each_state!(a in 0, STATES => cross[a] = damping.above(Wide::ZERO, state.at(a, U), Wide::ZERO));
            let variance = damping.above(Wide::ZERO, Wide::ONE / damping, Wide::ONE);
            let innovation = damping.above(Wide::ZERO, Wide::ZERO - state.x[U], Wide::ZERO);
            let damped = state.take(cross, cross[U] + variance, innovation);
            dampings[j] = Damped { gain: damped.gain, pull: damped.pull };
        }
        if KEEP {
            kept[j] = Kept { gain: weight.gain, pull: weight.pull, change: state.x[U], row: state.p[U] };
        }
    }
}

#[inline(always)]
fn dot(row: &[Wide; STATES], lambda: &[Wide; STATES]) -> Wide {
    let mut sum = Wide::ZERO;
    each_state!(a in 0, STATES => sum = sum + row[a] * lambda[a]);
    sum
}

/// Fills the change of log light at each step; gives its largest magnitude and the change of the first reference's offset.
#[inline(always)]
fn backward<const DAMPED: bool>(ask: &Ask<'_>, kept: &[Kept], dampings: &[Damped], change: &mut [Wide]) -> (Wide, Wide) {
    let steps = ask.lines.len();
    let (lines, expected, what) = (&ask.lines[..steps], &ask.expected[..steps], &ask.what[..steps]);
    let (kept, change) = (&kept[..steps], &mut change[..steps]);
    let mut lambda = [Wide::ZERO; STATES];
    let mut longest = Wide::ZERO;
    let (mut moved, mut next) = (Wide::ZERO, Flags([SEGMENT; WIDTH]));
    for j in (0..steps).rev() {
        let (line, kept) = (&lines[j], &kept[j]);
        let own = kept.change + dot(&kept.row, &lambda);
        // All steps of a knot move as its last.
        moved = next.choose(SEGMENT, own, moved);
        next = what[j];
        change[j] = moved;
        longest = moved.abs().max(longest);
        if DAMPED {
            let damped = &dampings[j];
            let pull = damped.pull - dot(&damped.gain, &lambda);
            lambda[U] = lambda[U] + pull;
        }
        let then = what[j];
        lambda[V] = then.choose(LATCH, lambda[V] + lambda[R], lambda[V]);
        lambda[R] = then.choose(LATCH, Wide::ZERO, lambda[R]);
        lambda[S] = then.choose(EXPOSE, Wide::ZERO, lambda[S]);
        let pull = kept.pull - dot(&kept.gain, &lambda);
        let event = line.sight.any(ask.events, pull, Wide::ZERO);
        lambda[V] = lambda[V] + event;
        lambda[R] = lambda[R] - event;
        lambda[S] = lambda[S] + line.sight.choose(FRAME, pull, Wide::ZERO);
        lambda[U] = lambda[U] + line.sight.choose(LIGHT, pull, Wide::ZERO);
        let prior = &expected[j];
        Transition::new(prior.correlation, prior.scale, &line.slopes).transposed(&mut lambda);
    }
    let first = begin(ask);
    let at = |a: usize| {
        let mut sum = Wide::ZERO;
        each_state!(b in 0, STATES => sum = sum + first.at(a, b) * lambda[b]);
        first.x[a] + sum
    };
    (longest, at(R) - at(V))
}

const NO_EVIDENCE: Evidence = Evidence { mantissa: Wide::ONE, exponent: Wide::ZERO, squares: Wide::ZERO, count: Wide::ZERO };

/// One Gauss-Newton step of each lane: see [`backward`].
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub(super) fn step(ask: &Ask<'_>, kept: &mut [Kept], change: &mut [Wide]) -> (Wide, Wide) {
    forward::<false, true, false>(ask, kept, &mut [], &mut { NO_EVIDENCE });
    backward::<false>(ask, kept, &[], change)
}

/// The same where some lanes are damped.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub(super) fn damped_step(ask: &Ask<'_>, kept: &mut [Kept], dampings: &mut [Damped], change: &mut [Wide]) -> (Wide, Wide) {
    forward::<true, true, false>(ask, kept, dampings, &mut { NO_EVIDENCE });
    backward::<true>(ask, kept, dampings, change)
}

/// The evidence of each lane.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub(super) fn evidence(ask: &Ask<'_>) -> Evidence {
    let mut evidence = NO_EVIDENCE;
    forward::<false, false, true>(ask, &mut [], &mut [], &mut evidence);
    evidence
}
