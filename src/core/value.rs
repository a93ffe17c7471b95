//! The closed set of things that flow between nodes, and what is known of them before they exist.

use crate::data_type::DataType;
use crate::diagnosis::{Diagnosis, DiagnosisMeta};
use crate::digest::{Digest, DigestBuilder};
use crate::error::DataError;
use crate::events::{EventStream, EventsMeta};
use crate::extent::Rows;
use crate::frames::{FrameSequence, FramesMeta, Truth};
use crate::handle::{Band, BandMeta, Handle};
use crate::light::{Light, LightMeta};
use crate::map::{MapMeta, MapSet};
use crate::sensor::Sensor;
use crate::table::{Table, TableMeta};
use crate::tracks::{TrackSet, TracksMeta};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Arc;

/// What is known about a value before its data exist.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Meta {
    /// Of an event stream.
    Events(Arc<EventsMeta>),
    /// Of frames.
    Frames(Arc<FramesMeta>),
    /// Of true frames.
    Truth(Arc<FramesMeta>),
    /// Of tracks.
    Tracks(Arc<TracksMeta>),
    /// Of light.
    Light(Arc<LightMeta>),
    /// The sensor description itself: planning needs what it states.
    Sensor(Arc<Sensor>),
    /// Of planes.
    Map(Arc<MapMeta>),
    /// Of a table.
    Table(Arc<TableMeta>),
    /// Of a stage's document.
    Diagnosis(Arc<DiagnosisMeta>),
    /// There will be nothing at this port, and why: "the recording has no frames".
    Absent {
        /// Of which type it would have been.
        data_type: DataType,
        /// The reason.
        why: String,
    },
}

impl Meta {
    /// The type of the value.
    pub fn data_type(&self) -> DataType {
        match self {
            Meta::Events(_) => DataType::Events,
            Meta::Frames(_) => DataType::Frames,
            Meta::Truth(_) => DataType::Truth,
            Meta::Tracks(_) => DataType::Tracks,
            Meta::Light(_) => DataType::Light,
            Meta::Sensor(_) => DataType::Sensor,
            Meta::Map(_) => DataType::Map,
            Meta::Table(_) => DataType::Table,
            Meta::Diagnosis(_) => DataType::Diagnosis,
            Meta::Absent { data_type, .. } => *data_type,
        }
    }

    /// Rows of the sensor that the value covers; `None` for what is not banded.
    pub fn rows(&self) -> Option<Rows> {
        match self {
            Meta::Events(meta) => Some(meta.extent.rows()),
            Meta::Frames(meta) | Meta::Truth(meta) => Some(meta.extent.rows()),
            Meta::Tracks(meta) => Some(meta.extent.rows()),
            Meta::Light(meta) => Some(meta.extent.rows()),
            Meta::Map(meta) => Some(meta.extent.rows()),
            Meta::Sensor(_) | Meta::Table(_) | Meta::Diagnosis(_) | Meta::Absent { .. } => None,
        }
    }

    /// About how many bytes the meta itself holds, from planning on: the exposures of its frames.
    pub fn held_bytes(&self) -> u64 {
        match self {
            Meta::Frames(meta) | Meta::Truth(meta) => {
                (meta.times.len() * size_of::<crate::time::Exposure>()) as u64
            }
            _ => 0,
        }
    }

    /// About how many bytes some rows of the value take in memory, when all rows are alike.
    fn estimated_bytes_of(&self, rows: Rows) -> u64 {
        let Some(all) = self.rows().filter(|all| !all.is_empty()) else { return self.estimated_bytes() };
        (self.estimated_bytes() as f64 * all.intersect(rows).len() as f64 / all.len() as f64) as u64
    }

    /// Is [`estimated_bytes`](Meta::estimated_bytes) made of a count, and not of a guess?
    pub fn is_counted(&self) -> bool {
        match self {
            Meta::Events(meta) => meta.count_hint.is_some(),
            Meta::Tracks(meta) => meta.count_hint.is_some(),
            Meta::Light(meta) => meta.count_hint.is_some(),
            _ => true,
        }
    }

    /// About how many bytes the whole value takes in memory.
    pub fn estimated_bytes(&self) -> u64 {
        // Where a count is not known, eight events a pixel: a lively quarter of a second.
        let per_pixel =
            |extent: crate::extent::Extent, hint: Option<u64>| hint.unwrap_or(8 * extent.pixels() as u64);
        match self {
            Meta::Events(meta) => {
                per_pixel(meta.extent, meta.count_hint)
                    * (11 + 8 * meta.has_t_in as u64 + 4 * meta.has_step as u64)
            }
            Meta::Frames(meta) | Meta::Truth(meta) => [meta.row_values(), meta.extent.height as usize, 4]
                .iter()
                .fold(meta.times.len() as u64, |bytes, &n| bytes.saturating_mul(n as u64)),
            Meta::Tracks(meta) => {
                per_pixel(meta.extent, meta.count_hint) * (12 + 4 * meta.has_sigma as u64)
                    + 8 * meta.extent.pixels() as u64
            }
            Meta::Light(meta) => {
                per_pixel(meta.extent, meta.count_hint) * 12 + 8 * meta.extent.pixels() as u64
            }
            Meta::Map(meta) => (meta.extent.pixels() * meta.planes.len() * 4) as u64,
            Meta::Sensor(_) | Meta::Table(_) | Meta::Diagnosis(_) | Meta::Absent { .. } => 1 << 16,
        }
    }
}

/// A value: cheap to clone, read by band.
#[derive(Clone)]
pub enum Value {
    /// An event stream.
    Events(EventStream),
    /// Captured or rendered frames.
    Frames(FrameSequence),
    /// True frames of simulated data.
    Truth(Truth),
    /// Photocurrent tracks.
    Tracks(TrackSet),
    /// Light on the pixels.
    Light(Light),
    /// A sensor description.
    Sensor(Arc<Sensor>),
    /// Named planes.
    Map(MapSet),
    /// Named columns.
    Table(Arc<Table>),
    /// What a stage of a diagnosis found.
    Diagnosis(Arc<Diagnosis>),
}

impl fmt::Debug for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Value({})", self.data_type())
    }
}

/// Rows that are hashed together: enough work for two cores, little memory.
const DIGEST_ROWS: u32 = 64;

impl Value {
    /// What is known about it.
    pub fn meta(&self) -> Meta {
        match self {
            Value::Events(value) => Meta::Events(value.meta.clone()),
            Value::Frames(value) => Meta::Frames(value.meta.clone()),
            Value::Truth(value) => Meta::Truth(value.0.meta.clone()),
            Value::Tracks(value) => Meta::Tracks(value.meta.clone()),
            Value::Light(value) => Meta::Light(value.meta.clone()),
            Value::Sensor(value) => Meta::Sensor(value.clone()),
            Value::Map(value) => Meta::Map(value.meta.clone()),
            Value::Table(value) => Meta::Table(Arc::new(TableMeta { scores: value.as_scores().is_some() })),
            Value::Diagnosis(value) => Meta::Diagnosis(Arc::new(DiagnosisMeta { kind: value.kind() })),
        }
    }

    /// Its type.
    pub fn data_type(&self) -> DataType {
        self.meta().data_type()
    }

    /// The rows that can be read; `None` for what is not banded.
    pub fn rows(&self) -> Option<Rows> {
        match self {
            Value::Events(value) => Some(value.rows()),
            Value::Frames(value) | Value::Truth(Truth(value)) => Some(value.rows()),
            Value::Tracks(value) => Some(value.rows()),
            Value::Light(value) => Some(value.rows()),
            Value::Map(value) => Some(value.rows()),
            Value::Sensor(_) | Value::Table(_) | Value::Diagnosis(_) => None,
        }
    }

    /// Are all of its rows in memory as one band? No for frames, which are read by time as well.
    pub fn is_in_memory(&self) -> bool {
        match self {
            Value::Events(value) => value.borrowed().is_some(),
            Value::Tracks(value) => value.borrowed().is_some(),
            Value::Light(value) => value.borrowed().is_some(),
            Value::Map(value) => value.borrowed().is_some(),
            _ => false,
        }
    }

    /// Bytes that some rows take when they are read: counted where that is possible, else that share of the
    /// estimate. Of all of it where nothing is banded.
    pub fn bytes(&self, rows: Rows) -> u64 {
        let counted = match self {
            Value::Events(value) => value.bytes(rows),
            Value::Tracks(value) => value.bytes(rows),
            Value::Light(value) => value.bytes(rows),
            _ => None,
        };
        counted.unwrap_or_else(|| self.meta().estimated_bytes_of(rows))
    }

    /// The same value restricted to some rows; what is not banded stays whole.
    pub fn cut(&self, rows: Rows) -> Value {
        match self {
            Value::Events(value) => Value::Events(value.cut(rows)),
            Value::Frames(value) => Value::Frames(value.cut(rows)),
            Value::Truth(value) => Value::Truth(Truth(value.0.cut(rows))),
            Value::Tracks(value) => Value::Tracks(value.cut(rows)),
            Value::Light(value) => Value::Light(value.cut(rows)),
            Value::Map(value) => Value::Map(value.cut(rows)),
            Value::Sensor(_) | Value::Table(_) | Value::Diagnosis(_) => self.clone(),
        }
    }

    /// Bands of one value, top to bottom, as one.
    ///
    /// # Panics
    /// When parts are missing, leave a gap or differ in type: a broken invariant of the scheduler.
    pub fn splice(parts: Vec<Value>) -> Value {
        macro_rules! of {
            ($variant:ident) => {
                parts.into_iter().map(|part| match part {
                    Value::$variant(part) => part,
                    other => panic!("spliced parts have one type, found {}", other.data_type()),
                })
            };
        }
        match parts.first().expect("a splice has at least one part") {
            Value::Events(_) => Value::Events(EventStream::splice(of!(Events).collect())),
            Value::Frames(_) => Value::Frames(FrameSequence::splice(of!(Frames).collect())),
            Value::Truth(_) => {
                Value::Truth(Truth(FrameSequence::splice(of!(Truth).map(|truth| truth.0).collect())))
            }
            Value::Tracks(_) => Value::Tracks(TrackSet::splice(of!(Tracks).collect())),
            Value::Light(_) => Value::Light(Light::splice(of!(Light).collect())),
            Value::Map(_) => Value::Map(MapSet::splice(of!(Map).collect())),
            Value::Sensor(_) | Value::Table(_) | Value::Diagnosis(_) => {
                parts.into_iter().next().expect("a splice has at least one part")
            }
        }
    }

    /// The digest of its content: header and one digest per row for banded data, whatever the band height it
    /// is read with.
    ///
    /// # Errors
    /// When the data cannot be read.
    pub fn digest(&self) -> Result<Digest, DataError> {
        let rows = self.rows().unwrap_or(Rows { start: 0, end: 0 });
        let mut digest = ValueDigest::new(&self.meta());
        for band in rows.bands(DIGEST_ROWS) {
            digest.add(&self.cut(band))?;
        }
        digest.finish(self)
    }
}

/// Computes a value's digest band by band, top to bottom.
pub struct ValueDigest {
    builder: DigestBuilder,
}

impl ValueDigest {
    /// Begins with what is known of the value.
    pub fn new(meta: &Meta) -> ValueDigest {
        let mut builder = DigestBuilder::new("photocurrent-value/1");
        builder.text(meta.data_type().name());
        match meta {
            Meta::Events(meta) => meta.write_digest(&mut builder),
            Meta::Frames(meta) | Meta::Truth(meta) => meta.write_digest(&mut builder),
            Meta::Tracks(meta) => meta.write_digest(&mut builder),
            Meta::Light(meta) => meta.write_digest(&mut builder),
            Meta::Map(meta) => meta.write_digest(&mut builder),
            Meta::Sensor(_) | Meta::Table(_) | Meta::Diagnosis(_) | Meta::Absent { .. } => {}
        }
        ValueDigest { builder }
    }

    /// Adds the rows of the next part.
    ///
    /// # Errors
    /// When the part cannot be read.
    pub fn add(&mut self, part: &Value) -> Result<(), DataError> {
        let rows = match part {
            Value::Events(part) => row_digests(part)?,
            Value::Tracks(part) => row_digests(part)?,
            Value::Light(part) => row_digests(part)?,
            Value::Map(part) => row_digests(part)?,
            Value::Frames(part) | Value::Truth(Truth(part)) => {
                let block = part.read_rows(part.rows())?;
                (block.rows.start..block.rows.end).into_par_iter().map(|row| block.row_digest(row)).collect()
            }
            Value::Sensor(_) | Value::Table(_) | Value::Diagnosis(_) => Vec::new(),
        };
        self.add_rows(&rows);
        Ok(())
    }

    /// Adds row digests that were computed elsewhere, in row order.
    pub fn add_rows(&mut self, rows: &[Digest]) {
        for row in rows {
            self.builder.digest(row);
        }
    }

    /// The digest; `whole` gives the content of what is not banded.
    ///
    /// # Errors
    /// When a sensor description cannot be written as text.
    pub fn finish(mut self, whole: &Value) -> Result<Digest, DataError> {
        match whole {
            Value::Sensor(sensor) => self.builder.text(&sensor.canonical_json()),
            Value::Table(table) => self.builder.digest(&table.digest()),
            Value::Diagnosis(document) => self.builder.digest(&document.digest()),
            _ => &mut self.builder,
        };
        Ok(self.builder.finish())
    }
}

fn row_digests<M: BandMeta>(part: &Handle<M>) -> Result<Vec<Digest>, DataError> {
    let band = part.read(part.rows())?;
    Ok((part.rows().start..part.rows().end).into_par_iter().map(|row| band.row_digest(row)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    #[test]
    fn a_digest_does_not_depend_on_how_the_value_was_put_together() {
        let (events, frames) =
            (Value::Events(testing::events(6, 90)), Value::Frames(testing::frames(6, 90, 3)));
        for value in
            [events, frames, Value::Tracks(testing::tracks(6, 90)), Value::Light(testing::light(6, 90))]
        {
            let whole = value.digest().unwrap();
            for height in [1, 7, 64, 200] {
                let parts =
                    value.rows().unwrap().bands(height).into_iter().map(|rows| value.cut(rows)).collect();
                assert_eq!(Value::splice(parts).digest().unwrap(), whole);
            }
        }
    }

    #[test]
    fn true_frames_are_another_content_than_the_same_numbers_as_frames() {
        let frames = testing::frames(4, 4, 2);
        assert_ne!(
            Value::Frames(frames.clone()).digest().unwrap(),
            Value::Truth(Truth(frames)).digest().unwrap()
        );
    }
}
