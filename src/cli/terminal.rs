//! Everything that the command writes to its two streams: data on stdout, talk on stderr.
//!
//! A reader that goes away (`photocurrent nodes | head`) stops neither the work nor changes its exit code:
//! what it does not read any more is let go. Any other trouble with stdout, such as a full disk, is an error;
//! trouble with stderr has nobody left to hear of it.
//!
//! A program that runs commands in its own process ([`crate::embed`]) receives both streams instead.

use crate::failure::Failure;
use photocurrent_engine::Observer;
use std::cell::RefCell;
use std::io::{ErrorKind, IsTerminal, Write};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// The program that a command runs in, when it is not ours.
#[derive(Default)]
pub struct Host {
    /// What the command wrote to stdout.
    pub out: String,
    /// What it wrote to stderr.
    pub err: String,
    /// Set by the program to stop the command.
    pub cancel: Arc<AtomicBool>,
    /// Watches runs in place of bars and lines.
    pub observer: Option<Arc<dyn Observer + Send + Sync>>,
}

thread_local! {
    /// The program that this thread runs a command for.
    static HOST: RefCell<Option<Host>> = const { RefCell::new(None) };
}

/// Runs `work` with its streams going to a host, and gives the host back.
pub fn hosted<T>(host: Host, work: impl FnOnce() -> T) -> (T, Host) {
    let before = HOST.with(|place| place.replace(Some(host)));
    let done = work();
    (done, HOST.with(|place| place.replace(before)).unwrap_or_default())
}

/// What a host stops the command with; `None` where the process is ours, and signals do.
pub fn host_cancel() -> Option<Arc<AtomicBool>> {
    HOST.with(|host| host.borrow().as_ref().map(|host| host.cancel.clone()))
}

/// Who watches runs for a host.
pub fn host_observer() -> Option<Arc<dyn Observer + Send + Sync>> {
    HOST.with(|host| host.borrow().as_ref().and_then(|host| host.observer.clone()))
}

/// Is stderr a terminal that a person sits at? Never where a host receives it.
pub fn is_terminal() -> bool {
    host_cancel().is_none() && std::io::stderr().is_terminal()
}

/// Adds text to what a host receives; false without one.
fn received(add: impl FnOnce(&mut Host)) -> bool {
    HOST.with(|host| host.borrow_mut().as_mut().map(add).is_some())
}

/// Writes a line of talk to stderr, as `eprintln!` does, and goes on when nobody reads it.
macro_rules! say {
    ($($part:tt)*) => {
        $crate::terminal::talk(format_args!($($part)*))
    };
}
pub(crate) use say;

/// What [`say`] does.
pub fn talk(line: std::fmt::Arguments<'_>) {
    if received(|host| host.err.push_str(&format!("{line}\n"))) {
        return;
    }
    let mut stderr = std::io::stderr().lock();
    // Nobody is left to hear of it.
    let _ = writeln!(stderr, "{line}");
}

/// Writes data to stdout, whole; a line's end is added where there is none.
pub fn print(text: &str) -> Result<(), Failure> {
    let end = if text.ends_with('\n') { "" } else { "\n" };
    if received(|host| host.out.extend([text, end])) {
        return Ok(());
    }
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
