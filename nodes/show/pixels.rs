//! Single pixels in numbers: events, captured exposures, and what a solver's photocurrent says of both.
//!
//! `V_DC = ln i` is Eq. (6). `V_FE` settles towards it by Eqs. (1) and (2), by the answer to a ramp of the
//! MAP solver, in quarters of the time between knots. The residual of a frame is captured minus predicted DN
//! of its own exposure, Eq. (5). The residual of an event is the step of V_FE from the end of the refractory
//! period after the event before it to its own in-pixel time, minus the signed threshold: the comparator's
//! condition with reset to the level at which the pixel may fire again.
//!
//! Limits: where in-pixel times were not recorded, the off-pixel time less the stated smallest latency stands
//! for them. `[effects]` of the description are not looked at. Colour has no such pixel: tracks and frames of
//! three channels give nothing.

use super::pictures::{Shown, Tone};
use photocurrent_core::tracks::Between;
use photocurrent_core::{Colour, EventStream, NodeError, Rows, Sensor, Value};
use photocurrent_sensor::exposure::{HeldTrack, LogLinearTrack};
use photocurrent_sensor::front_end::settled_voltage;
use photocurrent_sensor::map::ramp_voltage;
use photocurrent_sensor::model::Model;
use photocurrent_solve::pixel_events::clock_offset;

/// Of so many rows events are read at a time.
const ROWS: u32 = 16;
/// The frame is cut into so many parts each way to find pixels that lie apart.
const PARTS: u32 = 4;
/// In a part, the pixel that so many share of the others have fewer events than: not the liveliest, which may
/// be hot.
const SHARE: f64 = 0.95;
/// 95 % of a normal distribution lie within so many standard deviations.
const NORMAL_95: f64 = 1.96;

/// An event of a pixel: time in ns, and whether it is ON.
pub type Stamp = (i64, bool);

/// An exposure of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposed {
    /// Number of the frame.
    pub frame: usize,
    /// Start, ns.
    pub start_ns: i64,
    /// End, ns.
    pub end_ns: i64,
    /// What was read.
    pub dn: f64,
    /// The same at the exposure of the pictures.
    pub shown_dn: f64,
}

/// What a sensor recorded of a pixel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seen {
    /// Events in order of time, at their in-pixel times as far as known.
    pub events: Vec<Stamp>,
    /// Captured exposures.
    pub exposures: Vec<Exposed>,
}

/// A pixel's photocurrent as a solver found it, and its residuals.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Photocurrent {
    /// Does a value hold until the next knot?
    pub is_held: bool,
    /// Time in ns and V_DC.
    pub knots: Vec<(i64, f64)>,
    /// Time in ns and both ends of the 95 % interval of V_DC; empty where the solver gives none.
    pub band: Vec<(i64, f64, f64)>,
    /// Time in ns and V_FE; empty where the description does not state the front end.
    pub front_end: Vec<(i64, f64)>,
    /// Middle of the exposure in ns, captured minus predicted DN.
    pub frame_residuals: Vec<(i64, f64)>,
    /// Time in ns, step of V_FE minus threshold.
    pub event_residuals: Vec<(i64, f64)>,
}

fn events_of(value: &Value) -> Option<&EventStream> {
    match value {
        Value::Events(events) => Some(events),
        _ => None,
    }
}

/// At most `count` pixels with many events that lie apart from each other, the liveliest first; none without
/// events.
///
/// # Errors
/// When events cannot be read.
pub fn lively(events: &Value, count: usize) -> Result<Vec<(u32, u32)>, NodeError> {
    let Some(events) = events_of(events) else { return Ok(Vec::new()) };
    let extent = events.meta.extent;
    let mut counts = vec![0u32; extent.pixels()];
    for rows in events.rows().bands(ROWS) {
        let band = events.read(rows)?;
        for y in rows.iter() {
            band.row(y).x.iter().for_each(|&x| counts[(y * extent.width + u32::from(x)) as usize] += 1);
        }
    }
    let parts = |size: u32| size.clamp(1, PARTS);
    let mut found: Vec<(u32, u32, u32)> = Vec::new();
    for part_y in 0..parts(extent.height) {
        for part_x in 0..parts(extent.width) {
            let range = |part: u32, size: u32| size * part / parts(size)..size * (part + 1) / parts(size);
            let pixels =
                range(part_y, extent.height).flat_map(|y| range(part_x, extent.width).map(move |x| (x, y)));
            let mut here: Vec<(u32, u32, u32)> = pixels
                .map(|(x, y)| (counts[(y * extent.width + x) as usize], y, x))
                .filter(|(n, ..)| *n > 0)
                .collect();
            here.sort_unstable();
            if let Some(last) = here.len().checked_sub(1) {
                found.push(here[(SHARE * last as f64).round() as usize]);
            }
        }
    }
    found.sort_by(|a, b| b.0.cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    Ok(found.into_iter().take(count).map(|(_, y, x)| (x, y)).collect())
}

/// What was recorded of pixel (x, y), which must lie inside of both.
///
/// # Errors
/// When events or frames cannot be read.
pub fn seen(
    events: Option<&Value>,
    captured: Option<&Shown>,
    sensor: &Sensor,
    tone: &Tone,
    x: u32,
    y: u32,
) -> Result<Seen, NodeError> {
    let row = Rows { start: y, end: y + 1 };
    let mut seen = Seen::default();
    if let Some(events) = events.and_then(events_of) {
        let band = events.read(row)?;
        let row = band.row(y);
        // Recorded = true + offset, of the events' clock against that of the frames.
        let offset = clock_offset(sensor)?.offset_ns;
        let latency = Model::of(sensor).pixel.latency_ns;
        let index = row.by_pixel(events.meta.extent.width);
        seen.events = index
            .pixel(x as usize)
            .iter()
            .map(|&k| (row.t_in.map_or(row.t[k] - latency, |t_in| t_in[k]) - offset, row.on[k] == 1))
            .collect();
    }
    if let Some(captured) = captured.filter(|captured| captured.frames().meta.colour != Colour::Rgb) {
        let frames = captured.frames();
        for frame in 0..frames.len() {
            let exposure = frames.meta.times.exposure(frame, y);
            let dn = f64::from(frames.read(frame..frame + 1, row)?.dn[x as usize]);
            let shown_dn = tone.shown_dn(dn, exposure.length_ns());
            seen.exposures.push(Exposed {
                frame,
                start_ns: exposure.start.0,
                end_ns: exposure.end.0,
                dn,
                shown_dn,
            });
        }
    }
    Ok(seen)
}

/// What a solver made of pixel (x, y), against what was recorded of it; `None` for a value that holds no
/// tracks of grey pixels.
///
/// # Errors
/// When the tracks cannot be read.
pub fn solved(
    tracks: &Value,
    seen: &Seen,
    sensor: &Sensor,
    x: u32,
    y: u32,
) -> Result<Option<Photocurrent>, NodeError> {
    let Value::Tracks(tracks) = tracks else { return Ok(None) };
    let meta = &tracks.meta;
    if meta.colour == Colour::Rgb || x >= meta.extent.width || y >= meta.extent.height {
        return Ok(None);
    }
    let band = tracks.read(Rows { start: y, end: y + 1 })?;
    let pixel = band.pixel(x, y);
    if pixel.t.is_empty() {
        return Ok(None);
    }
    let model = Model::of(sensor);
    let is_held = meta.between == Between::Hold;
    let v_dc: Vec<f64> =
        pixel.photocurrent.iter().map(|i| settled_voltage(f64::from(*i).max(f64::MIN_POSITIVE))).collect();
    let end = meta.span.end.0.max(*pixel.t.last().unwrap_or(&0));
    let mut knots: Vec<(i64, f64)> = pixel.t.iter().copied().zip(v_dc.iter().copied()).collect();
    knots.extend(v_dc.last().map(|v| (end, *v)));
    let interval = |(k, sigma): (usize, &f32)| {
        (pixel.t[k], v_dc[k] - NORMAL_95 * f64::from(*sigma), v_dc[k] + NORMAL_95 * f64::from(*sigma))
    };
    let band = pixel
        .sigma
        .iter()
        .enumerate()
        .map(interval)
        .filter(|(_, low, high)| low.is_finite() && high.is_finite())
        .collect();
    let states_front_end = sensor.front_end.tau_0.is_some() && sensor.front_end.alpha.is_some();
    let front_end = if states_front_end { front_end_voltage(&knots, is_held, &model) } else { Vec::new() };

    let integral = |exposure| match is_held {
        true => HeldTrack::new(pixel.t, pixel.photocurrent).integral(exposure),
        false => LogLinearTrack::new(pixel.t, pixel.photocurrent).integral(exposure),
    };
    let frame = |one: &Exposed| {
        let exposure = photocurrent_core::Exposure::new(one.start_ns, one.end_ns);
        let predicted = model.number.of(integral(exposure)).min(model.saturation_dn);
        (exposure.mid().0, one.dn - predicted)
    };
    let frame_residuals =
        seen.exposures.iter().map(frame).filter(|(_, residual)| residual.is_finite()).collect();
    // An ideal front end follows at once.
    let voltage =
        |t: i64| if front_end.is_empty() { at(&knots, t, is_held) } else { at(&front_end, t, false) };
    let event = |pair: &[Stamp]| {
        let (before, (t, is_on)) = (pair[0].0 + model.pixel.refractory_ns, pair[1]);
        let threshold = if is_on { model.pixel.threshold_on } else { -model.pixel.threshold_off };
        (t, voltage(t) - voltage(before.min(t)) - threshold)
    };
    let event_residuals =
        seen.events.windows(2).map(event).filter(|(_, residual)| residual.is_finite()).collect();
    Ok(Some(Photocurrent { is_held, knots, band, front_end, frame_residuals, event_residuals }))
}

/// V_FE at the knots and three times between two of them: it starts settled.
fn front_end_voltage(knots: &[(i64, f64)], is_held: bool, model: &Model) -> Vec<(i64, f64)> {
    let Some(&(start, first)) = knots.first() else { return Vec::new() };
    let mut all = vec![(start, first)];
    let mut voltage = first;
    for pair in knots.windows(2) {
        let ((from, v_from), (to, v_to)) = (pair[0], pair[1]);
        for quarter in 0..4 {
            let v_dc = |quarters: i32| {
                if is_held { v_from } else { v_from + 0.25 * f64::from(quarters) * (v_to - v_from) }
            };
            voltage = ramp_voltage(
                &model.pixel.front_end,
                voltage,
                v_dc(quarter),
                v_dc(quarter + 1),
                (to - from) as f64 * 0.25e-9,
            );
            all.push((from + (to - from) * (i64::from(quarter) + 1) / 4, voltage));
        }
    }
    all
}

/// The value of a curve at an instant: held from point to point, or linear; its ends hold outside. NaN
/// without points.
fn at(curve: &[(i64, f64)], t: i64, is_held: bool) -> f64 {
    let after = curve.partition_point(|(instant, _)| *instant <= t);
    match (after.checked_sub(1), curve.get(after)) {
        (None, None) => f64::NAN,
        (None, Some(first)) => first.1,
        (Some(before), None) => curve[before].1,
        (Some(before), Some(_)) if is_held => curve[before].1,
        (Some(before), Some(next)) => {
            let share = (t - curve[before].0) as f64 / (next.0 - curve[before].0) as f64;
            curve[before].1 + share * (next.1 - curve[before].1)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::events::{Event, EventBand, EventsMeta, Polarity};
    use photocurrent_core::quantity::Duration;
    use photocurrent_core::tracks::{TrackBand, TrackSet, TracksMeta};
    use photocurrent_core::{Exposure, Extent, TimeSpan, testing};
    use std::sync::Arc;

    const EXTENT: Extent = Extent { width: 8, height: 8 };

    fn events(at: &[(u16, u16, i64)]) -> Value {
        let event = |&(x, y, t): &(u16, u16, i64)| Event { x, y, polarity: Polarity::On, t, t_in: None };
        let meta = EventsMeta {
            extent: EXTENT,
            span: Some(TimeSpan::new(0, 100)),
            has_t_in: false,
            has_step: false,
            t_resolution_ns: None,
            count_hint: None,
        };
        let band = EventBand::from_events(EXTENT.rows(), at.iter().map(event).collect()).unwrap();
        Value::Events(EventStream::in_memory(Arc::new(meta), band))
    }

    fn tracks(knots: &[(i64, f32)]) -> Value {
        let mut band = TrackBand::begin(0, EXTENT.width);
        (0..EXTENT.pixels()).for_each(|_| band.push(knots.iter().copied()));
        let meta = TracksMeta {
            extent: EXTENT,
            span: TimeSpan::new(0, 100_000_000),
            nominal_exposure_ns: 10_000_000,
            between: Between::Hold,
            colour: Colour::Mono,
            has_sigma: false,
            count_hint: None,
        };
        Value::Tracks(TrackSet::in_memory(Arc::new(meta), band))
    }

    #[test]
    fn pixels_that_are_chosen_lie_apart_and_are_lively() {
        // One event at (0, 0), three at (7, 7), two at (7, 0).
        let found =
            lively(&events(&[(0, 0, 1), (7, 7, 1), (7, 7, 2), (7, 7, 3), (7, 0, 1), (7, 0, 2)]), 2).unwrap();
        assert_eq!(found, [(7, 7), (7, 0)]);
        assert_eq!(lively(&events(&[]), 2).unwrap(), []);
    }

    #[test]
    fn residuals_vanish_where_the_photocurrent_explains_what_was_recorded() {
        let mut sensor = Sensor::unknown("test");
        (sensor.frames.gain, sensor.frames.black_level_dn) = (Some(1000.0), Some(10.0));
        (sensor.comparator.threshold_on, sensor.comparator.threshold_off) =
            (Some(std::f64::consts::LN_2), Some(0.1));
        sensor.readout.latency_min = Some(Duration::new(0));
        // The light doubles at 50 ms, and the pixel says so at once: a threshold of ln 2. Ten milliseconds at
        // 3 are 30 DN above black.
        let captured = Shown::of(Value::Frames(testing::captured(
            EXTENT,
            vec![Exposure::new(10_000_000, 20_000_000)],
            0,
            |_, _, _| 42.0,
        )))
        .unwrap();
        let tone = Tone::of(&captured, Some(&sensor)).unwrap();
        let found = seen(
            Some(&events(&[(2, 3, 5_000_000), (2, 3, 50_000_000)])),
            Some(&captured),
            &sensor,
            &tone,
            2,
            3,
        )
        .unwrap();
        assert_eq!(found.events, [(5_000_000, true), (50_000_000, true)]);
        let solved = solved(&tracks(&[(0, 3.0), (50_000_000, 6.0)]), &found, &sensor, 2, 3).unwrap().unwrap();
        assert_eq!(solved.knots[0], (0, libm::log(3.0)));
        let [(t, residual)] = solved.frame_residuals[..] else { panic!("one frame") };
        assert!(
            t == 15_000_000 && (residual - 2.0).abs() < 1e-9,
            "42 DN were captured, 40 are predicted: {residual}"
        );
        let [(t, residual)] = solved.event_residuals[..] else { panic!("one pair of events") };
        assert!(t == 50_000_000 && residual.abs() < 1e-6, "{residual}");
        assert!(solved.front_end.is_empty(), "the description states no front end");
    }

    #[test]
    fn the_front_end_lags_by_one_part_in_e_after_a_time_constant() {
        let mut sensor = Sensor::unknown("test");
        // tau = 1 ms + 36 ms / 4 = 10 ms at a photocurrent of 4.
        (sensor.front_end.tau_0, sensor.front_end.alpha) =
            (Some(Duration::new(1_000_000)), Some(Duration::new(36_000_000)));
        let solved = solved(
            &tracks(&[(0, 1.0), (50_000_000, 4.0), (60_000_000, 4.0)]),
            &Seen::default(),
            &sensor,
            0,
            0,
        )
        .unwrap()
        .unwrap();
        let v = solved.front_end.iter().find(|(t, _)| *t == 60_000_000).unwrap().1;
        let (low, high) = (0.0, 2.0 * std::f64::consts::LN_2);
        assert!((v - (high - (high - low) / std::f64::consts::E)).abs() < 1e-6, "{v}");
    }
}
