//! Posterior variances of log light for eight pixels in step: the backward pass of [`super::super::smoother`] with the curvature of the measurements.
//!
//! The same sums in the same order as [`super::super::state::Adjoint`] for one pixel, lanes choosing as in [`super::passes`].

use super::super::state::{OFF, ON, R, S, Transition, U, V, each_state};
use super::passes::{Ask, Evidence, Line, Memory, NO_EVIDENCE, forward};
use super::stream::{EXPOSE, FRAME, LATCH, LIGHT, MOVE, RISE, SEGMENT};
use crate::scalar::Scalar;
use crate::wide::{Flags, Wide};
use multiversion::multiversion;

/// The curvature of all later measurements by the states, all of the matrix.
struct Curvature<const N: usize>([[Wide; N]; N]);

impl<const N: usize> Curvature<N> {
    /// Along a row of a covariance, from both sides.
    #[inline(always)]
    fn along(&self, row: &[Wide; N]) -> Wide {
        let mut sum = Wide::ZERO;
        each_state!(a in 0, N => sum = sum + row[a] * self.of_row(a, row));
        sum
    }

    #[inline(always)]
    fn of_row(&self, a: usize, row: &[Wide; N]) -> Wide {
        let mut sum = Wide::ZERO;
        each_state!(b in 0, N => sum = sum + self.0[a][b] * row[b]);
        sum
    }

    /// `Lambda := H'H / S + (I - K H)' Lambda (I - K H)` for what each lane looked at.
    #[inline(always)]
    fn untake(&mut self, ask: &Ask<'_>, line: &Line, gain: &[Wide; N], information: Wide) {
        let of_event = |value: Wide| line.sight.any(ask.events, value, Wide::ZERO);
        let mut sight = [Wide::ZERO; N];
        (sight[V], sight[R]) = (of_event(Wide::ONE), of_event(-Wide::ONE));
        let of_value = |what: u64| line.sight.any(ask.events, Wide::ZERO, line.sight.choose(what, Wide::ONE, Wide::ZERO));
        (sight[S], sight[U]) = (of_value(FRAME), of_value(LIGHT));
        each_state!(a in ON, N => sight[a] = {
            let (rises, falls) = if a == ON { (-Wide::ONE, Wide::ZERO) } else { (Wide::ZERO, Wide::ONE) };
            of_event(line.sight.choose(RISE, rises, falls))
        });
        let mut along = [Wide::ZERO; N];
        each_state!(a in 0, N => along[a] = self.of_row(a, gain));
        let mut both = Wide::ZERO;
        each_state!(a in 0, N => both = both + along[a] * gain[a]);
        let both = both + information;
        each_state!(a in 0, N => each_state!(b in 0, N => {
            self.0[a][b] = self.0[a][b] + (both * sight[a] * sight[b] - along[a] * sight[b] - sight[a] * along[b]);
        }));
    }

    /// State `of` became zero, in lanes with these bits.
    #[inline(always)]
    fn forget(&mut self, then: Flags, bits: u64, of: usize) {
        each_state!(a in 0, N => {
            self.0[a][of] = then.choose(bits, Wide::ZERO, self.0[a][of]);
            self.0[of][a] = then.choose(bits, Wide::ZERO, self.0[of][a]);
        });
    }

    /// Column and row `to` grow by `sign` times those of `of`, in lanes where `chosen` lets them.
    #[inline(always)]
    fn add(&mut self, to: usize, of: usize, sign: Wide, chosen: impl Fn(Wide, Wide) -> Wide) {
        each_state!(a in 0, N => self.0[a][to] = chosen(self.0[a][to] + sign * self.0[a][of], self.0[a][to]));
        each_state!(a in 0, N => self.0[to][a] = chosen(self.0[to][a] + sign * self.0[of][a], self.0[to][a]));
    }

    /// `F' Lambda F`, in lanes with a segment: sums in another order made the matrix not quite symmetric, so that where nothing moves it must not be transposed.
    #[inline(always)]
    fn unpredict(&mut self, f: &Transition<Wide>, then: Flags) {
        each_state!(a in 0, N => f.transposed(&mut self.0[a]));
        // The columns are rows of the transpose.
        let half = self.0;
        each_state!(a in 0, N => {
            let mut column = [Wide::ZERO; N];
            each_state!(b in 0, N => column[b] = half[b][a]);
            f.transposed(&mut column);
            each_state!(b in 0, N => self.0[a][b] = then.choose(SEGMENT, column[b], half[a][b]));
        });
    }
}

/// The evidence of each lane, and the posterior variance of log light after each step: that of a knot stands at its last.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub(super) fn variance<const N: usize>(ask: &Ask<'_>, memory: &mut Memory<N>, variance: &mut Vec<Wide>) -> Evidence {
    let mut evidence = NO_EVIDENCE;
    memory.make_room(ask.lines.len());
    memory.information.resize(ask.lines.len(), Wide::ZERO);
    forward::<N, false, true, true>(ask, memory, &mut evidence);
    backward::<N>(ask, memory, variance);
    evidence
}

#[inline(always)]
fn backward<const N: usize>(ask: &Ask<'_>, memory: &Memory<N>, variance: &mut Vec<Wide>) {
    let steps = ask.lines.len();
    variance.resize(steps, Wide::ZERO);
    let (lines, expected, what) = (&ask.lines[..steps], &ask.expected[..steps], &ask.what[..steps]);
    let (kept, information, variance) = (&memory.kept[..steps], &memory.information[..steps], &mut variance[..steps]);
    let mut curvature = Curvature([[Wide::ZERO; N]; N]);
    for j in (0..steps).rev() {
        let (line, then, kept) = (&lines[j], what[j], &kept[j]);
        variance[j] = (kept.row[U] - curvature.along(&kept.row)).max(Wide::ZERO);
        curvature.add(V, R, Wide::ONE, |yes, no| then.choose(LATCH, yes, no));
        curvature.forget(then, LATCH, R);
        curvature.forget(then, EXPOSE, S);
        if N > ON {
            curvature.add(ON, R, Wide::ONE, |yes, no| then.choose(MOVE, then.choose(RISE, yes, no), no));
            curvature.add(OFF, R, -Wide::ONE, |yes, no| then.choose(MOVE, then.choose(RISE, no, yes), no));
        }
        curvature.untake(ask, line, &kept.gain, information[j]);
        let prior = &expected[j];
        curvature.unpredict(&Transition::new(prior.correlation, prior.scale, &line.slopes), then);
        // Through memory: kept in registers, compilers take lanes out of their vectors.
        std::hint::black_box(&mut curvature);
    }
}
