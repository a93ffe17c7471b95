//! Posterior variances of log light for eight pixels in step: the backward pass with the curvature of the
//! measurements, lanes
//! choosing as in [`super::passes`].

use super::super::curvature::Curvature;
use super::super::state::{OFF, ON, R, S, Transition, U, V, each_state};
use super::passes::{Ask, Evidence, Line, Memory, forward};
use super::stream::{EXPOSE, FRAME, LATCH, LIGHT, MOVE, RISE, SEGMENT};
use crate::scalar::Scalar;
use crate::wide::Wide;
use multiversion::multiversion;

/// What each lane looked at.
#[inline(always)]
fn sight<const N: usize, const W: usize>(ask: &Ask<'_, W>, line: &Line<W>) -> [Wide<W>; N] {
    let of_event = |value: Wide<W>| line.sight.any(ask.events, value, Wide::ZERO);
    let of_value =
        |what: u64| line.sight.any(ask.events, Wide::ZERO, line.sight.choose(what, Wide::ONE, Wide::ZERO));
    let mut sight = [Wide::ZERO; N];
    (sight[V], sight[R]) = (of_event(Wide::ONE), of_event(-Wide::ONE));
    (sight[S], sight[U]) = (of_value(FRAME), of_value(LIGHT));
    each_state!(a in ON, N => sight[a] = {
        let (rises, falls) = if a == ON { (-Wide::ONE, Wide::ZERO) } else { (Wide::ZERO, Wide::ONE) };
        of_event(line.sight.choose(RISE, rises, falls))
    });
    sight
}

/// The evidence of each lane, and the posterior variance of log light after each step: that of a knot stands
/// at its last.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub(super) fn variance<const N: usize, const W: usize>(
    ask: &Ask<'_, W>,
    memory: &mut Memory<N, W>,
    variance: &mut Vec<Wide<W>>,
) -> Evidence<W> {
    let mut evidence = Evidence::NONE;
    memory.make_room(ask.lines.len());
    memory.information.resize(ask.lines.len(), Wide::ZERO);
    forward::<N, false, true, true, W>(ask, memory, &mut evidence);
    backward::<N, W>(ask, memory, variance);
    evidence
}

#[inline(always)]
fn backward<const N: usize, const W: usize>(
    ask: &Ask<'_, W>,
    memory: &Memory<N, W>,
    variance: &mut Vec<Wide<W>>,
) {
    let steps = ask.lines.len();
    variance.resize(steps, Wide::ZERO);
    let (lines, expected, what) = (&ask.lines[..steps], &ask.expected[..steps], &ask.what[..steps]);
    let (kept, information, variance) =
        (&memory.kept[..steps], &memory.information[..steps], &mut variance[..steps]);
    let mut curvature = Curvature::<Wide<W>, N>::new();
    for j in (0..steps).rev() {
        let (line, then, kept) = (&lines[j], what[j], &kept[j]);
        variance[j] = (kept.row[U] - curvature.along(&kept.row)).max(Wide::ZERO);
        curvature.add(V, R, Wide::ONE, |yes, no| then.choose(LATCH, yes, no));
        curvature.forget(R, |yes, no| then.choose(LATCH, yes, no));
        curvature.forget(S, |yes, no| then.choose(EXPOSE, yes, no));
        if N > ON {
            curvature.add(ON, R, Wide::ONE, |yes, no| then.choose(MOVE, then.choose(RISE, yes, no), no));
            curvature.add(OFF, R, -Wide::ONE, |yes, no| then.choose(MOVE, then.choose(RISE, no, yes), no));
        }
        curvature.untake(&sight(ask, line), &kept.gain, information[j]);
        let prior = &expected[j];
        curvature.unpredict(&Transition::new(prior.correlation, prior.scale, &line.slopes), |yes, no| {
            then.choose(SEGMENT, yes, no)
        });
        // Through memory: kept in registers, compilers take lanes out of their vectors.
        std::hint::black_box(&mut curvature);
    }
}
