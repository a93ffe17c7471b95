//! Recordings with known truth.

pub mod camera;
pub mod instants;
mod load;
pub mod moved;
pub mod photo;
mod pixel_light;
pub mod pooled;
pub mod scene;
pub mod scenes;
pub mod sensor;
pub mod source;
pub mod stored;
pub mod video;
