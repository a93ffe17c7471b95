//! The cache: key -> record -> content, safe for several processes on one folder and for a kill at any
//! moment.
//!
//! ```text
//! keys/<key>.toml       a Record: ingredients in clear text, port -> digest
//! data/<digest>.h5      a value (see `layout`), named by its content
//! data/<digest>.sum     length and BLAKE3 of that file's bytes
//! files/<name>.toml     digests of outside files, remembered by size, inode and times
//! history/<name>.toml   which key a node had in the last run of a pipeline
//! bands/                row bands of results that are not complete (see `bands`)
//! tmp/                  what is being written
//! lock  commit.lock     shared by every run, exclusive for `gc`; exclusive for the moment of placing data
//! ```
//!
//! The order of steps makes every moment consistent: data is placed before the record that names it, and gc
//! removes records before data. A damaged entry counts as missing: the node runs again and its output
//! replaces the entry.

mod arrive;
mod bands;
mod content;
mod files;
mod folder;
mod keep;
mod memory;
mod record;

pub use arrive::{Arrivals, Placed};
pub use bands::{BandStore, KeptBand};
pub use content::CacheWriter;
pub use folder::{Cache, Lookup};
pub use keep::{CheckReport, DiskUse, GcOptions, GcReport, Listing};
pub use record::{Export, FileInput, Ingredients, Params, PortInput, Record, StoredOutput};
