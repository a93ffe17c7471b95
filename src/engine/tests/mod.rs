//! The engine's claims, shown with toy nodes: graphs without sensors.

mod bench;
mod blocks;
mod exports;
mod film;
mod folder;
mod mistakes;
mod overlays;
mod pictures;
mod running;
mod toys;
mod troubles;
