//! Reads a file through once where it has no index: which topics it has, how many messages, in which pieces.

use super::contents::Contents;
use super::piece::{Record, Topic};
use super::{mcap, walk};
use crate::error::FormatError;
use std::collections::BTreeMap;

/// Fills in topics, counts and times of all pieces.
///
/// # Errors
/// When the file cannot be opened any more.
pub(crate) fn survey(mut contents: Contents) -> Result<Contents, FormatError> {
    let mut topics: BTreeMap<u32, Topic> = BTreeMap::new();
    let mut schemas: BTreeMap<u16, String> = BTreeMap::new();
    let mut counts: BTreeMap<u32, u64> = BTreeMap::new();
    let mut body = Vec::new();
    for index in 0..contents.pieces.len() {
        let mut here: BTreeMap<u32, u64> = BTreeMap::new();
        let mut received: Option<(i64, i64)> = None;
        // What is damaged inside a piece is reported by those who read it for its messages.
        if let Ok(mut records) = walk::open_piece(&contents, index)? {
            while let Ok(Some(record)) = records.next(&|_| false, 0, &mut body) {
                match record {
                    Record::Topic(topic) => {
                        topics.entry(topic.id).or_insert(topic);
                    }
                    Record::Schema(id, name) => {
                        schemas.entry(id).or_insert(name);
                    }
                    Record::Message(envelope) => {
                        *here.entry(envelope.id).or_default() += 1;
                        let (first, last) = received.unwrap_or((envelope.received, envelope.received));
                        received = Some((first.min(envelope.received), last.max(envelope.received)));
                    }
                    Record::Other => {}
                }
            }
        }
        for (id, count) in &here {
            *counts.entry(*id).or_default() += count;
        }
        contents.pieces[index].received = received.unwrap_or((0, 0));
        contents.pieces[index].counts = Some(here.into_iter().collect());
    }
    contents.topics = topics.into_values().collect();
    mcap::name_types(&mut contents.topics, &schemas);
    for topic in &mut contents.topics {
        topic.messages = Some(counts.remove(&topic.id).unwrap_or(0));
    }
    let orphans: u64 = counts.values().sum();
    if orphans > 0 {
        let what = format!(
            "{orphans} messages belong to {} connections whose definition is lost; they are left out",
            counts.len()
        );
        contents.losses.add("topics without a definition", || "the whole file".into(), || what);
    }
    Ok(contents)
}
