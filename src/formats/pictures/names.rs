//! Which files of a folder are frames, in natural order: `frame2.png` before `frame10.png`.
//!
//! Hidden files, thumbnails and folders are left out. A name that is not UTF-8 is kept as it is.

use crate::error::FormatError;
use std::cmp::Ordering;
use std::path::{Path, PathBuf};

/// The pictures of a folder, in natural order of their names.
///
/// # Errors
/// When the folder cannot be listed.
pub fn pictures(folder: &Path) -> Result<Vec<PathBuf>, FormatError> {
    let io = |error: std::io::Error| FormatError::io(folder, &error);
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        if is_picture(&path.file_name().unwrap_or_default().to_string_lossy()) && path.is_file() {
            found.push(path);
        }
    }
    sort(&mut found);
    Ok(found)
}

/// Puts files in natural order of their names.
pub fn sort(files: &mut [PathBuf]) {
    let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    files.sort_by(|a, b| natural(&name(a), &name(b)).then_with(|| a.cmp(b)));
}

/// Does a name look like that of a frame?
pub(crate) fn is_picture(name: &str) -> bool {
    let lower = name.to_lowercase();
    let Some((stem, extension)) = lower.rsplit_once('.') else { return false };
    let is_thumbnail = stem.starts_with("thumb") || stem.ends_with("thumb") || stem.ends_with("thumbnail");
    !lower.starts_with('.') && !is_thumbnail && matches!(extension, "png" | "tif" | "tiff" | "jpg" | "jpeg")
}

/// Compares names with numbers by value: digits as a number, everything else as text.
pub(crate) fn natural(a: &str, b: &str) -> Ordering {
    let (mut a, mut b) = (a.as_bytes(), b.as_bytes());
    loop {
        match (a.first(), b.first()) {
            (None, None) => return Ordering::Equal,
            (None, _) => return Ordering::Less,
            (_, None) => return Ordering::Greater,
            (Some(x), Some(y)) if x.is_ascii_digit() && y.is_ascii_digit() => {
                let (first, second) = (digits(&mut a), digits(&mut b));
                let order = first.len().cmp(&second.len()).then_with(|| first.cmp(second));
                if order != Ordering::Equal {
                    return order;
                }
            }
            (Some(x), Some(y)) => {
                if x != y {
                    return x.cmp(y);
                }
                (a, b) = (&a[1..], &b[1..]);
            }
        }
    }
}

/// Takes the digits at the front, without zeros before them.
fn digits<'a>(text: &mut &'a [u8]) -> &'a [u8] {
    let end = text.iter().position(|byte| !byte.is_ascii_digit()).unwrap_or(text.len());
    let (number, rest) = text.split_at(end);
    *text = rest;
    let zeros = number.iter().position(|byte| *byte != b'0').unwrap_or(number.len());
    &number[zeros..]
}
