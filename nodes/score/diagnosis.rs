//! `score/diagnosis`: a diagnosis held against what is known of the recording's sensor.
//!
//! The answers are a file next to recordings that were made to examine a diagnosis
//! (`photocurrent-sealed-answers/1`): for each recording which effects its sensor has beyond its description,
//! with their numbers, or none, or a dependence outside the catalogue. This node alone reads such a file; no
//! stage of a diagnosis does.
//!
//! Numbers depend on what is concealed: `false_alarm` where nothing is; `first_right`, `in_set`, `set_size`,
//! `surplus`, `f1`, `posterior`, `parameter_error` and `covered` where effects of the catalogue are;
//! `unnamed` and `covariate_right` where a dependence is that no catalogue lists. What does not apply is left
//! out, so that means over recordings are means over those of their kind. `count` is 1: with the card's
//! fields `truth` and `said`, its sum is a confusion matrix.
//!
//! Limits: effects that no recording could distinguish count as wrong when the other one is named; `in_set`
//! is the fairer number.

use photocurrent_core::quantity::InputPath;
use photocurrent_core::table::{Column, Score, TableMeta};
use photocurrent_core::{
    Context, Decl, Diagnosis, DiagnosisKind, FileRef, Grain, Meta, Node, NodeError, PortMetas, Table,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeSet;
use std::sync::Arc;

/// The version of the form of answers.
const SCHEMA: &str = "photocurrent-sealed-answers/1";

/// Parameters of `score/diagnosis`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The answers, a JSON file in the form `photocurrent-sealed-answers/1`; relative to the manifest that
    /// names it.
    pub answers: InputPath,
    /// Which of its recordings was diagnosed: the name of the file without folder and ending, such as
    /// `"01234567"`.
    pub recording: String,
}

photocurrent_core::ports! {
    /// The answer to judge.
    pub struct In {
        /// The answer to judge, a diagnosis of kind `report`.
        report: Arc<Diagnosis>,
    }
}

photocurrent_core::ports! {
    /// How right it is.
    pub struct Out {
        /// Pooled: what applies of `count`, `false_alarm`, `first_right`, `in_set`, `set_size`, `surplus`,
        /// `f1`, `posterior`, `parameter_error`, `covered`, `unnamed`, `covariate_right`.
        scores: Arc<Table>,
        /// One row: `recording`, `kind`, `condition`, `truth`, `verdict`, `said`, `also_possible`.
        row: Arc<Table>,
    }
}

/// What it may give; which of them apply depends on the answer.
const METRICS: [&str; 12] = [
    "count",
    "false_alarm",
    "first_right",
    "in_set",
    "set_size",
    "surplus",
    "f1",
    "posterior",
    "parameter_error",
    "covered",
    "unnamed",
    "covariate_right",
];

/// The node.
pub struct ScoreDiagnosis {
    params: Params,
}

impl ScoreDiagnosis {
    /// What is known of the recording.
    fn answer(&self) -> Result<Value, NodeError> {
        let path = self.params.answers.path();
        let text = std::fs::read_to_string(path).map_err(|error| {
            NodeError::files(photocurrent_core::error::cannot_read(path, &error))
                .hint("paths are relative to the manifest that names them")
                .param("answers")
        })?;
        let wrong = |found: String| {
            NodeError::input(format!("{}: {found}", path.display()))
                .hint(format!("the file has `\"schema\": \"{SCHEMA}\"` and a list `recordings`"))
                .param("answers")
        };
        let all: Value =
            serde_json::from_str(&text).map_err(|error| wrong(format!("this is no JSON: {error}")))?;
        if all["schema"] != SCHEMA {
            return Err(wrong(format!("the schema is {}", all["schema"])));
        }
        let recordings =
            all["recordings"].as_array().ok_or_else(|| wrong("there is no list `recordings`".into()))?;
        let stem = |answer: &Value| {
            answer["file"]
                .as_str()
                .and_then(|file| file.rsplit('/').next()?.split('.').next().map(str::to_owned))
        };
        let found = recordings.iter().find(|answer| stem(answer).as_deref() == Some(&self.params.recording));
        found.cloned().ok_or_else(|| {
            NodeError::usage(format!(
                "there is no recording \"{}\" among the {} of {}",
                self.params.recording,
                recordings.len(),
                path.display()
            ))
            .hint("`recording` is the name of a recording without folder and ending, such as \"01234567\"")
            .param("recording")
        })
    }
}

impl Node for ScoreDiagnosis {
    const DECL: Decl = Decl {
        kind: "score/diagnosis",
        about: "Holds a diagnosis against what is known of the recording's sensor: false alarms, names, \
                sets, parameters.",
        revision: 3,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["photocurrent-sealed-answers/1 (data/concealed/README.md)"],
        example: r#"
[nodes.right]
kind   = "score/diagnosis"
in     = { report = "confirm.report" }
params = { answers = "known.json", recording = "01234567" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if params.answers.path().as_os_str().is_empty() {
            return Err(NodeError::usage("`answers` is missing")
                .hint("name the file of answers, such as `answers = \"known.json\"`")
                .param("answers"));
        }
        if params.recording.is_empty() {
            return Err(NodeError::usage("`recording` is missing")
                .hint("name the recording without folder and ending, such as `recording = \"01234567\"`")
                .param("recording"));
        }
        Ok(ScoreDiagnosis { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        inputs.diagnosis("report")?.need(DiagnosisKind::Report, "report")?;
        self.answer()?;
        Ok([true, false].map(|scores| Meta::Table(Arc::new(TableMeta { scores }))).to_vec())
    }

    fn metrics(_: &Params) -> Vec<String> {
        METRICS.map(String::from).to_vec()
    }

    fn run(&self, input: In, _: &Context) -> Result<Out, NodeError> {
        let (answer, report): (Value, Value) = (self.answer()?, input.report.read()?);
        let (truth, said) = (truth(&answer), Said::of(&report));
        let card = format!(
            "diagnosis.v1: kind = {}; condition = {}; truth = {}; verdict = {}; said = {}",
            text(&answer["kind"]),
            text(&answer["condition"]),
            joined(&truth),
            text(&report["verdict"]),
            joined(&said.ids)
        );
        let pooled = |(metric, value): (&str, f64)| Score {
            metric: metric.into(),
            frame: -1,
            t_ns: 0,
            value,
            unit: unit(metric).into(),
        };
        let scores = judge(&answer, &report, &truth, &said).into_iter().map(pooled).collect();
        let cell = |text: String| Column::Texts(vec![text]);
        let row = Table::default()
            .with("recording", cell(self.params.recording.clone()))
            .with("kind", cell(text(&answer["kind"])))
            .with("condition", cell(text(&answer["condition"])))
            .with("truth", cell(joined(&truth)))
            .with("verdict", cell(text(&report["verdict"])))
            .with("said", cell(joined(&said.ids)))
            .with(
                "also_possible",
                cell(said.sets.iter().map(|set| set[1..].join("|")).collect::<Vec<_>>().join("+")),
            );
        Ok(Out { scores: Arc::new(Table::scores(scores, card)), row: Arc::new(row) })
    }

    fn files(&self) -> Vec<FileRef> {
        vec![FileRef { param: "answers".into(), path: self.params.answers.path().into() }]
    }
}

fn unit(metric: &str) -> &'static str {
    if metric == "parameter_error" { "%" } else { "" }
}

/// A text, or a dash.
fn text(value: &Value) -> String {
    value.as_str().filter(|text| !text.is_empty()).unwrap_or("-").to_owned()
}

fn joined(ids: &[String]) -> String {
    if ids.is_empty() { "none".into() } else { ids.join("+") }
}

/// The ids of what is concealed, in alphabetical order; `unnamed` for a dependence outside the catalogue.
fn truth(answer: &Value) -> Vec<String> {
    let ids = answer["effects"].as_array().into_iter().flatten().filter_map(|effect| effect["id"].as_str());
    let mut ids: Vec<String> = ids.map(str::to_owned).collect();
    if answer["off_catalogue"].is_object() {
        ids.push("unnamed".into());
    }
    ids.sort();
    ids
}

/// What a report claims.
struct Said {
    /// Ids that stand first, in alphabetical order.
    ids: Vec<String>,
    /// Each claim as a set, the id that stands first first; strongest claim first.
    sets: Vec<Vec<String>>,
}

impl Said {
    fn of(report: &Value) -> Said {
        let set = |effect: &Value| -> Vec<String> {
            let others = effect["also_possible"].as_array().into_iter().flatten();
            std::iter::once(&effect["id"])
                .chain(others)
                .filter_map(Value::as_str)
                .map(str::to_owned)
                .collect()
        };
        let sets: Vec<Vec<String>> = report["effects"]
            .as_array()
            .into_iter()
            .flatten()
            .map(set)
            .filter(|set| !set.is_empty())
            .collect();
        let mut ids: Vec<String> = sets.iter().map(|set| set[0].clone()).collect();
        ids.sort();
        Said { ids, sets }
    }
}

fn judge(answer: &Value, report: &Value, truth: &[String], said: &Said) -> Vec<(&'static str, f64)> {
    let share = |count: usize, of: usize| count as f64 / of as f64;
    let is = |claim: bool| f64::from(u8::from(claim));
    let mut scores = vec![("count", 1.0)];
    if truth.is_empty() {
        scores.push(("false_alarm", is(!said.sets.is_empty())));
        return scores;
    }
    if let Some(concealed) = answer["off_catalogue"].as_object() {
        let unnamed =
            report["effects"].as_array().into_iter().flatten().find(|effect| effect["id"] == "unnamed");
        scores.push(("unnamed", is(unnamed.is_some())));
        let right: BTreeSet<&str> = concealed
            .get("covariates")
            .and_then(Value::as_array)
            .into_iter()
            .flatten()
            .filter_map(Value::as_str)
            .collect();
        let covariate = unnamed.and_then(|effect| effect["location"]["covariate"].as_str());
        scores.push(("covariate_right", is(covariate.is_some_and(|covariate| right.contains(covariate)))));
        return scores;
    }
    let named = truth.iter().filter(|id| said.ids.contains(id)).count();
    let in_set = truth.iter().filter(|id| said.sets.iter().any(|set| set.contains(id))).count();
    scores.push(("first_right", is(said.sets.first().is_some_and(|set| truth.contains(&set[0])))));
    scores.push(("in_set", share(in_set, truth.len())));
    if !said.sets.is_empty() {
        scores.push(("set_size", share(said.sets.iter().map(Vec::len).sum(), said.sets.len())));
    }
    scores.push((
        "surplus",
        said.sets.iter().filter(|set| !set.iter().any(|id| truth.contains(id))).count() as f64,
    ));
    scores.push(("f1", 2.0 * named as f64 / (truth.len() + said.ids.len()) as f64));
    let first = report["effects"].as_array().into_iter().flatten().next();
    if let Some(posterior) = first.and_then(|effect| effect["evidence"]["posterior"].as_f64()) {
        scores.push(("posterior", posterior));
    }
    let errors = parameters(answer, report);
    if !errors.is_empty() {
        scores.push((
            "parameter_error",
            100.0 * errors.iter().map(|(error, _)| error).sum::<f64>() / errors.len() as f64,
        ));
    }
    let covered: Vec<bool> = errors.iter().filter_map(|(_, covered)| *covered).collect();
    if !covered.is_empty() {
        scores.push(("covered", share(covered.iter().filter(|covered| **covered).count(), covered.len())));
    }
    scores
}

/// Of every number of an effect that is concealed and named: its error over what is concealed, and whether
/// its interval holds the truth.
fn parameters(answer: &Value, report: &Value) -> Vec<(f64, Option<bool>)> {
    let mut found = Vec::new();
    for effect in answer["effects"].as_array().into_iter().flatten() {
        let Some(claim) =
            report["effects"].as_array().into_iter().flatten().find(|claim| claim["id"] == effect["id"])
        else {
            continue;
        };
        for (key, parameter) in effect["parameters"].as_object().into_iter().flatten() {
            let said = &claim["parameters"][key];
            let (Some(actual), Some(nominal), Some(estimate)) =
                (parameter["actual"].as_f64(), parameter["nominal"].as_f64(), said["estimate"].as_f64())
            else {
                continue;
            };
            if actual != nominal {
                let interval = said["ci95"]
                    .as_array()
                    .and_then(|ends| Some((ends.first()?.as_f64()?, ends.get(1)?.as_f64()?)));
                found.push((
                    (estimate - actual).abs() / (actual - nominal).abs(),
                    interval.map(|(low, high)| (low..=high).contains(&actual)),
                ));
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::testing;
    use photocurrent_core::{DiagnosisMeta, Rows};
    use serde_json::json;

    fn answers() -> Value {
        let offset = json!({
            "id": "clock_offset",
            "parameters": { "offset_s": { "actual": 0.0005, "nominal": 0.0, "unit": "s" } },
        });
        let leak = json!({
            "id": "leak_events",
            "parameters": { "rate_hz": { "actual": [1.0, 2.0], "nominal": [0.0, 0.0], "unit": "Hz" } },
        });
        json!({ "schema": SCHEMA, "recordings": [
            { "file": "recordings/00000000.h5", "kind": "null", "effects": [], "off_catalogue": null },
            {
                "file": "recordings/00000001.h5", "kind": "single", "effects": [offset],
                "off_catalogue": null,
            },
            {
                "file": "recordings/00000002.h5", "kind": "pair", "effects": [offset, leak],
                "off_catalogue": null,
            },
            {
                "file": "recordings/00000003.h5", "kind": "off_catalogue", "effects": [],
                "off_catalogue": { "covariates": ["row", "row_rate"] },
            },
        ] })
    }

    fn node(recording: &str) -> (tempfile::TempDir, ScoreDiagnosis) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("known.json");
        std::fs::write(&path, answers().to_string()).unwrap();
        (
            folder,
            ScoreDiagnosis::build(Params { answers: InputPath::new(path), recording: recording.into() })
                .unwrap(),
        )
    }

    fn scores(recording: &str, effects: Value) -> (Vec<(String, f64)>, Arc<Table>) {
        let (_folder, node) = node(recording);
        let report = Diagnosis::from_text(
            DiagnosisKind::Report,
            json!({ "verdict": "named", "effects": effects }).to_string(),
        )
        .unwrap();
        let (out, _) = testing::with_context(Rows { start: 0, end: 0 }, &["scores", "row"], |cx| {
            node.run(In { report: Arc::new(report) }, cx).unwrap()
        });
        (
            out.scores.as_scores().unwrap().into_iter().map(|score| (score.metric, score.value)).collect(),
            out.row,
        )
    }

    fn close(found: &[(String, f64)], expected: &[(&str, f64)]) {
        assert_eq!(
            found.iter().map(|(metric, _)| metric.as_str()).collect::<Vec<_>>(),
            expected.iter().map(|(metric, _)| *metric).collect::<Vec<_>>()
        );
        assert!(found.iter().zip(expected).all(|((_, a), (_, b))| (a - b).abs() < 1e-12), "{found:?}");
    }

    #[test]
    fn a_claim_about_a_sound_sensor_is_a_false_alarm() {
        close(&scores("00000000", json!([])).0, &[("count", 1.0), ("false_alarm", 0.0)]);
        close(
            &scores("00000000", json!([{ "id": "blur", "also_possible": [] }])).0,
            &[("count", 1.0), ("false_alarm", 1.0)],
        );
    }

    #[test]
    fn a_right_name_counts_with_the_error_of_its_number() {
        let claim = |ci95: Value| {
            json!([{
                "id": "clock_offset", "also_possible": ["row_time"],
                "parameters": { "offset_s": { "estimate": 0.0004, "ci95": ci95 } },
            }])
        };
        let expected = |covered: f64| {
            [
                ("count", 1.0),
                ("first_right", 1.0),
                ("in_set", 1.0),
                ("set_size", 2.0),
                ("surplus", 0.0),
                ("f1", 1.0),
                ("parameter_error", 20.0),
                ("covered", covered),
            ]
        };
        close(&scores("00000001", claim(json!([0.0003, 0.0006]))).0, &expected(1.0));
        let (found, row) = scores("00000001", claim(json!([0.0003, 0.00045])));
        close(&found, &expected(0.0));
        let cell = |name: &str| row.column(name).unwrap().cell(0);
        assert_eq!(
            [cell("truth"), cell("said"), cell("also_possible")],
            ["clock_offset", "clock_offset", "row_time"]
        );
    }

    #[test]
    fn of_two_effects_each_counts_and_what_is_not_there_is_surplus() {
        let claims = json!([
            { "id": "blur", "also_possible": [] },
            { "id": "parasitic_leak", "also_possible": ["leak_events"] },
        ]);
        let expected = [
            ("count", 1.0),
            ("first_right", 0.0),
            ("in_set", 0.5),
            ("set_size", 1.5),
            ("surplus", 1.0),
            ("f1", 0.0),
        ];
        close(&scores("00000002", claims).0, &expected);
        let nothing = [("count", 1.0), ("first_right", 0.0), ("in_set", 0.0), ("surplus", 0.0), ("f1", 0.0)];
        close(&scores("00000002", json!([])).0, &nothing);
    }

    #[test]
    fn a_dependence_outside_the_catalogue_is_to_stay_without_a_name() {
        let right =
            json!([{ "id": "unnamed", "also_possible": [], "location": { "covariate": "row_rate" } }]);
        close(&scores("00000003", right).0, &[("count", 1.0), ("unnamed", 1.0), ("covariate_right", 1.0)]);
        close(
            &scores("00000003", json!([{ "id": "blur", "also_possible": [] }])).0,
            &[("count", 1.0), ("unnamed", 0.0), ("covariate_right", 0.0)],
        );
    }

    #[test]
    fn a_recording_or_a_file_that_is_not_there_is_reported_while_planning() {
        let report = || {
            PortMetas::new(
                [(
                    "report".to_string(),
                    vec![Meta::Diagnosis(Arc::new(DiagnosisMeta { kind: DiagnosisKind::Report }))],
                )]
                .into(),
            )
        };
        let (_folder, unknown) = node("ffffffff");
        let error = unknown.plan(&report()).unwrap_err();
        assert!(error.message.contains("no recording \"ffffffff\" among the 4"), "{}", error.message);
        let missing =
            ScoreDiagnosis::build(Params { answers: InputPath::new("no/such.json"), recording: "0".into() })
                .unwrap();
        assert_eq!(missing.plan(&report()).unwrap_err().param.as_deref(), Some("answers"));
        assert!(
            ScoreDiagnosis::build(Params::default()).err().unwrap().message.contains("`answers` is missing")
        );
    }
}
