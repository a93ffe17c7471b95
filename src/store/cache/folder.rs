//! The open folder of a cache: its records by key, its locks.

use super::bands::BandStore;
use super::files::{self, Identity, Owner};
use super::record::Record;
use crate::error::StoreError;
use photocurrent_core::Digest;
use std::collections::HashMap;
use std::fs::{File, OpenOptions};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, SystemTime};

/// An open cache. Cheap to share between threads; several may be open on one folder at once.
pub struct Cache {
    pub(super) root: PathBuf,
    pub(super) owner: Owner,
    /// Data files whose bytes were compared with their checksum by this instance.
    pub(super) verified: Mutex<HashMap<Digest, Identity>>,
    /// Keeps gc away as long as this lives.
    _shared: File,
}

/// What the cache knows of a key.
#[derive(Clone, Debug, PartialEq)]
pub enum Lookup {
    /// The record, all its stored outputs in place.
    Found(Box<Record>),
    /// Never made, or removed.
    Missing,
    /// There, but not to be trusted: treat as missing, and say why.
    Damaged {
        /// For a warning.
        why: String,
    },
}

/// How old a record's mark of use may grow before it is renewed: marking is for gc, which counts in days.
const USE_MARK: Duration = Duration::from_secs(3600);

impl Cache {
    /// Opens the cache at `root`, making its folders when needed. Waits while a gc runs.
    ///
    /// # Errors
    /// When the folders cannot be made or locked.
    pub fn open(root: &Path) -> Result<Cache, StoreError> {
        make_folders(root)?;
        let shared = lock_file(&root.join("lock"))?;
        shared.lock_shared().map_err(|error| StoreError::io(&root.join("lock"), "lock the cache", error))?;
        Ok(Cache {
            root: root.into(),
            owner: Owner::new(&root.join("tmp"))?,
            verified: Mutex::default(),
            _shared: shared,
        })
    }

    /// Row bands of results that are not complete.
    ///
    /// # Errors
    /// When the folder cannot be made.
    pub fn bands(&self) -> Result<BandStore, StoreError> {
        BandStore::open(&self.root.join("bands"))
    }

    /// Where it is.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Looks a key up, and checks that every stored output is there in full length. Contents are checked by
    /// [`Cache::load`].
    pub fn record(&self, key: &Digest) -> Lookup {
        let path = self.record_path(key);
        let record = match read_record(&path) {
            Ok(Some(record)) => record,
            Ok(None) => return Lookup::Missing,
            Err(why) => return Lookup::Damaged { why },
        };
        if record.key != *key || record.compute_key() != *key {
            return Lookup::Damaged {
                why: format!("{}: the ingredients are not those of the key", path.display()),
            };
        }
        for (port, output) in &record.outputs {
            if let Some(output) = output
                && let Err(error) = self.has_length(&output.digest)
            {
                return Lookup::Damaged { why: format!("output `{port}`: {error}") };
            }
        }
        mark_used(&path);
        Lookup::Found(Box::new(record))
    }

    /// Every record that can be read, by key.
    ///
    /// # Errors
    /// When the folder cannot be listed.
    pub fn records(&self) -> Result<Vec<Record>, StoreError> {
        let names = files::names_in(&self.root.join("keys"))?;
        Ok(names
            .iter()
            .filter_map(|name| read_record(&self.root.join("keys").join(name)).ok().flatten())
            .collect())
    }

    /// Keeps a record. Store its outputs first: a record promises that they are there.
    ///
    /// # Errors
    /// When the key is not that of the ingredients, or the file cannot be written.
    pub fn commit(&self, record: &Record) -> Result<(), StoreError> {
        let path = self.record_path(&record.key);
        let misuse = |what: String| StoreError::Misuse { path: path.clone(), what };
        if record.compute_key() != record.key {
            return Err(misuse("the key of a record is not that of its ingredients".into()));
        }
        let text = toml::to_string(record)
            .map_err(|error| misuse(format!("the record cannot be written as TOML: {error}")))?;
        self.owner.write(&path, text.as_bytes())
    }

    pub(super) fn record_path(&self, key: &Digest) -> PathBuf {
        self.root.join("keys").join(format!("{key}.toml"))
    }
}

pub(super) fn make_folders(root: &Path) -> Result<(), StoreError> {
    for name in ["keys", "data", "bands", "tmp", "history", "files"] {
        let folder = root.join(name);
        std::fs::create_dir_all(&folder)
            .map_err(|error| StoreError::io(&folder, "make the folder", error))?;
    }
    Ok(())
}

pub(super) fn lock_file(path: &Path) -> Result<File, StoreError> {
    OpenOptions::new()
        .create(true)
        .truncate(false)
        .write(true)
        .open(path)
        .map_err(|error| StoreError::io(path, "open the lock", error))
}

/// A record's file; `None` when there is none, the reason in words when it cannot be read.
pub(super) fn read_record(path: &Path) -> Result<Option<Record>, String> {
    match std::fs::read_to_string(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(format!("{}: {error}", path.display())),
        Ok(text) => toml::from_str(&text)
            .map(Some)
            .map_err(|error| format!("{}: not a record: {}", path.display(), error.message())),
    }
}

/// Renews the record's modification time, by which gc sees what was used last. Best effort: a cache on a
/// read-only disk still reads.
fn mark_used(path: &Path) {
    let now = SystemTime::now();
    let recent = std::fs::metadata(path)
        .and_then(|metadata| metadata.modified())
        .is_ok_and(|at| now.duration_since(at).is_ok_and(|age| age < USE_MARK));
    if !recent {
        let _ = OpenOptions::new().write(true).open(path).and_then(|file| file.set_modified(now));
    }
}
