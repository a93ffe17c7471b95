//! Reads changed files of every format for as long as is asked: `cargo run --release -p photocurrent-formats
//! --example fuzz -- [INPUTS] [SEED] [FORMAT]`.
//!
//! INPUTS are spread over the formats by how fast they read. A panic, more memory than the budget, or more
//! than five seconds is a failure: the input is written to `fuzz-failures`, and the exit code is 1. An input
//! that does not come back within 20 s ends the run; it stays in the scratch folder. Memory of libraries in C
//! (HDF5, Zstandard) is not counted. HDF5 1.10 ends the process on about one in 10,000 changed files (a chunk
//! of size 0, a heap of variable-length text that ends early): a copy of the process finds that out, and the
//! file is refused.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]

#[path = "../tests/common/mod.rs"]
mod common;

use common::{Random, Seed, mutate, read, seeds};
use photocurrent_formats::catalog;
use std::alloc::{GlobalAlloc, Layout, System};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering::Relaxed};
use std::time::{Duration, Instant};

/// What one input may take at once, beyond what stood before: a chunk of events, a picture, a message,
/// buffers.
const BUDGET: i64 = 64 << 20;
/// As much as the TIFF library reserves, without using it, for a list that a few bytes claim (its limits can
/// be set only after that), and as a chunk of a foreign HDF5 file may have.
const BUDGET_CLAIMED: i64 = 272 << 20;
/// A copy of the process may try an HDF5 file for 1 s of processor time, which is more on the clock of a busy
/// machine.
const SLOW: Duration = Duration::from_secs(5);
const HUNG_S: u64 = 20;

static NOW: AtomicI64 = AtomicI64::new(0);
static PEAK: AtomicI64 = AtomicI64::new(0);
/// Seconds since the start at which the current input began.
static BEGAN: AtomicU64 = AtomicU64::new(u64::MAX);
static LAST_PANIC: Mutex<String> = Mutex::new(String::new());

struct Counting;

// SAFETY: passes everything on to the system's allocator and counts bytes.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let now = NOW.fetch_add(layout.size() as i64, Relaxed) + layout.size() as i64;
        PEAK.fetch_max(now, Relaxed);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        NOW.fetch_sub(layout.size() as i64, Relaxed);
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Where inputs are written: memory where there is such a folder.
fn scratch() -> tempfile::TempDir {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() { tempfile::tempdir_in(memory).unwrap() } else { tempfile::tempdir().unwrap() }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number =
        |k: usize, default: u64| arguments.get(k).map_or(default, |text: &String| text.parse().unwrap());
    let (inputs, first_seed, only) = (number(0, 100_000), number(1, 1), arguments.get(2));
    let start = Instant::now();
    std::panic::set_hook(Box::new(|panic| {
        *LAST_PANIC.lock().unwrap() = panic.to_string().replace('\n', " ")
    }));
    std::thread::spawn(move || {
        loop {
            std::thread::sleep(Duration::from_secs(1));
            let began = BEGAN.load(Relaxed);
            if began != u64::MAX && start.elapsed().as_secs().saturating_sub(began) > HUNG_S {
                println!("an input did not come back within {HUNG_S} s; it is in the scratch folder");
                std::process::exit(1);
            }
        }
    });
    let seeds: Vec<Seed> =
        seeds::all().into_iter().filter(|seed| only.is_none_or(|only| seed.format == only)).collect();
    // As long for every recording: HDF5 files take some fifty times as long to open as others.
    let rates: Vec<f64> = seeds.iter().map(rate_of).collect();
    let sum: f64 = rates.iter().sum();
    let (mut done, mut failures) = (0, 0);
    for (index, (seed, rate)) in seeds.iter().zip(&rates).enumerate() {
        let share = (inputs as f64 * rate / sum).ceil() as u64;
        let (of_seed, failed) = (Instant::now(), fuzz(seed, share, first_seed + 1000 * index as u64, start));
        let rate = share as f64 / of_seed.elapsed().as_secs_f64();
        println!(
            "{:18} {:22} {share:9} inputs, {rate:7.0}/s, {failed} failures",
            seed.format, seed.files[0].0
        );
        done += share;
        failures += failed;
    }
    println!("{done} inputs in {:.0} s, {failures} failures", start.elapsed().as_secs_f64());
    std::process::exit(i32::from(failures > 0));
}

/// How often a second the whole recording is read.
fn rate_of(seed: &Seed) -> f64 {
    const READS: usize = 20;
    let place = scratch();
    let path = seed.write(place.path(), None);
    let format = catalog::named(seed.format).unwrap();
    let start = Instant::now();
    for _ in 0..READS {
        read(&path, format, &seed.declared);
    }
    READS as f64 / start.elapsed().as_secs_f64()
}

/// Reads so many changed copies of one recording; gives the number of failures.
fn fuzz(seed: &Seed, inputs: u64, first_seed: u64, start: Instant) -> u64 {
    let format = catalog::named(seed.format).unwrap();
    let mut random = Random::new(first_seed);
    let place = scratch();
    let mut before: Option<Seed> = None;
    let claims = [".tif", ".h5"].iter().any(|end| seed.files[0].0.ends_with(end));
    let budget = if claims { BUDGET_CLAIMED } else { BUDGET };
    let mut failures = 0;
    for _ in 0..inputs {
        let changed = mutate(seed, &mut random);
        let path = changed.write(place.path(), before.as_ref());
        BEGAN.store(start.elapsed().as_secs(), Relaxed);
        let (held, began) = (NOW.load(Relaxed), Instant::now());
        PEAK.store(held, Relaxed);
        let outcome = catch_unwind(AssertUnwindSafe(|| read(&path, format, &changed.declared)));
        let (took, peak) = (began.elapsed(), PEAK.load(Relaxed) - held);
        BEGAN.store(u64::MAX, Relaxed);
        let wrong = match outcome {
            Err(_) => Some(LAST_PANIC.lock().unwrap().clone()),
            Ok(_) if peak > budget => Some(format!("{peak} bytes at once")),
            Ok(_) if took > SLOW => Some(format!("{:.1} s", took.as_secs_f64())),
            Ok(_) => None,
        };
        if let Some(wrong) = wrong {
            failures += 1;
            if failures <= 5 {
                println!("{}: {wrong}: {}", seed.format, keep(&changed, first_seed, failures).display());
            }
        }
        before = Some(changed);
    }
    failures
}

/// Writes an input that failed to where it is found.
fn keep(seed: &Seed, first_seed: u64, failure: u64) -> PathBuf {
    let place = Path::new("fuzz-failures").join(format!("{}-{first_seed}-{failure}", seed.format));
    seed.write(&place, None)
}
