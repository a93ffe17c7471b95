//! The engine's claims, shown with toy nodes: graphs without sensors.

mod exports;
mod folder;
mod mistakes;
mod overlays;
mod pictures;
mod running;
mod toys;
mod troubles;
