//! The MAP estimate of pixels and means of their light on a graphics card, or on whatever else has a Vulkan
//! driver.
//!
//! [`Card`] takes the tasks that [`photocurrent_sensor::map::MapGroup`] takes and gives the same answers but
//! for rounding: log light to about 1e-5, its standard deviation to about a tenth of a per cent
//! (`tests/card` holds both). The processor lays pixels out by the solver's own code
//! ([`photocurrent_sensor::map::laid`]): knots, what happens at them, neighbourhoods of the prior, the start.
//! The card does what is costly and alike for all pixels: Gauss-Newton steps, second starts, evidence and
//! variances; one thread a pixel, pixels of about one length side by side in memory.
//!
//! Steps are in single precision: unknowns are increments of log light, and voltages are kept as differences,
//! so that nothing large is subtracted. Variances are differences of covariances before and after
//! measurements, of which single precision leaves nothing, so the last pass is in double precision, or in
//! pairs of numbers where a card has none.
//!
//! Means over exposures are taken of tracks that are brought to the card (`means`), or of answers that never
//! leave it (`pictures`).
//!
//! Limits: pixels with hints ([`photocurrent_sensor::map::MapProblem::hints`]) are not taken
//! ([`Card::takes`]). Bits depend on the card, its driver and its compiler ([`Card::name`]).

#![warn(unreachable_pub)]

mod adapter;
mod card;
mod descent;
mod layout;
mod means;
mod pictures;
mod speed;
mod structs;
mod template;

pub use adapter::ADAPTER_VARIABLE;
pub use card::{Card, CardOptions};
pub use descent::Unsolved;
pub use speed::CopySpeeds;

/// What names the card that [`Card::open`] would take: name, driver and its version. Results depend on it.
///
/// # Errors
/// When there is no card, or none of the name in [`ADAPTER_VARIABLE`].
pub fn card_name() -> Result<String, photocurrent_core::NodeError> {
    adapter::name(adapter::wanted().as_deref())
}
