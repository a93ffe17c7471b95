//! `baseline/repeat`: plain frame repetition: the picture of any instant is the captured frame nearest to it.
//!
//! What a viewer without events would see, and the floor that every method must beat. Nearest is by the middle of a row's own exposure.
//! Limits: blur, rolling shutter and motion between frames all stay in.

use crate::render::rows::from_rows;
use crate::sampling::{Sampling, scale_seconds, virtual_frames};
use photocurrent_core::{Context, Decl, EventsMeta, FrameScale, FrameSequence, FramesMeta, Grain, Meta, Node, NodeError, PortMetas, Sensor};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `baseline/repeat`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(deny_unknown_fields)]
pub struct Params {
    /// Steady sampling, when nothing is connected to `at`.
    #[serde(flatten)]
    pub sampling: Sampling,
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Captured frames.
        frames: FrameSequence,
        /// Black level (0 when absent); row time for a rolling shutter.
        sensor: Option<Arc<Sensor>>,
        /// Frames whose exposures, row time and scale are to be imitated.
        at: Option<FrameSequence>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// The repeated frames, linear DN.
        frames: FrameSequence,
    }
}

/// The node.
pub struct BaselineRepeat {
    params: Params,
}

/// What a method that works on captured frames renders: sampled as `sampling` says, or like `at`.
///
/// # Errors
/// When there is no captured frame, or the sampling does not fit.
pub(crate) fn output_meta(
    sampling: &Sampling,
    frames: &FramesMeta,
    events: Option<&EventsMeta>,
    at: Option<&FramesMeta>,
    sensor: Option<&Sensor>,
) -> Result<FramesMeta, NodeError> {
    if frames.scale != FrameScale::Captured || frames.channels != 1 {
        return Err(NodeError::usage("the method works on captured grey frames").hint("connect the recording's frames"));
    }
    let (Some(span), Some(nominal_ns)) = (frames.times.span(frames.extent.height), frames.times.nominal_exposure_ns()) else {
        return Err(NodeError::usage("there is no captured frame to start from"));
    };
    let covered = events.and_then(|events| events.span).map_or(span, |events| events.union(span));
    virtual_frames(sampling, at, frames.extent, covered, nominal_ns, sensor)
}

/// Black level of the description; 0 when there is none.
pub(crate) fn black_level(sensor: Option<&Sensor>) -> f64 {
    sensor.and_then(|sensor| sensor.frames.black_level_dn).unwrap_or(0.0)
}

/// Index of the captured frame whose exposure of `row` has its middle nearest to `t`; the earlier of two.
pub(crate) fn nearest_frame(frames: &FramesMeta, row: u32, t: i64) -> usize {
    let mid = |l: usize| frames.times.exposure(l, row).mid().0;
    let after = frames.times.exposures.partition_point(|e| e.delayed(frames.times.row_time_ns * i64::from(row)).mid().0 < t);
    match after {
        0 => 0,
        n if n == frames.times.len() => n - 1,
        n if t - mid(n - 1) <= mid(n) - t => n - 1,
        n => n,
    }
}

impl Node for BaselineRepeat {
    const DECL: Decl = Decl {
        kind: "baseline/repeat",
        about: "Plain frame repetition: each instant shows the captured frame nearest to it.",
        revision: 1,
        grain: Grain::Pixel,
        draws: false,
        exports: false,
        sources: &["the floor that every method must beat"],
        example: r#"
[nodes.repeat]
kind   = "baseline/repeat"
in     = { frames = "recording.frames" }
params = { rate = "1 kHz" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(BaselineRepeat { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let at = inputs.has("at").then(|| inputs.frames("at")).transpose()?;
        let sensor = inputs.has("sensor").then(|| inputs.sensor("sensor")).transpose()?;
        let meta = output_meta(&self.params.sampling, inputs.frames("frames")?, None, at.map(|m| &**m), sensor.map(|s| &**s))?;
        Ok(vec![Meta::Frames(Arc::new(meta))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let sensor = input.sensor.as_deref();
        let captured = &input.frames;
        let meta = output_meta(&self.params.sampling, &captured.meta, None, input.at.as_ref().map(|at| &*at.meta), sensor)?;
        let black = black_level(sensor);
        cx.begin(cx.rows().len() as u64, "rows");
        let block = captured.read_rows(cx.rows())?;
        let repeat_row = |row: u32| -> Result<Vec<f32>, NodeError> {
            let mut picture = Vec::with_capacity(meta.times.len() * meta.row_values());
            for l in 0..meta.times.len() {
                let exposure = meta.times.exposure(l, row);
                let from = nearest_frame(&captured.meta, row, exposure.mid().0);
                let ratio = scale_seconds(meta.scale, exposure) / scale_seconds(FrameScale::Captured, captured.meta.times.exposure(from, row));
                picture.extend(block.row(from, row).iter().map(|dn| (black + (f64::from(*dn) - black) * ratio) as f32));
            }
            cx.advance(1)?;
            Ok(picture)
        };
        let pictures: Result<Vec<Vec<f32>>, NodeError> = cx.rows().iter().into_par_iter().map(repeat_row).collect();
        Ok(Out { frames: from_rows(meta, cx.rows(), pictures?) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::quantity::Rate;
    use photocurrent_core::{Exposure, Extent, testing};

    #[test]
    fn each_instant_shows_the_nearest_frame_at_its_scale() {
        let extent = Extent { width: 1, height: 1 };
        // Middles at 1, 5 and 9 ms; the middle frame was exposed half as long.
        let exposures = vec![Exposure::new(0, 2_000_000), Exposure::new(4_500_000, 5_500_000), Exposure::new(8_000_000, 10_000_000)];
        let frames = testing::captured(extent, exposures, 0, |l, _, _| [10.0, 10.0, 30.0][l]);
        let node = BaselineRepeat { params: Params { sampling: Sampling { rate: Rate::new(500.0), ..Sampling::default() } } };
        let (out, _) = testing::with_context(extent.rows(), &["frames"], |cx| node.run(In { frames, sensor: None, at: None }, cx));
        let block = out.unwrap().frames.read_rows(extent.rows()).unwrap();
        // 0, 2, 4, 6, 8 ms; nominal exposure is the median, 2 ms.
        assert_eq!(block.dn, [10.0, 10.0, 20.0, 20.0, 30.0]);
    }
}
