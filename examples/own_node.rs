//! A node of one's own in a pipeline: the mean of every frame, run by the engine on a recording of a real
//! camera.
#![allow(clippy::print_stdout)]

use photocurrent_core::table::{Score, TableMeta};
use photocurrent_core::{
    Catalogue, Context, Decl, FrameSequence, Grain, Kind, Meta, Node, NodeError, PortMetas, Table, Value,
};
use photocurrent_engine::{Options, Plan, Selection, Unobserved, run};
use photocurrent_store::Cache;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::{Arc, atomic::AtomicBool};

/// Parameters: doc comments are the manual, ranges are checked before anything runs.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct Params {
    /// Only every so many frames.
    #[schemars(range(min = 1))]
    every: usize,
}

impl Default for Params {
    fn default() -> Params {
        Params { every: 1 }
    }
}

photocurrent_core::ports! {
    /// Inputs.
    struct In {
        /// The frames.
        frames: FrameSequence,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    struct Out {
        /// `mean_dn` of each frame.
        scores: Arc<Table>,
    }
}

/// The node.
struct MeanLevel {
    params: Params,
}

impl Node for MeanLevel {
    const DECL: Decl = Decl {
        kind: "own/mean_level",
        about: "Mean of each frame, DN.",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["arithmetic mean"],
        example: "",
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(MeanLevel { params })
    }

    fn metrics(_params: &Params) -> Vec<String> {
        vec!["mean_dn".into()]
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        inputs.frames("frames")?;
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: true }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let mut scores = Vec::new();
        for frame in (0..input.frames.len()).step_by(self.params.every) {
            let block = input.frames.read(frame..frame + 1, cx.rows())?;
            let known = || block.dn.iter().filter(|dn| dn.is_finite());
            let value = known().map(|dn| f64::from(*dn)).sum::<f64>() / known().count().max(1) as f64;
            let exposure = input.frames.meta.times.exposure(frame, 0);
            let t_ns = i64::midpoint(exposure.start.0, exposure.end.0);
            scores.push(Score {
                metric: "mean_dn".into(),
                frame: frame as i64,
                t_ns,
                value,
                unit: "DN".into(),
            });
        }
        Ok(Out { scores: Arc::new(Table::scores(scores, "mean over all known values of a frame")) })
    }
}

const MANIFEST: &str = r#"
format = 1

[nodes.recording]
kind   = "read/aedat4"
params = { path = "RECORDING" }

[nodes.mean]
kind   = "own/mean_level"
in     = { frames = "recording.frames" }
params = { every = 8 }
"#;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut kinds = photocurrent_nodes::read::formats::kinds();
    kinds.push(Kind::of::<MeanLevel>());
    let catalogue = Catalogue::new(kinds);
    let folder = tempfile::tempdir()?;
    let manifest = folder.path().join("own.toml");
    let recording = std::path::absolute("data/recordings/davis346_traffic.aedat4")?;
    std::fs::write(&manifest, MANIFEST.replace("RECORDING", &recording.to_string_lossy()))?;

    let selection = Selection::default();
    let (_, plan) =
        Plan::load(&manifest, &[], &catalogue, &selection).map_err(|problems| format!("{problems:?}"))?;
    let cache = Cache::open(&folder.path().join("cache"))?;
    let outcome = run(&plan, &cache, &Options::default(), &Unobserved, &AtomicBool::new(false));
    let variant = &plan.variants[0].name;
    let value = outcome.value(&cache, variant, "mean", "scores")?;
    let Some(Value::Table(table)) = value else { return Err("the node gave no table".into()) };
    for score in table.as_scores().unwrap_or_default() {
        println!("{:8.3} ms {:7.2} DN", score.t_ns as f64 / 1e6, score.value);
    }
    Ok(())
}
