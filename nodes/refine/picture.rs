//! `refine/picture`: tracks solved again with a moving picture that explains all frames.
//!
//! Idea: where something rigid moves, all its frames are views of one picture. Between events and between exposures a pixel by itself knows
//! nothing of a smooth texture; the picture does, because other exposures saw the same place, from elsewhere. So in windows of a few frames
//! one picture is fitted to all frame values, each the mean over its own row's exposure, and to how far light moved between the events of
//! every pixel. It moves as the tracks do, which know the motion
//! from the events; one affine motion of the whole sensor at every instant, corrected in the fit. What the picture foretells for a pixel is a
//! further measurement beside the pixel's own events and frames (and what its neighbours say, as in `refine/motion`), with which the pixel is
//! solved again. Better tracks give a better motion: a few rounds.
//!
//! Is it rigid? Nothing is assumed. The pictures of neighbouring windows must agree with each other and with the pixel's own events and
//! frames ([`Trust`]); and before every round the whole is tried without one frame in three: pictures and pixels must foretell those frames better
//! with the picture than without, or it is left away. How far the picture is believed is what foretells them best, region by region
//! ([`Caution`](super::caution::Caution)). (Motion is found from tracks that have seen all frames, and so is how far light moved between two
//! events, which is a threshold in any case; the picture's light has not.)
//!
//! Limits: it needs the whole sensor at once; one affine motion at a time, that of most pixels; edges sharper than a pixel are blurred; with
//! fewer than four frames nothing can be tried, and no picture is used.

mod fit;
mod grid;
mod pose;
#[cfg(test)]
mod tests;
mod window;

use super::again::{In, Out, Row, Setting, Solver};
use super::caution::take_care;
use super::film::{Film, LogTracks};
use super::flow::Flow;
use super::motion::advect;
use super::trust::{Known, Said, Trust};
use crate::solve::pixel::{FRAME_NOISE, FrontEndModel, KNOT_SPACING};
use photocurrent_core::quantity::Duration;
use photocurrent_core::{Context, Decl, FrameSequence, Grain, Meta, Node, NodeError, PortMetas, TrackSet};
use photocurrent_sensor::map::estimate::is_kept_back;
use photocurrent_sensor::map::{Hint, MapFrame};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use window::{Scene, Window};

/// Windows overlap: their middles are this part of a window apart.
const OVERLAP: i64 = 3;

/// Parameters of `refine/picture`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// How often motion is found, pictures are fitted and tracks are solved.
    #[schemars(range(min = 1, max = 10))]
    pub rounds: u32,
    /// The exposures of so many frame periods share one picture.
    #[schemars(range(min = 2, max = 100))]
    pub frames: u32,
    /// Distance of the picture's coefficients, pixels.
    #[schemars(range(min = 0.25, max = 2.0))]
    pub pitch: f64,
    /// Neighbouring pixels along the motion are asked as well, as `refine/motion` does.
    pub neighbours: bool,
    /// As in `solve/pixel`.
    pub front_end: FrontEndModel,
    /// As in `solve/pixel`: standard deviation of an event as a part of its threshold; absent = chosen for each block of 16 rows.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub event_noise: Option<f64>,
    /// As in `solve/pixel`: part of a frame value that is not believed.
    #[schemars(range(min = 0.0))]
    pub frame_noise: f64,
    /// As in `solve/pixel`: knots lie at most this far apart; the picture is asked at every second one.
    #[schemars(extend("x-min" = "10 us"))]
    pub knot_spacing: Duration,
}

impl Default for Params {
    fn default() -> Params {
        Params {
            rounds: 2,
            frames: 3,
            pitch: 0.8,
            neighbours: true,
            front_end: FrontEndModel::default(),
            event_noise: None,
            frame_noise: FRAME_NOISE,
            knot_spacing: KNOT_SPACING,
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
        about: "Solves tracks again with a moving picture of a few frames' time, and with what neighbouring pixels saw.",
        revision: 8,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &[
            "Lucas and Kanade, An iterative image registration technique with an application to stereo vision, IJCAI 1981",
            "Björck, Numerical Methods for Least Squares Problems, SIAM 1996, section 7.4 (CGLS)",
            "Jiang et al., CVPR 2024, Eqs. (1)-(5)",
        ],
        example: r#"
[nodes.solve]
kind   = "solve/pixel"
in     = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }
params = { method = "map" }

[nodes.picture]
kind = "refine/picture"
in   = { tracks = "solve.tracks", events = "recording.events", frames = "recording.frames", sensor = "sensor" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        let Params { front_end, event_noise, frame_noise, knot_spacing, .. } = params;
        Ok(RefinePicture { solver: Solver::build(Setting { front_end, event_noise, frame_noise, knot_spacing })?, params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Tracks(Arc::new(self.solver.plan(Self::DECL.kind, inputs)?))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let meta = self.solver.meta(Self::DECL.kind, &input.tracks.meta, &input.events.meta, &input.frames.meta)?;
        cx.begin(cx.rows().len() as u64 * (1 + u64::from(self.params.rounds)), "rows");
        let mut tracks = input.tracks.read(cx.rows())?;
        let mut again = self.solver.take_in(meta, &input.events, &input.frames, &input.sensor, cx)?;
        let fired = again.fired();
        let extent = again.meta.extent;
        let span = again.rows.first().map_or((0, 0), |row| row.span());
        let period_ns = period_ns(&input.frames);
        let step_ns = 2 * self.params.knot_spacing.ns();
        for round in 1..=self.params.rounds {
            let log = LogTracks::new(extent, &tracks, &fired);
            let flow = Flow::new(&Film::new(&log, span));
            let bright = typical(&tracks.photocurrent);
            let scale = again.scale();
            let pictures = |rows: &[Row], keep_back: bool| {
                let size = (extent.width as usize, extent.height as usize);
                let scene = Scene { rows, size, log: &log, flow: &flow, scale, bright, pitch: self.params.pitch, keep_back };
                self.windows(&scene, span, period_ns)
            };
            let of_picture = |windows: &[Window], keep_back: bool, row: &Row, x: usize, threshold: f64, hints: &mut Vec<Hint>| {
                let (y, count) = (row.row as usize, row.frames_of(x).len());
                let known = row.frames_of(x).iter().enumerate().filter(|(l, _)| !(keep_back && is_kept_back(*l, count)));
                let frames: Vec<MapFrame> = known.map(|(_, frame)| *frame).collect();
                let say = |t_ns: i64| foretell(windows, x, y, t_ns);
                Trust::new(Known::Change).hints(say, &log, (x, y), (row.span(), step_ns), row.events_of(x), &frames, threshold, hints);
            };
            // First without the frames that are kept back: do they come out better with the picture than without?
            let windows = pictures(&again.rows, true);
            let caution = again.caution(|row, x, threshold, hints| of_picture(&windows, true, row, x, threshold, hints));
            if round == self.params.rounds && caution.believes_some() {
                again.widen(|row, x, threshold, hints| {
                    of_picture(&windows, true, row, x, threshold, hints);
                    take_care(hints, caution.at(x, row.row as usize));
                });
            }
            let windows = if caution.believes_some() { pictures(&again.rows, false) } else { Vec::new() };
            tracks = again.solve(cx, round == self.params.rounds, |row, x, threshold, hints| {
                of_picture(&windows, false, row, x, threshold, hints);
                take_care(hints, caution.at(x, row.row as usize));
                if self.params.neighbours {
                    let mut said = Vec::new();
                    advect::hints(&log, &flow, row, x, step_ns, threshold, &mut said);
                    join(hints, &said);
                }
            })?;
        }
        Ok(Out { tracks: TrackSet::in_memory(Arc::new(again.meta), tracks) })
    }
}

impl RefinePicture {
    /// The pictures of overlapping windows, in order of time.
    fn windows(&self, scene: &Scene<'_>, span: (i64, i64), period_ns: i64) -> Vec<Window> {
        let length = i64::min(i64::from(self.params.frames) * period_ns, span.1 - span.0);
        if length <= 0 {
            return Vec::new();
        }
        let apart = i64::max(length / OVERLAP, 1);
        let count = (span.1 - span.0 - length) / apart + 1;
        let first = span.0 + (span.1 - span.0 - (count - 1) * apart) / 2;
        (0..count).into_par_iter().filter_map(|n| Window::fit(scene, first + n * apart, length / 2)).collect()
    }
}

/// The mean time from frame to frame, ns; 0 for fewer than two frames.
fn period_ns(frames: &FrameSequence) -> i64 {
    let last = frames.len().saturating_sub(1);
    let start = |l: usize| frames.meta.times.exposure(l, 0).start.0;
    if last == 0 { 0 } else { (start(last) - start(0)) / last as i64 }
}

/// The geometric mean: what a typical photocurrent is.
fn typical(photocurrent: &[f32]) -> f64 {
    let sum: f64 = photocurrent.iter().map(|&i| libm::log(f64::max(f64::from(i), f64::MIN_POSITIVE))).sum();
    libm::exp(sum / usize::max(photocurrent.len(), 1) as f64)
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
        }
        same
    });
}

/// What the pictures around an instant say of a pixel, each by how near its middle is.
fn foretell(windows: &[Window], x: usize, y: usize, t_ns: i64) -> Option<Said> {
    let after = windows.partition_point(|window| window.middle_ns <= t_ns);
    let say = |n: usize| windows.get(n).and_then(|window| window.log_at(x, y, t_ns));
    let (early, late) = (after.checked_sub(1).and_then(say), say(after));
    match (early, late) {
        (Some(early), Some(late)) => {
            let (from, to) = (windows[after - 1].middle_ns, windows[after].middle_ns);
            let share = (t_ns - from) as f64 / (to - from) as f64;
            let apart = late - early;
            Some(Said { t_ns, log: early + share * apart, contradiction: Some(share * (1.0 - share) * apart * apart) })
        }
        (Some(log), None) | (None, Some(log)) => Some(Said { t_ns, log, contradiction: None }),
        (None, None) => None,
    }
}
