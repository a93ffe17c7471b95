//! Claims about `solve/map` on recordings that lack something: in-pixel stamps, fine stamps, some events, a
//! frame.

use super::map::SolveMap;
use super::*;
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::quantity::Duration;
use photocurrent_core::sensor::Reset;
use photocurrent_core::{EventsMeta, Exposure, Extent, Node, TrackBand, testing};
use photocurrent_sensor::effects::Site;
use photocurrent_sensor::forward::{Chain, LOG_STEP, LinearLight, Noiseless, Pixel, simulate};
use photocurrent_sensor::front_end::FrontEnd;
use photocurrent_solve::SolveOptions;

const EXTENT: Extent = Extent { width: 6, height: 4 };
const END_NS: i64 = 44_000_000;
const GAIN: f64 = 1000.0;
const LATENCY_NS: i64 = 60_000;
const REFRACTORY_NS: i64 = 40_000;

/// Each pixel swings in its own phase, by 1 in log light, up to 0.4 a millisecond; `phase` is added to all.
fn log(phase: f64, x: usize, y: usize, ms: f64) -> f64 {
    4.6 + 0.5 * libm::sin(phase + 0.8 * ms + 0.9 * x as f64 + 1.7 * y as f64)
}

fn sensor(latency_min: Option<i64>) -> Arc<Sensor> {
    let mut sensor = Sensor::unknown("test");
    sensor.front_end.tau_0 = Some(Duration::new(20_000));
    sensor.front_end.alpha = Some(Duration::new(2_000_000));
    sensor.comparator.threshold_on = Some(0.15);
    sensor.comparator.threshold_off = Some(0.15);
    sensor.readout.refractory = Some(Duration::new(REFRACTORY_NS));
    sensor.readout.latency_min = latency_min.map(Duration::new);
    sensor.frames.gain = Some(GAIN);
    Arc::new(sensor)
}

/// What a sensor records whose readout takes [`LATENCY_NS`].
fn record() -> (Vec<Event>, FrameSequence) {
    record_at(0.0)
}

/// The same of light in another phase.
fn record_at(phase: f64) -> (Vec<Event>, FrameSequence) {
    let t_ns: Vec<i64> = (0..=END_NS / 50_000).map(|n| n * 50_000).collect();
    let exposures: Vec<Exposure> =
        (0..6).map(|l| Exposure::new(l * 8_000_000, l * 8_000_000 + 3_000_000)).collect();
    let pixel = Pixel {
        front_end: FrontEnd { tau_0_s: 20e-6, alpha_s: 2e-3 },
        threshold_on: 0.15,
        threshold_off: 0.15,
        latency_ns: LATENCY_NS,
        latency_spread_ns: 0.0,
        refractory_ns: REFRACTORY_NS,
        log_step: LOG_STEP,
    };
    let (mut events, mut dn) = (Vec::new(), Vec::new());
    for y in 0..EXTENT.height {
        for x in 0..EXTENT.width {
            let current: Vec<f64> = t_ns
                .iter()
                .map(|&t| libm::exp(log(phase, x as usize, y as usize, t as f64 * 1e-6)))
                .collect();
            let light = LinearLight::new(&t_ns, &current);
            let site = Site { x, y, width: EXTENT.width, height: EXTENT.height, seed: 0 };
            let fired = simulate(
                &Chain {
                    pixel,
                    reset: Reset::Resample,
                    effects: &[],
                    tolerance: photocurrent_sensor::forward::TOLERANCE,
                },
                &site,
                &light,
                0,
                END_NS,
                &mut Noiseless,
            );
            events.extend(fired.iter().map(|fired| Event {
                x: x as u16,
                y: y as u16,
                polarity: Polarity::from_bit(u8::from(fired.event.polarity > 0)),
                t: fired.event.t_off_ns,
                t_in: Some(fired.event.t_in_ns),
            }));
            dn.push(
                exposures
                    .iter()
                    .map(|&exposure| (GAIN * light.integral(exposure)) as f32)
                    .collect::<Vec<f32>>(),
            );
        }
    }
    let frames = testing::captured(EXTENT, exposures, 0, |l, x, y| dn[(y * EXTENT.width + x) as usize][l]);
    (events, frames)
}

/// The same events as a camera without in-pixel stamps gives them.
fn off_pixel(events: &[Event]) -> Vec<Event> {
    events.iter().map(|event| Event { t_in: None, ..*event }).collect()
}

fn solve(events: Vec<Event>, frames: &FrameSequence, latency_min: Option<i64>) -> TrackBand {
    solve_stream(testing::stream(EXTENT, events), frames, latency_min)
}

fn solve_stream(events: EventStream, frames: &FrameSequence, latency_min: Option<i64>) -> TrackBand {
    let node = SolveMap::build(SolveOptions::default().into()).unwrap();
    let input = In { events, frames: frames.clone(), sensor: sensor(latency_min) };
    let out = testing::with_context(EXTENT.rows(), &["tracks", "map"], |cx| node.run(input, cx)).0.unwrap();
    out.tracks.read(EXTENT.rows()).unwrap()
}

/// Stamps cut to whole multiples of `resolution_ns`, which the stream states.
fn coarse(events: &[Event], resolution_ns: i64) -> EventStream {
    let cut = |t: i64| t / resolution_ns * resolution_ns;
    let events = testing::stream(
        EXTENT,
        events.iter().map(|event| Event { t: cut(event.t), t_in: event.t_in.map(cut), ..*event }).collect(),
    );
    let meta = EventsMeta { t_resolution_ns: Some(resolution_ns), ..(*events.meta).clone() };
    EventStream::in_memory(Arc::new(meta), events.read(EXTENT.rows()).unwrap())
}

/// Rms error of log light over a time, of the pixels that `of` takes; `of` sees the number of the pixel.
fn error(found: impl Fn(usize, i64) -> f64, when: (i64, i64), of: impl Fn(usize) -> bool) -> f64 {
    error_at(0.0, found, when, of)
}

/// The same where light was in another phase.
fn error_at(
    phase: f64,
    found: impl Fn(usize, i64) -> f64,
    (from_ms, to_ms): (i64, i64),
    of: impl Fn(usize) -> bool,
) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for p in (0..EXTENT.pixels()).filter(|&p| of(p)) {
        for n in 4 * from_ms..4 * to_ms {
            let off = found(p, n * 250_000) - log(phase, p % 6, p / 6, n as f64 * 0.25);
            (sum, count) = (sum + off * off, count + 1.0);
        }
    }
    libm::sqrt(sum / count)
}

/// Log light of solved tracks.
fn of_tracks(band: &TrackBand) -> impl Fn(usize, i64) -> f64 + '_ {
    |p, t_ns| {
        let track = band.pixel((p % 6) as u32, (p / 6) as u32);
        let log = |k: usize| libm::log(f64::from(track.photocurrent[k]));
        match track.t.partition_point(|&knot| knot <= t_ns) {
            0 => log(0),
            after if after == track.t.len() => log(after - 1),
            after => {
                let share = (t_ns - track.t[after - 1]) as f64 / (track.t[after] - track.t[after - 1]) as f64;
                log(after - 1) + share * (log(after) - log(after - 1))
            }
        }
    }
}

/// Log light when each frame lasts until the middle between it and the next.
fn of_frames(frames: &FrameSequence) -> impl Fn(usize, i64) -> f64 + '_ {
    let block = frames.read_rows(EXTENT.rows()).unwrap();
    move |p, t_ns| {
        let l =
            (0..frames.len()).min_by_key(|&l| (frames.meta.times.exposures[l].mid().0 - t_ns).abs()).unwrap();
        let seconds = frames.meta.times.exposures[l].seconds();
        libm::log(f64::from(block.row(l, (p / 6) as u32)[p % 6]) / (GAIN * seconds))
    }
}

const ALL: (i64, i64) = (2, 42);

#[test]
fn a_constant_latency_that_is_stated_costs_nothing() {
    let (events, frames) = record();
    let both = solve(events.clone(), &frames, None);
    // The stamp less the latency is the in-pixel time, to the nanosecond that the simulator rounds to.
    let stated = solve(off_pixel(&events), &frames, Some(LATENCY_NS));
    assert_eq!(stated, both);
    let ignored = solve(off_pixel(&events), &frames, None);
    let of = |band: &TrackBand| error(of_tracks(band), ALL, |_| true);
    // 60 us late is 0.02 where light moves by 0.28 a millisecond, root mean square; and the reference is
    // taken when it was not.
    assert!(
        of(&ignored) > 1.5 * of(&stated),
        "{} with the latency ignored, {} with it",
        of(&ignored),
        of(&stated)
    );
}

#[test]
fn stamps_of_a_stated_resolution_are_nearly_as_good_as_exact_ones() {
    // 24 pixels choose noise and prior, and nanoseconds decide between settings that err by up to a third
    // more or less: only the mean over phases of the light compares stamps.
    let (mut exact, mut coarse) = (0.0, 0.0);
    for phase in [0.0, 0.001, 0.01, 0.1, 0.3, 1.0, 2.0, 3.0] {
        let (events, frames) = record_at(phase);
        let square = |band: &TrackBand| {
            let error = error_at(phase, of_tracks(band), ALL, |_| true);
            error * error
        };
        exact += square(&solve(events.clone(), &frames, None));
        coarse += square(&solve_stream(self::coarse(&events, 20_000), &frames, None));
    }
    let (exact, coarse) = (libm::sqrt(exact), libm::sqrt(coarse));
    // 20 us are 0.008 at the steepest, half of that on average: in squares a hundredth of what is wrong
    // anyway.
    assert!(coarse < 1.15 * exact, "{coarse} in steps of 20 us, {exact} exactly");
}

#[test]
fn pixels_that_lose_their_events_for_a_while_recover_and_leave_other_rows_alone() {
    let (events, frames) = record();
    let lost = |event: &Event| event.y == 1 && event.x < 4 && (13_000_000..27_000_000).contains(&event.t);
    let kept: Vec<Event> = events.iter().filter(|event| !lost(event)).copied().collect();
    assert!(kept.len() + 40 < events.len(), "the stretch must hold events");
    let (whole, holed) = (solve(events, &frames, None), solve(kept, &frames, None));
    for y in [0, 2, 3] {
        assert!((0..6).all(|x| whole.pixel(x, y) == holed.pixel(x, y)), "row {y}");
    }
    assert!(holed.photocurrent.iter().all(|i| i.is_finite() && *i > 0.0));
    let affected = |p: usize| p / 6 == 1 && p % 6 < 4;
    let of = |band: &TrackBand, when| error(of_tracks(band), when, affected);
    // Inside, nothing but frames says how light moves.
    let repeated = error(of_frames(&frames), (13, 27), affected);
    let (before, after) = (of(&whole, (13, 27)), of(&holed, (13, 27)));
    assert!(
        after > before && after < 1.2 * repeated,
        "{before} became {after}, and {repeated} by repeating frames"
    );
    // Away from the stretch the pixel knows what it knew.
    for outside in [(2, 12), (30, 42)] {
        let (before, after) = (of(&whole, outside), of(&holed, outside));
        assert!(after < 1.5 * before, "{before} became {after} outside of the stretch, {outside:?}");
    }
}

#[test]
fn a_missing_frame_is_survived() {
    let (events, frames) = record();
    let fewer = frames.select(vec![0, 1, 3, 4, 5]);
    let (whole, holed) = (solve(events.clone(), &frames, None), solve(events, &fewer, None));
    assert!(holed.photocurrent.iter().all(|i| i.is_finite() && *i > 0.0));
    let of = |band: &TrackBand| error(of_tracks(band), (12, 24), |_| true);
    let repeated = error(of_frames(&fewer), (12, 24), |_| true);
    assert!(of(&holed) < 0.2 * repeated, "{}, and {repeated} by repeating frames", of(&holed));
    assert!(of(&holed) < 1.5 * of(&whole), "{} became {}", of(&whole), of(&holed));
}
