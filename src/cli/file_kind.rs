//! What a file is, by its content: so that every command knows what it was given, whatever it is called.
//!
//! A recording is recognised by the formats' own signatures ([`photocurrent_formats::recognise`]), everything
//! else by its first bytes. Nothing but the start of a file is read. Limits: a text that looks like TOML and
//! does not constrain itself counts as a manifest, whose mistakes are then reported.

use crate::failure::Failure;
use photocurrent_formats::instead::{Instead, what_it_is};
use photocurrent_formats::{Format, Probe};
use photocurrent_store::format_attribute;
use photocurrent_store::recording::FORMAT as OURS;
use std::io::Read;
use std::path::Path;

/// Who reads a recording.
#[derive(Clone, Copy)]
pub enum Reader {
    /// HDF5 in this project's own form.
    Ours,
    /// Any other format of the catalogue.
    Format(&'static Format),
}

/// What a file or folder is.
#[derive(Clone)]
pub enum FileKind {
    /// A recording of events, frames or both.
    Recording(Reader),
    /// A cached result.
    Artefact,
    /// A sensor description.
    Sensor,
    /// A manifest.
    Manifest,
    /// What a run wrote: scores, and a folder for each node.
    RunFolder,
    /// A diagnosis: its folder, its document or its page.
    Diagnosis,
    /// Lines of scores.
    Scores,
    /// A file that is no recording and known all the same: a web page, an archive.
    Instead(Instead),
    /// Nothing of the above, in words.
    Other(String),
    /// It is not there, or may not be read: whoever opens it says so.
    Missing,
}

/// So many bytes of a text say what it is.
const HEAD: u64 = 64 << 10;
/// No manifest and no description is larger.
const LARGEST_TOML: u64 = 16 << 20;
/// The attribute of a cached result.
const ARTEFACT: &str = "photocurrent-artefact/";

impl FileKind {
    /// Looks at the start of a file, or at the names in a folder.
    pub fn of(path: &Path) -> FileKind {
        let Ok(metadata) = std::fs::metadata(path) else { return FileKind::Missing };
        if metadata.is_dir() {
            return of_folder(path);
        }
        let mut head = Vec::new();
        let read = std::fs::File::open(path).and_then(|file| file.take(HEAD).read_to_end(&mut head));
        if read.is_err() || !metadata.is_file() {
            return FileKind::Missing;
        }
        let own = of_hdf5(path, &head).or_else(|| of_text(path, &head, metadata.len()));
        own.or_else(|| of_formats(path))
            .or_else(|| instead(path))
            .unwrap_or_else(|| fallback(&head, metadata.len()))
    }

    /// "a manifest": for messages.
    pub fn describe(&self) -> String {
        match self {
            FileKind::Recording(Reader::Ours) => format!("a recording ({OURS})"),
            FileKind::Recording(Reader::Format(format)) => format!("a recording ({})", format.name),
            FileKind::Artefact => "a cached result".into(),
            FileKind::Sensor => "a sensor description".into(),
            FileKind::Manifest => "a manifest".into(),
            FileKind::RunFolder => "the output folder of a run".into(),
            FileKind::Diagnosis => "a diagnosis".into(),
            FileKind::Scores => "a file of scores".into(),
            FileKind::Instead(instead) => instead.what.clone(),
            FileKind::Other(what) => what.clone(),
            FileKind::Missing => "not there".into(),
        }
    }

    /// What can be done with it.
    fn advice(&self, path: &Path) -> String {
        let path = path.display();
        match self {
            FileKind::Recording(_) => format!(
                "`photocurrent inspect {path}` shows what it holds, \
                                               `photocurrent check {path}` looks for mistakes"
            ),
            FileKind::Artefact => format!("`photocurrent inspect {path}` shows what it holds"),
            FileKind::Sensor => format!(
                "`photocurrent check {path}` looks for mistakes in it; a manifest \
                                         names it with the node read/sensor"
            ),
            FileKind::Manifest => format!("`photocurrent check {path}`, `plan`, `run` and `graph` take it"),
            FileKind::RunFolder | FileKind::Scores => {
                format!("`photocurrent table {path}` prints its scores; the manifest makes them anew")
            }
            FileKind::Diagnosis => "open report.html in a browser; `photocurrent diagnose RECORDING` makes \
                                    it anew"
                .into(),
            FileKind::Instead(instead) => instead.todo.clone(),
            FileKind::Other(_) | FileKind::Missing => "docs/formats.md lists the files that are read".into(),
        }
    }

    /// Refuses a file for a command that takes `wanted`; exit code 2.
    pub fn refuse(&self, path: &Path, command: &str, wanted: &str) -> Failure {
        let message = format!(
            "{}: `{command}` takes {wanted}, and this is {}\n  hint: {}",
            path.display(),
            self.describe(),
            self.advice(path)
        );
        Failure::Other { message, code: 2 }
    }
}

/// Refuses what is no manifest, for the commands that take one. What is not there is reported by the one who
/// reads it.
pub fn need_manifest(path: &Path, command: &str) -> Result<(), Failure> {
    match FileKind::of(path) {
        FileKind::Manifest | FileKind::Missing => Ok(()),
        kind => Err(kind.refuse(path, command, "a manifest")),
    }
}

/// Refuses what evidently belongs to another command: for `inspect`, which looks at recordings and cached
/// results and says itself what it cannot read.
pub fn need_data(path: &Path, command: &str) -> Result<(), Failure> {
    match FileKind::of(path) {
        FileKind::Recording(_)
        | FileKind::Artefact
        | FileKind::Instead(_)
        | FileKind::Other(_)
        | FileKind::Missing => Ok(()),
        kind => Err(kind.refuse(path, command, "a recording or a cached result")),
    }
}

fn of_folder(path: &Path) -> FileKind {
    if path.join("diagnosis.json").is_file() {
        return FileKind::Diagnosis;
    }
    let is_stamped = |folder: &Path| photocurrent_engine::read_stamp(folder).is_some();
    let scores = [crate::run_record::FILE, "metrics.jsonl", "metrics.pooled.jsonl", "pooled.jsonl"];
    let children = || std::fs::read_dir(path).into_iter().flatten().flatten().take(4096);
    if scores.iter().any(|name| path.join(name).is_file())
        || is_stamped(path)
        || children().any(|child| is_stamped(&child.path()))
    {
        return FileKind::RunFolder;
    }
    of_formats(path)
        .or_else(|| instead(path))
        .unwrap_or_else(|| FileKind::Other("a folder without anything that is known here".into()))
}

fn of_formats(path: &Path) -> Option<FileKind> {
    photocurrent_formats::recognise(path)
        .ok()
        .flatten()
        .map(|format| FileKind::Recording(Reader::Format(format)))
}

/// What is recognised by no format, and is known all the same.
fn instead(path: &Path) -> Option<FileKind> {
    what_it_is(&Probe::new(path).ok()?).map(FileKind::Instead)
}

fn of_hdf5(path: &Path, head: &[u8]) -> Option<FileKind> {
    if !head.starts_with(b"\x89HDF\r\n\x1a\n") {
        return None;
    }
    match format_attribute(path).ok().flatten() {
        Some(format) if format == OURS => Some(FileKind::Recording(Reader::Ours)),
        Some(format) if format.starts_with(ARTEFACT) => Some(FileKind::Artefact),
        _ => None,
    }
}

fn of_text(path: &Path, head: &[u8], bytes: u64) -> Option<FileKind> {
    let is_named_so = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml"));
    // A character may be cut in two at the end of what was read.
    let text = match std::str::from_utf8(head) {
        Ok(text) => text,
        // A text in another encoding, by its name: who reads it shows the byte.
        Err(error) if error.error_len().is_none() || is_named_so && !head.contains(&0) => {
            std::str::from_utf8(&head[..error.valid_up_to()]).unwrap_or_default()
        }
        Err(_) => return None,
    };
    let text = text.trim_start_matches('\u{feff}');
    let start = text.trim_start();
    if start.starts_with('{') {
        let has = |words: &str| start.contains(words);
        return match () {
            () if has("\"photocurrent-diagnosis/") => Some(FileKind::Diagnosis),
            () if has("\"metric\"") && start.lines().next().is_some_and(|line| line.contains("\"node\"")) => {
                Some(FileKind::Scores)
            }
            () => None,
        };
    }
    let beginning: String = start.chars().take(400).collect::<String>().to_lowercase();
    let is_page_of = |who: &str| {
        beginning.starts_with("<!doctype html")
            && beginning.contains(&format!("content=\"photocurrent {who}\""))
    };
    if is_page_of("diagnose") {
        return Some(FileKind::Diagnosis);
    }
    if is_page_of("report") {
        return Some(FileKind::Other("the report of a run: open it in a browser".into()));
    }
    if is_page_of("play") {
        return Some(FileKind::Other("a page that plays a recording: open it in a browser".into()));
    }
    match of_toml(text) {
        _ if bytes > LARGEST_TOML => None,
        Some(kind) => Some(kind),
        None => is_named_so.then_some(FileKind::Manifest),
    }
}

/// A manifest or a sensor description by its first lines that mean something; `None` for what is no TOML.
fn of_toml(text: &str) -> Option<FileKind> {
    let mut is_toml = false;
    for line in text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#')) {
        if let Some(header) = line.strip_prefix('[') {
            let table = header.trim_start_matches('[').split([']', '.']).next().unwrap_or_default().trim();
            match table {
                "nodes" | "pipeline" | "ablation" => return Some(FileKind::Manifest),
                "front_end" | "comparator" | "readout" | "frames" | "optics" | "effects" => {
                    return Some(FileKind::Sensor);
                }
                _ => is_toml = header.contains(']'),
            }
            continue;
        }
        match line.split_once('=').map(|(key, value)| (key.trim(), value.trim())) {
            Some(("format", value))
                if value.starts_with("\"photocurrent-sensor/")
                    || value.starts_with("'photocurrent-sensor/") =>
            {
                return Some(FileKind::Sensor);
            }
            Some(("format" | "extends", _)) => return Some(FileKind::Manifest),
            Some((key, _)) if is_key(key) => is_toml = true,
            _ if is_toml => {}
            _ => return None,
        }
    }
    is_toml.then_some(FileKind::Manifest)
}

fn is_key(key: &str) -> bool {
    !key.is_empty()
        && key.chars().all(|c| c.is_alphanumeric() || "_-.\"'".contains(c))
        && key.chars().any(char::is_alphabetic)
}

fn fallback(head: &[u8], bytes: u64) -> FileKind {
    if head.starts_with(b"\x89HDF\r\n\x1a\n") {
        return FileKind::Other("an HDF5 file of another form than those that are read".into());
    }
    let start = &head[..head.len().min(40)];
    let is_text = !head.iter().take(4096).any(|byte| *byte == 0)
        && std::str::from_utf8(&start[..start.len().min(8)]).is_ok();
    let what = if is_text { "a text" } else { "a file" };
    FileKind::Other(format!(
        "{what} of no form that is known here ({bytes} bytes, beginning with \"{}\")",
        start.escape_ascii()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kind(name: &str, content: &[u8]) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        FileKind::of(&path).describe()
    }

    #[test]
    fn texts_are_known_by_what_they_say_and_not_by_their_names() {
        let cases: [(&str, &[u8], &str); 10] = [
            ("a.txt", b"# mine\nformat = \"photocurrent-sensor/1\"\n", "a sensor description"),
            ("a.toml", b"name = \"x\"\n[front_end]\ntau_0 = \"1 us\"\n", "a sensor description"),
            ("a", b"\xef\xbb\xbfformat = 1\n", "a manifest"),
            ("b.toml", b"extends = \"a.toml\"\n", "a manifest"),
            ("c.cfg", b"[nodes.a]\nkind = \"read/sensor\"\n", "a manifest"),
            ("broken.toml", b"]]] = = \n", "a manifest"),
            ("d.json", b"{\n \"schema\": \"photocurrent-diagnosis/1\"}", "a diagnosis"),
            (
                "r.html",
                b"<!doctype html>\n<html>\n<head><meta name=\"generator\" content=\"photocurrent diagnose\">",
                "a diagnosis",
            ),
            ("m", b"{\"variant\":\"base\",\"node\":\"psnr\",\"metric\":\"psnr_db\"}\n", "a file of scores"),
            ("empty", b"", "an empty file (0 bytes)"),
        ];
        for (name, content, expected) in cases {
            assert_eq!(kind(name, content), expected, "{name}");
        }
        for (name, content) in [
            ("events.txt", &b"0.003811 96 133 0\n0.003820 20 1 1\n"[..]),
            ("noise", b"\x00\x01\xff=\n"),
            ("prose", b"Dear reader,\nformat is no key\n"),
        ] {
            let said = kind(name, content);
            assert!(!said.contains("manifest") && !said.contains("sensor"), "{name}: {said}");
        }
    }

    #[test]
    fn what_is_in_another_form_is_refused_with_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.toml");
        std::fs::write(&path, "format = \"photocurrent-sensor/1\"\n").unwrap();
        let Err(Failure::Other { message, code: 2 }) = need_manifest(&path, "run") else { panic!("refused") };
        assert!(
            message.contains("`run` takes a manifest, and this is a sensor description")
                && message.contains("photocurrent check"),
            "{message}"
        );
        assert!(need_data(&path, "inspect").is_err());
        let nowhere = folder.path().join("nowhere");
        assert!(need_manifest(&nowhere, "run").is_ok() && need_data(&nowhere, "inspect").is_ok());
    }
}
