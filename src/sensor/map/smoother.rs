//! One Gauss-Newton step of a pixel: a Kalman pass forward, a Bryson-Frazier pass backward, both linear in the number of knots.
//!
//! The linearised pixel is a chain with seven states: the changes of log light, of its speed z, of the voltage, the light collected so far, the
//! reference, and both thresholds (left away when those are exact). Only z is random; the others follow. The backward pass carries the gradient
//! of the measurements (`lambda`) and, when standard deviations are asked for, their curvature: nothing is ever inverted,
//! so states without noise are no trouble.
//!
//! Source: A. E. Bryson and M. Frazier, "Smoothing for linear and nonlinear dynamic systems" (1963); the recursion as in G. J. Bierman (1973).

use super::chain::{Chain, Sight};
use super::knots::{Knots, Op};
use super::prior::Segments;
use super::state::{Adjoint, OFF, ON, R, S, STATES, State, Taken, Transition, U, V, Z};
use super::{Hint, Noise, Offsets};
use crate::elementary;
use photocurrent_core::sensor::Reset;

/// Variance of the first log light around the start value: free for all practical light.
pub(super) const FIRST_VARIANCE: f64 = 9.0;

/// The memory of the two passes.
#[derive(Clone, Debug, Default)]
pub(super) struct Smoother {
    /// Measurements in the order in which they were taken.
    taken: Vec<Taken>,
    /// Filtered change and the covariance's row of log light, per knot.
    filtered: Vec<(f64, [f64; STATES])>,
    /// Change of log light at each knot.
    pub change: Vec<f64>,
    /// Change of the offsets.
    pub offsets: Offsets,
    /// Posterior variance of log light at each knot, where asked for.
    pub variance: Vec<f64>,
    /// Of each measurement, in order, where asked for: `C^-1 y` and the diagonal of `C^-1`, so that their ratio is the residual when it is left out and one over the
    /// diagonal its variance.
    pub left_out: Vec<(f64, f64)>,
    /// Log of the marginal likelihood of all measurements, damping and the no-event constraint left out, where asked for.
    pub log_evidence: f64,
}

/// What is wanted of the passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Want {
    /// The change.
    Step,
    /// The evidence, nothing else.
    Evidence,
    /// The evidence and standard deviations, both with what hints count as for these; the change as well.
    Variance,
    /// The same, and each measurement as the others predict it.
    LeftOut,
}

/// What a step is asked for.
pub(super) struct Ask<'a> {
    pub knots: &'a Knots,
    pub segments: &'a Segments,
    pub chain: &'a Chain,
    pub hints: &'a [Hint],
    pub u: &'a [f64],
    /// The value that the prior expects of the first log light.
    pub first: f64,
    pub offsets: &'a Offsets,
    pub noise: &'a Noise,
    pub reset: Reset,
    /// 0 where the no-event constraint does not count.
    pub no_event_sigma: f64,
    /// Levenberg's damping: one over the variance of a change, per knot; 0 for none.
    pub damping: f64,
    pub want: Want,
    /// What the prior expects of the thresholds.
    pub expected: Offsets,
}

impl Ask<'_> {
    /// The variance of the hint at an op.
    fn of_hint(&self, at: usize) -> f64 {
        match self.knots.ops[at] {
            Op::Hint(l) if self.want == Want::Variance => self.hints[l as usize].for_sigma,
            _ => self.chain.rows[at].variance,
        }
    }
}

impl Smoother {
    /// Solves the linearised problem.
    pub fn solve(&mut self, ask: &Ask<'_>) {
        self.taken.clear();
        self.filtered.clear();
        self.log_evidence = 0.0;
        self.variance.clear();
        self.left_out.clear();
        // Exact thresholds are no unknowns.
        if ask.noise.threshold > 0.0 { self.passes::<STATES>(ask) } else { self.passes::<ON>(ask) }
    }

    fn passes<const N: usize>(&mut self, ask: &Ask<'_>) {
        let first = begin::<N>(ask);
        match ask.want {
            Want::Step => {
                self.forward::<N, false, true>(ask, &first);
                self.backward::<N, false>(ask, &first);
            }
            Want::Evidence => self.forward::<N, true, false>(ask, &first),
            Want::Variance | Want::LeftOut => {
                self.forward::<N, true, true>(ask, &first);
                self.backward::<N, true>(ask, &first);
            }
        }
    }

    fn forward<const N: usize, const WITH_EVIDENCE: bool, const KEEP: bool>(&mut self, ask: &Ask<'_>, first: &State<f64, N>) {
        let mut state = *first;
        let segments = ask.segments;
        let mut z_before = 0.0;
        for j in 0..ask.knots.len() {
            if j > 0 {
                let (correlation, scale) = (segments.correlation[j], segments.scale[j]);
                let z = segments.z[j];
                state.predict(&Transition::new(correlation, scale, &ask.chain.slopes[j]), segments.fresh[j], correlation * z_before - z);
                z_before = z;
            }
            for at in ask.knots.ops_of(j) {
                let row = &ask.chain.rows[at];
                if row.sight != Sight::None {
                    let taken = match row.sight {
                        Sight::Event(polarity) => state.take_event(polarity, row.residual, row.variance),
                        Sight::Light => state.take_value(U, row.residual, ask.of_hint(at)),
                        Sight::Frame | Sight::None => state.take_value(S, row.residual, row.variance),
                    };
                    // What neighbours say is no measurement of this pixel.
                    if WITH_EVIDENCE && row.sight != Sight::Light {
                        self.log_evidence += log_density(&taken);
                    }
                    if KEEP {
                        self.taken.push(taken);
                    }
                }
                match ask.knots.ops[at] {
                    Op::Read(_) | Op::Lose | Op::Hint(_) => {}
                    Op::Expose(_) => state.forget(S),
                    Op::Latch => state.copy(R, V),
                    Op::Fire { armed, .. } if armed || ask.reset == Reset::Resample => {}
                    Op::Fire { polarity, .. } => state.add_threshold(polarity),
                }
            }
            let (back, polarity) = ask.chain.no_event[j];
            if polarity != 0 && ask.no_event_sigma > 0.0 {
                let taken = state.take_event(polarity, back, ask.no_event_sigma * ask.no_event_sigma);
                if KEEP {
                    self.taken.push(taken);
                }
            }
            if ask.damping > 0.0 {
                self.taken.push(state.take_value(U, 0.0, 1.0 / ask.damping));
            }
            if KEEP {
                self.filtered.push(state.log_light());
            }
        }
    }

    fn backward<const N: usize, const WITH_VARIANCE: bool>(&mut self, ask: &Ask<'_>, first: &State<f64, N>) {
        let knots = ask.knots.len();
        self.change.clear();
        self.change.resize(knots, 0.0);
        self.variance.resize(if WITH_VARIANCE { knots } else { 0 }, 0.0);
        let mut adjoint = Adjoint::<N, WITH_VARIANCE>::new();
        let mut taken = self.taken.iter().rev();
        let left_out = &mut self.left_out;
        let mut untake = |adjoint: &mut Adjoint<N, WITH_VARIANCE>| {
            if let Some(taken) = taken.next() {
                if WITH_VARIANCE && ask.want == Want::LeftOut {
                    left_out.push((taken.pull - adjoint.dot(&taken.gain), taken.information + adjoint.information(&taken.gain)));
                }
                adjoint.untake(taken);
            }
        };
        for j in (0..knots).rev() {
            let (x, row) = &self.filtered[j];
            self.change[j] = x + adjoint.dot(row);
            if WITH_VARIANCE {
                self.variance[j] = f64::max(row[U] - adjoint.information(row), 0.0);
            }
            if ask.damping > 0.0 {
                untake(&mut adjoint);
            }
            if ask.chain.no_event[j].1 != 0 && ask.no_event_sigma > 0.0 {
                untake(&mut adjoint);
            }
            for at in ask.knots.ops_of(j).rev() {
                match ask.knots.ops[at] {
                    Op::Read(_) | Op::Lose | Op::Hint(_) => {}
                    Op::Expose(_) => adjoint.forget(S),
                    Op::Latch => adjoint.copy(R, V),
                    Op::Fire { armed, .. } if armed || ask.reset == Reset::Resample => {}
                    Op::Fire { polarity, .. } => adjoint.add_threshold(polarity),
                }
                if ask.chain.rows[at].sight != Sight::None {
                    untake(&mut adjoint);
                }
            }
            if j > 0 {
                adjoint.unpredict(&Transition::new(ask.segments.correlation[j], ask.segments.scale[j], &ask.chain.slopes[j]));
            }
        }
        self.left_out.reverse();
        let at = |a: usize| if a < N { first.x[a] + adjoint.along(first, a) } else { 0.0 };
        self.offsets = Offsets { reference: at(R) - at(V), on: at(ON), off: at(OFF) };
    }
}

/// What is known of the first knot before any measurement.
pub(super) fn begin<const N: usize>(ask: &Ask<'_>) -> State<f64, N> {
    let mut state = State::new();
    // The pixel starts settled: voltage and log light are one; the reference is near.
    let change = ask.first - ask.u[0];
    (state.x[U], state.x[V], state.x[R]) = (change, change, change - ask.offsets.reference);
    for (a, b) in [(U, U), (U, V), (U, R), (V, V), (V, R), (R, R)] {
        state.p[a][b] = FIRST_VARIANCE;
    }
    state.p[R][R] += ask.noise.reference * ask.noise.reference;
    state.p[Z][Z] = 1.0;
    for (threshold, offset) in [(ON, ask.offsets.on - ask.expected.on), (OFF, ask.offsets.off - ask.expected.off)] {
        if threshold < N {
            state.x[threshold] = -offset;
            state.p[threshold][threshold] = ask.noise.threshold * ask.noise.threshold;
        }
    }
    state
}

fn log_density(taken: &Taken) -> f64 {
    const LOG_TWO_PI: f64 = 1.837_877_066_409_345_3;
    -0.5 * (LOG_TWO_PI - elementary::ln(taken.information) + taken.pull * taken.pull / taken.information)
}
