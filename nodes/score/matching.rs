//! Which frame is compared with which: by the middle of their exposures, and only when those agree.

use photocurrent_core::{FrameTimes, FramesMeta, NodeError};

/// Pairs (frame, reference) whose exposure middles lie within `tolerance_ns`; each frame takes the nearest reference.
/// A reference beyond the tolerance is no partner: that frame is left out.
///
/// # Errors
/// When sizes differ, or no frame has a partner.
pub fn match_frames(frames: &FramesMeta, reference: &FramesMeta, tolerance_ns: i64) -> Result<Vec<(usize, usize)>, NodeError> {
    if (frames.extent, frames.channels) != (reference.extent, reference.channels) {
        let size = |meta: &FramesMeta| format!("{} with {} channel(s)", meta.extent, meta.channels);
        return Err(NodeError::usage(format!("frames are {}, the reference is {}", size(frames), size(reference))).hint("compare pictures of one size"));
    }
    let mid = |times: &FrameTimes, l: usize| times.exposures[l].mid().0;
    let mids: Vec<i64> = (0..reference.times.len()).map(|l| mid(&reference.times, l)).collect();
    let pairs: Vec<(usize, usize)> = (0..frames.times.len())
        .filter_map(|l| {
            let t = mid(&frames.times, l);
            let after = mids.partition_point(|&m| m < t);
            let nearest = [after.checked_sub(1), Some(after)].into_iter().flatten().filter(|&j| j < mids.len()).min_by_key(|&j| ((mids[j] - t).abs(), j))?;
            ((mids[nearest] - t).abs() <= tolerance_ns).then_some((l, nearest))
        })
        .collect();
    if pairs.is_empty() {
        let span = |times: &FrameTimes| match (times.exposures.first(), times.exposures.last()) {
            (Some(first), Some(last)) => format!("{} frames from {} to {}", times.len(), first.mid(), last.mid()),
            _ => "no frame".into(),
        };
        return Err(NodeError::usage(format!("no frame has a reference within {tolerance_ns} ns"))
            .note(format!("frames: {}", span(&frames.times)))
            .note(format!("reference: {}", span(&reference.times)))
            .hint("render at the reference's instants, or raise `tolerance`"));
    }
    Ok(pairs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Exposure, Extent, FrameScale};

    fn at(mids: &[i64]) -> FramesMeta {
        let times = FrameTimes::new(mids.iter().map(|t| Exposure::new(t - 5, t + 5)).collect(), 0).unwrap();
        FramesMeta { extent: Extent { width: 2, height: 2 }, channels: 1, times, scale: FrameScale::Captured }
    }

    #[test]
    fn only_partners_within_the_tolerance_are_paired() {
        assert_eq!(match_frames(&at(&[0, 104, 250]), &at(&[100, 200, 254]), 5).unwrap(), [(1, 0), (2, 2)]);
    }

    #[test]
    fn no_partner_at_all_shows_both_times() {
        let error = match_frames(&at(&[0]), &at(&[1_000_000]), 5).unwrap_err();
        assert_eq!(error.notes, ["frames: 1 frames from 0.000000 ms to 0.000000 ms", "reference: 1 frames from 1.000000 ms to 1.000000 ms"]);
    }
}
