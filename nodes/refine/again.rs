//! Solving a recording again: the inputs that the nodes of this folder share, and passing pseudo-measurements
//! to the solver.

use super::pseudo_measurement::{MeasuredPixel, PseudoMeasurementParams, SolverSensor};
use super::variance_factor::{FactorLosses, VARIANCE_FACTORS, VarianceFactors, scale_variances};
use crate::solve::map::check_length;
use crate::spans::{check_covered, check_one_clock, check_steps};
use photocurrent_core::{
    Between, Context, EventStream, EventsMeta, Extent, FrameSequence, FramesMeta, NodeError, PortMetas,
    Sensor, TrackBand, TrackSet, TracksMeta, handle::Band,
};
use photocurrent_scene::activity::Activity;
use photocurrent_scene::film::EventTimes;
use photocurrent_scene::film::STEP_NS;
use photocurrent_sensor::map::estimate::{self, HoldOut};
use photocurrent_sensor::map::{Hint, MapFrame, PixelEvent};
use photocurrent_solve::co_located::CoLocated;
use photocurrent_solve::row::{Recorded, RowSetting};
use photocurrent_solve::row_solver::{RowSolver, Taken};
use photocurrent_solve::settings::Settings;
use photocurrent_solve::shares::Colours;
use photocurrent_solve::{EVENT_RESIDUAL, Model, SolveOptions, neighbours};
use rayon::prelude::*;
use std::sync::Arc;

photocurrent_core::ports! {
    /// Inputs of a node that solves again.
    pub struct In {
        /// The first solution: log-linear tracks of `solve/map` or of a node with the same output.
        tracks: TrackSet,
        /// The events that it was solved from.
        events: EventStream,
        /// The frames that it was solved from.
        frames: FrameSequence,
        /// The sensor, as for `solve/map`.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// Its outputs.
    pub struct Out {
        /// Photocurrent of every pixel over time.
        tracks: TrackSet,
    }
}

/// The solver and its settings.
pub(super) struct RefineSolver {
    options: SolveOptions,
}

impl RefineSolver {
    pub(crate) fn build(options: SolveOptions) -> Result<RefineSolver, NodeError> {
        options.check()?;
        Ok(RefineSolver { options })
    }

    /// Metadata of the node's output.
    pub(crate) fn plan(&self, kind: &str, inputs: &PortMetas) -> Result<TracksMeta, NodeError> {
        let (events, frames) = (inputs.events("events")?, inputs.frames("frames")?);
        check_one_clock(events, frames, Some(inputs.sensor("sensor")?))?;
        check_covered(Some(events), frames, Some(inputs.sensor("sensor")?))?;
        Model::of_map(&self.options, inputs.sensor("sensor")?, events)?;
        let meta = self.meta(kind, inputs.tracks("tracks")?, events, frames)?;
        check_length(&self.options, meta.span)?;
        check_steps(meta.span, STEP_NS, "pictures", kind)?;
        Ok(meta)
    }

    /// The tracks to come; refuses tracks that are not those of these events and frames.
    pub(crate) fn meta(
        &self,
        kind: &str,
        tracks: &TracksMeta,
        events: &EventsMeta,
        frames: &FramesMeta,
    ) -> Result<TracksMeta, NodeError> {
        if tracks.between != Between::LogLinear {
            return Err(NodeError::usage(format!(
                "the tracks hold their values between knots; {kind} needs log-linear ones"
            ))
            .hint("connect tracks of solve/map"));
        }
        CoLocated::new(events, frames)?.need_plain(kind)?;
        let meta = self.options.tracks_meta(events, frames)?;
        if tracks.extent != meta.extent {
            return Err(NodeError::usage(format!(
                "tracks are {}, events are {}",
                tracks.extent, meta.extent
            ))
            .hint("connect the events and frames that the tracks were solved from"));
        }
        Ok(meta)
    }

    /// Loads all rows of a recording.
    pub(crate) fn load_recording(
        &self,
        meta: TracksMeta,
        events: &EventStream,
        frames: &FrameSequence,
        sensor: &Sensor,
        cx: &Context,
    ) -> Result<LoadedRecording, NodeError> {
        let mut model = Model::of_map(&self.options, sensor, &events.meta)?;
        model.inform(events)?;
        let (rows, times) = (cx.rows(), &frames.meta.times);
        let colours = Colours::new(CoLocated::new(&events.meta, &frames.meta)?, sensor)?;
        let events = colours.lie.read(events, rows)?;
        let values = frames.read_rows(rows)?;
        let recorded =
            Recorded { meta: &meta, times, colours: &colours, rows, events: &events, frames: &values };
        let known = neighbours::known(&self.options, &model, &recorded, rows, cx)?;
        let settings = Settings::choose(&self.options, &model, &recorded, rows, known.as_ref())?;
        let prepare = |solver: &mut RowSolver, row: u32| -> Result<LoadedRow, NodeError> {
            let setting = *settings.of(row);
            solver.take(&model, &setting, &recorded, row)?;
            if let Some(known) = &known {
                solver.give(known.of(row).to_vec());
            }
            cx.advance(1)?;
            Ok(LoadedRow { row, taken: solver.hand_over(), setting })
        };
        let rows: Result<Vec<LoadedRow>, NodeError> =
            rows.iter().into_par_iter().map_init(RowSolver::default, prepare).collect();
        Ok(LoadedRecording { model, meta, rows: rows? })
    }
}

/// The measurements of a row.
pub(super) struct LoadedRow {
    pub row: u32,
    taken: Taken,
    setting: RowSetting,
}

impl LoadedRow {
    /// First and last instant, ns.
    pub(crate) fn span(&self) -> (i64, i64) {
        self.setting.span
    }

    /// The events of pixel x, in order of in-pixel time.
    pub(crate) fn events_of(&self, x: usize) -> &[PixelEvent] {
        self.taken.data().events_of(x)
    }

    /// Pixel x and what it measured, with some of its frame values.
    pub(crate) fn measured<'a>(
        &'a self,
        x: usize,
        sensor: &'a SolverSensor,
        extent: Extent,
        frames: &'a [MapFrame],
        threshold: f64,
    ) -> MeasuredPixel<'a> {
        MeasuredPixel {
            sensor,
            extent,
            place: (x, self.row as usize),
            events: self.events_of(x),
            frames,
            threshold,
        }
    }

    /// The frame values of pixel x.
    pub(crate) fn frames_of(&self, x: usize) -> &[MapFrame] {
        self.taken.data().frames_of(x)
    }
}

/// Number of rows that are evaluated to select one.
const SAMPLED_ROWS: usize = 18;
/// The measurements of a recording.
pub(super) struct LoadedRecording {
    model: Model,
    pub meta: TracksMeta,
    pub rows: Vec<LoadedRow>,
}

impl LoadedRecording {
    /// When every pixel had events.
    pub(crate) fn fired(&self) -> Arc<EventTimes> {
        let width = self.meta.extent.width as usize;
        let times = |row: &LoadedRow, x: usize| row.events_of(x).iter().map(|event| event.t_in_ns).collect();
        Arc::new(EventTimes::new(self.rows.iter().flat_map(|row| (0..width).map(move |x| times(row, x)))))
    }

    /// Where and when pixels fired with events of their neighbours.
    pub(crate) fn activity(&self) -> Activity {
        let width = self.meta.extent.width as usize;
        let events = self.rows.iter().flat_map(|row| {
            let of_pixel = move |x: usize| {
                row.taken.data().in_company(x).map(move |event| (x, row.row as usize, event.t_in_ns))
            };
            (0..width).flat_map(of_pixel)
        });
        Activity::new(self.meta.extent, (self.meta.span.start.0, self.meta.span.end.0), events)
    }

    /// The sensor as the solver sees it.
    pub(crate) fn sensor(&self) -> SolverSensor {
        SolverSensor { model: self.model.sensor(), added: self.model.added() }
    }

    /// Selects variance factors of pseudo-measurements: those with which sampled pixels predict held-out
    /// frames best. `of_row` and `hints_of` as for [`LoadedRecording::solve`], but pseudo-measurements must
    /// not depend on the held-out frames.
    pub(crate) fn variance_factors<L>(
        &mut self,
        params: &PseudoMeasurementParams,
        of_row: impl Fn(&LoadedRow) -> L + Sync,
        hints_of: impl Fn(&L, &LoadedRow, usize, f64, &mut Vec<Hint>) + Sync,
    ) -> VarianceFactors {
        let of_pixel = |solver: &mut RowSolver,
                        (row, setting): (usize, &RowSetting),
                        model: &Model,
                        x: usize,
                        hints: &[Hint]| {
            let scaled = VARIANCE_FACTORS.map(|factor| {
                let mut hints = hints.to_vec();
                scale_variances(&mut hints, factor);
                hints
            });
            let lost = solver.prediction_errors(model, setting, x, &scaled);
            vec![FactorLosses { x, y: row, errors: std::array::from_fn(|n| lost[n]) }]
        };
        let lost = self.map_sampled_pixels(of_row, hints_of, of_pixel);
        VarianceFactors::choose(self.meta.extent, &lost, params)
    }

    /// Widens standard deviations as far as held-out frames require with the same pseudo-measurements, which
    /// must not depend on those frames.
    pub(crate) fn widen<L>(
        &mut self,
        of_row: impl Fn(&LoadedRow) -> L + Sync,
        hints_of: impl Fn(&L, &LoadedRow, usize, f64, &mut Vec<Hint>) + Sync,
    ) {
        let of_pixel = |solver: &mut RowSolver,
                        (_, setting): (usize, &RowSetting),
                        model: &Model,
                        x: usize,
                        hints: &[Hint]| solver.misses(model, setting, x, hints);
        let factor = estimate::too_narrow_by(&mut self.map_sampled_pixels(of_row, hints_of, of_pixel));
        self.rows.iter_mut().for_each(|row| row.setting.sigma_factor = factor);
    }

    /// Predictions of held-out frames for every `pitch`-th pixel of every `pitch`-th row by some rules, their
    /// indices and DN, mapped with `of_pixel`. `hints_of` gives pseudo-measurements that depend only on the
    /// frames that it receives.
    pub(crate) fn predictions<T: Send>(
        &mut self,
        pitch: usize,
        holds: &[HoldOut],
        hints_of: impl Fn(&LoadedRow, usize, &[MapFrame], f64, &mut Vec<Hint>) + Sync,
        of_pixel: impl Fn(&LoadedRow, usize, Vec<(usize, f64)>) -> T + Sync,
    ) -> Vec<Vec<T>> {
        let LoadedRecording { model, rows, meta } = self;
        let ask_pixel = |solver: &mut RowSolver, row: &mut LoadedRow, x: usize| {
            let hinted = |hold: &HoldOut| {
                let mut hints = Vec::new();
                hints_of(row, x, &hold.kept(row.frames_of(x)), model.threshold(), &mut hints);
                (*hold, hints)
            };
            let held: Vec<(HoldOut, Vec<Hint>)> = holds.iter().map(hinted).collect();
            let LoadedRow { taken, setting, .. } = row;
            let predicted = solver.with(taken, |solver| solver.predictions(model, setting, x, &held));
            of_pixel(row, x, predicted)
        };
        let columns = 0..meta.extent.width as usize;
        let ask_row = |solver: &mut RowSolver, row: &mut LoadedRow| -> Vec<T> {
            columns.clone().step_by(pitch).map(|x| ask_pixel(solver, row, x)).collect()
        };
        rows.par_iter_mut().step_by(pitch).map_init(RowSolver::default, ask_row).collect()
    }

    /// Maps sampled pixels, each with its pseudo-measurements, with `answer`.
    fn map_sampled_pixels<L, T: Send>(
        &mut self,
        of_row: impl Fn(&LoadedRow) -> L + Sync,
        hints_of: impl Fn(&L, &LoadedRow, usize, f64, &mut Vec<Hint>) + Sync,
        answer: impl Fn(&mut RowSolver, (usize, &RowSetting), &Model, usize, &[Hint]) -> Vec<T> + Sync,
    ) -> Vec<T> {
        let LoadedRecording { model, rows, .. } = self;
        let stride = usize::max(rows.len() / SAMPLED_ROWS, 1);
        let ask_row = |solver: &mut RowSolver, row: &mut LoadedRow| -> Vec<T> {
            let pixels = solver.with(&mut row.taken, |solver| solver.sample());
            let (known, mut hints) = (of_row(row), Vec::new());
            let of_pixel = |x: usize| {
                hints_of(&known, row, x, model.threshold(), &mut hints);
                let LoadedRow { row, taken, setting } = row;
                solver.with(taken, |solver| answer(solver, (*row as usize, &*setting), model, x, &hints))
            };
            pixels.into_iter().flat_map(of_pixel).collect()
        };
        let sampled: Vec<Vec<T>> = rows
            .par_iter_mut()
            .skip(stride / 2)
            .step_by(stride)
            .map_init(RowSolver::default, ask_row)
            .collect();
        sampled.into_iter().flatten().collect()
    }

    /// Solves every pixel with the pseudo-measurements that `hints_of` gives for a row and column, from the
    /// data that `of_row` returns for the row. Its last argument but one is the accuracy of a pixel's own
    /// estimate, natural-log units. Standard deviations are computed in the last round only. Returns the
    /// tracks, and each pixel's residual of its events, root mean square, thresholds; 0 without events.
    pub(crate) fn solve<L>(
        &mut self,
        cx: &Context,
        is_last: bool,
        of_row: impl Fn(&LoadedRow) -> L + Sync,
        hints_of: impl Fn(&L, &LoadedRow, usize, f64, &mut Vec<Hint>) + Sync,
    ) -> Result<(TrackBand, Vec<f32>), NodeError> {
        let LoadedRecording { model, meta, rows } = self;
        let solve_row =
            |solver: &mut RowSolver, row: &mut LoadedRow| -> Result<(TrackBand, Vec<f32>), NodeError> {
                let mut hints = vec![Vec::new(); meta.extent.width as usize];
                let known = of_row(row);
                for (x, hints) in hints.iter_mut().enumerate() {
                    hints_of(&known, row, x, model.threshold(), hints);
                }
                row.setting.options.with_sigma = is_last && meta.has_sigma;
                let LoadedRow { row, taken, setting } = row;
                let (band, map) =
                    solver.with(taken, |solver| solver.solve(model, setting, meta, *row, Some(&hints)));
                cx.advance(1)?;
                let left = |rms: &f32| if rms.is_finite() { rms * setting.noise.event as f32 } else { 0.0 };
                Ok((band.shrunk(), map.row(EVENT_RESIDUAL, *row).iter().map(left).collect()))
            };
        let solved: Result<Vec<(TrackBand, Vec<f32>)>, NodeError> =
            rows.par_iter_mut().map_init(RowSolver::default, solve_row).collect();
        let (bands, left): (Vec<TrackBand>, Vec<Vec<f32>>) = solved?.into_iter().unzip();
        Ok((TrackBand::concat(bands), left.concat()))
    }
}
