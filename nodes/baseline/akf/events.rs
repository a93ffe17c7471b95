//! The events of all pixels: one list per pixel in time order, and the order in which a program that takes
//! one event after the other meets them.

use photocurrent_core::events::EventBand;
use photocurrent_solve::pixel_events::StepRule;
use rayon::prelude::*;

/// Where an event stands in the order of processing: by time, then by pixel (row by row).
pub type Key = (i64, u32);

/// Events of all pixels, one list after the other.
pub struct PixelLists {
    offsets: Vec<usize>,
    t: Vec<i64>,
    step: Vec<f64>,
}

impl PixelLists {
    /// From whole rows of a sensor.
    pub fn new(events: &EventBand, width: u32, height: u32, rule: &StepRule) -> PixelLists {
        let row_lists = |y: u32| {
            let row = events.row(y);
            let index = row.by_pixel(width);
            let pixel = |x: usize| {
                let mut list: Vec<(i64, f64)> =
                    index.pixel(x).iter().map(|&k| (rule.time(&row, k), rule.step(&row, k))).collect();
                // In-pixel times need not be in the order of the stamps.
                list.sort_by_key(|(t, _)| *t);
                list
            };
            (0..width as usize).map(pixel).collect::<Vec<_>>()
        };
        PixelLists::from_lists(
            (0..height).into_par_iter().map(row_lists).collect::<Vec<_>>().into_iter().flatten(),
        )
    }

    /// From one list of (time in ns, signed step) per pixel, each in time order.
    pub fn from_lists(lists: impl Iterator<Item = Vec<(i64, f64)>>) -> PixelLists {
        let mut all = PixelLists { offsets: vec![0], t: Vec::new(), step: Vec::new() };
        for list in lists {
            all.t.extend(list.iter().map(|(t, _)| *t));
            all.step.extend(list.iter().map(|(_, step)| *step));
            all.offsets.push(all.t.len());
        }
        all
    }

    /// One pixel's list.
    pub fn pixel(&self, pixel: u32) -> PixelList<'_> {
        let range = self.offsets[pixel as usize]..self.offsets[pixel as usize + 1];
        PixelList { pixel, t: &self.t[range.clone()], step: &self.step[range] }
    }

    /// All events in the order of processing.
    pub fn order(&self) -> Vec<Key> {
        let pixels = self.offsets.len() as u32 - 1;
        let mut keys: Vec<Key> =
            (0..pixels).flat_map(|pixel| self.pixel(pixel).t.iter().map(move |t| (*t, pixel))).collect();
        keys.par_sort_unstable();
        keys
    }
}

/// One pixel's events.
#[derive(Clone, Copy)]
pub struct PixelList<'a> {
    /// Row-major index of the pixel.
    pub pixel: u32,
    /// Times, ns.
    pub t: &'a [i64],
    /// Signed log steps.
    pub step: &'a [f64],
}

impl PixelList<'_> {
    /// Index of the first event that is not processed before `key`.
    pub fn first_from(&self, key: Key) -> usize {
        self.t.partition_point(|t| (*t, self.pixel) < key)
    }

    /// Index of the first event that is processed after `key`.
    pub fn first_after(&self, key: Key) -> usize {
        self.t.partition_point(|t| (*t, self.pixel) <= key)
    }

    /// Sum of the steps from one key to another, both included.
    pub fn sum(&self, from: Key, to: Key) -> f64 {
        let (from, to) = (self.first_from(from), self.first_after(to));
        self.step[from..to.max(from)].iter().sum()
    }
}
