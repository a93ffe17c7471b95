//! Housekeeping: what is there, how large it is, what may go, and whether it is whole.

use super::content::{data_path, sum_path};
use super::folder::{Cache, Lookup, lock_file, make_folders, read_record};
use super::record::StoredOutput;
use super::{files, memory};
use crate::error::StoreError;
use crate::layout::open_stored;
use photocurrent_core::Digest;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::TryLockError;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// One record in a list.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Listing {
    /// Its key.
    pub key: Digest,
    /// `solve/map`.
    pub kind: String,
    /// Outputs by port; `None` for one that is not stored.
    pub outputs: BTreeMap<String, Option<StoredOutput>>,
    /// Size of the stored outputs; one that several records share counts for each.
    pub bytes: u64,
    /// How long the node ran.
    pub seconds: f64,
    /// When it finished, seconds since 1970.
    pub created_unix_s: u64,
    /// When it was last looked up (to the hour), seconds since 1970.
    pub used_unix_s: u64,
}

/// How large the cache is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize)]
pub struct DiskUse {
    /// Number of records.
    pub records: u64,
    /// Number of data files.
    pub contents: u64,
    /// Bytes in data files.
    pub content_bytes: u64,
    /// Of these, bytes that no record names.
    pub unreferenced_bytes: u64,
    /// Bytes being written right now, or left by a killed run: row bands that the next one goes on from among
    /// them.
    pub temporary_bytes: u64,
}

/// What gc may remove.
#[derive(Clone, Debug, Default)]
pub struct GcOptions {
    /// Remove what was used least recently until the data take no more than this.
    pub max_bytes: Option<u64>,
    /// Remove what was not used for so long.
    pub older_than: Option<Duration>,
    /// Keys that stay in any case.
    pub keep: BTreeSet<Digest>,
    /// Say what would go, and remove nothing.
    pub dry_run: bool,
}

/// What gc removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize)]
pub struct GcReport {
    /// Records removed, damaged ones included.
    pub records: u64,
    /// Data files removed.
    pub contents: u64,
    /// Their bytes.
    pub freed_bytes: u64,
    /// Bytes that stay.
    pub kept_bytes: u64,
}

/// What a full check found.
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize)]
pub struct CheckReport {
    /// Records that are whole.
    pub good_records: u64,
    /// Contents that are whole.
    pub good_contents: u64,
    /// What is damaged, one line each. A run makes it again, and gc removes it.
    pub damaged: Vec<String>,
    /// Files that no record needs.
    pub orphans: Vec<PathBuf>,
}

impl Cache {
    /// Every readable record, last used first.
    ///
    /// # Errors
    /// When the folder cannot be listed.
    pub fn ls(&self) -> Result<Vec<Listing>, StoreError> {
        let mut listings: Vec<Listing> = self
            .records()?
            .into_iter()
            .map(|record| Listing {
                used_unix_s: unix_s(used(&self.record_path(&record.key))),
                key: record.key,
                kind: record.ingredients.kind,
                bytes: record
                    .outputs
                    .values()
                    .flatten()
                    .map(|output| length(&data_path(&self.root, &output.digest)))
                    .sum(),
                outputs: record.outputs,
                seconds: record.seconds,
                created_unix_s: record.created_unix_s,
            })
            .collect();
        listings.sort_by_key(|listing| (std::cmp::Reverse(listing.used_unix_s), listing.key));
        Ok(listings)
    }

    /// How large the cache is.
    ///
    /// # Errors
    /// When a folder cannot be listed.
    pub fn du(&self) -> Result<DiskUse, StoreError> {
        let records = self.records()?;
        let referenced: BTreeSet<Digest> = records
            .iter()
            .flat_map(|record| record.outputs.values().flatten().map(|output| output.digest))
            .collect();
        let mut found = DiskUse { records: records.len() as u64, ..DiskUse::default() };
        for (digest, path) in contents(&self.root)? {
            let bytes = length(&path);
            found.contents += 1;
            found.content_bytes += bytes;
            found.unreferenced_bytes += if referenced.contains(&digest) { 0 } else { bytes };
        }
        for folder in ["tmp", "bands"].map(|name| self.root.join(name)) {
            found.temporary_bytes +=
                files::names_in(&folder)?.iter().map(|name| length(&folder.join(name))).sum::<u64>();
        }
        Ok(found)
    }

    /// Reads everything again: records, checksums, and the digest of every content.
    ///
    /// # Errors
    /// When a folder cannot be listed.
    pub fn verify(&self) -> Result<CheckReport, StoreError> {
        let mut report = CheckReport::default();
        let mut referenced = BTreeSet::new();
        let keys = self.root.join("keys");
        for name in files::names_in(&keys)? {
            let Some(key) = name.strip_suffix(".toml").and_then(|key| key.parse().ok()) else {
                report.orphans.push(keys.join(name));
                continue;
            };
            match self.record(&key) {
                Lookup::Found(record) => {
                    report.good_records += 1;
                    referenced.extend(record.outputs.values().flatten().map(|output| output.digest));
                }
                Lookup::Missing => {}
                Lookup::Damaged { why } => report.damaged.push(why),
            }
        }
        for (digest, path) in contents(&self.root)? {
            let found =
                self.intact(&digest).and_then(|_| open_stored(&path)).map_err(|error| error.to_string());
            match found.and_then(|value| value.digest().map_err(|error| error.message)) {
                Ok(found) if found == digest => report.good_contents += 1,
                Ok(found) => report.damaged.push(format!(
                    "{}: the content is that of {}",
                    path.display(),
                    found.short()
                )),
                Err(why) => report.damaged.push(why),
            }
            if !referenced.contains(&digest) {
                report.orphans.push(path);
            }
        }
        report.orphans.extend(strangers(&self.root)?);
        Ok(report)
    }

    /// Removes records that are old, damaged or too many, then the data that no record names, and digests of
    /// outside files that are gone.
    ///
    /// Not a method: it needs the cache for itself. Killed half way, it leaves data without records, which
    /// the next gc removes.
    ///
    /// # Errors
    /// [`StoreError::Busy`] while any run has the cache open; others when a file cannot be removed.
    pub fn gc(root: &Path, options: &GcOptions) -> Result<GcReport, StoreError> {
        make_folders(root)?;
        let lock = lock_file(&root.join("lock"))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(StoreError::Busy { path: root.into() }),
            Err(TryLockError::Error(error)) => return Err(StoreError::io(root, "lock the cache", error)),
        }
        let mut report = GcReport::default();
        let (stay, go) = choose(root, options)?;
        report.records = go.len() as u64;
        let referenced: BTreeSet<Digest> = stay.into_iter().flatten().collect();
        let mut unneeded = strangers(root)?;
        for (digest, path) in contents(root)? {
            let bytes = length(&path);
            if referenced.contains(&digest) {
                report.kept_bytes += bytes;
            } else {
                report.contents += 1;
                report.freed_bytes += bytes;
                unneeded.extend([path, sum_path(root, &digest)]);
            }
        }
        // Nobody has the cache open, so nobody is writing.
        for folder in ["tmp", "bands"].map(|name| root.join(name)) {
            unneeded.extend(files::names_in(&folder)?.iter().map(|name| folder.join(name)));
        }
        unneeded.extend(memory::useless(root)?);
        if !options.dry_run {
            go.iter().chain(&unneeded).try_for_each(|path| files::remove(path))?;
        }
        Ok(report)
    }
}

/// The contents of the records that stay, and the files of those that go.
#[allow(clippy::type_complexity)]
fn choose(root: &Path, options: &GcOptions) -> Result<(Vec<Vec<Digest>>, Vec<PathBuf>), StoreError> {
    struct Candidate {
        path: PathBuf,
        used: SystemTime,
        pinned: bool,
        contents: Vec<Digest>,
    }
    let keys = root.join("keys");
    let (mut stay, mut go) = (Vec::new(), Vec::new());
    for name in files::names_in(&keys)? {
        let path = keys.join(name);
        match read_record(&path) {
            Ok(Some(record))
                if record.compute_key() == record.key
                    && path == keys.join(format!("{}.toml", record.key)) =>
            {
                let contents = record.outputs.values().flatten().map(|output| output.digest).collect();
                stay.push(Candidate {
                    used: used(&path),
                    pinned: options.keep.contains(&record.key),
                    contents,
                    path,
                });
            }
            _ => go.push(path),
        }
    }
    if let Some(limit) = options.older_than {
        let now = SystemTime::now();
        let (old, young): (Vec<Candidate>, Vec<Candidate>) = stay.into_iter().partition(|candidate| {
            !candidate.pinned && now.duration_since(candidate.used).is_ok_and(|age| age > limit)
        });
        go.extend(old.into_iter().map(|candidate| candidate.path));
        stay = young;
    }
    if let Some(limit) = options.max_bytes {
        // Least recently used last, so that it is popped first; the name settles ties.
        stay.sort_by(|a, b| (b.used, &b.path).cmp(&(a.used, &a.path)));
        let mut users: BTreeMap<Digest, u64> = BTreeMap::new();
        stay.iter()
            .flat_map(|candidate| &candidate.contents)
            .for_each(|digest| *users.entry(*digest).or_default() += 1);
        let mut bytes: u64 = users.keys().map(|digest| length(&data_path(root, digest))).sum();
        let mut kept = Vec::new();
        while let Some(candidate) = stay.pop() {
            if bytes <= limit || candidate.pinned {
                kept.push(candidate);
                continue;
            }
            for digest in &candidate.contents {
                let count = users.entry(*digest).or_default();
                *count -= 1;
                if *count == 0 {
                    bytes -= length(&data_path(root, digest));
                }
            }
            go.push(candidate.path);
        }
        stay = kept;
    }
    Ok((stay.into_iter().map(|candidate| candidate.contents).collect(), go))
}

/// Data files by content.
fn contents(root: &Path) -> Result<Vec<(Digest, PathBuf)>, StoreError> {
    let data = root.join("data");
    let digest = |name: &String| name.strip_suffix(".h5").and_then(|digest| digest.parse().ok());
    Ok(files::names_in(&data)?
        .iter()
        .filter_map(|name| digest(name).map(|digest| (digest, data.join(name))))
        .collect())
}

/// Files below `data` that are neither a content nor the checksum of one.
fn strangers(root: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let data = root.join("data");
    let known: BTreeSet<PathBuf> =
        contents(root)?.into_iter().flat_map(|(digest, path)| [path, sum_path(root, &digest)]).collect();
    Ok(files::names_in(&data)?
        .iter()
        .map(|name| data.join(name))
        .filter(|path| !known.contains(path))
        .collect())
}

fn length(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |metadata| metadata.len())
}

fn used(path: &Path) -> SystemTime {
    std::fs::metadata(path).and_then(|metadata| metadata.modified()).unwrap_or(UNIX_EPOCH)
}

fn unix_s(time: SystemTime) -> u64 {
    time.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}
