//! Claims about the node, on small recordings whose light is known.

use super::*;
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::random::Random;
use photocurrent_core::{Extent, testing};
use photocurrent_sensor::effects::Site;
use photocurrent_sensor::forward::{Chain, LOG_STEP, LinearLight, Noiseless, Pixel, simulate};
use photocurrent_sensor::front_end::FrontEnd;

const EXTENT: Extent = Extent { width: 24, height: 16 };
const END_NS: i64 = 40_000_000;
const GAIN: f64 = 1000.0;

fn sensor() -> Arc<Sensor> {
    let mut sensor = Sensor::unknown("test");
    sensor.front_end.tau_0 = Some(Duration::new(20_000));
    sensor.front_end.alpha = Some(Duration::new(2_000_000));
    sensor.comparator.threshold_on = Some(0.25);
    sensor.comparator.threshold_off = Some(0.25);
    sensor.readout.refractory = Some(Duration::new(50_000));
    sensor.frames.gain = Some(GAIN);
    Arc::new(sensor)
}

/// What that sensor records of light whose logarithm is `log(x, y, ms)`.
fn record(log: impl Fn(usize, usize, f64) -> f64) -> (EventStream, FrameSequence) {
    let t_ns: Vec<i64> = (0..=END_NS / 50_000).map(|n| n * 50_000).collect();
    let exposures: Vec<Exposure> = (0..5).map(|l| Exposure::new(l * 8_800_000, l * 8_800_000 + 4_000_000)).collect();
    let front_end = FrontEnd { tau_0_s: 20e-6, alpha_s: 2e-3 };
    let pixel =
        Pixel { front_end, threshold_on: 0.25, threshold_off: 0.25, latency_ns: 1_000, latency_spread_ns: 0.0, refractory_ns: 50_000, log_step: LOG_STEP };
    let (mut events, mut dn) = (Vec::new(), Vec::new());
    for y in 0..EXTENT.height {
        for x in 0..EXTENT.width {
            let current: Vec<f64> = t_ns.iter().map(|&t| libm::exp(log(x as usize, y as usize, t as f64 * 1e-6))).collect();
            let light = LinearLight::new(&t_ns, &current);
            let site = Site { x, y, width: EXTENT.width, height: EXTENT.height, seed: 0 };
            let fired = simulate(&Chain { pixel, reset: photocurrent_core::sensor::Reset::Resample, effects: &[] }, &site, &light, 0, END_NS, &mut Noiseless);
            events.extend(fired.iter().map(|fired| Event {
                x: x as u16,
                y: y as u16,
                polarity: Polarity::from_bit(u8::from(fired.event.polarity > 0)),
                t: fired.event.t_off_ns,
                t_in: Some(fired.event.t_in_ns),
            }));
            dn.push(exposures.iter().map(|&exposure| (GAIN * light.integral(exposure)) as f32).collect::<Vec<f32>>());
        }
    }
    let frames = testing::captured(EXTENT, exposures, 0, |l, x, y| dn[(y * EXTENT.width + x) as usize][l]);
    (testing::stream(EXTENT, events), frames)
}

/// A texture that slides by 0.7 and 0.2 pixels a millisecond.
fn texture(x: usize, y: usize, ms: f64) -> f64 {
    let (x, y) = (x as f64 - 0.7 * ms, y as f64 - 0.2 * ms);
    4.6 + 0.3 * libm::sin(0.8 * x + 0.3) * libm::cos(0.7 * y) + 0.2 * libm::sin(0.4 * x - 0.9 * y) + 0.1 * libm::sin(1.3 * x + 0.5 * y)
}

/// Light that swings in every pixel as it pleases.
fn every_pixel_for_itself(x: usize, y: usize, ms: f64) -> f64 {
    let mut random = Random::new(3, &[x as u64, y as u64]);
    let (rate, phase) = (0.3 + 0.5 * random.uniform(), 7.0 * random.uniform());
    4.6 + 0.4 * libm::sin(rate * ms + phase)
}

fn solve(events: &EventStream, frames: &FrameSequence) -> TrackSet {
    let node = SolvePixel::build(SolveParams { method: Method::Map, ..SolveParams::default() }).unwrap();
    let input = crate::solve::pixel::In { events: events.clone(), frames: frames.clone(), sensor: sensor() };
    testing::with_context(EXTENT.rows(), &["tracks", "map"], |cx| node.run(input, cx)).0.unwrap().tracks
}

fn refine(tracks: &TrackSet, events: &EventStream, frames: &FrameSequence, rounds: u32) -> TrackSet {
    let node = RefineMotion::build(Params { rounds, ..Params::default() }).unwrap();
    let input = In { tracks: tracks.clone(), events: events.clone(), frames: frames.clone(), sensor: sensor() };
    testing::with_context(EXTENT.rows(), &["tracks"], |cx| node.run(input, cx)).0.unwrap().tracks
}

/// Rms error of log light, every half millisecond from the first frame to the last.
fn error(tracks: &TrackSet, log: impl Fn(usize, usize, f64) -> f64) -> f64 {
    let tracks = LogTracks::new(EXTENT, &tracks.read(EXTENT.rows()).unwrap(), &Arc::new(Fired::new(std::iter::empty())));
    let (mut sum, mut count) = (0.0, 0.0);
    for y in 0..EXTENT.height as usize {
        for x in 0..EXTENT.width as usize {
            for n in 4..76 {
                let t_ns = n * 500_000;
                let off = tracks.at(x, y, t_ns).unwrap() - log(x, y, t_ns as f64 * 1e-6);
                (sum, count) = (sum + off * off, count + 1.0);
            }
        }
    }
    libm::sqrt(sum / count)
}

fn decibels(before: f64, after: f64) -> f64 {
    20.0 * libm::log10(before / after)
}

#[test]
fn a_texture_that_slides_comes_out_better() {
    let (events, frames) = record(texture);
    let alone = solve(&events, &frames);
    let together = refine(&alone, &events, &frames, 3);
    let (before, after) = (error(&alone, texture), error(&together, texture));
    assert!(decibels(before, after) > 2.0, "{before} became {after}: {} dB", decibels(before, after));
}

#[test]
fn pixels_that_have_nothing_to_do_with_each_other_stay_as_they_are() {
    let (events, frames) = record(every_pixel_for_itself);
    let alone = solve(&events, &frames);
    let together = refine(&alone, &events, &frames, 3);
    let (before, after) = (error(&alone, every_pixel_for_itself), error(&together, every_pixel_for_itself));
    assert!(decibels(before, after) > -0.1, "{before} became {after}: {} dB", decibels(before, after));
}

#[test]
fn the_motion_of_a_sliding_texture_is_found() {
    // From the light itself, so that only the eye is judged.
    let pictures = (0..41).map(|n| (0..384).map(|p| texture(p % 24, p / 24, 0.5 * n as f64) as f32).collect()).collect();
    let flow = Flow::new(&Film { width: 24, height: 16, start_ns: 0, step_ns: FILM_STEP_NS, pictures });
    for (x, y, t_ns) in [(12.0, 8.0, 10_000_000), (5.0, 4.0, 5_000_000), (18.5, 11.5, 15_300_000)] {
        let [vx, vy] = flow.at(x, y, t_ns);
        // A twentieth of a pixel over the three lines that are looked at.
        assert!((vx - 0.7).abs() < 0.015 && (vy - 0.2).abs() < 0.015, "({vx}, {vy}) at ({x}, {y})");
    }
}

/// The hints of pixel (12, 8) of a texture whose tracks are its light, with that pixel's own track moved by `own`.
fn hints(own: f64, velocity: [f32; 2]) -> Vec<Hint> {
    let mut band = TrackBand::begin(0, EXTENT.width);
    for p in 0..EXTENT.pixels() {
        let (x, y) = (p % 24, p / 24);
        let moved = if (x, y) == (12, 8) { own } else { 0.0 };
        band.push((0..400).map(|n| (n * 100_000, libm::exp(texture(x, y, n as f64 * 0.1) + moved) as f32)));
    }
    let fired = Fired::new((0..EXTENT.pixels()).map(|_| vec![20_000_000]));
    let tracks = LogTracks::new(EXTENT, &band, &Arc::new(fired));
    let event = photocurrent_sensor::map::MapEvent { t_in_ns: 20_000_000, t_off_ns: 20_001_000, polarity: 1 };
    let mut hints = Vec::new();
    Advection::default().hints(&tracks, &Flow::steady(24, 16, velocity), (12, 8), (0, 39_900_000), 500_000, &[event], &[], 0.25, &mut hints);
    hints
}

#[test]
fn neighbours_along_the_motion_foretell_a_pixel() {
    let hints = hints(0.0, [0.7, 0.2]);
    assert!(hints.len() > 70);
    for hint in hints {
        let off = hint.log_photocurrent - texture(12, 8, hint.t_ns as f64 * 1e-6);
        // What a cubic through pixels leaves of waves seven pixels long.
        assert!(off.abs() < 0.01, "{off} at {}", hint.t_ns);
    }
}

#[test]
fn a_pixel_never_hints_itself_but_judges_its_hints() {
    let (plain, moved) = (hints(0.0, [0.7, 0.2]), hints(0.1, [0.7, 0.2]));
    assert_eq!(plain.len(), moved.len());
    for (plain, moved) in plain.iter().zip(&moved) {
        assert_eq!((plain.t_ns, plain.log_photocurrent), (moved.t_ns, moved.log_photocurrent));
        assert!(moved.variance > plain.variance);
    }
    // Hints that miss by four thresholds where the pixel knows its light, at its event, are none.
    assert!(hints(1.0, [0.7, 0.2]).is_empty());
}

#[test]
fn without_motion_there_are_no_hints() {
    assert!(hints(0.0, [0.0, 0.0]).is_empty());
    // Slower than a pixel in the longest time.
    assert!(hints(0.0, [0.05, 0.05]).is_empty());
}

#[test]
fn threads_do_not_change_a_bit() {
    let (events, frames) = record(texture);
    let alone = solve(&events, &frames);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| refine(&alone, &events, &frames, 1).read(EXTENT.rows()).unwrap())
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn held_tracks_are_refused() {
    let (events, frames) = record(|x, _, _| 4.0 + 0.01 * x as f64);
    let node = SolvePixel::build(SolveParams { readout: crate::solve::pixel::ReadoutModel::None, ..SolveParams::default() }).unwrap();
    let input = crate::solve::pixel::In { events: events.clone(), frames: frames.clone(), sensor: sensor() };
    let held = testing::with_context(EXTENT.rows(), &["tracks", "map"], |cx| node.run(input, cx)).0.unwrap().tracks;
    let node = RefineMotion::build(Params::default()).unwrap();
    let refused = testing::with_context(EXTENT.rows(), &["tracks"], |cx| node.run(In { tracks: held, events, frames, sensor: sensor() }, cx)).0;
    let error = refused.err().unwrap();
    assert!(error.to_string().contains("log-linear"), "{error}");
    assert!(error.hint.is_some_and(|hint| hint.contains("method = \"map\"")));
}
