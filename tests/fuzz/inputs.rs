//! Inputs for the two commands of a new user: half are small files of every format changed in some bytes,
//! half are whole recordings whose stamps, places and pictures are changed in meaning: other units, pauses,
//! strays, counters that wrap, numbers at the ends of their range.

use super::common::{Random, Seed, mutate, seeds};
use crate::disc::{self, Disc};

/// Address space of a command.
pub const BYTES: u64 = 2 << 30;
/// Processor time of a command, s.
pub const SECONDS: u64 = 20;
/// And time on the clock, s: a machine with other work is slow, a command that waits for nothing is stuck.
pub const WAITED: i64 = 120;

/// Why an end is none that may be, by signal, exit code and messages; `None` for every ordinary one.
pub fn broken(command: &str, signal: Option<i32>, code: Option<i32>, stderr: &str) -> Option<String> {
    let lines = || {
        stderr
            .lines()
            .filter(|line| line.contains("panicked") || line.contains("allocation"))
            .collect::<Vec<_>>()
            .join(" | ")
    };
    match (signal, code) {
        (Some(signal), _) => Some(format!("{command}: signal {signal} {}", lines())),
        (_, Some(101)) => Some(format!("{command}: {}", lines())),
        _ if stderr.contains("panicked at") => Some(format!("{command}: {}", lines())),
        _ => None,
    }
}

/// Formats whose files hold no frames: a folder of pictures is given with them.
const WITHOUT_FRAMES: [&str; 9] =
    ["evt2", "evt21", "evt3", "dat", "aedat2", "event_stream", "prophesee_hdf5", "csv", "npz"];

/// Small whole recordings of every format, with frames.
pub fn all() -> Vec<Seed> {
    seeds::all()
        .into_iter()
        .map(|seed| if WITHOUT_FRAMES.contains(&seed.format) { with_frames(&seed) } else { seed })
        .collect()
}

/// Input `k` of the series `first`.
pub fn input(all: &[Seed], first: u64, k: u64) -> Seed {
    let mut random = Random::new(first.wrapping_mul(1_000_003).wrapping_add(k));
    if k.is_multiple_of(2) {
        mutate(&all[(k / 2) as usize % all.len()], &mut random)
    } else {
        changed_in_meaning(&mut random)
    }
}

/// Arguments of `init` for an input that is written at `path`, in a folder `in`.
pub fn files(seed: &Seed, path: &str) -> Vec<String> {
    if seed.files.iter().any(|(name, _)| name == "frames/timestamps.txt") {
        return vec![format!("in/{}", seed.files[0].0), "in/frames".into()];
    }
    vec![path.into()]
}

/// Pictures of 32 x 24 pixels and stamps that go with the events of the seeds.
fn with_frames(seed: &Seed) -> Seed {
    let mut seed = seed.clone();
    for l in 0..4u8 {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 32, 24);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        let values: Vec<u8> =
            (0..32 * 24).map(|i: u32| ((i * 5 + u32::from(l) * 40) % 200) as u8 + 20).collect();
        encoder.write_header().unwrap().write_image_data(&values).unwrap();
        seed.files.push((format!("frames/{l:06}.png"), bytes));
    }
    seed.files
        .push(("frames/timestamps.txt".into(), b"1000 1200\n1500 1700\n2000 2200\n2500 2700\n".to_vec()));
    seed
}

/// A number as files hold them by mistake.
fn odd(random: &mut Random) -> i64 {
    const ODD: [i64; 12] = [
        0,
        -1,
        1,
        i64::MAX,
        i64::MIN,
        1 << 31,
        1 << 32,
        -(1 << 40),
        1_600_000_000_000_000,
        86_400_000_000,
        1 << 24,
        3,
    ];
    ODD[random.below(ODD.len())]
}

/// A small recording, changed in what its numbers mean.
fn changed_in_meaning(random: &mut Random) -> Seed {
    let disc = Disc::get();
    // A part of it: pixels around the disc's way, 120 ms.
    let (width, height) = if random.below(8) == 0 { (32, 24) } else { (16, 12) };
    let (left, top) = (30, 24);
    let inside = |event: &&disc::Event| {
        (left..left + width).contains(&event.x)
            && (top..top + height).contains(&event.y)
            && event.t_us < 120_000
    };
    let mut rows: Vec<[i64; 4]> = disc
        .events
        .iter()
        .filter(inside)
        .map(|event| {
            [event.t_us, i64::from(event.x - left), i64::from(event.y - top), i64::from(event.is_on)]
        })
        .collect();
    let mut stamps: Vec<[i64; 2]> =
        disc.frames.starts_us[..6].iter().map(|start| [*start, start + disc::EXPOSURE_US]).collect();
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
    let mut seed = Seed {
        format: "csv",
        files: vec![("events.txt".into(), format!("t x y p\n{text}").into_bytes())],
        declared: Default::default(),
    };
    for (l, values) in disc.frames.pictures[..6].iter().enumerate() {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, width.into(), height.into());
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        let row = |y: u16| &values[usize::from(top + y) * disc::WIDTH + usize::from(left)..][..width.into()];
        let part: Vec<u8> = (0..height).flat_map(row).copied().collect();
        encoder.write_header().unwrap().write_image_data(&part).unwrap();
        seed.files.push((format!("frames/{l:06}.png"), bytes));
    }
    let are_plain = random.below(2) == 0;
    let lines: String = stamps
        .iter()
        .map(|[start, end]| {
            if are_plain || random.below(8) == 0 { format!("{start}\n") } else { format!("{start} {end}\n") }
        })
        .collect();
    seed.files.push(("frames/timestamps.txt".into(), lines.into_bytes()));
    seed
}
