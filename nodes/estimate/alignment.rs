//! `estimate/alignment`: estimates the error of an alignment of two cameras, and corrects it.
//!
//! The events of an event pixel between two frames measure the change of the frames at its place. The shift
//! at which both agree best is estimated to a fraction of a pixel, constant or affine over the array,
//! together with the delay of the events ([`photocurrent_scene::misalignment`]). Pixels are then solved
//! without some of their frames at the shifted places. The shift is applied where it predicts these frames
//! better by far, and left out otherwise. Events and frames are returned on the event array, as by
//! `align/recording`, which this node replaces: warped events lie where the given alignment placed them, and
//! only the frames' values of each event pixel come from the corrected place.
//!
//! Limits: shifts of up to three pixels. A scene that moves in one direction leaves the shift along the
//! motion open, as late events look the same (the interval is then wide). Intervals are those of draws,
//! without the effect of a slow front end on the counts: those of two clips of a DAVIS346, whose events and
//! frames have the same pixels, are off 0 by 0.04 to 0.09 pixels (`-0.09 to -0.04`, `0.06 to 0.50`), and
//! nothing is applied. Frames of a global shutter; a mosaic goes through `render/demosaic` first; at least
//! four frames, or nothing is applied.

use super::{TableRow, held_out, table};
use crate::align::recording::{Pixels, frames_on_array, on_array, plan_of};
use photocurrent_core::quantity::Duration;
use photocurrent_core::table::TableMeta;
use photocurrent_core::{
    Context, Decl, EventBand, EventStream, EventsMeta, Extent, FrameSequence, FramesMeta, Grain, MapSet,
    Meta, Node, NodeError, PortMetas, Sensor, Table,
};
use photocurrent_scene::alignment::Alignment;
use photocurrent_scene::grey::{GreyFrames, SaturatedMean};
use photocurrent_scene::image::{Image, smooth};
use photocurrent_scene::misalignment::{ChangesAndEvents, Misalignment, PARTS, ShiftForm, ShiftSample};
use photocurrent_solve::pixel_events::clock_offset;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `estimate/alignment`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Pairs of neighbouring frames that are compared, at most: those with most events.
    #[schemars(range(min = 4, max = 512))]
    pub pairs: usize,
    /// How late events are against frames, as a start; absent = the best of half a period to either side.
    pub offset: Option<Duration>,
}

impl Default for Params {
    fn default() -> Params {
        Params { pairs: 24, offset: None }
    }
}

photocurrent_core::ports! {
    /// The recording.
    pub struct In {
        /// Events on the event array's own pixels, or on those of the frames.
        events: EventStream,
        /// Captured frames, grey or of three channels.
        frames: FrameSequence,
        /// The alignment so far: of `read/alignment`. Absent = pixel on pixel, or a whole number of frame
        /// pixels on each.
        alignment: Option<MapSet>,
        /// The description: black level, saturation and the weights of colours are used where they are
        /// stated.
        sensor: Option<Arc<Sensor>>,
    }
}

photocurrent_core::ports! {
    /// The results.
    pub struct Out {
        /// The alignment with the shift where that is better; the input alignment otherwise.
        alignment: MapSet,
        /// The events on the event array's own pixels, each once.
        events: EventStream,
        /// The frames as these see them by that alignment.
        frames: FrameSequence,
        /// `shift_x` and `shift_y`, pixels of the frames, in the middle of the array.
        estimates: Arc<Table>,
    }
}

/// Both pictures are smoothed by this before they are compared, pixels.
const SMOOTH: f64 = 1.2;
/// Darkest value that is used, as a share of a bright one; darker ones count as this.
const DARK: f32 = 0.01;
/// Share of the largest value from which a frame value may be saturated, where no level is stated.
const SATURATED: f32 = 0.995;
/// Samples, at most, and of a search.
const SAMPLES: usize = 240_000;
const COARSE: usize = 40_000;
/// Least share of pixels, one in this many, that change between two frames.
const FEW_CHANGE: usize = 8;
/// Less than this many events, and less change than this, is no change.
const FEWEST_EVENTS: f32 = 0.25;
const LEAST_CHANGE: f32 = 0.05;
/// Light counts as dim by at most this factor.
const DIMMEST: f32 = 8.0;
/// Frames further apart, in usual periods, are no neighbours.
const PAUSE: i64 = 4;
/// The rate of events is taken over this part of a period to either side.
const RATE: f64 = 1.0 / 16.0;
/// How late events may be, in steps of an eighth of a period to either side.
const LATE: i32 = 4;

/// The node.
pub struct EstimateAlignment {
    params: Params,
}

/// Each event pixel in the middle of the frame pixels that lie on it.
fn by_pixels(events: Extent, frames: Extent) -> Result<Alignment, NodeError> {
    let ratio = frames.multiple_of(events).ok_or_else(|| {
        NodeError::usage(format!("frames of {frames} pixels are no whole multiple of the events' {events}"))
            .hint("connect an `alignment`, such as that of read/alignment")
    })?;
    let place = |at: u32| (ratio * at) as f32 + 0.5 * (ratio - 1) as f32;
    let width = events.width;
    let places =
        |of: fn(usize, u32) -> u32| (0..events.pixels()).map(|at| place(of(at, width))).collect::<Vec<f32>>();
    Ok(Alignment {
        events,
        x: places(|at, width| at as u32 % width),
        y: places(|at, width| at as u32 / width),
    })
}

/// Inputs, prepared for the comparison.
struct AlignmentInputs {
    events: EventBand,
    stream: EventStream,
    /// How late events are by the description, ns.
    offset_ns: f64,
    alignment: Alignment,
    /// Grey frames on their own pixels.
    frames: FrameSequence,
    full: Option<f32>,
    black: f32,
    /// Metadata of the captured frames on the event array.
    meta: FramesMeta,
}

impl AlignmentInputs {
    fn new(input: &In, cx: &Context) -> Result<AlignmentInputs, NodeError> {
        let alignment = match &input.alignment {
            Some(map) => Alignment::from_map(map)?,
            None => by_pixels(input.events.meta.extent, input.frames.meta.extent)?,
        };
        let array = input.alignment.as_ref().map(|map| map.meta.extent);
        let (pixels, of_events, meta) = planned(&input.events.meta, &input.frames.meta, array)?;
        let events = match pixels {
            Pixels::Frames => on_array(&input.events, &alignment, cx)?,
            Pixels::Array => input.events.read(of_events.extent.rows())?,
        };
        let unknown = Sensor::unknown("alignment");
        let sensor = input.sensor.as_deref().unwrap_or(&unknown);
        let grey = GreyFrames::new(input.frames.meta.extent, &input.frames.meta, sensor)?;
        let frames = grey.frames(&input.frames, SaturatedMean::Mean)?;
        let full = sensor.frames.saturation_dn.map(|full| full as f32);
        let black = sensor.frames.black_level_dn.unwrap_or(0.0) as f32;
        let stream = EventStream::in_memory(Arc::new(of_events), events.clone());
        let offset_ns = clock_offset(sensor)?.offset_ns as f64;
        Ok(AlignmentInputs { events, stream, offset_ns, alignment, frames, full, black, meta })
    }

    /// Frames as the event pixels of an alignment see them, above black.
    fn frames_on_event_pixels(
        &self,
        frames: &FrameSequence,
        alignment: &Alignment,
    ) -> Result<FrameSequence, NodeError> {
        let meta = FramesMeta { extent: alignment.events, ..(*frames.meta).clone() };
        let mut block = frames_on_array(frames, alignment, &meta, &|| Ok(()))?;
        block.dn.iter_mut().for_each(|dn| *dn -= self.black);
        Ok(FrameSequence::in_memory(Arc::new(meta), block))
    }

    /// The pairs of neighbouring frames with most events, at most `most`, in order of time, and the usual
    /// period, ns.
    fn pairs(&self, most: usize) -> (Vec<usize>, i64) {
        let mids: Vec<i64> = self.frames.meta.times.exposures.iter().map(|e| e.mid().0).collect();
        let mut periods: Vec<i64> = mids.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let neighbours = periods.clone();
        periods.sort_unstable();
        let Some(period) = periods.get(periods.len() / 2).copied().filter(|period| *period > 0) else {
            return (Vec::new(), 1);
        };
        let mut counts = vec![0_u64; mids.len()];
        self.events.t.iter().for_each(|t| {
            let after = mids.partition_point(|mid| mid <= t);
            counts[after.saturating_sub(1)] += 1;
        });
        let is_near = |pair: &usize| (1..=PAUSE.saturating_mul(period)).contains(&neighbours[*pair]);
        let mut pairs: Vec<usize> = (0..neighbours.len()).filter(is_near).collect();
        pairs.sort_by_key(|pair| std::cmp::Reverse(counts[*pair]));
        pairs.truncate(most);
        pairs.sort_unstable();
        (pairs, period)
    }

    /// Logarithm of a frame, smoothed, and where it is saturated.
    fn log(&self, frame: usize) -> Result<(Image, Vec<bool>), NodeError> {
        let extent = self.frames.meta.extent;
        let dn = self.frames.read(frame..frame + 1, extent.rows())?.dn;
        let largest = dn.iter().copied().filter(|dn| dn.is_finite()).fold(0.0, f32::max);
        let full = self.full.unwrap_or(SATURATED * largest);
        let dark = (DARK * (largest - self.black)).max(1e-9);
        let values: Vec<f32> = dn.iter().map(|dn| libm::logf((dn - self.black).max(dark))).collect();
        let (width, height) = (extent.width as usize, extent.height as usize);
        let values = smooth(&values, width, height, SMOOTH);
        let saturated = dn.iter().map(|dn| dn.is_nan() || *dn >= full).collect();
        Ok((Image { width, height, values }, saturated))
    }

    /// Signed events of each event pixel between a frame and the next, `late_ns` later, smoothed.
    fn counts(&self, frame: usize, late_ns: f64) -> Vec<f32> {
        let (extent, times) = (self.alignment.events, &self.frames.meta.times);
        let width = extent.width as usize;
        let mut counts = vec![0.0; extent.pixels()];
        for row in extent.rows().iter() {
            // The row of the frames whose exposure this row of the array has.
            let at = row as usize * width + width / 2;
            let y = self.alignment.y[at].round().clamp(0.0, (self.frames.meta.extent.height - 1) as f32);
            let mid = |frame: usize| times.exposure(frame, y as u32).mid().0.saturating_add(late_ns as i64);
            let (from, to) = (mid(frame), mid(frame + 1));
            let events = self.events.row(row);
            let own = &mut counts[row as usize * width..][..width];
            let all = events.x.iter().zip(events.t).zip(events.on);
            for ((x, _), on) in all.filter(|((_, t), _)| from < **t && **t <= to) {
                own[usize::from(*x)] += if *on == 1 { 1.0 } else { -1.0 };
            }
        }
        let pitch = self.alignment.pitch();
        let sigma = SMOOTH / (0.5 * (pitch[0] + pitch[1])).max(0.1);
        smooth(&counts, width, extent.height as usize, sigma.max(0.4))
    }
}

/// A pair of neighbouring frames.
struct FramePair {
    /// The first of them.
    frame: usize,
    /// Light of each pixel of the frames between the two.
    light: Vec<f32>,
    saturated: Vec<bool>,
}

/// The changes of the frames, and the data for a search over them.
struct ShiftSearch<'a> {
    recorded: &'a AlignmentInputs,
    pairs: Vec<FramePair>,
    changes: Vec<Image>,
    /// The light that is usual where something changes.
    usual: f32,
    period: i64,
}

impl ShiftSearch<'_> {
    fn new(recorded: &AlignmentInputs, most: usize) -> Result<ShiftSearch<'_>, NodeError> {
        let (frames, period) = recorded.pairs(most);
        let of = |frame: usize| -> Result<(FramePair, Image), NodeError> {
            let ((before, full), (mut after, also)) = (recorded.log(frame)?, recorded.log(frame + 1)?);
            let both = before.values.iter().zip(&after.values);
            let light = both.map(|(before, after)| libm::expf(0.5 * (before + after))).collect();
            after.values.iter_mut().zip(before.values).for_each(|(after, before)| *after -= before);
            let saturated = full.into_iter().zip(also).map(|(full, also)| full || also).collect();
            Ok((FramePair { frame, light, saturated }, after))
        };
        let all: Vec<_> = frames.into_par_iter().map(of).collect::<Result<_, _>>()?;
        let (pairs, changes): (Vec<FramePair>, Vec<Image>) = all.into_iter().unzip();
        let mut moving: Vec<f32> = Vec::new();
        for (pair, change) in pairs.iter().zip(&changes) {
            let changing =
                change.values.iter().zip(&pair.light).filter(|(change, _)| change.abs() > LEAST_CHANGE);
            moving.extend(changing.map(|(_, light)| *light));
        }
        moving.sort_unstable_by(f32::total_cmp);
        let usual = moving.get(moving.len() / 2).copied().unwrap_or(1.0);
        Ok(ShiftSearch { recorded, pairs, changes, usual, period })
    }

    /// At most `most` samples for events with a delay `late_ns`.
    fn samples(&self, late_ns: f64, most: usize) -> Vec<ShiftSample> {
        // Of a large array, pixels are left out before it is known how many change.
        let pixels = self.pairs.len() * self.recorded.alignment.events.pixels();
        let every = pixels.div_ceil(FEW_CHANGE * most).max(1);
        let of = |n| self.samples_of(n, late_ns, every);
        let all: Vec<Vec<ShiftSample>> = (0..self.pairs.len()).into_par_iter().map(of).collect();
        let all = all.concat();
        let every = all.len().div_ceil(most).max(1);
        all.into_iter().step_by(every).collect()
    }

    /// The pixels of the array, one of `every`, that change between the frames of a pair.
    fn samples_of(&self, number: usize, late_ns: f64, every: usize) -> Vec<ShiftSample> {
        let (pair, change, alignment) =
            (&self.pairs[number], &self.changes[number], &self.recorded.alignment);
        let reach = RATE * self.period as f64;
        let [count, sooner, later] =
            [0.0, -reach, reach].map(|more| self.recorded.counts(pair.frame, late_ns + more));
        let (extent, frames) = (alignment.events, self.recorded.frames.meta.extent);
        let (width, height) = (extent.width as usize, extent.height as usize);
        let of = |pixel: usize| {
            let (x, y) = (pixel % width, pixel / width);
            let place = (alignment.x[pixel], alignment.y[pixel]);
            let (column, row) = alignment.nearest(pixel, frames)?;
            let seen = row * frames.width as usize + column;
            let (change, ..) = change.sample(f64::from(place.0), f64::from(place.1))?;
            let is_active = count[pixel].abs() > FEWEST_EVENTS || change.abs() as f32 > LEAST_CHANGE;
            (is_active && !pair.saturated[seen]).then(|| ShiftSample {
                pair: number as u32,
                part: (y * PARTS / height * PARTS + x * PARTS / width) as u16,
                place,
                at: ((2 * x + 1) as f32 / width as f32 - 1.0, (2 * y + 1) as f32 / height as f32 - 1.0),
                count: count[pixel],
                rate: (later[pixel] - sooner[pixel]) / (2.0 * RATE) as f32,
                dimness: (self.usual / pair.light[seen]).min(DIMMEST),
            })
        };
        (number % every..extent.pixels()).step_by(every).filter_map(of).collect()
    }

    fn compared<T>(&self, late_ns: f64, most: usize, of: impl FnOnce(&ChangesAndEvents<'_>) -> T) -> T {
        of(&ChangesAndEvents { changes: &self.changes, samples: &self.samples(late_ns, most) })
    }

    /// Delay of the events, ns, to an eighth of a period.
    fn coarse_delay_ns(&self) -> f64 {
        let step = self.period as f64 / f64::from(2 * LATE);
        let agreement = |n: i32| {
            let late_ns = f64::from(n) * step;
            (late_ns, self.compared(late_ns, COARSE, |compared| compared.agreement()))
        };
        let all = (-LATE..=LATE).map(agreement);
        all.fold((0.0, f64::NEG_INFINITY), |best, one| if one.1 > best.1 { one } else { best }).0
    }
}

/// The shift of a form; none where too little changes.
fn shifted(search: &ShiftSearch<'_>, start_ns: f64, form: ShiftForm) -> Option<Misalignment> {
    let first = search.compared(start_ns, SAMPLES, |compared| compared.misalignment(form))?;
    // Once more with the lateness of the first time, as counts are taken linear in it.
    let late_ns = start_ns + search.period as f64 * first.late.iter().map(|late| late.value).sum::<f64>();
    search.compared(late_ns, SAMPLES, |compared| compared.misalignment(form))
}

/// The shift of the form that predicts held-out frames best, and whether it is better by far than none;
/// `None` where too little changes.
fn held_out_shift(
    recorded: &AlignmentInputs,
    params: &Params,
) -> Result<Option<(Misalignment, bool)>, NodeError> {
    let search = ShiftSearch::new(recorded, params.pairs)?;
    let start_ns = params.offset.map_or_else(|| search.coarse_delay_ns(), |offset| offset.ns() as f64);
    let forms = [ShiftForm::Constant, ShiftForm::Affine].into_iter();
    let mut shifts: Vec<Misalignment> = forms.filter_map(|form| shifted(&search, start_ns, form)).collect();
    let Some(run) =
        held_out::busiest_frames(&recorded.stream, &recorded.frames.meta.times, recorded.offset_ns)?
    else {
        return Ok((!shifts.is_empty()).then(|| (shifts.swap_remove(0), false)));
    };
    let frames = recorded.frames.select(run.collect());
    let sequences: Vec<FrameSequence> = std::iter::once(None)
        .chain(shifts.iter().map(Some))
        .map(|found| recorded.frames_on_event_pixels(&frames, &shifted_alignment(&recorded.alignment, found)))
        .collect::<Result<_, NodeError>>()?;
    let Some(losses) = held_out::compared(&recorded.stream, &sequences, recorded.offset_ns)? else {
        return Ok((!shifts.is_empty()).then(|| (shifts.swap_remove(0), false)));
    };
    let (mut best, mut shown) = (0, 1);
    for n in 1..losses.len() {
        if held_out::is_better_by_far(&losses[n], &losses[best]) {
            (best, shown) = (n, n);
        }
    }
    Ok((shown <= shifts.len()).then(|| (shifts.swap_remove(shown - 1), best > 0)))
}

impl Node for EstimateAlignment {
    const DECL: Decl = Decl {
        kind: "estimate/alignment",
        about: "Estimates the error of an alignment of events and frames to a fraction of a pixel, and \
                corrects it.",
        revision: 3,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["Lucas and Kanade, IJCAI 1981: registration by gradients, of events against frames"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.array]
kind = "estimate/alignment"
in   = { events = "recording.events", frames = "recording.frames", sensor = "recording.sensor" }

[nodes.solve]
kind = "solve/map"
in   = { events = "array.events", frames = "array.frames", sensor = "recording.sensor" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(EstimateAlignment { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let (events, frames) = (inputs.events("events")?, inputs.frames("frames")?);
        let array = inputs.map("alignment").ok().map(|map| Alignment::check(map).map(|()| map.extent));
        let (_, events, frames) = planned(events, frames, array.transpose()?)?;
        Ok(vec![
            Meta::Map(Arc::new(Alignment::meta(events.extent))),
            Meta::Events(Arc::new(events)),
            Meta::Frames(Arc::new(frames)),
            Meta::Table(Arc::new(TableMeta { scores: false })),
        ])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        cx.begin(input.frames.len() as u64, "frames");
        let recorded = AlignmentInputs::new(&input, cx)?;
        let found = held_out_shift(&recorded, &self.params)?;
        cx.note(note(found.as_ref()));
        let of = |axis: usize| found.as_ref().map(|(found, _)| found.shift[axis]);
        let rows = [TableRow::new("shift_x", of(0), "px", 1.0), TableRow::new("shift_y", of(1), "px", 1.0)];
        let better = found.as_ref().filter(|(_, is_better)| *is_better).map(|(found, _)| found);
        let alignment = shifted_alignment(&recorded.alignment, better);
        let block = frames_on_array(&input.frames, &alignment, &recorded.meta, &|| cx.advance(1))?;
        let frames = FrameSequence::in_memory(Arc::new(recorded.meta), block);
        let estimates = Arc::new(table(&rows));
        Ok(Out { alignment: alignment.into_map(), events: recorded.stream, frames, estimates })
    }
}

/// Whose pixels events are on, and events and frames on the event array; pixel by pixel without an alignment.
fn planned(
    events: &EventsMeta,
    frames: &FramesMeta,
    array: Option<Extent>,
) -> Result<(Pixels, EventsMeta, FramesMeta), NodeError> {
    if array.is_none() {
        by_pixels(events.extent, frames.extent)?;
    }
    let pixels = array.is_none().then_some(Pixels::Array);
    plan_of(pixels, events, frames, array.unwrap_or(events.extent))
}

/// The alignment with its shift applied.
fn shifted_alignment(alignment: &Alignment, found: Option<&Misalignment>) -> Alignment {
    let mut moved = alignment.clone();
    let extent = alignment.events;
    let along = |at: usize, count: u32| (2 * at + 1) as f64 / f64::from(count) - 1.0;
    for (at, (x, y)) in moved.x.iter_mut().zip(&mut moved.y).enumerate() {
        let (column, row) = (at % extent.width as usize, at / extent.width as usize);
        let shift = found.map(|found| found.at((along(column, extent.width), along(row, extent.height))));
        let (right, down) = shift.unwrap_or((0.0, 0.0));
        (*x, *y) = (*x + right as f32, *y + down as f32);
    }
    moved
}

/// The result as a note.
fn note(found: Option<&(Misalignment, bool)>) -> String {
    let Some((found, is_better)) = found else {
        return "too little changes between frames to compare their places; the alignment stays".to_owned();
    };
    let [x, y] = &found.shift;
    let shift = format!(
        "{:.2} pixels to the right (95 %: {:.2} to {:.2}) and {:.2} down ({:.2} to {:.2}){}",
        x.value,
        x.ci95.0,
        x.ci95.1,
        y.value,
        y.ci95.0,
        y.ci95.1,
        if found.slope == [[0.0; 2]; 2] { "" } else { " in the middle" }
    );
    let left = 100.0 * (1.0 - found.left);
    if *is_better {
        format!(
            "places moved: a shift of {shift} explains {left:.1} % of what no shift leaves of the frames' \
             changes; it predicts frames that are held out better by far"
        )
    } else {
        format!(
            "the alignment stays: a shift of {shift} explains {left:.1} % of what none leaves of the frames' \
             changes, and does not predict frames that are held out better by far"
        )
    }
}
