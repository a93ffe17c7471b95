//! From photocurrent to pictures.

pub mod colour;
pub mod demosaic;
pub mod grey;
mod reading;
pub mod rows;
