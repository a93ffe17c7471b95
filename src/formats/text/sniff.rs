//! What the first lines of a text file say: separator, names of columns, unit, extent.
//!
//! A header line may hold units (`t [us]`, `timestamp_us`) and the size of the array as faery writes it
//! (`x@320`). A comment may hold them too (`# time_unit=us width=346 height=260`), or the names of the
//! columns, as numpy writes them. E2VID's files begin with a line `width height`.

use super::fields::{Separator, is_comment};
use crate::decimal::Decimal;
use crate::declared::{Column, TimeUnit};
use crate::error::FormatError;
use crate::evidence::{unit_in_brackets, unit_name, unit_named};
use photocurrent_core::Extent;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// Bytes at the beginning and at the end that are looked at.
const LOOK: u64 = 1 << 16;

/// What was found.
#[derive(Clone, Debug)]
pub(crate) struct Sniffed {
    pub(crate) separator: Separator,
    /// From a header line or a comment.
    pub(crate) columns: Option<Vec<Column>>,
    /// The header as written, for messages.
    pub(crate) header: Option<String>,
    pub(crate) unit: Option<TimeUnit>,
    pub(crate) extent: Option<Extent>,
    /// Byte and number of the first line of data.
    pub(crate) start: (u64, u64),
    /// Fields of the first line of data; 0 without data.
    pub(crate) fields: usize,
    /// Lines of data at the beginning, then at the end, as fields of numbers (`None` for what is no number).
    pub(crate) sample: Vec<Vec<Option<Decimal>>>,
    /// Lines of data in the file, about.
    pub(crate) lines: f64,
}

/// Looks at a file.
pub(crate) fn sniff(path: &Path) -> Result<Sniffed, FormatError> {
    let io = |error: std::io::Error| FormatError::io(path, &error);
    let mut file = File::open(path).map_err(io)?;
    let bytes = file.metadata().map_err(io)?.len();
    let mut head = Vec::new();
    file.by_ref().take(LOOK).read_to_end(&mut head).map_err(io)?;
    let mut tail = Vec::new();
    if bytes > LOOK {
        file.seek(SeekFrom::Start(bytes.saturating_sub(LOOK).max(LOOK))).map_err(io)?;
        file.take(LOOK).read_to_end(&mut tail).map_err(io)?;
    }
    if head.starts_with(b"\xff\xfe") || head.starts_with(b"\xfe\xff") {
        return Err(
            FormatError::new(path, "this text is in UTF-16", "convert it to UTF-8").expected("text in UTF-8")
        );
    }
    Ok(look(&head, &tail, bytes))
}

/// As [`sniff`], of the first and the last bytes of a file of `bytes`.
pub(crate) fn look(head: &[u8], tail: &[u8], bytes: u64) -> Sniffed {
    let mut found = Sniffed {
        separator: Separator::Space,
        columns: None,
        header: None,
        unit: None,
        extent: None,
        start: (0, 1),
        fields: 0,
        sample: Vec::new(),
        lines: 0.0,
    };
    let (mut width, mut height, mut commented) = (None, None, None);
    let mut offset = if head.starts_with(b"\xef\xbb\xbf") { 3 } else { 0 };
    let mut number = 1;
    let (mut data_bytes, mut data_lines) = (0, 0_u64);
    while offset < head.len() {
        let end = memchr::memchr(b'\n', &head[offset..]).map_or(head.len(), |length| offset + length);
        // A line that the look cuts off is not judged, unless it is all there is.
        let whole = end < head.len() || bytes <= head.len() as u64;
        let line = &head[offset..end];
        let next = (end + 1).min(head.len());
        if is_comment(line) {
            if found.sample.is_empty() {
                comment(line, &mut found, &mut width, &mut height, &mut commented);
            }
        } else if whole {
            let separator = Separator::of(line);
            let fields = numbers(line, separator);
            let numeric = fields.iter().filter(|field| field.is_some()).count();
            if found.sample.is_empty() && found.header.is_none() && numeric == 0 {
                header(line, separator, &mut found, &mut width, &mut height);
            } else if found.sample.is_empty() && is_extent(&fields) && next_fields(head, next) > 2 {
                width = whole_number(&fields, 0);
                height = whole_number(&fields, 1);
            } else {
                if found.sample.is_empty() {
                    found.separator = separator;
                    found.fields = fields.len();
                    found.start = (offset as u64, number);
                }
                data_bytes += next - offset;
                data_lines += 1;
                found.sample.push(numbers(line, found.separator));
            }
        }
        if found.sample.is_empty() {
            found.start = (next as u64, number + 1);
        }
        offset = next;
        number += 1;
    }
    if data_lines > 0 {
        let rest = bytes.saturating_sub(found.start.0);
        found.lines = (rest as f64 / (data_bytes as f64 / data_lines as f64)).max(data_lines as f64);
    }
    // The first line of the tail is mostly cut.
    for line in tail.split(|&byte| byte == b'\n').skip(1).filter(|line| !is_comment(line)) {
        found.sample.push(numbers(line, found.separator));
    }
    if found.columns.is_none() {
        found.columns = commented;
    }
    if let (Some(width), Some(height)) = (width, height) {
        found.extent = Some(Extent { width, height });
    }
    found
}

fn numbers(line: &[u8], separator: Separator) -> Vec<Option<Decimal>> {
    separator.fields(line).map(Decimal::read).collect()
}

fn next_fields(head: &[u8], from: usize) -> usize {
    let line = head[from..].split(|&byte| byte == b'\n').find(|line| !is_comment(line)).unwrap_or(&[]);
    Separator::of(line).fields(line).count()
}

fn is_extent(fields: &[Option<Decimal>]) -> bool {
    fields.len() == 2 && (0..2).all(|index| whole_number(fields, index).is_some())
}

fn whole_number(fields: &[Option<Decimal>], index: usize) -> Option<u32> {
    let number = fields.get(index).copied().flatten().filter(|number| number.is_whole())?;
    number.pixel(1).and_then(|value| u32::try_from(value).ok()).filter(|value| (1..=1 << 16).contains(value))
}

/// A name of a column: what it holds, the unit and the size that it states.
fn name(text: &str) -> (Column, Option<TimeUnit>, Option<u32>) {
    let mut text = text.trim().trim_matches(['"', '\'']).trim().to_ascii_lowercase();
    let mut size = None;
    if let Some((before, after)) = text.clone().split_once('@') {
        size = after.trim().parse().ok().filter(|size| (1..=1 << 16).contains(size));
        text = before.trim().into();
    }
    let mut unit = unit_in_brackets(&mut text);
    if let Some((before, after)) = text.clone().rsplit_once(['_', '/', ':'])
        && let Some(stated) = unit_named(after)
    {
        unit = Some(stated);
        text = before.trim().into();
    }
    let column = match text.as_str() {
        "t" | "ts" | "time" | "times" | "timestamp" | "timestamps" | "t_off" => Column::T,
        "t_in" | "tin" => Column::TIn,
        "x" | "xs" | "col" | "column" => Column::X,
        "y" | "ys" | "row" => Column::Y,
        "p" | "ps" | "pol" | "polarity" | "polarities" | "on" => Column::P,
        _ => Column::Skip,
    };
    (column, unit, size)
}

/// The names of a header line; a unit in brackets that a space cut off its name belongs to the name before.
fn names(line: &[u8], separator: Separator) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for field in separator.fields(line) {
        let field = String::from_utf8_lossy(field).into_owned();
        match names.last_mut() {
            Some(last) if separator == Separator::Space && field.starts_with(['[', '(']) => {
                last.push_str(&field)
            }
            _ => names.push(field),
        }
    }
    names
}

fn header(
    line: &[u8],
    separator: Separator,
    found: &mut Sniffed,
    width: &mut Option<u32>,
    height: &mut Option<u32>,
) {
    found.header = Some(super::line::shown(line));
    let mut columns = Vec::new();
    for text in names(line, separator) {
        let (column, unit, size) = name(&text);
        match column {
            Column::T | Column::TIn => found.unit = found.unit.or(unit),
            Column::X => *width = width.or(size),
            Column::Y => *height = height.or(size),
            _ => {}
        }
        columns.push(column);
    }
    found.columns = Some(columns);
}

/// `key=value` pairs of a comment, names of columns in it, and a sentence such as "timestamps in
/// microseconds".
fn comment(
    line: &[u8],
    found: &mut Sniffed,
    width: &mut Option<u32>,
    height: &mut Option<u32>,
    columns: &mut Option<Vec<Column>>,
) {
    let text = String::from_utf8_lossy(line);
    let text = text.trim().trim_start_matches(['#', '%']).trim();
    let words: Vec<&str> = text.split([' ', '\t', ',', ';']).filter(|word| !word.is_empty()).collect();
    for (index, word) in words.iter().enumerate() {
        if let Some((key, value)) = word.split_once(['=', ':']) {
            // "unit: us" leaves the value to the next word.
            let value = if value.is_empty() { words.get(index + 1).copied().unwrap_or("") } else { value };
            match key.to_ascii_lowercase().as_str() {
                "time_unit" | "unit" | "timestamp_unit" | "t" => {
                    found.unit = found.unit.or(unit_named(value))
                }
                "width" => *width = width.or(value.parse().ok()),
                "height" => *height = height.or(value.parse().ok()),
                _ => {}
            }
        }
        if word.eq_ignore_ascii_case("in")
            && (text.to_ascii_lowercase().contains("time") || text.to_ascii_lowercase().starts_with('t'))
        {
            found.unit = found.unit.or(words
                .get(index + 1)
                .and_then(|word| unit_named(word.trim_matches(['.', '[', ']', '(', ')']))));
        }
    }
    let named = names(text.as_bytes(), Separator::of(text.as_bytes()));
    let read: Vec<(Column, Option<TimeUnit>, Option<u32>)> = named.iter().map(|text| name(text)).collect();
    let has = |wanted: Column| read.iter().any(|(column, ..)| *column == wanted);
    if columns.is_none() && [Column::T, Column::X, Column::Y, Column::P].into_iter().all(has) {
        found.unit =
            found.unit.or(read.iter().find_map(|(column, unit, _)| unit.filter(|_| *column == Column::T)));
        *columns = Some(read.into_iter().map(|(column, ..)| column).collect());
    }
}

/// Which column seems to hold what, for a message: the names of [`Column`] from the left.
pub(crate) fn proposal(sample: &[Vec<Option<Decimal>>], fields: usize) -> Option<Vec<Column>> {
    let column = |index: usize| -> Option<Vec<f64>> {
        sample.iter().map(|line| line.get(index).copied().flatten().map(Decimal::value)).collect()
    };
    let columns: Vec<Option<Vec<f64>>> = (0..fields.min(16)).map(column).collect();
    let is_polarity = |values: &[f64]| values.iter().all(|value| [0.0, 1.0, -1.0].contains(value));
    let is_sorted =
        |values: &[f64]| values.windows(2).all(|pair| pair[0] <= pair[1]) && values.first() < values.last();
    let of = |index: usize| columns[index].as_deref().unwrap_or_default();
    let known: Vec<usize> = (0..columns.len()).filter(|index| columns[*index].is_some()).collect();
    let p = known.iter().copied().rfind(|index| is_polarity(of(*index)))?;
    // Of few lines a coordinate may be sorted too; stamps have fractions, or are the larger numbers.
    let rank = |index: &usize| {
        (of(*index).iter().any(|value| value.fract() != 0.0), of(*index).last().copied().unwrap_or(0.0))
    };
    let better = |a: &usize, b: &usize| rank(a).0.cmp(&rank(b).0).then(rank(a).1.total_cmp(&rank(b).1));
    let t = known.iter().copied().filter(|index| *index != p && is_sorted(of(*index))).max_by(better)?;
    let mut rest = (0..columns.len()).filter(|index| *index != p && *index != t && columns[*index].is_some());
    let (x, y) = (rest.next()?, rest.next()?);
    let named = |index: usize| {
        [(t, Column::T), (x, Column::X), (y, Column::Y), (p, Column::P)]
            .into_iter()
            .find(|(at, _)| *at == index)
    };
    Some((0..fields).map(|index| named(index).map_or(Column::Skip, |(_, column)| column)).collect())
}

/// Names of columns as a manifest has them.
pub(crate) fn column_names(columns: &[Column]) -> String {
    let name = |column: &Column| match column {
        Column::T => "\"t\"",
        Column::X => "\"x\"",
        Column::Y => "\"y\"",
        Column::P => "\"p\"",
        Column::TIn => "\"t_in\"",
        Column::Skip => "\"skip\"",
    };
    format!("[{}]", columns.iter().map(name).collect::<Vec<_>>().join(", "))
}

/// A note on a unit that the user states against the file.
pub(crate) fn unit_note(stated: Option<TimeUnit>, declared: Option<TimeUnit>) -> Option<String> {
    let (stated, declared) = (stated?, declared?);
    let (file, user) = (unit_name(stated), unit_name(declared));
    (stated != declared).then(|| {
        format!("the file says that its stamps are in {file}; they were read in {user}, as declared")
    })
}
