//! Selects pixels and frames where a blend of the frames before and after predicts better than tracks do.
//!
//! With a wrong description, or where events were lost, events can worsen a solution. So all pixels (of a
//! large sensor every second or third, of as many rows) predict each of their frames but the first and the
//! last from the others, by the solution and by two blends: of the pixel's own values before and after,
//! weighted by time, and of those along the motion. Squared errors are pooled over a neighbourhood. Where the
//! error of a blend is clearly smaller, by more than the noise of the frames, light around that frame is that
//! blend.
//!
//! Frames alone do not decide: an edge that passes often leaves similar frames, and a blend of two predicts a
//! third but not the light between. There the solution explains the events. A blend is used only where it
//! does not.
//!
//! Limits: a frame is predicted over twice the time between two frames, over which a blend loses more than a
//! solution does, so blends are used too seldom rather than too often. A saturated value enters a blend as it
//! is. The motion comes from tracks that were solved with the frame.

use super::again::{LoadedRecording, LoadedRow};
use super::pseudo_measurement::SolverSensor;
use photocurrent_core::handle::Band;
use photocurrent_core::{Extent, TrackBand};
use photocurrent_scene::flow::Flow;
use photocurrent_scene::hue::MotionPath;
use photocurrent_scene::image::{Image, smooth};
use photocurrent_sensor::exposure::DigitalNumber;
use photocurrent_sensor::map::estimate::{FEWEST_FRAMES, HoldOut};
use photocurrent_sensor::map::{Hint, MapFrame};
use rayon::prelude::*;

/// Of a sensor of more pixels every second of every second row is tried, and of the largest every third.
const LARGE: [usize; 2] = [20_000, 400_000];
/// Standard deviation of the neighbourhood that decides, pixels.
const NEIGHBOURHOOD: f64 = 2.0;
/// Least reduction of the squared error by a blend, as a share of the solution's, ...
const CLEAR_GAIN: f64 = 0.3;
/// ... and in variances of a frame value.
const NOISE: f64 = 2.0;
/// Least residual of the events with the solution, root mean square, thresholds: an edge that passes often
/// leaves similar frames, and a blend of them predicts the next, but not the events.
const UNEXPLAINED: f64 = 0.2;
/// Of fewer frames each is held out in turn, else one in three.
const FEW_FRAMES: usize = 6;
/// Upper bound of a squared relative error.
const LARGEST: f64 = 1.0;
/// Added to the light that an error is relative to, as a part of the brightest.
const DARK: f64 = 0.1;
/// Knots of a blend lie at most so far apart, ns.
const KNOTS_NS: i64 = 1_000_000;
/// A blend is no darker than this part of the brightest light that a frame shows.
const LEAST: f64 = 1e-3;

/// A blend.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Blend {
    /// Of the pixel's own values.
    Own,
    /// Of the values to which the motion leads.
    Moved,
}

/// The blends, in the order of weights.
const BLENDS: [Blend; 2] = [Blend::Own, Blend::Moved];

/// Squared relative errors of a pixel's frame, by the solution and by each blend; and the variance of its
/// value.
#[derive(Clone, Copy)]
struct FrameErrors {
    frame: usize,
    solution: f64,
    blends: [f64; 2],
    noise: f64,
}

/// Photocurrent of frames, effects added, and the exposure of each of their rows.
struct FramePhotocurrents {
    extent: Extent,
    light: Vec<Image>,
    /// The middle of each frame's exposure in each row, ns.
    mid_ns: Vec<Vec<i64>>,
    number: DigitalNumber,
    /// Constant that is added to the light to which an error is relative.
    dark: f64,
    /// The least light that a blend may have.
    least: f64,
}

/// The better predictor of each frame and pixel.
pub(super) struct Fallback<'a> {
    frames: FramePhotocurrents,
    path: MotionPath<'a>,
    /// Weights of both blends around each frame, of every pixel; empty where neither is better anywhere.
    weights: Vec<[Vec<f32>; 2]>,
}

impl<'a> Fallback<'a> {
    /// Evaluates all pixels. `left`: residual of each pixel's events, thresholds. `hints_of`:
    /// pseudo-measurements from the frames that it receives. `None` where no frame can be held out, or the
    /// pixels differ in their frames.
    pub(crate) fn evaluate(
        again: &mut LoadedRecording,
        (flow, left): (&'a Flow, &[f32]),
        hints_of: impl Fn(&LoadedRow, usize, &[MapFrame], f64, &mut Vec<Hint>) + Sync,
    ) -> Option<Fallback<'a>> {
        let extent = again.meta.extent;
        let (frames, path) = (FramePhotocurrents::new(again)?, MotionPath::new(flow));
        let count = frames.light.len();
        let every = if count < FEW_FRAMES { count } else { 3 };
        let holds: Vec<HoldOut> = (0..every).map(|first| HoldOut { every, first }).collect();
        let pitch = 1 + LARGE.iter().filter(|large| extent.pixels() > **large).count();
        let missed = again.predictions(pitch, &holds, hints_of, |row, x, predicted| {
            let of =
                |(l, dn)| frames.frame_errors((x, row.row as usize), &row.frames_of(x)[l], (l, dn), &path);
            predicted.into_iter().map(of).collect()
        });
        let unexplained = smooth(left, extent.width as usize, extent.height as usize, NEIGHBOURHOOD);
        let weights =
            (0..count).into_par_iter().map(|l| choose((&missed, &unexplained), l, extent, pitch)).collect();
        let mut fallback = Fallback { frames, path, weights };
        fallback.extend_to_borders();
        Some(fallback)
    }

    /// The first and the last frame, which are not predicted, get the predictor of the next one.
    fn extend_to_borders(&mut self) {
        let last = self.weights.len() - 1;
        self.weights[0] = self.weights[1].clone();
        self.weights[last] = self.weights[last - 1].clone();
        if self.weights.iter().flatten().flatten().all(|weight| *weight == 0.0) {
            self.weights.clear();
        }
    }

    /// Share of all light, by pixel and frame, that is a blend.
    pub(crate) fn blended_share(&self) -> f64 {
        let weights = self.weights.iter().flatten().flatten();
        let sum: f64 = weights.map(|weight| f64::from(*weight)).sum();
        sum / (self.frames.light.len() * self.frames.extent.pixels()) as f64
    }

    /// Tracks with the blends applied; standard deviations are widened by half the difference.
    pub(crate) fn apply(&self, tracks: TrackBand, sensor: &SolverSensor, with_sigma: bool) -> TrackBand {
        if self.weights.is_empty() {
            return tracks;
        }
        let width = self.frames.extent.width;
        let row = |y: u32| {
            let mut out = TrackBand::begin(y, width);
            let mut knots = Vec::new();
            for x in 0..width {
                self.pixel(&tracks, (x, y), sensor, &mut knots);
                let knots = knots.iter().copied();
                if with_sigma {
                    out.push_with_sigma(knots);
                } else {
                    out.push(knots.map(|(t, light, _)| (t, light)));
                }
            }
            out.shrunk()
        };
        let rows: Vec<TrackBand> = tracks.rows().iter().into_par_iter().map(row).collect();
        TrackBand::concat(rows)
    }

    /// The knots of a pixel: time, photocurrent, standard deviation of its logarithm.
    fn pixel(
        &self,
        tracks: &TrackBand,
        (x, y): (u32, u32),
        sensor: &SolverSensor,
        out: &mut Vec<(i64, f32, f32)>,
    ) {
        let track = tracks.pixel(x, y);
        let sigma = |k: usize| track.sigma.get(k).copied().unwrap_or(0.0);
        out.clear();
        let own = |k: usize| (track.t[k], track.photocurrent[k], sigma(k));
        let at = (y * self.frames.extent.width + x) as usize;
        let blended = self.weights.iter().any(|of_frame| of_frame.iter().any(|of_blend| of_blend[at] > 0.0));
        if !blended || track.t.is_empty() {
            out.extend((0..track.t.len()).map(own));
            return;
        }
        let log = |k: usize| libm::log(f64::max(f64::from(track.photocurrent[k]), f64::MIN_POSITIVE));
        let (x, y) = (x as usize, y as usize);
        for k in 0..track.t.len() {
            let (t, light, own_sigma) = own(k);
            let correction = |t: i64, log: f64| self.correction((x, y), t, log, sensor);
            match correction(t, log(k)) {
                Some(by) => out.push(shifted_knot(t, log(k) + by, own_sigma, by)),
                None => out.push((t, light, own_sigma)),
            }
            let Some(&next) = track.t.get(k + 1) else { break };
            // A blend is not log-linear between the knots of the track.
            let parts = (next - t).div_euclid(KNOTS_NS) + 1;
            for n in 1..parts {
                let share = n as f64 / parts as f64;
                let (between, t) = (log(k) + share * (log(k + 1) - log(k)), t + (next - t) * n / parts);
                let wide = own_sigma + share as f32 * (sigma(k + 1) - own_sigma);
                out.extend(correction(t, between).map(|by| shifted_knot(t, between + by, wide, by)));
            }
        }
    }

    /// Correction of a pixel's log light at an instant; `None` where no blend is used.
    fn correction(&self, (x, y): (usize, usize), t_ns: i64, log: f64, sensor: &SolverSensor) -> Option<f64> {
        let (before, after, share) = self.frames.bracketing_frames(y, t_ns);
        let at = y * self.frames.extent.width as usize + x;
        let mut correction = None;
        for (n, blend) in BLENDS.into_iter().enumerate() {
            let of = |frame: usize| f64::from(self.weights[frame][n][at]);
            let weight = (1.0 - share) * of(before) + share * of(after);
            if weight > 0.0 {
                let light = self.frames.blend(blend, (x, y), t_ns, (before, after), &self.path);
                let light = f64::max(light - sensor.added, self.frames.least);
                correction = Some(correction.unwrap_or(0.0) + weight * (libm::log(light) - log));
            }
        }
        correction
    }
}

/// A knot whose logarithm was moved: its standard deviation is wider by half of that.
fn shifted_knot(t_ns: i64, log: f64, sigma: f32, by: f64) -> (i64, f32, f32) {
    (t_ns, libm::exp(log) as f32, libm::hypot(f64::from(sigma), 0.5 * by) as f32)
}

impl FramePhotocurrents {
    fn new(again: &LoadedRecording) -> Option<FramePhotocurrents> {
        let extent = again.meta.extent;
        let number = again.sensor().model.number;
        let count = again.rows.first()?.frames_of(0).len();
        let all = |row: &LoadedRow| (0..extent.width as usize).all(|x| row.frames_of(x).len() == count);
        if count < FEWEST_FRAMES || !again.rows.iter().all(all) {
            return None;
        }
        let picture = |l: usize| {
            let light = |frame: &MapFrame| (number.integral(frame.dn) / seconds(frame)) as f32;
            let row = |row: &'_ LoadedRow| -> Vec<f32> {
                (0..extent.width as usize).map(|x| light(&row.frames_of(x)[l])).collect()
            };
            let values: Vec<f32> = again.rows.iter().flat_map(row).collect();
            Image { width: extent.width as usize, height: extent.height as usize, values }
        };
        let light: Vec<Image> = (0..count).into_par_iter().map(picture).collect();
        let mid = |row: &LoadedRow, l: usize| {
            let frame = &row.frames_of(0)[l];
            frame.start_ns + (frame.end_ns - frame.start_ns) / 2
        };
        let mid_ns = (0..count).map(|l| again.rows.iter().map(|row| mid(row, l)).collect()).collect();
        let most = light.iter().flat_map(|image| &image.values).fold(0.0_f32, |most, v| f32::max(most, *v));
        (most > 0.0).then(|| {
            let most = f64::from(most);
            FramePhotocurrents { extent, light, mid_ns, number, dark: DARK * most, least: LEAST * most }
        })
    }

    /// The frames before and after an instant, and the share of the later one.
    fn bracketing_frames(&self, y: usize, t_ns: i64) -> (usize, usize, f64) {
        let after = self.mid_ns.partition_point(|rows| rows[y] <= t_ns);
        let last = self.mid_ns.len() - 1;
        if after == 0 || after > last {
            let end = usize::min(after, last);
            return (end, end, 0.0);
        }
        let (from, to) = (self.mid_ns[after - 1][y], self.mid_ns[after][y]);
        (after - 1, after, (t_ns - from) as f64 / (to - from) as f64)
    }

    /// Light of a blend of two frames at an instant.
    fn blend(
        &self,
        blend: Blend,
        (x, y): (usize, usize),
        t_ns: i64,
        (before, after): (usize, usize),
        path: &MotionPath<'_>,
    ) -> f64 {
        let own = |frame: usize| f64::from(self.light[frame].values[y * self.extent.width as usize + x]);
        let read = |frame: usize| match blend {
            Blend::Own => own(frame),
            Blend::Moved => {
                let (x, y) = path.follow((x as f64, y as f64), t_ns, self.mid_ns[frame][y]);
                self.light[frame].sample(x, y).map_or_else(|| own(frame), |(light, ..)| light)
            }
        };
        if before == after {
            return read(before);
        }
        let (from, to) = (self.mid_ns[before][y], self.mid_ns[after][y]);
        let share = (t_ns - from) as f64 / (to - from) as f64;
        (1.0 - share) * read(before) + share * read(after)
    }

    /// Errors of frame l of a pixel; the solution predicts `dn`.
    fn frame_errors(
        &self,
        (x, y): (usize, usize),
        frame: &MapFrame,
        (l, dn): (usize, f64),
        path: &MotionPath<'_>,
    ) -> FrameErrors {
        let seen = f64::from(self.light[l].values[y * self.extent.width as usize + x]);
        let light = |dn: f64| self.number.integral(dn) / seconds(frame);
        let relative = |by: f64| {
            let part = by / (f64::max(seen, 0.0) + self.dark);
            f64::min(part * part, LARGEST)
        };
        let t_ns = self.mid_ns[l][y];
        let of_blend = |blend: Blend| relative(self.blend(blend, (x, y), t_ns, (l - 1, l + 1), path) - seen);
        FrameErrors {
            frame: l,
            solution: relative(light(dn) - light(frame.dn)),
            blends: BLENDS.map(of_blend),
            noise: relative(light(frame.dn + frame.sigma_dn) - light(frame.dn)),
        }
    }
}

/// Length of an exposure, s.
fn seconds(frame: &MapFrame) -> f64 {
    (frame.end_ns - frame.start_ns) as f64 * 1e-9
}

/// The weights of both blends around frame l, of every pixel: 0 or 1, smooth between.
fn choose(
    (missed, unexplained): (&[Vec<Vec<FrameErrors>>], &[f32]),
    l: usize,
    extent: Extent,
    pitch: usize,
) -> [Vec<f32>; 2] {
    let (columns, lines) = (missed.first().map_or(0, Vec::len), missed.len());
    let of = |value: &dyn Fn(&FrameErrors) -> f64| -> Vec<f32> {
        let here = |pixel: &Vec<FrameErrors>| {
            pixel.iter().find(|missed| missed.frame == l).map_or(0.0, |missed| value(missed) as f32)
        };
        let values: Vec<f32> = missed.iter().flatten().map(here).collect();
        smooth(&values, columns, lines, NEIGHBOURHOOD / pitch as f64)
    };
    let solution = of(&|missed| missed.solution);
    let noise = of(&|missed| missed.noise);
    let blends = [of(&|missed| missed.blends[0]), of(&|missed| missed.blends[1])];
    let better = |n: usize, at: usize| {
        let (own, other) = (blends[n][at], blends[1 - n][at]);
        let gain = solution[at] - own;
        let clear = f32::max(CLEAR_GAIN as f32 * solution[at], NOISE as f32 * noise[at]);
        let (x, y) = (at % columns * pitch, at / columns * pitch);
        // The plain blend where both are alike.
        gain > clear
            && unexplained[y * extent.width as usize + x] > UNEXPLAINED as f32
            && (own < other || (n == 0 && own == other))
    };
    [0, 1].map(|n| {
        let chosen: Vec<f32> = (0..columns * lines).map(|at| f32::from(u8::from(better(n, at)))).collect();
        if chosen.iter().all(|chosen| *chosen == 0.0) {
            return vec![0.0; extent.pixels()];
        }
        let image = Image { width: columns, height: lines, values: smooth(&chosen, columns, lines, 1.0) };
        let pixel = |at: usize| {
            let (x, y) = (at % extent.width as usize, at / extent.width as usize);
            let inside = |at: usize, count: usize| f64::min(at as f64 / pitch as f64, (count - 1) as f64);
            image.sample(inside(x, columns), inside(y, lines)).map_or(0.0, |(weight, ..)| weight as f32)
        };
        (0..extent.pixels()).map(pixel).collect()
    })
}
