//! Frames without events: a folder of PNG, TIFF or JPEG pictures, or a Y4M file, with stamps from a text
//! file.
//!
//! The stamps come from a declared file, or from one that stands in the folder (`timestamps.txt`,
//! `timestamp.txt`, `images.txt`, `frames.csv`). A Y4M file without stamps has the constant rate of its
//! header, and a note says so. Values are given as stored: see [`crate::declared::Transfer`]. Limits: the
//! first picture of a file with several; all frames have one size and one depth.

pub mod decode;
mod files;
mod head;
mod jpeg;
#[cfg(test)]
mod jpeg_tests;
pub mod names;
pub mod pairing;
pub(crate) mod partners;
pub(crate) mod place;
pub(crate) mod stamps;
#[cfg(test)]
pub(crate) mod tests;
pub mod triggers;
pub mod y4m;

pub use files::PictureFiles;
pub(crate) use files::{Defined, Found, find, rows_of, size_of, stamps_file};

use crate::declared::Declared;
use crate::error::{FormatError, Loss};
use crate::format::{Format, Probe};
use crate::recording::{EventCursor, EventsAbout, Pictures, Recording};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Folders of pictures and Y4M files.
pub static FORMAT: Format = Format {
    id: "pictures",
    name: "pictures (PNG, TIFF or JPEG folder, Y4M)",
    recognises,
    open: |path, declared| Ok(Box::new(PicturesOnly::open(path, declared)?)),
};

fn recognises(probe: &Probe) -> bool {
    match &probe.names {
        Some(names) => names.iter().any(|name| names::is_picture(name)),
        None => probe.head.starts_with(y4m::MAGIC),
    }
}

/// Pictures as a recording: frames and no events.
pub struct PicturesOnly {
    path: PathBuf,
    frames: Arc<PictureFiles>,
}

impl PicturesOnly {
    fn open(path: &Path, declared: &Declared) -> Result<PicturesOnly, FormatError> {
        Ok(PicturesOnly { path: path.into(), frames: Arc::new(PictureFiles::open(path, declared)?) })
    }
}

impl Recording for PicturesOnly {
    fn events_about(&self) -> Option<&EventsAbout> {
        None
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        Err(FormatError::new(
            &self.path,
            "pictures have no events",
            "name an event recording, and these pictures as its `frames`",
        ))
    }

    fn pictures(&self) -> Option<Arc<dyn Pictures>> {
        Some(self.frames.clone())
    }

    fn losses(&self) -> Vec<Loss> {
        self.frames.losses.clone()
    }

    fn files(&self) -> Vec<PathBuf> {
        self.frames.files.clone()
    }
}
