//! The exact test of a candidate: can a sensor with it have recorded this, whatever the light was?
//!
//! For a strength of a candidate the light is estimated as that sensor must have seen it ([`crate::under`]), the sensor looks at that light, and what it records is
//! compared with the recording, event by event ([`crate::mismatch`]). The strength that agrees best is sought. The right effect lets events and frames agree that no other
//! effect can bring together, because light has to explain both.
//!
//! Effects that are random have no events of their own to agree with: their place is elsewhere (`likelihood`, `synthesis`).

use crate::candidates::{CANDIDATES, Scales, Signs, Trial};
use crate::case::Case;
use crate::mismatch::{Mismatch, mismatch};
use crate::regression::jackknife;
use crate::sample::Sample;
use crate::scene::SceneSetting;
use crate::under::Under;
use photocurrent_sensor::effects::from_description;
use photocurrent_sensor::map::{MapOptions, Prior};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// How much is tried.
#[derive(Clone, Copy, Debug)]
pub struct RefitSetting {
    /// So many candidates are followed from the first strengths on.
    pub followed: usize,
    /// Of them, so many to the end.
    pub finished: usize,
    /// Corrections of the light, at first and at the end.
    pub turns: (usize, usize),
    /// Strengths lie within this.
    pub largest: f64,
}

impl Default for RefitSetting {
    fn default() -> RefitSetting {
        RefitSetting { followed: 12, finished: 6, turns: (1, 2), largest: 6.0 }
    }
}

/// A recording, the stated sensor, and what is looked at.
#[derive(Clone, Copy)]
pub struct Refit<'a> {
    /// The recording.
    pub case: &'a Case,
    /// What is on the sensor already: as stated, or with effects that were found before.
    pub base: &'a Trial,
    /// What strengths are measured by.
    pub scales: &'a Scales,
    /// Which pixels.
    pub sample: &'a Sample,
    /// How light is estimated.
    pub scene: &'a SceneSetting,
    /// The prior of each pixel.
    pub priors: &'a [Prior],
    /// Noise of frame values that is not stated, as a share of the signal.
    pub frame_noise: f64,
    /// Corrections of the light where it is looked at once.
    pub turns: usize,
}

/// A strength that was tried.
#[derive(Clone, Debug, PartialEq)]
pub struct Tried {
    /// Strength.
    pub strength: f64,
    /// Mismatch of each block.
    pub blocks: Vec<Mismatch>,
}

impl Tried {
    /// Cost of all blocks that are kept.
    pub fn cost(&self, keep: impl Fn(usize) -> bool) -> f64 {
        self.blocks.iter().enumerate().filter(|(block, _)| keep(*block)).map(|(_, of)| of.cost()).sum()
    }

    /// What a part of the blocks says.
    fn only(&self, part: &Sample) -> Tried {
        let keep = |block: usize| part.block.contains(&(block as u32));
        let blocks = self.blocks.iter().enumerate().map(|(block, of)| if keep(block) { *of } else { Mismatch::default() }).collect();
        Tried { strength: self.strength, blocks }
    }

    /// All blocks together.
    pub fn all(&self) -> Mismatch {
        self.blocks.iter().fold(Mismatch::default(), |sum, of| sum.and(of))
    }
}

/// How well a candidate can explain a recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Explained {
    /// Number in [`CANDIDATES`].
    pub candidate: usize,
    /// The strength that agrees best.
    pub strength: f64,
    /// The parameter there, in the unit of its declaration.
    pub value: f64,
    /// 95 % interval, from block to block.
    pub ci95: [f64; 2],
    /// Cost there, an event: 0 when every event comes again at its instant.
    pub cost: f64,
    /// What the same costs on a simulated recording of that sensor: this much its estimation leaves where it is right.
    pub control: f64,
    /// Share of the cost of the sensor without it that it takes away; on blocks that the strength was not fitted to.
    pub heldout: f64,
    /// Log of how well an event is foretold, nats: without it, and with it on blocks that its strength was not fitted to.
    pub nats_per_event: (f64, f64),
    /// Share of the blocks that it improves.
    pub blocks_better: f64,
    /// Was it followed to the end?
    pub is_finished: bool,
}

/// A cost below that of its control says no more than this.
const FURTHEST_BELOW: f64 = 0.02;
/// What the cost itself counts beside what it is beyond its control.
const COST_WEIGHT: f64 = 0.1;
/// Differences of scores count as shares of them and this: costs of simulators differ by so much.
const OFFSET: f64 = 0.03;

/// Fewer pixels than this are looked at all of them from the beginning.
const LEAST_COARSE: usize = 150;

/// Strengths around one that is nearly right, as shares of it.
const NEAR: [f64; 3] = [0.8, 1.0, 1.25];

/// Is a block looked at from the beginning? Those are as the black squares of a chessboard.
fn is_coarse(block: u32, across: u32) -> bool {
    (block % across + block / across).is_multiple_of(2)
}

/// What was found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Refitted {
    /// Cost without any candidate, an event.
    pub stated: f64,
    /// Cost of a simulated recording of the stated sensor, treated alike: what estimation leaves where nothing is missing.
    pub control: f64,
    /// Mean square of frame residuals as stated.
    pub stated_frames: f64,
    /// Cheapest first.
    pub explained: Vec<Explained>,
}

impl Explained {
    /// The less, the better it explains: by how much it costs more than it would if it were right, and a little of what it costs at all.
    pub fn score(&self) -> f64 {
        f64::max(self.cost - self.control, -FURTHEST_BELOW) + COST_WEIGHT * self.cost + OFFSET
    }
}

impl Refitted {
    /// Those that were followed to the end, one for each effect, best first.
    pub fn leading(&self) -> Vec<&Explained> {
        let mut all: Vec<&Explained> = self.explained.iter().filter(|one| one.is_finished).collect();
        all.sort_by(|a, b| a.score().total_cmp(&b.score()).then(a.candidate.cmp(&b.candidate)));
        let mut leading: Vec<&Explained> = Vec::new();
        for one in all {
            if leading.iter().all(|other| CANDIDATES[other.candidate].id != CANDIDATES[one.candidate].id) {
                leading.push(one);
            }
        }
        leading
    }
}

impl Refit<'_> {
    /// The sensor with a candidate.
    fn with(&self, candidate: Option<usize>, strength: f64) -> Trial {
        let mut trial = self.base.clone();
        if let Some(candidate) = candidate {
            CANDIDATES[candidate].put_on(&mut trial, strength, self.scales);
        }
        trial
    }

    /// A strength of a candidate; none where it cannot be combined with what is stated.
    pub fn at(&self, candidate: Option<usize>, strength: f64, turns: usize) -> Option<Tried> {
        let trial = self.with(candidate, strength);
        let under = Under::new(self.case, &trial, self.frame_noise).ok()?;
        let (_, recording) = under.corrected(self.sample, self.scene, self.priors, turns).ok()?;
        Some(Tried { strength, blocks: self.blocks(under.case(), &recording) })
    }

    fn blocks(&self, case: &Case, recording: &Case) -> Vec<Mismatch> {
        let mut blocks = vec![Mismatch::default(); self.sample.block_count];
        for (of, &block) in mismatch(case, recording, self.sample, &self.base.nominal, self.scene.frame_share).iter().zip(&self.sample.block) {
            blocks[block as usize] = blocks[block as usize].and(of);
        }
        blocks
    }

    /// What a recording of a trial would cost: its own light, recorded and estimated again.
    fn control(&self, candidate: Option<usize>, strength: f64, turns: usize) -> Option<Tried> {
        let trial = self.with(candidate, strength);
        let under = Under::new(self.case, &trial, self.frame_noise).ok()?;
        let (_, recording) = under.corrected(self.sample, self.scene, self.priors, turns).ok()?;
        let own = Refit { base: &trial, ..*self }.behind_mixing();
        let (_, again) = Under::new(&recording, &own, self.frame_noise).ok()?.corrected(self.sample, self.scene, self.priors, turns).ok()?;
        Some(Tried { strength: 0.0, blocks: self.blocks(&recording, &again) })
    }

    /// The sensor that looks at light which is mixed already.
    pub fn behind_mixing(&self) -> Trial {
        let mixes = |id: &str, of: &Map<String, Value>| {
            let alone = [(id.to_owned(), of.clone())].into_iter().collect();
            from_description(&alone).is_ok_and(|effects| effects.iter().any(|effect| effect.kernel().is_some()))
        };
        let effects = self.base.effects.iter().filter(|(id, of)| !mixes(id, of)).map(|(id, of)| (id.clone(), of.clone())).collect();
        Trial { effects, ..self.base.clone() }
    }

    /// Share of the cost `stated` that light at knots twice as near takes away.
    pub fn numerical(&self, setting: &RefitSetting, stated: f64) -> f64 {
        let options = MapOptions { spacing_ns: self.scene.options.spacing_ns / 2, ..self.scene.options };
        let finer = SceneSetting { options, ..*self.scene };
        let cost = Refit { scene: &finer, ..*self }.at(None, 0.0, setting.turns.1).map(|tried| an_event(&tried));
        cost.map_or(0.0, |cost| 1.0 - cost / f64::max(stated, 1e-12))
    }

    /// Tries candidates: those of `only`, or all where it is empty; those of `seen` are followed to the end.
    pub fn run(&self, setting: &RefitSetting, only: &[usize], seen: &[usize]) -> Refitted {
        let mut tried: Vec<(usize, Vec<Tried>)> =
            (0..CANDIDATES.len()).filter(|n| !CANDIDATES[*n].is_random && (only.is_empty() || only.contains(n))).map(|n| (n, Vec::new())).collect();
        let (first, last) = setting.turns;
        let [Some(stated), Some(control)] = [self.at(None, 0.0, first), self.control(None, 0.0, first)] else { return Refitted::default() };
        let stated_last = self.at(None, 0.0, last).unwrap_or_else(|| stated.clone());
        let best_stated = if stated_last.cost(|_| true) < stated.cost(|_| true) { &stated_last } else { &stated };
        let first_strengths: Vec<(usize, f64)> = tried
            .iter()
            .flat_map(|&(candidate, _)| {
                let strengths = match CANDIDATES[candidate].signs {
                    Signs::Switch => vec![1.0],
                    Signs::Both => vec![-0.5, 0.5],
                    Signs::Positive => vec![0.5, 1.2],
                };
                strengths.into_iter().map(move |strength| (candidate, strength))
            })
            .collect();
        // Where to look is seen on half of the blocks.
        let (half, places) = self.sample.only(|block| is_coarse(block, self.sample.across));
        let priors: Vec<Prior> = places.iter().map(|&n| self.priors[n]).collect();
        let quick = if half.len() < LEAST_COARSE { *self } else { Refit { sample: &half, priors: &priors, ..*self } };
        quick.extend(&mut tried, &first_strengths, first);
        // Strengths further out or in, then between, for those that do best.
        for round in 0..6 {
            order(&mut tried);
            let count = if round < 2 { setting.followed } else { setting.finished + 1 };
            let chosen = chosen(&tried, count, seen);
            let followed = tried.iter().filter(|(candidate, _)| chosen.contains(candidate));
            let next: Vec<(usize, f64)> = followed.filter_map(|(candidate, tried)| Some((*candidate, self.next(*candidate, tried, setting)?))).collect();
            quick.extend(&mut tried, &next, first);
        }
        order(&mut tried);
        let chosen = chosen(&tried, setting.finished, seen);
        let mut finished: Vec<(usize, Vec<Tried>)> = chosen.iter().map(|candidate| (*candidate, Vec::new())).collect();
        if last > first {
            let again: Vec<(usize, f64)> = tried
                .iter()
                .filter(|(candidate, tried)| chosen.contains(candidate) && !tried.is_empty())
                .flat_map(|(candidate, tried)| {
                    let best = best(tried).strength;
                    let is_switch = CANDIDATES[*candidate].signs == Signs::Switch;
                    let shares: &[f64] = if is_switch { &[1.0] } else { &NEAR };
                    shares.iter().map(|share| (*candidate, (best * share).clamp(-setting.largest, setting.largest))).collect::<Vec<_>>()
                })
                .collect();
            self.extend(&mut finished, &again, last);
            for _round in 0..2 {
                let next: Vec<(usize, f64)> =
                    finished.iter().filter_map(|(candidate, tried)| Some((*candidate, self.next(*candidate, tried, setting)?))).collect();
                self.extend(&mut finished, &next, last);
            }
        }
        let mut explained: Vec<Explained> = tried
            .iter()
            .filter(|(candidate, tried)| !tried.is_empty() && !finished.iter().any(|(other, tried)| other == candidate && !tried.is_empty()))
            .map(|(candidate, tried)| self.explain(*candidate, tried, &best_stated.only(quick.sample), false))
            .collect();
        explained.extend(finished.iter().filter(|(_, tried)| !tried.is_empty()).map(|(candidate, tried)| self.explain(*candidate, tried, best_stated, true)));
        let controls: Vec<Option<Tried>> =
            explained.par_iter().map(|one| if one.is_finished { self.control(Some(one.candidate), one.strength, last) } else { None }).collect();
        for (one, control) in explained.iter_mut().zip(controls) {
            one.control = control.as_ref().map_or(0.0, an_event);
        }
        explained.sort_by(|a, b| a.cost.total_cmp(&b.cost).then(a.candidate.cmp(&b.candidate)));
        let frames = best_stated.all();
        Refitted { stated: an_event(best_stated), control: an_event(&control), stated_frames: frames.frames / f64::max(frames.frame_count, 1.0), explained }
    }

    fn extend(&self, tried: &mut [(usize, Vec<Tried>)], strengths: &[(usize, f64)], turns: usize) {
        let results: Vec<Option<Tried>> = strengths.par_iter().map(|&(candidate, strength)| self.at(Some(candidate), strength, turns)).collect();
        for (&(candidate, _), result) in strengths.iter().zip(results) {
            if let (Some((_, tried)), Some(result)) = (tried.iter_mut().find(|(other, _)| *other == candidate), result) {
                tried.push(result);
                tried.sort_by(|a, b| a.strength.total_cmp(&b.strength));
            }
        }
    }

    /// The strength to try next: beyond the best when it is at the rim, else the lowest point of a parabola through the best and its neighbours; none when it is known well enough.
    fn next(&self, candidate: usize, tried: &[Tried], setting: &RefitSetting) -> Option<f64> {
        let kind = &CANDIDATES[candidate];
        if kind.signs == Signs::Switch || tried.is_empty() {
            return None;
        }
        // Without the candidate: strength 0 is a point of every curve, but its cost is known only to be more.
        let at = place_of_best(tried);
        let (here, cost) = (tried[at].strength, |n: usize| tried[n].cost(|_| true));
        let before = at.checked_sub(1).filter(|&n| tried[n].strength * here > 0.0);
        let after = Some(at + 1).filter(|&n| n < tried.len() && tried[n].strength * here > 0.0);
        let next = match (before, after) {
            (Some(before), Some(after)) => {
                let (a, c) = (tried[before].strength, tried[after].strength);
                let lowest = vertex((a, cost(before)), (here, cost(at)), (c, cost(after)))?;
                if (c - a).abs() < 0.12 * here.abs() {
                    return None;
                }
                // A parabola that keeps to one side is helped across.
                let lowest = lowest.clamp(a + 0.15 * (c - a), c - 0.15 * (c - a));
                if (lowest - here).abs() < 0.04 * here.abs() { here + 0.4 * if c - here > here - a { c - here } else { a - here } } else { lowest }
            }
            // The rim, outwards or towards 0.
            (_, None) if here > 0.0 => here * 1.6,
            (None, _) if here < 0.0 => here * 1.6,
            _ => here * 0.5,
        };
        let next = next.clamp(-setting.largest, setting.largest);
        (next.abs() > 0.03 && tried.iter().all(|other| (other.strength - next).abs() > 0.01 * next.abs())).then_some(next)
    }

    fn explain(&self, candidate: usize, tried: &[Tried], stated: &Tried, is_finished: bool) -> Explained {
        let best_one = best(tried);
        let kind = &CANDIDATES[candidate];
        let blocks = stated.blocks.len();
        let fit = |keep: &dyn Fn(usize) -> bool| fitted(tried, keep);
        let strength = fit(&|_| true);
        // What leaving one block away does to the strength.
        let left_out: Vec<f64> = (0..blocks).filter(|&block| stated.blocks[block].count > 0.0).map(|block| fit(&|other| other != block)).collect();
        let error = jackknife(&left_out);
        let at = |strength: f64| if kind.signs == Signs::Switch { 1.0 } else { kind.value(strength, self.scales, &self.base.nominal) };
        let (low, high) = (at(strength - 1.96 * error), at(strength + 1.96 * error));
        // On each half of the blocks with the strength that is best on the other.
        let half = |block: usize| block % 2;
        let (mut before, mut after, mut nats) = (0.0, 0.0, (0.0, 0.0));
        for side in 0..2 {
            let chosen = best_on(tried, |block| half(block) == side);
            before += stated.cost(|block| half(block) != side);
            after += chosen.cost(|block| half(block) != side);
            let foretold = |of: &Tried| (0..blocks).filter(|&block| half(block) != side).map(|block| of.blocks[block].nats).sum::<f64>();
            nats = (nats.0 + foretold(stated), nats.1 + foretold(chosen));
        }
        let recorded = f64::max(stated.all().recorded, 1.0);
        let better = (0..blocks).filter(|&block| stated.blocks[block].count > 0.0 && best_one.blocks[block].cost() < stated.blocks[block].cost()).count();
        Explained {
            candidate,
            strength,
            value: at(strength),
            ci95: [f64::min(low, high), f64::max(low, high)],
            cost: best_one.cost(|_| true) / f64::max(stated.all().count, 1.0),
            control: 0.0,
            heldout: 1.0 - after / f64::max(before, 1e-12),
            nats_per_event: (nats.0 / recorded, nats.1 / recorded),
            blocks_better: better as f64 / f64::max(left_out.len() as f64, 1.0),
            is_finished,
        }
    }
}

/// What a trial costs an event.
fn an_event(tried: &Tried) -> f64 {
    tried.cost(|_| true) / f64::max(tried.all().count, 1.0)
}

fn order(tried: &mut [(usize, Vec<Tried>)]) {
    let cost = |tried: &[Tried]| if tried.is_empty() { f64::INFINITY } else { best(tried).cost(|_| true) };
    tried.sort_by(|a, b| cost(&a.1).total_cmp(&cost(&b.1)).then(a.0.cmp(&b.0)));
}

/// The first `count`, what the best is confused with by the catalogue's own word, and those that were `seen` elsewhere.
fn chosen(ordered: &[(usize, Vec<Tried>)], count: usize, seen: &[usize]) -> Vec<usize> {
    let mut chosen: Vec<usize> = ordered.iter().take(count).map(|(candidate, _)| *candidate).collect();
    if let Some((best, _)) = ordered.first() {
        let confused_with = CANDIDATES[*best].decl().confused_with;
        let is_also = |candidate: &usize| confused_with.contains(&CANDIDATES[*candidate].id) || seen.contains(candidate);
        chosen.extend(ordered.iter().skip(count).map(|(candidate, _)| *candidate).filter(is_also));
    }
    chosen
}

fn place_of_best(tried: &[Tried]) -> usize {
    (0..tried.len()).min_by(|&a, &b| tried[a].cost(|_| true).total_cmp(&tried[b].cost(|_| true))).unwrap_or(0)
}

fn best(tried: &[Tried]) -> &Tried {
    &tried[place_of_best(tried)]
}

fn best_on(tried: &[Tried], keep: impl Fn(usize) -> bool) -> &Tried {
    let cost = |n: usize| tried[n].cost(&keep);
    &tried[(0..tried.len()).min_by(|&a, &b| cost(a).total_cmp(&cost(b))).unwrap_or(0)]
}

/// The strength at which the blocks that are kept cost least: the lowest point of a parabola through the three best neighbours.
fn fitted(tried: &[Tried], keep: &dyn Fn(usize) -> bool) -> f64 {
    let cost = |n: usize| tried[n].cost(keep);
    let at = (0..tried.len()).min_by(|&a, &b| cost(a).total_cmp(&cost(b))).unwrap_or(0);
    let here = tried[at].strength;
    if at == 0 || at + 1 >= tried.len() {
        return here;
    }
    let point = |n: usize| (tried[n].strength, cost(n));
    vertex(point(at - 1), point(at), point(at + 1)).map_or(here, |lowest| lowest.clamp(tried[at - 1].strength, tried[at + 1].strength))
}

/// The lowest point of a parabola through three; none when it opens downwards.
fn vertex(a: (f64, f64), b: (f64, f64), c: (f64, f64)) -> Option<f64> {
    let (left, right) = ((b.1 - a.1) / (b.0 - a.0), (c.1 - b.1) / (c.0 - b.0));
    let curvature = (right - left) / (c.0 - a.0);
    (curvature > 0.0).then(|| 0.5 * (a.0 + b.0) - 0.5 * left / curvature)
}
