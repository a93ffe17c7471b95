//! What a moving picture says, in the form that [`crate::verdict`] joins ([`crate::residual::evidence`]).
//!
//! A scene that frames alone state is evidence of another kind than a light that events helped to estimate: an effect cannot hide in it. So where enough events count, this method
//! decides alone; what it does not see is not there, to the size that its own floor allows.
//!
//! The floor of a gain grows with the residuals that the best effect leaves ([`Decision`]).

use crate::candidates::CANDIDATES;
use crate::case::Case;
use crate::diagnose::Setting;
use crate::nominal::Nominal;
use crate::picture::PictureSetting;
use crate::residual::evidence::{Evidence, EvidenceSetting, Ranked, evidence};
use crate::residual::source::MovingPicture;
use crate::verdict::{Proposal, Road};

/// The name of the method.
pub const PICTURE: &str = "picture";

/// From when on a gain is a finding. Values: docs/diagnosis.md, *The moving picture*.
#[derive(Clone, Copy, Debug)]
pub struct Decision {
    /// Least gain of an effect beyond the control, nats an event.
    pub least_gain: f64,
    /// And as a multiple of the median absolute residual over the threshold that the best effect leaves: what the picture's own errors gain.
    pub per_median: f64,
    /// A second effect must gain this share of the first one's gain.
    pub second_share: f64,
    /// Effects are told apart by gains that differ by this share of the best.
    pub softness: f64,
    /// Where the control's median absolute residual over the threshold is larger, the method does not model this sensor, and abstains.
    pub most_control: f64,
    /// Nor does it call consistent what leaves a larger median absolute residual over the threshold than this.
    pub most_left: f64,
}

impl Default for Decision {
    fn default() -> Decision {
        Decision { least_gain: 0.03, per_median: 2.0, second_share: 0.04, softness: 0.04, most_control: 0.15, most_left: 0.12 }
    }
}

/// Runs the method.
///
/// # Errors
/// When the description does not state what the model needs, or the picture predicts too few of the frames.
pub fn run(case: &Case, setting: &Setting) -> Result<Road, String> {
    let nominal = Nominal::new(case).map_err(|why| why.to_string())?;
    let source = MovingPicture::fit(case, &nominal, &PictureSetting::default())?;
    let found = evidence(case, &nominal, &source, &EvidenceSetting { seed: setting.seed, ..EvidenceSetting::default() })?;
    let decision = Decision::default();
    if found.control_median > decision.most_control {
        return Err(format!(
            "events of the nominal sensor on its own scene miss their thresholds by {:.2} of them: this sensor is not modelled well enough",
            found.control_median
        ));
    }
    let said = method(&found, &nominal, &decision);
    if !said.alarm && found.left[0] > decision.most_left {
        return Err(format!("events miss their thresholds by {:.2} of them, and no effect explains it on a moving picture", found.left[0]));
    }
    Ok(said)
}

/// What was found as a method's word.
pub fn method(found: &Evidence, nominal: &Nominal, decision: &Decision) -> Road {
    let floor = f64::max(decision.least_gain, decision.per_median * found.left[0]);
    let first = proposals(&found.ranked, &found.random, floor, nominal, decision);
    let best = first.iter().filter(|one| one.passed).filter_map(|one| one.heldout_nats_per_event).fold(0.0, f64::max);
    let floor_of_second = f64::max(floor, decision.second_share * best);
    let second = proposals(&found.second, &found.random_second, floor_of_second, nominal, decision);
    Road {
        name: PICTURE.into(),
        alarm: first.iter().any(|one| one.passed),
        proposals: first,
        second,
        decides: true,
        residual_left: Some(found.left[0] / f64::max(found.median, 1e-12)),
        ..Road::default()
    }
}

/// One proposal for each effect, by its best parameter; best first.
fn proposals(ranked: &[Ranked], random: &[Ranked], floor: f64, nominal: &Nominal, decision: &Decision) -> Vec<Proposal> {
    let mut all: Vec<&Ranked> = ranked.iter().chain(random).filter(|one| one.beyond() > 0.0).collect();
    all.sort_by(|a, b| b.beyond().total_cmp(&a.beyond()).then(a.candidate.cmp(&b.candidate)));
    let best = all.first().map_or(1.0, |one| one.beyond());
    let mut found: Vec<Proposal> = Vec::new();
    for one in all {
        let id = CANDIDATES[one.candidate].id;
        if found.iter().any(|other| CANDIDATES[other.candidate].id == id) {
            continue;
        }
        let gain = one.beyond();
        let width = one.error / f64::max(one.strength.abs(), 1e-12);
        // Blocks do not know of what all of them share: two parts in a hundred of the departure.
        let nothing = CANDIDATES[one.candidate].nominal_value(nominal);
        let error = 1.96 * libm::hypot(width, 0.02) * (one.value - nothing).abs();
        found.push(Proposal {
            candidate: one.candidate,
            score: gain / floor,
            probability: libm::exp((gain / best - 1.0) / decision.softness),
            value: one.value,
            ci95: (error > 0.0 && error.is_finite()).then_some([one.value - error, one.value + error]),
            passed: gain > floor && one.is_exact,
            heldout_nats: None,
            heldout_nats_per_event: Some(gain),
        });
    }
    let sum: f64 = found.iter().map(|one| one.probability).sum();
    found.iter_mut().for_each(|one| one.probability /= f64::max(sum, 1e-300));
    found
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

    #[test]
    fn gains_count_from_the_control_and_over_a_floor_that_grows_with_its_residuals() {
        let case = testing::case();
        let nominal = Nominal::new(&case).unwrap();
        let mut found = Evidence { left: [0.01; 2], ranked: vec![ranked("clock_offset", 0.5, 0.1), ranked("leak_events", 0.2, 0.19)], ..Evidence::default() };
        let said = method(&found, &nominal, &Decision::default());
        assert!(said.decides && said.alarm && said.proposals[0].passed && !said.proposals[1].passed);
        assert!((said.proposals[0].heldout_nats_per_event.unwrap() - 0.4).abs() < 1e-12);
        found.left = [0.3; 2];
        assert!(!method(&found, &nominal, &Decision::default()).alarm, "such residuals gain that much without an effect");
    }

    #[test]
    fn alike_gains_share_their_probability() {
        let case = testing::case();
        let nominal = Nominal::new(&case).unwrap();
        let found =
            Evidence { ranked: vec![ranked("clock_offset", 1.0, 0.0), ranked("second_pole", 0.99, 0.0), ranked("blur", 0.5, 0.0)], ..Evidence::default() };
        let said = method(&found, &nominal, &Decision::default()).proposals;
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
            let nominal = Nominal::new(&null).unwrap();
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
