//! `score/bew`: how wide edges are in rendered frames: the blurred edge width, `bew.v1`. Works without ground
//! truth.
//!
//! A rectangle is stated around each straight edge; [`super::edge`] says how its width is found: on linear
//! DN, along the normal of the edge, between 10 and 90 % of the contrast. Larger is blurrier. An ideal step
//! under square pixels has 0.80 pixels; a smaller value is sharpening, gets a mark, and has overshoot with
//! it, so that ringing cannot win unseen. More than one crossing of 50 % is a ghost: it is counted, and there
//! is no width.
//!
//! The paper's own definition is not public, and its lowest figure (0.7) lies below the floor: compare
//! methods and trends, not single figures. `profile = "row"` over a segment of 40 pixels is the closest
//! imitation of its Fig. 10(i). Limits: one edge a rectangle, straight, with plateaus on both sides. An edge
//! parallel to the pixels shows too few sub-pixel phases in one frame: `pool = "frames"` lays the frames in
//! which it moves over each other.

use super::card::{Card, OWN};
use super::compare::Peak;
use super::edge::{
    BOOTSTRAPS, Direction, Edge, FLOOR_PX, Fit, LEAST_ACROSS, LEAST_ALONG, Question, Refusal, Thresholds,
    measure, measure_all,
};
use super::matching::no_mosaic;
use crate::crop::Crop;
use photocurrent_core::table::{Column, Score, TableMeta, percentile};
use photocurrent_core::{
    Context, Decl, Extent, FrameSequence, Grain, Meta, Node, NodeError, PortMetas, Sensor, Table,
};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `score/bew`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// A rectangle around each edge: 20 pixels or more across it, 12 or more along it.
    pub edges: Vec<Crop>,
    /// Which channel, counted from 0.
    pub channel: u32,
    /// DN that counts as full scale, above black; absent = saturation of the connected sensor, else the
    /// largest value of the frames.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub peak_dn: Option<f64>,
    /// Between which shares of the contrast the width is taken.
    pub thresholds: Thresholds,
    /// Along what the profile is taken.
    pub profile: Direction,
    /// What the width is divided by.
    pub normalise: Normalise,
    /// What is laid through the edge's positions.
    pub fit: Fit,
    /// What the pooled scores are made of.
    pub pool: Pool,
    /// How fast each edge moves along its normal, pixels per millisecond; one number counts for all edges.
    /// With it, `bet_us` is the width divided by the speed.
    pub speeds_px_per_ms: Vec<f64>,
}

/// What pooled scores are made of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Pool {
    /// The median of the widths of single frames and edges.
    #[default]
    Widths,
    /// The median over edges of the width of one profile from all frames in which the edge was found, each by
    /// its own position there.
    Frames,
}

/// What the width is divided by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Normalise {
    /// Nothing: the distance itself.
    #[default]
    #[serde(rename = "none")]
    Nothing,
    /// 0.8: from 10-90 % to the whole ramp.
    #[serde(rename = "0.8")]
    FourFifths,
}

impl Normalise {
    fn divisor(self) -> f64 {
        match self {
            Normalise::Nothing => 1.0,
            Normalise::FourFifths => 0.8,
        }
    }
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// The frames with the edges.
        frames: FrameSequence,
        /// For full scale and saturation.
        sensor: Option<Arc<Sensor>>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// `bew_px`, `bew_gaussian_px`, `bew_overshoot`, `bew_ghosts`, with speeds `bet_us`: per frame the
        /// median over edges, pooled as `pool` says.
        scores: Arc<Table>,
        /// Everything about each edge in each frame (-1: in all of them together), with the reason where
        /// there is no width.
        edges: Arc<Table>,
        /// The edge spread functions.
        profiles: Arc<Table>,
    }
}

/// What it gives, with units; the last one where the edges' speeds are stated.
const METRICS: [(&str, &str); 5] = [
    ("bew_px", "px"),
    ("bew_gaussian_px", "px"),
    ("bew_overshoot", "%"),
    ("bew_ghosts", ""),
    ("bet_us", "us"),
];

impl Params {
    fn metrics(&self) -> &'static [(&'static str, &'static str)] {
        if self.speeds_px_per_ms.is_empty() { &METRICS[..4] } else { &METRICS }
    }
}

/// The node.
pub struct ScoreBew {
    params: Params,
}

impl ScoreBew {
    fn check(&self, extent: Extent, channels: u32) -> Result<(), NodeError> {
        for (i, roi) in self.params.edges.iter().enumerate() {
            roi.check("roi", "frames", extent).map_err(|mut error| {
                error.message = format!("edge {i}: {}", error.message);
                error.param("edges")
            })?;
            let (across, along) = match self.params.profile {
                Direction::Normal => (roi.width.max(roi.height), roi.width.min(roi.height)),
                Direction::Row => (roi.width, LEAST_ALONG as u32),
            };
            if (across as usize) < LEAST_ACROSS || (along as usize) < LEAST_ALONG {
                return Err(NodeError::usage(format!("edge {i}: {} are too few", roi.describe()))
                    .hint(format!(
                        "state {LEAST_ACROSS} pixels or more across the edge, and {LEAST_ALONG} \
                                   or more along it"
                    ))
                    .param("edges"));
            }
        }
        let speeds = self.params.speeds_px_per_ms.len();
        if speeds > 1 && speeds != self.params.edges.len() {
            return Err(NodeError::usage(format!(
                "`speeds_px_per_ms` has {speeds} numbers, and there are {} edges",
                self.params.edges.len()
            ))
            .hint("state one for each edge, in the same order, or one for all")
            .param("speeds_px_per_ms"));
        }
        if self.params.channel >= channels {
            return Err(NodeError::usage(format!(
                "`channel` is {}, and the frames have {channels}, counted from 0",
                self.params.channel
            ))
            .hint(format!("state a channel from 0 to {}", channels - 1))
            .param("channel"));
        }
        Ok(())
    }
}

impl Node for ScoreBew {
    const DECL: Decl = Decl {
        kind: "score/bew",
        about: "Width of blurred edges in pixels, with overshoot, ghosts and interval; needs no ground \
                truth.",
        revision: 2,
        grain: Grain::Whole,
        draws: true,
        exports: false,
        sources: &[
            "10-90 % rise distance of a slanted edge's spread function, as in ISO 12233",
            "Jiang et al., CVPR 2024, Figs. 10 and 11",
        ],
        example: r#"
[nodes.bew]
kind   = "score/bew"
in     = { frames = "render", sensor = "sensor" }
params = { edges = [{ x = 40, y = 30, width = 40, height = 24 }] }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if params.edges.is_empty() {
            return Err(NodeError::usage("`edges` is empty: there is nothing to measure")
                .hint(
                    "state a rectangle around each edge: edges = \
                       [{ x = 40, y = 30, width = 40, height = 24 }]",
                )
                .param("edges"));
        }
        if let Some(speed) =
            params.speeds_px_per_ms.iter().find(|speed| !(speed.is_finite() && **speed > 0.0))
        {
            return Err(NodeError::usage(format!("an edge does not move at {speed} pixels per millisecond"))
                .hint("state speeds greater than 0, without their direction")
                .param("speeds_px_per_ms"));
        }
        let along_rows = [("fit", params.fit != Fit::default()), ("pool", params.pool != Pool::default())];
        if let Some((name, _)) =
            along_rows.iter().find(|(_, is_set)| *is_set && params.profile == Direction::Row)
        {
            return Err(NodeError::usage(format!(
                "`{name}` is about edges with a position on each line, and `profile = \"row\"` averages \
                 lines as they stand"
            ))
            .hint("take it out, or set `profile = \"normal\"`")
            .param(*name));
        }
        Ok(ScoreBew { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let frames = inputs.frames("frames")?;
        no_mosaic(frames, "an edge's profile")?;
        self.check(frames.extent, frames.channels())?;
        Ok([true, false, false].map(|scores| Meta::Table(Arc::new(TableMeta { scores }))).to_vec())
    }

    fn metrics(params: &Params) -> Vec<String> {
        params.metrics().iter().map(|(metric, _)| (*metric).into()).collect()
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let frames = &input.frames;
        let meta = &frames.meta;
        self.check(meta.extent, meta.channels())?;
        let peak = Peak::find(self.params.peak_dn, input.sensor.as_deref(), frames, "given")?;
        let question = Question {
            thresholds: self.params.thresholds,
            direction: self.params.profile,
            fit: self.params.fit,
            full_scale: peak.dn,
            saturation: input.sensor.as_deref().and_then(|sensor| sensor.frames.saturation_dn),
            seed: cx.seed(),
        };
        cx.begin(frames.len() as u64, "frames");
        let planes = |l: usize| -> Result<Vec<Vec<f64>>, NodeError> {
            let picture = frames.read(l..l + 1, frames.rows())?;
            let value = |x: u32, y: u32| {
                f64::from(picture.row(l, y)[(x * meta.channels() + self.params.channel) as usize])
            };
            let plane = |roi: &Crop| {
                (roi.y..roi.y + roi.height)
                    .flat_map(|y| (roi.x..roi.x + roi.width).map(move |x| value(x, y)))
                    .collect()
            };
            cx.advance(1)?;
            Ok(self.params.edges.iter().map(plane).collect())
        };
        let (found, joint): (Vec<Vec<Edge>>, Vec<(Edge, usize)>) = match self.params.pool {
            Pool::Widths => {
                let one = |l: usize| -> Result<Vec<Edge>, NodeError> {
                    let edges = self.params.edges.iter().zip(planes(l)?);
                    Ok(edges
                        .map(|(roi, plane)| self.placed(measure(&plane, roi.width as usize, &question), roi))
                        .collect())
                };
                let found: Result<Vec<Vec<Edge>>, NodeError> =
                    (0..frames.len()).into_par_iter().map(one).collect();
                (found?, Vec::new())
            }
            Pool::Frames => {
                let all: Result<Vec<Vec<Vec<f64>>>, NodeError> =
                    (0..frames.len()).into_par_iter().map(planes).collect();
                let all = all?;
                let of_edge = |(e, roi): (usize, &Crop)| {
                    let (edges, joint, count) = measure_all(
                        all.iter().map(|planes| planes[e].as_slice()),
                        roi.width as usize,
                        &question,
                    );
                    let edges: Vec<Edge> = edges.into_iter().map(|edge| self.placed(edge, roi)).collect();
                    (edges, (self.placed(joint, roi), count))
                };
                let (of_edges, joint): (Vec<Vec<Edge>>, Vec<_>) =
                    self.params.edges.par_iter().enumerate().map(of_edge).unzip();
                (
                    (0..frames.len())
                        .map(|l| of_edges.iter().map(|edges| edges[l].clone()).collect())
                        .collect(),
                    joint,
                )
            }
        };
        for refusal in found.iter().flatten().filter_map(|edge| edge.refusal) {
            cx.count(1, &format!("edges have no width: {}", refusal.describe()));
        }
        cx.count(
            found.iter().flatten().filter(|edge| self.is_sub_floor(edge)).count() as u64,
            "widths are below that of an unsharpened edge",
        );
        let times: Vec<i64> = (0..frames.len()).map(|l| meta.times.exposures[l].mid().0).collect();
        Ok(Out {
            scores: Arc::new(Table::scores(self.scores(&found, &joint, &times), self.card(frames, &peak))),
            edges: Arc::new(self.edges(&found, &joint, &times)),
            profiles: Arc::new(profiles(&found, &joint)),
        })
    }
}

impl ScoreBew {
    /// The edge of a rectangle, in the frame's pixels and divided as asked.
    fn placed(&self, mut edge: Edge, roi: &Crop) -> Edge {
        let divisor = self.params.normalise.divisor();
        edge.width /= divisor;
        edge.interval = edge.interval.map(|end| end / divisor);
        edge.middle = [edge.middle[0] + f64::from(roi.x), edge.middle[1] + f64::from(roi.y)];
        edge
    }

    /// How long the edge takes to pass, us; NaN without a speed.
    fn transit_us(&self, e: usize, edge: &Edge) -> f64 {
        let speeds = &self.params.speeds_px_per_ms;
        speeds.get(e).or(speeds.first()).map_or(f64::NAN, |speed| 1000.0 * edge.width / speed)
    }

    /// Narrower than an unsharpened edge can be? Known for 10 to 90 % along the normal only.
    fn is_sub_floor(&self, edge: &Edge) -> bool {
        self.params.thresholds == Thresholds::TenNinety
            && self.params.profile == Direction::Normal
            && edge.width * self.params.normalise.divisor() < FLOOR_PX
    }

    fn card(&self, frames: &FrameSequence, peak: &Peak) -> Card {
        let (low, along) = (100.0 * self.params.thresholds.low(), self.params.profile);
        Card {
            definition: "bew.v1",
            channel: format!("linear DN, channel {} of {}", self.params.channel, frames.meta.channels()),
            range: peak.describe(),
            border: "none".into(),
            frames: format!("all {}, without reference", frames.len()),
            region: self.params.edges.iter().map(|roi| roi.describe()).collect::<Vec<_>>().join(" and "),
            weights: None,
            backend: OWN.into(),
            pooled: match self.params.pool {
                Pool::Widths => "median over frames and edges".into(),
                Pool::Frames => "one profile of all frames for each edge, median over edges".into(),
            },
            more: vec![
                ("thresholds", format!("{low} to {} %", 100.0 - low)),
                (
                    "profile",
                    match along {
                        Direction::Normal => "along the normal, bins of 1/4 pixel".into(),
                        Direction::Row => "along the row, mean of the rows, one value a column (imitates a \
                                           plot of DN on a segment)"
                            .into(),
                    },
                ),
                (
                    "fit",
                    match self.params.fit {
                        Fit::Straight => "straight line".into(),
                        Fit::Quadratic => "parabola".into(),
                    },
                ),
                ("normalise", self.params.normalise.divisor().to_string()),
                ("interval", format!("95 % of {BOOTSTRAPS} draws of lines")),
                ("floor", format!("{FLOOR_PX:.2} pixels, below it: sub-floor (sharpened)")),
            ],
        }
    }

    fn edges(&self, found: &[Vec<Edge>], joint: &[(Edge, usize)], times: &[i64]) -> Table {
        let all = || all(found, joint);
        let numbers =
            |value: &dyn Fn(&Edge) -> f64| Column::Numbers(all().map(|(_, _, edge)| value(edge)).collect());
        let remark = |l: i64, e: usize, edge: &Edge| {
            let joined = if l < 0 { format!("of {} frames together", joint[e].1) } else { String::new() };
            let what = match edge.refusal {
                Some(refusal) => refusal.describe().to_string(),
                None if self.is_sub_floor(edge) => "sub-floor (sharpened)".into(),
                None => String::new(),
            };
            if joined.is_empty() || what.is_empty() { joined + &what } else { format!("{joined}: {what}") }
        };
        Table::default()
            .with("frame", Column::Integers(all().map(|(l, _, _)| l).collect()))
            .with(
                "t_ns",
                Column::Integers(all().map(|(l, _, _)| usize::try_from(l).map_or(0, |l| times[l])).collect()),
            )
            .with("edge", Column::Integers(all().map(|(_, e, _)| e as i64).collect()))
            .with("bew_px", numbers(&|edge| edge.width))
            .with("bew_low_px", numbers(&|edge| edge.interval[0]))
            .with("bew_high_px", numbers(&|edge| edge.interval[1]))
            .with("bet_us", Column::Numbers(all().map(|(_, e, edge)| self.transit_us(e, edge)).collect()))
            .with("gaussian_px", numbers(&|edge| edge.gaussian_width))
            .with("overshoot_percent", numbers(&|edge| edge.overshoot))
            .with("undershoot_percent", numbers(&|edge| edge.undershoot))
            .with("mtf50_cycles_per_px", numbers(&|edge| edge.mtf50))
            .with("angle_deg", numbers(&|edge| edge.angle))
            .with("x", numbers(&|edge| edge.middle[0]))
            .with("y", numbers(&|edge| edge.middle[1]))
            .with("ghosts", Column::Integers(all().map(|(_, _, edge)| i64::from(edge.ghosts)).collect()))
            .with("ghost_spacing_px", numbers(&|edge| edge.ghost_spacing))
            .with("contrast_dn", numbers(&|edge| edge.contrast))
            .with("noise_dn", numbers(&|edge| edge.noise))
            .with("remark", Column::Texts(all().map(|(l, e, edge)| remark(l, e, edge)).collect()))
    }

    fn scores(&self, found: &[Vec<Edge>], joint: &[(Edge, usize)], times: &[i64]) -> Vec<Score> {
        let ghosts = |edge: &Edge| {
            if edge.refusal.is_some_and(|refusal| refusal != Refusal::Ghosts) {
                f64::NAN
            } else {
                f64::from(edge.ghosts)
            }
        };
        // In the order of METRICS.
        type Reading<'a> = &'a dyn Fn(usize, &Edge) -> f64;
        let readings: [Reading; 5] = [
            &|_, edge| edge.width,
            &|_, edge| edge.gaussian_width,
            &|_, edge| edge.overshoot,
            &|_, edge| ghosts(edge),
            &|e, edge| self.transit_us(e, edge),
        ];
        let mut scores = Vec::new();
        for ((metric, unit), value) in self.params.metrics().iter().zip(readings) {
            let score = |frame, t_ns, value| Score {
                metric: (*metric).into(),
                frame,
                t_ns,
                value,
                unit: (*unit).into(),
            };
            let over = |edges: &[Edge]| median(edges.iter().enumerate().map(|(e, edge)| value(e, edge)));
            scores.extend(found.iter().enumerate().map(|(l, edges)| score(l as i64, times[l], over(edges))));
            let pooled = match self.params.pool {
                Pool::Widths => median(
                    found.iter().flat_map(|edges| edges.iter().enumerate()).map(|(e, edge)| value(e, edge)),
                ),
                Pool::Frames => median(joint.iter().enumerate().map(|(e, (edge, _))| value(e, edge))),
            };
            scores.push(score(-1, 0, pooled));
        }
        scores
    }
}

/// Every edge with its frame (-1: all of them) and its number.
fn all<'a>(
    found: &'a [Vec<Edge>],
    joint: &'a [(Edge, usize)],
) -> impl Iterator<Item = (i64, usize, &'a Edge)> {
    let single = found
        .iter()
        .enumerate()
        .flat_map(|(l, edges)| edges.iter().enumerate().map(move |(e, edge)| (l as i64, e, edge)));
    single.chain(joint.iter().enumerate().map(|(e, (edge, _))| (-1, e, edge)))
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.filter(|value| !value.is_nan()).collect();
    values.sort_by(f64::total_cmp);
    percentile(&values, 0.5)
}

fn profiles(found: &[Vec<Edge>], joint: &[(Edge, usize)]) -> Table {
    let all =
        || all(found, joint).flat_map(|(l, e, edge)| edge.profile.iter().map(move |point| (l, e, point)));
    Table::default()
        .with("frame", Column::Integers(all().map(|(l, _, _)| l).collect()))
        .with("edge", Column::Integers(all().map(|(_, e, _)| e as i64).collect()))
        .with("distance_px", Column::Numbers(all().map(|(_, _, (distance, _))| *distance).collect()))
        .with("share_of_contrast", Column::Numbers(all().map(|(_, _, (_, share))| *share).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Exposure, testing};

    const EXTENT: Extent = Extent { width: 60, height: 40 };
    const EDGE: Crop = Crop { x: 10, y: 6, width: 40, height: 24 };

    /// Frame 0 has a Gaussian edge of sigma 1, 5 degrees off the vertical, at column 30.2 of row 18; frame 1
    /// is flat.
    fn frames() -> FrameSequence {
        let value = |l: usize, x: u32, y: u32| {
            let d = (f64::from(x) - 30.2) * libm::cos(0.0873) + (f64::from(y) - 18.0) * libm::sin(0.0873);
            if l == 1 {
                300.0
            } else {
                (200.0 + 200.0 * (1.0 + libm::erf(d / std::f64::consts::SQRT_2))) as f32
            }
        };
        testing::captured(EXTENT, vec![Exposure::new(0, 100), Exposure::new(1000, 1100)], 0, value)
    }

    fn run(params: Params) -> Result<(Out, Vec<String>), NodeError> {
        let node = ScoreBew::build(Params { peak_dn: Some(1000.0), ..params })?;
        let (out, notes) = testing::with_context(EXTENT.rows(), &["scores"], |cx| {
            node.run(In { frames: frames(), sensor: None }, cx)
        });
        Ok((out?, notes))
    }

    fn value(table: &Table, metric: &str, frame: i64) -> f64 {
        table
            .as_scores()
            .unwrap()
            .iter()
            .find(|score| score.metric == metric && score.frame == frame)
            .unwrap()
            .value
    }

    #[test]
    fn a_flat_frame_gets_a_reason_and_the_other_one_its_width() {
        let (out, notes) = run(Params { edges: vec![EDGE], ..Params::default() }).unwrap();
        assert!(
            (value(&out.scores, "bew_px", 0) - 2.563).abs() < 0.06,
            "{}",
            value(&out.scores, "bew_px", 0)
        );
        assert!(value(&out.scores, "bew_px", 1).is_nan());
        assert_eq!(
            value(&out.scores, "bew_px", -1),
            value(&out.scores, "bew_px", 0),
            "the median of what was measured"
        );
        assert_eq!(
            notes,
            ["1 edges have no width: no edge, or too little contrast: less than 5 % of full scale"]
        );
        let Some(Column::Numbers(x)) = out.edges.column("x") else { panic!("a column x") };
        // The middle line of the rectangle is row 17.5.
        assert!((x[0] - 30.2).abs() < 0.1 && x[1].is_nan(), "{x:?}");
        assert!(out.profiles.len() > 80);
        let card = &out.scores.notes[0].1;
        assert!(
            card.starts_with("bew.v1: channel = linear DN, channel 0 of 1; ")
                && card.contains("40 x 24 pixels at (10, 6)"),
            "{card}"
        );
    }

    #[test]
    fn the_normalised_width_is_that_of_the_whole_ramp() {
        let of = |normalise| {
            value(
                &run(Params { edges: vec![EDGE], normalise, ..Params::default() }).unwrap().0.scores,
                "bew_px",
                0,
            )
        };
        assert!((of(Normalise::FourFifths) * 0.8 - of(Normalise::Nothing)).abs() < 1e-12);
    }

    #[test]
    fn a_segment_of_forty_pixels_is_read_along_the_row() {
        let segment = Crop { x: 10, y: 18, width: 40, height: 1 };
        let (out, _) =
            run(Params { edges: vec![segment], profile: Direction::Row, ..Params::default() }).unwrap();
        // Straight lines between columns widen this edge by up to 0.32 pixels.
        assert!(
            (0.0..0.32).contains(&(value(&out.scores, "bew_px", 0) - 2.563)),
            "{}",
            value(&out.scores, "bew_px", 0)
        );
        assert!(out.scores.notes[0].1.contains("along the row"));
    }

    #[test]
    fn all_frames_together_give_the_pooled_width_and_say_of_how_many_it_is() {
        let (out, _) = run(Params { edges: vec![EDGE], pool: Pool::Frames, ..Params::default() }).unwrap();
        // Frame 1 is flat: one frame takes part.
        assert!((value(&out.scores, "bew_px", -1) - value(&out.scores, "bew_px", 0)).abs() < 1e-9);
        let (Some(Column::Integers(frame)), Some(Column::Texts(remark))) =
            (out.edges.column("frame"), out.edges.column("remark"))
        else {
            panic!()
        };
        assert_eq!((frame.as_slice(), remark[2].as_str()), (&[0, 1, -1][..], "of 1 frames together"));
        assert!(
            out.scores.notes[0].1.contains("pooled = one profile of all frames for each edge"),
            "{}",
            out.scores.notes[0].1
        );
    }

    #[test]
    fn a_speed_turns_width_into_time() {
        let (out, _) =
            run(Params { edges: vec![EDGE, EDGE], speeds_px_per_ms: vec![0.5, 2.0], ..Params::default() })
                .unwrap();
        let width = value(&out.scores, "bew_px", 0);
        // The median of two is their mean: 2000 and 500 us a pixel.
        assert!(
            (value(&out.scores, "bet_us", 0) - 1250.0 * width).abs() < 1e-6,
            "{}",
            value(&out.scores, "bet_us", 0)
        );
        let (out, _) =
            run(Params { edges: vec![EDGE, EDGE], speeds_px_per_ms: vec![2.0], ..Params::default() })
                .unwrap();
        assert!((value(&out.scores, "bet_us", -1) - 500.0 * width).abs() < 1e-6);
        let (out, _) = run(Params { edges: vec![EDGE], ..Params::default() }).unwrap();
        assert!(
            out.scores.as_scores().unwrap().iter().all(|score| score.metric != "bet_us"),
            "only when asked"
        );
        let refused = |params| run(params).err().unwrap().param.unwrap();
        assert_eq!(
            refused(Params { edges: vec![EDGE], speeds_px_per_ms: vec![0.0], ..Params::default() }),
            "speeds_px_per_ms"
        );
        assert_eq!(
            refused(Params {
                edges: vec![EDGE, EDGE, EDGE],
                speeds_px_per_ms: vec![1.0, 2.0],
                ..Params::default()
            }),
            "speeds_px_per_ms"
        );
        assert_eq!(
            refused(Params {
                edges: vec![EDGE],
                profile: Direction::Row,
                fit: Fit::Quadratic,
                ..Params::default()
            }),
            "fit"
        );
    }

    #[test]
    fn rectangles_outside_or_too_small_and_missing_channels_are_refused() {
        let refused = |params: Params| {
            let error = run(params).err().unwrap();
            assert!(error.hint.is_some());
            (error.message, error.param.unwrap())
        };
        assert_eq!(
            refused(Params::default()),
            ("`edges` is empty: there is nothing to measure".into(), "edges".into())
        );
        let outside = refused(Params { edges: vec![EDGE, Crop { x: 30, ..EDGE }], ..Params::default() });
        assert_eq!(
            outside,
            (
                "edge 1: `roi` asks for 40 x 24 pixels at (30, 6), and the frames have 60 x 40".into(),
                "edges".into()
            )
        );
        let small =
            refused(Params { edges: vec![Crop { width: 40, height: 11, ..EDGE }], ..Params::default() });
        assert_eq!(small, ("edge 0: 40 x 11 pixels at (10, 6) are too few".into(), "edges".into()));
        let channel = refused(Params { edges: vec![EDGE], channel: 1, ..Params::default() });
        assert_eq!(
            channel,
            ("`channel` is 1, and the frames have 1, counted from 0".into(), "channel".into())
        );
    }
}
