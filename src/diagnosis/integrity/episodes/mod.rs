//! Failures that come and go: from one instant to another, or in a part of the array, the sensor does
//! something else. Each test finds a stretch of time with its ends, and the rows and columns.
//!
//! - `stalls`: events wait and are released together.
//! - `copies`: packets of events come twice.
//! - `signs`: events of one sign carry the other one.
//! - `lost`: a rectangle of the array is silent.
//! - `noise`: events without light on the whole array, at random.
//! - `hot`: pixels fire by themselves.
//! - `rhythm`: events rise and fall together, as light that flickers for a while makes them.
//!
//! Limits: a failure that lasts for the whole recording is the business of the other tests; one of each kind
//! but of hot pixels is reported, the strongest; a rectangle is found where the scene moves in all of it.

mod copies;
pub(super) mod hot;
mod lost;
mod noise;
pub(super) mod rhythm;
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
    /// Events come twice.
    Copies,
    /// Events of one sign carry the other.
    Sign,
    /// A part of the array is silent.
    Lost,
    /// Events without light, everywhere.
    Noise,
    /// Pixels that fire by themselves.
    Hot,
    /// Light that flickers: no failure of the sensor's, and no finding.
    Rhythm,
}

impl Failure {
    /// The effect of the catalogue that it is an episode of; none where there is none.
    pub fn id(self) -> Option<&'static str> {
        match self {
            Failure::Stall => Some("readout_queue"),
            Failure::Sign | Failure::Copies | Failure::Rhythm => None,
            Failure::Lost => Some("event_loss"),
            Failure::Noise => Some("background_activity"),
            Failure::Hot => Some("hot_pixels"),
        }
    }

    /// Where in the chain one that is no effect of the catalogue enters.
    pub fn insertion(self) -> &'static str {
        if self == Failure::Copies { "readout" } else { "comparator" }
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

/// Stamps on a grid of this step, seconds, and coarser look like stalls (a tenth of the shortest) and like
/// copies.
const COARSE_S: f64 = 5e-5;

/// All failures of a recording that come and go, in the order of their beginnings: those of pixels that are
/// `hot` for a while, and others; pixels of `masked` (rising) take no part. `step_s`: the grid of the
/// stamps, seconds. With them a rhythm, for a while or for the whole
/// recording.
pub(super) fn episodes(
    case: &Case,
    stream: &Stream,
    (hot, masked): (Vec<Episode>, &[u32]),
    step_s: f64,
) -> (Vec<Episode>, Option<rhythm::Rhythm>) {
    let mut found = hot;
    let is_out = |pixel: u32| {
        masked.binary_search(&pixel).is_ok()
            || found.iter().any(|one| one.pixels.binary_search(&pixel).is_ok())
    };
    let rest: Vec<Stamped> = stream.0.iter().filter(|event| !is_out(event.pixel)).copied().collect();
    let mut others = Vec::new();
    if step_s < COARSE_S {
        // What waits together gets one stamp: of a stall it is no copy.
        others.extend(stalls::stalls(case, &rest).or_else(|| copies::copies(case, &rest)));
    }
    others.extend(signs::signs(case, &rest));
    others.extend(lost::lost(case, &rest));
    let rhythm = rhythm::rhythm(case, &rest);
    others.extend(noise::noise(case, &rest));
    // What rises and falls together is no noise.
    if let Some(episode) =
        rhythm.as_ref().filter(|rhythm| rhythm.for_a_while).map(|rhythm| rhythm.episode(case))
    {
        others.retain(|one| one.failure != Failure::Noise || !one.overlaps(&episode));
        others.push(episode);
    }
    found.extend(others);
    found.sort_by_key(|one| (one.time_ns, one.failure));
    (found, rhythm)
}

impl Episode {
    /// Is most of it within the time of another one?
    fn overlaps(&self, other: &Episode) -> bool {
        let shared = self.time_ns[1].min(other.time_ns[1]) - self.time_ns[0].max(other.time_ns[0]);
        2 * shared > self.time_ns[1] - self.time_ns[0]
    }

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

/// Side of the cells that rectangles consist of, pixels: smaller on small arrays.
fn cell_side(case: &Case) -> usize {
    if case.extent.width.min(case.extent.height) < 64 { 4 } else { 8 }
}

/// The block of a pixel.
fn block(case: &Case, pixel: u32) -> usize {
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let (x, y) = (pixel as usize % width, pixel as usize / width);
    (y * BLOCKS / height) * BLOCKS + x * BLOCKS / width
}

#[cfg(test)]
mod tests;
