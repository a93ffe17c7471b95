//! What limits a stage: how long reading its inputs out of the cache and packing its outputs take by
//! themselves, and how fast this machine copies and multiplies.
//!
//! A stage cannot be quicker than its packing. What is left is arithmetic, and waiting for memory.

use photocurrent_core::Value;
use photocurrent_store::{Cache, ValueWriter};
use serde_json::Value as Json;
use std::hint::black_box;
use std::path::Path;

/// What a stage takes and gives, as `node.port`.
pub fn ports(stage: &str) -> (&'static [&'static str], &'static [&'static str]) {
    match stage {
        "scene" => (&[], &["scene.light", "scene.truth"]),
        "recording" => (&["scene.light"], &["recording.events", "recording.frames"]),
        "solve" => (&["recording.events", "recording.frames"], &["solve.tracks", "solve.map"]),
        "render" => (&["solve.tracks"], &["render.frames", "render.sigma"]),
        "edi" => (&["recording.events", "recording.frames"], &["edi.frames"]),
        "psnr" => (&["render.frames", "scene.truth"], &[]),
        "pictures" => (&["render.frames"], &[]),
        other => unreachable!("`{other}` is no stage"),
    }
}

/// What packing alone takes.
#[derive(Clone, Copy, Debug, Default)]
pub struct Packing {
    /// Bytes of the inputs in the cache.
    pub bytes_in: u64,
    /// Of the outputs.
    pub bytes_out: u64,
    /// The same in memory.
    pub unpacked: u64,
    /// Processor seconds for reading the inputs once.
    pub reading: f64,
    /// And for packing the outputs.
    pub packing: f64,
}

/// Processor seconds of this process so far.
fn processor_seconds() -> f64 {
    // SAFETY: it points to memory of its type, and an all-zero rusage is valid.
    let usage = unsafe {
        let mut usage: libc::rusage = std::mem::zeroed();
        assert_eq!(
            libc::getrusage(libc::RUSAGE_SELF, &mut usage),
            0,
            "the system says what this process used"
        );
        usage
    };
    let seconds_of = |time: libc::timeval| time.tv_sec as f64 + time.tv_usec as f64 * 1e-6;
    seconds_of(usage.ru_utime) + seconds_of(usage.ru_stime)
}

fn timed<T>(of: impl FnOnce() -> T) -> (f64, T) {
    let began = processor_seconds();
    let made = of();
    (processor_seconds() - began, made)
}

/// Rows that are read and packed at once.
const ROWS: u32 = 16;

/// Reads a value once, as far as its bands are concerned, and gives its bytes in memory.
fn read(value: &Value) -> u64 {
    let rows = value.rows().expect("stages exchange banded data");
    let of_band = |rows| match value.cut(rows) {
        Value::Events(events) => drop(black_box(events.read(rows).expect("the cache is whole"))),
        Value::Frames(frames) | Value::Truth(photocurrent_core::Truth(frames)) => {
            drop(black_box(frames.read_rows(rows).expect("the cache is whole")))
        }
        Value::Tracks(tracks) => drop(black_box(tracks.read(rows).expect("the cache is whole"))),
        Value::Light(light) => drop(black_box(light.read(rows).expect("the cache is whole"))),
        Value::Map(map) => drop(black_box(map.read(rows).expect("the cache is whole"))),
        other => unreachable!("{} is not banded", other.data_type()),
    };
    rows.bands(ROWS).into_iter().for_each(of_band);
    value.bytes(rows)
}

/// What packing alone takes of a stage, from the values that it took and gave: `tasks` of a finished run.
pub fn packing(tasks: &[Json], cache: &Path, stage: &str) -> Packing {
    let cache = Cache::open(cache).expect("the cache of the run");
    let load = |port: &&str| {
        let (node, port) = port.split_once('.').expect("node.port");
        let output =
            tasks.iter().find(|task| task["node"] == node).map(|task| task["outputs"][port].clone())?;
        let digest = output["digest"].as_str()?.parse().ok()?;
        Some((output["bytes"].as_u64()?, cache.load(&digest).expect("the cache is whole")))
    };
    let (inputs, outputs) = ports(stage);
    let mut found = Packing::default();
    for (bytes, value) in inputs.iter().filter_map(load) {
        let (seconds, unpacked) = timed(|| read(&value));
        (found.bytes_in, found.unpacked, found.reading) =
            (found.bytes_in + bytes, found.unpacked + unpacked, found.reading + seconds);
    }
    let folder = tempfile::tempdir_in(cache.root()).expect("a folder for what is packed again");
    for (bytes, value) in outputs.iter().filter_map(load) {
        let (reading, unpacked) = timed(|| read(&value));
        let (both, ()) = timed(|| {
            let mut writer =
                ValueWriter::create(&folder.path().join("again.h5"), &value.meta()).expect("a file");
            let rows = value.rows().expect("stages exchange banded data");
            rows.bands(ROWS)
                .into_iter()
                .for_each(|rows| writer.append(&value.cut(rows)).expect("room on the disk"));
            writer.finish().expect("room on the disk");
        });
        (found.bytes_out, found.unpacked, found.packing) = (
            found.bytes_out + bytes,
            found.unpacked + unpacked,
            found.packing + f64::max(both - reading, 0.0),
        );
    }
    found
}

/// Bytes a second that one core copies from memory to memory.
pub fn copied_bytes_per_s() -> f64 {
    let (from, mut to) = (vec![1_u8; 256 << 20], vec![0_u8; 256 << 20]);
    let of_one = |_| {
        let (seconds, ()) = timed(|| {
            to.copy_from_slice(black_box(&from));
            black_box(&to);
        });
        from.len() as f64 / seconds
    };
    (0..5).map(of_one).fold(0.0, f64::max)
}

/// Additions and multiplications of doubles a second of one core, with the widest vectors that there are, and
/// no memory in the way.
pub fn operations_per_s() -> f64 {
    const TIMES: usize = 4_000_000;
    let of_one = |_| {
        let (seconds, sum) = timed(|| chains(black_box(TIMES)));
        black_box(sum);
        (2 * LANES * TIMES) as f64 / seconds
    };
    (0..5).map(of_one).fold(0.0, f64::max)
}

/// Enough independent chains to hide how long one operation takes.
const LANES: usize = 128;

#[multiversion::multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2", "aarch64+neon"))]
fn chains(times: usize) -> f64 {
    let mut chain = [1.0_f64; LANES];
    let (by, plus) = (black_box(0.999_999), black_box(1e-6));
    for _ in 0..times {
        chain.iter_mut().for_each(|value| *value = *value * by + plus);
    }
    chain.iter().sum()
}
