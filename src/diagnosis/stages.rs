//! Documents between the stages: findings of the direct tests, evidence and proposals; writing and reading.
//!
//! All are written as they are. Reading needs two things that the text does not contain: the catalogue's
//! names of ids and parameters, and the list of candidates to which an index into [`CANDIDATES`] refers. The
//! documents carry the list's labels and are refused where the list differs.

use crate::candidates::CANDIDATES;
use crate::dependence::Dependence;
use crate::integrity::{Departure, HalvesGain, Integrity};
use crate::report::{MinimumDetectable, SceneEstimate};
use crate::residual::evidence::SceneEvidence;
use crate::residual::located::{EffectLocations, LocatedEffect};
use photocurrent_core::{DataError, Diagnosis, DiagnosisKind};
use photocurrent_scene::block::Block;
use photocurrent_sensor::effects::catalogue;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};

/// Posterior and gain of one candidate.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EffectProposal {
    /// Index into [`CANDIDATES`].
    pub candidate: usize,
    /// Probability that something differs, over the least at which it is reported.
    pub score: f64,
    /// Its posterior probability conditional on a difference, 0 to 1.
    pub probability: f64,
    /// The parameter, in the unit of its declaration.
    pub value: f64,
    /// Its 95 % interval.
    pub ci95: Option<[f64; 2]>,
    /// Is it probable enough to be reported?
    pub passed: bool,
    /// Gain in log-likelihood on held-out events beyond the control's, nats.
    pub heldout_nats: Option<f64>,
    /// Its 95 % interval, from block to block.
    pub heldout_nats_ci95: Option<[f64; 2]>,
    /// The same per event.
    pub heldout_nats_per_event: Option<f64>,
    /// Distance of the residuals with it from the noise that the described sensor has on this scene
    /// (Kolmogorov and Smirnov).
    pub ks: Option<f64>,
}

impl EffectProposal {
    /// Catalogue id of its effect.
    pub fn id(&self) -> &'static str {
        CANDIDATES[self.candidate].id
    }
}

/// A dependence that no effect of the catalogue explains.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Unexplained {
    /// Covariate, by the names of docs/formats.md.
    pub covariate: String,
    /// The dependence, as an equation or in words.
    pub equation: String,
    /// Where in the chain.
    pub insertion: String,
    /// Statistic over its detection threshold.
    pub score: f64,
    /// Held-out gain in log-likelihood, nats an event.
    pub nats: f64,
    /// As it was measured.
    pub dependence: Option<Dependence>,
    /// Ids of effects that are nearly as probable.
    #[serde(default)]
    pub also_possible: Vec<String>,
}

impl Unexplained {
    /// From a curve; `score`: statistic over its detection threshold.
    pub fn from_dependence(dependence: &Dependence, score: f64) -> Unexplained {
        Unexplained {
            covariate: dependence.covariate.name().to_owned(),
            equation: dependence.equation(),
            insertion: dependence.moved.insertion().to_owned(),
            score,
            nats: dependence.nats_per_event,
            dependence: Some(dependence.clone()),
            also_possible: Vec::new(),
        }
    }

    /// Its location; `None` where another curve was located.
    pub fn located<'a>(&self, decided: Option<&'a SceneDecision>) -> Option<&'a LocatedEffect> {
        let is_it = |own: &Unexplained| own.dependence.is_some() && own.dependence == self.dependence;
        decided.filter(|decided| decided.unexplained.as_ref().is_some_and(is_it))?.located.unnamed.as_ref()
    }
}

/// The decision on one scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SceneDecision {
    /// The scene: `picture`, `given`, ...
    pub name: String,
    /// Share of the events that lie where the scene predicts frames: the others are not evaluated.
    #[serde(default)]
    pub share: f64,
    /// First and last instant that was evaluated, ns; none where it is the whole recording.
    #[serde(default)]
    pub span_ns: Option<(i64, i64)>,
    /// The part of the array that was evaluated; none where it is all of it.
    #[serde(default)]
    pub part: Option<Block>,
    /// Misfit or findings of another scene, where this one was preferred; empty where none was compared.
    #[serde(default)]
    pub other_scene: String,
    /// Does the recording differ from the description at all?
    pub detected: bool,
    /// For one more effect, best first; none of them passed where `unexplained` is claimed.
    pub proposals: Vec<EffectProposal>,
    /// Is a curve that no effect has nearly as probable as the best of them?
    #[serde(default)]
    pub is_unnamed_near: bool,
    /// For a second one in addition to the first of `proposals`, best first.
    pub second: Vec<EffectProposal>,
    /// The dependence that explains more than any candidate.
    pub unexplained: Option<Unexplained>,
    /// Minimum detectable effects.
    pub detectability: Vec<MinimumDetectable>,
    /// Held-out log-likelihood of an event's time with the description, nats (of a density per second).
    pub nats_per_event: Option<f64>,
    /// Distance of the description's residuals from its noise on this scene.
    pub ks: Option<f64>,
    /// Share of the misfit that the first proposal leaves.
    pub residual_left: Option<f64>,
    /// Where its answers are; empty where that was not measured.
    #[serde(default)]
    pub located: EffectLocations,
    /// Parameters that the description states as ranges, estimated before.
    #[serde(default)]
    pub estimated: Vec<SceneEstimate>,
}

/// Outcome of the decision stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum DecisionOutcome {
    /// No scene was requested.
    #[default]
    NotAsked,
    /// The scene gives no evidence; the reason.
    Nothing(String),
    /// The decision.
    Decided(Box<SceneDecision>),
}

impl DecisionOutcome {
    /// The decision; `None` without one.
    pub fn decided(&self) -> Option<&SceneDecision> {
        match self {
            DecisionOutcome::Decided(decided) => Some(decided),
            _ => None,
        }
    }
}

/// The document of an outcome, with the labels of its candidates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct ProposalsDocument {
    candidates: Vec<String>,
    proposed: DecisionOutcome,
}

fn labels() -> Vec<String> {
    CANDIDATES.iter().map(crate::candidates::Candidate::label).collect()
}

/// Direct tests as a document.
///
/// # Errors
/// When a number is not finite.
pub fn write_integrity(integrity: &Integrity) -> Result<Diagnosis, DataError> {
    Diagnosis::of(DiagnosisKind::Integrity, integrity)
}

/// Direct tests from their document.
///
/// # Errors
/// When the document is not one of [`write_integrity`], or names what is not in the catalogue.
pub fn read_integrity(document: &Diagnosis) -> Result<Integrity, DataError> {
    document.read()
}

/// Outcome of the evidence stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum EvidenceOutcome {
    /// No scene was requested.
    NotAsked,
    /// The scene gives no evidence; the reason.
    Nothing(String),
    /// Evidence of the residuals.
    Evidence(Box<SceneEvidence>),
}

/// The document of an outcome, with the labels of its candidates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct EvidenceDocument {
    candidates: Vec<String>,
    seen: EvidenceOutcome,
}

/// Evidence as a document.
///
/// # Errors
/// When a number is not finite.
pub fn write_evidence(seen: &EvidenceOutcome) -> Result<Diagnosis, DataError> {
    Diagnosis::of(DiagnosisKind::Evidence, &EvidenceDocument { candidates: labels(), seen: seen.clone() })
}

/// Evidence from its document.
///
/// # Errors
/// When the document is not one of [`write_evidence`], or was made with another list of candidates.
pub fn read_evidence(document: &Diagnosis) -> Result<EvidenceOutcome, DataError> {
    let read: EvidenceDocument = document.read()?;
    check_candidate_list(&read.candidates, "evidence", "diagnose/evidence")?;
    Ok(read.seen)
}

/// Checks that a document's list of candidates is this program's, so that indices into [`CANDIDATES`] agree.
fn check_candidate_list(candidates: &[String], what: &str, node: &str) -> Result<(), DataError> {
    if candidates == labels() {
        return Ok(());
    }
    let (count, own) = (candidates.len(), CANDIDATES.len());
    Err(DataError::new(format!(
        "the {what} were made with another list of {count} candidates (this program \
                                has {own}); run {node} again"
    )))
}

/// Proposals as a document.
///
/// # Errors
/// When a number is not finite.
pub fn write_proposals(proposed: &DecisionOutcome) -> Result<Diagnosis, DataError> {
    Diagnosis::of(
        DiagnosisKind::Proposals,
        &ProposalsDocument { candidates: labels(), proposed: proposed.clone() },
    )
}

/// Proposals from their document.
///
/// # Errors
/// When the document is not one of [`write_proposals`], or was made with another list of candidates.
pub fn read_proposals(document: &Diagnosis) -> Result<DecisionOutcome, DataError> {
    let read: ProposalsDocument = document.read()?;
    check_candidate_list(&read.candidates, "proposals", "diagnose/decide")?;
    Ok(read.proposed)
}

#[derive(Deserialize)]
struct DepartureText {
    id: String,
    parameters: Vec<(String, f64)>,
    statistic: f64,
    threshold: f64,
    share: f64,
    polarity: String,
    pixels: Vec<u32>,
    seen: String,
    heldout: Option<HalvesGain>,
    #[serde(default)]
    ci95: Vec<(String, [f64; 2])>,
}

impl<'de> Deserialize<'de> for Departure {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Departure, D::Error> {
        let text = DepartureText::deserialize(deserializer)?;
        let unknown = |what: &str| D::Error::custom(format!("`{what}` is not in the catalogue of effects"));
        let decl = catalogue()
            .into_iter()
            .map(|kind| kind.decl)
            .find(|decl| decl.id == text.id)
            .ok_or_else(|| unknown(&text.id))?;
        let name = |name: &str| decl.parameters.iter().map(|of| of.name).find(|of| *of == name);
        let parameters = text
            .parameters
            .iter()
            .map(|(of, value)| Ok((name(of).ok_or_else(|| unknown(&format!("{}.{of}", decl.id)))?, *value)));
        let ci95 = text.ci95.iter().map(|(of, interval)| {
            Ok((name(of).ok_or_else(|| unknown(&format!("{}.{of}", decl.id)))?, *interval))
        });
        let polarity = ["on", "off", "both"].into_iter().find(|polarity| *polarity == text.polarity);
        Ok(Departure {
            id: decl.id,
            parameters: parameters.collect::<Result<_, D::Error>>()?,
            statistic: text.statistic,
            threshold: text.threshold,
            share: text.share,
            polarity: polarity
                .ok_or_else(|| D::Error::custom(format!("`{}` is no polarity", text.polarity)))?,
            pixels: text.pixels,
            seen: text.seen,
            heldout: text.heldout,
            ci95: ci95.collect::<Result<_, D::Error>>()?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::check;
    use crate::report::SceneProperty;
    use crate::residual::evidence::RankedEffect;
    use crate::testing;

    #[test]
    fn what_direct_tests_saw_comes_back() {
        let step = serde_json::json!({"step": "130 us"});
        let effects =
            [("timestamp_quantization".to_owned(), step.as_object().unwrap().clone())].into_iter().collect();
        let mut found = check(&testing::case_with(&effects)).unwrap();
        assert_eq!(found.findings.len(), 1);
        found.scene.push(SceneProperty { time_ns: Some([3, 4]), ..SceneProperty::flicker(100.0, 0.1 + 0.2) });
        found.masked = vec![3, 7];
        assert_eq!(read_integrity(&write_integrity(&found).unwrap()).unwrap(), found);
    }

    #[test]
    fn an_id_that_is_in_no_catalogue_is_refused() {
        let effects = [(
            "timestamp_quantization".to_owned(),
            serde_json::json!({"step": "130 us"}).as_object().unwrap().clone(),
        )]
        .into_iter()
        .collect();
        let document = write_integrity(&check(&testing::case_with(&effects)).unwrap()).unwrap();
        for (was, is) in [
            ("timestamp_quantization", "timestamp_quantisation"),
            ("\"step\"", "\"steps\""),
            ("\"both\"", "\"either\""),
        ] {
            let other = Diagnosis::from_text(document.kind(), document.text().replacen(was, is, 1)).unwrap();
            assert!(read_integrity(&other).is_err(), "{is}");
        }
    }

    #[test]
    fn evidence_comes_back_and_so_does_why_there_is_none() {
        let some = SceneEvidence { share: 0.1 + 0.2, left: [1e-300, 2.0], ..SceneEvidence::default() };
        for seen in [
            EvidenceOutcome::Evidence(Box::new(some)),
            EvidenceOutcome::Nothing("no frames".into()),
            EvidenceOutcome::NotAsked,
        ] {
            let document = write_evidence(&seen).unwrap();
            assert_eq!(read_evidence(&document).unwrap(), seen);
            let other = Diagnosis::from_text(
                document.kind(),
                document.text().replacen(&CANDIDATES[0].label(), "something_else", 1),
            )
            .unwrap();
            assert!(read_evidence(&other).unwrap_err().message.contains("another list"));
        }
    }

    #[test]
    fn evidence_that_was_stored_without_locations_is_read() {
        let ranked = RankedEffect { candidate: 2, ..RankedEffect::default() };
        let some = SceneEvidence { ranked: vec![ranked], ..SceneEvidence::default() };
        let document = write_evidence(&EvidenceOutcome::Evidence(Box::new(some.clone()))).unwrap();
        assert!(!document.text().contains("located"));
        assert_eq!(read_evidence(&document).unwrap(), EvidenceOutcome::Evidence(Box::new(some)));
    }

    #[test]
    fn proposals_come_back_and_only_with_the_list_they_were_made_with() {
        let proposal = EffectProposal {
            candidate: 3,
            score: 1.0 / 3.0,
            ci95: Some([-1e-300, 2.0]),
            passed: true,
            heldout_nats: Some(0.1),
            ..EffectProposal::default()
        };
        let decided = SceneDecision {
            share: 0.83,
            span_ns: Some((0, 40_000_000)),
            part: Some(Block { x: 3, y: 4, width: 20, height: 10 }),
            name: "picture".into(),
            other_scene: "the other leaves more".into(),
            is_unnamed_near: true,
            detected: true,
            proposals: vec![proposal.clone()],
            second: vec![proposal],
            unexplained: Some(Unexplained { covariate: "row".into(), ..Unexplained::default() }),
            detectability: vec![MinimumDetectable {
                id: "leak_events".into(),
                parameter: "rate_hz".into(),
                estimate: None,
                standard_error: Some(0.1),
                minimal_detectable: 0.3,
                of_known_light: Some(0.1),
                usual: Some(0.2),
                unit: "Hz".into(),
            }],
            nats_per_event: Some(-2.0),
            ks: Some(0.1 + 0.2),
            estimated: vec![SceneEstimate { field: "front_end.alpha".into(), ..SceneEstimate::default() }],
            residual_left: Some(0.25),
            located: EffectLocations {
                first: vec![(3, LocatedEffect { polarity: "on".into(), ..LocatedEffect::default() })],
                ..EffectLocations::default()
            },
        };
        for proposed in [
            DecisionOutcome::Decided(Box::new(decided)),
            DecisionOutcome::Nothing("no light".into()),
            DecisionOutcome::NotAsked,
        ] {
            let document = write_proposals(&proposed).unwrap();
            assert_eq!(read_proposals(&document).unwrap(), proposed);
            let other = Diagnosis::from_text(
                document.kind(),
                document.text().replacen(&CANDIDATES[0].label(), "something_else", 1),
            )
            .unwrap();
            assert!(read_proposals(&other).unwrap_err().message.contains("another list"));
        }
    }
}
