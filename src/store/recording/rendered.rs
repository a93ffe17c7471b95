//! Frames in one HDF5 file for other programs, `photocurrent-frames/1`: ten thousand of them are easier to
//! move and to slice than as many pictures.
//!
//! `/frames/dn` is \[frame, row, column\] (with channels last), in chunks of a few frames and rows, so that a
//! frame and a pixel over time are both cheap to read. DN are 32-bit floating point, or 16-bit codes with the
//! attributes `scale_factor` and `add_offset` of the CF conventions, which xarray and netCDF4 undo by
//! themselves.

use super::whole::{DnCode, whole_file, write_colour, write_numbers, write_times};
use crate::error::StoreError;
use crate::layout::create_group;
use photocurrent_core::FrameSequence;
use std::path::Path;

/// The format, as the attribute `format` says it.
const FORMAT: &str = "photocurrent-frames/1";

/// Writes frames of a whole sensor, replacing what is there only when all is written and synced.
///
/// `exposure_dn_of_ns` is the exposure that DN stand for. Without `code`, DN are stored as 32-bit floating
/// point, NaN included.
///
/// # Errors
/// When frames cannot be read, lack rows, or the file cannot be written.
pub fn write_rendered(
    path: &Path,
    frames: &FrameSequence,
    exposure_dn_of_ns: i64,
    code: Option<DnCode>,
) -> Result<(), StoreError> {
    let meta = &frames.meta;
    if frames.rows() != meta.extent.rows() {
        return Err(StoreError::Misuse {
            path: path.into(),
            what: format!("the frames cover {} of {} pixels", frames.rows(), meta.extent),
        });
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
        write_times(
            opened,
            "frames/exposure_start",
            exposures.iter().map(|exposure| exposure.start.0).collect(),
        )?;
        write_times(opened, "frames/exposure_end", exposures.iter().map(|exposure| exposure.end.0).collect())
    })
}
