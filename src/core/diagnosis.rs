//! Documents of a diagnosis: what one of its stages found, as JSON of a stated kind.
//!
//! The stages are far apart in what they say and alike in how they are kept, so that there is one data type
//! for all: a kind, which is known before any data and checked while planning, and a text. The text is the
//! content, byte for byte: what is written out for the user is what was digested.

use crate::data_type::DataType;
use crate::digest::{Digest, DigestBuilder};
use crate::error::{DataError, NodeError};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Which stage this is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DiagnosisKind {
    /// What shows without a scene.
    Integrity,
    /// A known target: what is stated of it, and what was fitted.
    Target,
    /// What the residuals on a scene say of every effect.
    Evidence,
    /// What the tests that estimate the scene propose.
    Proposals,
    /// The answer: what `diagnosis.json` holds.
    Report,
    /// The answer as a page for people, one JSON text.
    Page,
}

impl DiagnosisKind {
    /// The name in errors and files.
    pub fn name(self) -> &'static str {
        match self {
            DiagnosisKind::Integrity => "integrity",
            DiagnosisKind::Target => "target",
            DiagnosisKind::Evidence => "evidence",
            DiagnosisKind::Proposals => "proposals",
            DiagnosisKind::Report => "report",
            DiagnosisKind::Page => "page",
        }
    }
}

impl fmt::Display for DiagnosisKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What is known about a document before its data.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosisMeta {
    /// Which stage this is.
    pub kind: DiagnosisKind,
}

impl DiagnosisMeta {
    /// Refuses a document of another stage at `port`.
    ///
    /// # Errors
    /// When it is of another kind than `needed`.
    pub fn need(&self, needed: DiagnosisKind, port: &str) -> Result<(), NodeError> {
        if self.kind == needed {
            return Ok(());
        }
        Err(NodeError::usage(format!(
            "`{port}` takes a diagnosis of kind {needed}, and this one is of kind {}",
            self.kind
        ))
        .hint("`photocurrent nodes` says which node gives which")
        .blames(DataType::Diagnosis))
    }
}

/// A document.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnosis {
    kind: DiagnosisKind,
    text: String,
}

impl Diagnosis {
    /// From what a stage found.
    ///
    /// # Errors
    /// When it cannot be read again as it is: a number in it is not finite, which JSON has no word for.
    pub fn of<T: Serialize + DeserializeOwned + PartialEq>(
        kind: DiagnosisKind,
        found: &T,
    ) -> Result<Diagnosis, DataError> {
        let text = serde_json::to_string(found).map_err(|error| {
            DataError::new(format!("a diagnosis of kind {kind} cannot be written as JSON: {error}"))
        })?;
        let document = Diagnosis { kind, text };
        let again: T = document.read()?;
        if again != *found {
            return Err(DataError::new(format!(
                "a diagnosis of kind {kind} is not the same after it was \
                                               written as JSON: a number in it is not finite"
            )));
        }
        Ok(document)
    }

    /// From a JSON text, which is kept as it is.
    ///
    /// # Errors
    /// When it is no JSON.
    pub fn from_text(kind: DiagnosisKind, text: String) -> Result<Diagnosis, DataError> {
        match serde_json::from_str::<serde::de::IgnoredAny>(&text) {
            Ok(_) => Ok(Diagnosis { kind, text }),
            Err(error) => Err(DataError::new(format!("a diagnosis of kind {kind} is no JSON: {error}"))),
        }
    }

    /// Which stage this is.
    pub fn kind(&self) -> DiagnosisKind {
        self.kind
    }

    /// The JSON text.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// What the stage found.
    ///
    /// # Errors
    /// When the text does not say it: another version of the program made it.
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, DataError> {
        serde_json::from_str(&self.text).map_err(|error| {
            DataError::new(format!("a diagnosis of kind {} cannot be read: {error}", self.kind))
        })
    }

    /// The name of the content.
    pub fn digest(&self) -> Digest {
        let mut digest = DigestBuilder::new("diagnosis/1");
        digest.text(self.kind.name()).text(&self.text);
        digest.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_stage_found_comes_back_to_the_last_bit() {
        let found = vec![0.1 + 0.2, 5e-324, -1.234_567_890_123_456_7e-300];
        let document = Diagnosis::of(DiagnosisKind::Proposals, &found).unwrap();
        assert_eq!(document.read::<Vec<f64>>().unwrap(), found);
        let other = Diagnosis::of(DiagnosisKind::Integrity, &found).unwrap();
        assert_ne!(document.digest(), other.digest(), "the same text of another stage is another content");
    }

    #[test]
    fn a_number_that_json_has_no_word_for_is_refused() {
        for value in [f64::NAN, f64::INFINITY] {
            assert!(Diagnosis::of(DiagnosisKind::Proposals, &vec![value]).is_err());
            // As an option it would be read again as nothing.
            let error = Diagnosis::of(DiagnosisKind::Proposals, &Some(value)).unwrap_err();
            assert!(error.message.contains("not finite"), "{}", error.message);
        }
    }

    #[test]
    fn a_text_is_kept_byte_for_byte_and_must_be_json() {
        let text = "{\n  \"verdict\": \"named\"\n}\n";
        assert_eq!(Diagnosis::from_text(DiagnosisKind::Report, text.into()).unwrap().text(), text);
        assert!(
            Diagnosis::from_text(DiagnosisKind::Report, "{".into())
                .unwrap_err()
                .message
                .contains("kind report is no JSON")
        );
    }

    #[test]
    fn another_stage_is_refused_by_name() {
        let meta = DiagnosisMeta { kind: DiagnosisKind::Page };
        assert!(meta.need(DiagnosisKind::Page, "page").is_ok());
        assert_eq!(
            meta.need(DiagnosisKind::Report, "report").unwrap_err().message,
            "`report` takes a diagnosis of kind report, and this one is of kind page"
        );
    }
}
