//! How a plan is made: node by node in running order, each asked what its outputs will look like; in blocks
//! of time where the pipeline has them.

use crate::blocks::{Blocks, Cuts, Extract, Source, extracted, name_of, node_of};
use crate::budget::{LESS, size};
use crate::lacking::Lacking;
use crate::pipeline::Pipeline;
use crate::task::{LeftOut, PlannedVariant, Task, TaskId, TaskInput, TaskOutput};
use crate::typed::{self, Link, TypedNode};
use photocurrent_core::digest::DigestBuilder;
use photocurrent_core::document::Problem;
use photocurrent_core::error::Trouble;
use photocurrent_core::lacking::with_examples;
use photocurrent_core::node::{Working, canonical_params};
use photocurrent_core::ports::{Arity, PortSpec};
use photocurrent_core::quantity::Duration;
use photocurrent_core::{Catalogue, Decl, Digest, FileRef, Grain, Meta, NodeError, PortMetas, TimeSpan};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Plans the nodes of one variant after the other.
pub(crate) struct Planner {
    pub is_ablation: bool,
    pub tasks: Vec<Task>,
    known: HashMap<Digest, TaskId>,
    pub problems: Vec<Problem>,
    pub lacking: Vec<Lacking>,
    /// What the node that was planned last is left out for.
    missing: Option<Missing>,
    /// Bytes that planning may take.
    memory: u64,
    /// Lists that planned outputs hold, each once, by their address, and their bytes.
    lists: BTreeMap<usize, u64>,
    /// In which block of time the task lies that is being planned, in words.
    of_block: Option<String>,
}

/// What comes to an input.
enum Coming {
    There,
    /// Nothing, and why.
    Nothing(String),
    /// Blocks of time that cannot be joined, and why.
    Apart(String),
}

/// The tasks of a node: none, one, or one for every block of time.
type Made = Vec<TaskId>;

impl Planner {
    /// Of nothing yet, with so many bytes for the plan itself.
    pub(crate) fn new(is_ablation: bool, memory: u64) -> Planner {
        Planner {
            is_ablation,
            tasks: Vec::new(),
            known: HashMap::new(),
            problems: Vec::new(),
            lacking: Vec::new(),
            missing: None,
            memory,
            lists: BTreeMap::new(),
            of_block: None,
        }
    }

    /// Plans a variant, as far as `to` needs it.
    pub(crate) fn add(
        &mut self,
        pipeline: &Pipeline,
        catalogue: &Catalogue,
        to: &[String],
    ) -> PlannedVariant {
        let typed = typed::check(pipeline, catalogue, &mut self.problems);
        let chosen = self.choose(pipeline, &typed, to);
        let mut made: Vec<Made> = vec![Vec::new(); pipeline.nodes.len()];
        let mut missing: Vec<Option<Missing>> = vec![None; pipeline.nodes.len()];
        let mut cuts = None;
        for &at in typed.order.iter().filter(|&&at| chosen[at]) {
            if let Some(node) = &typed.nodes[at] {
                missing[at] = node
                    .inputs
                    .iter()
                    .flat_map(|(_, links)| links)
                    .find_map(|link| missing[link.from.0].clone());
                if missing[at].is_none() {
                    made[at] = self.make(pipeline, node, &made, &mut cuts).unwrap_or_default();
                    missing[at] = self.missing.take();
                }
            }
        }
        self.mark_wanted(&typed, &made);
        let id = |at: usize| pipeline.nodes[at].id.clone();
        let named = |at: usize| {
            let count = made[at].len();
            made[at]
                .iter()
                .enumerate()
                .map(move |(k, task)| (name_of(&pipeline.nodes[at].id, (count > 1).then_some(k)), *task))
        };
        let nodes = typed.order.iter().flat_map(|&at| named(at)).collect();
        let left_out = typed
            .order
            .iter()
            .filter_map(|&at| {
                missing[at].clone().map(|(missing, why)| LeftOut { node: id(at), missing, why })
            })
            .collect();
        let expect = pipeline
            .nodes
            .iter()
            .flat_map(|node| node.expect.iter().map(|bound| (node.id.clone(), bound.clone())))
            .collect();
        let (name, levels) = (pipeline.variant.clone(), pipeline.levels.clone());
        PlannedVariant { name, levels, nodes, left_out, expect }
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
                    self.problems
                        .push(problem.did_you_mean(name, pipeline.nodes.iter().map(|node| node.id.as_str())));
                }
            }
        }
        for &at in typed.order.iter().rev().filter(|_| !to.is_empty()) {
            let needs = typed.nodes[at]
                .iter()
                .filter(|_| chosen[at])
                .flat_map(|node| &node.inputs)
                .flat_map(|(_, links)| links);
            needs
                .map(|link| link.from.0)
                .collect::<Vec<_>>()
                .into_iter()
                .for_each(|need| chosen[need] = true);
        }
        chosen
    }

    /// The tasks of one node: one, or one for every block of time where the pipeline has them. `None` after a
    /// mistake here or before.
    fn make(
        &mut self,
        pipeline: &Pipeline,
        node: &TypedNode<'_>,
        made: &[Made],
        cuts: &mut Option<Cuts>,
    ) -> Option<Made> {
        if node.inputs.iter().flat_map(|(_, links)| links).any(|link| made[link.from.0].is_empty()) {
            return None;
        }
        let Some(blocks) = pipeline.blocks.as_ref().filter(|_| node.kind.local_in_time) else {
            return Some(vec![self.task(pipeline, node, made, cuts.as_ref(), None)?]);
        };
        let cut: Vec<Meta> = node
            .inputs
            .iter()
            .filter(|(port, _)| port.data_type.has_windows())
            .flat_map(|(_, links)| links)
            .filter_map(|link| {
                let [task] = made[link.from.0][..] else { return None };
                self.tasks[task].output(link.from.1).map(|output| output.meta.clone())
            })
            .collect();
        let span = cut.iter().filter_map(Meta::span_to_cut).reduce(TimeSpan::union);
        if let (None, Some(span)) = (&cuts, span) {
            match blocks.cut(span) {
                Ok(found) => *cuts = Some(found),
                Err(message) => {
                    self.problems.push(Problem::at(&blocks.origin, message).help(
                        "make them longer; is the recording that long, or is one stamp far from all others?",
                    ));
                    return None;
                }
            }
        }
        let in_blocks =
            node.inputs.iter().flat_map(|(_, links)| links).any(|link| made[link.from.0].len() > 1);
        match cuts.as_ref().filter(|cuts| cuts.len() > 1 && (in_blocks || span.is_some())) {
            Some(cuts) => {
                self.check_overlap(blocks, &cut)?;
                (0..cuts.len()).map(|k| self.task(pipeline, node, made, Some(cuts), Some(k))).collect()
            }
            None => Some(vec![self.task(pipeline, node, made, cuts.as_ref(), None)?]),
        }
    }

    /// A frame that begins in a block must end in its overlap: else no block would have it whole.
    fn check_overlap(&mut self, blocks: &Blocks, cut: &[Meta]) -> Option<()> {
        let (exposure, delay) = cut
            .iter()
            .filter_map(Meta::longest_frame_ns)
            .max_by_key(|(exposure, delay)| exposure + delay)
            .unwrap_or((0, 0));
        if exposure + delay <= blocks.overlap_ns {
            return Some(());
        }
        let (overlap, exposure, delay) =
            (Duration::new(blocks.overlap_ns), Duration::new(exposure), Duration::new(delay));
        let message = format!(
            "blocks overlap by {overlap}, which is shorter than a frame: exposures last \
                               up to {exposure}, and rows follow within {delay}"
        );
        self.problems.push(
            Problem::at(&blocks.overlap_origin, message)
                .help("two frame periods are a good overlap, such as `overlap = \"50 ms\"`"),
        );
        None
    }

    /// The task of one node, or of one block of it: one that is already there, or a new one. `None` after a
    /// mistake here.
    fn task(
        &mut self,
        pipeline: &Pipeline,
        node: &TypedNode<'_>,
        made: &[Made],
        cuts: Option<&Cuts>,
        block: Option<usize>,
    ) -> Option<TaskId> {
        self.of_block = cuts.zip(block).map(|(cuts, block)| cuts.said(block));
        let mut inputs = Vec::new();
        for (port, links) in &node.inputs {
            if let Some(from) = self.present(node, port, links, made, cuts.map(|cuts| (cuts, block)))? {
                inputs.push(TaskInput { port: port.name, data_type: port.data_type, from });
            }
        }
        let decl = node.kind.decl;
        let files = node.node.files();
        let seed = decl.draws.then_some(pipeline.seed);
        let folder = if self.is_ablation {
            Path::new(&pipeline.variant).join(&node.spec.id)
        } else {
            PathBuf::from(&node.spec.id)
        };
        let export = decl.exports.then_some(folder);
        let label = name_of(&node.spec.id, block);
        let hash = structure(&decl, &node.params, &inputs, &files, seed, export.as_deref());
        let name = (pipeline.variant.clone(), label.clone());
        if let Some(&task) = self.known.get(&hash) {
            self.tasks[task].uses.push(name);
            return Some(task);
        }
        let (outputs, grain, working) = self.plan(node, &inputs)?;
        self.hold(node, &outputs)?;
        let canonical_params = canonical_params(&node.params, &node.kind.schema);
        let schema = Arc::new(node.kind.schema.clone());
        let changed_params = changed(&node.params, &node.kind.schema);
        let params = node.params.clone();
        let (origin, local_in_time) = (node.spec.kind_origin.clone(), node.kind.local_in_time);
        let metrics = node.metrics.clone();
        let node = node.node.clone();
        self.tasks.push(Task {
            decl,
            grain,
            working,
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
            local_in_time,
            metrics,
            export,
            origin,
            node,
        });
        self.known.insert(hash, self.tasks.len() - 1);
        Some(self.tasks.len() - 1)
    }

    /// The sources of one input. The outer `None`: planning stops here; the inner one: nothing will come, and
    /// the port does not mind.
    fn present(
        &mut self,
        node: &TypedNode<'_>,
        port: &PortSpec,
        links: &[Link],
        made: &[Made],
        of: Option<(&Cuts, Option<usize>)>,
    ) -> Option<Option<Vec<Source>>> {
        let mut from: Vec<Source> = Vec::new();
        let mut stops = false;
        for (value, link) in links.iter().enumerate() {
            let tasks = &made[link.from.0];
            let source = |k: usize, extract: Extract| Source {
                value: value as u32,
                task: tasks[k],
                port: link.from.1,
                extract,
            };
            let sources: Vec<Source> = match of {
                Some((_, Some(block))) if tasks.len() > 1 => vec![source(block, Extract::All)],
                Some((cuts, Some(block))) if port.data_type.has_windows() => {
                    vec![source(0, Extract::Window(cuts.window(block)))]
                }
                Some((cuts, None)) if tasks.len() > 1 => {
                    (0..tasks.len()).map(|k| source(k, Extract::Share(cuts.share(k)))).collect()
                }
                _ => vec![source(0, Extract::All)],
            };
            let (id, upstream) = (&node.spec.id, &self.tasks[tasks[0]].label);
            let problem = match self.look(&sources) {
                Coming::There => {
                    from.extend(sources);
                    continue;
                }
                Coming::Nothing(_) if port.arity == Arity::Optional => continue,
                Coming::Nothing(why) => {
                    let message = format!(
                        "nodes.{id}: input `{}` needs {}, and `{upstream}.{}` has none",
                        port.name, port.data_type, link.from.1
                    );
                    self.of_block
                        .clone()
                        .into_iter()
                        .fold(Problem::at(&link.origin, message).note(why), Problem::note)
                }
                Coming::Apart(why) => {
                    let upstream = node_of(upstream);
                    let message = format!(
                        "nodes.{id}: input `{}` takes `{upstream}.{}`, which blocks of \
                                           time do not give as one",
                        port.name, link.from.1
                    );
                    let help = format!("leave `{id}` out (--to names what is wanted), or `pipeline.blocks`");
                    Problem::at(&link.origin, message).note(why).help(help)
                }
            };
            self.problems.push(problem);
            stops = true;
        }
        if stops { None } else { Some((!from.is_empty()).then_some(from)) }
    }

    /// What comes of some sources of one value.
    fn look(&self, sources: &[Source]) -> Coming {
        let meta = |source: &Source| self.tasks[source.task].output(source.port).map(|output| &output.meta);
        if let Some(Meta::Absent { why, .. }) =
            sources.iter().filter_map(meta).find(|meta| matches!(meta, Meta::Absent { .. }))
        {
            return Coming::Nothing(why.clone());
        }
        let found = extracted::<Meta, NodeError>(sources, |task, port| {
            self.tasks[task]
                .output(port)
                .map(|output| output.meta.clone())
                .ok_or_else(|| NodeError::failed("no such output"))
        });
        match found.as_deref() {
            Ok([Meta::Frames(frames)])
                if frames.times.is_empty() && sources.iter().any(|source| source.extract != Extract::All) =>
            {
                Coming::Nothing("no frame is exposed wholly in it".into())
            }
            Ok(_) => Coming::There,
            Err(error) => Coming::Apart(error.message.clone()),
        }
    }

    /// Counts what the metas of outputs hold; `None`, and planning stops here, when the plan itself takes too
    /// much.
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
        let message = format!(
            "nodes.{}: the plan up to here takes {} for the times of frames, and there are {}",
            node.spec.id,
            size(held),
            size(self.memory)
        );
        self.problems.push(Problem::at(&node.spec.kind_origin, message).help(LESS));
        None
    }

    /// Asks the node what its outputs will look like, how far they reach and what memory it takes besides.
    fn plan(
        &mut self,
        node: &TypedNode<'_>,
        inputs: &[TaskInput],
    ) -> Option<(Vec<TaskOutput>, Grain, Working)> {
        let metas = inputs
            .iter()
            .map(|input| Ok((input.port.to_string(), input.metas(&self.tasks)?)))
            .collect::<Result<BTreeMap<_, _>, NodeError>>();
        let mut metas = PortMetas::new(metas.ok()?);
        let mut supposed: Vec<String> = Vec::new();
        let planned = loop {
            match node.node.plan(&metas) {
                Ok(planned) => break planned,
                Err(error) if node.spec.optional && error.trouble == Trouble::Files => {
                    self.missing = Some(missing(node, &error));
                    return None;
                }
                Err(error) => {
                    let missing: Vec<String> =
                        error.lacks.iter().filter(|field| !supposed.contains(field)).cloned().collect();
                    self.refused(node, inputs, error);
                    // What else the pipeline needs is heard by going on as if this were stated.
                    supposed.extend(missing.iter().cloned());
                    metas = if missing.is_empty() { return None } else { stated(&metas, &supposed)? };
                }
            }
        };
        let specs = &node.kind.outputs;
        assert!(
            planned.len() == specs.len()
                && planned.iter().zip(specs).all(|(meta, spec)| meta.data_type() == spec.data_type),
            "{}: `plan` gives one meta per output, in their order and of their types",
            node.kind.decl.kind
        );
        assert!(
            specs.iter().all(|spec| spec.arity != Arity::Many),
            "{}: an output gives one value: the store has one place for it",
            node.kind.decl.kind
        );
        let outputs = planned
            .into_iter()
            .zip(specs)
            .map(|(meta, spec)| TaskOutput { port: spec.name, meta, wanted: false })
            .collect();
        Some((outputs, node.node.grain(&metas), node.node.working(&metas)))
    }

    /// Notes why a node cannot be planned, with the files that are to blame.
    fn refused(&mut self, node: &TypedNode<'_>, inputs: &[TaskInput], mut error: NodeError) {
        error.notes.extend(self.of_block.clone());
        let blamed = inputs.iter().filter(|input| Some(input.data_type) == error.blamed_input);
        for task in blamed.flat_map(|input| &input.from).map(|source| &self.tasks[source.task]) {
            let read_from =
                |file: &FileRef| format!("the node `{}` reads it from {}", task.label, file.path.display());
            error.notes.extend(task.files.iter().map(read_from));
            if !error.lacks.is_empty() {
                let (from, file) = (task.label.clone(), task.files.first().map(|file| file.path.clone()));
                let at = self
                    .lacking
                    .iter()
                    .position(|lacking| lacking.from == from && lacking.file == file)
                    .unwrap_or(self.lacking.len());
                if at == self.lacking.len() {
                    self.lacking.push(Lacking { from, file, fields: Vec::new(), refusals: 0 });
                }
                self.lacking[at].add(&error.lacks, &format!("nodes.{}", node.spec.id));
            }
        }
        self.problems.extend(typed::node_problem(node.spec, &error));
    }

    /// An output is wanted when something takes it, when it is kept, and when nothing takes any output of its
    /// node.
    fn mark_wanted(&mut self, typed: &typed::Typed<'_>, made: &[Made]) {
        let mine: BTreeSet<TaskId> = made.iter().flatten().copied().collect();
        let sources =
            mine.iter().flat_map(|&task| self.tasks[task].inputs.iter().flat_map(|input| &input.from));
        let mut wanted: BTreeSet<(TaskId, &str)> = sources.map(|source| (source.task, source.port)).collect();
        let consumed: BTreeSet<TaskId> = wanted.iter().map(|(task, _)| *task).collect();
        for &task in mine.difference(&consumed) {
            wanted.extend(self.tasks[task].outputs.iter().map(|output| (task, output.port)));
        }
        wanted
            .extend(typed.keep.iter().flat_map(|(node, port)| made[*node].iter().map(|task| (*task, *port))));
        for (task, port) in wanted {
            self.tasks[task]
                .outputs
                .iter_mut()
                .filter(|output| output.port == port)
                .for_each(|output| output.wanted = true);
        }
    }
}

/// The metas with example values in the sensor descriptions for fields that these do not state; `None` when
/// that cannot be.
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

/// What a node cannot read: the parameter that it blames, without the folders before it; of a folder, its
/// parent stays.
fn missing(node: &TypedNode<'_>, error: &NodeError) -> Missing {
    let param = error
        .param
        .as_ref()
        .and_then(|param| node.params.pointer(&format!("/{}", param.replace('.', "/"))))
        .and_then(serde_json::Value::as_str);
    let name = param.and_then(|path| {
        let path = Path::new(path);
        let name = path.file_name()?.to_string_lossy();
        let parent = path.parent().and_then(Path::file_name).filter(|_| path.extension().is_none());
        Some(
            parent.map_or(name.clone().into_owned(), |parent| format!("{}/{name}", parent.to_string_lossy())),
        )
    });
    let hint = error.hint.as_ref().map(|hint| format!("; {hint}")).unwrap_or_default();
    (name.unwrap_or_else(|| error.message.clone()), format!("{}{hint}", error.message))
}

/// Distinguishes tasks of one plan.
fn structure(
    decl: &Decl,
    params: &serde_json::Value,
    inputs: &[TaskInput],
    files: &[FileRef],
    seed: Option<u64>,
    export: Option<&Path>,
) -> Digest {
    let mut hash = DigestBuilder::new("photocurrent-task/1");
    // Paths count here, as two files of one content are still two files to watch.
    hash.text(decl.kind)
        .integer(decl.revision.into())
        .text(&canonical_params(params, &serde_json::Value::Null));
    for input in inputs {
        hash.text(input.port).integer(input.from.len() as i64);
        for source in &input.from {
            hash.integer(source.task as i64)
                .text(source.port)
                .text(&format!("{} {:?}", source.value, source.extract));
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
    entries
        .filter(|(name, value)| !value.is_null() && differs(name, value))
        .map(|(name, value)| format!("{name} = {value}"))
        .collect()
}
