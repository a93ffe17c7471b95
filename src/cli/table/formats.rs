//! A grid as Markdown, CSV, LaTeX (booktabs) and JSON Lines.

use super::grid::{Cell, Grid};
use crate::args::Among;
use photocurrent_core::table::higher_is_better;
use serde_json::json;
use std::collections::BTreeMap;

/// How numbers and names are shown.
pub struct Style {
    /// Digits after the point, by metric.
    pub digits: BTreeMap<String, usize>,
    /// Among which cells the best is marked.
    pub among: Among,
    /// Other texts for names.
    pub names: BTreeMap<String, String>,
}

/// What a cell is among its kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// Nothing special.
    Plain,
    /// The best.
    Best,
    /// The second, of three or more.
    Second,
}

impl Style {
    /// A cell as text.
    pub fn show(&self, cell: Option<&Cell>) -> String {
        match cell {
            Some(cell) if !cell.value.is_nan() => {
                format!("{:.*}", self.digits.get(&cell.metric).copied().unwrap_or(3), cell.value)
            }
            Some(Cell { missing: Some((name, _)), .. }) => format!("no {name}"),
            _ => "-".into(),
        }
    }

    /// The text for a name.
    pub fn name<'a>(&'a self, name: &'a str) -> &'a str {
        self.names.get(name).map_or(name, String::as_str)
    }

    /// A metric's heading with its unit and an arrow that says which way is better.
    pub fn heading(&self, grid: &Grid, metric: &str, arrows: [&str; 2]) -> String {
        let unit = grid
            .cells
            .iter()
            .flatten()
            .flatten()
            .find(|cell| cell.metric == metric)
            .map_or("", |cell| cell.unit.as_str());
        let mut text = self.name(metric).to_string();
        if !unit.is_empty() && text == metric {
            text += &format!(" [{unit}]");
        }
        match higher_is_better(metric) {
            Some(true) => text + arrows[0],
            Some(false) => text + arrows[1],
            None => text,
        }
    }

    /// A level of an axis as text; metrics with their unit and direction.
    pub fn level(&self, grid: &Grid, axis: &str, level: &str, arrows: [&str; 2]) -> String {
        if axis == "metric" { self.heading(grid, level, arrows) } else { self.name(level).into() }
    }

    /// The marks of all cells. Cells that print alike are marked alike; one alone is not the best of
    /// anything, and of two the other is not marked.
    pub fn marks(&self, grid: &Grid) -> Vec<Vec<Mark>> {
        let mut marks = vec![vec![Mark::Plain; grid.columns.len()]; grid.rows.len()];
        let group = |row: usize, column: usize, cell: &Cell| match self.among {
            Among::Row => Some((row, cell.metric.clone())),
            Among::Column => Some((column, cell.metric.clone())),
            Among::None => None,
        };
        let mut groups: BTreeMap<(usize, String), Vec<(usize, usize)>> = BTreeMap::new();
        for (row, cells) in grid.cells.iter().enumerate() {
            for (column, cell) in cells.iter().enumerate() {
                if let Some(cell) = cell.as_ref().filter(|cell| !cell.value.is_nan())
                    && let Some(key) = group(row, column, cell)
                {
                    groups.entry(key).or_default().push((row, column));
                }
            }
        }
        for ((_, metric), members) in groups.iter().filter(|(_, members)| members.len() > 1) {
            let Some(higher) = higher_is_better(metric) else { continue };
            let mut values: Vec<(f64, String)> = members
                .iter()
                .filter_map(|&(r, c)| grid.cells[r][c].as_ref())
                .map(|cell| (cell.value, self.show(Some(cell))))
                .collect();
            values.sort_by(|a, b| if higher { b.0.total_cmp(&a.0) } else { a.0.total_cmp(&b.0) });
            let mut texts: Vec<String> = values.into_iter().map(|(_, text)| text).collect();
            texts.dedup();
            for &(row, column) in members {
                let text = self.show(grid.cells[row][column].as_ref());
                if text == texts[0] {
                    marks[row][column] = Mark::Best;
                } else if members.len() > 2 && text == texts[1] {
                    marks[row][column] = Mark::Second;
                }
            }
        }
        marks
    }
}

/// A Markdown table: the best in bold, the second underlined; below it, how the numbers were measured.
pub fn markdown(grid: &Grid, style: &Style) -> String {
    let escape = |text: &str| text.replace('|', "\\|");
    let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
    let head = |column: &Vec<String>| {
        let levels = grid
            .column_axes
            .iter()
            .zip(column)
            .map(|(axis, level)| style.level(grid, axis, level, [" ↑", " ↓"]));
        escape(&levels.collect::<Vec<_>>().join(", "))
    };
    let marks = style.marks(grid);
    let mut text = line(
        grid.row_axes
            .iter()
            .map(|axis| escape(style.name(axis)))
            .chain(grid.columns.iter().map(head))
            .collect(),
    );
    text += &line(
        grid.row_axes
            .iter()
            .map(|_| "---".to_string())
            .chain(grid.columns.iter().map(|_| "---:".to_string()))
            .collect(),
    );
    for (row, levels) in grid.rows.iter().enumerate() {
        let names = grid
            .row_axes
            .iter()
            .zip(levels)
            .map(|(axis, level)| escape(&style.level(grid, axis, level, [" ↑", " ↓"])));
        let cells = grid.cells[row].iter().zip(&marks[row]).map(|(cell, mark)| {
            match (style.show(cell.as_ref()), mark) {
                (text, Mark::Plain) => text,
                (text, Mark::Best) => format!("**{text}**"),
                (text, Mark::Second) => format!("<u>{text}</u>"),
            }
        });
        text += &line(names.chain(cells).collect());
    }
    if !grid.column_axes.iter().chain(&grid.row_axes).any(|axis| axis == "metric") {
        let metrics: Vec<String> = grid
            .metrics()
            .iter()
            .map(|metric| style.heading(grid, metric, [", higher is better", ", lower is better"]))
            .collect();
        text += &format!("\n{}.\n", metrics.join("; "));
    }
    for (name, why) in grid.missing() {
        text += &format!("\nno {}: {}.\n", escape(name), escape(why));
    }
    text
}

/// Comma-separated values: all digits, no marks, empty where nothing was measured.
pub fn csv(grid: &Grid, style: &Style) -> String {
    let field = |text: &str| {
        if text.contains([',', '"', '\n', '\r']) {
            format!("\"{}\"", text.replace('"', "\"\""))
        } else {
            text.to_string()
        }
    };
    let head = |column: &Vec<String>| {
        field(&column.iter().map(|level| style.name(level)).collect::<Vec<_>>().join(" "))
    };
    let mut text = grid
        .row_axes
        .iter()
        .map(|axis| field(style.name(axis)))
        .chain(grid.columns.iter().map(head))
        .collect::<Vec<_>>()
        .join(",")
        + "\n";
    for (levels, cells) in grid.rows.iter().zip(&grid.cells) {
        let names = levels.iter().map(|level| field(style.name(level)));
        let numbers = cells.iter().map(|cell| match cell {
            Some(cell) if !cell.value.is_nan() => format!("{:?}", cell.value),
            _ => String::new(),
        });
        text += &(names.chain(numbers).collect::<Vec<_>>().join(",") + "\n");
    }
    text
}

/// A `tabular` with the rules of booktabs: one line of heads for each axis of the columns, equal neighbours
/// joined.
pub fn latex(grid: &Grid, style: &Style) -> String {
    const ARROWS: [&str; 2] = [" @UP@", " @DOWN@"];
    let names = grid.row_axes.len();
    let mut text = format!(
        "% needs \\usepackage{{booktabs}}\n\\begin{{tabular}}{{{}{}}}\n\\toprule\n",
        "l".repeat(names),
        "r".repeat(grid.columns.len())
    );
    for (depth, axis) in grid.column_axes.iter().enumerate() {
        let last = depth + 1 == grid.column_axes.len();
        let mut cells: Vec<String> = grid
            .row_axes
            .iter()
            .map(|axis| if last { escaped(style.name(axis)) } else { String::new() })
            .collect();
        let mut rules = String::new();
        let mut at = 0;
        while at < grid.columns.len() {
            let end = (at..grid.columns.len())
                .find(|&other| grid.columns[other][..=depth] != grid.columns[at][..=depth])
                .unwrap_or(grid.columns.len());
            let name = escaped(&style.level(grid, axis, &grid.columns[at][depth], ARROWS));
            if last && end == at + 1 {
                cells.push(name);
            } else {
                cells.push(format!("\\multicolumn{{{}}}{{c}}{{{name}}}", end - at));
                rules += &format!("\\cmidrule(lr){{{}-{}}}", names + at + 1, names + end);
            }
            at = end;
        }
        text += &format!("{} \\\\\n", cells.join(" & "));
        if !last {
            text += &format!("{rules}\n");
        }
    }
    text += "\\midrule\n";
    let marks = style.marks(grid);
    for (row, levels) in grid.rows.iter().enumerate() {
        let names = grid
            .row_axes
            .iter()
            .zip(levels)
            .map(|(axis, level)| escaped(&style.level(grid, axis, level, ARROWS)));
        let cells = grid.cells[row].iter().zip(&marks[row]).map(|(cell, mark)| {
            match (style.show(cell.as_ref()), mark) {
                (text, Mark::Plain) => {
                    if text == "-" {
                        "--".into()
                    } else {
                        escaped(&text)
                    }
                }
                (text, Mark::Best) => format!("\\textbf{{{text}}}"),
                (text, Mark::Second) => format!("\\underline{{{text}}}"),
            }
        });
        text += &format!("{} \\\\\n", names.chain(cells).collect::<Vec<_>>().join(" & "));
    }
    text + "\\bottomrule\n\\end{tabular}\n"
}

/// Text for LaTeX.
fn escaped(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '\\' => out += "\\textbackslash{}",
            '~' => out += "\\textasciitilde{}",
            '^' => out += "\\textasciicircum{}",
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => out.extend(['\\', c]),
            c => out.push(c),
        }
    }
    out.replace("@UP@", "$\\uparrow$").replace("@DOWN@", "$\\downarrow$")
}

/// One JSON object a cell, a line each.
pub fn json_lines(grid: &Grid, style: &Style) -> String {
    json_cells(grid, style).iter().map(|cell| format!("{cell}\n")).collect()
}

/// The same cells as one JSON array.
pub fn json(grid: &Grid, style: &Style) -> String {
    let lines: Vec<String> = json_cells(grid, style).iter().map(|cell| format!("  {cell}")).collect();
    format!("[\n{}\n]\n", lines.join(",\n"))
}

/// Of every cell: its levels, metric, value with all digits (`null` when not measured), unit, direction, mark
/// and card.
fn json_cells(grid: &Grid, style: &Style) -> Vec<serde_json::Value> {
    let marks = style.marks(grid);
    let mut cells = Vec::new();
    for (row, levels) in grid.rows.iter().enumerate() {
        for (column, cell) in grid.cells[row].iter().enumerate() {
            let Some(cell) = cell else { continue };
            let mut line = serde_json::Map::new();
            for (axis, level) in
                grid.row_axes.iter().zip(levels).chain(grid.column_axes.iter().zip(&grid.columns[column]))
            {
                line.insert(axis.clone(), json!(level));
            }
            line.insert("metric".into(), json!(cell.metric));
            line.insert("value".into(), json!(cell.value.is_finite().then_some(cell.value)));
            line.insert("unit".into(), json!(cell.unit));
            line.insert("higher_is_better".into(), json!(higher_is_better(&cell.metric)));
            let mark = match marks[row][column] {
                Mark::Plain => None,
                Mark::Best => Some("best"),
                Mark::Second => Some("second"),
            };
            line.insert("mark".into(), json!(mark));
            line.insert("card".into(), json!(cell.card));
            if let Some((name, why)) = &cell.missing {
                line.insert("missing".into(), json!(name));
                line.insert("why".into(), json!(why));
            }
            cells.push(serde_json::Value::Object(line));
        }
    }
    cells
}

#[cfg(test)]
mod tests {
    use super::super::grid::Request;
    use super::super::grid::tests::{record, records};
    use super::*;

    fn style(among: Among) -> Style {
        let digits = [("psnr_db".to_string(), 1), ("lpips".to_string(), 2)].into();
        Style { digits, among, names: [("edi".to_string(), "EDI".to_string())].into() }
    }

    fn grid(rows: &[&str], columns: &[&str]) -> Grid {
        let own = |axes: &[&str]| axes.iter().map(ToString::to_string).collect();
        Grid::new(&records(), &Request { rows: own(rows), columns: own(columns), sum: false })
            .expect("a grid")
    }

    #[test]
    fn markdown_marks_the_best_and_the_second_whichever_way_is_better() {
        let text = markdown(&grid(&["scene"], &["metric", "method"]), &style(Among::Row));
        let expected = "\
| scene | psnr_db [dB] ↑, ours | psnr_db [dB] ↑, EDI | psnr_db [dB] ↑, akf | lpips ↓, ours | lpips ↓, EDI | lpips ↓, akf |
| --- | ---: | ---: | ---: | ---: | ---: | ---: |
| fan | **30.0** | 28.0 | <u>29.0</u> | 0.30 | **0.28** | <u>0.29</u> |
| ball | 20.0 | **21.0** | - | **0.20** | 0.21 | - |
";
        assert_eq!(text, expected);
    }

    #[test]
    fn a_cell_says_what_is_missing_and_the_reason_stands_below() {
        let mut records = ["method=ours metric=psnr_db", "method=film metric=psnr_db"]
            .map(|place| record(place, 30.0))
            .to_vec();
        (records[1].value, records[1].missing) =
            (f64::NAN, Some(("film_net.onnx".into(), "cannot read weights/film_net.onnx".into())));
        let grid = Grid::new(&records, &Request { rows: vec!["method".into()], columns: vec![], sum: false })
            .expect("a grid");
        let text = markdown(&grid, &style(Among::Column));
        assert!(
            text.contains(
                "| ours | 30.0 |\n| film | no film_net.onnx |\n\nno film_net.onnx: cannot \
                               read weights/film_net.onnx.\n"
            ),
            "{text}"
        );
        assert!(latex(&grid, &style(Among::Column)).contains("film & no film\\_net.onnx \\\\"));
        assert!(csv(&grid, &style(Among::Column)).ends_with("film,\n"));
        let lines = json_lines(&grid, &style(Among::Column));
        assert!(
            lines.lines().nth(1).is_some_and(
                |line| line.contains("\"missing\":\"film_net.onnx\"") && line.contains("\"value\":null")
            ),
            "{lines}"
        );
    }

    #[test]
    fn cells_that_print_alike_are_marked_alike() {
        let values = [30.04, 30.01, 29.0, 29.0].iter().enumerate();
        let records: Vec<_> =
            values.map(|(i, value)| record(&format!("method=m{i} metric=psnr_db"), *value)).collect();
        let grid = Grid::new(&records, &Request { rows: vec!["method".into()], columns: vec![], sum: false })
            .expect("a grid");
        let marks: Vec<Mark> = style(Among::Column).marks(&grid).concat();
        assert_eq!(marks, [Mark::Best, Mark::Best, Mark::Second, Mark::Second]);
        assert!(
            style(Among::Row).marks(&grid).concat().iter().all(|mark| *mark == Mark::Plain),
            "one alone is the best of nothing"
        );
    }

    #[test]
    fn csv_has_all_digits_and_gaps() {
        let text = csv(&grid(&["scene"], &["method", "metric"]), &style(Among::Row));
        assert_eq!(
            text.lines().next(),
            Some("scene,ours psnr_db,ours lpips,EDI psnr_db,EDI lpips,akf psnr_db,akf lpips")
        );
        assert_eq!(text.lines().nth(2), Some("ball,20.0,0.2,21.0,0.21,,"));
    }

    #[test]
    fn latex_joins_equal_heads_and_escapes_what_latex_reads() {
        let text = latex(&grid(&["scene"], &["method", "metric"]), &style(Among::Row));
        let expected = "% needs \\usepackage{booktabs}
\\begin{tabular}{lrrrrrr}
\\toprule
 & \\multicolumn{2}{c}{ours} & \\multicolumn{2}{c}{EDI} & \\multicolumn{2}{c}{akf} \\\\
\\cmidrule(lr){2-3}\\cmidrule(lr){4-5}\\cmidrule(lr){6-7}
scene & psnr\\_db [dB] $\\uparrow$ & lpips $\\downarrow$ \
& psnr\\_db [dB] $\\uparrow$ & lpips $\\downarrow$ \
& psnr\\_db [dB] $\\uparrow$ & lpips $\\downarrow$ \\\\
\\midrule
fan & \\textbf{30.0} & 0.30 & 28.0 & \\textbf{0.28} & \\underline{29.0} & \\underline{0.29} \\\\
ball & 20.0 & \\textbf{0.20} & \\textbf{21.0} & 0.21 & -- & -- \\\\
\\bottomrule
\\end{tabular}
";
        assert_eq!(text, expected);
    }

    #[test]
    fn json_lines_have_everything_about_a_cell() {
        let text = json_lines(&grid(&["scene"], &["method", "metric"]), &style(Among::Row));
        let lines: Vec<serde_json::Value> =
            text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
        assert_eq!(lines.len(), 12);
        let expected = json!({
            "scene": "fan", "method": "edi", "metric": "lpips", "value": 0.28, "unit": "",
            "higher_is_better": false, "mark": "best", "card": "a card",
        });
        assert_eq!(lines[3], expected);
        assert_eq!(lines[10]["value"], serde_json::Value::Null);
        let array = super::json(&grid(&["scene"], &["method", "metric"]), &style(Among::Row));
        assert_eq!(serde_json::from_str::<Vec<serde_json::Value>>(&array).expect("one array"), lines);
    }

    #[test]
    fn what_stands_on_no_axis_is_said_below() {
        let records: Vec<_> =
            ["a", "b"].iter().map(|m| record(&format!("scene=fan method={m} metric=psnr_db"), 1.0)).collect();
        let grid = Grid::new(
            &records,
            &Request { rows: vec!["scene".into()], columns: vec!["method".into()], sum: false },
        )
        .expect("a grid");
        assert!(markdown(&grid, &style(Among::None)).ends_with("\npsnr_db [dB], higher is better.\n"));
    }
}
