//! Changed files of every format through the two commands of a new user, `init` and `run`: no panic, no
//! abort, no endless work, whatever the files hold.
//!
//! Each command has an address space of 2 GiB, 20 s of processor time, and two minutes where it waits. The
//! long run, of the same inputs, is `cargo run --release --example fuzz_commands -- INPUTS SEED`; inputs that
//! fail are kept in `fuzz-failures`.

#![allow(clippy::unwrap_used)]

#[path = "../src/formats/tests/common/mod.rs"]
pub mod common;
#[path = "fuzz/inputs.rs"]
mod inputs;

use crate::support::Bench;
use common::Seed;
use inputs::{BYTES, SECONDS, WAITED};
use std::fs;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::Stdio;
use std::sync::Mutex;

/// Inputs, and their series.
const INPUTS: u64 = 48;
const SERIES: u64 = 1;

/// How a command ended when it should not have; `None` for every ordinary end.
fn broken(bench: &Bench, arguments: &[&str]) -> Option<String> {
    let mut command = bench.command(arguments);
    command
        .env("RAYON_NUM_THREADS", "1")
        .env("RUST_BACKTRACE", "0")
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    let limit = libc::rlimit { rlim_cur: BYTES, rlim_max: BYTES };
    let processor = libc::rlimit { rlim_cur: SECONDS, rlim_max: SECONDS };
    let timer = libc::itimerval {
        it_interval: libc::timeval { tv_sec: 0, tv_usec: 0 },
        it_value: libc::timeval { tv_sec: WAITED, tv_usec: 0 },
    };
    // SAFETY: between fork and exec only setrlimit and setitimer are called, which are safe there; the timer
    // outlives exec.
    unsafe {
        command.pre_exec(move || {
            let is_set = libc::setitimer(libc::ITIMER_REAL, &timer, std::ptr::null_mut()) == 0
                && libc::setrlimit(libc::RLIMIT_CPU, &processor) == 0
                && libc::setrlimit(libc::RLIMIT_AS, &limit) == 0;
            if is_set { Ok(()) } else { Err(std::io::Error::last_os_error()) }
        });
    }
    let done = command.output().unwrap();
    inputs::broken(
        arguments[0],
        done.status.signal(),
        done.status.code(),
        &String::from_utf8_lossy(&done.stderr),
    )
}

/// `init` and `run` on one input; `None` where both end as they may.
fn both(seed: &Seed, bench: &Bench) -> Option<String> {
    let path = seed.write(&bench.path("in"), None);
    let relative = path.strip_prefix(bench.path("")).unwrap().to_string_lossy().into_owned();
    let files = inputs::files(seed, &relative);
    let arguments: Vec<&str> =
        ["init", "-o", "my.toml"].into_iter().chain(files.iter().map(String::as_str)).collect();
    broken(bench, &arguments).or_else(|| {
        if bench.path("my.toml").exists() {
            broken(bench, &["run", "my.toml", "--to", "render", "--quiet"])
        } else {
            None
        }
    })
}

#[test]
fn changed_files_go_through_init_and_run_without_a_panic() {
    let all = inputs::all();
    let failures = Mutex::new(Vec::new());
    let work = |thread: u64| {
        for k in (thread..INPUTS).step_by(2) {
            let seed = inputs::input(&all, SERIES, k);
            let bench = Bench::new();
            if let Some(why) = both(&seed, &bench) {
                let place = Path::new("fuzz-failures").join(format!("{}-{SERIES}-{k}", seed.format));
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
    assert!(failures.is_empty(), "{} of {INPUTS} inputs:\n{}", failures.len(), failures.join("\n"));
}
