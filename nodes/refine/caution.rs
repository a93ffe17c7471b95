//! How careful to be with hints, for each region of the sensor: what predicts frames that were held out best.
//!
//! Pixels spread over the sensor are solved without some of their frames, with hints trusted more or less,
//! and asked for those frames. A region takes the caution that served the pixels near it best; far ones count
//! a little, so that a few lucky hits choose nothing.

use super::trust::TrustParams;
use photocurrent_core::Extent;
use photocurrent_sensor::map::Hint;

/// The factors of the hints' variances that are tried, most careful first.
pub(super) const CAUTIONS: [f64; 6] = [f64::INFINITY, 16.0, 4.0, 1.0, 0.25, 0.0625];
/// Side of the squares that share a caution, pixels.
const SQUARE: u32 = 4;

/// Trusts pseudo-measurements less by a factor of their variances; infinity removes them all. A factor below
/// 1 makes them no more exact than they say.
pub(super) fn take_care(hints: &mut Vec<Hint>, caution: f64) {
    if caution.is_infinite() {
        hints.clear();
    }
    for hint in hints.iter_mut() {
        hint.variance *= caution;
        hint.for_sigma *= f64::max(caution, 1.0);
    }
}

/// What a pixel lost with each of [`CAUTIONS`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Lost {
    pub x: usize,
    pub y: usize,
    pub errors: [f64; CAUTIONS.len()],
}

/// One of [`CAUTIONS`] for each square of pixels.
#[derive(Clone, Debug)]
pub(super) struct Caution {
    columns: usize,
    of_square: Vec<f64>,
}

impl Caution {
    /// Of what pixels lost that are spread over the sensor.
    pub(crate) fn choose(extent: Extent, lost: &[Lost], params: &TrustParams) -> Caution {
        let TrustParams { clear_gain, near, everywhere, .. } = *params;
        let mean =
            |n: usize| lost.iter().map(|lost| lost.errors[n]).sum::<f64>() / usize::max(lost.len(), 1) as f64;
        let means: [f64; CAUTIONS.len()] = std::array::from_fn(mean);
        let (columns, lines) = (extent.width.div_ceil(SQUARE), extent.height.div_ceil(SQUARE));
        let of_square = |column: u32, line: u32| {
            let middle = |n: u32| f64::from(n * SQUARE) + 0.5 * f64::from(SQUARE - 1);
            let mut totals = means.map(|mean| everywhere * mean);
            for lost in lost {
                let (dx, dy) = (lost.x as f64 - middle(column), lost.y as f64 - middle(line));
                let apart = (dx * dx + dy * dy) / (near * near);
                let weight = 1.0 / (1.0 + apart * apart);
                totals.iter_mut().zip(lost.errors).for_each(|(total, error)| *total += weight * error);
            }
            let best = (1..CAUTIONS.len()).fold(0, |best, n| {
                let by = if CAUTIONS[best].is_infinite() { 1.0 - clear_gain } else { 1.0 };
                if totals[n] < by * totals[best] { n } else { best }
            });
            CAUTIONS[best]
        };
        let of_square = (0..lines)
            .flat_map(|line| (0..columns).map(move |column| (column, line)))
            .map(|(column, line)| of_square(column, line))
            .collect();
        Caution { columns: columns as usize, of_square }
    }

    /// The caution of a pixel; infinity stands for no hints at all.
    pub(crate) fn at(&self, x: usize, y: usize) -> f64 {
        self.of_square[(y / SQUARE as usize) * self.columns + x / SQUARE as usize]
    }

    /// Is any pixel given hints?
    pub(crate) fn trusts_some(&self) -> bool {
        self.of_square.iter().any(|caution| caution.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXTENT: Extent = Extent { width: 60, height: 20 };

    /// Left of column 30 hints help by `left` of an error of 1, right of it by `right`; more the more they
    /// are trusted.
    fn halves(left: f64, right: f64) -> Vec<Lost> {
        let lost = |x: usize, y: usize| {
            let gain = if x < 30 { left } else { right };
            Lost { x, y, errors: std::array::from_fn(|n| 1.0 - gain * n as f64 / 5.0) }
        };
        (0..20).step_by(3).flat_map(|y| (0..60).step_by(3).map(move |x| lost(x, y))).collect()
    }

    #[test]
    fn each_region_takes_what_serves_it() {
        let caution = Caution::choose(EXTENT, &halves(0.5, -0.5), &TrustParams::default());
        assert_eq!(caution.at(5, 10), CAUTIONS[5]);
        assert_eq!(caution.at(55, 10), CAUTIONS[0]);
        assert!(caution.trusts_some());
    }

    #[test]
    fn nothing_is_trusted_that_helps_nowhere() {
        assert!(!Caution::choose(EXTENT, &halves(-0.1, 0.0), &TrustParams::default()).trusts_some());
        assert!(!Caution::choose(EXTENT, &[], &TrustParams::default()).trusts_some());
    }

    #[test]
    fn one_lucky_pixel_chooses_nothing() {
        let mut lost = halves(-0.3, -0.3);
        lost[30].errors = [1.0, 1.0, 0.9, 0.8, 0.7, 0.6];
        assert!(!Caution::choose(EXTENT, &lost, &TrustParams::default()).trusts_some());
    }
}
