//! Blocks of time: a long recording cut into windows that overlap, each worked on by itself, and what they
//! give joined.
//!
//! `pipeline.blocks` says how long a block is. Its first node that is local in time
//! ([`photocurrent_core::Node::LOCAL_IN_TIME`]) and takes a recording decides where blocks begin; from there
//! on each such node becomes one task for every block, which takes windows of what is not cut and the same
//! block of what is. A node that is not local takes the blocks joined: each instant from the block whose
//! share of time it lies in. Events, frames and tracks can be joined.
//!
//! Blocks are part of the manifest and of keys, unlike row bands: what a solver finds near a border depends
//! on where the border is, so the budget of a machine must not decide it.

use photocurrent_core::document::{Origin, Tree};
use photocurrent_core::error::NodeError;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{DataError, Meta, TimeSpan, Value};
use serde_json::{Value as Json, json};

/// The most blocks of one recording: more are a slip of the hand, or one stamp far from all others.
const MOST: i64 = 10_000;

/// What `pipeline.blocks` says.
#[derive(Clone, Debug)]
pub struct Blocks {
    /// Length of a block, ns, more than 0.
    pub length_ns: i64,
    /// How much of its neighbours a block sees on either side, ns.
    pub overlap_ns: i64,
    /// Where it is written.
    pub origin: Origin,
    /// Where the overlap is.
    pub overlap_origin: Origin,
}

impl Blocks {
    /// Seen on either side where nothing is said: some frame periods.
    const OVERLAP: Duration = Duration::new(50_000_000);

    /// The form of `pipeline.blocks`.
    pub(crate) fn schema() -> Json {
        let overlap =
            format!("How much of its neighbours a block sees on either side. Default: {}.", Blocks::OVERLAP);
        json!({
            "type": "object", "additionalProperties": false,
            "x-example": "`blocks = { length = \"2 s\", overlap = \"50 ms\" }`",
            "description": "Cut a recording into blocks of time, run nodes that are local in time for each, \
                            and join what they give.",
            "properties": {
                "length": {
                    "type": "string", "x-quantity": "time", "examples": ["2 s"], "x-min": "1 ms",
                    "description": "Length of a block, without its overlap.",
                },
                "overlap": {
                    "type": "string", "x-quantity": "time", "examples": ["50 ms"], "x-min": "0 ns",
                    "description": overlap,
                },
            },
        })
    }

    /// From a tree that fits the form; `None` where no length is given.
    pub(crate) fn from_tree(tree: &Tree) -> Option<Blocks> {
        let of = |name: &str| {
            let tree = tree.as_table()?.get(name)?;
            Some((tree.as_str()?.parse::<Duration>().ok()?.ns(), tree.origin.clone()))
        };
        let origin = tree.origin.clone();
        let (overlap_ns, overlap_origin) =
            of("overlap").unwrap_or_else(|| (Blocks::OVERLAP.ns(), origin.clone()));
        Some(Blocks { length_ns: of("length")?.0, overlap_ns, origin, overlap_origin })
    }

    /// The instants between which blocks lie. A rest of less than half a block belongs to the block before.
    ///
    /// # Errors
    /// When there would be too many.
    pub(crate) fn cut(&self, span: TimeSpan) -> Result<Cuts, String> {
        let count = (span.length_ns().saturating_add(self.length_ns / 2) / self.length_ns).max(1);
        if count > MOST {
            let (length, start, end) =
                (Duration::new(self.length_ns), Duration::new(span.start.0), Duration::new(span.end.0));
            return Err(format!(
                "blocks of {length} would cut the recording, from {start} to {end}, into \
                                {count}, and {MOST} are the most"
            ));
        }
        let borders = (1..count).map(|k| span.start.0 + k * self.length_ns).collect();
        Ok(Cuts { borders, overlap_ns: self.overlap_ns })
    }
}

/// Where a recording is cut.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Cuts {
    borders: Vec<i64>,
    overlap_ns: i64,
}

impl Cuts {
    /// Number of blocks.
    pub(crate) fn len(&self) -> usize {
        self.borders.len() + 1
    }

    /// The time of which a block's results are taken: from the border before it to the one after; the first
    /// and the last one have no end.
    pub(crate) fn share(&self, block: usize) -> TimeSpan {
        let start = block.checked_sub(1).map_or(i64::MIN, |before| self.borders[before]);
        TimeSpan::new(start, self.borders.get(block).copied().unwrap_or(i64::MAX))
    }

    /// What a block sees: its share and the overlap on either side.
    pub(crate) fn window(&self, block: usize) -> TimeSpan {
        let share = self.share(block);
        TimeSpan::new(
            share.start.0.saturating_sub(self.overlap_ns),
            share.end.0.saturating_add(self.overlap_ns),
        )
    }

    /// A block in words: `block 2 of 5, from 2 s to 4 s`.
    pub(crate) fn said(&self, block: usize) -> String {
        let share = self.share(block);
        let (start, end) = (Duration::new(share.start.0), Duration::new(share.end.0));
        let place = match (block, block + 1 == self.len()) {
            (0, _) => format!("up to {end}"),
            (_, true) => format!("from {start} on"),
            _ => format!("from {start} to {end}"),
        };
        format!(
            "in block {} of {} ({place}, with {} on either side)",
            block + 1,
            self.len(),
            Duration::new(self.overlap_ns)
        )
    }
}

/// How much of a value a task takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extract {
    /// All of it.
    All,
    /// What lies within a window of time.
    Window(TimeSpan),
    /// Its share of a value that is joined of several.
    Share(TimeSpan),
}

/// What is plugged into an input of a task, or a part of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Source {
    /// Which of the port's values it is; parts that are joined have one number.
    pub value: u32,
    /// The task that makes it.
    pub task: usize,
    /// The task's output.
    pub port: &'static str,
    /// How much of it is taken.
    pub extract: Extract,
}

/// What can be cut and joined in time.
pub(crate) trait Joinable: Sized {
    fn within(&self, window: TimeSpan) -> Self;
    fn joined(parts: Vec<(Self, TimeSpan)>) -> Result<Self, DataError>;
}

impl Joinable for Meta {
    fn within(&self, window: TimeSpan) -> Meta {
        Meta::within(self, window)
    }
    fn joined(parts: Vec<(Meta, TimeSpan)>) -> Result<Meta, DataError> {
        Meta::joined_in_time(&parts)
    }
}

impl Joinable for Value {
    fn within(&self, window: TimeSpan) -> Value {
        Value::within(self, window)
    }
    fn joined(parts: Vec<(Value, TimeSpan)>) -> Result<Value, DataError> {
        Value::joined_in_time(parts)
    }
}

/// The values of a port, from whole ones by task and output.
pub(crate) fn extracted<T: Joinable, E: From<NodeError>>(
    sources: &[Source],
    mut whole: impl FnMut(usize, &'static str) -> Result<T, E>,
) -> Result<Vec<T>, E> {
    let mut values = Vec::new();
    for parts in sources.chunk_by(|a, b| a.value == b.value) {
        let mut shares = Vec::new();
        for part in parts {
            let value = whole(part.task, part.port)?;
            match part.extract {
                Extract::All => values.push(value),
                Extract::Window(window) => values.push(value.within(window)),
                Extract::Share(share) => shares.push((value, share)),
            }
        }
        if !shares.is_empty() {
            values.push(T::joined(shares).map_err(|error| E::from(NodeError::from(error)))?);
        }
    }
    Ok(values)
}

/// A node's name, or that of one block of it, counted from 1: `solve[2]`.
pub(crate) fn name_of(node: &str, block: Option<usize>) -> String {
    block.map_or_else(|| node.to_string(), |k| format!("{node}[{}]", k + 1))
}

/// The node that a name is of: `solve` of `solve[2]`.
pub fn node_of(name: &str) -> &str {
    name.split_once('[').map_or(name, |(node, _)| node)
}

/// Does `asked` name this node or block of one, or the node that it is a block of?
pub(crate) fn is_of(name: &str, asked: &str) -> bool {
    name == asked || node_of(name) == asked
}
