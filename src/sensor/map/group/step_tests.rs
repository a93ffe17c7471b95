//! Claims about one step: it is that of dense algebra with numerical derivatives, for every reset rule,
//! family of priors and set of states.

use super::super::prior::FIRST_SLOPE_VARIANCE;
use super::super::tests::{event, sensor};
use super::super::{Hint, MapFrame, MapOptions, MapProblem, MapSensor, MapTask, Noise, Offsets, Prior};
use super::columns::{Common, adapt, run};
use super::lane::{is_exact, lanes_of, offsets as of_lanes};
use super::passes::step;
use super::solve::{InStep, ask};
use super::stream::{EVENT, FRAME, LIGHT, SEGMENT};
use crate::wide::{WIDTH, Wide};
use nalgebra::{DMatrix, DVector};
use photocurrent_core::sensor::Reset;

/// One pixel in the first lane of a group, at light and offsets of the test's own.
struct Alone<'a> {
    group: InStep<WIDTH>,
    common: Common<WIDTH>,
    task: MapTask<'a>,
    first: f64,
}

impl<'a> Alone<'a> {
    /// At its start; the prior expects `above` more than that of the first log light.
    fn new(problem: MapProblem<'a>, options: MapOptions, above: f64) -> Alone<'a> {
        let mut group = InStep::default();
        let task = MapTask { problem, options };
        let common = group.begin(&lanes_of(&[task], &[0]), 1);
        adapt(&mut group.columns, &common, &group.u);
        let first = group.lanes[0].u[0] + above;
        Alone { group, common, task, first }
    }

    fn start(&self) -> Vec<f64> {
        self.group.lanes[0].u.clone()
    }

    /// Its log light becomes `u`; gives the cost of the prior whose scales are those of where it was adapted.
    fn place(&mut self, u: &[f64], offsets: Offsets) -> f64 {
        let group = &mut self.group;
        group.lanes[0].stream.spread(u, 0, &mut group.u);
        group.lanes[0].state.offsets = offsets;
        let cost = run(&group.columns, &self.common, &group.u, &of_lanes(&group.lanes), &mut group.lines);
        cost.prior.0[0]
    }

    fn adapt(&mut self) {
        adapt(&mut self.group.columns, &self.common, &self.group.u);
    }

    /// The pixel's own steps.
    fn steps(&self) -> usize {
        self.group.lanes[0].stream.steps.len()
    }

    /// What the prior expects of the light that stands there, in standard deviations, at frozen scales.
    fn prior_rows(&self) -> Vec<f64> {
        let (mut rows, mut before) = (vec![(self.group.u[0].0[0] - self.first) / 3.0], 0.0);
        for s in (1..self.steps()).filter(|s| self.group.columns.what[*s].0[0] & SEGMENT != 0) {
            let expected = &self.group.columns.expected[s];
            let z = (self.group.u[s].0[0] - self.group.u[s - 1].0[0]) / expected.scale.0[0];
            rows.push((z - expected.correlation.0[0] * before) / expected.fresh.0[0].sqrt());
            before = z;
        }
        rows
    }

    /// Residual, variance and kind of each measurement.
    fn measured(&self) -> Vec<(f64, f64, u64)> {
        let lines = self.group.lines[..self.steps()]
            .iter()
            .map(|line| (line.residual.0[0], line.variance.0[0], line.sight.0[0] & (EVENT | FRAME | LIGHT)));
        lines.filter(|(.., sight)| *sight != 0).collect()
    }

    fn at_knots(&self, values: &[Wide<WIDTH>]) -> Vec<f64> {
        let mut knots = Vec::new();
        self.group.lanes[0].stream.of_knots(values, 0, &mut knots);
        knots
    }

    /// The change of log light at each knot, and of the offsets.
    fn step(&mut self, damping: f64) -> (Vec<f64>, Offsets) {
        let is_exact = is_exact(&self.task);
        let InStep { lanes, columns, lines, u, exact, free, change, .. } = &mut self.group;
        let ask = ask(lanes, columns, lines, (Wide::splat(self.first), u[0]), Wide::splat(damping));
        let by = if is_exact { step(&ask, exact, change).1 } else { step(&ask, free, change).1 };
        (self.at_knots(&self.group.change), by.lane(0))
    }

    /// The log of the marginal likelihood and the posterior variance at each knot.
    fn judge(&mut self) -> (f64, Vec<f64>) {
        let log_evidence =
            self.group.judge_all(&self.common, Wide::splat(self.first), is_exact(&self.task), true)[0];
        (log_evidence, self.at_knots(&self.group.variance))
    }
}

fn frame(start_ns: i64, dn: f64) -> MapFrame {
    MapFrame { start_ns, end_ns: start_ns + 3_000_000, dn, sigma_dn: 2.0, saturated: false }
}

const FAMILIES: [Prior; 3] =
    [Prior::USUAL, Prior::Walk { per_s: 1.0, nu: 1.0 }, Prior::IntegratedWalk { per_s3: 3e6, nu: 3.0 }];

/// Five events, two frames, and two pseudo-measurements: one between events, one at an event's instant.
fn with_pixels(then: impl Fn(&str, MapProblem<'_>, MapOptions)) {
    let events = [
        event(2_100_000, 1),
        event(2_900_000, 1),
        event(5_000_000, -1),
        event(5_080_500, -1),
        event(9_000_000, 1),
    ];
    let frames = [frame(500_000, 250.0), frame(6_000_000, 260.0)];
    let hint =
        |t_ns, log_photocurrent, variance| Hint { t_ns, log_photocurrent, variance, for_sigma: variance };
    let hints = [hint(4_100_000, 4.7, 0.01), hint(9_000_000, 4.5, 0.04)];
    for (reset, prior) in
        [Reset::Resample, Reset::Advance].into_iter().flat_map(|reset| FAMILIES.map(|prior| (reset, prior)))
    {
        for threshold in [0.02, 0.0] {
            let problem = MapProblem {
                hints: &hints,
                noise: Noise { event: 0.1, reference: 0.03, threshold, ..Noise::default() },
                ..MapProblem::new(sensor(reset), &events, &frames, (0, 10_000_000))
            };
            let options = MapOptions { prior, spacing_ns: 1_000_000, ..MapOptions::default() };
            then(&format!("{reset:?} {prior:?} {threshold}"), problem, options);
        }
    }
}

/// Rows of the prior and of the measurements, in standard deviations, and their numerical derivatives by
/// light and offsets.
struct Dense {
    prior: DVector<f64>,
    measured: DVector<f64>,
    prior_slopes: DMatrix<f64>,
    measured_slopes: DMatrix<f64>,
}

impl Dense {
    fn new(pixel: &mut Alone<'_>, u: &[f64], offsets: Offsets) -> Dense {
        let n = u.len();
        let noise = pixel.task.problem.noise;
        let unknowns = if noise.threshold > 0.0 { n + 3 } else { n + 1 };
        let at: Vec<f64> =
            u.iter().copied().chain([offsets.reference, offsets.on, offsets.off]).take(unknowns).collect();
        let mut rows = |x: &[f64]| {
            let of = |k: usize| x.get(n + k).copied().unwrap_or(0.0);
            pixel.place(&x[..n], Offsets { reference: of(0), on: of(1), off: of(2) });
            let mut prior = pixel.prior_rows();
            prior.push(of(0) / noise.reference);
            prior.extend((n + 1..unknowns).map(|k| x[k] / noise.threshold));
            let measured = pixel
                .measured()
                .into_iter()
                .map(|(residual, variance, _)| residual / variance.sqrt())
                .collect();
            (DVector::from_vec(prior), DVector::from_vec(measured))
        };
        let (prior, measured) = rows(&at);
        let (mut prior_slopes, mut measured_slopes) =
            (DMatrix::zeros(prior.len(), unknowns), DMatrix::zeros(measured.len(), unknowns));
        for column in 0..unknowns {
            let (mut above, mut below) = (at.clone(), at.clone());
            above[column] += 1e-5;
            below[column] -= 1e-5;
            let (above, below) = (rows(&above), rows(&below));
            prior_slopes.set_column(column, &((above.0 - below.0) / 2e-5));
            measured_slopes.set_column(column, &((above.1 - below.1) / 2e-5));
        }
        rows(&at);
        Dense { prior, measured, prior_slopes, measured_slopes }
    }

    /// The posterior covariance when changes of log light at `n` knots are damped, and the step.
    fn step(&self, n: usize, damping: f64) -> (DMatrix<f64>, DVector<f64>) {
        let (a, b) = (&self.prior_slopes, &self.measured_slopes);
        let mut curvature = a.transpose() * a + b.transpose() * b;
        (0..n).for_each(|k| curvature[(k, k)] += damping);
        let covariance = curvature.try_inverse().expect("a prior makes it regular");
        let step = -(&covariance * (a.transpose() * &self.prior + b.transpose() * &self.measured));
        (covariance, step)
    }

    /// The log density of the measurements, of these variances.
    fn log_evidence(&self, variances: impl Iterator<Item = f64>) -> f64 {
        let inverse = self.prior_slopes.clone().try_inverse().expect("as many rows of the prior as unknowns");
        let through = &self.measured_slopes * inverse;
        let innovation = &self.measured - &through * &self.prior;
        let spread = DMatrix::identity(innovation.len(), innovation.len()) + &through * through.transpose();
        let square = innovation.dot(&(spread.clone().try_inverse().expect("it is positive") * &innovation));
        let logs: f64 = variances.map(|variance| libm::log(std::f64::consts::TAU * variance)).sum();
        -0.5 * (square + libm::log(spread.determinant()) + logs)
    }
}

#[test]
fn one_step_is_that_of_dense_algebra_with_numerical_derivatives() {
    with_pixels(|of, problem, options| {
        let mut pixel = Alone::new(problem, options, 0.05);
        let (u, offsets) = (pixel.start(), Offsets { reference: 0.01, on: -0.01, off: 0.015 });
        let offsets = if problem.noise.threshold > 0.0 {
            offsets
        } else {
            Offsets { reference: 0.01, ..Offsets::default() }
        };
        let dense = Dense::new(&mut pixel, &u, offsets);
        let n = u.len();
        // Second differences of rows up to 1e4 in size: a relative error of 1e-5 is what numerical
        // derivatives allow.
        for damping in [0.0, 300.0] {
            let (covariance, expected) = dense.step(n, damping);
            let (change, by) = pixel.step(damping);
            for j in 0..n {
                assert!(
                    (change[j] - expected[j]).abs() < 1e-4 * (0.1 + expected[j].abs()),
                    "{of} {damping} knot {j}: {} against {}",
                    change[j],
                    expected[j]
                );
            }
            for (moved, expected) in [by.reference, by.on, by.off].into_iter().zip(expected.iter().skip(n)) {
                assert!(
                    (moved - expected).abs() < 1e-4 * (0.01 + expected.abs()),
                    "{of} {damping}: {moved} against {expected}"
                );
            }
            if damping == 0.0 {
                for (j, variance) in pixel.judge().1.into_iter().enumerate() {
                    assert!(
                        (variance / covariance[(j, j)] - 1.0).abs() < 1e-3,
                        "{of} knot {j}: {variance} against {}",
                        covariance[(j, j)]
                    );
                }
            }
        }
    });
}

#[test]
fn the_evidence_is_the_density_of_the_measurements() {
    with_pixels(|of, problem, options| {
        let mut pixel = Alone::new(MapProblem { hints: &[], ..problem }, options, 0.05);
        let u = pixel.start();
        let dense = Dense::new(&mut pixel, &u, Offsets::default());
        let expected = dense.log_evidence(pixel.measured().into_iter().map(|(_, variance, _)| variance));
        let log_evidence = pixel.judge().0;
        assert!(
            (log_evidence - expected).abs() < 1e-3 * (1.0 + expected.abs()),
            "{of}: {log_evidence} against {expected}"
        );
    });
}

#[test]
fn what_pseudo_measurements_count_as_for_the_variance_changes_that_alone() {
    with_pixels(|of, problem, options| {
        let found = |variance: f64, for_sigma: f64| {
            let hints: Vec<Hint> = problem
                .hints
                .iter()
                .map(|hint| Hint {
                    variance: variance * hint.variance,
                    for_sigma: for_sigma * hint.variance,
                    ..*hint
                })
                .collect();
            let mut pixel = Alone::new(MapProblem { hints: &hints, ..problem }, options, 0.05);
            let u = pixel.start();
            pixel.place(&u, Offsets::default());
            let change = pixel.step(0.0).0;
            pixel.group.widen_hints();
            (change, pixel.judge().1)
        };
        let (same, wide, worse) = (found(1.0, 1.0), found(1.0, 9.0), found(9.0, 9.0));
        assert_eq!(wide.0, same.0, "{of}");
        // As if they were that much worse.
        assert_eq!(wide.1, worse.1, "{of}");
        assert!(wide.1 != same.1 && wide.1.iter().zip(&same.1).all(|(wide, narrow)| wide >= narrow), "{of}");
    });
}

/// -2 log of Student's t of an increment with squared scale `square`, less constants.
fn student(increment: f64, square: f64, nu: f64) -> f64 {
    (nu + 1.0) * libm::log(1.0 + increment * increment / (nu * square))
}

#[test]
fn the_weights_of_both_walks_have_the_gradient_of_students_t() {
    let t_ns: [i64; 5] = [0, 250_000, 400_000, 1_400_000, 1_650_000];
    let at = [4.0, 4.02, 4.3, 4.28, 4.9];
    let seconds = t_ns.map(|t| t as f64 * 1e-9);
    let walk = |u: &[f64]| -> f64 {
        (1..5).map(|j| student(u[j] - u[j - 1], 1.0 * (seconds[j] - seconds[j - 1]), 1.0)).sum()
    };
    let integrated_walk = |u: &[f64]| -> f64 {
        let slope = |j: usize| (u[j] - u[j - 1]) / (seconds[j] - seconds[j - 1]);
        let middle = |j: usize| 0.5 * (seconds[j] + seconds[j - 1]);
        let first = slope(1) * slope(1) / FIRST_SLOPE_VARIANCE;
        first
            + (2..5)
                .map(|j| student(slope(j) - slope(j - 1), 3e6 * (middle(j) - middle(j - 1)), 3.0))
                .sum::<f64>()
    };
    type Cost<'a> = &'a dyn Fn(&[f64]) -> f64;
    // Knots stand where pseudo-measurements are.
    let hints =
        [1, 2, 3].map(|j| Hint { t_ns: t_ns[j], log_photocurrent: 4.0, variance: 1.0, for_sigma: 1.0 });
    for (prior, cost) in [(FAMILIES[1], &walk as Cost<'_>), (FAMILIES[2], &integrated_walk)] {
        let (sensor, noise): (MapSensor, Noise) = (sensor(Reset::Resample), Noise::default());
        let (stamp_sigma_s, no_event_sigma) = (0.0, 0.0);
        let (events, frames, lost_before, beyond) = (&[], &[], &[], &[]);
        let problem = MapProblem {
            hints: &hints,
            noise,
            stamp_sigma_s,
            no_event_sigma,
            lost_before,
            beyond,
            ..MapProblem::new(sensor, events, frames, (0, t_ns[4]))
        };
        let mut pixel =
            Alone::new(problem, MapOptions { prior, spacing_ns: 10_000_000, ..MapOptions::default() }, 0.0);
        pixel.place(&at, Offsets::default());
        pixel.adapt();
        for j in 0..5 {
            let slope = |of: &mut dyn FnMut(&[f64]) -> f64| {
                let (mut above, mut below) = (at, at);
                above[j] += 1e-6;
                below[j] -= 1e-6;
                (of(&above) - of(&below)) / 2e-6
            };
            let (expected, found) =
                (slope(&mut |u| cost(u)), slope(&mut |u| pixel.place(u, Offsets::default())));
            // Rounding of second-order terms over differences of a millionth.
            assert!(
                (found - expected).abs() < 1e-4 * (1.0 + expected.abs()),
                "{prior:?} at {j}: {found} against {expected}"
            );
        }
    }
}
