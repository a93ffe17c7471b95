//! How a task is cut into row bands, and about how much memory that takes.
//!
//! A node whose output rows reach only a known number of input rows may be run band by band; the height is the largest with which inputs and
//! outputs of one band fit into the task's share. Results do not depend on the height: that is a promise of the nodes, tested with every one.

use crate::plan::{Plan, Task};
use photocurrent_core::{EventsMeta, Grain, LightMeta, Meta, Rows, TracksMeta};

/// A task's bands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Bands {
    /// All rows that it produces; empty when nothing it takes or gives has rows.
    pub rows: Rows,
    /// Top to bottom; exactly one unless the node may be cut.
    pub bands: Vec<Rows>,
    /// Rows needed above and below a band.
    pub halo: u32,
    /// About how many bytes one band takes.
    pub estimate: u64,
}

/// Bytes of a task's inputs and outputs: those that shrink with the band, and those that do not.
struct Size {
    banded_inputs: u64,
    banded_outputs: u64,
    fixed: u64,
}

impl Size {
    /// With `part` of the rows as output and `reach` of the rows as input.
    fn at(&self, part: f64, reach: f64) -> u64 {
        // Outputs count twice: one band waits for the writer while the next is computed.
        self.fixed + (self.banded_inputs as f64 * reach + 2.0 * self.banded_outputs as f64 * part) as u64
    }
}

/// Cuts a task so that a band fits into `share` bytes; `forced` sets the height instead, where the node may be cut at all.
pub(crate) fn cut(plan: &Plan, task: &Task, share: u64, forced: Option<u32>) -> Bands {
    let outputs: Vec<&Meta> = task.outputs.iter().filter(|output| !matches!(output.meta, Meta::Absent { .. })).map(|output| &output.meta).collect();
    let sources = task.inputs.iter().flat_map(|input| &input.from);
    let inputs: Vec<&Meta> = sources.filter_map(|(from, port)| plan.tasks[*from].output(port)).map(|output| &output.meta).collect();
    let rows = outputs.iter().chain(&inputs).find_map(|meta| meta.rows()).unwrap_or(Rows { start: 0, end: 0 });
    let mut size = Size { banded_inputs: 0, banded_outputs: 0, fixed: 0 };
    for meta in &inputs {
        let counter = if meta.rows() == Some(rows) { &mut size.banded_inputs } else { &mut size.fixed };
        *counter += meta.estimated_bytes();
    }
    for output in task.stored() {
        let counter = if output.meta.rows() == Some(rows) { &mut size.banded_outputs } else { &mut size.fixed };
        *counter += output.meta.estimated_bytes();
    }
    let halo = match task.grain {
        Grain::Pixel => Some(0),
        Grain::Row { halo } => Some(halo),
        Grain::Frame | Grain::Whole => None,
    };
    // Only what has rows can be put together from bands, and files are written in one go.
    let can_be_cut =
        task.stored().next().is_some() && task.stored().all(|output| output.meta.rows() == Some(rows)) && task.export.is_none() && !rows.is_empty();
    let Some(halo) = halo.filter(|_| can_be_cut) else {
        return Bands { rows, bands: vec![rows], halo: 0, estimate: size.at(1.0, 1.0) };
    };
    let all = rows.len() as u32;
    let part = |height: u32| f64::from(height.min(all)) / f64::from(all);
    let need = |height: u32| size.at(part(height), part(height.saturating_add(2 * halo)));
    let height = forced.unwrap_or_else(|| tallest(all, share, &need)).clamp(1, all);
    Bands { rows, bands: rows.bands(height), halo, estimate: need(height) }
}

/// About how many bytes the outputs of a task's smallest piece take: a row where the node may be cut, else everything.
pub(crate) fn least_bytes(task: &Task) -> u64 {
    let all: u64 = task.stored().map(|output| output.meta.estimated_bytes()).fold(0, u64::saturating_add);
    let rows = task.stored().next().and_then(|output| output.meta.rows());
    let same_rows = task.stored().all(|output| output.meta.rows() == rows);
    match (task.grain, rows) {
        (Grain::Pixel | Grain::Row { .. }, Some(rows)) if same_rows && task.export.is_none() && !rows.is_empty() => all / rows.len() as u64,
        _ => all,
    }
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

/// Does the plan keep its promise? Counts are hints and may differ; a description that a node works out is planned as the one that it was given, and what is in it is
/// known by its content.
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
