//! Frames: their times, and values of some of them.
//!
//! Times are those of every frame. Values are read from up to [`Most::frames`] frames: all of a short
//! recording, otherwise runs of neighbours spread evenly over it, so that pictures that are there twice show.

use crate::error::FormatError;
use crate::recording::{FrameStamp, FramesAbout, Pictures};
use serde::Serialize;

/// Neighbours in a run of frames that are read.
const RUN: usize = 8;
/// A value that so large a share of a frame has, and none exceeds, is where the sensor ends.
const CLIPPED_SHARE: f64 = 0.002;
/// Frames, gaps and the like that are listed.
const MOST_LISTED: usize = 16;

/// Middle and ends of some times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Spread {
    /// Smallest, ns.
    pub min_ns: i64,
    /// Middle, the lower one of an even number, ns.
    pub median_ns: i64,
    /// Largest, ns.
    pub max_ns: i64,
}

impl Spread {
    /// Of some times; none of none.
    pub fn of(mut times: Vec<i64>) -> Option<Spread> {
        times.sort_unstable();
        Some(Spread {
            min_ns: *times.first()?,
            median_ns: times[(times.len() - 1) / 2],
            max_ns: *times.last()?,
        })
    }
}

/// A time without frames where there should be some.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Gap {
    /// The frame after it.
    pub frame: usize,
    /// From the frame before to it, ns.
    pub length_ns: i64,
    /// How many frames would fit.
    pub missing: i64,
}

/// What the values of the frames that were read are like.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ValuesSurvey {
    /// Which frames were read.
    pub read: Vec<usize>,
    /// Why some could not be.
    pub unreadable: Vec<String>,
    /// Which these are.
    pub unreadable_frames: Vec<usize>,
    /// Values that were read.
    pub values: u64,
    /// Not a number.
    pub nan: u64,
    /// Infinite.
    pub infinite: u64,
    /// Below zero.
    pub negative: u64,
    /// Smallest finite value.
    pub min: f64,
    /// Mean of the finite values.
    pub mean: f64,
    /// Largest finite value.
    pub max: f64,
    /// Share of the finite values at the largest one, where so many are there that they look clipped;
    /// otherwise 0.
    pub clipped_share: f64,
    /// Frames in which every value is the same.
    pub constant: Vec<usize>,
    /// Frames that are, value for value, the one before.
    pub repeated: Vec<usize>,
}

/// Frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct FramesSurvey {
    /// How many.
    pub count: u64,
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Colours.
    pub colour: &'static str,
    /// Bits of a stored value; 32 = floats.
    pub bits: u32,
    /// First and last instant, ns: exposures where they are known, otherwise stamps.
    pub span_ns: Option<(i64, i64)>,
    /// From one frame to the next.
    pub period: Option<Spread>,
    /// Of those that are stamped.
    pub exposure: Option<Spread>,
    /// How many have both ends of the exposure stamped.
    pub exposures_stamped: u64,
    /// What the one stamp means, where the file says so: `start`, `middle`, `end`.
    pub stamp: Option<crate::declared::StampRole>,
    /// Delay from row to row, where the file says so.
    pub row_time_ns: Option<i64>,
    /// How stored values follow from linear ones, where the file says so.
    pub transfer: Option<crate::declared::Transfer>,
    /// Are all periods the same to the step of the stamps? Then they may have been made from a rate.
    pub is_constant_rate: bool,
    /// Gaps of more than one and a half periods, the first ones.
    pub gaps: Vec<Gap>,
    /// All gaps.
    pub gap_count: u64,
    /// Frames that begin before the one before them.
    pub backward: u64,
    /// Frames with the stamp of the one before.
    pub equal_stamps: u64,
    /// Frames whose exposure ends before it begins, or at once.
    pub empty_exposures: u64,
    /// Frames that are exposed until after the next one begins.
    pub overlapping: u64,
    /// Values.
    pub values: ValuesSurvey,
    /// What the reader did or left out.
    pub notes: Vec<String>,
}

/// Where a frame begins as far as its stamps say.
pub(super) fn begins(stamp: &FrameStamp) -> i64 {
    stamp.exposure.map_or(stamp.at, |exposure| exposure.0)
}

/// The middle of its exposure as far as its stamps say; the plain stamp without an exposure.
pub(super) fn middle(stamp: &FrameStamp) -> i64 {
    stamp.exposure.map_or(stamp.at, |(start, end)| start.saturating_add(end.saturating_sub(start) / 2))
}

/// Which of `count` frames are read when at most `most` may be: runs of neighbours from the first to the
/// last.
pub fn chosen(count: usize, most: usize) -> Vec<usize> {
    if count <= most {
        return (0..count).collect();
    }
    let runs = (most / RUN).max(1);
    let run = most.min(RUN);
    let mut frames: Vec<usize> = (0..runs)
        .flat_map(|n| {
            if runs == 1 {
                0..run
            } else {
                let from = n * (count - run) / (runs - 1);
                from..from + run
            }
        })
        .collect();
    frames.dedup();
    frames
}

/// Times and notes; values are filled in by [`Values`].
pub(super) fn times(about: &FramesAbout) -> FramesSurvey {
    let stamps = &about.stamps;
    let periods: Vec<i64> =
        stamps.windows(2).map(|pair| begins(&pair[1]).saturating_sub(begins(&pair[0]))).collect();
    let exposures: Vec<(i64, i64)> = stamps.iter().filter_map(|stamp| stamp.exposure).collect();
    let first = stamps.iter().map(begins).min();
    let last = stamps
        .iter()
        .map(|stamp| stamp.exposure.map_or(stamp.at, |exposure| exposure.1.max(exposure.0)))
        .max();
    let period = Spread::of(periods.iter().copied().filter(|period| *period > 0).collect());
    let usual = period.map_or(i64::MAX, |period| period.median_ns);
    let gaps: Vec<Gap> = periods
        .iter()
        .enumerate()
        .filter(|(_, period)| **period as f64 > 1.5 * usual as f64)
        .map(|(n, period)| Gap {
            frame: n + 1,
            length_ns: *period,
            missing: ((*period as f64 / usual as f64).round() as i64 - 1).max(1),
        })
        .collect();
    FramesSurvey {
        count: stamps.len() as u64,
        width: about.extent.width,
        height: about.extent.height,
        colour: about.colour.name(),
        bits: about.bits,
        span_ns: first.zip(last),
        period,
        exposure: Spread::of(exposures.iter().map(|(start, end)| end.saturating_sub(*start)).collect()),
        exposures_stamped: exposures.len() as u64,
        stamp: about.stamp_role,
        row_time_ns: about.row_time_ns,
        transfer: about.transfer,
        // Of a rate that is no whole number of steps, periods are of two lengths, a step apart.
        is_constant_rate: stamps.len() > 8
            && period
                .is_some_and(|period| period.max_ns - period.min_ns <= 1_000.min(period.median_ns / 1_000)),
        gap_count: gaps.len() as u64,
        gaps: gaps.into_iter().take(MOST_LISTED).collect(),
        backward: periods.iter().filter(|period| **period < 0).count() as u64,
        equal_stamps: periods.iter().filter(|period| **period == 0).count() as u64,
        empty_exposures: exposures.iter().filter(|(start, end)| end <= start).count() as u64,
        overlapping: stamps
            .windows(2)
            .filter(|pair| pair[0].exposure.is_some_and(|(_, end)| end > begins(&pair[1])))
            .count() as u64,
        values: ValuesSurvey::default(),
        notes: about.notes.clone(),
    }
}

/// Looks at the values of frames one by one.
#[derive(Default)]
pub(super) struct Values {
    found: ValuesSurvey,
    sum: f64,
    at_largest: u64,
    before: Option<(usize, u64)>,
}

impl Values {
    /// Takes what was read of a frame.
    pub(super) fn add(&mut self, frame: usize, values: &[f32]) {
        let found = &mut self.found;
        if found.read.is_empty() {
            (found.min, found.max) = (f64::INFINITY, f64::NEG_INFINITY);
        }
        found.read.push(frame);
        found.values += values.len() as u64;
        let (mut least, mut most, mut at_most) = (f32::INFINITY, f32::NEG_INFINITY, 0u64);
        let mut mix = 0xcbf2_9ce4_8422_2325_u64;
        for value in values {
            mix = (mix ^ u64::from(value.to_bits())).wrapping_mul(0x0100_0000_01b3).rotate_left(17);
            if value.is_finite() {
                self.sum += f64::from(*value);
                found.negative += u64::from(*value < 0.0);
                least = least.min(*value);
                if *value > most {
                    (most, at_most) = (*value, 0);
                }
                at_most += u64::from(*value == most);
            } else {
                found.nan += u64::from(value.is_nan());
                found.infinite += u64::from(value.is_infinite());
            }
        }
        if f64::from(most) > found.max {
            self.at_largest = 0;
        }
        if f64::from(most) >= found.max {
            self.at_largest += at_most;
        }
        found.min = found.min.min(least.into());
        found.max = found.max.max(most.into());
        if least == most && values.len() > 1 {
            found.constant.push(frame);
        }
        if frame.checked_sub(1).is_some_and(|before| self.before == Some((before, mix))) {
            found.repeated.push(frame);
        }
        // Frames of no number at all repeat nothing.
        self.before = (least <= most).then_some((frame, mix));
    }

    /// A frame that could not be read.
    pub(super) fn unreadable(&mut self, frame: usize, error: &FormatError) {
        self.found.unreadable_frames.push(frame);
        if self.found.unreadable.len() < MOST_LISTED {
            self.found.unreadable.push(error.to_string().replace("\n  hint: ", "; "));
        }
    }

    pub(super) fn survey(mut self) -> ValuesSurvey {
        let finite = self.found.values - self.found.nan - self.found.infinite;
        if finite == 0 {
            (self.found.min, self.found.mean, self.found.max) = (0.0, 0.0, 0.0);
            return self.found;
        }
        self.found.mean = self.sum / finite as f64;
        let share = self.at_largest as f64 / finite as f64;
        let is_flat = self.found.min == self.found.max;
        self.found.clipped_share = if share >= CLIPPED_SHARE && !is_flat { share } else { 0.0 };
        self.found
    }
}

/// Reads frames and hands each on, with what could not be read reported to `values`.
pub(super) fn read(
    pictures: &dyn Pictures,
    frames: &[usize],
    mut each: impl FnMut(usize, &[f32]),
) -> ValuesSurvey {
    let mut values = Values::default();
    let mut buffer = Vec::new();
    for &frame in frames {
        match pictures.read(frame, &mut buffer) {
            Ok(()) => {
                values.add(frame, &buffer);
                each(frame, &buffer);
            }
            Err(error) => values.unreadable(frame, &error),
        }
    }
    values.survey()
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Colour, Extent};

    fn about(stamps: Vec<FrameStamp>) -> FramesAbout {
        let extent = Extent { width: 4, height: 3 };
        FramesAbout {
            extent,
            colour: Colour::Mono,
            bits: 8,
            stamps,
            stamp_role: None,
            row_time_ns: None,
            transfer: None,
            notes: Vec::new(),
        }
    }

    fn at(at: i64) -> FrameStamp {
        FrameStamp { at, exposure: Some((at, at + 5)) }
    }

    #[test]
    fn gaps_say_how_many_frames_are_missing() {
        let found = times(&about([0, 10, 20, 50, 60, 60, 55].map(at).to_vec()));
        assert_eq!(found.gaps, [Gap { frame: 3, length_ns: 30, missing: 2 }]);
        assert_eq!((found.equal_stamps, found.backward, found.overlapping), (1, 1, 2));
        assert_eq!(found.period, Some(Spread { min_ns: 10, median_ns: 10, max_ns: 30 }));
    }

    #[test]
    fn long_recordings_are_read_in_runs_from_the_first_to_the_last() {
        let frames = chosen(10_000, 64);
        assert_eq!((frames.len(), frames[0], *frames.last().unwrap()), (64, 0, 9_999));
        assert_eq!(frames.windows(2).filter(|pair| pair[1] == pair[0] + 1).count(), 56);
        assert_eq!(chosen(3, 64), [0, 1, 2]);
        assert!(chosen(70, 64).windows(2).all(|pair| pair[0] < pair[1]));
    }

    #[test]
    fn values_that_no_light_has_are_counted() {
        let mut values = Values::default();
        values.add(0, &[1.0, f32::NAN, f32::INFINITY, -2.0]);
        assert!(values.found.repeated.is_empty(), "the first frame repeats none");
        values.add(1, &[3.0; 4]);
        values.add(2, &[3.0; 4]);
        values.add(4, &[3.0; 4]);
        let found = values.survey();
        assert_eq!((found.nan, found.infinite, found.negative), (1, 1, 1));
        assert_eq!((found.constant, found.repeated), (vec![1, 2, 4], vec![2]));
        assert_eq!((found.min, found.max, found.clipped_share), (-2.0, 3.0, 12.0 / 14.0));
    }
}
