//! 95 % intervals of the direct tests' estimates by the delete-a-group jackknife: each test is repeated ten
//! times, each time without a tenth of the array.
//!
//! The array is cut into blocks of 8 x 8 pixels, which are dealt in pairs to ten groups. The differences
//! between groups give the standard error (Shao and Tu, *The Jackknife and Bootstrap*, 1995, section 2.3),
//! Student's t gives the interval. The error that all groups share ([`common_standard_error`]) is added in
//! quadrature. In a recording with more than [`MANY`] events each group is evaluated alone, so that all ten
//! cost one pass.
//!
//! Limits: an estimate that is wrong everywhere by more than [`common_standard_error`] gets a narrow interval
//! around the wrong value: assumptions of a test are not checked. A test that finds nothing in more than
//! three groups is near its threshold and gets no interval. Nor do arrays of too few blocks.

use super::array::BLOCK;
use super::departure::Departure;
use photocurrent_scene::case::Case;
use rayon::prelude::*;

/// Parts of the array.
const GROUPS: usize = 10;
/// Least number of groups in which the test must confirm its finding.
const FEWEST: usize = 7;
/// The 97.5 % quantile of the normal distribution.
const NORMAL: f64 = 1.96;
/// Number of events from which each group is evaluated alone.
const MANY: usize = 2_000_000;

/// The group of a pixel. Blocks are those of [`super::array::half`]; of two that follow each other one is of
/// each half, or the rows below bring the other.
fn group(case: &Case, pixel: usize) -> usize {
    let (x, y) = case.pixel_place(pixel);
    let block = y / BLOCK * case.extent.width.div_ceil(BLOCK) + x / BLOCK;
    block as usize % (2 * GROUPS) / 2
}

/// Repeats tests on a recording without the listed pixels.
type TestsAgain<'a> = &'a (dyn Fn(&Case, &[u32]) -> Vec<Departure> + Sync);

/// Has a finding a number without an interval?
pub(crate) fn lacks_interval(finding: &Departure) -> bool {
    finding.parameters.iter().any(|(name, _)| finding.interval(name).is_none())
}

/// Adds intervals to findings. `again` makes the same tests of a recording in which the pixels of the list
/// have no events and are left out.
pub(crate) fn add_intervals(case: &Case, findings: &mut [Departure], again: TestsAgain<'_>) {
    if !findings.iter().any(lacks_interval) {
        return;
    }
    let is_alone = case.events.len() > MANY;
    let groups: Vec<usize> = (0..case.extent.pixels()).map(|pixel| group(case, pixel)).collect();
    let is_empty = |number: usize| {
        groups
            .iter()
            .zip(0..)
            .all(|(group, pixel)| *group != number || case.events.of_pixel(pixel).is_empty())
    };
    if (0..GROUPS).any(is_empty) {
        return;
    }
    let part = |number: usize| -> Vec<Departure> {
        let out: Vec<u32> = groups
            .iter()
            .zip(0..)
            .filter(|(group, _)| (**group == number) != is_alone)
            .map(|(_, pixel)| pixel)
            .collect();
        again(
            &Case {
                events: case.events.without_pixels(&out),
                sensor: case.sensor.clone(),
                frames: case.frames.clone(),
                ..*case
            },
            &out,
        )
    };
    let parts: Vec<Vec<Departure>> = (0..GROUPS).into_par_iter().map(part).collect();
    for finding in findings {
        let same = |part: &Vec<Departure>, name: &str| -> Option<f64> {
            let twin =
                part.iter().find(|other| other.id == finding.id && other.threshold == finding.threshold)?;
            twin.value(name)
        };
        let unknown = finding.parameters.iter().filter(|(name, _)| finding.interval(name).is_none());
        let found = unknown.filter_map(|(name, value)| {
            let values: Vec<f64> = parts.iter().filter_map(|part| same(part, name)).collect();
            if values.len() < FEWEST {
                return None;
            }
            let (apart, common) = (
                student(values.len()) * standard_error(&values, is_alone),
                NORMAL * common_standard_error(finding, *value),
            );
            let reach = libm::sqrt(apart * apart + common * common);
            // Parameters that no part changes (the period of the frames) are not estimated from them.
            (reach > 1e-9 * value.abs()).then_some((*name, [value - reach, value + reach]))
        });
        finding.ci95 = found.collect::<Vec<_>>().into_iter().chain(finding.ci95.clone()).collect();
    }
}

/// The 97.5 % quantile of Student's t for so many groups, less one degree of freedom.
fn student(groups: usize) -> f64 {
    match groups {
        10.. => 2.262,
        9 => 2.306,
        8 => 2.365,
        _ => 2.447,
    }
}

/// Standard error that all groups share: the test's error on simulated recordings (`again_tests.rs`), or the
/// one that its file states.
fn common_standard_error(finding: &Departure, value: f64) -> f64 {
    match finding.id {
        "hot_rows" | "hot_pixels" => 0.01 * value.abs(),
        "clock_offset" => 0.05 * value.abs(),
        // A twentieth of the threshold itself.
        "threshold_scale" | "threshold_asymmetry" => 0.05 * (1.0 + value),
        // By what the light loses; read off the shortest intervals it has no such error.
        "refractory" if finding.heldout.is_some() => 0.15 * value.abs(),
        "dark_current" => 0.15 * value.abs(),
        _ => 0.0,
    }
}

/// Of the whole, from estimates without each group, or of each group alone.
fn standard_error(values: &[f64], is_alone: bool) -> f64 {
    let (n, groups) = (values.len() as f64, GROUPS as f64);
    let mean = values.iter().sum::<f64>() / n;
    let variance: f64 = values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / (n - 1.0);
    libm::sqrt(if is_alone { variance / groups } else { variance * (groups - 1.0) * (groups - 1.0) / groups })
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::Extent;
    use photocurrent_core::random::Random;

    #[test]
    fn the_standard_error_of_a_mean_comes_back() {
        // A mean of 1,000 normal values in ten groups: without each, or of each, the standard error is 1 /
        // sqrt(1000) on average.
        let (mut without, mut alone) = (0.0, 0.0);
        for seed in 0..200 {
            let mut random = Random::new(seed, &[]);
            let sums: Vec<f64> = (0..GROUPS).map(|_| (0..100).map(|_| random.normal()).sum()).collect();
            let all: f64 = sums.iter().sum();
            without += standard_error(&sums.iter().map(|sum| (all - sum) / 900.0).collect::<Vec<_>>(), false)
                .powi(2)
                / 200.0;
            alone +=
                standard_error(&sums.iter().map(|sum| sum / 100.0).collect::<Vec<_>>(), true).powi(2) / 200.0;
        }
        assert!(
            (without * 1000.0 - 1.0).abs() < 0.1 && (alone * 1000.0 - 1.0).abs() < 0.1,
            "{without} {alone}"
        );
    }

    #[test]
    fn groups_are_alike_and_have_both_halves() {
        for (width, height) in [(96, 72), (88, 72), (346, 260)] {
            let case = Case { extent: Extent { width, height }, ..crate::testing::case() };
            let (all, mut pixels) = (f64::from(width * height), [[0.0; 2]; GROUPS]);
            (0..case.extent.pixels()).for_each(|pixel| {
                pixels[group(&case, pixel)][super::super::array::half(&case, pixel)] += 20.0 / all
            });
            assert!(
                pixels.iter().flatten().all(|share| (0.8..1.25).contains(share)),
                "{width} x {height}: {pixels:?}"
            );
        }
    }
}
