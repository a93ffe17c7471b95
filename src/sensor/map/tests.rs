//! Claims about the solver: light that was simulated by the forward model comes back.

use super::knots::Knots;
use super::problem::has_run_away;
use super::start::Start;
use super::*;
use crate::effects::Site;
use crate::forward::{Chain as Pixels, LOG_STEP, LinearLight, Noiseless, Pixel, simulate};
use crate::front_end::FrontEnd;
use crate::misfit::Misfit;
use photocurrent_core::Exposure;
use photocurrent_core::sensor::Reset;

pub(super) const FRONT_END: FrontEnd = FrontEnd { tau_0_s: 20e-6, alpha_s: 12e-3 };

pub(super) fn sensor(reset: Reset) -> MapSensor {
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

pub(super) fn event(t_in_ns: i64, polarity: i8) -> PixelEvent {
    PixelEvent { t_in_ns, t_off_ns: t_in_ns + 30_000, polarity }
}

/// A pixel that sees an edge pass, as the forward model records it.
pub(super) struct Recorded {
    pub light: (Vec<i64>, Vec<f64>),
    pub events: Vec<PixelEvent>,
    pub frames: Vec<MapFrame>,
}

const END_NS: i64 = 40_000_000;

/// As many steps as are taken where many pixels are solved: noise and prior are chosen for these.
pub(super) fn few_steps() -> MapOptions {
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
    let fired = simulate(
        &Pixels { pixel, reset, effects: &[], tolerance: crate::forward::TOLERANCE },
        &site,
        &light,
        0,
        END_NS,
        &mut Noiseless,
    );
    let events = fired.iter().map(|fired| fired.event).collect();
    let frames = (0..5).map(|l| {
        let (start_ns, end_ns) = (l * 8_000_000, l * 8_000_000 + 6_000_000);
        MapFrame {
            start_ns,
            end_ns,
            dn: 850.0 * light.integral(Exposure::new(start_ns, end_ns)),
            sigma_dn: 1.5,
            saturated: false,
        }
    });
    Recorded { frames: frames.collect(), events, light: (t_ns, current) }
}

impl Recorded {
    pub(super) fn problem(&self, reset: Reset) -> MapProblem<'_> {
        let sensor =
            MapSensor { refractory_ns: if reset == Reset::Resample { 50_000 } else { 0 }, ..sensor(reset) };
        let noise = Noise { event: 0.02, ..Noise::default() };
        MapProblem { noise, ..MapProblem::new(sensor, &self.events, &self.frames, (0, END_NS)) }
    }

    /// The rms error of log light over the recording, of knots joined by lines.
    pub(super) fn error(&self, t_ns: &[i64], u: &[f64]) -> f64 {
        self.error_from(0, t_ns, u)
    }

    /// The same from an instant on.
    pub(super) fn error_from(&self, from_ns: i64, t_ns: &[i64], u: &[f64]) -> f64 {
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
    let levels = [Reset::Resample, Reset::Advance]
        .into_iter()
        .flat_map(|reset| [1.0, 4.0, 7.0].map(|darkest| (reset, darkest)));
    for ((reset, darkest), rise_ns) in
        levels.flat_map(|level| [5_000_000, 20_000_000, 36_000_000].map(|rise_ns| (level, rise_ns)))
    {
        // 1.15 natural-log units are five thresholds of 0.2 and what is missed during four readouts.
        let recorded = recorded_of(reset, |t_ns| {
            darkest + 1.15 * ((t_ns - 2_000_000) as f64 / rise_ns as f64).clamp(0.0, 1.0)
        });
        assert_eq!(recorded.events.iter().map(|event| event.polarity).collect::<Vec<_>>(), [1; 5]);
        let frames = [recorded.frames[0], recorded.frames[4]];
        let problem = MapProblem { frames: &frames, noise: Noise::default(), ..recorded.problem(reset) };
        let mut group = MapGroup::default();
        let solution = solve(&problem, &MapOptions::default(), &mut group);
        let (status, iterations) = (solution.outcome.status, solution.outcome.iterations);
        assert_eq!(
            status,
            MapStatus::Converged,
            "{reset:?}, from {darkest} in {rise_ns} ns: {iterations} steps"
        );
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
        let mut group = MapGroup::default();
        let problem = recorded.problem(reset);
        let solution = solve(&problem, &MapOptions::default(), &mut group);
        let error = recorded.error(solution.t_ns, solution.log_photocurrent);
        // Thresholds are 0.2: a fifth of one is what knots 250 us apart and a time constant held over them
        // leave.
        assert!(error < 0.04, "{reset:?}: {error}");
        // The start is the double integral: the solver must be several times better, or it is not worth its
        // time.
        let mut start = Vec::new();
        let mut knots = Knots::default();
        knots.lay(&problem, MapOptions::default().spacing_ns);
        Start::default().fill(&problem, &knots, &mut start);
        assert!(recorded.error(&knots.t_ns, &start) > 3.0 * error, "{reset:?}");
    }
}

/// Light of 298 DN an exposure and 17, as a spoke of a star passes: at 17 DN the front end takes 4 ms.
pub(super) fn spokes() -> Recorded {
    recorded_of(Reset::Resample, |t_ns: i64| {
        let phase = (t_ns as f64 * 1e-6) % 13.0;
        let bright = f64::max(1.0 - f64::max((5.0 - phase).abs() - 2.5, 0.0), 0.0);
        libm::log(3.3 + 55.2 * bright)
    })
}

#[test]
fn light_that_falls_at_once_into_the_dark_is_found_from_a_second_start() {
    let recorded = spokes();
    let problem = MapProblem { no_event_sigma: 0.03, ..recorded.problem(Reset::Resample) };
    let error = |second| {
        let mut group = MapGroup::default();
        let solution = solve(&problem, &MapOptions { second, ..MapOptions::default() }, &mut group);
        recorded.error(solution.t_ns, solution.log_photocurrent)
    };
    let (once, twice) = (error(None), error(Some(SecondStart::USUAL)));
    // 0.43 and 0.28 natural-log units.
    assert!(twice < 0.75 * once, "{once} and {twice}");
    // Of one misfit in all: nothing is tried where frames have it, and not events.
    let measured = (problem.events.len() + problem.frames.len()) as f64;
    let is_tried = |event_square: f64| {
        SecondStart::USUAL.is_worth_a_try(
            &problem,
            MapStatus::Converged,
            measured,
            &Misfit { event_square, events: 10, ..Misfit::default() },
        )
    };
    assert!(is_tried(1.1) && !is_tried(0.9));
    // With a front end that is as slow in the light there is one answer, and nothing is tried.
    let even = MapProblem {
        sensor: MapSensor { front_end: FrontEnd { tau_0_s: 100e-6, alpha_s: 0.0 }, ..problem.sensor },
        ..problem
    };
    assert!(!SecondStart::USUAL.is_worth_a_try(&even, MapStatus::Failed, 1e9, &Misfit::default()));
}

#[test]
fn a_pixel_without_events_is_as_bright_as_its_frames() {
    let frame = |start_ns: i64| MapFrame {
        start_ns,
        end_ns: start_ns + 5_000_000,
        dn: 425.0,
        sigma_dn: 1.0,
        saturated: false,
    };
    let frames = [frame(0), frame(8_000_000)];
    let problem = MapProblem::new(sensor(Reset::Resample), &[], &frames, (-1_000_000, 20_000_000));
    let mut group = MapGroup::default();
    let solution = solve(&problem, &MapOptions::default(), &mut group);
    assert_eq!(solution.outcome.status, MapStatus::Converged);
    // 425 DN = 850 x 5 ms x 100.
    assert!(solution.log_photocurrent.iter().all(|u| (u - libm::log(100.0)).abs() < 1e-6));
}

#[test]
fn light_that_would_have_fired_is_pulled_back() {
    // Two frames that say 100 and 160, and not one event between them: the change is 0.47 where 0.2 would
    // have fired.
    let frame = |start_ns: i64, dn: f64| MapFrame {
        start_ns,
        end_ns: start_ns + 5_000_000,
        dn,
        sigma_dn: 20.0,
        saturated: false,
    };
    let frames = [frame(0, 425.0), frame(8_000_000, 680.0)];
    let change = |no_event_sigma: f64| {
        let sensor = sensor(Reset::Resample);
        let noise = Noise { reference: 0.001, ..Noise::default() };
        let problem =
            MapProblem { noise, no_event_sigma, ..MapProblem::new(sensor, &[], &frames, (0, 14_000_000)) };
        let mut group = MapGroup::default();
        let u = solve(&problem, &MapOptions { max_iterations: 8, ..MapOptions::default() }, &mut group)
            .log_photocurrent
            .to_vec();
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
    // The frame's mean is 100: six times as much may pass between two frames, a hundred times as much does
    // not.
    assert!(!has_run_away(&problem, &[libm::log(100.0), libm::log(600.0)]));
    assert!(has_run_away(&problem, &[libm::log(100.0), libm::log(10_000.0)]));
    let saturated = [MapFrame { saturated: true, ..frames[0] }];
    assert!(!has_run_away(&MapProblem { frames: &saturated, ..problem }, &[libm::log(10_000.0)]));
}

#[test]
fn a_saturated_value_is_a_lower_bound_only() {
    let frame = |start_ns: i64, dn: f64, saturated| MapFrame {
        start_ns,
        end_ns: start_ns + 5_000_000,
        dn,
        sigma_dn: 1.0,
        saturated,
    };
    let problem = |frames| MapProblem::new(sensor(Reset::Resample), &[], frames, (0, 15_000_000));
    let mut group = MapGroup::default();
    // Brighter than the bound: the bound has no say.
    let above = [frame(0, 850.0, false), frame(8_000_000, 425.0, true)];
    let u = solve(&problem(&above), &MapOptions::default(), &mut group).log_photocurrent.to_vec();
    assert!((u[u.len() - 1] - libm::log(200.0)).abs() < 0.02, "{}", u[u.len() - 1]);
    // Darker: it pulls up.
    let below = [frame(0, 425.0, false), frame(8_000_000, 850.0, true)];
    let solution = solve(&problem(&below), &MapOptions::default(), &mut group);
    assert!(solution.log_photocurrent[solution.log_photocurrent.len() - 1] > libm::log(150.0));
}

#[test]
fn shifting_time_changes_nothing() {
    let recorded = recorded(Reset::Resample);
    let mut group = MapGroup::default();
    let here = solve(&recorded.problem(Reset::Resample), &MapOptions::default(), &mut group)
        .log_photocurrent
        .to_vec();
    let shift = 3_600_000_000_000;
    let events: Vec<PixelEvent> = recorded
        .events
        .iter()
        .map(|e| PixelEvent { t_in_ns: e.t_in_ns + shift, t_off_ns: e.t_off_ns + shift, ..*e })
        .collect();
    let frames: Vec<MapFrame> = recorded
        .frames
        .iter()
        .map(|f| MapFrame { start_ns: f.start_ns + shift, end_ns: f.end_ns + shift, ..*f })
        .collect();
    let later = MapProblem {
        events: &events,
        frames: &frames,
        hints: &[],
        start_ns: shift,
        end_ns: END_NS + shift,
        ..recorded.problem(Reset::Resample)
    };
    assert_eq!(solve(&later, &MapOptions::default(), &mut group).log_photocurrent, here);
}

/// Thresholds of the pixel that [`recorded`] simulates, as parts of those that the problem states.
fn found_thresholds(on: f64, off: f64) -> (f64, f64) {
    let recorded = recorded(Reset::Resample);
    let right = recorded.problem(Reset::Resample);
    let sensor = MapSensor { threshold_on: 0.2 / on, threshold_off: 0.21 / off, ..right.sensor };
    let noise = Noise { event: 0.08, threshold: 0.03, ..right.noise };
    let problem = MapProblem { sensor, noise, ..right };
    let mut group = MapGroup::default();
    let solution = solve(&problem, &MapOptions { max_iterations: 20, ..MapOptions::default() }, &mut group);
    (
        1.0 + solution.outcome.offsets.on / sensor.threshold_on,
        1.0 + solution.outcome.offsets.off / sensor.threshold_off,
    )
}

#[test]
fn thresholds_that_are_stated_wrong_are_found_from_the_frames() {
    for (on, off) in [(1.0, 1.0), (0.85, 0.85), (1.15, 1.15), (1.1, 0.95)] {
        let found = found_thresholds(on, off);
        // Stated to 15 %, so an error of 15 % is met about half-way. Thresholds that are right stay to a
        // third of that.
        assert!(
            (found.0 - on).abs() < 0.08 && (found.1 - off).abs() < 0.08,
            "{on} and {off}: found {found:?}"
        );
        assert!(
            on != 1.0 || ((found.0 - 1.0).abs() < 0.05 && (found.1 - 1.0).abs() < 0.05),
            "found {found:?}"
        );
    }
}

#[test]
fn what_is_expected_of_thresholds_makes_the_prior_blind_to_scale() {
    // Twice the light and twice the thresholds cost the prior 4 P less 2 P log(4) in its own units; to first
    // order around 1 nothing changes: d/ds [P s^2 - 2 sum(expected offset) / sigma^2] = 0 along offset = (s -
    // 1) threshold.
    let events = [event(1_000_000, 1), event(2_000_000, 1), event(3_000_000, -1)];
    let recorded = recorded(Reset::Resample);
    let problem = MapProblem {
        events: &events,
        noise: Noise { threshold: 0.02, ..Noise::default() },
        ..recorded.problem(Reset::Resample)
    };
    let (prior_cost, offsets) = (37.0, Offsets { reference: 0.0, on: 0.01, off: -0.02 });
    let expected = thresholds::expected(&problem, prior_cost, &offsets);
    let along = Offsets { reference: 0.0, on: 0.2 + offsets.on, off: 0.21 + offsets.off };
    let by_scale = 2.0 * prior_cost - thresholds::pulled(&expected, &along, &problem.noise);
    assert!(by_scale.abs() < 1e-12, "{by_scale}");
    // Exact thresholds expect nothing.
    assert_eq!(
        thresholds::expected(&MapProblem { noise: Noise::default(), ..problem }, prior_cost, &offsets),
        Offsets::default()
    );
}

#[test]
fn a_doubted_event_resets_the_pixel_and_moves_no_light() {
    // A pixel at rest, two frames of 100, and an ON event of noise between them.
    let frame = |start_ns: i64| MapFrame {
        start_ns,
        end_ns: start_ns + 5_000_000,
        dn: 425.0,
        sigma_dn: 1.0,
        saturated: false,
    };
    let frames = [frame(0), frame(20_000_000)];
    let events = [event(12_000_000, 1)];
    let largest = |reset: Reset, lone: LoneEvents| {
        let noise = Noise { event: 0.05, lone, ..Noise::default() };
        let problem = MapProblem {
            noise,
            is_lone: &[true],
            ..MapProblem::new(sensor(reset), &events, &frames, (0, 25_000_000))
        };
        let mut group = MapGroup::default();
        let solution = solve(&problem, &MapOptions::default(), &mut group);
        solution.log_photocurrent.iter().fold(0.0, |most, u| f64::max(most, (u - libm::log(100.0)).abs()))
    };
    for reset in [Reset::Resample, Reset::Advance] {
        let (trusted, doubted) = (largest(reset, LoneEvents::Trusted), largest(reset, LoneEvents::Doubted));
        assert!(trusted > 0.04 && doubted < 1e-6, "{reset:?}: {trusted} and {doubted}");
    }
}

#[test]
fn a_step_that_is_known_to_be_more_is_a_higher_threshold() {
    let events = [
        event(2_100_000, 1),
        event(2_900_000, 1),
        event(5_000_000, -1),
        event(7_080_500, -1),
        event(9_000_000, 1),
    ];
    let frames =
        [MapFrame { start_ns: 500_000, end_ns: 3_500_000, dn: 250.0, sigma_dn: 2.0, saturated: false }];
    for reset in [Reset::Resample, Reset::Advance] {
        let own = sensor(reset);
        let problem = MapProblem {
            noise: Noise { event: 1e-3, ..Noise::default() },
            ..MapProblem::new(own, &events, &frames, (0, 10_000_000))
        };
        let options = MapOptions { max_iterations: 30, ..MapOptions::default() };
        let light = |problem: MapProblem<'_>| {
            let (mut group, mut light) = (MapGroup::default(), Vec::new());
            group.solve(&[MapTask { problem, options }], |_, solution| {
                light = solution.log_photocurrent.to_vec()
            });
            light
        };
        let more: Vec<f64> = events.iter().map(|event| 0.05 * f64::from(event.polarity)).collect();
        let stated = light(MapProblem { beyond: &more, ..problem });
        let raised = light(MapProblem {
            sensor: MapSensor {
                threshold_on: own.threshold_on + 0.05,
                threshold_off: own.threshold_off + 0.05,
                ..own
            },
            ..problem
        });
        let plain = light(problem);
        let off = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(
            off(&stated, &raised) < 2e-3 && off(&stated, &plain) > 0.03,
            "{} {}",
            off(&stated, &raised),
            off(&stated, &plain)
        );
    }
}
