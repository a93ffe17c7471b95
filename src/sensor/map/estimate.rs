//! How far events may be trusted, and which prior suits: estimated from the recording itself.
//!
//! A stated noise is often wrong, and too small a value is far worse than too large a one: the light then
//! bends to meet every threshold, and is wrong where no event holds it. So some pixels are solved with
//! several values while every third of their frames is held out, and the value is taken that predicts those
//! frames best. With too few frames for that, the marginal likelihood of the measurements decides; it is the
//! weaker judge, because it assumes that the model is right.

use super::frame_noise::NORMAL_MEDIAN;
use super::group::MapGroup;
use super::options::{Evidence, MapOptions, MapSolution, MapTask, Second, SecondStart};
use super::prior::{Local, Prior};
use super::problem::{Hint, LoneEvents, MapFrame, MapProblem, Noise};
use super::segment::collected_between;
use crate::elementary::ln;
use multiversion::multiversion;

/// Standard deviations of an event that are tried, as parts of a threshold, largest first.
pub(crate) const EVENT_NOISES: [f64; 5] = [0.32, 0.16, 0.08, 0.04, 0.02];
/// Spreads of thresholds over the pixels that are tried, as parts of a threshold, in addition to none.
pub(crate) const THRESHOLD_SPREADS: [f64; 2] = [0.07, 0.15];
/// Where fewer than this part of the second starts are kept, they are tried only for pixels whose squared
/// misfits of events are above [`SELDOM`], per event (docs/performance.md has both's gain and loss).
const RARELY: f64 = 0.05;
const SELDOM: f64 = 0.5;
/// With fewer events than this in all pixels together nothing is estimated.
pub const FEWEST_EVENTS: usize = 40;
/// Frames are held out where there are at least so many.
pub const FEWEST_FRAMES: usize = 4;
/// Added to a frame value that an error is compared with, as a share of the range from darkness to
/// saturation: in the dark, noise is not relative, and a few dark pixels whose light ran away must not pass
/// for good.
const DARK_SHARE: f64 = 0.2;
/// Where there are many pixels, choices are tried on one in six of them, then on another sixth, then on the
/// others: of six pixels, these are first and second.
const STAGES: usize = 6;
const FIRST: usize = 1;
const SECOND: usize = 4;
/// Fewer pixels than this are one stage: of eighteen pixels, two standard errors dropped what was best.
const FEWEST_IN_STAGES: usize = 192;
/// A relative error counts at most this: one pixel that went astray does not decide.
const LARGEST_ERROR: f64 = 1.0;

/// Standard deviations are widened by this factor at most.
const LARGEST_FACTOR: f64 = 5.0;
/// With fewer misses than this they are taken as they are.
const FEWEST_MISSES: usize = 40;
/// No light is known better than to a ten-thousandth.
pub const LEAST_VARIANCE: f64 = 1e-8;

/// What it takes to choose something.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choosing {
    /// What is not usual must lose less by this part, from 0 (any less) to 1 (never).
    pub clear_gain: f64,
    /// Of many pixels a sixth tries every choice, another sixth and the others only those whose mean loss is
    /// not above that of the best, in the same pixels, by so many of the difference's standard errors.
    /// Infinite: all pixels try every choice.
    pub sure: f64,
}

/// What suits a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// How far its events are trusted.
    pub noise: Noise,
    /// How light is expected to move.
    pub prior: Prior,
    /// When pixels are solved from a second start.
    pub second: Option<SecondStart>,
}

/// The priors that are tried where frames can be held out: the usual one, two for light that is hardly ever
/// still (the second for smooth motion), one for edges that last longer, and Student's t of increments and of
/// changes of slope.
pub(crate) const PRIORS: [Prior; 6] = [
    Prior::USUAL,
    Prior::Local(Local { floor_per_s: 60.0, ..Local::USUAL }),
    Prior::Local(Local { floor_per_s: 60.0, memory_s: 5e-3, ..Local::USUAL }),
    Prior::Local(Local { memory_s: 4e-3, reach_s: 0.5e-3, ..Local::USUAL }),
    Prior::Walk { per_s: 1.0, nu: 1.0 },
    Prior::IntegratedWalk { per_s3: 3e6, nu: 3.0 },
];

impl Choosing {
    /// Suits most recordings: 3 % are more than chance.
    pub const USUAL: Choosing = Choosing { clear_gain: 0.03, sure: 3.0 };

    /// What is not usual must lose less than the best times this.
    fn clearly_better(&self) -> f64 {
        1.0 - self.clear_gain
    }
}

/// The noise of events and the prior that explain `problems` best; the usual ones when they have hardly an
/// event, and where frames decide, unless others are clearly better.
///
/// `event` is taken where it is given. Without enough frames to hold out, only the event noise is chosen.
pub fn choose(
    problems: &[MapProblem<'_>],
    event: Option<f64>,
    choosing: &Choosing,
    options: &MapOptions,
    group: &mut MapGroup,
) -> Choice {
    let events: usize = problems.iter().map(|problem| problem.events.len()).sum();
    let given = problems.first().map_or_else(Noise::default, |problem| problem.noise);
    let usual = Choice {
        noise: Noise { event: event.unwrap_or(given.event), ..given },
        prior: options.prior,
        second: options.second,
    };
    if events < FEWEST_EVENTS {
        return usual;
    }
    let by_frames = problems.iter().all(|problem| problem.frames.len() >= FEWEST_FRAMES);
    let kept = by_frames.then(|| problems.iter().map(|problem| kept(problem.frames)).collect());
    let tried = Tried { problems, kept, dark_dn: dark_dn(problems), options: *options };
    let noises = match event {
        Some(ref stated) => std::slice::from_ref(stated),
        None => EVENT_NOISES.as_slice(),
    };
    let stages = tried.stages();
    let mut best = Best { choice: usual, tally: Tally::default() };
    // Takes a choice that is better by a factor.
    let mut consider = |choices: Vec<Choice>, by: &dyn Fn(&Choice) -> f64, best: &mut Best| {
        let mut left: Vec<Best> =
            choices.into_iter().map(|choice| Best { choice, tally: Tally::default() }).collect();
        for (n, stage) in stages.iter().enumerate() {
            if n > 0 {
                drop_losers(&mut left, best, by(&best.choice), choosing.sure);
            }
            tried.losses(&mut left, stage, group);
        }
        for one in left {
            if best.tally.losses.is_empty() || one.tally.loss() < best.tally.loss() * by(&best.choice) {
                *best = one;
            }
        }
    };
    let clearly_better = choosing.clearly_better();
    let with_event = |event: f64, noise: Noise| Choice { noise: Noise { event, ..noise }, ..usual };
    let mut events: Vec<Choice> = noises.iter().map(|&event| with_event(event, usual.noise)).collect();
    if !by_frames {
        consider(events, &|_| 1.0, &mut best);
        return best.choice;
    }
    consider(vec![usual], &|_| 1.0, &mut best);
    events.retain(|choice| *choice != usual);
    consider(events, &|best| if *best == usual { clearly_better } else { 1.0 }, &mut best);
    // Events may be trusted more when their thresholds are right, so both are chosen together.
    let threshold = mean_threshold(problems);
    let spreads = THRESHOLD_SPREADS.iter().map(|part| Noise { threshold: part * threshold, ..usual.noise });
    let choices =
        spreads.flat_map(|noise| noises.iter().map(move |&event| with_event(event, noise))).collect();
    consider(choices, &|best| if best.noise.threshold > 0.0 { 1.0 } else { clearly_better }, &mut best);
    if problems.iter().any(|problem| problem.is_lone.contains(&true)) {
        let noise = Noise { lone: LoneEvents::Doubted, ..best.choice.noise };
        consider(vec![Choice { noise, ..best.choice }], &|_| clearly_better, &mut best);
    }
    let priors = PRIORS
        .into_iter()
        .filter(|prior| *prior != usual.prior)
        .map(|prior| Choice { prior, ..best.choice })
        .collect();
    consider(priors, &|_| clearly_better, &mut best);
    if (best.tally.kept as f64) < RARELY * best.tally.tried as f64 {
        let seldom = |second| SecondStart { least_misfit: SELDOM, ..second };
        best.choice.second = best.choice.second.map(seldom);
    }
    best.choice
}

/// Which of a pixel's frames are held out where a choice is judged by its prediction: one in so many, never
/// the first or the last, and none where there are fewer than [`FEWEST_FRAMES`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HoldOut {
    /// One in so many, 2 or more.
    pub every: usize,
    /// The first of them.
    pub first: usize,
}

impl HoldOut {
    /// One in three.
    pub const USUAL: HoldOut = HoldOut { every: 3, first: 1 };

    /// Is frame `l` of a pixel's `count` held out?
    fn is_held(self, l: usize, count: usize) -> bool {
        count >= FEWEST_FRAMES && l % self.every == self.first && l > 0 && l + 1 < count
    }

    /// Those of a pixel's frames that are held out and not saturated, with their numbers.
    pub fn held(self, frames: &[MapFrame]) -> impl Iterator<Item = (usize, &MapFrame)> {
        let is_held = move |l: usize| self.is_held(l, frames.len());
        frames.iter().enumerate().filter(move |(l, frame)| is_held(*l) && !frame.saturated)
    }

    /// The frames that are not held out.
    pub fn kept(self, frames: &[MapFrame]) -> Vec<MapFrame> {
        let is_kept = |(l, _): &(usize, &MapFrame)| !self.is_held(*l, frames.len());
        frames.iter().enumerate().filter(is_kept).map(|(_, frame)| *frame).collect()
    }
}

/// The frames that are not held out by the usual rule.
pub fn kept(frames: &[MapFrame]) -> Vec<MapFrame> {
    HoldOut::USUAL.kept(frames)
}

/// What choices are tried on.
struct Tried<'a> {
    problems: &'a [MapProblem<'a>],
    /// The frames of each problem without those that are held out, where frames decide.
    kept: Option<Vec<Vec<MapFrame>>>,
    /// What is added to a frame value that an error is compared with, DN.
    dark_dn: f64,
    options: MapOptions,
}

/// A choice, and what it loses in the problems that tried it.
struct Best {
    choice: Choice,
    tally: Tally,
}

/// What a choice loses in some problems.
#[derive(Clone, Debug, Default)]
struct Tally {
    /// In each of them.
    losses: Vec<f64>,
    /// So many pixels were solved from a second start as well, ...
    tried: usize,
    /// ... and so many kept its answer.
    kept: usize,
}

impl Tally {
    fn loss(&self) -> f64 {
        self.losses.iter().sum()
    }
}

/// Drops choices that surely lose more than the best of them, or than `best` times a factor, in the problems
/// that tried them.
fn drop_losers(left: &mut Vec<Best>, best: &Best, by: f64, sure: f64) {
    let least = |a: &&Best, b: &&Best| a.tally.loss().total_cmp(&b.tally.loss());
    let Some(leader) = left.iter().min_by(least).map(|leader| leader.tally.losses.clone()) else { return };
    left.retain(|one| {
        let losses = &one.tally.losses;
        !is_surely_more(losses, &leader, 1.0, sure) && !is_surely_more(losses, &best.tally.losses, by, sure)
    });
}

/// Is the sum of `losses` above that of as many of `others`, times `by`, by more than `sure` standard errors
/// of the difference? Not where there are no others.
pub(super) fn is_surely_more(losses: &[f64], others: &[f64], by: f64, sure: f64) -> bool {
    let n = usize::min(losses.len(), others.len());
    if n < 2 {
        return false;
    }
    let differences = || losses.iter().zip(others).map(|(loss, other)| loss - by * other);
    let sum: f64 = differences().sum();
    let mean = sum / n as f64;
    let squares: f64 = differences().map(|difference| (difference - mean) * (difference - mean)).sum();
    sum > sure * (squares * n as f64 / (n - 1) as f64).sqrt()
}

impl Tried<'_> {
    /// The problems, in stages. One stage where evidence decides: pixels alone do not show what it gains.
    fn stages(&self) -> Vec<Vec<usize>> {
        let all = 0..self.problems.len();
        if self.kept.is_none() || all.len() < FEWEST_IN_STAGES {
            return vec![all.collect()];
        }
        let of = |is_in: fn(usize) -> bool| all.clone().filter(|p| is_in(p % STAGES)).collect();
        vec![of(|p| p == FIRST), of(|p| p == SECOND), of(|p| p != FIRST && p != SECOND)]
    }

    /// Adds what each choice loses in some problems: by the frames that were held out, else by the evidence.
    ///
    /// Always from the usual start: from the light that another noise or prior has found, a few steps do not
    /// show what this one would find.
    fn losses(&self, choices: &mut [Best], trying: &[usize], group: &mut MapGroup) {
        let task = |n: usize| {
            let (p, choice) = (trying[n / choices.len()], &choices[n % choices.len()].choice);
            let problem = &self.problems[p];
            let frames = self.kept.as_ref().map_or(problem.frames, |kept| kept[p].as_slice());
            let noise = choice.noise;
            MapTask {
                problem: MapProblem { noise, frames, ..*problem },
                options: MapOptions { prior: choice.prior, with_sigma: false, ..self.options },
            }
        };
        let tasks: Vec<MapTask<'_>> = (0..trying.len() * choices.len()).map(task).collect();
        let mut losses = vec![(0.0, Second::Untried); tasks.len()];
        let evidence = if self.kept.is_some() { Evidence::Unwanted } else { Evidence::Wanted };
        group.solve_with(&tasks, evidence, &mut |n, solution| {
            let problem = &self.problems[trying[n / choices.len()]];
            let loss = if self.kept.is_some() {
                prediction_error(HoldOut::USUAL, problem, self.dark_dn, &solution)[0]
            } else {
                -solution.outcome.log_evidence
            };
            losses[n] = (loss, solution.outcome.second);
        });
        // Problem by problem, whatever order they were solved in.
        let count = choices.len();
        for (n, (loss, second)) in losses.into_iter().enumerate() {
            let tally = &mut choices[n % count].tally;
            tally.losses.push(loss);
            tally.tried += usize::from(second != Second::Untried);
            tally.kept += usize::from(second == Second::Kept);
        }
    }
}

/// How badly each problem's frames that are held out are predicted by its other measurements: the sum of
/// relative errors, at most [`LARGEST_ERROR`] each.
pub fn prediction_errors(
    problems: &[MapProblem<'_>],
    options: &MapOptions,
    group: &mut MapGroup,
) -> Vec<f64> {
    let [errors, _] = prediction_errors_of(HoldOut::USUAL, problems, options, group);
    errors
}

/// The same of frames that are held out by another rule; and the sums of the errors' squares.
pub fn prediction_errors_of(
    hold: HoldOut,
    problems: &[MapProblem<'_>],
    options: &MapOptions,
    group: &mut MapGroup,
) -> [Vec<f64>; 2] {
    let kept: Vec<Vec<MapFrame>> = problems.iter().map(|problem| hold.kept(problem.frames)).collect();
    let options = MapOptions { with_sigma: false, ..*options };
    let tasks: Vec<MapTask<'_>> = problems
        .iter()
        .zip(&kept)
        .map(|(problem, frames)| MapTask { problem: MapProblem { frames, ..*problem }, options })
        .collect();
    let mut errors = [vec![0.0; tasks.len()], vec![0.0; tasks.len()]];
    let dark_dn = dark_dn(problems);
    group.solve_with(&tasks, Evidence::Unwanted, &mut |n, solution| {
        let found = prediction_error(hold, &problems[n], dark_dn, &solution);
        errors.iter_mut().zip(found).for_each(|(errors, found)| errors[n] = found);
    });
    errors
}

/// What a problem's other measurements predict of its frames that are held out: their numbers and DN, of each
/// of some rules with the hints that know nothing of those frames.
pub fn predictions(
    problem: &MapProblem<'_>,
    held: &[(HoldOut, Vec<Hint>)],
    options: &MapOptions,
    group: &mut MapGroup,
) -> Vec<(usize, f64)> {
    let kept: Vec<Vec<MapFrame>> = held.iter().map(|(hold, _)| hold.kept(problem.frames)).collect();
    let options = MapOptions { with_sigma: false, ..*options };
    let tasks: Vec<MapTask<'_>> = held
        .iter()
        .zip(&kept)
        .map(|((_, hints), frames)| MapTask { problem: MapProblem { frames, hints, ..*problem }, options })
        .collect();
    let mut predictions = Vec::new();
    group.solve_with(&tasks, Evidence::Unwanted, &mut |n, solution| {
        let of = |(l, frame): (usize, &MapFrame)| (l, predicted_dn(problem, frame, &solution));
        predictions.extend(held[n].0.held(problem.frames).map(of));
    });
    predictions.sort_by_key(|(l, _)| *l);
    predictions
}

/// How a frame that was held out is missed.
#[derive(Clone, Copy, Debug)]
pub struct Miss {
    /// Predicted less recorded, absolute value, DN.
    size_dn: f64,
    /// The variance that the solution states for its prediction, DN^2.
    ours: f64,
    /// That of the frame value.
    frames: f64,
}

/// How each problem's frames that are held out are missed by its other measurements.
pub fn misses(problems: &[MapProblem<'_>], options: &MapOptions, group: &mut MapGroup) -> Vec<Miss> {
    let kept: Vec<Vec<MapFrame>> = problems.iter().map(|problem| kept(problem.frames)).collect();
    let options = MapOptions { with_sigma: true, ..*options };
    let tasks: Vec<MapTask<'_>> = problems
        .iter()
        .zip(&kept)
        .map(|(problem, frames)| MapTask { problem: MapProblem { frames, ..*problem }, options })
        .collect();
    let mut misses: Vec<(usize, Miss)> = Vec::new();
    group.solve_with(&tasks, Evidence::Unwanted, &mut |n, solution| {
        let MapProblem { frames, sensor, .. } = problems[n];
        let spread: Vec<f64> = solution
            .log_photocurrent
            .iter()
            .zip(solution.variance)
            .map(|(u, variance)| u + log_sigma(*variance))
            .collect();
        for (_, frame) in HoldOut::USUAL.held(frames) {
            let over = |log: &[f64]| {
                sensor.gain * collected_between(solution.t_ns, log, frame.start_ns, frame.end_ns)
            };
            let (predicted, sigma) = (sensor.black_level_dn + over(solution.log_photocurrent), over(&spread));
            misses.push((
                n,
                Miss {
                    size_dn: (predicted - frame.dn).abs(),
                    ours: sigma * sigma,
                    frames: frame.sigma_dn * frame.sigma_dn,
                },
            ));
        }
    });
    // Problem by problem, whatever order they were solved in.
    misses.sort_by_key(|(n, _)| *n);
    misses.into_iter().map(|(_, miss)| miss).collect()
}

/// Natural log of the standard deviation of log light, from its variance.
#[inline(always)]
pub fn log_sigma(variance: f64) -> f64 {
    0.5 * ln(if variance > LEAST_VARIANCE { variance } else { LEAST_VARIANCE })
}

/// [`log_sigma`] of each.
pub fn log_sigmas(variance: &[f64], log_sigmas: &mut Vec<f64>) {
    log_sigmas.clear();
    log_sigmas.extend_from_slice(variance);
    to_log_sigmas(log_sigmas);
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
fn to_log_sigmas(variances: &mut [f64]) {
    for variance in variances {
        *variance = log_sigma(*variance);
    }
}

/// By what factor standard deviations of light are too small: what misses show of it, at least 1 and at most
/// [`LARGEST_FACTOR`].
///
/// The prior and the noise are simpler than the world, and the light follows its own estimate, so the
/// posterior is too narrow where the model is poor. With this factor the median of the misses, over their
/// standard deviations, is that of a normal distribution. 1 where there are too few.
pub fn too_narrow_by(misses: &mut [Miss]) -> f64 {
    if misses.len() < FEWEST_MISSES {
        return 1.0;
    }
    let middle = misses.len() / 2;
    let mut median = |factor: f64| {
        let relative = |miss: &Miss| miss.size_dn / (miss.ours * factor * factor + miss.frames).sqrt();
        relative(misses.select_nth_unstable_by(middle, |a, b| relative(a).total_cmp(&relative(b))).1)
    };
    let (mut low, mut high) = (1.0, LARGEST_FACTOR);
    // To a hundredth.
    for _halving in 0..9 {
        let between = 0.5 * (low + high);
        if median(between) > NORMAL_MEDIAN {
            low = between;
        } else {
            high = between;
        }
    }
    low
}

fn mean_threshold(problems: &[MapProblem<'_>]) -> f64 {
    problems.first().map_or(0.0, |problem| 0.5 * (problem.sensor.threshold_on + problem.sensor.threshold_off))
}

/// [`DARK_SHARE`] of the range of the frames, DN; where saturation is not known, up to their brightest value.
fn dark_dn(problems: &[MapProblem<'_>]) -> f64 {
    let Some(MapProblem { sensor, .. }) = problems.first() else { return 0.0 };
    let brightest = || {
        problems
            .iter()
            .flat_map(|problem| problem.frames)
            .map(|frame| frame.dn)
            .fold(sensor.black_level_dn + 1.0, f64::max)
    };
    let top = if sensor.saturation_dn.is_finite() { sensor.saturation_dn } else { brightest() };
    DARK_SHARE * (top - sensor.black_level_dn)
}

/// The sum of relative errors of frames that were held out.
fn prediction_error(
    hold: HoldOut,
    problem: &MapProblem<'_>,
    dark_dn: f64,
    solution: &MapSolution<'_>,
) -> [f64; 2] {
    let of = |(_, frame): (usize, &MapFrame)| {
        relative_error(problem, dark_dn, frame, predicted_dn(problem, frame, solution))
    };
    sums(hold.held(problem.frames).map(of))
}

/// What a solution predicts of a frame, DN.
fn predicted_dn(problem: &MapProblem<'_>, frame: &MapFrame, solution: &MapSolution<'_>) -> f64 {
    let light = collected_between(solution.t_ns, solution.log_photocurrent, frame.start_ns, frame.end_ns);
    problem.sensor.black_level_dn + problem.sensor.gain * light
}

/// The sums of some errors and of their squares.
fn sums(errors: impl Iterator<Item = f64>) -> [f64; 2] {
    errors.fold([0.0; 2], |[sum, squares], error| [sum + error, squares + error * error])
}

/// What a predicted DN misses a frame value by, as a part of it; at most [`LARGEST_ERROR`].
fn relative_error(problem: &MapProblem<'_>, dark_dn: f64, frame: &MapFrame, predicted: f64) -> f64 {
    let bright = f64::max(frame.dn - problem.sensor.black_level_dn, 0.0);
    f64::min((predicted - frame.dn).abs() / (bright + dark_dn), LARGEST_ERROR)
}

/// The same as [`prediction_errors_of`], of a blend by time of the frames before and after in the place of a
/// solution.
pub fn blend_errors(hold: HoldOut, problems: &[MapProblem<'_>]) -> [Vec<f64>; 2] {
    let dark_dn = dark_dn(problems);
    let of_problem = |problem: &MapProblem<'_>| {
        let black = problem.sensor.black_level_dn;
        let length = |frame: &MapFrame| (frame.end_ns - frame.start_ns) as f64;
        let middle = |frame: &MapFrame| 0.5 * (frame.start_ns as f64 + frame.end_ns as f64);
        let of = |(l, frame): (usize, &MapFrame)| {
            // One in two or more is held out, and neither the first nor the last.
            let (before, after) = (&problem.frames[l - 1], &problem.frames[l + 1]);
            let share = (middle(frame) - middle(before)) / (middle(after) - middle(before));
            let light = |frame: &MapFrame| (frame.dn - black) / length(frame);
            let blend = (1.0 - share) * light(before) + share * light(after);
            relative_error(problem, dark_dn, frame, black + blend * length(frame))
        };
        sums(hold.held(problem.frames).map(of))
    };
    let (errors, squares) =
        problems.iter().map(of_problem).map(|[errors, squares]| (errors, squares)).unzip();
    [errors, squares]
}
