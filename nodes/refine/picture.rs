//! `refine/picture`: tracks solved again with a moving picture that explains all frames.
//!
//! Idea: where something rigid moves, all its frames are views of one picture. Between events and between
//! exposures a pixel by itself knows nothing of a smooth texture; the picture does, because other exposures
//! saw the same place, from elsewhere. So a scene ([`photocurrent_scene::mosaic`]) is fitted to the frames
//! alone: one moving picture, or one before a still ground, or pictures of tiles. What it predicts for a
//! pixel is a further measurement in addition to the pixel's own events and frames (and what its neighbours
//! say, as in `refine/motion`), with which the pixel is solved again.
//!
//! Is it right? Nothing is assumed. It counts only where it predicts the frames around ([`Gate`]), and for
//! places of the scene that exposures saw: what lies between is its neighbourhood carried on. The pixel's own
//! events, of which it knows nothing, judge it between frames ([`Trust`]). And before every round the whole
//! is tried on pixels without one frame in three: they must predict those frames better with the picture than
//! without, or it is left away; how far it is trusted is what predicts them best, region by region
//! ([`Caution`](super::caution::Caution)); neighbours are tried in the same way.
//!
//! Where most pixels never fire, the scene is fitted only around those that do: nobody asks for the others.
//!
//! Limits: it needs the whole sensor at once; edges sharper than a pixel are blurred; with fewer than four
//! frames nothing can be tried, and no picture is used. A long recording is fitted in parts of `most_values`
//! frame values; an array so large that three frames are more than that has no picture.

mod scene;
#[cfg(test)]
mod tests;

use super::again::{In, Out, Row, Solver};
use super::caution::take_care;
use super::motion::Neighbours;
use super::trust::{Posed, Trust, TrustParams};
use photocurrent_core::{Context, Decl, Extent, Grain, Meta, Node, NodeError, PortMetas, TrackSet};
use photocurrent_scene::activity::Activity;
use photocurrent_scene::case::Case;
use photocurrent_scene::film::LogTracks;
use photocurrent_scene::flow::{Flow, MotionParams};
use photocurrent_scene::picture::PictureSetting;
use photocurrent_sensor::map::Hint;
use photocurrent_sensor::map::estimate::kept;
use photocurrent_solve::SolveOptions;
use scene::{OfRow, Pictures};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `refine/picture`: its own, and those of `solve/map`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(extend("additionalProperties" = false))]
pub struct Params {
    /// How often neighbours are asked, the picture is judged and tracks are solved.
    #[schemars(range(min = 1, max = 10))]
    pub rounds: u32,
    /// Distance of the picture's coefficients, pixels.
    #[schemars(range(min = 0.25, max = 2.0))]
    pub pitch: f64,
    /// So many frame values of pixels near events are fitted at a time, at 300 bytes each; of a longer
    /// recording part after part.
    #[schemars(range(min = 10_000))]
    pub most_values: u64,
    /// The picture gives no hints for places that fewer exposures saw; one that saw a place for a part of its
    /// time counts as that part.
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
    solver: Solver,
    params: Params,
}

impl Node for RefinePicture {
    const DECL: Decl = Decl {
        kind: "refine/picture",
        about: "Solves tracks again with a moving picture that explains the frames, and with what \
                neighbouring pixels saw.",
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
        Ok(RefinePicture { solver: Solver::build(params.solver)?, params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Tracks(Arc::new(self.solver.plan(Self::DECL.kind, inputs)?))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let meta =
            self.solver.meta(Self::DECL.kind, &input.tracks.meta, &input.events.meta, &input.frames.meta)?;
        cx.begin(cx.rows().len() as u64 * (1 + u64::from(self.params.rounds)), "rows");
        let mut again = self.solver.take_in(meta, &input.events, &input.frames, &input.sensor, cx)?;
        let (fired, activity) = (again.fired(), again.activity());
        let (extent, sensor) = (again.meta.extent, again.sensor());
        let span = again.rows.first().map_or((0, 0), |row| row.span());
        let step_ns = 2 * self.params.solver.knot_spacing.ns();
        let width = extent.width as usize;
        let pictures = self.fitted(&input, &sensor, &activity, extent, cx)?;
        // Only pixels with events get pseudo-measurements.
        let of_row = |row: &Row| {
            let columns: Vec<usize> = (0..width).filter(|x| !row.events_of(*x).is_empty()).collect();
            pictures.of_row(row.row as usize, width, &columns)
        };
        let mut tracks = input.tracks.read(cx.rows())?;
        let (motion, trust) = (&MotionParams::default(), &TrustParams::default());
        for round in 1..=self.params.rounds {
            let log = LogTracks::new(extent, tracks, &fired);
            let flow = Flow::of_tracks(&log, span, &activity, (motion, false));
            let neighbours =
                Neighbours { log: &log, flow: &flow, motion, doubt: 0.0, sensor: &sensor, step_ns, trust };
            let of_neighbours = self.params.neighbours.then(|| neighbours.caution(&mut again));
            let of_picture = |hold_out: bool,
                              light: &OfRow,
                              row: &Row,
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
                let say = |t_ns: i64| pictures.predict(light, (x, row.row as usize), t_ns);
                Trust::new(trust).hints(say, &log, row.span(), step_ns, &measured, hints);
            };
            // First without frames that are held out from the pixels: do they come out better with the
            // picture than without?
            let caution = again.caution(trust, of_row, |light, row, x, threshold, hints| {
                of_picture(true, light, row, x, threshold, hints)
            });
            if round == self.params.rounds && caution.trusts_some() {
                again.widen(of_row, |light, row, x, threshold, hints| {
                    of_picture(true, light, row, x, threshold, hints);
                    take_care(hints, caution.at(x, row.row as usize));
                });
            }
            (tracks, _) =
                again.solve(cx, round == self.params.rounds, of_row, |light, row, x, threshold, hints| {
                    let caution = caution.at(x, row.row as usize);
                    if caution.is_finite() {
                        of_picture(false, light, row, x, threshold, hints);
                    }
                    take_care(hints, caution);
                    if let Some(caution) = &of_neighbours {
                        let mut said = Vec::new();
                        // They were tried without the picture: with it they are no more exact than they say.
                        neighbours.hints(row, x, threshold, (caution, 1.0), &mut said);
                        join(hints, &said);
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
        sensor: &Posed,
        activity: &Activity,
        extent: Extent,
        cx: &Context,
    ) -> Result<Pictures, NodeError> {
        let case = Case::read(Some(&input.events), Some(&input.frames), &input.sensor)?;
        let setting = PictureSetting {
            pitch: self.params.pitch,
            most_values: self.params.most_values as usize,
            ..PictureSetting::default()
        };
        let asked = |span: (i64, i64)| activity.pixels(span, extent);
        let pictures = Pictures::fit(
            &case,
            &sensor.model,
            &setting,
            (self.params.solver.knot_spacing.ns(), self.params.least_exposures),
            asked,
        );
        drop(case);
        if let Err(why) = &pictures {
            cx.note(format!("no picture is used: {why}"));
        }
        Ok(pictures.unwrap_or_default())
    }
}

/// Adds hints to others, both in order of time: at one instant the two become one, each by its weight.
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
