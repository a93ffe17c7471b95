//! `simulate/scene`: light of a moving scene, known in closed form, and true frames of it.
//!
//! A scene ([`super::scenes`]) gives each pixel's reflectance at any instant; illuminance on the scene and
//! the sensor's photocurrent per lux make it photocurrent. Light is looked at often where something moves and
//! kept at the instants that straight lines need ([`super::instants`]). True frames are the scene itself at
//! instants, not the sampled light, scaled as a frame of the stated exposure would read.
//!
//! The scenes are those of the paper's simulation (Section 5): basketball, checkerboard, slingshot egg,
//! running man, fan; its rotating disk under a stated illuminance; and two more. They are drawn from scratch:
//! same kind of motion, not the same pictures.
//!
//! With `colour`, each pixel has red, green and blue, or the one that a mosaic of filters lets through;
//! scenes without colours are grey behind every filter.
//!
//! Limits: an ideal lens; reflectance from 0.03 to 0.95, so contrast within a scene is at most about 30.

use super::scenes::{self, Details};
use super::source::{self, In, Look, Metas, Out, Scale, TruthParams};
use photocurrent_core::quantity::{Duration, Illuminance, Rate};
use photocurrent_core::{Colour, Context, Decl, Extent, Grain, Meta, Node, NodeError, PortMetas, Sensor};
use photocurrent_scene::closed::pellet;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

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
    /// Grey, red, green and blue of every pixel, or a mosaic of filters over the pixels.
    pub colour: Colour,
    /// Colours of the true frames; absent = those of the light. `rgb` for what is scored after
    /// `render/demosaic`.
    pub truth_colour: Option<Colour>,
    /// Exposure that true frames are scaled to: that of the captured frames they are compared with.
    #[schemars(extend("x-min" = "1 ns", "x-max" = "10 s"))]
    pub exposure: Duration,
    /// Longest time between two looks at a pixel that something may cross; shorter where things cross a
    /// quarter of a pixel sooner.
    #[schemars(extend("x-min" = "1 us", "x-max" = "1 s"))]
    pub sample_step: Duration,
    /// How far the logarithm of light may be off between instants, natural-log units; a small part of a
    /// threshold.
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
            colour: Colour::Mono,
            truth_colour: None,
            exposure: Duration::new(6_500_000),
            sample_step: Duration::new(100_000),
            tolerance: 1e-3,
            details: Details::default(),
        }
    }
}

/// The node.
pub struct SimulateScene {
    params: Params,
}

const WHO: &str = "simulate/scene";

impl SimulateScene {
    fn extent(&self) -> Extent {
        Extent { width: self.params.width, height: self.params.height }
    }

    fn metas(&self, instants: f64) -> Result<Metas, NodeError> {
        let truth = TruthParams { rate: self.params.truth_rate, exposure: self.params.exposure };
        let colour = self.params.colour;
        let metas = Metas::new(
            self.extent(),
            self.params.duration.ns(),
            instants * f64::from(colour.channels()),
            truth,
        )?;
        Ok(metas.coloured(colour, self.params.truth_colour.unwrap_or(colour)))
    }

    fn scale(&self, sensor: &Sensor) -> Result<Scale, NodeError> {
        Scale::new(sensor, self.params.illuminance, self.params.exposure, WHO)
    }

    fn look(&self) -> Look {
        // Pellets bounce off the borders within no time.
        let graze = self.params.scene == scenes::Name::Pellet;
        Look { step: self.params.sample_step, tolerance: self.params.tolerance, graze }
    }

    /// About how many instants a pixel has. The seed is not known while planning; another one gives another
    /// picture of the same kind.
    fn instants(&self) -> f64 {
        let scene = self.params.details.scene(self.params.scene, self.extent(), 0);
        source::estimated_instants(&*scene, self.look(), self.extent(), self.params.duration.ns())
    }
}

impl Node for SimulateScene {
    const DECL: Decl = Decl {
        kind: "simulate/scene",
        about: "Light of a moving scene that is known in closed form, and true frames of it.",
        revision: 2,
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
        params.details.check(params.scene)?;
        let (radius, extent) =
            (params.details.pellet.radius, Extent { width: params.width, height: params.height });
        if params.scene == scenes::Name::Pellet && !pellet::fits(radius, extent) {
            return Err(NodeError::usage(format!(
                "a pellet of radius {radius} does not fit into {extent} pixels"
            ))
            .hint("make `pellet.radius` smaller, or `width` and `height` larger")
            .param("pellet"));
        }
        Ok(SimulateScene { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        self.scale(inputs.sensor("sensor")?)?;
        Ok(self.metas(self.instants())?.planned())
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let scene = self.params.details.scene(self.params.scene, self.extent(), cx.seed());
        source::look(&*scene, self.look(), &self.scale(&input.sensor)?, self.metas(0.0)?, cx)
    }
}

#[cfg(test)]
#[path = "scene_tests.rs"]
mod tests;
