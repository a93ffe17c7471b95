//! Recordings that a decision is calibrated on: simulated scenes and sensors
//! ([`photocurrent_diagnosis::scenes`]) with nothing, one effect, two, or what is in no catalogue, each of
//! random size down to what hardly shows; frames with and without noise that nobody stated.
//!
//! Everything follows from a seed and a number. What is in no catalogue is made without any effect's code:
//! pixels of two sensors side by side, or stamps moved by what their events depend on.

use photocurrent_core::Extent;
use photocurrent_core::random::Random;
use photocurrent_diagnosis::candidates::{CANDIDATES, Scales, Signs, Trial};
use photocurrent_diagnosis::covariates::Covariate;
use photocurrent_diagnosis::scenes::MadeUp;
use photocurrent_diagnosis::targets::Sketches;
use photocurrent_scene::case::{Case, PixelEvent, PixelEvents};
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::target::Form;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What is wrong with a recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Fault {
    /// Effects of the catalogue: id, parameter, effect size.
    pub effects: Vec<(String, String, f64)>,
    /// What is in no catalogue: the covariate it depends on.
    pub other: Option<Covariate>,
    /// Frames have noise that is not stated.
    pub is_noisy: bool,
}

/// A recording and what is wrong with it.
pub struct Made {
    /// The recording.
    pub case: Case,
    /// What is wrong.
    pub truth: Fault,
    /// What is known of its scene, and where in the ranges of what is free of it the scene is, as shares;
    /// none where nothing is known.
    pub target: Option<(Arc<dyn Form>, Vec<f64>)>,
}

/// What is known of the scenes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kind {
    /// Nothing: a picture is fitted.
    #[default]
    Picture,
    /// Nothing, and they do not move as one.
    Parts,
    /// All but a few numbers: known targets.
    Given,
    /// Nothing, whether they move as one or not: the light of each pixel is free.
    Pixels,
    /// Nothing: a picture is fitted to frames and events together.
    Joint,
}

/// How recordings are made.
#[derive(Clone, Copy, Debug)]
pub struct MadeSetting {
    /// What is known of the scenes.
    pub kind: Kind,
    /// Size of the array.
    pub extent: Extent,
    /// Length, seconds.
    pub duration_s: f64,
    /// Shares with one effect, with two, and with what is in no catalogue; the rest has none.
    pub shares: [f64; 3],
    /// Share of recordings whose frames have noise.
    pub noisy: f64,
    /// Effect sizes of effects, from and to; evenly over their logarithm.
    pub effect_sizes: (f64, f64),
}

impl MadeSetting {
    /// How recordings of a kind of scene are made: only stronger effects show where scenes do not move as
    /// one.
    pub fn of(kind: Kind) -> MadeSetting {
        let usual = MadeSetting { kind, ..MadeSetting::default() };
        match kind {
            Kind::Picture => usual,
            Kind::Joint => MadeSetting { noisy: 0.7, effect_sizes: (0.03, 1.0), ..usual },
            Kind::Parts => MadeSetting { effect_sizes: (0.2, 2.0), ..usual },
            Kind::Pixels => MadeSetting { effect_sizes: (0.1, 1.5), ..usual },
            Kind::Given => MadeSetting { extent: Extent { width: 40, height: 30 }, duration_s: 0.1, ..usual },
        }
    }
}

impl Default for MadeSetting {
    fn default() -> MadeSetting {
        MadeSetting {
            kind: Kind::Picture,
            extent: Extent { width: 64, height: 48 },
            duration_s: 0.12,
            shares: [0.42, 0.12, 0.1],
            noisy: 0.4,
            effect_sizes: (0.06, 1.3),
        }
    }
}

/// Recording number `index` of a seed.
///
/// # Errors
/// When the effects that were drawn cannot be combined.
pub fn made(seed: u64, index: u64, setting: &MadeSetting) -> Result<Made, String> {
    let mut random = Random::new(seed, &[index, 0x3a]);
    let noise = (random.uniform() < setting.noisy)
        .then(|| (3.0 + 17.0 * random.uniform(), 1.0 + 2.0 * random.uniform()));
    let (scene, target) = match setting.kind {
        Kind::Picture | Kind::Joint => {
            (MadeUp::new(seed, index, setting.extent, setting.duration_s).with_frame_noise(noise), None)
        }
        Kind::Parts => {
            (MadeUp::in_parts(seed, index, setting.extent, setting.duration_s).with_frame_noise(noise), None)
        }
        Kind::Pixels => {
            (MadeUp::of_any(seed, index, setting.extent, setting.duration_s).with_frame_noise(noise), None)
        }
        Kind::Given => {
            let scene = MadeUp::target(seed, index, setting.extent, setting.duration_s);
            let (sketches, shares) = Sketches::around(&scene, seed, index);
            (scene, Some((Arc::new(sketches) as Arc<dyn Form>, shares)))
        }
    };
    let mut truth = Fault { is_noisy: noise.is_some() && target.is_none(), ..Fault::default() };
    let plain = scene.recording()?;
    let nominal = plain.nominal().map_err(|why| why.to_string())?;
    let scales = Scales::of(&plain, &nominal);
    let kind = random.uniform();
    let [one, two, other] = setting.shares;
    if kind < other {
        let (case, covariate) = outside(&scene, plain, &nominal, &scales, &mut random)?;
        truth.other = Some(covariate);
        return Ok(Made { case, truth, target });
    }
    let count = if kind < other + two { 2 } else { usize::from(kind < other + two + one) };
    let mut trial = Trial::stated(&nominal);
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
    Ok(Made { case, truth, target })
}

/// What stamps of what is in no catalogue may depend on.
const OF_STAMPS: [Covariate; 4] = [
    Covariate::RowParity,
    Covariate::ColumnBlock,
    Covariate::PreviousPolarity,
    Covariate::TimeSinceLastEvent,
];
/// And thresholds.
const OF_PIXELS: [Covariate; 3] = [Covariate::RowParity, Covariate::ColumnBlock, Covariate::Radius];

fn outside(
    scene: &MadeUp,
    plain: Case,
    nominal: &Nominal,
    scales: &Scales,
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
        let mut trial = Trial::stated(nominal);
        let factor = 1.0 + (0.04 + 0.2 * random.uniform()) * if random.uniform() < 0.5 { -1.0 } else { 1.0 };
        trial.nominal.pixel.threshold_on *= factor;
        trial.nominal.pixel.threshold_off *= factor;
        let second = scene.recording_through(Some(&trial))?;
        let of = |pixel: usize| {
            let (x, y) = plain.place(pixel);
            if is_other(covariate, x, y) {
                second.events.of(pixel).to_vec()
            } else {
                plain.events.of(pixel).to_vec()
            }
        };
        let events = PixelEvents::new((0..plain.events.pixels()).map(of));
        return Ok((Case { events, ..plain }, covariate));
    }
    let covariate = OF_STAMPS[(random.uniform() * OF_STAMPS.len() as f64) as usize % OF_STAMPS.len()];
    let delay_ns = (60e3 + 400e3 * random.uniform()) as i64;
    let usual_ns = (0.3e9 / f64::max(scales.rate_hz / f64::from(width * height), 1.0)) as i64;
    let of = |pixel: usize| -> Vec<PixelEvent> {
        let (x, y) = plain.place(pixel);
        let events = plain.events.of(pixel);
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
        let setting = MadeSetting {
            extent: Extent { width: 24, height: 16 },
            duration_s: 0.05,
            ..MadeSetting::default()
        };
        let truths: Vec<Fault> =
            (0..24).filter_map(|index| Some(made(3, index, &setting).ok()?.truth)).collect();
        assert!(truths.len() > 20);
        assert!(truths.iter().any(|one| one.other.is_some()));
        assert!(
            (0..3).all(|count| truths.iter().any(|one| one.other.is_none() && one.effects.len() == count)),
            "{truths:?}"
        );
        let (a, b) = (made(3, 5, &setting).unwrap(), made(3, 5, &setting).unwrap());
        assert_eq!((a.case.events, a.truth), (b.case.events, b.truth));
    }
}
