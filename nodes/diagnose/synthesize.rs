//! `diagnose/synthesize`: what the described sensor would have recorded of some light: the same pixels, exposures and stamps as a recording.
//!
//! With the description as stated, this is the control that residuals are held against; with another one (`read/sensor` with a `change`), it is that effect on the
//! recording's own scene. Events have the recording's stamps; frames have noise as stated, and what `frame_share` and `frame_dn` add. Pixels without light have no
//! events and unknown frame values.
//!
//! Limits: the load of a readout queue is that of the recording.

use photocurrent_core::{Context, Decl, EventStream, FrameScale, FrameSequence, FramesMeta, Grain, Meta, Node, NodeError, PortMetas, Sensor, TrackSet};
use photocurrent_diagnosis::light::from_tracks;
use photocurrent_diagnosis::record::{Conditions, Described, record};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `diagnose/synthesize`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Standard deviation of frame values as a share of their signal, beyond what is stated; 0 or more.
    #[schemars(range(min = 0.0))]
    pub frame_share: f64,
    /// The same in DN, beyond what is stated; 0 or more.
    #[schemars(range(min = 0.0))]
    pub frame_dn: f64,
}

impl Default for Params {
    fn default() -> Params {
        Params { frame_share: 0.003, frame_dn: 0.3 }
    }
}

photocurrent_core::ports! {
    /// The recording that is imitated, light, and the sensor that looks at it.
    pub struct In {
        /// The events of the recording.
        events: EventStream,
        /// The frames of the recording.
        frames: FrameSequence,
        /// The sensor that looks.
        sensor: Arc<Sensor>,
        /// What it looks at: log-linear tracks, such as those of diagnose/fit.
        tracks: TrackSet,
    }
}

photocurrent_core::ports! {
    /// What it records.
    pub struct Out {
        /// The events.
        events: EventStream,
        /// The frames, with the recording's exposures.
        frames: FrameSequence,
    }
}

/// The node.
pub struct DiagnoseSynthesize {
    params: Params,
}

impl Node for DiagnoseSynthesize {
    const DECL: Decl = Decl {
        kind: "diagnose/synthesize",
        about: "Records light with a described sensor, with the exposures and stamps of a recording: a control, or an effect on its own scene.",
        revision: 1,
        grain: Grain::Whole,
        draws: true,
        exports: false,
        sources: &["docs/diagnosis.md, roads"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.fit]
kind = "diagnose/fit"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }

[nodes.control]
kind = "diagnose/synthesize"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor", tracks = "fit.tracks" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(DiagnoseSynthesize { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let case = super::empty(inputs)?;
        let frames = inputs.frames("frames")?;
        let frames = FramesMeta { scale: FrameScale::Captured, ..(**frames).clone() };
        Ok(vec![Meta::Events(Arc::new(case.events_meta())), Meta::Frames(Arc::new(frames))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let case = super::case(Some(&input.events), Some(&input.frames), &input.sensor)?;
        let (sample, scene) = from_tracks(&case, &input.tracks)?;
        let conditions = Conditions { seed: cx.seed(), frame_share: self.params.frame_share, frame_dn: self.params.frame_dn, ..Conditions::default() };
        let recorded = record(&case, &case.nominal()?, &sample, &scene, &Described::new(), &conditions).map_err(NodeError::failed)?;
        let (events, frames) = recorded.streams()?;
        Ok(Out { events, frames: frames.unwrap_or(input.frames) })
    }
}
