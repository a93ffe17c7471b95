//! The scene of a recording as one moving picture, estimated from frames **and** events together.
//!
//! What frames with noise leave open of a picture, events decide: what the picture misses of their thresholds
//! falls by a factor of ten. Unlike a [`crate::Scene`] it is not independent of the events, and absorbs an
//! effect of the sensor in part; how much is known ([`FreeScene::score`]).
//!
//! - Unknowns s: coefficients of the picture, its motion, the array's shading. Rows: frame values, and events
//!   e = V(t) - V_ref - p theta (`events`); J their derivatives (`lines`).
//! - H = J'W J + P (`problem`; `normal`: its factor), P the prior: second differences of the picture with
//!   a variance each, by expectation and maximisation with a posterior sample (`prior`); second
//!   differences of the motion.
//! - Steps along what nothing measures (a shading along which nothing moves, picture and motion shifted
//!   together) are damped.
//! - Noise of events: Student-t with three degrees of freedom, scaled to what is left of them; of frames: as
//!   [`crate::free::frame_noise`] has it.
//! - Some pixels' events take no part: what a sensor gains is measured on these (`score`).
//!
//! Source: Gauss-Newton on all unknowns at once (Triggs et al., Bundle adjustment - a modern synthesis,
//! 2000); posterior samples by perturbation (Papandreou and Yuille, NIPS 2010).
//!
//! Before a still ground there are two fields, the picture and how much of the ground it hides, which the
//! ground's values are times; these stay as frames have them.
//!
//! Limits: one affine motion; a surface sharper than its pitch is softened, which is finer on a part of the
//! array ([`ArrayPart`]).

mod events;
mod fields;
mod lines;
mod normal;
mod part;
mod prior;
mod problem;
mod score;

use crate::block::Block;
use crate::case::Case;
use crate::free::{FreeScene, PixelPrediction, PredictedEvent, SceneNoise, Score, frame_scale, line};
use crate::light::LogLight;
use crate::moving::MovingPicture;
use crate::nominal::Nominal;
use crate::picture::{PictureSetting, ScenePicture};
use crate::scene::{Scene, SceneCell};
use crate::statistics::{MEDIAN_T, median};
use fields::GridFields;
use normal::NormalFactor;
pub use part::ArrayPart;
use part::LARGEST;
use photocurrent_core::random::Random;
use prior::DifferencePrior;
use problem::{CurrentPicture, FrameRows, JointRows};
use std::sync::Arc;

/// No frame value sees more coefficients in a line than this, in memory of some hundreds of megabytes.
const FARTHEST: usize = 24;
/// Degrees of freedom of an event at most.
const MOST_FREE: f64 = 0.7;
/// Factor by which a step that raises the objective is shortened, and the number of times.
const SHORTER: f64 = 0.4;
const TIMES_SHORTER: usize = 2;
/// Ratio of the event noise up to which a factor is kept.
const SAME_NOISE: f64 = 1.25;
/// Noise that changes by less than this from round to round has settled.
const SETTLED: f64 = 1.1;
/// Bins of slopes in which the noise of events is estimated, and the least of it: as a share of
/// thresholds, and seconds.
const BINS: usize = 8;
const LEAST_NOISE: (f64, f64) = (0.003, 1e-6);
/// Size of the cells within which errors at an edge are common, as a share of the pitch.
const CELL: f64 = 0.4;
/// Least number of rounds.
const FIRST_ROUNDS: u64 = 3;
/// Seed of posterior samples.
const SEED: u64 = 11;

/// A moving picture that follows frames and events.
#[derive(Clone)]
pub struct JointPicture {
    scene: Arc<MovingPicture>,
    case: Arc<Case>,
    nominal: Arc<Nominal>,
    step_ns: i64,
    /// The part of the array, its pixels, and of each pixel of the array its place among them.
    block: Block,
    pixels: Vec<u32>,
    place_of: Arc<Vec<u32>>,
    /// Of each of its pixels: do its events take part? Otherwise gains are measured on them.
    is_trained: Vec<bool>,
    /// Of the measurements.
    noise: SceneNoise,
    /// Median standard deviation of events, as a share of their thresholds; and that before the last round.
    typical: f64,
    typical_before: f64,
    prior: DifferencePrior,
    /// Share of its information that an event has about itself, in the mean.
    free: f64,
    rounds: u64,
    /// Before the last step.
    before: Option<StepToShorten>,
    /// The factor of an earlier linearisation, while noise is about as it was.
    factor: Option<FactorAndNoise>,
    /// Frame values as rows, once the picture hardly moves: their derivatives and weights stand from then on.
    frames: Option<Arc<FrameRows>>,
}

/// A factor of the normal equations, and its event noise.
#[derive(Clone)]
struct FactorAndNoise {
    factor: Arc<NormalFactor>,
    typical: f64,
}

/// A step that may have to be shortened.
#[derive(Clone, Debug)]
struct StepToShorten {
    scene: Arc<MovingPicture>,
    step: Vec<f64>,
    /// The objective before it.
    objective: f64,
    times: usize,
}

impl JointPicture {
    /// From a picture that was fitted to the frames, on a part of the array. `is_trained`: per pixel of the
    /// array, are its events fitted? `step_ns`: step of the predicted light.
    ///
    /// # Errors
    /// Where the picture is too large for a factor.
    pub fn new(
        case: &Case,
        nominal: &Nominal,
        (scene, part): (&MovingPicture, &ArrayPart),
        is_trained: &[bool],
        step_ns: i64,
        noise: SceneNoise,
    ) -> Result<JointPicture, String> {
        let ArrayPart { block, pitch } = *part;
        let setting = PictureSetting { pitch, ..scene.setting };
        let picture = scene.picture.on_block(case, nominal, &setting, &block);
        let fields = GridFields::from_picture(&picture);
        let count = fields.coefficients();
        let reach = problem::coefficients_per_line(case, nominal, &picture, &setting, &block);
        if count > LARGEST || reach > FARTHEST {
            return Err(format!(
                "a picture of {count} coefficients, of which a frame value sees {reach} in a line, is more \
                 than frames and events together are fitted to: {LARGEST}, and {FARTHEST} in a line"
            ));
        }
        let prior = DifferencePrior::estimate(&fields, &fields.unknowns(&picture.surface), None);
        let scene = MovingPicture::new(picture, &setting, case, nominal);
        let pixels = block.pixels(case.extent);
        let mut place_of = vec![u32::MAX; case.extent.pixels()];
        (0..).zip(&pixels).for_each(|(place, pixel)| place_of[*pixel as usize] = place);
        Ok(JointPicture {
            scene: Arc::new(scene),
            case: Arc::new(case.clone()),
            nominal: Arc::new(nominal.clone()),
            step_ns,
            block,
            is_trained: pixels.iter().map(|pixel| is_trained[*pixel as usize]).collect(),
            pixels,
            place_of: Arc::new(place_of),
            noise,
            typical: f64::INFINITY,
            typical_before: f64::INFINITY,
            prior,
            free: 0.0,
            rounds: 0,
            before: None,
            factor: None,
            frames: None,
        })
    }

    fn picture(&self) -> &ScenePicture {
        &self.scene.picture
    }

    fn current(&self) -> CurrentPicture<'_> {
        let JointPicture {
            case,
            nominal,
            scene,
            block,
            pixels,
            place_of,
            is_trained,
            noise,
            prior,
            frames,
            ..
        } = self;
        let frames = frames.as_ref();
        CurrentPicture { case, nominal, scene, block, pixels, place_of, is_trained, noise, prior, frames }
    }

    /// The kept factor, where the noise has hardly changed; otherwise a new one of the present rows.
    fn reusable_factor(&self, problem: &JointRows) -> Option<FactorAndNoise> {
        match self.factor.as_ref().filter(|kept| self.is_near(kept)) {
            Some(kept) => Some(kept.clone()),
            None => Some(FactorAndNoise {
                factor: Arc::new(self.current().factored(problem)?),
                typical: self.typical,
            }),
        }
    }

    /// Is the scene ready for effects? Before, each round has its own factor.
    fn has_begun(&self) -> bool {
        self.frames.is_some()
    }

    /// Is the noise of events about as it was for a factor?
    fn is_near(&self, kept: &FactorAndNoise) -> bool {
        let ratio = self.typical / kept.typical;
        ratio < SAME_NOISE && 1.0 / ratio < SAME_NOISE
    }

    /// Applies a share of a step of all unknowns to a picture.
    fn apply_step(&mut self, from: &Arc<MovingPicture>, step: &[f64], share: f64) {
        let mut picture = from.picture.clone();
        picture.move_by(&GridFields::from_picture(&picture).by_field(step), share);
        self.scene = Arc::new(MovingPicture::new(picture, &from.setting, &self.case, &self.nominal));
    }

    /// Events that take part, or those that do not.
    fn events<'a>(
        &'a self,
        predicted: &'a [PixelPrediction],
        is: bool,
    ) -> impl Iterator<Item = &'a PredictedEvent> {
        let of = predicted.iter().zip(&self.is_trained).filter(move |(_, is_trained)| **is_trained == is);
        of.flat_map(|(of, _)| &of.events)
    }

    /// The noise of events that take part, or of those that do not, from what is left of them, `free` of
    /// their information being about themselves: robust scales in bins of slopes, as a part of thresholds
    /// and a part of stamps.
    fn event_noise(&self, predicted: &[PixelPrediction], is_trained: bool, free: f64) -> SceneNoise {
        let of = |event: &PredictedEvent| {
            let slope = event.slope_per_s / event.threshold;
            (slope * slope, event.excess.abs() / event.threshold)
        };
        let mut sizes: Vec<(f64, f64)> = self.events(predicted, is_trained).map(of).collect();
        if sizes.len() < BINS {
            return self.noise;
        }
        sizes.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let level = |bin: &[(f64, f64)]| {
            let mut of_bin: Vec<f64> = bin.iter().map(|one| one.1).collect();
            let scale = median(&mut of_bin) / MEDIAN_T;
            (bin[bin.len() / 2].0, scale * scale / (1.0 - free))
        };
        let levels: Vec<(f64, f64)> = sizes.chunks(sizes.len().div_ceil(BINS)).map(level).collect();
        let (share, stamp) = line(&levels);
        SceneNoise {
            threshold_share: share.sqrt().max(LEAST_NOISE.0),
            stamp_s: stamp.sqrt().max(LEAST_NOISE.1),
            ..self.noise
        }
    }

    /// Estimates the event noise from the residuals.
    fn take_noise(&mut self, predicted: &[PixelPrediction]) {
        self.noise = self.event_noise(predicted, true, self.free);
        let of = |event: &PredictedEvent| self.noise.event_variance(event).sqrt() / event.threshold;
        let mut deviations: Vec<f64> = self.events(predicted, true).map(of).collect();
        if !deviations.is_empty() {
            (self.typical_before, self.typical) = (self.typical, median(&mut deviations));
        }
    }

    fn newton(&mut self, predicted: &[PixelPrediction], is_measured: bool) {
        let problem = self.current().problem(predicted);
        if self.rounds < FIRST_ROUNDS {
            self.factor = None;
        }
        let is_new = self.factor.is_none();
        let Some(kept) = self.reusable_factor(&problem) else { return };
        let is_new =
            is_new || self.factor.as_ref().is_some_and(|one| !Arc::ptr_eq(&one.factor, &kept.factor));
        let is_measured = is_measured && is_new;
        let factor = kept.factor.clone();
        self.factor = Some(kept);
        let fields = self.current().fields();
        let count = fields.coefficients();
        let mut sides = vec![self.current().gradient(&problem)];
        if is_measured {
            let (of_events, sample) = self.probes(&problem, count);
            sides.push(of_events);
            sides.push(sample);
        }
        let probe = sides.get(1).cloned();
        factor.solve(&mut sides);
        if let Some(probe) = probe {
            let events = problem.weight[problem.event_rows()].iter().filter(|w| **w > 0.0).count().max(1);
            let trace: f64 = probe.iter().zip(&sides[1]).map(|(a, b)| a * b).sum();
            self.free = (trace / events as f64).clamp(0.0, MOST_FREE);
        }
        let step: Vec<f64> = sides[0].iter().map(|by| -by).collect();
        if step.iter().any(|by| !by.is_finite()) {
            return;
        }
        let from = self.scene.clone();
        self.apply_step(&from, &step, 1.0);
        if is_measured {
            let now = self.current().unknowns();
            self.prior = DifferencePrior::estimate(&fields, &now[..count], Some(&sides[2][..count]));
        }
        let objective = CurrentPicture { scene: &from, ..self.current() }.objective(predicted);
        self.before = Some(StepToShorten { scene: from, step, objective, times: 0 });
        self.rounds += 1;
    }

    /// A probe of the degrees of freedom of events, and the right side of a posterior sample.
    fn probes(&self, problem: &JointRows, count: usize) -> (Vec<f64>, Vec<f64>) {
        let mut random = Random::new(SEED, &[self.rounds]);
        let all = self.current().unknowns().len();
        let (mut of_events, mut sample) = (vec![0.0; all], vec![0.0; all]);
        for r in problem.used() {
            let by = problem.weight[r].sqrt() * random.normal();
            if problem.event_rows().contains(&r) {
                problem.add_row(r, by, &mut of_events, count);
            }
            problem.add_row(r, by, &mut sample, count);
        }
        self.prior.for_each_difference(&self.current().fields(), |at, by, weight| {
            let draw = weight.sqrt() * random.normal();
            at.iter().zip(by).for_each(|(at, by)| sample[*at] += draw * by);
        });
        (of_events, sample)
    }
}

impl FreeScene for JointPicture {
    const FEWEST_EVENTS: usize = 0;
    const IS_ONE: bool = true;

    fn pixels(&self) -> &[u32] {
        &self.pixels
    }

    fn light(&self, case: &Case) -> LogLight {
        (&*self.scene as &dyn Scene).light_of(case, self.step_ns, &self.block)
    }

    fn takes_part(&self, place: usize) -> bool {
        self.is_trained[place]
    }

    fn is_measured(&self, place: usize) -> bool {
        !self.is_trained[place]
    }

    fn median_event_misfit(&self, predicted: &[PixelPrediction]) -> f64 {
        let mut sizes: Vec<f64> =
            self.events(predicted, false).map(|event| event.excess.abs() / event.threshold).collect();
        if sizes.is_empty() { f64::NAN } else { median(&mut sizes) }
    }

    fn cell(&self, case: &Case, pixel: usize, t_ns: i64) -> Option<SceneCell> {
        let side = CELL * self.picture().grid.pitch;
        Some((&*self.scene as &dyn Scene).cell(case, pixel, t_ns, side))
    }

    fn has_settled(&self) -> bool {
        self.rounds >= FIRST_ROUNDS && self.typical_before / self.typical < SETTLED
    }

    fn newton_and_noise(&mut self, predicted: &[PixelPrediction]) {
        if self.shorten_step(predicted) {
            return;
        }
        self.take_noise(predicted);
        if self.rounds < FIRST_ROUNDS
            || !self.has_begun()
            || self.factor.as_ref().is_none_or(|kept| self.is_near(kept))
        {
            self.newton(predicted, true);
        }
    }

    fn newton_step(&mut self, predicted: &[PixelPrediction]) {
        if !self.shorten_step(predicted) {
            self.newton(predicted, false);
        }
    }

    fn score(
        &self,
        predicted: &[PixelPrediction],
        columns: &[Vec<f32>],
        effects: usize,
    ) -> Vec<Option<Score>> {
        let standing = self.current();
        let problem = standing.problem(predicted);
        match self.reusable_factor(&problem) {
            Some(FactorAndNoise { factor, .. }) => {
                score::scores(&standing, &problem, &factor, predicted, (columns, effects))
            }
            None => predicted.iter().map(|_| None).collect(),
        }
    }

    fn gains(
        &self,
        predicted: &[PixelPrediction],
        columns: &[Vec<f32>],
        sizes: &[f64],
    ) -> Vec<Option<Vec<f64>>> {
        let standing = self.current();
        let problem = standing.problem(predicted);
        let Some(FactorAndNoise { factor, .. }) = self.reusable_factor(&problem) else {
            return predicted.iter().map(|_| None).collect();
        };
        let left_out = |moved: &[PixelPrediction]| self.left_out(moved);
        let gains = score::gains(&standing, &problem, &factor, predicted, (columns, sizes), left_out);
        gains.into_iter().enumerate().map(|(place, of)| self.is_measured(place).then_some(of)).collect()
    }

    fn objective(&self, predicted: &[PixelPrediction]) -> f64 {
        self.current().objective(predicted)
    }

    fn shorten_step(&mut self, predicted: &[PixelPrediction]) -> bool {
        let Some(before) = self.before.take() else { return false };
        if self.current().objective(predicted) <= before.objective {
            return false;
        }
        if before.times == TIMES_SHORTER {
            self.scene = before.scene;
            self.factor = None;
            return true;
        }
        let share = libm::pow(SHORTER, before.times as f64 + 1.0);
        self.apply_step(&before.scene, &before.step, share);
        self.before = Some(StepToShorten { times: before.times + 1, ..before });
        true
    }

    fn step_with_effects(&mut self, predicted: &[PixelPrediction], columns: &[Vec<f32>], sizes: &[f64]) {
        let standing = self.current();
        let problem = standing.problem(predicted);
        let Some(FactorAndNoise { factor, .. }) = self.reusable_factor(&problem) else { return };
        let step = score::step_with(&standing, &problem, &factor, predicted, (columns, sizes));
        if step.iter().all(|by| by.is_finite()) {
            self.apply_step(&self.scene.clone(), &step, 1.0);
        }
    }

    fn event_gains(&self, with: &[PixelPrediction], without: &[PixelPrediction]) -> Vec<Vec<f64>> {
        let noise = self.event_noise(with, false, 0.0);
        let of = |(place, (with, without)): (usize, (&PixelPrediction, &PixelPrediction))| match self
            .is_measured(place)
        {
            true => noise.event_gains(with, without, |_| 0.0),
            false => Vec::new(),
        };
        with.iter().zip(without).enumerate().map(of).collect()
    }

    fn prepare(&mut self, predicted: &[PixelPrediction]) {
        // What is predicted next may be another sensor's.
        self.before = None;
        self.frames = None;
        let problem = self.current().problem(predicted);
        self.frames = Some(problem.of_frames.clone());
        self.factor = None;
        self.factor = self.reusable_factor(&problem);
    }

    fn release(&mut self) {
        self.factor = None;
        self.frames = None;
    }

    fn left_out(&self, predicted: &[PixelPrediction]) -> Vec<f64> {
        let noise = self.event_noise(predicted, false, 0.0);
        let counts = |place: usize| self.is_measured(place) && !predicted[place].events.is_empty();
        let mut misfits: Vec<f64> = (0..predicted.len())
            .filter(|place| counts(*place))
            .flat_map(|place| predicted[place].frames.iter().map(|frame| noise.frame_misfit(frame).abs()))
            .collect();
        let scale = frame_scale(&mut misfits);
        let of = |(place, of): (usize, &PixelPrediction)| -> f64 {
            if !counts(place) {
                return 0.0;
            }
            let events = of.events.iter().map(|event| noise.log_density_left_out(event, 0.0));
            let frames = of.frames.iter().map(|frame| noise.log_density_of_frame(frame, scale));
            events.sum::<f64>() + frames.sum::<f64>()
        };
        predicted.iter().enumerate().map(of).collect()
    }
}

#[cfg(test)]
mod tests;
