//! The joint problem at the present picture: rows with residuals, and the normal equations.

use super::events::{self, OfEvents};
use super::fields::GridFields;
use super::lines::SparseRows;
use super::normal::{NormalFactor, NormalSums};
use super::prior::DifferencePrior;
use crate::block::Block;
use crate::case::Case;
use crate::free::{PixelPrediction, SceneNoise, is_rising, rise};
use crate::moving::MovingPicture;
use crate::nominal::Nominal;
use crate::picture::motion::{DEGREES, RIGID};
use crate::picture::{MOTION_WEIGHT, PictureSetting, ROBUST, STRETCH, ScenePicture};
use crate::statistics::NU;
use std::ops::Range;
use std::sync::Arc;

/// Largest distance, in coefficients along an axis, between the two places of an event that is used.
const REACH: usize = 11;
/// Largest misfit of an event that is used, thresholds.
const FAR: f64 = 3.0;
/// Standard deviations of a step of motion, pixels, and of shading.
pub(super) const STEP_OF_MOTION: f64 = 0.12;
pub(super) const STEP_OF_SHADING: f64 = 0.002;

/// Frame values as rows.
pub(super) struct FrameRows {
    lines: SparseRows,
    /// Which frame value each is, [frame][y][x].
    index: Vec<u32>,
    weight: Vec<f64>,
    sums: NormalSums,
}

/// Rows with residuals: frame values, then events, then the log slopes at events. An event's time is the
/// measurement, so the density of times is that of excesses times the slope. Without that factor a picture
/// that its prior smooths is as probable as a steeper one, and thresholds are estimated too small.
pub(super) struct JointRows {
    pub of_frames: Arc<FrameRows>,
    pub events: SparseRows,
    pub rises: SparseRows,
    /// Pixel of each row, by its place.
    pub place: Vec<u32>,
    /// Which of the pixel's predicted frame values, or events, it is or ends in.
    pub number: Vec<u32>,
    pub residual: Vec<f64>,
    /// 0: takes no part.
    pub weight: Vec<f64>,
}

impl JointRows {
    /// Number of frame values, behind which events follow.
    pub(super) fn frames(&self) -> usize {
        self.of_frames.lines.len()
    }

    pub(super) fn rows(&self) -> usize {
        self.weight.len()
    }

    /// Rows of events.
    pub(super) fn event_rows(&self) -> Range<usize> {
        self.frames()..self.frames() + self.events.len()
    }

    /// A row among those of its kind.
    fn line(&self, r: usize) -> (&SparseRows, usize) {
        let of_events = self.event_rows();
        if r < of_events.start {
            (&self.of_frames.lines, r)
        } else if r < of_events.end {
            (&self.events, r - of_events.start)
        } else {
            (&self.rises, r - of_events.end)
        }
    }

    /// Derivative of row `r` along a step of all unknowns.
    pub(super) fn directional_derivative(&self, r: usize, step: &[f64], picture: usize) -> f64 {
        let (lines, line) = self.line(r);
        lines.directional_derivative(line, step, picture)
    }

    /// Adds row `r` times a factor to a vector of all unknowns.
    pub(super) fn add_row(&self, r: usize, factor: f64, to: &mut [f64], picture: usize) {
        let (lines, line) = self.line(r);
        lines.add_row(line, factor, to, picture);
    }

    /// Index of a row in the columns of its pixel.
    pub(super) fn row_of(&self, r: usize, predicted: &[PixelPrediction]) -> usize {
        let (number, of) = (self.number[r] as usize, &predicted[self.place[r] as usize]);
        let of_events = self.event_rows();
        let before = usize::from(r >= of_events.start) * of.frames.len()
            + usize::from(r >= of_events.end) * of.events.len();
        before + number
    }

    /// Rows that take part.
    pub(super) fn used(&self) -> impl Iterator<Item = usize> {
        (0..self.rows()).filter(|r| self.weight[*r] > 0.0)
    }
}

/// Number of coefficients along an axis that a frame value of a picture covers.
pub(super) fn coefficients_per_line(
    case: &Case,
    nominal: &Nominal,
    picture: &ScenePicture,
    setting: &PictureSetting,
    block: &Block,
) -> usize {
    let (laid, fields) =
        (picture.rows_of_block(case, nominal, setting, block), GridFields::from_picture(picture));
    let lines = SparseRows::from_frame_rows(&laid, &fields, picture.motion.knots.len());
    let (columns, rows) = NormalSums::reach_of(&lines, fields.width());
    (columns / fields.count).max(rows)
}

/// The present picture, with the weights of its rows.
#[derive(Clone, Copy)]
pub(super) struct CurrentPicture<'a> {
    pub case: &'a Case,
    pub nominal: &'a Nominal,
    pub scene: &'a MovingPicture,
    /// The part of the array, its pixels, and of each pixel of the array its place among them.
    pub block: &'a Block,
    pub pixels: &'a [u32],
    pub place_of: &'a [u32],
    /// Of each of them: do its events take part?
    pub is_trained: &'a [bool],
    pub noise: &'a SceneNoise,
    pub prior: &'a DifferencePrior,
    /// Rows of frame values, where these are kept.
    pub frames: Option<&'a Arc<FrameRows>>,
}

impl CurrentPicture<'_> {
    pub(super) fn picture(&self) -> &ScenePicture {
        &self.scene.picture
    }

    /// The picture's fields.
    pub(super) fn fields(&self) -> GridFields {
        GridFields::from_picture(self.picture())
    }

    /// Number of the picture's coefficients.
    pub(super) fn coefficients(&self) -> usize {
        self.fields().coefficients()
    }

    /// All unknowns: the picture's coefficients, then the rest.
    pub(super) fn unknowns(&self) -> Vec<f64> {
        let mut all = self.fields().unknowns(&self.picture().surface);
        all.extend(self.picture().motion_and_shading());
        all
    }

    /// The place of the pixel that a frame value, [frame][y][x], is of.
    fn place_of(&self, at: u32) -> usize {
        self.place_of[at as usize % self.case.extent.pixels()] as usize
    }

    /// Rows of frame values at the present picture.
    pub(super) fn frame_rows(&self, predicted: &[PixelPrediction], places: &[u32]) -> FrameRows {
        let picture = self.picture();
        let laid = picture.rows_of_block(self.case, self.nominal, &self.scene.setting, self.block);
        let fields = self.fields();
        let lines = SparseRows::from_frame_rows(&laid, &fields, picture.motion.knots.len());
        let weight = |at: &u32| {
            let frame = predicted[self.place_of(*at)].frames.get(places[*at as usize] as usize);
            frame.map_or(0.0, |frame| {
                let variance = self.noise.frame_variance(frame.signal_dn);
                1.0 / variance / (1.0 + frame.residual_dn * frame.residual_dn / variance / (ROBUST * ROBUST))
            })
        };
        let weight: Vec<f64> = laid.index.iter().map(weight).collect();
        let mut reach = NormalSums::reach_of(&lines, fields.width());
        reach = (reach.0.max(fields.count * (REACH + 5) - 1), reach.1.max(REACH + 4));
        let mut sums =
            NormalSums::new(fields.width(), fields.coefficients(), picture.motion_and_shading().len(), reach);
        sums.add_all(&lines, &weight);
        FrameRows { lines, index: laid.index, weight, sums }
    }

    /// All rows at the present picture, with residuals and weights.
    pub(super) fn problem(&self, predicted: &[PixelPrediction]) -> JointRows {
        let places = self.frame_places(predicted);
        let of_frames = self.frames.cloned().unwrap_or_else(|| Arc::new(self.frame_rows(predicted, &places)));
        let frames = of_frames.lines.len();
        let (mut place, mut number) = (Vec::with_capacity(frames), Vec::with_capacity(frames));
        let (mut residual, mut weight) = (Vec::with_capacity(frames), of_frames.weight.clone());
        for at in &of_frames.index {
            let (of, n) = (self.place_of(*at), places[*at as usize]);
            place.push(of as u32);
            number.push(n);
            residual.push(predicted[of].frames.get(n as usize).map_or(0.0, |frame| frame.residual_dn));
        }
        let OfEvents { lines: events, rises, of } =
            events::lines(self.case, self.picture(), (self.pixels, predicted), REACH);
        for (of, k, is_near) in &of {
            let event = &predicted[*of as usize].events[*k as usize];
            let variance = self.noise.event_variance(event);
            let takes_part =
                *is_near && self.is_trained[*of as usize] && event.excess.abs() < FAR * event.threshold;
            place.push(*of);
            number.push(*k);
            residual.push(event.excess);
            let full = (NU + 1.0) / variance / (NU + event.excess * event.excess / variance);
            weight.push(if takes_part { full } else { 0.0 });
        }
        for (n, (of, k, _)) in of.iter().enumerate() {
            let event = &predicted[*of as usize].events[*k as usize];
            place.push(*of);
            number.push(*k);
            residual.push(-1.0);
            let takes_part = weight[frames + n] > 0.0 && is_rising(event);
            weight.push(if takes_part { self.noise.share_of_thresholds(event) } else { 0.0 });
        }
        JointRows { of_frames, events, rises, place, number, residual, weight }
    }

    /// Which of a pixel's predicted frame values each frame value is, [frame][y][x].
    pub(super) fn frame_places(&self, predicted: &[PixelPrediction]) -> Vec<u32> {
        let pixels = self.case.extent.pixels();
        let mut places = vec![u32::MAX; self.case.frame_count() * pixels];
        let Some(frames) = &self.case.frames else { return places };
        for (pixel, predicted) in self.pixels.iter().zip(predicted) {
            let pixel = *pixel as usize;
            let row = self.case.pixel_place(pixel).1;
            let mut k = 0;
            for l in 0..self.case.frame_count() {
                let start = frames.times.exposure(l, row).start.0;
                if predicted.frames.get(k).is_some_and(|frame| frame.start_ns == start) {
                    places[l * pixels + pixel] = k as u32;
                    k += 1;
                }
            }
        }
        places
    }

    /// Weights of the motion's and the shading's priors: unknowns of the rest, factors, weight.
    pub(super) fn each_of_rest(&self, mut with: impl FnMut(&[usize], &[f64], f64)) {
        let knots = self.picture().motion.knots.len();
        for k in 1..knots.saturating_sub(1) {
            for d in 0..DEGREES {
                let at = [(k - 1) * DEGREES + d, k * DEGREES + d, (k + 1) * DEGREES + d];
                with(&at, &[1.0, -2.0, 1.0], MOTION_WEIGHT * MOTION_WEIGHT);
            }
        }
        let rest = self.picture().motion_and_shading();
        for n in 0..rest.len() {
            if n >= knots * DEGREES {
                with(&[n], &[1.0], 1.0);
            } else if n % DEGREES >= RIGID {
                with(&[n], &[1.0], 1.0 / (STRETCH * STRETCH));
            }
        }
    }

    /// The factor of the normal equations; none where they are singular.
    pub(super) fn factored(&self, problem: &JointRows) -> Option<NormalFactor> {
        let (fields, rest) = (self.fields(), self.picture().motion_and_shading().len());
        let mut sums = problem.of_frames.sums.clone();
        let of_events = problem.event_rows();
        sums.add_all(&problem.events, &problem.weight[of_events.clone()]);
        sums.add_all(&problem.rises, &problem.weight[of_events.end..]);
        self.prior.for_each_difference(&fields, |at, by, weight| sums.add_picture(at, by, weight));
        self.each_of_rest(|at, by, weight| sums.add_rest(at, by, weight));
        let motion = self.picture().motion.knots.len() * DEGREES;
        for n in 0..rest {
            let step = if n < motion { STEP_OF_MOTION } else { STEP_OF_SHADING };
            sums.add_rest(&[n], &[1.0], 1.0 / (step * step));
        }
        sums.factor()
    }

    /// J'W rho and the pull of the priors.
    pub(super) fn gradient(&self, problem: &JointRows) -> Vec<f64> {
        let fields = self.fields();
        let (count, now) = (fields.coefficients(), self.unknowns());
        let mut gradient = vec![0.0; now.len()];
        for r in problem.used() {
            problem.add_row(r, problem.weight[r] * problem.residual[r], &mut gradient, count);
        }
        let pull = |first: usize, gradient: &mut Vec<f64>, at: &[usize], by: &[f64], weight: f64| {
            let value: f64 = at.iter().zip(by).map(|(at, by)| by * now[first + at]).sum();
            at.iter().zip(by).for_each(|(at, by)| gradient[first + at] += weight * value * by);
        };
        self.prior.for_each_difference(&fields, |at, by, weight| pull(0, &mut gradient, at, by, weight));
        self.each_of_rest(|at, by, weight| pull(count, &mut gradient, at, by, weight));
        gradient
    }

    /// Objective of the steps: misfit of frames and of event times under the present noise, and roughness.
    pub(super) fn objective(&self, predicted: &[PixelPrediction]) -> f64 {
        let (fields, now) = (self.fields(), self.unknowns());
        let of_frames = |of: &PixelPrediction| -> f64 {
            of.frames
                .iter()
                .map(|frame| {
                    let variance = self.noise.frame_variance(frame.signal_dn);
                    0.5 * ROBUST
                        * ROBUST
                        * libm::log1p(frame.residual_dn * frame.residual_dn / variance / (ROBUST * ROBUST))
                })
                .sum()
        };
        let of_events = |of: &PixelPrediction| -> f64 {
            of.events
                .iter()
                .map(|event| {
                    let far = FAR * event.threshold;
                    let excess = event.excess.clamp(-far, far);
                    let variance = self.noise.event_variance(event);
                    0.5 * (NU + 1.0) * libm::log1p(excess * excess / variance / NU)
                        + 0.5 * libm::log(variance)
                        - libm::log(rise(event))
                })
                .sum()
        };
        let mut sum: f64 = predicted.iter().map(of_frames).sum();
        sum += predicted
            .iter()
            .zip(self.is_trained)
            .filter(|(_, is)| **is)
            .map(|(of, _)| of_events(of))
            .sum::<f64>();
        let count = fields.coefficients();
        let mut rough = |first: usize, at: &[usize], by: &[f64], weight: f64| {
            let value: f64 = at.iter().zip(by).map(|(at, by)| by * now[first + at]).sum();
            sum += 0.5 * weight * value * value;
        };
        self.prior.for_each_difference(&fields, |at, by, weight| rough(0, at, by, weight));
        self.each_of_rest(|at, by, weight| rough(count, at, by, weight));
        sum
    }
}
