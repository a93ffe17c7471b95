//! From photocurrent to pictures.

pub mod demosaic;
mod reading;
pub mod rows;
