//! Pictures of a pipeline: Graphviz dot, Mermaid, JSON and SVG, all of one small model.
//!
//! The picture shows the pipeline as it runs: overlays applied, bypassed nodes passed over. Boxes are
//! coloured by family (`read`, `solve`, ...), edges carry the names of their ports. The SVG needs no program
//! besides a browser. A [`Drawing`] can also be made of what a run says of itself, with times and states in
//! its boxes.

mod layout;
mod svg;

use crate::pipeline::Pipeline;
use crate::typed;
use photocurrent_core::Catalogue;
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
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Node {
    /// The node's name.
    pub id: String,
    /// `family/name`.
    pub kind: String,
    /// A third line, such as how long it ran; empty for none.
    pub note: String,
    /// A word for styles, such as `failed`; empty for none.
    pub state: String,
}

impl Node {
    fn family(&self) -> &str {
        self.kind.split('/').next().unwrap_or(&self.kind)
    }
}

/// One wire.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Edge {
    /// Place of the node that it comes from; smaller than `to`.
    pub from: usize,
    /// The port that it comes from.
    pub from_port: String,
    /// Place of the node that it goes to.
    pub to: usize,
    /// The port that it goes to.
    pub to_port: String,
    /// Name of the type of data.
    pub data_type: String,
}

impl Edge {
    /// The port's name once where both ends call it the same.
    fn label(&self) -> String {
        if self.from_port == self.to_port {
            self.to_port.clone()
        } else {
            format!("{} to {}", self.from_port, self.to_port)
        }
    }
}

/// What is drawn.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Drawing {
    /// Text above.
    pub title: String,
    /// The boxes, each after those that it takes something from.
    pub nodes: Vec<Node>,
    /// The wires.
    pub edges: Vec<Edge>,
}

impl Drawing {
    fn of(pipeline: &Pipeline, catalogue: &Catalogue) -> Drawing {
        // Mistakes were reported when the project was loaded; what is not sound is left out of the picture.
        let typed = typed::check(pipeline, catalogue, &mut Vec::new());
        let title = pipeline.about.clone().unwrap_or_else(|| pipeline.variant.clone());
        let mut drawing = Drawing { title, ..Drawing::default() };
        let mut places = vec![None; pipeline.nodes.len()];
        for &at in &typed.order {
            let Some(node) = &typed.nodes[at] else { continue };
            let to = drawing.nodes.len();
            for (port, links) in &node.inputs {
                for link in links {
                    let Some(from) = places[link.from.0] else { continue };
                    let (from_port, to_port) = (link.from.1.to_string(), port.name.to_string());
                    drawing.edges.push(Edge {
                        from,
                        from_port,
                        to,
                        to_port,
                        data_type: port.data_type.name().into(),
                    });
                }
            }
            places[at] = Some(to);
            drawing.nodes.push(Node {
                id: node.spec.id.clone(),
                kind: node.kind.decl.kind.into(),
                ..Node::default()
            });
        }
        drawing
    }

    /// For each node the longest way to it from one without inputs, in edges that `counts` says yes to.
    fn layers(&self, counts: impl Fn(&Edge) -> bool) -> Vec<usize> {
        let mut layers = vec![0; self.nodes.len()];
        for to in 0..self.nodes.len() {
            let before = self
                .edges
                .iter()
                .filter(|edge| edge.to == to && counts(edge))
                .map(|edge| layers[edge.from] + 1);
            layers[to] = before.max().unwrap_or(0);
        }
        layers
    }

    /// A picture that stands alone, or inside a page whose styles name its classes.
    pub fn svg(&self) -> String {
        svg::draw(self)
    }
}

/// Fill colour of a family: light enough for black text. Families that are not listed get a colour from their
/// name.
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
        ("estimate", "#e3e9d2"),
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
    let drawing = Drawing::of(pipeline, catalogue);
    match format {
        GraphFormat::Dot => dot(&drawing),
        GraphFormat::Mermaid => mermaid(&drawing),
        GraphFormat::Svg => drawing.svg(),
        GraphFormat::Json => json_text(&drawing),
    }
}

fn dot(drawing: &Drawing) -> String {
    let quote =
        |text: &str| format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', " "));
    let mut text = format!(
        "digraph pipeline {{\n  label={};\n  rankdir=LR;\n  node [shape=box, style=\"rounded,filled\"];\n",
        quote(&drawing.title)
    );
    for node in &drawing.nodes {
        // `\n` is Graphviz's own line break, so it goes in after quoting.
        text += &format!(
            "  {} [label=\"{}\\n{}\", fillcolor=\"{}\"];\n",
            quote(&node.id),
            node.id,
            node.kind,
            dot_colour(node.family())
        );
    }
    for edge in &drawing.edges {
        text += &format!(
            "  {} -> {} [label={}];\n",
            quote(&drawing.nodes[edge.from].id),
            quote(&drawing.nodes[edge.to].id),
            quote(&edge.label())
        );
    }
    text + "}\n"
}

/// Graphviz knows no `hsl()`.
fn dot_colour(family: &str) -> String {
    Some(colour(family)).filter(|colour| colour.starts_with('#')).unwrap_or_else(|| "#f2f2f2".into())
}

fn mermaid(drawing: &Drawing) -> String {
    let mut text = String::from("flowchart LR\n");
    for node in &drawing.nodes {
        // A prefix, because `end` and other words are Mermaid's own.
        text += &format!("  n_{}[\"{}<br/>{}\"]\n", node.id, node.id, node.kind);
        text += &format!("  style n_{} fill:{},color:#000\n", node.id, dot_colour(node.family()));
    }
    for edge in &drawing.edges {
        text += &format!(
            "  n_{} -->|{}| n_{}\n",
            drawing.nodes[edge.from].id,
            edge.label(),
            drawing.nodes[edge.to].id
        );
    }
    text
}

fn json_text(drawing: &Drawing) -> String {
    let layers = drawing.layers(|_| true);
    let nodes = drawing.nodes.iter().zip(&layers);
    let nodes: Vec<_> = nodes
        .map(|(node, layer)| {
            json!({ "id": node.id, "kind": node.kind,
    "family": node.family(), "layer": layer })
        })
        .collect();
    let edge = |edge: &Edge| {
        json!({
            "from": drawing.nodes[edge.from].id, "from_port": edge.from_port,
            "to": drawing.nodes[edge.to].id, "to_port": edge.to_port, "type": edge.data_type,
        })
    };
    let edges: Vec<_> = drawing.edges.iter().map(edge).collect();
    format!("{:#}\n", json!({ "about": drawing.title, "nodes": nodes, "edges": edges }))
}
