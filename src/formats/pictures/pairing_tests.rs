//! Pictures and pulses of which some are missing: the pairing is the true one or a question.

use super::{Candidate, Sides, Unclear};
use crate::declared::{Declared, Pairing};
use crate::pictures::stamps::Row;
use proptest::prelude::*;

/// Pulses every 20 ms, those of `kept` alone.
fn pulses(kept: &[usize]) -> Vec<Row> {
    // Times of a real camera are uneven by a few microseconds.
    kept.iter().map(|n| Row::at(*n as i64 * 20_000_000 + (*n as i64 * 7919) % 5000, None, true)).collect()
}

fn names(kept: &[usize]) -> Vec<String> {
    kept.iter().map(|n| format!("cam1_{n:06}.png")).collect()
}

/// Numbers from 0 without some.
fn without(count: usize, gone: &[usize]) -> Vec<usize> {
    (0..count).filter(|n| !gone.contains(n)).collect()
}

fn decided(pictures: &[usize], times: &[usize]) -> Result<Vec<(usize, usize)>, Unclear> {
    let sides = Sides::new(&names(pictures), &pulses(times));
    let candidate = sides.decide(&Declared::default())?;
    // As the numbers that each had.
    Ok(candidate
        .map_or_else(Vec::new, |candidate| sides.pairs(&candidate))
        .into_iter()
        .map(|(picture, time)| (pictures[picture], times[time]))
        .collect())
}

fn is_true(pairs: &[(usize, usize)], pictures: &[usize], times: &[usize]) -> bool {
    let both = pictures.iter().filter(|n| times.contains(n)).count();
    pairs.len() == both && pairs.iter().all(|(picture, time)| picture == time)
}

#[test]
fn a_picture_that_is_lost_leaves_a_hole_in_the_numbers() {
    let (pictures, times) = (without(15, &[5]), without(15, &[]));
    assert!(is_true(&decided(&pictures, &times).unwrap(), &pictures, &times));
    let (pictures, times) = (without(15, &[5, 6, 9]), without(15, &[]));
    assert!(is_true(&decided(&pictures, &times).unwrap(), &pictures, &times));
}

#[test]
fn a_pulse_that_is_lost_leaves_a_gap_of_two_periods() {
    let (pictures, times) = (without(15, &[]), without(15, &[5]));
    assert!(is_true(&decided(&pictures, &times).unwrap(), &pictures, &times));
    // Both sides miss one: counts are equal, and the order is wrong for the four between.
    let (pictures, times) = (without(15, &[9]), without(15, &[5]));
    assert!(is_true(&decided(&pictures, &times).unwrap(), &pictures, &times));
}

/// As in uzh-rpg/DSEC#50, whose names count by twos.
#[test]
fn every_second_picture_of_a_camera_that_is_triggered_each_time_is_paired() {
    let (pictures, times): (Vec<usize>, Vec<usize>) = ((0..15).map(|n| 2 * n).collect(), (0..29).collect());
    assert!(is_true(&decided(&pictures, &times).unwrap(), &pictures, &times));
    // Names that count by tens count no pulses.
    let pictures: Vec<usize> = (0..15).map(|n| 10 * n).collect();
    assert_eq!(
        decided(&pictures, &without(15, &[])).unwrap(),
        (0..15).map(|n| (10 * n, n)).collect::<Vec<_>>()
    );
}

/// As in AravisProject/aravis#818: after a pause the camera drops the first picture of a triggered series;
/// and in AllenInstitute/AllenSDK#2307: a picture too many stands first.
#[test]
fn one_too_many_at_an_end_is_a_question() {
    for (pictures, times) in [(14, 15), (15, 14), (1, 2), (3, 40)] {
        let unclear = decided(&without(pictures, &[]), &without(times, &[])).unwrap_err();
        assert_eq!(unclear.best.cost, unclear.second.cost, "{unclear:?}");
    }
    let sides = Sides::new(&names(&without(14, &[])), &pulses(&without(15, &[])));
    let stated = |first| {
        sides
            .decide(&Declared { first_pulse: Some(first), ..Declared::default() })
            .unwrap()
            .map(|candidate| sides.pairs(&candidate))
    };
    assert_eq!(stated(1).unwrap(), (0..14).map(|n| (n, n + 1)).collect::<Vec<_>>());
    assert_eq!(stated(-1).unwrap(), (0..13).map(|n| (n + 1, n)).collect::<Vec<_>>());
    assert_eq!(stated(99), None);
}

/// As in czbiohub-sf/shrimPy#26, where a picture was dropped or a pulse was missed, and both look alike.
#[test]
fn a_gap_with_equal_counts_is_a_question_for_pulses_and_none_for_stamps() {
    let (pictures, times) = (without(14, &[]), without(15, &[5]));
    let unclear = decided(&pictures, &times).unwrap_err();
    assert_ne!(unclear.best.by, unclear.second.by);
    // A line of stamps is written with its picture: a camera that dropped frames.
    let rows: Vec<Row> = pulses(&times).into_iter().zip(1..).map(|(row, line)| Row { line, ..row }).collect();
    assert_eq!(
        Sides::new(&names(&pictures), &rows).decide(&Declared::default()),
        Ok(Some(Candidate { by: Pairing::Order, first: 0, cost: 0 }))
    );
}

/// As in JARVIS-MoCap/JARVIS-AcquisitionTool#19: the numbers of the frames begin anywhere.
#[test]
fn numbers_that_begin_anywhere_and_begin_anew_pair_by_order() {
    let pictures: Vec<usize> = (2534..2549).collect();
    assert_eq!(
        decided(&pictures, &without(15, &[])).unwrap(),
        pictures.iter().copied().zip(0..15).collect::<Vec<_>>()
    );
    let pictures: Vec<usize> = (0..10).chain(1_000..1_005).collect();
    assert_eq!(
        decided(&pictures, &without(15, &[])).unwrap(),
        pictures.iter().copied().zip(0..15).collect::<Vec<_>>()
    );
    // A pause of the generator is no gap of whole periods.
    let mut rows = pulses(&without(15, &[]));
    rows[7..].iter_mut().for_each(|row| row.at += 47_000_000);
    assert_eq!(
        Sides::new(&names(&without(15, &[])), &rows)
            .decide(&Declared::default())
            .unwrap()
            .map(|candidate| candidate.first),
        Some(0)
    );
}

/// As in uzh-rpg/rpg_timelens#36: 334 pictures and 284 stamps, which are those of the first pictures.
#[test]
fn stamps_that_count_pictures_are_paired_by_number() {
    let rows = |from: i64, count: i64| {
        (0..count)
            .map(|n| Row { index: Some(from + n), line: n as u64 + 1, ..Row::at(n * 1_000_000, None, true) })
            .collect::<Vec<_>>()
    };
    let sides = Sides::new(&names(&without(334, &[])), &rows(0, 284));
    assert_eq!(
        sides.decide(&Declared::default()).unwrap().map(|candidate| sides.pairs(&candidate)),
        Some((0..284).map(|n| (n, n)).collect())
    );
    // The stamps of the last ones.
    let sides = Sides::new(&names(&without(334, &[])), &rows(50, 284));
    assert_eq!(sides.decide(&Declared::default()).unwrap().map(|candidate| candidate.first), Some(-50));
    // One counts from 0, the other from 1, or one of both misses its first.
    let from_one: Vec<usize> = (1..334).collect();
    assert!(Sides::new(&names(&from_one), &rows(0, 334)).decide(&Declared::default()).is_err());
}

#[test]
fn a_recording_that_begins_inside_an_exposure_misses_no_picture() {
    let mut rows = pulses(&without(16, &[]));
    rows[0].is_whole = false;
    let first = |pictures: usize, rows: &[Row]| {
        Sides::new(&names(&without(pictures, &[])), rows)
            .decide(&Declared::default())
            .map(|found| found.map(|one| one.first))
    };
    assert_eq!((first(15, &rows), first(16, &rows)), (Ok(Some(1)), Ok(Some(0))));
    rows[15].is_whole = false;
    assert_eq!(first(14, &rows), Ok(Some(1)));
    assert!(first(15, &rows).is_err(), "the first or the last of both was not taken");
}

#[test]
fn numbers_of_any_size_take_no_memory() {
    let names: Vec<String> = ["a_1.png", "a_9223372036854775807.png"].map(String::from).to_vec();
    let rows = [
        Row::at(i64::MIN, None, true),
        Row::at(0, None, true),
        Row { index: Some(3), ..Row::at(i64::MAX, None, true) },
    ];
    let sides = Sides::new(&names, &rows);
    assert!(sides.candidates(&Declared::default()).len() < 1000);
    let rows: Vec<Row> =
        [0, i64::MAX].map(|index| Row { index: Some(index), ..Row::at(index, None, true) }).to_vec();
    assert!(Sides::new(&names, &rows).candidates(&Declared::default()).len() < 1000);
}

/// Some of so many, the most of them kept.
fn gone(count: usize) -> impl Strategy<Value = Vec<usize>> {
    proptest::collection::vec(1..count - 1, 0..5)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// What is lost between the first and the last is found, or is a question.
    #[test]
    fn what_is_lost_within_is_paired_truly_or_not_at_all(pictures in gone(30), times in gone(30)) {
        let (pictures, times) = (without(30, &pictures), without(30, &times));
        match decided(&pictures, &times) {
            Ok(pairs) => prop_assert!(is_true(&pairs, &pictures, &times), "{pairs:?}"),
            Err(unclear) => prop_assert!(false, "ends that are there leave no doubt: {unclear:?}"),
        }
    }

    /// At the ends of one side too.
    #[test]
    fn what_is_lost_at_the_ends_of_one_side_is_paired_truly_or_is_a_question(
        within in (gone(30), gone(30)), ends in (0_usize..4, 0_usize..4), of_pictures in any::<bool>()
    ) {
        let (mut pictures, mut times) = (without(30, &within.0), without(30, &within.1));
        let side = if of_pictures { &mut pictures } else { &mut times };
        side.retain(|n| (ends.0..30 - ends.1).contains(n));
        if let Ok(pairs) = decided(&pictures, &times) {
            prop_assert!(is_true(&pairs, &pictures, &times), "{pairs:?}");
        }
    }
}
