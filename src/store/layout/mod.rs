//! Artefacts: one HDF5 layout per type of value (`photocurrent-artefact/1`), written band by band and read
//! lazily.
//!
//! | type | datasets |
//! | --- | --- |
//! | events | `/events/x` u16, `/events/p` u8, `/events/t` i64, optional `/events/t_in` i64 and `/events/step` f32, all in (y, t, x) order; `/events/row_offsets` u64 \[h + 1\] |
//! | frames, truth | `/frames/dn` f32 \[n, h, w x channels\] |
//! | tracks | `/tracks/t` i64, `/tracks/photocurrent` f32, pixels in row-major order; `/tracks/pixel_offsets` u64 \[h x w + 1\] |
//! | light | `/light/t`, `/light/photocurrent`, `/light/pixel_offsets`: as tracks |
//! | map | `/map/values` f32 \[h, planes, w\] |
//! | table | `/table/c0`, `/table/c1` ...: f64, i64, or UTF-8 bytes with offsets; names and notes in `/table/form` (JSON) |
//! | sensor | `/meta` holds it |
//! | diagnosis | `/diagnosis`: a JSON text; its kind in `/meta` |
//!
//! Every file has the attributes `format`, `data_type` and `tool_version`, and `/meta`, a JSON text of what
//! is known of the value. Filters are shuffle and deflate only, so h5py and MATLAB read it with nothing
//! installed. A content digest is computed while writing: it is the value's own ([`Value::digest`]), whatever
//! the height of the bands.

mod columns;
mod grids;
mod series;
mod table;

use crate::error::StoreError;
use crate::hdf::{Opened, locked};
pub(crate) use columns::create_group;
pub(crate) use grids::StripWriter;

use columns::EventsBody;
use grids::{FramesBody, MapBody};
use photocurrent_core::map::MapBand;
use photocurrent_core::value::ValueDigest;
use photocurrent_core::{
    Diagnosis, Digest, Extent, LightMeta, MapMeta, MapSet, Meta, Rows, TracksMeta, Truth, Value,
};
use series::SeriesBody;
use std::path::Path;
use std::sync::Arc;

/// The version of these layouts, as the attribute `format` says it.
pub(crate) const FORMAT: &str = "photocurrent-artefact/1";

/// Writes one value, band by band from top to bottom.
pub struct ValueWriter {
    opened: Opened,
    meta: Meta,
    /// None for a band that is kept: its digest is not used.
    digest: Option<ValueDigest>,
    /// Rows still to come; empty for what is not banded.
    missing: Rows,
    body: Body,
}

enum Body {
    Events(Box<EventsBody>),
    Frames(FramesBody),
    /// Tracks or light.
    Series(Box<SeriesBody>),
    Map(MapBody),
    /// A sensor, a table or a document, in one piece.
    Whole(Option<Value>),
}

impl Body {
    fn create(opened: &Opened, meta: &Meta) -> Result<Body, StoreError> {
        Ok(match meta {
            Meta::Events(meta) => Body::Events(Box::new(EventsBody::create(opened, meta)?)),
            Meta::Frames(meta) | Meta::Truth(meta) => Body::Frames(FramesBody::create(opened, meta)?),
            Meta::Tracks(meta) => Body::Series(Box::new(SeriesBody::create(opened, &**meta)?)),
            Meta::Light(meta) => Body::Series(Box::new(SeriesBody::create(opened, &**meta)?)),
            Meta::Map(meta) => Body::Map(MapBody::create(opened, meta)?),
            Meta::Sensor(_) | Meta::Table(_) | Meta::Diagnosis(_) => Body::Whole(None),
            Meta::Absent { .. } => Body::Whole(None),
        })
    }
}

impl ValueWriter {
    /// Creates the file, replacing what is there.
    ///
    /// # Errors
    /// When the file cannot be created, or `meta` says that there is nothing to write.
    pub fn create(path: &Path, meta: &Meta) -> Result<ValueWriter, StoreError> {
        let opened = ValueWriter::opened(path, meta)?;
        let body = Body::create(&opened, meta)?;
        let missing = meta.rows().unwrap_or(Rows { start: 0, end: 0 });
        let digest = Some(ValueDigest::new(meta));
        Ok(ValueWriter { digest, opened, meta: without_hint(meta), missing, body })
    }

    /// Writes the rows of a value as all rows of one by itself ([`Value::alone`]), as they are: neither
    /// packed nor digested. Gives the size of the file in bytes.
    ///
    /// # Errors
    /// When the value cannot be read or the file cannot be written.
    pub(crate) fn keep(path: &Path, value: &Value) -> Result<u64, StoreError> {
        let alone = value.alone();
        // Columns have no number of their first row: they are written from where they are.
        let is_columns = matches!(value, Value::Events(_) | Value::Tracks(_) | Value::Light(_));
        let part = if is_columns { value } else { &alone };
        let opened = Opened { packs: false, ..ValueWriter::opened(path, &alone.meta())? };
        let body = Body::create(&opened, &alone.meta())?;
        let missing = part.rows().unwrap_or(Rows { start: 0, end: 0 });
        let meta = without_hint(&part.meta());
        let mut writer = ValueWriter { digest: None, opened, meta, missing, body };
        writer.append(part)?;
        writer.complete().map(|(_, bytes)| bytes)
    }

    fn opened(path: &Path, meta: &Meta) -> Result<Opened, StoreError> {
        if let Meta::Absent { data_type, why } = meta {
            return Err(StoreError::Misuse {
                path: path.into(),
                what: format!("there are no {data_type} to write: {why}"),
            });
        }
        // A new file and not a truncated one: whoever has the old one open goes on reading it.
        match std::fs::remove_file(path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(StoreError::io(path, "replace the file", error));
            }
            _ => {}
        }
        let opened = Opened::create(path)?;
        opened.set_text_attribute(&opened.file, "format", FORMAT)?;
        opened.set_text_attribute(&opened.file, "data_type", meta.data_type().name())?;
        opened.set_text_attribute(&opened.file, "tool_version", crate::TOOL_VERSION)?;
        // A hint about size is no content: without it, equal contents give equal files.
        let json = serde_json::to_string(&without_hint(meta))
            .map_err(|error| StoreError::Misuse { path: path.into(), what: error.to_string() })?;
        opened.set_text("meta", &json)?;
        Ok(opened)
    }

    /// Adds the next rows; what is not banded comes in one piece.
    ///
    /// # Errors
    /// When the part is of another type or description, does not follow the rows before it, or cannot be read
    /// or written.
    pub fn append(&mut self, part: &Value) -> Result<(), StoreError> {
        let found = without_hint(&part.meta());
        if found != self.meta {
            let what = if found.data_type() == self.meta.data_type() {
                format!(
                    "a part says of itself {}, but the value was announced as {}",
                    describe(&found),
                    describe(&self.meta)
                )
            } else {
                format!(
                    "a part is {}, but the value was announced as {}",
                    found.data_type(),
                    self.meta.data_type()
                )
            };
            return Err(self.misuse(what));
        }
        if let Some(rows) = part.rows() {
            if rows.is_empty() {
                return Ok(());
            }
            if rows.start != self.missing.start || rows.end > self.missing.end {
                return Err(self.misuse(format!("{rows} were appended where {} are missing", self.missing)));
            }
            self.missing.start = rows.end;
        }
        let digest = self.digest.as_mut();
        match (&mut self.body, part) {
            (Body::Events(body), Value::Events(part)) => body.append(&self.opened, part, digest),
            (Body::Frames(body), Value::Frames(part) | Value::Truth(Truth(part))) => {
                body.append(part, digest)
            }
            (Body::Series(body), Value::Tracks(part)) => body.append(part, digest),
            (Body::Series(body), Value::Light(part)) => body.append(part, digest),
            (Body::Map(body), Value::Map(part)) => body.append(part, digest),
            (Body::Whole(whole @ None), part) => {
                *whole = Some(part.clone());
                Ok(())
            }
            _ => Err(self.misuse("a value that comes in one piece was appended twice".into())),
        }
    }

    /// Completes the file; gives the digest of the content and the size of the file in bytes.
    ///
    /// # Errors
    /// When rows are missing or the file cannot be written.
    pub fn finish(mut self) -> Result<(Digest, u64), StoreError> {
        let (digest, path) = (self.digest.take(), self.opened.path.clone());
        let (whole, bytes) = self.complete()?;
        let misuse = |what: String| StoreError::Misuse { path: path.clone(), what };
        let digest = digest.ok_or_else(|| misuse("the value was written without a digest".into()))?;
        Ok((digest.finish(&whole).map_err(|error| misuse(error.message))?, bytes))
    }

    /// Writes the rest of the file; gives what of the value its digest still needs, and the size of the file
    /// in bytes.
    fn complete(self) -> Result<(Value, u64), StoreError> {
        if !self.missing.is_empty() {
            return Err(self.misuse(format!("the value is not complete: {} are missing", self.missing)));
        }
        let ValueWriter { opened, meta, body, .. } = self;
        // The digest of banded data is complete already and only asks that the value has rows.
        let mut whole = banded();
        match body {
            Body::Events(body) => body.finish(&opened)?,
            Body::Frames(body) => body.finish()?,
            Body::Series(body) => body.finish(&opened)?,
            Body::Map(body) => body.finish(&opened, &meta)?,
            Body::Whole(Some(value)) => {
                match &value {
                    Value::Table(table) => table::write(&opened, table)?,
                    Value::Diagnosis(document) => opened.set_text("diagnosis", document.text())?,
                    _ => {}
                }
                whole = value;
            }
            Body::Whole(None) => {
                return Err(StoreError::Misuse {
                    path: opened.path.clone(),
                    what: format!("the value is not complete: the {} is missing", meta.data_type()),
                });
            }
        }
        let path = opened.path.clone();
        close(opened)?;
        let bytes = std::fs::metadata(&path)
            .map_err(|error| StoreError::io(&path, "read the file's size", error))?
            .len();
        Ok((whole, bytes))
    }

    fn misuse(&self, what: String) -> StoreError {
        StoreError::Misuse { path: self.opened.path.clone(), what }
    }
}

/// Flushes and closes; what the library could not write, it says here.
pub(crate) fn close(opened: Opened) -> Result<(), StoreError> {
    opened.wrap("/", "write the rest of the file", locked(|| opened.file.flush()))?;
    let Opened { path, file, .. } = opened;
    locked(|| file.close()).map_err(|error| StoreError::Library {
        path,
        at: "/".into(),
        doing: "close the file",
        detail: crate::hdf::short(&error),
    })
}

fn banded() -> Value {
    let meta = MapMeta { extent: Extent { width: 0, height: 0 }, planes: Vec::new() };
    let band = MapBand::zeros(meta.extent.rows(), &meta);
    Value::Map(MapSet::in_memory(Arc::new(meta), band))
}

fn without_hint(meta: &Meta) -> Meta {
    match meta {
        Meta::Events(meta) if meta.count_hint.is_some() => {
            Meta::Events(Arc::new(photocurrent_core::EventsMeta { count_hint: None, ..(**meta).clone() }))
        }
        Meta::Light(meta) if meta.count_hint.is_some() => {
            Meta::Light(Arc::new(LightMeta { count_hint: None, ..(**meta).clone() }))
        }
        Meta::Tracks(meta) if meta.count_hint.is_some() => {
            Meta::Tracks(Arc::new(TracksMeta { count_hint: None, ..(**meta).clone() }))
        }
        other => other.clone(),
    }
}

/// A meta in one line of bounded length.
fn describe(meta: &Meta) -> String {
    let text = format!("{meta:?}");
    match text.char_indices().nth(300) {
        Some((at, _)) => format!("{} ...", &text[..at]),
        None => text,
    }
}

/// Opens a value; bands and frames are read when they are asked for, from any thread.
///
/// # Errors
/// When the file is no artefact, or what it holds does not fit its own description.
pub fn open_value(path: &Path) -> Result<Value, StoreError> {
    let opened = Opened::read(path)?;
    if let Some(found) = opened.cut() {
        let hint = "an artefact is whole or not there: run the pipeline again".into();
        return Err(StoreError::NotReadable { path: path.into(), found, hint });
    }
    value_of(&opened)
}

/// [`open_value`] of a file of the cache, which nobody else writes.
pub(crate) fn open_stored(path: &Path) -> Result<Value, StoreError> {
    value_of(&Opened::read_ours(path)?)
}

fn value_of(opened: &Opened) -> Result<Value, StoreError> {
    let hint = "the file is no artefact of this version: run the pipeline again";
    let format = opened.text_attribute(&opened.file, "/", "format")?;
    if format.as_deref() != Some(FORMAT) {
        let found = format.map_or("no attribute `format`".into(), |format| format!("format = \"{format}\""));
        return Err(opened.content("/", found, format!("format = \"{FORMAT}\""), hint));
    }
    let missing = |what: &str| opened.content(what, "nothing", "a text", hint);
    let data_type = opened
        .text_attribute(&opened.file, "/", "data_type")?
        .ok_or_else(|| missing("/: attribute `data_type`"))?;
    let dataset = opened.dataset("meta")?.ok_or_else(|| missing("/meta"))?;
    let text = opened.text("/meta", &dataset)?;
    let meta: Meta = serde_json::from_str(&text).map_err(|error| {
        opened.content("/meta", format!("a text that cannot be read ({error})"), "a description", hint)
    })?;
    if meta.data_type().name() != data_type {
        return Err(opened.content("/meta", meta.data_type().name(), data_type, hint));
    }
    match meta {
        Meta::Events(meta) => columns::open_events(opened, &meta).map(Value::Events),
        Meta::Tracks(meta) => series::open(opened, &*meta).map(Value::Tracks),
        Meta::Light(meta) => series::open(opened, &*meta).map(Value::Light),
        Meta::Frames(meta) => grids::open_frames(opened, meta).map(Value::Frames),
        Meta::Truth(meta) => grids::open_frames(opened, meta).map(|frames| Value::Truth(Truth(frames))),
        Meta::Map(meta) => grids::open_map(opened, meta).map(Value::Map),
        Meta::Table(_) => table::read(opened).map(|table| Value::Table(Arc::new(table))),
        Meta::Sensor(sensor) => Ok(Value::Sensor(sensor)),
        Meta::Diagnosis(meta) => {
            let dataset = opened.dataset("diagnosis")?.ok_or_else(|| missing("/diagnosis"))?;
            let text = opened.text("/diagnosis", &dataset)?;
            let document = Diagnosis::from_text(meta.kind, text)
                .map_err(|error| opened.content("/diagnosis", error.message, "a JSON text", hint))?;
            Ok(Value::Diagnosis(Arc::new(document)))
        }
        Meta::Absent { .. } => Err(opened.content("/meta", "nothing", "a value", hint)),
    }
}
