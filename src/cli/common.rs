//! What the commands that run a manifest share: how they load and plan it, where its files go, how failed
//! nodes are reported.

use crate::args::Target;
use crate::failure::Failure;
use crate::file_kind::need_manifest;
use crate::run_record::check_same_manifest;
use crate::terminal::say;
use photocurrent_engine::{End, Outcome, Plan, Project, Selection};
use std::path::{Path, PathBuf};

impl Target {
    /// Loads and plans, for `command`.
    pub fn plan(&self, command: &str) -> Result<(Project, Plan), Failure> {
        need_manifest(&self.manifest, command)?;
        let catalogue = photocurrent_nodes::catalogue();
        let selection =
            Selection { variants: self.variants.clone(), to: self.to.clone(), memory: self.memory };
        Ok(Plan::load(&self.manifest, &self.sets, &catalogue, &selection)?)
    }

    /// Where files for the user go.
    pub fn out_dir(&self) -> PathBuf {
        self.out
            .clone()
            .unwrap_or_else(|| Path::new("out").join(self.manifest.file_stem().unwrap_or_default()))
    }

    /// Refuses to put files where those of another manifest with the same name are; a folder that is named by
    /// `--out` is taken as it is.
    pub fn check_out_dir(&self) -> Result<(), Failure> {
        if self.out.is_some() {
            return Ok(());
        }
        let folder = self.out_dir();
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let within = self
            .manifest
            .canonicalize()
            .ok()
            .and_then(|path| Some(path.parent()?.file_name()?.to_string_lossy().into_owned()))
            .unwrap_or_default();
        let hint = format!(
            "name another folder, such as --out out/{within}-{name}, or the same folder by \
                            --out to replace what is there"
        );
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
