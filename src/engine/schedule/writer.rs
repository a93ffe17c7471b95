//! The one thread that writes results: bands come through a bounded channel, so that a slow disk slows the
//! nodes instead of filling memory.
//!
//! HDF5 works behind one lock anyway; a thread of its own lets the next band be computed while this one is
//! packed and written.

use crossbeam::channel::{Receiver, Sender, bounded};
use photocurrent_core::{Digest, Meta, NodeError, Rows, Value};
use photocurrent_store::{BandStore, Cache, CacheWriter, StoredOutput};
use std::any::Any;
use std::collections::{BTreeMap, HashMap};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use crate::task::TaskId;

/// What a finished task has in the store.
pub(crate) type Stored = BTreeMap<String, StoredOutput>;

/// What a node said of some rows ([`photocurrent_core::context::Notes::content`]).
pub(crate) type Said = (Vec<String>, BTreeMap<String, u64>);

/// About how many bytes are read and written at once.
const PIECE: u64 = 16 << 20;

/// An order to the writer.
pub(crate) enum Message {
    /// Append a band to an output.
    Write { task: TaskId, port: &'static str, meta: Meta, value: Value },
    /// Keep a band until the result is complete. That it cannot be kept is no failure: the result is written
    /// all the same.
    Keep {
        store: Arc<BandStore>,
        identity: Digest,
        rows: Rows,
        outputs: Vec<(&'static str, Value)>,
        said: Said,
    },
    /// Answer when everything that was sent before is written, or was dropped because the task has failed.
    Reached { reply: Sender<()> },
    /// All bands were sent: put the outputs in their place and say what they are.
    Finish { task: TaskId, reply: Sender<Result<Stored, NodeError>> },
    /// The task failed: drop what it wrote.
    Abandon { task: TaskId },
}

/// A channel to a writer that will run `write`; it holds at most `bands` bands.
pub(crate) fn channel(bands: usize) -> (Sender<Message>, Receiver<Message>) {
    bounded(bands.max(1))
}

/// Writes until every sender is gone.
pub(crate) fn write(cache: &Cache, messages: &Receiver<Message>) {
    let mut open: HashMap<TaskId, Result<BTreeMap<&'static str, CacheWriter<'_>>, NodeError>> =
        HashMap::new();
    for message in messages {
        match message {
            Message::Write { task, port, meta, value } => {
                let outputs = open.entry(task).or_insert_with(|| Ok(BTreeMap::new()));
                // The first failure stays; what comes after it is dropped.
                if let Ok(writers) = outputs
                    && let Err(error) = guarded(|| append(cache, writers, port, &meta, &value))
                {
                    *outputs = Err(error);
                }
            }
            Message::Keep { store, identity, rows, outputs, said } => {
                let _ = guarded(|| Ok(store.put(identity, rows, &outputs, said)?));
            }
            Message::Reached { reply } => {
                // Nobody waits any more only when the task is given up.
                let _ = reply.send(());
            }
            Message::Finish { task, reply } => {
                let result = open.remove(&task).unwrap_or_else(|| Ok(BTreeMap::new()));
                let finish = |(port, writer): (&'static str, CacheWriter<'_>)| {
                    Ok((port.to_string(), writer.finish()?))
                };
                let stored = result.and_then(|writers| guarded(|| writers.into_iter().map(finish).collect()));
                // Nobody waits any more only when the run is being torn down.
                let _ = reply.send(stored);
            }
            Message::Abandon { task } => drop(open.remove(&task)),
        }
    }
}

fn append<'a>(
    cache: &'a Cache,
    writers: &mut BTreeMap<&'static str, CacheWriter<'a>>,
    port: &'static str,
    meta: &Meta,
    value: &Value,
) -> Result<(), NodeError> {
    let writer = match writers.entry(port) {
        std::collections::btree_map::Entry::Occupied(entry) => entry.into_mut(),
        std::collections::btree_map::Entry::Vacant(entry) => entry.insert(cache.writer(meta)?),
    };
    let is_read = |rows: &Rows| !rows.is_empty() && !value.is_in_memory();
    let Some(rows) = value.rows().filter(is_read) else { return Ok(writer.append(value)?) };
    // A reader's value may be a whole recording that is read only now: piece by piece, or it would fill the
    // memory.
    let per_row = meta.estimated_bytes() / meta.rows().map_or(1, |all| all.len() as u64).max(1);
    let height = (PIECE / per_row.max(1)).clamp(1, u64::from(u32::MAX)) as u32;
    rows.bands(height).into_iter().try_for_each(|piece| Ok(writer.append(&value.cut(piece))?))
}

/// A value may be computed only when it is read, so a node's panic can come up here; it is that node's
/// failure.
pub(crate) fn guarded<T>(work: impl FnOnce() -> Result<T, NodeError>) -> Result<T, NodeError> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| Err(panicked(panic.as_ref())))
}

fn panicked(panic: &(dyn Any + Send)) -> NodeError {
    let text = panic
        .downcast_ref::<&str>()
        .map(|text| text.to_string())
        .or_else(|| panic.downcast_ref::<String>().cloned());
    NodeError::failed(format!(
        "the node broke off: {}",
        text.unwrap_or_else(|| "a panic without a message".into())
    ))
    .hint("this is a mistake in the node, not in the manifest; please report it")
}
