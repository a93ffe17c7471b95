//! Time to decode events of each format, from bytes in memory.
//!
//! Run with `cargo bench -p photocurrent-formats --bench decode`. The words are made up: a million events of
//! a moving edge, sorted by time, about ten in each microsecond and row; EVT3 has a vector for every third
//! group. `benches/peers.py` compares whole files with other programs.

use divan::Bencher;
use divan::counter::ItemsCount;
use photocurrent_core::Extent;
use photocurrent_formats::EventChunk;
use photocurrent_formats::evt::evt3_writer::Writer;
use photocurrent_formats::evt::{DatDecoder, DatLayout, Evt2Decoder, Evt3Decoder, Evt21Decoder};

const EVENTS: usize = 1 << 20;
const EXTENT: Extent = Extent { width: 1280, height: 720 };

fn main() {
    divan::main();
}

/// Events in order of time: some in a row side by side, then another row.
fn events() -> EventChunk {
    let mut chunk = EventChunk::default();
    let mut state = 1_u64;
    let mut next = |below: u64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % below
    };
    let mut us = 0;
    while chunk.len() < EVENTS {
        us += i64::from(next(4) == 0);
        let (x, y, step) = (next(1200) as u16, next(720) as u16, if next(3) == 0 { 1 } else { 15 });
        let on = next(2) == 0;
        (0..=next(5) as u16).for_each(|n| chunk.push(us * 1000, x + n * step, y, on));
    }
    chunk
}

fn evt3() -> Vec<u8> {
    let mut writer = Writer::new(Vec::new(), EXTENT, &[]).expect("a header");
    writer.write(&events()).expect("events in order");
    let file = writer.finish().expect("a file");
    let header = file.windows(6).position(|six| six == b"% end\n").expect("an end") + 6;
    file[header..].to_vec()
}

fn evt2() -> Vec<u8> {
    let mut words: Vec<u32> = Vec::new();
    let (events, mut high) = (events(), u32::MAX);
    for n in 0..events.len() {
        let us = (events.t[n] / 1000) as u32;
        if us >> 6 != high {
            high = us >> 6;
            words.push(0x8000_0000 | high);
        }
        words.push(
            u32::from(events.on[n]) << 28
                | (us & 63) << 22
                | u32::from(events.x[n]) << 11
                | u32::from(events.y[n]),
        );
    }
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

fn evt21() -> Vec<u8> {
    // Each event of EVT2 with a mask of three columns.
    let words = evt2()
        .as_chunks::<4>()
        .0
        .iter()
        .map(|word| u64::from(u32::from_le_bytes(*word)) << 32 | 0b1011)
        .collect::<Vec<u64>>();
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

fn dat() -> Vec<u8> {
    let events = events();
    let record = |n: usize| {
        (events.t[n] / 1000) as u64
            | (u64::from(events.on[n]) << 28 | u64::from(events.y[n]) << 14 | u64::from(events.x[n])) << 32
    };
    (0..events.len()).flat_map(|n| record(n).to_le_bytes()).collect()
}

/// Decodes all bytes in pieces, as a reader of files does.
fn run(bencher: Bencher, bytes: &[u8], mut decode: impl FnMut(&[u8], &mut EventChunk)) {
    let mut chunk = EventChunk::default();
    decode(bytes, &mut chunk);
    let count = chunk.len();
    bencher.counter(ItemsCount::new(count)).bench_local(|| {
        for piece in bytes.chunks(1 << 17) {
            chunk.clear();
            decode(piece, &mut chunk);
            divan::black_box(&chunk);
        }
    });
}

#[divan::bench]
fn evt3_events(bencher: Bencher) {
    let mut decoder = Evt3Decoder::new().with_extent(Some(EXTENT));
    run(bencher, &evt3(), |bytes, chunk| _ = decoder.decode(bytes, chunk, &mut Vec::new()));
}

#[divan::bench]
fn evt2_events(bencher: Bencher) {
    let mut decoder = Evt2Decoder::new().with_extent(Some(EXTENT));
    run(bencher, &evt2(), |bytes, chunk| _ = decoder.decode(bytes, chunk, &mut Vec::new()));
}

#[divan::bench]
fn evt21_events(bencher: Bencher) {
    let mut decoder = Evt21Decoder::new();
    run(bencher, &evt21(), |bytes, chunk| _ = decoder.decode(bytes, chunk, &mut Vec::new()));
}

#[divan::bench]
fn dat_events(bencher: Bencher) {
    let mut decoder = DatDecoder::new(DatLayout::V2).with_extent(Some(EXTENT));
    run(bencher, &dat(), |bytes, chunk| _ = decoder.decode(bytes, chunk));
}
