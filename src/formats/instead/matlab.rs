//! Files of MATLAB: which variables they hold, and how to save these for others.
//!
//! Version 5 (also 6 and 7): a head of 128 bytes, then elements of a tag and content; a variable is an
//! element of type 14, packed by zlib in one of type 15. Version 7.3 is HDF5 behind a head of 512 bytes.
//! Source: MAT-File Format, The MathWorks. Limits: names and sizes are read, values are not.

use super::{Instead, inside};
use crate::format::Probe;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};

/// Variables that are listed.
const LISTED: usize = 12;
/// Bytes of a variable that hold its class, its size and its name.
const HEAD: u64 = 512;

/// A MATLAB file, by the text that it begins with.
pub(super) fn matlab(probe: &Probe) -> Option<Instead> {
    let (version, variables) = if probe.head.starts_with(b"MATLAB 5.0 MAT-file") {
        ("version 5 to 7", variables(probe))
    } else if probe.head.starts_with(b"MATLAB 7.3 MAT-file") {
        ("version 7.3, which is HDF5", inside::datasets(&probe.path))
    } else {
        return None;
    };
    let holds = match variables.len() {
        0 => "no variable of it can be listed".to_string(),
        n if n > LISTED => format!("it holds {} and {} more", variables[..LISTED].join(", "), n - LISTED),
        _ => format!("it holds {}", variables.join(", ")),
    };
    let todo = "save it as text from MATLAB, `writematrix([t(:) x(:) y(:) p(:)], \"events.csv\")`, or as npz \
                from Python: `m = scipy.io.loadmat(...)` (h5py for version 7.3), \
                `numpy.savez(\"events.npz\", t=..., x=..., y=..., p=...)`; coordinates of MATLAB often \
                               begin at 1: state `origin = 1` then";
    Some(Instead::new(format!("a file of MATLAB ({version}); {holds}"), todo))
}

/// "events 18436 x 4 double".
fn variables(probe: &Probe) -> Vec<String> {
    let mut found = Vec::new();
    let Ok(file) = File::open(&probe.path) else { return found };
    let mut file = BufReader::new(file);
    let big = probe.head.get(126..128) == Some(b"MI");
    let mut at = 128;
    while found.len() < 64 && file.seek(SeekFrom::Start(at)).is_ok() {
        let mut tag = [0; 8];
        if file.read_exact(&mut tag).is_err() {
            break;
        }
        let (kind, size) = (number(&tag, 0, big), u64::from(number(&tag, 4, big)));
        let mut head = Vec::new();
        let read = match kind {
            15 => flate2::read::ZlibDecoder::new(file.by_ref().take(size))
                .take(HEAD)
                .read_to_end(&mut head)
                .map(|_| head.get(8..).unwrap_or_default().to_vec()),
            14 => file.by_ref().take(size.min(HEAD)).read_to_end(&mut head).map(|_| head.clone()),
            _ => break,
        };
        // A damaged variable is no reason to leave out the others.
        found.extend(read.ok().and_then(|head| variable(&head, big)));
        at = at.saturating_add(8).saturating_add(size);
    }
    found
}

fn number(bytes: &[u8], at: usize, big: bool) -> u32 {
    let four = bytes.get(at..at + 4).and_then(|bytes| <[u8; 4]>::try_from(bytes).ok()).unwrap_or_default();
    if big { u32::from_be_bytes(four) } else { u32::from_le_bytes(four) }
}

/// The content of an element within a variable, and where the next begins. Short content stands within the
/// tag.
fn element(bytes: &[u8], at: usize, big: bool) -> Option<(&[u8], usize)> {
    let tag = number(bytes, at, big);
    if tag >> 16 != 0 {
        let size = (tag >> 16) as usize;
        return Some((bytes.get(at + 4..at + 4 + size.min(4))?, at + 8));
    }
    let size = number(bytes, at + 4, big) as usize;
    let content = bytes.get(at + 8..(at + 8).checked_add(size)?)?;
    Some((content, at + 8 + size.next_multiple_of(8)))
}

/// Name, size and class of a variable from its beginning.
fn variable(bytes: &[u8], big: bool) -> Option<String> {
    let (flags, next) = element(bytes, 0, big)?;
    let class = match number(flags, 0, big) & 0xff {
        1 => "cell",
        2 => "struct",
        3 => "object",
        4 => "char",
        5 => "sparse",
        6 => "double",
        7 => "single",
        8 => "int8",
        9 => "uint8",
        10 => "int16",
        11 => "uint16",
        12 => "int32",
        13 => "uint32",
        14 => "int64",
        15 => "uint64",
        _ => "of an unknown class",
    };
    let (sides, next) = element(bytes, next, big)?;
    let sides: Vec<String> =
        (0..sides.len() / 4).map(|side| number(sides, 4 * side, big).to_string()).collect();
    let (name, _) = element(bytes, next, big)?;
    let name = String::from_utf8_lossy(name);
    (!name.is_empty()).then(|| format!("{} {} {class}", name.escape_debug(), sides.join(" x ")))
}
