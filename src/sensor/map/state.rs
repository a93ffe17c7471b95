//! The states of the linearised pixel, and what moves them: forward with their covariance, backward with the
//! gradient of the measurements.
//!
//! Seven states, or the first five where thresholds are exact. Of the covariance only the half above the
//! diagonal is kept. Everything is inlined into the two passes, where all indices are known.

use super::segment::Slopes;
use crate::scalar::Scalar;

/// Log light.
pub(super) const U: usize = 0;
/// Scaled increment.
pub(super) const Z: usize = 1;
/// Voltage.
pub(super) const V: usize = 2;
/// Collected light.
pub(super) const S: usize = 3;
/// Reference.
pub(super) const R: usize = 4;
/// ON threshold.
pub(super) const ON: usize = 5;
/// OFF threshold.
pub(super) const OFF: usize = 6;
/// How many there are.
pub(super) const STATES: usize = 7;

/// The body once for each index of a state that is below the limit, with the index known. A loop over states
/// of lanes would be turned into vectors of states, which is slow.
macro_rules! each_state {
    ($a:ident in $from:expr, $below:expr => $body:expr) => {
        each_state!(@ $a $from, $below, $body, 0 1 2 3 4 5 6)
    };
    (@ $a:ident $from:expr, $below:expr, $body:expr, $($n:literal)*) => {
        $({
            let $a: usize = $n;
            if ($from..$below).contains(&$a) {
                $body;
            }
        })*
    };
}
pub(super) use each_state;

/// The states before this one move over a segment, the others stand still.
const MOVING: usize = R;

/// The linear map of one segment, sparse.
pub(super) struct Transition<T> {
    correlation: T,
    /// Of log light by z before.
    u_by_z: T,
    voltage: T,
    v_by_u: T,
    v_by_z: T,
    s_by_u: T,
    s_by_z: T,
    /// Of log light, z, voltage and collected light by what is new.
    by_new: [T; MOVING],
}

impl<T: Scalar> Transition<T> {
    #[inline(always)]
    pub(super) fn new(correlation: T, scale: T, slopes: &Slopes<T>) -> Transition<T> {
        let u_by_z = scale * correlation;
        Transition {
            correlation,
            u_by_z,
            voltage: slopes.by_voltage,
            v_by_u: slopes.by_both,
            v_by_z: slopes.by_last * u_by_z,
            s_by_u: slopes.light_by_both,
            s_by_z: slopes.light_by_last * u_by_z,
            by_new: [scale, T::from_f64(1.0), slopes.by_last * scale, slopes.light_by_last * scale],
        }
    }

    /// `F x` for the states that move.
    #[inline(always)]
    pub(super) fn apply(&self, [u, z, v, s]: [T; MOVING]) -> [T; MOVING] {
        [
            u + self.u_by_z * z,
            self.correlation * z,
            self.voltage * v + (self.v_by_u * u + self.v_by_z * z),
            s + (self.s_by_u * u + self.s_by_z * z),
        ]
    }

    /// `F' x`.
    #[inline(always)]
    pub(super) fn transposed<const N: usize>(&self, x: &mut [T; N]) {
        let (u, z, v, s) = (x[U], x[Z], x[V], x[S]);
        x[U] = u + (self.v_by_u * v + self.s_by_u * s);
        x[Z] = (self.correlation * z + self.u_by_z * u) + (self.v_by_z * v + self.s_by_z * s);
        x[V] = self.voltage * v;
    }
}

/// Changes of the states and their covariance, of which `p[a][b]` counts for `a <= b` only.
#[derive(Clone, Copy, Debug)]
pub(super) struct State<T, const N: usize> {
    pub x: [T; N],
    pub p: [[T; N]; N],
}

impl<T: Scalar, const N: usize> State<T, N> {
    pub(super) fn new() -> State<T, N> {
        let zero = T::from_f64(0.0);
        State { x: [zero; N], p: [[zero; N]; N] }
    }

    #[inline(always)]
    pub(super) fn at(&self, a: usize, b: usize) -> T {
        if a <= b { self.p[a][b] } else { self.p[b][a] }
    }

    #[inline(always)]
    pub(super) fn set(&mut self, a: usize, b: usize, value: T) {
        if a <= b {
            self.p[a][b] = value;
        } else {
            self.p[b][a] = value;
        }
    }

    /// Over a segment: `F x`, `F P F'` and what is new, with variance `fresh` and mean `surprise`.
    #[inline(always)]
    pub(super) fn predict(&mut self, f: &Transition<T>, fresh: T, surprise: T) {
        let x = f.apply([self.x[U], self.x[Z], self.x[V], self.x[S]]);
        each_state!(a in 0, MOVING => self.x[a] = x[a] + f.by_new[a] * surprise);
        each_state!(b in MOVING, N => {
            let column = f.apply([self.p[U][b], self.p[Z][b], self.p[V][b], self.p[S][b]]);
            (self.p[U][b], self.p[Z][b]) = (column[U], column[Z]);
            (self.p[V][b], self.p[S][b]) = (column[V], column[S]);
        });
        let mut half = [[T::from_f64(0.0); MOVING]; MOVING];
        each_state!(b in 0, MOVING => {
            let column = f.apply([self.at(U, b), self.at(Z, b), self.at(V, b), self.at(S, b)]);
            (half[U][b], half[Z][b], half[V][b], half[S][b]) = (column[U], column[Z], column[V], column[S]);
        });
        each_state!(a in 0, MOVING => {
            let row = f.apply(half[a]);
            let new = f.by_new[a] * fresh;
            each_state!(b in a, MOVING => self.p[a][b] = row[b] + new * f.by_new[b]);
        });
    }

    /// Takes in a measurement with these covariances to the states, this variance in all and this difference
    /// from what was predicted.
    #[inline(always)]
    pub(super) fn take(&mut self, cross: [T; N], spread: T, innovation: T) -> Weight<T, N> {
        let information = T::from_f64(1.0) / spread;
        let pull = innovation * information;
        let mut gain = cross;
        each_state!(a in 0, N => {
            gain[a] = cross[a] * information;
            self.x[a] = self.x[a] + cross[a] * pull;
            each_state!(b in a, N => self.p[a][b] = self.p[a][b] - gain[a] * cross[b]);
        });
        Weight { gain, pull, information }
    }
}

/// What a measurement did to the states.
#[derive(Clone, Copy, Debug)]
pub(super) struct Weight<T, const N: usize> {
    pub gain: [T; N],
    /// Innovation over its variance.
    pub pull: T,
    /// One over the innovation's variance.
    pub information: T,
}
