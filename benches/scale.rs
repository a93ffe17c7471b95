//! Time and peak memory of every stage against the size of a recording: the table of docs/performance.md.
//!
//! ```text
//! cargo bench --bench scale                                       # four sizes of 100 ms under 256MiB
//! cargo bench --bench scale -- --memory 4GiB 1280x720x2000        # one size, ms
//! ```
//!
//! Each stage is a process of its own (`photocurrent run pipelines/scale.toml --to STAGE`), so that its peak
//! is its own; what comes before it lies in the cache. Peak memory and processor time are what the system
//! says of the ended process. Everything is written below `--folder` and removed at the end, about 4 GB for
//! 1280x720x100.

//! A second table says what limits each stage: what reading its inputs and packing its outputs take by
//! themselves, in bytes of the cache, against its processor time.

#![allow(clippy::print_stdout)]

#[path = "scale/limits.rs"]
mod limits;

use photocurrent_core::Meta;
use photocurrent_store::Cache;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

/// Stages in running order, as nodes of the pipeline.
const STAGES: [&str; 7] = ["scene", "recording", "solve", "render", "edi", "psnr", "pictures"];

struct Measured {
    seconds: f64,
    processor_seconds: f64,
    peak_bytes: u64,
    outcome: serde_json::Value,
}

fn main() {
    // `cargo bench` adds `--bench`, and `cargo test --benches` wants to know only that it starts.
    let mut arguments = std::env::args().skip(1).filter(|argument| argument != "--bench").peekable();
    let (mut memory, mut folder, mut sizes) = ("256MiB".to_string(), std::env::temp_dir(), Vec::new());
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--memory" => memory = arguments.next().expect("--memory SIZE"),
            "--folder" => folder = PathBuf::from(arguments.next().expect("--folder FOLDER")),
            size => sizes.push(parse(size).unwrap_or_else(|| {
                panic!(
                    "`{size}` is no size: \
                                                            WIDTHxHEIGHTxMILLISECONDS, such as 640x360x100"
                )
            })),
        }
    }
    if sizes.is_empty() {
        sizes = vec![(160, 90, 100), (320, 180, 100), (640, 360, 100), (1280, 720, 100)];
    }
    println!("`--memory {memory}`, {} threads", std::thread::available_parallelism().map_or(1, usize::from));
    println!();
    println!("| size | events | stage | time | processor time | peak memory |");
    println!("| --- | --- | --- | --- | --- | --- |");
    let mut done = Vec::new();
    for size in sizes {
        let here = tempfile::tempdir_in(&folder).expect("a folder for the cache");
        let mut stages = Vec::new();
        for stage in STAGES {
            let measured = run(stage, size, &memory, here.path());
            let (width, height, ms) = size;
            let events = if stage == "scene" {
                "".into()
            } else {
                events(here.path(), size, &memory).map_or("".into(), millions)
            };
            println!(
                "| {width}x{height}, {ms} ms | {events} | {stage} | {:.1} s | {:.1} s | {} MB |",
                measured.seconds,
                measured.processor_seconds,
                measured.peak_bytes / 1_000_000
            );
            stages.push((
                stage,
                measured.processor_seconds,
                measured.outcome["tasks"].as_array().cloned().unwrap_or_default(),
            ));
        }
        done.push((size, here, stages));
    }
    // At the end: what this process holds at its peak counts as that of the processes that it begins later.
    for ((width, height, ms), here, stages) in done {
        println!();
        println!("{width}x{height}, {ms} ms:");
        let packing = |(stage, seconds, tasks): (_, f64, Vec<_>)| {
            (stage, seconds, limits::packing(&tasks, &here.path().join("cache"), stage))
        };
        print_limits(&stages.into_iter().map(packing).collect::<Vec<_>>());
    }
}

/// What limits each stage.
fn print_limits(stages: &[(&str, f64, limits::Packing)]) {
    let (copied, operations) = (limits::copied_bytes_per_s(), limits::operations_per_s());
    println!();
    println!(
        "One core copies {:.1} GB/s and adds or multiplies {:.1} G doubles/s.",
        copied * 1e-9,
        operations * 1e-9
    );
    println!();
    println!(
        "| stage | in, out of the cache | in memory | processor time | reading | packing | copying | \
              rest |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- |");
    for (stage, seconds, packing) in stages {
        let (moved, mb) = (packing.reading + packing.packing, |bytes: u64| bytes as f64 * 1e-6);
        println!(
            "| {stage} | {:.0}, {:.0} MB | {:.0} MB | {seconds:.1} s | {:.2} s | {:.2} s | {:.2} s | {:.0} % \
             |",
            mb(packing.bytes_in),
            mb(packing.bytes_out),
            mb(packing.unpacked),
            packing.reading,
            packing.packing,
            packing.unpacked as f64 / copied,
            100.0 * (1.0 - moved / seconds).max(0.0)
        );
    }
}

fn parse(text: &str) -> Option<(u32, u32, u32)> {
    let mut numbers = text.split('x').map(|number| number.parse().ok());
    let size = (numbers.next()??, numbers.next()??, numbers.next()??);
    numbers.next().is_none().then_some(size)
}

fn millions(count: u64) -> String {
    format!("{:.2} M", count as f64 * 1e-6)
}

fn run(stage: &str, (width, height, ms): (u32, u32, u32), memory: &str, folder: &Path) -> Measured {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/scale.toml");
    let mut command = Command::new(env!("CARGO_BIN_EXE_photocurrent"));
    command.arg("run").arg(manifest).args(["--to", stage, "--memory", memory, "--json", "--quiet"]);
    for (name, value) in
        [("width", width.to_string()), ("height", height.to_string()), ("duration", format!("\"{ms} ms\""))]
    {
        command.arg("--set").arg(format!("nodes.scene.params.{name}={value}"));
    }
    command
        .arg("--cache")
        .arg(folder.join("cache"))
        .arg("--out")
        .arg(folder.join("out"))
        .stdout(Stdio::piped());
    let began = Instant::now();
    #[allow(clippy::zombie_processes)] // It is waited for below, in a way that says what it used.
    let mut child = command.spawn().expect("the command starts");
    let mut text = String::new();
    std::io::Read::read_to_string(&mut child.stdout.take().expect("a pipe"), &mut text)
        .expect("the command prints text");
    let (code, usage) = wait(child.id());
    assert_eq!(code, 0, "{stage} of {width}x{height} fails under --memory {memory}");
    let seconds_of = |time: libc::timeval| time.tv_sec as f64 + time.tv_usec as f64 * 1e-6;
    Measured {
        seconds: began.elapsed().as_secs_f64(),
        processor_seconds: seconds_of(usage.ru_utime) + seconds_of(usage.ru_stime),
        // Kilobytes on Linux.
        peak_bytes: usage.ru_maxrss as u64 * 1024,
        outcome: serde_json::from_str(&text).expect("--json prints JSON"),
    }
}

/// Waits for a child, and gives its exit status and what it used.
fn wait(id: u32) -> (i32, libc::rusage) {
    let mut status = 0;
    // SAFETY: both point to memory of their type, and an all-zero rusage is valid.
    let usage = unsafe {
        let mut usage: libc::rusage = std::mem::zeroed();
        assert_eq!(
            libc::wait4(id as libc::pid_t, &mut status, 0, &mut usage),
            id as libc::pid_t,
            "the child is ours"
        );
        usage
    };
    (status, usage)
}

/// How many events the recording has, as the cache says.
fn events(folder: &Path, size: (u32, u32, u32), memory: &str) -> Option<u64> {
    let outcome = run("recording", size, memory, folder).outcome;
    let task = outcome["tasks"].as_array()?.iter().find(|task| task["node"] == "recording")?;
    let digest = task["outputs"]["events"]["digest"].as_str()?.parse().ok()?;
    match Cache::open(&folder.join("cache")).ok()?.load(&digest).ok()?.meta() {
        Meta::Events(meta) => meta.count_hint,
        _ => None,
    }
}
