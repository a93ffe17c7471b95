//! Views: smooth in time, edges as soft as stated, and what is seen moves.

use super::*;
use crate::light::cubic;

const SIZE: [f64; 2] = [72.0, 54.0];

fn grid() -> Grid {
    Grid { left: 0.0, top: 0.0, columns: 72, rows: 54 }
}

fn pattern(view: &View, t: f64) -> Vec<f64> {
    let mut out = vec![0.0; 72 * 54];
    view.pattern(t, t, &grid(), &mut out);
    out
}

#[test]
fn an_edge_has_the_stated_standard_deviation() {
    let (sigma, h) = (0.4, 1e-3);
    let mut variance = 0.0;
    for k in -2000..2000 {
        let d = (f64::from(k) + 0.5) * h;
        variance += d * d * (edge(d + 0.5 * h, sigma) - edge(d - 0.5 * h, sigma));
    }
    assert!((variance - sigma * sigma).abs() < 1e-5, "{variance}");
    assert_eq!((edge(-1.1, sigma), edge(0.0, sigma), edge(1.1, sigma)), (0.0, 0.5, 1.0));
}

#[test]
fn views_are_smooth_in_time() {
    // The cubic through four instants 32 us apart gives the light between them to a hundredth of a threshold,
    // and to 1e-5 ln on average.
    for name in View::NAMES {
        let view = View::draw(name, &mut Random::named(name), SIZE, 0.35).expect("a view");
        let h = 32e-6;
        let (mut worst, mut sum, mut moved) = (0.0f64, 0.0, 0.0);
        for k in 0..12 {
            let t = 4e-3 + 7e-3 * f64::from(k);
            let nodes = [-1.0, 0.0, 1.0, 2.0].map(|n| pattern(&view, t + n * h));
            let (between, later) = (pattern(&view, t + 0.5 * h), pattern(&view, t + 1e-3));
            let weights = cubic(0.5);
            for p in 0..between.len() {
                let value: f64 = (0..4).map(|n| weights[n] * nodes[n][p]).sum();
                worst = worst.max((value - between[p]).abs());
                sum += (value - between[p]).abs() / (12.0 * between.len() as f64);
                moved += (later[p] - between[p]).abs() / (12.0 * between.len() as f64);
            }
        }
        println!("{name}: {worst:.1e} ln at most, {sum:.1e} on average; {moved:.3} in a millisecond");
        assert!(worst < 2e-3 && sum < 1e-5, "{name}: {worst} ln at most, {sum} on average");
        assert!(moved > 2e-3, "{name}: moves by {moved} in a millisecond");
    }
}

#[test]
fn views_have_the_range_of_a_pattern() {
    for name in View::NAMES {
        let view = View::draw(name, &mut Random::named(name), SIZE, 0.6).expect("a view");
        let values: Vec<f64> = (0..6).flat_map(|k| pattern(&view, 0.02 * f64::from(k))).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let spread = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / values.len() as f64;
        let most = values.iter().fold(0.0f64, |most, v| most.max(v.abs()));
        assert!(
            mean.abs() < 0.7 && (0.15..0.9).contains(&spread.sqrt()) && most < 1.8,
            "{name}: {mean} {spread} {most}"
        );
    }
    assert!(View::draw("none", &mut Random::named("none"), SIZE, 0.6).is_none());
}
