//! A folder as the Event Camera Dataset keeps a recording: `events.txt` (`t x y p`, seconds), `images.txt`
//! (`t images/frame_00000000.png`) and the pictures.
//!
//! Source: Mueggler et al., The Event-Camera Dataset and Simulator, IJRR 2017. What an image's stamp means,
//! the exposure and the encoding of its values are not recorded. E2VID's folders are the same with a first
//! line `width height`.

use crate::csv::Csv;
use crate::declared::{Column, Declared, TimeUnit};
use crate::error::{FormatError, Loss};
use crate::format::{Format, Probe};
use crate::pictures::{Defined, PictureFiles, names};
use crate::recording::Convention;
use crate::recording::{EventCursor, EventsAbout, Pictures, Recording};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Event Camera Dataset folders.
pub(crate) static FORMAT: Format = Format {
    id: "ecd",
    name: "Event Camera Dataset folder (events.txt, images.txt)",
    recognises,
    open: |path, declared| Ok(Box::new(EventCameraDataset::open(path, declared)?)),
};

/// A folder with the list of pictures and their folder, but no events, is one that was copied or unpacked in
/// part.
fn recognises(probe: &Probe) -> bool {
    let pictures_here = probe.names.iter().flatten().any(|name| names::is_picture(name));
    probe.has("events.txt") || probe.has("images.txt") && probe.has("images") && !pictures_here
}

/// The refusal of a folder without its events.
fn without_events(path: &Path) -> FormatError {
    let packed =
        ["events.zip", "events.txt.gz", "events.txt.zip"].into_iter().find(|name| path.join(name).is_file());
    let hint = match packed {
        Some(name) if name.ends_with(".gz") => {
            format!("unpack it there: gunzip -k {}", path.join(name).display())
        }
        Some(name) => format!("unpack it there: unzip {} -d {}", path.join(name).display(), path.display()),
        None => {
            let frames = "for its frames alone name the folder `images`, with `images.txt` as stamps";
            format!(
                "it is in the sequence's zip (rpg.ifi.uzh.ch/davis_data.html), with the pictures; {frames}"
            )
        }
    };
    let found = match packed {
        Some(name) => format!("events.txt is missing; {name} is there, packed"),
        None => "events.txt is missing; images.txt and the pictures are there".into(),
    };
    FormatError::new(path, found, hint).expected("events.txt with a line `t x y p` an event")
}

/// An opened folder.
pub(crate) struct EventCameraDataset {
    events: Csv,
    frames: Option<Arc<PictureFiles>>,
    calibration: Option<(PathBuf, String)>,
    files: Vec<PathBuf>,
}

impl EventCameraDataset {
    /// Opens a folder.
    ///
    /// # Errors
    /// When `events.txt` is missing or has no events, or `images.txt` names no pictures.
    pub(crate) fn open(path: &Path, declared: &Declared) -> Result<EventCameraDataset, FormatError> {
        if !path.join("events.txt").exists() {
            return Err(without_events(path));
        }
        let columns = [Column::T, Column::X, Column::Y, Column::P];
        let events = Csv::open_as(&path.join("events.txt"), declared, Some((&columns, TimeUnit::S)))?;
        let images = path.join("images.txt");
        let frames = match images.is_file() {
            // The stamps of both files have one unit.
            true => Some(Arc::new(PictureFiles::open_with(
                path,
                declared,
                &images,
                &Defined { unit: Some(events.unit()), ..Defined::default() },
            )?)),
            false => None,
        };
        let extent = frames.as_ref().map(|frames| frames.about().extent);
        let events = events.or_extent(extent);
        let mut files = vec![path.join("events.txt")];
        files.extend(frames.iter().flat_map(|frames| frames.files().to_vec()));
        let calibration = calibration(&path.join("calib.txt"));
        files.extend(calibration.iter().map(|(file, _)| file.clone()));
        Ok(EventCameraDataset { events, frames, calibration, files })
    }
}

/// `calib.txt`: fx fy cx cy k1 k2 p1 p2 k3.
fn calibration(file: &Path) -> Option<(PathBuf, String)> {
    let small = std::fs::metadata(file).ok()?.len() < 4096;
    let text = std::fs::read_to_string(file).ok().filter(|_| small)?;
    let line = text.lines().next()?.trim();
    let numbers = line.split_whitespace().all(|word| word.parse::<f64>().is_ok());
    (numbers && !line.is_empty()).then(|| (file.to_path_buf(), line.to_string()))
}

impl Recording for EventCameraDataset {
    fn events_about(&self) -> Option<&EventsAbout> {
        self.events.events_about()
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        self.events.events()
    }

    fn pictures(&self) -> Option<Arc<dyn Pictures>> {
        self.frames.clone().map(|frames| frames as Arc<dyn Pictures>)
    }

    fn facts(&self) -> Vec<(String, String)> {
        self.calibration
            .iter()
            .map(|(_, line)| ("calibration (fx fy cx cy k1 k2 p1 p2 k3)".to_string(), line.clone()))
            .collect()
    }

    fn conventions(&self) -> Vec<Convention> {
        self.events.conventions()
    }

    fn losses(&self) -> Vec<Loss> {
        self.frames.iter().flat_map(|frames| frames.losses().to_vec()).collect()
    }

    fn files(&self) -> Vec<PathBuf> {
        self.files.clone()
    }
}
