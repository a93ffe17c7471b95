//! A known target is found where it is, effects of frames that move the fit are reported all the same, and
//! derivatives by its free parameters are those of the residuals.

use crate::candidates::{CANDIDATES, EffectScales, Trial};
use crate::residual::SampleView;
use crate::residual::evidence::{EvidenceSetting, SceneEvidence};
use crate::residual::ranking::evidence;
use crate::scenes::SimulatedScene;
use crate::targets::SketchFamily;
use photocurrent_core::Extent;
use photocurrent_scene::FreeParameters;
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::target::{FittedTarget, TargetSetting};
use std::sync::Arc;

const EXTENT: Extent = Extent { width: 24, height: 18 };

const SETTING: TargetSetting = TargetSetting { values: 2_000, tries: 1, seed: 1 };

/// A star, by its number.
const STAR: u64 = 1;

fn recorded(effect: Option<(&str, &str, f64)>) -> (Case, Nominal, FittedTarget, Vec<f64>, Option<f64>) {
    let scene = SimulatedScene::target(3, STAR, EXTENT, 0.08);
    let plain = scene.recording().unwrap();
    let nominal = plain.nominal().unwrap();
    let scales = EffectScales::from_case(&plain, &nominal);
    let candidate = effect.map(|(id, parameter, effect_size)| {
        (CANDIDATES.iter().find(|one| one.id == id && one.parameter == parameter).unwrap(), effect_size)
    });
    let trial =
        candidate.map(|(one, effect_size)| Trial::nominal_with_effect(&nominal, one, effect_size, &scales));
    let case = scene.recording_through(trial.as_ref()).unwrap();
    let (sketches, shares) = SketchFamily::ranges_around(&scene, 3, STAR);
    let near: Vec<f64> = shares.iter().map(|share| share + 0.01).collect();
    let target = FittedTarget::fit_near(&case, &nominal, Arc::new(sketches), SETTING, &near).unwrap();
    let truth = candidate.map(|(one, effect_size)| one.value(effect_size, &scales, &nominal));
    (case, nominal, target, shares, truth)
}

fn evidence_and_gain(effect: Option<(&str, &str, f64)>) -> (SceneEvidence, Option<f64>) {
    let (case, nominal, target, _, truth) = recorded(effect);
    (evidence(&case, &nominal, &target, &EvidenceSetting::default()).unwrap(), truth)
}

#[test]
fn it_is_found_within_what_the_frames_leave_open() {
    let (_, _, target, truth, _) = recorded(None);
    for ((share, error), truth) in target.shares().iter().zip(target.errors()).zip(&truth) {
        assert!(
            (share - truth).abs() < 4.0 * error + 5e-3 && error < 0.05,
            "{share} with {error} is {truth}"
        );
    }
}

#[test]
fn effects_that_move_the_fit_come_first_with_their_size() {
    for effect in [
        ("black_level", "black_level_dn", 1.0),
        ("row_time", "row_time", 1.0),
        ("clock_offset", "offset", 1.0),
    ] {
        let (found, truth) = evidence_and_gain(Some(effect));
        let (best, truth) = (&found.ranked[0], truth.unwrap());
        assert_eq!(CANDIDATES[best.candidate].id, effect.0, "{:?}", &found.ranked[..3]);
        assert!((best.value / truth - 1.0).abs() < 0.05, "{}: {} is {truth}", effect.0, best.value);
    }
}

#[test]
fn derivatives_by_free_parameters_are_those_of_the_residuals() {
    let (case, nominal, target, ..) = recorded(None);
    let pixels: Vec<u32> = (0..EXTENT.pixels() as u32).step_by(7).collect();
    let steps: Vec<f64> = target.free().iter().map(|(_, step)| *step).collect();
    let left = |by: &[f64]| -> Vec<f64> {
        let light = target.moved_light(&case, 25_000, Some(&pixels), by).unwrap();
        let view = SampleView { case: &case, light: &light, pixels: pixels.clone(), is_known: true };
        let (_, of) = view.residuals(&[Trial::nominal(&nominal)], |_, _| true).unwrap();
        of[0].excess.iter().map(|value| f64::from(*value)).collect()
    };
    let none = left(&vec![0.0; steps.len()]);
    for k in 0..steps.len() {
        let slope = |share: f64| -> Vec<f64> {
            let mut by = vec![0.0; steps.len()];
            by[k] = share;
            left(&by).iter().zip(&none).map(|(then, now)| (then - now) / share).collect()
        };
        // One step and its double, to either side: edges bend, so the sum over events is compared.
        let (one, other) = (slope(steps[k]), slope(-2.0 * steps[k]));
        let product: f64 = one.iter().zip(&other).map(|(a, b)| a * b).sum();
        let size = |of: &[f64]| libm::sqrt(of.iter().map(|a| a * a).sum());
        assert!(
            size(&one) > 0.0 && product > 0.95 * size(&one) * size(&other),
            "parameter {k}: {product} of {} and {}",
            size(&one),
            size(&other)
        );
    }
}
