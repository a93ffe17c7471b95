//! The vocabulary of photocurrent: what every other crate agrees on.
//!
//! Nothing here opens a file or starts a thread. In reading order:
//!
//! - [`time`], [`extent`], [`quantity`]: instants in nanoseconds, pixels and rows, values with units.
//! - [`apart`]: events and frames whose clocks were never put together.
//! - [`coverage`]: which parts of a recording's time have frames near.
//! - [`colour`]: grey, three channels, or a mosaic of filters.
//! - [`events`], [`frames`], [`tracks`], [`light`], [`map`], [`table`], [`sensor`], [`diagnosis`]: the data, each with one
//!   canonical order.
//! - [`lacking`]: what to report of fields that a sensor description does not state.
//! - [`value`]: the closed set of things that flow between nodes, and [`value::Meta`], what is known of them before data.
//! - [`node`], [`ports`], [`context`]: what a node is, what its sockets are, what it may ask while it runs.
//! - [`digest`]: the name of a content. [`random`]: numbers that depend on (seed, pixel, index) only.
//! - [`document`], [`schema`]: TOML with its positions kept, so that a mistake can be shown where it stands.
//! - [`testing`]: small helpers that the tests of several crates share.

pub mod apart;
pub mod colour;
pub mod context;
pub mod coverage;
pub mod diagnosis;
pub mod digest;
pub mod document;
pub mod error;
pub mod events;
pub mod extent;
pub mod frames;
pub mod handle;
pub mod in_time;
pub mod lacking;
pub mod light;
pub mod map;
mod moved;
pub mod node;
pub mod ports;
pub mod quantity;
pub mod random;
pub mod schema;
pub mod sensor;
pub mod series;
pub mod table;
pub mod testing;
pub mod time;
pub mod tracks;
pub mod value;

pub use apart::Apart;
pub use colour::Colour;
pub use context::{Context, Notes};
pub use coverage::Coverage;
pub use diagnosis::{Diagnosis, DiagnosisKind, DiagnosisMeta};
pub use digest::Digest;
pub use error::{DataError, NodeError};
pub use events::{EventBand, EventStream, EventsMeta, Polarity};
pub use extent::{Extent, Rows};
pub use frames::{FrameBlock, FrameScale, FrameSequence, FrameTimes, FramesMeta, Truth};
pub use light::{Light, LightBand, LightMeta};
pub use map::{MapBand, MapMeta, MapSet};
pub use node::{Catalogue, Decl, FileRef, Grain, Kind, Node};
pub use ports::{PortMetas, PortValues, Ports};
pub use sensor::Sensor;
pub use table::Table;
pub use time::{Exposure, TimeSpan, Timestamp};
pub use tracks::{Between, TrackBand, TrackSet, TracksMeta};
pub use value::{DataType, Meta, Value};
