//! What to record next, so that what looks alike comes apart.

use crate::case::Case;
use crate::integrity::Integrity;
use crate::report::Verdict;
use crate::verdict::Answer;

/// Pairs that look alike, and what tells them apart.
const APART: &[(&str, &str, &str)] = &[
    ("blur", "crosstalk", "a slanted sharp edge: blur widens it to both sides by its sigma, crosstalk adds a fixed share of the next pixel only"),
    ("readout_queue", "clock_offset", "the same scene at a tenth of the event rate: a queue vanishes, an offset stays"),
    ("second_pole", "time_constant", "a step of light of known instant (a flashing lamp): a second pole delays the rise, a time constant only slows it"),
    ("clock_offset", "time_constant", "the same scene in brighter light: the delay of a time constant shrinks, an offset stays"),
    ("clock_offset", "second_pole", "the same scene at twice the speed, and in brighter light: an offset changes with neither"),
    ("clock_offset", "misalignment", "the same scene moving the other way: a shift changes its sign in time, an offset does not"),
    ("clock_drift", "clock_offset", "a recording four times as long: a drift grows with it"),
    ("threshold_scale", "lateral_inhibition", "a large even surface that grows brighter: without a surround that differs there is nothing to inhibit"),
    ("threshold_scale", "dark_current", "the same scene in twice the light: a dark current matters half as much, a threshold as before"),
    ("threshold_scale", "black_level", "a frame with the lens covered: it reads the black level"),
    ("threshold_scale", "threshold_drift", "a recording four times as long: a drift grows with it"),
    ("dark_current", "black_level", "a frame with the lens covered: it reads the black level"),
    ("refractory", "refractory_light", "the same scene in twice the light: only one of the blind times changes"),
    ("refractory", "refractory_spread", "a fast blinking lamp over the whole array: each pixel shows its own blind time"),
    ("refractory", "reset_memory", "the same scene at three times the speed: the blind time matters three times as much, the memory as before"),
    ("leak_events", "parasitic_leak", "a static scene in dim and in bright light: only a parasitic leak fires more in bright light"),
    ("leak_events", "threshold_asymmetry", "a static scene: a leak fires without motion, an asymmetry does not"),
    ("leak_events", "background_activity", "a static scene: a leak fires ON only and regularly, noise both signs and irregularly"),
    ("exposure_time", "black_level", "the same scene with half the exposure: a black level stays"),
    ("exposure_time", "frame_nonlinearity", "the same scene with half the exposure: only a nonlinearity changes the ratio of bright to dark"),
    ("frame_nonlinearity", "black_level", "a series of exposures of a static scene: a straight line that misses zero, or a curve"),
    ("exposure_time", "image_lag", "a lamp that is switched off: lag leaves a trace in the next frame"),
    ("threshold_mismatch", "threshold_noise", "the same scene again: mismatch repeats in each pixel, noise does not"),
    ("threshold_mismatch", "refractory_spread", "the same scene at a third of the speed: a blind time matters a third as much, a threshold as before"),
    ("timestamp_jitter", "threshold_noise", "the same scene at three times the speed: jitter matters three times as much, threshold noise as before"),
    ("vignetting", "bandwidth_gradient", "an even bright surface: vignetting shows in a single frame"),
    ("threshold_gradient", "bandwidth_gradient", "the same scene in brighter light: a bandwidth matters less, a threshold as before"),
];

/// Advice for a diagnosis; nothing when there is nothing to tell apart.
pub fn next_experiments(case: &Case, answer: &Answer, integrity: &Integrity) -> Vec<String> {
    let mut advice = Vec::new();
    for claim in &answer.claims {
        let mut set = vec![claim.id];
        set.extend(&claim.also_possible);
        for (k, one) in set.iter().enumerate() {
            for other in &set[k + 1..] {
                let known = APART.iter().find(|(a, b, _)| (a == one && b == other) || (a == other && b == one));
                advice.push(match known {
                    Some((a, b, what)) => format!("to tell {a} from {b}: {what}"),
                    None => format!("to tell {one} from {other}: the same scene at another speed and in other light, as the two do not scale alike"),
                });
            }
        }
    }
    if answer.verdict == Verdict::Insufficient {
        advice.extend(integrity.lacking.iter().map(|what| format!("record more: {what}")));
    }
    if answer.verdict == Verdict::BrokenData {
        advice.push("record again, or repair the file: nothing can be said of a sensor whose data contradict themselves".into());
    }
    if answer.verdict == Verdict::Consistent && case.frame_count() > 0 {
        advice.push("faster motion, sharper edges and a wider range of light make smaller effects visible".into());
    }
    advice
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::sensor::EFFECT_IDS;

    #[test]
    fn advice_is_about_effects_of_the_catalogue() {
        for (a, b, _) in APART {
            assert!(EFFECT_IDS.contains(a) && EFFECT_IDS.contains(b) && a != b, "{a} {b}");
        }
    }
}
