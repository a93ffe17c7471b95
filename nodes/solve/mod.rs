//! From events and frames to photocurrent.
//!
//! Two kinds take the same inputs and give the same outputs, so that one stands in for the other: [`map`],
//! the MAP estimate, and [`paper`], Eq. (13) of the paper. What they compute is in [`photocurrent_solve`].
//! [`frames`] goes on to pictures, where nobody else takes the photocurrent.

#[cfg(test)]
mod colour_tests;
#[cfg(test)]
mod coupled_tests;
pub mod frames;
mod host;
pub mod map;
pub mod paper;
#[cfg(test)]
mod stamps_tests;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod undo_tests;

use photocurrent_core::{Context, EventStream, FrameSequence, MapSet, Sensor, TrackSet};
use photocurrent_solve::{Recording, Report, Solution};
use std::sync::Arc;

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Events; in-pixel times when `readout = "slope"`.
        events: EventStream,
        /// Captured frames of the same pixels, or of a whole number of pixels along the side of each event
        /// pixel; grey, colour or a mosaic. At least one.
        frames: FrameSequence,
        /// Thresholds, gain, and what the chosen models need.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// Photocurrent of every value of the frames over time.
        tracks: TrackSet,
        /// How the solution went: planes `status` (0 converged, 1 double-integral estimate, 2 saturated, 3 no
        /// usable frame), `iterations` (largest), `cost` (sum), `event_residual` and `frame_residual` (root
        /// mean squares in standard deviations, NaN for none), `implausible` (0, or natural logarithm of the
        /// brightest light over that of the brightest frame where it was held: see `plausible_range`).
        map: MapSet,
    }
}

impl In {
    fn recording(&self) -> Recording<'_> {
        Recording { events: &self.events, frames: &self.frames, sensor: &self.sensor }
    }
}

/// Notes what a solution left out, and counts pixels that did not come out as they should.
fn out(solution: Solution, plausible_range: f64, cx: &Context) -> Out {
    note(solution.not_modelled, &solution.report, plausible_range, cx);
    Out { tracks: solution.tracks, map: solution.map }
}

fn note(not_modelled: Option<String>, report: &Report, plausible_range: f64, cx: &Context) {
    if let Some(note) = not_modelled {
        cx.note(note);
    }
    for (pixels, what) in report.lines(plausible_range) {
        cx.count(pixels, &what);
    }
}
