//! Where data live on disk: recordings that come from outside, artefacts that the tool makes, and the cache
//! that names them.
//!
//! - [`recording`]: the documented HDF5 recording, `photocurrent-recording/1`; read by row band, checked
//!   while reading.
//! - [`stream`]: recordings and DSEC's layout, written as the events come.
//! - `layout`: one HDF5 layout per type of value, `photocurrent-artefact/1`; written band by band, read
//!   lazily.
//! - `cache`: key -> record -> content, safe for several processes and for a kill at any moment.
//! - [`foreign`]: HDF5 files of other programs, looked at and read with care.
//! - `error`: the one error type of this crate.
//!
//! This is the only crate that names HDF5. Files from outside are not trusted: a copy of this process tries
//! them first, as libhdf5 itself may crash on them; links to other files, external and virtual storage and
//! filter plugins are refused, and a claim about size is compared with the file before memory is taken
//! (`hdf`).
//!
//! ```
//! use photocurrent_core::{EventStream, Extent, testing};
//! use photocurrent_store::{Recording, RecordingContent, write_recording};
//! let folder = tempfile::tempdir().unwrap();
//! let events: EventStream = testing::events(8, 6);
//! let path = folder.path().join("recording.h5");
//! let content = RecordingContent {
//!     events: Some(&events), ..RecordingContent::empty(Extent { width: 8, height: 6 })
//! };
//! let count = write_recording(&path, &content).unwrap();
//! let recording = Recording::open(&path).unwrap();
//! assert_eq!((recording.event_count(), recording.exposures()), (count, None));
//! let rows = events.rows();
//! assert_eq!(recording.read_events(rows).unwrap(), events.read(rows).unwrap());
//! ```

#![cfg_attr(not(test), warn(unreachable_pub))]

mod cache;
mod error;
pub mod foreign;
mod hdf;
mod layout;
pub mod recording;
pub mod stream;
mod threads;

pub use cache::{
    Arrivals, BandStore, Cache, CacheWriter, CheckReport, DiskUse, Export, FileInput, GcOptions, GcReport,
    Ingredients, KeptBand, Listing, Lookup, Params, Placed, PortInput, Record, StoredOutput,
};
pub use error::StoreError;
pub use layout::{ValueWriter, open_value};
pub use recording::{
    DnCode, DnType, Inspection, Recording, RecordingContent, format_attribute, unnamed_in, write_recording,
    write_rendered,
};

/// The version that is written into every file and record.
pub const TOOL_VERSION: &str = env!("CARGO_PKG_VERSION");
