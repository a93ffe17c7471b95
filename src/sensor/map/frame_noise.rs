//! How noisy frames are: from pixels in which nothing happens.
//!
//! Where a pixel fires no event over three consecutive exposures, its light is nearly a straight line, and
//! the middle value less the mean of its neighbours is noise: of variance `v + (v + v) / 4` when v is a
//! value's. The median of such differences is compared with that of a normal distribution of the stated
//! noise; what is missing is added to all values alike. The median does not mind the few pixels that do
//! change.
//!
//! Light that bends without reaching a threshold looks like noise. Where many pixels are at rest the median
//! does not mind; where hardly one is, the few silent ones are those that bend a little less than a
//! threshold, and nothing is said of noise.
//!
//! Limits: one number for all values, however bright; where everything moves, noise is taken from the
//! description.

use super::problem::MapFrame;
use crate::comparator::PixelEvent;

/// With fewer differences than this, noise is taken from the description.
pub(crate) const FEWEST_DIFFERENCES: usize = 60;
/// The median of the absolute value of a normal variable of unit variance.
pub(super) const NORMAL_MEDIAN: f64 = 0.674_489_750_196_081_7;

/// A second difference of frame values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Its absolute value, DN.
    pub size_dn: f64,
    /// Its stated variance, DN^2.
    pub variance: f64,
}

/// With a smaller part of all possible differences than this, hardly a pixel is at rest.
const AT_REST: f64 = 0.1;

/// The second differences of a pixel where it is silent: no event from the start of the first exposure to the
/// end of the third.
pub fn differences<'a>(
    events: &'a [PixelEvent],
    frames: &'a [MapFrame],
) -> impl Iterator<Item = Difference> + 'a {
    frames.windows(3).filter_map(move |three| {
        let [before, here, after] = three else { return None };
        let first = events.partition_point(|event| event.t_in_ns < before.start_ns);
        let silent = events.get(first).is_none_or(|event| event.t_in_ns > after.end_ns);
        let usable = silent && !three.iter().any(|frame| frame.saturated);
        let variance = |frame: &MapFrame| frame.sigma_dn * frame.sigma_dn;
        usable.then(|| Difference {
            size_dn: (here.dn - 0.5 * (before.dn + after.dn)).abs(),
            variance: variance(here) + 0.25 * (variance(before) + variance(after)),
        })
    })
}

/// The standard deviation, DN, that has to be added in squares to every frame value for the differences to be
/// as large as they are; 0 where the stated noise explains them, where there are too few, or where they are
/// too small a part of the `possible` ones, which is their number if every pixel were silent. Reorders
/// `differences`.
pub fn missing_dn(differences: &mut [Difference], possible: usize) -> f64 {
    if differences.len() < FEWEST_DIFFERENCES || (differences.len() as f64) < AT_REST * possible as f64 {
        return 0.0;
    }
    let middle = differences.len() / 2;
    let mut median = |extra_variance: f64| {
        let relative = |d: &Difference| d.size_dn / (d.variance + 1.5 * extra_variance).sqrt();
        let (_, at, _) =
            differences.select_nth_unstable_by(middle, |a, b| relative(a).total_cmp(&relative(b)));
        relative(at)
    };
    if median(0.0) <= NORMAL_MEDIAN {
        return 0.0;
    }
    let (mut low, mut high) = (0.0, 1.0);
    while median(high * high) > NORMAL_MEDIAN && high < 1e9 {
        (low, high) = (high, 2.0 * high);
    }
    // To a thousandth.
    for _halving in 0..10 {
        let between = 0.5 * (low + high);
        if median(between * between) > NORMAL_MEDIAN {
            low = between;
        } else {
            high = between;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::random::Random;

    /// Pixels that collect `light(pixel, frame)`, read with normal noise of 5 DN of which 3 are stated.
    fn film(pixels: u64, light: impl Fn(u64, i64) -> f64) -> Vec<Vec<MapFrame>> {
        let values = |pixel: u64| {
            let mut random = Random::new(3, &[pixel]);
            (0..12).map(|l| (l, light(pixel, l) + 5.0 * random.normal())).collect::<Vec<_>>()
        };
        let frame = |(l, dn): (i64, f64)| MapFrame {
            start_ns: l * 8_000_000,
            end_ns: l * 8_000_000 + 6_000_000,
            dn,
            sigma_dn: 3.0,
            saturated: false,
        };
        (0..pixels).map(|pixel| values(pixel).into_iter().map(frame).collect()).collect()
    }

    fn missing(film: &[Vec<MapFrame>], events: &[PixelEvent]) -> f64 {
        let mut all: Vec<Difference> = film.iter().flat_map(|frames| differences(events, frames)).collect();
        missing_dn(&mut all, film.len() * 10)
    }

    #[test]
    fn noise_that_is_not_stated_is_found() {
        // 5^2 = 3^2 + 4^2. Of 2,000 differences a median is good to some 2 %, and 5 +- 0.1 leaves 4 +- 0.13.
        let found = missing(&film(200, |pixel, l| 100.0 + pixel as f64 + 3.0 * l as f64), &[]);
        assert!((found - 4.0).abs() < 0.3, "{found}");
    }

    #[test]
    fn a_few_pixels_that_change_do_not_pass_for_noise() {
        let jumps = |pixel: u64, l: i64| if pixel.is_multiple_of(10) && l % 2 == 0 { 300.0 } else { 100.0 };
        let found = missing(&film(200, jumps), &[]);
        // A tenth far outside moves the median to the quantile 0.556 of the rest: 0.765 / 0.674 times 5 DN,
        // less 3 in squares.
        assert!((found - 4.8).abs() < 0.4, "{found}");
    }

    #[test]
    fn noise_that_is_stated_is_not_added_again() {
        let mut film = film(200, |_, _| 100.0);
        film.iter_mut().flatten().for_each(|frame| frame.sigma_dn = 5.5);
        assert_eq!(missing(&film, &[]), 0.0);
    }

    #[test]
    fn pixels_that_fire_are_left_out() {
        let event = |l: i64| PixelEvent {
            t_in_ns: l * 8_000_000 + 3_000_000,
            t_off_ns: l * 8_000_000 + 3_001_000,
            polarity: 1,
        };
        let busy: Vec<PixelEvent> = (0..12).step_by(3).map(event).collect();
        let film = film(200, |_, _| 100.0);
        assert_eq!(film.iter().flat_map(|frames| differences(&busy, frames)).count(), 0);
        assert_eq!(missing(&film, &busy), 0.0);
    }

    #[test]
    fn light_that_bends_without_events_is_no_noise_where_nothing_is_at_rest() {
        // Light swings by 4 % of itself, the noise is stated. Of a hundred times as many differences these
        // are the silent ones.
        let found = |possible: usize| {
            let mut film = film(200, |_, l| if l % 2 == 0 { 98.0 } else { 102.0 });
            film.iter_mut().flatten().for_each(|frame| frame.sigma_dn = 5.0);
            let mut all: Vec<Difference> = film.iter().flat_map(|frames| differences(&[], frames)).collect();
            missing_dn(&mut all, possible)
        };
        assert!(found(2_000) > 1.0);
        assert_eq!(found(200_000), 0.0);
    }
}
