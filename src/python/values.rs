//! Values that flow between nodes, as arrays and texts.

use crate::events::{self, Event, Unit};
use crate::trouble;
use numpy::ndarray::ArrayD;
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayDyn, PyArrayMethods};
use photocurrent_core::table::Column;
use photocurrent_core::{FrameScale, FrameSequence, Rows, Truth, Value as Flowing};
use pyo3::prelude::*;
use std::path::PathBuf;

/// Pixels in flat columns: index of the first sample of every pixel and the number of samples, instants in
/// ns, photocurrents, standard deviations of their logarithm (empty where not known).
type Columns<'py> = (
    Bound<'py, PyArray1<u64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<f32>>,
    Bound<'py, PyArray1<f32>>,
);

/// When frames were exposed: start and end of row 0 in ns, the delay from row to row in ns, and the exposure
/// in ns that rendered values are scaled to (`None` of captured frames).
type Times<'py> = (Bound<'py, PyArray2<i64>>, i64, Option<i64>);

/// A value that a node gave. Its data are read when they are wanted.
#[pyclass(frozen, module = "photocurrent._native")]
pub struct Value {
    value: Flowing,
    /// The name of its content.
    #[pyo3(get)]
    digest: String,
}

/// Opens a stored value, an HDF5 file of the cache.
#[pyfunction]
pub fn load(py: Python<'_>, path: PathBuf) -> PyResult<Value> {
    let value = py.detach(|| photocurrent_store::open_value(&path));
    let value = value.map_err(|error| trouble::data(py, error))?;
    let digest = py.detach(|| value.digest()).map_err(|error| trouble::data(py, error))?;
    Ok(Value::new(value, digest.to_string()))
}

impl Value {
    /// Of a content.
    pub fn new(value: Flowing, digest: String) -> Value {
        Value { value, digest }
    }

    fn sequence(&self, py: Python<'_>) -> PyResult<&FrameSequence> {
        match &self.value {
            Flowing::Frames(frames) | Flowing::Truth(Truth(frames)) => Ok(frames),
            _ => Err(self.no(py, "frames")),
        }
    }

    fn no(&self, py: Python<'_>, wanted: &str) -> PyErr {
        trouble::usage(py, format!("error: this value is {}, no {wanted}", self.value.data_type().name()))
    }
}

#[pymethods]
impl Value {
    /// Its type: `events`, `frames`, `tracks` ...
    #[getter]
    fn kind(&self) -> &'static str {
        self.value.data_type().name()
    }

    /// What is known of it without its data, as JSON.
    fn meta(&self, py: Python<'_>) -> PyResult<String> {
        let meta = serde_json::to_value(self.value.meta()).map_err(|error| trouble::data(py, error))?;
        let inner = meta.as_object().and_then(|object| object.values().next()).cloned();
        Ok(inner.unwrap_or(meta).to_string())
    }

    /// Events in the order of time, with stamps in `unit` (`us` or `ns`).
    fn events<'py>(&self, py: Python<'py>, unit: &str) -> PyResult<Bound<'py, PyArray1<Event>>> {
        let Flowing::Events(stream) = &self.value else { return Err(self.no(py, "events")) };
        let unit = Unit::named(unit).ok_or_else(|| trouble::usage(py, "error: unit is \"us\" or \"ns\""))?;
        let read = py.detach(|| Ok(events::of_band(&stream.read(stream.rows())?, unit)));
        let all = read.map_err(|error: photocurrent_core::DataError| trouble::data(py, error))?;
        Ok(events::array(py, all))
    }

    /// Number of frames.
    fn frame_count(&self, py: Python<'_>) -> PyResult<usize> {
        Ok(self.sequence(py)?.len())
    }

    /// Some frames as [frame][y][x] or [frame][y][x][channel], linear DN.
    fn frames<'py>(
        &self,
        py: Python<'py>,
        start: usize,
        stop: usize,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        frames_array(py, self.sequence(py)?, start..stop)
    }

    /// When the frames were exposed.
    fn times<'py>(&self, py: Python<'py>) -> PyResult<Times<'py>> {
        times(py, self.sequence(py)?)
    }

    /// Tracks or light of some rows, in flat columns.
    fn columns<'py>(&self, py: Python<'py>, start: u32, end: u32) -> PyResult<Columns<'py>> {
        let rows = Rows { start, end };
        let parts = py.detach(|| match &self.value {
            Flowing::Tracks(tracks) => Some(tracks.read(rows).map(|band| {
                (band.offsets().iter().map(|&at| at as u64).collect(), band.t, band.photocurrent, band.sigma)
            })),
            Flowing::Light(light) => Some(light.read(rows).map(|band| {
                (band.offsets().iter().map(|&at| at as u64).collect(), band.t, band.photocurrent, band.sigma)
            })),
            _ => None,
        });
        let parts = parts.ok_or_else(|| self.no(py, "tracks"))?;
        let (offsets, t, photocurrent, sigma): (Vec<u64>, _, _, _) =
            parts.map_err(|error| trouble::data(py, error))?;
        Ok((
            PyArray1::from_vec(py, offsets),
            PyArray1::from_vec(py, t),
            PyArray1::from_vec(py, photocurrent),
            PyArray1::from_vec(py, sigma),
        ))
    }

    /// Planes of one number a pixel: their names, and values as [plane][y][x].
    fn planes<'py>(&self, py: Python<'py>) -> PyResult<(Vec<String>, Bound<'py, PyArray3<f32>>)> {
        let Flowing::Map(map) = &self.value else { return Err(self.no(py, "planes")) };
        let band = py.detach(|| map.read(map.rows())).map_err(|error| trouble::data(py, error))?;
        let (width, height) = (map.meta.extent.width as usize, map.meta.extent.height as usize);
        let names = map.meta.planes.clone();
        let values: Vec<f32> = (0..names.len())
            .flat_map(|plane| {
                map.rows().iter().flat_map(|row| band.row(plane, row).iter().copied()).collect::<Vec<_>>()
            })
            .collect();
        let flat = PyArray1::from_vec(py, values);
        Ok((names.clone(), flat.reshape([names.len(), height, width])?))
    }

    /// A table: columns by name, and notes by name.
    #[allow(clippy::type_complexity)]
    fn table<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Vec<(String, Bound<'py, PyAny>)>, Vec<(String, String)>)> {
        let Flowing::Table(table) = &self.value else { return Err(self.no(py, "a table")) };
        let column = |(name, column): &(String, Column)| {
            let cells = match column {
                Column::Numbers(cells) => PyArray1::from_slice(py, cells).into_any(),
                Column::Integers(cells) => PyArray1::from_slice(py, cells).into_any(),
                Column::Texts(cells) => cells.into_pyobject(py)?,
            };
            Ok((name.clone(), cells))
        };
        let columns: PyResult<Vec<_>> = table.columns().iter().map(column).collect();
        Ok((columns?, table.notes.clone()))
    }

    /// A sensor description as TOML, or the document of a diagnosis' stage.
    fn text(&self, py: Python<'_>) -> PyResult<String> {
        match &self.value {
            Flowing::Sensor(sensor) => Ok(sensor.to_toml()),
            Flowing::Diagnosis(document) => Ok(document.text().to_owned()),
            _ => Err(self.no(py, "text")),
        }
    }
}

/// Some frames of a sequence.
pub fn frames_array<'py>(
    py: Python<'py>,
    sequence: &FrameSequence,
    frames: std::ops::Range<usize>,
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    let (meta, rows) = (&sequence.meta, sequence.rows());
    let block =
        py.detach(|| sequence.read(frames.clone(), rows)).map_err(|error| trouble::data(py, error))?;
    let mut shape = vec![frames.len(), rows.len(), meta.extent.width as usize];
    if meta.channels() > 1 {
        shape.push(meta.channels() as usize);
    }
    let array = ArrayD::from_shape_vec(shape, block.dn).map_err(|error| trouble::data(py, error))?;
    Ok(PyArrayDyn::from_owned_array(py, array))
}

/// When the frames of a sequence were exposed.
pub fn times<'py>(py: Python<'py>, sequence: &FrameSequence) -> PyResult<Times<'py>> {
    let times = &sequence.meta.times;
    let flat: Vec<i64> = times.exposures.iter().flat_map(|e| [e.start.0, e.end.0]).collect();
    let scaled = match sequence.meta.scale {
        FrameScale::Captured => None,
        FrameScale::Nominal { exposure_ns } => Some(exposure_ns),
    };
    Ok((PyArray1::from_vec(py, flat).reshape([times.len(), 2])?, times.row_time_ns, scaled))
}
