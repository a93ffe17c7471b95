//! Numbers: tables of pooled scores with their marks, curves over frames and over an axis, profiles of edges,
//! cards.

use super::run::{Run, Styles};
use crate::args::{Among, Pooled};
use crate::failure::Failure;
use crate::table::formats::{self, Mark as Standing, Style};
use crate::table::grid::{Grid, Request};
use crate::table::records::{Choice, Record, levels_of, read};
use crate::table::{plot, usual_digits};
use photocurrent_core::table::Column;
use photocurrent_core::{Table, Value};
use photocurrent_page::{Card, Cell, Copy, Curve, Mark, Panel, RunPage, Verdict, VerdictRow};
use serde_json::Value as Json;
use std::collections::BTreeMap;
use std::path::PathBuf;

const POOLED: &str = "metrics.pooled.jsonl";
const SINGLE: &str = "metrics.jsonl";

/// The scores of all runs, pooled over frames; empty when there are none.
fn pooled(runs: &[Run]) -> Result<Vec<Record>, Failure> {
    // What was never measured by anybody has no place in a table.
    let has_numbers = |run: &&Run| {
        std::fs::read_to_string(run.folder.join(POOLED)).is_ok_and(|text| text.contains("\"metric\""))
    };
    let folders: Vec<PathBuf> = runs.iter().filter(has_numbers).map(|run| run.folder.clone()).collect();
    let choice = Choice {
        metrics: Vec::new(),
        levels: Vec::new(),
        statistic: Pooled::Value,
        by_frame: false,
        card: Vec::new(),
    };
    if folders.is_empty() { Ok(Vec::new()) } else { read(&folders, &choice) }
}

/// Names that people gave to methods, in place of those of nodes.
fn names(runs: &[Run]) -> BTreeMap<String, String> {
    let mut names: BTreeMap<String, Option<String>> = BTreeMap::new();
    for run in runs {
        for (at, task) in
            run.record.tasks.iter().enumerate().filter(|(_, task)| task.kind.starts_with("score/"))
        {
            let Some(judged) = run.judged(at) else { continue };
            let method =
                task.label.split_once('_').map_or(task.label.as_str(), |(_, method)| method).to_string();
            let label = run.label(judged);
            // A name of two things is no name.
            names
                .entry(method)
                .and_modify(|known| *known = known.take().filter(|known| *known == label))
                .or_insert(Some(label));
        }
    }
    names.into_iter().filter_map(|(method, label)| Some((method, label?))).collect()
}

fn style(runs: &[Run], grid: &Grid) -> Style {
    Style {
        digits: grid.metrics().into_iter().map(|metric| (metric.clone(), usual_digits(&metric))).collect(),
        among: if grid.columns_compare() { Among::Row } else { Among::Column },
        names: names(runs),
    }
}

/// Lays records out: as `photocurrent table` would, with nodes for methods where two scorers share a method's
/// name.
fn laid_out(records: &[Record]) -> Result<Grid, Failure> {
    let request = |rows: &[&str]| Request {
        rows: rows.iter().map(ToString::to_string).collect(),
        columns: Vec::new(),
        sum: false,
    };
    let tries = [request(&[]), request(&["node"]), request(&["file", "node"])];
    let mut last = String::new();
    for request in tries {
        match Grid::new(records, &request) {
            Ok(grid) => return Ok(grid),
            Err(why) => last = why,
        }
    }
    Err(Failure::other(format!("the scores cannot be laid out: {last}")))
}

/// The name of the method that is best in the first column of the verdict.
pub fn best_row(page: &RunPage) -> Option<&str> {
    let rows = page.verdicts.first().map_or(&[][..], |verdict| &verdict.rows);
    rows.iter()
        .find(|row| row.cells.first().is_some_and(|cell| cell.mark == Mark::Best))
        .and_then(|row| row.names.last())
        .map(String::as_str)
}

/// The name of a run's method that is best in the first column of its scores.
pub fn best(run: &Run) -> Result<Option<String>, Failure> {
    let mut page = RunPage::default();
    verdict(std::slice::from_ref(run), &mut page)?;
    Ok(best_row(&page).map(String::from))
}

/// Adds the tables of scores and the metric cards.
pub fn verdict(runs: &[Run], page: &mut RunPage) -> Result<(), Failure> {
    let records = pooled(runs)?;
    if records.is_empty() {
        return Ok(());
    }
    let grid = laid_out(&records)?;
    let style = style(runs, &grid);
    let marks = style.marks(&grid);
    let arrows = [" \u{2191}", " \u{2193}"];
    let level = |axis: &String, level: &String| style.level(&grid, axis, level, arrows);
    let column = |levels: &Vec<String>| {
        let parts: Vec<String> =
            grid.column_axes.iter().zip(levels).map(|(axis, text)| level(axis, text)).collect();
        let only =
            grid.metrics().first().map_or_else(String::new, |metric| style.heading(&grid, metric, arrows));
        if parts.is_empty() { only } else { parts.join(", ") }
    };
    let cell = |row: usize, at: usize| {
        let cell = grid.cells[row][at].as_ref();
        let why = cell.and_then(|cell| cell.missing.as_ref()).map(|(_, why)| why.clone());
        let mark = match marks[row][at] {
            // What nobody asked for is no failure.
            _ if cell.is_some_and(|cell| cell.value.is_nan()) => Mark::Missing,
            Standing::Best => Mark::Best,
            Standing::Second => Mark::Second,
            Standing::Plain => Mark::Plain,
        };
        let digits =
            cell.map(|cell| format!("{} {}", cell.value, cell.unit)).filter(|_| mark != Mark::Missing);
        Cell { text: style.show(cell), mark, title: why.or(digits).unwrap_or_default() }
    };
    let rows = grid.rows.iter().enumerate().map(|(row, levels)| VerdictRow {
        names: grid.row_axes.iter().zip(levels).map(|(axis, text)| level(axis, text)).collect(),
        cells: (0..grid.columns.len()).map(|at| cell(row, at)).collect(),
    });
    let copy = |name: &str, text: String| Copy { name: name.into(), text };
    page.verdicts.push(Verdict {
        caption: "Scores, pooled over frames".into(),
        names: grid.row_axes.iter().map(|axis| style.name(axis).to_string()).collect(),
        columns: grid.columns.iter().map(column).collect(),
        rows: rows.collect(),
        copies: vec![
            copy("Markdown", formats::markdown(&grid, &style)),
            copy("LaTeX", formats::latex(&grid, &style)),
            copy("CSV", formats::csv(&grid, &style)),
            copy("JSON Lines", formats::json_lines(&grid, &style)),
        ],
    });
    page.cards = cards(&records, &style);
    Ok(())
}

/// Each card once, with the metrics that it is about and the methods that it was used for.
fn cards(records: &[Record], style: &Style) -> Vec<Card> {
    let mut texts: Vec<&str> = Vec::new();
    for record in records.iter().filter(|record| !record.card.is_empty()) {
        if !texts.contains(&record.card.as_str()) {
            texts.push(&record.card);
        }
    }
    let card = |card: &str| {
        let own: Vec<Record> = records.iter().filter(|record| record.card == card).cloned().collect();
        let methods: Vec<String> =
            levels_of(&own, "method").iter().map(|method| style.name(method).to_string()).collect();
        let (definition, fields) = card.split_once(": ").unwrap_or((card, ""));
        let pairs = fields
            .split("; ")
            .filter_map(|pair| pair.split_once(" = "))
            .map(|(key, text)| (key.to_string(), text.to_string()));
        Card {
            metrics: format!("{} of {}", levels_of(&own, "metric").join(", "), methods.join(", ")),
            definition: definition.to_string(),
            fields: pairs.collect(),
        }
    };
    texts.into_iter().map(card).collect()
}

/// Adds the scores of single frames as curves: a panel for each metric and run.
pub fn curves(runs: &[Run], styles: &mut Styles, page: &mut RunPage) -> Result<(), Failure> {
    for run in runs {
        let path = run.folder.join(SINGLE);
        let Ok(text) = std::fs::read_to_string(&path) else { continue };
        let mut panels: Vec<(String, Panel)> = Vec::new();
        for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            let wrong = |what: String| Failure::Other {
                message: format!("{}:{}: {what}\n  hint: run the manifest again", path.display(), number + 1),
                code: 2,
            };
            let line: Json =
                serde_json::from_str(line).map_err(|error| wrong(format!("no JSON: {error}")))?;
            let text = |key: &str| line[key].as_str().ok_or_else(|| wrong(format!("no `{key}`")));
            let (metric, node) = (text("metric")?, text("node")?);
            let Some(variant) = run.variants().find(|variant| variant.name == line["variant"]) else {
                continue;
            };
            let scorer = variant.nodes.iter().find(|(name, _)| name == node).map(|(_, task)| *task);
            let judged = scorer
                .and_then(|scorer| run.judged(scorer))
                .or_else(|| scorer.and_then(|scorer| judged_by_scores(run, scorer)));
            let label = judged.map_or_else(|| node.to_string(), |judged| run.label_in(judged, variant));
            let unit = text("unit")?;
            let at = panels.iter().position(|(known, _)| known == metric).unwrap_or_else(|| {
                let several = if runs.len() > 1 { format!(", {}", run.name) } else { String::new() };
                let y = if unit.is_empty() { metric.to_string() } else { format!("{metric} [{unit}]") };
                panels.push((
                    metric.into(),
                    Panel {
                        title: format!("{metric}{several}"),
                        x: "time [ms]".into(),
                        y,
                        is_time: true,
                        ..Panel::default()
                    },
                ));
                panels.len() - 1
            });
            let series = &mut panels[at].1.series;
            // Two scorers of one sequence with one metric (another region, say) are two curves.
            let name = |series: &[Curve]| match series
                .iter()
                .any(|one| one.label == label && one.points.iter().any(|(t, _)| *t == ms(&line)))
            {
                true => format!("{label}, {node}"),
                false => label.clone(),
            };
            let name = name(series);
            if !series.iter().any(|one| one.label == name) {
                series.push(Curve { label: name.clone(), style: styles.of(&label), ..Curve::default() });
            }
            if let Some(one) = series.iter_mut().find(|one| one.label == name) {
                one.points.push((ms(&line), line["value"].as_f64().map(rounded)));
            }
        }
        page.curves.extend(
            panels
                .into_iter()
                .map(|(_, panel)| panel)
                .filter(|panel| panel.series.iter().any(|one| one.points.len() > 1)),
        );
    }
    page.has_glitch = page.curves.iter().any(|panel| panel.title.contains("glitch"));
    Ok(())
}

/// What a scorer of scores judges in the end.
fn judged_by_scores(run: &Run, scorer: usize) -> Option<&super::run::Output> {
    run.judged(run.inputs(scorer, "scores").first()?.0)
}

fn ms(line: &Json) -> f64 {
    line["t_ns"].as_f64().unwrap_or(0.0) / 1e6
}

/// Six digits that count: enough for a curve, and a smaller page.
fn rounded(value: f64) -> f64 {
    format!("{value:.5e}").parse().unwrap_or(value)
}

/// Adds what is drawn over something else than time: profiles of edges, and scores over an axis of numbers.
pub fn edges(runs: &[Run], styles: &mut Styles, page: &mut RunPage) -> Result<(), Failure> {
    let records = pooled(runs)?;
    let axes: Vec<String> = runs
        .iter()
        .flat_map(|run| &run.record.axes)
        .map(|(axis, _)| axis.rsplit('.').next().unwrap_or(axis).to_string())
        .collect();
    for axis in axes.iter().filter(|axis| levels_of(&records, axis).len() > 1) {
        let Ok(grid) =
            Grid::new(&records, &Request { rows: vec![axis.clone()], columns: Vec::new(), sum: false })
        else {
            continue;
        };
        // An axis whose levels are words has no place in a figure.
        let Ok(figure) = plot::figure(&grid, &style(runs, &grid)) else { continue };
        page.edges.extend(figure.panels.into_iter().map(|panel| {
            Panel {
                title: format!("{} over {axis}", panel.y_label),
                x: panel.x_label,
                y: panel.y_label,
                series: panel
                    .series
                    .into_iter()
                    .map(|one| Curve {
                        style: styles.of(&one.label),
                        dots: true,
                        points: one
                            .points
                            .into_iter()
                            .map(|(x, y)| (x, y.is_finite().then_some(y)))
                            .collect(),
                        label: if one.label.is_empty() { "value".into() } else { one.label },
                        ..Curve::default()
                    })
                    .collect(),
                ..Panel::default()
            }
        }));
    }
    let mut has_scorer = false;
    for run in runs {
        let mut panel = Panel {
            title: "Edge spread functions".into(),
            x: "distance [px]".into(),
            y: "share of contrast".into(),
            ..Panel::default()
        };
        for variant in run.variants() {
            for (at, task) in run.tasks(variant).filter(|(_, task)| task.kind == "score/bew") {
                has_scorer = true;
                let label =
                    run.judged(at).map_or_else(|| task.label.clone(), |judged| run.label_in(judged, variant));
                match run.value(&(at, "profiles".into())) {
                    Ok(Value::Table(table)) => {
                        panel.series.extend(profile(&table, &label, styles.of(&label)))
                    }
                    _ => page.edge_notes.push(format!(
                        "The profiles of `{0}` were not stored: write `pipeline.keep = [\"{0}.profiles\"]` \
                         into the manifest and run it again.",
                        task.label
                    )),
                }
            }
        }
        if !panel.series.is_empty() {
            page.edges.push(panel);
        }
    }
    page.edge_notes.dedup();
    if !has_scorer && page.edges.is_empty() {
        page.edge_notes.push(
            "No edges were measured: `score/bew` measures the width of edges that are \
                              stated, without a truth, and an ablation with numbers as levels draws it over \
                              speed or light."
                .into(),
        );
    }
    Ok(())
}

/// The profile of the first edge: that of all frames together where there is one, else of the first frame.
fn profile(table: &Table, label: &str, style: usize) -> Option<Curve> {
    let (Column::Integers(frames), Column::Integers(edges), Column::Numbers(x), Column::Numbers(y)) = (
        table.column("frame")?,
        table.column("edge")?,
        table.column("distance_px")?,
        table.column("share_of_contrast")?,
    ) else {
        return None;
    };
    let (frame, edge) = (*frames.iter().min()?, *edges.iter().min()?);
    let rows = (0..table.len()).filter(|&row| frames[row] == frame && edges[row] == edge);
    Some(Curve {
        label: label.into(),
        style,
        points: rows.map(|row| (x[row], y[row].is_finite().then_some(y[row]))).collect(),
        ..Curve::default()
    })
}
