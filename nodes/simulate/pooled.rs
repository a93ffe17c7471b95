//! The light that event pixels see, where each lies on several frame pixels or colours: the mixture of its
//! block ([`photocurrent_sensor::pooling`]).

use photocurrent_core::handle::BandSource;
use photocurrent_core::light::{Light, LightBand, LightMeta, at};
use photocurrent_core::series::Series;
use photocurrent_core::{Colour, DataError, Extent, NodeError, Rows};
use photocurrent_sensor::pooling::block_weights;
use rayon::prelude::*;
use std::sync::Arc;

/// How event pixels lie on the pixels of the light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pooling {
    /// Pixels of the light along the side of an event pixel.
    pub ratio: u32,
    /// How strongly an event pixel sees red, green and blue; absent = every photodiode alike.
    pub seen: Option<[f64; 3]>,
}

impl Pooling {
    /// Extent of the events.
    ///
    /// # Errors
    /// When the light cannot be cut into whole blocks.
    pub fn extent(&self, light: &LightMeta) -> Result<Extent, NodeError> {
        let Extent { width, height } = light.extent;
        if !width.is_multiple_of(self.ratio) || !height.is_multiple_of(self.ratio) {
            return Err(NodeError::usage(format!(
                "the light has {width} x {height} pixels, and {0} x {0} lie on each event pixel",
                self.ratio
            ))
            .hint(format!("make width and height multiples of {}", self.ratio))
            .param("pixels_per_event_pixel"));
        }
        Ok(Extent { width: width / self.ratio, height: height / self.ratio })
    }

    /// Does every event pixel see the light of one grey pixel?
    pub fn is_plain(&self, light: &LightMeta) -> bool {
        self.ratio == 1 && light.colour == Colour::Mono
    }

    /// The light of the event pixels, as far as all rows of their blocks are there; mixed when it is read.
    ///
    /// # Errors
    /// As [`Pooling::extent`].
    pub fn light(self, light: &Light) -> Result<Light, NodeError> {
        if self.is_plain(&light.meta) {
            return Ok(light.clone());
        }
        let meta = LightMeta {
            extent: self.extent(&light.meta)?,
            colour: Colour::Mono,
            count_hint: None,
            ..(*light.meta).clone()
        };
        let rows =
            Rows { start: light.rows().start.div_ceil(self.ratio), end: light.rows().end / self.ratio };
        Ok(Light::new(Arc::new(meta), rows, Arc::new(Mixture { of: light.clone(), pooling: self })))
    }
}

/// Adds a pixel that sees parts of the light of others, each with its weight, at the instants of all of them:
/// light is straight between these, so the sum is exact. A pixel without light is left for the camera to
/// refuse. `instants` is memory for them.
pub(crate) fn push_mixed(band: &mut LightBand, instants: &mut Vec<i64>, parts: &[(f64, Series<'_>)]) {
    instants.clear();
    instants.extend(parts.iter().flat_map(|(_, part)| part.t));
    instants.sort_unstable();
    instants.dedup();
    let mixed = |t: i64| {
        parts.iter().map(|(weight, part)| weight * at(*part, t).unwrap_or(f64::NAN)).sum::<f64>() as f32
    };
    band.push(instants.iter().map(|&t| (t, mixed(t))));
}

struct Mixture {
    of: Light,
    pooling: Pooling,
}

impl BandSource<LightBand> for Mixture {
    fn read(&self, rows: Rows) -> Result<LightBand, DataError> {
        let Pooling { ratio, seen } = self.pooling;
        let (meta, whole) =
            (&self.of.meta, self.of.read(Rows { start: rows.start * ratio, end: rows.end * ratio })?);
        let (width, block_values) = (meta.extent.width / ratio, ratio * meta.colour.channels());
        let row = |y: u32| -> LightBand {
            let mut band = LightBand::begin(y, width);
            let mut instants: Vec<i64> = Vec::new();
            for x in 0..width {
                let weights = block_weights(meta.colour, ratio, (x, y), seen);
                let places = (0..ratio).flat_map(|dy| {
                    (0..block_values).map(move |value| (x * block_values + value, y * ratio + dy))
                });
                let parts: Vec<(f64, Series<'_>)> = weights
                    .into_iter()
                    .zip(places)
                    .filter(|(weight, _)| *weight > 0.0)
                    .map(|(weight, (value, y))| (weight, whole.pixel(value, y)))
                    .collect();
                push_mixed(&mut band, &mut instants, &parts);
            }
            band
        };
        let bands: Vec<LightBand> = rows.iter().into_par_iter().map(row).collect();
        if bands.is_empty() {
            Ok(LightBand::begin(rows.start, width))
        } else {
            Ok(photocurrent_core::handle::Band::concat(bands))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::TimeSpan;

    fn light(colour: Colour, extent: Extent) -> Light {
        let values = extent.width * colour.channels();
        let mut band = LightBand::begin(0, values);
        for place in 0..values * extent.height {
            let (v, y) = (place % values, place / values);
            // Each value turns at an instant of its own.
            let turn = 1_000 + 100 * i64::from(v) + 10 * i64::from(y);
            band.push([(0, 1.0 + v as f32), (turn, 5.0 + (v * y) as f32), (10_000, 2.0 + y as f32)]);
        }
        let meta = LightMeta { extent, span: TimeSpan::new(0, 10_000), colour, count_hint: None };
        Light::in_memory(Arc::new(meta), band)
    }

    #[test]
    fn the_mixture_is_the_weighted_sum_at_every_instant_and_in_every_band() {
        let extent = Extent { width: 8, height: 4 };
        let seen = Some([0.2, 0.5, 0.3]);
        // Written out: a Bayer block has red, two green, blue; of three channels every pixel has each.
        let bayer = |light: &LightBand, x: u32, y: u32, t: i64| {
            let i = |dx: u32, dy: u32| at(light.pixel(2 * x + dx, 2 * y + dy), t).unwrap();
            0.2 * i(0, 0) + 0.25 * (i(1, 0) + i(0, 1)) + 0.3 * i(1, 1)
        };
        let rgb = |light: &LightBand, x: u32, y: u32, t: i64| {
            let i = |c: u32| {
                (0..4)
                    .map(|n| at(light.pixel(3 * (2 * x + n % 2) + c, 2 * y + n / 2), t).unwrap())
                    .sum::<f64>()
                    / 4.0
            };
            0.2 * i(0) + 0.5 * i(1) + 0.3 * i(2)
        };
        type By<'a> = &'a dyn Fn(&LightBand, u32, u32, i64) -> f64;
        for (name, by) in [("bayer_rggb", &bayer as By), ("rgb", &rgb as By)] {
            let own = light(Colour::named(name).unwrap(), extent);
            let pooled = Pooling { ratio: 2, seen }.light(&own).unwrap();
            assert_eq!(
                (pooled.meta.extent, pooled.meta.colour, pooled.rows().end),
                (Extent { width: 4, height: 2 }, Colour::Mono, 2)
            );
            let (own, all) = (own.read(own.rows()).unwrap(), pooled.read(pooled.rows()).unwrap());
            for (x, y) in [(0, 0), (3, 0), (1, 1)] {
                for t in [0, 1_234, 1_777, 5_000, 10_000] {
                    let (found, expected) = (at(all.pixel(x, y), t).unwrap(), by(&own, x, y, t));
                    assert!((found / expected - 1.0).abs() < 1e-6, "{name}: {found}, expected {expected}");
                }
            }
            let rows = Rows { start: 1, end: 2 };
            assert_eq!(pooled.read(rows).unwrap(), photocurrent_core::handle::Band::slice(&all, rows));
        }
    }

    #[test]
    fn light_that_does_not_cut_into_blocks_is_refused() {
        let light = light(Colour::Mono, Extent { width: 8, height: 5 });
        let error = Pooling { ratio: 2, seen: None }.light(&light).err().unwrap();
        assert_eq!(
            (error.message.as_str(), error.param.as_deref()),
            ("the light has 8 x 5 pixels, and 2 x 2 lie on each event pixel", Some("pixels_per_event_pixel"))
        );
    }
}
