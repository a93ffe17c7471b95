//! Decoders against words made by hand after the published layouts, and the writer against the decoder.

use super::decoder::Decoder;
use super::evt3_writer::Writer;
use super::*;
use crate::chunk::{Edge, EventChunk, Trigger};
use photocurrent_core::Extent;
use proptest::prelude::*;

/// An event as a tuple: time in us, column, row, polarity.
type Event = (i64, u16, u16, u8);

fn events(chunk: &EventChunk) -> Vec<Event> {
    (0..chunk.len()).map(|n| (chunk.t[n] / 1000, chunk.x[n], chunk.y[n], chunk.on[n])).collect()
}

fn bytes3(words: &[u16]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

fn bytes2(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

fn bytes21(words: &[u64]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

fn decode3(words: &[u16]) -> (Vec<Event>, Vec<Trigger>, Faults) {
    let (mut out, mut triggers, mut decoder) = (EventChunk::default(), Vec::new(), Evt3Decoder::new());
    assert_eq!(decoder.decode(&bytes3(words), &mut out, &mut triggers), 2 * words.len());
    (events(&out), triggers, *decoder.faults())
}

fn decode2(words: &[u32]) -> (Vec<Event>, Vec<Trigger>, Faults) {
    let (mut out, mut triggers, mut decoder) = (EventChunk::default(), Vec::new(), Evt2Decoder::new());
    assert_eq!(decoder.decode(&bytes2(words), &mut out, &mut triggers), 4 * words.len());
    (events(&out), triggers, *decoder.faults())
}

#[test]
fn evt3_takes_row_time_and_polarity_from_the_words_before() {
    // High 1, low 5, row 20, ON at column 10, OFF at column 11; row 21, ON at column 3.
    let (events, triggers, faults) = decode3(&[0x8001, 0x6005, 20, 0x280A, 0x200B, 21, 0x2803]);
    assert_eq!(events, [(4101, 10, 20, 1), (4101, 11, 20, 0), (4101, 3, 21, 1)]);
    assert_eq!((triggers, faults), (vec![], Faults::default()));
}

#[test]
fn evt3_vectors_go_on_where_the_one_before_ended() {
    // Base 100 OFF; 12 columns with the first and the last set; 12 empty; 8 with bits 0, 1 and 7; the base
    // that was named holds no longer.
    let (events, ..) = decode3(&[0x8000, 0x6000, 7, 0x3064, 0x4801, 0x4000, 0x5083, 0x5001]);
    let columns: Vec<u16> = events.iter().map(|event| event.1).collect();
    assert_eq!(columns, [100, 111, 124, 125, 131, 132]);
    assert!(events.iter().all(|event| event.2 == 7 && event.3 == 0));
    // The upper half byte of a vector of eight is no part of it.
    assert_eq!(decode3(&[0x8000, 0x6000, 7, 0x3800, 0x5F01]).0, [(0, 0, 7, 1)]);
}

#[test]
fn evt3_time_goes_on_over_the_wrap_of_24_bits() {
    let (events, _, faults) =
        decode3(&[0x8FFF, 0x6FFF, 1, 0x2001, 0x8000, 0x6000, 0x2002, 0x8001, 0x6001, 0x2003]);
    let times: Vec<i64> = events.iter().map(|event| event.0).collect();
    assert_eq!(times, [16_777_215, 16_777_216, 16_777_216 + 4097]);
    assert_eq!(faults, Faults::default());
}

#[test]
fn evt3_time_words_that_repeat_or_step_back_are_no_wrap() {
    // Out of order at the wrap: high 4095, 0, 4095, 0.
    let words = [
        0x8FFF, 0x6001, 1, 0x2001, 0x8000, 0x6001, 0x2002, 0x8FFF, 0x6FFE, 0x2003, 0x8000, 0x6002, 0x2004,
        0x8000, 0x2005,
    ];
    let times: Vec<i64> = decode3(&words).0.iter().map(|event| event.0).collect();
    assert_eq!(
        times,
        [16_773_121, 16_777_217, 16_777_214, 16_777_218, 16_777_218],
        "a repeated time word leaves the lower bits"
    );
    // A step back of the lower bits is a stamp out of order, not a carry.
    let times: Vec<i64> = decode3(&[0x8001, 0x600B, 1, 0x2001, 0x6000, 0x2002, 0x8002, 0x2003])
        .0
        .iter()
        .map(|event| event.0)
        .collect();
    assert_eq!(times, [4107, 4096, 8192], "a new upper time word sets the lower bits to zero");
}

#[test]
fn evt3_counts_many_wraps() {
    // Each period in 16 steps; one event in each period.
    let mut words = vec![0x8000, 0x6000, 3];
    for period in 0..50_u16 {
        words.extend((0..16).map(|step| 0x8000 | step << 8));
        words.extend([0x6000 | period, 0x2000 | period]);
    }
    let expected: Vec<Event> =
        (0..50).map(|n| (i64::from(n) * 16_777_216 + 15 * 256 * 4096 + i64::from(n), n, 3, 0)).collect();
    assert_eq!(decode3(&words).0, expected);
}

#[test]
fn evt3_undoes_the_leap_of_one_damaged_time_word() {
    let (events, _, faults) = decode3(&[0x8010, 0x6000, 1, 0x2001, 0x8C00, 0x2002, 0x8011, 0x6000, 0x2003]);
    assert_eq!((events[0].0, events[2].0), (16 * 4096, 17 * 4096));
    assert_eq!(faults.strays, 1);
}

#[test]
fn evt3_leaves_out_what_comes_before_time_or_row_and_unknown_words() {
    // Before a time: one event, three of vectors, one edge. The row and the base that were named count.
    let (events, _, faults) = decode3(&[9, 0x2001, 0x3010, 0x4003, 0xA101, 0x5080, 0x8000, 0x2805, 0x4001]);
    assert_eq!(events, [(0, 5, 9, 1), (0, 16 + 12 + 8, 9, 0)]);
    assert_eq!(faults, Faults { early: 5, ..Faults::default() });
    // Without a row; kinds 9, 11 and 12, which do not exist; others, continued and inertial words, which
    // carry no events.
    let (events, _, faults) =
        decode3(&[0x8000, 0x2005, 0x9000, 0xB000, 0xC000, 0xE014, 0xF123, 0x7001, 0xD000, 0, 0x2006]);
    assert_eq!(events, [(0, 6, 0, 0)]);
    assert_eq!(faults, Faults { outside: 1, unknown: 3, ..Faults::default() });
}

#[test]
fn evt3_trigger_words_have_line_and_edge() {
    let (_, triggers, _) = decode3(&[0x8001, 0x6002, 0xA101, 0x6003, 0xA600]);
    assert_eq!(
        triggers,
        [
            Trigger { t: 4_098_000, line: 1, edge: Edge::Rising },
            Trigger { t: 4_099_000, line: 6, edge: Edge::Falling }
        ]
    );
}

#[test]
fn events_outside_the_extent_are_left_out_and_counted() {
    let extent = Some(Extent { width: 20, height: 10 });
    let mut out = EventChunk::default();
    let mut decoder = Evt3Decoder::new().with_extent(extent);
    // Columns 19 and 20 of row 9; a vector from 18 with all of 12; a row 10.
    decoder.decode(
        &bytes3(&[0x8000, 0x6000, 9, 0x2013, 0x2014, 0x3012, 0x4FFF, 10, 0x2001, 0x3000, 0x5001]),
        &mut out,
        &mut Vec::new(),
    );
    assert_eq!(events(&out), [(0, 19, 9, 0), (0, 18, 9, 0), (0, 19, 9, 0)]);
    assert_eq!(decoder.faults().outside, 13);
    let mut out = EventChunk::default();
    let mut decoder = Evt2Decoder::new().with_extent(extent);
    decoder.decode(
        &bytes2(&[0x8000_0000, 19 << 11 | 9, 20 << 11 | 9, 19 << 11 | 10]),
        &mut out,
        &mut Vec::new(),
    );
    assert_eq!((events(&out), decoder.faults().outside), (vec![(0, 19, 9, 0)], 2));
    let mut out = EventChunk::default();
    let mut decoder = DatDecoder::new(DatLayout::V2).with_extent(extent);
    decoder.decode(&bytes21(&[(9 << 14 | 19) << 32, (9 << 14 | 20) << 32, (10 << 14) << 32]), &mut out);
    assert_eq!((events(&out), decoder.faults().outside), (vec![(0, 19, 9, 0)], 2));
}

#[test]
fn evt2_words_have_time_column_row_and_polarity() {
    // An event before any time; high 2; ON with low 63 at 639, 479; OFF with low 1; a falling edge on line
    // 17; counters; an unknown kind.
    let words = [
        0x1000_0000,
        0x8000_0002,
        0x1000_0000 | 63 << 22 | 639 << 11 | 479,
        1 << 22 | 5 << 11 | 6,
        0xA000_0000 | 3 << 22 | 17 << 8,
        0xE000_0000,
        0x3000_0000,
    ];
    let (events, triggers, faults) = decode2(&words);
    assert_eq!(events, [(191, 639, 479, 1), (129, 5, 6, 0)]);
    assert_eq!(triggers, [Trigger { t: 131_000, line: 17, edge: Edge::Falling }]);
    assert_eq!(faults, Faults { early: 1, unknown: 1, ..Faults::default() });
}

#[test]
fn evt2_time_goes_on_over_the_wrap_of_28_bits() {
    let words = [0x8FFF_FFFF, 0, 0x8000_0000, 0, 0x8FFF_FFFF, 0, 0x8000_0001, 0];
    let times: Vec<i64> = decode2(&words).0.iter().map(|event| event.0).collect();
    let wrap = 1 << 34;
    assert_eq!(times, [wrap - 64, wrap, wrap - 64, wrap + 64]);
}

#[test]
fn evt21_words_hold_32_columns_in_either_order_of_halves() {
    let words = [
        0x8000_0001_u64 << 32,
        (0x1000_0000 | 2 << 22 | 32 << 11 | 7) << 32 | 0x8000_0005,
        (3 << 22 | 8) << 32 | 1,
        (0xA000_0001 | 1 << 8) << 32,
    ];
    let expected = [(66, 32, 7, 1), (66, 34, 7, 1), (66, 63, 7, 1), (67, 0, 8, 0)];
    for (legacy, words) in [(false, words), (true, words.map(|word| word.rotate_left(32)))] {
        let (mut out, mut triggers, mut decoder) =
            (EventChunk::default(), Vec::new(), Evt21Decoder::new().with_legacy(legacy));
        assert_eq!(decoder.decode(&bytes21(&words), &mut out, &mut triggers), 32);
        assert_eq!(events(&out), expected, "legacy: {legacy}");
        assert_eq!(triggers, [Trigger { t: 64_000, line: 1, edge: Edge::Rising }]);
    }
}

#[test]
fn dat_records_of_both_versions_and_the_wrap_of_32_bits() {
    let record = |t: u32, place: u64| place << 32 | u64::from(t);
    let mut out = EventChunk::default();
    let place = 1 << 28 | 479 << 14 | 639;
    DatDecoder::new(DatLayout::V2).decode(
        &bytes21(&[record(u32::MAX, place), record(0, 1), record(u32::MAX, 2), record(5, 3)]),
        &mut out,
    );
    let wrap = 1 << 32;
    assert_eq!(
        events(&out),
        [(wrap - 1, 639, 479, 1), (wrap, 1, 0, 0), (wrap - 1, 2, 0, 0), (wrap + 5, 3, 0, 0)]
    );
    let mut out = EventChunk::default();
    DatDecoder::new(DatLayout::V1).decode(&bytes21(&[record(7, 1 << 17 | 239 << 9 | 303)]), &mut out);
    assert_eq!(events(&out), [(7, 303, 239, 1)]);
}

/// The plainest possible reading of the published tables, one word at a time, for times that do not wrap.
fn plain_evt3(words: &[u16]) -> Vec<Event> {
    let (mut high, mut low, mut row, mut base, mut on, mut all) = (None, 0, None, 0, 0, Vec::new());
    for word in words {
        let value = word & 0xFFF;
        match (word >> 12, high, row) {
            (8, ..) => {
                low = if high == Some(value) { low } else { 0 };
                high = Some(value);
            }
            (6, Some(_), _) => low = value,
            (0, ..) => row = Some(value & 0x7FF),
            (3, ..) => (base, on) = (value & 0x7FF, (value >> 11) as u8),
            (2, Some(high), Some(row)) => {
                all.push((i64::from(high) * 4096 + i64::from(low), value & 0x7FF, row, (value >> 11) as u8))
            }
            (4 | 5, ..) => {
                let columns = if word >> 12 == 4 { 12 } else { 8 };
                if let (Some(high), Some(row)) = (high, row) {
                    let set = (0..columns).filter(|bit| value >> bit & 1 == 1 && base + bit < 2048);
                    all.extend(set.map(|bit| (i64::from(high) * 4096 + i64::from(low), base + bit, row, on)));
                }
                base = (base + columns).min(1 << 15);
            }
            _ => {}
        }
    }
    all
}

fn tuples() -> impl Strategy<Value = Vec<(i64, u16, u16, bool)>> {
    // Steps of time of all sizes, zero the most frequent, and columns near each other: vectors, repeats, gaps
    // over several wraps.
    let step = prop_oneof![4 => Just(0_i64), 4 => 1..200_i64, 1 => 1..40_000_000_i64];
    proptest::collection::vec((step, 0..40_u16, 0..4_u16, any::<bool>()), 0..300)
}

proptest! {
    #[test]
    fn evt3_decodes_as_the_tables_say_whatever_the_words(
        kinds in proptest::collection::vec((0..16_u16, 0..0x1000_u16), 0..2000),
    ) {
        // Upper time words rise slowly, so that no wrap is in doubt.
        let words: Vec<u16> = kinds.iter().enumerate().map(|(n, &(kind, value))| match kind {
            8 => 0x8000 | (n as u16 / 8),
            1 => 0xE000,
            kind => kind << 12 | value,
        }).collect();
        prop_assert_eq!(decode3(&words).0, plain_evt3(&words));
    }

    #[test]
    fn random_bytes_give_bounded_output_the_same_in_any_pieces(
        bytes in proptest::collection::vec(any::<u8>(), 0..6000),
        cut in 0..6000_usize,
    ) {
        fn check<D: Decoder>(decoder: D, bytes: &[u8], cut: usize, most: usize) {
            let (mut whole, mut parts) = (
                (EventChunk::default(), Vec::new(), decoder.clone()),
                (EventChunk::default(), Vec::new(), decoder),
            );
            let used = whole.2.decode(bytes, &mut whole.0, &mut whole.1);
            assert_eq!(used, bytes.len() / D::WORD * D::WORD);
            assert!(whole.0.len() <= used / D::WORD * most);
            let lengths = [whole.0.x.len(), whole.0.y.len(), whole.0.on.len()];
            assert!(lengths.iter().all(|length| *length == whole.0.len()));
            let first = parts.2.decode(&bytes[..cut.min(bytes.len())], &mut parts.0, &mut parts.1);
            parts.2.decode(&bytes[first..], &mut parts.0, &mut parts.1);
            assert_eq!((&whole.0, &whole.1, whole.2.faults()), (&parts.0, &parts.1, parts.2.faults()));
        }
        check(Evt3Decoder::new(), &bytes, cut, 12);
        check(Evt2Decoder::new(), &bytes, cut, 1);
        check(Evt21Decoder::new(), &bytes, cut, 32);
        check(Evt21Decoder::new().with_legacy(true), &bytes, cut, 32);
        check(DatDecoder::new(DatLayout::V2), &bytes, cut, 1);
    }

    #[test]
    fn any_bytes_are_a_header_or_none(bytes in proptest::collection::vec(any::<u8>(), 0..300),
                                         text in "(% (evt|format|geometry|system_ID|Version|endianness) \
                                                  [0-9a-zEVT.=;x -]{0,30}\n){0,4}") {
        let Some(header) = Header::parse(&[text.as_bytes(), &bytes].concat()) else {
            prop_assert!(text.is_empty());
            return Ok(());
        };
        prop_assert!(header.data_at >= text.len() && header.data_at <= text.len() + bytes.len());
        let extent = header.extent().map_or(1, |(extent, _)| extent.width.max(extent.height));
        prop_assert!((1..=1 << 14).contains(&extent));
        let _ = (header.encoding(), header.is_legacy(), header.facts(), dat_layout(&header, &bytes));
    }

    #[test]
    fn what_the_writer_writes_is_read_back(steps in tuples(), begin in 0..100_000_000_i64) {
        let (mut chunk, mut us) = (EventChunk::default(), begin);
        for (step, x, y, on) in steps {
            us += step;
            chunk.push(us * 1000 + 999, x, y, on);
        }
        let mut writer = Writer::new(
            Vec::new(), Extent { width: 40, height: 4 }, &[("serial_number", "12")],
        ).expect("a header");
        writer.write(&chunk).expect("events in order");
        let shift = writer.shift_ns();
        let file = writer.finish().expect("a file");
        let header = Header::parse(&file).expect("a header");
        let expected = (Some(Encoding::Evt3), Some((Extent { width: 40, height: 4 }, None)), Some("12"));
        prop_assert_eq!((header.encoding(), header.extent(), header.get("serial_number")), expected);
        let (mut read, mut decoder) = (EventChunk::default(), Evt3Decoder::new());
        decoder.decode(&file[header.data_at..], &mut read, &mut Vec::new());
        chunk.t.iter_mut().for_each(|t| *t = *t - 999 - shift);
        prop_assert_eq!(read, chunk);
        prop_assert_eq!(*decoder.faults(), Faults::default());
    }
}

#[test]
fn the_writer_makes_vectors_and_triggers_after_the_tables() {
    let mut writer = Writer::new(Vec::new(), Extent { width: 64, height: 8 }, &[]).expect("a header");
    let begin = "% evt 3.0\n% format EVT3;height=8;width=64\n% geometry 64x8\n% end\n".len();
    let mut chunk = EventChunk::default();
    for x in [10, 12, 17] {
        chunk.push(5_000, x, 3, true);
    }
    chunk.push(4_096_000, 1, 3, false);
    writer.write(&chunk).expect("events in order");
    writer.write_trigger(&Trigger { t: 4_097_000, line: 2, edge: Edge::Rising }).expect("a trigger");
    let file = writer.finish().expect("a file");
    assert_eq!(
        file[begin..],
        bytes3(&[0x8000, 0x6005, 0x0003, 0x380A, 0x5085, 0x8001, 0x6000, 0x2001, 0x6001, 0xA201])
    );
}

#[test]
fn the_writer_refuses_disorder_and_places_outside() {
    let extent = Extent { width: 10, height: 10 };
    let one = |t: i64, x: u16| EventChunk { t: vec![t], x: vec![x], y: vec![0], on: vec![1], t_in: None };
    let mut writer = Writer::new(Vec::new(), extent, &[]).expect("a header");
    writer.write(&one(5_000, 0)).expect("the first");
    assert!(writer.write(&one(4_000, 0)).expect_err("earlier").to_string().contains("sort by time"));
    assert!(writer.write(&one(6_000, 10)).expect_err("outside").to_string().contains("column 10"));
    assert!(writer.write(&one(i64::MAX, 0)).is_err());
    assert!(Writer::new(Vec::new(), Extent { width: 4096, height: 1 }, &[]).is_err());
    assert!(Writer::new(Vec::new(), extent, &[("a", "b\n% end")]).is_err());
}
