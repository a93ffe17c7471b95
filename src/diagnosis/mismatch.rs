//! How unlike two recordings of the same pixels are: event by event and frame value by frame value, in one bounded number for each pixel.
//!
//! An event costs nothing when the other recording has one of its polarity at the same instant, and 1 when it has none anywhere near, as measured by the interval before it. So an
//! instant counts in units of the threshold, as light moves by one threshold in an interval, and no single event counts for more than any other.

use crate::case::{Case, Recorded};
use crate::nominal::Nominal;
use crate::sample::Sample;

/// An event that is off by this share of the interval before it costs 0.4.
const SHARE_OF_INTERVAL: f64 = 0.1;
/// Half of a cost is by a scale so many times as wide: what is roughly right is better than what is wrong.
const COARSE: f64 = 4.0;
/// Intervals count between these, ns.
const INTERVAL_NS: (i64, i64) = (100_000, 3_000_000);
/// Share of the events that come from nowhere, as far as foretelling goes.
pub const STRANGE: f64 = 0.05;
/// Squares of frame residuals are cut here.
const LARGEST_SQUARE: f64 = 25.0;
/// What a frame value's square costs beside an event's 1; light is fitted to frames closely, so what is left of them says less.
const FRAME_WEIGHT: f64 = 0.05;
/// Frame values are believed to so many DN.
const FRAME_DN: f64 = 0.5;

/// The mismatch of one pixel, or a sum.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mismatch {
    /// Cost of the events of both, halved.
    pub events: f64,
    /// Number of events of both, halved.
    pub count: f64,
    /// Log of how well each recorded event was foretold, summed, nats: 0 at the very instant, and [`STRANGE`] of a density for one that was not foretold at all.
    pub nats: f64,
    /// Recorded events.
    pub recorded: f64,
    /// Sum of squares of frame residuals.
    pub frames: f64,
    /// Frame values.
    pub frame_count: f64,
}

impl Mismatch {
    /// One number.
    pub fn cost(&self) -> f64 {
        self.events + FRAME_WEIGHT * self.frames
    }

    /// Both together.
    #[must_use]
    pub fn and(&self, other: &Mismatch) -> Mismatch {
        Mismatch {
            events: self.events + other.events,
            count: self.count + other.count,
            nats: self.nats + other.nats,
            recorded: self.recorded + other.recorded,
            frames: self.frames + other.frames,
            frame_count: self.frame_count + other.frame_count,
        }
    }
}

/// The mismatch of every pixel of a sample, in its order; frame values are believed to `frame_share` of them beyond what is stated.
pub fn mismatch(case: &Case, other: &Case, sample: &Sample, nominal: &Nominal, frame_share: f64) -> Vec<Mismatch> {
    let of = |&pixel: &u32| {
        let pixel = pixel as usize;
        let (a, b) = (case.events.of(pixel), other.events.of(pixel));
        let (here, there) = (one_way(a, b), one_way(b, a));
        let mut found = Mismatch {
            events: 0.5 * (here.0 + there.0),
            count: 0.5 * (a.len() + b.len()) as f64,
            nats: here.1,
            recorded: a.len() as f64,
            ..Mismatch::default()
        };
        for frame in 0..case.frame_count() {
            let (here, there) = (case.dn(frame, pixel), other.dn(frame, pixel));
            if here.is_finite() && there.is_finite() {
                let (stated, share) = (nominal.stated_frame_sigma_dn(here), frame_share * (here - nominal.number.black_level));
                let square = (here - there) * (here - there) / (stated * stated + share * share + FRAME_DN * FRAME_DN);
                found.frames += f64::min(square, LARGEST_SQUARE);
                found.frame_count += 1.0;
            }
        }
        found
    };
    sample.pixels.iter().map(of).collect()
}

/// What the events of one recording cost against those of the other, and the log of how well they were foretold; both in order of time.
fn one_way(events: &[Recorded], others: &[Recorded]) -> (f64, f64) {
    let (mut cost, mut nats) = (0.0, 0.0);
    for_each_cost(events, others, |own| {
        cost += own;
        nats += libm::log(STRANGE + (1.0 - STRANGE) * (1.0 - own));
    });
    (cost, nats)
}

/// What each event costs against those of the other recording, 0 to 1, in order of time.
pub fn for_each_cost(events: &[Recorded], others: &[Recorded], mut tell: impl FnMut(f64)) {
    let mut from = 0;
    let mut before: Option<i64> = None;
    // How late the event before was; where a drift makes events, an early one makes the next early too.
    let mut late: Option<i64> = None;
    for event in events {
        let interval = before.map_or(INTERVAL_NS.1, |before| event.t_in_ns - before).clamp(INTERVAL_NS.0, INTERVAL_NS.1) as f64;
        before = Some(event.t_in_ns);
        let scale = SHARE_OF_INTERVAL * interval;
        let reach = (4.0 * COARSE * scale) as i64;
        let furthest = (4.0 * COARSE * SHARE_OF_INTERVAL * INTERVAL_NS.1 as f64) as i64;
        while others.get(from).is_some_and(|other| other.t_in_ns < event.t_in_ns - furthest) {
            from += 1;
        }
        let near = others[from..].iter().take_while(|other| other.t_in_ns <= event.t_in_ns + reach).filter(|other| other.polarity == event.polarity);
        let nearest = near.map(|other| event.t_in_ns - other.t_in_ns).min_by_key(|off| off.abs());
        let own = nearest.map_or(1.0, |off| {
            let by_interval = late.map_or(i64::MAX, |late| (off - late).abs());
            let z = i64::min(off.abs(), by_interval) as f64 / scale;
            let wide = z / COARSE;
            -0.5 * (libm::expm1(-0.5 * z * z) + libm::expm1(-0.5 * wide * wide))
        });
        tell(own);
        late = nearest;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn train(stamps_us: &[i64]) -> Vec<Recorded> {
        stamps_us.iter().map(|t| Recorded { t_in_ns: t * 1000, t_off_ns: t * 1000, polarity: 1 }).collect()
    }

    #[test]
    fn events_at_the_same_instants_cost_nothing_and_strangers_one_each() {
        let train_of = |off: i64| train(&[1000 + off, 3000 + off, 9000 + off]);
        assert_eq!(one_way(&train_of(0), &train_of(0)), (0.0, 0.0));
        assert_eq!(one_way(&train_of(0), &[]).0, 3.0);
        let other: Vec<Recorded> = train_of(0).into_iter().map(|event| Recorded { polarity: -1, ..event }).collect();
        assert!((one_way(&train_of(0), &other).1 - 3.0 * libm::log(STRANGE)).abs() < 1e-12);
        // Early by 0.2 ms after an interval that counts as 3 ms; nothing is near the second.
        let late = one_way(&train(&[2000, 40_000]), &train(&[2200])).0;
        let z = 0.2 / 0.3_f64;
        let first = 1.0 - 0.5 * (libm::exp(-0.5 * z * z) + libm::exp(-0.5 * z * z / 16.0));
        assert!((late - first - 1.0).abs() < 1e-12, "{late}");
    }

    #[test]
    fn a_train_that_began_late_costs_once() {
        // All late by a millisecond at intervals of four: the first costs, the others keep their interval.
        let stamps: Vec<i64> = (1..9).map(|k| 4000 * k).collect();
        let late: Vec<i64> = stamps.iter().map(|t| t + 400).collect();
        let cost = one_way(&train(&late), &train(&stamps)).0;
        let z = 0.4 / 0.3_f64;
        assert!((cost - (1.0 - 0.5 * (libm::exp(-0.5 * z * z) + libm::exp(-0.5 * z * z / 16.0)))).abs() < 1e-12, "{cost}");
    }
}
