//! Claims about what is chosen and found for many pixels: noise, prior, factor of standard deviations, lost
//! events.

use super::estimate::Choosing;
use super::tests::{FRONT_END, Recorded, event, few_steps, recorded, sensor, spokes};
use super::*;
use crate::effects::Site;
use crate::forward::{Chain as Pixels, LOG_STEP, LinearLight, Noiseless, Pixel, simulate};
use photocurrent_core::Exposure;
use photocurrent_core::sensor::Reset;

#[test]
fn choices_that_stages_drop_would_not_be_chosen() {
    let mut group = MapGroup::default();
    let recorded = recorded(Reset::Resample);
    let right = recorded.problem(Reset::Resample);
    // Pixels whose thresholds are stated too large, each by a part of its own.
    let stated = |n: usize, most: f64| {
        let threshold_on = 0.2 * (1.0 + most * (n * 7 % 13) as f64 / 12.0);
        MapProblem { sensor: MapSensor { threshold_on, ..right.sensor }, ..right }
    };
    let [right, wrong] = [0.02, 0.8].map(|most| {
        let problems: Vec<MapProblem<'_>> = (0..192).map(|n| stated(n, most)).collect();
        let [in_stages, all] = [Choosing::USUAL.sure, f64::INFINITY].map(|sure| {
            let choosing = Choosing { sure, ..Choosing::USUAL };
            estimate::choose(&problems, None, &choosing, &few_steps(), &mut group)
        });
        assert_eq!(in_stages, all, "{most}");
        in_stages
    });
    assert!(wrong.noise != right.noise, "{:?} and {:?}", wrong.noise, right.noise);
}

#[test]
fn a_sum_is_surely_more_by_standard_errors_of_the_differences() {
    // Differences of -1 and 3: mean 1, standard deviation 2, so that the standard error of a sum of n is
    // 2 sqrt(n), but for the factor of the sample.
    let losses =
        |n: usize| -> Vec<f64> { (0..n).map(|k| 10.0 + if k % 2 == 0 { -1.0 } else { 3.0 }).collect() };
    for (n, by, sure, is_more) in [
        (100, 1.0, 4.9, true),
        (100, 1.0, 5.0, false),
        (4, 1.0, 0.8, true),
        (4, 1.0, 0.9, false),
        (100, 1.05, 2.4, true),
        (100, 1.05, 2.5, false),
        (100, 1.2, 0.0, false),
        (1, 0.1, 0.0, false),
    ] {
        let (losses, others) = (losses(n), vec![10.0; n]);
        assert_eq!(estimate::is_surely_more(&losses, &others, by, sure), is_more, "{n} {by} {sure}");
    }
    assert!(!estimate::is_surely_more(&losses(4), &[], 1.0, 0.0));
}

#[test]
fn more_noise_is_found_where_thresholds_jump() {
    let recorded = recorded(Reset::Resample);
    let mut group = MapGroup::default();
    let options = few_steps();
    // With three frames none is held out: the evidence decides.
    let few = |recorded: &Recorded, group: &mut MapGroup| {
        let problem = MapProblem { frames: &recorded.frames[..3], ..recorded.problem(Reset::Resample) };
        estimate::choose(&[problem; 2], None, &Choosing::USUAL, &options, group).noise.event
    };
    let clean = few(&recorded, &mut group);
    // Stamps moved by up to 150 us to and fro, where the voltage moves by a threshold in that time.
    let mut shaken = recorded;
    for (k, event) in shaken.events.iter_mut().enumerate() {
        let shift = (k as i64 * 7919 % 13 - 6) * 25_000;
        event.t_in_ns += shift;
        event.t_off_ns += shift;
    }
    shaken.events.sort_by_key(|event| event.t_in_ns);
    let noisy = few(&shaken, &mut group);
    assert!(clean <= 0.08 && noisy > clean, "{clean} and {noisy}");
}

#[test]
fn events_are_trusted_less_where_they_mislead_about_frames() {
    let recorded = recorded(Reset::Resample);
    let mut group = MapGroup::default();
    let right = recorded.problem(Reset::Resample);
    let wrong = MapProblem { sensor: MapSensor { threshold_on: 0.3, ..right.sensor }, ..right };
    let found = |problem, group: &mut MapGroup| {
        estimate::choose(&[problem; 2], None, &Choosing::USUAL, &few_steps(), group).noise.event
    };
    let (right, wrong) = (found(right, &mut group), found(wrong, &mut group));
    assert!(wrong > right, "{right} and {wrong}");
}

#[test]
fn nothing_unusual_is_chosen_where_no_gain_is_enough() {
    let recorded = recorded(Reset::Resample);
    let right = recorded.problem(Reset::Resample);
    let wrong = MapProblem { sensor: MapSensor { threshold_on: 0.3, ..right.sensor }, ..right };
    let found = |clear_gain: f64| {
        let choosing = Choosing { clear_gain, ..Choosing::USUAL };
        estimate::choose(&[wrong; 2], None, &choosing, &few_steps(), &mut MapGroup::default())
    };
    let usual = (wrong.noise, Prior::default());
    let part = |choice: estimate::Choice| (choice.noise, choice.prior);
    assert_eq!(part(found(1.0)), usual);
    assert_ne!(part(found(Choosing::USUAL.clear_gain)), usual);
}

#[test]
fn second_starts_are_tried_less_where_they_are_not_kept() {
    // With the noise and the prior that are given: no gain is enough for others.
    let choosing = Choosing { clear_gain: 1.0, ..Choosing::USUAL };
    let second = |problem: MapProblem<'_>| {
        let (problems, mut group) = ([problem; 2], MapGroup::default());
        let choice = estimate::choose(&problems, None, &choosing, &few_steps(), &mut group);
        choice.second.expect("the options have one")
    };
    // Light that falls at once into the dark, which is found from a second start only.
    let dark = spokes();
    let dark = MapProblem { no_event_sigma: 0.03, ..dark.problem(Reset::Resample) };
    assert_eq!(second(dark), SecondStart::USUAL);
    // Events that a wrong threshold misplaces, in light where there is one answer.
    let recorded = recorded(Reset::Resample);
    let right = recorded.problem(Reset::Resample);
    let wrong = MapProblem { sensor: MapSensor { threshold_on: 0.3, ..right.sensor }, ..right };
    let (seldom, usual) = (second(wrong), SecondStart::USUAL);
    assert!(seldom.least_misfit > usual.least_misfit, "{seldom:?}");
    assert_eq!(SecondStart { least_misfit: usual.least_misfit, ..seldom }, usual);
}

#[test]
fn standard_deviations_are_widened_where_frames_are_missed_by_more() {
    let recorded = recorded(Reset::Resample);
    let right = recorded.problem(Reset::Resample);
    // Thresholds stated 50 % too large, of which the noise knows nothing.
    let wrong =
        MapProblem { sensor: MapSensor { threshold_on: 0.3, threshold_off: 0.315, ..right.sensor }, ..right };
    let factor = |problem, count| {
        estimate::too_narrow_by(&mut estimate::misses(
            &vec![problem; count],
            &few_steps(),
            &mut MapGroup::default(),
        ))
    };
    let (reported_right, reported_wrong) = (factor(right, 60), factor(wrong, 60));
    assert!(
        reported_right < 2.0 && reported_wrong > 1.5 * reported_right,
        "{reported_right} and {reported_wrong}"
    );
    // One frame of each is held out: too few to decide.
    assert_eq!(factor(wrong, 10), 1.0);
}

#[test]
fn smooth_slow_light_gets_a_prior_of_its_own() {
    // Log light swings smoothly, by two thresholds each way in 57 ms: few events, and frames that follow a
    // smooth curve.
    let swing = |t: i64| libm::exp(4.5 + 0.6 * libm::sin(t as f64 * 1.1e-7));
    let t_ns: Vec<i64> = (0..=10_000).map(|n| n * 10_000).collect();
    let current: Vec<f64> = t_ns.iter().map(|&t| swing(t)).collect();
    let light = LinearLight::new(&t_ns, &current);
    let frames: Vec<MapFrame> = (0..12)
        .map(|l| {
            let (start_ns, end_ns) = (l * 8_000_000, l * 8_000_000 + 4_000_000);
            MapFrame {
                start_ns,
                end_ns,
                dn: 850.0 * light.integral(Exposure::new(start_ns, end_ns)),
                sigma_dn: 2.0,
                saturated: false,
            }
        })
        .collect();
    let pixel = Pixel {
        front_end: FRONT_END,
        threshold_on: 0.3,
        threshold_off: 0.3,
        latency_ns: 1_000,
        latency_spread_ns: 0.0,
        refractory_ns: 50_000,
        log_step: LOG_STEP,
    };
    let site = Site { x: 0, y: 0, width: 1, height: 1, seed: 0 };
    let fired = simulate(
        &Pixels { pixel, reset: Reset::Resample, effects: &[], tolerance: crate::forward::TOLERANCE },
        &site,
        &light,
        0,
        100_000_000,
        &mut Noiseless,
    );
    let events: Vec<PixelEvent> = fired.iter().map(|fired| fired.event).collect();
    let sensor = MapSensor { threshold_on: 0.3, threshold_off: 0.3, ..sensor(Reset::Resample) };
    let problem = MapProblem::new(sensor, &events, &frames, (0, 100_000_000));
    let copies = vec![problem; estimate::FEWEST_EVENTS / events.len() + 1];
    let mut group = MapGroup::default();
    let choice = estimate::choose(&copies, None, &Choosing::USUAL, &few_steps(), &mut group);
    let restless = match choice.prior {
        Prior::Local(local) => local.floor_per_s > Local::USUAL.floor_per_s,
        Prior::IntegratedWalk { .. } => true,
        Prior::Walk { .. } => false,
    };
    assert!(restless, "{choice:?}");
}

#[test]
fn lone_events_are_doubted_where_they_mislead_about_frames() {
    // Light at rest, and noise: one event inside each frame that is held out.
    let frames: Vec<MapFrame> = (0..12)
        .map(|l| MapFrame {
            start_ns: l * 8_000_000,
            end_ns: l * 8_000_000 + 6_000_000,
            dn: 510.0,
            sigma_dn: 3.0,
            saturated: false,
        })
        .collect();
    let noise_events: Vec<PixelEvent> = [1, 4, 7]
        .into_iter()
        .map(|l| event(l * 8_000_000 + 2_000_000, if l == 4 { -1 } else { 1 }))
        .collect();
    let problem = MapProblem {
        is_lone: &[true; 3],
        ..MapProblem::new(sensor(Reset::Resample), &noise_events, &frames, (0, 95_000_000))
    };
    let choice =
        estimate::choose(&[problem; 14], None, &Choosing::USUAL, &few_steps(), &mut MapGroup::default());
    assert_eq!(choice.noise.lone, LoneEvents::Doubted);
}

#[test]
fn thresholds_of_their_own_are_found_where_pixels_differ() {
    // Stated thresholds too small in one pixel, too large in the other.
    let recorded = recorded(Reset::Resample);
    let right = recorded.problem(Reset::Resample);
    let stated = |factor: f64| MapProblem {
        sensor: MapSensor { threshold_on: 0.2 * factor, threshold_off: 0.21 * factor, ..right.sensor },
        ..right
    };
    let mut group = MapGroup::default();
    let problems = [stated(0.85), stated(1.15)];
    let chosen =
        estimate::choose(&problems, None, &Choosing::USUAL, &few_steps(), &mut MapGroup::default()).noise;
    let mut error = |noise: Noise| {
        let of = |problem: &MapProblem<'_>| {
            let solution = solve(&MapProblem { noise, ..*problem }, &few_steps(), &mut group);
            recorded.error(solution.t_ns, solution.log_photocurrent)
        };
        problems.iter().map(of).sum::<f64>()
    };
    let exact = estimate::EVENT_NOISES
        .iter()
        .map(|&event| error(Noise { event, threshold: 0.0, ..chosen }))
        .fold(f64::INFINITY, f64::min);
    assert!(
        chosen.threshold > 0.0 && error(chosen) < 0.9 * exact,
        "{chosen:?}: {} against {exact}",
        error(chosen)
    );
}

#[test]
fn lost_events_are_found_where_frames_contradict_the_gap_and_nowhere_else() {
    for reset in [Reset::Resample, Reset::Advance] {
        let whole = recorded(reset);
        // One edge goes unseen: light falls by 1.4 while the pixel is silent, and rises again after it.
        let kept = whole
            .events
            .iter()
            .copied()
            .filter(|event| !(10_000_000..17_500_000).contains(&event.t_in_ns))
            .collect();
        let holed = Recorded { light: whole.light.clone(), frames: whole.frames.clone(), events: kept };
        let after = holed.events.partition_point(|event| event.t_in_ns < 17_500_000) as u32;
        assert!(holed.events.len() + 3 < whole.events.len());
        let options = MapOptions { max_iterations: 8, ..MapOptions::default() };
        let mut group = MapGroup::default();
        let tasks = [&whole, &holed, &whole].map(|recorded| MapTask {
            problem: MapProblem { no_event_sigma: 0.03, ..recorded.problem(reset) },
            options,
        });
        let mut plain = [losses::Plain::default(); 3];
        group.solve(&tasks, |n, solution| plain[n] = losses::Plain::of(&solution.outcome));
        let lost = losses::lost_before(&tasks, &plain, &mut group);
        assert_eq!(lost, [vec![], vec![after], vec![]], "{reset:?}");
        // Behind the stretch, light is as if nothing had happened.
        let mut group = MapGroup::default();
        let mut error = |task: &MapTask<'_>, lost_before: &[u32]| {
            let solution = solve(&MapProblem { lost_before, ..task.problem }, &task.options, &mut group);
            whole.error_from(24_000_000, solution.t_ns, solution.log_photocurrent)
        };
        let (before, trusted, doubted) =
            (error(&tasks[0], &[]), error(&tasks[1], &[]), error(&tasks[1], &lost[1]));
        assert!(
            trusted > 3.0 * before && doubted < 1.5 * before,
            "{reset:?}: {before} whole, {trusted} trusted, {doubted} doubted"
        );
    }
}

#[test]
fn a_second_stretch_of_lost_events_is_found_once_the_first_is_known() {
    for reset in [Reset::Resample, Reset::Advance] {
        let whole = recorded(reset);
        let holes = [10_000_000..17_500_000, 24_000_000..31_500_000];
        let in_hole = |event: &PixelEvent| holes.iter().any(|hole| hole.contains(&event.t_in_ns));
        let kept: Vec<PixelEvent> = whole.events.iter().copied().filter(|event| !in_hole(event)).collect();
        let after = |end: i64| kept.partition_point(|event| event.t_in_ns < end) as u32;
        let expected = holes.each_ref().map(|hole| after(hole.end)).to_vec();
        let holed = Recorded { light: whole.light.clone(), frames: whole.frames.clone(), events: kept };
        let task = MapTask {
            problem: MapProblem { no_event_sigma: 0.03, ..holed.problem(reset) },
            options: MapOptions { max_iterations: 8, ..MapOptions::default() },
        };
        let mut group = MapGroup::default();
        let plain = losses::Plain::of(&group.solve_one(&task).outcome);
        assert_eq!(losses::lost_before(&[task], &[plain], &mut group), [expected], "{reset:?}");
    }
}
