//! Recordings that are read wrongly in one way, and which reading of several is found.

use super::*;
use crate::error::Loss;
use crate::recording::{EventCursor, EventsAbout, FrameStamp, Pictures};
use photocurrent_core::Colour;
use std::path::PathBuf;
use std::sync::Arc;

const WIDTH: i64 = 64;
const HEIGHT: i64 = 48;
const FRAMES: i64 = 12;
const PERIOD_US: i64 = 20_000;
const EXPOSURE_US: i64 = 4_000;

/// A recording in memory.
#[derive(Clone)]
struct Made {
    about: EventsAbout,
    events: EventChunk,
    frames: FramesAbout,
    values: Vec<Vec<f32>>,
}

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

impl Pictures for Made {
    fn about(&self) -> &FramesAbout {
        &self.frames
    }

    fn read(&self, frame: usize, values: &mut Vec<f32>) -> Result<(), FormatError> {
        values.clone_from(&self.values[frame]);
        Ok(())
    }
}

impl Recording for Made {
    fn events_about(&self) -> Option<&EventsAbout> {
        Some(&self.about)
    }

    fn events(&self) -> Result<Box<dyn EventCursor>, FormatError> {
        Ok(Box::new(Cursor(Some(self.events.clone()))))
    }

    fn pictures(&self) -> Option<Arc<dyn Pictures>> {
        Some(Arc::new(self.clone()))
    }

    fn files(&self) -> Vec<PathBuf> {
        Vec::new()
    }
}

/// Logarithm of the light over its mean: waves of several lengths, in the lower half the other way unless all
/// moves one way.
fn log_light(x: i64, y: i64, t_us: i64, is_one_way: bool) -> f64 {
    let s = t_us as f64 * 1e-6;
    let way = if is_one_way || y < HEIGHT / 2 { 1.0 } else { -1.0 };
    let (x, y) = (x as f64 - way * 150.0 * s, y as f64 + way * 60.0 * s);
    let wave = |a: f64, b: f64, phase: f64| libm::sin(a * x + b * y + phase);
    0.3 * wave(0.41, 0.23, 0.0)
        + 0.2 * wave(0.17, -0.39, 1.0)
        + 0.2 * wave(-0.13, 0.61, 2.0)
        + 0.1 * wave(0.9, 0.3, 0.5)
}

/// The scene, read as it is.
fn scene(is_one_way: bool, is_still: bool) -> Made {
    let mut events: Vec<(i64, i64, i64, bool)> = Vec::new();
    let at = |x, y, t| log_light(x, y, if is_still { 0 } else { t }, is_one_way);
    for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
        let mut level = (at(x, y, 0) / 0.2).floor();
        for t in (0..(FRAMES + 1) * PERIOD_US).step_by(500) {
            let now = at(x, y, t) / 0.2;
            while now >= level + 1.0 {
                level += 1.0;
                events.push((t, x, y, true));
            }
            while now < level - 1.0 {
                level -= 1.0;
                events.push((t, x, y, false));
            }
        }
    }
    events.sort_unstable();
    let extent = Extent { width: WIDTH as u32, height: HEIGHT as u32 };
    let mut chunk = EventChunk::default();
    events.into_iter().for_each(|(t, x, y, is_on)| chunk.push(1_000 * t, x as u16, y as u16, is_on));
    let start = |frame: i64| (10_000 + frame * PERIOD_US) * 1_000;
    let stamp = |frame| FrameStamp {
        at: start(frame),
        exposure: Some((start(frame), start(frame) + EXPOSURE_US * 1_000)),
    };
    let value = |frame: i64, x, y| {
        (110.0 * libm::exp(at(x, y, start(frame) / 1_000 + EXPOSURE_US / 2))).round() as f32
    };
    let picture = |frame| {
        (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))).map(|(x, y)| value(frame, x, y)).collect()
    };
    Made {
        about: EventsAbout {
            extent: Some(extent),
            tick_ns: 1000,
            count: None,
            has_t_in: false,
            stamps: "u64 microseconds".into(),
            notes: Vec::new(),
        },
        events: chunk,
        frames: FramesAbout {
            extent,
            colour: Colour::Mono,
            bits: 8,
            stamps: (0..FRAMES).map(stamp).collect(),
            stamp_role: None,
            row_time_ns: None,
            transfer: None,
            notes: Vec::new(),
        },
        values: (0..FRAMES).map(picture).collect(),
    }
}

/// The same with events stored elsewhere: (t in ns, x, y) of each.
fn stored(made: &Made, event: impl Fn(i64, i64, i64) -> (i64, i64, i64)) -> Made {
    let mut chunk = EventChunk::default();
    let of = &made.events;
    for (((t, x), y), on) in of.t.iter().zip(&of.x).zip(&of.y).zip(&of.on) {
        let (t, x, y) = event(*t, (*x).into(), (*y).into());
        if (0..WIDTH).contains(&x) && (0..HEIGHT).contains(&y) {
            chunk.push(t, x as u16, y as u16, *on == 1);
        }
    }
    Made { events: chunk, ..made.clone() }
}

/// As read, and everything that the other cases are; each with an offset of its own.
fn alternatives() -> Vec<Alternative> {
    let all = [
        Alternative::new("as read"),
        Alternative::new("left to right"),
        Alternative::new("top to bottom"),
        Alternative::new("two pixels right"),
        Alternative::new("polarity"),
    ];
    let [read, left, top, two, polarity] = all;
    vec![
        read.clone(),
        Alternative { name: "late".into(), ..read }.fitting_offset(),
        left.mirrored(true, false),
        top.mirrored(false, true),
        two.shifted(2, 0),
        polarity.inverted(),
    ]
}

fn scored(made: &Made) -> Vec<Scored> {
    compare(made, &alternatives(), &Much::default()).unwrap()
}

fn is_decided(made: &Made, name: &str) {
    let scored = scored(made);
    assert_eq!(decided(&scored).map(|best| best.name.as_str()), Some(name), "{scored:#?}");
}

#[test]
fn what_was_read_wrongly_is_the_reading_that_explains_most() {
    let made = scene(false, false);
    is_decided(&stored(&made, |t, x, y| (t, WIDTH - 1 - x, y)), "left to right");
    is_decided(&stored(&made, |t, x, y| (t, x, HEIGHT - 1 - y)), "top to bottom");
    is_decided(&stored(&made, |t, x, y| (t, x - 2, y)), "two pixels right");
    is_decided(&stored(&made, |t, x, y| (t + PERIOD_US * 800, x, y)), "late");
    let mut inverted = made;
    inverted.events.on.iter_mut().for_each(|on| *on = 1 - *on);
    is_decided(&inverted, "polarity");
}

#[test]
fn a_recording_that_is_read_well_stays_as_it_is() {
    let made = scene(false, false);
    let all = scored(&made);
    let (first, second) = (&all[0], &all[1]);
    // A fitted offset has nothing to add: both are near each other, and the offset near none.
    assert!(
        ["as read", "late"].contains(&first.name.as_str())
            && ["as read", "late"].contains(&second.name.as_str()),
        "{all:#?}"
    );
    assert!(
        first.explained.value > 0.6 && second.behind.value < 0.05 && all[2].behind.ci95.0 > 0.2,
        "{all:#?}"
    );
    let late = all.iter().find(|one| one.name == "late").unwrap();
    assert!(late.late_ns.abs() < 1.5e6, "{late:?}");
    // With one of the two alone the answer is clear.
    let without: Vec<Alternative> = alternatives().into_iter().filter(|of| of.name != "late").collect();
    let found =
        compare(&made, &without, &Much { span_ns: Some((0, 260_000_000)), ..Much::default() }).unwrap();
    assert_eq!(decided(&found).map(|best| best.alternative), Some(0), "{found:#?}");
}

#[test]
fn where_all_moves_one_way_a_shift_is_close_to_lateness() {
    // At 150 pixels a second, 8 ms late is 1.2 pixels behind.
    let made = stored(&scene(true, false), |t, x, y| (t + 8_000_000, x, y));
    let three = [
        Alternative::new("shifted").shifted(1, 0),
        Alternative::new("late").fitting_offset(),
        Alternative::new("as read"),
    ];
    let found = compare(&made, &three, &Much::default()).unwrap();
    assert_eq!((found[0].name.as_str(), found[2].name.as_str()), ("late", "as read"), "{found:#?}");
    assert!(found[1].behind.value < 0.6 * found[2].behind.value, "{found:#?}");
}

#[test]
fn rows_that_are_exposed_later_are_held_against_their_own_events() {
    let mut made = stored(&scene(false, false), |t, x, y| (t + y * 300_000, x, y));
    let explained =
        |made: &Made| compare(made, &[Alternative::new("as read")], &Much::default()).unwrap()[0].explained;
    let at_once = explained(&made);
    made.frames.row_time_ns = Some(300_000);
    let by_row = explained(&made);
    assert!(by_row.ci95.0 > at_once.ci95.1, "{by_row:?} {at_once:?}");
}

#[test]
fn what_does_not_move_or_has_no_frames_decides_nothing() {
    assert_eq!(decided(&scored(&scene(false, true))), None);
    let mut few = scene(false, false);
    let mut wide = few.clone();
    few.frames.stamps.truncate(1);
    assert_eq!(scored(&few), []);
    // Spans that a file only claims: nothing is allocated for them.
    wide.frames
        .stamps
        .iter_mut()
        .zip([i64::MIN, -5, 0, i64::MAX / 2, i64::MAX])
        .for_each(|(stamp, at)| *stamp = FrameStamp { at, exposure: None });
    assert!(decided(&scored(&wide)).is_none_or(|best| best.explained.value <= 1.0));
}
