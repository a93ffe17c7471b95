//! Frames and their standard deviations by a card against those of the processor.

use crate::backend::Backend;
use crate::backend::testing::has_card;
use crate::crop::Crop;
use crate::render::rows::{In, Params, Reading, RenderRows};
use crate::sampling::{Sampling, Shutter};
use photocurrent_core::quantity::{Duration, Rate};
use photocurrent_core::random::Random;
use photocurrent_core::{
    Between, Colour, Exposure, Extent, FrameSequence, Node, Rows, Sensor, TimeSpan, TrackBand, TrackSet,
    TracksMeta, testing,
};
use std::sync::Arc;

const EXTENT: Extent = Extent { width: 24, height: 10 };

/// Light that moves by a tenth or so from knot to knot, three knots a millisecond, for 20 ms; one pixel
/// in ten is unknown.
fn tracks(between: Between, colour: Colour) -> TrackSet {
    let series = EXTENT.width * colour.channels();
    let (mut band, mut random) = (TrackBand::begin(0, series), Random::new(5, &[]));
    for pixel in 0..series * EXTENT.height {
        let (mut t, mut log) = (-300_000, 1.0 + random.normal());
        let mut knots = Vec::new();
        for _ in 0..60 {
            t += 1 + (random.uniform() * 700_000.0) as i64;
            log += 0.1 * random.normal();
            knots.push((t, libm::exp(log) as f32, libm::exp(-4.0 + 0.3 * random.normal()) as f32));
        }
        band.push_with_sigma(knots.into_iter().filter(|_| pixel % 10 != 3));
    }
    let meta = TracksMeta {
        extent: EXTENT,
        span: TimeSpan::new(0, 20_000_000),
        nominal_exposure_ns: 4_000_000,
        between,
        colour,
        has_sigma: true,
        count_hint: None,
    };
    TrackSet::in_memory(Arc::new(meta), band)
}

fn sensor() -> Arc<Sensor> {
    let mut sensor = Sensor::unknown("test");
    sensor.frames.gain = Some(1000.0);
    sensor.frames.black_level_dn = Some(10.0);
    sensor.frames.row_time = Some(Duration::new(70_000));
    sensor.frames.channel_gain = Some([0.5, 1.0, 2.0]);
    Arc::new(sensor)
}

/// Frames, their standard deviations and what was noted.
type Rendered = (FrameSequence, FrameSequence, Vec<String>);

fn render(backend: Backend, params: &Params, input: &In, rows: Rows) -> Rendered {
    let node = RenderRows::build(Params { backend, ..params.clone() }).unwrap();
    let In { tracks, sensor, at } = input;
    let input = In { tracks: tracks.clone(), sensor: sensor.clone(), at: at.clone() };
    let (out, notes) = testing::with_context(rows, &["frames", "sigma"], |cx| node.run(input, cx));
    let out = out.unwrap();
    (out.frames, out.sigma.unwrap(), notes)
}

fn values(frames: &FrameSequence) -> Vec<f32> {
    frames.read_rows(frames.rows()).unwrap().dn
}

/// The largest difference of a value from the processor's, over that one.
fn apart(on_card: &FrameSequence, here: &FrameSequence) -> f32 {
    assert_eq!(on_card.meta, here.meta);
    let pairs: Vec<(f32, f32)> = values(on_card).into_iter().zip(values(here)).collect();
    assert!(pairs.iter().all(|(a, b)| a.is_nan() == b.is_nan()), "what is unknown is the same");
    let known = pairs.iter().filter(|(_, here)| !here.is_nan());
    known.map(|(on_card, here)| ((on_card - here) / here).abs()).fold(0.0, f32::max)
}

#[test]
fn pictures_are_those_of_the_processor() {
    if !has_card() {
        return;
    }
    let steady = Sampling { rate: Rate::new(5_000.0), ..Sampling::default() };
    let rolling = Sampling { shutter: Shutter::Rolling, exposure: Duration::new(900_000), ..steady.clone() };
    let roi = Some(Crop { x: 4, y: 2, width: 13, height: 6 });
    let whole = EXTENT.rows();
    let part = Rows { start: 1, end: 6 };
    let bayer = Colour::named("bayer_rggb").unwrap();
    let cases = [
        (Between::LogLinear, Colour::Mono, Params { sampling: steady.clone(), ..Params::default() }, whole),
        (Between::LogLinear, Colour::Rgb, Params { sampling: rolling, roi, ..Params::default() }, part),
        (
            Between::Hold,
            bayer,
            Params { sampling: steady.clone(), between: Reading::Linear, ..Params::default() },
            whole,
        ),
        (Between::Hold, Colour::Mono, Params { sampling: steady, roi, ..Params::default() }, part),
    ];
    for (between, colour, params, rows) in cases {
        let input = In { tracks: tracks(between, colour), sensor: sensor(), at: None };
        let (here, sigma_here, _) = render(Backend::Cpu, &params, &input, rows);
        let (frames, sigma, notes) = render(Backend::Gpu, &params, &input, rows);
        let (of_light, of_sigma) = (apart(&frames, &here), apart(&sigma, &sigma_here));
        // 0.01 dB are a thousandth; a standard deviation may be rounded to the next number of 16 bits.
        assert!(of_light < 1e-5 && of_sigma < 0.01, "{between:?}, {colour}: {of_light} and {of_sigma}");
        assert!(notes.len() == 1 && notes[0].starts_with("rendered on "), "{notes:?}");
    }
}

#[test]
fn what_the_card_does_not_take_is_rendered_here_and_counted() {
    if !has_card() {
        return;
    }
    let exposures = vec![Exposure::new(0, 4_000_000), Exposure::new(9_000_000, 13_000_000)];
    let at = Some(testing::captured(EXTENT, exposures, 10_000, |_, _, _| 0.0));
    let mut with_effects = (*sensor()).clone();
    let text = "format = \"photocurrent-sensor/1\"\n[effects.frame_nonlinearity]\n\
                fraction = 0.05\nfull_scale_dn = 4000.0\n";
    let source = photocurrent_core::document::Source::new("s.toml", "", text);
    with_effects.effects = Sensor::parse(&source).unwrap().effects;
    let tracks = tracks(Between::LogLinear, Colour::Mono);
    let input = In { tracks, sensor: Arc::new(with_effects), at };
    let rows = EXTENT.rows();
    let (here, _, _) = render(Backend::Cpu, &Params::default(), &input, rows);
    let (frames, _, notes) = render(Backend::Gpu, &Params::default(), &input, rows);
    let bits = |frames: &FrameSequence| values(frames).iter().map(|dn| dn.to_bits()).collect::<Vec<u32>>();
    assert_eq!(bits(&frames), bits(&here));
    assert!(notes.iter().any(|note| note.starts_with("10 rows were rendered on the processor: effects")));
    // Numbers that are not finite.
    let mut band = input.tracks.read(rows).unwrap();
    let knot = band.offsets()[5 * EXTENT.width as usize];
    band.photocurrent[knot] = f32::INFINITY;
    let tracks = TrackSet::in_memory(input.tracks.meta.clone(), band);
    let input = In { tracks, sensor: sensor(), at: None };
    let (here, _, _) = render(Backend::Cpu, &Params::default(), &input, rows);
    let (frames, _, notes) = render(Backend::Gpu, &Params::default(), &input, rows);
    let row = Rows { start: 5, end: 6 };
    let (ours, theirs) = (frames.read_rows(row).unwrap().dn, here.read_rows(row).unwrap().dn);
    assert!(ours.iter().zip(&theirs).all(|(a, b)| a.to_bits() == b.to_bits()));
    assert!(notes.iter().any(|note| note.starts_with("1 rows were rendered on the processor")), "{notes:?}");
}
