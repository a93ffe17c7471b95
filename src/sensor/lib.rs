//! The physics of a hybrid sensor that takes frames (CIS) and events (EVS) with one photodiode array.
//!
//! Every equation of the model is written once, here, and the simulator, the solver and the diagnosis all
//! call it. The crate knows no files, no graphs and no image layout: it sees one pixel (or one pixel row) at
//! a time, as plain slices of seconds, nanoseconds, photocurrents and natural-log voltages.
//!
//! The equations follow "Sensor inverse modeling" (Eqs. 1-13); deviations are said where they happen.
//!
//! In reading order:
//!
//! - [`elementary`]: exponential and logarithm that vectorise.
//! - [`scalar`]: the numbers the equations are written over: `f64`, dual numbers, lanes.
//! - [`lanes`]: sixteen pixels side by side, as a number of the equations; `wide`: eight of them in double
//!   precision.
//! - [`front_end`]: photocurrent to front-end voltage, a light-dependent low-pass, Eqs. (1)-(3).
//! - [`comparator`]: when a voltage change becomes an event, Eq. (4).
//! - [`readout`]: the voltage change missed during readout and refractory period, Eqs. (9)-(12).
//! - [`pooling`]: the light of an event pixel that lies on several frame pixels or colours.
//! - [`exposure`]: row timing and the exposure integral of a frame, Eq. (5); [`integrate`]: the same on
//!   another processor.
//! - [`forward`]: light in, events and frame values out, for one pixel.
//! - [`array`](mod@array): what each pixel of a simulated array records.
//! - [`model`]: a description in numbers.
//! - [`conditional`]: recorded events and frames of one pixel, seen through any effects, given its light.
//! - [`residuals`]: measured minus predicted for a candidate photocurrent, with its Jacobian.
//! - [`inverse`]: events and frames in, photocurrent out: the least-squares problem of Eq. (13).
//! - [`map`]: the same with knots that are fine, the exact reset and a prior: the MAP estimate.
//! - [`mixing`]: whose photocurrent an event pixel sees; [`undo`]: what effects did to measurements, undone.
//! - [`estimate`]: what a file does not say and its own events and frames do: offset, exposure, row time,
//!   thresholds.
//! - [`effects`]: non-idealities beyond the model above, one file each; [`form`]: formulas of curves.
//!
//! Results are the same bits on every machine: no fused multiply-add and no platform `exp` or `ln`
//! ([`elementary`] and the `libm` crate instead). Keep it so; a method call such as `x.exp()` on an `f64` is
//! the platform's.

#![warn(unreachable_pub)]

pub mod array;
pub mod comparator;
pub mod conditional;
pub mod effects;
pub mod elementary;
pub mod estimate;
pub mod exposure;
pub mod form;
pub mod forward;
pub mod front_end;
pub mod integrate;
pub mod inverse;
pub mod lanes;
pub mod map;
mod misfit;
pub mod mixing;
pub mod model;
pub mod pooling;
pub mod readout;
pub mod residuals;
pub mod scalar;
pub mod undo;
pub(crate) mod wide;
