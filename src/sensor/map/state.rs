//! The states of the linearised pixel, and what moves them: forward with their covariance, backward with the gradient of the measurements.
//!
//! Seven states, or the first five where thresholds are exact. Of the covariance only the half above the diagonal is kept. Everything is
//! inlined into the two passes, where all indices are known.

use super::chain::Slopes;
use super::curvature::Curvature;
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

/// The body once for each index of a state that is below the limit, with the index known. A loop over states of lanes would be turned into vectors of
/// states, which is slow.
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

/// What a measurement looked at.
#[derive(Clone, Copy, Debug)]
enum Seen {
    /// Voltage less reference, less (ON) or plus (OFF) the threshold.
    Event(i8),
    /// One state.
    Value(usize),
}

/// A measurement that was taken in: for the backward pass.
#[derive(Clone, Copy, Debug)]
pub(super) struct Taken {
    seen: Seen,
    pub gain: [f64; STATES],
    /// Innovation over its variance.
    pub pull: f64,
    /// One over the innovation's variance.
    pub information: f64,
}

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
    pub fn new(correlation: T, scale: T, slopes: &Slopes<T>) -> Transition<T> {
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
    pub fn apply(&self, [u, z, v, s]: [T; MOVING]) -> [T; MOVING] {
        [u + self.u_by_z * z, self.correlation * z, self.voltage * v + (self.v_by_u * u + self.v_by_z * z), s + (self.s_by_u * u + self.s_by_z * z)]
    }

    /// `F' x`.
    #[inline(always)]
    pub fn transposed<const N: usize>(&self, x: &mut [T; N]) {
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
    pub fn new() -> State<T, N> {
        let zero = T::from_f64(0.0);
        State { x: [zero; N], p: [[zero; N]; N] }
    }

    #[inline(always)]
    pub fn at(&self, a: usize, b: usize) -> T {
        if a <= b { self.p[a][b] } else { self.p[b][a] }
    }

    #[inline(always)]
    pub fn set(&mut self, a: usize, b: usize, value: T) {
        if a <= b {
            self.p[a][b] = value;
        } else {
            self.p[b][a] = value;
        }
    }

    /// Over a segment: `F x`, `F P F'` and what is new, with variance `fresh` and mean `surprise`.
    #[inline(always)]
    pub fn predict(&mut self, f: &Transition<T>, fresh: T, surprise: T) {
        let x = f.apply([self.x[U], self.x[Z], self.x[V], self.x[S]]);
        each_state!(a in 0, MOVING => self.x[a] = x[a] + f.by_new[a] * surprise);
        each_state!(b in MOVING, N => {
            let column = f.apply([self.p[U][b], self.p[Z][b], self.p[V][b], self.p[S][b]]);
            (self.p[U][b], self.p[Z][b], self.p[V][b], self.p[S][b]) = (column[U], column[Z], column[V], column[S]);
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

    /// Takes in a measurement with these covariances to the states, this variance in all and this difference from what was predicted.
    #[inline(always)]
    pub fn take(&mut self, cross: [T; N], spread: T, innovation: T) -> Weight<T, N> {
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

impl<const N: usize> State<f64, N> {
    /// The change of log light and its row of the covariance.
    #[inline(always)]
    pub fn log_light(&self) -> (f64, [f64; STATES]) {
        let mut row = [0.0; STATES];
        row[..N].copy_from_slice(&self.p[U]);
        (self.x[U], row)
    }

    #[inline(always)]
    fn take_seen(&mut self, seen: Seen, cross: [f64; N], spread: f64, innovation: f64) -> Taken {
        let weight = self.take(cross, spread, innovation);
        let mut gain = [0.0; STATES];
        gain[..N].copy_from_slice(&weight.gain);
        Taken { seen, gain, pull: weight.pull, information: weight.information }
    }

    /// Takes in that voltage less reference less the threshold of `polarity` is larger by `residual` than predicted.
    #[inline(always)]
    pub fn take_event(&mut self, polarity: i8, residual: f64, variance: f64) -> Taken {
        let mut cross = [0.0; N];
        let mut expected = self.x[V] - self.x[R];
        for a in 0..N {
            cross[a] = self.at(a, V) - self.at(a, R);
        }
        let mut spread = cross[V] - cross[R];
        if N > ON {
            let (threshold, sign) = if polarity > 0 { (ON, 1.0) } else { (OFF, -1.0) };
            for a in 0..N {
                cross[a] -= sign * self.at(a, threshold);
            }
            spread = cross[V] - cross[R] - sign * cross[threshold];
            expected -= sign * self.x[threshold];
        }
        self.take_seen(Seen::Event(polarity), cross, spread + variance, residual - expected)
    }

    /// Takes in that state `of` is larger by `residual` than predicted.
    #[inline(always)]
    pub fn take_value(&mut self, of: usize, residual: f64, variance: f64) -> Taken {
        let mut cross = [0.0; N];
        for a in 0..N {
            cross[a] = self.at(a, of);
        }
        self.take_seen(Seen::Value(of), cross, cross[of] + variance, residual - self.x[of])
    }

    /// State `of` becomes zero.
    #[inline(always)]
    pub fn forget(&mut self, of: usize) {
        self.x[of] = 0.0;
        for a in 0..N {
            self.set(a, of, 0.0);
        }
    }

    /// State `to` becomes `from`.
    #[inline(always)]
    pub fn copy(&mut self, to: usize, from: usize) {
        self.x[to] = self.x[from];
        for a in 0..N {
            if a != to {
                self.set(a, to, self.at(a, from));
            }
        }
        self.p[to][to] = self.p[from][from];
    }

    /// The reference moves by the threshold of `polarity`.
    #[inline(always)]
    pub fn add_threshold(&mut self, polarity: i8) {
        let (threshold, sign) = if polarity > 0 { (ON, 1.0) } else { (OFF, -1.0) };
        if threshold < N {
            self.x[R] += sign * self.x[threshold];
            self.p[R][R] += 2.0 * sign * self.at(R, threshold) + self.p[threshold][threshold];
            for a in 0..N {
                if a != R {
                    self.set(a, R, self.at(a, R) + sign * self.at(a, threshold));
                }
            }
        }
    }
}

/// The gradient of all later measurements by the states, and their curvature where it is wanted.
pub(super) struct Adjoint<const N: usize, const CURVED: bool> {
    lambda: [f64; N],
    curvature: Curvature<f64, N>,
}

impl<const N: usize, const CURVED: bool> Adjoint<N, CURVED> {
    pub fn new() -> Self {
        Adjoint { lambda: [0.0; N], curvature: Curvature::new() }
    }

    /// The gradient along a row of a covariance.
    #[inline(always)]
    pub fn dot(&self, row: &[f64; STATES]) -> f64 {
        let mut sum = 0.0;
        for a in 0..N {
            sum += row[a] * self.lambda[a];
        }
        sum
    }

    /// The gradient along row `a` of a first covariance.
    pub fn along(&self, first: &State<f64, N>, a: usize) -> f64 {
        (0..N).map(|b| first.at(a, b) * self.lambda[b]).sum()
    }

    /// The curvature along a row of a covariance.
    pub fn information(&self, row: &[f64; STATES]) -> f64 {
        self.curvature.along(row)
    }

    /// `Lambda := H'H / S + (I - K H)' Lambda (I - K H)`, and the same for the gradient.
    #[inline(always)]
    pub fn untake(&mut self, taken: &Taken) {
        let pull = taken.pull - self.dot(&taken.gain);
        let mut sight = [0.0; N];
        match taken.seen {
            Seen::Event(polarity) => {
                (sight[V], sight[R]) = (1.0, -1.0);
                let threshold = if polarity > 0 { ON } else { OFF };
                if threshold < N {
                    sight[threshold] = -f64::from(polarity);
                }
            }
            Seen::Value(of) => sight[of] = 1.0,
        }
        for a in 0..N {
            self.lambda[a] += sight[a] * pull;
        }
        if CURVED {
            self.curvature.untake(&sight, &taken.gain, taken.information);
        }
    }

    /// Undoes [`State::forget`].
    #[inline(always)]
    pub fn forget(&mut self, of: usize) {
        self.lambda[of] = 0.0;
        if CURVED {
            self.curvature.forget(of, |yes, _| yes);
        }
    }

    /// Undoes [`State::copy`].
    #[inline(always)]
    pub fn copy(&mut self, to: usize, from: usize) {
        self.add(from, to, 1.0);
        self.forget(to);
    }

    /// Undoes [`State::add_threshold`].
    #[inline(always)]
    pub fn add_threshold(&mut self, polarity: i8) {
        let threshold = if polarity > 0 { ON } else { OFF };
        if threshold < N {
            self.add(threshold, R, f64::from(polarity));
        }
    }

    /// Entry `to` grows by `sign` times `of`.
    #[inline(always)]
    fn add(&mut self, to: usize, of: usize, sign: f64) {
        self.lambda[to] += sign * self.lambda[of];
        if CURVED {
            self.curvature.add(to, of, sign, |yes, _| yes);
        }
    }

    /// Undoes [`State::predict`].
    #[inline(always)]
    pub fn unpredict(&mut self, f: &Transition<f64>) {
        f.transposed(&mut self.lambda);
        if CURVED {
            self.curvature.unpredict(f, |yes, _| yes);
        }
    }
}
