//! Checks a [`Tree`] against the JSON Schema that a `Params` struct generates, reporting every mistake at its
//! place.
//!
//! The struct stays the only statement of what is allowed: its doc comments, ranges and units become the
//! schema (through `schemars`), the schema becomes checks here, the manual, and completion in an editor.
//! Beyond JSON Schema there are five keys of ours: `x-quantity` (a text with a unit, see
//! [`crate::quantity`]), `x-min` and `x-max` (bounds of a quantity, with unit), `x-path` (a path, relative to
//! the file that wrote it), and `x-example` (what to write instead of a value of the wrong form).

use crate::document::{Item, Problem, Tree, nearest};
use crate::quantity::Dimension;
use serde_json::Value as Json;

/// Checks `tree` against a whole schema and appends every problem found.
/// `what` names the thing in messages: "parameter of solve/map".
pub fn validate(tree: &Tree, schema: &Json, what: &str, problems: &mut Vec<Problem>) {
    Checker { root: schema, what }.check(tree, schema, "", problems);
}

struct Checker<'a> {
    root: &'a Json,
    what: &'a str,
}

/// Follows `$ref` and a nullable `anyOf` to the schema that counts; keys next to `$ref` (such as `x-min`) are
/// looked up by the caller first.
pub fn resolve<'a>(root: &'a Json, mut schema: &'a Json) -> &'a Json {
    loop {
        if let Some(target) = schema["$ref"]
            .as_str()
            .and_then(|r| r.strip_prefix('#'))
            .and_then(|pointer| root.pointer(pointer))
        {
            schema = target;
        } else if let Some([one]) = alternatives(schema).as_deref() {
            schema = one;
        } else {
            return schema;
        }
    }
}

/// The non-null alternatives of `anyOf` or `oneOf`, when there are any.
pub fn alternatives(schema: &Json) -> Option<Vec<&Json>> {
    let list = schema["anyOf"].as_array().or_else(|| schema["oneOf"].as_array())?;
    Some(list.iter().filter(|s| s["type"] != "null").collect())
}

/// The texts that a schema of fixed words allows.
fn words<'a>(root: &'a Json, schema: &'a Json) -> Option<Vec<&'a str>> {
    if let Some(list) = schema["enum"].as_array() {
        return list.iter().filter(|word| !word.is_null()).map(Json::as_str).collect();
    }
    if let Some(word) = schema["const"].as_str() {
        return Some(vec![word]);
    }
    let words: Option<Vec<Vec<&str>>> =
        alternatives(schema)?.into_iter().map(|s| words(root, resolve(root, s))).collect();
    Some(words?.concat())
}

fn allows(schema: &Json, name: &str) -> bool {
    schema["type"] == name || schema["type"].as_array().is_some_and(|types| types.iter().any(|t| t == name))
}

/// "from 1 to 8", "at least 0", "greater than 0 and at most 100": the whole range, from bounds as they are
/// written.
fn range(
    least: Option<String>,
    above: Option<String>,
    most: Option<String>,
    below: Option<String>,
) -> String {
    if let (Some(least), None, Some(most), None) = (&least, &above, &most, &below) {
        return format!("from {least} to {most}");
    }
    let named = [("at least", least), ("greater than", above), ("at most", most), ("less than", below)];
    named
        .into_iter()
        .filter_map(|(words, bound)| Some(format!("{words} {}", bound?)))
        .collect::<Vec<_>>()
        .join(" and ")
}

impl Checker<'_> {
    /// `path` leads from the whole to this value: `crop.width`, `times[1]`; empty for the whole.
    fn check(&self, tree: &Tree, outer: &Json, path: &str, problems: &mut Vec<Problem>) {
        let schema = resolve(self.root, outer);
        if let Some(words) = words(self.root, schema) {
            return self.check_word(tree, &words, problems);
        }
        if let Some(alternatives) = alternatives(schema) {
            return self.check_alternatives(tree, &alternatives, path, problems);
        }
        if let Some(dimension) = schema["x-quantity"].as_str().and_then(Dimension::named) {
            return self.check_quantity(tree, dimension, (outer, schema), path, problems);
        }
        let expected = if allows(schema, "object") {
            "a table"
        } else if allows(schema, "array") {
            "a list"
        } else if allows(schema, "boolean") {
            "`true` or `false`"
        } else if allows(schema, "integer") {
            "an integer"
        } else if allows(schema, "number") {
            "a number"
        } else if allows(schema, "string") {
            "a text in quotes"
        } else {
            return;
        };
        match (&tree.item, expected) {
            (Item::Table(_), "a table") => self.check_table(tree, schema, path, problems),
            (Item::Array(items), "a list") => {
                let (least, most, found) =
                    (schema["minItems"].as_u64(), schema["maxItems"].as_u64(), items.len() as u64);
                let bound = match (least, most) {
                    (Some(least), Some(most)) if least == most && found != least => Some(format!("{least}")),
                    (Some(least), _) if found < least => Some(format!("at least {least}")),
                    (_, Some(most)) if found > most => Some(format!("at most {most}")),
                    _ => None,
                };
                if let Some(bound) = bound {
                    problems.push(Problem::at(
                        &tree.origin,
                        format!("a list of {bound} is needed, found {found}"),
                    ));
                }
                for (i, item) in items.iter().enumerate() {
                    self.check(item, &schema["items"], &format!("{path}[{i}]"), problems);
                }
            }
            (Item::Boolean(_), "`true` or `false`") | (Item::String(_), "a text in quotes") => {}
            (Item::Integer(number), "an integer" | "a number") => {
                self.check_range(tree, *number as f64, (outer, schema), path, problems)
            }
            (Item::Float(number), "a number") if number.is_finite() => {
                self.check_range(tree, *number, (outer, schema), path, problems)
            }
            (Item::Float(_), "a number") => problems.push(
                Problem::at(&tree.origin, format!("expected a finite number, found {}", tree.describe()))
                    .label("not finite"),
            ),
            _ => {
                let problem =
                    Problem::at(&tree.origin, format!("expected {expected}, found {}", tree.describe()))
                        .label(format!("expected {expected}"));
                problems.push(match (schema["x-example"].as_str(), tree.as_str()) {
                    (Some(example), _) => problem.help(format!("such as {example}")),
                    (None, Some(text)) if expected == "a list" => {
                        problem.help(format!("a list of one is [\"{text}\"]"))
                    }
                    _ => problem,
                });
            }
        }
    }

    fn check_word(&self, tree: &Tree, words: &[&str], problems: &mut Vec<Problem>) {
        let list = words.iter().map(|word| format!("\"{word}\"")).collect::<Vec<_>>().join(", ");
        match tree.as_str() {
            Some(text) if words.contains(&text) => {}
            Some(text) => {
                let problem = Problem::at(&tree.origin, format!("\"{text}\" is not one of {list}"))
                    .label("unknown value");
                problems.push(match crate::document::nearest(text, words.iter().copied()) {
                    Some(word) => problem.help(format!("did you mean \"{word}\"?")),
                    None => problem,
                });
            }
            None => problems.push(
                Problem::at(&tree.origin, format!("expected one of {list}, found {}", tree.describe()))
                    .label("expected a text in quotes"),
            ),
        }
    }

    /// Accepts what any alternative accepts; otherwise reports the complaints of the alternative that
    /// complains deepest inside.
    fn check_alternatives(
        &self,
        tree: &Tree,
        alternatives: &[&Json],
        path: &str,
        problems: &mut Vec<Problem>,
    ) {
        let mut best: Option<Vec<Problem>> = None;
        for schema in alternatives {
            let mut found = Vec::new();
            self.check(tree, schema, path, &mut found);
            if found.is_empty() {
                return;
            }
            let depth =
                |list: &[Problem]| list.iter().filter(|p| p.at.as_ref() != Some(&tree.origin)).count();
            if best.as_ref().is_none_or(|best| depth(&found) > depth(best)) {
                best = Some(found);
            }
        }
        problems.extend(best.unwrap_or_default());
    }

    fn check_quantity(
        &self,
        tree: &Tree,
        dimension: Dimension,
        (outer, schema): (&Json, &Json),
        path: &str,
        problems: &mut Vec<Problem>,
    ) {
        let Some(text) = tree.as_str() else {
            let problem = Problem::at(
                &tree.origin,
                format!("expected a {} with its unit, found {}", dimension.name(), tree.describe()),
            );
            let help = match tree.item {
                Item::Integer(_) | Item::Float(_) => {
                    format!(
                        "write it as text with a unit, such as \"{}\" (units: {})",
                        dimension.example(),
                        dimension.unit_list()
                    )
                }
                _ => format!("such as \"{}\"", dimension.example()),
            };
            problems.push(problem.label("a unit is needed").help(help));
            return;
        };
        let value = match dimension.read(text) {
            Ok(value) => value,
            Err(error) => {
                problems.push(
                    Problem::at(&tree.origin, error.what)
                        .label(format!("expected a {}", dimension.name()))
                        .help(format!(
                            "such as \"{}\" (units: {})",
                            dimension.example(),
                            dimension.unit_list()
                        )),
                );
                return;
            }
        };
        let bound = |key: &str| outer[key].as_str().or_else(|| schema[key].as_str());
        let number = |text: &str| dimension.read(text).unwrap_or(f64::NAN);
        let (least, most) = (bound("x-min"), bound("x-max"));
        let too_small = least.is_some_and(|least| value < number(least));
        if too_small || most.is_some_and(|most| value > number(most)) {
            let range = range(least.map(String::from), None, most.map(String::from), None);
            problems.push(self.outside(tree, path, &range, text.trim(), too_small));
        }
    }

    fn check_range(
        &self,
        tree: &Tree,
        value: f64,
        (outer, schema): (&Json, &Json),
        path: &str,
        problems: &mut Vec<Problem>,
    ) {
        let bound = |key: &str| outer[key].as_f64().or_else(|| schema[key].as_f64());
        let (least, above, most, below) =
            (bound("minimum"), bound("exclusiveMinimum"), bound("maximum"), bound("exclusiveMaximum"));
        let too_small = least.is_some_and(|least| value < least) || above.is_some_and(|above| value <= above);
        if too_small || most.is_some_and(|most| value > most) || below.is_some_and(|below| value >= below) {
            let shown = |bound: Option<f64>| bound.map(|bound| bound.to_string());
            problems.push(self.outside(
                tree,
                path,
                &range(shown(least), shown(above), shown(most), shown(below)),
                &value.to_string(),
                too_small,
            ));
        }
    }

    fn outside(&self, tree: &Tree, path: &str, range: &str, found: &str, too_small: bool) -> Problem {
        Problem::at(&tree.origin, format!("`{path}` must be {range}, found {found}")).label(if too_small {
            "too small"
        } else {
            "too large"
        })
    }

    fn check_table(&self, tree: &Tree, schema: &Json, path: &str, problems: &mut Vec<Problem>) {
        let Some(table) = tree.as_table() else { return };
        let properties = schema["properties"].as_object();
        let known: Vec<&str> = properties.map(|p| p.keys().map(String::as_str).collect()).unwrap_or_default();
        // What a slip of the hand stands for is not reported as missing a second time.
        let mut suggested: Vec<&str> = Vec::new();
        for (key, value) in &table.entries {
            let inner = if path.is_empty() { key.name.clone() } else { format!("{path}.{}", key.name) };
            if let Some(property) = properties.and_then(|p| p.get(&key.name)) {
                self.check(value, property, &inner, problems);
            } else if schema["additionalProperties"].is_object() {
                self.check(value, &schema["additionalProperties"], &inner, problems);
            } else if schema["additionalProperties"] == Json::Bool(false) {
                let what = if path.is_empty() { self.what.to_string() } else { format!("key of `{path}`") };
                let problem =
                    Problem::at(&key.origin, format!("`{}` is not a {what}", key.name)).label("unknown key");
                problems.push(problem.did_you_mean(&key.name, known.iter().copied()));
                suggested.extend(nearest(&key.name, known.iter().copied()));
            }
        }
        for name in schema["required"].as_array().into_iter().flatten().filter_map(Json::as_str) {
            if table.get(name).is_none() && !suggested.contains(&name) {
                problems.push(
                    Problem::at(&tree.origin, format!("`{name}` is missing"))
                        .label(format!("needs `{name}`")),
                );
            }
        }
    }
}

/// Turns a checked tree into JSON; paths are joined to the folder of the file that wrote them.
pub fn to_json(tree: &Tree, schema: &Json) -> Json {
    convert(tree, schema, schema)
}

fn convert(tree: &Tree, schema: &Json, root: &Json) -> Json {
    let schema = resolve(root, schema);
    match &tree.item {
        Item::String(text) if schema["x-path"] == Json::Bool(true) => {
            Json::String(tree.origin.source.folder.join(text).to_string_lossy().into_owned())
        }
        Item::String(text) | Item::Datetime(text) => Json::String(text.clone()),
        Item::Integer(number) => Json::from(*number),
        Item::Float(number) => Json::from(*number),
        Item::Boolean(value) => Json::Bool(*value),
        Item::Array(items) => {
            Json::Array(items.iter().map(|item| convert(item, &schema["items"], root)).collect())
        }
        Item::Table(table) => {
            let property = |name: &str| {
                if schema["properties"][name].is_null() {
                    &schema["additionalProperties"]
                } else {
                    &schema["properties"][name]
                }
            };
            Json::Object(
                table
                    .entries
                    .iter()
                    .map(|(key, value)| (key.name.clone(), convert(value, property(&key.name), root)))
                    .collect(),
            )
        }
    }
}

/// Removes every value that the schema calls a path.
pub fn strip_paths(value: &mut Json, schema: &Json) {
    strip(value, schema, schema);
}

fn strip(value: &mut Json, schema: &Json, root: &Json) {
    let schema = resolve(root, schema);
    match value {
        Json::Object(map) => {
            map.retain(|name, _| {
                resolve(root, &schema["properties"][name.as_str()])["x-path"] != Json::Bool(true)
            });
            map.iter_mut().for_each(|(name, value)| strip(value, &schema["properties"][name.as_str()], root));
        }
        Json::Array(items) => {
            if resolve(root, &schema["items"])["x-path"] == Json::Bool(true) {
                items.clear();
            }
            items.iter_mut().for_each(|item| strip(item, &schema["items"], root));
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::{Source, parse};
    use crate::quantity::{Duration, InputPath, Rate};
    use schemars::JsonSchema;
    use serde::{Deserialize, Serialize};

    /// Parameters of every form.
    #[derive(Default, Serialize, Deserialize, JsonSchema)]
    #[serde(default, deny_unknown_fields)]
    struct Params {
        /// A rate.
        rate: Rate,
        /// A time within bounds.
        #[schemars(extend("x-min" = "0 ns", "x-max" = "1 s"))]
        exposure: Option<Duration>,
        /// A weight.
        #[schemars(range(min = 0.0, max = 10.0))]
        weight: f64,
        /// Words.
        shutter: Shutter,
        /// Where.
        path: Option<InputPath>,
        /// Several.
        labels: Vec<String>,
    }

    #[derive(Default, Serialize, Deserialize, JsonSchema)]
    #[serde(rename_all = "snake_case")]
    enum Shutter {
        /// All at once.
        #[default]
        Global,
        /// Row by row.
        Rolling,
    }

    fn check(text: &str) -> (Vec<String>, Json) {
        let schema = schemars::schema_for!(Params).to_value();
        let source = Source::new("m.toml", "some/folder", text);
        let table = parse(&source).unwrap();
        let tree = Tree { item: Item::Table(table), origin: crate::document::Origin { source, span: 0..0 } };
        let mut problems = Vec::new();
        validate(&tree, &schema, "parameter of test/node", &mut problems);
        let shown = problems
            .iter()
            .map(|p| {
                format!(
                    "{}: {}{}",
                    p.at.as_ref().unwrap(),
                    p.message,
                    p.help.as_ref().map(|h| format!(" | {h}")).unwrap_or_default()
                )
            })
            .collect();
        (shown, to_json(&tree, &schema))
    }

    #[test]
    fn what_is_right_passes_and_becomes_the_struct() {
        let (problems, json) = check(
            "rate = \"1 kHz\"\nexposure = \"1 ms\"\nweight = 2\nshutter = \
                                      \"rolling\"\npath = \"a.h5\"\nlabels = [\"x\"]\n",
        );
        assert_eq!(problems, [""; 0]);
        let params: Params = serde_json::from_value(json).unwrap();
        assert_eq!(params.rate.hz(), 1000.0);
        assert_eq!(params.path.unwrap().path(), std::path::Path::new("some/folder/a.h5"));
    }

    #[test]
    fn every_mistake_is_reported_at_its_place() {
        let (problems, _) = check(
            "rate = 5\nexposure = \"2 s\"\nweight = -1.0\nshutter = \"roling\"\nlabels = [3]\nwieght = 1\n",
        );
        assert_eq!(
            problems,
            [
                "m.toml:1:8: expected a rate with its unit, found the integer 5 | write it as text with a \
                 unit, such as \"10 kHz\" (units: Hz, fps, kHz, MHz)",
                "m.toml:2:12: `exposure` must be from 0 ns to 1 s, found 2 s",
                "m.toml:3:10: `weight` must be from 0 to 10, found -1",
                "m.toml:4:11: \"roling\" is not one of \"global\", \"rolling\" | did you mean \"rolling\"?",
                "m.toml:5:11: expected a text in quotes, found the integer 3",
                "m.toml:6:1: `wieght` is not a parameter of test/node | did you mean `weight`?",
            ]
        );
    }

    #[test]
    fn a_range_is_named_whole() {
        let shown = |bounds: [Option<&str>; 4]| {
            let [least, above, most, below] = bounds.map(|bound| bound.map(String::from));
            range(least, above, most, below)
        };
        assert_eq!(shown([Some("1"), None, Some("8"), None]), "from 1 to 8");
        assert_eq!(shown([None, Some("0"), None, None]), "greater than 0");
        assert_eq!(shown([None, Some("0"), Some("9"), None]), "greater than 0 and at most 9");
        assert_eq!(shown([Some("0"), None, None, Some("1")]), "at least 0 and less than 1");
    }

    #[test]
    fn a_slip_inside_a_table_is_said_once_and_of_that_table() {
        /// With a table inside.
        #[derive(JsonSchema)]
        #[serde(deny_unknown_fields)]
        #[allow(dead_code)]
        struct Outer {
            crop: Option<Crop>,
        }
        #[derive(JsonSchema)]
        #[serde(deny_unknown_fields)]
        #[allow(dead_code)]
        struct Crop {
            width: u32,
            height: u32,
        }
        let schema = schemars::schema_for!(Outer).to_value();
        let source = Source::new("m.toml", "", "crop = { widht = 3, height = -1 }");
        let tree = Tree {
            item: Item::Table(parse(&source).unwrap()),
            origin: crate::document::Origin { source, span: 0..0 },
        };
        let mut problems = Vec::new();
        validate(&tree, &schema, "parameter of test/node", &mut problems);
        let said: Vec<&str> = problems.iter().map(|problem| problem.message.as_str()).collect();
        assert_eq!(said, ["`widht` is not a key of `crop`", "`crop.height` must be at least 0, found -1"]);
    }

    #[test]
    fn paths_are_taken_out_of_what_is_hashed() {
        let schema = schemars::schema_for!(Params).to_value();
        let mut json = serde_json::json!({"weight": 1.0, "path": "a.h5"});
        strip_paths(&mut json, &schema);
        assert_eq!(json, serde_json::json!({"weight": 1.0}));
    }
}
