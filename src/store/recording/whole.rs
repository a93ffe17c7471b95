//! Files that appear whole or not at all, and what recordings and rendered frames both contain.

use crate::error::StoreError;
use crate::hdf::write::ColumnWriter;
use crate::hdf::{Item, Opened};
use crate::layout::{StripWriter, close};
use photocurrent_core::{Colour, FrameSequence, FramesMeta};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

/// How DN become 16-bit codes: `dn = offset + scale * code`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DnCode {
    /// DN of code 0.
    pub offset: f64,
    /// DN per code, positive.
    pub scale: f64,
}

impl DnCode {
    /// The highest code.
    pub const WHITE: f64 = u16::MAX as f64;

    /// The code of a value, and whether the value lies outside of what codes can say. What is not known (NaN)
    /// is code 0.
    ///
    /// ```
    /// # use photocurrent_store::DnCode;
    /// let code = DnCode { offset: 10.0, scale: 0.5 };
    /// assert_eq!((code.of(12.2), code.of(9.0)), ((4, false), (0, true)));
    /// ```
    pub fn of(self, dn: f32) -> (u16, bool) {
        let code = ((f64::from(dn) - self.offset) / self.scale).round();
        (code.clamp(0.0, Self::WHITE) as u16, !(0.0..=Self::WHITE).contains(&code))
    }
}

/// A file in a folder that has not got its name yet. Temporary files are private by default, and what becomes
/// of this one is not: the umask still applies.
///
/// # Errors
/// When the folder takes no file.
pub fn unnamed_in(folder: &Path) -> std::io::Result<tempfile::NamedTempFile> {
    tempfile::Builder::new()
        .prefix(".")
        .suffix(".part")
        .permissions(std::fs::Permissions::from_mode(0o666))
        .tempfile_in(folder)
}

/// Lets `fill` write a new file next to `path`, and moves it there when it is complete and synced.
pub(crate) fn whole_file<T>(
    path: &Path,
    fill: impl FnOnce(&Opened) -> Result<T, StoreError>,
) -> Result<T, StoreError> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let temporary =
        unnamed_in(folder).map_err(|error| StoreError::io(folder, "create a file in the folder", error))?;
    let opened = Opened::create(temporary.path())?;
    let filled = fill(&opened)?;
    close(opened)?;
    temporary.as_file().sync_all().map_err(|error| StoreError::io(path, "sync the file", error))?;
    temporary
        .persist(path)
        .map_err(|error| StoreError::io(path, "move the file to its place", error.error))?;
    std::fs::File::open(folder)
        .and_then(|folder| folder.sync_all())
        .map_err(|error| StoreError::io(folder, "sync the folder", error))?;
    Ok(filled)
}

pub(crate) fn write_times(opened: &Opened, name: &str, times: Vec<i64>) -> Result<(), StoreError> {
    let mut column = ColumnWriter::new(opened, name);
    column.append(&times)?;
    opened.set_text_attribute(column.finish()?.dataset(), "unit", "ns")
}

/// Grey has no attribute.
pub(crate) fn write_colour(opened: &Opened, group: &hdf5::Group, colour: Colour) -> Result<(), StoreError> {
    if colour == Colour::Mono { Ok(()) } else { opened.set_text_attribute(group, "colour", colour.name()) }
}

/// The dimensions of frames after their rows; grey frames have no channels.
fn tail(meta: &FramesMeta) -> Vec<usize> {
    let channels = Some(meta.channels() as usize).filter(|&channels| channels > 1);
    std::iter::once(meta.extent.width as usize).chain(channels).collect()
}

/// A dataset \[frame, row, column\] or \[frame, row, column, channel\], a few rows of all frames at a time.
pub(super) fn write_numbers<T: Item>(
    opened: &Opened,
    name: &str,
    frames: &FrameSequence,
    code: Option<DnCode>,
    convert: impl Fn(f32) -> T + Sync,
) -> Result<(), StoreError> {
    let mut writer = StripWriter::create::<T>(
        opened,
        name,
        frames.len(),
        frames.meta.extent.height as usize,
        &tail(&frames.meta),
    )?;
    if let Some(DnCode { offset, scale }) = code {
        opened.set_number_attribute(writer.dataset(), "scale_factor", scale)?;
        opened.set_number_attribute(writer.dataset(), "add_offset", offset)?;
    }
    for rows in frames.rows().bands(writer.rows_at_once()) {
        let block = frames.read_rows(rows).map_err(StoreError::Source)?;
        writer.append(&block, &convert)?;
    }
    Ok(())
}
