//! Archives: how to unpack them, and what they hold that would be read.

use super::Instead;
use crate::format::Probe;
use std::fs::File;
use std::io::{BufReader, Read};

/// Names of members that are listed.
const LISTED: usize = 6;
/// Ends of names that recordings and what belongs to them have.
const READ: [&str; 19] = [
    "raw", "dat", "hdf5", "h5", "aedat", "aedat4", "es", "bag", "mcap", "npz", "npy", "txt", "csv", "png",
    "tif", "tiff", "y4m", "bias", "yaml",
];

/// An archive or a compressed file, by its first bytes.
pub(super) fn archive(probe: &Probe) -> Option<Instead> {
    let head = probe.head.as_slice();
    let name = probe.path.display();
    if head.starts_with(b"PK\x03\x04") || head.starts_with(b"PK\x05\x06") {
        return Some(zip(probe));
    }
    if head.get(257..262) == Some(b"ustar") {
        return Some(Instead::new(
            format!("an archive (tar){}", first_of_tar(head)),
            format!("unpack it: `tar xf {name}`, then name what it holds"),
        ));
    }
    if head.starts_with(b"\x1f\x8b") {
        return Some(gzip(probe));
    }
    let unpacked = probe.path.with_extension("");
    let others: [(&[u8], &str, &str); 7] = [
        (b"\xfd7zXZ\0", "xz", "xz -dk"),
        (b"BZh", "bzip2", "bzip2 -dk"),
        (b"\x28\xb5\x2f\xfd", "Zstandard", "zstd -d"),
        (b"\x04\x22\x4d\x18", "LZ4", "lz4 -d"),
        (b"7z\xbc\xaf\x27\x1c", "7z", "7z x"),
        (b"Rar!\x1a\x07", "RAR", "unrar x"),
        (b"\x1f\x9d", "compress", "gunzip -k"),
    ];
    let (_, kind, command) = others.into_iter().find(|(magic, ..)| head.starts_with(magic))?;
    if probe.extension() == "tar" || unpacked.extension().is_some_and(|extension| extension == "tar") {
        return Some(Instead::new(
            format!("an archive (tar, packed by {kind})"),
            format!("unpack it: `tar xf {name}`, then name what it holds"),
        ));
    }
    let what = if matches!(kind, "7z" | "RAR") {
        format!("an archive ({kind})")
    } else {
        format!("a file packed by {kind}")
    };
    Some(Instead::new(what, format!("unpack it: `{command} {name}`, then name what comes out")))
}

/// A zip archive: its members, those first that would be read.
fn zip(probe: &Probe) -> Instead {
    let name = probe.path.display();
    let Some(members) = members(probe) else {
        return Instead::new(
            "an archive (zip) without its directory, which stands at the end: the download broke off",
            "fetch it again, and compare its size with the source's",
        );
    };
    if members.iter().any(|member| member.ends_with("data.pkl")) {
        return Instead::new(
            "a file of PyTorch, which holds pickled Python objects",
            "load it with torch and save events for numpy: `numpy.savez(\"events.npz\", t=t, x=x, y=y, p=p)`",
        );
    }
    let end =
        |member: &String| member.rsplit_once('.').map(|(_, end)| end.to_lowercase()).unwrap_or_default();
    let read: Vec<&String> = members.iter().filter(|member| READ.contains(&end(member).as_str())).collect();
    let holds = match (members.is_empty(), read.is_empty()) {
        (true, _) => "it is empty".to_string(),
        (false, true) => format!(
            "it holds {}, none of which looks like a recording",
            list(&members.iter().collect::<Vec<_>>())
        ),
        (false, false) => format!("it holds {}", list(&read)),
    };
    Instead::new(
        format!("an archive (zip); {holds}"),
        format!("unpack it: `unzip {name}`, then name the recording that it holds"),
    )
}

/// Names of files in a zip archive, 4096 at most; `None` without a directory.
fn members(probe: &Probe) -> Option<Vec<String>> {
    let mut archive = ::zip::ZipArchive::new(BufReader::new(File::open(&probe.path).ok()?)).ok()?;
    let mut names = Vec::new();
    for index in 0..archive.len().min(4096) {
        let Ok(entry) = archive.by_index_raw(index) else { continue };
        let Ok(name) = entry.name().map(|name| name.to_string()) else { continue };
        if !name.ends_with('/') && !name.starts_with("__MACOSX") {
            names.push(name);
        }
    }
    Some(names)
}

fn list(names: &[&String]) -> String {
    let shown =
        names.iter().take(LISTED).map(|name| name.escape_debug().to_string()).collect::<Vec<_>>().join(", ");
    if names.len() > LISTED { format!("{shown} and {} more", names.len() - LISTED) } else { shown }
}

/// A gzip file: the name that it states, and what its first bytes are.
fn gzip(probe: &Probe) -> Instead {
    let path = probe.path.display();
    let mut head = Vec::new();
    let unpacked = File::open(&probe.path)
        .map(|file| flate2::read::GzDecoder::new(BufReader::new(file)).take(4096).read_to_end(&mut head));
    if matches!(unpacked, Ok(Ok(_))) && head.get(257..262) == Some(b"ustar") {
        return Instead::new(
            format!("an archive (tar, packed by gzip){}", first_of_tar(&head)),
            format!("unpack it: `tar xzf {path}`, then name what it holds"),
        );
    }
    let stem = probe.path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let inner = Probe { path: probe.path.with_extension(""), bytes: head.len() as u64, head, names: None };
    // Signatures need no more than the beginning; a text is recognised by it too.
    let format = crate::FORMATS
        .iter()
        .take_while(|format| format.id != "recording")
        .chain(crate::FORMATS.last())
        .find(|format| (format.recognises)(&inner));
    let holds = format.map_or_else(|| stem.clone(), |format| format!("{stem}, {}", format.name));
    Instead::new(
        format!("a file packed by gzip; it holds {holds}"),
        format!("unpack it: `gunzip -k {path}`, then name {stem}"),
    )
}

/// The first name of a tar archive.
fn first_of_tar(head: &[u8]) -> String {
    let name: String =
        head.iter().take(100).take_while(|byte| **byte != 0).map(|byte| *byte as char).collect();
    if name.is_empty() { String::new() } else { format!("; its first entry is {}", name.escape_debug()) }
}
