//! Failures that come and go: from one instant to another, or in a part of the array, the sensor does
//! something else. Each test finds a stretch of time with its ends, and the rows and columns.
//!
//! - `stalls`: events wait and are released together.
//! - `signs`: events of one sign carry the other one.
//! - `lost`: a rectangle of the array is silent.
//! - `noise`: events without light on the whole array, at random.
//! - `hot`: pixels fire by themselves.
//!
//! Limits: a failure that lasts for the whole recording is the business of the other tests; one of each kind
//! but of hot pixels is reported, the strongest; a rectangle is found where the scene moves in all of it.

pub(super) mod hot;
mod lost;
mod noise;
mod signs;
mod stalls;

use super::array::{Stamped, Stream};
use photocurrent_scene::case::Case;
use serde::{Deserialize, Serialize};

/// What goes wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Failure {
    /// Events are released together.
    Stall,
    /// Events of one sign carry the other.
    Sign,
    /// A part of the array is silent.
    Lost,
    /// Events without light, everywhere.
    Noise,
    /// Pixels that fire by themselves.
    Hot,
}

impl Failure {
    /// The effect of the catalogue that it is an episode of; none where there is none.
    pub fn id(self) -> Option<&'static str> {
        match self {
            Failure::Stall => Some("readout_queue"),
            Failure::Sign => None,
            Failure::Lost => Some("event_loss"),
            Failure::Noise => Some("background_activity"),
            Failure::Hot => Some("hot_pixels"),
        }
    }
}

/// A failure from one instant to another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// What.
    pub failure: Failure,
    /// First and last instant, ns.
    pub time_ns: [i64; 2],
    /// First and last row.
    pub rows: [u32; 2],
    /// First and last column.
    pub columns: [u32; 2],
    /// The pixels, rising, where they are not all of those rows and columns.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pixels: Vec<u32>,
    /// What the test measured over what counts.
    pub statistic: f64,
    /// What was seen, in a sentence.
    pub seen: String,
}

/// A failure that lasts for more than this share of the recording is none that comes and goes.
const LONGEST: f64 = 0.9;

/// All failures of a recording that come and go, in the order of their beginnings: those of pixels that are
/// `hot` for a while, and others; pixels of `masked` (rising) take no part. `is_on_grid`: stamps stand on a
/// coarse grid, which looks like stalls.
pub(super) fn episodes(
    case: &Case,
    stream: &Stream,
    (hot, masked): (Vec<Episode>, &[u32]),
    is_on_grid: bool,
) -> Vec<Episode> {
    let mut found = hot;
    let is_out = |pixel: u32| {
        masked.binary_search(&pixel).is_ok()
            || found.iter().any(|one| one.pixels.binary_search(&pixel).is_ok())
    };
    let rest: Vec<Stamped> = stream.0.iter().filter(|event| !is_out(event.pixel)).copied().collect();
    let mut others = Vec::new();
    if !is_on_grid {
        others.extend(stalls::stalls(case, &rest));
    }
    others.extend(signs::signs(case, &rest));
    others.extend(lost::lost(case, &rest));
    others.extend(noise::noise(case, &rest));
    found.extend(others);
    found.sort_by_key(|one| (one.time_ns, one.failure));
    found
}

impl Episode {
    /// On the whole array.
    fn everywhere(case: &Case, failure: Failure, time_ns: [i64; 2], statistic: f64, seen: String) -> Episode {
        Episode {
            failure,
            time_ns,
            rows: [0, case.extent.height.saturating_sub(1)],
            columns: [0, case.extent.width.saturating_sub(1)],
            pixels: Vec::new(),
            statistic,
            seen,
        }
    }
}

/// The stretch of scores with the largest sum: first and last number, and the sum; none without a positive
/// one.
fn stretch(scores: impl IntoIterator<Item = f64>) -> Option<(usize, usize, f64)> {
    let mut best: Option<(usize, usize, f64)> = None;
    let (mut first, mut sum) = (0, 0.0);
    for (k, score) in scores.into_iter().enumerate() {
        if sum <= 0.0 {
            (first, sum) = (k, 0.0);
        }
        sum += score;
        if sum > best.map_or(0.0, |best| best.2) {
            best = Some((first, k, sum));
        }
    }
    best
}

/// Blocks across and down that the array is compared in.
const BLOCKS: usize = 4;

/// The block of a pixel.
fn block(case: &Case, pixel: u32) -> usize {
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let (x, y) = (pixel as usize % width, pixel as usize / width);
    (y * BLOCKS / height) * BLOCKS + x * BLOCKS / width
}

#[cfg(test)]
mod tests;
