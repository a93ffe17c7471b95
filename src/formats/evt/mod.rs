//! Files of Prophesee cameras: RAW (EVT2, EVT2.1, EVT3) and DAT.
//!
//! A text header of `% key value` lines ([`header`](self)) and words of 16, 32 or 64 bits. The decoders stand
//! on their own: they take bytes from wherever they come and keep their state from call to call, so that
//! other containers of the same words (ROS messages) use them too.
//!
//! - [`Evt2Decoder`], [`Evt21Decoder`], [`Evt3Decoder`], [`DatDecoder`]: bytes to events and trigger edges,
//!   times in ns, wraps continued.
//! - [`evt3_writer::Writer`]: events to an EVT3 file.
//! - [`EVT2`], [`EVT21`], [`EVT3`], [`DAT`]: the entries of the catalogue.
//!
//! Limits: event frames (HISTO3D, DIFF3D), EVT4 and AER are not read. Data of inertial sensors and counters
//! are skipped.

mod clock;
mod dat;
mod decoder;
mod evt2;
mod evt3;
pub mod evt3_writer;
mod faults;
#[cfg(test)]
mod file_tests;
mod header;
mod raw;
#[cfg(test)]
mod tests;

pub use dat::{DatDecoder, DatLayout};
pub use evt2::{Evt2Decoder, Evt21Decoder};
pub use evt3::Evt3Decoder;
pub use faults::Faults;

use crate::declared::Declared;
use crate::error::FormatError;
use crate::format::{Format, Probe};
use crate::recording::Recording;
use header::{Encoding, Header};
use photocurrent_core::Extent;
use std::path::Path;

/// RAW with words of 32 bits.
pub static EVT2: Format = Format {
    id: "evt2",
    name: "Prophesee RAW, EVT2",
    recognises: |probe| is_raw(probe, Encoding::Evt2),
    open: open_raw,
};

/// RAW with words of 64 bits.
pub static EVT21: Format = Format {
    id: "evt21",
    name: "Prophesee RAW, EVT2.1",
    recognises: |probe| is_raw(probe, Encoding::Evt21),
    open: open_raw,
};

/// RAW with words of 16 bits.
pub static EVT3: Format = Format {
    id: "evt3",
    name: "Prophesee RAW, EVT3",
    recognises: |probe| is_raw(probe, Encoding::Evt3),
    open: open_raw,
};

/// Decoded events.
pub static DAT: Format = Format { id: "dat", name: "Prophesee DAT", recognises: is_dat, open: open_dat };

fn is_raw(probe: &Probe, encoding: Encoding) -> bool {
    Header::parse(&probe.head).is_some_and(|header| header.encoding() == Some(encoding))
}

fn is_dat(probe: &Probe) -> bool {
    let Some(header) = Header::parse(&probe.head) else { return false };
    let known = ["Version", "Width", "Height", "Data"].iter().any(|key| header.get(key).is_some())
        || probe.extension() == "dat";
    let after = &probe.head[header.data_at..];
    // Type and size of a record; 14 are trigger edges, which are refused with their name.
    let record = matches!(after, [0 | 12 | 14, 8, ..]) || (after.is_empty() && probe.extension() == "dat");
    known && record && header.get("evt").is_none() && header.get("format").is_none()
}

/// What is known of a file without its words: the extent, stated by the user or the file, and how it was
/// found.
fn size(header: &Header, declared: &Declared) -> (Option<Extent>, Vec<String>) {
    match (declared.extent, header.extent()) {
        (Some(extent), _) => (Some(extent), Vec::new()),
        (None, Some((extent, note))) => (Some(extent), note.into_iter().collect()),
        (None, None) => (None, Vec::new()),
    }
}

fn open_raw(path: &Path, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    let (header, bytes) = raw::read_header(path)?;
    let (extent, mut notes) = size(&header, declared);
    let about = |encoding: &str, period: &str, notes: Vec<String>| raw::About {
        encoding: encoding.into(),
        stamps: format!("microseconds, {encoding} words, continued over wraps every {period}"),
        extent,
        notes,
        is_counted: false,
    };
    match header.encoding() {
        Some(Encoding::Evt2) => Ok(raw::open(
            path,
            &header,
            bytes,
            about("EVT2", "4.77 h", notes),
            Evt2Decoder::new().with_extent(extent),
        )),
        Some(Encoding::Evt21) => {
            let legacy = header.is_legacy();
            if legacy {
                notes.push(
                    "words of EVT2.1 in the legacy order of halves, as the header states or the \
                            camera that it names writes"
                        .into(),
                );
            }
            let decoder = Evt21Decoder::new().with_extent(extent).with_legacy(legacy);
            Ok(raw::open(path, &header, bytes, about("EVT2.1", "4.77 h", notes), decoder))
        }
        Some(Encoding::Evt3) => Ok(raw::open(
            path,
            &header,
            bytes,
            about("EVT3", "16.777216 s", notes),
            Evt3Decoder::new().with_extent(extent),
        )),
        None => {
            let found = header
                .get("format")
                .or(header.get("evt"))
                .map_or("a header without `evt` and `format`".into(), |format| {
                    format!("encoding `{format}`")
                });
            let hint = "record with EVT2, EVT2.1 or EVT3, or convert the file with the maker's tools";
            Err(FormatError::new(path, found, hint).at("header").expected("EVT2, EVT2.1 or EVT3"))
        }
    }
}

fn open_dat(path: &Path, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    let (mut header, bytes) = raw::read_header(path)?;
    let record = raw::read_at(path, header.data_at as u64, 2 + raw::LOOK)?;
    match record[..] {
        [0 | 12, 8, ..] => {}
        [kind, size, ..] => {
            let at = format!("byte {}", header.data_at);
            let found = format!("records of type {kind} and {size} bytes");
            let hint = "only files of change events are read; type 14 holds trigger edges, which a RAW file \
                        has among its events";
            return Err(FormatError::new(path, found, hint).at(at).expected("type 0 or 12 and 8 bytes"));
        }
        _ => {
            return Err(FormatError::new(path, "the file ends with its header", "copy the file again")
                .at(format!("byte {bytes}")));
        }
    }
    header.data_at += 2;
    let layout = dat_layout(&header, &record[2..]);
    let (extent, mut notes) = size(&header, declared);
    if header.get("Version").is_none() {
        notes.push(format!(
            "the header states no version: layout {layout:?} follows from the bits that are used"
        ));
    }
    let about = raw::About {
        encoding: if layout == DatLayout::V1 { "DAT version 1" } else { "DAT version 2" }.into(),
        stamps: "u32 microseconds, continued over wraps every 71.6 min".into(),
        extent,
        notes,
        is_counted: true,
    };
    Ok(raw::open(path, &header, bytes, about, DatDecoder::new(layout).with_extent(extent)))
}

/// The layout that the header states; without a statement, that of version 2 if any of the first records uses
/// bits that version 1 leaves zero.
fn dat_layout(header: &Header, records: &[u8]) -> DatLayout {
    let stated =
        header.get("Version").and_then(|version| version.split('.').next()?.trim().parse::<u32>().ok());
    let is_first = match stated {
        Some(version) => version < 2,
        None => {
            records.as_chunks::<8>().0.iter().all(|record| u64::from_le_bytes(*record) >> (32 + 18) == 0)
                && records.len() >= 8
        }
    };
    if is_first { DatLayout::V1 } else { DatLayout::V2 }
}
