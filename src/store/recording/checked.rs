//! Datasets and attributes of a recording, compared with what the format demands.

use crate::error::StoreError;
use crate::hdf::grid::Grid;
use crate::hdf::{Item, Opened, locked};

/// The format, the value of the attribute `format`.
pub const FORMAT: &str = "photocurrent-recording/1";

/// A dataset that the format demands, with `unit` when it holds times.
pub(super) fn required<T: Item>(
    opened: &Opened,
    name: &str,
    unit: Option<&str>,
) -> Result<Grid<T>, StoreError> {
    let at = format!("/{name}");
    let missing = || {
        opened.content(
            &at,
            "nothing",
            format!("a dataset of {}", T::type_descriptor()),
            format!("write {at} as the recording format says"),
        )
    };
    let grid = Grid::open(opened, name)?.ok_or_else(missing)?;
    if let Some(unit) = unit {
        check_unit(opened, name, unit)?;
    }
    Ok(grid)
}

/// Microseconds that pass for nanoseconds would go unnoticed for long, so a unit must be stated.
fn check_unit(opened: &Opened, name: &str, unit: &str) -> Result<(), StoreError> {
    let at = format!("/{name}");
    let Some(dataset) = opened.dataset(name)? else { return Ok(()) };
    let found = opened.text_attribute(&dataset, &at, "unit")?;
    if found.as_deref() == Some(unit) {
        return Ok(());
    }
    let found = found.map_or("no attribute `unit`".into(), |found| format!("unit = \"{found}\""));
    Err(opened.content(
        &at,
        found,
        format!("unit = \"{unit}\""),
        format!("write times as i64 nanoseconds and set the attribute `unit` to \"{unit}\""),
    ))
}

/// A column of `count` numbers.
pub(super) fn column<T: Item>(
    opened: &Opened,
    name: &str,
    count: usize,
    like: &str,
    unit: Option<&str>,
) -> Result<Grid<T>, StoreError> {
    let grid = required(opened, name, unit)?;
    check_column(opened, name, &grid, count, like)?;
    Ok(grid)
}

pub(super) fn check_column<T: Item>(
    opened: &Opened,
    name: &str,
    grid: &Grid<T>,
    count: usize,
    like: &str,
) -> Result<(), StoreError> {
    if grid.shape != [count] {
        let expected = format!("[{count}], as {like} has");
        return Err(opened.content(
            &format!("/{name}"),
            format!("the shape {:?}", grid.shape),
            expected,
            "datasets that belong together have one length",
        ));
    }
    Ok(())
}

/// An integer attribute of a group.
pub(super) fn group_integer(opened: &Opened, group: &str, name: &str) -> Result<Option<i64>, StoreError> {
    match opened.group(group)? {
        Some(found) => opened.integer_attribute(&found, &format!("/{group}"), name),
        None => Ok(None),
    }
}

/// Is there such a group?
pub(super) fn has_group(opened: &Opened, name: &str) -> bool {
    locked(|| opened.file.link_exists(name))
}
