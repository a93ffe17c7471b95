//! A folder of pictures as a film: one picture a frame, sorted by name as people count (`f2` before `f10`).

use super::{Curve, Film, Transfer, refused, short_name, still};
use photocurrent_core::{Extent, NodeError, Rows};
use photocurrent_formats::pictures::names;
use std::path::{Path, PathBuf};

/// The pictures of a folder in the natural order of their names. Hidden files, thumbnails and other endings
/// are left out.
///
/// # Errors
/// When the folder cannot be listed or has no such picture.
pub fn pictures(folder: &Path) -> Result<Vec<PathBuf>, NodeError> {
    let paths = names::pictures(folder).map_err(refused)?;
    if paths.is_empty() {
        return Err(NodeError::input(format!(
            "there is no PNG, TIFF or JPEG picture in {}",
            folder.display()
        ))
        .hint(
            "a film is a folder of pictures such as `*.png`, one a frame, or a Y4M file; such as \
                   `ffmpeg -i film.mp4 frames/%06d.png`",
        )
        .param("path"));
    }
    Ok(paths)
}

/// Pictures of one size, one a frame.
pub struct Pictures {
    paths: Vec<PathBuf>,
    extent: Extent,
    curve: Curve,
}

impl Pictures {
    /// Looks at every header.
    ///
    /// # Errors
    /// When a picture cannot be read, or has another size than the first: the file is named.
    pub fn open(paths: Vec<PathBuf>, transfer: Transfer) -> Result<Pictures, NodeError> {
        let first = paths.first().ok_or_else(|| NodeError::input("a film without pictures"))?;
        let extent = still::extent(first)?;
        for path in &paths[1..] {
            let other = still::extent(path)?;
            if other != extent {
                return Err(NodeError::input(format!(
                    "{} has {other} pixels, and {} has {extent}",
                    short_name(path),
                    short_name(first)
                ))
                .hint("every picture of a film has the same size; move other pictures elsewhere")
                .param("path"));
            }
        }
        Ok(Pictures { paths, extent, curve: Curve::new(transfer) })
    }
}

impl Pictures {
    /// What they show behind a filter of red (0), green (1) or blue (2), as a film.
    pub fn channel(&self, channel: usize) -> Channel<'_> {
        Channel { pictures: self, channel }
    }
}

/// One colour of pictures.
pub struct Channel<'a> {
    pictures: &'a Pictures,
    channel: usize,
}

impl Film for Channel<'_> {
    fn extent(&self) -> Extent {
        self.pictures.extent
    }

    fn frames(&self) -> usize {
        self.pictures.paths.len()
    }

    fn read(&self, frame: usize, rows: Rows, each: &mut dyn FnMut(&[f64])) -> Result<(), NodeError> {
        let mut plane = Vec::new();
        still::read_colour(&self.pictures.paths[frame], &self.pictures.curve, rows, &mut |light| {
            plane.clear();
            plane.extend(light.iter().skip(self.channel).step_by(3));
            each(&plane);
        })
    }
}

impl Film for Pictures {
    fn extent(&self) -> Extent {
        self.extent
    }

    fn frames(&self) -> usize {
        self.paths.len()
    }

    fn read(&self, frame: usize, rows: Rows, each: &mut dyn FnMut(&[f64])) -> Result<(), NodeError> {
        still::read(&self.paths[frame], &self.curve, rows, each)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_picture_is_left_out() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["b11.PNG", "b9.png", "b10.tif", ".hidden.png", "thumb.png", "notes.txt", "png"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let names: Vec<String> =
            pictures(folder.path()).unwrap().iter().map(|path| short_name(path)).collect();
        assert_eq!(names, ["b9.png", "b10.tif", "b11.PNG"]);
    }
}
