//! `diagnose/decide`: probabilities from evidence: that something differs from the stated sensor, which
//! effect it is, whether there is a second one, or that it is in no catalogue.
//!
//! One small model with calibrated numbers for each kind of scene, all of them parameters here;
//! `photocurrent-calibrate` makes them anew from simulated recordings. Evidence is cached by itself, so that
//! another model or threshold is tried in no time.
//!
//! Source: docs/diagnosis.md, the moving picture. Limits: without evidence, or where what is left has no
//! explanation, nothing is decided, and the proposals say why.

use photocurrent_core::{
    Context, Decl, Diagnosis, DiagnosisKind, DiagnosisMeta, Grain, Meta, Node, NodeError, PortMetas, Sensor,
};
use photocurrent_diagnosis::decide::model::{Model, Models, SECOND, SOMETHING};
use photocurrent_diagnosis::decide::{Decision, decide};
use photocurrent_diagnosis::stages::{Proposed, Seen, read_evidence, write_proposals};
use photocurrent_scene::nominal::Nominal;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `diagnose/decide`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Something differs from this probability on.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub least: f64,
    /// And there is a second effect from this probability on.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub least_second: f64,
    /// Nothing is decided where events of the stated sensor on its own scene miss their thresholds by more
    /// than this share of them (median).
    #[schemars(range(min = 0.0))]
    pub most_control: f64,
    /// Nor, on a scene that was fitted to frames, where more than this share is left with the best effect.
    #[schemars(range(min = 0.0))]
    pub most_left: f64,
    /// And finding nothing decides nothing where more than this share is left.
    #[schemars(range(min = 0.0))]
    pub most_silent: f64,
    /// Nor where nothing is said from a smaller gain on than this, nats an event.
    #[schemars(range(min = 0.0))]
    pub most_needed: f64,
    /// Error of sizes that all blocks share, as a share of the departure.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub shared_error: f64,
    /// The model of a moving picture, and of every kind of scene that has none of its own.
    pub picture: Numbers,
    /// The model of a scene in parts, or before a still ground.
    pub patches: Numbers,
    /// The model of known light.
    pub given: Numbers,
}

/// Numbers of a model; those that are left out are the built-in ones.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Numbers {
    /// Log odds that something differs: constant, and weights of the logarithms of what the best effect gains
    /// and a second one in addition to it, and of the share of the events that count.
    pub something: Option<[f64; SOMETHING]>,
    /// Log odds of a second effect: constant, and weights of the logarithms of its gain and of that over the
    /// first's.
    pub second: Option<[f64; SECOND]>,
    /// Logarithms of gains count less by this of random effects, and of those that change how far light
    /// swings from event to event: such effects gain where the scene errs.
    pub discount: Option<[f64; 2]>,
    /// Logarithm of the share of the best gain by which an effect must fall short to be a factor e less
    /// probable, at a gain of 1 nat an event; and what it grows by with the logarithm of that gain.
    pub softness: Option<[f64; 2]>,
    /// Log odds of a random effect over one with a size, at the same gain.
    pub random: Option<f64>,
    /// Log odds of what is in no catalogue: constant, and weights of the logarithms of the best curve's gain
    /// with the best effect, and alone, over that effect's.
    pub unnamed: Option<[f64; 3]>,
}

impl Numbers {
    fn of(model: &Model) -> Numbers {
        let Model { something, second, discount, softness, random, unnamed } = *model;
        Numbers {
            something: Some(something),
            second: Some(second),
            discount: Some(discount),
            softness: Some(softness),
            random: Some(random),
            unnamed: Some(unnamed),
        }
    }

    /// With what is left out from `built_in`.
    fn model(&self, built_in: &Model) -> Model {
        Model {
            something: self.something.unwrap_or(built_in.something),
            second: self.second.unwrap_or(built_in.second),
            discount: self.discount.unwrap_or(built_in.discount),
            softness: self.softness.unwrap_or(built_in.softness),
            random: self.random.unwrap_or(built_in.random),
            unnamed: self.unnamed.unwrap_or(built_in.unnamed),
        }
    }
}

impl Default for Params {
    fn default() -> Params {
        let Decision {
            models,
            least,
            least_second,
            most_control,
            most_left,
            most_silent,
            most_needed,
            shared_error,
        } = Decision::default();
        let [picture, patches, given] =
            [models.picture, models.patches, models.given].map(|model| Numbers::of(&model));
        Params {
            least,
            least_second,
            most_control,
            most_left,
            most_silent,
            most_needed,
            shared_error,
            picture,
            patches,
            given,
        }
    }
}

photocurrent_core::ports! {
    /// What the events say, and the description that they were held against.
    pub struct In {
        /// What residuals say of every effect, a diagnosis of kind `evidence`.
        evidence: Arc<Diagnosis>,
        /// The description, with what direct tests found.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// What may be missing.
    pub struct Out {
        /// What is decided, or why nothing is: a diagnosis of kind `proposals`.
        proposals: Arc<Diagnosis>,
    }
}

/// The node.
pub struct DiagnoseDecide {
    decision: Decision,
}

impl Node for DiagnoseDecide {
    const DECL: Decl = Decl {
        kind: "diagnose/decide",
        about: "Makes probabilities of evidence: that something differs, which effect it is, a second one, \
                or none of the catalogue.",
        revision: 7,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["docs/diagnosis.md, the moving picture"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.integrity]
kind = "diagnose/integrity"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }

[nodes.evidence]
kind = "diagnose/evidence"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor", integrity = "integrity.findings" }

[nodes.decide]
kind   = "diagnose/decide"
in     = { evidence = "evidence", sensor = "integrity.sensor" }
params = { least = 0.9 }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        let Params {
            least,
            least_second,
            most_control,
            most_left,
            most_silent,
            most_needed,
            shared_error,
            picture,
            patches,
            given,
        } = params;
        let built_in = Models::default();
        let models = Models {
            picture: picture.model(&built_in.picture),
            patches: patches.model(&built_in.patches),
            given: given.model(&built_in.given),
        };
        Ok(DiagnoseDecide {
            decision: Decision {
                models,
                least,
                least_second,
                most_control,
                most_left,
                most_silent,
                most_needed,
                shared_error,
            },
        })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        inputs.diagnosis("evidence")?.need(DiagnosisKind::Evidence, "evidence")?;
        inputs.sensor("sensor")?;
        Ok(vec![Meta::Diagnosis(Arc::new(DiagnosisMeta { kind: DiagnosisKind::Proposals }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let proposed = match read_evidence(&input.evidence)? {
            Seen::NotAsked => Proposed::NotAsked,
            Seen::Nothing(why) => Proposed::Nothing(why),
            Seen::Evidence(found) => match decide(&found, &Nominal::of(&input.sensor), &self.decision) {
                Ok(decided) => Proposed::Decided(Box::new(decided)),
                Err(why) => Proposed::Nothing(why),
            },
        };
        if let Proposed::Nothing(why) = &proposed {
            cx.note(format!("nothing is decided: {why}"));
        }
        Ok(Out { proposals: Arc::new(write_proposals(&proposed)?) })
    }
}
