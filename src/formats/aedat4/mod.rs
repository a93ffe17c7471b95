//! AEDAT4: recordings of DVS and DAVIS cameras (DV, dv-processing).
//!
//! A file is a header with a list of streams, and a chain of packets, each compressed, each of one stream;
//! behind them usually a table of all packets. Events, frames and triggers are read; samples of the inertial
//! sensor are left. Stamps are microseconds of the camera's clock. A file that is cut off, or damaged in
//! places, gives every packet that is whole.
//!
//! Source: the AEDAT 4.0 pages of iniVation and its FlatBuffers schemas (`IOHE`, `EVTS`, `FRME`, `TRIG`,
//! `FTAB`).
//!
//! Limits: one stream of events and one of frames are read, those with the lowest numbers or those that were
//! named. Frames of another size or type than the first (regions of interest) are left out. Whether values of
//! frames are linear, and when which row was exposed, the file does not say.

mod chain;
mod decompress;
mod events;
mod flat;
mod frames;
mod header;
mod index;
#[doc(hidden)]
pub mod made;
mod shared;
#[cfg(test)]
mod tests;
mod triggers;

use crate::chunk::Trigger;
use crate::declared::Declared;
use crate::error::{FormatError, Loss};
use crate::format::{Format, Probe};
use crate::losses::Losses;
use crate::recording::{EventCursor, EventsAbout, Pictures, Recording};
use chain::Chain;
use frames::Frames;
use header::{Content, Header, Stream};
use index::{Index, Wanted};
use photocurrent_core::Extent;
use shared::Inner;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use triggers::Triggers;

/// AEDAT4.
pub static FORMAT: Format = Format { id: "aedat4", name: "AEDAT4 (DV)", recognises, open };

fn recognises(probe: &Probe) -> bool {
    probe.head.starts_with(b"#!AER-DAT4.")
}

fn open(path: &Path, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    Ok(Box::new(Aedat4::open(path, declared)?))
}

/// An opened file.
pub struct Aedat4 {
    inner: Arc<Inner>,
    about: Option<EventsAbout>,
    events: Option<(Stream, Extent)>,
    frames: Option<Stream>,
    frame_notes: Vec<String>,
    losses: Losses,
    pictures: OnceLock<(Option<Arc<Frames>>, Vec<Loss>)>,
    triggers: OnceLock<Result<Triggers, FormatError>>,
}

impl Aedat4 {
    /// Reads the header, and finds the packets.
    ///
    /// # Errors
    /// When it is no AEDAT4 file, its header is damaged, or a stream that was named is not there.
    pub fn open(path: &Path, declared: &Declared) -> Result<Aedat4, FormatError> {
        let header = Header::read(path)?;
        let (events, other_events) =
            header.choose(path, Content::Events, declared.camera.as_deref(), "camera")?;
        let (frames, other_frames) =
            header.choose(path, Content::Frames, declared.frame_camera.as_deref(), "frame_camera")?;
        let (events, frames) = (events.cloned(), frames.cloned());
        let mut about = None;
        let mut chosen = None;
        if let Some(stream) = &events {
            let mut notes: Vec<String> = other_events.into_iter().collect();
            let extent = match (declared.extent, stream.extent) {
                (Some(declared), Some(stated)) if declared != stated => {
                    notes.push(format!("the extent is declared as {declared}; the file states {stated}"));
                    declared
                }
                (Some(extent), _) | (None, Some(extent)) => extent,
                (None, None) => {
                    let error = FormatError::new(
                        path,
                        "the header does not state the size of the pixel array",
                        "state its extent, such as 346 x 260",
                    );
                    return Err(error.undeclared("extent"));
                }
            };
            about = Some(EventsAbout {
                extent: Some(extent),
                tick_ns: 1000,
                count: None,
                has_t_in: false,
                stamps: "i64 microseconds".into(),
                notes,
            });
            chosen = Some((stream.clone(), extent));
        }
        let mut losses = Losses::default();
        let triggers =
            header.streams.iter().find(|stream| stream.content == Content::Triggers).map(|stream| stream.id);
        let wanted = Wanted {
            events: events.map(|stream| stream.id),
            frames: frames.as_ref().map(|stream| stream.id),
            triggers,
        };
        let header = Arc::new(header);
        let index = Index::new(path, &header, wanted, &mut losses)?;
        if let Some(about) = &mut about {
            about.count = index.events;
        }
        let inner = Arc::new(Inner { path: path.into(), header, index, marks: OnceLock::new() });
        let frame_notes = other_frames.into_iter().collect();
        let (pictures, triggers) = (OnceLock::new(), OnceLock::new());
        Ok(Aedat4 { inner, about, events: chosen, frames, frame_notes, losses, pictures, triggers })
    }

    /// The frames, and what was damaged of them. They are looked at when they are first asked for.
    fn frames(&self) -> &(Option<Arc<Frames>>, Vec<Loss>) {
        self.pictures.get_or_init(|| {
            let Some(stream) = &self.frames else { return (None, Vec::new()) };
            match Frames::new(&self.inner, stream.extent, self.frame_notes.clone()) {
                Ok((frames, losses)) => (frames.map(Arc::new), losses),
                Err(error) => (None, vec![Loss::new("all frames", error.found)]),
            }
        })
    }

    /// The trigger signals, when the file has a stream of them.
    fn trigger_signals(&self) -> Option<&Result<Triggers, FormatError>> {
        let stream = self.inner.header.streams.iter().find(|stream| stream.content == Content::Triggers)?.id;
        Some(self.triggers.get_or_init(|| Triggers::new(&self.inner, stream)))
    }

    /// The stamp of the first event, us.
    fn first_stamp_us(&self) -> Option<i64> {
        let (stream, _) = self.events.as_ref()?;
        let mut chain =
            Chain::new(&self.inner.path, &self.inner.header, self.inner.index.end, 1 << 12).ok()?;
        let mut losses = Losses::default();
        while let Some(packet) = chain.next(&mut losses).ok()? {
            if packet.stream == stream.id
                && chain.load(&packet, usize::MAX, &mut losses).ok()?
                && let Some(first) =
                    index::elements(chain.content()).and_then(|events| events.first_chunk::<8>())
            {
                return Some(i64::from_le_bytes(*first));
            }
        }
        None
    }
}

impl Recording for Aedat4 {
    fn events_about(&self) -> Option<&EventsAbout> {
        self.about.as_ref()
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        let (stream, extent) = self.events.as_ref().ok_or_else(|| {
            let streams: Vec<String> = self.inner.header.streams.iter().map(Stream::describe).collect();
            FormatError::new(
                &self.inner.path,
                "the file has no event stream",
                format!("it has these streams: {}", streams.join("; ")),
            )
        })?;
        Ok(Box::new(events::Cursor::new(&self.inner, stream.id, *extent)?))
    }

    fn pictures(&self) -> Option<Arc<dyn Pictures>> {
        self.frames().0.clone().map(|frames| frames as Arc<dyn Pictures>)
    }

    fn triggers(&self) -> Result<Vec<Trigger>, FormatError> {
        match self.trigger_signals() {
            None => Ok(Vec::new()),
            Some(Ok(signals)) => Ok(signals.edges.clone()),
            Some(Err(error)) => Err(error.clone()),
        }
    }

    fn facts(&self) -> Vec<(String, String)> {
        let header = &self.inner.header;
        let mut facts: Vec<(String, String)> = Vec::new();
        let mut add = |name: &str, what: String| facts.push((name.into(), what));
        let of_events = self.events.as_ref().and_then(|(stream, _)| stream.source.clone());
        if let Some(source) =
            of_events.or_else(|| header.streams.iter().find_map(|stream| stream.source.clone()))
        {
            // Recorders write model and serial number with an underscore between.
            match source.split_once('_') {
                Some((model, serial)) if serial.chars().all(|letter| letter.is_ascii_digit()) => {
                    add("camera", format!("{model} serial {serial}"))
                }
                _ => add("camera", source),
            }
        }
        add("streams", header.streams.iter().map(Stream::describe).collect::<Vec<_>>().join("; "));
        add("compression", header.compression.name().into());
        add("packets", self.inner.index.packets.to_string());
        add("data table", if self.inner.index.has_table { "whole" } else { "none" }.into());
        if let Some(first) = self.first_stamp_us() {
            add("first event", format!("{first} us on the camera's clock"));
        }
        if let Some(Ok(signals)) = self.trigger_signals()
            && let Some(what) = signals.describe()
        {
            add("trigger signals", what);
        }
        facts
    }

    fn losses(&self) -> Vec<Loss> {
        let mut losses = self.losses.list();
        losses.extend(self.frames().1.iter().cloned());
        if let Some(Ok(signals)) = self.triggers.get() {
            losses.extend(signals.losses.list());
        }
        losses
    }

    fn files(&self) -> Vec<PathBuf> {
        vec![self.inner.path.clone()]
    }
}
