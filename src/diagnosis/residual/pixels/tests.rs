//! Sound and faulty recordings on the light of their pixels.

use super::*;
use crate::scenes::MadeUp;
use photocurrent_core::Extent;

/// The first of photographs that shake with many events, on a small array: its motion is not given.
fn busy() -> MadeUp {
    let of = |index: u64| MadeUp::photograph(5, index, Extent { width: 24, height: 20 }, 0.08);
    let is_busy = |made: &MadeUp| made.recording().is_ok_and(|case| case.events.len() > 4_000);
    (0..20).map(of).find(is_busy).unwrap()
}

fn best(case: &Case) -> (Evidence, Option<Ranked>) {
    let found = evidence(case, &case.nominal().unwrap()).unwrap();
    let first = found.first.clone();
    (found, first)
}

#[test]
fn a_sound_recording_gains_nothing_by_any_effect() {
    let (found, first) = best(&busy().recording().unwrap());
    assert_eq!(found.scene, "pixels");
    assert!(found.events > 300, "{}", found.events);
    let gain = first.map_or(0.0, |one| one.gain);
    assert!(gain < 0.02, "{gain}");
}

#[test]
fn an_effect_is_found_where_nothing_moves_as_one_with_its_size() {
    let scene = busy().with_frame_noise(Some((10.0, 2.0)));
    let plain = scene.recording().unwrap();
    let nominal = plain.nominal().unwrap();
    let scales = Scales::of(&plain, &nominal);
    let candidate = crate::candidates::Candidate::find("leak_events", "rate").unwrap();
    let trial = Trial::with(&nominal, candidate, 1.0, &scales);
    let (_, first) = best(&scene.recording_through(Some(&trial)).unwrap());
    let first = first.unwrap();
    assert_eq!(CANDIDATES[first.candidate].id, "leak_events");
    assert!(first.gain > 0.1 && (first.effect_size - 1.0).abs() < 0.15, "{first:?}");
}

#[test]
fn what_an_event_is_explained_by_follows_its_noise() {
    // The probability of |t| < 2 with three degrees of freedom is 0.8607.
    assert!((explained(0.01) - 0.8607).abs() < 1e-3);
    assert!(explained(0.3) < 0.06);
}

#[test]
fn without_frames_there_is_no_light_to_begin_with() {
    let case = Case { frames: None, ..busy().recording().unwrap() };
    let why = evidence(&case, &case.nominal().unwrap()).unwrap_err();
    assert!(why.contains("no frames"), "{why}");
}
