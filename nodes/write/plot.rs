//! `write/plot`: curves of several tables over each other, as SVG and PNG.
//!
//! Scores become a metric over time (the paper's Fig. 7: PSNR frame by frame). Other tables are drawn by
//! column: a pixel and its truth (Fig. 8, `score/pixel_error.pixels`), an edge's profile (Fig. 10(i),
//! `score/bew.profiles`). Columns of nanoseconds are drawn in milliseconds.
//!
//! Files: `plot.svg`, `plot.png` with twice the pixels, and `points.csv`, what was drawn with all digits. A
//! value that was not measured is a gap.
//!
//! Limits: one pair of axes; what runs over the variants of an ablation (an edge's width over speed) is drawn
//! by `photocurrent table --plot`.

use super::figure::{Figure, Panel, Series};
use photocurrent_core::table::{Column, TableMeta};
use photocurrent_core::{Context, Decl, Grain, Meta, Node, NodeError, PortMetas, Table};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Parameters of `write/plot`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Names of the curves: one text for each connected table, in the same order, all different.
    pub labels: Vec<String>,
    /// Text above the axes.
    pub title: String,
    /// Which metric of scores is drawn over time. Default: the first one met.
    pub metric: Option<String>,
    /// Column to the right, of tables that are no scores.
    pub x: String,
    /// Column upwards, of tables that are no scores.
    pub y: Option<String>,
    /// Column upwards of a black curve, taken from the first table: what the others should be. Absent = none.
    pub reference: Option<String>,
    /// Only rows with these whole numbers, by column, such as `{ frame = 12, edge = 0 }`. Empty = all rows.
    pub only: BTreeMap<String, i64>,
    /// Text next to the axis upwards. Default: the metric with its unit, or the column.
    pub y_label: Option<String>,
    /// Pixels of `plot.svg`.
    #[schemars(range(min = 200, max = 4000))]
    pub width: u32,
    /// Pixels of `plot.svg`.
    #[schemars(range(min = 150, max = 4000))]
    pub height: u32,
}

impl Default for Params {
    fn default() -> Params {
        Params {
            labels: Vec::new(),
            title: String::new(),
            metric: None,
            x: "t_ns".into(),
            y: None,
            reference: None,
            only: BTreeMap::new(),
            y_label: None,
            width: 720,
            height: 360,
        }
    }
}

photocurrent_core::ports! {
    /// What is drawn.
    pub struct In {
        /// One table for each curve: scores, or others with equal columns.
        tables: Vec<Arc<Table>>,
    }
}

photocurrent_core::ports! {
    /// The result.
    pub struct Out {
        /// What was drawn: `curve`, `x`, `y`, a row for each point.
        points: Arc<Table>,
    }
}

/// The node.
pub struct WritePlot {
    params: Params,
}

impl Node for WritePlot {
    const DECL: Decl = Decl {
        kind: "write/plot",
        about: "Draws scores over time, or columns of other tables, as curves: SVG, PNG, CSV.",
        revision: 2,
        grain: Grain::Whole,
        draws: false,
        exports: true,
        sources: &["Jiang et al., CVPR 2024, Figs. 7, 8 and 10(i)", "colours of Okabe and Ito, 2008"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.split]
kind = "split/frames"
in   = { frames = "recording.frames" }

[nodes.scores]
kind = "score/heldout"
in   = { frames = "split.held", held = "split.held" }

[nodes.curves]
kind   = "write/plot"
in     = { tables = ["scores"] }
params = { labels = ["itself"], metric = "heldout_psnr_db" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if params.metric.is_some() && params.y.is_some() {
            return Err(NodeError::usage(
                "`metric` and `y` are both stated: the one is for scores, the other for tables of columns",
            )
            .hint("leave one of them out")
            .param("y"));
        }
        Ok(WritePlot { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let tables = inputs.all("tables");
        super::check_labels(&self.params.labels, tables.len(), "tables")?;
        for (label, meta) in self.params.labels.iter().zip(tables) {
            let Meta::Table(meta) = meta else { continue };
            if self.params.metric.is_some() && !meta.scores {
                return Err(NodeError::usage(format!(
                    "the table \"{label}\" holds no scores, and `metric` is stated"
                ))
                .hint("connect the scores of a scorer, or name a column with `y`")
                .param("metric"));
            }
            if self.params.y.is_none() && !meta.scores {
                return Err(NodeError::usage(format!(
                    "the table \"{label}\" holds no scores: which column is drawn?"
                ))
                .hint("name a column: y = \"v_dc\"")
                .param("y"));
            }
        }
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: false }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let folder = cx.export_dir()?;
        let panel = self.panel(&input.tables)?;
        let gaps =
            panel.series.iter().flat_map(|series| &series.points).filter(|(_, y)| !y.is_finite()).count();
        cx.count(gaps as u64, "values were not measured and are gaps");
        let points = Table::default()
            .with(
                "curve",
                Column::Texts(
                    panel
                        .series
                        .iter()
                        .flat_map(|series| series.points.iter().map(|_| series.label.clone()))
                        .collect(),
                ),
            )
            .with(
                "x",
                Column::Numbers(
                    panel
                        .series
                        .iter()
                        .flat_map(|series| series.points.iter().map(|point| point.0))
                        .collect(),
                ),
            )
            .with(
                "y",
                Column::Numbers(
                    panel
                        .series
                        .iter()
                        .flat_map(|series| series.points.iter().map(|point| point.1))
                        .collect(),
                ),
            )
            .note("x", panel.x_label.as_str())
            .note("y", panel.y_label.as_str());
        let csv = csv(&panel);
        let figure = Figure { panels: vec![panel], width: self.params.width, height: self.params.height };
        super::save(&folder.join("plot.svg"), figure.svg().map_err(NodeError::failed)?.as_bytes())?;
        super::save(&folder.join("plot.png"), &figure.png().map_err(NodeError::failed)?)?;
        super::save(&folder.join("points.csv"), csv.as_bytes())?;
        Ok(Out { points: Arc::new(points) })
    }
}

impl WritePlot {
    fn panel(&self, tables: &[Arc<Table>]) -> Result<Panel, NodeError> {
        super::check_labels(&self.params.labels, tables.len(), "tables")?;
        let mut series = Vec::new();
        let y_label = match &self.params.y {
            Some(y) => {
                if let (Some(reference), Some(table)) = (&self.params.reference, tables.first()) {
                    series.push(Series {
                        label: "truth".into(),
                        points: self.columns(table, reference, "reference")?,
                        is_reference: true,
                    });
                }
                for (label, table) in self.params.labels.iter().zip(tables) {
                    series.push(Series {
                        label: label.clone(),
                        points: self.columns(table, y, "y")?,
                        is_reference: false,
                    });
                }
                y.clone()
            }
            None => {
                let (metric, unit) = self.metric(tables)?;
                for (label, table) in self.params.labels.iter().zip(tables) {
                    let scores = table.as_scores().unwrap_or_default();
                    let frames = scores.iter().filter(|score| score.frame >= 0 && score.metric == metric);
                    let points = frames.map(|score| (score.t_ns as f64 * 1e-6, score.value)).collect();
                    series.push(Series { label: label.clone(), points, is_reference: false });
                }
                if unit.is_empty() { metric } else { format!("{metric} [{unit}]") }
            }
        };
        Ok(Panel {
            title: self.params.title.clone(),
            x_label: if self.params.y.is_none() { "time [ms]".into() } else { axis_name(&self.params.x) },
            y_label: self.params.y_label.clone().unwrap_or(y_label),
            is_log: false,
            series,
        })
    }

    /// The metric that is drawn, and its unit.
    fn metric(&self, tables: &[Arc<Table>]) -> Result<(String, String), NodeError> {
        let mut met: Vec<(String, String)> = Vec::new();
        for score in
            tables.iter().filter_map(|table| table.as_scores()).flatten().filter(|score| score.frame >= 0)
        {
            if !met.iter().any(|(name, _)| *name == score.metric) {
                met.push((score.metric, score.unit));
            }
        }
        let found = met
            .iter()
            .find(|(name, _)| self.params.metric.as_ref().is_none_or(|asked| asked == name))
            .cloned();
        found.ok_or_else(|| {
            let names: Vec<&str> = met.iter().map(|(name, _)| name.as_str()).collect();
            let what = self
                .params
                .metric
                .as_deref()
                .map_or("no connected table has a score of a single frame".into(), |metric| {
                    format!("no connected table has frames with the metric \"{metric}\"")
                });
            NodeError::input(what).hint(format!("there are: {}", names.join(", "))).param("metric")
        })
    }

    /// A column over `x`, rows as `only` says.
    fn columns(&self, table: &Table, y: &str, parameter: &str) -> Result<Vec<(f64, f64)>, NodeError> {
        let column = |name: &str, parameter: &str| {
            table.column(name).ok_or_else(|| {
                let names: Vec<&str> = table.columns().iter().map(|(name, _)| name.as_str()).collect();
                NodeError::input(format!("the table has no column \"{name}\""))
                    .hint(format!("there are: {}", names.join(", ")))
                    .param(parameter)
            })
        };
        let numbers = |name: &str, parameter: &str| match column(name, parameter)? {
            Column::Numbers(values) => Ok(values.clone()),
            Column::Integers(values) => Ok(values.iter().map(|value| *value as f64).collect()),
            Column::Texts(_) => {
                Err(NodeError::input(format!("the column \"{name}\" holds texts, and no numbers"))
                    .param(parameter))
            }
        };
        let mut kept = vec![true; table.len()];
        for (name, wanted) in &self.params.only {
            let values = numbers(name, "only")?;
            kept.iter_mut().zip(&values).for_each(|(kept, value)| *kept &= *value == *wanted as f64);
        }
        if !kept.contains(&true) {
            return Err(NodeError::input("no row has what `only` asks for")
                .hint("leave an entry out, or look at the numbers in the table")
                .param("only"));
        }
        let scale = if self.params.x.ends_with("_ns") { 1e-6 } else { 1.0 };
        let (xs, ys) = (numbers(&self.params.x, "x")?, numbers(y, parameter)?);
        Ok(xs
            .iter()
            .zip(&ys)
            .zip(&kept)
            .filter(|(_, kept)| **kept)
            .map(|((x, y), _)| (x * scale, *y))
            .collect())
    }
}

/// A column's name as the text of an axis.
fn axis_name(column: &str) -> String {
    match column.strip_suffix("_ns") {
        Some("t") => "time [ms]".into(),
        Some(name) => format!("{name} [ms]"),
        None => column.strip_suffix("_px").map_or(column.into(), |name| format!("{name} [px]")),
    }
}

/// What was drawn, all digits; an empty field where nothing was measured.
fn csv(panel: &Panel) -> String {
    let field = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    let number = |value: f64| if value.is_nan() { String::new() } else { format!("{value:?}") };
    let mut text = format!("curve,{},{}\n", field(&panel.x_label), field(&panel.y_label));
    for series in &panel.series {
        for (x, y) in &series.points {
            text += &format!("{},{},{}\n", field(&series.label), number(*x), number(*y));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::testing::exporting;
    use super::*;
    use photocurrent_core::table::Score;
    use std::path::Path;

    fn scores(values: &[f64]) -> Arc<Table> {
        let score = |l: usize, value: f64| Score {
            metric: "psnr_db".into(),
            frame: l as i64,
            t_ns: l as i64 * 10_000_000,
            value,
            unit: "dB".into(),
        };
        let pooled = Score { frame: -1, ..score(0, 99.0) };
        Arc::new(Table::scores(
            values.iter().enumerate().map(|(l, value)| score(l, *value)).chain([pooled]).collect(),
            "a card",
        ))
    }

    fn params(labels: &[&str]) -> Params {
        Params {
            labels: labels.iter().map(ToString::to_string).collect(),
            title: "Fan".into(),
            ..Params::default()
        }
    }

    fn plot(params: Params, tables: Vec<Arc<Table>>, look: impl FnOnce(&Table, Vec<String>, &Path)) {
        let node = WritePlot::build(params).unwrap();
        exporting(
            |cx| node.run(In { tables }, cx).unwrap(),
            |out, notes, folder| look(&out.points, notes, folder),
        );
    }

    /// The points of every polyline of a colour.
    fn polylines(svg: &str, colour: &str) -> Vec<Vec<(f64, f64)>> {
        let lines = svg
            .lines()
            .filter(|line| line.starts_with("<polyline") && line.contains(&format!("stroke=\"{colour}\"")));
        let points = |line: &str| {
            line.split("points=\"").nth(1).unwrap().split('"').next().unwrap().trim().to_string()
        };
        let place =
            |pair: &str| pair.split_once(',').map(|(x, y)| (x.parse().unwrap(), y.parse().unwrap())).unwrap();
        lines.map(|line| points(line).split(' ').map(place).collect()).collect()
    }

    /// Where the tick with this text stands: (x, y) of the text.
    fn text_at(svg: &str, text: &str) -> Vec<(f64, f64)> {
        let lines: Vec<&str> = svg.lines().collect();
        let number = |line: &str, name: &str| {
            line.split(&format!(" {name}=\"")).nth(1).unwrap().split('"').next().unwrap().parse().unwrap()
        };
        lines
            .windows(2)
            .filter(|pair| pair[1].trim_end() == text && pair[0].starts_with("<text"))
            .map(|pair| (number(pair[0], "x"), number(pair[0], "y")))
            .collect()
    }

    const BLUE: &str = "#0072B2";
    const RED: &str = "#D55E00";

    #[test]
    fn colours_that_recur_are_dashed_and_the_legend_covers_no_curve() {
        let labels = ["a", "b", "c", "d", "e", "f", "g", "h"];
        let tables = (0..8).map(|n| scores(&[20.0, 20.0 + f64::from(n), 30.0])).collect();
        plot(params(&labels), tables, |_, _, folder| {
            let svg = std::fs::read_to_string(folder.join("plot.svg")).unwrap();
            let (blue, red) = (polylines(&svg, BLUE), polylines(&svg, RED));
            let right = red.iter().find(|line| line.len() == 3).unwrap()[2].0;
            // The first and the eighth: a curve of three points, and one of dashes, of which one may bend at
            // the middle point; with a whole and a dashed sample.
            assert_eq!(blue.iter().filter(|line| line.len() == 3 && line[2].0 == right).count(), 1);
            assert!(blue.len() > 20 && red.len() == 2, "{} and {}", blue.len(), red.len());
            for label in labels {
                let [(x, _)] = text_at(&svg, label)[..] else { panic!("`{label}` stands in the legend") };
                assert!(x > right, "`{label}` at {x}, curves end at {right}");
            }
        });
    }

    #[test]
    fn a_curve_goes_through_its_points_as_the_ticks_say() {
        plot(
            params(&["ours", "EDI"]),
            vec![scores(&[20.0, 25.0, 30.0]), scores(&[22.0, 22.0, 22.0])],
            |table, _, folder| {
                let svg = std::fs::read_to_string(folder.join("plot.svg")).unwrap();
                let (ours, edi) = (polylines(&svg, BLUE), polylines(&svg, RED));
                // One of each is the curve, the other its sample in the legend.
                let curve =
                    |lines: &[Vec<(f64, f64)>]| lines.iter().find(|line| line.len() == 3).cloned().unwrap();
                assert_eq!((ours.len(), edi.len()), (2, 2));
                let (ours, edi) = (curve(&ours), curve(&edi));
                // The middle of three points on a straight line is in the middle, give or take a rounding.
                assert!(
                    (ours[1].0 - 0.5 * (ours[0].0 + ours[2].0)).abs() <= 1.0
                        && (ours[1].1 - 0.5 * (ours[0].1 + ours[2].1)).abs() <= 1.0,
                    "{ours:?}"
                );
                assert!(ours[2].1 < ours[0].1, "more is above");
                assert_eq!(edi[0].1, edi[2].1);
                // Points stand at the ticks that have their value: 10 ms below, 22 dB to the left.
                assert!(text_at(&svg, "10").iter().any(|(x, _)| (x - ours[1].0).abs() <= 1.0));
                assert!(text_at(&svg, "22").iter().any(|(_, y)| (y - edi[0].1).abs() <= 1.0));
                for text in ["time [ms]", "psnr_db [dB]", "Fan", "ours", "EDI"] {
                    assert_eq!(text_at(&svg, text).len(), 1, "{text}");
                }
                assert_eq!(table.column("x"), Some(&Column::Numbers(vec![0.0, 10.0, 20.0, 0.0, 10.0, 20.0])));
            },
        );
    }

    #[test]
    fn the_picture_has_twice_the_pixels_and_the_same_bytes_each_time() {
        let mut files = Vec::new();
        for _ in 0..2 {
            plot(
                Params { width: 400, height: 200, ..params(&["ours"]) },
                vec![scores(&[20.0, 30.0])],
                |_, _, folder| {
                    let (values, info) = super::super::picture::load(&folder.join("plot.png"));
                    assert_eq!((info.width, info.height), (800, 400));
                    assert!(values.chunks(3).any(|pixel| pixel == [0, 114, 178]), "a curve in its colour");
                    files.push(
                        ["plot.svg", "plot.png", "points.csv"]
                            .map(|file| std::fs::read(folder.join(file)).unwrap()),
                    );
                },
            );
        }
        assert_eq!(files[0], files[1]);
    }

    #[test]
    fn what_was_not_measured_is_a_gap() {
        plot(params(&["ours"]), vec![scores(&[20.0, 21.0, f64::NAN, 23.0, 24.0])], |_, notes, folder| {
            let svg = std::fs::read_to_string(folder.join("plot.svg")).unwrap();
            assert_eq!(polylines(&svg, BLUE).iter().map(Vec::len).collect::<Vec<_>>(), [2, 2]);
            assert_eq!(notes, ["1 values were not measured and are gaps"]);
            let csv = std::fs::read_to_string(folder.join("points.csv")).unwrap();
            assert_eq!(csv.lines().nth(3), Some("\"ours\",20.0,"));
        });
    }

    fn pixels() -> Arc<Table> {
        let integers = |values: [i64; 4]| Column::Integers(values.to_vec());
        let numbers = |values: [f64; 4]| Column::Numbers(values.to_vec());
        let table = Table::default()
            .with("x", integers([5, 6, 5, 6]))
            .with("t_ns", integers([0, 0, 2_000_000, 2_000_000]));
        Arc::new(
            table
                .with("v_dc", numbers([1.0, 7.0, 2.0, 8.0]))
                .with("v_dc_true", numbers([1.5, 7.5, 2.5, 8.5])),
        )
    }

    #[test]
    fn columns_are_drawn_with_their_truth_for_the_rows_asked_for() {
        let params = Params {
            y: Some("v_dc".into()),
            reference: Some("v_dc_true".into()),
            only: [("x".to_string(), 6)].into(),
            ..params(&["ours"])
        };
        plot(params, vec![pixels()], |table, _, folder| {
            assert_eq!(
                table.column("curve"),
                Some(&Column::Texts(["truth", "truth", "ours", "ours"].map(String::from).to_vec()))
            );
            assert_eq!(table.column("x"), Some(&Column::Numbers(vec![0.0, 2.0, 0.0, 2.0])));
            assert_eq!(table.column("y"), Some(&Column::Numbers(vec![7.5, 8.5, 7.0, 8.0])));
            let svg = std::fs::read_to_string(folder.join("plot.svg")).unwrap();
            assert_eq!((text_at(&svg, "time [ms]").len(), text_at(&svg, "v_dc").len()), (1, 1));
        });
    }

    #[test]
    fn an_unknown_metric_column_or_row_is_reported_with_what_there_is() {
        let run = |params: Params, table: Arc<Table>, look: &dyn Fn(NodeError)| {
            let node = WritePlot::build(params).unwrap();
            exporting(
                |cx| node.run(In { tables: vec![table] }, cx).err().unwrap(),
                |error, _, _| look(error),
            );
        };
        run(Params { metric: Some("ssim".into()), ..params(&["a"]) }, scores(&[1.0]), &|error| {
            assert_eq!(error.message, "no connected table has frames with the metric \"ssim\"");
            assert_eq!(error.hint.as_deref(), Some("there are: psnr_db"));
        });
        run(Params { y: Some("v".into()), ..params(&["a"]) }, pixels(), &|error| {
            assert_eq!(error.message, "the table has no column \"v\"");
            assert_eq!(error.hint.as_deref(), Some("there are: x, t_ns, v_dc, v_dc_true"));
        });
        run(
            Params { y: Some("v_dc".into()), only: [("x".to_string(), 9)].into(), ..params(&["a"]) },
            pixels(),
            &|error| {
                assert_eq!(error.message, "no row has what `only` asks for");
            },
        );
    }

    #[test]
    fn a_table_without_scores_needs_a_column() {
        let plan = |params: Params, scores: bool| {
            let metas = vec![Meta::Table(Arc::new(TableMeta { scores }))];
            WritePlot::build(params)
                .unwrap()
                .plan(&PortMetas::new(BTreeMap::from([("tables".to_string(), metas)])))
        };
        assert!(plan(params(&["a"]), true).is_ok());
        assert_eq!(
            plan(params(&["a"]), false).unwrap_err().message,
            "the table \"a\" holds no scores: which column is drawn?"
        );
        assert!(
            plan(Params { metric: Some("psnr_db".into()), ..params(&["a"]) }, false)
                .unwrap_err()
                .message
                .contains("`metric` is stated")
        );
        assert!(plan(params(&["a", "b"]), true).is_err());
        assert!(
            WritePlot::build(Params { metric: Some("m".into()), y: Some("y".into()), ..params(&["a"]) })
                .is_err()
        );
    }
}
