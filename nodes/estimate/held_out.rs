//! Estimates contrast thresholds, exposure and clock offset that predict held-out frames best.
//!
//! The direct estimate ([`photocurrent_sensor::estimate::thresholds`]) divides the change between frames by
//! the events in it. It needs many bright places whose light changes in one direction between frames, and
//! fails with few. Here pixels of the whole array are solved without some of their frames: one in three, or
//! of a few frames each inner one in turn. Each threshold is tried with the noise and prior that the solver
//! chooses for it, and the one with the least error on the held-out frames is selected. Unknown lengths of
//! the exposure and unknown offsets are tried in the same way, and used where they are better by far than the
//! known values. A blend of the neighbouring frames is compared on the same frames: where that is better, a
//! picture gains nothing from events.
//!
//! A known offset from correlation is kept. Held-out frames are blurred, and those of a disc that moves in
//! one direction preferred an offset of a millisecond to the right one, which gave sharp pictures of 37.2
//! instead of 39.8 dB (`a_first_stamp_that_is_missing_is_found_by_the_events_in_a_folder_too` with an offset
//! that is always tried).
//!
//! Limits: both signs have the same threshold, as frames do not show which of the two is off (a pixel that
//! darkens is slower). An ideal front end is assumed, so that a slow pixel's missing events are absorbed by
//! the thresholds, and its delay by the offset. Parameters are searched one after the other on grids, each
//! refined once. Intervals include the values that are not clearly worse.

mod bench;

use super::Estimate;
use bench::{CandidateDescription, HeldOutBench};
use photocurrent_core::{EventStream, FrameSequence, NodeError};
use rayon::prelude::*;

pub(crate) use bench::busiest_frames;

/// The thresholds that are tried first, alike for both signs, natural-log units: each 1.3 times the last.
const FIRST: f64 = 0.06;
const STEP: f64 = 1.3;
const TRIED: i32 = 12;
/// Steps around the best of those.
const REFINED: [f64; 4] = [0.82, 0.91, 1.1, 1.21];
/// With other exposures and offsets thresholds change by about so much.
const NEAR: [f64; 3] = [0.8, 1.0, 1.25];
/// Lengths of the exposure that are tried, in periods.
const LENGTHS: [f64; 6] = [0.03, 0.1, 0.25, 0.45, 0.7, 0.97];
/// Offsets that are tried around the known one, in periods.
const OFFSETS: [f64; 6] = [-0.25, -0.12, -0.05, 0.05, 0.12, 0.25];
/// And around the best of those.
const CLOSER: [f64; 2] = [-0.03, 0.03];
/// Least factor by which an interval reaches beyond the best value: rows of one recording have common errors.
const APART: f64 = 1.3;
/// Largest share of the squared errors that an accepted exposure, offset or shift of places leaves. Standard
/// errors alone moved the places of a clip whose events and frames have the same pixels
/// (`tests/two_cameras.rs`, traffic). Errors of a pixel, or of 4 ms, are corrected (there, and
/// `frames_that_are_held_out_choose_offset_and_exposure`).
const FAR_BETTER: f64 = 0.8;
/// Standard errors from which on one description is clearly worse than another.
const CLEAR: f64 = 2.0;

/// Known values.
#[derive(Clone, Copy, Debug, Default)]
pub struct KnownTimes {
    /// How late events are against frames, ns; none = not known, and tried.
    pub late_ns: Option<f64>,
    /// The pair of thresholds that is compared.
    pub thresholds: Option<(f64, f64)>,
    /// Where the exposure is not recorded: the instant of it that stays when its length changes, 0 its start,
    /// 1 its end.
    pub anchor: Option<f64>,
    /// The length that is compared then, ns; none = that of the frames.
    pub length_ns: Option<i64>,
}

/// Thresholds, exposure and offset, and how well frames that are held out are predicted with them.
#[derive(Clone, Debug)]
pub struct HeldOut {
    /// The threshold of both signs, natural-log units.
    pub threshold: Estimate,
    /// Root mean square of the relative error of a frame value with them, each at most 1.
    pub error: f64,
    /// The same with the known thresholds.
    pub given: Option<f64>,
    /// The same of a blend of the frames before and after, and whether that is clearly better.
    pub blend: (f64, bool),
    /// Length of the exposure, ns, where it is better by far than that of the frames.
    pub exposure_ns: Option<Estimate>,
    /// Delay of the events, ns, where none was known and it is better by far than 0.
    pub late_ns: Option<Estimate>,
}

/// A description and its loss in each row.
#[derive(Clone, Debug)]
struct EvaluatedDescription {
    described: CandidateDescription,
    of_rows: Vec<f64>,
}

impl EvaluatedDescription {
    fn sum(&self) -> f64 {
        self.of_rows.iter().sum()
    }
}

/// All descriptions that were evaluated.
struct DescriptionSearch<'a> {
    bench: &'a HeldOutBench,
    all: Vec<EvaluatedDescription>,
}

impl DescriptionSearch<'_> {
    /// Evaluates descriptions; returns the best of them and of `best`.
    fn best(
        &mut self,
        best: Option<EvaluatedDescription>,
        all: Vec<CandidateDescription>,
    ) -> Result<EvaluatedDescription, NodeError> {
        let of = |described: CandidateDescription| {
            Ok(EvaluatedDescription { of_rows: self.bench.losses(&described)?, described })
        };
        let tried: Vec<EvaluatedDescription> =
            all.into_par_iter().map(of).collect::<Result<_, NodeError>>()?;
        let first = best.unwrap_or_else(|| tried[0].clone());
        let best =
            tried.iter().fold(first, |best, one| if one.sum() < best.sum() { one.clone() } else { best });
        self.all.extend(tried);
        Ok(best)
    }

    /// The best threshold of both signs for an otherwise fixed description.
    fn threshold(&mut self, described: CandidateDescription) -> Result<EvaluatedDescription, NodeError> {
        let both = |both: f64| CandidateDescription { pair: (both, both), ..described };
        let coarse = (0..TRIED).map(|n| both(FIRST * libm::pow(STEP, f64::from(n)))).collect();
        let best = self.best(None, coarse)?;
        self.refined(best)
    }

    fn refined(&mut self, best: EvaluatedDescription) -> Result<EvaluatedDescription, NodeError> {
        let around = REFINED.iter().map(|by| scaled(&best.described, *by)).collect();
        self.best(Some(best), around)
    }

    /// Takes another length of the exposure where it is better by far.
    fn length(&mut self, best: &mut EvaluatedDescription) -> Result<bool, NodeError> {
        let period_ns = self.bench.period_ns();
        let length = |share: &f64| Some((share * period_ns) as i64);
        let near =
            |length_ns| NEAR.map(|by| CandidateDescription { length_ns, ..scaled(&best.described, by) });
        let longer = self.best(Some(best.clone()), LENGTHS.iter().map(length).flat_map(near).collect())?;
        Ok(accept_if_better(best, longer))
    }

    /// Takes another offset where it is better by far.
    fn offset(&mut self, best: &mut EvaluatedDescription) -> Result<bool, NodeError> {
        let period_ns = self.bench.period_ns();
        let at = |late_ns: f64, from: &EvaluatedDescription| {
            NEAR.map(|by| CandidateDescription { late_ns, ..scaled(&from.described, by) })
        };
        let around = |from: &EvaluatedDescription, all: &[f64]| -> Vec<CandidateDescription> {
            all.iter().flat_map(|by| at(from.described.late_ns + by * period_ns, from)).collect()
        };
        let late = self.best(Some(best.clone()), around(best, &OFFSETS))?;
        let closer = around(&late, &CLOSER);
        let late = self.best(Some(late), closer)?;
        Ok(accept_if_better(best, late))
    }

    /// The range of the values `of` of descriptions that are not clearly worse than the best.
    fn interval(&self, best: &EvaluatedDescription, of: impl Fn(&CandidateDescription) -> f64) -> (f64, f64) {
        let close = self.all.iter().filter(|one| !loses_significantly(&best.of_rows, &one.of_rows));
        let value = of(&best.described);
        close
            .map(|one| of(&one.described))
            .fold((value, value), |(low, high), one| (low.min(one), high.max(one)))
    }
}

/// Replaces the best description by another where that is better by far.
fn accept_if_better(best: &mut EvaluatedDescription, other: EvaluatedDescription) -> bool {
    let is_better = is_better_by_far(&other.of_rows, &best.of_rows);
    if is_better {
        *best = other;
    }
    is_better
}

/// Is the loss of `better` below [`FAR_BETTER`] of that of `worse`, and significantly so by rows?
pub(crate) fn is_better_by_far(better: &[f64], worse: &[f64]) -> bool {
    better.iter().sum::<f64>() < FAR_BETTER * worse.iter().sum::<f64>() && loses_significantly(better, worse)
}

fn scaled(described: &CandidateDescription, by: f64) -> CandidateDescription {
    let (on, off) = described.pair;
    CandidateDescription { pair: (by * on, by * off), ..*described }
}

/// The values that predict held-out frames best; `None` where too little moves, or there are fewer than four
/// frames.
///
/// # Errors
/// When a stream cannot be read, or frames are no whole multiple of the events' pixels.
pub fn chosen(
    events: &EventStream,
    frames: &FrameSequence,
    given: &KnownTimes,
) -> Result<Option<HeldOut>, NodeError> {
    let anchor = given.anchor.unwrap_or(0.5);
    let late_ns = given.late_ns.unwrap_or(0.0);
    let Some(bench) = HeldOutBench::new(events, frames, late_ns, anchor)? else { return Ok(None) };
    let start = CandidateDescription { pair: (FIRST, FIRST), late_ns, length_ns: given.length_ns };
    let mut search = DescriptionSearch { bench: &bench, all: Vec::new() };
    let first = search.threshold(start)?;
    let mut best = first.clone();
    // With a wrong offset no length is right.
    let length = given.anchor.is_some();
    let is_longer = length && search.length(&mut best)?;
    let is_shifted = given.late_ns.is_none() && search.offset(&mut best)?;
    if length && is_shifted {
        search.length(&mut best)?;
    }
    if is_longer || is_shifted {
        best = search.refined(best)?;
    }
    let pair = |pair| CandidateDescription { pair, ..best.described };
    let compared = given.thresholds.map(|thresholds| bench.losses(&pair(thresholds))).transpose()?;
    let root = |squares: f64| libm::sqrt(squares / bench.held as f64);
    let blend = bench.blend(&start)?;
    let (low, high) = search.interval(&best, |described| described.pair.0);
    let both = best.described.pair.0;
    let exposure = |described: &CandidateDescription| described.length_ns.map(|length_ns| length_ns as f64);
    let is_longer = best.described.length_ns != given.length_ns;
    let exposure_ns = exposure(&best.described).filter(|_| is_longer).map(|value| {
        let ci95 = search.interval(&best, |described| exposure(described).unwrap_or(value));
        Estimate { value, ci95 }
    });
    let late_ns = (best.described.late_ns != late_ns).then(|| Estimate {
        value: best.described.late_ns,
        ci95: search.interval(&best, |described| described.late_ns),
    });
    Ok(Some(HeldOut {
        threshold: Estimate { value: both, ci95: (low.min(both / APART), high.max(both * APART)) },
        error: root(best.sum()),
        given: compared.map(|of_rows| root(of_rows.iter().sum())),
        blend: (root(blend.iter().sum()), loses_significantly(&blend, &best.of_rows)),
        exposure_ns,
        late_ns,
    }))
}

/// Loss of each row of pixels with each of several sequences of frames, each with the threshold that predicts
/// its held-out frames best; `late_ns` as for [`chosen`]. `None` where too little moves.
///
/// # Errors
/// When a stream cannot be read, or frames are no whole multiple of the events' pixels.
pub(crate) fn compared(
    events: &EventStream,
    sequences: &[FrameSequence],
    late_ns: f64,
) -> Result<Option<Vec<Vec<f64>>>, NodeError> {
    let mut all = Vec::new();
    let mut places: Option<Vec<(u32, Vec<usize>)>> = None;
    for frames in sequences {
        let Some(mut bench) = HeldOutBench::new(events, frames, late_ns, 0.5)? else { return Ok(None) };
        // The same pixels of each sequence.
        bench.places = places.get_or_insert(bench.places).clone();
        let start = CandidateDescription { pair: (FIRST, FIRST), late_ns, length_ns: None };
        all.push(DescriptionSearch { bench: &bench, all: Vec::new() }.threshold(start)?.of_rows);
    }
    Ok(Some(all))
}

/// Is the loss of `worse` significantly larger, row by row, than that of `better`?
fn loses_significantly(better: &[f64], worse: &[f64]) -> bool {
    let count = better.len() as f64;
    let apart: Vec<f64> = worse.iter().zip(better).map(|(worse, better)| worse - better).collect();
    let mean = apart.iter().sum::<f64>() / count;
    let square = apart.iter().map(|apart| (apart - mean) * (apart - mean)).sum::<f64>();
    let error = libm::sqrt(square / f64::max(count - 1.0, 1.0) / count);
    mean > CLEAR * error
}
