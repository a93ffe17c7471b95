//! Pictures of a pipeline: Graphviz dot, Mermaid, JSON and SVG, all of one small model.
//!
//! The picture shows the pipeline as it runs: overlays applied, bypassed nodes passed over. Boxes are coloured by family
//! (`read`, `solve`, ...), edges carry the names of their ports. The SVG needs no program besides a browser.

mod svg;

use crate::pipeline::Pipeline;
use crate::typed;
use photocurrent_core::{Catalogue, DataType};
use serde_json::json;

/// How to draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GraphFormat {
    /// For Graphviz.
    Dot,
    /// For Markdown renderers that draw Mermaid.
    Mermaid,
    /// A picture that stands alone.
    Svg,
    /// For programs.
    Json,
}

/// One box.
pub(crate) struct Node {
    pub id: String,
    pub kind: &'static str,
    /// Longest way from a node without inputs, in edges.
    pub layer: usize,
}

impl Node {
    fn family(&self) -> &str {
        self.kind.split('/').next().unwrap_or(self.kind)
    }
}

/// One arrow.
pub(crate) struct Edge {
    pub from: usize,
    pub from_port: &'static str,
    pub to: usize,
    pub to_port: &'static str,
    pub data_type: DataType,
}

impl Edge {
    /// The port's name once where both ends call it the same.
    fn label(&self) -> String {
        if self.from_port == self.to_port { self.to_port.to_string() } else { format!("{} to {}", self.from_port, self.to_port) }
    }
}

/// What is drawn.
pub(crate) struct Model {
    pub title: String,
    pub nodes: Vec<Node>,
    pub edges: Vec<Edge>,
}

impl Model {
    fn of(pipeline: &Pipeline, catalogue: &Catalogue) -> Model {
        // Mistakes were reported when the project was loaded; what is not sound is left out of the picture.
        let typed = typed::check(pipeline, catalogue, &mut Vec::new());
        let mut model = Model { title: pipeline.about.clone().unwrap_or_else(|| pipeline.variant.clone()), nodes: Vec::new(), edges: Vec::new() };
        let mut places = vec![None; pipeline.nodes.len()];
        for &at in &typed.order {
            let Some(node) = &typed.nodes[at] else { continue };
            let to = model.nodes.len();
            let mut layer = 0;
            for (port, links) in &node.inputs {
                for link in links {
                    let Some(from) = places[link.from.0] else { continue };
                    let up: &Node = &model.nodes[from];
                    layer = layer.max(up.layer + 1);
                    model.edges.push(Edge { from, from_port: link.from.1, to, to_port: port.name, data_type: port.data_type });
                }
            }
            places[at] = Some(to);
            model.nodes.push(Node { id: node.spec.id.clone(), kind: node.kind.decl.kind, layer });
        }
        model
    }
}

/// Fill colour of a family: light enough for black text. Families that are not listed get a colour from their name.
fn colour(family: &str) -> String {
    let known = [
        ("read", "#d5e8f7"),
        ("simulate", "#dcefd8"),
        ("split", "#eeeeee"),
        ("compensate", "#fdeccb"),
        ("solve", "#fbdcd3"),
        ("render", "#e9dcf3"),
        ("refine", "#f9dcea"),
        ("baseline", "#e6e3cf"),
        ("score", "#d3efec"),
        ("diagnose", "#fbf3c4"),
        ("write", "#dfe3ea"),
    ];
    let listed = known.iter().find(|(name, _)| *name == family).map(|(_, colour)| colour.to_string());
    listed.unwrap_or_else(|| {
        let hue = family.bytes().fold(0u32, |hue, byte| (hue * 31 + u32::from(byte)) % 360);
        format!("hsl({hue},45%,90%)")
    })
}

/// Draws one variant's pipeline.
pub fn graph(pipeline: &Pipeline, catalogue: &Catalogue, format: GraphFormat) -> String {
    let model = Model::of(pipeline, catalogue);
    match format {
        GraphFormat::Dot => dot(&model),
        GraphFormat::Mermaid => mermaid(&model),
        GraphFormat::Svg => svg::draw(&model),
        GraphFormat::Json => json_text(&model),
    }
}

fn dot(model: &Model) -> String {
    let quote = |text: &str| format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', " "));
    let mut text = format!("digraph pipeline {{\n  label={};\n  rankdir=LR;\n  node [shape=box, style=\"rounded,filled\"];\n", quote(&model.title));
    for node in &model.nodes {
        // `\n` is Graphviz's own line break, so it goes in after quoting.
        text += &format!("  {} [label=\"{}\\n{}\", fillcolor=\"{}\"];\n", quote(&node.id), node.id, node.kind, dot_colour(node.family()));
    }
    for edge in &model.edges {
        text += &format!("  {} -> {} [label={}];\n", quote(&model.nodes[edge.from].id), quote(&model.nodes[edge.to].id), quote(&edge.label()));
    }
    text + "}\n"
}

/// Graphviz knows no `hsl()`.
fn dot_colour(family: &str) -> String {
    Some(colour(family)).filter(|colour| colour.starts_with('#')).unwrap_or_else(|| "#f2f2f2".into())
}

fn mermaid(model: &Model) -> String {
    let mut text = String::from("flowchart LR\n");
    for node in &model.nodes {
        // A prefix, because `end` and other words are Mermaid's own.
        text += &format!("  n_{}[\"{}<br/>{}\"]\n", node.id, node.id, node.kind);
        text += &format!("  style n_{} fill:{},color:#000\n", node.id, dot_colour(node.family()));
    }
    for edge in &model.edges {
        text += &format!("  n_{} -->|{}| n_{}\n", model.nodes[edge.from].id, edge.label(), model.nodes[edge.to].id);
    }
    text
}

fn json_text(model: &Model) -> String {
    let nodes: Vec<_> = model.nodes.iter().map(|node| json!({ "id": node.id, "kind": node.kind, "family": node.family(), "layer": node.layer })).collect();
    let edge = |edge: &Edge| {
        json!({
            "from": model.nodes[edge.from].id, "from_port": edge.from_port,
            "to": model.nodes[edge.to].id, "to_port": edge.to_port, "type": edge.data_type.name(),
        })
    };
    let edges: Vec<_> = model.edges.iter().map(edge).collect();
    format!("{:#}\n", json!({ "about": model.title, "nodes": nodes, "edges": edges }))
}
