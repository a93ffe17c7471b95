//! Recognition by synthesis: what is a recording's deviation most like, among what effects do to a recording of the same scene?
//!
//! Every effect is put on the recording's own scene, recorded, reconstructed and compared as the recording itself was, the best ones again at the strength that fits. How well
//! such a template explains the deviation beyond the floor of nulls decides whether there is anything at all; with the word of the net, if there is one, it gives the order.
//!
//! Limits: a template is scaled linearly around the strength that it was made at, once refined; the scene is the nominal sensor's reconstruction throughout.

use crate::candidates::{CANDIDATES, Candidate, Signs, Trial};
use crate::case::Case;
use crate::deviation::{FULL, LEAN, Prepared};
use crate::floor::Level;
use crate::knowledge::Knowledge;
use crate::matching::{best, misfit};
use serde::{Deserialize, Serialize};

/// How a recording is recognised.
#[derive(Clone, Debug)]
pub struct SynthesisSetting {
    /// Seed of everything random.
    pub seed: u64,
    /// So many candidates, the best ones, are synthesised again at the strength that fits.
    pub candidates: usize,
    /// Least gain of the best template, nats, for an alarm.
    pub alarm_gain: f64,
}

impl Default for SynthesisSetting {
    fn default() -> SynthesisSetting {
        SynthesisSetting { seed: 7, candidates: 12, alarm_gain: 0.9 }
    }
}

/// A cause, judged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ranked {
    /// Place in [`CANDIDATES`].
    pub candidate: usize,
    /// Catalogue id.
    pub id: String,
    /// `leak_events.rate`.
    pub label: String,
    /// The net's probability of the id.
    pub probability: f64,
    /// Nats that the template explains.
    pub gain: f64,
    /// What the order is by: gain and the log of the probability.
    pub score: f64,
    /// Strength of the best match ([`Candidate::value`]).
    pub strength: f64,
    /// The parameter's value in the unit of its JSON key.
    pub value: f64,
    /// Its JSON key.
    pub key: String,
}

/// A summary that deviates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Deviating {
    /// Its name.
    pub name: String,
    /// How far, in spreads of nulls.
    pub z: f64,
}

/// What recognition by synthesis says of a recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Synthesis {
    /// Is there anything that nulls do not show?
    pub alarm: bool,
    /// What the alarm is decided by: the best gain, nats.
    pub statistic: f64,
    /// And what it must exceed.
    pub threshold: f64,
    /// The net's probability that there is nothing.
    pub consistent: f64,
    /// Candidates that were synthesised, best first.
    pub ranked: Vec<Ranked>,
    /// The best second effect beside the first, and what it gains in addition.
    pub second: Option<Ranked>,
    /// Summaries that deviate most.
    pub deviating: Vec<Deviating>,
    /// What kind of recording it is.
    pub context: Vec<f64>,
    /// Effective number of nulls like it.
    pub nulls: f64,
    /// Share of the deviation's misfit that the best template leaves: near 1 with an alarm, nothing in the catalogue is like it.
    pub left: f64,
    /// Noise of frames that the description does not state, as a share of the signal.
    pub frame_share: f64,
}

/// A template in spreads, made at a strength.
struct Template {
    candidate: usize,
    made_at: f64,
    z: Vec<f64>,
    factor: f64,
    gain: f64,
}

/// Least and most strength that is considered.
const STRENGTHS: (f64, f64) = (0.08, 4.0);

/// The strength at which a candidate is tried first: so many hot pixels and rows that some are among the sampled ones.
fn first_strength(candidate: &Candidate) -> f64 {
    if candidate.id.starts_with("hot_") { 2.5 } else { 1.0 }
}

/// Most strength of a candidate. A wide blur costs a hundred times what other effects cost, and thresholds that spread to nothing fire without end.
fn most(candidate: &Candidate) -> f64 {
    match candidate.id {
        "blur" => 1.8,
        "threshold_mismatch" => 2.0,
        "refractory" => 12.0,
        _ => STRENGTHS.1,
    }
}

/// Recognises a recording.
///
/// # Errors
/// When its description does not state what the model needs, or the knowledge was made for other summaries.
pub fn synthesis(case: &Case, knowledge: &Knowledge, setting: &SynthesisSetting) -> Result<Synthesis, String> {
    let nominal = case.nominal().map_err(|why| why.to_string())?;
    let full = Prepared::new(case, nominal.clone(), FULL, setting.seed)?;
    if full.own.names != knowledge.names {
        return Err("the knowledge of the diagnosis was made for other summaries; train it anew".to_owned());
    }
    let level = knowledge.floor.level(&full.context);
    let z: Vec<f64> = level.z(&full.deviation);
    let (probabilities, consistent) = proposed(knowledge, &z, &full.context);
    let lean = Prepared::new(case, nominal, LEAN, setting.seed)?;
    let bottom = lean.template(&Trial::stated(&lean.nominal), setting.seed ^ 3)?;
    let maker = Maker { lean: &lean, bottom: &bottom, level: &level, z: &z, seed: setting.seed };
    // Every candidate once, then the best anew at the strengths that fit, twice.
    let mut templates: Vec<Template> = (0..CANDIDATES.len()).filter_map(|candidate| maker.fitted(candidate, first_strength(&CANDIDATES[candidate]))).collect();
    let score = |template: &Template| template.gain + NET * libm::log(probabilities[template.candidate] + 1e-2);
    for (count, tolerance) in [(setting.candidates, 1.15), (setting.candidates / 2, 1.1)] {
        templates.sort_by(|a, b| score(b).total_cmp(&score(a)).then(a.candidate.cmp(&b.candidate)));
        for template in templates.iter_mut().take(count) {
            let is_near = template.factor > 0.0 && (1.0 / tolerance..tolerance).contains(&template.factor);
            if !is_near && template.factor != 0.0 && CANDIDATES[template.candidate].signs != Signs::Switch {
                // What was made at the strength itself is right even where the scaled one seemed better.
                if let Some(again) = maker.fitted(template.candidate, template.made_at * template.factor) {
                    *template = again;
                }
            }
        }
    }
    let rank = |template: &Template| ranked(template, &lean, probabilities[template.candidate]);
    let mut found: Vec<(Ranked, &Template)> = templates.iter().map(|template| (rank(template), template)).collect();
    found.sort_by(|a, b| b.0.score.total_cmp(&a.0.score).then(a.0.candidate.cmp(&b.0.candidate)));
    let statistic = found.iter().map(|(ranked, _)| ranked.gain).fold(0.0, f64::max);
    let whole = misfit(&z);
    let left = found.first().map_or(1.0, |(ranked, _)| (whole - ranked.gain) / whole.max(1e-9));
    let second = found.first().and_then(|(_, first)| second(&z, first, &templates, &lean, &probabilities));
    let mut deviating: Vec<Deviating> = full.own.names.iter().zip(&z).map(|(name, z)| Deviating { name: name.clone(), z: *z }).collect();
    deviating.sort_by(|a, b| b.z.abs().total_cmp(&a.z.abs()));
    deviating.truncate(12);
    Ok(Synthesis {
        alarm: statistic > setting.alarm_gain,
        statistic,
        threshold: setting.alarm_gain,
        consistent,
        ranked: found.into_iter().map(|(ranked, _)| ranked).collect(),
        second,
        deviating,
        context: full.context.clone(),
        nulls: level.nulls,
        left,
        frame_share: full.conditions.frame_share,
    })
}

/// The net's probability of every candidate's id, and of nothing.
fn proposed(knowledge: &Knowledge, z: &[f64], context: &[f64]) -> (Vec<f64>, f64) {
    let Some(net) = &knowledge.net else {
        return (vec![1.0 / CANDIDATES.len() as f64; CANDIDATES.len()], 0.0);
    };
    let out = net.run(&net.input(z, context));
    let of = |id: &str| net.labels.iter().position(|label| label == id).map_or(0.0, |at| f64::from(out[at]));
    (CANDIDATES.iter().map(|candidate| of(candidate.id)).collect(), of("consistent"))
}

struct Maker<'a> {
    lean: &'a Prepared<'a>,
    bottom: &'a [f64],
    level: &'a Level,
    z: &'a [f64],
    seed: u64,
}

impl Maker<'_> {
    /// A candidate's template at a strength, in spreads.
    fn made(&self, candidate: &Candidate, strength: f64) -> Option<Vec<f64>> {
        let trial = Trial::with(&self.lean.nominal, candidate, strength, &self.lean.scales);
        let template = self.lean.template(&trial, self.seed ^ 5).ok()?;
        Some(template.iter().zip(self.bottom).zip(&self.level.spread).map(|((with, without), s)| (with - without) / s).collect())
    }

    /// A candidate's best match with a template made at a strength.
    fn fitted(&self, number: usize, strength: f64) -> Option<Template> {
        let candidate = &CANDIDATES[number];
        let z = self.made(candidate, strength)?;
        let range = match candidate.signs {
            Signs::Switch => (1.0, 1.0),
            _ => (STRENGTHS.0 / strength.abs(), most(candidate) / strength.abs()),
        };
        let is_first = strength == first_strength(candidate);
        let fit = best(self.z, &z, range, is_first && candidate.signs == Signs::Both);
        Some(Template { candidate: number, made_at: strength, z, factor: fit.factor, gain: fit.gain })
    }
}

fn ranked(template: &Template, lean: &Prepared<'_>, probability: f64) -> Ranked {
    let candidate = &CANDIDATES[template.candidate];
    let strength = template.made_at * template.factor;
    Ranked {
        candidate: template.candidate,
        id: candidate.id.to_owned(),
        label: candidate.label(),
        probability,
        gain: template.gain,
        score: template.gain + NET * libm::log(probability + 1e-2),
        strength,
        value: candidate.value(strength, &lean.scales, &lean.nominal),
        key: candidate.json_key().0,
    }
}

/// How many nats a factor e in the net's probability counts as.
const NET: f64 = 0.3;

/// The best effect beside the first: what it explains of what the first leaves.
fn second(z: &[f64], first: &Template, templates: &[Template], lean: &Prepared<'_>, probabilities: &[f64]) -> Option<Ranked> {
    let rest: Vec<f64> = z.iter().zip(&first.z).map(|(z, t)| z - first.factor * t).collect();
    let wide: Vec<f64> = first.z.iter().map(|t| libm::sqrt(1.0 + 0.0625 * first.factor * first.factor * t * t)).collect();
    let rest: Vec<f64> = rest.iter().zip(&wide).map(|(z, s)| z / s).collect();
    let id = CANDIDATES[first.candidate].id;
    let mut found: Option<Ranked> = None;
    for template in templates.iter().filter(|template| CANDIDATES[template.candidate].id != id) {
        let narrowed: Vec<f64> = template.z.iter().zip(&wide).map(|(t, s)| t / s).collect();
        let range = (STRENGTHS.0 / template.made_at.abs(), most(&CANDIDATES[template.candidate]) / template.made_at.abs());
        let fit = best(&rest, &narrowed, range, false);
        let joined = Template { candidate: template.candidate, made_at: template.made_at, z: Vec::new(), factor: fit.factor, gain: fit.gain };
        let judged = ranked(&joined, lean, probabilities[template.candidate]);
        if fit.gain > 0.0 && found.as_ref().is_none_or(|found| judged.score > found.score) {
            found = Some(judged);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::floor::{Floor, Null};
    use crate::testing;
    use photocurrent_core::random::Random;

    /// Recordings without an effect that differ from the model, as those of other simulators do.
    fn knowledge() -> Knowledge {
        let names = crate::summaries::names().unwrap();
        let null = |n: u64| {
            let mut random = Random::new(4, &[n]);
            let context = (0..13).map(|_| random.normal() as f32).collect();
            Null { name: n.to_string(), context, deviation: names.iter().map(|_| 0.2 * random.normal() as f32).collect() }
        };
        Knowledge { floor: Floor { nulls: (0..12).map(null).collect() }, names, ..Knowledge::default() }
    }

    #[test]
    fn every_candidate_is_ranked_and_the_answer_is_the_same_with_any_number_of_threads() {
        let setting = SynthesisSetting { candidates: 4, ..SynthesisSetting::default() };
        let of = |case: &Case, threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| synthesis(case, &knowledge(), &setting).unwrap())
        };
        let leak = [("leak_events".to_owned(), [("rate".to_owned(), serde_json::json!("30 Hz"))].into_iter().collect())].into_iter().collect();
        let leaking = testing::case_with(&leak);
        let found = of(&leaking, 1);
        assert_eq!(found, of(&leaking, 2));
        assert_eq!(found.ranked.len(), CANDIDATES.len());
        assert!(found.ranked.windows(2).all(|pair| pair[0].score >= pair[1].score));
        assert!(found.ranked.iter().all(|ranked| ranked.gain.is_finite() && ranked.value.is_finite()));
    }
}
