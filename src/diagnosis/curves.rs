//! The light of sampled pixels: log light at knots, linear between.

use photocurrent_sensor::conditional::at;

/// Knots, log light, and whether it is known.
pub(crate) type LogLightCurve = (Vec<i64>, Vec<f64>, bool);

/// Log light of the pixels of a sample.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LogLightCurves {
    first: Vec<usize>,
    /// Knots, ns, pixel after pixel.
    pub t_ns: Vec<i64>,
    /// Log light at each.
    pub log_light: Vec<f64>,
    /// Which pixels of the sample have an estimate; the others have no usable frame, and carry one constant
    /// knot.
    pub is_known: Vec<bool>,
}

impl LogLightCurves {
    /// From knots, log light, and whether it is known, of each pixel in turn.
    pub fn from_pixels(pixels: impl IntoIterator<Item = LogLightCurve>) -> LogLightCurves {
        let mut curves = LogLightCurves { first: vec![0], ..LogLightCurves::default() };
        for (t_ns, log_light, is_known) in pixels {
            curves.t_ns.extend(t_ns);
            curves.log_light.extend(log_light);
            curves.first.push(curves.t_ns.len());
            curves.is_known.push(is_known);
        }
        curves
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.is_known.len()
    }

    /// No pixel at all?
    pub fn is_empty(&self) -> bool {
        self.is_known.is_empty()
    }

    /// Knots and log light of pixel `n` of the sample.
    pub fn pixel(&self, n: usize) -> (&[i64], &[f64]) {
        let range = self.first[n]..self.first[n + 1];
        (&self.t_ns[range.clone()], &self.log_light[range])
    }

    /// Log light of pixel `n` of the sample at an instant: linear between knots, constant beyond them.
    pub fn at(&self, n: usize, t_ns: i64) -> f64 {
        let (t, u) = self.pixel(n);
        at(t, u, t_ns)
    }
}
