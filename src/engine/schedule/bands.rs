//! How a task is cut into row bands, and about how much memory that takes.
//!
//! A node whose output rows reach only a known number of input rows may be run band by band; the height is
//! the largest with which inputs and outputs of one band fit into the task's share. Results do not depend on
//! the height: that is a promise of the nodes, tested with every one.

use crate::plan::Plan;
use crate::task::Task;
use photocurrent_core::node::Working;
use photocurrent_core::ports::PortValues;
use photocurrent_core::{EventsMeta, Grain, LightMeta, Meta, Rows, TracksMeta, Value};

/// Outputs of a band count so often: one band is put together from its rows while the one before waits for
/// the writer.
const COPIES: u64 = 3;

/// Rows may be unlike each other: the next band's outputs are taken for so much larger than the last one's,
/// in quarters.
const CAUTION_QUARTERS: u64 = 5;

/// Of the tallest band that an estimate allows, the first is such a part: a solver may give three times as
/// many knots an event as was guessed.
const FIRST_PART: u32 = 8;

/// How a task may be cut.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Bands {
    /// All rows that it produces; empty when nothing it takes or gives has rows.
    pub rows: Rows,
    /// Rows needed above and below a band; `None` when everything is produced at once.
    pub halo: Option<u32>,
    /// Height of every band where it was asked for.
    forced: Option<u32>,
    /// Bytes that a band may take.
    share: u64,
    /// About how many bytes a band takes.
    pub estimate: u64,
    /// About how many bytes all rows of the inputs take, as planned.
    planned_inputs: u64,
    /// What the node takes besides inputs and outputs: all threads together, and with all rows.
    work: (u64, u64),
}

/// Bytes of a task's inputs and outputs: those that shrink with the band, and those that do not.
struct Size {
    banded_inputs: u64,
    banded_outputs: u64,
    banded_work: u64,
    fixed: u64,
}

impl Size {
    /// With `part` of the rows as output and `reach` of the rows as input.
    fn at(&self, part: f64, reach: f64) -> u64 {
        self.fixed
            + (self.banded_inputs as f64 * reach
                + (COPIES as f64 * self.banded_outputs as f64 + self.banded_work as f64) * part)
                as u64
    }

    /// Of all in one piece, which waits for the writer once.
    fn whole(&self) -> u64 {
        self.fixed + self.banded_inputs + self.banded_work + 2 * self.banded_outputs
    }
}

/// Says how a task is cut so that a band fits into `share` bytes; `forced` sets the height instead, where the
/// node may be cut at all.
pub(crate) fn cut(plan: &Plan, task: &Task, share: u64, threads: usize, forced: Option<u32>) -> Bands {
    let outputs: Vec<&Meta> = task
        .outputs
        .iter()
        .filter(|output| !matches!(output.meta, Meta::Absent { .. }))
        .map(|output| &output.meta)
        .collect();
    let inputs: Vec<Meta> =
        task.inputs.iter().filter_map(|input| input.metas(&plan.tasks).ok()).flatten().collect();
    let rows = outputs
        .iter()
        .copied()
        .chain(&inputs)
        .find_map(|meta| meta.rows())
        .unwrap_or(Rows { start: 0, end: 0 });
    let Working { per_thread, banded } = task.working;
    let work = (per_thread * threads as u64, banded);
    let mut size = Size { banded_inputs: 0, banded_outputs: 0, banded_work: work.1, fixed: work.0 };
    for meta in &inputs {
        let counter = if meta.rows() == Some(rows) { &mut size.banded_inputs } else { &mut size.fixed };
        *counter += meta.estimated_bytes();
    }
    for output in task.stored() {
        let counter =
            if output.meta.rows() == Some(rows) { &mut size.banded_outputs } else { &mut size.fixed };
        *counter += output.meta.estimated_bytes();
    }
    let Some(halo) = halo(task, rows) else {
        return Bands {
            rows,
            halo: None,
            forced,
            share,
            estimate: size.whole(),
            planned_inputs: size.banded_inputs,
            work,
        };
    };
    let all = rows.len() as u32;
    let part = |height: u32| f64::from(height.min(all)) / f64::from(all);
    let need = |height: u32| size.at(part(height), part(height.saturating_add(2 * halo)));
    let height = forced.unwrap_or_else(|| tallest(all, share, &need)).clamp(1, all);
    Bands {
        rows,
        halo: Some(halo),
        forced,
        share,
        estimate: need(height),
        planned_inputs: size.banded_inputs,
        work,
    }
}

/// How many rows above and below a band of the task's outputs need; `None` when it cannot be cut.
pub(crate) fn halo(task: &Task, rows: Rows) -> Option<u32> {
    // Only what has rows can be put together from bands, and files are written in one go.
    let can_be_cut = task.stored().next().is_some()
        && task.stored().all(|output| output.meta.rows() == Some(rows))
        && task.export.is_none()
        && !rows.is_empty();
    match task.grain {
        Grain::Pixel => Some(0),
        Grain::Row { halo } => Some(halo),
        Grain::Frame | Grain::Whole => None,
    }
    .filter(|_| can_be_cut)
}

/// Cuts band after band, from what the inputs hold and what the bands before gave.
pub(crate) struct Cutter<'a> {
    bands: &'a Bands,
    inputs: &'a PortValues,
    /// Rows that are still to be produced.
    left: Rows,
    /// About how many bytes of outputs a row has.
    row_outputs: u64,
    last_height: Option<u32>,
}

impl<'a> Cutter<'a> {
    /// For `rows` of a task, whose wanted outputs look like `outputs`.
    pub(crate) fn new(bands: &'a Bands, rows: Rows, outputs: &[&Meta], inputs: &'a PortValues) -> Cutter<'a> {
        // What could not be counted when the run was planned is as much larger as the inputs turned out to
        // be.
        let larger = f64::max(
            banded_bytes(inputs, bands.rows, bands.rows) as f64 / (bands.planned_inputs as f64).max(1.0),
            1.0,
        );
        let bytes_of = |meta: &&Meta| {
            (meta.estimated_bytes() as f64 * if meta.is_counted() { 1.0 } else { larger }) as u64
        };
        let bytes: u64 = outputs.iter().map(bytes_of).fold(0, u64::saturating_add);
        Cutter {
            bands,
            inputs,
            left: rows,
            row_outputs: bytes / (bands.rows.len() as u64).max(1),
            last_height: None,
        }
    }

    /// The first row that is still to be produced.
    pub(crate) fn at(&self) -> Option<u32> {
        (!self.left.is_empty()).then_some(self.left.start)
    }

    /// Somebody else gave the rows up to this one.
    pub(crate) fn skip_to(&mut self, row: u32) {
        self.left.start = row.min(self.left.end);
    }

    /// The next band, which ends at `limit` at the latest; one, perhaps without rows, for what cannot be cut.
    pub(crate) fn next(&mut self, limit: u32) -> Option<Rows> {
        let (bands, left) = (self.bands, self.left);
        let Some(halo) = bands.halo else {
            return self.last_height.replace(0).is_none().then_some(left);
        };
        if left.is_empty() {
            return None;
        }
        let all = (left.end.min(limit) - left.start).max(1);
        let height = bands.forced.unwrap_or_else(|| {
            let tallest = tallest(all, bands.share, &|height| self.need(height));
            match self.last_height {
                // Nothing is known yet but an estimate: a part that would fit if it were several times too
                // low.
                None if all > tallest / FIRST_PART => (tallest / FIRST_PART).max(1),
                None => all,
                Some(last) => tallest.min(last.saturating_mul(2)),
            }
        });
        // A node that reads around its rows often works by blocks as high as that: whole ones spare it work
        // done twice.
        let end = left.start + height.clamp(1, all);
        let end = if bands.forced.is_none() && halo > 0 && end < left.end && end / halo * halo > left.start {
            end / halo * halo
        } else {
            end
        };
        let band = Rows { start: left.start, end };
        self.left.start = band.end;
        self.last_height = Some(band.len() as u32);
        Some(band)
    }

    /// Learns what the outputs of a band really take.
    pub(crate) fn learn(&mut self, band: Rows, outputs: u64) {
        if !band.is_empty() {
            self.row_outputs = outputs / 4 * CAUTION_QUARTERS / band.len() as u64;
        }
    }

    /// What a single row takes, without those around it, and what it may, in bytes, where that is too much;
    /// known after the first band.
    pub(crate) fn too_much(&self) -> Option<(u64, u64)> {
        let is_known = self.last_height.is_some()
            && self.bands.halo.is_some()
            && self.bands.forced.is_none()
            && !self.left.is_empty();
        let row = Rows { start: self.left.start, end: self.left.start + 1 };
        let needed = || banded_bytes(self.inputs, self.bands.rows, row) + COPIES * self.row_outputs;
        is_known.then(|| (needed(), self.bands.share)).filter(|(needed, share)| needed > share)
    }

    /// Bytes that the next band takes with so many rows.
    fn need(&self, height: u32) -> u64 {
        let band =
            Rows { start: self.left.start, end: self.left.end.min(self.left.start.saturating_add(height)) };
        let reach = band.with_halo(self.bands.halo.unwrap_or(0), self.bands.rows);
        let (fixed, banded) = self.bands.work;
        let of_work = banded / (self.bands.rows.len() as u64).max(1) * band.len() as u64;
        let of_data =
            banded_bytes(self.inputs, self.bands.rows, reach) + COPIES * self.row_outputs * band.len() as u64;
        of_data + of_work + fixed
    }
}

/// Bytes that some rows take of those inputs that have the rows of the task.
fn banded_bytes(inputs: &PortValues, all: Rows, some: Rows) -> u64 {
    inputs.values().flatten().filter(|value| is_cut(value, all)).map(|value| value.bytes(some)).sum()
}

/// Is the value cut together with a task of so many rows?
fn is_cut(value: &Value, rows: Rows) -> bool {
    value.meta().rows() == Some(rows)
}

/// The inputs of one band: what has the rows of the task is cut to the band and its halo; everything else
/// stays whole.
pub(crate) fn inputs_of(inputs: &PortValues, bands: &Bands, band: Rows) -> PortValues {
    let Some(halo) = bands.halo.filter(|_| band != bands.rows) else { return inputs.clone() };
    let reach = band.with_halo(halo, bands.rows);
    let cut = |value: &Value| if is_cut(value, bands.rows) { value.cut(reach) } else { value.clone() };
    inputs.iter().map(|(port, values)| (*port, values.iter().map(cut).collect())).collect()
}

/// The largest height that fits, and 1 when none does. More rows never need less, so halving finds it.
fn tallest(all: u32, share: u64, need: &dyn Fn(u32) -> u64) -> u32 {
    let (mut fits, mut too_tall) = (1, all + 1);
    while too_tall - fits > 1 {
        let middle = fits + (too_tall - fits) / 2;
        if need(middle) <= share { fits = middle } else { too_tall = middle }
    }
    fits
}

/// Does the plan keep its promise? Counts are hints and may differ; a description that a node works out is
/// planned as the one that it was given, and what is in it is known by its content.
pub(crate) fn same_meta(planned: &Meta, actual: &Meta) -> bool {
    let events = |meta: &EventsMeta| EventsMeta { count_hint: None, ..meta.clone() };
    let tracks = |meta: &TracksMeta| TracksMeta { count_hint: None, ..meta.clone() };
    let light = |meta: &LightMeta| LightMeta { count_hint: None, ..meta.clone() };
    match (planned, actual) {
        (Meta::Events(planned), Meta::Events(actual)) => events(planned) == events(actual),
        (Meta::Tracks(planned), Meta::Tracks(actual)) => tracks(planned) == tracks(actual),
        (Meta::Light(planned), Meta::Light(actual)) => light(planned) == light(actual),
        (Meta::Sensor(_), Meta::Sensor(_)) => true,
        (planned, actual) => planned == actual,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Between, Colour, Extent, MapBand, MapMeta, MapSet, TimeSpan};
    use std::sync::Arc;

    #[test]
    fn what_could_not_be_counted_is_as_much_larger_as_the_inputs_turn_out_to_be() {
        let extent = Extent { width: 8, height: 64 };
        let meta = MapMeta { extent, planes: vec!["value".into()] };
        let band = MapBand::zeros(extent.rows(), &meta);
        let inputs = PortValues::from([("plane", vec![Value::Map(MapSet::in_memory(Arc::new(meta), band))])]);
        let bytes = banded_bytes(&inputs, extent.rows(), extent.rows());
        let with_work = |count_hint: Option<u64>, planned_inputs: u64, work: (u64, u64)| {
            let tracks = Meta::Tracks(Arc::new(TracksMeta {
                extent,
                span: TimeSpan::new(0, 10),
                nominal_exposure_ns: 5,
                between: Between::Hold,
                colour: Colour::Mono,
                has_sigma: false,
                count_hint,
            }));
            let bands = Bands {
                rows: extent.rows(),
                halo: Some(0),
                forced: None,
                share: 150_000,
                estimate: 0,
                planned_inputs,
                work,
            };
            Cutter::new(&bands, extent.rows(), &[&tracks], &inputs).next(64).map(|band| band.len())
        };
        let first = |hint, planned| with_work(hint, planned, (0, 0));
        // Eight knots a pixel are 104 bytes of it, three times 832 and 32 of inputs of a row: 59 rows fit,
        // and an eighth of that are 7.
        assert_eq!(first(None, bytes), Some(7));
        // Inputs are four times as large as planned, and so are outputs: 14 rows would fit.
        assert_eq!(first(None, bytes / 4), Some(1));
        assert_eq!(first(Some(8 * extent.pixels() as u64), bytes / 4), Some(7));
        // Memory besides leaves room for half as many rows: once and for all, or by the row.
        assert_eq!(with_work(None, bytes, (75_000, 0)), Some(3));
        assert_eq!(with_work(None, bytes, (0, 64 * 2_528)), Some(3));
    }
}
