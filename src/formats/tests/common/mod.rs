//! What the quick test of changed files and the long one share: small whole files of every format, ways to
//! change them, and a reader that asks for everything.
#![allow(dead_code, missing_docs, clippy::unwrap_used, clippy::should_implement_trait)]

pub mod seeds;

use photocurrent_formats::{Declared, EventChunk, Format, recognise};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::{Duration, SystemTime};

/// Inputs that were written.
static INPUTS: AtomicU64 = AtomicU64::new(1);
/// Events that are read of one input; no seed has near as many, and what a bomb unpacks is not waited for.
const MOST_EVENTS: usize = 1 << 21;
/// Pictures that are read of one input.
const MOST_PICTURES: usize = 4;

/// One recording: the files of a folder, or one file of any name.
#[derive(Clone)]
pub struct Seed {
    /// The format that reads it.
    pub format: &'static str,
    /// Names and contents; a single file is opened itself, several through their folder.
    pub files: Vec<(String, Vec<u8>)>,
    /// What its format leaves open.
    pub declared: Declared,
}

impl Seed {
    /// One file.
    pub fn file(format: &'static str, name: &str, bytes: Vec<u8>, declared: &Declared) -> Seed {
        Seed { format, files: vec![(name.into(), bytes)], declared: declared.clone() }
    }

    /// Bytes in all.
    pub fn bytes(&self) -> usize {
        self.files.iter().map(|(_, bytes)| bytes.len()).sum()
    }

    /// Writes it into an empty place and gives the path to open. Files that have not changed since `before`
    /// are left as they are.
    pub fn write(&self, place: &Path, before: Option<&Seed>) -> PathBuf {
        for (k, (name, bytes)) in self.files.iter().enumerate() {
            if before.is_some_and(|before| before.files[k].1 == *bytes) {
                continue;
            }
            let path = place.join(name);
            if before.is_none() {
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            }
            std::fs::write(&path, bytes).unwrap();
            // Every input has a time of its own, in the past: whatever is remembered of a file by its time of
            // change is of this input.
            let time = SystemTime::UNIX_EPOCH + Duration::from_millis(INPUTS.fetch_add(1, Relaxed));
            std::fs::File::options().write(true).open(path).unwrap().set_modified(time).unwrap();
        }
        if let [(name, _)] = self.files.as_slice() { place.join(name) } else { place.into() }
    }
}

/// A small generator of the xorshift kind: the same inputs for the same seed on every machine.
pub struct Random(u64);

impl Random {
    /// From any number.
    pub fn new(seed: u64) -> Random {
        Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    /// Below `end`, which is at least 1.
    pub fn below(&mut self, end: usize) -> usize {
        (self.next() % end as u64) as usize
    }
}

/// Changes one file of a recording in one to eight places.
pub fn mutate(seed: &Seed, random: &mut Random) -> Seed {
    let mut changed = seed.clone();
    let which = random.below(changed.files.len());
    let bytes = &mut changed.files[which].1;
    for _ in 0..1 + random.below(8) {
        change(bytes, random);
    }
    changed
}

fn change(bytes: &mut Vec<u8>, random: &mut Random) {
    if bytes.is_empty() {
        bytes.push(random.next() as u8);
        return;
    }
    let at = random.below(bytes.len());
    let most = 1 << random.below(7);
    let length = 1 + random.below(most);
    match random.below(16) {
        0..4 => bytes[at] ^= 1 << random.below(8),
        4..6 => bytes[at] = random.next() as u8,
        6 => {
            bytes[at] = [0, 1, 0x7f, 0x80, 0xff, b' ', b'-', b'.', b'\n', b'9', b'e', b','][random.below(12)]
        }
        // Sizes, counts and places that are wrong.
        7..10 => {
            let numbers = [
                0,
                1,
                u64::MAX,
                i64::MAX as u64,
                u64::from(u32::MAX),
                i32::MAX as u64,
                1 << 31,
                1 << 40,
                0xffff,
                0x8000,
                bytes.len() as u64,
                random.next(),
            ];
            let number =
                numbers[random.below(numbers.len())].wrapping_add(random.below(3) as u64).wrapping_sub(1);
            let width = [2, 4, 8][random.below(3)];
            let raw = if random.below(4) == 0 {
                number.to_be_bytes()[8 - width..].to_vec()
            } else {
                number.to_le_bytes()[..width].to_vec()
            };
            let until = bytes.len().min(at + width);
            bytes[at..until].copy_from_slice(&raw[..until - at]);
        }
        10 => bytes.truncate(at),
        11 => drop(bytes.drain(at..bytes.len().min(at + length))),
        12 => {
            let more: Vec<u8> = (0..length).map(|_| random.next() as u8).collect();
            drop(bytes.splice(at..at, more));
        }
        13 => {
            let piece = bytes[at..bytes.len().min(at + length)].to_vec();
            let to = random.below(bytes.len());
            drop(bytes.splice(to..to, piece));
        }
        14 => {
            let piece = bytes[at..bytes.len().min(at + length)].to_vec();
            let to = random.below(bytes.len());
            let until = bytes.len().min(to + piece.len());
            bytes[to..until].copy_from_slice(&piece[..until - to]);
        }
        _ => bytes[at..].iter_mut().take(length).for_each(|byte| *byte = 0),
    }
}

/// What reading gave.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outcome {
    pub opened: bool,
    pub events: usize,
    pub pictures: usize,
    pub losses: usize,
}

/// Opens a recording and asks for everything. Refusals and losses are right; a panic, endless work or a
/// broken promise is not.
pub fn read(path: &Path, format: &Format, declared: &Declared) -> Outcome {
    let _ = recognise(path);
    let Ok(recording) = (format.open)(path, declared) else { return Outcome::default() };
    let mut outcome = Outcome { opened: true, ..Outcome::default() };
    let extent = recording.events_about().and_then(|about| about.extent);
    if let Ok(mut cursor) = recording.events() {
        let mut chunk = EventChunk::default();
        let mut middle = 0;
        while outcome.events < MOST_EVENTS && cursor.next(&mut chunk).unwrap_or(false) {
            assert!(
                chunk.x.len() == chunk.len() && chunk.y.len() == chunk.len() && chunk.on.len() == chunk.len(),
                "columns of one length"
            );
            assert!(chunk.on.iter().all(|&on| on <= 1), "polarity is 0 or 1");
            if let Some(extent) = extent {
                assert!(
                    chunk.x.iter().all(|&x| u32::from(x) < extent.width)
                        && chunk.y.iter().all(|&y| u32::from(y) < extent.height),
                    "an event outside"
                );
            }
            middle = chunk.t.get(chunk.len() / 2).copied().unwrap_or(middle);
            outcome.events += chunk.len();
        }
        for t in [middle, i64::MIN, i64::MAX] {
            if cursor.seek(t).is_ok() {
                let _ = cursor.next(&mut chunk);
            }
        }
        outcome.losses += cursor.losses().len();
        assert!(cursor.losses().len() < 1000, "a list of losses that stays short");
        let _ = cursor.position();
    }
    if let Some(pictures) = recording.pictures() {
        let about = pictures.about();
        let expected = about.extent.pixels() * about.colour.channels() as usize;
        let mut values = Vec::new();
        for frame in 0..about.stamps.len().min(MOST_PICTURES) {
            if pictures.read(frame, &mut values).is_ok() {
                assert_eq!(values.len(), expected, "as many values as pixels");
                outcome.pictures += 1;
            }
        }
        assert!(pictures.read(about.stamps.len(), &mut values).is_err(), "a picture beyond the last");
    }
    let _ = (recording.triggers(), recording.facts(), recording.files(), recording.sensor_text());
    outcome.losses += recording.losses().len();
    outcome
}
