//! Where the unknowns of a pixel stand, and what happens there.
//!
//! Knots are put at every event (in-pixel time), at every instant when the reference is taken anew, and at
//! the edges of exposures; and between them so that none lie further apart than asked for near events, and up
//! to [`COARSEST`] times as far, or a 64th of the frame period, in long quiet gaps. What happens at a knot is
//! a short list of [`Op`]s in causal order.

use super::problem::{LoneEvents, MapProblem};
use photocurrent_core::sensor::Reset;

/// In quiet gaps knots may lie so many times as far apart as near events.
pub const COARSEST: i64 = 32;
/// Or so many to a frame period, where that is further apart: a film of one frame in twenty seconds needs no
/// knot every 8 ms.
const A_PERIOD: i64 = 64;
/// They do so from this many times their distance from the nearest event on.
const WIDENING: i64 = 2;

/// An event this soon after the blind time may be one that was held back, ns.
const LATE_NS: i64 = 1_000;

/// What happens at a knot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Op {
    /// The exposure of this frame ends and is read.
    Read(u32),
    /// The exposure of this frame begins: nothing is collected yet.
    Expose(u32),
    /// The reference becomes the voltage of now.
    Latch,
    /// From here to the next latch the no-event constraint is left out: events were lost.
    Lose,
    /// Log light is known from elsewhere, by this hint.
    Hint(u32),
    /// An event fires; `armed` when the comparator was surely watching.
    Fire {
        /// Number of the event.
        event: u32,
        /// Its polarity.
        polarity: i8,
        /// Was the comparator surely watching, and is it assumed that light made it fire?
        armed: bool,
        /// Does it carry no information on light at all?
        doubted: bool,
    },
}

/// The events around a stretch of time, ns.
#[derive(Clone, Copy, Debug)]
struct Neighbours {
    before: i64,
    after: i64,
}

/// Distances between knots, ns.
#[derive(Clone, Copy, Debug)]
struct Spacing {
    /// Near events.
    finest: i64,
    /// In quiet gaps.
    coarsest: i64,
}

impl Spacing {
    fn of(problem: &MapProblem<'_>, spacing_ns: i64) -> Spacing {
        let periods = problem
            .frames
            .windows(2)
            .map(|pair| pair[1].start_ns.saturating_sub(pair[0].start_ns))
            .filter(|period| *period > 0);
        // Of one frame, its exposure.
        let exposure = problem.frames.first().map_or(0, |frame| frame.end_ns.saturating_sub(frame.start_ns));
        let quiet = periods.min().unwrap_or(exposure) / A_PERIOD;
        Spacing { finest: spacing_ns, coarsest: quiet.max(COARSEST * spacing_ns) }
    }
}

/// The knots of one pixel; kept from pixel to pixel for its memory.
#[derive(Clone, Debug, Default)]
pub(super) struct Knots {
    /// Time of each knot, ns, rising.
    pub t_ns: Vec<i64>,
    /// Where each knot's ops begin in `ops`; one more than knots.
    pub first_op: Vec<u32>,
    /// What happens, in order of time.
    pub ops: Vec<Op>,
    marks: Vec<(i64, u8, Op)>,
}

impl Knots {
    /// Lays the knots of a pixel between its start and its end (both become knots), at most `spacing_ns`
    /// apart.
    ///
    /// Events, exposures and hints are inside that span; what lies outside is left away.
    pub(super) fn lay(&mut self, problem: &MapProblem<'_>, spacing_ns: i64) {
        let (start_ns, end_ns, spacing) =
            (problem.start_ns, problem.end_ns, Spacing::of(problem, spacing_ns));
        self.mark(problem);
        self.t_ns.clear();
        self.first_op.clear();
        self.ops.clear();
        self.begin(start_ns);
        let mut events = Neighbours { before: i64::MIN / 2, after: self.next_event(0) };
        for k in 0..self.marks.len() {
            let (t, _, op) = self.marks[k];
            self.fill_to(t, spacing, events);
            self.ops.push(op);
            if let Op::Fire { .. } = op {
                events = Neighbours { before: t, after: self.next_event(k + 1) };
            }
        }
        self.fill_to(end_ns, spacing, events);
        self.first_op.push(self.ops.len() as u32);
    }

    /// Becomes the same as `other`.
    pub(super) fn copy(&mut self, other: &Knots) {
        self.t_ns.clone_from(&other.t_ns);
        self.first_op.clone_from(&other.first_op);
        self.ops.clone_from(&other.ops);
    }

    fn begin(&mut self, t_ns: i64) {
        self.first_op.push(self.ops.len() as u32);
        self.t_ns.push(t_ns);
    }

    fn next_event(&self, from: usize) -> i64 {
        self.marks[from..]
            .iter()
            .find(|(_, _, op)| matches!(op, Op::Fire { .. }))
            .map_or(i64::MAX / 2, |(t, _, _)| *t)
    }

    /// Adds knots up to and including `t_ns`, unless it is one already.
    fn fill_to(&mut self, t_ns: i64, wanted: Spacing, events: Neighbours) {
        let mut last = self.t_ns[self.t_ns.len() - 1];
        while last < t_ns {
            let quiet = i64::min(last - events.before, events.after - last) / WIDENING;
            let spacing = quiet.clamp(wanted.finest, wanted.coarsest);
            // What is left is shared out evenly, so that no short rest remains.
            let left = t_ns - last;
            last = if left <= spacing {
                t_ns
            } else if left <= 2 * spacing {
                last + (left + 1) / 2
            } else {
                let pieces = (left + spacing - 1) / spacing;
                last + (left + pieces - 1) / pieces
            };
            self.begin(last);
        }
    }

    fn mark(&mut self, problem: &MapProblem<'_>) {
        let MapProblem { sensor, events, frames, hints, start_ns, end_ns, .. } = *problem;
        self.marks.clear();
        let inside = |t: i64| t >= start_ns && t <= end_ns;
        for (l, frame) in
            frames.iter().enumerate().filter(|(_, frame)| inside(frame.start_ns) && inside(frame.end_ns))
        {
            self.marks.push((frame.end_ns, 0, Op::Read(l as u32)));
            self.marks.push((frame.start_ns, 1, Op::Expose(l as u32)));
        }
        self.marks.extend(
            hints
                .iter()
                .enumerate()
                .filter(|(_, hint)| inside(hint.t_ns))
                .map(|(l, hint)| (hint.t_ns, 5, Op::Hint(l as u32))),
        );
        let mut blind_until = i64::MIN;
        let mut before = i64::MIN;
        for (k, event) in events.iter().enumerate().filter(|(_, event)| inside(event.t_in_ns)) {
            let latch_ns = event.t_off_ns + sensor.refractory_ns;
            // Two events of a pixel at one instant: under "resample" the second carries no information, under
            // "advance" it counts twice.
            let watching = match sensor.reset {
                Reset::Resample => event.t_in_ns >= blind_until && event.t_in_ns > before,
                // One that fires as the blind time ends may have crossed long before.
                Reset::Advance | Reset::AdvanceLossy => {
                    events.get(k + 1).is_none_or(|next| next.t_in_ns != event.t_in_ns)
                        && (sensor.refractory_ns == 0 || event.t_in_ns > blind_until.saturating_add(LATE_NS))
                }
            };
            let is_lone = problem.is_lone.get(k).copied().unwrap_or(false);
            let doubted = is_lone && problem.noise.lone == LoneEvents::Doubted;
            let after_loss = problem.lost_before.binary_search(&(k as u32)).is_ok();
            if after_loss && blind_until <= event.t_in_ns {
                self.marks.push((i64::max(blind_until, start_ns), 6, Op::Lose));
            }
            self.marks.push((
                event.t_in_ns,
                3,
                Op::Fire {
                    event: k as u32,
                    polarity: event.polarity,
                    armed: watching && !doubted && !after_loss,
                    doubted,
                },
            ));
            // A reference that moves by one threshold is the voltage of the event, unless the event was held
            // back. Taken from the voltage, errors of thresholds do not add up.
            match sensor.reset {
                Reset::Resample if inside(latch_ns) => {
                    self.marks.push((latch_ns, if latch_ns > event.t_in_ns { 2 } else { 4 }, Op::Latch))
                }
                Reset::Advance | Reset::AdvanceLossy if watching && !doubted => {
                    self.marks.push((event.t_in_ns, 4, Op::Latch))
                }
                _ => {}
            }
            blind_until = i64::max(blind_until, latch_ns);
            before = event.t_in_ns;
        }
        self.marks.sort_by_key(|&(t, order, _)| (t, order));
    }

    /// The ops of knot `j`.
    pub(super) fn ops_of(&self, j: usize) -> std::ops::Range<usize> {
        self.first_op[j] as usize..self.first_op[j + 1] as usize
    }

    /// Number of knots.
    pub(super) fn len(&self) -> usize {
        self.t_ns.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::front_end::FrontEnd;
    use crate::map::{MapFrame, MapSensor, Noise, PixelEvent};

    fn event(t_in_ns: i64, polarity: i8) -> PixelEvent {
        PixelEvent { t_in_ns, t_off_ns: t_in_ns, polarity }
    }

    /// Of nothing yet.
    fn problem() -> MapProblem<'static> {
        let sensor = MapSensor {
            front_end: FrontEnd::IDEAL,
            threshold_on: 0.2,
            threshold_off: 0.2,
            reset: Reset::Resample,
            refractory_ns: 50_000,
            gain: 850.0,
            black_level_dn: 0.0,
            saturation_dn: f64::INFINITY,
        };
        let (noise, stamp_sigma_s, no_event_sigma) = (Noise::default(), 0.0, 0.0);
        MapProblem { noise, stamp_sigma_s, no_event_sigma, ..MapProblem::new(sensor, &[], &[], (0, 0)) }
    }

    #[test]
    fn knots_follow_events_and_frames_and_not_the_span() {
        let knots = |period_ns: i64| {
            let frame = |l: i64| MapFrame {
                start_ns: l * period_ns,
                end_ns: l * period_ns + period_ns / 2,
                dn: 250.0,
                sigma_dn: 2.0,
                saturated: false,
            };
            let (frames, events) =
                ([0, 1, 2, 3, 4, 5].map(frame), [event(period_ns, 1), event(3 * period_ns, -1)]);
            let problem = MapProblem {
                events: &events,
                frames: &frames,
                hints: &[],
                start_ns: 0,
                end_ns: 6 * period_ns,
                ..problem()
            };
            let mut knots = Knots::default();
            knots.lay(&problem, 250_000);
            assert!(
                knots.t_ns.windows(2).all(|pair| pair[1] - pair[0] <= i64::max(8_000_000, period_ns / 64))
            );
            knots.len()
        };
        // Up to half a second from frame to frame quiet gaps have a knot every 8 ms; from there on the number
        // stays.
        let (short, long, longer) = (knots(40_000_000), knots(20_000_000_000), knots(20_000_000_000_000));
        assert!(short < 150 && long < 800 && longer < 1_100, "{short}, {long}, {longer}");
        // One frame alone, whose exposure ends an hour after the last event.
        let (frames, events) = (
            [MapFrame { start_ns: 0, end_ns: 3_600_000_000_000, dn: 250.0, sigma_dn: 2.0, saturated: false }],
            [event(1_000_000, 1)],
        );
        let problem = MapProblem {
            events: &events,
            frames: &frames,
            hints: &[],
            start_ns: 0,
            end_ns: 3_600_000_000_000,
            ..problem()
        };
        let mut knots = Knots::default();
        knots.lay(&problem, 250_000);
        assert!(knots.len() < 200, "{}", knots.len());
    }
}
