//! How long a recording lasts, looked at before anything is made from that length: for every node that works
//! over a span of time.
//!
//! Two mistakes of stamps make a recording last for decades: events and frames on two clocks
//! ([`check_one_clock`]), and one stamp far from all others. A list with an entry for every millisecond of
//! that ([`check_steps`]) would take all memory there is, so both are refused while planning; so is a
//! recording most of whose time has no frame near ([`check_covered`]): a camera that paused, events far from
//! all frames.

use photocurrent_core::quantity::Duration;
use photocurrent_core::time::in_seconds;
use photocurrent_core::{Apart, Coverage, DataType, EventsMeta, FramesMeta, NodeError, Sensor, TimeSpan};
use photocurrent_solve::pixel_events::clock_offset;

/// More entries of a list than this are a mistake of stamps or of parameters: more than an hour at a thousand
/// a second.
pub const MOST_STEPS: u64 = 4_000_000;

/// Refuses to lay `what` every `step_ns` over a span that would need more than [`MOST_STEPS`] of them; `who`
/// would.
///
/// # Errors
/// When there would be too many, with their number and the span.
pub fn check_steps(span: TimeSpan, step_ns: i64, what: &str, who: &str) -> Result<(), NodeError> {
    let steps = (span.end.0 as f64 - span.start.0 as f64) / step_ns.max(1) as f64;
    if steps <= MOST_STEPS as f64 {
        return Ok(());
    }
    let (from, to) = (in_seconds(span.start.0), in_seconds(span.end.0));
    Err(NodeError::input(format!(
        "{who} would need {} {what} for a recording from {from} to {to}, and {MOST_STEPS} are the most",
        rounded(steps)
    ))
    .hint(
        "is a stamp far from all others, or in another unit? `photocurrent inspect` shows the spans; \
               else cut the recording into shorter ones",
    )
    .blames(DataType::Events))
}

/// Refuses a window of time that ends where it begins, or before.
///
/// # Errors
/// When it does, with both ends.
pub fn check_window(start: Option<Duration>, end: Option<Duration>) -> Result<(), NodeError> {
    match (start, end) {
        (Some(start), Some(end)) if end <= start => {
            Err(NodeError::usage(format!("the window ends at {end}, and begins at {start}"))
                .hint("make `end` later than `start`")
                .param("end"))
        }
        _ => Ok(()),
    }
}

/// A large number for people: `1.7e12`.
pub fn rounded(count: f64) -> String {
    if count < 1e6 { format!("{count:.0}") } else { format!("{count:.1e}") }
}

/// Refuses events and frames that share no time once the description's clock offset is subtracted; both
/// inputs' files are to blame.
///
/// # Errors
/// When they do not share time, with both spans and the likely offset; or when the clock offset is not
/// understood.
pub fn check_one_clock(
    events: &EventsMeta,
    frames: &FramesMeta,
    sensor: Option<&Sensor>,
) -> Result<(), NodeError> {
    match Apart::of(on_frames_clock(events, sensor)?, &frames.times, frames.extent.height) {
        None => Ok(()),
        Some(apart) => Err(NodeError::input(apart.message()).hint(apart.hint()).blames(DataType::Events)),
    }
}

/// The events' span, less the clock offset that the description states.
fn on_frames_clock(events: &EventsMeta, sensor: Option<&Sensor>) -> Result<Option<TimeSpan>, NodeError> {
    let shift_ns = sensor.map(clock_offset).transpose()?.map_or(0, |offset| offset.offset_ns);
    Ok(events.span.map(|span| {
        TimeSpan::new(span.start.0.saturating_sub(shift_ns), span.end.0.saturating_sub(shift_ns))
    }))
}

/// Refuses a recording of which less than a quarter of the time has frames near: whoever works over it would
/// fill the rest.
///
/// # Errors
/// When it is so, with the parts that have frames and the window that holds the fullest; or when the clock
/// offset is not understood.
pub fn check_covered(
    events: Option<&EventsMeta>,
    frames: &FramesMeta,
    sensor: Option<&Sensor>,
) -> Result<(), NodeError> {
    let Some(of_frames) = frames.times.span(frames.extent.height) else { return Ok(()) };
    let of_events = events.map(|events| on_frames_clock(events, sensor)).transpose()?.flatten();
    let span = of_events.map_or(of_frames, |span| span.union(of_frames));
    let coverage = Coverage::of(&frames.times, frames.extent.height);
    match coverage.refuses(span) {
        None => Ok(()),
        Some(why) => {
            let window = coverage.window().unwrap_or_default();
            let hint = format!(
                "read a part that has frames: {window} of the reader of both, or of a node split/time; \
                 `photocurrent inspect` shows pauses and stray events"
            );
            Err(NodeError::input(why).hint(hint).blames(if events.is_some() {
                DataType::Events
            } else {
                DataType::Frames
            }))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::document::Source;
    use photocurrent_core::testing;

    #[test]
    fn a_stated_clock_offset_puts_streams_together() {
        let frames = testing::frames(6, 5, 3).meta;
        let day = 1_600_000_000_000_000_000;
        let events = |shift: i64| {
            let meta = (*testing::events(6, 5).meta).clone();
            EventsMeta {
                span: meta.span.map(|span| TimeSpan::new(span.start.0 + shift, span.end.0 + shift)),
                ..meta
            }
        };
        assert!(check_one_clock(&events(0), &frames, None).is_ok());
        let error = check_one_clock(&events(day), &frames, None).unwrap_err();
        assert!(
            error.message.contains("no moment in common")
                && error.hint.is_some()
                && error.blamed_input == Some(DataType::Events),
            "{error}"
        );
        let text = "format = \"photocurrent-sensor/1\"\n[effects]\nclock_offset = \
                    { offset = \"1600000000 s\" }\n";
        let sensor = Sensor::parse(&Source::new("s.toml", "", text)).unwrap();
        assert!(
            check_one_clock(&events(day), &frames, Some(&sensor)).is_ok()
                && check_one_clock(&events(0), &frames, Some(&sensor)).is_err()
        );
    }

    #[test]
    fn stray_events_far_from_all_frames_are_refused_and_a_recording_with_frames_throughout_is_not() {
        let frames = testing::frames(6, 5, 3).meta;
        let mut events = (*testing::events(6, 5).meta).clone();
        assert!(
            check_covered(Some(&events), &frames, None).is_ok() && check_covered(None, &frames, None).is_ok()
        );
        events.span = Some(TimeSpan::new(0, 3_600_000_000_000));
        let error = check_covered(Some(&events), &frames, None).unwrap_err();
        assert!(
            error.message.contains("has frames near")
                && error.hint.unwrap().contains("start = \"0 s\", end = "),
            "{}",
            error.message
        );
    }

    #[test]
    fn lists_that_no_machine_can_hold_are_refused_with_their_number() {
        assert!(check_steps(TimeSpan::new(0, 3_600_000_000_000), 1_000_000, "frames", "somebody").is_ok());
        let error = check_steps(TimeSpan::new(0, 1_600_000_000_000_000_000), 1_000_000, "frames", "somebody")
            .unwrap_err();
        assert!(
            error
                .message
                .starts_with("somebody would need 1.6e12 frames for a recording from 0 s to 1600000000 s"),
            "{}",
            error.message
        );
        assert!(check_steps(TimeSpan::new(i64::MIN, i64::MAX), 0, "frames", "somebody").is_err());
        assert_eq!((rounded(12_345.0), rounded(1.72e12)), ("12345".into(), "1.7e12".into()));
    }
}
