//! A folder of numpy arrays as event_utils and EVREAL keep a recording: `events_ts.npy`, `events_xy.npy`,
//! `events_p.npy`, and mostly `images.npy`, `images_ts.npy` and `metadata.json`.
//!
//! Stamps are seconds in floats; whole numbers need a declared unit. What the image stamps mean, and the
//! exposure, are not recorded. `image_event_indices.npy` follows from the stamps and is not read. EVIMO2's
//! `dataset_events_*.npy` is the same layout.

use crate::convention::{Lazy, Rules};
use crate::declared::{Column, Declared, TimeUnit};
use crate::error::{FormatError, Loss};
use crate::format::{Format, Probe};
use crate::npy::pictures::NpyPictures;
use crate::npy::place::Place;
use crate::npy::table::{Reading, Table};
use crate::npz::{self, Events};
use crate::recording::{Convention, EventCursor, EventsAbout, Pictures, Recording};
use photocurrent_core::Extent;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// event_utils memmap folders.
pub(crate) static FORMAT: Format = Format {
    id: "memmap",
    name: "event_utils memmap folder (EVREAL)",
    recognises,
    open: |path, declared| Ok(Box::new(Memmap::open(path, declared)?)),
};

const STAMPS: [&str; 4] = ["events_ts.npy", "t.npy", "events_t.npy", "dataset_events_t.npy"];
const PIXELS: [&str; 3] = ["events_xy.npy", "xy.npy", "dataset_events_xy.npy"];
const POLARITIES: [&str; 3] = ["events_p.npy", "p.npy", "dataset_events_p.npy"];

/// A folder with two of the three arrays is one that was copied in part.
fn recognises(probe: &Probe) -> bool {
    [&STAMPS[..], &PIXELS, &POLARITIES]
        .iter()
        .filter(|names| names.iter().any(|name| probe.has(name)))
        .count()
        >= 2
}

/// The refusal of a folder without one of its arrays.
fn without(path: &Path, names: &[&str]) -> FormatError {
    let others = names[1..].iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    let hint = "copy it from where the others came from: event_utils (h5_to_memmap) and EVREAL write all \
                three together";
    FormatError::new(path, format!("{} is missing; the other arrays of events are there", names[0]), hint)
        .expected(format!("{}, or {others}", names[0]))
}

/// An opened folder.
pub(crate) struct Memmap {
    events: Events,
    frames: Option<Arc<NpyPictures>>,
    losses: Vec<Loss>,
    files: Vec<PathBuf>,
}

impl Memmap {
    /// Opens a folder.
    ///
    /// # Errors
    /// When an array is missing or has another shape, or the unit of whole stamps is not declared.
    pub(crate) fn open(path: &Path, declared: &Declared) -> Result<Memmap, FormatError> {
        for names in [&STAMPS[..], &PIXELS, &POLARITIES] {
            if !names.iter().any(|name| path.join(name).is_file()) {
                return Err(without(path, names));
            }
        }
        let mut table = Table::default();
        let mut files = Vec::new();
        for (names, columns) in
            [(&STAMPS[..], &[Column::T][..]), (&PIXELS, &[Column::X, Column::Y]), (&POLARITIES, &[Column::P])]
        {
            let Some(file) = names.iter().map(|name| path.join(name)).find(|file| file.is_file()) else {
                return Err(without(path, names));
            };
            let place = Place { path: file.clone(), member: None };
            let mut header = place.header()?;
            // N x 1 x 2 is squeezed, as its own readers do.
            if columns.len() > 1 && header.shape.len() > 2 {
                header.shape.retain(|side| *side != 1);
            }
            match columns {
                [column] => table.add_column(*column, place, &header)?,
                _ => table.add_columns(columns, place, &header)?,
            }
            files.push(file);
        }
        let mut losses = table.compare()?;
        let (unit, mut notes) = npz::unit(&files[0], &table, declared, Some(TimeUnit::S))?;
        let frames = frames(path, unit, declared, &mut losses, &mut files)?;
        let extent = match (declared.extent, stated_extent(path, &mut files), &frames) {
            (Some(extent), ..) | (None, Some(extent), _) => Some(extent),
            (None, None, Some(frames)) => {
                notes.push("no size of the event array is stated; the frames' was taken".into());
                Some(frames.about().extent)
            }
            _ => None,
        };
        notes.extend(npz::rounded(&table));
        let scale = declared.coordinate_scale.unwrap_or(1).max(1);
        let reading =
            Reading { unit, scale, wraps_at: None, extent, has_t_in: false, rules: Rules::default() };
        let about = Lazy::new(path, declared, npz::about(&table, &reading, notes));
        Ok(Memmap { events: Events { about, table: Arc::new(table), reading }, frames, losses, files })
    }
}

fn frames(
    path: &Path,
    unit: TimeUnit,
    declared: &Declared,
    losses: &mut Vec<Loss>,
    files: &mut Vec<PathBuf>,
) -> Result<Option<Arc<NpyPictures>>, FormatError> {
    let (images, stamps) = (path.join("images.npy"), path.join("images_ts.npy"));
    if !images.is_file() {
        return Ok(None);
    }
    if !stamps.is_file() {
        losses.push(Loss::new(
            "images.npy",
            "there is no images_ts.npy with the stamps of its frames; they were left out",
        ));
        return Ok(None);
    }
    let place = Place { path: stamps.clone(), member: None };
    let mut table = Table::default();
    table.add_column(Column::T, place.clone(), &place.header()?)?;
    losses.extend(table.compare()?);
    let mut values = Vec::new();
    if let Some(source) = table.sources.first() {
        use std::io::Read;
        let mut bytes = Vec::new();
        let read = source
            .place
            .open(source.start)?
            .take(table.rows.saturating_mul(source.stride as u64))
            .read_to_end(&mut bytes);
        read.map_err(|error| FormatError::io(&stamps, &error))?;
        crate::npy::header::each(source.fields[0].1, &bytes, source.stride, 0, |number| {
            values.push(crate::npy::table::time(number, unit))
        });
    }
    if let Some(frame) = values.iter().position(|stamp| *stamp == i64::MIN) {
        return Err(FormatError::new(
            &stamps,
            "a stamp that is not finite",
            "correct it, or leave the frame out of both arrays",
        )
        .at(format!("frame {frame}")));
    }
    let (frames, lost) = NpyPictures::open(&images, &values, declared)?;
    losses.extend(lost);
    files.extend([images, stamps]);
    Ok(Some(Arc::new(frames)))
}

/// `sensor_resolution` of `metadata.json`: height, width.
fn stated_extent(path: &Path, files: &mut Vec<PathBuf>) -> Option<Extent> {
    let file = path.join("metadata.json");
    let small = std::fs::metadata(&file).ok()?.len() < 1 << 20;
    let text = std::fs::read_to_string(&file).ok().filter(|_| small)?;
    let value: serde_json::Value = serde_json::from_str(&text).ok()?;
    let sides = value.get("sensor_resolution")?.as_array()?;
    let side = |index: usize| {
        sides
            .get(index)
            .and_then(serde_json::Value::as_u64)
            .and_then(|side| u32::try_from(side).ok())
            .filter(|side| (1..=1 << 16).contains(side))
    };
    let extent = Extent { width: side(1)?, height: side(0)? };
    files.push(file);
    Some(extent)
}

impl Recording for Memmap {
    fn events_about(&self) -> Option<&EventsAbout> {
        Some(self.events.about())
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        self.events.open()
    }

    fn conventions(&self) -> Vec<Convention> {
        self.events.conventions()
    }

    fn pictures(&self) -> Option<Arc<dyn Pictures>> {
        self.frames.clone().map(|frames| frames as Arc<dyn Pictures>)
    }

    fn losses(&self) -> Vec<Loss> {
        self.losses.clone()
    }

    fn files(&self) -> Vec<PathBuf> {
        self.files.clone()
    }
}
