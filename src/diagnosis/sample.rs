//! Selects pixels to evaluate: blocks spread over the array, in each zone the one with the most events.

use photocurrent_scene::case::Case;

/// Some pixels of an array.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PixelSample {
    /// Pixels (`y * width + x`), rising.
    pub pixels: Vec<u32>,
    /// Which of them are in the inner part of their block, so that their neighbours are there too; of the
    /// same length.
    pub is_inner: Vec<bool>,
    /// Number of the block of each.
    pub block: Vec<u32>,
    /// Blocks are numbered row by row, so many in a row.
    pub across: u32,
    /// One more than the largest number of a block; of a part of a sample that of the whole.
    pub block_count: usize,
    place: Vec<u32>,
}

const NOWHERE: u32 = u32::MAX;

impl PixelSample {
    /// In each of `zones.0` x `zones.1` zones, the block of `side` x `side` pixels with the most events, of
    /// blocks whose mean number of events a pixel lies within `events`; a zone without one gives nothing.
    /// Inner pixels are those with `margin` pixels of the block around them.
    pub fn blocks(case: &Case, zones: (u32, u32), side: u32, margin: u32, events: (f64, f64)) -> PixelSample {
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
                        .map(|y| case.events.count((y * width + x) as usize..(y * width + x + side) as usize))
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
        PixelSample::new(case, zones.0, pixels)
    }

    /// Blocks of 6 x 6 pixels that together touch many rows and columns: in every band of six rows, those
    /// with the most events in each of `across` parts of the band's length, and the blocks around the few
    /// pixels that fire most against their surround. The inner 4 x 4 of each are marked.
    pub fn spread(case: &Case, across: u32) -> PixelSample {
        const SIDE: u32 = 6;
        let (columns, rows) = ((case.extent.width / SIDE).max(1), (case.extent.height / SIDE).max(1));
        let side = |length: u32| u32::min(SIDE, length);
        let (wide, high) = (side(case.extent.width), side(case.extent.height));
        let width = case.extent.width;
        let count = |column: u32, row: u32| -> usize {
            let first = |y: u32| (y * width + column * SIDE) as usize;
            (row * SIDE..row * SIDE + high)
                .map(|y| case.events.count(first(y)..first(y) + wide as usize))
                .sum()
        };
        let mut is_chosen = vec![false; (columns * rows) as usize];
        for row in 0..rows {
            for part in 0..across {
                let within = part * columns / across..(part + 1) * columns / across;
                let best = within.max_by_key(|&column| (count(column, row), u32::MAX - column));
                if let Some(column) = best {
                    is_chosen[(row * columns + column) as usize] = true;
                }
            }
        }
        let mut outliers: Vec<(i64, u32, u32)> = Vec::new();
        for y in 1..case.extent.height.saturating_sub(1) {
            for x in 1..width.saturating_sub(1) {
                let events = |dx: u32, dy: u32| {
                    case.events.of_pixel(((y + dy - 1) * width + x + dx - 1) as usize).len() as i64
                };
                let around = (0..3)
                    .flat_map(|dy| (0..3).map(move |dx| (dx, dy)))
                    .filter(|at| *at != (1, 1))
                    .map(|(dx, dy)| events(dx, dy))
                    .max()
                    .unwrap_or(0);
                let excess = events(1, 1) - 2 * around;
                if excess > 20 {
                    outliers.push((excess, x / SIDE, y / SIDE));
                }
            }
        }
        outliers.sort_by_key(|outlier| (std::cmp::Reverse(outlier.0), outlier.1, outlier.2));
        for (_, column, row) in
            outliers.iter().take(4).filter(|outlier| outlier.1 < columns && outlier.2 < rows)
        {
            is_chosen[(row * columns + column) as usize] = true;
        }
        let mut pixels: Vec<(u32, bool, u32)> = Vec::new();
        for block in (0..columns * rows).filter(|block| is_chosen[*block as usize]) {
            let (left, top) = (block % columns * SIDE, block / columns * SIDE);
            for (dx, dy) in (0..high).flat_map(|dy| (0..wide).map(move |dx| (dx, dy))) {
                let inside = |at: u32| (1..SIDE - 1).contains(&at);
                pixels.push(((top + dy) * width + left + dx, inside(dx) && inside(dy), block));
            }
        }
        pixels.sort_unstable();
        PixelSample::new(case, columns, pixels)
    }

    /// Blocks for which `keep` returns true, with new numbers, and the indices of their pixels in this
    /// sample.
    pub fn select_blocks(&self, keep: impl Fn(u32) -> bool) -> (PixelSample, Vec<usize>) {
        let places: Vec<usize> = (0..self.len()).filter(|&n| keep(self.block[n])).collect();
        let mut place = vec![NOWHERE; self.place.len()];
        for (n, &from) in places.iter().enumerate() {
            place[self.pixels[from] as usize] = n as u32;
        }
        let sample = PixelSample {
            pixels: places.iter().map(|&n| self.pixels[n]).collect(),
            is_inner: places.iter().map(|&n| self.is_inner[n]).collect(),
            block: places.iter().map(|&n| self.block[n]).collect(),
            place,
            ..*self
        };
        (sample, places)
    }

    /// Every pixel, in blocks of `side` x `side`.
    pub fn every_pixel(case: &Case, side: u32) -> PixelSample {
        let (width, height) = (case.extent.width, case.extent.height);
        let across = width.div_ceil(side);
        PixelSample::new(
            case,
            across,
            (0..width * height)
                .map(|pixel| (pixel, true, (pixel / width) / side * across + (pixel % width) / side))
                .collect(),
        )
    }

    /// These pixels, in blocks of `side` x `side`.
    pub fn from_pixels(case: &Case, pixels: impl IntoIterator<Item = u32>, side: u32) -> PixelSample {
        let (width, across) = (case.extent.width, case.extent.width.div_ceil(side));
        let mut pixels: Vec<(u32, bool, u32)> = pixels
            .into_iter()
            .map(|pixel| (pixel, true, (pixel / width) / side * across + (pixel % width) / side))
            .collect();
        pixels.sort_unstable();
        pixels.dedup();
        PixelSample::new(case, across, pixels)
    }

    fn new(case: &Case, across: u32, pixels: Vec<(u32, bool, u32)>) -> PixelSample {
        let mut place = vec![NOWHERE; case.extent.pixels()];
        for (n, (pixel, ..)) in (0..).zip(&pixels) {
            place[*pixel as usize] = n;
        }
        PixelSample {
            pixels: pixels.iter().map(|(pixel, ..)| *pixel).collect(),
            is_inner: pixels.iter().map(|(_, inner, _)| *inner).collect(),
            block: pixels.iter().map(|(.., block)| *block).collect(),
            across,
            block_count: pixels.iter().map(|(.., block)| *block as usize + 1).max().unwrap_or(0),
            place,
        }
    }

    /// Pixels for the held-out check: blocks spread over the array, or all of a small one.
    pub fn for_held_out_frames(case: &Case) -> PixelSample {
        const SIDE: u32 = 8;
        let zones = (6, 5);
        if case.extent.width < zones.0 * SIDE || case.extent.height < zones.1 * SIDE {
            return PixelSample::every_pixel(case, SIDE);
        }
        PixelSample::blocks(case, zones, SIDE, 1, (3.0, 300.0))
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.pixels.len()
    }

    /// No pixel at all?
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }

    /// Index of an array pixel in the sample; `None` outside.
    pub fn index_of(&self, pixel: usize) -> Option<usize> {
        Some(self.place[pixel]).filter(|place| *place != NOWHERE).map(|place| place as usize)
    }
}
