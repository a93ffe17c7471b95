//! Other methods in the same roles, so that they can be compared with ours.

pub mod akf;
pub mod cf;
pub mod contrast;
pub mod edi;
pub mod exec;
pub mod external;
pub mod onnx;
pub mod repeat;

#[cfg(test)]
pub(crate) mod reference;
