//! Events as rows of the joint problem.

use super::super::picture::motion::{DEGREES, apply, derivatives, map_of};
use super::super::picture::spline::{ORDER, weights};
use super::fields::GridFields;
use super::lines::{SparseDerivatives, SparseRows};
use crate::case::Case;
use crate::free::{PixelPrediction, rise};
use crate::picture::ScenePicture;
use rayon::prelude::*;

/// Gauss-Laguerre instants of the front end's memory, in time constants before, and their shares.
const LAGS: [(f64, f64); 3] = [
    (0.415_774_556_783_479, 0.711_093_009_929_173),
    (2.294_280_360_279_042, 0.278_517_733_569_241),
    (6.289_945_082_937_479, 0.010_389_256_501_586),
];

/// An event's rise is the difference of the voltage over this long before it, ns, or half of the time since
/// its reference where that is shorter.
const RISE_NS: i64 = 100_000;

/// Events as rows, in order of pixel and time.
pub(super) struct OfEvents {
    /// Of their excesses.
    pub lines: SparseRows,
    /// Of the logarithms of how fast the voltage rises when they fire.
    pub rises: SparseRows,
    /// Place of the pixel, number among its predicted events, and whether both places that the event compares
    /// are on the picture and near each other.
    pub of: Vec<(u32, u32, bool)>,
}

impl OfEvents {
    fn empty() -> OfEvents {
        OfEvents { lines: SparseRows::new(), rises: SparseRows::new(), of: Vec::new() }
    }
}

/// Rows of all predicted events: derivatives of the voltage's change from reference to event. The voltage is
/// log light with the front end's lag, its time constant that of the light when it is read.
pub(super) fn lines(
    case: &Case,
    picture: &ScenePicture,
    (pixels, predicted): (&[u32], &[PixelPrediction]),
    reach: usize,
) -> OfEvents {
    let parts: Vec<OfEvents> = predicted
        .par_chunks(64)
        .enumerate()
        .map(|(chunk, of)| {
            let mut part = OfEvents::empty();
            let mut at =
                [SparseDerivatives::default(), SparseDerivatives::default(), SparseDerivatives::default()];
            for (n, predicted) in of.iter().enumerate() {
                let place = chunk * 64 + n;
                let pixel = pixels[place] as usize;
                for (k, event) in predicted.events.iter().enumerate() {
                    let before_ns = RISE_NS.min((event.t_ns - event.reference_ns) / 2).max(1);
                    let is_whole = [event.t_ns, event.reference_ns, event.t_ns - before_ns]
                        .into_iter()
                        .zip(&mut at)
                        .all(|(t_ns, at)| voltage(case, picture, predicted, (pixel, t_ns), at));
                    let [now, reference, before] = &at;
                    let is_near = is_whole && is_within(&at, &GridFields::from_picture(picture), reach + 4);
                    let by = event.polarity / (1e-9 * before_ns as f64 * rise(event));
                    part.lines.push_difference((now, reference), 1.0, is_near);
                    part.rises.push_difference((now, before), by, is_near);
                    part.of.push((place as u32, k as u32, is_near));
                }
            }
            part
        })
        .collect();
    let mut all = OfEvents::empty();
    for part in parts {
        all.lines.extend(&part.lines);
        all.rises.extend(&part.rises);
        all.of.extend(part.of);
    }
    all
}

/// Do coefficients lie within `most` of each other along both axes?
fn is_within(of: &[SparseDerivatives], fields: &GridFields, most: usize) -> bool {
    let (mut low, mut high) = ((usize::MAX, usize::MAX), (0, 0));
    for (at, _) in of.iter().flat_map(|of| &of.of_picture) {
        let k = *at as usize / fields.count;
        let (x, y) = (k % fields.grid.width, k / fields.grid.width);
        low = (low.0.min(x), low.1.min(y));
        high = (high.0.max(x), high.1.max(y));
    }
    high.0 - low.0.min(high.0) <= most && high.1 - low.1.min(high.1) <= most
}

/// Derivatives of a pixel's voltage at an instant; `false` outside of the picture.
fn voltage(
    case: &Case,
    picture: &ScenePicture,
    predicted: &PixelPrediction,
    (pixel, t_ns): (usize, i64),
    derived: &mut SparseDerivatives,
) -> bool {
    let SparseDerivatives { of_picture, of_rest } = derived;
    of_picture.clear();
    of_rest.clear();
    let (x, y) = case.pixel_place(pixel);
    let place = (f64::from(x) - picture.centre.0, f64::from(y) - picture.centre.1);
    let shade = picture.shade(place);
    let fields = GridFields::from_picture(picture);
    let behind = picture.still_ground(pixel);
    if behind.is_some_and(|behind| !behind.ground.is_finite()) {
        return false;
    }
    let by_field = [Some(1.0), behind.map(|behind| behind.by_hidden())];
    let light = |t_ns: i64| {
        let at = apply(&picture.motion.at(t_ns), place.0, place.1);
        picture.value(behind, at).map(|value| f64::max(value * shade, picture.least))
    };
    let Some(now) = light(t_ns) else { return false };
    let tau_ns = 1e9 * (predicted.low_pass.tau_0_s + predicted.low_pass.alpha_s / now);
    for (lag, share) in LAGS {
        let at_ns = (t_ns - (lag * tau_ns) as i64).max(case.span.0);
        let (knot, of_knots) = picture.motion.weights(at_ns);
        let pose = picture.motion.pose(at_ns);
        let map = map_of(&pose, picture.motion.half);
        let (px, py) = apply(&map, place.0, place.1);
        let Some((i, j, f, g)) = picture.grid.locate(px, py) else { return false };
        let (wx, wy) = (weights(f), weights(g));
        let value = picture.value(behind, (px, py)).unwrap_or(0.0);
        let by = share / f64::max(value, picture.least / shade);
        for (row, wy) in wy.iter().enumerate() {
            for (column, wx) in wx.iter().enumerate() {
                let k = (j + row) * picture.grid.width + i + column;
                for (field, of_field) in by_field.into_iter().flatten().enumerate() {
                    of_picture.push((fields.unknown(field, k) as u32, (of_field * by * wx * wy) as f32));
                }
            }
        }
        let (gx, gy) = picture.gradient(behind, (px, py));
        let of_pose = derivatives(&map, &pose, picture.motion.half, place.0, place.1);
        for (n, weight) in of_knots.iter().enumerate().take(ORDER) {
            for (d, (dx, dy)) in of_pose.iter().enumerate() {
                let change = by * weight * (gx * dx + gy * dy);
                of_rest.push((((knot + n) * DEGREES + d) as u16, change as f32));
            }
        }
    }
    derived.sum();
    true
}

#[cfg(test)]
mod tests {
    use super::super::super::picture::spline::SplineGrid;
    use super::*;

    #[test]
    fn every_place_of_an_event_has_to_be_within_reach() {
        let grid = SplineGrid { x0: 0.0, y0: 0.0, pitch: 1.0, width: 16, height: 12 };
        // Before a still ground two fields share each place.
        let fields = GridFields { grid, count: 2 };
        let at = |x: usize, y: usize| SparseDerivatives {
            of_picture: vec![(fields.unknown(1, y * fields.grid.width + x) as u32, 1.0)],
            of_rest: Vec::new(),
        };
        let is_near = |of: &[SparseDerivatives]| is_within(of, &fields, 4);
        assert!(is_near(&[at(3, 3), at(7, 3), at(3, 7)]));
        // Any of the three too far along any axis.
        for n in 0..3 {
            for far in [at(8, 3), at(3, 8)] {
                let mut of = [at(3, 3), at(3, 3), at(3, 3)];
                of[n] = far;
                assert!(!is_near(&of), "{n}");
            }
        }
    }
}
