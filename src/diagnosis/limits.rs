//! Limits of detection relative to usual sizes: which effects a recording would have shown.

use crate::report::MinimumDetectable;
use crate::units::readable;

/// The smaller limit of each parameter, of two scenes on either of which an effect would have been found.
pub(crate) fn smaller_limits(
    one: &[MinimumDetectable],
    other: &[MinimumDetectable],
) -> Vec<MinimumDetectable> {
    let is_same = |a: &MinimumDetectable, b: &MinimumDetectable| a.id == b.id && a.parameter == b.parameter;
    let smaller = |own: &MinimumDetectable| {
        let there = other.iter().find(|there| is_same(own, there));
        there.filter(|there| there.minimal_detectable < own.minimal_detectable).unwrap_or(own).clone()
    };
    let only_there = other.iter().filter(|there| one.iter().all(|own| !is_same(own, there)));
    one.iter().map(smaller).chain(only_there.cloned()).collect()
}

/// Effects that would have been found at their usual size, and those that would not, by id, in the order
/// of the limits: an effect is found by any of its parameters.
pub(crate) fn seen_and_unseen(limits: &[MinimumDetectable]) -> (Vec<&str>, Vec<&str>) {
    let mut ids: Vec<&str> = Vec::new();
    limits.iter().filter(|one| one.usual.is_some()).for_each(|one| {
        if !ids.contains(&&one.id[..]) {
            ids.push(&one.id);
        }
    });
    ids.into_iter().partition(|id| limits.iter().any(|one| one.id == *id && times(one) <= 1.0))
}

/// A limit over the usual size.
fn times(limit: &MinimumDetectable) -> f64 {
    limit.usual.map_or(f64::INFINITY, |usual| limit.minimal_detectable / usual)
}

/// Most effects that a sentence lists.
const MOST_LISTED: usize = 3;

/// Reason why no finding is inconclusive: no effect of its usual size would have been detected. `None` where
/// one would, or where no limit is known.
pub(crate) fn nothing_would_show(limits: &[MinimumDetectable]) -> Option<String> {
    let (seen, unseen) = seen_and_unseen(limits);
    if !seen.is_empty() || unseen.is_empty() {
        return None;
    }
    let mut near: Vec<&MinimumDetectable> = limits.iter().filter(|one| times(one).is_finite()).collect();
    near.sort_by(|a, b| times(a).total_cmp(&times(b)));
    let one = |of: &&MinimumDetectable| {
        let [limit, usual] =
            [of.minimal_detectable, of.usual.unwrap_or(0.0)].map(|value| readable(value, &of.unit));
        format!("{} ({}) from {limit} on, usual is {usual}", of.id, of.parameter)
    };
    let nearest: Vec<String> = near.iter().take(MOST_LISTED).map(one).collect();
    Some(format!(
        "on this scene none of {} effects would be seen at its usual size; nearest: {}",
        unseen.len(),
        nearest.join("; ")
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limit(id: &str, parameter: &str, minimal_detectable: f64, usual: Option<f64>) -> MinimumDetectable {
        MinimumDetectable {
            id: id.into(),
            parameter: parameter.into(),
            minimal_detectable,
            usual,
            unit: "s".into(),
            ..MinimumDetectable::default()
        }
    }

    #[test]
    fn an_effect_is_seen_by_any_of_its_parameters() {
        let limits = [
            limit("clock_offset", "offset_s", 2e-4, Some(1e-4)),
            limit("second_pole", "tau_s", 2e-4, Some(1e-4)),
            limit("second_pole", "tau_light_s", 1e-4, Some(1e-4)),
            limit("reset_rule", "rule", 1.0, None),
        ];
        assert_eq!(seen_and_unseen(&limits), (vec!["second_pole"], vec!["clock_offset"]));
        assert_eq!(nothing_would_show(&limits), None);
        let why = nothing_would_show(&limits[..2]).unwrap();
        assert!(why.contains("none of 2 effects"), "{why}");
        assert!(why.contains("clock_offset (offset_s) from 200 us on, usual is 100 us"), "{why}");
        assert_eq!(nothing_would_show(&limits[3..]), None);
        assert_eq!(nothing_would_show(&[]), None);
    }

    #[test]
    fn of_two_scenes_the_smaller_limit_counts() {
        let one = [limit("a", "p", 2.0, None), limit("b", "p", 1.0, None)];
        let other = [limit("a", "p", 1.0, None), limit("b", "p", 3.0, None), limit("c", "p", 4.0, None)];
        let smaller: Vec<f64> = smaller_limits(&one, &other).iter().map(|of| of.minimal_detectable).collect();
        assert_eq!(smaller, [1.0, 1.0, 4.0]);
    }
}
