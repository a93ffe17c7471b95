//! Reads lines of scores and says where each stands on the axes.

use crate::args::Pooled;
use crate::failure::{Failure, usage};
use crate::file_kind::FileKind;
use crate::run_record::check_same_manifest;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// One number and its place.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// (axis, level): `file`, those of the ablation, `node`, `method`, `label`, `metric`, `frame`, as far as
    /// the line has them.
    pub place: Vec<(String, String)>,
    /// Its unit, "" for none.
    pub unit: String,
    /// NaN where it was not measured.
    pub value: f64,
    /// How it was measured.
    pub card: String,
    /// What is missing where nothing was measured, as a name of a file or folder; and in whole sentences.
    pub missing: Option<(String, String)>,
}

impl Record {
    /// Its level on an axis.
    pub fn level(&self, axis: &str) -> Option<&str> {
        self.place.iter().find(|(name, _)| name == axis).map(|(_, level)| level.as_str())
    }
}

/// Which numbers are wanted.
pub struct Choice {
    /// In this order; empty = all.
    pub metrics: Vec<String>,
    /// Levels of axes, in this order.
    pub levels: Vec<(String, Vec<String>)>,
    /// Which of the pooled numbers.
    pub statistic: Pooled,
    /// Single frames instead of pooled numbers?
    pub by_frame: bool,
    /// Fields of the metric card that are axes.
    pub card: Vec<String>,
}

/// Reads all sources and keeps what is wanted, in the order of the choice, else of the files.
pub fn read(sources: &[PathBuf], choice: &Choice) -> Result<Vec<Record>, Failure> {
    let mut all = Vec::new();
    for source in sources {
        let (path, name) = find(source, choice.by_frame)?;
        let text = std::fs::read_to_string(&path)
            .map_err(|error| usage(format!("{}: cannot read: {error}", path.display())))?;
        for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            let wrong = |what: &str| {
                usage(format!(
                    "{}:{}: {what}\n  expected a line of metrics.pooled.jsonl (docs/formats.md)",
                    path.display(),
                    number + 1
                ))
            };
            let value: Value =
                serde_json::from_str(line).map_err(|error| wrong(&format!("no JSON: {error}")))?;
            all.extend(record(&value, &name, choice).map_err(|what| wrong(&what))?);
        }
    }
    let all = placed(all);
    if all.is_empty() {
        let (what, hint) = if choice.by_frame {
            ("of single frames", "leave `frame` out")
        } else {
            ("pooled over frames", "name `frame` in --rows or --columns")
        };
        return Err(usage(format!(
            "{}: no score {what}\n  {hint}, or run the pipeline again",
            sources[0].display()
        )));
    }
    chosen(all, choice)
}

/// The file to read, and what to call it.
fn find(source: &Path, by_frame: bool) -> Result<(PathBuf, String), Failure> {
    let file = if by_frame { "metrics.jsonl" } else { "metrics.pooled.jsonl" };
    let name =
        |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let kind = FileKind::of(source);
    if matches!(kind, FileKind::Recording(_) | FileKind::Artefact | FileKind::Sensor | FileKind::Diagnosis) {
        return Err(kind.refuse(
            source,
            "table",
            "a manifest that was run, a folder with scores, or a file of scores",
        ));
    }
    if matches!(kind, FileKind::Manifest) || source.extension().is_some_and(|extension| extension == "toml") {
        let stem = source.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        if !source.exists() {
            return Err(usage(format!(
                "{}: there is no such manifest\n  name a manifest that was run, the folder that it wrote \
                 to, or a file {file}",
                source.display()
            )));
        }
        let path = Path::new("out").join(&stem).join(file);
        if !path.exists() {
            return Err(usage(format!(
                "{} is not there\n  run `photocurrent run {}` first, or name the folder that it wrote to",
                path.display(),
                source.display()
            )));
        }
        let hint = "run this manifest with --out FOLDER, and name that folder instead of the manifest";
        check_same_manifest(&Path::new("out").join(&stem), source, "this is", hint)?;
        return Ok((path, stem));
    }
    if source.is_dir() {
        // A folder of `run`, or one of write/table.
        let other = if by_frame { "metrics.jsonl" } else { "pooled.jsonl" };
        let path = [file, other].iter().map(|file| source.join(file)).find(|path| path.exists());
        return path.map(|path| (path, name(source))).ok_or_else(|| {
            let hint = "name a folder that `photocurrent run` wrote scores to (out/NAME of the manifest), \
                        or one of write/table";
            usage(format!("{}: the folder has no {file}\n  {hint}", source.display()))
        });
    }
    if !source.exists() {
        return Err(usage(format!(
            "{} is not there\n  name a manifest that was run, the folder that it wrote to (out/NAME unless \
             --out said otherwise), or a file {file}; `photocurrent run MANIFEST` writes them",
            source.display()
        )));
    }
    Ok((source.to_path_buf(), source.parent().map(name).unwrap_or_default()))
}

/// A line's number and place; `None` when it is of the other sort (a frame's, or pooled).
fn record(line: &Value, file: &str, choice: &Choice) -> Result<Option<Record>, String> {
    let text = |key: &str| line[key].as_str();
    let (variant, node) = (text("variant").ok_or("no `variant`")?, text("node").ok_or("no `node`")?);
    let missing = text("missing").map(|name| (name.to_string(), text("why").unwrap_or_default().to_string()));
    let metric = text("metric").or(missing.as_ref().map(|_| UNPLACED)).ok_or("no `metric`")?;
    let frame = line["frame"].as_i64().filter(|frame| *frame >= 0);
    if frame.is_some() != choice.by_frame {
        return Ok(None);
    }
    let value = match (choice.by_frame, choice.statistic) {
        (true, _) | (_, Pooled::Value) => &line["value"],
        (_, Pooled::Min) => &line["min"],
        (_, Pooled::P05) => &line["p05"],
        (_, Pooled::P95) => &line["p95"],
        (_, Pooled::Max) => &line["max"],
    };
    let value = match value {
        Value::Null => f64::NAN,
        Value::String(text) if text == "Infinity" => f64::INFINITY,
        Value::String(text) if text == "-Infinity" => f64::NEG_INFINITY,
        other => other.as_f64().ok_or_else(|| format!("`value` is {other}, and no number"))?,
    };
    let mut place = vec![("file".to_string(), file.to_string())];
    let mut put = |axis: &str, level: &str| place.push((axis.into(), level.into()));
    if node.is_empty() {
        // A line of write/table: the variant is the row's label.
        put("label", variant);
        put("method", variant);
    } else {
        for (axis, level) in variant.split(',').filter_map(|pair| pair.split_once('=')) {
            put(axis, level);
        }
        put("node", node);
        put("method", node.split_once('_').map_or(node, |(_, method)| method));
    }
    put("metric", metric);
    if let Some(frame) = frame {
        put("frame", &frame.to_string());
    }
    let (unit, card) =
        (text("unit").unwrap_or_default().to_string(), text("card").unwrap_or_default().to_string());
    for field in &choice.card {
        place.extend(card_field(&card, field).map(|level| (format!("card.{field}"), level.to_string())));
    }
    Ok(Some(Record { place, unit, value, card, missing }))
}

/// The metric of what was not measured, before that is known.
const UNPLACED: &str = "";

/// What was not measured stands where the numbers of the other methods do: a node whose name begins alike
/// (psnr_edi, psnr_film) would have given the same metrics. Without another method it stands nowhere.
fn placed(all: Vec<Record>) -> Vec<Record> {
    let sort =
        |record: &Record| record.level("node").map(|node| node.split('_').next().unwrap_or(node).to_string());
    let measured: Vec<Record> = all.iter().filter(|record| record.missing.is_none()).cloned().collect();
    let as_others = |record: Record| -> Vec<Record> {
        if record.missing.is_none() {
            return vec![record];
        }
        let alike: Vec<Record> =
            measured.iter().filter(|other| sort(other) == sort(&record)).cloned().collect();
        let place = |metric: String| {
            let unit = alike
                .iter()
                .find(|other| other.level("metric") == Some(&metric))
                .map(|other| other.unit.clone())
                .unwrap_or_default();
            let place = record.place.iter().map(|(axis, level)| {
                (axis.clone(), if axis == "metric" { metric.clone() } else { level.clone() })
            });
            Record { place: place.collect(), unit, ..record.clone() }
        };
        levels_of(&alike, "metric").into_iter().map(place).collect()
    };
    all.into_iter().flat_map(as_others).collect()
}

/// A field of a metric card: `definition: key = text; key = text`.
fn card_field<'a>(card: &'a str, field: &str) -> Option<&'a str> {
    let (_, fields) = card.split_once(": ")?;
    fields
        .split("; ")
        .filter_map(|pair| pair.split_once(" = "))
        .find(|(key, _)| *key == field)
        .map(|(_, text)| text)
}

/// What is wanted, in the order in which it is wanted.
fn chosen(all: Vec<Record>, choice: &Choice) -> Result<Vec<Record>, Failure> {
    let mut wishes = choice.levels.clone();
    if !choice.metrics.is_empty() {
        wishes.push(("metric".into(), choice.metrics.clone()));
    }
    let mut kept = all.clone();
    for (axis, levels) in &wishes {
        let known = levels_of(&all, axis);
        if known.is_empty() {
            return Err(usage(format!("there is no axis `{axis}`; there are {}", axes_of(&all).join(", "))));
        }
        if let Some(level) = levels.iter().find(|level| !known.contains(level)) {
            return Err(usage(format!("there is no {axis} `{level}`; there are {}", known.join(", "))));
        }
        let rank = |record: &Record| levels.iter().position(|level| record.level(axis) == Some(level));
        kept.retain(|record| rank(record).is_some());
        kept.sort_by_key(rank);
    }
    if kept.is_empty() { Err(usage("no score has all that --where and --metric ask for")) } else { Ok(kept) }
}

/// The levels of an axis in the order in which they come.
pub fn levels_of(records: &[Record], axis: &str) -> Vec<String> {
    let mut levels: Vec<String> = Vec::new();
    for level in records.iter().filter_map(|record| record.level(axis)) {
        if levels.last().is_none_or(|last| last != level) && !levels.iter().any(|known| known == level) {
            levels.push(level.into());
        }
    }
    levels
}

/// All axes, those of an ablation before `node`.
pub fn axes_of(records: &[Record]) -> Vec<String> {
    let mut axes: Vec<String> = Vec::new();
    for (axis, _) in records.iter().flat_map(|record| &record.place) {
        if !axes.contains(axis) {
            axes.push(axis.clone());
        }
    }
    axes
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn wish(by_frame: bool) -> Choice {
        Choice {
            metrics: Vec::new(),
            levels: Vec::new(),
            statistic: Pooled::Value,
            by_frame,
            card: Vec::new(),
        }
    }

    #[test]
    fn a_field_of_the_card_is_an_axis_when_it_is_asked_for() {
        let line = json!({
            "variant": "recording=a", "node": "right", "metric": "count", "frame": -1, "value": 1.0,
            "unit": "", "card": "d.v1: truth = blur; said = none",
        });
        let asked = Choice { card: vec!["truth".into(), "colour".into()], ..wish(false) };
        let found = record(&line, "concealed", &asked).expect("a line").expect("pooled");
        assert_eq!(
            (found.level("card.truth"), found.level("card.said"), found.level("card.colour")),
            (Some("blur"), None, None)
        );
    }

    #[test]
    fn a_pooled_line_stands_on_the_axes_of_its_variant_and_node() {
        let line = json!({
            "variant": "scene=fan,light=50lx", "node": "psnr_akf_late", "metric": "psnr_db", "frame": -1,
            "value": 30.5, "unit": "dB", "min": 20.0,
        });
        let found = record(&line, "table1", &wish(false)).expect("a line").expect("pooled");
        let place: Vec<String> = found.place.iter().map(|(axis, level)| format!("{axis}={level}")).collect();
        assert_eq!(
            place,
            [
                "file=table1",
                "scene=fan",
                "light=50lx",
                "node=psnr_akf_late",
                "method=akf_late",
                "metric=psnr_db"
            ]
        );
        assert_eq!((found.value, found.unit.as_str()), (30.5, "dB"));
        let least = Choice { statistic: Pooled::Min, ..wish(false) };
        assert_eq!(record(&line, "", &least).expect("a line").expect("pooled").value, 20.0);
        assert_eq!(record(&line, "", &wish(true)), Ok(None));
    }

    #[test]
    fn what_is_missing_stands_where_other_methods_have_numbers() {
        let number = |node: &str, metric: &str| {
            json!({
                "variant": "scene=fan", "node": node, "metric": metric, "frame": -1, "value": 1.0,
                "unit": "dB",
            })
        };
        let absent = |node: &str| {
            json!({
                "variant": "scene=fan", "node": node, "missing": "film.onnx",
                "why": "cannot read weights/film.onnx",
            })
        };
        let lines = [
            number("psnr_edi", "psnr_db"),
            number("psnr_edi", "sharpness"),
            absent("film"),
            absent("psnr_film"),
            absent("lpips_film"),
        ];
        let read = |wish: &Choice| {
            placed(lines.iter().filter_map(|line| record(line, "", wish).expect("a line")).collect())
        };
        let missing: Vec<Record> =
            read(&wish(false)).into_iter().filter(|record| record.missing.is_some()).collect();
        let places: Vec<_> =
            missing.iter().map(|record| (record.level("method"), record.level("metric"))).collect();
        // No other method was measured by `lpips`, and `film` itself measures nothing.
        assert_eq!(places, [(Some("film"), Some("psnr_db")), (Some("film"), Some("sharpness"))]);
        assert!(missing.iter().all(|record| record.value.is_nan() && record.unit == "dB"));
        assert_eq!(read(&wish(true)).len(), 0, "it is no number of a frame");
    }

    #[test]
    fn what_write_table_writes_has_labels_and_what_was_not_measured_is_no_number() {
        let line = |value: Value| {
            json!({
                "variant": "EDI, late = 2", "node": "", "metric": "psnr_db", "value": value, "unit": "dB",
            })
        };
        let found = record(&line(Value::Null), "", &wish(false)).expect("a line").expect("pooled");
        assert_eq!(found.level("label"), Some("EDI, late = 2"));
        assert!(found.value.is_nan());
        assert_eq!(
            record(&line(json!("Infinity")), "", &wish(false)).expect("a line").expect("pooled").value,
            f64::INFINITY
        );
        assert!(record(&line(json!([1])), "", &wish(false)).is_err_and(|what| what.contains("no number")));
    }

    #[test]
    fn levels_come_in_the_order_in_which_they_are_asked_for() {
        let line = |scene: &str| {
            json!({
                "variant": format!("scene={scene}"), "node": "psnr", "metric": "psnr_db", "frame": -1,
                "value": 1.0,
            })
        };
        let all: Vec<Record> = ["fan", "ball", "text"]
            .iter()
            .filter_map(|scene| record(&line(scene), "", &wish(false)).expect("a line"))
            .collect();
        let asked = |levels: &[&str]| Choice {
            levels: vec![("scene".into(), levels.iter().map(ToString::to_string).collect())],
            ..wish(false)
        };
        assert!(
            chosen(all.clone(), &asked(&["text", "fan"]))
                .is_ok_and(|found| levels_of(&found, "scene") == ["text", "fan"])
        );
        let Err(Failure::Other { message, .. }) = chosen(all, &asked(&["moon"])) else {
            panic!("there is no moon")
        };
        assert_eq!(message, "there is no scene `moon`; there are fan, ball, text");
    }
}
