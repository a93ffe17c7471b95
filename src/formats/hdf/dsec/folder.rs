//! A sequence's folder of DSEC: where the events are, and its PNG pictures with their exposures.

use super::super::extent;
use crate::StampRole;
use crate::error::FormatError;
use crate::recording::{FrameStamp, FramesAbout, Pictures};
use photocurrent_core::Colour;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A text of stamps is no longer than this.
const LONGEST_TEXT: u64 = 64 << 20;
/// Memory that decoding one picture may take.
const PICTURE_BYTES: usize = 1 << 30;

/// The file of events in a folder; of the left camera, unless another is asked for.
pub(super) fn events_of(folder: &Path, camera: Option<&str>) -> Option<PathBuf> {
    let camera = camera.unwrap_or("left");
    let places = [format!("events/{camera}/events.h5"), format!("{camera}/events.h5"), "events/events.h5".into(), "events.h5".into()];
    places.iter().map(|place| folder.join(place)).find(|path| path.is_file())
}

/// The pictures and the files they are read from; `None` when there are none.
#[allow(clippy::type_complexity)]
pub(super) fn pictures_of(folder: &Path, camera: Option<&str>) -> Result<Option<(Arc<dyn Pictures>, Vec<PathBuf>)>, FormatError> {
    let camera = camera.unwrap_or("left");
    let images = folder.join("images");
    let places = [images.join(camera).join("rectified"), images.join(camera).join("distorted"), images.join(camera)];
    let Some((place, mut files)) = places.iter().map(|place| (place, pngs(place))).find(|(_, files)| !files.is_empty()) else { return Ok(None) };
    let exposures = images.join(camera).join(format!("exposure_timestamps_{camera}.txt"));
    let middles = images.join("timestamps.txt");
    let (from, stamps) = if exposures.is_file() {
        let both = |row: &[i64]| Some(FrameStamp { at: row[0] + (row.get(1)? - row[0]) / 2, exposure: Some((row[0], *row.get(1)?)) });
        (exposures.clone(), lines(&exposures)?.iter().map(|row| both(row)).collect::<Option<Vec<_>>>())
    } else if middles.is_file() {
        (middles.clone(), Some(lines(&middles)?.iter().map(|row| FrameStamp { at: row[0], exposure: None }).collect()))
    } else {
        let hint = "put images/timestamps.txt or the exposures of the camera beside the pictures, or read the events alone";
        return Err(FormatError::new(place, format!("{} pictures without stamps", files.len()), hint).undeclared("stamps"));
    };
    let one = || FormatError::new(&from, "a line with one number", "write the file as DSEC does").expected("start and end of every exposure, in microseconds");
    let mut stamps = stamps.ok_or_else(one)?;
    let mut notes = Vec::new();
    if files.len() != stamps.len() {
        notes.push(format!("{} pictures and {} stamps: what is left over at the end was left out", files.len(), stamps.len()));
        files.truncate(stamps.len());
        stamps.truncate(files.len());
    }
    let Some(first) = files.first() else { return Ok(None) };
    let (header, _) = decode(first)?;
    let extent = extent(header.0.into(), header.1.into()).ok_or_else(|| FormatError::new(first, "a picture without pixels", "copy it again"))?;
    let colour = if header.2 == 3 { Colour::Rgb } else { Colour::Mono };
    let about = FramesAbout { extent, colour, bits: header.3, stamps, stamp_role: Some(StampRole::Middle), row_time_ns: None, transfer: None, notes };
    let all = files.iter().cloned().chain([from]).collect();
    Ok(Some((Arc::new(Pngs { files, about }), all)))
}

fn pngs(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let is_png = |path: &PathBuf| path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"));
    let mut files: Vec<PathBuf> = entries.filter_map(Result::ok).map(|entry| entry.path()).filter(is_png).collect();
    files.sort();
    files
}

/// Numbers of a text in microseconds, as nanoseconds; lines that begin with `#` are notes.
fn lines(path: &Path) -> Result<Vec<Vec<i64>>, FormatError> {
    let file = File::open(path).map_err(|error| FormatError::io(path, &error))?;
    let mut rows = Vec::new();
    for (at, line) in BufReader::new(file.take(LONGEST_TEXT)).lines().enumerate() {
        let line = line.map_err(|error| FormatError::io(path, &error))?;
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let numbers = line.split(',').map(|number| number.trim().parse::<i64>().ok().and_then(|us| us.checked_mul(1000)));
        let wrong = || {
            FormatError::new(path, format!("`{}`", line.chars().take(40).collect::<String>()), "write times as whole microseconds")
                .at(format!("line {}", at + 1))
        };
        rows.push(numbers.collect::<Option<Vec<i64>>>().ok_or_else(wrong)?);
    }
    Ok(rows)
}

struct Pngs {
    files: Vec<PathBuf>,
    about: FramesAbout,
}

impl Pictures for Pngs {
    fn about(&self) -> &FramesAbout {
        &self.about
    }

    fn read(&self, frame: usize, values: &mut Vec<f32>) -> Result<(), FormatError> {
        let missing = || FormatError::new(Path::new("images"), format!("there is no frame {frame}"), "the folder changed while it was read");
        let file = self.files.get(frame).ok_or_else(missing)?;
        let ((width, height, channels, _), found) = decode(file)?;
        if (width, height, channels) != (self.about.extent.width, self.about.extent.height, self.about.colour.channels()) {
            let expected = format!("{} pixels with {} channels, as the first picture has", self.about.extent, self.about.colour.channels());
            return Err(
                FormatError::new(file, format!("{width} x {height} pixels with {channels} channels"), "the pictures must be of one kind").expected(expected)
            );
        }
        *values = found;
        Ok(())
    }
}

/// Width, height, channels and bits of a PNG, and its stored values.
#[allow(clippy::type_complexity)]
fn decode(path: &Path) -> Result<((u32, u32, u32, u32), Vec<f32>), FormatError> {
    let wrong = |error: png::DecodingError| FormatError::new(path, format!("this is no whole PNG picture ({error})"), "copy it again");
    let file = File::open(path).map_err(|error| FormatError::io(path, &error))?;
    let mut decoder = png::Decoder::new_with_limits(BufReader::new(file), png::Limits { bytes: PICTURE_BYTES });
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(wrong)?;
    let too_large = || FormatError::new(path, "a picture that is too large", "use pictures of at most 1 GiB");
    let size = reader.output_buffer_size().filter(|&size| size <= PICTURE_BYTES).ok_or_else(too_large)?;
    let mut bytes = vec![0; size];
    let info = reader.next_frame(&mut bytes).map_err(wrong)?;
    bytes.truncate(info.buffer_size());
    let deep = info.bit_depth == png::BitDepth::Sixteen;
    let stored: Vec<f32> = if deep {
        bytes.as_chunks::<2>().0.iter().map(|value| f32::from(u16::from_be_bytes(*value))).collect()
    } else {
        bytes.iter().map(|&value| f32::from(value)).collect()
    };
    let samples = info.color_type.samples();
    // Transparency is no light.
    let channels = if samples >= 3 { 3 } else { 1 };
    let values = if samples == channels { stored } else { stored.chunks_exact(samples).flat_map(|pixel| pixel[..channels].to_vec()).collect() };
    Ok(((info.width, info.height, channels as u32, if deep { 16 } else { 8 }), values))
}
