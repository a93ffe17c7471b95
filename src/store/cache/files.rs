//! Files that are either whole or not there: temporary name, sync, rename, sync of the folder.
//!
//! Temporary names belong to an owner, which holds a lock on `tmp/<owner>.lock` as long as it lives. The
//! system releases the lock when the process dies, however it dies; so the next [`Owner::new`] sees which
//! temporary files nobody will finish. A process number would not do: containers that share a folder do not
//! share process numbers.

use crate::error::StoreError;
use photocurrent_core::Digest;
use std::collections::BTreeSet;
use std::fs::{File, OpenOptions};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Who temporary files belong to.
pub(super) struct Owner {
    folder: PathBuf,
    stem: String,
    next: AtomicU64,
    _lock: File,
}

impl Owner {
    /// Takes a name in `folder` and removes what dead owners left there.
    pub(super) fn new(folder: &Path) -> Result<Owner, StoreError> {
        let owner = loop {
            let random = RandomState::new().build_hasher().finish();
            let stem = format!("p{}-{random:016x}", std::process::id());
            let path = folder.join(format!("{stem}.lock"));
            let io = |error| StoreError::io(&path, "create a lock", error);
            let lock = OpenOptions::new().write(true).create_new(true).open(&path).map_err(io)?;
            lock.lock().map_err(io)?;
            // Between creating and locking, another process may have taken the file for a dead owner's and
            // removed it.
            if path.exists() {
                break Owner { folder: folder.into(), stem, next: AtomicU64::new(0), _lock: lock };
            }
        };
        owner.remove_what_the_dead_left()?;
        Ok(owner)
    }

    /// A name that nobody else uses.
    pub(super) fn temporary(&self, extension: &str) -> PathBuf {
        self.folder.join(format!("{}-{}.{extension}", self.stem, self.next.fetch_add(1, Ordering::Relaxed)))
    }

    fn remove_what_the_dead_left(&self) -> Result<(), StoreError> {
        let names = names_in(&self.folder)?;
        let stems: BTreeSet<&str> =
            names.iter().filter_map(|name| stem_of(name)).filter(|stem| *stem != self.stem).collect();
        for stem in stems {
            // Held until its files are gone: a newborn that has not locked its file yet waits here, and then
            // finds the file gone.
            let lock = match OpenOptions::new().write(true).open(self.folder.join(format!("{stem}.lock"))) {
                Ok(lock) => match lock.try_lock() {
                    Ok(()) => Some(lock),
                    Err(_) => continue,
                },
                // An owner has its lock as long as it lives, so there is none.
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
                Err(_) => continue,
            };
            for name in names.iter().filter(|name| stem_of(name) == Some(stem) && !name.ends_with(".lock")) {
                remove(&self.folder.join(name))?;
            }
            remove(&self.folder.join(format!("{stem}.lock")))?;
            drop(lock);
        }
        Ok(())
    }

    /// Writes a small file: afterwards it is there with these bytes, or as it was before.
    pub(super) fn write(&self, target: &Path, bytes: &[u8]) -> Result<(), StoreError> {
        let temporary = self.temporary("part");
        let written =
            File::create(&temporary).and_then(|mut file| file.write_all(bytes).and_then(|_| file.sync_all()));
        let result = written
            .map_err(|error| StoreError::io(&temporary, "write a file", error))
            .and_then(|_| rename(&temporary, target));
        if result.is_err() {
            // Nothing more to say when this fails too: the first error is the one to report.
            let _ = std::fs::remove_file(&temporary);
        }
        result
    }
}

impl Drop for Owner {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(self.folder.join(format!("{}.lock", self.stem)));
    }
}

/// The owner in a temporary name, `p<process>-<random>-<count>.<extension>` or `p<process>-<random>.lock`.
fn stem_of(name: &str) -> Option<&str> {
    let stem = name.strip_suffix(".lock").or_else(|| name.rsplit_once('-').map(|(stem, _)| stem))?;
    stem.strip_prefix('p').and_then(|rest| rest.split_once('-')).map(|_| stem)
}

/// Moves a synced file to its place, for good.
pub(super) fn rename(from: &Path, to: &Path) -> Result<(), StoreError> {
    std::fs::rename(from, to).map_err(|error| StoreError::io(to, "move a file to its place", error))?;
    let folder = to.parent().unwrap_or(Path::new("."));
    File::open(folder)
        .and_then(|folder| folder.sync_all())
        .map_err(|error| StoreError::io(folder, "sync the folder", error))
}

/// Forces a file's bytes to the disk.
pub(super) fn sync(path: &Path) -> Result<(), StoreError> {
    File::open(path)
        .and_then(|file| file.sync_all())
        .map_err(|error| StoreError::io(path, "sync the file", error))
}

/// Removes a file; one that is gone already is fine.
pub(super) fn remove(path: &Path) -> Result<(), StoreError> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(StoreError::io(path, "remove the file", error))
        }
        _ => Ok(()),
    }
}

/// Names in a folder, sorted.
pub(super) fn names_in(folder: &Path) -> Result<Vec<String>, StoreError> {
    let io = |error| StoreError::io(folder, "list the folder", error);
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        // A name that is no UTF-8 is none of ours.
        names.extend(entry.map_err(io)?.file_name().into_string().ok());
    }
    names.sort();
    Ok(names)
}

/// BLAKE3 of a whole file, in pieces.
pub(super) fn hash_file(path: &Path) -> Result<Digest, StoreError> {
    let io = |error| StoreError::io(path, "read the file", error);
    let mut file = File::open(path).map_err(io)?;
    let mut hasher = blake3::Hasher::new();
    let mut buffer = vec![0; 4 << 20];
    loop {
        let mut filled = 0;
        while filled < buffer.len() {
            match file.read(&mut buffer[filled..]) {
                Ok(0) => break,
                Ok(n) => filled += n,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(io(error)),
            }
        }
        // Not in parallel: during a long solve, rayon's pool would let it wait.
        hasher.update(&buffer[..filled]);
        if filled < buffer.len() {
            return Ok(Digest::from_bytes(*hasher.finalize().as_bytes()));
        }
    }
}

/// Which file this is, as far as the system says without reading it.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub(super) struct Identity {
    pub bytes: u64,
    pub inode: u64,
    pub mtime_ns: i64,
    /// Time of the last change of any kind: a copy that keeps the old mtime does not keep this one.
    pub ctime_ns: i64,
}

impl Identity {
    pub(super) fn of(path: &Path) -> std::io::Result<Identity> {
        use std::os::unix::fs::MetadataExt;
        let metadata = std::fs::metadata(path)?;
        let ns = |seconds: i64, ns: i64| seconds.saturating_mul(1_000_000_000).saturating_add(ns);
        Ok(Identity {
            bytes: metadata.len(),
            inode: metadata.ino(),
            mtime_ns: ns(metadata.mtime(), metadata.mtime_nsec()),
            ctime_ns: ns(metadata.ctime(), metadata.ctime_nsec()),
        })
    }
}
