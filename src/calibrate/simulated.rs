//! Simulates recordings for the calibration: random scenes and sensors ([`photocurrent_diagnosis::scenes`])
//! with no effect, one, two, or an uncatalogued fault, each of random size down to the detection limit;
//! frames with and without unstated noise.
//!
//! Everything follows from a seed and an index. Uncatalogued faults are made without any effect's code:
//! pixels of two sensors side by side, or stamps shifted by a covariate of their events.

use photocurrent_core::Extent;
use photocurrent_core::random::Random;
use photocurrent_diagnosis::candidates::{CANDIDATES, EffectScales, Signs, Trial};
use photocurrent_diagnosis::covariates::Covariate;
use photocurrent_diagnosis::scenes::SimulatedScene;
use photocurrent_diagnosis::targets::SketchFamily;
use photocurrent_scene::case::{Case, PixelEvent, PixelEvents};
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::target::TargetForm;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The faults of a recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct InjectedFault {
    /// Effects of the catalogue: id, parameter, effect size.
    pub effects: Vec<(String, String, f64)>,
    /// The covariate of an uncatalogued fault.
    pub other: Option<Covariate>,
    /// Frames have noise that is not stated.
    pub is_noisy: bool,
}

/// A recording and its faults.
pub struct SimulatedRecording {
    /// The recording.
    pub case: Case,
    /// The faults.
    pub truth: InjectedFault,
    /// The family of its scene where that is known, and the true place in the ranges of its free parameters,
    /// as shares.
    pub target: Option<(Arc<dyn TargetForm>, Vec<f64>)>,
}

/// Scene model of the diagnosis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SceneModelKind {
    /// Unknown: a picture is fitted.
    #[default]
    Picture,
    /// Unknown, and without a common motion.
    Parts,
    /// Known but for a few parameters: known targets.
    Given,
    /// Unknown, with or without a common motion: the light of each pixel is free.
    Pixels,
    /// Unknown: a picture is fitted to frames and events together.
    Joint,
}

/// Settings of the simulation.
#[derive(Clone, Copy, Debug)]
pub struct SimulationSetting {
    /// What is known of the scenes.
    pub kind: SceneModelKind,
    /// Size of the array.
    pub extent: Extent,
    /// Length, seconds.
    pub duration_s: f64,
    /// Shares of recordings with one effect, with two, and with an uncatalogued fault; the rest has none.
    pub shares: [f64; 3],
    /// Share of recordings whose frames have noise.
    pub noisy: f64,
    /// Effect sizes of effects, from and to; evenly over their logarithm.
    pub effect_sizes: (f64, f64),
}

impl SimulationSetting {
    /// Settings for a scene model: only larger effects are detectable where scenes do not move as one.
    pub fn for_model(kind: SceneModelKind) -> SimulationSetting {
        let usual = SimulationSetting { kind, ..SimulationSetting::default() };
        match kind {
            SceneModelKind::Picture => usual,
            SceneModelKind::Joint => SimulationSetting { noisy: 0.7, effect_sizes: (0.03, 1.0), ..usual },
            SceneModelKind::Parts => SimulationSetting { effect_sizes: (0.2, 2.0), ..usual },
            SceneModelKind::Pixels => SimulationSetting { effect_sizes: (0.1, 1.5), ..usual },
            SceneModelKind::Given => {
                SimulationSetting { extent: Extent { width: 40, height: 30 }, duration_s: 0.1, ..usual }
            }
        }
    }
}

impl Default for SimulationSetting {
    fn default() -> SimulationSetting {
        SimulationSetting {
            kind: SceneModelKind::Picture,
            extent: Extent { width: 64, height: 48 },
            duration_s: 0.12,
            shares: [0.42, 0.12, 0.1],
            noisy: 0.4,
            effect_sizes: (0.06, 1.3),
        }
    }
}

/// Simulates recording number `index` of a seed.
///
/// # Errors
/// When the effects that were drawn cannot be combined.
pub fn simulate_recording(
    seed: u64,
    index: u64,
    setting: &SimulationSetting,
) -> Result<SimulatedRecording, String> {
    let mut random = Random::new(seed, &[index, 0x3a]);
    let noise = (random.uniform() < setting.noisy)
        .then(|| (3.0 + 17.0 * random.uniform(), 1.0 + 2.0 * random.uniform()));
    let (scene, target) = match setting.kind {
        SceneModelKind::Picture | SceneModelKind::Joint => (
            SimulatedScene::new(seed, index, setting.extent, setting.duration_s).with_frame_noise(noise),
            None,
        ),
        SceneModelKind::Parts => (
            SimulatedScene::in_parts(seed, index, setting.extent, setting.duration_s).with_frame_noise(noise),
            None,
        ),
        SceneModelKind::Pixels => (
            SimulatedScene::of_any_kind(seed, index, setting.extent, setting.duration_s)
                .with_frame_noise(noise),
            None,
        ),
        SceneModelKind::Given => {
            let scene = SimulatedScene::target(seed, index, setting.extent, setting.duration_s);
            let (sketches, shares) = SketchFamily::ranges_around(&scene, seed, index);
            (scene, Some((Arc::new(sketches) as Arc<dyn TargetForm>, shares)))
        }
    };
    let mut truth =
        InjectedFault { is_noisy: noise.is_some() && target.is_none(), ..InjectedFault::default() };
    let plain = scene.recording()?;
    let nominal = plain.nominal().map_err(|why| why.to_string())?;
    let scales = EffectScales::from_case(&plain, &nominal);
    let kind = random.uniform();
    let [one, two, other] = setting.shares;
    if kind < other {
        let (case, covariate) = with_uncatalogued_fault(&scene, plain, &nominal, &scales, &mut random)?;
        truth.other = Some(covariate);
        return Ok(SimulatedRecording { case, truth, target });
    }
    let count = if kind < other + two { 2 } else { usize::from(kind < other + two + one) };
    let mut trial = Trial::nominal(&nominal);
    let choice: Vec<usize> = (0..CANDIDATES.len()).filter(|&n| CANDIDATES[n].sought.is_made).collect();
    while truth.effects.len() < count {
        let candidate = &CANDIDATES[choice[(random.uniform() * choice.len() as f64) as usize % choice.len()]];
        let (from, to) = setting.effect_sizes;
        let size = from * libm::pow(to / from, random.uniform());
        let effect_size = if candidate.signs == Signs::Both && random.uniform() < 0.5 { -size } else { size };
        if truth.effects.iter().all(|(id, ..)| *id != candidate.id) {
            candidate.apply(&mut trial, effect_size, &scales);
            truth.effects.push((candidate.id.to_owned(), candidate.parameter.to_owned(), effect_size));
        }
    }
    let case = if count == 0 { plain } else { scene.recording_through(Some(&trial))? };
    Ok(SimulatedRecording { case, truth, target })
}

/// Covariates of uncatalogued stamp faults.
const OF_STAMPS: [Covariate; 4] = [
    Covariate::RowParity,
    Covariate::ColumnBlock,
    Covariate::PreviousPolarity,
    Covariate::TimeSinceLastEvent,
];
/// And thresholds.
const OF_PIXELS: [Covariate; 3] = [Covariate::RowParity, Covariate::ColumnBlock, Covariate::Radius];

fn with_uncatalogued_fault(
    scene: &SimulatedScene,
    plain: Case,
    nominal: &Nominal,
    scales: &EffectScales,
    random: &mut Random,
) -> Result<(Case, Covariate), String> {
    let (width, height) = (plain.extent.width, plain.extent.height);
    let is_other = move |covariate: Covariate, x: u32, y: u32| match covariate {
        Covariate::ColumnBlock => (8 * x / width) % 2 == 1,
        Covariate::Radius => {
            let off = |at: u32, size: u32| f64::from(at) - 0.5 * f64::from(size - 1);
            // A ring in the middle: no effect of the catalogue rises and falls again.
            let radius =
                libm::hypot(off(x, width), off(y, height)) / libm::hypot(off(0, width), off(0, height));
            (0.3..0.6).contains(&radius)
        }
        _ => y % 2 == 1,
    };
    if random.uniform() < 0.5 {
        let covariate = OF_PIXELS[(random.uniform() * OF_PIXELS.len() as f64) as usize % OF_PIXELS.len()];
        let mut trial = Trial::nominal(nominal);
        let factor = 1.0 + (0.04 + 0.2 * random.uniform()) * if random.uniform() < 0.5 { -1.0 } else { 1.0 };
        trial.nominal.pixel.threshold_on *= factor;
        trial.nominal.pixel.threshold_off *= factor;
        let second = scene.recording_through(Some(&trial))?;
        let of = |pixel: usize| {
            let (x, y) = plain.pixel_place(pixel);
            if is_other(covariate, x, y) {
                second.events.of_pixel(pixel).to_vec()
            } else {
                plain.events.of_pixel(pixel).to_vec()
            }
        };
        let events = PixelEvents::new((0..plain.events.pixels()).map(of));
        return Ok((Case { events, ..plain }, covariate));
    }
    let covariate = OF_STAMPS[(random.uniform() * OF_STAMPS.len() as f64) as usize % OF_STAMPS.len()];
    let delay_ns = (60e3 + 400e3 * random.uniform()) as i64;
    let usual_ns = (0.3e9 / f64::max(scales.rate_hz / f64::from(width * height), 1.0)) as i64;
    let of = |pixel: usize| -> Vec<PixelEvent> {
        let (x, y) = plain.pixel_place(pixel);
        let events = plain.events.of_pixel(pixel);
        let late = |k: usize| {
            let before = k.checked_sub(1).map(|k| &events[k]);
            match covariate {
                Covariate::PreviousPolarity => {
                    before.is_some_and(|before| before.polarity != events[k].polarity)
                }
                Covariate::TimeSinceLastEvent => {
                    before.is_some_and(|before| events[k].t_in_ns - before.t_in_ns < usual_ns)
                }
                _ => is_other(covariate, x, y),
            }
        };
        let moved = |k: usize| {
            let by = if late(k) { delay_ns } else { 0 };
            PixelEvent { t_in_ns: events[k].t_in_ns + by, t_off_ns: events[k].t_off_ns + by, ..events[k] }
        };
        (0..events.len()).map(moved).filter(|event| event.t_off_ns < plain.span.1).collect()
    };
    let events = PixelEvents::new((0..plain.events.pixels()).map(of));
    Ok((Case { events, ..plain }, covariate))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_makes_one_recording_and_all_kinds_are_made() {
        let setting = SimulationSetting {
            extent: Extent { width: 24, height: 16 },
            duration_s: 0.05,
            ..SimulationSetting::default()
        };
        let truths: Vec<InjectedFault> =
            (0..24).filter_map(|index| Some(simulate_recording(3, index, &setting).ok()?.truth)).collect();
        assert!(truths.len() > 20);
        assert!(truths.iter().any(|one| one.other.is_some()));
        assert!(
            (0..3).all(|count| truths.iter().any(|one| one.other.is_none() && one.effects.len() == count)),
            "{truths:?}"
        );
        let (a, b) =
            (simulate_recording(3, 5, &setting).unwrap(), simulate_recording(3, 5, &setting).unwrap());
        assert_eq!((a.case.events, a.truth), (b.case.events, b.truth));
    }
}
