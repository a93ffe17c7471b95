//! Edges of known width: Gaussian edges, ideal steps under square pixels, motion blur, ringing, ghosts,
//! noise.

use super::fit::TEN_TO_NINETY;
use super::*;

const FULL_SCALE: f64 = 1000.0;

/// A picture of 40 x 30 pixels of an edge through its middle, `tilt` degrees off the vertical; `profile`
/// gives 0 to 1 at a distance along the normal.
fn picture(tilt: f64, profile: impl Fn(f64) -> f64) -> Vec<f64> {
    let (sin, cos) = (libm::sin(tilt.to_radians()), libm::cos(tilt.to_radians()));
    // 0.3 pixels from the middle: no symmetry with the pixels.
    let distance = |x: f64, y: f64| (x - 19.8) * cos + (y - 14.5) * sin;
    (0..30)
        .flat_map(|y| (0..40).map(move |x| (f64::from(x), f64::from(y))))
        .map(|(x, y)| 200.0 + 400.0 * profile(distance(x, y)))
        .collect()
}

/// The same, averaged over square pixels.
fn under_square_pixels(tilt: f64, profile: impl Fn(f64) -> f64) -> Vec<f64> {
    let (sin, cos) = (libm::sin(tilt.to_radians()), libm::cos(tilt.to_radians()));
    let n = 16;
    let part = |k: i32| (f64::from(k) + 0.5) / f64::from(n) - 0.5;
    let value = |x: i32, y: i32| {
        let sum: f64 = (0..n * n)
            .map(|k| {
                profile((f64::from(x) + part(k % n) - 19.8) * cos + (f64::from(y) + part(k / n) - 14.5) * sin)
            })
            .sum();
        200.0 + 400.0 * sum / f64::from(n * n)
    };
    (0..30).flat_map(|y| (0..40).map(move |x| (x, y))).map(|(x, y)| value(x, y)).collect()
}

fn gaussian(sigma: f64) -> impl Fn(f64) -> f64 {
    move |d| 0.5 * (1.0 + libm::erf(d / (sigma * std::f64::consts::SQRT_2)))
}

fn step(d: f64) -> f64 {
    if d < 0.0 { 0.0 } else { 1.0 }
}

fn question() -> Question {
    Question {
        thresholds: Thresholds::TenNinety,
        direction: Direction::Normal,
        fit: Fit::Straight,
        full_scale: FULL_SCALE,
        saturation: None,
        seed: 7,
    }
}

fn measured(plane: &[f64]) -> Edge {
    measure(plane, 40, &question())
}

fn noisy(mut plane: Vec<f64>, sigma: f64, seed: u64) -> Vec<f64> {
    let mut random = Random::new(seed, &[]);
    plane.iter_mut().for_each(|value| *value += sigma * random.normal());
    plane
}

#[test]
fn a_gaussian_edge_is_as_wide_as_its_sigma_says() {
    for sigma in [0.5, 1.0, 2.0] {
        for tilt in [3.0, -6.0, 15.0] {
            let edge = measured(&picture(tilt, gaussian(sigma)));
            let truth = TEN_TO_NINETY * sigma;
            assert_eq!(edge.refusal, None, "sigma {sigma}, tilt {tilt}");
            // Bins of a quarter pixel widen a narrow edge: up to 3 % at sigma 0.5.
            assert!(
                (edge.width / truth - 1.0).abs() < 0.035,
                "sigma {sigma}, tilt {tilt}: {} for {truth}",
                edge.width
            );
            assert!(
                (edge.gaussian_width / truth - 1.0).abs() < 0.02,
                "sigma {sigma}, tilt {tilt}: {} for {truth}",
                edge.gaussian_width
            );
            assert!((edge.angle - tilt.abs()).abs() < 0.3, "{} for {tilt}", edge.angle);
            // MTF50 of a Gaussian is sqrt(2 ln 2) / (2 pi sigma): the product with the width is 0.480.
            assert!(
                (edge.width * edge.mtf50 - 0.480).abs() < 0.02,
                "sigma {sigma}: {}",
                edge.width * edge.mtf50
            );
            assert!(edge.overshoot < 0.5 && edge.undershoot < 0.5 && edge.ghosts == 0);
            assert!(
                (edge.contrast - 400.0).abs() < 1.0
                    && (edge.middle[0] - 19.8).abs() < 0.1
                    && edge.middle[1] == 14.5,
                "{edge:?}"
            );
        }
    }
}

#[test]
fn an_ideal_step_under_square_pixels_is_at_the_floor() {
    for tilt in [2.5, 5.0, 9.0] {
        let edge = measured(&under_square_pixels(tilt, step));
        assert!((FLOOR_PX - 0.01..0.87).contains(&edge.width), "tilt {tilt}: {}", edge.width);
    }
}

#[test]
fn motion_blur_is_four_fifths_of_its_length() {
    for length in [4.0, 8.0] {
        let edge = measured(&picture(5.0, |d| (d / length + 0.5).clamp(0.0, 1.0)));
        assert!((edge.width - 0.8 * length).abs() < 0.1, "{length}: {}", edge.width);
    }
}

#[test]
fn motion_blur_under_square_pixels_has_the_width_of_both() {
    // A box of 1 pixel and one of L make a trapezoid: 10 % are reached after sqrt(0.2 L) pixels (L < 5), so
    // the width is L + 1 - 2 sqrt(0.2 L).
    for length in [1.3_f64, 2.6] {
        for tilt in [5.0, 11.0] {
            let edge = measured(&under_square_pixels(tilt, |d| (d / length + 0.5).clamp(0.0, 1.0)));
            let truth = length + 1.0 - 2.0 * (0.2 * length).sqrt();
            // Bins widen narrow edges, and a tilted pixel is wider than an upright one.
            assert!(
                (truth - 0.01..truth + 0.07).contains(&edge.width),
                "{length}, tilt {tilt}: {} for {truth}",
                edge.width
            );
        }
    }
}

#[test]
fn clipped_edges_look_sharp_and_are_refused() {
    let clipped: Vec<f64> = picture(5.0, gaussian(2.0)).iter().map(|value| value.min(450.0)).collect();
    let with = |saturation| measure(&clipped, 40, &Question { saturation, ..question() });
    assert!(with(None).width < 0.9 * TEN_TO_NINETY * 2.0, "{}", with(None).width);
    assert_eq!(with(Some(450.0)).refusal, Some(Refusal::Saturated));
    assert_eq!(with(Some(451.0)).refusal, None);
}

#[test]
fn the_other_thresholds_give_another_width() {
    let edge = measure(
        &picture(5.0, gaussian(1.0)),
        40,
        &Question { thresholds: Thresholds::TwentyEighty, ..question() },
    );
    // 20 to 80 % of a Gaussian edge: 1.683 sigma.
    assert!((edge.width - 1.683).abs() < 0.05, "{}", edge.width);
}

#[test]
fn ringing_narrows_the_edge_and_is_reported() {
    // 7 % at each side, 3 pixels long.
    let ringing = |d: f64| step(d) + if d.abs() < 3.0 { 0.07 * d.signum() } else { 0.0 };
    let edge = measured(&under_square_pixels(5.0, ringing));
    assert!(edge.width < 0.78, "{}", edge.width);
    assert!(
        (edge.overshoot - 7.0).abs() < 1.0 && (edge.undershoot - 7.0).abs() < 1.0,
        "{} {}",
        edge.overshoot,
        edge.undershoot
    );
}

#[test]
fn an_edge_may_lie_or_stand_and_rise_or_fall() {
    let upright = picture(5.0, gaussian(1.0));
    let expected = measured(&upright).width;
    let falling: Vec<f64> = upright.iter().map(|value| 800.0 - value).collect();
    assert!((measured(&falling).width - expected).abs() < 1e-9);
    let lying: Vec<f64> =
        (0..40).flat_map(|x| (0..30).map(|y| upright[y * 40 + x]).collect::<Vec<_>>()).collect();
    let edge = measure(&lying, 30, &question());
    assert!((edge.width - expected).abs() < 1e-9);
    assert_eq!(edge.middle[0], 14.5);
}

#[test]
fn the_interval_covers_the_width_and_grows_with_noise() {
    let truth = TEN_TO_NINETY;
    let edges = [4.0, 16.0].map(|sigma| measured(&noisy(picture(5.0, gaussian(1.0)), sigma, 11)));
    for edge in &edges {
        assert_eq!(edge.refusal, None);
        let [low, high] = edge.interval;
        assert!(
            low < edge.width && edge.width < high && (edge.width - truth).abs() < 0.4,
            "{:?} {}",
            edge.interval,
            edge.width
        );
    }
    let size = |edge: &Edge| edge.interval[1] - edge.interval[0];
    assert!(size(&edges[1]) > 1.5 * size(&edges[0]), "{} {}", size(&edges[0]), size(&edges[1]));
}

#[test]
fn a_row_profile_reads_what_stands_on_the_segment() {
    let segment: Vec<f64> = (0..40).map(|x| 200.0 + 400.0 * gaussian(2.0)(f64::from(x) - 18.3)).collect();
    let edge = measure(&segment, 40, &Question { direction: Direction::Row, ..question() });
    // A straight line between two columns lies up to f''/8 off the curve, f'' = 1.282 phi(1.282) / sigma^2:
    // 0.08 pixels at either threshold, outwards.
    assert!((0.0..0.16).contains(&(edge.width - 2.0 * TEN_TO_NINETY)), "{}", edge.width);
    assert!(edge.interval[0].is_nan(), "one row has nothing to draw from");
    assert_eq!(edge.profile.len(), 40);
    // An ideal step on a single row: 0.8 to 1.6 pixels, as its phase will have it.
    for phase in [0.0, 0.25, 0.5] {
        let row: Vec<f64> =
            (0..40).map(|x| 200.0 + 400.0 * (f64::from(x) - 20.0 + phase).clamp(0.0, 1.0)).collect();
        let width = measure(&row, 40, &Question { direction: Direction::Row, ..question() }).width;
        assert!((0.79..1.61).contains(&width), "phase {phase}: {width}");
    }
}

#[test]
fn a_ghost_is_counted_and_has_no_width() {
    // Dark, bright, dark for six pixels, bright.
    let doubled = |d: f64| gaussian(0.7)(d + 6.0) - gaussian(0.7)(d) + gaussian(0.7)(d - 6.0);
    let edge = measured(&picture(5.0, doubled));
    assert_eq!((edge.refusal, edge.ghosts), (Some(Refusal::Ghosts), 2));
    assert!(edge.width.is_nan() && (edge.ghost_spacing - 12.0).abs() < 0.5, "{}", edge.ghost_spacing);
}

#[test]
fn what_cannot_be_measured_is_refused_with_a_reason() {
    let sharp = |tilt: f64| picture(tilt, gaussian(1.0));
    let refused = |plane: &[f64]| {
        let edge = measured(plane);
        assert!(edge.width.is_nan() && edge.interval[0].is_nan());
        edge.refusal
    };
    assert_eq!(refused(&vec![300.0; 1200]), Some(Refusal::LowContrast));
    // 4 % of full scale.
    assert_eq!(
        refused(&sharp(5.0).iter().map(|value| value / 10.0).collect::<Vec<_>>()),
        Some(Refusal::LowContrast)
    );
    assert_eq!(refused(&noisy(sharp(5.0), 30.0, 3)), Some(Refusal::Noisy));
    assert_eq!(refused(&sharp(0.0)), Some(Refusal::Phases));
    let mut holes = sharp(5.0);
    holes[7] = f64::NAN;
    assert_eq!(refused(&holes), Some(Refusal::Unknown));
    assert_eq!(refused(&picture(5.0, |d| gaussian(1.0)(d - 17.0))), Some(Refusal::AtTheBorder));
    assert_eq!(refused(&picture(5.0, |d| (d / 60.0 + 0.5).clamp(0.0, 1.0))), Some(Refusal::NoPlateau));
    // A zigzag of 12 pixels.
    let zigzag: Vec<f64> = (0..30)
        .flat_map(|y| (0..40).map(move |x| if x < 14 + 12 * (y / 5 % 2) { 200.0 } else { 600.0 }))
        .collect();
    assert_eq!(refused(&zigzag), Some(Refusal::NotStraight));
    assert_eq!(measure(&sharp(5.0)[..400], 40, &question()).refusal, Some(Refusal::TooSmall));
}

/// A disk of radius `r` whose rim stands at column 19.8 of the middle row, `tilt` degrees off the vertical
/// there; its edge is a Gaussian of sigma 1.
fn rim(r: f64, tilt: f64) -> Vec<f64> {
    let (sin, cos) = (libm::sin(tilt.to_radians()), libm::cos(tilt.to_radians()));
    let value = |x: i32, y: i32| {
        let (dx, dy) = (f64::from(x) - 19.8 + r * cos, f64::from(y) - 14.5 + r * sin);
        600.0 - 400.0 * gaussian(1.0)((dx * dx + dy * dy).sqrt() - r)
    };
    (0..30).flat_map(|y| (0..40).map(move |x| (x, y))).map(|(x, y)| value(x, y)).collect()
}

#[test]
fn a_bent_edge_needs_a_parabola() {
    let of = |r: f64, tilt, fit| measure(&rim(r, tilt), 40, &Question { fit, ..question() });
    for (r, tilt) in [(60.0, 5.0), (40.0, 8.0)] {
        // A rim of 30 rows is 1.9 or 2.9 pixels behind at its ends: a straight line mixes that into the
        // width.
        let (straight, bent) = (of(r, tilt, Fit::Straight), of(r, tilt, Fit::Quadratic));
        assert!(straight.width > 1.08 * TEN_TO_NINETY, "{r}: {} {:?}", straight.width, straight.refusal);
        assert!((bent.width / TEN_TO_NINETY - 1.0).abs() < 0.035, "{r}: {} {:?}", bent.width, bent.refusal);
        // A circle is no parabola: its slope in the middle comes out a little steeper.
        assert!((bent.angle - tilt).abs() < 0.5, "{}", bent.angle);
    }
    // An upright rim shows all phases by itself, where its bend is known.
    assert_eq!(of(60.0, 0.0, Fit::Straight).refusal, Some(Refusal::Phases));
    assert!((of(60.0, 0.0, Fit::Quadratic).width / TEN_TO_NINETY - 1.0).abs() < 0.035);
    // It takes nothing from a straight edge.
    let straight = measure(&picture(5.0, gaussian(1.0)), 40, &Question { fit: Fit::Quadratic, ..question() });
    assert!((straight.width / TEN_TO_NINETY - 1.0).abs() < 0.035, "{}", straight.width);
}

#[test]
fn pictures_of_a_moving_edge_fill_each_others_phases() {
    // Upright: no picture has a width by itself. Where the edge stands differs by a third of a pixel from
    // picture to picture, and so does the light.
    let at = |n: u32| -> Vec<f64> {
        let value = |x: u32| {
            f64::from(3 + n) * 100.0 * (1.0 + gaussian(1.0)(f64::from(x) - 18.0 - f64::from(n) / 3.0))
        };
        (0..30 * 40).map(|i| value(i % 40)).collect()
    };
    let pictures: Vec<Vec<f64>> = (0..4).map(at).collect();
    let (edges, joint, count) = measure_all(pictures.iter().map(Vec::as_slice), 40, &question());
    assert!(edges.iter().all(|edge| edge.refusal == Some(Refusal::Phases)), "{:?}", edges[0].refusal);
    assert_eq!((joint.refusal, count), (None, 4));
    // Three phases of a third of a pixel: bins of a quarter pixel are met by one or two of them.
    assert!((joint.width / TEN_TO_NINETY - 1.0).abs() < 0.06, "{}", joint.width);
    assert!((joint.contrast - 450.0).abs() < 5.0, "the middle of 300 to 600 DN: {}", joint.contrast);
    // The same picture four times has one phase still.
    let (_, joint, _) = measure_all(vec![pictures[0].as_slice(); 4].into_iter(), 40, &question());
    assert_eq!(joint.refusal, Some(Refusal::Phases));
}

#[test]
fn pictures_without_the_edge_take_no_part() {
    let (flat, sharp) = (vec![300.0; 1200], picture(5.0, gaussian(1.0)));
    let (edges, joint, count) =
        measure_all([flat.as_slice(), sharp.as_slice(), flat.as_slice()].into_iter(), 40, &question());
    assert_eq!((count, edges.len()), (1, 3));
    assert!((joint.width - edges[1].width).abs() < 1e-9, "{} {}", joint.width, edges[1].width);
    let (_, joint, count) = measure_all([flat.as_slice()].into_iter(), 40, &question());
    assert_eq!((joint.refusal, count), (Some(Refusal::LowContrast), 0));
}
