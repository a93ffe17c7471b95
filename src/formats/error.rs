//! Why a file is refused, and what was lost of one that is damaged.

use photocurrent_core::{DataError, NodeError};
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};

/// A file cannot be read as what it is said to be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FormatError {
    /// The file or folder.
    pub path: PathBuf,
    /// Where in it: "line 17", "byte 4096", "/events/t".
    pub at: Option<String>,
    /// What is there.
    pub found: String,
    /// What should be there.
    pub expected: Option<String>,
    /// What to do next.
    pub hint: String,
    /// Does the file lack a fact that its format does not record, so that the user must state it? Names the
    /// field of [`crate::Declared`].
    pub undeclared: Option<&'static str>,
}

impl FormatError {
    /// From what was found and what to do about it.
    pub fn new(path: &Path, found: impl Into<String>, hint: impl Into<String>) -> FormatError {
        FormatError {
            path: path.into(),
            at: None,
            found: found.into(),
            expected: None,
            hint: hint.into(),
            undeclared: None,
        }
    }

    /// The system could not open or read a file.
    pub fn io(path: &Path, error: &std::io::Error) -> FormatError {
        FormatError::new(
            path,
            photocurrent_core::error::cannot_read(path, error),
            "check the path, and that the file may be read",
        )
    }

    /// Says where in the file.
    #[must_use]
    pub fn at(mut self, at: impl Into<String>) -> FormatError {
        self.at = Some(at.into());
        self
    }

    /// Says what should be there.
    #[must_use]
    pub fn expected(mut self, expected: impl Into<String>) -> FormatError {
        self.expected = Some(expected.into());
        self
    }

    /// Says that the user must state `field` of [`crate::Declared`].
    #[must_use]
    pub fn undeclared(mut self, field: &'static str) -> FormatError {
        self.undeclared = Some(field);
        self
    }
}

impl FormatError {
    /// Where, what was found, what was expected: the first line.
    fn first_line(&self) -> String {
        let at = self.at.as_ref().map(|at| format!(": {at}")).unwrap_or_default();
        let expected =
            self.expected.as_ref().map(|expected| format!(", expected {expected}")).unwrap_or_default();
        let path = self.path.display().to_string() + &at;
        if path.is_empty() {
            format!("{}{expected}", self.found)
        } else {
            format!("{path}: {}{expected}", self.found)
        }
    }
}

impl fmt::Display for FormatError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}\n  hint: {}", self.first_line(), self.hint)
    }
}

impl std::error::Error for FormatError {}

/// Data that could not be brought into order: the file is named by who reports it.
impl From<DataError> for FormatError {
    fn from(error: DataError) -> FormatError {
        FormatError::new(
            Path::new(""),
            error.message,
            "free some memory or room for temporary files, or read a shorter window",
        )
    }
}

impl From<FormatError> for DataError {
    fn from(error: FormatError) -> DataError {
        DataError::new(error.to_string())
    }
}

impl From<FormatError> for NodeError {
    fn from(error: FormatError) -> NodeError {
        NodeError::input(error.first_line()).hint(error.hint).param(error.undeclared.unwrap_or("path"))
    }
}

/// Why a part of a file was left out: what can be done about it follows from this.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// Bytes are not what they were when they were written.
    #[default]
    Damage,
    /// The file ends before its content does.
    Cut,
    /// Pixels lie outside of the array that is stated.
    Outside,
    /// Polarities are none that the reading knows.
    Polarity,
    /// Stamps are no times.
    Stamp,
}

/// A part of a file that could not be read; what stands around it was.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Loss {
    /// Where: "bytes 4096 to 5120", "line 17", "packet 12".
    pub at: String,
    /// What is wrong there and what was left out: "the packet is cut off; its events are lost".
    pub what: String,
    /// Why.
    pub cause: Cause,
    /// Places that this entry counts, where it closes a list of them; 0 for a place by itself.
    pub more: u64,
}

impl Loss {
    /// One place.
    pub fn new(at: impl Into<String>, what: impl Into<String>) -> Loss {
        Loss { at: at.into(), what: what.into(), ..Loss::default() }
    }

    /// States why.
    #[must_use]
    pub fn by(self, cause: Cause) -> Loss {
        Loss { cause, ..self }
    }

    /// How many places it stands for.
    pub fn places(&self) -> u64 {
        self.more.max(1)
    }
}
