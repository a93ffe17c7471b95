//! Runs a command of the user's in the folder of a node, until it ends or the run is interrupted.
//!
//! What it prints goes to `stdout.txt` and `stderr.txt` in that folder. No shell takes part unless the
//! command names one. A command that fails shows the last of what it said. What else it does, nobody here
//! knows: a node that runs one needs a text in its parameters that stands for the command's version.

use photocurrent_core::{Context, NodeError};
use std::fs::File;
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::time::Duration as Pause;

/// Lines of what a failing command said that are shown.
const LAST_LINES: usize = 20;

/// Runs `program` in `folder` to its end; `param` is the parameter that names it.
///
/// # Errors
/// When it cannot start, ends with another exit code than 0, or the run is interrupted (the command is ended
/// then).
pub(crate) fn run(
    folder: &Path,
    program: &str,
    arguments: &[String],
    param: &str,
    cx: &Context,
) -> Result<(), NodeError> {
    let said = |name: &str| {
        File::create(folder.join(name))
            .map_err(|error| NodeError::files(format!("cannot write {name}: {error}")))
    };
    let mut child = Command::new(program)
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(said("stdout.txt")?)
        .stderr(said("stderr.txt")?)
        .spawn()
        .map_err(|error| NodeError::failed(format!("cannot start \"{program}\": {error}")).param(param))?;
    let status = loop {
        match child.try_wait() {
            Ok(Some(status)) => break status,
            Ok(None) => {}
            Err(error) => return Err(NodeError::failed(format!("lost \"{program}\": {error}"))),
        }
        if let Err(interrupted) = cx.advance(0) {
            // It may have ended by itself in between: then there is nothing to end.
            child.kill().ok();
            child.wait().ok();
            return Err(interrupted);
        }
        std::thread::sleep(Pause::from_millis(20));
    };
    if status.success() { Ok(()) } else { Err(failed(folder, program, status).param(param)) }
}

/// A command that did not end well, with the last of what it said.
fn failed(folder: &Path, program: &str, status: ExitStatus) -> NodeError {
    let how = match status.code() {
        Some(code) => format!("exit code {code}"),
        None => format!("{status}"),
    };
    let mut error = NodeError::failed(format!("\"{program}\" ended with {how}"));
    for name in ["stderr.txt", "stdout.txt"] {
        let text = std::fs::read(folder.join(name))
            .map(|bytes| String::from_utf8_lossy(&bytes).into_owned())
            .unwrap_or_default();
        let lines: Vec<&str> = text.lines().collect();
        let last = &lines[lines.len().saturating_sub(LAST_LINES)..];
        if !last.is_empty() {
            error = error.note(format!("the last of {name}:"));
            error = last.iter().fold(error, |error, line| error.note(format!("| {line}")));
        }
    }
    error
}
