//! `cargo run --release --example fuzz_commands -- INPUTS [SERIES] [PROCESSES] [SECONDS]`: changed files of
//! every format through `init` and `run`, for hours.
//!
//! The inputs are those of the quick test (`tests/fuzzed.rs`). Nothing is started anew: each command is a
//! copy of this process, in which the program is loaded, with an address space of 2 GiB, 20 s of processor
//! time and two minutes on the clock. Inputs that fail, and slow ones, are kept in `fuzz-failures`. Set
//! `TMPDIR` to a folder in memory. With SECONDS it ends after that time.

#![allow(clippy::unwrap_used, clippy::print_stdout)]

#[path = "../../src/formats/tests/common/mod.rs"]
pub mod common;
#[allow(dead_code)]
#[path = "../disc.rs"]
mod disc;
mod inputs;

use common::Seed;
use inputs::{BYTES, SECONDS, WAITED};
use std::ffi::OsString;
use std::fs;
use std::io::Write;
use std::os::fd::AsRawFd;
use std::panic::AssertUnwindSafe;
use std::path::Path;
use std::time::{Duration, Instant};

/// Processor time of a command after which an input is kept as slow, s.
const SLOW: f64 = 5.0;

/// How a command ended.
enum Ended {
    Code(i32),
    Signal(i32),
}

/// Runs one command in a copy of this process, in a folder, with its messages in `stderr.txt` there; how it
/// ended, and its processor time, s.
fn command(folder: &Path, arguments: &[&str]) -> (Ended, f64) {
    // SAFETY: this process has one thread, so that its copy may do what it likes.
    let child = unsafe { libc::fork() };
    assert!(child >= 0, "no process: {}", std::io::Error::last_os_error());
    if child == 0 {
        let code = std::panic::catch_unwind(AssertUnwindSafe(|| {
            std::env::set_current_dir(folder).unwrap();
            let stderr = fs::File::create("stderr.txt").unwrap();
            let limit = |most: u64| libc::rlimit { rlim_cur: most, rlim_max: most };
            let timer = libc::itimerval {
                it_interval: libc::timeval { tv_sec: 0, tv_usec: 0 },
                it_value: libc::timeval { tv_sec: WAITED, tv_usec: 0 },
            };
            // SAFETY: plain calls with structures that live until they return.
            let is_set = unsafe {
                libc::dup2(stderr.as_raw_fd(), libc::STDERR_FILENO) >= 0
                    && libc::setitimer(libc::ITIMER_REAL, &timer, std::ptr::null_mut()) == 0
                    && libc::setrlimit(libc::RLIMIT_CPU, &limit(SECONDS)) == 0
                    && libc::setrlimit(libc::RLIMIT_AS, &limit(BYTES)) == 0
            };
            assert!(is_set, "no limits: {}", std::io::Error::last_os_error());
            let all = std::iter::once("photocurrent").chain(arguments.iter().copied());
            photocurrent_cli::run(all.map(OsString::from))
        }));
        let _ = std::io::stdout().flush();
        // SAFETY: ends the copy without the handlers of the original.
        unsafe { libc::_exit(code.map_or(101, i32::from)) }
    }
    let mut status = 0;
    // SAFETY: a structure of numbers; then waits for the child above.
    let mut used: libc::rusage = unsafe { std::mem::zeroed() };
    while unsafe { libc::wait4(child, &mut status, 0, &mut used) } < 0 {}
    let seconds = |time: libc::timeval| time.tv_sec as f64 + time.tv_usec as f64 * 1e-6;
    let ended = if libc::WIFSIGNALED(status) {
        Ended::Signal(libc::WTERMSIG(status))
    } else {
        Ended::Code(libc::WEXITSTATUS(status))
    };
    (ended, seconds(used.ru_utime) + seconds(used.ru_stime))
}

fn broken(folder: &Path, arguments: &[&str], ended: &Ended) -> Option<String> {
    let stderr = fs::read(folder.join("stderr.txt")).unwrap_or_default();
    let (signal, code) = match ended {
        Ended::Signal(signal) => (Some(*signal), None),
        Ended::Code(code) => (None, Some(*code)),
    };
    inputs::broken(arguments[0], signal, code, &String::from_utf8_lossy(&stderr))
}

/// What became of some inputs.
#[derive(Default)]
struct Counts {
    /// Whose `run` ended with 0, and all.
    rendered: u64,
    inputs: u64,
    failed: u64,
    /// Processor time of the slowest command, s.
    slowest: f64,
}

/// `init` and `run` on one input in an empty folder: why it failed, whether a picture came, and the longer
/// processor time, s.
fn both(seed: &Seed, folder: &Path) -> (Option<String>, bool, f64) {
    let path = seed.write(&folder.join("in"), None);
    let relative = path.strip_prefix(folder).unwrap().to_string_lossy().into_owned();
    let files = inputs::files(seed, &relative);
    let init: Vec<&str> =
        ["init", "-o", "my.toml"].into_iter().chain(files.iter().map(String::as_str)).collect();
    let (ended, first) = command(folder, &init);
    let why = broken(folder, &init, &ended);
    if why.is_some() || !folder.join("my.toml").exists() {
        return (why, false, first);
    }
    let run = ["run", "my.toml", "--to", "render", "--quiet", "--threads", "1"];
    let (ended, second) = command(folder, &run);
    (broken(folder, &run, &ended), matches!(ended, Ended::Code(0)), first.max(second))
}

fn work(process: u64, of: u64, inputs: u64, series: u64, until: Instant) -> Counts {
    let all = inputs::all();
    let mut counts = Counts::default();
    let top = std::env::temp_dir().join(format!("fuzz-{}", std::process::id()));
    // In pairs: of each two the second is the longer one.
    for k in (0..inputs).filter(|k| k / 2 % of == process) {
        if Instant::now() >= until {
            break;
        }
        let seed = inputs::input(&all, series, k);
        fs::create_dir_all(&top).unwrap();
        let (why, is_rendered, took) = both(&seed, &top);
        counts.inputs += 1;
        counts.rendered += u64::from(is_rendered);
        counts.slowest = counts.slowest.max(took);
        counts.failed += u64::from(why.is_some());
        if let Some(why) =
            why.map(|why| format!("FAILED: {why}")).or_else(|| (took > SLOW).then(|| "slow".into()))
        {
            let place = Path::new("fuzz-failures").join(format!("{}-{series}-{k}", seed.format));
            fs::create_dir_all(&place).unwrap();
            seed.write(&place, None);
            println!("{}: {why}; {took:.1} s", place.display());
        }
        let _ = fs::remove_dir_all(&top);
    }
    counts
}

fn main() {
    let number = |at: usize, default: u64| {
        std::env::args().nth(at).map_or(default, |text| text.parse().expect("a number"))
    };
    let (inputs, series, processes, seconds) =
        (number(1, 1000), number(2, 1), number(3, 1).max(1), number(4, 1 << 30));
    // SAFETY: before anything else runs; copies compute with one thread.
    unsafe { std::env::set_var("RAYON_NUM_THREADS", "1") };
    let (started, until) = (Instant::now(), Instant::now() + Duration::from_secs(seconds));
    let mut children = Vec::new();
    for process in 0..processes {
        // SAFETY: one thread, as above.
        match unsafe { libc::fork() } {
            0 => {
                let Counts { rendered, inputs, failed, slowest } =
                    work(process, processes, inputs, series, until);
                let seconds = started.elapsed().as_secs_f64();
                println!(
                    "process {process}: {inputs} inputs, {rendered} rendered, {failed} failed, slowest \
                          {slowest:.1} s; {seconds:.0} s"
                );
                let _ = std::io::stdout().flush();
                std::process::exit(i32::from(failed > 0));
            }
            child => children.push(child),
        }
    }
    let mut has_failed = false;
    for child in children {
        let mut status = 0;
        // SAFETY: waits for a child of this process.
        while unsafe { libc::waitpid(child, &mut status, 0) } < 0 {}
        has_failed |= status != 0;
    }
    std::process::exit(i32::from(has_failed));
}
