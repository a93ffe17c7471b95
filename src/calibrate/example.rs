//! One training example of the decision: a simulated recording's truth with the evidence that the diagnosis
//! found.

use crate::simulated::{Fault, Kind, Made, MadeSetting, made};
use photocurrent_diagnosis::candidates::{Candidate, Scales};
use photocurrent_diagnosis::decide::model::Facts;
use photocurrent_diagnosis::residual::evidence::{Evidence, EvidenceSetting};
use photocurrent_diagnosis::residual::free;
use photocurrent_diagnosis::residual::ranking::evidence;
use photocurrent_scene::Scene;
use photocurrent_scene::mosaic::{PatchSetting, scene};
use photocurrent_scene::moving::MovingPicture;
use photocurrent_scene::picture::PictureSetting;
use photocurrent_scene::target::{Target, TargetSetting};
use serde::{Deserialize, Serialize};

/// A simulated recording's truth, with what the diagnosis found in it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Example {
    /// What is wrong with it; sizes that nobody would care about are left out.
    pub truth: Fault,
    /// The evidence, from which facts are computed; none where the method abstained, or where only facts were
    /// stored.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub found: Option<Evidence>,
    /// The model's inputs; none where the method abstained.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub facts: Option<Facts>,
}

impl Example {
    /// With facts from what was found.
    pub fn new(truth: Fault, found: Option<Evidence>) -> Example {
        let facts = found.as_ref().map(Facts::of);
        Example { truth, found, facts }
    }

    /// Facts alone, to four digits behind the point: what a training set keeps.
    #[must_use]
    pub fn facts_alone(&self) -> Example {
        Example { truth: self.truth.clone(), found: None, facts: self.facts.as_ref().map(Facts::rounded) }
    }

    /// Does anything differ from the description?
    pub fn is_something(&self) -> bool {
        !self.truth.effects.is_empty() || self.truth.other.is_some()
    }

    /// Is this effect among the true ones?
    pub fn has(&self, id: &str) -> bool {
        self.truth.effects.iter().any(|(other, ..)| other == id)
    }
}

/// Targets of simulated recordings are fitted to fewer values than a user's: their arrays are small.
const FEWER: TargetSetting = TargetSetting { values: 4_000, tries: 1, seed: 1 };

/// Simulates recording number `index` of a seed and computes its evidence.
///
/// # Errors
/// When the effects that were drawn cannot be combined.
pub fn example(seed: u64, index: u64, setting: &MadeSetting) -> Result<Example, String> {
    let Made { case, mut truth, target } = made(seed, index, setting)?;
    let nominal = case.nominal().map_err(|why| why.to_string())?;
    let scales = Scales::of(&case, &nominal);
    truth.effects.retain(|(id, parameter, effect_size)| {
        Candidate::find(id, parameter)
            .is_some_and(|one| one.is_material(&case, &nominal, one.value(*effect_size, &scales, &nominal)))
    });
    let picture = PictureSetting::default();
    let evidence_on = |source: &dyn Scene| evidence(&case, &nominal, source, &EvidenceSetting::default());
    let found = match target {
        None if setting.kind == Kind::Pixels => free::on_pixels(&case, &nominal).ok(),
        None if setting.kind == Kind::Joint => MovingPicture::fit(&case, &nominal, &picture)
            .and_then(|picture| free::on_picture(&case, &nominal, &picture))
            .ok(),
        None => scene(&case, &nominal, &picture, &PatchSetting::default())
            .and_then(|source| evidence_on(source.as_ref()))
            .ok(),
        // The search finds the same place; only the fit is of interest.
        Some((form, shares)) => {
            Target::near(&case, &nominal, form, FEWER, &shares).and_then(|source| evidence_on(&source).ok())
        }
    };
    Ok(Example::new(truth, found))
}
