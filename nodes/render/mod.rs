//! From photocurrent to pictures.

pub mod rows;
