//! `align/tracks`: tracks of the event array as tracks of the frames' pixels.
//!
//! Log light is bilinear between the four event pixels around a pixel; its knots are those of the nearest
//! one. With the events connected, light is interpolated along the motion, so that a moving edge keeps its
//! width. What stands between event pixels passed each of them a little before, or will a little later. Finer
//! detail of the frames comes from `render/colour`, with the same alignment.
//!
//! Limits: outside the event array a pixel has the track of the nearest event pixel up to one pitch, and none
//! further out.

use photocurrent_core::handle::Band;
use photocurrent_core::{
    Between, Colour, Context, Decl, EventStream, FrameSequence, FramesMeta, Grain, MapSet, Meta, Node,
    NodeError, PortMetas, TrackBand, TrackSet, TracksMeta,
};
use photocurrent_scene::activity::Activity;
use photocurrent_scene::alignment::{Alignment, BilinearWeights};
use photocurrent_scene::film::{EventTimes, LogTracks};
use photocurrent_scene::flow::{Flow, MotionParams};
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
        /// Events on the event array's own pixels, which state where motion is estimated.
        events: Option<EventStream>,
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

/// Slower motion than this, event pixels a millisecond, is none.
const SLOW: f64 = 0.1;

/// The tracks of an event array between its pixels.
struct InBetween<'a> {
    band: &'a TrackBand,
    log: &'a LogTracks,
    flow: Option<&'a Flow>,
    /// Columns of the array.
    array: usize,
}

impl InBetween<'_> {
    /// Delay with which a moving object at `place` of the array reaches the place `off` pixels away, ns.
    fn later_ns(&self, place: (f64, f64), off: (f64, f64), t_ns: i64) -> i64 {
        let Some(flow) = self.flow else { return 0 };
        let [right, down] = flow.at(place.0, place.1, t_ns);
        let along = off.0 * right + off.1 * down;
        (1e6 * along / (right * right + down * down + SLOW * SLOW)) as i64
    }

    /// The knots of a pixel: time, photocurrent, standard deviation of its logarithm.
    fn knots(&self, around: &BilinearWeights, out: &mut Vec<(i64, f32, f32)>) {
        out.clear();
        let column_row = |at: usize| ((at % self.array) as f64, (at / self.array) as f64);
        let pixels = || around.at.iter().copied().zip(around.weights).filter(|(_, weight)| *weight > 0.0);
        // Weights that are bilinear give the place that they are those of.
        let place = pixels().fold((0.0, 0.0), |sum, (at, weight)| {
            let (column, row) = column_row(at);
            (sum.0 + f64::from(weight) * column, sum.1 + f64::from(weight) * row)
        });
        let off = |at: usize| (column_row(at).0 - place.0, column_row(at).1 - place.1);
        let at = around.nearest();
        let track = self.band.pixel((at % self.array) as u32, (at / self.array) as u32);
        for (k, t) in track.t.iter().enumerate() {
            let t = t - self.later_ns(column_row(at), off(at), *t);
            let (mut sum, mut weights) = (0.0, 0.0);
            for (at, weight) in pixels() {
                let later = t + self.later_ns(place, off(at), t);
                if let Some(log) = self.log.at(at % self.array, at / self.array, later) {
                    (sum, weights) = (sum + f64::from(weight) * log, weights + f64::from(weight));
                }
            }
            if weights > 0.0 {
                let sigma = track.sigma.get(k).copied().unwrap_or(0.0);
                out.push((t, libm::exp(sum / weights) as f32, sigma));
            }
        }
        // Where motion changes, knots may change places.
        if self.flow.is_some() {
            out.sort_by_key(|knot| knot.0);
            out.dedup_by_key(|knot| knot.0);
        }
    }
}

/// The motion over the event array.
fn motion(log: &LogTracks, meta: &TracksMeta, events: &EventStream) -> Result<Flow, NodeError> {
    let rows = meta.extent.rows();
    let band = events.read(rows)?;
    let span = (meta.span.start.0, meta.span.end.0);
    let places = rows.iter().flat_map(|y| {
        let row = band.row(y);
        (0..row.len()).map(move |k| (usize::from(row.x[k]), y as usize, row.t[k]))
    });
    let activity = Activity::new(meta.extent, span, places);
    Ok(Flow::estimate(log, span, &activity, (&MotionParams::default(), false)))
}

impl Node for AlignTracks {
    const DECL: Decl = Decl {
        kind: "align/tracks",
        about: "Tracks of the event array as tracks of the pixels of another camera's frames.",
        revision: 2,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["bilinear interpolation of log light"],
        example: r#"
[nodes.back]
kind = "align/tracks"
in   = { tracks = "solve.tracks", frames = "recording.frames", alignment = "alignment", events = "array.events" }

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
        if let Some(events) = inputs.has("events").then(|| inputs.events("events")).transpose()?
            && events.extent != map.extent
        {
            return Err(NodeError::usage(format!(
                "events are {}, the alignment is of an event array of {}",
                events.extent, map.extent
            ))
            .hint("connect the events that align/recording or estimate/alignment give"));
        }
        Ok(vec![Meta::Tracks(Arc::new(plan_of(tracks, inputs.frames("frames")?)?))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let meta = plan_of(&input.tracks.meta, &input.frames.meta)?;
        let alignment = Alignment::from_map(&input.alignment)?;
        let around = alignment.bilinear_weights(meta.extent);
        let (extent, array) = (alignment.events, alignment.events.width as usize);
        let band = input.tracks.read(extent.rows())?;
        let fired = Arc::new(EventTimes::new((0..extent.pixels()).map(|_| Vec::new())));
        let log = LogTracks::new(extent, band.clone(), &fired);
        let flow = input.events.map(|events| motion(&log, &input.tracks.meta, &events)).transpose()?;
        let between = InBetween { band: &band, log: &log, flow: flow.as_ref(), array };
        cx.begin(u64::from(meta.extent.height), "rows");
        let row = |y: u32| -> Result<TrackBand, NodeError> {
            let mut out = TrackBand::begin(y, meta.extent.width);
            let mut knots_here = Vec::new();
            for x in 0..meta.extent.width {
                let around = &around[(y * meta.extent.width + x) as usize];
                knots_here.clear();
                if around.is_known() {
                    between.knots(around, &mut knots_here);
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
    use photocurrent_core::events::{Event, Polarity};
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
            events: None,
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

    #[test]
    fn an_edge_that_moves_keeps_its_width_with_events() {
        const EXTENT: Extent = Extent { width: 32, height: 16 };
        // A band with edges half a pixel wide moves 0.6 pixels a millisecond, a little slanted.
        let edge = |s: f64| libm::tanh(s / 0.25);
        let log = |x: f64, y: f64, ms: f64| {
            let s = x - 0.6 * ms + 0.2 * y;
            0.5 * (edge(s - 3.0) - edge(s + 5.0)) + 0.1 * libm::sin(0.9 * s) * libm::sin(0.8 * y)
        };
        let (knots, step_ns) = (201, 200_000_i64);
        let meta = TracksMeta {
            extent: EXTENT,
            span: TimeSpan::new(0, knots * step_ns),
            nominal_exposure_ns: 1,
            between: Between::LogLinear,
            colour: Colour::Mono,
            has_sigma: false,
            count_hint: None,
        };
        let mut band = TrackBand::begin(0, EXTENT.width);
        let mut fired = Vec::new();
        for (y, x) in (0..EXTENT.height).flat_map(|y| (0..EXTENT.width).map(move |x| (y, x))) {
            let at = |k: i64| log(f64::from(x), f64::from(y), (k * step_ns) as f64 * 1e-6);
            band.push((0..knots).map(|k| (k * step_ns, libm::exp(at(k)) as f32)));
            fired.extend((1..knots).filter(|k| (at(*k) - at(k - 1)).abs() > 0.1).map(|k| Event {
                x: x as u16,
                y: y as u16,
                polarity: Polarity::On,
                t: k * step_ns,
                t_in: None,
            }));
        }
        let tracks = TrackSet::in_memory(Arc::new(meta), band);
        let events = testing::stream(EXTENT, fired);
        let squares = |events: Option<EventStream>| -> f64 {
            let input = In {
                tracks: tracks.clone(),
                frames: testing::captured(EXTENT, vec![Exposure::new(0, 5)], 0, |_, _, _| 1.0),
                alignment: alignment(EXTENT, &shifted(0.5)),
                events,
            };
            let (out, _) = testing::with_context(EXTENT.rows(), &["tracks"], |cx| AlignTracks.run(input, cx));
            let band = out.unwrap().tracks.read(EXTENT.rows()).unwrap();
            let of = |x: u32, y: u32| {
                let track = band.pixel(x, y);
                let off = |(t, light): (&i64, &f32)| {
                    // The array lies half a pixel right and below.
                    let expected = log(f64::from(x) - 0.5, f64::from(y) - 0.5, *t as f64 * 1e-6);
                    libm::log(f64::from(*light)) - expected
                };
                track.t.iter().zip(track.photocurrent).map(off).map(|off| off * off).sum::<f64>()
            };
            (4..12).flat_map(|y| (8..24).map(move |x| (x, y))).map(|(x, y)| of(x, y)).sum()
        };
        let (still, moving) = (squares(None), squares(Some(events)));
        assert!(moving < 0.3 * still, "{still} {moving}");
    }
}
