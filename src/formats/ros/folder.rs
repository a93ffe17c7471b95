//! Bags of ROS 2 as folders: `metadata.yaml`, and one or more files of messages, MCAP or SQLite, one after
//! another in the order of recording.
//!
//! The order is that of `metadata.yaml`; where that is missing or damaged, that of the names, numbers by
//! value. Connections of several files are kept apart and belong together by the names of their topics.

use super::contents::{Contents, Part, Piece};
use super::piece::Topic;
use super::wire::label;
use super::{mcap, scan, sqlite};
use crate::error::FormatError;
use crate::losses::Losses;
use crate::pictures::names::natural;
use serde::Deserialize;
use std::io::Read;
use std::path::Path;

/// The file that describes the others.
pub(crate) const METADATA: &str = "metadata.yaml";
/// No description of a bag is larger.
const MOST_METADATA: u64 = 4 << 20;
/// Files of a bag.
const MOST_FILES: usize = 4096;
/// The numbers of connections of a file are below this.
const IDS: u32 = 1 << 16;
/// The start of a Zstandard frame.
const ZSTD: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];

#[derive(Deserialize)]
struct Metadata {
    rosbag2_bagfile_information: Information,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Information {
    relative_file_paths: Vec<String>,
    ros_distro: Option<String>,
}

/// Does a name look like that of a file of messages, compressed or not?
pub(crate) fn is_storage(name: &str) -> bool {
    let name = name.strip_suffix(".zstd").unwrap_or(name);
    !name.starts_with('.') && (name.ends_with(".db3") || name.ends_with(".mcap"))
}

/// What a file is when a whole file was compressed: "a bag in SQLite"; `None` for any other.
pub(crate) fn packed_kind(head: &[u8]) -> Option<&'static str> {
    if !head.starts_with(ZSTD) {
        return None;
    }
    let mut decoder = zstd::stream::read::Decoder::with_buffer(head).ok()?;
    decoder.window_log_max(25).ok()?;
    let mut start = Vec::new();
    // The head ends within a frame: what comes before that decides.
    let _ = decoder.take(64).read_to_end(&mut start);
    if start.starts_with(sqlite::MAGIC) {
        Some("SQLite")
    } else {
        start.starts_with(mcap::MAGIC).then_some("MCAP")
    }
}

/// The refusal of a file that was compressed as a whole.
pub(crate) fn packed(path: &Path, what: &str) -> FormatError {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let hint = format!("decompress it with `zstd -d {name}` and name the result, or the folder of the bag");
    FormatError::new(
        path,
        format!("a file of a bag of ROS 2 ({what}) that is compressed as a whole by Zstandard"),
        hint,
    )
    .expected("the file as it was recorded")
}

/// Opens one file of messages, as what it is.
///
/// # Errors
/// When it is none.
pub(crate) fn open_file(path: &Path) -> Result<Contents, FormatError> {
    let mut head = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(4096).read_to_end(&mut head));
    read.map_err(|error| FormatError::io(path, &error))?;
    if let Some(what) = packed_kind(&head) {
        return Err(packed(path, what));
    }
    if head.starts_with(mcap::MAGIC) { mcap::open(path, scan::survey) } else { sqlite::open(path) }
}

/// Opens the files of a folder.
///
/// # Errors
/// When no file of messages is there, or none can be read.
pub(crate) fn open(path: &Path, names: &[String]) -> Result<Contents, FormatError> {
    let mut losses = Losses::default();
    let information = information(path, &mut losses);
    let mut there: Vec<&String> = names.iter().filter(|name| is_storage(name)).collect();
    there.sort_by(|a, b| natural(a, b));
    // A compressed file that was decompressed stands there twice.
    let unpacked = |name: &str| {
        name.strip_suffix(".zstd").is_some_and(|plain| there.iter().any(|other| *other == plain))
    };
    let mut chosen: Vec<String> =
        there.iter().filter(|name| !unpacked(name)).map(|name| name.to_string()).collect();
    let listed = listed(&information, &chosen, &mut losses);
    if !listed.is_empty() {
        let more = chosen.iter().filter(|name| !listed.contains(name)).count();
        if more > 0 {
            let what = format!(
                "{more} further files of messages stand in the folder and are not read: \
                                {METADATA} does not list them"
            );
            losses.add("files that do not belong to the bag", || METADATA.into(), || what);
        }
        chosen = listed;
    }
    let mut all: Option<Contents> = None;
    let mut last_error = None;
    for name in chosen.iter().take(MOST_FILES) {
        match open_file(&path.join(name)) {
            Ok(contents) => {
                all = Some(all.take().map_or_else(|| first(path, &contents), Ok)?)
                    .map(|all| join(all, contents, name))
            }
            Err(error) => {
                losses.add("files of the bag that cannot be read", || name.clone(), || error.found.clone());
                last_error = Some(error);
            }
        }
    }
    let Some(mut all) = all else {
        let missing = || {
            FormatError::new(path, "the folder has no file of messages", "copy the whole bag")
                .expected(format!("{METADATA} and .db3 or .mcap files"))
        };
        return Err(last_error.unwrap_or_else(missing));
    };
    if path.join(METADATA).is_file() {
        all.files.push(path.join(METADATA));
    }
    if let Some(distro) = information.ros_distro.filter(|distro| !distro.is_empty()) {
        all.facts.push(("ROS".into(), label(distro.as_bytes())));
    }
    if all.parts.len() > 1 {
        all.facts.push(("files".into(), format!("{}, read one after another", all.parts.len())));
    }
    losses.append(std::mem::take(&mut all.losses), |at| at);
    all.losses = losses;
    Ok(all)
}

/// What `metadata.yaml` says; nothing where it is missing or damaged.
fn information(path: &Path, losses: &mut Losses) -> Information {
    let file = path.join(METADATA);
    let small = std::fs::metadata(&file).is_ok_and(|metadata| metadata.len() <= MOST_METADATA);
    let text = std::fs::read_to_string(&file).ok().filter(|_| small);
    match text.as_deref().map(serde_saphyr::from_str::<Metadata>) {
        Some(Ok(metadata)) => metadata.rosbag2_bagfile_information,
        found => {
            let what = if found.is_some() {
                "it is no description of a bag"
            } else {
                "it is missing or cannot be read"
            };
            losses.add(
                "descriptions that cannot be read",
                || METADATA.into(),
                || format!("{what}; the files were read in the order of their names"),
            );
            Information::default()
        }
    }
}

/// The files that the description lists and that are there, each once.
fn listed(information: &Information, there: &[String], losses: &mut Losses) -> Vec<String> {
    let mut listed: Vec<String> = Vec::new();
    for entry in information.relative_file_paths.iter().take(MOST_FILES) {
        // Older bags name them with their folder.
        let name = entry.rsplit('/').next().unwrap_or_default();
        let plain = name.strip_suffix(".zstd").unwrap_or(name);
        match there
            .iter()
            .find(|other| *other == name || *other == plain || other.strip_suffix(".zstd") == Some(name))
        {
            Some(found) if !listed.contains(found) => listed.push(found.clone()),
            Some(_) => {}
            None => {
                let name = label(name.as_bytes());
                losses.add(
                    "files of the bag that are missing",
                    || name.clone(),
                    || format!("{METADATA} lists it, and it is not in the folder"),
                );
            }
        }
    }
    listed
}

/// Nothing yet, in a folder whose first file is `contents`.
fn first(path: &Path, contents: &Contents) -> Result<Contents, FormatError> {
    let container = contents.parts.first().map(|part| part.container);
    let container = container
        .ok_or_else(|| FormatError::new(path, "a file of the bag has no content", "copy the whole bag"))?;
    let mut all = Contents::new(path, 0, container);
    all.parts.clear();
    all.files.clear();
    Ok(all)
}

/// Adds a file behind others.
fn join(mut all: Contents, next: Contents, name: &str) -> Contents {
    let file = all.parts.len();
    // Below 2^16 files of 2^16 connections each.
    let first_id = file as u32 * IDS;
    for part in next.parts {
        all.parts.push(Part { first_id, before: all.size, ..part });
    }
    all.size = all.size.saturating_add(next.size);
    all.topics.extend(next.topics.into_iter().map(|topic| Topic { id: topic.id + first_id, ..topic }));
    all.pieces.extend(next.pieces.into_iter().map(|piece| {
        let counts =
            piece.counts.map(|counts| counts.into_iter().map(|(id, count)| (id + first_id, count)).collect());
        Piece { file, counts, ..piece }
    }));
    all.files.extend(next.files);
    if file == 0 {
        all.facts.extend(next.facts);
    }
    all.losses.append(next.losses, |at| format!("{name}, {at}"));
    all
}
