//! A folder with manifests in it, and problems as plain text.

use photocurrent_core::document::Problem;
use std::path::{Path, PathBuf};

/// A folder with manifests in it.
pub struct Folder(pub tempfile::TempDir);

impl Folder {
    pub fn new() -> Folder {
        Folder(tempfile::tempdir().unwrap())
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, text).unwrap();
        path
    }

    /// Problems as plain text: `file:line:col: message`, notes and help indented below.
    pub fn show(&self, problems: &[Problem]) -> String {
        let root = format!("{}/", self.0.path().display());
        problems.iter().map(show).collect::<String>().replace(&root, "")
    }
}

fn show(problem: &Problem) -> String {
    let place = problem.at.as_ref().map(|at| format!("{at}: ")).unwrap_or_default();
    let notes: String = problem.notes.iter().map(|note| format!("\n  {note}")).collect();
    let help = problem.help.as_ref().map(|help| format!("\n  hint: {help}")).unwrap_or_default();
    format!("{place}{}{notes}{help}\n", problem.message)
}

/// All files below a folder with their bytes, to see that nothing changed.
pub fn snapshot(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(snapshot(&path))
        } else {
            found.push((path.clone(), std::fs::read(&path).unwrap()))
        }
    }
    found.sort();
    found
}
