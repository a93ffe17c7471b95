//! Follows places along a motion in time.

use crate::flow::Flow;
use rayon::prelude::*;

/// Motion is followed in steps of at most this, ns.
const STEP_NS: i64 = 1_000_000;
/// Pitch of the pixels of a row and of a column that are followed; places between are linear.
const PITCH: usize = 2;

/// Follows a motion.
pub struct MotionPath<'a> {
    flow: &'a Flow,
}

impl<'a> MotionPath<'a> {
    /// Along this motion.
    pub fn new(flow: &'a Flow) -> MotionPath<'a> {
        MotionPath { flow }
    }

    /// The place at `to_ns` of the object that is at a place at `from_ns`.
    pub fn follow(&self, (mut x, mut y): (f64, f64), from_ns: i64, to_ns: i64) -> (f64, f64) {
        let steps = ((to_ns - from_ns).unsigned_abs().div_ceil(STEP_NS as u64)).max(1);
        let step_ns = (to_ns - from_ns) as f64 / steps as f64;
        for n in 0..steps {
            let at = |share: f64| from_ns + ((n as f64 + share) * step_ns) as i64;
            // The midpoint rule.
            let v = self.flow.at(x, y, at(0.0));
            let half = 0.5 * step_ns * 1e-6;
            let v = self.flow.at(x + half * v[0], y + half * v[1], at(0.5));
            (x, y) = (x + 2.0 * half * v[0], y + 2.0 * half * v[1]);
        }
        (x, y)
    }

    /// The places of all pixels of a picture, row by row: each row is exposed at one of `t_ns`, and each row
    /// there at `there(row)`.
    pub(super) fn follow_pixels(
        &self,
        (width, height): (usize, usize),
        t_ns: &[i64],
        there: &(dyn Fn(usize) -> i64 + Sync),
    ) -> Vec<(f32, f32)> {
        let (columns, lines) = (width.div_ceil(PITCH) + 1, height.div_ceil(PITCH) + 1);
        let of = |at: usize| {
            let (x, y) = (at % columns * PITCH, usize::min(at / columns * PITCH, height - 1));
            let own = (x as f64, y as f64);
            let first = self.follow(own, t_ns[y], there(y));
            // It stands in another row by then, which is exposed at another time.
            let row = (first.1.round().max(0.0) as usize).min(height - 1);
            let (x, y) = if there(row) == there(y) { first } else { self.follow(own, t_ns[y], there(row)) };
            ((x - own.0) as f32, (y - own.1) as f32)
        };
        let coarse: Vec<(f32, f32)> = (0..columns * lines).into_par_iter().map(of).collect();
        let mut places = Vec::with_capacity(width * height);
        for y in 0..height {
            let (line, dy) = (y / PITCH, (y % PITCH) as f32 / PITCH as f32);
            for x in 0..width {
                let (column, dx) = (x / PITCH, (x % PITCH) as f32 / PITCH as f32);
                let at = line * columns + column;
                let (a, b, c, d) =
                    (coarse[at], coarse[at + 1], coarse[at + columns], coarse[at + columns + 1]);
                let between = |a: f32, b: f32, c: f32, d: f32| {
                    (1.0 - dy) * (a + dx * (b - a)) + dy * (c + dx * (d - c))
                };
                places.push((x as f32 + between(a.0, b.0, c.0, d.0), y as f32 + between(a.1, b.1, c.1, d.1)));
            }
        }
        places
    }
}
