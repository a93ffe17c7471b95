//! Rows against numerical derivatives, scores against the whole problem, light and noise against the truth.

use super::path::{JacobianRows, PixelPath};
use super::*;
use crate::free::{PredictedEvent, frame_noise};
use crate::testing::{self, predicted};
use nalgebra::{DMatrix, DVector};
use photocurrent_core::Extent;
use photocurrent_sensor::conditional::Track;
use photocurrent_sensor::front_end::FrontEnd;

const STEP_NS: i64 = 100_000;

fn splines() -> TimeSplines {
    TimeSplines::new(0, STEP_NS, 301, 10)
}

/// Coefficients of light that rises and falls.
fn coefficients(splines: &TimeSplines) -> Vec<f64> {
    (0..splines.coefficients()).map(|k| 4.0 + 0.5 * libm::sin(0.7 * k as f64)).collect()
}

/// The voltage at an instant by small Euler steps, log light straight between the instants.
fn voltage(log: &[f64], low_pass: FrontEnd, t_ns: i64) -> f64 {
    let (mut v, fine_ns) = (log[0], 200.0);
    let at = |t: f64| {
        let place = (t / STEP_NS as f64).min(log.len() as f64 - 1.001);
        let k = place as usize;
        log[k] + (log[k + 1] - log[k]) * (place - k as f64)
    };
    let mut t = 0.0;
    while t + fine_ns <= t_ns as f64 {
        let u = at(t + 0.5 * fine_ns);
        v += (u - v) * fine_ns * 1e-9 / (low_pass.tau_0_s + low_pass.alpha_s * libm::exp(-u));
        t += fine_ns;
    }
    v
}

#[test]
fn a_voltages_row_times_the_coefficients_is_the_voltage() {
    let (splines, low_pass) = (splines(), FrontEnd { tau_0_s: 30e-6, alpha_s: 0.02 });
    let c = coefficients(&splines);
    let mut path = PixelPath::default();
    splines.values(&c, &mut path.log);
    path.set_log_light(&splines, low_pass);
    let mut rows = JacobianRows::default();
    let instants = [[12_345_600, 9_876_600], [20_000_000, 2_000_000], [29_999_000, 29_912_000]];
    instants.iter().for_each(|pair| path.push_difference(&splines, *pair, &mut rows));
    for (r, [t, before]) in instants.into_iter().enumerate() {
        let expected = voltage(&path.log, low_pass, t) - voltage(&path.log, low_pass, before);
        let (from, row) = (rows.from[r], rows.row(r));
        let found: f64 = row.iter().zip(&c[from..]).map(|(v, c)| v * c).sum();
        // Steps of 0.2 us of a time constant of 0.3 ms, and of the middle of each instant's step.
        assert!((found - expected).abs() < 3e-4, "{found} is {expected}");
    }
}

#[test]
fn rows_are_numerical_derivatives() {
    let splines = splines();
    let c = coefficients(&splines);
    // Where the time constant does not depend on the light nothing is held.
    let low_pass = FrontEnd { tau_0_s: 400e-6, alpha_s: 0.0 };
    let event = [17_654_300, 11_111_100];
    let exposure = [3_210_000, 9_876_000];
    let both = |c: &[f64]| {
        let mut log = Vec::new();
        splines.values(c, &mut log);
        let instants: Vec<i64> = (0..splines.instants as i64).map(|k| k * STEP_NS).collect();
        let track = Track::new(&instants, &log, STEP_NS);
        let exposure = photocurrent_core::Exposure::new(exposure[0], exposure[1]);
        (
            voltage(&log, low_pass, event[0]) - voltage(&log, low_pass, event[1]),
            1000.0 * track.collected_in(exposure),
        )
    };
    let mut path = PixelPath::default();
    splines.values(&c, &mut path.log);
    path.set_log_light(&splines, low_pass);
    let mut rows = JacobianRows::default();
    path.push_difference(&splines, event, &mut rows);
    path.push_exposure(&splines, exposure, 1000.0, &mut rows);
    for k in 0..c.len() {
        let at = |r: usize| {
            let row = rows.row(r);
            k.checked_sub(rows.from[r]).and_then(|k| row.get(k)).copied().unwrap_or(0.0)
        };
        let moved = |by: f64| {
            let mut moved = c.clone();
            moved[k] += by;
            both(&moved)
        };
        let (up, down) = (moved(1e-4), moved(-1e-4));
        let (event, frame) = ((up.0 - down.0) / 2e-4, (up.1 - down.1) / 2e-4);
        assert!((at(0) - event).abs() < 1e-3, "event by {k}: {} is {event}", at(0));
        // Light between instants is log-linear, and taken as linear here.
        assert!((at(1) - frame).abs() < 2e-3 * 500.0, "frame by {k}: {} is {frame}", at(1));
    }
}

#[test]
fn light_is_estimated_from_frames_and_events_together() {
    let case = testing::texture(Extent { width: 10, height: 8 }, 6);
    let mut nominal = case.nominal().unwrap();
    // The recording is of an ideal front end, compared every 0.1 ms: thresholds are passed by up to a step.
    nominal.pixel.front_end = FrontEnd::IDEAL;
    let block = Block { x: 1, y: 1, width: 8, height: 6 };
    let mut light = PixelLight::new(&case, &nominal, vec![block], (STEP_NS, 10), SceneNoise::new((0.0, 0.0)));
    let off = |light: &PixelLight| {
        let found = light.light(&case);
        let (mut sum, mut count) = (0.0, 0.0);
        for &pixel in light.pixels() {
            let (x, y) = case.pixel_place(pixel as usize);
            for t_ns in (8_000_000..40_000_000).step_by(1_000_000) {
                let truth = testing::log_light(x.into(), y.into(), t_ns);
                sum += (found.at(pixel as usize, t_ns).unwrap() - truth).abs();
                count += 1.0;
            }
        }
        sum / count
    };
    let begin = off(&light);
    for _ in 0..9 {
        let now = predicted(&case, &nominal, light.pixels(), &light.light(&case));
        light.newton_and_noise(&now);
    }
    let end = off(&light);
    // Thresholds of 0.2 are passed by up to a step's rise, some 0.003 at 60 pixels a second:
    // half of it is left.
    assert!(end < 0.002 && end < 0.5 * begin, "{begin} to {end}");
}

/// The light of one pixel after some rounds, what is predicted on it, and what two effects change a little.
fn one_pixel() -> (PixelLight, Vec<PixelPrediction>, Vec<f32>) {
    let case = testing::texture(Extent { width: 6, height: 5 }, 6);
    let mut nominal = case.nominal().unwrap();
    nominal.pixel.front_end = FrontEnd { tau_0_s: 200e-6, alpha_s: 0.0 };
    let block = Block { x: 2, y: 2, width: 1, height: 1 };
    let mut light = PixelLight::new(&case, &nominal, vec![block], (STEP_NS, 10), SceneNoise::new((4.0, 0.1)));
    for _ in 0..4 {
        let now = predicted(&case, &nominal, light.pixels(), &light.light(&case));
        light.newton_and_noise(&now);
    }
    let now = predicted(&case, &nominal, light.pixels(), &light.light(&case));
    let (frames, events, quiet) = (now[0].frames.len(), now[0].events.len(), now[0].quiet.len());
    assert!(frames == 6 && events > 3 && quiet == events);
    let columns = (0..2 * (frames + 2 * events + quiet)).map(|k| libm::sin(1.0 + 2.3 * k as f64) as f32);
    (light, now, columns.collect())
}

/// Derivatives of a measurement, its weight and its residual.
type DenseRow = (DVector<f64>, f64, f64);

/// All measurements of a pixel as dense rows with weights and residuals, and with the prior the normal matrix
/// and the gradient of its light.
fn dense(light: &PixelLight, now: &PixelPrediction) -> (Vec<DenseRow>, DMatrix<f64>, DVector<f64>) {
    let count = light.splines.coefficients();
    let whole = |(from, row, weight, residual): (usize, Vec<f64>, f64, f64)| {
        let mut whole = DVector::zeros(count);
        row.iter().enumerate().for_each(|(k, v)| whole[from + k] = *v);
        (whole, weight, residual)
    };
    let rows: Vec<_> = PixelWork::default().rows(&light.pixel_view(0, now)).into_iter().map(whole).collect();
    let second = |k: usize| {
        let mut second = DVector::zeros(count);
        (second[k], second[k + 1], second[k + 2]) = (1.0, -2.0, 1.0);
        let value = second.dot(&DVector::from_column_slice(&light.coefficients));
        (second, 1.0 / light.variance[k], value)
    };
    let (mut normal, mut gradient) = (1e-6 * DMatrix::identity(count, count), DVector::zeros(count));
    for (row, weight, residual) in rows.iter().cloned().chain((0..count - 2).map(second)) {
        normal += weight * &row * row.transpose();
        gradient += weight * residual * row;
    }
    (rows, normal, gradient)
}

#[test]
fn a_score_is_that_of_the_whole_problem_with_the_light_solved_for() {
    let (light, now, columns) = one_pixel();
    let found = light.score(&now, std::slice::from_ref(&columns), 2).pop().unwrap().unwrap();

    // All rows in one dense matrix: those of the measurements, of the prior, and the effects' columns next
    // to the light's.
    let (rows, light_alone, of_light) = dense(&light, &now[0]);
    let count = light.splines.coefficients();
    let mut normal = light_alone.resize(count + 2, count + 2, 0.0);
    let mut gradient = of_light.resize_vertically(count + 2, 0.0);
    for (r, (row, weight, residual)) in rows.iter().enumerate() {
        let of_effects = DVector::from_fn(2, |k, _| f64::from(columns[2 * r + k]));
        let mut both = normal.view_mut((count, 0), (2, count));
        both += *weight * &of_effects * row.transpose();
        let mut own = normal.view_mut((count, count), (2, 2));
        own += *weight * &of_effects * of_effects.transpose();
        let mut of_effect = gradient.rows_mut(count, 2);
        of_effect += *weight * *residual * of_effects;
    }
    let below = normal.view((count, 0), (2, count)).transpose();
    normal.view_mut((0, count), (count, 2)).copy_from(&below);
    let scale = normal[(count, count)];
    // A block of the inverse is the inverse of the Schur complement, which is the information.
    let inverse = normal.clone().try_inverse().unwrap();
    let information = inverse.view((count, count), (2, 2)).into_owned().try_inverse().unwrap();
    let whole = normal.lu().solve(&gradient).unwrap();
    let score = &information * whole.rows(count, 2);
    for k in 0..2 {
        assert!((found.score[k] - score[k]).abs() < 1e-6 * scale.max(score[k].abs()), "{found:?} {score}");
        for other in 0..2 {
            let (a, b) = (found.information[2 * k + other], information[(k, other)]);
            assert!((a - b).abs() < 1e-6 * scale, "{a} is {b}");
        }
    }
}

#[test]
fn a_gain_is_that_of_the_measurements_when_the_light_follows_an_effect() {
    let (light, now, columns) = one_pixel();
    let sizes = [0.004, -0.002];
    let found = light.gains(&now, std::slice::from_ref(&columns), &sizes).pop().unwrap().unwrap();
    let (rows, normal, alone) = dense(&light, &now[0]);
    let change = |r: usize, k: usize| match k {
        2 => 0.0,
        _ => f64::from(columns[2 * r + k]) * sizes[k],
    };
    let gradient = |k: usize| {
        let of_effect = rows.iter().enumerate().map(|(r, (row, weight, _))| weight * change(r, k) * row);
        of_effect.fold(alone.clone(), |sum, one| sum + one)
    };
    let inverse = normal.try_inverse().unwrap();
    let (frames, events) = (now[0].frames.len(), now[0].events.len());
    let density = |k: usize| {
        let step = -&inverse * gradient(k);
        let moved = |r: usize| change(r, k) + rows[r].0.dot(&step);
        let fired = |e: usize| {
            let (event, (row, weight, _)) = (now[0].events[e], &rows[frames + e]);
            let leverage = weight * (&inverse * row).dot(row);
            let excess = event.excess + moved(frames + e);
            let rise_per_s = event.rise_per_s * libm::exp(moved(frames + events + e).clamp(-1.0, 1.0));
            light.noise.log_density_left_out(&PredictedEvent { excess, rise_per_s, ..event }, leverage)
        };
        let silent = |q: usize| {
            let quiet = now[0].quiet[q];
            let excess = quiet.excess + moved(frames + 2 * events + q);
            light.noise.quiet_term(&PredictedEvent { excess, ..quiet }).log_probability
        };
        (0..events).map(fired).sum::<f64>() + (0..now[0].quiet.len()).map(silent).sum::<f64>()
    };
    for (k, found) in found.iter().enumerate() {
        let expected = density(k) - density(2);
        assert!((found - expected).abs() < 1e-6 * expected.abs().max(1.0), "{found} is {expected}");
    }
}

#[test]
fn no_event_counts_as_the_probability_of_none() {
    let noise = SceneNoise::new((0.0, 0.0));
    let event = |z: f64, polarity: f64| {
        let blank = PredictedEvent { threshold: 0.2, polarity, ..PredictedEvent::default() };
        let deviation = noise.event_variance(&blank).sqrt();
        (PredictedEvent { excess: polarity * z * deviation, ..blank }, deviation)
    };
    // Tables of the normal distribution: log Phi(-z); beyond them the losses of one in a thousand.
    for (z, log_probability) in [(-3.0, -0.00135), (0.5, -1.17591), (1.0, -1.84102), (2.0, -3.78319)] {
        for polarity in [1.0, -1.0] {
            let (plain, deviation) = event(z, polarity);
            let found = noise.quiet_term(&plain);
            let with_losses = libm::log(0.999 * libm::exp(log_probability) + 0.001);
            assert!((found.log_probability - with_losses).abs() < 1e-4, "{z}: {}", found.log_probability);
            // Gradient and curvature of -log Phi(-z), by differences.
            let minus_log = |z: f64| -libm::log(0.5 * libm::erfc(z / 2.0_f64.sqrt()));
            let (up, down) = (minus_log(z + 1e-3), minus_log(z - 1e-3));
            let (first, second) = ((up - down) / 2e-3, (up + down - 2.0 * minus_log(z)) / 1e-6);
            assert!(
                (polarity * found.residual * found.weight * deviation - first).abs() < 1e-4 * (1.0 + first)
            );
            if z > -1.0 {
                assert!((found.weight * deviation * deviation - second).abs() < 1e-3, "{z}");
            }
        }
    }
    assert!(noise.quiet_term(&event(50.0, 1.0).0).log_probability > libm::log(0.9e-3));
    // Where the function of errors is nothing to rounding, its expansion goes on.
    let (near, far) = (noise.quiet_term(&event(7.99, 1.0).0), noise.quiet_term(&event(8.01, 1.0).0));
    // Of order 1 / z^2 in the curvature, which there is one.
    assert!((near.weight / far.weight - 1.0).abs() < 0.02);
    assert!((near.residual * near.weight / (far.residual * far.weight) - 1.0).abs() < 0.01);
}

#[test]
fn instants_far_beyond_a_threshold_make_an_event_that_is_missing_less_of_a_surprise() {
    // Three of ten at five standard deviations, the others where no event is due.
    let mut noise = SceneNoise::new((0.0, 0.0));
    let blank = PredictedEvent { threshold: 0.2, polarity: -1.0, ..PredictedEvent::default() };
    let at = |z: f64| PredictedEvent { excess: -z * noise.event_variance(&blank).sqrt(), ..blank };
    let (far, near) = (at(5.0), at(1.0));
    let quiet = (0..10).map(|n| if n < 3 { far } else { near }).collect();
    let predicted = [PixelPrediction { quiet, ..PixelPrediction::default() }];
    let before = noise.quiet_term(&far).log_probability;
    noise.estimate_of_quiet(&predicted);
    assert!((noise.missing - 0.3).abs() < 1e-12);
    assert!(before < -6.9 && (noise.quiet_term(&far).log_probability - libm::log(0.3)).abs() < 1e-5);
    // Phi(-1) by a table.
    let one = libm::log(0.3 + 0.7 * 0.158_655);
    assert!((noise.quiet_term(&near).log_probability - one).abs() < 1e-5);
    // None far, and no instant at all: a loss in a thousand.
    for quiet in [vec![near], Vec::new()] {
        noise.estimate_of_quiet(&[PixelPrediction { quiet, ..PixelPrediction::default() }]);
        assert!((noise.missing - 1e-3).abs() < 1e-12);
    }
}

#[test]
fn events_are_no_more_probable_on_a_scene_of_less_contrast() {
    // Voltages and thresholds a tenth of what they are: times are as probable as before.
    let light = |by: f64| {
        let event = PredictedEvent {
            threshold: 0.2 * by,
            excess: 0.003 * by,
            slope_per_s: 50.0 * by,
            rise_per_s: 40.0 * by,
            polarity: 1.0,
            ..PredictedEvent::default()
        };
        SceneNoise::new((0.0, 0.0)).log_density_left_out(&event, 0.3)
    };
    assert!((light(1.0) - light(0.1)).abs() < 1e-12);
}

#[test]
fn noise_of_frames_is_found_on_a_texture_that_moves() {
    let case = testing::texture(Extent { width: 48, height: 40 }, 8);
    let nominal = case.nominal().unwrap();
    let noise_at = |signal: f64, (dark, shot): (f64, f64)| dark + shot * signal;
    let clean = frame_noise(&case, &nominal);
    // Signals are some 220 DN, and second differences of its waves some hundredths of that.
    assert!(noise_at(220.0, clean) < 6.0, "{clean:?}");
    let mut random = photocurrent_core::random::Random::new(5, &[]);
    let frames = case.frames.as_ref().unwrap().map(|_, dn| {
        let variance = 4.0 + f64::from(dn) / 5.0;
        (f64::from(dn) + variance.sqrt() * random.normal()) as f32
    });
    let noisy = Case { frames: Some(frames), ..case };
    let found = frame_noise(&noisy, &nominal);
    let (found, truth) = (noise_at(220.0, found), noise_at(220.0, (4.0, 0.2)));
    // Of each level the smallest of three estimates counts, each good to some 5 %.
    assert!((found / truth - 1.0).abs() < 0.2, "{found} is {truth}");
}
