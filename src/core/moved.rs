//! Some rows of a value as a value by itself, and back: how a row band is kept in a file of its own.
//!
//! A band that is kept begins at row 0 of a sensor that is as high as the band, so that every layout takes it
//! as it is. When it is read again, its rows go back to where they were. No number changes, so the digests of
//! rows stay.

use crate::error::DataError;
use crate::extent::{Extent, Rows};
use crate::frames::{FrameBlock, FrameSequence, FrameSource, FramesMeta, Truth};
use crate::handle::{Band, BandMeta, BandSource, Handle};
use crate::value::{Meta, Value};
use std::ops::Range;
use std::sync::Arc;

/// Reads rows of a source that stand `by` rows further up in it.
struct Moved<S> {
    of: S,
    by: i64,
}

fn moved(rows: Rows, by: i64) -> Rows {
    let to = |row: u32| u32::try_from(i64::from(row) - by).expect("rows are moved to where they were");
    Rows { start: to(rows.start), end: to(rows.end) }
}

impl<M: BandMeta> BandSource<M::Band> for Moved<Handle<M>> {
    fn read(&self, rows: Rows) -> Result<M::Band, DataError> {
        Ok(self.of.read(moved(rows, self.by))?.moved(rows.start))
    }

    fn bytes(&self, rows: Rows) -> Option<u64> {
        self.of.bytes(moved(rows, self.by))
    }
}

impl FrameSource for Moved<FrameSequence> {
    fn read(&self, frames: Range<usize>, rows: Rows) -> Result<FrameBlock, DataError> {
        Ok(FrameBlock { rows, ..self.of.read(frames, moved(rows, self.by))? })
    }
}

impl Meta {
    /// The same of a sensor with so many rows; of what is not banded, the same.
    fn with_height(&self, height: u32) -> Meta {
        let of = |extent: Extent| Extent { height, ..extent };
        let frames =
            |meta: &Arc<FramesMeta>| Arc::new(FramesMeta { extent: of(meta.extent), ..(**meta).clone() });
        macro_rules! cut {
            ($variant:ident, $meta:expr) => {{
                let mut meta = (**$meta).clone();
                meta.extent = of(meta.extent);
                Meta::$variant(Arc::new(meta))
            }};
        }
        match self {
            Meta::Events(meta) => cut!(Events, meta),
            Meta::Tracks(meta) => cut!(Tracks, meta),
            Meta::Light(meta) => cut!(Light, meta),
            Meta::Map(meta) => cut!(Map, meta),
            Meta::Frames(meta) => Meta::Frames(frames(meta)),
            Meta::Truth(meta) => Meta::Truth(frames(meta)),
            other => other.clone(),
        }
    }
}

impl Value {
    /// The value's rows as all rows of a value by itself; what is not banded stays as it is.
    pub fn alone(&self) -> Value {
        let Some(rows) = self.rows() else { return self.clone() };
        let all = Rows { start: 0, end: rows.len() as u32 };
        self.at(&self.meta().with_height(all.end), all, -i64::from(rows.start))
    }

    /// Undoes [`Value::alone`]: the value's rows as those from `first_row` on of what `whole` says; `None`
    /// when it is no part of that.
    pub fn placed(&self, whole: &Meta, first_row: u32) -> Option<Value> {
        let Some(rows) = self.rows() else { return (self.meta() == *whole).then(|| self.clone()) };
        let placed = Rows { start: first_row, end: first_row.checked_add(rows.end)? };
        let fits = rows.start == 0 && whole.rows()?.contains(placed) && self.data_type() == whole.data_type();
        fits.then(|| self.at(whole, placed, i64::from(first_row)))
    }

    fn at(&self, meta: &Meta, rows: Rows, by: i64) -> Value {
        macro_rules! moved {
            ($variant:ident, $value:expr, $meta:expr) => {
                Value::$variant(Handle::new($meta.clone(), rows, Arc::new(Moved { of: $value.clone(), by })))
            };
        }
        let frames = |of: &FrameSequence, meta: &Arc<FramesMeta>| {
            FrameSequence::new(meta.clone(), rows, Arc::new(Moved { of: of.clone(), by }))
        };
        match (self, meta) {
            (Value::Events(value), Meta::Events(meta)) => moved!(Events, value, meta),
            (Value::Tracks(value), Meta::Tracks(meta)) => moved!(Tracks, value, meta),
            (Value::Light(value), Meta::Light(meta)) => moved!(Light, value, meta),
            (Value::Map(value), Meta::Map(meta)) => moved!(Map, value, meta),
            (Value::Frames(value), Meta::Frames(meta)) => Value::Frames(frames(value, meta)),
            (Value::Truth(Truth(value)), Meta::Truth(meta)) => Value::Truth(Truth(frames(value, meta))),
            _ => self.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::{Light, LightBand, LightMeta};
    use crate::{Colour, TimeSpan};

    #[test]
    fn rows_that_are_kept_alone_come_back_to_their_place() {
        let extent = Extent { width: 2, height: 7 };
        let mut band = LightBand::begin(0, extent.width);
        (0..14).for_each(|pixel| band.push((0..pixel % 3 + 1).map(|k| (k, pixel as f32))));
        let meta = LightMeta { extent, span: TimeSpan::new(0, 10), colour: Colour::Mono, count_hint: None };
        let whole = Value::Light(Light::in_memory(Arc::new(meta), band));
        let rows = Rows { start: 2, end: 5 };
        let alone = whole.cut(rows).alone();
        assert_eq!(
            (alone.rows(), alone.meta().rows()),
            (Some(Rows { start: 0, end: 3 }), Some(Rows { start: 0, end: 3 }))
        );
        assert_eq!(alone.bytes(Rows { start: 0, end: 3 }), whole.bytes(rows));
        let back = alone.placed(&whole.meta(), 2).unwrap();
        let read = |value: &Value| match value {
            Value::Light(light) => light.read(Rows { start: 3, end: 5 }).unwrap(),
            other => panic!("light stays light, found {other:?}"),
        };
        assert_eq!(read(&back), read(&whole));
        assert!(alone.placed(&whole.meta(), 5).is_none(), "three rows do not fit from row 5 on");
    }
}
