//! Prophesee's HDF5: `CD/events` with members x, y, p, t in us, `EXT_TRIGGER/events` with p, t, id; packed by
//! ECF or not; attributes repeat the RAW header.
//!
//! `CD/indexes` is not used: its times are shifted and its entries repeat; halving the stamps finds a time
//! with a few chunks.

use super::table::EventTable;
use super::{HdfRecording, declared_extent, extent, holds, open_file, optional, refused, with_cut};
use crate::chunk::{Edge, Trigger};
use crate::error::{FormatError, Loss};
use crate::format::{Format, Probe};
use crate::recording::Recording;
use crate::{Declared, TimeUnit};
use photocurrent_core::Extent;
use photocurrent_store::foreign::ForeignFile;
use std::path::Path;

/// Prophesee's HDF5.
pub(crate) static FORMAT: Format = Format {
    id: "prophesee_hdf5",
    name: "Prophesee HDF5",
    recognises,
    open: |path, declared| with_cut(open(path, declared)),
};

/// Attributes that people want to see.
const FACTS: [&str; 8] = [
    "serial_number",
    "generation",
    "integrator_name",
    "plugin_integrator_name",
    "system_ID",
    "camera_integrator_name",
    "date",
    "version",
];

/// Triggers that are read; a line that never rests has fewer.
const MOST_TRIGGERS: usize = 10_000_000;

/// Losses of triggers that are named one by one.
const MOST_LOSSES: usize = 20;

fn recognises(probe: &Probe) -> bool {
    holds(probe, &["CD/events"])
}

fn open(path: &Path, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    let file = open_file(path)?;
    let mut table = EventTable::of_compound(&file, "CD/events")?;
    let geometry = file.attribute("", "geometry").map_err(|error| refused(path, error))?;
    table.extent =
        declared_extent(declared, geometry.as_ref().and_then(|value| value.text()).and_then(sides));
    let mut recording = HdfRecording::new(path, &file, Some(table), Vec::new(), Vec::new());
    for name in FACTS {
        if let Ok(Some(value)) = file.attribute("", name) {
            let numbers = || value.numbers().iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
            recording.facts.push((name.replace('_', " "), value.text().map_or_else(numbers, str::to_string)));
        }
    }
    recording.triggers = triggers(&file, MOST_TRIGGERS, &mut recording.losses)?;
    Ok(Box::new(recording))
}

/// "640x480".
fn sides(geometry: &str) -> Option<Extent> {
    let (width, height) = geometry.trim().split_once('x')?;
    extent(width.trim().parse().ok()?, height.trim().parse().ok()?)
}

pub(super) fn triggers(
    file: &ForeignFile,
    most: usize,
    losses: &mut Vec<Loss>,
) -> Result<Vec<Trigger>, FormatError> {
    let wrap = |error| refused(file.path(), error);
    let Some(events) = optional(file, "EXT_TRIGGER/events", losses)? else { return Ok(Vec::new()) };
    let (Some(p), Some(t), Some(id)) = (events.member("p"), events.member("t"), events.member("id")) else {
        return Ok(Vec::new());
    };
    let mut triggers = Vec::new();
    let count = events.rows().min(most);
    for start in (0..count).step_by(1 << 16) {
        let block = events.rows_at(start..count.min(start + (1 << 16))).map_err(wrap)?;
        let (mut edges, mut times, mut lines) = (Vec::new(), Vec::new(), Vec::new());
        block.integers(p, &mut edges);
        block.integers(t, &mut times);
        block.integers(id, &mut lines);
        for gap in block.gaps() {
            losses.push(Loss::new(
                format!("triggers {} to {}", gap.rows.start, gap.rows.end - 1),
                format!("{}; they are lost", gap.why),
            ));
        }
        for i in 0..times.len() {
            if block.gaps().iter().any(|gap| gap.rows.contains(&(start + i))) {
                continue;
            }
            let edge = if edges[i] > 0 { Edge::Rising } else { Edge::Falling };
            let (Some(t), Ok(line)) = (times[i].checked_mul(TimeUnit::Us.ns()), u16::try_from(lines[i]))
            else {
                continue;
            };
            triggers.push(Trigger { t, line, edge });
        }
    }
    losses.truncate(MOST_LOSSES);
    if count < events.rows() {
        let what = format!("no more than {most} triggers are read; the others are left out");
        losses.push(Loss::new(format!("triggers {count} to {}", events.rows() - 1), what));
    }
    Ok(triggers)
}
