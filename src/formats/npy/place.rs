//! Where an array lies: a file of its own, or a member of an npz archive, stored or deflated.
//!
//! The archive's directory is read by the `zip` crate; the member's bytes are read here, straight from the
//! file, so that several members can be read side by side. The checksum that the directory states is compared
//! when a deflated or stored member has been read from its first to its last byte.

use super::header::{self, Header};
use crate::error::FormatError;
use flate2::read::DeflateDecoder;
use std::fs::File;
use std::io::{BufReader, Read, Result as IoResult, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Bytes that are read from a file at a time.
const BLOCK: usize = 1 << 16;

/// A member of an archive.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Member {
    pub(crate) name: String,
    start: u64,
    packed: u64,
    deflated: bool,
    bytes: u64,
    crc: u32,
}

/// Where an array lies.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Place {
    pub(crate) path: PathBuf,
    pub(crate) member: Option<Member>,
}

impl Place {
    /// For messages: "x.npy", "events_ts.npy".
    pub(crate) fn name(&self) -> String {
        match &self.member {
            Some(member) => member.name.clone(),
            None => self.path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
        }
    }

    /// Bytes that the array's file really has, or that the archive claims for it.
    pub(crate) fn bytes(&self) -> Result<u64, FormatError> {
        match &self.member {
            Some(member) => Ok(member.bytes),
            None => {
                Ok(std::fs::metadata(&self.path).map_err(|error| FormatError::io(&self.path, &error))?.len())
            }
        }
    }

    /// A reader that stands at a byte of the array's file.
    pub(crate) fn open(&self, at: u64) -> Result<Bytes, FormatError> {
        let io = |error: std::io::Error| FormatError::io(&self.path, &error);
        let mut file = File::open(&self.path).map_err(io)?;
        let Some(member) = &self.member else {
            file.seek(SeekFrom::Start(at)).map_err(io)?;
            return Ok(Bytes { reader: Box::new(BufReader::with_capacity(BLOCK, file)), check: None });
        };
        let packed = |file: File| BufReader::with_capacity(BLOCK, file.take(member.packed));
        if !member.deflated {
            let at = at.min(member.packed);
            file.seek(SeekFrom::Start(member.start.saturating_add(at))).map_err(io)?;
            let reader = BufReader::with_capacity(BLOCK, file.take(member.packed - at));
            return Ok(Bytes { reader: Box::new(reader), check: None });
        }
        file.seek(SeekFrom::Start(member.start)).map_err(io)?;
        let check = Some(Check { crc: flate2::Crc::new(), read: 0, want: member.crc, bytes: member.bytes });
        let mut bytes = Bytes { reader: Box::new(DeflateDecoder::new(packed(file))), check };
        // A member that ends before is found out by whoever reads on.
        let mut left = at;
        let mut scratch = [0; 4096];
        while left > 0 {
            let most = usize::try_from(left).unwrap_or(usize::MAX).min(scratch.len());
            match bytes.read(&mut scratch[..most]) {
                Ok(0) | Err(_) => break,
                Ok(read) => left -= read as u64,
            }
        }
        Ok(bytes)
    }

    /// The array's header.
    pub(crate) fn header(&self) -> Result<Header, FormatError> {
        let wrong = |what: String| {
            FormatError::new(&self.path, what, "save the array again with numpy.save or numpy.savez")
                .at(self.name())
                .expected("a numpy array of numbers")
        };
        let read = header::read(&mut self.open(0)?);
        read.map_err(|error| wrong(format!("it cannot be unpacked: {error}")))?.map_err(wrong)
    }
}

/// The bytes of an array's file.
pub(crate) struct Bytes {
    reader: Box<dyn Read + Send>,
    check: Option<Check>,
}

struct Check {
    crc: flate2::Crc,
    read: u64,
    want: u32,
    bytes: u64,
}

impl Bytes {
    /// True when all bytes have been read and their checksum is not the one that the archive states.
    pub(crate) fn is_damaged(&self) -> bool {
        self.check.as_ref().is_some_and(|check| check.read >= check.bytes && check.crc.sum() != check.want)
    }
}

impl Read for Bytes {
    fn read(&mut self, buffer: &mut [u8]) -> IoResult<usize> {
        let read = self.reader.read(buffer)?;
        if let Some(check) = &mut self.check {
            check.crc.update(&buffer[..read]);
            check.read += read as u64;
        }
        Ok(read)
    }
}

/// The arrays of an npz archive, in its order, with their names without `.npy`.
pub(crate) fn archive(path: &Path) -> Result<Vec<(String, Place)>, FormatError> {
    let file = File::open(path).map_err(|error| FormatError::io(path, &error))?;
    let bytes = file.metadata().map_err(|error| FormatError::io(path, &error))?.len();
    let damaged = |error: &dyn std::fmt::Display| {
        FormatError::new(
            path,
            format!("the archive cannot be read: {error}"),
            "a copy that broke off has no directory at its end; copy it again",
        )
        .expected("an npz file (a zip archive of numpy arrays)")
    };
    let mut archive = zip::ZipArchive::new(BufReader::new(file)).map_err(|error| damaged(&error))?;
    let mut arrays = Vec::new();
    for index in 0..archive.len().min(4096) {
        let entry = archive.by_index_raw(index).map_err(|error| damaged(&error))?;
        let Some(name) =
            entry.name().map_err(|error| damaged(&error))?.strip_suffix(".npy").map(String::from)
        else {
            continue;
        };
        let deflated = match entry.compression() {
            zip::CompressionMethod::Stored => false,
            other if other.to_string().eq_ignore_ascii_case("deflated") => true,
            other => {
                return Err(damaged(&format!("`{name}` is packed by {other}, which numpy does not use")));
            }
        };
        let start = entry.data_start().ok_or_else(|| damaged(&format!("`{name}` has no data")))?;
        // What the directory claims is no more than the file has.
        let packed = entry.compressed_size().min(bytes.saturating_sub(start));
        let member = Member {
            name: format!("{name}.npy"),
            start,
            packed,
            deflated,
            bytes: entry.size(),
            crc: entry.crc32(),
        };
        arrays.push((name, Place { path: path.into(), member: Some(member) }));
    }
    Ok(arrays)
}
