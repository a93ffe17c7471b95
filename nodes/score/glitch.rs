//! `score/glitch`: how much the PSNR jumps from one frame to the next.
//!
//! A method that works frame by frame can be good on average and still flicker: its PSNR curve over time has
//! steps where one captured frame gives way to the next (the paper's Fig. 7). This node takes the scores of
//! any scorer and measures the spread of the change between neighbouring frames: per frame the absolute
//! change to the frame before, pooled their standard deviation about zero, the largest one, and how often it
//! exceeds `step`.
//!
//! Limits: a scene that itself changes abruptly changes the score too; compare methods on one scene. Frames
//! that were not measured break the chain.

use super::card::{Card, OWN};
use photocurrent_core::table::{Score, TableMeta};
use photocurrent_core::{Context, Decl, Grain, Meta, Node, NodeError, PortMetas, Table};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `score/glitch`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The metric whose changes are measured.
    pub metric: String,
    /// A change of more than this counts as a glitch, in the unit of the metric.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub step: f64,
}

impl Default for Params {
    fn default() -> Self {
        Params { metric: "psnr_db".into(), step: 3.0 }
    }
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Scores of frames in order of time, as `score/psnr` gives them.
        scores: Arc<Table>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// `glitch_<metric>` per frame (absolute change) and pooled (root mean square), `glitch_max_<metric>`
        /// and `glitches` pooled.
        glitches: Arc<Table>,
    }
}

/// The node.
pub struct ScoreGlitch {
    params: Params,
}

impl Node for ScoreGlitch {
    const DECL: Decl = Decl {
        kind: "score/glitch",
        about: "Spread of the change of a score from frame to frame: how much a video flickers.",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["Jiang et al., CVPR 2024, Fig. 7"],
        example: r#"
[nodes.glitch]
kind = "score/glitch"
in   = { scores = "psnr" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(ScoreGlitch { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        if !inputs.all("scores").iter().all(|meta| matches!(meta, Meta::Table(table) if table.scores)) {
            return Err(NodeError::usage("`scores` holds no scores")
                .hint("connect the output of a scorer, such as score/psnr"));
        }
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: true }))])
    }

    fn metrics(params: &Params) -> Vec<String> {
        let of = &params.metric;
        vec![format!("glitch_{of}"), format!("glitch_max_{of}"), "glitches".into()]
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let scores = input.scores.as_scores().ok_or_else(|| NodeError::input("`scores` holds no scores"))?;
        let mut frames: Vec<&Score> =
            scores.iter().filter(|score| score.frame >= 0 && score.metric == self.params.metric).collect();
        let Some(unit) = frames.first().map(|score| score.unit.clone()) else {
            return Err(self.no_such_metric(&scores));
        };
        frames.sort_by_key(|score| score.frame);
        let changes: Vec<(&Score, f64)> =
            frames.windows(2).map(|pair| (pair[1], (pair[1].value - pair[0].value).abs())).collect();
        let measured: Vec<f64> =
            changes.iter().map(|(_, change)| *change).filter(|change| !change.is_nan()).collect();
        cx.count(
            (changes.len() - measured.len()) as u64,
            "changes were not measured, as a frame next to them was not",
        );
        if measured.is_empty() {
            return Err(NodeError::input(format!(
                "{} frame(s) of \"{}\" make no pair of measured neighbours",
                frames.len(),
                self.params.metric
            ))
            .hint("score two frames or more"));
        }
        let name = format!("glitch_{}", self.params.metric);
        let score = |metric: &str, frame, t_ns, value, unit: &str| Score {
            metric: metric.into(),
            frame,
            t_ns,
            value,
            unit: unit.into(),
        };
        let mut table: Vec<Score> =
            changes.iter().map(|(at, change)| score(&name, at.frame, at.t_ns, *change, &unit)).collect();
        let root_mean_square =
            (measured.iter().map(|change| change * change).sum::<f64>() / measured.len() as f64).sqrt();
        table.push(score(&name, -1, 0, root_mean_square, &unit));
        let largest = measured.iter().copied().fold(0.0, f64::max);
        table.push(score(&format!("glitch_max_{}", self.params.metric), -1, 0, largest, &unit));
        let glitches = measured.iter().filter(|change| **change > self.params.step).count();
        table.push(score("glitches", -1, 0, glitches as f64, ""));
        let of = input
            .scores
            .notes
            .iter()
            .find(|(name, _)| name == "card")
            .map_or("no card", |(_, card)| card.as_str());
        let card = Card {
            definition: "glitch.v1",
            channel: format!("\"{}\" of {of}", self.params.metric),
            range: "as measured".into(),
            border: "none".into(),
            frames: format!("each with the one before, {} changes", measured.len()),
            region: "as measured".into(),
            weights: None,
            backend: OWN.into(),
            pooled: "root mean square, largest, number over the step".into(),
            more: vec![("step", format!("{} {unit}", self.params.step))],
        };
        Ok(Out { glitches: Arc::new(Table::scores(table, card)) })
    }
}

impl ScoreGlitch {
    fn no_such_metric(&self, scores: &[Score]) -> NodeError {
        let mut known: Vec<&str> =
            scores.iter().filter(|score| score.frame >= 0).map(|score| score.metric.as_str()).collect();
        known.dedup();
        NodeError::input(format!("no frame has the metric \"{}\"", self.params.metric))
            .hint(format!("there are: {}", known.join(", ")))
            .param("metric")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Rows, testing};

    fn run(values: &[f64], metric: &str) -> Result<(Vec<Score>, Vec<String>), NodeError> {
        let score = |(l, value): (usize, &f64)| Score {
            metric: "psnr_db".into(),
            frame: l as i64,
            t_ns: 1000 * l as i64,
            value: *value,
            unit: "dB".into(),
        };
        let mut scores: Vec<Score> = values.iter().enumerate().map(score).rev().collect();
        scores.push(Score { frame: -1, ..scores[0].clone() });
        let node = ScoreGlitch { params: Params { metric: metric.into(), ..Params::default() } };
        let input = In { scores: Arc::new(Table::scores(scores, "psnr.v1: made up")) };
        let (out, notes) =
            testing::with_context(Rows { start: 0, end: 1 }, &["glitches"], |cx| node.run(input, cx));
        Ok((out?.glitches.as_scores().unwrap(), notes))
    }

    fn pooled(scores: &[Score], metric: &str) -> f64 {
        scores.iter().find(|score| score.metric == metric && score.frame == -1).unwrap().value
    }

    #[test]
    fn changes_of_three_and_four_have_a_root_mean_square_of_the_root_of_twelve_and_a_half() {
        let (scores, _) = run(&[30.0, 33.0, 29.0], "psnr_db").unwrap();
        assert_eq!(
            scores[..2].iter().map(|s| (s.frame, s.t_ns, s.value)).collect::<Vec<_>>(),
            [(1, 1000, 3.0), (2, 2000, 4.0)]
        );
        assert!((pooled(&scores, "glitch_psnr_db") - 12.5_f64.sqrt()).abs() < 1e-12);
        // 3 dB is not more than 3 dB.
        assert_eq!((pooled(&scores, "glitch_max_psnr_db"), pooled(&scores, "glitches")), (4.0, 1.0));
    }

    #[test]
    fn a_steady_method_has_no_glitch_however_bad_it_is() {
        let (scores, _) = run(&[5.0; 4], "psnr_db").unwrap();
        assert_eq!(pooled(&scores, "glitch_psnr_db"), 0.0);
    }

    #[test]
    fn frames_that_were_not_measured_break_the_chain() {
        let (scores, notes) = run(&[30.0, 31.0, f64::NAN, 40.0], "psnr_db").unwrap();
        assert_eq!(pooled(&scores, "glitch_psnr_db"), 1.0);
        assert_eq!(notes, ["2 changes were not measured, as a frame next to them was not"]);
    }

    #[test]
    fn one_frame_or_another_metric_give_a_reason() {
        assert_eq!(
            run(&[30.0], "psnr_db").unwrap_err().message,
            "1 frame(s) of \"psnr_db\" make no pair of measured neighbours"
        );
        let error = run(&[30.0, 31.0], "ssim").unwrap_err();
        assert_eq!(
            (error.message.as_str(), error.hint.as_deref()),
            ("no frame has the metric \"ssim\"", Some("there are: psnr_db"))
        );
    }
}
