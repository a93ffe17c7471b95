//! Files for the user: written next to their place, stamped, and swapped in at once.
//!
//! A node that exports gets an empty folder next to its destination. When it is done the engine adds a stamp
//! (the key, each file's size and digest), makes everything reach the disk, and exchanges the two folders in
//! one step: a reader sees the old files or the new ones, never a mixture. What a killed run left half-made
//! is removed by the next one. A folder that holds anything the stamp does not name is somebody's own and is
//! never replaced.

use photocurrent_core::{Digest, NodeError};
use serde::{Deserialize, Serialize};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// The stamp's file name.
pub const STAMP: &str = ".photocurrent.toml";

/// What the stamp says about one file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StampedFile {
    /// Relative to the folder, parts joined by `/`.
    pub name: String,
    /// Its size.
    pub bytes: u64,
    /// Of its bytes.
    pub digest: Digest,
}

/// The stamp in an exported folder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// The key that the files were made under.
    pub key: Digest,
    /// Every file.
    #[serde(default)]
    pub files: Vec<StampedFile>,
}

fn files_error(path: &Path, doing: &str, error: &io::Error) -> NodeError {
    NodeError::files(format!("{}: cannot {doing}: {error}", path.display()))
}

/// Reads a folder's stamp; `None` when there is none or it cannot be understood.
pub fn read_stamp(folder: &Path) -> Option<Stamp> {
    toml::from_str(&fs::read_to_string(folder.join(STAMP)).ok()?).ok()
}

/// Are the files of `key` in a folder, each with its size? The reason when not.
pub(crate) fn check_current(folder: &Path, key: &Digest) -> Result<(), String> {
    let Some(stamp) = read_stamp(folder) else { return Err("exported files are gone".into()) };
    if stamp.key != *key {
        return Err(format!("{} holds files of another run", folder.display()));
    }
    for file in &stamp.files {
        match fs::metadata(folder.join(&file.name)) {
            Err(_) => return Err(format!("exported file {} is gone", file.name)),
            Ok(found) if found.len() != file.bytes => {
                return Err(format!("exported file {} changed its size", file.name));
            }
            Ok(_) => {}
        }
    }
    Ok(())
}

/// May the engine replace this folder? Refuses what it did not write.
pub(crate) fn check_free(folder: &Path) -> Result<(), NodeError> {
    let found = match list(folder) {
        Ok(found) => found,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(files_error(folder, "list the folder", &error)),
    };
    let ours: Vec<String> = read_stamp(folder)
        .map(|stamp| stamp.files.into_iter().map(|file| file.name).collect())
        .unwrap_or_default();
    let foreign: Vec<&String> = found.iter().filter(|name| *name != STAMP && !ours.contains(name)).collect();
    let Some(first) = foreign.first() else { return Ok(()) };
    let rest = if foreign.len() > 1 { format!(" and {} more", foreign.len() - 1) } else { String::new() };
    let error =
        NodeError::files(format!("{} holds files that this tool did not write there", folder.display()));
    Err(error
        .note(format!("found {first}{rest}"))
        .hint("move them away, or choose another output folder with `--out`"))
}

/// All files below a folder, as sorted relative names.
fn list(folder: &Path) -> io::Result<Vec<String>> {
    fn walk(folder: &Path, prefix: &str, names: &mut Vec<String>) -> io::Result<()> {
        for entry in fs::read_dir(folder)? {
            let entry = entry?;
            let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
            if entry.file_type()?.is_dir() {
                walk(&entry.path(), &format!("{name}/"), names)?
            } else {
                names.push(name)
            }
        }
        Ok(())
    }
    let mut names = Vec::new();
    walk(folder, "", &mut names)?;
    names.sort();
    Ok(names)
}

/// How the name of a folder in the making ends.
const PARTIAL: &str = ".partial";

/// Removes half-made folders next to a destination whose makers are gone. What cannot be removed does no harm
/// where it is.
fn remove_what_the_dead_left(parent: &Path, name: &str) {
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let found = entry.file_name();
        let is_partial = found
            .to_str()
            .is_some_and(|found| found.starts_with(&format!(".{name}.")) && found.ends_with(PARTIAL));
        // The lock is held until the folder is gone: its maker, when it has not locked it yet, waits, and
        // then makes another.
        if is_partial
            && let Ok(folder) = fs::File::open(entry.path())
            && folder.try_lock().is_ok()
        {
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

/// A folder in the making; removed unless it is published.
pub(crate) struct Staging {
    folder: PathBuf,
    /// Held as long as this lives; the system lets go of it when the process dies, however it dies.
    _lock: fs::File,
    destination: PathBuf,
}

impl Staging {
    /// An empty folder next to `destination`.
    pub(crate) fn create(destination: &Path) -> Result<Staging, NodeError> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        check_free(destination)?;
        let parent = destination.parent().unwrap_or(Path::new(""));
        let name = destination.file_name().unwrap_or_default().to_string_lossy();
        remove_what_the_dead_left(parent, &name);
        loop {
            // The process and a count in the name: two runs at once never share a folder.
            let count = COUNT.fetch_add(1, Ordering::Relaxed);
            let folder = parent.join(format!(".{name}.{}-{count}{PARTIAL}", std::process::id()));
            fs::create_dir_all(&folder).map_err(|error| files_error(&folder, "make the folder", &error))?;
            let lock = match fs::File::open(&folder) {
                Ok(lock) => lock,
                // Another run has taken it for a dead one's already.
                Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                Err(error) => return Err(files_error(&folder, "make the folder", &error)),
            };
            // A file system without locks serves one run at a time just as well.
            let _ = lock.lock();
            // Between making and locking, another run may have taken the folder for a dead one's.
            if folder.exists() {
                return Ok(Staging { folder, _lock: lock, destination: destination.to_path_buf() });
            }
        }
    }

    /// Where the node writes.
    pub(crate) fn path(&self) -> &Path {
        &self.folder
    }

    /// Stamps the files and puts the folder in its place.
    pub(crate) fn publish(self, key: Digest) -> Result<Vec<StampedFile>, NodeError> {
        let stamp = Stamp { key, files: self.stamped()? };
        let text = toml::to_string(&stamp)
            .map_err(|error| NodeError::failed(format!("cannot write the stamp: {error}")))?;
        let path = self.folder.join(STAMP);
        fs::write(
            &path,
            format!("# Written by photocurrent. Files named here are replaced by the next run.\n{text}"),
        )
        .and_then(|()| fs::File::open(&path)?.sync_all())
        .and_then(|()| fs::File::open(&self.folder)?.sync_all())
        .map_err(|error| files_error(&path, "write the stamp", &error))?;
        // Checked again: the run may have taken hours.
        check_free(&self.destination)?;
        swap(&self.folder, &self.destination)
            .map_err(|error| files_error(&self.destination, "put the files in their place", &error))?;
        if let Some(parent) = self.destination.parent() {
            // Not every file system can sync a folder, and the files themselves are safe already.
            let _ = fs::File::open(parent).and_then(|folder| folder.sync_all());
        }
        Ok(stamp.files)
    }

    fn stamped(&self) -> Result<Vec<StampedFile>, NodeError> {
        let names =
            list(&self.folder).map_err(|error| files_error(&self.folder, "list the folder", &error))?;
        let stamp = |name: String| {
            let path = self.folder.join(&name);
            let file = fs::File::open(&path)?;
            let mut hash = blake3::Hasher::new();
            hash.update_reader(&file)?;
            file.sync_all()?;
            Ok(StampedFile {
                name,
                bytes: file.metadata()?.len(),
                digest: Digest::from_bytes(*hash.finalize().as_bytes()),
            })
        };
        names
            .into_iter()
            .map(stamp)
            .collect::<io::Result<_>>()
            .map_err(|error| files_error(&self.folder, "read back the files", &error))
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        // After a swap this is the old folder, or nothing at all.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Puts `new` at `place`; what was there is at `new` afterwards.
fn swap(new: &Path, place: &Path) -> io::Result<()> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    if !place.exists() {
        match fs::rename(new, place) {
            // Another run has put its files there in the meantime: change places with them.
            Err(error)
                if matches!(
                    error.kind(),
                    io::ErrorKind::DirectoryNotEmpty | io::ErrorKind::AlreadyExists
                ) => {}
            done => return done,
        }
    }
    match renameat_with(CWD, new, CWD, place, RenameFlags::EXCHANGE) {
        Ok(()) => Ok(()),
        // A file system without the exchange: two renames, with a moment between them when the place is
        // empty.
        Err(rustix::io::Errno::INVAL | rustix::io::Errno::NOSYS | rustix::io::Errno::NOTSUP) => {
            let aside = new.with_extension("old");
            fs::rename(place, &aside)?;
            fs::rename(new, place)?;
            fs::rename(&aside, new)
        }
        Err(error) => Err(error.into()),
    }
}
