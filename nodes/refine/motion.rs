//! `refine/motion`: tracks solved again, with what neighbours know.
//!
//! Idea: where something moves, neighbouring pixels see the same light one after the other. A pixel that had
//! no event for a while knows little about its light, but what passed its neighbours a moment ago passes it
//! now. So the motion is found from the tracks themselves, every pixel's light is predicted by its
//! neighbours' tracks carried along the motion, and the pixel is solved again with that as a further
//! measurement in addition to its own events and frames ([`photocurrent_sensor::map::Hint`]). Better tracks
//! give a better motion: a few rounds.
//!
//! The error of what neighbours say is measured, not assumed: past and future neighbours must agree with each
//! other, and with the pixel's own events and frames. Where they do not (something is uncovered, two things
//! move through each other, nothing moves at all), the pixel stays as it was. And before every round the
//! whole is tried on pixels without one frame in three: they must predict those frames better with what
//! neighbours say than without, region by region, or it is left away there ([`Caution`]).
//!
//! Where even so events mislead, light is a blend of the frames before and after ([`Fallback`]).
//!
//! Limits: with fewer than four frames nothing can be tried, and tracks stay as they are; it needs the whole
//! sensor at once, as tracks and measurements; pictures of the motion are made for a part of the time after
//! the other. Light that changes without moving is what it must reject, not what it can use.

mod advect;
#[cfg(test)]
mod tests;

use super::again::{Again, In, Out, Row, Solver};
use super::caution::{Caution, take_care};
use super::fallback::Fallback;
use super::trust::{Posed, Trust, TrustParams};
use photocurrent_core::{Context, Decl, Grain, Meta, Node, NodeError, PortMetas, TrackSet};
use photocurrent_scene::film::LogTracks;
use photocurrent_scene::flow::{Flow, MotionParams};
use photocurrent_sensor::map::estimate::kept;
use photocurrent_sensor::map::{Hint, MapFrame};
use photocurrent_solve::SolveOptions;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Tracks and their motion, to ask neighbours.
pub(super) struct Neighbours<'a> {
    pub log: &'a LogTracks,
    pub flow: &'a Flow,
    pub motion: &'a MotionParams,
    /// As [`DOUBT`].
    pub doubt: f64,
    pub sensor: &'a Posed,
    /// Neighbours are asked at every so many ns.
    pub step_ns: i64,
    pub trust: &'a TrustParams,
}

impl Neighbours<'_> {
    /// Do pixels without some of their frames predict those better with what neighbours say than without?
    pub(crate) fn caution(&self, again: &mut Again) -> Caution {
        again.caution(
            self.trust,
            |_| (),
            |(), row, x, threshold, hints| self.ask(row, x, &kept(row.frames_of(x)), threshold, hints),
        )
    }

    /// What neighbours say of a pixel, as carefully as that has shown to be right, and at least as carefully
    /// as `least`.
    pub(crate) fn hints(
        &self,
        row: &Row,
        x: usize,
        threshold: f64,
        (caution, least): (&Caution, f64),
        hints: &mut Vec<Hint>,
    ) {
        self.hints_with((row, row.frames_of(x)), x, threshold, (caution, least), hints);
    }

    /// The same to a pixel that knows only some of its frames.
    fn hints_with(
        &self,
        (row, frames): (&Row, &[MapFrame]),
        x: usize,
        threshold: f64,
        (caution, least): (&Caution, f64),
        hints: &mut Vec<Hint>,
    ) {
        let caution = f64::max(caution.at(x, row.row as usize), least);
        if caution.is_finite() {
            self.ask(row, x, frames, threshold, hints);
        }
        take_care(hints, caution);
    }

    fn ask(&self, row: &Row, x: usize, frames: &[MapFrame], threshold: f64, hints: &mut Vec<Hint>) {
        let Neighbours { log, flow, motion, doubt, sensor, step_ns, trust } = *self;
        let say = |t_ns: i64| {
            advect::neighbours(log, (flow, motion, doubt), (x, row.row as usize), row.span(), t_ns)
        };
        let measured = row.measured(x, sensor, log.extent, frames, threshold);
        Trust::new(trust).hints(say, log, row.span(), step_ns, &measured, hints);
    }
}

/// Where another motion explains a place not clearly worse than the one that is taken, the predictions have
/// this part of the square by which the two differ as a further variance.
const DOUBT: f64 = 0.5;

/// Blends of a smaller part of the light are not reported.
const WORTH_A_NOTE: f64 = 1e-3;

/// Parameters of `refine/motion`: its own, and those of `solve/map`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(extend("additionalProperties" = false))]
pub struct Params {
    /// How often motion is found and tracks are solved.
    #[schemars(range(min = 1, max = 10))]
    pub rounds: u32,
    /// Takes a blend of the frames before and after where that predicts frames clearly better.
    pub fall_back: bool,
    /// How tracks are solved.
    #[serde(flatten)]
    pub solver: SolveOptions,
}

impl Default for Params {
    fn default() -> Params {
        Params { rounds: 3, fall_back: true, solver: SolveOptions::default() }
    }
}

/// The node.
pub struct RefineMotion {
    solver: Solver,
    params: Params,
}

impl Node for RefineMotion {
    const DECL: Decl = Decl {
        kind: "refine/motion",
        about: "Solves tracks again with what neighbouring pixels saw before and after, carried along the \
                motion.",
        revision: 21,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &[
            "Lucas and Kanade, An iterative image registration technique with an application to stereo \
             vision, IJCAI 1981",
            "Jiang et al., CVPR 2024, Eqs. (1)-(5)",
        ],
        example: r#"
[nodes.solve]
kind   = "solve/map"
in     = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }

[nodes.refine]
kind = "refine/motion"
in   = { tracks = "solve.tracks", events = "recording.events", frames = "recording.frames", sensor = "sensor" }
"#,
    };
    const LOCAL_IN_TIME: bool = true;
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(RefineMotion { solver: Solver::build(params.solver)?, params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Tracks(Arc::new(self.solver.plan(Self::DECL.kind, inputs)?))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let meta =
            self.solver.meta(Self::DECL.kind, &input.tracks.meta, &input.events.meta, &input.frames.meta)?;
        cx.begin(cx.rows().len() as u64 * (1 + u64::from(self.params.rounds)), "rows");
        let mut tracks = input.tracks.read(cx.rows())?;
        let mut again = self.solver.take_in(meta, &input.events, &input.frames, &input.sensor, cx)?;
        let (fired, activity) = (again.fired(), again.activity());
        let (extent, sensor) = (again.meta.extent, again.sensor());
        let span = (again.meta.span.start.0, again.meta.span.end.0);
        let step_ns = 2 * self.params.solver.knot_spacing.ns();
        let (motion, trust) = (&MotionParams::default(), &TrustParams::default());
        for round in 1..=self.params.rounds {
            let log = LogTracks::new(extent, tracks, &fired);
            let flow = Flow::of_tracks(&log, span, &activity, (motion, true));
            let neighbours =
                Neighbours { log: &log, flow: &flow, motion, doubt: DOUBT, sensor: &sensor, step_ns, trust };
            let caution = neighbours.caution(&mut again);
            let is_last = round == self.params.rounds;
            let left;
            (tracks, left) = again.solve(
                cx,
                is_last,
                |_| (),
                |(), row, x, threshold, hints| neighbours.hints(row, x, threshold, (&caution, 0.0), hints),
            )?;
            if is_last && self.params.fall_back {
                let hints =
                    |row: &Row, x: usize, kept: &[MapFrame], threshold: f64, hints: &mut Vec<Hint>| {
                        neighbours.hints_with((row, kept), x, threshold, (&caution, 0.0), hints)
                    };
                let fallback = Fallback::judge(&mut again, (&flow, &left), hints);
                drop(log);
                if let Some(fallback) = fallback {
                    tracks = fallback.apply(tracks, &sensor, again.meta.has_sigma);
                    if fallback.part() > WORTH_A_NOTE {
                        cx.note(format!(
                            "{:.1} % of the light is a blend of the frames before and after, which predicts \
                             frames that were held out clearly better than events do there: thresholds, \
                             exposure or clocks may be wrong, or events were lost",
                            1e2 * fallback.part()
                        ));
                    }
                }
            }
        }
        Ok(Out { tracks: TrackSet::in_memory(Arc::new(again.meta), tracks) })
    }
}
