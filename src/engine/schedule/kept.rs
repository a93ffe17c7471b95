//! Bands of results that were made before: by a run that was stopped, or elsewhere.

use super::writer::Said;
use crate::key;
use crate::plan::Plan;
use crate::task::{Task, TaskId};
use photocurrent_core::{Digest, Meta, Rows, Value};
use photocurrent_store::{BandStore, Cache, KeptBand};
use std::path::PathBuf;
use std::sync::Arc;

/// The bands that are there, and where more are kept.
pub(crate) struct Kept {
    identities: Vec<Option<Digest>>,
    /// That of the cache, where it could be opened.
    own: Option<Arc<BandStore>>,
    /// Every band with the folder that it lies in.
    bands: Vec<(Arc<BandStore>, KeptBand)>,
}

/// A band as it was kept: its rows, what outputs have of them, and what the node said.
pub(crate) type Loaded = (Rows, Vec<(&'static str, Value)>, Said);

/// A band of some task.
pub(crate) struct Found {
    store: Arc<BandStore>,
    band: KeptBand,
}

impl Found {
    pub(super) fn rows(&self) -> Rows {
        self.band.rows()
    }
}

impl Kept {
    /// Looks into the cache and into `parts`; also gives what could not be read, as sentences.
    pub(super) fn open(plan: &Plan, cache: &Cache, parts: &[PathBuf]) -> (Kept, Vec<String>) {
        let mut trouble = Vec::new();
        let mut kept = Kept { identities: key::identities(plan, cache), own: None, bands: Vec::new() };
        let own = cache.bands().map(Arc::new);
        let others = parts.iter().map(|folder| BandStore::open(folder).map(Arc::new));
        for (n, store) in std::iter::once(own).chain(others).enumerate() {
            match store.and_then(|store| Ok((store.list()?, store))) {
                Ok((bands, store)) => {
                    kept.bands.extend(bands.into_iter().map(|band| (store.clone(), band)));
                    kept.own = if n == 0 { Some(store) } else { kept.own };
                }
                Err(error) => {
                    trouble.push(format!("row bands of an earlier run cannot be looked up: {error}"))
                }
            }
        }
        (kept, trouble)
    }

    /// The bands of a task, by first row.
    pub(super) fn of(&self, task: TaskId) -> Vec<Found> {
        let Some(identity) = self.identities[task] else { return Vec::new() };
        let mut found: Vec<Found> = self
            .bands
            .iter()
            .filter(|(_, band)| band.identity == identity)
            .map(|(store, band)| Found { store: store.clone(), band: band.clone() })
            .collect();
        found.sort_by_key(|found| (found.band.start, found.band.end));
        found
    }

    /// Where a task's own bands are kept.
    pub(super) fn own(&self, task: TaskId) -> Option<(Arc<BandStore>, Digest)> {
        Some((self.own.clone()?, self.identities[task]?))
    }

    /// What a band has from `row` on, when it has that row and every output that is stored. A damaged one
    /// counts as missing: its rows are computed again.
    pub(super) fn load(&self, found: &Found, row: u32, task: &Task) -> Option<Loaded> {
        let rows = Rows { start: row, end: found.rows().end };
        // Notes count what is in all rows of a band, so a band is taken whole or not at all.
        if found.rows().start != row || rows.is_empty() {
            return None;
        }
        let load = |(port, meta): (&'static str, &Meta)| {
            Some((port, found.store.load(&found.band, port, meta).ok()?))
        };
        let outputs: Option<Vec<(&'static str, Value)>> =
            task.stored().map(|output| load((output.port, &output.meta))).collect();
        Some((rows, outputs?, (found.band.texts.clone(), found.band.counts.clone())))
    }
}
