//! Selects the thresholds with which the solver predicts held-out frames best.
//!
//! Some pixels are cut out of the recording, spread over its events, and every third of their frames is held
//! out. Their light is estimated by MAP with each candidate pair of thresholds. The score is the error on the
//! held-out frames, by which `solve/map` also chooses the event noise
//! ([`photocurrent_sensor::map::estimate`]). Half of the pixels search: from the better of the description's
//! pair and the one measured from frames, over a common factor and the ratio of ON to OFF. The other half
//! compares the selected pair with the description's. The halves are tiles of 8 x 8 pixels in a chessboard
//! pattern. Pixels of a tile see the same edges, so the standard error counts tiles and not pixels.
//!
//! The usual event noise is assumed throughout: with wrong thresholds the best-fitting noise is large, and
//! the estimate then hardly depends on events, whatever their thresholds. So the selected pair must also not
//! be clearly worse with the noise and the prior that the solver would choose for each.
//!
//! Limits: thresholds partly compensate a delay or a dark current that the description lacks. Pixels whose
//! event paths share photocurrent are not evaluated. The whole recording is used: cut a part out of a long
//! one.

use crate::estimate::In;
use crate::solve::map::check_length;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{Colour, Context, EventStream, NodeError, Rows, Sensor, TracksMeta};
use photocurrent_sensor::estimate::Estimate;
use photocurrent_sensor::map::estimate::{
    Choice, Choosing, FEWEST_EVENTS, FEWEST_FRAMES, choose, prediction_errors,
};
use photocurrent_sensor::map::{MapGroup, MapOptions, MapProblem, Noise, Prior, SecondStart};
use photocurrent_solve::co_located::{CoLocated, values_of};
use photocurrent_solve::row::{Recorded, RowData};
use photocurrent_solve::settings::{Sample, Unexplained, events_in_company};
use photocurrent_solve::shares::Colours;
use photocurrent_solve::{FrontEndModel, Model, SolveOptions};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Side of a tile, pixels.
const TILE: u32 = 8;
/// Share of the busiest pixels, one in this many, that are excluded as possibly hot.
const HOT: usize = 200;
/// Least number of tiles of a half: the standard error is that of as many numbers.
const FEWEST_TILES: usize = 6;
/// Pixels that are solved together: a fixed number, so that threads change no bit.
const TOGETHER: usize = 32;
/// Rows of the array that are at hand at once.
const BLOCK_ROWS: u32 = 16;
/// First steps of the common factor, natural-log units, and their number to each side.
const WIDE_STEP: f64 = 0.35;
const WIDE_STEPS: i32 = 3;
/// Then both, with steps from this to that.
const COARSE_STEP: f64 = 0.2;
const FINE_STEP: f64 = 0.0125;
/// So often, at most.
const MOST_ROUNDS: usize = 20;

/// Noise and prior that the solver assumes before it adapts them to a recording.
const TRUSTED: Choice = Choice { noise: Noise::USUAL, prior: Prior::USUAL, second: Some(SecondStart::USUAL) };

/// ON and OFF thresholds, natural-log units.
pub(crate) type ThresholdPair = (f64, f64);

/// Rule for accepting other thresholds than the description's.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AcceptanceRule {
    /// Most pixels that are evaluated.
    pub pixels: usize,
    /// Standard errors by which they must be better.
    pub least_z: f64,
    /// The share by which held-out frames must be missed less.
    pub least_gain: f64,
    /// Search range of a threshold: up to this many times the description's, and down to one part in this
    /// many.
    pub most_factor: f64,
}

/// Comparison of the selected pair with the description's, on the other half.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ThresholdVerdict {
    /// The description's.
    pub stated: ThresholdPair,
    /// The selected pair.
    pub found: ThresholdPair,
    /// The share by which held-out frames are missed less with it.
    pub gain: f64,
    /// The standard error of that.
    pub gain_sigma: f64,
    /// The share with the noise and the prior that the solver would choose for each pair, and its standard
    /// error.
    pub as_solved: (f64, f64),
    /// Pixels that judged.
    pub pixels: usize,
    /// Does it fulfil the rule?
    pub is_used: bool,
}

impl ThresholdVerdict {
    /// Improvement by the selected pair, standard errors.
    pub(crate) fn z(&self) -> f64 {
        z((self.gain, self.gain_sigma))
    }

    /// The same with what the solver would choose.
    pub(crate) fn z_as_solved(&self) -> f64 {
        z(self.as_solved)
    }

    /// The gain with its 95 % interval.
    pub(crate) fn gain(&self) -> Estimate {
        let reach = 1.96 * self.gain_sigma;
        Estimate { value: self.gain, ci95: (self.gain - reach, self.gain + reach) }
    }
}

/// Selects and evaluates thresholds; the inner error is the reason why none could be evaluated.
///
/// # Errors
/// When a stream cannot be read, or the user interrupts.
pub(crate) fn evaluate_thresholds(
    input: &In,
    sensor: &Sensor,
    measured: Option<ThresholdPair>,
    rule: &AcceptanceRule,
    cx: &Context,
) -> Result<Result<ThresholdVerdict, String>, NodeError> {
    let mut bench = match ThresholdBench::new(input, sensor, rule)? {
        Ok(bench) => bench,
        Err(why) => return Ok(Err(why)),
    };
    let stated = (bench.model.sensor().pixel.threshold_on, bench.model.sensor().pixel.threshold_off);
    cx.begin((2 + 2 * WIDE_STEPS as usize + 4 * MOST_ROUNDS) as u64, "pairs of thresholds");
    let found = bench.search_pair(stated, measured, rule.most_factor, cx)?;
    let mut verdict = ThresholdVerdict {
        stated,
        found,
        gain: 0.0,
        gain_sigma: 0.0,
        as_solved: (0.0, 0.0),
        pixels: bench.judging.sample.len(),
        is_used: false,
    };
    if found != stated {
        (verdict.gain, verdict.gain_sigma) = bench.gain([(stated, TRUSTED), (found, TRUSTED)]);
        verdict.is_used = verdict.z() >= rule.least_z && verdict.gain >= rule.least_gain;
    }
    if verdict.is_used {
        let chosen = [stated, found].map(|pair| (pair, bench.choice(pair)));
        verdict.as_solved = bench.gain(chosen);
        verdict.is_used = verdict.z_as_solved() > -rule.least_z;
    }
    Ok(Ok(verdict))
}

/// Standard errors.
fn z((value, sigma): (f64, f64)) -> f64 {
    if sigma > 0.0 { value / sigma } else { 0.0 }
}

/// A sum over pixels and its standard error, by the tiles that they lie in.
fn tile_sum(tiles: &[u32], values: impl Iterator<Item = f64>) -> (f64, f64) {
    let mut sums: BTreeMap<u32, f64> = BTreeMap::new();
    tiles.iter().zip(values).for_each(|(tile, value)| *sums.entry(*tile).or_default() += value);
    let (n, sum) = (sums.len() as f64, sums.values().sum::<f64>());
    let squares: f64 = sums.values().map(|of_tile| (of_tile - sum / n) * (of_tile - sum / n)).sum();
    (sum, libm::sqrt(squares * n / (n - 1.0)))
}

/// An evaluated value of the frames.
#[derive(Clone, Copy, Debug, PartialEq)]
struct FrameValuePlace {
    row: u32,
    /// Within the row.
    value: usize,
    tile: u32,
    is_judge: bool,
}

/// Pixels that have events, spread over the events: of both halves alike, in order of rows.
fn frame_value_places(
    events: &EventStream,
    lie: CoLocated,
    pixels: usize,
) -> Result<Vec<FrameValuePlace>, NodeError> {
    let extent = events.meta.extent;
    let mut counted: [Vec<(u32, u32, u32)>; 2] = Default::default();
    let tile = |x: u32, y: u32| (x / TILE, y / TILE);
    for band in extent.rows().bands(BLOCK_ROWS) {
        let read = events.read(band)?;
        for y in band.iter() {
            let mut counts = vec![0u32; extent.width as usize];
            read.row(y).x.iter().for_each(|x| counts[usize::from(*x)] += 1);
            for (x, count) in (0..).zip(counts).filter(|(_, count)| *count > 0) {
                let (column, row) = tile(x, y);
                counted[((column + row) % 2) as usize].push((count, y, x));
            }
        }
    }
    let mut places = Vec::new();
    for (of_half, is_judge) in counted.iter_mut().zip([false, true]) {
        of_half.sort_unstable();
        let usual = &of_half[..of_half.len() - of_half.len() / HOT];
        let all: u64 = usual.iter().map(|(count, _, _)| u64::from(*count)).sum();
        let taken = usize::min(usual.len(), pixels / 2) as u64;
        // The pixels in which every so many-th event lies, by their number of events.
        let (mut at, mut before) = (0, 0);
        let mut picked: Vec<usize> = (0..taken)
            .map(|n| {
                while before + u64::from(usual[at].0) <= (2 * n + 1) * all / (2 * taken) {
                    before += u64::from(usual[at].0);
                    at += 1;
                }
                at
            })
            .collect();
        picked.dedup();
        for (n, at) in picked.into_iter().enumerate() {
            let (_, y, x) = usual[at];
            // Of an event pixel with several values one after the other.
            let (copies, within) = (
                lie.ratio * lie.colour.channels(),
                n as u32 % (lie.ratio * lie.ratio * lie.colour.channels()),
            );
            let (column, row) = tile(x, y);
            let value = (x * copies + within % copies) as usize;
            places.push(FrameValuePlace {
                row: y * lie.ratio + within / copies,
                value,
                tile: row * extent.width.div_ceil(TILE) + column,
                is_judge,
            });
        }
    }
    places.sort_unstable_by_key(|place| (place.row, place.value));
    Ok(places)
}

/// Pixels of a half.
struct PixelHalf {
    sample: Sample,
    tiles: Vec<u32>,
}

impl PixelHalf {
    fn what_is_missing(&self) -> Option<String> {
        let tiles = self.tiles.iter().collect::<BTreeSet<_>>().len();
        let events = self.sample.events();
        (tiles < FEWEST_TILES || events < FEWEST_EVENTS).then(|| {
            format!(
                "{events} events of {} pixels in {tiles} tiles are too few, as {FEWEST_EVENTS} in \
                     {FEWEST_TILES} tiles are needed",
                self.sample.len()
            )
        })
    }

    /// How badly the frames of each pixel that are held out are predicted with the thresholds of `model`.
    fn errors(&self, model: &Model, choice: &Choice) -> Vec<f64> {
        let options = MapOptions { prior: choice.prior, second: choice.second, ..self.sample.options };
        let begins: Vec<usize> = (0..self.sample.len()).step_by(TOGETHER).collect();
        let of_some = |group: &mut MapGroup, begin: usize| {
            let pixels = begin..usize::min(begin + TOGETHER, self.sample.len());
            self.sample.with_problems(model, pixels, None, group, |problems, group| {
                let problems: Vec<MapProblem<'_>> =
                    problems.iter().map(|problem| MapProblem { noise: choice.noise, ..*problem }).collect();
                prediction_errors(&problems, &options, group)
            })
        };
        let errors: Vec<Vec<f64>> = begins.into_par_iter().map_init(MapGroup::default, of_some).collect();
        errors.concat()
    }
}

/// The pixels and the solver.
struct ThresholdBench {
    model: Model,
    searching: PixelHalf,
    judging: PixelHalf,
}

impl ThresholdBench {
    /// Cuts the pixels out of the recording.
    fn new(
        input: &In,
        sensor: &Sensor,
        rule: &AcceptanceRule,
    ) -> Result<Result<ThresholdBench, String>, NodeError> {
        // Delays that the description does not state count as none.
        let has_front_end = sensor.front_end.tau_0.is_some() && sensor.front_end.alpha.is_some();
        let front_end = if has_front_end { FrontEndModel::LowPass } else { FrontEndModel::Ideal };
        let mut sensor = sensor.clone();
        sensor.readout.refractory = Some(sensor.readout.refractory.unwrap_or(Duration::new(0)));
        let options = SolveOptions { front_end, sigma: false, ..SolveOptions::default() };
        let (events, frames) = (&input.events.meta, &input.frames.meta);
        let checked = || -> Result<(Model, TracksMeta, Colours), NodeError> {
            let (model, meta) =
                (Model::of_map(&options, &sensor, events)?, options.tracks_meta(events, frames)?);
            check_length(&options, meta.span)?;
            Ok((model, meta, Colours::new(CoLocated::new(events, frames)?, &sensor)?))
        };
        let (mut model, meta, colours) = match checked() {
            Ok(checked) => checked,
            Err(error) => return Ok(Err(error.message)),
        };
        if model.is_mixed() {
            return Ok(Err("the description mixes the photocurrent of neighbouring pixels".into()));
        }
        if input.frames.len() < FEWEST_FRAMES {
            return Ok(Err(format!(
                "of {} frames none can be held out, as {FEWEST_FRAMES} are needed",
                input.frames.len()
            )));
        }
        model.inform(&input.events)?;
        let places = frame_value_places(&input.events, colours.lie, rule.pixels)?;
        let wide = TracksMeta { extent: values_of(meta.extent, meta.colour), colour: Colour::Mono, ..meta };
        let (times, all) = (&input.frames.meta.times, meta.extent.rows());
        let span = (wide.span.start.0, wide.span.end.0);
        let mut halves =
            [(); 2].map(|()| PixelHalf { sample: Sample::new(&options, span), tiles: Vec::new() });
        let (mut data, mut unexplained) = (RowData::default(), Unexplained::default());
        for of_block in places.chunk_by(|a, b| a.row / BLOCK_ROWS == b.row / BLOCK_ROWS) {
            let first = of_block[0].row / BLOCK_ROWS * BLOCK_ROWS;
            let at_hand = Rows { start: first, end: first + BLOCK_ROWS }.intersect(all).with_halo(1, all);
            let (events, frames) = (
                colours.lie.read(&input.events, at_hand)?,
                input.frames.read_rows(at_hand.with_halo(colours.halo(), all))?,
            );
            let recorded = Recorded {
                meta: &wide,
                times,
                colours: &colours,
                rows: at_hand,
                events: &events,
                frames: &frames,
            };
            for of_row in of_block.chunk_by(|a, b| a.row == b.row) {
                data.take(&model, &recorded, of_row[0].row, 0.0)?;
                (0..data.width()).for_each(|x| unexplained.add(&data, x));
                for place in of_row {
                    if events_in_company(&data, place.value) > 0
                        && data.frames_of(place.value).len() >= FEWEST_FRAMES
                    {
                        let half = &mut halves[usize::from(place.is_judge)];
                        half.sample.push(&data, place.value);
                        half.tiles.push(place.tile);
                    }
                }
            }
        }
        let frame_dn = unexplained.frame_dn();
        halves.iter_mut().for_each(|half| half.sample.add_noise(frame_dn));
        if let Some(missing) = halves.iter().find_map(PixelHalf::what_is_missing) {
            return Ok(Err(missing));
        }
        let [searching, judging] = halves;
        Ok(Ok(ThresholdBench { model, searching, judging }))
    }

    /// The noise of events and the prior that suit the searching half, with these thresholds.
    fn choice(&mut self, thresholds: ThresholdPair) -> Choice {
        self.model.set_thresholds(thresholds);
        let PixelHalf { sample, .. } = &self.searching;
        let choose = |problems: &[MapProblem<'_>], group: &mut MapGroup| {
            choose(problems, None, &Choosing::USUAL, &sample.options, group)
        };
        sample.with_problems(&self.model, 0..sample.len(), None, &mut MapGroup::default(), choose)
    }

    /// The share by which the judging half is missed less with the second than with the first, and its
    /// standard error.
    fn gain(&mut self, pairs: [(ThresholdPair, Choice); 2]) -> (f64, f64) {
        let [first, second] = pairs.map(|(thresholds, choice)| {
            self.model.set_thresholds(thresholds);
            self.judging.errors(&self.model, &choice)
        });
        let all: f64 = first.iter().sum();
        let (better, sigma) =
            tile_sum(&self.judging.tiles, first.iter().zip(&second).map(|(first, second)| first - second));
        if all > 0.0 { (better / all, sigma / all) } else { (0.0, 0.0) }
    }

    /// How badly the searching half is predicted.
    fn loss(&mut self, thresholds: ThresholdPair, cx: &Context) -> Result<f64, NodeError> {
        self.model.set_thresholds(thresholds);
        cx.advance(1)?;
        Ok(self.searching.errors(&self.model, &TRUSTED).iter().sum())
    }

    /// The pair that predicts the searching half best.
    fn search_pair(
        &mut self,
        stated: ThresholdPair,
        measured: Option<ThresholdPair>,
        most_factor: f64,
        cx: &Context,
    ) -> Result<ThresholdPair, NodeError> {
        let farthest = libm::log(most_factor);
        let is_near = |pair: ThresholdPair| {
            f64::max(libm::log(pair.0 / stated.0).abs(), libm::log(pair.1 / stated.1).abs()) <= farthest
        };
        // By a common factor and by the ratio of ON to OFF, both as logarithms.
        let moved = |pair: ThresholdPair, (common, ratio): (f64, f64)| {
            (pair.0 * libm::exp(common + 0.5 * ratio), pair.1 * libm::exp(common - 0.5 * ratio))
        };
        let mut best = (self.loss(stated, cx)?, stated);
        let mut try_all =
            |pairs: &[ThresholdPair], best: &mut (f64, ThresholdPair)| -> Result<(), NodeError> {
                for &pair in pairs.iter().filter(|pair| is_near(**pair)) {
                    let loss = self.loss(pair, cx)?;
                    if loss < best.0 {
                        *best = (loss, pair);
                    }
                }
                Ok(())
            };
        try_all(measured.as_slice(), &mut best)?;
        let begin = best.1;
        let wide: Vec<ThresholdPair> = (-WIDE_STEPS..=WIDE_STEPS)
            .filter(|n| *n != 0)
            .map(|n| moved(begin, (f64::from(n) * WIDE_STEP, 0.0)))
            .collect();
        try_all(&wide, &mut best)?;
        let mut step = COARSE_STEP;
        for _ in 0..MOST_ROUNDS {
            let around = best.1;
            try_all(
                &[(-step, 0.0), (step, 0.0), (0.0, -step), (0.0, step)].map(|by| moved(around, by)),
                &mut best,
            )?;
            if best.1 == around {
                step *= 0.5;
            }
            if step < FINE_STEP {
                break;
            }
        }
        Ok(best.1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sum_has_the_standard_error_of_its_tiles() {
        // Four tiles with sums of 1, 2, 3 and 4: a sample variance of 5 / 3, four times.
        let (sum, sigma) = tile_sum(&[7, 3, 7, 1, 2], [0.5, 2.0, 0.5, 3.0, 4.0].into_iter());
        assert!(sum == 10.0 && (sigma - libm::sqrt(4.0 * 5.0 / 3.0)).abs() < 1e-12, "{sum} {sigma}");
    }
}
