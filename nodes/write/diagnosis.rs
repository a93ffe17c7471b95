//! Writes the answer of a diagnosis: `diagnosis.json` for programs, a page for people, the fitted
//! description.
//!
//! The files are those of `photocurrent diagnose`: the report byte for byte, `report.html`, and
//! `sensor.fitted.toml` when the report says that there is one, with a word on where it comes from.

use photocurrent_core::table::{Column, TableMeta};
use photocurrent_core::{
    Context, Decl, Diagnosis, DiagnosisKind, Grain, Meta, Node, NodeError, PortMetas, Sensor, Table,
};
use photocurrent_diagnosis::fitted::with_findings;
use photocurrent_diagnosis::page::with_names;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::sync::Arc;

/// Parameters of `write/diagnosis`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// What the recording is called on the page, such as the name of its file. Absent = not named.
    pub recording: Option<String>,
    /// What the sensor description is called on the page. Absent = it is the one in the recording.
    pub description: Option<String>,
}

photocurrent_core::ports! {
    /// The answer.
    pub struct In {
        /// The answer, a diagnosis of kind `report`.
        report: Arc<Diagnosis>,
        /// The same for people, a diagnosis of kind `page`.
        page: Option<Arc<Diagnosis>>,
        /// The description with what was found put in.
        sensor: Option<Arc<Sensor>>,
    }
}

photocurrent_core::ports! {
    /// What was written.
    pub struct Out {
        /// One row a file: its name, and how many bytes it has.
        listing: Arc<Table>,
    }
}

/// The node.
pub struct WriteDiagnosis {
    params: Params,
}

impl Node for WriteDiagnosis {
    const DECL: Decl = Decl {
        kind: "write/diagnosis",
        about: "Writes the answer of a diagnosis: diagnosis.json, report.html and sensor.fitted.toml.",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: true,
        sources: &["photocurrent-diagnosis/1 (docs/formats.md)"],
        example: r#"
[nodes.answer]
kind = "write/diagnosis"
in   = { report = "confirm.report", page = "confirm.page", sensor = "confirm.sensor" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(WriteDiagnosis { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        inputs.diagnosis("report")?.need(DiagnosisKind::Report, "report")?;
        if inputs.has("page") {
            inputs.diagnosis("page")?.need(DiagnosisKind::Page, "page")?;
        }
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: false }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let report: Value = input.report.read()?;
        let mut files = vec![("diagnosis.json", input.report.text().to_owned())];
        if let Some(page) = &input.page {
            let names = (self.params.recording.as_deref(), self.params.description.as_deref());
            files.push(("report.html", with_names(&page.read::<String>()?, names.0, names.1)));
        }
        if let Some(sensor) = input.sensor.filter(|_| report["sensor_fitted"].is_string()) {
            let texts = |value: &Value| -> Vec<String> {
                value.as_array().into_iter().flatten().filter_map(Value::as_str).map(str::to_owned).collect()
            };
            let effects = report["effects"].as_array().into_iter().flatten();
            let claims: Vec<(String, Vec<String>)> = effects
                .map(|effect| {
                    (effect["id"].as_str().unwrap_or_default().to_owned(), texts(&effect["also_possible"]))
                })
                .collect();
            files.push(("sensor.fitted.toml", with_findings(&sensor, &claims)));
        }
        for (name, text) in &files {
            super::save(&cx.export_dir()?.join(name), text.as_bytes())?;
        }
        let listing = Table::default()
            .with("file", Column::Texts(files.iter().map(|(name, _)| (*name).into()).collect()))
            .with("bytes", Column::Integers(files.iter().map(|(_, text)| text.len() as i64).collect()));
        Ok(Out { listing: Arc::new(listing) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::write::testing::exporting;
    use photocurrent_core::document::Source;

    fn written(fitted: bool) -> Vec<(String, String)> {
        let fitted = if fitted { ", \"sensor_fitted\": \"sensor.fitted.toml\"" } else { "" };
        let text =
            format!("{{\"effects\": [{{\"id\": \"blur\", \"also_possible\": [\"crosstalk\"]}}]{fitted}}}\n");
        let input = In {
            report: Arc::new(Diagnosis::from_text(DiagnosisKind::Report, text).unwrap()),
            page: Some(Arc::new(Diagnosis::of(DiagnosisKind::Page, &"<p>\"so\"</p>\n".to_owned()).unwrap())),
            sensor: Some(Arc::new(Sensor::unknown("test"))),
        };
        let mut found = Vec::new();
        exporting(
            |cx| WriteDiagnosis { params: Params::default() }.run(input, cx).unwrap(),
            |out, _, folder| {
                let Some(Column::Texts(names)) = out.listing.column("file") else { panic!("names") };
                found.extend(
                    names
                        .iter()
                        .map(|name| (name.clone(), std::fs::read_to_string(folder.join(name)).unwrap())),
                );
            },
        );
        found
    }

    #[test]
    fn the_report_is_written_as_it_is_and_the_page_as_html() {
        let files = written(false);
        assert_eq!(files.len(), 2, "without a fitted description there is none to write");
        assert_eq!(files[0].1, "{\"effects\": [{\"id\": \"blur\", \"also_possible\": [\"crosstalk\"]}]}\n");
        assert_eq!(files[1].1, "<p>\"so\"</p>\n");
    }

    #[test]
    fn the_fitted_description_says_why_and_can_be_read() {
        let (name, text) = written(true).swap_remove(2);
        assert!(name == "sensor.fitted.toml" && text.contains("# blur (or crosstalk)\n"), "{text}");
        assert_eq!(Sensor::parse(&Source::new(name, "", text)).unwrap(), Sensor::unknown("test"));
    }
}
