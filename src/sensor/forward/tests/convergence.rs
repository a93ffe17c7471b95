//! How errors shrink with the step, and that event times keep no trace of the sampling of the light.

use super::super::*;
use crate::effects::simulated::{MS, Samples, ideal_pixel, recorded};
use crate::effects::{Effect, FrontEndModel, Site};
use crate::front_end::FrontEnd;
use photocurrent_core::random::Random;

/// Root mean square of the differences of times, nanoseconds.
fn apart(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    libm::sqrt(a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / a.len() as f64)
}

#[test]
fn halving_the_step_divides_the_error_by_thirty_two() {
    // Coarse samples, so that ln i is really curved inside a piece, and a time constant that moves with it.
    let t_ns: Vec<i64> = (0..12).map(|n| n * 5_000_000).collect();
    let photocurrent = t_ns.iter().map(|&t| 0.5 + 0.4 * libm::sin(t as f64 * 3e-7)).collect();
    let light = Samples { t_ns, photocurrent };
    let pixel = Pixel {
        front_end: FrontEnd { tau_0_s: 30e-6, alpha_s: 400e-6 },
        threshold_on: 0.05,
        threshold_off: 0.05,
        ..ideal_pixel()
    };
    let times = |log_step| {
        let events =
            simulate_events(&Pixel { log_step, ..pixel }, &light.light(), 0, 55 * MS, &mut Noiseless);
        events.iter().map(|event| event.t_in_ns as f64).collect::<Vec<f64>>()
    };
    let exact = times(0.005);
    let errors = [0.8, 0.4, 0.2].map(|log_step| apart(&times(log_step), &exact));
    assert!(errors[2] > 1.5, "above the nanosecond of the stamps: {errors:?}");
    for pair in errors.windows(2) {
        assert!(pair[0] / pair[1] > 18.0 && pair[0] / pair[1] < 60.0, "{errors:?}");
    }
    assert!(apart(&times(LOG_STEP), &exact) < 1.0, "the usual step");
}

#[test]
fn finer_samples_of_the_same_motion_move_events_with_the_square_of_their_spacing() {
    // What a scene or a video gives: smooth light, sampled at a frame rate, linear between.
    let pixel = Pixel { front_end: FrontEnd { tau_0_s: 30e-6, alpha_s: 100e-6 }, ..ideal_pixel() };
    let times = |spacing_ns: i64| {
        let t_ns: Vec<i64> = (0..=60 * MS / spacing_ns).map(|n| n * spacing_ns).collect();
        let photocurrent = t_ns
            .iter()
            .map(|&t| libm::exp(libm::sin(t as f64 * 4e-7) + 0.4 * libm::sin(t as f64 * 1.1e-6)))
            .collect();
        let light = Samples { t_ns, photocurrent };
        simulate_events(&pixel, &light.light(), 0, 58 * MS, &mut Noiseless)
            .iter()
            .map(|event| event.t_in_ns as f64)
            .collect::<Vec<f64>>()
    };
    let exact = times(5_000);
    let errors = [400_000, 200_000, 100_000].map(|spacing_ns| apart(&times(spacing_ns), &exact));
    for pair in errors.windows(2) {
        assert!(pair[0] / pair[1] > 3.3 && pair[0] / pair[1] < 5.0, "{errors:?}");
    }
    // 10,000 frames per second resolve this motion to some microseconds, and then the rate no longer matters.
    assert!(errors[2] < 8_000.0 && apart(&times(10_000), &exact) < 100.0, "{errors:?}");
}

#[test]
fn event_times_do_not_clump_on_the_samples_of_the_light() {
    let mut counts = [0.0; 20];
    let period_ns = 100_000;
    for seed in 0..40 {
        let mut random = Random::new(seed, &[]);
        let (phase, omega) = (6.0 * random.uniform(), 300.0 + 400.0 * random.uniform());
        let t_ns: Vec<i64> = (0..=500).map(|n| n * period_ns).collect();
        let photocurrent =
            t_ns.iter().map(|&t| libm::exp(libm::sin(phase + omega * t as f64 / 1e9))).collect();
        let light = Samples { t_ns, photocurrent };
        let pixel = Pixel {
            front_end: FrontEnd { tau_0_s: 20e-6, alpha_s: 30e-6 },
            threshold_on: 0.05,
            threshold_off: 0.06,
            ..ideal_pixel()
        };
        for event in simulate_events(&pixel, &light.light(), 0, 50 * MS, &mut Noiseless) {
            counts[(event.t_in_ns % period_ns * 20 / period_ns) as usize] += 1.0;
        }
    }
    let expected = counts.iter().sum::<f64>() / 20.0;
    assert!(expected > 200.0);
    let chi_square: f64 = counts.iter().map(|count| (count - expected) * (count - expected) / expected).sum();
    // 19 degrees of freedom: the 99.99 % point is 51.
    assert!(chi_square < 51.0, "{counts:?}");
}

#[test]
fn a_sinusoid_through_a_low_pass_crosses_where_algebra_says() {
    let (depth, omega, tau_s) = (1.5, 250.0, 0.4e-3);
    let light = Samples::of_log(60 * MS, |t| depth * libm::sin(omega * t));
    let pixel = Pixel { front_end: FrontEnd { tau_0_s: tau_s, alpha_s: 0.0 }, ..ideal_pixel() };
    let events = simulate_events(&pixel, &light.light(), 0, 60 * MS, &mut Noiseless);
    let lag = omega * tau_s;
    let voltage = |t: f64| {
        depth / (1.0 + lag * lag)
            * (libm::sin(omega * t) - lag * libm::cos(omega * t) + lag * libm::exp(-t / tau_s))
    };
    let rate = |t: f64| (depth * libm::sin(omega * t) - voltage(t)) / tau_s;
    // Each event lies on its rung of the ladder of thresholds.
    let mut rung = 0.0;
    for event in &events {
        rung += 0.2 * f64::from(event.polarity);
        let t = event.t_in_ns as f64 / 1e9;
        assert!(((voltage(t) - rung) / rate(t)).abs() < 1e-6, "an event at {t} s");
    }
    // And none is missing: the same ladder climbed on a grid of 1 us.
    let (mut rung, mut count) = (0.0, 0);
    for t in (0..60_000).map(|n| f64::from(n) * 1e-6) {
        if (voltage(t) - rung).abs() >= 0.2 {
            rung += 0.2_f64.copysign(voltage(t) - rung);
            count += 1;
        }
    }
    assert_eq!(events.len(), count);
    assert!(count > 50);
}

/// Slew limits that nothing reaches: the same physics, by the other method.
struct Integrated;

impl Effect for Integrated {
    fn id(&self) -> &'static str {
        "integrated"
    }

    fn front_end(&self, _site: &Site, model: &mut FrontEndModel) {
        model.slew_up_per_s = 1e15;
    }
}

#[test]
fn the_integrator_finds_the_times_of_the_closed_form() {
    let light = Samples::of_log(60 * MS, |t| libm::sin(250.0 * t) + 0.5 * libm::sin(900.0 * t));
    for (tau_0_s, refractory_ns) in [(2e-3, 0), (50e-6, 80_000), (1e-6, 80_000)] {
        let pixel = Pixel { front_end: FrontEnd { tau_0_s, alpha_s: 0.0 }, refractory_ns, ..ideal_pixel() };
        let closed = recorded(pixel, vec![], &light, 60 * MS);
        let integrated = recorded(pixel, vec![Box::new(Integrated)], &light, 60 * MS);
        assert_eq!(closed.len(), integrated.len());
        assert!(closed.len() > 20);
        for (a, b) in closed.iter().zip(&integrated) {
            assert!((a.t_in_ns - b.t_in_ns).abs() < 100 && a.polarity == b.polarity, "{a:?} {b:?}");
        }
    }
}

#[test]
fn a_step_of_the_integrator_has_an_error_of_fourth_order() {
    use super::super::numeric::{System, TOLERANCE};
    let mut model = FrontEndModel::plain(FrontEnd { tau_0_s: 1e-4, alpha_s: 2e-4 });
    model.second_pole = Some(crate::effects::SecondPole { tau_s: 2e-4, tau_light_s: 1e-4 });
    model.high_pass_s = 1e-3;
    model.drive = crate::effects::Drive::LargeSignal;
    let system = System { model: &model, first: 1.0, slope_per_s: 3e3, tolerance: TOLERANCE };
    let start = [-0.8, -0.5, -0.2];
    let error = |h: f64| {
        let whole = system.step(0.0, &start, h).0;
        // The same interval in 64 parts stands for the exact solution.
        let parts = (0..64).fold(start, |state, n| system.step(f64::from(n) * h / 64.0, &state, h / 64.0).0);
        whole.iter().zip(parts).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    };
    let ratio = error(2e-5) / error(1e-5);
    assert!((ratio / 16.0 - 1.0).abs() < 0.25, "halving the step divides the error by 16: {ratio}");
}
