//! Each hazard from a recording made by hand, and none from a sound one.

use super::*;
use crate::error::{FormatError, Loss};
use crate::recording::{EventCursor, EventsAbout, FrameStamp, FramesAbout, Pictures, Recording};
use crate::survey::interval::Interval;
use crate::survey::lag::LagSurvey;
use crate::survey::{Most, survey};
use crate::{Edge, EventChunk, StampRole, Transfer, Trigger};
use photocurrent_core::random::Random;
use photocurrent_core::{Colour, Extent};
use std::path::PathBuf;
use std::sync::Arc;

const EXTENT: Extent = Extent { width: 64, height: 48 };
const MS: i64 = 1_000_000;
const PERIOD: i64 = 20 * MS;
const FRAMES: usize = 12;

/// A recording in memory.
#[derive(Clone)]
struct Made {
    about: EventsAbout,
    events: EventChunk,
    frames: FramesAbout,
    values: Vec<Vec<f32>>,
    triggers: Vec<Trigger>,
    sensor: Option<String>,
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

    fn triggers(&self) -> Result<Vec<Trigger>, FormatError> {
        Ok(self.triggers.clone())
    }

    fn sensor_text(&self) -> Option<&str> {
        self.sensor.as_deref()
    }

    fn files(&self) -> Vec<PathBuf> {
        Vec::new()
    }
}

/// A grating that moves, and frames of it; everything stated. Events by a reference that steps by a threshold
/// of 0.2.
fn sound() -> Made {
    let log_light = |x: u32, y: u32, t: i64| {
        let x = f64::from(x) - 120.0 * t as f64 * 1e-9;
        4.0 + 0.5 * libm::sin(0.31 * x + 0.2 * f64::from(y)) + 0.3 * libm::sin(0.13 * x - 0.27 * f64::from(y))
    };
    let length = FRAMES as i64 * PERIOD;
    let mut random = Random::new(4, &[]);
    let mut all = Vec::new();
    for y in 0..EXTENT.height {
        for x in 0..EXTENT.width {
            let mut reference = log_light(x, y, 0);
            for step in 1..length / (MS / 4) {
                // Not all pixels at once: each looks at its own instants, whole microseconds.
                let t = step * (MS / 4) + (random.uniform() * 250.0) as i64 * 1000;
                let change = log_light(x, y, t) - reference;
                if change.abs() > 0.2 {
                    reference += 0.2 * change.signum();
                    all.push((t, x as u16, y as u16, u8::from(change > 0.0)));
                }
            }
        }
    }
    all.sort_unstable();
    let mut events = EventChunk::default();
    all.iter().for_each(|(t, x, y, on)| events.push(*t, *x, *y, *on == 1));
    let stamps: Vec<FrameStamp> = (0..FRAMES as i64)
        .map(|l| l * PERIOD + 3 * MS + (l % 3) * 5_000)
        .map(|at| FrameStamp { at, exposure: Some((at, at + 2 * MS)) })
        .collect();
    let picture = |stamp: &FrameStamp| {
        let t = stamp.at + MS;
        (0..EXTENT.height)
            .flat_map(|y| (0..EXTENT.width).map(move |x| (x, y)))
            .map(|(x, y)| (libm::exp(log_light(x, y, t))).round() as f32)
            .collect()
    };
    let values = stamps.iter().map(picture).collect();
    Made {
        about: EventsAbout {
            extent: Some(EXTENT),
            tick_ns: 1000,
            count: None,
            has_t_in: false,
            stamps: "by hand".into(),
            notes: Vec::new(),
        },
        events,
        frames: FramesAbout {
            extent: EXTENT,
            colour: Colour::Mono,
            bits: 8,
            stamps,
            stamp_role: Some(StampRole::Start),
            row_time_ns: Some(0),
            transfer: Some(Transfer::Linear),
            notes: Vec::new(),
        },
        values,
        triggers: Vec::new(),
        sensor: None,
    }
}

/// Ids of all findings but facts, worst first.
fn ids_of(made: &Made, format: &str) -> Vec<&'static str> {
    let survey = survey(made, format, &Most::default(), |_| {}).unwrap();
    findings(&survey, &Limits::default())
        .into_iter()
        .filter(|finding| finding.severity != Severity::Fact)
        .map(|finding| finding.id)
        .collect()
}

fn ids(made: &Made) -> Vec<&'static str> {
    ids_of(made, "made")
}

/// What a change of the sound recording brings.
fn with(change: impl FnOnce(&mut Made)) -> Vec<&'static str> {
    let mut made = sound();
    change(&mut made);
    ids(&made)
}

#[test]
fn a_sound_recording_has_no_hazard() {
    assert_eq!(ids(&sound()), Vec::<&str>::new());
}

#[test]
fn microseconds_that_are_read_as_nanoseconds_are_too_fast() {
    let found = with(|made| {
        made.events.t.iter_mut().for_each(|t| *t /= 1000);
        made.frames.stamps.iter_mut().for_each(|stamp| {
            stamp.at /= 1000;
            stamp.exposure = stamp.exposure.map(|(start, end)| (start / 1000, end / 1000));
        });
    });
    assert!(found.contains(&"unit_too_small") && found.contains(&"frames_too_fast"), "{found:?}");
    assert!(
        with(|made| made.events.t.iter_mut().for_each(|t| *t = t.saturating_mul(100_000_000)))
            .contains(&"unit_too_large")
    );
}

#[test]
fn frames_that_no_light_makes_are_errors() {
    let of = |change: &dyn Fn(&mut f32)| with(|made| made.values.iter_mut().flatten().for_each(change));
    assert_eq!(of(&|value| *value = f32::NAN)[0], "nan_frames");
    assert_eq!(of(&|value| *value = -*value)[0], "negative_frames");
    assert_eq!(of(&|value| *value = 0.0)[0], "no_picture");
    assert_eq!(with(|made| made.values[3][7] = f32::INFINITY)[0], "infinite_frames");
    assert!(with(|made| made.values[3][7] = f32::NAN).is_empty(), "one value that is not known is no hazard");
}

#[test]
fn clocks_that_do_not_meet_are_reported_with_the_offset() {
    let mut made = sound();
    let day = 1_700_000_000_000_000_000;
    made.frames.stamps.iter_mut().for_each(|stamp| {
        *stamp = FrameStamp {
            at: stamp.at + day,
            exposure: stamp.exposure.map(|(start, end)| (start + day, end + day)),
        }
    });
    let survey = survey(&made, "made", &Most::default(), |_| {}).unwrap();
    let found = findings(&survey, &Limits::default());
    assert_eq!((found[0].id, found[0].severity), ("no_overlap", Severity::Error));
    let offset = survey.frames.unwrap().span_ns.unwrap().0 - survey.events.unwrap().span_ns.unwrap().0;
    assert!(found[0].what_to_do.contains(&offset.to_string()), "{}", found[0].what_to_do);
}

#[test]
fn events_that_are_late_or_mirrored_are_reported() {
    assert_eq!(with(|made| made.events.t.iter_mut().for_each(|t| *t += 5 * MS)), ["events_late"]);
    assert_eq!(with(|_| {}), Vec::<&str>::new());
    let mirrored = with(|made| made.events.x.iter_mut().for_each(|x| *x = EXTENT.width as u16 - 1 - *x));
    assert!(mirrored.contains(&"mirrored"), "{mirrored:?}");
}

#[test]
fn rows_are_compared_at_their_own_time() {
    // Row y shows all of it 100 us times y later, as a rolling shutter would with these frames.
    let rolling = |row_time_ns: Option<i64>| {
        let mut made = sound();
        made.events.t.iter_mut().zip(&made.events.y).for_each(|(t, y)| *t += 100_000 * i64::from(*y));
        made.frames.row_time_ns = row_time_ns;
        survey(&made, "made", &Most::default(), |_| {}).unwrap()
    };
    let recorded = rolling(Some(100_000));
    // References that step by whole thresholds lag behind the light a little, with and without rows.
    let late = |survey: &Survey| survey.lag.as_ref().unwrap().late_ns.unwrap().value;
    let at_once = late(&survey(&sound(), "made", &Most::default(), |_| {}).unwrap());
    assert!(
        (late(&recorded) - at_once).abs() < 0.2e6
            && recorded.lag.as_ref().unwrap().row_time_ns == Some(100_000),
        "{:?}",
        recorded.lag
    );
    let unknown = rolling(None);
    // Half of 48 rows.
    assert!((late(&unknown) - at_once - 2.4e6).abs() < 0.6e6, "{:?}", unknown.lag);
    let found = findings(&unknown, &Limits::default());
    assert!(
        found.iter().any(|finding| ["in_time", "events_late"].contains(&finding.id)
            && finding.evidence.contains("of the middle row")),
        "{found:?}"
    );
}

#[test]
fn what_a_stated_front_end_delays_is_not_late() {
    let described = |front_end: &str| {
        let mut made = sound();
        made.events.t.iter_mut().for_each(|t| *t += 4 * MS);
        made.sensor = Some(format!(
            "format = \"photocurrent-sensor/1\"\n[front_end]\n{front_end}\n[frames]\ngain = 100.0\n"
        ));
        survey(&made, "made", &Most::default(), |_| {}).unwrap()
    };
    let ids = |survey: &Survey| {
        findings(survey, &Limits::default()).into_iter().map(|finding| finding.id).collect::<Vec<_>>()
    };
    let stated = described("tau_0 = \"4 ms\"\nalpha = \"0 ns\"");
    let lag = stated.lag.clone().unwrap();
    let without =
        survey(&sound(), "made", &Most::default(), |_| {}).unwrap().lag.unwrap().late_ns.unwrap().value;
    assert!(
        (lag.front_end_ns.unwrap() - 4e6).abs() < 1e3 && (lag.late_ns.unwrap().value - without).abs() < 0.2e6,
        "{lag:?}"
    );
    assert!(ids(&stated).contains(&"in_time"), "{:?}", ids(&stated));
    let fast = described("tau_0 = \"10 us\"\nalpha = \"0 ns\"");
    assert!(ids(&fast).contains(&"events_late"), "{:?}", ids(&fast));
    // Not stated: four milliseconds of a period of twenty are late.
    assert!(ids(&described("")).contains(&"events_late"));
}

/// What counts as a drift; that it is measured as it was made is tested in `photocurrent_sensor::estimate`.
#[test]
fn a_drift_is_reported_when_all_of_the_picture_shows_it_and_no_front_end_explains_it() {
    let survey = survey(&sound(), "made", &Most::default(), |_| {}).unwrap();
    // Of a frame period of 20 ms, 3 ms in a second and 24 pairs.
    let drifting = LagSurvey {
        pairs: 24,
        drift_ns_per_s: Some(Interval { value: 3e6, ci95: (2e6, 4e6) }),
        drift_halves_ns_per_s: (2.8e6, 3.1e6),
        drift_correlation: (0.9, 0.89),
        drift_over_s: 1.0,
        ..survey.lag.clone().unwrap()
    };
    let is_reported = |lag: LagSurvey| {
        findings(&Survey { lag: Some(lag), ..survey.clone() }, &Limits::default())
            .iter()
            .any(|finding| finding.id == "clock_drift")
    };
    assert!(is_reported(drifting.clone()));
    assert!(is_reported(LagSurvey { front_end_ns: Some(1e6), ..drifting.clone() }));
    let chance = [
        LagSurvey { pairs: 11, ..drifting.clone() },
        LagSurvey { drift_halves_ns_per_s: (5e6, 0.1e6), ..drifting.clone() },
        LagSurvey { drift_ns_per_s: Some(Interval { value: 3e6, ci95: (-1e6, 4e6) }), ..drifting.clone() },
        LagSurvey { drift_correlation: (0.9, 0.9), ..drifting.clone() },
        LagSurvey { front_end_ns: Some(5e6), ..drifting },
    ];
    chance.into_iter().for_each(|lag| assert!(!is_reported(lag.clone()), "{lag:?}"));
}

#[test]
fn a_counter_that_started_again_is_an_error() {
    let found = with(|made| {
        let half = made.events.len() / 2;
        made.events.t.iter_mut().for_each(|t| *t += 16_700 * MS);
        made.events.t[half..].iter_mut().for_each(|t| *t -= 16_777_216_000);
        made.frames.stamps.clear();
        made.values.clear();
    });
    assert!(found.contains(&"counter_wrap"), "{found:?}");
    let two = with(|made| {
        let half = made.events.len() / 2;
        made.events.t[half..].iter_mut().for_each(|t| *t -= 110 * MS);
    });
    assert!(two.contains(&"time_goes_back"), "{two:?}");
}

#[test]
fn stamps_that_stand_still_or_come_in_clumps_are_reported() {
    assert!(with(|made| made.events.t.fill(30 * MS)).contains(&"clock_stands"));
    // A clock of 5 ms; and clumps at times that a clock of 1 us may well have.
    assert!(
        with(|made| made.events.t.iter_mut().for_each(|t| *t -= *t % (5 * MS))).contains(&"coarse_stamps")
    );
    let place = |k: i64| k * 5 * MS + (k * k % 97) * 1000;
    let clumped = with(|made| made.events.t.iter_mut().for_each(|t| *t = place(*t / (5 * MS))));
    assert!(clumped.contains(&"clumps") && !clumped.contains(&"coarse_stamps"), "{clumped:?}");
}

#[test]
fn no_events_and_one_polarity_are_reported() {
    assert_eq!(with(|made| made.events.clear())[0], "no_events");
    assert!(with(|made| made.events.on.fill(1)).contains(&"one_polarity"));
}

#[test]
fn coordinates_that_do_not_fit_are_reported() {
    let scaled = with(|made| {
        made.about.extent = None;
        made.events.x.iter_mut().chain(&mut made.events.y).for_each(|at| *at *= 32);
    });
    assert!(scaled.contains(&"scaled"), "{scaled:?}");
    let swapped = with(|made| {
        made.about.extent = None;
        let x = made.events.x.clone();
        made.events.x = std::mem::replace(&mut made.events.y, x);
    });
    assert!(swapped.contains(&"swapped"), "{swapped:?}");
    assert!(with(|made| made.about.extent = None).contains(&"extent_unknown"));
}

#[test]
fn what_is_not_recorded_is_a_question() {
    let found = with(|made| {
        made.frames.stamps.iter_mut().for_each(|stamp| stamp.exposure = None);
        (made.frames.stamp_role, made.frames.row_time_ns, made.frames.transfer) = (None, None, None);
    });
    for id in ["exposure_unknown", "stamp_unknown", "row_time_unknown", "transfer_unknown"] {
        assert!(found.contains(&id), "{id}: {found:?}");
    }
}

#[test]
fn missing_and_repeated_frames_and_long_exposures_are_reported() {
    let gap = with(|made| {
        made.frames.stamps.remove(5);
        made.values.remove(5);
    });
    assert_eq!(gap, ["missing_frames"]);
    assert!(with(|made| made.values[6] = made.values[5].clone()).contains(&"repeated_frames"));
    let long = with(|made| {
        made.frames.stamps.iter_mut().for_each(|stamp| stamp.exposure = Some((stamp.at, stamp.at + 30 * MS)))
    });
    assert!(long.contains(&"exposure_over_period"), "{long:?}");
}

#[test]
fn bursts_in_step_with_the_frames_are_reported() {
    let found = with(|made| {
        let mut random = Random::new(9, &[]);
        let events = &made.events;
        let mut all: Vec<(i64, u16, u16, u8)> =
            (0..events.len()).map(|k| (events.t[k], events.x[k], events.y[k], events.on[k])).collect();
        for stamp in made.frames.stamps.clone() {
            for _ in 0..1500 {
                let (x, y) = ((random.uniform() * 64.0) as u16, (random.uniform() * 48.0) as u16);
                all.push((stamp.at + 9 * MS + (random.uniform() * 200.0) as i64 * 1000, x, y, 1));
            }
        }
        all.sort_unstable();
        made.events.clear();
        all.iter().for_each(|(t, x, y, on)| made.events.push(*t, *x, *y, *on == 1));
    });
    assert!(found.contains(&"frame_coupled_events"), "{found:?}");
}

#[test]
fn triggers_that_miss_an_edge_are_reported() {
    let edges = |made: &mut Made| {
        made.frames
            .stamps
            .iter()
            .flat_map(|stamp| [(stamp.at, Edge::Rising), (stamp.at + 2 * MS, Edge::Falling)])
            .map(|(t, edge)| Trigger { t, line: 0, edge })
            .collect::<Vec<_>>()
    };
    assert!(with(|made| made.triggers = edges(made)).is_empty());
    let missed = with(|made| {
        made.triggers = edges(made);
        made.triggers.remove(6);
    });
    assert!(missed.contains(&"trigger_unpaired") && missed.contains(&"trigger_gaps"), "{missed:?}");
}

#[test]
fn a_counter_that_was_followed_is_a_fact_of_evt3_only() {
    let mut made = sound();
    made.events.t.iter_mut().for_each(|t| *t += 16_700 * MS);
    let facts = |format: &str| {
        let survey = survey(&made, format, &Most::default(), |_| {}).unwrap();
        findings(&survey, &Limits::default()).iter().any(|finding| finding.id == "counter_wrap_followed")
    };
    assert!(facts("evt3") && !facts("evt2"));
}

#[test]
fn times_are_for_people() {
    assert_eq!([time(1_250_000.0), time(-20.0), time(3e9), time(0.0)], ["1.25 ms", "-20 ns", "3 s", "0 ns"]);
}
