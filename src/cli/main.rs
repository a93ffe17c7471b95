//! The photocurrent command; what it does is in `lib.rs`.

use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(photocurrent_cli::run(std::env::args_os()))
}
