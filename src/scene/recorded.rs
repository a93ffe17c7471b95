//! Events and frames of a recording in memory, shared between copies: exclusions of a copy are a mask next to
//! them.

use photocurrent_core::{Colour, FrameTimes};
use photocurrent_sensor::comparator::PixelEvent;
use std::ops::Range;
use std::sync::Arc;

/// The recorded events of all pixels of an array, pixel by pixel, each in order of in-pixel time: the
/// recorded in-pixel stamp, or the off-pixel stamp less the smallest latency. A copy shares them.
#[derive(Clone, Debug, Default)]
pub struct PixelEvents {
    /// Where the events of each pixel begin and end.
    of: Arc<Vec<(usize, usize)>>,
    all: Arc<Vec<PixelEvent>>,
    count: usize,
}

impl PixelEvents {
    /// From the events of each pixel, in row-major order of pixels; sorts each.
    pub fn new(pixels: impl IntoIterator<Item = Vec<PixelEvent>>) -> PixelEvents {
        let mut gathered = EventGatherer::default();
        pixels.into_iter().for_each(|events| gathered.pixel(events));
        gathered.finish()
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.of.len()
    }

    /// The events of a pixel (`y * width + x`).
    pub fn of_pixel(&self, pixel: usize) -> &[PixelEvent] {
        let (from, to) = self.of[pixel];
        &self.all[from..to]
    }

    /// Number of events of all pixels.
    pub fn len(&self) -> usize {
        self.count
    }

    /// No event at all?
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Number of events of some neighbouring pixels.
    pub fn count(&self, pixels: Range<usize>) -> usize {
        self.of[pixels].iter().map(|(from, to)| to - from).sum()
    }

    /// Every event, pixel by pixel.
    pub fn iter(&self) -> impl Iterator<Item = &PixelEvent> {
        self.of.iter().flat_map(|&(from, to)| &self.all[from..to])
    }

    /// The same without those of some pixels.
    #[must_use]
    pub fn without_pixels(&self, pixels: &[u32]) -> PixelEvents {
        let mut of = (*self.of).clone();
        pixels.iter().for_each(|&pixel| of[pixel as usize] = (0, 0));
        let count = of.iter().map(|(from, to)| to - from).sum();
        PixelEvents { of: Arc::new(of), all: self.all.clone(), count }
    }
}

impl PartialEq for PixelEvents {
    fn eq(&self, other: &PixelEvents) -> bool {
        self.pixels() == other.pixels()
            && (0..self.pixels()).all(|pixel| self.of_pixel(pixel) == other.of_pixel(pixel))
    }
}

/// Builder of [`PixelEvents`], pixel by pixel; only the events themselves are kept.
#[derive(Debug, Default)]
pub(crate) struct EventGatherer {
    of: Vec<(usize, usize)>,
    all: Vec<PixelEvent>,
}

impl EventGatherer {
    /// Reserves memory for more events.
    pub(crate) fn reserve(&mut self, events: usize) {
        self.all.reserve_exact(events);
    }

    /// The events of the next pixel.
    pub(crate) fn pixel(&mut self, events: impl IntoIterator<Item = PixelEvent>) {
        let from = self.all.len();
        self.all.extend(events);
        self.all[from..].sort_by_key(|event| (event.t_in_ns, event.t_off_ns));
        self.of.push((from, self.all.len()));
    }

    /// All of them.
    pub(crate) fn finish(mut self) -> PixelEvents {
        self.all.shrink_to_fit();
        PixelEvents { count: self.all.len(), of: Arc::new(self.of), all: Arc::new(self.all) }
    }
}

/// Frames in memory. A copy shares their values.
#[derive(Clone, Debug)]
pub struct CaseFrames {
    /// Exposures and row time.
    pub times: FrameTimes,
    /// The mosaic of filters before the event pixels, where neighbouring ones measure other light.
    pub filters: Option<Colour>,
    /// DN as [frame][y][x]; NaN = not known.
    all: Arc<Vec<f32>>,
    /// The first value of the first frame.
    first: usize,
    pixels: usize,
    /// Pixels and frames whose values read as not known; empty where all are.
    is_left_out: (Arc<Vec<bool>>, Arc<Vec<bool>>),
}

impl CaseFrames {
    /// From values as [frame][y][x].
    pub fn new(times: FrameTimes, dn: Vec<f32>) -> CaseFrames {
        let pixels = dn.len() / times.len().max(1);
        CaseFrames {
            times,
            filters: None,
            all: Arc::new(dn),
            first: 0,
            pixels,
            is_left_out: Default::default(),
        }
    }

    /// Number of values of all frames.
    pub fn len(&self) -> usize {
        self.times.len() * self.pixels
    }

    /// No value at all?
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The value of a pixel in a frame, DN; NaN = not known.
    pub fn dn(&self, frame: usize, pixel: usize) -> f32 {
        let is_left_out = |of: &[bool], at: usize| of.get(at).is_some_and(|is| *is);
        if is_left_out(&self.is_left_out.0, pixel) || is_left_out(&self.is_left_out.1, frame) {
            return f32::NAN;
        }
        self.all[self.first + frame * self.pixels + pixel]
    }

    /// The values of a pixel, frame by frame.
    pub fn values_of_pixel(&self, pixel: usize) -> impl Iterator<Item = f32> + '_ {
        (0..self.times.len()).map(move |frame| self.dn(frame, pixel))
    }

    /// Every value as [frame][y][x].
    pub fn values(&self) -> impl Iterator<Item = f32> + '_ {
        (0..self.times.len()).flat_map(move |frame| (0..self.pixels).map(move |pixel| self.dn(frame, pixel)))
    }

    /// Every so manyth of [`CaseFrames::values`].
    pub fn every_nth(&self, step: usize) -> impl Iterator<Item = f32> + '_ {
        (0..self.len()).step_by(step).map(move |at| self.dn(at / self.pixels, at % self.pixels))
    }

    /// Some neighbouring frames.
    #[must_use]
    pub fn frame_range(&self, of: Range<usize>) -> CaseFrames {
        let (pixels, frames) = &self.is_left_out;
        let frames = if frames.is_empty() { frames.clone() } else { Arc::new(frames[of.clone()].to_vec()) };
        let chosen: Vec<usize> = of.clone().collect();
        CaseFrames {
            times: self.times.select(&chosen),
            first: self.first + of.start * self.pixels,
            is_left_out: (pixels.clone(), frames),
            ..self.clone()
        }
    }

    /// The same with the values of some pixels not known.
    #[must_use]
    pub fn without_pixels(&self, pixels: &[u32]) -> CaseFrames {
        let mut is_left_out = mark_more(&self.is_left_out.0, self.pixels);
        pixels.iter().for_each(|&pixel| is_left_out[pixel as usize] = true);
        CaseFrames { is_left_out: (Arc::new(is_left_out), self.is_left_out.1.clone()), ..self.clone() }
    }

    /// The same with some frames not known.
    #[must_use]
    pub fn without_frames(&self, frames: impl IntoIterator<Item = usize>) -> CaseFrames {
        let mut is_left_out = mark_more(&self.is_left_out.1, self.times.len());
        frames.into_iter().for_each(|frame| is_left_out[frame] = true);
        CaseFrames { is_left_out: (self.is_left_out.0.clone(), Arc::new(is_left_out)), ..self.clone() }
    }

    /// With other values, each from its place in [`CaseFrames::values`] and its value.
    #[must_use]
    pub fn map(&self, mut of: impl FnMut(usize, f32) -> f32) -> CaseFrames {
        let dn = self.values().enumerate().map(|(at, dn)| of(at, dn)).collect();
        CaseFrames { filters: self.filters, ..CaseFrames::new(self.times.clone(), dn) }
    }

    /// Their times alone; every value is not known.
    #[must_use]
    pub fn without_values(&self) -> CaseFrames {
        CaseFrames::new(self.times.clone(), Vec::new())
    }
}

impl PartialEq for CaseFrames {
    fn eq(&self, other: &CaseFrames) -> bool {
        self.times == other.times && self.values().eq(other.values())
    }
}

fn mark_more(already: &[bool], count: usize) -> Vec<bool> {
    if already.is_empty() { vec![false; count] } else { already.to_vec() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    #[test]
    fn what_is_left_out_is_masked_and_nothing_is_copied() {
        let case = testing::case();
        let frames = case.frames.as_ref().unwrap();
        let rest = frames.without_pixels(&[3, 50]).without_frames([1, 4]).without_pixels(&[7]);
        let pixels = case.extent.pixels();
        for (at, dn) in rest.values().enumerate() {
            let (frame, pixel) = (at / pixels, at % pixels);
            let is_left_out = [3, 50, 7].contains(&pixel) || [1, 4].contains(&frame);
            assert_eq!(dn.is_nan(), is_left_out, "{frame} {pixel}");
            assert!(is_left_out || dn == frames.dn(frame, pixel));
        }
        assert!(Arc::ptr_eq(&rest.all, &frames.all));
        let part = rest.frame_range(2..6);
        assert!(Arc::ptr_eq(&part.all, &frames.all) && part.len() == 4 * pixels);
        assert!(part.values_of_pixel(8).map(f32::is_nan).eq([false, false, true, false]));
        assert_eq!(part.dn(3, 8), frames.dn(5, 8));
        assert!(part.every_nth(5).map(f32::to_bits).eq(part.values().step_by(5).map(f32::to_bits)));
        let events = case.events.without_pixels(&[3, 50]);
        assert!(
            Arc::ptr_eq(&events.all, &case.events.all)
                && events.of_pixel(3).is_empty()
                && events.of_pixel(4) == case.events.of_pixel(4)
        );
        assert_eq!(
            events.len(),
            case.events.len() - case.events.of_pixel(3).len() - case.events.of_pixel(50).len()
        );
        assert_eq!((events.iter().count(), events.count(0..pixels)), (events.len(), events.len()));
    }
}
