//! `refine/motion`: tracks solved again, with what neighbours know.
//!
//! Idea: where something moves, neighbouring pixels see the same light one after the other. A pixel that had no event for a while knows little
//! about its light, but what passed its neighbours a moment ago passes it now. So the motion is found from the tracks themselves,
//! every pixel's light is foretold by its neighbours' tracks carried along the motion, and the pixel is solved again with that as a further
//! measurement beside its own events and frames ([`photocurrent_sensor::map::Hint`]). Better tracks give a better motion: a few rounds.
//!
//! The error of what neighbours say is measured, not assumed: past and future neighbours must agree with each other, and with the pixel's own
//! events and frames. Where they do not (something is uncovered, two things move through each other, nothing moves at all), the pixel stays
//! as it was.
//!
//! Limits: it needs the whole sensor at once. Light that changes without moving is what it must reject, not what it can use.

mod advect;
mod film;
mod flow;
#[cfg(test)]
mod tests;

use crate::co_located::CoLocated;
use crate::solve::pixel::map::{RowSetting, RowSolver};
use crate::solve::pixel::shares::RowShares;
use crate::solve::pixel::{FrontEndModel, Method, Model, Params as SolveParams, SolvePixel};
use advect::Advection;
use film::{Film, Fired, LogTracks};
use flow::Flow;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{
    Between, Context, Decl, EventStream, EventsMeta, Exposure, FrameSequence, FramesMeta, Grain, Meta, Node, NodeError, PortMetas, Sensor, TrackBand, TrackSet,
    TracksMeta, handle::Band,
};
use photocurrent_sensor::map::Hint;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Pictures of the film in which motion is looked for lie so far apart, ns.
const FILM_STEP_NS: i64 = 500_000;

/// Parameters of `refine/motion`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// How often motion is found and tracks are solved.
    #[schemars(range(min = 1, max = 10))]
    pub rounds: u32,
    /// As in `solve/pixel`.
    pub front_end: FrontEndModel,
    /// As in `solve/pixel`: standard deviation of an event as a part of its threshold; absent = chosen for each row.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub event_noise: Option<f64>,
    /// As in `solve/pixel`: part of a frame value that is not believed.
    #[schemars(range(min = 0.0))]
    pub frame_noise: f64,
    /// As in `solve/pixel`: knots lie at most this far apart; neighbours are asked at every second one.
    #[schemars(extend("x-min" = "10 us"))]
    pub knot_spacing: Duration,
}

impl Default for Params {
    fn default() -> Params {
        let SolveParams { front_end, event_noise, frame_noise, knot_spacing, .. } = SolveParams::default();
        Params { rounds: 3, front_end, event_noise, frame_noise, knot_spacing }
    }
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// The first solution: log-linear tracks, of `solve/pixel` with `method = "map"`.
        tracks: TrackSet,
        /// The events that it was solved from.
        events: EventStream,
        /// The frames that it was solved from.
        frames: FrameSequence,
        /// The sensor, as for `solve/pixel`.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// Photocurrent of every pixel over time.
        tracks: TrackSet,
    }
}

/// The node.
pub struct RefineMotion {
    solve: SolvePixel,
    params: Params,
}

impl RefineMotion {
    fn meta(&self, tracks: &TracksMeta, events: &EventsMeta, frames: &FramesMeta) -> Result<TracksMeta, NodeError> {
        if tracks.between != Between::LogLinear {
            return Err(NodeError::usage("the tracks hold their values between knots; refine/motion needs log-linear ones")
                .hint("connect tracks of solve/pixel with `method = \"map\"`"));
        }
        CoLocated::new(events, frames)?.need_plain("refine/motion")?;
        let meta = self.solve.tracks_meta(events, frames)?;
        if tracks.extent != meta.extent {
            return Err(NodeError::usage(format!("tracks are {}, events are {}", tracks.extent, meta.extent))
                .hint("connect the events and frames that the tracks were solved from"));
        }
        Ok(meta)
    }
}

impl Node for RefineMotion {
    const DECL: Decl = Decl {
        kind: "refine/motion",
        about: "Solves tracks again with what neighbouring pixels saw before and after, carried along the motion.",
        revision: 2,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &[
            "Lucas and Kanade, An iterative image registration technique with an application to stereo vision, IJCAI 1981",
            "Jiang et al., CVPR 2024, Eqs. (1)-(5)",
        ],
        example: r#"
[nodes.solve]
kind   = "solve/pixel"
in     = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }
params = { method = "map" }

[nodes.refine]
kind = "refine/motion"
in   = { tracks = "solve.tracks", events = "recording.events", frames = "recording.frames", sensor = "sensor" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        let Params { front_end, event_noise, frame_noise, knot_spacing, .. } = params;
        let solve = SolvePixel::build(SolveParams { method: Method::Map, front_end, event_noise, frame_noise, knot_spacing, ..SolveParams::default() })?;
        Ok(RefineMotion { solve, params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let (events, frames) = (inputs.events("events")?, inputs.frames("frames")?);
        self.solve.model(inputs.sensor("sensor")?, events)?;
        Ok(vec![Meta::Tracks(Arc::new(self.meta(inputs.tracks("tracks")?, events, frames)?))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let meta = self.meta(&input.tracks.meta, &input.events.meta, &input.frames.meta)?;
        let model = self.solve.model(&input.sensor, &input.events.meta)?;
        let rows = cx.rows();
        cx.begin(rows.len() as u64 * (1 + u64::from(self.params.rounds)), "rows");
        let mut tracks = input.tracks.read(rows)?;
        let events = input.events.read(rows)?;
        let frames = input.frames.read_rows(rows)?;
        let prepare = |row: u32| -> Result<Row, NodeError> {
            let exposures: Vec<Exposure> = (0..input.frames.len()).map(|l| input.frames.meta.times.exposure(l, row)).collect();
            let mut solver = RowSolver::default();
            let setting = solver.prepare(self.solve.params(), &model, &meta, row, events.row(row), &frames, &exposures, &RowShares::default());
            cx.advance(1)?;
            Ok(Row { row, solver, setting })
        };
        let prepared: Result<Vec<Row>, NodeError> = rows.iter().into_par_iter().map(prepare).collect();
        let mut prepared = prepared?;
        drop((events, frames));
        let width = meta.extent.width as usize;
        let times = |row: &Row, x: usize| row.solver.events_of(x).iter().map(|event| event.t_in_ns).collect();
        let fired = Arc::new(Fired::new(prepared.iter().flat_map(|row| (0..width).map(move |x| times(row, x)))));
        for _round in 0..self.params.rounds {
            let log = LogTracks::new(meta.extent, &tracks, &fired);
            let flow = Flow::new(&Film::new(&log, (meta.span.start.0, meta.span.end.0), FILM_STEP_NS));
            let solved: Result<Vec<TrackBand>, NodeError> = prepared
                .par_iter_mut()
                .map(|row| {
                    let band = self.solve_row(row, &model, &meta, &log, &flow);
                    cx.advance(1)?;
                    Ok(band)
                })
                .collect();
            tracks = TrackBand::concat(solved?);
        }
        Ok(Out { tracks: TrackSet::in_memory(Arc::new(meta), tracks) })
    }
}

/// A row, taken in once for all rounds.
struct Row {
    row: u32,
    solver: RowSolver,
    setting: RowSetting,
}

impl RefineMotion {
    fn solve_row(&self, row: &mut Row, model: &Model, meta: &TracksMeta, log: &LogTracks, flow: &Flow) -> TrackBand {
        let Row { row, solver, setting } = row;
        let mut advection = Advection::default();
        let hints: Vec<Vec<Hint>> = (0..meta.extent.width as usize)
            .map(|x| {
                let mut hints = Vec::new();
                let (events, frames) = (solver.events_of(x), solver.frames_of(x));
                let step_ns = 2 * self.params.knot_spacing.ns();
                advection.hints(log, flow, (x, *row as usize), setting.span, step_ns, events, frames, model.threshold(), &mut hints);
                hints
            })
            .collect();
        solver.solve(model, setting, meta, *row, Some(&hints)).0
    }
}
