//! What a moving picture says, in the form that [`crate::verdict`] joins ([`crate::residual::evidence`]).
//!
//! A scene that frames alone state is evidence of another kind than a light that events helped to estimate: an effect cannot hide in it. So where enough events count, this method
//! decides alone; what it does not see is not there, to the size that its own floor allows.
//!
//! - [`model`]: probabilities.
//! - [`calibrate`]: where its numbers come from.

use crate::candidates::CANDIDATES;
use crate::case::Case;
use crate::diagnose::Setting;
use crate::nominal::Nominal;
use crate::picture::PictureSetting;
use crate::residual::evidence::{Evidence, EvidenceSetting, Ranked, evidence};
use crate::residual::source::MovingPicture;
use crate::verdict::{Proposal, Road, Unexplained, is_material};
use model::{Belief, Facts, Model, hypotheses};
use serde::{Deserialize, Serialize};

pub mod calibrate;
pub mod model;

/// The name of the method.
pub const PICTURE: &str = "picture";

/// From when on something is said.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Decision {
    /// The model's numbers.
    pub model: Model,
    /// Something differs from this probability on.
    pub least: f64,
    /// And there is a second effect from this probability on.
    pub least_second: f64,
    /// Where the control's median absolute residual over the threshold is larger, the method does not model this sensor, and abstains.
    pub most_control: f64,
    /// Nor does it call consistent what leaves a larger median absolute residual over the threshold than this.
    pub most_left: f64,
    /// Error of sizes that all blocks share, as a share of the departure.
    pub shared_error: f64,
}

impl Default for Decision {
    fn default() -> Decision {
        Decision { model: Model::default(), least: 0.8, least_second: 0.7, most_control: 0.15, most_left: 0.3, shared_error: 0.02 }
    }
}

/// Runs the method.
///
/// # Errors
/// When the description does not state what the model needs, or the scene predicts too few of the frames.
pub fn run(case: &Case, setting: &Setting) -> Result<Road, String> {
    let nominal = case.nominal().map_err(|why| why.to_string())?;
    let source = MovingPicture::fit(case, &nominal, &PictureSetting::default())?;
    let found = evidence(case, &nominal, &source, &EvidenceSetting { seed: setting.seed, ..EvidenceSetting::default() })?;
    let decision = Decision::default();
    if found.control_median > decision.most_control {
        return Err(format!(
            "events of the nominal sensor on its own scene miss their thresholds by {:.2} of them: this sensor is not modelled well enough",
            found.control_median
        ));
    }
    let said = method(&found, &|one| is_material(case, &nominal, &CANDIDATES[one.candidate], one.value), &nominal, &decision);
    if !said.alarm && found.left[0] > decision.most_left {
        return Err(format!("events miss their thresholds by {:.2} of them, and no effect explains it on this scene", found.left[0]));
    }
    Ok(said)
}

/// What was found as a method's word; `matters`: is a size worth a word?
pub fn method(found: &Evidence, matters: &impl Fn(&Ranked) -> bool, nominal: &Nominal, decision: &Decision) -> Road {
    let facts = Facts::of(found, matters);
    let belief = decision.model.first(&facts);
    let is_something = belief.something >= decision.least;
    let first = proposals(&hypotheses(&found.ranked, &found.random, matters), &belief, belief.something / decision.least, nominal, decision);
    let most = first.iter().map(|one| one.probability).fold(0.0, f64::max);
    let is_unnamed = is_something && belief.unnamed > most;
    let second = decision.model.second(&facts).map_or_else(Vec::new, |belief| {
        let list = hypotheses(&found.second, &found.random_second, matters);
        proposals(&list, &belief, belief.something / decision.least_second, nominal, decision)
    });
    let curve = found.open_second.first().or(found.open.first()).filter(|_| is_unnamed);
    Road {
        name: PICTURE.into(),
        alarm: is_something,
        proposals: if is_unnamed { Vec::new() } else { first },
        second: if is_unnamed { Vec::new() } else { second },
        unexplained: curve.map(|curve| Unexplained::by(&curve.law, belief.something / decision.least)),
        decides: true,
        residual_left: Some(found.left[0] / f64::max(found.median, 1e-12)),
        ..Road::default()
    }
}

/// One proposal for each hypothesis, best first; `score`: how far over what is said something is.
fn proposals(list: &[&Ranked], belief: &Belief, score: f64, nominal: &Nominal, decision: &Decision) -> Vec<Proposal> {
    let one = |(one, probability): (&&Ranked, &f64)| {
        let width = one.error / f64::max(one.strength.abs(), 1e-12);
        let nothing = CANDIDATES[one.candidate].nominal_value(nominal);
        let error = 1.96 * libm::hypot(width, decision.shared_error) * (one.value - nothing).abs();
        Proposal {
            candidate: one.candidate,
            score,
            probability: *probability,
            value: one.value,
            ci95: (error > 0.0 && error.is_finite()).then_some([one.value - error, one.value + error]),
            passed: score >= 1.0,
            heldout_nats: None,
            heldout_nats_per_event: Some(one.beyond()),
        }
    };
    list.iter().zip(&belief.each).map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidates::{Scales, Signs, Trial};
    use crate::scenes::MadeUp;
    use crate::testing;
    use crate::verdict::is_material;
    use photocurrent_core::Extent;
    use photocurrent_core::random::Random;

    fn ranked(id: &str, gain: f64, control_gain: f64) -> Ranked {
        let candidate = CANDIDATES.iter().position(|one| one.id == id).unwrap();
        Ranked { candidate, gain, control_gain, strength: 1.0, value: 1.0, is_exact: true, ..Ranked::default() }
    }

    fn said(found: &Evidence) -> Road {
        let case = testing::case();
        method(found, &|_| true, &case.nominal().unwrap(), &Decision::default())
    }

    #[test]
    fn gains_count_from_the_control() {
        let found = Evidence { left: [0.01; 2], ranked: vec![ranked("clock_offset", 0.5, 0.1), ranked("leak_events", 0.2, 0.19)], ..Evidence::default() };
        let said = said(&found);
        assert!(said.decides && said.alarm && said.proposals[0].passed);
        assert!((said.proposals[0].heldout_nats_per_event.unwrap() - 0.4).abs() < 1e-12);
        assert!(said.proposals[0].probability > 0.9);
    }

    #[test]
    fn what_gains_next_to_nothing_is_no_finding() {
        let found = Evidence { left: [0.05; 2], ranked: vec![ranked("clock_offset", 0.004, 0.001)], ..Evidence::default() };
        assert!(!said(&found).alarm);
    }

    #[test]
    fn alike_gains_share_their_probability() {
        let found =
            Evidence { ranked: vec![ranked("clock_offset", 1.0, 0.0), ranked("second_pole", 0.99, 0.0), ranked("blur", 0.5, 0.0)], ..Evidence::default() };
        let said = said(&found).proposals;
        assert!(said[0].probability < 0.6 && said[1].probability > 0.4 && said[2].probability < 0.01);
    }

    /// Scenes and sensors that nothing was set on, each without an effect and with one of random kind and size:
    /// `cargo test --release -p photocurrent-diagnosis made_up_scenes -- --ignored --nocapture`.
    #[test]
    #[ignore = "takes minutes"]
    fn on_made_up_scenes_nothing_is_found_where_nothing_is_and_most_names_are_right() {
        const SCENES: u64 = 12;
        let (mut alarms, mut asked, mut right) = (Vec::new(), 0, 0);
        for index in 0..SCENES {
            let scene = MadeUp::new(11, index, Extent { width: 96, height: 72 }, 0.15);
            let null = scene.recording().unwrap();
            let nominal = null.nominal().unwrap();
            let said = |case: &Case| -> Option<&'static str> {
                let found = run(case, &Setting::default()).ok()?;
                let passed = found.proposals.iter().filter(|one| one.passed && is_material(case, &nominal, &CANDIDATES[one.candidate], one.value));
                Some(passed.map(|one| CANDIDATES[one.candidate].id).next().unwrap_or("nothing"))
            };
            alarms.extend(said(&null).filter(|id| *id != "nothing").map(|id| (index, id)));
            let mut random = Random::new(11, &[index, 7]);
            let chosen = &CANDIDATES[(random.uniform() * CANDIDATES.len() as f64) as usize % CANDIDATES.len()];
            let size = 0.15 * libm::pow(10.0, random.uniform());
            let strength = if chosen.signs == Signs::Both && random.uniform() < 0.5 { -size } else { size };
            let trial = Trial::with(&nominal, chosen, strength, &Scales::of(&null, &nominal));
            let Some(id) = scene.recording_through(Some(&trial)).ok().and_then(|case| said(&case)) else { continue };
            eprintln!("{index}: {} at {strength:.2}, found {id}", chosen.label());
            asked += 1;
            right += usize::from(id == chosen.id);
        }
        eprintln!("{right} of {asked} names right; without an effect: {alarms:?}");
        assert!(alarms.is_empty(), "{alarms:?}");
        assert!(2 * right > asked, "{right} of {asked}");
    }
}
