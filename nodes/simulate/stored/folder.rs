//! A folder of PNG pictures as a film: one picture a frame, sorted by name as people count (`f2` before `f10`).

use super::{Curve, Film, Transfer, cannot_read, short_name, still};
use photocurrent_core::{Extent, NodeError, Rows};
use std::cmp::Ordering;
use std::path::{Path, PathBuf};

/// The PNG pictures of a folder in the natural order of their names. Hidden files and other endings are left out.
///
/// # Errors
/// When the folder cannot be listed or has no such picture.
pub fn pictures(folder: &Path) -> Result<Vec<PathBuf>, NodeError> {
    let entries = std::fs::read_dir(folder).and_then(Iterator::collect::<Result<Vec<_>, _>>).map_err(|error| cannot_read(folder, &error))?;
    let is_picture = |path: &PathBuf| {
        let shown = !short_name(path).starts_with('.');
        shown && path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"))
    };
    let mut paths: Vec<PathBuf> = entries.into_iter().map(|entry| entry.path()).filter(is_picture).collect();
    if paths.is_empty() {
        return Err(NodeError::input(format!("there is no PNG picture in {}", folder.display()))
            .hint("a film is a folder of `*.png`, one picture a frame, or a Y4M file; such as `ffmpeg -i film.mp4 frames/%06d.png`")
            .param("path"));
    }
    paths.sort_by(|a, b| by_number(&short_name(a), &short_name(b)));
    Ok(paths)
}

/// Names compared as people count: runs of digits by their number, everything else by letter; equal ones by letter throughout.
pub(crate) fn by_number(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a, b);
    while let (Some(l), Some(r)) = (left.chars().next(), right.chars().next()) {
        let order = if l.is_ascii_digit() && r.is_ascii_digit() {
            let (l, r) = (take_digits(&mut left), take_digits(&mut right));
            l.len().cmp(&r.len()).then(l.cmp(r))
        } else {
            left = &left[l.len_utf8()..];
            right = &right[r.len_utf8()..];
            l.cmp(&r)
        };
        if order != Ordering::Equal {
            return order;
        }
    }
    left.len().cmp(&right.len()).then_with(|| a.cmp(b))
}

/// Takes the digits that a text begins with, and gives them without leading zeros.
fn take_digits<'a>(text: &mut &'a str) -> &'a str {
    let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (digits, rest) = text.split_at(end);
    *text = rest;
    digits.trim_start_matches('0')
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
                return Err(NodeError::input(format!("{} has {other} pixels, and {} has {extent}", short_name(path), short_name(first)))
                    .hint("every picture of a film has the same size; move other pictures elsewhere")
                    .param("path"));
            }
        }
        Ok(Pictures { paths, extent, curve: Curve::new(transfer) })
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
    fn names_are_sorted_as_people_count() {
        let mut names = ["f10.png", "f2.png", "f2b.png", "F1.png", "f02.png", "f0010.png", "f.png", "f2.10.png", "f2.9.png"];
        names.sort_by(|a, b| by_number(a, b));
        assert_eq!(names, ["F1.png", "f.png", "f2.9.png", "f2.10.png", "f02.png", "f2.png", "f2b.png", "f0010.png", "f10.png"]);
    }

    #[test]
    fn what_is_no_picture_is_left_out() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["b11.PNG", "b9.png", ".hidden.png", "notes.txt", "png"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let names: Vec<String> = pictures(folder.path()).unwrap().iter().map(|path| short_name(path)).collect();
        assert_eq!(names, ["b9.png", "b11.PNG"]);
    }
}
