//! How the picture lies on the array over time: shift, turn, scale and shear, each a cubic spline of time.
//!
//! All are in pixels: turn, scale and shear are what they move a point at the edge of the array
//! ([`PictureMotion::half`] from its centre).

use super::spline::{ORDER, weights};

/// Numbers of a pose: shift along x and y, turn, scale, shear, and shear at 45 degrees.
pub(crate) const DEGREES: usize = 6;
/// The first of them that a rigid motion does not have.
pub(crate) const RIGID: usize = 3;

/// Shift, turn, scale and shears, pixels.
pub(crate) type AffinePose = [f64; DEGREES];

/// An affine map of places in pixels from the array's centre: `X = m0 + m1 x + m2 y`, `Y = m3 + m4 x + m5 y`.
pub(crate) type AffineMap = [f64; 6];

/// The map of a pose.
pub(crate) fn map_of(pose: &AffinePose, half: f64) -> AffineMap {
    let (turn, scale, a, b) = (pose[2] / half, libm::exp(pose[3] / half), pose[4] / half, pose[5] / half);
    let (c, s) = (scale * libm::cos(turn), scale * libm::sin(turn));
    [
        pose[0],
        c * (1.0 + a) - s * b,
        c * b - s * (1.0 - a),
        pose[1],
        s * (1.0 + a) + c * b,
        s * b + c * (1.0 - a),
    ]
}

/// The pose of a map.
pub(crate) fn pose_of(map: &AffineMap, half: f64) -> AffinePose {
    // A = k R(turn) (1 + a, b; b, 1 - a): sums give turn and scale, differences the shears.
    let turn = libm::atan2(map[4] - map[2], map[1] + map[5]);
    let scale = 0.5 * libm::hypot(map[4] - map[2], map[1] + map[5]);
    let (c, s) = (libm::cos(turn) / scale, libm::sin(turn) / scale);
    let (first, second) = (
        (c * map[1] + s * map[4], c * map[2] + s * map[5]),
        (-s * map[1] + c * map[4], -s * map[2] + c * map[5]),
    );
    let (a, b) = (0.5 * (first.0 - second.1), 0.5 * (first.1 + second.0));
    [map[0], map[3], turn * half, libm::log(scale) * half, a * half, b * half]
}

/// Where a map takes a place.
#[inline]
pub(crate) fn apply(map: &AffineMap, x: f64, y: f64) -> (f64, f64) {
    (map[0] + map[1] * x + map[2] * y, map[3] + map[4] * x + map[5] * y)
}

/// `first` after `second`.
pub(crate) fn compose(first: &AffineMap, second: &AffineMap) -> AffineMap {
    let (x, y) = apply(first, second[0], second[3]);
    let part = |a: f64, b: f64| (first[1] * a + first[2] * b, first[4] * a + first[5] * b);
    let ((xx, yx), (xy, yy)) = (part(second[1], second[4]), part(second[2], second[5]));
    [x, xx, xy, y, yx, yy]
}

/// Derivatives of the place that a pose takes (`x`, `y`) to, by each of its numbers.
#[inline]
pub(crate) fn derivatives(
    map: &AffineMap,
    pose: &AffinePose,
    half: f64,
    x: f64,
    y: f64,
) -> [(f64, f64); DEGREES] {
    let (px, py) = apply(map, x, y);
    let (dx, dy) = ((px - map[0]) / half, (py - map[3]) / half);
    let scale = libm::exp(pose[3] / half);
    let (c, s) = (scale * libm::cos(pose[2] / half) / half, scale * libm::sin(pose[2] / half) / half);
    [
        (1.0, 0.0),
        (0.0, 1.0),
        (-dy, dx),
        (dx, dy),
        (c * x + s * y, s * x - c * y),
        (c * y - s * x, s * y + c * x),
    ]
}

/// The motion of a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureMotion {
    /// Splines hold from this instant on, ns.
    pub start_ns: i64,
    /// Time between knots, ns.
    pub knot_ns: i64,
    /// Half of the array's longer side, pixels.
    pub half: f64,
    /// The splines' coefficients.
    pub knots: Vec<AffinePose>,
}

impl PictureMotion {
    /// No motion, over a span of time.
    pub fn at_rest(span: (i64, i64), knot_ns: i64, half: f64) -> PictureMotion {
        let intervals = ((span.1 - span.0).max(1) as u64).div_ceil(knot_ns as u64) as usize;
        PictureMotion { start_ns: span.0, knot_ns, half, knots: vec![[0.0; DEGREES]; intervals + ORDER - 1] }
    }

    /// The first of the four knots that hold at an instant, and their weights; the nearest end of the spline
    /// beyond it.
    #[inline]
    pub fn weights(&self, t_ns: i64) -> (usize, [f64; ORDER]) {
        let place = (t_ns - self.start_ns) as f64 / self.knot_ns as f64;
        let last = (self.knots.len() - ORDER) as f64;
        let interval = place.floor().clamp(0.0, last);
        (interval as usize, weights((place - interval).clamp(0.0, 1.0)))
    }

    /// The pose at an instant.
    #[inline]
    pub fn pose(&self, t_ns: i64) -> AffinePose {
        let (first, weights) = self.weights(t_ns);
        let mut pose = [0.0; DEGREES];
        for (knot, weight) in self.knots[first..first + ORDER].iter().zip(weights) {
            for (sum, value) in pose.iter_mut().zip(knot) {
                *sum += weight * value;
            }
        }
        pose
    }

    /// The map at an instant.
    #[inline]
    pub fn at(&self, t_ns: i64) -> AffineMap {
        map_of(&self.pose(t_ns), self.half)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_and_maps_are_the_same_and_derivatives_are_differences() {
        let half = 40.0;
        let pose = [3.0, -2.0, 11.0, 2.0, -1.5, 0.8];
        let map = map_of(&pose, half);
        let again = pose_of(&map, half);
        assert!(pose.iter().zip(again).all(|(a, b)| (a - b).abs() < 1e-9), "{again:?}");
        let (x, y, step) = (13.0, -21.0, 1e-5);
        let found = derivatives(&map, &pose, half, x, y);
        for d in 0..DEGREES {
            let (mut more, mut less) = (pose, pose);
            more[d] += step;
            less[d] -= step;
            let (a, b) = (apply(&map_of(&more, half), x, y), apply(&map_of(&less, half), x, y));
            let expected = ((a.0 - b.0) / (2.0 * step), (a.1 - b.1) / (2.0 * step));
            assert!(
                (found[d].0 - expected.0).abs() < 1e-6 && (found[d].1 - expected.1).abs() < 1e-6,
                "{d}: {:?} {expected:?}",
                found[d]
            );
        }
    }
}
