//! Coverage of the direct tests' intervals, on recordings whose fault was inserted by hand.

use super::changes_tests::seeded;
use super::still_tests::leaking;
use super::tests::{add, bursts_on, wide_wave_on, with_changed_events};
use super::{Integrity, integrity};
use photocurrent_core::Extent;
use photocurrent_core::random::Random;
use photocurrent_scene::case::Case;

/// Of `seeds` recordings: number with an interval for the parameter, number of these that contain the truth,
/// and mean estimate over the truth.
fn interval_coverage(
    seeds: u64,
    of: impl Fn(u64) -> Case,
    id: &str,
    parameter: &str,
    truth: f64,
) -> (usize, usize, f64) {
    let found: Vec<Integrity> =
        (0..seeds).map(of).map(|case| integrity(&case, case.nominal().ok().as_ref())).collect();
    let all = found.iter().flat_map(|found| &found.findings).filter(|finding| finding.id == id);
    let with: Vec<(f64, [f64; 2])> =
        all.filter_map(|finding| Some((finding.value(parameter)?, finding.interval(parameter)?))).collect();
    let holding = with.iter().filter(|(_, [low, high])| (*low..=*high).contains(&truth)).count();
    let mean = with.iter().map(|one| one.0).sum::<f64>() / with.len().max(1) as f64;
    let width = with.iter().map(|(_, [low, high])| high - low).sum::<f64>() / with.len().max(1) as f64;
    eprintln!(
        "{id}.{parameter}: {} intervals, {holding} hold the truth, mean {:.4} of it, half width {:.4}",
        with.len(),
        mean / truth,
        0.5 * width / truth
    );
    (with.len(), holding, mean / truth)
}

const SIZE: Extent = Extent { width: 64, height: 48 };

/// A recording in which three pixels, or a row, fire `count` times more than others.
fn case_with_hot_pixels(seed: u64, pixels: &[usize], count: usize) -> Case {
    let mut random = Random::new(seed, &[8]);
    with_changed_events(bursts_on(SIZE, seed, 1000), |pixel, events| {
        if pixels.contains(&pixel) {
            add(events, &mut random, count, -1);
        }
    })
}

fn assert_coverage(seeds: u64) {
    let rate = interval_coverage(seeds, |seed| leaking(seed, 0.2), "leak_events", "rate", 0.2);
    let noise = |seed| {
        let mut random = Random::new(seed, &[16]);
        with_changed_events(wide_wave_on(bursts_on(SIZE, seed, 1000), seed), |_, events| {
            for n in 0..6 {
                let comes = usize::from(random.uniform() < 0.5);
                add(events, &mut random, comes, if n % 2 == 0 { 1 } else { -1 });
            }
        })
    };
    // Three of six that may come in 0.3 s.
    let noise = interval_coverage(seeds, noise, "background_activity", "rate", 10.0);
    let row: Vec<usize> = (20 * 64..21 * 64).collect();
    let rows =
        interval_coverage(seeds, |seed| case_with_hot_pixels(seed, &row, 40), "hot_rows", "rate", 40.0 / 0.3);
    let many: Vec<usize> = (0..30).map(|n| (3 + n / 6 * 9) * 64 + 5 + n % 6 * 10).collect();
    let pixels = interval_coverage(
        seeds,
        |seed| case_with_hot_pixels(seed, &many, 200),
        "hot_pixels",
        "rate",
        200.0 / 0.3,
    );
    let late = interval_coverage(seeds, |seed| seeded(seed, 4_000_000, 0), "clock_offset", "offset", 4e-3);
    let blind = interval_coverage(seeds, |seed| seeded(seed, 0, 3_000_000), "refractory", "refractory", 3e-3);
    let all = [
        ("leak", rate),
        ("noise", noise),
        ("rows", rows),
        ("pixels", pixels),
        ("late", late),
        ("blind", blind),
    ];
    for (what, (intervals, holding, mean)) in all {
        assert!(
            10 * intervals >= 8 * seeds as usize && (0.8..1.25).contains(&mean),
            "{what}: {intervals} {holding} {mean}"
        );
        assert!(
            seeds < 10 || 10 * holding >= 8 * intervals,
            "{what}: {holding} of {intervals} hold the truth"
        );
    }
    let [intervals, holding] =
        [0, 1].map(|which| all.iter().map(|(_, of)| if which == 0 { of.0 } else { of.1 }).sum::<usize>());
    assert!(10 * holding >= 8 * intervals, "{holding} of {intervals} hold the truth");
}

#[test]
fn intervals_hold_the_truth() {
    assert_coverage(2);
}

#[test]
#[ignore = "takes minutes; the counts are those of docs/diagnosis.md"]
fn intervals_hold_the_truth_as_often_as_the_pages_say() {
    assert_coverage(20);
}
