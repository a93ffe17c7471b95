//! v2e's HDF5: `events` N x 4 u32 (t in us, x, y, p), and optionally `frame`, `frame_ts`, `frame_idx`.
//!
//! v2e keeps times as 32-bit seconds while it simulates: beyond 16 s its microseconds come in steps of 2,
//! beyond 32 s of 4. That is said in a note.

use super::stack::{Order, Stack};
use super::table::EventTable;
use super::{HdfRecording, declared_extent, extent, open_file, optional, refused, with_cut};
use crate::error::FormatError;
use crate::format::{Format, Probe};
use crate::recording::{FrameStamp, Pictures, Recording};
use crate::{Declared, TimeUnit};
use photocurrent_store::foreign::ForeignFile;
use std::path::Path;
use std::sync::Arc;

/// v2e's HDF5.
pub(crate) static FORMAT: Format = Format {
    id: "v2e_hdf5",
    name: "v2e HDF5",
    recognises,
    open: |path, declared| with_cut(open(path, declared)),
};

fn recognises(probe: &Probe) -> bool {
    probe.is_hdf5()
        && ForeignFile::open(&probe.path).is_ok_and(|file| {
            file.has("events")
                && file
                    .dataset("events")
                    .is_ok_and(|events| events.is_some_and(|events| matches!(events.shape(), [_, 4])))
        })
}

fn open(path: &Path, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    let file = open_file(path)?;
    let mut table = EventTable::of_rows(&file, "events", [1, 2, 0, 3])?;
    table.unit_ns = declared.time_unit.unwrap_or(TimeUnit::Us).ns();
    let wrap = |error| refused(path, error);
    let mut pictures = None;
    let mut lost = Vec::new();
    if let Some(frames) = optional(&file, "frame", &mut lost)? {
        let stamps = optional(&file, "frame_ts", &mut lost)?;
        let stamps = stamps.map(|stamps| stamps.integers()).transpose().map_err(wrap)?.unwrap_or_default();
        let stamps =
            stamps.into_iter().map(|t| FrameStamp { at: t.saturating_mul(1000), exposure: None }).collect();
        let mut stack =
            Stack::of_dataset(path, frames, stamps, Order::Rgb, file.cut().is_none().then_some(declared))?;
        lost.extend(stack.lost.take());
        pictures = Some(stack);
    }
    let found = pictures.as_ref().map(|pictures| pictures.about().extent);
    table.extent =
        declared_extent(declared, found.and_then(|found| extent(found.width.into(), found.height.into())));
    let mut notes = vec![
        "v2e computes with 32-bit seconds: stamps beyond 16 s come in steps of 2 us and more".to_string(),
    ];
    notes.extend(table.polarity_note());
    let mut recording = HdfRecording::new(path, &file, Some(table), notes, lost).recognising(declared);
    recording.pictures = pictures.map(|pictures| Arc::new(pictures) as Arc<dyn Pictures>);
    Ok(Box::new(recording))
}
