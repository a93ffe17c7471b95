//! Claims about the conditional model: against the solver's own residuals, and against simulated recordings with effects.

use super::features::{Bench, Metric};
use super::view::{Prepared, View};
use super::{LikelihoodSetting, likelihood};
use crate::candidates::{CANDIDATES, Scales, Trial};
use crate::case::PixelEvents;
use crate::nominal::Nominal;
use crate::record::Conditions;
use crate::sample::Sample;
use crate::scene::{Scene, SceneSetting, task};
use crate::testing;
use photocurrent_sensor::conditional::{Conditional, Look, Track, conditional};
use photocurrent_sensor::map::{Column, MapWorkspace, Whitened, whiten};

#[test]
fn without_effects_residuals_are_those_of_the_solver() {
    let case = testing::case();
    let nominal = case.nominal().unwrap();
    let sample = Sample::all(&case, 4);
    let setting = SceneSetting::default();
    let scene = Scene::estimate(&case, &nominal, &sample, &setting);
    let view = View::new(&case, &nominal, &sample, &scene, &setting);
    let mut compared = 0;
    for n in [0, 17, 63, 100] {
        let (t, u) = scene.pixel(n);
        // No step is cut, so that the voltage is exactly that of the solver's segments.
        let track = Track::new(t, u, i64::MAX / 4);
        let (events, frames) = &view.data[n];
        let mut seen = Conditional::default();
        let site = case.site(sample.pixels[n] as usize, 0);
        conditional(&nominal, &[], &Look { site, track: &track, seen: None, events, frames }, &mut seen);
        let mut whitened = Whitened::default();
        whiten(&task(&case, &setting, &view.data[n], nominal.map_sensor(), &[]), u, Column::default(), &[], &mut MapWorkspace::default(), &mut whitened);
        for (measurement, residual) in whitened.measurement.iter().zip(&whitened.residual) {
            let measurement = *measurement as usize;
            if measurement < events.len() {
                assert!((residual + seen.excess[measurement]).abs() < 1e-9, "pixel {n}, event {measurement}");
                compared += 1;
            } else {
                let l = measurement - events.len();
                assert!((residual - (frames[l].dn - seen.dn[l])).abs() < 1e-6, "pixel {n}, frame {l}");
            }
        }
    }
    assert!(compared > 30, "{compared} events");
}

/// Median miss of events, the miss that one in forty exceeds (natural-log units), and the median of frames (DN), of a recording at its true light.
fn misses(case: &crate::case::Case, nominal: &Nominal, trial: &Trial) -> (f64, f64, f64) {
    let sample = Sample::all(case, 4);
    let scene: Scene = testing::scene(case);
    let view = View::in_steps(case, nominal, &sample, &scene, &SceneSetting::default(), 100_000);
    let prepared = Prepared::new(case, trial).unwrap();
    let (mut events, mut frames) = (Vec::new(), Vec::new());
    let mut seen = Conditional::default();
    for n in 0..sample.len() {
        view.through(&prepared, n, &mut seen);
        events.extend((0..seen.excess.len()).filter(|&k| seen.is_armed[k]).map(|k| seen.excess[k].abs()));
        frames.extend(view.data[n].1.iter().zip(&seen.dn).map(|(frame, dn)| (frame.dn - dn).abs()));
    }
    events.sort_by(f64::total_cmp);
    frames.sort_by(f64::total_cmp);
    (events[events.len() / 2], events[events.len() * 39 / 40], frames[frames.len() / 2])
}

#[test]
fn events_of_an_effect_are_explained_by_the_same_effect_and_by_nothing_less() {
    let clean = testing::case();
    let nominal = clean.nominal().unwrap();
    let scales = Scales::of(&clean, &nominal);
    let (mut tried, mut wrong) = (0, Vec::new());
    for candidate in CANDIDATES.iter().filter(|candidate| !candidate.is_random) {
        // Stamps on a coarse grid lose what they were; a queue needs the load of the whole array; a curve of the frames needs a stated full pixel.
        if ["timestamp_quantization", "readout_queue", "frame_nonlinearity"].contains(&candidate.id) || candidate.parameter == "reset" {
            continue;
        }
        let trial = Trial::with(&nominal, candidate, 1.0, &scales);
        let case = testing::case_with(&trial.effects);
        let (stated, with) = (misses(&case, &nominal, &Trial::stated(&nominal)), misses(&case, &nominal, &trial));
        // The simulator's light is linear where the scene's is log-linear: a thousandth.
        let is_explained = with.0 < 1.5e-3 && with.2 < 0.3;
        let is_missed = stated.0 > 2.0 * with.0 || stated.1 > 2.0 * with.1 || stated.2 > 4.0 * with.2.max(0.1);
        if !(is_explained && is_missed) {
            wrong.push(format!("{}: stated {stated:?}, with the effect {with:?}", candidate.label()));
        }
        tried += 1;
    }
    assert!(wrong.is_empty() && tried > 25, "{tried} tried: {wrong:#?}");
}

/// As in [`LikelihoodSetting::default`], for an array of 12 x 10 pixels.
fn small() -> LikelihoodSetting {
    LikelihoodSetting { zones: (2, 2), refined: [4, 4, 0, 0], calibrated: 1, ..LikelihoodSetting::default() }
}

#[test]
fn a_leak_is_named_with_its_rate_and_a_clean_recording_raises_no_alarm() {
    let clean = testing::case();
    let nominal = clean.nominal().unwrap();
    let nothing = likelihood(&clean, &nominal, &LikelihoodSetting { refined: [0; 4], calibrated: 0, ..small() }).unwrap();
    let scales = Scales::of(&clean, &nominal);
    let (candidate, kind) = CANDIDATES.iter().enumerate().find(|(_, kind)| kind.id == "leak_events").unwrap();
    let trial = Trial::with(&nominal, kind, 1.0, &scales);
    let found = likelihood(&testing::case_with(&trial.effects), &nominal, &small()).unwrap();
    assert!(!nothing.is_alarm && found.is_alarm, "{:?}\n{:?}", nothing.proposals.first(), found.proposals.first());
    let leak = found.proposals.iter().find(|proposal| proposal.candidate == candidate).unwrap();
    // On a few pixels of one brightness others are much alike: a leak in proportion to light, thresholds apart.
    let best = &found.proposals[0];
    assert!(leak.statistic > 0.8 * best.statistic, "{leak:?}\n{best:?}");
    // The scene takes over a part of a leak and gives back another's: strengths are good to a factor of one and a half.
    assert!(leak.value > 12.0 / 1.5 && leak.value < 12.0 * 1.5, "{} Hz", leak.value);
    let detectable = found.detectability.iter().find(|detectable| detectable.candidate == candidate).unwrap();
    assert!(detectable.not_testable.is_none() && detectable.minimal_detectable < 6.0, "{detectable:?}");
}

#[test]
fn a_recording_without_events_is_refused_with_what_to_do() {
    let mut case = testing::case();
    case.events = PixelEvents::new(vec![Vec::new(); case.extent.pixels()]);
    let why = likelihood(&case, &case.nominal().unwrap(), &small()).unwrap_err();
    assert!(why.contains("5 x 5 pixels") && why.contains("record more change"), "{why}");
}

#[test]
fn features_are_the_same_bits_for_one_thread_and_three() {
    let case = testing::case();
    let nominal = case.nominal().unwrap();
    let (sample, scales, setting) = (Sample::all(&case, 4), Scales::of(&case, &nominal), small());
    let priors = vec![setting.scene.options.prior; sample.len()];
    let conditions = Conditions::default();
    let bench = Bench { case: &case, nominal: &nominal, sample: &sample, setting: &setting.scene, scales: &scales, conditions, priors: &priors };
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bench.measure(&case).unwrap().1.sum())
    };
    let (one, three) = (with(1), with(3));
    assert!(one.values.iter().any(|value| *value != 0.0));
    assert_eq!((one.values, one.information), (three.values, three.information));
}

#[test]
fn products_of_whitened_values_are_those_of_the_inverse_covariance() {
    // [[4, 2], [2, 5]] has the inverse [[5, -2], [-2, 4]] / 16.
    let metric = Metric::new(vec![vec![4.0, 0.0], vec![2.0, 5.0]]);
    let (a, b) = (metric.whitened(&[3.0, 1.0]), metric.whitened(&[1.0, 2.0]));
    let product = a[0] * b[0] + a[1] * b[1];
    // (3, 1) (5 - 4, -2 + 8) / 16
    assert!((product - 9.0 / 16.0).abs() < 1e-12, "{product}");
}
