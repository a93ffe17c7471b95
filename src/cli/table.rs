//! `photocurrent table`: scores of finished runs as a table for people, papers and programs.
//!
//! `run` leaves one line of JSON for every score. Each line has a place on several axes: the ablation's own,
//! and `file`, `node`, `method` (the node's name after its first `_`: psnr_edi, lpips_edi are one method),
//! `label`, `metric` and `frame`. The table is those numbers laid out by two lists of axes. A field of the
//! metric card is an axis too, as `card.FIELD`. Nothing is averaged here: where two numbers fall into one
//! cell, the command says by what they differ, or adds them up with `--sum`, which makes a confusion matrix
//! of counts.

pub mod formats;
pub mod grid;
pub mod plot;
pub mod records;

use crate::args::{Among, TableFormat, TableOptions};
use crate::failure::{Done, Failure, usage};
use crate::terminal::print;
use formats::Style;
use grid::{Grid, Request};
use records::Choice;
use std::collections::BTreeMap;

/// Prints the table.
pub fn table(options: &TableOptions) -> Done {
    let choice = Choice {
        metrics: options.metric.clone(),
        levels: options.only.iter().map(|text| choice(text)).collect::<Result<_, _>>()?,
        statistic: options.statistic,
        card: card_axes(options),
        by_frame: [&options.rows, &options.columns]
            .iter()
            .any(|axes| axes.iter().any(|axis| axis == "frame"))
            || options.only.iter().any(|text| text.starts_with("frame=")),
    };
    let records = records::read(&options.sources, &choice)?;
    let request = Request { rows: options.rows.clone(), columns: options.columns.clone(), sum: options.sum };
    let grid = Grid::new(&records, &request).map_err(usage)?;
    let style = Style {
        digits: digits(&options.digits, &grid.metrics())?,
        among: options.best.unwrap_or(if grid.columns_compare() { Among::Row } else { Among::Column }),
        names: names(&options.rename)?,
    };
    if let Some(path) = &options.plot {
        plot::save(&grid, &style, path)?;
    }
    print(&match options.format {
        _ if options.json => formats::json(&grid, &style),
        TableFormat::Md => formats::markdown(&grid, &style),
        TableFormat::Csv => formats::csv(&grid, &style),
        TableFormat::Latex => formats::latex(&grid, &style),
        TableFormat::Jsonl => formats::json_lines(&grid, &style),
        TableFormat::Json => formats::json(&grid, &style),
    })?;
    Ok(0)
}

/// The fields of cards that are asked for as axes.
fn card_axes(options: &TableOptions) -> Vec<String> {
    let asked = options
        .rows
        .iter()
        .chain(&options.columns)
        .map(String::as_str)
        .chain(options.only.iter().filter_map(|text| Some(text.split_once('=')?.0)));
    asked.filter_map(|axis| axis.strip_prefix("card.")).map(str::to_owned).collect()
}

/// `scene=fan,texture`.
fn choice(text: &str) -> Result<(String, Vec<String>), Failure> {
    match text.split_once('=') {
        Some((axis, levels)) if !axis.is_empty() && !levels.is_empty() => {
            Ok((axis.into(), levels.split(',').map(String::from).collect()))
        }
        _ => Err(usage(format!(
            "--where {text}: expected an axis and its levels, such as --where scene=fan,texture"
        ))),
    }
}

/// `edi=EDI`.
fn names(renames: &[String]) -> Result<BTreeMap<String, String>, Failure> {
    let pair = |text: &String| {
        let (from, to) = text
            .split_once('=')
            .ok_or_else(|| usage(format!("--rename {text}: expected NAME=TEXT, such as --rename edi=EDI")))?;
        Ok((from.to_string(), to.to_string()))
    };
    renames.iter().map(pair).collect()
}

/// Digits after the point by metric: what was asked for, else what the metric can bear.
fn digits(asked: &[String], metrics: &[String]) -> Result<BTreeMap<String, usize>, Failure> {
    let mut digits: BTreeMap<String, usize> =
        metrics.iter().map(|metric| (metric.clone(), usual_digits(metric))).collect();
    for text in asked {
        let (metric, number) =
            text.split_once('=').map_or((None, text.as_str()), |(metric, number)| (Some(metric), number));
        let number = number.trim().parse::<usize>().ok().filter(|number| *number <= 12);
        let number = number.ok_or_else(|| {
            usage(format!("--digits {text}: expected a number from 0 to 12, alone or as METRIC=NUMBER"))
        })?;
        match metric {
            None => digits.values_mut().for_each(|value| *value = number),
            Some(metric) => {
                let known = metrics.join(", ");
                *digits.get_mut(metric).ok_or_else(|| {
                    usage(format!("--digits {text}: the table has no metric `{metric}`; it has {known}"))
                })? = number;
            }
        }
    }
    Ok(digits)
}

/// Digits after the point that a metric can bear.
pub fn usual_digits(metric: &str) -> usize {
    match metric {
        _ if metric.ends_with("_db") || metric.starts_with("bew") || metric.ends_with("_dn") => 2,
        _ if metric.starts_with("glitches") => 0,
        _ if metric.contains("ssim") => 4,
        _ => 3,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(failure: Failure) -> String {
        match failure {
            Failure::Other { message, code: 2 } => message,
            _ => panic!("a mistake in the arguments"),
        }
    }

    #[test]
    fn digits_are_for_all_metrics_or_for_one() {
        let metrics = ["psnr_db".to_string(), "lpips".to_string()];
        let of = |asked: &[&str]| {
            digits(&asked.iter().map(ToString::to_string).collect::<Vec<_>>(), &metrics)
                .map(|d| (d["psnr_db"], d["lpips"]))
        };
        assert!(
            matches!(of(&[]), Ok((2, 3)))
                && matches!(of(&["1"]), Ok((1, 1)))
                && matches!(of(&["1", "lpips=4"]), Ok((1, 4)))
        );
        let found = message(of(&["ssim=2"]).unwrap_err());
        assert_eq!(found, "--digits ssim=2: the table has no metric `ssim`; it has psnr_db, lpips");
        assert!(message(of(&["x"]).unwrap_err()).contains("0 to 12"));
    }

    #[test]
    fn choices_and_names_need_both_sides() {
        assert!(matches!(
            choice("scene=fan,texture"),
            Ok((axis, levels)) if axis == "scene" && levels == ["fan", "texture"],
        ));
        assert!(message(choice("scene").unwrap_err()).starts_with("--where scene: expected"));
        assert!(message(names(&["edi".into()]).unwrap_err()).starts_with("--rename edi: expected"));
    }
}
