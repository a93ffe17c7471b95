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
//! for, not rounded to the step. Halving `log_step` divides the error by 32. Front ends without a closed
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

pub use crate::comparator::PixelEvent;
pub use crate::model::{LOG_STEP, Pixel};
pub use frames::{FrameReadout, read_frames};
pub use light::LinearLight;
pub use numeric::TOLERANCE;
pub use pixel::{Chain, Fired, Noiseless, PixelNoise, simulate, simulate_events};

#[cfg(test)]
pub(crate) mod tests;
