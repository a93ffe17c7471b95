//! Where the iteration starts: the double integral, joined up.
//!
//! Each event moves log light by its threshold, along a ramp that ends at the event; each frame says at which level. Between
//! the middles of two exposures the level goes over linearly, so that thresholds that are a little wrong do not add up. This is also
//! the safe estimate of a pixel whose problem does not converge.

use super::MapProblem;
use super::knots::{Knots, Op};
use super::segment::collected;

/// A step takes this long, seconds, or since the event before when that is shorter.
const RAMP_S: f64 = 3e-3;
/// What a dark frame counts as, DN above black: its logarithm must exist.
const DARK_DN: f64 = 0.5;

/// The start's memory.
#[derive(Clone, Debug, Default)]
pub(super) struct Start {
    levels: Vec<(f64, f64)>,
}

impl Start {
    /// Fills `u` with the start at each knot.
    pub fn fill(&mut self, problem: &MapProblem<'_>, knots: &Knots, u: &mut Vec<f64>) {
        let seconds = |j: usize| (knots.t_ns[j] - knots.t_ns[0]) as f64 * 1e-9;
        u.clear();
        u.resize(knots.len(), 0.0);
        steps(problem, knots, &seconds, u);
        self.find_levels(problem, knots, &seconds, u);
        let mut at = 0;
        for (j, value) in u.iter_mut().enumerate() {
            let t = seconds(j);
            while at < self.levels.len() && self.levels[at].0 <= t {
                at += 1;
            }
            *value += match (at.checked_sub(1).map(|before| self.levels[before]), self.levels.get(at)) {
                (Some((t0, l0)), Some(&(t1, l1))) => l0 + (l1 - l0) * (t - t0) / (t1 - t0),
                (Some((_, level)), None) | (None, Some(&(_, level))) => level,
                (None, None) => 0.0,
            };
        }
    }

    /// The level at which the steps collect what each frame has.
    fn find_levels(&mut self, problem: &MapProblem<'_>, knots: &Knots, seconds: &impl Fn(usize) -> f64, u: &[f64]) {
        self.levels.clear();
        let mut light = 0.0;
        let mut begun_s = 0.0;
        for j in 0..knots.len() {
            if j > 0 {
                light += collected(u[j - 1], u[j], seconds(j) - seconds(j - 1));
            }
            for op in &knots.ops[knots.ops_of(j)] {
                match *op {
                    Op::Expose(_) => {
                        light = 0.0;
                        begun_s = seconds(j);
                    }
                    Op::Read(l) => {
                        let bright = f64::max(problem.frames[l as usize].dn - problem.sensor.black_level_dn, DARK_DN);
                        self.levels.push((0.5 * (begun_s + seconds(j)), libm::log(bright / (problem.sensor.gain * light))));
                    }
                    Op::Latch | Op::Hint(_) | Op::Fire { .. } => {}
                }
            }
        }
    }
}

/// The sum of steps at each knot, in ramps.
fn steps(problem: &MapProblem<'_>, knots: &Knots, seconds: &impl Fn(usize) -> f64, u: &mut [f64]) {
    let mut sum = 0.0;
    let (mut last_knot, mut last_s) = (0, 0.0);
    for j in 0..knots.len() {
        u[j] = sum;
        let mut step = 0.0;
        for op in &knots.ops[knots.ops_of(j)] {
            if let Op::Fire { polarity, .. } = *op {
                step += if polarity > 0 { problem.sensor.threshold_on } else { -problem.sensor.threshold_off };
            }
        }
        if step != 0.0 {
            let now_s = seconds(j);
            let from_s = f64::max(last_s, now_s - RAMP_S);
            for k in (last_knot + 1)..=j {
                let share = (seconds(k) - from_s) / (now_s - from_s);
                u[k] = sum + step * f64::max(share, 0.0);
            }
            sum += step;
            (last_knot, last_s) = (j, now_s);
        }
    }
}
