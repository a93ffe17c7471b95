//! The manifest's JSON Schema, for completion and checks in an editor.
//!
//! Every kind of the catalogue becomes one alternative of a node, its parameters' schema inside. Those
//! schemas come with definitions of their own; two kinds may define different things under one name, so
//! references are replaced by what they refer to.

use photocurrent_core::ports::{Arity, PortSpec};
use photocurrent_core::{Catalogue, Kind};
use serde_json::{Map, Value as Json, json};

/// References inside references beyond this depth mean a schema that contains itself.
const DEEPEST: usize = 32;

/// The schema of a whole manifest.
pub fn manifest_schema(catalogue: &Catalogue) -> Json {
    let kinds: Vec<Json> = catalogue.kinds().iter().map(node).collect();
    // A manifest that extends another one may lay over a node without naming its kind again.
    let overlay = json!({
        "type": "object", "additionalProperties": false,
        "properties": {
            "in": { "type": "object" }, "params": { "type": "object" }, "bypass": { "type": "boolean" },
            "optional": { "type": "boolean" }, "expect": { "type": "object" },
        },
    });
    json!({
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "photocurrent manifest",
        "type": "object",
        "additionalProperties": false,
        "required": ["format"],
        "properties": {
            "format": { "const": crate::manifest::FORMAT, "description": "Version of the manifest's form." },
            "extends": {
                "type": "string", "description": "Path of the manifest that this one is laid over.",
            },
            "pipeline": { "$ref": "#/$defs/pipeline" },
            "nodes": {
                "type": "object",
                "propertyNames": { "pattern": "^[a-z][a-z0-9_]*$" },
                "additionalProperties": { "oneOf": kinds.into_iter().chain([overlay]).collect::<Vec<_>>() },
            },
            "ablation": ablation(),
        },
        "$defs": {
            "pipeline": {
                "type": "object",
                "additionalProperties": false,
                "properties": {
                    "about": { "type": "string", "description": "What the pipeline is for." },
                    "seed": { "type": "integer", "minimum": 0, "description": "For nodes that draw random \
                                                            numbers." },
                    "keep": {
                        "type": "array", "items": { "type": "string" },
                        "description": "Outputs to store though nothing takes them: node.port.",
                    },
                    "blocks": crate::blocks::Blocks::schema(),
                },
            },
        },
    })
}

/// The schema of an ablation.
fn ablation() -> Json {
    let layer = json!({
        "type": "object", "additionalProperties": false,
        "properties": { "nodes": { "type": "object" }, "pipeline": { "$ref": "#/$defs/pipeline" } },
    });
    let spaced = |by: &str| {
        let ends = json!({ "type": "array", "items": { "type": "number" }, "minItems": 2, "maxItems": 2 });
        json!({
            "type": "object", "additionalProperties": false,
            "required": [by, "steps"],
            "properties": { by: ends, "steps": { "type": "integer", "minimum": 2 } },
        })
    };
    json!({
        "type": "object",
        "additionalProperties": false,
        "properties": {
            "about": { "type": "string", "description": "What the ablation is for." },
            "metrics": {
                "type": "array", "items": { "type": "string" },
                "description": "Numbers to compare: node.metric.",
            },
            "baseline": {
                "type": "object", "description": "The variant to compare with: a level for every axis.",
            },
            "skip": {
                "type": "array", "items": { "type": "object" },
                "description": "Combinations to leave out.",
            },
            "axes": {
                "type": "object",
                "description": "Named axes, each with named levels: tables that are laid over the manifest.",
                "additionalProperties": { "type": "object", "additionalProperties": layer },
            },
            "sweep": {
                "type": "object", "description": "Paths of parameters, in quotes, with their values.",
                "additionalProperties": {
                    "oneOf": [{ "type": "array", "minItems": 1 }, spaced("log"), spaced("linear")],
                },
            },
        },
    })
}

/// The schema of a node's bounds. Names of scores may depend on parameters, so others than those of the
/// defaults are allowed.
fn expect(metrics: &[String]) -> Json {
    let known: Map<String, Json> =
        metrics.iter().map(|metric| (metric.clone(), crate::expect::schema())).collect();
    json!({
        "type": "object", "description": "Bounds on its scores.",
        "properties": known, "additionalProperties": crate::expect::schema(),
    })
}

fn node(kind: &Kind) -> Json {
    let port = |port: &PortSpec| {
        let name = json!({ "type": "string", "pattern": "^[a-z][a-z0-9_]*(\\.[a-z][a-z0-9_]*)?$" });
        let form = if port.arity == Arity::Many {
            json!({ "oneOf": [name, { "type": "array", "items": name }] })
        } else {
            name
        };
        let mut form = form;
        form["description"] = json!(format!("{} ({})", port.about, port.data_type));
        (port.name.to_string(), form)
    };
    let ports: Map<String, Json> = kind.inputs.iter().map(port).collect();
    let mut params = inline(&kind.schema, &kind.schema, 0);
    if let Some(params) = params.as_object_mut() {
        params.remove("$schema");
        params.remove("$defs");
        // Parameters may come from the manifest below: what is required is checked when all layers are in
        // place.
        params.remove("required");
    }
    json!({
        "type": "object",
        "title": kind.decl.kind,
        "description": kind.decl.about,
        "additionalProperties": false,
        "required": ["kind"],
        "properties": {
            "kind": { "const": kind.decl.kind, "description": kind.decl.about },
            "in": { "type": "object", "additionalProperties": false, "properties": ports },
            "params": params,
            "bypass": { "type": "boolean", "description": "Leave the node out and pass its input on." },
            "optional": { "type": "boolean", "description": "Leave the node out, with all that take \
                something from it, while its files are \
                missing." },
            "expect": expect(&kind.metrics),
        },
    })
}

/// Replaces every reference inside `schema` by what it refers to in `root`.
fn inline(schema: &Json, root: &Json, depth: usize) -> Json {
    match schema {
        Json::Object(map) => {
            let target = map
                .get("$ref")
                .and_then(Json::as_str)
                .and_then(|reference| root.pointer(reference.strip_prefix('#')?));
            let mut result = match target {
                Some(target) if depth < DEEPEST => {
                    inline(target, root, depth + 1).as_object().cloned().unwrap_or_default()
                }
                _ => Map::new(),
            };
            // What stands next to a reference (a description, a bound) is about this use of it, and wins.
            for (name, value) in map.iter().filter(|(name, _)| *name != "$ref") {
                result.insert(name.clone(), inline(value, root, depth));
            }
            Json::Object(result)
        }
        Json::Array(items) => Json::Array(items.iter().map(|item| inline(item, root, depth)).collect()),
        other => other.clone(),
    }
}
