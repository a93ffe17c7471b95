//! Readers of other people's files: one node for each format, one text for all of them.
//!
//! What differs between formats is in `photocurrent-formats`: how a file is recognised, how its bytes become
//! events and pictures. Here stands what is the same: parameters that state what a file cannot say, a clock
//! that begins at zero, bands of rows. A format accepts only those parameters that mean something for it
//! ([`Reader::ACCEPTS`]), and its manual page shows only those.
//!
//! Limits: planning walks over all events once, to know their span. Events beyond 512 MiB go through a
//! temporary file.

use crate::crop::Crop;
use crate::spans::check_window;
use photocurrent_core::DataType;
use photocurrent_core::document::Source;
use photocurrent_core::quantity::{Duration, InputPath};
use photocurrent_core::{
    Context, Decl, EventStream, Extent, FileRef, FrameSequence, Meta, Node, NodeError, PortMetas, Sensor,
};
use photocurrent_formats::arrange::{Arranged, EVENTS_BUDGET, Settings, arrange};
use photocurrent_formats::{
    Column, Counter, Declared, EventCursor, Mirror, Pairing, Polarity, Probe, Recording, Shift, StampRole,
    Strobe, TimeUnit, Transfer, catalog, instead, trim,
};
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::borrow::Cow;
use std::marker::PhantomData;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// One format as a node.
pub trait Reader: Send + Sync + 'static {
    /// What the node says about itself.
    const DECL: Decl;
    /// The format's id in the catalogue of formats.
    const FORMAT: &'static str;
    /// The parameters that mean something for it, in addition to [`COMMON`].
    const ACCEPTS: &'static [&'static str];
}

/// Parameters that every format accepts.
const COMMON: [&str; 5] = ["path", "start", "end", "zero", "crop"];

/// Parameters that every format with events accepts in addition.
const OF_EVENTS: [&str; 5] = ["mirror", "shift", "drop_duplicates", "invert_polarity", "time_unit"];

/// Parameters that every format with frames, in its files or elsewhere, accepts in addition.
const OF_FRAMES: [&str; 2] = ["skip_frames", "stamps_unit"];

/// Width and height of the array of event pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Size {
    /// Pixels in a row.
    #[schemars(range(min = 1, max = 65536))]
    pub width: u32,
    /// Rows.
    #[schemars(range(min = 1, max = 65536))]
    pub height: u32,
}

/// All parameters of all formats.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct All {
    /// The file or folder; relative to the manifest that names it.
    pub path: InputPath,
    /// Leave out what was stamped before this time, counted from zero. Default: the beginning.
    #[schemars(extend("x-min" = "0 ns"))]
    pub start: Option<Duration>,
    /// Leave out events stamped at or after this time, and frames whose exposure ends after it; counted from
    /// zero. Default: the end.
    #[schemars(extend("x-min" = "0 ns"))]
    pub end: Option<Duration>,
    /// The file's time that becomes t = 0. Default: its earliest stamp. Give two readers the same value where
    /// events and frames of one recording are read apart.
    pub zero: Option<Duration>,
    /// Only this part of the array of event pixels, numbered from 0, and the frame pixels that lie on it.
    pub crop: Option<Crop>,
    /// Size of the array of event pixels, where the file does not state it.
    pub extent: Option<Size>,
    /// Unit of the events' stamps, where the file does not state it, or states a wrong one.
    pub time_unit: Option<TimeUnit>,
    /// What the columns hold, from the left, where no header says so.
    pub columns: Option<Vec<Column>>,
    /// Stored coordinates count this many to a pixel: 32 in HS-ERGB and BS-ERGB.
    #[schemars(range(min = 1, max = 4096))]
    pub coordinate_scale: Option<u32>,
    /// Which event camera, stream or topic of a file with several, as the file names it.
    pub camera: Option<String>,
    /// Which frame camera, stream or topic of a file with several, as the file names it.
    pub frame_camera: Option<String>,
    /// Frames that lie elsewhere: a folder of PNG, TIFF or JPEG pictures, or a Y4M file; relative to the
    /// manifest.
    pub frames: Option<InputPath>,
    /// Stamps of those frames: a text file; relative to the manifest. Default: the one in the folder of the
    /// pictures.
    pub stamps: Option<InputPath>,
    /// The trigger line of the event file whose edges are the exposures of those frames; `strobe` states
    /// which edge opens the shutter.
    pub trigger_line: Option<u16>,
    /// Added to every stamp of a frame: for clocks that begin apart.
    pub frame_offset: Option<Duration>,
    /// Length of a frame's exposure, where it is not recorded.
    #[schemars(extend("x-min" = "1 ns"))]
    pub exposure: Option<Duration>,
    /// What a frame's one stamp means, where it is not recorded.
    pub stamp: Option<StampRole>,
    /// Delay from one row's exposure to the next, where it is not recorded; 0 is a global shutter.
    #[schemars(extend("x-min" = "0 ns"))]
    pub row_time: Option<Duration>,
    /// How the stored values of frames follow from linear ones, where it is not recorded.
    pub transfer: Option<Transfer>,
    /// Unit of the frames' stamps, where their file does not state it, or states a wrong one. Default:
    /// `time_unit` for frames that lie elsewhere.
    pub stamps_unit: Option<TimeUnit>,
    /// How the frames' picture is mirrored against the events; events are moved.
    pub mirror: Option<Mirror>,
    /// Whole event pixels by which events lie right of and below the same detail of the frames; events are
    /// moved, after `mirror`.
    pub shift: Option<Shift>,
    /// Frames that are left out, numbered from 0 in the order of the file.
    pub skip_frames: Option<Vec<u32>>,
    /// Read events that are there twice (one time, pixel and sign) once.
    pub drop_duplicates: Option<bool>,
    /// Exchange ON and OFF, for files whose ON means darker.
    pub invert_polarity: Option<bool>,
    /// How polarity is stored. Default: recognised over the whole file, with a note where it is unusual.
    pub polarity: Option<Polarity>,
    /// Which number the first column and row have. Default: 1 where an array of known size shows it, with a
    /// note; otherwise 0.
    #[schemars(range(max = 1))]
    pub origin: Option<u32>,
    /// The counter of the stamps, whose range is added each time it begins again. Default: recognised where
    /// time goes back by the range of one, with a note.
    pub counter: Option<Counter>,
    /// Which level of the trigger line is an open shutter. Default: `active_high`, rising opens and falling
    /// closes.
    pub strobe: Option<Strobe>,
    /// The pulse of the trigger line, or the entry of the stamps, that belongs to the first picture: counted
    /// from 0, with those that `pairing` counts as missing; -1 where only the second picture has the first.
    /// Default: what follows from counts, numbers in names and gaps between the times, and an error where
    /// nothing follows.
    pub first_pulse: Option<i64>,
    /// By what a missing picture, pulse or stamp is recognised where they are paired in order: holes in the
    /// numbers of the pictures' names, gaps of whole periods between the times, both, or nothing. Default:
    /// what leaves least without a partner.
    pub pairing: Option<Pairing>,
}

impl All {
    /// The parameters as the readers take them.
    pub fn settings(&self) -> Settings {
        let path = |path: &Option<InputPath>| path.as_ref().map(|path| PathBuf::from(path.path()));
        Settings {
            declared: Declared {
                extent: self.extent.map(|size| Extent { width: size.width, height: size.height }),
                time_unit: self.time_unit,
                columns: self.columns.clone(),
                coordinate_scale: self.coordinate_scale,
                camera: self.camera.clone(),
                frame_camera: self.frame_camera.clone(),
                frames: path(&self.frames),
                stamps: path(&self.stamps),
                trigger_line: self.trigger_line,
                exposure: self.exposure,
                stamp: self.stamp,
                transfer: self.transfer,
                stamps_unit: self.stamps_unit,
                mirror: self.mirror,
                shift: self.shift,
                skip_frames: self.skip_frames.clone(),
                drop_duplicates: self.drop_duplicates,
                invert_polarity: self.invert_polarity,
                polarity: self.polarity,
                origin: self.origin,
                counter: self.counter,
                strobe: self.strobe,
                first_pulse: self.first_pulse,
                pairing: self.pairing,
            },
            zero: self.zero,
            start: self.start,
            end: self.end,
            frame_offset: self.frame_offset,
            row_time: self.row_time,
            crop: self.crop.map(|Crop { x, y, width, height }| trim::Crop { x, y, width, height }),
        }
    }
}

/// The parameters of one format: those of [`All`] that it accepts.
pub struct Params<R> {
    all: All,
    reader: PhantomData<R>,
}

impl<R> Default for Params<R> {
    fn default() -> Self {
        Params { all: All::default(), reader: PhantomData }
    }
}

/// Does this format accept a parameter?
pub(super) fn accepted<R: Reader>(name: &str) -> bool {
    let has_events = R::FORMAT != "pictures";
    COMMON.contains(&name)
        || R::ACCEPTS.contains(&name)
        || OF_FRAMES.contains(&name)
        || has_events && OF_EVENTS.contains(&name)
}

impl<R: Reader> Serialize for Params<R> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut value = serde_json::to_value(&self.all).map_err(serde::ser::Error::custom)?;
        if let Some(map) = value.as_object_mut() {
            map.retain(|name, _| accepted::<R>(name));
        }
        value.serialize(serializer)
    }
}

impl<'de, R: Reader> Deserialize<'de> for Params<R> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let map = serde_json::Map::deserialize(deserializer)?;
        if let Some(name) = map.keys().find(|name| !accepted::<R>(name)) {
            return Err(serde::de::Error::custom(format!("`{name}` is no parameter of {}", R::DECL.kind)));
        }
        let all = serde_json::from_value(map.into()).map_err(serde::de::Error::custom)?;
        Ok(Params { all, reader: PhantomData })
    }
}

impl<R: Reader> JsonSchema for Params<R> {
    fn schema_name() -> Cow<'static, str> {
        format!("Params of {}", R::DECL.kind).into()
    }
    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let mut schema = All::json_schema(generator);
        if let Some(properties) = schema.get_mut("properties").and_then(serde_json::Value::as_object_mut) {
            properties.retain(|name, _| accepted::<R>(name));
        }
        schema
    }
}

photocurrent_core::ports! {
    /// Nothing is needed.
    pub struct In {}
}

photocurrent_core::ports! {
    /// What the file holds.
    pub struct Out {
        /// The events.
        events: Option<EventStream>,
        /// The frames as captured, linear digital numbers.
        frames: Option<FrameSequence>,
        /// The sensor description that travels with the file.
        sensor: Option<Arc<Sensor>>,
    }
}

/// An opened file, arranged.
struct Open {
    recording: Box<dyn Recording>,
    arranged: Arranged,
}

/// The node.
pub struct Read<R> {
    all: All,
    open: OnceLock<Open>,
    /// The events, gathered once for all bands of rows.
    events: Mutex<Option<EventStream>>,
    reader: PhantomData<R>,
}

impl<R: Reader> Read<R> {
    fn opened(&self) -> Result<Box<dyn Recording>, NodeError> {
        let path = self.all.path.path();
        let format = catalog::named(R::FORMAT)
            .ok_or_else(|| NodeError::failed(format!("there is no format `{}`", R::FORMAT)))?;
        let probe = Probe::new(path)?;
        if !(format.recognises)(&probe) {
            let (path, name) = (path.display(), format.name);
            let error = match catalog::recognise(self.all.path.path())? {
                Some(other) => NodeError::input(format!("{path} is {}, and not {name}", other.name))
                    .hint(format!("read it with read/{}", other.id)),
                None => match instead::what_it_is(&probe) {
                    Some(instead) => {
                        NodeError::input(format!("{path} is not {name}: it is {}", instead.what))
                            .hint(instead.todo)
                    }
                    None => {
                        let beginning = probe.head[..probe.head.len().min(12)].escape_ascii();
                        NodeError::input(format!("{path} is not {name}: it begins with `{beginning}`"))
                            .hint("photocurrent inspect lists the formats that are known")
                    }
                },
            };
            return Err(error.param("path"));
        }
        photocurrent_formats::joined::open(format, path, &self.all.settings().declared)
            .map_err(NodeError::from)
    }

    fn open(
        &self,
        advance: impl FnMut(&dyn EventCursor) -> Result<(), NodeError>,
    ) -> Result<&Open, NodeError> {
        if let Some(open) = self.open.get() {
            return Ok(open);
        }
        let recording = self.opened()?;
        let arranged = arrange(self.all.path.path(), recording.as_ref(), &self.all.settings(), advance)?;
        Ok(self.open.get_or_init(|| Open { recording, arranged }))
    }

    fn sensor(&self, recording: &dyn Recording) -> Result<Option<Arc<Sensor>>, NodeError> {
        let Some(text) = recording.sensor_text() else { return Ok(None) };
        let path = self.all.path.path();
        let name = super::short_name(path);
        let source = Source::new(format!("{name}:/sensor"), path.parent().unwrap_or(path), text);
        let sensor = Sensor::parse(&source).map_err(|problems| {
            NodeError::input(format!("the sensor description in {name} has mistakes"))
                .param("path")
                .problems(problems)
        })?;
        Ok(Some(Arc::new(sensor)))
    }

    /// The events, read from the file at the first call.
    fn events(&self, open: &Open, cx: &Context) -> Result<Option<EventStream>, NodeError> {
        // A lock: of two bands that begin together one reads, the other waits for it.
        let mut events = self.events.lock().unwrap_or_else(PoisonError::into_inner);
        if events.is_none() {
            let name = super::short_name(self.all.path.path());
            let mut before = 0;
            let gathered = open.arranged.gather(
                open.recording.as_ref(),
                EVENTS_BUDGET,
                |cursor: &dyn EventCursor| {
                    let (at, total) = cursor.position();
                    if before == 0 {
                        cx.begin(total, "bytes");
                    }
                    cx.advance(at.saturating_sub(before))?;
                    before = at.max(before);
                    Ok::<(), NodeError>(())
                },
            )?;
            if let Some((stream, outside)) = gathered {
                cx.count(
                    outside,
                    &format!("events in {name} lie outside {} pixels and were left out", stream.meta.extent),
                );
                *events = Some(stream);
            }
        }
        Ok(events.clone())
    }
}

impl<R: Reader> Node for Read<R> {
    const DECL: Decl = R::DECL;
    type Params = Params<R>;
    type In = In;
    type Out = Out;

    fn build(params: Params<R>) -> Result<Self, NodeError> {
        let all = params.all;
        super::need_path(&all.path, "recording")?;
        check_window(all.start, all.end)?;
        if let Some(Transfer::Gamma(gamma)) = all.transfer
            && !(gamma > 0.0 && gamma.is_finite())
        {
            return Err(NodeError::usage(format!("a gamma of {gamma} is no curve; it must be positive"))
                .param("transfer"));
        }
        if let Some(origin) = all.origin.filter(|origin| *origin > 1) {
            return Err(
                NodeError::usage(format!("coordinates begin at 0 or 1, not at {origin}")).param("origin")
            );
        }
        Ok(Read { all, open: OnceLock::new(), events: Mutex::new(None), reader: PhantomData })
    }

    fn plan(&self, _: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let open = self.open(|_| Ok(()))?;
        let absent = |data_type: DataType, why: &String| Meta::Absent { data_type, why: why.clone() };
        let events = open
            .arranged
            .events
            .as_ref()
            .map_or_else(|why| absent(DataType::Events, why), |meta| Meta::Events(meta.clone()));
        let frames = open
            .arranged
            .frames
            .as_ref()
            .map_or_else(|why| absent(DataType::Frames, why), |meta| Meta::Frames(meta.clone()));
        let no_sensor = || {
            absent(
                DataType::Sensor,
                &format!("{} has no sensor description", super::short_name(self.all.path.path())),
            )
        };
        let sensor = self.sensor(open.recording.as_ref())?.map_or_else(no_sensor, Meta::Sensor);
        Ok(vec![events, frames, sensor])
    }

    fn run(&self, _: In, cx: &Context) -> Result<Out, NodeError> {
        let open = self.open(|_| cx.advance(0))?;
        let arranged = &open.arranged;
        arranged.notes.iter().for_each(|note| cx.note(note));
        arranged.counts.iter().for_each(|(n, what)| cx.count(*n, what));
        arranged.losses.iter().for_each(|loss| {
            cx.loss(format!("{}: {}: {}", super::short_name(self.all.path.path()), loss.at, loss.what))
        });
        Ok(Out {
            events: if cx.wants("events") {
                self.events(open, cx)?.map(|events| events.cut(cx.rows()))
            } else {
                None
            },
            frames: if cx.wants("frames") { arranged.frame_sequence() } else { None },
            sensor: if cx.wants("sensor") { self.sensor(open.recording.as_ref())? } else { None },
        })
    }

    fn files(&self) -> Vec<FileRef> {
        let named = |path: PathBuf| FileRef { param: "path".into(), path };
        // A file that cannot be opened is reported by `plan`, with the reason.
        match self.opened() {
            Ok(recording) => recording.files().into_iter().map(named).collect(),
            Err(_) => vec![named(self.all.path.path().into())],
        }
    }
}
