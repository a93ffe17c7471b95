//! `diagnose/fit`: the light of some pixels of a recording, estimated with the sensor as described so that it fires the recorded events again.
//!
//! Light is estimated with several priors, the described sensor looks at each, and every pixel keeps the prior whose events are most like the recorded ones. The tracks
//! are those of the looked-at pixels only; others have no knot. With `like`, pixels and priors are those of another fit: so a simulated recording is treated as the
//! real one was.
//!
//! Limits: a free light explains much of what a faulty sensor does; that is what residuals are short of.

use photocurrent_core::table::{Column, Score, TableMeta};
use photocurrent_core::{Context, Decl, EventStream, FrameSequence, Grain, Meta, Node, NodeError, PortMetas, Sensor, Table, TrackSet};
use photocurrent_diagnosis::case::Case;
use photocurrent_diagnosis::light::{PRIORS, fit, fit_like, tracks, tracks_meta};
use photocurrent_diagnosis::sample::Sample;
use photocurrent_diagnosis::scene::SceneSetting;
use photocurrent_sensor::map::{MapOptions, Noise};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `diagnose/fit`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Which pixels are looked at, when `like` is not connected.
    pub pixels: Pixels,
    /// With `pixels = "spread"`: how many blocks of 6 x 6 pixels are taken from each band of six rows; 1 to 100.
    #[schemars(range(min = 1, max = 100))]
    pub across: u32,
    /// How closely events are believed: standard deviation of one, as a part of its threshold. Believed too closely, events take with them what the light cannot have done.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub event_sigma: f64,
    /// Most steps of the solver; 1 to 100.
    #[schemars(range(min = 1, max = 100))]
    pub max_iterations: usize,
}

impl Default for Params {
    fn default() -> Params {
        Params { pixels: Pixels::Spread, across: 3, event_sigma: 0.03, max_iterations: 5 }
    }
}

/// Which pixels are looked at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Pixels {
    /// Blocks that together touch all rows and many columns, where most happens.
    #[default]
    Spread,
    /// All of them.
    All,
}

photocurrent_core::ports! {
    /// The recording and what is stated of its sensor.
    pub struct In {
        /// The events.
        events: EventStream,
        /// The frames as captured, grey, of the events' pixels.
        frames: FrameSequence,
        /// The description that the light is estimated with.
        sensor: Arc<Sensor>,
        /// The `pixels` of another fit, whose pixels and priors are taken.
        like: Option<Arc<Table>>,
    }
}

photocurrent_core::ports! {
    /// The light.
    pub struct Out {
        /// The light of the pixels that were looked at.
        tracks: TrackSet,
        /// One row a pixel: `x`, `y`, `prior`.
        pixels: Arc<Table>,
        /// Pooled: `agreement`, %, of recorded events and those that the light fires again; `pixels_known`, how many have a light.
        scores: Arc<Table>,
    }
}

/// The node.
pub struct DiagnoseFit {
    params: Params,
}

impl Node for DiagnoseFit {
    const DECL: Decl = Decl {
        kind: "diagnose/fit",
        about: "Estimates the light of some pixels with the sensor as described, so that it fires the recorded events again.",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["docs/diagnosis.md, roads", "method = \"map\" of solve/pixel"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.fit]
kind   = "diagnose/fit"
in     = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }
params = { across = 2 }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if params.pixels == Pixels::All && params.across != Params::default().across {
            return Err(NodeError::usage("`across` is read with `pixels = \"spread\"` only").hint("leave `across` out").param("across"));
        }
        Ok(DiagnoseFit { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let case = super::empty(inputs)?;
        let table = |scores| Meta::Table(Arc::new(TableMeta { scores }));
        Ok(vec![Meta::Tracks(Arc::new(tracks_meta(&case))), table(false), table(true)])
    }

    fn run(&self, input: In, _: &Context) -> Result<Out, NodeError> {
        let case = super::case(Some(&input.events), Some(&input.frames), &input.sensor)?;
        let nominal = case.nominal()?;
        let usual = SceneSetting::default();
        let noise = Noise { event: self.params.event_sigma, ..usual.noise };
        let options = MapOptions { max_iterations: self.params.max_iterations, ..usual.options };
        let setting = SceneSetting { noise, options, ..usual };
        let found = match (&input.like, self.params.pixels) {
            (Some(table), _) => fit_like(&case, &nominal, &read(&case, table)?, &setting),
            (None, Pixels::Spread) => fit(&case, &nominal, Sample::spread(&case, self.params.across), &setting),
            (None, Pixels::All) => fit(&case, &nominal, Sample::all(&case, 6), &setting),
        };
        let found = found.map_err(NodeError::failed)?;
        let places: Vec<(u32, u32)> = found.sample.pixels.iter().map(|pixel| case.place(*pixel as usize)).collect();
        let pixels = Table::default()
            .with("x", Column::Integers(places.iter().map(|place| place.0.into()).collect()))
            .with("y", Column::Integers(places.iter().map(|place| place.1.into()).collect()))
            .with("prior", Column::Texts(found.priors.iter().map(|prior| PRIORS[*prior].into()).collect()));
        let known = found.scene.is_known.iter().filter(|known| **known).count();
        let pooled = |metric: &str, value: f64, unit: &str| Score { metric: metric.into(), frame: -1, t_ns: 0, value, unit: unit.into() };
        let scores = vec![pooled("agreement", 100.0 * found.agreement, "%"), pooled("pixels_known", known as f64, "px")];
        let card = "fit.v1: agreement = recorded and simulated events with a partner of their polarity within 0.5 ms, over all of them";
        Ok(Out { tracks: tracks(&case, &found.sample, &found.scene), pixels: Arc::new(pixels), scores: Arc::new(Table::scores(scores, card)) })
    }
}

/// Pixels and priors of another fit.
fn read(case: &Case, table: &Table) -> Result<Vec<(u32, usize)>, NodeError> {
    let (Some(Column::Integers(x)), Some(Column::Integers(y)), Some(Column::Texts(priors))) = (table.column("x"), table.column("y"), table.column("prior"))
    else {
        return Err(NodeError::input("`like` has no columns `x`, `y` and `prior`").hint("connect the output `pixels` of another diagnose/fit"));
    };
    let one = |((x, y), prior): ((&i64, &i64), &String)| {
        let inside = |at: i64, size: u32| u32::try_from(at).ok().filter(|at| *at < size);
        let pixel = inside(*x, case.extent.width).zip(inside(*y, case.extent.height)).map(|(x, y)| y * case.extent.width + x);
        let outside = || NodeError::input(format!("`like` names the pixel ({x}, {y}), and the array is {}", case.extent));
        let prior = PRIORS.iter().position(|name| name == prior).ok_or_else(|| NodeError::input(format!("`like` names a prior `{prior}`, which there is not")));
        Ok((pixel.ok_or_else(outside)?, prior?))
    };
    x.iter().zip(y).zip(priors).map(one).collect()
}
