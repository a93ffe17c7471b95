//! Temporary failures: from one instant to another, or in a part of the array, the sensor behaves
//! differently. Each test finds an interval of time, and rows and columns.
//!
//! - `stalls`: events are delayed and released together.
//! - `copies`: packets of events are repeated.
//! - `signs`: events of one sign are recorded with the other one.
//! - `lost`: a rectangle of the array has no events.
//! - `noise`: random events without light on the whole array.
//! - `hot`: pixels fire without light.
//! - `rhythm`: events rise and fall together, as under light that flickers for a while.
//!
//! Limits: failures of the whole recording are left to the other tests. One of each kind is reported, the
//! strongest; of hot pixels all. A rectangle is found where the scene moves in all of it.

mod copies;
pub(super) mod hot;
mod lost;
mod noise;
pub(super) mod rhythm;
mod signs;
mod stalls;

use super::array::{EventsByTime, StampedEvent};
use photocurrent_scene::case::Case;
use serde::{Deserialize, Serialize};

/// Kinds of temporary failures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Failure {
    /// Events are released together.
    Stall,
    /// Events are repeated.
    Copies,
    /// Events of one sign carry the other.
    Sign,
    /// A part of the array has no events.
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

/// A temporary failure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// Its kind.
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
    /// The test's statistic over its threshold.
    pub statistic: f64,
    /// The observation, in a sentence.
    pub seen: String,
}

/// Longest temporary failure, as a share of the recording.
const LONGEST: f64 = 0.9;

/// Grid of stamps, seconds, from which on stalls (a tenth of the shortest) and copies cannot be tested.
const COARSE_S: f64 = 5e-5;

/// All temporary failures of a recording by their beginnings: of pixels that are `hot` for a while, and
/// others. A rhythm comes with them, temporary or not. `masked`: pixels left out, rising. `step_s`: grid of
/// the stamps, s.
pub(super) fn episodes(
    case: &Case,
    stream: &EventsByTime,
    (hot, masked): (Vec<Episode>, &[u32]),
    step_s: f64,
) -> (Vec<Episode>, Option<rhythm::EventRhythm>) {
    let mut found = hot;
    let is_out = |pixel: u32| {
        masked.binary_search(&pixel).is_ok()
            || found.iter().any(|one| one.pixels.binary_search(&pixel).is_ok())
    };
    let rest: Vec<StampedEvent> = stream.0.iter().filter(|event| !is_out(event.pixel)).copied().collect();
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

    /// A failure of the whole array.
    fn on_whole_array(
        case: &Case,
        failure: Failure,
        time_ns: [i64; 2],
        statistic: f64,
        seen: String,
    ) -> Episode {
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
