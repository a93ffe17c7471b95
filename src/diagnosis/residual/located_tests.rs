//! Effects that were applied to a part of a recording are found there, and one that is everywhere is found
//! everywhere.

use super::*;
use crate::candidates::{CANDIDATES, Candidate, EffectScales, Trial};
use crate::residual::evidence::{EvidenceSetting, RankedEffect, SceneEvidence};
use crate::residual::free::on_picture;
use crate::residual::ranking::evidence;
use crate::scenes::SimulatedScene;
use crate::testing;
use photocurrent_core::Extent;
use photocurrent_core::random::Random;
use photocurrent_scene::case::{PixelEvent, PixelEvents};
use photocurrent_scene::known::KnownLight;
use photocurrent_scene::moving::MovingPicture;
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::picture::PictureSetting;

/// A texture before a sensor that is described as it is.
fn texture() -> (SimulatedScene, Case, Nominal) {
    let scene = SimulatedScene::new(3, 1, Extent { width: 48, height: 40 }, 0.15);
    let case = scene.recording().unwrap();
    let nominal = case.nominal().unwrap();
    (scene, case, nominal)
}

/// The same scene recorded with an effect at an effect size.
fn with_effect(
    scene: &SimulatedScene,
    plain: &Case,
    nominal: &Nominal,
    id: &str,
    parameter: &str,
    effect_size: f64,
) -> Case {
    let candidate = Candidate::find(id, parameter).unwrap();
    scene
        .recording_through(Some(&Trial::nominal_with_effect(
            nominal,
            candidate,
            effect_size,
            &EffectScales::from_case(plain, nominal),
        )))
        .unwrap()
}

/// Events of one recording where `is_other` is true (pixel, time in ns), and of another elsewhere.
fn mix_cases(plain: &Case, other: &Case, is_other: impl Fn(usize, i64) -> bool) -> Case {
    let of = |pixel: usize| -> Vec<PixelEvent> {
        let from = |case: &Case, wanted: bool| {
            case.events
                .of_pixel(pixel)
                .iter()
                .filter(|event| is_other(pixel, event.t_in_ns) == wanted)
                .copied()
                .collect::<Vec<_>>()
        };
        [from(plain, false), from(other, true)].concat()
    };
    Case { events: PixelEvents::new((0..plain.events.pixels()).map(of)), ..plain.clone() }
}

/// Evidence of the events on the true light.
fn evidence_on_known_light(scene: &SimulatedScene, case: &Case, nominal: &Nominal) -> SceneEvidence {
    let source = KnownLight::new(case, nominal, scene.light().into());
    evidence(case, nominal, &source, &EvidenceSetting::default()).unwrap()
}

fn location_of_effect<'a>(ranked: &'a [RankedEffect], id: &str) -> &'a LocatedEffect {
    let one = ranked.iter().find(|one| CANDIDATES[one.candidate].id == id && one.located.is_some());
    one.unwrap_or_else(|| {
        panic!(
            "{id} was not located: {:?}",
            ranked.iter().map(|one| CANDIDATES[one.candidate].id).collect::<Vec<_>>()
        )
    })
    .located
    .as_ref()
    .unwrap()
}

fn is_near(found: u32, truth: u32) -> bool {
    found.abs_diff(truth) <= 4
}

#[test]
fn an_effect_of_some_rows_is_found_in_them() {
    let (scene, plain, nominal) = texture();
    let other = with_effect(&scene, &plain, &nominal, "time_constant", "alpha", 1.0);
    let case = mix_cases(&plain, &other, |pixel, _| plain.pixel_place(pixel).1 >= 16);
    let found = evidence_on_known_light(&scene, &case, &nominal);
    let located = location_of_effect(&found.ranked, "time_constant");
    assert!(is_near(located.rows.range[0], 16) && located.rows.range[1] == 39, "{:?}", located.rows);
    assert!(located.rows.outside.unwrap().gain < 0.1 * located.rows.inside.gain);
    assert_eq!(
        (located.columns.range, located.time_ns.range),
        ([0, 47], [case.span.0, case.span.1]),
        "{:?} {:?}",
        located.columns,
        located.time_ns
    );
    assert_eq!((&located.covariate[..], &located.shape[..]), ("row", "rises"));
    assert!(located.pixels.abs_diff(48 * 24) < 48 * 5, "{}", located.pixels);
}

#[test]
fn an_effect_of_a_part_of_the_time_is_found_then() {
    let (scene, plain, nominal) = texture();
    let other = with_effect(&scene, &plain, &nominal, "time_constant", "alpha", 1.0);
    let case = mix_cases(&plain, &other, |_, t_ns| t_ns >= 60_000_000);
    let found = evidence_on_known_light(&scene, &case, &nominal);
    let located = location_of_effect(&found.ranked, "time_constant");
    let step_ns = (case.span.1 - case.span.0) / LocatedSetting::default().steps as i64;
    assert!(
        (located.time_ns.range[0] - 60_000_000).abs() <= 2 * step_ns
            && located.time_ns.range[1] == case.span.1,
        "{:?}",
        located.time_ns
    );
    assert_eq!((located.rows.range, located.columns.range), ([0, 39], [0, 47]));
    assert_eq!(located.covariate, "time");
}

#[test]
fn an_effect_that_is_everywhere_is_found_everywhere() {
    let (scene, plain, nominal) = texture();
    for (id, parameter) in
        [("time_constant", "alpha"), ("clock_offset", "offset"), ("black_level", "black_level_dn")]
    {
        let case = with_effect(&scene, &plain, &nominal, id, parameter, 1.0);
        let found = evidence_on_known_light(&scene, &case, &nominal);
        let located = location_of_effect(&found.ranked, id);
        let whole = (located.rows.range, located.columns.range, located.time_ns.range);
        assert_eq!(whole, ([0, 39], [0, 47], [case.span.0, case.span.1]), "{id}");
        assert_eq!(located.polarity, "both", "{id}: {:?}", located.by_polarity);
        assert!(located.pixels > 48 * 40 * 9 / 10, "{id}: {}", located.pixels);
    }
}

#[test]
fn a_threshold_of_one_polarity_is_located_by_polarity() {
    let (scene, plain, nominal) = texture();
    for is_on in [true, false] {
        let mut trial = Trial::nominal(&nominal);
        let pixel = &mut trial.nominal.pixel;
        *(if is_on { &mut pixel.threshold_on } else { &mut pixel.threshold_off }) *= 1.15;
        let case = scene.recording_through(Some(&trial)).unwrap();
        let found = evidence_on_known_light(&scene, &case, &nominal);
        // One number for both polarities fits one of them alone.
        let located = location_of_effect(&found.ranked, "threshold_scale");
        assert_eq!(located.polarity, if is_on { "on" } else { "off" }, "{:?}", located.by_polarity);
    }
    // Both by as much, one up and one down.
    let case = with_effect(&scene, &plain, &nominal, "threshold_asymmetry", "fraction", 1.0);
    let found = evidence_on_known_light(&scene, &case, &nominal);
    assert_eq!(location_of_effect(&found.ranked, "threshold_asymmetry").polarity, "both");
}

#[test]
fn a_leak_shows_after_long_intervals_and_a_dark_current_in_the_dark() {
    let (scene, plain, nominal) = texture();
    let case = with_effect(&scene, &plain, &nominal, "leak_events", "rate", 1.0);
    let leak = evidence_on_known_light(&scene, &case, &nominal);
    let leak = location_of_effect(&leak.ranked, "leak_events");
    assert_eq!((&leak.covariate[..], &leak.shape[..]), ("time_since_last_event", "rises"));
    let (short, long) = (leak.over.gain[0], leak.over.gain[leak.over.gain.len() - 1]);
    assert!(long.gain > 1.5 * short.gain && long.gain - short.gain > 4.0 * long.error, "{:?}", leak.over);
    let case = with_effect(&scene, &plain, &nominal, "dark_current", "current", 1.0);
    let dark = evidence_on_known_light(&scene, &case, &nominal);
    let dark = location_of_effect(&dark.ranked, "dark_current");
    assert_eq!(dark.covariate, "photocurrent");
    let bins = &dark.over_light.gain;
    assert!(bins[0].gain > bins[bins.len() - 1].gain, "{:?}", dark.over_light);
}

#[test]
fn what_has_no_name_has_the_place_of_its_curve() {
    let (scene, plain, nominal) = texture();
    let mut trial = Trial::nominal(&nominal);
    trial.nominal.pixel.threshold_on *= 1.2;
    trial.nominal.pixel.threshold_off *= 1.2;
    let other = scene.recording_through(Some(&trial)).unwrap();
    let case = mix_cases(&plain, &other, |pixel, _| plain.pixel_place(pixel).1 % 2 == 1);
    let best = evidence_on_known_light(&scene, &case, &nominal).open.remove(0);
    let located = best.located.unwrap();
    assert_eq!((&located.covariate[..], &located.shape[..]), ("row_parity", "differs"));
    assert_eq!((located.rows.range, located.columns.range), ([0, 39], [0, 47]));
    assert!(located.all.gain > 0.1);
}

#[test]
fn a_moving_picture_locates_too_and_no_number_depends_on_threads() {
    let (scene, plain, nominal) = texture();
    let other = with_effect(&scene, &plain, &nominal, "time_constant", "alpha", 1.0);
    let case = mix_cases(&plain, &other, |pixel, _| plain.pixel_place(pixel).1 >= 16);
    let of_picture = || {
        let source = MovingPicture::fit(&case, &nominal, &PictureSetting::default()).unwrap();
        evidence(&case, &nominal, &source, &EvidenceSetting::default()).unwrap()
    };
    let on = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(of_picture)
    };
    let found = on(1);
    let located = location_of_effect(&found.ranked, "time_constant");
    assert!(is_near(located.rows.range[0], 16) && located.rows.range[1] == 39, "{:?}", located.rows);
    assert_eq!(located.columns.range, [0, 47]);
    assert_eq!(serde_json::to_string(&found).unwrap(), serde_json::to_string(&on(3)).unwrap());
}

#[test]
fn frames_and_events_together_locate_too() {
    let scene = SimulatedScene::new(3, 1, Extent { width: 36, height: 30 }, 0.1);
    let plain = scene.recording().unwrap();
    let nominal = plain.nominal().unwrap();
    // Thresholds of some rows that are 2 % larger.
    let other = with_effect(&scene, &plain, &nominal, "threshold_scale", "fraction", 0.2);
    let case = mix_cases(&plain, &other, |pixel, _| plain.pixel_place(pixel).1 >= 12);
    let source = MovingPicture::fit(&case, &nominal, &PictureSetting::default()).unwrap();
    let found = on_picture(&case, &nominal, &source).unwrap();
    let located = location_of_effect(&found.ranked, "threshold_scale");
    assert!(is_near(located.rows.range[0], 12) && located.rows.range[1] == 29, "{:?}", located.rows);
    assert_eq!(located.columns.range, [0, 35]);
}

/// Events over an array of 12 x 10 pixels with gains of a mean where `is_part` is true (column, row), and
/// about nothing elsewhere.
struct SimulatedGains {
    case: Case,
    pixel: Vec<u32>,
    t_ns: Vec<i64>,
    polarity: Vec<i8>,
    light: Vec<f64>,
    block: Vec<u32>,
    gains: Vec<f64>,
}

fn simulate_gains(seed: u64, mean: f64, is_part: impl Fn(u32, u32) -> bool) -> SimulatedGains {
    let case = testing::case();
    let mut random = Random::new(seed, &[]);
    let mut drawn = SimulatedGains {
        case,
        pixel: Vec::new(),
        t_ns: Vec::new(),
        polarity: Vec::new(),
        light: Vec::new(),
        block: Vec::new(),
        gains: Vec::new(),
    };
    for _ in 0..3_000 {
        let pixel = ((random.uniform() * 120.0) as u32).min(119);
        let (x, y) = drawn.case.pixel_place(pixel as usize);
        drawn.pixel.push(pixel);
        drawn.t_ns.push((random.uniform() * 60e6) as i64);
        drawn.polarity.push(if random.uniform() < 0.5 { 1 } else { -1 });
        drawn.light.push(random.normal());
        drawn.block.push(2 * (y / 2 * 6 + x / 2) + (x / 2 + y / 2) % 2);
        drawn.gains.push(random.normal() + if is_part(x, y) { mean } else { 0.0 });
    }
    drawn
}

fn located(drawn: &SimulatedGains) -> LocatedEffect {
    let setting = LocatedSetting::default();
    let on = GainingValues {
        pixel: &drawn.pixel,
        t_ns: &drawn.t_ns,
        polarity: &drawn.polarity,
        log_light: &drawn.light,
        block: &drawn.block,
    };
    LocationData::new(&drawn.case, on, &[], &setting).locate(&drawn.gains, "slope")
}

#[test]
fn a_block_of_the_array_is_found_and_chance_makes_no_parts() {
    let found = located(&simulate_gains(1, 1.0, |x, y| (3..9).contains(&x) && (2..6).contains(&y)));
    assert_eq!((found.columns.range, found.rows.range), ([3, 8], [2, 5]));
    assert!(
        found.columns.outside.is_some()
            && found.time_ns.outside.is_none()
            && found.log_light.outside.is_none()
            && found.polarity == "both"
    );
    // As strong everywhere, weak everywhere, and none at all.
    for (seed, mean) in (0..60).map(|seed| (seed, [1.0, 0.1, 0.0][seed as usize % 3])) {
        let found = located(&simulate_gains(seed, mean, |_, _| true));
        let is_whole =
            [&found.rows.outside, &found.columns.outside, &found.time_ns.outside, &found.log_light.outside]
                .iter()
                .all(|rest| rest.is_none());
        assert!(is_whole && found.polarity == "both", "{seed}: {found:?}");
        assert_eq!(
            (found.rows.range, found.columns.range, found.time_ns.range),
            ([0, 9], [0, 11], [0, 60_000_000])
        );
        assert_eq!((&found.covariate[..], &found.shape[..]), ("slope", "flat"));
    }
}

#[test]
fn a_gain_that_falls_off_slowly_is_no_part() {
    let mut drawn = simulate_gains(2, 0.0, |_, _| true);
    for k in 0..drawn.gains.len() {
        let row = f64::from(drawn.case.pixel_place(drawn.pixel[k] as usize).1);
        drawn.gains[k] = 0.1 * drawn.gains[k] + 0.2 + 0.1 * row;
    }
    let found = located(&drawn);
    assert!(found.rows.outside.is_none() && found.rows.range == [0, 9], "{:?}", found.rows);
}

#[test]
fn curves_have_words() {
    assert_eq!(shape(&[0.0, 1.0, 2.1, 3.0], 0.7), "rises");
    assert_eq!(shape(&[3.0, 1.0, 0.9, 0.1], 0.7), "falls");
    assert_eq!(shape(&[0.0, 2.0, 2.1, 0.1], 0.7), "peak");
    assert_eq!(shape(&[2.0, 0.0, 0.1, 2.1], 0.7), "valley");
    assert_eq!(shape(&[2.0, 0.0, 2.1, 0.0], 0.7), "uneven");
}

#[test]
fn a_location_takes_what_was_measured() {
    let found = located(&simulate_gains(1, 1.0, |x, _| x < 6));
    let mut location = Location {
        stream: "frames".into(),
        polarity: "both".into(),
        rows: [0, 9],
        columns: [0, 11],
        time_ns: [0, 60_000_000],
        covariate: "dn".into(),
        shape: None,
        pixels: 120,
        pixel_list: Vec::new(),
    };
    found.copy_to(&mut location);
    assert_eq!(
        (location.columns, location.rows, &location.stream[..], location.shape.as_deref()),
        ([0, 5], [0, 9], "frames", Some("flat"))
    );
    assert!(location.pixels.abs_diff(60) <= 12, "{}", location.pixels);
}
