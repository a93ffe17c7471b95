//! Events as structured arrays: one record an event, in the order of time.
//!
//! The layout is that of Metavision's `EventCD`: `x` and `y` (u2), `p` (i2, 1 = ON), `t` (i8), 16 bytes.

use numpy::{Element, PyArray1, PyArrayDescr};
use photocurrent_core::EventBand;
use photocurrent_core::handle::Band;
use photocurrent_formats::EventChunk;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyDict;
use rayon::prelude::*;
use std::collections::TryReserveError;

/// An event.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Event {
    x: u16,
    y: u16,
    p: i16,
    unused: u16,
    /// Microseconds or nanoseconds.
    t: i64,
}

// SAFETY: the description states the offsets of this struct, and every bit pattern of its fields is valid.
unsafe impl Element for Event {
    const IS_COPY: bool = true;

    fn get_dtype(py: Python<'_>) -> Bound<'_, PyArrayDescr> {
        static DTYPE: PyOnceLock<Py<PyArrayDescr>> = PyOnceLock::new();
        let made = || -> PyResult<Py<PyArrayDescr>> {
            let fields = PyDict::new(py);
            fields.set_item("names", ["x", "y", "p", "t"])?;
            fields.set_item("formats", ["<u2", "<u2", "<i2", "<i8"])?;
            fields.set_item("offsets", [0, 2, 4, 8])?;
            fields.set_item("itemsize", 16)?;
            Ok(PyArrayDescr::new(py, fields)?.unbind())
        };
        let dtype = DTYPE.get_or_try_init(py, made).expect("numpy takes a list of fields");
        dtype.bind(py).clone()
    }

    fn clone_ref(&self, _py: Python<'_>) -> Event {
        *self
    }

    fn array_from_view<D: numpy::ndarray::Dimension>(
        _py: Python<'_>,
        view: numpy::ndarray::ArrayView<'_, Event, D>,
    ) -> numpy::ndarray::Array<Event, D> {
        view.to_owned()
    }
}

/// The unit of stamps.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    Us,
    Ns,
}

impl Unit {
    /// By its name.
    pub fn named(name: &str) -> Option<Unit> {
        match name {
            "us" => Some(Unit::Us),
            "ns" => Some(Unit::Ns),
            _ => None,
        }
    }

    fn of(self, ns: i64) -> i64 {
        match self {
            Unit::Us => ns.div_euclid(1000),
            Unit::Ns => ns,
        }
    }
}

/// Events of all rows in the order of time; equal stamps in the order of rows.
pub fn of_band(band: &EventBand, unit: Unit) -> Vec<Event> {
    let mut all = Vec::with_capacity(band.len());
    for y in band.rows().iter() {
        let row = band.row(y);
        all.extend((0..row.t.len()).map(|k| Event {
            x: row.x[k],
            y: y as u16,
            p: i16::from(row.on[k]),
            unused: 0,
            t: row.t[k],
        }));
    }
    all.par_sort_by_key(|event| event.t);
    all.par_iter_mut().for_each(|event| event.t = unit.of(event.t));
    all
}

/// All events of a file, collected in one pass.
pub struct Collected {
    events: Vec<Event>,
    /// Nanoseconds of a step of the stamps that are kept so far: 1000 where the file has no finer ones.
    step_ns: i64,
    unit: Unit,
    /// The first stamp of the file, from which the others count, ns.
    first_ns: Option<i64>,
    /// The earliest and the latest stamp so far, in steps from the first.
    earliest: i64,
    last: i64,
    is_ordered: bool,
}

impl Collected {
    /// Nothing yet, of a file whose stamps are multiples of `tick_ns`.
    pub fn new(tick_ns: i64, unit: Unit) -> Collected {
        let step_ns = if unit == Unit::Us && tick_ns > 0 && tick_ns % 1000 == 0 { 1000 } else { 1 };
        let (events, first_ns) = (Vec::new(), None);
        Collected { events, step_ns, unit, first_ns, earliest: 0, last: i64::MIN, is_ordered: true }
    }

    /// Makes room, where there is some.
    pub fn reserve(&mut self, events: usize) {
        // Without it the list grows as it must.
        let _ = self.events.try_reserve(events);
    }

    /// Adds a piece.
    ///
    /// # Errors
    /// When memory is out.
    pub fn add(&mut self, chunk: &EventChunk) -> Result<(), TryReserveError> {
        let Some(&first) = chunk.t.first() else { return Ok(()) };
        self.events.try_reserve(chunk.len())?;
        let zero = *self.first_ns.get_or_insert(first);
        let begin = self.events.len();
        // The constant makes the division a multiplication.
        match self.step_ns {
            1000 => append(chunk, |t| (t - zero).div_euclid(1000), &mut self.events),
            _ => append(chunk, |t| t - zero, &mut self.events),
        }
        let added = &self.events[begin..];
        if !chunk.t.is_sorted() || added[0].t < self.last {
            self.is_ordered = false;
            self.earliest = added.iter().map(|event| event.t).fold(self.earliest, i64::min);
        }
        self.last = added[added.len() - 1].t;
        Ok(())
    }

    /// The events in the order of time, with stamps from `zero_ns` of the file's clock on; by itself from the
    /// earliest of theirs and `frame_ns`.
    pub fn finish(mut self, zero_ns: Option<i64>, frame_ns: Option<i64>) -> Vec<Event> {
        let first = self.first_ns.unwrap_or(0);
        let earliest = self.earliest * self.step_ns;
        let earliest = frame_ns.map_or(earliest, |frame| earliest.min(frame - first));
        let begin = zero_ns.map_or(earliest, |zero| zero - first);
        if !self.is_ordered {
            self.events.par_sort_by_key(|event| event.t);
        }
        let (step, unit) = (self.step_ns, self.unit);
        if begin != 0 || step == 1 && unit == Unit::Us {
            self.events.par_iter_mut().for_each(|event| event.t = unit.of(event.t * step - begin));
        }
        self.events
    }
}

fn append(chunk: &EventChunk, stamp: impl Fn(i64) -> i64, to: &mut Vec<Event>) {
    let places = chunk.x.iter().zip(&chunk.y);
    let rest = chunk.on.iter().zip(&chunk.t);
    to.extend(places.zip(rest).map(|((&x, &y), (&on, &t))| Event {
        x,
        y,
        p: i16::from(on),
        unused: 0,
        t: stamp(t),
    }));
}

/// A piece of a stream in the order of time, as it is stamped.
pub fn add(chunk: &EventChunk, unit: Unit, to: &mut Vec<Event>) {
    append(chunk, |t| unit.of(t), to);
}

/// As an array that owns them: no copy.
pub fn array(py: Python<'_>, events: Vec<Event>) -> Bound<'_, PyArray1<Event>> {
    PyArray1::from_vec(py, events)
}
