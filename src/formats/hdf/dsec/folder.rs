//! A sequence's folder of DSEC: where the events are, and its pictures with their exposures.

use crate::error::FormatError;
use crate::pictures::{Defined, PictureFiles, names};
use crate::{Declared, StampRole, TimeUnit};
use std::path::{Path, PathBuf};

/// The file of events in a folder; of the left camera, unless another is asked for.
pub(super) fn events_of(folder: &Path, camera: Option<&str>) -> Option<PathBuf> {
    let camera = camera.unwrap_or("left");
    let places = [
        format!("events/{camera}/events.h5"),
        format!("{camera}/events.h5"),
        "events/events.h5".into(),
        "events.h5".into(),
    ];
    places.iter().map(|place| folder.join(place)).find(|path| path.is_file())
}

/// Does a folder without events have the pictures of a sequence, where DSEC has them?
pub(super) fn is_sequence(folder: &Path) -> bool {
    let images = folder.join("images");
    ["left", "right"]
        .iter()
        .any(|camera| ["rectified", "distorted"].iter().any(|kind| images.join(camera).join(kind).is_dir()))
}

/// The refusal of a folder without the events of a camera.
pub(super) fn without_events(folder: &Path, camera: Option<&str>) -> FormatError {
    let side = camera.unwrap_or("left");
    let name =
        folder.file_name().map_or_else(|| "SEQUENCE".into(), |name| name.to_string_lossy().into_owned());
    let packed = [format!("{name}_events_{side}.zip"), format!("events_{side}.zip"), "events.zip".into()];
    let hint = match packed.iter().map(|zip| folder.join(zip)).find(|zip| zip.is_file()) {
        Some(zip) => {
            format!("unpack it: unzip {} -d {}", zip.display(), folder.join("events").join(side).display())
        }
        None => format!(
            "it is in {name}_events_{side}.zip of dsec.ifi.uzh.ch: unpack that into \
                         events/{side}, or name another side as `camera`"
        ),
    };
    FormatError::new(folder, format!("events/{side}/events.h5 is missing"), hint)
        .expected("events/left/events.h5 or events.h5")
}

/// Cameras whose events lie in a folder, by their names.
pub(super) fn cameras_of(folder: &Path) -> Vec<String> {
    let inner = |place: PathBuf| std::fs::read_dir(place).into_iter().flatten().flatten();
    let names = inner(folder.join("events"))
        .chain(inner(folder.into()))
        .filter(|entry| entry.path().join("events.h5").is_file());
    let mut names: Vec<String> = names
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| name != "events")
        .collect();
    names.sort();
    names.dedup();
    names
}

/// The pictures of a camera, left unless another is wanted, with their exposures or the middles of these;
/// `None` when there are none.
pub(super) fn pictures_of(
    folder: &Path,
    declared: &Declared,
    camera: Option<&str>,
) -> Result<Option<PictureFiles>, FormatError> {
    let camera = camera.unwrap_or("left");
    let images = folder.join("images");
    let places =
        [images.join(camera).join("rectified"), images.join(camera).join("distorted"), images.join(camera)];
    let has_pictures = |place: &&PathBuf| names::pictures(place).is_ok_and(|files| !files.is_empty());
    let Some(place) = places.iter().find(has_pictures) else { return Ok(None) };
    let exposures = images.join(camera).join(format!("exposure_timestamps_{camera}.txt"));
    let middles = images.join("timestamps.txt");
    let Some(stamps) = [exposures, middles].into_iter().find(|file| file.is_file()) else {
        let name = format!("images/{camera}/exposure_timestamps_{camera}.txt");
        let hint = "both come with the sequence on dsec.ifi.uzh.ch (image timestamps, exposure timestamps); \
                    or read events.h5 alone";
        return Err(FormatError::new(
            place,
            format!("pictures without stamps: {name} and images/timestamps.txt are missing"),
            hint,
        )
        .undeclared("stamps"));
    };
    // The unit and the meaning of these files are the format's: nothing that is stated of the events' file
    // changes them.
    let declared = Declared {
        first_pulse: declared.first_pulse,
        pairing: declared.pairing,
        stamps_unit: declared.stamps_unit,
        ..Declared::default()
    };
    let defined = Defined { unit: Some(TimeUnit::Us), role: Some(StampRole::Middle), lines_count: false };
    PictureFiles::open_with(place, &declared, &stamps, &defined).map(Some)
}
