//! `baseline/repeat`: plain frame repetition: the picture of any instant is the captured frame nearest to it.
//!
//! What a viewer without events would see, and the floor that every method must beat. Nearest is by the
//! middle of a row's own exposure. Limits: blur, rolling shutter and motion between frames all stay in.

pub(crate) use crate::reconstruct::black_level;
use crate::reconstruct::{Request, by_rows, nearest_frame};
use crate::sampling::{Sampling, scale_seconds};
use photocurrent_core::{
    Context, Decl, FrameScale, FrameSequence, Grain, Meta, Node, NodeError, PortMetas, Sensor,
};
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
    const LOCAL_IN_TIME: bool = true;
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(BaselineRepeat { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Frames(Arc::new(Request::planned(inputs)?.output(&self.params.sampling)?))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let request = Request::connected(&input.frames, None, &input.at, &input.sensor);
        let meta = request.output(&self.params.sampling)?;
        let black = black_level(request.sensor);
        let block = input.frames.read_rows(cx.rows())?;
        let repeat_row = |row: u32| -> Result<Vec<f32>, NodeError> {
            let mut picture = Vec::with_capacity(meta.times.len() * meta.row_values());
            for l in 0..meta.times.len() {
                let exposure = meta.times.exposure(l, row);
                let from = nearest_frame(request.frames, row, exposure.mid().0);
                let ratio = scale_seconds(meta.scale, exposure)
                    / scale_seconds(FrameScale::Captured, request.frames.times.exposure(from, row));
                picture.extend(
                    block.row(from, row).iter().map(|dn| (black + (f64::from(*dn) - black) * ratio) as f32),
                );
            }
            Ok(picture)
        };
        Ok(Out { frames: by_rows(cx, meta.clone(), repeat_row)? })
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
        let exposures = vec![
            Exposure::new(0, 2_000_000),
            Exposure::new(4_500_000, 5_500_000),
            Exposure::new(8_000_000, 10_000_000),
        ];
        let frames = testing::captured(extent, exposures, 0, |l, _, _| [10.0, 10.0, 30.0][l]);
        let node = BaselineRepeat {
            params: Params { sampling: Sampling { rate: Rate::new(500.0), ..Sampling::default() } },
        };
        let (out, _) = testing::with_context(extent.rows(), &["frames"], |cx| {
            node.run(In { frames, sensor: None, at: None }, cx)
        });
        let block = out.unwrap().frames.read_rows(extent.rows()).unwrap();
        // 0, 2, 4, 6, 8 ms; nominal exposure is the median, 2 ms.
        assert_eq!(block.dn, [10.0, 10.0, 20.0, 20.0, 30.0]);
    }
}
