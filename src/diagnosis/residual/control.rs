//! The control: the nominal sensor simulated on the fitted scene, with the estimated frame noise. What an
//! effect gains on it is no evidence.

use crate::curves::LogLightCurves;
use crate::record::{EffectParameters, SimulatedConditions, record};
use crate::sample::PixelSample;
use photocurrent_core::random::Random;
use photocurrent_scene::Scene;
use photocurrent_scene::case::{Case, CaseFrames, PixelEvents};
use photocurrent_scene::light::LogLight;
use photocurrent_scene::nominal::Nominal;
use photocurrent_sensor::elementary;
use rayon::prelude::*;

/// The scene of a control: its light, and its frames without noise.
pub(super) struct ControlScene {
    /// Log photocurrent.
    pub light: LogLight,
    /// Frames, DN as [frame][y][x]; NaN where the scene does not reach.
    pub frames: Vec<f32>,
}

/// Least share of light that the correction leaves.
const LEAST_LEFT: f64 = 0.3;

impl ControlScene {
    /// From the light of the fitted scene.
    pub(super) fn from_light(case: &Case, nominal: &Nominal, light: LogLight) -> ControlScene {
        ControlScene { frames: light.frames(case, nominal), light }
    }

    /// A scene whose fit equals the fitted one, to first order: it contains what the fit removes, and a
    /// posterior sample of what frames leave open.
    ///
    /// A fit of frames of the scene s gives f(s) = s + b(s). With r a rough scene around s' = f(s), the fit
    /// of s' + a (r - f(r)) is s' where b changes little between the two. The factor a, 0 to 1, is the share
    /// of the pattern lost from frames of r that is in the frame residuals. `light`: of s'.
    ///
    /// # Errors
    /// When frames cannot be fitted.
    pub(super) fn looking_like(
        case: &Case,
        nominal: &Nominal,
        source: &dyn Scene,
        light: &LogLight,
        seed: u64,
    ) -> Result<ControlScene, String> {
        let Some(sample) = source.posterior_sample(case, nominal, seed)? else {
            return Ok(ControlScene { light: light.clone(), frames: source.frames(case) });
        };
        let of_sample = sample.light(case, light.step_ns);
        if source.is_known() {
            return Ok(ControlScene { light: of_sample, frames: sample.frames(case) });
        }
        let rough = ControlScene::from_light(case, nominal, of_sample);
        let frames = with_noise(case, nominal, source, &rough.frames, seed.wrapping_add(1));
        let events = PixelEvents::new(std::iter::repeat_n(Vec::new(), case.extent.pixels()));
        let again = Case { frames, events, sensor: case.sensor.clone(), ..*case };
        let fitted = source.refit(&again, nominal)?;
        let lost =
            rough.frames.iter().zip(fitted.frames(&again)).map(|(rough, fitted)| f64::from(rough - fitted));
        let share = share_of(lost, source.residual().iter().map(|left| f64::from(*left)));
        let fitted = fitted.light(case, light.step_ns);
        let log =
            rough.light.log.par_iter().zip(&light.log).zip(&fitted.log).map(|((rough, plain), fitted)| {
                if rough.len() != plain.len() || rough.len() != fitted.len() {
                    return rough.clone();
                }
                let of = |((rough, plain), fitted): ((&f32, &f32), &f32)| {
                    let [rough, plain, fitted] =
                        [rough, plain, fitted].map(|log| elementary::exp(f64::from(*log)));
                    elementary::ln(f64::max(plain + share * (rough - fitted), LEAST_LEFT * plain)) as f32
                };
                rough.iter().zip(plain).zip(fitted).map(of).collect()
            });
        let log = log.collect();
        Ok(ControlScene::from_light(case, nominal, LogLight { log, ..rough.light }))
    }
}

/// Least-squares amplitude of a pattern in values, 0 to 1. Pairs that are not finite are left out. Noise in
/// the pattern lowers it.
fn share_of(pattern: impl Iterator<Item = f64>, values: impl Iterator<Item = f64>) -> f64 {
    let pairs = pattern.zip(values).filter(|(a, b)| a.is_finite() && b.is_finite());
    let (of_both, of_pattern) = pairs.fold((0.0, 0.0), |sum, (a, b)| (sum.0 + a * b, sum.1 + a * a));
    if of_pattern > 0.0 { (of_both / of_pattern).clamp(0.0, 1.0) } else { 0.0 }
}

/// Frames of a scene with the noise that was found.
fn with_noise(
    case: &Case,
    nominal: &Nominal,
    source: &dyn Scene,
    frames: &[f32],
    seed: u64,
) -> Option<CaseFrames> {
    let mut random = Random::new(seed, &[0xc0]);
    let noisy = |dn: &f32| {
        let sigma = source.sigma(nominal, f64::from(*dn) - nominal.number.black_level);
        f64::min(f64::from(*dn) + sigma * random.normal(), nominal.saturation_dn) as f32
    };
    let dn = frames.iter().map(noisy).collect();
    case.frames.as_ref().map(|frames| CaseFrames::new(frames.times.clone(), dn))
}

/// The nominal sensor's recording of a scene: events of `pixels` (rising), and all frames with the noise that
/// was found.
///
/// # Errors
/// When the description's effects cannot be combined.
pub(super) fn control(
    case: &Case,
    nominal: &Nominal,
    source: &dyn Scene,
    behind: &ControlScene,
    pixels: &[u32],
    block: usize,
    seed: u64,
) -> Result<Case, String> {
    let sample = PixelSample::from_pixels(case, pixels.to_vec(), block as u32);
    let light = &behind.light;
    let scene = LogLightCurves::from_pixels(sample.pixels.iter().map(|&pixel| {
        let log = &light.log[pixel as usize];
        let known = !log.is_empty();
        let t: Vec<i64> =
            if known { (0..log.len()).map(|k| light.instant(k)).collect() } else { vec![case.span.0] };
        (t, if known { log.iter().map(|u| f64::from(*u)).collect() } else { vec![0.0] }, known)
    }));
    let conditions = SimulatedConditions { seed, frame_share: 0.0, frame_dn: 0.0, is_mixed: false };
    let recorded = record(case, nominal, &sample, &scene, &EffectParameters::new(), &conditions)?;
    let frames = with_noise(case, nominal, source, &behind.frames, seed);
    Ok(Case { frames, ..recorded })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::evidence::EvidenceSetting;
    use crate::residual::ranking::evidence;
    use crate::scenes::SimulatedScene;
    use photocurrent_core::Extent;
    use photocurrent_scene::mosaic::{PatchSetting, scene};
    use photocurrent_scene::picture::PictureSetting;

    #[test]
    fn a_pattern_is_found_in_noise_with_its_share() {
        let mut random = Random::new(2, &[]);
        let pattern: Vec<f64> = (0..4000).map(|_| random.normal()).collect();
        let values: Vec<f64> = pattern.iter().map(|x| 0.3 * x + 2.0 * random.normal()).collect();
        // Standard error: 2 over the root of 4000.
        assert!((share_of(pattern.iter().copied(), values.iter().copied()) - 0.3).abs() < 0.1);
        assert_eq!(share_of(pattern.iter().map(|x| -x), values.iter().copied()), 0.0);
        assert_eq!(share_of([f64::NAN, 0.0].into_iter(), [1.0, 2.0].into_iter()), 0.0);
    }

    #[test]
    fn a_control_misses_its_thresholds_as_far_as_a_sharp_scene_does() {
        // A fan whose blades have edges sharper than the picture's grid, and nothing wrong with its sensor.
        let fan = SimulatedScene::in_parts(7, 34, Extent { width: 64, height: 48 }, 0.12);
        assert_eq!(fan.sketch.name(), "fan");
        let case = fan.recording().unwrap();
        let nominal = case.nominal().unwrap();
        let ratio = |sharpest: f64| {
            let source = scene(
                &case,
                &nominal,
                &PictureSetting { sharpest, ..PictureSetting::default() },
                &PatchSetting::default(),
            )
            .unwrap();
            let found = evidence(&case, &nominal, source.as_ref(), &EvidenceSetting::default()).unwrap();
            found.control_median / found.median
        };
        // How sharp edges are follows from the frames to a factor of two or three; the picture as it is does
        // not constrain it.
        let (sharp, soft) = (ratio(PictureSetting::default().sharpest), ratio(0.0));
        assert!(
            (0.3..3.0).contains(&sharp) && soft < 0.5 * sharp,
            "the control misses by {sharp} of what the recording does, on the picture by {soft}"
        );
    }
}
