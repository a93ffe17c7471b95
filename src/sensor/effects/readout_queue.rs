//! Readout queue: when many pixels fire at once they wait for each other, and no stamp shows how long.
//!
//! All pixels share one way out, which serves one event after the other. An event that finds others waiting
//! keeps its pixel blind until its turn comes; the pixel takes its new reference that much later and has
//! missed more of the edge. The stamps are those of an empty readout. At low load nothing happens; near
//! `1 / service` events a second the wait shoots up, for pixels far apart alike. Typical: 10 to 100 ns an
//! event in fast sensors, a row at a time in others (microseconds); waits of 1 ms and more are known.
//!
//! Sources: Lindley's recursion for a queue with one server (1952), `W[n+1] = max(0, W[n] + service - gap)`;
//! Prophesee's knowledge base on back-pressure. What loads the queue: every event that a pixel fires, also
//! one that is lost later (`event_loss`: full buffers and dropped packets lie behind the queue, and the pixel
//! has waited and reset like any other). A crossing inside the blind time is no event, and loads nothing.
//! Limits: the load is that of a pass before; `simulate/sensor` repeats passes until no wait changes. In a
//! load a pixel's events that would come while an earlier one still waits are left out, since the pixel is
//! blind. Of requests at the same nanosecond the lower row goes first, then the lower column.

use super::sought::{Measure, Search, Size, Sought, TIME};
use super::{
    ArrayEvent, Effect, EffectDecl, EffectKind, Latency, ParameterDecl, Parameters, Site, Stage, Unit,
};
use photocurrent_core::random::Random;
use std::collections::HashMap;

/// The catalogue entry.
pub(super) const KIND: EffectKind = EffectKind {
    decl: EffectDecl {
        id: "readout_queue",
        stage: Stage::Readout,
        about: "Events wait for each other on their way out, and the stamps do not show it",
        equation: "wait[n+1] = max(0, wait[n] + service - (t_in[n+1] - t_in[n])) over all events of the \
                   array; the reset comes later by the wait",
        parameters: &[ParameterDecl {
            name: "service",
            unit: Unit::Time,
            null: Some(0.0),
            allowed: (0.0, 1.0),
            plausible: (1e-8, 1e-4),
            about: "time that the readout needs for one event",
        }],
        covariate: "global_rate",
        signature: "after an event under load a pixel has missed change in proportion to slope times wait; \
                    nothing at low load, a sharp rise near 1 / service",
        confused_with: &["refractory", "clock_offset", "row_skew", "event_loss"],
        source: "Lindley 1952; Prophesee knowledge base",
        apart: &[(
            "clock_offset",
            "the same scene at a tenth of the event rate: a queue vanishes, an offset stays",
        )],
        search: Search::For(&[Sought {
            typical: Size::Over(&Size::Fixed(0.6), Measure::EventRate),
            material: TIME,
            is_made: false,
            ..Sought::positive("service")
        }]),
    },
    build,
};

fn build(parameters: &Parameters) -> Result<Box<dyn Effect>, String> {
    Ok(Box::new(ReadoutQueue { service_ns: parameters.need_ns("service")?, load: Vec::new() }))
}

/// One server for the whole array.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct ReadoutQueue {
    /// Time for one event, nanoseconds, at least zero.
    pub service_ns: i64,
    /// The requests of a first pass, in order; empty before it.
    load: Vec<Request>,
}

/// An event that asks to be read out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Request {
    /// When, by whom: in-pixel time, row, column. Requests are served in this order.
    key: (i64, u32, u32),
    /// How long it waits, nanoseconds.
    wait_ns: i64,
}

impl ReadoutQueue {
    /// The queue under the load of these events, in any order.
    pub(super) fn loaded(service_ns: i64, events: &[ArrayEvent]) -> ReadoutQueue {
        let mut keys: Vec<(i64, u32, u32)> =
            events.iter().map(|event| (event.event.t_in_ns, event.y, event.x)).collect();
        keys.sort_unstable();
        let mut queue = ReadoutQueue { service_ns, load: Vec::with_capacity(keys.len()) };
        let mut served_ns: HashMap<(u32, u32), i64> = HashMap::new();
        for key in keys {
            let (t_ns, y, x) = key;
            if served_ns.get(&(y, x)).is_some_and(|&served| t_ns < served) {
                continue;
            }
            let wait_ns = queue.wait_behind(queue.load.last(), t_ns);
            served_ns.insert((y, x), t_ns + wait_ns);
            queue.load.push(Request { key, wait_ns });
        }
        queue
    }

    /// How long a request of a pixel at `t_ns` waits, nanoseconds; zero before a first pass.
    pub(super) fn wait_ns(&self, x: u32, y: u32, t_ns: i64) -> i64 {
        let before = self.load.partition_point(|request| request.key < (t_ns, y, x));
        self.wait_behind(before.checked_sub(1).map(|last| &self.load[last]), t_ns)
    }

    /// Lindley's recursion.
    fn wait_behind(&self, last: Option<&Request>, t_ns: i64) -> i64 {
        last.map_or(0, |last| (last.wait_ns + self.service_ns - (t_ns - last.key.0)).max(0))
    }
}

impl Effect for ReadoutQueue {
    fn id(&self) -> &'static str {
        KIND.decl.id
    }

    fn informed(&self, events: &[ArrayEvent]) -> Option<Box<dyn Effect>> {
        (self.service_ns > 0)
            .then(|| Box::new(ReadoutQueue::loaded(self.service_ns, events)) as Box<dyn Effect>)
    }

    fn latency(&self, site: &Site, _random: &mut Random, t_in_ns: i64) -> Latency {
        Latency { shown_ns: 0, hidden_ns: self.wait_ns(site.x, site.y, t_in_ns) }
    }
}

#[cfg(test)]
mod tests {
    use super::super::PixelEvent;
    use super::super::simulated::{MS, SITE, Samples, ideal_pixel, recorded};
    use super::super::testing::{described, site};
    use super::*;
    use serde_json::json;

    fn request(x: u32, y: u32, t_in_ns: i64) -> ArrayEvent {
        ArrayEvent { x, y, event: PixelEvent { t_in_ns, t_off_ns: t_in_ns + 1_000, polarity: 1 } }
    }

    fn waits(events: &[ArrayEvent]) -> Vec<Latency> {
        let informed = described("readout_queue", json!({ "service": "100 ns" }))
            .informed(events)
            .expect("load matters");
        events
            .iter()
            .map(|event| {
                informed.latency(&site(event.x, event.y), &mut Random::new(1, &[]), event.event.t_in_ns)
            })
            .collect()
    }

    #[test]
    fn a_burst_waits_as_the_recursion_says_and_no_stamp_shows_it() {
        // Gaps 30, 40, 0, 500, 100, 99: waits 0, 70, 130, 230, 0, 0, 1 with a service of 100.
        let burst = [0, 30, 70, 70, 570, 670, 769];
        let events: Vec<ArrayEvent> = burst.iter().zip(0..).map(|(&t_ns, x)| request(x, 5, t_ns)).collect();
        let expected = [0, 70, 130, 230, 0, 0, 1];
        assert_eq!(waits(&events), expected.map(|hidden_ns| Latency { shown_ns: 0, hidden_ns }));
    }

    #[test]
    fn requests_at_once_are_served_by_row_then_column() {
        let hidden: Vec<i64> = waits(&[request(9, 2, 0), request(1, 3, 0), request(4, 2, 0)])
            .iter()
            .map(|wait| wait.hidden_ns)
            .collect();
        assert_eq!(hidden, [100, 200, 0]);
    }

    #[test]
    fn the_wait_shoots_up_where_the_rate_exceeds_the_service() {
        let at_gap = |gap_ns: i64| {
            let events: Vec<ArrayEvent> =
                (0..20_000).map(|k| request((k % 200) as u32, (k / 200) as u32, gap_ns * k)).collect();
            waits(&events).iter().map(|wait| wait.hidden_ns).max()
        };
        // Regular requests: nothing up to the limit, beyond it 19,999 x (service - gap).
        assert_eq!(at_gap(101), Some(0));
        assert_eq!(at_gap(100), Some(0));
        assert_eq!(at_gap(90), Some(199_990));
    }

    #[test]
    fn a_pixel_that_waits_asks_only_once() {
        // The pixel's second request comes while the first waits (until 200), so the next pixel waits behind
        // three, not four.
        let queue = ReadoutQueue::loaded(
            100,
            &[request(0, 0, 0), request(1, 0, 0), request(2, 0, 0), request(2, 0, 150)],
        );
        assert_eq!(queue.wait_ns(7, 0, 160), 140);
    }

    #[test]
    fn no_wait_without_a_first_pass_or_a_service_time() {
        let queue = described("readout_queue", json!({ "service": "100 ns" }));
        assert_eq!(queue.latency(&site(0, 0), &mut Random::new(1, &[]), 0), Latency::default());
        assert!(
            described("readout_queue", json!({ "service": "0 ns" })).informed(&[request(0, 0, 0)]).is_none()
        );
    }

    #[test]
    fn a_pixel_under_load_takes_its_reference_later_and_its_stamps_do_not_show_it() {
        let ramp = Samples::of_log(45 * MS, |t| 20.0 * t);
        let pixel = crate::forward::Pixel { latency_ns: 1_000, ..ideal_pixel() };
        let alone = recorded(pixel, Vec::new(), &ramp, 45 * MS);
        // Thirty pixels of the row before ask 5 us before this one's second event, and need 100 us each.
        let mut load: Vec<ArrayEvent> =
            alone.iter().map(|&event| ArrayEvent { x: SITE.x, y: SITE.y, event }).collect();
        load.extend((0..30).map(|x| request(x, SITE.y - 1, alone[1].t_in_ns - 5_000)));
        let informed =
            described("readout_queue", json!({ "service": "100 us" })).informed(&load).expect("load matters");
        let loaded = recorded(pixel, vec![informed], &ramp, 45 * MS);
        assert!(loaded.iter().all(|event| event.t_off_ns - event.t_in_ns == 1_000));
        assert_eq!(loaded[..2], alone[..2]);
        let later_ns = loaded[2].t_in_ns - alone[2].t_in_ns;
        assert!((later_ns - (30 * 100_000 - 5_000)).abs() <= 2, "{later_ns}");
    }
}
