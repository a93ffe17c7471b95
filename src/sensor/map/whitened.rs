//! What a pixel's measurements say that no light explains: residuals and columns with them, with the scene projected out.
//!
//! With residuals y and a column s of the same measurements (what an effect of unit size would change of each), the score of the effect is `s' C^-1 y` and its
//! information `s' C^-1 s`, where `C = noise + J Q J'` holds everything that light of the prior could do. The Kalman pass that solves a step gives a factor of
//! `C^-1`: its innovations over their standard deviations. So columns are sent through the same pass, one after another at once, and scores are plain products of what comes out.
//!
//! Limits: the problem as linearised at the given light; thresholds exact; the no-event constraint is left out here.

use super::chain::Sight;
use super::knots::Op;
use super::smoother::{Want, begin};
use super::state::{R, S, State, Transition, U, V, Z};
use super::{MapTask, MapWorkspace, Offsets, ask};

/// One number for each measurement of a pixel.
#[derive(Clone, Copy, Debug, Default)]
pub struct Column<'a> {
    /// Of each event of the problem, natural-log units: by how much voltage less reference less signed threshold rises. Those of unarmed events are not looked at.
    pub events: &'a [f64],
    /// Of each frame of the problem: by how much its value rises, DN.
    pub frames: &'a [f64],
}

/// Innovations of the residuals and of columns, in standard deviations.
#[derive(Clone, Debug, Default)]
pub struct Whitened {
    /// One line a measurement: the residual, then each column.
    pub values: Vec<f64>,
    /// Numbers a line.
    pub width: usize,
    /// Which measurement: `k` of an event, or `events + l` of a frame.
    pub measurement: Vec<u32>,
    /// The residual as it is, natural-log units or DN: measured less predicted.
    pub residual: Vec<f64>,
    /// Standard deviation that the measurement is assumed to, in the same unit.
    pub sigma: Vec<f64>,
}

impl Whitened {
    /// The lines.
    pub fn lines(&self) -> impl Iterator<Item = &[f64]> {
        self.values.chunks_exact(self.width.max(1))
    }
}

/// Sends residuals and columns of a pixel through the linearised problem at the light `u`, which stands at the knots that solving the task gives.
///
/// Residuals are measured less predicted, so that a column has a score above zero where its effect is missing in the prediction. Nothing comes out when `u` does
/// not fit the task. `shift` is added to what the sensor of the task predicts.
pub fn whiten(task: &MapTask<'_>, u: &[f64], shift: Column<'_>, columns: &[Column<'_>], workspace: &mut MapWorkspace, out: &mut Whitened) {
    let MapTask { problem, options } = task;
    out.values.clear();
    out.measurement.clear();
    out.residual.clear();
    out.sigma.clear();
    out.width = columns.len() + 1;
    workspace.knots.lay(problem, options.spacing_ns);
    if workspace.knots.len() != u.len() {
        return;
    }
    let first = linearise(task, u, shift, workspace);
    let MapWorkspace { knots, segments, chain, .. } = workspace;
    let offsets = Offsets::default();
    let ask = ask(problem, knots, segments, chain, u, first, &offsets, 0.0, 0.0, Want::Evidence);
    let mut state: State<f64, 5> = begin(&ask);
    let count = columns.len();
    let mut states = vec![0.0; 5 * count];
    let first_event = problem.events.partition_point(|event| event.t_in_ns < problem.start_ns);
    let (mut event, mut z_before) = (first_event, 0.0);
    for j in 0..knots.len() {
        if j > 0 {
            let transition = Transition::new(segments.correlation[j], segments.scale[j], &chain.slopes[j]);
            state.predict(&transition, segments.fresh[j], segments.correlation[j] * z_before - segments.z[j]);
            z_before = segments.z[j];
            for x in states.chunks_exact_mut(5) {
                let moved = transition.apply([x[U], x[Z], x[V], x[S]]);
                x[..4].copy_from_slice(&moved);
            }
        }
        for at in knots.ops_of(j) {
            let row = &chain.rows[at];
            let is_event = matches!(knots.ops[at], Op::Fire { .. });
            if row.sight != Sight::None {
                let (taken, measurement, scale) = match (row.sight, knots.ops[at]) {
                    (Sight::Event(polarity), _) => (state.take_event(polarity, row.residual, row.variance), event, 1.0),
                    (Sight::Frame, Op::Read(l)) => {
                        let taken = state.take_value(S, row.residual, row.variance);
                        (taken, problem.events.len() + l as usize, problem.frames[l as usize].sigma_dn)
                    }
                    _ => (state.take_value(U, row.residual, row.variance), usize::MAX, 1.0),
                };
                let root = libm::sqrt(taken.information);
                let is_own = measurement != usize::MAX;
                if is_own {
                    out.values.push(taken.pull / root);
                    out.measurement.push(measurement as u32);
                    out.residual.push(row.residual * scale);
                    out.sigma.push(libm::sqrt(row.variance) * scale);
                }
                for (column, x) in columns.iter().zip(states.chunks_exact_mut(5)) {
                    let (says, seen) = match row.sight {
                        Sight::Event(_) => (column.events[event], x[V] - x[R]),
                        Sight::Frame if is_own => (column.frames[measurement - problem.events.len()] / scale, x[S]),
                        _ => (0.0, x[U]),
                    };
                    let innovation = says - seen;
                    for (x, gain) in x.iter_mut().zip(&taken.gain) {
                        *x += gain * innovation;
                    }
                    if is_own {
                        out.values.push(innovation * root);
                    }
                }
            }
            match knots.ops[at] {
                Op::Expose(_) => {
                    state.forget(S);
                    states.chunks_exact_mut(5).for_each(|x| x[S] = 0.0);
                }
                Op::Latch => {
                    state.copy(R, V);
                    states.chunks_exact_mut(5).for_each(|x| x[R] = x[V]);
                }
                // An exact threshold moves no state.
                Op::Read(_) | Op::Lose | Op::Hint(_) | Op::Fire { .. } => {}
            }
            event += usize::from(is_event);
        }
    }
}

/// Chain, prior and shifted residuals at `u`, when the knots are laid; gives what the prior expects of the first log light.
fn linearise(task: &MapTask<'_>, u: &[f64], shift: Column<'_>, workspace: &mut MapWorkspace) -> f64 {
    let MapTask { problem, options } = task;
    let MapWorkspace { knots, segments, chain, start, u: first_u, .. } = workspace;
    segments.lay(&knots.t_ns, &options.prior);
    start.fill(problem, knots, first_u);
    let offsets = Offsets::default();
    chain.run(problem, knots, segments, u, &offsets);
    let inside = problem.events.partition_point(|event| event.t_in_ns < problem.start_ns);
    chain.shift(knots, shift.events.get(inside..).unwrap_or(&[]), |l| shift.frames.get(l as usize).map_or(0.0, |dn| dn / problem.frames[l as usize].sigma_dn));
    segments.adapt(u, &options.prior);
    segments.cost(u);
    first_u[0]
}

/// A measurement as all others predict it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LeftOut {
    /// `k` of an event, or `events + l` of a frame.
    pub measurement: u32,
    /// Measured less predicted, natural-log units or DN.
    pub residual: f64,
    /// Its variance, its own noise included.
    pub variance: f64,
}

/// One Gauss-Newton step of the light `u` of a pixel (at the knots that solving the task gives) when `shift` is added to what the sensor of the task predicts; no part of it
/// is longer than `longest`. `out` says how each measurement was predicted by the others before the step. Gives the length of the step, or nothing when `u` does not fit the task.
///
/// A caller who computes the shift anew after each step solves the pixel under any model, as long as the task's sensor is near enough for its derivatives. The no-event constraint is left out.
pub fn refine(task: &MapTask<'_>, u: &mut [f64], shift: Column<'_>, longest: f64, workspace: &mut MapWorkspace, out: &mut Vec<LeftOut>) -> Option<f64> {
    let MapTask { problem, options } = task;
    out.clear();
    workspace.knots.lay(problem, options.spacing_ns);
    if workspace.knots.len() != u.len() {
        return None;
    }
    let first = linearise(task, u, shift, workspace);
    let MapWorkspace { knots, segments, chain, smoother, .. } = workspace;
    smoother.solve(&ask(problem, knots, segments, chain, u, first, &Offsets::default(), 0.0, 0.0, Want::LeftOut));
    let mut left_out = smoother.left_out.iter();
    let mut event = problem.events.partition_point(|event| event.t_in_ns < problem.start_ns) as u32;
    for (row, op) in chain.rows.iter().zip(&knots.ops) {
        let seen = if row.sight == Sight::None { None } else { left_out.next() };
        if let Some((weighted, information)) = seen {
            let (measurement, scale) = match *op {
                Op::Read(l) => (problem.events.len() as u32 + l, problem.frames[l as usize].sigma_dn),
                _ => (event, 1.0),
            };
            if row.sight != Sight::Light {
                out.push(LeftOut { measurement, residual: scale * weighted / information, variance: scale * scale / information });
            }
        }
        event += u32::from(matches!(op, Op::Fire { .. }));
    }
    let length = smoother.change.iter().fold(0.0, |most, change| f64::max(most, change.abs()));
    if !length.is_finite() {
        return None;
    }
    let share = f64::min(1.0, longest / length);
    u.iter_mut().zip(&smoother.change).for_each(|(u, change)| *u += share * change);
    Some(length)
}

#[cfg(test)]
mod tests {
    use super::super::chain::Chain;
    use super::super::knots::Knots;
    use super::super::prior::Segments;
    use super::super::start::Start;
    use super::super::{MapEvent, MapFrame, MapOptions, MapProblem, MapSensor, Noise, Prior};
    use super::*;
    use crate::front_end::FrontEnd;
    use nalgebra::{DMatrix, DVector};
    use photocurrent_core::sensor::Reset;

    #[test]
    fn products_are_those_of_dense_algebra_with_numerical_derivatives() {
        let event = |t_in_ns: i64, polarity: i8| MapEvent { t_in_ns, t_off_ns: t_in_ns + 30_000, polarity, is_lone: false };
        // The fourth fires inside the blind time of the third: it is no measurement.
        let events = [event(2_100_000, 1), event(2_900_000, 1), event(5_000_000, -1), event(5_010_000, -1), event(9_000_000, 1)];
        let frame = |start_ns: i64, dn: f64| MapFrame { start_ns, end_ns: start_ns + 3_000_000, dn, sigma_dn: 2.0, saturated: false };
        let frames = [frame(500_000, 250.0), frame(6_000_000, 260.0)];
        let front_end = FrontEnd { tau_0_s: 20e-6, alpha_s: 12e-3 };
        let sensor = MapSensor {
            front_end,
            threshold_on: 0.2,
            threshold_off: 0.21,
            reset: Reset::Resample,
            refractory_ns: 50_000,
            gain: 850.0,
            black_level_dn: 0.0,
            saturation_dn: f64::INFINITY,
        };
        let noise = Noise { event: 0.1, reference: 0.03, ..Noise::default() };
        let (hints, lost_before) = (&[][..], &[][..]);
        let problem = MapProblem {
            events: &events,
            frames: &frames,
            hints,
            start_ns: 0,
            end_ns: 10_000_000,
            sensor,
            noise,
            stamp_sigma_s: 1e-4,
            no_event_sigma: 0.0,
            lost_before,
            beyond: &[],
        };
        let options = MapOptions { spacing_ns: 1_000_000, ..MapOptions::default() };
        let (mut knots, mut segments, mut u) = (Knots::default(), Segments::default(), Vec::new());
        knots.lay(&problem, options.spacing_ns);
        segments.lay(&knots.t_ns, &Prior::USUAL);
        Start::default().fill(&problem, &knots, &mut u);
        let first = u[0];
        // Somewhere else than at the start.
        u.iter_mut().zip(&knots.t_ns).for_each(|(u, t)| *u += 0.02 * libm::sin(*t as f64 * 1e-6));
        segments.adapt(&u, &Prior::USUAL);
        let (about_events, about_frames) = ([0.03, -0.02, 0.05, 9.0, 0.01], [1.5, -2.0]);
        let mut out = Whitened::default();
        let column = Column { events: &about_events, frames: &about_frames };
        whiten(&MapTask { problem, options }, &u, Column::default(), &[column, column], &mut MapWorkspace::default(), &mut out);
        assert_eq!(out.measurement, [0, 1, 5, 2, 6, 4]);

        // All that is trusted, in standard deviations, by light at the knots and the first reference.
        let mut chain = Chain::default();
        chain.run(&problem, &knots, &segments, &u, &Offsets::default());
        let fixed: Vec<f64> = chain.rows.iter().map(|row| row.variance.sqrt()).collect();
        let mut rows = |x: &DVector<f64>| -> DVector<f64> {
            let n = knots.len();
            let u: Vec<f64> = x.iter().copied().take(n).collect();
            chain.run(&problem, &knots, &segments, &u, &Offsets { reference: x[n], ..Offsets::default() });
            let mut rows = vec![(u[0] - first) / 3.0, x[n] / noise.reference];
            let mut before = 0.0;
            for j in 1..n {
                let z = (u[j] - u[j - 1]) / segments.scale[j];
                rows.push((z - segments.correlation[j] * before) / segments.fresh[j].sqrt());
                before = z;
            }
            rows.extend(chain.rows.iter().zip(&fixed).map(|(row, sigma)| if row.sight == Sight::None { 0.0 } else { row.residual / sigma }));
            DVector::from_vec(rows)
        };
        let at = DVector::from_iterator(u.len() + 1, u.iter().copied().chain([0.0]));
        let here = rows(&at);
        let mut jacobian = DMatrix::zeros(here.len(), at.len());
        for k in 0..at.len() {
            let (mut above, mut below) = (at.clone(), at.clone());
            above[k] += 1e-6;
            below[k] -= 1e-6;
            jacobian.set_column(k, &((rows(&above) - rows(&below)) / 2e-6));
        }
        chain.run(&problem, &knots, &segments, &u, &Offsets::default());
        let mut says = DVector::zeros(here.len());
        let (mut event, from) = (0, here.len() - chain.rows.len());
        for (n, (row, op)) in chain.rows.iter().zip(&knots.ops).enumerate() {
            match *op {
                Op::Fire { .. } => {
                    says[from + n] = if row.sight == Sight::None { 0.0 } else { about_events[event] / fixed[n] };
                    event += 1;
                }
                Op::Read(l) => says[from + n] = about_frames[l as usize] / 2.0,
                _ => {}
            }
        }
        let left = |y: &DVector<f64>| y - &jacobian * jacobian.clone().svd(true, true).solve(y, 1e-12).unwrap();
        let product = |a: usize, b: usize| out.lines().map(|line| line[a] * line[b]).sum::<f64>();
        for (found, expected) in [(product(0, 0), left(&here).dot(&here)), (product(0, 1), left(&here).dot(&says)), (product(1, 2), left(&says).dot(&says))] {
            assert!((found / expected - 1.0).abs() < 1e-5, "{found} against {expected}");
        }

        let (mut moved, mut predicted) = (u.clone(), Vec::new());
        refine(&MapTask { problem, options }, &mut moved, column, 100.0, &mut MapWorkspace::default(), &mut predicted).unwrap();
        let shifted = &here - &says;
        let change = jacobian.clone().svd(true, true).solve(&-&shifted, 1e-12).unwrap();
        for (k, moved) in moved.iter().enumerate() {
            assert!((moved - u[k] - change[k]).abs() < 1e-6, "knot {k}");
        }
        // The residual of a row that is left out, from the rest by dense algebra.
        let one = predicted[3];
        let row = from + chain.rows.iter().enumerate().filter(|(_, row)| row.sight != Sight::None).nth(3).unwrap().0;
        let mut unit = DVector::zeros(here.len());
        unit[row] = 1.0;
        let (weighted, information) = (left(&shifted)[row], left(&unit)[row]);
        assert_eq!(one.measurement, 2);
        assert!((one.residual / (weighted / information * fixed[row - from]) - 1.0).abs() < 1e-5);
        assert!((one.variance / (fixed[row - from].powi(2) / information) - 1.0).abs() < 1e-5);
    }
}
