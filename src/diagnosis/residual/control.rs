//! What the method finds where nothing is: the nominal sensor on the fitted scene, its frames with the noise that was found.

use super::light::Light;
use super::source::Source;
use crate::case::{Case, CaseFrames};
use crate::nominal::Nominal;
use crate::record::{Conditions, Described, record};
use crate::sample::Sample;
use crate::scene::Scene;
use photocurrent_core::random::Random;

/// The nominal sensor's recording of a scene: events of `pixels` (rising), and all frames with the noise that was found.
///
/// # Errors
/// When the description's effects cannot be combined.
pub fn control(case: &Case, nominal: &Nominal, source: &dyn Source, light: &Light, pixels: &[u32], block: usize, seed: u64) -> Result<Case, String> {
    let sample = Sample::of_pixels(case, pixels.to_vec(), block as u32);
    let scene = Scene::from_pixels(sample.pixels.iter().map(|&pixel| {
        let log = &light.log[pixel as usize];
        let known = !log.is_empty();
        let t: Vec<i64> = if known { (0..log.len()).map(|k| light.instant(k)).collect() } else { vec![case.span.0] };
        (t, if known { log.iter().map(|u| f64::from(*u)).collect() } else { vec![0.0] }, known)
    }));
    let conditions = Conditions { seed, frame_share: 0.0, frame_dn: 0.0, is_mixed: false };
    let recorded = record(case, nominal, &sample, &scene, &Described::new(), &conditions)?;
    let mut random = Random::new(seed, &[0xc0]);
    let noisy = |dn: &f32| {
        let sigma = source.sigma(nominal, f64::from(*dn) - nominal.number.black_level);
        f64::min(f64::from(*dn) + sigma * random.normal(), nominal.saturation_dn) as f32
    };
    let dn = source.frames(case).iter().map(noisy).collect();
    let frames = case.frames.as_ref().map(|frames| CaseFrames { times: frames.times.clone(), dn });
    Ok(Case { frames, ..recorded })
}
