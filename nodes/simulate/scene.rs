//! `simulate/scene`: light of a moving scene, known in closed form, and true frames of it.
//!
//! A scene ([`super::scenes`]) gives each pixel's reflectance at any instant; illuminance on the scene and the sensor's photocurrent per lux make it
//! photocurrent. Light is looked at often where something moves and kept at the instants that straight lines need ([`super::instants`]). True frames
//! are the scene itself at instants, not the sampled light, scaled as a frame of the stated exposure would read.
//!
//! The scenes are those of the paper's simulation (Section 5): basketball, checkerboard, slingshot egg, running man, fan; its rotating disk under a
//! stated illuminance; and two more. They are drawn from scratch: same kind of motion, not the same pictures.
//!
//! Limits: grey; an ideal lens; reflectance from 0.03 to 0.95, so contrast within a scene is at most about 30.

use super::instants::Sampler;
use super::scenes::{self, Details, Scene};
use photocurrent_core::quantity::{Duration, Illuminance, Rate};
use photocurrent_core::{
    Context, Decl, Exposure, Extent, FrameBlock, FrameScale, FrameSequence, FrameTimes, FramesMeta, Grain, Light, LightBand, LightMeta, Meta, Node, NodeError,
    PortMetas, Rows, Sensor, TimeSpan, Truth,
};
use photocurrent_sensor::exposure::DigitalNumber;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `simulate/scene`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
#[serde(default)]
pub struct Params {
    /// What is seen.
    pub scene: scenes::Name,
    /// Pixels in a row.
    #[schemars(range(min = 8, max = 4096))]
    pub width: u32,
    /// Rows.
    #[schemars(range(min = 8, max = 4096))]
    pub height: u32,
    /// Length of the recording, from 0 on.
    #[schemars(extend("x-min" = "10 us", "x-max" = "1000 s"))]
    pub duration: Duration,
    /// Light on the scene.
    #[schemars(extend("x-min" = "0.001 lx", "x-max" = "1000000 lx"))]
    pub illuminance: Illuminance,
    /// True frames per second, at multiples of the period from 0 on.
    #[schemars(extend("x-min" = "0.001 Hz", "x-max" = "1 MHz"))]
    pub truth_rate: Rate,
    /// Exposure that true frames are scaled to: that of the captured frames they are compared with.
    #[schemars(extend("x-min" = "1 ns", "x-max" = "10 s"))]
    pub exposure: Duration,
    /// Longest time between two looks at a pixel that something may cross; shorter where things cross a quarter of a pixel sooner.
    #[schemars(extend("x-min" = "1 us", "x-max" = "1 s"))]
    pub sample_step: Duration,
    /// How far the logarithm of light may be off between instants, natural-log units; a small part of a threshold.
    #[schemars(range(min = 0.00001, max = 0.1))]
    pub tolerance: f64,
    #[serde(flatten)]
    #[allow(missing_docs)]
    pub details: Details,
}

impl Default for Params {
    fn default() -> Self {
        Params {
            scene: scenes::Name::default(),
            width: 320,
            height: 240,
            duration: Duration::new(60_000_000),
            illuminance: Illuminance::new(300.0),
            truth_rate: Rate::new(1000.0),
            exposure: Duration::new(6_500_000),
            sample_step: Duration::new(100_000),
            tolerance: 1e-3,
            details: Details::default(),
        }
    }
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// The sensor that looks at the scene: its photocurrent per lux and its gain.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// Photocurrent of every pixel over time.
        light: Light,
        /// The picture at instants, scaled as a frame of the stated exposure.
        truth: Truth,
    }
}

/// The node.
pub struct SimulateScene {
    params: Params,
}

const WHO: &str = "simulate/scene";

/// Things move by this between two looks at most, pixels: a pixel's light has few bends in that time.
const LOOK_PX: f64 = 0.25;

/// About how many instants a pixel has per second, for memory estimates: a lively scene keeps some thousands where it moves.
const INSTANTS_PER_S: f64 = 4000.0;

impl SimulateScene {
    fn extent(&self) -> Extent {
        Extent { width: self.params.width, height: self.params.height }
    }

    fn metas(&self) -> Result<(LightMeta, FramesMeta), NodeError> {
        let extent = self.extent();
        let duration = self.params.duration;
        let count_hint = Some((extent.pixels() as f64 * (2.0 + INSTANTS_PER_S * duration.seconds())) as u64);
        let light = LightMeta { extent, span: TimeSpan::new(0, duration.ns()), count_hint };
        Ok((light, truth_meta(extent, duration.ns(), self.params.truth_rate, self.params.exposure)?))
    }

    /// Photocurrent of a white pixel.
    fn white(&self, sensor: &Sensor) -> Result<f64, NodeError> {
        Ok(self.params.illuminance.lux() * sensor.need(sensor.optics.photocurrent_per_lux, "optics.photocurrent_per_lux", WHO)?)
    }

    /// The light of pixel (x, y).
    fn light(&self, scene: &dyn Scene, white: f64, (x, y): (f64, f64)) -> Vec<(i64, f64)> {
        let step = (LOOK_PX / scene.speed(x, y)).min(self.params.sample_step.ns() as f64);
        // Pellets bounce off the borders within no time.
        let graze = self.params.scene == scenes::Name::Pellet;
        let sampler = Sampler { end_ns: self.params.duration.ns(), step_ns: step as i64, tolerance: self.params.tolerance, graze };
        sampler.sample(|t| white * scene.reflectance(x, y, t), |t| scene.still_until(x, y, t))
    }
}

/// True frames at multiples of the period from 0 on; each stands for an instant.
pub(super) fn truth_meta(extent: Extent, duration_ns: i64, rate: Rate, exposure: Duration) -> Result<FramesMeta, NodeError> {
    let period = 1e9 / rate.hz();
    let instants = (0..).map(|k| (k as f64 * period).round() as i64).take_while(|t| *t < duration_ns);
    let times = FrameTimes::new(instants.map(|t| Exposure::new(t, t + 1)).collect(), 0)?;
    Ok(FramesMeta { extent, channels: 1, times, scale: FrameScale::Nominal { exposure_ns: exposure.ns() } })
}

/// From photocurrent to the DN of a true frame.
pub(super) fn true_dn(sensor: &Sensor, exposure: Duration, who: &str) -> Result<impl Fn(f64) -> f32 + use<>, NodeError> {
    let gain = sensor.need(sensor.frames.gain, "frames.gain", who)?;
    let scale = DigitalNumber { black_level: sensor.frames.black_level_dn.unwrap_or(0.0), gain };
    Ok(move |photocurrent: f64| scale.of(photocurrent * exposure.seconds()) as f32)
}

impl Node for SimulateScene {
    const DECL: Decl = Decl {
        kind: "simulate/scene",
        about: "Light of a moving scene that is known in closed form, and true frames of it.",
        revision: 1,
        grain: Grain::Pixel,
        draws: true,
        exports: false,
        sources: &["Jiang et al., CVPR 2024, Section 5: the kinds of scene"],
        example: r#"
[nodes.scene]
kind   = "simulate/scene"
in     = { sensor = "sensor" }
params = { scene = "fan", fan = { speed = "900 rpm" }, illuminance = "300 lx", duration = "60 ms" }
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
        let (radius, extent) = (params.details.pellet.radius, Extent { width: params.width, height: params.height });
        if params.scene == scenes::Name::Pellet && !scenes::pellet::fits(radius, extent) {
            return Err(NodeError::usage(format!("a pellet of radius {radius} does not fit into {extent} pixels"))
                .hint("make `pellet.radius` smaller, or `width` and `height` larger")
                .param("pellet"));
        }
        Ok(SimulateScene { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let sensor = inputs.sensor("sensor")?;
        let stated = [("optics.photocurrent_per_lux", sensor.optics.photocurrent_per_lux.is_some()), ("frames.gain", sensor.frames.gain.is_some())];
        sensor.need_all(&stated, WHO)?;
        let (light, truth) = self.metas()?;
        Ok(vec![Meta::Light(Arc::new(light)), Meta::Truth(Arc::new(truth))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let (light_meta, truth_meta) = self.metas()?;
        let (white, dn) = (self.white(&input.sensor)?, true_dn(&input.sensor, self.params.exposure, WHO)?);
        let scene = &*self.params.details.scene(self.params.scene, self.extent(), cx.seed());
        let rows = cx.rows();
        cx.begin(rows.len() as u64, "rows");
        let simulate_row = |y: u32| -> Result<(LightBand, FrameBlock), NodeError> {
            let mut light = LightBand::begin(y, self.params.width);
            let frames = if cx.wants("truth") { truth_meta.times.len() } else { 0 };
            let mut truth = FrameBlock::zeros(0..frames, Rows { start: y, end: y + 1 }, truth_meta.row_values());
            for x in 0..self.params.width {
                let place = (f64::from(x), f64::from(y));
                light.push(self.light(scene, white, place).into_iter().map(|(t, photocurrent)| (t, photocurrent as f32)));
                for l in 0..frames {
                    let reflectance = scene.reflectance(place.0, place.1, truth_meta.times.exposures[l].start.0);
                    truth.row_mut(l, y)[x as usize] = dn(white * reflectance);
                }
            }
            cx.advance(1)?;
            Ok((light, truth))
        };
        let simulated: Result<Vec<(LightBand, FrameBlock)>, NodeError> = rows.iter().into_par_iter().map(simulate_row).collect();
        let mut truth = FrameBlock::zeros(0..truth_meta.times.len(), rows, truth_meta.row_values());
        let mut bands = Vec::with_capacity(rows.len());
        for (y, (band, row)) in rows.iter().zip(simulated?) {
            bands.push(band);
            for l in row.frames.clone() {
                truth.row_mut(l, y).copy_from_slice(row.row(l, y));
            }
        }
        let band = if bands.is_empty() { LightBand::begin(rows.start, self.params.width) } else { joined(bands) };
        Ok(Out { light: Light::in_memory(Arc::new(light_meta), band), truth: Truth(FrameSequence::in_memory(Arc::new(truth_meta), truth)) })
    }
}

fn joined(bands: Vec<LightBand>) -> LightBand {
    photocurrent_core::handle::Band::concat(bands)
}

#[cfg(test)]
#[path = "scene_tests.rs"]
mod tests;
