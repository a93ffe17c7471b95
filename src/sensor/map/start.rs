//! Where the iteration starts: the double integral, joined up.
//!
//! Each event moves log light by its threshold, along a ramp that ends at the event; each frame says at which
//! level. Between the middles of two exposures the level goes over linearly, so that thresholds that are a
//! little wrong do not add up. This is also the double-integral estimate of a pixel whose problem does not
//! converge.

use super::knots::{Knots, Op};
use super::problem::MapProblem;
use super::segment::collect;

/// A step takes this long, seconds, or since the event before when that is shorter.
const RAMP_S: f64 = 3e-3;
/// What a dark frame counts as, DN above black: its logarithm must exist.
const DARK_DN: f64 = 0.5;

/// The start's memory.
#[derive(Clone, Debug, Default)]
pub(super) struct Start {
    /// Of each knot, from the first.
    seconds: Vec<f64>,
    current: Vec<f64>,
    /// Collected on the segment that ends at each knot.
    light: Vec<f64>,
    levels: Vec<(f64, f64)>,
}

impl Start {
    /// Fills `u` with the start at each knot.
    pub(super) fn fill(&mut self, problem: &MapProblem<'_>, knots: &Knots, u: &mut Vec<f64>) {
        for column in [&mut self.seconds, &mut self.current, &mut self.light, u] {
            column.resize(knots.len(), 0.0);
        }
        let begin_ns = knots.t_ns[0];
        for (seconds, t_ns) in self.seconds.iter_mut().zip(&knots.t_ns) {
            *seconds = (t_ns - begin_ns) as f64 * 1e-9;
        }
        steps(problem, knots, &self.seconds, u);
        collect(&self.seconds, u, &mut self.current, &mut self.light);
        self.find_levels(problem, knots);
        self.add_levels(u);
    }

    /// The level at which the steps collect what each frame has.
    fn find_levels(&mut self, problem: &MapProblem<'_>, knots: &Knots) {
        self.levels.clear();
        let mut light = 0.0;
        let mut begun_s = 0.0;
        for j in 0..knots.len() {
            light += self.light[j];
            for op in &knots.ops[knots.ops_of(j)] {
                match *op {
                    Op::Expose(_) => {
                        light = 0.0;
                        begun_s = self.seconds[j];
                    }
                    Op::Read(l) => {
                        let bright =
                            f64::max(problem.frames[l as usize].dn - problem.sensor.black_level_dn, DARK_DN);
                        self.levels.push((
                            0.5 * (begun_s + self.seconds[j]),
                            libm::log(bright / (problem.sensor.gain * light)),
                        ));
                    }
                    Op::Latch | Op::Lose | Op::Hint(_) | Op::Fire { .. } => {}
                }
            }
        }
    }

    /// Adds the levels: constant before the first and after the last, linear between.
    fn add_levels(&self, u: &mut [f64]) {
        let Some(&(mut from_s, mut level)) = self.levels.first() else { return };
        let mut slope = 0.0;
        let mut at = 0;
        for (value, &t) in u.iter_mut().zip(&self.seconds) {
            while at < self.levels.len() && self.levels[at].0 <= t {
                (from_s, level) = self.levels[at];
                at += 1;
                slope = self.levels.get(at).map_or(0.0, |next| (next.1 - level) / (next.0 - from_s));
            }
            *value += level + slope * (t - from_s);
        }
    }
}

/// The sum of steps at each knot, in ramps.
fn steps(problem: &MapProblem<'_>, knots: &Knots, seconds: &[f64], u: &mut [f64]) {
    let mut sum = 0.0;
    let (mut last_knot, mut last_s) = (0, 0.0);
    for j in 0..knots.len() {
        u[j] = sum;
        let mut step = 0.0;
        for op in &knots.ops[knots.ops_of(j)] {
            if let Op::Fire { event, polarity, doubted: false, .. } = *op {
                step +=
                    if polarity > 0 { problem.sensor.threshold_on } else { -problem.sensor.threshold_off }
                        + problem.beyond_of(event);
            }
        }
        if step != 0.0 {
            let now_s = seconds[j];
            let from_s = f64::max(last_s, now_s - RAMP_S);
            let rise = step / (now_s - from_s);
            for k in (last_knot + 1)..=j {
                u[k] = sum + rise * f64::max(seconds[k] - from_s, 0.0);
            }
            sum += step;
            (last_knot, last_s) = (j, now_s);
        }
    }
}
