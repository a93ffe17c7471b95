//! Reads a recording of any format and prints what it gives: counts, first and last stamp, a checksum, and
//! how long it took.
//!
//! Run with `cargo run --release -p photocurrent-formats --example decode -- [--time-unit s|ms|us|ns]
//! FILE...`, or through `benches/peers.py`, which does the same with other programs. The unit is that of
//! files that do not state it. The checksum does not depend on the order of events of other readers: a sum
//! over events of t (us) + 3 x + 5 y + 7 on, modulo 2^64.

#![allow(clippy::print_stdout)]

use photocurrent_formats::{Declared, EventChunk, FormatError, Recording, TimeUnit, recognise};
use std::error::Error;
use std::path::Path;
use std::time::{Duration, Instant};

/// As often as this each file is read; the fastest counts.
const RUNS: usize = 5;

fn main() -> Result<(), Box<dyn Error>> {
    let mut declared = Declared::default();
    let mut arguments = std::env::args_os().skip(1);
    while let Some(argument) = arguments.next() {
        if argument != "--time-unit" {
            read(Path::new(&argument), &declared)?;
            continue;
        }
        let name = arguments.next().unwrap_or_default();
        let units = [("s", TimeUnit::S), ("ms", TimeUnit::Ms), ("us", TimeUnit::Us), ("ns", TimeUnit::Ns)];
        let unit = units
            .iter()
            .find(|(known, _)| name == *known)
            .ok_or_else(|| format!("--time-unit {name:?}, expected s, ms, us or ns"))?;
        declared.time_unit = Some(unit.1);
    }
    Ok(())
}

/// What the events of a file are.
#[derive(Default)]
struct Seen {
    n: u64,
    on: u64,
    first: Option<i64>,
    last: Option<i64>,
    earliest: Option<i64>,
    latest: Option<i64>,
    sum: u64,
}

impl Seen {
    fn add(&mut self, chunk: &EventChunk) {
        self.n += chunk.len() as u64;
        self.first = self.first.or(chunk.t.first().copied());
        self.last = chunk.t.last().copied().or(self.last);
        self.earliest = self.earliest.into_iter().chain(chunk.t.iter().copied()).min();
        self.latest = self.latest.into_iter().chain(chunk.t.iter().copied()).max();
        self.on += chunk.on.iter().map(|&on| u64::from(on)).sum::<u64>();
        let us = chunk.t.iter().map(|t| t.div_euclid(1000) as u64).fold(0, u64::wrapping_add);
        let sum = |values: &[u16]| values.iter().map(|&value| u64::from(value)).sum::<u64>();
        let on = chunk.on.iter().map(|&on| u64::from(on)).sum::<u64>();
        self.sum = self.sum.wrapping_add(us).wrapping_add(3 * sum(&chunk.x) + 5 * sum(&chunk.y) + 7 * on);
    }
}

fn us(t: Option<i64>) -> String {
    t.map_or("-".into(), |t| format!("{}.{:03}", t.div_euclid(1000), t.rem_euclid(1000)))
}

fn read(path: &Path, declared: &Declared) -> Result<(), Box<dyn Error>> {
    let Some(format) = recognise(path)? else {
        println!("{}: no known format", path.display());
        return Ok(());
    };
    let recording = (format.open)(path, declared)?;
    println!("{}: {} ({})", path.display(), format.name, format.id);
    recording.facts().iter().for_each(|(name, value)| println!("  {name}: {value}"));
    if let Some(about) = recording.events_about() {
        let extent = about.extent.map_or("unknown".into(), |extent| extent.to_string());
        println!("  extent {extent}, stamps: {}", about.stamps);
        let (seen, best) = timed(&*recording, || (format.open)(path, declared))?;
        println!(
            "  events {}, on {}, first {} us, last {} us, earliest {} us, latest {} us",
            seen.n,
            seen.on,
            us(seen.first),
            us(seen.last),
            us(seen.earliest),
            us(seen.latest)
        );
        println!("  sum {}", seen.sum);
        println!("  seconds {:.6}, events/s {:.0}", best.as_secs_f64(), seen.n as f64 / best.as_secs_f64());
    }
    println!("  triggers {}", recording.triggers()?.len());
    if let Some(pictures) = recording.pictures() {
        let about = pictures.about();
        println!(
            "  frames {} of {}, {:?}, {} bits",
            about.stamps.len(),
            about.extent,
            about.colour,
            about.bits
        );
        let mut values = Vec::new();
        let (mut sum, mut best) = (0.0, Duration::MAX);
        for run in 0..RUNS {
            let start = Instant::now();
            let Some(pictures) = (format.open)(path, declared)?.pictures() else { break };
            for frame in 0..pictures.about().stamps.len() {
                pictures.read(frame, &mut values)?;
                if run == 0 {
                    sum += values.iter().map(|&value| f64::from(value)).sum::<f64>();
                }
            }
            best = best.min(start.elapsed());
        }
        println!("  frame values sum {sum}");
        println!(
            "  frame seconds {:.6}, frames/s {:.0}",
            best.as_secs_f64(),
            about.stamps.len() as f64 / best.as_secs_f64()
        );
    }
    Ok(())
}

/// What the events are, and the shortest time that reading them took: opening, decoding into columns, a piece
/// at a time.
fn timed(
    recording: &dyn Recording,
    open: impl Fn() -> Result<Box<dyn Recording>, FormatError>,
) -> Result<(Seen, Duration), Box<dyn Error>> {
    let mut seen = Seen::default();
    let mut cursor = recording.events()?;
    let mut chunk = EventChunk::default();
    while cursor.next(&mut chunk)? {
        seen.add(&chunk);
    }
    let losses = recording.losses().into_iter().chain(cursor.losses());
    losses.for_each(|loss| println!("  loss at {}: {}", loss.at, loss.what));
    let mut best = Duration::MAX;
    for _ in 0..RUNS {
        let start = Instant::now();
        let mut cursor = open()?.events()?;
        while cursor.next(&mut chunk)? {
            std::hint::black_box(&chunk);
        }
        best = best.min(start.elapsed());
    }
    Ok((seen, best))
}
