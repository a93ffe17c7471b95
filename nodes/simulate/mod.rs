//! Recordings with known truth.

pub mod camera;
pub mod instants;
pub mod moved;
pub mod photo;
pub mod scene;
pub mod scenes;
pub mod sensor;
pub mod source;
pub mod stored;
pub mod video;
