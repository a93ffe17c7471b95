//! DSEC's events: `events/{x,y,t,p}`, times in us from `t_offset` on, `ms_to_idx`; also VECtor and TUM-VIE. A
//! file, or a sequence's folder with images.
//!
//! In a folder are `events/left/events.h5` (or `events.h5`) and, of the frame camera,
//! `images/left/rectified/*.png` (or `distorted`) with `images/left/exposure_timestamps_left.txt` (start and
//! end of every exposure) or `images/timestamps.txt` (their middle). Frames come from another camera than the
//! events. The file does not state the sensor's size: `rectify_map.h5` in its folder does, and so do our own
//! files.

use super::table::EventTable;
use super::{HdfRecording, declared_extent, extent, holds, open_file, optional, others, refused, with_cut};
use crate::Declared;
use crate::error::{Cause, FormatError, Loss};
use crate::format::{Format, Probe};
use crate::recording::Recording;
use photocurrent_core::Extent;
use photocurrent_store::foreign::ForeignFile;
use std::path::{Path, PathBuf};
use std::sync::Arc;

mod folder;

/// DSEC.
pub(crate) static FORMAT: Format = Format {
    id: "dsec",
    name: "DSEC HDF5",
    recognises,
    open: |path, declared| with_cut(open(path, declared)),
};

fn recognises(probe: &Probe) -> bool {
    if probe.names.is_some() {
        let events = folder::events_of(&probe.path, None);
        return events.map_or_else(
            || folder::is_sequence(&probe.path),
            |events| Probe::new(&events).is_ok_and(|probe| recognises(&probe)),
        );
    }
    holds(probe, &["events/x", "events/y", "events/t", "events/p"])
}

fn open(path: &Path, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    if !path.is_dir() {
        return Ok(Box::new(open_events(path, path, declared)?));
    }
    let side = declared.camera.as_deref();
    let events = folder::events_of(path, side).ok_or_else(|| folder::without_events(path, side))?;
    let mut recording = open_events(path, &events, declared)?;
    let there = folder::cameras_of(path);
    let there: Vec<&str> = there.iter().map(String::as_str).collect();
    recording.note(others(side, "left", &there, "events and frames", "camera"));
    recording.more_files = vec![events];
    if let Some(pictures) = folder::pictures_of(path, declared, declared.frame_camera.as_deref().or(side))? {
        recording.more_files.extend_from_slice(pictures.files());
        recording.losses.extend_from_slice(pictures.losses());
        recording.pictures = Some(Arc::new(pictures));
    }
    Ok(Box::new(recording))
}

fn open_events(path: &Path, events: &Path, declared: &Declared) -> Result<HdfRecording, FormatError> {
    let file = open_file(events)?;
    let wrap = |error| refused(events, error);
    let mut table = EventTable::of_columns(&file, ["events/x", "events/y", "events/t", "events/p"], None)?;
    if let Some(unit) = declared.time_unit {
        table.unit_ns = unit.ns();
    }
    let (mut notes, mut lost) = (Vec::new(), Vec::new());
    let offset =
        optional(&file, "t_offset", &mut lost)?.map(|offset| offset.integers()).transpose().map_err(wrap)?;
    if let Some(&us) = offset.as_ref().and_then(|offset| offset.first()) {
        let wrong = || {
            FormatError::new(events, format!("an offset of {us} us"), "the file is damaged: copy it again")
                .at("/t_offset")
        };
        table.offset_ns = us.checked_mul(table.unit_ns).ok_or_else(wrong)?;
        notes.push(format!("t_offset of {us} us added"));
    } else if file.cut().is_some() {
        lost.push(
            Loss::new("/t_offset", "none is left: if there was one, all times are too early by it")
                .by(Cause::Cut),
        );
    }
    table.index = optional(&file, "ms_to_idx", &mut lost)?
        .filter(|index| index.shape().len() == 1 && table.unit_ns == 1000);
    table.extent = declared_extent(declared, stated_extent(&file));
    notes.extend(table.polarity_note());
    Ok(HdfRecording::new(path, &file, Some(table), notes, lost).recognising(declared))
}

/// The sensor's size: of attributes as we write them, or of a rectification map in its folder.
fn stated_extent(file: &ForeignFile) -> Option<Extent> {
    let side = |name: &str| {
        file.attribute("events", name).ok().flatten().and_then(|value| value.numbers().first().copied())
    };
    if let (Some(width), Some(height)) = (side("sensor_width"), side("sensor_height")) {
        return extent(width, height);
    }
    let map_file: PathBuf = file.path().with_file_name("rectify_map.h5");
    let map = ForeignFile::open(&map_file).ok()?.dataset("rectify_map").ok()??;
    match *map.shape() {
        [height, width, 2] => extent(width as f64, height as f64),
        _ => None,
    }
}
