//! One pixel: a Newton step of its light, and the score of effects with its light adapted.

use super::envelope::{EnvelopeMatrix, InverseRoom, dot};
use super::path::{JacobianRows, PixelPath, TimeSplines};
use crate::free::{PixelPrediction, SceneNoise, Score};
use crate::picture::ROBUST;
use crate::statistics::NU;

/// The voltage rises by at least this share of a threshold over an instant before an event.
pub const LEAST_RISE: f64 = 0.01;
/// No coefficient moves by more in a step, natural-log units.
const LONGEST_STEP: f64 = 0.6;
/// Added to every diagonal element: natural-log units to the power of -2.
const RIDGE: f64 = 1e-6;

/// Result of a step of one pixel.
#[derive(Clone, Debug, Default)]
pub(super) struct PixelStep {
    /// The new coefficients.
    pub coefficients: Vec<f64>,
    /// Squares of their second differences.
    pub square: Vec<f64>,
    /// Share of each of these that measurements decide, 0 to 1.
    pub decided: Vec<f64>,
    /// Variance of the voltage difference of each event that the measurements leave.
    pub event_variance: Vec<f64>,
    /// The share of each event's information that it has about itself: its leverage, 0 to 1.
    pub leverage: Vec<f64>,
}

/// Room for the work on one pixel after another.
#[derive(Default)]
pub(super) struct PixelWork {
    path: PixelPath,
    frames: JacobianRows,
    events: JacobianRows,
    rises: JacobianRows,
    quiet: JacobianRows,
    weight: Vec<f64>,
    rise: Vec<f64>,
    /// Of instants without an event: weight and residual.
    quiet_terms: Vec<(f64, f64)>,
    first: Vec<usize>,
    envelope: EnvelopeMatrix,
    gradient: Vec<f64>,
    inverse: InverseRoom,
}

/// Present light of a pixel: coefficients, and variances of their second differences.
#[derive(Clone, Copy)]
pub(super) struct PixelView<'a> {
    pub splines: &'a TimeSplines,
    pub coefficients: &'a [f64],
    pub variance: &'a [f64],
    pub noise: &'a SceneNoise,
    pub predicted: &'a PixelPrediction,
}

impl PixelWork {
    /// Rows, weights, gradient and the factor of the normal equations.
    fn assemble_equations(&mut self, of: &PixelView<'_>) -> bool {
        let PixelView { splines, coefficients, predicted, .. } = *of;
        splines.values(coefficients, &mut self.path.log);
        self.path.set_log_light(splines, predicted.low_pass);
        for rows in [&mut self.frames, &mut self.events, &mut self.rises, &mut self.quiet] {
            rows.clear();
        }
        for frame in &predicted.frames {
            self.path.push_exposure(
                splines,
                [frame.start_ns, frame.end_ns],
                predicted.gain,
                &mut self.frames,
            );
        }
        for event in &predicted.events {
            self.path.push_difference(splines, [event.t_ns, event.reference_ns], &mut self.events);
            self.path.push_difference(splines, [event.t_ns, event.t_ns - splines.step_ns], &mut self.rises);
        }
        for quiet in &predicted.quiet {
            self.path.push_difference(splines, [quiet.t_ns, quiet.reference_ns], &mut self.quiet);
        }
        self.weigh(of);
        self.assemble(of);
        self.envelope.factor()
    }

    /// Weights of frame values, then of events; the rise of the voltage before each event.
    fn weigh(&mut self, of: &PixelView<'_>) {
        let PixelView { coefficients, noise, predicted, .. } = *of;
        self.weight.clear();
        self.weight.extend(predicted.frames.iter().map(|frame| {
            let variance = noise.frame_variance(frame.signal_dn);
            let far = frame.residual_dn * frame.residual_dn / variance / (ROBUST * ROBUST);
            1.0 / variance / (1.0 + far)
        }));
        self.weight.extend(predicted.events.iter().map(|event| {
            let variance = noise.event_variance(event);
            (NU + 1.0) / variance / (NU + event.excess * event.excess / variance)
        }));
        self.quiet_terms.clear();
        self.quiet_terms.extend(predicted.quiet.iter().map(|quiet| {
            let term = noise.quiet_term(quiet);
            (term.weight, term.residual)
        }));
        self.rise.clear();
        for (k, event) in predicted.events.iter().enumerate() {
            let (from, row) = (self.rises.from[k], self.rises.row(k));
            let rise = event.polarity * dot(row, &coefficients[from..from + row.len()]);
            self.rise.push(event.polarity * f64::max(rise, LEAST_RISE * event.threshold));
        }
    }

    fn assemble(&mut self, of: &PixelView<'_>) {
        let PixelView { coefficients, variance, predicted, .. } = *of;
        let count = coefficients.len();
        self.first.clear();
        // Second differences reach two unknowns back.
        self.first.extend((0..count).map(|k: usize| k.saturating_sub(2)));
        for rows in [&self.frames, &self.events, &self.rises, &self.quiet] {
            for r in 0..rows.len() {
                let from = rows.from[r];
                for k in rows.row(r).iter().enumerate().filter(|(_, v)| **v != 0.0).map(|(k, _)| from + k) {
                    self.first[k] = self.first[k].min(from);
                }
            }
        }
        self.envelope.reset(&self.first);
        self.gradient.clear();
        self.gradient.resize(count, 0.0);
        let residual = |r: usize| match r.checked_sub(predicted.frames.len()) {
            None => predicted.frames[r].residual_dn,
            Some(event) => predicted.events[event].excess,
        };
        let mut put = |from: usize, row: &[f64], weight: f64, residual: f64| {
            self.envelope.add_square(from, row, weight);
            let to = &mut self.gradient[from..from + row.len()];
            to.iter_mut().zip(row).for_each(|(to, v)| *to += weight * residual * v);
        };
        for r in 0..self.frames.len() {
            put(self.frames.from[r], self.frames.row(r), self.weight[r], residual(r));
        }
        let frames = self.frames.len();
        for k in 0..self.events.len() {
            put(self.events.from[k], self.events.row(k), self.weight[frames + k], residual(frames + k));
            // An event's time is what is measured: its density has the slope of the voltage as a factor,
            // whose logarithm is subtracted.
            let rise = self.rise[k];
            put(self.rises.from[k], self.rises.row(k), 1.0 / (rise * rise), -rise);
        }
        for (k, (weight, residual)) in self.quiet_terms.iter().enumerate() {
            put(self.quiet.from[k], self.quiet.row(k), *weight, *residual);
        }
        for (k, variance) in variance.iter().enumerate() {
            let second = coefficients[k] - 2.0 * coefficients[k + 1] + coefficients[k + 2];
            put(k, &[1.0, -2.0, 1.0], 1.0 / variance, second);
        }
        (0..count).for_each(|k| self.envelope.add(k, k, RIDGE));
    }

    /// All rows in the order of an effect's column: the first coefficient, derivatives, weight and residual.
    #[cfg(test)]
    pub(super) fn rows(&mut self, of: &PixelView<'_>) -> Vec<(usize, Vec<f64>, f64, f64)> {
        assert!(self.assemble_equations(of), "the equations can be solved");
        let of = |r: usize| {
            let PixelMeasurement { from, row, weight, residual, is_rise } = self.measured(of, r);
            if is_rise {
                return (from, row.iter().map(|v| v * weight).collect(), 1.0, residual);
            }
            (from, row.to_vec(), weight, residual)
        };
        (0..self.measurements()).map(of).collect()
    }

    /// A Newton step; none where the normal equations are singular. Variances are computed where
    /// `is_measured`, and empty otherwise.
    pub(super) fn step(&mut self, of: &PixelView<'_>, is_measured: bool) -> Option<PixelStep> {
        if !self.assemble_equations(of) {
            return None;
        }
        let mut step = PixelStep { coefficients: of.coefficients.to_vec(), ..PixelStep::default() };
        let mut by = self.gradient.clone();
        self.envelope.forward(&mut by, 0);
        self.envelope.backward(&mut by);
        step.coefficients.iter_mut().zip(&by).for_each(|(c, by)| *c -= by.clamp(-LONGEST_STEP, LONGEST_STEP));
        if !is_measured {
            return Some(step);
        }
        self.envelope.invert(&mut self.inverse);
        for (k, variance) in of.variance.iter().enumerate() {
            let second = step.coefficients[k] - 2.0 * step.coefficients[k + 1] + step.coefficients[k + 2];
            step.square.push(second * second);
            step.decided
                .push((1.0 - self.envelope.square_of(k, &[1.0, -2.0, 1.0]) / variance).clamp(0.0, 1.0));
        }
        (step.event_variance, step.leverage) = self.events_left();
        Some(step)
    }

    /// Of each event the variance that the measurements leave of its voltage difference, and its leverage;
    /// of an inverse.
    fn events_left(&self) -> (Vec<f64>, Vec<f64>) {
        let left = |(k, weight): (usize, &f64)| {
            let variance = self.envelope.square_of(self.events.from[k], self.events.row(k));
            (variance, variance * weight)
        };
        self.weight[self.frames.len()..].iter().enumerate().map(left).unzip()
    }

    /// Score of effects; `columns`: the change by each of frame values, of events' excesses and of log slopes
    /// at events, and of excesses at instants without one, K for each. `None` where the normal equations are
    /// singular.
    pub(super) fn score(&mut self, of: &PixelView<'_>, columns: &[f32], effects: usize) -> Option<Score> {
        if !self.assemble_equations(of) {
            return None;
        }
        let count = self.envelope.len();
        // Behind the effects the gradient: all are solved for together.
        let mut through = vec![vec![0.0; count]; effects + 1];
        through[effects].copy_from_slice(&self.gradient);
        let mut found = Score {
            score: vec![0.0; effects],
            information: vec![0.0; effects * effects],
            known: vec![0.0; effects],
        };
        for r in 0..self.measurements() {
            let PixelMeasurement { from, row, weight, residual, is_rise } = self.measured(of, r);
            for (k, column) in columns[r * effects..(r + 1) * effects].iter().enumerate() {
                let by = f64::from(*column);
                if by == 0.0 {
                    continue;
                }
                // A rise's row is of the rise itself: its logarithm changes by the row over the rise.
                let of_effect = if is_rise { by } else { by * weight };
                found.score[k] += of_effect * residual;
                let to = &mut through[k][from..from + row.len()];
                let scale = by * weight;
                to.iter_mut().zip(row).for_each(|(to, v)| *to += scale * v);
                let others = &columns[r * effects..r * effects + k + 1];
                let to = &mut found.information[k * effects..k * effects + k + 1];
                to.iter_mut().zip(others).for_each(|(to, other)| *to += of_effect * f64::from(*other));
            }
        }
        (0..effects).for_each(|k| found.known[k] = found.information[k * effects + k]);
        through.iter_mut().for_each(|column| self.envelope.forward(column, 0));
        for k in 0..effects {
            found.score[k] -= dot(&through[k], &through[effects]);
            for other in 0..=k {
                let shared = dot(&through[k], &through[other]);
                found.information[k * effects + other] -= shared;
                found.information[other * effects + k] = found.information[k * effects + other];
            }
        }
        Some(found)
    }
    /// Gain of effects of given sizes in the densities of event times, with the light estimated from
    /// everything else, and of none between them, nats: with one Newton step of the light, as in
    /// [`PixelWork::score`], and leverages as they are. `None` where the normal equations are singular.
    pub(super) fn gains(&mut self, of: &PixelView<'_>, columns: &[f32], sizes: &[f64]) -> Option<Vec<f64>> {
        if !self.assemble_equations(of) {
            return None;
        }
        let (effects, frames, events) = (sizes.len(), self.frames.len(), self.events.len());
        // Behind the effects the light without one.
        let mut steps = vec![self.gradient.clone(); effects + 1];
        for r in 0..self.measurements() {
            let PixelMeasurement { from, row, weight, .. } = self.measured(of, r);
            for (k, size) in sizes.iter().enumerate() {
                let scale = f64::from(columns[r * effects + k]) * size * weight;
                if scale != 0.0 {
                    let to = &mut steps[k][from..from + row.len()];
                    to.iter_mut().zip(row).for_each(|(to, v)| *to += scale * v);
                }
            }
        }
        for step in &mut steps {
            self.envelope.forward(step, 0);
            self.envelope.backward(step);
        }
        self.envelope.invert(&mut self.inverse);
        let (_, leverage) = self.events_left();
        let density = |k: usize| {
            let size = sizes.get(k).copied().unwrap_or(0.0);
            let moved = |r: usize| {
                let PixelMeasurement { from, row, weight, is_rise, .. } = self.measured(of, r);
                let by = if k < effects { f64::from(columns[r * effects + k]) * size } else { 0.0 };
                let of_light = dot(row, &steps[k][from..from + row.len()]);
                by - if is_rise { weight * of_light } else { of_light }
            };
            let event = |k: usize| [moved(frames + k), moved(frames + events + k)];
            of.noise.log_density(of.predicted, &leverage, event, |k| moved(frames + 2 * events + k))
        };
        let without = density(effects);
        Some((0..effects).map(|k| density(k) - without).collect())
    }

    /// Number of measurements: frame values, events, their rises, instants without one.
    fn measurements(&self) -> usize {
        self.frames.len() + 2 * self.events.len() + self.quiet.len()
    }

    /// One of them, in that order.
    fn measured(&self, of: &PixelView<'_>, r: usize) -> PixelMeasurement<'_> {
        let (frames, events) = (self.frames.len(), self.events.len());
        let (rows, k, weight, residual) = match r.checked_sub(frames) {
            None => (&self.frames, r, self.weight[r], of.predicted.frames[r].residual_dn),
            Some(k) if k < events => (&self.events, k, self.weight[r], of.predicted.events[k].excess),
            Some(k) if k < 2 * events => (&self.rises, k - events, 1.0 / self.rise[k - events], -1.0),
            Some(k) => {
                let (weight, residual) = self.quiet_terms[k - 2 * events];
                (&self.quiet, k - 2 * events, weight, residual)
            }
        };
        let is_rise = (frames + events..frames + 2 * events).contains(&r);
        PixelMeasurement { from: rows.from[k], row: rows.row(k), weight, residual, is_rise }
    }
}

/// A measurement of a pixel: its row begins at coefficient `from`. Of a rise's logarithm the row is that of
/// the rise, and the weight one over it.
struct PixelMeasurement<'a> {
    from: usize,
    row: &'a [f64],
    weight: f64,
    residual: f64,
    is_rise: bool,
}
