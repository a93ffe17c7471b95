//! Elements of scenes: edges and stripes averaged over a pixel, lines, moving points.
//!
//! Anti-aliasing is along the edge's normal: an edge covers a pixel from none to all while it moves by one
//! pixel. That is exact for edges along rows or columns and keeps the mean for all others (the ramp is a
//! little steeper than a slanted edge's own).

use photocurrent_core::Extent;
use photocurrent_core::quantity::Rotation;
use std::f64::consts::TAU;

/// How much of a pixel lies inside a shape, 0 to 1, from the signed distance of its centre to the outline,
/// pixels; positive is outside.
pub fn covered(distance: f64) -> f64 {
    coverage_at_depth(-distance, 0.5)
}

/// The same from how deep within the outline the centre lies, pixels, of an edge so wide on either side.
pub fn coverage_at_depth(depth: f64, edge: f64) -> f64 {
    (0.5 + 0.5 * depth / edge).clamp(0.0, 1.0)
}

/// Mean over a pixel of stripes that are 1 on `[0, 1)` and 0 on `[1, 2)`, and so on. `at` is the pixel's
/// centre in stripes, `width` its size in stripes.
pub fn stripes(at: f64, width: f64) -> f64 {
    let whole = |to: f64| {
        let turns = (to / 2.0).floor();
        turns + (to - 2.0 * turns).min(1.0)
    };
    (whole(at + width / 2.0) - whole(at - width / 2.0)) / width
}

/// Distance from a place in stripes to the nearest border between two.
pub fn to_border(at: f64) -> f64 {
    let part = at - at.floor();
    part.min(1.0 - part)
}

/// `low` to `high` as `share` goes from 0 to 1.
pub fn blend(low: f64, high: f64, share: f64) -> f64 {
    low + (high - low) * share
}

/// A coordinate that runs on for ever, reflected between two walls.
pub fn bounce(at: f64, low: f64, high: f64) -> f64 {
    let span = high - low;
    let phase = (at - low).rem_euclid(2.0 * span);
    low + if phase > span { 2.0 * span - phase } else { phase }
}

/// (x, y) turned by an angle given as (sine, cosine); with `y` down, a positive angle is clockwise on the
/// screen.
pub fn rotate((x, y): (f64, f64), (sine, cosine): (f64, f64)) -> (f64, f64) {
    (x * cosine - y * sine, x * sine + y * cosine)
}

/// When something that is `distance` pixels away can be here at the earliest. The distance that a pixel's own
/// half and its corner take is left out.
pub fn arrival(t_ns: i64, distance: f64, speed: f64) -> i64 {
    // The square pixel's filter is one pixel wide along any normal; a hundredth more is for rounding.
    let clear = distance - 0.51;
    if clear <= 0.0 {
        return t_ns;
    }
    let wait = clear / speed;
    // Beyond a hundred years it does not come.
    if wait > 3e18 { i64::MAX } else { t_ns.saturating_add(wait as i64) }
}

/// Way from the nearest place of a line from `a` to `b` to a place, pixels.
pub fn from_line((x, y): (f64, f64), a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    let (along_x, along_y) = (b.0 - a.0, b.1 - a.1);
    let squared = f64::max(along_x * along_x + along_y * along_y, 1e-9);
    let share = (((x - a.0) * along_x + (y - a.1) * along_y) / squared).clamp(0.0, 1.0);
    (x - a.0 - share * along_x, y - a.1 - share * along_y)
}

/// End point of a bone of a length at an angle, rad: it hangs down at 0 and swings to the right for positive
/// angles.
pub fn bone(from: (f64, f64), length: f64, angle: f64) -> (f64, f64) {
    (from.0 + length * libm::sin(angle), from.1 + length * libm::cos(angle))
}

/// The middle of a picture.
pub fn picture_centre(extent: Extent) -> (f64, f64) {
    (f64::from(extent.width - 1) / 2.0, f64::from(extent.height - 1) / 2.0)
}

/// Angular speed, radians per nanosecond.
pub fn radians_per_ns(speed: Rotation) -> f64 {
    TAU * speed.turns_per_s() * 1e-9
}

/// Length of (x, y).
pub fn hypot(x: f64, y: f64) -> f64 {
    (x * x + y * y).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coordinate_bounces_between_its_walls() {
        assert_eq!([5.0, 12.0, 15.0, 21.0].map(|at| bounce(at, 2.0, 10.0)), [5.0, 8.0, 5.0, 5.0]);
    }

    #[test]
    fn averaging_over_a_pixel_keeps_the_mean_of_stripes() {
        for width in [0.05, 0.3, 1.0, 2.7] {
            let n = 4000;
            let mean =
                (0..n).map(|k| stripes(-3.0 + 8.0 * (f64::from(k) + 0.5) / f64::from(n), width)).sum::<f64>()
                    / f64::from(n);
            assert!((mean - 0.5).abs() < 1e-3, "{mean} at {width}");
        }
        // As wide as a whole period, nothing is left to see.
        assert!((stripes(0.77, 2.0) - 0.5).abs() < 1e-12);
        for (at, mean) in [(0.5, 1.0), (1.5, 0.0), (-0.5, 0.0), (1.0, 0.5)] {
            assert!((stripes(at, 0.2) - mean).abs() < 1e-12);
        }
    }

    #[test]
    fn a_disk_drawn_by_coverage_has_its_area() {
        let radius = 7.3;
        let area: f64 = (0..40)
            .flat_map(|y| {
                (0..40).map(move |x| covered(hypot(f64::from(x) - 19.2, f64::from(y) - 20.7) - radius))
            })
            .sum();
        // Coverage along the normal leaves out the outline's bend: pi / 12 of area in all.
        assert!((area - std::f64::consts::PI * radius * radius).abs() < 0.5, "{area}");
    }

    #[test]
    fn what_is_far_needs_time() {
        assert_eq!(arrival(5, 0.3, 1e-6), 5);
        assert_eq!(arrival(5, 10.51, 1e-6), 5 + 10_000_000);
        assert_eq!(arrival(5, 10.0, 0.0), i64::MAX);
        assert_eq!(from_line((3.0, 4.0), (0.0, 0.0), (0.0, 2.0)), (3.0, 2.0));
    }
}
