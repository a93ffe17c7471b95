//! Claims about groups: every pixel gets what it gets alone.

use super::super::knots::Knots;
use super::super::tests::recorded;
use super::super::{
    Hint, Local, LoneEvents, MapFrame, MapGroup, MapOptions, MapProblem, MapStatus, MapTask, PixelEvent,
    Prior, solve,
};
use super::stream::Stream;
use photocurrent_core::sensor::Reset;

/// What a pixel recorded up to an instant.
struct Cut {
    events: Vec<PixelEvent>,
    is_lone: Vec<bool>,
    frames: Vec<MapFrame>,
    hints: Vec<Hint>,
    end_ns: i64,
}

/// Pixels of all lengths, with and without events, hints and saturated values; some with measurements at one
/// instant, some with thresholds so wrong that steps are refused.
fn with_pixels(reset: Reset, then: impl Fn(&[MapTask<'_>])) {
    let whole = recorded(reset);
    let cut: Vec<Cut> = (0..21_i64)
        .map(|n| {
            let end_ns = 40_000_000 - 1_700_000 * n;
            let mut events: Vec<PixelEvent> =
                whole.events.iter().filter(|event| event.t_in_ns <= end_ns).copied().collect();
            let mut frames: Vec<MapFrame> =
                whole.frames.iter().filter(|frame| frame.end_ns <= end_ns).copied().collect();
            if n % 7 == 3 {
                // Frames that differ by more than the no-event constraint allows: steps are refused.
                events.clear();
                for frame in frames.iter_mut().step_by(2) {
                    frame.dn *= 4.0;
                }
            }
            if n % 6 == 2 && events.len() > 2 {
                // An event as an exposure ends, and the latch of one as another fires.
                events[1].t_in_ns = events[0].t_in_ns + 80_000;
                if let Some(frame) = frames.first_mut() {
                    frame.end_ns = events[2].t_in_ns;
                }
            }
            let is_lone = (0..events.len()).map(|k| k % 5 == 1 && n % 3 > 0).collect();
            if n % 6 == 4 && frames.len() > 1 {
                frames[1].saturated = true;
            }
            let hint = |k: i64| Hint {
                t_ns: k * 400_000 + 1,
                log_photocurrent: 4.0 + 0.01 * k as f64,
                variance: 0.04,
                for_sigma: 0.04 * k as f64,
            };
            let hints = if n % 4 == 1 { (0..end_ns / 400_000).map(hint).collect() } else { Vec::new() };
            Cut { events, is_lone, frames, hints, end_ns }
        })
        .collect();
    let mut tasks: Vec<MapTask<'_>> = cut
        .iter()
        .enumerate()
        .map(|(n, Cut { events, is_lone, frames, hints, end_ns })| {
            let mut problem = MapProblem {
                events,
                is_lone,
                frames,
                hints,
                end_ns: *end_ns,
                no_event_sigma: 0.03,
                ..whole.problem(reset)
            };
            problem.lost_before = if n % 7 == 1 { &[0, 2, 6] } else { &[] };
            problem.beyond = if n % 5 == 2 { &[0.03, -0.02, 0.0, 0.05, -0.04, 0.01] } else { &[] };
            problem.sensor.threshold_on *= [1.0, 0.3, 2.5, 1.0, 8.0][n % 5];
            problem.noise.threshold = [0.0, 0.02][n / 8 % 2];
            problem.stamp_sigma_s = [0.0, 1e-6][n % 2];
            problem.noise.lone = [LoneEvents::Doubted, LoneEvents::Trusted][n / 4 % 2];
            let mut options = MapOptions::default();
            let busy = Prior::Local(Local { floor_per_s: 60.0, ..Local::USUAL });
            options.prior = [
                Prior::USUAL,
                busy,
                Prior::Walk { per_s: 1.0, nu: 1.0 },
                Prior::IntegratedWalk { per_s3: 3e6, nu: 3.0 },
            ][n / 2 % 4];
            options.max_iterations = 5 + n % 9;
            options.with_sigma = n % 3 != 1;
            MapTask { problem, options }
        })
        .collect();
    // One pixel several times, as where a noise or a prior is chosen.
    for (event, floor_per_s) in [(0.08, 6.0), (0.3, 6.0), (0.3, 30.0)] {
        let mut again = tasks[0];
        again.problem.noise.event = event;
        again.options.prior = Prior::Local(Local { floor_per_s, ..Local::USUAL });
        tasks.push(again);
    }
    then(&tasks);
}

#[test]
fn a_pixel_gets_the_bits_in_a_group_that_it_gets_alone() {
    for reset in [Reset::Resample, Reset::Advance] {
        with_pixels(reset, |tasks| {
            let mut alone = MapGroup::default();
            let mut group = MapGroup::default();
            let splits = |task: &MapTask<'_>| {
                let (mut knots, mut stream) = (Knots::default(), Stream::default());
                knots.lay(&task.problem, task.options.spacing_ns);
                stream.fill(&task.problem, &knots);
                stream.steps.len() > knots.len()
            };
            assert!(tasks.iter().any(splits), "no knot has several steps");
            let (mut counts, mut failed) = (vec![0; tasks.len()], 0);
            group.solve(tasks, |n, found| {
                counts[n] += 1;
                failed += usize::from(found.outcome.status == MapStatus::Failed);
                let expected = solve(&tasks[n].problem, &tasks[n].options, &mut alone);
                assert_eq!(
                    (found.outcome.status, found.outcome.iterations),
                    (expected.outcome.status, expected.outcome.iterations),
                    "{reset:?} {n}"
                );
                assert_eq!(
                    (found.t_ns, found.outcome.offsets),
                    (expected.t_ns, expected.outcome.offsets),
                    "{reset:?} {n}"
                );
                assert_eq!(found.log_photocurrent, expected.log_photocurrent, "{reset:?} {n}");
                assert_eq!(found.variance, expected.variance, "{reset:?} {n}");
                assert_eq!(
                    (found.outcome.misfit, found.outcome.largest_square, found.outcome.largest_ns),
                    (expected.outcome.misfit, expected.outcome.largest_square, expected.outcome.largest_ns),
                    "{reset:?} {n}"
                );
                assert_eq!(found.outcome.log_evidence, expected.outcome.log_evidence, "{reset:?} {n}");
            });
            assert_eq!(counts, vec![1; tasks.len()]);
            assert!(failed > 0, "no pixel falls back to its start");
            // Steps were refused, or damping would not be looked at. With unknown thresholds and without a
            // blind time none is.
            assert!(
                !group.side_by_side.exact.dampings.is_empty()
                    && (!group.side_by_side.free.dampings.is_empty() || reset == Reset::Advance),
                "{reset:?}"
            );
        });
    }
}
