//! `score/pixel_error`: single pixels over time, with the truth: DN and the settled voltage V_DC.
//!
//! A mean over pictures hides what happens in the one pixel that a fast object passes. Here chosen pixels are
//! followed through all frames (the paper's Fig. 8): their DN, the photocurrent that it stands for by Eq.
//! (5), and `V_DC = ln i` of Eq. (6), each with that of the true frame. `V_FE` is what the front end makes of
//! that light by Eqs. (1) and (2): it settles towards each frame's V_DC, with the time constant of that
//! frame's photocurrent, from one middle of an exposure to the next. It is close to the pixel's own voltage
//! where frames follow each other faster than the front end does. Errors in V_DC are relative errors of the
//! light: 0.1 is about 10 %, whether the pixel is bright or dark.
//!
//! Limits: V_DC is that of the mean light over a frame's virtual exposure, not of an instant. A DN at or
//! below black has none.

use super::card::{Card, MEAN, OWN};
use super::compare::mean_of_measured;
use super::matching::match_frames;
use crate::sampling::scale_seconds;
use photocurrent_core::quantity::Duration;
use photocurrent_core::table::{Column, Score, TableMeta};
use photocurrent_core::{
    Colour, Context, Decl, FrameSequence, FramesMeta, Grain, Meta, Node, NodeError, PortMetas, Rows, Sensor,
    Table, Truth,
};
use photocurrent_sensor::front_end::{
    FrontEnd, settle, settled_photocurrent, settled_voltage, time_constant,
};
use photocurrent_sensor::model::Model;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `score/pixel_error`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The pixels to follow, each as `{ x = ..., y = ... }`.
    pub pixels: Vec<Pixel>,
    /// How far apart the middles of two exposures may lie.
    #[schemars(extend("x-min" = "0 ns"))]
    pub tolerance: Duration,
}

/// One pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Pixel {
    /// Column, counted from 0.
    pub x: u32,
    /// Row, counted from 0.
    pub y: u32,
}

impl Default for Params {
    fn default() -> Self {
        Params { pixels: Vec::new(), tolerance: Duration::new(1000) }
    }
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// The frames to judge.
        frames: FrameSequence,
        /// What they should be.
        truth: Truth,
        /// Gain and black level, which turn DN into photocurrent.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// `pixel_error_dn` and `pixel_error_v_dc`: mean absolute error over the pixels, per frame and
        /// pooled.
        scores: Arc<Table>,
        /// The pixels over time: `x`, `y`, `frame`, `t_ns`, DN and V_DC with truth and error, and V_FE with
        /// truth where the description states the front end.
        pixels: Arc<Table>,
    }
}

/// Of a pixel at an instant, a value and its truth.
type Reading = fn(&Follow) -> [f64; 2];

/// What it gives, with units.
const METRICS: [(&str, &str, Reading); 2] =
    [("pixel_error_dn", "DN", |row| row.dn), ("pixel_error_v_dc", "", |row| row.v_dc)];

/// The node.
pub struct ScorePixelError {
    params: Params,
}

impl ScorePixelError {
    fn check(
        &self,
        frames: &FramesMeta,
        truth: &FramesMeta,
        sensor: &Sensor,
    ) -> Result<Vec<(usize, usize)>, NodeError> {
        if let Some(pixel) = self
            .params
            .pixels
            .iter()
            .find(|pixel| pixel.x >= frames.extent.width || pixel.y >= frames.extent.height)
        {
            return Err(NodeError::usage(format!(
                "the pixel ({}, {}) is outside, the frames have {}",
                pixel.x, pixel.y, frames.extent
            ))
            .hint(format!("keep `x` below {}, and `y` below {}", frames.extent.width, frames.extent.height))
            .param("pixels"));
        }
        if frames.colour != Colour::Mono {
            return Err(NodeError::usage(format!(
                "the frames are {}, and V_DC is that of one photodiode",
                frames.colour
            ))
            .hint("connect grey frames"));
        }
        sensor.need_all(&[("frames.gain", sensor.frames.gain.is_some())], "score/pixel_error")?;
        match_frames(frames, truth, self.params.tolerance.ns())
    }
}

impl Node for ScorePixelError {
    const DECL: Decl = Decl {
        kind: "score/pixel_error",
        about: "Follows chosen pixels over time: DN and V_DC with the truth.",
        revision: 2,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["Jiang et al., CVPR 2024, Fig. 8, Eqs. (5) and (6)"],
        example: r#"
[nodes.pixel]
kind   = "score/pixel_error"
in     = { frames = "render", truth = "recording.truth", sensor = "sensor" }
params = { pixels = [{ x = 64, y = 48 }] }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if params.pixels.is_empty() {
            return Err(NodeError::usage("`pixels` is empty: there is nothing to follow")
                .hint("state the pixels: pixels = [{ x = 64, y = 48 }]")
                .param("pixels"));
        }
        Ok(ScorePixelError { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        self.check(inputs.frames("frames")?, inputs.truth("truth")?, inputs.sensor("sensor")?)?;
        Ok([true, false].map(|scores| Meta::Table(Arc::new(TableMeta { scores }))).to_vec())
    }

    fn metrics(_: &Params) -> Vec<String> {
        METRICS.map(|(metric, ..)| metric.into()).to_vec()
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let (frames, truth, sensor) = (&input.frames, &input.truth.0, &*input.sensor);
        let pairs = self.check(&frames.meta, &truth.meta, sensor)?;
        let gain = sensor.need(sensor.frames.gain, "frames.gain", "score/pixel_error")?;
        let black = sensor.frames.black_level_dn.unwrap_or(0.0);
        // Eq. (5) the other way round: the mean photocurrent over the exposure that the DN stands for.
        let v_dc = |dn: f64, seconds: f64| {
            if dn > black { settled_voltage((dn - black) / (gain * seconds)) } else { f64::NAN }
        };
        let follow = |&(l, j): &(usize, usize), &Pixel { x, y }: &Pixel| -> Result<Follow, NodeError> {
            let value = |frames: &FrameSequence, l: usize| -> Result<f64, NodeError> {
                let row = Rows { start: y, end: y + 1 };
                Ok(f64::from(frames.read(l..l + 1, row)?.dn[x as usize]))
            };
            let exposure = frames.meta.times.exposure(l, y);
            let (dn, dn_true) = (value(frames, l)?, value(truth, j)?);
            let there = truth.meta.times.exposure(j, y);
            let seconds =
                [scale_seconds(frames.meta.scale, exposure), scale_seconds(truth.meta.scale, there)];
            let v_dc = [v_dc(dn, seconds[0]), v_dc(dn_true, seconds[1])];
            Ok(Follow {
                pixel: Pixel { x, y },
                frame: l as i64,
                t_ns: exposure.mid().0,
                dn: [dn, dn_true],
                v_dc,
            })
        };
        cx.begin(pairs.len() as u64, "frames");
        let mut rows: Vec<Follow> = Vec::new();
        for pair in &pairs {
            for pixel in &self.params.pixels {
                rows.push(follow(pair, pixel)?);
            }
            cx.advance(1)?;
        }
        cx.count(
            rows.iter().filter(|row| row.dn[0].is_nan()).count() as u64,
            "values were not known (NaN) and left out",
        );
        cx.count(
            rows.iter().filter(|row| row.dn[0] <= black || row.dn[1] <= black).count() as u64,
            "values are at or below black and have no V_DC",
        );
        let within = self.params.tolerance;
        let matched =
            format!("{} of {} matched by middle of exposure within {within}", pairs.len(), frames.len());
        let card = self.card(matched, format!("DN as they are, black level {black} DN, gain {gain}"));
        let times: Vec<(i64, i64)> =
            pairs.iter().map(|(l, _)| (*l as i64, frames.meta.times.exposures[*l].mid().0)).collect();
        let mut scores = Vec::new();
        for (metric, unit, of) in METRICS {
            let score =
                |frame, t_ns, value| Score { metric: metric.into(), frame, t_ns, value, unit: unit.into() };
            let error = |row: &Follow| (of(row)[0] - of(row)[1]).abs();
            let each: Vec<f64> = rows
                .chunks(self.params.pixels.len())
                .map(|rows| mean_of_measured(&rows.iter().map(error).collect::<Vec<_>>()))
                .collect();
            scores.extend(times.iter().zip(&each).map(|((frame, t_ns), value)| score(*frame, *t_ns, *value)));
            scores.push(score(-1, 0, mean_of_measured(&each)));
        }
        Ok(Out {
            scores: Arc::new(Table::scores(scores, card)),
            pixels: Arc::new(self.followed(&rows, sensor)),
        })
    }
}

/// One pixel in one frame; of DN and V_DC the frame's and the true one.
struct Follow {
    pixel: Pixel,
    frame: i64,
    t_ns: i64,
    dn: [f64; 2],
    v_dc: [f64; 2],
}

impl ScorePixelError {
    fn card(&self, frames: String, range: String) -> Card {
        let name = |pixel: &Pixel| format!("pixel ({}, {})", pixel.x, pixel.y);
        Card {
            definition: "pixel_error.v1",
            channel: "linear DN, and V_DC = ln i with i = (DN - black) / (gain x exposure)".into(),
            range,
            border: "none".into(),
            frames,
            region: self.params.pixels.iter().map(name).collect::<Vec<_>>().join(" and "),
            weights: None,
            backend: OWN.into(),
            pooled: MEAN.into(),
            more: vec![("error", "absolute, mean over the pixels".into())],
        }
    }

    fn followed(&self, rows: &[Follow], sensor: &Sensor) -> Table {
        let table = followed(rows);
        if sensor.front_end.tau_0.is_none() || sensor.front_end.alpha.is_none() {
            return table;
        }
        let front_end = Model::of(sensor).pixel.front_end;
        let column = |which: usize| {
            Column::Numbers(front_end_voltages(rows, which, self.params.pixels.len(), &front_end))
        };
        table.with("v_fe", column(0)).with("v_fe_true", column(1))
    }
}

/// V_FE of every row, of the frames (`which` 0) or the true ones (1): it starts settled, and holds while V_DC
/// is not known. `pixels` rows are of one frame.
fn front_end_voltages(rows: &[Follow], which: usize, pixels: usize, front_end: &FrontEnd<f64>) -> Vec<f64> {
    let mut voltages = vec![f64::NAN; rows.len()];
    for first in 0..pixels {
        let mut last: Option<(i64, f64)> = None;
        for at in (first..rows.len()).step_by(pixels) {
            let (t_ns, settled) = (rows[at].t_ns, rows[at].v_dc[which]);
            if settled.is_nan() {
                continue;
            }
            voltages[at] = last.map_or(settled, |(before_ns, voltage)| {
                settle(
                    voltage,
                    settled,
                    (t_ns - before_ns) as f64 * 1e-9,
                    time_constant(front_end, settled_photocurrent(settled)),
                )
            });
            last = Some((t_ns, voltages[at]));
        }
    }
    voltages
}

fn followed(rows: &[Follow]) -> Table {
    let integers = |value: fn(&Follow) -> i64| Column::Integers(rows.iter().map(value).collect());
    let numbers = |value: fn(&Follow) -> f64| Column::Numbers(rows.iter().map(value).collect());
    Table::default()
        .with("x", integers(|row| row.pixel.x.into()))
        .with("y", integers(|row| row.pixel.y.into()))
        .with("frame", integers(|row| row.frame))
        .with("t_ns", integers(|row| row.t_ns))
        .with("dn", numbers(|row| row.dn[0]))
        .with("dn_true", numbers(|row| row.dn[1]))
        .with("dn_error", numbers(|row| row.dn[0] - row.dn[1]))
        .with("v_dc", numbers(|row| row.v_dc[0]))
        .with("v_dc_true", numbers(|row| row.v_dc[1]))
        .with("v_dc_error", numbers(|row| row.v_dc[0] - row.v_dc[1]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Exposure, Extent, testing};

    const EXTENT: Extent = Extent { width: 4, height: 3 };

    fn sensor() -> Sensor {
        let mut sensor = Sensor::unknown("test");
        (sensor.frames.gain, sensor.frames.black_level_dn) = (Some(1000.0), Some(10.0));
        sensor
    }

    /// Two exposures of 10 ms, 1 ms from row to row.
    fn frames(dn: impl FnMut(usize, u32, u32) -> f32) -> FrameSequence {
        testing::captured(
            EXTENT,
            vec![Exposure::new(0, 10_000_000), Exposure::new(20_000_000, 30_000_000)],
            1_000_000,
            dn,
        )
    }

    fn node(pixels: &[(u32, u32)]) -> ScorePixelError {
        ScorePixelError {
            params: Params {
                pixels: pixels.iter().map(|&(x, y)| Pixel { x, y }).collect(),
                ..Params::default()
            },
        }
    }

    fn run(
        pixels: &[(u32, u32)],
        given: FrameSequence,
        truth: FrameSequence,
    ) -> Result<(Out, Vec<String>), NodeError> {
        let input = In { frames: given, truth: Truth(truth), sensor: Arc::new(sensor()) };
        let (out, notes) =
            testing::with_context(EXTENT.rows(), &["scores", "pixels"], |cx| node(pixels).run(input, cx));
        Ok((out?, notes))
    }

    fn numbers(table: &Table, column: &str) -> Vec<f64> {
        match table.column(column) {
            Some(Column::Numbers(cells)) => cells.clone(),
            other => panic!("{column}: {other:?}"),
        }
    }

    #[test]
    fn the_voltage_is_the_logarithm_of_the_light_above_black() {
        // 30 DN are 20 above black: 20 / (1000 x 10 ms) = 2; the truth's 50 DN are 4. Their logarithms differ
        // by ln 2.
        let (out, _) = run(
            &[(1, 2)],
            frames(|l, x, y| if (l, x, y) == (1, 1, 2) { 30.0 } else { 50.0 }),
            frames(|_, _, _| 50.0),
        )
        .unwrap();
        let (v_dc, error) = (numbers(&out.pixels, "v_dc"), numbers(&out.pixels, "v_dc_error"));
        assert!(
            (v_dc[0] - 2.0 * std::f64::consts::LN_2).abs() < 1e-12
                && (v_dc[1] - std::f64::consts::LN_2).abs() < 1e-12,
            "{v_dc:?}"
        );
        assert!(error[0] == 0.0 && (error[1] + std::f64::consts::LN_2).abs() < 1e-12, "{error:?}");
        assert_eq!(numbers(&out.pixels, "dn_error"), [0.0, -20.0]);
        // Row 2 is exposed 2 ms later than row 0.
        assert_eq!(out.pixels.column("t_ns"), Some(&Column::Integers(vec![7_000_000, 27_000_000])));
        let scores = out.scores.as_scores().unwrap();
        assert_eq!(
            scores[..3].iter().map(|s| (s.frame, s.value)).collect::<Vec<_>>(),
            [(0, 0.0), (1, 20.0), (-1, 10.0)]
        );
        assert!((scores[5].value - std::f64::consts::LN_2 / 2.0).abs() < 1e-12);
    }

    #[test]
    fn the_front_end_follows_a_step_by_one_part_in_e_after_one_time_constant() {
        use photocurrent_core::quantity::Duration;
        let mut sensor = sensor();
        // Middles lie 20 ms apart; at a photocurrent of 4, tau = 5 ms + 60 ms / 4 = 20 ms.
        (sensor.front_end.tau_0, sensor.front_end.alpha) =
            (Some(Duration::new(5_000_000)), Some(Duration::new(60_000_000)));
        let step = frames(|l, _, _| [30.0, 50.0][l]);
        let input = In { frames: frames(|_, _, _| 50.0), truth: Truth(step), sensor: Arc::new(sensor) };
        let (out, _) = testing::with_context(EXTENT.rows(), &["scores", "pixels"], |cx| {
            node(&[(1, 2), (0, 0)]).run(input, cx)
        });
        let pixels = out.unwrap().pixels;
        let (low, high) = (std::f64::consts::LN_2, 2.0 * std::f64::consts::LN_2);
        let expected =
            [low, low, high - (high - low) / std::f64::consts::E, high - (high - low) / std::f64::consts::E];
        assert!(
            numbers(&pixels, "v_fe").iter().all(|voltage| (voltage - high).abs() < 1e-12),
            "still light stays settled"
        );
        let found = numbers(&pixels, "v_fe_true");
        assert!(
            found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-12),
            "{found:?}"
        );
    }

    #[test]
    fn what_is_not_known_or_not_above_black_is_counted() {
        let (out, notes) = run(
            &[(0, 0), (1, 0)],
            frames(|_, x, _| if x == 0 { f32::NAN } else { 10.0 }),
            frames(|_, _, _| 50.0),
        )
        .unwrap();
        assert_eq!(out.scores.as_scores().unwrap()[0].value, 40.0, "of the known pixel");
        assert_eq!(
            notes,
            ["2 values are at or below black and have no V_DC", "2 values were not known (NaN) and left out"]
        );
        assert!(out.scores.as_scores().unwrap()[5].value.is_nan());
    }

    #[test]
    fn pixels_outside_no_pixels_and_other_sizes_are_refused() {
        let same = || frames(|_, _, _| 50.0);
        let error = run(&[(1, 1), (4, 0)], same(), same()).err().unwrap();
        assert_eq!(
            (error.message.as_str(), error.param.as_deref()),
            ("the pixel (4, 0) is outside, the frames have 4 x 3", Some("pixels"))
        );
        assert!(
            ScorePixelError::build(Params::default()).err().unwrap().message.contains("`pixels` is empty")
        );
        let other = testing::captured(
            Extent { width: 5, height: 3 },
            vec![Exposure::new(0, 10_000_000)],
            1_000_000,
            |_, _, _| 0.0,
        );
        assert!(run(&[(1, 1)], same(), other).err().unwrap().message.contains("the reference is 5 x 3"));
        let error = node(&[(1, 1)]).check(&same().meta, &same().meta, &Sensor::unknown("test")).unwrap_err();
        assert!(format!("{error}").contains("frames.gain"), "{error}");
    }
}
