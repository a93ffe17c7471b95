//! Derivatives of the fit against finite steps; the same picture with any number of threads; sharper edges.

use super::super::rows::{POSES, TOUCHED};
use super::*;
use crate::testing;
use photocurrent_core::Extent;

fn recording() -> Case {
    testing::texture(Extent { width: 24, height: 18 }, 6)
}

#[test]
fn derivatives_are_those_of_finite_steps() {
    let case = recording();
    derivatives_of(&case, None);
    let mut random = Random::new(4, &[]);
    let ground: Vec<f32> =
        (0..case.extent.pixels()).map(|_| (60.0 + 80.0 * random.uniform()) as f32).collect();
    derivatives_of(&case, Some(&ground));
}

fn derivatives_of(case: &Case, ground: Option<&[f32]>) {
    let nominal = case.nominal().unwrap();
    let setting = PictureSetting::default();
    let poses = vec![[0.3, 1.01, 0.02, -0.4, -0.02, 0.99]; case.frame_count()];
    let mut fit = PictureFit::new(
        case,
        &nominal,
        &setting,
        begin_motion(case, &poses, &setting),
        FitStart { counts: None, ground, selected: None },
    );
    let mut random = Random::new(3, &[]);
    let typical = fit.typical as f32;
    fit.picture.surface.iter_mut().for_each(|c| *c += 0.2 * typical * random.normal() as f32);
    fit.picture.shading.iter_mut().for_each(|term| *term = 0.02 * random.normal());
    let rows = fit.frame_rows(true);
    assert!(rows.count() > 500);
    let begun = fit.picture.clone();
    let mut moved = |change: &dyn Fn(&mut ScenePicture, f64)| -> Vec<f64> {
        let by = 1e-4;
        let at = |fit: &mut PictureFit<'_>, by: f64| {
            fit.picture = begun.clone();
            change(&mut fit.picture, by);
            fit.frame_rows(false).residual
        };
        let (more, less) = (at(&mut fit, by), at(&mut fit, -by));
        // A residual falls as what is predicted rises.
        more.iter().zip(&less).map(|(more, less)| -f64::from(more - less) / (2.0 * by)).collect()
    };
    let knots = begun.motion.knots.len();
    for (knot, degree) in (0..knots).flat_map(|knot| (0..DEGREES).map(move |degree| (knot, degree))) {
        let finite = moved(&|picture, by| picture.motion.knots[knot][degree] += by);
        for (r, finite) in finite.iter().enumerate() {
            let first = rows.knot[r] as usize;
            let own = if (first..first + TOUCHED).contains(&knot) {
                f64::from(rows.other_derivatives(r)[POSES + (knot - first) * DEGREES + degree])
            } else {
                0.0
            };
            assert!(
                (own - finite).abs() < 0.02 * own.abs() + 1.5,
                "knot {knot}, degree {degree}, row {r}: {own} is {finite}"
            );
        }
    }
    for term in 0..TERMS {
        let finite = moved(&|picture, by| picture.shading[term] += by);
        for (r, finite) in finite.iter().enumerate() {
            let own = f64::from(rows.other_derivatives(r)[term]);
            assert!((own - finite).abs() < 0.02 * own.abs() + 1.5, "term {term}, row {r}: {own} is {finite}");
        }
    }
}

#[test]
fn the_same_recording_gives_the_same_picture_with_any_number_of_threads() {
    let case = recording();
    let nominal = case.nominal().unwrap();
    let of = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| ScenePicture::fit(&case, &nominal, &PictureSetting::default()).unwrap().surface)
    };
    assert_eq!(of(1), of(2));
}

#[test]
fn sharpening_narrows_edges_and_leaves_what_is_flat() {
    let case = recording();
    let nominal = case.nominal().unwrap();
    let setting = PictureSetting { coarse_pitch: 0.5, ..PictureSetting::default() };
    let poses = vec![[0.0, 1.0, 0.0, 0.0, 0.0, 1.0]; case.frame_count()];
    let mut picture = PictureFit::new(
        &case,
        &nominal,
        &setting,
        begin_motion(&case, &poses, &setting),
        FitStart::default(),
    )
    .picture;
    let grid = picture.grid;
    let edge = |x: f64| 100.0 + 50.0 * libm::tanh(x / 0.8);
    picture.surface = (0..grid.coefficients())
        .map(|n| edge(grid.x0 + (n % grid.width) as f64 * grid.pitch) as f32)
        .collect();
    let sharp = picture.sharpened(0.4);
    let width = |of: &ScenePicture| {
        let values: Vec<f64> =
            (-400..=400).map(|k| of.grid.value(&of.surface, f64::from(k) * 0.01, 0.3).unwrap()).collect();
        assert!(values.windows(2).all(|pair| pair[1] >= pair[0] - 1e-3), "an edge that rises goes on rising");
        values.iter().filter(|value| (60.0..140.0).contains(*value)).count() as f64 * 0.01
    };
    let (before, after) = (width(&picture), width(&sharp));
    assert!(after < before - 0.5 && after > before - 1.0, "{before} px becomes {after}");
    for x in [-6.0, 6.0] {
        assert!((sharp.grid.value(&sharp.surface, x, 1.0).unwrap() - edge(x)).abs() < 0.1);
    }
}
