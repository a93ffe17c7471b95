//! One Gauss-Newton step of eight pixels: a Kalman pass forward, a Bryson-Frazier pass backward, both linear
//! in the number of knots.
//!
//! The linearised pixel is a chain with seven states: the changes of log light, of its speed z, of the
//! voltage, the light collected so far, the
//! reference, and both thresholds (left away when those are exact). Only z is random; the others follow. The
//! backward pass carries the gradient
//! of the measurements (`lambda`) and, for standard deviations ([`super::variance`]), their curvature:
//! nothing is ever inverted, so states without noise are no trouble.
//!
//! Pixels do different things at the same step, so every step does everything, and lanes choose: a
//! measurement that a lane does not have weighs nothing there and leaves its numbers as they are, to the last
//! bit.
//!
//! Source: A. E. Bryson and M. Frazier, "Smoothing for linear and nonlinear dynamic systems" (1963); the
//! recursion as in G. J. Bierman (1973).

use super::super::problem::Offsets;
use super::super::segment::Slopes;
use super::super::state::{OFF, ON, R, S, State, Transition, U, V, Weight, Z, each_state};
use super::stream::{EVENT, EXPOSE, FRAME, LATCH, LIGHT, MOVE, RISE, SEGMENT};
use crate::scalar::Scalar;
use crate::wide::{Flags, Wide};
use multiversion::multiversion;

/// One step at given unknowns: the segment that ends there, and what is measured there, linearised. It
/// begins at a cache line, like what is kept of steps below: numbers of eight lanes fill one each, those of
/// one lane lie together.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(64))]
pub(super) struct Line<const W: usize> {
    pub slopes: Slopes<Wide<W>>,
    /// What counts there: [`EVENT`], [`FRAME`], [`LIGHT`], `NO_EVENT` or nothing.
    pub sight: Flags<W>,
    pub residual: Wide<W>,
    pub variance: Wide<W>,
}

/// The prior of the segment that ends at a step.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(64))]
pub(super) struct Expected<const W: usize> {
    pub correlation: Wide<W>,
    /// 0 at steps without a segment.
    pub fresh: Wide<W>,
    pub per_fresh: Wide<W>,
    pub scale: Wide<W>,
    pub per_scale: Wide<W>,
    /// z less what the z before lets expect.
    pub surprise: Wide<W>,
}

/// What the backward pass needs of a step of the forward one.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(super) struct Kept<const N: usize, const W: usize> {
    pub gain: [Wide<W>; N],
    pull: Wide<W>,
    /// Filtered change and the covariance's row of log light.
    change: Wide<W>,
    pub row: [Wide<W>; N],
}

/// The same of a damping.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(super) struct Damped<const N: usize, const W: usize> {
    gain: [Wide<W>; N],
    pull: Wide<W>,
}

/// The memory of the passes.
#[derive(Clone, Debug)]
pub(super) struct Memory<const N: usize, const W: usize> {
    pub kept: Vec<Kept<N, W>>,
    pub dampings: Vec<Damped<N, W>>,
    /// One over the variance of each innovation, where standard deviations are wanted.
    pub information: Vec<Wide<W>>,
}

impl<const N: usize, const W: usize> Memory<N, W> {
    /// For so many steps, of what every pass keeps.
    pub(super) fn make_room(&mut self, steps: usize) {
        let nothing = [Wide::ZERO; N];
        self.kept.resize(steps, Kept { gain: nothing, pull: Wide::ZERO, change: Wide::ZERO, row: nothing });
    }
}

impl<const N: usize, const W: usize> Default for Memory<N, W> {
    fn default() -> Memory<N, W> {
        Memory { kept: Vec::new(), dampings: Vec::new(), information: Vec::new() }
    }
}

/// The [`Offsets`] of each lane.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WideOffsets<const W: usize> {
    pub reference: Wide<W>,
    pub on: Wide<W>,
    pub off: Wide<W>,
}

impl<const W: usize> WideOffsets<W> {
    /// Moved by a share of `by`.
    pub(super) fn moved(&self, by: &WideOffsets<W>, share: Wide<W>) -> WideOffsets<W> {
        WideOffsets {
            reference: self.reference + share * by.reference,
            on: self.on + share * by.on,
            off: self.off + share * by.off,
        }
    }

    pub(super) fn lane(&self, l: usize) -> Offsets {
        Offsets { reference: self.reference.0[l], on: self.on.0[l], off: self.off.0[l] }
    }
}

/// What the passes are asked for.
pub(super) struct Ask<'a, const W: usize> {
    pub lines: &'a [Line<W>],
    pub expected: &'a [Expected<W>],
    /// What is at each step.
    pub what: &'a [Flags<W>],
    /// What is seen as an event: with `NO_EVENT` in lanes where that counts.
    pub events: Flags<W>,
    /// Levenberg's damping of each lane; 0 for none.
    pub damping: Wide<W>,
    /// The first change that the prior expects.
    pub first: Wide<W>,
    /// Thresholds less what the prior expects of them.
    pub offsets: WideOffsets<W>,
    pub first_variance: f64,
    pub reference_variance: Wide<W>,
    /// Of the thresholds.
    pub threshold_variance: Wide<W>,
}

/// Natural log of twice pi.
pub const LOG_TWO_PI: f64 = 1.837_877_066_409_345_3;

/// Sums that make the evidence.
#[derive(Clone, Copy, Debug)]
pub(super) struct Evidence<const W: usize> {
    /// Mantissa and exponent of the product of all information.
    mantissa: Wide<W>,
    exponent: Wide<W>,
    squares: Wide<W>,
    count: Wide<W>,
}

impl<const W: usize> Evidence<W> {
    /// Of no measurement.
    pub(super) const NONE: Evidence<W> =
        Evidence { mantissa: Wide::ONE, exponent: Wide::ZERO, squares: Wide::ZERO, count: Wide::ZERO };

    /// Log of the marginal likelihood of a lane's measurements.
    pub(super) fn log(&self, lane: usize) -> f64 {
        let log_information =
            libm::log(self.mantissa.0[lane]) + self.exponent.0[lane] * std::f64::consts::LN_2;
        -0.5 * (self.count.0[lane] * LOG_TWO_PI - log_information + self.squares.0[lane])
    }

    #[inline(always)]
    fn add<const N: usize>(&mut self, counts: Wide<W>, innovation: Wide<W>, weight: &Weight<Wide<W>, N>) {
        self.count = self.count + counts;
        self.squares = self.squares + counts.equal(1.0, innovation * weight.pull, Wide::ZERO);
        let product = self.mantissa * counts.equal(1.0, weight.information, Wide::ONE);
        let (exponent, mantissa) = product.parts();
        self.exponent = self.exponent + exponent;
        self.mantissa = mantissa;
    }
}

/// What is known of the first step before any measurement: the pixel starts settled, voltage and log light
/// are one, the reference is near.
#[inline(always)]
fn begin<const N: usize, const W: usize>(ask: &Ask<'_, W>) -> State<Wide<W>, N> {
    let mut state = State::new();
    (state.x[U], state.x[V], state.x[R]) = (ask.first, ask.first, ask.first - ask.offsets.reference);
    for (a, b) in [(U, U), (U, V), (U, R), (V, V), (V, R), (R, R)] {
        state.p[a][b] = Wide::splat(ask.first_variance);
    }
    state.p[R][R] = state.p[R][R] + ask.reference_variance;
    state.p[Z][Z] = Wide::ONE;
    each_state!(a in ON, N => {
        state.x[a] = if a == ON { -ask.offsets.on } else { -ask.offsets.off };
        state.p[a][a] = ask.threshold_variance;
    });
    state
}

#[inline(always)]
pub(super) fn forward<
    const N: usize,
    const DAMPED: bool,
    const KEEP: bool,
    const EVIDENCE: bool,
    const W: usize,
>(
    ask: &Ask<'_, W>,
    memory: &mut Memory<N, W>,
    evidence: &mut Evidence<W>,
) {
    let (mut state, steps) = (begin::<N, W>(ask), ask.lines.len());
    let (lines, expected, what) = (&ask.lines[..steps], &ask.expected[..steps], &ask.what[..steps]);
    let kept = &mut memory.kept[..if KEEP { steps } else { 0 }];
    let dampings = &mut memory.dampings[..if DAMPED { steps } else { 0 }];
    let informations = &mut memory.information[..if KEEP && EVIDENCE { steps } else { 0 }];
    for j in 0..steps {
        // Nothing moves before the first step: its segment keeps all as it is.
        let (line, prior) = (&lines[j], &expected[j]);
        state.predict(
            &Transition::new(prior.correlation, prior.scale, &line.slopes),
            prior.fresh,
            -prior.surprise,
        );
        let choose = |event: Wide<W>, frame: Wide<W>, light: Wide<W>| {
            let rest = line.sight.choose(FRAME, frame, line.sight.choose(LIGHT, light, Wide::ZERO));
            line.sight.any(ask.events, event, rest)
        };
        let mut cross = [Wide::ZERO; N];
        each_state!(a in 0, N => {
            let mut event = state.at(a, V) - state.at(a, R);
            if N > ON {
                event = event - line.sight.choose(RISE, state.at(a, ON), -state.at(a, OFF));
            }
            cross[a] = choose(event, state.at(a, S), state.at(a, U));
        });
        let mut event = (cross[V] - cross[R], state.x[V] - state.x[R]);
        if N > ON {
            event.0 = event.0 - line.sight.choose(RISE, cross[ON], -cross[OFF]);
            event.1 = event.1 - line.sight.choose(RISE, state.x[ON], -state.x[OFF]);
        }
        let spread = choose(event.0, cross[S], cross[U]) + line.variance;
        let innovation =
            choose(line.residual - event.1, line.residual - state.x[S], line.residual - state.x[U]);
        let weight = state.take(cross, spread, innovation);
        if EVIDENCE {
            let counts = line.sight.choose(EVENT | FRAME, Wide::ONE, Wide::ZERO);
            evidence.add(counts, innovation, &weight);
        }
        if KEEP && EVIDENCE {
            informations[j] = weight.information;
        }
        let then = what[j];
        if N > ON {
            add_threshold(&mut state, then);
        }
        state.x[S] = then.choose(EXPOSE, Wide::ZERO, state.x[S]);
        each_state!(a in 0, N => state.set(a, S, then.choose(EXPOSE, Wide::ZERO, state.at(a, S))));
        state.x[R] = then.choose(LATCH, state.x[V], state.x[R]);
        each_state!(a in 0, R => state.set(a, R, then.choose(LATCH, state.at(a, V), state.at(a, R))));
        state.p[R][R] = then.choose(LATCH, state.p[V][V], state.p[R][R]);
        each_state!(a in ON, N => state.set(a, R, then.choose(LATCH, state.at(a, V), state.at(a, R))));
        if DAMPED {
            // Once a knot, at the last of its steps.
            let next = what.get(j + 1).copied().unwrap_or(Flags([SEGMENT; W]));
            let damping = next.choose(SEGMENT, ask.damping, Wide::ZERO);
            let mut cross = [Wide::ZERO; N];
            each_state!(a in 0, N => cross[a] = damping.above(Wide::ZERO, state.at(a, U), Wide::ZERO));
            let variance = damping.above(Wide::ZERO, Wide::ONE / damping, Wide::ONE);
            let innovation = damping.above(Wide::ZERO, Wide::ZERO - state.x[U], Wide::ZERO);
            let damped = state.take(cross, cross[U] + variance, innovation);
            dampings[j] = Damped { gain: damped.gain, pull: damped.pull };
        }
        if KEEP {
            kept[j] = Kept { gain: weight.gain, pull: weight.pull, change: state.x[U], row: state.p[U] };
        }
        // Through memory: kept in registers, compilers take lanes out of their vectors.
        std::hint::black_box(&mut state);
    }
}

/// The reference moves by the threshold of the polarity, in lanes where it does.
#[inline(always)]
fn add_threshold<const N: usize, const W: usize>(state: &mut State<Wide<W>, N>, then: Flags<W>) {
    let signed = |on: Wide<W>, off: Wide<W>| then.choose(MOVE, then.choose(RISE, on, -off), Wide::ZERO);
    state.x[R] = state.x[R] + signed(state.x[ON], state.x[OFF]);
    let square = then.choose(MOVE, then.choose(RISE, state.p[ON][ON], state.p[OFF][OFF]), Wide::ZERO);
    let twice = Wide::splat(2.0) * signed(state.at(R, ON), state.at(R, OFF));
    state.p[R][R] = state.p[R][R] + (twice + square);
    each_state!(a in 0, R => state.set(a, R, state.at(a, R) + signed(state.at(a, ON), state.at(a, OFF))));
    each_state!(a in ON, N => state.set(a, R, state.at(a, R) + signed(state.at(a, ON), state.at(a, OFF))));
}

#[inline(always)]
fn dot<const N: usize, const W: usize>(row: &[Wide<W>; N], lambda: &[Wide<W>; N]) -> Wide<W> {
    let mut sum = Wide::ZERO;
    each_state!(a in 0, N => sum = sum + row[a] * lambda[a]);
    sum
}

/// Fills the change of log light at each step; gives its largest magnitude and the change of the offsets.
#[inline(always)]
fn backward<const N: usize, const DAMPED: bool, const W: usize>(
    ask: &Ask<'_, W>,
    memory: &Memory<N, W>,
    change: &mut [Wide<W>],
) -> (Wide<W>, WideOffsets<W>) {
    let steps = ask.lines.len();
    let (lines, expected, what) = (&ask.lines[..steps], &ask.expected[..steps], &ask.what[..steps]);
    let (kept, change) = (&memory.kept[..steps], &mut change[..steps]);
    let mut lambda = [Wide::ZERO; N];
    let mut longest = Wide::ZERO;
    let (mut moved, mut next) = (Wide::ZERO, Flags([SEGMENT; W]));
    for j in (0..steps).rev() {
        let (line, kept) = (&lines[j], &kept[j]);
        let own = kept.change + dot(&kept.row, &lambda);
        // All steps of a knot move as its last.
        moved = next.choose(SEGMENT, own, moved);
        next = what[j];
        change[j] = moved;
        longest = moved.abs().max(longest);
        if DAMPED {
            let damped = &memory.dampings[j];
            let pull = damped.pull - dot(&damped.gain, &lambda);
            lambda[U] = lambda[U] + pull;
        }
        let then = what[j];
        lambda[V] = then.choose(LATCH, lambda[V] + lambda[R], lambda[V]);
        lambda[R] = then.choose(LATCH, Wide::ZERO, lambda[R]);
        lambda[S] = then.choose(EXPOSE, Wide::ZERO, lambda[S]);
        if N > ON {
            let threshold = then.choose(MOVE, lambda[R], Wide::ZERO);
            lambda[ON] = lambda[ON] + then.choose(RISE, threshold, Wide::ZERO);
            lambda[OFF] = lambda[OFF] - then.choose(RISE, Wide::ZERO, threshold);
        }
        let pull = kept.pull - dot(&kept.gain, &lambda);
        let event = line.sight.any(ask.events, pull, Wide::ZERO);
        lambda[V] = lambda[V] + event;
        lambda[R] = lambda[R] - event;
        if N > ON {
            lambda[ON] = lambda[ON] - line.sight.choose(RISE, event, Wide::ZERO);
            lambda[OFF] = lambda[OFF] + line.sight.choose(RISE, Wide::ZERO, event);
        }
        lambda[S] = lambda[S] + line.sight.choose(FRAME, pull, Wide::ZERO);
        lambda[U] = lambda[U] + line.sight.choose(LIGHT, pull, Wide::ZERO);
        let prior = &expected[j];
        Transition::new(prior.correlation, prior.scale, &line.slopes).transposed(&mut lambda);
        // Through memory: kept in registers, compilers take lanes out of their vectors.
        std::hint::black_box(&mut lambda);
    }
    let first = begin::<N, W>(ask);
    let mut at = [Wide::ZERO; N];
    each_state!(a in 0, N => {
        let mut sum = Wide::ZERO;
        each_state!(b in 0, N => sum = sum + first.at(a, b) * lambda[b]);
        at[a] = first.x[a] + sum;
    });
    let threshold = |a: usize| at.get(a).copied().unwrap_or(Wide::ZERO);
    (longest, WideOffsets { reference: at[R] - at[V], on: threshold(ON), off: threshold(OFF) })
}

/// One Gauss-Newton step of each lane: see [`backward`].
pub(super) fn step<const N: usize, const W: usize>(
    ask: &Ask<'_, W>,
    memory: &mut Memory<N, W>,
    change: &mut [Wide<W>],
) -> (Wide<W>, WideOffsets<W>) {
    let steps = ask.lines.len();
    memory.make_room(steps);
    if ask.damping == Wide::ZERO {
        return passes::<N, false, W>(ask, memory, change);
    }
    memory.dampings.resize(steps, Damped { gain: [Wide::ZERO; N], pull: Wide::ZERO });
    passes::<N, true, W>(ask, memory, change)
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
fn passes<const N: usize, const DAMPED: bool, const W: usize>(
    ask: &Ask<'_, W>,
    memory: &mut Memory<N, W>,
    change: &mut [Wide<W>],
) -> (Wide<W>, WideOffsets<W>) {
    forward::<N, DAMPED, true, false, W>(ask, memory, &mut { Evidence::NONE });
    backward::<N, DAMPED, W>(ask, memory, change)
}

/// The evidence of each lane.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub(super) fn evidence<const N: usize, const W: usize>(ask: &Ask<'_, W>) -> Evidence<W> {
    let mut evidence = Evidence::NONE;
    forward::<N, false, false, true, W>(ask, &mut Memory::default(), &mut evidence);
    evidence
}
