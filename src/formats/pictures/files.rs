//! The pictures of a folder or of a Y4M file, and their times.

use super::pairing::Sides;
use super::partners::Times;
use super::stamps::{self, Row, Stamps};
use super::triggers::{Pulses, pulses};
use super::y4m::Y4m;
use super::{decode, names};
use crate::chunk::Trigger;
use crate::declared::{Declared, StampRole, Strobe, TimeUnit, Transfer};
use crate::error::{FormatError, Loss};
use crate::losses::Losses;
use crate::recording::{FramesAbout, Pictures};
use photocurrent_core::Extent;
use std::path::{Path, PathBuf};

/// Names of stamps files, in the order in which they are looked for.
pub(crate) const STAMPS: [&str; 6] = [
    "frames.csv",
    "timestamps.txt",
    "timestamp.txt",
    "images.txt",
    "exposure_timestamps.txt",
    "timestamps.csv",
];

/// Where the values come from.
pub(super) enum Source {
    Files(Vec<PathBuf>),
    Video(Box<Y4m>),
}

/// An opened folder or Y4M file.
pub struct PictureFiles {
    pub(super) about: FramesAbout,
    pub(super) source: Source,
    /// Which picture of the source is frame k.
    pub(super) chosen: Vec<usize>,
    pub(super) losses: Vec<Loss>,
    pub(super) files: Vec<PathBuf>,
}

/// Pictures of one size and depth, before anything is known of their times.
pub(crate) struct Found {
    pub(crate) about: FramesAbout,
    pub(super) source: Source,
    /// Names without folders, of every picture that stands there, whole or not.
    pub(crate) names: Vec<String>,
    /// Which pictures are whole.
    pub(crate) whole: Vec<bool>,
    pub(super) losses: Vec<Loss>,
    pub(super) files: Vec<PathBuf>,
}

/// What the format of a folder defines of its file of stamps.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Defined {
    /// Unit.
    pub(crate) unit: Option<TimeUnit>,
    /// Meaning of plain stamps.
    pub(crate) role: Option<StampRole>,
    /// Where pictures are more than lines, do the lines belong to the first ones?
    pub(crate) lines_count: bool,
}

impl PictureFiles {
    /// Opens a folder or a Y4M file with the stamps that are declared or stand with it.
    ///
    /// # Errors
    /// When there are no pictures, no stamps, or the unit of the stamps is not stated.
    pub fn open(path: &Path, declared: &Declared) -> Result<PictureFiles, FormatError> {
        let found = find(path)?;
        match stamps_file(path, declared) {
            Some(file) => {
                let stamps = stamps::read(&file, declared, None)?;
                found.with_stamps(&file, stamps, declared)
            }
            None => found.at_constant_rate(path),
        }
    }

    /// As [`PictureFiles::open`], with a file of stamps of which the folder's format defines something.
    pub(crate) fn open_with(
        path: &Path,
        declared: &Declared,
        stamps_file: &Path,
        defined: &Defined,
    ) -> Result<PictureFiles, FormatError> {
        let mut stamps = stamps::read(stamps_file, declared, defined.unit)?;
        stamps.role = stamps.role.or(defined.role);
        stamps.lines_count = defined.lines_count;
        find(path)?.with_stamps(stamps_file, stamps, declared)
    }

    /// Pictures whose times are the pulses of a trigger line.
    ///
    /// # Errors
    /// When there are no pictures, the line has no pulse with all its edges, or which picture belongs to
    /// which pulse is a question.
    pub fn of_line(
        path: &Path,
        triggers: &[Trigger],
        line: u16,
        declared: &Declared,
    ) -> Result<PictureFiles, FormatError> {
        let found = find(path)?;
        let of_line = pulses(triggers, line, declared.strobe.unwrap_or(Strobe::ActiveHigh));
        let names = found.names.clone();
        let is_inverted = || {
            let inverted = pulses(triggers, line, Strobe::ActiveLow);
            inverted.has_both
                && inverted.whole() == names.len()
                && Sides::new(&names, &rows_of(&inverted)).decide(declared).is_ok()
        };
        let (whole, has_both) = (of_line.whole(), of_line.has_both);
        let role = has_both.then_some(StampRole::Start);
        let stamps = Stamps { rows: rows_of(&of_line), role, notes: of_line.notes, ..Stamps::default() };
        found.place(path, stamps, declared, Times::Pulses(line)).map_err(|error| {
            if error.undeclared.is_none() || declared.strobe.is_some() || !has_both || !is_inverted() {
                return error;
            }
            let count = names.len();
            let found = format!(
                "{count} pictures, and {whole} whole exposures on trigger line {line} where rising \
                         opens the shutter, {count} where falling opens it"
            );
            let hint = "state it: `strobe = \"active_low\"` for a line that is inverted, \"active_high\" \
                 otherwise; photocurrent init compares both with the events";
            FormatError::new(path, found, hint).undeclared("strobe")
        })
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

/// Size of the first picture of a folder or a Y4M file that can be read; `None` where there is none.
pub(crate) fn size_of(path: &Path) -> Option<Extent> {
    if !path.is_dir() {
        return Y4m::open(path).ok().map(|video| video.extent());
    }
    let folders = [path.to_path_buf(), path.join("images"), path.join("frames")];
    let files = folders
        .iter()
        .filter(|folder| folder.is_dir())
        .find_map(|folder| names::pictures(folder).ok().filter(|files| !files.is_empty()))?;
    files.iter().find_map(|file| decode::head(file).ok()).map(|head| head.extent)
}

/// Pulses as stamps.
pub(crate) fn rows_of(pulses: &Pulses) -> Vec<Row> {
    pulses.all.iter().map(|pulse| Row::at(pulse.at, pulse.exposure, pulse.is_whole)).collect()
}

/// The declared file of stamps, or the one that stands with the pictures.
pub(crate) fn stamps_file(path: &Path, declared: &Declared) -> Option<PathBuf> {
    let folder = if path.is_dir() {
        path.to_path_buf()
    } else {
        path.parent().map(Path::to_path_buf).unwrap_or_default()
    };
    let mut candidates: Vec<PathBuf> = STAMPS.iter().map(|name| folder.join(name)).collect();
    if !path.is_dir() {
        // In the folder of a video only a file of the same name surely belongs to it.
        candidates = vec![path.with_extension("txt"), path.with_extension("csv")];
    }
    declared.stamps.clone().or_else(|| candidates.into_iter().find(|file| file.is_file()))
}

/// Looks for the pictures of a folder or a Y4M file, and reads their headers.
pub(crate) fn find(path: &Path) -> Result<Found, FormatError> {
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
    let is_alike = |head: &decode::Head| {
        (head.extent, head.colour, head.bits) == (first.extent, first.colour, first.bits)
    };
    for (file, head) in files.iter().zip(&heads) {
        if let Some(head) = head.filter(|head| !is_alike(head)) {
            let what = || {
                format!(
                    "{} of {} bits, where others have {} of {}; it was left out",
                    head.extent, head.bits, first.extent, first.bits
                )
            };
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
    Ok(Found {
        about,
        names,
        whole,
        losses: losses.list(),
        files: files.clone(),
        source: Source::Files(files),
    })
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn of_video(path: &Path, video: Y4m) -> Found {
    let about = FramesAbout {
        extent: video.extent(),
        colour: video.colour(),
        bits: video.bits(),
        stamps: Vec::new(),
        stamp_role: None,
        row_time_ns: None,
        transfer: None,
        notes: video.notes(),
    };
    let names = vec![String::new(); video.frames()];
    Found {
        about,
        whole: vec![true; names.len()],
        names,
        losses: video.losses(),
        files: vec![path.into()],
        source: Source::Video(Box::new(video)),
    }
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
        let at: Option<Vec<i64>> = (0..video.frames()).map(|frame| video.at(frame)).collect();
        let Some(at) = at else {
            return Err(FormatError::new(
                path,
                "the header states no frame rate",
                "name a file with the stamps of the frames: `stamps`",
            )
            .undeclared("stamps"));
        };
        let (frames, seconds) = video.rate().unwrap_or((1, 1));
        let note = format!(
            "stamps follow from the header's constant rate, {frames}/{seconds} per second, from 0: \
                     frames that came at other times are not seen in it"
        );
        let rows = at.into_iter().map(|at| Row::at(at, None, true)).collect();
        self.place(
            path,
            Stamps { rows, notes: vec![note], ..Stamps::default() },
            &Declared::default(),
            Times::Stamps,
        )
    }

    fn with_stamps(
        mut self,
        file: &Path,
        mut stamps: Stamps,
        declared: &Declared,
    ) -> Result<PictureFiles, FormatError> {
        self.files.push(file.into());
        if let Source::Video(video) = &self.source
            && let Some(note) = rate_note(video, &stamps.rows)
        {
            stamps.notes.push(note);
        }
        self.place(file, stamps, declared, Times::Stamps)
    }

    /// Replaces `values` by those of a picture.
    pub(crate) fn read(&self, picture: usize, values: &mut Vec<f32>) -> Result<(), FormatError> {
        self.source.read(picture, &self.about, values)
    }
}

/// What a header's constant rate and the stamps disagree about.
fn rate_note(video: &Y4m, rows: &[Row]) -> Option<String> {
    let (frames, seconds) = video.rate()?;
    let period = 1e9 * seconds as f64 / frames as f64;
    let mut steps: Vec<i64> = rows.windows(2).map(|pair| pair[1].at.saturating_sub(pair[0].at)).collect();
    steps.sort_unstable();
    let median = *steps.get(steps.len() / 2)? as f64;
    let varied = steps.iter().filter(|step| (**step as f64 - median).abs() > 0.1 * median.abs()).count();
    if (median - period).abs() > 0.01 * period {
        return Some(format!(
            "the header's rate is one frame in {period:.0} ns, the stamps' mostly \
                             {median:.0} ns; the stamps were taken"
        ));
    }
    (varied > 0).then(|| {
        format!(
            "the header states a constant rate, and {varied} of {} intervals of the stamps differ from \
                 {median:.0} ns by more than 10 %",
            steps.len()
        )
    })
}

impl Pictures for PictureFiles {
    fn about(&self) -> &FramesAbout {
        &self.about
    }

    fn read(&self, frame: usize, values: &mut Vec<f32>) -> Result<(), FormatError> {
        let Some(&picture) = self.chosen.get(frame) else {
            let path = self.files.first().cloned().unwrap_or_default();
            return Err(FormatError::new(
                &path,
                format!("there is no frame {frame}"),
                "ask for one of the frames that have a stamp",
            ));
        };
        self.source.read(picture, &self.about, values)
    }
}

impl Source {
    fn read(&self, picture: usize, about: &FramesAbout, values: &mut Vec<f32>) -> Result<(), FormatError> {
        match self {
            Source::Video(video) => video.read(picture, values),
            Source::Files(files) => {
                let head = decode::read(&files[picture], values)?;
                if (head.extent, head.colour, head.bits) != (about.extent, about.colour, about.bits) {
                    values.clear();
                    return Err(FormatError::new(
                        &files[picture],
                        "the picture was changed since it was opened",
                        "start again",
                    ));
                }
                Ok(())
            }
        }
    }
}
