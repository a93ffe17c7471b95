//! The door to HDF5: opening files with care, and texts and attributes in whichever way other programs write
//! them.
//!
//! The library has one global lock, so heavy work is kept outside it: chunks are packed and unpacked by us in
//! parallel ([`pack`], [`pipeline`]) and pass through the library as raw bytes ([`chunks`], [`write`]). No
//! lock is held while they work, or a stolen task could wait for its own thread.
//!
//! Care means: external links are unregistered and plugins are off before the first file is opened; a file
//! from outside is tried in a process of its own ([`trial`]); a dataset whose bytes lie in other files is
//! refused; and what a dataset claims to hold is compared with what the file can hold.

pub(crate) mod chunks;
pub(crate) mod codec;
mod cut;
pub(crate) mod grid;
mod guard;
mod library;
pub(crate) mod number;
pub(crate) mod pack;
pub(crate) mod pipeline;
pub(crate) mod text;
mod trial;
pub(crate) mod write;

pub(crate) use library::{locked, short};

use crate::error::StoreError;
use cut::Superblock;
use hdf5::dataset::Layout;
use hdf5::{Dataset, File, Group};
use pipeline::Pipeline;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// A number that can stand in a dataset.
pub(crate) trait Item: hdf5::H5Type + bytemuck::Pod + Default + Send + Sync {}
impl<T: hdf5::H5Type + bytemuck::Pod + Default + Send + Sync> Item for T {}

/// A dataset with a filter that we do not know and that claims more than this factor was never written, or
/// lies: deflate cannot shrink by more than about 1032. Filters that we know have bounds of their own.
const LARGEST_RATIO: u64 = 1100;

/// No chunk may be larger: the library would take that much memory for one number.
const LARGEST_CHUNK: u64 = 1 << 30;

/// Groups in groups are followed so far: no layout that is read has half as many.
const DEEPEST: usize = 10;

/// An open file and its name, for messages.
#[derive(Clone)]
pub(crate) struct Opened {
    pub path: PathBuf,
    pub file: File,
    /// Size of the file when it was opened: no chunk can be larger.
    pub bytes: u64,
    /// The size that the file states, where it ends earlier: what lies behind its end is lost.
    pub stated_bytes: Option<u64>,
    /// Are chunks packed that are written?
    pub packs: bool,
}

impl Opened {
    /// Opens a file from outside for reading: tried in a process of its own first, and as far as it goes when
    /// it is cut.
    pub(crate) fn read(path: &Path) -> Result<Opened, StoreError> {
        refuse_what_is_not_hdf5(path)?;
        trial::pass(path)?;
        Opened::open(path)
    }

    /// Opens a file that we wrote for reading: whole or not at all.
    pub(crate) fn read_ours(path: &Path) -> Result<Opened, StoreError> {
        let Start { bytes, .. } = refuse_what_is_not_hdf5(path)?;
        Opened::whole(path, bytes)
    }

    /// Opens for reading without a trial.
    fn open(path: &Path) -> Result<Opened, StoreError> {
        let Start { bytes, superblock } = refuse_what_is_not_hdf5(path)?;
        match superblock.filter(|superblock| superblock.end > bytes) {
            None => Opened::whole(path, bytes),
            Some(superblock) => {
                let file = cut::open(path, superblock, bytes)?;
                Ok(Opened { path: path.into(), file, bytes, stated_bytes: Some(superblock.end), packs: true })
            }
        }
    }

    fn whole(path: &Path, bytes: u64) -> Result<Opened, StoreError> {
        let file = locked(|| File::open(path)).map_err(|error| StoreError::NotReadable {
            path: path.into(),
            found: format!("the HDF5 library cannot open the file: {}", short(&error)),
            hint: hint_for(&short(&error)).into(),
        })?;
        Ok(Opened { path: path.into(), file, bytes, stated_bytes: None, packs: true })
    }

    /// "the file is cut at byte 1000 of 2000", of one that ends before its stated end.
    pub(crate) fn cut(&self) -> Option<String> {
        self.stated_bytes.map(|stated| format!("the file is cut at byte {} of {stated}", self.bytes))
    }

    /// Creates, replacing what is there.
    pub(crate) fn create(path: &Path) -> Result<Opened, StoreError> {
        let file = locked(|| File::create(path)).map_err(|error| StoreError::Library {
            path: path.into(),
            at: "/".into(),
            doing: "create the file",
            detail: short(&error),
        })?;
        Ok(Opened { path: path.into(), file, bytes: 0, stated_bytes: None, packs: true })
    }

    /// Turns a library error into ours.
    pub(crate) fn wrap<T>(
        &self,
        at: &str,
        doing: &'static str,
        result: hdf5::Result<T>,
    ) -> Result<T, StoreError> {
        result.map_err(|error| StoreError::Library {
            path: self.path.clone(),
            at: at.into(),
            doing,
            detail: short(&error),
        })
    }

    /// An error about something inside.
    pub(crate) fn content(
        &self,
        at: &str,
        found: impl Into<String>,
        expected: impl Into<String>,
        hint: impl Into<String>,
    ) -> StoreError {
        StoreError::content(&self.path, at, found, expected, hint)
    }

    /// A group of the root; `None` when there is none.
    pub(crate) fn group(&self, name: &str) -> Result<Option<Group>, StoreError> {
        if !locked(|| self.file.link_exists(name)) {
            return Ok(None);
        }
        self.wrap(&format!("/{name}"), "open the group", locked(|| self.file.group(name))).map(Some)
    }

    /// Is there a link of this name, `group/group/name`, and to each of its groups?
    pub(crate) fn exists(&self, name: &str) -> bool {
        let ends = name.match_indices('/').map(|(at, _)| at).chain([name.len()]);
        name.split('/').count() <= DEEPEST
            && locked(|| ends.into_iter().all(|end| self.file.link_exists(&name[..end])))
    }

    /// A dataset, `group/name` or `name`, after the checks of this module; `None` when there is none.
    pub(crate) fn dataset(&self, name: &str) -> Result<Option<Dataset>, StoreError> {
        if !self.exists(name) {
            return Ok(None);
        }
        let at = format!("/{name}");
        let dataset = self.wrap(&at, "open the dataset", locked(|| self.file.dataset(name)))?;
        self.refuse_foreign_or_absurd(&at, &dataset)?;
        Ok(Some(dataset))
    }

    fn refuse_foreign_or_absurd(&self, at: &str, dataset: &Dataset) -> Result<(), StoreError> {
        let plist = self.wrap(at, "read how the dataset is stored", locked(|| dataset.create_plist()))?;
        let layout = self.wrap(at, "read how the dataset is stored", locked(|| plist.get_layout()))?;
        let external = self.wrap(at, "read how the dataset is stored", locked(|| plist.get_external()))?;
        if layout == Layout::Virtual || !external.is_empty() {
            return Err(self.content(
                at,
                "a dataset whose bytes lie in other files",
                "a dataset that is stored in this file",
                "copy the data into one file",
            ));
        }
        let item = self.wrap(at, "read the number type", locked(|| dataset.dtype()))?.size() as u64;
        let shape = locked(|| dataset.shape());
        let claimed = shape.iter().try_fold(item, |bytes, &n| bytes.checked_mul(n as u64));
        let stored = locked(|| dataset.storage_size());
        let file_bytes = self.bytes;
        let possible = match layout {
            Layout::Chunked => {
                let ratio = locked(|| Pipeline::of(plist.id()))
                    .map_or(LARGEST_RATIO, |pipeline| pipeline.largest_ratio());
                // Some chunks may not have been written, so a dataset without filters may claim more than is
                // stored, too.
                let ratio = ratio.max(LARGEST_RATIO);
                stored.min(file_bytes).saturating_mul(ratio)
            }
            _ => stored.min(file_bytes),
        };
        // Of a file that is cut, the library cannot add up an index, and numbers may lie behind the end.
        let possible =
            if self.stated_bytes.is_some() { file_bytes.saturating_mul(LARGEST_RATIO) } else { possible };
        if claimed.is_none_or(|claimed| claimed > possible) {
            return Err(self.content(
                at,
                format!(
                    "a shape {shape:?} of {item}-byte numbers, but only {stored} bytes are stored (the \
                         file has {file_bytes})"
                ),
                "as many numbers as the shape says",
                "the file is cut short, or its writer stopped early: copy or record it again",
            ));
        }
        let chunk_bytes = locked(|| dataset.chunk())
            .map_or(0, |chunk| chunk.iter().fold(item, |bytes, &n| bytes.saturating_mul(n as u64)));
        if chunk_bytes > LARGEST_CHUNK {
            return Err(self.content(
                at,
                format!("chunks of {chunk_bytes} bytes"),
                "chunks of at most 1 GiB",
                "write the file again with smaller chunks",
            ));
        }
        Ok(())
    }
}

/// What to do about a file that begins as HDF5 does and still cannot be opened.
fn hint_for(detail: &str) -> &'static str {
    if detail.contains("unable to lock file") {
        "another program has the file open for writing: close it there, or wait until it has finished"
    } else {
        "the file is probably cut short or damaged: copy or record it again"
    }
}

/// How an HDF5 file begins.
struct Start {
    /// Its size.
    bytes: u64,
    /// `None` when it is of a version that we do not know, or not whole.
    superblock: Option<Superblock>,
}

/// Looks at the beginning of a file, which must be as HDF5 says.
fn refuse_what_is_not_hdf5(path: &Path) -> Result<Start, StoreError> {
    const SIGNATURE: [u8; 8] = [0x89, b'H', b'D', b'F', b'\r', b'\n', 0x1a, b'\n'];
    let io = |error| StoreError::io(path, "open the file", error);
    let mut file = std::fs::File::open(path).map_err(io)?;
    let metadata = file.metadata().map_err(io)?;
    let not = |found: String| StoreError::NotReadable {
        path: path.into(),
        found,
        hint: "give an HDF5 recording; AEDAT4 files are read by the node read/aedat4".into(),
    };
    if !metadata.is_file() {
        return Err(not("this is no regular file".into()));
    }
    // The signature stands at 0, or after a user block at 512, 1024, 2048 ...
    let mut at = 0;
    let mut first = [0; 8];
    while at + 8 <= metadata.len() {
        let mut bytes = [0; 8];
        file.seek(SeekFrom::Start(at)).and_then(|_| file.read_exact(&mut bytes)).map_err(io)?;
        if bytes == SIGNATURE {
            return Ok(Start { bytes: metadata.len(), superblock: Superblock::read(&mut file, at) });
        }
        if at == 0 {
            first = bytes;
        }
        at = if at == 0 { 512 } else { at * 2 };
    }
    Err(not(if metadata.len() == 0 {
        "the file is empty, so it is no HDF5 file".into()
    } else {
        format!(
            "the file ({} bytes, beginning with \"{}\") is no HDF5 file",
            metadata.len(),
            first.escape_ascii()
        )
    }))
}
