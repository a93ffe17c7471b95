//! Frames without events: a folder of PNG, TIFF or JPEG pictures, or a Y4M file, with stamps from a text file.
//!
//! The stamps come from a declared file, or from one that stands in the folder (`timestamps.txt`, `timestamp.txt`, `images.txt`, `frames.csv`). A Y4M file
//! without stamps has the constant rate of its header, and a note says so. Values are given as stored: see [`crate::declared::Transfer`].
//! Limits: the first picture of a file with several; all frames have one size and one depth.

pub(crate) mod decode;
mod jpeg;
#[cfg(test)]
mod jpeg_tests;
pub(crate) mod names;
pub(crate) mod stamps;
#[cfg(test)]
pub(crate) mod tests;
pub mod triggers;
pub(crate) mod y4m;

use crate::declared::{Declared, StampRole, TimeUnit, Transfer};
use crate::error::{FormatError, Loss};
use crate::format::{Format, Probe};
use crate::losses::Losses;
use crate::recording::{EventCursor, EventsAbout, FrameStamp, FramesAbout, Pictures, Recording};
use stamps::{Row, Stamps};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
pub use triggers::exposures_from_triggers;
use y4m::Y4m;

/// Folders of pictures and Y4M files.
pub static FORMAT: Format = Format {
    id: "pictures",
    name: "pictures (PNG, TIFF or JPEG folder, Y4M)",
    recognises,
    open: |path, declared| Ok(Box::new(PicturesOnly::open(path, declared)?)),
};

/// Names of stamps files, in the order in which they are looked for.
pub(crate) const STAMPS: [&str; 6] = ["frames.csv", "timestamps.txt", "timestamp.txt", "images.txt", "exposure_timestamps.txt", "timestamps.csv"];

fn recognises(probe: &Probe) -> bool {
    match &probe.names {
        Some(names) => names.iter().any(|name| names::is_picture(name)),
        None => probe.head.starts_with(b"YUV4MPEG2 "),
    }
}

/// Where the values come from.
enum Source {
    Files(Vec<PathBuf>),
    Video(Box<Y4m>),
}

/// An opened folder or Y4M file.
pub struct PictureFiles {
    about: FramesAbout,
    source: Source,
    /// Which picture of the source is frame k.
    chosen: Vec<usize>,
    losses: Vec<Loss>,
    files: Vec<PathBuf>,
}

/// Pictures of one size and depth, before anything is known of their times.
struct Found {
    about: FramesAbout,
    source: Source,
    /// Names without folders, of every picture that stands there, whole or not.
    names: Vec<String>,
    /// Which pictures are whole.
    whole: Vec<bool>,
    losses: Vec<Loss>,
    files: Vec<PathBuf>,
}

impl PictureFiles {
    /// Opens a folder or a Y4M file with the stamps that are declared or stand with it.
    ///
    /// # Errors
    /// When there are no pictures, no stamps, or the unit of the stamps is not stated.
    pub fn open(path: &Path, declared: &Declared) -> Result<PictureFiles, FormatError> {
        let found = find(path)?;
        let folder = if path.is_dir() { path.to_path_buf() } else { path.parent().map(Path::to_path_buf).unwrap_or_default() };
        let mut candidates: Vec<PathBuf> = STAMPS.iter().map(|name| folder.join(name)).collect();
        if !path.is_dir() {
            // In the folder of a video only a file of the same name surely belongs to it.
            candidates = vec![path.with_extension("txt"), path.with_extension("csv")];
        }
        let stamps_file = declared.stamps.clone().or_else(|| candidates.into_iter().find(|file| file.is_file()));
        match stamps_file {
            Some(file) => found.with_stamps(&file, stamps::read(&file, declared, None)?),
            None => found.at_constant_rate(path),
        }
    }

    /// As [`PictureFiles::open`], with the stamps of a file whose unit, and the meaning of whose plain stamps, the folder's format defines.
    pub(crate) fn open_with(
        path: &Path,
        declared: &Declared,
        stamps_file: &Path,
        unit: Option<TimeUnit>,
        role: Option<StampRole>,
    ) -> Result<PictureFiles, FormatError> {
        let mut stamps = stamps::read(stamps_file, declared, unit)?;
        stamps.role = stamps.role.or(role);
        find(path)?.with_stamps(stamps_file, stamps)
    }

    /// Pictures whose exposures are known from elsewhere: the edges of a trigger line.
    ///
    /// # Errors
    /// When there are no pictures.
    pub fn with_exposures(path: &Path, exposures: &[(i64, i64)], notes: Vec<String>) -> Result<PictureFiles, FormatError> {
        let rows = exposures.iter().map(|&(start, end)| Row { name: None, at: start, exposure: Some((start, end)), line: 0 }).collect();
        let stamps = Stamps { rows, role: Some(StampRole::Start), notes, ..Stamps::default() };
        find(path)?.place(stamps)
    }

    /// What was left out.
    pub fn losses(&self) -> &[Loss] {
        &self.losses
    }

    /// All files that are read.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }
}

/// Looks for the pictures of a folder or a Y4M file, and reads their headers.
fn find(path: &Path) -> Result<Found, FormatError> {
    if !path.is_dir() {
        return Y4m::open(path).map(|video| of_video(path, video));
    }
    let mut files = names::pictures(path)?;
    if files.is_empty() {
        for inner in ["images", "frames"] {
            let inner = path.join(inner);
            if inner.is_dir() {
                files = names::pictures(&inner)?;
            }
        }
    }
    let mut losses = Losses::default();
    let mut heads: Vec<Option<decode::Head>> = Vec::with_capacity(files.len());
    for file in &files {
        let head = decode::head(file);
        if let Err(error) = &head {
            let what = || format!("{}; it was left out", error.found);
            losses.add("pictures that cannot be read were left out", || file_name(file), what);
        }
        heads.push(head.ok());
    }
    // The kind of the first whole picture is that of the recording.
    let Some(first) = heads.iter().flatten().next().copied() else {
        return Err(FormatError::new(
            path,
            if files.is_empty() { "no pictures" } else { "no picture that can be read" },
            "name a folder of PNG, TIFF or JPEG pictures",
        )
        .expected("pictures such as 000000.png"));
    };
    let is_alike = |head: &decode::Head| (head.extent, head.colour, head.bits) == (first.extent, first.colour, first.bits);
    for (file, head) in files.iter().zip(&heads) {
        if let Some(head) = head.filter(|head| !is_alike(head)) {
            let what = || format!("{} of {} bits, where others have {} of {}; it was left out", head.extent, head.bits, first.extent, first.bits);
            losses.add("pictures of another size or depth were left out", || file_name(file), what);
        }
    }
    let mut notes = Vec::new();
    if heads.iter().flatten().any(|head| head.has_more) {
        notes.push("a file holds several pictures; only the first was read".into());
    }
    let says_srgb = heads.iter().flatten().all(|head| head.says_srgb);
    if says_srgb {
        notes.push("the pictures say that they are encoded as sRGB".into());
    }
    let about = FramesAbout {
        extent: first.extent,
        colour: first.colour,
        bits: first.bits,
        stamps: Vec::new(),
        stamp_role: None,
        row_time_ns: None,
        transfer: says_srgb.then_some(Transfer::Srgb),
        notes,
    };
    let names = files.iter().map(|file| file_name(file)).collect();
    let whole = heads.iter().map(|head| head.as_ref().is_some_and(is_alike)).collect();
    Ok(Found { about, names, whole, losses: losses.list(), files: files.clone(), source: Source::Files(files) })
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn of_video(path: &Path, video: Y4m) -> Found {
    let about = FramesAbout {
        extent: video.extent,
        colour: video.colour,
        bits: video.bits,
        stamps: Vec::new(),
        stamp_role: None,
        row_time_ns: None,
        transfer: None,
        notes: video.notes.clone(),
    };
    let names = vec![String::new(); video.frames.len()];
    Found { about, whole: vec![true; names.len()], names, losses: video.losses.clone(), files: vec![path.into()], source: Source::Video(Box::new(video)) }
}

impl Found {
    fn at_constant_rate(self, path: &Path) -> Result<PictureFiles, FormatError> {
        let Source::Video(video) = &self.source else {
            let looked = STAMPS.join(", ");
            return Err(FormatError::new(
                path,
                format!("{} pictures, and no file with their stamps (looked for {looked})", self.names.len()),
                "name one: `stamps`",
            )
            .undeclared("stamps"));
        };
        let at: Option<Vec<i64>> = (0..video.frames.len()).map(|frame| video.at(frame)).collect();
        let Some(at) = at else {
            return Err(FormatError::new(path, "the header states no frame rate", "name a file with the stamps of the frames: `stamps`").undeclared("stamps"));
        };
        let (frames, seconds) = video.rate.unwrap_or((1, 1));
        let note =
            format!("stamps follow from the header's constant rate, {frames}/{seconds} per second, from 0: frames that came at other times are not seen in it");
        let rows = at.into_iter().map(|at| Row { name: None, at, exposure: None, line: 0 }).collect();
        self.place(Stamps { rows, notes: vec![note], ..Stamps::default() })
    }

    fn with_stamps(mut self, file: &Path, mut stamps: Stamps) -> Result<PictureFiles, FormatError> {
        self.files.push(file.into());
        if let Source::Video(video) = &self.source
            && let Some(note) = rate_note(video, &stamps.rows)
        {
            stamps.notes.push(note);
        }
        self.place(stamps)
    }

    /// Gives every picture its stamp: by name where the stamps have names, else by order.
    fn place(self, stamps: Stamps) -> Result<PictureFiles, FormatError> {
        let Found { mut about, source, names, whole, losses, files } = self;
        let Stamps { mut rows, role, row_time_ns, is_linear, notes } = stamps;
        about.notes.extend(notes);
        let mut chosen = Vec::new();
        if rows.iter().any(|row| row.name.is_some()) {
            let index: HashMap<&str, usize> = names.iter().enumerate().map(|(index, name)| (name.as_str(), index)).collect();
            let mut missing: Option<&str> = None;
            let (mut used, mut absent) = (vec![false; names.len()], 0);
            for row in &rows {
                let name = row.name.as_deref().unwrap_or_default();
                match index.get(name) {
                    Some(&picture) if !used[picture] => {
                        used[picture] = true;
                        if whole[picture] {
                            chosen.push(picture);
                            about.stamps.push(FrameStamp { at: row.at, exposure: row.exposure });
                        }
                    }
                    _ => {
                        absent += 1;
                        missing = missing.or(Some(name));
                    }
                }
            }
            if absent > 0 {
                about.notes.push(format!(
                    "{absent} stamps name no picture that is there, or one twice (the first: `{}`); they were left out",
                    missing.unwrap_or_default()
                ));
            }
            let unstamped = used.iter().filter(|used| !**used).count();
            if unstamped > 0 {
                about.notes.push(format!("{unstamped} pictures have no stamp and were left out"));
            }
        } else {
            if let Some((wrong, why)) = stamps::leading_wrong(&rows, rows.len().saturating_sub(names.len())) {
                about.notes.push(why);
                rows.drain(..wrong);
            }
            if rows.len() != names.len() {
                let (both, more) = (rows.len().min(names.len()), if rows.len() > names.len() { "stamps" } else { "pictures" });
                let count = rows.len().abs_diff(names.len());
                about.notes.push(format!(
                    "{} pictures and {} stamps: the first {both} of both are taken to belong together; the last {count} {more} were left out",
                    names.len(),
                    rows.len()
                ));
            }
            for (picture, row) in rows.iter().enumerate().take(names.len()).filter(|(picture, _)| whole[*picture]) {
                chosen.push(picture);
                about.stamps.push(FrameStamp { at: row.at, exposure: row.exposure });
            }
        }
        about.stamp_role = role;
        about.row_time_ns = row_time_ns;
        if is_linear {
            about.transfer = Some(Transfer::Linear);
        }
        Ok(PictureFiles { about, source, chosen, losses, files })
    }
}

/// What a header's constant rate and the stamps disagree about.
fn rate_note(video: &Y4m, rows: &[Row]) -> Option<String> {
    let (frames, seconds) = video.rate?;
    let period = 1e9 * seconds as f64 / frames as f64;
    let mut steps: Vec<i64> = rows.windows(2).map(|pair| pair[1].at.saturating_sub(pair[0].at)).collect();
    steps.sort_unstable();
    let median = *steps.get(steps.len() / 2)? as f64;
    let varied = steps.iter().filter(|step| (**step as f64 - median).abs() > 0.1 * median.abs()).count();
    if (median - period).abs() > 0.01 * period {
        return Some(format!("the header's rate is one frame in {period:.0} ns, the stamps' mostly {median:.0} ns; the stamps were taken"));
    }
    (varied > 0).then(|| {
        format!("the header states a constant rate, and {varied} of {} intervals of the stamps differ from {median:.0} ns by more than 10 %", steps.len())
    })
}

impl Pictures for PictureFiles {
    fn about(&self) -> &FramesAbout {
        &self.about
    }

    fn read(&self, frame: usize, values: &mut Vec<f32>) -> Result<(), FormatError> {
        let Some(&picture) = self.chosen.get(frame) else {
            let path = self.files.first().cloned().unwrap_or_default();
            return Err(FormatError::new(&path, format!("there is no frame {frame}"), "ask for one of the frames that have a stamp"));
        };
        match &self.source {
            Source::Video(video) => video.read(picture, values),
            Source::Files(files) => {
                let head = decode::read(&files[picture], values)?;
                let about = &self.about;
                if (head.extent, head.colour, head.bits) != (about.extent, about.colour, about.bits) {
                    values.clear();
                    return Err(FormatError::new(&files[picture], "the picture was changed since it was opened", "start again"));
                }
                Ok(())
            }
        }
    }
}

/// Pictures as a recording: frames and no events.
pub struct PicturesOnly {
    path: PathBuf,
    frames: Arc<PictureFiles>,
}

impl PicturesOnly {
    fn open(path: &Path, declared: &Declared) -> Result<PicturesOnly, FormatError> {
        Ok(PicturesOnly { path: path.into(), frames: Arc::new(PictureFiles::open(path, declared)?) })
    }
}

impl Recording for PicturesOnly {
    fn events_about(&self) -> Option<&EventsAbout> {
        None
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        Err(FormatError::new(&self.path, "pictures have no events", "name an event recording, and these pictures as its `frames`"))
    }

    fn pictures(&self) -> Option<Arc<dyn Pictures>> {
        Some(self.frames.clone())
    }

    fn losses(&self) -> Vec<Loss> {
        self.frames.losses.clone()
    }

    fn files(&self) -> Vec<PathBuf> {
        self.frames.files.clone()
    }
}
