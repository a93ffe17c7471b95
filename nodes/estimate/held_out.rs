//! Contrast thresholds with which frames that are held out are predicted best.
//!
//! What the change between two frames counts in events ([`photocurrent_sensor::estimate::thresholds`]) needs
//! many bright places that change one way between frames. Where there are few, thresholds come out anywhere.
//! So pixels all over the array are solved without some of their frames (one in three, or of a few frames
//! each that is not an end in turn), with one threshold after the other, and with the noise and prior that
//! the solver chooses for each: the one that predicts those frames best is what a solution needs.
//! A blend of the neighbouring frames is compared on the same frames: where that is better, a picture gains
//! nothing from events.
//!
//! Limits: both signs have the same threshold, as frames do not show which of the two is off (a pixel that
//! darkens is slower); an ideal front end, so that what a slow pixel leaves out of its events is in the
//! thresholds; a grid, refined once; the interval is that of the values that are not clearly worse. Frames
//! are blurred, so that sharpness does not count.

use super::Estimate;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{EventStream, FrameBlock, FrameSequence, NodeError, Sensor, TimeSpan};
use photocurrent_scene::grey::{Clipped, Grey};
use photocurrent_sensor::map::estimate::{self, Choosing, FEWEST_FRAMES, HoldOut};
use photocurrent_sensor::map::{MapGroup, MapOptions, MapProblem};
use photocurrent_solve::co_located::CoLocated;
use photocurrent_solve::row::{Recorded, RowData};
use photocurrent_solve::settings::{Sample, Unexplained, events_in_company};
use photocurrent_solve::shares::Colours;
use photocurrent_solve::{FrontEndModel, Model, SolveOptions};
use rayon::prelude::*;
use std::sync::Arc;

/// Frames that take part: at most so many in a row, those with most events.
const MOST_FRAMES: usize = 25;
/// Frames that are further apart, in usual periods, have a pause between them.
const PAUSE: i64 = 4;
/// Of fewer frames each is held out in turn.
const FEW_FRAMES: usize = 10;
/// Rows that take part, each the busiest of as many bands, and pixels of each.
const ROWS: u32 = 24;
const PIXELS: usize = 16;
/// Fewer pixels decide nothing.
const FEWEST_PIXELS: usize = 48;
/// The thresholds that are tried first, alike for both signs, natural-log units: each 1.3 times the last.
const FIRST: f64 = 0.06;
const STEP: f64 = 1.3;
const TRIED: i32 = 12;
/// Steps around the best of those.
const REFINED: [f64; 4] = [0.82, 0.91, 1.1, 1.21];
/// The interval reaches at least by this factor beyond what is best: rows of one recording err together.
const APART: f64 = 1.3;
/// A threshold is clearly worse by so many standard errors.
const CLEAR: f64 = 2.0;

/// Thresholds, and how well frames that are held out are predicted with them.
#[derive(Clone, Debug)]
pub struct HeldOut {
    /// The threshold of both signs, natural-log units.
    pub threshold: Estimate,
    /// Root mean square of the relative error of a frame value with them, each at most 1.
    pub error: f64,
    /// The same with the thresholds that were given.
    pub given: Option<f64>,
    /// The same of a blend of the frames before and after, and whether that is clearly better.
    pub blend: (f64, bool),
}

/// A threshold of both signs, and what each row loses with it: squares of relative errors, as pictures are
/// judged by squares; absolute values prefer too large thresholds, with which few pixels err by much.
struct Tried {
    both: f64,
    of_rows: Vec<f64>,
}

/// Of events that lag the frames by `late_ns`; `given` is the pair that is compared. None where too little
/// moves, or there are fewer than four frames.
///
/// # Errors
/// When a stream cannot be read, or frames are no whole multiple of the events' pixels.
pub fn thresholds(
    events: &EventStream,
    frames: &FrameSequence,
    late_ns: f64,
    given: Option<(f64, f64)>,
) -> Result<Option<HeldOut>, NodeError> {
    if frames.len() < FEWEST_FRAMES {
        return Ok(None);
    }
    let Some((events, frames)) = busiest(events, frames, late_ns)? else { return Ok(None) };
    let bench = Bench::new(&events, &frames, late_ns)?;
    if bench.places.iter().map(|(_, columns)| columns.len()).sum::<usize>() < FEWEST_PIXELS {
        return Ok(None);
    }
    let of = |all: Vec<f64>| -> Result<Vec<Tried>, NodeError> {
        let of = |both: f64| Ok(Tried { both, of_rows: bench.of((both, both))? });
        all.into_par_iter().map(of).collect()
    };
    let mut tried = of((0..TRIED).map(|n| FIRST * libm::pow(STEP, f64::from(n))).collect())?;
    let both = best_of(&tried).both;
    tried.extend(of(REFINED.iter().map(|by| both * by).collect())?);
    let best = best_of(&tried);
    let given = given.map(|pair| bench.of(pair)).transpose()?;
    let root = |squares: f64| libm::sqrt(squares / bench.held as f64);
    let blend = bench.blend()?;
    let close = tried.iter().filter(|one| !clearly(&best.of_rows, &one.of_rows)).map(|one| one.both);
    let wider = |(low, high): (f64, f64), both: f64| (f64::min(low, both), f64::max(high, both));
    let ci95 = close.fold((best.both / APART, best.both * APART), wider);
    Ok(Some(HeldOut {
        threshold: Estimate { value: best.both, ci95 },
        error: root(best.sum()),
        given: given.map(|of_rows| root(of_rows.iter().sum())),
        blend: (root(blend.iter().sum()), clearly(&blend, &best.of_rows)),
    }))
}

impl Tried {
    fn sum(&self) -> f64 {
        self.of_rows.iter().sum()
    }
}

fn best_of(tried: &[Tried]) -> &Tried {
    let first = &tried[0];
    tried.iter().fold(first, |best, one| if one.sum() < best.sum() { one } else { best })
}

/// Does `worse` lose clearly more, row by row, than `better`?
fn clearly(better: &[f64], worse: &[f64]) -> bool {
    let count = better.len() as f64;
    let apart: Vec<f64> = worse.iter().zip(better).map(|(worse, better)| worse - better).collect();
    let mean = apart.iter().sum::<f64>() / count;
    let square = apart.iter().map(|apart| (apart - mean) * (apart - mean)).sum::<f64>();
    let error = libm::sqrt(square / f64::max(count - 1.0, 1.0) / count);
    mean > CLEAR * error
}

/// Sums of the errors of each problem.
fn together(all: impl Iterator<Item = Vec<f64>>) -> Vec<f64> {
    let add = |mut sums: Vec<f64>, more: Vec<f64>| {
        sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
        sums
    };
    all.reduce(add).unwrap_or_default()
}

/// The frames in a row, without a pause among them, that have most events, in grey, and the events of their
/// time; none where fewer than four lie so.
fn busiest(
    events: &EventStream,
    frames: &FrameSequence,
    late_ns: f64,
) -> Result<Option<(EventStream, FrameSequence)>, NodeError> {
    let (extent, height) = (events.meta.extent, frames.meta.extent.height);
    let mids: Vec<i64> = frames.meta.times.exposures.iter().map(|exposure| exposure.mid().0).collect();
    let mut counts = vec![0_u64; frames.len()];
    for band in extent.rows().bands(64) {
        let read = events.read(band)?;
        for y in band.iter() {
            for t in read.row(y).t {
                let after = mids.partition_point(|mid| *mid <= t - late_ns as i64);
                counts[usize::min(after, mids.len() - 1)] += 1;
            }
        }
    }
    let mut periods: Vec<i64> = mids.windows(2).map(|pair| pair[1] - pair[0]).collect();
    periods.sort_unstable();
    let pause = PAUSE.saturating_mul(periods.get(periods.len() / 2).copied().unwrap_or(0));
    // From each frame on as many as lie without a pause.
    let mut last = mids.len() - 1;
    let mut of_first: Vec<(u64, std::ops::Range<usize>)> = Vec::new();
    for first in (0..mids.len()).rev() {
        if mids.get(first + 1).is_some_and(|next| next - mids[first] > pause) {
            last = first;
        }
        let run = first..usize::min(last + 1, first + MOST_FRAMES);
        of_first.push((counts[first + 1..run.end.max(first + 1)].iter().sum(), run));
    }
    let long_enough = of_first.into_iter().filter(|(_, run)| run.len() >= FEWEST_FRAMES);
    let Some((_, run)) = long_enough.max_by_key(|(count, _)| *count) else { return Ok(None) };
    let frames = frames.select(run.collect());
    let span = frames.meta.times.span(height).unwrap_or(TimeSpan::new(0, 0));
    let late = TimeSpan::new(
        span.start.0.saturating_add(late_ns as i64),
        span.end.0.saturating_add(late_ns as i64).saturating_add(1),
    );
    let events = events.within(Arc::new(events.meta.within(late)), late);
    let grey = Grey::new(extent, &frames.meta, &Sensor::unknown("held out"))?;
    let frames = grey.frames(&frames, Clipped::Mean)?;
    Ok(Some((events, frames)))
}

/// Where pairs of thresholds are tried.
struct Bench<'a> {
    events: &'a EventStream,
    frames: &'a FrameSequence,
    values: FrameBlock,
    late_ns: f64,
    options: SolveOptions,
    /// Rows and their columns.
    places: Vec<(u32, Vec<usize>)>,
    /// What frames differ by without an event, DN.
    frame_dn: f64,
    /// Which frames are held out, one after the other.
    holds: Vec<HoldOut>,
    /// Frame values that are held out, all in all.
    held: usize,
}

impl Bench<'_> {
    fn new<'a>(
        events: &'a EventStream,
        frames: &'a FrameSequence,
        late_ns: f64,
    ) -> Result<Bench<'a>, NodeError> {
        let options =
            SolveOptions { front_end: FrontEndModel::Ideal, sigma: false, ..SolveOptions::default() };
        let values = frames.read_rows(frames.rows())?;
        let count = frames.len();
        let holds = if count < FEW_FRAMES {
            (1..count - 1).map(|first| HoldOut { every: count, first }).collect()
        } else {
            vec![HoldOut::USUAL]
        };
        let mut bench = Bench {
            events,
            frames,
            values,
            late_ns,
            options,
            places: Vec::new(),
            frame_dn: 0.0,
            holds,
            held: 0,
        };
        let rows = frames.meta.extent.rows();
        let mut unexplained = Unexplained::default();
        let places = bench.with_rows((0.25, 0.25), |data, _, take| {
            let mut places = Vec::new();
            for band in rows.bands(rows.len().div_ceil(ROWS as usize) as u32) {
                let mut busiest: (usize, u32, Vec<usize>) = (0, band.start, Vec::new());
                for row in band.iter() {
                    take(data, row)?;
                    let mut active: Vec<(usize, usize)> = (0..data.width())
                        .map(|x| (events_in_company(data, x), x))
                        .filter(|(count, x)| *count > 0 && data.frames_of(*x).len() >= FEWEST_FRAMES)
                        .collect();
                    (0..data.width()).for_each(|x| unexplained.add(data, x));
                    let all = active.iter().map(|(count, _)| count).sum();
                    if all > busiest.0 {
                        active.sort_unstable();
                        let taken = usize::min(active.len(), PIXELS);
                        let spread = |n: usize| active[(2 * n + 1) * active.len() / (2 * taken)].1;
                        busiest = (all, row, (0..taken).map(spread).collect());
                    }
                }
                if !busiest.2.is_empty() {
                    places.push((busiest.1, busiest.2));
                }
            }
            Ok(places)
        })?;
        bench.places = places;
        bench.frame_dn = unexplained.frame_dn();
        bench.held = bench.with_problems((0.25, 0.25), |problems, _, _| {
            let of = |hold: &HoldOut| problems.iter().map(|p| hold.held(p.frames).count()).sum::<usize>();
            bench.holds.iter().map(of).sum()
        })?;
        Ok(bench)
    }

    /// The description of a pair of thresholds.
    fn sensor(&self, (on, off): (f64, f64)) -> Sensor {
        let mut sensor = Sensor::unknown("held out");
        (sensor.comparator.threshold_on, sensor.comparator.threshold_off) = (Some(on), Some(off));
        sensor.readout.refractory = Some(Duration::new(100_000));
        let exposure_s = self.frames.meta.times.nominal_exposure_ns().unwrap_or(1) as f64 * 1e-9;
        sensor.frames.gain = Some(1.0 / exposure_s);
        sensor.frames.black_level_dn = Some(0.0);
        let offset = serde_json::json!({ "offset": Duration::new(self.late_ns as i64).to_string() });
        if let serde_json::Value::Object(offset) = offset {
            sensor.effects.insert("clock_offset".to_owned(), offset);
        }
        sensor
    }

    /// What `work` makes of the rows: it gets memory for one, the model, and how to take one in.
    fn with_rows<T>(
        &self,
        pair: (f64, f64),
        work: impl FnOnce(
            &mut RowData,
            &Model,
            &mut dyn FnMut(&mut RowData, u32) -> Result<(), NodeError>,
        ) -> Result<T, NodeError>,
    ) -> Result<T, NodeError> {
        let (sensor, rows) = (self.sensor(pair), self.frames.meta.extent.rows());
        let model = Model::of_map(&self.options, &sensor, &self.events.meta)?;
        let meta = self.options.tracks_meta(&self.events.meta, &self.frames.meta)?;
        let colours = Colours::new(CoLocated::new(&self.events.meta, &self.frames.meta)?, &sensor)?;
        let events = colours.lie.read(self.events, rows)?;
        let recorded = Recorded {
            meta: &meta,
            times: &self.frames.meta.times,
            colours: &colours,
            rows,
            events: &events,
            frames: &self.values,
        };
        let mut take = |data: &mut RowData, row: u32| data.take(&model, &recorded, row, 0.0);
        work(&mut RowData::default(), &model, &mut take)
    }

    /// What `work` makes of the problems of the places, in their order.
    fn with_problems<T>(
        &self,
        pair: (f64, f64),
        work: impl FnOnce(&[MapProblem<'_>], &MapOptions, &mut MapGroup) -> T,
    ) -> Result<T, NodeError> {
        let meta = self.options.tracks_meta(&self.events.meta, &self.frames.meta)?;
        let mut sample = Sample::new(&self.options, (meta.span.start.0, meta.span.end.0));
        self.with_rows(pair, |data, model, take| {
            for (row, columns) in &self.places {
                take(data, *row)?;
                columns.iter().for_each(|x| sample.push(data, *x));
            }
            sample.add_noise(self.frame_dn);
            let options = sample.options;
            let all = 0..sample.len();
            Ok(sample.with_problems(model, all, None, &mut MapGroup::default(), |problems, group| {
                work(problems, &options, group)
            }))
        })
    }

    /// What each row loses with a pair of thresholds, and the noise and prior that a solver then chooses.
    fn of(&self, pair: (f64, f64)) -> Result<Vec<f64>, NodeError> {
        let squares = self.with_problems(pair, |problems, options, group| {
            let choice = estimate::choose(problems, None, &Choosing::USUAL, options, group);
            let options = MapOptions { prior: choice.prior, ..*options };
            let problems: Vec<MapProblem<'_>> =
                problems.iter().map(|problem| MapProblem { noise: choice.noise, ..*problem }).collect();
            let of = |hold: &HoldOut| {
                let [_, squares] = estimate::prediction_errors_of(*hold, &problems, &options, group);
                squares
            };
            together(self.holds.iter().map(of))
        })?;
        Ok(self.by_row(&squares))
    }

    /// The same of a blend of the frames before and after.
    fn blend(&self) -> Result<Vec<f64>, NodeError> {
        let errors = self.with_problems((0.25, 0.25), |problems, _, _| {
            together(self.holds.iter().map(|hold| {
                let [_, squares] = estimate::blend_errors(*hold, problems);
                squares
            }))
        })?;
        Ok(self.by_row(&errors))
    }

    fn by_row(&self, errors: &[f64]) -> Vec<f64> {
        let mut rest = errors;
        let of = |(_, columns): &(u32, Vec<usize>)| {
            let (own, others) = rest.split_at(columns.len());
            rest = others;
            own.iter().sum()
        };
        self.places.iter().map(of).collect()
    }
}
