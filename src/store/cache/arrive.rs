//! Entries that come from another cache: taken in, held against their names, and placed together.
//!
//! Nothing is placed before all of it is found to be right, and in the order of a run: contents first, then
//! the records that name them. What the cache has already stays as it is.

use super::bands::Temporary;
use super::content::data_path;
use super::folder::{Cache, Lookup};
use super::record::Record;
use crate::error::StoreError;
use crate::layout::open_value;
use photocurrent_core::Digest;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Entries on their way into a cache; dropped before [`Arrivals::place`], they leave nothing behind.
pub struct Arrivals<'a> {
    cache: &'a Cache,
    contents: BTreeMap<Digest, Temporary>,
    records: Vec<Record>,
}

/// What was placed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Placed {
    /// Records that the cache did not have, or lacked outputs of.
    pub records: u64,
    /// Contents that it did not have.
    pub contents: u64,
}

impl Cache {
    /// The file of a content, its bytes compared with their checksum.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] when it is missing or not as it was written.
    pub fn content_file(&self, digest: &Digest) -> Result<PathBuf, StoreError> {
        self.intact(digest)?;
        Ok(data_path(&self.root, digest))
    }

    /// Begins to take entries in.
    pub fn arrivals(&self) -> Arrivals<'_> {
        Arrivals { cache: self, contents: BTreeMap::new(), records: Vec::new() }
    }
}

impl Arrivals<'_> {
    /// Takes a record in, from its text.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] when it is no record, or one of another key.
    pub fn record(&mut self, key: &Digest, text: &str) -> Result<(), StoreError> {
        let damaged =
            |why: String| StoreError::Damaged { path: Path::new("keys").join(format!("{key}.toml")), why };
        let record: Record =
            toml::from_str(text).map_err(|error| damaged(format!("no record: {}", error.message())))?;
        if record.key != *key || record.compute_key() != *key {
            return Err(damaged("the ingredients are not those of the key".into()));
        }
        self.records.push(record);
        Ok(())
    }

    /// Takes a content in, from the bytes of its file, and compares its digest with its name. One that the
    /// cache has is not read.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] when it cannot be read or has another digest.
    pub fn content(&mut self, digest: &Digest, bytes: &mut dyn Read) -> Result<(), StoreError> {
        if self.contents.contains_key(digest) || self.cache.intact(digest).is_ok() {
            return Ok(());
        }
        let temporary = Temporary(self.cache.owner.temporary("h5"));
        let shown = Path::new("data").join(format!("{digest}.h5"));
        let io = |error| StoreError::io(&temporary.0, "write a file", error);
        let mut file = File::create(&temporary.0).map_err(io)?;
        std::io::copy(bytes, &mut file).map_err(|error| StoreError::io(&shown, "take it in", error))?;
        file.sync_all().map_err(io)?;
        let damaged = |why: String| StoreError::Damaged { path: shown.clone(), why };
        // From outside: the library tries it in a process of its own first.
        let value = open_value(&temporary.0).map_err(|error| {
            damaged(error.to_string().replace(&*temporary.0.to_string_lossy(), "its file"))
        })?;
        let found = value.digest().map_err(|error| damaged(error.message))?;
        if found != *digest {
            return Err(damaged(format!("its content is that of {}", found.short())));
        }
        self.contents.insert(*digest, temporary);
        Ok(())
    }

    /// Puts everything in its place.
    ///
    /// # Errors
    /// [`StoreError::Damaged`], and nothing is placed, when a record names a content that is neither here nor
    /// in the cache; others when a file cannot be written.
    pub fn place(self) -> Result<Placed, StoreError> {
        for record in &self.records {
            for (port, output) in &record.outputs {
                if let Some(output) = output
                    && !self.contents.contains_key(&output.digest)
                    && self.cache.intact(&output.digest).is_err()
                {
                    let path = Path::new("keys").join(format!("{}.toml", record.key));
                    let why = format!("the content of its output `{port}` is missing");
                    return Err(StoreError::Damaged { path, why });
                }
            }
        }
        let mut placed = Placed::default();
        for (digest, temporary) in &self.contents {
            self.cache.place(digest, temporary)?;
            placed.contents += 1;
        }
        for mut record in self.records {
            if let Lookup::Found(there) = self.cache.record(&record.key) {
                let lacks = |(port, output): (&String, &Option<_>)| {
                    output.is_some() && !matches!(there.outputs.get(port), Some(Some(_)))
                };
                if !record.outputs.iter().any(lacks) {
                    continue;
                }
                // One that was made when less was wanted: what it has stays.
                let outputs = there.outputs.into_iter().filter(|(_, output)| output.is_some());
                record.outputs.extend(outputs);
            }
            self.cache.commit(&record)?;
            placed.records += 1;
        }
        Ok(placed)
    }
}
