//! What lies in an HDF5 file of no known layout, and in a folder that is no recording.

use super::Instead;
use crate::catalog::recognise;
use photocurrent_store::foreign::ForeignFile;
use std::path::Path;

/// Datasets and names that are listed.
const LISTED: usize = 12;
/// Groups that are looked into, and how deep.
const MOST_GROUPS: usize = 64;
const DEEPEST: usize = 4;

/// An HDF5 file of another layout: what is in it, and which layout it could become. `None` when it cannot be
/// opened.
pub(super) fn hdf5(path: &Path) -> Option<Instead> {
    let file = ForeignFile::open(path).ok()?;
    let all = walk(&file);
    let shown =
        all.iter().take(LISTED).map(|(name, shape)| format!("/{name}{shape}")).collect::<Vec<_>>().join(", ");
    let more = if all.len() > LISTED { format!(" and {} more", all.len() - LISTED) } else { String::new() };
    let holds =
        if all.is_empty() { "it holds no dataset".to_string() } else { format!("it holds {shown}{more}") };
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let group = columns(&all);
    let todo = match group {
        Some((group, [t, x, y, p])) => {
            let from = if group.is_empty() { String::new() } else { format!("{group}/") };
            format!(
                "the layout of DSEC would be read, /events/t (in microseconds), /events/x, /events/y, \
                 /events/p: `python3 -c \"import h5py; f = h5py.File('{name}', 'r+'); \
                 [f.move('{from}' + a, 'events/' + b) for a, b in [('{t}', 't'), ('{x}', 'x'), ('{y}', 'y'), \
                 ('{p}', 'p')]]\"`"
            )
        }
        None => "the layouts that are read are in docs/recordings.md; the simplest is DSEC's: /events/t (in \
                 microseconds), /events/x, /events/y, /events/p"
            .to_string(),
    };
    Some(Instead::new(format!("an HDF5 file of a layout that is not known here; {holds}"), todo))
}

/// The group whose datasets are the four columns of events, and what they are called.
pub(super) fn columns(all: &[(String, String)]) -> Option<(String, [String; 4])> {
    const NAMES: [&[&str]; 4] = [
        &["t", "ts", "time", "times", "timestamp", "timestamps"],
        &["x", "xs"],
        &["y", "ys"],
        &["p", "ps", "pol", "polarity", "polarities"],
    ];
    let split = |name: &str| {
        name.rsplit_once('/')
            .map_or((String::new(), name.to_string()), |(group, name)| (group.to_string(), name.to_string()))
    };
    let parts: Vec<(String, String)> = all.iter().map(|(name, _)| split(name)).collect();
    parts.iter().map(|(group, _)| group).find_map(|group| {
        let find = |names: &&[&str]| {
            parts
                .iter()
                .find(|(g, name)| g == group && names.contains(&name.to_lowercase().as_str()))
                .map(|(_, name)| name.clone())
        };
        let found: Vec<String> = NAMES.iter().filter_map(find).collect();
        <[String; 4]>::try_from(found).ok().map(|names| (group.clone(), names))
    })
}

/// Names and sizes of the datasets of an HDF5 file, as MATLAB's variables; none when it cannot be opened.
pub(super) fn datasets(path: &Path) -> Vec<String> {
    let Ok(file) = ForeignFile::open(path) else { return Vec::new() };
    walk(&file)
        .into_iter()
        .filter(|(name, _)| !name.starts_with("#refs#"))
        .map(|(name, shape)| name + &shape)
        .collect()
}

/// Every dataset: its name, and its shape as " [18436, 4]".
fn walk(file: &ForeignFile) -> Vec<(String, String)> {
    let (mut found, mut groups, mut at) = (Vec::new(), vec![String::new()], 0);
    while at < groups.len().min(MOST_GROUPS) {
        let group = groups[at].clone();
        at += 1;
        for name in file.names(&group).unwrap_or_default().into_iter().take(1024) {
            let name = if group.is_empty() { name } else { format!("{group}/{name}") };
            match file.dataset(&name) {
                Ok(Some(dataset)) => {
                    let sides = dataset.shape().iter().map(usize::to_string).collect::<Vec<_>>().join(", ");
                    found.push((name, format!(" [{sides}]")));
                }
                _ if name.split('/').count() < DEEPEST
                    && file.names(&name).is_ok_and(|inner| !inner.is_empty()) =>
                {
                    groups.push(name)
                }
                Err(_) => found.push((name, " (no numbers)".into())),
                Ok(None) => {}
            }
        }
    }
    found
}

/// A folder that is no recording: what is in it that is.
pub(super) fn folder(path: &Path, names: &[String]) -> Option<Instead> {
    let has = |name: &str| names.iter().any(|n| n == name);
    if names.is_empty() {
        return Some(Instead::new(
            "an empty folder",
            "name the recording, or check that the folder was copied whole",
        ));
    }
    if has("images.txt") && !has("events.txt") {
        return Some(Instead::new(
            "a folder of the Event Camera Dataset without its events.txt",
            "download or unpack the sequence again: events.txt (`t x y p`) belongs next to images.txt",
        ));
    }
    let inner: Vec<String> = names.iter().filter(|name| !name.starts_with('.')).take(64).cloned().collect();
    let is_recording = |name: &&String| {
        recognise(&path.join(name)).is_ok_and(|format| format.is_some_and(|format| format.id != "pictures"))
    };
    let found: Vec<&String> = inner.iter().filter(is_recording).take(LISTED).collect();
    let listed = |names: &[&String]| {
        names.iter().map(|name| path.join(name).display().to_string()).collect::<Vec<_>>().join(", ")
    };
    if !found.is_empty() {
        return Some(Instead::new(
            format!("a folder that is no recording; it holds {}", listed(&found)),
            "name one of the recordings in it",
        ));
    }
    let few: Vec<&String> = inner.iter().take(6).collect();
    let shown = few.iter().map(|name| name.as_str()).collect::<Vec<_>>().join(", ");
    Some(Instead::new(
        format!("a folder without anything that is known here; it holds {} entries: {shown}", names.len()),
        "name the recording itself",
    ))
}
