//! Claims about the solver: its step against dense algebra, and light that was simulated by the forward model.

use super::estimate::Choosing;
use super::*;
use crate::effects::Site;
use crate::forward::{Chain as Pixels, LOG_STEP, LinearLight, Noiseless, Pixel, simulate};
use nalgebra::{DMatrix, DVector};
use photocurrent_core::Exposure;

const FRONT_END: FrontEnd = FrontEnd { tau_0_s: 20e-6, alpha_s: 12e-3 };

fn sensor(reset: Reset) -> MapSensor {
    MapSensor {
        front_end: FRONT_END,
        threshold_on: 0.2,
        threshold_off: 0.21,
        reset,
        refractory_ns: 50_000,
        gain: 850.0,
        black_level_dn: 0.0,
        saturation_dn: f64::INFINITY,
    }
}

fn event(t_in_ns: i64, polarity: i8) -> MapEvent {
    MapEvent { t_in_ns, t_off_ns: t_in_ns + 30_000, polarity, is_lone: false }
}

/// Whitened residuals of everything, with frozen prior scales: written down again, from the rows of the chain and the text of the prior.
fn whitened(problem: &MapProblem<'_>, knots: &Knots, segments: &Segments, first: f64, unknowns: &DVector<f64>) -> DVector<f64> {
    let n = knots.len();
    let u: Vec<f64> = unknowns.iter().copied().take(n).collect();
    let offsets = Offsets { reference: unknowns[n], on: unknowns[n + 1], off: unknowns[n + 2] };
    let mut chain = Chain::default();
    chain.run(problem, knots, segments, &u, &offsets);
    let mut rows: Vec<f64> = vec![(u[0] - first) / 3.0, offsets.reference / problem.noise.reference];
    rows.extend([offsets.on / problem.noise.threshold, offsets.off / problem.noise.threshold]);
    let mut before = 0.0;
    for j in 1..n {
        let z = (u[j] - u[j - 1]) / segments.scale[j];
        let correlation = segments.correlation[j];
        rows.push((z - correlation * before) / segments.fresh[j].sqrt());
        before = z;
    }
    rows.extend(chain.rows.iter().map(|row| if row.sight == chain::Sight::None { 0.0 } else { row.residual / row.variance.sqrt() }));
    DVector::from_vec(rows)
}

#[test]
fn one_step_is_that_of_dense_algebra_with_numerical_derivatives() {
    let families = [Prior::USUAL, Prior::Walk { per_s: 1.0, nu: 1.0 }, Prior::IntegratedWalk { per_s3: 3e6, nu: 3.0 }];
    for (reset, prior) in [Reset::Resample, Reset::Advance].into_iter().flat_map(|reset| families.map(|prior| (reset, prior))) {
        let events = [event(2_100_000, 1), event(2_900_000, 1), event(5_000_000, -1), event(5_080_500, -1), event(9_000_000, 1)];
        let frame = |start_ns: i64, dn: f64| MapFrame { start_ns, end_ns: start_ns + 3_000_000, dn, sigma_dn: 2.0, saturated: false };
        let frames = [frame(500_000, 250.0), frame(6_000_000, 260.0)];
        // One between events, one at an event's instant.
        let hint = |t_ns, log_photocurrent, variance| Hint { t_ns, log_photocurrent, variance, for_sigma: variance };
        let hints = [hint(4_100_000, 4.7, 0.01), hint(9_000_000, 4.5, 0.04)];
        let noise = Noise { event: 0.1, reference: 0.03, threshold: 0.02, ..Noise::default() };
        let problem = MapProblem {
            events: &events,
            frames: &frames,
            hints: &hints,
            start_ns: 0,
            end_ns: 10_000_000,
            sensor: sensor(reset),
            noise,
            stamp_sigma_s: 0.0,
            no_event_sigma: 0.0,
            lost_before: &[],
            beyond: &[],
        };
        let (mut knots, mut segments, mut u) = (Knots::default(), Segments::default(), Vec::new());
        knots.lay(&problem, 1_000_000);
        segments.lay(&knots.t_ns, &prior);
        Start::default().fill(&problem, &knots, &mut u);
        let first = u[0] + 0.05;
        segments.adapt(&u, &prior);
        let offsets = Offsets { reference: 0.01, on: -0.01, off: 0.015 };
        let (mut chain, mut smoother) = (Chain::default(), Smoother::default());
        chain.run(&problem, &knots, &segments, &u, &offsets);
        segments.cost(&u);
        smoother.solve(&ask(&problem, &knots, &segments, &chain, &u, first, &offsets, 0.0, 0.0, Want::Variance));

        let n = knots.len();
        let at = DVector::from_iterator(n + 3, u.iter().copied().chain([offsets.reference, offsets.on, offsets.off]));
        let rows = |x: &DVector<f64>| whitened(&problem, &knots, &segments, first, x);
        let here = rows(&at);
        let mut jacobian = DMatrix::zeros(here.len(), n + 3);
        for column in 0..n + 3 {
            let (mut above, mut below) = (at.clone(), at.clone());
            above[column] += 1e-5;
            below[column] -= 1e-5;
            jacobian.set_column(column, &((rows(&above) - rows(&below)) / 2e-5));
        }
        let covariance = (jacobian.transpose() * &jacobian).try_inverse().expect("a prior makes it regular");
        let step = -(&covariance * jacobian.transpose() * &here);
        // Second differences of rows up to 1e4 in size: a relative error of 1e-5 is what numerical derivatives allow.
        for j in 0..n {
            assert!((smoother.change[j] - step[j]).abs() < 1e-4 * (0.1 + step[j].abs()), "{reset:?} knot {j}: {} against {}", smoother.change[j], step[j]);
            assert!(
                (smoother.variance[j] / covariance[(j, j)] - 1.0).abs() < 1e-3,
                "{reset:?} knot {j}: {} against {}",
                smoother.variance[j],
                covariance[(j, j)]
            );
        }
        for (moved, expected) in [(smoother.offsets.reference, step[n]), (smoother.offsets.on, step[n + 1]), (smoother.offsets.off, step[n + 2])] {
            assert!((moved - expected).abs() < 1e-4 * (0.01 + expected.abs()), "{reset:?}: {moved} against {expected}");
        }

        // What hints count as for the variance changes that alone, as if they were that much worse.
        let mut asked = |variance: f64, for_sigma: f64, want: Want| {
            let hints = hints.map(|hint| Hint { variance: variance * hint.variance, for_sigma: for_sigma * hint.variance, ..hint });
            let problem = MapProblem { hints: &hints, ..problem };
            chain.run(&problem, &knots, &segments, &u, &offsets);
            smoother.solve(&ask(&problem, &knots, &segments, &chain, &u, first, &offsets, 0.0, 0.0, want));
            (smoother.variance.clone(), smoother.change.clone())
        };
        let (wide, worse) = (asked(1.0, 9.0, Want::Variance).0, asked(9.0, 9.0, Want::Variance).0);
        assert_eq!(wide, worse, "{reset:?}");
        assert!(wide.iter().zip(asked(1.0, 1.0, Want::Variance).0).all(|(wide, narrow)| *wide >= narrow) && wide != asked(1.0, 1.0, Want::Variance).0);
        assert_eq!(asked(1.0, 9.0, Want::Step).1, asked(1.0, 1.0, Want::Step).1, "{reset:?}");
    }
}

/// A pixel that sees an edge pass, as the forward model records it.
pub(super) struct Recorded {
    light: (Vec<i64>, Vec<f64>),
    pub events: Vec<MapEvent>,
    pub frames: Vec<MapFrame>,
}

const END_NS: i64 = 40_000_000;

/// As many steps as are taken where many pixels are solved: noise and prior are chosen for these.
fn few_steps() -> MapOptions {
    MapOptions { max_iterations: 5, ..MapOptions::default() }
}

/// Log light between 3.4 and 4.8, with steep sides, once every 14 ms.
pub(super) fn recorded(reset: Reset) -> Recorded {
    recorded_of(reset, |t_ns| 4.1 + 0.7 * libm::tanh(4.0 * libm::sin(t_ns as f64 * 4.5e-7)))
}

/// The same of any log light.
fn recorded_of(reset: Reset, log_light: impl Fn(i64) -> f64) -> Recorded {
    let t_ns: Vec<i64> = (0..=4000).map(|n| n * 10_000).collect();
    let current: Vec<f64> = t_ns.iter().map(|&t| libm::exp(log_light(t))).collect();
    let light = LinearLight::new(&t_ns, &current);
    let pixel = Pixel {
        front_end: FRONT_END,
        threshold_on: 0.2,
        threshold_off: 0.21,
        latency_ns: 30_000,
        latency_spread_ns: 0.0,
        refractory_ns: if reset == Reset::Resample { 50_000 } else { 0 },
        log_step: LOG_STEP,
    };
    let site = Site { x: 0, y: 0, width: 1, height: 1, seed: 0 };
    let fired = simulate(&Pixels { pixel, reset, effects: &[], tolerance: crate::forward::TOLERANCE }, &site, &light, 0, END_NS, &mut Noiseless);
    let events = fired.iter().map(|f| MapEvent { t_in_ns: f.event.t_in_ns, t_off_ns: f.event.t_off_ns, polarity: f.event.polarity, is_lone: false }).collect();
    let frames = (0..5).map(|l| {
        let (start_ns, end_ns) = (l * 8_000_000, l * 8_000_000 + 6_000_000);
        MapFrame { start_ns, end_ns, dn: 850.0 * light.integral(Exposure::new(start_ns, end_ns)), sigma_dn: 1.5, saturated: false }
    });
    Recorded { frames: frames.collect(), events, light: (t_ns, current) }
}

impl Recorded {
    pub fn problem(&self, reset: Reset) -> MapProblem<'_> {
        let sensor = MapSensor { refractory_ns: if reset == Reset::Resample { 50_000 } else { 0 }, ..sensor(reset) };
        let noise = Noise { event: 0.02, ..Noise::default() };
        MapProblem {
            events: &self.events,
            frames: &self.frames,
            hints: &[],
            start_ns: 0,
            end_ns: END_NS,
            sensor,
            noise,
            stamp_sigma_s: 0.0,
            no_event_sigma: 0.0,
            lost_before: &[],
            beyond: &[],
        }
    }

    /// The rms error of log light over the recording, of knots joined by lines.
    fn error(&self, t_ns: &[i64], u: &[f64]) -> f64 {
        self.error_from(0, t_ns, u)
    }

    /// The same from an instant on.
    fn error_from(&self, from_ns: i64, t_ns: &[i64], u: &[f64]) -> f64 {
        let from = self.light.0.partition_point(|t| *t < from_ns);
        let squares = self.light.0[from..].iter().zip(&self.light.1[from..]).map(|(&t, i)| {
            let k = t_ns.partition_point(|&knot| knot <= t).clamp(1, t_ns.len() - 1);
            let share = (t - t_ns[k - 1]) as f64 / (t_ns[k] - t_ns[k - 1]) as f64;
            let error = u[k - 1] + share * (u[k] - u[k - 1]) - libm::log(*i);
            error * error
        });
        (squares.sum::<f64>() / (self.light.0.len() - from) as f64).sqrt()
    }
}

#[test]
fn a_ramp_of_five_events_converges_with_the_default_options() {
    let levels = [Reset::Resample, Reset::Advance].into_iter().flat_map(|reset| [1.0, 4.0, 7.0].map(|darkest| (reset, darkest)));
    for ((reset, darkest), rise_ns) in levels.flat_map(|level| [5_000_000, 20_000_000, 36_000_000].map(|rise_ns| (level, rise_ns))) {
        // 1.15 natural-log units are five thresholds of 0.2 and what is missed during four readouts.
        let recorded = recorded_of(reset, |t_ns| darkest + 1.15 * ((t_ns - 2_000_000) as f64 / rise_ns as f64).clamp(0.0, 1.0));
        assert_eq!(recorded.events.iter().map(|event| event.polarity).collect::<Vec<_>>(), [1; 5]);
        let frames = [recorded.frames[0], recorded.frames[4]];
        let problem = MapProblem { frames: &frames, noise: Noise::default(), ..recorded.problem(reset) };
        let mut workspace = MapWorkspace::default();
        let solution = solve(&problem, &MapOptions::default(), &mut workspace);
        let (status, iterations) = (solution.status, solution.iterations);
        assert_eq!(status, MapStatus::Converged, "{reset:?}, from {darkest} in {rise_ns} ns: {iterations} steps");
        // Between two events the light is known to a threshold; the estimate misses by less than half of one.
        let error = recorded.error(solution.t_ns, solution.log_photocurrent);
        assert!(error < 0.1, "{reset:?}, from {darkest} in {rise_ns} ns: {error}");
    }
}

#[test]
fn steep_light_comes_back_for_both_reset_rules() {
    for reset in [Reset::Resample, Reset::Advance] {
        let recorded = recorded(reset);
        assert!(recorded.events.len() > 20, "{}", recorded.events.len());
        let mut workspace = MapWorkspace::default();
        let problem = recorded.problem(reset);
        let solution = solve(&problem, &MapOptions::default(), &mut workspace);
        let error = recorded.error(solution.t_ns, solution.log_photocurrent);
        // Thresholds are 0.2: a fifth of one is what knots 250 us apart and a time constant held over them leave.
        assert!(error < 0.04, "{reset:?}: {error}");
        // The start is the double integral: the solver must be several times better, or it is not worth its time.
        let mut start = Vec::new();
        let knots = workspace.knots.clone();
        Start::default().fill(&problem, &knots, &mut start);
        assert!(recorded.error(&knots.t_ns, &start) > 3.0 * error, "{reset:?}");
    }
}

#[test]
fn light_that_falls_at_once_into_the_dark_is_found_from_a_second_start() {
    // 298 DN an exposure and 17, as a spoke of a star passes: at 17 DN the front end takes 4 ms.
    let spokes = |t_ns: i64| {
        let phase = (t_ns as f64 * 1e-6) % 13.0;
        let bright = f64::max(1.0 - f64::max((5.0 - phase).abs() - 2.5, 0.0), 0.0);
        libm::log(3.3 + 55.2 * bright)
    };
    let recorded = recorded_of(Reset::Resample, spokes);
    let problem = MapProblem { no_event_sigma: 0.03, ..recorded.problem(Reset::Resample) };
    let error = |second| {
        let mut workspace = MapWorkspace::default();
        let solution = solve(&problem, &MapOptions { second, ..MapOptions::default() }, &mut workspace);
        recorded.error(solution.t_ns, solution.log_photocurrent)
    };
    let (once, twice) = (error(None), error(Some(SecondStart::USUAL)));
    // 0.43 and 0.28 natural-log units.
    assert!(twice < 0.75 * once, "{once} and {twice}");
    // Of one misfit in all: nothing is tried where frames have it, and not events.
    let measured = (problem.events.len() + problem.frames.len()) as f64;
    let is_tried = |event_square: f64| {
        SecondStart::USUAL.is_worth_a_try(&problem, MapStatus::Converged, measured, &Misfit { event_square, events: 10, ..Misfit::default() })
    };
    assert!(is_tried(1.1) && !is_tried(0.9));
    // With a front end that is as slow in the light there is one answer, and nothing is tried.
    let even = MapProblem { sensor: MapSensor { front_end: FrontEnd { tau_0_s: 100e-6, alpha_s: 0.0 }, ..problem.sensor }, ..problem };
    assert!(!SecondStart::USUAL.is_worth_a_try(&even, MapStatus::Failed, 1e9, &Misfit::default()));
}

#[test]
fn choices_that_a_third_of_many_pixels_leaves_away_would_not_be_chosen() {
    let mut group = MapGroup::default();
    let options = few_steps();
    let recorded = recorded(Reset::Resample);
    let right = recorded.problem(Reset::Resample);
    let wrong = MapProblem { sensor: MapSensor { threshold_on: 0.3, ..right.sensor }, ..right };
    // Fewer than 48 pixels look at everything.
    let [[right, right_in_turn], [wrong, wrong_in_turn]] =
        [right, wrong].map(|problem| [45, 48].map(|pixels| estimate::choose(&vec![problem; pixels], None, &Choosing::USUAL, &options, &mut group)));
    assert_eq!((right, wrong), (right_in_turn, wrong_in_turn));
    assert!(wrong.noise.event > right.noise.event, "{} and {}", right.noise.event, wrong.noise.event);
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
    let found = |problem, group: &mut MapGroup| estimate::choose(&[problem; 2], None, &Choosing::USUAL, &few_steps(), group).noise.event;
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
    let usual = estimate::Choice { noise: wrong.noise, prior: Prior::default() };
    assert_eq!(found(1.0), usual);
    assert_ne!(found(Choosing::USUAL.clear_gain), usual);
}

#[test]
fn standard_deviations_are_widened_where_frames_are_missed_by_more() {
    let recorded = recorded(Reset::Resample);
    let right = recorded.problem(Reset::Resample);
    // Thresholds stated 50 % too large, of which the noise knows nothing.
    let wrong = MapProblem { sensor: MapSensor { threshold_on: 0.3, threshold_off: 0.315, ..right.sensor }, ..right };
    let factor = |problem, count| estimate::too_narrow_by(&mut estimate::misses(&vec![problem; count], &few_steps(), &mut MapGroup::default()));
    let (reported_right, reported_wrong) = (factor(right, 60), factor(wrong, 60));
    assert!(reported_right < 2.0 && reported_wrong > 1.5 * reported_right, "{reported_right} and {reported_wrong}");
    // One frame of each is held out: too few to decide.
    assert_eq!(factor(wrong, 10), 1.0);
}

#[test]
fn a_pixel_without_events_is_as_bright_as_its_frames() {
    let frame = |start_ns: i64| MapFrame { start_ns, end_ns: start_ns + 5_000_000, dn: 425.0, sigma_dn: 1.0, saturated: false };
    let frames = [frame(0), frame(8_000_000)];
    let problem = MapProblem {
        events: &[],
        frames: &frames,
        hints: &[],
        start_ns: -1_000_000,
        end_ns: 20_000_000,
        sensor: sensor(Reset::Resample),
        noise: Noise::default(),
        stamp_sigma_s: 0.0,
        no_event_sigma: 0.0,
        lost_before: &[],
        beyond: &[],
    };
    let mut workspace = MapWorkspace::default();
    let solution = solve(&problem, &MapOptions::default(), &mut workspace);
    assert_eq!(solution.status, MapStatus::Converged);
    // 425 DN = 850 x 5 ms x 100.
    assert!(solution.log_photocurrent.iter().all(|u| (u - libm::log(100.0)).abs() < 1e-6));
}

#[test]
fn smooth_slow_light_gets_a_prior_of_its_own() {
    // Log light swings smoothly, by two thresholds each way in 57 ms: few events, and frames that follow a smooth curve.
    let swing = |t: i64| libm::exp(4.5 + 0.6 * libm::sin(t as f64 * 1.1e-7));
    let t_ns: Vec<i64> = (0..=10_000).map(|n| n * 10_000).collect();
    let current: Vec<f64> = t_ns.iter().map(|&t| swing(t)).collect();
    let light = LinearLight::new(&t_ns, &current);
    let frames: Vec<MapFrame> = (0..12)
        .map(|l| {
            let (start_ns, end_ns) = (l * 8_000_000, l * 8_000_000 + 4_000_000);
            MapFrame { start_ns, end_ns, dn: 850.0 * light.integral(Exposure::new(start_ns, end_ns)), sigma_dn: 2.0, saturated: false }
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
    let fired =
        simulate(&Pixels { pixel, reset: Reset::Resample, effects: &[], tolerance: crate::forward::TOLERANCE }, &site, &light, 0, 100_000_000, &mut Noiseless);
    let events: Vec<MapEvent> =
        fired.iter().map(|f| MapEvent { t_in_ns: f.event.t_in_ns, t_off_ns: f.event.t_off_ns, polarity: f.event.polarity, is_lone: false }).collect();
    let sensor = MapSensor { threshold_on: 0.3, threshold_off: 0.3, ..sensor(Reset::Resample) };
    let problem = MapProblem {
        events: &events,
        frames: &frames,
        hints: &[],
        start_ns: 0,
        end_ns: 100_000_000,
        sensor,
        noise: Noise::default(),
        stamp_sigma_s: 0.0,
        no_event_sigma: 0.0,
        lost_before: &[],
        beyond: &[],
    };
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
fn light_that_would_have_fired_is_pulled_back() {
    // Two frames that say 100 and 160, and not one event between them: the change is 0.47 where 0.2 would have fired.
    let frame = |start_ns: i64, dn: f64| MapFrame { start_ns, end_ns: start_ns + 5_000_000, dn, sigma_dn: 20.0, saturated: false };
    let frames = [frame(0, 425.0), frame(8_000_000, 680.0)];
    let change = |no_event_sigma: f64| {
        let sensor = sensor(Reset::Resample);
        let noise = Noise { reference: 0.001, ..Noise::default() };
        let problem = MapProblem {
            events: &[],
            frames: &frames,
            hints: &[],
            start_ns: 0,
            end_ns: 14_000_000,
            sensor,
            noise,
            stamp_sigma_s: 0.0,
            lost_before: &[],
            beyond: &[],
            no_event_sigma,
        };
        let mut workspace = MapWorkspace::default();
        let u = solve(&problem, &MapOptions { max_iterations: 8, ..MapOptions::default() }, &mut workspace).log_photocurrent.to_vec();
        u[u.len() - 1] - u[0]
    };
    let (free, silent) = (change(0.0), change(0.01));
    assert!(free > 0.3 && silent < 0.27 && silent > 0.1, "{free} and {silent}");
}

#[test]
fn light_that_frames_cannot_have_seen_is_implausible() {
    let frames = [MapFrame { start_ns: 0, end_ns: 5_000_000, dn: 425.0, sigma_dn: 1.0, saturated: false }];
    let recorded = recorded(Reset::Resample);
    let problem = MapProblem { frames: &frames, ..recorded.problem(Reset::Resample) };
    // The frame's mean is 100: six times as much may pass between two frames, a hundred times as much does not.
    assert!(!has_run_away(&problem, &[libm::log(100.0), libm::log(600.0)]));
    assert!(has_run_away(&problem, &[libm::log(100.0), libm::log(10_000.0)]));
    let saturated = [MapFrame { saturated: true, ..frames[0] }];
    assert!(!has_run_away(&MapProblem { frames: &saturated, ..problem }, &[libm::log(10_000.0)]));
}

#[test]
fn a_saturated_value_is_a_lower_bound_only() {
    let frame = |start_ns: i64, dn: f64, saturated| MapFrame { start_ns, end_ns: start_ns + 5_000_000, dn, sigma_dn: 1.0, saturated };
    let problem = |frames| MapProblem {
        events: &[],
        frames,
        hints: &[],
        start_ns: 0,
        end_ns: 15_000_000,
        sensor: sensor(Reset::Resample),
        noise: Noise::default(),
        stamp_sigma_s: 0.0,
        no_event_sigma: 0.0,
        lost_before: &[],
        beyond: &[],
    };
    let mut workspace = MapWorkspace::default();
    // Brighter than the bound: the bound has no say.
    let above = [frame(0, 850.0, false), frame(8_000_000, 425.0, true)];
    let u = solve(&problem(&above), &MapOptions::default(), &mut workspace).log_photocurrent.to_vec();
    assert!((u[u.len() - 1] - libm::log(200.0)).abs() < 0.02, "{}", u[u.len() - 1]);
    // Darker: it pulls up.
    let below = [frame(0, 425.0, false), frame(8_000_000, 850.0, true)];
    let solution = solve(&problem(&below), &MapOptions::default(), &mut workspace);
    assert!(solution.log_photocurrent[solution.log_photocurrent.len() - 1] > libm::log(150.0));
}

#[test]
fn shifting_time_changes_nothing() {
    let recorded = recorded(Reset::Resample);
    let mut workspace = MapWorkspace::default();
    let here = solve(&recorded.problem(Reset::Resample), &MapOptions::default(), &mut workspace).log_photocurrent.to_vec();
    let shift = 3_600_000_000_000;
    let events: Vec<MapEvent> =
        recorded.events.iter().map(|e| MapEvent { t_in_ns: e.t_in_ns + shift, t_off_ns: e.t_off_ns + shift, polarity: e.polarity, is_lone: false }).collect();
    let frames: Vec<MapFrame> = recorded.frames.iter().map(|f| MapFrame { start_ns: f.start_ns + shift, end_ns: f.end_ns + shift, ..*f }).collect();
    let later = MapProblem { events: &events, frames: &frames, hints: &[], start_ns: shift, end_ns: END_NS + shift, ..recorded.problem(Reset::Resample) };
    assert_eq!(solve(&later, &MapOptions::default(), &mut workspace).log_photocurrent, here);
}

/// Thresholds of the pixel that [`recorded`] simulates, as parts of those that the problem states.
fn found_thresholds(on: f64, off: f64) -> (f64, f64) {
    let recorded = recorded(Reset::Resample);
    let right = recorded.problem(Reset::Resample);
    let sensor = MapSensor { threshold_on: 0.2 / on, threshold_off: 0.21 / off, ..right.sensor };
    let noise = Noise { event: 0.08, threshold: 0.03, ..right.noise };
    let problem = MapProblem { sensor, noise, ..right };
    let mut workspace = MapWorkspace::default();
    let solution = solve(&problem, &MapOptions { max_iterations: 20, ..MapOptions::default() }, &mut workspace);
    (1.0 + solution.offsets.on / sensor.threshold_on, 1.0 + solution.offsets.off / sensor.threshold_off)
}

#[test]
fn thresholds_that_are_stated_wrong_are_found_from_the_frames() {
    for (on, off) in [(1.0, 1.0), (0.85, 0.85), (1.15, 1.15), (1.1, 0.95)] {
        let found = found_thresholds(on, off);
        // Stated to 15 %, so an error of 15 % is met about half-way. Thresholds that are right stay to a third of that.
        assert!((found.0 - on).abs() < 0.08 && (found.1 - off).abs() < 0.08, "{on} and {off}: found {found:?}");
        assert!(on != 1.0 || ((found.0 - 1.0).abs() < 0.05 && (found.1 - 1.0).abs() < 0.05), "found {found:?}");
    }
}

#[test]
fn what_is_expected_of_thresholds_makes_the_prior_blind_to_scale() {
    // Twice the light and twice the thresholds cost the prior 4 P less 2 P log(4) in its own units; to first order around 1 nothing changes:
    // d/ds [P s^2 - 2 sum(expected offset) / sigma^2] = 0 along offset = (s - 1) threshold.
    let events = [event(1_000_000, 1), event(2_000_000, 1), event(3_000_000, -1)];
    let recorded = recorded(Reset::Resample);
    let problem = MapProblem { events: &events, noise: Noise { threshold: 0.02, ..Noise::default() }, ..recorded.problem(Reset::Resample) };
    let (prior_cost, offsets) = (37.0, Offsets { reference: 0.0, on: 0.01, off: -0.02 });
    let expected = thresholds::expected(&problem, prior_cost, &offsets);
    let along = Offsets { reference: 0.0, on: 0.2 + offsets.on, off: 0.21 + offsets.off };
    let by_scale = 2.0 * prior_cost - thresholds::pulled(&expected, &along, &problem.noise);
    assert!(by_scale.abs() < 1e-12, "{by_scale}");
    // Exact thresholds expect nothing.
    assert_eq!(thresholds::expected(&MapProblem { noise: Noise::default(), ..problem }, prior_cost, &offsets), Offsets::default());
}

#[test]
fn a_doubted_event_resets_the_pixel_and_moves_no_light() {
    // A pixel at rest, two frames of 100, and an ON event of noise between them.
    let frame = |start_ns: i64| MapFrame { start_ns, end_ns: start_ns + 5_000_000, dn: 425.0, sigma_dn: 1.0, saturated: false };
    let frames = [frame(0), frame(20_000_000)];
    let events = [MapEvent { is_lone: true, ..event(12_000_000, 1) }];
    let largest = |reset: Reset, lone: LoneEvents| {
        let noise = Noise { event: 0.05, lone, ..Noise::default() };
        let problem = MapProblem {
            events: &events,
            frames: &frames,
            hints: &[],
            start_ns: 0,
            end_ns: 25_000_000,
            sensor: sensor(reset),
            noise,
            stamp_sigma_s: 0.0,
            no_event_sigma: 0.0,
            lost_before: &[],
            beyond: &[],
        };
        let mut workspace = MapWorkspace::default();
        let solution = solve(&problem, &MapOptions::default(), &mut workspace);
        solution.log_photocurrent.iter().fold(0.0, |most, u| f64::max(most, (u - libm::log(100.0)).abs()))
    };
    for reset in [Reset::Resample, Reset::Advance] {
        let (trusted, doubted) = (largest(reset, LoneEvents::Trusted), largest(reset, LoneEvents::Doubted));
        assert!(trusted > 0.04 && doubted < 1e-6, "{reset:?}: {trusted} and {doubted}");
    }
}

#[test]
fn lone_events_are_doubted_where_they_mislead_about_frames() {
    // Light at rest, and noise: one event inside each frame that is held out.
    let frames: Vec<MapFrame> =
        (0..12).map(|l| MapFrame { start_ns: l * 8_000_000, end_ns: l * 8_000_000 + 6_000_000, dn: 510.0, sigma_dn: 3.0, saturated: false }).collect();
    let noise_events: Vec<MapEvent> =
        [1, 4, 7].into_iter().map(|l| MapEvent { is_lone: true, ..event(l * 8_000_000 + 2_000_000, if l == 4 { -1 } else { 1 }) }).collect();
    let problem = MapProblem {
        events: &noise_events,
        frames: &frames,
        hints: &[],
        start_ns: 0,
        end_ns: 95_000_000,
        sensor: sensor(Reset::Resample),
        noise: Noise::default(),
        stamp_sigma_s: 0.0,
        no_event_sigma: 0.0,
        lost_before: &[],
        beyond: &[],
    };
    let choice = estimate::choose(&[problem; 14], None, &Choosing::USUAL, &few_steps(), &mut MapGroup::default());
    assert_eq!(choice.noise.lone, LoneEvents::Doubted);
}

#[test]
fn thresholds_of_their_own_are_found_where_pixels_differ() {
    // Stated thresholds too small in one pixel, too large in the other.
    let recorded = recorded(Reset::Resample);
    let right = recorded.problem(Reset::Resample);
    let stated = |factor: f64| MapProblem { sensor: MapSensor { threshold_on: 0.2 * factor, threshold_off: 0.21 * factor, ..right.sensor }, ..right };
    let mut workspace = MapWorkspace::default();
    let problems = [stated(0.85), stated(1.15)];
    let chosen = estimate::choose(&problems, None, &Choosing::USUAL, &few_steps(), &mut MapGroup::default()).noise;
    let mut error = |noise: Noise| {
        let of = |problem: &MapProblem<'_>| {
            let solution = solve(&MapProblem { noise, ..*problem }, &few_steps(), &mut workspace);
            recorded.error(solution.t_ns, solution.log_photocurrent)
        };
        problems.iter().map(of).sum::<f64>()
    };
    let exact = estimate::EVENT_NOISES.iter().map(|&event| error(Noise { event, threshold: 0.0, ..chosen })).fold(f64::INFINITY, f64::min);
    assert!(chosen.threshold > 0.0 && error(chosen) < 0.9 * exact, "{chosen:?}: {} against {exact}", error(chosen));
}

#[test]
fn lost_events_are_found_where_frames_contradict_the_gap_and_nowhere_else() {
    for reset in [Reset::Resample, Reset::Advance] {
        let whole = recorded(reset);
        // One edge goes unseen: light falls by 1.4 while the pixel is silent, and rises again after it.
        let kept = whole.events.iter().copied().filter(|event| !(10_000_000..17_500_000).contains(&event.t_in_ns)).collect();
        let holed = Recorded { light: whole.light.clone(), frames: whole.frames.clone(), events: kept };
        let after = holed.events.partition_point(|event| event.t_in_ns < 17_500_000) as u32;
        assert!(holed.events.len() + 3 < whole.events.len());
        let options = MapOptions { max_iterations: 8, ..MapOptions::default() };
        let mut group = MapGroup::default();
        let tasks = [&whole, &holed, &whole].map(|recorded| MapTask { problem: MapProblem { no_event_sigma: 0.03, ..recorded.problem(reset) }, options });
        let mut plain = [losses::Plain::default(); 3];
        group.solve(&tasks, |n, solution| plain[n] = losses::Plain::of(&solution));
        let lost = losses::lost_before(&tasks, &plain, &mut group);
        assert_eq!(lost, [vec![], vec![after], vec![]], "{reset:?}");
        // Behind the stretch, light is as if nothing had happened.
        let mut workspace = MapWorkspace::default();
        let mut error = |task: &MapTask<'_>, lost_before: &[u32]| {
            let solution = solve(&MapProblem { lost_before, ..task.problem }, &task.options, &mut workspace);
            whole.error_from(24_000_000, solution.t_ns, solution.log_photocurrent)
        };
        let (before, trusted, doubted) = (error(&tasks[0], &[]), error(&tasks[1], &[]), error(&tasks[1], &lost[1]));
        assert!(trusted > 3.0 * before && doubted < 1.5 * before, "{reset:?}: {before} whole, {trusted} trusted, {doubted} doubted");
    }
}

#[test]
fn a_step_that_is_known_to_be_more_is_a_higher_threshold() {
    let events = [event(2_100_000, 1), event(2_900_000, 1), event(5_000_000, -1), event(7_080_500, -1), event(9_000_000, 1)];
    let frames = [MapFrame { start_ns: 500_000, end_ns: 3_500_000, dn: 250.0, sigma_dn: 2.0, saturated: false }];
    for reset in [Reset::Resample, Reset::Advance] {
        let own = sensor(reset);
        let problem = MapProblem {
            events: &events,
            frames: &frames,
            hints: &[],
            start_ns: 0,
            end_ns: 10_000_000,
            sensor: own,
            // One variance for both: it goes with the threshold.
            noise: Noise { event: 1e-3, ..Noise::default() },
            stamp_sigma_s: 0.0,
            no_event_sigma: 0.0,
            lost_before: &[],
            beyond: &[],
        };
        let options = MapOptions { max_iterations: 30, ..MapOptions::default() };
        let light = |problem: MapProblem<'_>| {
            let (mut group, mut light) = (MapGroup::default(), Vec::new());
            group.solve(&[MapTask { problem, options }], |_, solution| light = solution.log_photocurrent.to_vec());
            light
        };
        let more: Vec<f64> = events.iter().map(|event| 0.05 * f64::from(event.polarity)).collect();
        let stated = light(MapProblem { beyond: &more, ..problem });
        let raised =
            light(MapProblem { sensor: MapSensor { threshold_on: own.threshold_on + 0.05, threshold_off: own.threshold_off + 0.05, ..own }, ..problem });
        let plain = light(problem);
        let off = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off(&stated, &raised) < 2e-3 && off(&stated, &plain) > 0.03, "{} {}", off(&stated, &raised), off(&stated, &plain));
    }
}
