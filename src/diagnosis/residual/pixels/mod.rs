//! Which effects explain a recording where nothing moves as one: the light of each pixel is free in time
//! ([`photocurrent_scene::pixels`]), and every effect is scored against what that light would take over.
//!
//! 1. Blocks of pixels with many events, spread over the array, and the busiest 0.15 s (`choose`).
//! 2. Light, its prior and the noise with the description as it is (`fit`).
//! 3. Score and information of every effect, summed over pixels: a first size for each, and its gain when the
//!    light follows by one step (`score`).
//! 4. The best are fitted exactly: light and size in turn, and the description for as many rounds; the gain
//!    is that of each event's density in time when the light is estimated from everything else, and of the
//!    probability that none fired between events.
//! 5. With the best one applied, score and information of all others with its own size free.

mod choose;
mod fit;
mod score;

use super::evidence::{Evidence, KINDS, Ranked};
use super::fit::{MEDIAN_T, probability_t};
use super::table::is_physics;
use crate::candidates::{CANDIDATES, Scales, Trial};
use fit::{ERRORS, Exact, Fit, Ground};
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use score::Scored;

/// Rounds with the description as it is, before effects are scored.
const ROUNDS: usize = 11;
/// Corrections of a size.
const CORRECTIONS: usize = 3;
/// The same of a second effect.
const CORRECTIONS_OF_SECOND: usize = 2;
/// So many effects are fitted exactly by their gain, and so many by the agreement of places.
const BY_GAIN: usize = 6;
const BY_AGREEMENT: usize = 3;
/// And so many second ones.
const SECOND: usize = 2;
/// Fewer events than this are no evidence.
const FEWEST_EVENTS: usize = 300;
/// An event is explained when it misses its threshold by no more than this share of it.
const EXPLAINED: f64 = 0.02;
/// Of a gain so many standard errors are no sign of anything: a convention; the decision is calibrated on
/// what is left.
const BY_CHANCE: f64 = 2.0;

/// Evidence on the light of pixels.
///
/// # Errors
/// When there are no frames or too few events, or stated effects cannot be combined.
pub fn evidence(case: &Case, nominal: &Nominal) -> Result<Evidence, String> {
    let part = choose::window(case);
    let (case, span_ns) = part.as_ref().map_or((case, None), |part| (part, Some(part.span)));
    let scales = Scales::of(case, nominal);
    let ground = Ground::new(case, nominal, &scales, choose::blocks(case))?;
    let events = ground.events();
    if events < FEWEST_EVENTS {
        return Err(format!(
            "{events} events follow another one in the pixels whose light is estimated; {FEWEST_EVENTS} are \
             needed"
        ));
    }
    let mut base = Fit::begin(&ground, &Trial::stated(nominal));
    base.rounds(ROUNDS)?;
    let all: Vec<usize> = (0..CANDIDATES.len()).filter(|n| !CANDIDATES[*n].is_random).collect();
    let scored = base.score(&all, None)?;
    let mut list = ranked(&scored, &ground);
    let mut nothing = base.clone();
    nothing.settled(CORRECTIONS)?;
    let level = nothing.left_out()?;
    let mut exact = Vec::new();
    for candidate in worth_fitting(&list, &scored) {
        exact.extend(scored.size(candidate).and_then(|begin| base.exact(candidate, begin, CORRECTIONS).ok()));
    }
    replace(&exact, &mut list, &level, &ground);
    let first = list.iter().find(|one| one.is_exact && one.beyond() > 0.0).cloned();
    let with = first.as_ref().and_then(|one| exact.iter().find(|fit| fit.candidate == one.candidate));
    let second = with.map_or_else(|| Ok(Vec::new()), |with| second(with, &ground))?;
    let median = |fit: &Fit<'_>| MEDIAN_T * fit.light.noise.threshold_share;
    let left = with.map_or(median(&nothing), |with| median(&with.fit));
    Ok(Evidence {
        scene: KINDS[3].to_owned(),
        span_ns,
        nats_per_event: level.iter().sum::<f64>() / events as f64,
        share: events as f64 / case.events.len() as f64,
        explained: explained(left / MEDIAN_T),
        events,
        median: median(&nothing),
        left: [left; 2],
        slope_per_s: ground.slope_per_s(&nothing)?,
        white: 1.0,
        misfit: 1.0,
        ranked: list,
        first,
        second,
        ..Evidence::default()
    })
}

/// Share of the events that are explained when what they miss their thresholds by has Student's distribution
/// with three degrees of freedom and a scale of `share` of the threshold.
fn explained(share: f64) -> f64 {
    2.0 * probability_t(EXPLAINED / share) - 1.0
}

/// Is a front end described as slower than with this effect? Light that it need not sharpen is smoother, and
/// so more probable: where edges pass fast, recordings without a fault gain up to 0.4 nats an event by it.
fn is_faster(one: &Ranked) -> bool {
    match CANDIDATES[one.candidate].id {
        "time_constant" => one.effect_size < 0.0,
        id => id == "large_signal_front_end",
    }
}

/// Exact fits in the places of first sizes and gains, best first; `level`: densities of events without them.
fn replace(exact: &[Exact<'_>], list: &mut [Ranked], level: &[f64], ground: &Ground<'_>) {
    for found in exact {
        list.iter_mut()
            .filter(|one| one.candidate == found.candidate)
            .for_each(|one| found.replace(one, level, ground));
    }
    for one in list.iter_mut() {
        one.is_material = CANDIDATES[one.candidate].is_material(ground.case, ground.nominal, one.value);
        one.control_gain = if is_faster(one) { f64::max(one.gain, 0.0) } else { BY_CHANCE * one.gain_error };
    }
    list.sort_by(Ranked::by_gain);
}

/// All other effects with one applied.
fn second(with: &Exact<'_>, ground: &Ground<'_>) -> Result<Vec<Ranked>, String> {
    let others: Vec<usize> = (0..CANDIDATES.len())
        .filter(|n| !CANDIDATES[*n].is_random && CANDIDATES[*n].id != CANDIDATES[with.candidate].id)
        .collect();
    let scored = with.fit.score(&others, Some(with.candidate))?;
    let mut list = ranked(&scored, ground);
    let mut alone = with.fit.clone();
    alone.settled(CORRECTIONS_OF_SECOND)?;
    let level = alone.left_out()?;
    let mut exact = Vec::new();
    for one in list.iter().filter(|one| one.gain > 0.0).take(SECOND) {
        exact.extend(with.fit.exact(one.candidate, one.effect_size, CORRECTIONS_OF_SECOND).ok());
    }
    replace(&exact, &mut list, &level, ground);
    list.iter_mut().filter(|one| one.is_exact).for_each(|one| one.of_first = Some(with.effect_size));
    Ok(list)
}

/// First sizes and gains, best first.
fn ranked(scored: &Scored, ground: &Ground<'_>) -> Vec<Ranked> {
    let (scales, nominal, events) = (ground.scales, ground.nominal, ground.events());
    let one = |n: usize| -> Option<Ranked> {
        let candidate = scored.candidates[n];
        let kind = &CANDIDATES[candidate];
        let (size, information) = (scored.sizes[n]?, scored.information[n]);
        Some(Ranked {
            candidate,
            effect_size: size,
            error: ERRORS / information.sqrt(),
            value: kind.value(size, scales, nominal),
            gain: if is_physics(candidate, size) { scored.gains[n] / events as f64 } else { 0.0 },
            information: information / (ERRORS * ERRORS * events as f64),
            unit: kind.value(1.0, scales, nominal) - kind.nominal_value(nominal),
            ..Ranked::default()
        })
    };
    let mut list: Vec<Ranked> = (0..scored.candidates.len()).filter_map(one).collect();
    list.sort_by(Ranked::by_gain);
    list
}

/// The best by gain, and by how well places agree.
fn worth_fitting(ranked: &[Ranked], scored: &Scored) -> Vec<usize> {
    let is_something = |one: &&Ranked| one.gain > 0.0;
    let mut chosen: Vec<usize> =
        ranked.iter().filter(is_something).take(BY_GAIN).map(|one| one.candidate).collect();
    let mut by_agreement: Vec<(f64, usize)> = ranked
        .iter()
        .filter(is_something)
        .filter_map(|one| Some((scored.agreement(one.candidate)?, one.candidate)))
        .collect();
    by_agreement.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    for (_, candidate) in by_agreement.into_iter().take(BY_AGREEMENT) {
        if !chosen.contains(&candidate) {
            chosen.push(candidate);
        }
    }
    chosen
}

#[cfg(test)]
mod tests;
