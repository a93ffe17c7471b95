//! Words of Prophesee cameras without the text header that says how they are encoded and how large the array
//! is.
//!
//! Programs that cut a recording, or take words straight from the camera, leave it out. The words themselves
//! show which of three encodings they are: the kind in the upper four bits of each, and high parts of the
//! time that never step back by more than one turn.

use super::Instead;
use crate::format::Probe;

/// Words that decide it, at least.
const FEWEST: usize = 64;

/// RAW words, of the first bytes of a file that nothing else explains.
pub(super) fn words(probe: &Probe) -> Option<Instead> {
    let head = probe.head.as_slice();
    if probe.names.is_some() || head.len() < 2 * FEWEST || head.starts_with(b"%") {
        return None;
    }
    let kind = [("2.1", is_evt21(head)), ("2.0", is_evt2(head)), ("3.0", is_evt3(head))]
        .into_iter()
        .find(|(_, is)| *is)?
        .0;
    let short = kind.trim_end_matches(".0").replace('.', "");
    let name = probe.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let todo = format!(
        "write the header that is missing, with the size of your sensor: `printf '%% evt {kind}\\n\
         %% format EVT{short};height=720;width=1280\\n%% end\\n' | cat - {name} > \
         with_header.raw`"
    );
    Some(Instead::new(
        format!("a file without a header that looks like EVT{} words", kind.trim_end_matches(".0")),
        todo,
    ))
}

/// Words of 16 bits.
fn is_evt3(head: &[u8]) -> bool {
    let words: Vec<u16> = head.as_chunks::<2>().0.iter().map(|bytes| u16::from_le_bytes(*bytes)).collect();
    let of = |kind: u16| words.iter().filter(|word| **word >> 12 == kind).count();
    // Row, single event, base of a vector, two vectors, low and high time, continued words, triggers, others.
    let known = words.iter().filter(|word| matches!(*word >> 12, 0 | 2..=8 | 10 | 14 | 15)).count();
    let highs: Vec<u32> =
        words.iter().filter(|word| *word >> 12 == 8).map(|word| u32::from(word & 0xfff)).collect();
    let events = of(2) + of(4) + of(5);
    known * 100 >= words.len() * 99 && of(0) > 0 && events > 0 && of(6) > 0 && rise(&highs, 1 << 12)
}

/// Words of 32 bits.
fn is_evt2(head: &[u8]) -> bool {
    let words: Vec<u32> = head.as_chunks::<4>().0.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect();
    let known = words.iter().filter(|word| matches!(*word >> 28, 0 | 1 | 8 | 10 | 14 | 15)).count();
    let highs: Vec<u32> =
        words.iter().filter(|word| *word >> 28 == 8).map(|word| word & 0xfff_ffff).collect();
    let events = words.iter().filter(|word| *word >> 28 <= 1).count();
    known * 100 >= words.len() * 99 && events > 0 && rise(&highs, 1 << 28)
}

/// Words of 64 bits.
fn is_evt21(head: &[u8]) -> bool {
    let words: Vec<u64> = head.as_chunks::<8>().0.iter().map(|bytes| u64::from_le_bytes(*bytes)).collect();
    let known = words.iter().filter(|word| matches!(*word >> 60, 0 | 1 | 8 | 10 | 14 | 15)).count();
    let highs: Vec<u32> =
        words.iter().filter(|word| *word >> 60 == 8).map(|word| (word >> 32) as u32 & 0xfff_ffff).collect();
    // An event without a valid pixel is none.
    let events = words.iter().filter(|word| *word >> 60 <= 1 && **word as u32 != 0).count();
    let empty = words.iter().filter(|word| *word >> 60 <= 1 && **word as u32 == 0).count();
    known * 100 >= words.len() * 99 && events > 0 && empty * 10 <= events && rise(&highs, 1 << 28)
}

/// Are there high parts of the time, and do they rise in small steps, but for a turn of their range?
fn rise(highs: &[u32], range: u32) -> bool {
    let small = |pair: &[u32]| (pair[1] + range - pair[0]) % range <= range / 64;
    highs.len() >= 2 && highs.windows(2).all(small)
}
