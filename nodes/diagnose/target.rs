//! `diagnose/target`: the light of a known target: a scene in closed form whose named free parameters are fitted to the frames.
//!
//! A rotating star, a fan, a sliding board: what it looks like is stated as for `simulate/scene`; where it stands, how fast it turns and when it began is only known to a range.
//! Each range is searched, then the best few are fitted by damped Gauss-Newton with robust weights (Student's t) to a sample of the frame values, each the mean of the scene over its
//! row's exposure. The light is that of the fitted scene over the recording, for `diagnose/evidence` and everything else that takes light.
//!
//! Source: docs/diagnosis.md, known targets. Limits: the whole array sees the target; parameters that are free absorb what looks like them (`start` a clock offset, `illuminance` a gain), so
//! state what is known; the sensor that frames are predicted with is the one stated.

use crate::simulate::scenes::{self, Details, Scene};
use crate::simulate::source::{Look, Scale};
use nalgebra::{DMatrix, DVector};
use photocurrent_core::light::LightBand;
use photocurrent_core::quantity::{Duration, Illuminance};
use photocurrent_core::random::Random;
use photocurrent_core::table::{Column, TableMeta};
use photocurrent_core::{
    Colour, Context, Decl, EventStream, Extent, FrameSequence, Grain, Light, LightMeta, Meta, Node, NodeError, PortMetas, Sensor, Table, TimeSpan,
};
use photocurrent_diagnosis::case::Case;
use photocurrent_diagnosis::nominal::Nominal;
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
    /// What is seen.
    pub scene: scenes::Name,
    /// Light on it.
    #[schemars(extend("x-min" = "0.001 lx", "x-max" = "1000000 lx"))]
    pub illuminance: Illuminance,
    /// How far it stands to the right of where `simulate/scene` has it, pixels.
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
    /// What is fitted: names of parameters, those of the scene as `siemens_disk.speed`, each with the range that it lies in.
    pub free: BTreeMap<String, [Value; 2]>,
    /// Frame values that are fitted, at most.
    #[schemars(range(min = 100, max = 1_000_000))]
    pub values: u32,
    /// Places of the ranges at which the search begins.
    #[schemars(range(min = 1, max = 10_000_000))]
    pub tries: u32,
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
            values: 20_000,
            tries: 20_000,
            details: Details::default(),
        }
    }
}

photocurrent_core::ports! {
    /// The recording, and what is stated of its sensor.
    pub struct In {
        /// The events: only when they were recorded.
        events: Option<EventStream>,
        /// The frames as captured, grey.
        frames: FrameSequence,
        /// The description as stated.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// The target.
    pub struct Out {
        /// Photocurrent of every pixel over the recording.
        light: Light,
        /// The free parameters as fitted.
        fitted: Arc<Table>,
    }
}

const WHO: &str = "diagnose/target";

/// A free parameter: where it is, and the ends of its range.
#[derive(Clone, Debug)]
struct Free {
    name: String,
    pointer: String,
    from: f64,
    to: f64,
    unit: Option<String>,
}

impl Free {
    fn new(name: &str, ends: &[Value; 2], params: &Value) -> Result<Free, NodeError> {
        let wrong = |what: String, hint: &str| NodeError::usage(what).hint(hint.to_owned()).param("free");
        let pointer = format!("/{}", name.replace('.', "/"));
        let now = params.pointer(&pointer).filter(|now| now.is_number() || now.as_str().is_some_and(|text| parts(text).is_some()));
        if now.is_none() || ["free", "values", "tries"].contains(&name) {
            return Err(wrong(
                format!("`{name}` is no number of this target"),
                "name a parameter as in `siemens_disk.speed`, `shift_x`, `start`, `illuminance`",
            ));
        }
        let one = |end: &Value| -> Option<(f64, Option<String>)> {
            end.as_f64().map(|value| (value, None)).or_else(|| parts(end.as_str()?).map(|(value, unit)| (value, Some(unit))))
        };
        let hint = "give the least and the greatest value it may have, both in the same unit: [\"280 rpm\", \"300 rpm\"]";
        match (one(&ends[0]), one(&ends[1])) {
            (Some((from, unit)), Some((to, other))) if unit == other && from < to && unit.is_some() == now.is_some_and(Value::is_string) => {
                Ok(Free { name: name.into(), pointer, from, to, unit })
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

/// Number and unit of a quantity's text.
fn parts(text: &str) -> Option<(f64, String)> {
    let (number, unit) = text.trim().split_once(' ')?;
    Some((number.parse().ok()?, unit.trim().to_owned()))
}

/// A scene as the camera stands before it.
struct Seen {
    scene: Box<dyn Scene>,
    shift: (f64, f64),
    start_ns: i64,
    blur: f64,
}

/// Gauss-Hermite: three places of a normal distribution, standard deviations, with their weights.
const HERMITE: [(f64, f64); 3] = [(-1.732_050_807_568_877_2, 1.0 / 6.0), (0.0, 2.0 / 3.0), (1.732_050_807_568_877_2, 1.0 / 6.0)];

impl Seen {
    fn new(params: &Params, extent: Extent, seed: u64) -> Seen {
        let scene = params.details.scene(params.scene, extent, seed);
        Seen { scene, shift: (params.shift_x, params.shift_y), start_ns: params.start.ns(), blur: params.blur }
    }

    /// Places of the scene that a pixel sees, with their weights.
    fn places(&self, x: f64, y: f64) -> impl Iterator<Item = (f64, f64, f64)> {
        let (x, y, blur) = (x - self.shift.0, y - self.shift.1, self.blur);
        let which = if blur > 0.0 { 0..3 } else { 1..2 };
        let whole = if blur > 0.0 { 1.0 } else { 2.25 };
        which.clone().flat_map(move |i| which.clone().map(move |j| (x + blur * HERMITE[i].0, y + blur * HERMITE[j].0, whole * HERMITE[i].1 * HERMITE[j].1)))
    }
}

impl Scene for Seen {
    fn reflectance(&self, x: f64, y: f64, t_ns: i64) -> f64 {
        self.places(x, y).map(|(x, y, weight)| weight * self.scene.reflectance(x, y, t_ns + self.start_ns)).sum()
    }

    fn speed(&self, x: f64, y: f64) -> f64 {
        self.places(x, y).map(|(x, y, _)| self.scene.speed(x, y)).fold(0.0, f64::max)
    }

    fn still_until(&self, x: f64, y: f64, t_ns: i64) -> i64 {
        let until = self.places(x, y).map(|(x, y, _)| self.scene.still_until(x, y, t_ns + self.start_ns)).min().unwrap_or(t_ns);
        if until == i64::MAX { until } else { until - self.start_ns }
    }
}

/// Gauss-Legendre instants of an exposure (of -1 to 1) and their shares of the mean.
const INSTANTS: [(f64, f64); 4] = [
    (-0.861_136_311_594_052_6, 0.173_927_422_568_727),
    (-0.339_981_043_584_856_3, 0.326_072_577_431_273),
    (0.339_981_043_584_856_3, 0.326_072_577_431_273),
    (0.861_136_311_594_052_6, 0.173_927_422_568_727),
];

/// One frame value that is fitted.
#[derive(Clone, Copy)]
struct Measured {
    x: f64,
    y: f64,
    start_ns: i64,
    end_ns: i64,
    dn: f64,
}

/// A target, and what it is fitted to.
struct Fit<'a> {
    params: &'a Value,
    free: &'a [Free],
    extent: Extent,
    sensor: &'a Sensor,
    nominal: &'a Nominal,
    measured: Vec<Measured>,
    seed: u64,
}

/// Standard deviation of frame values beyond what is stated: DN, and a share of the signal.
const FRAME_NOISE: (f64, f64) = (1.0, 0.01);
/// Degrees of freedom of their errors.
const NU: f64 = 3.0;
/// Values that the search looks at.
const SEARCHED: usize = 400;
/// Starting places that are fitted.
const BEST: usize = 8;
/// Rounds of the fit.
const ROUNDS: usize = 40;

impl Fit<'_> {
    fn params(&self, shares: &[f64]) -> Result<Params, NodeError> {
        let mut value = self.params.clone();
        for (free, share) in self.free.iter().zip(shares) {
            if let Some(at) = value.pointer_mut(&free.pointer) {
                *at = free.json(*share);
            }
        }
        serde_json::from_value(value).map_err(|why| NodeError::usage(format!("a free parameter leaves its range: {why}")).param("free"))
    }

    /// Residuals in standard deviations; none where the parameters make no scene.
    fn residuals(&self, shares: &[f64], measured: &[Measured]) -> Option<Vec<f64>> {
        let params = self.params(shares).ok()?;
        let seen = Seen::new(&params, self.extent, self.seed);
        let white = Scale::new(self.sensor, params.illuminance, Duration::new(1), WHO).ok()?.white;
        let number = self.nominal.number;
        let of = |one: &Measured| {
            let (middle, half) = (0.5 * (one.start_ns + one.end_ns) as f64, 0.5 * (one.end_ns - one.start_ns) as f64);
            let mean: f64 = INSTANTS.iter().map(|(at, share)| share * seen.reflectance(one.x, one.y, (middle + half * at) as i64)).sum();
            let signal = number.gain * white * mean * (2e-9 * half);
            let sigma = self.nominal.frame_sigma_dn(signal, FRAME_NOISE);
            (one.dn - number.black_level - signal) / sigma
        };
        Some(measured.par_iter().with_min_len(256).map(of).collect())
    }

    /// Minus the log density of Student's t.
    fn cost(&self, shares: &[f64], measured: &[Measured]) -> f64 {
        self.residuals(shares, measured).map_or(f64::INFINITY, |left| left.iter().map(|z| 0.5 * (NU + 1.0) * libm::log1p(z * z / NU)).sum())
    }

    /// Damped Gauss-Newton from a place.
    fn descend(&self, from: &[f64], measured: &[Measured]) -> (f64, Vec<f64>) {
        const STEP: f64 = 1e-4;
        let n = from.len();
        let mut at = from.to_vec();
        let mut cost = self.cost(&at, measured);
        let mut damping = 1e-3;
        for _ in 0..ROUNDS {
            let Some(now) = self.residuals(&at, measured) else { break };
            let mut columns = Vec::with_capacity(n);
            for k in 0..n {
                let mut moved = at.clone();
                let by = if moved[k] + STEP > 1.0 { -STEP } else { STEP };
                moved[k] += by;
                let Some(then) = self.residuals(&moved, measured) else { return (cost, at) };
                columns.push(then.iter().zip(&now).map(|(then, now)| (then - now) / by).collect::<Vec<f64>>());
            }
            let weights: Vec<f64> = now.iter().map(|z| (NU + 1.0) / (NU + z * z)).collect();
            let sum = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).zip(&weights).map(|((a, b), w)| a * b * w).sum() };
            let normal = DMatrix::from_fn(n, n, |i, j| sum(&columns[i], &columns[j]));
            let right = DVector::from_fn(n, |i, _| -sum(&columns[i], &now));
            let mut is_better = false;
            for _ in 0..8 {
                let mut damped = normal.clone();
                (0..n).for_each(|k| damped[(k, k)] += damping * (normal[(k, k)] + 1e-9));
                let Some(step) = damped.cholesky().map(|factor| factor.solve(&right)) else { break };
                let next: Vec<f64> = at.iter().zip(step.iter()).map(|(at, step)| (at + step).clamp(0.0, 1.0)).collect();
                let other = self.cost(&next, measured);
                if other < cost {
                    let gain = cost - other;
                    (at, cost, damping, is_better) = (next, other, 0.3 * damping, gain > 1e-9 * cost);
                    break;
                }
                damping *= 10.0;
            }
            if !is_better {
                break;
            }
        }
        (cost, at)
    }

    /// The free parameters that explain the frame values best, as shares of their ranges; and the median residual, standard deviations.
    fn solve(&self, tries: usize) -> (Vec<f64>, f64) {
        let n = self.free.len();
        let mut best = vec![0.5; n];
        if n > 0 {
            let few: Vec<Measured> = self.measured.iter().step_by(self.measured.len().div_ceil(SEARCHED).max(1)).copied().collect();
            let some: Vec<Measured> = self.measured.iter().step_by(self.measured.len().div_ceil(8 * SEARCHED).max(1)).copied().collect();
            let mut found: Vec<(f64, Vec<f64>)> = (0..tries)
                .into_par_iter()
                .map(|k| {
                    let mut random = Random::new(self.seed, &[0x7a, k as u64]);
                    let at: Vec<f64> = (0..n).map(|_| random.uniform()).collect();
                    (self.cost(&at, &few), at)
                })
                .collect();
            found.sort_by(|a, b| a.0.total_cmp(&b.0));
            found.truncate(BEST);
            let fitted = found.iter().map(|(_, at)| self.descend(at, &some)).min_by(|a, b| a.0.total_cmp(&b.0));
            best = fitted.map_or(best, |(_, at)| self.descend(&at, &self.measured).1);
        }
        let mut left: Vec<f64> = self.residuals(&best, &self.measured).unwrap_or_default().iter().map(|z| z.abs()).collect();
        left.sort_by(f64::total_cmp);
        (best, left.get(left.len() / 2).copied().unwrap_or(f64::NAN))
    }
}

/// The node.
pub struct DiagnoseTarget {
    params: Params,
    json: Value,
    free: Vec<Free>,
}

impl DiagnoseTarget {
    fn measured(&self, case: &Case, nominal: &Nominal) -> Vec<Measured> {
        let Some(times) = case.frames.as_ref().map(|frames| &frames.times) else { return Vec::new() };
        let all = times.len() * case.extent.pixels();
        // Steps that share no factor with the width or the number of pixels see every column of every frame.
        let step = all.div_ceil(self.params.values as usize).max(1);
        let of = |k: usize| {
            let (l, pixel) = (k / case.extent.pixels(), k % case.extent.pixels());
            let (x, y) = case.place(pixel);
            let (dn, exposure) = (case.dn(l, pixel), times.exposure(l, y));
            let counts = dn.is_finite() && dn < nominal.saturation_dn;
            counts.then_some(Measured { x: x.into(), y: y.into(), start_ns: exposure.start.0, end_ns: exposure.end.0, dn })
        };
        let mut random = Random::new(1, &[0x5e]);
        (0..all.div_ceil(step)).filter_map(|n| of((n * step + (random.uniform() * step as f64) as usize).min(all - 1))).collect()
    }
}

impl Node for DiagnoseTarget {
    const DECL: Decl = Decl {
        kind: "diagnose/target",
        about: "Fits named free parameters of a known target to the frames, and gives its light.",
        revision: 1,
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
        if let Some(name) = params.details.set_in_vain(params.scene) {
            let shown = serde_json::to_value(params.scene).map_err(|error| NodeError::failed(error.to_string()))?;
            return Err(NodeError::usage(format!("`{name}` is set, but the scene is {shown}"))
                .hint(format!("write `scene = \"{name}\"`, or leave `{name}` out"))
                .param(name));
        }
        let json = serde_json::to_value(&params).map_err(|error| NodeError::failed(error.to_string()))?;
        let free = params.free.iter().map(|(name, ends)| Free::new(name, ends, &json)).collect::<Result<Vec<Free>, NodeError>>()?;
        let node = DiagnoseTarget { params, json, free };
        for end in [0.0, 1.0] {
            node.free.iter().try_for_each(|free| {
                let mut value = node.json.clone();
                if let Some(at) = value.pointer_mut(&free.pointer) {
                    *at = free.json(end);
                }
                let wrong = |why: serde_json::Error| NodeError::usage(format!("`{}` cannot be {}: {why}", free.name, free.json(end))).param("free");
                serde_json::from_value::<Params>(value).map(drop).map_err(wrong)
            })?;
        }
        Ok(node)
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let sensor = super::check(inputs)?;
        Scale::new(sensor, self.params.illuminance, Duration::new(1), WHO)?;
        let case = super::empty(inputs)?;
        let light = LightMeta { extent: case.extent, span: TimeSpan::new(case.span.0, case.span.1), colour: Colour::Mono, count_hint: None };
        Ok(vec![Meta::Light(Arc::new(light)), Meta::Table(Arc::new(TableMeta { scores: false }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let case = super::case(input.events.as_ref(), Some(&input.frames), &input.sensor)?;
        let nominal = case.nominal()?;
        let measured = self.measured(&case, &nominal);
        let fit = Fit { params: &self.json, free: &self.free, extent: case.extent, sensor: &input.sensor, nominal: &nominal, measured, seed: cx.seed() };
        let (shares, left) = fit.solve(self.params.tries as usize);
        let params = fit.params(&shares)?;
        for (free, share) in self.free.iter().zip(&shares) {
            let at_end = if (0.001..0.999).contains(share) { "" } else { ", the end of its range: look further" };
            cx.note(format!("{} = {}{at_end}", free.name, free.json(*share).to_string().trim_matches('"')));
        }
        cx.note(format!("frame values miss the target by {left:.2} standard deviations (median; 0.67 is noise alone)"));
        let seen = Seen::new(&params, case.extent, cx.seed());
        let white = Scale::new(&input.sensor, params.illuminance, Duration::new(1), WHO)?.white;
        let look = Look { step: Duration::new(100_000), tolerance: 1e-3, graze: false };
        let pixel = |n: u32| {
            let place = (f64::from(n % case.extent.width), f64::from(n / case.extent.width));
            let light = look.sample(&seen, None, place, case.span.0, case.span.1, white);
            light.into_iter().map(|(t, photocurrent)| (t + case.span.0, photocurrent as f32)).collect::<Vec<(i64, f32)>>()
        };
        let pixels: Vec<Vec<(i64, f32)>> = (0..case.extent.pixels() as u32).into_par_iter().map(pixel).collect();
        let mut band = LightBand::begin(0, case.extent.width);
        let count = pixels.iter().map(Vec::len).sum::<usize>() as u64;
        pixels.into_iter().for_each(|pixel| band.push(pixel));
        let meta = LightMeta { extent: case.extent, span: TimeSpan::new(case.span.0, case.span.1), colour: Colour::Mono, count_hint: Some(count) };
        let texts = |of: &dyn Fn(&Free) -> String| Column::Texts(self.free.iter().map(of).collect());
        let fitted = Table::default()
            .with("parameter", texts(&|free| free.name.clone()))
            .with("value", Column::Numbers(self.free.iter().zip(&shares).map(|(free, share)| free.value(*share)).collect()))
            .with("unit", texts(&|free| free.unit.clone().unwrap_or_default()));
        Ok(Out { light: Light::in_memory(Arc::new(meta), band), fitted: Arc::new(fitted) })
    }
}

#[cfg(test)]
#[path = "target_tests.rs"]
mod tests;
