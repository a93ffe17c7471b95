//! The light of one pixel as the forward model takes it: neighbours mixed in, in double precision.

use photocurrent_core::light::LightBand;
use photocurrent_core::{Extent, NodeError};
use photocurrent_sensor::effects::{Kernel, Tap};
use photocurrent_sensor::forward::LinearLight;
use photocurrent_sensor::forward::neighbours::{mixed, stand_in};

/// Buffers for one pixel's light after the other.
#[derive(Default)]
pub(super) struct PixelLight {
    own: Instants,
    mixed: Instants,
    is_mixed: bool,
}

impl PixelLight {
    /// Takes the light of pixel (x, y) from a band that holds its row and those that `kernel` reaches.
    pub(crate) fn take(
        &mut self,
        light: &LightBand,
        extent: Extent,
        kernel: Option<&Kernel>,
        x: u32,
        y: u32,
    ) {
        self.own.take(light, x, y);
        self.is_mixed = kernel.is_some();
        if let Some(kernel) = kernel {
            self.mixed.mix(light, extent, kernel, x, y);
        }
    }

    /// What the event path sees.
    ///
    /// # Errors
    /// When the light is not positive everywhere.
    pub(crate) fn seen(&self) -> Result<LinearLight<'_>, NodeError> {
        if self.is_mixed { self.mixed.light() } else { self.own.light() }
    }

    /// What the frames see.
    ///
    /// # Errors
    /// When the light is not positive everywhere.
    pub(crate) fn own(&self) -> Result<LinearLight<'_>, NodeError> {
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

    /// The weighted sum of the neighbours' light at all their instants; beyond the edge the nearest pixel
    /// stands in.
    fn mix(&mut self, light: &LightBand, extent: Extent, kernel: &Kernel, x: u32, y: u32) {
        let neighbour = |tap: &Tap| {
            let (column, row) = (
                stand_in(x as usize, tap.dx, extent.width as usize),
                stand_in(y as usize, tap.dy, extent.height as usize),
            );
            light.pixel(column as u32, row as u32)
        };
        self.t.clear();
        self.t.extend(kernel.taps.iter().flat_map(|tap| neighbour(tap).t));
        self.t.sort_unstable();
        self.t.dedup();
        self.photocurrent.clear();
        let sum = |&t: &i64| {
            mixed(kernel, |tap| photocurrent_core::light::at(neighbour(tap), t).unwrap_or(f64::NAN))
        };
        self.photocurrent.extend(self.t.iter().map(sum));
    }

    fn light(&self) -> Result<LinearLight<'_>, NodeError> {
        if self.t.is_empty() || !self.photocurrent.iter().all(|i| *i > 0.0 && i.is_finite()) {
            return Err(NodeError::input(
                "the light has a pixel without a positive photocurrent at every instant",
            )
            .hint("a scene reflects more than nothing everywhere"));
        }
        Ok(LinearLight::new(&self.t, &self.photocurrent))
    }
}
