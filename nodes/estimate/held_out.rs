//! Contrast thresholds, exposure and offset of the clocks with which frames that are held out are predicted
//! best.
//!
//! What the change between two frames counts in events ([`photocurrent_sensor::estimate::thresholds`]) needs
//! many bright places that change one way between frames. Where there are few, thresholds come out anywhere.
//! So pixels all over the array are solved without some of their frames (one in three, or of a few frames
//! each that is not an end in turn), with one threshold after the other, and with the noise and prior that
//! the solver chooses for each: the one that predicts those frames best is what a solution needs. Lengths of
//! the exposure, where it is not recorded, and offsets, where none is known, are tried in the same way, and
//! taken where they are better by far than what was given. A blend of the neighbouring frames is compared on
//! the same frames: where that is better, a picture gains nothing from events.
//!
//! An offset that correlation states stands: frames that are held out are blurred, and those of a disc that
//! moves one way preferred an offset of a millisecond to the right one, which gave sharp pictures of 37.2
//! instead of 39.8 dB (`a_first_stamp_that_is_missing_is_found_by_the_events_in_a_folder_too` with an offset
//! that is always tried).
//!
//! Limits: both signs have the same threshold, as frames do not show which of the two is off (a pixel that
//! darkens is slower); an ideal front end, so that what a slow pixel leaves out of its events is in the
//! thresholds, and its delay in the offset; one after the other on grids, each refined once; intervals are
//! those of the values that are not clearly worse.

mod bench;

use super::Estimate;
use bench::{Bench, Described};
use photocurrent_core::{EventStream, FrameSequence, NodeError};
use rayon::prelude::*;

pub(crate) use bench::run;

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
/// Offsets that are tried around what was given, in periods.
const OFFSETS: [f64; 6] = [-0.25, -0.12, -0.05, 0.05, 0.12, 0.25];
/// And around the best of those.
const CLOSER: [f64; 2] = [-0.03, 0.03];
/// The interval reaches at least by this factor beyond what is best: rows of one recording err together.
const APART: f64 = 1.3;
/// An exposure, an offset or a shift of places is taken where it leaves less than this part of the squares of
/// errors. Standard errors alone moved the places of a clip whose events and frames have the same pixels
/// (`tests/two_cameras.rs`, traffic); what is off by a pixel, or by 4 ms, passes (there, and
/// `frames_that_are_held_out_choose_offset_and_exposure`).
const FAR_BETTER: f64 = 0.8;
/// One description is clearly worse than another by so many standard errors.
const CLEAR: f64 = 2.0;

/// What is known before.
#[derive(Clone, Copy, Debug, Default)]
pub struct Given {
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
    /// The same with the thresholds that were given.
    pub given: Option<f64>,
    /// The same of a blend of the frames before and after, and whether that is clearly better.
    pub blend: (f64, bool),
    /// Length of the exposure, ns, where it is better by far than that of the frames.
    pub exposure_ns: Option<Estimate>,
    /// How late events are, ns, where none was given and it is better by far than 0.
    pub late_ns: Option<Estimate>,
}

/// A description, and what each row loses with it.
#[derive(Clone, Debug)]
struct Tried {
    described: Described,
    of_rows: Vec<f64>,
}

impl Tried {
    fn sum(&self) -> f64 {
        self.of_rows.iter().sum()
    }
}

/// What was tried, all of it.
struct Search<'a> {
    bench: &'a Bench,
    all: Vec<Tried>,
}

impl Search<'_> {
    /// Tries descriptions, and gives the best of them and of `best`.
    fn best(&mut self, best: Option<Tried>, all: Vec<Described>) -> Result<Tried, NodeError> {
        let of = |described: Described| Ok(Tried { of_rows: self.bench.losses(&described)?, described });
        let tried: Vec<Tried> = all.into_par_iter().map(of).collect::<Result<_, NodeError>>()?;
        let first = best.unwrap_or_else(|| tried[0].clone());
        let best =
            tried.iter().fold(first, |best, one| if one.sum() < best.sum() { one.clone() } else { best });
        self.all.extend(tried);
        Ok(best)
    }

    /// The best threshold of both signs for what else is described.
    fn threshold(&mut self, described: Described) -> Result<Tried, NodeError> {
        let both = |both: f64| Described { pair: (both, both), ..described };
        let coarse = (0..TRIED).map(|n| both(FIRST * libm::pow(STEP, f64::from(n)))).collect();
        let best = self.best(None, coarse)?;
        self.refined(best)
    }

    fn refined(&mut self, best: Tried) -> Result<Tried, NodeError> {
        let around = REFINED.iter().map(|by| scaled(&best.described, *by)).collect();
        self.best(Some(best), around)
    }

    /// Takes another length of the exposure where it is better by far.
    fn length(&mut self, best: &mut Tried) -> Result<bool, NodeError> {
        let period_ns = self.bench.period_ns();
        let length = |share: &f64| Some((share * period_ns) as i64);
        let near = |length_ns| NEAR.map(|by| Described { length_ns, ..scaled(&best.described, by) });
        let longer = self.best(Some(best.clone()), LENGTHS.iter().map(length).flat_map(near).collect())?;
        Ok(taken(best, longer))
    }

    /// Takes another offset where it is better by far.
    fn offset(&mut self, best: &mut Tried) -> Result<bool, NodeError> {
        let period_ns = self.bench.period_ns();
        let at =
            |late_ns: f64, from: &Tried| NEAR.map(|by| Described { late_ns, ..scaled(&from.described, by) });
        let around = |from: &Tried, all: &[f64]| -> Vec<Described> {
            all.iter().flat_map(|by| at(from.described.late_ns + by * period_ns, from)).collect()
        };
        let late = self.best(Some(best.clone()), around(best, &OFFSETS))?;
        let closer = around(&late, &CLOSER);
        let late = self.best(Some(late), closer)?;
        Ok(taken(best, late))
    }

    /// The range of what is not clearly worse than the best, of a number of each description.
    fn interval(&self, best: &Tried, of: impl Fn(&Described) -> f64) -> (f64, f64) {
        let close = self.all.iter().filter(|one| !clearly(&best.of_rows, &one.of_rows));
        let value = of(&best.described);
        close
            .map(|one| of(&one.described))
            .fold((value, value), |(low, high), one| (low.min(one), high.max(one)))
    }
}

/// Takes what is better by far.
fn taken(best: &mut Tried, other: Tried) -> bool {
    let is_better = is_better_by_far(&other.of_rows, &best.of_rows);
    if is_better {
        *best = other;
    }
    is_better
}

/// Does `better` lose less than [`FAR_BETTER`] of what `worse` loses, row by row, and clearly so?
pub(crate) fn is_better_by_far(better: &[f64], worse: &[f64]) -> bool {
    better.iter().sum::<f64>() < FAR_BETTER * worse.iter().sum::<f64>() && clearly(better, worse)
}

fn scaled(described: &Described, by: f64) -> Described {
    let (on, off) = described.pair;
    Described { pair: (by * on, by * off), ..*described }
}

/// What predicts frames that are held out best. None where too little moves, or there are fewer than four
/// frames.
///
/// # Errors
/// When a stream cannot be read, or frames are no whole multiple of the events' pixels.
pub fn chosen(
    events: &EventStream,
    frames: &FrameSequence,
    given: &Given,
) -> Result<Option<HeldOut>, NodeError> {
    let anchor = given.anchor.unwrap_or(0.5);
    let late_ns = given.late_ns.unwrap_or(0.0);
    let Some(bench) = Bench::new(events, frames, late_ns, anchor)? else { return Ok(None) };
    let start = Described { pair: (FIRST, FIRST), late_ns, length_ns: given.length_ns };
    let mut search = Search { bench: &bench, all: Vec::new() };
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
    let pair = |pair| Described { pair, ..best.described };
    let compared = given.thresholds.map(|thresholds| bench.losses(&pair(thresholds))).transpose()?;
    let root = |squares: f64| libm::sqrt(squares / bench.held as f64);
    let blend = bench.blend(&start)?;
    let (low, high) = search.interval(&best, |described| described.pair.0);
    let both = best.described.pair.0;
    let exposure = |described: &Described| described.length_ns.map(|length_ns| length_ns as f64);
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
        blend: (root(blend.iter().sum()), clearly(&blend, &best.of_rows)),
        exposure_ns,
        late_ns,
    }))
}

/// What each row of pixels loses with frames of each of several sequences, with the threshold that predicts
/// the held-out ones of that sequence best; `late_ns` as for [`chosen`]. None where too little moves.
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
        let Some(mut bench) = Bench::new(events, frames, late_ns, 0.5)? else { return Ok(None) };
        // The same pixels of each sequence.
        bench.places = places.get_or_insert(bench.places).clone();
        let start = Described { pair: (FIRST, FIRST), late_ns, length_ns: None };
        all.push(Search { bench: &bench, all: Vec::new() }.threshold(start)?.of_rows);
    }
    Ok(Some(all))
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
