//! Making what the recogniser learns from: templates of every candidate at several strengths on many scenes, and deviations of recordings without an effect.
//!
//! Own scenes ([`crate::scenes`]) and real recordings serve alike: a base is a recording, its reconstruction is the scene that effects are put on. No answers are
//! needed, because the effect is put on here. Deviations of nulls are added to templates later ([`crate::proposer`]), so that the net learns what matters beside
//! the errors of other simulators and real sensors.

use crate::candidates::{CANDIDATES, Scales, Signs, Trial};
use crate::case::Case;
use crate::deviation::{FULL, LEAN, Prepared, context_of, unstated_frame_noise};
use crate::floor::{Floor, Null};
use crate::knowledge::Knowledge;
use crate::linear::Templates;
use crate::nominal::Nominal;
use crate::proposer::{Net, NetSetting};
use photocurrent_core::random::Random;
use serde::{Deserialize, Serialize};
use serde_json::json;

/// A deviation whose cause is known.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Example {
    /// Which candidate was put on; none for a recording without an effect.
    pub candidate: Option<usize>,
    /// At which strength.
    pub strength: f64,
    /// Kind of recording: [`crate::summaries::context`].
    pub context: Vec<f32>,
    /// Deviation of the summaries.
    pub deviation: Vec<f32>,
}

/// How many templates are made of a base.
#[derive(Clone, Copy, Debug)]
pub struct TrainingSetting {
    /// Seed of strengths, signs and noise.
    pub seed: u64,
    /// Templates of each candidate.
    pub strengths: usize,
}

fn narrow(values: &[f64]) -> Vec<f32> {
    values.iter().map(|value| *value as f32).collect()
}

/// The null and the templates of a base, in order of candidates; those that cannot be put on it are left out.
///
/// # Errors
/// When its description does not state what the model needs.
pub fn examples_of(case: &Case, setting: &TrainingSetting, number: u64) -> Result<Vec<Example>, String> {
    let nominal = case.nominal().map_err(|why| why.to_string())?;
    let full = Prepared::new(case, nominal.clone(), FULL, setting.seed)?;
    let prepared = Prepared::new(case, nominal, LEAN, setting.seed)?;
    let context = narrow(&full.context);
    let mut examples = vec![Example { candidate: None, strength: 0.0, context: context.clone(), deviation: narrow(&full.deviation) }];
    // The bottom of templates: what the way through scene and back gives without an effect.
    let bottom = prepared.template(&Trial::stated(&prepared.nominal), setting.seed ^ 3)?;
    for (n, candidate) in CANDIDATES.iter().enumerate() {
        for part in 0..setting.strengths {
            let mut random = Random::new(setting.seed, &[number, n as u64, part as u64]);
            let size = libm::exp2(2.6 * random.uniform() - 1.3);
            let strength = match candidate.signs {
                Signs::Positive => size,
                Signs::Switch => 1.0,
                Signs::Both if random.uniform() < 0.5 => -size,
                Signs::Both => size,
            };
            let mut trial = Trial::with(&prepared.nominal, candidate, strength, &prepared.scales);
            vary(&mut trial, candidate.id, &prepared.nominal, &mut random);
            if let Ok(template) = prepared.template(&trial, random.bits()) {
                let deviation = template.iter().zip(&bottom).map(|(with, without)| (with - without) as f32).collect();
                examples.push(Example { candidate: Some(n), strength, context: context.clone(), deviation });
            }
        }
    }
    Ok(examples)
}

/// What varies beside the number that is sought: how fast hot pixels and rows fire, around which period the refractory period spreads.
fn vary(trial: &mut Trial, id: &str, nominal: &Nominal, random: &mut Random) {
    let share = random.uniform();
    let mut put = |key: &str, value: serde_json::Value| {
        if let Some(parameters) = trial.effects.get_mut(id) {
            parameters.insert(key.to_owned(), value);
        }
    };
    match id {
        "hot_pixels" => put("rate", json!(format!("{} Hz", (150.0 * libm::exp2(3.3 * share)).round()))),
        "hot_rows" => put("rate", json!(format!("{} Hz", (40.0 * libm::exp2(2.5 * share)).round()))),
        "refractory_spread" if share < 0.6 && nominal.pixel.refractory_ns > 0 => {
            let about = json!({ "refractory": format!("{} ns", 3 * nominal.pixel.refractory_ns) });
            if let serde_json::Value::Object(parameters) = about {
                trial.effects.entry("refractory".to_owned()).or_insert(parameters);
            }
        }
        _ => {}
    }
}

/// Knowledge from examples, own nulls among them, from further nulls, such as real recordings known to have no effect, and from the biases of some of both.
pub fn learn(names: &[String], examples: &[Example], more: &[Null], biases: &[Null], setting: &NetSetting) -> Knowledge {
    let own = examples.iter().filter(|example| example.candidate.is_none()).enumerate();
    let own = own.map(|(n, example)| Null { name: format!("made up {n}"), context: example.context.clone(), deviation: example.deviation.clone() });
    let floor = Floor { nulls: more.iter().cloned().chain(own).collect() };
    let net = Net::train(examples, &floor, setting);
    Knowledge { names: names.to_vec(), floor, biases: Floor { nulls: biases.to_vec() }, net: Some(net) }
}

/// By how much a recording without an effect deviates.
///
/// # Errors
/// When its description does not state what the model needs.
pub fn null_of(case: &Case, name: String, seed: u64) -> Result<Null, String> {
    let nominal = case.nominal().map_err(|why| why.to_string())?;
    let full = Prepared::new(case, nominal, FULL, seed)?;
    Ok(Null { name, context: narrow(&full.context), deviation: narrow(&full.deviation) })
}

/// The strength of every candidate that a recording without an effect seems to have, as a deviation; 0 for those that are random.
///
/// # Errors
/// When its description does not state what the model needs.
pub fn bias_of(case: &Case, name: String) -> Result<Null, String> {
    let nominal = case.nominal().map_err(|why| why.to_string())?;
    let frame_noise = unstated_frame_noise(case, &nominal)?;
    let found = Templates::new(case, &nominal, &Scales::of(case, &nominal), frame_noise)?.beside(&[]);
    let mut strengths = vec![0.0; CANDIDATES.len()];
    found.iter().for_each(|one| strengths[one.candidate] = one.strength as f32);
    Ok(Null { name, context: narrow(&context_of(case, &nominal)), deviation: strengths })
}

impl Example {
    /// For a file that examples are appended to: little-endian, lengths first.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(16 + 4 * (self.context.len() + self.deviation.len()));
        let candidate = self.candidate.map_or(u32::MAX, |n| n as u32);
        for number in [candidate, self.context.len() as u32, self.deviation.len() as u32] {
            bytes.extend(number.to_le_bytes());
        }
        bytes.extend((self.strength as f32).to_le_bytes());
        for value in self.context.iter().chain(&self.deviation) {
            bytes.extend(value.to_le_bytes());
        }
        bytes
    }

    /// All examples of a file's content; what is cut off at its end is left out.
    pub fn all_from_bytes(bytes: &[u8]) -> Vec<Example> {
        let word = |at: usize| bytes.get(at..at + 4).map(|b| [b[0], b[1], b[2], b[3]]);
        let mut examples = Vec::new();
        let mut at = 0;
        while let (Some(candidate), Some(context), Some(deviation), Some(strength)) = (word(at), word(at + 4), word(at + 8), word(at + 12)) {
            let (n, m) = (u32::from_le_bytes(context) as usize, u32::from_le_bytes(deviation) as usize);
            let Some(body) = bytes.get(at + 16..(at + 16).saturating_add(4 * n.saturating_add(m))) else {
                break;
            };
            let values: Vec<f32> = body.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
            let candidate = Some(u32::from_le_bytes(candidate) as usize).filter(|n| *n < CANDIDATES.len());
            let strength = f64::from(f32::from_le_bytes(strength));
            examples.push(Example { candidate, strength, context: values[..n].to_vec(), deviation: values[n..].to_vec() });
            at += 16 + 4 * (n + m);
        }
        examples
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::MadeUp;
    use crate::testing;
    use photocurrent_core::Extent;

    #[test]
    fn examples_survive_being_written_and_a_cut_file_keeps_the_whole_ones() {
        let one = |candidate: Option<usize>| Example { candidate, strength: 0.5, context: vec![1.0, -2.0], deviation: vec![0.25, 3.0, f32::MIN_POSITIVE] };
        let bytes: Vec<u8> = [one(None), one(Some(3))].iter().flat_map(Example::to_bytes).collect();
        assert_eq!(Example::all_from_bytes(&bytes), [one(None), one(Some(3))]);
        assert_eq!(Example::all_from_bytes(&bytes[..bytes.len() - 1]), [one(None)]);
    }

    #[test]
    fn a_net_trained_on_made_up_scenes_knows_its_own_templates() {
        let setting = TrainingSetting { seed: 3, strengths: 1 };
        let examples: Vec<Example> = (0..2)
            .flat_map(|n| {
                let case = MadeUp::new(3, n, Extent { width: 24, height: 18 }, 0.1).recording().unwrap();
                examples_of(&case, &setting, n).unwrap()
            })
            .collect();
        let names = crate::summaries::names().unwrap();
        let net = NetSetting { steps: 300, width: 48, ..NetSetting::default() };
        // Recordings without an effect that differ by a twentieth, as real ones might.
        let other = |n: u64| -> Null {
            let mut random = Random::new(9, &[n]);
            let context = examples[0].context.iter().map(|c| c + 0.1 * random.normal() as f32).collect();
            Null { name: format!("{n}"), context, deviation: names.iter().map(|_| 0.05 * random.normal() as f32).collect() }
        };
        let more: Vec<Null> = (0..10).map(other).collect();
        let knowledge = learn(&names, &examples, &more, &[], &net);
        assert_eq!(knowledge, learn(&names, &examples, &more, &[], &net));
        let net = knowledge.net.as_ref().unwrap();
        let wide = |values: &[f32]| -> Vec<f64> { values.iter().map(|v| f64::from(*v)).collect() };
        let mut right = 0.0;
        for example in examples.iter().filter(|example| example.candidate.is_some()) {
            let context = wide(&example.context);
            let level = knowledge.floor.level(&context);
            let z: Vec<f64> = example.deviation.iter().zip(&level.spread).map(|(d, s)| f64::from(*d) / s).collect();
            let p = net.run(&net.input(&z, &context));
            let own = net.labels.iter().position(|label| *label == CANDIDATES[example.candidate.unwrap()].id).unwrap();
            right += f64::from(p[own]);
        }
        // By chance it would be one in 42, 0.024.
        let mean = right / (examples.len() - 2) as f64;
        assert!(mean > 0.08, "{mean}");
    }

    #[test]
    fn every_candidate_gives_an_example_and_most_differ_from_none() {
        let examples = examples_of(&testing::case(), &TrainingSetting { seed: 1, strengths: 1 }, 0).unwrap();
        assert_eq!(examples.len(), CANDIDATES.len() + 1);
        let moved = examples[1..].iter().filter(|example| example.deviation.iter().any(|value| value.abs() > 0.05)).count();
        // A few pixels for 60 ms do not show all: nothing turns, nothing repeats.
        assert!(moved > CANDIDATES.len() * 3 / 4, "{moved}");
    }
}
