//! Everything that the command writes to its two streams: data on stdout, talk on stderr.
//!
//! A reader that goes away (`photocurrent nodes | head`) stops neither the work nor changes its exit code:
//! what it does not read any more is let go. Any other trouble with stdout, such as a full disk, is an error;
//! trouble with stderr has nobody left to hear of it.

use crate::failure::Failure;
use std::io::{ErrorKind, Write};

/// Writes a line of talk to stderr, as `eprintln!` does, and goes on when nobody reads it.
macro_rules! say {
    ($($part:tt)*) => {
        $crate::terminal::talk(format_args!($($part)*))
    };
}
pub(crate) use say;

/// What [`say`] does.
pub fn talk(line: std::fmt::Arguments<'_>) {
    let mut stderr = std::io::stderr().lock();
    // Nobody is left to hear of it.
    let _ = writeln!(stderr, "{line}");
}

/// Writes data to stdout, whole; a line's end is added where there is none.
pub fn print(text: &str) -> Result<(), Failure> {
    match written(&mut std::io::stdout().lock(), text) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        done => Ok(done?),
    }
}

fn written(to: &mut impl Write, text: &str) -> std::io::Result<()> {
    to.write_all(text.as_bytes())?;
    if !text.ends_with('\n') {
        to.write_all(b"\n")?;
    }
    to.flush()
}

/// Writes JSON to stdout, indented.
pub fn print_json(value: &serde_json::Value) -> Result<(), Failure> {
    print(&serde_json::to_string_pretty(value).map_err(|error| Failure::other(error.to_string()))?)
}
