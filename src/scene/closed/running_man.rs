//! `running_man`: a figure of head, trunk and limbs that runs, slowly.
//!
//! Limbs are lines with thickness, their joints swing with the stride. A stride is tabulated finely and
//! linear between the table's poses, so that a pose costs little at any instant. The figure that leaves on
//! the right comes back on the left.

use super::shapes::{arrival, blend, bone, covered, from_line, hypot};
use super::surface::Texture;
use super::{ClosedScene, DARKEST};
use photocurrent_core::Extent;
use photocurrent_core::quantity::Duration;
use photocurrent_core::random::Random;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// Parameters of the scene `running_man`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RunningManParams {
    /// Height of the figure, as a share of the picture's smaller side.
    #[schemars(range(min = 0.1, max = 0.95))]
    pub height: f64,
    /// Time of two steps, one of each leg.
    #[schemars(extend("x-min" = "10 ms", "x-max" = "1000 s"))]
    pub stride: Duration,
    /// Speed to the right, pixels per millisecond.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub speed: f64,
}

impl Default for RunningManParams {
    fn default() -> Self {
        RunningManParams { height: 0.8, stride: Duration::new(700_000_000), speed: 0.2 }
    }
}

/// Poses in a stride.
const POSES: usize = 512;

type FigurePoint = (f64, f64);

/// A limb: from joint to joint, half its thickness in heights of the figure, its grey. From the back to the
/// front.
const LIMBS: [(usize, usize, f64, f64); 11] = [
    (NECK, FAR_ELBOW, 0.028, 0.35),
    (FAR_ELBOW, FAR_ELBOW + 1, 0.022, 0.45),
    (HIP, FAR_KNEE, 0.042, 0.10),
    (FAR_KNEE, FAR_KNEE + 1, 0.030, 0.14),
    (NECK, HIP, 0.070, 0.80),
    (HEAD, HEAD, 0.070, 0.60),
    (HIP, NEAR_KNEE, 0.045, DARKEST),
    (NEAR_KNEE, NEAR_KNEE + 1, 0.032, 0.06),
    (NEAR_KNEE + 1, TOE, 0.020, 0.90),
    (NECK, NEAR_ELBOW, 0.030, 0.65),
    (NEAR_ELBOW, NEAR_ELBOW + 1, 0.024, 0.75),
];

/// Joints by number; behind an elbow comes its hand, behind a knee its foot.
const HEAD: usize = 0;
const NECK: usize = 1;
const HIP: usize = 2;
const NEAR_ELBOW: usize = 3;
const FAR_ELBOW: usize = 5;
const NEAR_KNEE: usize = 7;
const FAR_KNEE: usize = 9;
const TOE: usize = 11;
const JOINTS: usize = 12;

/// Where the joints are at a phase of the stride, in heights of the figure from the ground below its hip; up
/// is negative.
fn joint_positions(phase: f64) -> [FigurePoint; JOINTS] {
    let mut joints = [(0.0, 0.0); JOINTS];
    joints[HIP] = (0.0, -0.50 - 0.02 * libm::cos(2.0 * phase));
    joints[NECK] = bone(joints[HIP], -0.30, -0.15);
    joints[HEAD] = bone(joints[NECK], -0.11, -0.1);
    for (knee, elbow, phase) in [(NEAR_KNEE, NEAR_ELBOW, phase), (FAR_KNEE, FAR_ELBOW, phase + PI)] {
        let thigh = 0.25 + 0.75 * libm::sin(phase);
        // The knee is straight when the foot is ahead and bends as the leg comes forwards.
        let bend = 0.75 + 0.65 * libm::cos(phase + 0.3);
        joints[knee] = bone(joints[HIP], 0.24, thigh);
        joints[knee + 1] = bone(joints[knee], 0.23, thigh - bend);
        let arm = -0.75 * libm::sin(phase);
        joints[elbow] = bone(joints[NECK], 0.16, arm);
        joints[elbow + 1] = bone(joints[elbow], 0.15, arm + 1.5);
        if knee == NEAR_KNEE {
            joints[TOE] = bone(joints[knee + 1], 0.06, thigh - bend + 1.4);
        }
    }
    joints
}

/// The scene.
pub struct RunningMan {
    poses: Vec<[FigurePoint; JOINTS]>,
    height: f64,
    ground: f64,
    start: f64,
    /// Pixels after which the figure repeats.
    span: f64,
    /// Pixels per nanosecond.
    speed: f64,
    fastest: f64,
    stride_ns: f64,
    wall: Texture,
}

impl RunningMan {
    /// For a picture of that size.
    pub fn new(params: &RunningManParams, extent: Extent, seed: u64) -> RunningMan {
        let (width, height) = (f64::from(extent.width), f64::from(extent.height));
        let figure = params.height * width.min(height);
        let mut random = Random::new(seed, &[0]);
        let first = TAU * random.uniform();
        let poses: Vec<[FigurePoint; JOINTS]> = (0..POSES)
            .map(|k| {
                joint_positions(first + TAU * k as f64 / POSES as f64).map(|(x, y)| (x * figure, y * figure))
            })
            .collect();
        let stride_ns = params.stride.ns() as f64;
        let step_ns = stride_ns / POSES as f64;
        let swing = (0..POSES)
            .flat_map(|k| {
                let (now, next) = (&poses[k], &poses[(k + 1) % POSES]);
                (0..JOINTS)
                    .map(move |joint| hypot(next[joint].0 - now[joint].0, next[joint].1 - now[joint].1))
                    .collect::<Vec<_>>()
            })
            .fold(0.0, f64::max);
        let speed = params.speed * 1e-6;
        RunningMan {
            poses,
            height: figure,
            ground: (height + figure) / 2.0,
            start: 0.35 * width,
            span: width + 1.2 * figure,
            speed,
            fastest: speed + swing / step_ns,
            stride_ns,
            wall: Texture::new(0.15, 0.6, seed, 1),
        }
    }

    /// A place as seen from the figure's ground point; of the figure and its repetitions, the nearest counts.
    fn in_figure(&self, x: f64, y: f64, t_ns: i64) -> FigurePoint {
        let dx = x - self.start - self.speed * t_ns as f64;
        (dx - self.span * (dx / self.span).round(), y - self.ground)
    }

    /// Is a place far enough that no limb can be near, and how far?
    fn distance_outside(&self, place: FigurePoint) -> f64 {
        hypot(place.0, place.1 + 0.5 * self.height) - 0.62 * self.height
    }

    /// Signed distances to the limbs from back to front.
    fn distances(&self, place: FigurePoint, t_ns: i64) -> [f64; LIMBS.len()] {
        let at = (t_ns as f64 / self.stride_ns).rem_euclid(1.0) * POSES as f64;
        let (whole, part) = (at as usize % POSES, at - at.floor());
        let (now, next) = (&self.poses[whole], &self.poses[(whole + 1) % POSES]);
        let joint = |j: usize| (blend(now[j].0, next[j].0, part), blend(now[j].1, next[j].1, part));
        LIMBS.map(|(from, to, half, _)| {
            let (dx, dy) = from_line(place, joint(from), joint(to));
            hypot(dx, dy) - half * self.height
        })
    }
}

impl ClosedScene for RunningMan {
    fn light(&self, x: f64, y: f64, t_ns: i64) -> f64 {
        let wall = self.wall.at(x, y);
        let place = self.in_figure(x, y, t_ns);
        if self.distance_outside(place) > 0.5 {
            return wall;
        }
        let limbs = self.distances(place, t_ns).into_iter().zip(LIMBS);
        limbs.fold(wall, |behind, (distance, (_, _, _, grey))| blend(behind, grey, covered(distance)))
    }

    fn speed(&self, _: f64, _: f64) -> f64 {
        self.fastest
    }

    fn still_until(&self, x: f64, y: f64, t_ns: i64) -> i64 {
        let place = self.in_figure(x, y, t_ns);
        let aside = self.distance_outside(place);
        if aside > 2.0 {
            return arrival(t_ns, aside, self.speed);
        }
        // A line's distance changes no faster than its ends move.
        let nearest = self.distances(place, t_ns).into_iter().map(f64::abs).fold(f64::INFINITY, f64::min);
        arrival(t_ns, nearest, self.fastest)
    }
}

#[cfg(test)]
mod tests {
    use super::super::EXTENT;
    use super::*;

    #[test]
    fn bones_keep_their_length_and_stay_in_the_figures_circle() {
        for k in 0..200 {
            let joints = joint_positions(TAU * f64::from(k) / 200.0);
            let length = |a: usize, b: usize| hypot(joints[a].0 - joints[b].0, joints[a].1 - joints[b].1);
            assert!(
                (length(HIP, NEAR_KNEE) - 0.24).abs() < 1e-12
                    && (length(FAR_KNEE, FAR_KNEE + 1) - 0.23).abs() < 1e-12
            );
            for (from, to, half, _) in LIMBS {
                for (x, y) in [joints[from], joints[to]] {
                    assert!(hypot(x, y + 0.5) + half < 0.62, "a joint at ({x}, {y})");
                }
            }
        }
    }

    #[test]
    fn legs_move_in_opposite_phase() {
        let (now, later) = (joint_positions(0.8), joint_positions(0.8 + PI));
        assert!((now[NEAR_KNEE].0 - later[FAR_KNEE].0).abs() < 1e-12);
    }

    #[test]
    fn after_a_stride_the_figure_is_the_same_further_on() {
        let man = RunningMan::new(&RunningManParams::default(), EXTENT, 7);
        // 700 ms at 0.2 px/ms: 140 pixels, and the wall is left out of the comparison by looking at
        // distances.
        let (before, after) = (
            man.distances(man.in_figure(30.0, 30.0, 0), 0),
            man.distances(man.in_figure(170.0, 30.0, 700_000_000), 700_000_000),
        );
        assert!(before.iter().zip(after).all(|(a, b)| (a - b).abs() < 1e-6));
    }
}
