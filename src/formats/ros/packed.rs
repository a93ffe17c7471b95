//! Messages that rosbag2 compressed one by one (`compression_mode: message`): a Zstandard frame stands where
//! a message should.
//!
//! No message of ROS 2 begins as such a frame does: its first byte is 0.

use super::piece::{Envelope, MOST_MESSAGE};
use std::io::Read;

const MAGIC: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];

/// Replaces a compressed message by the first `most` bytes of what it holds, and states the length of that;
/// leaves any other as it is.
///
/// # Errors
/// When the message cannot be decompressed, or is too long.
pub(super) fn unpack(envelope: Envelope, most: u64, body: &mut Vec<u8>) -> Result<Envelope, String> {
    if !body.starts_with(MAGIC) {
        return Ok(envelope);
    }
    // `body` may hold the beginning only: then the frame is read as far as it goes.
    let whole = body.len() as u64 == envelope.length;
    let mut decoder =
        zstd::stream::read::Decoder::with_buffer(body.as_slice()).map_err(|error| error.to_string())?;
    // The window that a frame asks for is allocated at once; recorders ask for 8 MiB at most.
    decoder.window_log_max(25).map_err(|error| error.to_string())?;
    let mut unpacked = Vec::new();
    let limit = if whole { MOST_MESSAGE + 1 } else { most };
    let read = decoder.take(limit).read_to_end(&mut unpacked);
    if let Err(error) = read.and_then(|_| {
        if unpacked.is_empty() { Err(std::io::ErrorKind::UnexpectedEof.into()) } else { Ok(()) }
    }) && (whole || unpacked.is_empty())
    {
        return Err(format!("the message cannot be decompressed ({error})"));
    }
    if unpacked.len() as u64 > MOST_MESSAGE {
        return Err(format!("a message decompresses to more than {MOST_MESSAGE} bytes"));
    }
    // Of a beginning the length of the whole is not known: it has as many bytes as are claimed, or reading it
    // says otherwise.
    let length = if whole { unpacked.len() as u64 } else { MOST_MESSAGE };
    unpacked.truncate(usize::try_from(most).unwrap_or(usize::MAX));
    *body = unpacked;
    Ok(Envelope { length, ..envelope })
}
