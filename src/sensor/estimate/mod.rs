//! What a file does not say and its own events and frames do: how late events are, the exposure, the row
//! time, the thresholds.
//!
//! A frame's logarithm changes from one frame to the next; the events between the two say the same change
//! once more. Held against each other at many places, the two give the shift in time at which they agree best
//! ([`offset()`]), that shift row by row ([`row_time()`]), the log change of one event ([`thresholds()`]),
//! and the length of the exposure that blurs as the frames are blurred ([`exposure()`]). Each comes with a 95
//! % interval, by drawing parts of the picture and pairs of frames again and again.
//!
//! These are proposals for a description that lacks a value, within the size of the interval in scenes that
//! move, none where nothing does.
//!
//! - [`displacement()`]: the shift in whole pixels at which the two agree, over patches ([`Patch`]) of the
//!   array's own pixels.
//! - [`agreements()`]: which of several readings of the events explains most of the frames' change.
//! - [`Panel`]: events and frames of some places, side by side; [`Centring`]: when light changed, from when
//!   events came.
//!
//! Source: the residual of Eq. (13) without its front end; the double integral of Pan et al., CVPR 2019, for
//! the blur. Limits: the latency of the front end and the readout is part of the offset, and differs with
//! light, unless the front end is stated ([`Delay`]); frames with a curve that is not linear give thresholds
//! of that curve. Light that changes between two places of a panel as a whole (an exposure that adapts) is
//! taken out.

mod agree;
mod blur;
mod draw;
mod panel;
mod place;
mod shift;
mod step;

pub use agree::{Agreement, Changes, STEPS, TILE, Trial, Waits, agreements};
pub use blur::{Unclear, exposure};
pub use draw::{Estimate, by_draws};
pub use panel::{Centring, Delay, NOWHERE, Panel, Stretch};
pub use place::{Displacement, FRAME_SIDE, Patch, REACH, SIDE, displacement};
pub use shift::{Drift, Shift, agreement_from, drift, offset, row_time};
pub use step::{StepGains, Steps, step_gains, thresholds};

#[cfg(test)]
mod tests;
