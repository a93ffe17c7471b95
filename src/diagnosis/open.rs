//! What an effect that nobody has named depends on, and by which curve.
//!
//! Changes of closures ([`crate::closures`]) are regressed on what thresholds, stamps, and events without light would add that differ from bin to bin of a covariate. No form is presumed, but for
//! a rhythm: its period is that of the strongest Fourier component. What a curve takes away is counted on pixels that it was not fitted to, beyond the simplest effects of the
//! catalogue, and beyond what named effects explain: those are simulated on the recording's own light, and their changes of closures are regressors too.
//!
//! A simulated recording of the same sensor is treated alike. The curve that it asks for is an error of the light through the events, and where curves start from.

use crate::candidates::{CANDIDATES, Scales, Trial};
use crate::case::Case;
use crate::closures::{Change, PLAIN};
use crate::covariates::{Covariate, Surroundings};
use crate::instants::Instants;
use crate::law::{Law, Moved};
use crate::nominal::Nominal;
use crate::record::{Conditions, effects_of, record};
use crate::regression::{Products, RIDGE};
use crate::rhythm::strongest_period_ns;
use crate::sample::Sample;
use crate::side::{PART_COUNT, Side, differences, part_of, sampled};
use photocurrent_core::random::Random;
use photocurrent_sensor::effects::{FrontEndModel, History, Thresholds};
use rayon::prelude::*;

/// Bins of a covariate on a scale.
const BINS: usize = 10;
/// Fewest events of a bin.
const LEAST_EVENTS: usize = 100;
/// Of an array with more events than this only some blocks are looked at.
const MOST_EVENTS: usize = 150_000;

/// Laws over all covariates, the one that takes away most first, beyond what the `named` candidates at their strengths explain.
///
/// # Errors
/// When effects cannot be combined.
pub fn laws(case: &Case, nominal: &Nominal, scales: &Scales, named: &[(usize, f64)], frame_noise: f64) -> Result<Vec<Law>, String> {
    let sample = sampled(case, MOST_EVENTS);
    let mut trial = Trial::stated(nominal);
    named.iter().for_each(|(candidate, strength)| CANDIDATES[*candidate].put_on(&mut trial, *strength, scales));
    let known = as_nominal(case, &trial)?;
    let nominal = known.as_ref().unwrap_or(nominal);
    let here = Side::new(case, nominal, &sample);
    if here.changes.is_empty() {
        return Ok(Vec::new());
    }
    let again = |trial: &Trial| -> Result<Side, String> {
        let conditions = Conditions { seed: 11, frame_share: frame_noise, ..Conditions::default() };
        Ok(Side::new(&record(case, &trial.nominal, &sample, &here.light, &trial.effects, &conditions)?, nominal, &sample))
    };
    let stated = again(&Trial::stated(nominal))?;
    let mut templates = Vec::new();
    for &(candidate, strength) in named.iter().filter(|_| known.is_none()) {
        let with = again(&Trial::with(nominal, &CANDIDATES[candidate], strength, scales))?;
        templates.push(differences(&here.changes, &with.changes, &stated.changes));
    }
    let none: Vec<Vec<f64>> = templates.iter().map(|_| vec![0.0; stated.changes.len()]).collect();
    let front_end = nominal.pixel.front_end;
    let tau = (front_end.tau_0_s, front_end.alpha_s);
    let mut laws = Vec::new();
    let Some(instants) = Instants::new(case) else { return Ok(Vec::new()) };
    let step = 0.5 * (nominal.pixel.threshold_on + nominal.pixel.threshold_off);
    for moved in [Moved::Threshold, Moved::Stamps, Moved::Rate] {
        let asked = Asked { moved, instants: &instants, step };
        let period_ns = rhythm(&here, &templates, &asked);
        let around = Surroundings::new(&here.case, &sample, &here.light, tau).with_period(period_ns);
        let around_stated = Surroundings::new(&stated.case, &sample, &stated.light, tau).with_period(period_ns);
        let found = Covariate::ALL.par_iter().filter_map(|&covariate| {
            let (at, at_stated) = (asked.lay(&here, covariate, &sample, &around), asked.lay(&stated, covariate, &sample, &around_stated));
            let bins = Bins::new(&at, covariate)?;
            let of_recording = Part::all(&here, &sample, &templates, &asked, &bins, &at);
            let of_control = Part::all(&stated, &sample, &none, &asked, &bins, &at_stated);
            let period_s = period_ns.filter(|_| covariate == Covariate::AcPhase).map(|ns| ns as f64 * 1e-9);
            let (value, error, weighed) = weigh(&of_recording, &of_control, templates.len(), bins.at.len());
            Some(Law {
                moved,
                covariate,
                period_s,
                at: bins.at,
                value,
                error,
                taken: weighed.0,
                significance: weighed.1,
                nats_per_change: -0.5 * libm::log(f64::max(1.0 - weighed.0, 1e-12)),
            })
        });
        laws.extend(found.collect::<Vec<Law>>());
    }
    laws.sort_by(|a, b| b.taken.total_cmp(&a.taken));
    Ok(laws)
}

/// The sensor of a trial whose effects are nothing but other thresholds, time constants or blind times; none when there are no effects, or others.
fn as_nominal(case: &Case, trial: &Trial) -> Result<Option<Nominal>, String> {
    if trial.effects.is_empty()
        || trial.effects.keys().any(|id| !matches!(id.as_str(), "threshold_scale" | "threshold_asymmetry" | "time_constant" | "refractory"))
    {
        return Ok(None);
    }
    let mut nominal = trial.nominal.clone();
    let site = case.site(0, 1);
    let mut model = FrontEndModel::plain(nominal.pixel.front_end);
    let mut thresholds = Thresholds { on: nominal.pixel.threshold_on, off: nominal.pixel.threshold_off };
    for effect in effects_of(case, &trial.effects)? {
        effect.front_end(&site, &mut model);
        effect.thresholds(&site, &History::default(), &mut Random::new(0, &[]), case.span.0, &mut thresholds);
        nominal.pixel.refractory_ns = effect.refractory_ns(&site, 1.0, nominal.pixel.refractory_ns);
    }
    (nominal.pixel.threshold_on, nominal.pixel.threshold_off) = (thresholds.on, thresholds.off);
    nominal.pixel.front_end = model.low_pass;
    Ok(Some(nominal))
}

/// What is moved, and where a covariate is asked for: at events, or at instants.
struct Asked<'a> {
    moved: Moved,
    instants: &'a Instants,
    /// Of an event, natural-log units.
    step: f64,
}

impl Asked<'_> {
    fn lay(&self, side: &Side, covariate: Covariate, sample: &Sample, surroundings: &Surroundings<'_>) -> Vec<f64> {
        if self.moved == Moved::Rate { self.instants.lay(covariate, sample, surroundings) } else { side.lay(covariate, surroundings) }
    }

    /// What a unit of it adds to a change: (number among those of `lay`, natural-log units).
    fn each_added(&self, change: &Change, mut tell: impl FnMut(usize, f64)) {
        match self.moved {
            Moved::Threshold => change.events.iter().for_each(|&(event, gain, _)| tell(event, gain)),
            Moved::Stamps => change.events.iter().for_each(|&(event, _, delay)| tell(event, delay)),
            Moved::Rate => self.instants.added(change, self.step).for_each(|(instant, added)| tell(instant, added)),
            // How often events come is the light's, too: see `integrity::regular`.
            Moved::EventRate => {}
        }
    }

    fn time(&self, side: &Side, number: usize) -> i64 {
        if self.moved == Moved::Rate { self.instants.time(number) } else { side.events[number].1 }
    }
}

/// The period of what events ask for.
fn rhythm(side: &Side, templates: &[Vec<f64>], asked: &Asked<'_>) -> Option<i64> {
    let mut products = Products::new(PLAIN + templates.len());
    let row = |n: usize| -> Vec<(usize, f64)> {
        let change = &side.changes[n];
        change.plain.iter().copied().chain(templates.iter().map(|template| template[n])).enumerate().collect()
    };
    for (n, change) in side.changes.iter().enumerate() {
        products.add(&row(n), change.value, change.weight);
    }
    let found = products.solve(|_| true, RIDGE);
    // The gradient of the squares by what each event, or instant, adds.
    let mut gradient = Vec::new();
    for (n, change) in side.changes.iter().enumerate() {
        let left = change.value - row(n).iter().map(|(k, x)| found[*k] * x).sum::<f64>();
        asked.each_added(change, |number, added| gradient.push((asked.time(side, number), change.weight * added * left)));
    }
    let frame_ns = side.case.frames.as_ref().and_then(|frames| frames.times.mean_period_ns()).map(|period_ns| period_ns as i64);
    strongest_period_ns(gradient.into_iter(), side.case.span, frame_ns)
}

/// Bins of a covariate: classes, or of as many events each.
struct Bins {
    edges: Vec<f64>,
    /// Which bin each interval between edges is.
    number: Vec<Option<usize>>,
    at: Vec<f64>,
}

impl Bins {
    fn new(values: &[f64], covariate: Covariate) -> Option<Bins> {
        let mut all: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
        all.sort_by(f64::total_cmp);
        let mut edges: Vec<f64> = if covariate.is_class() {
            let mut classes = all.clone();
            classes.dedup();
            classes.into_iter().skip(1).collect()
        } else {
            (1..BINS).filter_map(|n| all.get(n * all.len() / BINS).copied()).collect()
        };
        edges.dedup();
        edges.retain(|edge| all.first().is_some_and(|first| edge > first));
        let mut sums = vec![(0_usize, 0.0); edges.len() + 1];
        for value in &all {
            let sum = &mut sums[edges.partition_point(|edge| edge <= value)];
            *sum = (sum.0 + 1, sum.1 + value);
        }
        // Bins with too few events are none.
        let mut number = Vec::new();
        let mut at = Vec::new();
        for (count, sum) in sums {
            number.push((count >= LEAST_EVENTS).then_some(at.len()));
            if count >= LEAST_EVENTS {
                at.push(sum / count as f64);
            }
        }
        (at.len() > 1).then_some(Bins { edges, number, at })
    }

    fn of(&self, value: f64) -> Option<usize> {
        self.number[self.edges.partition_point(|edge| *edge <= value)].filter(|_| value.is_finite())
    }
}

/// Sums of a part of the array, by half: pixels are of two, as squares of a chessboard.
struct Part {
    halves: [Products; 2],
}

impl Part {
    fn all(side: &Side, sample: &Sample, templates: &[Vec<f64>], asked: &Asked<'_>, bins: &Bins, at: &[f64]) -> Vec<Part> {
        let columns = PLAIN + templates.len() + bins.at.len();
        let mut parts: Vec<Part> = (0..PART_COUNT).map(|_| Part { halves: [Products::new(columns), Products::new(columns)] }).collect();
        let extent = side.case.extent;
        let mut row = Vec::with_capacity(columns);
        let mut own = vec![0.0; bins.at.len()];
        for (n, change) in side.changes.iter().enumerate() {
            let (x, y) = side.case.place(sample.pixels[change.place] as usize);
            own.fill(0.0);
            asked.each_added(change, |number, added| {
                if let Some(bin) = bins.of(at[number]) {
                    own[bin] += added;
                }
            });
            row.clear();
            row.extend(change.plain.iter().copied().enumerate());
            row.extend(templates.iter().enumerate().map(|(k, template)| (PLAIN + k, template[n])));
            row.extend(own.iter().enumerate().map(|(k, value)| (PLAIN + templates.len() + k, *value)));
            parts[part_of(extent, x, y)].halves[(x + y) as usize % 2].add(&row, change.value, change.weight);
        }
        parts
    }
}

fn sum_of(parts: &[Part], half: usize) -> Products {
    let mut sum = parts[0].halves[half].clone();
    parts[1..].iter().for_each(|part| sum.merge(&part.halves[half]));
    sum
}

/// The curve, its error, and what it takes away with its significance.
fn weigh(recording: &[Part], control: &[Part], templates: usize, bins: usize) -> (Vec<f64>, Vec<f64>, (f64, f64)) {
    let first = PLAIN + templates;
    let halves: [Products; 2] = std::array::from_fn(|half| sum_of(recording, half));
    let whole = |parts: &[Part]| {
        let mut sum = sum_of(parts, 0);
        sum.merge(&sum_of(parts, 1));
        sum
    };
    let (all, of_control) = (whole(recording), whole(control));
    let law = |products: &Products| products.solve(|_| true, RIDGE);
    let start = law(&of_control);
    // Without a law: the simplest effects, beside the curve of the control or none, whichever leaves less.
    let base = |from: &Products, on: &Products| {
        let plain = from.solve(|n| n < first, RIDGE);
        let offset = from.solve_beside(|n| n < first, RIDGE, |n| if n < first { 0.0 } else { start[n] });
        if on.left(&plain) <= on.left(&offset) { plain } else { offset }
    };
    let fits: [(Vec<f64>, Vec<f64>); 2] = std::array::from_fn(|half| (base(&halves[1 - half], &halves[half]), law(&halves[1 - half])));
    let (mut before, mut gains) = (0.0, Vec::new());
    for part in recording {
        let (mut gain, mut rows) = (0.0, 0.0);
        for (half, (base, law)) in fits.iter().enumerate() {
            let products = &part.halves[half];
            before += products.left(base);
            gain += products.left(base) - products.left(law);
            rows += products.rows;
        }
        if rows > 0.0 {
            gains.push(gain);
        }
    }
    let n = gains.len() as f64;
    let mean = gains.iter().sum::<f64>() / f64::max(n, 1.0);
    let spread = libm::sqrt(gains.iter().map(|gain| (gain - mean) * (gain - mean)).sum::<f64>() / f64::max(n - 1.0, 1.0));
    let both = law(&all);
    let less = |of: &[f64]| -> Vec<f64> {
        let curve: Vec<f64> = (0..bins).map(|bin| of[first + bin] - start[first + bin]).collect();
        let middle = curve.iter().sum::<f64>() / bins as f64;
        curve.iter().map(|value| value - middle).collect()
    };
    let (one, other) = (less(&fits[0].1), less(&fits[1].1));
    let error = one.iter().zip(&other).map(|(a, b)| 0.5 * (a - b).abs()).collect();
    let significance = if spread > 0.0 { mean / (spread / libm::sqrt(n)) } else { 0.0 };
    (less(&both), error, (n * mean / f64::max(before, 1e-300), significance))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::PixelEvents;
    use crate::testing;
    use serde_json::json;

    /// A recording whose even rows have thresholds a share higher, and the others as much lower.
    fn by_rows(share: f64) -> Case {
        rows_of(&[share, -share].map(|fraction| ("threshold_scale", json!({"fraction": fraction}))))
    }

    /// A recording whose even rows have the first effect, and the others the second.
    fn rows_of(effects: &[(&str, serde_json::Value); 2]) -> Case {
        let [even, odd] =
            effects.each_ref().map(|(id, effect)| testing::case_with(&[((*id).to_owned(), effect.as_object().unwrap().clone())].into_iter().collect()));
        let of = |pixel: usize| if even.place(pixel).1 % 2 == 0 { even.events.of(pixel) } else { odd.events.of(pixel) };
        Case { events: PixelEvents::new((0..even.extent.pixels()).map(|pixel| of(pixel).to_vec())), ..even.clone() }
    }

    fn found(case: &Case) -> Vec<Law> {
        let nominal = case.nominal().unwrap();
        laws(case, &nominal, &Scales::of(case, &nominal), &[], 0.0).unwrap()
    }

    #[test]
    fn thresholds_by_parity_of_the_row_are_found_with_their_size() {
        let laws = found(&by_rows(0.12));
        let most = laws.iter().max_by(|a, b| a.significance.total_cmp(&b.significance)).unwrap();
        assert_eq!((most.moved, most.covariate), (Moved::Threshold, Covariate::RowParity));
        assert!(most.taken > 0.1 && most.significance > 4.0, "{most:?}");
        assert!((most.value[0] - 0.12).abs() < 0.03 && (most.value[1] + 0.12).abs() < 0.03, "{most:?}");
    }

    #[test]
    fn events_without_light_by_parity_of_the_row_are_found_with_their_rate() {
        let laws = found(&rows_of(&["60 Hz", "0.001 Hz"].map(|rate| ("leak_events", json!({"rate": rate})))));
        let most = laws.iter().max_by(|a, b| a.significance.total_cmp(&b.significance)).unwrap();
        assert_eq!((most.moved, most.covariate), (Moved::Rate, Covariate::RowParity));
        assert!((most.value[0] - 30.0).abs() < 2.0 && (most.value[1] + 30.0).abs() < 2.0, "{most:?}");
    }

    #[test]
    fn equal_thresholds_give_no_law_of_the_rows() {
        let laws = found(&by_rows(0.0));
        let of_rows = laws.iter().find(|law| law.moved == Moved::Threshold && law.covariate == Covariate::RowParity).unwrap();
        assert!(of_rows.taken < 0.01 && of_rows.value.iter().all(|value| value.abs() < 0.02), "{of_rows:?}");
    }
}
