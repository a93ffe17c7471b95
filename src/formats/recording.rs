//! What an opened file gives.

use crate::chunk::{EventChunk, Trigger};
use crate::declared::{StampRole, Transfer};
use crate::error::{FormatError, Loss};
use photocurrent_core::{Colour, Extent};
use serde::Serialize;
use std::path::PathBuf;
use std::sync::Arc;

/// An opened file or folder. Opening reads headers and indices, not events.
pub trait Recording: Send + Sync {
    /// What is known of the events before they are read; `None` without an event stream.
    fn events_about(&self) -> Option<&EventsAbout>;

    /// A fresh cursor at the first event. Several may be open at once.
    ///
    /// # Errors
    /// When there is no event stream, or the file has gone.
    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError>;

    /// The frames; `None` without any.
    fn pictures(&self) -> Option<Arc<dyn Pictures>> {
        None
    }

    /// Edges of trigger lines, in file order. Formats that interleave them with events read the whole file
    /// for this.
    ///
    /// # Errors
    /// When the file cannot be read.
    fn triggers(&self) -> Result<Vec<Trigger>, FormatError> {
        Ok(Vec::new())
    }

    /// The sensor description that travels with the file: its source for messages, and TOML text.
    fn sensor_text(&self) -> Option<&str> {
        None
    }

    /// What else the file says, for people: ("camera", "DAVIS346 serial 00000336"). In reading order.
    fn facts(&self) -> Vec<(String, String)> {
        Vec::new()
    }

    /// Unusual ways of storing events that were recognised over the whole file, each also a note of
    /// [`Recording::events_about`].
    fn conventions(&self) -> Vec<Convention> {
        Vec::new()
    }

    /// What was found damaged while opening.
    fn losses(&self) -> Vec<Loss> {
        Vec::new()
    }

    /// All files whose content decides what is read: the file itself, or the files of a folder.
    fn files(&self) -> Vec<PathBuf>;
}

/// What a recording that changes another one's events or frames passes on from the field that holds it:
/// description, facts, conventions, and, unless it has its own, losses and files.
macro_rules! forward {
    ($field:ident) => {
        $crate::recording::forward!($field, without losses and files);

        fn losses(&self) -> Vec<$crate::error::Loss> {
            self.$field.losses()
        }

        fn files(&self) -> Vec<std::path::PathBuf> {
            self.$field.files()
        }
    };
    ($field:ident, without losses and files) => {
        fn sensor_text(&self) -> Option<&str> {
            self.$field.sensor_text()
        }

        fn facts(&self) -> Vec<(String, String)> {
            self.$field.facts()
        }

        fn conventions(&self) -> Vec<$crate::recording::Convention> {
            self.$field.conventions()
        }
    };
}
pub(crate) use forward;

/// What a cursor that changes another one's events passes on from the field that holds it.
macro_rules! forward_cursor {
    ($field:ident) => {
        fn losses(&self) -> Vec<$crate::error::Loss> {
            self.$field.losses()
        }

        fn position(&self) -> (u64, u64) {
            self.$field.position()
        }
    };
}
pub(crate) use forward_cursor;

/// An unusual way of storing that was recognised.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Convention {
    /// Short and stable: `polarity_counts`.
    pub id: &'static str,
    /// What is stored, and how it was read.
    pub what: String,
    /// The numbers behind it.
    pub evidence: String,
    /// How to state it otherwise.
    pub otherwise: String,
}

/// What is known of an event stream before it is read.
#[derive(Clone, Debug, PartialEq)]
pub struct EventsAbout {
    /// Size of the pixel array, when the file states it (or the user did).
    pub extent: Option<Extent>,
    /// Step of the stored stamps, ns: 1000 for microseconds.
    pub tick_ns: i64,
    /// How many, when the file says so without being read.
    pub count: Option<u64>,
    /// Does every event have its in-pixel time?
    pub has_t_in: bool,
    /// How stamps are stored, for people: "u64 microseconds", "f64 seconds".
    pub stamps: String,
    /// What the reader did to give whole pixels, nanoseconds and 0/1: "coordinates divided by 32", "t_offset
    /// of 1234 us added".
    pub notes: Vec<String>,
}

/// The note that one camera of several was read: "events are those of left; not read: right (`camera`
/// chooses)".
pub(crate) fn not_read(what: &str, chosen: &str, others: &[&str], field: &str) -> String {
    format!("{what} are those of {chosen}; not read: {} (`{field}` chooses)", others.join(", "))
}

/// Walks through events in file order.
pub trait EventCursor: Send {
    /// Clears `chunk` and fills it with the next events, about [`crate::chunk::CHUNK_EVENTS`] of them. False,
    /// and an empty chunk, at the end. A chunk may be empty before the end.
    ///
    /// # Errors
    /// When the file cannot be read any more (vanished, an input error). Damaged content is no error: see
    /// [`EventCursor::losses`].
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError>;

    /// Moves so that no event stamped at or after `t_ns` is left out: to the first of them, or to some event
    /// before. Cheap only where the format allows random access; otherwise back to the first event.
    ///
    /// # Errors
    /// As [`EventCursor::next`].
    fn seek(&mut self, t_ns: i64) -> Result<(), FormatError>;

    /// What was left out so far because it was damaged, as [`crate::losses::Losses`] lists it.
    fn losses(&self) -> Vec<Loss>;

    /// Where in the file the cursor stands, of how much in all, in one unit: bytes, events. For progress.
    fn position(&self) -> (u64, u64);
}

/// What is known of frames before their values.
#[derive(Clone, Debug, PartialEq)]
pub struct FramesAbout {
    /// Size in pixels.
    pub extent: Extent,
    /// Colours.
    pub colour: Colour,
    /// Bits of a stored value: 8, 10, 16; 32 for floats.
    pub bits: u32,
    /// Stamps of every frame, in file order.
    pub stamps: Vec<FrameStamp>,
    /// What the one stamp of a frame means; `None` when the file does not say.
    pub stamp_role: Option<StampRole>,
    /// Delay from one row to the next, ns; `None` when the file does not say.
    pub row_time_ns: Option<i64>,
    /// How stored values follow from linear ones; `None` when the file does not say.
    pub transfer: Option<Transfer>,
    /// What the reader did or left out: "2 pictures have no stamp and were left out".
    pub notes: Vec<String>,
}

/// When a frame was taken, ns on the file's own clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameStamp {
    /// Its plain stamp, with the meaning of [`FramesAbout::stamp_role`].
    pub at: i64,
    /// Start and end of the exposure of row 0, when the file has both.
    pub exposure: Option<(i64, i64)>,
}

/// Frames by index.
pub trait Pictures: Send + Sync {
    /// What is known of them.
    fn about(&self) -> &FramesAbout;

    /// Replaces `values` by the stored values of one frame, row by row, channels side by side (red, green,
    /// blue).
    ///
    /// # Errors
    /// When the frame cannot be read or is damaged.
    fn read(&self, frame: usize, values: &mut Vec<f32>) -> Result<(), FormatError>;
}
