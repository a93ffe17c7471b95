//! `simulate/photo`: light of a still photo that moves as stated: translation, rotation, zoom, shake; and
//! true frames of it.
//!
//! Real texture under motion that is known exactly at any instant ([`super::moved::motion`]), so truth is as
//! good as the photo at any rate. Between its pixels the photo is a cubic B-spline through them, widened
//! where it is shrunk ([`super::moved::spline`] says why). Light is looked at often enough for what passes
//! each pixel and kept at the instants that straight lines need, as `simulate/scene` does.
//!
//! At time 0 the middle of the photo is in the middle of the sensor. In grey it is the photo's luminance;
//! with `colour` each of red, green and blue is a picture of its own. Limit: one flat picture, so nothing
//! covers anything else.

use super::moved::motion::Motion;
use super::moved::spline::{Outside, Spline, WIDEST};
use super::moved::{MovingPhoto, Planes};
use super::source::{self, In, Look, Metas, Out, Scale, TruthParams};
use super::stored::folder::Pictures;
use super::stored::{Film, Transfer, Window, still};
use photocurrent_core::quantity::{Duration, Illuminance, InputPath, Rate, Rotation};
use photocurrent_core::{
    Colour, Context, Decl, Extent, FileRef, Grain, Meta, Node, NodeError, PortMetas, Sensor,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::sync::OnceLock;

/// Parameters of `simulate/photo`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The photo: a PNG, TIFF or JPEG picture, grey or RGB, 8 or 16 bits; relative to the manifest that names
    /// it.
    pub path: InputPath,
    /// How stored values become linear light.
    pub transfer: Transfer,
    /// Squares of so many pixels of the photo are averaged to one first, in linear light: for photos much
    /// larger than the sensor.
    #[schemars(range(min = 1, max = 64))]
    pub shrink: u32,
    /// Pixels of the sensor to one of the (shrunk) photo at time 0.
    #[schemars(range(min = 0.0625, max = 64.0))]
    pub scale: f64,
    /// What is seen beyond the border of the photo.
    pub outside: Outside,
    /// Pixels in a row of the sensor.
    #[schemars(range(min = 1, max = 4096))]
    pub width: u32,
    /// Rows of the sensor.
    #[schemars(range(min = 1, max = 4096))]
    pub height: u32,
    /// Length of the recording, from 0 on.
    #[schemars(extend("x-min" = "10 us", "x-max" = "1000 s"))]
    pub duration: Duration,
    /// Light on what is stored as full white.
    #[schemars(extend("x-min" = "0.001 lx", "x-max" = "1000000 lx"))]
    pub illuminance: Illuminance,
    /// Grey, red, green and blue of every pixel, or a mosaic of filters over the pixels.
    pub colour: Colour,
    /// Colours of the true frames; absent = those of the light. `rgb` for what is scored after
    /// `render/demosaic`.
    pub truth_colour: Option<Colour>,
    /// Darkest light, as a share of white's; what is stored darker counts as this.
    #[schemars(range(min = 0.000001, max = 0.5))]
    pub black: f64,
    /// How fast the photo slides, pixels of the sensor per second.
    #[schemars(range(min = 0.0, max = 1_000_000.0))]
    pub speed: f64,
    /// Where to it slides, degrees clockwise from the right.
    #[schemars(range(min = -180.0, max = 180.0))]
    pub heading: f64,
    /// How fast it turns, clockwise; less than 0 is the other way round.
    #[schemars(extend("x-min" = "-100000 rpm", "x-max" = "100000 rpm"))]
    pub rotation: Rotation,
    /// Growth per second: after `t` seconds it is `exp(zoom t)` times as large. Less than 0 shrinks.
    #[schemars(range(min = -100.0, max = 100.0))]
    pub zoom: f64,
    /// The pixel of the sensor about which it turns and grows; that point of the photo slides along. Default:
    /// the middle.
    pub centre: Option<Place>,
    /// A hand that shakes: a sine along a line.
    pub shake: Shake,
    /// True frames per second, at multiples of the period from 0 on.
    #[schemars(extend("x-min" = "0.001 Hz", "x-max" = "1 MHz"))]
    pub truth_rate: Rate,
    /// Exposure that true frames are scaled to: that of the captured frames they are compared with.
    #[schemars(extend("x-min" = "1 ns", "x-max" = "10 s"))]
    pub exposure: Duration,
    /// Longest time between two looks at a pixel; shorter where a quarter of a pixel of the photo passes
    /// sooner.
    #[schemars(extend("x-min" = "1 us", "x-max" = "1 s"))]
    pub sample_step: Duration,
    /// How far the logarithm of light may be off between instants, natural-log units; a small part of a
    /// threshold.
    #[schemars(range(min = 0.00001, max = 0.1))]
    pub tolerance: f64,
}

/// A place on the sensor, in pixels; pixels have their centres at whole numbers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Place {
    /// Column, to the right.
    pub x: f64,
    /// Row, downwards.
    pub y: f64,
}

/// A sine along a line.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Shake {
    /// Furthest from the middle, pixels of the sensor; 0 is a steady hand.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub amplitude: f64,
    /// Swings per second; hands do about 8.
    #[schemars(extend("x-min" = "0.001 Hz", "x-max" = "10 kHz"))]
    pub frequency: Rate,
    /// Along which line, degrees clockwise from the right.
    #[schemars(range(min = -180.0, max = 180.0))]
    pub direction: f64,
}

impl Default for Shake {
    fn default() -> Self {
        Shake { amplitude: 0.0, frequency: Rate::new(8.0), direction: 0.0 }
    }
}

impl Default for Params {
    fn default() -> Self {
        Params {
            path: InputPath::default(),
            transfer: Transfer::Srgb,
            shrink: 1,
            scale: 1.0,
            outside: Outside::default(),
            width: 320,
            height: 240,
            duration: Duration::new(60_000_000),
            illuminance: Illuminance::new(300.0),
            colour: Colour::Mono,
            truth_colour: None,
            black: 0.01,
            speed: 0.0,
            heading: 0.0,
            rotation: Rotation::new(0.0),
            zoom: 0.0,
            centre: None,
            shake: Shake::default(),
            truth_rate: Rate::new(1000.0),
            exposure: Duration::new(6_500_000),
            sample_step: Duration::new(100_000),
            tolerance: 1e-3,
        }
    }
}

/// The node.
pub struct SimulatePhoto {
    params: Params,
    /// Read once for all row bands.
    photo: OnceLock<Planes>,
}

const WHO: &str = "simulate/photo";

/// About how many instants a pixel has per second, for memory estimates.
const INSTANTS_PER_S: f64 = 4000.0;

impl SimulatePhoto {
    fn metas(&self) -> Result<Metas, NodeError> {
        let (extent, duration) =
            (Extent { width: self.params.width, height: self.params.height }, self.params.duration);
        let truth = TruthParams { rate: self.params.truth_rate, exposure: self.params.exposure };
        let colour = self.params.colour;
        let instants = (2.0 + INSTANTS_PER_S * duration.seconds()) * f64::from(colour.channels());
        let metas = Metas::new(extent, duration.ns(), instants, truth)?;
        Ok(metas.coloured(colour, self.truth_colour()))
    }

    fn truth_colour(&self) -> Colour {
        self.params.truth_colour.unwrap_or(self.params.colour)
    }

    fn scale(&self, sensor: &Sensor) -> Result<Scale, NodeError> {
        Scale::new(sensor, self.params.illuminance, self.params.exposure, WHO)
    }

    fn photo(&self) -> Result<&Planes, NodeError> {
        if let Some(photo) = self.photo.get() {
            return Ok(photo);
        }
        let picture = Pictures::open(vec![self.params.path.path().into()], self.params.transfer)?;
        let window = Window::by_factor(picture.extent(), self.params.shrink)?;
        let extent = window.extent();
        let plane = |film: &dyn Film| -> Result<Spline, NodeError> {
            let light = window.read(film, 0, extent.rows())?;
            Ok(Spline::new(extent.width as usize, extent.height as usize, light, self.params.outside))
        };
        let has_colour = [self.params.colour, self.truth_colour()] != [Colour::Mono; 2];
        let channel = |channel: usize| plane(&picture.channel(channel));
        let channels = has_colour.then(|| Ok::<_, NodeError>([channel(0)?, channel(1)?, channel(2)?]));
        let photo = Planes { grey: plane(&picture)?, channels: channels.transpose()? };
        Ok(self.photo.get_or_init(|| photo))
    }

    fn motion(&self, photo: Extent) -> Motion {
        let params = &self.params;
        let middle = |extent: Extent| (f64::from(extent.width - 1) / 2.0, f64::from(extent.height - 1) / 2.0);
        let (sensor, photo) = (middle(Extent { width: params.width, height: params.height }), middle(photo));
        let along = |length: f64, degrees: f64| {
            let angle = degrees.to_radians();
            (length * libm::cos(angle), length * libm::sin(angle))
        };
        Motion {
            centre: params.centre.map_or(sensor, |centre| (centre.x, centre.y)),
            velocity: along(params.speed, params.heading),
            turning: TAU * params.rotation.turns_per_s(),
            zoom: params.zoom,
            shake: along(params.shake.amplitude, params.shake.direction),
            shaking: if params.shake.amplitude == 0.0 { 0.0 } else { TAU * params.shake.frequency.hz() },
            scale: params.scale,
            origin: (sensor.0 - params.scale * photo.0, sensor.1 - params.scale * photo.1),
        }
    }
}

impl Node for SimulatePhoto {
    const DECL: Decl = Decl {
        kind: "simulate/photo",
        about: "Light of a still photo that moves as stated, and true frames of it.",
        revision: 1,
        grain: Grain::Pixel,
        draws: false,
        exports: false,
        sources: &["Unser, Aldroubi and Eden, IEEE Transactions on Signal Processing 41, 1993: B-spline \
                    interpolation"],
        example: r#"
[nodes.photo]
kind   = "simulate/photo"
in     = { sensor = "sensor" }
params = { path = "street.png", speed = 2000.0, heading = 20.0, rotation = "30 rpm", shake = { amplitude = 3.0, frequency = "8 Hz" }, truth_rate = "10 kHz" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if params.path.path().as_os_str().is_empty() {
            return Err(NodeError::usage("`path` is missing")
                .hint("name the photo, such as `path = \"street.png\"`")
                .param("path"));
        }
        // Growth is monotonic: the photo is smallest at the beginning or at the end.
        let smallest = params.scale * libm::exp((params.zoom * params.duration.seconds()).min(0.0));
        if smallest * WIDEST < 1.0 {
            return Err(NodeError::usage(format!(
                "at the end a pixel of the sensor sees {:.0} pixels of the photo in a row, at most {WIDEST} \
                 can be",
                1.0 / smallest
            ))
            .hint(
                "average squares of the photo first (`shrink`), take a larger `scale`, or a `zoom` nearer \
                   to 0",
            )
            .param("zoom"));
        }
        Ok(SimulatePhoto { params, photo: OnceLock::new() })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Window::by_factor(still::extent(self.params.path.path())?, self.params.shrink)?;
        self.scale(inputs.sensor("sensor")?)?;
        Ok(self.metas()?.planned())
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let photo = self.photo()?;
        let size = photo.grey.size();
        let motion = self.motion(Extent { width: size.0 as u32, height: size.1 as u32 });
        let scene = MovingPhoto::new(photo, motion, self.params.black, self.params.duration.ns());
        let look = Look { step: self.params.sample_step, tolerance: self.params.tolerance, graze: false };
        source::look(&scene, look, &self.scale(&input.sensor)?, self.metas()?, cx)
    }

    fn files(&self) -> Vec<FileRef> {
        vec![FileRef { param: "path".into(), path: self.params.path.path().into() }]
    }
}

#[cfg(test)]
#[path = "photo_tests.rs"]
mod tests;
