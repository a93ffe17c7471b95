//! Direct tests, which need no estimate of the scene: inconsistent data, stamps on a coarser grid, a
//! readout queue, hot rows and pixels, noise events, lost events, events in step with the frames, leaks,
//! blind times, late events; and flicker of the light, which is a property of the scene.
//!
//! Each test is strict: it reports only where a nominal sensor could hardly record this, whatever the scene.
//! A test that finds nothing is no proof of health; what is finer than these tests see is the business of the
//! tests that estimate the scene.
//!
//! In reading order:
//!
//! - [`Departure`]: what a test finds; `array`: events in order of time, and the halves of the array.
//! - `data`: broken and insufficient recordings.
//! - `stamps`: grids and regular gaps of time stamps.
//! - `hot`: rows, then pixels, that fire far more than those around them.
//! - `intervals`: intervals that are too short for any light (noise, jitter), or pile up at their shortest
//!   (blind time).
//! - `contrary`: events against the light, where all around goes one way (noise).
//! - `load`: windows of time with one and the same count (loss), bursts in step with the frames.
//! - `still`: pixels in which nothing moves, and the leak that shows there.
//! - `coupling`: events there, or anywhere, that come when their row of the frame is read.
//! - `changes`: what the light did between two frames by the frames and by the events: late events, lost
//!   light.
//! - `steps`: how many events come for a change between two frames: thresholds.
//! - `means`: both for frames of long exposure, by the double integral; and a dark current. It proposes,
//!   [`crate::judge`] decides.
//! - `regular`: rates of events that repeat with the frames row by row, or from row to row: what no scene
//!   does and no effect of the catalogue.
//! - `flicker`: one rhythm common to the whole array.
//! - [`episodes`]: failures that come and go: stalls, stuck signs, a silent rectangle, bursts of noise,
//!   pixels that are hot for a while.
//! - `again`: 95 % intervals of what is found, by tests made again without parts of the array.

pub(crate) mod again;
mod array;
mod changes;
mod contrary;
mod coupling;
pub(crate) mod data;
mod departure;
pub mod episodes;
mod flicker;
pub(crate) mod hot;
mod intervals;
mod load;
pub(crate) mod means;
pub(crate) mod regular;
mod rest;
pub(crate) mod stamps;
mod steps;
mod still;

use crate::covariates::Covariate;
use crate::dependence::Dependence;
use crate::report::SceneProperty;
use again::{add_intervals, lacks_interval};
pub use array::{EventsByTime, StampedEvent};
pub use departure::{Departure, HalvesGain};
use episodes::Episode;
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use serde::{Deserialize, Serialize};

/// Results of the direct tests.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Integrity {
    /// Reasons why the data cannot be used, one sentence each.
    pub broken: Vec<String>,
    /// Data that are missing or too few, one sentence each.
    pub lacking: Vec<String>,
    /// Departures, strongest (statistic over threshold) first.
    pub findings: Vec<Departure>,
    /// Event rates that depend on the frame phase or the row parity, strongest first. No scene causes that,
    /// and no effect of the catalogue.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub dependences: Vec<Dependence>,
    /// Failures from one instant to another, in the order of their beginnings.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub episodes: Vec<Episode>,
    /// Not mismatches.
    pub scene: Vec<SceneProperty>,
    /// Pixels that later stages should leave out, rising.
    pub masked: Vec<u32>,
}

/// Are the data sufficient and consistent enough to estimate a scene?
pub fn can_compare(case: &Case, integrity: &Integrity) -> bool {
    integrity.broken.is_empty() && data::is_enough(case)
}

/// Effects of the catalogue that direct tests detect.
pub const TESTED: [&str; 15] = [
    "timestamp_quantization",
    "timestamp_jitter",
    "readout_queue",
    "hot_rows",
    "hot_pixels",
    "background_activity",
    "event_loss",
    "frame_coupling",
    "clock_offset",
    "refractory",
    "leak_events",
    "parasitic_leak",
    "threshold_scale",
    "threshold_asymmetry",
    "dark_current",
];

/// Runs all direct tests. `nominal`: the nominal description, `None` where it lacks what the model needs.
pub fn integrity(case: &Case, nominal: Option<&Nominal>) -> Integrity {
    let mut found = Integrity {
        broken: data::unusable_data(case),
        lacking: data::insufficient_data(case),
        ..Integrity::default()
    };
    if !found.broken.is_empty() || case.events.len() < data::FEWEST_EVENTS {
        return found;
    }
    let stream = EventsByTime::from_case(case);
    // Pixels that are hot for a while are none that always are.
    let hot = episodes::hot::hot_pixel_episodes(case);
    let of_while = hot.iter().fold(Vec::new(), |all, one| merge_pixels(&all, &one.pixels));
    (found.findings, found.masked) = hot_ones(case, nominal, &of_while);
    found.findings.extend(run_masked_tests(case, nominal, Some(&stream), &found.masked, &|_| true));
    let step_s = found.findings.iter().filter(|finding| finding.id == stamps::GRID);
    let step_s = step_s.flat_map(|finding| &finding.parameters).map(|(_, step)| *step).fold(0.0, f64::max);
    let (episodes, rhythm) = episodes::episodes(case, &stream, (hot, &found.masked), step_s);
    found.episodes = episodes;
    found.dependences = regular::dependences(case, &found.masked);
    if found.findings.iter().any(|finding| finding.id == "frame_coupling") {
        found.dependences.retain(|dependence| dependence.covariate != Covariate::FramePhase);
    }
    found.scene = nominal.map_or_else(Vec::new, |nominal| flicker::flicker(case, nominal, &stream));
    let rhythm =
        nominal.zip(rhythm).and_then(|(nominal, rhythm)| flicker::property_of_rhythm(nominal, &rhythm));
    if let Some(rhythm) = rhythm {
        found.scene.retain(|one| !one.has_frequency(rhythm.frequency_hz));
        found.scene.push(rhythm);
        // Its events lie on still pixels as well.
        found.findings.retain(|finding| finding.id != "background_activity");
    }
    // The same effect by two tests is one finding, the stronger.
    found.findings.sort_by(|a, b| {
        (b.statistic / b.threshold).total_cmp(&(a.statistic / a.threshold)).then(a.id.cmp(b.id))
    });
    // And what fails for a while is no fault of the whole recording.
    let mut ids: Vec<&str> = found.episodes.iter().filter_map(|one| one.failure.id()).collect();
    found.findings.retain(|finding| {
        let is_new = !ids.contains(&finding.id);
        ids.push(finding.id);
        is_new
    });
    let Integrity { findings, masked, .. } = &mut found;
    let ids: Vec<&str> =
        findings.iter().filter(|finding| lacks_interval(finding)).map(|finding| finding.id).collect();
    add_intervals(case, findings, &|case, out| {
        let mut again = if ids.iter().any(|id| hot::IDS.contains(id)) {
            hot_ones(case, nominal, &merge_pixels(&of_while, out)).0
        } else {
            Vec::new()
        };
        let stream = ids.iter().any(|id| OF_STREAM.contains(id)).then(|| EventsByTime::from_case(case));
        again.extend(run_masked_tests(case, nominal, stream.as_ref(), &merge_pixels(masked, out), &|of| {
            ids.iter().any(|id| of.contains(id))
        }));
        again
    });
    found
}

/// Effects that are detected in the order of all events.
const OF_STREAM: [&str; 5] =
    [stamps::GRID, "timestamp_jitter", "readout_queue", "event_loss", "frame_coupling"];

/// Merges two lists of pixels, rising.
pub(crate) fn merge_pixels(a: &[u32], b: &[u32]) -> Vec<u32> {
    let mut all = [a, b].concat();
    all.sort_unstable();
    all.dedup();
    all
}

/// Hot rows, then hot pixels, and the pixels of both. Pixels of `out` (rising) are left out.
fn hot_ones(case: &Case, nominal: Option<&Nominal>, out: &[u32]) -> (Vec<Departure>, Vec<u32>) {
    let (rows, in_rows) = hot::rows(case, nominal, out);
    let mut masked = merge_pixels(&in_rows, out);
    let pixels = hot::pixels(case, nominal, &mut masked);
    (rows.into_iter().chain(pixels).collect(), masked)
}

/// The tests that are `wanted` (by the ids that they may find), without the pixels of `masked`.
fn run_masked_tests(
    case: &Case,
    nominal: Option<&Nominal>,
    stream: Option<&EventsByTime>,
    masked: &[u32],
    wanted: &dyn Fn(&[&str]) -> bool,
) -> Vec<Departure> {
    let mut found: Vec<Departure> = stream.map_or_else(Vec::new, |stream| stamps::findings(case, stream));
    let on_grid = found.iter().any(|finding| finding.id == stamps::GRID);
    if wanted(&["background_activity", "timestamp_jitter", "refractory"]) {
        // Stamps on a coarse grid have no interval below its step.
        let says_more = |finding: &Departure| !(on_grid && finding.id == "refractory");
        found.extend(intervals::findings(case, nominal, masked).into_iter().filter(says_more));
    }
    if wanted(&["background_activity"])
        && let Some(noise) = contrary::noise(case, masked)
    {
        // Its rate is counted over a longer time than that of too short reversals.
        found.retain(|finding| finding.id != noise.id);
        found.push(noise);
    }
    if let Some(stream) = stream {
        found.extend(load::loss(case, stream).filter(|_| !on_grid));
        found.extend(load::frame_coupling(case, stream));
    }
    let Some(nominal) = nominal else { return found };
    if wanted(&["leak_events", "parasitic_leak", "frame_coupling", "background_activity"]) {
        let still = still::still_pixels(case, nominal, masked);
        found.extend(still::leak(case, nominal, &still, masked));
        found.extend(rest::noise(case, &still, masked).filter(|_| wanted(&["background_activity"])));
        found.extend(coupling::coupling(case, nominal, &still, masked));
    }
    if wanted(&["clock_offset", "refractory"]) {
        found.extend(changes::findings(case, nominal, masked));
    }
    if wanted(&["threshold_scale", "threshold_asymmetry"]) {
        found.extend(steps::findings(case, nominal, masked));
    }
    found
}

#[cfg(test)]
mod again_tests;
#[cfg(test)]
mod changes_tests;
#[cfg(test)]
mod means_tests;
#[cfg(test)]
mod regular_tests;
#[cfg(test)]
mod still_tests;
#[cfg(test)]
mod tests;
