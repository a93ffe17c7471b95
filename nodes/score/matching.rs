//! Which frame is compared with which: by the middle of their exposures, and only when those agree.

use photocurrent_core::quantity::Duration;
use photocurrent_core::{FrameScale, FrameTimes, FramesMeta, NodeError};

/// Pairs (frame, reference) whose exposure middles lie within `tolerance_ns`; each frame takes the nearest
/// reference. A reference beyond the tolerance is no partner: that frame is left out.
///
/// # Errors
/// When sizes differ, no frame has a partner, or the DN of partners are of different exposures.
pub fn match_frames(
    frames: &FramesMeta,
    reference: &FramesMeta,
    tolerance_ns: i64,
) -> Result<Vec<(usize, usize)>, NodeError> {
    if (frames.extent, frames.colour) != (reference.extent, reference.colour) {
        let size = |meta: &FramesMeta| format!("{} {}", meta.extent, meta.colour);
        return Err(NodeError::usage(format!(
            "frames are {}, the reference is {}",
            size(frames),
            size(reference)
        ))
        .hint("compare pictures of one size and the same colours"));
    }
    let pairs = partners(frames, reference, tolerance_ns)?;
    check_scale(frames, reference, &pairs)?;
    check_rows(frames, reference, tolerance_ns)?;
    Ok(pairs)
}

/// Refuses a mosaic, for who looks at neighbours as if they were of one colour; `who` says who does.
///
/// # Errors
/// When the frames are one.
pub fn no_mosaic(frames: &FramesMeta, who: &str) -> Result<(), NodeError> {
    if !frames.colour.is_mosaic() {
        return Ok(());
    }
    Err(NodeError::usage(format!(
        "the frames are a {} mosaic, and {who} takes neighbours for the same colour",
        frames.colour
    ))
    .hint("put render/demosaic before it, and compare with an RGB truth"))
}

/// Refuses pictures whose rows are exposed at other times: row 0 agrees, and the last row may be a frame
/// period off.
fn check_rows(frames: &FramesMeta, reference: &FramesMeta, tolerance_ns: i64) -> Result<(), NodeError> {
    let (here, there) = (frames.times.row_time_ns, reference.times.row_time_ns);
    let apart = (here - there).abs() * i64::from(frames.extent.height.saturating_sub(1));
    if apart <= tolerance_ns.max(1000) {
        return Ok(());
    }
    Err(NodeError::usage(format!(
        "the frames' rows follow each other after {}, the reference's after {}",
        Duration::new(here),
        Duration::new(there)
    ))
    .note(format!("their last rows are {} apart", Duration::new(apart)))
    .hint("render with a global shutter, as true frames have one, or `at` the reference"))
}

/// How far the exposures may differ that DN of a pair stand for, as a share: stamps are whole microseconds in
/// many recordings.
const SAME_SCALE: f64 = 1e-3;

/// Refuses pairs whose DN are of frames of different exposure: the same light would read differently.
fn check_scale(
    frames: &FramesMeta,
    reference: &FramesMeta,
    pairs: &[(usize, usize)],
) -> Result<(), NodeError> {
    let exposure_of_dn = |meta: &FramesMeta, l: usize| match meta.scale {
        FrameScale::Captured => meta.times.exposures[l].length_ns(),
        FrameScale::Nominal { exposure_ns } => exposure_ns,
    };
    for &(l, j) in pairs {
        let (here, there) = (exposure_of_dn(frames, l), exposure_of_dn(reference, j));
        if (here - there).abs() as f64 > SAME_SCALE * there as f64 {
            return Err(NodeError::usage(format!(
                "the frames' DN are those of an exposure of {}, the reference's of one of {}: the same \
                 light reads differently",
                Duration::new(here),
                Duration::new(there)
            ))
            .note(format!("frame {l} is compared with frame {j} of the reference"))
            .hint(
                "simulate the truth with the exposure of the camera's frames (`exposure`), or render `at` \
                   the reference",
            ));
        }
    }
    Ok(())
}

fn partners(
    frames: &FramesMeta,
    reference: &FramesMeta,
    tolerance_ns: i64,
) -> Result<Vec<(usize, usize)>, NodeError> {
    let mid = |times: &FrameTimes, l: usize| times.exposures[l].mid().0;
    let mids: Vec<i64> = (0..reference.times.len()).map(|l| mid(&reference.times, l)).collect();
    let pairs: Vec<(usize, usize)> = (0..frames.times.len())
        .filter_map(|l| {
            let t = mid(&frames.times, l);
            let after = mids.partition_point(|&m| m < t);
            let nearest = [after.checked_sub(1), Some(after)]
                .into_iter()
                .flatten()
                .filter(|&j| j < mids.len())
                .min_by_key(|&j| ((mids[j] - t).abs(), j))?;
            ((mids[nearest] - t).abs() <= tolerance_ns).then_some((l, nearest))
        })
        .collect();
    if pairs.is_empty() {
        let span = |times: &FrameTimes| match (times.exposures.first(), times.exposures.last()) {
            (Some(first), Some(last)) => {
                format!("{} frames from {} to {}", times.len(), first.mid(), last.mid())
            }
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
    use photocurrent_core::Colour;
    use photocurrent_core::{Exposure, Extent};

    fn at(mids: &[i64]) -> FramesMeta {
        let times = FrameTimes::new(mids.iter().map(|t| Exposure::new(t - 5, t + 5)).collect(), 0).unwrap();
        FramesMeta {
            extent: Extent { width: 2, height: 2 },
            colour: Colour::Mono,
            times,
            scale: FrameScale::Captured,
        }
    }

    #[test]
    fn only_partners_within_the_tolerance_are_paired() {
        assert_eq!(match_frames(&at(&[0, 104, 250]), &at(&[100, 200, 254]), 5).unwrap(), [(1, 0), (2, 2)]);
    }

    #[test]
    fn a_rolling_shutter_is_not_compared_with_a_global_one() {
        let rolling = |row_time_ns| {
            let meta = at(&[0, 100]);
            FramesMeta { times: FrameTimes::new(meta.times.exposures.to_vec(), row_time_ns).unwrap(), ..meta }
        };
        let error = match_frames(&rolling(10_000), &rolling(0), 5).unwrap_err();
        assert!(
            error
                .message
                .starts_with("the frames' rows follow each other after 10 us, the reference's after 0 ns"),
            "{}",
            error.message
        );
        assert!(match_frames(&rolling(10_000), &rolling(10_000), 5).is_ok());
    }

    #[test]
    fn values_of_another_exposure_are_refused() {
        let nominal =
            |exposure_ns| FramesMeta { scale: FrameScale::Nominal { exposure_ns }, ..at(&[0, 100]) };
        let error = match_frames(&nominal(8_000_000), &nominal(4_000_000), 5).unwrap_err();
        assert!(
            error.message.contains("exposure of 8 ms, the reference's of one of 4 ms"),
            "{}",
            error.message
        );
        // `at` makes exposures of 10 ns: rendered frames of that scale compare with captured ones.
        assert!(match_frames(&nominal(10), &at(&[0, 100]), 5).is_ok());
        assert!(match_frames(&nominal(11), &at(&[0, 100]), 5).is_err());
    }

    #[test]
    fn no_partner_at_all_shows_both_times() {
        let error = match_frames(&at(&[0]), &at(&[1_000_000]), 5).unwrap_err();
        assert_eq!(
            error.notes,
            [
                "frames: 1 frames from 0.000000 ms to 0.000000 ms",
                "reference: 1 frames from 1.000000 ms to 1.000000 ms"
            ]
        );
    }
}
