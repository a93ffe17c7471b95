//! First-order fits of every effect on a scene, and exact ones of a few together.

use super::components::{SPREADS, white_share};
use super::evidence::RankedEffect;
use super::fit::{
    EffectColumn, EventNoise, FittedColumns, NullFit, ResidualRows, ResidualsAndSlopes, SoftnessColumn,
    gain_of, heldout, row_gains, without_softness,
};
use super::formulas::formulas;
use super::laid::{CovariateColumns, covariate_columns};
use super::open::{self, CovariateCurve};
use super::places::GainLocator;
use super::prepared::PreparedTrial;
use super::setting::{CELL, EvidenceSetting, LARGEST_EFFECT_SIZE, LEAST_SLOPE, PROBE, STILL, WORTH_REFINING};
use super::trials::EvaluatedTrials;
use super::{EventResiduals, FrameValues, SampleView};
use crate::candidates::{CANDIDATES, EffectScales, Signs, Trial};
use crate::covariates::{Covariate, CovariateSource};
use crate::rhythm::ResidualRhythm;
use photocurrent_scene::case::Case;
use photocurrent_scene::gate::PredictionGate;
use photocurrent_scene::light::LogLight;
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::statistics::median;
use photocurrent_scene::{Scene, SceneCell};
use photocurrent_sensor::effects::sought::Grows;
use photocurrent_sensor::elementary::ln;
use std::borrow::Cow;
use std::sync::LazyLock;

/// A recording with its scene, for evaluating trials.
pub(super) struct SceneRecording<'a> {
    pub case: &'a Case,
    pub light: LogLight,
    pub gate: PredictionGate,
    pub pixels: Vec<u32>,
    /// Further pixels, for pairs.
    pub more: Vec<u32>,
    pub setting: &'a EvidenceSetting,
    pub scales: &'a EffectScales,
    /// Least noise, natural-log units.
    pub least: f64,
    /// Is the scene known independently of the frames? Then their values are evaluated as well.
    pub is_known: bool,
    /// The scene, with its free parameters.
    pub source: &'a dyn Scene,
    /// Shift of the free parameters from the scene's, shares of their ranges; `light` is that of the shifted
    /// scene.
    pub by: Vec<f64>,
    /// And the light with each of them moved from there by a step ([`SceneRecording::steps`]).
    pub near: Vec<(f64, LogLight)>,
    /// Correction of each residual by its pixel's own size of a random effect; empty, or for the stated
    /// sensor's events.
    pub own: Vec<f32>,
}

/// One sensor and everything on top of it.
pub(super) struct ResidualTable {
    /// The sensor.
    pub trial: Trial,
    pub events: EventResiduals,
    /// Frame values, of a known scene.
    frames: FrameValues,
    /// Slopes of events; behind them, of a known scene, brightness of frame values.
    slope: Vec<f64>,
    /// Blocks, likewise.
    block: Vec<u32>,
    /// Residuals, likewise.
    base: Vec<f64>,
    /// Residuals of the events, corrected for softness of the picture.
    sharp: Vec<f64>,
    /// Logarithms of the events' slopes.
    log_slope: Vec<f32>,
    least: f64,
    /// At most so much of the blur's column is subtracted in addition to everything, below 0.
    softest: f64,
    /// Columns of the candidates.
    columns: Vec<(usize, EffectColumn)>,
    /// And of the free parameters of the scene.
    free: Vec<EffectColumn>,
    /// Held-out log-likelihood of an event's time, nats.
    pub nats_per_event: f64,
    /// Noise of the events, corrected for softness of the picture.
    pub noise: EventNoise,
    pub fitted: Vec<(usize, FittedColumns)>,
}

/// Effect with the residual pattern of a picture that is too soft, with the other sign.
const SOFTNESS: &str = "blur";

/// Largest change of a size, as a share, for which its column is kept.
const SAME_COLUMN: f64 = 0.05;

impl ResidualTable {
    fn rows(&self, is_sharp: bool) -> ResidualRows<'_> {
        let soft = self.effect_column(SOFTNESS, "").filter(|_| !is_sharp).map(|column| SoftnessColumn {
            column: &column.of,
            log_slope: &column.log_slope,
            most: self.softest,
        });
        ResidualRows {
            slope: &self.slope,
            block: &self.block,
            events: self.events.pixel.len(),
            least: self.least,
            soft,
            free: &self.free,
        }
    }

    /// The column of an effect's parameter, or of its first one.
    fn effect_column(&self, id: &str, parameter: &str) -> Option<&EffectColumn> {
        let is_it = |n: usize| {
            CANDIDATES[n].id == id && (parameter.is_empty() || CANDIDATES[n].parameter == parameter)
        };
        self.columns.iter().find(|(n, _)| is_it(*n)).map(|(_, column)| column)
    }

    /// Fits every column together with softness of the picture, at most `softest`.
    pub(super) fn fit(&mut self, softest: f64) {
        self.softest = softest;
        let plain = |is_sharp: bool| NullFit::new(&self.base, self.rows(is_sharp));
        let (soft, sharp) = (plain(false), plain(true));
        let base = |n: usize| if CANDIDATES[n].id == SOFTNESS { &sharp } else { &soft };
        let nats_per_event = soft.nats_per_event(&self.log_slope);
        self.fitted = self.columns.iter().map(|(n, column)| (*n, heldout(base(*n), &[column]))).collect();
        let mut left = without_softness(&self.base, &self.rows(false));
        left.truncate(self.events.pixel.len());
        self.nats_per_event = nats_per_event;
        self.noise = EventNoise::estimate(&left, &self.events.slope_per_s, self.least);
        self.sharp = left;
    }

    /// How much too soft the picture is: the size of the blur's column that events have too little of, 0 or
    /// below.
    pub(super) fn softness(&self) -> f64 {
        let size = |(_, fitted): &(usize, FittedColumns)| fitted.size[0];
        self.fitted.iter().find(|(n, _)| CANDIDATES[*n].id == SOFTNESS).map_or(0.0, size).min(0.0)
    }

    /// Residuals of the events.
    pub(super) fn residual(&self) -> &[f64] {
        &self.base[..self.events.pixel.len()]
    }

    /// The same, corrected for softness of the picture and for the free parameters of the scene.
    pub(super) fn sharp(&self) -> &[f64] {
        &self.sharp
    }

    /// Columns of the events that each pixel may have a size of its own of.
    pub(super) fn pixel_columns(&self) -> [Cow<'_, [f32]>; 2] {
        let events = self.events.pixel.len();
        OF_PIXELS.map(|(id, parameter)| {
            self.effect_column(id, parameter)
                .map_or_else(|| Cow::Owned(vec![0.0; events]), |column| Cow::Borrowed(&column.of[..events]))
        })
    }
}

/// Sizes of some effects together, and their gain over a table's residuals.
pub(super) struct RefinedSizes {
    pub effect_size: Vec<f64>,
    pub error: Vec<f64>,
    pub gain: f64,
    pub gain_error: f64,
    /// Residuals of events that they leave.
    pub left: Vec<f64>,
    /// Gain of each row by them.
    pub gains: Vec<f64>,
    /// Where they leave the free parameters of the scene ([`SceneRecording::by`]).
    pub by: Vec<f64>,
}

/// Candidates whose size may differ per pixel: those that [`SPREADS`] spread.
pub(super) static OF_PIXELS: LazyLock<[(&str, &str); 2]> = LazyLock::new(|| {
    let spread_of =
        |id: &str| CANDIDATES.iter().filter(|one| one.id == id).find_map(|one| one.sought.spread_of);
    SPREADS.map(|id| spread_of(id).unwrap_or_else(|| unreachable!("{id} spreads sizes")))
});

/// Standard deviation of a free parameter of the scene within its range, as a share of it, before the
/// recording.
const OPEN: f64 = 0.3;
/// Largest shift of a free parameter, in its steps, that counts as none.
const NEAR: f64 = 2.0;
/// And none moves by more than this share of its range at a time.
const FARTHEST: f64 = 0.2;

impl SceneRecording<'_> {
    /// The light of the pixels with each free parameter of the scene moved by a step from shares `by`.
    pub(super) fn steps(&self, by: &[f64]) -> Vec<(f64, LogLight)> {
        let Some(target) = self.source.target() else { return Vec::new() };
        let one = |(k, (_, step)): (usize, (f64, f64))| {
            let mut moved = by.to_vec();
            moved[k] += step;
            Some((step, target.moved_light(self.case, self.light.step_ns, Some(&self.pixels), &moved)?))
        };
        target.free().into_iter().enumerate().filter_map(one).collect()
    }

    /// Change of each row of a trial by the free parameters of the scene, per prior standard deviation.
    /// `near`: [`SceneRecording::steps`].
    fn free(
        &self,
        trial: &Trial,
        near: &[(f64, LogLight)],
        table: Option<&ResidualTable>,
        base: &[f32],
        log_slope: &[f32],
    ) -> Result<Vec<EffectColumn>, String> {
        let one = |(step, light): &(f64, LogLight)| -> Result<EffectColumn, String> {
            let found = self.evaluate_on(light, std::slice::from_ref(trial), table)?;
            let scale = (OPEN / step) as f32;
            let change = |then: &[f32], now: &[f32]| -> Vec<f32> {
                then.iter().zip(now).map(|(then, now)| (then - now) * scale).collect()
            };
            Ok(EffectColumn {
                of: change(&found.left[0], base),
                log_slope: change(&found.log_slope[0], log_slope),
            })
        };
        near.iter().map(one).collect()
    }

    /// The free parameters, and their light, moved from shares `by` by sizes; `None` where that is nearly
    /// zero.
    fn move_free_parameters(&self, by: &[f64], sizes: &[f64], trial: &Trial) -> Option<(Vec<f64>, LogLight)> {
        let target = self.source.target()?;
        let free = target.free();
        let far = |(size, (_, step)): (&f64, &(f64, f64))| (OPEN * size).abs() > NEAR * step.abs();
        if sizes.len() != by.len() || !sizes.iter().zip(&free).any(far) {
            return None;
        }
        // Within its range.
        let next = |((by, size), (at, _)): ((&f64, &f64), &(f64, f64))| {
            (by + (OPEN * size).clamp(-FARTHEST, FARTHEST)).clamp(-at, 1.0 - at)
        };
        let moved: Vec<f64> = by.iter().zip(sizes).zip(&free).map(next).collect();
        if moved == by {
            return None;
        }
        // Neighbours are seen where the event path mixes them.
        let is_mixed =
            PreparedTrial::new(self.case, trial).map_or(true, |prepared| prepared.kernel().is_some());
        let light = target.moved_light(
            self.case,
            self.light.step_ns,
            (!is_mixed).then_some(&self.pixels[..]),
            &moved,
        )?;
        Some((moved, light))
    }

    /// Residuals of trials for events: those of a table, or those that are evaluable by the first trial.
    fn evaluate(&self, trials: &[Trial], table: Option<&ResidualTable>) -> Result<EvaluatedTrials, String> {
        self.evaluate_on(&self.light, trials, table)
    }

    fn evaluate_on(
        &self,
        light: &LogLight,
        trials: &[Trial],
        table: Option<&ResidualTable>,
    ) -> Result<EvaluatedTrials, String> {
        let view =
            SampleView { case: self.case, light, pixels: self.pixels.clone(), is_known: self.is_known };
        let (events, of_trials) = match table {
            Some(table) => (Cow::Borrowed(&table.events), view.evaluate_trials(trials, &table.events)?),
            None => {
                let (events, of_trials) =
                    view.residuals(trials, |pixel, t_ns| self.gate.accepts(pixel, t_ns))?;
                (Cow::Owned(events), of_trials)
            }
        };
        let mut slopes: Vec<f64> = events.slope_per_s.iter().map(|slope| slope.abs()).collect();
        // A voltage that hardly moves hardly determines when an event comes; on the way to one it takes a
        // threshold within the recording.
        let least =
            LEAST_SLOPE * f64::max(median(&mut slopes), self.scales.threshold / self.scales.duration_s);
        let log_slope = of_trials
            .iter()
            .map(|of| {
                of.slope_per_s
                    .iter()
                    .map(|slope| ln(f64::max(f64::from(slope.abs()), least)) as f32)
                    .collect()
            })
            .collect();
        let mut left: Vec<Vec<f32>> = of_trials.into_iter().map(|of| of.excess).collect();
        for of_trial in &mut left {
            of_trial.iter_mut().zip(&self.own).for_each(|(value, own)| *value -= own);
        }
        let mut frames = FrameValues::default();
        if self.is_known {
            // The first one selects the values that are evaluated.
            let first = table.map(|table| table.trial.clone());
            let all: Vec<Trial> = first.iter().chain(trials).cloned().collect();
            let mut of_frames;
            (frames, of_frames) = view.frames(&all)?;
            of_frames.drain(..all.len() - trials.len());
            left.iter_mut().zip(of_frames).for_each(|(left, of_frames)| left.extend(of_frames));
        }
        Ok(EvaluatedTrials {
            events: if table.is_none() { events.into_owned() } else { EventResiduals::default() },
            frames,
            left,
            log_slope,
        })
    }

    /// The share of the squares of residuals that is noise of pixels ([`white_share`]), on more events than
    /// are fitted.
    pub(super) fn noise_share(&self, trial: &Trial, source: &dyn Scene) -> Result<f64, String> {
        if self.is_known {
            return Ok(1.0);
        }
        let view =
            SampleView { case: self.case, light: &self.light, pixels: self.more.clone(), is_known: false };
        let (events, _) =
            view.residuals(std::slice::from_ref(trial), |pixel, t_ns| self.gate.accepts(pixel, t_ns))?;
        let cell = |(pixel, t_ns): (&u32, &i64)| source.cell(self.case, *pixel as usize, *t_ns, CELL);
        let cells: Vec<SceneCell> = events.pixel.iter().zip(&events.t_ns).map(cell).collect();
        Ok(white_share((&events.pixel, &events.polarity), &events.excess, &cells))
    }

    /// Covariates of the events of a table, and of its frame values.
    pub(super) fn covariates_of_rows(
        &self,
        table: &ResidualTable,
        nominal: &Nominal,
        rhythm: Option<ResidualRhythm>,
    ) -> [Vec<CovariateColumns>; 2] {
        let front_end = nominal.pixel.front_end;
        let light = Box::new(|pixel: usize, t_ns: i64| self.light.at(pixel, t_ns));
        let constants = (front_end.tau_0_s, front_end.alpha_s);
        let mut surroundings =
            CovariateSource::from_light(self.case, light, self.case.extent.pixels(), constants);
        let FrameValues { pixel, t_ns, .. } = table.frames.clone();
        let count = pixel.len();
        let values = EventResiduals {
            pixel,
            t_ns,
            polarity: vec![1; count],
            previous: vec![1; count],
            since_ns: vec![0; count],
            ..EventResiduals::default()
        };
        let mut of_frames =
            if count > 0 { covariate_columns(&values, &mut surroundings, None) } else { Vec::new() };
        of_frames.retain(|laid| Covariate::OF_FRAMES.contains(&laid.covariate));
        [covariate_columns(&table.events, &mut surroundings, rhythm), of_frames]
    }

    /// Data for locating gains over a table's residuals.
    pub(super) fn gain_locator<'t>(
        &'t self,
        table: &'t ResidualTable,
        laid: &[Vec<CovariateColumns>; 2],
    ) -> GainLocator<'t> {
        GainLocator::new(self.case, &table.events, &table.frames, &table.block, laid, &self.setting.located)
    }

    /// Uncatalogued curves on the residuals of a table.
    pub(super) fn dependences(
        &self,
        table: &ResidualTable,
        laid: &[CovariateColumns],
    ) -> Vec<CovariateCurve> {
        open::dependences(
            &table.events,
            table.sharp(),
            &table.block[..table.events.pixel.len()],
            laid,
            self.scales.threshold,
            self.least,
        )
    }

    /// Where the best of them is.
    pub(super) fn locate_dependence(
        &self,
        table: &ResidualTable,
        laid: &[CovariateColumns],
        places: &GainLocator<'_>,
        best: &mut CovariateCurve,
    ) {
        let (events, block) = (&table.events, &table.block[..table.events.pixel.len()]);
        let (threshold, sharp) = (self.scales.threshold, table.sharp());
        best.dependence.formulas =
            formulas(events, sharp, block, laid, &best.dependence, threshold, self.least);
        let after = open::apply_curve(
            events,
            table.sharp(),
            block,
            laid,
            &best.dependence,
            self.scales.threshold,
            self.least,
        );
        best.located = after.map(|after| {
            places
                .events
                .locate(&after.gains, best.dependence.covariate.name())
                .of_dependence(&best.dependence, &self.setting.located)
        });
    }

    fn block_of(&self, pixel: usize) -> u32 {
        block_of(self.case, self.setting.block, pixel)
    }

    /// First-order fits of every effect on top of a sensor, but for one candidate; with a picture that is too
    /// soft by `softest` at most.
    pub(super) fn table(
        &self,
        trial: &Trial,
        without: Option<usize>,
        softest: f64,
    ) -> Result<ResidualTable, String> {
        // One that cannot be combined with what is there is no candidate.
        let can_be = |n: &usize| {
            PreparedTrial::new(self.case, &trial.with_effect(&CANDIDATES[*n], probe(*n), self.scales)).is_ok()
        };
        let chosen: Vec<usize> = (0..CANDIDATES.len())
            .filter(|&n| !CANDIDATES[n].is_random && Some(n) != without)
            .filter(can_be)
            .collect();
        let mut trials = vec![trial.clone()];
        trials.extend(chosen.iter().map(|&n| trial.with_effect(&CANDIDATES[n], probe(n), self.scales)));
        let found = self.evaluate(&trials, None)?;
        let block: Vec<u32> = found
            .events
            .pixel
            .iter()
            .chain(&found.frames.pixel)
            .map(|pixel| self.block_of(*pixel as usize))
            .collect();
        let slope: Vec<f64> =
            found.events.slope_per_s.iter().chain(&found.frames.signal_dn).copied().collect();
        let columns =
            chosen.iter().enumerate().map(|(k, &n)| (n, found.column(1 + k, 0, probe(n)))).collect();
        let free = self.free(trial, &self.near, None, &found.left[0], &found.log_slope[0])?;
        let EvaluatedTrials { events, frames, left, mut log_slope } = found;
        let mut table = ResidualTable {
            trial: trial.clone(),
            events,
            frames,
            slope,
            block,
            base: wide(&left[0]),
            sharp: Vec::new(),
            log_slope: std::mem::take(&mut log_slope[0]),
            least: self.least,
            softest,
            columns,
            free,
            nats_per_event: 0.0,
            noise: EventNoise { a: self.least, b: 0.0 },
            fitted: Vec::new(),
        };
        table.fit(softest);
        Ok(table)
    }

    /// Sizes of effects on top of a sensor by Gauss-Newton on their exact models, from first ones; their gain
    /// is that over the residuals of `table`.
    pub(super) fn refine(
        &self,
        trial: &Trial,
        table: &ResidualTable,
        which: &[usize],
        begin: &[f64],
    ) -> Result<RefinedSizes, String> {
        let put = |effect_sizes: &[f64]| self.with_effects(trial, which, effect_sizes);
        let is_free: Vec<bool> = which.iter().map(|&n| CANDIDATES[n].signs != Signs::Switch).collect();
        let mut effect_size: Vec<f64> = (0..which.len())
            .map(|i| if is_free[i] { self.bounded(which[i], begin[i]) } else { 1.0 })
            .collect();
        let mut error = vec![0.0; which.len()];
        let free: Vec<usize> = (0..which.len()).filter(|&i| is_free[i]).collect();
        let rows = table.rows(which.iter().any(|&n| CANDIDATES[n].id == SOFTNESS));
        let is_open = !self.by.is_empty();
        let rounds = if free.is_empty() && !is_open { 0 } else { self.setting.rounds * which.len() };
        let (mut by, mut light, mut near) =
            (self.by.clone(), Cow::Borrowed(&self.light), Cow::Borrowed(&self.near[..]));
        let mut open: Option<Vec<EffectColumn>> = None;
        // Columns, and the sizes that they were taken at.
        let mut known: Option<(Vec<EffectColumn>, Vec<f64>)> = None;
        for _ in 0..rounds {
            let is_known = known.as_ref().is_some_and(|(_, at)| self.is_near(at, &effect_size));
            let further: Vec<f64> =
                free.iter().map(|&i| PROBE * f64::max(0.2, effect_size[i].abs())).collect();
            let to_move = if is_known { &[][..] } else { &free[..] };
            let trials = self.moved_trials(trial, which, &effect_size, to_move, &further);
            let found = self.evaluate_on(&light, &trials, Some(table))?;
            if !is_known {
                known = Some((
                    further.iter().enumerate().map(|(n, by)| found.column(1 + n, 0, *by)).collect(),
                    effect_size.clone(),
                ));
            }
            let columns: Vec<&EffectColumn> = known.iter().flat_map(|(columns, _)| columns).collect();
            let open_now = match open.take() {
                Some(open) => open,
                None => self.free(&trials[0], &near, Some(table), &found.left[0], &found.log_slope[0])?,
            };
            let rows = ResidualRows { free: &open_now, ..rows };
            let step = heldout(&NullFit::new(&wide(&found.left[0]), rows), &columns);
            let mut is_still = true;
            for (n, &i) in free.iter().enumerate() {
                let next = self.next_effect_size(which[i], effect_size[i], step.size[n]);
                is_still &= (next - effect_size[i]).abs() < STILL * f64::max(effect_size[i].abs(), PROBE);
                (effect_size[i], error[i]) = (next, step.error[n]);
            }
            if let Some((moved, there)) = self.move_free_parameters(&by, &step.free, &trials[0]) {
                near = Cow::Owned(self.steps(&moved));
                known = None;
                (by, light, is_still) = (moved, Cow::Owned(there), false);
            } else {
                open = Some(open_now);
            }
            if is_still {
                break;
            }
        }
        let found = self.evaluate_on(&light, &[put(&effect_size)], Some(table))?;
        let open = if is_open {
            self.free(&put(&effect_size), &near, Some(table), &found.left[0], &found.log_slope[0])?
        } else {
            Vec::new()
        };
        let with_rows = ResidualRows { free: &open, ..rows };
        let mut left = wide(&found.left[0]);
        let before = ResidualsAndSlopes { residual: &table.base, log_slope: &table.log_slope, rows: &rows };
        let with = ResidualsAndSlopes { residual: &left, log_slope: &found.log_slope[0], rows: &with_rows };
        let (gain, gain_error) = gain_of(before, with);
        let gains = row_gains(before, with);
        if is_open {
            left = without_softness(&left, &with_rows);
        }
        left.truncate(table.events.pixel.len());
        Ok(RefinedSizes { effect_size, error, gain, gain_error, left, gains, by })
    }

    /// A sensor with more effects, each of its size.
    fn with_effects(&self, trial: &Trial, which: &[usize], effect_sizes: &[f64]) -> Trial {
        which.iter().zip(effect_sizes).fold(trial.clone(), |trial, (&n, &effect_size)| {
            trial.with_effect(&CANDIDATES[n], effect_size, self.scales)
        })
    }

    /// A sensor whose effects have these sizes, and those with one of the `free` ones moved by `further`.
    fn moved_trials(
        &self,
        trial: &Trial,
        which: &[usize],
        effect_size: &[f64],
        free: &[usize],
        further: &[f64],
    ) -> Vec<Trial> {
        let mut trials = vec![self.with_effects(trial, which, effect_size)];
        for (&i, by) in free.iter().zip(further) {
            let mut moved = effect_size.to_vec();
            moved[i] += by;
            trials.push(self.with_effects(trial, which, &moved));
        }
        trials
    }

    /// Would columns that were taken at effect sizes be the same now?
    fn is_near(&self, at: &[f64], now: &[f64]) -> bool {
        at.iter().zip(now).all(|(at, now)| (now - at).abs() < SAME_COLUMN * f64::max(now.abs(), PROBE))
    }

    /// The effect size after a step of a fit, which is limited to the size itself plus 1.
    fn next_effect_size(&self, candidate: usize, effect_size: f64, step: f64) -> f64 {
        let most = 1.0 + effect_size.abs();
        self.bounded(candidate, effect_size + step.clamp(-most, most))
    }

    /// Effect sizes that a search may reach, within physics.
    fn bounded(&self, candidate: usize, effect_size: f64) -> f64 {
        let most = LARGEST_EFFECT_SIZE;
        let least = if CANDIDATES[candidate].signs == Signs::Both { -most } else { 0.0 };
        effect_size.clamp(least, most)
    }

    /// All effects on top of a table's sensor, best first; the best few are exact. With `first`, an effect
    /// that the table's sensor has and its effect size, both sizes are fitted together on top of `bare`.
    pub(super) fn rank(
        &self,
        bare: &Trial,
        table: &ResidualTable,
        control: &ResidualTable,
        first: Option<(usize, f64)>,
        refined: usize,
        nominal: &Nominal,
        places: &GainLocator<'_>,
    ) -> Result<Vec<RankedEffect>, String> {
        let mut ranked: Vec<RankedEffect> = table
            .fitted
            .iter()
            .map(|(candidate, fitted)| self.first_order(*candidate, fitted, control, nominal))
            .collect();
        ranked.sort_by(RankedEffect::by_gain);
        let best = ranked.first().map_or(0.0, RankedEffect::gain_beyond_control);
        for one in ranked.iter_mut().take(refined).filter(|one| {
            one.gain_beyond_control() > WORTH_REFINING * best && one.gain_beyond_control() > 0.0
        }) {
            let begin = one.effect_size + one.control_effect_size;
            let found = match first {
                Some((other, effect_size)) => {
                    self.refine(bare, table, &[one.candidate, other], &[begin, effect_size])?
                }
                None => self.refine(bare, table, &[one.candidate], &[begin])?,
            };
            let is_switch = CANDIDATES[one.candidate].signs == Signs::Switch;
            one.effect_size =
                if is_switch { found.effect_size[0] } else { found.effect_size[0] - one.control_effect_size };
            (one.error, one.gain, one.gain_error, one.is_exact) =
                (found.error[0], found.gain, found.gain_error, true);
            one.value = CANDIDATES[one.candidate].value(one.effect_size, self.scales, nominal);
            one.of_first = first.map(|_| found.effect_size[1]);
            one.left = median_share(&found.left, self.scales.threshold);
            one.ks = control.noise.distance(&found.left, &table.events.slope_per_s);
            one.located = Some(places.locate(&found.gains, one.candidate));
            one.by = found.by;
        }
        ranked.sort_by(RankedEffect::by_gain);
        Ok(ranked)
    }

    fn first_order(
        &self,
        candidate: usize,
        fitted: &FittedColumns,
        control: &ResidualTable,
        nominal: &Nominal,
    ) -> RankedEffect {
        let none = FittedColumns { size: vec![0.0], error: vec![0.0], ..FittedColumns::default() };
        let control =
            control.fitted.iter().find(|(n, _)| *n == candidate).map_or(&none, |(_, fitted)| fitted);
        let gain = |of: &FittedColumns| if is_physics(candidate, of.size[0]) { of.gain } else { 0.0 };
        let effect_size = fitted.size[0] - control.size[0];
        RankedEffect {
            candidate,
            effect_size,
            error: fitted.error[0],
            value: CANDIDATES[candidate].value(effect_size, self.scales, nominal),
            gain: gain(fitted),
            gain_error: fitted.gain_error,
            information: fitted.information,
            unit: CANDIDATES[candidate].value(1.0, self.scales, nominal)
                - CANDIDATES[candidate].nominal_value(nominal),
            control_gain: gain(control).max(0.0),
            control_effect_size: control.size[0],
            ..RankedEffect::default()
        }
    }
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|value| f64::from(*value)).collect()
}

/// Median absolute residual over the threshold.
pub(super) fn median_share(residual: &[f64], threshold: f64) -> f64 {
    let mut sizes: Vec<f64> = residual.iter().map(|residual| residual.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    sizes.get(sizes.len() / 2).copied().unwrap_or(f64::NAN) / threshold
}

/// Is an effect size one that the effect can have?
pub(super) fn is_physics(candidate: usize, effect_size: f64) -> bool {
    CANDIDATES[candidate].signs == Signs::Both || effect_size > 0.0
}

/// Effect size of the finite differences of an effect.
pub(super) fn probe(candidate: usize) -> f64 {
    let kind = &CANDIDATES[candidate];
    match kind.sought.grows {
        // So little of it would hardly show.
        Grows::WithSquare => 10.0 * PROBE,
        Grows::AsItFalls => 1.0,
        Grows::Linearly if kind.signs == Signs::Switch => 1.0,
        Grows::Linearly => PROBE,
    }
}

/// The block of `side` pixels that a pixel lies in; the last bit is its half, as on a chessboard.
pub(super) fn block_of(case: &Case, side: usize, pixel: usize) -> u32 {
    let width = case.extent.width as usize;
    let (bx, by) = (pixel % width / side, pixel / width / side);
    (2 * (by * width.div_ceil(side) + bx) + (bx + by) % 2) as u32
}
