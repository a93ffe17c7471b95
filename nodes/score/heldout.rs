//! `score/heldout`: how well real frames are predicted that the method never saw. Works without ground truth.
//!
//! `split/frames` sets every n-th captured frame aside; a method reconstructs from the rest and renders, `at`
//! the held frames, what they should have read: same exposures, same row times. This node compares. Values
//! that are saturated or not known (NaN) in the held frame do not count; what is rendered brighter than
//! saturation counts as saturation, which is what the camera would have read.
//!
//! Reported per frame and pooled: `heldout_rmse_dn` and `heldout_psnr_db` over all pixels, and
//! `heldout_psnr_moving_db` over the pixels that change over the held frames, where methods differ. Limits: a
//! held frame is blurred, so agreement with it says less about details than true frames do; and its noise
//! bounds the score from above.

use super::card::{Card, MEAN, OWN, linear_dn};
use super::compare::{Peak, mean_of_measured};
use super::matching::match_frames;
use super::psnr::{mean_square_error, psnr_db};
use super::region::Region;
use photocurrent_core::table::{Score, TableMeta};
use photocurrent_core::{
    Context, Decl, FrameScale, FrameSequence, FramesMeta, Grain, Meta, Node, NodeError, PortMetas, Sensor,
    Table,
};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `score/heldout`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// DN that counts as peak, above black; absent = saturation of the connected sensor, else the largest
    /// held value.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub peak_dn: Option<f64>,
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Frames rendered `at` the held ones.
        frames: FrameSequence,
        /// The held frames, as captured.
        held: FrameSequence,
        /// Saturation and peak.
        sensor: Option<Arc<Sensor>>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// Scores per held frame, and pooled: the mean over frames.
        scores: Arc<Table>,
    }
}

/// The node.
pub struct ScoreHeldout {
    params: Params,
}

const METRICS: [(&str, &str); 3] =
    [("heldout_rmse_dn", "DN"), ("heldout_psnr_db", "dB"), ("heldout_psnr_moving_db", "dB")];

fn check(frames: &FramesMeta, held: &FramesMeta) -> Result<(), NodeError> {
    if frames.scale != FrameScale::Captured
        || held.scale != FrameScale::Captured
        || frames.times != held.times
    {
        return Err(NodeError::usage("`frames` were not rendered at the exposures of the held frames")
            .hint("connect the held frames to `at` of the renderer"));
    }
    match_frames(frames, held, 0).map(drop)
}

impl Node for ScoreHeldout {
    const DECL: Decl = Decl {
        kind: "score/heldout",
        about: "Compares rendered exposures with captured frames that were held out of the solve; needs no \
                ground truth.",
        revision: 3,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["leave-one-out prediction"],
        example: r#"
[nodes.heldout]
kind = "score/heldout"
in   = { frames = "render_at_held", held = "split.held", sensor = "sensor" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(ScoreHeldout { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        check(inputs.frames("frames")?, inputs.frames("held")?)?;
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: true }))])
    }

    fn metrics(_: &Params) -> Vec<String> {
        METRICS.map(|(metric, _)| metric.into()).to_vec()
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let (frames, held) = (&input.frames, &input.held);
        check(&frames.meta, &held.meta)?;
        cx.begin(held.len() as u64, "frames");
        let sensor = input.sensor.as_deref();
        let peak = Peak::find(self.params.peak_dn, sensor, held, "held")?;
        let saturation = sensor.and_then(|sensor| sensor.frames.saturation_dn).unwrap_or(f64::INFINITY);
        let moving = Region::Moving.mask(held, peak.dn).unwrap_or_default();
        if moving.is_empty() {
            cx.note("no pixel of the held frames moves: heldout_psnr_moving_db is not measured");
        }
        let compare = |l: usize| -> Result<[f64; 3], NodeError> {
            let mut picture = frames.read(l..l + 1, frames.rows())?;
            // As the camera would have read it.
            picture
                .dn
                .iter_mut()
                .filter(|dn| **dn > saturation as f32)
                .for_each(|dn| *dn = saturation as f32);
            let real = held.read(l..l + 1, held.rows())?;
            let counts: Vec<bool> =
                real.dn.iter().map(|dn| dn.is_finite() && f64::from(*dn) < saturation).collect();
            let counts_and_moves: Vec<bool> = counts.iter().zip(&moving).map(|(a, b)| *a && *b).collect();
            let (mse, unknown) = mean_square_error(&picture.dn, &real.dn, &counts);
            cx.count(unknown, "rendered values were not known (NaN) and counted as 0 DN");
            cx.advance(1)?;
            Ok([
                mse.sqrt(),
                psnr_db(mse, peak.dn),
                psnr_db(mean_square_error(&picture.dn, &real.dn, &counts_and_moves).0, peak.dn),
            ])
        };
        let values: Result<Vec<[f64; 3]>, NodeError> = (0..held.len()).into_par_iter().map(compare).collect();
        Ok(Out { scores: Arc::new(table(&values?, held, &peak)) })
    }
}

fn table(values: &[[f64; 3]], held: &FrameSequence, peak: &Peak) -> Table {
    let mut scores = Vec::new();
    for (m, (metric, unit)) in METRICS.iter().enumerate() {
        let score = |frame, t_ns, value| Score {
            metric: metric.to_string(),
            frame,
            t_ns,
            value,
            unit: unit.to_string(),
        };
        scores.extend(
            values
                .iter()
                .enumerate()
                .map(|(l, row)| score(l as i64, held.meta.times.exposures[l].mid().0, row[m])),
        );
        scores.push(score(-1, 0, mean_of_measured(&values.iter().map(|row| row[m]).collect::<Vec<_>>())));
    }
    let card = Card {
        definition: "heldout.v2",
        channel: linear_dn(&held.meta),
        range: peak.describe(),
        border: "none".into(),
        frames: format!("{} held frames, each with the one rendered at its exposures", held.len()),
        region: format!(
            "values that are finite and below saturation, rendered ones cut there; moving = {}",
            Region::Moving.describe()
        ),
        weights: None,
        backend: OWN.into(),
        pooled: MEAN.into(),
        more: Vec::new(),
    };
    Table::scores(scores, card)
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Exposure, Extent, testing};

    fn frames(dn: impl FnMut(usize, u32, u32) -> f32) -> FrameSequence {
        testing::captured(
            Extent { width: 4, height: 3 },
            vec![Exposure::new(0, 100), Exposure::new(1000, 1100)],
            10,
            dn,
        )
    }

    fn scores(rendered: FrameSequence, held: FrameSequence, sensor: Option<Sensor>) -> Vec<Score> {
        let node = ScoreHeldout { params: Params { peak_dn: Some(100.0) } };
        let input = In { frames: rendered, held, sensor: sensor.map(Arc::new) };
        let (out, _) = testing::with_context(Extent { width: 4, height: 3 }.rows(), &["scores"], |cx| {
            node.run(input, cx)
        });
        out.unwrap().scores.as_scores().unwrap()
    }

    #[test]
    fn a_constant_error_is_its_own_root_mean_square() {
        let scores = scores(
            frames(|_, _, _| 53.0),
            frames(|l, x, _| 50.0 + if x == 0 { 20.0 * l as f32 } else { 0.0 }),
            None,
        );
        let pooled =
            |metric: &str| scores.iter().find(|s| s.metric == metric && s.frame == -1).unwrap().value;
        // Frame 0 is off by 3 everywhere; frame 1 by 17 in one column of four: sqrt((3 x 9 + 289) / 4) =
        // 8.888...
        assert!((pooled("heldout_rmse_dn") - (3.0 + 79.0_f64.sqrt()) / 2.0).abs() < 1e-9);
        // Only column 0 moves: 3 of 100 and 17 of 100.
        assert!(
            (pooled("heldout_psnr_moving_db") - (-20.0 * libm::log10(0.03) - 20.0 * libm::log10(0.17)) / 2.0)
                .abs()
                < 1e-9
        );
    }

    #[test]
    fn saturated_values_of_the_held_frame_do_not_count() {
        let mut sensor = Sensor::unknown("test");
        sensor.frames.saturation_dn = Some(255.0);
        let scores =
            scores(frames(|_, _, _| 50.0), frames(|_, x, _| if x == 1 { 255.0 } else { 50.0 }), Some(sensor));
        assert_eq!(scores.iter().find(|s| s.metric == "heldout_rmse_dn").unwrap().value, 0.0);
    }

    #[test]
    fn what_is_brighter_than_saturation_counts_as_saturation() {
        let mut sensor = Sensor::unknown("test");
        sensor.frames.saturation_dn = Some(60.0);
        // 90 would have been read as 60, 4 away from 56; the other frame is right.
        let scores =
            scores(frames(|l, _, _| if l == 0 { 90.0 } else { 56.0 }), frames(|_, _, _| 56.0), Some(sensor));
        assert_eq!(
            scores.iter().find(|s| s.metric == "heldout_rmse_dn" && s.frame == -1).unwrap().value,
            2.0
        );
    }

    #[test]
    fn frames_rendered_elsewhere_are_refused() {
        let other =
            testing::captured(Extent { width: 4, height: 3 }, vec![Exposure::new(0, 100)], 10, |_, _, _| 0.0);
        assert!(
            check(&other.meta, &frames(|_, _, _| 0.0).meta)
                .unwrap_err()
                .message
                .contains("not rendered at the exposures")
        );
    }
}
