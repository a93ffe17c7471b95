//! `align/recording`: frames on the pixels of the event array, and every event once.
//!
//! Events that were warped onto the pixels of another camera's frames may appear in several pixels, or in
//! none at their place. On the event array's own grid each event pixel is one, and the frames are sampled at
//! its place. There a recording is solved like one of a single sensor. `align/tracks` brings the solved
//! tracks back to the frames' pixels.
//!
//! Limits: frames of a global shutter; a mosaic goes through `render/demosaic` first; event pixels that share
//! their pixel of the frames with a nearer one have no events.

use photocurrent_core::events::Event;
use photocurrent_core::{
    Context, Decl, EventBand, EventStream, EventsMeta, Extent, FrameBlock, FrameSequence, FramesMeta, Grain,
    MapSet, Meta, Node, NodeError, PortMetas,
};
use photocurrent_scene::alignment::Alignment;
use photocurrent_scene::image::Image;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `align/recording`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// On whose pixels the events are: `"frames"` (they were warped there) or `"array"`. Absent = on those of
    /// the one whose size they have, and the frames' where both have it.
    pub events: Option<Pixels>,
}

/// Whose pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Pixels {
    /// Those of the frames.
    Frames,
    /// Those of the event array.
    Array,
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Events on the pixels of the frames, or of the event array.
        events: EventStream,
        /// Captured frames, grey or of three channels.
        frames: FrameSequence,
        /// Places of the event pixels on the frames: of `read/alignment`.
        alignment: MapSet,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// The events on the event array's own pixels.
        events: EventStream,
        /// The frames as these see them.
        frames: FrameSequence,
    }
}

/// The node.
pub struct AlignRecording {
    params: Params,
}

/// The pixels of the events, and the outputs' metadata.
///
/// # Errors
/// When sizes do not meet, or these events or frames cannot be brought to the array.
pub(crate) fn plan_of(
    stated: Option<Pixels>,
    events: &EventsMeta,
    frames: &FramesMeta,
    array: Extent,
) -> Result<(Pixels, EventsMeta, FramesMeta), NodeError> {
    let is_of = |pixels: &Pixels| match pixels {
        Pixels::Frames => events.extent == frames.extent,
        Pixels::Array => events.extent == array,
    };
    let found = [Pixels::Frames, Pixels::Array].into_iter().find(is_of);
    let pixels = stated.filter(is_of).or(if stated.is_none() { found } else { None }).ok_or_else(|| {
        NodeError::usage(format!(
            "events are {}, frames are {}, the event array is {array}: they have the size of one of these",
            events.extent, frames.extent
        ))
        .hint("connect the alignment of this recording, and its events and frames whole")
    })?;
    if pixels == Pixels::Frames && events.has_step {
        return Err(NodeError::usage("events have compensated steps, of which each is one pixel's")
            .hint("put compensate/readout behind align/recording"));
    }
    if frames.colour.is_mosaic() {
        return Err(NodeError::usage(format!("frames are {}", frames.colour))
            .hint("put render/demosaic between: neighbouring pixels of a mosaic have other colours"));
    }
    if frames.times.row_time_ns != 0 {
        return Err(NodeError::usage(format!(
            "rows of the frames begin {} ns after each other, and rows of events lie across them",
            frames.times.row_time_ns
        ))
        .hint("state `row_time = \"0 ns\"` at the reader if the shutter is global"));
    }
    let events = EventsMeta { extent: array, count_hint: None, ..events.clone() };
    Ok((pixels, events, FramesMeta { extent: array, ..frames.clone() }))
}

/// For each pixel of the frames the event pixel whose events are taken from it.
fn source_event_pixels(alignment: &Alignment, frames: Extent) -> Vec<Option<usize>> {
    let around = alignment.bilinear_weights(frames);
    let width = frames.width as usize;
    // Of each event pixel the nearest of the pixels that it is nearest to.
    let mut best: Vec<Option<(f32, usize)>> = vec![None; alignment.events.pixels()];
    for (pixel, around) in around.iter().enumerate().filter(|(_, around)| around.is_known()) {
        let at = around.nearest();
        let apart =
            libm::hypotf((pixel % width) as f32 - alignment.x[at], (pixel / width) as f32 - alignment.y[at]);
        if best[at].is_none_or(|(least, _)| apart < least) {
            best[at] = Some((apart, pixel));
        }
    }
    let mut takers = vec![None; frames.pixels()];
    for (at, best) in best.iter().enumerate() {
        if let Some((_, pixel)) = best {
            takers[*pixel] = Some(at);
        }
    }
    takers
}

/// Every event that was warped onto the pixels of the frames once, on the event array's own.
///
/// # Errors
/// When events cannot be read.
pub(crate) fn on_array(
    events: &EventStream,
    alignment: &Alignment,
    cx: &Context,
) -> Result<EventBand, NodeError> {
    let frames = events.meta.extent;
    let takers = source_event_pixels(alignment, frames);
    let seen = (0..alignment.events.pixels()).filter(|at| alignment.is_seen(*at, frames)).count();
    let taken = takers.iter().flatten().count();
    cx.count(seen.saturating_sub(taken) as u64, "event pixels have no pixel of the frames, and no events");
    let band = events.read(frames.rows())?;
    let array = alignment.events.width as usize;
    let mut all = Vec::new();
    for y in frames.rows().iter() {
        let row = band.row(y);
        for k in 0..row.t.len() {
            let Some(at) = takers[y as usize * frames.width as usize + usize::from(row.x[k])] else {
                continue;
            };
            all.push(Event {
                x: (at % array) as u16,
                y: (at / array) as u16,
                polarity: photocurrent_core::events::Polarity::from_bit(row.on[k]),
                t: row.t[k],
                t_in: row.t_in.map(|t_in| t_in[k]),
            });
        }
    }
    Ok(EventBand::from_events(alignment.events.rows(), all)?)
}

/// Frames as the event pixels see them: those of `meta`. `done` is called after each.
///
/// # Errors
/// When frames cannot be read, or the run is stopped.
pub(crate) fn frames_on_array(
    frames: &FrameSequence,
    alignment: &Alignment,
    meta: &FramesMeta,
    done: &(dyn Fn() -> Result<(), NodeError> + Sync),
) -> Result<FrameBlock, NodeError> {
    let own = &frames.meta;
    let (channels, size) = (own.channels() as usize, (own.extent.width as usize, own.extent.height as usize));
    let mut block = FrameBlock::zeros(0..frames.len(), meta.extent.rows(), meta.row_values());
    let pictures = block.dn.chunks_exact_mut(meta.extent.pixels() * channels);
    pictures.enumerate().collect::<Vec<_>>().into_par_iter().try_for_each(
        |(l, picture)| -> Result<(), NodeError> {
            let dn = frames.read(l..l + 1, own.extent.rows())?.dn;
            for channel in 0..channels {
                let values = dn.iter().skip(channel).step_by(channels).copied().collect();
                let seen = alignment.to_events(&Image { width: size.0, height: size.1, values });
                picture
                    .iter_mut()
                    .skip(channel)
                    .step_by(channels)
                    .zip(seen.values)
                    .for_each(|(to, dn)| *to = dn);
            }
            done()
        },
    )?;
    Ok(block)
}

impl Node for AlignRecording {
    const DECL: Decl = Decl {
        kind: "align/recording",
        about: "Frames resampled to the event array, and every event once, on the array's own pixels.",
        revision: 2,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["Tulyakov et al., Time Lens, CVPR 2021: two cameras behind a beam splitter"],
        example: r#"
[nodes.alignment]
kind   = "read/alignment"
params = { path = "sequence" }

[nodes.array]
kind = "align/recording"
in   = { events = "recording.events", frames = "recording.frames", alignment = "alignment" }

[nodes.solve]
kind = "solve/map"
in   = { events = "array.events", frames = "array.frames", sensor = "sensor" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(AlignRecording { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let map = inputs.map("alignment")?;
        Alignment::check(map)?;
        let (events, frames) = (inputs.events("events")?, inputs.frames("frames")?);
        let (_, events, frames) = plan_of(self.params.events, events, frames, map.extent)?;
        Ok(vec![Meta::Events(Arc::new(events)), Meta::Frames(Arc::new(frames))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let alignment = Alignment::from_map(&input.alignment)?;
        let (pixels, events, frames) =
            plan_of(self.params.events, &input.events.meta, &input.frames.meta, alignment.events)?;
        cx.begin(input.frames.len() as u64, "frames");
        let band = match pixels {
            Pixels::Frames => on_array(&input.events, &alignment, cx)?,
            Pixels::Array => input.events.read(events.extent.rows())?,
        };
        let block = frames_on_array(&input.frames, &alignment, &frames, &|| cx.advance(1))?;
        Ok(Out {
            events: EventStream::in_memory(Arc::new(events), band),
            frames: FrameSequence::in_memory(Arc::new(frames), block),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::testing::{alignment, shifted};
    use photocurrent_core::{Colour, Exposure, testing};

    const EXTENT: Extent = Extent { width: 12, height: 9 };

    fn input(alignment: MapSet) -> In {
        let exposures = vec![Exposure::new(0, 1_000_000), Exposure::new(9_000_000, 10_000_000)];
        let frames = testing::captured(EXTENT, exposures, 0, |l, x, y| (10 * l as u32 + x + 3 * y) as f32);
        In { events: testing::events(EXTENT.width, EXTENT.height), frames, alignment }
    }

    fn run(input: In) -> Out {
        testing::with_context(EXTENT.rows(), &["events", "frames"], |cx| {
            AlignRecording { params: Params::default() }.run(input, cx)
        })
        .0
        .unwrap()
    }

    #[test]
    fn arrays_that_lie_pixel_on_pixel_stay_as_they_are() {
        let given = input(alignment(EXTENT, &shifted(0.0)));
        let (events, frames) = (given.events.clone(), given.frames.clone());
        let out = run(given);
        assert_eq!(out.events.read(EXTENT.rows()).unwrap(), events.read(EXTENT.rows()).unwrap());
        let (seen, own) =
            (out.frames.read_rows(EXTENT.rows()).unwrap(), frames.read_rows(EXTENT.rows()).unwrap());
        assert!(seen.dn.iter().zip(&own.dn).all(|(seen, own)| (seen - own).abs() < 1e-4));
    }

    #[test]
    fn an_array_between_the_pixels_sees_their_means_and_each_event_once() {
        let out = run(input(alignment(EXTENT, &shifted(0.5))));
        // A plane between four pixels.
        let frames = out.frames.read_rows(EXTENT.rows()).unwrap();
        assert!((frames.row(0, 2)[4] - (4.5 + 7.5)).abs() < 1e-4, "{}", frames.row(0, 2)[4]);
        let all = testing::events(EXTENT.width, EXTENT.height).read(EXTENT.rows()).unwrap().t.len();
        assert!(out.events.read(EXTENT.rows()).unwrap().t.len() <= all);
    }

    #[test]
    fn events_of_the_arrays_own_pixels_stay_and_the_frames_are_brought_to_them() {
        let given = input(alignment(EXTENT, &shifted(0.5)));
        let events = given.events.clone();
        let node = AlignRecording { params: Params { events: Some(Pixels::Array) } };
        let (out, _) = testing::with_context(EXTENT.rows(), &["events", "frames"], |cx| node.run(given, cx));
        let out = out.unwrap();
        assert_eq!(out.events.read(EXTENT.rows()).unwrap(), events.read(EXTENT.rows()).unwrap());
        let frames = out.frames.read_rows(EXTENT.rows()).unwrap();
        assert!((frames.row(1, 2)[4] - (10.0 + 4.5 + 7.5)).abs() < 1e-4);
    }

    #[test]
    fn what_cannot_be_aligned_is_refused_with_its_reason() {
        let given = input(alignment(EXTENT, &shifted(0.0)));
        let (events, frames) = (&given.events.meta, &given.frames.meta);
        let message = |frames: FramesMeta| {
            let array = Extent { width: 10, height: 8 };
            plan_of(None, events, &frames, array).err().unwrap().message
        };
        let mosaic = FramesMeta { colour: Colour::named("bayer_rggb").unwrap(), ..(**frames).clone() };
        assert!(message(mosaic).starts_with("frames are"));
        let mut rolling = (**frames).clone();
        rolling.times.row_time_ns = 5_000;
        assert!(message(rolling).contains("5000 ns after each other"));
        let larger = FramesMeta { extent: Extent { width: 24, height: 18 }, ..(**frames).clone() };
        assert!(message(larger).contains("events are 12 x 9, frames are 24 x 18"));
        let map = photocurrent_core::MapMeta { extent: EXTENT, planes: vec!["cost".into()] };
        assert!(Alignment::check(&map).unwrap_err().message.contains("the planes cost"));
    }
}
