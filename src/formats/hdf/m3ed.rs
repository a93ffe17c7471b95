//! M3ED's `*_data.h5`: `prophesee/{left,right}/{x,y,t,p}` with `ms_map_idx` and `calib/resolution`, frames in
//! `ovc/{left,right,rgb}/data` with `ovc/ts`.
//!
//! Times are microseconds of one clock. The frames come from another camera than the events: sizes and views
//! differ. What a frame's stamp means and its exposure are not recorded. Colour frames were written by
//! OpenCV, so their channels stand as blue, green, red.

use super::stack::{Order, Stack};
use super::table::EventTable;
use super::{
    HdfRecording, chosen, declared_extent, extent, holds, open_file, optional, others, refused, with_cut,
};
use crate::Declared;
use crate::error::FormatError;
use crate::format::{Format, Probe};
use crate::recording::{FrameStamp, Pictures, Recording};
use photocurrent_core::Colour;
use std::path::Path;
use std::sync::Arc;

/// M3ED.
pub(crate) static FORMAT: Format = Format {
    id: "m3ed",
    name: "M3ED HDF5",
    recognises,
    open: |path, declared| with_cut(open(path, declared)),
};

fn recognises(probe: &Probe) -> bool {
    holds(probe, &["prophesee/left/t"]) || holds(probe, &["prophesee/right/t"])
}

fn open(path: &Path, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    let file = open_file(path)?;
    let wrap = |error| refused(path, error);
    let there: Vec<&str> =
        ["left", "right"].into_iter().filter(|side| file.has(&format!("prophesee/{side}/t"))).collect();
    let camera = chosen(path, declared.camera.as_deref(), &there, "event camera", "camera")?;
    let name = |name: &str| format!("prophesee/{camera}/{name}");
    let mut table = EventTable::of_columns(&file, [&name("x"), &name("y"), &name("t"), &name("p")], None)?;
    let mut lost = Vec::new();
    // The resolution is what the calibration was made for: width, height.
    let resolution = optional(&file, &name("calib/resolution"), &mut lost)?
        .map(|resolution| resolution.floats())
        .transpose()
        .map_err(wrap)?;
    let found = resolution
        .as_deref()
        .and_then(|sides| if let [width, height] = *sides { extent(width, height) } else { None });
    table.extent = declared_extent(declared, found);
    table.index = optional(&file, &name("ms_map_idx"), &mut lost)?;
    let notes = table
        .polarity_note()
        .into_iter()
        .chain(others(declared.camera.as_deref(), camera, &there, "events", "camera"))
        .collect();
    let mut recording = HdfRecording::new(path, &file, Some(table), notes, lost).recognising(declared);
    recording.facts = vec![("event camera".into(), format!("prophesee/{camera} (of {})", there.join(", ")))];
    let frames: Vec<&str> =
        ["left", "rgb", "right"].into_iter().filter(|side| file.has(&format!("ovc/{side}/data"))).collect();
    if !frames.is_empty() || declared.frame_camera.is_some() {
        // Of the side of the events, where another is not stated.
        let wanted = declared.frame_camera.as_deref().or(frames.contains(&camera).then_some(camera));
        let side = chosen(path, wanted, &frames, "frame camera", "frame_camera")?;
        let images = optional(&file, &format!("ovc/{side}/data"), &mut recording.losses)?;
        let stamps = optional(&file, "ovc/ts", &mut recording.losses)?
            .map(|stamps| stamps.integers())
            .transpose()
            .map_err(wrap)?
            .unwrap_or_default();
        let stamps =
            stamps.into_iter().map(|t| FrameStamp { at: t.saturating_mul(1000), exposure: None }).collect();
        if let Some(images) = images {
            let mut stack = Stack::of_dataset(
                path,
                images,
                stamps,
                Order::Bgr,
                file.cut().is_none().then_some(declared),
            )?;
            recording.losses.extend(stack.lost.take());
            stack.about_mut().notes.extend(others(
                declared.frame_camera.as_deref(),
                side,
                &frames,
                "frames",
                "frame_camera",
            ));
            if stack.about().colour == Colour::Rgb {
                stack
                    .about_mut()
                    .notes
                    .push("channels are stored as blue, green, red, and were turned round".into());
            }
            recording.pictures = Some(Arc::new(stack) as Arc<dyn Pictures>);
            recording.facts.push(("frame camera".into(), format!("ovc/{side} (of {})", frames.join(", "))));
        }
    }
    Ok(Box::new(recording))
}
