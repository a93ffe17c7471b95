//! When frames were taken, from a text file that stands with them.
//!
//! A line is a frame: one stamp, a name and a stamp, an index and a stamp, or start and end of the exposure,
//! in an order that the header names or the values show. This project's own `frames.csv` is one of these.
//! Units come from the header (`t_start_ns`, `[us]`), from the format, or from the user.

use super::names::is_picture;
use crate::decimal::Decimal;
use crate::declared::{Declared, StampRole, TimeUnit};
use crate::error::FormatError;
use crate::evidence::{self, Of, unit_in_brackets, unit_name, unit_named};
use crate::text::fields::{Separator, is_comment};
use std::path::Path;

/// Largest file that is read: a million frames with long names.
const LARGEST: u64 = 64 << 20;

/// A line of a stamps file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Row {
    /// Name of the picture, without folders.
    pub(crate) name: Option<String>,
    pub(crate) at: i64,
    pub(crate) exposure: Option<(i64, i64)>,
    /// The number by which the file counts it.
    pub(crate) index: Option<i64>,
    /// Is all of it there? A pulse of which an edge is missing has its place, and no exposure.
    pub(crate) is_whole: bool,
    /// Number of the line, from 1; 0 of what stands in no file.
    pub(crate) line: u64,
}

impl Row {
    /// A stamp that stands in no file.
    pub(crate) fn at(at: i64, exposure: Option<(i64, i64)>, is_whole: bool) -> Row {
        Row { name: None, at, exposure, index: None, is_whole, line: 0 }
    }
}

/// A stamps file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Stamps {
    pub(crate) rows: Vec<Row>,
    pub(crate) role: Option<StampRole>,
    pub(crate) row_time_ns: Option<i64>,
    /// Does a comment say that codes are linear (`# dn = offset + scale * code`)?
    pub(crate) is_linear: bool,
    pub(crate) notes: Vec<String>,
    /// Does the format define that the n-th entry is that of the picture with the number n, from 0, where
    /// pictures are more?
    pub(crate) lines_count: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    At,
    Start,
    End,
    Mid,
    Name,
    Index,
    Skip,
}

fn role(name: &str) -> (Role, Option<TimeUnit>) {
    let mut text = name.trim().trim_matches(['"', '\'']).to_ascii_lowercase();
    let mut unit = unit_in_brackets(&mut text);
    if let Some((before, after)) = text.clone().rsplit_once('_')
        && let Some(stated) = unit_named(after)
    {
        unit = Some(stated);
        text = before.into();
    }
    let has = |words: &[&str]| words.iter().any(|word| text.contains(word));
    let is = |words: &[&str]| words.contains(&text.as_str());
    let role = if is(&[
        "index",
        "idx",
        "seq",
        "id",
        "number",
        "frame",
        "frame_id",
        "frame_index",
        "frame_number",
        "image_id",
        "image_index",
    ]) {
        Role::Index
    } else if has(&["file", "name", "image", "picture", "path"]) && !has(&["stamp", "time"]) {
        Role::Name
    } else if has(&["start", "begin", "open"]) {
        Role::Start
    } else if has(&["end", "close", "stop"]) {
        Role::End
    } else if has(&["mid"]) {
        Role::Mid
    } else if has(&["stamp"]) || is(&["t", "ts", "time", "times"]) {
        Role::At
    } else {
        Role::Skip
    };
    (role, unit)
}

/// Reads a stamps file. `defined` is the unit that the folder's format defines.
pub(crate) fn read(
    path: &Path,
    declared: &Declared,
    defined: Option<TimeUnit>,
) -> Result<Stamps, FormatError> {
    let io = |error: std::io::Error| FormatError::io(path, &error);
    let bytes = std::fs::metadata(path).map_err(io)?.len();
    if bytes > LARGEST {
        return Err(FormatError::new(
            path,
            format!("{bytes} bytes"),
            "name the text file with the stamps of the frames",
        )
        .expected("a stamps file of at most 64 MiB"));
    }
    parse(path, &std::fs::read(path).map_err(io)?, declared, defined)
}

/// Lines of a stamps file by what they hold.
struct Lines<'a> {
    /// What the header names, with units.
    roles: Option<Vec<(Role, Option<TimeUnit>)>>,
    /// Numbers and fields of the lines with stamps.
    lines: Vec<(u64, Vec<&'a [u8]>)>,
    /// Numbers of those that hold nothing of use.
    wrong_lines: Vec<u64>,
    /// The unit that comments state.
    stated: Option<TimeUnit>,
}

impl<'a> Lines<'a> {
    /// Sorts the lines of a text; what comments say goes to `stamps`.
    fn of(text: &'a [u8], stamps: &mut Stamps) -> Lines<'a> {
        let mut roles: Option<Vec<(Role, Option<TimeUnit>)>> = None;
        let mut lines: Vec<(u64, Vec<&[u8]>)> = Vec::new();
        let mut wrong_lines = Vec::new();
        let mut stated = None;
        let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
        for (number, line) in (1..).zip(text.split(|&byte| byte == b'\n')) {
            let separator = Separator::of(line);
            if is_comment(line) {
                comment(line, stamps, &mut roles, &mut stated);
                continue;
            }
            let fields: Vec<&[u8]> = separator.fields(line).collect();
            if fields.iter().any(|field| Decimal::read(field).is_some()) {
                lines.push((number, fields));
            } else if lines.is_empty() && roles.is_none() {
                let named: Vec<_> =
                    fields.iter().map(|field| role(&String::from_utf8_lossy(field))).collect();
                if named.iter().any(|(role, _)| !matches!(role, Role::Skip | Role::Index)) {
                    roles = Some(named)
                } else {
                    wrong_lines.push(number)
                }
            } else {
                wrong_lines.push(number);
            }
        }
        Lines { roles, lines, wrong_lines, stated }
    }
}

/// As [`read`], of the file's bytes.
pub(crate) fn parse(
    path: &Path,
    text: &[u8],
    declared: &Declared,
    defined: Option<TimeUnit>,
) -> Result<Stamps, FormatError> {
    let mut stamps = Stamps::default();
    let Lines { roles, lines, wrong_lines, mut stated } = Lines::of(text, &mut stamps);
    if !wrong_lines.is_empty() {
        stamps.notes.push(format!(
            "{} of its lines hold no number and were left out (the first is line {})",
            wrong_lines.len(),
            wrong_lines[0]
        ));
    }
    if lines.is_empty() {
        return Err(FormatError::new(
            path,
            "no stamps",
            "put one stamp on a line, or a name and a stamp, or start and end of the exposure",
        ));
    }
    let roles = match roles {
        Some(named) if named.iter().any(|(role, _)| matches!(role, Role::At | Role::Start | Role::Mid)) => {
            stated = named.iter().find_map(|(_, unit)| *unit).or(stated);
            named.into_iter().map(|(role, _)| role).collect()
        }
        _ => roles_of(path, &lines)?,
    };
    // The unit of the events serves where none is stated for the frames.
    let unit = match (stated, declared.stamps_unit.or(declared.time_unit), defined) {
        // A unit that is stated for these very stamps goes before what the file says of them.
        (Some(file), Some(user), _)
            if file != user && (declared.stamps.is_some() || declared.stamps_unit.is_some()) =>
        {
            stamps.notes.push(format!(
                "the stamps file says {}; {} was declared and taken",
                unit_name(file),
                unit_name(user)
            ));
            user
        }
        (Some(unit), ..) | (None, Some(unit), _) | (None, None, Some(unit)) => unit,
        (None, None, None) => {
            let evidence = look(&roles, &lines);
            let what = format!("the unit of the frames' stamps is not stated ({})", evidence.text);
            return Err(FormatError::new(path, what, evidence.hint())
                .expected("a unit in the header, such as `t_us`")
                .undeclared("stamps_unit"));
        }
    };
    for (number, fields) in &lines {
        stamps.rows.push(row(path, *number, fields, &roles, unit)?);
    }
    if stated.is_none() && declared.stamps_unit.is_none() && runs_together(&roles, &lines, &stamps.rows) {
        let evidence = look(&roles, &lines);
        let what =
            format!("stamps that differ become one and the same in {} ({})", unit_name(unit), evidence.text);
        return Err(FormatError::new(path, what, evidence.hint())
            .expected("the unit of the frames' stamps")
            .undeclared("stamps_unit"));
    }
    let has = |wanted: Role| roles.contains(&wanted);
    stamps.role = match (has(Role::At), has(Role::Start), has(Role::Mid)) {
        (true, ..) => None,
        (_, true, _) => Some(StampRole::Start),
        (.., true) => Some(StampRole::Middle),
        _ => None,
    };
    Ok(stamps)
}

/// Which column holds the first stamp of a line.
fn column_of(roles: &[Role]) -> usize {
    roles.iter().position(|role| !matches!(role, Role::Name | Role::Index | Role::Skip)).unwrap_or(0)
}

/// What the stamps look like.
fn look(roles: &[Role], lines: &[(u64, Vec<&[u8]>)]) -> evidence::Evidence {
    let index = column_of(roles);
    let sample: Vec<Decimal> = lines
        .iter()
        .filter_map(|(_, fields)| fields.get(index).and_then(|field| Decimal::read(field)))
        .take(100_000)
        .collect();
    evidence::of_decimals(&sample, sample.len() as f64, Of::Frames)
}

/// Are there stamps that differ in the file and no longer do in its rows? Decimal seconds that are read as
/// nanoseconds.
fn runs_together(roles: &[Role], lines: &[(u64, Vec<&[u8]>)], rows: &[Row]) -> bool {
    let index = column_of(roles);
    let text = |line: usize| lines[line].1.get(index).map(|field| field.trim_ascii());
    (1..rows.len()).any(|line| rows[line].at == rows[line - 1].at && text(line) != text(line - 1))
}

fn comment(
    line: &[u8],
    stamps: &mut Stamps,
    roles: &mut Option<Vec<(Role, Option<TimeUnit>)>>,
    stated: &mut Option<TimeUnit>,
) {
    let text = String::from_utf8_lossy(line);
    let text = text.trim().trim_start_matches(['#', '%']).trim();
    if text.starts_with("dn = offset + scale * code") {
        stamps.is_linear = true;
        stamps.notes.push(format!("codes are linear: {text}"));
        let row_time = text
            .split(';')
            .find_map(|part| part.trim().strip_prefix("row_time_ns="))
            .and_then(|value| value.trim().parse().ok());
        stamps.row_time_ns = Some(row_time.unwrap_or(0));
        return;
    }
    let words: Vec<&str> = text.split([' ', ',', ';', '\t']).filter(|word| !word.is_empty()).collect();
    for pair in words.windows(2) {
        if pair[0].eq_ignore_ascii_case("in") || pair[0].eq_ignore_ascii_case("unit:") {
            *stated = stated.or(unit_named(pair[1].trim_matches(['.', '[', ']', '(', ')'])));
        }
    }
    *stated = stated.or(words.iter().find_map(|word| word.strip_prefix("time_unit=").and_then(unit_named)));
    // A header as numpy and DSEC write it: `# exposure_start_timestamp_us, exposure_end_timestamp_us`.
    let named: Vec<_> = Separator::of(text.as_bytes())
        .fields(text.as_bytes())
        .map(|field| role(&String::from_utf8_lossy(field)))
        .collect();
    if roles.is_none()
        && named.iter().all(|(role, unit)| *role != Role::Skip || unit.is_some())
        && named.iter().any(|(role, _)| *role != Role::Index)
    {
        *roles = Some(named);
    }
}

/// What the columns hold when nothing names them.
fn roles_of(path: &Path, lines: &[(u64, Vec<&[u8]>)]) -> Result<Vec<Role>, FormatError> {
    let width = lines[0].1.len();
    let mut roles: Vec<Role> = (0..width)
        .map(|index| {
            if lines.iter().take(100).all(|(_, fields)| is_number(fields, index)) {
                Role::At
            } else {
                Role::Name
            }
        })
        .collect();
    let numbers: Vec<usize> = (0..width).filter(|index| roles[*index] == Role::At).collect();
    let value = |line: usize, column: usize| {
        lines[line].1.get(column).and_then(|field| Decimal::read(field)).map_or(f64::NAN, Decimal::value)
    };
    // By ones, but for some that are missing.
    let counts_up = |column: usize| {
        let steps: Vec<f64> =
            (1..lines.len()).map(|line| value(line, column) - value(line - 1, column)).collect();
        let ones = steps.iter().filter(|step| **step == 1.0).count();
        !steps.is_empty()
            && 2 * ones > steps.len()
            && steps.iter().all(|step| *step >= 1.0)
            && value(0, column).fract() == 0.0
    };
    let is_span = |a: usize, b: usize| {
        (0..lines.len()).all(|line| value(line, a) <= value(line, b))
            && (1..lines.len()).all(|line| value(line, a) > value(line - 1, a))
    };
    match numbers.as_slice() {
        [_] => {}
        &[a, b] if counts_up(a) && !counts_up(b) => roles[a] = Role::Index,
        &[a, b] if is_span(a, b) => (roles[a], roles[b]) = (Role::Start, Role::End),
        &[a, b, c] if counts_up(a) && is_span(b, c) => {
            (roles[a], roles[b], roles[c]) = (Role::Index, Role::Start, Role::End)
        }
        _ => {
            return Err(FormatError::new(
                path,
                format!("{width} columns without a header that names them"),
                "put a header line above: `t_us`, `start_us,end_us`, `file,t_us`",
            )
            .at(format!("line {}", lines[0].0))
            .expected("one stamp a line, a name and a stamp, or start and end of the exposure"));
        }
    }
    Ok(roles)
}

fn is_number(fields: &[&[u8]], index: usize) -> bool {
    fields.get(index).is_some_and(|field| Decimal::read(field).is_some())
}

fn row(path: &Path, line: u64, fields: &[&[u8]], roles: &[Role], unit: TimeUnit) -> Result<Row, FormatError> {
    let wrong = |what: String| {
        FormatError::new(path, what, "correct the line, or leave it out").at(format!("line {line}"))
    };
    let mut row = Row { line, ..Row::at(0, None, true) };
    let (mut at, mut start, mut end, mut mid) = (None, None, None, None);
    for (index, role) in roles.iter().enumerate() {
        if *role == Role::Skip {
            continue;
        }
        let field =
            fields.get(index).ok_or_else(|| wrong(format!("{} of {} columns", fields.len(), roles.len())))?;
        let text = String::from_utf8_lossy(field);
        if *role == Role::Index {
            row.index = text.trim_matches('"').parse().ok();
            continue;
        }
        if *role == Role::Name {
            let name = text.trim_matches('"').rsplit(['/', '\\']).next().unwrap_or_default().to_string();
            row.name = row.name.or(Some(name).filter(|name| is_picture(name) || name.contains('.')));
            continue;
        }
        let ns = Decimal::read(field)
            .and_then(|number| number.ns(unit))
            .ok_or_else(|| wrong(format!("`{}` is no stamp", text.escape_debug())))?;
        match role {
            Role::At => at = at.or(Some(ns)),
            Role::Start => start = Some(ns),
            Role::End => end = Some(ns),
            _ => mid = Some(ns),
        }
    }
    row.exposure = match (start, end) {
        (Some(start), Some(end)) if start > end => {
            return Err(wrong(format!("the exposure ends before it begins ({start} ns, {end} ns)")));
        }
        (Some(start), Some(end)) => Some((start, end)),
        _ => None,
    };
    row.at = at.or(start).or(mid).or(end).ok_or_else(|| wrong("no stamp".into()))?;
    Ok(row)
}

/// Stamps that do not belong to the frames: lines at the front whose distance to the next is unlike that of
/// all others. The number of such lines and why.
pub(crate) fn leading_wrong(rows: &[Row], surplus: usize) -> Option<(usize, String)> {
    let steps: Vec<i64> = rows.windows(2).map(|pair| pair[1].at.saturating_sub(pair[0].at)).collect();
    if surplus == 0 || steps.len() < surplus + 3 {
        return None;
    }
    let mut usual: Vec<i64> = steps[surplus..].to_vec();
    usual.sort_unstable();
    let median = usual[usual.len() / 2];
    let odd = steps[surplus - 1];
    // An ordinary gap of dropped frames is shorter than that.
    (odd <= 0 || odd > median.saturating_mul(20)).then(|| {
        (
            surplus,
            format!(
                "line {} is {odd} ns before the next where others are {median} ns apart: {surplus} wrong \
                 lines at the front were left out",
                rows[surplus - 1].line
            ),
        )
    })
}
