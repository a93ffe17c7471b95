//! The log change of one event: thresholds from frames.
//!
//! Between two frames the logarithm of a place changes by `c_on` for each ON event of a pixel and by `-c_off` for each OFF event. Both follow from a fit
//! over all pairs of frames and all places that changed, with places that lie far off (noise events, saturation) counted for less (Huber).
//!
//! An event count is a change rounded to whole events, so a plain fit through the counts is too low where counts are small. Places of several pixels
//! round each pixel by itself, and the errors cancel; and places with less than one event a pixel are left out.

use super::draw::estimate;
use super::{Estimate, Panel};

/// Places with fewer events a pixel say little, and what they say is rounded.
const FEWEST_A_PIXEL: f32 = 1.5;
/// Places that changed, at least.
const FEWEST: usize = 100;
/// Rounds of the fit with new weights.
const ROUNDS: usize = 8;
/// From so many standard deviations on a place counts for less: Huber's usual constant.
const HUBER: f64 = 1.345;

/// Both thresholds, natural-log units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steps {
    /// Of an ON event.
    pub on: Estimate,
    /// Of an OFF event.
    pub off: Estimate,
    /// Places and pairs of frames that the fit is made of.
    pub measured: usize,
    /// Standard deviation of what the fit leaves, natural-log units.
    pub sigma: f64,
}

/// One place between two frames.
struct Row {
    unit: u32,
    on: f64,
    off: f64,
    change: f64,
}

/// Thresholds, with events taken `offset_ns` later than frames; none where too little changed.
pub fn thresholds(panel: &Panel, offset_ns: f64) -> Option<Steps> {
    let rows = rows(panel, offset_ns);
    if rows.len() < FEWEST {
        return None;
    }
    let mut units: Vec<u32> = rows.iter().map(|row| row.unit).collect();
    units.dedup();
    // Sums by unit under the weights of the whole fit: drawing units again then costs nothing.
    let (weights, sigma) = huber(&rows)?;
    let mut sums = vec![[0.0; 5]; units.len()];
    let mut unit = 0;
    for (row, weight) in rows.iter().zip(&weights) {
        while units[unit] != row.unit {
            unit += 1;
        }
        let add = [row.on * row.on, row.on * row.off, row.off * row.off, row.on * row.change, row.off * row.change];
        sums[unit].iter_mut().zip(add).for_each(|(sum, add)| *sum += weight * add);
    }
    let solved = |weights: &[f64]| {
        let total = sums.iter().zip(weights).fold([0.0; 5], |mut total: [f64; 5], (sums, weight)| {
            total.iter_mut().zip(sums).for_each(|(total, sum)| *total += weight * sum);
            total
        });
        solve(&total)
    };
    Some(Steps {
        on: estimate(units.len(), |weights| solved(weights).map(|found| found.0))?,
        off: estimate(units.len(), |weights| solved(weights).map(|found| found.1))?,
        measured: rows.len(),
        sigma,
    })
}

fn rows(panel: &Panel, offset_ns: f64) -> Vec<Row> {
    let places = panel.places();
    let (mut rows, mut pair) = (Vec::new(), 0);
    for stretch in &panel.stretches {
        let (on, off) = (stretch.summed(1.0, 0.0), stretch.summed(0.0, -1.0));
        for frame in 1..stretch.mids_ns.len() {
            let (from, to) = (stretch.mids_ns[frame - 1] as f64 + offset_ns, stretch.mids_ns[frame] as f64 + offset_ns);
            let (mut n_on, mut n_off) = (vec![0.0; places], vec![0.0; places]);
            let is_inside = stretch.add_at(&on, to, 1.0, &mut n_on)
                && stretch.add_at(&on, from, -1.0, &mut n_on)
                && stretch.add_at(&off, to, 1.0, &mut n_off)
                && stretch.add_at(&off, from, -1.0, &mut n_off);
            let first = rows.len();
            for place in (0..places).filter(|_| is_inside) {
                let change = f64::from(stretch.logs(frame)[place] - stretch.logs(frame - 1)[place]);
                let pixels = panel.pixels[place] as f32;
                // Both ways of nearly one size: a flicker or an edge that went and came, of which frames see nothing.
                let (on, off) = (n_on[place] / pixels, n_off[place] / pixels);
                if change.is_finite() && (on - off).abs() >= FEWEST_A_PIXEL && (on - off).abs() > 0.6 * (on + off) {
                    rows.push(Row { unit: pair * 4096 + u32::from(panel.parts[place]), on: f64::from(on), off: -f64::from(off), change });
                }
            }
            rows[first..].sort_by_key(|row| row.unit);
            pair += 1;
        }
    }
    rows
}

/// Weights of a robust fit, and the spread of what it leaves.
fn huber(rows: &[Row]) -> Option<(Vec<f64>, f64)> {
    let mut weights = vec![1.0; rows.len()];
    let mut sigma = 0.0;
    for _ in 0..ROUNDS {
        let total = rows.iter().zip(&weights).fold([0.0; 5], |total: [f64; 5], (row, w)| {
            let add = [row.on * row.on, row.on * row.off, row.off * row.off, row.on * row.change, row.off * row.change];
            std::array::from_fn(|n| total[n] + w * add[n])
        });
        let (on, off) = solve(&total)?;
        let left: Vec<f64> = rows.iter().map(|row| row.change - on * row.on - off * row.off).collect();
        let mut sizes: Vec<f64> = left.iter().map(|left| left.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        sigma = 1.4826 * sizes[sizes.len() / 2];
        weights = left.iter().map(|left| if left.abs() <= HUBER * sigma { 1.0 } else { HUBER * sigma / left.abs() }).collect();
    }
    Some((weights, sigma))
}

/// Two normal equations; none when they are one.
fn solve(sums: &[f64; 5]) -> Option<(f64, f64)> {
    let [aa, ab, bb, ay, by] = *sums;
    let determinant = aa * bb - ab * ab;
    (determinant > 1e-9 * aa * bb).then(|| ((ay * bb - by * ab) / determinant, (by * aa - ay * ab) / determinant))
}
