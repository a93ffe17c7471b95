//! A plan: the tasks of all variants, typed, ordered, and each written down once.
//!
//! Every node says what its outputs will look like before data exist; what cannot work is refused here, at
//! its line, and nothing has run yet. Tasks of different variants that do the same to the same are one task,
//! found by a hash over kind, revision, parameters, files, seed and the tasks before them. That hash only
//! distinguishes tasks inside one plan; what names results for ever is the key (`key`), which knows contents.

use crate::blocks::is_of;
use crate::budget::{LESS, least_bytes, machine_memory, size};
use crate::lacking::Lacking;
use crate::pipeline::Pipeline;
use crate::planner::Planner;
use crate::resolve::{Project, distinct};
use crate::task::{PlannedVariant, Task, TaskId};
use crate::typed;
use photocurrent_core::document::Problem;
use photocurrent_core::{Catalogue, Digest};
use std::collections::BTreeSet;
use std::path::Path;

/// Which part of a project to plan.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    /// Names of variants, whole (`front_end=on,readout=off`) or in part (`front_end=on`); none means all.
    pub variants: Vec<String>,
    /// Nodes to reach: only they and what they need; none means all.
    pub to: Vec<String>,
    /// Bytes that planning, and the smallest piece of any task, may take; none = all that this process may
    /// ever have.
    pub memory: Option<u64>,
}

/// What there is to do.
pub struct Plan {
    /// Names the manifest in the cache's history.
    pub manifest_id: Digest,
    /// Every task after those it needs.
    pub tasks: Vec<Task>,
    /// The variants and their nodes.
    pub variants: Vec<PlannedVariant>,
    /// Does the manifest have an ablation? Then files go into one folder per variant.
    pub is_ablation: bool,
}

impl Plan {
    /// Plans the selected variants of a project.
    ///
    /// # Errors
    /// Every independent mistake, each at its place.
    pub fn new(
        project: &Project,
        catalogue: &Catalogue,
        selection: &Selection,
    ) -> Result<Plan, Vec<Problem>> {
        Plan::after(project, catalogue, selection, Vec::new())
    }

    /// Reads a manifest as [`Project::load`] does and plans the selected variants, in one round: what is
    /// sound is planned even when something else is wrong, so that a file that cannot be read is reported
    /// together with a mistake in the manifest.
    ///
    /// # Errors
    /// Every independent mistake, each at its place.
    pub fn load(
        path: &Path,
        sets: &[String],
        catalogue: &Catalogue,
        selection: &Selection,
    ) -> Result<(Project, Plan), Vec<Problem>> {
        let (project, problems) = Project::resolve(path, sets, catalogue);
        let plan = Plan::after(&project, catalogue, selection, problems)?;
        Ok((project, plan))
    }

    /// Plans with mistakes that were found before.
    fn after(
        project: &Project,
        catalogue: &Catalogue,
        selection: &Selection,
        mut problems: Vec<Problem>,
    ) -> Result<Plan, Vec<Problem>> {
        let mut unknown = Vec::new();
        let selected = select_variants(project, &selection.variants, &mut unknown);
        // A broken ablation has no variants to name: that the named one is not there only follows.
        if problems.is_empty() {
            problems = unknown;
        }
        let is_ablation = project.ablation.is_some();
        let memory = [selection.memory, machine_memory()].into_iter().flatten().min().unwrap_or(u64::MAX);
        let mut planner = Planner::new(is_ablation, memory);
        let mut variants = Vec::new();
        let mut found = Vec::new();
        for pipeline in &project.pipelines {
            if selected.iter().any(|chosen| std::ptr::eq(*chosen, pipeline)) {
                variants.push(planner.add(pipeline, catalogue, &selection.to));
            } else {
                typed::check(pipeline, catalogue, &mut planner.problems);
            }
            found.push((pipeline.variant.as_str(), std::mem::take(&mut planner.problems)));
        }
        let mut problems = distinct(problems, found);
        problems.extend(planner.lacking.iter().filter_map(Lacking::problem));
        if !problems.is_empty() {
            return Err(problems);
        }
        let plan = Plan { manifest_id: project.manifest_id, tasks: planner.tasks, variants, is_ablation };
        plan.refuse_beyond(memory)?;
        Ok(plan)
    }

    /// Refuses what can never run: a task whose results, even of its smallest piece, take more than `bytes`
    /// of memory.
    fn refuse_beyond(&self, bytes: u64) -> Result<(), Vec<Problem>> {
        let problems: Vec<Problem> = self
            .tasks
            .iter()
            .filter_map(|task| {
                let least = least_bytes(task);
                (least > bytes).then(|| {
                    let message = format!(
                        "nodes.{}: its results need about {} of memory at a time, and there are {}",
                        task.label,
                        size(least),
                        size(bytes)
                    );
                    Problem::at(&task.origin, message).help(LESS)
                })
            })
            .collect();
        if problems.is_empty() { Ok(()) } else { Err(problems) }
    }

    /// The tasks of a node in all variants, each once; of one that runs in blocks of time those of all
    /// blocks, unless `node` names one (`solve[2]`).
    pub fn tasks_of(&self, node: &str) -> BTreeSet<TaskId> {
        self.variants
            .iter()
            .flat_map(|v| &v.nodes)
            .filter(|(id, _)| is_of(id, node))
            .map(|(_, task)| *task)
            .collect()
    }

    /// The names of all nodes that are planned, each once.
    pub fn node_names(&self) -> Vec<&str> {
        let mut names: Vec<&str> = Vec::new();
        for (id, _) in self.variants.iter().flat_map(|v| &v.nodes) {
            if !names.contains(&id.as_str()) {
                names.push(id);
            }
        }
        names
    }
}

/// The variants that a command line names. A part of a name selects every variant that has all its levels.
fn select_variants<'a>(
    project: &'a Project,
    names: &[String],
    problems: &mut Vec<Problem>,
) -> Vec<&'a Pipeline> {
    if names.is_empty() {
        return project.pipelines.iter().collect();
    }
    let matches = |name: &str, pipeline: &Pipeline| {
        let has = |part: &str| {
            part.split_once('=').is_some_and(|(axis, level)| {
                pipeline.levels.iter().any(|(a, l)| a == axis.trim() && l == level.trim())
            })
        };
        pipeline.variant == name || name.split(',').all(has)
    };
    for name in names.iter().filter(|name| !project.pipelines.iter().any(|pipeline| matches(name, pipeline)))
    {
        let mut known: Vec<String> =
            project.pipelines.iter().map(|pipeline| pipeline.variant.clone()).collect();
        let shown = known.len().min(12);
        let more = known.len() - shown;
        known.truncate(shown);
        let problem = Problem::new(format!("there is no variant `{name}`"))
            .did_you_mean(name, known.iter().map(String::as_str));
        problems.push(if more > 0 { problem.note(format!("and {more} more")) } else { problem });
    }
    project.pipelines.iter().filter(|pipeline| names.iter().any(|name| matches(name, pipeline))).collect()
}
