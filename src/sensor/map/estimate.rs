//! How far events may be believed: estimated from the recording itself.
//!
//! A stated noise is often wrong, and too small a value is far worse than too large a one: the light then bends to meet every threshold, and is
//! wrong where no event holds it. So some pixels are solved with several values while every third of their frames is kept back, and
//! the value is taken that predicts those frames best. With too few frames for that, the marginal likelihood of the measurements decides;
//! it is the weaker judge, because it believes that the model is right.

use super::segment::collected_between;
use super::{MapFrame, MapOptions, MapProblem, MapWorkspace, Noise, solve};

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
/// A relative error counts at most this: one pixel that went astray does not decide.
const LARGEST_ERROR: f64 = 0.3;

/// The event noise that explains `problems` best, or the one of [`Noise::default`] when they have hardly an event.
pub fn event_noise(problems: &[MapProblem<'_>], options: &MapOptions, workspace: &mut MapWorkspace) -> f64 {
    let events: usize = problems.iter().map(|problem| problem.events.len()).sum();
    if events < FEWEST_EVENTS {
        return Noise::default().event;
    }
    let by_frames = problems.iter().all(|problem| problem.frames.len() >= FEWEST_FRAMES);
    let mut best = (f64::INFINITY, Noise::default().event);
    let mut kept = Vec::new();
    for event in EVENT_NOISES {
        let mut loss = 0.0;
        for problem in problems {
            let tried = MapProblem { noise: Noise { event, ..problem.noise }, ..*problem };
            loss += if by_frames { prediction_error(&tried, options, workspace, &mut kept) } else { -solve(&tried, options, workspace).log_evidence };
        }
        if loss < best.0 {
            best = (loss, event);
        }
    }
    best.1
}

/// The sum of relative errors of frames that were kept back.
fn prediction_error(problem: &MapProblem<'_>, options: &MapOptions, workspace: &mut MapWorkspace, kept: &mut Vec<MapFrame>) -> f64 {
    let last = problem.frames.len() - 1;
    let is_kept_back = |l: usize| l % KEPT_BACK == 1 && l < last;
    kept.clear();
    kept.extend(problem.frames.iter().enumerate().filter(|(l, _)| !is_kept_back(*l)).map(|(_, frame)| *frame));
    let solution = solve(&MapProblem { frames: kept, ..*problem }, options, workspace);
    let mut error = 0.0;
    for (_, frame) in problem.frames.iter().enumerate().filter(|(l, frame)| is_kept_back(*l) && !frame.saturated) {
        let light = collected_between(solution.t_ns, solution.log_photocurrent, frame.start_ns, frame.end_ns);
        let predicted = problem.sensor.black_level_dn + problem.sensor.gain * light;
        let bright = f64::max(frame.dn - problem.sensor.black_level_dn, 0.0);
        error += f64::min((predicted - frame.dn).abs() / (bright + DARK_DN), LARGEST_ERROR);
    }
    error
}
