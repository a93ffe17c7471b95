//! A sequence folder of HS-ERGB or BS-ERGB (Time Lens, Time Lens++): event files `events*/000000.npz`,
//! pictures `images*/000000.png`, and their stamps in `timestamp.txt` or `timestamps.txt`.
//!
//! Event file n lies between pictures n and n + 1. Stamps are microseconds; that is taken only where the
//! values agree with it. BS-ERGB's coordinates were rectified and are stored as 16-bit numbers of 1/32
//! pixel, where negative ones appear as 65,536 too large; HS-ERGB's are whole pixels or floats. Which of
//! these it is follows from the values and is noted. Places with fractions were warped to the pictures:
//! each pixel has the events of the event pixel that sees it ([`crate::warped`]). Source: the loaders of
//! Time Lens and of EVREAL. Limits: the events' array is taken to be as large as the pictures, on which
//! they were aligned; what lies outside is left out.

use crate::chunk::EventChunk;
use crate::convention::{Lazy, Rules, Tally};
use crate::declared::{Column, Declared, TimeUnit};
use crate::error::{FormatError, Loss};
use crate::evidence::{self, Of};
use crate::format::{Format, Probe};
use crate::losses::Losses;
use crate::npy::header::Kind;
use crate::npy::table::{Reading, Table, TableCursor};
use crate::npz;
use crate::pictures::{Defined, PictureFiles, names};
use crate::recording::{Convention, EventCursor, EventsAbout, Pictures, Recording};
use crate::warped::{Array, Warped};
use photocurrent_core::Extent;
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// HS-ERGB and BS-ERGB sequences.
pub(crate) static FORMAT: Format = Format {
    id: "hs_ergb",
    name: "HS-ERGB or BS-ERGB sequence folder",
    recognises,
    open: |path, declared| Ok(Box::new(HsErgb::open(path, declared)?)),
};

const EVENTS: [&str; 3] = ["events_aligned", "events_corrected", "events"];
const IMAGES: [&str; 3] = ["images_corrected", "images_aligned", "images"];
/// So many files, and events of each, show where event pixels lie.
const FILES_OF_PLACES: usize = 16;
const EVENTS_OF_PLACES: usize = 1 << 19;
const STAMPS: [&str; 2] = ["timestamp.txt", "timestamps.txt"];

fn recognises(probe: &Probe) -> bool {
    let events = events_folder(&probe.path, |name| probe.has(name));
    // Pictures in folders of these names, but no event files: a sequence that was copied or unpacked in part.
    let in_part = ["images_corrected", "images_aligned"].iter().any(|name| probe.has(name));
    let has_images = IMAGES.iter().any(|name| probe.has(name))
        && (probe.has("timestamp.txt")
            || IMAGES.iter().any(|name| probe.path.join(name).join("timestamp.txt").is_file()));
    match events {
        Some(folder) => archives(&folder)
            .is_ok_and(|files| !files.is_empty() || in_part || has_images && is_empty(&folder)),
        None => in_part,
    }
}

fn is_empty(folder: &Path) -> bool {
    std::fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_none())
}

/// The refusal of a sequence without event files.
fn without_events(path: &Path) -> FormatError {
    let found = match events_folder(path, |name| path.join(name).is_dir()) {
        Some(folder) => format!(
            "{}/000000.npz and all other event files are missing",
            folder.file_name().unwrap_or_default().to_string_lossy()
        ),
        None => "the folder of event files is missing".into(),
    };
    let hint = "they come with the sequence's download (Time Lens: HS-ERGB, Time Lens++: BS-ERGB on \
                rpg.ifi.uzh.ch); name the folder of one sequence";
    FormatError::new(path, found, hint)
        .expected("a folder `events`, `events_aligned` or `events_corrected` with 000000.npz and so on")
}

fn events_folder(path: &Path, has: impl Fn(&str) -> bool) -> Option<PathBuf> {
    EVENTS.iter().find(|name| has(name)).map(|name| path.join(name))
}

/// The npz files of a folder, in natural order.
fn archives(folder: &Path) -> Result<Vec<PathBuf>, FormatError> {
    let io = |error: std::io::Error| FormatError::io(folder, &error);
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if name.to_lowercase().ends_with(".npz") && !name.starts_with('.') {
            found.push(path);
        }
    }
    names::sort(&mut found);
    Ok(found)
}

/// An opened sequence.
pub(crate) struct HsErgb {
    about: Lazy,
    reading: Reading,
    archives: Arc<Vec<PathBuf>>,
    declared: Declared,
    /// Where places have fractions.
    warped: Option<Arc<Warped>>,
    frames: Option<Arc<PictureFiles>>,
    files: Vec<PathBuf>,
}

impl HsErgb {
    /// Opens a sequence.
    ///
    /// # Errors
    /// When it has no events, or the values contradict microseconds or leave open how coordinates are stored.
    pub(crate) fn open(path: &Path, declared: &Declared) -> Result<HsErgb, FormatError> {
        let folder =
            events_folder(path, |name| path.join(name).is_dir()).ok_or_else(|| without_events(path))?;
        let archives = archives(&folder)?;
        if archives.is_empty() {
            return Err(without_events(path));
        }
        let sample = Sample::of(&folder, &archives, declared)?;
        let unit = sample.unit(&folder, declared)?;
        let mut notes = Vec::new();
        if declared.time_unit.is_none() {
            notes.push(
                "stamps were taken as microseconds, as in the published sequences: their span and rate agree"
                    .into(),
            );
        }
        let frames = frames(path, declared, unit)?;
        let picture = frames.as_ref().map(|frames| frames.about().extent);
        let scale = sample.scale(&folder, declared, picture, &mut notes)?;
        let extent = declared.extent.or(picture);
        if declared.extent.is_none() && picture.is_some() {
            notes.push(
                "no size of the event array is stated; the pictures', on which the events were \
                        aligned, was taken"
                    .into(),
            );
        }
        let wraps_at = match (scale > 1 && sample.is_u16, extent) {
            (true, Some(extent)) => {
                // Between the array and the wrap lies at least half of the range of 16 bits; the middle of
                // the gap separates them.
                let limit = |side: u32| (i64::from(side) * i64::from(scale) + 65_536) / 2;
                Some((limit(extent.width), limit(extent.height)))
            }
            _ => None,
        };
        let mut files = archives.clone();
        files.extend(frames.iter().flat_map(|frames| frames.files().to_vec()));
        let reading = Reading { unit, scale, wraps_at, extent, has_t_in: false, rules: Rules::default() };
        let warped = match extent.filter(|_| sample.is_fractional || scale > 1) {
            Some(extent) => warped(&archives, declared, reading, extent).map(Arc::new),
            None => None,
        };
        match &warped {
            Some(warped) => notes.push(warped.note()),
            None if scale > 1 => notes.push("places were rounded to the nearest pixel".into()),
            None => notes.extend(npz::rounded(&sample.table)),
        }
        let mut about = npz::about(&sample.table, &reading, notes);
        about.count = None;
        let about = Lazy::new(path, declared, about);
        let (archives, declared) = (Arc::new(archives), declared.clone());
        Ok(HsErgb { about, reading, archives, declared, warped, frames, files })
    }
}

impl HsErgb {
    /// The event array whose places were warped to the pictures; none where they are whole pixels.
    pub(crate) fn array(&self) -> Option<Array> {
        let warped = self.warped.as_ref()?;
        let (extent, places) = warped.lattice.places(warped.extent());
        Some(Array { extent, places, residual: warped.lattice.residual, files: self.archives.to_vec() })
    }

    /// Counts what all event files hold; what cannot be read of them is reported by who reads the events.
    fn tally(&self, tally: &mut Tally) -> Result<(), FormatError> {
        for file in self.archives.iter() {
            let Ok((mut table, _)) = npz::table(file, &self.declared) else { continue };
            if table.compare().is_ok() {
                Arc::new(table).tally(self.reading, tally)?;
            }
        }
        Ok(())
    }
}

/// The event array's own grid, from places in some of the files.
fn warped(archives: &[PathBuf], declared: &Declared, reading: Reading, extent: Extent) -> Option<Warped> {
    let mut places = HashSet::new();
    for file in archives.iter().step_by(archives.len().div_ceil(FILES_OF_PLACES)) {
        let Ok((table, _)) = npz::table(file, declared) else { continue };
        let cursor = TableCursor::open(Arc::new(table), reading);
        // What cannot be read is reported by who reads the events.
        let _ = cursor.and_then(|cursor| cursor.places(EVENTS_OF_PLACES, &mut places));
    }
    Warped::of(&places, extent)
}

fn frames(
    path: &Path,
    declared: &Declared,
    unit: TimeUnit,
) -> Result<Option<Arc<PictureFiles>>, FormatError> {
    let Some(folder) = IMAGES.iter().map(|name| path.join(name)).find(|folder| folder.is_dir()) else {
        return Ok(None);
    };
    let stamps = declared.stamps.clone().or_else(|| {
        [&folder, path]
            .into_iter()
            .flat_map(|place| STAMPS.map(|name| place.join(name)))
            .find(|file| file.is_file())
    });
    let pictures = match stamps {
        // One unit a file set.
        Some(file) => PictureFiles::open_with(
            &folder,
            declared,
            &file,
            &Defined { unit: Some(unit), role: None, lines_count: true },
        )?,
        None => PictureFiles::open(&folder, declared)?,
    };
    Ok(Some(Arc::new(pictures)))
}

/// The first values of some event files.
struct Sample {
    /// Of the first file that can be read.
    table: Table,
    stamps: Vec<f64>,
    /// Largest ordinary coordinates: the 99th percentile, so that a few wrapped ones do not decide.
    reach: (f64, f64),
    is_fractional: bool,
    is_u16: bool,
    rows: f64,
}

impl Sample {
    fn of(folder: &Path, archives: &[PathBuf], declared: &Declared) -> Result<Sample, FormatError> {
        const FILES: usize = 4;
        let mut first: Option<Table> = None;
        let mut last_error = None;
        let (mut stamps, mut xs, mut ys, mut rows) = (Vec::new(), Vec::new(), Vec::new(), 0.0);
        // The first, the last, and two between.
        let mut indices: Vec<usize> =
            (0..FILES).map(|k| k * archives.len().saturating_sub(1) / (FILES - 1)).collect();
        indices.dedup();
        for index in indices.into_iter().filter(|index| *index < archives.len()) {
            let read = npz::table(&archives[index], declared).and_then(|(table, _)| {
                stamps.extend(table.sample(Column::T, 2000)?);
                xs.extend(table.sample(Column::X, 2000)?);
                ys.extend(table.sample(Column::Y, 2000)?);
                Ok(table)
            });
            match read {
                Ok(table) => {
                    rows += table.rows as f64;
                    first = first.or(Some(table).filter(|table| table.rows > 0));
                }
                Err(error) => last_error = Some(error),
            }
        }
        let Some(table) = first else {
            return Err(last_error.unwrap_or_else(|| {
                FormatError::new(
                    folder,
                    "no event file holds events",
                    "check that the sequence was copied whole",
                )
            }));
        };
        let is_fractional = xs.iter().chain(&ys).any(|value| value.fract() != 0.0);
        let is_u16 = [Column::X, Column::Y].into_iter().all(|column| {
            table.scalar(column).is_some_and(|scalar| scalar.kind == Kind::Uint && scalar.bytes == 2)
        });
        let high = |values: &mut Vec<f64>| {
            // Wrapped negative coordinates are no reach.
            values.retain(|value| value.is_finite() && (!is_u16 || *value < 60_000.0));
            values.sort_by(f64::total_cmp);
            values.get((values.len() * 99 / 100).min(values.len().saturating_sub(1))).copied().unwrap_or(0.0)
        };
        let reach = (high(&mut xs), high(&mut ys));
        Ok(Sample { table, stamps, reach, is_fractional, is_u16, rows })
    }

    /// Microseconds, unless the values contradict.
    fn unit(&self, folder: &Path, declared: &Declared) -> Result<TimeUnit, FormatError> {
        if let Some(unit) = declared.time_unit {
            return Ok(unit);
        }
        let whole = self.stamps.iter().all(|stamp| stamp.fract() == 0.0);
        let evidence = evidence::of_values(&self.stamps, whole, self.rows, Of::Events);
        if whole && matches!(evidence.proposal, Some(TimeUnit::Us) | None) {
            return Ok(TimeUnit::Us);
        }
        let what = format!(
            "the stamps do not look like the microseconds of the published sequences ({})",
            evidence.text
        );
        Err(FormatError::new(folder, what, evidence.hint()).undeclared("time_unit"))
    }

    /// 1 or 32, from how far the coordinates reach beyond the pictures.
    fn scale(
        &self,
        folder: &Path,
        declared: &Declared,
        picture: Option<Extent>,
        notes: &mut Vec<String>,
    ) -> Result<u32, FormatError> {
        let (x, y) = self.reach;
        let reach = format!("coordinates reach x = {x}, y = {y}");
        if let Some(scale) = declared.coordinate_scale.map(|scale| scale.max(1)) {
            notes.push(format!("{reach}; divided by {scale}, as declared"));
            return Ok(scale);
        }
        let undeclared = |what: String| {
            FormatError::new(
                folder,
                what,
                "state `coordinate_scale`: 1 when they are pixels, 32 when they \
                                            are 1/32 pixel (as in BS-ERGB)",
            )
            .undeclared("coordinate_scale")
        };
        let Some(Extent { width, height }) = declared.extent.or(picture) else {
            // Without pictures only fractions show that they are pixels.
            return if self.is_fractional {
                Ok(1)
            } else {
                Err(undeclared(format!("{reach}, and there are no pictures to compare them with")))
            };
        };
        let (width, height) = (f64::from(width), f64::from(height));
        if x < width && y < height {
            return Ok(1);
        }
        if !self.is_fractional
            && x / 32.0 < 1.1 * width
            && y / 32.0 < 1.1 * height
            && (x > 4.0 * width || y > 4.0 * height)
        {
            notes.push(format!(
                "{reach} where the pictures are {width} x {height}: divided by 32, as the dataset's authors \
                 document"
            ));
            return Ok(32);
        }
        Err(undeclared(format!("{reach} where the pictures are {width} x {height}")))
    }
}

/// Walks through the event files of a sequence, one after another.
struct SequenceCursor {
    archives: Arc<Vec<PathBuf>>,
    declared: Declared,
    reading: Reading,
    warped: Option<Arc<Warped>>,
    index: usize,
    inner: Option<TableCursor>,
    losses: Losses,
}

impl SequenceCursor {
    /// Opens the next file; one that cannot be read is a loss.
    fn open_next(&mut self) -> Result<(), FormatError> {
        let file = &self.archives[self.index];
        let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let opened = npz::table(file, &self.declared).and_then(|(mut table, _)| {
            let losses = table.compare()?;
            let cursor = TableCursor::open_warped(Arc::new(table), self.reading, self.warped.clone())?;
            Ok((cursor, losses))
        });
        match opened {
            Ok((cursor, losses)) => {
                for loss in losses {
                    self.losses.add(
                        "event files whose arrays disagree",
                        || format!("{name}, {}", loss.at),
                        || loss.what.clone(),
                    );
                }
                self.inner = Some(cursor);
            }
            // A file that has gone is no damage.
            Err(error) if !file.is_file() => return Err(error),
            Err(error) => {
                self.losses.add(
                    "event files that cannot be read",
                    || name,
                    || format!("{}; its events are lost", error.found),
                );
                self.index += 1;
            }
        }
        Ok(())
    }
}

impl EventCursor for SequenceCursor {
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        chunk.clear();
        let more = loop {
            if let Some(inner) = &mut self.inner {
                if inner.next(chunk)? {
                    break true;
                }
                let name =
                    self.archives[self.index].file_name().unwrap_or_default().to_string_lossy().into_owned();
                if let Some(inner) = self.inner.take() {
                    self.losses.append(inner.into_losses(), |at| format!("{name}, {at}"));
                }
                self.index += 1;
            } else if self.index >= self.archives.len() {
                break false;
            } else {
                self.open_next()?;
            }
        };
        Ok(more)
    }

    fn seek(&mut self, _t_ns: i64) -> Result<(), FormatError> {
        // Nothing says that the files are sorted, so that only the beginning is safe.
        (self.index, self.inner, self.losses) = (0, None, Losses::default());
        Ok(())
    }

    fn losses(&self) -> Vec<Loss> {
        self.losses.list()
    }

    fn position(&self) -> (u64, u64) {
        (self.index as u64, self.archives.len() as u64)
    }
}

impl Recording for HsErgb {
    fn events_about(&self) -> Option<&EventsAbout> {
        Some(self.about.about(|tally| self.tally(tally)))
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        let settled = self.about.settled(|tally| self.tally(tally))?;
        let (archives, declared) = (self.archives.clone(), self.declared.clone());
        let reading = Reading { rules: settled.rules, ..self.reading };
        Ok(settled.followed(Box::new(SequenceCursor {
            archives,
            declared,
            reading,
            warped: self.warped.clone(),
            index: 0,
            inner: None,
            losses: Losses::default(),
        })))
    }

    fn conventions(&self) -> Vec<Convention> {
        self.about
            .settled(|tally| self.tally(tally))
            .map_or_else(|_| Vec::new(), |settled| settled.conventions.clone())
    }

    fn pictures(&self) -> Option<Arc<dyn Pictures>> {
        self.frames.clone().map(|frames| frames as Arc<dyn Pictures>)
    }

    fn facts(&self) -> Vec<(String, String)> {
        vec![("event files".into(), self.archives.len().to_string())]
    }

    fn losses(&self) -> Vec<Loss> {
        self.frames.iter().flat_map(|frames| frames.losses().to_vec()).collect()
    }

    fn files(&self) -> Vec<PathBuf> {
        self.files.clone()
    }
}
