//! Parts of the array for a few frames each, every one with a picture and a motion of its own: for scenes
//! that do not move as one.
//!
//! The array is cut into tiles and the recording into windows of frames that overlap. Around a tile a picture
//! is fitted to the values that change from frame to frame, as what stands still belongs to something else;
//! where it begins to move is a search for the one shift a frame that predicts the window best.
//!
//! Source: the piecewise view of optical flow (Black and Anandan, The Robust Estimation of Multiple Motions,
//! CVIU 1996). Limits: what comes out from behind something else is seen by too few frames, and one patch has
//! one motion.

use super::begin::{images, moving};
use super::estimate::{FitStart, ScenePicture};
use super::motion::{AffineMap, apply, compose};
use super::setting::PictureSetting;
use crate::case::{Case, CaseFrames, PixelEvents};
use crate::nominal::Nominal;
use photocurrent_core::{Exposure, Extent, FrameTimes};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// How the array and the recording are cut.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct PatchSetting {
    /// Side of the tiles that may have a picture of their own, pixels.
    #[schemars(range(min = 4, max = 256))]
    pub tile: u32,
    /// Which is fitted to so many pixels around the tile as well.
    #[schemars(range(min = 2, max = 64))]
    pub margin: u32,
    /// And to so many frames.
    #[schemars(range(min = 3, max = 64))]
    pub window: usize,
    /// At most so many such pictures are fitted, those of tiles with the most events.
    #[schemars(range(max = 100_000))]
    pub most_parts: usize,
}

impl Default for PatchSetting {
    fn default() -> PatchSetting {
        PatchSetting { tile: 12, margin: 6, window: 5, most_parts: 96 }
    }
}

/// Frame intervals that neighbouring windows share.
const SHARED: usize = 1;
/// Largest shift from frame to frame, pixels.
const REACH: i32 = 12;
/// Largest turn from frame to frame of the whole array, radians.
pub const TURN: f64 = 0.8;
/// Least gain of a shift by one pixel, as a share of the mean difference of frames.
const SHIFT_COST: f64 = 0.01;
/// Standard deviations from which on a value changes.
pub(crate) const MOVES: f64 = 4.0;
/// Fewer moving values than this are not fitted.
const LEAST_VALUES: usize = 200;
/// Least number of events in a tile and window for a picture.
pub(crate) const LEAST_EVENTS: usize = 12;

impl PatchSetting {
    /// The tiles of an array: columns and rows.
    pub fn tiles(&self, extent: Extent) -> Vec<(Range<u32>, Range<u32>)> {
        let cut = |length: u32| -> Vec<Range<u32>> {
            let count = u32::max(length / self.tile.max(1), 1);
            (0..count).map(|n| n * length / count..(n + 1) * length / count).collect()
        };
        cut(extent.height)
            .into_iter()
            .flat_map(|rows| cut(extent.width).into_iter().map(move |columns| (columns, rows.clone())))
            .collect()
    }

    /// The windows of so many frames.
    pub fn windows(&self, count: usize) -> Vec<Range<usize>> {
        let length = self.window.clamp(3, count.max(3));
        let step = (length - 1).saturating_sub(SHARED).max(1);
        let last = count.saturating_sub(length);
        let mut all: Vec<Range<usize>> = (0..last).step_by(step).map(|first| first..first + length).collect();
        if count >= length {
            all.push(last..last + length);
        }
        all
    }
}

/// A part of the array, for some frames.
#[derive(Clone, Debug)]
pub struct PatchPart {
    /// Columns of the array that are fitted.
    pub columns: Range<u32>,
    /// Rows.
    pub rows: Range<u32>,
    /// Frames.
    pub frames: Range<usize>,
}

impl PatchPart {
    /// Around a tile.
    pub fn around_tile(
        tile: &(Range<u32>, Range<u32>),
        frames: Range<usize>,
        extent: Extent,
        setting: &PatchSetting,
    ) -> PatchPart {
        let wider = |range: &Range<u32>, end: u32| {
            range.start.saturating_sub(setting.margin)..(range.end + setting.margin).min(end)
        };
        PatchPart { columns: wider(&tile.0, extent.width), rows: wider(&tile.1, extent.height), frames }
    }

    /// Size of the part.
    pub fn extent(&self) -> Extent {
        Extent { width: self.columns.end - self.columns.start, height: self.rows.end - self.rows.start }
    }

    /// The array's pixels of the part, row by row.
    pub fn pixels(&self, width: u32) -> impl Iterator<Item = usize> + '_ {
        self.rows.clone().flat_map(move |y| self.columns.clone().map(move |x| (y * width + x) as usize))
    }

    /// Its frames as a recording without events, with the times of the whole recording.
    ///
    /// # Panics
    /// When the recording has no frames.
    pub fn cut_from(&self, case: &Case) -> Case {
        let frames = case.frames.as_ref().expect("frames are there");
        let times = &frames.times;
        let exposures: Vec<Exposure> =
            self.frames.clone().map(|l| times.exposure(l, self.rows.start)).collect();
        let dn = self
            .frames
            .clone()
            .flat_map(|l| self.pixels(case.extent.width).map(move |pixel| frames.dn(l, pixel)))
            .collect();
        let extent = self.extent();
        let last = times.exposure(self.frames.end - 1, self.rows.end - 1).end.0;
        let span =
            (exposures[0].start.0.min(times.exposure(self.frames.start, self.rows.end - 1).start.0), last);
        let times = FrameTimes::new(exposures, times.row_time_ns)
            .unwrap_or_else(|_| unreachable!("exposures of a recording are in order"));
        Case {
            extent,
            span,
            events: PixelEvents::new(vec![Vec::new(); extent.pixels()]),
            has_t_in: case.has_t_in,
            t_resolution_ns: case.t_resolution_ns,
            frames: Some(CaseFrames::new(times, dn)),
            sensor: case.sensor.clone(),
        }
    }
}

/// The still ground: the value that most frames have of a pixel, DN; NaN where fewer than the share `least`
/// of them agree.
pub fn ground(case: &Case, nominal: &Nominal, noise: (f64, f64), moves: f64, least: f64) -> Vec<f64> {
    let count = case.frame_count();
    let of = |pixel: usize| {
        let mut values: Vec<f64> =
            (0..count).map(|l| case.dn(l, pixel)).filter(|dn| dn.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        // The largest group of values that noise explains.
        let group = |first: usize| {
            let sigma =
                nominal.frame_sigma_dn(f64::max(values[first] - nominal.number.black_level, 0.0), noise);
            values[first..].partition_point(|dn| *dn <= values[first] + moves * sigma)
        };
        let Some((held, first)) = (0..values.len())
            .map(|first| (group(first), first))
            .max_by(|a, b| a.0.cmp(&b.0).then(b.1.cmp(&a.1)))
        else {
            return f64::NAN;
        };
        if (held as f64) < least * values.len() as f64 { f64::NAN } else { values[first + held / 2] }
    };
    (0..case.extent.pixels()).map(of).collect()
}

/// Which frame values belong to something that moves: those that are not the ground's, and where there is
/// none those that change.
pub fn foreground(
    case: &Case,
    nominal: &Nominal,
    ground: &[f64],
    noise: (f64, f64),
    moves: f64,
) -> Vec<bool> {
    let pixels = case.extent.pixels();
    let changes = moving(case, nominal, noise, moves);
    let of = |(n, changes): (usize, bool)| {
        let (dn, still) = (case.dn(n / pixels, n % pixels), ground[n % pixels]);
        if still.is_finite() {
            let sigma = nominal.frame_sigma_dn(f64::max(still - nominal.number.black_level, 0.0), noise);
            (dn - still).abs() > moves * sigma
        } else {
            changes
        }
    };
    changes.into_iter().enumerate().map(of).collect()
}

/// A part with its picture.
#[derive(Clone, Debug)]
pub struct PicturePatch {
    /// Where and when.
    pub part: PatchPart,
    /// Which of its frame values were fitted.
    counts: Vec<bool>,
    /// Its picture, in pixels from the part's centre.
    pub picture: ScenePicture,
}

impl PicturePatch {
    /// Fits a picture to a part of a recording; none where too little moves.
    ///
    /// `moves`: which frame values of the whole recording belong to something that moves ([`foreground`]);
    /// `ground`: the still ground of its pixels, photocurrent, where there is one.
    pub fn fit(
        case: &Case,
        nominal: &Nominal,
        moves: &[bool],
        ground: Option<&[f32]>,
        part: PatchPart,
        of_picture: &PictureSetting,
    ) -> Option<PicturePatch> {
        let own = part.cut_from(case);
        if own.extent.width.min(own.extent.height) < 8 || own.frame_count() < 3 {
            return None;
        }
        let pixels = case.extent.pixels();
        let mut counts: Vec<bool> = part
            .frames
            .clone()
            .flat_map(|l| part.pixels(case.extent.width).map(move |pixel| moves[l * pixels + pixel]))
            .collect();
        counts.iter_mut().enumerate().for_each(|(n, counts)| {
            *counts &= own.dn(n / own.extent.pixels(), n % own.extent.pixels()).is_finite()
        });
        if counts.iter().filter(|counts| **counts).count() < LEAST_VALUES {
            return None;
        }
        // A part is too small to turn much.
        let poses = follow_motion(&own, nominal, &counts, 0.0);
        let ground: Option<Vec<f32>> =
            ground.map(|ground| part.pixels(case.extent.width).map(|pixel| ground[pixel]).collect());
        if ground.is_some() {
            // What stands still is explained as well.
            counts.fill(true);
        }
        let picture = ScenePicture::fit_from(
            &own,
            nominal,
            of_picture,
            &[&poses],
            FitStart { counts: Some(&counts), ground: ground.as_deref(), selected: None },
        );
        Some(PicturePatch { part, counts, picture })
    }

    /// Fits the frames of another recording of the same scene, from here on.
    #[must_use]
    pub fn refit(&self, case: &Case, nominal: &Nominal, of_picture: &PictureSetting) -> PicturePatch {
        PicturePatch {
            picture: self.picture.refit(&self.part.cut_from(case), nominal, of_picture, Some(&self.counts)),
            ..self.clone()
        }
    }

    /// A posterior sample of it, as sharp as it may be.
    #[must_use]
    pub fn posterior_sample(
        &self,
        case: &Case,
        nominal: &Nominal,
        of_picture: &PictureSetting,
        seed: u64,
    ) -> PicturePatch {
        let drawn = self.picture.posterior_sample(
            &self.part.cut_from(case),
            nominal,
            of_picture,
            Some(&self.counts),
            seed,
        );
        PicturePatch { picture: drawn.sharpened(of_picture.sharpest), ..self.clone() }
    }

    /// Residual of a frame value of the array, DN; NaN where it took no part.
    pub fn residual(&self, frame: usize, x: u32, y: u32) -> f32 {
        let PatchPart { columns, rows, frames } = &self.part;
        if !(frames.contains(&frame) && columns.contains(&x) && rows.contains(&y)) {
            return f32::NAN;
        }
        let extent = self.part.extent();
        let pixel = ((y - rows.start) * extent.width + (x - columns.start)) as usize;
        self.picture.residual[(frame - frames.start) * extent.pixels() + pixel]
    }
}

/// The one motion from frame to frame that predicts moving values best, a shift or a turn around their
/// middle by at most `most_turn` radians: poses of all frames.
pub fn follow_motion(case: &Case, nominal: &Nominal, counts: &[bool], most_turn: f64) -> Vec<AffineMap> {
    let smooth: Vec<_> = images(case, nominal).iter().map(|image| image.smoothed(1)).collect();
    let width = case.extent.width as usize;
    let pixels = case.extent.pixels();
    let centre = (0.5 * (f64::from(case.extent.width) - 1.0), 0.5 * (f64::from(case.extent.height) - 1.0));
    let moving: Vec<(usize, f64, f64)> = (pixels..counts.len())
        .filter(|n| counts[*n])
        .map(|n| (n, (n % pixels % width) as f64 - centre.0, (n % pixels / width) as f64 - centre.1))
        .collect();
    let all = f64::max(moving.len() as f64, 1.0);
    let (mx, my) = moving.iter().fold((0.0, 0.0), |sum, at| (sum.0 + at.1 / all, sum.1 + at.2 / all));
    let radius = moving.iter().map(|at| libm::hypot(at.1 - mx, at.2 - my)).sum::<f64>() / all;
    let map = |dx: f64, dy: f64, turn: f64| -> AffineMap {
        let (c, s) = (libm::cos(turn), libm::sin(turn));
        [mx - c * mx + s * my + dx, c, -s, my - s * mx - c * my + dy, s, c]
    };
    let cost = |dx: f64, dy: f64, turn: f64| -> f64 {
        let map = map(dx, dy, turn);
        let (mut sum, mut n) = (0.0, 0.0);
        for (at, x, y) in &moving {
            let (l, pixel) = (at / pixels, at % pixels);
            let (px, py) = apply(&map, *x, *y);
            let (i, j) = ((px + centre.0).round(), (py + centre.1).round());
            if i >= 0.0 && j >= 0.0 && i < f64::from(case.extent.width) && j < f64::from(case.extent.height) {
                sum += f64::from(
                    (smooth[l].values[pixel] - smooth[l - 1].values[j as usize * width + i as usize]).abs(),
                );
                n += 1.0;
            }
        }
        if 2.0 * n < all {
            f64::INFINITY
        } else {
            sum / n * (1.0 + SHIFT_COST * (libm::hypot(dx, dy) + turn.abs() * radius))
        }
    };
    let reach = REACH;
    let shifts =
        (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (f64::from(dx), f64::from(dy), 0.0)));
    let steps = (most_turn / TURN_STEP).floor() as i32;
    let turns = (-steps..=steps).flat_map(|n| {
        (-1..=1).flat_map(move |j| {
            (-1..=1).map(move |i| (2.0 * f64::from(i), 2.0 * f64::from(j), f64::from(n) * TURN_STEP))
        })
    });
    let tried = shifts.chain(turns).map(|(dx, dy, turn)| (cost(dx, dy, turn), (dx, dy, turn)));
    let (mut least, mut best) =
        tried.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::INFINITY, (0.0, 0.0, 0.0)));
    // And finer from there on.
    for by in [0.5, 0.25] {
        for (dx, dy, turn) in [
            (by, 0.0, 0.0),
            (-by, 0.0, 0.0),
            (0.0, by, 0.0),
            (0.0, -by, 0.0),
            (0.0, 0.0, by * TURN_STEP),
            (0.0, 0.0, -by * TURN_STEP),
        ] {
            let other = (best.0 + dx, best.1 + dy, best.2 + turn);
            let cost = cost(other.0, other.1, other.2);
            if cost < least {
                (least, best) = (cost, other);
            }
        }
    }
    let step = map(best.0, best.1, best.2);
    let mut poses: Vec<AffineMap> = vec![[0.0, 1.0, 0.0, 0.0, 0.0, 1.0]];
    while poses.len() < case.frame_count() {
        poses.push(compose(poses.last().expect("one is there"), &step));
    }
    poses
}

/// Step of the search over turns, radians.
const TURN_STEP: f64 = 0.04;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_and_tiles_cover_everything() {
        let setting = PatchSetting::default();
        for count in 3..40 {
            let windows = setting.windows(count);
            // Every interval between two frames is within a window, and none is longer than the recording.
            assert!(
                (0..count - 1)
                    .all(|l| windows.iter().any(|window| window.contains(&l) && window.contains(&(l + 1)))),
                "{count}: {windows:?}"
            );
            assert!(
                windows.iter().all(|window| window.end <= count && window.len() >= 3),
                "{count}: {windows:?}"
            );
        }
        for (width, height) in [(9, 8), (72, 54), (97, 71)] {
            let extent = Extent { width, height };
            let tiles = setting.tiles(extent);
            let inside: u32 =
                tiles.iter().map(|(columns, rows)| columns.len() as u32 * rows.len() as u32).sum();
            assert_eq!(inside, width * height);
        }
    }
}
