//! A folder with a manifest, a cache and a place for files, and what came of a run.

use super::folder::Folder;
use super::toys::catalogue;
use crate::{End, Options, Outcome, Plan, Project, Selection, Unobserved, run};
use photocurrent_core::Digest;
use photocurrent_core::document::Problem;
use photocurrent_store::Cache;
use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;

pub struct Bench {
    pub folder: Folder,
    pub cache: Cache,
}

impl Bench {
    pub fn new() -> Bench {
        let folder = Folder::new();
        let cache = Cache::open(&folder.path("cache")).unwrap();
        Bench { folder, cache }
    }

    /// The plan of a manifest, or what is wrong with it.
    pub fn planned(&self, text: &str, sets: &[&str], to: &[&str]) -> Result<Plan, Vec<Problem>> {
        let path = self.folder.write("m.toml", text);
        let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
        let project = Project::load(&path, &sets, &catalogue())?;
        let selection = Selection {
            variants: Vec::new(),
            to: to.iter().map(|node| node.to_string()).collect(),
            memory: None,
        };
        Plan::new(&project, &catalogue(), &selection)
    }

    pub fn plan(&self, text: &str, sets: &[&str]) -> Plan {
        self.planned(text, sets, &[]).unwrap_or_else(|problems| panic!("{problems:#?}"))
    }

    pub fn options(&self) -> Options {
        Options { threads: 2, out_dir: self.folder.path("out"), ..Options::default() }
    }

    pub fn run(&self, text: &str, sets: &[&str]) -> Outcome {
        self.run_with(&self.plan(text, sets), &self.options())
    }

    pub fn run_with(&self, plan: &Plan, options: &Options) -> Outcome {
        run(plan, &self.cache, options, &Unobserved, &AtomicBool::new(false))
    }
}

/// The tasks that ended so.
pub fn ended(outcome: &Outcome, end: End) -> Vec<&str> {
    outcome.tasks.iter().filter(|task| task.end == end).map(|task| task.label.as_str()).collect()
}

/// The tasks that ran.
pub fn executed(outcome: &Outcome) -> Vec<&str> {
    ended(outcome, End::Executed)
}

/// What every output is, by task and port.
pub fn digests(outcome: &Outcome) -> BTreeMap<String, Digest> {
    let all = outcome.tasks.iter().flat_map(|task| {
        task.outputs.iter().map(|(port, output)| (format!("{}.{port}", task.label), output.digest))
    });
    all.collect()
}

pub fn assert_well(outcome: &Outcome) {
    let errors: Vec<_> = outcome.failures().map(|(_, task)| (&task.label, &task.error)).collect();
    assert!(errors.is_empty(), "{errors:#?}");
}
