//! Any recording written in the layout of DSEC, or its events into our own recording: a piece at a time.

use super::refused;
use crate::chunk::EventChunk;
use crate::error::{FormatError, Loss};
use crate::recording::EventCursor;
use photocurrent_core::{DataError, Extent};
use photocurrent_store::StoreError;
use photocurrent_store::stream::{EventPiece, EventSink, StreamedRecording, stream_recording};
use std::path::Path;

/// What was written, and what of it was not as it was read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Written {
    /// Events.
    pub events: u64,
    /// What the layout could not hold: "in-pixel times were left out".
    pub notes: Vec<String>,
    /// What was damaged in the file that was read.
    pub losses: Vec<Loss>,
}

/// Writes events in the layout of DSEC. `extent` is the sensor's size.
///
/// # Errors
/// When the events cannot be read, are not in the order of time, lie outside the sensor, or last longer than
/// the layout can say.
pub fn write_dsec(
    path: &Path,
    cursor: &mut dyn EventCursor,
    extent: Extent,
    has_t_in: bool,
) -> Result<Written, FormatError> {
    let written = photocurrent_store::stream::write_dsec(path, extent, |sink| pour(cursor, sink))
        .map_err(|error| refused(path, error))?;
    let mut notes = Vec::new();
    if written.rounded > 0 {
        notes.push(format!("{} stamps were rounded to whole microseconds", written.rounded));
    }
    if has_t_in {
        notes.push("in-pixel times were left out: this layout has no place for them".into());
    }
    Ok(Written { events: written.events, notes, losses: cursor.losses() })
}

/// Writes our own recording: events, when `content` says that there are any, and what else it says.
///
/// # Errors
/// When the events cannot be read, are not in the order of time, or lie outside the sensor; when a frame
/// cannot be read.
pub fn write_recording(
    path: &Path,
    cursor: Option<&mut dyn EventCursor>,
    content: &StreamedRecording,
) -> Result<Written, FormatError> {
    let mut losses = Vec::new();
    let fill = |sink: &mut EventSink| match cursor {
        None => Ok(()),
        Some(cursor) => {
            pour(cursor, sink)?;
            losses = cursor.losses();
            Ok(())
        }
    };
    let events = stream_recording(path, content, fill).map_err(|error| refused(path, error))?;
    Ok(Written { events, notes: Vec::new(), losses })
}

fn pour(cursor: &mut dyn EventCursor, sink: &mut EventSink) -> Result<(), StoreError> {
    let mut chunk = EventChunk::default();
    while cursor.next(&mut chunk).map_err(|error| StoreError::Source(DataError::from(error)))? {
        sink.append(EventPiece {
            t: &chunk.t,
            x: &chunk.x,
            y: &chunk.y,
            on: &chunk.on,
            t_in: chunk.t_in.as_deref(),
        })?;
    }
    Ok(())
}
