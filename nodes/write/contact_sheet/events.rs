//! Events as colour: counted over a window around each instant, ON in red, OFF in blue, on white.
//!
//! The mixing is that of two inks: ON events take green and blue away from the white, OFF events take red and
//! green away. So a pixel that saw only one polarity is a pure tint, and one that saw both (something narrow
//! passed) is purple-grey to black instead of looking idle.

use crate::crop::Crop;
use photocurrent_core::events::EventRow;
use photocurrent_core::{Colour, EventStream, NodeError, Rows, TimeSpan};
use photocurrent_solve::co_located::CoLocated;

/// Rows that are read at a time, so that a long recording need not fit into memory.
const BAND_ROWS: u32 = 32;

/// What one pixel saw: ON and OFF events.
pub(super) type Count = [u32; 2];

/// Counts each pixel's events of the crop in each window, start included and end excluded:
/// `[window][row][x]`. Stamps are off-pixel times less `shift_ns`.
///
/// # Errors
/// When the events cannot be read. Rows and columns of the crop are pixels of the frames, of which `ratio`
/// lie along the side of an event pixel: each shows its event pixel.
pub(super) fn counted(
    events: &EventStream,
    ratio: u32,
    windows: &[TimeSpan],
    shift_ns: i64,
    crop: Crop,
) -> Result<Vec<Vec<Count>>, NodeError> {
    let mut counts = vec![vec![[0; 2]; crop.width as usize * crop.height as usize]; windows.len()];
    let lie = CoLocated { ratio, colour: Colour::Mono };
    let columns = crop.x..crop.x + crop.width;
    for rows in (Rows { start: crop.y, end: crop.y + crop.height }).bands(BAND_ROWS) {
        let band = lie.read(events, rows)?;
        for y in rows.iter() {
            let count = |row: EventRow| {
                let start = (y - crop.y) as usize * crop.width as usize;
                for (window, counts) in windows.iter().zip(&mut counts) {
                    let before = |ns: i64| row.t.partition_point(|t| t - shift_ns < ns);
                    for k in before(window.start.0)..before(window.end.0) {
                        let x = u32::from(row.x[k]);
                        if columns.contains(&x) {
                            counts[start + (x - crop.x) as usize][usize::from(row.on[k] == 0)] += 1;
                        }
                    }
                }
            };
            band.with_row(y, count)?;
        }
    }
    Ok(counts)
}

/// Red, green and blue of a count; `full` events of one polarity have its full colour, fewer a tint in
/// proportion.
pub(super) fn colour([on, off]: Count, full: u32) -> [u8; 3] {
    let ink = |count: u32| f64::from(count.min(full)) / f64::from(full);
    let (on, off) = (ink(on), ink(off));
    [off, on.max(off), on].map(|taken| (255.0 * (1.0 - taken)).round() as u8)
}
