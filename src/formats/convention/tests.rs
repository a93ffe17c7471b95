//! Files with unusual conventions, written here, read as what they mean: numpy arrays, text and HDF5 alike.

use crate::catalog::named;
use crate::csv::Csv;
use crate::declared::{Counter, Declared, Polarity, TimeUnit};
use crate::error::{Cause, FormatError};
use crate::npy::tests::{npy, stored};
use crate::npz::Npz;
use crate::recording::Convention;
use crate::recording::{EventCursor, Recording};
use crate::text::tests::{collect, drain};
use crate::{EventChunk, Loss};
use photocurrent_core::Extent;
use std::path::PathBuf;

/// An event as it is stored.
type Stored = (u32, u16, u16, i64);

const SIZE: Extent = Extent { width: 20, height: 10 };

fn us() -> Declared {
    Declared { time_unit: Some(TimeUnit::Us), ..Declared::default() }
}

/// Numpy arrays t u32, x u16, y u16 and p of `bits`, without a sign where it is not negative.
fn npz(events: &[Stored], code: &str) -> (tempfile::TempDir, PathBuf) {
    let column =
        |code: &str, bytes: Vec<u8>| npy(&format!("'{code}'"), &format!("({},)", events.len()), &bytes);
    let size: usize = code[2..].parse().unwrap();
    let p = events.iter().flat_map(|event| event.3.to_le_bytes()[..size].to_vec()).collect();
    let file = stored(&[
        ("t.npy", column("<u4", events.iter().flat_map(|event| event.0.to_le_bytes()).collect())),
        ("x.npy", column("<u2", events.iter().flat_map(|event| event.1.to_le_bytes()).collect())),
        ("y.npy", column("<u2", events.iter().flat_map(|event| event.2.to_le_bytes()).collect())),
        ("p.npy", column(code, p)),
    ]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("events.npz");
    std::fs::write(&path, file).unwrap();
    (folder, path)
}

struct Read {
    events: EventChunk,
    losses: Vec<Loss>,
    notes: Vec<String>,
    found: Vec<Convention>,
}

fn read(recording: &dyn Recording) -> Read {
    let notes = recording.events_about().unwrap().notes.clone();
    let (events, losses) = collect(recording);
    Read { events, losses, notes, found: recording.conventions() }
}

/// Reads the same events as numpy arrays and as text, and compares.
fn both(events: &[Stored], code: &str, declared: &Declared) -> Result<Read, FormatError> {
    let (_folder, path) = npz(events, code);
    let arrays = Npz::open(&path, declared)?;
    arrays.events()?;
    let arrays = read(&arrays);
    let text: String = events.iter().map(|(t, x, y, p)| format!("{t} {x} {y} {p}\n")).collect();
    let path = path.with_extension("txt");
    std::fs::write(&path, format!("# t_us x y p\n{text}")).unwrap();
    let lines = read(&Csv::open(&path, declared)?);
    assert_eq!((&arrays.events, &arrays.found), (&lines.events, &lines.found), "arrays and text agree");
    Ok(arrays)
}

fn ids(read: &Read) -> Vec<&str> {
    read.found.iter().map(|convention| convention.id).collect()
}

/// Events over the whole array, one every 10 us, with these polarities in turn.
fn events(count: u32, polarities: &[i64]) -> Vec<Stored> {
    (0..count)
        .map(|k| {
            (
                k * 10,
                (k % SIZE.width) as u16,
                (k / 7 % SIZE.height) as u16,
                polarities[k as usize % polarities.len()],
            )
        })
        .collect()
}

#[test]
fn ordinary_events_have_no_convention_and_no_note() {
    for (polarities, code) in [(&[0, 1][..], "|u1"), (&[-1, 1], "|i1"), (&[1], "|u1"), (&[-1, 0, 1], "<i4")] {
        let found = both(&events(300, polarities), code, &us()).unwrap();
        assert_eq!((ids(&found), found.notes.len(), found.losses.len()), (vec![], 0, 0), "{polarities:?}");
        assert_eq!(found.events.on[..3], [0, 1, 2].map(|k| u8::from(polarities[k % polarities.len()] == 1)));
    }
}

/// better-flow/evimo#20: "the event's polarity is not -1 and 1, but a bunch of 0, 1, 2, 3".
#[test]
fn counts_are_read_as_on_above_zero_and_said_once() {
    let found = both(&events(600, &[0, 1, 2, 0, 3, 5, 4, 0]), "|u1", &us()).unwrap();
    assert_eq!(found.events.on[..8], [0, 1, 1, 0, 1, 1, 1, 0]);
    assert_eq!((found.events.len(), found.losses.len()), (600, 0));
    assert_eq!(found.notes, ["polarity holds counts 0 to 5: every value above 0 was read as ON"]);
    assert_eq!(
        (ids(&found), found.found[0].evidence.as_str()),
        (vec!["polarity_counts"], "events by value: 0: 225, 1: 75, 2: 75, 3: 75, 4: 75, 5: 75")
    );
    // sunsean21/Event-Aware-Video-Deraining#1: polarities of a simulator are summed, both signs.
    let signed = both(&events(600, &[-2, 1, 2, -1, -3, 3]), "|i1", &us()).unwrap();
    assert_eq!((&signed.events.on[..6], signed.losses.len()), (&[0, 1, 1, 0, 0, 1][..], 0));
}

#[test]
fn what_only_the_end_of_a_file_shows_decides_for_all_of_it() {
    let mut all = events(200_000, &[1]);
    all[190_000..].iter_mut().for_each(|event| event.3 = 2);
    let found = both(&all, "|u1", &us()).unwrap();
    assert_eq!((ids(&found), found.events.on[0], found.events.on[199_999]), (vec!["polarity_one_two"], 0, 1));
}

/// `Read_Ndataset.m` of N-MNIST adds 1 to polarity ("1 means off, 2 means on") and to coordinates ("first
/// pixel having index 1").
#[test]
fn arrays_of_matlab_count_polarity_and_coordinates_from_one() {
    let all: Vec<Stored> =
        events(600, &[1, 2]).into_iter().map(|(t, x, y, p)| (t, x + 1, y + 1, p)).collect();
    let found = both(&all, "|u1", &Declared { extent: Some(SIZE), ..us() }).unwrap();
    assert_eq!(ids(&found), ["polarity_one_two", "origin_one"]);
    assert_eq!(
        found.notes,
        ["polarity is 1 or 2: 1 was read as OFF, 2 as ON", "coordinates begin at 1: 1 was subtracted"]
    );
    let right = both(&events(600, &[0, 1]), "|u1", &us()).unwrap();
    assert_eq!((found.events, found.losses.len()), (right.events, 0));
    // Without a size nothing is certain, and nothing is changed.
    let unknown = both(&all, "|u1", &us()).unwrap();
    assert_eq!((ids(&unknown), unknown.events.x.iter().max()), (vec!["polarity_one_two"], Some(&20)));
    let stated = both(&all, "|u1", &Declared { origin: Some(1), ..us() }).unwrap();
    assert_eq!(
        (ids(&stated), stated.events.x.iter().max()),
        (vec!["polarity_one_two", "origin_one"], Some(&19))
    );
    // Said otherwise, what lies outside is left out.
    let kept = both(&all, "|u1", &Declared { origin: Some(0), extent: Some(SIZE), ..us() }).unwrap();
    assert!(
        kept.losses.len() > 20 && kept.losses.iter().all(|loss| loss.cause == Cause::Outside),
        "{:?}",
        kept.losses
    );
}

#[test]
fn a_few_events_outside_do_not_move_the_origin() {
    // Column 0 and row 0 are empty, and one damaged event lies a column outside.
    let mut all: Vec<Stored> =
        events(6000, &[0, 1]).into_iter().map(|(t, x, y, p)| (t, x.clamp(1, 19), y.clamp(1, 9), p)).collect();
    all[100].1 = 20;
    let found = both(&all, "|u1", &Declared { extent: Some(SIZE), ..us() }).unwrap();
    assert_eq!((ids(&found), found.events.len(), found.losses[0].cause), (vec![], 5999, Cause::Outside));
}

#[test]
fn minus_one_without_a_sign_is_off_and_two_values_are_a_sign() {
    for (code, minus) in [("|u1", 0xff), ("<u2", 0xffff), ("<u4", 0xffff_ffff)] {
        let found = both(&events(300, &[1, minus]), code, &us()).unwrap();
        assert_eq!((ids(&found), &found.events.on[..2]), (vec!["polarity_unsigned"], &[1, 0][..]), "{code}");
    }
    let found = both(&events(300, &[0, 255]), "|u1", &us()).unwrap();
    assert_eq!((ids(&found), &found.events.on[..2]), (vec!["polarity_two_values"], &[0, 1][..]));
}

#[test]
fn what_no_convention_explains_is_refused_by_its_option_or_left_out() {
    let error = both(&events(300, &[0, 1, 7, 9]), "|u1", &us()).err().unwrap();
    assert_eq!(error.undeclared, Some("polarity"));
    assert_eq!(
        error.found,
        "polarity takes the values 0, 1, 7, 9; 50 % of the events have others than 0, 1 and -1"
    );
    // Stated, it is read.
    let counts =
        both(&events(300, &[0, 1, 7, 9]), "|u1", &Declared { polarity: Some(Polarity::Counts), ..us() })
            .unwrap();
    assert_eq!(counts.events.on[..4], [0, 1, 1, 1]);
    let signs =
        both(&events(300, &[0, 1, 7, 9]), "|u1", &Declared { polarity: Some(Polarity::Signs), ..us() })
            .unwrap();
    assert_eq!(
        (signs.events.len(), signs.losses.iter().map(Loss::places).sum::<u64>()),
        (150, 150),
        "every place is counted once"
    );
    assert!(signs.losses.iter().all(|loss| loss.cause == Cause::Polarity));
    // A few of many are damage.
    let mut few = events(1000, &[0, 1]);
    (few[17].3, few[500].3) = (7, 113);
    let found = both(&few, "|u1", &us()).unwrap();
    assert_eq!((ids(&found), found.events.len(), found.losses.len()), (vec![], 998, 2));
    // One damaged event among ON events turns none of them round.
    let mut ones = events(5000, &[1]);
    ones[99].3 = 2;
    let found = both(&ones, "|u1", &us()).unwrap();
    assert_eq!(
        (ids(&found), found.events.on.iter().all(|on| *on == 1), found.events.len()),
        (vec![], true, 4999)
    );
}

/// neuromorphicsystems/neuromorphic-drivers#1: stamps begin again after 24 bits of microseconds.
#[test]
fn a_counter_that_begins_again_is_followed_and_late_events_belong_before() {
    let right: Vec<i64> = (0..4000).map(|k| (16_000_000 + k * 10_007) * 1000).collect();
    let mut all: Vec<Stored> = events(4000, &[0, 1]);
    for (event, t) in all.iter_mut().zip(&right) {
        event.0 = (t / 1000 % (1 << 24)) as u32;
    }
    // An event from before the first turn comes after it.
    let turn = all.windows(2).position(|pair| pair[1].0 < pair[0].0).unwrap();
    all.swap(turn, turn + 1);
    let found = both(&all, "|u1", &us()).unwrap();
    assert_eq!(
        found.notes,
        ["the stamps' counter of 24 bits of microseconds started again 3 times; its range was added"]
    );
    let mut stamps = found.events.t.clone();
    assert_eq!((stamps[turn], stamps[turn + 1]), (right[turn + 1], right[turn]));
    stamps.sort_unstable();
    assert_eq!(stamps, right);
    let kept = both(&all, "|u1", &Declared { counter: Some(Counter::None), ..us() }).unwrap();
    assert_eq!((ids(&kept), kept.events.t.iter().max() < Some(&16_777_216_000)), (vec![], true));
}

#[test]
fn every_counter_is_recognised_and_a_seek_begins_before_all_turns() {
    for (counter, range) in [(Counter::Us31, 1_i64 << 31), (Counter::Us32, 1 << 32), (Counter::Us28, 1 << 28)]
    {
        let mut all = events(2000, &[0, 1]);
        all.iter_mut()
            .enumerate()
            .for_each(|(k, event)| event.0 = ((range - 50_000 + 53 * k as i64) % range) as u32);
        let (_folder, path) = npz(&all, "|u1");
        let recording = Npz::open(&path, &us()).unwrap();
        assert_eq!(recording.conventions()[0].id, "counter_followed", "{counter:?}");
        let (events, _) = collect(&recording);
        assert!(events.t.windows(2).all(|pair| pair[1] - pair[0] == 53_000), "{counter:?}");
        let mut cursor = recording.events().unwrap();
        let mut chunk = EventChunk::default();
        cursor.next(&mut chunk).unwrap();
        cursor.seek(events.t[1500]).unwrap();
        assert_eq!(drain(&mut *cursor).t, events.t);
    }
    // Nanoseconds in 32 bits begin again after 4.3 s.
    let mut all = events(2000, &[0, 1]);
    all.iter_mut()
        .enumerate()
        .for_each(|(k, event)| event.0 = ((1_i64 << 32) - 50_000_000 + 53_000 * k as i64) as u32);
    let (_folder, path) = npz(&all, "|u1");
    let (events, _) = collect(
        &Npz::open(&path, &Declared { time_unit: Some(TimeUnit::Ns), ..Declared::default() }).unwrap(),
    );
    assert!(events.t.windows(2).all(|pair| pair[1] - pair[0] == 53_000));
}

/// uzh-rpg/timelens-pp#4: `np.max(event['x'])` is 65534 where pictures have 970 columns.
#[test]
fn negative_coordinates_without_a_sign_do_not_make_the_array_huge() {
    let mut all = events(2000, &[0, 1]);
    (all[7].1, all[90].2) = (65_534, 65_535);
    let found = both(&all, "|u1", &us()).unwrap();
    assert_eq!(
        (ids(&found), found.events.len(), found.losses.len()),
        (vec!["negative_coordinates"], 1998, 2)
    );
    assert_eq!(found.events.x.iter().max(), Some(&19));
}

/// A file of events in memory.
struct Cursor(Option<EventChunk>);

impl EventCursor for Cursor {
    fn next(&mut self, chunk: &mut EventChunk) -> Result<bool, FormatError> {
        chunk.clear();
        Ok(self.0.take().map(|events| *chunk = events).is_some())
    }

    fn seek(&mut self, _: i64) -> Result<(), FormatError> {
        Ok(())
    }

    fn losses(&self) -> Vec<Loss> {
        Vec::new()
    }

    fn position(&self) -> (u64, u64) {
        (0, 0)
    }
}

#[test]
fn columns_of_hdf5_are_read_by_the_same_rules() {
    let mut chunk = EventChunk::default();
    for (t, x, y, p) in events(5000, &[0, 1, 2, 3]) {
        chunk.push(i64::from(t) * 1000, x + 1, y + 1, false);
        *chunk.on.last_mut().unwrap() = p as u8;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("events.h5");
    let larger = Extent { width: SIZE.width + 1, height: SIZE.height + 1 };
    crate::hdf::write::write_dsec(&path, &mut Cursor(Some(chunk)), larger, false).unwrap();
    let recording =
        (named("dsec").unwrap().open)(&path, &Declared { extent: Some(SIZE), ..Declared::default() })
            .unwrap();
    let found = read(&*recording);
    assert_eq!(ids(&found), ["polarity_counts", "origin_one"]);
    let right = both(&events(5000, &[0, 1, 1, 1]), "|u1", &us()).unwrap();
    assert_eq!((found.events, found.losses.len()), (right.events, 0));
    assert!(
        found
            .notes
            .iter()
            .any(|note| note == "polarity holds counts 0 to 3: every value above 0 was read as ON"),
        "{:?}",
        found.notes
    );
}
