//! How far effects explain, event by event, what the estimated light does not.
//!
//! The light is estimated with the stated sensor, in blocks of pixels spread over the array. What is left at every event and frame is scored for every effect of the catalogue, with everything
//! projected out that light could do ([`score`]). What the estimation itself leaves is taken off by a control: the stated sensor on the same scene ([`crate::faithful`]), through all of it again.
//! Then every candidate is put on, simulated on the same scene and estimated again: the one whose difference from the control is most like that of the
//! recording is named first ([`features`]). The best are simulated again at the strength that fits; what the same
//! search finds in a simulated recording of known strength calibrates it.
//!
//! Limits: one pixel alone, so what needs neighbours (vignetting, shifts) is hardly seen; effects that act alike through events and frames stay a set; the bias that
//! estimation has from scene to scene is a stated constant.

pub mod features;
pub mod pairs;
pub mod score;
#[cfg(test)]
mod tests;
pub mod view;

use crate::candidates::{CANDIDATES, Scales, Signs, Trial};
use crate::case::Case;
use crate::faithful::{Faithful, faithful};
use crate::nominal::Nominal;
use crate::record::{Conditions, record};
use crate::sample::Sample;
use crate::scene::{Scene, SceneSetting};
use features::{Bench, Features, Measured, Metric};
use pairs::{Pair, Responses, best_pair};
use score::pair;
use serde::{Deserialize, Serialize};

/// How much is looked at.
#[derive(Clone, Copy, Debug)]
pub struct LikelihoodSetting {
    /// Zones of the array, each with one block.
    pub zones: (u32, u32),
    /// Side of a block, pixels.
    pub side: u32,
    /// Pixels around the scored ones, whose light is estimated for their neighbours' sake.
    pub margin: u32,
    /// Blocks have a mean number of events a pixel between these.
    pub events: (f64, f64),
    /// How light is estimated.
    pub scene: SceneSetting,
    /// Every candidate is simulated; then so many of the best, once each round, again at the strength that fits.
    pub refined: [usize; 4],
    /// Of so many effects the strength is calibrated with a simulated recording where it is known.
    pub calibrated: usize,
    /// What [`Proposal::statistic_of_sums`] some effect must reach for an alarm.
    pub least_statistic: f64,
    /// Log density that an effect must add on pixels that its strength was not fitted to, nats.
    pub least_nats: f64,
    /// And the share of blocks that it must improve.
    pub least_share: f64,
    /// Effects whose statistic is at least this share of the best are not told apart from it.
    pub alike: f64,
    /// Seed of simulated recordings.
    pub seed: u64,
}

impl Default for LikelihoodSetting {
    fn default() -> LikelihoodSetting {
        LikelihoodSetting {
            zones: (4, 4),
            side: 5,
            margin: 1,
            events: (3.0, 250.0),
            scene: SceneSetting::close(),
            refined: [9, 6, 5, 4],
            calibrated: 2,
            least_statistic: 12.0,
            least_nats: 10.0,
            least_share: 0.6,
            alike: 0.85,
            seed: 1,
        }
    }
}

/// An effect that may be missing, as this road sees it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Proposal {
    /// Number in [`CANDIDATES`].
    pub candidate: usize,
    /// Its name there: id and parameter.
    pub label: String,
    /// Its strength.
    pub strength: f64,
    /// The parameter, in the unit of `diagnosis.json`; the interval holds noise and the bias of estimation.
    pub value: f64,
    /// See there.
    pub ci95: [f64; 2],
    /// Twice the log density that it adds, at its best strength.
    pub statistic: f64,
    /// The same of sums over all blocks, in which biases of the estimation count once: by this an alarm is raised.
    pub statistic_of_sums: f64,
    /// Log density that it adds to blocks that its strength was not fitted to, nats.
    pub heldout_nats: f64,
    /// The same over the events looked at.
    pub heldout_nats_per_event: f64,
    /// Share of the blocks that it improves.
    pub blocks_better: f64,
}

/// How well an effect could be seen in this recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Detectable {
    /// Number in [`CANDIDATES`].
    pub candidate: usize,
    /// Its name there.
    pub label: String,
    /// What a single linear step says of the parameter, less that of the control: the scene takes over much of an effect, so it is too small where there is one.
    pub estimate: f64,
    /// Standard deviation of it.
    pub standard_error: f64,
    /// What would have been seen in half of the cases, at 5 % with one side: 2.92 standard errors.
    pub minimal_detectable: f64,
    /// How much of the information is left when the light is unknown.
    pub share: f64,
    /// Why it cannot be tested here, if so.
    pub not_testable: Option<String>,
}

/// What this road says of a recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Likelihood {
    /// Best first; of each effect its best parameter only.
    pub proposals: Vec<Proposal>,
    /// Does the first pass the gates?
    pub is_alarm: bool,
    /// Two effects that explain more together.
    pub pair: Option<Pair>,
    /// Labels of those that are not told apart from the first, without it.
    pub also_possible: Vec<String>,
    /// Of every candidate with a column.
    pub detectability: Vec<Detectable>,
    /// By how much residuals are larger than they are believed to; 1 when they are not.
    pub dispersion: f64,
    /// The same in the control.
    pub control_dispersion: f64,
    /// How well the light that was estimated with the stated sensor fires the recorded events again: 1 is perfect.
    pub agreement: f64,
    /// Twice the log density that an exact explanation would add; proposals explain parts of it.
    pub total: f64,
    /// Pixels that were scored.
    pub pixels: usize,
    /// Events and frame values that were scored.
    pub measurements: usize,
}

/// A candidate, simulated at a strength.
#[derive(Clone, Debug)]
pub struct Expected {
    /// Number in [`CANDIDATES`].
    pub candidate: usize,
    /// Strength.
    pub strength: f64,
    /// What was measured of it.
    pub measured: Measured,
}

/// Everything that is compared: for the caller that wants to look closer.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// The recording.
    pub data: Measured,
    /// The stated sensor on its scene.
    pub control: Measured,
    /// Candidates on its scene.
    pub expected: Vec<Expected>,
    /// How well the light fires the recorded events again: 1 is perfect.
    pub agreement: f64,
    /// By how much strengths of a candidate are found too small, where that was tried.
    pub calibration: Vec<(usize, f64)>,
}

/// Shares of information below this cannot be tested.
const LEAST_SHARE: f64 = 0.005;

/// What a likelihood with estimated light says of a recording.
///
/// # Errors
/// When the stated effects cannot be combined, or no block of pixels has enough events.
pub fn likelihood(case: &Case, nominal: &Nominal, setting: &LikelihoodSetting) -> Result<Likelihood, String> {
    let scales = Scales::of(case, nominal);
    let comparison = compare(case, nominal, &scales, setting)?;
    Ok(judge(&comparison, nominal, &scales, setting))
}

/// Measures a recording, its control and every candidate.
///
/// # Errors
/// When the stated effects cannot be combined, or no block of pixels has enough events.
pub fn compare(case: &Case, nominal: &Nominal, scales: &Scales, setting: &LikelihoodSetting) -> Result<Comparison, String> {
    let sample = Sample::blocks(case, setting.zones, setting.side, setting.margin, setting.events);
    if sample.is_empty() {
        let (LikelihoodSetting { side, .. }, (least, most)) = (setting, setting.events);
        return Err(format!(
            "no block of {side} x {side} pixels has between {least} and {most} events a pixel, so nothing can be scored; record more change, or for longer"
        ));
    }
    let conditions = Conditions { seed: setting.seed, frame_share: 0.003, frame_dn: 0.3, is_mixed: false };
    let Faithful { scene, priors, agreement } = faithful(case, nominal, &sample, &setting.scene)?;
    let bench = Bench { case, nominal, sample: &sample, setting: &setting.scene, scales, conditions, priors: &priors };
    let data = bench.measure_scene(case, &scene)?;
    let (_, control) = bench.expect(&scene, &Trial::stated(nominal))?;
    let mut comparison = Comparison { data, control, expected: Vec::new(), agreement, calibration: Vec::new() };
    for (candidate, strength) in comparison.first_strengths() {
        comparison.simulate(&bench, &scene, candidate, strength);
    }
    for count in setting.refined {
        let mut best: Vec<(usize, f64, f64)> = comparison.matches();
        best.sort_by(|a, b| b.2.total_cmp(&a.2).then(a.0.cmp(&b.0)));
        let again: Vec<(Expected, f64)> = best.into_iter().take(count).map(|(n, share, _)| (comparison.expected[n].clone(), share)).collect();
        for (one, share) in again {
            let kind = &CANDIDATES[one.candidate];
            let share = if share > 0.0 { share.clamp(0.3, 3.0) } else { share.clamp(-3.0, -0.3) };
            let share = if kind.signs == Signs::Switch || (kind.signs != Signs::Both && share < 0.0) { 1.0 } else { share };
            comparison.simulate(&bench, &scene, one.candidate, (one.strength * share).clamp(-6.0, 6.0));
        }
    }
    for candidate in comparison.leading(setting.calibrated) {
        let found = comparison.fitted(candidate);
        if CANDIDATES[candidate].signs != Signs::Switch
            && let Some(again) = found.and_then(|strength| comparison.find_again(&bench, &scene, candidate, strength))
        {
            comparison.calibration.push((candidate, found.map_or(1.0, |strength| (strength / again).clamp(1.0 / LARGEST_CALIBRATION, LARGEST_CALIBRATION))));
        }
    }
    Ok(comparison)
}

/// Strengths are corrected by no more than this factor.
const LARGEST_CALIBRATION: f64 = 3.0;

impl Comparison {
    /// The candidates of the best matches, one for each effect.
    fn leading(&self, count: usize) -> Vec<usize> {
        let mut best = self.matches();
        best.sort_by(|a, b| b.2.total_cmp(&a.2).then(a.0.cmp(&b.0)));
        let mut leading: Vec<usize> = Vec::new();
        for (n, ..) in best {
            let candidate = self.expected[n].candidate;
            if leading.len() < count && leading.iter().all(|&other| CANDIDATES[other].id != CANDIDATES[candidate].id) {
                leading.push(candidate);
            }
        }
        leading
    }

    /// The strength at which a candidate matches best.
    fn fitted(&self, candidate: usize) -> Option<f64> {
        let n = self.expected.iter().position(|expected| expected.candidate == candidate)?;
        self.matches().get(n).map(|(_, share, _)| share * self.expected[n].strength).filter(|strength| strength.abs() > 1e-3)
    }

    /// What all of this finds of a candidate's strength in a simulated recording where it is known: the light takes over a part of every effect, here as in the recording.
    fn find_again(&self, bench: &Bench<'_>, scene: &Scene, candidate: usize, strength: f64) -> Option<f64> {
        let mut trial = Trial::stated(bench.nominal);
        CANDIDATES[candidate].put_on(&mut trial, strength, bench.scales);
        let case = record(bench.case, &trial.nominal, bench.sample, scene, &trial.effects, &bench.conditions).ok()?;
        let Faithful { scene, priors, agreement } = faithful(&case, bench.nominal, bench.sample, bench.setting).ok()?;
        let conditions = Conditions { seed: bench.conditions.seed + 1, ..bench.conditions };
        let bench = Bench { priors: &priors, conditions, ..*bench };
        let data = bench.measure_scene(&case, &scene).ok()?;
        let (_, control) = bench.expect(&scene, &Trial::stated(bench.nominal)).ok()?;
        let mut known = Comparison { data, control, expected: Vec::new(), agreement, calibration: Vec::new() };
        let mut found = 0.7 * strength;
        for _round in 0..3 {
            known.simulate(&bench, &scene, candidate, found);
            found = known.fitted(candidate)?;
        }
        (found / strength > 0.0).then_some(found)
    }

    /// Simulates a candidate on some light at a strength; it takes the place of what was there of it.
    fn simulate(&mut self, bench: &Bench<'_>, light: &Scene, candidate: usize, strength: f64) {
        let mut trial = Trial::stated(bench.nominal);
        CANDIDATES[candidate].put_on(&mut trial, strength, bench.scales);
        // One that cannot be combined with what the description states is no candidate.
        if let Ok((_, measured)) = bench.expect(light, &trial) {
            self.expected.retain(|other| other.candidate != candidate);
            self.expected.push(Expected { candidate, strength, measured });
        }
    }

    /// Every candidate, with a strength to begin with: what a linear step finds, within bounds.
    fn first_strengths(&self) -> Vec<(usize, f64)> {
        let (data, control) = (self.data.sum().responses(), self.control.sum().responses());
        let strength = |candidate: usize| {
            let kind = &CANDIDATES[candidate];
            let found = self.data.columns.iter().position(|&column| column == candidate).map_or(1.0, |j| data[j] - control[j]);
            let size = (1.2 * found.abs()).clamp(0.4, 2.0);
            match kind.signs {
                Signs::Both => size.copysign(found),
                Signs::Positive if !kind.is_random => size,
                _ => 1.0,
            }
        };
        (0..CANDIDATES.len()).map(|candidate| (candidate, strength(candidate))).collect()
    }

    /// Of each simulated candidate: by how much its strength is to be multiplied, and twice the log density that it adds.
    fn matches(&self) -> Vec<(usize, f64, f64)> {
        let parts = parts(&self.data, &self.control);
        let of = |(n, expected): (usize, &Expected)| {
            let (along, square) = matched(&parts, &expected.measured, |_| true);
            let is_physics = CANDIDATES[expected.candidate].signs == Signs::Both || along > 0.0;
            (n, along / square, if is_physics { along * along / square } else { 0.0 })
        };
        self.expected.iter().enumerate().map(of).collect()
    }
}

/// `a b` and `b b`.
fn products(a: &[f64], b: &[f64]) -> (f64, f64) {
    a.iter().zip(b).fold((0.0, 1e-12), |(along, square), (a, b)| (along + a * b, square + b * b))
}

/// One linear step of a column: strength in the data less that in the control, and information.
fn step(data: &Features, control: &Features, j: usize) -> (f64, f64, f64) {
    let at = |of: &Features| {
        let information = of.information.get(pair(j, j)).copied().unwrap_or(0.0);
        if information > 0.0 { of.values[j] / information } else { 0.0 }
    };
    (at(data) - at(control), at(data), data.information.get(pair(j, j)).copied().unwrap_or(0.0))
}

/// From what was measured to what is said.
pub fn judge(comparison: &Comparison, nominal: &Nominal, scales: &Scales, setting: &LikelihoodSetting) -> Likelihood {
    let Comparison { data, control, expected, agreement, calibration } = comparison;
    let zones = setting.zones.0 as usize;
    let half = |block: usize| (block % zones + block / zones) % 2;
    let parts = parts(data, control);
    let sums = Part::new(0, &data.sum(), &control.sum());
    let events = f64::max(data.sum().counts[0], 1.0);
    let mut proposals: Vec<Proposal> = Vec::new();
    for one in expected {
        let kind = &CANDIDATES[one.candidate];
        let (along, square) = matched(&parts, &one.measured, |_| true);
        if along <= 0.0 {
            continue;
        }
        // From one half of the blocks to the other.
        let shares = [0, 1].map(|side| {
            let (along, square) = matched(&parts, &one.measured, |block| half(block) == side);
            (along / square, along, square)
        });
        let gain = |share: f64, along: f64, square: f64| share * along - 0.5 * share * share * square;
        let heldout_nats = gain(shares[0].0, shares[1].1, shares[1].2) + gain(shares[1].0, shares[0].1, shares[0].2);
        let better = parts.iter().filter(|part| {
            let (along, square) = matched(&parts, &one.measured, |block| block == part.block);
            gain(shares[1 - half(part.block)].0, along, square) > 0.0
        });
        let blocks_better = better.count() as f64 / f64::max(parts.len() as f64, 1.0);
        // What was not tried itself is found too small as the best was.
        let by = calibration.iter().find(|(candidate, _)| *candidate == one.candidate).or(calibration.first()).map_or(1.0, |(_, by)| *by);
        let share = by * along / square;
        let is_switch = kind.signs == Signs::Switch;
        let at = |share: f64| if is_switch { 1.0 } else { kind.value(one.strength * share, scales, nominal) };
        let sigma = 1.96 * by / libm::sqrt(square);
        let (low, high) = (at(f64::max(share - sigma, 0.0)), at(share + sigma));
        proposals.push(Proposal {
            candidate: one.candidate,
            label: kind.label(),
            strength: if is_switch { 1.0 } else { one.strength * share },
            value: at(share),
            ci95: [f64::min(low, high), f64::max(low, high)],
            statistic: along * along / square,
            statistic_of_sums: {
                let (along, square) = products(&sums.found, &sums.metric.whitened(&less(&one.measured.sum().responses(), &sums.control)));
                if along > 0.0 { along * along / square } else { 0.0 }
            },
            heldout_nats,
            heldout_nats_per_event: heldout_nats / events,
            blocks_better,
        });
    }
    proposals.sort_by(|a, b| b.statistic.total_cmp(&a.statistic).then(a.candidate.cmp(&b.candidate)));
    let mut seen: Vec<&str> = Vec::new();
    proposals.retain(|proposal| {
        let id = CANDIDATES[proposal.candidate].id;
        let is_first = !seen.contains(&id);
        seen.push(id);
        is_first
    });
    let first = proposals.first();
    let loudest = proposals.iter().fold(0.0, |most, proposal| f64::max(most, proposal.statistic_of_sums));
    let is_alarm =
        loudest > setting.least_statistic && first.is_some_and(|first| first.heldout_nats > setting.least_nats && first.blocks_better > setting.least_share);
    let best = first.map_or(0.0, |first| first.statistic);
    let also_possible = proposals.iter().skip(1).filter(|other| is_alarm && other.statistic > setting.alike * best).map(|other| other.label.clone()).collect();
    Likelihood {
        is_alarm,
        also_possible,
        detectability: detectability(data, control, nominal, scales),
        dispersion: data.sum().dispersion,
        control_dispersion: control.sum().dispersion,
        pixels: data.scores.pixels.len(),
        measurements: data.scores.pixels.iter().map(|pixel| pixel.count).sum(),
        pair: best_pair(&parts.iter().map(|part| part.found.clone()).collect::<Vec<_>>(), &responses(&parts, expected), |n| half(parts[n].block)),
        agreement: *agreement,
        total: parts.iter().flat_map(|part| &part.found).map(|z| z * z).sum(),
        proposals,
    }
}

/// One block of a recording against the control.
struct Part {
    block: usize,
    metric: Metric,
    /// What the recording has beyond the control, in standard deviations.
    found: Vec<f64>,
    control: Vec<f64>,
}

impl Part {
    fn new(block: usize, data: &Features, control: &Features) -> Part {
        let control = control.responses();
        let moved = less(&data.responses(), &control);
        let metric = data.metric(&moved);
        Part { block, found: metric.whitened(&moved), metric, control }
    }
}

/// Every block that both have.
fn parts(data: &Measured, control: &Measured) -> Vec<Part> {
    let both = data.blocks.iter().zip(&control.blocks).enumerate();
    both.filter(|(_, (data, control))| data.counts[0] > 0.0 && control.counts[0] > 0.0)
        .map(|(block, (data, control))| Part::new(block, data, control))
        .collect()
}

/// What each candidate makes of each block, in standard deviations.
fn responses(parts: &[Part], expected: &[Expected]) -> Vec<Responses> {
    let white = |part: &Part, one: &Expected| part.metric.whitened(&less(&one.measured.blocks[part.block].responses(), &part.control));
    let of = |one: &Expected| Responses { candidate: one.candidate, strength: one.strength, blocks: parts.iter().map(|part| white(part, one)).collect() };
    expected.iter().map(of).collect()
}

/// The products of what was found and what a candidate makes, and of that with itself, block by block: a block's light, speed and place are the same in both.
fn matched(parts: &[Part], expected: &Measured, keep: impl Fn(usize) -> bool) -> (f64, f64) {
    parts.iter().filter(|part| keep(part.block)).fold((0.0, 1e-12), |sum, part| {
        let (along, square) = products(&part.found, &part.metric.whitened(&less(&expected.blocks[part.block].responses(), &part.control)));
        (sum.0 + along, sum.1 + square)
    })
}

fn less(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

fn detectability(data: &Measured, control: &Measured, nominal: &Nominal, scales: &Scales) -> Vec<Detectable> {
    let (sum, sum_control) = (data.sum(), control.sum());
    let mut raw = vec![0.0; data.columns.len()];
    for pixel in &data.scores.pixels {
        raw.iter_mut().zip(&pixel.raw).for_each(|(sum, value)| *sum += value);
    }
    let of = |(j, &candidate): (usize, &usize)| {
        let kind = &CANDIDATES[candidate];
        let (strength, _, information) = step(&sum, &sum_control, j);
        let share = if raw[j] > 0.0 { information / raw[j] } else { 0.0 };
        let unit = (kind.value(1.0, scales, nominal) - kind.nominal_value(nominal)).abs();
        let standard_error = unit * libm::sqrt(sum.dispersion / f64::max(information, 1e-12));
        let why = if raw[j] <= 0.0 {
            Some("it changes nothing in this recording".to_owned())
        } else if share < LEAST_SHARE {
            Some(format!("the light of the scene could do the same: {:.1} % of what it changes is left", 100.0 * share))
        } else {
            None
        };
        Detectable {
            candidate,
            label: kind.label(),
            estimate: if kind.signs == Signs::Switch { 0.0 } else { kind.nominal_value(nominal) + strength * unit },
            standard_error,
            minimal_detectable: 2.92 * standard_error,
            share,
            not_testable: why,
        }
    };
    data.columns.iter().enumerate().map(of).collect()
}
