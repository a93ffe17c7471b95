//! What pages show of values: pictures of 8 bits, events of a stretch of time, and single pixels in numbers.
//! No node kinds stand here: the command asks for what is shown of files, and of results that nodes have left
//! in the cache.

mod packed;
mod pictures;
mod pixels;

pub use packed::{Packed, Packer, clock_offset_ns};
pub use pictures::{Shown, Tone};
pub use pixels::{Exposed, Photocurrent, Seen, Stamp, lively, seen, solved};
