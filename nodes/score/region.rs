//! Which pixels a score is taken over.
//!
//! Most of a picture stands still, and there every method is good: a score over all pixels hides the
//! differences. `moving` keeps the pixels whose reference value changes over time by more than a stated part
//! of the peak.

use crate::crop::Crop;
use photocurrent_core::{FrameSequence, NodeError};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which pixels count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Region {
    /// All of them.
    #[default]
    All,
    /// Those whose reference changes over time.
    Moving,
}

/// Change of the reference over time, as a part of the peak, from which a pixel counts as moving.
pub const MOVING_PART_OF_PEAK: f64 = 0.05;

impl Region {
    /// For the metric card.
    pub fn describe(self) -> String {
        match self {
            Region::All => "all pixels".into(),
            Region::Moving => format!(
                "pixels whose reference varies by more than {} % of the peak over time",
                100.0 * MOVING_PART_OF_PEAK
            ),
        }
    }

    /// For the card, with a rectangle that the region is cut to.
    pub fn describe_in(self, roi: Option<Crop>) -> String {
        roi.map_or(self.describe(), |roi| format!("{}, in {}", self.describe(), roi.describe()))
    }

    /// [`Region::mask`], cut to a rectangle.
    ///
    /// # Errors
    /// As [`Region::mask`], and when the rectangle reaches outside.
    pub fn mask_in(
        self,
        roi: Option<Crop>,
        reference: &FrameSequence,
        peak: f64,
    ) -> Result<Vec<bool>, NodeError> {
        let mut mask = self.mask(reference, peak)?;
        let Some(roi) = roi else { return Ok(mask) };
        let (extent, channels) = (reference.meta.extent, reference.meta.channels() as usize);
        roi.check("roi", "frames", extent)?;
        for (i, counts) in mask.iter_mut().enumerate() {
            let pixel = i / channels;
            *counts &=
                roi.contains((pixel % extent.width as usize) as u32, (pixel / extent.width as usize) as u32);
        }
        if mask.contains(&true) {
            Ok(mask)
        } else {
            Err(NodeError::input(format!("no pixel of the reference moves in the {}", roi.describe()))
                .hint("score with region = \"all\", or another `roi`"))
        }
    }

    /// One flag per value of a frame, row-major.
    ///
    /// # Errors
    /// When the reference cannot be read, or no pixel is left.
    pub fn mask(self, reference: &FrameSequence, peak: f64) -> Result<Vec<bool>, NodeError> {
        let meta = &reference.meta;
        if self == Region::All {
            return Ok(vec![true; meta.row_values() * meta.extent.height as usize]);
        }
        let rows: Result<Vec<Vec<bool>>, NodeError> = reference
            .rows()
            .bands(1)
            .into_par_iter()
            .map(|row| {
                let block = reference.read_rows(row)?;
                let moves = |x: usize| {
                    let values = (0..reference.len())
                        .map(|l| f64::from(block.row(l, row.start)[x]))
                        .filter(|v| v.is_finite());
                    let (low, high) = values
                        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (v.min(low), v.max(high)));
                    high - low > MOVING_PART_OF_PEAK * peak
                };
                Ok((0..meta.row_values()).map(moves).collect())
            })
            .collect();
        let mask = rows?.concat();
        if mask.contains(&true) {
            Ok(mask)
        } else {
            Err(NodeError::input("no pixel of the reference moves").hint("score with region = \"all\""))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Exposure, Extent, testing};

    #[test]
    fn only_pixels_that_change_by_more_than_the_stated_part_move() {
        let exposures = vec![Exposure::new(0, 1), Exposure::new(10, 11)];
        let frames = testing::captured(Extent { width: 3, height: 1 }, exposures, 0, |l, x, _| {
            50.0 + (l as f32) * [0.0, 4.9, 5.1][x as usize]
        });
        assert_eq!(Region::Moving.mask(&frames, 100.0).unwrap(), [false, false, true]);
        assert!(Region::Moving.mask(&frames, 200.0).is_err());
        let column = |x| Some(Crop { x, y: 0, width: 1, height: 1 });
        assert_eq!(Region::Moving.mask_in(column(2), &frames, 100.0).unwrap(), [false, false, true]);
        assert_eq!(Region::All.mask_in(column(0), &frames, 100.0).unwrap(), [true, false, false]);
        assert!(
            Region::Moving
                .mask_in(column(0), &frames, 100.0)
                .unwrap_err()
                .message
                .ends_with("in the 1 x 1 pixels at (0, 0)")
        );
    }
}
