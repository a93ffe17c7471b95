//! Events as colour: counted over a window around each instant; ON in red, OFF in blue, on white; or over a
//! picture, ON in orange, OFF in light blue, as a page that plays a recording has them.
//!
//! On white, the mixing is that of two inks: ON events take green and blue away from the white, OFF events
//! take red and green away. So a pixel that saw only one polarity is a pure tint, and one that saw both
//! (something narrow passed) is purple-grey to black instead of looking idle. Over a picture, colours cover
//! what is below, the more the more events there are, and both polarities give a colour between. Orange and
//! light blue (after Okabe and Ito, Color Universal Design, 2008) are distinguished by colour-blind eyes, and
//! on dark and bright pictures.

use crate::crop::Crop;
use photocurrent_core::events::EventRow;
use photocurrent_core::{Colour, EventStream, NodeError, Rows, TimeSpan};
use photocurrent_solve::co_located::CoLocated;

/// Rows that are read at a time, so that a long recording need not fit into memory.
const BAND_ROWS: u32 = 32;

/// Red, green and blue of ON events over a picture.
const OVER_ON: [u8; 3] = [240, 138, 75];
/// Red, green and blue of OFF events over a picture.
const OVER_OFF: [u8; 3] = [92, 179, 232];
/// What is left of the picture after an event, and again after the next.
const LEFT: f64 = 0.4;
/// More events change no code of 8 bits.
const MOST: u32 = 8;

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

/// Red, green and blue of a pixel of a picture with its events over it.
pub(super) fn over(picture: [u8; 3], [on, off]: Count) -> [u8; 3] {
    let all = on + off;
    if all == 0 {
        return picture;
    }
    let left = (0..all.min(MOST)).fold(1.0, |left, _| left * LEFT);
    let share = f64::from(on) / f64::from(all);
    [0, 1, 2].map(|channel| {
        let ink = share * f64::from(OVER_ON[channel]) + (1.0 - share) * f64::from(OVER_OFF[channel]);
        (left * f64::from(picture[channel]) + (1.0 - left) * ink).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_cover_a_picture_the_more_there_are() {
        assert_eq!(over([7, 8, 9], [0, 0]), [7, 8, 9]);
        // By hand: 0.4 x 100 + 0.6 x 240 = 184, 0.4 x 100 + 0.6 x 138 = 122.8, 0.4 x 100 + 0.6 x 75 = 85.
        assert_eq!(over([100; 3], [1, 0]), [184, 123, 85]);
        // 0.16 of 100 is left below 0.84 of the colour halfway: 166, 158.5 and 153.5.
        assert_eq!(over([100; 3], [1, 1]), [155, 149, 145]);
        assert_eq!(over([0; 3], [0, 50]), OVER_OFF);
    }
}
