//! `baseline/akf`: the asynchronous Kalman filter: a leak towards deblurred frames whose speed follows the
//! gain of each source.
//!
//! Idea: frames are deblurred with the events inside their exposure, and events between them are scaled so
//! that they lead from one latent frame to the next: a reference known at every event. A state per pixel
//! follows events and leaks towards that reference as a Kalman filter does, with a covariance that events
//! raise (more where they are alone, or late) and frames lower (less where they are nearly black or white).
//!
//! Source: Wang, Ng, Scheerlinck, Mahony, ICCV 2021, as its authors coded it. `variant = "as_released"` keeps
//! two faults of that code: the deblurring weights each piece of time with the value on its far side (a
//! blurred frame becomes worse), and one frame's value in the interpolated certainty is never renewed.
//! `variant = "corrected"` has the exact double integral and renews it. `sequence = "as_released"` starts
//! with the second frame, stops at the last but one, and writes at the first event after an instant;
//! `sequence = "whole"` covers the recording.
//!
//! Limits: the authors' table of certainties is not public, here it is a bell over digital numbers. All rows
//! count as exposed like the middle one. A picture is the state at the middle of a virtual exposure. Holds
//! all events in memory, about 32 bytes each. The authors' display stretches and median filter (off by
//! default there) are not here.

pub mod events;
pub mod pixel;
pub mod sequence;
pub mod settings;

use crate::reconstruct::{In, Intensity, Request, by_rows, one_contrast_of};
use crate::sampling::{Sampling, scale_seconds};
use events::PixelLists;
use photocurrent_core::quantity::{Duration, Rate};
use photocurrent_core::{
    Context, Decl, Exposure, FrameSequence, FramesMeta, Grain, Meta, Node, NodeError, PortMetas,
};
use photocurrent_solve::pixel_events::{Stamp, StepRule};
use pixel::{Picture, Shared};
use schemars::JsonSchema;
use sequence::What;
use serde::{Deserialize, Serialize};
use settings::{Certainty, Sequence, Settings, Variant};
use std::sync::Arc;

/// Parameters of `baseline/akf`. Numbers are the authors' defaults.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(deny_unknown_fields)]
pub struct Params {
    /// Steady sampling, when nothing is connected to `at`.
    #[serde(flatten)]
    pub sampling: Sampling,
    /// With or without the faults of the released code.
    pub variant: Variant,
    /// From where to where the filter runs, and when a picture is written.
    pub sequence: Sequence,
    /// How often all pixels are brought up to date besides pictures, in the whole sequence: without, a
    /// pixel's leak would depend on how many pictures are asked for, as it does in the released code (whose
    /// default is 300 pictures a second).
    #[schemars(extend("x-min" = "1 Hz", "x-max" = "100 kHz"))]
    pub update_rate: Rate,
    /// Takes the latent picture of each frame instead of the frame itself.
    pub deblur: bool,
    /// One threshold for both polarities, as a step of log(1 + I); absent = the one at `contrast`, else the
    /// sensor description's two. The authors' example is 0.1.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub threshold: Option<f64>,
    /// DN of white, I = 1; absent = the sensor description's saturation.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub white: Option<f64>,
    /// Variance of the state that a second adds, 1/s.
    #[schemars(range(min = 0.0))]
    pub process_noise: f64,
    /// Variance that an event adds, per second since the latest event of the pixel and its eight neighbours.
    #[schemars(range(min = 0.0))]
    pub isolated_noise: f64,
    /// Variance that an event adds, per second since the pixel's last event, inside `refractory`.
    #[schemars(range(min = 0.0))]
    pub refractory_noise: f64,
    /// How long `refractory_noise` counts after an event.
    #[schemars(extend("x-min" = "0 ns"))]
    pub refractory: Duration,
    /// Stands for each of the two noises above on the sensor's border.
    #[schemars(range(min = 0.0))]
    pub border_noise: f64,
    /// Steps are scaled to lead from frame to frame when they add up to at least this many times the
    /// change...
    #[schemars(range(min = 0.0))]
    pub scale_least: f64,
    /// ... and at most this many times.
    #[schemars(range(min = 0.0))]
    pub scale_most: f64,
    /// Variance at the start.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub covariance: f64,
    /// Largest certainty of a frame's value: inverse variance in log(1 + I), 1/s.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub certainty: f64,
    /// Smallest, as a part of the largest: at black and white.
    #[schemars(range(min = 0.000001, max = 1.0))]
    pub certainty_floor: f64,
    /// Where the bell has its top, in 1/256 of white, counted from 1.
    pub certainty_centre: f64,
    /// Standard deviation of the bell, in 1/256 of white.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub certainty_width: f64,
    /// Which stamp dates an event.
    pub stamp: Stamp,
    /// A constant latency to subtract from every stamp; negative moves events later.
    pub latency: Duration,
}

impl Default for Params {
    fn default() -> Self {
        Params {
            sampling: Sampling::default(),
            variant: Variant::Corrected,
            sequence: Sequence::Whole,
            update_rate: Rate::new(300.0),
            deblur: true,
            threshold: None,
            white: None,
            process_noise: 0.005,
            isolated_noise: 0.03,
            refractory_noise: 0.05,
            refractory: Duration::new(10_000_000),
            border_noise: 10.0,
            scale_least: 0.6,
            scale_most: 100.0,
            covariance: 0.09,
            certainty: 7e5,
            certainty_floor: 0.09,
            certainty_centre: 128.5,
            certainty_width: 55.0,
            stamp: Stamp::Best,
            latency: Duration::default(),
        }
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// The reconstructed frames, linear DN; NaN where the authors' sequence gives none.
        frames: FrameSequence,
    }
}

impl Certainty {
    fn new(params: &Params) -> Certainty {
        let bell = |n: f64| {
            libm::exp(
                -0.5 * ((n - params.certainty_centre) / params.certainty_width)
                    * ((n - params.certainty_centre) / params.certainty_width),
            )
        };
        Certainty(
            (1..=256).map(|n| params.certainty * bell(f64::from(n)).max(params.certainty_floor)).collect(),
        )
    }
}

impl Settings {
    fn new(params: &Params) -> Settings {
        Settings {
            variant: params.variant,
            sequence: params.sequence,
            deblur: params.deblur,
            process_noise: params.process_noise,
            isolated_noise: params.isolated_noise,
            refractory_noise: params.refractory_noise,
            refractory_ns: params.refractory.ns(),
            border_noise: params.border_noise,
            scale: (params.scale_least, params.scale_most),
            covariance: params.covariance,
            weight: Certainty::new(params),
        }
    }
}

/// The node.
pub struct BaselineAkf {
    params: Params,
}

impl BaselineAkf {
    fn prepare(
        &self,
        request: &Request,
        searched: Option<f64>,
    ) -> Result<(FramesMeta, StepRule, Intensity), NodeError> {
        let params = &self.params;
        request.need_plain("baseline/akf")?;
        let rule =
            request.step_rule("baseline/akf", params.threshold, searched, params.stamp, params.latency)?;
        let meta = request.output(&params.sampling)?;
        let count = request.frames.times.len();
        if params.sequence == Sequence::AsReleased && count < 5 {
            return Err(NodeError::usage(format!(
                "the released sequence leaves out the first frame and the \
                                                 last two, and there are {count} frames"
            ))
            .hint("give at least 5 frames, or take `sequence = \"whole\"`")
            .param("sequence"));
        }
        Ok((meta, rule, request.intensity("baseline/akf", params.white)?))
    }
}

impl Node for BaselineAkf {
    const DECL: Decl = Decl {
        kind: "baseline/akf",
        about: "The asynchronous Kalman filter, as released and with its faults corrected.",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["Wang, Ng, Scheerlinck, Mahony, An Asynchronous Kalman Filter for Hybrid Event Cameras, \
                    ICCV 2021, and its authors' code"],
        example: r#"
[nodes.akf]
kind   = "baseline/akf"
in     = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }
params = { rate = "1 kHz", threshold = 0.1, white = 255, variant = "corrected" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if params.scale_least > params.scale_most {
            return Err(NodeError::usage(format!(
                "no scale lies between {} and {}",
                params.scale_least, params.scale_most
            ))
            .param("scale_least"));
        }
        Ok(BaselineAkf { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Frames(Arc::new(
            self.prepare(&Request::planned(inputs)?, inputs.has("contrast").then_some(1.0))?.0,
        ))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let request = input.request();
        let searched =
            input.contrast.as_deref().map(|table| one_contrast_of(table, "baseline/akf")).transpose()?;
        let (meta, rule, intensity) = self.prepare(&request, searched)?;
        let captured = request.frames;
        let (width, height) = (captured.extent.width, captured.extent.height);
        let exposures: Vec<Exposure> =
            (0..captured.times.len()).map(|l| captured.times.exposure(l, height / 2)).collect();
        if captured.times.row_time_ns != 0 {
            cx.note("the frames have a rolling shutter: all rows are taken as exposed like the middle one");
        }
        let lists = PixelLists::new(&input.events.read(input.events.rows())?, width, height, &rule);
        let mut wanted: Vec<(i64, usize)> =
            (0..meta.times.len()).map(|l| (meta.times.exposure(l, height / 2).mid().0, l)).collect();
        wanted.sort_unstable();
        let instants: Vec<i64> = wanted.iter().map(|(t, _)| *t).collect();
        let seconds: Vec<f64> = wanted
            .iter()
            .map(|(_, l)| scale_seconds(meta.scale, meta.times.exposure(*l, height / 2)))
            .collect();
        let settings = Settings::new(&self.params);
        let course = sequence::course(
            &exposures,
            &lists.order(),
            &instants,
            settings.variant,
            settings.sequence,
            1e9 / self.params.update_rate.hz(),
        );
        let given = course.controls.iter().filter(|(_, _, what)| matches!(what, What::Picture(..))).count();
        cx.count(
            (wanted.len() - given) as u64,
            "frames lie outside the authors' sequence and are not known (NaN)",
        );
        let frames = input.frames.read_rows(input.frames.rows())?;
        let shared = Shared { settings: &settings, course: &course, events: &lists, width, height };
        let picture_row = |row: u32| -> Result<Vec<f32>, NodeError> {
            let mut picture = vec![f32::NAN; wanted.len() * width as usize];
            let mut values = Vec::with_capacity(exposures.len());
            for x in 0..width {
                values.clear();
                values.extend(
                    exposures
                        .iter()
                        .enumerate()
                        .map(|(l, exposure)| intensity.of(frames.row(l, row)[x as usize], *exposure)),
                );
                pixel::run(&shared, row * width + x, &values, |which, value| {
                    if let Picture::Asked(n) = which {
                        picture[wanted[n].1 * width as usize + x as usize] = intensity.dn(value, seconds[n]);
                    }
                });
            }
            Ok(picture)
        };
        Ok(Out { frames: by_rows(cx, meta.clone(), picture_row)? })
    }
}

#[cfg(test)]
#[path = "akf/tests.rs"]
mod tests;
