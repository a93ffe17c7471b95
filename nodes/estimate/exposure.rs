//! `estimate/exposure`: the length of the exposure that blurred the frames.
//!
//! Events measure the change of light during an exposure. The length is proposed at which the mean over the
//! exposure explains the frames best.
//!
//! Limits: it needs light whose slope changes within an exposure, fast motion in bright places, and stamps at
//! the middle of the exposure. Where no length is clearly better the note gives the reason, and nothing is
//! proposed: event noise looks like blur. Thresholds of 0.7 to 1.6 times the input ones are tested with each
//! length, as blurred frames make them look small; the interval includes that of the offset.

use super::{Estimate, In, PanelSettings, TableRow, table};
use photocurrent_core::quantity::Duration;
use photocurrent_core::{Context, Decl, Grain, Meta, Node, NodeError, PortMetas, Table};
use photocurrent_sensor::estimate::{self, Unclear};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `estimate/exposure`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Most frames that are evaluated: all of a short recording, otherwise runs of neighbours spread over it.
    #[schemars(range(min = 2, max = 512))]
    pub frames: usize,
    /// How late events are against frames; absent = estimated as estimate/offset does.
    pub offset: Option<Duration>,
    /// ON and OFF thresholds, natural-log units; absent = those of the description, or estimated as
    /// estimate/thresholds does.
    pub thresholds: Option<[f64; 2]>,
}

impl Default for Params {
    fn default() -> Params {
        Params { frames: 48, offset: None, thresholds: None }
    }
}

photocurrent_core::ports! {
    /// The results.
    pub struct Out {
        /// `exposure`, ms.
        estimates: Arc<Table>,
    }
}

/// The length of the exposure, or why it is not clear, for people.
pub(super) fn exposure_length(
    panel: &estimate::Panel,
    thresholds: Option<(f64, f64)>,
    late_ns: &Estimate,
) -> Result<Estimate, String> {
    let thresholds =
        thresholds.ok_or("thresholds are not known, and too few bright pixels changed to measure them")?;
    estimate::exposure(panel, thresholds, late_ns).map_err(|why| match why {
        Unclear::NoChange => "nothing moves in bright pixels while frames are exposed".into(),
        Unclear::Flat { from_shortest, from_longest } => format!(
            "no length explains the frames much better than others: the residual is {:.0} % below that of \
             the shortest and {:.0} % below that of the longest, and noise of events alone \
             makes a fifth; the light bends too little within an exposure, or the exposure is short",
            100.0 * from_shortest,
            100.0 * from_longest
        ),
        Unclear::AtAnEnd => "the best length is at an end of its range for some thresholds or delays within \
                             their intervals"
            .into(),
    })
}

/// The node.
pub struct EstimateExposure {
    params: Params,
}

impl Node for EstimateExposure {
    const DECL: Decl = Decl {
        kind: "estimate/exposure",
        about: "Estimates the length of the exposure from the blur of frames and the events within it.",
        revision: 2,
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
        let settings = PanelSettings { frames: self.params.frames, ..PanelSettings::default() };
        let panel = input.panel(&settings)?;
        let stated = self.params.offset.map(|offset| super::stated_estimate(offset.ns() as f64));
        let late = stated
            .or_else(|| estimate::offset(&panel).map(|shift| shift.ns))
            .unwrap_or(super::stated_estimate(0.0));
        let described = input
            .sensor
            .as_deref()
            .and_then(|sensor| sensor.comparator.threshold_on.zip(sensor.comparator.threshold_off));
        let given = self.params.thresholds.map(|[on, off]| (on, off)).or(described);
        let thresholds = given.or_else(|| {
            estimate::thresholds(&panel, late.value).map(|found| (found.on.value, found.off.value))
        });
        let found = exposure_length(&panel, thresholds, &late);
        match (&found, thresholds) {
            (Err(why), _) => cx.note(why.clone()),
            (Ok(_), Some((on, off))) => cx.note(format!(
                "with thresholds {on:.3} and {off:.3}, events taken {:.3} ms later",
                late.value * 1e-6
            )),
            (Ok(_), None) => {}
        }
        let found = found.ok();
        Ok(Out { estimates: Arc::new(table(&[TableRow::new("exposure", found, "ms", 1e6)])) })
    }
}
