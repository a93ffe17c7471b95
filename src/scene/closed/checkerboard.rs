//! `checkerboard`: a board of squares without end that slides and turns.
//!
//! The mean over a pixel is taken along the board's own axes, where it is a product of two means in closed
//! form.

use super::ClosedScene;
use super::shapes::{arrival, blend, hypot, picture_centre, radians_per_ns, rotate, stripes, to_border};
use photocurrent_core::Extent;
use photocurrent_core::quantity::Rotation;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Parameters of the scene `checkerboard`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CheckerboardParams {
    /// Side of a square, pixels.
    #[schemars(range(min = 2.0, max = 1000.0))]
    pub square: f64,
    /// How fast the board slides, pixels per millisecond, right and a little down.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub speed: f64,
    /// How fast it turns around the middle of the picture, clockwise.
    #[schemars(extend("x-min" = "0 rpm", "x-max" = "100000 rpm"))]
    pub turning: Rotation,
    /// How it lies at the start, degrees clockwise.
    #[schemars(range(min = -180.0, max = 180.0))]
    pub angle: f64,
}

impl Default for CheckerboardParams {
    fn default() -> Self {
        CheckerboardParams { square: 16.0, speed: 2.0, turning: Rotation::new(20.0), angle: 15.0 }
    }
}

/// Reflectances of the two kinds of square.
const SQUARES: (f64, f64) = (0.05, 0.85);

/// The scene.
pub struct Checkerboard {
    centre: (f64, f64),
    square: f64,
    /// Pixels per nanosecond.
    velocity: (f64, f64),
    /// Radians, and radians per nanosecond.
    angle: f64,
    turning: f64,
}

impl Checkerboard {
    /// For a picture of that size.
    pub fn new(params: &CheckerboardParams, extent: Extent) -> Checkerboard {
        // 20 degrees off the rows: no edge moves along itself.
        let heading = 20f64.to_radians();
        let speed = params.speed * 1e-6;
        Checkerboard {
            centre: picture_centre(extent),
            square: params.square,
            velocity: (speed * libm::cos(heading), speed * libm::sin(heading)),
            angle: params.angle.to_radians(),
            turning: radians_per_ns(params.turning),
        }
    }

    /// A place on the board, in squares. The board first turns around the picture's middle; what slides is
    /// the board before it is turned.
    fn on_board(&self, x: f64, y: f64, t_ns: i64) -> (f64, f64) {
        let t = t_ns as f64;
        let angle = -(self.angle + self.turning * t);
        let (u, v) = rotate((x - self.centre.0, y - self.centre.1), (libm::sin(angle), libm::cos(angle)));
        ((u - self.velocity.0 * t) / self.square, (v - self.velocity.1 * t) / self.square)
    }
}

impl ClosedScene for Checkerboard {
    fn light(&self, x: f64, y: f64, t_ns: i64) -> f64 {
        let (u, v) = self.on_board(x, y, t_ns);
        let pixel = 1.0 / self.square;
        let (a, b) = (stripes(u, pixel), stripes(v, pixel));
        blend(SQUARES.0, SQUARES.1, a * b + (1.0 - a) * (1.0 - b))
    }

    fn speed(&self, x: f64, y: f64) -> f64 {
        let from_centre = hypot(x - self.centre.0, y - self.centre.1);
        hypot(self.velocity.0, self.velocity.1) + self.turning * (from_centre + 1.0)
    }

    fn still_until(&self, x: f64, y: f64, t_ns: i64) -> i64 {
        let (u, v) = self.on_board(x, y, t_ns);
        arrival(t_ns, to_border(u).min(to_border(v)) * self.square, self.speed(x, y))
    }
}

#[cfg(test)]
mod tests {
    use super::super::EXTENT;
    use super::*;

    #[test]
    fn without_turning_the_board_repeats_after_two_squares() {
        let params = CheckerboardParams { square: 10.0, speed: 4.0, turning: Rotation::new(0.0), angle: 0.0 };
        let board = Checkerboard::new(&params, EXTENT);
        for (x, y) in [(3.0, 4.0), (41.0, 17.0)] {
            // A place that moves with the board sees the same.
            let (dx, dy) = (board.velocity.0 * 3e6, board.velocity.1 * 3e6);
            assert!((board.light(x, y, 0) - board.light(x + dx, y + dy, 3_000_000)).abs() < 1e-9);
            assert!((board.light(x, y, 0) - board.light(x + 20.0, y, 0)).abs() < 1e-9);
        }
        assert!((hypot(board.velocity.0, board.velocity.1) * 1e6 - 4.0).abs() < 1e-9);
    }

    #[test]
    fn half_of_it_is_bright() {
        // Without an angle, whole squares fill the picture: 8 by 6 of side 10.
        let params = CheckerboardParams { square: 10.0, angle: 0.0, ..CheckerboardParams::default() };
        let board = Checkerboard::new(&params, EXTENT);
        let pixels =
            EXTENT.rows().iter().flat_map(|y| (0..EXTENT.width).map(move |x| (f64::from(x), f64::from(y))));
        let mean = pixels.map(|(x, y)| board.light(x, y, 0)).sum::<f64>() / EXTENT.pixels() as f64;
        assert!((mean - 0.45).abs() < 1e-9, "{mean}");
    }
}
