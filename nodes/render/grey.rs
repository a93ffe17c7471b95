//! `render/grey`: captured frames as the event pixels see them, one grey value for each.
//!
//! A photodiode without a filter sees the light of all values of a frame that lie on it, as a mixture
//! ([`GreyFrames`]). Solved with the mixture, every event counts once, and counts for what it saw;
//! `render/colour` gives what was solved its colours again.
//!
//! Limits: a value that is saturated counts as it is, so that the mixture is too small there; what the
//! description states of the noise of a value is that of the mixture too, which is less.

use photocurrent_core::{
    Context, Decl, EventStream, Extent, FrameSequence, FramesMeta, Grain, Meta, Node, NodeError, PortMetas,
    Sensor,
};
use photocurrent_scene::grey::{GreyFrames, SaturatedMean};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `render/grey`: none.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Captured frames: three channels, a mosaic, or more pixels than the events have.
        frames: FrameSequence,
        /// The events next to them.
        events: EventStream,
        /// What an event pixel sees of each colour, gains of the channels, black level.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// One grey value for each event pixel, captured when the frames were.
        frames: FrameSequence,
    }
}

/// The node.
pub struct RenderGrey;

/// How values lie on event pixels, and what the grey frames are.
///
/// # Errors
/// When the frames' extent is no whole multiple of the events', or each event pixel has a filter of its own.
fn plan_of(
    extent: Extent,
    frames: &FramesMeta,
    sensor: &Sensor,
) -> Result<(GreyFrames, FramesMeta), NodeError> {
    let grey = GreyFrames::new(extent, frames, sensor)?;
    if grey.is_behind_filters() {
        return Err(NodeError::usage(format!(
            "frames are {}, with the cell of the mosaic larger than an event pixel: none sees a mixture",
            frames.colour
        ))
        .hint("leave render/grey out: each value is solved with the events of its own pixel"));
    }
    let meta = grey.meta(frames);
    Ok((grey, meta))
}

impl Node for RenderGrey {
    const DECL: Decl = Decl {
        kind: "render/grey",
        about: "Captured colour frames as the event pixels see them: the mixture of the values on each.",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["Jiang et al., CVPR 2024, section 3"],
        example: r#"
[nodes.grey]
kind = "render/grey"
in   = { frames = "recording.frames", events = "recording.events", sensor = "sensor" }

[nodes.solve]
kind = "solve/map"
in   = { events = "recording.events", frames = "grey", sensor = "sensor" }
"#,
    };
    const LOCAL_IN_TIME: bool = true;
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(_: Params) -> Result<Self, NodeError> {
        Ok(RenderGrey)
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let (frames, events) = (inputs.frames("frames")?, inputs.events("events")?);
        Ok(vec![Meta::Frames(Arc::new(plan_of(events.extent, frames, inputs.sensor("sensor")?)?.1))])
    }

    fn run(&self, input: In, _: &Context) -> Result<Out, NodeError> {
        let (grey, _) = plan_of(input.events.meta.extent, &input.frames.meta, &input.sensor)?;
        Ok(Out { frames: grey.frames(&input.frames, SaturatedMean::Mean)? })
    }
}
