//! The light of one pixel as the forward model takes it: neighbours mixed in, in double precision, and cut where its logarithm bends.

use photocurrent_core::light::LightBand;
use photocurrent_core::{Extent, NodeError};
use photocurrent_sensor::effects::{Kernel, Tap};
use photocurrent_sensor::forward::LinearLight;
use photocurrent_sensor::forward::neighbours::{mixed, stand_in};

/// The forward model takes the logarithm of light as linear between two instants. Light that is linear itself is off by at most the square
/// of this over eight, here a hundred-thousandth: a ten-thousandth of a threshold.
const LOG_STEP: f64 = 0.01;

/// Buffers for one pixel's light after the other.
#[derive(Default)]
pub(super) struct PixelLight {
    own: Instants,
    mixed: Instants,
    cut: Instants,
}

impl PixelLight {
    /// Takes the light of pixel (x, y) from a band that holds its row and those that `kernel` reaches.
    pub fn take(&mut self, light: &LightBand, extent: Extent, kernel: Option<&Kernel>, x: u32, y: u32) {
        self.own.take(light, x, y);
        match kernel {
            Some(kernel) => {
                self.mixed.mix(light, extent, kernel, x, y);
                self.cut.cut(&self.mixed);
            }
            None => self.cut.cut(&self.own),
        }
    }

    /// What the event path sees.
    ///
    /// # Errors
    /// When the light is not positive everywhere.
    pub fn seen(&self) -> Result<LinearLight<'_>, NodeError> {
        self.cut.light()
    }

    /// What the frames see.
    ///
    /// # Errors
    /// When the light is not positive everywhere.
    pub fn own(&self) -> Result<LinearLight<'_>, NodeError> {
        self.own.light()
    }
}

/// One pixel's light in double precision.
#[derive(Default)]
struct Instants {
    t: Vec<i64>,
    photocurrent: Vec<f64>,
}

impl Instants {
    fn take(&mut self, light: &LightBand, x: u32, y: u32) {
        let pixel = light.pixel(x, y);
        self.t.clear();
        self.t.extend_from_slice(pixel.t);
        self.photocurrent.clear();
        self.photocurrent.extend(pixel.photocurrent.iter().map(|i| f64::from(*i)));
    }

    /// The weighted sum of the neighbours' light at all their instants; beyond the edge the nearest pixel stands in.
    fn mix(&mut self, light: &LightBand, extent: Extent, kernel: &Kernel, x: u32, y: u32) {
        let neighbour = |tap: &Tap| {
            let (column, row) = (stand_in(x as usize, tap.dx, extent.width as usize), stand_in(y as usize, tap.dy, extent.height as usize));
            light.pixel(column as u32, row as u32)
        };
        self.t.clear();
        self.t.extend(kernel.taps.iter().flat_map(|tap| neighbour(tap).t));
        self.t.sort_unstable();
        self.t.dedup();
        self.photocurrent.clear();
        let sum = |&t: &i64| mixed(kernel, |tap| photocurrent_core::light::at(neighbour(tap), t).unwrap_or(f64::NAN));
        self.photocurrent.extend(self.t.iter().map(sum));
    }

    /// The same light with instants added where it changes by more than [`LOG_STEP`] from one to the next.
    fn cut(&mut self, light: &Instants) {
        self.t.clear();
        self.photocurrent.clear();
        for k in 0..light.t.len() {
            if k > 0 {
                let (t, i) = (light.t[k - 1], light.photocurrent[k - 1]);
                let (length, change) = (light.t[k] - t, light.photocurrent[k] - i);
                let pieces = ((libm::log(light.photocurrent[k] / i).abs() / LOG_STEP).ceil() as i64).clamp(1, length.max(1));
                for piece in 1..pieces {
                    let after = length * piece / pieces;
                    self.t.push(t + after);
                    self.photocurrent.push(i + change * after as f64 / length as f64);
                }
            }
            self.t.push(light.t[k]);
            self.photocurrent.push(light.photocurrent[k]);
        }
    }

    fn light(&self) -> Result<LinearLight<'_>, NodeError> {
        if self.t.is_empty() || !self.photocurrent.iter().all(|i| *i > 0.0 && i.is_finite()) {
            return Err(NodeError::input("the light has a pixel without a positive photocurrent at every instant")
                .hint("a scene reflects more than nothing everywhere"));
        }
        Ok(LinearLight::new(&self.t, &self.photocurrent))
    }
}
