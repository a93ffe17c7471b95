//! The forward pass of one pixel at given unknowns: voltages, residuals, and everything the linearised problem needs.

use super::knots::{Knots, Op};
use super::prior::Segments;
use super::segment::{Ramp, collected};
use super::{MapProblem, Offsets};
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
}

/// One measurement, linearised: measured minus predicted, with its variance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    pub sight: Sight,
    pub residual: f64,
    pub variance: f64,
}

/// A segment's derivatives: of the voltage by voltage and both ends, of the scaled light by both ends.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Slopes {
    pub by_voltage: f64,
    pub by_first: f64,
    pub by_last: f64,
    pub light_by_first: f64,
    pub light_by_last: f64,
}

/// A pixel's unknowns turned into predictions.
#[derive(Clone, Debug, Default)]
pub(super) struct Chain {
    /// Derivatives of the segment that ends at each knot.
    pub slopes: Vec<Slopes>,
    /// One for each op of the knots.
    pub rows: Vec<Row>,
    /// Silence that is broken at a knot: how far to move back, and the polarity of the threshold; polarity 0 where all is well.
    pub silence: Vec<(f64, i8)>,
    /// Twice the negative log of the posterior density, less constants.
    pub cost: f64,
}

impl Chain {
    /// Runs the pixel at `u`.
    pub fn run(&mut self, problem: &MapProblem<'_>, knots: &Knots, segments: &Segments, u: &[f64], offsets: &Offsets) {
        let sensor = &problem.sensor;
        let noise = &problem.noise;
        self.slopes.clear();
        self.rows.clear();
        self.silence.clear();
        let mut cost = 0.0;
        let mut voltage = u[0];
        let mut reference = voltage + offsets.reference;
        let (on, off) = (sensor.threshold_on + offsets.on, sensor.threshold_off + offsets.off);
        // Light counts in standard deviations of the frame that is exposed.
        let (mut light, mut scale) = (0.0, 0.0);
        let mut z_before = 0.0;
        let mut blind = false;
        for j in 0..knots.len() {
            let mut slopes = Slopes::default();
            if j > 0 {
                let length_s = segments.length_s[j];
                let ramp = Ramp::new(&sensor.front_end, voltage, u[j - 1], u[j], length_s);
                voltage = ramp.voltage;
                slopes = Slopes { by_voltage: ramp.by_voltage, by_first: ramp.by_first, by_last: ramp.by_last, ..slopes };
                if scale > 0.0 {
                    let (part, by_first, by_last) = collected(u[j - 1], u[j], length_s);
                    light += scale * part;
                    slopes.light_by_first = scale * by_first;
                    slopes.light_by_last = scale * by_last;
                }
                let z = (u[j] - u[j - 1]) / segments.scale[j];
                let correlation = segments.correlation[j];
                let surprise = z - correlation * z_before;
                cost += surprise * surprise / (1.0 - correlation * correlation);
                z_before = z;
            }
            self.slopes.push(slopes);
            let mut fires = false;
            for op in &knots.ops[knots.ops_of(j)] {
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
                    Op::Fire { polarity, armed, .. } => {
                        fires = true;
                        let level = reference + if polarity > 0 { on } else { -off };
                        row.residual = level - voltage;
                        if armed {
                            row.sight = Sight::Event(polarity);
                            let tau_s = sensor.front_end.tau_0_s + sensor.front_end.alpha_s * libm::exp(-u[j]);
                            let slope = if tau_s > 0.0 { (u[j] - voltage) / tau_s } else { 0.0 };
                            let stamp = slope * problem.stamp_sigma_s;
                            let threshold = if polarity > 0 { sensor.threshold_on } else { sensor.threshold_off };
                            row.variance = noise.event_variance(threshold) + stamp * stamp;
                            let (weight, price) = noise.judge(row.residual * row.residual / row.variance);
                            row.variance /= weight;
                            cost += price;
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
            let mut broken = (0.0, 0_i8);
            if problem.silence_sigma > 0.0 && !blind && !fires {
                let change = voltage - reference;
                if change > on {
                    broken = (on - change, 1);
                } else if change < -off {
                    broken = (-off - change, -1);
                }
                let ratio = broken.0 / problem.silence_sigma;
                cost += ratio * ratio;
            }
            self.silence.push(broken);
        }
        self.cost = cost + offsets.cost(noise);
    }
}
