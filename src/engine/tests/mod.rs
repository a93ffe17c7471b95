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

use crate::{Plan, TaskId};

impl Plan {
    /// The task of a node in a variant.
    fn task_of(&self, variant: &str, node: &str) -> Option<TaskId> {
        let variant = self.variants.iter().find(|v| v.name == variant)?;
        variant.nodes.iter().find(|(id, _)| id == node).map(|(_, task)| *task)
    }
}
