//! `refine/picture`: tracks solved again with a moving picture that explains all frames.
//!
//! Idea: where something rigid moves, all its frames are views of one picture. Between events and between
//! exposures a single pixel does not determine a smooth texture. The picture does, because other exposures
//! recorded the same place from elsewhere. So a scene ([`photocurrent_scene::mosaic`]) is fitted to the
//! frames alone: one moving picture, one before a still ground, or pictures of tiles. Its prediction for a
//! pixel is a pseudo-measurement in addition to the pixel's own events and frames (and to the predictions of
//! its neighbours, as in `refine/motion`), with which the pixel is solved again.
//!
//! The picture is used only where it predicts neighbouring frames within their noise
//! ([`PredictionGate`](photocurrent_scene::gate::PredictionGate)), and where at least `least_exposures`
//! exposures recorded the place; elsewhere it is extrapolation. Between frames it is compared with the
//! pixel's own events, to which it is not fitted ([`PseudoMeasurements`]). Before every round it is evaluated
//! on pixels without one frame in three. They must predict those frames better with the picture than without,
//! or it is left out. Its variance factor is the one that predicts them best, region by region
//! ([`VarianceFactors`](super::variance_factor::VarianceFactors)). Predictions of neighbours are evaluated in
//! the same way.
//!
//! Where most pixels never fire, the scene is fitted only around those that do.
//!
//! Limits: it needs the whole sensor at once; edges sharper than a pixel are blurred; with fewer than four
//! frames nothing can be evaluated, and no picture is used. A long recording is fitted in parts of
//! `most_values` frame values; an array so large that three frames are more than that has no picture.

mod scene;
#[cfg(test)]
mod tests;

use super::again::{In, LoadedRow, Out, RefineSolver};
use super::motion::Neighbours;
use super::pseudo_measurement::{PseudoMeasurementParams, PseudoMeasurements, SolverSensor};
use super::variance_factor::scale_variances;
use photocurrent_core::{Context, Decl, Extent, Grain, Meta, Node, NodeError, PortMetas, TrackSet};
use photocurrent_scene::activity::Activity;
use photocurrent_scene::case::Case;
use photocurrent_scene::film::LogTracks;
use photocurrent_scene::flow::{Flow, MotionParams};
use photocurrent_scene::picture::PictureSetting;
use photocurrent_sensor::map::Hint;
use photocurrent_sensor::map::estimate::kept;
use photocurrent_solve::SolveOptions;
use scene::{PredictedPictures, PredictedRowLight};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `refine/picture`: its own, and those of `solve/map`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(extend("additionalProperties" = false))]
pub struct Params {
    /// Rounds of predictions by neighbours and the picture, each followed by a solution of the tracks.
    #[schemars(range(min = 1, max = 10))]
    pub rounds: u32,
    /// Distance of the picture's coefficients, pixels.
    #[schemars(range(min = 0.25, max = 2.0))]
    pub pitch: f64,
    /// Frame values of pixels near events that are fitted at a time, at 300 bytes each; a longer recording is
    /// fitted part by part.
    #[schemars(range(min = 10_000))]
    pub most_values: u64,
    /// Least number of exposures that recorded a place, for the picture to be used there; one that recorded
    /// it for a part of its time counts as that part.
    #[schemars(range(min = 0.0))]
    pub least_exposures: f64,
    /// Neighbouring pixels along the motion are used as well, as `refine/motion` does.
    pub neighbours: bool,
    /// How tracks are solved.
    #[serde(flatten)]
    pub solver: SolveOptions,
}

impl Default for Params {
    fn default() -> Params {
        let PictureSetting { pitch, most_values, .. } = PictureSetting::default();
        Params {
            rounds: 2,
            pitch,
            most_values: most_values as u64,
            least_exposures: 0.25,
            neighbours: true,
            solver: SolveOptions::default(),
        }
    }
}

/// The node.
pub struct RefinePicture {
    solver: RefineSolver,
    params: Params,
}

impl Node for RefinePicture {
    const DECL: Decl = Decl {
        kind: "refine/picture",
        about: "Solves tracks again with a moving picture that explains the frames, and with \
                predictions from neighbouring pixels.",
        revision: 18,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &[
            "Lucas and Kanade, An iterative image registration technique with an application to stereo \
             vision, IJCAI 1981",
            "Irani and Peleg, Improving Resolution by Image Registration, CVGIP 1991",
            "Björck, Numerical Methods for Least Squares Problems, SIAM 1996, section 7.4 (CGLS)",
            "Jiang et al., CVPR 2024, Eqs. (1)-(5)",
        ],
        example: r#"
[nodes.solve]
kind   = "solve/map"
in     = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }

[nodes.picture]
kind = "refine/picture"
in   = { tracks = "solve.tracks", events = "recording.events", frames = "recording.frames", sensor = "sensor" }
"#,
    };
    const LOCAL_IN_TIME: bool = true;
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(RefinePicture { solver: RefineSolver::build(params.solver)?, params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Tracks(Arc::new(self.solver.plan(Self::DECL.kind, inputs)?))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let meta =
            self.solver.meta(Self::DECL.kind, &input.tracks.meta, &input.events.meta, &input.frames.meta)?;
        cx.begin(cx.rows().len() as u64 * (1 + u64::from(self.params.rounds)), "rows");
        let mut again = self.solver.load_recording(meta, &input.events, &input.frames, &input.sensor, cx)?;
        let (fired, activity) = (again.fired(), again.activity());
        let (extent, sensor) = (again.meta.extent, again.sensor());
        let span = again.rows.first().map_or((0, 0), |row| row.span());
        let step_ns = 2 * self.params.solver.knot_spacing.ns();
        let width = extent.width as usize;
        let pictures = self.fitted(&input, &sensor, &activity, extent, cx)?;
        // Only pixels with events get pseudo-measurements.
        let of_row = |row: &LoadedRow| {
            let columns: Vec<usize> = (0..width).filter(|x| !row.events_of(*x).is_empty()).collect();
            pictures.row_light(row.row as usize, width, &columns)
        };
        let mut tracks = input.tracks.read(cx.rows())?;
        let (motion, hint_params) = (&MotionParams::default(), &PseudoMeasurementParams::default());
        for round in 1..=self.params.rounds {
            let log = LogTracks::new(extent, tracks, &fired);
            let flow = Flow::estimate(&log, span, &activity, (motion, false));
            let neighbours = Neighbours {
                log: &log,
                flow: &flow,
                motion,
                ambiguity: 0.0,
                sensor: &sensor,
                step_ns,
                hint_params,
            };
            let of_neighbours = self.params.neighbours.then(|| neighbours.variance_factors(&mut again));
            let of_picture = |hold_out: bool,
                              light: &PredictedRowLight,
                              row: &LoadedRow,
                              x: usize,
                              threshold: f64,
                              hints: &mut Vec<Hint>| {
                let left = hold_out.then(|| kept(row.frames_of(x)));
                let measured = row.measured(
                    x,
                    &sensor,
                    extent,
                    left.as_deref().unwrap_or_else(|| row.frames_of(x)),
                    threshold,
                );
                let predict = |t_ns: i64| pictures.predict(light, (x, row.row as usize), t_ns);
                PseudoMeasurements::new(hint_params).hints(
                    predict,
                    &log,
                    row.span(),
                    step_ns,
                    &measured,
                    hints,
                );
            };
            // First without frames that are held out from the pixels: do they come out better with the
            // picture than without?
            let factor = again.variance_factors(hint_params, of_row, |light, row, x, threshold, hints| {
                of_picture(true, light, row, x, threshold, hints)
            });
            if round == self.params.rounds && factor.uses_some() {
                again.widen(of_row, |light, row, x, threshold, hints| {
                    of_picture(true, light, row, x, threshold, hints);
                    scale_variances(hints, factor.at(x, row.row as usize));
                });
            }
            (tracks, _) =
                again.solve(cx, round == self.params.rounds, of_row, |light, row, x, threshold, hints| {
                    let factor = factor.at(x, row.row as usize);
                    if factor.is_finite() {
                        of_picture(false, light, row, x, threshold, hints);
                    }
                    scale_variances(hints, factor);
                    if let Some(factor) = &of_neighbours {
                        let mut predicted = Vec::new();
                        // They were evaluated without the picture: with it their variance is not reduced.
                        neighbours.hints(row, x, threshold, (factor, 1.0), &mut predicted);
                        join(hints, &predicted);
                    }
                })?;
        }
        Ok(Out { tracks: TrackSet::in_memory(Arc::new(again.meta), tracks) })
    }
}

impl RefinePicture {
    /// The pictures of the frames around pixels with events; none where they cannot be fitted.
    fn fitted(
        &self,
        input: &In,
        sensor: &SolverSensor,
        activity: &Activity,
        extent: Extent,
        cx: &Context,
    ) -> Result<PredictedPictures, NodeError> {
        let case = Case::read(Some(&input.events), Some(&input.frames), &input.sensor)?;
        let setting = PictureSetting {
            pitch: self.params.pitch,
            most_values: self.params.most_values as usize,
            ..PictureSetting::default()
        };
        let active = |span: (i64, i64)| activity.active_pixels(span, extent);
        let pictures = PredictedPictures::fit(
            &case,
            &sensor.model,
            &setting,
            (self.params.solver.knot_spacing.ns(), self.params.least_exposures),
            active,
        );
        drop(case);
        if let Err(why) = &pictures {
            cx.note(format!("no picture is used: {why}"));
        }
        Ok(pictures.unwrap_or_default())
    }
}

/// Merges pseudo-measurements, both lists in order of time: two at one instant become one, weighted by their
/// variances.
fn join(hints: &mut Vec<Hint>, others: &[Hint]) {
    hints.extend_from_slice(others);
    hints.sort_by_key(|hint| hint.t_ns);
    hints.dedup_by(|second, first| {
        let same = second.t_ns == first.t_ns;
        if same {
            let share = first.variance / (first.variance + second.variance);
            first.log_photocurrent += share * (second.log_photocurrent - first.log_photocurrent);
            first.variance = share * second.variance;
            // Both saw the same frames.
            first.for_sigma = f64::min(first.for_sigma, second.for_sigma);
        }
        same
    });
}
