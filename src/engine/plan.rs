//! A plan: the tasks of all variants, typed, ordered, and each written down once.
//!
//! Every node says what its outputs will look like before data exist; what cannot work is refused here, at its line, and nothing has
//! run yet. Tasks of different variants that do the same to the same are one task, found by a hash over kind, revision, parameters, files,
//! seed and the tasks before them. That hash only distinguishes tasks inside one plan; what names results for ever is the key (`key`),
//! which knows contents.

use crate::blocks::{Source, extracted, is_of};
use crate::lacking::Lacking;
use crate::pipeline::Pipeline;
use crate::planner::Planner;
use crate::resolve::{Project, distinct};
use crate::schedule::{least_bytes, machine_memory};
use crate::typed;
use photocurrent_core::document::{Origin, Problem};
use photocurrent_core::node::AnyNode;
use photocurrent_core::{Catalogue, DataType, Decl, Digest, FileRef, Grain, Meta, NodeError};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A task's place in [`Plan::tasks`].
pub type TaskId = usize;

/// One output of a task.
#[derive(Clone, Debug)]
pub struct TaskOutput {
    /// The port.
    pub port: &'static str,
    /// What it will look like.
    pub meta: Meta,
    /// Does anybody want it? What nobody wants is not stored, and the node may leave it out.
    pub wanted: bool,
}

/// One input of a task.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TaskInput {
    /// The port.
    pub port: &'static str,
    /// What it takes.
    pub data_type: DataType,
    /// Where it comes from, in the manifest's order.
    pub from: Vec<Source>,
}

/// A node that runs, once for all variants that share it.
#[derive(Clone)]
pub struct Task {
    /// What its kind says about itself.
    pub decl: Decl,
    /// How far an output element reaches, with its inputs.
    pub grain: Grain,
    /// Its name where it stands in one variant, and for people: `solve`, or `solve[2]` for the second block of time.
    pub label: String,
    /// The (variant, node)s that it stands for; of a node in blocks of time with the block, as in the label.
    pub uses: Vec<(String, String)>,
    /// All parameters, defaults filled in.
    pub params: serde_json::Value,
    /// The parameters that differ from their defaults, as `name = value`.
    pub changed_params: Vec<String>,
    /// The parameters as they enter the key.
    pub canonical_params: String,
    /// Schema of the parameters.
    pub(crate) schema: Arc<serde_json::Value>,
    /// Its inputs; an absent optional one is left out.
    pub inputs: Vec<TaskInput>,
    /// Its outputs, all of them.
    pub outputs: Vec<TaskOutput>,
    /// Files that its result depends on.
    pub files: Vec<FileRef>,
    /// The seed, for a node that draws.
    pub seed: Option<u64>,
    /// May a recording be cut into blocks of time for it?
    pub local_in_time: bool,
    /// Where its files go, below the output folder.
    pub export: Option<PathBuf>,
    /// Where the manifest names its kind.
    pub(crate) origin: Origin,
    pub(crate) node: Arc<dyn AnyNode>,
}

impl TaskInput {
    /// What is known of what comes in, one for each value.
    ///
    /// # Errors
    /// When the blocks of time of a value cannot be joined.
    pub fn metas(&self, tasks: &[Task]) -> Result<Vec<Meta>, NodeError> {
        extracted(&self.from, |task, port| {
            let output = tasks[task].output(port).map(|output| output.meta.clone());
            output.ok_or_else(|| NodeError::failed(format!("{} has no output `{port}`", tasks[task].label)))
        })
    }
}

impl Task {
    /// An output by its port.
    pub fn output(&self, port: &str) -> Option<&TaskOutput> {
        self.outputs.iter().find(|output| output.port == port)
    }

    /// The outputs that a run stores.
    pub fn stored(&self) -> impl Iterator<Item = &TaskOutput> {
        self.outputs.iter().filter(|output| output.wanted && !matches!(output.meta, Meta::Absent { .. }))
    }

    /// The tasks that it needs.
    pub fn needs(&self) -> BTreeSet<TaskId> {
        self.inputs.iter().flat_map(|input| input.from.iter().map(|source| source.task)).collect()
    }
}

/// One variant's nodes and their tasks.
#[derive(Clone, Debug)]
pub struct PlannedVariant {
    /// Its name.
    pub name: String,
    /// Axis and level.
    pub levels: Vec<(String, String)>,
    /// Node and task, in running order; `solve[1]`, `solve[2]` where a node runs in blocks of time. Bypassed nodes have none, and neither have those that are left out.
    pub nodes: Vec<(String, TaskId)>,
    /// Nodes marked `optional` whose files are missing, and those that take something from them, in running order.
    pub left_out: Vec<LeftOut>,
}

/// A node that does not run because a file is missing.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct LeftOut {
    /// Its name.
    pub node: String,
    /// What is missing, as a name of a file or a folder.
    pub missing: String,
    /// In whole sentences.
    pub why: String,
}

/// Which part of a project to plan.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    /// Names of variants, whole (`front_end=on,readout=off`) or in part (`front_end=on`); none means all.
    pub variants: Vec<String>,
    /// Nodes to reach: only they and what they need; none means all.
    pub to: Vec<String>,
    /// Bytes that planning, and the smallest piece of any task, may take; none = all that this process may ever have.
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
    pub fn new(project: &Project, catalogue: &Catalogue, selection: &Selection) -> Result<Plan, Vec<Problem>> {
        Plan::after(project, catalogue, selection, Vec::new())
    }

    /// Reads a manifest as [`Project::load`] does and plans the selected variants, in one round: what is sound is planned even when something else is
    /// wrong, so that a file that cannot be read is reported together with a mistake in the manifest.
    ///
    /// # Errors
    /// Every independent mistake, each at its place.
    pub fn load(path: &Path, sets: &[String], catalogue: &Catalogue, selection: &Selection) -> Result<(Project, Plan), Vec<Problem>> {
        let (project, problems) = Project::resolve(path, sets, catalogue);
        let plan = Plan::after(&project, catalogue, selection, problems)?;
        Ok((project, plan))
    }

    /// Plans with mistakes that were found before.
    fn after(project: &Project, catalogue: &Catalogue, selection: &Selection, mut problems: Vec<Problem>) -> Result<Plan, Vec<Problem>> {
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

    /// Refuses what can never run: a task whose results, even of its smallest piece, take more than `bytes` of memory.
    fn refuse_beyond(&self, bytes: u64) -> Result<(), Vec<Problem>> {
        let problems: Vec<Problem> = self
            .tasks
            .iter()
            .filter_map(|task| {
                let least = least_bytes(task);
                (least > bytes).then(|| {
                    let message = format!("nodes.{}: its results need about {} of memory at a time, and there are {}", task.label, size(least), size(bytes));
                    Problem::at(&task.origin, message).help(LESS)
                })
            })
            .collect();
        if problems.is_empty() { Ok(()) } else { Err(problems) }
    }

    /// The tasks of a node in all variants, each once; of one that runs in blocks of time those of all blocks, unless `node` names one (`solve[2]`).
    pub fn tasks_of(&self, node: &str) -> BTreeSet<TaskId> {
        self.variants.iter().flat_map(|v| &v.nodes).filter(|(id, _)| is_of(id, node)).map(|(_, task)| *task).collect()
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

/// What to do about a plan that is too large.
pub(crate) const LESS: &str = "make less of it: a shorter part of the recording, blocks of time (`pipeline.blocks`), a lower `rate`, fewer pixels; \
                    or allow more with --memory, where the machine has it";

/// A number of bytes for people: `1.2 GB`.
pub(crate) fn size(bytes: u64) -> String {
    match bytes as f64 {
        bytes if bytes < 1e6 => format!("{:.1} kB", bytes * 1e-3),
        bytes if bytes < 1e9 => format!("{:.1} MB", bytes * 1e-6),
        bytes => format!("{:.1} GB", bytes * 1e-9),
    }
}

/// The variants that a command line names. A part of a name selects every variant that has all its levels.
fn select_variants<'a>(project: &'a Project, names: &[String], problems: &mut Vec<Problem>) -> Vec<&'a Pipeline> {
    if names.is_empty() {
        return project.pipelines.iter().collect();
    }
    let matches = |name: &str, pipeline: &Pipeline| {
        let has = |part: &str| part.split_once('=').is_some_and(|(axis, level)| pipeline.levels.iter().any(|(a, l)| a == axis.trim() && l == level.trim()));
        pipeline.variant == name || name.split(',').all(has)
    };
    for name in names.iter().filter(|name| !project.pipelines.iter().any(|pipeline| matches(name, pipeline))) {
        let mut known: Vec<String> = project.pipelines.iter().map(|pipeline| pipeline.variant.clone()).collect();
        let shown = known.len().min(12);
        let more = known.len() - shown;
        known.truncate(shown);
        let problem = Problem::new(format!("there is no variant `{name}`")).did_you_mean(name, known.iter().map(String::as_str));
        problems.push(if more > 0 { problem.note(format!("and {more} more")) } else { problem });
    }
    project.pipelines.iter().filter(|pipeline| names.iter().any(|name| matches(name, pipeline))).collect()
}
