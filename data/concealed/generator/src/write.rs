//! One recording as an HDF5 file of the form `photocurrent-recording/1`. The bytes depend on the content
//! alone.

use crate::draw::Draft;
use crate::frames::Numbers;
use crate::stamps::Stamped;
use hdf5::types::VarLenUnicode;
use hdf5::{Group, H5Type};
use std::path::Path;

/// Writes events, frames and the described sensor.
///
/// # Errors
/// What HDF5 says, with the file's name.
pub fn write(path: &Path, draft: &Draft, events: &[Stamped], frames: &[Vec<f64>]) -> Result<(), String> {
    layout(path, draft, events, frames)
        .map_err(|error| format!("{}: cannot be written: {error}", path.display()))
}

fn layout(path: &Path, draft: &Draft, events: &[Stamped], frames: &[Vec<f64>]) -> hdf5::Result<()> {
    let [width, height] = draft.size;
    let file = hdf5::File::create(path)?;
    let text = |value: &str| -> hdf5::Result<VarLenUnicode> {
        value.parse().map_err(|_| hdf5::Error::from("a text with a NUL character"))
    };
    file.new_attr::<VarLenUnicode>().create("format")?.write_scalar(&text("photocurrent-recording/1")?)?;
    file.new_attr::<i64>().create("width")?.write_scalar(&(width as i64))?;
    file.new_attr::<i64>().create("height")?.write_scalar(&(height as i64))?;

    let group = file.create_group("events")?;
    group.new_attr::<i64>().create("t_resolution_ns")?.write_scalar(&draft.resolution)?;
    let column =
        |of: &dyn Fn(&Stamped) -> usize| events.iter().map(|event| of(event) as u16).collect::<Vec<u16>>();
    dataset(&group, "x", &column(&|event| event.pixel % width), &[events.len()])?;
    dataset(&group, "y", &column(&|event| event.pixel / width), &[events.len()])?;
    dataset(
        &group,
        "p",
        &events.iter().map(|event| u8::from(event.on)).collect::<Vec<_>>(),
        &[events.len()],
    )?;
    times(&group, "t", &events.iter().map(|event| event.t).collect::<Vec<_>>())?;
    if draft.has_t_in {
        times(&group, "t_in", &events.iter().map(|event| event.t_in).collect::<Vec<_>>())?;
    }

    let group = file.create_group("frames")?;
    group
        .new_attr::<i64>()
        .create("row_time_ns")?
        .write_scalar(&((draft.nominal.row_time * 1e9).round() as i64))?;
    let shape = [frames.len(), height, width];
    match draft.numbers {
        Numbers::Whole => {
            dataset(&group, "dn", &frames.iter().flatten().map(|dn| *dn as u16).collect::<Vec<_>>(), &shape)?
        }
        Numbers::Sixteenths => {
            dataset(&group, "dn", &frames.iter().flatten().map(|dn| *dn as f32).collect::<Vec<_>>(), &shape)?
        }
    }
    for (k, name) in ["exposure_start", "exposure_end"].into_iter().enumerate() {
        times(
            &group,
            name,
            &draft
                .timing
                .exposures
                .iter()
                .map(|exposure| (exposure[k] * 1e9).round() as i64)
                .collect::<Vec<_>>(),
        )?;
    }
    file.new_dataset::<VarLenUnicode>()
        .obj_track_times(false)
        .create("sensor")?
        .write_scalar(&text(&draft.nominal.description())?)?;
    file.close()
}

fn dataset<T: H5Type>(group: &Group, name: &str, values: &[T], shape: &[usize]) -> hdf5::Result<()> {
    let built = group
        .new_dataset::<T>()
        .shuffle()
        .deflate(9)
        .chunk(shape)
        .obj_track_times(false)
        .shape(shape)
        .create(name)?;
    built.as_writer().write_raw(values)
}

fn times(group: &Group, name: &str, values: &[i64]) -> hdf5::Result<()> {
    dataset(group, name, values, &[values.len()])?;
    let unit = "ns".parse::<VarLenUnicode>().map_err(|_| hdf5::Error::from("a text with a NUL character"))?;
    group.dataset(name)?.new_attr::<VarLenUnicode>().create("unit")?.write_scalar(&unit)
}
