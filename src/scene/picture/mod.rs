//! The scene as one moving picture, fitted to frames alone.
//!
//! Many scenes are coherent: one picture moves, and every place of it is seen by many pixels in many frames,
//! whose exposure, row time and gain are known, without any event. So the picture, how it lies on the array
//! at every instant, and the static shading of the array are fitted to all frame values at once. What it
//! predicts at an event's instant is then independent of that event.
//!
//! - [`spline`]: the surface.
//! - [`motion`]: how it lies on the array over time.
//! - [`register`]: how one frame lies on the next; where the fit starts.
//! - [`shading`]: the array's own shading.
//! - [`rows`]: frame values as rows of one problem. [`system`]: the sparse least-squares problem.
//! - [`products`]: what solving it spends its time in.
//! - [`begin`]: how motion begins.
//! - [`estimate`]: the rounds. `setting`: how they are made. `lay`: frame values as rows of that problem.
//! - `coverage`: its light on a pixel, and how many exposures cover each of its places.
//! - [`sharpen`]: a picture as sharp as it may be.
//! - [`patches`]: parts of the array with a picture each.
//!
//! Sources: Lucas and Kanade, IJCAI 1981; Irani and Peleg, Improving Resolution by Image Registration, CVGIP
//! 1991; Björck, Numerical Methods for Least Squares Problems, 1996.
//!
//! Limits: one affine motion for each picture; what moves before something that moves as well has parts only;
//! a surface that is sharper than its pitch is softened.

pub(crate) mod begin;
mod coverage;
pub(crate) mod estimate;
mod lay;
pub(crate) mod motion;
pub mod patches;
mod products;
pub(crate) mod register;
pub(crate) mod rows;
mod setting;
pub(crate) mod shading;
pub(crate) mod sharpen;
pub(crate) mod spline;
pub(crate) mod system;

pub use estimate::{FitStart, PictureReport, ScenePicture};
pub use setting::PictureSetting;
pub(crate) use setting::{FRAME_NOISE, MOTION_WEIGHT, ROBUST, STRETCH};
