//! `score/psnr`: peak signal-to-noise ratio against true frames, per frame and pooled.
//!
//! `PSNR = 10 log10(peak^2 / MSE)` on linear DN, no gamma, no clipping, no affine fitting. The peak is the sensor's saturation above black when a sensor
//! description is connected, a given number, or the largest true value. A frame is compared with the true frame whose middle of exposure agrees.
//!
//! Limits: PSNR is global; it says little about edges. A value that is not known (NaN) counts as zero DN, so that a method gains nothing by
//! leaving pixels out; how many there were is said.

use super::matching::match_frames;
use super::region::Region;
use photocurrent_core::quantity::Duration;
use photocurrent_core::table::{Score, TableMeta};
use photocurrent_core::{Context, Decl, FrameSequence, Grain, Meta, Node, NodeError, PortMetas, Sensor, Table, Truth};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A perfect frame would have no finite ratio; this stands for it.
pub const PSNR_CEILING_DB: f64 = 120.0;

/// Parameters of `score/psnr`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// DN that counts as peak, above black; absent = saturation of the connected sensor, else the largest true value.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub peak_dn: Option<f64>,
    /// Which pixels count.
    pub region: Region,
    /// How far apart the middles of two exposures may lie.
    #[schemars(extend("x-min" = "0 ns"))]
    pub tolerance: Duration,
}

impl Default for Params {
    fn default() -> Self {
        Params { peak_dn: None, region: Region::All, tolerance: Duration::new(1000) }
    }
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// The frames to judge.
        frames: FrameSequence,
        /// What they should be.
        truth: Truth,
        /// For the peak.
        sensor: Option<Arc<Sensor>>,
    }
}

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
        revision: 1,
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
        match_frames(inputs.frames("frames")?, inputs.truth("truth")?, self.params.tolerance.ns())?;
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: true }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let (frames, truth) = (&input.frames, &input.truth.0);
        let pairs = match_frames(&frames.meta, &truth.meta, self.params.tolerance.ns())?;
        cx.begin(pairs.len() as u64, "frames");
        let (peak, peak_from) = match (self.params.peak_dn, input.sensor.as_deref().and_then(saturation_above_black)) {
            (Some(peak), _) => (peak, "given"),
            (None, Some(peak)) => (peak, "saturation of the sensor above black"),
            (None, None) => (largest(truth)?, "largest true value"),
        };
        if peak <= 0.0 {
            return Err(NodeError::input("the true frames are black: there is no peak").hint("state `peak_dn`"));
        }
        let mask = self.params.region.mask(truth, peak)?;
        let compare = |&(l, reference): &(usize, usize)| -> Result<(f64, u64), NodeError> {
            let picture = frames.read(l..l + 1, frames.rows())?;
            let true_picture = truth.read(reference..reference + 1, truth.rows())?;
            cx.advance(1)?;
            Ok(mean_square_error(&picture.dn, &true_picture.dn, &mask))
        };
        let compared: Result<Vec<(f64, u64)>, NodeError> = pairs.par_iter().map(compare).collect();
        let compared = compared?;
        cx.count(compared.iter().map(|(_, unknown)| unknown).sum(), "values were not known (NaN) and counted as 0 DN");
        let psnr: Vec<f64> = compared.iter().map(|(mse, _)| psnr_db(*mse, peak)).collect();
        let times = &frames.meta.times;
        let score = |frame, t_ns, value| Score { metric: "psnr_db".into(), frame, t_ns, value, unit: "dB".into() };
        let mut scores: Vec<Score> = pairs.iter().zip(&psnr).map(|((l, _), db)| score(*l as i64, times.exposures[*l].mid().0, *db)).collect();
        scores.push(score(-1, 0, psnr.iter().sum::<f64>() / psnr.len() as f64));
        let card = format!(
            "psnr.v1: linear DN; peak {peak:.3} DN ({peak_from}); {}; {} of {} frames matched by middle of exposure within {}; pooled = mean over frames; ceiling {PSNR_CEILING_DB} dB",
            self.params.region.describe(),
            pairs.len(),
            frames.len(),
            self.params.tolerance
        );
        Ok(Out { scores: Arc::new(Table::scores(scores, card)) })
    }
}

/// Saturation above black, when the description states a saturation.
pub(crate) fn saturation_above_black(sensor: &Sensor) -> Option<f64> {
    sensor.frames.saturation_dn.map(|saturation| saturation - sensor.frames.black_level_dn.unwrap_or(0.0))
}

/// Largest finite value of a sequence.
pub(crate) fn largest(frames: &FrameSequence) -> Result<f64, NodeError> {
    let mut peak = f64::NEG_INFINITY;
    for l in 0..frames.len() {
        let picture = frames.read(l..l + 1, frames.rows())?;
        peak = picture.dn.iter().filter(|dn| dn.is_finite()).fold(peak, |peak, dn| peak.max(f64::from(*dn)));
    }
    Ok(peak)
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
    use photocurrent_core::{Exposure, Extent, testing};

    fn run(params: Params, frames: FrameSequence, truth: FrameSequence) -> (Arc<Table>, Vec<String>) {
        let node = ScorePsnr { params };
        let rows = frames.rows();
        let (out, notes) = testing::with_context(rows, &["scores"], |cx| node.run(In { frames, truth: Truth(truth), sensor: None }, cx));
        (out.unwrap().scores, notes)
    }

    fn constant(dn: f32) -> FrameSequence {
        testing::captured(Extent { width: 4, height: 3 }, vec![Exposure::new(0, 100), Exposure::new(1000, 1100)], 0, |_, _, _| dn)
    }

    #[test]
    fn an_error_of_a_tenth_of_the_peak_is_twenty_decibels() {
        let (table, _) = run(Params { peak_dn: Some(100.0), ..Params::default() }, constant(60.0), constant(50.0));
        let scores = table.as_scores().unwrap();
        assert_eq!(scores.len(), 3);
        assert!(scores.iter().all(|s| (s.value - 20.0).abs() < 1e-12));
        assert_eq!((scores[1].frame, scores[1].t_ns, scores[2].frame), (1, 1050, -1));
    }

    #[test]
    fn equal_frames_reach_the_ceiling() {
        let (table, _) = run(Params::default(), constant(50.0), constant(50.0));
        assert_eq!(table.as_scores().unwrap()[0].value, PSNR_CEILING_DB);
    }

    #[test]
    fn unknown_values_are_counted_and_do_not_help() {
        let (table, notes) = run(Params { peak_dn: Some(50.0), ..Params::default() }, constant(f32::NAN), constant(50.0));
        assert_eq!(table.as_scores().unwrap()[0].value, 0.0);
        assert_eq!(notes, ["24 values were not known (NaN) and counted as 0 DN"]);
    }
}
