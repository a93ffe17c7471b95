//! How far events may be believed: estimated from the recording itself.
//!
//! A stated noise is often wrong, and too small a value is far worse than too large a one: the light then bends to meet every threshold.
//! So some pixels are solved with several values, from the large side, and the value is kept that makes their measurements most probable (the
//! marginal likelihood of the problem linearised at its answer).

use super::{MapOptions, MapProblem, MapWorkspace, Noise, solve};

/// Standard deviations of an event that are tried, as parts of a threshold, largest first.
pub const EVENT_NOISES: [f64; 6] = [0.32, 0.16, 0.08, 0.04, 0.02, 0.01];
/// With fewer events than this in all pixels together nothing is estimated.
pub const FEWEST_EVENTS: usize = 40;

/// The event noise that explains `problems` best, or the one of [`Noise::default`] when they have hardly an event.
pub fn event_noise(problems: &[MapProblem<'_>], options: &MapOptions, workspace: &mut MapWorkspace) -> f64 {
    let events: usize = problems.iter().map(|problem| problem.events.len()).sum();
    if events < FEWEST_EVENTS {
        return Noise::default().event;
    }
    let mut best = (f64::NEG_INFINITY, Noise::default().event);
    for event in EVENT_NOISES {
        let mut evidence = 0.0;
        for problem in problems {
            let tried = MapProblem { noise: Noise { event, ..problem.noise }, ..*problem };
            evidence += solve(&tried, options, workspace).log_evidence;
        }
        if evidence > best.0 {
            best = (evidence, event);
        } else {
            // From the large side: what lies beyond a maximum is not looked at.
            break;
        }
    }
    best.1
}
