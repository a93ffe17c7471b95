//! Variance factors of pseudo-measurements for each region of the sensor, selected by held-out frames.
//!
//! Pixels spread over the sensor are solved without some of their frames, with several variance factors, and
//! predict those frames. A region gets the factor that fits the pixels near it best. Far ones have a small
//! weight, so that a few lucky predictions do not decide.

use super::pseudo_measurement::PseudoMeasurementParams;
use photocurrent_core::Extent;
use photocurrent_sensor::map::Hint;

/// The variance factors that are tried, largest first; infinity removes all pseudo-measurements.
pub(super) const VARIANCE_FACTORS: [f64; 6] = [f64::INFINITY, 16.0, 4.0, 1.0, 0.25, 0.0625];
/// Side of the squares that share a factor, pixels.
const SQUARE: u32 = 4;

/// Multiplies the variances of pseudo-measurements by a factor; infinity removes them all. A factor below 1
/// does not narrow the posterior.
pub(super) fn scale_variances(hints: &mut Vec<Hint>, factor: f64) {
    if factor.is_infinite() {
        hints.clear();
    }
    for hint in hints.iter_mut() {
        hint.variance *= factor;
        hint.for_sigma *= f64::max(factor, 1.0);
    }
}

/// Errors of a pixel with each of [`VARIANCE_FACTORS`].
#[derive(Clone, Copy, Debug)]
pub(super) struct FactorLosses {
    pub x: usize,
    pub y: usize,
    pub errors: [f64; VARIANCE_FACTORS.len()],
}

/// One of [`VARIANCE_FACTORS`] for each square of pixels.
#[derive(Clone, Debug)]
pub(super) struct VarianceFactors {
    columns: usize,
    of_square: Vec<f64>,
}

impl VarianceFactors {
    /// Selects factors by the errors of pixels spread over the sensor.
    pub(crate) fn choose(
        extent: Extent,
        lost: &[FactorLosses],
        params: &PseudoMeasurementParams,
    ) -> VarianceFactors {
        let PseudoMeasurementParams { clear_gain, near_pixels: near, mean_weight: everywhere, .. } = *params;
        let mean =
            |n: usize| lost.iter().map(|lost| lost.errors[n]).sum::<f64>() / usize::max(lost.len(), 1) as f64;
        let means: [f64; VARIANCE_FACTORS.len()] = std::array::from_fn(mean);
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
            let best = (1..VARIANCE_FACTORS.len()).fold(0, |best, n| {
                let by = if VARIANCE_FACTORS[best].is_infinite() { 1.0 - clear_gain } else { 1.0 };
                if totals[n] < by * totals[best] { n } else { best }
            });
            VARIANCE_FACTORS[best]
        };
        let of_square = (0..lines)
            .flat_map(|line| (0..columns).map(move |column| (column, line)))
            .map(|(column, line)| of_square(column, line))
            .collect();
        VarianceFactors { columns: columns as usize, of_square }
    }

    /// The factor of a pixel; infinity: no pseudo-measurements.
    pub(crate) fn at(&self, x: usize, y: usize) -> f64 {
        self.of_square[(y / SQUARE as usize) * self.columns + x / SQUARE as usize]
    }

    /// Does any pixel get pseudo-measurements?
    pub(crate) fn uses_some(&self) -> bool {
        self.of_square.iter().any(|factor| factor.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXTENT: Extent = Extent { width: 60, height: 20 };

    /// Left of column 30 pseudo-measurements reduce an error of 1 by `left`, right of it by `right`; more
    /// with smaller variances.
    fn halves(left: f64, right: f64) -> Vec<FactorLosses> {
        let lost = |x: usize, y: usize| {
            let gain = if x < 30 { left } else { right };
            FactorLosses { x, y, errors: std::array::from_fn(|n| 1.0 - gain * n as f64 / 5.0) }
        };
        (0..20).step_by(3).flat_map(|y| (0..60).step_by(3).map(move |x| lost(x, y))).collect()
    }

    #[test]
    fn each_region_takes_what_serves_it() {
        let factor = VarianceFactors::choose(EXTENT, &halves(0.5, -0.5), &PseudoMeasurementParams::default());
        assert_eq!(factor.at(5, 10), VARIANCE_FACTORS[5]);
        assert_eq!(factor.at(55, 10), VARIANCE_FACTORS[0]);
        assert!(factor.uses_some());
    }

    #[test]
    fn pseudo_measurements_without_gain_are_removed() {
        assert!(
            !VarianceFactors::choose(EXTENT, &halves(-0.1, 0.0), &PseudoMeasurementParams::default())
                .uses_some()
        );
        assert!(!VarianceFactors::choose(EXTENT, &[], &PseudoMeasurementParams::default()).uses_some());
    }

    #[test]
    fn one_lucky_pixel_chooses_nothing() {
        let mut lost = halves(-0.3, -0.3);
        lost[30].errors = [1.0, 1.0, 0.9, 0.8, 0.7, 0.6];
        assert!(!VarianceFactors::choose(EXTENT, &lost, &PseudoMeasurementParams::default()).uses_some());
    }
}
