//! A pipeline against the catalogue: kinds, parameters, sockets, bypasses, cycles. Every independent mistake
//! is reported at its place.
//!
//! Nothing is planned here yet: no node is asked what its outputs look like, so the check is cheap and
//! touches no file. A node with a mistake is left out of what follows, and so is, without a word, what hangs
//! on it.

use crate::pipeline::{NodeSpec, Pipeline, Reference, Wire};
use photocurrent_core::document::{Origin, Problem, nearest};
use photocurrent_core::node::{AnyNode, Built};
use photocurrent_core::ports::{Arity, PortSpec};
use photocurrent_core::{Catalogue, DataType, Kind, NodeError, schema};
use std::sync::Arc;

/// An output of a node: its place in the pipeline's list, and the port's name.
pub(crate) type Output = (usize, &'static str);

/// One connection, bypassed nodes already passed over.
#[derive(Clone, Debug)]
pub(crate) struct Link {
    pub from: Output,
    pub origin: Origin,
}

/// One node with its kind found and its sockets checked.
pub(crate) struct TypedNode<'a> {
    pub spec: &'a NodeSpec,
    pub kind: &'a Kind,
    pub node: Arc<dyn AnyNode>,
    /// All parameters, defaults filled in.
    pub params: serde_json::Value,
    /// Scores that it may give.
    pub metrics: Vec<String>,
    /// For each connected input, in the kind's order.
    pub inputs: Vec<(&'a PortSpec, Vec<Link>)>,
}

/// One pipeline, checked.
pub(crate) struct Typed<'a> {
    /// By the place in the pipeline's list; `None` for a node with a mistake, and for one that is bypassed.
    pub nodes: Vec<Option<TypedNode<'a>>>,
    /// Places in an order in which every node comes after those it needs.
    pub order: Vec<usize>,
    /// Outputs that are stored though nothing asks for them.
    pub keep: Vec<Output>,
}

struct Checker<'a, 'p> {
    pipeline: &'a Pipeline,
    kinds: Vec<Option<&'a Kind>>,
    /// For a bypassed node: the output that is passed on, and the one name that stands for it upstream.
    bypasses: Vec<Option<(&'static str, &'a Reference)>>,
    /// Nodes with a mistake.
    broken: Vec<bool>,
    problems: &'p mut Vec<Problem>,
}

/// Checks a pipeline and gives what of it is sound.
pub(crate) fn check<'a>(
    pipeline: &'a Pipeline,
    catalogue: &'a Catalogue,
    problems: &mut Vec<Problem>,
) -> Typed<'a> {
    let count = pipeline.nodes.len();
    let kinds = pipeline.nodes.iter().map(|node| catalogue.get(&node.kind)).collect();
    let mut checker =
        Checker { pipeline, kinds, bypasses: vec![None; count], broken: vec![false; count], problems };
    let mut built: Vec<Option<Built>> =
        pipeline.nodes.iter().enumerate().map(|(at, node)| checker.build(at, node, catalogue)).collect();
    for at in 0..count {
        checker.find_bypass(at);
    }
    let mut inputs: Vec<Vec<(&PortSpec, Vec<Link>)>> = (0..count).map(|at| checker.inputs(at)).collect();
    let order = checker.order(&inputs);
    let keep =
        pipeline.keep.iter().filter_map(|name| checker.output(name, None)).map(|link| link.from).collect();
    let mut nodes: Vec<Option<TypedNode<'_>>> = Vec::new();
    for (at, spec) in pipeline.nodes.iter().enumerate() {
        let sound = !checker.broken[at] && checker.bypasses[at].is_none();
        nodes.push(match (checker.kinds[at], built[at].take()) {
            (Some(kind), Some(built)) if sound => Some(TypedNode {
                spec,
                kind,
                node: built.node.into(),
                params: built.params,
                metrics: built.metrics,
                inputs: std::mem::take(&mut inputs[at]),
            }),
            _ => None,
        });
    }
    Typed { nodes, order, keep }
}

/// A node's own words about a mistake, at the parameter that it blames.
pub(crate) fn node_problem(spec: &NodeSpec, error: &NodeError) -> Vec<Problem> {
    let origin = error.param.as_ref().map_or(&spec.kind_origin, |param| spec.param_origin(param));
    let mut problem = Problem::at(origin, format!("nodes.{}: {}", spec.id, error.message));
    problem.notes = error.notes.clone();
    problem.help = error.hint.clone();
    std::iter::once(problem).chain(error.problems.iter().cloned()).collect()
}

fn list<'s>(names: impl Iterator<Item = &'s PortSpec>) -> String {
    let names: Vec<String> = names.map(|port| format!("`{}` ({})", port.name, port.data_type)).collect();
    if names.is_empty() { "none".into() } else { names.join(", ") }
}

impl<'a> Checker<'a, '_> {
    fn id(&self, at: usize) -> &'a str {
        &self.pipeline.nodes[at].id
    }

    fn find(&self, id: &str) -> Option<usize> {
        self.pipeline.nodes.iter().position(|node| node.id == id)
    }

    fn build(&mut self, at: usize, node: &'a NodeSpec, catalogue: &'a Catalogue) -> Option<Built> {
        let before = self.problems.len();
        let Some(kind) = self.kinds[at] else {
            let problem = Problem::at(&node.kind_origin, format!("there is no node kind `{}`", node.kind))
                .label("unknown kind");
            self.problems.push(match catalogue.in_place_of(&node.kind) {
                Some(instead) => problem.help(instead),
                None => problem.did_you_mean(&node.kind, catalogue.kinds().iter().map(|kind| kind.decl.kind)),
            });
            self.broken[at] = true;
            return None;
        };
        schema::validate(
            &node.params,
            &kind.schema,
            &format!("parameter of {}", kind.decl.kind),
            self.problems,
        );
        name_readers(&mut self.problems[before..], kind, catalogue);
        if self.problems.len() == before {
            match kind.build(schema::to_json(&node.params, &kind.schema)) {
                Ok(built) => {
                    self.bounds(node, kind, &built.metrics);
                    return Some(built);
                }
                Err(error) => self.problems.extend(node_problem(node, &error)),
            }
        }
        // A mistake in a parameter does not affect the sockets: they are still checked, but nothing is
        // planned from here on.
        None
    }

    /// Bounds are on scores that the node gives.
    fn bounds(&mut self, node: &NodeSpec, kind: &Kind, metrics: &[String]) {
        for bound in node.expect.iter().filter(|bound| !metrics.contains(&bound.metric)) {
            let name = kind.decl.kind;
            let problem = Problem::at(&bound.origin, format!("`{}` is not a score of {name}", bound.metric))
                .label("unknown score");
            self.problems.push(if metrics.is_empty() {
                problem.help("it gives no scores: write `expect` at an evaluator, such as score/psnr")
            } else {
                problem.did_you_mean(&bound.metric, metrics.iter().map(String::as_str))
            });
        }
    }

    /// `bypass = true` needs one connected input and one output of one type.
    fn find_bypass(&mut self, at: usize) {
        let node = &self.pipeline.nodes[at];
        let (Some(origin), Some(kind)) = (&node.bypass, self.kinds[at]) else { return };
        let mut pairs = Vec::new();
        for wire in node.wires.iter().filter(|wire| wire.from.len() == 1) {
            let input = kind.input(&wire.port.name);
            let outputs = kind.main_output().map_or(kind.outputs.as_slice(), std::slice::from_ref);
            pairs.extend(
                outputs
                    .iter()
                    .filter(|output| input.is_some_and(|i| i.data_type == output.data_type))
                    .map(|o| (o.name, &wire.from[0])),
            );
        }
        if let [pair] = pairs[..] {
            self.bypasses[at] = Some(pair);
            return;
        }
        let inputs = list(
            kind.inputs.iter().filter(|input| node.wires.iter().any(|wire| wire.port.name == input.name)),
        );
        let found = if pairs.is_empty() { "it has none" } else { "it has several" };
        let problem = Problem::at(
            origin,
            format!(
                "nodes.{}: a bypass needs one connected input and one output of the same type, and {found}",
                node.id
            ),
        );
        let problem = problem
            .note(format!("connected inputs: {inputs}"))
            .note(format!("outputs: {}", list(kind.outputs.iter())));
        self.problems.push(
            problem.help("take `bypass` out, and connect what follows to what stands before this node"),
        );
        self.broken[at] = true;
    }

    /// What a name stands for, bypassed nodes passed over. `wanted` is the input it is plugged into.
    fn output(&mut self, name: &Reference, wanted: Option<(usize, &PortSpec)>) -> Option<Link> {
        let link = self.written_output(name, wanted)?;
        let mut from = link.from;
        for _ in 0..self.pipeline.nodes.len() {
            let Some((port, upstream)) = self.bypasses[from.0] else { return Some(Link { from, ..link }) };
            if port != from.1 {
                let id = self.id(from.0);
                let problem = Problem::at(
                    &name.origin,
                    format!("`{id}` is bypassed, and its output `{}` is gone", from.1),
                );
                self.problems
                    .push(problem.note(format!("a bypassed node passes on its input as `{id}.{port}` only")));
                return None;
            }
            from = self.written_output(upstream, None)?.from;
        }
        // Bypassed nodes that wait for each other: reported as a cycle.
        None
    }

    fn written_output(&mut self, name: &Reference, wanted: Option<(usize, &PortSpec)>) -> Option<Link> {
        let (id, port) = name.parts();
        let Some(at) = self.find(id) else {
            if !self.pipeline.broken.contains(id) {
                let problem =
                    Problem::at(&name.origin, format!("there is no node `{id}`")).label("unknown node");
                self.problems
                    .push(problem.did_you_mean(id, self.pipeline.nodes.iter().map(|node| node.id.as_str())));
            }
            return None;
        };
        let kind = self.kinds[at]?;
        let outputs = &kind.outputs;
        let output = match (port, kind.main_output()) {
            (Some(port), _) => outputs.iter().find(|output| output.name == port),
            (None, Some(main)) => Some(main),
            (None, None) => {
                let right = outputs
                    .iter()
                    .filter(|output| wanted.is_some_and(|(_, input)| input.data_type == output.data_type))
                    .collect::<Vec<_>>();
                let problem = Problem::at(
                    &name.origin,
                    format!("`{id}` has {}, so its port must be named", count(outputs.len(), "output")),
                );
                let problem =
                    problem.note(format!("outputs of {}: {}", kind.decl.kind, list(outputs.iter())));
                self.problems.push(match right[..] {
                    [right] => problem.help(format!("write \"{id}.{}\"", right.name)),
                    _ => problem,
                });
                return None;
            }
        };
        let Some(output) = output else {
            let port = port.unwrap_or_default();
            let problem =
                Problem::at(&name.origin, format!("`{port}` is not an output of {}", kind.decl.kind))
                    .label("unknown port");
            self.problems.push(problem.did_you_mean(port, kind.outputs.iter().map(|output| output.name)));
            return None;
        };
        Some(Link { from: (at, output.name), origin: name.origin.clone() })
    }

    fn inputs(&mut self, at: usize) -> Vec<(&'a PortSpec, Vec<Link>)> {
        let node = &self.pipeline.nodes[at];
        let Some(kind) = self.kinds[at] else { return Vec::new() };
        let before = self.problems.len();
        // What a slip of the hand stands for is not reported as missing a second time.
        let mut suggested: Vec<&str> = Vec::new();
        for wire in node.wires.iter().filter(|wire| kind.input(&wire.port.name).is_none()) {
            let problem = Problem::at(
                &wire.port.origin,
                format!("`{}` is not an input of {}", wire.port.name, kind.decl.kind),
            )
            .label("unknown port");
            let names = || kind.inputs.iter().map(|input| input.name);
            self.problems.push(problem.did_you_mean(&wire.port.name, names()));
            suggested.extend(nearest(&wire.port.name, names()));
        }
        let mut inputs = Vec::new();
        for input in &kind.inputs {
            let wire = node.wires.iter().find(|wire| wire.port.name == input.name && !wire.from.is_empty());
            match wire {
                Some(wire) => inputs.extend(self.links(at, input, wire).map(|links| (input, links))),
                None if input.arity != Arity::Optional && !suggested.contains(&input.name) => {
                    self.problems.push(self.missing(at, input))
                }
                None => {}
            }
        }
        self.broken[at] |= self.problems.len() > before;
        inputs
    }

    fn missing(&self, at: usize, input: &PortSpec) -> Problem {
        let node = &self.pipeline.nodes[at];
        let problem = Problem::at(
            &node.origin,
            format!("nodes.{}: input `{}` ({}) is not connected", node.id, input.name, input.data_type),
        );
        let offers = self.offers(at, input.data_type);
        let Some(first) = offers.first() else {
            return problem.note(format!("no node here has an output of type {}", input.data_type));
        };
        let value = if input.arity == Arity::Many { format!("[{first}]") } else { first.clone() };
        let entry = format!("{} = {value}", input.name);
        // An empty list stands there already, and one key does not stand twice.
        let help = match node.wires.iter().any(|wire| wire.port.name == input.name) {
            true => format!("write `{entry}`"),
            false if node.wires.is_empty() => format!("add `in = {{ {entry} }}`"),
            false => format!("add `{entry}` to `in`"),
        };
        let others =
            if offers.len() > 1 { format!(" (or one of {})", offers[1..].join(", ")) } else { String::new() };
        problem.help(format!("{help}{others}"))
    }

    /// The outputs of other nodes that have a type, in quotes as they are written.
    fn offers(&self, at: usize, data_type: DataType) -> Vec<String> {
        let mut offers = Vec::new();
        for (other, kind) in self.kinds.iter().enumerate().filter(|(other, _)| *other != at) {
            for output in
                kind.iter().flat_map(|kind| &kind.outputs).filter(|output| output.data_type == data_type)
            {
                let alone = kind.is_some_and(|kind| kind.outputs.len() == 1);
                offers.push(if alone {
                    format!("\"{}\"", self.id(other))
                } else {
                    format!("\"{}.{}\"", self.id(other), output.name)
                });
            }
        }
        offers
    }

    fn links(&mut self, at: usize, input: &'a PortSpec, wire: &Wire) -> Option<Vec<Link>> {
        if wire.is_list && input.arity != Arity::Many && wire.from.len() > 1 {
            let problem = Problem::at(
                &wire.port.origin,
                format!(
                    "input `{}` of {} takes one value, found a list of {}",
                    input.name,
                    self.id(at),
                    wire.from.len()
                ),
            );
            self.problems.push(
                problem
                    .label("expected \"node.port\"")
                    .help(format!("write one of them, such as `{} = \"{}\"`", input.name, wire.from[0].text)),
            );
            return None;
        }
        let links: Vec<Option<Link>> = wire.from.iter().map(|name| self.link(at, input, name)).collect();
        if links.iter().any(Option::is_none) {
            // The mistake is reported where it is; this node cannot be planned.
            self.broken[at] = true;
        }
        links.into_iter().collect()
    }

    fn link(&mut self, at: usize, input: &PortSpec, name: &Reference) -> Option<Link> {
        // Judged as written: a bypass does not change the type, and the reader sees the name that stands
        // there.
        let written = self.written_output(name, Some((at, input)))?;
        let kind = self.kinds[written.from.0]?;
        let output = kind.output(written.from.1)?;
        if output.data_type != input.data_type {
            let upstream = self.id(written.from.0);
            let message = format!(
                "nodes.{}: input `{}` takes {}, and `{upstream}.{}` is {}",
                self.id(at),
                input.name,
                input.data_type,
                output.name,
                output.data_type
            );
            let problem = Problem::at(&name.origin, message).label(format!("expected {}", input.data_type));
            let right: Vec<String> = kind
                .outputs
                .iter()
                .filter(|o| o.data_type == input.data_type)
                .map(|o| format!("\"{upstream}.{}\"", o.name))
                .collect();
            let elsewhere = self.offers(at, input.data_type);
            self.problems.push(match (right.is_empty(), elsewhere.is_empty()) {
                (false, _) => problem.help(format!("write {}", right.join(" or "))),
                (true, false) => problem.help(format!("write {}", elsewhere.join(" or "))),
                (true, true) => {
                    let problem =
                        problem.note(format!("outputs of {}: {}", kind.decl.kind, list(kind.outputs.iter())));
                    problem.note(format!("no node here has an output of type {}", input.data_type))
                }
            });
            return None;
        }
        self.output(name, None)
    }

    /// An order in which every node comes after those it needs, otherwise as written; nodes on a cycle are
    /// reported and left out.
    fn order(&mut self, inputs: &[Vec<(&PortSpec, Vec<Link>)>]) -> Vec<usize> {
        let count = self.pipeline.nodes.len();
        let needs: Vec<Vec<usize>> = (0..count)
            .map(|at| match self.bypasses[at] {
                // A bypassed node needs what it passes on, so that a ring of bypassed nodes is seen.
                Some((_, upstream)) => self.find(upstream.parts().0).into_iter().collect(),
                None => {
                    inputs[at].iter().flat_map(|(_, links)| links.iter().map(|link| link.from.0)).collect()
                }
            })
            .collect();
        let mut placed = vec![false; count];
        let mut order = Vec::new();
        loop {
            let next = (0..count).find(|&at| !placed[at] && needs[at].iter().all(|&need| placed[need]));
            if let Some(at) = next {
                placed[at] = true;
                order.push(at);
                continue;
            }
            let Some(start) = (0..count).find(|&at| !placed[at]) else { return order };
            // Every node that is left waits for another one that is left: following them must come round.
            let mut path = vec![start];
            let ring = loop {
                let last = path[path.len() - 1];
                let next = needs[last].iter().copied().find(|&need| !placed[need]).unwrap_or(last);
                if let Some(at) = path.iter().position(|&seen| seen == next) {
                    break path[at..].to_vec();
                }
                path.push(next);
            };
            self.report_ring(&ring);
            for at in ring {
                placed[at] = true;
                self.broken[at] = true;
            }
        }
    }

    fn report_ring(&mut self, ring: &[usize]) {
        // In the direction of the data, beginning with the node written first.
        let first = (0..ring.len()).min_by_key(|&i| ring[i]).unwrap_or(0);
        let mut names: Vec<&str> =
            (0..ring.len()).map(|i| self.id(ring[(first + ring.len() - i) % ring.len()])).collect();
        names.push(names[0]);
        let message = match ring.len() {
            1 => format!("node `{}` waits for itself", names[0]),
            _ => format!("these nodes wait for each other: {}", names.join(" -> ")),
        };
        let problem = Problem::at(&self.pipeline.nodes[ring[first]].origin, message);
        self.problems.push(problem.help("feedback is written as a chain: solve, render, solve again"));
    }
}

fn count(number: usize, what: &str) -> String {
    match number {
        0 => format!("no {what}"),
        1 => format!("one {what}"),
        _ => format!("{number} {what}s"),
    }
}
/// Of parameters that are not those of `kind`, names the kinds that read them and stand in for it: those of
/// its family.
fn name_readers(problems: &mut [Problem], kind: &Kind, catalogue: &Catalogue) {
    let family = |name: &str| name.split('/').next().map(str::to_owned);
    for problem in problems.iter_mut().filter(|problem| problem.help.is_none()) {
        let end = format!("` is not a parameter of {}", kind.decl.kind);
        let Some(name) = problem.message.strip_prefix('`').and_then(|rest| rest.strip_suffix(&end)) else {
            continue;
        };
        let reads = |other: &&Kind| {
            other.schema.pointer("/properties").and_then(|properties| properties.get(name)).is_some()
        };
        let of_family =
            catalogue.kinds().iter().filter(|other| family(other.decl.kind) == family(kind.decl.kind));
        let readers: Vec<String> =
            of_family.filter(reads).map(|other| format!("`kind = \"{}\"`", other.decl.kind)).collect();
        if !readers.is_empty() && readers.len() <= MOST_READERS {
            problem.help = Some(format!("take it out, or set {}, which reads it", readers.join(" or ")));
        }
    }
}

/// More kinds than this that read a parameter are no advice.
const MOST_READERS: usize = 2;
