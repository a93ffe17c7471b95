//! Small memories: digests of outside files, and which key a node had last time.

use super::files::{Identity, hash_file, names_in};
use super::folder::Cache;
use crate::error::StoreError;
use photocurrent_core::Digest;
use photocurrent_core::digest::DigestBuilder;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// A file that was changed less than this before it was hashed may change again within one tick of the file
/// system's clock.
const SETTLED_NS: i64 = 2_000_000_000;

#[derive(Serialize, Deserialize)]
struct RememberedFile {
    path: String,
    digest: Digest,
    identity: Identity,
}

#[derive(Serialize, Deserialize)]
struct RememberedKey {
    manifest: String,
    variant: String,
    node: String,
    key: Digest,
}

impl Cache {
    /// BLAKE3 of a whole file. Remembered by canonical path, size, inode and times, so that a large recording
    /// is read once; a file that changed within the last two seconds is not remembered yet.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn file_digest(&self, path: &Path) -> Result<Digest, StoreError> {
        let io = |error| StoreError::io(path, "read the file", error);
        let canonical = path.canonicalize().map_err(io)?;
        let name = DigestBuilder::new("photocurrent-file/1")
            .slice(canonical.as_os_str().as_encoded_bytes())
            .finish();
        let memory = self.root.join("files").join(format!("{name}.toml"));
        let before = Identity::of(&canonical).map_err(io)?;
        if let Some(remembered) = read::<RememberedFile>(&memory)
            && remembered.identity == before
        {
            return Ok(remembered.digest);
        }
        let digest = hash_file(&canonical)?;
        let now_ns = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as i64);
        let settled = before.mtime_ns.max(before.ctime_ns) < now_ns - SETTLED_NS;
        if settled && Identity::of(&canonical).map_err(io)? == before {
            let remembered =
                RememberedFile { path: canonical.to_string_lossy().into(), digest, identity: before };
            self.write_toml(&memory, &remembered)?;
        }
        Ok(digest)
    }

    /// Remembers which key a node had in this run, for `explain` after the next.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn remember(
        &self,
        manifest: &str,
        variant: &str,
        node: &str,
        key: &Digest,
    ) -> Result<(), StoreError> {
        let memory = RememberedKey {
            manifest: manifest.into(),
            variant: variant.into(),
            node: node.into(),
            key: *key,
        };
        self.write_toml(&self.history_path(manifest, variant, node), &memory)
    }

    /// The key that a node had in the last run; `None` when there was none, or its memory is damaged.
    pub fn recall(&self, manifest: &str, variant: &str, node: &str) -> Option<Digest> {
        read::<RememberedKey>(&self.history_path(manifest, variant, node)).map(|memory| memory.key)
    }

    fn history_path(&self, manifest: &str, variant: &str, node: &str) -> std::path::PathBuf {
        let name =
            DigestBuilder::new("photocurrent-history/1").text(manifest).text(variant).text(node).finish();
        self.root.join("history").join(format!("{name}.toml"))
    }

    fn write_toml(&self, path: &Path, content: &impl Serialize) -> Result<(), StoreError> {
        let text = toml::to_string(content)
            .map_err(|error| StoreError::Misuse { path: path.into(), what: error.to_string() })?;
        self.owner.write(path, text.as_bytes())
    }
}

/// Memories of outside files that are gone, or are others by now, and those that cannot be read.
pub(super) fn useless(root: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let files = root.join("files");
    let is_the_same = |memory: RememberedFile| {
        Identity::of(Path::new(&memory.path)).is_ok_and(|identity| identity == memory.identity)
    };
    let of_file = names_in(&files)?.into_iter().map(|name| files.join(name));
    Ok(of_file.filter(|path| !read::<RememberedFile>(path).is_some_and(is_the_same)).collect())
}

/// A memory is a convenience: one that cannot be read is none.
fn read<T: serde::de::DeserializeOwned>(path: &Path) -> Option<T> {
    toml::from_str(&std::fs::read_to_string(path).ok()?).ok()
}
