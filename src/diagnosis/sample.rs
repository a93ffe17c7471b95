//! Which pixels are looked at: blocks spread over the array, in each zone the one with the most events.

use crate::case::Case;

/// Some pixels of an array.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sample {
    /// Pixels (`y * width + x`), rising.
    pub pixels: Vec<u32>,
    /// Which of them are in the inner part of their block, so that their neighbours are there too; of the same length.
    pub is_inner: Vec<bool>,
    /// Number of the block of each.
    pub block: Vec<u32>,
    place: Vec<u32>,
}

const NOWHERE: u32 = u32::MAX;

impl Sample {
    /// In each of `zones.0` x `zones.1` zones, the block of `side` x `side` pixels with the most events, of blocks whose mean number of events a pixel lies
    /// within `events`; a zone without one gives nothing. Inner pixels are those with `margin` pixels of the block around them.
    pub fn blocks(case: &Case, zones: (u32, u32), side: u32, margin: u32, events: (f64, f64)) -> Sample {
        let (width, height) = (case.extent.width, case.extent.height);
        let mut chosen: Vec<(u32, u32, u32)> = Vec::new();
        for zone in 0..zones.0 * zones.1 {
            let (zx, zy) = (zone % zones.0, zone / zones.0);
            let columns = zx * width / zones.0..(zx + 1) * width / zones.0;
            let rows = zy * height / zones.1..(zy + 1) * height / zones.1;
            let mut best: Option<(usize, u32, u32)> = None;
            for y in rows.clone().filter(|y| y + side <= rows.end) {
                for x in columns.clone().filter(|x| x + side <= columns.end) {
                    let count: usize = (y..y + side)
                        .map(|y| case.events.range((y * width + x) as usize).start..case.events.range((y * width + x + side - 1) as usize).end)
                        .map(|r| r.len())
                        .sum();
                    let mean = count as f64 / f64::from(side * side);
                    if mean >= events.0 && mean <= events.1 && best.is_none_or(|best| count > best.0) {
                        best = Some((count, x, y));
                    }
                }
            }
            chosen.extend(best.map(|(_, x, y)| (zone, x, y)));
        }
        let mut pixels: Vec<(u32, bool, u32)> = Vec::new();
        for (zone, left, top) in chosen {
            for (dx, dy) in (0..side).flat_map(|dy| (0..side).map(move |dx| (dx, dy))) {
                let inside = |at: u32| at >= margin && at + margin < side;
                pixels.push(((top + dy) * width + left + dx, inside(dx) && inside(dy), zone));
            }
        }
        pixels.sort_unstable();
        Sample::new(case, pixels)
    }

    /// Every pixel, in blocks of `side` x `side`.
    pub fn all(case: &Case, side: u32) -> Sample {
        let (width, height) = (case.extent.width, case.extent.height);
        let across = width.div_ceil(side);
        Sample::new(case, (0..width * height).map(|pixel| (pixel, true, (pixel / width) / side * across + (pixel % width) / side)).collect())
    }

    fn new(case: &Case, pixels: Vec<(u32, bool, u32)>) -> Sample {
        let mut place = vec![NOWHERE; case.extent.pixels()];
        for (n, (pixel, ..)) in (0..).zip(&pixels) {
            place[*pixel as usize] = n;
        }
        Sample {
            pixels: pixels.iter().map(|(pixel, ..)| *pixel).collect(),
            is_inner: pixels.iter().map(|(_, inner, _)| *inner).collect(),
            block: pixels.iter().map(|(.., block)| *block).collect(),
            place,
        }
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.pixels.len()
    }

    /// No pixel at all?
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }

    /// Where in the sample a pixel of the array stands.
    pub fn place(&self, pixel: usize) -> Option<usize> {
        Some(self.place[pixel]).filter(|place| *place != NOWHERE).map(|place| place as usize)
    }
}
