//! Values survive the disk: every type, every band height, whole and in parts.
#![allow(clippy::unwrap_used)]

use photocurrent_core::frames::{FrameScale, FrameTimes};
use photocurrent_core::handle::Band;
use photocurrent_core::map::MapBand;
use photocurrent_core::sensor::Sensor;
use photocurrent_core::table::TableMeta;
use photocurrent_core::table::{Column, Score};
use photocurrent_core::{testing, *};
use photocurrent_store::{StoreError, ValueWriter, open_value};
use std::path::Path;
use std::sync::Arc;

fn write(path: &Path, value: &Value, height: u32) -> (Digest, u64) {
    let mut writer = ValueWriter::create(path, &value.meta()).unwrap();
    match value.rows() {
        Some(rows) => {
            rows.bands(height).into_iter().for_each(|rows| writer.append(&value.cut(rows)).unwrap())
        }
        None => writer.append(value).unwrap(),
    }
    writer.finish().unwrap()
}

fn colour_frames() -> FrameSequence {
    let grey = testing::frames(9, 21, 19);
    let meta = FramesMeta {
        extent: Extent { width: 3, height: 21 },
        colour: Colour::Rgb,
        scale: FrameScale::Nominal { exposure_ns: 7 },
        ..(*grey.meta).clone()
    };
    FrameSequence::in_memory(Arc::new(meta), grey.read_rows(grey.rows()).unwrap())
}

/// Three tracks a pixel.
fn colour_tracks() -> TrackSet {
    let grey = testing::tracks(18, 70);
    let meta =
        TracksMeta { extent: Extent { width: 6, height: 70 }, colour: Colour::Rgb, ..(*grey.meta).clone() };
    TrackSet::in_memory(Arc::new(meta), grey.read(grey.rows()).unwrap())
}

/// Tracks whose knots carry standard deviations.
fn known_tracks() -> TrackSet {
    let plain = testing::tracks(17, 70);
    let mut band = plain.read(plain.rows()).unwrap();
    band.sigma = band.photocurrent.iter().map(|i| 0.01 * i).collect();
    TrackSet::in_memory(Arc::new(TracksMeta { has_sigma: true, ..(*plain.meta).clone() }), band)
}

fn a_map() -> MapSet {
    let meta =
        MapMeta { extent: Extent { width: 7, height: 90 }, planes: vec!["cost".into(), "delay [us]".into()] };
    let mut band = MapBand::zeros(meta.extent.rows(), &meta);
    band.values
        .iter_mut()
        .enumerate()
        .for_each(|(i, value)| *value = if i % 13 == 0 { f32::NAN } else { i as f32 / 3.0 });
    MapSet::in_memory(Arc::new(meta), band)
}

fn events_with_steps() -> EventStream {
    let events = testing::events(11, 40);
    let mut band = events.read(events.rows()).unwrap();
    band.step = Some((0..band.len()).map(|i| 1.0 / (i as f32 - 7.5)).collect());
    band.t_in = None;
    EventStream::in_memory(
        Arc::new(EventsMeta {
            has_t_in: false,
            has_step: true,
            t_resolution_ns: Some(1000),
            ..(*events.meta).clone()
        }),
        band,
    )
}

fn no_events() -> EventStream {
    testing::stream(Extent { width: 5, height: 4 }, Vec::new())
}

fn banded() -> Vec<Value> {
    let mut frames = testing::frames(33, 70, 21);
    // NaN and both zeros are data, and must come back by their bits.
    let mut block = frames.read_rows(frames.rows()).unwrap();
    block.dn[..4].copy_from_slice(&[f32::NAN, -0.0, 0.0, f32::INFINITY]);
    frames = FrameSequence::in_memory(frames.meta.clone(), block);
    vec![
        Value::Events(testing::events(13, 70)),
        Value::Events(events_with_steps()),
        Value::Events(no_events()),
        Value::Frames(frames.clone()),
        Value::Frames(colour_frames()),
        Value::Frames(testing::frames(3, 4, 0)),
        Value::Frames(testing::frames(3, 4, 1)),
        Value::Truth(Truth(frames)),
        Value::Tracks(testing::tracks(17, 70)),
        Value::Light(testing::light(17, 70)),
        Value::Tracks(colour_tracks()),
        Value::Tracks(known_tracks()),
        Value::Map(a_map()),
        Value::Map(MapSet::in_memory(
            Arc::new(MapMeta { extent: Extent { width: 2, height: 3 }, planes: vec![] }),
            no_planes(),
        )),
    ]
}

fn no_planes() -> MapBand {
    MapBand::zeros(
        Rows { start: 0, end: 3 },
        &MapMeta { extent: Extent { width: 2, height: 3 }, planes: vec![] },
    )
}

#[test]
fn every_banded_type_comes_back_with_its_digest_for_any_band_height() {
    let folder = tempfile::tempdir().unwrap();
    for (i, value) in banded().into_iter().enumerate() {
        let digest = value.digest().unwrap();
        for height in [1, 7, 64, 1000] {
            let path = folder.path().join(format!("{i}-{height}.h5"));
            let (written, bytes) = write(&path, &value, height);
            assert_eq!(written, digest, "{value:?} {i} in bands of {height}");
            assert_eq!(bytes, std::fs::metadata(&path).unwrap().len());
            let back = open_value(&path).unwrap();
            assert_eq!(back.digest().unwrap(), digest, "{value:?} {i} in bands of {height}");
            assert_eq!(back.data_type(), value.data_type());
        }
    }
}

#[test]
fn equal_contents_written_alike_are_equal_files() {
    let folder = tempfile::tempdir().unwrap();
    for (i, value) in banded().into_iter().enumerate() {
        let paths = [0, 1].map(|j| folder.path().join(format!("{i}-{j}.h5")));
        for path in &paths {
            write(path, &value, 16);
        }
        assert_eq!(std::fs::read(&paths[0]).unwrap(), std::fs::read(&paths[1]).unwrap(), "{value:?} {i}");
    }
}

#[test]
fn tables_and_sensors_come_back_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("value.h5");
    let score = |frame| Score {
        metric: "psnr_db".into(),
        frame,
        t_ns: 17 * frame,
        value: 1.0 / frame as f64,
        unit: "dB".into(),
    };
    let tables = [
        Table::scores((1..40).map(score).collect(), "full frame, \u{0}\n\"quoted\" \u{1f4f7}"),
        Table::scores(Vec::new(), ""),
        Table::default(),
        Table::default()
            .with("a/b", Column::Texts(vec!["".into(), "µ\u{0}x".into()]))
            .with("n", Column::Numbers(vec![f64::NAN, -0.0])),
    ];
    for table in tables {
        let (digest, _) = write(&path, &Value::Table(Arc::new(table.clone())), 1);
        let Value::Table(back) = open_value(&path).unwrap() else { panic!("a table stays a table") };
        assert_eq!(format!("{back:?}"), format!("{table:?}"));
        assert_eq!(Value::Table(back).digest().unwrap(), digest);
    }
    let mut sensor = Sensor::unknown("hybrid");
    // Numbers that an inexact parser is known to get wrong by one unit in the last place.
    sensor.comparator.threshold_on = Some(0.1 + 0.2);
    sensor.frames.gain = Some(5e-324);
    sensor.optics.photocurrent_per_lux = Some(1.234_567_890_123_456_7e-300);
    let value = Value::Sensor(Arc::new(sensor.clone()));
    let (digest, _) = write(&path, &value, 1);
    let Value::Sensor(back) = open_value(&path).unwrap() else { panic!("a sensor stays a sensor") };
    assert_eq!(*back, sensor);
    assert_eq!(value.digest().unwrap(), digest);
}

#[test]
fn a_document_of_a_diagnosis_comes_back_byte_for_byte() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("value.h5");
    // Longer than an attribute can be, with every kind of letter, and a newline at its end.
    let long = "\u{1f4f7} \\\" \n".repeat(20_000);
    let document = Diagnosis::from_text(
        DiagnosisKind::Report,
        format!("{{\n  \"summary\": {}\n}}\n", serde_json::to_string(&long).unwrap()),
    )
    .unwrap();
    let (digest, _) = write(&path, &Value::Diagnosis(Arc::new(document.clone())), 1);
    let Value::Diagnosis(back) = open_value(&path).unwrap() else { panic!("a document stays a document") };
    assert_eq!(*back, document);
    assert_eq!(Value::Diagnosis(back).digest().unwrap(), digest);
}

#[test]
fn parts_read_like_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("value.h5");
    let frames = testing::frames(33, 70, 21);
    write(&path, &Value::Frames(frames.clone()), 16);
    let Value::Frames(back) = open_value(&path).unwrap() else { panic!("frames stay frames") };
    for (range, rows) in [
        (0..21, (0, 70)),
        (3..4, (0, 70)),
        (7..17, (5, 23)),
        (20..21, (69, 70)),
        (5..5, (0, 70)),
        (0..21, (8, 8)),
    ] {
        let rows = Rows { start: rows.0, end: rows.1 };
        assert_eq!(back.read(range.clone(), rows).unwrap(), frames.read(range, rows).unwrap());
    }
    assert!(back.read(0..22, Rows { start: 0, end: 1 }).is_err());

    let events = testing::events(13, 70);
    write(&path, &Value::Events(events.clone()), 9);
    let Value::Events(back) = open_value(&path).unwrap() else { panic!("events stay events") };
    assert_eq!(back.meta.count_hint, Some(13 * 70 * 10));
    for rows in (Rows { start: 0, end: 70 }).bands(11) {
        assert_eq!(back.read(rows).unwrap(), events.read(rows).unwrap());
    }
    assert_eq!(back.read(Rows { start: 4, end: 4 }).unwrap().len(), 0);

    let tracks = testing::tracks(17, 70);
    write(&path, &Value::Tracks(tracks.clone()), 9);
    let Value::Tracks(back) = open_value(&path).unwrap() else { panic!("tracks stay tracks") };
    for rows in (Rows { start: 0, end: 70 }).bands(11) {
        assert_eq!(back.read(rows).unwrap(), tracks.read(rows).unwrap());
    }

    let light = testing::light(17, 70);
    write(&path, &Value::Light(light.clone()), 9);
    let Value::Light(back) = open_value(&path).unwrap() else { panic!("light stays light") };
    for rows in (Rows { start: 0, end: 70 }).bands(11) {
        assert_eq!(back.read(rows).unwrap(), light.read(rows).unwrap());
    }

    let map = a_map();
    write(&path, &Value::Map(map.clone()), 9);
    let Value::Map(back) = open_value(&path).unwrap() else { panic!("maps stay maps") };
    let band = back.read(Rows { start: 13, end: 30 }).unwrap();
    let original = map.read(Rows { start: 13, end: 30 }).unwrap();
    assert!(band.rows().iter().all(|row| band.row_digest(row) == original.row_digest(row)));
}

#[test]
fn large_columns_span_many_chunks() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("value.h5");
    // 2.5 million events: more than one batch of chunks, and no multiple of any.
    let value = Value::Events(testing::events(499, 501));
    let (digest, _) = write(&path, &value, 100);
    let back = open_value(&path).unwrap();
    assert_eq!(back.digest().unwrap(), digest);
    assert_eq!(value.digest().unwrap(), digest);
}

#[test]
fn an_ordinary_reader_finds_the_documented_datasets() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("value.h5");
    let frames = testing::frames(33, 70, 21);
    write(&path, &Value::Frames(frames.clone()), 7);
    let file = hdf5::File::open(&path).unwrap();
    let dn = file.dataset("frames/dn").unwrap();
    assert_eq!(dn.shape(), [21, 70, 33]);
    assert_eq!(dn.read_raw::<f32>().unwrap(), frames.read_rows(frames.rows()).unwrap().dn);
    let ids: Vec<hdf5::filters::Filter> = dn.filters();
    assert_eq!(ids, [hdf5::filters::Filter::Shuffle, hdf5::filters::Filter::Deflate(1)]);
    let format: hdf5::types::VarLenUnicode = file.attr("format").unwrap().read_scalar().unwrap();
    assert_eq!(format.as_str(), "photocurrent-artefact/1");

    let events = testing::events(13, 70);
    write(&path.with_extension("events"), &Value::Events(events.clone()), 7);
    let file = hdf5::File::open(path.with_extension("events")).unwrap();
    let band = events.read(events.rows()).unwrap();
    assert_eq!(file.dataset("events/t").unwrap().read_raw::<i64>().unwrap(), band.t);
    assert_eq!(file.dataset("events/x").unwrap().read_raw::<u16>().unwrap(), band.x);
    assert_eq!(file.dataset("events/p").unwrap().read_raw::<u8>().unwrap(), band.on);
    let offsets: Vec<u64> = band.offsets().iter().map(|&offset| offset as u64).collect();
    assert_eq!(file.dataset("events/row_offsets").unwrap().read_raw::<u64>().unwrap(), offsets);

    let tracks = testing::tracks(17, 20);
    write(&path.with_extension("tracks"), &Value::Tracks(tracks.clone()), 7);
    let file = hdf5::File::open(path.with_extension("tracks")).unwrap();
    assert_eq!(
        file.dataset("tracks/photocurrent").unwrap().read_raw::<f32>().unwrap(),
        tracks.read(tracks.rows()).unwrap().photocurrent
    );
    let light = testing::light(17, 20);
    write(&path.with_extension("light"), &Value::Light(light.clone()), 7);
    let file = hdf5::File::open(path.with_extension("light")).unwrap();
    let band = light.read(light.rows()).unwrap();
    assert_eq!(file.dataset("light/t").unwrap().read_raw::<i64>().unwrap(), band.t);
    assert_eq!(file.dataset("light/photocurrent").unwrap().read_raw::<f32>().unwrap(), band.photocurrent);
    assert_eq!(file.dataset("light/pixel_offsets").unwrap().shape(), [17 * 20 + 1]);
    write(&path.with_extension("map"), &Value::Map(a_map()), 7);
    assert_eq!(
        hdf5::File::open(path.with_extension("map")).unwrap().dataset("map/values").unwrap().shape(),
        [90, 2, 7]
    );
}

#[test]
fn many_threads_may_read_one_value() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("value.h5");
    let frames = testing::frames(33, 70, 21);
    write(&path, &Value::Frames(frames.clone()), 7);
    let Value::Frames(back) = open_value(&path).unwrap() else { panic!("frames stay frames") };
    std::thread::scope(|scope| {
        for i in 0..8u32 {
            let (back, frames) = (&back, &frames);
            scope.spawn(move || {
                for rows in (Rows { start: i, end: 70 - i }).bands(5 + i) {
                    assert_eq!(back.read_rows(rows).unwrap(), frames.read_rows(rows).unwrap());
                }
            });
        }
    });
}

#[test]
fn a_writer_refuses_what_does_not_fit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("value.h5");
    let value = Value::Tracks(testing::tracks(3, 10));
    let message = |result: Result<(), StoreError>| result.unwrap_err().to_string();
    let mut writer = ValueWriter::create(&path, &value.meta()).unwrap();
    assert!(
        message(writer.append(&value.cut(Rows { start: 1, end: 3 })))
            .contains("rows 1..3 were appended where rows 0..10 are missing")
    );
    assert!(message(writer.append(&Value::Tracks(testing::tracks(4, 10)))).contains("announced as"));
    assert!(
        message(writer.append(&Value::Frames(testing::frames(3, 10, 1))))
            .contains("a part is frames, but the value was announced as tracks")
    );
    writer.append(&value.cut(Rows { start: 0, end: 4 })).unwrap();
    assert!(message(writer.finish().map(drop)).contains("the value is not complete: rows 4..10 are missing"));
    let absent = Meta::Absent { data_type: DataType::Frames, why: "the recording has no frames".into() };
    assert!(
        message(ValueWriter::create(&path, &absent).map(drop))
            .contains("there are no frames to write: the recording has no frames")
    );
    let empty = ValueWriter::create(&path, &Meta::Table(Arc::new(TableMeta { scores: false }))).unwrap();
    assert!(message(empty.finish().map(drop)).contains("the table is missing"));
}

#[test]
fn a_file_that_is_no_artefact_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("value.h5");
    hdf5::File::create(&path).unwrap().close().unwrap();
    assert!(
        open_value(&path)
            .unwrap_err()
            .to_string()
            .contains("found no attribute `format`, expected format = \"photocurrent-artefact/1\"")
    );
    std::fs::write(&path, "hello, world").unwrap();
    assert!(open_value(&path).unwrap_err().to_string().contains("is no HDF5 file"));
    assert!(
        open_value(&folder.path().join("nowhere.h5"))
            .unwrap_err()
            .to_string()
            .contains("cannot open the file")
    );
}

#[test]
fn a_damaged_artefact_is_an_error_and_never_a_panic() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("value.h5");
    write(&path, &Value::Frames(testing::frames(33, 30, 9)), 8);
    let bytes = std::fs::read(&path).unwrap();
    for cut in 0..20 {
        std::fs::write(&path, &bytes[..bytes.len() * cut / 20]).unwrap();
        assert!(open_value(&path).is_err(), "cut to {cut}/20");
    }
    // A wrong byte in a compressed chunk: an error or other numbers, found by the checksum of the cache;
    // never a crash.
    for at in (0..bytes.len()).rev().step_by(bytes.len() / 50).take(45) {
        let mut bytes = bytes.clone();
        bytes[at] ^= 0x5a;
        std::fs::write(&path, &bytes).unwrap();
        let _ = open_value(&path).map(|value| value.digest());
    }
}

#[test]
fn frame_times_survive_even_when_there_are_many() {
    // Their text is longer than the 64 kB that an HDF5 attribute holds.
    let exposures = (0..3000).map(|l| Exposure::new(l * 1000, l * 1000 + 999)).collect();
    let times = FrameTimes::new(exposures, 3).unwrap();
    let meta = FramesMeta {
        extent: Extent { width: 2, height: 2 },
        colour: Colour::Mono,
        times,
        scale: FrameScale::Captured,
    };
    let block = FrameBlock::zeros(0..3000, meta.extent.rows(), 2);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("value.h5");
    write(&path, &Value::Frames(FrameSequence::in_memory(Arc::new(meta.clone()), block)), 1);
    let Value::Frames(back) = open_value(&path).unwrap() else { panic!("frames stay frames") };
    assert_eq!(*back.meta, meta);
}

#[test]
fn a_window_of_stored_events_is_what_lies_within_it_however_long_a_row_is() {
    use photocurrent_core::events::Event;
    use photocurrent_core::handle::InTime;
    let extent = Extent { width: 3, height: 4 };
    let mut random = photocurrent_core::random::Random::new(9, &[]);
    // Row 1 is longer than what is looked through, and has many equal stamps; row 3 has none.
    let event = |y: u16, t: i64, x: u16| Event { x, y, polarity: Polarity::On, t, t_in: Some(t - 1) };
    let mut events: Vec<Event> = (0..200_000)
        .map(|_| (random.bits() % 5000, random.bits() % 3))
        .map(|(t, x)| event(1, t as i64, x as u16))
        .collect();
    events.extend((0..500).map(|k| event(k % 2 * 2, i64::from(k) * 10, 1)));
    let whole = testing::stream(extent, events);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("events.h5");
    write(&path, &Value::Events(whole.clone()), 64);
    let Value::Events(stored) = open_value(&path).unwrap() else { panic!("events stay events") };
    let (in_memory, mut found) = (whole.read(whole.rows()).unwrap(), 0);
    for (start, end) in [
        (i64::MIN, i64::MAX),
        (0, 1),
        (1000, 1001),
        (2400, 2600),
        (4999, 9000),
        (7000, 9000),
        (-5, 0),
        (i64::MIN, 2500),
        (2500, i64::MAX),
    ] {
        let window = TimeSpan::new(start, end);
        for rows in
            [extent.rows(), Rows { start: 1, end: 2 }, Rows { start: 2, end: 4 }, Rows { start: 2, end: 2 }]
        {
            let read = stored.read_within(rows, window).unwrap();
            assert_eq!(read, in_memory.slice(rows).within(window), "{rows} from {start} to {end}");
            found += read.len();
        }
    }
    assert!(found > 500_000);
}
