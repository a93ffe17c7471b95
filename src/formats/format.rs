//! What a format is, and what of a file decides whether it has it: its content, never its name alone.

use crate::declared::Declared;
use crate::error::FormatError;
use crate::recording::Recording;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Opens a file of a format.
pub(crate) type Open = fn(&Path, &Declared) -> Result<Box<dyn Recording>, FormatError>;

/// A format.
pub struct Format {
    /// Short and stable: the node is `read/<id>`.
    pub id: &'static str,
    /// For people: "Prophesee RAW, EVT3".
    pub name: &'static str,
    /// Is this file or folder one? Cheap: headers only.
    pub recognises: fn(&Probe) -> bool,
    /// Opens a file that is one.
    pub open: Open,
}

/// Names in a folder that are looked at; more are not needed to know what it is.
const MOST_NAMES: usize = 4096;

/// What is looked at to recognise a file.
pub struct Probe {
    /// The file or folder.
    pub path: PathBuf,
    /// The first bytes of a file, 4096 at most; empty for a folder.
    pub head: Vec<u8>,
    /// Size of a file in bytes.
    pub bytes: u64,
    /// What stands in a folder, sorted, at most 4096 names; `None` for a file.
    pub names: Option<Vec<String>>,
}

impl Probe {
    /// Looks at a file or folder.
    ///
    /// # Errors
    /// When it is not there or may not be read.
    pub fn new(path: &Path) -> Result<Probe, FormatError> {
        let io = |error: std::io::Error| FormatError::io(path, &error);
        let metadata = std::fs::metadata(path).map_err(io)?;
        let mut probe = Probe { path: path.into(), head: Vec::new(), bytes: metadata.len(), names: None };
        if metadata.is_dir() {
            let entries = std::fs::read_dir(path).map_err(io)?.take(MOST_NAMES);
            let mut names: Vec<String> = entries
                .filter_map(Result::ok)
                .map(|entry| entry.file_name().to_string_lossy().into_owned())
                .collect();
            names.sort();
            probe.names = Some(names);
        } else if metadata.is_file() {
            File::open(path).map_err(io)?.take(4096).read_to_end(&mut probe.head).map_err(io)?;
        } else {
            return Err(FormatError::new(path, "this is neither a file nor a folder", "name a recording"));
        }
        Ok(probe)
    }

    /// Does the file begin as HDF5 does (without a user block)?
    pub fn is_hdf5(&self) -> bool {
        self.head.starts_with(b"\x89HDF\r\n\x1a\n")
    }

    /// Does the folder have such an entry?
    pub fn has(&self, name: &str) -> bool {
        self.names.as_ref().is_some_and(|names| names.iter().any(|n| n == name))
    }

    /// The extension in lower case; empty without one.
    pub fn extension(&self) -> String {
        self.path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).unwrap_or_default()
    }
}
