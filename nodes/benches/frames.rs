//! How fast frames come out: rendering from tracks, and the double integral, per row of pixels.
//!
//! `cargo bench -p photocurrent-nodes`. Items are pixels times frames. One row of 346 pixels, 160 frames over
//! 160 ms, as many events a pixel as the argument says.

use divan::Bencher;
use divan::counter::ItemsCount;
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::quantity::Rate;
use photocurrent_core::random::Random;
use photocurrent_core::{
    Between, Colour, EventStream, Exposure, Extent, FrameSequence, Node, Sensor, TimeSpan, TrackBand,
    TrackSet, TracksMeta, testing,
};
use photocurrent_nodes::baseline::edi::{self, BaselineEdi};
use photocurrent_nodes::render::rows::{self, RenderRows};
use photocurrent_nodes::sampling::Sampling;
use std::sync::Arc;

const EXTENT: Extent = Extent { width: 346, height: 1 };
const LENGTH_NS: i64 = 160_000_000;
const FRAMES: usize = 160;

fn main() {
    divan::main();
}

fn sensor() -> Arc<Sensor> {
    let mut sensor = Sensor::unknown("bench");
    sensor.comparator.threshold_on = Some(0.2);
    sensor.comparator.threshold_off = Some(0.2);
    sensor.frames.gain = Some(1000.0);
    Arc::new(sensor)
}

fn sampling() -> Sampling {
    Sampling { rate: Rate::new(1000.0), ..Sampling::default() }
}

fn instants(x: u32, count: usize) -> Vec<i64> {
    let mut random = Random::new(1, &[x.into()]);
    let mut t: Vec<i64> = (0..count).map(|_| (random.uniform() * LENGTH_NS as f64) as i64).collect();
    t.sort_unstable();
    t
}

fn tracks(events: usize) -> TrackSet {
    let mut band = TrackBand::begin(0, EXTENT.width);
    for x in 0..EXTENT.width {
        let mut random = Random::new(2, &[x.into()]);
        band.push(std::iter::once(0).chain(instants(x, events)).map(|t| (t, random.uniform() as f32)));
    }
    let meta = TracksMeta {
        extent: EXTENT,
        span: TimeSpan::new(0, LENGTH_NS),
        nominal_exposure_ns: 4_000_000,
        between: Between::Hold,
        colour: Colour::Mono,
        has_sigma: false,
        count_hint: None,
    };
    TrackSet::in_memory(Arc::new(meta), band)
}

fn recording(events: usize) -> (EventStream, FrameSequence) {
    let mut all = Vec::new();
    for x in 0..EXTENT.width {
        let mut random = Random::new(3, &[x.into()]);
        all.extend(instants(x, events).into_iter().map(|t| Event {
            x: x as u16,
            y: 0,
            polarity: Polarity::from_bit((random.bits() & 1) as u8),
            t,
            t_in: None,
        }));
    }
    let exposures = (0..19).map(|l| Exposure::new(l * 8_333_333, l * 8_333_333 + 6_500_000)).collect();
    (testing::stream(EXTENT, all), testing::captured(EXTENT, exposures, 0, |_, x, _| 100.0 + x as f32))
}

#[divan::bench(args = [4, 20, 100])]
fn render(bencher: Bencher, events: usize) {
    let node = RenderRows::build(rows::Params { sampling: sampling(), ..rows::Params::default() })
        .expect("parameters go together");
    let (tracks, sensor) = (tracks(events), sensor());
    bencher.counter(ItemsCount::new(EXTENT.pixels() * FRAMES)).bench_local(|| {
        let input = rows::In { tracks: tracks.clone(), sensor: sensor.clone(), at: None };
        testing::with_context(EXTENT.rows(), &["frames"], |cx| node.run(input, cx)).0.expect("renders")
    });
}

#[divan::bench(args = [4, 20, 100])]
fn double_integral(bencher: Bencher, events: usize) {
    let node = BaselineEdi::build(edi::Params { sampling: sampling(), ..edi::Params::default() })
        .expect("parameters go together");
    let ((events, frames), sensor) = (recording(events), sensor());
    bencher.counter(ItemsCount::new(EXTENT.pixels() * FRAMES)).bench_local(|| {
        let input = edi::In {
            events: events.clone(),
            frames: frames.clone(),
            sensor: Some(sensor.clone()),
            contrast: None,
            at: None,
        };
        testing::with_context(EXTENT.rows(), &["frames"], |cx| node.run(input, cx)).0.expect("reconstructs")
    });
}
