//! Numbers laid out by two lists of axes.

use super::records::{Record, axes_of, levels_of};

/// Which axes make rows and columns; empty = what differs and is not in the other.
pub struct Request {
    /// Axes of the rows, the last one changing fastest.
    pub rows: Vec<String>,
    /// Axes of the columns.
    pub columns: Vec<String>,
    /// Numbers of one metric that fall into one cell are added up.
    pub sum: bool,
}

/// One number of a cell.
#[derive(Clone, Debug)]
pub struct Cell {
    /// NaN where it was not measured.
    pub value: f64,
    /// Of what.
    pub metric: String,
    /// In what.
    pub unit: String,
    /// How it was measured.
    pub card: String,
    /// What is missing where nothing was measured; and in whole sentences.
    pub missing: Option<(String, String)>,
}

/// The table.
pub struct Grid {
    /// Axes of the rows.
    pub row_axes: Vec<String>,
    /// Axes of the columns.
    pub column_axes: Vec<String>,
    /// Levels of each row.
    pub rows: Vec<Vec<String>>,
    /// Levels of each column.
    pub columns: Vec<Vec<String>>,
    /// By row, then by column; `None` where nothing was run.
    pub cells: Vec<Vec<Option<Cell>>>,
}

impl Grid {
    /// Lays the records out.
    ///
    /// # Errors
    /// When an axis is unknown, stands twice, or two numbers fall into one cell.
    pub fn new(records: &[Record], request: &Request) -> Result<Grid, String> {
        let known = axes_of(records);
        let named: Vec<&String> = request.rows.iter().chain(&request.columns).collect();
        for (i, axis) in named.iter().enumerate() {
            if !known.contains(axis) {
                return Err(format!("there is no axis `{axis}`; there are {}", known.join(", ")));
            }
            if named[..i].contains(axis) {
                return Err(format!(
                    "the axis `{axis}` stands twice; leave it out of --rows or of --columns"
                ));
            }
        }
        let (row_axes, column_axes) = axes(records, request, &known);
        let rows = places(records, &row_axes);
        let columns = places(records, &column_axes);
        let mut cells: Vec<Vec<Option<(usize, Cell)>>> = vec![vec![None; columns.len()]; rows.len()];
        for (i, record) in records.iter().enumerate() {
            let at = |places: &[Vec<String>], axes: &[String]| {
                places.iter().position(|place| *place == levels(record, axes))
            };
            let (Some(row), Some(column)) = (at(&rows, &row_axes), at(&columns, &column_axes)) else {
                continue;
            };
            let metric = record.level("metric").unwrap_or_default().to_string();
            match &mut cells[row][column] {
                Some((_, cell)) if request.sum && cell.metric == metric && cell.unit == record.unit => {
                    cell.value += record.value;
                    continue;
                }
                Some((other, _)) => {
                    return Err(two_in_one(record, &records[*other], &rows[row], &columns[column]));
                }
                None => {}
            }
            cells[row][column] = Some((
                i,
                Cell {
                    value: record.value,
                    metric,
                    unit: record.unit.clone(),
                    card: record.card.clone(),
                    missing: record.missing.clone(),
                },
            ));
        }
        let cells = cells
            .into_iter()
            .map(|row| row.into_iter().map(|cell| cell.map(|(_, cell)| cell)).collect())
            .collect();
        Ok(Grid { row_axes, column_axes, rows, columns, cells })
    }

    /// Are cells compared along a row? Methods with methods, where there are any; else cells side by side,
    /// unless those are of two metrics.
    pub fn columns_compare(&self) -> bool {
        let has_methods =
            |axes: &[String]| axes.iter().any(|axis| ["method", "node", "label"].contains(&axis.as_str()));
        match (has_methods(&self.column_axes), has_methods(&self.row_axes)) {
            (true, _) => true,
            (false, true) => false,
            (false, false) => self.column_axes.iter().any(|axis| axis != "metric"),
        }
    }

    /// What is missing in whole sentences, each once.
    pub fn missing(&self) -> Vec<&(String, String)> {
        let mut all: Vec<&(String, String)> = Vec::new();
        for missing in self.cells.iter().flatten().flatten().filter_map(|cell| cell.missing.as_ref()) {
            if !all.contains(&missing) {
                all.push(missing);
            }
        }
        all
    }

    /// The metrics in the order in which they stand.
    pub fn metrics(&self) -> Vec<String> {
        let mut metrics: Vec<String> = Vec::new();
        for cell in self.cells.iter().flatten().flatten() {
            if !metrics.contains(&cell.metric) {
                metrics.push(cell.metric.clone());
            }
        }
        metrics
    }
}

/// The axes of rows and columns: those asked for, and what is left for a side that was not.
fn axes(records: &[Record], request: &Request, known: &[String]) -> (Vec<String>, Vec<String>) {
    let differs = |axis: &str| levels_of(records, axis).len() > 1;
    let asked = |axis: &String| request.rows.contains(axis) || request.columns.contains(axis);
    // Method stands for node and label, unless those are asked for.
    let taken = |axis: &String| match axis.as_str() {
        "node" | "label" => true,
        "method" => request.rows.iter().chain(&request.columns).any(|axis| axis == "node" || axis == "label"),
        _ => false,
    };
    let left: Vec<String> =
        known.iter().filter(|axis| differs(axis) && !asked(axis) && !taken(axis)).cloned().collect();
    let is_column = |axis: &String| axis == "method" || axis == "metric";
    let (mut rows, mut columns) = (request.rows.clone(), request.columns.clone());
    match (rows.is_empty(), columns.is_empty()) {
        (true, true) => {
            let (last, first): (Vec<String>, Vec<String>) = left.into_iter().partition(is_column);
            (rows, columns) = (first, last);
            // Without an ablation the methods are the rows.
            if rows.is_empty() && columns.iter().any(|axis| axis == "method") {
                columns.retain(|axis| axis != "method");
                rows.push("method".into());
            }
        }
        (true, false) => rows = left,
        (false, true) => columns = left,
        (false, false) => {}
    }
    if rows.is_empty()
        && !columns.iter().any(|axis| axis == "method")
        && known.iter().any(|axis| axis == "method")
    {
        rows.push("method".into());
    }
    if columns.is_empty() && !rows.iter().any(|axis| axis == "metric") {
        columns.push("metric".into());
    }
    (rows, columns)
}

fn levels(record: &Record, axes: &[String]) -> Vec<String> {
    axes.iter().map(|axis| record.level(axis).unwrap_or("-").to_string()).collect()
}

/// The places that records take on the axes: ordered by the order of each axis' levels, the last axis
/// changing fastest.
fn places(records: &[Record], axes: &[String]) -> Vec<Vec<String>> {
    let orders: Vec<Vec<String>> = axes.iter().map(|axis| levels_of(records, axis)).collect();
    let rank = |place: &Vec<String>| -> Vec<usize> {
        place
            .iter()
            .zip(&orders)
            .map(|(level, order)| order.iter().position(|known| known == level).unwrap_or(usize::MAX))
            .collect()
    };
    let mut places: Vec<Vec<String>> = records.iter().map(|record| levels(record, axes)).collect();
    places.sort_by_key(rank);
    places.dedup();
    places
}

fn two_in_one(one: &Record, other: &Record, row: &[String], column: &[String]) -> String {
    let differ: Vec<&str> = one
        .place
        .iter()
        .filter(|(axis, level)| other.level(axis) != Some(level))
        .map(|(axis, _)| axis.as_str())
        .collect();
    let cell = row.iter().chain(column).map(String::as_str).collect::<Vec<_>>().join(", ");
    if differ.is_empty() {
        return format!("two scores have the same place ({cell})\n  is a file named twice?");
    }
    let differ = differ.join("`, `");
    format!(
        "two scores fall into one cell ({cell}): they differ in `{differ}`\n  name that axis in --rows or \
         --columns, or choose one of its levels with --where"
    )
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// A record at `axis=level` places.
    pub fn record(place: &str, value: f64) -> Record {
        let place: Vec<(String, String)> = place
            .split(' ')
            .filter_map(|pair| pair.split_once('='))
            .map(|(a, l)| (a.into(), l.into()))
            .collect();
        let unit = if place.iter().any(|(_, level)| level == "psnr_db") { "dB" } else { "" };
        Record { place, unit: unit.into(), value, card: "a card".into(), missing: None }
    }

    /// Two scenes, three methods, two metrics.
    pub fn records() -> Vec<Record> {
        let mut all = Vec::new();
        for (scene, values) in [("fan", [30.0, 28.0, 29.0]), ("ball", [20.0, 21.0, f64::NAN])] {
            for (method, value) in ["ours", "edi", "akf"].iter().zip(values) {
                all.push(record(
                    &format!("file=t scene={scene} node=psnr_{method} method={method} metric=psnr_db"),
                    value,
                ));
                all.push(record(
                    &format!("file=t scene={scene} node=lpips_{method} method={method} metric=lpips"),
                    value / 100.0,
                ));
            }
        }
        all
    }

    fn request(rows: &[&str], columns: &[&str]) -> Request {
        let own = |axes: &[&str]| axes.iter().map(ToString::to_string).collect();
        Request { rows: own(rows), columns: own(columns), sum: false }
    }

    #[test]
    fn what_falls_into_one_cell_is_added_up_when_that_is_asked_for() {
        let said = [("fan", 1.0), ("fan", 2.0), ("ball", 4.0)].map(|(scene, value)| {
            record(&format!("scene={scene} recording={value} metric=count node=n method=n"), value)
        });
        let request = Request { rows: vec!["scene".into()], columns: vec!["metric".into()], sum: true };
        let grid = Grid::new(&said, &request).expect("a grid");
        let values: Vec<f64> =
            grid.cells.iter().map(|row| row[0].as_ref().expect("a number").value).collect();
        assert_eq!(values, [3.0, 4.0]);
        assert!(
            Grid::new(&said, &Request { sum: false, ..request }).err().expect("refused").contains("one cell")
        );
    }

    #[test]
    fn numbers_of_two_metrics_are_never_added_up() {
        let records =
            [record("scene=fan metric=count node=n", 1.0), record("scene=fan metric=f1 node=n", 2.0)];
        let request = Request { rows: vec!["scene".into()], columns: vec!["node".into()], sum: true };
        assert!(Grid::new(&records, &request).is_err());
    }

    #[test]
    fn what_differs_is_laid_out_without_being_asked() {
        let grid = Grid::new(&records(), &request(&[], &[])).expect("a grid");
        assert_eq!(
            (grid.row_axes.as_slice(), grid.column_axes.as_slice()),
            (["scene".to_string()].as_slice(), ["method".into(), "metric".into()].as_slice())
        );
        assert_eq!(grid.rows, [["fan"], ["ball"]]);
        assert_eq!(grid.columns.len(), 6);
        assert_eq!(grid.columns[1], ["ours", "lpips"]);
        assert_eq!(grid.cells[0][2].as_ref().map(|cell| cell.value), Some(28.0));
        assert!(grid.columns_compare());
        assert_eq!(grid.metrics(), ["psnr_db", "lpips"]);
    }

    #[test]
    fn rows_and_columns_can_change_places() {
        let grid = Grid::new(&records(), &request(&["method"], &["metric", "scene"])).expect("a grid");
        assert_eq!(grid.rows, [["ours"], ["edi"], ["akf"]]);
        assert_eq!(
            grid.columns,
            [["psnr_db", "fan"], ["psnr_db", "ball"], ["lpips", "fan"], ["lpips", "ball"]]
        );
        assert_eq!(grid.cells[1][1].as_ref().map(|cell| cell.value), Some(21.0));
        // Methods are compared with methods.
        assert!(!grid.columns_compare());
    }

    #[test]
    fn two_numbers_in_one_cell_and_unknown_axes_are_reported() {
        let message = |rows: &[&str], columns: &[&str]| {
            Grid::new(&records(), &request(rows, columns)).err().expect("a mistake")
        };
        let found = message(&["scene"], &["metric"]);
        assert!(
            found
                .starts_with("two scores fall into one cell (fan, psnr_db): they differ in `node`, `method`"),
            "{found}"
        );
        assert_eq!(
            message(&["scenes"], &[]),
            "there is no axis `scenes`; there are file, scene, node, method, metric"
        );
        assert!(message(&["scene"], &["scene"]).contains("stands twice"));
    }
}
