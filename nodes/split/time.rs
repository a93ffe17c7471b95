//! Cuts a window of time out of a recording, so that a long one is solved block by block: memory and disk are
//! then those of a block.
//!
//! Events are those stamped within the window, frames those whose whole exposure, of every row, lies in it.
//! Blocks should overlap: near the ends of a window a solution has data on one side only. Render what lies
//! between the overlaps (`start` and `end` of `render/rows`).
//!
//! `pipeline.blocks` of a manifest cuts a whole recording so, and joins what the blocks give; this node is
//! for one window of it.

use crate::spans::check_window;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{
    Context, DataType, Decl, EventStream, FrameSequence, FrameTimes, FramesMeta, Grain, Meta, Node,
    NodeError, PortMetas, TimeSpan,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `split/time`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Leave out what was stamped before this instant of the recording's clock, and frames exposed earlier.
    /// Default: the beginning.
    pub start: Option<Duration>,
    /// Leave out events stamped at or after this instant, and frames whose exposure ends after it. Default:
    /// the end.
    pub end: Option<Duration>,
}

photocurrent_core::ports! {
    /// A recording, one of its streams at least.
    pub struct In {
        /// The events.
        events: Option<EventStream>,
        /// The frames as captured.
        frames: Option<FrameSequence>,
    }
}

photocurrent_core::ports! {
    /// The part of it within the window.
    pub struct Out {
        /// Its events; without `events` absent.
        events: Option<EventStream>,
        /// Its frames; without `frames` absent.
        frames: Option<FrameSequence>,
    }
}

/// The node.
pub struct SplitTime {
    window: TimeSpan,
}

impl SplitTime {
    /// What is known of the frames within the window.
    fn frames(&self, meta: &FramesMeta) -> Result<FramesMeta, NodeError> {
        let within = meta.within(self.window);
        if within.times.is_empty() && !meta.times.is_empty() {
            return Err(NodeError::usage(format!(
                "no frame is exposed wholly within the window {}; {}",
                self.said(),
                said_of(&meta.times, meta.extent.height)
            ))
            .hint(
                "make the window longer than a frame's exposure and the delay of its rows, with its \
                   overlap on both sides",
            ));
        }
        Ok(within)
    }

    fn said(&self) -> String {
        let of = |t_ns: i64, open: &str| {
            if t_ns == i64::MIN || t_ns == i64::MAX {
                open.to_owned()
            } else {
                Duration::new(t_ns).to_string()
            }
        };
        format!("from {} to {}", of(self.window.start.0, "the beginning"), of(self.window.end.0, "the end"))
    }
}

fn said_of(times: &FrameTimes, height: u32) -> String {
    times.span(height).map_or_else(String::new, |span| {
        format!("frames reach from {} to {}", Duration::new(span.start.0), Duration::new(span.end.0))
    })
}

impl Node for SplitTime {
    const DECL: Decl = Decl {
        kind: "split/time",
        about: "Cuts a window of time out of a recording, so that a long one is solved block by block.",
        revision: 1,
        grain: Grain::Pixel,
        draws: false,
        exports: false,
        sources: &["docs/long-recordings.md"],
        example: r#"
[nodes.recording]
kind   = "read/recording"
params = { path = "scene.h5" }

[nodes.block]
kind   = "split/time"
in     = { events = "recording.events", frames = "recording.frames" }
params = { start = "0.9 s", end = "2.1 s" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        check_window(params.start, params.end)?;
        Ok(SplitTime {
            window: TimeSpan::new(
                params.start.map_or(i64::MIN, Duration::ns),
                params.end.map_or(i64::MAX, Duration::ns),
            ),
        })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let absent =
            |data_type: DataType| Meta::Absent { data_type, why: format!("there are no {data_type} to cut") };
        if !inputs.has("events") && !inputs.has("frames") {
            return Err(NodeError::usage("there is nothing to cut: neither `events` nor `frames` is there")
                .hint("connect at least one of them"));
        }
        let events = if inputs.has("events") {
            Meta::Events(Arc::new(inputs.events("events")?.within(self.window)))
        } else {
            absent(DataType::Events)
        };
        let frames = if inputs.has("frames") {
            Meta::Frames(Arc::new(self.frames(inputs.frames("frames")?)?))
        } else {
            absent(DataType::Frames)
        };
        Ok(vec![events, frames])
    }

    fn run(&self, input: In, _: &Context) -> Result<Out, NodeError> {
        if let Some(frames) = &input.frames {
            self.frames(&frames.meta)?;
        }
        let events =
            input.events.map(|events| events.within(Arc::new(events.meta.within(self.window)), self.window));
        let frames = input
            .frames
            .map(|frames| frames.select(frames.meta.times.within(self.window, frames.meta.extent.height)));
        Ok(Out { events, frames })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::events::Event;
    use photocurrent_core::{Exposure, Extent, Polarity, Rows, testing};
    use std::collections::BTreeMap;

    const EXTENT: Extent = Extent { width: 3, height: 4 };

    fn node(start_ns: i64, end_ns: i64) -> SplitTime {
        SplitTime::build(Params { start: Some(Duration::new(start_ns)), end: Some(Duration::new(end_ns)) })
            .unwrap()
    }

    #[test]
    fn blocks_that_follow_each_other_hold_every_event_once() {
        let mut random = photocurrent_core::random::Random::new(3, &[]);
        let events: Vec<Event> = (0..500)
            .map(|_| {
                let mut below = |n: u64| random.bits() % n;
                let (x, y, t) = (below(3) as u16, below(4) as u16, below(1000) as i64);
                Event {
                    x,
                    y,
                    polarity: if below(2) == 0 { Polarity::On } else { Polarity::Off },
                    t,
                    t_in: Some(t - 3),
                }
            })
            .collect();
        let all = testing::stream(EXTENT, events.clone());
        let rows = Rows { start: 1, end: 4 };
        let mut found = Vec::new();
        for (start, end) in [(0, 400), (400, 401), (401, 1000)] {
            let node = node(start, end);
            let (out, _) = testing::with_context(EXTENT.rows(), &["events"], |cx| {
                node.run(In { events: Some(all.clone()), frames: None }, cx)
            });
            let band = out.unwrap().events.unwrap().read(rows).unwrap();
            for y in rows.iter() {
                let row = band.row(y);
                assert!(row.t.iter().all(|t| (start..end).contains(t)));
                found.extend(
                    (0..row.len()).map(|k| (row.x[k], y as u16, row.t[k], row.t_in.unwrap()[k], row.on[k])),
                );
            }
        }
        let mut expected: Vec<_> = events
            .iter()
            .filter(|event| event.y >= 1)
            .map(|event| {
                (event.x, event.y, event.t, event.t_in.unwrap(), u8::from(event.polarity == Polarity::On))
            })
            .collect();
        found.sort_unstable();
        expected.sort_unstable();
        assert_eq!(found, expected);
    }

    #[test]
    fn frames_are_those_exposed_wholly_within_and_the_plan_says_so() {
        // Rows follow each other by 10 ns, so the last of four is exposed 30 ns after the first.
        let frames = testing::captured(
            EXTENT,
            (0..6).map(|l| Exposure::new(100 * l, 100 * l + 50)).collect(),
            10,
            |l, _, _| l as f32,
        );
        let metas =
            PortMetas::new(BTreeMap::from([("frames".to_string(), vec![Meta::Frames(frames.meta.clone())])]));
        for (start, end, expected) in [
            (100, 380, vec![1, 2, 3]),
            (101, 380, vec![2, 3]),
            (100, 379, vec![1, 2]),
            (0, 10_000, vec![0, 1, 2, 3, 4, 5]),
        ] {
            let node = node(start, end);
            let (out, _) = testing::with_context(frames.rows(), &["frames"], |cx| {
                node.run(In { events: None, frames: Some(frames.clone()) }, cx)
            });
            let cut = out.unwrap().frames.unwrap();
            assert_eq!(
                (0..cut.len())
                    .map(|l| cut.read(l..l + 1, frames.rows()).unwrap().dn[0] as i32)
                    .collect::<Vec<_>>(),
                expected
            );
            assert_eq!(node.plan(&metas).unwrap()[1], Meta::Frames(cut.meta.clone()));
        }
        let error = node(10, 60).plan(&metas).unwrap_err();
        assert!(
            error.message.contains("no frame is exposed wholly within the window from 10 ns to 60 ns")
                && error.message.contains("580 ns"),
            "{error:?}"
        );
        assert!(node(0, 100).plan(&PortMetas::default()).unwrap_err().message.contains("nothing to cut"));
        assert_eq!(
            SplitTime::build(Params { start: Some(Duration::new(5)), end: Some(Duration::new(5)) })
                .err()
                .unwrap()
                .param
                .as_deref(),
            Some("end")
        );
    }
}
