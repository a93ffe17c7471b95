//! `estimate/exposure`: the length of the exposure that blurred the frames.
//!
//! Events say how the light went while a frame was exposed. The length at which the mean over the exposure explains the frames best is proposed.
//!
//! Limits: it needs light that bends within an exposure, fast motion over fine texture, events with little noise, and stamps at the middle of the exposure. Real
//! recordings rarely have all of it, and then nothing is proposed: noise of events looks like blur.

use super::{In, Row, Settings, panel, table};
use photocurrent_core::quantity::Duration;
use photocurrent_core::{Context, Decl, Grain, Meta, Node, NodeError, PortMetas, Table};
use photocurrent_sensor::estimate;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `estimate/exposure`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Frames that are looked at, at most: all of a short recording, otherwise runs of neighbours spread over it.
    #[schemars(range(min = 2, max = 512))]
    pub frames: usize,
    /// How late events are against frames; absent = estimated as estimate/offset does.
    pub offset: Option<Duration>,
    /// ON and OFF thresholds, natural-log units; absent = those of the description, or estimated as estimate/thresholds does.
    pub thresholds: Option<[f64; 2]>,
}

impl Default for Params {
    fn default() -> Params {
        Params { frames: 48, offset: None, thresholds: None }
    }
}

photocurrent_core::ports! {
    /// What was found.
    pub struct Out {
        /// `exposure`, ms.
        estimates: Arc<Table>,
    }
}

/// The node.
pub struct EstimateExposure {
    params: Params,
}

impl Node for EstimateExposure {
    const DECL: Decl = Decl {
        kind: "estimate/exposure",
        about: "Length of the exposure, from how frames are blurred where events say how the light went.",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["Pan et al., CVPR 2019: the event-based double integral"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.exposure]
kind = "estimate/exposure"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(EstimateExposure { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        super::plan(inputs)
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let settings = Settings { frames: self.params.frames, ..Settings::default() };
        let panel = panel(&input.events, &input.frames, input.sensor.as_deref(), &settings)?;
        let offset_ns = self.params.offset.map(|offset| offset.ns() as f64).or_else(|| estimate::offset(&panel).map(|shift| shift.ns.value)).unwrap_or(0.0);
        let stated = input.sensor.as_deref().and_then(|sensor| sensor.comparator.threshold_on.zip(sensor.comparator.threshold_off));
        let given = self.params.thresholds.map(|[on, off]| (on, off)).or(stated);
        let thresholds = given.or_else(|| estimate::thresholds(&panel, offset_ns).map(|found| (found.on.value, found.off.value)));
        let found = thresholds.and_then(|thresholds| estimate::exposure(&panel, thresholds, offset_ns));
        match (thresholds, &found) {
            (None, _) => cx.note("thresholds are not known, and too few pixels changed to estimate them"),
            (Some(_), None) => cx.note(
                "no length explains the frames better than the others: the curvature of the light within an exposure is too small, or events are too noisy",
            ),
            (Some((on, off)), Some(_)) => cx.note(format!("with thresholds {on:.3} and {off:.3}, events taken {:.3} ms later", offset_ns * 1e-6)),
        }
        Ok(Out { estimates: Arc::new(table(&[Row::new("exposure", found, "ms", 1e6)])) })
    }
}
