//! Where the recording and a simulation of it differ, event by event and frame value by frame value.
//!
//! Each recorded event is matched with the nearest simulated one of its pixel and polarity, in order of time, none twice. What is left over on one side is an extra
//! event (recorded, not simulated) or a missing one (simulated, not recorded).

use crate::case::{Case, Recorded};
use crate::sample::Sample;
use rayon::prelude::*;

/// Events further apart than this are no pair, ns.
pub const PAIR_NS: i64 = 1_000_000;

/// How one event of either side fared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// Both have it; recorded less simulated time, ns.
    Paired(i64),
    /// Only the recording has it.
    Extra,
    /// Only the simulation has it.
    Missing,
}

/// One event of either side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EventDifference {
    /// Pixel of the array.
    pub pixel: u32,
    /// When it was recorded, or simulated when it is missing, ns.
    pub t_ns: i64,
    /// +1 or -1.
    pub polarity: i8,
    /// How it fared.
    pub fate: Fate,
}

/// One frame value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameDifference {
    /// Pixel of the array.
    pub pixel: u32,
    /// Frame.
    pub frame: u32,
    /// Middle of the row's exposure, ns.
    pub t_ns: i64,
    /// Log of recorded over simulated signal.
    pub log_ratio: f64,
}

/// All differences of a sample, pixel by pixel and in order of time; between the first and the last exposure where there are frames, as light is a guess beyond.
pub fn of_events(recording: &Case, simulation: &Case, sample: &Sample) -> Vec<EventDifference> {
    let one = |n: usize| {
        let pixel = sample.pixels[n];
        let mut found = Vec::new();
        for polarity in [1, -1] {
            let of = |case: &Case| -> Vec<Recorded> { case.events.of(pixel as usize).iter().filter(|event| event.polarity == polarity).copied().collect() };
            let tell = |t_ns, fate| EventDifference { pixel, t_ns, polarity, fate };
            pair(&of(recording), &of(simulation), |t_ns, fate| found.push(tell(t_ns, fate)));
        }
        let (_, y) = recording.place(pixel as usize);
        if let Some(times) = recording.frames.as_ref().map(|frames| &frames.times).filter(|times| !times.is_empty()) {
            let (first, last) = (times.exposure(0, y).start.0, times.exposure(times.len() - 1, y).end.0);
            found.retain(|difference| difference.t_ns >= first && difference.t_ns <= last);
        }
        found.sort_by_key(|difference| difference.t_ns);
        found
    };
    (0..sample.len()).into_par_iter().with_min_len(64).flat_map_iter(one).collect()
}

/// Matches two rising trains, nearest first where they compete.
fn pair(recorded: &[Recorded], simulated: &[Recorded], mut tell: impl FnMut(i64, Fate)) {
    let (mut a, mut b) = (0, 0);
    while a < recorded.len() || b < simulated.len() {
        match (recorded.get(a), simulated.get(b)) {
            (Some(here), Some(there)) => {
                let gap = here.t_in_ns - there.t_in_ns;
                // A neighbour that is nearer to the partner takes it.
                let next_is_nearer = |next: Option<&Recorded>, partner: &Recorded| next.is_some_and(|next| (next.t_in_ns - partner.t_in_ns).abs() < gap.abs());
                if gap < 0 && (gap < -PAIR_NS || next_is_nearer(recorded.get(a + 1), there)) {
                    tell(here.t_in_ns, Fate::Extra);
                    a += 1;
                } else if gap > 0 && (gap > PAIR_NS || next_is_nearer(simulated.get(b + 1), here)) {
                    tell(there.t_in_ns, Fate::Missing);
                    b += 1;
                } else {
                    tell(here.t_in_ns, Fate::Paired(gap));
                    (a, b) = (a + 1, b + 1);
                }
            }
            (Some(here), None) => {
                tell(here.t_in_ns, Fate::Extra);
                a += 1;
            }
            (None, Some(there)) => {
                tell(there.t_in_ns, Fate::Missing);
                b += 1;
            }
            (None, None) => {}
        }
    }
}

/// Frame values of a sample where both sides have light above `black_level` and the recording is below `saturation_dn`.
pub fn of_frames(recording: &Case, simulation: &Case, sample: &Sample, black_level: f64, saturation_dn: f64) -> Vec<FrameDifference> {
    let Some(frames) = &recording.frames else { return Vec::new() };
    let mut found = Vec::new();
    for &pixel in &sample.pixels {
        let (_, y) = recording.place(pixel as usize);
        for frame in 0..frames.times.len() {
            let (here, there) = (recording.dn(frame, pixel as usize), simulation.dn(frame, pixel as usize));
            let (signal, simulated) = (here - black_level, there - black_level);
            if signal > 0.0 && simulated > 0.0 && here < saturation_dn {
                let exposure = frames.times.exposure(frame, y);
                let t_ns = i64::midpoint(exposure.start.0, exposure.end.0);
                found.push(FrameDifference { pixel, frame: frame as u32, t_ns, log_ratio: libm::log(signal / simulated) });
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn train(stamps: &[i64]) -> Vec<Recorded> {
        stamps.iter().map(|&t| Recorded { t_in_ns: t * 1000, t_off_ns: t * 1000, polarity: 1 }).collect()
    }

    fn told(recorded: &[i64], simulated: &[i64]) -> Vec<(i64, Fate)> {
        let mut found = Vec::new();
        pair(&train(recorded), &train(simulated), |t_ns, fate| found.push((t_ns / 1000, fate)));
        found
    }

    #[test]
    fn shifted_trains_pair_up_and_the_odd_one_is_left_over() {
        assert_eq!(told(&[100, 5000], &[90, 5020]), [(100, Fate::Paired(10_000)), (5000, Fate::Paired(-20_000))]);
        assert_eq!(told(&[100, 400, 5000], &[390, 5000]), [(100, Fate::Extra), (400, Fate::Paired(10_000)), (5000, Fate::Paired(0))]);
        assert_eq!(told(&[400], &[100, 390, 9000]), [(100, Fate::Missing), (400, Fate::Paired(10_000)), (9000, Fate::Missing)]);
        assert_eq!(told(&[100], &[5000]), [(100, Fate::Extra), (5000, Fate::Missing)]);
    }
}
