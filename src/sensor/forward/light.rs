//! Light on one pixel: photocurrents at instants, linear between them.
//!
//! Linear pieces keep the exposure integral exact and let the front end answer in closed form. Effects that
//! change the light of the event path are applied at the instants; one that bends straight light says how
//! finely it must be cut.

use crate::effects::{Effect, Site};
use photocurrent_core::Exposure;
use photocurrent_core::time::between;
use std::borrow::Cow;

/// Light on one pixel: photocurrent at instants, linear between them, constant before the first and after the
/// last.
#[derive(Clone, Copy, Debug)]
pub struct LinearLight<'a> {
    pub(super) t_ns: &'a [i64],
    pub(super) photocurrent: &'a [f64],
}

impl<'a> LinearLight<'a> {
    /// Takes photocurrents (positive) at instants in nanoseconds.
    ///
    /// # Panics
    ///
    /// When the slices are empty or differ in length, the instants do not increase, or a photocurrent is not
    /// positive and finite: its logarithm is needed everywhere.
    pub fn new(t_ns: &'a [i64], photocurrent: &'a [f64]) -> Self {
        assert!(
            !t_ns.is_empty() && t_ns.len() == photocurrent.len(),
            "light has one photocurrent per instant"
        );
        assert!(t_ns.is_sorted_by(|before, after| before < after), "instants of light increase");
        assert!(
            photocurrent.iter().all(|&i| i > 0.0 && i.is_finite()),
            "photocurrent is positive and finite"
        );
        LinearLight { t_ns, photocurrent }
    }

    /// The photocurrent at `t_ns`.
    pub fn at(&self, t_ns: i64) -> f64 {
        self.between(self.t_ns.partition_point(|&instant| instant <= t_ns), t_ns)
    }

    /// The photocurrent at `t_ns`, when `after` is the first instant after it.
    pub(super) fn between(&self, after: usize, t_ns: i64) -> f64 {
        let photocurrent = |k: usize| self.photocurrent[k];
        between(self.t_ns, after, t_ns, photocurrent, |a, b, share| a * (1.0 - share) + b * share)
            .expect("light has an instant")
    }

    /// The exact integral over `exposure`, in photocurrent times seconds: Eq. (5) without its gain.
    pub fn integral(&self, exposure: Exposure) -> f64 {
        let (mut sum, mut from) = (0.0, exposure.start.0);
        let mut after = self.t_ns.partition_point(|&instant| instant <= from);
        let mut first = self.between(after, from);
        while from < exposure.end.0 {
            let next = self.t_ns.get(after).copied().unwrap_or(i64::MAX);
            let to = next.min(exposure.end.0);
            let last = if to == next { self.photocurrent[after] } else { self.between(after, to) };
            sum += 0.5 * (first + last) * (to - from) as f64;
            (from, first, after) = (to, last, after + 1);
        }
        sum / 1e9
    }
}

/// One linear piece of light; the piece before the first instant and the one after the last are constant and
/// without end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Piece {
    /// Where it starts and ends; the far end of an endless piece is the largest (smallest) time.
    pub start_ns: i64,
    pub end_ns: i64,
    /// The photocurrent there.
    pub first: f64,
    pub last: f64,
}

impl Piece {
    /// The photocurrent at an instant of the piece: the same bits as [`LinearLight::at`].
    pub(super) fn at(&self, t_ns: i64) -> f64 {
        if self.first == self.last {
            return self.first;
        }
        let share = (t_ns - self.start_ns) as f64 / (self.end_ns - self.start_ns) as f64;
        self.first * (1.0 - share) + self.last * share
    }
}

impl LinearLight<'_> {
    /// The piece that holds from `t_ns` on.
    pub(super) fn piece(&self, t_ns: i64) -> Piece {
        let after = self.t_ns.partition_point(|&instant| instant <= t_ns);
        let before = after.saturating_sub(1);
        let start_ns = if after == 0 { i64::MIN } else { self.t_ns[before] };
        match self.t_ns.get(after) {
            Some(&end_ns) if after > 0 => {
                Piece { start_ns, end_ns, first: self.photocurrent[before], last: self.photocurrent[after] }
            }
            Some(&end_ns) => {
                Piece { start_ns, end_ns, first: self.photocurrent[0], last: self.photocurrent[0] }
            }
            None => Piece {
                start_ns,
                end_ns: i64::MAX,
                first: self.photocurrent[before],
                last: self.photocurrent[before],
            },
        }
    }
}

/// Light that owns its samples, or borrows them.
#[derive(Clone, Debug)]
pub(super) struct EventLight<'a> {
    t_ns: Cow<'a, [i64]>,
    photocurrent: Cow<'a, [f64]>,
}

impl<'a> EventLight<'a> {
    /// What enters the logarithm when `light` falls on the pixel.
    ///
    /// # Panics
    ///
    /// When an effect makes a photocurrent that is not positive.
    pub(super) fn new(
        effects: &[Box<dyn Effect>],
        site: &Site,
        light: LinearLight<'a>,
        start_ns: i64,
        end_ns: i64,
    ) -> EventLight<'a> {
        if effects.is_empty() {
            return EventLight {
                t_ns: Cow::Borrowed(light.t_ns),
                photocurrent: Cow::Borrowed(light.photocurrent),
            };
        }
        let t_ns = match effects.iter().filter_map(|effect| effect.light_step_ns()).min() {
            Some(step_ns) => Cow::Owned(refined(light.t_ns, step_ns.max(1), start_ns, end_ns)),
            None => Cow::Borrowed(light.t_ns),
        };
        let mut after = 0;
        let seen = |&t: &i64| {
            while light.t_ns.get(after).is_some_and(|instant| *instant <= t) {
                after += 1;
            }
            effects.iter().fold(light.between(after, t), |i, effect| effect.event_light(site, t, i))
        };
        let photocurrent: Vec<f64> = t_ns.iter().map(seen).collect();
        assert!(
            photocurrent.iter().all(|&i| i > 0.0 && i.is_finite()),
            "photocurrent is positive and finite"
        );
        EventLight { t_ns, photocurrent: Cow::Owned(photocurrent) }
    }

    /// As linear light.
    pub(super) fn get(&self) -> LinearLight<'_> {
        LinearLight { t_ns: &self.t_ns, photocurrent: &self.photocurrent }
    }
}

/// Instants at most `step_ns` apart from `start_ns` to `end_ns`, the given ones among them.
fn refined(instants: &[i64], step_ns: i64, start_ns: i64, end_ns: i64) -> Vec<i64> {
    let grid = (0..).map(|n| start_ns + n * step_ns).take_while(|&t| t <= end_ns);
    let mut all: Vec<i64> = instants.iter().copied().chain(grid).collect();
    all.sort_unstable();
    all.dedup();
    all
}
