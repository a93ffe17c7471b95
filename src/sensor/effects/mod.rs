//! Non-idealities beyond the paper's model, one file each.
//!
//! An effect lives in one place so that the simulator can add it, the solver can undo it and the diagnosis
//! can name it. Each file says what the effect is, how it enters, its parameters with unit and plausible
//! range, what it is confused with, and its source.
//!
//! - [`clock_offset`]: the event clock and the frame clock start at different instants.

pub mod clock_offset;
