//! Row bands of results that are not complete yet: what a stopped run goes on from, and what a run of some
//! rows leaves for others to join.
//!
//! ```text
//! <identity>-<first row>-<end row>.toml        rows, notes, and length and BLAKE3 of every file below
//! <identity>-<first row>-<end row>-<port>.h5   those rows as a value by itself, not packed
//! ```
//!
//! The identity says what the result is a function of, so bands of one identity belong together whoever made
//! them. The TOML file is written last: a band without one is not there. Any number of processes may add to
//! one folder; the last one to write a band wins, and its bytes say the same.

use super::files::{hash_file, names_in, remove, rename, sync};
use crate::error::StoreError;
use crate::layout::{ValueWriter, open_stored};
use photocurrent_core::{Digest, Meta, Rows, Value};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// A folder of bands.
pub struct BandStore {
    folder: PathBuf,
    next: AtomicU64,
}

/// A band that is kept.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeptBand {
    /// What the result is a function of.
    pub identity: Digest,
    /// First row.
    pub start: u32,
    /// One after the last row.
    pub end: u32,
    /// What the node had to say of these rows.
    #[serde(default)]
    pub texts: Vec<String>,
    /// What the node counted in these rows.
    #[serde(default)]
    pub counts: BTreeMap<String, u64>,
    /// By port.
    #[serde(default)]
    pub outputs: BTreeMap<String, KeptFile>,
}

/// A file of a band.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeptFile {
    /// Length.
    pub bytes: u64,
    /// Of its bytes.
    pub blake3: Digest,
}

impl KeptBand {
    /// Its rows.
    pub fn rows(&self) -> Rows {
        Rows { start: self.start, end: self.end }
    }

    fn stem(&self) -> String {
        format!("{}-{}-{}", self.identity, self.start, self.end)
    }
}

impl BandStore {
    /// Opens a folder, making it when needed.
    ///
    /// # Errors
    /// When the folder cannot be made.
    pub fn open(folder: &Path) -> Result<BandStore, StoreError> {
        std::fs::create_dir_all(folder).map_err(|error| StoreError::io(folder, "make the folder", error))?;
        Ok(BandStore { folder: folder.into(), next: AtomicU64::new(0) })
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Every band whose files are there in full length, by first row. One that cannot be read counts as
    /// missing: it is computed again.
    ///
    /// # Errors
    /// When the folder cannot be listed.
    pub fn list(&self) -> Result<Vec<KeptBand>, StoreError> {
        let names = names_in(&self.folder)?;
        let read = |name: &String| -> Option<KeptBand> {
            let band: KeptBand =
                toml::from_str(&std::fs::read_to_string(self.folder.join(name)).ok()?).ok()?;
            let whole = band.outputs.iter().all(|(port, file)| {
                std::fs::metadata(self.file(&band, port)).is_ok_and(|found| found.len() == file.bytes)
            });
            (whole && band.start < band.end && *name == format!("{}.toml", band.stem())).then_some(band)
        };
        let mut bands: Vec<KeptBand> =
            names.iter().filter(|name| name.ends_with(".toml")).filter_map(read).collect();
        bands.sort_by_key(|band| (band.identity, band.start, band.end));
        Ok(bands)
    }

    /// Keeps a band: values of the same rows by port, and what the node said of them.
    ///
    /// # Errors
    /// When a value cannot be read or a file cannot be written.
    pub fn put(
        &self,
        identity: Digest,
        rows: Rows,
        outputs: &[(&'static str, Value)],
        (texts, counts): (Vec<String>, BTreeMap<String, u64>),
    ) -> Result<KeptBand, StoreError> {
        let mut band =
            KeptBand { identity, start: rows.start, end: rows.end, texts, counts, outputs: BTreeMap::new() };
        for (port, value) in outputs {
            let temporary = Temporary(self.temporary());
            let bytes = ValueWriter::keep(&temporary.0, value)?;
            sync(&temporary.0)?;
            let blake3 = hash_file(&temporary.0)?;
            rename(&temporary.0, &self.file(&band, port))?;
            band.outputs.insert((*port).into(), KeptFile { bytes, blake3 });
        }
        let path = self.folder.join(format!("{}.toml", band.stem()));
        let text = toml::to_string(&band)
            .map_err(|error| StoreError::Misuse { path: path.clone(), what: error.to_string() })?;
        let temporary = Temporary(self.temporary());
        let written = std::fs::File::create(&temporary.0)
            .and_then(|mut file| file.write_all(text.as_bytes()).and_then(|_| file.sync_all()));
        written.map_err(|error| StoreError::io(&temporary.0, "write a file", error))?;
        rename(&temporary.0, &path)?;
        Ok(band)
    }

    /// Opens an output of a band, as those rows of what `whole` says; compares the file's bytes with their
    /// checksum.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] when the file is not as it was written or is no part of `whole`: compute the
    /// band again.
    pub fn load(&self, band: &KeptBand, port: &str, whole: &Meta) -> Result<Value, StoreError> {
        let path = self.file(band, port);
        let damaged = |why: &str| StoreError::Damaged { path: path.clone(), why: why.into() };
        let file = band.outputs.get(port).ok_or_else(|| damaged("the band has no such output"))?;
        if hash_file(&path)? != file.blake3 {
            return Err(damaged("its bytes are not those that were written"));
        }
        let value =
            open_stored(&path)?.placed(whole, band.start).filter(|value| value.rows() == Some(band.rows()));
        value.ok_or_else(|| damaged("it is no part of what the plan says"))
    }

    /// Removes the bands of an identity, and what was being written for it.
    ///
    /// # Errors
    /// When the folder cannot be listed or a file cannot be removed.
    pub fn remove(&self, identity: &Digest) -> Result<(), StoreError> {
        let of = format!("{identity}-");
        let names = names_in(&self.folder)?;
        // The promise goes before what it promises.
        let (promises, files): (Vec<&String>, Vec<&String>) =
            names.iter().filter(|name| name.starts_with(&of)).partition(|name| name.ends_with(".toml"));
        promises.into_iter().chain(files).try_for_each(|name| remove(&self.folder.join(name)))
    }

    fn file(&self, band: &KeptBand, port: &str) -> PathBuf {
        self.folder.join(format!("{}-{port}.h5", band.stem()))
    }

    fn temporary(&self) -> PathBuf {
        use std::hash::{BuildHasher, Hasher, RandomState};
        // Not a process number: machines that share a folder do not share them.
        let random = RandomState::new().build_hasher().finish();
        self.folder.join(format!("{random:016x}-{}.part", self.next.fetch_add(1, Ordering::Relaxed)))
    }
}

/// A file that goes away unless it is moved first.
pub(super) struct Temporary(pub(super) PathBuf);

impl Drop for Temporary {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::map::MapBand;
    use photocurrent_core::{Extent, MapMeta, MapSet};
    use std::sync::Arc;

    #[test]
    fn a_band_comes_back_to_its_rows_and_a_damaged_one_is_known() {
        let folder = tempfile::tempdir().unwrap();
        let store = BandStore::open(folder.path()).unwrap();
        let meta = MapMeta { extent: Extent { width: 3, height: 9 }, planes: vec!["a".into()] };
        let rows = Rows { start: 4, end: 6 };
        let band = MapBand::from_values(rows, &meta, (0..6).map(|i| i as f32).collect()).unwrap();
        let value = Value::Map(MapSet::in_memory(Arc::new(meta.clone()), band.clone()));
        let identity = photocurrent_core::digest::DigestBuilder::new("test").finish();
        let said = (vec!["a text".to_string()], BTreeMap::from([("pixels".to_string(), 7)]));
        let kept = store.put(identity, rows, &[("plane", value)], said).unwrap();
        assert_eq!(store.list().unwrap(), std::slice::from_ref(&kept));
        let whole = Meta::Map(Arc::new(meta));
        let Value::Map(map) = store.load(&kept, "plane", &whole).unwrap() else {
            panic!("a map stays a map")
        };
        assert_eq!((map.rows(), map.read(rows).unwrap()), (rows, band));
        // A file that lost its end is no band any more; one with another byte is found when it is read.
        let file = folder.path().join(format!("{}-plane.h5", kept.stem()));
        let mut bytes = std::fs::read(&file).unwrap();
        let last = bytes.len() - 1;
        bytes[last / 2] ^= 1;
        std::fs::write(&file, &bytes).unwrap();
        assert!(store.load(&kept, "plane", &whole).err().unwrap().is_damage());
        std::fs::write(&file, &bytes[..last]).unwrap();
        assert!(store.list().unwrap().is_empty());
        store.remove(&identity).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
