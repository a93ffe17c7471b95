//! What is measured and known of one pixel: the problem that the solver is given.

use crate::comparator::PixelEvent;
use crate::front_end::FrontEnd;
use photocurrent_core::sensor::Reset;

/// A frame value of the pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapFrame {
    /// Exposure of this row, ns.
    pub start_ns: i64,
    /// End of it.
    pub end_ns: i64,
    /// Digital number, black level included; finite.
    pub dn: f64,
    /// Its standard deviation, DN, positive.
    pub sigma_dn: f64,
    /// Is the value a lower bound?
    pub saturated: bool,
}

/// What is known of a pixel's light from elsewhere, at one instant: a measurement of log light with a normal
/// error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hint {
    /// When, ns; becomes a knot.
    pub t_ns: i64,
    /// Log light.
    pub log_photocurrent: f64,
    /// Its variance, positive.
    pub variance: f64,
    /// What counts as its variance where the posterior variance is asked for, positive: hints that err
    /// together narrow it less than they hold the light.
    pub for_sigma: f64,
}

/// The pixel as a description states it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapSensor {
    /// The low-pass of Eq. (3).
    pub front_end: FrontEnd,
    /// ON threshold, natural-log units, positive.
    pub threshold_on: f64,
    /// OFF threshold, natural-log units, positive.
    pub threshold_off: f64,
    /// What the reference does after an event.
    pub reset: Reset,
    /// From `t_off` until the comparator watches again, ns.
    pub refractory_ns: i64,
    /// DN per photocurrent and second.
    pub gain: f64,
    /// DN of darkness.
    pub black_level_dn: f64,
    /// DN at which values stay; infinite = not known.
    pub saturation_dn: f64,
}

/// What a lone event says of light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LoneEvents {
    /// As much as any other.
    #[default]
    Trusted,
    /// Nothing: it only resets the pixel.
    Doubted,
}

/// How far measurements of events are trusted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Standard deviation of an event, as a part of its threshold.
    pub event: f64,
    /// Standard deviation of the first reference around the first voltage, natural-log units.
    pub reference: f64,
    /// Standard deviation of this pixel's thresholds around the stated ones, natural-log units; 0 = they are
    /// exact.
    pub threshold: f64,
    /// What lone events say.
    pub lone: LoneEvents,
}

impl Default for Noise {
    fn default() -> Noise {
        Noise::USUAL
    }
}

impl Noise {
    /// Before anything is known of a recording.
    pub const USUAL: Noise = Noise { event: 0.1, reference: 0.05, threshold: 0.0, lone: LoneEvents::Trusted };

    pub(super) fn event_variance(&self, threshold: f64) -> f64 {
        let sigma = self.event * threshold;
        sigma * sigma
    }
}

/// What is estimated of a pixel besides its light: how far it is from the stated values, natural-log units.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Offsets {
    /// First reference less first voltage.
    pub reference: f64,
    /// Added to the ON threshold.
    pub on: f64,
    /// Added to the OFF threshold.
    pub off: f64,
}

impl Offsets {
    pub(super) fn cost(&self, noise: &Noise) -> f64 {
        let part = |value: f64, sigma: f64| if sigma > 0.0 { (value / sigma) * (value / sigma) } else { 0.0 };
        part(self.reference, noise.reference)
            + part(self.on, noise.threshold)
            + part(self.off, noise.threshold)
    }
}

/// Everything measured and known about one pixel.
#[derive(Clone, Copy, Debug)]
pub struct MapProblem<'a> {
    /// Events in order of in-pixel time; none leaves the array before it fired.
    pub events: &'a [PixelEvent],
    /// Of each event: did nothing else happen around it, in time and space? Such an event may be noise: see
    /// [`Noise::lone`]. Empty = of none.
    pub is_lone: &'a [bool],
    /// Frame values, in order of time, exposures apart from each other.
    pub frames: &'a [MapFrame],
    /// What is known from elsewhere, in order of time; may be empty. No part of `log_evidence`, which then is
    /// the predictive log-likelihood of the pixel's own measurements.
    pub hints: &'a [Hint],
    /// First instant of the solution, ns; the pixel is taken as settled there.
    pub start_ns: i64,
    /// Last instant, ns.
    pub end_ns: i64,
    /// The pixel.
    pub sensor: MapSensor,
    /// Assumed standard deviations of events.
    pub noise: Noise,
    /// Standard deviation of a stamp, seconds.
    pub stamp_sigma_s: f64,
    /// Softness of "no event, so no threshold was crossed", natural-log units; 0 = not used. Counts in the
    /// last steps only.
    pub no_event_sigma: f64,
    /// Numbers of events before which events were lost, rising; may be empty. The gap before them is no
    /// constraint, and they only take the reference anew.
    pub lost_before: &'a [u32],
    /// What each event's signed step from the reference is known to be beyond its threshold (drift of the
    /// reference since the reset, thresholds of that moment),
    /// natural-log units; empty = nothing. The no-event constraint leaves it out.
    pub beyond: &'a [f64],
}

impl<'a> MapProblem<'a> {
    /// Of events and frames alone, from `start_ns` to `end_ns`: the usual noise, exact stamps, nothing known
    /// from elsewhere, and no no-event constraint.
    pub fn new(
        sensor: MapSensor,
        events: &'a [PixelEvent],
        frames: &'a [MapFrame],
        (start_ns, end_ns): (i64, i64),
    ) -> MapProblem<'a> {
        let noise = Noise::default();
        let (hints, lost_before, beyond) = (&[], &[], &[]);
        MapProblem {
            events,
            is_lone: &[],
            frames,
            hints,
            start_ns,
            end_ns,
            sensor,
            noise,
            stamp_sigma_s: 0.0,
            no_event_sigma: 0.0,
            lost_before,
            beyond,
        }
    }

    /// [`MapProblem::beyond`] of an event.
    pub(crate) fn beyond_of(&self, event: u32) -> f64 {
        self.beyond.get(event as usize).copied().unwrap_or(0.0)
    }
}

/// Light brighter than the brightest frame's mean by more than this is not trusted, natural-log units.
const RUN_AWAY: f64 = 2.5;

/// Is the light anywhere implausible, given what the frames collected?
pub(super) fn has_run_away(problem: &MapProblem<'_>, u: &[f64]) -> bool {
    let limit = brightest(problem);
    u.iter().any(|&u| u > limit)
}

/// The brightest log light that is plausible, given what the frames collected; infinite where one of them is
/// a lower bound.
pub(super) fn brightest(problem: &MapProblem<'_>) -> f64 {
    if problem.frames.iter().any(|frame| frame.saturated) {
        return f64::INFINITY;
    }
    let collected = |frame: &MapFrame| frame.dn - problem.sensor.black_level_dn + 3.0 * frame.sigma_dn;
    let brightest = problem
        .frames
        .iter()
        .fold(0.0, |most, frame| f64::max(most, collected(frame) / (frame.end_ns - frame.start_ns) as f64));
    libm::log(brightest * 1e9 / problem.sensor.gain) + RUN_AWAY
}
