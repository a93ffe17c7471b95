//! `diagnose/target`: the light of a known target: a scene in closed form with named free parameters, fitted
//! to the frames.
//!
//! The target is stated as for `simulate/scene`: a rotating star, a fan, a sliding board. Its place, speed
//! and phase are known to a range. Each range is searched, then the best few candidates are fitted by damped
//! Gauss-Newton with robust weights (Student's t) to a sample of the frame values. Each of these is the mean
//! of the scene over its row's exposure. `target` is the fitted scene with its free parameters, for
//! `diagnose/evidence`, which fits them with every effect; `light` is its light over the recording, for every
//! input that takes light.
//!
//! Source: docs/diagnosis.md, known targets. Limits: the whole array sees the target. A free parameter hides
//! an effect that is exactly alike (`illuminance` an exposure time), so state what is known. Frames are
//! predicted with the stated sensor.

use crate::simulate::scenes::{self, Details};
use crate::simulate::source::{Look, Scale};
use photocurrent_core::light::LightBand;
use photocurrent_core::quantity::{Duration, Illuminance};
use photocurrent_core::table::{Column, TableMeta};
use photocurrent_core::{
    Colour, Context, Decl, Diagnosis, DiagnosisKind, DiagnosisMeta, EventStream, Extent, FrameSequence,
    Grain, Light, LightMeta, Meta, Node, NodeError, PortMetas, Sensor, Table, TimeSpan,
};
use photocurrent_scene::case::Case;
use photocurrent_scene::closed::ClosedScene;
use photocurrent_scene::light::LightKnots;
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::target::{FittedTarget, TargetForm, TargetSetting};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Parameters of `diagnose/target`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
#[serde(default)]
pub struct Params {
    /// The scene.
    pub scene: scenes::Name,
    /// Light on it.
    #[schemars(extend("x-min" = "0.001 lx", "x-max" = "1000000 lx"))]
    pub illuminance: Illuminance,
    /// Shift to the right of its place in `simulate/scene`, pixels.
    #[schemars(range(min = -1000.0, max = 1000.0))]
    pub shift_x: f64,
    /// And further down, pixels.
    #[schemars(range(min = -1000.0, max = 1000.0))]
    pub shift_y: f64,
    /// How long it had moved when the clock of the recording stood at 0.
    #[schemars(extend("x-min" = "-1000 s", "x-max" = "1000 s"))]
    pub start: Duration,
    /// Blur of the lens, standard deviation in pixels.
    #[schemars(range(min = 0.0, max = 5.0))]
    pub blur: f64,
    /// Free parameters by name, those of the scene as `siemens_disk.speed`, each with its range.
    pub free: BTreeMap<String, [Value; 2]>,
    /// How it is fitted.
    #[serde(flatten)]
    pub fit: TargetSetting,
    #[serde(flatten)]
    #[allow(missing_docs)]
    pub details: Details,
}

impl Default for Params {
    fn default() -> Params {
        Params {
            scene: scenes::Name::default(),
            illuminance: Illuminance::new(300.0),
            shift_x: 0.0,
            shift_y: 0.0,
            start: Duration::new(0),
            blur: 0.0,
            free: BTreeMap::new(),
            fit: TargetSetting::default(),
            details: Details::default(),
        }
    }
}

photocurrent_core::ports! {
    /// The recording and its description.
    pub struct In {
        /// The events: only when they were recorded.
        events: Option<EventStream>,
        /// The frames as captured, grey.
        frames: FrameSequence,
        /// The nominal description.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// The target.
    pub struct Out {
        /// Photocurrent of every pixel over the recording.
        light: Light,
        /// The fitted free parameters, with standard errors.
        fitted: Arc<Table>,
        /// The same target with its free parameters, for `diagnose/evidence`: a diagnosis of kind `target`.
        target: Arc<Diagnosis>,
    }
}

const WHO: &str = "diagnose/target";

/// A free parameter: where it is, and the ends of its range.
#[derive(Clone, Debug)]
struct RangedParameter {
    name: String,
    pointer: String,
    from: f64,
    to: f64,
    unit: Option<String>,
}

impl RangedParameter {
    fn new(name: &str, ends: &[Value; 2], params: &Value) -> Result<RangedParameter, NodeError> {
        let wrong = |what: String, hint: &str| NodeError::usage(what).hint(hint.to_owned()).param("free");
        let pointer = format!("/{}", name.replace('.', "/"));
        let now = params.pointer(&pointer).filter(|now| {
            now.is_number() || now.as_str().is_some_and(|text| number_and_unit(text).is_some())
        });
        if now.is_none() || ["free", "values", "tries"].contains(&name) {
            return Err(wrong(
                format!("`{name}` is no number of this target"),
                "name a parameter as in `siemens_disk.speed`, `shift_x`, `start`, `illuminance`",
            ));
        }
        let one = |end: &Value| -> Option<(f64, Option<String>)> {
            end.as_f64()
                .map(|value| (value, None))
                .or_else(|| number_and_unit(end.as_str()?).map(|(value, unit)| (value, Some(unit))))
        };
        let hint = "give the least and the greatest value it may have, both in the same unit: [\"280 rpm\", \
                    \"300 rpm\"]";
        match (one(&ends[0]), one(&ends[1])) {
            (Some((from, unit)), Some((to, other)))
                if unit == other && from < to && unit.is_some() == now.is_some_and(Value::is_string) =>
            {
                Ok(RangedParameter { name: name.into(), pointer, from, to, unit })
            }
            _ => Err(wrong(format!("the range of `{name}` is {} to {}", ends[0], ends[1]), hint)),
        }
    }

    fn value(&self, share: f64) -> f64 {
        self.from + (self.to - self.from) * share
    }

    fn json(&self, share: f64) -> Value {
        match &self.unit {
            Some(unit) => Value::from(format!("{} {unit}", self.value(share))),
            None => Value::from(self.value(share)),
        }
    }
}

/// Number and unit of a quantity's text; `None` where it is none.
fn number_and_unit(text: &str) -> Option<(f64, String)> {
    let (number, unit) = text.trim().split_once(' ')?;
    Some((number.parse().ok()?, unit.trim().to_owned()))
}

/// A scene with the camera's shift and the light on it.
struct LitScene {
    scene: Box<dyn ClosedScene>,
    shift: (f64, f64),
    start_ns: i64,
    blur: f64,
    /// Photocurrent of white.
    white: f64,
}

/// Gauss-Hermite: three places of a normal distribution, standard deviations, with their weights.
const HERMITE: [(f64, f64); 3] =
    [(-1.732_050_807_568_877_2, 1.0 / 6.0), (0.0, 2.0 / 3.0), (1.732_050_807_568_877_2, 1.0 / 6.0)];

impl LitScene {
    fn new(params: &Params, extent: Extent, sensor: &Sensor, seed: u64) -> Result<LitScene, NodeError> {
        Ok(LitScene {
            scene: params.details.scene(params.scene, extent, seed),
            shift: (params.shift_x, params.shift_y),
            start_ns: params.start.ns(),
            blur: params.blur,
            white: Scale::new(sensor, params.illuminance, Duration::new(1), WHO)?.white,
        })
    }

    /// Places of the scene that a pixel sees, with their weights.
    fn places(&self, x: f64, y: f64) -> impl Iterator<Item = (f64, f64, f64)> {
        let (x, y, blur) = (x - self.shift.0, y - self.shift.1, self.blur);
        let which = if blur > 0.0 { 0..3 } else { 1..2 };
        let whole = if blur > 0.0 { 1.0 } else { 2.25 };
        which.clone().flat_map(move |i| {
            which.clone().map(move |j| {
                (x + blur * HERMITE[i].0, y + blur * HERMITE[j].0, whole * HERMITE[i].1 * HERMITE[j].1)
            })
        })
    }
}

/// How light is sampled.
const LOOK: Look = Look { step: Duration::new(100_000), tolerance: 1e-3, graze: false };

impl ClosedScene for LitScene {
    fn light(&self, x: f64, y: f64, t_ns: i64) -> f64 {
        let places = self.places(x, y);
        let reflectance = places.map(|(x, y, weight)| weight * self.scene.light(x, y, t_ns + self.start_ns));
        self.white * reflectance.sum::<f64>()
    }

    fn speed(&self, x: f64, y: f64) -> f64 {
        self.places(x, y).map(|(x, y, _)| self.scene.speed(x, y)).fold(0.0, f64::max)
    }

    fn still_until(&self, x: f64, y: f64, t_ns: i64) -> i64 {
        let until = self
            .places(x, y)
            .map(|(x, y, _)| self.scene.still_until(x, y, t_ns + self.start_ns))
            .min()
            .unwrap_or(t_ns);
        if until == i64::MAX { until } else { until - self.start_ns }
    }

    fn knots(&self, x: f64, y: f64, span: (i64, i64)) -> LightKnots {
        LOOK.sample(self, None, (x, y), span.0, span.1, 1.0)
            .into_iter()
            .map(|(t, photocurrent)| (t + span.0, photocurrent))
            .unzip()
    }
}

/// All targets within the ranges of the free parameters.
struct TargetFamily {
    params: Value,
    free: Vec<RangedParameter>,
    extent: Extent,
    sensor: Sensor,
    seed: u64,
}

impl TargetFamily {
    fn params(&self, shares: &[f64]) -> Result<Params, NodeError> {
        let mut value = self.params.clone();
        for (free, share) in self.free.iter().zip(shares) {
            if let Some(at) = value.pointer_mut(&free.pointer) {
                *at = free.json(*share);
            }
        }
        serde_json::from_value(value).map_err(|why| {
            NodeError::usage(format!("a free parameter leaves its range: {why}")).param("free")
        })
    }
}

impl TargetForm for TargetFamily {
    fn count(&self) -> usize {
        self.free.len()
    }

    fn at(&self, shares: &[f64]) -> Option<Box<dyn ClosedScene>> {
        let params = self.params(shares).ok()?;
        Some(Box::new(LitScene::new(&params, self.extent, &self.sensor, self.seed).ok()?))
    }
}

/// A fitted target as a document.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct FittedTargetDocument {
    /// Nominal, with the ranges.
    params: Value,
    seed: u64,
    /// The free parameters, as shares of their ranges.
    shares: Vec<f64>,
}

/// A target from its document, its free parameters fitted to the frames of a recording from where they were
/// found.
pub fn read_target(document: &Diagnosis, case: &Case, nominal: &Nominal) -> Result<FittedTarget, NodeError> {
    let FittedTargetDocument { params, seed, shares } = document.read()?;
    let params: Params = serde_json::from_value(params)
        .map_err(|why| NodeError::failed(format!("a fitted target cannot be read: {why}")))?;
    let node = DiagnoseTarget::build(params)?;
    let form = Arc::new(node.family(case.extent, &case.sensor, seed));
    FittedTarget::fit_near(case, nominal, form, node.setting(seed), &shares)
        .ok_or_else(|| NodeError::failed("the fitted target makes no scene".to_owned()))
}

fn light_meta(case: &Case, count_hint: Option<u64>) -> LightMeta {
    let span = TimeSpan::new(case.span.0, case.span.1);
    LightMeta { extent: case.extent, span, colour: Colour::Mono, count_hint }
}

/// The node.
pub struct DiagnoseTarget {
    params: Params,
    json: Value,
    free: Vec<RangedParameter>,
}

impl DiagnoseTarget {
    fn family(&self, extent: Extent, sensor: &Sensor, seed: u64) -> TargetFamily {
        TargetFamily {
            params: self.json.clone(),
            free: self.free.clone(),
            extent,
            sensor: sensor.clone(),
            seed,
        }
    }

    fn setting(&self, seed: u64) -> TargetSetting {
        TargetSetting { seed, ..self.params.fit }
    }
}

impl Node for DiagnoseTarget {
    const DECL: Decl = Decl {
        kind: "diagnose/target",
        about: "Fits named free parameters of a known target to the frames, and returns its light.",
        revision: 3,
        grain: Grain::Whole,
        draws: true,
        exports: false,
        sources: &["docs/diagnosis.md, known targets"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.target]
kind = "diagnose/target"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }

[nodes.target.params]
scene        = "siemens_disk"
siemens_disk = { spokes = 12 }
free         = { "siemens_disk.speed" = ["250 rpm", "320 rpm"], start = ["0 ms", "20 ms"], shift_x = [-2.0, 2.0], shift_y = [-2.0, 2.0] }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        params.details.check(params.scene)?;
        let json = serde_json::to_value(&params).map_err(|error| NodeError::failed(error.to_string()))?;
        let free = params
            .free
            .iter()
            .map(|(name, ends)| RangedParameter::new(name, ends, &json))
            .collect::<Result<Vec<RangedParameter>, NodeError>>()?;
        let node = DiagnoseTarget { params, json, free };
        for end in [0.0, 1.0] {
            node.free.iter().try_for_each(|free| {
                let mut value = node.json.clone();
                if let Some(at) = value.pointer_mut(&free.pointer) {
                    *at = free.json(end);
                }
                let wrong = |why: serde_json::Error| {
                    NodeError::usage(format!("`{}` cannot be {}: {why}", free.name, free.json(end)))
                        .param("free")
                };
                serde_json::from_value::<Params>(value).map(drop).map_err(wrong)
            })?;
        }
        Ok(node)
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let sensor = super::check(inputs)?;
        Scale::new(sensor, self.params.illuminance, Duration::new(1), WHO)?;
        let case = super::empty(inputs)?;
        let light = light_meta(&case, None);
        let document = DiagnosisMeta { kind: DiagnosisKind::Target };
        Ok(vec![
            Meta::Light(Arc::new(light)),
            Meta::Table(Arc::new(TableMeta { scores: false })),
            Meta::Diagnosis(Arc::new(document)),
        ])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let case = super::case(input.events.as_ref(), Some(&input.frames), &input.sensor)?;
        let nominal = case.nominal()?;
        let family = Arc::new(self.family(case.extent, &input.sensor, cx.seed()));
        let target = FittedTarget::fit(&case, &nominal, family.clone(), self.setting(cx.seed()))
            .ok_or_else(|| NodeError::failed("the target's parameters make no scene".to_owned()))?;
        let (shares, errors) = (target.shares(), target.errors());
        let params = family.params(shares)?;
        for (free, share) in self.free.iter().zip(shares) {
            let at_end = if (0.001..0.999).contains(share) { "" } else { ", the end of its range: widen it" };
            cx.note(format!("{} = {}{at_end}", free.name, free.json(*share).to_string().trim_matches('"')));
        }
        cx.note(format!(
            "frame values miss the target by {:.2} standard deviations (median; 0.67 is noise alone)",
            target.median_residual()
        ));
        let scene = LitScene::new(&params, case.extent, &input.sensor, cx.seed())?;
        let pixel = |n: u32| -> Vec<(i64, f32)> {
            let (x, y) = (f64::from(n % case.extent.width), f64::from(n / case.extent.width));
            let (t, light) = scene.knots(x, y, case.span);
            t.into_iter().zip(light).map(|(t, photocurrent)| (t, photocurrent as f32)).collect()
        };
        let pixels: Vec<Vec<(i64, f32)>> =
            (0..case.extent.pixels() as u32).into_par_iter().map(pixel).collect();
        let mut band = LightBand::begin(0, case.extent.width);
        let count = pixels.iter().map(Vec::len).sum::<usize>() as u64;
        pixels.into_iter().for_each(|pixel| band.push(pixel));
        let meta = light_meta(&case, Some(count));
        let texts =
            |of: &dyn Fn(&RangedParameter) -> String| Column::Texts(self.free.iter().map(of).collect());
        let numbers = |of: &dyn Fn(&RangedParameter, usize) -> f64| {
            Column::Numbers(self.free.iter().zip(0..).map(|(free, k)| of(free, k)).collect())
        };
        let fitted = Table::default()
            .with("parameter", texts(&|free| free.name.clone()))
            .with("value", numbers(&|free, k| free.value(shares[k])))
            .with("error", numbers(&|free, k| errors[k] * (free.to - free.from)))
            .with("unit", texts(&|free| free.unit.clone().unwrap_or_default()));
        let found =
            FittedTargetDocument { params: self.json.clone(), seed: cx.seed(), shares: shares.to_vec() };
        let document = Diagnosis::of(DiagnosisKind::Target, &found)?;
        Ok(Out {
            light: Light::in_memory(Arc::new(meta), band),
            fitted: Arc::new(fitted),
            target: Arc::new(document),
        })
    }
}

#[cfg(test)]
#[path = "target_tests.rs"]
mod tests;
