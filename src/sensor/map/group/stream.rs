//! A pixel as a stream of uniform steps, so that eight pixels can go in step.
//!
//! A step is a segment, then at most one measurement, then at most a new exposure and a new reference. A knot
//! where more happens becomes several steps, of which all but the first have no segment: nothing moves there.
//! Pixels with fewer steps than their neighbours end with steps at which nothing happens.

use super::super::knots::{Knots, Op};
use super::super::problem::MapProblem;
use crate::wide::Wide;
use photocurrent_core::sensor::Reset;

/// An event: voltage is reference plus or minus a threshold.
pub(crate) const EVENT: u64 = 1;
/// A frame value: collected light is the target.
pub(crate) const FRAME: u64 = 2;
/// Log light is the target.
pub(crate) const LIGHT: u64 = 4;
/// NoEvent: voltage and reference are less than a threshold apart.
pub(crate) const NO_EVENT: u64 = 8;
/// With [`FRAME`]: the value is a lower bound.
pub(crate) const BOUND: u64 = 16;
/// No measurement: the reference moves by a threshold.
pub(crate) const MOVE: u64 = 32;
/// After the measurement an exposure begins.
pub(crate) const EXPOSE: u64 = 64;
/// After it the reference becomes the voltage of now.
pub(crate) const LATCH: u64 = 128;
/// The step has a segment.
pub(crate) const SEGMENT: u64 = 256;
/// With [`EVENT`] and [`MOVE`]: the polarity is ON.
pub(crate) const RISE: u64 = 512;
/// All that can be at a step but once.
const TAKES: u64 = EVENT | FRAME | LIGHT | NO_EVENT | MOVE;

/// A step of one pixel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Step {
    pub knot: u32,
    /// What is there, of the bits above. The first step of a pixel counts as one that has a segment.
    pub what: u64,
    pub target: f64,
    pub variance: f64,
    /// What counts as it for the posterior variance, of a pseudo-measurement.
    pub for_sigma: f64,
    /// Frame values, in standard deviations, per light on the segment; 0 between exposures.
    pub exposure: f64,
}

/// The steps of one pixel; kept from pixel to pixel for its memory.
#[derive(Clone, Debug, Default)]
pub(crate) struct Stream {
    pub steps: Vec<Step>,
    /// The first step of each knot.
    pub first_step: Vec<u32>,
}

impl Stream {
    /// Writes down what happens at `knots`.
    pub(crate) fn fill(&mut self, problem: &MapProblem<'_>, knots: &Knots) {
        let MapProblem { sensor, noise, frames, hints, .. } = problem;
        self.steps.clear();
        self.first_step.clear();
        let mut exposure = 0.0;
        let mut is_blind = false;
        for j in 0..knots.len() {
            self.first_step.push(self.steps.len() as u32);
            self.begin(j, SEGMENT, exposure);
            let mut fires = false;
            for op in &knots.ops[knots.ops_of(j)] {
                match *op {
                    Op::Read(l) => {
                        let frame = &frames[l as usize];
                        let target = (frame.dn - sensor.black_level_dn) / frame.sigma_dn;
                        self.measure(if frame.saturated { FRAME | BOUND } else { FRAME }, target, 1.0);
                        exposure = 0.0;
                    }
                    Op::Expose(l) => {
                        exposure = sensor.gain / frames[l as usize].sigma_dn;
                        self.last().what |= EXPOSE;
                    }
                    Op::Latch => {
                        self.last().what |= LATCH;
                        is_blind = false;
                    }
                    Op::Lose => is_blind = true,
                    Op::Hint(l) => {
                        let hint = &hints[l as usize];
                        self.measure(LIGHT, hint.log_photocurrent, hint.variance);
                        self.last().for_sigma = hint.for_sigma;
                    }
                    Op::Fire { event, polarity, armed, .. } => {
                        fires = true;
                        let threshold = if polarity > 0 { sensor.threshold_on } else { sensor.threshold_off };
                        let rises = if polarity > 0 { RISE } else { 0 };
                        if armed {
                            self.measure(
                                EVENT | rises,
                                problem.beyond_of(event),
                                noise.event_variance(threshold),
                            );
                        } else if sensor.reset != Reset::Resample {
                            self.measure(MOVE | rises, problem.beyond_of(event), 1.0);
                        }
                        is_blind = is_blind || sensor.reset == Reset::Resample;
                    }
                }
            }
            // Where the reference was just taken anew, nothing can be broken.
            if problem.no_event_sigma > 0.0 && !is_blind && !fires && self.last().what & LATCH == 0 {
                self.measure(NO_EVENT, 0.0, problem.no_event_sigma * problem.no_event_sigma);
            }
        }
    }

    /// Of the values of a lane at each step, those at each knot: all steps of a knot have one light, and its
    /// last what is known after all that happens there.
    pub(crate) fn of_knots<const W: usize>(&self, steps: &[Wide<W>], lane: usize, knots: &mut Vec<f64>) {
        let ends = self.first_step.iter().skip(1).map(|first| *first as usize).chain([self.steps.len()]);
        knots.clear();
        knots.extend(ends.map(|end| steps[end - 1].0[lane]));
    }

    /// A lane of the values at each step becomes those at the knots; behind the pixel's end the last.
    pub(crate) fn spread<const W: usize>(&self, knots: &[f64], lane: usize, steps: &mut [Wide<W>]) {
        for (s, value) in steps.iter_mut().enumerate() {
            value.0[lane] =
                self.steps.get(s).map_or(knots[knots.len() - 1], |step| knots[step.knot as usize]);
        }
    }

    fn begin(&mut self, knot: usize, what: u64, exposure: f64) {
        self.steps.push(Step {
            knot: knot as u32,
            what,
            target: 0.0,
            variance: 1.0,
            for_sigma: 1.0,
            exposure,
        });
    }

    fn last(&mut self) -> &mut Step {
        let last = self.steps.len() - 1;
        &mut self.steps[last]
    }

    /// A measurement at the last knot, after all that stands there.
    fn measure(&mut self, what: u64, target: f64, variance: f64) {
        let last = *self.last();
        // The no-event constraint does not see what an exposure's begin forgets.
        if last.what & TAKES != 0 || (last.what & (EXPOSE | LATCH) != 0 && what != NO_EVENT) {
            self.begin(last.knot as usize, 0, 0.0);
        }
        let step = self.last();
        step.what |= what;
        (step.target, step.variance) = (target, variance);
    }
}
