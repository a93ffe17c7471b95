//! Which effect explains the events, when frames alone state the scene.
//!
//! 1. A moving picture is fitted to the frames ([`crate::picture`]); events count where it predicts the frames around them.
//! 2. Every effect of the catalogue that has a size gets a column: what a small strength of it changes of every residual. It is fitted with its own noise and judged on
//!    the half of the blocks that it was not fitted to.
//! 3. The best are evaluated exactly, at their size, until it moves no more.
//! 4. A control goes the same way: the nominal sensor, simulated on the fitted scene, its frames with the noise that was found, fitted again. What it gains is what a
//!    regularised picture costs, and every gain and size is counted from there.
//! 5. With the best one applied, all others are fitted again.
//!
//! 6. Random effects are parts of the residuals' distribution ([`super::components`]).
//!
//! Limits: a scene without one motion leaves few events, and then this method abstains.

use super::components::{Ground, parts, value as part_value, white_share};
use super::fit::{EventNoise, Fitted, gain_of, heldout};
use super::gate::Gate;
use super::light::Light;
use super::source::{Cell, Source};
use super::{Residuals, View};
use crate::candidates::{CANDIDATES, Candidate, Scales, Signs, Trial};
use crate::case::{Case, CaseFrames};
use crate::likelihood::view::Prepared;
use crate::nominal::Nominal;
use crate::record::{Conditions, Described, record};
use crate::sample::Sample;
use crate::scene::Scene;
use photocurrent_core::random::Random;
use serde::{Deserialize, Serialize};

/// How the method works.
#[derive(Clone, Copy, Debug)]
pub struct MovingSetting {
    /// Light is sampled this often, ns.
    pub step_ns: i64,
    /// About so many events are looked at.
    pub events: usize,
    /// Of at most so many pixels.
    pub pixels: usize,
    /// Fewer events than this are no evidence.
    pub least_events: usize,
    /// Nor is a smaller share of all events.
    pub least_share: f64,
    /// A place is predicted when frames miss by less than this, DN, or by [`MovingSetting::spread`] median absolute deviations.
    pub least_dn: f64,
    /// See there.
    pub spread: f64,
    /// Side of the blocks for held-out gains, pixels.
    pub block: usize,
    /// Least threshold noise, as a share of the threshold.
    pub least_noise: f64,
    /// Strength of the finite differences, as a share of a usual one.
    pub probe: f64,
    /// So many of the best are evaluated exactly.
    pub refined: usize,
    /// In so many rounds.
    pub rounds: usize,
    /// Events within one cell of the picture see the same of it, pixels.
    pub cell: f64,
    /// Seed of the control.
    pub seed: u64,
}

impl Default for MovingSetting {
    fn default() -> MovingSetting {
        MovingSetting {
            step_ns: 100_000,
            events: 10_000,
            pixels: 1_000,
            least_events: 500,
            least_share: 0.05,
            least_dn: 1.0,
            spread: 4.5,
            block: 8,
            least_noise: 1e-3,
            probe: 0.05,
            refined: 6,
            rounds: 3,
            cell: 0.5,
            seed: 1,
        }
    }
}

/// One effect, as the events see it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ranked {
    /// Number in [`CANDIDATES`].
    pub candidate: usize,
    /// Its size, in strengths, less what the control finds.
    pub strength: f64,
    /// Standard error, strengths.
    pub error: f64,
    /// The parameter, in the unit of its declaration.
    pub value: f64,
    /// Held-out gain over the nominal sensor, nats per event.
    pub gain: f64,
    /// Its standard error.
    pub gain_error: f64,
    /// The same of the control.
    pub control_gain: f64,
    /// And the size that the control finds, strengths.
    pub control_strength: f64,
    /// Was it evaluated at its size?
    pub is_exact: bool,
}

impl Ranked {
    /// Held-out gain beyond the control's, nats per event.
    pub fn beyond(&self) -> f64 {
        self.gain - self.control_gain
    }
}

/// What the method found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Moving {
    /// Share of the events that counts.
    pub share: f64,
    /// Events looked at.
    pub events: usize,
    /// Median absolute residual over the threshold.
    pub median: f64,
    /// The same of the control.
    pub control_median: f64,
    /// Median slope of the voltage at the events, ln/s.
    pub slope_per_s: f64,
    /// Share of the squares of residuals that is noise of pixels.
    pub white: f64,
    /// Median absolute residual of frames, standard deviations.
    pub misfit: f64,
    /// Median absolute residual over the threshold with the first effect applied, and with both.
    pub left: [f64; 2],
    /// Best first.
    pub ranked: Vec<Ranked>,
    /// With the first applied, best first.
    pub second: Vec<Ranked>,
    /// Random effects with nothing applied, best first.
    pub random: Vec<Ranked>,
    /// And with the first of [`Moving::ranked`] applied.
    pub random_second: Vec<Ranked>,
}

/// A recording with its scene, ready to be asked.
struct Seen<'a> {
    case: &'a Case,
    light: Light,
    gate: Gate,
    pixels: Vec<u32>,
    /// For what needs pairs of pixels.
    more: Vec<u32>,
    setting: &'a MovingSetting,
    least: f64,
}

/// One base and everything on top of it.
struct Table {
    events: Residuals,
    block: Vec<u32>,
    base: Vec<f64>,
    fitted: Vec<(usize, Fitted)>,
    /// Columns of the threshold's scale and of the refractory period.
    columns: [Vec<f32>; 2],
}

/// Candidates whose columns each pixel may have a size of its own of.
const OF_PIXELS: [(&str, &str); 2] = [("threshold_scale", "fraction"), ("refractory", "refractory")];

impl Seen<'_> {
    fn evaluate(&self, trials: &[Trial]) -> Result<(Residuals, Vec<Vec<f32>>), String> {
        let view = View { case: self.case, light: &self.light, pixels: self.pixels.clone() };
        view.residuals(trials, |pixel, t_ns| self.gate.keeps(pixel, t_ns))
    }

    /// The share of the squares of residuals that is noise of pixels ([`white_share`]), on more events than are fitted.
    fn white(&self, base: &Trial, source: &dyn Source) -> Result<f64, String> {
        let view = View { case: self.case, light: &self.light, pixels: self.more.clone() };
        let (events, _) = view.residuals(std::slice::from_ref(base), |pixel, t_ns| self.gate.keeps(pixel, t_ns))?;
        let cell = |(pixel, t_ns): (&u32, &i64)| source.cell(self.case, *pixel as usize, *t_ns, self.setting.cell);
        let cells: Vec<Cell> = events.pixel.iter().zip(&events.t_ns).map(cell).collect();
        Ok(white_share(&events, &events.excess, &cells))
    }

    fn block_of(&self, pixel: usize) -> u32 {
        let (width, side) = (self.case.extent.width as usize, self.setting.block);
        let (bx, by) = (pixel % width / side, pixel / width / side);
        (2 * (by * width.div_ceil(side) + bx) + (bx + by) % 2) as u32
    }

    /// First-order fits of every effect on top of a trial, but for one candidate.
    fn table(&self, base: &Trial, scales: &Scales, without: Option<usize>) -> Result<Table, String> {
        // One that cannot be combined with what is there is no candidate.
        let can_be = |n: &usize| Prepared::new(self.case, &on_top(base, *n, self.probe(*n), scales)).is_ok();
        let chosen: Vec<usize> = (0..CANDIDATES.len()).filter(|&n| !CANDIDATES[n].is_random && Some(n) != without).filter(can_be).collect();
        let mut trials = vec![base.clone()];
        trials.extend(chosen.iter().map(|&n| on_top(base, n, self.probe(n), scales)));
        let (events, values) = self.evaluate(&trials)?;
        let block: Vec<u32> = events.pixel.iter().map(|pixel| self.block_of(*pixel as usize)).collect();
        let base: Vec<f64> = values[0].iter().map(|e| f64::from(*e)).collect();
        let fitted = chosen
            .iter()
            .zip(&values[1..])
            .map(|(&n, with)| {
                let column = self.column(n, with, &values[0]);
                (n, heldout(&base, &events.slope_per_s, &[&column], &block, self.least))
            })
            .collect();
        let columns = OF_PIXELS.map(|(id, parameter)| {
            let at = chosen.iter().position(|&n| CANDIDATES[n].id == id && CANDIDATES[n].parameter == parameter);
            at.map_or_else(|| vec![0.0; base.len()], |at| self.column(chosen[at], &values[1 + at], &values[0]))
        });
        Ok(Table { events, block, base, fitted, columns })
    }

    fn probe(&self, candidate: usize) -> f64 {
        let kind = &CANDIDATES[candidate];
        match kind.id {
            // A blur grows with the square of its width.
            "blur" => 10.0 * self.setting.probe,
            _ if kind.signs == Signs::Switch || kind.is_limit() => 1.0,
            _ => self.setting.probe,
        }
    }

    fn column(&self, candidate: usize, with: &[f32], base: &[f32]) -> Vec<f32> {
        let probe = self.probe(candidate) as f32;
        with.iter().zip(base).map(|(with, base)| (with - base) / probe).collect()
    }

    /// The size of an effect by Gauss-Newton on its exact model, from a first one; and its gain there.
    fn refine(&self, base: &Trial, table: &Table, candidate: usize, begin: f64, scales: &Scales) -> Result<(f64, f64, f64, f64), String> {
        let kind = &CANDIDATES[candidate];
        let mut strength = if kind.signs == Signs::Switch { 1.0 } else { bounded(candidate, begin) };
        let mut error = 0.0;
        let rounds = if kind.signs == Signs::Switch { 0 } else { self.setting.rounds };
        for _ in 0..rounds {
            let further = strength + self.setting.probe * f64::max(0.2, strength.abs());
            let (_, values) = self.evaluate(&[base.clone(), on_top(base, candidate, strength, scales), on_top(base, candidate, further, scales)])?;
            let column: Vec<f32> = values[2].iter().zip(&values[1]).map(|(a, b)| (a - b) / (further - strength) as f32).collect();
            let left: Vec<f64> = values[1].iter().map(|e| f64::from(*e)).collect();
            let step = heldout(&left, &table.events.slope_per_s, &[&column], &table.block, self.least);
            error = step.error;
            let next = bounded(candidate, strength + step.size.clamp(-1.0 - strength.abs(), 1.0 + strength.abs()));
            let moved = (next - strength).abs();
            strength = next;
            if moved < 0.003 * f64::max(strength.abs(), 0.05) {
                break;
            }
        }
        let (_, values) = self.evaluate(&[base.clone(), on_top(base, candidate, strength, scales)])?;
        let left: Vec<f64> = values[1].iter().map(|e| f64::from(*e)).collect();
        let (gain, gain_error) = gain_of(&table.base, &left, &table.events.slope_per_s, &table.block, self.least);
        Ok((strength, error, gain, gain_error))
    }
}

/// Strengths that a search may reach, within physics.
fn bounded(candidate: usize, strength: f64) -> f64 {
    const MOST: f64 = 12.0;
    let least = if CANDIDATES[candidate].signs == Signs::Both { -MOST } else { 0.0 };
    strength.clamp(least, MOST)
}

fn on_top(base: &Trial, candidate: usize, strength: f64, scales: &Scales) -> Trial {
    let mut trial = base.clone();
    CANDIDATES[candidate].put_on(&mut trial, strength, scales);
    trial
}

fn is_physics(candidate: usize, strength: f64) -> bool {
    CANDIDATES[candidate].signs == Signs::Both || strength > 0.0
}

/// Asks which effects explain the events of a recording.
///
/// # Errors
/// When there are too few frames, the picture predicts too few of the events' frames, or stated effects cannot be combined.
pub fn moving(case: &Case, nominal: &Nominal, source: &dyn Source, setting: &MovingSetting) -> Result<Moving, String> {
    let scales = Scales::of(case, nominal);
    let least = setting.least_noise * scales.threshold;
    let gate = Gate::new(case, source.residual(), setting.least_dn, setting.spread);
    let all = case.events.all().len();
    let counted: Vec<usize> =
        (0..case.extent.pixels()).map(|pixel| case.events.of(pixel).iter().filter(|event| gate.keeps(pixel, event.t_in_ns)).count()).collect();
    let kept: usize = counted.iter().sum();
    let share = kept as f64 / all.max(1) as f64;
    if kept < setting.least_events || share < setting.least_share {
        return Err(format!(
            "the scene predicts the frames around {kept} of {all} events; {} and {:.0} % are needed",
            setting.least_events,
            100.0 * setting.least_share
        ));
    }
    let pixels = spread(case, &counted, setting.events, setting.pixels);
    let more = spread(case, &counted, 5 * setting.events, 3 * setting.pixels);
    let light = source.light(case, setting.step_ns);
    let seen = Seen { case, light, gate, pixels, more, setting, least };
    let stated = Trial::stated(nominal);
    let table = seen.table(&stated, &scales, None)?;
    let control_case = control(case, nominal, source, &seen, setting)?;
    let control_source = source.refit(&control_case, nominal)?;
    let control_gate = Gate::new(&control_case, control_source.residual(), setting.least_dn, setting.spread);
    let control_light = control_source.light(&control_case, setting.step_ns);
    let control_seen =
        Seen { case: &control_case, light: control_light, gate: control_gate, pixels: seen.pixels.clone(), more: seen.more.clone(), setting, least };
    let control_table = control_seen.table(&stated, &scales, None)?;
    let ranked = rank(&seen, &stated, &table, &control_table, &scales, nominal, setting)?;
    let median = |values: &mut dyn Iterator<Item = f64>| {
        let mut sizes: Vec<f64> = values.map(f64::abs).collect();
        sizes.sort_by(f64::total_cmp);
        sizes.get(sizes.len() / 2).copied().unwrap_or(f64::NAN) / scales.threshold
    };
    let base_median = median(&mut table.base.iter().copied());
    let rate = case.events.all().len() as f64 / f64::max(case.extent.pixels() as f64 * scales.duration_s, 1e-9);
    let control_noise = EventNoise::estimate(&control_table.base, &control_table.events.slope_per_s, least);
    let strengths = OF_PIXELS.map(|(id, parameter)| {
        Candidate::find(id, parameter).map_or(0.0, |candidate| candidate.value(1.0, &scales, nominal) - candidate.value(0.0, &scales, nominal))
    });
    let control_white = control_seen.white(&stated, control_source.as_ref())?;
    let random = |base: &Trial, table: &Table| -> Result<Vec<Ranked>, String> {
        let of = |table: &Table, columns: &[Vec<f32>; 2], white: f64| {
            let columns = [&columns[0][..], &columns[1][..]];
            parts(&Ground { events: &table.events, residual: &table.base, columns, white, threshold: scales.threshold, least }, &control_noise)
        };
        let found = of(table, &table.columns, seen.white(base, source)?);
        let control = of(&control_table, &control_table.columns, control_white);
        let mut found: Vec<Ranked> = found
            .iter()
            .zip(&control)
            .map(|(part, control)| Ranked {
                candidate: part.candidate,
                strength: part.size,
                value: part_value(part, control.size, scales.threshold, (strengths[0], strengths[1]), nominal, rate),
                gain: part.gain,
                control_gain: control.gain.max(0.0),
                control_strength: control.size,
                is_exact: true,
                ..Ranked::default()
            })
            .collect();
        found.sort_by(|a, b| b.beyond().total_cmp(&a.beyond()).then(a.candidate.cmp(&b.candidate)));
        Ok(found)
    };
    let white = seen.white(&stated, source)?;
    let random_first = random(&stated, &table)?;
    let mut random_second = Vec::new();
    let mut second = Vec::new();
    let mut left = [base_median; 2];
    if let Some(first) = ranked.first().filter(|first| first.is_exact && first.beyond() > 0.0) {
        let with = on_top(&stated, first.candidate, first.strength, &scales);
        let table = seen.table(&with, &scales, Some(first.candidate))?;
        left = [median(&mut table.base.iter().copied()); 2];
        random_second = random(&with, &table)?;
        second = rank(&seen, &with, &table, &control_table, &scales, nominal, &MovingSetting { refined: 3, ..*setting })?;
        if let Some(other) = second.first().filter(|other| other.is_exact) {
            let (_, values) = seen.evaluate(&[stated.clone(), on_top(&with, other.candidate, other.strength, &scales)])?;
            left[1] = median(&mut values[1].iter().map(|e| f64::from(*e)));
        }
    }
    Ok(Moving {
        share,
        events: table.base.len(),
        median: base_median,
        control_median: median(&mut control_table.base.iter().copied()),
        left,
        slope_per_s: median(&mut table.events.slope_per_s.iter().copied()) * scales.threshold,
        white,
        misfit: source.misfit(),
        ranked,
        second,
        random: random_first,
        random_second,
    })
}

fn rank(
    seen: &Seen<'_>,
    base: &Trial,
    table: &Table,
    control_table: &Table,
    scales: &Scales,
    nominal: &Nominal,
    setting: &MovingSetting,
) -> Result<Vec<Ranked>, String> {
    let mut ranked: Vec<Ranked> = table
        .fitted
        .iter()
        .map(|(candidate, fitted)| {
            let control = control_table.fitted.iter().find(|(n, _)| n == candidate).map(|(_, fitted)| *fitted).unwrap_or_default();
            let strength = fitted.size - control.size;
            let gain = if is_physics(*candidate, fitted.size) { fitted.gain } else { 0.0 };
            let control_gain = if is_physics(*candidate, control.size) { control.gain.max(0.0) } else { 0.0 };
            Ranked {
                candidate: *candidate,
                strength,
                error: fitted.error,
                value: CANDIDATES[*candidate].value(strength, scales, nominal),
                gain,
                gain_error: fitted.gain_error,
                control_gain,
                control_strength: control.size,
                is_exact: false,
            }
        })
        .collect();
    let by_gain = |a: &Ranked, b: &Ranked| b.beyond().total_cmp(&a.beyond()).then(a.candidate.cmp(&b.candidate));
    ranked.sort_by(by_gain);
    let best = ranked.first().map_or(0.0, Ranked::beyond);
    // First order overstates nothing of the best by more than half.
    for one in ranked.iter_mut().take(setting.refined).filter(|one| one.beyond() > 0.3 * best && one.beyond() > 0.0) {
        let (strength, error, gain, gain_error) = seen.refine(base, table, one.candidate, one.strength + one.control_strength, scales)?;
        one.strength = if CANDIDATES[one.candidate].signs == Signs::Switch { strength } else { strength - one.control_strength };
        (one.error, one.gain, one.gain_error, one.is_exact) = (error, gain, gain_error, true);
        one.value = CANDIDATES[one.candidate].value(one.strength, scales, nominal);
    }
    ranked.sort_by(by_gain);
    Ok(ranked)
}

/// Pixels spread over the array, about `pixels` at most, whose events that count are about `events` in all at most.
fn spread(case: &Case, counted: &[usize], events: usize, pixels: usize) -> Vec<u32> {
    let width = case.extent.width as usize;
    let all: usize = counted.iter().sum();
    let lit = counted.iter().filter(|count| **count > 0).count();
    let step = usize::max(all / events.max(1), lit / pixels.max(1)).max(1);
    // Another column from row to row, so that all columns are seen.
    let turn = (1..=step).find(|turn| step == 1 || (turn * turn > step && gcd(*turn, step) == 1)).unwrap_or(1);
    (0..counted.len()).filter(|&pixel| (pixel % width + turn * (pixel / width)).is_multiple_of(step) && counted[pixel] > 0).map(|pixel| pixel as u32).collect()
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// The nominal sensor's recording of the fitted scene: events of the pixels that are looked at, and all frames with the noise that was found.
fn control(case: &Case, nominal: &Nominal, source: &dyn Source, seen: &Seen<'_>, setting: &MovingSetting) -> Result<Case, String> {
    let mut pixels: Vec<u32> = seen.more.iter().chain(&seen.pixels).copied().collect();
    pixels.sort_unstable();
    pixels.dedup();
    let sample = Sample::of_pixels(case, pixels, setting.block as u32);
    let scene = Scene::from_pixels(sample.pixels.iter().map(|&pixel| {
        let log = &seen.light.log[pixel as usize];
        let known = !log.is_empty();
        let t: Vec<i64> = if known { (0..log.len()).map(|k| seen.light.instant(k)).collect() } else { vec![case.span.0] };
        (t, if known { log.iter().map(|u| f64::from(*u)).collect() } else { vec![0.0] }, known)
    }));
    let conditions = Conditions { seed: setting.seed, frame_share: 0.0, frame_dn: 0.0, is_mixed: false };
    let recorded = record(case, nominal, &sample, &scene, &Described::new(), &conditions)?;
    let mut random = Random::new(setting.seed, &[0xc0]);
    let clean = source.frames(case);
    let dn = clean
        .iter()
        .map(|dn| {
            let sigma = source.sigma(nominal, f64::from(*dn) - nominal.number.black_level);
            let noisy = f64::from(*dn) + sigma * random.normal();
            noisy.min(nominal.saturation_dn) as f32
        })
        .collect();
    let frames = case.frames.as_ref().map(|frames| CaseFrames { times: frames.times.clone(), dn });
    Ok(Case { frames, ..recorded })
}
