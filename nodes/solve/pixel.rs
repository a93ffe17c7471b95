//! `solve/pixel`: the photocurrent of every pixel that explains its events and its frame values.
//!
//! Idea: a pixel's frames say how much light it collected, its events when the light changed, both through the sensor's own
//! delays. Inverting the sensor pixel by pixel undoes blur, rolling shutter and event latency at once. Each pixel is one small least-squares
//! problem; this node cuts a recording into such problems and puts the answers together.
//!
//! `method = "map"` asks for the most probable light ([`photocurrent_sensor::map`]): all frames and events of the pixel at once, with knots that are finer
//! than the events, the exact reset and a prior. Nothing is cut into windows there, and its tracks are log-linear between knots.
//!
//! `method = "paper"` is Eq. (13), solved in [`photocurrent_sensor::inverse`], with the approximations that the paper makes. Frames are taken two by two, as in the paper: the pair (l, l+1) is solved with all events from the start of exposure l to
//! the end of exposure l+1, and its answer counts until exposure l+1 starts. The first window reaches back to the recording's start, the
//! last one on to its end. `frames = "all"` solves one problem over the whole recording instead.
//!
//! Limits: grey frames at the events' resolution. A saturated value counts as the light of saturation, which is a lower bound. A pixel whose
//! problem does not converge gets the safe estimate (a double integral) and is counted; the `map` output shows where.

mod map;
#[cfg(test)]
mod tests;

use crate::compensate::readout::check_events;
use crate::pixel_events::{Stamp, StepRule, clock_offset, left_out};
use map::FrameNoise;
use photocurrent_core::events::{EventRow, PixelIndex};
use photocurrent_core::handle::Band;
use photocurrent_core::quantity::Duration;
use photocurrent_core::sensor::Reset;
use photocurrent_core::{
    Between, Context, Decl, EventStream, EventsMeta, Exposure, FrameBlock, FrameScale, FrameSequence, FramesMeta, Grain, MapBand, MapMeta, MapSet, Meta, Node,
    NodeError, PortMetas, Rows, Sensor, TrackBand, TrackSet, TracksMeta,
};
use photocurrent_sensor::front_end::{FrontEnd, TauRule};
use photocurrent_sensor::inverse::{FrameSample, PixelProblem, SolveOptions, Workspace, solve};
use photocurrent_sensor::readout::compensated_step;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What is solved for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// The paper's least squares: one unknown per event, held between events.
    #[default]
    Paper,
    /// The most probable light: fine knots, exact reset, all frames at once, and a prior.
    Map,
}

/// How the front end's delay is treated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FrontEndModel {
    /// No delay: V_FE = V_DC, tau = 0 in Eq. (7).
    Ideal,
    /// A first-order low-pass with tau = tau_0 + alpha / i_pd, Eqs. (1)-(3).
    #[default]
    LowPass,
}

/// How readout latency and refractory period are treated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ReadoutModel {
    /// Not at all: Eq. (8).
    None,
    /// By the local slope: Eqs. (9)-(12).
    #[default]
    Slope,
}

/// Which photocurrent sets the time constant of an interval.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TauChoice {
    /// The one at its start, as Eqs. (2) and (3) are printed.
    Start,
    /// The one at its end, which drives the voltage in Eq. (1): better at every steep edge.
    #[default]
    End,
}

/// Which frames are solved together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Joint {
    /// Two consecutive frames at a time.
    #[default]
    Pairs,
    /// All frames of the recording at once.
    All,
}

/// Where the first unknown of a window stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FirstKnot {
    /// At the window's start, so that the first event's step counts too.
    #[default]
    Window,
    /// At the first event, as printed: its step is not used.
    Event,
}

/// Parameters of `solve/pixel`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// What is solved for. `map` uses `front_end`, `event_noise`, `frame_noise`, `knot_spacing` and `max_iterations`; `paper` all but `event_noise`, `frame_noise`
    /// and `knot_spacing`.
    pub method: Method,
    /// Standard deviation of an event as a part of its threshold, for `map`; absent = chosen for each row so that frames
    /// that are kept back are predicted best.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub event_noise: Option<f64>,
    /// Part of a frame value that is not believed, for `map`, beside the noise that the sensor description states and 1 DN.
    #[schemars(range(min = 0.0))]
    pub frame_noise: f64,
    /// Knots lie at most this far apart, for `map`.
    #[schemars(extend("x-min" = "10 us"))]
    pub knot_spacing: Duration,
    /// How the front end's delay is treated.
    pub front_end: FrontEndModel,
    /// How readout latency and refractory period are treated. `slope` needs in-pixel times.
    pub readout: ReadoutModel,
    /// Which photocurrent sets the time constant of an interval.
    pub tau_rule: TauChoice,
    /// Which frames are solved together.
    pub frames: Joint,
    /// Where the first unknown of a window stands.
    pub first_knot: FirstKnot,
    /// Weight of a squared frame residual, per DN^2; the paper sets 1.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub cis_weight: f64,
    /// Weight of a squared event residual, per natural-log unit squared; the paper sets 1.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub evs_weight: f64,
    /// Most steps tried for one problem; `map` never takes more than 5: more make it follow its own estimate.
    #[schemars(range(min = 1, max = 10000))]
    pub max_iterations: u32,
}

impl Default for Params {
    fn default() -> Self {
        Params {
            method: Method::Paper,
            event_noise: None,
            frame_noise: 0.02,
            knot_spacing: Duration::new(250_000),
            front_end: FrontEndModel::LowPass,
            readout: ReadoutModel::Slope,
            tau_rule: TauChoice::End,
            frames: Joint::Pairs,
            first_knot: FirstKnot::Window,
            cis_weight: 1.0,
            evs_weight: 1.0,
            max_iterations: 100,
        }
    }
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Events; in-pixel times when `readout = "slope"`.
        events: EventStream,
        /// Captured frames of the same pixels; at least one.
        frames: FrameSequence,
        /// Thresholds, gain, and what the chosen models need.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// Photocurrent of every pixel over time.
        tracks: TrackSet,
        /// How the solution went: planes `status` (0 converged, 1 safe estimate, 2 saturated, 3 no usable frame), `iterations` (largest), `cost` (sum).
        map: MapSet,
    }
}

/// The node.
pub struct SolvePixel {
    params: Params,
}

/// How a pixel came out, worst window counting.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Status {
    Converged = 0,
    SafeEstimate = 1,
    Saturated = 2,
    NoFrame = 3,
}

/// More steps than this do not improve a pixel of `method = "map"`.
const MAP_STEPS: usize = 5;

const PLANES: [&str; 3] = ["status", "iterations", "cost"];

/// Everything about the sensor that one pixel's problem needs, checked once.
struct Model {
    rule: StepRule,
    front_end: FrontEnd,
    refractory_s: f64,
    refractory_ns: i64,
    reset: Reset,
    clock_offset_ns: i64,
    /// Standard deviation of an event's stamp, from the width of its interval.
    stamp_sigma_s: f64,
    frame_noise: FrameNoise,
    gain: f64,
    black_level: f64,
    saturation_dn: f64,
}

impl SolvePixel {
    fn model(&self, sensor: &Sensor, events: &EventsMeta) -> Result<Model, NodeError> {
        const WHO: &str = "solve/pixel";
        // A model that the description cannot feed can be left away, so its refusal says how.
        let or_without = |error: NodeError, param: &str, without: &str| {
            let added = error.hint.clone().unwrap_or_default();
            error.hint(format!("{added}, or set `{param} = \"{without}\"`")).param(param)
        };
        let front_end = match self.params.front_end {
            FrontEndModel::Ideal => FrontEnd::IDEAL,
            FrontEndModel::LowPass => {
                const LOW_PASS: &str = "`front_end = \"low_pass\"`";
                let (tau_0, alpha) = (sensor.front_end.tau_0, sensor.front_end.alpha);
                let fields = [("front_end.tau_0", tau_0.is_some()), ("front_end.alpha", alpha.is_some())];
                sensor.need_all(&fields, LOW_PASS).map_err(|error| or_without(error, "front_end", "ideal"))?;
                FrontEnd {
                    tau_0_s: sensor.need(tau_0, "front_end.tau_0", LOW_PASS)?.seconds(),
                    alpha_s: sensor.need(alpha, "front_end.alpha", LOW_PASS)?.seconds(),
                }
            }
        };
        let refractory_s = match (self.params.method, self.params.readout) {
            (Method::Map, _) => {
                const MAP: &str = "`method = \"map\"`";
                if events.has_step {
                    return Err(NodeError::usage("the events carry compensated steps, and `method = \"map\"` undoes the readout itself")
                        .hint("connect the events as recorded, or set `method = \"paper\"`")
                        .param("method"));
                }
                sensor.need(sensor.readout.refractory, "readout.refractory", MAP).map_err(|error| or_without(error, "method", "paper"))?.seconds()
            }
            (Method::Paper, ReadoutModel::None) => 0.0,
            (Method::Paper, ReadoutModel::Slope) => {
                const SLOPE: &str = "`readout = \"slope\"`";
                check_events(events, SLOPE, "set `readout = \"none\"`").map_err(|error| error.param("readout"))?;
                sensor.need(sensor.readout.refractory, "readout.refractory", SLOPE).map_err(|error| or_without(error, "readout", "none"))?.seconds()
            }
        };
        sensor.need_all(&[StepRule::needs(sensor).as_slice(), &[("frames.gain", sensor.frames.gain.is_some())]].concat(), WHO)?;
        Ok(Model {
            rule: StepRule::from_sensor(sensor, events, Stamp::Best, WHO)?,
            front_end,
            refractory_s,
            refractory_ns: (refractory_s * 1e9).round() as i64,
            reset: sensor.comparator.reset,
            clock_offset_ns: clock_offset(sensor)?.offset_ns,
            stamp_sigma_s: events.t_resolution_ns.unwrap_or(0) as f64 * 1e-9 / libm::sqrt(12.0),
            frame_noise: FrameNoise::new(sensor, self.params.frame_noise),
            gain: sensor.need(sensor.frames.gain, "frames.gain", WHO)?,
            black_level: sensor.frames.black_level_dn.unwrap_or(0.0),
            saturation_dn: sensor.frames.saturation_dn.unwrap_or(f64::INFINITY),
        })
    }

    fn tracks_meta(&self, events: &EventsMeta, frames: &FramesMeta) -> Result<TracksMeta, NodeError> {
        if events.extent != frames.extent {
            return Err(NodeError::usage(format!("events are {}, frames are {}", events.extent, frames.extent))
                .hint("frames and events must come from the same pixels"));
        }
        if frames.channels != 1 {
            return Err(NodeError::usage(format!("frames have {} channels; solve/pixel takes grey frames", frames.channels)));
        }
        if frames.scale != FrameScale::Captured {
            return Err(
                NodeError::usage("frames are rendered, not captured: their values do not belong to their exposures").hint("connect the recording's frames")
            );
        }
        let (Some(covered), Some(nominal_exposure_ns)) = (frames.times.span(frames.extent.height), frames.times.nominal_exposure_ns()) else {
            return Err(NodeError::usage("there is no frame, and events alone leave the photocurrent's level open").hint("give at least one frame"));
        };
        Ok(TracksMeta {
            extent: events.extent,
            span: events.span.map_or(covered, |span| span.union(covered)),
            nominal_exposure_ns,
            between: match self.params.method {
                Method::Paper => Between::Hold,
                Method::Map => Between::LogLinear,
            },
            count_hint: events.count_hint.map(|n| match self.params.method {
                Method::Paper => 2 * n + (frames.times.len() * frames.extent.pixels()) as u64,
                Method::Map => 4 * n + 8 * (frames.times.len() * frames.extent.pixels()) as u64,
            }),
        })
    }
}

impl Node for SolvePixel {
    const DECL: Decl = Decl {
        kind: "solve/pixel",
        about: "Solves for the photocurrent of every pixel from its events and frame values.",
        revision: 2,
        grain: Grain::Pixel,
        draws: false,
        exports: false,
        sources: &["Jiang et al., CVPR 2024, Eqs. (1)-(13) and section 4.1"],
        example: r#"
[nodes.solve]
kind   = "solve/pixel"
in     = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }
params = { front_end = "low_pass", readout = "slope", cis_weight = 1.0, evs_weight = 1.0 }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(SolvePixel { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let (events, frames) = (inputs.events("events")?, inputs.frames("frames")?);
        self.model(inputs.sensor("sensor")?, events)?;
        let tracks = self.tracks_meta(events, frames)?;
        let map = map_meta(tracks.extent);
        Ok(vec![Meta::Tracks(Arc::new(tracks)), Meta::Map(Arc::new(map))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let meta = self.tracks_meta(&input.events.meta, &input.frames.meta)?;
        let model = self.model(&input.sensor, &input.events.meta)?;
        let mut used = (*input.sensor).clone();
        if self.params.method == Method::Map {
            // The reset law is modelled there.
            used.comparator.reset = Reset::Resample;
        }
        if let Some(note) = left_out(&used) {
            cx.note(note);
        }
        let rows = cx.rows();
        cx.begin(rows.len() as u64, "rows");
        let events = input.events.read(rows)?;
        let frames = input.frames.read_rows(rows)?;
        let solve_row = |(workspace, finer): &mut (RowSolver, map::RowSolver), row: u32| -> Result<(TrackBand, MapBand), NodeError> {
            let exposures: Vec<Exposure> = (0..input.frames.len()).map(|l| input.frames.meta.times.exposure(l, row)).collect();
            let band = match self.params.method {
                Method::Paper => workspace.row(&self.params, &model, &meta, row, events.row(row), &frames, &exposures)?,
                Method::Map => finer.row(&self.params, &model, &meta, row, events.row(row), &frames, &exposures),
            };
            cx.advance(1)?;
            Ok(band)
        };
        let solved: Result<Vec<_>, NodeError> = rows.iter().into_par_iter().map_init(Default::default, solve_row).collect();
        let (tracks, maps): (Vec<TrackBand>, Vec<MapBand>) = solved?.into_iter().unzip();
        let map = MapBand::concat(maps);
        report(&map, cx);
        Ok(Out { tracks: TrackSet::in_memory(Arc::new(meta.clone()), TrackBand::concat(tracks)), map: MapSet::in_memory(Arc::new(map_meta(meta.extent)), map) })
    }
}

fn map_meta(extent: photocurrent_core::Extent) -> MapMeta {
    MapMeta { extent, planes: PLANES.map(String::from).to_vec() }
}

fn report(map: &MapBand, cx: &Context) {
    let pixels = |status: Status| map.rows().iter().flat_map(|row| map.row(0, row)).filter(|value| **value == status as u8 as f32).count() as u64;
    cx.count(pixels(Status::SafeEstimate), "pixels did not converge in some window and carry the safe estimate there");
    cx.count(pixels(Status::Saturated), "pixels were saturated in every frame of some window: their light is a lower bound there");
    cx.count(pixels(Status::NoFrame), "pixels had no usable frame value in some window (NaN): they hold their last known light there");
}

/// Solves the pixels of a row; keeps its memory from row to row.
#[derive(Default)]
struct RowSolver {
    workspace: Workspace,
    event_t: Vec<i64>,
    event_step: Vec<f64>,
    t_s: Vec<f64>,
    steps: Vec<f64>,
    samples: Vec<FrameSample>,
    knots: Vec<(i64, f32)>,
}

impl RowSolver {
    fn row(
        &mut self,
        params: &Params,
        model: &Model,
        meta: &TracksMeta,
        row: u32,
        events: EventRow,
        frames: &FrameBlock,
        exposures: &[Exposure],
    ) -> Result<(TrackBand, MapBand), NodeError> {
        let index = events.by_pixel(meta.extent.width);
        let mut tracks = TrackBand::begin(row, meta.extent.width);
        let mut map = MapBand::zeros(Rows { start: row, end: row + 1 }, &map_meta(meta.extent));
        let windows = windows(params.frames, exposures, meta);
        for x in 0..meta.extent.width as usize {
            self.take_events(params, model, &events, &index, x);
            self.knots.clear();
            let (mut worst, mut iterations, mut cost) = (Status::Converged, 0, 0.0);
            for window in &windows {
                let (status, tried, residual) = self.window(params, model, window, exposures, |l| frames.row(l, row)[x])?;
                worst = worst.max(status);
                iterations = iterations.max(tried);
                cost += residual;
            }
            tracks.push(self.knots.iter().copied());
            for (plane, value) in [worst as u8 as f32, iterations as f32, cost as f32].into_iter().enumerate() {
                map.row_mut(plane, row)[x] = value;
            }
        }
        Ok((tracks, map))
    }

    /// The pixel's events as times and steps; compensated ones when asked.
    fn take_events(&mut self, params: &Params, model: &Model, events: &EventRow, index: &PixelIndex, x: usize) {
        self.event_t.clear();
        self.event_step.clear();
        let mut before: Option<usize> = None;
        for &k in index.pixel(x) {
            let (t, plain) = (model.rule.time(events, k), model.rule.step(events, k));
            let step = match (params.readout, before) {
                (ReadoutModel::Slope, Some(before)) => {
                    let since = |t: i64| (t - model.rule.time(events, before)) as f64 * 1e-9;
                    compensated_step(plain, 0.0, since(events.t[before] - model.rule.shift_ns), since(t), model.refractory_s)
                }
                _ => plain,
            };
            // Two events at one instant are one step of their sum: stamps are quantised, and knots must differ.
            match self.event_t.last() {
                Some(&last) if t <= last => *self.event_step.last_mut().expect("as long as the times") += step,
                _ => {
                    self.event_t.push(t);
                    self.event_step.push(step);
                }
            }
            before = Some(k);
        }
    }

    /// Solves one window and appends its knots; returns (status, iterations, cost).
    fn window(
        &mut self,
        params: &Params,
        model: &Model,
        window: &Window,
        exposures: &[Exposure],
        dn: impl Fn(usize) -> f32,
    ) -> Result<(Status, usize, f64), NodeError> {
        let origin = window.start;
        let seconds = |t: i64| (t - origin) as f64 * 1e-9;
        self.samples.clear();
        let mut status = Status::Converged;
        let sample =
            |l: usize, dn: f64| FrameSample { start_s: seconds(exposures[l].start.0), end_s: seconds(exposures[l].end.0), dn, weight: params.cis_weight };
        let known = || window.frames.clone().map(|l| (l, f64::from(dn(l)))).filter(|(_, dn)| dn.is_finite());
        self.samples.extend(known().filter(|(_, dn)| *dn < model.saturation_dn).map(|(l, dn)| sample(l, dn)));
        if self.samples.is_empty() {
            status = Status::Saturated;
            self.samples.extend(known().map(|(l, _)| sample(l, model.saturation_dn)));
        }
        if self.samples.is_empty() {
            return Ok((Status::NoFrame, 0, 0.0));
        }
        let inside = self.event_t.partition_point(|&t| t < window.start)..self.event_t.partition_point(|&t| t < window.end);
        self.t_s.clear();
        self.steps.clear();
        let first_knot = params.first_knot == FirstKnot::Window || inside.is_empty();
        if first_knot {
            self.t_s.push(0.0);
            self.steps.push(0.0);
        }
        for k in inside.clone() {
            // An event on the window's first instant is its first knot: there is no interval before it to step over.
            if !first_knot || self.event_t[k] > window.start {
                self.t_s.push(seconds(self.event_t[k]));
                self.steps.push(self.event_step[k]);
            }
        }
        let tau_rule = match params.tau_rule {
            TauChoice::Start => TauRule::Start,
            TauChoice::End => TauRule::End,
        };
        let problem = PixelProblem {
            t_s: &self.t_s,
            steps: &self.steps,
            frames: &self.samples,
            evs_weight: params.evs_weight,
            front_end: model.front_end,
            tau_rule,
            black_level: model.black_level,
            gain: model.gain,
        };
        let options = SolveOptions { max_iterations: params.max_iterations as usize, ..SolveOptions::default() };
        let solution =
            solve(&problem, &options, &mut self.workspace).map_err(|error| NodeError::failed(format!("a pixel's problem cannot be posed: {error}")))?;
        if !solution.has_converged() {
            status = status.max(Status::SafeEstimate);
        }
        let until = window.counts_until;
        for (k, &u) in solution.log_photocurrent.iter().enumerate() {
            let t = origin + (self.t_s[k] * 1e9).round() as i64;
            if k == 0 || t < until {
                self.knots.push((t, libm::exp(u) as f32));
            }
        }
        Ok((status, solution.iterations, solution.cost))
    }
}

/// One problem's share of the recording, for one row.
#[derive(Clone, Debug, PartialEq)]
struct Window {
    frames: std::ops::Range<usize>,
    /// First instant whose events count, ns; the first knot.
    start: i64,
    /// First instant whose events no longer count, ns.
    end: i64,
    /// First instant that the next window answers for, ns.
    counts_until: i64,
}

fn windows(joint: Joint, exposures: &[Exposure], meta: &TracksMeta) -> Vec<Window> {
    let frames = exposures.len();
    let span = (meta.span.start.0.min(exposures[0].start.0), meta.span.end.0.max(exposures[frames - 1].end.0));
    if joint == Joint::All || frames <= 2 {
        return vec![Window { frames: 0..frames, start: span.0, end: span.1, counts_until: span.1 }];
    }
    let last = frames - 2;
    (0..=last)
        .map(|l| Window {
            frames: l..l + 2,
            start: if l == 0 { span.0 } else { exposures[l].start.0 },
            end: if l == last { span.1 } else { exposures[l + 1].end.0 },
            counts_until: if l == last { span.1 } else { exposures[l + 1].start.0 },
        })
        .collect()
}
