//! Which effects explain the events, on a scene that frames alone (or the user) state.
//!
//! 1. Events count where the scene predicts the frames around them ([`photocurrent_scene::gate`]).
//! 2. Every effect of the catalogue that has a size gets a column: what a small effect size of it changes of
//!    every residual. It is fitted with its own noise and judged on the half of the blocks that it was not
//!    fitted to (`table`).
//! 3. The best are evaluated exactly, at their size, until it moves no more.
//! 4. A control goes the same way (`control`): what it gains is what a regularised picture costs,
//!    and every gain and size is counted from there.
//! 5. Random effects are parts of the residuals' distribution (`components`); what no effect has is
//!    free per bin of every covariate (`open`).
//! 6. With the best one applied, all others are fitted again, its own size with them.

use super::EventResiduals;
use super::chance::{RandomEffects, noise_gain};
use super::components::{ComponentData, VarianceComponent, variance_components};
use super::control::{ControlScene, control};
use super::evidence::{RankedEffect, SceneEvidence};
use super::fit::EventNoise;
use super::open::{self, CovariateCurve};
use super::setting::{DEPENDENCES, EvidenceSetting, KNOWN_STEP_NS, LEAST_NOISE, LEAST_SPREAD};
use super::table::{ResidualTable, SceneRecording, median_share};
use crate::candidates::{CANDIDATES, EffectScales, Trial};
use crate::rhythm::{ResidualRhythm, strongest_period_ns};
use photocurrent_scene::case::Case;
use photocurrent_scene::gate::PredictionGate;
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::{Scene, gate};
use std::borrow::Cow;

/// Ranks the effects of the catalogue by how much they explain of a recording's events.
///
/// # Errors
/// When the scene predicts too few of the events' frames, or stated effects cannot be combined.
pub fn evidence(
    case: &Case,
    nominal: &Nominal,
    source: &dyn Scene,
    setting: &EvidenceSetting,
) -> Result<SceneEvidence, String> {
    let scales = EffectScales::from_case(case, nominal);
    let (gate, counted, share) = counted_events(case, source, setting)?;
    let pixels = spread_pixels(case, &counted, setting.events, setting.pixels);
    let more = spread_pixels(case, &counted, 5 * setting.events, 3 * setting.pixels);
    let step_ns = setting.step.ns().min(if source.is_known() { KNOWN_STEP_NS } else { i64::MAX });
    let mut seen = on_scene(case, source, setting, &scales, gate, step_ns, [pixels, more]);
    let stated = Trial::nominal(nominal);

    let control_case = control_recording(&seen, nominal)?;
    let control_source = source.refit(&control_case, nominal)?;
    let control_gate = control_source.gate(&control_case, gate::LEAST_DN, gate::SPREAD);
    let pixels = [seen.pixels.clone(), seen.more.clone()];
    let control_seen =
        on_scene(&control_case, &*control_source, setting, &scales, control_gate, step_ns, pixels);
    let mut control_table = control_seen.table(&stated, None, 0.0)?;
    let softest = setting.softness * control_table.softness();
    control_table.fit(softest);
    let table = seen.table(&stated, None, softest)?;
    enough_left(&table, &control_table, setting)?;

    let rhythm = rhythm_of(case, &table.events, table.residual());
    let control_dependences = control_seen
        .dependences(&control_table, &control_seen.covariates_of_rows(&control_table, nominal, rhythm)[0]);
    let slope_per_s = median_slope(&table);
    let control_white = control_seen.noise_share(&stated, control_source.as_ref())?;
    let chance = of_chance(&seen, nominal, &control_table, control_white, slope_per_s);
    let ranking = Ranking {
        nominal,
        stated: &stated,
        control_table: &control_table,
        control_dependences: &control_dependences,
        chance: &chance,
        rhythm,
        step_ns,
        softest,
    };

    let base = ranking.rank_effects(&seen, &table, &stated, None, setting.refined)?;
    let base_median = left_of(&seen, &table);
    // On a fitted scene, what it gets wrong widens residuals, and its noise is the control's.
    let noise_of = |round: &RankingRound| if source.is_known() { noise_gain(&round.random) } else { 0.0 };
    let mut noise = [noise_of(&base), 0.0];
    let first = base.best(noise[0]).cloned();
    let (mut left, mut after) = ([base_median; 2], RankingRound::default());
    if let Some(first) = &first {
        (after, left) = ranking.with_first(&mut seen, &table, &base.parts, first)?;
        noise[1] = noise_of(&after);
    }
    let lists = [base.ranked, after.ranked, base.random, after.random];
    let [ranked, second, random, random_second] = lists.map(|list| mark_measurable(case, nominal, list));
    Ok(SceneEvidence {
        scene: source.name().to_owned(),
        nats_per_event: table.nats_per_event,
        share,
        events: table.residual().len(),
        median: base_median,
        control_median: left_of(&seen, &control_table),
        ks: control_table.noise.distance(table.sharp(), &table.events.slope_per_s),
        left,
        slope_per_s,
        white: base.white,
        softness: [softest, table.softness()],
        misfit: source.misfit(),
        noise,
        ranked,
        first,
        second,
        random,
        random_second,
        open: base.open,
        open_second: after.open,
        ..SceneEvidence::default()
    })
}

/// Where the scene predicts the frames, how many events of each pixel it predicts them around, and their
/// share of all events; an error when they are too few.
fn counted_events(
    case: &Case,
    source: &dyn Scene,
    setting: &EvidenceSetting,
) -> Result<(PredictionGate, Vec<usize>, f64), String> {
    let gate = source.gate(case, gate::LEAST_DN, gate::SPREAD);
    let all = case.events.len();
    let counted: Vec<usize> = (0..case.extent.pixels())
        .map(|pixel| {
            case.events.of_pixel(pixel).iter().filter(|event| gate.accepts(pixel, event.t_in_ns)).count()
        })
        .collect();
    let kept: usize = counted.iter().sum();
    let share = kept as f64 / all.max(1) as f64;
    if kept < setting.least_events || share < setting.least_share {
        return Err(format!(
            "the scene predicts the frames around {kept} of {all} events; {} and {:.0} % are needed",
            setting.least_events,
            100.0 * setting.least_share
        ));
    }
    Ok((gate, counted, share))
}

/// A recording with its scene, its free parameters unchanged. `pixels`: those with residuals, and those for
/// pairs.
fn on_scene<'a>(
    case: &'a Case,
    source: &'a dyn Scene,
    setting: &'a EvidenceSetting,
    scales: &'a EffectScales,
    gate: PredictionGate,
    step_ns: i64,
    pixels: [Vec<u32>; 2],
) -> SceneRecording<'a> {
    let [pixels, more] = pixels;
    let mut seen = SceneRecording {
        case,
        light: source.light(case, step_ns),
        gate,
        pixels,
        more,
        setting,
        scales,
        least: LEAST_NOISE * scales.threshold,
        is_known: source.is_known(),
        source,
        by: vec![0.0; source.target().map_or(0, |target| target.free().len())],
        near: Vec::new(),
        own: Vec::new(),
    };
    seen.near = seen.steps(&seen.by);
    seen
}

/// The control of a recording: the stated sensor before a scene that looks like this one.
fn control_recording(seen: &SceneRecording<'_>, nominal: &Nominal) -> Result<Case, String> {
    let (setting, source) = (seen.setting, seen.source);
    let mut simulated: Vec<u32> = seen.more.iter().chain(&seen.pixels).copied().collect();
    simulated.sort_unstable();
    simulated.dedup();
    let behind = ControlScene::looking_like(seen.case, nominal, source, &seen.light, setting.seed)?;
    control(seen.case, nominal, source, &behind, &simulated, setting.block, setting.seed)
}

/// An error when too few events of the recording or of its control have residuals.
fn enough_left(
    table: &ResidualTable,
    control_table: &ResidualTable,
    setting: &EvidenceSetting,
) -> Result<(), String> {
    let events = table.residual().len();
    if events < setting.least_events / 5 {
        return Err(format!(
            "only {events} of the events looked at follow another one that the scene explains as well; \
             {} are needed",
            setting.least_events / 5
        ));
    }
    let control_events = control_table.residual().len();
    if control_events < setting.least_events / 5 {
        return Err(format!(
            "only {control_events} events of the control count, the stated sensor on this scene; {} are \
             needed",
            setting.least_events / 5
        ));
    }
    Ok(())
}

/// The rhythm in which residuals swing most, apart from that of the frames: of events, or of the resets
/// before them.
pub(super) fn rhythm_of(case: &Case, events: &EventResiduals, residual: &[f64]) -> Option<ResidualRhythm> {
    let frame_ns =
        case.frames.as_ref().and_then(|frames| frames.times.mean_period_ns()).map(|period| period as i64);
    let of = |is_at_reset: bool| {
        let instant = |k: usize| events.t_ns[k] - if is_at_reset { events.since_ns[k] } else { 0 };
        let swing =
            residual.iter().enumerate().map(|(k, left)| (instant(k), f64::from(events.polarity[k]) * left));
        let (period_ns, power) = strongest_period_ns(swing, case.span, frame_ns)?;
        Some((ResidualRhythm { period_ns, is_at_reset }, power))
    };
    let found = [of(false), of(true)].into_iter().flatten();
    found.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(rhythm, _)| rhythm)
}

/// Median slope of the voltage at the events, ln/s.
fn median_slope(table: &ResidualTable) -> f64 {
    let mut slopes: Vec<f64> = table.events.slope_per_s.iter().map(|slope| slope.abs()).collect();
    slopes.sort_by(f64::total_cmp);
    slopes.get(slopes.len() / 2).copied().unwrap_or(0.0)
}

/// Median absolute residual over the threshold; 0 on a known scene.
fn left_of(seen: &SceneRecording<'_>, table: &ResidualTable) -> f64 {
    median_share(if seen.is_known { table.sharp() } else { table.residual() }, seen.scales.threshold)
}

/// Marks effects of a material size.
fn mark_measurable(case: &Case, nominal: &Nominal, mut list: Vec<RankedEffect>) -> Vec<RankedEffect> {
    list.iter_mut()
        .for_each(|one| one.is_material = CANDIDATES[one.candidate].is_material(case, nominal, one.value));
    list
}

/// All effects on top of one sensor.
#[derive(Default)]
struct RankingRound {
    /// With a size, best first.
    ranked: Vec<RankedEffect>,
    /// Random ones, best first.
    random: Vec<RankedEffect>,
    /// And the parts that they are.
    parts: Vec<VarianceComponent>,
    /// Uncatalogued curves.
    open: Vec<CovariateCurve>,
    /// Share of the squares of residuals that is noise of pixels.
    white: f64,
}

impl RankingRound {
    /// The best of all, where wider noise of events alone gains `noise`.
    fn best(&self, noise: f64) -> Option<&RankedEffect> {
        let found = |one: &&RankedEffect| one.is_exact && one.gain_beyond_control() > 0.0;
        let best = |a: &&RankedEffect, b: &&RankedEffect| {
            b.gain_beyond_noise(noise)
                .total_cmp(&a.gain_beyond_noise(noise))
                .then(RankedEffect::by_gain(a, b))
        };
        self.ranked.iter().filter(found).chain(self.random.iter().filter(found)).min_by(best)
    }
}

/// Data that the rounds on one recording share.
struct Ranking<'a> {
    nominal: &'a Nominal,
    /// The sensor as it is described.
    stated: &'a Trial,
    control_table: &'a ResidualTable,
    control_dependences: &'a [CovariateCurve],
    chance: &'a RandomEffects<'a>,
    rhythm: Option<ResidualRhythm>,
    step_ns: i64,
    softest: f64,
}

impl Ranking<'_> {
    /// All effects on top of a sensor and its table; `first`: an effect that the sensor has, and its size.
    fn rank_effects(
        &self,
        seen: &SceneRecording<'_>,
        table: &ResidualTable,
        trial: &Trial,
        first: Option<(usize, f64)>,
        refined: usize,
    ) -> Result<RankingRound, String> {
        let laid = seen.covariates_of_rows(table, self.nominal, self.rhythm);
        let places = seen.gain_locator(table, &laid);
        let ranked =
            seen.rank(self.stated, table, self.control_table, first, refined, self.nominal, &places)?;
        let white = seen.noise_share(trial, seen.source)?;
        let columns = table.pixel_columns();
        let (random, parts) =
            self.chance.rank_beyond_control(&ground(table, &columns, white, seen.scales.threshold));
        let mut open = seen.dependences(table, &laid[0]);
        open::subtract_control_gains(&mut open, self.control_dependences);
        open.truncate(DEPENDENCES);
        if let Some(best) = open.first_mut() {
            seen.locate_dependence(table, &laid[0], &places, best);
        }
        Ok(RankingRound { ranked, random, parts, open, white })
    }

    /// All other effects with the first one applied, and the misfits with the first and with both. `table`,
    /// `parts`: without it.
    fn with_first(
        &self,
        seen: &mut SceneRecording<'_>,
        table: &ResidualTable,
        parts: &[VarianceComponent],
        first: &RankedEffect,
    ) -> Result<(RankingRound, [f64; 2]), String> {
        let is_random = CANDIDATES[first.candidate].is_random;
        let effect_size = first.effect_size + first.control_effect_size;
        let with = if is_random {
            self.stated.clone()
        } else {
            self.stated.with_effect(&CANDIDATES[first.candidate], effect_size, seen.scales)
        };
        let shifted = parts
            .iter()
            .find(|part| is_random && part.candidate == first.candidate)
            .and_then(|part| part.left.as_ref());
        if let Some(left) = shifted {
            // Each pixel with its own size, each event with its mean delay from here on.
            seen.own = table.sharp().iter().zip(left).map(|(base, left)| (base - left) as f32).collect();
        }
        if !is_random
            && let Some(light) = seen
                .source
                .target()
                .and_then(|target| target.moved_light(seen.case, self.step_ns, None, &first.by))
        {
            (seen.by, seen.light) = (first.by.clone(), light);
            seen.near = seen.steps(&seen.by);
        }
        let table = seen.table(&with, Some(first.candidate), self.softest)?;
        let mut left = [left_of(seen, &table); 2];
        let first_effect = (!is_random).then_some((first.candidate, effect_size));
        let mut round = self.rank_effects(seen, &table, &with, first_effect, seen.setting.refined_second)?;
        round.random.retain(|other| other.candidate != first.candidate);
        if let Some(other) = round.ranked.first().filter(|other| other.is_exact) {
            left[1] = other.left;
        }
        Ok((round, left))
    }
}

/// Random effects of a recording, counted from its control.
fn of_chance<'a>(
    seen: &SceneRecording<'a>,
    nominal: &'a Nominal,
    control: &ResidualTable,
    white: f64,
    slope_per_s: f64,
) -> RandomEffects<'a> {
    let SceneRecording { case, scales, is_known, .. } = *seen;
    let least = LEAST_NOISE * scales.threshold;
    let noise = EventNoise::estimate(control.sharp(), &control.events.slope_per_s, least);
    let control =
        variance_components(&ground(control, &control.pixel_columns(), white, scales.threshold), &noise);
    RandomEffects { case, scales, nominal, is_known, slope_per_s, noise, control }
}

/// Data of the variance components of a table's residuals. `columns`: [`ResidualTable::pixel_columns`].
fn ground<'a>(
    table: &'a ResidualTable,
    columns: &'a [Cow<'a, [f32]>; 2],
    white: f64,
    threshold: f64,
) -> ComponentData<'a> {
    ComponentData {
        events: &table.events,
        residual: table.sharp(),
        columns: [&columns[0], &columns[1]],
        white,
        threshold,
        least: LEAST_NOISE * threshold,
        errs: false,
        least_spread: LEAST_SPREAD,
    }
}

/// Pixels spread over the array, about `pixels` at most, whose events that count are about `events` in all at
/// most.
fn spread_pixels(case: &Case, counted: &[usize], events: usize, pixels: usize) -> Vec<u32> {
    let width = case.extent.width as usize;
    let all: usize = counted.iter().sum();
    let lit = counted.iter().filter(|count| **count > 0).count();
    let step = usize::max(all / events.max(1), lit / pixels.max(1)).max(1);
    // Another column from row to row, so that all columns are seen.
    let turn =
        (1..=step).find(|turn| step == 1 || (turn * turn > step && gcd(*turn, step) == 1)).unwrap_or(1);
    (0..counted.len())
        .filter(|&pixel| (pixel % width + turn * (pixel / width)).is_multiple_of(step) && counted[pixel] > 0)
        .map(|pixel| pixel as u32)
        .collect()
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}
