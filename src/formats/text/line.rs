//! One line of text becomes one event, or the reason why not.

use super::{Layout, Separator};
use crate::decimal::Decimal;
use crate::declared::Column;

/// An event as a line has it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Event {
    pub(crate) t: i64,
    pub(crate) x: u16,
    pub(crate) y: u16,
    pub(crate) on: bool,
    pub(crate) t_in: i64,
}

/// Why a line is no event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Wrong {
    /// It ends after so many fields.
    Short(usize),
    /// The field of this column (from 0) is no number.
    NoNumber(usize),
    /// Its stamp does not fit into 64 bits of nanoseconds.
    Time,
    /// Its polarity is none.
    Polarity,
    /// It lies outside the pixel array, or has a negative coordinate.
    Outside,
}

impl Wrong {
    /// The kind of loss.
    pub(crate) fn kind(self) -> &'static str {
        match self {
            Wrong::Short(_) => "lines with too few columns were left out",
            Wrong::NoNumber(_) => "lines with a field that is no number were left out",
            Wrong::Time => "events whose stamp is beyond 292 years were left out",
            Wrong::Polarity => "events whose polarity is none of 0, 1, -1, true, false were left out",
            Wrong::Outside => "events outside the pixel array were left out",
        }
    }

    /// What is wrong with this line.
    pub(crate) fn what(self, line: &[u8], layout: &Layout) -> String {
        let shown = shown(line);
        match self {
            Wrong::Short(found) => format!("{found} of {} columns in {shown}; the line was left out", layout.columns.len()),
            Wrong::NoNumber(column) => format!("column {} of {shown} is no number; the line was left out", column + 1),
            Wrong::Time => format!("the stamp of {shown} does not fit into 64 bits of nanoseconds; the event was left out"),
            Wrong::Polarity => format!("the polarity of {shown} is none of 0, 1, -1, true, false; the event was left out"),
            Wrong::Outside => match layout.extent {
                Some(extent) => format!("the pixel of {shown} lies outside {extent}; the event was left out"),
                None => format!("the pixel of {shown} lies outside any array; the event was left out"),
            },
        }
    }
}

/// The beginning of a line, for messages.
pub(crate) fn shown(line: &[u8]) -> String {
    const MOST: usize = 60;
    let cut: String = String::from_utf8_lossy(&line[..line.len().min(4 * MOST)]).trim().chars().take(MOST).collect();
    format!("`{}`{}", cut.escape_debug(), if cut.len() < line.trim_ascii().len() { " ..." } else { "" })
}

/// Reads one line that is neither empty nor a comment.
#[inline]
pub(crate) fn read(line: &[u8], layout: &Layout) -> Result<Event, Wrong> {
    let mut event = Event::default();
    let mut fields = layout.separator.fields(line);
    for (index, column) in layout.columns.iter().enumerate() {
        // An empty field of a line that goes on is a column that is there.
        let field = fields.next().filter(|field| !(field.is_empty() && layout.separator == Separator::Space)).ok_or(Wrong::Short(index))?;
        match column {
            Column::Skip => {}
            Column::T => event.t = time(field, index, layout)?,
            Column::TIn => event.t_in = time(field, index, layout)?,
            Column::X => event.x = coordinate(field, index, layout, true)?,
            Column::Y => event.y = coordinate(field, index, layout, false)?,
            Column::P => event.on = polarity(field, index)?,
        }
    }
    Ok(event)
}

#[inline]
fn time(field: &[u8], index: usize, layout: &Layout) -> Result<i64, Wrong> {
    Decimal::read(field).ok_or(Wrong::NoNumber(index))?.ns(layout.unit).ok_or(Wrong::Time)
}

#[inline]
fn coordinate(field: &[u8], index: usize, layout: &Layout, across: bool) -> Result<u16, Wrong> {
    let pixel = match short(field).filter(|_| layout.scale == 1) {
        Some(pixel) => i64::from(pixel),
        None => Decimal::read(field).ok_or(Wrong::NoNumber(index))?.pixel(layout.scale).ok_or(Wrong::Outside)?,
    };
    let limit = layout.extent.map_or(1 << 16, |extent| if across { extent.width } else { extent.height });
    if pixel < 0 || pixel >= i64::from(limit) { Err(Wrong::Outside) } else { u16::try_from(pixel).map_err(|_| Wrong::Outside) }
}

/// One to six digits, the usual case.
#[inline]
fn short(field: &[u8]) -> Option<u32> {
    if field.is_empty() || field.len() > 6 {
        return None;
    }
    let mut value = 0;
    for byte in field {
        let digit = byte.wrapping_sub(b'0');
        if digit > 9 {
            return None;
        }
        value = value * 10 + u32::from(digit);
    }
    Some(value)
}

/// 1 is ON; 0 and -1 are OFF.
#[inline]
fn polarity(field: &[u8], index: usize) -> Result<bool, Wrong> {
    match field {
        b"1" | b"+1" | b"true" | b"True" | b"TRUE" => Ok(true),
        b"0" | b"-1" | b"false" | b"False" | b"FALSE" => Ok(false),
        _ => {
            // 1.0 and -1.0000e+00 are written by programs that keep all columns as floats.
            let number = Decimal::read(field).ok_or(Wrong::NoNumber(index))?;
            match number.pixel(1).filter(|_| number.is_whole()) {
                Some(1) => Ok(true),
                Some(0 | -1) => Ok(false),
                _ => Err(Wrong::Polarity),
            }
        }
    }
}
