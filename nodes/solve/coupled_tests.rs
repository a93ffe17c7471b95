//! The loop closed where pixels are coupled: neighbours whose photocurrent is mixed, and a readout that lets
//! events wait.

use super::map::SolveMap;
use super::*;
use crate::simulate::sensor::{self as simulated, SimulateSensor};
use photocurrent_core::document::Source;
use photocurrent_core::handle::Band;
use photocurrent_core::light::{LightBand, LightMeta};
use photocurrent_core::quantity::{Duration, Rate};
use photocurrent_core::{
    Colour, Extent, Grain, Light, Meta, Node, PortMetas, Rows, TimeSpan, TrackBand, testing,
};
use photocurrent_sensor::effects::Site;
use photocurrent_solve::{Model, SolveOptions};

const EXTENT: Extent = Extent { width: 12, height: 9 };
const END_NS: i64 = 120_000_000;

fn sensor(effects: &str) -> Arc<Sensor> {
    let text = format!(
        "format = \"photocurrent-sensor/1\"\n[front_end]\ntau_0 = \"30 us\"\nalpha = \"8 ms\"\n[comparator]\n\
         threshold_on = 0.1\nthreshold_off = 0.11\n[readout]\nlatency_min = \"10 us\"\n\
         refractory = \"30 us\"\n[frames]\ngain = 800\nblack_level_dn = 20\nsaturation_dn = 4095\nrow_time \
                        = \"20 us\"\n[effects]\n{effects}\n"
    );
    Arc::new(Sensor::parse(&Source::new("s.toml", "", text)).unwrap())
}

/// A wave that runs to the right and down over a texture of single pixels.
fn waves(x: u32, y: u32, t_ns: i64) -> f64 {
    let t = t_ns as f64 * 1e-9;
    let texture = 0.3 * f64::from((x * 7 + y * 5) % 4);
    let wave = 0.7 * libm::tanh(3.0 * libm::sin(110.0 * t - 0.9 * f64::from(x) - 0.4 * f64::from(y)));
    4.0 + texture + wave
}

fn record(sensor: &Arc<Sensor>, log_light: impl Fn(u32, u32, i64) -> f64) -> simulated::Out {
    let mut band = LightBand::begin(0, EXTENT.width);
    for (x, y) in (0..EXTENT.height).flat_map(|y| (0..EXTENT.width).map(move |x| (x, y))) {
        band.push((0..=END_NS / 50_000).map(|k| (50_000 * k, libm::exp(log_light(x, y, 50_000 * k)) as f32)));
    }
    let meta =
        LightMeta { extent: EXTENT, span: TimeSpan::new(0, END_NS), colour: Colour::Mono, count_hint: None };
    let params = simulated::Params {
        frame_rate: Rate::new(125.0),
        exposure: Duration::new(5_000_000),
        latency_spread: Duration::new(0),
        ..simulated::Params::default()
    };
    let node = SimulateSensor::build(params).unwrap();
    let input = simulated::In { light: Light::in_memory(Arc::new(meta), band), sensor: sensor.clone() };
    let (out, notes) = testing::with_context(EXTENT.rows(), &["events", "frames"], |cx| node.run(input, cx));
    // A note would say that the readout is overloaded, and the truth not settled.
    assert_eq!(notes, [""; 0]);
    out.unwrap()
}

fn solve(recorded: &simulated::Out, description: &Arc<Sensor>) -> (TrackBand, Vec<String>) {
    let node = SolveMap::build(SolveOptions::default().into()).unwrap();
    let input =
        In { events: recorded.events.clone(), frames: recorded.frames.clone(), sensor: description.clone() };
    let (out, notes) = testing::with_context(EXTENT.rows(), &["tracks", "map"], |cx| node.run(input, cx));
    (out.unwrap().tracks.read(EXTENT.rows()).unwrap(), notes)
}

/// Root mean square of log photocurrent against the truth.
fn error(tracks: &TrackBand, log_light: impl Fn(u32, u32, i64) -> f64) -> f64 {
    let (mut square, mut count) = (0.0, 0.0);
    for (x, y) in (0..EXTENT.height).flat_map(|y| (0..EXTENT.width).map(move |x| (x, y))) {
        let track = tracks.pixel(x, y);
        let log: Vec<f64> = track.photocurrent.iter().map(|i| libm::log(f64::from(*i))).collect();
        for t in (100..1050).map(|n| n * 100_000) {
            let off = photocurrent_sensor::conditional::at(track.t, &log, t) - log_light(x, y, t);
            square += off * off;
            count += 1.0;
        }
    }
    f64::sqrt(square / count)
}

#[test]
fn photocurrent_that_neighbours_mix_in_is_subtracted() {
    let stated = sensor("");
    let clean = error(&solve(&record(&stated, waves), &stated).0, waves);
    let (mut lines, mut failed) = (Vec::new(), Vec::new());
    // Each with the part of the error of the nominal description that may be left. Of a wide blur and a shift
    // between pixels, fine texture keeps more.
    for (effects, left) in [
        ("crosstalk = { fraction = 0.1 }", 0.4),
        ("crosstalk = { fraction = 0.3 }", 0.2),
        ("blur = { sigma = 0.4 }", 0.2),
        ("blur = { sigma = 0.7 }", 0.35),
        ("misalignment = { shift_x = 0.4 }", 0.25),
        ("misalignment = { shift_x = 1.0 }", 0.1),
        ("misalignment = { shift_x = -1.2, shift_y = 1.0 }", 0.6),
        ("lateral_inhibition = { fraction = 0.15 }", 0.6),
        ("lateral_inhibition = { fraction = 0.4 }", 0.3),
    ] {
        let actual = sensor(effects);
        let recorded = record(&actual, waves);
        let nominal = error(&solve(&recorded, &stated).0, waves);
        let (tracks, notes) = solve(&recorded, &actual);
        let fitted = error(&tracks, waves);
        let line = format!(
            "{effects}: without the effect {clean:.4}, nominal {nominal:.4}, fitted {fitted:.4}, {notes:?}"
        );
        if !(fitted < left * nominal
            && nominal > 2.0 * clean
            && notes.iter().all(|note| !note.contains("not modelled")))
        {
            failed.push(line.clone());
        }
        lines.push(line);
    }
    println!("{lines:#?}");
    assert!(failed.is_empty(), "{failed:#?}");
}

/// All pixels brighten and darken together, so that they ask at once, and fewer events come than the readout
/// can serve.
fn pulses(x: u32, y: u32, t_ns: i64) -> f64 {
    4.0 + 0.01 * f64::from(x + y) + 0.7 * libm::sin(33.0 * (t_ns as f64 * 1e-9))
}

#[test]
fn events_that_waited_reset_their_pixels_later() {
    let stated = sensor("");
    let clean = error(&solve(&record(&stated, pulses), &stated).0, pulses);
    // At steepest a pixel fires every 4 ms, and all 108 of them are served in 2.2 ms: they wait for 1 ms on
    // average.
    let actual = sensor("readout_queue = { service = \"20 us\" }");
    let recorded = record(&actual, pulses);
    let nominal = error(&solve(&recorded, &stated).0, pulses);
    let (tracks, notes) = solve(&recorded, &actual);
    let fitted = error(&tracks, pulses);
    assert_eq!(notes, [""; 0]);
    println!("without the queue {clean:.5}, nominal {nominal:.5}, fitted {fitted:.5}");
    assert!(
        nominal > 2.0 * clean && fitted < 1.2 * clean,
        "without the queue {clean:.5}, nominal {nominal:.5}, fitted {fitted:.5}"
    );
}

#[test]
fn waits_are_given_back_to_the_microsecond() {
    let actual = sensor("readout_queue = { service = \"20 us\" }");
    let recorded = record(&actual, pulses);
    let mut model = Model::of_map(&SolveOptions::default(), &actual, &recorded.events.meta).unwrap();
    model.inform(&recorded.events).unwrap();
    let band = recorded.events.read(EXTENT.rows()).unwrap();
    let mut requests: Vec<(i64, u32, u32, i64)> = Vec::new();
    for y in EXTENT.rows().iter() {
        let row = band.row(y);
        for k in 0..row.len() {
            let x = u32::from(row.x[k]);
            let (event, undone) = model.event_undone(
                &Site { x, y, width: EXTENT.width, height: EXTENT.height, seed: 0 },
                &row,
                k,
            );
            assert_eq!(undone.t_in_ns, event.t_in_ns);
            requests.push((event.t_in_ns, y, x, undone.t_off_ns - event.t_off_ns));
        }
    }
    // Lindley's recursion, by itself.
    requests.sort_unstable();
    let (mut wait, mut before, mut most) = (0, i64::MIN / 2, 0);
    for (t_ns, _, _, found) in requests {
        wait = i64::max(0, wait + 20_000 - (t_ns - before));
        assert!((found - wait).abs() <= 1_000, "at {t_ns}: {found} instead of {wait}");
        (before, most) = (t_ns, i64::max(most, wait));
    }
    assert!(most > 1_000_000, "{most}: the test means nothing where nobody waits");
}

/// Rows of the inputs that a band is given.
fn given(
    node: &SolveMap,
    events: &EventStream,
    frames: &FrameSequence,
    description: &Arc<Sensor>,
    band: Rows,
) -> Rows {
    let metas = [
        ("events".to_string(), vec![Meta::Events(events.meta.clone())]),
        ("frames".to_string(), vec![Meta::Frames(frames.meta.clone())]),
        ("sensor".to_string(), vec![Meta::Sensor(description.clone())]),
    ];
    match node.grain(&PortMetas::new(metas.into())) {
        Grain::Row { halo } => band.with_halo(halo, frames.meta.extent.rows()),
        _ => frames.meta.extent.rows(),
    }
}

#[test]
fn neighbours_change_no_bit_with_bands_and_threads() {
    let extent = Extent { width: 3, height: 90 };
    let events = super::tests::walk(extent, 20_000_000);
    let frames = testing::captured(extent, super::tests::exposures(3), 30_000, |l, x, y| {
        (200 + (37 * l as u32 + 11 * x + 5 * y) % 90) as f32
    });
    let description =
        sensor("misalignment = { shift_x = 0.2, shift_y = 0.9 }\ncrosstalk = { fraction = 0.1 }");
    let node =
        SolveMap::build(SolveOptions { undo_rounds: Some(2), ..SolveOptions::default() }.into()).unwrap();
    let run = |rows: Rows, band: Rows| {
        let input = In { events: events.cut(rows), frames: frames.cut(rows), sensor: description.clone() };
        testing::with_context(band, &["tracks", "map"], |cx| node.run(input, cx))
            .0
            .map(|out| out.tracks.read(band).unwrap())
    };
    let whole = run(extent.rows(), extent.rows()).unwrap();
    let one_thread = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap()
        .install(|| run(extent.rows(), extent.rows()).unwrap());
    assert_eq!(whole, one_thread);
    for band in extent.rows().bands(20) {
        let rows = given(&node, &events, &frames, &description, band);
        assert!(rows.len() < 90 || band.start == 40, "{rows:?}: the test means nothing where all is at hand");
        assert_eq!(run(rows, band).unwrap(), whole.slice(band));
    }
    // As when a node worked the description out and the plan knew nothing of it.
    assert!(
        run(Rows { start: 0, end: 36 }, Rows { start: 0, end: 20 })
            .unwrap_err()
            .message
            .contains("cut into row bands")
    );
}

#[test]
fn a_queue_makes_the_recording_one_piece_and_says_so_when_it_is_too_late() {
    let description = sensor("readout_queue = { service = \"1 us\" }");
    let recorded = record(&description, pulses);
    let node = SolveMap::build(SolveOptions::default().into()).unwrap();
    let band = Rows { start: 0, end: 2 };
    assert_eq!(given(&node, &recorded.events, &recorded.frames, &description, band), EXTENT.rows());
    let input =
        In { events: recorded.events.cut(band), frames: recorded.frames.cut(band), sensor: description };
    let error = testing::with_context(band, &["tracks"], |cx| node.run(input, cx)).0.map(|_| ()).unwrap_err();
    assert_eq!(
        error.message,
        "`effects.readout_queue` couples all pixels, and that was not known when the \
                               recording was cut into row bands"
    );
}
