//! An opened recording of any format, read as arrays without a run: one pass over its events.
//!
//! Times are those of the readers' nodes: they begin at the earliest stamp of events and frames.

use crate::events::{self, Collected, Event, Unit};
use crate::trouble;
use crate::values::{frames_array, times};
use crate::waiting::wait;
use numpy::{PyArray1, PyArray2, PyArrayDyn};
use photocurrent_core::quantity::Duration;
use photocurrent_core::{DataError, FrameSequence};
use photocurrent_formats::arrange::{Arranged, EVENTS_BUDGET, Settings, arrange};
use photocurrent_formats::{EventChunk, EventCursor, FormatError, Recording, joined, recognise};
use photocurrent_nodes::read::foreign::All;
use pyo3::prelude::*;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// The id of the project's own form.
const OWN: &str = "recording";

/// Most events that room is made for before they are seen: 16 GiB of addresses.
const MOST_RESERVED: u64 = 1 << 30;

/// Why a file is not read.
enum Refusal {
    Format(FormatError),
    Data(DataError),
    Stopped,
}

impl From<FormatError> for Refusal {
    fn from(error: FormatError) -> Refusal {
        Refusal::Format(error)
    }
}

impl From<DataError> for Refusal {
    fn from(error: DataError) -> Refusal {
        Refusal::Data(error)
    }
}

impl Refusal {
    fn raised(&self, py: Python<'_>) -> PyErr {
        match self {
            Refusal::Format(error) => trouble::data(py, format!("error: {error}")),
            Refusal::Data(error) => trouble::data(py, format!("error: {error}")),
            Refusal::Stopped => trouble::of(py, 130, "interrupted"),
        }
    }
}

struct Inner {
    path: PathBuf,
    format: &'static str,
    settings: Settings,
    recording: Box<dyn Recording>,
    /// Known after one pass over all events.
    arranged: Mutex<Option<Arc<Arranged>>>,
}

/// An opened file or folder.
#[pyclass(frozen, module = "photocurrent._native")]
pub struct Source(Arc<Inner>);

impl Inner {
    fn open(path: &Path, mut settings: Settings) -> Result<Option<Inner>, Refusal> {
        let Some(format) = recognise(path)? else { return Ok(None) };
        // Recordings of ours have the clock of the engine already.
        if format.id == OWN {
            settings.zero = settings.zero.or(Some(Duration::new(0)));
        }
        let recording = joined::open(format, path, &settings.declared)?;
        Ok(Some(Inner {
            path: path.into(),
            format: format.id,
            settings,
            recording,
            arranged: Mutex::default(),
        }))
    }

    fn arranged(&self, stop: &AtomicBool) -> Result<Arc<Arranged>, Refusal> {
        let mut place = self.arranged.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(arranged) = &*place {
            return Ok(Arc::clone(arranged));
        }
        let advance = |_: &dyn EventCursor| going_on(stop);
        let found = Arc::new(arrange(&self.path, &*self.recording, &self.settings, advance)?);
        *place = Some(Arc::clone(&found));
        Ok(found)
    }

    /// Is the whole stream wanted as it is?
    fn is_plain(&self) -> bool {
        let Settings { declared, start, end, crop, .. } = &self.settings;
        let whole = start.is_none() && end.is_none() && crop.is_none();
        whole && !declared.drop_duplicates.unwrap_or(false)
    }

    /// The earliest start of a frame, where it can be known.
    fn first_frame(&self) -> Option<i64> {
        let pictures = self.recording.pictures()?;
        let (about, declared) = (pictures.about(), &self.settings.declared);
        let offset = self.settings.frame_offset.map_or(0, Duration::ns);
        // Stated exposures count from a stamp with a role: what `arrange` works out.
        if declared.exposure.is_some() || about.stamps.iter().any(|stamp| stamp.exposure.is_none()) {
            return None;
        }
        let starts = about.stamps.iter().filter_map(|stamp| stamp.exposure);
        starts.map(|(start, _)| start + offset).min()
    }

    fn events(&self, unit: Unit, stop: &AtomicBool) -> Result<Vec<Event>, Refusal> {
        let given = self.settings.zero.map(Duration::ns);
        let has_frames = self.recording.pictures().is_some();
        if !self.is_plain() || given.is_none() && has_frames && self.first_frame().is_none() {
            let arranged = self.arranged(stop)?;
            let advance = |_: &dyn EventCursor| going_on(stop);
            let read = arranged.gather::<Refusal>(&*self.recording, EVENTS_BUDGET, advance)?;
            let Some((stream, _)) = read else { return Ok(Vec::new()) };
            return Ok(events::of_band(&stream.read(stream.rows())?, unit));
        }
        let Some(about) = self.recording.events_about() else { return Ok(Vec::new()) };
        let mut all = Collected::new(about.tick_ns, unit);
        // Room that is not written to costs nothing, and a list that grows is copied again and again.
        let bytes = std::fs::metadata(&self.path).map_or(0, |metadata| metadata.len());
        all.reserve(about.count.unwrap_or(bytes).min(MOST_RESERVED) as usize);
        let (mut cursor, mut chunk) = (self.recording.events()?, EventChunk::default());
        while cursor.next(&mut chunk)? {
            going_on(stop)?;
            all.add(&chunk).map_err(too_many)?;
        }
        Ok(all.finish(given, self.first_frame()))
    }

    fn frames(&self, stop: &AtomicBool) -> Result<Option<FrameSequence>, Refusal> {
        Ok(self.arranged(stop)?.frame_sequence())
    }
}

fn too_many(error: std::collections::TryReserveError) -> DataError {
    DataError::new(format!(
        "the events do not fit into memory: {error}\n  hint: read a part of them, or chunk by chunk"
    ))
}

fn going_on(stop: &AtomicBool) -> Result<(), Refusal> {
    if stop.load(Ordering::Relaxed) { Err(Refusal::Stopped) } else { Ok(()) }
}

/// Runs `work` on an opened file in a thread that Ctrl-C stops.
fn waited<T: Send + 'static>(
    py: Python<'_>,
    inner: &Arc<Inner>,
    work: impl FnOnce(&Inner, &AtomicBool) -> Result<T, Refusal> + Send + 'static,
) -> PyResult<T> {
    let (cancel, inner) = (Arc::<AtomicBool>::default(), Arc::clone(inner));
    let stop = Arc::clone(&cancel);
    wait(py, &cancel, None, move || work(&inner, &stop))?.map_err(|refusal| refusal.raised(py))
}

#[pymethods]
impl Source {
    /// Opens a file or folder: headers and indices only. `params` are parameters of a reader's node as JSON,
    /// without its path. `None` for what is no recording.
    #[staticmethod]
    fn open(py: Python<'_>, path: PathBuf, params: &str) -> PyResult<Option<Source>> {
        let all: All =
            serde_json::from_str(params).map_err(|error| trouble::usage(py, format!("error: {error}")))?;
        let opened = py.detach(|| Inner::open(&path, all.settings()));
        let opened = opened.map_err(|refusal| refusal.raised(py))?;
        Ok(opened.map(|inner| Source(Arc::new(inner))))
    }

    /// The format's id: the node that reads it is `read/<id>`.
    #[getter]
    fn format(&self) -> &'static str {
        self.0.format
    }

    /// What is known without reading events, as JSON.
    fn about(&self) -> String {
        let events = self.0.recording.events_about().map(|about| {
            json!({
                "width": about.extent.map(|extent| extent.width),
                "height": about.extent.map(|extent| extent.height),
                "count": about.count, "tick_ns": about.tick_ns, "notes": about.notes,
            })
        });
        let frames = self.0.recording.pictures().map(|pictures| {
            let about = pictures.about();
            json!({
                "width": about.extent.width, "height": about.extent.height, "count": about.stamps.len(),
                "colour": about.colour.name(), "bits": about.bits, "notes": about.notes,
            })
        });
        json!({
            "format": self.0.format, "events": events, "frames": frames, "facts": self.0.recording.facts(),
        })
        .to_string()
    }

    /// The sensor description that travels with the file, TOML.
    fn sensor_text(&self) -> Option<String> {
        self.0.recording.sensor_text().map(str::to_owned)
    }

    /// Width and height of the array of event pixels, or of the frames without events; reads all events once
    /// where the file does not state it.
    fn extent(&self, py: Python<'_>) -> PyResult<(u32, u32)> {
        let crop = self.0.settings.crop.map(|crop| (crop.width, crop.height));
        let stated = self.0.settings.declared.extent;
        let stated = stated.or(self.0.recording.events_about().and_then(|about| about.extent));
        if let Some(size) = crop.or(stated.map(|extent| (extent.width, extent.height))) {
            return Ok(size);
        }
        let size = |inner: &Inner, stop: &AtomicBool| {
            let arranged = inner.arranged(stop)?;
            let extent = arranged.events.as_ref().map(|events| events.extent);
            let extent = extent.or(arranged.frames.as_ref().map(|frames| frames.extent));
            extent.map_err(|why| DataError::new(why.clone()).into())
        };
        let extent = waited(py, &self.0, size)?;
        Ok((extent.width, extent.height))
    }

    /// All events in the order of time.
    fn events<'py>(&self, py: Python<'py>, unit: &str) -> PyResult<Bound<'py, PyArray1<Event>>> {
        let unit = Unit::named(unit).ok_or_else(|| trouble::usage(py, "error: unit is \"us\" or \"ns\""))?;
        let all = waited(py, &self.0, move |inner, stop| inner.events(unit, stop))?;
        Ok(events::array(py, all))
    }

    /// The events in pieces, in the order of time; memory does not grow with the file.
    fn chunks(&self, py: Python<'_>, events: usize, unit: &str) -> PyResult<Chunks> {
        let unit = Unit::named(unit).ok_or_else(|| trouble::usage(py, "error: unit is \"us\" or \"ns\""))?;
        let cursor = waited(py, &self.0, |inner, stop| {
            let arranged = inner.arranged(stop)?;
            arranged.events.as_ref().map_err(|why| DataError::new(why.clone()))?;
            Ok(arranged.cursor(&*inner.recording, true)?)
        })?;
        let state = State { cursor, rest: Vec::new(), ended: false };
        Ok(Chunks { state: Mutex::new(state), events: events.max(1), unit })
    }

    /// Number of frames in the window.
    fn frame_count(&self, py: Python<'_>) -> PyResult<usize> {
        Ok(waited(py, &self.0, |inner, stop| inner.frames(stop))?.map_or(0, |frames| frames.len()))
    }

    /// Some frames as [frame][y][x] or [frame][y][x][channel], linear DN.
    fn frames<'py>(
        &self,
        py: Python<'py>,
        start: usize,
        stop: usize,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let frames = self.sequence(py)?;
        frames_array(py, &frames, start..stop.min(frames.len()))
    }

    /// Start and end of the exposure of row 0 of every frame, and the delay from row to row, ns.
    fn times<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyArray2<i64>>, i64)> {
        let (exposures, row_time_ns, _) = times(py, &self.sequence(py)?)?;
        Ok((exposures, row_time_ns))
    }

    /// What was done to bring the file onto one clock, and what of it is damaged; reads all events once.
    fn notes(&self, py: Python<'_>) -> PyResult<(Vec<String>, Vec<String>)> {
        waited(py, &self.0, |inner, stop| {
            let arranged = inner.arranged(stop)?;
            let counts =
                arranged.counts.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}"));
            let losses = arranged.losses.iter().map(|loss| format!("{}: {}", loss.at, loss.what));
            Ok((arranged.notes.iter().cloned().chain(counts).collect(), losses.collect()))
        })
    }
}

impl Source {
    fn sequence(&self, py: Python<'_>) -> PyResult<FrameSequence> {
        let frames = waited(py, &self.0, |inner, stop| inner.frames(stop))?;
        frames.ok_or_else(|| {
            trouble::data(py, format!("error: {}: there are no frames in it", self.0.path.display()))
        })
    }
}

/// Where a walk over events stands.
struct State {
    cursor: Box<dyn EventCursor>,
    rest: Vec<Event>,
    ended: bool,
}

/// Events in pieces.
#[pyclass(frozen, module = "photocurrent._native")]
pub struct Chunks {
    state: Mutex<State>,
    events: usize,
    unit: Unit,
}

#[pymethods]
impl Chunks {
    fn __iter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    fn __next__<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray1<Event>>>> {
        let next = py.detach(|| -> Result<Vec<Event>, FormatError> {
            let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            let State { cursor, rest, ended } = &mut *state;
            let mut chunk = EventChunk::default();
            while rest.len() < self.events && !*ended {
                *ended = !cursor.next(&mut chunk)?;
                events::add(&chunk, self.unit, rest);
            }
            let left = rest.split_off(self.events.min(rest.len()));
            Ok(std::mem::replace(rest, left))
        });
        let piece = next.map_err(|error| Refusal::from(error).raised(py))?;
        Ok((!piece.is_empty()).then(|| events::array(py, piece)))
    }
}
