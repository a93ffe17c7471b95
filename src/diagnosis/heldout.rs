//! Frames that are held out, predicted from the events and the other frames, with the nominal description and with the fitted one.
//!
//! Every third frame is held out, the light is estimated from what is left as `solve/map` does with the description, effects undone, and the held-out frames are what the camera would
//! read of it.
//!
//! Limit: the light of the sample's pixels alone is estimated, so effects that mix that of neighbours are not undone here.

use crate::case::Case;
use crate::nominal::Nominal;
use crate::sample::Sample;
use crate::scene::{Given, Scene, SceneSetting, pixel_data, task};
use photocurrent_core::{NodeError, Sensor};
use photocurrent_sensor::conditional::{Conditional, Look, Track, frame_values};
use photocurrent_sensor::effects::from_description;
use photocurrent_sensor::map::MapFrame;
use photocurrent_sensor::undo::{Estimate, Known, Memory, Undo};

/// Of each three frames this one is held out.
const KEPT: usize = 1;
/// Light is estimated again so often with what effects did to events.
const ROUNDS: usize = 2;
/// The longest step of light in a prediction, ns.
const STEP_NS: i64 = 500_000;

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

/// Predicts every third frame with a description, its `[effects]` undone where the light is estimated ([`photocurrent_sensor::undo`]) and applied again where frames are read; none with
/// fewer than five frames, or when nothing can be predicted.
///
/// # Errors
/// When the description does not state what the model needs, or its effects are not understood.
pub fn predict(case: &Case, sensor: &Sensor, sample: &Sample, setting: &SceneSetting) -> Result<Option<Prediction>, NodeError> {
    let nominal = case.described(sensor)?;
    let mut undo = Undo::new(from_description(&sensor.effects).map_err(NodeError::usage)?);
    if undo.couples().is_some() {
        let of_pixel = |pixel: usize| pixel_data(case, &nominal, setting, pixel).0.into_iter().map(move |event| (case.site(pixel, 0), event));
        undo.inform((0..case.events.pixels()).flat_map(of_pixel));
    }
    let Some(frames) = &case.frames else { return Ok(None) };
    let Some((rest, kept)) = hold_out(case) else { return Ok(None) };
    let scene = estimate(&rest, &nominal, &undo, sample, setting);
    let mut by_pixel = vec![f64::NAN; sample.len()];
    let mut by_frame = vec![(0.0, 0.0); kept.len()];
    let (mut sum, mut count, mut largest) = (0.0, 0.0, 0.0_f64);
    let mut read = Conditional::default();
    for (n, &pixel) in sample.pixels.iter().enumerate().filter(|(n, _)| scene.is_known[*n]) {
        let (_, y) = case.place(pixel as usize);
        let (t_ns, log_light) = scene.pixel(n);
        let track = Track::new(t_ns, log_light, STEP_NS);
        let stated = |l: usize| {
            let exposure = frames.times.exposure(l, y);
            MapFrame { start_ns: exposure.start.0, end_ns: exposure.end.0, dn: 0.0, sigma_dn: 1.0, saturated: false }
        };
        let all: Vec<MapFrame> = (0..case.frame_count()).map(stated).collect();
        let look = Look { site: case.site(pixel as usize, 0), track: &track, seen: None, events: &[], frames: &all };
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
    let by_frame = kept.iter().zip(by_frame).filter(|(_, (_, count))| *count > 0.0).map(|(frame, (sum, count))| (*frame, libm::sqrt(sum / count))).collect();
    Ok(Some(Prediction { square_error: sum / count, peak_dn, by_pixel, by_frame, scene }))
}

/// The light of the pixels, effects undone.
fn estimate(case: &Case, nominal: &Nominal, undo: &Undo, sample: &Sample, setting: &SceneSetting) -> Scene {
    let priors = vec![setting.options.prior; sample.len()];
    let recorded = |n: usize| pixel_data(case, nominal, setting, sample.pixels[n] as usize);
    let first = |n: usize| {
        let site = case.site(sample.pixels[n] as usize, 0);
        let (mut events, mut frames) = recorded(n);
        events.iter_mut().for_each(|event| *event = undo.event(&site, event));
        undo.frames(nominal, &site, &mut frames);
        frames.iter_mut().for_each(|frame| undo.raise(nominal, frame));
        Given { data: (events, frames), sensor: nominal.map_sensor(), beyond: Vec::new() }
    };
    let solve = |given: &(dyn Fn(usize) -> Given + Sync)| {
        Scene::estimate_from(sample, &priors, given, |given| task(case, setting, &given.data, given.sensor, &given.beyond), case.span.0)
    };
    let mut scene = solve(&first);
    for _ in 0..if undo.needs_light() { ROUNDS } else { 0 } {
        let again = |n: usize| {
            let mut given = first(n);
            if scene.is_known[n] {
                let (mut known, site) = (Known::default(), case.site(sample.pixels[n] as usize, 0));
                let (t_ns, own) = scene.pixel(n);
                let light = Estimate { t_ns, own, seen: None };
                undo.at_light(nominal, &site, light, &recorded(n).0, &given.data.0, &mut known, &mut Memory::default());
                (given.data.0, given.beyond) = (known.events, known.beyond);
            }
            given
        };
        scene = solve(&again);
    }
    scene.log_light.iter_mut().for_each(|log| *log = undo.own(*log));
    scene
}

/// A recording without every third frame, and which of them are predicted: not the last one, which has no frame after it. None with fewer than five frames.
pub fn hold_out(case: &Case) -> Option<(Case, Vec<usize>)> {
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
    use crate::record::Described;
    use crate::testing;

    #[test]
    fn a_description_that_states_its_effects_predicts_kept_frames_better() {
        for (id, parameters, gain_db) in [
            ("clock_offset", serde_json::json!({"offset": "-700 us"}), 10.0),
            ("second_pole", serde_json::json!({"tau": "2 ms"}), 10.0),
            ("leak_events", serde_json::json!({"rate": "40 Hz"}), 2.0),
            ("threshold_scale", serde_json::json!({"fraction": 0.3}), 5.0),
            ("exposure_time", serde_json::json!({"difference": "1 ms"}), 8.0),
            ("image_lag", serde_json::json!({"fraction": 0.2}), 5.0),
        ] {
            let effects: Described = [(id.to_owned(), parameters.as_object().unwrap().clone())].into_iter().collect();
            let case = testing::case_with(&effects);
            let sample = Sample::all(&case, 4);
            let setting = SceneSetting::default();
            let before = predict(&case, &case.sensor, &sample, &setting).unwrap().unwrap();
            let right = Sensor { effects, ..case.sensor.clone() };
            let after = predict(&case, &right, &sample, &setting).unwrap().unwrap();
            assert!(after.psnr_db() > before.psnr_db() + gain_db, "{id}: {} {}", before.psnr_db(), after.psnr_db());
        }
    }
}
