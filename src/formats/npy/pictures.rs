//! Frames in one npy array: n x height x width, or with one or three channels at the end.

use super::header::{Element, Kind, Number, Scalar, each};
use super::place::Place;
use crate::declared::Declared;
use crate::error::{Cause, FormatError, Loss};
use crate::pictures::pairing::of_array;
use crate::recording::{FrameStamp, FramesAbout, Pictures};
use photocurrent_core::{Colour, Extent};
use std::io::Read;
use std::path::Path;

/// Frames of an npy file.
pub(crate) struct NpyPictures {
    place: Place,
    start: u64,
    scalar: Scalar,
    /// Bytes of a frame.
    bytes: usize,
    about: FramesAbout,
    /// Of each frame its number in the array.
    rows: Vec<usize>,
}

impl NpyPictures {
    /// Opens the array; the stamps are those of its frames, in order. Where these are others in number they
    /// are paired as `declared` states, or by gaps between them.
    pub(crate) fn open(
        path: &Path,
        stamps: &[i64],
        declared: &Declared,
    ) -> Result<(NpyPictures, Vec<Loss>), FormatError> {
        let place = Place { path: path.into(), member: None };
        let header = place.header()?;
        let wrong = |expected: &str| {
            FormatError::new(
                path,
                format!("an array of shape {:?}", header.shape),
                "save frames as one array of n x height x width",
            )
            .expected(expected.to_string())
        };
        let (&frames, &height, &width, channels) = match header.shape.as_slice() {
            [frames, height, width] => (frames, height, width, 1),
            [frames, height, width, channels @ (1 | 3)] => (frames, height, width, *channels),
            _ => return Err(wrong("frames of one or three channels")),
        };
        let Element::Number(scalar) = header.element else { return Err(wrong("numbers")) };
        let side = |side: u64| u32::try_from(side).ok().filter(|side| (1..=1 << 16).contains(side));
        let (Some(width), Some(height)) = (side(width), side(height)) else {
            return Err(wrong("frames of 1 to 65,536 pixels a side"));
        };
        if header.fortran {
            return Err(wrong("the order of C (frames one after another)"));
        }
        let bytes = u64::from(width) * u64::from(height) * channels * scalar.bytes as u64;
        let room = place.bytes()?.saturating_sub(header.start) / bytes;
        let mut losses = Vec::new();
        if frames > room {
            losses.push(
                Loss::new(
                    place.name(),
                    format!("its header claims {frames} frames and {room} are there; the rest is lost"),
                )
                .by(Cause::Cut),
            );
        }
        let whole = usize::try_from(frames.min(room)).unwrap_or(usize::MAX);
        // Those that are cut off count as they were written; a header may claim any number.
        let claimed = usize::try_from(frames).unwrap_or(usize::MAX);
        let claimed = if claimed == stamps.len() { claimed } else { whole.max(claimed.min(stamps.len())) };
        let (mut pairs, note) = of_array(path, claimed, stamps, declared)?;
        pairs.retain(|(frame, _)| *frame < whole);
        let notes = note.into_iter().collect();
        let (rows, stamps) = pairs
            .iter()
            .map(|&(frame, stamp)| (frame, FrameStamp { at: stamps[stamp], exposure: None }))
            .unzip();
        let about = FramesAbout {
            extent: Extent { width, height },
            colour: if channels == 3 { Colour::Rgb } else { Colour::Mono },
            bits: if scalar.kind == Kind::Float { 32 } else { 8 * scalar.bytes as u32 },
            stamps,
            stamp_role: None,
            row_time_ns: None,
            transfer: None,
            notes,
        };
        let bytes = usize::try_from(bytes).map_err(|_| wrong("smaller frames"))?;
        Ok((NpyPictures { place, start: header.start, scalar, bytes, about, rows }, losses))
    }
}

impl Pictures for NpyPictures {
    fn about(&self) -> &FramesAbout {
        &self.about
    }

    fn read(&self, frame: usize, values: &mut Vec<f32>) -> Result<(), FormatError> {
        values.clear();
        let Some(&row) = self.rows.get(frame) else {
            return Err(FormatError::new(
                &self.place.path,
                format!("there is no frame {frame}"),
                "ask for one of the frames that have a stamp",
            ));
        };
        let mut stored = vec![0; self.bytes];
        let mut bytes = self.place.open(self.start + row as u64 * self.bytes as u64)?;
        bytes
            .read_exact(&mut stored)
            .map_err(|error| FormatError::io(&self.place.path, &error).at(format!("frame {frame}")))?;
        values.reserve(self.bytes / self.scalar.bytes);
        each(self.scalar, &stored, self.scalar.bytes, 0, |number| {
            values.push(match number {
                Number::Whole(value) => value as f32,
                Number::Beyond => f32::INFINITY,
                Number::Fraction(value) => value as f32,
            });
        });
        Ok(())
    }
}
