//! The log change of one event: thresholds from frames.
//!
//! Between two frames the logarithm of a place changes by `c_on` for each ON event of a pixel and by `-c_off`
//! for each OFF event. The net events of a pixel are fitted on the change of the frames, for rising and
//! falling places by themselves, with places that lie far off (noise events, flicker) counted for less
//! (Huber).
//!
//! An event count is a change rounded to whole events, so it is the count that is fitted and not the change:
//! rounding then makes noise and no bias. The reverse holds for noise of the frames, so only bright places
//! are taken, and only changes well over that noise. Dark places are what makes thresholds come out too
//! large: one step of the scale is a large change there, and their slow pixels lose events. A change that
//! reverses costs the pixel up to a threshold before its next event, whatever its size: the line that is
//! fitted need not begin at zero, and its slope counts. The largest values may be saturated and are taken as
//! unknown.

use super::draw::{Estimate, by_draws};
use super::panel::{ACROSS, Panel};

/// Smaller changes of the logarithm are left out: noise of frames would be taken for change without events.
const LEAST_CHANGE: f64 = 0.3;
/// Places that changed one way, at least.
const FEWEST: usize = 50;
/// Events between two frames that hang on what was before them, of up to one. The interval holds it.
const UNSURE: f64 = 0.75;
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
    /// Places and pairs of frames that the fit is made of: bright ones that changed enough.
    pub measured: usize,
    /// Those that changed enough and are too dark.
    pub too_dark: usize,
    /// Standard deviation of what the fit leaves, natural-log units.
    pub sigma: f64,
}

/// One place between two frames that changed one way.
struct Row {
    unit: u32,
    /// Events of that way a pixel, less those of the other.
    net: f64,
    /// Change of the logarithm, positive.
    change: f64,
}

/// Thresholds, with events taken `offset_ns` later than frames; none where too few bright places changed.
pub fn thresholds(panel: &Panel, offset_ns: f64) -> Option<Steps> {
    let Rows { up, down, too_dark } = rows(panel, offset_ns);
    let (on, sigma_on) = threshold(&up)?;
    let (off, sigma_off) = threshold(&down)?;
    Some(Steps { on, off, measured: up.len() + down.len(), too_dark, sigma: 0.5 * (sigma_on + sigma_off) })
}

/// Sums of 1, change, events, change squared, change times events.
type Sums = [f64; 5];

fn products(row: &Row) -> Sums {
    [1.0, row.change, row.net, row.change * row.change, row.change * row.net]
}

fn add(sums: &mut Sums, weight: f64, more: &Sums) {
    sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += weight * more);
}

/// Events a change, and at none, of the line through all; none where it does not rise.
fn line(&[n, change, events, squares, products]: &Sums) -> Option<(f64, f64)> {
    let slope = (n * products - change * events) / (n * squares - change * change).max(1e-30);
    (slope > 0.0 && slope.is_finite()).then(|| (slope, (events - slope * change) / n))
}

/// The threshold of one way, and the spread of what the fit leaves.
fn threshold(rows: &[Row]) -> Option<(Estimate, f64)> {
    if rows.len() < FEWEST {
        return None;
    }
    // Sums by unit under the weights of the whole fit: drawing units again then costs nothing.
    let (weights, sigma) = huber(rows)?;
    let mut units: Vec<(u32, Sums)> = Vec::new();
    for (row, weight) in rows.iter().zip(&weights) {
        if units.last().is_none_or(|unit| unit.0 != row.unit) {
            units.push((row.unit, [0.0; 5]));
        }
        if let Some((_, sums)) = units.last_mut() {
            add(sums, *weight, &products(row));
        }
    }
    let found = by_draws(units.len(), |drawn| {
        let mut total = [0.0; 5];
        units.iter().zip(drawn).for_each(|((_, sums), n)| add(&mut total, *n, sums));
        line(&total).map(|(slope, _)| 1.0 / slope)
    })?;
    // A pixel's state at both ends is not known: after a reversal it is up to one event behind.
    let net = rows.iter().map(|row| row.net).sum::<f64>() / rows.len() as f64;
    let unsure = found.value * (UNSURE / net.max(1.0));
    let ci95 = (found.ci95.0.min(found.value - unsure), found.ci95.1.max(found.value + unsure));
    Some((Estimate { ci95, ..found }, sigma * found.value))
}

/// Rows in order of their unit, by the way that frames changed.
struct Rows {
    up: Vec<Row>,
    down: Vec<Row>,
    too_dark: usize,
}

fn rows(panel: &Panel, offset_ns: f64) -> Rows {
    let (places, bright) = (panel.places(), panel.bright());
    let (mut found, mut pair) = (Rows { up: Vec::new(), down: Vec::new(), too_dark: 0 }, 0);
    for stretch in &panel.stretches {
        let summed = stretch.summed(1.0, 1.0);
        for frame in 1..stretch.mids_ns.len() {
            let (from, to) =
                (stretch.mids_ns[frame - 1] as f64 + offset_ns, stretch.mids_ns[frame] as f64 + offset_ns);
            let mut net = vec![0.0; places];
            let is_inside =
                stretch.add_at(&summed, to, 1.0, &mut net) && stretch.add_at(&summed, from, -1.0, &mut net);
            for place in (0..places).filter(|_| is_inside) {
                let (before, after) = (stretch.logs(frame - 1)[place], stretch.logs(frame)[place]);
                let change = f64::from(after - before);
                // Not a number is left out as well.
                if !change.is_finite() || change.abs() < LEAST_CHANGE {
                    continue;
                }
                if before.min(after) < bright {
                    found.too_dark += 1;
                    continue;
                }
                let (unit, net) = (
                    pair * 4096 + u32::from(panel.parts[place]),
                    f64::from(net[place] / panel.pixels[place] as f32),
                );
                let (rows, net) = if change > 0.0 { (&mut found.up, net) } else { (&mut found.down, -net) };
                rows.push(Row { unit, net, change: change.abs() });
            }
            pair += 1;
        }
    }
    found.up.sort_by_key(|row| row.unit);
    found.down.sort_by_key(|row| row.unit);
    found
}

/// Weights of a robust fit of events on change, and the spread of what it leaves, in events.
fn huber(rows: &[Row]) -> Option<(Vec<f64>, f64)> {
    let mut weights = vec![1.0; rows.len()];
    let mut sigma = 0.0;
    for _ in 0..ROUNDS {
        let mut total = [0.0; 5];
        rows.iter().zip(&weights).for_each(|(row, weight)| add(&mut total, *weight, &products(row)));
        // Events against the change in both: the frames do not show what the events do.
        let (slope, none) = line(&total)?;
        let left: Vec<f64> = rows.iter().map(|row| row.net - none - slope * row.change).collect();
        let mut sizes: Vec<f64> = left.iter().map(|left| left.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        sigma = 1.4826 * sizes[sizes.len() / 2];
        weights = left
            .iter()
            .map(|left| if left.abs() <= HUBER * sigma { 1.0 } else { HUBER * sigma / left.abs() })
            .collect();
    }
    Some((weights, sigma))
}

/// What thresholds other than stated gain on the other half of the picture, nats.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepGains {
    /// Of both thresholds larger or smaller by one factor.
    pub scale: f64,
    /// Of each threshold by itself, over that.
    pub apart: f64,
    /// Places between frames that were judged.
    pub measured: usize,
}

/// Gains of other thresholds than `stated` (ON, OFF): events for a change of frames, fitted on half of the
/// picture's parts and judged on the other, both ways, with normal errors whose size is that of the half that
/// is fitted. None where too few bright places changed.
pub fn step_gains(panel: &Panel, offset_ns: f64, stated: (f64, f64)) -> Option<StepGains> {
    let Rows { up, down, .. } = rows(panel, offset_ns);
    if up.len() < FEWEST || down.len() < FEWEST {
        return None;
    }
    let ways = [(&up, huber(&up)?.0, 1.0 / stated.0), (&down, huber(&down)?.0, 1.0 / stated.1)];
    let side = |row: &Row| ((row.unit % 4096) as usize / ACROSS + (row.unit % 4096) as usize % ACROSS) % 2;
    let mut found = [0.0; 3];
    for half in 0..2 {
        // Weighted sums of the fitted half: 1, change, events, change squared, change times events.
        let sums = |(rows, weights, _): &(&Vec<Row>, Vec<f64>, f64)| {
            let mut total = [0.0; 5];
            rows.iter()
                .zip(weights)
                .filter(|(row, _)| side(row) == half)
                .for_each(|(row, weight)| add(&mut total, *weight, &products(row)));
            total
        };
        let fitted = [sums(&ways[0]), sums(&ways[1])];
        let centred = |[n, change, events, squares, products]: Sums| {
            (products - change * events / n, squares - change * change / n)
        };
        let (up, down) = (centred(fitted[0]), centred(fitted[1]));
        let factor = (ways[0].2 * up.0 + ways[1].2 * down.0)
            / (ways[0].2 * ways[0].2 * up.1 + ways[1].2 * ways[1].2 * down.1);
        let slopes = [
            [ways[0].2, ways[1].2],
            [factor * ways[0].2, factor * ways[1].2],
            [up.0 / up.1, down.0 / down.1],
        ];
        for (found, slopes) in found.iter_mut().zip(slopes) {
            for ((rows, weights, _), (slope, [n, change, events, ..])) in
                ways.iter().zip(slopes.into_iter().zip(fitted))
            {
                let none = (events - slope * change) / n;
                let square =
                    |row: &Row| (row.net - none - slope * row.change) * (row.net - none - slope * row.change);
                let of = |which: usize| {
                    let chosen = rows.iter().zip(weights).filter(move |(row, _)| side(row) == which);
                    chosen.fold((0.0, 0.0), |(count, sum), (row, weight)| {
                        (count + weight, sum + weight * square(row))
                    })
                };
                let variance = (of(half).1 / n).max(1e-12);
                let (count, left) = of(1 - half);
                *found -= 0.5 * (count * libm::log(variance) + left / variance);
            }
        }
    }
    let [stated, scaled, free] = found;
    (stated.is_finite() && scaled.is_finite() && free.is_finite()).then_some(StepGains {
        scale: scaled - stated,
        apart: free - scaled,
        measured: up.len() + down.len(),
    })
}
