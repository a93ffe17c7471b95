//! One Gauss-Newton step of a pixel: a Kalman pass forward, a Bryson-Frazier pass backward, both linear in the number of knots.
//!
//! The linearised pixel is a chain with seven states: the changes of log light, of its speed z, of the voltage, the reference, the
//! light collected so far, and both thresholds. Only z is random; the others follow. The backward pass carries the gradient
//! of the measurements (`lambda`) and, when standard deviations are asked for, their curvature: nothing is ever inverted,
//! so states without noise are no trouble.
//!
//! Source: A. E. Bryson and M. Frazier, "Smoothing for linear and nonlinear dynamic systems" (1963); the recursion as in G. J. Bierman (1973).

use super::chain::{Chain, Sight, Slopes};
use super::knots::{Knots, Op};
use super::prior::Segments;
use super::{Noise, Offsets};
use photocurrent_core::sensor::Reset;

const STATES: usize = 7;
/// Log light.
const U: usize = 0;
/// Scaled increment.
const Z: usize = 1;
/// Voltage.
const V: usize = 2;
/// Reference.
const R: usize = 3;
/// Collected light.
const S: usize = 4;
/// ON threshold.
const ON: usize = 5;
/// OFF threshold.
const OFF: usize = 6;

type Vector = [f64; STATES];
type Matrix = [[f64; STATES]; STATES];

/// Variance of the first log light around the start value: free for all practical light.
const FIRST_VARIANCE: f64 = 9.0;

/// A measurement that was taken in: for the backward pass.
#[derive(Clone, Copy, Debug)]
struct Taken {
    sight: Vector,
    gain: Vector,
    /// Innovation over its variance.
    pull: f64,
    /// One over the innovation's variance.
    information: f64,
}

/// What the backward pass undoes, in the order it was done.
#[derive(Clone, Copy, Debug)]
enum Step {
    Segment,
    Knot,
    Take(Taken),
    Latch,
    Expose,
    Advance(i8),
}

/// The memory of the two passes.
#[derive(Clone, Debug, Default)]
pub(super) struct Smoother {
    steps: Vec<Step>,
    /// Filtered change and the covariance's row of log light, per knot.
    filtered: Vec<(f64, Vector)>,
    /// Change of log light at each knot.
    pub change: Vec<f64>,
    /// Change of the offsets.
    pub offsets: Offsets,
    /// Posterior variance of log light at each knot, where asked for.
    pub variance: Vec<f64>,
    /// Log of the marginal likelihood of all measurements, damping and silence left out.
    pub log_evidence: f64,
}

/// What a step is asked for.
pub(super) struct Ask<'a> {
    pub knots: &'a Knots,
    pub segments: &'a Segments,
    pub chain: &'a Chain,
    pub u: &'a [f64],
    /// The value that the prior expects of the first log light.
    pub first: f64,
    pub offsets: &'a Offsets,
    pub noise: &'a Noise,
    pub reset: Reset,
    pub silence_sigma: f64,
    /// Levenberg's damping: one over the variance of a change, per knot; 0 for none.
    pub damping: f64,
    pub with_variance: bool,
}

impl Smoother {
    /// Solves the linearised problem.
    pub fn solve(&mut self, ask: &Ask<'_>) {
        let (x, p) = self.forward(ask);
        self.backward(ask, &x, &p);
    }

    fn forward(&mut self, ask: &Ask<'_>) -> (Vector, Matrix) {
        self.steps.clear();
        self.filtered.clear();
        self.log_evidence = 0.0;
        let mut p: Matrix = [[0.0; STATES]; STATES];
        let mut x: Vector = [0.0; STATES];
        // The pixel starts settled: voltage and log light are one; the reference is near.
        x[U] = ask.first - ask.u[0];
        x[V] = x[U];
        x[R] = x[U] - ask.offsets.reference;
        x[ON] = -ask.offsets.on;
        x[OFF] = -ask.offsets.off;
        for a in [U, V, R] {
            for b in [U, V, R] {
                p[a][b] = FIRST_VARIANCE;
            }
        }
        p[R][R] += ask.noise.reference * ask.noise.reference;
        p[Z][Z] = 1.0;
        p[ON][ON] = ask.noise.threshold * ask.noise.threshold;
        p[OFF][OFF] = p[ON][ON];
        let (first_x, first_p) = (x, p);
        let mut z_before = 0.0;
        for j in 0..ask.knots.len() {
            if j > 0 {
                let z = (ask.u[j] - ask.u[j - 1]) / ask.segments.scale[j];
                let correlation = ask.segments.correlation[j];
                predict(&mut x, &mut p, correlation, ask.segments.scale[j], &ask.chain.slopes[j], correlation * z_before - z);
                z_before = z;
                self.steps.push(Step::Segment);
            }
            for at in ask.knots.ops_of(j) {
                let row = &ask.chain.rows[at];
                match row.sight {
                    Sight::None => {}
                    Sight::Event(polarity) => {
                        let mut sight = [0.0; STATES];
                        sight[V] = 1.0;
                        sight[R] = -1.0;
                        sight[if polarity > 0 { ON } else { OFF }] = -f64::from(polarity);
                        let taken = take(&mut x, &mut p, sight, row.residual, row.variance);
                        self.log_evidence += log_density(&taken);
                        self.steps.push(Step::Take(taken));
                    }
                    Sight::Frame => {
                        let mut sight = [0.0; STATES];
                        sight[S] = 1.0;
                        let taken = take(&mut x, &mut p, sight, row.residual, row.variance);
                        self.log_evidence += log_density(&taken);
                        self.steps.push(Step::Take(taken));
                    }
                }
                match ask.knots.ops[at] {
                    Op::Read(_) => {}
                    Op::Expose(_) => {
                        copy_state(&mut x, &mut p, S, None);
                        self.steps.push(Step::Expose);
                    }
                    Op::Latch => {
                        copy_state(&mut x, &mut p, R, Some(V));
                        self.steps.push(Step::Latch);
                    }
                    Op::Fire { armed, .. } if armed || ask.reset == Reset::Resample => {}
                    Op::Fire { polarity, .. } => {
                        add_state(&mut x, &mut p, R, if polarity > 0 { ON } else { OFF }, f64::from(polarity));
                        self.steps.push(Step::Advance(polarity));
                    }
                }
            }
            let (back, polarity) = ask.chain.silence[j];
            if polarity != 0 {
                let mut sight = [0.0; STATES];
                sight[V] = 1.0;
                sight[R] = -1.0;
                sight[if polarity > 0 { ON } else { OFF }] = -f64::from(polarity);
                let taken = take(&mut x, &mut p, sight, back, ask.silence_sigma * ask.silence_sigma);
                self.steps.push(Step::Take(taken));
            }
            if ask.damping > 0.0 {
                let mut sight = [0.0; STATES];
                sight[U] = 1.0;
                let taken = take(&mut x, &mut p, sight, 0.0, 1.0 / ask.damping);
                self.steps.push(Step::Take(taken));
            }
            self.filtered.push((x[U], p[U]));
            self.steps.push(Step::Knot);
        }
        (first_x, first_p)
    }

    fn backward(&mut self, ask: &Ask<'_>, first_x: &Vector, first_p: &Matrix) {
        let knots = ask.knots.len();
        self.change.clear();
        self.change.resize(knots, 0.0);
        self.variance.clear();
        self.variance.resize(if ask.with_variance { knots } else { 0 }, 0.0);
        let mut lambda: Vector = [0.0; STATES];
        let mut curvature: Matrix = [[0.0; STATES]; STATES];
        let mut j = knots;
        for step in self.steps.iter().rev() {
            match step {
                Step::Knot => {
                    j -= 1;
                    let (x, row) = &self.filtered[j];
                    self.change[j] = x + dot(row, &lambda);
                    if ask.with_variance {
                        let mut spread = row[U];
                        for a in 0..STATES {
                            spread -= row[a] * dot(&curvature[a], row);
                        }
                        self.variance[j] = f64::max(spread, 0.0);
                    }
                }
                Step::Take(taken) => {
                    let pull = taken.pull - dot(&taken.gain, &lambda);
                    for a in 0..STATES {
                        lambda[a] += taken.sight[a] * pull;
                    }
                    if ask.with_variance {
                        untake(&mut curvature, taken);
                    }
                }
                Step::Latch => {
                    lambda[V] += lambda[R];
                    lambda[R] = 0.0;
                    if ask.with_variance {
                        transposed_copy(&mut curvature, R, Some(V));
                    }
                }
                Step::Expose => {
                    lambda[S] = 0.0;
                    if ask.with_variance {
                        transposed_copy(&mut curvature, S, None);
                    }
                }
                Step::Advance(polarity) => {
                    let threshold = if *polarity > 0 { ON } else { OFF };
                    let sign = f64::from(*polarity);
                    lambda[threshold] += sign * lambda[R];
                    if ask.with_variance {
                        for a in 0..STATES {
                            curvature[a][threshold] += sign * curvature[a][R];
                        }
                        for a in 0..STATES {
                            curvature[threshold][a] += sign * curvature[R][a];
                        }
                    }
                }
                Step::Segment => {
                    let f = Transition::new(ask.segments.correlation[j], ask.segments.scale[j], &ask.chain.slopes[j]);
                    f.transposed(&mut lambda);
                    if ask.with_variance {
                        for row in &mut curvature {
                            f.transposed(row);
                        }
                        // F' (Lambda F): the columns are done, now the rows.
                        transpose(&mut curvature);
                        for row in &mut curvature {
                            f.transposed(row);
                        }
                    }
                }
            }
        }
        let at = |a: usize| first_x[a] + dot(&first_p[a], &lambda);
        self.offsets = Offsets { reference: at(R) - at(V), on: at(ON), off: at(OFF) };
    }
}

fn dot(a: &Vector, b: &Vector) -> f64 {
    let mut sum = 0.0;
    for k in 0..STATES {
        sum += a[k] * b[k];
    }
    sum
}

fn log_density(taken: &Taken) -> f64 {
    const LOG_TWO_PI: f64 = 1.837_877_066_409_345_3;
    -0.5 * (LOG_TWO_PI - libm::log(taken.information) + taken.pull * taken.pull / taken.information)
}

/// The linear map of one segment, sparse: only four states move.
struct Transition {
    correlation: f64,
    /// Of log light by z before.
    u_by_z: f64,
    voltage: f64,
    v_by_u: f64,
    v_by_z: f64,
    s_by_u: f64,
    s_by_z: f64,
}

impl Transition {
    fn new(correlation: f64, scale: f64, slopes: &Slopes) -> Transition {
        let u_by_z = scale * correlation;
        Transition {
            correlation,
            u_by_z,
            voltage: slopes.by_voltage,
            v_by_u: slopes.by_first + slopes.by_last,
            v_by_z: slopes.by_last * u_by_z,
            s_by_u: slopes.light_by_first + slopes.light_by_last,
            s_by_z: slopes.light_by_last * u_by_z,
        }
    }

    /// `F x`.
    #[inline]
    fn apply(&self, x: &mut Vector) {
        let (u, z, v, s) = (x[U], x[Z], x[V], x[S]);
        x[U] = u + self.u_by_z * z;
        x[Z] = self.correlation * z;
        x[V] = self.voltage * v + self.v_by_u * u + self.v_by_z * z;
        x[S] = s + self.s_by_u * u + self.s_by_z * z;
    }

    /// `F' x`.
    #[inline]
    fn transposed(&self, x: &mut Vector) {
        let (u, z, v, s) = (x[U], x[Z], x[V], x[S]);
        x[U] = u + self.v_by_u * v + self.s_by_u * s;
        x[Z] = self.correlation * z + self.u_by_z * u + self.v_by_z * v + self.s_by_z * s;
        x[V] = self.voltage * v;
    }
}

fn predict(x: &mut Vector, p: &mut Matrix, correlation: f64, scale: f64, slopes: &Slopes, surprise: f64) {
    let f = Transition::new(correlation, scale, slopes);
    f.apply(x);
    // P is symmetric: F on every row gives P F', F on every row of its transpose gives F P F'.
    for row in p.iter_mut() {
        f.apply(row);
    }
    transpose(p);
    for row in p.iter_mut() {
        f.apply(row);
    }
    let noise = [(U, scale), (Z, 1.0), (V, slopes.by_last * scale), (S, slopes.light_by_last * scale)];
    let variance = 1.0 - correlation * correlation;
    for (a, by) in noise {
        x[a] += by * surprise;
        for (b, also_by) in noise {
            p[a][b] += by * also_by * variance;
        }
    }
}

fn transpose(p: &mut Matrix) {
    for a in 0..STATES {
        for b in 0..a {
            let kept = p[a][b];
            p[a][b] = p[b][a];
            p[b][a] = kept;
        }
    }
}

fn take(x: &mut Vector, p: &mut Matrix, sight: Vector, residual: f64, variance: f64) -> Taken {
    let mut cross = [0.0; STATES];
    for a in 0..STATES {
        cross[a] = dot(&p[a], &sight);
    }
    let spread = dot(&cross, &sight) + variance;
    let information = 1.0 / spread;
    let innovation = residual - dot(&sight, x);
    let mut gain = cross;
    for a in 0..STATES {
        gain[a] = cross[a] * information;
        x[a] += gain[a] * innovation;
    }
    for a in 0..STATES {
        for b in 0..STATES {
            p[a][b] -= gain[a] * cross[b];
        }
    }
    Taken { sight, gain, pull: innovation * information, information }
}

/// `Lambda := H'H / S + (I - K H)' Lambda (I - K H)`.
fn untake(curvature: &mut Matrix, taken: &Taken) {
    let mut along = [0.0; STATES];
    for a in 0..STATES {
        along[a] = dot(&curvature[a], &taken.gain);
    }
    let both = dot(&along, &taken.gain) + taken.information;
    for a in 0..STATES {
        for b in 0..STATES {
            curvature[a][b] += both * taken.sight[a] * taken.sight[b] - along[a] * taken.sight[b] - taken.sight[a] * along[b];
        }
    }
}

/// State `to` becomes a copy of `from`, or zero.
fn copy_state(x: &mut Vector, p: &mut Matrix, to: usize, from: Option<usize>) {
    x[to] = from.map_or(0.0, |from| x[from]);
    for row in p.iter_mut() {
        row[to] = from.map_or(0.0, |from| row[from]);
    }
    p[to] = from.map_or([0.0; STATES], |from| p[from]);
}

fn transposed_copy(curvature: &mut Matrix, to: usize, from: Option<usize>) {
    for row in curvature.iter_mut() {
        if let Some(from) = from {
            row[from] += row[to];
        }
        row[to] = 0.0;
    }
    if let Some(from) = from {
        let moved = curvature[to];
        for a in 0..STATES {
            curvature[from][a] += moved[a];
        }
    }
    curvature[to] = [0.0; STATES];
}

/// State `to` grows by `sign` times `of`.
fn add_state(x: &mut Vector, p: &mut Matrix, to: usize, of: usize, sign: f64) {
    x[to] += sign * x[of];
    for row in p.iter_mut() {
        row[to] += sign * row[of];
    }
    let more = p[of];
    for a in 0..STATES {
        p[to][a] += sign * more[a];
    }
}
