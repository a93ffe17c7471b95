//! A task: a node that runs, once for all variants that share it, with what comes in and what it will give.

use crate::blocks::{Source, extracted};
use crate::expect::Bound;
use photocurrent_core::document::Origin;
use photocurrent_core::node::{AnyNode, Working};
use photocurrent_core::{DataType, Decl, FileRef, Grain, Meta, NodeError};
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;

/// A task's place in [`crate::Plan::tasks`].
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
    /// Memory besides inputs and outputs.
    pub working: Working,
    /// Its name where it stands in one variant, and for people: `solve`, or `solve[2]` for the second block
    /// of time.
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
    /// Scores that it may give.
    pub(crate) metrics: Vec<String>,
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
    /// Node and task, in running order; `solve[1]`, `solve[2]` where a node runs in blocks of time. Bypassed
    /// nodes have none, and neither have those that are left out.
    pub nodes: Vec<(String, TaskId)>,
    /// Nodes marked `optional` whose files are missing, and those that take something from them, in running
    /// order.
    pub left_out: Vec<LeftOut>,
    /// Bounds on scores, by node.
    pub expect: Vec<(String, Bound)>,
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
