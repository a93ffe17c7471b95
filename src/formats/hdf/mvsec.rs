//! MVSEC's `*_data.hdf5`: `davis/{left,right}/events` N x 4 f64 (x, y, t in s, p of -1 and 1), `image_raw`,
//! `image_raw_ts`.
//!
//! Stamps of images are the DAVIS driver's; what they mean is not recorded, nor is the exposure.

use super::stack::{Order, Stack};
use super::table::{EventTable, nanoseconds};
use super::{HdfRecording, chosen, declared_extent, holds, open_file, optional, others, refused, with_cut};
use crate::error::FormatError;
use crate::format::{Format, Probe};
use crate::recording::{FrameStamp, Pictures, Recording};
use crate::{Declared, TimeUnit};
use std::path::Path;
use std::sync::Arc;

/// MVSEC.
pub(crate) static FORMAT: Format = Format {
    id: "mvsec",
    name: "MVSEC HDF5",
    recognises,
    open: |path, declared| with_cut(open(path, declared)),
};

fn recognises(probe: &Probe) -> bool {
    holds(probe, &["davis/left/events"]) || holds(probe, &["davis/right/events"])
}

fn open(path: &Path, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    let file = open_file(path)?;
    let there: Vec<&str> =
        ["left", "right"].into_iter().filter(|side| file.has(&format!("davis/{side}/events"))).collect();
    let camera = chosen(path, declared.camera.as_deref(), &there, "camera", "camera")?;
    let name = |name: &str| format!("davis/{camera}/{name}");
    let mut table = EventTable::of_rows(&file, &name("events"), [0, 1, 2, 3])?;
    table.unit_ns = TimeUnit::S.ns();
    let wrap = |error| refused(path, error);
    let mut lost = Vec::new();
    let images = optional(&file, &name("image_raw"), &mut lost)?;
    let stamps = optional(&file, &name("image_raw_ts"), &mut lost)?;
    let mut pictures = None;
    if let (Some(images), Some(stamps)) = (images, stamps) {
        let stamps = stamps.floats().map_err(wrap)?;
        let at = |s: f64| nanoseconds(s, TimeUnit::S.ns()).map(|at| FrameStamp { at, exposure: None });
        let bad = || {
            FormatError::new(path, "a stamp that is no time", "the file is damaged: copy it again")
                .at(format!("/{}", name("image_raw_ts")))
        };
        let stamps = stamps.into_iter().map(|s| at(s).ok_or_else(bad)).collect::<Result<Vec<_>, _>>()?;
        let mut stack =
            Stack::of_dataset(path, images, stamps, Order::Rgb, file.cut().is_none().then_some(declared))?;
        lost.extend(stack.lost.take());
        pictures = Some(stack);
    }
    table.extent = declared_extent(declared, pictures.as_ref().map(|pictures| pictures.about().extent));
    let notes = table
        .polarity_note()
        .into_iter()
        .chain(others(declared.camera.as_deref(), camera, &there, "events and frames", "camera"))
        .collect();
    let mut recording = HdfRecording::new(path, &file, Some(table), notes, lost).recognising(declared);
    recording.pictures = pictures.map(|pictures| Arc::new(pictures) as Arc<dyn Pictures>);
    recording.facts = vec![("camera".into(), format!("davis/{camera} (of {})", there.join(", ")))];
    Ok(Box::new(recording))
}
