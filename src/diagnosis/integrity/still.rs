//! Pixels that see nothing move: whatever they record is the sensor's own.
//!
//! A pixel is still when its frames change by no more than their noise, or by less than a quarter of a
//! threshold, and so do all pixels around it: what is fast passes between two frames, but it comes from
//! somewhere. Events of one sign there are a leak ([`leak`]); events that come when their row of the frame is
//! read are coupling ([`coupling`]). A leak fills the gap to the threshold, coupling decides when it is
//! crossed, so both are often met together.
//!
//! Limits: a scene in which all moves has no still pixels, and these tests are silent. A leak that fires only
//! at readouts does not show how strong the coupling is; that is counted where light rises.

use super::array::half;
use super::departure::{Departure, Heldout};
use super::rest::is_at_rest;
use crate::units::readable;
use photocurrent_scene::case::{Case, CaseFrames, PixelEvent};
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::statistics::{median, quantile};

/// Fewer frames say too little of what stands still.
const FEWEST_FRAMES: usize = 5;
/// As many pixels must be still.
const FEWEST_PIXELS: usize = 200;
/// Frames of a still pixel stay within so many standard deviations of the noise of quiet pixels; of 60 normal
/// values the range is 4.6 on average, and bright pixels have more.
const NOISE_RANGE: f64 = 10.0;
/// Or within this share of the smaller threshold.
const THRESHOLD_SHARE: f64 = 0.25;
/// What moves must be farther away than this, pixels in rows and columns.
const DISTANCE: usize = 4;
/// So few events of one sign decide nothing.
const FEWEST_EVENTS: usize = 30;
/// ON events must be so many times as many as OFF events; and of a camera at rest, where these are noise.
const ON_OVER_OFF: usize = 4;
const ON_OVER_OFF_AT_REST: usize = 2;
/// Their difference over the root of their sum.
const SIGMAS: f64 = 7.0;
/// A pixel may have this share of them, for one that is hot is no leak of all.
const SHARE_OF_ONE: f64 = 0.1;
/// Parts of the recording, in so many of which there must be some.
const PARTS: usize = 12;
const STEADY: usize = 9;
/// Nats that a rate which grows with the light must be better than one rate of all pixels.
const BY_LIGHT: f64 = 10.0;
/// And nats that a rate in proportion to the light may be worse than one that has a part without light.
const ALL_BY_LIGHT: f64 = 3.0;

/// The pixels that are still, rising; none where frames do not show it. `masked` are left out.
pub(super) fn still(case: &Case, nominal: &Nominal, masked: &[u32]) -> Vec<u32> {
    let Some(frames) = case.frames.as_ref().filter(|frames| frames.times.len() >= FEWEST_FRAMES) else {
        return Vec::new();
    };
    let (pixels, noise) = (case.extent.pixels(), noise_dn(case, frames));
    let threshold = f64::min(nominal.pixel.threshold_on, nominal.pixel.threshold_off);
    let moves: Vec<bool> = (0..pixels)
        .map(|pixel| {
            let (mut low, mut high, mut sum, mut count) = (f64::INFINITY, f64::NEG_INFINITY, 0.0, 0.0);
            for dn in frames.of_pixel(pixel).filter(|dn| dn.is_finite()).map(f64::from) {
                (low, high, sum, count) = (low.min(dn), high.max(dn), sum + dn, count + 1.0);
            }
            let signal = sum / f64::max(count, 1.0) - nominal.number.black_level;
            // A saturated pixel shows no motion, and has it nevertheless.
            let is_seen = count >= FEWEST_FRAMES as f64 && high < nominal.saturation_dn;
            !is_seen || high - low > f64::max(NOISE_RANGE * noise, THRESHOLD_SHARE * threshold * signal)
        })
        .collect();
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let near = |at: usize, size: usize| at.saturating_sub(DISTANCE)..(at + DISTANCE + 1).min(size);
    let in_row: Vec<bool> = (0..pixels)
        .map(|pixel| near(pixel % width, width).any(|x| moves[pixel / width * width + x]))
        .collect();
    let is_still = |pixel: usize| !near(pixel / width, height).any(|y| in_row[y * width + pixel % width]);
    (0..pixels)
        .filter(|&pixel| is_still(pixel) && masked.binary_search(&(pixel as u32)).is_err())
        .map(|pixel| pixel as u32)
        .collect()
}

/// Standard deviation of a frame value where the light stands still, DN: from differences of frames that
/// follow each other, of the quietest fifth of the pixels.
pub(super) fn noise_dn(case: &Case, frames: &CaseFrames) -> f64 {
    let pixels = case.extent.pixels();
    let mut all: Vec<f64> = (0..pixels)
        .step_by(pixels.div_ceil(5000))
        .filter_map(|pixel| {
            let values: Vec<f64> = frames.of_pixel(pixel).map(f64::from).collect();
            let mut steps: Vec<f64> = values
                .windows(2)
                .map(|pair| (pair[1] - pair[0]).abs())
                .filter(|step| step.is_finite())
                .collect();
            (steps.len() >= FEWEST_FRAMES - 1).then(|| deviation(&mut steps))
        })
        .collect();
    all.sort_by(f64::total_cmp);
    quantile(&all, 0.2)
}

/// Standard deviation of a value whose absolute differences are `steps`. Where more than half of them are 0,
/// as of dark pixels in whole digital numbers, from the share that is not: one step counts 1 at most, as more
/// is no noise.
fn deviation(steps: &mut [f64]) -> f64 {
    match median(steps) {
        0.0 => {
            let mean = steps.iter().map(|step| step.min(1.0)).sum::<f64>() / steps.len() as f64;
            // Of two normal values the mean absolute difference is 2 / sqrt(pi) standard deviations.
            mean * 0.5 * libm::sqrt(std::f64::consts::PI)
        }
        middle => 1.4826 * middle / std::f64::consts::SQRT_2,
    }
}

/// Events of still pixels, by pixel.
fn events<'a>(case: &'a Case, still: &'a [u32]) -> impl Iterator<Item = (usize, &'a PixelEvent)> {
    still
        .iter()
        .flat_map(|&pixel| case.events.of(pixel as usize).iter().map(move |event| (pixel as usize, event)))
}

/// ON events where nothing moves, all the time and in no pixel above all: the reference leaks, by itself or
/// by the light that falls on it.
pub(super) fn leak(case: &Case, nominal: &Nominal, still: &[u32], masked: &[u32]) -> Option<Departure> {
    if still.len() < FEWEST_PIXELS {
        return None;
    }
    let length = ((case.span.1 - case.span.0) / PARTS as i64).max(1);
    let (mut on, mut off, mut parts) = ([0_usize; 2], [0_usize; 2], [false; PARTS]);
    for (pixel, event) in events(case, still) {
        if event.polarity > 0 {
            on[half(case, pixel)] += 1;
            parts[(((event.t_in_ns - case.span.0) / length).max(0) as usize).min(PARTS - 1)] = true;
        } else {
            off[half(case, pixel)] += 1;
        }
    }
    let (ons, offs) = (on[0] + on[1], off[0] + off[1]);
    let sigmas = (ons as f64 - offs as f64) / libm::sqrt((ons + offs).max(1) as f64);
    let of_one = still.iter().map(|&pixel| case.events.of(pixel as usize).len()).max().unwrap_or(0);
    let is_steady = parts.iter().filter(|part| **part).count() >= STEADY;
    let on_over_off = if is_at_rest(case, still, masked) { ON_OVER_OFF_AT_REST } else { ON_OVER_OFF };
    if ons < FEWEST_EVENTS
        || ons < on_over_off * offs
        || sigmas < SIGMAS
        || of_one as f64 > f64::max(3.0, SHARE_OF_ONE * ons as f64)
        || !is_steady
    {
        return None;
    }
    let a_pixel = (ons - offs) as f64 / still.len() as f64;
    if brightening(case, nominal, still) > 0.5 * nominal.pixel.threshold_on * a_pixel {
        return None;
    }
    let rate = a_pixel / ((case.span.1 - case.span.0) as f64 * 1e-9);
    // Held against noise that has no sign, of the same rate: one half gives the share of ON events, the other
    // is predicted with it.
    let nats: f64 = (0..2)
        .map(|side| {
            let share = (on[1 - side] as f64 + 1.0) / ((on[1 - side] + off[1 - side]) as f64 + 2.0);
            on[side] as f64 * libm::log(2.0 * share) + off[side] as f64 * libm::log(2.0 * (1.0 - share))
        })
        .sum();
    let light = ByLight::of(case, nominal, still);
    let (id, parameter) = if light.grows > BY_LIGHT && light.in_proportion > light.grows - ALL_BY_LIGHT {
        ("parasitic_leak", ("coefficient", rate * nominal.pixel.threshold_on / light.mean))
    } else {
        ("leak_events", ("rate", rate))
    };
    let the_brighter = if light.grows > BY_LIGHT { ", the more the brighter" } else { "" };
    Some(Departure {
        id,
        parameters: vec![parameter],
        statistic: sigmas,
        threshold: SIGMAS,
        share: ons as f64 / case.events.len() as f64,
        polarity: "on",
        pixels: Vec::new(),
        seen: format!(
            "{} pixels in which nothing moves have {ons} ON and {offs} OFF events: {} a pixel more ON than \
             OFF{the_brighter}",
            still.len(),
            readable(rate, "Hz")
        ),
        heldout: Some(Heldout { nats, events: ons + offs }),
        ci95: Vec::new(),
    })
}

/// How ON events of still pixels, less OFF events (for what yet moves fires both), go with the light: nats
/// over one rate of all pixels.
struct ByLight {
    /// Of a rate in proportion to the light.
    in_proportion: f64,
    /// Of the best mixture of both.
    grows: f64,
    /// Mean light, photocurrent.
    mean: f64,
}

impl ByLight {
    fn of(case: &Case, nominal: &Nominal, still: &[u32]) -> ByLight {
        let frames = case.frame_count();
        let exposure_s =
            case.frames.as_ref().and_then(|frames| frames.times.nominal_exposure_ns()).unwrap_or(1) as f64
                * 1e-9;
        let light = |pixel: usize| -> f64 {
            let sum: f64 = (0..frames)
                .map(|frame| nominal.number.integral(case.dn(frame, pixel)))
                .filter(|charge| charge.is_finite())
                .sum();
            sum / frames as f64 / exposure_s
        };
        let lights: Vec<f64> = still.iter().map(|&pixel| light(pixel as usize)).collect();
        let mean = lights.iter().sum::<f64>() / lights.len() as f64;
        let excess = |pixel: u32| {
            case.events.of(pixel as usize).iter().map(|event| f64::from(event.polarity)).sum::<f64>()
        };
        let net: Vec<(f64, f64)> = still
            .iter()
            .zip(&lights)
            .map(|(&pixel, light)| (excess(pixel), light / mean))
            .filter(|(excess, _)| *excess != 0.0)
            .collect();
        // Where the light is nearly zero, its noise would decide.
        let nats = |share: f64| {
            net.iter()
                .map(|(excess, light)| excess * libm::log(f64::max(1.0 - share + share * light, 0.01)))
                .sum::<f64>()
        };
        let grows = (0..=20).map(|k| nats(f64::from(k) / 20.0)).fold(f64::NEG_INFINITY, f64::max);
        ByLight { in_proportion: nats(1.0), grows, mean }
    }
}

/// By how much still pixels grow brighter over the recording, natural-log units: the least that a straight
/// line through the means of the frames allows (two standard errors less), 0 when that is nothing. A slow
/// dawn fires ON events too.
fn brightening(case: &Case, nominal: &Nominal, still: &[u32]) -> f64 {
    let frames = case.frame_count();
    let level: Vec<f64> = (0..frames)
        .map(|frame| {
            let sum: f64 = still
                .iter()
                .map(|&pixel| case.dn(frame, pixel as usize) - nominal.number.black_level)
                .filter(|dn| dn.is_finite())
                .sum();
            libm::log(f64::max(sum, 1e-9))
        })
        .collect();
    let n = frames as f64;
    let (middle, mean) = (0.5 * (n - 1.0), level.iter().sum::<f64>() / n);
    let spread: f64 = (0..frames).map(|frame| (frame as f64 - middle) * (frame as f64 - middle)).sum();
    let slope =
        level.iter().enumerate().map(|(frame, level)| (frame as f64 - middle) * (level - mean)).sum::<f64>()
            / f64::max(spread, 1.0);
    let left: f64 = level
        .iter()
        .enumerate()
        .map(|(frame, level)| level - mean - slope * (frame as f64 - middle))
        .map(|rest| rest * rest)
        .sum();
    let error = libm::sqrt(left / f64::max(n - 2.0, 1.0) / f64::max(spread, 1.0));
    f64::max((slope - 2.0 * error) * (n - 1.0), 0.0)
}
