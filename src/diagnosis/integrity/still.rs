//! Still pixels: all their events are the sensor's own.
//!
//! A pixel is still when its frames change by no more than their noise, or by less than a quarter of a
//! threshold, and so do all pixels around it: fast objects pass between two frames, but they come from the
//! surroundings. Events of one sign there are a leak ([`leak`]). Events at the readout of their row are
//! coupling (`coupling`). A leak brings the voltage to the threshold and coupling sets the instant of
//! crossing, so both often occur together.
//!
//! Limits: a scene in full motion has no still pixels, and these tests abstain. A leak that fires only at
//! readouts does not show the size of the coupling; that is measured where light rises.

use super::array::half;
use super::departure::{Departure, HalvesGain};
use super::rest::is_at_rest;
use crate::units::readable;
use photocurrent_scene::case::{Case, CaseFrames, PixelEvent};
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::statistics::{median, quantile};

/// Least number of frames.
const FEWEST_FRAMES: usize = 5;
/// As many pixels must be still.
const FEWEST_PIXELS: usize = 200;
/// Largest range of a still pixel's frames, standard deviations of the noise of quiet pixels. Of 60 normal
/// values the range is 4.6 on average, and bright pixels have more.
const NOISE_RANGE: f64 = 10.0;
/// Or within this share of the smaller threshold.
const THRESHOLD_SHARE: f64 = 0.25;
/// Least distance of moving pixels, in rows and columns.
const DISTANCE: usize = 4;
/// Least number of events of one sign.
const FEWEST_EVENTS: usize = 30;
/// Least ratio of ON to OFF events; and for a camera at rest, where OFF events are noise.
const ON_OVER_OFF: usize = 4;
const ON_OVER_OFF_AT_REST: usize = 2;
/// Their difference over the root of their sum.
const SIGMAS: f64 = 7.0;
/// A pixel may have this share of them, for one that is hot is no leak of all.
const SHARE_OF_ONE: f64 = 0.1;
/// Parts of the recording, and the number of them that must have events.
const PARTS: usize = 12;
const STEADY: usize = 9;
/// Nats that a rate which grows with the light must be better than one rate of all pixels.
const BY_LIGHT: f64 = 10.0;
/// And nats that a rate in proportion to the light may be worse than one that has a part without light.
const ALL_BY_LIGHT: f64 = 3.0;

/// Still pixels, rising; empty where frames do not show them. `masked`: pixels left out.
pub(super) fn still_pixels(case: &Case, nominal: &Nominal, masked: &[u32]) -> Vec<u32> {
    let Some(frames) = case.frames.as_ref().filter(|frames| frames.times.len() >= FEWEST_FRAMES) else {
        return Vec::new();
    };
    let (pixels, noise) = (case.extent.pixels(), noise_dn(case, frames));
    let threshold = f64::min(nominal.pixel.threshold_on, nominal.pixel.threshold_off);
    let moves: Vec<bool> = (0..pixels)
        .map(|pixel| {
            let (mut low, mut high, mut sum, mut count) = (f64::INFINITY, f64::NEG_INFINITY, 0.0, 0.0);
            for dn in frames.values_of_pixel(pixel).filter(|dn| dn.is_finite()).map(f64::from) {
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

/// Standard deviation of a frame value under constant light, DN: from differences of consecutive frames, over
/// the quietest fifth of the pixels.
pub(super) fn noise_dn(case: &Case, frames: &CaseFrames) -> f64 {
    let pixels = case.extent.pixels();
    let mut all: Vec<f64> = (0..pixels)
        .step_by(pixels.div_ceil(5000))
        .filter_map(|pixel| {
            let values: Vec<f64> = frames.values_of_pixel(pixel).map(f64::from).collect();
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
/// as of dark pixels in whole digital numbers, it follows from the share that is not. One step counts 1 at
/// most: larger ones are not noise.
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
    still.iter().flat_map(|&pixel| {
        case.events.of_pixel(pixel as usize).iter().map(move |event| (pixel as usize, event))
    })
}

/// Leak of the reference: ON events of still pixels, all the time and not concentrated in a few pixels; by
/// itself or in proportion to light.
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
    let of_one = still.iter().map(|&pixel| case.events.of_pixel(pixel as usize).len()).max().unwrap_or(0);
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
    let light = RateByLight::from_case(case, nominal, still);
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
        heldout: Some(HalvesGain { nats, events: ons + offs }),
        ci95: Vec::new(),
    })
}

/// Gain of a rate of ON less OFF events of still pixels that depends on light, over one rate for all, nats.
struct RateByLight {
    /// Of a rate in proportion to the light.
    in_proportion: f64,
    /// Of the best mixture of both.
    grows: f64,
    /// Mean light, photocurrent.
    mean: f64,
}

impl RateByLight {
    fn from_case(case: &Case, nominal: &Nominal, still: &[u32]) -> RateByLight {
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
            case.events.of_pixel(pixel as usize).iter().map(|event| f64::from(event.polarity)).sum::<f64>()
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
        RateByLight { in_proportion: nats(1.0), grows, mean }
    }
}

/// Increase of log light of still pixels over the recording, natural-log units: the lower bound (two standard
/// errors) of a straight line through the means of the frames, at least 0. A slow dawn causes ON events too.
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
