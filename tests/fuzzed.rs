//! Changed files of every format through the two commands of a new user, `init` and `run`: no panic, no abort, no endless work, whatever the files hold.
//!
//! Each command has an address space of 2 GiB, 20 s of processor time, and two minutes where it waits. The quick test takes few inputs; the long run is
//! `FUZZED_INPUTS=100000 FUZZED_SEED=1 cargo test --release --test photocurrent fuzzed -- --nocapture`; inputs that fail are kept in `fuzz-failures`.
//! Half of the inputs are files changed in some bytes ([`common::mutate`]); half are whole recordings whose stamps, places and pictures are changed in meaning: other units, pauses, strays,
//! counters that wrap, numbers at the ends of their range.

#![allow(clippy::unwrap_used)]

#[path = "../src/formats/tests/common/mod.rs"]
mod common;

use crate::disc::{self, Disc};
use crate::support::Bench;
use common::{Random, Seed, mutate, seeds};
use std::fs;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::Stdio;
use std::sync::Mutex;

/// Address space of a command.
const BYTES: u64 = 2 << 30;
/// Processor time of a command, s.
const SECONDS: u64 = 20;
/// And time on the clock: a machine with other work is slow, one that waits for nothing is stuck.
const WAITED: i64 = 120;
/// Formats whose files hold no frames: a folder of pictures is given with them.
const WITHOUT_FRAMES: [&str; 9] = ["evt2", "evt21", "evt3", "dat", "aedat2", "event_stream", "prophesee_hdf5", "csv", "npz"];

fn number(name: &str, default: u64) -> u64 {
    std::env::var(name).ok().map_or(default, |text| text.parse().unwrap())
}

/// Pictures of 32 x 24 pixels and stamps that go with the events of the seeds.
fn with_frames(seed: &Seed) -> Seed {
    let mut seed = seed.clone();
    for l in 0..4u8 {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 32, 24);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        let values: Vec<u8> = (0..32 * 24).map(|i: u32| ((i * 5 + u32::from(l) * 40) % 200) as u8 + 20).collect();
        encoder.write_header().unwrap().write_image_data(&values).unwrap();
        seed.files.push((format!("frames/{l:06}.png"), bytes));
    }
    seed.files.push(("frames/timestamps.txt".into(), b"1000 1200\n1500 1700\n2000 2200\n2500 2700\n".to_vec()));
    seed
}

/// A number as files hold them by mistake.
fn odd(random: &mut Random) -> i64 {
    const ODD: [i64; 12] = [0, -1, 1, i64::MAX, i64::MIN, 1 << 31, 1 << 32, -(1 << 40), 1_600_000_000_000_000, 86_400_000_000, 1 << 24, 3];
    ODD[random.below(ODD.len())]
}

/// A small recording, changed in what its numbers mean.
fn changed_in_meaning(random: &mut Random) -> Seed {
    let disc = Disc::get();
    // A part of it: 32 x 24 pixels around the disc's way, 60 ms.
    let (left, top) = (30, 24);
    let inside = |event: &&disc::Event| (left..left + 32).contains(&event.x) && (top..top + 24).contains(&event.y) && event.t_us < 120_000;
    let mut rows: Vec<[i64; 4]> =
        disc.events.iter().filter(inside).map(|event| [event.t_us, i64::from(event.x - left), i64::from(event.y - top), i64::from(event.is_on)]).collect();
    let mut stamps: Vec<[i64; 2]> = disc.frames.starts_us[..6].iter().map(|start| [*start, start + disc::EXPOSURE_US]).collect();
    for _ in 0..1 + random.below(4) {
        let at = random.below(rows.len());
        match random.below(16) {
            0 => rows.iter_mut().for_each(|row| row[0] = row[0].saturating_mul(1000)),
            1 => rows.iter_mut().for_each(|row| row[0] /= 1000),
            2 => stamps.iter_mut().flatten().for_each(|t| *t = t.saturating_mul(1000)),
            3 => stamps.iter_mut().flatten().for_each(|t| *t /= 1000),
            4 => rows[at..].iter_mut().for_each(|row| row[0] = row[0].saturating_add(3_600_000_000)),
            5 => {
                let (from, by) = (random.below(stamps.len()), odd(random));
                stamps[from..].iter_mut().flatten().for_each(|t| *t = t.saturating_add(by));
            }
            6 => rows[at][0] = odd(random),
            7 => rows[at][1 + random.below(3)] = odd(random),
            8 => {
                let by = odd(random);
                rows.iter_mut().for_each(|row| row[0] = row[0].saturating_add(by));
            }
            9 => rows.iter_mut().for_each(|row| row[0] &= 0xffff),
            10 => rows.truncate(1 + at / 8),
            11 => rows.iter_mut().for_each(|row| row[1] *= 32),
            12 => stamps.truncate(1 + random.below(5)),
            13 => {
                let l = random.below(stamps.len());
                stamps[l][random.below(2)] = odd(random);
            }
            14 => rows.iter_mut().for_each(|row| row[0] = 5),
            _ => rows.swap(0, at),
        }
        if rows.is_empty() {
            break;
        }
    }
    let text = rows.iter().map(|[t, x, y, p]| format!("{t} {x} {y} {p}\n")).collect::<String>();
    let mut seed = Seed { format: "csv", files: vec![("events.txt".into(), format!("t x y p\n{text}").into_bytes())], declared: Default::default() };
    for (l, values) in disc.frames.pictures[..6].iter().enumerate() {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 32, 24);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        let part: Vec<u8> = (0..24).flat_map(|y| values[(usize::from(top) + y) * disc::WIDTH + usize::from(left)..][..32].to_vec()).collect();
        encoder.write_header().unwrap().write_image_data(&part).unwrap();
        seed.files.push((format!("frames/{l:06}.png"), bytes));
    }
    let are_plain = random.below(2) == 0;
    let lines: String =
        stamps.iter().map(|[start, end]| if are_plain || random.below(8) == 0 { format!("{start}\n") } else { format!("{start} {end}\n") }).collect();
    seed.files.push(("frames/timestamps.txt".into(), lines.into_bytes()));
    seed
}

/// How a command ended when it should not have; `None` for every ordinary end.
fn broken(bench: &Bench, arguments: &[&str]) -> Option<String> {
    let mut command = bench.command(arguments);
    command.env("RAYON_NUM_THREADS", "1").env("RUST_BACKTRACE", "0").stdout(Stdio::null()).stderr(Stdio::piped());
    let limit = libc::rlimit { rlim_cur: BYTES, rlim_max: BYTES };
    let processor = libc::rlimit { rlim_cur: SECONDS, rlim_max: SECONDS };
    let timer = libc::itimerval { it_interval: libc::timeval { tv_sec: 0, tv_usec: 0 }, it_value: libc::timeval { tv_sec: WAITED, tv_usec: 0 } };
    // SAFETY: between fork and exec only setrlimit and setitimer are called, which are safe there; the timer outlives exec.
    unsafe {
        command.pre_exec(move || {
            let is_set = libc::setitimer(libc::ITIMER_REAL, &timer, std::ptr::null_mut()) == 0
                && libc::setrlimit(libc::RLIMIT_CPU, &processor) == 0
                && libc::setrlimit(libc::RLIMIT_AS, &limit) == 0;
            if is_set { Ok(()) } else { Err(std::io::Error::last_os_error()) }
        });
    }
    let done = command.output().unwrap();
    let stderr = String::from_utf8_lossy(&done.stderr);
    let last = || stderr.lines().filter(|line| line.contains("panicked") || line.contains("allocation")).collect::<Vec<_>>().join(" | ");
    match (done.status.signal(), done.status.code()) {
        (Some(signal), _) => Some(format!("{}: signal {signal} {}", arguments[0], last())),
        (_, Some(101)) => Some(format!("{}: {}", arguments[0], last())),
        _ if stderr.contains("panicked at") => Some(format!("{}: {}", arguments[0], last())),
        _ => None,
    }
}

/// `init` and `run` on one input; `None` where both end as they may.
fn both(seed: &Seed, bench: &Bench) -> Option<String> {
    let path = seed.write(&bench.path("in"), None);
    let relative = path.strip_prefix(bench.path("")).unwrap().to_string_lossy().into_owned();
    let is_apart = seed.files.iter().any(|(name, _)| name == "frames/timestamps.txt");
    let first = if is_apart { format!("in/{}", seed.files[0].0) } else { relative };
    let mut arguments = vec!["init", "-o", "my.toml", first.as_str()];
    if is_apart {
        arguments.push("in/frames");
    }
    broken(bench, &arguments).or_else(|| if bench.path("my.toml").exists() { broken(bench, &["run", "my.toml", "--to", "render", "--quiet"]) } else { None })
}

#[test]
fn changed_files_go_through_init_and_run_without_a_panic() {
    let (inputs, first) = (number("FUZZED_INPUTS", 48), number("FUZZED_SEED", 1));
    let all: Vec<Seed> = seeds::all().into_iter().map(|seed| if WITHOUT_FRAMES.contains(&seed.format) { with_frames(&seed) } else { seed }).collect();
    let failures = Mutex::new(Vec::new());
    let work = |thread: u64| {
        for k in (thread..inputs).step_by(2) {
            let mut random = Random::new(first.wrapping_mul(1_000_003).wrapping_add(k));
            let seed = if k % 2 == 0 { mutate(&all[(k / 2) as usize % all.len()], &mut random) } else { changed_in_meaning(&mut random) };
            let bench = Bench::new();
            if let Some(why) = both(&seed, &bench) {
                let place = Path::new("fuzz-failures").join(format!("{}-{first}-{k}", seed.format));
                fs::create_dir_all(&place).unwrap();
                seed.write(&place, None);
                failures.lock().unwrap().push(format!("{}: {why}", place.display()));
            }
        }
    };
    std::thread::scope(|scope| {
        scope.spawn(|| work(0));
        work(1);
    });
    let failures = failures.into_inner().unwrap();
    assert!(failures.is_empty(), "{} of {inputs} inputs:\n{}", failures.len(), failures.join("\n"));
}
