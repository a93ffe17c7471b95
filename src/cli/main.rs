//! The photocurrent command; what it does is in `lib.rs`.

use std::process::ExitCode;

/// Blocks of a hundred megabytes that come and go are mapped anew each time by the system's allocator: a
/// fifth of the time of a diagnosis.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    ExitCode::from(photocurrent_cli::run(std::env::args_os()))
}
