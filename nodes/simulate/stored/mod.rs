//! Stored pictures as linear light: folders of pictures and Y4M films, which
//! [`photocurrent_formats::pictures`] reads, row by row.
//!
//! A stored value becomes relative light, 0 for none and 1 for full white, by a transfer curve ([`Curve`]);
//! colour becomes grey as its luminance, summed after the curve. A [`Film`] gives rows of one frame at a
//! time; a [`Window`] crops them and averages squares of pixels, in linear light.
//!
//! Limits: colours are those of BT.709 and sRGB (they share their primaries); colour profiles and gamma
//! chunks in files are not read.

pub mod folder;
pub mod still;
pub mod y4m;

use crate::crop::Crop;
use photocurrent_core::{Extent, NodeError, Rows};
use photocurrent_formats::FormatError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::path::Path;
use std::sync::OnceLock;

/// How a stored value becomes linear light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Transfer {
    /// Stored values are proportional to light, as machine-vision cameras write them.
    Linear,
    /// The sRGB curve (IEC 61966-2-1), of photos and screens.
    Srgb,
    /// The camera curve of BT.709, of films.
    Bt709,
}

impl Transfer {
    /// Relative light of a stored value, 0 to 1; above 1 the curve goes on, below 0 is 0.
    ///
    /// ```
    /// # use photocurrent_nodes::simulate::stored::Transfer;
    /// assert_eq!([0.0, 0.5, 1.0].map(|v| Transfer::Linear.light(v)), [0.0, 0.5, 1.0]);
    /// assert!((Transfer::Srgb.light(0.5) - 0.214_041).abs() < 1e-6);
    /// ```
    pub fn light(self, stored: f64) -> f64 {
        let stored = stored.max(0.0);
        match self {
            Transfer::Linear => stored,
            Transfer::Srgb => photocurrent_formats::Transfer::Srgb.linear(stored),
            Transfer::Bt709 if stored < 0.081 => stored / 4.5,
            Transfer::Bt709 => libm::pow((stored + 0.099) / 1.099, 1.0 / 0.45),
        }
    }
}

/// A transfer curve with its tables for whole numbers of 8 and 16 bits.
pub struct Curve {
    transfer: Transfer,
    eight: Vec<f64>,
    sixteen: OnceLock<Vec<f64>>,
}

impl Curve {
    /// Of a transfer.
    pub fn new(transfer: Transfer) -> Curve {
        Curve { transfer, eight: table(transfer, 255), sixteen: OnceLock::new() }
    }

    /// Light of every value of so many bits: 8, or 16.
    fn of(&self, bits: u32) -> &[f64] {
        if bits > 8 { self.sixteen.get_or_init(|| table(self.transfer, 65535)) } else { &self.eight }
    }
}

fn table(transfer: Transfer, most: u32) -> Vec<f64> {
    (0..=most).map(|value| transfer.light(f64::from(value) / f64::from(most))).collect()
}

/// Pictures of one size in order of time, read by rows.
pub trait Film: Send + Sync {
    /// Size of every picture.
    fn extent(&self) -> Extent;

    /// Number of pictures.
    fn frames(&self) -> usize;

    /// Calls `each` with the relative light of the given rows of one frame, from top to bottom.
    ///
    /// # Errors
    /// When the file cannot be read or is damaged.
    fn read(&self, frame: usize, rows: Rows, each: &mut dyn FnMut(&[f64])) -> Result<(), NodeError>;
}

/// What is taken of every picture: a part, with squares of pixels averaged to one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    crop: Crop,
    factor: u32,
}

impl Window {
    /// Of pictures of `stored` size: `crop` (default: everything), shrunk to `width` x `height` (default:
    /// not) by one whole factor.
    ///
    /// # Errors
    /// When the crop lies outside, or no whole factor leads to the size.
    pub fn new(
        stored: Extent,
        crop: Option<Crop>,
        width: Option<u32>,
        height: Option<u32>,
    ) -> Result<Window, NodeError> {
        let crop = crop.unwrap_or(Crop::whole(stored));
        crop.check("crop", "pictures", stored)?;
        let factor =
            width.map(|width| crop.width / width).or(height.map(|height| crop.height / height)).unwrap_or(1);
        let shrunk = |length: u32, asked: Option<u32>| {
            factor > 0 && length.is_multiple_of(factor) && asked.is_none_or(|asked| asked * factor == length)
        };
        if !shrunk(crop.width, width) || !shrunk(crop.height, height) {
            let (asked, param) = match (width, height) {
                (Some(width), Some(height)) => (format!("{width} x {height}"), "width"),
                (Some(width), None) => (format!("a width of {width}"), "width"),
                (None, height) => (format!("a height of {}", height.unwrap_or(crop.height)), "height"),
            };
            let message = format!(
                "{} x {} pixels do not shrink to {asked} by one whole factor",
                crop.width, crop.height
            );
            return Err(NodeError::usage(message).hint(possible(crop)).param(param));
        }
        Ok(Window { crop, factor })
    }

    /// Of pictures of `stored` size: everything but what is left over at the right and the bottom, with
    /// squares of `factor` x `factor` averaged.
    ///
    /// # Errors
    /// When there is no whole square.
    pub fn by_factor(stored: Extent, factor: u32) -> Result<Window, NodeError> {
        let (width, height) = (stored.width / factor * factor, stored.height / factor * factor);
        if width == 0 || height == 0 {
            return Err(NodeError::usage(format!(
                "{stored} pixels are less than one square of {factor} x {factor}"
            ))
            .hint("take a smaller `shrink`")
            .param("shrink"));
        }
        Ok(Window { crop: Crop { x: 0, y: 0, width, height }, factor })
    }

    /// Size of what comes out.
    pub fn extent(&self) -> Extent {
        Extent { width: self.crop.width / self.factor, height: self.crop.height / self.factor }
    }

    /// Relative light of some rows of one frame, row after row: the mean over each square.
    ///
    /// # Errors
    /// As [`Film::read`].
    pub fn read(&self, film: &dyn Film, frame: usize, rows: Rows) -> Result<Vec<f64>, NodeError> {
        let (factor, width) = (self.factor as usize, self.extent().width as usize);
        let mut light = vec![0.0; rows.len() * width];
        let stored =
            Rows { start: self.crop.y + rows.start * self.factor, end: self.crop.y + rows.end * self.factor };
        let columns = self.crop.x as usize..(self.crop.x + self.crop.width) as usize;
        let mut at = 0;
        film.read(frame, stored, &mut |row| {
            let sums = &mut light[at / factor * width..][..width];
            for (sum, square) in sums.iter_mut().zip(row[columns.clone()].chunks_exact(factor)) {
                *sum += square.iter().sum::<f64>();
            }
            at += 1;
        })?;
        let share = f64::from(self.factor * self.factor);
        light.iter_mut().for_each(|light| *light /= share);
        Ok(light)
    }
}

/// The sizes to which a part shrinks by a whole factor.
fn possible(crop: Crop) -> String {
    let factors = (2..=crop.width.min(crop.height))
        .filter(|factor| crop.width.is_multiple_of(*factor) && crop.height.is_multiple_of(*factor));
    let sizes: Vec<String> =
        factors.take(4).map(|factor| format!("{} x {}", crop.width / factor, crop.height / factor)).collect();
    match sizes.is_empty() {
        true => "name a `crop` whose width and height have a common factor".into(),
        false => format!("it shrinks to {}; for others, name a `crop` first", sizes.join(", ")),
    }
}

/// The file's name without its folder: what messages call it.
pub fn short_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// A file that could not be read, in the reader's terms.
pub fn cannot_read(path: &Path, error: &std::io::Error) -> NodeError {
    NodeError::files(photocurrent_core::error::cannot_read(path, error))
        .hint("paths are relative to the manifest that names them")
        .param("path")
}

/// A picture or film that was refused, by its short name. One that cannot be opened is trouble with files,
/// anything else with what they hold.
pub fn refused(error: FormatError) -> NodeError {
    match File::open(&error.path) {
        Err(trouble) => cannot_read(&error.path, &trouble),
        Ok(_) => FormatError { path: short_name(&error.path).into(), ..error }.into(),
    }
}

#[cfg(test)]
#[path = "tests.rs"]
pub(super) mod tests;
