//! A pipeline: the nodes of one variant with everything laid over, not yet checked against the catalogue.

use crate::ablation::Variant;
use crate::blocks::Blocks;
use crate::expect::{self, Bound};
use crate::manifest::Manifest;
use photocurrent_core::document::{Item, Key, Origin, Problem, Table, Tree};
use std::collections::BTreeSet;

/// The nodes of one variant.
#[derive(Clone, Debug)]
pub struct Pipeline {
    /// `front_end=on,readout=off`, or `base` without an ablation.
    pub variant: String,
    /// Axis and level, in the order of the axes.
    pub levels: Vec<(String, String)>,
    /// What it is for.
    pub about: Option<String>,
    /// For nodes that draw.
    pub seed: u64,
    /// Outputs to store though nothing downstream asks: `solve.tracks`.
    pub keep: Vec<Reference>,
    /// How a recording is cut in time; `None` where it is not.
    pub blocks: Option<Blocks>,
    /// In written order.
    pub nodes: Vec<NodeSpec>,
    /// Nodes that have a mistake already reported, with their places: what hangs on them is not complained
    /// about.
    pub(crate) broken: BTreeSet<String>,
}

/// A name of an output, `node.port` or `node`, and where it is written.
#[derive(Clone, Debug)]
pub struct Reference {
    /// As written.
    pub text: String,
    /// Where.
    pub origin: Origin,
}

impl Reference {
    /// The node and, when one is named, the port.
    pub fn parts(&self) -> (&str, Option<&str>) {
        match self.text.split_once('.') {
            Some((node, port)) => (node, Some(port)),
            None => (&self.text, None),
        }
    }
}

/// What is plugged into one input.
#[derive(Clone, Debug)]
pub struct Wire {
    /// The input's name and place.
    pub port: Key,
    /// Where it leads from.
    pub from: Vec<Reference>,
    /// Written as a list?
    pub is_list: bool,
}

/// One node as written and laid over.
#[derive(Clone, Debug)]
pub struct NodeSpec {
    /// Its name.
    pub id: String,
    /// Where the name stands.
    pub origin: Origin,
    /// `family/name`.
    pub kind: String,
    /// Where the kind stands.
    pub kind_origin: Origin,
    /// Its parameters as written.
    pub params: Tree,
    /// Its inputs as written.
    pub wires: Vec<Wire>,
    /// Left out, its input passed on?
    pub bypass: Option<Origin>,
    /// Left out, with what takes something from it, while its files are missing?
    pub optional: bool,
    /// Bounds on its scores, in written order.
    pub expect: Vec<Bound>,
}

impl Pipeline {
    /// The pipeline that `table` describes: `manifest` with a variant's overlays, which collects what is
    /// wrong.
    pub(crate) fn from_table(table: &Table, variant: Variant, manifest: &mut Manifest) -> Pipeline {
        let pipeline = table.get("pipeline").and_then(Tree::as_table).cloned().unwrap_or_default();
        let seed = match pipeline.get("seed").map(|tree| &tree.item) {
            Some(Item::Integer(seed)) => *seed as u64,
            _ => 0,
        };
        let mut result = Pipeline {
            variant: variant.name,
            levels: variant.levels,
            about: pipeline.get("about").and_then(Tree::as_str).map(str::to_string),
            seed,
            keep: pipeline.get("keep").map(references).unwrap_or_default(),
            blocks: None,
            nodes: Vec::new(),
            broken: manifest.broken.clone(),
        };
        if let Some(tree) = pipeline.get("blocks") {
            result.blocks = Blocks::from_tree(tree);
            if result.blocks.is_none() {
                let problem = Problem::at(&tree.origin, "`pipeline.blocks` does not say how long a block is");
                manifest
                    .problems
                    .push(problem.help("such as `blocks = { length = \"2 s\", overlap = \"50 ms\" }`"));
            }
        }
        let nodes = table.get("nodes").and_then(Tree::as_table).cloned().unwrap_or_default();
        if nodes.entries.is_empty() && manifest.problems.is_empty() {
            let problem = Problem { at: manifest.start.clone(), ..Problem::new("the manifest has no node") };
            manifest.problems.push(problem.help("add a table such as `[nodes.sensor]` with a `kind`"));
        }
        for (key, tree) in &nodes.entries {
            if manifest.broken.contains(&key.name) {
                continue;
            }
            match NodeSpec::from_tree(key, tree, &mut manifest.problems) {
                Some(node) => result.nodes.push(node),
                None => {
                    manifest.problems.push(without_kind(key, &nodes, manifest.extends));
                    result.broken.insert(key.name.clone());
                }
            }
        }
        result
    }

    /// A node by name.
    pub fn node(&self, id: &str) -> Option<&NodeSpec> {
        self.nodes.iter().find(|node| node.id == id)
    }
}

/// A node without a kind: in a manifest that extends another one it was meant to change a node there.
fn without_kind(key: &Key, nodes: &Table, extends: bool) -> Problem {
    if !extends {
        return Problem::at(&key.origin, format!("nodes.{}: `kind` is missing", key.name))
            .help("`photocurrent nodes` lists the kinds");
    }
    let has_kind = |node: &Tree| node.as_table().is_some_and(|node| node.get("kind").is_some());
    let below = nodes.entries.iter().filter(|(_, node)| has_kind(node)).map(|(key, _)| key.name.as_str());
    let problem = Problem::at(
        &key.origin,
        format!("there is no node `{}` below to change, and without `kind` it is no new one", key.name),
    );
    problem.label("unknown node").did_you_mean(&key.name, below)
}

fn references(tree: &Tree) -> Vec<Reference> {
    let items = match &tree.item {
        Item::Array(items) => items.as_slice(),
        _ => std::slice::from_ref(tree),
    };
    items
        .iter()
        .filter_map(|item| Some(Reference { text: item.as_str()?.to_string(), origin: item.origin.clone() }))
        .collect()
}

impl NodeSpec {
    fn from_tree(key: &Key, tree: &Tree, problems: &mut Vec<Problem>) -> Option<NodeSpec> {
        let table = tree.as_table()?;
        let kind = table.get("kind")?;
        let empty = Tree { item: Item::Table(Table::default()), origin: kind.origin.clone() };
        let wires = table.get("in").and_then(Tree::as_table).into_iter().flat_map(|wires| &wires.entries);
        Some(NodeSpec {
            id: key.name.clone(),
            origin: key.origin.clone(),
            kind: kind.as_str()?.to_string(),
            kind_origin: kind.origin.clone(),
            params: table.get("params").cloned().unwrap_or(empty),
            wires: wires
                .map(|(port, tree)| Wire {
                    port: port.clone(),
                    from: references(tree),
                    is_list: matches!(tree.item, Item::Array(_)),
                })
                .collect(),
            bypass: table
                .get("bypass")
                .filter(|tree| tree.item == Item::Boolean(true))
                .map(|tree| tree.origin.clone()),
            optional: table.get("optional").is_some_and(|tree| tree.item == Item::Boolean(true)),
            expect: table
                .get("expect")
                .and_then(Tree::as_table)
                .map_or_else(Vec::new, |t| expect::read(t, problems)),
        })
    }

    /// Where a parameter stands, `window.start` being `start` inside `window` and `labels.1` the second of a
    /// list; the kind's place when it is not written.
    pub fn param_origin(&self, param: &str) -> &Origin {
        let mut tree = &self.params;
        for name in param.split('.') {
            let inner = match &tree.item {
                Item::Table(table) => table.get(name),
                Item::Array(items) => name.parse().ok().and_then(|at: usize| items.get(at)),
                _ => None,
            };
            match inner {
                Some(inner) => tree = inner,
                None => {
                    return if std::ptr::eq(tree, &self.params) { &self.kind_origin } else { &tree.origin };
                }
            }
        }
        &tree.origin
    }
}
