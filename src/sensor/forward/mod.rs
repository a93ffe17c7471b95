//! The sensor forward: light on one pixel goes in, events and frame values come out.
//!
//! The chain is the one that the inverse model undoes: photocurrent, logarithm, low-pass, comparator,
//! in-pixel stamp, readout latency, off-pixel stamp, refractory period, new reference. In contrast to the
//! inverse model nothing is extrapolated: the voltage really moves while the pixel is blind, and the
//! reference is taken at the end. Effects ([`crate::effects`]) enter at every place of the chain; without
//! any, the chain is the paper's.
//!
//! Light is given at instants and is linear between them. Each piece is cut into steps by how much `ln i`
//! changes; within a step the voltage has a closed form (`steps`) and the instant of a crossing is solved
//! for, not rounded to the step. Halving `log_step` divides the error by eight. Front ends without a closed
//! form are integrated with error control instead (`numeric`).
//!
//! - [`LinearLight`]: the light. [`Chain`]: the pixel, its reset rule and its effects. [`simulate`]: events.
//!   [`simulate_events`]: the same for the paper's pixel.
//! - [`read_frames`]: digital numbers of one pixel. [`neighbours`]: light that comes from other pixels.
//!
//! Source: Eqs. (1)-(5) and Section 3; `V_ref` is latched at `t_off + t_rp` ("resample" reset), or moves by
//! one threshold ("advance"). Limits: one pixel, so a queue on the readout bus needs further passes
//! ([`crate::effects::Effect::informed`]); no shot noise of the photocurrent: noise enters as a threshold
//! that varies per event and as events without a crossing.
//!
//! # Example
//!
//! Light that doubles crosses three thresholds of 0.2:
//!
//! ```
//! use photocurrent_sensor::forward::{LOG_STEP, LinearLight, Noiseless, Pixel, simulate_events};
//! use photocurrent_sensor::front_end::FrontEnd;
//!
//! let (threshold_on, threshold_off) = (0.2, 0.2);
//! let pixel = Pixel {
//!     front_end: FrontEnd::IDEAL, threshold_on, threshold_off, latency_ns: 0, latency_spread_ns: 0.0,
//!     refractory_ns: 0, log_step: LOG_STEP,
//! };
//! let light = LinearLight::new(&[0, 10_000_000, 30_000_000], &[100.0, 100.0, 200.0]);
//! let events = simulate_events(&pixel, &light, 0, 30_000_000, &mut Noiseless);
//! assert!(events.iter().all(|event| event.polarity == 1));
//! // 100 exp(0.2) is reached at 10 ms + 20 ms (exp(0.2) - 1) = 14.428 ms.
//! assert_eq!((events.len(), events[0].t_in_ns / 1_000), (3, 14_428));
//! ```

pub mod neighbours;

mod frames;
mod light;
mod numeric;
mod pixel;
mod response;
mod steps;

pub use crate::effects::PixelEvent;
pub use frames::{FrameReadout, read_frames};
pub use light::LinearLight;
pub use numeric::TOLERANCE;
pub use pixel::{Chain, Fired, simulate};

use crate::effects::Site;
use crate::front_end::FrontEnd;
use photocurrent_core::sensor::Reset;

/// The usual step: a crossing is then exact to a part in 100,000 of the time that the light takes for the
/// step, some nanoseconds.
pub const LOG_STEP: f64 = 0.025;

/// What the simulated pixel is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pixel {
    /// The low-pass of Eq. (3).
    pub front_end: FrontEnd,
    /// Contrast threshold of an ON event, positive, natural-log units.
    pub threshold_on: f64,
    /// Contrast threshold of an OFF event, positive, natural-log units.
    pub threshold_off: f64,
    /// The part of the readout latency that is always there, nanoseconds, not negative.
    pub latency_ns: i64,
    /// Mean of the exponentially distributed part of the readout latency, nanoseconds, not negative.
    pub latency_spread_ns: f64,
    /// Refractory period after `t_off`, nanoseconds, not negative.
    pub refractory_ns: i64,
    /// The most by which ln i changes over one step of the low-pass, positive; [`LOG_STEP`] unless errors are
    /// studied.
    pub log_step: f64,
}

/// Where the simulated pixel gets its randomness from; the methods' defaults are "none".
pub trait PixelNoise {
    /// A number of [0, 1) for the next readout latency. Zero gives the constant latency alone.
    fn uniform(&mut self) -> f64 {
        0.0
    }

    /// Added to both thresholds from one event to the next, natural-log units.
    fn threshold_offset(&mut self) -> f64 {
        0.0
    }
}

/// A pixel without noise.
#[derive(Clone, Copy, Debug, Default)]
pub struct Noiseless;

impl PixelNoise for Noiseless {}

/// The events of one pixel of the paper's model from `start_ns` to `end_ns`, in time order: [`simulate`]
/// without effects.
///
/// The pixel starts settled (Eq. 6), armed, and with the reference at its voltage. Events whose `t_in` lies
/// in the span are put out even when their `t_off` does not.
///
/// # Panics
///
/// When `log_step` is not positive.
pub fn simulate_events(
    pixel: &Pixel,
    light: &LinearLight<'_>,
    start_ns: i64,
    end_ns: i64,
    noise: &mut impl PixelNoise,
) -> Vec<PixelEvent> {
    let chain = Chain { pixel: *pixel, reset: Reset::Resample, effects: &[], tolerance: TOLERANCE };
    let site = Site { x: 0, y: 0, width: 1, height: 1, seed: 0 };
    simulate(&chain, &site, light, start_ns, end_ns, noise).into_iter().map(|fired| fired.event).collect()
}

#[cfg(test)]
pub(crate) mod tests;
