//! A Y4M film as light: [`photocurrent_formats::pictures::y4m`] reads it, each channel becomes light by the
//! transfer curve, and their sum is luminance.
//!
//! A pixel without colour is exactly its luma. Black and white are 16 and 235 (of 8 bits), of grey too,
//! unless the header says `XCOLORRANGE=FULL`: then 0 and 255.
//!
//! Limits: progressive and whole films only, no alpha.

use super::{Film, Transfer, refused, short_name};
use photocurrent_core::colour::luminance;
use photocurrent_core::{Extent, NodeError, Rows};
use photocurrent_formats::pictures::y4m;
use photocurrent_formats::ycbcr::{Levels, MATRIX, Range};
use std::path::Path;

/// A film, with what its numbers stand for.
pub struct Y4m {
    file: y4m::Y4m,
    levels: Levels,
    transfer: Transfer,
    /// Light of every luma value of a pixel without colour.
    grey: Vec<f64>,
    notes: Vec<String>,
}

impl Y4m {
    /// Reads the header and walks over all frames by their lengths. `range` wins over the header's word.
    ///
    /// # Errors
    /// When the file cannot be read, is cut off, or has frames of a form that is not read.
    pub fn open(path: &Path, transfer: Transfer, range: Option<Range>) -> Result<Y4m, NodeError> {
        let file = y4m::Y4m::open(path).map_err(refused)?;
        let name = short_name(path);
        if let Some(word) = file.interlaced() {
            return Err(NodeError::input(format!(
                "the header of {name} says that its frames are interlaced (`{word}`)"
            ))
            .hint(
                "make it progressive first, such as `ffmpeg -i in.y4m -vf yadif out.y4m`: half a \
                       frame is no picture of one instant",
            )
            .param("path"));
        }
        if file.has_alpha() {
            return Err(NodeError::input(format!("{name} has transparency, and light has none"))
                .hint("write it without alpha, such as `ffmpeg -i in.y4m -pix_fmt yuv444p out.y4m`")
                .param("path"));
        }
        file.whole().map_err(refused)?;
        let stated = range.or(file.range());
        let silent = stated
            .is_none()
            .then(|| format!("{name} does not state the range of its values; taken as limited (`range`)"));
        let coloured = file.colour().channels() > 1;
        let matrix = coloured
            .then(|| format!("{name} does not state the matrix of its colours; taken as that of {MATRIX}"));
        let levels = Levels::new(stated.unwrap_or(Range::Limited), file.bits());
        let grey = (0..=if file.bits() > 8 { u16::MAX } else { 255 })
            .map(|luma| transfer.light(levels.luma(luma)))
            .collect();
        Ok(Y4m { file, levels, transfer, grey, notes: silent.into_iter().chain(matrix).collect() })
    }

    /// Frames per second; `None` when the header has none.
    pub fn rate(&self) -> Option<f64> {
        self.file.rate().map(|(frames, seconds)| frames as f64 / seconds as f64)
    }

    /// What the header leaves open.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Luminance of a pixel.
    fn light(&self, pixel: [u16; 3]) -> f64 {
        let [luma, blue, red] = pixel;
        if [blue, red] == [self.levels.middle(); 2] {
            return self.grey[usize::from(luma)];
        }
        luminance(self.levels.rgb(pixel).map(|share| self.transfer.light(share)))
    }
}

impl Film for Y4m {
    fn extent(&self) -> Extent {
        self.file.extent()
    }

    fn frames(&self) -> usize {
        self.file.frames()
    }

    fn read(&self, frame: usize, rows: Rows, each: &mut dyn FnMut(&[f64])) -> Result<(), NodeError> {
        let mut light = Vec::new();
        let read = self.file.rows(frame, rows, &mut |row| {
            light.clear();
            light.extend(row.iter().map(|pixel| self.light(*pixel)));
            each(&light);
        });
        read.map_err(refused)
    }
}
