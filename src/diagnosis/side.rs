//! A recording or a simulated one, ready for a regression of its changes of closures: the light through its events, the changes, and how they are laid side by side.

use crate::band::Band;
use crate::case::Case;
use crate::closures::{Change, changes};
use crate::covariates::{Covariate, Surroundings};
use crate::nominal::Nominal;
use crate::sample::Sample;
use crate::scene::Scene;
use photocurrent_core::Extent;

/// Parts of the array that tell an error: across and down.
const PARTS: (u32, u32) = (6, 5);
/// Side of a block, pixels.
const BLOCK: u32 = 7;
/// Changes from frame to frame of a large array or a long recording are thinned to so many: templates of every effect are kept of each.
const MOST_CHANGES: usize = 250_000;

/// A recording or its control, ready to be regressed.
pub struct Side {
    /// The recording.
    pub case: Case,
    /// The light through its events.
    pub light: Scene,
    /// Its changes of closures.
    pub changes: Vec<Change>,
    /// Pixel, stamp and polarity of the sample's events.
    pub events: Vec<(u32, i64, i8)>,
}

impl Side {
    /// Of the pixels of a sample.
    pub fn new(case: &Case, nominal: &Nominal, sample: &Sample) -> Side {
        let bands = Band::all(case, nominal, sample);
        let events = sample.pixels.iter().flat_map(|&pixel| case.events.of(pixel as usize).iter().map(move |event| (pixel, event.t_in_ns, event.polarity)));
        Side { changes: changes(case, nominal, sample, &bands), light: Band::scene(case, &bands), events: events.collect(), case: case.clone() }
    }

    /// A covariate at each of its events; NaN where it is not known.
    pub fn lay(&self, covariate: Covariate, surroundings: &Surroundings<'_>) -> Vec<f64> {
        let value = |&(pixel, t_ns, polarity): &(u32, i64, i8)| surroundings.value(covariate, pixel as usize, t_ns, polarity).unwrap_or(f64::NAN);
        self.events.iter().map(value).collect()
    }
}

/// Number of parts.
pub const PART_COUNT: usize = (PARTS.0 * PARTS.1) as usize;

/// The part of the array in which a pixel is.
pub fn part_of(extent: Extent, x: u32, y: u32) -> usize {
    (y * PARTS.1 / extent.height * PARTS.0 + x * PARTS.0 / extent.width) as usize
}

/// All pixels, or some of the blocks where there are more events than `most`, or more changes than [`MOST_CHANGES`].
pub fn sampled(case: &Case, most: usize) -> Sample {
    let changes = case.extent.pixels() * case.frame_count();
    let thinned = case.events.all().len().div_ceil(most).max(changes.div_ceil(MOST_CHANGES)).max(1) as u32;
    Sample::all(case, BLOCK).only(|block| block.is_multiple_of(thinned)).0
}

/// Changes with an effect less those without, in the places of the recording's own changes; 0 where either has none.
pub fn differences(own: &[Change], with: &[Change], without: &[Change]) -> Vec<f64> {
    at_changes(own, with)
        .into_iter()
        .zip(at_changes(own, without))
        .map(|(with, without)| with.zip(without).map_or(0.0, |(with, without)| with - without))
        .collect()
}

/// Changes in the places of others.
pub fn at_changes(own: &[Change], others: &[Change]) -> Vec<Option<f64>> {
    let find = |one: &Change| others.binary_search_by(|other| (other.place, other.frame).cmp(&(one.place, one.frame))).ok().map(|at| others[at].value);
    own.iter().map(find).collect()
}
