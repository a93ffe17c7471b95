//! Frames: digital numbers of whole pictures, captured or rendered, each row with its own exposure.
//!
//! A sequence is read by row band and by range of frames. Its times stand in [`FrameTimes`]: the exposure of
//! row 0 of every frame, and how much later each further row starts. A captured frame's DN belongs to its own
//! exposure; a rendered one's is scaled to a nominal exposure, so that it compares with what the sensor
//! records ([`FrameScale`]).

use crate::colour::Colour;
use crate::digest::{Digest, DigestBuilder};
use crate::error::DataError;
use crate::extent::{Extent, Rows};
use crate::handle::spliced_rows;
use crate::time::{Exposure, TimeSpan};
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::sync::Arc;

/// When the frames were exposed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameTimes {
    /// Exposure of row 0 of each frame, in time order.
    pub exposures: Arc<Vec<Exposure>>,
    /// Delay from one row to the next, ns; 0 is a global shutter.
    pub row_time_ns: i64,
}

impl FrameTimes {
    /// Checks and keeps.
    ///
    /// # Errors
    /// When an exposure is empty or starts before the one of the frame before it.
    pub fn new(exposures: Vec<Exposure>, row_time_ns: i64) -> Result<FrameTimes, DataError> {
        for (l, exposure) in exposures.iter().enumerate() {
            if exposure.length_ns() <= 0 {
                return Err(DataError::new(format!(
                    "frame {l} has an exposure of {} ns (from {} to {} ns)",
                    exposure.length_ns(),
                    exposure.start.0,
                    exposure.end.0
                )));
            }
            if l > 0 && exposures[l - 1].start > exposure.start {
                return Err(DataError::new(format!(
                    "frame {l} starts at {} ns, before frame {} at {} ns",
                    exposure.start.0,
                    l - 1,
                    exposures[l - 1].start.0
                )));
            }
        }
        Ok(FrameTimes { exposures: Arc::new(exposures), row_time_ns })
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.exposures.len()
    }

    /// No frame at all?
    pub fn is_empty(&self) -> bool {
        self.exposures.is_empty()
    }

    /// Exposure of one row of one frame.
    pub fn exposure(&self, frame: usize, row: u32) -> Exposure {
        self.exposures[frame].delayed(self.row_time_ns * i64::from(row))
    }

    /// The last frame whose exposure of `row` has begun at `t_ns`; none before the first.
    pub fn last_begun(&self, row: u32, t_ns: i64) -> Option<usize> {
        let shift = self.row_time_ns * i64::from(row);
        self.exposures.partition_point(|exposure| exposure.start.0 + shift <= t_ns).checked_sub(1)
    }

    /// Mean time from the start of one exposure to that of the next, ns; none of fewer than two.
    pub fn mean_period_ns(&self) -> Option<f64> {
        let (first, last) = (self.exposures.first()?, self.exposures.last()?);
        (self.exposures.len() > 1)
            .then(|| (last.start.0 - first.start.0) as f64 / (self.exposures.len() - 1) as f64)
    }

    /// From the first exposure's start to the last one's end, all rows of a sensor of `height` rows counted.
    pub fn span(&self, height: u32) -> Option<TimeSpan> {
        let shift = self.row_time_ns * i64::from(height.saturating_sub(1));
        self.exposures
            .iter()
            .map(|e| TimeSpan::new(e.start.0.min(e.start.0 + shift), e.end.0.max(e.end.0 + shift)))
            .reduce(TimeSpan::union)
    }

    /// Median exposure length in ns, the lower one of an even number: what "a frame of the recording" means.
    pub fn nominal_exposure_ns(&self) -> Option<i64> {
        let mut lengths: Vec<i64> = self.exposures.iter().map(Exposure::length_ns).collect();
        lengths.sort_unstable();
        lengths.get(lengths.len().saturating_sub(1) / 2).copied()
    }

    /// The times of some frames only.
    pub fn select(&self, frames: &[usize]) -> FrameTimes {
        FrameTimes {
            exposures: Arc::new(frames.iter().map(|&l| self.exposures[l]).collect()),
            row_time_ns: self.row_time_ns,
        }
    }

    #[cfg(feature = "graph")]
    fn write_digest(&self, digest: &mut DigestBuilder) {
        let flat: Vec<i64> = self.exposures.iter().flat_map(|e| [e.start.0, e.end.0]).collect();
        digest.integer(self.row_time_ns).slice(&flat);
    }
}

/// What one DN stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FrameScale {
    /// `DN = black level + gain x integral of i_pd` over the frame's own exposure, Eq. (5).
    Captured,
    /// As a frame of this exposure would read if the frame's mean light lasted so long.
    Nominal {
        /// Length of that exposure, ns.
        exposure_ns: i64,
    },
}

/// What is known about frames before their data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FramesMeta {
    /// Size of the pictures in pixels.
    pub extent: Extent,
    /// Grey, red, green and blue, or a mosaic of filters.
    #[serde(default)]
    pub colour: Colour,
    /// Exposures.
    pub times: FrameTimes,
    /// What one DN stands for.
    pub scale: FrameScale,
}

impl FramesMeta {
    /// Values per pixel: 1 for grey and for a mosaic, 3 for colour.
    pub fn channels(&self) -> u32 {
        self.colour.channels()
    }

    /// Number of f32 values in one row of one frame.
    pub fn row_values(&self) -> usize {
        self.extent.width as usize * self.channels() as usize
    }

    /// Writes every attribute that is part of the content.
    #[cfg(feature = "graph")]
    pub(crate) fn write_digest(&self, digest: &mut DigestBuilder) {
        digest
            .text("frames/1")
            .integer(self.extent.width.into())
            .integer(self.extent.height.into())
            .integer(self.channels().into());
        // Grey frames and three channels are the content they were before mosaics had a name.
        if self.colour.is_mosaic() {
            digest.text(self.colour.name());
        }
        self.times.write_digest(digest);
        digest.integer(match self.scale {
            FrameScale::Captured => -1,
            FrameScale::Nominal { exposure_ns } => exposure_ns,
        });
    }
}

/// Some rows of some frames.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameBlock {
    /// Which frames.
    pub frames: Range<usize>,
    /// Which rows.
    pub rows: Rows,
    /// Values in a row.
    pub row_values: usize,
    /// DN as [frame][row][x * channels + channel]. NaN marks a value that is not known.
    pub dn: Vec<f32>,
}

impl FrameBlock {
    /// A block of zeros.
    pub fn zeros(frames: Range<usize>, rows: Rows, row_values: usize) -> FrameBlock {
        let dn = vec![0.0; frames.len() * rows.len() * row_values];
        FrameBlock { frames, rows, row_values, dn }
    }

    fn at(&self, frame: usize, row: u32) -> usize {
        ((frame - self.frames.start) * self.rows.len() + (row - self.rows.start) as usize) * self.row_values
    }

    /// One row of one frame.
    pub fn row(&self, frame: usize, row: u32) -> &[f32] {
        let at = self.at(frame, row);
        &self.dn[at..at + self.row_values]
    }

    /// One row of one frame, to write.
    pub fn row_mut(&mut self, frame: usize, row: u32) -> &mut [f32] {
        let at = self.at(frame, row);
        &mut self.dn[at..at + self.row_values]
    }

    /// All rows of one frame.
    pub fn frame(&self, frame: usize) -> &[f32] {
        let at = self.at(frame, self.rows.start);
        &self.dn[at..at + self.rows.len() * self.row_values]
    }

    /// Only some frames and rows, which must be inside.
    pub fn slice(&self, frames: Range<usize>, rows: Rows) -> FrameBlock {
        let mut block = FrameBlock::zeros(frames.clone(), rows, self.row_values);
        for frame in frames {
            for row in rows.iter() {
                block.row_mut(frame, row).copy_from_slice(self.row(frame, row));
            }
        }
        block
    }

    /// The digest of one row through all frames of the block, which must be the whole sequence.
    pub fn row_digest(&self, row: u32) -> Digest {
        let mut digest = DigestBuilder::new("frames-row/1");
        for frame in self.frames.clone() {
            digest.slice(self.row(frame, row));
        }
        digest.finish()
    }
}

/// Where frames come from.
pub trait FrameSource: Send + Sync {
    /// Reads some rows of some frames; only called with what the sequence holds.
    fn read(&self, frames: Range<usize>, rows: Rows) -> Result<FrameBlock, DataError>;
}

impl FrameSource for FrameBlock {
    fn read(&self, frames: Range<usize>, rows: Rows) -> Result<FrameBlock, DataError> {
        Ok(self.slice(frames, rows))
    }
}

/// Frames that can be read by row band and by range of frames, again and again, from many threads.
#[derive(Clone)]
pub struct FrameSequence {
    /// What is known about them.
    pub meta: Arc<FramesMeta>,
    rows: Rows,
    source: Arc<dyn FrameSource>,
}

impl FrameSequence {
    /// From a source that can read all frames of `rows`.
    pub fn new(meta: Arc<FramesMeta>, rows: Rows, source: Arc<dyn FrameSource>) -> FrameSequence {
        FrameSequence { meta, rows, source }
    }

    /// Frames in memory.
    ///
    /// # Panics
    /// When the block does not hold all frames of `meta`, or rows of another width.
    pub fn in_memory(meta: Arc<FramesMeta>, block: FrameBlock) -> FrameSequence {
        assert_eq!(block.frames, 0..meta.times.len(), "a block in memory holds every frame of its sequence");
        assert_eq!(block.row_values, meta.row_values(), "a block's rows are as wide as its sequence's");
        FrameSequence { meta, rows: block.rows, source: Arc::new(block) }
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.meta.times.len()
    }

    /// No frame at all?
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The rows that can be read.
    pub fn rows(&self) -> Rows {
        self.rows
    }

    /// Reads some rows of some frames.
    ///
    /// # Errors
    /// When a row or frame is asked for that is not here, or the source cannot be read.
    pub fn read(&self, frames: Range<usize>, rows: Rows) -> Result<FrameBlock, DataError> {
        if !self.rows.contains(rows) || frames.end > self.len() || frames.start > frames.end {
            return Err(DataError::new(format!(
                "frames {frames:?}, {rows} were asked for, but only 0..{}, {} are here",
                self.len(),
                self.rows
            )));
        }
        self.source.read(frames, rows)
    }

    /// All frames of some rows.
    ///
    /// # Errors
    /// As [`FrameSequence::read`].
    pub fn read_rows(&self, rows: Rows) -> Result<FrameBlock, DataError> {
        self.read(0..self.len(), rows)
    }

    /// The same frames, restricted to some rows.
    pub fn cut(&self, rows: Rows) -> FrameSequence {
        FrameSequence { rows: self.rows.intersect(rows), ..self.clone() }
    }

    /// Some of the frames, in the given order, without copying.
    pub fn select(&self, frames: Vec<usize>) -> FrameSequence {
        let meta = FramesMeta { times: self.meta.times.select(&frames), ..(*self.meta).clone() };
        FrameSequence {
            meta: Arc::new(meta),
            rows: self.rows,
            source: Arc::new(Selected { frames, of: self.clone() }),
        }
    }

    /// Parts that follow each other without gap, as one sequence.
    ///
    /// # Panics
    /// When there is no part or the parts leave a gap: a broken invariant of the scheduler.
    pub fn splice(parts: Vec<FrameSequence>) -> FrameSequence {
        let rows = spliced_rows(parts.iter().map(|part| part.rows));
        FrameSequence { meta: parts[0].meta.clone(), rows, source: Arc::new(Spliced(parts)) }
    }
}

struct Selected {
    frames: Vec<usize>,
    of: FrameSequence,
}

impl FrameSource for Selected {
    fn read(&self, frames: Range<usize>, rows: Rows) -> Result<FrameBlock, DataError> {
        // Frames that follow each other are read together, and all at once without a copy.
        let mut runs = self.frames[frames.clone()].chunk_by(|a, b| a + 1 == *b);
        let read = |run: &[usize]| self.of.read(run[0]..run[0] + run.len(), rows);
        let row_values = self.of.meta.row_values();
        let mut dn = runs.next().map(read).transpose()?.map_or_else(Vec::new, |block| block.dn);
        for run in runs {
            dn.extend(read(run)?.dn);
        }
        Ok(FrameBlock { frames, rows, row_values, dn })
    }
}

struct Spliced(Vec<FrameSequence>);

impl FrameSource for Spliced {
    fn read(&self, frames: Range<usize>, rows: Rows) -> Result<FrameBlock, DataError> {
        let mut block = FrameBlock::zeros(frames.clone(), rows, self.0[0].meta.row_values());
        for part in &self.0 {
            let here = part.rows.intersect(rows);
            if here.is_empty() {
                continue;
            }
            let piece = part.read(frames.clone(), here)?;
            for frame in frames.clone() {
                for row in here.iter() {
                    block.row_mut(frame, row).copy_from_slice(piece.row(frame, row));
                }
            }
        }
        Ok(block)
    }
}

/// True frames of simulated data. A type of its own, so that only a scorer's port takes them: no solver can
/// be wired to them.
#[derive(Clone)]
pub struct Truth(pub FrameSequence);

#[cfg(test)]
mod tests {
    use super::*;

    fn sequence() -> FrameSequence {
        let exposures = (0..4).map(|l| Exposure::new(l * 10, l * 10 + 4)).collect();
        let meta = FramesMeta {
            extent: Extent { width: 3, height: 5 },
            colour: Colour::Mono,
            times: FrameTimes::new(exposures, 2).unwrap(),
            scale: FrameScale::Captured,
        };
        let mut block = FrameBlock::zeros(0..4, meta.extent.rows(), 3);
        block.dn.iter_mut().enumerate().for_each(|(i, dn)| *dn = i as f32);
        FrameSequence::in_memory(Arc::new(meta), block)
    }

    #[test]
    fn spliced_bands_read_like_the_whole() {
        let whole = sequence();
        for height in 1..6 {
            let parts = whole.rows().bands(height).into_iter().map(|rows| whole.cut(rows)).collect();
            let spliced = FrameSequence::splice(parts);
            assert_eq!(spliced.read_rows(whole.rows()).unwrap(), whole.read_rows(whole.rows()).unwrap());
        }
    }

    #[test]
    fn a_selection_keeps_times_and_pictures_together() {
        let whole = sequence();
        let odd = whole.select(vec![1, 3]);
        assert_eq!(odd.meta.times.exposure(1, 2), Exposure::new(34, 38));
        assert_eq!(odd.read(1..2, whole.rows()).unwrap().dn, whole.read(3..4, whole.rows()).unwrap().dn);
    }

    #[test]
    fn rows_that_were_cut_away_cannot_be_read() {
        let band = sequence().cut(Rows { start: 1, end: 3 });
        assert!(band.read_rows(Rows { start: 0, end: 2 }).is_err());
        assert!(band.read(3..5, Rows { start: 1, end: 2 }).is_err());
    }

    #[test]
    fn an_exposure_must_have_a_length_and_frames_an_order() {
        assert!(
            FrameTimes::new(vec![Exposure::new(5, 5)], 0)
                .unwrap_err()
                .message
                .contains("an exposure of 0 ns")
        );
        assert!(
            FrameTimes::new(vec![Exposure::new(5, 9), Exposure::new(4, 9)], 0)
                .unwrap_err()
                .message
                .contains("before frame 0")
        );
    }
}
