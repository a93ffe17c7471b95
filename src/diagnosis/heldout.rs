//! Predicts held-out frames from events and the other frames, with the nominal and with the fitted
//! description.
//!
//! Every third frame is held out. The photocurrent is estimated from the rest by the solver and with the
//! options of `solve/map` ([`photocurrent_solve::solve_pixels`]), effects undone. The camera model then
//! predicts the held-out frames from it.
//!
//! Limit: where effects mix the light of neighbours or couple all pixels, the rows around the sample are
//! solved as well. That takes as long as a solution of the whole recording.

use crate::curves::LogLightCurves;
use crate::sample::PixelSample;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{NodeError, Sensor};
use photocurrent_scene::case::Case;
use photocurrent_sensor::conditional::{Conditional, Look, Track, frame_values};
use photocurrent_sensor::effects::from_description;
use photocurrent_sensor::map::MapFrame;
use photocurrent_sensor::undo::Undo;
use photocurrent_solve::{Recording, SolveOptions, solve_pixels};

/// Of each three frames this one is held out.
const KEPT: usize = 1;
/// The longest step of light in a prediction, ns.
const STEP_NS: i64 = 500_000;

/// Prediction error of held-out frames.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HeldOutScore {
    /// Mean square error, DN squared.
    pub square_error: f64,
    /// Peak for a signal-to-noise ratio, DN: saturation, or the largest value.
    pub peak_dn: f64,
    /// Root mean square error by pixel of the sample, as a share of the pixel's mean; NaN where nothing was
    /// predicted.
    pub by_pixel: Vec<f64>,
    /// Root mean square error by held-out frame: its number, DN.
    pub by_frame: Vec<(usize, f64)>,
    /// The light it was predicted from.
    pub light: LogLightCurves,
}

impl HeldOutScore {
    /// Peak signal-to-noise ratio, dB.
    pub fn psnr_db(&self) -> f64 {
        10.0 * libm::log10(self.peak_dn * self.peak_dn / f64::max(self.square_error, 1e-12))
    }
}

/// Predicts every third frame with a description, its `[effects]` undone where the light is estimated
/// ([`photocurrent_sensor::undo`]) and applied again where frames are read; none with
/// fewer than five frames, or when nothing can be predicted.
///
/// # Errors
/// When the description does not state what the model needs, or its effects are not understood.
pub(crate) fn predict(
    case: &Case,
    sensor: &Sensor,
    sample: &PixelSample,
    options: &SolveOptions,
) -> Result<Option<HeldOutScore>, NodeError> {
    let nominal = case.described(sensor)?;
    let undo = Undo::new(from_description(&sensor.effects).map_err(NodeError::usage)?);
    let Some(frames) = &case.frames else { return Ok(None) };
    let Some((rest, kept)) = hold_out(case) else { return Ok(None) };
    let light = estimate(&rest, sensor, sample, options)?;
    let mut by_pixel = vec![f64::NAN; sample.len()];
    let mut by_frame = vec![(0.0, 0.0); kept.len()];
    let (mut sum, mut count, mut largest) = (0.0, 0.0, 0.0_f64);
    let mut read = Conditional::default();
    for (n, &pixel) in sample.pixels.iter().enumerate().filter(|(n, _)| light.is_known[*n]) {
        let (_, y) = case.pixel_place(pixel as usize);
        let (t_ns, log_light) = light.pixel(n);
        let track = Track::new(t_ns, log_light, STEP_NS);
        let stated = |l: usize| {
            let exposure = frames.times.exposure(l, y);
            MapFrame {
                start_ns: exposure.start.0,
                end_ns: exposure.end.0,
                dn: 0.0,
                sigma_dn: 1.0,
                saturated: false,
            }
        };
        let all: Vec<MapFrame> = (0..case.frame_count()).map(stated).collect();
        let look = Look {
            site: case.site(pixel as usize, 0),
            track: &track,
            seen: None,
            events: &[],
            frames: &all,
            quiet_ns: &[],
        };
        frame_values(&nominal, undo.known(), &look, &mut read);
        let (mut own, mut values, mut level) = (0.0, 0.0, 0.0);
        for (slot, &frame) in kept.iter().enumerate() {
            let dn = case.dn(frame, pixel as usize);
            if !dn.is_finite() || dn >= nominal.saturation_dn {
                continue;
            }
            let off = read.dn[frame].min(nominal.saturation_dn) - dn;
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
    let by_frame = kept
        .iter()
        .zip(by_frame)
        .filter(|(_, (_, count))| *count > 0.0)
        .map(|(frame, (sum, count))| (*frame, libm::sqrt(sum / count)))
        .collect();
    Ok(Some(HeldOutScore { square_error: sum / count, peak_dn, by_pixel, by_frame, light }))
}

/// The light of the pixels as `solve/map` estimates it, effects undone.
fn estimate(
    case: &Case,
    sensor: &Sensor,
    sample: &PixelSample,
    options: &SolveOptions,
) -> Result<LogLightCurves, NodeError> {
    let (events, Some(frames)) = case.streams() else { return Ok(LogLightCurves::default()) };
    let sensor = with_defaults(sensor);
    let recording = Recording { events: &events, frames: &frames, sensor: &sensor };
    // Standard deviations do not enter a prediction.
    let options = SolveOptions { sigma: false, ..*options };
    let tracks = solve_pixels(&recording, &options, &sample.pixels, &())?;
    Ok(LogLightCurves::from_pixels(tracks.into_iter().map(|track| {
        if track.t_ns.is_empty() {
            return (vec![case.span.0], vec![0.0], false);
        }
        let log_light =
            track.photocurrent.iter().map(|i| libm::log(f64::max(*i, f64::MIN_POSITIVE))).collect();
        (track.t_ns, log_light, true)
    })))
}

/// The description with 0 for time constants and refractory period that it does not state.
fn with_defaults(sensor: &Sensor) -> Sensor {
    let zero = Duration::new(0);
    let mut sensor = sensor.clone();
    let fields = [&mut sensor.front_end.tau_0, &mut sensor.front_end.alpha, &mut sensor.readout.refractory];
    fields.into_iter().for_each(|field| *field = field.or(Some(zero)));
    sensor
}

/// A recording without every third frame, and which of them are predicted: not the last one, which has no
/// frame after it. None with fewer than five frames.
pub(crate) fn hold_out(case: &Case) -> Option<(Case, Vec<usize>)> {
    let count = case.frame_count();
    if count < 5 {
        return None;
    }
    let frames = case.frames.as_ref().map(|frames| frames.without_frames((KEPT..count).step_by(3)));
    let rest = Case { frames, events: case.events.clone(), sensor: case.sensor.clone(), ..*case };
    Some((rest, (KEPT..count - 1).step_by(3).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::EffectParameters;
    use crate::testing;

    #[test]
    fn a_description_that_states_its_effects_predicts_held_out_frames_better() {
        // About two thirds of what a run gained. The noise of events is chosen for each description, which
        // excuses a wrong one in part: with noise fixed at 3 % of the threshold the same effects gained 2 to
        // 10 dB.
        for (id, parameters, gain_db) in [
            ("clock_offset", serde_json::json!({"offset": "-700 us"}), 8.0),
            ("second_pole", serde_json::json!({"tau": "2 ms"}), 5.0),
            ("leak_events", serde_json::json!({"rate": "40 Hz"}), 0.5),
            ("threshold_scale", serde_json::json!({"fraction": 0.3}), 1.0),
            ("exposure_time", serde_json::json!({"difference": "1 ms"}), 6.0),
            // 0.7 to 1.7 dB with 13 to 18 frames. It was above 3 dB before the simulator took longer steps;
            // why it gains less is not known (120 pixels choose noise and prior).
            ("image_lag", serde_json::json!({"fraction": 0.2}), 0.8),
        ] {
            let effects: EffectParameters =
                [(id.to_owned(), parameters.as_object().unwrap().clone())].into_iter().collect();
            let case = testing::case_of(16, &effects);
            let sample = PixelSample::every_pixel(&case, 4);
            let options = SolveOptions::default();
            let before = predict(&case, &case.sensor, &sample, &options).unwrap().unwrap();
            let right = Sensor { effects, ..case.sensor.clone() };
            let after = predict(&case, &right, &sample, &options).unwrap().unwrap();
            assert!(
                after.psnr_db() > before.psnr_db() + gain_db,
                "{id}: {} {}",
                before.psnr_db(),
                after.psnr_db()
            );
        }
    }

    #[test]
    fn a_description_without_a_front_end_and_a_blind_time_predicts_as_one_that_states_0() {
        let case = testing::case();
        let sample = PixelSample::every_pixel(&case, 4);
        let predicted = |of: Option<Duration>| {
            let mut sensor = case.sensor.clone();
            (sensor.front_end.tau_0, sensor.front_end.alpha, sensor.readout.refractory) = (of, of, of);
            predict(&case, &sensor, &sample, &SolveOptions::default()).unwrap().unwrap()
        };
        let (absent, zero) = (predicted(None), predicted(Some(Duration::new(0))));
        assert_eq!((absent.square_error, absent.light), (zero.square_error, zero.light));
    }
}
