//! How frames and events lie on each other, as values that a reader takes: for whoever writes a manifest.

use super::limits::Limits;
use crate::declared::{Mirror, Shift};
use crate::survey::grid::GridSurvey;
use crate::survey::interval::Interval;
use crate::survey::lag::LagSurvey;

/// The way in which frames are mirrored against events, where that is clear, with the correlation there.
pub fn mirror_of(lag: &LagSurvey, limits: &Limits) -> Option<(Mirror, f64)> {
    let [as_is, left_right, top_bottom, both] = lag.mirrored;
    let ways = [(Mirror::LeftRight, left_right), (Mirror::TopBottom, top_bottom), (Mirror::Both, both)];
    ways.into_iter()
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .filter(|(_, r)| *r > as_is + limits.mirrored && *r > limits.correlation)
}

/// Whole pixels by which events lie right of and below the frames' picture, where they clearly do.
pub fn shift_of(grid: &GridSurvey, limits: &Limits) -> Option<Shift> {
    let (best, none) = grid.correlation;
    let is_away = |of: Interval| {
        of.value.abs() >= limits.displaced_px
            && (of.ci95.0 > 0.5 * limits.displaced_px || of.ci95.1 < -0.5 * limits.displaced_px)
    };
    // Of a picture that moves one way a shift along the motion is an offset: at the offset of no shift there
    // is little to gain.
    let (shift_alone, alone) = grid.at_one_offset;
    let is_no_motion = alone > none + limits.displaced_gain && shift_alone != (0, 0);
    let is_clear = best >= limits.correlation
        && best > none + limits.displaced_gain
        && is_no_motion
        && (is_away(grid.right_px) || is_away(grid.down_px));
    // The survey states where frames lie; the parameter, where events do.
    let whole = |of: Interval| -of.value.round() as i32;
    is_clear.then(|| Shift { right: whole(grid.right_px), down: whole(grid.down_px) })
}
