//! The motion of pictures in closed form.

use super::*;
use photocurrent_core::Extent;

/// Log light that slides by 0.7 and 0.2 pixels a millisecond.
fn texture(x: usize, y: usize, ms: f64) -> f64 {
    let (x, y) = (x as f64 - 0.7 * ms, y as f64 - 0.2 * ms);
    4.6 + 0.3 * libm::sin(0.8 * x + 0.3) * libm::cos(0.7 * y)
        + 0.2 * libm::sin(0.4 * x - 0.9 * y)
        + 0.1 * libm::sin(1.3 * x + 0.5 * y)
}

#[test]
fn the_motion_of_a_sliding_texture_is_found() {
    // From the light itself, so that only the motion estimate is tested.
    let picture = |n: usize| Image {
        width: 24,
        height: 16,
        values: (0..384).map(|p| texture(p % 24, p / 24, 0.5 * n as f64) as f32).collect(),
    };
    let film = |numbers: std::ops::Range<usize>| LogFilm {
        first: numbers.start,
        pictures: numbers.map(picture).collect(),
    };
    let activity = Activity::new(
        Extent { width: 24, height: 16 },
        (0, 20_000_000),
        std::iter::once((12, 8, 10_000_000)),
    );
    let flow = Flow::new((24, 16), (0, 41), &activity, (&MotionParams::default(), true), film);
    for (x, y, t_ns) in [(12.0, 8.0, 10_000_000), (5.0, 4.0, 5_000_000), (18.5, 11.5, 15_300_000)] {
        let [vx, vy] = flow.at(x, y, t_ns);
        // A twentieth of a pixel over the three lines that neighbours predict from.
        assert!((vx - 0.7).abs() < 0.015 && (vy - 0.2).abs() < 0.015, "({vx}, {vy}) at ({x}, {y})");
    }
}

#[test]
fn what_passes_before_a_ground_leaves_its_motion_alone() {
    // A disc of radius 3 that crosses a sliding texture at 1.6 pixels a millisecond.
    let (width, height) = (60, 44);
    let disc = |ms: f64| (30.0 - 1.6 * (ms - 10.0), 22.0);
    let log = |x: usize, y: usize, ms: f64| {
        let (cx, cy) = disc(ms);
        let inside = (3.5 - libm::hypot(x as f64 - cx, y as f64 - cy)).clamp(0.0, 1.0);
        texture(x, y, ms) + 1.5 * inside
    };
    let values =
        |n: usize| (0..width * height).map(|p| log(p % width, p / width, 0.5 * n as f64) as f32).collect();
    let picture = |n: usize| Image { width, height, values: values(n) };
    let film = |numbers: std::ops::Range<usize>| LogFilm {
        first: numbers.start,
        pictures: numbers.map(picture).collect(),
    };
    let extent = Extent { width: width as u32, height: height as u32 };
    let activity = Activity::new(extent, (0, 20_000_000), std::iter::once((30, 22, 10_000_000)));
    let flow = Flow::new((width, height), (0, 41), &activity, (&MotionParams::default(), true), film);
    // In a ring around it, as far as windows reach.
    let ring: Vec<(usize, usize)> = (0..width * height)
        .map(|p| (p % width, p / width))
        .filter(|(x, y)| (7.0..12.0).contains(&libm::hypot(*x as f64 - 30.0, *y as f64 - 22.0)))
        .collect();
    let off = |(x, y): &(usize, usize)| {
        let [vx, vy] = flow.at(*x as f64, *y as f64, 10_000_000);
        libm::hypot(vx - 0.7, vy - 0.2)
    };
    // Without another motion to choose all 292 are off; with it, 19.
    let wrong = ring.iter().filter(|at| off(at) > 0.1).count();
    assert!(wrong * 10 < ring.len(), "{wrong} of {}", ring.len());
}
