//! Events as comma-separated values or any other text with one event a line.
//!
//! The order of the columns and the unit of the stamps come from a header line, from comments, or from the
//! user; nothing is guessed. What this module writes says both, and reads back without a declaration. Limits:
//! one event a line, one stamp unit a file, a decimal point.

use crate::convention::{Lazy, Rules, Tally};
use crate::declared::{Column, Declared, TimeUnit};
use crate::error::FormatError;
use crate::evidence::{self, Of, unit_name};
use crate::format::{Format, Probe};
use crate::recording::{Convention, EventCursor, EventsAbout, Recording};
use crate::text::cursor::TextCursor;
use crate::text::fields::Separator;
use crate::text::layout::Layout;
use crate::text::sniff::{self, Sniffed};
use crate::{EventChunk, decimal::Decimal};
use photocurrent_core::Extent;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Text with one event a line.
pub static FORMAT: Format = Format {
    id: "csv",
    name: "text, one event a line",
    recognises,
    open: |path, declared| Ok(Box::new(Csv::open(path, declared)?)),
};

/// Text whose header names t, x, y and p, or whose lines are at least four numbers each.
fn recognises(probe: &Probe) -> bool {
    if probe.names.is_some() || probe.head.is_empty() || probe.head.contains(&0) {
        return false;
    }
    let found = sniff::look(&probe.head, &[], probe.bytes);
    if let Some(columns) = &found.columns {
        return [Column::T, Column::X, Column::Y].iter().all(|wanted| columns.contains(wanted));
    }
    let all_numbers = |line: &Vec<Option<Decimal>>| {
        line.len() >= 4 && line.iter().filter(|field| field.is_some()).count() + 1 >= line.len()
    };
    // A line or two may be damaged; a file that is mostly something else is not ours.
    let good = found.sample.iter().filter(|line| all_numbers(line)).count();
    found.fields >= 4 && found.header.is_none() && good * 10 >= found.sample.len() * 9
}

/// An opened text file.
pub struct Csv {
    path: PathBuf,
    about: Lazy,
    layout: Arc<Layout>,
}

impl Csv {
    /// Opens a file; columns and unit from its header, or declared.
    ///
    /// # Errors
    /// When neither says them, or the file has no such line.
    pub fn open(path: &Path, declared: &Declared) -> Result<Csv, FormatError> {
        Csv::open_as(path, declared, None)
    }

    /// As [`Csv::open`], for a format that defines columns and unit of its files.
    pub(crate) fn open_as(
        path: &Path,
        declared: &Declared,
        defined: Option<(&[Column], TimeUnit)>,
    ) -> Result<Csv, FormatError> {
        let found = sniff::sniff(path)?;
        let columns = columns(path, declared, defined.map(|(columns, _)| columns), &found)?;
        let mut notes: Vec<String> = sniff::unit_note(found.unit, declared.time_unit).into_iter().collect();
        let stamps = stamps(&found, &columns);
        let unit = match declared.time_unit.or(found.unit) {
            Some(unit) => unit,
            None => match defined {
                // A unit of seconds with nothing after the point contradicts the definition.
                Some((_, unit))
                    if unit != TimeUnit::S
                        || stamps.len() < 10
                        || stamps.iter().any(|number| !number.is_whole()) =>
                {
                    unit
                }
                _ => {
                    let evidence = evidence::of_decimals(&stamps, found.lines, Of::Events);
                    return Err(FormatError::new(
                        path,
                        format!("the unit of the stamps is not stated ({})", evidence.text),
                        evidence.hint(),
                    )
                    .expected("a unit in the header, such as `t [us]`")
                    .undeclared("time_unit"));
                }
            },
        };
        let places = stamps.iter().map(|number| number.places()).max().unwrap_or(0).min(12);
        let tick_ns = (unit.ns() / 10_i64.pow(places.min(12))).max(1);
        let extent = declared.extent.or(found.extent);
        let scale = declared.coordinate_scale.unwrap_or(1).max(1);
        if scale > 1 {
            notes.push(format!("coordinates divided by {scale} and rounded to the nearest pixel"));
        }
        let has_t_in = columns.contains(&Column::TIn);
        let about = EventsAbout {
            extent,
            tick_ns,
            count: None,
            has_t_in,
            stamps: format!(
                "decimal {}{}",
                unit_name(unit),
                if places > 0 { format!(", {places} places") } else { String::new() }
            ),
            notes,
        };
        let layout = Layout {
            separator: found.separator,
            columns,
            unit,
            scale,
            extent,
            has_t_in,
            start: found.start,
            rules: Rules::default(),
        };
        Ok(Csv { path: path.into(), about: Lazy::new(path, declared, about), layout: Arc::new(layout) })
    }

    /// Unit of the stamps.
    pub(crate) fn unit(&self) -> TimeUnit {
        self.layout.unit
    }

    /// Counts what all lines hold.
    fn tally(&self, tally: &mut Tally) -> Result<(), FormatError> {
        TextCursor::open(&self.path, self.layout.clone())?.tally(tally)
    }

    /// Sets an extent that stands elsewhere: in the header of a picture.
    pub(crate) fn or_extent(mut self, extent: Option<Extent>) -> Csv {
        if self.about.before().extent.is_none() {
            self.about = self.about.with_extent(extent);
            self.layout = Arc::new(Layout { extent, ..(*self.layout).clone() });
        }
        self
    }
}

/// The stamps of the sample.
fn stamps(found: &Sniffed, columns: &[Column]) -> Vec<Decimal> {
    let Some(index) = columns.iter().position(|column| *column == Column::T) else { return Vec::new() };
    found.sample.iter().filter_map(|line| line.get(index).copied().flatten()).collect()
}

fn columns(
    path: &Path,
    declared: &Declared,
    defined: Option<&[Column]>,
    found: &Sniffed,
) -> Result<Vec<Column>, FormatError> {
    let columns = declared
        .columns
        .clone()
        .or_else(|| found.columns.clone())
        .or_else(|| defined.map(<[Column]>::to_vec));
    let Some(columns) = columns else {
        let proposal = sniff::proposal(&found.sample, found.fields);
        let hint = match &proposal {
            Some(columns) => {
                format!(
                    "state what they hold; from the values, `columns = {}` looks right (x before y is \
                         convention)",
                    sniff::column_names(columns)
                )
            }
            None => "state what they hold: `columns = [\"t\", \"x\", \"y\", \"p\"]`".into(),
        };
        return Err(FormatError::new(
            path,
            format!("{} columns without a header that names them", found.fields),
            hint,
        )
        .at(format!("line {}", found.start.1))
        .expected("a header line such as `t,x,y,p`")
        .undeclared("columns"));
    };
    let names = [(Column::T, "t"), (Column::X, "x"), (Column::Y, "y"), (Column::P, "p")];
    let count = |wanted: Column| columns.iter().filter(|column| **column == wanted).count();
    if let Some((_, name)) = names.iter().find(|(column, _)| count(*column) != 1) {
        let stated = found
            .header
            .as_ref()
            .filter(|_| declared.columns.is_none())
            .map_or("the declared columns".to_string(), |header| format!("the header {header}"));
        return Err(FormatError::new(
            path,
            format!("{stated} must name one column `{name}`"),
            "state `columns`: t, x, y, p, t_in or skip for every column, from the left",
        )
        .undeclared("columns"));
    }
    if columns.len() > found.fields && found.fields > 0 {
        return Err(FormatError::new(
            path,
            format!("{} columns", found.fields),
            "state one name for every column, from the left",
        )
        .at(format!("line {}", found.start.1))
        .expected(format!("{}", columns.len()))
        .undeclared("columns"));
    }
    // What follows the last known column need not be there.
    let used = columns.iter().rposition(|column| *column != Column::Skip).map_or(0, |last| last + 1);
    Ok(columns[..used].to_vec())
}

impl Recording for Csv {
    fn events_about(&self) -> Option<&EventsAbout> {
        Some(self.about.about(|tally| self.tally(tally)))
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        let settled = self.about.settled(|tally| self.tally(tally))?;
        let layout = Layout { rules: settled.rules, ..(*self.layout).clone() };
        Ok(settled.followed(Box::new(TextCursor::open(&self.path, Arc::new(layout))?)))
    }

    fn conventions(&self) -> Vec<Convention> {
        self.about
            .settled(|tally| self.tally(tally))
            .map_or_else(|_| Vec::new(), |settled| settled.conventions.clone())
    }

    fn facts(&self) -> Vec<(String, String)> {
        let separator = match self.layout.separator {
            Separator::Comma => "comma",
            Separator::Semicolon => "semicolon",
            Separator::Space => "space",
        };
        vec![
            ("columns".into(), sniff::column_names(&self.layout.columns)),
            ("separator".into(), separator.into()),
        ]
    }

    fn files(&self) -> Vec<PathBuf> {
        vec![self.path.clone()]
    }
}

/// Writes events as `t,x,y,p` or `t,x,y,p,t_in`, with a comment that names unit and extent.
pub struct CsvWriter<W: Write> {
    out: W,
    unit: TimeUnit,
    has_t_in: bool,
    line: Vec<u8>,
}

impl<W: Write> CsvWriter<W> {
    /// Begins a file: the comment and the header.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn new(
        mut out: W,
        unit: TimeUnit,
        extent: Option<Extent>,
        has_t_in: bool,
    ) -> std::io::Result<CsvWriter<W>> {
        let size = extent
            .map(|extent| format!(" width={} height={}", extent.width, extent.height))
            .unwrap_or_default();
        writeln!(out, "# photocurrent-events/1 time_unit={}{size}", unit_name(unit))?;
        writeln!(out, "{}", if has_t_in { "t,x,y,p,t_in" } else { "t,x,y,p" })?;
        Ok(CsvWriter { out, unit, has_t_in, line: Vec::with_capacity(1 << 16) })
    }

    /// Adds events. Stamps are written exactly, whatever the unit.
    ///
    /// # Errors
    /// When they cannot be written, or in-pixel times were promised and are not there.
    pub fn write(&mut self, chunk: &EventChunk) -> std::io::Result<()> {
        if self.has_t_in && chunk.t_in.is_none() && !chunk.is_empty() {
            return Err(std::io::Error::new(
                std::io::ErrorKind::InvalidInput,
                "these events have no in-pixel times, and the header promises them",
            ));
        }
        for k in 0..chunk.len() {
            stamp(&mut self.line, chunk.t[k], self.unit);
            write!(self.line, ",{},{},{}", chunk.x[k], chunk.y[k], chunk.on[k])?;
            if let Some(t_in) = chunk.t_in.as_ref().filter(|_| self.has_t_in) {
                self.line.push(b',');
                stamp(&mut self.line, t_in[k], self.unit);
            }
            self.line.push(b'\n');
            if self.line.len() > (1 << 16) - 128 {
                self.out.write_all(&self.line)?;
                self.line.clear();
            }
        }
        Ok(())
    }

    /// Writes what is left.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn finish(mut self) -> std::io::Result<W> {
        self.out.write_all(&self.line)?;
        self.out.flush()?;
        Ok(self.out)
    }
}

/// A stamp in a unit, with as many places as the unit has in nanoseconds, unless it is whole.
fn stamp(line: &mut Vec<u8>, t: i64, unit: TimeUnit) {
    let (per, magnitude) = (unit.ns().unsigned_abs(), t.unsigned_abs());
    let (whole, part) = (magnitude / per, magnitude % per);
    let sign = if t < 0 { "-" } else { "" };
    let places = match unit {
        TimeUnit::S => 9,
        TimeUnit::Ms => 6,
        TimeUnit::Us => 3,
        TimeUnit::Ns => 0,
    };
    // Writing into memory does not fail.
    let _ =
        if part == 0 { write!(line, "{sign}{whole}") } else { write!(line, "{sign}{whole}.{part:0places$}") };
}
