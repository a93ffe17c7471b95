//! A training example of the decision: a simulated recording's truth and its evidence.

use crate::simulated::{
    InjectedFault, SceneModelKind, SimulatedRecording, SimulationSetting, simulate_recording,
};
use photocurrent_diagnosis::candidates::{Candidate, EffectScales};
use photocurrent_diagnosis::decide::model::DecisionFeatures;
use photocurrent_diagnosis::residual::evidence::{EvidenceSetting, SceneEvidence};
use photocurrent_diagnosis::residual::free;
use photocurrent_diagnosis::residual::ranking::evidence;
use photocurrent_scene::Scene;
use photocurrent_scene::mosaic::{PatchSetting, scene};
use photocurrent_scene::moving::MovingPicture;
use photocurrent_scene::picture::PictureSetting;
use photocurrent_scene::target::{FittedTarget, TargetSetting};
use serde::{Deserialize, Serialize};

/// A simulated recording's truth and the features of its evidence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibrationExample {
    /// The true effects; immaterial sizes are left out.
    pub truth: InjectedFault,
    /// The evidence, from which facts are computed; none where the method abstained, or where only facts were
    /// stored.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub found: Option<SceneEvidence>,
    /// The model's inputs; none where the method abstained.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub facts: Option<DecisionFeatures>,
}

impl CalibrationExample {
    /// From the truth and the evidence.
    pub fn new(truth: InjectedFault, found: Option<SceneEvidence>) -> CalibrationExample {
        let facts = found.as_ref().map(DecisionFeatures::from_evidence);
        CalibrationExample { truth, found, facts }
    }

    /// Features alone, to four decimals: the form of the training set.
    #[must_use]
    pub fn facts_alone(&self) -> CalibrationExample {
        CalibrationExample {
            truth: self.truth.clone(),
            found: None,
            facts: self.facts.as_ref().map(DecisionFeatures::rounded),
        }
    }

    /// Does anything differ from the description?
    pub fn is_something(&self) -> bool {
        !self.truth.effects.is_empty() || self.truth.other.is_some()
    }

    /// Is this effect among the true ones?
    pub fn has_effect(&self, id: &str) -> bool {
        self.truth.effects.iter().any(|(other, ..)| other == id)
    }
}

/// Targets of simulated recordings are fitted to fewer values than a user's: their arrays are small.
const FEWER: TargetSetting = TargetSetting { values: 4_000, tries: 1, seed: 1 };

/// Simulates recording number `index` of a seed and computes its evidence.
///
/// # Errors
/// When the effects that were drawn cannot be combined.
pub fn example(seed: u64, index: u64, setting: &SimulationSetting) -> Result<CalibrationExample, String> {
    let SimulatedRecording { case, mut truth, target } = simulate_recording(seed, index, setting)?;
    let nominal = case.nominal().map_err(|why| why.to_string())?;
    let scales = EffectScales::from_case(&case, &nominal);
    truth.effects.retain(|(id, parameter, effect_size)| {
        Candidate::find(id, parameter)
            .is_some_and(|one| one.is_material(&case, &nominal, one.value(*effect_size, &scales, &nominal)))
    });
    let picture = PictureSetting::default();
    let evidence_on = |source: &dyn Scene| evidence(&case, &nominal, source, &EvidenceSetting::default());
    let found = match target {
        None if setting.kind == SceneModelKind::Pixels => free::on_pixels(&case, &nominal).ok(),
        None if setting.kind == SceneModelKind::Joint => MovingPicture::fit(&case, &nominal, &picture)
            .and_then(|picture| free::on_picture(&case, &nominal, &picture))
            .ok(),
        None => scene(&case, &nominal, &picture, &PatchSetting::default())
            .and_then(|source| evidence_on(source.as_ref()))
            .ok(),
        // The search finds the same place; only the fit is of interest.
        Some((form, shares)) => FittedTarget::fit_near(&case, &nominal, form, FEWER, &shares)
            .and_then(|source| evidence_on(&source).ok()),
    };
    Ok(CalibrationExample::new(truth, found))
}
