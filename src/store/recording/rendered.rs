//! Frames in one HDF5 file for other programs, `photocurrent-frames/1`: ten thousand of them are easier to move and to slice than as many pictures.
//!
//! `/frames/dn` is \[frame, row, column\] (with channels last), in chunks of a few frames and rows, so that a frame and a pixel over time are both cheap to
//! read. DN are 32-bit floating point, or 16-bit codes with the attributes `scale_factor` and `add_offset` of the CF conventions, which xarray and
//! netCDF4 undo by themselves.

use super::write::{whole_file, write_colour, write_times};
use crate::error::StoreError;
use crate::hdf::{Item, Opened};
use crate::layout::{StripWriter, create_group};
use photocurrent_core::{FrameSequence, FramesMeta};
use std::path::Path;

/// The format, as the attribute `format` says it.
const FORMAT: &str = "photocurrent-frames/1";

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

    /// The code of a value, and whether the value lies outside of what codes can say. What is not known (NaN) is code 0.
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

/// Writes frames of a whole sensor, replacing what is there only when all is written and synced.
///
/// `exposure_dn_of_ns` is the exposure that DN stand for. Without `code`, DN are stored as 32-bit floating point, NaN included.
///
/// # Errors
/// When frames cannot be read, lack rows, or the file cannot be written.
pub fn write_rendered(path: &Path, frames: &FrameSequence, exposure_dn_of_ns: i64, code: Option<DnCode>) -> Result<(), StoreError> {
    let meta = &frames.meta;
    if frames.rows() != meta.extent.rows() {
        return Err(StoreError::Misuse { path: path.into(), what: format!("the frames cover {} of {} pixels", frames.rows(), meta.extent) });
    }
    whole_file(path, |opened| {
        opened.set_text_attribute(&opened.file, "format", FORMAT)?;
        let group = create_group(opened, "frames")?;
        opened.set_integer_attribute(&group, "row_time_ns", meta.times.row_time_ns)?;
        opened.set_integer_attribute(&group, "exposure_dn_of_ns", exposure_dn_of_ns)?;
        write_colour(opened, &group, meta.colour)?;
        match code {
            None => write_numbers::<f32>(opened, "frames/dn", frames, None, |dn| dn)?,
            Some(code) => write_numbers::<u16>(opened, "frames/dn", frames, Some(code), |dn| code.of(dn).0)?,
        }
        let exposures = &meta.times.exposures;
        write_times(opened, "frames/exposure_start", exposures.iter().map(|exposure| exposure.start.0).collect())?;
        write_times(opened, "frames/exposure_end", exposures.iter().map(|exposure| exposure.end.0).collect())
    })
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
    let mut writer = StripWriter::create::<T>(opened, name, frames.len(), frames.meta.extent.height as usize, &tail(&frames.meta))?;
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
