//! A grid as curves: rows along the axis, one curve a column.

use super::formats::Style;
use super::grid::Grid;
use crate::failure::{Failure, usage};
use photocurrent_nodes::write::figure::{Figure, Panel, Series};
use std::path::Path;

/// From this ratio of the greatest to the smallest level on, equal ratios are drawn equally far apart.
const LOG_FROM: f64 = 8.0;

/// Writes the figure; the file's ending says how.
pub fn save(grid: &Grid, style: &Style, path: &Path) -> Result<(), Failure> {
    let figure =
        figure(grid, style).map_err(|message| usage(format!("--plot {}: {message}", path.display())))?;
    let failed = |message: String| Failure::other(format!("{}: {message}", path.display()));
    let bytes = match path.extension().and_then(|extension| extension.to_str()) {
        Some("svg") => figure.svg().map_err(failed)?.into_bytes(),
        Some("png") => figure.png().map_err(failed)?,
        _ => return Err(usage(format!("--plot {}: the file ends in .svg or .png", path.display()))),
    };
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|error| failed(format!("cannot write: {error}")))?;
    }
    std::fs::write(path, bytes).map_err(|error| failed(format!("cannot write: {error}")))
}

/// One panel for each metric.
pub fn figure(grid: &Grid, style: &Style) -> Result<Figure, String> {
    let [axis] = grid.row_axes.as_slice() else {
        return Err(format!(
            "one axis makes the rows of a figure, and here {} do: {}",
            grid.row_axes.len(),
            grid.row_axes.join(", ")
        ));
    };
    let levels = grid.rows.iter().map(|row| {
        number(&row[0]).ok_or_else(|| format!("the level `{}` of `{axis}` is no number with a unit", row[0]))
    });
    let levels: Vec<(f64, String)> = levels.collect::<Result<_, _>>()?;
    let unit = &levels[0].1;
    if let Some((_, other)) = levels.iter().find(|(_, other)| other != unit) {
        return Err(format!("the levels of `{axis}` have two units, `{unit}` and `{other}`"));
    }
    let values = || levels.iter().map(|(value, _)| *value);
    let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
    let name = style.name(axis);
    let metrics = grid.metrics();
    let panels = metrics.iter().map(|metric| {
        let columns = (0..grid.columns.len()).filter(|&column| {
            grid.cells.iter().filter_map(|row| row[column].as_ref()).any(|cell| cell.metric == *metric)
        });
        let series = columns.map(|column| {
            let value = |row: usize| grid.cells[row][column].as_ref().map_or(f64::NAN, |cell| cell.value);
            let mut points: Vec<(f64, f64)> =
                levels.iter().enumerate().map(|(row, (x, _))| (*x, value(row))).collect();
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            let names = grid
                .column_axes
                .iter()
                .zip(&grid.columns[column])
                .filter(|(axis, _)| *axis != "metric")
                .map(|(_, level)| style.name(level));
            let label = names.collect::<Vec<_>>().join(", ");
            Series { label, points, is_reference: false }
        });
        Panel {
            title: String::new(),
            x_label: if unit.is_empty() { name.into() } else { format!("{name} [{unit}]") },
            y_label: style.heading(grid, metric, ["", ""]),
            is_log: low > 0.0 && high >= LOG_FROM * low,
            series: series.collect(),
        }
    });
    Ok(Figure { panels: panels.collect(), width: 720, height: 360 })
}

/// `73rpm` is 73 in `rpm`.
fn number(level: &str) -> Option<(f64, String)> {
    let end = level.find(|c: char| !(c.is_ascii_digit() || ".+-".contains(c))).unwrap_or(level.len());
    let value = level[..end].parse::<f64>().ok().filter(|value| value.is_finite())?;
    Some((value, level[end..].to_string()))
}

#[cfg(test)]
mod tests {
    use super::super::grid::Request;
    use super::super::grid::tests::record;
    use super::*;
    use crate::args::Among;
    use std::collections::BTreeMap;

    fn drawn(records: &[(&str, f64)], rows: &str) -> Result<Figure, String> {
        let records: Vec<_> = records.iter().map(|(place, value)| record(place, *value)).collect();
        let grid = Grid::new(&records, &Request { rows: vec![rows.into()], columns: vec![], sum: false })?;
        let names = [("edi".to_string(), "EDI".to_string())].into();
        figure(&grid, &Style { digits: BTreeMap::new(), among: Among::None, names })
    }

    #[test]
    fn levels_with_units_are_places_on_the_axis() {
        let records = [
            ("light=1000lx method=edi metric=psnr_db", 3.0),
            ("light=50lx method=edi metric=psnr_db", 1.0),
            ("light=1000lx method=map metric=psnr_db", 5.0),
            ("light=50lx method=map metric=psnr_db", f64::NAN),
        ];
        let figure = drawn(&records, "light").expect("a figure");
        let [panel] = figure.panels.as_slice() else { panic!("one metric, one panel") };
        assert_eq!(
            (panel.x_label.as_str(), panel.y_label.as_str(), panel.is_log),
            ("light [lx]", "psnr_db [dB]", true)
        );
        assert_eq!(
            panel.series.iter().map(|series| series.label.as_str()).collect::<Vec<_>>(),
            ["EDI", "map"]
        );
        assert_eq!(panel.series[0].points, [(50.0, 1.0), (1000.0, 3.0)]);
        assert!(panel.series[1].points[0].1.is_nan() && panel.series[1].points[1] == (1000.0, 5.0));
    }

    #[test]
    fn what_is_no_number_cannot_be_an_axis() {
        assert!(
            drawn(&[("scene=fan method=edi metric=psnr_db", 3.0)], "scene")
                .is_err_and(|message| message.contains("`fan` of `scene` is no number"))
        );
        let mixed =
            [("light=50lx method=edi metric=psnr_db", 3.0), ("light=50klx method=edi metric=psnr_db", 3.0)];
        assert!(drawn(&mixed, "light").is_err_and(|message| message.contains("two units, `lx` and `klx`")));
        assert_eq!(number("-2.5ms"), Some((-2.5, "ms".into())));
        assert_eq!(number("fan"), None);
    }
}
