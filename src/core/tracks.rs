//! Tracks: the photocurrent of every pixel over time, what the solver finds and the renderer integrates.
//!
//! A pixel's track is a list of knots. Between knots the photocurrent is held (the paper's zero-order hold): knot k's value lasts
//! until knot k+1; before the first knot its value holds, after the last one the last. How knots are kept: [`crate::series`].

use crate::digest::DigestBuilder;
use crate::extent::Extent;
use crate::handle::{BandMeta, Handle};
use crate::series::{SeriesBand, SeriesMeta};
use crate::time::TimeSpan;
use serde::{Deserialize, Serialize};

/// What is known about tracks before their data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TracksMeta {
    /// Size of the sensor.
    pub extent: Extent,
    /// The time that events or frames cover.
    pub span: TimeSpan,
    /// Length of an ordinary frame's exposure in the recording, ns: the scale of rendered DN.
    pub nominal_exposure_ns: i64,
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
    }
}

impl SeriesMeta for TracksMeta {
    const NAME: &'static str = "tracks";

    fn counted(&self, samples: u64) -> TracksMeta {
        TracksMeta { count_hint: Some(samples), ..self.clone() }
    }
}

/// Tracks of all pixels, read by row band.
pub type TrackSet = Handle<TracksMeta>;

/// The tracks of some rows: `photocurrent[k]` lasts from `t[k]` on.
pub type TrackBand = SeriesBand<TracksMeta>;
