//! `score/psnr`: peak signal-to-noise ratio against true frames, per frame and pooled.
//!
//! `PSNR = 10 log10(peak^2 / MSE)` on linear DN, no gamma, no clipping, no affine fitting. The peak is the
//! sensor's saturation above black when a sensor description is connected, a given number, or the largest
//! true value. A frame is compared with the true frame whose middle of exposure agrees.
//!
//! Limits: PSNR is global; it says little about edges. A value that is not known (NaN) counts as zero DN, so
//! that a method gains nothing by leaving pixels out; how many there were is said.

use super::card::{Card, MEAN, OWN, linear_dn};
use super::compare::{In, Pairs, Params, Peak, UNKNOWN};
use photocurrent_core::{Context, Decl, Grain, Meta, Node, NodeError, PortMetas, Table};
use std::sync::Arc;

/// A perfect frame would have no finite ratio; this stands for it.
pub const PSNR_CEILING_DB: f64 = 120.0;

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// `psnr_db` per frame, and pooled: the mean over frames.
        scores: Arc<Table>,
    }
}

/// The node.
pub struct ScorePsnr {
    params: Params,
}

impl Node for ScorePsnr {
    const DECL: Decl = Decl {
        kind: "score/psnr",
        about: "Peak signal-to-noise ratio against true frames, per frame and pooled.",
        revision: 2,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["10 log10(peak^2 / MSE) on linear DN"],
        example: r#"
[nodes.psnr]
kind   = "score/psnr"
in     = { frames = "render", truth = "recording.truth", sensor = "sensor" }
params = { region = "moving" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(ScorePsnr { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        self.params.plan(inputs)
    }

    fn metrics(_: &Params) -> Vec<String> {
        vec!["psnr_db".into()]
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let pairs = Pairs::new(&input.frames, &input.truth.0, self.params.tolerance)?;
        let peak = Peak::find(self.params.peak_dn, input.sensor.as_deref(), &input.truth.0, "true")?;
        let mask = self.params.region.mask_in(self.params.roi, &input.truth.0, peak.dn)?;
        let compared =
            pairs.map(cx, |picture, reference| Ok(mean_square_error(picture, reference, &mask)))?;
        cx.count(compared.iter().map(|(_, unknown)| unknown).sum(), UNKNOWN);
        let psnr: Vec<f64> = compared.iter().map(|(mse, _)| psnr_db(*mse, peak.dn)).collect();
        let card = Card {
            definition: "psnr.v1",
            channel: linear_dn(&input.frames.meta),
            range: peak.describe(),
            border: "none".into(),
            frames: pairs.describe(),
            region: self.params.region.describe_in(self.params.roi),
            weights: None,
            backend: OWN.into(),
            pooled: MEAN.into(),
            more: vec![("ceiling", format!("{PSNR_CEILING_DB} dB"))],
        };
        Ok(Out { scores: Arc::new(Table::scores(pairs.scores("psnr_db", "dB", &psnr), card)) })
    }
}

/// Mean squared difference over the mask, and how many values were not known.
pub(crate) fn mean_square_error(picture: &[f32], reference: &[f32], mask: &[bool]) -> (f64, u64) {
    let (mut sum, mut count, mut unknown) = (0.0, 0u64, 0u64);
    for ((value, reference), _) in picture.iter().zip(reference).zip(mask).filter(|(_, counts)| **counts) {
        unknown += u64::from(!value.is_finite());
        let value = if value.is_finite() { f64::from(*value) } else { 0.0 };
        let difference = value - f64::from(*reference);
        sum += difference * difference;
        count += 1;
    }
    (sum / count as f64, unknown)
}

/// The ratio in dB, at most [`PSNR_CEILING_DB`]; NaN when there was nothing to compare.
pub(crate) fn psnr_db(mse: f64, peak: f64) -> f64 {
    // `min` would turn a NaN into the ceiling.
    if mse.is_nan() { mse } else { (10.0 * libm::log10(peak * peak / mse)).min(PSNR_CEILING_DB) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crop::Crop;
    use photocurrent_core::{Exposure, Extent, FrameSequence, Truth, testing};

    fn run(params: Params, frames: FrameSequence, truth: FrameSequence) -> (Arc<Table>, Vec<String>) {
        let node = ScorePsnr { params };
        let rows = frames.rows();
        let (out, notes) = testing::with_context(rows, &["scores"], |cx| {
            node.run(In { frames, truth: Truth(truth), sensor: None }, cx)
        });
        (out.unwrap().scores, notes)
    }

    fn constant(dn: f32) -> FrameSequence {
        testing::captured(
            Extent { width: 4, height: 3 },
            vec![Exposure::new(0, 100), Exposure::new(1000, 1100)],
            0,
            |_, _, _| dn,
        )
    }

    #[test]
    fn an_error_of_a_tenth_of_the_peak_is_twenty_decibels() {
        let (table, _) =
            run(Params { peak_dn: Some(100.0), ..Params::default() }, constant(60.0), constant(50.0));
        let scores = table.as_scores().unwrap();
        assert_eq!(scores.len(), 3);
        assert!(scores.iter().all(|s| (s.value - 20.0).abs() < 1e-12));
        assert_eq!((scores[1].frame, scores[1].t_ns, scores[2].frame), (1, 1050, -1));
    }

    #[test]
    fn the_card_says_what_was_measured() {
        let roi = Some(Crop { x: 1, y: 0, width: 2, height: 3 });
        let (table, _) = run(Params { roi, ..Params::default() }, constant(60.0), constant(50.0));
        let expected = "psnr.v1: channel = linear DN, 1 channel; range = peak 50.000 DN (largest true \
                        value); border = none; \
            frames = 2 of 2 matched by middle of exposure within 1 us; region = all pixels, in 2 x 3 pixels \
            at (1, 0); weights = none; backend = own, f64; pooled = mean over frames; ceiling = 120 dB";
        assert_eq!(table.notes, [("card".to_string(), expected.to_string())]);
    }

    #[test]
    fn a_peak_of_another_range_gives_a_reason_and_no_number() {
        let node = ScorePsnr { params: Params { peak_dn: Some(1.0), ..Params::default() } };
        let input = In { frames: constant(60.0), truth: Truth(constant(50.0)), sensor: None };
        let (out, _) =
            testing::with_context(input.frames.rows(), &["scores"], |cx| node.run(input, cx).map(drop));
        let error = out.unwrap_err();
        assert_eq!(
            error.message,
            "24 of 24 true values lie above the peak of 1 DN: it is of another range of values"
        );
        assert_eq!(error.notes, ["the largest true value is 50 DN"]);
    }

    #[test]
    fn equal_frames_reach_the_ceiling() {
        let (table, _) = run(Params::default(), constant(50.0), constant(50.0));
        assert_eq!(table.as_scores().unwrap()[0].value, PSNR_CEILING_DB);
    }

    #[test]
    fn unknown_values_are_counted_and_do_not_help() {
        let (table, notes) =
            run(Params { peak_dn: Some(50.0), ..Params::default() }, constant(f32::NAN), constant(50.0));
        assert_eq!(table.as_scores().unwrap()[0].value, 0.0);
        assert_eq!(notes, ["24 values were not known (NaN) and counted as 0 DN"]);
    }
}
