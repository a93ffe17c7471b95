//! Recordings: what is written comes back, and every contradiction is reported with file, dataset, finding
//! and next step.
#![allow(clippy::unwrap_used)]

use hdf5::types::VarLenUnicode;
use photocurrent_core::frames::{FrameScale, FrameTimes};
use photocurrent_core::{testing, *};
use photocurrent_store::{DnCode, DnType, Recording, RecordingContent, write_recording, write_rendered};
use std::path::Path;
use std::sync::Arc;

const EXTENT: Extent = Extent { width: 12, height: 9 };

fn truth() -> Truth {
    let frames = testing::frames(EXTENT.width, EXTENT.height, 6);
    let times = FrameTimes::new((0..6).map(|m| Exposure::new(m * 500, m * 500 + 1)).collect(), 0).unwrap();
    let meta =
        FramesMeta { times, scale: FrameScale::Nominal { exposure_ns: 4_000_000 }, ..(*frames.meta).clone() };
    Truth(FrameSequence::in_memory(Arc::new(meta), frames.read_rows(frames.rows()).unwrap()))
}

fn write_full(path: &Path) -> (EventStream, FrameSequence, Truth) {
    let (events, frames, truth) = (
        testing::events(EXTENT.width, EXTENT.height),
        testing::frames(EXTENT.width, EXTENT.height, 5),
        truth(),
    );
    let content = RecordingContent {
        events: Some(&events),
        frames: Some(&frames),
        sensor: Some("format = \"photocurrent-sensor/1\"\n"),
        truth: Some(&truth),
        ..RecordingContent::empty(EXTENT)
    };
    write_recording(path, &content).unwrap();
    (events, frames, truth)
}

#[test]
fn a_recording_comes_back_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("egg.h5");
    let (events, frames, truth) = write_full(&path);
    let back = Recording::open(&path).unwrap();
    assert_eq!(back.extent(), EXTENT);
    assert_eq!(back.row_time_ns(), Some(10_000));
    assert_eq!(back.sensor_text(), Some("format = \"photocurrent-sensor/1\"\n"));
    assert_eq!(
        Value::Events(back.events().unwrap()).digest().unwrap(),
        Value::Events(events.clone()).digest().unwrap()
    );
    assert_eq!(
        Value::Frames(back.frames(10_000).unwrap()).digest().unwrap(),
        Value::Frames(frames).digest().unwrap()
    );
    assert_eq!(Value::Truth(back.truth().unwrap()).digest().unwrap(), Value::Truth(truth).digest().unwrap());
    for rows in EXTENT.rows().bands(4) {
        assert_eq!(back.read_events(rows).unwrap(), events.read(rows).unwrap());
    }
    let leftovers: Vec<_> = std::fs::read_dir(folder.path()).unwrap().collect();
    assert_eq!(leftovers.len(), 1, "no temporary file stays");
}

/// What another program reads from a file of rendered frames: the values, and both attributes of the code.
fn plain<T: hdf5::H5Type>(path: &Path) -> (Vec<T>, Vec<usize>, Option<(f64, f64)>) {
    let file = hdf5::File::open(path).unwrap();
    let dn = file.dataset("frames/dn").unwrap();
    let number = |name: &str| dn.attr(name).and_then(|attribute| attribute.read_scalar::<f64>()).ok();
    let times = |name: &str| file.dataset(name).unwrap().read_raw::<i64>().unwrap();
    assert_eq!(
        file.attr("format").unwrap().read_scalar::<VarLenUnicode>().unwrap().as_str(),
        "photocurrent-frames/1"
    );
    assert_eq!(
        file.group("frames").unwrap().attr("exposure_dn_of_ns").unwrap().read_scalar::<i64>().unwrap(),
        6_500_000
    );
    assert_eq!(
        times("frames/exposure_end")
            .iter()
            .zip(times("frames/exposure_start"))
            .filter(|(end, start)| **end > *start)
            .count(),
        dn.shape()[0]
    );
    (dn.read_raw::<T>().unwrap(), dn.shape(), number("scale_factor").zip(number("add_offset")))
}

#[test]
fn rendered_frames_are_one_file_of_values_or_of_codes_with_their_scale() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frames.h5");
    let frames = testing::frames(EXTENT.width, EXTENT.height, 5);
    let dn = frames.read_rows(frames.rows()).unwrap().dn;
    write_rendered(&path, &frames, 6_500_000, None).unwrap();
    let (values, shape, code) = plain::<f32>(&path);
    assert_eq!((values.as_slice(), shape.as_slice(), code), (dn.as_slice(), &[5, 9, 12][..], None));
    let code = DnCode { offset: -3.0, scale: 0.125 };
    write_rendered(&path, &frames, 6_500_000, Some(code)).unwrap();
    let (codes, shape, found) = plain::<u16>(&path);
    let (scale, offset) = found.unwrap();
    assert_eq!((shape.as_slice(), scale, offset), (&[5, 9, 12][..], 0.125, -3.0));
    // Half a code is the best that rounding can do, and nothing lies beyond the codes here.
    assert!(
        codes
            .iter()
            .zip(&dn)
            .all(|(code, dn)| (offset + scale * f64::from(*code) - f64::from(*dn)).abs() <= scale / 2.0)
    );
    assert!(codes.iter().any(|code| *code != codes[0]));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file stays");
}

#[test]
fn a_summary_needs_the_header_only() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("egg.h5");
    write_full(&path);
    let summary = Recording::open(&path).unwrap().inspect();
    let (events, frames) = (summary.events.unwrap(), summary.frames.unwrap());
    assert_eq!((events.count, events.has_t_in), (1080, true));
    assert!((events.events_per_s.unwrap() / 10_800.0 - 1.0).abs() < 0.05);
    assert_eq!((frames.count, frames.frames_per_s, frames.row_time_ns), (5, Some(100.0), Some(10_000)));
    assert_eq!(frames.exposure.unwrap().median_ns, 4_000_000);
    assert_eq!((frames.colour, frames.channels, frames.number_type), (Colour::Mono, 1, "f32"));
    assert_eq!(summary.truth.unwrap().count, 6);
    assert!(summary.has_sensor);
}

#[test]
fn either_stream_may_be_missing_or_empty() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("egg.h5");
    write_recording(&path, &RecordingContent::empty(EXTENT)).unwrap();
    let back = Recording::open(&path).unwrap();
    assert!(
        back.events().is_none()
            && back.frames(0).is_none()
            && back.truth().is_none()
            && back.sensor_text().is_none()
    );
    assert!(back.read_events(EXTENT.rows()).unwrap().is_empty());

    let events = testing::stream(EXTENT, Vec::new());
    let one = testing::frames(EXTENT.width, EXTENT.height, 1);
    let none = testing::frames(EXTENT.width, EXTENT.height, 0);
    for frames in [&one, &none] {
        write_recording(
            &path,
            &RecordingContent {
                events: Some(&events),
                frames: Some(frames),
                ..RecordingContent::empty(EXTENT)
            },
        )
        .unwrap();
        let back = Recording::open(&path).unwrap();
        assert_eq!((back.event_count(), back.events_meta().unwrap().span), (0, None));
        assert!(back.events().unwrap().read(EXTENT.rows()).unwrap().is_empty());
        assert_eq!(back.frames(10_000).unwrap().len(), frames.len());
        assert_eq!(
            back.frames(10_000).unwrap().read_rows(EXTENT.rows()).unwrap().dn,
            frames.read_rows(EXTENT.rows()).unwrap().dn
        );
        assert_eq!(back.inspect().frames.unwrap().frames_per_s, None);
    }
}

#[test]
fn whole_numbers_and_colour_are_read_as_f32() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("egg.h5");
    let exposures = vec![Exposure::new(0, 5), Exposure::new(10, 15)];
    let frames = testing::captured(EXTENT, exposures, 0, |l, x, y| (l * 60_000) as f32 + (x * y) as f32);
    write_recording(
        &path,
        &RecordingContent { frames: Some(&frames), dn: DnType::U16, ..RecordingContent::empty(EXTENT) },
    )
    .unwrap();
    let back = Recording::open(&path).unwrap();
    assert_eq!(back.inspect().frames.unwrap().number_type, "u16");
    assert_eq!(
        back.frames(0).unwrap().read(1..2, Rows { start: 2, end: 7 }).unwrap(),
        frames.read(1..2, Rows { start: 2, end: 7 }).unwrap()
    );

    let wide = testing::frames(EXTENT.width * 3, EXTENT.height, 2);
    let meta = FramesMeta { extent: EXTENT, colour: Colour::Rgb, ..(*wide.meta).clone() };
    let rgb = FrameSequence::in_memory(Arc::new(meta), wide.read_rows(wide.rows()).unwrap());
    write_recording(&path, &RecordingContent { frames: Some(&rgb), ..RecordingContent::empty(EXTENT) })
        .unwrap();
    let back = Recording::open(&path).unwrap();
    assert_eq!(back.colour(), Some(Colour::Rgb));
    let rows = Rows { start: 3, end: 5 };
    assert_eq!(back.frames(0).unwrap().read(1..2, rows).unwrap(), rgb.read(1..2, rows).unwrap());
    drop(back);
    let file = hdf5::File::append(&path).unwrap();
    file.group("frames").unwrap().delete_attr("colour").unwrap();
    file.close().unwrap();
    assert!(
        Recording::open(&path)
            .err()
            .unwrap()
            .to_string()
            .contains("/frames/dn: found 3 channels, expected 1 for colour = \"mono\"")
    );
}

#[test]
fn a_mosaic_of_more_pixels_than_the_events_comes_back_with_its_truth() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("egg.h5");
    let mosaic = |frames: FrameSequence, colour| {
        let meta = FramesMeta { colour, ..(*frames.meta).clone() };
        FrameSequence::in_memory(Arc::new(meta), frames.read_rows(frames.rows()).unwrap())
    };
    let colour = Colour::named("quad_bayer_grbg").unwrap();
    let (events, frames) =
        (testing::events(EXTENT.width, EXTENT.height), mosaic(testing::frames(48, 36, 3), colour));
    let rgb =
        testing::captured(Extent { width: 144, height: 36 }, vec![Exposure::new(5, 6)], 0, |_, x, y| {
            (x * y) as f32
        });
    let meta =
        FramesMeta { extent: Extent { width: 48, height: 36 }, colour: Colour::Rgb, ..(*rgb.meta).clone() };
    let truth = Truth(FrameSequence::in_memory(Arc::new(meta), rgb.read_rows(rgb.rows()).unwrap()));
    let content = RecordingContent {
        events: Some(&events),
        frames: Some(&frames),
        truth: Some(&truth),
        ..RecordingContent::empty(EXTENT)
    };
    write_recording(&path, &content).unwrap();
    let back = Recording::open(&path).unwrap();
    assert_eq!(
        Value::Frames(back.frames(10_000).unwrap()).digest().unwrap(),
        Value::Frames(frames).digest().unwrap()
    );
    let read = back.truth().unwrap().0;
    assert_eq!((read.meta.extent, read.meta.colour), (truth.0.meta.extent, Colour::Rgb));
    assert_eq!(read.read_rows(read.rows()).unwrap(), truth.0.read_rows(truth.0.rows()).unwrap());
    let summary = back.inspect().frames.unwrap();
    assert_eq!(
        (summary.width, summary.height, summary.pixels_per_event_pixel, summary.colour),
        (48, 36, 4, colour)
    );
}

/// Columns of a small recording as other programs write it: no chunks, no filters.
struct Plain {
    x: Vec<u16>,
    y: Vec<u16>,
    p: Vec<u8>,
    t: Vec<i64>,
    t_in: Option<Vec<i64>>,
}

impl Plain {
    fn good() -> Plain {
        Plain {
            x: vec![1, 0, 2, 1],
            y: vec![0, 1, 1, 0],
            p: vec![1, 0, 1, 1],
            t: vec![10, 20, 20, 35],
            t_in: Some(vec![9, 12, 19, 35]),
        }
    }

    fn write(&self, path: &Path) -> hdf5::File {
        let file = header(path);
        let events = file.create_group("events").unwrap();
        events.new_dataset_builder().with_data(&self.x).create("x").unwrap();
        events.new_dataset_builder().with_data(&self.y).create("y").unwrap();
        events.new_dataset_builder().with_data(&self.p).create("p").unwrap();
        times(&events, "t", &self.t);
        if let Some(t_in) = &self.t_in {
            times(&events, "t_in", t_in);
        }
        file
    }

    fn complaint(&self) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bad.h5");
        self.write(&path).close().unwrap();
        let whole = |rows| {
            Recording::open(&path)
                .and_then(|recording| recording.read_events(rows))
                .err()
                .unwrap()
                .to_string()
        };
        let all = whole(Rows { start: 0, end: 2 });
        // The same words whichever band is read first.
        assert_eq!(whole(Rows { start: 1, end: 2 }), all);
        all
    }
}

fn header(path: &Path) -> hdf5::File {
    let file = hdf5::File::create(path).unwrap();
    text(&file, "format", "photocurrent-recording/1");
    file.new_attr::<u16>().create("width").unwrap().write_scalar(&3u16).unwrap();
    file.new_attr::<i32>().create("height").unwrap().write_scalar(&2i32).unwrap();
    file
}

fn text(location: &hdf5::Location, name: &str, text: &str) {
    let text: VarLenUnicode = text.parse().unwrap();
    location.new_attr::<VarLenUnicode>().create(name).unwrap().write_scalar(&text).unwrap();
}

fn times(group: &hdf5::Group, name: &str, values: &[i64]) {
    text(&group.new_dataset_builder().with_data(values).create(name).unwrap(), "unit", "ns");
}

#[test]
fn a_plain_file_of_another_program_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("plain.h5");
    Plain::good().write(&path).close().unwrap();
    let back = Recording::open(&path).unwrap();
    let band = back.read_events(Rows { start: 0, end: 2 }).unwrap();
    assert_eq!(
        (band.offsets(), &band.x, &band.t),
        (&[0, 2, 4][..], &vec![1, 1, 0, 2], &vec![10, 35, 20, 20])
    );
    assert_eq!(back.row_time_ns(), None);
    drop(back);
    // LZF goes through the ordinary read.
    let file = hdf5::File::append(&path).unwrap();
    file.unlink("events/p").unwrap();
    file.new_dataset_builder().with_data(&[1u8, 0, 1, 1]).chunk(3).lzf().create("events/p").unwrap();
    file.close().unwrap();
    assert_eq!(
        Recording::open(&path).unwrap().read_events(Rows { start: 0, end: 2 }).unwrap().on,
        [1, 1, 0, 1]
    );
}

#[test]
fn events_that_contradict_the_format_are_reported_with_count_and_place() {
    let good = Plain::good;
    let cases = [
        (
            Plain { x: vec![1, 3, 2, 9], ..good() },
            "/events/x, /events/y: found 2 events outside the sensor, the first at index 1 (x = 3, y = 1)",
        ),
        (
            Plain { y: vec![0, 1, 1, 2], ..good() },
            "found 1 event outside the sensor, the first at index 3 \
                                                   (x = 1, y = 2), expected x below 3 and y below 2",
        ),
        (
            Plain { p: vec![1, 255, 1, 1], ..good() },
            "/events/p: found 1 event with another polarity, the first at index 1 (p = 255)",
        ),
        (
            Plain { t: vec![10, 20, 19, 35], ..good() },
            "/events/t: found 1 event earlier than the event ahead, the first at index 2 (19 ns after 20 ns)",
        ),
        (
            Plain { t_in: Some(vec![9, 21, 19, 36]), ..good() },
            "/events/t_in: found 2 events with its in-pixel time after its off-pixel time, the first at \
             index 1",
        ),
        (
            Plain { x: vec![1, 0, 2], ..good() },
            "/events/x: found the shape [3], expected [4], as /events/t has",
        ),
        (Plain { t_in: Some(vec![1]), ..good() }, "/events/t_in: found the shape [1], expected [4]"),
    ];
    for (plain, expected) in cases {
        let complaint = plain.complaint();
        assert!(
            complaint.contains(expected) && complaint.contains("hint: ") && complaint.contains("bad.h5"),
            "{complaint}"
        );
    }
}

fn complaint(make: impl FnOnce(&Path)) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.h5");
    make(&path);
    let error = Recording::open(&path).err().unwrap().to_string();
    assert!(error.contains("bad.h5"), "{error}");
    error
}

fn with_frames(shape: (usize, usize, usize), start: &[i64], end: &[i64]) -> impl FnOnce(&Path) {
    let (start, end) = (start.to_vec(), end.to_vec());
    move |path| {
        let file = header(path);
        let frames = file.create_group("frames").unwrap();
        let dn = frames.new_dataset::<f32>().shape(shape).create("dn").unwrap();
        dn.write_raw(&vec![1.0f32; shape.0 * shape.1 * shape.2]).unwrap();
        times(&frames, "exposure_start", &start);
        times(&frames, "exposure_end", &end);
    }
}

#[test]
fn a_header_that_contradicts_the_format_is_reported() {
    let says = |make: Box<dyn FnOnce(&Path)>, expected: &str| {
        let found = complaint(make);
        assert!(found.contains(expected), "{found}\nshould contain {expected}");
    };
    says(Box::new(|path| hdf5::File::create(path).unwrap().close().unwrap()), "found no attribute `format`");
    says(
        Box::new(|path| text(&hdf5::File::create(path).unwrap(), "format", "other/2")),
        "found format = \"other/2\", expected format = \"photocurrent-recording/1\"",
    );
    says(
        Box::new(|path| text(&hdf5::File::create(path).unwrap(), "format", "photocurrent-recording/1")),
        "found no attribute `width`",
    );
    says(
        Box::new(|path| Plain::good().write(path).unlink("events/p").unwrap()),
        "/events/p: found nothing, expected a dataset of uint8",
    );
    says(
        Box::new(|path| Plain::good().write(path).unlink("events/t").unwrap()),
        "/events/t: found nothing, expected a dataset of int64",
    );
    says(
        Box::new(|path| Plain::good().write(path).dataset("events/t").unwrap().delete_attr("unit").unwrap()),
        "/events/t: found no attribute `unit`",
    );
    let wrong_type = |path: &Path| {
        let file = Plain::good().write(path);
        file.unlink("events/x").unwrap();
        file.new_dataset_builder().with_data(&[1i64, 0, 2, 1]).create("events/x").unwrap();
    };
    says(Box::new(wrong_type), "/events/x: found numbers of type int64, expected numbers of type uint16");
    says(
        Box::new(with_frames((2, 2, 3), &[0, 10], &[5, 10])),
        "/frames/exposure_end: found an empty exposure in 1 of 2 frames, first in frame 1 (10 to 10 ns)",
    );
    says(
        Box::new(with_frames((2, 2, 3), &[10, 0], &[15, 5])),
        "/frames/exposure_start: found frame 1 starting at 0 ns, before frame 0 at 10 ns",
    );
    says(
        Box::new(with_frames((2, 2, 3), &[0], &[5])),
        "/frames/exposure_start: found the shape [1], expected [2], as /frames/dn has",
    );
    for (height, width) in [(3, 3), (4, 9), (1, 1)] {
        let expected = format!(
            "/frames/dn: found frames of {width} x {height} pixels, expected 3 x 2, as \
                                the attributes say, or a whole multiple of it"
        );
        says(Box::new(with_frames((2, height, width), &[0, 10], &[5, 15])), &expected);
    }
    let coloured = |colour: &'static str| {
        move |path: &Path| {
            with_frames((2, 4, 6), &[0, 10], &[5, 15])(path);
            text(&hdf5::File::append(path).unwrap().group("frames").unwrap(), "colour", colour);
        }
    };
    says(
        Box::new(coloured("bayer_rgbg")),
        "/frames: attribute `colour`: found \"bayer_rgbg\", expected mono, rgb, bayer_rggb",
    );
    says(Box::new(coloured("rgb")), "/frames/dn: found 1 channels, expected 3 for colour = \"rgb\"");
    says(Box::new(|path| std::fs::write(path, "not at all").unwrap()), "is no HDF5 file");
    says(Box::new(|path| std::fs::write(path, "").unwrap()), "the file is empty");
    says(Box::new(|path| std::fs::create_dir(path).unwrap()), "no regular file");
}

#[test]
fn independent_mistakes_are_reported_together() {
    let found = complaint(|path| {
        let file = Plain::good().write(path);
        file.delete_attr("width").unwrap();
        file.dataset("events/t").unwrap().delete_attr("unit").unwrap();
        file.unlink("events/p").unwrap();
        let frames = file.create_group("frames").unwrap();
        frames.new_dataset::<f32>().shape((2, 2, 3)).create("dn").unwrap().write_raw(&[1.0f32; 12]).unwrap();
        text(&frames, "colour", "bayer_rgbg");
        times(&frames, "exposure_start", &[0, 10, 20]);
    });
    let parts = [
        "6 mistakes",
        "/: found no attribute `width`",
        "/events/t: found no attribute `unit`",
        "/events/p: found nothing",
        "/frames: attribute `colour`: found \"bayer_rgbg\"",
        "/frames/exposure_start: found the shape [3], expected [2]",
        "/frames/exposure_end: found nothing",
    ];
    parts.iter().for_each(|part| assert!(found.contains(part), "`{part}` in\n{found}"));
    // Of events, too: every kind of mistake, each with its count.
    let found = Plain { x: vec![1, 3, 2, 9], p: vec![1, 255, 1, 1], ..Plain::good() }.complaint();
    assert!(
        found.contains("2 mistakes")
            && found.contains("2 events outside the sensor")
            && found.contains("1 event with another polarity"),
        "{found}"
    );
}

#[test]
fn unknown_values_in_frames_are_data() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("egg.h5");
    let frames = testing::captured(
        EXTENT,
        vec![Exposure::new(0, 5)],
        0,
        |_, x, _| if x == 3 { f32::NAN } else { 1.0 },
    );
    write_recording(&path, &RecordingContent { frames: Some(&frames), ..RecordingContent::empty(EXTENT) })
        .unwrap();
    let block = Recording::open(&path).unwrap().frames(0).unwrap().read_rows(EXTENT.rows()).unwrap();
    assert!(block.row(0, 4)[3].is_nan() && block.row(0, 4)[2] == 1.0);
}

#[test]
fn a_recording_that_is_cut_short_is_an_error_at_any_length() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, path) = (folder.path().join("egg.h5"), folder.path().join("bad.h5"));
    write_full(&whole);
    let bytes = std::fs::read(&whole).unwrap();
    for cut in 0..20 {
        std::fs::write(&path, &bytes[..bytes.len() * cut / 20 + cut % 7]).unwrap();
        let error = Recording::open(&path).err().unwrap().to_string();
        assert!(error.contains("bad.h5"), "{error}");
    }
}

#[test]
fn a_file_that_somebody_writes_is_not_called_damaged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("egg.h5");
    write_full(&path);
    let writer = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
    writer.lock().unwrap();
    // A library that was built or set not to lock reads it all the same.
    if let Err(error) = Recording::open(&path) {
        let error = error.to_string();
        assert!(
            error.contains("egg.h5") && error.contains("another program has the file open for writing"),
            "{error}"
        );
    }
    drop(writer);
    Recording::open(&path).unwrap();
}

#[test]
fn a_dataset_stored_in_another_file_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let secret = folder.path().join("secret");
    std::fs::write(&secret, [7u8; 4]).unwrap();
    let path = folder.path().join("bad.h5");
    let file = Plain::good().write(&path);
    file.unlink("events/p").unwrap();
    file.new_dataset::<u8>()
        .no_chunk()
        .external(secret.to_str().unwrap(), 0, 4)
        .shape(4)
        .create("events/p")
        .unwrap();
    file.close().unwrap();
    let error = Recording::open(&path).err().unwrap().to_string();
    assert!(error.contains("/events/p: found a dataset whose bytes lie in other files"), "{error}");
}

#[test]
fn an_absurd_claim_takes_no_memory() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.h5");
    let file = Plain::good().write(&path);
    for name in ["x", "y", "p", "t", "t_in"] {
        file.unlink(&format!("events/{name}")).unwrap();
    }
    let huge = 1usize << 50;
    text(
        &file.new_dataset::<i64>().chunk(1024).deflate(1).shape(huge).create("events/t").unwrap(),
        "unit",
        "ns",
    );
    file.close().unwrap();
    let error = Recording::open(&path).err().unwrap().to_string();
    assert!(
        error.contains(
            "/events/t: found a shape [1125899906842624] of 8-byte numbers, but only 0 bytes are stored"
        ),
        "{error}"
    );
}
