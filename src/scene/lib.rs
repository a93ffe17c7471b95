//! The scene of a recording, estimated from frames alone (or stated by the user), and the motion in it.
//!
//! Every estimate is a [`Scene`]: log photocurrent of any pixel at any instant, with the residuals of frames.
//! This light is independent of the events with which it is compared.
//!
//! - [`case`]: a recording in memory: events by pixel, frames ([`grey`]: one value for each event pixel), the
//!   description; [`nominal`]: the sensor that it states; [`block`]: a rectangle of its pixels.
//! - [`scene`]: the trait of scenes. [`moving`]: one moving [`picture`]. [`mosaic`]: that picture, or
//!   pictures of parts where they predict frames better. [`free`]: a scene that follows events as well:
//!   [`joint`], one moving picture of frames and events; [`pixels`], the light of each pixel, free in time.
//!   [`known`]: light that is known. [`target`]: a scene in closed form with free parameters.
//! - [`closed`]: scenes in closed form, for simulators and targets.
//! - [`light`]: log photocurrent of an array at steady instants; [`gate`]: the events at which a scene
//!   predicts the frames.
//! - [`flow`]: velocities over the array, from a [`film`] of solved tracks; [`activity`]: where they are
//!   estimated. [`image`]: a picture and its values between pixels. [`hue`]: the hue of captured frames,
//!   carried along the motion.
//!
//! The crate uses no files and no graphs. It never reads true light.

#![warn(unreachable_pub)]

pub mod activity;
pub mod alignment;
pub mod block;
pub mod case;
pub mod closed;
pub mod film;
pub mod flow;
pub mod free;
pub mod gate;
pub mod grey;
pub mod hue;
pub mod image;
pub mod joint;
pub mod known;
pub mod light;
pub mod misalignment;
pub mod mosaic;
pub mod moving;
pub mod nominal;
pub mod picture;
pub mod pixels;
pub mod recorded;
pub mod scene;
pub mod statistics;
pub mod target;

#[cfg(test)]
mod testing;

pub use scene::{FrameTolerance, FreeParameters, Scene, SceneCell};
