//! Writes scores as tables: one row per method, one column per metric.
//!
//! Every input is a table of scores (one value per frame and metric, sometimes a pooled value) and has a
//! label. A cell is the pooled score: the mean over frames, or the smallest or largest value, or the 5th or
//! 95th percentile. A mean that the scorer pooled itself (it may pool errors rather than decibels) wins over
//! a mean taken here. Frames whose score is NaN were not measured: they are left out and counted.
//!
//! Files: `table.md` for people (the best of each column in bold, where it is known which way is better),
//! `table.csv` and `table.json` for programs (all digits), `metrics.jsonl` with every frame's score and
//! `pooled.jsonl` with every pooled one, one JSON object a line.
//!
//! Limits: scores of methods that were measured on different frames are put side by side as they are; the
//! number of frames stands in `table.json`.

use photocurrent_core::table::{Column, Score, TableMeta, higher_is_better, percentile};
use photocurrent_core::{Context, Decl, Grain, Meta, Node, NodeError, PortMetas, Table};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::sync::Arc;

/// Parameters of `write/table`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Names of the rows: one text for each connected table, in the same order, all different.
    pub labels: Vec<String>,
    /// Which metrics become columns, in this order, such as `["psnr_db"]`. Default: all, in the order in
    /// which they are met.
    pub metrics: Option<Vec<String>>,
    /// How the scores of the frames become one number.
    pub statistic: Statistic,
    /// Digits after the point in `table.md`; 0 to 12. The other files have all digits.
    #[schemars(range(max = 12))]
    pub decimals: usize,
}

impl Default for Params {
    fn default() -> Params {
        Params { labels: Vec::new(), metrics: None, statistic: Statistic::Mean, decimals: 3 }
    }
}

/// How the scores of the frames become one number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Statistic {
    /// The mean; the scorer's own pooled value, when it gave one.
    #[default]
    Mean,
    /// The smallest value.
    Min,
    /// The 5th percentile, linear between neighbouring values.
    P05,
    /// The 95th percentile, linear between neighbouring values: the bad tail where smaller is better.
    P95,
    /// The largest value.
    Max,
}

impl Statistic {
    fn name(self) -> &'static str {
        match self {
            Statistic::Mean => "mean",
            Statistic::Min => "min",
            Statistic::P05 => "p05",
            Statistic::P95 => "p95",
            Statistic::Max => "max",
        }
    }

    /// Of measured values; NaN when there is none.
    fn of(self, mut values: Vec<f64>) -> f64 {
        values.sort_by(f64::total_cmp);
        match (self, values.len()) {
            (_, 0) => f64::NAN,
            (Statistic::Mean, n) => values.iter().sum::<f64>() / n as f64,
            (Statistic::Min, _) => values[0],
            (Statistic::P05, _) => percentile(&values, 0.05),
            (Statistic::P95, _) => percentile(&values, 0.95),
            (Statistic::Max, n) => values[n - 1],
        }
    }
}

photocurrent_core::ports! {
    /// What is tabulated.
    pub struct In {
        /// Scores, one table per row of the result.
        tables: Vec<Arc<Table>>,
    }
}

photocurrent_core::ports! {
    /// The result.
    pub struct Out {
        /// One row per label: `label`, then one column of numbers per metric.
        table: Arc<Table>,
    }
}

/// The node.
pub struct WriteTable {
    params: Params,
}

/// A column: a metric in a unit.
#[derive(Clone, Debug, PartialEq)]
struct Metric {
    name: String,
    unit: String,
}

impl Metric {
    fn heading(&self) -> String {
        if self.unit.is_empty() { self.name.clone() } else { format!("{} [{}]", self.name, self.unit) }
    }

    fn higher_is_better(&self) -> Option<bool> {
        higher_is_better(&self.name)
    }
}

/// One pooled score.
#[derive(Clone, Copy, Debug)]
struct Cell {
    value: f64,
    /// How many frames it stands on.
    frames: usize,
}

/// Everything that is written.
struct Report {
    labels: Vec<String>,
    scores: Vec<Vec<Score>>,
    cards: Vec<String>,
    metrics: Vec<Metric>,
    /// By label, then by metric.
    cells: Vec<Vec<Cell>>,
    statistic: Statistic,
}

/// A number for JSON: NaN and infinities have no form of their own there.
fn number(value: f64) -> Value {
    if value.is_finite() {
        json!(value)
    } else if value.is_nan() {
        Value::Null
    } else {
        json!(if value > 0.0 { "Infinity" } else { "-Infinity" })
    }
}

/// A field of a CSV file: in quotes where it must be.
fn csv_field(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.into()
    }
}

/// A cell of a Markdown table.
fn markdown_cell(text: &str) -> String {
    text.replace('|', "\\|").replace(['\n', '\r'], " ")
}

impl Report {
    /// Cells of one metric in Markdown, the best in bold.
    fn markdown_column(&self, metric: usize, decimals: usize) -> Vec<String> {
        let value = |cells: &Vec<Cell>| cells[metric].value;
        let known = || self.cells.iter().map(value).filter(|value| !value.is_nan());
        let best = match self.metrics[metric].higher_is_better() {
            Some(true) => known().reduce(f64::max),
            Some(false) => known().reduce(f64::min),
            None => None,
        };
        let show = |value: f64| if value.is_nan() { "-".to_string() } else { format!("{value:.decimals$}") };
        // Values that print alike are marked alike. One method alone is not the best of anything.
        let best = best.filter(|_| known().count() > 1).map(show);
        self.cells
            .iter()
            .map(|cells| show(value(cells)))
            .map(|text| if Some(&text) == best.as_ref() { format!("**{text}**") } else { text })
            .collect()
    }

    fn markdown(&self, decimals: usize) -> String {
        let columns: Vec<Vec<String>> =
            (0..self.metrics.len()).map(|metric| self.markdown_column(metric, decimals)).collect();
        let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
        let headings = self.metrics.iter().map(|metric| markdown_cell(&metric.heading()));
        let mut text = line(std::iter::once("label".to_string()).chain(headings).collect());
        text += &line(
            std::iter::once("---".to_string())
                .chain(self.metrics.iter().map(|_| "---:".to_string()))
                .collect(),
        );
        for (row, label) in self.labels.iter().enumerate() {
            text += &line(
                std::iter::once(markdown_cell(label))
                    .chain(columns.iter().map(|column| column[row].clone()))
                    .collect(),
            );
        }
        text += &format!("\nStatistic over frames: {}.\n", self.statistic.name());
        let mut shown: Vec<&str> = Vec::new();
        for card in self.cards.iter().map(String::as_str).filter(|card| !card.is_empty()) {
            if !shown.contains(&card) {
                text += &format!("\n{card}\n");
                shown.push(card);
            }
        }
        text
    }

    fn csv(&self) -> String {
        let headings = self.metrics.iter().map(|metric| csv_field(&metric.heading()));
        let mut text =
            std::iter::once("label".to_string()).chain(headings).collect::<Vec<_>>().join(",") + "\n";
        for (label, cells) in self.labels.iter().zip(&self.cells) {
            let numbers = cells
                .iter()
                .map(|cell| if cell.value.is_nan() { String::new() } else { format!("{:?}", cell.value) });
            text += &(std::iter::once(csv_field(label)).chain(numbers).collect::<Vec<_>>().join(",") + "\n");
        }
        text
    }

    fn json(&self) -> String {
        let columns: Vec<Value> = self
            .metrics
            .iter()
            .map(|metric| {
                json!({"metric": metric.name, "unit": metric.unit,
                "higher_is_better": metric.higher_is_better(), "statistic": self.statistic.name()})
            })
            .collect();
        let row = |row: usize| {
            let cells = self.cells[row].iter();
            let (values, frames): (Vec<Value>, Vec<usize>) =
                cells.map(|cell| (number(cell.value), cell.frames)).unzip();
            json!({"label": self.labels[row], "values": values, "frames": frames, "card": self.cards[row]})
        };
        let rows: Vec<Value> = (0..self.labels.len()).map(row).collect();
        format!("{:#}\n", json!({"schema": "photocurrent-table/1", "columns": columns, "rows": rows}))
    }

    /// One object per (variant, frame, metric).
    fn metrics_lines(&self) -> String {
        let mut text = String::new();
        for ((label, scores), card) in self.labels.iter().zip(&self.scores).zip(&self.cards) {
            for score in scores.iter().filter(|score| score.frame >= 0 && self.has(score)) {
                let line = json!({
                    "variant": label, "node": "", "metric": score.metric, "frame": score.frame,
                    "t_ns": score.t_ns,
                    "value": number(score.value), "unit": score.unit, "card": card,
                });
                text += &format!("{line}\n");
            }
        }
        text
    }

    /// One object per (variant, metric).
    fn pooled_lines(&self) -> String {
        let mut text = String::new();
        for ((label, cells), card) in self.labels.iter().zip(&self.cells).zip(&self.cards) {
            for (metric, cell) in self.metrics.iter().zip(cells) {
                let line = json!({
                    "variant": label, "node": "", "metric": metric.name, "statistic": self.statistic.name(),
                    "frames": cell.frames,
                    "value": number(cell.value), "unit": metric.unit, "card": card,
                });
                text += &format!("{line}\n");
            }
        }
        text
    }

    fn has(&self, score: &Score) -> bool {
        self.metrics.iter().any(|metric| metric.name == score.metric && metric.unit == score.unit)
    }

    fn table(&self) -> Table {
        let table = Table::default().with("label", Column::Texts(self.labels.clone()));
        let table = self.metrics.iter().enumerate().fold(table, |table, (i, metric)| {
            table.with(
                &metric.heading(),
                Column::Numbers(self.cells.iter().map(|cells| cells[i].value).collect()),
            )
        });
        let table = table.note("statistic", self.statistic.name());
        self.labels
            .iter()
            .zip(&self.cards)
            .fold(table, |table, (label, card)| table.note(&format!("card of {label}"), card.as_str()))
    }
}

impl WriteTable {
    /// The columns: what the parameter asks for, or all in the order in which they are met.
    fn metrics(&self, scores: &[Vec<Score>]) -> Result<Vec<Metric>, NodeError> {
        let mut met: Vec<Metric> = Vec::new();
        for score in scores.iter().flatten() {
            let metric = Metric { name: score.metric.clone(), unit: score.unit.clone() };
            if !met.contains(&metric) {
                met.push(metric);
            }
        }
        let Some(asked) = &self.params.metrics else { return Ok(met) };
        let mut metrics = Vec::new();
        for name in asked {
            let before = metrics.len();
            metrics.extend(met.iter().filter(|metric| metric.name == *name).cloned());
            if metrics.len() == before {
                let mut known: Vec<&str> = met.iter().map(|metric| metric.name.as_str()).collect();
                known.dedup();
                return Err(NodeError::input(format!("no connected table has the metric \"{name}\""))
                    .hint(format!("there are: {}", known.join(", ")))
                    .param("metrics"));
            }
        }
        Ok(metrics)
    }

    fn pool(&self, label: &str, metric: &Metric, scores: &[Score], cx: &Context) -> Cell {
        let mine = || scores.iter().filter(|score| score.metric == metric.name && score.unit == metric.unit);
        let frames: Vec<f64> = mine().filter(|score| score.frame >= 0).map(|score| score.value).collect();
        let measured: Vec<f64> = frames.iter().copied().filter(|value| !value.is_nan()).collect();
        cx.count(
            (frames.len() - measured.len()) as u64,
            &format!("frames of {label} have no {} and were left out", metric.name),
        );
        let count = measured.len();
        let pooled = mine().find(|score| score.frame == -1).map(|score| score.value);
        match (pooled, self.params.statistic) {
            (Some(value), Statistic::Mean) => Cell { value, frames: count },
            // Without frames, the scorer's value is all there is; say what it is.
            (Some(value), statistic) if frames.is_empty() => {
                cx.note(format!(
                    "{label} has only a pooled {}; it stands in place of the {}",
                    metric.name,
                    statistic.name()
                ));
                Cell { value, frames: 0 }
            }
            (_, statistic) => Cell { value: statistic.of(measured), frames: count },
        }
    }
}

impl Node for WriteTable {
    const DECL: Decl = Decl {
        kind: "write/table",
        about: "Writes the scores of several methods as one table: Markdown, CSV, JSON, JSON Lines.",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: true,
        sources: &["photocurrent-table/1: Markdown, CSV, JSON (docs/formats.md)"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.split]
kind   = "split/frames"
in     = { frames = "recording.frames" }

[nodes.psnr]
kind   = "score/heldout"
in     = { frames = "split.held", held = "split.held" }

[nodes.scores]
kind   = "write/table"
in     = { tables = ["psnr"] }
params = { labels = ["itself"], decimals = 2 }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if params.decimals > 12 {
            return Err(NodeError::usage(format!(
                "`decimals` is {}, and must be 12 or less",
                params.decimals
            ))
            .param("decimals"));
        }
        if params.metrics.as_ref().is_some_and(Vec::is_empty) {
            return Err(NodeError::usage("`metrics` is an empty list: no column would be left")
                .hint("leave it out to get all metrics")
                .param("metrics"));
        }
        Ok(WriteTable { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let tables = inputs.all("tables");
        super::check_labels(&self.params.labels, tables.len(), "tables")?;
        for (label, meta) in self.params.labels.iter().zip(tables) {
            if let Meta::Table(meta) = meta
                && !meta.scores
            {
                return Err(NodeError::usage(format!("the table \"{label}\" holds no scores"))
                    .hint("connect the output of a scorer, such as score/psnr"));
            }
        }
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: false }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let folder = cx.export_dir()?;
        let labels = self.params.labels.clone();
        super::check_labels(&labels, input.tables.len(), "tables")?;
        let not_scores = |label: &String| NodeError::input(format!("the table \"{label}\" holds no scores"));
        let scores = labels
            .iter()
            .zip(&input.tables)
            .map(|(label, table)| table.as_scores().ok_or_else(|| not_scores(label)));
        let scores: Vec<Vec<Score>> = scores.collect::<Result<_, _>>()?;
        let card = |table: &Arc<Table>| {
            table
                .notes
                .iter()
                .find(|(name, _)| name == "card")
                .map(|(_, card)| card.clone())
                .unwrap_or_default()
        };
        let metrics = self.metrics(&scores)?;
        let pool = |(label, scores): (&String, &Vec<Score>)| {
            metrics.iter().map(|metric| self.pool(label, metric, scores, cx)).collect()
        };
        let cells = labels.iter().zip(&scores).map(pool).collect();
        let report = Report {
            cards: input.tables.iter().map(card).collect(),
            labels,
            scores,
            metrics,
            cells,
            statistic: self.params.statistic,
        };
        let files = [
            ("table.md", report.markdown(self.params.decimals)),
            ("table.csv", report.csv()),
            ("table.json", report.json()),
            ("metrics.jsonl", report.metrics_lines()),
            ("pooled.jsonl", report.pooled_lines()),
        ];
        for (name, text) in files {
            super::save(&folder.join(name), text.as_bytes())?;
        }
        Ok(Out { table: Arc::new(report.table()) })
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::exporting;
    use super::*;
    use std::collections::BTreeMap;
    use std::path::Path;

    fn score(metric: &str, frame: i64, value: f64, unit: &str) -> Score {
        Score { metric: metric.into(), frame, t_ns: frame * 1000, value, unit: unit.into() }
    }

    fn scores(values: &[f64], lpips: f64) -> Arc<Table> {
        let mut list: Vec<Score> =
            values.iter().enumerate().map(|(l, value)| score("psnr_db", l as i64, *value, "dB")).collect();
        list.push(score("lpips", 0, lpips, ""));
        Arc::new(Table::scores(list, "full frame"))
    }

    fn params(labels: &[&str]) -> Params {
        Params { labels: labels.iter().map(|label| label.to_string()).collect(), ..Params::default() }
    }

    fn write(
        params: Params,
        tables: Vec<Arc<Table>>,
        look: impl FnOnce(Table, Vec<String>, &dyn Fn(&str) -> String),
    ) {
        let node = WriteTable::build(params).unwrap();
        exporting(
            |cx| node.run(In { tables }, cx).unwrap(),
            |out, notes, folder: &Path| {
                look((*out.table).clone(), notes, &|name| std::fs::read_to_string(folder.join(name)).unwrap())
            },
        );
    }

    #[test]
    fn the_best_of_each_column_is_bold_whichever_way_is_better() {
        write(
            Params { decimals: 2, ..params(&["ours", "EDI"]) },
            vec![scores(&[30.0, 32.0], 0.2), scores(&[29.0, 28.0], 0.1)],
            |table, _, file| {
                let text = file("table.md");
                let lines: Vec<&str> = text.lines().take(4).collect();
                assert_eq!(
                    lines,
                    [
                        "| label | psnr_db [dB] | lpips |",
                        "| --- | ---: | ---: |",
                        "| ours | **31.00** | 0.20 |",
                        "| EDI | 28.50 | **0.10** |"
                    ]
                );
                assert!(text.ends_with("Statistic over frames: mean.\n\nfull frame\n"), "{text}");
                assert_eq!(file("table.csv"), "label,psnr_db [dB],lpips\nours,31.0,0.2\nEDI,28.5,0.1\n");
                assert_eq!(table.column("psnr_db [dB]"), Some(&Column::Numbers(vec![31.0, 28.5])));
            },
        );
    }

    #[test]
    fn programs_get_every_frame_and_every_pooled_value() {
        write(params(&["ours"]), vec![scores(&[30.0, f64::INFINITY], 0.25)], |_, _, file| {
            let lines: Vec<Value> =
                file("metrics.jsonl").lines().map(|line| serde_json::from_str(line).unwrap()).collect();
            assert_eq!(lines.len(), 3);
            let expected = json!({
                "variant": "ours", "node": "", "metric": "psnr_db", "frame": 0, "t_ns": 0, "value": 30.0,
                "unit": "dB", "card": "full frame",
            });
            assert_eq!(lines[0], expected);
            assert_eq!(lines[1]["value"], "Infinity");
            let pooled: Value = serde_json::from_str(file("pooled.jsonl").lines().nth(1).unwrap()).unwrap();
            assert_eq!(
                (&pooled["metric"], &pooled["value"], &pooled["frames"]),
                (&json!("lpips"), &json!(0.25), &json!(1))
            );
            let table: Value = serde_json::from_str(&file("table.json")).unwrap();
            assert_eq!(table["columns"][1]["higher_is_better"], false);
            assert_eq!(table["rows"][0]["values"], json!(["Infinity", 0.25]));
        });
    }

    #[test]
    fn frames_without_a_score_are_left_out_and_counted() {
        write(
            params(&["ours", "EDI"]),
            vec![scores(&[30.0, f64::NAN, 40.0], 0.1), scores(&[f64::NAN], f64::NAN)],
            |table, notes, file| {
                let Some(Column::Numbers(psnr)) = table.column("psnr_db [dB]") else {
                    panic!("a column of numbers")
                };
                assert_eq!(psnr[0], 35.0);
                assert!(psnr[1].is_nan());
                assert_eq!(notes.len(), 3);
                assert!(
                    notes.contains(&"1 frames of ours have no psnr_db and were left out".to_string()),
                    "{notes:?}"
                );
                // A single measured method is not the best of its column.
                assert!(file("table.md").contains("| EDI | - | - |") && !file("table.md").contains("**"));
            },
        );
    }

    #[test]
    fn the_scorers_own_mean_wins_and_other_statistics_come_from_the_frames() {
        let list = || {
            let frames = (0..21).map(|l| score("psnr_db", l, 20.0 + l as f64, "dB"));
            Arc::new(Table::scores(frames.chain([score("psnr_db", -1, 28.125, "dB")]).collect(), ""))
        };
        // Of 20, 21 ... 40 the 5th percentile is the second value: a twentieth of the way.
        for (statistic, expected) in
            [(Statistic::Mean, 28.125), (Statistic::Min, 20.0), (Statistic::P05, 21.0)]
        {
            write(Params { statistic, ..params(&["ours"]) }, vec![list()], |table, _, _| {
                assert_eq!(table.column("psnr_db [dB]"), Some(&Column::Numbers(vec![expected])));
            });
        }
        assert_eq!(Statistic::P05.of(vec![1.0, 2.0]), 1.05);
        assert!(Statistic::Min.of(vec![]).is_nan());
    }

    #[test]
    fn metrics_can_be_chosen_and_an_unknown_one_is_named() {
        let chosen = |names: &[&str]| Params {
            metrics: Some(names.iter().map(|name| name.to_string()).collect()),
            ..params(&["ours"])
        };
        write(chosen(&["lpips"]), vec![scores(&[1.0], 0.5)], |table, _, file| {
            assert_eq!(table.columns().len(), 2);
            assert_eq!(file("metrics.jsonl").lines().count(), 1);
        });
        let node = WriteTable::build(chosen(&["ssim"])).unwrap();
        exporting(
            |cx| node.run(In { tables: vec![scores(&[1.0], 0.5)] }, cx).err().unwrap(),
            |error, _, _| {
                assert_eq!(error.message, "no connected table has the metric \"ssim\"");
                assert_eq!(error.hint.as_deref(), Some("there are: psnr_db, lpips"));
            },
        );
    }

    #[test]
    fn labels_must_fit_the_tables_and_the_tables_must_be_scores() {
        let plan = |labels: &[&str], scores: &[bool]| {
            let metas = scores.iter().map(|&scores| Meta::Table(Arc::new(TableMeta { scores }))).collect();
            WriteTable::build(params(labels))
                .unwrap()
                .plan(&PortMetas::new(BTreeMap::from([("tables".to_string(), metas)])))
        };
        assert!(plan(&["a", "b"], &[true, true]).is_ok());
        assert_eq!(
            plan(&["a"], &[true, true]).unwrap_err().message,
            "`labels` has 1 text, and 2 inputs are connected to `tables`"
        );
        assert!(plan(&["a", "a"], &[true, true]).unwrap_err().message.contains("stands twice"));
        assert_eq!(plan(&["a", "b"], &[true, false]).unwrap_err().message, "the table \"b\" holds no scores");
    }

    #[test]
    fn labels_with_commas_and_bars_stay_in_their_cell() {
        write(params(&["a|b, \"c\""]), vec![scores(&[1.0], 0.5)], |_, _, file| {
            assert!(file("table.md").contains("| a\\|b, \"c\" |"));
            assert!(file("table.csv").contains("\n\"a|b, \"\"c\"\"\",1.0,0.5\n"));
        });
    }
}
