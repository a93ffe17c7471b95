//! Tables: one dataset per column, with names, kinds and notes in one JSON text.
//!
//! A column of text is stored as its UTF-8 bytes and the offset of each cell, so that any text survives, and
//! any reader can take it apart.

use super::columns::{create_group, required};
use crate::error::StoreError;
use crate::hdf::write::ColumnWriter;
use crate::hdf::{Item, Opened};
use photocurrent_core::Table;
use photocurrent_core::table::Column;
use serde::{Deserialize, Serialize};

const DAMAGED: &str = "the artefact is damaged: run the pipeline again";

#[derive(Serialize, Deserialize)]
struct Form {
    columns: Vec<ColumnForm>,
    notes: Vec<(String, String)>,
}

#[derive(Serialize, Deserialize)]
struct ColumnForm {
    name: String,
    kind: Kind,
    dataset: String,
}

#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Kind {
    Numbers,
    Integers,
    Texts,
}

/// Writes a table; called once per file.
pub(super) fn write(opened: &Opened, table: &Table) -> Result<(), StoreError> {
    create_group(opened, "table")?;
    let mut columns = Vec::new();
    for (i, (name, column)) in table.columns().iter().enumerate() {
        let dataset = format!("table/c{i}");
        let kind = match column {
            Column::Numbers(cells) => write_column(opened, &dataset, name, cells).map(|_| Kind::Numbers)?,
            Column::Integers(cells) => write_column(opened, &dataset, name, cells).map(|_| Kind::Integers)?,
            Column::Texts(cells) => {
                let mut offsets = vec![0u64];
                for cell in cells {
                    offsets.push(offsets[offsets.len() - 1] + cell.len() as u64);
                }
                write_column(opened, &format!("{dataset}_offsets"), name, &offsets)?;
                write_column(opened, &dataset, name, cells.concat().as_bytes()).map(|_| Kind::Texts)?
            }
        };
        columns.push(ColumnForm { name: name.clone(), kind, dataset });
    }
    let form = Form { columns, notes: table.notes.clone() };
    let json = serde_json::to_string(&form)
        .map_err(|error| StoreError::Misuse { path: opened.path.clone(), what: error.to_string() })?;
    opened.set_text("table/form", &json)
}

fn write_column<T: Item>(opened: &Opened, dataset: &str, name: &str, cells: &[T]) -> Result<(), StoreError> {
    let mut column = ColumnWriter::new(opened, dataset);
    column.append(cells)?;
    opened.set_text_attribute(column.finish()?.dataset(), "name", name)
}

/// Reads a table, whole.
pub(super) fn read(opened: &Opened) -> Result<Table, StoreError> {
    let dataset = opened
        .dataset("table/form")?
        .ok_or_else(|| opened.content("/table/form", "nothing", "a text", DAMAGED))?;
    let text = opened.text("/table/form", &dataset)?;
    let form: Form = serde_json::from_str(&text)
        .map_err(|error| opened.content("/table/form", error.to_string(), "the form of a table", DAMAGED))?;
    let mut table = Table::default();
    let mut rows = None;
    for ColumnForm { name, kind, dataset } in form.columns {
        let column = match kind {
            Kind::Numbers => Column::Numbers(read_column(opened, &dataset)?),
            Kind::Integers => Column::Integers(read_column(opened, &dataset)?),
            Kind::Texts => Column::Texts(read_texts(opened, &dataset)?),
        };
        // Core panics on columns of unequal length, which is right for a node and wrong for a file.
        if *rows.get_or_insert(column.len()) != column.len() {
            return Err(opened.content(
                &format!("/{dataset}"),
                format!("{} cells", column.len()),
                "as many as the column before",
                DAMAGED,
            ));
        }
        table = table.with(&name, column);
    }
    Ok(form.notes.into_iter().fold(table, |table, (name, text)| table.note(&name, text)))
}

fn read_column<T: Item>(opened: &Opened, dataset: &str) -> Result<Vec<T>, StoreError> {
    let grid = required::<T>(opened, dataset)?;
    grid.read(&vec![0; grid.shape.len()], &grid.shape.clone())
}

fn read_texts(opened: &Opened, dataset: &str) -> Result<Vec<String>, StoreError> {
    let offsets: Vec<u64> = read_column(opened, &format!("{dataset}_offsets"))?;
    let bytes: Vec<u8> = read_column(opened, dataset)?;
    let damaged = || {
        opened.content(
            &format!("/{dataset}"),
            "bytes that are no cells of text",
            "UTF-8 text with rising offsets",
            DAMAGED,
        )
    };
    offsets
        .windows(2)
        .map(|ends| {
            bytes
                .get(ends[0] as usize..ends[1] as usize)
                .and_then(|cell| std::str::from_utf8(cell).ok())
                .map(String::from)
                .ok_or_else(damaged)
        })
        .collect()
}
