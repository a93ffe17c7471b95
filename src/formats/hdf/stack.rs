//! Frames in HDF5: one dataset [frames, rows, columns] with channels last, or a dataset for each frame.

use super::refused;
use crate::declared::Declared;
use crate::error::{Cause, FormatError, Loss};
use crate::pictures::pairing::of_array;
use crate::recording::{FrameStamp, FramesAbout, Pictures};
use photocurrent_core::{Colour, Extent};
use photocurrent_store::foreign::{Field, ForeignDataset, ForeignFile};
use std::path::{Path, PathBuf};

/// In which order three channels stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Order {
    Rgb,
    Bgr,
}

/// What a frame's shape says: extent and colour; `None` when it is none of [h, w], [h, w, 1], [h, w, 3],
/// [1, h, w].
pub(super) fn shape_of(shape: &[usize]) -> Option<(Extent, Colour)> {
    let (height, width, colour) = match *shape {
        [height, width] | [height, width, 1] => (height, width, Colour::Mono),
        [height, width, 3] => (height, width, Colour::Rgb),
        [1, height, width] => (height, width, Colour::Mono),
        _ => return None,
    };
    super::extent(width as f64, height as f64).map(|extent| (extent, colour))
}

/// Bits of a stored value.
pub(super) fn bits(field: Field) -> u32 {
    if field.number().is_float() { 32 } else { 8 * field.number().bytes() as u32 }
}

/// A description with what a file of this kind leaves open.
pub(super) fn about(extent: Extent, colour: Colour, field: Field, stamps: Vec<FrameStamp>) -> FramesAbout {
    FramesAbout {
        extent,
        colour,
        bits: bits(field),
        stamps,
        stamp_role: None,
        row_time_ns: None,
        transfer: None,
        notes: Vec::new(),
    }
}

/// Frames of one dataset, or of one each.
pub(super) struct Stack {
    path: PathBuf,
    from: From,
    order: Order,
    about: FramesAbout,
    /// Frames of a cut file that are lost.
    pub lost: Option<Loss>,
}

enum From {
    /// Frames of one dataset, by their numbers there.
    Dataset(ForeignDataset, Vec<usize>),
    Each(ForeignFile, Vec<String>),
}

impl Stack {
    /// A dataset whose first dimension counts frames, and their stamps. Where these are others in number they
    /// are paired as `declared` states, or by gaps between them; in order without `declared`, as those of a
    /// file that is cut off. Frames and stamps without a partner are left out with a note.
    ///
    /// # Errors
    /// When the dataset holds no frames, or it stays open which stamp belongs to which.
    pub(super) fn of_dataset(
        path: &Path,
        dataset: ForeignDataset,
        stamps: Vec<FrameStamp>,
        order: Order,
        declared: Option<&Declared>,
    ) -> Result<Stack, FormatError> {
        let wrong = || {
            let expected = "[frames, height, width], with 1 or 3 channels last";
            FormatError::new(
                path,
                format!("the shape {:?}", dataset.shape()),
                "is this the file that you meant?",
            )
            .at(dataset.at())
            .expected(expected)
        };
        let (extent, colour) = dataset.shape().get(1..).and_then(shape_of).ok_or_else(wrong)?;
        let field = dataset.numbers().ok_or_else(wrong)?;
        let (frames, whole, stamped) = (
            dataset.rows(),
            dataset.rows_before_the_cut().map_err(|error| refused(path, error))?,
            stamps.len(),
        );
        let lost = (whole < frames).then(|| {
            Loss::new(
                dataset.at(),
                format!("frames {whole} to {} lie behind the cut; they are lost", frames - 1),
            )
            .by(Cause::Cut)
        });
        let at: Vec<i64> = stamps.iter().map(|stamp| stamp.at).collect();
        let in_order = || ((0..frames.min(stamped)).map(|n| (n, n)).collect(), None);
        let (mut pairs, note) =
            declared.map_or_else(|| Ok(in_order()), |declared| of_array(path, frames, &at, declared))?;
        pairs.retain(|(frame, _)| *frame < whole);
        let mut about = about(extent, colour, field, pairs.iter().map(|(_, stamp)| stamps[*stamp]).collect());
        about.notes.extend(note);
        if declared.is_none() && frames > stamped {
            about.notes.push(format!("{} frames have no stamp and were left out", frames - stamped));
        } else if declared.is_none() && stamped > frames {
            about.notes.push(format!("{} stamps have no frame and were left out", stamped - frames));
        }
        let rows = pairs.into_iter().map(|(frame, _)| frame).collect();
        Ok(Stack { path: path.into(), from: From::Dataset(dataset, rows), order, about, lost })
    }

    /// Datasets by name, one for each stamp of `about`.
    pub(super) fn of_each(file: &ForeignFile, names: Vec<String>, order: Order, about: FramesAbout) -> Stack {
        Stack { path: file.path().into(), from: From::Each(file.clone(), names), order, about, lost: None }
    }

    pub(super) fn about_mut(&mut self) -> &mut FramesAbout {
        &mut self.about
    }
}

impl Pictures for Stack {
    fn about(&self) -> &FramesAbout {
        &self.about
    }

    fn read(&self, frame: usize, values: &mut Vec<f32>) -> Result<(), FormatError> {
        let missing = || {
            FormatError::new(
                &self.path,
                format!("there is no frame {frame}"),
                "the file changed while it was read",
            )
        };
        if frame >= self.about.stamps.len() {
            return Err(missing());
        }
        let (dataset, rows) = match &self.from {
            From::Dataset(dataset, rows) => {
                let row = *rows.get(frame).ok_or_else(missing)?;
                (dataset.clone(), row..row + 1)
            }
            From::Each(file, names) => {
                let dataset = file
                    .dataset(names.get(frame).ok_or_else(missing)?)
                    .map_err(|error| refused(&self.path, error))?
                    .ok_or_else(missing)?;
                let rows = 0..dataset.rows();
                if shape_of(dataset.shape()) != Some((self.about.extent, self.about.colour)) {
                    let expected = format!("{} pixels, as the first picture has", self.about.extent);
                    let found = format!("the shape {:?}", dataset.shape());
                    return Err(FormatError::new(&self.path, found, "split the file by size")
                        .at(dataset.at())
                        .expected(expected));
                }
                (dataset, rows)
            }
        };
        let field = dataset.numbers().ok_or_else(missing)?;
        let block = dataset.rows_at(rows).map_err(|error| refused(&self.path, error))?;
        if let Some(gap) = block.gaps().first() {
            return Err(FormatError::new(
                &self.path,
                format!("frame {frame} is damaged: {}", gap.why),
                "copy or record the file again",
            )
            .at(dataset.at()));
        }
        let mut numbers = Vec::new();
        block.all(field, &mut numbers);
        values.clear();
        values.extend(numbers.iter().map(|&number| number as f32));
        if self.about.colour == Colour::Rgb && self.order == Order::Bgr {
            values.chunks_exact_mut(3).for_each(|pixel| pixel.swap(0, 2));
        }
        Ok(())
    }
}
