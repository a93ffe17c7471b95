//! What the commands share: how they fail, how they write, how they find a project.

use crate::args::Target;
use crate::file_kind::need_manifest;
use crate::run_record::check_same_manifest;
use crate::terminal::say;
use photocurrent_core::document::Problem;
use photocurrent_engine::{End, Outcome, Plan, Project, Selection};
use photocurrent_store::{StoreError, unnamed_in};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Why a command stops.
pub enum Failure {
    /// The manifest or what it asks for is wrong; nothing ran.
    Problems(Vec<Problem>),
    /// Anything else.
    Other {
        /// What, in the reader's terms.
        message: String,
        /// For the shell.
        code: u8,
    },
}

impl Failure {
    /// With exit code 1.
    pub fn other(message: impl Into<String>) -> Failure {
        Failure::Other { message: message.into(), code: 1 }
    }
}

impl From<Vec<Problem>> for Failure {
    fn from(problems: Vec<Problem>) -> Failure {
        Failure::Problems(problems)
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Failure {
        Failure::other(error.to_string())
    }
}

impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Failure {
        Failure::other(error.to_string())
    }
}

/// An exit code, or why not.
pub type Done = Result<u8, Failure>;

/// Refuses a path that a manifest cannot name.
pub fn must_be_utf8(path: &Path) -> Result<(), Failure> {
    if path.to_str().is_some() {
        return Ok(());
    }
    Err(Failure::Other { message: format!("{}: a manifest names files in UTF-8, and this name is not\n  hint: rename the file", path.display()), code: 2 })
}

/// Writes a file whole or not at all.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let failed = |error: std::io::Error| Failure::other(format!("{}: cannot write: {error}", path.display()));
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(failed)?;
    let mut file = unnamed_in(folder).map_err(failed)?;
    file.write_all(bytes).map_err(failed)?;
    file.as_file().sync_all().map_err(failed)?;
    file.persist(path).map_err(|error| failed(error.error))?;
    Ok(())
}

impl Target {
    /// Loads and plans, for `command`.
    pub fn plan(&self, command: &str) -> Result<(Project, Plan), Failure> {
        need_manifest(&self.manifest, command)?;
        let catalogue = photocurrent_nodes::catalogue();
        let selection = Selection { variants: self.variants.clone(), to: self.to.clone(), memory: self.memory };
        Ok(Plan::load(&self.manifest, &self.sets, &catalogue, &selection)?)
    }

    /// Where files for the user go.
    pub fn out_dir(&self) -> PathBuf {
        self.out.clone().unwrap_or_else(|| Path::new("out").join(self.manifest.file_stem().unwrap_or_default()))
    }

    /// Refuses to put files where those of another manifest with the same name are; a folder that is named by `--out` is taken as it is.
    pub fn check_out_dir(&self) -> Result<(), Failure> {
        if self.out.is_some() {
            return Ok(());
        }
        let folder = self.out_dir();
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let within = self.manifest.canonicalize().ok().and_then(|path| Some(path.parent()?.file_name()?.to_string_lossy().into_owned())).unwrap_or_default();
        let hint = format!("name another folder, such as --out out/{within}-{name}, or the same folder by --out to replace what is there");
        check_same_manifest(&folder, &self.manifest, "they would be replaced by those of", &hint)
    }
}

/// Reports on stderr which nodes failed and why, and which were left out for it.
pub fn failed_nodes(outcome: &Outcome) {
    for (_, task) in outcome.failures() {
        let error = task.error.as_ref().map(ToString::to_string).unwrap_or_default();
        say!("\nerror: node {} ({}) failed: {error}", task.label, task.kind);
        if let Some(error) = task.error.as_ref().filter(|error| !error.problems.is_empty()) {
            crate::problems::render(&error.problems);
        }
    }
    for task in outcome.tasks.iter().filter(|task| task.end == End::Skipped) {
        say!("skipped: {} needs {}", task.label, task.because.join(", "));
    }
}

/// `1,234`.
pub fn grouped(count: u64) -> String {
    let digits = count.to_string();
    let mut text = String::new();
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// `1 mistake`, `3 mistakes`.
pub fn print_count(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

/// `1.2 GB`.
pub fn human_bytes(bytes: u64) -> String {
    let units = ["B", "kB", "MB", "GB", "TB"];
    let mut value = bytes as f64;
    let mut unit = 0;
    while value >= 999.5 && unit + 1 < units.len() {
        value /= 1000.0;
        unit += 1;
    }
    if unit == 0 { format!("{bytes} B") } else { format!("{value:.1} {}", units[unit]) }
}

/// `85 ms`, `3.2 s`, `4 min 10 s`.
pub fn human_seconds(seconds: f64) -> String {
    match seconds {
        s if s < 1.0 => format!("{:.0} ms", s * 1e3),
        s if s < 60.0 => format!("{s:.1} s"),
        s => format!("{:.0} min {:.0} s", (s / 60.0).floor(), s % 60.0),
    }
}
