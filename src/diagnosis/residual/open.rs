//! Uncatalogued dependences: threshold, stamp delay, or rate without light, free in every bin of a covariate.
//!
//! With small residuals this is a regression. Each bin has a size of its own, evaluated on held-out blocks.
//! The gain of one common size is subtracted, as that is an effect of the catalogue.

use super::EventResiduals;
use super::fit::{self, EffectColumn, FittedColumns, NullFit, ResidualRows, ResidualsAndSlopes, heldout};
use super::laid::{CovariateBins, CovariateColumns};
use super::located::LocatedEffect;
use super::steps::steps;
use crate::covariates::Covariate;
use crate::dependence::{AffectedQuantity, Dependence};
use serde::{Deserialize, Serialize};

/// Bins of a covariate that is a number on a scale.
const BINS: usize = 6;
/// Of the place on the array and of the time, where what is confined to a part has steps.
const BINS_OF_PLACE: usize = 12;
/// And of the phase of a rhythm or of frames, whose curves turn.
const BINS_OF_PHASE: usize = 8;
/// Fewer events in a bin have no size of their own.
pub(super) const LEAST_IN_BIN: usize = 60;

/// A curve over a covariate, with its held-out gain beyond one size for all, nats an event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CovariateCurve {
    /// The curve.
    pub dependence: Dependence,
    /// Mean over all events of their bins' sizes: the common part, in the unit of the curve.
    #[serde(default)]
    pub mean: f64,
    /// Gain beyond one size for all bins, nats an event.
    pub gain: f64,
    /// Its standard error by blocks.
    pub gain_error: f64,
    /// The same of the control.
    pub control_gain: f64,
    /// Where it is; of the best one alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub located: Option<LocatedEffect>,
}

impl CovariateCurve {
    /// Held-out gain beyond the control's, nats an event.
    pub fn gain_beyond_control(&self) -> f64 {
        self.gain - self.control_gain.max(0.0)
    }
}

/// Subtracts the control's gains, and sorts again, best first.
pub(crate) fn subtract_control_gains(found: &mut [CovariateCurve], control: &[CovariateCurve]) {
    for one in found.iter_mut() {
        let same = |other: &&CovariateCurve| {
            (other.dependence.covariate, other.dependence.moved)
                == (one.dependence.covariate, one.dependence.moved)
        };
        one.control_gain = control.iter().find(same).map_or(0.0, |other| other.gain);
    }
    found.sort_by(|a, b| b.gain_beyond_control().total_cmp(&a.gain_beyond_control()));
}

/// Covariates that are left out: polarity, which has effects of the catalogue, and lag, which is slope and
/// light.
const LEFT_OUT: [Covariate; 2] = [Covariate::Polarity, Covariate::Lag];

/// May something depend on it that no effect has?
pub(super) fn is_sought(covariate: Covariate) -> bool {
    !LEFT_OUT.contains(&covariate)
}

/// Every covariate with everything that may be moved, best first.
///
/// `residual`: natural-log units, by event; `block`: of each event; `threshold`: mean one, natural-log units;
/// `least`: least noise.
pub(crate) fn dependences(
    events: &EventResiduals,
    residual: &[f64],
    block: &[u32],
    laid: &[CovariateColumns],
    threshold: f64,
    least: f64,
) -> Vec<CovariateCurve> {
    let mut found: Vec<CovariateCurve> = laid
        .iter()
        .filter(|laid| is_sought(laid.covariate))
        .flat_map(|laid| {
            [AffectedQuantity::Threshold, AffectedQuantity::Stamps, AffectedQuantity::Rate]
                .into_iter()
                .map(move |moved| (laid, moved))
        })
        .filter_map(|of| dependence(events, residual, block, of, (threshold, least)))
        .collect();
    found.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    found
}

/// The column of a change by `here` at each event and `before` at the event before it.
pub(super) fn moving(
    events: &EventResiduals,
    moved: AffectedQuantity,
    threshold: f64,
    here: impl Fn(usize) -> f64,
    before: impl Fn(usize) -> f64,
) -> EffectColumn {
    let change = |k: usize| match moved {
        AffectedQuantity::Threshold | AffectedQuantity::EventRate => {
            here(k) * f64::from(events.polarity[k]) * threshold
        }
        AffectedQuantity::Stamps => {
            here(k) * events.slope_per_s[k] - before(k) * events.slope_before_per_s[k]
        }
        AffectedQuantity::Rate => -here(k) * threshold * events.since_ns[k] as f64 * 1e-9,
    };
    let of = (0..events.polarity.len()).map(|k| -change(k) as f32).collect();
    EffectColumn { of, log_slope: Vec::new() }
}

/// Columns of each bin of a covariate, and of all bins together.
pub(super) struct BinColumns {
    pub(super) bins: CovariateBins,
    pub(super) columns: Vec<EffectColumn>,
    whole: EffectColumn,
}

impl BinColumns {
    /// From the bins of a measured curve and its factors.
    fn from_dependence(
        events: &EventResiduals,
        laid: &[CovariateColumns],
        found: &Dependence,
        threshold: f64,
    ) -> Option<BinColumns> {
        let factors = SecondCurveFactors::from_curve(laid, found);
        let laid = laid.iter().find(|laid| laid.covariate == found.covariate)?;
        let bins = match found.steps.is_empty() {
            true => bins(laid),
            false => CovariateBins::from_edges(&laid.at, found.steps.clone(), false),
        };
        let between = |bins| BinColumns::from_bins((events, threshold), laid, found.moved, bins, &factors);
        (bins.at.len() >= 2).then(|| between(bins))
    }

    /// With about as many events in each bin; none where there is one bin.
    pub(super) fn new(
        events: &EventResiduals,
        laid: &CovariateColumns,
        moved: AffectedQuantity,
        threshold: f64,
    ) -> Option<BinColumns> {
        let bins = bins(laid);
        let between = |bins| {
            BinColumns::from_bins((events, threshold), laid, moved, bins, &SecondCurveFactors::default())
        };
        (bins.at.len() >= 2).then(|| between(bins))
    }

    /// Mean over all events of their bins' values.
    pub(super) fn mean_over_events(&self, value: &[f64]) -> f64 {
        let of: Vec<f64> = self.bins.of.iter().flatten().map(|bin| value[*bin as usize]).collect();
        of.iter().sum::<f64>() / f64::max(of.len() as f64, 1.0)
    }

    /// Events without a value keep what they have.
    fn from_bins(
        (events, threshold): (&EventResiduals, f64),
        laid: &CovariateColumns,
        moved: AffectedQuantity,
        bins: CovariateBins,
        factors: &SecondCurveFactors,
    ) -> BinColumns {
        let of = &bins.of;
        let of_before: Vec<Option<u32>> = laid.before.iter().map(|value| bins.bin(*value)).collect();
        let column = |bin: Option<u32>| -> EffectColumn {
            let is_in = |at: Option<u32>| at.is_some_and(|at| bin.is_none_or(|bin| at == bin));
            let one = |is: bool, factor: f64| if is { factor } else { 0.0 };
            let here = |k: usize| one(is_in(of[k]), factors.at(k));
            moving(events, moved, threshold, here, |k| {
                one(is_in(of_before[k]), factors.factor_at_previous_event(k))
            })
        };
        let columns = (0..bins.at.len() as u32).map(|bin| column(Some(bin))).collect();
        let whole = column(None);
        BinColumns { bins, columns, whole }
    }
}

/// Bins of a covariate.
pub(super) fn bins(laid: &CovariateColumns) -> CovariateBins {
    let most = match laid.covariate {
        Covariate::AcPhase | Covariate::FramePhase => BINS_OF_PHASE,
        Covariate::Row | Covariate::Column | Covariate::Radius | Covariate::Time => BINS_OF_PLACE,
        _ => BINS,
    };
    CovariateBins::new(&laid.at, most, LEAST_IN_BIN, laid.covariate.is_class())
}

/// Factors by a product's second curve, at every event and at the event before; 1, and empty, for other
/// curves.
#[derive(Default)]
pub(super) struct SecondCurveFactors {
    at: Vec<f64>,
    before: Vec<f64>,
}

impl SecondCurveFactors {
    /// Of a curve.
    pub(super) fn from_curve(laid: &[CovariateColumns], curve: &Dependence) -> SecondCurveFactors {
        let Some(factor) = &curve.times else { return SecondCurveFactors::default() };
        let laid = laid.iter().find(|laid| laid.covariate == factor.covariate);
        let of = |values: &Vec<f64>| values.iter().map(|x| factor.value(*x)).collect();
        laid.map_or_else(SecondCurveFactors::default, |laid| SecondCurveFactors {
            at: of(&laid.at),
            before: of(&laid.before),
        })
    }

    /// At event `k`.
    pub(super) fn at(&self, k: usize) -> f64 {
        self.at.get(k).copied().unwrap_or(1.0)
    }

    /// At the event before it.
    pub(super) fn factor_at_previous_event(&self, k: usize) -> f64 {
        self.before.get(k).copied().unwrap_or(1.0)
    }
}

/// Residual of each event with a curve, natural-log units, and the event's gain over one common size, nats
/// (`fit::row_gains`).
pub(crate) struct CurveResiduals {
    pub residual: Vec<f64>,
    pub gains: Vec<f64>,
}

/// Residuals and gains with a curve; `None` where its covariate has no bins.
pub(crate) fn apply_curve(
    events: &EventResiduals,
    residual: &[f64],
    block: &[u32],
    laid: &[CovariateColumns],
    dependence: &Dependence,
    threshold: f64,
    least: f64,
) -> Option<CurveResiduals> {
    let free = BinColumns::from_dependence(events, laid, dependence, threshold)?;
    let rows = ResidualRows {
        slope: &events.slope_per_s,
        block,
        events: residual.len(),
        least,
        soft: None,
        free: &[],
    };
    let left = |columns: &[&EffectColumn]| -> Vec<f64> {
        let of: Vec<&[f32]> = columns.iter().map(|column| &column.of[..]).collect();
        let sizes = fit::fit(residual, &rows, &of, |_| true).0;
        (0..residual.len())
            .map(|k| {
                residual[k]
                    + of.iter().zip(&sizes).map(|(column, size)| size * f64::from(column[k])).sum::<f64>()
            })
            .collect()
    };
    let (one, all) = (left(&[&free.whole]), left(&free.columns.iter().collect::<Vec<_>>()));
    let rest = |residual| ResidualsAndSlopes { residual, log_slope: &[], rows: &rows };
    Some(CurveResiduals { gains: fit::row_gains(rest(&one), rest(&all)), residual: all })
}

/// Residuals as they are without a curve that the sensor has.
pub(super) fn restored(
    events: &EventResiduals,
    residual: &[f64],
    laid: &[CovariateColumns],
    curve: &Dependence,
    threshold: f64,
) -> Option<Vec<f64>> {
    let BinColumns { columns, .. } = BinColumns::from_dependence(events, laid, curve, threshold)?;
    let of_curve = |k: usize| {
        columns.iter().zip(&curve.value).map(|(column, value)| value * f64::from(column.of[k])).sum::<f64>()
    };
    Some(residual.iter().enumerate().map(|(k, left)| left - of_curve(k)).collect())
}

/// One covariate with one thing that may be moved.
fn dependence(
    events: &EventResiduals,
    residual: &[f64],
    block: &[u32],
    (laid, moved): (&CovariateColumns, AffectedQuantity),
    (threshold, least): (f64, f64),
) -> Option<CovariateCurve> {
    let plain = NullFit::new(
        residual,
        ResidualRows {
            slope: &events.slope_per_s,
            block,
            events: residual.len(),
            least,
            soft: None,
            free: &[],
        },
    );
    let free = BinColumns::new(events, laid, moved, threshold)?;
    let one: FittedColumns = heldout(&plain, &[&free.whole]);
    let of_bins = |free: &BinColumns| heldout(&plain, &free.columns.iter().collect::<Vec<_>>());
    let mut found = (of_bins(&free), free, Vec::new());
    let is_stepped = matches!(laid.covariate, Covariate::Row | Covariate::Column);
    if let Some(steps) = is_stepped.then(|| steps(&laid.at, residual, &found.1.whole, LEAST_IN_BIN)) {
        let bins = CovariateBins::from_edges(&laid.at, steps.first.clone(), false);
        let free =
            BinColumns::from_bins((events, threshold), laid, moved, bins, &SecondCurveFactors::default());
        let of_steps = of_bins(&free);
        if !steps.first.is_empty() && of_steps.gain - steps.cost > found.0.gain {
            found = (of_steps, free, steps.first);
        }
    }
    let (all, free, steps): (FittedColumns, BinColumns, Vec<f64>) = found;
    let gain = all.gain - one.gain.max(0.0);
    let value = &all.size;
    let mean = free.mean_over_events(value);
    let taken = 1.0 - libm::exp(-2.0 * gain.max(0.0));
    let dependence = Dependence {
        period_s: laid.period_ns.map(|period_ns| period_ns as f64 * 1e-9),
        at: free.bins.at,
        steps,
        value: value.iter().map(|value| value - mean).collect(),
        error: all.error.clone(),
        taken,
        significance: gain / f64::max(all.gain_error, 1e-9),
        nats_per_event: gain,
        ..Dependence::empty_over(laid.covariate, moved)
    };
    Some(CovariateCurve {
        dependence,
        mean,
        gain,
        gain_error: all.gain_error,
        control_gain: 0.0,
        located: None,
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use photocurrent_core::random::Random;

    /// Events of an array of 8 x 8 blocks with residuals of noise 0.01.
    pub(crate) fn events(count: usize) -> (EventResiduals, Vec<u32>, Vec<f64>) {
        let mut random = Random::new(4, &[]);
        let mut events = EventResiduals::default();
        let mut residual = Vec::new();
        for k in 0..count {
            events.pixel.push((k % 4096) as u32);
            events.t_ns.push(k as i64 * 1_000);
            events.polarity.push(if random.uniform() < 0.5 { 1 } else { -1 });
            events.previous.push(1);
            events.since_ns.push(1_000_000 + (4e6 * random.uniform()) as i64);
            events.slope_per_s.push(100.0 * random.normal());
            events.slope_before_per_s.push(100.0 * random.normal());
            residual.push(0.01 * random.normal());
        }
        let block = (0..count).map(|_| (random.uniform() * 64.0) as u32).collect();
        (events, block, residual)
    }

    pub(crate) fn laid(at: Vec<f64>, covariate: Covariate) -> CovariateColumns {
        CovariateColumns { covariate, period_ns: None, before: at.clone(), at }
    }

    #[test]
    fn a_delay_of_odd_rows_is_found_with_its_size_and_nothing_else_is() {
        let (events, block, mut residual) = events(8_000);
        let row: Vec<f64> = events.pixel.iter().map(|pixel| f64::from(pixel / 64)).collect();
        let parity: Vec<f64> = row.iter().map(|row| row % 2.0).collect();
        for k in 0..residual.len() {
            residual[k] += 2e-4 * parity[k] * (events.slope_per_s[k] - events.slope_before_per_s[k]);
        }
        let laid = [laid(parity, Covariate::RowParity), laid(row, Covariate::Row)];
        let found = dependences(&events, &residual, &block, &laid, 0.2, 1e-4);
        assert_eq!(
            (found[0].dependence.covariate, found[0].dependence.moved),
            (Covariate::RowParity, AffectedQuantity::Stamps)
        );
        assert!(
            (found[0].dependence.value[1] - found[0].dependence.value[0] - 2e-4).abs() < 5e-6,
            "{:?}",
            found[0].dependence.value
        );
        assert!(found[1].gain < 0.2 * found[0].gain, "{:?}", found[1]);
    }

    #[test]
    fn a_leak_of_on_events_in_odd_rows_is_positive() {
        // A reference that falls by c thresholds a second: an event of either sign fires when the voltage is
        // lower by that times the time since the event before.
        let (events, block, mut residual) = events(8_000);
        let row: Vec<f64> = events.pixel.iter().map(|pixel| f64::from(pixel / 64)).collect();
        let parity: Vec<f64> = row.iter().map(|row| row % 2.0).collect();
        for k in 0..residual.len() {
            residual[k] -= 30.0 * parity[k] * 0.2 * events.since_ns[k] as f64 * 1e-9;
        }
        let laid = [laid(parity, Covariate::RowParity)];
        let found = dependences(&events, &residual, &block, &laid, 0.2, 1e-4);
        assert_eq!(found[0].dependence.moved, AffectedQuantity::Rate);
        let difference = found[0].dependence.value[1] - found[0].dependence.value[0];
        // 8,000 events of noise 0.01 with 3 ms of 0.2 each: an error of 0.4 Hz.
        assert!((difference - 30.0).abs() < 2.0, "{:?}", found[0].dependence);
    }

    #[test]
    fn one_size_for_all_bins_is_no_dependence() {
        let (events, block, mut residual) = events(8_000);
        let row: Vec<f64> = events.pixel.iter().map(|pixel| f64::from(pixel / 64)).collect();
        residual
            .iter_mut()
            .zip(&events.polarity)
            .for_each(|(residual, polarity)| *residual += 0.02 * f64::from(*polarity));
        let found = dependences(&events, &residual, &block, &[laid(row, Covariate::Row)], 0.2, 1e-4);
        assert!(found.iter().all(|one| one.gain < 0.01), "{:?}", found[0]);
    }
}
