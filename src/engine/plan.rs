//! A plan: the tasks of all variants, typed, ordered, and each written down once.
//!
//! Every node says what its outputs will look like before data exist; what cannot work is refused here, at its line, and nothing has
//! run yet. Tasks of different variants that do the same to the same are one task, found by a hash over kind, revision, parameters, files,
//! seed and the tasks before them. That hash only distinguishes tasks inside one plan; what names results for ever is the key (`key`),
//! which knows contents.

use crate::lacking::Lacking;
use crate::pipeline::Pipeline;
use crate::resolve::{Project, distinct};
use crate::schedule::{least_bytes, machine_memory};
use crate::typed::{self, Link, TypedNode};
use photocurrent_core::digest::DigestBuilder;
use photocurrent_core::document::{Origin, Problem};
use photocurrent_core::error::Trouble;
use photocurrent_core::lacking::with_examples;
use photocurrent_core::node::{AnyNode, canonical_params};
use photocurrent_core::ports::{Arity, PortSpec};
use photocurrent_core::{Catalogue, DataType, Decl, Digest, FileRef, Grain, Meta, NodeError, PortMetas};
use std::collections::{BTreeMap, BTreeSet, HashMap};
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
    /// Where it comes from: tasks and their ports, in the manifest's order.
    pub from: Vec<(TaskId, &'static str)>,
}

/// A node that runs, once for all variants that share it.
#[derive(Clone)]
pub struct Task {
    /// What its kind says about itself.
    pub decl: Decl,
    /// How far an output element reaches, with its inputs.
    pub grain: Grain,
    /// Its name where it stands in one variant, and for people: `solve`.
    pub label: String,
    /// The (variant, node)s that it stands for.
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
    /// Where its files go, below the output folder.
    pub export: Option<PathBuf>,
    /// Where the manifest names its kind.
    pub(crate) origin: Origin,
    pub(crate) node: Arc<dyn AnyNode>,
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
        self.inputs.iter().flat_map(|input| input.from.iter().map(|(task, _)| *task)).collect()
    }
}

/// One variant's nodes and their tasks.
#[derive(Clone, Debug)]
pub struct PlannedVariant {
    /// Its name.
    pub name: String,
    /// Axis and level.
    pub levels: Vec<(String, String)>,
    /// Node and task, in running order. Bypassed nodes have none, and neither have those that are left out.
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
        let mut planner = Planner {
            is_ablation,
            tasks: Vec::new(),
            known: HashMap::new(),
            problems: Vec::new(),
            lacking: Vec::new(),
            missing: None,
            memory,
            lists: BTreeMap::new(),
        };
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

    /// The task of a node in a variant.
    pub fn task_of(&self, variant: &str, node: &str) -> Option<TaskId> {
        let variant = self.variants.iter().find(|v| v.name == variant)?;
        variant.nodes.iter().find(|(id, _)| id == node).map(|(_, task)| *task)
    }

    /// The tasks of a node in all variants, each once.
    pub fn tasks_of(&self, node: &str) -> BTreeSet<TaskId> {
        self.variants.iter().flat_map(|v| &v.nodes).filter(|(id, _)| id == node).map(|(_, task)| *task).collect()
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
const LESS: &str = "make less of it: a shorter part of the recording, a lower `rate`, fewer pixels; or allow more with --memory, where the machine has it";

/// A number of bytes for people: `1.2 GB`.
fn size(bytes: u64) -> String {
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

struct Planner {
    is_ablation: bool,
    tasks: Vec<Task>,
    known: HashMap<Digest, TaskId>,
    problems: Vec<Problem>,
    lacking: Vec<Lacking>,
    /// What the node that was planned last is left out for.
    missing: Option<Missing>,
    /// Bytes that planning may take.
    memory: u64,
    /// Lists that planned outputs hold, each once, by their address, and their bytes.
    lists: BTreeMap<usize, u64>,
}

impl Planner {
    fn add(&mut self, pipeline: &Pipeline, catalogue: &Catalogue, to: &[String]) -> PlannedVariant {
        let typed = typed::check(pipeline, catalogue, &mut self.problems);
        let chosen = self.choose(pipeline, &typed, to);
        let mut tasks: Vec<Option<TaskId>> = vec![None; pipeline.nodes.len()];
        let mut missing: Vec<Option<Missing>> = vec![None; pipeline.nodes.len()];
        for &at in typed.order.iter().filter(|&&at| chosen[at]) {
            if let Some(node) = &typed.nodes[at] {
                missing[at] = node.inputs.iter().flat_map(|(_, links)| links).find_map(|link| missing[link.from.0].clone());
                if missing[at].is_none() {
                    tasks[at] = self.task(pipeline, node, &tasks);
                    missing[at] = self.missing.take();
                }
            }
        }
        self.mark_wanted(&typed, &tasks);
        let id = |at: usize| pipeline.nodes[at].id.clone();
        let nodes = typed.order.iter().filter_map(|&at| Some((id(at), tasks[at]?))).collect();
        let left_out = typed.order.iter().filter_map(|&at| missing[at].clone().map(|(missing, why)| LeftOut { node: id(at), missing, why })).collect();
        PlannedVariant { name: pipeline.variant.clone(), levels: pipeline.levels.clone(), nodes, left_out }
    }

    /// The nodes that `to` names and all they need.
    fn choose(&mut self, pipeline: &Pipeline, typed: &typed::Typed<'_>, to: &[String]) -> Vec<bool> {
        let mut chosen = vec![to.is_empty(); pipeline.nodes.len()];
        for name in to {
            match pipeline.nodes.iter().position(|node| node.id == *name) {
                Some(at) => chosen[at] = true,
                None if pipeline.broken.contains(name) => {}
                None => {
                    let problem = Problem::new(format!("there is no node `{name}`"));
                    self.problems.push(problem.did_you_mean(name, pipeline.nodes.iter().map(|node| node.id.as_str())));
                }
            }
        }
        for &at in typed.order.iter().rev().filter(|_| !to.is_empty()) {
            let needs = typed.nodes[at].iter().filter(|_| chosen[at]).flat_map(|node| &node.inputs).flat_map(|(_, links)| links);
            needs.map(|link| link.from.0).collect::<Vec<_>>().into_iter().for_each(|need| chosen[need] = true);
        }
        chosen
    }

    /// The task of one node: one that is already there, or a new one. `None` after a mistake here or before.
    fn task(&mut self, pipeline: &Pipeline, node: &TypedNode<'_>, tasks: &[Option<TaskId>]) -> Option<TaskId> {
        let mut inputs = Vec::new();
        for (port, links) in &node.inputs {
            if let Some(from) = self.present(node, port, links, tasks)? {
                inputs.push(TaskInput { port: port.name, data_type: port.data_type, from });
            }
        }
        let decl = node.kind.decl;
        let files = node.node.files();
        let seed = decl.draws.then_some(pipeline.seed);
        let folder = if self.is_ablation { Path::new(&pipeline.variant).join(&node.spec.id) } else { PathBuf::from(&node.spec.id) };
        let export = decl.exports.then_some(folder);
        let hash = structure(&decl, &node.params, &inputs, &files, seed, export.as_deref());
        let name = (pipeline.variant.clone(), node.spec.id.clone());
        if let Some(&task) = self.known.get(&hash) {
            self.tasks[task].uses.push(name);
            return Some(task);
        }
        let (outputs, grain) = self.plan(node, &inputs)?;
        self.hold(node, &outputs)?;
        let label = node.spec.id.clone();
        let canonical_params = canonical_params(&node.params, &node.kind.schema);
        let schema = Arc::new(node.kind.schema.clone());
        let changed_params = changed(&node.params, &node.kind.schema);
        let params = node.params.clone();
        let origin = node.spec.kind_origin.clone();
        let node = node.node.clone();
        self.tasks.push(Task {
            decl,
            grain,
            label,
            uses: vec![name],
            params,
            changed_params,
            canonical_params,
            schema,
            inputs,
            outputs,
            files,
            seed,
            export,
            origin,
            node,
        });
        self.known.insert(hash, self.tasks.len() - 1);
        Some(self.tasks.len() - 1)
    }

    /// The sources of one input. The outer `None`: planning stops here; the inner one: nothing will come, and the port does not mind.
    fn present(&mut self, node: &TypedNode<'_>, port: &PortSpec, links: &[Link], tasks: &[Option<TaskId>]) -> Option<Option<Vec<(TaskId, &'static str)>>> {
        let mut from = Vec::new();
        let mut stops = false;
        for link in links {
            let task = tasks[link.from.0]?;
            match self.tasks[task].output(link.from.1).map(|output| &output.meta) {
                Some(Meta::Absent { why, .. }) if port.arity != Arity::Optional => {
                    let (id, upstream) = (&node.spec.id, &self.tasks[task].label);
                    let message = format!("nodes.{id}: input `{}` needs {}, and `{upstream}.{}` has none", port.name, port.data_type, link.from.1);
                    self.problems.push(Problem::at(&link.origin, message).note(why.clone()));
                    stops = true;
                }
                Some(Meta::Absent { .. }) => {}
                _ => from.push((task, link.from.1)),
            }
        }
        if stops { None } else { Some((!from.is_empty()).then_some(from)) }
    }

    /// Counts what the metas of outputs hold; `None`, and planning stops here, when the plan itself takes too much.
    fn hold(&mut self, node: &TypedNode<'_>, outputs: &[TaskOutput]) -> Option<()> {
        for output in outputs {
            if let Meta::Frames(meta) | Meta::Truth(meta) = &output.meta {
                self.lists.insert(Arc::as_ptr(meta) as usize, output.meta.held_bytes());
            }
        }
        let held: u64 = self.lists.values().sum();
        if held <= self.memory {
            return Some(());
        }
        let message = format!("nodes.{}: the plan up to here takes {} for the times of frames, and there are {}", node.spec.id, size(held), size(self.memory));
        self.problems.push(Problem::at(&node.spec.kind_origin, message).help(LESS));
        None
    }

    /// Asks the node what its outputs will look like, and how far they reach.
    fn plan(&mut self, node: &TypedNode<'_>, inputs: &[TaskInput]) -> Option<(Vec<TaskOutput>, Grain)> {
        let meta = |&(task, port): &(TaskId, &'static str)| self.tasks[task].output(port).map(|output| output.meta.clone());
        let metas: BTreeMap<String, Vec<Meta>> = inputs.iter().map(|input| (input.port.to_string(), input.from.iter().filter_map(meta).collect())).collect();
        let mut metas = PortMetas::new(metas);
        let mut supposed: Vec<String> = Vec::new();
        let planned = loop {
            match node.node.plan(&metas) {
                Ok(planned) => break planned,
                Err(error) if node.spec.optional && error.trouble == Trouble::Files => {
                    self.missing = Some(missing(node, &error));
                    return None;
                }
                Err(error) => {
                    let missing: Vec<String> = error.lacks.iter().filter(|field| !supposed.contains(field)).cloned().collect();
                    self.refused(node, inputs, error);
                    // What else the pipeline needs is heard by going on as if this were stated.
                    supposed.extend(missing.iter().cloned());
                    metas = if missing.is_empty() { return None } else { stated(&metas, &supposed)? };
                }
            }
        };
        let specs = &node.kind.outputs;
        assert!(
            planned.len() == specs.len() && planned.iter().zip(specs).all(|(meta, spec)| meta.data_type() == spec.data_type),
            "{}: `plan` gives one meta per output, in their order and of their types",
            node.kind.decl.kind
        );
        assert!(specs.iter().all(|spec| spec.arity != Arity::Many), "{}: an output gives one value: the store has one place for it", node.kind.decl.kind);
        let outputs = planned.into_iter().zip(specs).map(|(meta, spec)| TaskOutput { port: spec.name, meta, wanted: false }).collect();
        Some((outputs, node.node.grain(&metas)))
    }

    /// Notes why a node cannot be planned, with the files that are to blame.
    fn refused(&mut self, node: &TypedNode<'_>, inputs: &[TaskInput], mut error: NodeError) {
        let blamed = inputs.iter().filter(|input| Some(input.data_type) == error.blamed_input);
        for task in blamed.flat_map(|input| &input.from).map(|(task, _)| &self.tasks[*task]) {
            let read_from = |file: &FileRef| format!("the node `{}` reads it from {}", task.label, file.path.display());
            error.notes.extend(task.files.iter().map(read_from));
            if !error.lacks.is_empty() {
                let (from, file) = (task.label.clone(), task.files.first().map(|file| file.path.clone()));
                let at = self.lacking.iter().position(|lacking| lacking.from == from && lacking.file == file).unwrap_or(self.lacking.len());
                if at == self.lacking.len() {
                    self.lacking.push(Lacking { from, file, fields: Vec::new(), refusals: 0 });
                }
                self.lacking[at].add(&error.lacks, &format!("nodes.{}", node.spec.id));
            }
        }
        self.problems.extend(typed::node_problem(node.spec, &error));
    }

    /// An output is wanted when something takes it, when it is kept, and when nothing takes any output of its node.
    fn mark_wanted(&mut self, typed: &typed::Typed<'_>, tasks: &[Option<TaskId>]) {
        let mine: BTreeSet<TaskId> = tasks.iter().flatten().copied().collect();
        let mut wanted: BTreeSet<(TaskId, &str)> = mine.iter().flat_map(|&task| self.tasks[task].inputs.iter().flat_map(|input| input.from.clone())).collect();
        let consumed: BTreeSet<TaskId> = wanted.iter().map(|(task, _)| *task).collect();
        for &task in mine.difference(&consumed) {
            wanted.extend(self.tasks[task].outputs.iter().map(|output| (task, output.port)));
        }
        wanted.extend(typed.keep.iter().filter_map(|(node, port)| Some((tasks[*node]?, *port))));
        for (task, port) in wanted {
            self.tasks[task].outputs.iter_mut().filter(|output| output.port == port).for_each(|output| output.wanted = true);
        }
    }
}

/// The metas with example values in the sensor descriptions for fields that these do not state; `None` when that cannot be.
fn stated(metas: &PortMetas, fields: &[String]) -> Option<PortMetas> {
    let mut changed: BTreeMap<String, Vec<Meta>> = BTreeMap::new();
    for (port, meta) in metas.iter() {
        let meta = match meta {
            Meta::Sensor(sensor) => Meta::Sensor(Arc::new(with_examples(sensor, fields)?)),
            other => other.clone(),
        };
        changed.entry(port.to_string()).or_default().push(meta);
    }
    Some(PortMetas::new(changed))
}

/// A name of a file or folder, and whole sentences about it.
type Missing = (String, String);

/// What a node cannot read: the parameter that it blames, without the folders before it; of a folder, its parent stays.
fn missing(node: &TypedNode<'_>, error: &NodeError) -> Missing {
    let param = error.param.as_ref().and_then(|param| node.params.pointer(&format!("/{}", param.replace('.', "/")))).and_then(serde_json::Value::as_str);
    let name = param.and_then(|path| {
        let path = Path::new(path);
        let name = path.file_name()?.to_string_lossy();
        let parent = path.parent().and_then(Path::file_name).filter(|_| path.extension().is_none());
        Some(parent.map_or(name.clone().into_owned(), |parent| format!("{}/{name}", parent.to_string_lossy())))
    });
    let hint = error.hint.as_ref().map(|hint| format!("; {hint}")).unwrap_or_default();
    (name.unwrap_or_else(|| error.message.clone()), format!("{}{hint}", error.message))
}

/// Distinguishes tasks of one plan.
fn structure(decl: &Decl, params: &serde_json::Value, inputs: &[TaskInput], files: &[FileRef], seed: Option<u64>, export: Option<&Path>) -> Digest {
    let mut hash = DigestBuilder::new("photocurrent-task/1");
    // Paths count here, as two files of one content are still two files to watch.
    hash.text(decl.kind).integer(decl.revision.into()).text(&canonical_params(params, &serde_json::Value::Null));
    for input in inputs {
        hash.text(input.port).integer(input.from.len() as i64);
        for (task, port) in &input.from {
            hash.integer(*task as i64).text(port);
        }
    }
    for file in files {
        hash.text(&file.param).text(&file.path.to_string_lossy());
    }
    hash.text(&format!("{seed:?} {export:?}"));
    hash.finish()
}

/// Parameters that are not as they would be by default.
fn changed(params: &serde_json::Value, schema: &serde_json::Value) -> Vec<String> {
    let entries = params.as_object().into_iter().flatten();
    let differs = |name: &str, value: &serde_json::Value| schema["properties"][name]["default"] != *value;
    // A value that is null stands for "not given"; its default is then left out of the schema.
    entries.filter(|(name, value)| !value.is_null() && differs(name, value)).map(|(name, value)| format!("{name} = {value}")).collect()
}
