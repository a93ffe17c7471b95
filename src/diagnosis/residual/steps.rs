//! Estimates the rows or columns at which a size changes in steps: the division with the largest penalised
//! gain.

use super::fit::EffectColumn;
use super::setting::ERRORS;
use photocurrent_scene::statistics::{MEDIAN_T, NU, median};

/// Bins between steps at most: each is a number to be estimated with the scene.
const MOST: usize = 12;

/// A division into bins.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct BinDivision {
    /// First value of each bin but the lowest; empty where no step gains more than its penalty.
    pub first: Vec<f64>,
    /// Penalty of the steps, nats per event.
    pub cost: f64,
}

/// Sums of the values up to each one: score, information, events.
#[derive(Clone, Copy, Default)]
struct PrefixSums {
    score: f64,
    information: f64,
    events: usize,
}

/// The division of a covariate's values into bins, each with its own size of `column` and at least `least`
/// events, that has the largest penalised gain: log-likelihood of weighted residuals, less half the log of
/// the number of events and the log of the number of values per step (Schwarz's criterion and the choice of
/// the place), times the squared ratio of standard errors. By dynamic programming over values and numbers of
/// bins.
///
/// `at`: value of each event, NaN where it has none; `residual`: natural-log units.
pub(super) fn steps(at: &[f64], residual: &[f64], column: &EffectColumn, least: usize) -> BinDivision {
    let mut values: Vec<f64> = at.iter().copied().filter(|value| value.is_finite()).collect();
    let events = values.len();
    values.sort_by(f64::total_cmp);
    values.dedup();
    let sums = prefix_sums(&values, at, residual, column);
    let gain = |from: usize, to: usize| -> Option<f64> {
        let (a, b) = (sums[from], sums[to]);
        let (score, information) = (b.score - a.score, b.information - a.information);
        let of = 0.5 * score * score / f64::max(information, f64::MIN_POSITIVE);
        (b.events - a.events >= least).then_some(of)
    };
    let count = values.len();
    let price = ERRORS * ERRORS * (0.5 * libm::log(events.max(1) as f64) + libm::log(count.max(1) as f64));
    // Of so many bins, up to each value: the gain, and where the last bin begins.
    let mut best: Vec<Vec<Option<(f64, usize)>>> =
        vec![(0..=count).map(|to| Some((gain(0, to)?, 0))).collect()];
    for bins in 1..MOST {
        let before = &best[bins - 1];
        let one = |to: usize| -> Option<(f64, usize)> {
            let with = |from: usize| Some((before[from]?.0 + gain(from, to)? - price, from));
            (1..to).filter_map(with).max_by(|a, b| a.0.total_cmp(&b.0))
        };
        let next = (0..=count).map(one).collect();
        best.push(next);
    }
    let total = |bins: usize| best[bins][count].map_or(f64::NEG_INFINITY, |(gain, _)| gain);
    let Some(bins) = (0..MOST).max_by(|a, b| total(*a).total_cmp(&total(*b)).then(b.cmp(a))) else {
        return BinDivision::default();
    };
    let (mut first, mut to) = (Vec::new(), count);
    for of in (1..=bins).rev() {
        let Some((_, from)) = best[of][to] else { return BinDivision::default() };
        first.push(values[from]);
        to = from;
    }
    first.reverse();
    BinDivision { cost: price * first.len() as f64 / events.max(1) as f64, first }
}

/// Weights are those of Student's distribution with the scale of all residuals.
fn prefix_sums(values: &[f64], at: &[f64], residual: &[f64], column: &EffectColumn) -> Vec<PrefixSums> {
    let mut sizes: Vec<f64> = residual.iter().map(|residual| residual.abs()).collect();
    let scale = f64::max(median(&mut sizes) / MEDIAN_T, f64::MIN_POSITIVE);
    let mut sums = vec![PrefixSums::default(); values.len() + 1];
    for ((at, residual), by) in at.iter().zip(residual).zip(&column.of).filter(|((at, _), _)| at.is_finite())
    {
        let z = residual / scale;
        let weight = (NU + 1.0) / (NU + z * z) / (scale * scale);
        let (by, sum) = (f64::from(*by), &mut sums[values.partition_point(|value| value < at) + 1]);
        sum.score += weight * by * residual;
        sum.information += weight * by * by;
        sum.events += 1;
    }
    for k in 1..sums.len() {
        let before = sums[k - 1];
        sums[k].score += before.score;
        sums[k].information += before.information;
        sums[k].events += before.events;
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::random::Random;

    #[test]
    fn a_band_is_cut_out_between_its_rows_and_noise_is_not_cut() {
        let mut random = Random::new(3, &[]);
        let at: Vec<f64> = (0..8_000).map(|_| (random.uniform() * 72.0).floor()).collect();
        let column = EffectColumn { of: vec![-0.2; at.len()], log_slope: Vec::new() };
        let noise: Vec<f64> = at.iter().map(|_| 0.01 * random.normal()).collect();
        assert_eq!(steps(&at, &noise, &column, 60).first, Vec::<f64>::new());
        let is_in = |row: f64| f64::from(u8::from((24.0..36.0).contains(&row)));
        let banded: Vec<f64> = at.iter().zip(&noise).map(|(row, noise)| noise + 0.02 * is_in(*row)).collect();
        assert_eq!(steps(&at, &banded, &column, 60).first, [24.0, 36.0]);
        // Without events there is nothing to cut.
        assert_eq!(steps(&[], &[], &EffectColumn::default(), 60), BinDivision::default());
    }
}
