//! Values in the cache: writing them to their name, checking their bytes, opening them.
//!
//! Two writers may make one content at once, and their files may differ in bytes though not in content. So
//! the pair (checksum, data) is placed under a lock that is held only for that moment, and a reader that
//! finds a pair that does not fit looks again under the same lock.

use super::bands::Temporary;
use super::files::{self, Identity};
use super::folder::{Cache, lock_file};
use super::record::StoredOutput;
use crate::error::StoreError;
use crate::layout::{ValueWriter, open_stored};
use photocurrent_core::{DataType, Digest, Meta, Value};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::PoisonError;

/// The checksum file next to a data file.
#[derive(Serialize, Deserialize)]
struct Sum {
    bytes: u64,
    blake3: Digest,
}

impl Cache {
    /// Begins to store a value.
    ///
    /// # Errors
    /// When the file cannot be created, or `meta` says that there is nothing to store.
    pub fn writer(&self, meta: &Meta) -> Result<CacheWriter<'_>, StoreError> {
        let temporary = Temporary(self.owner.temporary("h5"));
        let writer = ValueWriter::create(&temporary.0, meta)?;
        Ok(CacheWriter { cache: self, writer, temporary, data_type: meta.data_type() })
    }

    /// Opens a stored value; its data are read when they are asked for. Compares the file's bytes with their
    /// checksum, once per instance: about a second per gigabyte.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] when the file is missing or not as it was written: run the node again. Others
    /// when it cannot be read at all.
    pub fn load(&self, digest: &Digest) -> Result<Value, StoreError> {
        if self.intact(digest).is_err() {
            // Perhaps somebody is between placing the checksum and the data.
            let _placing = self.placing()?;
            self.intact(digest)?;
        }
        open_stored(&self.data_path(digest))
    }

    pub(super) fn data_path(&self, digest: &Digest) -> PathBuf {
        data_path(&self.root, digest)
    }

    fn placing(&self) -> Result<std::fs::File, StoreError> {
        let path = self.root.join("commit.lock");
        let file = lock_file(&path)?;
        file.lock().map_err(|error| StoreError::io(&path, "lock the cache", error))?;
        Ok(file)
    }

    /// Moves a synced file of a content to its name, with its checksum, unless an intact one is there.
    pub(super) fn place(&self, digest: &Digest, temporary: &Temporary) -> Result<(), StoreError> {
        let bytes = Identity::of(&temporary.0)
            .map_err(|error| StoreError::io(&temporary.0, "read the file", error))?
            .bytes;
        let sum = Sum { bytes, blake3: files::hash_file(&temporary.0)? };
        let sum = toml::to_string(&sum)
            .map_err(|error| StoreError::Misuse { path: temporary.0.clone(), what: error.to_string() })?;
        let _placing = self.placing()?;
        // Somebody may have placed the same content since; when that is intact, ours is not needed.
        if self.intact(digest).is_err() {
            self.owner.write(&sum_path(&self.root, digest), sum.as_bytes())?;
            files::rename(&temporary.0, &self.data_path(digest))?;
            // The bytes were hashed a moment ago: no need to read them again.
            if let Ok(identity) = Identity::of(&self.data_path(digest)) {
                self.verified.lock().unwrap_or_else(PoisonError::into_inner).insert(*digest, identity);
            }
        }
        Ok(())
    }

    /// Checks presence and length only.
    pub(super) fn has_length(&self, digest: &Digest) -> Result<(), StoreError> {
        if checked_length(&self.root, digest).is_err() {
            let _placing = self.placing()?;
            checked_length(&self.root, digest)?;
        }
        Ok(())
    }

    /// Checks the bytes as well.
    pub(super) fn intact(&self, digest: &Digest) -> Result<(), StoreError> {
        let (sum, identity) = checked_length(&self.root, digest)?;
        if self.verified.lock().unwrap_or_else(PoisonError::into_inner).get(digest) == Some(&identity) {
            return Ok(());
        }
        let path = self.data_path(digest);
        if files::hash_file(&path)? != sum.blake3 {
            return Err(StoreError::Damaged {
                path,
                why: "its bytes are not those that were written".into(),
            });
        }
        self.verified.lock().unwrap_or_else(PoisonError::into_inner).insert(*digest, identity);
        Ok(())
    }
}

pub(super) fn data_path(root: &Path, digest: &Digest) -> PathBuf {
    root.join("data").join(format!("{digest}.h5"))
}

pub(super) fn sum_path(root: &Path, digest: &Digest) -> PathBuf {
    root.join("data").join(format!("{digest}.sum"))
}

fn checked_length(root: &Path, digest: &Digest) -> Result<(Sum, Identity), StoreError> {
    let path = data_path(root, digest);
    let damaged = |why: String| StoreError::Damaged { path: path.clone(), why };
    let identity =
        Identity::of(&path).map_err(|error| damaged(format!("its data cannot be read ({error})")))?;
    let sum = std::fs::read_to_string(sum_path(root, digest))
        .map_err(|error| damaged(format!("its checksum cannot be read ({error})")))?;
    let sum: Sum = toml::from_str(&sum)
        .map_err(|error| damaged(format!("its checksum is no checksum ({})", error.message())))?;
    if sum.bytes != identity.bytes {
        return Err(damaged(format!("it has {} bytes instead of {}", identity.bytes, sum.bytes)));
    }
    Ok((sum, identity))
}

/// Stores one value, band by band; dropped before [`CacheWriter::finish`], it leaves nothing behind.
pub struct CacheWriter<'a> {
    cache: &'a Cache,
    writer: ValueWriter,
    temporary: Temporary,
    data_type: DataType,
}

impl CacheWriter<'_> {
    /// Adds the next rows; what is not banded comes in one piece.
    ///
    /// # Errors
    /// As [`ValueWriter::append`].
    pub fn append(&mut self, part: &Value) -> Result<(), StoreError> {
        self.writer.append(part)
    }

    /// Completes the value and moves it to its name. An intact file of the same content is kept; a damaged
    /// one is replaced.
    ///
    /// # Errors
    /// When rows are missing or the file cannot be written.
    pub fn finish(self) -> Result<StoredOutput, StoreError> {
        let CacheWriter { cache, writer, temporary, data_type } = self;
        let (digest, bytes) = writer.finish()?;
        let stored = StoredOutput { data_type, digest, bytes };
        if cache.intact(&digest).is_ok() {
            return Ok(stored);
        }
        files::sync(&temporary.0)?;
        cache.place(&digest, &temporary)?;
        Ok(stored)
    }
}
