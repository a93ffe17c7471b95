//! Shared by the direct tests: the events of the array in order of time, and the halves of the array.

use photocurrent_scene::case::Case;

/// Side of the blocks of [`half`], pixels.
pub(super) const BLOCK: u32 = 8;

/// Which half of the array a pixel is of: a checkerboard of blocks.
pub(super) fn half(case: &Case, pixel: usize) -> usize {
    let (x, y) = case.pixel_place(pixel);
    ((x / BLOCK + y / BLOCK) % 2) as usize
}

/// Frequencies of light that flickers, Hz: lamps on 50 and 60 Hz mains, and dimmers.
pub(super) const LAMPS_HZ: std::ops::Range<u32> = 45..400;

/// Time step of the search for a rhythm, ns: a fifth of the shortest period.
pub(super) const LAMPS_STEP_NS: i64 = 500_000;

/// Means of a series over 12.5 ms in steps of [`LAMPS_STEP_NS`] on either side: scenes change slowly, lamps
/// do not.
pub(super) fn slow_mean(series: &[f64]) -> Vec<f64> {
    let half = (12_500_000 / LAMPS_STEP_NS) as usize;
    let mut sums = vec![0.0];
    series.iter().for_each(|value| sums.push(sums[sums.len() - 1] + value));
    let mean = |k: usize| {
        let (from, to) = (k.saturating_sub(half), (k + half + 1).min(series.len()));
        (sums[to] - sums[from]) / (to - from) as f64
    };
    (0..series.len()).map(mean).collect()
}

/// An event of the whole array in order of the recorded time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StampedEvent {
    /// The recorded off-pixel time, ns.
    pub t_ns: i64,
    /// `y * width + x`.
    pub pixel: u32,
    /// +1 or -1.
    pub polarity: i8,
}

/// All events of the array in order of their recorded time.
#[derive(Clone, Debug, Default)]
pub struct EventsByTime(pub Vec<StampedEvent>);

impl EventsByTime {
    /// All events of a recording, sorted by recorded time.
    pub fn from_case(case: &Case) -> EventsByTime {
        let mut all = Vec::with_capacity(case.events.len());
        for pixel in 0..case.events.pixels() {
            all.extend(case.events.of_pixel(pixel).iter().map(|event| StampedEvent {
                t_ns: event.t_off_ns,
                pixel: pixel as u32,
                polarity: event.polarity,
            }));
        }
        all.sort_unstable_by_key(|event| (event.t_ns, event.pixel));
        EventsByTime(all)
    }

    /// First and last stamp, ns; none without events.
    pub fn span(&self) -> Option<(i64, i64)> {
        Some((self.0.first()?.t_ns, self.0.last()?.t_ns))
    }
}

/// Where a curve is lowest, by a parabola through the lowest point and its neighbours; none at a rim.
pub(super) fn lowest(curve: &[f64]) -> Option<f64> {
    let k = (0..curve.len()).min_by(|&a, &b| curve[a].total_cmp(&curve[b]))?;
    let (before, here, after) = (*curve.get(k.checked_sub(1)?)?, curve[k], *curve.get(k + 1)?);
    let bend = before - 2.0 * here + after;
    let between = if bend > 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
    Some(k as f64 + between)
}
