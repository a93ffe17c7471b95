//! Small helpers that the tests of several crates share: made-up data of every type, and a context to run a
//! node in.

use crate::colour::Colour;
use crate::context::{Context, Notes, Silent};
use crate::events::{Event, EventBand, EventStream, EventsMeta, Polarity};
use crate::extent::{Extent, Rows};
use crate::frames::{FrameBlock, FrameScale, FrameSequence, FrameTimes, FramesMeta};
use crate::light::{Light, LightBand, LightMeta};
use crate::random::Random;
use crate::time::{Exposure, TimeSpan};
use crate::tracks::{Between, TrackBand, TrackSet, TracksMeta};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Random events with both stamps, about ten a pixel, over 100 ms.
pub fn events(width: u32, height: u32) -> EventStream {
    let extent = Extent { width, height };
    let mut random = Random::new(1, &[u64::from(width), u64::from(height)]);
    let mut draw = |limit: u64| random.bits() % limit;
    let events = (0..10 * extent.pixels())
        .map(|_| {
            let t_in = draw(100_000_000) as i64;
            Event {
                x: draw(width.into()) as u16,
                y: draw(height.into()) as u16,
                polarity: Polarity::from_bit(draw(2) as u8),
                t: t_in + draw(50_000) as i64,
                t_in: Some(t_in),
            }
        })
        .collect();
    stream(extent, events)
}

/// A stream of given events; carries in-pixel times when every event has one.
///
/// # Panics
/// When an event lies outside the sensor.
pub fn stream(extent: Extent, events: Vec<Event>) -> EventStream {
    let span = events.iter().map(|e| TimeSpan::new(e.t, e.t + 1)).reduce(TimeSpan::union);
    let has_t_in = !events.is_empty() && events.iter().all(|e| e.t_in.is_some());
    let meta = EventsMeta {
        extent,
        span,
        has_t_in,
        has_step: false,
        t_resolution_ns: None,
        count_hint: Some(events.len() as u64),
    };
    let mut band = EventBand::from_events(extent.rows(), events).expect("test events lie on the sensor");
    if !has_t_in {
        band.t_in = None;
    }
    EventStream::in_memory(Arc::new(meta), band)
}

/// Random captured frames at 100 fps with 4 ms exposures and 10 us row time.
pub fn frames(width: u32, height: u32, count: usize) -> FrameSequence {
    let exposures =
        (0..count as i64).map(|l| Exposure::new(l * 10_000_000, l * 10_000_000 + 4_000_000)).collect();
    let mut random = Random::new(2, &[u64::from(width), u64::from(height)]);
    captured(Extent { width, height }, exposures, 10_000, |_, _, _| (random.uniform() * 1000.0) as f32)
}

/// Captured frames whose DN is a function of (frame, x, y).
///
/// # Panics
/// When the exposures are not in order.
pub fn captured(
    extent: Extent,
    exposures: Vec<Exposure>,
    row_time_ns: i64,
    mut dn: impl FnMut(usize, u32, u32) -> f32,
) -> FrameSequence {
    let times = FrameTimes::new(exposures, row_time_ns).expect("test exposures are in order");
    let meta = FramesMeta { extent, colour: Colour::Mono, times, scale: FrameScale::Captured };
    let mut block = FrameBlock::zeros(0..meta.times.len(), extent.rows(), extent.width as usize);
    for frame in 0..meta.times.len() {
        for y in 0..extent.height {
            for x in 0..extent.width {
                block.row_mut(frame, y)[x as usize] = dn(frame, x, y);
            }
        }
    }
    FrameSequence::in_memory(Arc::new(meta), block)
}

/// Random tracks with zero to four knots a pixel, over 100 ms.
pub fn tracks(width: u32, height: u32) -> TrackSet {
    let extent = Extent { width, height };
    let mut random = Random::new(3, &[u64::from(width), u64::from(height)]);
    let mut band = TrackBand::begin(0, width);
    for _ in 0..extent.pixels() {
        let mut t = 0;
        let knots: Vec<(i64, f32)> = (0..random.bits() % 5)
            .map(|_| {
                t += 1 + (random.bits() % 20_000_000) as i64;
                (t, (random.uniform() * 100.0) as f32)
            })
            .collect();
        band.push(knots);
    }
    let meta = TracksMeta {
        extent,
        span: TimeSpan::new(0, 100_000_000),
        nominal_exposure_ns: 4_000_000,
        between: Between::Hold,
        colour: Colour::Mono,
        has_sigma: false,
        count_hint: None,
    };
    TrackSet::in_memory(Arc::new(meta), band)
}

/// Random light with one to four instants a pixel, over 100 ms.
pub fn light(width: u32, height: u32) -> Light {
    let extent = Extent { width, height };
    let mut random = Random::new(4, &[u64::from(width), u64::from(height)]);
    let mut band = LightBand::begin(0, width);
    for _ in 0..extent.pixels() {
        let mut t = 0;
        let instants: Vec<(i64, f32)> = (0..1 + random.bits() % 4)
            .map(|_| {
                t += 1 + (random.bits() % 20_000_000) as i64;
                (t, (random.uniform() * 100.0) as f32)
            })
            .collect();
        band.push(instants);
    }
    let meta =
        LightMeta { extent, span: TimeSpan::new(0, 100_000_000), colour: Colour::Mono, count_hint: None };
    Light::in_memory(Arc::new(meta), band)
}

/// Calls `work` with a context for some rows, all of `wanted` outputs wanted; gives back its result and the
/// notes made.
pub fn with_context<T>(rows: Rows, wanted: &[&str], work: impl FnOnce(&Context) -> T) -> (T, Vec<String>) {
    let wanted: BTreeSet<String> = wanted.iter().map(|port| port.to_string()).collect();
    let (cancel, notes) = (AtomicBool::new(false), Notes::default());
    let result = work(&Context::new(rows, 7, &wanted, &Silent, &cancel, None, &notes));
    (result, notes.lines())
}
