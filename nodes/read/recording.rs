//! Reads a recording: events, frames, true frames and the sensor description of one HDF5 file,
//! `photocurrent-recording/1`.
//!
//! Either stream may be missing; what is not there becomes an absent output with the reason, so that a node
//! which needs it can say so before any data are read. Only the header is read while planning. Events come
//! out by row band, frames lazily by frames and rows, so that a recording may be larger than memory.
//!
//! The row time is that of the recorder (`row_time_ns` of `/frames`), also when the sensor description
//! differs; then a note states both. A recording that states it nowhere is refused rather than taken for a
//! global shutter, unless the parameter `row_time` does.
//!
//! Frames may have a whole number of pixels along the side of each event pixel, three channels, or a mosaic
//! of filters, which is passed on as stored: one value a pixel. Those of more pixels than the events are not
//! cut into row bands.

use photocurrent_core::DataType;
use photocurrent_core::document::Source;
use photocurrent_core::quantity::{Duration, InputPath};
use photocurrent_core::{
    Context, Decl, EventStream, EventsMeta, FileRef, FrameSequence, Grain, Meta, Node, NodeError, PortMetas,
    Rows, Sensor, Truth,
};
use photocurrent_formats::Declared;
use photocurrent_formats::arrange::EVENTS_BUDGET;
use photocurrent_formats::gather::{Wanted, gather};
use photocurrent_formats::{catalog, joined};
use photocurrent_store::Recording;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Parameters of `read/recording`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The recording, an HDF5 file in the form `photocurrent-recording/1`; relative to the manifest that
    /// names it.
    pub path: InputPath,
    /// Delay from one row's exposure to the next, for a file that does not state it with its frames; goes
    /// before what the file's sensor description says.
    #[schemars(extend("x-min" = "0 ns"))]
    pub row_time: Option<Duration>,
}

photocurrent_core::ports! {
    /// Nothing is needed.
    pub struct In {}
}

photocurrent_core::ports! {
    /// What the file holds.
    pub struct Out {
        /// The events, with in-pixel times when the file has them.
        events: Option<EventStream>,
        /// The frames as captured.
        frames: Option<FrameSequence>,
        /// True frames of simulated data; only scorers take them.
        truth: Option<Truth>,
        /// The nominal sensor description that travels with the recording.
        sensor: Option<Arc<Sensor>>,
    }
}

/// The node.
pub struct ReadRecording {
    params: Params,
    /// The file stays open between row bands: its header is read, and its events are checked, once.
    opened: OnceLock<Recording>,
    /// The events of a large file, sorted by row once.
    gathered: Mutex<Option<EventStream>>,
}

/// Events of a recording stand in the order of time, so rows are read by a pass over all of them. With more
/// events than this they are sorted by rows first, in one pass, through a temporary file where they are many.
const SCANNED_EVENTS: u64 = 4 << 20;

/// The events of a recording by row, after one pass over the file.
fn gathered(recording: &Recording, meta: &Arc<EventsMeta>, budget: usize) -> Result<EventStream, NodeError> {
    // Events that contradict the format are reported as they are everywhere.
    recording.read_events(Rows { start: 0, end: 0 })?;
    let path = recording.path();
    let format = catalog::recognise(path)?.ok_or_else(|| {
        NodeError::input(format!("{} is no recording any more", path.display())).param("path")
    })?;
    let opened = joined::open(format, path, &Declared::default())?;
    let (extent, t_in) = (meta.extent, meta.has_t_in);
    let wanted = Wanted {
        extent,
        crop: None,
        zero_ns: 0,
        start_ns: i64::MIN,
        end_ns: i64::MAX,
        ordered: true,
        t_in,
        budget,
        drop_duplicates: false,
    };
    let events = gather(&mut *opened.events()?, wanted, |_| Ok::<(), NodeError>(()))?;
    Ok(EventStream::new(meta.clone(), extent.rows(), Arc::new(events)))
}

impl ReadRecording {
    fn open(&self) -> Result<&Recording, NodeError> {
        if let Some(recording) = self.opened.get() {
            return Ok(recording);
        }
        let path = self.params.path.path();
        // The system's message for a missing file comes without a hint about where paths start.
        if std::fs::metadata(path).map_err(|error| super::cannot_read(path, &error))?.is_dir() {
            return Err(NodeError::files(format!(
                "{}: this is no regular file but a folder",
                path.display()
            ))
            .hint("name the HDF5 recording itself, such as `path = \"scene.h5\"`")
            .param("path"));
        }
        let recording = Recording::open(path).map_err(|error| NodeError::from(error).param("path"))?;
        Ok(self.opened.get_or_init(|| recording))
    }

    fn events(&self, recording: &Recording) -> Result<Option<EventStream>, NodeError> {
        let Some(meta) = recording.events_meta().filter(|_| recording.event_count() > SCANNED_EVENTS) else {
            return Ok(recording.events());
        };
        let mut found = self.gathered.lock().unwrap_or_else(PoisonError::into_inner);
        if found.is_none() {
            *found = Some(gathered(recording, meta, EVENTS_BUDGET)?);
        }
        Ok(found.clone())
    }

    fn name(&self) -> String {
        super::short_name(self.params.path.path())
    }

    /// The row time where the frames do not state it.
    fn row_time(&self, sensor: Option<&Sensor>) -> Option<Duration> {
        self.params.row_time.or(sensor.and_then(|sensor| sensor.frames.row_time))
    }

    fn sensor(&self, recording: &Recording) -> Result<Option<Arc<Sensor>>, NodeError> {
        let Some(text) = recording.sensor_text() else { return Ok(None) };
        let path = self.params.path.path();
        let source = Source::new(format!("{}:/sensor", self.name()), path.parent().unwrap_or(path), text);
        let sensor = Sensor::parse(&source).map_err(|problems| {
            let mistakes =
                if problems.len() == 1 { "a mistake".into() } else { format!("{} mistakes", problems.len()) };
            NodeError::input(format!("the sensor description in {} (/sensor) has {mistakes}", self.name()))
                .param("path")
                .problems(problems)
        })?;
        Ok(Some(Arc::new(sensor)))
    }
}

/// The row time that counts: the recorder's word, or else what the manifest or the sensor description says.
fn row_time_ns(name: &str, recorded: Option<i64>, described: Option<Duration>) -> Result<i64, NodeError> {
    recorded.or(described.map(Duration::ns)).ok_or_else(|| {
        NodeError::input(format!("{name} does not state the row time of its frames"))
            .note(
                "/frames has no attribute `row_time_ns`, and no sensor description in the file states \
                   `frames.row_time`",
            )
            .hint(
                "set the attribute `row_time_ns` of /frames to the delay from one row to the next in ns, \
                   or `row_time` here; 0 is a global shutter",
            )
            .param("path")
    })
}

/// The note when recorder and description disagree.
fn disagreement(name: &str, recorded: Option<i64>, described: Option<Duration>) -> Option<String> {
    let (recorded, described) = (recorded?, described?);
    (recorded != described.ns()).then(|| {
        format!(
            "{name}: /frames states a row time of {}, its sensor description {described}; the first counts",
            Duration::new(recorded)
        )
    })
}

impl Node for ReadRecording {
    const DECL: Decl = Decl {
        kind: "read/recording",
        about: "Reads events, frames, true frames and the sensor description of an HDF5 recording.",
        revision: 1,
        grain: Grain::Pixel,
        draws: false,
        exports: false,
        sources: &["photocurrent-recording/1 (docs/formats.md)"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        super::need_path(&params.path, "scene.h5")?;
        Ok(ReadRecording { params, opened: OnceLock::new(), gathered: Mutex::new(None) })
    }

    fn plan(&self, _: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let (recording, name) = (self.open()?, self.name());
        let sensor = self.sensor(recording)?;
        let absent = |data_type: DataType, why: String| Meta::Absent { data_type, why };
        let events = match recording.events_meta() {
            Some(meta) => Meta::Events(meta.clone()),
            None => absent(DataType::Events, format!("{name} has no /events")),
        };
        let frames = match recording.exposures() {
            None => absent(DataType::Frames, format!("{name} has no /frames")),
            Some([]) => absent(DataType::Frames, format!("/frames of {name} holds no frame")),
            Some(_) => {
                let row_time_ns =
                    row_time_ns(&name, recording.row_time_ns(), self.row_time(sensor.as_deref()))?;
                let none = || absent(DataType::Frames, format!("{name} has no /frames"));
                recording.frames_meta(row_time_ns).map_or_else(none, |meta| Meta::Frames(Arc::new(meta)))
            }
        };
        let truth = match recording.truth().filter(|truth| !truth.0.is_empty()) {
            Some(truth) => Meta::Truth(truth.0.meta),
            None => absent(DataType::Truth, format!("{name} has no /truth")),
        };
        let sensor =
            sensor.map_or_else(|| absent(DataType::Sensor, format!("{name} has no /sensor")), Meta::Sensor);
        Ok(vec![events, frames, truth, sensor])
    }

    fn run(&self, _: In, cx: &Context) -> Result<Out, NodeError> {
        let (recording, name, rows) = (self.open()?, self.name(), cx.rows());
        let sensor = self.sensor(recording)?;
        let events =
            if cx.wants("events") { self.events(recording)?.map(|events| events.cut(rows)) } else { None };
        let frames = if cx.wants("frames")
            && recording.exposures().is_some_and(|exposures| !exposures.is_empty())
        {
            let (recorded, described) =
                (recording.row_time_ns(), sensor.as_ref().and_then(|sensor| sensor.frames.row_time));
            disagreement(&name, recorded, described).into_iter().for_each(|note| cx.note(note));
            recording.frames(row_time_ns(&name, recorded, self.row_time(sensor.as_deref()))?).map(|frames| {
                if frames.rows() == recording.extent().rows() { frames.cut(rows) } else { frames }
            })
        } else {
            None
        };
        let truth = if cx.wants("truth") {
            recording.truth().filter(|truth| !truth.0.is_empty()).map(|Truth(truth)| {
                Truth(if truth.rows() == recording.extent().rows() { truth.cut(rows) } else { truth })
            })
        } else {
            None
        };
        Ok(Out { events, frames, truth, sensor: sensor.filter(|_| cx.wants("sensor")) })
    }

    fn files(&self) -> Vec<FileRef> {
        vec![FileRef { param: "path".into(), path: self.params.path.path().into() }]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Exposure, Extent, testing};
    use photocurrent_store::{RecordingContent, write_recording};
    use tempfile::TempDir;

    const EXTENT: Extent = Extent { width: 6, height: 5 };
    const ALL: [&str; 4] = ["events", "frames", "truth", "sensor"];
    const SENSOR: &str = "format = \"photocurrent-sensor/1\"\nname = \"small\"\n[frames]\nrow_time = \"10 \
                          us\"\n";

    /// A node that reads what `content` says; the folder must outlive it.
    fn node(content: &RecordingContent) -> (TempDir, ReadRecording) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rec.h5");
        write_recording(&path, content).unwrap();
        (folder, ReadRecording::build(Params { path: InputPath::new(path), row_time: None }).unwrap())
    }

    fn plan(node: &ReadRecording) -> Result<Vec<Meta>, NodeError> {
        node.plan(&PortMetas::default())
    }

    #[test]
    fn events_that_are_sorted_by_row_first_are_those_of_a_pass_for_every_band() {
        let mut random = photocurrent_core::random::Random::new(3, &[]);
        let mut below = |n: u64| (random.bits() % n) as u16;
        let event = |k: i64| {
            let (x, y, t) = (below(6), below(5), i64::from(below(300)));
            photocurrent_core::events::Event {
                x,
                y,
                polarity: photocurrent_core::Polarity::On,
                t,
                t_in: Some(t - k % 3),
            }
        };
        let band =
            photocurrent_core::EventBand::from_events(EXTENT.rows(), (0..200_000).map(event).collect())
                .unwrap();
        let meta = EventsMeta {
            extent: EXTENT,
            span: None,
            has_t_in: true,
            has_step: false,
            t_resolution_ns: None,
            count_hint: None,
        };
        let events = EventStream::in_memory(Arc::new(meta), band);
        let (_folder, node) =
            node(&RecordingContent { events: Some(&events), ..RecordingContent::empty(EXTENT) });
        let recording = node.open().unwrap();
        // In memory, and through a temporary file.
        for budget in [usize::MAX, 100_000] {
            let sorted = gathered(recording, recording.events_meta().unwrap(), budget).unwrap();
            for rows in [EXTENT.rows(), Rows { start: 1, end: 2 }, Rows { start: 3, end: 5 }] {
                assert_eq!(sorted.read(rows).unwrap(), recording.read_events(rows).unwrap());
            }
        }
    }

    #[test]
    fn bands_put_together_are_what_was_written() {
        let (events, frames) = (testing::events(6, 5), testing::frames(6, 5, 3));
        let truth = Truth(testing::captured(
            EXTENT,
            vec![Exposure::new(0, 1), Exposure::new(500, 501)],
            0,
            |l, x, y| (l as u32 * 100 + 10 * y + x) as f32,
        ));
        let content = RecordingContent {
            events: Some(&events),
            frames: Some(&frames),
            truth: Some(&truth),
            sensor: Some(SENSOR),
            ..RecordingContent::empty(EXTENT)
        };
        let (_folder, node) = node(&content);
        let metas = plan(&node).unwrap();
        let bands = EXTENT
            .rows()
            .bands(2)
            .into_iter()
            .map(|rows| testing::with_context(rows, &ALL, |cx| node.run(In {}, cx)).0.unwrap());
        let mut parts: (Vec<EventStream>, Vec<FrameSequence>, Vec<FrameSequence>) = Default::default();
        for (band, rows) in bands.zip(EXTENT.rows().bands(2)) {
            let (events, frames, truth) = (band.events.unwrap(), band.frames.unwrap(), band.truth.unwrap().0);
            assert_eq!((events.rows(), frames.rows(), truth.rows()), (rows, rows, rows));
            assert_eq!(band.sensor.unwrap().name, "small");
            parts.0.push(events);
            parts.1.push(frames);
            parts.2.push(truth);
        }
        let (read_events, read_frames, read_truth) =
            (EventStream::splice(parts.0), FrameSequence::splice(parts.1), FrameSequence::splice(parts.2));
        assert_eq!(
            metas[..3],
            [
                Meta::Events(read_events.meta.clone()),
                Meta::Frames(read_frames.meta.clone()),
                Meta::Truth(read_truth.meta.clone())
            ]
        );
        let rows = EXTENT.rows();
        assert_eq!(read_frames.read_rows(rows).unwrap(), frames.read_rows(rows).unwrap());
        assert_eq!(read_frames.meta.times, frames.meta.times);
        assert_eq!(read_truth.read_rows(rows).unwrap(), truth.0.read_rows(rows).unwrap());
        // Events of equal stamp and pixel do not occur in this data, so the order is one.
        assert_eq!(read_events.read(rows).unwrap(), events.read(rows).unwrap());
    }

    #[test]
    fn what_a_recording_does_not_have_is_absent_with_the_reason() {
        let (_folder, node) = node(&RecordingContent::empty(EXTENT));
        let why = |meta: &Meta| {
            if let Meta::Absent { data_type, why } = meta {
                format!("{data_type}: {why}")
            } else {
                panic!("present")
            }
        };
        let found: Vec<String> = plan(&node).unwrap().iter().map(why).collect();
        assert_eq!(
            found,
            [
                "events: rec.h5 has no /events",
                "frames: rec.h5 has no /frames",
                "truth: rec.h5 has no /truth",
                "sensor: rec.h5 has no /sensor"
            ]
        );
        let (out, notes) = testing::with_context(EXTENT.rows(), &ALL, |cx| node.run(In {}, cx));
        let out = out.unwrap();
        assert!(
            out.events.is_none()
                && out.frames.is_none()
                && out.truth.is_none()
                && out.sensor.is_none()
                && notes.is_empty()
        );
    }

    #[test]
    fn a_stream_without_events_is_still_a_stream() {
        let none = testing::stream(EXTENT, Vec::new());
        let (_folder, node) =
            node(&RecordingContent { events: Some(&none), ..RecordingContent::empty(EXTENT) });
        let Meta::Events(meta) = &plan(&node).unwrap()[0] else { panic!("events") };
        assert_eq!((meta.span, meta.extent), (None, EXTENT));
        let rows = Rows { start: 1, end: 3 };
        let (out, _) = testing::with_context(rows, &ALL, |cx| node.run(In {}, cx));
        assert!(out.unwrap().events.unwrap().read(rows).unwrap().is_empty());
    }

    #[test]
    fn only_what_is_wanted_is_given() {
        let (events, frames) = (testing::events(6, 5), testing::frames(6, 5, 3));
        let (_folder, node) = node(&RecordingContent {
            events: Some(&events),
            frames: Some(&frames),
            sensor: Some(SENSOR),
            ..RecordingContent::empty(EXTENT)
        });
        let (out, _) = testing::with_context(EXTENT.rows(), &["frames"], |cx| node.run(In {}, cx));
        let out = out.unwrap();
        assert!(out.frames.is_some() && out.events.is_none() && out.sensor.is_none());
    }

    #[test]
    fn the_recorders_row_time_wins_and_the_difference_is_noted() {
        let frames = testing::captured(EXTENT, vec![Exposure::new(0, 10)], 30_000, |_, _, _| 1.0);
        let (_folder, node) = node(&RecordingContent {
            frames: Some(&frames),
            sensor: Some(SENSOR),
            ..RecordingContent::empty(EXTENT)
        });
        let Meta::Frames(meta) = &plan(&node).unwrap()[1] else { panic!("frames") };
        assert_eq!(meta.times.row_time_ns, 30_000);
        let (_, notes) = testing::with_context(EXTENT.rows(), &ALL, |cx| node.run(In {}, cx).unwrap());
        assert_eq!(
            notes,
            ["rec.h5: /frames states a row time of 30 us, its sensor description 10 us; the first counts"]
        );
        assert_eq!(disagreement("rec.h5", Some(10_000), Some(Duration::new(10_000))), None);
    }

    #[test]
    fn a_row_time_that_is_stated_nowhere_is_not_taken_for_zero() {
        assert_eq!(row_time_ns("rec.h5", None, Some(Duration::new(7))).unwrap(), 7);
        let error = row_time_ns("rec.h5", None, None).unwrap_err();
        assert_eq!(error.message, "rec.h5 does not state the row time of its frames");
        assert!(error.hint.unwrap().ends_with("0 is a global shutter"));
    }

    #[test]
    fn a_row_time_in_the_manifest_stands_in_for_the_descriptions() {
        let (_folder, mut node) =
            node(&RecordingContent { sensor: Some(SENSOR), ..RecordingContent::empty(EXTENT) });
        let sensor = Sensor {
            frames: photocurrent_core::sensor::Frames {
                row_time: Some(Duration::new(9)),
                ..Default::default()
            },
            ..Sensor::unknown("other")
        };
        assert_eq!(node.row_time(Some(&sensor)), Some(Duration::new(9)));
        node.params.row_time = Some(Duration::new(7));
        assert_eq!(
            (node.row_time(Some(&sensor)), node.row_time(None)),
            (Some(Duration::new(7)), Some(Duration::new(7)))
        );
    }

    #[test]
    fn mistakes_in_the_embedded_description_are_shown_at_their_line() {
        let (_folder, node) = node(&RecordingContent {
            sensor: Some("format = \"photocurrent-sensor/1\"\n[frames]\nrow_tme = 3\n"),
            ..RecordingContent::empty(EXTENT)
        });
        let error = plan(&node).unwrap_err();
        assert_eq!(error.message, "the sensor description in rec.h5 (/sensor) has a mistake");
        assert_eq!(error.problems[0].at.as_ref().unwrap().to_string(), "rec.h5:/sensor:3:1");
    }

    #[test]
    fn a_file_that_is_no_recording_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notes.txt");
        std::fs::write(&path, "not HDF5").unwrap();
        let refused = |path: std::path::PathBuf| {
            plan(&ReadRecording::build(Params { path: InputPath::new(path), row_time: None }).unwrap())
                .unwrap_err()
        };
        let error = refused(path);
        assert!(error.message.contains("notes.txt") && error.hint.is_some(), "{error}");
        let error = refused("no/such.h5".into());
        assert!(error.message.contains("no/such.h5: there is no such file"), "{error}");
        assert_eq!(error.param.as_deref(), Some("path"));
    }
}
