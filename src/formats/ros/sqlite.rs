//! Bags of ROS 2 in SQLite (`.db3`): finds the topics of a file, and the ranges of rows in which its messages
//! stand.
//!
//! rosbag2 keeps two tables: `topics` (id, name, type, serialization_format) and `messages` (id, topic_id,
//! timestamp, data), where `id` is the row's own number and grows in the order of recording. A piece is a
//! range of these numbers. Source: `rosbag2_storage_sqlite3`.
//!
//! A file may hold anything. It is opened read-only and as one that nobody changes (no lock, no journal is
//! written), its schema may be hostile: only ordinary tables without computed columns are read, and only by
//! the number of a row, so that no query does more than the file has rows. Where a page is damaged, rows
//! behind it are looked for in growing steps. A value cannot be longer than the pages of the file: SQLite
//! checks that itself.
//!
//! Limits: messages that a recorder left in a write-ahead log (`.db3-wal`) are not read, with a loss that
//! says how to bring them in.

use super::contents::{Contents, Database, Piece};
use super::messages::Serial;
use super::piece::{Container, Envelope, MOST_MESSAGE, Record, Topic};
use super::wire::label;
use crate::error::FormatError;
use crate::losses::Losses;
use rusqlite::config::DbConfig;
use rusqlite::limits::Limit;
use rusqlite::types::ValueRef;
use rusqlite::{Connection, OpenFlags, Row};
use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::Read;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The first bytes.
pub(crate) const MAGIC: &[u8] = b"SQLite format 3\0";
/// Bytes of the header of a database.
const HEAD: usize = 100;
/// Rows of a piece, and bytes of its messages, at most (one message may be longer).
const PIECE_ROWS: u64 = 1024;
const PIECE_BYTES: u64 = 4 << 20;
/// Rows whose numbers and times are read at a time.
const BATCH: usize = 256;
/// More topics than any recording has.
const MOST_TOPICS: usize = 1 << 16;
/// After so many damaged places the rest of a file is given up.
const MOST_GAPS: usize = 1 << 12;

/// Opens a database for reading.
fn connect(path: &Path, cut: bool) -> Result<Connection, String> {
    let place = std::path::absolute(path).map_err(|error| error.to_string())?;
    // A name may hold any byte; in a URI most are written by their number.
    let mut uri = String::from("file://");
    for &byte in place.as_os_str().as_bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'.' | b'-' | b'_' => uri.push(char::from(byte)),
            _ => uri.push_str(&format!("%{byte:02X}")),
        }
    }
    uri.push_str("?mode=ro&immutable=1");
    let flags =
        OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_URI | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let open = || -> rusqlite::Result<Connection> {
        let connection = Connection::open_with_flags(&uri, flags)?;
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false)?;
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_VIEW, false)?;
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_TRIGGER, false)?;
        // A database that is shorter than its header says is read as far as it goes only in this mode;
        // nothing is ever written.
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_DEFENSIVE, !cut)?;
        connection.pragma_update(None, "writable_schema", cut)?;
        connection.pragma_update(None, "cell_size_check", true)?;
        connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, MOST_MESSAGE as i32 + (1 << 16))?;
        Ok(connection)
    };
    open().map_err(|error| said(&error))
}

/// An error of SQLite without its codes.
fn said(error: &rusqlite::Error) -> String {
    match error {
        rusqlite::Error::SqliteFailure(_, Some(text)) => label(text.as_bytes()),
        other => label(other.to_string().as_bytes()),
    }
}

/// What one row says, without its message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Line {
    row: i64,
    topic: i64,
    received: i64,
    length: u64,
}

/// Reads the rows whose number is above `after` and not above `last`, in order, [`BATCH`] at most, and says
/// what stopped it before that.
fn lines(connection: &Connection, after: i64, last: i64, found: &mut VecDeque<Line>) -> Result<(), String> {
    let read = |found: &mut VecDeque<Line>| -> rusqlite::Result<bool> {
        let query = "SELECT rowid, topic_id, timestamp, length(data) FROM messages WHERE rowid > ?1 AND \
                     rowid <= ?2 ORDER BY rowid LIMIT ?3";
        let mut statement = connection.prepare_cached(query)?;
        let mut rows = statement.query((after, last, BATCH as i64))?;
        let mut before = after;
        while let Some(row) = rows.next()? {
            let number = |k: usize| {
                row.get_ref(k)
                    .map(|value| if let ValueRef::Integer(number) = value { Some(number) } else { None })
            };
            let Some(at) = number(0)?.filter(|row| *row > before) else { return Ok(false) };
            before = at;
            // A row without a topic, a time or data belongs to no connection.
            let line =
                match (number(1)?, number(2)?, number(3)?.and_then(|length| u64::try_from(length).ok())) {
                    (Some(topic), Some(received), Some(length)) => Line { row: at, topic, received, length },
                    _ => Line { row: at, topic: i64::MIN, received: 0, length: 0 },
                };
            found.push_back(line);
        }
        Ok(true)
    };
    match read(found) {
        Ok(true) => Ok(()),
        Ok(false) => Err("the rows are not in order".into()),
        Err(error) => Err(said(&error)),
    }
}

/// Reads topics, and goes over the numbers and times of all messages.
///
/// # Errors
/// When the file cannot be read, or is no database of rosbag2.
pub(crate) fn open(path: &Path) -> Result<Contents, FormatError> {
    let io = |error: std::io::Error| FormatError::io(path, &error);
    let mut file = File::open(path).map_err(io)?;
    let size = file.metadata().map_err(io)?.len();
    let mut head = Vec::new();
    (&mut file).take(HEAD as u64).read_to_end(&mut head).map_err(io)?;
    if !head.starts_with(MAGIC) {
        return Err(FormatError::new(
            path,
            "this is no SQLite database: its first bytes are others",
            "check the path",
        )
        .expected("a bag of ROS 2 (.db3)"));
    }
    let mut losses = Losses::default();
    let cut = claimed(&head).is_some_and(|claimed| claimed > size);
    if cut {
        let what = format!(
            "the file is cut off: its header states {} bytes; what is before the cut is read",
            claimed(&head).unwrap_or(0)
        );
        losses.add("ends that are cut off", || format!("byte {size}"), || what);
    }
    for (end, what) in [("-wal", "write-ahead log"), ("-journal", "journal")] {
        let mut name = path.as_os_str().to_os_string();
        name.push(end);
        let name = PathBuf::from(name);
        if std::fs::metadata(&name).is_ok_and(|log| log.len() > 0) {
            let at = || name.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let hint = "copy both files and run `sqlite3 COPY \"PRAGMA wal_checkpoint(TRUNCATE)\"`";
            losses.add("logs that were not merged", at, || {
                format!("the recorder left a {what}, whose messages are not read; to bring them in, {hint}")
            });
        }
    }
    let refuse = |what: String| {
        let hint = "check that the file was copied whole; `sqlite3 FILE .recover` saves what can be saved \
                    of a damaged one";
        FormatError::new(path, what, hint).expected("a bag of ROS 2, with tables `topics` and `messages`")
    };
    let connection =
        connect(path, cut).map_err(|error| refuse(format!("the database cannot be opened: {error}")))?;
    check_tables(&connection).map_err(&refuse)?;
    let mut contents = Contents::new(path, size, Container::Sqlite);
    contents.facts.push(("container".into(), "rosbag2, SQLite".into()));
    let mut database = Database { cut, ids: BTreeMap::new() };
    topics(&connection, &mut contents, &mut database)
        .map_err(|error| refuse(format!("the table of topics cannot be read: {error}")))?;
    survey(&connection, &mut contents, &database, &mut losses);
    contents.parts[0].database = Arc::new(database);
    contents.losses = losses;
    Ok(contents)
}

/// Bytes that a database should have: size and number of its pages; `None` where the header does not say.
fn claimed(head: &[u8]) -> Option<u64> {
    let page = match u16::from_be_bytes(*head.get(16..)?.first_chunk()?) {
        1 => 1 << 16,
        page => u64::from(page),
    };
    // The number of pages counts only where it was written by the last change.
    let same = head.get(24..28)? == head.get(92..96)?;
    let pages = u32::from_be_bytes(*head.get(28..)?.first_chunk()?);
    same.then_some(page * u64::from(pages))
}

/// Both tables must be ordinary ones: reading others could do any work.
fn check_tables(connection: &Connection) -> Result<(), String> {
    for table in ["topics", "messages"] {
        let query = "SELECT sql FROM sqlite_schema WHERE type = 'table' AND name = ?1 LIMIT 1";
        let sql: Option<String> = match connection.query_row(query, [table], |row| row.get(0)) {
            Ok(sql) => sql,
            Err(rusqlite::Error::QueryReturnedNoRows) => {
                return Err(format!("the database has no table `{table}`: it is no bag of ROS 2"));
            }
            Err(error) => return Err(format!("the database cannot be read: {}", said(&error))),
        };
        let start: String = sql.unwrap_or_default().chars().take(12).collect::<String>().to_uppercase();
        let computed = connection.query_row(
            "SELECT count(*) FROM pragma_table_xinfo(?1) WHERE hidden <> 0",
            [table],
            |row| row.get::<_, i64>(0),
        );
        if start != "CREATE TABLE" || computed.map_err(|error| said(&error))? != 0 {
            return Err(format!("`{table}` is no ordinary table; such databases are not read"));
        }
    }
    Ok(())
}

fn topics(connection: &Connection, contents: &mut Contents, database: &mut Database) -> Result<(), String> {
    let mut read = || -> rusqlite::Result<()> {
        let mut statement = connection.prepare("SELECT * FROM topics LIMIT ?1")?;
        let column = |name: &str| statement.column_index(name);
        let (id, name, kind, serial) =
            (column("id")?, column("name")?, column("type")?, column("serialization_format").ok());
        let mut rows = statement.query([MOST_TOPICS as i64])?;
        while let Some(row) = rows.next()? {
            let ValueRef::Integer(number) = row.get_ref(id)? else { continue };
            let next = contents.topics.len() as u32;
            if database.ids.contains_key(&number) {
                continue;
            }
            let serial = match serial.map(|serial| text(row, serial)).transpose()?.as_deref() {
                None | Some("cdr" | "") => Serial::Cdr,
                Some("ros1" | "rosmsg") => Serial::Ros1,
                Some(_) => Serial::Other,
            };
            database.ids.insert(number, next);
            contents.topics.push(Topic {
                id: next,
                name: text(row, name)?,
                type_name: text(row, kind)?,
                schema: 0,
                serial,
                messages: Some(0),
            });
        }
        Ok(())
    };
    read().map_err(|error| said(&error))
}

fn text(row: &Row<'_>, column: usize) -> rusqlite::Result<String> {
    Ok(match row.get_ref(column)? {
        ValueRef::Text(bytes) | ValueRef::Blob(bytes) => label(bytes),
        _ => String::new(),
    })
}

/// Goes over all rows once: counts messages of every topic, and cuts the rows into pieces.
fn survey(connection: &Connection, contents: &mut Contents, database: &Database, losses: &mut Losses) {
    let (mut at, mut step, mut gaps, mut orphans) = (i64::MIN, 1_i64, 0, 0_u64);
    let mut good = i64::MIN;
    let mut found = VecDeque::new();
    let mut builder = Builder::default();
    loop {
        found.clear();
        let end = lines(connection, at, i64::MAX, &mut found);
        if let Some(first) = found.front() {
            if step > 1 {
                let (from, to) = (good.max(0), first.row);
                let what =
                    "the rows between cannot be read: a page of the file is damaged or missing".to_string();
                losses.add("rows that cannot be read", || format!("rows after {from}, up to {to}"), || what);
                step = 1;
            }
        } else if end.is_ok() {
            break;
        }
        for line in &found {
            match database.ids.get(&line.topic) {
                Some(&id) => builder.add(line, id, contents),
                None => orphans += 1,
            }
            (at, good) = (line.row, line.row);
        }
        if let Err(error) = end {
            gaps += 1;
            let from = if at == i64::MIN { 0 } else { at };
            let next = from.checked_add(step).filter(|_| gaps < MOST_GAPS);
            builder.close(contents);
            let Some(next) = next else {
                let what = format!("what follows cannot be read: {error}");
                losses.add("rows that cannot be read", || format!("rows after {}", good.max(0)), || what);
                break;
            };
            (at, step) = (next, step.saturating_mul(2));
        }
    }
    if step > 1 && gaps < MOST_GAPS {
        losses.add(
            "rows that cannot be read",
            || format!("rows after {}", good.max(0)),
            || "a page of the file is damaged or missing".into(),
        );
    }
    builder.close(contents);
    if orphans > 0 {
        let what = format!("{orphans} rows belong to no topic, or have no time or data; they are left out");
        losses.add("rows that are no message", || "the whole file".into(), || what);
    }
    // For progress: pieces as if they stood one after another in the file.
    let count = contents.pieces.len() as u64;
    for (k, piece) in contents.pieces.iter_mut().enumerate() {
        piece.at = contents.size / count.max(1) * k as u64;
    }
}

/// A piece in the making.
#[derive(Default)]
struct Builder {
    rows: Option<(i64, i64)>,
    received: (i64, i64),
    counts: BTreeMap<u32, u64>,
    messages: u64,
    bytes: u64,
}

impl Builder {
    fn add(&mut self, line: &Line, id: u32, contents: &mut Contents) {
        let known = self.rows;
        self.rows = Some((known.map_or(line.row, |rows| rows.0), line.row));
        self.received = match known {
            Some(_) => (self.received.0.min(line.received), self.received.1.max(line.received)),
            None => (line.received, line.received),
        };
        *self.counts.entry(id).or_default() += 1;
        self.messages += 1;
        self.bytes = self.bytes.saturating_add(line.length);
        if let Some(topic) = contents.topics.get_mut(id as usize) {
            topic.messages = topic.messages.map(|messages| messages + 1);
        }
        if self.messages >= PIECE_ROWS || self.bytes >= PIECE_BYTES {
            self.close(contents);
        }
    }

    fn close(&mut self, contents: &mut Contents) {
        let done = std::mem::take(self);
        if let Some(rows) = done.rows {
            let counts = Some(done.counts.into_iter().collect());
            contents.pieces.push(Piece {
                file: 0,
                at: 0,
                length: None,
                rows: Some(rows),
                received: done.received,
                counts,
            });
        }
    }
}

/// Walks over the messages of one piece.
pub(crate) struct Rows {
    connection: Connection,
    database: Arc<Database>,
    first: i64,
    last: i64,
    /// The last row that was passed.
    passed: Option<i64>,
    ahead: VecDeque<Line>,
}

impl Rows {
    /// Before the first row of a piece.
    ///
    /// # Errors
    /// When the file can no longer be opened as a database.
    pub(crate) fn open(
        path: &Path,
        database: &Arc<Database>,
        (first, last): (i64, i64),
    ) -> Result<Rows, String> {
        let connection = connect(path, database.cut)?;
        Ok(Rows { connection, database: database.clone(), first, last, passed: None, ahead: VecDeque::new() })
    }

    fn offset(&self, row: i64) -> u64 {
        row.wrapping_sub(self.first).cast_unsigned()
    }

    /// The next row as an offset from the first.
    pub(crate) fn at(&self) -> u64 {
        self.passed.map_or(0, |row| self.offset(row).saturating_add(1))
    }

    /// Goes on at an offset that a message had.
    pub(crate) fn forward(&mut self, offset: u64) {
        let row = self.first.wrapping_add(offset.cast_signed());
        self.ahead.retain(|line| line.row >= row);
        self.passed = row.checked_sub(1).filter(|passed| *passed >= self.first);
    }

    /// The next message; its data up to `most` bytes in `body` when its topic is wanted.
    ///
    /// # Errors
    /// When the rows cannot be read further.
    pub(crate) fn next(
        &mut self,
        wanted: &dyn Fn(u32) -> bool,
        most: u64,
        body: &mut Vec<u8>,
    ) -> Result<Option<Record>, String> {
        if self.ahead.is_empty() {
            let after = self.passed.unwrap_or(self.first.saturating_sub(1));
            let end = lines(&self.connection, after, self.last, &mut self.ahead);
            if self.ahead.is_empty() {
                return end.map(|()| None);
            }
        }
        let Some(line) = self.ahead.pop_front() else { return Ok(None) };
        self.passed = Some(line.row);
        let Some(&id) = self.database.ids.get(&line.topic) else { return Ok(Some(Record::Other)) };
        let kept = line.length.min(most);
        if wanted(id) && kept > MOST_MESSAGE {
            return Err(format!("a message has {} bytes; {MOST_MESSAGE} at most are read", line.length));
        }
        if wanted(id) {
            let mut fetch = || -> rusqlite::Result<()> {
                let mut statement =
                    self.connection.prepare_cached("SELECT data FROM messages WHERE rowid = ?1")?;
                statement.query_row([line.row], |row| {
                    if let ValueRef::Blob(data) = row.get_ref(0)? {
                        body.extend_from_slice(
                            &data[..data.len().min(usize::try_from(kept).unwrap_or(usize::MAX))],
                        );
                    }
                    Ok(())
                })
            };
            fetch().map_err(|error| said(&error))?;
        }
        Ok(Some(Record::Message(Envelope {
            id,
            received: line.received,
            offset: self.offset(line.row),
            length: line.length,
        })))
    }
}
