//! Covariates of events: their values, and bins of these.

use super::EventResiduals;
use crate::covariates::{Covariate, CovariateSource};
use crate::rhythm::ResidualRhythm;

/// Values of a covariate at every event and at the event before it; NaN where it has none.
#[derive(Clone, Debug)]
pub(crate) struct CovariateColumns {
    /// The covariate.
    pub covariate: Covariate,
    /// Of a rhythm, its period, ns.
    pub period_ns: Option<i64>,
    /// At every event.
    pub(super) at: Vec<f64>,
    /// And at the one before it.
    pub(super) before: Vec<f64>,
}

/// Computes every covariate of the events; of a rhythm its phase.
pub(super) fn covariate_columns(
    events: &EventResiduals,
    surroundings: &mut CovariateSource<'_>,
    rhythm: Option<ResidualRhythm>,
) -> Vec<CovariateColumns> {
    let period_ns = rhythm.map(|rhythm| rhythm.period_ns);
    let is_at_reset = |covariate| covariate == Covariate::AcPhase && rhythm.is_some_and(|of| of.is_at_reset);
    surroundings.set_period(period_ns);
    Covariate::ALL
        .into_iter()
        .filter(|covariate| *covariate != Covariate::AcPhase || period_ns.is_some())
        .map(|covariate| {
            let value = |k: usize, t_ns: i64, polarity: i8| {
                surroundings.value(covariate, events.pixel[k] as usize, t_ns, polarity).unwrap_or(f64::NAN)
            };
            let before: Vec<f64> = (0..events.t_ns.len())
                .map(|k| value(k, events.t_ns[k] - events.since_ns[k], events.previous[k]))
                .collect();
            let at = match is_at_reset(covariate) {
                true => before.clone(),
                false => (0..before.len()).map(|k| value(k, events.t_ns[k], events.polarity[k])).collect(),
            };
            CovariateColumns {
                covariate,
                period_ns: period_ns.filter(|_| covariate == Covariate::AcPhase),
                at,
                before,
            }
        })
        .collect()
}

/// Values sorted into bins.
pub(super) struct CovariateBins {
    edges: Vec<f64>,
    /// Mean value of each bin.
    pub at: Vec<f64>,
    /// The bin of each value; `None` for values that are not finite.
    pub of: Vec<Option<u32>>,
    pub is_class: bool,
}

impl CovariateBins {
    /// At most `most` bins with about equal numbers of values, at least `least` each. Class values have bins
    /// of their own.
    pub(super) fn new(values: &[f64], most: usize, least: usize, is_class: bool) -> CovariateBins {
        let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let count = most.min(sorted.len() / least.max(1));
        let mut edges: Vec<f64> = if is_class {
            let mut classes = sorted.clone();
            classes.dedup();
            classes.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect()
        } else {
            (1..count).map(|bin| sorted[bin * sorted.len() / count]).collect()
        };
        edges.dedup();
        // A bin below the first value is none.
        edges.retain(|edge| sorted.first().is_some_and(|first| edge > first));
        CovariateBins::from_edges(values, edges, is_class)
    }

    /// From the first values of all bins but the lowest, rising.
    pub(super) fn from_edges(values: &[f64], edges: Vec<f64>, is_class: bool) -> CovariateBins {
        let mut bins = CovariateBins { edges, at: Vec::new(), of: Vec::new(), is_class };
        bins.of = values.iter().map(|value| bins.bin(*value)).collect();
        let mut sums = vec![(0.0, 0.0); bins.edges.len() + 1];
        for (bin, value) in bins.of.iter().zip(values).filter_map(|(bin, value)| Some(((*bin)?, value))) {
            let sum = &mut sums[bin as usize];
            *sum = (sum.0 + value, sum.1 + 1.0);
        }
        bins.at = sums.iter().map(|(sum, count)| sum / f64::max(*count, 1.0)).collect();
        bins
    }

    /// The bin of a value; `None` where it is not finite.
    pub(super) fn bin(&self, value: f64) -> Option<u32> {
        value.is_finite().then(|| self.edges.partition_point(|edge| *edge <= value) as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::super::ranking::rhythm_of;
    use super::*;
    use crate::testing;
    use core::f64::consts::TAU;
    use photocurrent_core::random::Random;

    #[test]
    fn a_rhythm_is_laid_over_the_resets_where_thresholds_follow_it_there() {
        // 270 Hz, 25 frames 8 ms apart; intervals of 1 to 12 ms.
        let (case, period_ns) = (testing::case_of(25, &Default::default()), 3.7e6);
        for is_at_reset in [false, true] {
            let mut random = Random::new(2, &[]);
            let mut events = EventResiduals::default();
            for _ in 0..3000 {
                let t_ns = 12_000_000 + (random.uniform() * 180e6) as i64;
                let since_ns = (1e6 + random.uniform() * 11e6) as i64;
                let polarity = if random.uniform() < 0.5 { 1 } else { -1 };
                let at = if is_at_reset { t_ns - since_ns } else { t_ns };
                events.pixel.push(0);
                events.t_ns.push(t_ns);
                events.since_ns.push(since_ns);
                events.polarity.push(polarity);
                events.previous.push(polarity);
                let swing = 0.02 * libm::sin(TAU * at as f64 / period_ns);
                events.excess.push(f64::from(polarity) * swing + 0.02 * random.normal());
            }
            let rhythm = rhythm_of(&case, &events, &events.excess).expect("a rhythm");
            assert_eq!(rhythm.is_at_reset, is_at_reset);
            assert!((rhythm.period_ns as f64 / period_ns - 1.0).abs() < 0.01, "{rhythm:?}");
            let light = Box::new(|_: usize, _: i64| None);
            let mut surroundings =
                CovariateSource::from_light(&case, light, case.extent.pixels(), (0.0, 0.0));
            let laid = covariate_columns(&events, &mut surroundings, Some(rhythm));
            let phase = laid.iter().find(|one| one.covariate == Covariate::AcPhase).expect("its phase");
            assert!(phase.at.iter().all(|at| (0.0..1.0).contains(at)));
            assert_eq!(phase.at == phase.before, is_at_reset);
        }
    }
}
