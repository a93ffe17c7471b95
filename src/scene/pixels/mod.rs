//! Light of pixels, each free in time: a scene without one motion.
//!
//! Log light of each pixel is a smooth function of time of its own (a cubic B-spline). It is estimated from
//! the pixel's frame values **and** events: so, unlike a [`crate::Scene`], it is not independent of the
//! events, and an effect of the sensor is in part absorbed by it. How much is known: [`FreeScene::score`]
//! subtracts from the score of every effect, and from its information, what the light would take over.
//!
//! - Unknowns: coefficients c of each pixel. Rows: events, e = V(t) - V_ref - p theta; frame values.
//! - The event's time is what is measured, so that its density has the slope of the voltage as a factor:
//!   -log(p dV/dt) for each event. Without it contrasts shrink.
//! - Where a pixel has no event, its voltage lies within both thresholds: Phi(-excess / noise) for the
//!   instant of each stretch between events at which one is nearest.
//! - Prior: second differences of c are normal with a variance of their own each, which follows the activity
//!   of the scene (`prior`).
//! - Noise of events: Student-t with three degrees of freedom, a share of the threshold and a part that grows
//!   with the slope; of frame values: a constant and a part that grows with the signal.
//!
//! With H the normal matrix, g the gradient, B the columns of effects, W the weights and G = J'W B:
//! score = B'W rho - G' H^-1 g, information = B'W B - G' H^-1 G, both summed over pixels.
//! The caller predicts events and frame values, at any sensor: only derivatives are taken here.

mod envelope;
mod path;
mod prior;
mod step;

use crate::block::Block;
use crate::case::Case;
use crate::free::{FreeScene, PixelPrediction, SceneNoise, Score};
use crate::light::LogLight;
use crate::nominal::Nominal;
use crate::statistics::MEDIAN_T;
use path::TimeSplines;
use photocurrent_core::time::between;
use rayon::prelude::*;
pub use step::LEAST_RISE;
use step::{PixelStep, PixelView, PixelWork};

/// Standard deviation of second differences before anything is known, natural-log units.
const FIRST_DEVIATION: f64 = 0.03;
/// Rounds before the prior is estimated.
const ROUNDS_BEFORE_PRIOR: usize = 2;
/// And before the noise of events is.
const ROUNDS_BEFORE_NOISE: usize = 4;
/// And before the share of missing events stays as it is: effects are compared at the same share.
const ROUNDS_OF_MISSING: usize = 10;

/// The light of some pixels.
#[derive(Clone, Debug)]
pub struct PixelLight {
    splines: TimeSplines,
    blocks: Vec<Block>,
    /// Pixels (`y * width + x` of the array), block after block, row by row.
    pixels: Vec<u32>,
    /// Of each pixel, one after another.
    coefficients: Vec<f64>,
    /// Of second differences, likewise.
    variance: Vec<f64>,
    /// Of the measurements.
    noise: SceneNoise,
    rounds: usize,
    /// Of the last round: leverages of events, pixel by pixel.
    leverage: Vec<Vec<f64>>,
}

impl PixelLight {
    /// From the log frame values, linear between. `step_ns`: step of the predicted light; `per_knot`: number
    /// of steps between knots. Blocks do not overlap.
    ///
    /// # Panics
    /// Without frames, or for blocks outside of the array.
    pub fn new(
        case: &Case,
        nominal: &Nominal,
        blocks: Vec<Block>,
        (step_ns, per_knot): (i64, usize),
        noise: SceneNoise,
    ) -> PixelLight {
        let instants = LogLight::instants(case, step_ns).count();
        let splines = TimeSplines::new(case.span.0, step_ns, instants, per_knot);
        let pixels: Vec<u32> = blocks.iter().flat_map(|block| block.pixels(case.extent)).collect();
        let begin = |pixel: &u32| coefficients_from_frames(case, nominal, &splines, *pixel as usize);
        let coefficients: Vec<f64> = pixels.par_iter().flat_map_iter(begin).collect();
        let seconds = pixels.len() * (splines.coefficients() - 2);
        PixelLight {
            splines,
            blocks,
            pixels,
            coefficients,
            variance: vec![FIRST_DEVIATION * FIRST_DEVIATION; seconds],
            noise,
            rounds: 0,
            leverage: Vec::new(),
        }
    }

    fn pixel_view<'a>(&'a self, place: usize, predicted: &'a PixelPrediction) -> PixelView<'a> {
        let count = self.splines.coefficients();
        PixelView {
            splines: &self.splines,
            coefficients: &self.coefficients[place * count..(place + 1) * count],
            variance: &self.variance[place * (count - 2)..(place + 1) * (count - 2)],
            noise: &self.noise,
            predicted,
        }
    }

    /// The work on every pixel, in their order; `work` also takes the pixel's place.
    fn map_pixels<T: Send>(
        &self,
        predicted: &[PixelPrediction],
        work: impl Fn(&mut PixelWork, &PixelView<'_>, usize) -> T + Sync,
    ) -> Vec<T> {
        let of =
            |room: &mut PixelWork, (place, predicted)| work(room, &self.pixel_view(place, predicted), place);
        predicted.par_iter().enumerate().map_init(PixelWork::default, of).collect()
    }

    fn newton(&mut self, predicted: &[PixelPrediction], is_measured: bool) -> Vec<Option<PixelStep>> {
        let steps = self.map_pixels(predicted, |work, of, _| work.step(of, is_measured));
        let of_pixel = self.coefficients.chunks_mut(self.splines.coefficients());
        for (to, step) in of_pixel.zip(&steps) {
            step.iter().for_each(|step| to.copy_from_slice(&step.coefficients));
        }
        steps
    }

    fn estimate_prior(&mut self, square: &[f64], decided: &[f64]) {
        let differences = self.splines.coefficients() - 2;
        let all = prior::overall(square, decided);
        let mut begin = 0;
        for block in &self.blocks {
            let of = begin..begin + block.width * block.height * differences;
            let sums = prior::PriorBlock {
                width: block.width,
                height: block.height,
                square: &square[of.clone()],
                decided: &decided[of.clone()],
            };
            self.variance[of.clone()].copy_from_slice(&sums.variances(all));
            begin = of.end;
        }
    }
}

impl FreeScene for PixelLight {
    const FEWEST_EVENTS: usize = 3;
    const IS_ONE: bool = false;

    fn pixels(&self) -> &[u32] {
        &self.pixels
    }

    fn light(&self, case: &Case) -> LogLight {
        let mut light = LogLight::blank(case, self.splines.step_ns);
        let values: Vec<Vec<f32>> = self
            .coefficients
            .par_chunks(self.splines.coefficients())
            .map_init(Vec::new, |room, c| {
                self.splines.values(c, room);
                room.iter().map(|u| *u as f32).collect()
            })
            .collect();
        self.pixels.iter().zip(values).for_each(|(pixel, log)| light.log[*pixel as usize] = log);
        light
    }

    fn takes_part(&self, _place: usize) -> bool {
        true
    }

    fn is_measured(&self, _place: usize) -> bool {
        true
    }

    fn median_event_misfit(&self, _predicted: &[PixelPrediction]) -> f64 {
        MEDIAN_T * self.noise.threshold_share
    }

    fn newton_and_noise(&mut self, predicted: &[PixelPrediction]) {
        let steps = self.newton(predicted, true);
        let (mut square, mut decided) = (Vec::new(), Vec::new());
        let differences = self.splines.coefficients() - 2;
        let mut left = Vec::new();
        self.leverage.clear();
        for (step, predicted) in steps.into_iter().zip(predicted) {
            // A pixel whose equations are singular decides nothing.
            let step = step.unwrap_or_else(|| PixelStep {
                square: vec![0.0; differences],
                decided: vec![0.0; differences],
                event_variance: vec![0.0; predicted.events.len()],
                leverage: vec![0.0; predicted.events.len()],
                ..PixelStep::default()
            });
            square.extend(step.square);
            decided.extend(step.decided);
            left.push(step.event_variance);
            self.leverage.push(step.leverage);
        }
        if self.rounds >= ROUNDS_BEFORE_PRIOR {
            self.estimate_prior(&square, &decided);
        }
        if self.rounds >= ROUNDS_BEFORE_NOISE {
            self.noise.estimate_of_events(predicted, &left);
        }
        if (ROUNDS_BEFORE_NOISE..ROUNDS_OF_MISSING).contains(&self.rounds) {
            self.noise.estimate_of_quiet(predicted);
        }
        self.rounds += 1;
    }

    fn newton_step(&mut self, predicted: &[PixelPrediction]) {
        self.newton(predicted, false);
    }

    fn score(
        &self,
        predicted: &[PixelPrediction],
        columns: &[Vec<f32>],
        effects: usize,
    ) -> Vec<Option<Score>> {
        self.map_pixels(predicted, |work, of, place| work.score(of, &columns[place], effects))
    }

    fn gains(
        &self,
        predicted: &[PixelPrediction],
        columns: &[Vec<f32>],
        sizes: &[f64],
    ) -> Vec<Option<Vec<f64>>> {
        self.map_pixels(predicted, |work, of, place| work.gains(of, &columns[place], sizes))
    }

    fn event_gains(&self, with: &[PixelPrediction], without: &[PixelPrediction]) -> Vec<Vec<f64>> {
        let of = |((with, without), leverages): ((&PixelPrediction, &PixelPrediction), &Vec<f64>)| {
            self.noise.event_gains(with, without, |k| leverages[k])
        };
        with.iter().zip(without).zip(&self.leverage).map(of).collect()
    }

    /// From the last round, without refitting.
    ///
    /// Source: leave-one-out residuals e / (1 - h), h the event's leverage (Cook and Weisberg, Residuals and
    /// Influence in Regression, 1982).
    fn left_out(&self, predicted: &[PixelPrediction]) -> Vec<f64> {
        let of = |(predicted, leverages): (&PixelPrediction, &Vec<f64>)| {
            self.noise.log_density(predicted, leverages, |_| [0.0; 2], |_| 0.0)
        };
        predicted.iter().zip(&self.leverage).map(of).collect()
    }
}

/// Coefficients that follow the frame values of a pixel.
fn coefficients_from_frames(case: &Case, nominal: &Nominal, splines: &TimeSplines, pixel: usize) -> Vec<f64> {
    let frames = case.frames.as_ref().expect("frames are there");
    let row = case.pixel_place(pixel).1;
    let known = (0..frames.times.len()).filter_map(|l| {
        let (dn, exposure) = (case.dn(l, pixel), frames.times.exposure(l, row));
        let seconds = (exposure.end.0 - exposure.start.0) as f64 * 1e-9;
        let light = f64::max(dn - nominal.number.black_level, 1.0) / (nominal.number.gain * seconds);
        let middle_ns = i64::midpoint(exposure.start.0, exposure.end.0);
        dn.is_finite().then_some((middle_ns, libm::log(light)))
    });
    let (t_ns, log): (Vec<i64>, Vec<f64>) = known.unzip();
    if t_ns.is_empty() {
        return vec![0.0; splines.coefficients()];
    }
    let at = |k: usize| {
        let instant = splines.start_ns + splines.middle_ns(k);
        let after = t_ns.partition_point(|t| *t <= instant);
        between(&t_ns, after, instant, |l| log[l], |a, b, share| a + (b - a) * share).unwrap_or(0.0)
    };
    (0..splines.coefficients()).map(at).collect()
}

#[cfg(test)]
mod tests;
