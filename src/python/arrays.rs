//! Arrays from Python: as a recording in a file, as a name of their content, as voxel grids.

use crate::trouble;
use numpy::{
    IntoPyArray, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArrayDyn,
    PyUntypedArrayMethods,
};
use photocurrent_core::digest::DigestBuilder;
use photocurrent_core::{
    Colour, EventBand, EventStream, EventsMeta, Exposure, Extent, FrameBlock, FrameScale, FrameSequence,
    FrameTimes, FramesMeta, TimeSpan, Truth,
};
use photocurrent_nodes::baseline::onnx::voxel::{Grid, Normalise, Signs, Stretch, Timeline};
use photocurrent_store::{RecordingContent, write_recording as write};
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::Arc;

/// Events as columns: x, y, p (1 = ON), t in ns.
type Columns<'py> = (
    PyReadonlyArray1<'py, u16>,
    PyReadonlyArray1<'py, u16>,
    PyReadonlyArray1<'py, u8>,
    PyReadonlyArray1<'py, i64>,
);

/// Frames: values as [frame][y][x] or [frame][y][x][3], exposures of row 0 as [frame][start, end] in ns, the
/// delay from row to row in ns, the name of their colours.
type Frames<'py> = (PyReadonlyArrayDyn<'py, f32>, PyReadonlyArray2<'py, i64>, i64, String);

/// Writes a recording in the project's form, whole or not at all.
#[pyfunction]
#[pyo3(signature = (path, width, height, events=None, frames=None, truth=None, sensor=None))]
#[allow(clippy::too_many_arguments)]
pub fn write_recording(
    py: Python<'_>,
    path: PathBuf,
    width: u32,
    height: u32,
    events: Option<Columns<'_>>,
    frames: Option<Frames<'_>>,
    truth: Option<Frames<'_>>,
    sensor: Option<String>,
) -> PyResult<()> {
    let extent = Extent { width, height };
    let events = events.map(|columns| stream(py, extent, &columns)).transpose()?;
    let frames = frames.map(|frames| sequence(py, frames)).transpose()?;
    let truth = truth.map(|truth| sequence(py, truth)).transpose()?.map(Truth);
    py.detach(|| {
        let content = RecordingContent {
            events: events.as_ref(),
            frames: frames.as_ref(),
            truth: truth.as_ref(),
            sensor: sensor.as_deref(),
            ..RecordingContent::empty(extent)
        };
        write(&path, &content)
    })
    .map(drop)
    .map_err(|error| trouble::of(py, 1, &format!("error: {error}")))
}

fn stream(py: Python<'_>, extent: Extent, (x, y, p, t): &Columns<'_>) -> PyResult<EventStream> {
    let (x, y, p, t) = (x.as_slice()?, y.as_slice()?, p.as_slice()?, t.as_slice()?);
    let made = py.detach(|| {
        if let Some(at) = x.iter().position(|&x| u32::from(x) >= extent.width) {
            return Err(format!("event {at} has x = {}, and the sensor is {extent} pixels", x[at]));
        }
        if let Some(at) = y.iter().position(|&y| u32::from(y) >= extent.height) {
            return Err(format!("event {at} has y = {}, and the sensor is {extent} pixels", y[at]));
        }
        EventBand::from_file_order(extent.rows(), y, x, p, t, None).map_err(|error| error.message)
    });
    let band = made.map_err(|why| trouble::usage(py, format!("error: {why}")))?;
    let (first, last) = (t.iter().min(), t.iter().max());
    let meta = EventsMeta {
        extent,
        span: first.zip(last).map(|(first, last)| TimeSpan::new(*first, last + 1)),
        has_t_in: false,
        has_step: false,
        t_resolution_ns: None,
        count_hint: Some(t.len() as u64),
    };
    Ok(EventStream::in_memory(Arc::new(meta), band))
}

fn sequence(py: Python<'_>, (dn, exposures, row_time_ns, colour): Frames<'_>) -> PyResult<FrameSequence> {
    let refuse = |why: String| trouble::usage(py, format!("error: {why}"));
    let colour = Colour::named(&colour).ok_or_else(|| {
        let known: Vec<&str> = Colour::names().collect();
        refuse(format!("`{colour}` is no name of colours; known: {}", known.join(", ")))
    })?;
    let shape = dn.shape().to_vec();
    let (frames, extent) = match (&shape[..], colour.channels()) {
        (&[frames, height, width], 1) | (&[frames, height, width, 3], 3) => {
            (frames, Extent { width: width as u32, height: height as u32 })
        }
        _ => return Err(refuse(format!("frames in {colour} cannot have the shape {shape:?}"))),
    };
    let exposures = exposures.as_array();
    if exposures.shape() != [frames, 2] {
        let found = exposures.shape();
        return Err(refuse(format!(
            "{frames} frames need exposures of shape [{frames}, 2], found {found:?}"
        )));
    }
    let spans = exposures.outer_iter().map(|span| Exposure::new(span[0], span[1])).collect();
    let times = FrameTimes::new(spans, row_time_ns).map_err(|error| refuse(error.message))?;
    let meta = FramesMeta { extent, colour, times, scale: FrameScale::Captured };
    let block = FrameBlock {
        frames: 0..frames,
        rows: extent.rows(),
        row_values: meta.row_values(),
        dn: dn.as_slice()?.to_vec(),
    };
    Ok(FrameSequence::in_memory(Arc::new(meta), block))
}

/// The name of a content: of bytes with what they are, in order.
#[pyfunction]
pub fn digest(py: Python<'_>, parts: Vec<(String, PyReadonlyArray1<'_, u8>)>) -> PyResult<String> {
    let parts: PyResult<Vec<(&str, &[u8])>> =
        parts.iter().map(|(what, bytes)| Ok((what.as_str(), bytes.as_slice()?))).collect();
    let parts = parts?;
    Ok(py.detach(|| {
        let mut digest = DigestBuilder::new("python/1");
        for (what, bytes) in parts {
            digest.text(what).slice(bytes);
        }
        digest.finish().to_string()
    }))
}

/// Events as a voxel grid of a window of time (its end left out), as [channel][y][x]. `window` is in the
/// unit of `t`; bins are stretched over it, or over the first to the last event in it.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub fn voxels<'py>(
    py: Python<'py>,
    columns: Columns<'_>,
    size: (usize, usize),
    window: (i64, i64),
    bins: usize,
    separate: bool,
    over_events: bool,
    normalise: &str,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let (x, y, p, t) = columns;
    let (x, y, p, t) = (x.as_slice()?, y.as_slice()?, p.as_slice()?, t.as_slice()?);
    let (width, height) = size;
    let outside = x.iter().any(|&x| usize::from(x) >= width) || y.iter().any(|&y| usize::from(y) >= height);
    if outside || bins == 0 || [x.len(), y.len(), p.len()] != [t.len(); 3] {
        let why = format!("columns of one length, {bins} bins and events within {width} x {height} pixels");
        return Err(trouble::usage(py, format!("error: a voxel grid needs {why}, 1 bin or more")));
    }
    let grid = Grid {
        bins,
        signs: if separate { Signs::Separate } else { Signs::Signed },
        normalise: match normalise {
            "std" => Normalise::Std,
            "max" => Normalise::Max,
            _ => Normalise::Nothing,
        },
        stretch: if over_events { Stretch::Events } else { Stretch::Window },
        reversed: false,
    };
    let cells = py.detach(|| {
        let mut cells = Timeline::from_columns(t, x, y, p).grid(window.0..window.1, grid, size).0;
        if normalise == "sample_std" {
            standardise(&mut cells);
        }
        cells
    });
    cells.into_pyarray(py).reshape([grid.channels(), height, width])
}

/// Cells that are not 0 less their mean, over the standard deviation of a sample (n - 1): what DSEC's loader
/// does. Cells that are all alike become 0.
fn standardise(cells: &mut [f32]) {
    let filled = || cells.iter().filter(|cell| **cell != 0.0).map(|cell| f64::from(*cell));
    let count = filled().count() as f64;
    let mean = filled().sum::<f64>() / count;
    let squares: f64 = filled().map(|cell| (cell - mean) * (cell - mean)).sum();
    let deviation = (squares / (count - 1.0)).sqrt();
    let scale = if deviation > 0.0 { 1.0 / deviation } else { 1.0 };
    let of = |cell: &mut f32| *cell = ((f64::from(*cell) - mean) * scale) as f32;
    cells.iter_mut().filter(|cell| **cell != 0.0).for_each(of);
}

/// Panics, for the test that a panic becomes an exception.
#[pyfunction]
#[pyo3(name = "_panic")]
pub fn panic(py: Python<'_>) -> PyResult<()> {
    crate::waiting::wait(py, &Arc::default(), None, || panic!("a panic that was wanted"))
}
