//! Events and frames of one recording run on one clock: this notices when they evidently do not.
//!
//! The usual cause is a file whose events count from the start of the recording while its frames carry the
//! time of day, with the difference in a field (`t_offset`) that nobody added. Whoever goes on then works
//! over decades in which nothing happened. So streams without a common moment are refused, with both spans
//! and the difference of their starts, before anything is made from either.
//!
//! Limits: frames that end shortly before the first event, or begin shortly after the last one, are taken for
//! what they are: within one frame period, and for a lone frame within the length of the events.

use crate::frames::FrameTimes;
use crate::time::{TimeSpan, in_seconds};

/// Events and frames without a common moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Apart {
    /// From the first event to just after the last.
    pub events: TimeSpan,
    /// From the first exposure's start to the last one's end.
    pub frames: TimeSpan,
}

impl Apart {
    /// Of events and of frames of `height` rows; `None` when they share time, or one of them has none.
    pub fn of(events: Option<TimeSpan>, times: &FrameTimes, height: u32) -> Option<Apart> {
        let (events, frames) = (events?, times.span(height)?);
        let gap = i128::from(frames.start.0.max(events.start.0)) - i128::from(frames.end.0.min(events.end.0));
        let slack = times
            .mean_period_ns()
            .map_or(i128::from(events.end.0) - i128::from(events.start.0), |period| period as i128);
        (gap > slack.max(0)).then_some(Apart { events, frames })
    }

    /// What would have to be added to the stamps of events for both streams to start together, ns.
    pub fn offset_ns(&self) -> i64 {
        self.frames.start.0.saturating_sub(self.events.start.0)
    }

    /// What is wrong, in one sentence.
    pub fn message(&self) -> String {
        format!(
            "events and frames have no moment in common: events {}, frames {}",
            span(self.events),
            span(self.frames)
        )
    }

    /// What to do about it.
    pub fn hint(&self) -> String {
        let offset = self.offset_ns();
        let (sign, later) = if offset < 0 { ("-", "earlier") } else { ("", "later") };
        let length = offset.unsigned_abs();
        let shown = in_seconds(offset.saturating_abs());
        format!(
            "frames start {shown} {later} than events: if the two clocks were never put together (a \
             forgotten `t_offset`), add about {sign}{length} ns to the stamps of the events"
        )
    }
}

fn span(span: TimeSpan) -> String {
    format!("from {} to {}", in_seconds(span.start.0), in_seconds(span.end.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Exposure;

    const MS: i64 = 1_000_000;

    /// Frames of 4 ms every 10 ms.
    fn frames(start: i64, count: i64) -> FrameTimes {
        FrameTimes::new(
            (0..count).map(|l| Exposure::new(start + l * 10 * MS, start + l * 10 * MS + 4 * MS)).collect(),
            0,
        )
        .unwrap()
    }

    fn apart(events: (i64, i64), frames: &FrameTimes) -> bool {
        Apart::of(Some(TimeSpan::new(events.0, events.1)), frames, 1).is_some()
    }

    #[test]
    fn clocks_that_were_never_put_together_are_noticed_whichever_is_ahead() {
        let day = 1_600_000_000_000_000_000;
        let found = Apart::of(Some(TimeSpan::new(0, 200 * MS)), &frames(day, 20), 1).unwrap();
        assert_eq!(found.offset_ns(), day);
        assert!(
            found.message().contains("events from 0 s to 0.2 s, frames from 1600000000 s to"),
            "{}",
            found.message()
        );
        assert!(found.hint().contains("add about 1600000000000000000 ns"), "{}", found.hint());
        let found = Apart::of(Some(TimeSpan::new(day, day + 1)), &frames(0, 20), 1).unwrap();
        assert!(
            found.hint().contains("earlier") && found.hint().contains("add about -1600000000000000000 ns"),
            "{}",
            found.hint()
        );
        // The ends of what a stamp can say.
        assert!(apart((i64::MIN, i64::MIN + 5), &frames(i64::MAX - 200 * MS, 20)));
    }

    #[test]
    fn streams_that_share_time_or_touch_are_no_two_clocks() {
        let clip = frames(0, 20);
        assert!(!apart((50 * MS, 60 * MS), &clip) && !apart((-5 * MS, 1), &clip));
        // Events go on after the last frame until the next one would have begun.
        assert!(!apart((200 * MS, 203 * MS), &clip) && apart((205 * MS, 300 * MS), &clip));
        // One picture, and what happened after it.
        assert!(!apart((10 * MS, 500 * MS), &frames(0, 1)) && apart((600 * MS, 900 * MS), &frames(0, 1)));
        assert!(
            Apart::of(None, &clip, 1).is_none()
                && Apart::of(Some(TimeSpan::new(0, 1)), &frames(0, 0), 1).is_none()
        );
    }
}
