//! Events in step with the frames.
//!
//! In a camera that takes frames and events with one photodiode, the switching of the frame path can fire
//! pixels: bursts of one sign, at the same time in every frame. So the time from each frame's stamp to the
//! next is cut into bins, and events are counted by bin, frame by frame. What a scene does is at another
//! place in the next frame; what is at one place in nearly all is the sensor's, or a simulator's that works
//! frame by frame.

use super::readout::{Readout, ReadoutSurvey};
use photocurrent_core::Extent;
use serde::Serialize;

/// Bins from one frame to the next.
pub const PHASES: usize = 64;
/// A frame with fewer events decides nothing.
const FEWEST: u32 = 2 * PHASES as u32;

/// Events by the time since the frame before them.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PhaseSurvey {
    /// Frames with enough events to be counted.
    pub frames: u64,
    /// Length of a bin, ns, at the middle period.
    pub bin_ns: i64,
    /// Share of a frame's events in each bin, mean over the frames, times the number of bins: 1 everywhere
    /// where nothing is in step.
    pub profile: Vec<f64>,
    /// Share of ON events in each bin.
    pub on_share: Vec<f64>,
    /// The bin with most.
    pub peak: usize,
    /// How far it is above the middle bin, in standard errors from frame to frame.
    pub peak_sigma: f64,
    /// In how many of the frames it has over 1.5 times the frame's mean.
    pub peak_frames: u64,
    /// The same row by row, for each sign with enough events.
    pub readout: Vec<ReadoutSurvey>,
}

/// Counts events by phase.
pub(super) struct Phase {
    /// Where frames begin, ns, rising.
    starts: Vec<i64>,
    now: usize,
    counts: [(u32, u32); PHASES],
    frames: u64,
    sums: [f64; PHASES],
    squares: [f64; PHASES],
    over: [u64; PHASES],
    on: [u64; PHASES],
    all: [u64; PHASES],
    readout: Option<Readout>,
}

impl Phase {
    /// With the instants at which frames begin, and the pixels whose rows are distinguished; none when there
    /// are too few frames to be in step with.
    pub(super) fn new(mut starts: Vec<i64>, extent: Extent) -> Option<Phase> {
        starts.sort_unstable();
        starts.dedup();
        let zero = Phase {
            starts,
            now: usize::MAX,
            counts: [(0, 0); PHASES],
            frames: 0,
            sums: [0.0; PHASES],
            squares: [0.0; PHASES],
            over: [0; PHASES],
            on: [0; PHASES],
            all: [0; PHASES],
            readout: Readout::new(extent),
        };
        (zero.starts.len() > 2).then_some(zero)
    }

    /// Takes an event.
    #[inline]
    pub(super) fn add(&mut self, t: i64, y: u16, on: u8) {
        let is_here = self.now != usize::MAX && self.starts[self.now] <= t && t < self.starts[self.now + 1];
        if !is_here {
            let next = self.starts.partition_point(|start| *start <= t);
            if next == 0 || next == self.starts.len() {
                return;
            }
            self.close();
            self.now = next - 1;
        }
        let (from, to) = (self.starts[self.now], self.starts[self.now + 1]);
        let phase = t.abs_diff(from) as f64 / to.abs_diff(from) as f64;
        if let Some(readout) = &mut self.readout {
            readout.add(self.now, phase, y, on);
        }
        let count = &mut self.counts[((phase * PHASES as f64) as usize).min(PHASES - 1)];
        count.0 += 1;
        count.1 += u32::from(on & 1);
    }

    fn close(&mut self) {
        let all: u32 = self.counts.iter().map(|count| count.0).sum();
        if all >= FEWEST {
            self.frames += 1;
            for (bin, (count, on)) in self.counts.iter().enumerate() {
                let over_mean = f64::from(*count) * PHASES as f64 / f64::from(all);
                self.sums[bin] += over_mean;
                self.squares[bin] += over_mean * over_mean;
                self.over[bin] += u64::from(over_mean > 1.5);
                self.on[bin] += u64::from(*on);
                self.all[bin] += u64::from(*count);
            }
        }
        self.counts = [(0, 0); PHASES];
    }

    pub(super) fn survey(mut self) -> Option<PhaseSurvey> {
        self.close();
        if self.frames < 2 {
            return None;
        }
        let mut periods: Vec<i64> =
            self.starts.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
        periods.sort_unstable();
        let profile: Vec<f64> = self.sums.iter().map(|sum| sum / self.frames as f64).collect();
        let peak = (0..PHASES).max_by(|a, b| profile[*a].total_cmp(&profile[*b])).unwrap_or(0);
        let mut sorted = profile.clone();
        sorted.sort_by(f64::total_cmp);
        let n = self.frames as f64;
        let variance = (self.squares[peak] / n - profile[peak] * profile[peak]).max(0.0) * n / (n - 1.0);
        let peak_sigma = (profile[peak] - sorted[PHASES / 2]) / (variance / n).sqrt().max(1e-3);
        Some(PhaseSurvey {
            peak_sigma,
            frames: self.frames,
            bin_ns: periods[periods.len() / 2] / PHASES as i64,
            on_share: self
                .on
                .iter()
                .zip(&self.all)
                .map(|(on, all)| *on as f64 / (*all).max(1) as f64)
                .collect(),
            peak_frames: self.over[peak],
            readout: self
                .readout
                .as_ref()
                .map_or_else(Vec::new, |readout| readout.survey(periods[periods.len() / 2] as f64)),
            profile,
            peak,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXTENT: Extent = Extent { width: 8, height: 7 };

    #[test]
    fn a_burst_in_every_frame_stands_at_its_place() {
        let mut phase = Phase::new((0..20).map(|k| k * 6_400).collect(), EXTENT).unwrap();
        for t in 0..20 * 6_400 {
            let is_burst = (3_000..3_100).contains(&(t % 6_400));
            if is_burst || t % 20 == 0 {
                phase.add(t, (t % 7) as u16, u8::from(is_burst));
            }
        }
        let found = phase.survey().unwrap();
        assert_eq!((found.frames, found.bin_ns, found.peak, found.peak_frames), (19, 100, 30, 19));
        assert!(found.peak_sigma > 50.0, "{found:?}");
        assert!(found.profile[30] > 10.0 && found.on_share[30] > 0.9 && found.on_share[3] == 0.0);
    }

    #[test]
    fn what_wanders_is_not_in_step() {
        let mut phase = Phase::new((0..65).map(|k| k * 6_400).collect(), EXTENT).unwrap();
        for frame in 0..64 {
            (0..600).for_each(|k| phase.add(frame * 6_400 + frame * 100 + k % 100, 3, 1));
        }
        let found = phase.survey().unwrap();
        assert!(
            found.peak_frames <= 1 && found.profile.iter().all(|over| (over - 1.0).abs() < 1e-9),
            "{found:?}"
        );
    }
}
