//! Readings of one recording held against each other: an offset, mirrored or moved places, other signs, each
//! judged by how much of the frames' change its events explain.
//!
//! A shift in time can look like much, such as a picture shifted by a pixel along its motion. So nothing is
//! concluded from one reading alone: [`compare`] counts the same events under every [`Alternative`] and
//! measures each on pairs of frames that its thresholds and offset were not fitted on
//! ([`photocurrent_sensor::estimate::agreements`]). The best, the second best and their distance decide, or
//! that nothing does ([`decided`]).
//!
//! ```no_run
//! # fn f(recording: &dyn photocurrent_formats::Recording) -> Result<(), photocurrent_formats::FormatError> {
//! use photocurrent_formats::survey::alternatives::{Alternative, compare, decided, Much};
//! let alternatives = [
//!     Alternative::new("as read").fitting_offset(),
//!     Alternative::new("two pixels right").shifted(2, 0).fitting_offset(),
//!     Alternative::new("mirrored left to right").mirrored(true, false).fitting_offset(),
//! ];
//! let scored = compare(recording, &alternatives, &Much::default())?;
//! match decided(&scored) {
//!     Some(best) => println!("{}: explains {:.2}", best.name, best.explained.value),
//!     None => scored.iter().for_each(|one| println!("a question for the user: {}", one.name)),
//! }
//! # Ok(())
//! # }
//! ```
//!
//! A reading with an offset of its own explains whatever is a constant shift (a strobe read upside down, a
//! stamp that means the exposure's end): hold readings without one against each other first, and let an
//! offset be fitted where none of them is clear.
//!
//! Limits: no reading is preferred where nothing moves. Of a picture that moves one way, a shift along the
//! motion and lateness explain the same; that shows as two readings close to each other. Of [`PAIRS`] pairs
//! of frames the [`A_PAIR`] tiles that change most are evaluated.

use super::interval::Interval;
use super::pictures::middle;
use super::places::MOST_PIXELS;
use crate::chunk::EventChunk;
use crate::error::FormatError;
use crate::recording::{FramesAbout, Pictures, Recording};
use photocurrent_core::Extent;
use photocurrent_sensor::estimate::{Changes, TILE, Trial, Waits, agreements};
use serde::Serialize;

/// Pairs of frames, at most, spread over the time that events and frames share.
pub const PAIRS: usize = 16;
/// Tiles of a pair.
pub const A_PAIR: usize = 96;
/// Readings that are counted in one pass over the events.
const AT_ONCE: usize = 8;
/// Parts of the picture in each direction, for intervals.
const PARTS: usize = 4;
/// A step of the grey scale, as a part of the largest value: added before the logarithm.
const DARK: f32 = 1.0 / 255.0;
/// Share of the change that the best reading must explain, at least, to decide anything.
pub const LEAST_EXPLAINED: f64 = 0.05;
/// Share of the change by which the second best must be behind, at least.
pub const LEAST_AHEAD: f64 = 0.02;

/// How the events of a recording could be meant. Nothing is changed where nothing is stated:
/// [`Alternative::new`] is the recording as it was read.
#[derive(Clone, Debug, PartialEq)]
pub struct Alternative {
    /// What it is, for reports.
    pub name: String,
    /// Is an offset of up to a frame period to each side fitted too, on the half of the pairs that is not
    /// measured?
    pub fits_offset: bool,
    /// Mirrored left to right, and top to bottom, within the picture.
    pub mirrored: (bool, bool),
    /// Pixels by which the events' picture is moved right and down, after mirroring.
    pub shifted: (i32, i32),
    /// ON and OFF exchanged.
    pub inverted: bool,
}

impl Alternative {
    /// The recording as it was read.
    pub fn new(name: impl Into<String>) -> Alternative {
        Alternative {
            name: name.into(),
            fits_offset: false,
            mirrored: (false, false),
            shifted: (0, 0),
            inverted: false,
        }
    }

    /// Fits an offset of up to a frame period as well.
    #[must_use]
    pub fn fitting_offset(self) -> Alternative {
        Alternative { fits_offset: true, ..self }
    }

    /// Mirrors the events' picture.
    #[must_use]
    pub fn mirrored(self, left_right: bool, top_bottom: bool) -> Alternative {
        Alternative { mirrored: (left_right, top_bottom), ..self }
    }

    /// Moves the events' picture by whole pixels of the events.
    #[must_use]
    pub fn shifted(self, right: i32, down: i32) -> Alternative {
        Alternative { shifted: (right, down), ..self }
    }

    /// Exchanges ON and OFF.
    #[must_use]
    pub fn inverted(self) -> Alternative {
        Alternative { inverted: true, ..self }
    }
}

/// How much is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Much {
    /// First and last stamp of the events as they are read, ns, where that is known: otherwise the events are
    /// read once more for it. Strays are best left out.
    pub span_ns: Option<(i64, i64)>,
    /// Events that are read, at most.
    pub events: u64,
    /// Size of the event array, in place of the one that is recorded.
    pub extent: Option<Extent>,
}

impl Default for Much {
    fn default() -> Much {
        Much { span_ns: None, events: 50_000_000, extent: None }
    }
}

/// How well a reading agrees with the frames.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Scored {
    /// Which of the alternatives, from 0.
    pub alternative: usize,
    /// Its name.
    pub name: String,
    /// Share of the frames' log change that its events explain on held-out pairs of frames, with its 95 %
    /// interval; 1 = all, 0 = none.
    pub explained: Interval,
    /// How much more the best one explains, with the interval of that difference over the same parts of the
    /// picture.
    pub behind: Interval,
    /// Correlation of what the events predict with the change, on held-out pairs.
    pub correlation: f64,
    /// The offset that was fitted, ns: events are later by so much, in the time of this reading; zero where
    /// none is fitted.
    pub late_ns: f64,
    /// Thresholds that fit, ON and OFF, natural-log units: proportions of places of one pixel, no proposal
    /// for a sensor.
    pub thresholds: (f64, f64),
    /// Pairs of frames that have events between them, and all that were evaluated.
    pub pairs: (usize, usize),
}

/// The best of some scored readings, best first, where it is clear: it explains something, and the second
/// best less.
pub fn decided(scored: &[Scored]) -> Option<&Scored> {
    let best = scored.first().filter(|best| best.explained.ci95.0 > LEAST_EXPLAINED)?;
    scored
        .get(1)
        .is_none_or(|second| second.behind.ci95.0 > 0.0 && second.behind.value > LEAST_AHEAD)
        .then_some(best)
}

/// The pixels on which frames and events are compared: those of the events where the frames are a whole
/// multiple of them, otherwise those of the frames.
#[derive(Clone, Copy, Debug)]
struct Canvas {
    width: usize,
    height: usize,
    /// Frame pixels to one, in each direction.
    times: usize,
    /// Event pixels to one, in each direction.
    divides: usize,
    channels: usize,
}

impl Canvas {
    fn of(frames: &FramesAbout, events: Option<Extent>) -> Option<Canvas> {
        let (f, e) = (frames.extent, events.unwrap_or(frames.extent));
        let multiple = |a: Extent, b: Extent| {
            let times = a.width / b.width.max(1);
            (times > 0 && (b.width * times, b.height * times) == (a.width, a.height))
                .then_some(times as usize)
        };
        let (times, divides) = (
            multiple(f, e).unwrap_or(1),
            if multiple(f, e).is_some() { 1 } else { multiple(e, f).unwrap_or(1) },
        );
        let (width, height) = (f.width as usize / times, f.height as usize / times);
        (width >= TILE && height >= TILE && f.pixels() <= MOST_PIXELS).then_some(Canvas {
            width,
            height,
            times,
            divides,
            channels: frames.colour.channels() as usize,
        })
    }

    /// Logarithm of the mean of the frame's values of each pixel.
    fn log(&self, values: &[f32], dark: f32) -> Option<Vec<f32>> {
        let row = self.width * self.times * self.channels;
        if values.len() < row * self.height * self.times {
            return None;
        }
        let mut sums = vec![0.0f32; self.width * self.height];
        for (y, values) in values.chunks_exact(row).take(self.height * self.times).enumerate() {
            let sums = &mut sums[y / self.times * self.width..][..self.width];
            sums.iter_mut()
                .zip(values.chunks_exact(self.times * self.channels))
                .for_each(|(sum, values)| *sum += values.iter().sum::<f32>());
        }
        let scale = 1.0 / (self.times * self.times * self.channels) as f32;
        Some(sums.into_iter().map(|sum| libm::logf((sum * scale).max(0.0) + dark.max(1e-6))).collect())
    }

    fn across(&self) -> usize {
        self.width / TILE
    }

    fn tile(&self, cell: usize, values: &[f32]) -> Vec<f32> {
        let (left, top) = (cell % self.across() * TILE, cell / self.across() * TILE);
        (0..TILE).flat_map(|y| values[(top + y) * self.width + left..][..TILE].iter().copied()).collect()
    }

    fn part(&self, cell: usize) -> usize {
        let (across, down) = (self.across(), self.height / TILE);
        cell / across * PARTS / down * PARTS + cell % across * PARTS / across
    }

    /// Where an event of a reading falls.
    fn place(&self, of: &Alternative, x: u16, y: u16) -> Option<(usize, usize)> {
        let pixel = |at: u16| i64::from(at) / self.divides as i64;
        let mirrored = |at: i64, is: bool, size: usize| if is { size as i64 - 1 - at } else { at };
        let x = mirrored(pixel(x), of.mirrored.0, self.width) + i64::from(of.shifted.0);
        let y = mirrored(pixel(y), of.mirrored.1, self.height) + i64::from(of.shifted.1);
        let is_inside = (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y);
        is_inside.then_some((x as usize, y as usize))
    }
}

/// Scores every alternative by the share of the frames' log change that its events explain on pairs of frames
/// that were not fitted, best first.
///
/// Empty where there are no events or fewer than two pairs of frames that change, or where sizes are not
/// known.
///
/// # Errors
/// When the file cannot be read any more. A frame that cannot be read is left out.
pub fn compare(
    recording: &dyn Recording,
    alternatives: &[Alternative],
    much: &Much,
) -> Result<Vec<Scored>, FormatError> {
    let (Some(pictures), Some(events)) = (recording.pictures(), recording.events_about()) else {
        return Ok(Vec::new());
    };
    let about = pictures.about();
    let Some(canvas) = Canvas::of(about, much.extent.or(events.extent)) else { return Ok(Vec::new()) };
    let Some(span) = much.span_ns.map_or_else(|| span(recording, much), |span| Ok(Some(span)))? else {
        return Ok(Vec::new());
    };
    let mids: Vec<i64> = about.stamps.iter().map(middle).collect();
    let (changes, kept, tile_of) = changing_tiles(&*pictures, &canvas, pairs(&mids, span));
    let spans: Vec<(i64, i64)> = kept.iter().map(|later| (mids[later - 1], mids[*later])).collect();
    let mut trials = Vec::with_capacity(alternatives.len());
    for some in alternatives.chunks(AT_ONCE) {
        let mut made: Vec<Trial> =
            some.iter().map(|reading| Trial::new(&changes, &spans, reading.fits_offset)).collect();
        count(recording, &canvas, about, some, &mut made, &tile_of, much)?;
        trials.extend(made);
    }
    let Some(found) = agreements(&changes, &trials) else { return Ok(Vec::new()) };
    let scored =
        |(alternative, (found, of)): (usize, (photocurrent_sensor::estimate::Agreement, &Alternative))| {
            Scored {
                alternative,
                name: of.name.clone(),
                explained: found.explained.into(),
                behind: found.behind.into(),
                correlation: found.correlation,
                late_ns: found.offset_ns,
                thresholds: found.thresholds,
                pairs: (found.pairs, kept.len()),
            }
        };
    let mut scored: Vec<Scored> = found.into_iter().zip(alternatives).enumerate().map(scored).collect();
    scored.sort_by(|a, b| {
        b.explained.value.total_cmp(&a.explained.value).then(a.alternative.cmp(&b.alternative))
    });
    Ok(scored)
}

/// The tiles of the pictures that change most, the frames of which some do, and where each tile lies.
fn changing_tiles(
    pictures: &dyn Pictures,
    canvas: &Canvas,
    chosen: Vec<usize>,
) -> (Changes, Vec<usize>, Vec<Vec<u16>>) {
    let (mut changes, mut kept, mut tile_of): (Changes, Vec<usize>, Vec<Vec<u16>>) = Default::default();
    let mut before: Option<(usize, Vec<f32>)> = None;
    let (mut dark, mut values) = (0.0f32, Vec::new());
    let mut log = |frame: usize| -> Option<Vec<f32>> {
        pictures.read(frame, &mut values).ok()?;
        if dark == 0.0 {
            dark = DARK * values.iter().copied().filter(|value| value.is_finite()).fold(0.0, f32::max);
        }
        canvas.log(&values, dark)
    };
    for later in chosen {
        let earlier = before
            .take()
            .filter(|(frame, _)| frame + 1 == later)
            .map(|(_, log)| log)
            .or_else(|| log(later - 1));
        let after = log(later);
        if let (Some(earlier), Some(after)) = (&earlier, &after) {
            let change: Vec<f32> = after.iter().zip(earlier).map(|(after, before)| after - before).collect();
            let (tiles, of) = tiles(canvas, &change);
            if !tiles.is_empty() {
                changes.push(&tiles);
                kept.push(later);
                tile_of.push(of);
            }
        }
        before = after.map(|after| (later, after));
    }
    (changes, kept, tile_of)
}

/// The later frames of the pairs that are evaluated, rising: spread over the time that events and frames
/// share.
fn pairs(mids: &[i64], (first, last): (i64, i64)) -> Vec<usize> {
    let shares =
        |later: &usize| mids[*later] >= first && mids[later - 1] <= last && mids[*later] > mids[later - 1];
    let shared: Vec<usize> = (1..mids.len()).filter(shares).collect();
    let count = PAIRS.min(shared.len());
    (0..count).map(|n| shared[n * shared.len() / count]).collect()
}

/// The tiles of a pair that change most, each with its part of the picture; and of each tile of the picture
/// its number among them.
fn tiles(canvas: &Canvas, change: &[f32]) -> (Vec<(usize, Vec<f32>)>, Vec<u16>) {
    let cells = canvas.across() * (canvas.height / TILE);
    let mut sizes: Vec<(f32, usize)> = Vec::new();
    for cell in 0..cells {
        let tile = canvas.tile(cell, change);
        let mean = tile.iter().sum::<f32>() / tile.len() as f32;
        let size = tile.iter().map(|change| (change - mean) * (change - mean)).sum::<f32>();
        sizes.extend(size.is_finite().then_some((size, cell)));
    }
    sizes.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    sizes.truncate(A_PAIR);
    sizes.sort_by_key(|(_, cell)| (canvas.part(*cell), *cell));
    let mut tile_of = vec![u16::MAX; cells];
    sizes.iter().enumerate().for_each(|(tile, (_, cell))| tile_of[*cell] = tile as u16);
    (sizes.into_iter().map(|(_, cell)| (canvas.part(cell), canvas.tile(cell, change))).collect(), tile_of)
}

/// First and last stamp of the middle 99.8 % of the events.
fn span(recording: &dyn Recording, much: &Much) -> Result<Option<(i64, i64)>, FormatError> {
    /// Stamps that are kept of all, at most; then every second one, and so on.
    const KEPT: usize = 1 << 16;
    let (mut stamps, mut every, mut n) = (Vec::new(), 1u64, 0u64);
    let (mut cursor, mut chunk) = (recording.events()?, EventChunk::default());
    while n < much.events && cursor.next(&mut chunk)? {
        for t in &chunk.t {
            if n % every == 0 {
                stamps.push(*t);
            }
            n += 1;
        }
        while stamps.len() > KEPT {
            let mut at = 0;
            stamps.retain(|_| {
                at += 1;
                at % 2 == 1
            });
            every *= 2;
        }
    }
    stamps.sort_unstable();
    let few = stamps.len() / 1000;
    Ok(stamps
        .get(few)
        .copied()
        .zip(stamps.len().checked_sub(few + 1).and_then(|last| stamps.get(last)).copied()))
}

/// Counts the events of the recording under some readings.
fn count(
    recording: &dyn Recording,
    canvas: &Canvas,
    about: &FramesAbout,
    alternatives: &[Alternative],
    trials: &mut [Trial],
    tile_of: &[Vec<u16>],
    much: &Much,
) -> Result<(), FormatError> {
    let row_time_ns = about.row_time_ns.unwrap_or(0).saturating_mul(canvas.times as i64);
    let mut put = |(x, y): (u16, u16), stamp: i64, earlier: i64, is_on: bool| {
        for (of, trial) in alternatives.iter().zip(trials.iter_mut()) {
            let Some((x, y)) = canvas.place(of, x, y) else { continue };
            let (column, cell) = (x / TILE, y / TILE * canvas.across() + x / TILE);
            if column >= canvas.across() {
                continue;
            }
            let earlier = earlier.min(trial.period_ns() / 4);
            let t = stamp.saturating_sub(earlier).saturating_sub(row_time_ns.saturating_mul(y as i64));
            let pixel = y % TILE * TILE + x % TILE;
            trial.event(t, is_on != of.inverted, |pair| {
                tile_of[pair]
                    .get(cell)
                    .filter(|tile| **tile != u16::MAX)
                    .map(|tile| (usize::from(*tile), pixel))
            });
        }
    };
    // Pixels by the coordinates that are stored: those of an unknown array are many, and are folded together.
    let (width, height) = much
        .extent
        .or(recording.events_about().and_then(|about| about.extent))
        .map_or((canvas.width, canvas.height), |extent| (extent.width as usize, extent.height as usize));
    let side = (width.max(height)).clamp(1, 4096);
    let pixel_of = |x: u16, y: u16| usize::from(y) % side * side + usize::from(x) % side;
    let (mut waits, mut places) = (Waits::new(side * side), vec![(0u16, 0u16); side * side]);
    let (mut cursor, mut chunk, mut n) = (recording.events()?, EventChunk::default(), 0);
    while n < much.events && cursor.next(&mut chunk)? {
        for (((&t, &x), &y), &on) in chunk.t.iter().zip(&chunk.x).zip(&chunk.y).zip(&chunk.on) {
            let pixel = pixel_of(x, y);
            let before = std::mem::replace(&mut places[pixel], (x, y));
            if let Some((stamp, earlier, was_on)) = waits.next(pixel, t, on & 1 == 1) {
                put(before, stamp, earlier, was_on);
            }
        }
        n += chunk.len() as u64;
    }
    waits.rest().for_each(|(pixel, stamp, earlier, is_on)| put(places[pixel], stamp, earlier, is_on));
    Ok(())
}

#[cfg(test)]
#[path = "alternatives_tests.rs"]
mod tests;
