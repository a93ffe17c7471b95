//! Flicker of the light: one rhythm at one phase over the whole array, in events and in frames.
//!
//! The mean over many pixels of the summed signed thresholds follows the mean log light; what moves across
//! the array averages out, what is common to all pixels stays. Both paths see it: it is a property of the
//! scene, and no fault of the sensor.

use super::array::{EventsByTime, LAMPS_HZ, LAMPS_STEP_NS, slow_mean};
use super::episodes::rhythm::EventRhythm;
use crate::report::SceneProperty;
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;

/// Zones across and down.
const ZONES: usize = 4;
/// Of the zones' amplitudes, so much must be common.
const COHERENCE: f64 = 0.9;
/// Shallower is not reported, as a share of the light.
const SHALLOWEST: f64 = 0.02;
/// The rhythm of the light, when there is one.
pub(super) fn flicker(case: &Case, nominal: &Nominal, stream: &EventsByTime) -> Vec<SceneProperty> {
    let Some((first, last)) = stream.span() else { return Vec::new() };
    let steps = ((last - first) / LAMPS_STEP_NS) as usize;
    // Three periods of the slowest, and enough steps.
    if steps < 130 {
        return Vec::new();
    }
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let zone = |pixel: usize| (pixel / width * ZONES / height) * ZONES + pixel % width * ZONES / width;
    let mut change = vec![vec![0.0; steps + 1]; ZONES * ZONES];
    let mut pixels = [0.0; ZONES * ZONES];
    // A pixel that never fires carries no information: the rhythm may be below its threshold.
    let mut size = [0.0; ZONES * ZONES];
    for pixel in 0..width * height {
        size[zone(pixel)] += 1.0;
        pixels[zone(pixel)] += if case.events.of_pixel(pixel).is_empty() { 0.0 } else { 1.0 };
    }
    for event in &stream.0 {
        let step = (((event.t_ns - first) / LAMPS_STEP_NS) as usize).min(steps);
        let threshold =
            if event.polarity > 0 { nominal.pixel.threshold_on } else { -nominal.pixel.threshold_off };
        change[zone(event.pixel as usize)][step] += threshold;
    }
    let curves: Vec<Vec<f64>> = change
        .iter()
        .zip(&pixels)
        .zip(&size)
        .filter(|((_, pixels), size)| **pixels > 0.3 * **size)
        .map(|((change, pixels), _)| {
            let mut level = 0.0;
            let summed: Vec<f64> = change
                .iter()
                .map(|change| {
                    level += change / f64::max(*pixels, 1.0);
                    level
                })
                .collect();
            summed.iter().zip(slow_mean(&summed)).map(|(value, slow)| value - slow).collect()
        })
        .collect();
    if curves.len() < ZONES {
        return Vec::new();
    }
    let mut best: Option<(f64, f64, f64)> = None;
    for hz in LAMPS_HZ {
        let amplitudes: Vec<(f64, f64)> =
            curves.iter().map(|curve| amplitude(curve, f64::from(hz))).collect();
        let n = amplitudes.len() as f64;
        let mean = amplitudes.iter().fold((0.0, 0.0), |sum, one| (sum.0 + one.0 / n, sum.1 + one.1 / n));
        let power = amplitudes.iter().map(|one| one.0 * one.0 + one.1 * one.1).sum::<f64>() / n;
        let depth = libm::sqrt(mean.0 * mean.0 + mean.1 * mean.1);
        if best.is_none_or(|best| depth > best.1) {
            best = Some((f64::from(hz), depth, depth / libm::sqrt(f64::max(power, 1e-30))));
        }
    }
    best.filter(|(_, depth, coherence)| *depth > SHALLOWEST && *coherence > COHERENCE)
        .map(|(frequency_hz, depth, _)| SceneProperty::flicker(frequency_hz, depth))
        .into_iter()
        .collect()
}

/// A rhythm, with its part of the array where it is there for a while: the thresholds of its events are the
/// change of log light. One of the whole recording that is shallow may be a ripple of thresholds as well, and
/// is none.
pub(super) fn property_of_rhythm(nominal: &Nominal, rhythm: &EventRhythm) -> Option<SceneProperty> {
    let threshold = 0.5 * (nominal.pixel.threshold_on + nominal.pixel.threshold_off);
    let depth = threshold * rhythm.amplitude / (std::f64::consts::TAU * rhythm.hz);
    let flicker = SceneProperty::flicker(rhythm.hz, depth);
    if !rhythm.for_a_while {
        return Some(flicker).filter(|flicker| flicker.depth > SHALLOWEST);
    }
    let [rows, columns] = [rhythm.rows, rhythm.columns].map(Some);
    Some(SceneProperty { time_ns: Some(rhythm.time_ns), rows, columns, ..flicker })
}

/// Amplitude of a frequency: cosine and sine part, under a Hann window.
fn amplitude(curve: &[f64], hz: f64) -> (f64, f64) {
    let (mut re, mut im, mut weight) = (0.0, 0.0, 0.0);
    let n = curve.len() as f64;
    for (k, value) in curve.iter().enumerate() {
        let window = 0.5 - 0.5 * libm::cos(std::f64::consts::TAU * (k as f64 + 0.5) / n);
        let phase = std::f64::consts::TAU * hz * k as f64 * LAMPS_STEP_NS as f64 * 1e-9;
        re += window * value * libm::cos(phase);
        im += window * value * libm::sin(phase);
        weight += window;
    }
    (2.0 * re / weight, 2.0 * im / weight)
}
