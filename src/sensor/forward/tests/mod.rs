//! The forward model against algebra and against another integrator.

mod closed_forms;
mod convergence;
mod euler;
mod hooks;
mod openeb;
pub(crate) mod plane;
mod resets;
