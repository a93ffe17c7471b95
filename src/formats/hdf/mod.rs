//! Event cameras' data in HDF5: one reader of columns for all layouts, and one small module for each layout.
//!
//! A file is recognised by the datasets that are in it, never by its name. All layouts are read through
//! `photocurrent_store::foreign`, which trusts nothing.
//!
//! | module | events | stamps | frames |
//! | --- | --- | --- | --- |
//! | [`recording`] | `events/{x,y,t,p,t_in}` | i64 ns | `frames/dn` |
//! | [`dsec`] | `events/{x,y,t,p}`, `ms_to_idx`, `t_offset` | u32 us | a separate folder |
//! | [`m3ed`] | `prophesee/left/{x,y,t,p}`, `ms_map_idx` | i64 us | `ovc/{left,right,rgb}/data`, `ovc/ts` |
//! | [`mvsec`] | `davis/left/events` N x 4: x, y, t, p | f64 s | `image_raw`, `image_raw_ts` |
//! | [`prophesee`] | `CD/events` {x, y, p, t} | i64 us | none; triggers |
//! | [`v2e`] | `events` N x 4: t, x, y, p | u32 us | `frame`, `frame_ts` |
//! | [`event_utils`] | `events/{xs,ys,ts,ps}` | f64 s | `images/image000000000` with attributes |

pub(crate) mod dsec;
pub(crate) mod event_utils;
pub(crate) mod m3ed;
pub(crate) mod mvsec;
pub(crate) mod prophesee;
pub(crate) mod recording;
mod refusal;
mod stack;
mod table;
pub(crate) mod v2e;
pub mod write;

#[cfg(test)]
mod cut_tests;
#[cfg(test)]
mod tests;

use crate::convention::{Lazy, Rules, Settled};
use crate::error::{Cause, FormatError, Loss};
use crate::format::Probe;
use crate::recording::{Convention, EventCursor, EventsAbout, Pictures, Recording, not_read};
use crate::{Declared, chunk::Trigger};
use photocurrent_core::Extent;
use photocurrent_store::foreign::{ForeignDataset, ForeignFile};
use refusal::{COPY, refused};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use table::{EventTable, TableCursor};

fn open_file(path: &Path) -> Result<ForeignFile, FormatError> {
    ForeignFile::open(path).map_err(|error| refused(path, error))
}

/// A dataset that a layout may lack. In a cut file its header may be lost: that is a loss.
fn optional(
    file: &ForeignFile,
    name: &str,
    losses: &mut Vec<Loss>,
) -> Result<Option<ForeignDataset>, FormatError> {
    match file.dataset(name) {
        Err(_) if file.cut().is_some() => {
            losses.push(
                Loss::new(format!("/{name}"), "its header lies behind the cut; it is lost").by(Cause::Cut),
            );
            Ok(None)
        }
        found => found.map_err(|error| refused(file.path(), error)),
    }
}

/// What opening gave; a refusal of a cut file says so first.
fn with_cut(opened: Result<Box<dyn Recording>, FormatError>) -> Result<Box<dyn Recording>, FormatError> {
    opened.map_err(|error| match ForeignFile::open(&error.path).ok().and_then(|file| file.cut()) {
        Some(cut) => FormatError {
            found: format!("{cut}, and what is needed lies behind the cut: {}", error.found),
            ..error
        },
        None => error,
    })
}

/// Why an HDF5 file that no layout recognises cannot be read at all.
///
/// # Errors
/// When it cannot be opened, or is cut so early that its layout is lost.
pub(crate) fn readable(path: &Path) -> Result<(), FormatError> {
    match open_file(path)?.cut() {
        Some(cut) => Err(FormatError::new(
            path,
            format!("{cut}, and no layout can be recognised in what is left"),
            COPY,
        )),
        None => Ok(()),
    }
}

/// Does an HDF5 file hold all these datasets or groups?
fn holds(probe: &Probe, names: &[&str]) -> bool {
    probe.is_hdf5()
        && ForeignFile::open(&probe.path).is_ok_and(|file| names.iter().all(|name| file.has(name)))
}

/// An extent of two sides that make sense.
fn extent(width: f64, height: f64) -> Option<Extent> {
    let side = |n: f64| (n.fract() == 0.0 && (1.0..=65_536.0).contains(&n)).then_some(n as u32);
    Some(Extent { width: side(width)?, height: side(height)? })
}

/// One camera of a file with several: `declared.camera`, or the first that is there. Errors name those that
/// are there.
fn chosen<'a>(
    path: &Path,
    wanted: Option<&str>,
    there: &[&'a str],
    what: &str,
    field: &'static str,
) -> Result<&'a str, FormatError> {
    match wanted {
        None => there.first().copied().ok_or_else(|| {
            FormatError::new(path, format!("there is no {what}"), "is this the file that you meant?")
        }),
        Some(wanted) => there.iter().copied().find(|name| *name == wanted).ok_or_else(|| {
            let found = format!("there is no {what} `{wanted}`");
            FormatError::new(path, found, format!("choose one of: {}", there.join(", "))).undeclared(field)
        }),
    }
}

/// The note that one camera of several was read, where none was stated.
fn others(wanted: Option<&str>, chosen: &str, there: &[&str], what: &str, field: &str) -> Option<String> {
    let others: Vec<&str> = there.iter().copied().filter(|name| *name != chosen).collect();
    (wanted.is_none() && !others.is_empty()).then(|| not_read(what, chosen, &others, field))
}

/// What every layout gives: a table of events, pictures, triggers, facts.
struct HdfRecording {
    path: PathBuf,
    about: Option<EventsAbout>,
    table: Option<Arc<EventTable>>,
    /// What is recognised of the columns; none for layouts that define all of it.
    lazy: Option<Lazy>,
    pictures: Option<Arc<dyn Pictures>>,
    triggers: Vec<Trigger>,
    sensor: Option<String>,
    facts: Vec<(String, String)>,
    losses: Vec<Loss>,
    /// Other files that were read.
    more_files: Vec<PathBuf>,
}

impl HdfRecording {
    /// Of a file, or of a folder and its file, with or without events. What was lost while it was opened
    /// stands behind the cut that caused it.
    fn new(
        path: &Path,
        file: &ForeignFile,
        table: Option<EventTable>,
        notes: Vec<String>,
        lost: Vec<Loss>,
    ) -> HdfRecording {
        let whole =
            |cut: String| Loss::new("the file", format!("{cut}; what lies behind is lost")).by(Cause::Cut);
        let about = table.as_ref().map(|table| table.about(notes));
        HdfRecording {
            path: path.into(),
            about,
            table: table.map(Arc::new),
            lazy: None,
            pictures: None,
            triggers: Vec::new(),
            sensor: None,
            facts: Vec::new(),
            losses: file.cut().map(whole).into_iter().chain(lost).collect(),
            more_files: Vec::new(),
        }
    }
}

impl HdfRecording {
    /// Adds a note on the events.
    fn note(&mut self, note: Option<String>) {
        if let Some(about) = &mut self.about {
            about.notes.extend(note.clone());
        }
        if let Some(lazy) = &mut self.lazy {
            lazy.note(note);
        }
    }

    /// Lets what the columns hold decide how they are read: for layouts that other people's programs write.
    fn recognising(mut self, declared: &Declared) -> HdfRecording {
        self.lazy = self.about.clone().map(|about| Lazy::new(&self.path, declared, about));
        self
    }

    /// How the events are read, where what the columns hold decides it.
    fn settled(&self) -> Option<Result<&Settled, FormatError>> {
        let (lazy, table) = (self.lazy.as_ref()?, self.table.as_ref()?);
        Some(lazy.settled(|tally| table.tally(tally)))
    }
}

impl Recording for HdfRecording {
    fn events_about(&self) -> Option<&EventsAbout> {
        match self.settled() {
            Some(Ok(settled)) => Some(&settled.about),
            _ => self.about.as_ref(),
        }
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        let table = self
            .table
            .clone()
            .ok_or_else(|| FormatError::new(&self.path, "there are no events", "name a file with events"))?;
        let Some(settled) = self.settled().transpose()? else {
            return Ok(Box::new(TableCursor::new(table, Rules::default())));
        };
        Ok(settled.followed(Box::new(TableCursor::new(table, settled.rules))))
    }

    fn conventions(&self) -> Vec<Convention> {
        self.settled().and_then(Result::ok).map_or_else(Vec::new, |settled| settled.conventions.clone())
    }

    fn pictures(&self) -> Option<Arc<dyn Pictures>> {
        self.pictures.clone()
    }

    fn triggers(&self) -> Result<Vec<Trigger>, FormatError> {
        Ok(self.triggers.clone())
    }

    fn sensor_text(&self) -> Option<&str> {
        self.sensor.as_deref()
    }

    fn facts(&self) -> Vec<(String, String)> {
        self.facts.clone()
    }

    fn losses(&self) -> Vec<Loss> {
        self.losses.clone()
    }

    fn files(&self) -> Vec<PathBuf> {
        // Of a sequence's folder, only what was read.
        std::iter::once(&self.path).chain(&self.more_files).filter(|path| !path.is_dir()).cloned().collect()
    }
}

/// What the user states about the sensor's size wins over what the file says.
fn declared_extent(declared: &Declared, found: Option<Extent>) -> Option<Extent> {
    declared.extent.or(found)
}
