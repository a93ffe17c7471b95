//! Whether events and frames lie on one pixel grid, where their sizes agree: patches of the busiest parts of
//! some pairs of frames, with the events of each pixel.
//!
//! [`photocurrent_sensor::estimate::displacement`] holds the two against each other. Limits: of [`PAIRS`]
//! pairs the [`A_PAIR`] patches that change most; frames must have the events' pixels or a whole multiple.

use super::interval::Interval;
use crate::recording::FramesAbout;
use photocurrent_core::Extent;
use photocurrent_sensor::estimate::{FRAME_SIDE, Patch, REACH, SIDE, displacement};
use serde::Serialize;

/// Pairs of frames that are looked at, spread over those that are read.
pub const PAIRS: usize = 24;
/// Patches of a pair.
pub const A_PAIR: usize = 48;
/// Steps of time from frame to frame.
const STEPS: i64 = 16;
/// Offsets in time to each side of the best one of the whole picture at which a shift is looked for, and
/// their distance as a part of the frame period.
const AROUND: i64 = 3;
/// See [`AROUND`].
const OFFSET_STEP: f64 = 0.125;
/// No patch.
const NONE: u16 = u16::MAX;

/// Where frames see what events see.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GridSurvey {
    /// Event pixels by which the frames' picture lies right of the events'.
    pub right_px: Interval,
    /// Event pixels by which it lies below.
    pub down_px: Interval,
    /// Correlation at that shift and the offset in time that suits it best, and without a shift at the offset
    /// that suits that best.
    pub correlation: (f64, f64),
    /// Whole pixels right and down that agree best at the latter offset, and the correlation there.
    pub at_one_offset: ((i32, i32), f64),
    /// Patches that were compared.
    pub patches: usize,
}

/// Two neighbouring frames.
struct Pair {
    start_ns: i64,
    end_ns: i64,
    /// Of each cell of [`SIDE`] squared pixels its patch, or [`NONE`].
    patch_of: Vec<u16>,
    patches: Vec<Patch>,
}

/// Patches as frames and events come.
pub(super) struct Grid {
    events: Extent,
    times: usize,
    channels: usize,
    dark: f32,
    period_ns: i64,
    /// The later frame of each pair that is looked at, with the middles of both, rising.
    wanted: Vec<(usize, i64, i64)>,
    before: Option<(usize, Vec<f32>)>,
    pairs: Vec<Pair>,
}

impl Grid {
    /// For pairs of frames (the later one, and the middles of both exposures); none where sizes do not agree.
    pub(super) fn new(
        about: &FramesAbout,
        events: Extent,
        pairs: &[(usize, i64, i64)],
        period_ns: i64,
    ) -> Option<Grid> {
        let times = about.extent.width / events.width.max(1);
        if times == 0
            || (events.width * times, events.height * times) != (about.extent.width, about.extent.height)
            || pairs.is_empty()
        {
            return None;
        }
        let every = pairs.len().div_ceil(PAIRS);
        let wanted = pairs.iter().copied().step_by(every).collect();
        Some(Grid {
            events,
            times: times as usize,
            channels: about.colour.channels() as usize,
            dark: 0.0,
            period_ns,
            wanted,
            before: None,
            pairs: Vec::new(),
        })
    }

    /// Takes the values of a frame; `dark` is added before the logarithm.
    pub(super) fn picture(&mut self, frame: usize, values: &[f32], dark: f32) {
        let is_later = self.wanted.binary_search_by_key(&frame, |wanted| wanted.0);
        let is_earlier = self.wanted.binary_search_by_key(&(frame + 1), |wanted| wanted.0).is_ok();
        if is_later.is_err() && !is_earlier {
            return;
        }
        if self.dark == 0.0 {
            self.dark = dark;
        }
        let log = self.log(values);
        if let (Ok(at), Some((before, log_before))) = (is_later, &self.before)
            && before + 1 == frame
        {
            let (_, from, to) = self.wanted[at];
            let change: Vec<f32> = log.iter().zip(log_before).map(|(after, before)| after - before).collect();
            let pair = self.pair(&change, (from, to));
            self.pairs.push(pair);
        }
        self.before = Some((frame, log));
    }

    /// Logarithm of the mean of the frame's values of each event pixel.
    fn log(&self, values: &[f32]) -> Vec<f32> {
        let (width, height) = (self.events.width as usize, self.events.height as usize);
        let row = width * self.times * self.channels;
        let mut sums = vec![0.0f32; width * height];
        for (y, values) in values.chunks_exact(row).take(height * self.times).enumerate() {
            let sums = &mut sums[y / self.times * width..][..width];
            for (sum, values) in sums.iter_mut().zip(values.chunks_exact(self.times * self.channels)) {
                *sum += values.iter().sum::<f32>();
            }
        }
        let scale = 1.0 / (self.times * self.times * self.channels) as f32;
        sums.into_iter().map(|sum| libm::logf((sum * scale).max(0.0) + self.dark.max(1e-6))).collect()
    }

    fn across(&self) -> usize {
        self.events.width as usize / SIDE
    }

    /// The patches of a pair that change most.
    fn pair(&self, change: &[f32], mids_ns: (i64, i64)) -> Pair {
        let (width, height, across) =
            (self.events.width as usize, self.events.height as usize, self.across());
        let down = height / SIDE;
        let fits = |cell: usize, of: usize| cell * SIDE >= REACH && (cell + 1) * SIDE + REACH <= of;
        let mut cells: Vec<(f32, usize, Vec<f32>)> = Vec::new();
        for cell in
            (0..across * down).filter(|cell| fits(cell % across, width) && fits(cell / across, height))
        {
            let (left, top) = (cell % across * SIDE - REACH, cell / across * SIDE - REACH);
            let patch: Vec<f32> = (0..FRAME_SIDE)
                .flat_map(|y| change[(top + y) * width + left..][..FRAME_SIDE].iter().copied())
                .collect();
            let mean = patch.iter().sum::<f32>() / patch.len() as f32;
            let size = patch.iter().map(|change| (change - mean) * (change - mean)).sum::<f32>();
            if size.is_finite() {
                cells.push((size, cell, patch));
            }
        }
        cells.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let (step_ns, margin_ns) = ((self.period_ns / STEPS).max(1), self.period_ns);
        let mut pair = Pair {
            start_ns: mids_ns.0.saturating_sub(margin_ns),
            end_ns: mids_ns.1.saturating_add(margin_ns),
            patch_of: vec![NONE; across * down],
            patches: Vec::new(),
        };
        for (_, cell, change) in cells.into_iter().take(A_PAIR) {
            if let Some(patch) = Patch::new(mids_ns, margin_ns, step_ns, change) {
                pair.patch_of[cell] = pair.patches.len() as u16;
                pair.patches.push(patch);
            }
        }
        pair
    }

    /// Takes an event inside of the array.
    #[inline]
    pub(super) fn event(&mut self, t_ns: i64, x: usize, y: usize, is_on: bool) {
        let (column, row, across) = (x / SIDE, y / SIDE, self.across());
        if column >= across {
            return;
        }
        // Pairs are in order of time, and no four of them overlap.
        let after = self.pairs.partition_point(|pair| pair.start_ns <= t_ns);
        for pair in self.pairs[after.saturating_sub(4)..after].iter_mut().filter(|pair| t_ns <= pair.end_ns) {
            if let Some(patch) = pair
                .patch_of
                .get(row * across + column)
                .and_then(|patch| pair.patches.get_mut(usize::from(*patch)))
            {
                patch.event(t_ns, x % SIDE, y % SIDE, is_on);
            }
        }
    }

    /// What they show, with events later than frames by about `offset_ns`.
    pub(super) fn survey(self, offset_ns: f64) -> Option<GridSurvey> {
        let patches: Vec<Patch> = self.pairs.into_iter().flat_map(|pair| pair.patches).collect();
        let offsets: Vec<f64> =
            (-AROUND..=AROUND).map(|n| offset_ns + n as f64 * OFFSET_STEP * self.period_ns as f64).collect();
        displacement(&patches, &offsets).map(|found| GridSurvey {
            right_px: found.right.into(),
            down_px: found.down.into(),
            correlation: (found.correlation, found.correlation_at_none),
            at_one_offset: (found.shift_at_one_offset, found.correlation_at_one_offset),
            patches: found.patches,
        })
    }
}
