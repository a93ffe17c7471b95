//! The vocabulary of photocurrent: what every other crate agrees on.
//!
//! Nothing here opens a file or starts a thread. In reading order:
//!
//! - [`time`], [`extent`], [`quantity`]: instants in nanoseconds, pixels and rows, values with units.
//! - [`colour`]: grey, three channels, or a mosaic of filters.
//! - [`sensor`]: the sensor description. [`error`]: what can go wrong. [`document`]: texts with their
//!   positions kept, so that a mistake can be shown where it stands.
//! - [`random`]: numbers that depend on (seed, pixel, index) only.
//!
//! With the feature `data`, recordings and results in memory:
//!
//! - [`events`], [`frames`], [`tracks`], [`light`], [`map`], [`table`], `diagnosis`: the data, each with one
//!   canonical order. [`handle`]: data read by row band. [`digest`]: the name of a content.
//! - `apart`: events and frames whose clocks were never put together. `coverage`: which parts of a
//!   recording's time have frames near.
//! - [`context`]: what a node may use while it runs.
//!
//! With the feature `graph`, which is on by default and includes `data`:
//!
//! - [`value`]: the closed set of things that flow between nodes, and [`Meta`], what is known of them before
//!   data.
//! - [`node`], [`ports`]: what a node is, what its sockets are.
//! - [`schema`]: documents checked against parameter structs. [`lacking`]: fields that a sensor description
//!   does not state.
//! - [`testing`]: small helpers that the tests of several crates share.
//!
//! ```
//! use photocurrent_core::quantity::Duration;
//! let exposure: Duration = "2.5 ms".parse().unwrap();
//! assert_eq!((exposure.ns(), exposure.to_string()), (2_500_000, "2500 us".into()));
//! let error = "2.5".parse::<Duration>().unwrap_err().to_string();
//! assert!(error.starts_with("`2.5` has no unit"));
//! ```

#![cfg_attr(not(test), warn(unreachable_pub))]

#[cfg(feature = "data")]
mod apart;
pub mod colour;
#[cfg(feature = "data")]
pub mod context;
#[cfg(feature = "data")]
mod coverage;
mod data_type;
#[cfg(feature = "data")]
mod diagnosis;
#[cfg(feature = "data")]
pub mod digest;
pub mod document;
pub mod error;
#[cfg(feature = "data")]
pub mod events;
pub mod extent;
#[cfg(feature = "data")]
pub mod frames;
#[cfg(feature = "data")]
pub mod handle;
#[cfg(feature = "graph")]
pub mod lacking;
#[cfg(feature = "data")]
pub mod light;
#[cfg(feature = "data")]
pub mod map;
#[cfg(feature = "graph")]
mod moved;
#[cfg(feature = "graph")]
pub mod node;
#[cfg(feature = "data")]
mod offsets;
#[cfg(feature = "graph")]
pub mod ports;
pub mod quantity;
pub mod random;
mod ranges;
#[cfg(feature = "graph")]
pub mod schema;
pub mod sensor;
#[cfg(feature = "data")]
pub mod series;
#[cfg(feature = "data")]
pub mod table;
#[cfg(feature = "graph")]
pub mod testing;
pub mod time;
#[cfg(feature = "data")]
pub mod tracks;
#[cfg(feature = "graph")]
pub mod value;
#[cfg(feature = "graph")]
mod windows;

#[cfg(feature = "data")]
pub use apart::Apart;
pub use colour::Colour;
#[cfg(feature = "data")]
pub use context::{Context, Notes};
#[cfg(feature = "data")]
pub use coverage::Coverage;
pub use data_type::DataType;
#[cfg(feature = "data")]
pub use diagnosis::{Diagnosis, DiagnosisKind, DiagnosisMeta};
#[cfg(feature = "data")]
pub use digest::Digest;
pub use error::{DataError, NodeError};
#[cfg(feature = "data")]
pub use events::{EventBand, EventStream, EventsMeta, Polarity};
pub use extent::{Extent, Rows};
#[cfg(feature = "data")]
pub use frames::{FrameBlock, FrameScale, FrameSequence, FrameTimes, FramesMeta, Truth};
#[cfg(feature = "data")]
pub use light::{Light, LightBand, LightMeta};
#[cfg(feature = "data")]
pub use map::{MapBand, MapMeta, MapSet};
#[cfg(feature = "graph")]
pub use node::{Catalogue, Decl, FileRef, Grain, Kind, Node};
#[cfg(feature = "graph")]
pub use ports::{PortMetas, PortValues, Ports};
pub use sensor::Sensor;
#[cfg(feature = "data")]
pub use table::Table;
pub use time::{Exposure, TimeSpan, Timestamp};
#[cfg(feature = "data")]
pub use tracks::{Between, TrackBand, TrackSet, TracksMeta};
#[cfg(feature = "graph")]
pub use value::{Meta, Value};
