//! Events that numpy saved: an npz archive with arrays x, y, t, p, one npy file of records, or one array of N
//! x 4.
//!
//! The unit of the stamps is in none of these, and the user states it; of an array of N x 4 the order of the
//! columns too.

use crate::convention::{Lazy, Rules, Settled};
use crate::declared::{Column, Declared, TimeUnit};
use crate::error::{FormatError, Loss};
use crate::evidence::{self, Of, unit_name};
use crate::format::{Format, Probe};
use crate::npy::header::{Element, Kind};
use crate::npy::place::{self, Place};
use crate::npy::table::{Reading, Table, TableCursor, column_named};
use crate::recording::{Convention, EventCursor, EventsAbout, Recording};
use crate::text::sniff::{column_names, proposal};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Events in npz and npy files.
pub(crate) static FORMAT: Format = Format {
    id: "npz",
    name: "numpy arrays of events (npz, npy)",
    recognises,
    open: |path, declared| Ok(Box::new(Npz::open(path, declared)?)),
};

/// Begins as an npy file does, or as a zip archive whose first member is one.
fn recognises(probe: &Probe) -> bool {
    if probe.head.starts_with(b"\x93NUMPY") {
        return true;
    }
    let name_length =
        probe.head.get(26..28).map_or(0, |bytes| usize::from(u16::from_le_bytes([bytes[0], bytes[1]])));
    probe.head.starts_with(b"PK\x03\x04")
        && probe.head.get(30..30 + name_length).is_some_and(|name| name.ends_with(b".npy"))
}

/// Events in the columns of arrays, decided how to read when that is first needed.
pub(crate) struct Events {
    pub(crate) about: Lazy,
    pub(crate) table: Arc<Table>,
    pub(crate) reading: Reading,
}

impl Events {
    fn settled(&self) -> Result<&Settled, FormatError> {
        self.about.settled(|tally| self.table.tally(self.reading, tally))
    }

    pub(crate) fn about(&self) -> &EventsAbout {
        self.about.about(|tally| self.table.tally(self.reading, tally))
    }

    pub(crate) fn open(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        let settled = self.settled()?;
        let reading = Reading { rules: settled.rules, ..self.reading };
        Ok(settled.followed(Box::new(TableCursor::open(self.table.clone(), reading)?)))
    }

    pub(crate) fn conventions(&self) -> Vec<Convention> {
        self.settled().map_or_else(|_| Vec::new(), |settled| settled.conventions.clone())
    }
}

/// An opened npz or npy file.
pub(crate) struct Npz {
    path: PathBuf,
    events: Events,
    losses: Vec<Loss>,
    names: String,
}

impl Npz {
    /// Opens a file.
    ///
    /// # Errors
    /// When it holds no events, or its unit or its columns are not declared.
    pub(crate) fn open(path: &Path, declared: &Declared) -> Result<Npz, FormatError> {
        let (mut table, names) = table(path, declared)?;
        let losses = table.compare()?;
        let (unit, mut notes) = unit(path, &table, declared, None)?;
        let scale = declared.coordinate_scale.unwrap_or(1).max(1);
        if scale > 1 {
            notes.push(format!("coordinates divided by {scale} and rounded to the nearest pixel"));
        }
        notes.extend(rounded(&table));
        let has_t_in = table.scalar(Column::TIn).is_some();
        let reading = Reading {
            unit,
            scale,
            wraps_at: None,
            extent: declared.extent,
            has_t_in,
            rules: Rules::default(),
        };
        let about = Lazy::new(path, declared, about(&table, &reading, notes));
        let events = Events { about, table: Arc::new(table), reading };
        Ok(Npz { path: path.into(), events, losses, names })
    }
}

/// Notes on coordinates that are rounded.
pub(crate) fn rounded(table: &Table) -> impl Iterator<Item = String> {
    let is_float = |column| table.scalar(column).is_some_and(|scalar| scalar.kind == Kind::Float);
    [(Column::X, "x"), (Column::Y, "y")]
        .into_iter()
        .filter(move |(column, _)| is_float(*column))
        .map(|(_, name)| format!("{name} is stored as floats and was rounded to the nearest pixel"))
}

/// What is known of a table before it is read.
pub(crate) fn about(table: &Table, reading: &Reading, mut notes: Vec<String>) -> EventsAbout {
    let scalar = table.scalar(Column::T);
    let is_float = scalar.is_some_and(|scalar| scalar.kind == Kind::Float);
    if let Some(scalar) = scalar.filter(|scalar| scalar.kind == Kind::Float && scalar.bytes == 4) {
        notes.push(format!(
            "stamps are stored as {}, of 24 bits: their step grows to 1e-7 of the time since 0",
            scalar.name()
        ));
    }
    EventsAbout {
        extent: reading.extent,
        tick_ns: if is_float { 1 } else { reading.unit.ns() },
        count: Some(table.rows),
        has_t_in: reading.has_t_in,
        stamps: format!(
            "{} {}",
            scalar.map(|scalar| scalar.name()).unwrap_or_default(),
            unit_name(reading.unit)
        ),
        notes,
    }
}

/// The unit of the stamps: declared, or defined by the format for fractions; or an error with what they look
/// like.
pub(crate) fn unit(
    path: &Path,
    table: &Table,
    declared: &Declared,
    fractions: Option<TimeUnit>,
) -> Result<(TimeUnit, Vec<String>), FormatError> {
    if let Some(unit) = declared.time_unit {
        return Ok((unit, Vec::new()));
    }
    let is_float = table.scalar(Column::T).is_some_and(|scalar| scalar.kind == Kind::Float);
    let sample = table.sample(Column::T, 4096)?;
    let whole = sample.iter().all(|stamp| stamp.fract() == 0.0);
    if let Some(unit) = fractions.filter(|_| is_float && (!whole || sample.len() < 10)) {
        return Ok((unit, Vec::new()));
    }
    let evidence = evidence::of_values(&sample, whole, table.rows as f64, Of::Events);
    Err(FormatError::new(
        path,
        format!("the unit of the stamps is not stated ({})", evidence.text),
        evidence.hint(),
    )
    .undeclared("time_unit"))
}

/// The arrays of a file as columns of events, and their names for messages.
pub(crate) fn table(path: &Path, declared: &Declared) -> Result<(Table, String), FormatError> {
    let is_archive = path_begins(path, b"PK")?;
    let arrays = if is_archive {
        place::archive(path)?
    } else {
        vec![(String::new(), Place { path: path.into(), member: None })]
    };
    let names = if arrays.is_empty() {
        "no arrays".to_string()
    } else {
        arrays.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>().join(", ")
    };
    let lone = arrays.len() == 1;
    let mut table = Table::default();
    let mut columns_of = None;
    for (name, place) in arrays {
        if let Some(column) = column_named(&name) {
            let header = place.header()?;
            table.add_column(column, place, &header)?;
        } else if name == "xy" {
            let header = place.header()?;
            table.add_columns(&[Column::X, Column::Y], place, &header)?;
        } else if columns_of.is_none() && (lone || has_rows(&place)) {
            columns_of = Some(place);
        }
    }
    // Arrays with names of their own go before one that holds everything.
    if let Some(place) = columns_of.filter(|_| table.sources.is_empty()) {
        let header = place.header()?;
        match (&header.element, &declared.columns) {
            (Element::Record(..), _) => table.add_records(place, &header)?,
            (_, Some(columns)) => table.add_columns(columns, place, &header)?,
            (Element::Number(_), None) => return Err(undeclared_columns(path, place, &header)),
        }
    }
    table.check(path, &names)?;
    Ok((table, names))
}

/// Could this array hold an event in every row?
fn has_rows(place: &Place) -> bool {
    place.header().is_ok_and(|header| match header.element {
        Element::Record(..) => header.shape.len() == 1,
        Element::Number(_) => header.shape.len() == 2 && (4..=16).contains(&header.shape[1]),
    })
}

fn undeclared_columns(path: &Path, place: Place, header: &crate::npy::header::Header) -> FormatError {
    let fields = header.shape.get(1).map_or(0, |width| usize::try_from(*width).unwrap_or(usize::MAX));
    if header.shape.len() != 2 || !(4..=16).contains(&fields) {
        return FormatError::new(
            path,
            format!("one array of shape {:?}", header.shape),
            "save events as arrays t, x, y, p, or as one array of N x 4",
        )
        .expected("events, one in a row");
    }
    // Their values may show the order; as decimal text they are judged as those of a text file are.
    let mut table = Table::default();
    let mut sample: Vec<Vec<Option<crate::decimal::Decimal>>> = Vec::new();
    for index in 0..fields {
        let mut columns = vec![Column::Skip; fields];
        columns[index] = Column::T;
        table.sources.clear();
        let values = table
            .add_columns(&columns, place.clone(), header)
            .and_then(|()| table.sample(Column::T, 1000))
            .unwrap_or_default();
        sample.resize(values.len().max(sample.len()), Vec::new());
        for (row, value) in values.iter().enumerate() {
            sample[row].push(crate::decimal::Decimal::read(format!("{value}").as_bytes()));
        }
    }
    let hint = match proposal(&sample, fields) {
        Some(columns) => format!(
            "state what they hold; from the values, `columns = {}` looks right (x before y is convention)",
            column_names(&columns)
        ),
        None => "state what they hold: `columns = [\"t\", \"x\", \"y\", \"p\"]`".into(),
    };
    FormatError::new(
        path,
        format!("one array of shape {:?}, and nothing says what its columns hold", header.shape),
        hint,
    )
    .undeclared("columns")
}

fn path_begins(path: &Path, with: &[u8]) -> Result<bool, FormatError> {
    Ok(Probe::new(path)?.head.starts_with(with))
}

impl Recording for Npz {
    fn events_about(&self) -> Option<&EventsAbout> {
        Some(self.events.about())
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        self.events.open()
    }

    fn conventions(&self) -> Vec<Convention> {
        self.events.conventions()
    }

    fn facts(&self) -> Vec<(String, String)> {
        if self.names.is_empty() { Vec::new() } else { vec![("arrays".into(), self.names.clone())] }
    }

    fn losses(&self) -> Vec<Loss> {
        self.losses.clone()
    }

    fn files(&self) -> Vec<PathBuf> {
        vec![self.path.clone()]
    }
}
