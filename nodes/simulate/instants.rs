//! Which instants of a changing light to keep, so that straight lines between them are as good as the light
//! itself.
//!
//! Light is looked at in panels of four steps. Where one does not lie on the line between the ends, the panel
//! is halved, if need be down to nanoseconds; where the scene says that nothing changes, time is skipped. Of
//! all instants looked at, only those are kept without which a line would leave the tolerance: one pass with
//! a cone of slopes that all instants since the last kept one allow.

/// How light is sampled over a span that begins at 0.
#[derive(Clone, Copy, Debug)]
pub struct Sampler {
    /// End of the span, ns.
    pub end_ns: i64,
    /// Longest time between two looks while something may change, ns; at least 1.
    pub step_ns: i64,
    /// How far the logarithm of light between kept instants may be off, natural-log units.
    pub tolerance: f64,
    /// Do things turn back at once, so that they may touch a pixel for less than a step? Then a pause is only
    /// taken as one when `still_until` says so.
    pub graze: bool,
}

impl Sampler {
    /// The kept instants of `light`; `still_until` says up to when it is constant from an instant on, for
    /// certain.
    pub fn sample(&self, light: impl Fn(i64) -> f64, still_until: impl Fn(i64) -> i64) -> Vec<(i64, f64)> {
        let mut thinned = Thinned::new((0, light(0)), 0.5 * self.tolerance);
        let panel = 4 * self.step_ns.max(1);
        let mut at = thinned.last;
        while at.0 < self.end_ns {
            let still = still_until(at.0).min(self.end_ns);
            if still > at.0 + panel {
                at.0 = still;
                thinned.add(at);
            } else {
                let end = (at.0 + panel).min(self.end_ns);
                let next = (end, light(end));
                self.panel((&light, &still_until), at, next, &mut thinned);
                at = next;
            }
        }
        thinned.finish()
    }

    fn panel(
        &self,
        scene: (&impl Fn(i64) -> f64, &impl Fn(i64) -> i64),
        from: (i64, f64),
        to: (i64, f64),
        thinned: &mut Thinned,
    ) {
        let (light, still_until) = scene;
        let length = to.0 - from.0;
        if length < 4 {
            return thinned.add(to);
        }
        let inside = [length / 4, length / 2, length - length / 4]
            .map(|after| (from.0 + after, light(from.0 + after)));
        // A kink anywhere shows at these instants with a good part of its error, but may be where light is
        // weakest.
        let weakest = inside.iter().fold(from.1.min(to.1), |least, seen| least.min(seen.1));
        let bends = |seen: &(i64, f64)| {
            let line = from.1 + (to.1 - from.1) * ((seen.0 - from.0) as f64 / length as f64);
            (seen.1 - line).abs() > 0.25 * self.tolerance * weakest
        };
        // What grazes a pixel may come and go between two looks: a flat panel must be known to stand still,
        // or be looked at more closely.
        let flat = from.1 == to.1 && inside.iter().all(|seen| seen.1 == from.1);
        let may_graze = self.graze && flat && length > self.step_ns / 32 && still_until(from.0) < to.0;
        if may_graze || inside.iter().any(bends) {
            self.panel(scene, from, inside[1], thinned);
            self.panel(scene, inside[1], to, thinned);
        } else {
            inside.into_iter().for_each(|seen| thinned.add(seen));
            thinned.add(to);
        }
    }
}

/// Instants of which only the needed ones stay.
pub(super) struct Thinned {
    kept: Vec<(i64, f64)>,
    last: (i64, f64),
    /// Slopes from the last kept instant that pass all since within the tolerance.
    slopes: (f64, f64),
    tolerance: f64,
}

impl Thinned {
    /// From the first instant, which stays; `tolerance` is relative.
    pub(super) fn new(first: (i64, f64), tolerance: f64) -> Thinned {
        Thinned { kept: vec![first], last: first, slopes: (f64::NEG_INFINITY, f64::INFINITY), tolerance }
    }

    fn add(&mut self, next: (i64, f64)) {
        self.add_within(next, self.tolerance * next.1);
    }

    /// Adds an instant, of which the line may be off by `margin` if it does not stay; in the unit of the
    /// light.
    pub(super) fn add_within(&mut self, next: (i64, f64), margin: f64) {
        let slope = |from: (i64, f64), to: f64| (to - from.1) / (next.0 - from.0) as f64;
        let mut anchor = self.kept[self.kept.len() - 1];
        let straight = slope(anchor, next.1);
        if !(self.slopes.0..=self.slopes.1).contains(&straight) {
            self.kept.push(self.last);
            anchor = self.last;
            self.slopes = (f64::NEG_INFINITY, f64::INFINITY);
        }
        self.slopes = (
            self.slopes.0.max(slope(anchor, next.1 - margin)),
            self.slopes.1.min(slope(anchor, next.1 + margin)),
        );
        self.last = next;
    }

    /// The instants that stay.
    pub(super) fn finish(mut self) -> Vec<(i64, f64)> {
        // What is constant to the end needs no last instant: light holds after the last.
        if self.last.1 != self.kept[self.kept.len() - 1].1 {
            self.kept.push(self.last);
        }
        self.kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::light;
    use photocurrent_core::series::Series;

    const SAMPLER: Sampler = Sampler { end_ns: 1_000_000, step_ns: 20_000, tolerance: 1e-3, graze: false };

    fn worst(kept: &[(i64, f64)], light: impl Fn(i64) -> f64) -> f64 {
        let t: Vec<i64> = kept.iter().map(|k| k.0).collect();
        let values: Vec<f32> = kept.iter().map(|k| k.1 as f32).collect();
        let line = |at: i64| light::at(Series { t: &t, photocurrent: &values, sigma: &[] }, at).unwrap();
        (0..=10_000).map(|k| k * 100).map(|at| libm::log(line(at) / light(at)).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn lines_between_kept_instants_stay_within_the_tolerance() {
        let wave = |t: i64| 2.0 + libm::sin(t as f64 * 2e-5);
        let ramp = |t: i64| 0.03 + 0.9 * ((t - 312_345) as f64 / 111_111.0).clamp(0.0, 1.0);
        let (smooth, edge) = (SAMPLER.sample(wave, |t| t), SAMPLER.sample(ramp, |t| t));
        assert!(
            worst(&smooth, wave) < 1e-3 && worst(&edge, ramp) < 1e-3,
            "{} {}",
            worst(&smooth, wave),
            worst(&edge, ramp)
        );
        // A wave bends by 1 in (50 us)^2 at most: lines of 4.5 us are needed; an edge is a line with two
        // ends.
        assert!(smooth.len() < 220 && edge.len() < 8, "{} {}", smooth.len(), edge.len());
        assert!(edge.is_sorted_by(|a, b| a.0 < b.0));
    }

    #[test]
    fn what_stands_still_costs_one_instant_and_a_pause_costs_two() {
        assert_eq!(SAMPLER.sample(|_| 5.0, |_| i64::MAX), [(0, 5.0)]);
        assert_eq!(SAMPLER.sample(|_| 5.0, |t| t), [(0, 5.0)]);
        let pause = |t: i64| 1.0 + (t - 600_000).max(0) as f64 * 1e-6;
        let kept = SAMPLER.sample(pause, |t| if t < 600_000 { 600_000 } else { t });
        assert_eq!(kept, [(0, 1.0), (600_000, 1.0), (1_000_000, 1.4)]);
    }
}
