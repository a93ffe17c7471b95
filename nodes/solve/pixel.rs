//! `solve/pixel`: the photocurrent of every pixel that explains its events and its frame values.
//!
//! Idea: a pixel's frames say how much light it collected, its events when the light changed, both through the sensor's own
//! delays. Inverting the sensor pixel by pixel undoes blur, rolling shutter and event latency at once. Each pixel is one small least-squares
//! problem, Eq. (13), solved in [`photocurrent_sensor::inverse`]; this node cuts a recording into such problems and puts the answers together.
//!
//! Frames are taken two by two, as in the paper: the pair (l, l+1) is solved with all events from the start of exposure l to
//! the end of exposure l+1, and its answer counts until exposure l+1 starts. The first window reaches back to the recording's start, the
//! last one on to its end. `frames = "all"` solves one problem over the whole recording instead.
//!
//! Limits: grey frames at the events' resolution. A saturated value counts as the light of saturation, which is a lower bound. A pixel whose
//! problem does not converge gets the safe estimate (a double integral) and is counted; the `map` output shows where.

use crate::compensate::readout::check_events;
use crate::pixel_events::{Stamp, StepRule, left_out};
use photocurrent_core::events::{EventRow, PixelIndex};
use photocurrent_core::handle::Band;
use photocurrent_core::{
    Context, Decl, EventStream, EventsMeta, Exposure, FrameBlock, FrameScale, FrameSequence, FramesMeta, Grain, MapBand, MapMeta, MapSet, Meta, Node,
    NodeError, PortMetas, Rows, Sensor, TrackBand, TrackSet, TracksMeta,
};
use photocurrent_sensor::front_end::{FrontEnd, TauRule};
use photocurrent_sensor::inverse::{FrameSample, PixelProblem, SolveOptions, Workspace, solve};
use photocurrent_sensor::readout::compensated_step;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

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
    /// Most steps tried for one problem.
    #[schemars(range(min = 1, max = 10000))]
    pub max_iterations: u32,
}

impl Default for Params {
    fn default() -> Self {
        Params {
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

const PLANES: [&str; 3] = ["status", "iterations", "cost"];

/// Everything about the sensor that one pixel's problem needs, checked once.
struct Model {
    rule: StepRule,
    front_end: FrontEnd,
    refractory_s: f64,
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
        let refractory_s = match self.params.readout {
            ReadoutModel::None => 0.0,
            ReadoutModel::Slope => {
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
            gain: sensor.need(sensor.frames.gain, "frames.gain", WHO)?,
            black_level: sensor.frames.black_level_dn.unwrap_or(0.0),
            saturation_dn: sensor.frames.saturation_dn.unwrap_or(f64::INFINITY),
        })
    }

    fn tracks_meta(events: &EventsMeta, frames: &FramesMeta) -> Result<TracksMeta, NodeError> {
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
            count_hint: events.count_hint.map(|n| 2 * n + (frames.times.len() * frames.extent.pixels()) as u64),
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
        let tracks = SolvePixel::tracks_meta(events, frames)?;
        let map = map_meta(tracks.extent);
        Ok(vec![Meta::Tracks(Arc::new(tracks)), Meta::Map(Arc::new(map))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let meta = SolvePixel::tracks_meta(&input.events.meta, &input.frames.meta)?;
        let model = self.model(&input.sensor, &input.events.meta)?;
        if let Some(note) = left_out(&input.sensor) {
            cx.note(note);
        }
        let rows = cx.rows();
        cx.begin(rows.len() as u64, "rows");
        let events = input.events.read(rows)?;
        let frames = input.frames.read_rows(rows)?;
        let solve_row = |workspace: &mut RowSolver, row: u32| -> Result<(TrackBand, MapBand), NodeError> {
            let exposures: Vec<Exposure> = (0..input.frames.len()).map(|l| input.frames.meta.times.exposure(l, row)).collect();
            let band = workspace.row(&self.params, &model, &meta, row, events.row(row), &frames, &exposures)?;
            cx.advance(1)?;
            Ok(band)
        };
        let solved: Result<Vec<_>, NodeError> = rows.iter().into_par_iter().map_init(RowSolver::default, solve_row).collect();
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::baseline::edi::{self, BaselineEdi};
    use crate::render::rows::{self, RenderRows};
    use crate::sampling::Sampling;
    use photocurrent_core::events::{Event, Polarity};
    use photocurrent_core::quantity::{Duration, Rate};
    use photocurrent_core::random::Random;
    use photocurrent_core::{Extent, testing};

    fn sensor() -> Arc<Sensor> {
        let mut sensor = Sensor::unknown("test");
        sensor.front_end.tau_0 = Some(Duration::new(20_000));
        sensor.front_end.alpha = Some(Duration::new(2_000_000));
        sensor.comparator.threshold_on = Some(0.2);
        sensor.comparator.threshold_off = Some(0.25);
        sensor.readout.refractory = Some(Duration::new(60_000));
        sensor.frames.gain = Some(1000.0);
        sensor.frames.saturation_dn = Some(1023.0);
        Arc::new(sensor)
    }

    fn solve(params: Params, events: EventStream, frames: FrameSequence, rows: Rows) -> (Out, Vec<String>) {
        let node = SolvePixel { params };
        let (out, notes) = testing::with_context(rows, &["tracks", "map"], |cx| node.run(In { events, frames, sensor: sensor() }, cx));
        (out.unwrap(), notes)
    }

    fn ideal() -> Params {
        Params { front_end: FrontEndModel::Ideal, readout: ReadoutModel::None, ..Params::default() }
    }

    const EXTENT: Extent = Extent { width: 5, height: 4 };

    /// A walk of ON and OFF around zero net change, so that no pixel runs away.
    fn walk(extent: Extent, until_ns: i64) -> EventStream {
        let mut events = Vec::new();
        for y in 0..extent.height {
            for x in 0..extent.width {
                let mut random = Random::new(11, &[x.into(), y.into()]);
                let mut t = 0;
                loop {
                    t += 200_000 + (random.uniform() * 1.5e6) as i64;
                    if t + 20_000 >= until_ns {
                        break;
                    }
                    events.push(Event { x: x as u16, y: y as u16, polarity: Polarity::from_bit((random.bits() & 1) as u8), t: t + 20_000, t_in: Some(t) });
                }
            }
        }
        testing::stream(extent, events)
    }

    fn exposures(count: i64) -> Vec<Exposure> {
        (0..count).map(|l| Exposure::new(l * 8_000_000, l * 8_000_000 + 6_000_000)).collect()
    }

    fn frames(count: i64) -> FrameSequence {
        let mut random = Random::new(5, &[]);
        testing::captured(EXTENT, exposures(count), 30_000, |_, _, _| (100.0 + 300.0 * random.uniform()) as f32)
    }

    #[test]
    fn with_an_ideal_sensor_and_one_frame_it_is_the_double_integral() {
        let (events, frames) = (walk(EXTENT, 6_000_000), frames(1));
        let sampling = Sampling { rate: Rate::new(5000.0), ..Sampling::default() };
        let (solved, _) = solve(ideal(), events.clone(), frames.clone(), EXTENT.rows());
        let render = RenderRows::build(rows::Params { sampling: sampling.clone() }).unwrap();
        let ours = testing::with_context(EXTENT.rows(), &["frames"], |cx| render.run(rows::In { tracks: solved.tracks, sensor: sensor(), at: None }, cx))
            .0
            .unwrap()
            .frames;
        let double_integral = BaselineEdi::build(edi::Params { sampling, ..edi::Params::default() }).unwrap();
        let input = edi::In { events, frames, sensor: Some(sensor()), contrast: None, at: None };
        let theirs = testing::with_context(EXTENT.rows(), &["frames"], |cx| double_integral.run(input, cx)).0.unwrap().frames;
        assert_eq!(ours.meta, theirs.meta);
        let (ours, theirs) = (ours.read_rows(EXTENT.rows()).unwrap(), theirs.read_rows(EXTENT.rows()).unwrap());
        // Tracks are f32: a few rounding errors of 6e-8 each.
        assert!(ours.dn.iter().zip(&theirs.dn).all(|(a, b)| (a / b - 1.0).abs() < 1e-6));
        assert!(ours.dn.iter().any(|dn| (dn / ours.dn[0] - 1.0).abs() > 0.2), "the picture must change for the test to mean something");
    }

    #[test]
    fn rows_are_solved_alike_whatever_the_band() {
        let (events, frames) = (walk(EXTENT, 30_000_000), frames(4));
        let whole = solve(Params::default(), events.clone(), frames.clone(), EXTENT.rows()).0.tracks.read(EXTENT.rows()).unwrap();
        for band in EXTENT.rows().bands(3) {
            let part = solve(Params::default(), events.clone(), frames.clone(), band).0.tracks.read(band).unwrap();
            assert_eq!(part, whole.slice(band));
        }
    }

    #[test]
    fn solved_tracks_reproduce_the_frames_they_came_from() {
        let frames = testing::captured(EXTENT, exposures(2), 30_000, |_, x, y| 100.0 + 40.0 * x as f32 + 10.0 * y as f32);
        let (solved, notes) = solve(Params::default(), walk(EXTENT, 14_000_000), frames.clone(), EXTENT.rows());
        let render = RenderRows::build(rows::Params::default()).unwrap();
        let input = rows::In { tracks: solved.tracks.clone(), sensor: sensor(), at: Some(frames.clone()) };
        let again = testing::with_context(EXTENT.rows(), &["frames"], |cx| render.run(input, cx)).0.unwrap().frames.read_rows(EXTENT.rows()).unwrap();
        let original = frames.read_rows(EXTENT.rows()).unwrap();
        let map = solved.map.read(EXTENT.rows()).unwrap();
        let mut converged = 0;
        for y in EXTENT.rows().iter() {
            for x in (0..5).filter(|x| map.row(0, y)[*x] == 0.0) {
                // A squared DN weighs as much as a squared log unit, so frames are met to a small part of one DN.
                assert!((0..2).all(|l| (again.row(l, y)[x] - original.row(l, y)[x]).abs() < 0.5), "({x}, {y})");
                converged += 1;
            }
        }
        assert!(converged >= 15, "{notes:?}");
    }

    #[test]
    fn dead_saturated_and_unknown_pixels_have_stated_outcomes() {
        let dn = |_: usize, x: u32, _: u32| [0.0, 1023.0, f32::NAN, 200.0, 200.0][x as usize];
        let frames = testing::captured(EXTENT, exposures(2), 0, dn);
        let (solved, notes) = solve(Params::default(), walk(EXTENT, 14_000_000), frames, EXTENT.rows());
        let tracks = solved.tracks.read(EXTENT.rows()).unwrap();
        assert!(tracks.pixel(0, 0).photocurrent.iter().all(|i| *i < 1e-10));
        assert!(tracks.pixel(1, 0).photocurrent.iter().all(|i| i.is_finite() && *i > 0.0));
        assert!(tracks.pixel(2, 0).t.is_empty());
        let map = solved.map.read(EXTENT.rows()).unwrap();
        assert_eq!(&map.row(0, 0)[..4], [1.0, 2.0, 3.0, 0.0]);
        assert_eq!(notes.len(), 3, "{notes:?}");
    }

    #[test]
    fn a_recording_without_events_holds_the_light_of_each_pair() {
        let (solved, _) = solve(Params::default(), testing::stream(EXTENT, vec![]), frames(3), EXTENT.rows());
        let tracks = solved.tracks.read(EXTENT.rows()).unwrap();
        assert_eq!(tracks.pixel(1, 1).t, [0, 8_030_000]);
    }

    #[test]
    fn windows_answer_for_every_instant_once() {
        let meta = SolvePixel::tracks_meta(&walk(EXTENT, 30_000_000).meta, &frames(4).meta).unwrap();
        let windows = windows(Joint::Pairs, &exposures(4), &meta);
        assert_eq!(windows.len(), 3);
        assert!(windows.windows(2).all(|w| w[0].counts_until == w[1].start && w[0].end > w[1].start));
        assert_eq!(windows[2].end, windows[2].counts_until);
    }

    #[test]
    fn no_frame_at_all_is_refused_with_the_reason() {
        let none = FramesMeta { times: photocurrent_core::FrameTimes::new(vec![], 0).unwrap(), ..(*frames(1).meta).clone() };
        let error = SolvePixel::tracks_meta(&walk(EXTENT, 1_000_000).meta, &none).unwrap_err();
        assert_eq!(error.message, "there is no frame, and events alone leave the photocurrent's level open");
    }
}
