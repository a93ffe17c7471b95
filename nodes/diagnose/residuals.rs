//! `diagnose/residuals`: what the described sensor makes of estimated light, against the recording, event by event and frame value by frame value.
//!
//! Each recorded event is paired with the nearest simulated one of its pixel and polarity; what is left over is extra (recorded only) or missing (simulated only).
//! Intervals between events are rescaled exactly: with the right sensor and light, `uniform` is uniform between 0 and 1.
//!
//! Source: the time-rescaling theorem (Brown et al., Neural Computation 14, 2002). Limits: the light was fitted to the same events, so hold the residuals against those
//! of a control (`diagnose/synthesize`, fitted alike).

use photocurrent_core::table::{Column, Score, TableMeta};
use photocurrent_core::{Context, Decl, EventStream, FrameSequence, Grain, Meta, Node, NodeError, PortMetas, Sensor, Table, TrackSet};
use photocurrent_diagnosis::differences::{EventDifference, Fate, FrameDifference};
use photocurrent_diagnosis::light::from_tracks;
use photocurrent_diagnosis::residuals::{Residuals, residuals};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `diagnose/residuals`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Standard deviation of the threshold at each reset that intervals are rescaled with, natural-log units; absent = what is stated, or a tenth of the ON threshold.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub threshold_sigma: Option<f64>,
}

photocurrent_core::ports! {
    /// The recording, its light, and what is stated of its sensor.
    pub struct In {
        /// The events.
        events: EventStream,
        /// The frames as captured, grey, of the events' pixels.
        frames: FrameSequence,
        /// The description that is held against them.
        sensor: Arc<Sensor>,
        /// The light, such as that of diagnose/fit.
        tracks: TrackSet,
    }
}

photocurrent_core::ports! {
    /// The residuals.
    pub struct Out {
        /// One row an event: `x`, `y`, `t_ns`, `polarity`, `fate` (`paired`, `extra`, `missing`), `delay_s` (recorded less simulated; NaN of no pair).
        events: Arc<Table>,
        /// One row a frame value: `x`, `y`, `frame`, `t_ns`, `log_ratio` (of recorded over simulated signal).
        frames: Arc<Table>,
        /// One row an interval: `x`, `y`, `armed_ns`, `end_ns`, `fired` (0 = the silent end), `compensator`, `uniform`, `mark`.
        intervals: Arc<Table>,
        /// Pooled: `extra` and `missing`, %, `delay` and `delay_spread`, us, `frame_log_ratio`, `ks`, `expected_over_recorded`.
        scores: Arc<Table>,
    }
}

/// The node.
pub struct DiagnoseResiduals {
    params: Params,
}

impl Node for DiagnoseResiduals {
    const DECL: Decl = Decl {
        kind: "diagnose/residuals",
        about: "Holds what the described sensor makes of estimated light against the recording: events, frame values, rescaled intervals.",
        revision: 1,
        grain: Grain::Whole,
        draws: true,
        exports: false,
        sources: &["docs/diagnosis.md", "E. N. Brown et al., The time-rescaling theorem, Neural Computation 14, 2002"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.fit]
kind = "diagnose/fit"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }

[nodes.residuals]
kind = "diagnose/residuals"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor", tracks = "fit.tracks" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(DiagnoseResiduals { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        super::empty(inputs)?;
        Ok([false, false, false, true].map(|scores| Meta::Table(Arc::new(TableMeta { scores }))).to_vec())
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let case = super::case(Some(&input.events), Some(&input.frames), &input.sensor)?;
        let nominal = case.nominal()?;
        let (sample, scene) = from_tracks(&case, &input.tracks)?;
        let found = residuals(&case, &nominal, &sample, &scene, self.params.threshold_sigma, cx.seed()).map_err(NodeError::failed)?;
        let width = case.extent.width;
        Ok(Out {
            events: Arc::new(write_events(&found.events, width)),
            frames: Arc::new(write_frames(&found.frames, width)),
            intervals: Arc::new(write_intervals(&found, width)),
            scores: Arc::new(scores(&found)),
        })
    }
}

/// A table that begins with the places of pixels.
fn placed(pixels: impl Iterator<Item = u32> + Clone, width: u32) -> Table {
    Table::default()
        .with("x", Column::Integers(pixels.clone().map(|pixel| i64::from(pixel % width)).collect()))
        .with("y", Column::Integers(pixels.map(|pixel| i64::from(pixel / width)).collect()))
}

fn write_events(events: &[EventDifference], width: u32) -> Table {
    let fate = |event: &EventDifference| match event.fate {
        Fate::Paired(_) => "paired".to_owned(),
        Fate::Extra => "extra".to_owned(),
        Fate::Missing => "missing".to_owned(),
    };
    let delay = |event: &EventDifference| if let Fate::Paired(by_ns) = event.fate { by_ns as f64 * 1e-9 } else { f64::NAN };
    placed(events.iter().map(|event| event.pixel), width)
        .with("t_ns", Column::Integers(events.iter().map(|event| event.t_ns).collect()))
        .with("polarity", Column::Integers(events.iter().map(|event| event.polarity.into()).collect()))
        .with("fate", Column::Texts(events.iter().map(fate).collect()))
        .with("delay_s", Column::Numbers(events.iter().map(delay).collect()))
}

fn write_frames(frames: &[FrameDifference], width: u32) -> Table {
    placed(frames.iter().map(|frame| frame.pixel), width)
        .with("frame", Column::Integers(frames.iter().map(|frame| frame.frame.into()).collect()))
        .with("t_ns", Column::Integers(frames.iter().map(|frame| frame.t_ns).collect()))
        .with("log_ratio", Column::Numbers(frames.iter().map(|frame| frame.log_ratio).collect()))
}

fn write_intervals(found: &Residuals, width: u32) -> Table {
    let all = &found.intervals;
    placed(all.iter().map(|(pixel, _)| *pixel), width)
        .with("armed_ns", Column::Integers(all.iter().map(|(_, interval)| interval.armed_ns).collect()))
        .with("end_ns", Column::Integers(all.iter().map(|(_, interval)| interval.end_ns).collect()))
        .with("fired", Column::Integers(all.iter().map(|(_, interval)| interval.event.is_some().into()).collect()))
        .with("compensator", Column::Numbers(all.iter().map(|(_, interval)| interval.compensator).collect()))
        .with("uniform", Column::Numbers(all.iter().map(|(_, interval)| interval.uniform).collect()))
        .with("mark", Column::Numbers(all.iter().map(|(_, interval)| interval.mark).collect()))
}

fn scores(found: &Residuals) -> Table {
    let digested = found.digested();
    let pooled = |(metric, value, unit): (&str, f64, &str)| Score { metric: metric.into(), frame: -1, t_ns: 0, value, unit: unit.into() };
    let scores = [
        ("extra", 100.0 * digested.extra, "%"),
        ("missing", 100.0 * digested.missing, "%"),
        ("delay", 1e6 * digested.delay_s, "us"),
        ("delay_spread", 1e6 * digested.delay_spread_s, "us"),
        ("frame_log_ratio", digested.frame_log_ratio, ""),
        ("ks", digested.ks, ""),
        ("expected_over_recorded", digested.expected_over_recorded, ""),
    ];
    let card = "residuals.v1: pairs within 1 ms, between first and last exposure; delay and delay_spread = medians; frame_log_ratio = root mean square; \
                ks = distance of rescaled intervals from uniform";
    Table::scores(scores.map(pooled).to_vec(), card)
}

/// Residuals of events as [`write_events`] wrote them; `port` names where they stand.
pub(super) fn read_events(table: &Table, width: u32, port: &str) -> Result<Vec<EventDifference>, NodeError> {
    let columns = (table.column("x"), table.column("y"), table.column("t_ns"), table.column("polarity"), table.column("fate"), table.column("delay_s"));
    let (
        Some(Column::Integers(x)),
        Some(Column::Integers(y)),
        Some(Column::Integers(t_ns)),
        Some(Column::Integers(polarity)),
        Some(Column::Texts(fate)),
        Some(Column::Numbers(delay)),
    ) = columns
    else {
        return Err(not_residuals(port, "events"));
    };
    let one = |k: usize| {
        let fate = match fate[k].as_str() {
            "paired" => Fate::Paired((delay[k] * 1e9).round() as i64),
            "extra" => Fate::Extra,
            "missing" => Fate::Missing,
            other => return Err(NodeError::input(format!("`{port}` has the fate `{other}`, and there are `paired`, `extra` and `missing`"))),
        };
        Ok(EventDifference { pixel: pixel(x[k], y[k], width, port)?, t_ns: t_ns[k], polarity: if polarity[k] > 0 { 1 } else { -1 }, fate })
    };
    (0..x.len()).map(one).collect()
}

/// Residuals of frames as [`write_frames`] wrote them.
pub(super) fn read_frames(table: &Table, width: u32, port: &str) -> Result<Vec<FrameDifference>, NodeError> {
    let columns = (table.column("x"), table.column("y"), table.column("frame"), table.column("t_ns"), table.column("log_ratio"));
    let (Some(Column::Integers(x)), Some(Column::Integers(y)), Some(Column::Integers(frame)), Some(Column::Integers(t_ns)), Some(Column::Numbers(log_ratio))) =
        columns
    else {
        return Err(not_residuals(port, "frames"));
    };
    let one = |k: usize| Ok(FrameDifference { pixel: pixel(x[k], y[k], width, port)?, frame: frame[k] as u32, t_ns: t_ns[k], log_ratio: log_ratio[k] });
    (0..x.len()).map(one).collect()
}

fn pixel(x: i64, y: i64, width: u32, port: &str) -> Result<u32, NodeError> {
    let inside = (0..i64::from(width)).contains(&x).then(|| u32::try_from(y * i64::from(width) + x).ok()).flatten();
    inside.ok_or_else(|| NodeError::input(format!("`{port}` names the pixel ({x}, {y}), and the array is {width} pixels wide")))
}

fn not_residuals(port: &str, output: &str) -> NodeError {
    NodeError::input(format!("`{port}` is no table of residuals")).hint(format!("connect the output `{output}` of diagnose/residuals"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn residuals_come_back_from_their_tables() {
        let event = |pixel, fate| EventDifference { pixel, t_ns: 7_000_001, polarity: -1, fate };
        let events = vec![event(3, Fate::Paired(-12_345)), event(25, Fate::Extra), event(119, Fate::Missing)];
        assert_eq!(read_events(&write_events(&events, 12), 12, "events").unwrap(), events);
        let frames = vec![FrameDifference { pixel: 14, frame: 2, t_ns: -5, log_ratio: 0.1 + 0.2 }];
        assert_eq!(read_frames(&write_frames(&frames, 12), 12, "frames").unwrap(), frames);
        assert!(read_events(&write_frames(&frames, 12), 12, "residuals").unwrap_err().message.contains("`residuals` is no table"));
        assert!(read_frames(&write_frames(&frames, 12), 2, "residuals").unwrap_err().message.contains("names the pixel (2, 1)"));
    }

    #[test]
    fn a_table_of_no_residuals_is_known_by_its_fate() {
        let table = write_events(&[EventDifference { pixel: 0, t_ns: 0, polarity: 1, fate: Fate::Extra }], 12);
        assert_eq!(table.column("fate"), Some(&Column::Texts(vec!["extra".into()])));
        assert!(matches!(table.column("delay_s"), Some(Column::Numbers(delay)) if delay[0].is_nan()));
    }
}
