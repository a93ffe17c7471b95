//! Scenes estimated from frames against the light of simulated recordings: one picture, a picture before a
//! still ground, parts; and effects on known light.

use crate::candidates::{CANDIDATES, EffectScales, Trial};
use crate::residual::evidence::{EvidenceSetting, SceneEvidence};
use crate::residual::ranking::evidence;
use crate::scenes::SimulatedScene;
use photocurrent_core::Extent;
use photocurrent_scene::Scene;
use photocurrent_scene::case::Case;
use photocurrent_scene::known::KnownLight;
use photocurrent_scene::mosaic::scene;
use photocurrent_scene::moving::MovingPicture;
use photocurrent_scene::picture::patches::{PatchSetting, TURN, follow_motion, foreground, ground};
use photocurrent_scene::picture::{FitStart, PictureSetting, ScenePicture};
use photocurrent_scene::statistics::median;
use photocurrent_sensor::conditional::at;

fn evidence_and_gain(
    scene: &SimulatedScene,
    effect: Option<(&str, &str, f64)>,
) -> (SceneEvidence, Option<f64>) {
    let nominal = scene.recording().unwrap().nominal().unwrap();
    let scales = EffectScales::from_case(&scene.recording().unwrap(), &nominal);
    let candidate = effect.map(|(id, parameter, effect_size)| {
        (CANDIDATES.iter().find(|one| one.id == id && one.parameter == parameter).unwrap(), effect_size)
    });
    let trial =
        candidate.map(|(one, effect_size)| Trial::nominal_with_effect(&nominal, one, effect_size, &scales));
    let case = scene.recording_through(trial.as_ref()).unwrap();
    let source = KnownLight::new(&case, &nominal, scene.light().into());
    let truth = candidate.map(|(one, effect_size)| one.value(effect_size, &scales, &nominal));
    (evidence(&case, &nominal, &source, &EvidenceSetting::default()).unwrap(), truth)
}

#[test]
fn on_known_light_effects_of_events_and_of_frames_come_first_with_their_size() {
    // A texture and discs, by their numbers.
    for index in 1..3 {
        let scene = SimulatedScene::new(3, index, Extent { width: 32, height: 24 }, 0.15);
        for effect in [("time_constant", "alpha", 1.0), ("black_level", "black_level_dn", 1.0)] {
            let (found, truth) = evidence_and_gain(&scene, Some(effect));
            let (best, truth) = (&found.ranked[0], truth.unwrap());
            assert_eq!(CANDIDATES[best.candidate].id, effect.0, "scene {index}: {:?}", &found.ranked[..3]);
            assert!(
                (best.value / truth - 1.0).abs() < 0.005,
                "scene {index}, {}: {} is {truth}",
                effect.0,
                best.value
            );
        }
        let (found, _) = evidence_and_gain(&scene, None);
        assert!(
            found.ranked[0].gain_beyond_control() < 0.02 && found.left[0] < 0.02,
            "scene {index}: {:?}",
            found.ranked[0]
        );
    }
}

/// The middle of the exposure of the first row of a frame, ns.
fn middle_ns(case: &Case, l: usize) -> i64 {
    let exposure = case.frames.as_ref().unwrap().times.exposure(l, 0);
    i64::midpoint(exposure.start.0, exposure.end.0)
}

/// Mean distance of a scene's log light from the truth, in places whose light changes, between the middles of
/// the first and the last frame.
fn error(source: &dyn Scene, case: &Case, truth: &[(Vec<i64>, Vec<f64>)]) -> f64 {
    let light = source.light(case, 200_000);
    let (from, to) = (middle_ns(case, 0), middle_ns(case, case.frame_count() - 1));
    let mut errors: Vec<f64> = Vec::new();
    for (pixel, (t, photocurrent)) in truth.iter().enumerate() {
        let (low, high) = photocurrent
            .iter()
            .fold((f64::INFINITY, 0.0), |(low, high), i| (f64::min(low, *i), f64::max(high, *i)));
        if high < 1.3 * low || light.log[pixel].is_empty() {
            continue;
        }
        let within = (0..light.count).filter(|k| (from..to).contains(&light.instant(*k)));
        errors.extend(within.map(|k| {
            (f64::from(light.log[pixel][k]) - libm::log(at(t, photocurrent, light.instant(k)))).abs()
        }));
    }
    errors.iter().sum::<f64>() / errors.len() as f64
}

#[test]
fn what_moves_before_a_still_wall_is_followed_and_one_picture_is_left_alone() {
    let extent = Extent { width: 48, height: 36 };
    let fan = (0..)
        .map(|index| SimulatedScene::in_parts(5, index, extent, 0.08))
        .find(|scene| scene.sketch.name() == "fan")
        .unwrap();
    let case = fan.recording().unwrap();
    let nominal = case.nominal().unwrap();
    let found = scene(&case, &nominal, &PictureSetting::default(), &PatchSetting::default()).unwrap();
    assert_eq!(found.name(), "patches");
    let one = MovingPicture::fit(&case, &nominal, &PictureSetting::default()).unwrap();
    let (parts, one) = (error(found.as_ref(), &case, &fan.light()), error(&one, &case, &fan.light()));
    assert!(parts < 0.5 * one, "{parts} of natural-log units, one picture {one}");

    let texture = SimulatedScene::new(21, 0, extent, 0.06);
    let case = texture.recording().unwrap();
    assert_eq!(
        scene(&case, &case.nominal().unwrap(), &PictureSetting::default(), &PatchSetting::default())
            .unwrap()
            .name(),
        "picture"
    );
}

/// A ball that falls and a fan that turns, both before a still texture, by less than five pixels from frame
/// to frame.
#[test]
fn what_moves_before_a_still_ground_is_seen_with_its_light() {
    for (name, most) in [("fan", 0.04), ("ball", 0.06)] {
        let extent = Extent { width: 48, height: 36 };
        let scene = (0..2_000)
            .map(|index| SimulatedScene::in_parts(21, index, extent, 0.12))
            .find(|scene| scene.sketch.name() == name && scene.sketch.px_per_s(0.0, 0.0) < 500.0)
            .unwrap();
        let case = scene.recording().unwrap();
        let nominal = case.nominal().unwrap();
        let noise = (1.0, 0.005);
        let still = ground(&case, &nominal, noise, 4.0, 0.35);
        let counts = foreground(&case, &nominal, &still, noise, 4.0);
        let exposure_s = case.frames.as_ref().unwrap().times.nominal_exposure_ns().unwrap() as f64 * 1e-9;
        let ground: Vec<f32> = still
            .iter()
            .map(|dn| ((dn - nominal.number.black_level) / (nominal.number.gain * exposure_s)) as f32)
            .collect();
        let poses = follow_motion(&case, &nominal, &counts, TURN);
        let picture = ScenePicture::fit_from(
            &case,
            &nominal,
            &PictureSetting::default(),
            &[&poses],
            FitStart { counts: None, ground: Some(&ground), selected: None },
        );
        // Between frames, at instants that no exposure covers, where something moves.
        let (mut of_picture, mut of_ground) = (Vec::new(), Vec::new());
        for l in 2..case.frame_count() - 2 {
            let frames = case.frames.as_ref().unwrap();
            let t_ns = (frames.times.exposure(l, 18).end.0 + frames.times.exposure(l + 1, 18).start.0) / 2;
            let map = picture.motion.at(t_ns);
            for pixel in (0..extent.pixels())
                .filter(|pixel| counts[l * extent.pixels() + pixel] && ground[*pixel].is_finite())
            {
                let (x, y) = case.pixel_place(pixel);
                let truth = scene.sketch.log_light(f64::from(x), f64::from(y), t_ns as f64 * 1e-9);
                let found = picture.log_light(x as usize, y as usize, &[map]).unwrap()[0];
                of_picture.push((found - truth).abs());
                of_ground.push((libm::log(f64::from(ground[pixel])) - truth).abs());
            }
        }
        let (found, without) = (median(&mut of_picture), median(&mut of_ground));
        assert!(
            found < most && found < 0.3 * without,
            "{name}: {found}, of the ground alone {without}, in {} places",
            of_picture.len()
        );
    }
}

#[test]
fn photographs_that_shake_zoom_and_turn_are_predicted() {
    for index in 0..3 {
        let case =
            SimulatedScene::photograph(22, index, Extent { width: 40, height: 30 }, 0.1).recording().unwrap();
        let nominal = case.nominal().unwrap();
        let picture = ScenePicture::fit(&case, &nominal, &PictureSetting::default()).unwrap();
        let mut sizes: Vec<f64> = picture
            .residual
            .iter()
            .filter(|residual| residual.is_finite())
            .map(|residual| f64::from(residual.abs()))
            .collect();
        let signal = 0.5 * (0..case.extent.pixels()).map(|pixel| case.dn(1, pixel)).sum::<f64>()
            / case.extent.pixels() as f64;
        let missed = median(&mut sizes);
        assert!(missed < 0.005 * signal, "{index}: {missed} DN of {signal}");
    }
}
