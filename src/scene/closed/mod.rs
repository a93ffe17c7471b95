//! Scenes in closed form: linear light at any place and instant, for the simulator, for known targets and for
//! the recordings of a diagnosis' calibration.
//!
//! Pixels are unit squares with their centre at whole numbers, `x` to the right and `y` down. Edges are
//! anti-aliased: a scene returns the mean over a pixel, from coverage in closed form, so that an edge that
//! crosses a pixel makes a ramp and not a jump. Two bounds make sampling quick: the largest speed, and the
//! time without changes.
//!
//! Every scene is one file: its parameters, its struct, its tests; [`sketch`] has those with edges of a
//! stated width, for random parameters. [`shapes`] has outlines and motions, [`surface`] random surfaces.
//! Random values come from the seed alone.

pub mod basketball;
pub mod checkerboard;
pub mod colour_wheel;
mod disk;
pub mod fan;
pub mod pellet;
pub mod running_man;
pub mod shapes;
pub mod siemens_disk;
pub mod sketch;
pub mod slingshot_egg;
pub mod surface;
pub mod texture;

use crate::light::LightKnots;

/// The darkest and the brightest reflectance of any scene: black felt and white paper.
pub const DARKEST: f64 = 0.03;
/// See [`DARKEST`].
pub const BRIGHTEST: f64 = 0.95;

/// A scene in closed form.
pub trait ClosedScene: Send + Sync {
    /// Mean linear light of the pixel centred at (x, y) at an instant: reflectance, [`DARKEST`] to
    /// [`BRIGHTEST`]; photocurrent of a scene before a sensor.
    fn light(&self, x: f64, y: f64, t_ns: i64) -> f64;

    /// The same behind a filter of red (0), green (1) or blue (2); equal for grey objects. Both bounds hold
    /// for it, too.
    fn channel(&self, _channel: usize, x: f64, y: f64, t_ns: i64) -> f64 {
        self.light(x, y, t_ns)
    }

    /// Upper bound on how fast anything crosses this pixel, pixels per nanosecond. Sampling steps follow from
    /// it.
    fn speed(&self, x: f64, y: f64) -> f64;

    /// The pixel's light is constant from `t_ns` to the instant given, at least; `t_ns` where no such
    /// instant is known, `i64::MAX` for ever.
    fn still_until(&self, _x: f64, _y: f64, t_ns: i64) -> i64 {
        t_ns
    }

    /// The pixel's light between two instants, linear between knots.
    fn knots(&self, x: f64, y: f64, span: (i64, i64)) -> LightKnots {
        /// A pixel's light hardly bends while the scene moves so far, pixels; and not more often than this,
        /// ns.
        const STEP: (f64, i64) = (0.1, 25_000);
        let step_ns = ((STEP.0 / f64::max(self.speed(x, y), 1e-9)) as i64).clamp(STEP.1, 200_000);
        let t: Vec<i64> = (0..=(span.1 - span.0) / step_ns + 1).map(|k| span.0 + k * step_ns).collect();
        let light = t.iter().map(|t| self.light(x, y, *t)).collect();
        (t, light)
    }
}

#[cfg(test)]
const EXTENT: photocurrent_core::Extent = photocurrent_core::Extent { width: 80, height: 60 };
