//! Files that end too early. What is left of one is compared with the whole of it, which other tests compare
//! with formulas.
#![allow(clippy::unwrap_used)]

use crate::catalog::recognise;
use crate::chunk::EventChunk;
use crate::declared::Declared;
use crate::error::{FormatError, Loss};
use crate::format::Format;
use crate::recording::EventCursor;
use photocurrent_core::{Colour, Extent};
use photocurrent_store::stream::{StreamedFrames, StreamedRecording};
use std::path::{Path, PathBuf};

/// Cuts of each file.
const CUTS: usize = 20;
const EXTENT: Extent = Extent { width: 640, height: 480 };

/// Events of a formula.
struct Made {
    next: i64,
    count: i64,
}

impl EventCursor for Made {
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        chunk.clear();
        let end = self.count.min(self.next + 10_000);
        // Places that no filter shrinks much.
        let place = |i: i64, sides: i64| {
            (i.wrapping_mul(0x9e37_79b9_7f4a_7c15u64 as i64) >> 33).rem_euclid(sides) as u16
        };
        (self.next..end).for_each(|i| chunk.push(i * 13_000, place(i, 640), place(i + 7, 480), i % 3 == 0));
        self.next = end;
        Ok(!chunk.is_empty())
    }
    fn seek(&mut self, _: i64) -> Result<(), FormatError> {
        self.next = 0;
        Ok(())
    }
    fn losses(&self) -> Vec<Loss> {
        Vec::new()
    }
    fn position(&self) -> (u64, u64) {
        (self.next as u64, self.count as u64)
    }
}

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/formats").join(name)
}

/// t, x, y, ON.
type Row = (i64, u16, u16, u8);

/// Events as rows, and everything that was lost.
fn all(path: &Path, format: &Format) -> Result<(Vec<Row>, Vec<Loss>), FormatError> {
    let recording = (format.open)(path, &Declared::default())?;
    let (mut cursor, mut chunk, mut events) = (recording.events()?, EventChunk::default(), Vec::new());
    while cursor.next(&mut chunk)? {
        events.extend((0..chunk.len()).map(|i| (chunk.t[i], chunk.x[i], chunk.y[i], chunk.on[i])));
    }
    if let Some(pictures) = recording.pictures() {
        let mut values = Vec::new();
        for frame in 0..pictures.about().stamps.len() {
            pictures.read(frame, &mut values)?;
        }
    }
    Ok((events, [recording.losses(), cursor.losses()].concat()))
}

/// Cuts a file at many places: every cut is refused with its byte, or gives events of the whole file in their
/// order and says what is lost. Gives the number of events after each cut.
fn cut_everywhere(whole: &Path) -> Vec<usize> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.h5");
    let format = recognise(whole).unwrap().unwrap();
    let (events, losses) = all(whole, format).unwrap();
    assert!(losses.is_empty() && events.len() >= 1000, "{losses:?}");
    let bytes = std::fs::read(whole).unwrap();
    let mut left = Vec::new();
    for k in 1..=CUTS {
        let length = bytes.len() * k / (CUTS + 1);
        std::fs::write(&path, &bytes[..length]).unwrap();
        let byte = format!("cut at byte {length} of {}", bytes.len());
        let (found, losses) = match all(&path, format) {
            Ok((found, losses)) => {
                assert!(losses[0].what.contains(&byte), "{losses:?}");
                assert!(
                    found.len() == events.len()
                        || losses.iter().any(|loss| loss.what.contains("its events are lost")),
                    "{losses:?}"
                );
                assert!(losses.len() <= 12, "one loss for each column: {losses:?}");
                (found, losses)
            }
            Err(error) => {
                assert!(error.found.contains(&byte), "{error}");
                (Vec::new(), Vec::new())
            }
        };
        // Without `t_offset` times count from zero, and a loss says so.
        let offset = if found.is_empty() || losses.iter().all(|loss| loss.at != "/t_offset") {
            0
        } else {
            events[0].0 - found[0].0
        };
        let mut rest = events.iter();
        let in_order = found.iter().all(|&(t, x, y, on)| rest.any(|other| *other == (t + offset, x, y, on)));
        assert!(in_order, "cut {k}: events of the file in their order");
        left.push(found.len());
    }
    left
}

#[test]
fn our_own_files_give_what_stands_before_the_cut() {
    let folder = tempfile::tempdir().unwrap();
    let (ours, dsec) = (folder.path().join("ours.h5"), folder.path().join("dsec.h5"));
    let made = || Made { next: 0, count: 3_000_000 };
    let read = |frame: usize, values: &mut Vec<f32>| {
        *values = vec![frame as f32; EXTENT.pixels()];
        Ok(())
    };
    let exposures = (0..20).map(|k| (k * 100_000_000, k * 100_000_000 + 5_000_000)).collect();
    let frames = StreamedFrames {
        extent: EXTENT,
        colour: Colour::Mono,
        dn: photocurrent_store::DnType::U16,
        row_time_ns: 0,
        exposures,
        read: &read,
    };
    let content = StreamedRecording {
        extent: EXTENT,
        events: Some(false),
        t_resolution_ns: Some(1000),
        frames: Some(frames),
        sensor: None,
    };
    super::write::write_recording(&ours, Some(&mut made()), &content).unwrap();
    super::write::write_dsec(&dsec, &mut made(), EXTENT, false).unwrap();
    for path in [ours, dsec] {
        let left = cut_everywhere(&path);
        assert!(left.is_sorted(), "a later cut loses no more: {left:?}");
        // Columns are written by turns, a million events at a time: cuts in the later half leave events.
        assert!(
            left[CUTS / 2..].iter().all(|&events| events > 0) && left[CUTS / 2] < 3_000_000,
            "{}: {left:?}",
            path.display()
        );
    }
}

#[test]
fn files_of_others_give_what_stands_before_the_cut() {
    for name in [
        "dsec_blosc_zstd.h5",
        "mvsec.h5",
        "prophesee_plain.h5",
        "prophesee_ecf.h5",
        "m3ed.h5",
        "v2e.h5",
        "event_utils.h5",
    ] {
        let left = cut_everywhere(&fixture(name));
        println!("{name}: {left:?}");
        assert!(left[CUTS - 1] > 0, "{name}: {left:?}");
    }
}
