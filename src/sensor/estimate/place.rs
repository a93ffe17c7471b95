//! Whether events and frames lie on one pixel grid: the shift in whole pixels at which they agree best.
//!
//! Where a frame's logarithm changes from one frame to the next, small patches are taken; the events of each
//! pixel of a patch, summed between the two mid-exposures, are held against the change of the frames that
//! many pixels further right and down. The shift with the largest correlation over all patches is where the
//! frames see what the events see.
//!
//! Limits: shifts up to [`REACH`] pixels; one shift for the whole picture, no rotation and no scale. Events
//! that come late in a scene that moves one way look like a shift against the motion: give several offsets in
//! time around the one that [`super::offset()`] finds.

use super::draw::{Estimate, by_draws, peak};

/// Pixels in a row and in a column of a patch.
pub const SIDE: usize = 16;
/// Pixels to each side that frames are looked for in.
pub const REACH: usize = 4;
/// Pixels in a row and in a column of a frame's patch.
pub const FRAME_SIDE: usize = SIDE + 2 * REACH;
/// Shifts in one direction.
const SHIFTS: usize = 2 * REACH + 1;
/// A weaker correlation is none, as for a shift in time.
const LEAST_CORRELATION: f64 = 0.15;
/// Patches with events, at least.
const FEWEST: usize = 8;
/// Log changes beyond this many times the root mean square of a patch are brought to it: a lamp or a hot
/// pixel would be all that is seen.
const CLIPPED: f32 = 3.0;

/// Part of the picture between two frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Patch {
    /// Middles of the exposures, ns.
    mids_ns: (i64, i64),
    /// Log change of the frames, [y][x] of [`FRAME_SIDE`] squared; not finite = not known.
    change: Vec<f32>,
    start_ns: i64,
    step_ns: i64,
    steps: usize,
    /// ON less OFF events, [step][y][x].
    net: Vec<i16>,
}

impl Patch {
    /// With the log change of the frames between two mid-exposures, [`FRAME_SIDE`] squared; events are taken
    /// up to `margin_ns` to each side, in steps of `step_ns`. None where the change has another size.
    pub fn new(mids_ns: (i64, i64), margin_ns: i64, step_ns: i64, change: Vec<f32>) -> Option<Patch> {
        let step_ns = step_ns.max(1);
        let start_ns = mids_ns.0.saturating_sub(margin_ns);
        let steps =
            (mids_ns.1.saturating_add(margin_ns).saturating_sub(start_ns) / step_ns + 1).max(1) as usize;
        (change.len() == FRAME_SIDE * FRAME_SIDE).then(|| Patch {
            mids_ns,
            change,
            start_ns,
            step_ns,
            steps,
            net: vec![0; steps * SIDE * SIDE],
        })
    }

    /// Takes an event at a pixel of the patch, from 0; what lies outside in time is let go.
    #[inline]
    pub fn event(&mut self, t_ns: i64, x: usize, y: usize, is_on: bool) {
        let step = t_ns.saturating_sub(self.start_ns).div_euclid(self.step_ns);
        if (0..self.steps as i64).contains(&step) && x < SIDE && y < SIDE {
            let net = &mut self.net[(step as usize * SIDE + y) * SIDE + x];
            *net = net.saturating_add(if is_on { 1 } else { -1 });
        }
    }

    /// Net events of each pixel between the two mid-exposures, shifted; none where that leaves the patch's
    /// time.
    fn between(&self, offset_ns: f64) -> Option<Vec<f32>> {
        let at = |t: i64| (t as f64 + offset_ns - self.start_ns as f64) / self.step_ns as f64;
        let (from, to) = (at(self.mids_ns.0), at(self.mids_ns.1));
        if from < 0.0 || to > self.steps as f64 || from >= to {
            return None;
        }
        let mut sums = vec![0.0; SIDE * SIDE];
        for (step, net) in self.net.chunks(SIDE * SIDE).enumerate() {
            let part = (to.min(step as f64 + 1.0) - from.max(step as f64)).clamp(0.0, 1.0) as f32;
            if part > 0.0 {
                sums.iter_mut().zip(net).for_each(|(sum, net)| *sum += part * f32::from(*net));
            }
        }
        Some(sums)
    }

    /// Sums of (event x frame, event x event, frame x frame), less the means: [offset][shift]; none at an
    /// offset without events, or with unknown values.
    fn sums(&self, offsets_ns: &[f64]) -> Vec<Option<Vec<[f64; 3]>>> {
        if self.change.iter().any(|change| !change.is_finite()) {
            return vec![None; offsets_ns.len()];
        }
        let has_events = |events: &Vec<f32>| events.iter().any(|sum| *sum != 0.0);
        let events: Vec<Option<Vec<f32>>> = offsets_ns
            .iter()
            .map(|offset_ns| self.between(*offset_ns).filter(has_events).map(|events| centred(&events)))
            .collect();
        let mut sums: Vec<Option<Vec<[f64; 3]>>> = events
            .iter()
            .map(|events| events.as_ref().map(|_| Vec::with_capacity(SHIFTS * SHIFTS)))
            .collect();
        for down in 0..SHIFTS {
            for right in 0..SHIFTS {
                let rows = (0..SIDE).map(|y| &self.change[(y + down) * FRAME_SIDE + right..][..SIDE]);
                let frames = centred(&rows.flatten().copied().collect::<Vec<f32>>());
                for (sums, events) in sums.iter_mut().zip(&events) {
                    let (Some(sums), Some(events)) = (sums, events) else { continue };
                    sums.push(events.iter().zip(&frames).fold([0.0; 3], |sum: [f64; 3], (x, y)| {
                        let (x, y) = (f64::from(*x), f64::from(*y));
                        [sum[0] + x * y, sum[1] + x * x, sum[2] + y * y]
                    }));
                }
            }
        }
        sums
    }
}

/// Less the mean, with the largest values brought in.
fn centred(values: &[f32]) -> Vec<f32> {
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    let limit = CLIPPED
        * (values.iter().map(|value| (value - mean) * (value - mean)).sum::<f32>() / values.len() as f32)
            .sqrt();
    values.iter().map(|value| (value - mean).clamp(-limit, limit)).collect()
}

/// Where frames see what events see.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Displacement {
    /// Pixels by which the frames' picture lies right of the events'.
    pub right: Estimate,
    /// Pixels by which it lies below.
    pub down: Estimate,
    /// Correlation over the patches there.
    pub correlation: f64,
    /// Correlation without a shift, at the offset that suits that best.
    pub correlation_at_none: f64,
    /// Whole pixels right and down that agree best at that same offset: what is a shift for the one offset
    /// and none for the other is motion.
    pub shift_at_one_offset: (i32, i32),
    /// Correlation there.
    pub correlation_at_one_offset: f64,
    /// Patches with events.
    pub patches: usize,
}

/// The shift of the frames against the events, with events taken later than frames by the one of `offsets_ns`
/// at which a shift agrees best; none where patches are few, or agree at no shift, or at the end of what is
/// tried.
///
/// The correlation without a shift is that at the offset that suits it best: of a picture that moves one way,
/// a shift along the motion and an offset show the same, and the two correlations are then close.
pub fn displacement(patches: &[Patch], offsets_ns: &[f64]) -> Option<Displacement> {
    let none = SHIFTS * REACH + REACH;
    let mut found: Option<(f64, Vec<Vec<[f64; 3]>>)> = None;
    let mut at_none = f64::NEG_INFINITY;
    let (mut shift_at_one_offset, mut correlation_at_one_offset) = ((0, 0), 0.0);
    let mut by_patch: Vec<Vec<Option<Vec<[f64; 3]>>>> =
        patches.iter().map(|patch| patch.sums(offsets_ns)).collect();
    for offset in 0..offsets_ns.len() {
        let sums: Vec<Vec<[f64; 3]>> =
            by_patch.iter_mut().filter_map(|of_offset| of_offset[offset].take()).collect();
        if sums.len() < FEWEST {
            continue;
        }
        let all = correlations(&sums, &vec![1.0; sums.len()]);
        let at = (0..all.len()).max_by(|a, b| all[*a].total_cmp(&all[*b])).unwrap_or(none);
        let most = all[at];
        if all[none] > at_none {
            let pixels = |at: usize| at as i32 - REACH as i32;
            (at_none, correlation_at_one_offset) = (all[none], most);
            shift_at_one_offset = (pixels(at % SHIFTS), pixels(at / SHIFTS));
        }
        if found.as_ref().is_none_or(|(best, _)| most > *best) {
            found = Some((most, sums));
        }
    }
    let (_, sums) = found?;
    // The best whole shift, and between pixels by a parabola in each direction.
    let best = |weights: &[f64]| -> Option<(f64, f64, f64)> {
        let all = correlations(&sums, weights);
        let at = (0..all.len())
            .max_by(|a, b| all[*a].total_cmp(&all[*b]))
            .filter(|at| all[*at] >= LEAST_CORRELATION)?;
        let (down, right) = (at / SHIFTS, at % SHIFTS);
        let row = &all[down * SHIFTS..][..SHIFTS];
        let column: Vec<f64> = (0..SHIFTS).map(|down| all[down * SHIFTS + right]).collect();
        Some((peak(row, right)? - REACH as f64, peak(&column, down)? - REACH as f64, all[at]))
    };
    let (_, _, correlation) = best(&vec![1.0; sums.len()])?;
    Some(Displacement {
        right: by_draws(sums.len(), |weights| best(weights).map(|found| found.0))?,
        down: by_draws(sums.len(), |weights| best(weights).map(|found| found.1))?,
        correlation,
        correlation_at_none: at_none,
        shift_at_one_offset,
        correlation_at_one_offset,
        patches: sums.len(),
    })
}

/// Correlation over patches by weight, at each shift.
fn correlations(sums: &[Vec<[f64; 3]>], weights: &[f64]) -> Vec<f64> {
    let of = |shift: usize| {
        let total = sums.iter().zip(weights).fold([0.0; 3], |total: [f64; 3], (sums, weight)| {
            let sums = sums[shift];
            [total[0] + weight * sums[0], total[1] + weight * sums[1], total[2] + weight * sums[2]]
        });
        total[0] / (total[1] * total[2]).sqrt().max(1e-30)
    };
    (0..SHIFTS * SHIFTS).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::random::Random;

    /// Patches of a random texture whose brightness changes; frames lie `right`, `down` of events, and events
    /// count whole steps of 0.2 with noise.
    fn patches(right: i64, down: i64, noise: f64, late_ns: i64) -> Vec<Patch> {
        let mut random = Random::new(11, &[]);
        let made = |_| {
            let wide = FRAME_SIDE + 2 * REACH;
            let texture: Vec<f64> = (0..wide * wide).map(|_| 0.6 * random.normal()).collect();
            let at = |x: i64, y: i64| {
                texture[((y + 2 * REACH as i64) as usize) * wide + (x + 2 * REACH as i64) as usize]
            };
            let change = (0..FRAME_SIDE * FRAME_SIDE).map(|n| {
                let (x, y) = ((n % FRAME_SIDE) as i64 - REACH as i64, (n / FRAME_SIDE) as i64 - REACH as i64);
                at(x - right, y - down) as f32
            });
            let mut patch = Patch::new((0, 10_000_000), 10_000_000, 500_000, change.collect()).unwrap();
            for n in 0..SIDE * SIDE {
                let (x, y) = (n % SIDE, n / SIDE);
                let change = at(x as i64, y as i64);
                for k in 0..(change.abs() / 0.2) as i64 {
                    patch.event(late_ns + 1_000_000 + 600_000 * k, x, y, change > 0.0);
                }
                if random.uniform() < noise {
                    patch.event((10e6 * random.uniform()) as i64, x, y, random.uniform() < 0.5);
                }
            }
            patch
        };
        (0..24).map(made).collect()
    }

    #[test]
    fn a_picture_that_was_shifted_is_shifted_so_much() {
        for (right, down) in [(0, 0), (2, -1), (-3, 3)] {
            let found = displacement(&patches(right, down, 0.3, 0), &[0.0]).unwrap();
            assert!(
                (found.right.value - right as f64).abs() < 0.3
                    && (found.down.value - down as f64).abs() < 0.3,
                "{found:?}"
            );
            assert!(found.right.ci95.1 - found.right.ci95.0 < 0.5 && found.correlation > 0.6, "{found:?}");
            assert_eq!(found.correlation_at_none > 0.5, right == 0 && down == 0, "{found:?}");
        }
    }

    #[test]
    fn late_events_are_summed_where_they_are() {
        let late = patches(1, 0, 0.0, 9_000_000);
        assert!(
            displacement(&late, &[9e6]).unwrap().correlation
                > displacement(&late, &[0.0]).map_or(0.0, |found| found.correlation) + 0.2
        );
    }

    #[test]
    fn what_does_not_agree_gives_no_shift() {
        assert_eq!(displacement(&[], &[0.0]), None);
        // Beyond what is tried, and events that have nothing to do with the frames.
        assert!(displacement(&patches(0, 0, 0.0, 30_000_000), &[0.0]).is_none());
        assert_eq!(Patch::new((0, 1), 1, 1, vec![0.0; 3]), None);
    }
}
