//! What a report shows of stored values: pictures of 8 bits, and single pixels in numbers. No node kinds
//! stand here: the command asks for what is shown of results that nodes have left in the cache.

mod pictures;
mod pixels;

pub use pictures::{Shown, Tone};
pub use pixels::{Exposed, Photocurrent, Seen, Stamp, lively, seen, solved};
