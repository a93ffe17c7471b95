//! Recordings: the HDF5 file in which data come from outside, `photocurrent-recording/1`.
//!
//! Opening reads the header only. Events stand in the file by time, and come out by row band: a read scans
//! the file in blocks of bounded memory and keeps the rows asked for. The first scan also checks every event,
//! so that a mistake is reported the same way whichever band is read first. Frames are read lazily by frames
//! and rows.
//!
//! Either stream may be missing, or be there with nothing in it. NaN in a frame is data: a value that is not
//! known. Frames have the extent of the events or a whole multiple of it: then several frame pixels lie on
//! each event pixel.

mod by_time;
mod checked;
mod events;
mod file;
mod frames;
mod inspect;
mod rendered;
pub(crate) mod whole;
mod write;

pub use checked::FORMAT;
pub use file::{Recording, format_attribute};
pub use inspect::{EventsSummary, FramesSummary, Inspection, Spread, TruthSummary};
pub use rendered::write_rendered;
pub use whole::{DnCode, unnamed_in};
pub use write::{DnType, RecordingContent, write_recording};
