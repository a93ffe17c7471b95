//! Writers: files for the user.
//!
//! A writer puts files into the folder it is given (`cx.export_dir()`); the engine moves the folder to its
//! place when the node is done. What was written is also an output, a small table, so that a report can list
//! it.

pub mod contact_sheet;
pub mod diagnosis;
pub(crate) mod display;
mod events;
pub mod figure;
mod font;
pub mod frames;
pub(crate) mod picture;
pub mod plot;
pub mod recording;
pub mod table;
pub mod video;

use photocurrent_core::NodeError;
use std::path::Path;

/// Writes a file, or says which one could not be written.
fn save(path: &Path, bytes: &[u8]) -> Result<(), NodeError> {
    std::fs::write(path, bytes).map_err(|error| cannot_write(path, &error))
}

/// A file that could not be written.
fn cannot_write(path: &Path, error: &dyn std::fmt::Display) -> NodeError {
    NodeError::files(format!("cannot write {}: {error}", path.display()))
        .hint("is the disk full, or the output folder read-only?")
}

/// Refuses a list of labels that does not name each of `count` inputs of `port` once.
fn check_labels(labels: &[String], count: usize, port: &str) -> Result<(), NodeError> {
    if labels.len() != count {
        let texts = if labels.len() == 1 { "1 text".into() } else { format!("{} texts", labels.len()) };
        let inputs = if count == 1 { "1 input is".into() } else { format!("{count} inputs are") };
        return Err(NodeError::usage(format!("`labels` has {texts}, and {inputs} connected to `{port}`"))
            .hint(format!("write one label for each input of `{port}`, in the same order"))
            .param("labels"));
    }
    for (i, label) in labels.iter().enumerate() {
        if let Some(first) = labels[..i].iter().position(|other| other == label) {
            return Err(NodeError::usage(format!("the label \"{label}\" stands twice in `labels`"))
                .note(format!("label {} and label {} of the list are the same", first + 1, i + 1))
                .hint("give each row its own: readers distinguish rows by their label")
                .param(format!("labels.{i}")));
        }
    }
    Ok(())
}

#[cfg(test)]
mod testing {
    use photocurrent_core::context::Silent;
    use photocurrent_core::{Context, Notes, Rows};
    use std::collections::BTreeSet;
    use std::path::Path;
    use std::sync::atomic::AtomicBool;

    /// Calls `work` with a context that has a folder to write to; then gives result, notes and folder to
    /// `look`.
    pub(crate) fn exporting<T>(work: impl FnOnce(&Context) -> T, look: impl FnOnce(T, Vec<String>, &Path)) {
        let folder = tempfile::tempdir().unwrap();
        let (wanted, cancel, notes) = (BTreeSet::new(), AtomicBool::new(false), Notes::default());
        let result = work(&Context::new(
            Rows { start: 0, end: 0 },
            7,
            &wanted,
            &Silent,
            &cancel,
            Some(folder.path()),
            &notes,
        ));
        look(result, notes.lines(), folder.path());
    }
}
