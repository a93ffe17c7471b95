//! Two effects at once: which pair of simulated candidates adds up to what was found.
//!
//! Responses of two small effects add. With the responses of all candidates in standard deviations, the best pair is a plane in that space. How much it
//! explains beyond its better half is judged on blocks that its strengths were not fitted to.
//!
//! Limits: effects that change each other's responses (a strong one beside a weak one) do not add; a pair that explains more is no proof of its names.

use crate::candidates::{CANDIDATES, Signs};
use serde::{Deserialize, Serialize};

/// So many of the best single candidates are tried as the first of a pair.
const FIRSTS: usize = 6;
/// A part of less than this times its simulated strength is no effect.
const LEAST_PART: f64 = 0.05;

/// A candidate's responses block by block, in standard deviations.
#[derive(Clone, Debug)]
pub struct Responses {
    /// Number in [`CANDIDATES`].
    pub candidate: usize,
    /// The strength at which it was simulated.
    pub strength: f64,
    /// Of each block.
    pub blocks: Vec<Vec<f64>>,
}

/// A pair of effects.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pair {
    /// Numbers in [`CANDIDATES`].
    pub candidates: [usize; 2],
    /// Their names there.
    pub labels: [String; 2],
    /// Their strengths together.
    pub strengths: [f64; 2],
    /// Twice the log density that both add.
    pub statistic: f64,
    /// What the second adds to that of the better of both alone.
    pub gain: f64,
    /// What the second adds to the first on blocks that strengths were not fitted to, nats.
    pub heldout_nats: f64,
}

/// Sums of products over some blocks.
#[derive(Clone, Copy, Debug, Default)]
struct Products {
    along: [f64; 2],
    square: [f64; 2],
    cross: f64,
}

impl Products {
    fn of(found: &[Vec<f64>], a: &Responses, b: &Responses, keep: impl Fn(usize) -> bool) -> Products {
        let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        (0..found.len()).filter(|&n| keep(n)).fold(Products::default(), |sum, n| {
            let (y, a, b) = (&found[n], &a.blocks[n], &b.blocks[n]);
            Products {
                along: [sum.along[0] + dot(y, a), sum.along[1] + dot(y, b)],
                square: [sum.square[0] + dot(a, a), sum.square[1] + dot(b, b)],
                cross: sum.cross + dot(a, b),
            }
        })
    }

    /// Shares of both that fit best, if they can be told apart.
    fn shares(&self) -> Option<[f64; 2]> {
        let determinant = self.square[0] * self.square[1] - self.cross * self.cross;
        (determinant > 1e-6 * self.square[0] * self.square[1]).then(|| {
            [
                (self.along[0] * self.square[1] - self.along[1] * self.cross) / determinant,
                (self.along[1] * self.square[0] - self.along[0] * self.cross) / determinant,
            ]
        })
    }

    /// Log density that shares add.
    fn nats(&self, [a, b]: [f64; 2]) -> f64 {
        a * self.along[0] + b * self.along[1] - 0.5 * (a * a * self.square[0] + b * b * self.square[1] + 2.0 * a * b * self.cross)
    }

    fn alone(&self, which: usize) -> f64 {
        f64::max(self.along[which], 0.0) / f64::max(self.square[which], 1e-12)
    }
}

/// The best pair, when any adds up; `half` says to which half of the array a block belongs.
pub fn best_pair(found: &[Vec<f64>], responses: &[Responses], half: impl Fn(usize) -> usize) -> Option<Pair> {
    let mut order: Vec<(f64, usize)> = (0..responses.len())
        .map(|n| {
            let products = Products::of(found, &responses[n], &responses[n], |_| true);
            (products.alone(0) * products.along[0], n)
        })
        .collect();
    order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut best: Option<(f64, usize, usize, [f64; 2])> = None;
    for &(_, a) in order.iter().take(FIRSTS) {
        for (b, other) in responses.iter().enumerate() {
            if CANDIDATES[other.candidate].id == CANDIDATES[responses[a].candidate].id {
                continue;
            }
            let products = Products::of(found, &responses[a], other, |_| true);
            let Some(shares) = products.shares() else { continue };
            let is_physics = |share: f64, n: usize| share > LEAST_PART || (share < -LEAST_PART && CANDIDATES[responses[n].candidate].signs == Signs::Both);
            let statistic = 2.0 * products.nats(shares);
            if is_physics(shares[0], a) && is_physics(shares[1], b) && best.is_none_or(|best| statistic > best.0) {
                best = Some((statistic, a, b, shares));
            }
        }
    }
    best.map(|(statistic, a, b, shares)| {
        let (one, other) = (&responses[a], &responses[b]);
        let whole = Products::of(found, one, other, |_| true);
        let alone = f64::max(whole.alone(0) * whole.along[0], whole.alone(1) * whole.along[1]);
        let halves = [0, 1].map(|side| Products::of(found, one, other, |n| half(n) == side));
        let heldout = |from: usize| {
            let (fit, held) = (halves[from], halves[1 - from]);
            fit.shares().map_or(0.0, |shares| held.nats(shares) - held.nats([fit.alone(0), 0.0]))
        };
        let label = |n: usize| CANDIDATES[responses[n].candidate].label();
        Pair {
            candidates: [one.candidate, other.candidate],
            labels: [label(a), label(b)],
            strengths: [shares[0] * one.strength, shares[1] * other.strength],
            statistic,
            gain: statistic - alone,
            heldout_nats: heldout(0) + heldout(1),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_effects_that_add_up_are_found_with_their_strengths() {
        // Three candidates in three dimensions, the same in four blocks; what was found is twice the first and half the second.
        let wave = |k: f64| -> Vec<f64> { (0..3).map(|n| libm::sin(k * f64::from(n) + k)).collect() };
        let ids = ["blur", "leak_events", "black_level"].map(|id| CANDIDATES.iter().position(|candidate| candidate.id == id).unwrap());
        let responses: Vec<Responses> =
            ids.iter().zip([1.0, 2.3, 3.1]).map(|(&candidate, k)| Responses { candidate, strength: 1.0, blocks: vec![wave(k); 4] }).collect();
        let sum: Vec<f64> = (0..3).map(|n| 2.0 * wave(1.0)[n] + 0.5 * wave(2.3)[n]).collect();
        let pair = best_pair(&vec![sum.clone(); 4], &responses, |n| n % 2).unwrap();
        let (first, second) = if pair.candidates[0] == ids[0] { (0, 1) } else { (1, 0) };
        assert_eq!(pair.candidates[second], ids[1]);
        assert!((pair.strengths[first] - 2.0).abs() < 1e-9 && (pair.strengths[second] - 0.5).abs() < 1e-9, "{pair:?}");
        let all: f64 = 4.0 * sum.iter().map(|z| z * z).sum::<f64>();
        assert!((pair.statistic / all - 1.0).abs() < 1e-9 && pair.heldout_nats > 0.0);
    }
}
