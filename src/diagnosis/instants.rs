//! Instants of every pixel, whether or not it fires then: what a rate of events without light may depend on is asked at these.

use crate::case::Case;
use crate::closures::Change;
use crate::covariates::{Covariate, Surroundings};
use crate::sample::Sample;

/// So many from frame to frame.
const A_FRAME: i64 = 6;
/// Of each pixel they are moved by this share of their distance more than those of the one before, so that all phases of frames and rhythms are met.
const SHIFT: f64 = 0.618_033_988_749_895;

/// Instants at equal distances.
pub struct Instants {
    /// Start of the recording, ns.
    zero: i64,
    apart_ns: i64,
    per_pixel: usize,
}

impl Instants {
    /// Of a recording; none with fewer than two frames.
    pub fn new(case: &Case) -> Option<Instants> {
        let apart_ns = case.frames.as_ref()?.times.mean_period_ns()? as i64 / A_FRAME;
        let per_pixel = usize::try_from((case.span.1 - case.span.0) / apart_ns.max(1)).ok()?;
        (apart_ns > 0 && per_pixel > 0).then_some(Instants { zero: case.span.0, apart_ns, per_pixel })
    }

    /// When the `k`-th of a pixel is.
    pub fn at(&self, place: usize, k: usize) -> i64 {
        let shift = (place as f64 * SHIFT).fract();
        self.zero + ((k as f64 + shift) * self.apart_ns as f64) as i64
    }

    /// A covariate at all of them, pixel by pixel; NaN where it is not known. Covariates of an event's sign have no value without an event.
    pub fn lay(&self, covariate: Covariate, sample: &Sample, surroundings: &Surroundings<'_>) -> Vec<f64> {
        if matches!(covariate, Covariate::Polarity | Covariate::PreviousPolarity | Covariate::BurstIndex) {
            return Vec::new();
        }
        let value = |place: usize, k: usize| surroundings.value(covariate, sample.pixels[place] as usize, self.at(place, k), 1).unwrap_or(f64::NAN);
        (0..sample.len()).flat_map(|place| (0..self.per_pixel).map(move |k| (place, k))).map(|(place, k)| value(place, k)).collect()
    }

    /// What one event a second more adds to a change of closure, by instant: (number among those of [`Instants::lay`], natural-log units). `step` is that of one event.
    pub fn added(&self, change: &Change, step: f64) -> impl Iterator<Item = (usize, f64)> {
        let seconds = |t: i64| (t - self.zero) as f64 * 1e-9;
        let apart_s = self.apart_ns as f64 * 1e-9;
        let first = (change.exposures[0].0 / apart_s).floor().max(0.0) as usize;
        let last = f64::max(change.exposures[1].1 / apart_s, 0.0) as usize + 1;
        let place = change.place;
        (first.saturating_sub(1)..usize::min(last, self.per_pixel)).filter_map(move |k| {
            // Events that no light made are taken for light that rose.
            let added = -step * change.rise(seconds(self.at(place, k))) * apart_s;
            (added != 0.0).then_some((place * self.per_pixel + k, added))
        })
    }

    /// When the `number`-th of [`Instants::lay`] is.
    pub fn time(&self, number: usize) -> i64 {
        self.at(number / self.per_pixel, number % self.per_pixel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::side::Side;
    use crate::testing;

    #[test]
    fn a_steady_rate_adds_as_much_as_a_drift_from_frame_to_frame() {
        let case = testing::case();
        let (sample, instants) = (Sample::all(&case, 4), Instants::new(&case).unwrap());
        let side = Side::new(&case, &case.nominal().unwrap(), &sample);
        let mut off = Vec::new();
        for change in &side.changes {
            let added: f64 = instants.added(change, 0.2).map(|(_, added)| added).sum();
            // From the middle of one exposure to that of the next, `plain[4]` seconds, events of 0.2 that no light made.
            off.push(added / (-0.2 * change.plain[4]) - 1.0);
        }
        let mean = off.iter().sum::<f64>() / off.len() as f64;
        assert!(off.len() > 100 && mean.abs() < 0.01 && off.iter().all(|one| one.abs() < 0.1), "{mean} {off:?}");
    }

    #[test]
    fn instants_meet_all_phases_of_the_frames_and_are_where_they_are_laid() {
        let case = testing::case();
        let instants = Instants::new(&case).unwrap();
        let times: Vec<i64> = (0..40 * instants.per_pixel).map(|number| instants.time(number)).collect();
        assert!(times.iter().all(|t| (0..60_000_000).contains(t)));
        assert_eq!(times[3 * instants.per_pixel + 2], instants.at(3, 2));
        let eighths: std::collections::BTreeSet<i64> = times.iter().map(|t| t % 8_000_000 / 200_000).collect();
        assert_eq!(eighths.len(), 40);
    }
}
