//! Rows against numerical derivatives, scores against the whole problem, and pictures under noise against the
//! truth.

use super::problem::{STEP_OF_MOTION, STEP_OF_SHADING};
use super::*;
use crate::picture::FitStart;
use crate::picture::motion::DEGREES;
use crate::testing::{self, predicted};
use nalgebra::{DMatrix, DVector};
use photocurrent_core::Extent;
use photocurrent_sensor::front_end::FrontEnd;

const STEP_NS: i64 = 50_000;

/// The texture seen by a sensor with a short constant lag, with noise of `electrons` a DN and `read` DN
/// in its frames.
fn noisy(extent: Extent, frames: usize, noise: (f64, f64)) -> (Case, Nominal) {
    with_noise(testing::texture(extent, frames), noise)
}

fn with_noise(mut case: Case, (electrons, read): (f64, f64)) -> (Case, Nominal) {
    let mut random = Random::new(8, &[]);
    let noise = |_: usize, dn: f32| {
        let variance = f64::from(dn) / electrons + read * read;
        (f64::from(dn) + libm::sqrt(variance) * random.normal()).round() as f32
    };
    case.frames = case.frames.map(|frames| frames.map(noise));
    let mut nominal = case.nominal().unwrap();
    nominal.pixel.front_end = FrontEnd::IDEAL;
    (case, nominal)
}

/// The whole array.
fn whole_array_part(case: &Case) -> ArrayPart {
    ArrayPart { block: Block::whole_array(case.extent), pitch: 0.8 }
}

fn joint_picture(case: &Case, nominal: &Nominal, noise: (f64, f64)) -> JointPicture {
    begin_on(case, nominal, noise, None)
}

/// On a part of the array; on all of it without one.
fn begin_on(case: &Case, nominal: &Nominal, noise: (f64, f64), part: Option<ArrayPart>) -> JointPicture {
    let setting = PictureSetting::default();
    let scene = MovingPicture::fit(case, nominal, &setting).unwrap();
    // Every fourth pixel is held out.
    let is_trained: Vec<bool> = (0..case.extent.pixels()).map(|pixel| pixel % 4 != 3).collect();
    let part = part.unwrap_or_else(|| whole_array_part(case));
    JointPicture::new(case, nominal, (&scene, &part), &is_trained, STEP_NS, SceneNoise::new(noise)).unwrap()
}

fn current_predictions(case: &Case, nominal: &Nominal, joint: &JointPicture) -> Vec<PixelPrediction> {
    predicted(case, nominal, joint.pixels(), &joint.light(case))
}

fn rounds(case: &Case, nominal: &Nominal, joint: &mut JointPicture, count: usize) {
    for _ in 0..count {
        let measured = current_predictions(case, nominal, joint);
        joint.newton_and_noise(&measured);
    }
}

#[test]
fn rows_are_what_a_small_step_of_everything_changes() {
    let (case, mut nominal) = noisy(Extent { width: 16, height: 12 }, 8, (1e9, 0.0));
    nominal.pixel.front_end = FrontEnd { tau_0_s: 300e-6, alpha_s: 0.0 };
    let joint = joint_picture(&case, &nominal, (1.0, 0.0));
    rows_are_what_a_small_step_changes(&case, &nominal, &joint);
    // The same picture, a quarter of whose light is that of a ground which it hides less than all of.
    let mut before_ground = joint.clone();
    let mut picture = joint.scene.picture.clone();
    let mut random = Random::new(5, &[]);
    picture.ground = (0..case.extent.pixels()).map(|_| (0.3 + 0.2 * random.uniform()) as f32).collect();
    picture.ground.iter_mut().for_each(|ground| *ground *= picture.unit as f32);
    let hidden: Vec<f32> =
        picture.surface.iter().map(|_| ((0.4 + 0.2 * random.uniform()) * picture.unit) as f32).collect();
    picture.surface.extend(hidden);
    before_ground.scene = Arc::new(MovingPicture::new(picture, &joint.scene.setting, &case, &nominal));
    let fields = before_ground.current().fields();
    let unknowns = before_ground.current().unknowns();
    before_ground.prior = DifferencePrior::estimate(&fields, &unknowns[..fields.coefficients()], None);
    rows_are_what_a_small_step_changes(&case, &nominal, &before_ground);
}

fn rows_are_what_a_small_step_changes(case: &Case, nominal: &Nominal, joint: &JointPicture) {
    let before = current_predictions(case, nominal, joint);
    let problem = joint.current().problem(&before);
    let count = joint.current().coefficients();
    let mut random = Random::new(3, &[]);
    let knots = joint.picture().motion.knots.len() * DEGREES;
    // A step of the picture, of the motion, of the shading.
    for kind in 0..3 {
        let size = |n: usize| match n.checked_sub(count) {
            None if kind == 0 => 0.01 * 55.0,
            Some(rest) if kind == 1 && rest < knots => 0.004,
            Some(rest) if kind == 2 && rest >= knots => 0.002,
            _ => 0.0,
        };
        let step: Vec<f64> =
            (0..joint.current().unknowns().len()).map(|n| size(n) * random.normal()).collect();
        let moved = |share: f64| {
            let mut moved = joint.clone();
            moved.apply_step(&joint.scene.clone(), &step, share);
            current_predictions(case, nominal, &moved)
        };
        let (more, less) = (moved(0.5), moved(-0.5));
        let (mut off, mut size) = ([0.0; 3], [0.0; 3]);
        for r in problem.used() {
            let (pixel, n) = (problem.place[r] as usize, problem.number[r] as usize);
            let of_events = problem.event_rows();
            let row = usize::from(r >= of_events.start) + usize::from(r >= of_events.end);
            let log_rise = |of: &[PixelPrediction]| libm::log(of[pixel].events[n].rise_per_s);
            let change = match row {
                0 => more[pixel].frames[n].residual_dn - less[pixel].frames[n].residual_dn,
                1 => more[pixel].events[n].excess - less[pixel].events[n].excess,
                _ => log_rise(&more) - log_rise(&less),
            };
            let found = problem.directional_derivative(r, &step, count);
            off[row] += (found - change) * (found - change);
            size[row] += change * change;
        }
        for (row, most) in [0.04, 0.04, 0.2].into_iter().enumerate() {
            let share = libm::sqrt(off[row] / size[row].max(1e-12));
            // Shading cancels from one voltage to another; the lag is taken at three instants, and a rise
            // over 100 us.
            let is_nothing = kind == 2 && row > 0;
            let nothing = if row == 1 { 1e-9 } else { 1e-5 };
            assert!(
                if is_nothing { off[row] < nothing } else { share < most },
                "{kind} {row}: {share} {}",
                off[row]
            );
        }
    }
}

#[test]
fn scores_are_those_of_the_whole_problem_on_the_array_and_on_a_part() {
    let (case, nominal) = noisy(Extent { width: 12, height: 10 }, 6, (5.0, 2.0));
    let block = Block { x: 3, y: 1, width: 8, height: 9 };
    for part in [None, Some(ArrayPart { block, pitch: 0.9 })] {
        scores_are_those_of_the_whole_problem(&case, &nominal, begin_on(&case, &nominal, (4.0, 0.2), part));
    }
}

fn scores_are_those_of_the_whole_problem(case: &Case, nominal: &Nominal, mut joint: JointPicture) {
    rounds(case, nominal, &mut joint, 2);
    let measured = current_predictions(case, nominal, &joint);
    joint.prepare(&measured);
    let effects = 3;
    let columns: Vec<Vec<f32>> = measured
        .iter()
        .enumerate()
        .map(|(pixel, of)| {
            let rows = of.frames.len() + 2 * of.events.len();
            (0..rows * effects).map(|k| libm::sin(0.3 * pixel as f64 + 1.7 * k as f64) as f32).collect()
        })
        .collect();
    let scores = joint.score(&measured, &columns, effects);
    // The whole problem, dense.
    let problem = joint.current().problem(&measured);
    let (count, all) = (joint.picture().grid.coefficients(), joint.current().unknowns().len());
    let mut normal = DMatrix::<f64>::zeros(all, all);
    let square = |normal: &mut DMatrix<f64>, first: usize, at: &[usize], by: &[f64], weight: f64| {
        for (a, by_a) in at.iter().zip(by) {
            for (b, by_b) in at.iter().zip(by) {
                normal[(first + a, first + b)] += weight * by_a * by_b;
            }
        }
    };
    joint.prior.for_each_difference(&joint.current().fields(), |at, by, weight| {
        square(&mut normal, 0, at, by, weight)
    });
    joint.current().each_of_rest(|at, by, weight| square(&mut normal, count, at, by, weight));
    let motion = joint.picture().motion.knots.len() * DEGREES;
    for n in count..all {
        let step = if n - count < motion { STEP_OF_MOTION } else { STEP_OF_SHADING };
        normal[(n, n)] += 1.0 / (step * step);
    }
    let gradient = DVector::from_vec(joint.current().gradient(&problem));
    let mut through = DMatrix::<f64>::zeros(all, effects);
    let (mut score, mut information) =
        (DVector::<f64>::zeros(effects), DMatrix::<f64>::zeros(effects, effects));
    for r in problem.used() {
        let mut row = vec![0.0; all];
        problem.add_row(r, 1.0, &mut row, count);
        let (row, weight) = (DVector::from_vec(row), problem.weight[r]);
        let at = problem.row_of(r, &measured) * effects;
        let of = &columns[problem.place[r] as usize][at..at + effects];
        let of = DVector::from_iterator(effects, of.iter().map(|by| f64::from(*by)));
        normal.ger(weight, &row, &row, 1.0);
        through.ger(weight, &row, &of, 1.0);
        score += weight * problem.residual[r] * &of;
        information.ger(weight, &of, &of, 1.0);
    }
    let factor = normal.cholesky().unwrap();
    score -= through.tr_mul(&factor.solve(&gradient));
    information -= through.tr_mul(&factor.solve(&through));
    let sum = |of: &dyn Fn(&Score) -> f64| -> f64 { scores.iter().flatten().map(of).sum() };
    for k in 0..effects {
        let found = sum(&|one| one.score[k]);
        assert!((found - score[k]).abs() < 1e-4 * information[(k, k)].abs(), "{found} is {}", score[k]);
        for other in 0..effects {
            let found = sum(&|one| one.information[k * effects + other]);
            let expected = information[(k, other)];
            assert!((found - expected).abs() < 1e-4 * information[(k, k)].abs(), "{found} is {expected}");
        }
    }
}

#[test]
fn events_decide_what_noisy_frames_leave_open() {
    let noise = (4.0, 0.2);
    let (case, nominal) = noisy(Extent { width: 32, height: 24 }, 10, (5.0, 2.0));
    let mut joint = joint_picture(&case, &nominal, noise);
    // What held-out events miss their thresholds by, as a share of them.
    let left = |joint: &JointPicture| {
        let of = current_predictions(&case, &nominal, joint);
        let held = of.iter().enumerate().filter(|(place, _)| joint.is_measured(*place));
        let mut sizes: Vec<f64> = held.flat_map(|(_, of)| &of.events).map(|e| e.excess.abs() / 0.2).collect();
        crate::statistics::median(&mut sizes)
    };
    let frames_alone = left(&joint);
    rounds(&case, &nominal, &mut joint, 5);
    let both = left(&joint);
    // Thresholds are passed by up to a step of 0.1 ms, at some 10 ln a second: half a hundredth of them.
    assert!(both < 0.015 && both < 0.3 * frames_alone, "{frames_alone} to {both}");
}

#[test]
fn a_step_that_leads_away_is_taken_back() {
    let (case, nominal) = noisy(Extent { width: 20, height: 16 }, 8, (5.0, 2.0));
    let mut joint = joint_picture(&case, &nominal, (4.0, 0.2));
    let left = |joint: &JointPicture| joint.median_event_misfit(&current_predictions(&case, &nominal, joint));
    rounds(&case, &nominal, &mut joint, 3);
    let before = joint.scene.clone();
    let (settled, objective) =
        (left(&joint), joint.current().objective(&current_predictions(&case, &nominal, &joint)));
    // Half a pixel along the motion, which no step a sixth as long makes good.
    let count = joint.picture().grid.coefficients();
    let step: Vec<f64> =
        (0..joint.current().unknowns().len()).map(|n| if n < count { 0.0 } else { 0.5 }).collect();
    joint.apply_step(&before, &step, 1.0);
    assert!(left(&joint) > 3.0 * settled);
    joint.before = Some(StepToShorten { scene: before.clone(), step, objective, times: 0 });
    for _ in 0..=TIMES_SHORTER {
        let measured = current_predictions(&case, &nominal, &joint);
        joint.newton_step(&measured);
    }
    assert!(Arc::ptr_eq(&joint.scene, &before) && joint.before.is_none() && joint.factor.is_none());
}

#[test]
fn a_step_with_an_effect_gains_what_the_scene_that_takes_it_does() {
    let (case, nominal) = noisy(Extent { width: 20, height: 16 }, 8, (5.0, 2.0));
    let mut joint = joint_picture(&case, &nominal, (4.0, 0.2));
    rounds(&case, &nominal, &mut joint, 5);
    let measured = current_predictions(&case, &nominal, &joint);
    joint.prepare(&measured);
    // Frames of another black level, and one threshold that is larger.
    let mut other = nominal.clone();
    other.number.black_level += 6.0;
    other.pixel.threshold_on *= 1.05;
    let with = current_predictions(&case, &other, &joint);
    let column = |(with, without): (&PixelPrediction, &PixelPrediction)| -> Vec<f32> {
        let frames = with.frames.iter().zip(&without.frames).map(|(a, b)| a.residual_dn - b.residual_dn);
        let events = with.events.iter().zip(&without.events).map(|(a, b)| a.excess - b.excess);
        let rises = with.events.iter().map(|_| 0.0);
        frames.chain(events).chain(rises).map(|by| by as f32).collect()
    };
    let columns: Vec<Vec<f32>> = with.iter().zip(&measured).map(column).collect();
    let after = |size: f64, nominal: &Nominal| {
        let mut moved = joint.clone();
        moved.step_with_effects(&measured, &columns, &[size]);
        let of = current_predictions(&case, nominal, &moved);
        (moved.objective(&of), moved.left_out(&of).iter().sum::<f64>())
    };
    let (alone, together) = (after(0.0, &nominal), after(1.0, &other));
    // The scene that takes the step fits what is measured by such a sensor better than one that stays.
    let still = joint.objective(&with);
    assert!(together.0 < still - 0.5 * (still - alone.0), "{still} to {}, {}", together.0, alone.0);
    let found: f64 = joint.gains(&measured, &columns, &[1.0]).iter().flatten().map(|of| of[0]).sum();
    let gained = together.1 - alone.1;
    // A step of everything, to first order: of the logarithms of rises too, which bend more than excesses.
    assert!(gained < -20.0 && (found - gained).abs() < 0.15 * gained.abs(), "{found} is {gained}");
    // Each event's part of it, by the noise that is left with it.
    let of_events = joint.event_gains(&with, &measured);
    let of = |place: usize| joint.is_measured(place) && !measured[place].events.is_empty();
    for (place, gains) in of_events.iter().enumerate() {
        assert_eq!(gains.len(), if of(place) { measured[place].events.len() } else { 0 });
    }
    assert!(of_events.iter().flatten().sum::<f64>() < 0.0);
}

#[test]
fn a_finer_grid_follows_edges_that_a_coarse_one_softens() {
    let case = testing::stripes(Extent { width: 32, height: 24 }, 8);
    let mut nominal = case.nominal().unwrap();
    nominal.pixel.front_end = FrontEnd::IDEAL;
    let block = Block { x: 6, y: 4, width: 20, height: 16 };
    let left = |pitch: f64| {
        let mut joint = begin_on(&case, &nominal, (0.5, 0.0), Some(ArrayPart { block, pitch }));
        rounds(&case, &nominal, &mut joint, 5);
        joint.median_event_misfit(&current_predictions(&case, &nominal, &joint))
    };
    let (coarse, fine) = (left(1.0), left(0.4));
    assert!(fine < 0.5 * coarse, "{coarse} to {fine}");
}

#[test]
fn events_decide_what_noisy_frames_leave_open_of_what_moves_before_a_ground() {
    let (case, nominal) = with_noise(testing::disc(Extent { width: 32, height: 24 }, 10), (5.0, 2.0));
    let setting = PictureSetting::default();
    let places = (0..case.extent.pixels()).map(|pixel| case.pixel_place(pixel));
    let ground: Vec<f32> = places.map(|(x, y)| testing::ground(f64::from(x), f64::from(y)) as f32).collect();
    // It lies on the array as it drifts.
    let poses: Vec<[f64; 6]> = (0..10)
        .map(|l| 8e-3 * (f64::from(l) - 4.5))
        .map(|t_s| [60.0 * t_s, 1.0, 0.0, -35.0 * t_s, 0.0, 1.0])
        .collect();
    let from = FitStart { ground: Some(&ground), ..FitStart::default() };
    let picture = ScenePicture::fit_from(&case, &nominal, &setting, &[&poses], from);
    let scene = MovingPicture::new(picture, &setting, &case, &nominal);
    let is_trained: Vec<bool> = (0..case.extent.pixels()).map(|pixel| pixel % 4 != 3).collect();
    let noise = SceneNoise::new((4.0, 0.2));
    let on = (&scene, &whole_array_part(&case));
    let mut joint = JointPicture::new(&case, &nominal, on, &is_trained, STEP_NS, noise).unwrap();
    let left = |joint: &JointPicture| joint.median_event_misfit(&current_predictions(&case, &nominal, joint));
    let frames_alone = left(&joint);
    rounds(&case, &nominal, &mut joint, 8);
    let both = left(&joint);
    // Thresholds are passed by up to a step of 10 us; the disc's edge is as soft as two steps of the grid.
    assert!(both < 0.02 && both < 0.2 * frames_alone, "{frames_alone} to {both}");
}

#[test]
fn a_picture_that_is_too_large_is_refused() {
    let (case, nominal) = noisy(Extent { width: 12, height: 10 }, 6, (1e9, 0.0));
    let mut scene = MovingPicture::fit(&case, &nominal, &PictureSetting::default()).unwrap();
    // As if it ran over some thousand pixels along both axes.
    for (k, knot) in scene.picture.motion.knots.iter_mut().enumerate() {
        (knot[0], knot[1]) = (300.0 * k as f64, 300.0 * k as f64);
    }
    let part = whole_array_part(&case);
    let noise = SceneNoise::new((1.0, 0.0));
    let begun = JointPicture::new(&case, &nominal, (&scene, &part), &[true; 120], STEP_NS, noise);
    assert!(begun.err().unwrap().contains("coefficients"));
}

#[test]
fn on_a_part_its_pixels_have_the_light_that_they_have_on_the_whole_array() {
    let (case, nominal) = noisy(Extent { width: 24, height: 20 }, 6, (1e9, 0.0));
    let whole = joint_picture(&case, &nominal, (1.0, 0.0));
    let block = Block { x: 5, y: 4, width: 14, height: 12 };
    let pitch = whole.picture().grid.pitch;
    let part = begin_on(&case, &nominal, (1.0, 0.0), Some(ArrayPart { block, pitch }));
    assert!(part.picture().grid.coefficients() < whole.picture().grid.coefficients());
    let (all, light) = (whole.light(&case), part.light(&case));
    for pixel in 0..case.extent.pixels() {
        let is_in = block.pixels(case.extent).contains(&(pixel as u32));
        assert_eq!(light.log[pixel].is_empty(), !is_in, "{pixel}");
        let off = light.log[pixel].iter().zip(&all.log[pixel]).map(|(a, b)| (a - b).abs());
        // The grids begin at other places.
        assert!(off.fold(0.0, f32::max) < 0.03, "{pixel}");
    }
    // Every measurement of the part is one of the whole array, and no other.
    let of = current_predictions(&case, &nominal, &part);
    assert_eq!(of.len(), 14 * 12);
    let problem = part.current().problem(&of);
    assert!(problem.frames() > 4 * 14 * 12 && problem.place.iter().all(|place| *place < 14 * 12));
}
