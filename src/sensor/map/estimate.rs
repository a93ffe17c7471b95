//! How far events may be believed, and which prior suits: estimated from the recording itself.
//!
//! A stated noise is often wrong, and too small a value is far worse than too large a one: the light then bends to meet every threshold, and is
//! wrong where no event holds it. So some pixels are solved with several values while every third of their frames is kept back, and
//! the value is taken that predicts those frames best. With too few frames for that, the marginal likelihood of the measurements decides;
//! it is the weaker judge, because it believes that the model is right.

use super::segment::collected_between;
use super::{Evidence, MapFrame, MapOptions, MapProblem, MapSolution, MapWorkspace, Noise, Prior, solve, solve_with};

/// Standard deviations of an event that are tried, as parts of a threshold, largest first.
pub const EVENT_NOISES: [f64; 3] = [0.32, 0.16, 0.08];
/// With fewer events than this in all pixels together nothing is estimated.
pub const FEWEST_EVENTS: usize = 40;
/// Frames are kept back where there are at least so many.
pub const FEWEST_FRAMES: usize = 4;
/// One in so many frames is kept back, never the first or the last.
const KEPT_BACK: usize = 3;
/// Added to a frame value that an error is compared with, DN: in the dark, noise is not relative.
const DARK_DN: f64 = 20.0;
/// Another prior than the usual one must be better by this factor.
const CLEARLY_BETTER: f64 = 0.97;
/// A relative error counts at most this: one pixel that went astray does not decide.
const LARGEST_ERROR: f64 = 0.3;

/// Steps with another prior, from the light that was found with the usual one.
const WARM_STEPS: usize = 2;

/// What suits a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// Standard deviation of an event as a part of its threshold.
    pub event: f64,
    /// How light is expected to move.
    pub prior: Prior,
}

/// The priors that are tried where frames can be kept back: the usual one, two for light that is hardly ever still (the second for smooth
/// motion), and one for edges that last longer.
pub const PRIORS: [Prior; 4] = [
    Prior::USUAL,
    Prior { floor_per_s: 60.0, ..Prior::USUAL },
    Prior { floor_per_s: 60.0, memory_s: 5e-3, ..Prior::USUAL },
    Prior { memory_s: 4e-3, reach_s: 0.5e-3, ..Prior::USUAL },
];

/// The event noise and the prior that explain `problems` best; the usual ones when they have hardly an event.
///
/// `event` is taken where it is given. Without enough frames to keep back, only the event noise is chosen.
pub fn choose(problems: &[MapProblem<'_>], event: Option<f64>, options: &MapOptions, workspace: &mut MapWorkspace) -> Choice {
    let events: usize = problems.iter().map(|problem| problem.events.len()).sum();
    let usual = Choice { event: event.unwrap_or(Noise::default().event), prior: options.prior };
    if events < FEWEST_EVENTS {
        return usual;
    }
    let by_frames = problems.iter().all(|problem| problem.frames.len() >= FEWEST_FRAMES);
    let options = &MapOptions { with_sigma: false, ..*options };
    let mut kept = Vec::new();
    // What the last noise and the best one made of each pixel: another prior starts from there.
    let (mut tried_lights, mut lights) = (vec![Vec::new(); problems.len()], vec![Vec::new(); problems.len()]);
    let mut best = (f64::INFINITY, usual);
    let noises = match event {
        Some(ref stated) => std::slice::from_ref(stated),
        None => EVENT_NOISES.as_slice(),
    };
    for &event in noises {
        let mut found = 0.0;
        for (problem, light) in problems.iter().zip(&mut tried_lights) {
            let problem = MapProblem { noise: Noise { event, ..problem.noise }, ..*problem };
            found += if by_frames {
                let (error, solution) = prediction_error(&problem, options, None, workspace, &mut kept);
                light.clear();
                light.extend_from_slice(solution.log_photocurrent);
                error
            } else {
                -solve(&problem, options, workspace).log_evidence
            };
        }
        if found < best.0 {
            best = (found, Choice { event, ..usual });
            std::mem::swap(&mut lights, &mut tried_lights);
        }
    }
    if by_frames {
        for prior in PRIORS.into_iter().filter(|prior| *prior != usual.prior) {
            let options = MapOptions { prior, max_iterations: usize::min(options.max_iterations, WARM_STEPS), ..*options };
            let mut found = 0.0;
            for (problem, light) in problems.iter().zip(&lights) {
                let problem = MapProblem { noise: Noise { event: best.1.event, ..problem.noise }, ..*problem };
                found += prediction_error(&problem, &options, Some(light), workspace, &mut kept).0;
            }
            if found < best.0 * CLEARLY_BETTER {
                best = (found, Choice { prior, ..best.1 });
            }
        }
    }
    best.1
}

/// The sum of relative errors of frames that were kept back, and the solution without them.
fn prediction_error<'w>(
    problem: &MapProblem<'_>,
    options: &MapOptions,
    start: Option<&[f64]>,
    workspace: &'w mut MapWorkspace,
    kept: &mut Vec<MapFrame>,
) -> (f64, MapSolution<'w>) {
    let last = problem.frames.len() - 1;
    let is_kept_back = |l: usize| l % KEPT_BACK == 1 && l < last;
    kept.clear();
    kept.extend(problem.frames.iter().enumerate().filter(|(l, _)| !is_kept_back(*l)).map(|(_, frame)| *frame));
    let solution = solve_with(&MapProblem { frames: kept, ..*problem }, options, start, Evidence::Unwanted, workspace);
    let mut error = 0.0;
    for (_, frame) in problem.frames.iter().enumerate().filter(|(l, frame)| is_kept_back(*l) && !frame.saturated) {
        let light = collected_between(solution.t_ns, solution.log_photocurrent, frame.start_ns, frame.end_ns);
        let predicted = problem.sensor.black_level_dn + problem.sensor.gain * light;
        let bright = f64::max(frame.dn - problem.sensor.black_level_dn, 0.0);
        error += f64::min((predicted - frame.dn).abs() / (bright + DARK_DN), LARGEST_ERROR);
    }
    (error, solution)
}
