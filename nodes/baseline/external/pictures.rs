//! A folder of pictures that another program wrote, as digital numbers.

use super::npy::Npy;
use crate::reconstruct::black_level;
use crate::simulate::stored::still::{self, luminance};
use crate::simulate::stored::{Curve, Transfer, cannot_read, short_name};
use photocurrent_core::{Colour, Context, Extent, FrameBlock, FramesMeta, NodeError, Sensor};
use photocurrent_formats::pictures::names;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// What stored values stand for.
#[derive(Clone, Copy, Debug)]
pub struct Levels {
    black: f64,
    white: f64,
    stored_white: Option<f64>,
    transfer: Transfer,
}

impl Levels {
    /// Black from the description; white as stated, else the description's saturation.
    ///
    /// # Errors
    /// When white is not known, or not above black.
    pub fn new(
        white: Option<f64>,
        stored_white: Option<f64>,
        transfer: Transfer,
        sensor: Option<&Sensor>,
    ) -> Result<Levels, NodeError> {
        let black = black_level(sensor);
        match white.or_else(|| sensor.and_then(|sensor| sensor.frames.saturation_dn)) {
            Some(white) if white > black => Ok(Levels { black, white, stored_white, transfer }),
            Some(white) => {
                Err(NodeError::usage(format!("white, {white} DN, is not above black, {black} DN"))
                    .param("white"))
            }
            None => Err(NodeError::usage("which DN the pictures' white stands for is not known")
                .hint("state `white`, or connect a sensor description with `frames.saturation_dn`")
                .param("white")),
        }
    }

    /// Frames of `meta`, one picture each, side by side: of three channels, or grey, where colours count as
    /// their luminance.
    ///
    /// # Errors
    /// When a picture cannot be read or has another size, or the user interrupts.
    pub fn frames(&self, cx: &Context, meta: &FramesMeta, paths: &[&Path]) -> Result<FrameBlock, NodeError> {
        let rows = meta.extent.rows();
        let curve = Curve::new(self.transfer);
        let mut block = FrameBlock::zeros(0..paths.len(), rows, meta.row_values());
        let is_colour = meta.colour == Colour::Rgb;
        block
            .dn
            .par_chunks_exact_mut(meta.extent.height as usize * meta.row_values())
            .zip(paths)
            .try_for_each(|(dn, path)| -> Result<(), NodeError> {
                let size = extent(path)?;
                if size != meta.extent {
                    return Err(NodeError::input(format!(
                        "{} has {size} pixels, and {} are needed",
                        short_name(path),
                        meta.extent
                    ))
                    .hint("every picture has the frames' size")
                    .param("path"));
                }
                let put =
                    |dn: &mut f32, light: f64| *dn = (self.black + light * (self.white - self.black)) as f32;
                let mut next = dn.iter_mut();
                let mut fill =
                    |light: &[f64]| light.iter().zip(&mut next).for_each(|(light, dn)| put(dn, *light));
                match (is_npy(path), is_colour) {
                    (true, true) => fill(&Npy::open(path)?.light(self.stored_white)),
                    (true, false) => {
                        let light = Npy::open(path)?.light(self.stored_white);
                        let grey = light.chunks_exact(3).map(|rgb| luminance([rgb[0], rgb[1], rgb[2]]));
                        fill(&grey.collect::<Vec<f64>>());
                    }
                    (false, true) => still::read_colour(path, &curve, rows, &mut fill)?,
                    (false, false) => still::read(path, &curve, rows, &mut fill)?,
                }
                cx.advance(1)
            })?;
        Ok(block)
    }
}

fn is_npy(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("npy"))
}

/// Size of a picture.
///
/// # Errors
/// When it cannot be read, or is no picture.
pub fn extent(path: &Path) -> Result<Extent, NodeError> {
    if is_npy(path) { Ok(Npy::open(path)?.extent) } else { still::extent(path) }
}

/// The pictures of a folder, of one kind, sorted by name as people count.
///
/// # Errors
/// When the folder cannot be listed, or has no picture or two kinds.
pub fn pictures(folder: &Path) -> Result<Vec<PathBuf>, NodeError> {
    let entries = std::fs::read_dir(folder)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .map_err(|error| cannot_read(folder, &error))?;
    let is_png =
        |path: &Path| path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"));
    let (mut npy, mut png) = (Vec::new(), Vec::new());
    for path in
        entries.into_iter().map(|entry| entry.path()).filter(|path| !short_name(path).starts_with('.'))
    {
        if is_npy(&path) {
            npy.push(path);
        } else if is_png(&path) {
            png.push(path);
        }
    }
    let mut paths = match (npy.is_empty(), png.is_empty()) {
        (true, true) => {
            return Err(NodeError::input(format!("there is no picture in {}", folder.display()))
                .hint("one `*.png` or `*.npy` a frame")
                .param("path"));
        }
        (false, false) => {
            return Err(NodeError::input(format!(
                "{} has {} `*.npy` and {} `*.png`",
                folder.display(),
                npy.len(),
                png.len()
            ))
            .hint("keep pictures of one kind in the folder")
            .param("path"));
        }
        (true, false) => png,
        (false, true) => npy,
    };
    names::sort(&mut paths);
    Ok(paths)
}
