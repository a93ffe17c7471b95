//! Pictures and the schema: they parse, and everything is in them.

use super::folder::Folder;
use super::toys::catalogue;
use crate::{GraphFormat, Project, graph, manifest_schema};
use serde_json::Value as Json;

const TEXT: &str = r#"
format = 1
pipeline.about = "Light & <shade> \"quoted\""
[nodes.source]
kind = "read/source"
[nodes.halves]
kind = "split/halves"
in.plane = "source"
[nodes.smooth]
kind = "refine/smooth"
in.plane = "halves.low"
[nodes.sum]
kind = "score/sum"
in.planes = ["smooth", "halves.high", "source"]
"#;

fn draw(format: GraphFormat) -> String {
    let folder = Folder::new();
    let project = Project::load(&folder.write("m.toml", TEXT), &[], &catalogue()).unwrap();
    graph(&project.pipelines[0], &catalogue(), format)
}

#[test]
fn json_has_every_node_and_edge() {
    let json: Json = serde_json::from_str(&draw(GraphFormat::Json)).unwrap();
    let ids: Vec<&str> =
        json["nodes"].as_array().unwrap().iter().map(|node| node["id"].as_str().unwrap()).collect();
    assert_eq!(ids, ["source", "halves", "smooth", "sum"]);
    assert_eq!(json["edges"].as_array().unwrap().len(), 5);
    assert_eq!(
        json["edges"][1],
        serde_json::json!({
            "from": "halves", "from_port": "low", "to": "smooth", "to_port": "plane", "type": "map",
        })
    );
    assert_eq!(json["nodes"][3]["layer"], 3);
}

#[test]
fn dot_and_mermaid_name_ports() {
    let dot = draw(GraphFormat::Dot);
    assert!(
        dot.contains("label=\"Light & <shade> \\\"quoted\\\"\"")
            && dot.contains("\"halves\" -> \"smooth\" [label=\"low to plane\"];"),
        "{dot}"
    );
    let mermaid = draw(GraphFormat::Mermaid);
    assert!(
        mermaid.starts_with("flowchart LR\n") && mermaid.contains("n_halves -->|low to plane| n_smooth"),
        "{mermaid}"
    );
}

#[test]
fn svg_is_balanced_and_its_text_is_escaped() {
    let svg = draw(GraphFormat::Svg);
    assert!(svg.contains("Light &amp; &lt;shade&gt; &quot;quoted&quot;") && !svg.contains("<shade>"));
    for id in ["source", "halves", "smooth", "sum"] {
        assert!(svg.contains(&format!(">{id}</text>")), "{id}");
    }
    for tag in ["svg", "text", "g", "defs", "marker", "title"] {
        let opened = svg.matches(&format!("<{tag} ")).count() + svg.matches(&format!("<{tag}>")).count();
        assert_eq!(opened, svg.matches(&format!("</{tag}>")).count(), "{tag}");
    }
    assert_eq!(svg.matches("marker-end").count(), 5, "one arrow per pair of nodes");
    assert!(!svg.contains("NaN"));
}

#[test]
fn wires_between_the_same_boxes_are_one_arrow_with_all_names() {
    let folder = Folder::new();
    let text = TEXT.replace("\"smooth\", \"halves.high\", \"source\"", "\"halves.low\", \"halves.high\"");
    let project = Project::load(&folder.write("m.toml", &text), &[], &catalogue()).unwrap();
    let svg = graph(&project.pipelines[0], &catalogue(), GraphFormat::Svg);
    let mut paths: Vec<&str> = svg.lines().filter(|line| line.contains("marker-end")).collect();
    assert_eq!(paths.len(), 3, "source to halves, halves to smooth, halves to sum");
    assert!(svg.contains(">low to planes, high to planes</text>"), "{svg}");
    paths.sort();
    paths.dedup_by_key(|line| line.split(" d=\"").nth(1).unwrap().split('"').next().unwrap());
    assert_eq!(paths.len(), 3, "no two run the same way");
}

#[test]
fn the_schema_has_every_kind_and_no_reference_into_nowhere() {
    let schema = manifest_schema(&catalogue());
    let kinds = schema["properties"]["nodes"]["additionalProperties"]["oneOf"].as_array().unwrap();
    assert_eq!(kinds.len(), catalogue().kinds().len() + 1);
    let add = kinds.iter().find(|kind| kind["title"] == "solve/add").unwrap();
    assert_eq!(add["properties"]["params"]["properties"]["amount"]["maximum"], 100.0);
    assert!(add["properties"]["params"]["properties"]["direction"].to_string().contains("\"down\""));
    fn references(json: &Json, found: &mut Vec<String>) {
        match json {
            Json::Object(map) => map.iter().for_each(|(name, value)| match value.as_str() {
                Some(text) if name == "$ref" => found.push(text.into()),
                _ => references(value, found),
            }),
            Json::Array(items) => items.iter().for_each(|item| references(item, found)),
            _ => {}
        }
    }
    let mut found = Vec::new();
    references(&schema, &mut found);
    assert!(
        !found.is_empty() && found.iter().all(|reference| schema.pointer(&reference[1..]).is_some()),
        "{found:?}"
    );
}
