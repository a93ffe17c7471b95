//! Hazards of frames by themselves: values that no light has, times that no camera has, what is not recorded.

use super::{Findings, count, percent, time};
use crate::survey::pictures::{FramesSurvey, ValuesSurvey};

/// Adds what there is to say.
pub(super) fn judge(frames: &FramesSurvey, found: &mut Findings) {
    if frames.count == 0 {
        found.hazard(
            "no_frames",
            "there is a place for frames and no frame in it",
            "0 frames",
            "check the recording: methods that join frames and events need some",
        );
        return;
    }
    values(frames, found);
    times(frames, found);
    questions(frames, found);
}

fn values(frames: &FramesSurvey, found: &mut Findings) {
    let values = &frames.values;
    unreadable(values, found);
    if values.values > 0 {
        unlikely(values, found);
        even(values, found);
        saturated(values, found);
        repeated(frames, found);
    }
}

/// Frames that could not be read.
fn unreadable(values: &ValuesSurvey, found: &mut Findings) {
    if let Some(first) = values.unreadable.first() {
        found.hazard(
            "unreadable_frames",
            "frames could not be read",
            format!(
                "{} of {} that were tried; first: {first}",
                values.unreadable.len(),
                values.unreadable.len() + values.read.len()
            ),
            "copy the file again from where it came, or leave those frames out",
        );
    }
}

/// Values that no light has: infinite ones, NaN, negative ones.
fn unlikely(values: &ValuesSurvey, found: &mut Findings) {
    let all = values.values as f64;
    let of = |n: u64| {
        format!("{n} of {} values of {}", values.values, count(values.read.len() as u64, "frame", "frames"))
    };
    if values.infinite > 0 {
        found.error(
            "infinite_frames",
            "frames hold infinite values",
            of(values.infinite),
            "look for a division by zero where the frames were made",
        );
    }
    if values.nan as f64 > found.limits.nan_share * all {
        found.error(
            "nan_frames",
            "most values of the frames are not numbers",
            of(values.nan),
            "look where the frames were made; NaN marks single values that are not known",
        );
    } else if values.nan > 0 {
        found.fact(
            "some_nan",
            "some values of the frames are not known (NaN)",
            of(values.nan),
            "nothing, if they are meant: they are left out",
        );
    }
    if values.negative as f64 > found.limits.negative_share * all {
        found.error(
            "negative_frames",
            "most values of the frames are negative, and no light is",
            format!("{}; from {} to {}", of(values.negative), values.min, values.max),
            "look for a sign, or a black level that was subtracted twice",
        );
    } else if values.negative as f64 > found.limits.some_negative * all {
        found.hazard(
            "some_negative",
            "some values of the frames are negative",
            format!("{}; the least is {}", of(values.negative), values.min),
            "noise about a black level of zero does this; state `frames.black_level_dn` if one was \
             subtracted",
        );
    }
}

/// Frames that hold one and the same value everywhere.
fn even(values: &ValuesSurvey, found: &mut Findings) {
    let (constant, read) = (values.constant.len(), values.read.len());
    if constant == read && values.nan + values.infinite < values.values {
        let what = if values.max == 0.0 { "every frame is black" } else { "every frame is one even grey" };
        found.error(
            "no_picture",
            what,
            format!(
                "all values of {} are the same; from {} to {}",
                count(read as u64, "frame", "frames"),
                values.min,
                values.max
            ),
            "check lens, exposure and which stream holds the frames",
        );
    } else if constant > 0 {
        found.hazard(
            "empty_frames",
            "some frames hold one and the same value everywhere",
            format!("{} of {read}; first frame {}", constant, values.constant[0]),
            "leave them out; a camera that starts gives such",
        );
    }
}

/// Values at the largest that there is.
fn saturated(values: &ValuesSurvey, found: &mut Findings) {
    // Black that is clipped at zero counts from the other side; the largest value is the full well.
    if values.clipped_share > found.limits.clipped_most {
        found.error(
            "all_saturated",
            "nearly all of the frames is saturated",
            format!("{} of the values are {}", percent(values.clipped_share), values.max),
            "shorten the exposure and record again",
        );
    } else if values.clipped_share > found.limits.clipped_share {
        found.fact(
            "saturated",
            "parts of the frames are saturated",
            format!("{} of the values are {}, and none is above", percent(values.clipped_share), values.max),
            "state `frames.saturation_dn`, so that these values are not taken for light",
        );
    }
}

/// Frames that are the one before.
fn repeated(frames: &FramesSurvey, found: &mut Findings) {
    let values = &frames.values;
    let pairs = values.read.windows(2).filter(|pair| pair[1] == pair[0] + 1).count();
    let repeated = values.repeated.iter().filter(|frame| !values.constant.contains(frame)).count();
    if repeated > 0 {
        let is_film = repeated as f64 > found.limits.repeated_share * pairs as f64;
        found.hazard(
            "repeated_frames",
            if is_film && frames.is_constant_rate {
                "frames are repeated in a constant rate: the film was of variable rate once"
            } else {
                "frames are, value for value, the one before"
            },
            format!("{repeated} of {pairs} pairs of neighbours; first frame {}", values.repeated[0]),
            "leave the repeated ones out: their stamps are not when they were taken",
        );
    }
}

fn times(frames: &FramesSurvey, found: &mut Findings) {
    let usual = frames.period.map_or(0, |period| period.median_ns);
    let every = time(usual as f64);
    if frames.backward > 0 {
        found.error(
            "frames_go_back",
            "frames are not in order of time",
            format!("{} of {} begin before the one before", frames.backward, frames.count),
            "check the stamps, and that they belong to these frames",
        );
    }
    if frames.equal_stamps > 0 {
        found.hazard(
            "equal_frame_stamps",
            "frames have the stamp of the one before",
            format!("{} of {}", frames.equal_stamps, frames.count),
            "leave the repeated ones out, or put the stamps right",
        );
    }
    if frames.gap_count > 0 {
        let gap = &frames.gaps[0];
        let missing: i64 = frames.gaps.iter().map(|gap| gap.missing).sum();
        found.hazard(
            "missing_frames",
            "frames are missing",
            format!(
                "{}, about {missing} missing; frame {} is {} after the one before, usual are {every}",
                count(frames.gap_count, "gap", "gaps"),
                gap.frame,
                time(gap.length_ns as f64)
            ),
            "nothing, if stamps are right: pictures between are made of events alone. If files were \
             numbered, look for lost ones",
        );
    }
    if frames.empty_exposures > 0 {
        found.error(
            "empty_exposures",
            "exposures end before they begin, or at once",
            format!("{} of {}", frames.empty_exposures, frames.count),
            "check which stamp is the start and which the end",
        );
    }
    if frames.overlapping > 0 {
        let longest = frames.exposure.map_or_else(String::new, |exposure| {
            format!("exposures of up to {}, ", time(exposure.max_ns as f64))
        });
        found.hazard(
            "exposure_over_period",
            "frames are exposed until after the next one begins",
            format!("{} of {}; {longest}frames every {every}", frames.overlapping, frames.count),
            "check the unit of the exposures and what the stamps mean",
        );
    }
    if usual > 0 && 1e9 / usual as f64 > found.limits.fastest_frames_hz {
        let exposures = frames.exposure.map_or_else(String::new, |exposure| {
            format!(", exposures of {}", time(exposure.median_ns as f64))
        });
        found.hazard(
            "frames_too_fast",
            "frames come faster than a camera takes them: stamps may be of a larger unit than they are read \
             in",
            format!("one every {every}{exposures}"),
            "state the unit of the frames' stamps",
        );
    }
    even_periods(frames, &every, found);
}

/// Frames of one and the same distance.
fn even_periods(frames: &FramesSurvey, every: &str, found: &mut Findings) {
    // A camera that stamps exposures has its own clock, and its periods are even.
    if frames.is_constant_rate && frames.exposures_stamped == 0 {
        found.fact(
            "constant_rate",
            "frames have one and the same distance",
            format!("{} every {every}", frames.count),
            "if the stamps were made from a rate, check it against another clock: real cameras wander",
        );
    }
}

fn questions(frames: &FramesSurvey, found: &mut Findings) {
    let missing = frames.count - frames.exposures_stamped.min(frames.count);
    if missing > 0 {
        found.question(
            "exposure_unknown",
            "the exposure of frames is not recorded",
            format!("{missing} of {} have no start and end", frames.count),
            "state `exposure`; estimate/exposure proposes one from the blur",
        );
        if frames.stamp.is_none() {
            found.question(
                "stamp_unknown",
                "what a frame's stamp means is not recorded",
                "start, middle or end of the exposure: half an exposure either way",
                "state `stamp`; estimate/offset says how the frames lie against the events",
            );
        }
    } else {
        let exposure = frames.exposure.unwrap_or_default();
        let share = frames.period.map_or_else(String::new, |period| {
            format!(", {} of the period", percent(exposure.median_ns as f64 / period.median_ns.max(1) as f64))
        });
        found.fact(
            "exposure_stamps",
            "start and end of every exposure are recorded",
            format!("{}{share}", time(exposure.median_ns as f64)),
            "nothing: they are used",
        );
    }
    if frames.row_time_ns.is_none() {
        found.question(
            "row_time_unknown",
            "the delay from row to row is not recorded",
            "0 is a global shutter; rolling shutters have 5 to 50 us",
            "state `frames.row_time` in the sensor description; estimate/row_time proposes one",
        );
    }
    if frames.transfer.is_none() {
        found.question(
            "transfer_unknown",
            "whether stored values are linear is not recorded",
            format!("{} bits, {}", frames.bits, frames.colour),
            "state `transfer`: linear (raw), srgb or a gamma; pictures of video are not linear",
        );
    }
}
