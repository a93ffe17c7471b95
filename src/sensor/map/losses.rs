//! Where events were lost: gaps that the rest of a pixel's measurements contradict.
//!
//! A readout that is too busy, or a file with a hole, loses events. To the solver the pixel was then silent:
//! light that stays within a threshold of an old reference, and a first event after it that is one threshold
//! away from that. Frames say otherwise, and the wrong event bends light and thresholds far around. So where
//! a measurement is far off, the pixel's longest gaps near by are tried: solved again as stretches in which
//! events were lost. Nothing in them counts but frames, and the first event after them only takes the
//! reference anew. What makes the measurements clearly more likely is kept.
//!
//! Limits: a stretch must hold the middle of an exposure and end with an event.

use super::group::MapGroup;
use super::options::{Evidence, MapOptions, MapOutcome, MapTask, Second};
use super::problem::{MapFrame, MapProblem};

/// Pixels with an event or a frame that is further off than this, in squared standard deviations, are looked
/// at.
const SUSPICIOUS: f64 = 6.0;
/// So many gaps of a pixel are tried, the longest.
const MOST_TRIED: usize = 3;
/// A gap is tried when it is so many times as long as the pixel's events are apart on average, ...
const LONG: i64 = 3;
/// ... and what is furthest off was measured in it, or away from it by so many times its length at most, ...
const NEAR: i64 = 1;
/// ... and events were lost there when the measurements become more likely by this much, natural-log units:
/// an event that is left away saves 2 at most where it fits.
const CLEAR_GAIN: f64 = 10.0;

/// How a pixel came out when nothing was taken for lost.
#[derive(Clone, Copy, Debug, Default)]
pub struct Plain {
    /// The square of the largest whitened residual.
    pub largest_square: f64,
    /// When it was measured, ns.
    pub largest_ns: i64,
    /// Log of the measurements' marginal likelihood.
    pub log_evidence: f64,
    /// What became of its second start.
    pub second: Second,
}

impl Plain {
    /// Of a solution.
    pub fn of(outcome: &MapOutcome) -> Plain {
        let MapOutcome { largest_square, largest_ns, log_evidence, second, .. } = *outcome;
        Plain { largest_square, largest_ns, log_evidence, second }
    }
}

/// For each task, the events before which events were lost, rising: what belongs in
/// [`MapProblem::lost_before`]. `plain` says how each came out.
///
/// The gap that gains most is taken first, the others only for what they gain in addition: one that is
/// contradicted bends light in all. Costs up to three solutions for each pixel that is suspicious, more only
/// where something is found, and nothing for the others.
pub fn lost_before(tasks: &[MapTask<'_>], plain: &[Plain], group: &mut MapGroup) -> Vec<Vec<u32>> {
    let mut found = vec![Vec::new(); tasks.len()];
    let mut now = plain.to_vec();
    let gaps = |(task, plain): (&MapTask<'_>, &Plain)| long_gaps(&task.problem, plain, &[]);
    let mut left: Vec<Vec<u32>> = tasks.iter().zip(plain).map(gaps).collect();
    for _round in 0..MOST_TRIED {
        let suspects: Vec<(usize, Vec<u32>)> = left
            .iter()
            .enumerate()
            .flat_map(|(n, events)| events.iter().map(move |event| (n, *event)))
            .map(|(n, event)| {
                let mut events: Vec<u32> = found[n].iter().copied().chain([event]).collect();
                events.sort_unstable();
                (n, events)
            })
            .collect();
        let trials: Vec<MapTask<'_>> = suspects
            .iter()
            .map(|(n, lost_before)| {
                let MapTask { problem, options } = tasks[*n];
                let second = options.second.filter(|_| plain[*n].second == Second::Kept);
                MapTask {
                    problem: MapProblem { lost_before, ..problem },
                    options: MapOptions { with_sigma: false, second, ..options },
                }
            })
            .collect();
        let mut came_out = vec![Plain::default(); trials.len()];
        group.solve_with(&trials, Evidence::Wanted, &mut |trial, solution| {
            came_out[trial] = Plain::of(&solution.outcome)
        });
        let mut best: Vec<Option<usize>> = vec![None; tasks.len()];
        for (trial, (n, _)) in suspects.iter().enumerate() {
            let to_beat =
                best[*n].map_or(now[*n].log_evidence + CLEAR_GAIN, |best| came_out[best].log_evidence);
            if came_out[trial].log_evidence > to_beat {
                best[*n] = Some(trial);
            }
        }
        for (n, left) in left.iter_mut().enumerate() {
            match best[n] {
                Some(trial) => {
                    (found[n], now[n]) = (suspects[trial].1.clone(), came_out[trial]);
                    *left = long_gaps(&tasks[n].problem, &now[n], &found[n]);
                }
                None => left.clear(),
            }
        }
    }
    found
}

/// The events that end the longest gaps with the middle of an exposure inside and near what is furthest off,
/// at most [`MOST_TRIED`] besides those that are found; none where nothing is far off.
fn long_gaps(problem: &MapProblem<'_>, plain: &Plain, found: &[u32]) -> Vec<u32> {
    let MapProblem { events, frames, start_ns, end_ns, .. } = *problem;
    if plain.largest_square <= SUSPICIOUS {
        return Vec::new();
    }
    let apart_ns = (end_ns - start_ns) / (events.len() as i64 + 1);
    let middle = |frame: &MapFrame| frame.start_ns + (frame.end_ns - frame.start_ns) / 2;
    let mut gaps: Vec<(i64, u32)> = Vec::new();
    for (event, pair) in (1..).zip(events.windows(2)) {
        let (from, to) = (pair[0].t_off_ns + problem.sensor.refractory_ns, pair[1].t_in_ns);
        let reach_ns = NEAR * (to - from);
        if to - from > LONG * apart_ns
            && (from - reach_ns..=to + reach_ns).contains(&plain.largest_ns)
            && frames.iter().any(|frame| (from..to).contains(&middle(frame)))
            && !found.contains(&event)
        {
            gaps.push((to - from, event));
        }
    }
    gaps.sort_unstable_by_key(|gap| std::cmp::Reverse(*gap));
    gaps.truncate(MOST_TRIED);
    gaps.into_iter().map(|(_, event)| event).collect()
}
