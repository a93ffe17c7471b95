//! `align/tracks`: tracks of the event array as tracks of the frames' pixels.
//!
//! Between the four event pixels around a pixel the logarithm of light is bilinear; its knots are those of
//! the nearest one. What the frames show finer than that is `render/colour`'s, with the same alignment.
//!
//! Limits: beyond the event array a pixel has the track of the nearest event pixel as far as one pitch, and
//! none further out.

use photocurrent_core::handle::Band;
use photocurrent_core::{
    Between, Colour, Context, Decl, FrameSequence, FramesMeta, Grain, MapSet, Meta, Node, NodeError,
    PortMetas, TrackBand, TrackSet, TracksMeta,
};
use photocurrent_scene::alignment::{Alignment, Around};
use photocurrent_scene::film::{Fired, LogTracks};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `align/tracks`: none.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Grey tracks of the event array: of `solve/map` or a refinement.
        tracks: TrackSet,
        /// Frames whose pixels the tracks get.
        frames: FrameSequence,
        /// Places of the event pixels on the frames: of `read/alignment`.
        alignment: MapSet,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// Tracks of the pixels of the frames.
        tracks: TrackSet,
    }
}

/// The node.
pub struct AlignTracks;

fn plan_of(tracks: &TracksMeta, frames: &FramesMeta) -> Result<TracksMeta, NodeError> {
    if tracks.between != Between::LogLinear || tracks.colour != Colour::Mono {
        return Err(NodeError::usage("align/tracks takes grey tracks that are log-linear between knots")
            .hint("connect tracks of solve/map, solved from grey frames (render/grey)"));
    }
    Ok(TracksMeta { extent: frames.extent, count_hint: None, ..tracks.clone() })
}

/// The knots of a pixel: time, photocurrent, standard deviation of its logarithm.
fn knots(band: &TrackBand, log: &LogTracks, array: usize, around: &Around, out: &mut Vec<(i64, f32, f32)>) {
    out.clear();
    let at = around.nearest();
    let track = band.pixel((at % array) as u32, (at / array) as u32);
    for (k, t) in track.t.iter().enumerate() {
        let (mut sum, mut weights) = (0.0, 0.0);
        for (at, weight) in around.at.iter().zip(around.weights).filter(|(_, weight)| *weight > 0.0) {
            if let Some(log) = log.at(at % array, at / array, *t) {
                (sum, weights) = (sum + f64::from(weight) * log, weights + f64::from(weight));
            }
        }
        if weights > 0.0 {
            let sigma = track.sigma.get(k).copied().unwrap_or(0.0);
            out.push((*t, libm::exp(sum / weights) as f32, sigma));
        }
    }
}

impl Node for AlignTracks {
    const DECL: Decl = Decl {
        kind: "align/tracks",
        about: "Tracks of the event array as tracks of the pixels of another camera's frames.",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["bilinear interpolation of log light"],
        example: r#"
[nodes.back]
kind = "align/tracks"
in   = { tracks = "solve.tracks", frames = "recording.frames", alignment = "alignment" }

[nodes.render]
kind = "render/rows"
in   = { tracks = "back.tracks", sensor = "sensor" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(_: Params) -> Result<Self, NodeError> {
        Ok(AlignTracks)
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let (map, tracks) = (inputs.map("alignment")?, inputs.tracks("tracks")?);
        Alignment::check(map)?;
        if map.extent != tracks.extent {
            return Err(NodeError::usage(format!(
                "tracks are {}, the alignment is of an event array of {}",
                tracks.extent, map.extent
            ))
            .hint("connect tracks that were solved from what align/recording gives"));
        }
        Ok(vec![Meta::Tracks(Arc::new(plan_of(tracks, inputs.frames("frames")?)?))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let meta = plan_of(&input.tracks.meta, &input.frames.meta)?;
        let alignment = Alignment::of(&input.alignment)?;
        let around = alignment.around(meta.extent);
        let (extent, array) = (alignment.events, alignment.events.width as usize);
        let band = input.tracks.read(extent.rows())?;
        let fired = Arc::new(Fired::new((0..extent.pixels()).map(|_| Vec::new())));
        let log = LogTracks::new(extent, band.clone(), &fired);
        cx.begin(u64::from(meta.extent.height), "rows");
        let row = |y: u32| -> Result<TrackBand, NodeError> {
            let mut out = TrackBand::begin(y, meta.extent.width);
            let mut knots_here = Vec::new();
            for x in 0..meta.extent.width {
                let around = &around[(y * meta.extent.width + x) as usize];
                knots_here.clear();
                if around.is_known() {
                    knots(&band, &log, array, around, &mut knots_here);
                }
                let knots = knots_here.iter().copied();
                if meta.has_sigma {
                    out.push_with_sigma(knots);
                } else {
                    out.push(knots.map(|(t, light, _)| (t, light)));
                }
            }
            cx.advance(1)?;
            Ok(out.shrunk())
        };
        let rows: Result<Vec<TrackBand>, NodeError> =
            meta.extent.rows().iter().into_par_iter().map(row).collect();

        Ok(Out { tracks: TrackSet::in_memory(Arc::new(meta), TrackBand::concat(rows?)) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::testing::{alignment, shifted};
    use photocurrent_core::{Exposure, Extent, TimeSpan, testing};

    const EXTENT: Extent = Extent { width: 6, height: 5 };

    fn run(by: f64) -> TrackBand {
        let meta = TracksMeta {
            extent: EXTENT,
            span: TimeSpan::new(0, 10),
            nominal_exposure_ns: 1,
            between: Between::LogLinear,
            colour: Colour::Mono,
            has_sigma: true,
            count_hint: None,
        };
        let mut band = TrackBand::begin(0, EXTENT.width);
        // Log light is a plane over the array, and rises by 1 in time.
        let log = |at: usize, t: f64| 0.3 * (at % 6) as f64 - 0.2 * (at / 6) as f64 + 0.1 * t;
        for at in 0..EXTENT.pixels() {
            band.push_with_sigma([0, 10].map(|t| (t, libm::exp(log(at, t as f64)) as f32, 0.05)));
        }
        let input = In {
            tracks: TrackSet::in_memory(Arc::new(meta), band),
            frames: testing::captured(EXTENT, vec![Exposure::new(0, 5)], 0, |_, _, _| 1.0),
            alignment: alignment(EXTENT, &shifted(by)),
        };
        let (out, _) = testing::with_context(EXTENT.rows(), &["tracks"], |cx| AlignTracks.run(input, cx));
        out.unwrap().tracks.read(EXTENT.rows()).unwrap()
    }

    #[test]
    fn log_light_between_event_pixels_is_bilinear() {
        for by in [0.0, 0.3] {
            let band = run(by);
            let track = band.pixel(3, 2);
            // The array lies right of and below the pixels: pixel 3 is 3 - by columns in.
            let expected = 0.3 * (3.0 - by) - 0.2 * (2.0 - by);
            assert!((libm::log(track.photocurrent[0].into()) - expected).abs() < 1e-5, "{by}");
            assert!((libm::log(track.photocurrent[1].into()) - expected - 1.0).abs() < 1e-5, "{by}");
            assert_eq!((track.t, track.sigma), (&[0, 10][..], &[0.05, 0.05][..]));
        }
    }

    #[test]
    fn pixels_that_no_event_pixel_is_near_have_no_track() {
        assert!(run(4.0).pixel(0, 0).t.is_empty());
    }
}
