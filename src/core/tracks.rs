//! Tracks: the photocurrent of every pixel over time, what the solver finds and the renderer integrates.
//!
//! A pixel's track is a list of knots. What happens between two knots is the same for all pixels and said in
//! [`TracksMeta::between`]: the value of knot k lasts until knot k+1 (the paper's zero-order hold), or its
//! logarithm goes over linearly. Before the first knot its value holds, after the last one the last. A knot
//! may carry the standard deviation of its log photocurrent, whose logarithm goes over linearly. How knots
//! are kept: [`crate::series`].

use crate::colour::Colour;
use crate::digest::DigestBuilder;
use crate::extent::Extent;
use crate::handle::{BandMeta, Handle};
use crate::series::{SeriesBand, SeriesMeta};
use crate::time::TimeSpan;
use serde::{Deserialize, Serialize};

/// What the photocurrent does between two knots.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Between {
    /// It keeps the value of the earlier knot.
    #[default]
    Hold,
    /// Its logarithm is linear from knot to knot.
    LogLinear,
}

/// What is known about tracks before their data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TracksMeta {
    /// Size of the sensor.
    pub extent: Extent,
    /// The time that events or frames cover.
    pub span: TimeSpan,
    /// Length of an ordinary frame's exposure in the recording, ns: the scale of rendered DN.
    pub nominal_exposure_ns: i64,
    /// What happens between two knots.
    #[serde(default)]
    pub between: Between,
    /// Grey, red, green and blue of every pixel (three tracks, one after the other), or a mosaic.
    #[serde(default)]
    pub colour: Colour,
    /// Does every knot carry a standard deviation of its log photocurrent?
    #[serde(default)]
    pub has_sigma: bool,
    /// About how many knots, for memory estimates only: no part of the content.
    pub count_hint: Option<u64>,
}

impl BandMeta for TracksMeta {
    type Band = TrackBand;

    fn extent(&self) -> Extent {
        self.extent
    }

    fn write_digest(&self, digest: &mut DigestBuilder) {
        digest.text("tracks/1").integer(self.extent.width.into()).integer(self.extent.height.into());
        digest.integer(self.span.start.0).integer(self.span.end.0).integer(self.nominal_exposure_ns);
        // Nothing is added for held tracks: they are the content they were before others existed.
        if self.between == Between::LogLinear {
            digest.text("log_linear");
        }
        if self.colour != Colour::Mono {
            digest.text(self.colour.name());
        }
        if self.has_sigma {
            digest.text("sigma");
        }
    }
}

impl SeriesMeta for TracksMeta {
    const NAME: &'static str = "tracks";

    fn colour(&self) -> Colour {
        self.colour
    }

    fn has_sigma(&self) -> bool {
        self.has_sigma
    }

    fn counted(&self, samples: u64) -> TracksMeta {
        TracksMeta { count_hint: Some(samples), ..self.clone() }
    }
}

/// Tracks of all pixels, read by row band.
pub type TrackSet = Handle<TracksMeta>;

/// The tracks of some rows: `photocurrent[k]` is that of instant `t[k]`.
pub type TrackBand = SeriesBand<TracksMeta>;

#[cfg(test)]
mod tests {
    use super::*;

    fn meta(between: Between) -> TracksMeta {
        TracksMeta {
            extent: Extent { width: 2, height: 1 },
            span: TimeSpan::new(0, 10),
            nominal_exposure_ns: 5,
            between,
            colour: Colour::Mono,
            has_sigma: false,
            count_hint: None,
        }
    }

    #[test]
    fn the_same_knots_are_another_content_when_they_are_joined_otherwise() {
        let digest = |between| {
            let mut digest = DigestBuilder::new("test");
            meta(between).write_digest(&mut digest);
            digest.finish()
        };
        assert_ne!(digest(Between::Hold), digest(Between::LogLinear));
    }

    #[test]
    fn a_description_without_the_word_means_held() {
        let mut fields = serde_json::to_value(meta(Between::LogLinear)).unwrap();
        assert_eq!(fields["between"], "log_linear");
        fields.as_object_mut().unwrap().remove("between");
        assert_eq!(serde_json::from_value::<TracksMeta>(fields).unwrap(), meta(Between::Hold));
    }
}
