//! Eq. (13): a row of pixels cut into windows of frames, each a problem of Eq. (13), and their solutions put
//! together.
//!
//! All problems of a row are gathered first. In single precision those with equally many frames are then
//! solved sixteen at a time, shortest first, so that the pixels of a group need about the same time; what the
//! group hands back, and what has no steps at all, is solved one by one in double precision.

use crate::model::Model;
use crate::options::{FirstKnot, Joint, PaperOptions, Precision, ReadoutModel, TauChoice};
use crate::plausible::Plausible;
use crate::shares::{RowShares, Share};
use crate::status::{Status, map_meta, planes};
use photocurrent_core::events::{EventRow, PixelIndex};
use photocurrent_core::{Exposure, FrameBlock, MapBand, NodeError, Rows, TrackBand, TracksMeta};
use photocurrent_sensor::front_end::TauRule;
use photocurrent_sensor::inverse::{FrameSample, LaneGroup, PixelProblem, SolveOptions, Workspace, solve};
use photocurrent_sensor::lanes::LANES;
use photocurrent_sensor::readout::compensated_step;
use photocurrent_sensor::residuals::Misfit;
use std::ops::Range;

/// Solves the pixels of a row; keeps its memory from row to row.
#[derive(Default)]
pub(crate) struct RowSolver {
    workspace: Workspace,
    group: LaneGroup,
    event_t: Vec<i64>,
    event_step: Vec<f64>,
    /// The columns of all problems of the row, one after the other.
    t_s: Vec<f64>,
    steps: Vec<f64>,
    samples: Vec<FrameSample>,
    problems: Vec<Problem>,
    /// ln i of every knot, as `t_s`.
    log_photocurrent: Vec<f64>,
    order: Vec<usize>,
    knots: Vec<(i64, f32)>,
}

/// One window of one pixel: where its columns stand, and what became of it.
struct Problem {
    knots: Range<usize>,
    samples: Range<usize>,
    /// Light of the frame's value over that of its event pixel, in which the problem is posed.
    light_ratio: f64,
    status: Status,
    iterations: usize,
    cost: f64,
    misfit: Misfit,
}

impl RowSolver {
    pub(crate) fn row(
        &mut self,
        params: &PaperOptions,
        model: &Model,
        meta: &TracksMeta,
        row: u32,
        events: EventRow,
        frames: &FrameBlock,
        exposures: &[Exposure],
        shares: &RowShares,
    ) -> Result<(TrackBand, MapBand), NodeError> {
        let index = events.by_pixel(meta.extent.width);
        let windows = windows(params.frames, exposures, meta);
        self.t_s.clear();
        self.steps.clear();
        self.samples.clear();
        self.problems.clear();
        for x in 0..meta.extent.width as usize {
            self.take_events(params, model, &events, &index, x);
            for window in &windows {
                let share = shares.of(x, window.frames.clone());
                self.take_window(params, model, window, exposures, share, |l| frames.row(l, row)[x]);
            }
        }
        self.solve(params, model)?;
        let mut tracks = TrackBand::begin(row, meta.extent.width);
        let mut map = MapBand::zeros(Rows { start: row, end: row + 1 }, &map_meta(meta.extent));
        for (x, problems) in self.problems.chunks_exact(windows.len()).enumerate() {
            let (mut worst, mut iterations, mut cost, mut misfit) =
                (Status::Converged, 0, 0.0, Misfit::default());
            self.knots.clear();
            let of_frames = exposures
                .iter()
                .enumerate()
                .map(|(l, exposure)| (f64::from(frames.row(l, row)[x]), exposure.length_ns() as f64 * 1e-9));
            let plausible = Plausible::new(model, shares.of(x, 0..exposures.len()), of_frames);
            let mut most = 0.0;
            for (window, problem) in windows.iter().zip(problems) {
                worst = worst.max(problem.status);
                iterations = iterations.max(problem.iterations);
                cost += problem.cost;
                misfit.add(&problem.misfit);
                for (k, at) in problem.knots.clone().enumerate() {
                    let t = window.start + (self.t_s[at] * 1e9).round() as i64;
                    if problem.status != Status::NoFrame && (k == 0 || t < window.counts_until) {
                        let photocurrent = libm::exp(self.log_photocurrent[at]) * problem.light_ratio;
                        most = f64::max(most, photocurrent);
                        self.knots.push((t, plausible.held(photocurrent) as f32));
                    }
                }
            }
            tracks.push(self.knots.iter().copied());
            for (plane, value) in
                planes(worst, iterations, cost, &misfit, plausible.excess(most)).into_iter().enumerate()
            {
                map.row_mut(plane, row)[x] = value;
            }
        }
        Ok((tracks, map))
    }

    /// The pixel's events as times and steps; compensated ones when asked.
    fn take_events(
        &mut self,
        params: &PaperOptions,
        model: &Model,
        events: &EventRow,
        index: &PixelIndex,
        x: usize,
    ) {
        self.event_t.clear();
        self.event_step.clear();
        let mut before: Option<usize> = None;
        for &k in index.pixel(x) {
            let (t, plain) = (model.rule.time(events, k), model.rule.step(events, k));
            let step = match (params.readout, before) {
                (ReadoutModel::Slope, Some(before)) => {
                    let since = |t: i64| (t - model.rule.time(events, before)) as f64 * 1e-9;
                    compensated_step(
                        plain,
                        0.0,
                        since(events.t[before] - model.rule.shift_ns),
                        since(t),
                        model.refractory_s,
                    )
                }
                _ => plain,
            };
            // Two events at one instant are one step of their sum: stamps are quantised, and knots must
            // differ.
            match self.event_t.last() {
                Some(&last) if t <= last => {
                    *self.event_step.last_mut().expect("as long as the times") += step
                }
                _ => {
                    self.event_t.push(t);
                    self.event_step.push(step);
                }
            }
            before = Some(k);
        }
    }

    /// Appends the problem of one window of the pixel whose events were taken.
    fn take_window(
        &mut self,
        params: &PaperOptions,
        model: &Model,
        window: &Window,
        exposures: &[Exposure],
        share: Share,
        dn: impl Fn(usize) -> f32,
    ) {
        let seconds = |t: i64| (t - window.start) as f64 * 1e-9;
        let (first_sample, first_at) = (self.samples.len(), self.t_s.len());
        let mut status = Status::Converged;
        let sample = |l: usize, dn: f64| FrameSample {
            start_s: seconds(exposures[l].start.0),
            end_s: seconds(exposures[l].end.0),
            dn: share.dn(dn, model.sensor.number.black_level),
            weight: share.weight(params.cis_weight),
        };
        let known = || window.frames.clone().map(|l| (l, f64::from(dn(l)))).filter(|(_, dn)| dn.is_finite());
        self.samples
            .extend(known().filter(|(_, dn)| *dn < model.sensor.saturation_dn).map(|(l, dn)| sample(l, dn)));
        if self.samples.len() == first_sample {
            status = Status::Saturated;
            self.samples.extend(known().map(|(l, _)| sample(l, model.sensor.saturation_dn)));
        }
        if self.samples.len() == first_sample {
            status = Status::NoFrame;
        }
        let inside = self.event_t.partition_point(|&t| t < window.start)
            ..self.event_t.partition_point(|&t| t < window.end);
        let first_knot = params.first_knot == FirstKnot::Window || inside.is_empty();
        if first_knot {
            self.t_s.push(0.0);
            self.steps.push(0.0);
        }
        for k in inside {
            // An event on the window's first instant is its first knot: there is no interval before it to
            // step over.
            if !first_knot || self.event_t[k] > window.start {
                self.t_s.push(seconds(self.event_t[k]));
                self.steps.push(self.event_step[k]);
            }
        }
        let (knots, samples) = (first_at..self.t_s.len(), first_sample..self.samples.len());
        self.problems.push(Problem {
            knots,
            samples,
            light_ratio: share.ratio,
            status,
            iterations: 0,
            cost: 0.0,
            misfit: Misfit::default(),
        });
    }

    /// Solves all problems of the row.
    fn solve(&mut self, params: &PaperOptions, model: &Model) -> Result<(), NodeError> {
        let tau_rule = match params.tau_rule {
            TauChoice::Start => TauRule::Start,
            TauChoice::End => TauRule::End,
        };
        let options =
            SolveOptions { max_iterations: params.max_iterations as usize, ..SolveOptions::default() };
        let posed = |problem: &Problem| PixelProblem {
            t_s: &self.t_s[problem.knots.clone()],
            steps: &self.steps[problem.knots.clone()],
            frames: &self.samples[problem.samples.clone()],
            evs_weight: params.evs_weight,
            front_end: model.sensor.pixel.front_end,
            tau_rule,
            black_level: model.sensor.number.black_level,
            gain: model.sensor.number.gain,
        };
        self.log_photocurrent.clear();
        self.log_photocurrent.resize(self.t_s.len(), 0.0);
        self.order.clear();
        self.order.extend((0..self.problems.len()).filter(|n| self.problems[*n].status != Status::NoFrame));
        // By frames, then by knots; what the lanes do not take comes last.
        let takes = |problem: &Problem| params.precision == Precision::Single && problem.knots.len() > 1;
        self.order.sort_by_key(|n| {
            let problem = &self.problems[*n];
            (!takes(problem), problem.samples.len(), problem.knots.len())
        });
        let alone = self.order.partition_point(|n| takes(&self.problems[*n]));
        let unposable = |error| NodeError::failed(format!("a pixel's problem cannot be posed: {error}"));
        let mut left: Vec<usize> = self.order[alone..].to_vec();
        let mut from = 0;
        while from < alone {
            // As many as have lanes, and equally many frames.
            let frames = |at: usize| self.problems[self.order[at]].samples.len();
            let to = (from + 1..alone.min(from + LANES))
                .find(|at| frames(*at) != frames(from))
                .unwrap_or(alone.min(from + LANES));
            let numbers = &self.order[from..to];
            from = to;
            let problems: Vec<PixelProblem<'_>> = numbers.iter().map(|n| posed(&self.problems[*n])).collect();
            problems.iter().try_for_each(PixelProblem::check).map_err(unposable)?;
            self.group.solve(&problems);
            for (lane, n) in numbers.iter().enumerate() {
                let Some(solution) = self.group.solution(lane) else {
                    left.push(*n);
                    continue;
                };
                let problem = &mut self.problems[*n];
                (problem.iterations, problem.cost, problem.misfit) =
                    (solution.iterations, solution.cost.into(), solution.misfit);
                for (out, u) in
                    self.log_photocurrent[problem.knots.clone()].iter_mut().zip(solution.log_photocurrent())
                {
                    *out = u.into();
                }
            }
        }
        for n in left {
            let solution =
                solve(&posed(&self.problems[n]), &options, &mut self.workspace).map_err(unposable)?;
            let problem = &mut self.problems[n];
            if !solution.has_converged() {
                problem.status = problem.status.max(Status::FellBack);
            }
            (problem.iterations, problem.cost, problem.misfit) =
                (solution.iterations, solution.cost, solution.misfit);
            self.log_photocurrent[problem.knots.clone()].copy_from_slice(solution.log_photocurrent);
        }
        Ok(())
    }
}

/// One problem's share of the recording, for one row.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Window {
    pub frames: Range<usize>,
    /// First instant whose events count, ns; the first knot.
    pub start: i64,
    /// First instant whose events no longer count, ns.
    pub end: i64,
    /// First instant that the next window answers for, ns.
    pub counts_until: i64,
}

pub(crate) fn windows(joint: Joint, exposures: &[Exposure], meta: &TracksMeta) -> Vec<Window> {
    let frames = exposures.len();
    let span =
        (meta.span.start.0.min(exposures[0].start.0), meta.span.end.0.max(exposures[frames - 1].end.0));
    if joint == Joint::All || frames <= 2 {
        return vec![Window { frames: 0..frames, start: span.0, end: span.1, counts_until: span.1 }];
    }
    let last = frames - 2;
    (0..=last)
        .map(|l| Window {
            frames: l..l + 2,
            start: if l == 0 { span.0 } else { exposures[l].start.0 },
            end: if l == last { span.1 } else { exposures[l + 1].end.0 },
            counts_until: if l == last { span.1 } else { exposures[l + 1].start.0 },
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Between, Colour, Extent, TimeSpan};

    #[test]
    fn windows_answer_for_every_instant_once() {
        let exposures: Vec<Exposure> =
            (0..4).map(|l| Exposure::new(l * 8_000_000, l * 8_000_000 + 6_000_000)).collect();
        let meta = TracksMeta {
            extent: Extent { width: 5, height: 4 },
            colour: Colour::Mono,
            has_sigma: false,
            span: TimeSpan::new(0, 30_000_000),
            nominal_exposure_ns: 6_000_000,
            between: Between::Hold,
            count_hint: None,
        };
        let windows = windows(Joint::Pairs, &exposures, &meta);
        assert_eq!(windows.len(), 3);
        assert!(windows.windows(2).all(|w| w[0].counts_until == w[1].start && w[0].end > w[1].start));
        assert_eq!(windows[2].end, windows[2].counts_until);
    }
}
