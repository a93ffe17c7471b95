//! The pixels of a recording on which descriptions are evaluated: solved without some of their frames, which
//! are predicted.

use photocurrent_core::quantity::Duration;
use photocurrent_core::{
    EventStream, Exposure, FrameBlock, FrameSequence, FrameTimes, FramesMeta, NodeError, Sensor, TimeSpan,
};
use photocurrent_scene::grey::{GreyFrames, SaturatedMean};
use photocurrent_sensor::map::estimate::{self, Choosing, FEWEST_FRAMES, HoldOut};
use photocurrent_sensor::map::{MapGroup, MapOptions, MapProblem};
use photocurrent_solve::co_located::CoLocated;
use photocurrent_solve::row::{Recorded, RowData};
use photocurrent_solve::settings::{Sample, Unexplained, events_in_company};
use photocurrent_solve::shares::Colours;
use photocurrent_solve::{FrontEndModel, Model, SolveOptions};
use std::ops::Range;
use std::sync::Arc;

/// Most frames that are evaluated: consecutive ones with the most events.
const MOST_FRAMES: usize = 25;
/// Frames that are further apart, in usual periods, have a pause between them.
const PAUSE: i64 = 4;
/// Of fewer frames each is held out in turn.
const FEW_FRAMES: usize = 10;
/// Rows that take part, each the busiest of as many bands, and pixels of each.
const ROWS: u32 = 24;
const PIXELS: usize = 16;
/// Least number of pixels.
const FEWEST_PIXELS: usize = 48;

/// A candidate for a sensor's thresholds and clocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CandidateDescription {
    /// Thresholds of ON and OFF, natural-log units.
    pub(super) pair: (f64, f64),
    /// How late events are, ns.
    pub(super) late_ns: f64,
    /// Length of the exposures, ns; none = as the frames state.
    pub(super) length_ns: Option<i64>,
}

/// Pixels of a recording that are solved without some of their frames.
pub(super) struct HeldOutBench {
    events: EventStream,
    frames: FrameSequence,
    values: FrameBlock,
    /// The instant of an exposure that stays when its length changes: 0 its start, 1 its end.
    anchor: f64,
    options: SolveOptions,
    /// Rows and their columns.
    pub(super) places: Vec<(u32, Vec<usize>)>,
    /// Difference of frames without an event, DN.
    frame_dn: f64,
    /// Which frames are held out, one after the other.
    holds: Vec<HoldOut>,
    /// Frame values that are held out, all in all.
    pub(super) held: usize,
}

impl HeldOutBench {
    /// Of the busiest frames of a recording; none where fewer than four lie in a row, or too few pixels have
    /// events. `late_ns` is about how late these are.
    ///
    /// # Errors
    /// When a stream cannot be read, or frames are no whole multiple of the events' pixels.
    pub(super) fn new(
        events: &EventStream,
        frames: &FrameSequence,
        late_ns: f64,
        anchor: f64,
    ) -> Result<Option<HeldOutBench>, NodeError> {
        let Some((events, frames)) = busiest_run(events, frames, late_ns)? else { return Ok(None) };
        let options =
            SolveOptions { front_end: FrontEndModel::Ideal, sigma: false, ..SolveOptions::default() };
        let values = frames.read_rows(frames.rows())?;
        let count = frames.len();
        let holds = if count < FEW_FRAMES {
            (1..count - 1).map(|first| HoldOut { every: count, first }).collect()
        } else {
            vec![HoldOut::USUAL]
        };
        let rows = frames.meta.extent.rows();
        let mut bench = HeldOutBench {
            events,
            frames,
            values,
            anchor,
            options,
            places: Vec::new(),
            frame_dn: 0.0,
            holds,
            held: 0,
        };
        let any = CandidateDescription { pair: (0.25, 0.25), late_ns, length_ns: None };
        let mut unexplained = Unexplained::default();
        let places = bench.with_rows(&any, |data, _, take| {
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
        bench.held = bench.with_problems(&any, |problems, _, _| {
            let of = |hold: &HoldOut| problems.iter().map(|p| hold.held(p.frames).count()).sum::<usize>();
            bench.holds.iter().map(of).sum()
        })?;
        Ok((bench.pixels() >= FEWEST_PIXELS).then_some(bench))
    }

    /// How many pixels take part.
    fn pixels(&self) -> usize {
        self.places.iter().map(|(_, columns)| columns.len()).sum()
    }

    /// The usual time from a frame to the next, ns.
    pub(super) fn period_ns(&self) -> f64 {
        self.frames.meta.times.mean_period_ns().unwrap_or(1.0)
    }

    /// The frames as they are exposed by a description.
    fn meta(&self, described: &CandidateDescription) -> Arc<FramesMeta> {
        let Some(length_ns) = described.length_ns else { return self.frames.meta.clone() };
        let times = &self.frames.meta.times;
        let of = |exposure: &Exposure| {
            let (start, end) = (exposure.start.0, exposure.end.0);
            let kept = start + (self.anchor * (end - start) as f64) as i64;
            let start = kept - (self.anchor * length_ns as f64) as i64;
            Exposure::new(start, start + length_ns)
        };
        let exposures: Vec<Exposure> = times.exposures.iter().map(of).collect();
        let times = FrameTimes { exposures: exposures.into(), row_time_ns: times.row_time_ns };
        Arc::new(FramesMeta { times, ..(*self.frames.meta).clone() })
    }

    fn sensor(&self, described: &CandidateDescription, meta: &FramesMeta) -> Sensor {
        let (on, off) = described.pair;
        let mut sensor = Sensor::unknown("held out");
        (sensor.comparator.threshold_on, sensor.comparator.threshold_off) = (Some(on), Some(off));
        sensor.readout.refractory = Some(Duration::new(100_000));
        let exposure_s = meta.times.nominal_exposure_ns().unwrap_or(1) as f64 * 1e-9;
        sensor.frames.gain = Some(1.0 / exposure_s);
        sensor.frames.black_level_dn = Some(0.0);
        let offset = serde_json::json!({ "offset": Duration::new(described.late_ns as i64).to_string() });
        if let serde_json::Value::Object(offset) = offset {
            sensor.effects.insert("clock_offset".to_owned(), offset);
        }
        sensor
    }

    /// Results of `work` on the rows. It receives memory for one row, the model, and a function that loads a
    /// row.
    fn with_rows<T>(
        &self,
        described: &CandidateDescription,
        work: impl FnOnce(
            &mut RowData,
            &Model,
            &mut dyn FnMut(&mut RowData, u32) -> Result<(), NodeError>,
        ) -> Result<T, NodeError>,
    ) -> Result<T, NodeError> {
        let frames = self.meta(described);
        let (sensor, rows) = (self.sensor(described, &frames), frames.extent.rows());
        let model = Model::of_map(&self.options, &sensor, &self.events.meta)?;
        let meta = self.options.tracks_meta(&self.events.meta, &frames)?;
        let colours = Colours::new(CoLocated::new(&self.events.meta, &frames)?, &sensor)?;
        let events = colours.lie.read(&self.events, rows)?;
        let recorded = Recorded {
            meta: &meta,
            times: &frames.times,
            colours: &colours,
            rows,
            events: &events,
            frames: &self.values,
        };
        let mut take = |data: &mut RowData, row: u32| data.take(&model, &recorded, row, 0.0);
        work(&mut RowData::default(), &model, &mut take)
    }

    /// Results of `work` on the problems of the places, in their order.
    fn with_problems<T>(
        &self,
        described: &CandidateDescription,
        work: impl FnOnce(&[MapProblem<'_>], &MapOptions, &mut MapGroup) -> T,
    ) -> Result<T, NodeError> {
        let meta = self.options.tracks_meta(&self.events.meta, &self.meta(described))?;
        let mut sample = Sample::new(&self.options, (meta.span.start.0, meta.span.end.0));
        self.with_rows(described, |data, model, take| {
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

    /// Loss of each row with a description, and with the noise and prior that a solver then chooses: squared
    /// relative errors, by which pictures are scored. Absolute values prefer too large thresholds, with which
    /// few pixels have large errors.
    pub(super) fn losses(&self, described: &CandidateDescription) -> Result<Vec<f64>, NodeError> {
        let squares = self.with_problems(described, |problems, options, group| {
            let choice = estimate::choose(problems, None, &Choosing::USUAL, options, group);
            let options = MapOptions { prior: choice.prior, second: choice.second, ..*options };
            let problems: Vec<MapProblem<'_>> =
                problems.iter().map(|problem| MapProblem { noise: choice.noise, ..*problem }).collect();
            let of = |hold: &HoldOut| {
                let [_, squares] = estimate::prediction_errors_of(*hold, &problems, &options, group);
                squares
            };
            summed_errors(self.holds.iter().map(of))
        })?;
        Ok(self.by_row(&squares))
    }

    /// The same of a blend of the frames before and after.
    pub(super) fn blend(&self, described: &CandidateDescription) -> Result<Vec<f64>, NodeError> {
        let errors = self.with_problems(described, |problems, _, _| {
            summed_errors(self.holds.iter().map(|hold| {
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

/// The frames in a row, without a pause among them, that have most events, in grey, and the events of their
/// time; none where fewer than four lie so.
fn busiest_run(
    events: &EventStream,
    frames: &FrameSequence,
    late_ns: f64,
) -> Result<Option<(EventStream, FrameSequence)>, NodeError> {
    let (extent, height) = (events.meta.extent, frames.meta.extent.height);
    let Some(run) = busiest_frames(events, &frames.meta.times, late_ns)? else { return Ok(None) };
    let frames = frames.select(run.collect());
    let span = frames.meta.times.span(height).unwrap_or(TimeSpan::new(0, 0));
    let late = TimeSpan::new(
        span.start.0.saturating_add(late_ns as i64),
        span.end.0.saturating_add(late_ns as i64).saturating_add(1),
    );
    let events = events.within(Arc::new(events.meta.within(late)), late);
    let grey = GreyFrames::new(extent, &frames.meta, &Sensor::unknown("held out"))?;
    let frames = grey.frames(&frames, SaturatedMean::Mean)?;
    Ok(Some((events, frames)))
}

/// Consecutive frames without a pause that have most events; `None` where there are fewer than four.
///
/// # Errors
/// When events cannot be read.
pub(crate) fn busiest_frames(
    events: &EventStream,
    times: &FrameTimes,
    late_ns: f64,
) -> Result<Option<Range<usize>>, NodeError> {
    let extent = events.meta.extent;
    let mids: Vec<i64> = times.exposures.iter().map(|exposure| exposure.mid().0).collect();
    let mut counts = vec![0_u64; mids.len()];
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
    let mut of_first: Vec<(u64, Range<usize>)> = Vec::new();
    for first in (0..mids.len()).rev() {
        if mids.get(first + 1).is_some_and(|next| next - mids[first] > pause) {
            last = first;
        }
        let run = first..usize::min(last + 1, first + MOST_FRAMES);
        of_first.push((counts[first + 1..run.end.max(first + 1)].iter().sum(), run));
    }
    let long_enough = of_first.into_iter().filter(|(_, run)| run.len() >= FEWEST_FRAMES);
    Ok(long_enough.max_by_key(|(count, _)| *count).map(|(_, run)| run))
}

/// Sums of the errors of each problem.
fn summed_errors(all: impl Iterator<Item = Vec<f64>>) -> Vec<f64> {
    let add = |mut sums: Vec<f64>, more: Vec<f64>| {
        sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
        sums
    };
    all.reduce(add).unwrap_or_default()
}
