//! What can go wrong while data is read or a node works.

use crate::data_type::DataType;
use crate::document::Problem;
use std::fmt;
use std::path::Path;

/// Data could not be read: a file, a damaged artefact, or a request outside what a handle holds.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct DataError {
    /// What was asked, what was found.
    pub message: String,
}

impl DataError {
    /// From a message that names the file or value.
    pub fn new(message: impl Into<String>) -> DataError {
        DataError { message: message.into() }
    }
}

/// Why a file could not be read, in the reader's terms: "cannot read scene.h5: there is no such file".
pub fn cannot_read(path: &Path, error: &std::io::Error) -> String {
    use std::io::ErrorKind;
    let trouble = match error.kind() {
        ErrorKind::NotFound => "there is no such file".to_string(),
        ErrorKind::InvalidData => "it is not text in UTF-8".to_string(),
        ErrorKind::IsADirectory => "it is a folder, not a file".to_string(),
        ErrorKind::PermissionDenied => "its permissions forbid it".to_string(),
        _ => error.to_string(),
    };
    format!("cannot read {}: {trouble}", path.display())
}

/// What kind of trouble stopped a node; decides the exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trouble {
    /// The parameters or the wiring cannot work: found while planning.
    Usage,
    /// Input data failed a check.
    Input,
    /// A file could not be read or written.
    Files,
    /// The user interrupted the run.
    Interrupted,
    /// Anything else that stops a node.
    Failed,
}

/// Why a node refused or failed, in the reader's terms: what, the facts behind it, what to do next.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeError {
    /// What kind of trouble.
    pub trouble: Trouble,
    /// One sentence.
    pub message: String,
    /// Facts behind it, one line each.
    pub notes: Vec<String>,
    /// What to do next.
    pub hint: Option<String>,
    /// The parameter that is to blame, when one is: `readout`, `window.start`.
    pub param: Option<String>,
    /// The type of the input that is to blame, when one is: a plan then says which file it was read from.
    pub blamed_input: Option<DataType>,
    /// Mistakes in a text file that the node read, each at its place.
    pub problems: Vec<Problem>,
    /// Fields of the sensor description that the node needs and that are not stated: `front_end.tau_0`.
    pub lacks: Vec<String>,
}

impl NodeError {
    fn with(trouble: Trouble, message: impl Into<String>) -> NodeError {
        NodeError {
            trouble,
            message: message.into(),
            notes: Vec::new(),
            hint: None,
            param: None,
            blamed_input: None,
            problems: Vec::new(),
            lacks: Vec::new(),
        }
    }

    /// The parameters or the wiring cannot work.
    pub fn usage(message: impl Into<String>) -> NodeError {
        NodeError::with(Trouble::Usage, message)
    }

    /// Input data failed a check.
    pub fn input(message: impl Into<String>) -> NodeError {
        NodeError::with(Trouble::Input, message)
    }

    /// A file could not be read or written.
    pub fn files(message: impl Into<String>) -> NodeError {
        NodeError::with(Trouble::Files, message)
    }

    /// The user interrupted the run.
    pub fn interrupted() -> NodeError {
        NodeError::with(Trouble::Interrupted, "interrupted")
    }

    /// Anything else.
    pub fn failed(message: impl Into<String>) -> NodeError {
        NodeError::with(Trouble::Failed, message)
    }

    /// Adds a fact.
    pub fn note(mut self, note: impl Into<String>) -> NodeError {
        self.notes.push(note.into());
        self
    }

    /// Says what to do next.
    pub fn hint(mut self, hint: impl Into<String>) -> NodeError {
        self.hint = Some(hint.into());
        self
    }

    /// Adds mistakes in a text file.
    pub fn problems(mut self, problems: Vec<Problem>) -> NodeError {
        self.problems = problems;
        self
    }

    /// Names the type of the input to blame.
    pub fn blames(mut self, input: DataType) -> NodeError {
        self.blamed_input = Some(input);
        self
    }

    /// Names the parameter to blame.
    pub fn param(mut self, param: impl Into<String>) -> NodeError {
        self.param = Some(param.into());
        self
    }
}

impl fmt::Display for NodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.message)?;
        for note in &self.notes {
            write!(f, "\n  {note}")?;
        }
        if let Some(hint) = &self.hint {
            write!(f, "\n  hint: {hint}")?;
        }
        Ok(())
    }
}

impl std::error::Error for NodeError {}

impl From<DataError> for NodeError {
    fn from(error: DataError) -> NodeError {
        NodeError::input(error.message)
    }
}
