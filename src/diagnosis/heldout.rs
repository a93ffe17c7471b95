//! The loop closed: frames that are kept back, predicted from the events and the other frames, with the description as stated and with the fitted one.
//!
//! Every third frame is kept back, the light is estimated from what is left, and the kept frames are what the camera would read of it. Only what the solver can undo
//! enters: the fields of the description, clocks and exposure times. Other effects change nothing here, and then nothing is told.

use crate::candidates::CANDIDATES;
use crate::case::{Case, CaseFrames, PixelEvents, Recorded};
use crate::nominal::Nominal;
use crate::sample::Sample;
use crate::scene::{Scene, SceneSetting};
use photocurrent_core::{Exposure, FrameTimes, NodeError, Sensor};
use photocurrent_sensor::exposure::DigitalNumber;

/// Of each three frames this one is kept back.
const KEPT: usize = 1;

/// How well kept frames are predicted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Prediction {
    /// Mean square error, DN squared.
    pub square_error: f64,
    /// Peak for a signal-to-noise ratio, DN: saturation, or the largest value.
    pub peak_dn: f64,
    /// Root mean square error by pixel of the sample, as a share of the pixel's mean; NaN where nothing was predicted.
    pub by_pixel: Vec<f64>,
    /// Root mean square error by kept frame: its number, DN.
    pub by_frame: Vec<(usize, f64)>,
    /// The light it was predicted from.
    pub scene: Scene,
}

impl Prediction {
    /// Peak signal-to-noise ratio, dB.
    pub fn psnr_db(&self) -> f64 {
        10.0 * libm::log10(self.peak_dn * self.peak_dn / f64::max(self.square_error, 1e-12))
    }
}

/// Predicts every third frame with a description; none with fewer than five frames, or when nothing can be predicted.
///
/// # Errors
/// When the description does not state what the model needs.
pub fn predict(case: &Case, sensor: &Sensor, sample: &Sample, setting: &SceneSetting) -> Result<Option<Prediction>, NodeError> {
    let nominal = case.described(&sensor)?;
    let Some(frames) = &case.frames else { return Ok(None) };
    let Some((rest, kept)) = kept_back(case) else { return Ok(None) };
    let scene = Scene::estimate(&rest, &nominal, sample, setting);
    let mut by_pixel = vec![f64::NAN; sample.len()];
    let mut by_frame = vec![(0.0, 0.0); kept.len()];
    let (mut sum, mut count, mut largest) = (0.0, 0.0, 0.0_f64);
    for (n, &pixel) in sample.pixels.iter().enumerate().filter(|(n, _)| scene.is_known[*n]) {
        let (_, y) = case.place(pixel as usize);
        let (mut own, mut values, mut level) = (0.0, 0.0, 0.0);
        for (slot, &frame) in kept.iter().enumerate() {
            let dn = case.dn(frame, pixel as usize);
            if !dn.is_finite() || dn >= nominal.saturation_dn {
                continue;
            }
            let off = expected_dn(&nominal.number, &scene, n, frames.times.exposure(frame, y)).min(nominal.saturation_dn) - dn;
            let error = off * off;
            own += error;
            values += 1.0;
            level += dn - nominal.number.black_level;
            largest = largest.max(dn);
            by_frame[slot] = (by_frame[slot].0 + error, by_frame[slot].1 + 1.0);
        }
        if values > 0.0 {
            by_pixel[n] = libm::sqrt(own / values) / f64::max(level / values, 1.0);
        }
        sum += own;
        count += values;
    }
    if count == 0.0 {
        return Ok(None);
    }
    let peak_dn = if nominal.saturation_dn.is_finite() { nominal.saturation_dn } else { largest };
    let by_frame = kept.iter().zip(by_frame).filter(|(_, (_, count))| *count > 0.0).map(|(frame, (sum, count))| (*frame, libm::sqrt(sum / count))).collect();
    Ok(Some(Prediction { square_error: sum / count, peak_dn, by_pixel, by_frame, scene }))
}

/// A recording without every third frame, and which of them are foretold: not the last one, which has no frame after it. None with fewer than five frames.
pub fn kept_back(case: &Case) -> Option<(Case, Vec<usize>)> {
    let count = case.frame_count();
    if count < 5 {
        return None;
    }
    let pixels = case.extent.pixels();
    let mut rest = case.clone();
    if let Some(frames) = &mut rest.frames {
        for frame in (KEPT..count).step_by(3) {
            frames.dn[frame * pixels..(frame + 1) * pixels].fill(f32::NAN);
        }
    }
    Some((rest, (KEPT..count - 1).step_by(3).collect()))
}

/// DN of an exposure: the light is log-linear between knots, and constant before the first and after the last.
fn expected_dn(number: &DigitalNumber, scene: &Scene, n: usize, exposure: Exposure) -> f64 {
    let (t, u) = scene.pixel(n);
    let (start, end) = (exposure.start.0 as f64, exposure.end.0 as f64);
    let mut charge = 0.0;
    let mut add = |from: f64, to: f64, left: f64, right: f64| {
        let (from, to) = (from.max(start), to.min(end));
        if to > from {
            // The integral of exp over a straight line; for a flat one the limit of it.
            let rise = right - left;
            let mean = if rise.abs() < 1e-6 { libm::exp(0.5 * (left + right)) } else { libm::exp(left) * libm::expm1(rise) / rise };
            charge += mean * (to - from) * 1e-9;
        }
    };
    let last = t.len() - 1;
    add(f64::NEG_INFINITY, t[0] as f64, u[0], u[0]);
    for k in 0..last {
        // Cut to the exposure first: the mean of a part is not that of the whole.
        let (a, b) = (t[k] as f64, t[k + 1] as f64);
        let at = |instant: f64| u[k] + (u[k + 1] - u[k]) * ((instant - a) / (b - a)).clamp(0.0, 1.0);
        add(a, b, at(start.max(a)), at(end.min(b)));
    }
    add(t[last] as f64, f64::INFINITY, u[last], u[last]);
    number.of(charge)
}

/// The recording as a sensor without an effect of clocks or exposures would have recorded it: what is found is undone. None when nothing found is of that kind.
pub fn undone(case: &Case, found: &[(usize, f64)]) -> Option<Case> {
    let mut undone = case.clone();
    let mut is_changed = false;
    for (which, value) in found {
        let ns = value * 1e9;
        match CANDIDATES[*which].id {
            "clock_offset" => moved(&mut undone, |t| t - ns.round() as i64),
            "clock_drift" => moved(&mut undone, |t| (t as f64 / (1.0 + value)).round() as i64),
            "row_time" => exposures(&mut undone, ns.round() as i64, 0),
            "exposure_time" => {
                let row_time_ns = undone.frames.as_ref().map_or(0, |frames| frames.times.row_time_ns);
                exposures(&mut undone, row_time_ns, ns.round() as i64);
            }
            _ => continue,
        }
        is_changed = true;
    }
    is_changed.then_some(undone)
}

/// Other stamps.
fn moved(case: &mut Case, time: impl Fn(i64) -> i64) {
    let pixels: Vec<Vec<Recorded>> = (0..case.events.pixels())
        .map(|pixel| case.events.of(pixel).iter().map(|event| Recorded { t_in_ns: time(event.t_in_ns), t_off_ns: time(event.t_off_ns), ..*event }).collect())
        .collect();
    case.events = PixelEvents::new(pixels);
    // No event may fall out of the recording.
    case.span = case.events.all().iter().fold(case.span, |span, event| (span.0.min(event.t_in_ns), span.1.max(event.t_off_ns)));
}

/// Another row time, and exposures that begin earlier.
fn exposures(case: &mut Case, row_time_ns: i64, longer_ns: i64) {
    let Some(frames) = &case.frames else { return };
    let exposures =
        frames.times.exposures.iter().map(|exposure| Exposure::new((exposure.start.0 - longer_ns).min(exposure.end.0 - 1), exposure.end.0)).collect();
    // Exposures in order stay in order: all starts move alike.
    if let Ok(times) = FrameTimes::new(exposures, row_time_ns) {
        let dn = frames.dn.clone();
        case.span.0 = case.span.0.min(times.exposures.first().map_or(case.span.0, |exposure| exposure.start.0));
        case.frames = Some(CaseFrames { times, dn });
    }
}

/// Does a fitted description differ from the stated one in what the solver reads?
pub fn is_read_by_solver(stated: &Nominal, fitted: &Nominal) -> bool {
    let key = |nominal: &Nominal| {
        let pixel = nominal.pixel;
        let number = nominal.number;
        (
            [pixel.front_end.tau_0_s, pixel.front_end.alpha_s, pixel.threshold_on, pixel.threshold_off, number.black_level, number.gain],
            pixel.refractory_ns,
            nominal.reset,
        )
    };
    key(stated) != key(fitted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    fn position(id: &str) -> usize {
        CANDIDATES.iter().position(|candidate| candidate.id == id).unwrap()
    }

    #[test]
    fn the_charge_of_an_exposure_is_that_of_a_fine_sum() {
        let scene = Scene::from_pixels([(vec![1_000_000, 3_000_000, 4_000_000], vec![1.0, 2.5, 2.5], true)]);
        let number = DigitalNumber { black_level: 7.0, gain: 1000.0 };
        let exposure = Exposure::new(500_000, 4_700_000);
        let light = |t: f64| {
            let u = if t < 1e6 {
                1.0
            } else if t < 3e6 {
                1.0 + 1.5 * (t - 1e6) / 2e6
            } else {
                2.5
            };
            libm::exp(u)
        };
        let steps = 42_000;
        let sum: f64 = (0..steps).map(|k| light(5e5 + (f64::from(k) + 0.5) * 100.0) * 100e-9).sum();
        let expected = 7.0 + 1000.0 * sum;
        assert!((expected_dn(&number, &scene, 0, exposure) - expected).abs() < 1e-5 * expected);
    }

    #[test]
    fn a_clock_that_is_set_right_predicts_kept_frames_better() {
        let offset = serde_json::json!({"offset": "-700 us"});
        let effects = [("clock_offset".to_owned(), offset.as_object().unwrap().clone())].into_iter().collect();
        let case = testing::case_with(&effects);
        let sample = Sample::all(&case, 4);
        let setting = SceneSetting::default();
        let before = predict(&case, &case.sensor, &sample, &setting).unwrap().unwrap();
        let right = undone(&case, &[(position("clock_offset"), -700e-6)]).unwrap();
        let after = predict(&right, &case.sensor, &sample, &setting).unwrap().unwrap();
        assert!(after.psnr_db() > before.psnr_db() + 1.0, "{} {}", before.psnr_db(), after.psnr_db());
    }

    #[test]
    fn what_the_solver_cannot_undo_changes_nothing() {
        let case = testing::case();
        assert!(undone(&case, &[(position("vignetting"), 0.3)]).is_none());
    }
}
