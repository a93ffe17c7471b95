//! How mismatch depends on what an effect depends on: as stated, and as fitted.
//!
//! Recorded events (or frame values) are sorted by the covariate of the effect into bins of equally many, and averaged; errors are from block to block, as the events of one
//! pixel are not independent of each other. The right effect takes away the dependence, not only the mean.

use crate::case::Case;
use crate::covariates::{Covariate, Surroundings};
use crate::differences::{Fate, of_events, of_frames};
use crate::mismatch::for_each_cost;
use crate::nominal::Nominal;
use crate::sample::Sample;
use crate::scene::Scene;
use photocurrent_sensor::effects::{Stage, catalogue};

/// Bins of a covariate on a scale.
const BINS: usize = 10;
/// Fewest values in a bin, and fewest blocks that they come from.
const LEAST: (usize, usize) = (20, 3);

/// What is averaged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Cost of a recorded event, 0 to 1 ([`crate::mismatch`]).
    Cost,
    /// Recorded less simulated time of paired events, us.
    Delay,
    /// Logarithm of recorded over simulated frame values, %.
    Frames,
}

/// A point of a curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Mean of the covariate in the bin.
    pub at: f64,
    /// Mean of the quantity.
    pub value: f64,
    /// Its standard error, from block to block.
    pub error: f64,
}

/// A quantity over a covariate.
#[derive(Clone, Debug, PartialEq)]
pub struct Dependence {
    /// What is averaged.
    pub quantity: Quantity,
    /// Over what.
    pub covariate: Covariate,
    /// As stated.
    pub before: Vec<Point>,
    /// As fitted.
    pub after: Vec<Point>,
}

/// What an effect depends on: its covariate (of a product the first that is one of events), and whether it is one of frames; none when that is the pixel alone or no covariate of ours.
pub fn covariate(id: &str) -> Option<(Covariate, bool)> {
    let decl = catalogue().into_iter().map(|kind| kind.decl).find(|decl| decl.id == id)?;
    let named = |name: &str| match name {
        // The brighter, the more digits.
        "dn" => Some(Covariate::Photocurrent),
        _ => Covariate::ALL.into_iter().find(|covariate| covariate.name() == name),
    };
    Some((decl.covariate.split('*').find_map(named)?, decl.stage == Stage::Exposure))
}

/// A recording beside what a description fires at its own light.
pub struct Looked<'a> {
    surroundings: Surroundings<'a>,
    case: &'a Case,
    sample: &'a Sample,
    recording: &'a Case,
    nominal: &'a Nominal,
}

/// Covariate, block and quantity of an event or a frame value.
type Value = (f64, u32, f64);

impl<'a> Looked<'a> {
    /// Of a recording, light, and what a description records of it.
    pub fn new(case: &'a Case, sample: &'a Sample, light: &'a Scene, recording: &'a Case, nominal: &'a Nominal) -> Looked<'a> {
        let front_end = nominal.pixel.front_end;
        Looked { surroundings: Surroundings::new(case, sample, light, (front_end.tau_0_s, front_end.alpha_s)), case, sample, recording, nominal }
    }

    fn values(&self, quantity: Quantity, covariate: Covariate) -> Vec<Value> {
        let block = |pixel: u32| self.sample.place(pixel as usize).map_or(0, |n| self.sample.block[n]);
        let at = |pixel: u32, t_ns: i64, polarity: i8| self.surroundings.value(covariate, pixel as usize, t_ns, polarity);
        let mut found = Vec::new();
        match quantity {
            Quantity::Cost => {
                for &pixel in &self.sample.pixels {
                    let (here, there) = (self.case.events.of(pixel as usize), self.recording.events.of(pixel as usize));
                    let mut events = here.iter();
                    for_each_cost(here, there, |cost| {
                        found.extend(events.next().and_then(|event| Some((at(pixel, event.t_in_ns, event.polarity)?, block(pixel), cost))));
                    });
                }
            }
            Quantity::Delay => found.extend(of_events(self.case, self.recording, self.sample).iter().filter_map(|event| {
                let Fate::Paired(by_ns) = event.fate else { return None };
                Some((at(event.pixel, event.t_ns, event.polarity)?, block(event.pixel), by_ns as f64 * 1e-3))
            })),
            Quantity::Frames => {
                let (black_level, saturation_dn) = (self.nominal.number.black_level, self.nominal.saturation_dn);
                let frames = of_frames(self.case, self.recording, self.sample, black_level, saturation_dn);
                found.extend(frames.iter().filter_map(|one| Some((at(one.pixel, one.t_ns, 1)?, block(one.pixel), 100.0 * one.log_ratio))));
            }
        }
        found.retain(|(at, _, value)| at.is_finite() && value.is_finite());
        found
    }
}

/// The curves of an effect: of cost and delay for one of events, of cost and frame values for one of frames.
pub fn dependences((covariate, is_of_frames): (Covariate, bool), before: &Looked<'_>, after: &Looked<'_>) -> Vec<Dependence> {
    let signed = if is_of_frames { Quantity::Frames } else { Quantity::Delay };
    let one = |quantity: Quantity| {
        let (stated, fitted) = (before.values(quantity, covariate), after.values(quantity, covariate));
        let edges = edges(&stated, covariate.is_class());
        Dependence { quantity, covariate, before: points(&stated, &edges), after: points(&fitted, &edges) }
    };
    [Quantity::Cost, signed].map(one).into_iter().filter(|one| one.before.len() > 1).collect()
}

/// Where bins end: after each class, or so that equally many values are in each.
fn edges(values: &[Value], is_class: bool) -> Vec<f64> {
    let mut all: Vec<f64> = values.iter().map(|value| value.0).collect();
    all.sort_by(f64::total_cmp);
    let mut edges: Vec<f64> = if is_class {
        all.dedup();
        all.iter().skip(1).copied().collect()
    } else {
        (1..BINS).filter_map(|bin| all.get(bin * all.len() / BINS).copied()).collect()
    };
    edges.dedup();
    edges
}

fn points(values: &[Value], edges: &[f64]) -> Vec<Point> {
    let mut bins: Vec<Vec<&Value>> = vec![Vec::new(); edges.len() + 1];
    values.iter().for_each(|value| bins[edges.partition_point(|edge| *edge <= value.0)].push(value));
    let point = |bin: &Vec<&Value>| {
        let n = bin.len() as f64;
        let (at, mean) = bin.iter().fold((0.0, 0.0), |sum, value| (sum.0 + value.0 / n, sum.1 + value.2 / n));
        let mut parts = vec![(0.0, false); bin.iter().map(|value| value.1 as usize + 1).max().unwrap_or(0)];
        bin.iter().for_each(|value| {
            let part = &mut parts[value.1 as usize];
            *part = (part.0 + (value.2 - mean) / n, true);
        });
        let blocks = parts.iter().filter(|part| part.1).count();
        let squares: f64 = parts.iter().map(|part| part.0 * part.0).sum();
        let error = libm::sqrt(blocks as f64 / f64::max(blocks as f64 - 1.0, 1.0) * squares);
        (bin.len() >= LEAST.0 && blocks >= LEAST.1).then_some(Point { at, value: mean, error })
    };
    bins.iter().filter_map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::random::Random;

    #[test]
    fn a_straight_line_comes_back_with_honest_errors() {
        // 40 blocks, each with an offset of its own of 0.3: 25 values of a block in a bin share it.
        let mut random = Random::new(7, &[]);
        let offsets: Vec<f64> = (0..40).map(|_| 0.3 * random.normal()).collect();
        let values: Vec<Value> = (0..10_000)
            .map(|k| {
                let (at, block) = (random.uniform(), k % 40);
                (at, block, 2.0 * at + offsets[block as usize] + 0.1 * random.normal())
            })
            .collect();
        let found = points(&values, &edges(&values, false));
        assert_eq!(found.len(), BINS);
        let mean = offsets.iter().sum::<f64>() / 40.0;
        for point in &found {
            assert!((point.value - mean - 2.0 * point.at).abs() < 0.03, "{point:?}");
            // The offsets are what the mean is uncertain by, not the noise of the values: 0.3 over the root of 40.
            assert!((point.error / (0.3 / libm::sqrt(40.0)) - 1.0).abs() < 0.35, "{point:?}");
        }
    }

    #[test]
    fn effects_have_the_covariate_of_the_catalogue() {
        assert_eq!(covariate("leak_events"), Some((Covariate::TimeSinceLastEvent, false)));
        assert_eq!(covariate("black_level"), Some((Covariate::Photocurrent, true)));
        assert_eq!(covariate("row_skew").map(|of| of.0), Some(Covariate::Row));
        assert_eq!(covariate("threshold_mismatch"), None);
    }
}
