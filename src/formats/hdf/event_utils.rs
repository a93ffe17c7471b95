//! event_utils' HDF5 (also of its many descendants): `events/{xs,ys,ts,ps}` with times in seconds,
//! `images/image000000000` with attributes `timestamp` and `type`, and the attribute `sensor_resolution`
//! (height, width).
//!
//! Pictures of type `color_bgr` have blue first. Some writers add start and end of the exposure as
//! `timestamp_start` and `timestamp_end`.

use super::stack::{Order, Stack, about, shape_of};
use super::table::{EventTable, nanoseconds};
use super::{HdfRecording, declared_extent, extent, holds, open_file, refused, with_cut};
use crate::error::{Cause, FormatError, Loss};
use crate::format::{Format, Probe};
use crate::recording::{FrameStamp, Pictures, Recording};
use crate::{Declared, TimeUnit};
use photocurrent_store::foreign::{ForeignFile, Value};
use std::path::Path;
use std::sync::Arc;

/// event_utils' HDF5.
pub(crate) static FORMAT: Format = Format {
    id: "event_utils_hdf5",
    name: "event_utils HDF5",
    recognises,
    open: |path, declared| with_cut(open(path, declared)),
};

fn recognises(probe: &Probe) -> bool {
    holds(probe, &["events/xs", "events/ys", "events/ts", "events/ps"])
}

fn open(path: &Path, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    let file = open_file(path)?;
    let mut table =
        EventTable::of_columns(&file, ["events/xs", "events/ys", "events/ts", "events/ps"], None)?;
    table.unit_ns = declared.time_unit.unwrap_or(TimeUnit::S).ns();
    let resolution = file.attribute("", "sensor_resolution").map_err(|error| refused(path, error))?;
    let found = resolution.and_then(|value| match *value.numbers() {
        [height, width] | [height, width, _] => extent(width, height),
        _ => None,
    });
    table.extent = declared_extent(declared, found);
    let (pictures, losses) = pictures(&file, table.unit_ns)?;
    let notes = table.polarity_note().into_iter().collect();
    let mut recording = HdfRecording::new(path, &file, Some(table), notes, losses).recognising(declared);
    recording.pictures = pictures.map(|pictures| Arc::new(pictures) as Arc<dyn Pictures>);
    Ok(Box::new(recording))
}

fn pictures(file: &ForeignFile, unit_ns: i64) -> Result<(Option<Stack>, Vec<Loss>), FormatError> {
    let wrap = |error| refused(file.path(), error);
    let names = file.names("images").map_err(wrap)?;
    let mut names: Vec<String> = names
        .into_iter()
        .filter(|name| name.starts_with("image"))
        .map(|name| format!("images/{name}"))
        .collect();
    // Nine digits sort as they count; more would not.
    names.sort_by_key(|name| (name.len(), name.clone()));
    let (mut kept, mut stamps, mut without, mut odd, mut lost) = (Vec::new(), Vec::new(), 0, 0, 0);
    let (mut first, mut order) = (None, Order::Rgb);
    for name in names {
        let dataset = match file.dataset(&name) {
            // The header of a picture or some of its pixels.
            Ok(Some(dataset)) if dataset.rows_before_the_cut().map_err(wrap)? == dataset.rows() => dataset,
            Ok(None) => continue,
            Err(error) if file.cut().is_none() => return Err(wrap(error)),
            _ => {
                lost += 1;
                continue;
            }
        };
        let time = |attribute: &str| -> Result<Option<i64>, FormatError> {
            let value = file.attribute(&name, attribute).map_err(wrap)?;
            Ok(value.and_then(|value| nanoseconds(*value.numbers().first()?, unit_ns)))
        };
        let Some(at) = time("timestamp")? else {
            without += 1;
            continue;
        };
        let (Some(shape), Some(field)) = (shape_of(dataset.shape()), dataset.numbers()) else {
            odd += 1;
            continue;
        };
        let (extent, colour) = *first.get_or_insert(shape);
        if (extent, colour) != shape {
            odd += 1;
            continue;
        }
        if kept.is_empty()
            && file.attribute(&name, "type").map_err(wrap)? == Some(Value::Text("color_bgr".into()))
        {
            order = Order::Bgr;
        }
        let exposure = time("timestamp_start")?.zip(time("timestamp_end")?);
        kept.push((name, field));
        stamps.push(FrameStamp { at, exposure });
    }
    let mut losses = Vec::new();
    if lost > 0 {
        losses.push(
            Loss::new("/images", format!("{lost} pictures lie behind the cut; they are lost")).by(Cause::Cut),
        );
    }
    if odd > 0 {
        losses.push(Loss::new(
            "/images",
            format!("{odd} pictures have another shape than the first and were left out"),
        ));
    }
    let (Some((extent, colour)), Some((_, field))) = (first, kept.first()) else { return Ok((None, losses)) };
    let mut about = about(extent, colour, *field, stamps);
    if without > 0 {
        about.notes.push(format!("{without} pictures have no stamp and were left out"));
    }
    if order == Order::Bgr {
        about.notes.push("channels are stored as blue, green, red, and were turned round".into());
    }
    let names = kept.into_iter().map(|(name, _)| name).collect();
    Ok((Some(Stack::of_each(file, names, order, about)), losses))
}
