//! Light: the photocurrent that a scene causes in every pixel over time, what a simulated sensor looks at.
//!
//! A pixel's light is a list of instants with a photocurrent each, positive and finite. Between two instants
//! it is **linear** (a track, [`crate::tracks`], holds); before the first it is the first, after the last the
//! last. A pixel has at least one instant, and one is enough where nothing moves. How instants are kept:
//! [`crate::series`].

use crate::colour::Colour;
use crate::digest::DigestBuilder;
use crate::extent::Extent;
use crate::handle::{BandMeta, Handle};
use crate::series::{Series, SeriesBand, SeriesMeta};
use crate::time::{TimeSpan, between};
use serde::{Deserialize, Serialize};

/// What is known about light before its data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightMeta {
    /// Size of the sensor.
    pub extent: Extent,
    /// The time in which the light is known.
    pub span: TimeSpan,
    /// Grey, red, green and blue of every pixel (three series, one after the other), or what a mosaic of
    /// filters lets through.
    #[serde(default)]
    pub colour: Colour,
    /// About how many instants all pixels have together, for memory estimates only: no part of the content.
    pub count_hint: Option<u64>,
}

impl BandMeta for LightMeta {
    type Band = LightBand;

    fn extent(&self) -> Extent {
        self.extent
    }

    fn write_digest(&self, digest: &mut DigestBuilder) {
        digest.text("light/1").integer(self.extent.width.into()).integer(self.extent.height.into());
        digest.integer(self.span.start.0).integer(self.span.end.0);
        if self.colour != Colour::Mono {
            digest.text(self.colour.name());
        }
    }
}

impl SeriesMeta for LightMeta {
    const NAME: &'static str = "light";

    fn colour(&self) -> Colour {
        self.colour
    }

    fn counted(&self, samples: u64) -> LightMeta {
        LightMeta { count_hint: Some(samples), ..self.clone() }
    }
}

/// Light on all pixels, read by row band.
pub type Light = Handle<LightMeta>;

/// The light of some rows: linear from `(t[k], photocurrent[k])` to the next.
pub type LightBand = SeriesBand<LightMeta>;

/// The photocurrent of one pixel's light at an instant; `None` for a pixel without instants, which valid
/// light does not have.
///
/// ```
/// use photocurrent_core::{light, series::Series};
/// let pixel = Series { t: &[100, 200], photocurrent: &[3.0, 5.0], sigma: &[] };
/// assert_eq!([0, 100, 150, 200, 900].map(|t| light::at(pixel, t).unwrap()), [3.0, 3.0, 4.0, 5.0, 5.0]);
/// ```
pub fn at(pixel: Series<'_>, t_ns: i64) -> Option<f64> {
    let after = pixel.t.partition_point(|&instant| instant <= t_ns);
    let photocurrent = |k: usize| f64::from(pixel.photocurrent[k]);
    between(pixel.t, after, t_ns, photocurrent, |a, b, share| a * (1.0 - share) + b * share)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::handle::Band;
    use crate::tracks::TrackBand;

    #[test]
    fn light_is_another_content_than_a_track_of_the_same_numbers() {
        let (mut light, mut tracks) = (LightBand::begin(0, 1), TrackBand::begin(0, 1));
        light.push([(0, 1.0), (10, 2.0)]);
        tracks.push([(0, 1.0), (10, 2.0)]);
        assert_ne!(light.row_digest(0), tracks.row_digest(0));
    }

    #[test]
    fn a_pixel_without_instants_has_no_light() {
        assert_eq!(at(Series { t: &[], photocurrent: &[], sigma: &[] }, 5), None);
    }
}
