//! The MAP estimate of one pixel: all its events and frames at once, through the exact sensor.
//!
//! Unknown is u(t) = ln i(t), linear between knots, so light is positive without a constraint. The voltage
//! follows by the exact response to ramps; the reference is latched when the readout is over ("resample") or
//! when the event fires ("advance"); every event says that voltage and reference were one threshold apart
//! when it fired; every frame says how much light its own row collected. A prior says that light moves with a
//! speed that lasts a while, with a variance of its own at every place in time ([`Prior`]).
//!
//! The maximum of the posterior is found by Gauss-Newton steps. Each is one pass forward and one backward
//! over a chain of small states: the cost is linear in the number of knots. The posterior standard deviation
//! comes from the same passes.
//!
//! Nothing of this is trusted blindly: how far events are trusted and which prior suits is chosen by frames
//! that are held out ([`estimate`]).
//!
//! Limits: one pixel alone, nothing from its neighbours; the local variance is estimated from the estimate,
//! so standard deviations are too small where nothing was measured; the time constant is held over a segment.
//!
//! # Example
//!
//! The events of one pixel, simulated, and two frame values:
//!
//! ```
//! use photocurrent_core::sensor::Reset;
//! use photocurrent_sensor::forward::{LOG_STEP, LinearLight, Noiseless, Pixel, simulate_events};
//! use photocurrent_sensor::front_end::FrontEnd;
//! use photocurrent_sensor::map::{
//!     MapFrame, MapGroup, MapOptions, MapProblem, MapSensor, MapStatus, solve,
//! };
//!
//! const MS: i64 = 1_000_000;
//! let (front_end, threshold_on, threshold_off) = (FrontEnd { tau_0_s: 20e-6, alpha_s: 2e-3 }, 0.15, 0.15);
//! let pixel = Pixel {
//!     front_end, threshold_on, threshold_off, latency_ns: 1_000, latency_spread_ns: 0.0, refractory_ns: 0,
//!     log_step: LOG_STEP,
//! };
//! let light = LinearLight::new(&[0, 10 * MS, 30 * MS, 50 * MS], &[100.0, 100.0, 200.0, 200.0]);
//! let events = simulate_events(&pixel, &light, 0, 50 * MS, &mut Noiseless);
//!
//! // 100 for 5 ms at 1000 DN per unit and second, and 200.
//! let frame = |start_ns, dn| MapFrame {
//!     start_ns, end_ns: start_ns + 5 * MS, dn, sigma_dn: 2.0, saturated: false,
//! };
//! let frames = [frame(MS, 500.0), frame(40 * MS, 1000.0)];
//! let (reset, gain, black_level_dn) = (Reset::Resample, 1000.0, 0.0);
//! let sensor = MapSensor {
//!     front_end, threshold_on, threshold_off, reset, refractory_ns: 0, gain, black_level_dn,
//!     saturation_dn: 4095.0,
//! };
//!
//! let mut memory = MapGroup::default();
//! let solution = solve(
//!     &MapProblem::new(sensor, &events, &frames, (0, 50 * MS)), &MapOptions::default(), &mut memory,
//! );
//! assert_ne!(solution.outcome.status, MapStatus::Failed);
//! // Between events the light is known to a threshold.
//! for (t_ns, log) in solution.t_ns.iter().zip(solution.log_photocurrent) {
//!     let light = 100.0 + 5e-6 * (t_ns - 10 * MS).clamp(0, 20 * MS) as f64;
//!     assert!((log - light.ln()).abs() < threshold_on);
//! }
//! ```

mod curvature;
mod elsewhere;
pub mod estimate;
#[cfg(test)]
mod estimate_tests;
pub mod frame_noise;
mod group;
mod knots;
pub mod laid;
pub mod losses;
#[cfg(test)]
mod misfit_tests;
mod options;
mod prior;
mod problem;
mod segment;
mod start;
mod state;
#[cfg(test)]
mod tests;
mod thresholds;

pub use crate::comparator::PixelEvent;
pub use elsewhere::{Elsewhere, MapMeans, Pictured};
pub use group::MapGroup;
pub use knots::COARSEST;
pub use options::{MapOptions, MapOutcome, MapSolution, MapStatus, MapTask, Second, SecondStart};
pub use prior::{Local, Prior};
pub use problem::{Hint, LoneEvents, MapFrame, MapProblem, MapSensor, Noise, Offsets};
pub use segment::ramp_voltage;

/// Solves one pixel.
pub fn solve<'g>(problem: &MapProblem<'_>, options: &MapOptions, group: &'g mut MapGroup) -> MapSolution<'g> {
    group.solve_one(&MapTask { problem: *problem, options: *options })
}
