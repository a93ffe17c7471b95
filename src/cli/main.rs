//! The photocurrent command.
fn main() {}
