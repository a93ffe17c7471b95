//! What users wait for: storing frames and reading them back, in bytes of f32 per second, and writing a
//! recording.
//!
//! `ordinary_*` is the same work through the library's own filters, as a yardstick for packing chunks
//! ourselves. Frames are whole numbers with photon noise, 200 x 480 x 546: 210 MB.
#![allow(clippy::unwrap_used)]

use divan::{
    Bencher,
    counter::{BytesCount, ItemsCount},
};
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::random::Random;
use photocurrent_core::{
    EventBand, EventStream, EventsMeta, Exposure, Extent, FrameSequence, Rows, Value, testing,
};
use photocurrent_store::recording::{RecordingContent, write_recording};
use photocurrent_store::{ValueWriter, open_value};
use std::path::Path;
use std::sync::{Arc, LazyLock};

const EXTENT: Extent = Extent { width: 546, height: 480 };
const FRAMES: usize = 200;

static NOISY: LazyLock<FrameSequence> = LazyLock::new(|| {
    let exposures =
        (0..FRAMES as i64).map(|l| Exposure::new(l * 1_000_000, l * 1_000_000 + 900_000)).collect();
    let mut random = Random::new(1, &[]);
    testing::captured(EXTENT, exposures, 0, |l, x, y| {
        let light = 50.0 + (f64::from(x + y) + l as f64) % 300.0;
        // Four uniform numbers: near enough to photon noise for a compressor.
        let noise: f64 = (0..4).map(|_| random.uniform() - 0.5).sum();
        (light + noise * light.sqrt()).round() as f32
    })
});

fn bytes() -> BytesCount {
    BytesCount::new(FRAMES * EXTENT.pixels() * 4)
}

fn write(path: &Path) {
    let value = Value::Frames(NOISY.clone());
    let mut writer = ValueWriter::create(path, &value.meta()).unwrap();
    EXTENT.rows().bands(32).into_iter().for_each(|rows| writer.append(&value.cut(rows)).unwrap());
    writer.finish().unwrap();
}

fn open(path: &Path) -> FrameSequence {
    match open_value(path).unwrap() {
        Value::Frames(frames) => frames,
        other => panic!("frames were written, not {other:?}"),
    }
}

#[divan::bench(sample_count = 5, sample_size = 1)]
fn write_frames(bencher: Bencher) {
    let folder = tempfile::tempdir().unwrap();
    LazyLock::force(&NOISY);
    bencher.counter(bytes()).bench(|| write(&folder.path().join("frames.h5")));
}

#[divan::bench(sample_count = 5, sample_size = 1)]
fn read_frames_by_row_band(bencher: Bencher) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frames.h5");
    write(&path);
    bencher.counter(bytes()).bench(|| {
        let frames = open(&path);
        EXTENT
            .rows()
            .bands(32)
            .into_iter()
            .map(|rows| frames.read_rows(rows).unwrap().dn.len())
            .sum::<usize>()
    });
}

#[divan::bench(sample_count = 5, sample_size = 1)]
fn read_frames_one_by_one(bencher: Bencher) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frames.h5");
    write(&path);
    bencher.counter(bytes()).bench(|| {
        let frames = open(&path);
        (0..FRAMES).map(|l| frames.read(l..l + 1, EXTENT.rows()).unwrap().dn.len()).sum::<usize>()
    });
}

#[divan::bench(sample_count = 3, sample_size = 1)]
fn ordinary_write(bencher: Bencher) {
    let folder = tempfile::tempdir().unwrap();
    let block = NOISY.read_rows(EXTENT.rows()).unwrap();
    bencher.counter(bytes()).bench(|| {
        let file = hdf5::File::create(folder.path().join("ordinary.h5")).unwrap();
        let shape = (FRAMES, EXTENT.height as usize, EXTENT.width as usize);
        let dn = file
            .new_dataset::<f32>()
            .shuffle()
            .deflate(1)
            .chunk((8, 8, shape.2))
            .shape(shape)
            .create("dn")
            .unwrap();
        dn.write_raw(&block.dn).unwrap();
        file.close().unwrap();
    });
}

#[divan::bench(sample_count = 3, sample_size = 1)]
fn ordinary_read(bencher: Bencher) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frames.h5");
    write(&path);
    bencher.counter(bytes()).bench(|| {
        hdf5::File::open(&path).unwrap().dataset("frames/dn").unwrap().read_raw::<f32>().unwrap().len()
    });
}

#[divan::bench(sample_count = 5, sample_size = 1)]
fn digest_only(bencher: Bencher) {
    let value = Value::Frames(NOISY.clone());
    bencher.counter(bytes()).bench(|| value.cut(Rows { start: 0, end: EXTENT.height }).digest().unwrap());
}

/// Eight million events of pixels that fire some tens of times in a row.
static EVENTS: LazyLock<EventStream> = LazyLock::new(|| {
    let mut random = Random::new(2, &[]);
    let mut events = Vec::new();
    for y in 0..EXTENT.height as u16 {
        for x in 0..EXTENT.width as u16 {
            let mut t = (random.uniform() * 1e9) as i64;
            for _ in 0..8_000_000 / EXTENT.pixels() {
                t += 50_000 + (random.uniform() * 1e6) as i64;
                let polarity = if random.uniform() < 0.5 { Polarity::On } else { Polarity::Off };
                events.push(Event {
                    x,
                    y,
                    polarity,
                    t: t + 1_000 + (random.uniform() * 40_000.0) as i64,
                    t_in: Some(t),
                });
            }
        }
    }
    let meta = EventsMeta {
        extent: EXTENT,
        span: None,
        has_t_in: true,
        has_step: false,
        t_resolution_ns: None,
        count_hint: None,
    };
    EventStream::in_memory(Arc::new(meta), EventBand::from_events(EXTENT.rows(), events).unwrap())
});

/// Events per second into a recording.
#[divan::bench(sample_count = 3, sample_size = 1)]
fn write_events_by_time(bencher: Bencher) {
    let folder = tempfile::tempdir().unwrap();
    let count = EVENTS.read(EXTENT.rows()).unwrap().len();
    let content = RecordingContent { events: Some(&EVENTS), ..RecordingContent::empty(EXTENT) };
    bencher
        .counter(ItemsCount::new(count))
        .bench(|| write_recording(&folder.path().join("recording.h5"), &content).unwrap());
}

/// Bytes of f32 per second into a recording of whole numbers.
#[divan::bench(sample_count = 3, sample_size = 1)]
fn write_recorded_frames(bencher: Bencher) {
    let folder = tempfile::tempdir().unwrap();
    LazyLock::force(&NOISY);
    let content = RecordingContent { frames: Some(&NOISY), ..RecordingContent::empty(EXTENT) };
    bencher
        .counter(bytes())
        .bench(|| write_recording(&folder.path().join("recording.h5"), &content).unwrap());
}

fn main() {
    divan::main();
}
