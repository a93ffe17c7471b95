//! A value that no file states, with its reason.

/// The value.
pub struct Fill {
    /// The parameter.
    pub name: &'static str,
    /// As TOML.
    pub value: String,
    /// Why this value, and what depends on it.
    pub why: String,
    /// Is it a question that the user has to check (`FILL:`), or settled by what was found?
    pub is_open: bool,
}

impl Fill {
    /// A proposal that is marked.
    pub fn open(name: &'static str, value: impl Into<String>, why: impl Into<String>) -> Fill {
        Fill { name, value: value.into(), why: why.into(), is_open: true }
    }

    /// A correction that is stated with its reason.
    pub fn settled(name: &'static str, value: impl Into<String>, why: impl Into<String>) -> Fill {
        Fill { name, value: value.into(), why: why.into(), is_open: false }
    }
}
