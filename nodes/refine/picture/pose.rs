//! How a rigid picture lies on the sensor over time: an affine map from pixels to the picture's own coordinates.
//!
//! The picture is still in its own coordinates X while the sensor sees it move with the velocity v(x, t) = A(t) x + b(t): along a path
//! dx/dt = v, X stays the same. So X = M(t) x + d(t) with dM/dt = -M A and dd/dt = -M b, and X = x in the middle of the window.

use crate::refine::flow::Affine;

/// Steps of the integration, ns.
const STEP_NS: i64 = 250_000;
/// Corrections of the motion that are fitted: six of the affine velocity, two of its acceleration.
pub(super) const CORRECTIONS: usize = 8;

/// An affine map of places relative to the sensor's middle, pixels: `X = m0 + m1 x + m2 y`, `Y = m3 + m4 x + m5 y`.
pub(super) type Map = [f64; 6];

/// The maps of a window at steady instants.
#[derive(Clone, Debug)]
pub(super) struct Pose {
    first_ns: i64,
    maps: Vec<Map>,
}

impl Pose {
    /// Integrates the velocities `motion` (of places in units of `half` pixels from the sensor's middle) plus a correction over
    /// `middle_ns` plus and minus `reach_ns`.
    pub fn new(motion: impl Fn(i64) -> Affine, half: f64, middle_ns: i64, reach_ns: i64, correction: &[f64; CORRECTIONS]) -> Pose {
        let steps = reach_ns / STEP_NS + 1;
        let velocity = |t_ns: i64| -> Affine {
            let mut p = motion(t_ns);
            let late = (t_ns - middle_ns) as f64 / reach_ns as f64;
            for k in 0..6 {
                p[k] += correction[k];
            }
            p[0] += late * correction[6];
            p[3] += late * correction[7];
            [p[0], p[1] / half, p[2] / half, p[3], p[4] / half, p[5] / half]
        };
        let side = |direction: i64| -> Vec<Map> {
            let mut map = [0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
            let step = |n: i64| {
                let half_way_ns = middle_ns + direction * (n * STEP_NS + STEP_NS / 2);
                // Back along the path over one step, then by the map that holds there.
                map = compose(&map, &flow(&velocity(half_way_ns), -(direction * STEP_NS) as f64 * 1e-6));
                map
            };
            (0..steps).map(step).collect()
        };
        let mut maps = side(-1);
        maps.reverse();
        maps.push([0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        maps.extend(side(1));
        Pose { first_ns: middle_ns - steps * STEP_NS, maps }
    }

    /// The map at an instant of the window.
    pub fn at(&self, t_ns: i64) -> Map {
        let last = self.maps.len() - 1;
        let at = ((t_ns - self.first_ns) as f64 / STEP_NS as f64).clamp(0.0, last as f64);
        let before = usize::min(at as usize, last - 1);
        let share = at - before as f64;
        std::array::from_fn(|k| (1.0 - share) * self.maps[before][k] + share * self.maps[before + 1][k])
    }
}

/// Where a map takes a place.
pub(super) fn apply(map: &Map, x: f64, y: f64) -> (f64, f64) {
    (map[0] + map[1] * x + map[2] * y, map[3] + map[4] * x + map[5] * y)
}

/// `first` after `second`: x goes to first(second(x)).
fn compose(first: &Map, second: &Map) -> Map {
    let (x, y) = apply(first, second[0], second[3]);
    let part = |a: f64, b: f64| (first[1] * a + first[2] * b, first[4] * a + first[5] * b);
    let ((xx, yx), (xy, yy)) = (part(second[1], second[4]), part(second[2], second[5]));
    [x, xx, xy, y, yx, yy]
}

/// Where steady velocities `v = b + A x` carry a place in time h: `exp(h A) x` and the integral of `exp(s A) b`, to the third order.
fn flow(v: &Affine, h: f64) -> Map {
    let [bx, xx, xy, by, yx, yy] = *v;
    let times = |[a, b, c, d]: [f64; 4]| [xx * a + xy * c, xx * b + xy * d, yx * a + yy * c, yx * b + yy * d];
    let first = [xx, xy, yx, yy];
    let second = times(first);
    let third = times(second);
    let one = [1.0, 0.0, 0.0, 1.0];
    let e: [f64; 4] = std::array::from_fn(|k| one[k] + h * (first[k] + h * (second[k] / 2.0 + h * third[k] / 6.0)));
    let f: [f64; 4] = std::array::from_fn(|k| h * (one[k] + h * (first[k] / 2.0 + h * second[k] / 6.0)));
    [f[0] * bx + f[1] * by, e[0], e[1], f[2] * bx + f[3] * by, e[2], e[3]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_turns_is_turned_back() {
        // A turn by 0.05 radians a millisecond about (3, -2), half = 10: v = 0.05 (-(y + 2), x - 3).
        let omega = 0.05;
        let pose = Pose::new(|_| [-omega * 2.0, 0.0, -omega * 10.0, -omega * 3.0, omega * 10.0, 0.0], 10.0, 5_000_000, 8_000_000, &[0.0; CORRECTIONS]);
        for t_ns in [-2_000_000, 4_000_000, 5_000_000, 11_250_000] {
            let angle = -omega * (t_ns - 5_000_000) as f64 * 1e-6;
            let (x, y) = (7.0, 4.0);
            let (a, b) = (x - 3.0, y + 2.0);
            let expected = (3.0 + a * libm::cos(angle) - b * libm::sin(angle), -2.0 + a * libm::sin(angle) + b * libm::cos(angle));
            let found = apply(&pose.at(t_ns), x, y);
            assert!((found.0 - expected.0).abs() + (found.1 - expected.1).abs() < 1e-5, "{t_ns}: {found:?} {expected:?}");
        }
    }

    #[test]
    fn what_speeds_up_is_followed() {
        // v_x = 0.3 + 0.1 t (ms), as a correction of rest: 0.3 and, at the window's end 4 ms later, 0.4 more.
        let pose = Pose::new(|_| [0.0; 6], 10.0, 0, 4_000_000, &[0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.4, 0.0]);
        let (x, y) = apply(&pose.at(4_000_000), 0.0, 0.0);
        assert!((x + 0.3 * 4.0 + 0.05 * 16.0).abs() < 1e-9 && y == 0.0, "{x}");
    }
}
