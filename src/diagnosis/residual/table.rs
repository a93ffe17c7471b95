//! First-order fits of every effect on a scene, and exact ones of a few together.

use super::components::{SPREADS, white_share};
use super::evidence::Ranked;
use super::fit::{
    Column, EventNoise, Fitted, Plain, Rest, Rows, Soft, gain_of, gains, heldout, without_softness,
};
use super::formulas::formulas;
use super::laid::{Laid, lay};
use super::open::{self, Open};
use super::places::Places;
use super::prepared::Prepared;
use super::setting::{CELL, EvidenceSetting, LARGEST_EFFECT_SIZE, LEAST_SLOPE, PROBE, STILL, WORTH_REFINING};
use super::{FrameValues, Residuals, View};
use crate::candidates::{CANDIDATES, Scales, Signs, Trial};
use crate::covariates::{Covariate, Surroundings};
use crate::rhythm::Rhythm;
use photocurrent_scene::case::Case;
use photocurrent_scene::gate::Gate;
use photocurrent_scene::light::Light;
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::statistics::median;
use photocurrent_scene::{Cell, Scene};
use photocurrent_sensor::effects::sought::Grows;
use photocurrent_sensor::elementary::ln;
use std::borrow::Cow;
use std::sync::LazyLock;

/// A recording with its scene, ready to be asked.
pub(super) struct Seen<'a> {
    pub case: &'a Case,
    pub light: Light,
    pub gate: Gate,
    pub pixels: Vec<u32>,
    /// For what needs pairs of pixels.
    pub more: Vec<u32>,
    pub setting: &'a EvidenceSetting,
    pub scales: &'a Scales,
    /// Least noise, natural-log units.
    pub least: f64,
    /// Does the scene stand without the frames? Then their values are looked at as well.
    pub is_known: bool,
    /// The scene, for what is free of it.
    pub source: &'a dyn Scene,
    /// How far the free parameters stand from where the source has them, shares of their ranges; `light` is
    /// that of the source moved so.
    pub by: Vec<f64>,
    /// And the light with each of them moved from there by a step ([`Seen::steps`]).
    pub near: Vec<(f64, Light)>,
    /// What each pixel's own size of a random effect subtracts from each residual; nothing, or of the stated
    /// sensor's events.
    pub own: Vec<f32>,
}

/// One sensor and everything on top of it.
pub(super) struct Table {
    /// The sensor.
    pub trial: Trial,
    pub events: Residuals,
    /// Frame values, of a known scene.
    frames: FrameValues,
    /// Slopes of events; behind them, of a known scene, brightness of frame values.
    slope: Vec<f64>,
    /// Blocks, likewise.
    block: Vec<u32>,
    /// Residuals, likewise.
    base: Vec<f64>,
    /// Residuals of the events without what a picture that is too soft leaves.
    sharp: Vec<f64>,
    /// Logarithms of the events' slopes.
    log_slope: Vec<f32>,
    least: f64,
    /// At most so much of the blur's column is subtracted in addition to everything, below 0.
    softest: f64,
    /// Columns of the candidates.
    columns: Vec<(usize, Column)>,
    /// And of the free parameters of the scene.
    free: Vec<Column>,
    /// Held-out log-likelihood of an event's time, nats.
    pub nats_per_event: f64,
    /// Noise of the events without what a picture that is too soft leaves.
    pub noise: EventNoise,
    pub fitted: Vec<(usize, Fitted)>,
}

/// What a picture that is too soft leaves looks like what too much blur in the event path would, with the
/// other sign.
const SOFTNESS: &str = "blur";

/// Columns of effects at their sizes stand while those move by less than this share.
const SAME_COLUMN: f64 = 0.05;

/// What trials make of the rows.
struct Evaluated {
    /// Of the first trial; nothing where they are a table's.
    events: Residuals,
    frames: FrameValues,
    /// Residuals for each trial: of events, then of frame values.
    left: Vec<Vec<f32>>,
    /// Logarithms of the events' slopes for each trial.
    log_slope: Vec<Vec<f32>>,
}

impl Table {
    fn rows(&self, is_sharp: bool) -> Rows<'_> {
        let soft = self.of(SOFTNESS, "").filter(|_| !is_sharp).map(|column| Soft {
            column: &column.of,
            log_slope: &column.log_slope,
            most: self.softest,
        });
        Rows {
            slope: &self.slope,
            block: &self.block,
            events: self.events.pixel.len(),
            least: self.least,
            soft,
            free: &self.free,
        }
    }

    /// The column of an effect's parameter, or of its first one.
    fn of(&self, id: &str, parameter: &str) -> Option<&Column> {
        let is_it = |n: usize| {
            CANDIDATES[n].id == id && (parameter.is_empty() || CANDIDATES[n].parameter == parameter)
        };
        self.columns.iter().find(|(n, _)| is_it(*n)).map(|(_, column)| column)
    }

    /// Fits every column with what a picture that is too soft leaves, `softest` of it at most.
    pub(super) fn fit(&mut self, softest: f64) {
        self.softest = softest;
        let plain = |is_sharp: bool| Plain::new(&self.base, self.rows(is_sharp));
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
        let size = |(_, fitted): &(usize, Fitted)| fitted.size[0];
        self.fitted.iter().find(|(n, _)| CANDIDATES[*n].id == SOFTNESS).map_or(0.0, size).min(0.0)
    }

    /// Residuals of the events.
    pub(super) fn residual(&self) -> &[f64] {
        &self.base[..self.events.pixel.len()]
    }

    /// The same without what a picture that is too soft leaves, or what free parameters of the scene explain.
    pub(super) fn sharp(&self) -> &[f64] {
        &self.sharp
    }

    /// Columns of the events that each pixel may have a size of its own of.
    pub(super) fn of_pixels(&self) -> [Cow<'_, [f32]>; 2] {
        let events = self.events.pixel.len();
        OF_PIXELS.map(|(id, parameter)| {
            self.of(id, parameter)
                .map_or_else(|| Cow::Owned(vec![0.0; events]), |column| Cow::Borrowed(&column.of[..events]))
        })
    }
}

impl Evaluated {
    /// What a step `by` of one trial from another one changes, for each size.
    fn column(&self, trial: usize, from: usize, by: f64) -> Column {
        let change = |values: &[Vec<f32>]| {
            values[trial]
                .iter()
                .zip(&values[from])
                .map(|(with, before)| (with - before) / by as f32)
                .collect()
        };
        Column { of: change(&self.left), log_slope: change(&self.log_slope) }
    }
}

/// Sizes of some effects together, and their gain over a table's residuals.
pub(super) struct Refined {
    pub effect_size: Vec<f64>,
    pub error: Vec<f64>,
    pub gain: f64,
    pub gain_error: f64,
    /// Residuals of events that they leave.
    pub left: Vec<f64>,
    /// What each row gains by them.
    pub gains: Vec<f64>,
    /// Where they leave the free parameters of the scene ([`Seen::by`]).
    pub by: Vec<f64>,
}

/// Candidates whose columns each pixel may have a size of its own of: what [`SPREADS`] spread.
pub(super) static OF_PIXELS: LazyLock<[(&str, &str); 2]> = LazyLock::new(|| {
    let spread_of =
        |id: &str| CANDIDATES.iter().filter(|one| one.id == id).find_map(|one| one.sought.spread_of);
    SPREADS.map(|id| spread_of(id).unwrap_or_else(|| unreachable!("{id} spreads sizes")))
});

/// Standard deviation of a free parameter of the scene within its range, as a share of it, before the
/// recording.
const OPEN: f64 = 0.3;
/// A free parameter that moves by less than so many of its steps stands.
const NEAR: f64 = 2.0;
/// And none moves by more than this share of its range at a time.
const FARTHEST: f64 = 0.2;

impl Seen<'_> {
    /// The light of the pixels with each free parameter of the scene moved by a step from shares `by`.
    pub(super) fn steps(&self, by: &[f64]) -> Vec<(f64, Light)> {
        let Some(target) = self.source.target() else { return Vec::new() };
        let one = |(k, (_, step)): (usize, (f64, f64))| {
            let mut moved = by.to_vec();
            moved[k] += step;
            Some((step, target.moved(self.case, self.light.step_ns, Some(&self.pixels), &moved)?))
        };
        target.free().into_iter().enumerate().filter_map(one).collect()
    }

    /// What the free parameters of the scene change of each row seen through a trial, each per its standard
    /// deviation before the recording; `near`: [`Seen::steps`].
    fn free(
        &self,
        trial: &Trial,
        near: &[(f64, Light)],
        table: Option<&Table>,
        base: &[f32],
        log_slope: &[f32],
    ) -> Result<Vec<Column>, String> {
        let one = |(step, light): &(f64, Light)| -> Result<Column, String> {
            let found = self.evaluate_on(light, std::slice::from_ref(trial), table)?;
            let scale = (OPEN / step) as f32;
            let change = |then: &[f32], now: &[f32]| -> Vec<f32> {
                then.iter().zip(now).map(|(then, now)| (then - now) * scale).collect()
            };
            Ok(Column { of: change(&found.left[0], base), log_slope: change(&found.log_slope[0], log_slope) })
        };
        near.iter().map(one).collect()
    }

    /// Where sizes of what is free of the scene move it from shares `by`; none where that is nearly zero.
    fn further(&self, by: &[f64], sizes: &[f64], trial: &Trial) -> Option<(Vec<f64>, Light)> {
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
        let is_mixed = Prepared::new(self.case, trial).map_or(true, |prepared| prepared.kernel().is_some());
        let light =
            target.moved(self.case, self.light.step_ns, (!is_mixed).then_some(&self.pixels[..]), &moved)?;
        Some((moved, light))
    }

    /// What trials make of events: those of a table, or those that count by the first trial.
    fn evaluate(&self, trials: &[Trial], table: Option<&Table>) -> Result<Evaluated, String> {
        self.evaluate_on(&self.light, trials, table)
    }

    fn evaluate_on(
        &self,
        light: &Light,
        trials: &[Trial],
        table: Option<&Table>,
    ) -> Result<Evaluated, String> {
        let view = View { case: self.case, light, pixels: self.pixels.clone(), is_known: self.is_known };
        let (events, of_trials) = match table {
            Some(table) => (Cow::Borrowed(&table.events), view.of_events(trials, &table.events)?),
            None => {
                let (events, of_trials) =
                    view.residuals(trials, |pixel, t_ns| self.gate.keeps(pixel, t_ns))?;
                (Cow::Owned(events), of_trials)
            }
        };
        let mut slopes: Vec<f64> = events.slope_per_s.iter().map(|slope| slope.abs()).collect();
        // A voltage that hardly moves says little of when an event comes; on the way to one it takes a
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
            // Which values are looked at is the first one's business.
            let first = table.map(|table| table.trial.clone());
            let all: Vec<Trial> = first.iter().chain(trials).cloned().collect();
            let mut of_frames;
            (frames, of_frames) = view.frames(&all)?;
            of_frames.drain(..all.len() - trials.len());
            left.iter_mut().zip(of_frames).for_each(|(left, of_frames)| left.extend(of_frames));
        }
        Ok(Evaluated {
            events: if table.is_none() { events.into_owned() } else { Residuals::default() },
            frames,
            left,
            log_slope,
        })
    }

    /// The share of the squares of residuals that is noise of pixels ([`white_share`]), on more events than
    /// are fitted.
    pub(super) fn white(&self, trial: &Trial, source: &dyn Scene) -> Result<f64, String> {
        if self.is_known {
            return Ok(1.0);
        }
        let view = View { case: self.case, light: &self.light, pixels: self.more.clone(), is_known: false };
        let (events, _) =
            view.residuals(std::slice::from_ref(trial), |pixel, t_ns| self.gate.keeps(pixel, t_ns))?;
        let cell = |(pixel, t_ns): (&u32, &i64)| source.cell(self.case, *pixel as usize, *t_ns, CELL);
        let cells: Vec<Cell> = events.pixel.iter().zip(&events.t_ns).map(cell).collect();
        Ok(white_share((&events.pixel, &events.polarity), &events.excess, &cells))
    }

    /// Covariates of the events of a table, and of its frame values.
    pub(super) fn lay(&self, table: &Table, nominal: &Nominal, rhythm: Option<Rhythm>) -> [Vec<Laid>; 2] {
        let front_end = nominal.pixel.front_end;
        let light = Box::new(|pixel: usize, t_ns: i64| self.light.at(pixel, t_ns));
        let constants = (front_end.tau_0_s, front_end.alpha_s);
        let mut surroundings = Surroundings::of(self.case, light, self.case.extent.pixels(), constants);
        let FrameValues { pixel, t_ns, .. } = table.frames.clone();
        let count = pixel.len();
        let values = Residuals {
            pixel,
            t_ns,
            polarity: vec![1; count],
            previous: vec![1; count],
            since_ns: vec![0; count],
            ..Residuals::default()
        };
        let mut of_frames = if count > 0 { lay(&values, &mut surroundings, None) } else { Vec::new() };
        of_frames.retain(|laid| Covariate::OF_FRAMES.contains(&laid.covariate));
        [lay(&table.events, &mut surroundings, rhythm), of_frames]
    }

    /// What gains over the residuals of a table are located on.
    pub(super) fn places<'t>(&'t self, table: &'t Table, laid: &[Vec<Laid>; 2]) -> Places<'t> {
        Places::new(self.case, &table.events, &table.frames, &table.block, laid, &self.setting.located)
    }

    /// What no effect of the catalogue has, on the residuals of a table.
    pub(super) fn dependences(&self, table: &Table, laid: &[Laid]) -> Vec<Open> {
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
        table: &Table,
        laid: &[Laid],
        places: &Places<'_>,
        best: &mut Open,
    ) {
        let (events, block) = (&table.events, &table.block[..table.events.pixel.len()]);
        let (threshold, sharp) = (self.scales.threshold, table.sharp());
        best.dependence.formulas =
            formulas(events, sharp, block, laid, &best.dependence, threshold, self.least);
        let after = open::after(
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
    pub(super) fn table(&self, trial: &Trial, without: Option<usize>, softest: f64) -> Result<Table, String> {
        // One that cannot be combined with what is there is no candidate.
        let can_be =
            |n: &usize| Prepared::new(self.case, &trial.and(&CANDIDATES[*n], probe(*n), self.scales)).is_ok();
        let chosen: Vec<usize> = (0..CANDIDATES.len())
            .filter(|&n| !CANDIDATES[n].is_random && Some(n) != without)
            .filter(can_be)
            .collect();
        let mut trials = vec![trial.clone()];
        trials.extend(chosen.iter().map(|&n| trial.and(&CANDIDATES[n], probe(n), self.scales)));
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
        let Evaluated { events, frames, left, mut log_slope } = found;
        let mut table = Table {
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
        table: &Table,
        which: &[usize],
        begin: &[f64],
    ) -> Result<Refined, String> {
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
        let mut open: Option<Vec<Column>> = None;
        // Columns, and the sizes that they were taken at.
        let mut known: Option<(Vec<Column>, Vec<f64>)> = None;
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
            let columns: Vec<&Column> = known.iter().flat_map(|(columns, _)| columns).collect();
            let open_now = match open.take() {
                Some(open) => open,
                None => self.free(&trials[0], &near, Some(table), &found.left[0], &found.log_slope[0])?,
            };
            let rows = Rows { free: &open_now, ..rows };
            let step = heldout(&Plain::new(&wide(&found.left[0]), rows), &columns);
            let mut is_still = true;
            for (n, &i) in free.iter().enumerate() {
                let next = self.next(which[i], effect_size[i], step.size[n]);
                is_still &= (next - effect_size[i]).abs() < STILL * f64::max(effect_size[i].abs(), PROBE);
                (effect_size[i], error[i]) = (next, step.error[n]);
            }
            if let Some((moved, there)) = self.further(&by, &step.free, &trials[0]) {
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
        let with_rows = Rows { free: &open, ..rows };
        let mut left = wide(&found.left[0]);
        let before = Rest { residual: &table.base, log_slope: &table.log_slope, rows: &rows };
        let with = Rest { residual: &left, log_slope: &found.log_slope[0], rows: &with_rows };
        let (gain, gain_error) = gain_of(before, with);
        let gains = gains(before, with);
        if is_open {
            left = without_softness(&left, &with_rows);
        }
        left.truncate(table.events.pixel.len());
        Ok(Refined { effect_size, error, gain, gain_error, left, gains, by })
    }

    /// A sensor with more effects, each of its size.
    fn with_effects(&self, trial: &Trial, which: &[usize], effect_sizes: &[f64]) -> Trial {
        which.iter().zip(effect_sizes).fold(trial.clone(), |trial, (&n, &effect_size)| {
            trial.and(&CANDIDATES[n], effect_size, self.scales)
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

    /// The effect size after a step of a fit, which goes no further than the size itself and 1 more.
    fn next(&self, candidate: usize, effect_size: f64, step: f64) -> f64 {
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
        table: &Table,
        control: &Table,
        first: Option<(usize, f64)>,
        refined: usize,
        nominal: &Nominal,
        places: &Places<'_>,
    ) -> Result<Vec<Ranked>, String> {
        let mut ranked: Vec<Ranked> = table
            .fitted
            .iter()
            .map(|(candidate, fitted)| self.first_order(*candidate, fitted, control, nominal))
            .collect();
        ranked.sort_by(Ranked::by_gain);
        let best = ranked.first().map_or(0.0, Ranked::beyond);
        for one in ranked
            .iter_mut()
            .take(refined)
            .filter(|one| one.beyond() > WORTH_REFINING * best && one.beyond() > 0.0)
        {
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
        ranked.sort_by(Ranked::by_gain);
        Ok(ranked)
    }

    fn first_order(&self, candidate: usize, fitted: &Fitted, control: &Table, nominal: &Nominal) -> Ranked {
        let none = Fitted { size: vec![0.0], error: vec![0.0], ..Fitted::default() };
        let control =
            control.fitted.iter().find(|(n, _)| *n == candidate).map_or(&none, |(_, fitted)| fitted);
        let gain = |of: &Fitted| if is_physics(candidate, of.size[0]) { of.gain } else { 0.0 };
        let effect_size = fitted.size[0] - control.size[0];
        Ranked {
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
            ..Ranked::default()
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
