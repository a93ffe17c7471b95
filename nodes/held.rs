//! Means of held tracks over the exposures of many frames, sixteen pixels at a time.
//!
//! Idea: a pixel that holds its value for thirty frames gives thirty equal means, so nothing is done for each
//! frame of each pixel. Every knot marks the first frame that starts at or after it, one pass over the frames
//! carries the marks on in vectors of sixteen pixels, and only exposures that a knot falls into are
//! integrated. The cost is one mark a knot and one vector operation a frame.
//!
//! An exposure inside a hold has the held value as its mean, exactly; any other is integrated by
//! [`HeldTrack`] (Eq. (5)). Pixels never mix, and nothing is fused: a result does not depend on the tile, on
//! the width of a vector or on the machine.

use multiversion::multiversion;
use photocurrent_core::Exposure;
use photocurrent_sensor::exposure::{HeldTrack, Track};
use std::ops::Range;

/// Pixels side by side: a frame's values of a tile are one cache line.
pub(crate) const TILE: usize = 16;

/// Frames whose means are made in one go: with their marks they fit the fastest cache.
const FRAMES: usize = 192;

/// One number for each pixel of a tile.
pub(crate) type Lanes = [f64; TILE];

/// The exposures of a row's frames, in order of their starts, and a quick way from an instant to a frame.
pub(crate) struct Exposures {
    exposures: Vec<Exposure>,
    /// Of each frame, and one that is never reached.
    starts: Vec<i64>,
    seconds: Vec<f64>,
    longest_ns: i64,
    /// `first[b]` is the first frame that starts at or after `starts[0] + (b << shift)`.
    first: Vec<u32>,
    shift: u32,
}

impl Exposures {
    /// Of frames in order of their starts, which [`photocurrent_core::FrameTimes`] promises.
    pub(crate) fn new(exposures: Vec<Exposure>) -> Exposures {
        let mut starts: Vec<i64> = exposures.iter().map(|exposure| exposure.start.0).collect();
        debug_assert!(starts.is_sorted(), "frames are in order of their starts");
        let seconds = exposures.iter().map(Exposure::seconds).collect();
        let longest_ns = exposures.iter().map(Exposure::length_ns).max().unwrap_or(0);
        let (first, shift) = calendar(&starts);
        starts.push(i64::MAX);
        Exposures { exposures, starts, seconds, longest_ns, first, shift }
    }

    /// Number of frames.
    pub(crate) fn len(&self) -> usize {
        self.exposures.len()
    }

    /// The exposures.
    pub(crate) fn all(&self) -> &[Exposure] {
        &self.exposures
    }

    /// `frames` in pieces for [`HeldMeans::of`].
    pub(crate) fn pieces(frames: Range<usize>) -> impl Iterator<Item = Range<usize>> {
        frames.clone().step_by(FRAMES).map(move |from| from..frames.end.min(from + FRAMES))
    }

    /// The first frame that starts at or after `t`; their number when there is none.
    fn first_from(&self, t: i64) -> usize {
        let origin = self.starts[0];
        let bucket = (t.max(origin).wrapping_sub(origin) as u64 >> self.shift)
            .min(self.first.len() as u64 - 2) as usize;
        let (low, high) = (self.first[bucket] as usize, self.first[bucket + 1] as usize);
        // Most buckets have one frame or none, and then one comparison without a branch decides: a later
        // bucket's frame starts after `t`.
        if high - low <= 1 {
            low + usize::from(self.starts[low] < t)
        } else {
            low + self.starts[low..high].partition_point(|&start| start < t)
        }
    }
}

/// The first frame at or after each of evenly spaced instants, about eight for each frame, and the spacing as
/// a power of two, ns. The last bucket is open.
fn calendar(starts: &[i64]) -> (Vec<u32>, u32) {
    let (Some(&origin), Some(&last)) = (starts.first(), starts.last()) else { return (vec![0, 0], 0) };
    let length = last.wrapping_sub(origin) as u64;
    let spacing = length / (8 * starts.len() as u64) + 1;
    let shift = u64::BITS - 1 - spacing.leading_zeros();
    let buckets = (length >> shift) as usize + 1;
    let mut first = Vec::with_capacity(buckets + 1);
    for (frame, start) in starts.iter().enumerate() {
        // Instants up to this start have their first frame here, unless an earlier one took them.
        let reached = (start.wrapping_sub(origin) as u64 >> shift) as usize;
        first.resize((reached + 1).max(first.len()), frame as u32);
    }
    first.push(starts.len() as u32);
    (first, shift)
}

/// Knots of one pixel: `value[k]` holds from `t[k]` to `t[k + 1]`, the first one before it as well, the last
/// one for ever.
#[derive(Clone, Copy)]
pub(crate) struct Knots<'a, P> {
    /// Instants, ns, not falling.
    pub t: &'a [i64],
    /// Values, as many.
    pub value: &'a [P],
}

/// A frame that no knot marked: no value that is put there has these bits.
const UNMARKED: f64 = f64::from_bits(u64::MAX);

/// Means of a tile, and the room to make them in.
#[derive(Default)]
pub(crate) struct HeldMeans {
    means: Vec<Lanes>,
    straddling: Vec<(usize, usize, f64)>,
}

impl HeldMeans {
    /// Means of up to sixteen pixels over the exposures of `frames`, as `[frame - frames.start][pixel]`; NaN
    /// for a pixel without knots.
    ///
    /// # Panics
    /// As [`HeldTrack::new`], when knots go back in time.
    pub(crate) fn of<'a, P: Copy + Into<f64> + 'a>(
        &mut self,
        exposures: &Exposures,
        frames: Range<usize>,
        pixels: impl Iterator<Item = Knots<'a, P>>,
    ) -> &[Lanes] {
        self.straddling.clear();
        self.means.clear();
        self.means.resize(frames.len(), [UNMARKED; TILE]);
        for (lane, pixel) in pixels.take(TILE).enumerate() {
            if !pixel.t.is_empty() && !frames.is_empty() {
                self.mark(exposures, &frames, lane, pixel);
            }
        }
        carry_on(&mut self.means);
        for &(frame, lane, mean) in &self.straddling {
            self.means[frame][lane] = mean;
        }
        &self.means
    }

    /// Puts every value of a pixel where it is first seen, and integrates the exposures that a knot falls
    /// into.
    fn mark<P: Copy + Into<f64>>(
        &mut self,
        exposures: &Exposures,
        frames: &Range<usize>,
        lane: usize,
        pixel: Knots<P>,
    ) {
        let track = HeldTrack::new(pixel.t, pixel.value);
        let t = track.knots_ns();
        // Knots before the first frame mark it one after the other, which a later piece need not go through
        // again.
        let mut k = if frames.start == 0 {
            0
        } else {
            t.partition_point(|&t| t <= exposures.starts[frames.start]).saturating_sub(1)
        };
        let mut from = frames.start;
        loop {
            let value: f64 = pixel.value[k].into();
            self.means[from - frames.start][lane] = if value.is_nan() { f64::NAN } else { value };
            let Some(&ends) = t.get(k + 1) else { break };
            let next = exposures.first_from(ends).clamp(from, frames.end);
            let mut frame = next;
            while frame > from && exposures.starts[frame - 1] > ends.saturating_sub(exposures.longest_ns) {
                frame -= 1;
                let exposure = exposures.exposures[frame];
                if exposure.end.0 > ends {
                    self.straddling.push((
                        frame - frames.start,
                        lane,
                        track.integral_from(k, exposure) / exposures.seconds[frame],
                    ));
                }
            }
            if next == frames.end {
                break;
            }
            (k, from) = (k + 1, next);
        }
    }
}

/// Gives every frame that no knot marked the value of the frame before.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
fn carry_on(means: &mut [Lanes]) {
    let mut now = [f64::NAN; TILE];
    for means in means {
        for (now, mean) in now.iter_mut().zip(means) {
            *now = if mean.to_bits() == UNMARKED.to_bits() { *now } else { *mean };
            *mean = *now;
        }
    }
}

/// Digital numbers of means: `black_level + gain * (mean * seconds)`, Eq. (5), a gain for each pixel and a
/// length for each frame.
///
/// They go to columns `left` and on of `out`, the same row of each frame, as far as it goes.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub fn develop(
    means: &[Lanes],
    seconds: &[f64],
    black_level: f64,
    gain: &Lanes,
    out: &mut [&mut [f32]],
    left: usize,
) {
    for ((means, seconds), row) in means.iter().zip(seconds).zip(out) {
        let mut dn = [0.0; TILE];
        for n in 0..TILE {
            dn[n] = (black_level + gain[n] * (means[n] * seconds)) as f32;
        }
        match row[left..].first_chunk_mut() {
            Some(whole) => *whole = dn,
            None => row[left..].iter_mut().zip(dn).for_each(|(out, dn)| *out = dn),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::random::Random;

    /// By the definition: every hold counts for its overlap; a single one's value is the mean. The second
    /// number says how many holds there are.
    fn mean(pixel: Knots<f64>, exposure: Exposure) -> (f64, usize) {
        let (mut sum, mut holds, mut held) = (0.0, 0, 0.0);
        for k in 0..pixel.t.len() {
            let from = if k == 0 { i64::MIN } else { pixel.t[k] };
            let to = pixel.t.get(k + 1).copied().unwrap_or(i64::MAX);
            let overlap = to.min(exposure.end.0).saturating_sub(from.max(exposure.start.0)).max(0);
            sum += pixel.value[k] * overlap as f64;
            if overlap > 0 {
                (holds, held) = (holds + 1, pixel.value[k]);
            }
        }
        (if holds == 1 { held } else { sum / exposure.length_ns() as f64 }, holds)
    }

    /// Steady, of changing lengths, in bursts with long gaps between, and all at one instant.
    fn sequences() -> Vec<Vec<Exposure>> {
        let of = |starts: Vec<i64>, length: &dyn Fn(usize) -> i64| {
            starts.iter().enumerate().map(|(l, s)| Exposure::new(*s, s + length(l))).collect()
        };
        vec![
            of((0..500).map(|l| l * 1000 - 7).collect(), &|_| 100),
            of((0..500).map(|l| l * 1000).collect(), &|_| 1000),
            of((0..400).map(|l| l * 1000).collect(), &|l| 1 + 5000 * (l as i64 % 3)),
            of((0..300).map(|l| (l / 100) * 200_000 + l % 100 / 3).collect(), &|l| 40 + l as i64),
            of(vec![250_000; 20], &|l| 1 + l as i64),
            of(vec![10], &|_| 500_000),
        ]
    }

    #[test]
    fn means_are_those_of_every_hold_for_its_overlap_in_any_pieces() {
        let mut random = Random::new(7, &[]);
        let mut pixels: Vec<(Vec<i64>, Vec<f64>)> = Vec::new();
        for count in [1, 2, 3, 5, 10, 40, 300, 1000] {
            let mut t: Vec<i64> =
                (0..count).map(|_| (random.uniform() * 800_000.0) as i64 - 100_000).collect();
            if count % 2 == 0 {
                // Many equal instants, and many on the edges of exposures.
                t.iter_mut().for_each(|t| *t -= *t % 1000);
            }
            t.sort_unstable();
            pixels.push((t, (0..count).map(|_| 0.1 + random.uniform()).collect()));
        }
        let knots = || pixels.iter().map(|(t, value)| Knots { t, value });
        for (n, exposures) in sequences().into_iter().enumerate() {
            let exposures = Exposures::new(exposures);
            let whole = HeldMeans::default().of(&exposures, 0..exposures.len(), knots()).to_vec();
            for (l, exposure) in exposures.all().iter().enumerate() {
                for (lane, pixel) in knots().enumerate() {
                    let (expected, holds) = mean(pixel, *exposure);
                    let found = whole[l][lane];
                    // Exact when nothing is summed.
                    let tolerance = if holds == 1 { 0.0 } else { 1e-13 * holds as f64 };
                    assert!(
                        (found / expected - 1.0).abs() <= tolerance,
                        "sequence {n}, frame {l}, pixel {lane}: {found}, {expected}"
                    );
                }
            }
            for length in [1, 3, 64] {
                for from in (0..exposures.len()).step_by(length) {
                    let frames = from..exposures.len().min(from + length);
                    let mut means = HeldMeans::default();
                    let piece = means.of(&exposures, frames.clone(), knots());
                    for (piece, whole) in piece.iter().zip(&whole[frames]) {
                        assert_eq!(
                            piece[..pixels.len()],
                            whole[..pixels.len()],
                            "sequence {n}, pieces of {length}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn frames_are_found_where_a_search_finds_them() {
        for exposures in sequences().into_iter().map(Exposures::new) {
            for t in (-2_000..700_000)
                .step_by(97)
                .chain(exposures.all().iter().flat_map(|e| [e.start.0 - 1, e.start.0, e.start.0 + 1]))
                .chain([i64::MIN, i64::MAX])
            {
                assert_eq!(
                    exposures.first_from(t),
                    exposures.all().iter().filter(|e| e.start.0 < t).count(),
                    "{t}"
                );
            }
        }
    }

    #[test]
    fn what_is_unknown_is_marked_and_stays_so_until_something_is_known() {
        let exposures = Exposures::new((0..4).map(|l| Exposure::new(10 * l, 10 * l + 5)).collect());
        // The bits that mark a frame without knot must be no way to be overlooked.
        let value = [1.0, f64::from_bits(u64::MAX), 3.0];
        let pixels = [Knots { t: &[0, 10, 30], value: &value }, Knots { t: &[], value: &[] }];
        let mut means = HeldMeans::default();
        let found = means.of(&exposures, 0..4, pixels.into_iter());
        assert_eq!(
            found
                .iter()
                .map(|lanes| lanes[0])
                .map(|mean| (mean.is_nan(), mean))
                .filter(|(nan, _)| !nan)
                .map(|(_, mean)| mean)
                .collect::<Vec<_>>(),
            [1.0, 3.0]
        );
        assert!(found[1][0].is_nan() && found[2][0].is_nan() && found.iter().all(|lanes| lanes[1].is_nan()));
    }

    #[test]
    fn digital_numbers_go_to_their_columns_also_where_a_row_ends() {
        let mut rows = [vec![0.0_f32; 19], vec![0.0; 19]];
        let mut out: Vec<&mut [f32]> = rows.iter_mut().map(|row| &mut row[..]).collect();
        let gain = std::array::from_fn(|n| n as f64);
        develop(&[[2.0; TILE], [3.0; TILE]], &[0.5, 1.0], 10.0, &gain, &mut out, 0);
        develop(&[[2.0; TILE]], &[0.5], 10.0, &gain, &mut out, 16);
        assert_eq!((rows[0][15], rows[0][16], rows[0][18]), (25.0, 10.0, 12.0));
        assert_eq!((rows[1][1], rows[1][15], rows[1][16]), (13.0, 55.0, 0.0));
    }
}
