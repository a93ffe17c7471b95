//! Where in the photo a pixel of the sensor looks, exactly, at any instant.
//!
//! A point of the photo that stands at `q` at time 0 stands at `p` later:
//!
//! `p(t) = c + exp(z t) R(w t) (q - c) + v t + a sin(TAU f t) d`
//!
//! with the centre `c`, the zoom rate `z`, the rotation by `w t` clockwise (`y` points down), the velocity
//! `v`, and the shake of amplitude `a` and frequency `f` along `d`. So the picture turns and grows about the
//! point of the photo that stands at the centre at time 0, and this point moves with `v` and the shake. A
//! sensor's pixel sees the place that this equation, solved for `q`, leads to.

use std::f64::consts::TAU;

/// A motion and the photo's place at time 0, in pixels of the sensor and seconds.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    /// The point about which the picture turns and grows.
    pub centre: (f64, f64),
    /// Pixels per second.
    pub velocity: (f64, f64),
    /// Radians per second, clockwise.
    pub turning: f64,
    /// Relative growth per second.
    pub zoom: f64,
    /// Amplitude of the shake along each axis, pixels.
    pub shake: (f64, f64),
    /// Radians per second of the shake.
    pub shaking: f64,
    /// Pixels of the sensor to one of the photo at time 0.
    pub scale: f64,
    /// The sensor's place of the photo's pixel (0, 0) at time 0.
    pub origin: (f64, f64),
}

/// What a pixel of the sensor sees.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Column in the photo.
    pub x: f64,
    /// Row in the photo.
    pub y: f64,
    /// Pixels of the photo to one of the sensor.
    pub spacing: f64,
}

impl Motion {
    /// What the pixel at (x, y) of the sensor sees at an instant.
    pub fn seen(&self, x: f64, y: f64, t_ns: i64) -> Seen {
        let t = t_ns as f64 * 1e-9;
        let shaken = if self.shaking == 0.0 { 0.0 } else { libm::sin(wrapped(self.shaking * t)) };
        let from =
            |p: f64, centre: f64, velocity: f64, shake: f64| p - centre - velocity * t - shake * shaken;
        let mut q = (
            from(x, self.centre.0, self.velocity.0, self.shake.0),
            from(y, self.centre.1, self.velocity.1, self.shake.1),
        );
        if self.turning != 0.0 {
            let angle = wrapped(self.turning * t);
            let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
            q = (cosine * q.0 + sine * q.1, cosine * q.1 - sine * q.0);
        }
        let grown = if self.zoom == 0.0 { self.scale } else { self.scale * libm::exp(self.zoom * t) };
        let place = |q: f64, centre: f64, origin: f64| q / grown + (centre - origin) / self.scale;
        Seen {
            x: place(q.0, self.centre.0, self.origin.0),
            y: place(q.1, self.centre.1, self.origin.1),
            spacing: 1.0 / grown,
        }
    }

    /// Does nothing move?
    pub fn rests(&self) -> bool {
        let shakes = self.shaking != 0.0 && self.shake != (0.0, 0.0);
        self.velocity == (0.0, 0.0) && self.turning == 0.0 && self.zoom == 0.0 && !shakes
    }

    /// A bound, from 0 to `end_ns`, on how fast the photo passes the pixel at (x, y): pixels of the photo per
    /// nanosecond.
    pub fn fastest(&self, x: f64, y: f64, end_ns: i64) -> f64 {
        let end = end_ns as f64 * 1e-9;
        let length = |(x, y): (f64, f64)| libm::sqrt(x * x + y * y);
        let speed = length(self.velocity) + length(self.shake) * self.shaking;
        // The centre moves along a line: a pixel is furthest from it at the beginning or at the end, but for
        // the shake.
        let away = |t: f64| {
            length((x - self.centre.0 - self.velocity.0 * t, y - self.centre.1 - self.velocity.1 * t))
        };
        let furthest = away(0.0).max(away(end)) + if self.shaking == 0.0 { 0.0 } else { length(self.shake) };
        let smallest = self.scale * libm::exp((self.zoom * end).min(0.0));
        (speed + (self.turning.abs() + self.zoom.abs()) * furthest) / smallest * 1e-9
    }
}

/// The same angle within a turn: sine and cosine of large ones lose nothing then.
fn wrapped(angle: f64) -> f64 {
    angle % TAU
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(crate) const SIZE: (u32, u32) = (64, 48);

    /// Everything at once.
    pub(crate) fn lively() -> Motion {
        Motion {
            centre: (20.0, 30.0),
            velocity: (150.0, -80.0),
            turning: 7.0,
            zoom: -1.5,
            shake: (1.2, 0.7),
            shaking: TAU * 40.0,
            scale: 0.8,
            origin: (-3.0, 5.0),
        }
    }

    /// The module's equation as it stands there: where a place of the photo is on the sensor.
    fn forward(motion: &Motion, photo: (f64, f64), t: f64) -> (f64, f64) {
        let q = (motion.origin.0 + motion.scale * photo.0, motion.origin.1 + motion.scale * photo.1);
        let (dx, dy) = (q.0 - motion.centre.0, q.1 - motion.centre.1);
        let (sine, cosine) = (libm::sin(motion.turning * t), libm::cos(motion.turning * t));
        let grown = libm::exp(motion.zoom * t);
        let shaken = libm::sin(motion.shaking * t);
        (
            motion.centre.0
                + grown * (cosine * dx - sine * dy)
                + motion.velocity.0 * t
                + motion.shake.0 * shaken,
            motion.centre.1
                + grown * (sine * dx + cosine * dy)
                + motion.velocity.1 * t
                + motion.shake.1 * shaken,
        )
    }

    #[test]
    fn a_pixel_sees_the_place_that_the_equation_puts_there() {
        let motion = lively();
        for t_ns in [0, 1, 3_000_000, 47_111_111, 900_000_000] {
            for photo in [(0.0, 0.0), (31.5, 7.25), (-4.0, 60.0)] {
                let (x, y) = forward(&motion, photo, t_ns as f64 * 1e-9);
                let seen = motion.seen(x, y, t_ns);
                assert!(
                    (seen.x - photo.0).abs() < 1e-9 && (seen.y - photo.1).abs() < 1e-9,
                    "{photo:?} at {t_ns}: {seen:?}"
                );
            }
        }
    }

    #[test]
    fn single_motions_are_as_stated() {
        let rest = Motion {
            velocity: (0.0, 0.0),
            turning: 0.0,
            zoom: 0.0,
            shake: (0.0, 0.0),
            scale: 1.0,
            origin: (0.0, 0.0),
            ..lively()
        };
        assert!(rest.rests() && !lively().rests());
        let close = |seen: Seen, x: f64, y: f64| {
            assert!((seen.x - x).abs() < 1e-9 && (seen.y - y).abs() < 1e-9, "{seen:?}, ({x}, {y}) expected")
        };
        close(rest.seen(5.0, 6.0, 123_456_789), 5.0, 6.0);
        // 100 pixels per second to the right: after 30 ms a pixel sees what stood 3 pixels left of it.
        close(Motion { velocity: (100.0, 0.0), ..rest }.seen(5.0, 6.0, 30_000_000), 2.0, 6.0);
        // A quarter turn clockwise brings what was right of the centre below it.
        let quarter = Motion { turning: TAU, ..rest }.seen(20.0, 37.0, 250_000_000);
        close(quarter, 27.0, 30.0);
        // Twice as large after a second: what stood half as far from the centre.
        let zoomed = Motion { zoom: std::f64::consts::LN_2, ..rest }.seen(30.0, 34.0, 1_000_000_000);
        close(zoomed, 25.0, 32.0);
        assert!((zoomed.spacing - 0.5).abs() < 1e-12);
        // A quarter of a period: the whole amplitude.
        close(
            Motion { shake: (2.0, -1.0), shaking: TAU * 10.0, ..rest }.seen(5.0, 6.0, 25_000_000),
            3.0,
            7.0,
        );
    }
}
