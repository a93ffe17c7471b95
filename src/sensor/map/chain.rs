//! The forward pass of one pixel at given unknowns: voltages, residuals, and everything the linearised problem needs.

use super::knots::{Knots, Op};
use super::prior::Segments;
use super::segment::Pieces;
use super::{MapProblem, Offsets};
use crate::residuals::Misfit;
use photocurrent_core::sensor::Reset;

/// What a measurement at a knot looks at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Sight {
    /// Nothing: the op is no measurement, or does not count here.
    None,
    /// Voltage less reference less the threshold of this polarity.
    Event(i8),
    /// Light collected since the exposure began.
    Frame,
    /// Log light.
    Light,
}

/// One measurement, linearised: measured minus predicted, with its variance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    pub sight: Sight,
    pub residual: f64,
    pub variance: f64,
}

impl Row {
    fn misfit(&self) -> Misfit {
        let square = self.residual * self.residual * (1.0 / self.variance);
        match self.sight {
            Sight::Event(_) => Misfit { event_square: square, events: 1, ..Misfit::default() },
            Sight::Frame => Misfit { frame_square: square, frames: 1, ..Misfit::default() },
            Sight::Light | Sight::None => Misfit::default(),
        }
    }
}

/// A segment's derivatives: of the voltage by voltage and both ends, of the scaled light by both ends.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Slopes<T = f64> {
    pub by_voltage: T,
    /// By both ends together.
    pub by_both: T,
    pub by_last: T,
    /// By both ends together.
    pub light_by_both: T,
    pub light_by_last: T,
}

/// A pixel's unknowns turned into predictions.
#[derive(Clone, Debug, Default)]
pub(super) struct Chain {
    /// Derivatives of the segment that ends at each knot.
    pub slopes: Vec<Slopes>,
    /// One for each op of the knots.
    pub rows: Vec<Row>,
    /// The no-event constraint that is broken at a knot: how far to move back, and the polarity of the threshold; polarity 0 where all is well.
    pub no_event: Vec<(f64, i8)>,
    /// Twice the negative log of the likelihood and of the offsets' prior, less constants, without the no-event constraint.
    measured_cost: f64,
    /// The sum of squares of the broken no-event constraint.
    no_event_square: f64,
    pieces: Pieces,
}

impl Chain {
    /// Runs the pixel at `u`.
    pub fn run(&mut self, problem: &MapProblem<'_>, knots: &Knots, segments: &Segments, u: &[f64], offsets: &Offsets) {
        let sensor = &problem.sensor;
        let noise = &problem.noise;
        self.pieces.fill(&sensor.front_end, u, &segments.length_s);
        self.slopes.clear();
        self.rows.clear();
        self.no_event.clear();
        let mut cost = 0.0;
        let mut no_event_square = 0.0;
        let mut voltage = u[0];
        let mut reference = voltage + offsets.reference;
        let (on, off) = (sensor.threshold_on + offsets.on, sensor.threshold_off + offsets.off);
        // Light counts in standard deviations of the frame that is exposed.
        let (mut light, mut scale) = (0.0, 0.0);
        let mut blind = false;
        let knots_and_ends = u.iter().zip(&knots.first_op[1..]).enumerate();
        let mut next_op = knots.first_op[0] as usize;
        let mut before = u[0];
        for (j, (&here, &end_op)) in knots_and_ends {
            let mut slopes = Slopes::default();
            if j > 0 {
                let ramp = self.pieces.ramp(j, voltage, before, here);
                voltage = ramp.voltage;
                let light_by_both = scale * self.pieces.light[j];
                light += light_by_both;
                let light_by_last = scale * self.pieces.light_by_last[j];
                slopes = Slopes { by_voltage: ramp.by_voltage, by_both: ramp.by_both, by_last: ramp.by_last, light_by_both, light_by_last };
            }
            before = here;
            self.slopes.push(slopes);
            let mut fires = false;
            for op in &knots.ops[next_op..end_op as usize] {
                let mut row = Row { sight: Sight::None, residual: 0.0, variance: 1.0 };
                match *op {
                    Op::Read(l) => {
                        let frame = &problem.frames[l as usize];
                        row.residual = (frame.dn - sensor.black_level_dn) / frame.sigma_dn - light;
                        // A saturated value is a lower bound: more light is no contradiction.
                        if !(frame.saturated && row.residual < 0.0) {
                            row.sight = Sight::Frame;
                        }
                        scale = 0.0;
                    }
                    Op::Expose(l) => {
                        let frame = &problem.frames[l as usize];
                        scale = sensor.gain / frame.sigma_dn;
                        light = 0.0;
                    }
                    Op::Latch => {
                        reference = voltage;
                        blind = false;
                    }
                    Op::Lose => blind = true,
                    Op::Hint(l) => {
                        let hint = &problem.hints[l as usize];
                        row = Row { sight: Sight::Light, residual: hint.log_photocurrent - u[j], variance: hint.variance };
                        cost += row.residual * row.residual * (1.0 / row.variance);
                    }
                    Op::Fire { event, polarity, armed, .. } => {
                        fires = true;
                        let level = reference + if polarity > 0 { on } else { -off } + problem.beyond_of(event);
                        row.residual = level - voltage;
                        if armed {
                            row.sight = Sight::Event(polarity);
                            let threshold = if polarity > 0 { sensor.threshold_on } else { sensor.threshold_off };
                            row.variance = noise.event_variance(threshold);
                            if problem.stamp_sigma_s > 0.0 {
                                let current = self.pieces.root[j] * self.pieces.root[j];
                                let tau_light = sensor.front_end.tau_0_s * current + sensor.front_end.alpha_s;
                                let slope = if tau_light > 0.0 { (here - voltage) * current / tau_light } else { 0.0 };
                                let stamp = slope * problem.stamp_sigma_s;
                                row.variance += stamp * stamp;
                            }
                            cost += row.residual * row.residual * (1.0 / row.variance);
                        }
                        match sensor.reset {
                            Reset::Resample => blind = true,
                            Reset::Advance | Reset::AdvanceLossy if !armed => reference = level,
                            Reset::Advance | Reset::AdvanceLossy => {}
                        }
                    }
                }
                if row.sight == Sight::Frame {
                    cost += row.residual * row.residual;
                }
                self.rows.push(row);
            }
            next_op = end_op as usize;
            let mut broken = (0.0, 0_i8);
            if !blind && !fires {
                let change = voltage - reference;
                if change > on {
                    broken = (on - change, 1);
                } else if change < -off {
                    broken = (-off - change, -1);
                }
                no_event_square += broken.0 * broken.0;
            }
            self.no_event.push(broken);
        }
        self.measured_cost = cost + offsets.cost(noise);
        self.no_event_square = no_event_square;
    }

    /// Adds to what is predicted of the measurements, frames in standard deviations: `events` of each firing in order, `frames` of each frame; empty = nothing.
    pub fn shift(&mut self, knots: &Knots, events: &[f64], frames: impl Fn(u32) -> f64) {
        let mut event = 0;
        for (row, op) in self.rows.iter_mut().zip(&knots.ops) {
            match *op {
                Op::Fire { .. } => {
                    row.residual -= events.get(event).copied().unwrap_or(0.0);
                    event += 1;
                }
                Op::Read(l) => row.residual -= frames(l),
                _ => {}
            }
        }
    }

    /// How far the pixel's events and frames are from the predictions; those that carry no information (unarmed events, lower bounds that hold) are left away. And the largest
    /// of the squares that are summed up.
    pub fn misfit(&self) -> (Misfit, f64) {
        let (mut misfit, mut largest) = (Misfit::default(), 0.0);
        for row in &self.rows {
            let of_row = row.misfit();
            largest = f64::max(largest, of_row.event_square + of_row.frame_square);
            misfit.add(&of_row);
        }
        (misfit, largest)
    }

    /// Twice the negative log of the posterior density, less constants, when `prior_cost` is the prior's part and `no_event_sigma` the
    /// softness of the no-event constraint (0 = it does not count).
    pub fn cost(&self, prior_cost: f64, no_event_sigma: f64) -> f64 {
        let no_event = if no_event_sigma > 0.0 { self.no_event_square / (no_event_sigma * no_event_sigma) } else { 0.0 };
        self.measured_cost + prior_cost + no_event
    }
}
