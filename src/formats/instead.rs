//! What a file is that is no recording, and what to do: a pointer of Git LFS, a web page, an archive, a file
//! of MATLAB, RAW words without their header, a film.
//!
//! Most of them come from a download or an export that went another way than it seemed. Each is recognised by
//! its first bytes, whatever it is called; nothing is unpacked but names and the beginning of what is inside.
//!
//! - [`archive`]: archives, and what they hold that would be read.
//! - [`matlab`]: variables of MATLAB files.
//! - [`inside`]: datasets of an HDF5 file, recordings in a folder.
//! - [`headless`]: words of EVT2, EVT2.1 and EVT3 without a header.
//!
//! Limits: what is recognised as a recording is none of these, so a whole file of the wrong kind (frames
//! where events are needed) is reported elsewhere.

mod archive;
mod headless;
mod inside;
mod matlab;
#[cfg(test)]
mod tests;

use crate::catalog::recognise;
use crate::declared::Declared;
use crate::error::FormatError;
use crate::format::Probe;
use std::path::Path;

/// What a file is instead of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Instead {
    /// A noun phrase: "a web page (`Sign in`)".
    pub what: String,
    /// What to do about it.
    pub todo: String,
}

impl Instead {
    fn new(what: impl Into<String>, todo: impl Into<String>) -> Instead {
        Instead { what: what.into(), todo: todo.into() }
    }

    /// The refusal of the file.
    pub fn refusal(&self, path: &Path) -> FormatError {
        FormatError::new(path, format!("this is {}", self.what), &self.todo)
    }
}

/// What a file or folder is that no format recognises; `None` where nothing is known of it.
pub fn what_it_is(probe: &Probe) -> Option<Instead> {
    by_signature(probe)
        .or_else(|| if probe.is_hdf5() { inside::hdf5(&probe.path) } else { None })
        .or_else(|| headless::words(probe))
}

/// As [`what_it_is`], by what stands at the beginning alone: true of no recording.
fn by_signature(probe: &Probe) -> Option<Instead> {
    if let Some(names) = &probe.names {
        return inside::folder(&probe.path, names);
    }
    let head = probe.head.as_slice();
    not_fetched(probe)
        .or_else(|| archive::archive(probe))
        .or_else(|| matlab::matlab(probe))
        .or_else(|| container(probe))
        .or_else(|| our_text(head))
}

/// What a download leaves that did not fetch the file: nothing, a pointer, a page.
fn not_fetched(probe: &Probe) -> Option<Instead> {
    if probe.names.is_none() && probe.bytes == 0 {
        return Some(Instead::new(
            "an empty file (0 bytes)",
            "the download or the copy did not begin: fetch the file again, and compare its size with the \
             source's",
        ));
    }
    pointer(&probe.head).or_else(|| page(&probe.head))
}

/// Puts what a file is in place of an error about its content, where the file that the error names is
/// something else altogether.
pub fn explained(error: FormatError, declared: &Declared) -> FormatError {
    let path = error.path.clone();
    let Ok(probe) = Probe::new(&path) else { return error };
    let is = |place: &Option<std::path::PathBuf>| place.as_deref() == Some(path.as_path());
    let (is_frames, is_stamps) = (is(&declared.frames), is(&declared.stamps));
    if is_frames || is_stamps {
        let (option, wanted) = if is_frames {
            ("frames", "a folder of PNG or TIFF pictures, or a Y4M file")
        } else {
            ("stamps", "a text file with the stamps of the frames")
        };
        if is_stamps && probe.names.is_some() {
            return FormatError::new(&path, "this is a folder", "name the text file with the stamps")
                .expected(wanted);
        }
        return match recognise(&path).ok().flatten() {
            Some(format) if format.id != "csv" && !(is_frames && format.id == "pictures") => {
                let hint = format!(
                    "`{option}` takes {wanted}; name a recording as the first file: frames \
                                    that it holds are read with it"
                );
                FormatError::new(&path, format!("this is a recording ({})", format.name), hint)
                    .expected(wanted)
            }
            // What is missing of pictures, or wrong in a line of a text, is reported by its reader.
            Some(_) => error,
            None => what_it_is(&probe)
                .filter(|_| probe.names.is_none())
                .map_or(error, |instead| instead.refusal(&path).expected(wanted)),
        };
    }
    // A file of a recording of several, which stands for itself: a text of events, an archive of a sequence,
    // a picture.
    not_fetched(&probe).map_or(error, |instead| instead.refusal(&path))
}

/// Could this be a text of stamps: lines of numbers, of which the first may be a header?
pub fn may_be_stamps(probe: &Probe) -> bool {
    let Ok(text) = std::str::from_utf8(&probe.head)
        .or_else(|error| std::str::from_utf8(&probe.head[..error.valid_up_to()]))
    else {
        return false;
    };
    let has_number =
        |line: &str| line.split([' ', ',', ';', '\t']).any(|word| word.trim().parse::<f64>().is_ok());
    let lines: Vec<&str> =
        text.lines().filter(|line| !line.trim().is_empty() && !line.starts_with(['#', '%'])).collect();
    // The last line may be cut by the look.
    let numbers = lines.iter().filter(|line| has_number(line)).count();
    probe.names.is_none() && !probe.head.contains(&0) && numbers > 0 && numbers + 2 >= lines.len()
}

fn text(head: &[u8]) -> String {
    String::from_utf8_lossy(head).trim_start_matches('\u{feff}').trim_start().to_string()
}

/// `version https://git-lfs.github.com/spec/v1`, `oid sha256:...`, `size 123`; or the place of git-annex.
fn pointer(head: &[u8]) -> Option<Instead> {
    let text = text(&head[..head.len().min(1024)]);
    if text.starts_with("version https://git-lfs.github.com/spec/")
        || text.starts_with("version https://hawser.github.com/spec/")
    {
        let size = text.lines().find_map(|line| line.strip_prefix("size ")?.trim().parse::<u64>().ok());
        let size = size.map_or_else(String::new, |size| format!(" to a file of {size} bytes"));
        return Some(Instead::new(
            format!("a Git LFS pointer{size}, not the file itself"),
            "in its repository run `git lfs install`, then `git lfs pull`; or download the file itself. An \
             archive of a repository holds pointers only",
        ));
    }
    text.contains("/annex/objects/").then(|| {
        Instead::new(
            "a pointer of git-annex, not the file itself",
            "in its repository run `git annex get` with its name (or `datalad get`)",
        )
    })
}

/// HTML, and what servers answer in its place.
fn page(head: &[u8]) -> Option<Instead> {
    let text = text(head);
    let lower = text.to_lowercase();
    let again = "the download needs a login, a confirmation or another link: open the link in a browser, \
                 log in, and download again";
    if lower.starts_with("<!doctype html") || lower.starts_with("<html") || lower.starts_with("<head") {
        let title = lower.find("<title>").and_then(|at| {
            let rest = text.get(at + 7..)?;
            Some(rest.split('<').next()?.trim().chars().take(60).collect::<String>())
        });
        let title = title
            .filter(|title| !title.is_empty())
            .map_or_else(String::new, |title| format!(" (`{}`)", title.escape_debug()));
        return Some(Instead::new(format!("a web page{title}"), again));
    }
    let is_error = lower.starts_with("<?xml") && lower.contains("<error>")
        || lower.starts_with("{\"error\"")
        || lower.starts_with("{\"message\"");
    is_error.then(|| {
        Instead::new(
            format!(
                "a server's error message: `{}`",
                text.chars().take(120).collect::<String>().escape_debug()
            ),
            again,
        )
    })
}

/// Containers of other things: tables, films, pictures, databases, programs' objects.
fn container(probe: &Probe) -> Option<Instead> {
    let head = probe.head.as_slice();
    let name = probe.path.display();
    let save = "load it with the program that wrote it and save events for numpy: \
                `numpy.savez(\"events.npz\", t=t, x=x, y=y, p=p)`";
    let film = || {
        format!(
            "make pictures of it: `ffmpeg -i {name} -fps_mode passthrough frames/%06d.png`, and write the \
             time of each into frames/timestamps.txt; a film's rate is not \
             the time at which frames were taken"
        )
    };
    if head.starts_with(b"PAR1") || head.starts_with(b"ARROW1") || head.starts_with(b"FEA1") {
        let kind = if head.starts_with(b"PAR1") { "a table in Parquet" } else { "a table in Arrow" };
        let read = if head.starts_with(b"PAR1") { "read_parquet" } else { "read_feather" };
        return Some(Instead::new(
            kind,
            format!(
                "save it as text: `python3 -c \"import pandas; pandas.{read}('{name}').to_csv('events.csv', \
                                                index=False)\"`"
            ),
        ));
    }
    if head.get(4..8) == Some(b"ftyp") {
        return Some(Instead::new("a film (MP4 or MOV)", film()));
    }
    if head.starts_with(b"RIFF") && head.get(8..12) == Some(b"AVI ") {
        return Some(Instead::new("a film (AVI)", film()));
    }
    if head.starts_with(b"\x1a\x45\xdf\xa3") {
        return Some(Instead::new("a film (Matroska or WebM)", film()));
    }
    let pictures: [(&[u8], &str); 6] = [
        (b"\x89PNG\r\n", "PNG"),
        (b"II*\0", "TIFF"),
        (b"MM\0*", "TIFF"),
        (b"\xff\xd8\xff", "JPEG"),
        (b"GIF8", "GIF"),
        (b"BM", "BMP"),
    ];
    if let Some((_, kind)) = pictures
        .iter()
        .find(|(magic, kind)| head.starts_with(magic) && (*kind != "BMP" || probe.extension() == "bmp"))
    {
        let todo = match *kind {
            "PNG" | "TIFF" => "name the folder of the pictures instead of one of them".to_string(),
            _ => "name a folder of PNG or TIFF pictures; convert others without loss: `mogrify -format png \
                  *.jpg`"
                .to_string(),
        };
        return Some(Instead::new(format!("one picture ({kind})"), todo));
    }
    if head.starts_with(b"SQLite format 3\0") {
        return Some(Instead::new(
            "an SQLite database",
            "of a ROS 2 bag name the `.mcap` or convert it: `ros2 bag convert`",
        ));
    }
    // Protocol 2 to 5 of pickle, which ends with a full stop.
    if head.first() == Some(&0x80) && matches!(head.get(1), Some(2..=5)) {
        return Some(Instead::new("pickled Python objects, which are programs and are not read", save));
    }
    if head.starts_with(b"%PDF") {
        return Some(Instead::new("a PDF document", "name the recording"));
    }
    None
}

/// Our own texts: descriptions and manifests.
fn our_text(head: &[u8]) -> Option<Instead> {
    let text = text(head);
    let has = |what: &str| text.lines().any(|line| line.trim_start().starts_with(what));
    if has("format = \"photocurrent-sensor/") || has("format=\"photocurrent-sensor/") {
        return Some(Instead::new(
            "a sensor description",
            "name the recording; a manifest names the description with the node read/sensor",
        ));
    }
    (has("[nodes.") && (has("format = 1") || has("extends")))
        .then(|| Instead::new("a manifest of a pipeline", "name the recording that it reads"))
}
