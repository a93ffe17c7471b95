//! Events of one file with frames of another place: a RAW file and a folder of PNGs, an AEDAT file and a Y4M
//! video.
//!
//! Both must stand on one clock. The frames' times are the stamps of a text file, or the pulses of a trigger
//! line that the event file recorded.

use crate::chunk::{Edge, Trigger};
use crate::declared::Declared;
use crate::error::{FormatError, Loss};
use crate::format::Format;
use crate::instead::explained;
use crate::known::with_known_camera;
use crate::pictures::PictureFiles;
use crate::placed::placed;
use crate::recording::{EventCursor, EventsAbout, Pictures, Recording};
use crate::restamped::restamped;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// An event recording with frames from elsewhere.
pub struct Joined {
    events: Box<dyn Recording>,
    frames: Arc<PictureFiles>,
}

/// Adds the frames that are declared ([`Declared::frames`]); without any, the recording stays as it is.
///
/// # Errors
/// When there are no pictures, or nothing says when they were taken.
pub(crate) fn with_declared_frames(
    events: Box<dyn Recording>,
    declared: &Declared,
) -> Result<Box<dyn Recording>, FormatError> {
    match &declared.frames {
        Some(path) => Ok(Box::new(Joined::new(events, path, declared)?)),
        None => Ok(events),
    }
}

/// Opens a file of a known format, with the frames that are declared for it.
///
/// # Errors
/// When the file cannot be read, or its frames cannot.
pub fn open(format: &Format, path: &Path, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    let opened = (format.open)(path, declared).and_then(|recording| match declared.frames {
        Some(_) => with_declared_frames(recording, declared),
        None => Ok(with_known_camera(format, recording)),
    });
    opened
        .and_then(|recording| placed(path, restamped(format.id, recording, declared), declared))
        .map_err(|error| explained(error, declared))
}

impl Joined {
    /// Joins a recording with the pictures at `path`. A declared trigger line goes before stamps.
    ///
    /// # Errors
    /// When there are no pictures, nothing says when they were taken, or which belongs to which time is a
    /// question.
    pub fn new(events: Box<dyn Recording>, path: &Path, declared: &Declared) -> Result<Joined, FormatError> {
        let frames = match declared.trigger_line {
            Some(line) => {
                let triggers = events.triggers()?;
                if !triggers.iter().any(|trigger| trigger.line == line) {
                    let found =
                        format!("no exposure on trigger line {line} of the event file ({})", said(&triggers));
                    let mut error =
                        FormatError::new(path, found, "state another `trigger_line`, or a file of `stamps`")
                            .expected("rising and falling edges");
                    error.undeclared = Some("trigger_line");
                    return Err(error);
                }
                PictureFiles::of_line(path, &triggers, line, declared)?
            }
            None => PictureFiles::open(path, declared).or_else(|error| {
                if error.undeclared != Some("stamps") {
                    return Err(error);
                }
                // The event file may know when the frames were taken.
                let triggers = events.triggers()?;
                let edges = said(&triggers);
                Err(FormatError {
                    found: format!("{}; the event file has {edges}", error.found),
                    hint: format!("{}, or a `trigger_line`", error.hint),
                    ..error
                })
            })?,
        };
        Ok(Joined { events, frames: Arc::new(frames) })
    }
}

/// Edges of every line, for messages.
fn said(triggers: &[Trigger]) -> String {
    let mut lines: Vec<(u16, usize, usize)> = Vec::new();
    for trigger in triggers {
        let index = lines.iter().position(|(line, ..)| *line == trigger.line).unwrap_or_else(|| {
            lines.push((trigger.line, 0, 0));
            lines.len() - 1
        });
        match trigger.edge {
            Edge::Rising => lines[index].1 += 1,
            Edge::Falling => lines[index].2 += 1,
        }
    }
    lines.sort_unstable();
    if lines.is_empty() {
        return "no trigger edges".into();
    }
    lines
        .iter()
        .map(|(line, rising, falling)| {
            format!("{rising} rising and {falling} falling edges on trigger line {line}")
        })
        .collect::<Vec<_>>()
        .join(", ")
}

impl Recording for Joined {
    fn events_about(&self) -> Option<&EventsAbout> {
        self.events.events_about()
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        self.events.events()
    }

    fn pictures(&self) -> Option<Arc<dyn Pictures>> {
        Some(self.frames.clone())
    }

    fn triggers(&self) -> Result<Vec<Trigger>, FormatError> {
        self.events.triggers()
    }

    crate::recording::forward!(events, without losses and files);

    fn losses(&self) -> Vec<Loss> {
        let mut losses = self.events.losses();
        losses.extend_from_slice(self.frames.losses());
        losses
    }

    fn files(&self) -> Vec<PathBuf> {
        let mut files = self.events.files();
        files.extend_from_slice(self.frames.files());
        files
    }
}
