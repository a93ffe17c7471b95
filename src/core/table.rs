//! Tables: named columns of numbers or text, one row per frame, method or whatever was measured.
//!
//! Scores use one fixed form, [`Table::scores`]: one row per (metric, frame), so that the command can write
//! metrics as JSON Lines and pool them without knowing any scorer.

use crate::digest::{Digest, DigestBuilder};
use serde::{Deserialize, Serialize};

/// One column.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Column {
    /// Floating-point numbers; NaN means "not measured".
    Numbers(Vec<f64>),
    /// Integers.
    Integers(Vec<i64>),
    /// Text.
    Texts(Vec<String>),
}

impl Column {
    /// Number of cells.
    pub fn len(&self) -> usize {
        match self {
            Column::Numbers(cells) => cells.len(),
            Column::Integers(cells) => cells.len(),
            Column::Texts(cells) => cells.len(),
        }
    }

    /// No cell at all?
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A cell as text: numbers with three decimals, NaN as a dash.
    pub fn cell(&self, row: usize) -> String {
        match self {
            Column::Numbers(cells) if cells[row].is_nan() => "-".into(),
            Column::Numbers(cells) => format!("{:.3}", cells[row]),
            Column::Integers(cells) => cells[row].to_string(),
            Column::Texts(cells) => cells[row].clone(),
        }
    }
}

/// What is known about a table before its data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TableMeta {
    /// Are these scores in the form of [`Table::scores`]?
    pub scores: bool,
}

/// Named columns of equal length.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct Table {
    columns: Vec<(String, Column)>,
    /// What the numbers mean: a metric card, a definition, a warning. In order.
    pub notes: Vec<(String, String)>,
}

/// One measured value.
#[derive(Clone, Debug, PartialEq)]
pub struct Score {
    /// `psnr_db`.
    pub metric: String,
    /// Index of the frame; -1 for a value pooled over all frames.
    pub frame: i64,
    /// Middle of the frame's exposure, ns; 0 for a pooled value.
    pub t_ns: i64,
    /// The value; NaN when it could not be measured.
    pub value: f64,
    /// `dB`.
    pub unit: String,
}

/// The tails of a score over its frames: failures are not visible when looking at the average values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tails {
    /// Smallest value.
    pub min: f64,
    /// 5th percentile.
    pub p05: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Largest value.
    pub max: f64,
}

impl Tails {
    /// Of the frames of one metric, those that were not measured (NaN) left out; `None` when none was
    /// measured.
    pub fn of<'a>(scores: impl IntoIterator<Item = &'a Score>, metric: &str) -> Option<Tails> {
        let frames = scores.into_iter().filter(|score| score.frame >= 0 && score.metric == metric);
        let mut values: Vec<f64> = frames.map(|score| score.value).filter(|value| !value.is_nan()).collect();
        values.sort_by(f64::total_cmp);
        let (min, max) = (*values.first()?, *values.last()?);
        Some(Tails { min, p05: percentile(&values, 0.05), p95: percentile(&values, 0.95), max })
    }
}

/// The value below which a share (0 to 1) of sorted values lies, linear between neighbouring values; NaN when
/// there is none.
///
/// ```
/// use photocurrent_core::table::percentile;
/// assert_eq!(percentile(&[1.0, 2.0, 4.0], 0.75), 3.0);
/// ```
pub fn percentile(sorted: &[f64], share: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let at = share * last as f64;
    let (below, part) = (at.floor() as usize, at.fract());
    // Two infinities have no difference.
    if part == 0.0 || sorted[below] == sorted[below + 1] {
        sorted[below]
    } else {
        sorted[below] + part * (sorted[below + 1] - sorted[below])
    }
}

/// Is a higher value of a metric better? `None` when its name does not say.
///
/// ```
/// use photocurrent_core::table::higher_is_better;
/// assert_eq!(
///     [higher_is_better("psnr_db"), higher_is_better("bew_px"), higher_is_better("count")],
///     [Some(true), Some(false), None],
/// );
/// ```
pub fn higher_is_better(metric: &str) -> Option<bool> {
    let name = metric.to_lowercase();
    let has = |words: &[&str]| words.iter().any(|word| name.contains(word));
    // An error in decibels would be an odd name, but still an error; and a glitch of the PSNR is a glitch.
    if has(&["error", "rmse", "mae", "lpips", "bew", "glitch"]) {
        Some(false)
    } else if name.ends_with("_db") || has(&["ssim"]) {
        Some(true)
    } else {
        None
    }
}

impl Table {
    /// Adds a column.
    ///
    /// # Panics
    /// When its length differs from that of the columns before it: a mistake of the node.
    pub fn with(mut self, name: &str, column: Column) -> Table {
        assert!(
            self.columns.is_empty() || self.columns[0].1.len() == column.len(),
            "columns of one table have one length"
        );
        self.columns.push((name.into(), column));
        self
    }

    /// Adds a note.
    pub fn note(mut self, name: &str, text: impl Into<String>) -> Table {
        self.notes.push((name.into(), text.into()));
        self
    }

    /// The columns in order.
    pub fn columns(&self) -> &[(String, Column)] {
        &self.columns
    }

    /// A column by name.
    pub fn column(&self, name: &str) -> Option<&Column> {
        self.columns.iter().find(|(n, _)| n == name).map(|(_, column)| column)
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.columns.first().map_or(0, |(_, column)| column.len())
    }

    /// No row at all?
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Scores: one row per (metric, frame), with the card that says how they were measured.
    pub fn scores(scores: Vec<Score>, card: impl Into<String>) -> Table {
        Table::default()
            .with("metric", Column::Texts(scores.iter().map(|s| s.metric.clone()).collect()))
            .with("frame", Column::Integers(scores.iter().map(|s| s.frame).collect()))
            .with("t_ns", Column::Integers(scores.iter().map(|s| s.t_ns).collect()))
            .with("value", Column::Numbers(scores.iter().map(|s| s.value).collect()))
            .with("unit", Column::Texts(scores.iter().map(|s| s.unit.clone()).collect()))
            .note("card", card)
    }

    /// The rows of a table made by [`Table::scores`]; `None` for another table.
    pub fn as_scores(&self) -> Option<Vec<Score>> {
        let (
            Column::Texts(metric),
            Column::Integers(frame),
            Column::Integers(t_ns),
            Column::Numbers(value),
            Column::Texts(unit),
        ) = (
            self.column("metric")?,
            self.column("frame")?,
            self.column("t_ns")?,
            self.column("value")?,
            self.column("unit")?,
        )
        else {
            return None;
        };
        Some(
            (0..self.len())
                .map(|i| Score {
                    metric: metric[i].clone(),
                    frame: frame[i],
                    t_ns: t_ns[i],
                    value: value[i],
                    unit: unit[i].clone(),
                })
                .collect(),
        )
    }

    /// The digest of everything in it.
    pub fn digest(&self) -> Digest {
        let mut digest = DigestBuilder::new("table/1");
        digest.integer(self.columns.len() as i64);
        for (name, column) in &self.columns {
            digest.text(name);
            match column {
                Column::Numbers(cells) => digest.text("numbers").slice(cells),
                Column::Integers(cells) => digest.text("integers").slice(cells),
                Column::Texts(cells) => {
                    digest.text("texts").integer(cells.len() as i64);
                    cells.iter().fold(&mut digest, |digest, cell| digest.text(cell))
                }
            };
        }
        for (name, text) in &self.notes {
            digest.text(name).text(text);
        }
        digest.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scores_survive_their_form() {
        let scores =
            vec![Score { metric: "psnr_db".into(), frame: 3, t_ns: 17, value: 31.5, unit: "dB".into() }];
        let table = Table::scores(scores.clone(), "full frame");
        assert_eq!(table.as_scores().unwrap(), scores);
        assert_eq!(Table::default().with("metric", Column::Texts(vec![])).as_scores(), None);
    }

    #[test]
    fn tails_are_of_measured_frames_and_not_of_pooled_values() {
        let score =
            |frame: i64, value| Score { metric: "psnr_db".into(), frame, t_ns: 0, value, unit: "dB".into() };
        let mut scores: Vec<Score> = (0..=20).rev().map(|l| score(l, l as f64)).collect();
        scores.extend([
            score(21, f64::NAN),
            score(-1, -99.0),
            Score { metric: "other".into(), ..score(3, 99.0) },
        ]);
        assert_eq!(Tails::of(&scores, "psnr_db"), Some(Tails { min: 0.0, p05: 1.0, p95: 19.0, max: 20.0 }));
        assert_eq!(Tails::of(&scores, "none"), None);
    }

    #[test]
    fn every_part_enters_the_digest() {
        let base = Table::default().with("a", Column::Numbers(vec![1.0]));
        let others = [
            Table::default().with("b", Column::Numbers(vec![1.0])),
            Table::default().with("a", Column::Integers(vec![1])),
            base.clone().note("n", ""),
        ];
        assert!(others.iter().all(|other| other.digest() != base.digest()));
    }
}
