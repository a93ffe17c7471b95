//! Files that end before the end that their superblock states: opened as far as they go.
//!
//! The library refuses such a file. Asked to skip its check, it reads zeros behind the end and takes them for
//! numbers. So the file is mapped, the mapping gets a superblock that states the true end, and the library
//! reads the mapping (its `core` driver): what lies behind the end is then refused piece by piece, a chunk, a
//! node of an index, an object header at a time. Nothing is copied; the file itself is not changed.

use crate::error::StoreError;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// Where a superblock stands in a file and what it says of the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Superblock {
    at: u64,
    version: u8,
    /// Where the end of the file is stated, bytes from the start of the superblock.
    end_at: usize,
    /// Bytes of an address.
    width: usize,
    /// The end of the file in bytes, as it is stated.
    pub end: u64,
}

/// A superblock with the addresses of version 1 and 8-byte addresses takes 100 bytes.
const LONGEST: usize = 256;

impl Superblock {
    /// Of a file whose signature stands at a place; `None` when there is no whole superblock of a known
    /// version.
    pub(super) fn read(file: &mut File, at: u64) -> Option<Superblock> {
        let mut bytes = Vec::new();
        file.seek(SeekFrom::Start(at)).ok()?;
        file.take(LONGEST as u64).read_to_end(&mut bytes).ok()?;
        Superblock::of(&bytes, at)
    }

    fn of(bytes: &[u8], at: u64) -> Option<Superblock> {
        let version = *bytes.get(8)?;
        // Before the end of the file stand the addresses of the base, and of free space or of an extension.
        let (width, addresses) = match version {
            0 => (*bytes.get(13)?, 24),
            1 => (*bytes.get(13)?, 28),
            2 | 3 => (*bytes.get(9)?, 12),
            _ => return None,
        };
        let width = usize::from(width);
        if !matches!(width, 2 | 4 | 8) {
            return None;
        }
        let end_at = addresses + 2 * width;
        let mut end = [0; 8];
        end[..width].copy_from_slice(bytes.get(end_at..end_at + width)?);
        Some(Superblock { at, version, end_at, width, end: u64::from_le_bytes(end) })
    }

    /// States another end, in the bytes of a file.
    fn state(&self, end: u64, file: &mut [u8]) -> Option<()> {
        let bytes = file.get_mut(usize::try_from(self.at).ok()?..)?;
        bytes
            .get_mut(self.end_at..self.end_at + self.width)?
            .copy_from_slice(&end.to_le_bytes()[..self.width]);
        if self.version >= 2 {
            // A file whose writer was ended says that it is still being written: nobody does any more.
            *bytes.get_mut(11)? = 0;
            let sum_at = self.end_at + 2 * self.width;
            let sum = lookup3(bytes.get(..sum_at)?);
            bytes.get_mut(sum_at..sum_at + 4)?.copy_from_slice(&sum.to_le_bytes());
        } else {
            // Behind the end stand two more addresses and the root's entry: without it the library would read
            // zeros.
            bytes.get(self.end_at + 4 * self.width + 23)?;
        }
        Some(())
    }
}

/// Bob Jenkins' lookup3 (`hashlittle` with 0), the checksum of HDF5's metadata.
fn lookup3(bytes: &[u8]) -> u32 {
    let word = |block: &[u8], at: usize| {
        (0..4).fold(0u32, |word, k| word | u32::from(block.get(4 * at + k).copied().unwrap_or(0)) << (8 * k))
    };
    let start = 0xdead_beefu32.wrapping_add(bytes.len() as u32);
    let (mut a, mut b, mut c) = (start, start, start);
    let mut rest = bytes;
    while rest.len() > 12 {
        (a, b, c) =
            (a.wrapping_add(word(rest, 0)), b.wrapping_add(word(rest, 1)), c.wrapping_add(word(rest, 2)));
        a = a.wrapping_sub(c) ^ c.rotate_left(4);
        c = c.wrapping_add(b);
        b = b.wrapping_sub(a) ^ a.rotate_left(6);
        a = a.wrapping_add(c);
        c = c.wrapping_sub(b) ^ b.rotate_left(8);
        b = b.wrapping_add(a);
        a = a.wrapping_sub(c) ^ c.rotate_left(16);
        c = c.wrapping_add(b);
        b = b.wrapping_sub(a) ^ a.rotate_left(19);
        a = a.wrapping_add(c);
        c = c.wrapping_sub(b) ^ b.rotate_left(4);
        b = b.wrapping_add(a);
        rest = &rest[12..];
    }
    if rest.is_empty() {
        return c;
    }
    (a, b, c) = (a.wrapping_add(word(rest, 0)), b.wrapping_add(word(rest, 1)), c.wrapping_add(word(rest, 2)));
    c = (c ^ b).wrapping_sub(b.rotate_left(14));
    a = (a ^ c).wrapping_sub(c.rotate_left(11));
    b = (b ^ a).wrapping_sub(a.rotate_left(25));
    c = (c ^ b).wrapping_sub(b.rotate_left(16));
    a = (a ^ c).wrapping_sub(c.rotate_left(4));
    b = (b ^ a).wrapping_sub(a.rotate_left(14));
    (c ^ b).wrapping_sub(b.rotate_left(24))
}

/// Opens a file of `bytes` bytes as if it were meant to end there.
#[cfg(unix)]
pub(super) fn open(path: &Path, superblock: Superblock, bytes: u64) -> Result<hdf5::File, StoreError> {
    mapped::open(path, superblock, bytes)
}

#[cfg(not(unix))]
pub(super) fn open(path: &Path, superblock: Superblock, bytes: u64) -> Result<hdf5::File, StoreError> {
    Err(refusal(path, superblock, bytes, "files that are cut are read in part on Unix only"))
}

/// The whole file is refused.
fn refusal(path: &Path, superblock: Superblock, bytes: u64, why: &str) -> StoreError {
    StoreError::NotReadable {
        path: path.into(),
        found: format!("the file is cut at byte {bytes} of {}, and {why}", superblock.end),
        hint: "copy or record it again".into(),
    }
}

#[cfg(unix)]
mod mapped {
    use super::*;
    use crate::hdf::library::{locked, short};
    use hdf5_sys::h5::herr_t;
    use hdf5_sys::h5fd::{H5FD_file_image_callbacks_t, H5FD_file_image_op_t};
    use hdf5_sys::{h5f, h5p};
    use std::collections::HashMap;
    use std::ffi::{CString, c_void};
    use std::os::fd::AsRawFd;
    use std::sync::atomic::{AtomicPtr, Ordering};
    use std::sync::{LazyLock, Mutex, PoisonError};

    /// The mapping that is being opened. Set and used under the library's lock.
    static OPENING: AtomicPtr<c_void> = AtomicPtr::new(std::ptr::null_mut());
    /// Lengths of the mappings of open files. Used under the library's lock.
    static LENGTHS: LazyLock<Mutex<HashMap<usize, usize>>> = LazyLock::new(Mutex::default);

    fn unmap(mapping: *mut c_void) {
        let length = LENGTHS.lock().unwrap_or_else(PoisonError::into_inner).remove(&(mapping as usize));
        if let Some(length) = length {
            // SAFETY: mapped by `open` with this length, and nobody else knows of it any more.
            unsafe { libc::munmap(mapping, length) };
        }
    }

    // The library asks for memory of an image whenever it would copy it: all copies are the one mapping,
    // which the closing file gives back.
    extern "C" fn give(_: usize, _: H5FD_file_image_op_t, _: *mut c_void) -> *mut c_void {
        OPENING.load(Ordering::Relaxed)
    }
    extern "C" fn copy(
        to: *mut c_void,
        _: *const c_void,
        _: usize,
        _: H5FD_file_image_op_t,
        _: *mut c_void,
    ) -> *mut c_void {
        to
    }
    extern "C" fn grow(_: *mut c_void, _: usize, _: H5FD_file_image_op_t, _: *mut c_void) -> *mut c_void {
        std::ptr::null_mut()
    }
    extern "C" fn free(image: *mut c_void, why: H5FD_file_image_op_t, _: *mut c_void) -> herr_t {
        if why == H5FD_file_image_op_t::H5FD_FILE_IMAGE_OP_FILE_CLOSE {
            unmap(image);
        }
        0
    }

    pub(super) fn open(path: &Path, superblock: Superblock, bytes: u64) -> Result<hdf5::File, StoreError> {
        let refused = |why: &str| refusal(path, superblock, bytes, why);
        let file = File::open(path).map_err(|error| StoreError::io(path, "open the file", error))?;
        let length = usize::try_from(bytes).map_err(|_| refused("it is too large for this system"))?;
        locked(|| {
            // SAFETY: a private mapping of an open file; writing to it changes this process's copy of a page
            // only.
            let mapping = unsafe {
                let (access, kind) =
                    (libc::PROT_READ | libc::PROT_WRITE, libc::MAP_PRIVATE | libc::MAP_NORESERVE);
                libc::mmap(std::ptr::null_mut(), length, access, kind, file.as_raw_fd(), 0)
            };
            if mapping == libc::MAP_FAILED {
                return Err(StoreError::io(path, "map the file", std::io::Error::last_os_error()));
            }
            LENGTHS.lock().unwrap_or_else(PoisonError::into_inner).insert(mapping as usize, length);
            // SAFETY: the mapping has this length, and nothing else refers to it yet.
            let image = unsafe { std::slice::from_raw_parts_mut(mapping.cast::<u8>(), length) };
            if superblock.state(bytes, image).is_none() {
                unmap(mapping);
                return Err(refused("not even its superblock is whole"));
            }
            // The library takes files of one name for the same file, and a name that stands in a folder for a
            // mistake.
            let name = CString::new(format!("/dev/null/{mapping:p}")).unwrap_or_default();
            OPENING.store(mapping, Ordering::Relaxed);
            // SAFETY: property list and callbacks are valid for these calls, under the library's lock; the
            // image lives until the file closes.
            let opened = unsafe {
                let properties = h5p::H5Pcreate(*hdf5::globals::H5P_FILE_ACCESS);
                let mut callbacks = H5FD_file_image_callbacks_t {
                    image_malloc: Some(give),
                    image_memcpy: Some(copy),
                    image_realloc: Some(grow),
                    image_free: Some(free),
                    ..Default::default()
                };
                let set = h5p::H5Pset_fapl_core(properties, 1 << 16, 0) >= 0
                    && h5p::H5Pset_file_image_callbacks(properties, &mut callbacks) >= 0
                    && h5p::H5Pset_file_image(properties, mapping, length) >= 0;
                let id = if set { h5f::H5Fopen(name.as_ptr(), h5f::H5F_ACC_RDONLY, properties) } else { -1 };
                let opened = if id < 0 {
                    Err(hdf5::Error::query().unwrap_or_else(|error| error))
                } else {
                    hdf5::from_id::<hdf5::File>(id)
                };
                h5p::H5Pclose(properties);
                opened
            };
            OPENING.store(std::ptr::null_mut(), Ordering::Relaxed);
            opened.map_err(|error| {
                unmap(mapping);
                refused(&format!("its directory lies behind the cut ({})", short(&error)))
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values from the comments of Bob Jenkins' own program.
    #[test]
    fn the_checksum_is_that_of_its_author() {
        assert_eq!(lookup3(b""), 0xdead_beef);
        assert_eq!(lookup3(b"Four score and seven years ago"), 0x1777_0551);
    }
}
