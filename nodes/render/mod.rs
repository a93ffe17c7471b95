//! From photocurrent to pictures.

pub mod demosaic;
pub mod rows;
