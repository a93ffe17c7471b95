//! `score/coverage`: are standard deviations honest? How often the truth lies within one, two and three of
//! them.
//!
//! `z = (value - truth) / sigma` for every value. Were the errors normal and the standard deviations right,
//! 68.27, 95.45 and 99.73 % of all |z| would lie below one, two and three, and the root mean square of z
//! would be one. Lower parts mean that standard deviations are too small: the picture is less known than it
//! says.
//!
//! Limits: errors of one picture are not independent, so a part's own uncertainty is larger than its number
//! of values suggests. Values that are not known (NaN, or without a standard deviation) are left out and
//! counted.

use super::card::{Card, MEAN, OWN, linear_dn};
use super::compare::{Pairs, Peak};
use super::matching::match_frames;
use super::region::Region;
use crate::crop::Crop;
use photocurrent_core::quantity::Duration;
use photocurrent_core::table::TableMeta;
use photocurrent_core::{
    Context, Decl, FrameSequence, FramesMeta, Grain, Meta, Node, NodeError, PortMetas, Sensor, Table, Truth,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What lies within so many standard deviations is counted.
const WITHIN: [(f64, &str); 3] = [(1.0, "within_1_sigma"), (2.0, "within_2_sigma"), (3.0, "within_3_sigma")];

/// Parameters of `score/coverage`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Which pixels count.
    pub region: Region,
    /// Only pixels in this rectangle count; absent = the whole picture.
    pub roi: Option<Crop>,
    /// How far apart the middles of two exposures may lie.
    #[schemars(extend("x-min" = "0 ns"))]
    pub tolerance: Duration,
}

impl Default for Params {
    fn default() -> Self {
        Params { region: Region::All, roi: None, tolerance: Duration::new(1000) }
    }
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// The frames.
        frames: FrameSequence,
        /// Standard deviation of every value of theirs, DN.
        sigma: FrameSequence,
        /// What the frames should be.
        truth: Truth,
        /// For the peak from which moving pixels follow.
        sensor: Option<Arc<Sensor>>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// Per frame, and pooled as the mean over frames: `within_1_sigma`, `within_2_sigma` and
        /// `within_3_sigma`, %, `rms_z`, and `sigma_dn`, the median standard deviation, DN.
        scores: Arc<Table>,
    }
}

/// The node.
pub struct ScoreCoverage {
    params: Params,
}

impl Node for ScoreCoverage {
    const DECL: Decl = Decl {
        kind: "score/coverage",
        about: "How often the truth lies within one, two and three standard deviations of frames.",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["parts of a normal distribution: 68.27, 95.45 and 99.73 %"],
        example: r#"
[nodes.coverage]
kind = "score/coverage"
in   = { frames = "render.frames", sigma = "render.sigma", truth = "recording.truth", sensor = "sensor" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(ScoreCoverage { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let frames = inputs.frames("frames")?;
        match_frames(frames, inputs.truth("truth")?, self.params.tolerance.ns())?;
        belong(frames, inputs.frames("sigma")?)?;
        self.params.roi.map_or(Ok(()), |roi| roi.check("roi", "frames", frames.extent))?;
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: true }))])
    }

    fn metrics(_: &Params) -> Vec<String> {
        WITHIN.iter().map(|(_, name)| *name).chain(["rms_z", "sigma_dn"]).map(String::from).collect()
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        belong(&input.frames.meta, &input.sigma.meta)?;
        let pairs = Pairs::new(&input.frames, &input.truth.0, self.params.tolerance)?;
        let peak = Peak::find(None, input.sensor.as_deref(), &input.truth.0, "true")?;
        let mask = self.params.region.mask_in(self.params.roi, &input.truth.0, peak.dn)?;
        let counted = pairs.map_with(cx, &input.sigma, |picture, reference, sigma| {
            Ok(Counted::of(picture, reference, sigma, &mask))
        })?;
        cx.count(
            counted.iter().map(|counted| counted.unknown).sum(),
            "values were not known, or not how well, and are left out",
        );
        let mut scores = Vec::new();
        for (n, (_, name)) in WITHIN.iter().enumerate() {
            let parts: Vec<f64> = counted
                .iter()
                .map(|counted| 100.0 * counted.within[n] as f64 / counted.known as f64)
                .collect();
            scores.extend(pairs.scores(name, "%", &parts));
        }
        let rms: Vec<f64> =
            counted.iter().map(|counted| (counted.squares / counted.known as f64).sqrt()).collect();
        scores.extend(pairs.scores("rms_z", "", &rms));
        let sigma: Vec<f64> = counted.iter().map(|counted| counted.median).collect();
        scores.extend(pairs.scores("sigma_dn", "DN", &sigma));
        let card = Card {
            definition: "coverage.v1",
            channel: linear_dn(&input.frames.meta),
            range: peak.describe(),
            border: "none".into(),
            frames: pairs.describe(),
            region: self.params.region.describe_in(self.params.roi),
            weights: None,
            backend: OWN.into(),
            pooled: MEAN.into(),
            more: Vec::new(),
        };
        Ok(Out { scores: Arc::new(Table::scores(scores, card)) })
    }
}

/// Are these the standard deviations of those frames?
fn belong(frames: &FramesMeta, sigma: &FramesMeta) -> Result<(), NodeError> {
    if frames == sigma {
        return Ok(());
    }
    Err(NodeError::usage("`sigma` is of other size, times or scale than `frames`")
        .hint("connect the outputs `frames` and `sigma` of one render/rows"))
}

/// What was counted in one frame.
struct Counted {
    within: [u64; WITHIN.len()],
    known: u64,
    unknown: u64,
    squares: f64,
    median: f64,
}

impl Counted {
    fn of(picture: &[f32], reference: &[f32], sigma: &[f32], mask: &[bool]) -> Counted {
        let mut counted =
            Counted { within: [0; WITHIN.len()], known: 0, unknown: 0, squares: 0.0, median: f64::NAN };
        let mut sigmas = Vec::new();
        for (((value, reference), sigma), _) in
            picture.iter().zip(reference).zip(sigma).zip(mask).filter(|(_, counts)| **counts)
        {
            if !(value.is_finite() && *sigma > 0.0) {
                counted.unknown += 1;
                continue;
            }
            let z = (f64::from(*value) - f64::from(*reference)) / f64::from(*sigma);
            counted.known += 1;
            counted.squares += z * z;
            for (within, (limit, _)) in counted.within.iter_mut().zip(WITHIN) {
                *within += u64::from(z.abs() <= limit);
            }
            sigmas.push(*sigma);
        }
        if !sigmas.is_empty() {
            let middle = sigmas.len() / 2;
            counted.median = f64::from(*sigmas.select_nth_unstable_by(middle, f32::total_cmp).1);
        }
        counted
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::random::Random;
    use photocurrent_core::{Exposure, Extent, testing};

    const EXTENT: Extent = Extent { width: 100, height: 100 };

    fn frames(dn: impl Fn(usize, u32, u32) -> f32) -> FrameSequence {
        testing::captured(EXTENT, vec![Exposure::new(0, 100)], 0, dn)
    }

    fn pooled(
        frames: FrameSequence,
        sigma: FrameSequence,
        truth: FrameSequence,
    ) -> (Vec<(String, f64)>, Vec<String>) {
        let node = ScoreCoverage { params: Params::default() };
        let input = In { frames, sigma, truth: Truth(truth), sensor: None };
        let (out, notes) = testing::with_context(EXTENT.rows(), &["scores"], |cx| node.run(input, cx));
        let table = out.unwrap().scores;
        (
            table
                .as_scores()
                .unwrap()
                .into_iter()
                .filter(|score| score.frame < 0)
                .map(|score| (score.metric.clone(), score.value))
                .collect(),
            notes,
        )
    }

    #[test]
    fn normal_errors_of_the_stated_size_lie_where_the_normal_distribution_says() {
        let normal =
            |x: u32, y: u32| 100.0 + 4.0 * Random::new(5, &[u64::from(x), u64::from(y)]).normal() as f32;
        let (scores, _) =
            pooled(frames(|_, x, y| normal(x, y)), frames(|_, _, _| 4.0), frames(|_, _, _| 100.0));
        // Of ten thousand values, parts are good to 0.5, 0.2 and 0.05 %.
        for ((metric, value), (expected, tolerance)) in
            scores.iter().zip([(68.27, 1.5), (95.45, 0.7), (99.73, 0.2), (1.0, 0.02), (4.0, 1e-6)])
        {
            assert!((value - expected).abs() < tolerance, "{metric}: {value}");
        }
    }

    #[test]
    fn what_is_not_known_is_left_out_and_counted() {
        let (scores, notes) = pooled(
            frames(|_, x, _| if x == 0 { f32::NAN } else { 103.0 }),
            frames(|_, _, _| 2.0),
            frames(|_, _, _| 100.0),
        );
        assert_eq!(scores.iter().map(|(_, value)| *value).collect::<Vec<_>>(), [0.0, 100.0, 100.0, 1.5, 2.0]);
        assert_eq!(notes, ["100 values were not known, or not how well, and are left out"]);
    }

    #[test]
    fn standard_deviations_of_other_frames_are_refused() {
        let node = ScoreCoverage { params: Params::default() };
        let other = testing::captured(EXTENT, vec![Exposure::new(0, 200)], 0, |_, _, _| 1.0);
        let input = In {
            frames: frames(|_, _, _| 1.0),
            sigma: other,
            truth: Truth(frames(|_, _, _| 1.0)),
            sensor: None,
        };
        let (out, _) = testing::with_context(EXTENT.rows(), &["scores"], |cx| node.run(input, cx).map(drop));
        assert_eq!(out.unwrap_err().message, "`sigma` is of other size, times or scale than `frames`");
    }
}
