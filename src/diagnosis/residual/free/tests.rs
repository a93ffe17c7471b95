//! Sound and faulty recordings with 5 electrons a DN and 2 DN of read noise in their frames: on one moving
//! picture a photograph that shakes, on the light of pixels waves that run in all directions, so that no
//! picture predicts the frames.

use super::*;
use crate::candidates::Candidate;
use crate::curves::LogLightCurves;
use crate::decide::model::DecisionModel;
use crate::decide::{DecisionThresholds, decide};
use crate::record::{SimulatedConditions, record};
use crate::sample::PixelSample;
use crate::scenes::SimulatedScene;
use photocurrent_core::Extent;
use photocurrent_core::random::Random;
use photocurrent_scene::picture::PictureSetting;

/// Log light of waves: wave numbers along x and y, one over pixels, and angular frequencies, 1/s.
fn water(x: f64, y: f64, t_s: f64) -> f64 {
    let waves = [
        (0.5, 0.2, 90.0, 0.3),
        (-0.3, 0.5, 70.0, 1.9),
        (0.1, -0.6, 110.0, 4.0),
        (-0.7, -0.3, 130.0, 2.2),
        (0.4, -0.4, 60.0, 5.1),
    ];
    let wave = |(kx, ky, rate, phase): &(f64, f64, f64, f64)| libm::sin(kx * x + ky * y - rate * t_s + phase);
    5.3 + 0.3 * waves.iter().map(wave).sum::<f64>()
}

/// The recording of it by a sensor with one effect, or as described.
fn recording(effect: Option<(&str, &str, f64)>) -> Case {
    let made = SimulatedScene::photograph(5, 0, Extent { width: 12, height: 20 }, 0.1);
    let plain = made.recording().unwrap();
    let nominal = plain.nominal().unwrap();
    let scales = EffectScales::from_case(&plain, &nominal);
    let trial = effect.map_or_else(
        || Trial::nominal(&nominal),
        |(id, parameter, size)| {
            Trial::nominal_with_effect(&nominal, Candidate::find(id, parameter).unwrap(), size, &scales)
        },
    );
    let instants: Vec<i64> = (plain.span.0..=plain.span.1).step_by(100_000).collect();
    let curve = |pixel: usize| {
        let (x, y) = plain.pixel_place(pixel);
        let at = |t_ns: &i64| water(x.into(), y.into(), *t_ns as f64 * 1e-9);
        (instants.clone(), instants.iter().map(at).collect(), true)
    };
    let curves = LogLightCurves::from_pixels((0..plain.extent.pixels()).map(curve));
    let sample = PixelSample::every_pixel(&plain, 6);
    let conditions = SimulatedConditions::default();
    let mut case = record(&plain, &trial.nominal, &sample, &curves, &trial.effects, &conditions).unwrap();
    let mut random = Random::new(11, &[]);
    let noisy = |_, dn: f32| {
        let signal = f64::max(f64::from(dn) - nominal.number.black_level, 0.0);
        (f64::from(dn) + libm::sqrt(signal / 5.0 + 4.0) * random.normal()).round() as f32
    };
    case.frames = case.frames.map(|frames| frames.map(noisy));
    case
}

#[test]
fn a_nominal_recording_has_no_findings() {
    let case = recording(None);
    let nominal = case.nominal().unwrap();
    let found = on_pixels(&case, &nominal).unwrap();
    assert!(found.scene == "pixels" && found.events > 300, "{}", found.events);
    let decided = decide(&found, &nominal, &DecisionThresholds::default()).unwrap();
    assert!(!decided.detected, "{:?}", found.first);
    // And no curve counts.
    let most = found.open.first().map_or(0.0, |one| one.gain_beyond_control());
    assert!(most < DecisionModel::for_pixels().least_gain, "{:?}", found.open[0]);
}

/// A recording whose thresholds are larger by this share where `is` holds, by row and time, ns.
fn larger_thresholds(truth: f64, is: impl Fn(u32, i64) -> bool) -> Case {
    use photocurrent_scene::case::PixelEvents;
    use photocurrent_sensor::effects::PixelEvent;
    let plain = recording(None);
    let nominal = plain.nominal().unwrap();
    let scales = EffectScales::from_case(&plain, &nominal);
    let scale = Candidate::find("threshold_scale", "fraction").unwrap();
    let larger =
        recording(Some(("threshold_scale", "fraction", scale.effect_size(truth, &scales, &nominal))));
    let of = |pixel: usize| {
        let (_, y) = plain.pixel_place(pixel);
        let part = |case: &Case, wanted: bool| -> Vec<PixelEvent> {
            case.events
                .of_pixel(pixel)
                .iter()
                .filter(|event| is(y, event.t_in_ns) == wanted)
                .copied()
                .collect()
        };
        let mut events = [part(&plain, false), part(&larger, true)].concat();
        events.sort_by_key(|event| event.t_in_ns);
        events
    };
    Case { events: PixelEvents::new((0..plain.extent.pixels()).map(of)), ..plain.clone() }
}

#[test]
fn a_second_variable_multiplies_a_curve_where_that_gains_more() {
    use crate::covariates::Covariate;
    // From a quarter of the recording on.
    let truth = 0.2;
    let case = larger_thresholds(truth, |y, t_ns| y % 2 == 1 && t_ns >= 25_000_000);
    let found = on_pixels(&case, &case.nominal().unwrap()).unwrap();
    let curve = &found.open[0].dependence;
    assert_eq!(curve.covariate, Covariate::RowParity, "{curve:?}");
    let times = curve.times.as_ref().expect("a product");
    assert_eq!((times.covariate, times.at.len()), (Covariate::Time, 4), "{times:?}");
    // Of the first bin the light takes what the others leave it.
    assert!(times.by[0] < 0.25 && times.by[1..].iter().all(|by| (by - 1.0).abs() < 0.15), "{times:?}");
    let difference = curve.value[1] - curve.value[0];
    assert!((difference / truth - 1.0).abs() < 0.3, "{curve:?}");
    let equation = curve.equation();
    assert!(equation.contains("c = f * g") && equation.contains("g(time) = "), "{equation}");
}

#[test]
fn thresholds_of_odd_rows_are_a_curve_on_the_light_of_pixels() {
    use crate::covariates::Covariate;
    use crate::dependence::AffectedQuantity;
    let truth = 0.25;
    let case = larger_thresholds(truth, |y, _| y % 2 == 1);
    let found = on_pixels(&case, &case.nominal().unwrap()).unwrap();
    let curve = &found.open[0].dependence;
    assert_eq!(
        (curve.covariate, curve.moved),
        (Covariate::RowParity, AffectedQuantity::Threshold),
        "{curve:?}"
    );
    // The light takes a part of what is the same in all rows, and nothing of their difference.
    let difference = curve.value[1] - curve.value[0];
    assert!((difference / truth - 1.0).abs() < 0.15, "{curve:?}");
    let best = found
        .ranked
        .iter()
        .filter(|one| one.is_exact)
        .map(RankedEffect::gain_beyond_control)
        .fold(0.0, f64::max);
    assert!(
        best < 0.5 * found.open[0].gain_beyond_control(),
        "{best} {}",
        found.open[0].gain_beyond_control()
    );
}

#[test]
fn a_ball_that_passes_within_a_millisecond_gains_nothing_by_other_thresholds() {
    // Light that may swing further where no event is, and densities in volts, gained 0.7 nats an event here
    // by thresholds of half their size.
    let case =
        SimulatedScene::of_any_kind(7, 98, Extent { width: 64, height: 48 }, 0.12).recording().unwrap();
    let found = on_pixels(&case, &case.nominal().unwrap()).unwrap();
    let thresholds = ["threshold_scale", "threshold_drift", "threshold_gradient", "black_level"];
    let of_thresholds = found.ranked.iter().filter(|one| thresholds.contains(&CANDIDATES[one.candidate].id));
    let gains: Vec<f64> = of_thresholds.map(RankedEffect::gain_beyond_control).collect();
    // Less than is a sign of anything.
    let least = DecisionModel::for_pixels().least_gain;
    assert!(gains.len() >= thresholds.len() && gains.iter().all(|gain| *gain < least), "{gains:?}");
    assert!(!decide(&found, &case.nominal().unwrap(), &DecisionThresholds::default()).unwrap().detected);
}

#[test]
fn effects_are_named_with_their_sizes_where_nothing_moves_as_one() {
    for (id, parameter, size) in [("leak_events", "rate", 1.0), ("threshold_asymmetry", "fraction", -0.7)] {
        let case = recording(Some((id, parameter, size)));
        let nominal = case.nominal().unwrap();
        let found = on_pixels(&case, &nominal).unwrap();
        let first = found.first.clone().unwrap();
        assert_eq!(CANDIDATES[first.candidate].id, id);
        // Within the standard error that is stated, or a tenth.
        let off = (first.effect_size - size).abs();
        assert!(off < f64::max(first.error, 0.1 * size.abs()), "{first:?}");
        assert!(decide(&found, &nominal, &DecisionThresholds::default()).unwrap().detected, "{first:?}");
    }
}

#[test]
fn the_probability_that_an_event_is_explained_is_that_of_students_t() {
    // |t| < 2 with three degrees of freedom: 0.8607 in any table.
    assert!((explained(0.01) - 0.8607).abs() < 1e-4);
    // Where nothing is left, all of them are.
    assert!(explained(0.0) > 0.999 && explained(0.0) <= 1.0);
}

#[test]
fn without_frames_there_is_no_light_to_begin_with() {
    let case = Case { frames: None, ..recording(None) };
    let why = on_pixels(&case, &case.nominal().unwrap()).unwrap_err();
    assert!(why.contains("no frames"), "{why}");
}

#[test]
fn where_no_picture_predicts_the_frames_the_light_of_pixels_decides() {
    use crate::integrity::Integrity;
    use crate::stages::EvidenceOutcome;
    use crate::whole::{SceneSetting, SceneSource, on_frames};
    let case = recording(None);
    let nominal = case.nominal().unwrap();
    let integrity = Integrity::default();
    let of = |scene: SceneSource| {
        let setting = SceneSetting { scene, ..SceneSetting::default() };
        on_frames(&case, &nominal, &integrity, &setting)
    };
    let EvidenceOutcome::Evidence(usual) = of(SceneSource::Parts) else { panic!("no evidence") };
    let on_pixels = usual.on_pixels.as_deref().unwrap_or(&usual);
    assert_eq!(on_pixels.scene, "pixels");
    // A picture alone is what was chosen: no other scene takes its place.
    match of(SceneSource::Picture) {
        EvidenceOutcome::Evidence(picture) => assert!(picture.on_pixels.is_none()),
        EvidenceOutcome::Nothing(why) => assert!(!why.is_empty()),
        EvidenceOutcome::NotAsked => panic!("a scene was chosen"),
    }
}

/// A photograph that shakes, recorded by a sensor with one effect, or as described.
fn photograph(effect: Option<(&str, &str, f64)>) -> Case {
    let extent = Extent { width: 44, height: 33 };
    recorded(&SimulatedScene::photograph(5, 0, extent, 0.1).with_frame_noise(Some((5.0, 2.0))), effect)
}

/// A scene as recorded by a sensor with one effect, or as described.
fn recorded(made: &SimulatedScene, effect: Option<(&str, &str, f64)>) -> Case {
    let plain = made.recording().unwrap();
    let Some((id, parameter, size)) = effect else { return plain };
    let nominal = plain.nominal().unwrap();
    let scales = EffectScales::from_case(&plain, &nominal);
    let trial = Trial::nominal_with_effect(&nominal, Candidate::find(id, parameter).unwrap(), size, &scales);
    made.recording_through(Some(&trial)).unwrap()
}

fn joint(case: &Case) -> SceneEvidence {
    let nominal = case.nominal().unwrap();
    let picture = MovingPicture::fit(case, &nominal, &PictureSetting::default()).unwrap();
    on_picture(case, &nominal, &picture).unwrap()
}

#[test]
fn nothing_gains_on_a_picture_of_noisy_frames_and_events() {
    let case = photograph(None);
    let found = joint(&case);
    let nominal = case.nominal().unwrap();
    assert!(found.scene == "joint" && found.events > 300, "{}", found.events);
    // Frames alone miss thresholds by ten times as much.
    assert!(found.median < 0.02, "{}", found.median);
    let best = found.ranked.iter().map(RankedEffect::gain_beyond_control).fold(0.0, f64::max);
    assert!(best < 0.01, "{best}");
    assert!(!decide(&found, &nominal, &DecisionThresholds::default()).unwrap().detected, "{:?}", found.first);
}

#[test]
fn effects_of_events_and_of_frames_are_named_with_their_sizes_on_noisy_frames() {
    let effects = [("threshold_asymmetry", "fraction", -0.5), ("black_level", "black_level_dn", 1.0)];
    for (id, parameter, size) in effects {
        let case = photograph(Some((id, parameter, size)));
        let found = joint(&case);
        let first = found.first.clone().unwrap();
        assert_eq!(CANDIDATES[first.candidate].id, id, "{first:?}");
        // Within the standard error that is stated, or a tenth: three rounds of scene and size leave that
        // much of a black level of 54 DN.
        let off = (first.effect_size - size).abs();
        assert!(off < f64::max(first.error, 0.1 * size.abs()), "{first:?}");
        let decided = decide(&found, &case.nominal().unwrap(), &DecisionThresholds::default()).unwrap();
        assert!(decided.detected, "{first:?}");
    }
}

#[test]
fn thresholds_that_differ_from_pixel_to_pixel_are_found_with_their_spread() {
    // Of a scene with many events: an eighth of the thresholds.
    let extent = Extent { width: 24, height: 18 };
    let made = SimulatedScene::new(5, 2, extent, 0.12).with_frame_noise(Some((5.0, 2.0)));
    let case = recorded(&made, Some(("threshold_mismatch", "sigma", 0.75)));
    let nominal = case.nominal().unwrap();
    let found = joint(&case);
    let first = found.first.clone().unwrap();
    let kind = &CANDIDATES[first.candidate];
    assert_eq!(kind.id, "threshold_mismatch", "{first:?}");
    let truth = kind.value(0.75, &EffectScales::from_case(&case, &nominal), &nominal);
    // Of two thresholds a pixel, each known as its events have it.
    assert!((first.value / truth - 1.0).abs() < 0.15, "{} is {truth}", first.value);
    // Each pixel with its own, events are explained as in a recording without differences.
    assert!(found.median > 0.05 && found.left[0] < EXPLAINED, "{} {:?}", found.median, found.left);
    // And no other effect explains as much.
    let others = found.ranked.iter().filter(|one| one.is_exact);
    assert!(
        others.map(RankedEffect::gain_beyond_control).fold(0.0, f64::max) < 0.5 * first.gain_beyond_control()
    );
}

#[test]
fn noise_of_thresholds_that_is_stated_is_no_fault_of_the_scene() {
    let made = SimulatedScene::new(5, 2, Extent { width: 30, height: 22 }, 0.12);
    let case = made.with_frame_noise(Some((5.0, 2.0))).with_threshold_noise(0.05).recording().unwrap();
    let found = joint(&case);
    // By noise of 5 % half of the events miss by 0.034 at the least, and a scene decides from 0.02 down.
    assert!(found.median > 0.03 && EXPLAINED < 0.03, "{}", found.median);
    // Thresholds as a whole come out 7 % smaller than stated here, as events decide what noisy frames leave
    // open: by 13 % (0.67 effect sizes) without the density of times.
    let scale = Candidate::number("threshold_scale", "fraction").unwrap();
    let whole = found.ranked.iter().find(|one| one.candidate == scale).unwrap();
    assert!(whole.effect_size.abs() < 0.5, "{whole:?}");
    // Nor is that noise a curve that chance chose: it gains less than any effect needs for a name.
    let curve = found.open.first().map_or(0.0, |one| one.gain_beyond_control());
    assert!(curve < 0.1, "{:?}", found.open.first());
    assert!(!decide(&found, &case.nominal().unwrap(), &DecisionThresholds::default()).unwrap().detected);
}

#[test]
fn thresholds_of_odd_rows_are_a_curve_without_a_name() {
    use crate::covariates::Covariate;
    use crate::dependence::AffectedQuantity;
    use photocurrent_scene::case::PixelEvents;
    let small = |effect: Option<(&str, &str, f64)>| {
        let made = SimulatedScene::photograph(5, 0, Extent { width: 38, height: 28 }, 0.1);
        recorded(&made.with_frame_noise(Some((5.0, 2.0))), effect)
    };
    let even = small(None);
    let truth = 0.15;
    let scales = EffectScales::from_case(&even, &even.nominal().unwrap());
    let size = Candidate::find("threshold_scale", "fraction").unwrap().effect_size(
        truth,
        &scales,
        &even.nominal().unwrap(),
    );
    let odd = small(Some(("threshold_scale", "fraction", size)));
    let of = |pixel: usize| {
        let is_odd = even.pixel_place(pixel).1 % 2 == 1;
        (if is_odd { &odd } else { &even }).events.of_pixel(pixel).to_vec()
    };
    let case = Case { events: PixelEvents::new((0..even.extent.pixels()).map(of)), ..even.clone() };
    let found = joint(&case);
    // Without the curve half of the events miss by more than a scene may: that is no fault of the scene.
    assert!(found.median > EXPLAINED, "{}", found.median);
    let curve = &found.open[0].dependence;
    assert_eq!(
        (curve.covariate, curve.moved),
        (Covariate::RowParity, AffectedQuantity::Threshold),
        "{curve:?}"
    );
    // As the description has it in even rows, and with 15 % more in odd ones. What is the same in all rows is
    // nearly one number with the contrast of a scene whose frames are noisy.
    let [even, odd] = [curve.value[0], curve.value[1]];
    assert!((odd - even - truth).abs() < 0.08 * truth, "{curve:?}");
    assert!(even.abs() < 3.0 * curve.error[0] && curve.error.iter().all(|error| *error < 0.02), "{curve:?}");
    // And no effect of the catalogue gains as much.
    let best = found
        .ranked
        .iter()
        .filter(|one| one.is_exact)
        .map(RankedEffect::gain_beyond_control)
        .fold(0.0, f64::max);
    assert!(
        best < 0.5 * found.open[0].gain_beyond_control(),
        "{best} {}",
        found.open[0].gain_beyond_control()
    );
}

#[test]
fn numbers_that_lie_in_a_range_are_estimated_with_the_scene() {
    use photocurrent_core::quantity::Duration;
    use photocurrent_core::sensor::Range;
    let mut case = photograph(None);
    let truth = Nominal::of(&case.sensor);
    let alpha_ns = (truth.pixel.front_end.alpha_s * 1e9) as i64;
    let ranges = [
        ("front_end.alpha", Range::Time([alpha_ns / 6, 2 * alpha_ns].map(Duration::new))),
        ("comparator.threshold_on", Range::Number([0.8, 1.5].map(|by| by * truth.pixel.threshold_on))),
    ];
    case.sensor.ranges = ranges.into_iter().map(|(field, range)| (field.to_owned(), range)).collect();
    // The middle stands for the number, which is wrong.
    let unknowns = crate::unknowns::unknowns(&case.sensor);
    let middle = |one: &UnknownParameter| f64::midpoint(one.bounds()[0], one.bounds()[1]);
    let nominal = unknowns.iter().fold(truth.clone(), |with, one| one.with_estimate(&with, middle(one)));
    assert!((nominal.pixel.front_end.alpha_s / truth.pixel.front_end.alpha_s - 0.577).abs() < 0.01);
    let picture = MovingPicture::fit(&case, &nominal, &PictureSetting::default()).unwrap();
    for (found, truth) in estimated_on_picture(&case, &nominal, &picture, &unknowns)
        .unwrap()
        .iter()
        .zip([truth.pixel.threshold_on, truth.pixel.front_end.alpha_s])
    {
        // Of ranges of factors twelve and two at first: errors are three times what the information gives,
        // and what the grid leaves of this photograph, 1.5 % of a threshold, may be common to all events.
        let [low, high] = found.ci95;
        assert!((found.estimate / truth - 1.0).abs() < 0.05, "{found:?}: {truth}");
        assert!(low < truth && truth < high && high < 1.8 * low, "{found:?}: {truth}");
    }
}

#[test]
fn the_picture_that_explains_more_decides() {
    use crate::integrity::Integrity;
    use crate::stages::{DecisionOutcome, EvidenceOutcome};
    use crate::whole::{SceneSetting, decide_outcome, on_frames};
    let case = photograph(Some(("threshold_asymmetry", "fraction", -0.5)));
    let nominal = case.nominal().unwrap();
    let seen = on_frames(&case, &nominal, &Integrity::default(), &SceneSetting::default());
    let EvidenceOutcome::Evidence(found) = &seen else { panic!("no evidence") };
    let joint = found.on_joint.as_deref().expect("frames have noise");
    assert!(joint.left[0] < found.left[0] && found.on_pixels.is_none(), "{:?} {:?}", joint.left, found.left);
    let DecisionOutcome::Decided(decided) = decide_outcome(seen, &nominal, &DecisionThresholds::default())
    else {
        panic!("there is no decision")
    };
    assert_eq!(decided.name, "joint");
    assert_eq!(CANDIDATES[decided.proposals[0].candidate].id, "threshold_asymmetry");
}

#[test]
fn pixels_are_drawn_until_enough_events_take_part_and_others_are_held_out() {
    let case = photograph(None);
    let gate = gate::PredictionGate::accept_all();
    let kept = choose::gated_events(&case, &gate);
    let block = Block { x: 2, y: 3, width: 40, height: 30 };
    let (is_trained, is_measured) = choose::choose_pixels(&case, &block, &kept, (2_000, 700));
    let events = |is: &[bool]| -> usize {
        is.iter().enumerate().filter(|(_, is)| **is).map(|(pixel, _)| case.events.of_pixel(pixel).len()).sum()
    };
    assert!((1_200..2_800).contains(&events(&is_trained)), "{}", events(&is_trained));
    assert!((350..1_050).contains(&events(&is_measured)), "{}", events(&is_measured));
    let within = block.pixels(case.extent);
    for (pixel, (a, b)) in (0..).zip(is_trained.iter().zip(&is_measured)) {
        assert!(!(*a && *b) && (!(*a || *b) || within.contains(&pixel)));
    }
}
