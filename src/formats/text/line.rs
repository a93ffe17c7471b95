//! One line of text becomes one event, or the reason why not.

use super::fields::Separator;
use super::layout::Layout;
use crate::convention::NONE;
use crate::decimal::Decimal;
use crate::declared::Column;
use crate::error::Cause;

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

    /// Why the event is left out.
    pub(crate) fn cause(self) -> Cause {
        match self {
            Wrong::Short(_) | Wrong::NoNumber(_) => Cause::Damage,
            Wrong::Time => Cause::Stamp,
            Wrong::Polarity => Cause::Polarity,
            Wrong::Outside => Cause::Outside,
        }
    }

    /// What is wrong with this line.
    pub(crate) fn what(self, line: &[u8], layout: &Layout) -> String {
        let shown = shown(line);
        match self {
            Wrong::Short(found) => {
                format!("{found} of {} columns in {shown}; the line was left out", layout.columns.len())
            }
            Wrong::NoNumber(column) => {
                format!("column {} of {shown} is no number; the line was left out", column + 1)
            }
            Wrong::Time => format!(
                "the stamp of {shown} does not fit into 64 bits of nanoseconds; the event was left out"
            ),
            Wrong::Polarity => {
                format!("the polarity of {shown} is none of 0, 1, -1, true, false; the event was left out")
            }
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
    let cut: String =
        String::from_utf8_lossy(&line[..line.len().min(4 * MOST)]).trim().chars().take(MOST).collect();
    format!("`{}`{}", cut.escape_debug(), if cut.len() < line.trim_ascii().len() { " ..." } else { "" })
}

/// A line as it is stored: stamps in ns, coordinates in pixels, the polarity as a number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Stored {
    pub(crate) t: i64,
    pub(crate) x: i64,
    pub(crate) y: i64,
    pub(crate) p: i64,
    t_in: i64,
}

/// Reads one line that is neither empty nor a comment.
#[inline]
pub(crate) fn stored(line: &[u8], layout: &Layout) -> Result<Stored, Wrong> {
    let mut event = Stored::default();
    let mut fields = layout.separator.fields(line);
    for (index, column) in layout.columns.iter().enumerate() {
        // An empty field of a line that goes on is a column that is there.
        let field = fields
            .next()
            .filter(|field| !(field.is_empty() && layout.separator == Separator::Space))
            .ok_or(Wrong::Short(index))?;
        match column {
            Column::Skip => {}
            Column::T => event.t = time(field, index, layout)?,
            Column::TIn => event.t_in = time(field, index, layout)?,
            Column::X => event.x = coordinate(field, index, layout)?,
            Column::Y => event.y = coordinate(field, index, layout)?,
            Column::P => event.p = polarity(field, index)?,
        }
    }
    Ok(event)
}

/// As [`stored`], as an event within the array.
#[inline]
pub(crate) fn read(line: &[u8], layout: &Layout) -> Result<Event, Wrong> {
    let stored = stored(line, layout)?;
    let on = layout.rules.on(stored.p).ok_or(Wrong::Polarity)?;
    let (width, height) = layout.extent.map_or((1 << 16, 1 << 16), |extent| (extent.width, extent.height));
    let inside = |place: i64, limit: u32| {
        u16::try_from(layout.rules.pixel(place))
            .ok()
            .filter(|place| u32::from(*place) < limit)
            .ok_or(Wrong::Outside)
    };
    Ok(Event {
        t: stored.t,
        x: inside(stored.x, width)?,
        y: inside(stored.y, height)?,
        on,
        t_in: stored.t_in,
    })
}

#[inline]
fn time(field: &[u8], index: usize, layout: &Layout) -> Result<i64, Wrong> {
    Decimal::read(field).ok_or(Wrong::NoNumber(index))?.ns(layout.unit).ok_or(Wrong::Time)
}

#[inline]
fn coordinate(field: &[u8], index: usize, layout: &Layout) -> Result<i64, Wrong> {
    match short(field).filter(|_| layout.scale == 1) {
        Some(pixel) => Ok(i64::from(pixel)),
        None => Decimal::read(field).ok_or(Wrong::NoNumber(index))?.pixel(layout.scale).ok_or(Wrong::Outside),
    }
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

/// The polarity as it is stored; true is 1, false 0.
#[inline]
fn polarity(field: &[u8], index: usize) -> Result<i64, Wrong> {
    match field {
        b"1" | b"+1" | b"true" | b"True" | b"TRUE" => Ok(1),
        b"0" | b"false" | b"False" | b"FALSE" => Ok(0),
        b"-1" => Ok(-1),
        _ => {
            // 1.0 and -1.0000e+00 are written by programs that keep all columns as floats.
            let number = Decimal::read(field).ok_or(Wrong::NoNumber(index))?;
            Ok(number.pixel(1).filter(|_| number.is_whole()).unwrap_or(NONE))
        }
    }
}
