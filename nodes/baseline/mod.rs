//! Other methods in the same roles, so that they can stand beside ours.

pub mod contrast;
pub mod edi;
pub mod repeat;
