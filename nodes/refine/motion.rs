//! `refine/motion`: tracks solved again, with predictions from neighbouring pixels.
//!
//! Idea: where something moves, neighbouring pixels see the same light one after the other. A pixel without
//! recent events determines its light poorly, but the light that passed its neighbours a moment ago passes it
//! now. So the motion is estimated from the tracks themselves. Every pixel's light is predicted by its
//! neighbours' tracks along the motion, and the pixel is solved again with that prediction as a
//! pseudo-measurement in addition to its own events and frames ([`photocurrent_sensor::map::Hint`]). Better
//! tracks give a better motion: a few rounds.
//!
//! The error of the prediction is measured, not assumed: past and future neighbours must agree with each
//! other, and with the pixel's own events and frames. Where they do not (occlusion, two motions, no motion),
//! the pixel stays as it was. Before every round the method is evaluated on pixels without one frame in
//! three. They must predict those frames better with the pseudo-measurements than without, region by region,
//! or these are removed there ([`VarianceFactors`]).
//!
//! Where events mislead even so, light is a blend of the frames before and after ([`Fallback`]).
//!
//! Limits: with fewer than four frames nothing can be evaluated, and tracks stay as they are. It needs the
//! whole sensor at once, as tracks and measurements; pictures of the motion are computed for a part of the
//! time after the other. It must reject light that changes without moving, and cannot use it.

mod advect;
#[cfg(test)]
mod tests;

use super::again::{In, LoadedRecording, LoadedRow, Out, RefineSolver};
use super::fallback::Fallback;
use super::pseudo_measurement::{PseudoMeasurementParams, PseudoMeasurements, SolverSensor};
use super::variance_factor::{VarianceFactors, scale_variances};
use photocurrent_core::{Context, Decl, Grain, Meta, Node, NodeError, PortMetas, TrackSet};
use photocurrent_scene::film::LogTracks;
use photocurrent_scene::flow::{Flow, MotionParams};
use photocurrent_sensor::map::estimate::kept;
use photocurrent_sensor::map::{Hint, MapFrame};
use photocurrent_solve::SolveOptions;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Tracks and their motion, for predictions from neighbours.
pub(super) struct Neighbours<'a> {
    pub log: &'a LogTracks,
    pub flow: &'a Flow,
    pub motion: &'a MotionParams,
    /// Share of the squared difference of two predictions that is added as variance (`DOUBT`).
    pub ambiguity: f64,
    pub sensor: &'a SolverSensor,
    /// Step of the predictions, ns.
    pub step_ns: i64,
    pub hint_params: &'a PseudoMeasurementParams,
}

impl Neighbours<'_> {
    /// Selects variance factors: do pixels predict held-out frames better with predictions from neighbours
    /// than without?
    pub(crate) fn variance_factors(&self, again: &mut LoadedRecording) -> VarianceFactors {
        again.variance_factors(
            self.hint_params,
            |_| (),
            |(), row, x, threshold, hints| {
                self.neighbour_hints(row, x, &kept(row.frames_of(x)), threshold, hints)
            },
        )
    }

    /// Pseudo-measurements of a pixel from its neighbours, with a variance factor of at least `least`.
    pub(crate) fn hints(
        &self,
        row: &LoadedRow,
        x: usize,
        threshold: f64,
        (factor, least): (&VarianceFactors, f64),
        hints: &mut Vec<Hint>,
    ) {
        self.hints_with((row, row.frames_of(x)), x, threshold, (factor, least), hints);
    }

    /// The same for a pixel with only some of its frames.
    fn hints_with(
        &self,
        (row, frames): (&LoadedRow, &[MapFrame]),
        x: usize,
        threshold: f64,
        (factor, least): (&VarianceFactors, f64),
        hints: &mut Vec<Hint>,
    ) {
        let factor = f64::max(factor.at(x, row.row as usize), least);
        if factor.is_finite() {
            self.neighbour_hints(row, x, frames, threshold, hints);
        }
        scale_variances(hints, factor);
    }

    fn neighbour_hints(
        &self,
        row: &LoadedRow,
        x: usize,
        frames: &[MapFrame],
        threshold: f64,
        hints: &mut Vec<Hint>,
    ) {
        let Neighbours { log, flow, motion, ambiguity, sensor, step_ns, hint_params } = *self;
        let predict = |t_ns: i64| {
            advect::neighbours(log, (flow, motion, ambiguity), (x, row.row as usize), row.span(), t_ns)
        };
        let measured = row.measured(x, sensor, log.extent, frames, threshold);
        PseudoMeasurements::new(hint_params).hints(predict, log, row.span(), step_ns, &measured, hints);
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
    solver: RefineSolver,
    params: Params,
}

impl Node for RefineMotion {
    const DECL: Decl = Decl {
        kind: "refine/motion",
        about: "Solves tracks again with predictions from neighbouring pixels before and after, carried \
                along the motion.",
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
        Ok(RefineMotion { solver: RefineSolver::build(params.solver)?, params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Tracks(Arc::new(self.solver.plan(Self::DECL.kind, inputs)?))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let meta =
            self.solver.meta(Self::DECL.kind, &input.tracks.meta, &input.events.meta, &input.frames.meta)?;
        cx.begin(cx.rows().len() as u64 * (1 + u64::from(self.params.rounds)), "rows");
        let mut tracks = input.tracks.read(cx.rows())?;
        let mut again = self.solver.load_recording(meta, &input.events, &input.frames, &input.sensor, cx)?;
        let (fired, activity) = (again.fired(), again.activity());
        let (extent, sensor) = (again.meta.extent, again.sensor());
        let span = (again.meta.span.start.0, again.meta.span.end.0);
        let step_ns = 2 * self.params.solver.knot_spacing.ns();
        let (motion, hint_params) = (&MotionParams::default(), &PseudoMeasurementParams::default());
        for round in 1..=self.params.rounds {
            let log = LogTracks::new(extent, tracks, &fired);
            let flow = Flow::estimate(&log, span, &activity, (motion, true));
            let neighbours = Neighbours {
                log: &log,
                flow: &flow,
                motion,
                ambiguity: DOUBT,
                sensor: &sensor,
                step_ns,
                hint_params,
            };
            let factor = neighbours.variance_factors(&mut again);
            let is_last = round == self.params.rounds;
            let left;
            (tracks, left) = again.solve(
                cx,
                is_last,
                |_| (),
                |(), row, x, threshold, hints| neighbours.hints(row, x, threshold, (&factor, 0.0), hints),
            )?;
            if is_last && self.params.fall_back {
                let hints =
                    |row: &LoadedRow, x: usize, kept: &[MapFrame], threshold: f64, hints: &mut Vec<Hint>| {
                        neighbours.hints_with((row, kept), x, threshold, (&factor, 0.0), hints)
                    };
                let fallback = Fallback::evaluate(&mut again, (&flow, &left), hints);
                drop(log);
                if let Some(fallback) = fallback {
                    tracks = fallback.apply(tracks, &sensor, again.meta.has_sigma);
                    if fallback.blended_share() > WORTH_A_NOTE {
                        cx.note(format!(
                            "{:.1} % of the light is a blend of the frames before and after, which predicts \
                             frames that were held out clearly better than events do there: thresholds, \
                             exposure or clocks may be wrong, or events were lost",
                            1e2 * fallback.blended_share()
                        ));
                    }
                }
            }
        }
        Ok(Out { tracks: TrackSet::in_memory(Arc::new(again.meta), tracks) })
    }
}
