//! What the light did between two frames, by the frames and by the events: events that come late (`late`),
//! and light that is lost while pixels are blind (`blind`).
//!
//! Events of a pixel between two frames say how far its log light went: a threshold each. They agree best
//! with the frames when they are moved by as much as their clock or their path is late. An event stands for
//! the light that made its step before it, and for the light that is lost after it: half an interval less a
//! blind time, which is no delay and is subtracted. A pixel that is blind after each event does not see what
//! the light does meanwhile: the faster its events follow each other, the further the light went for each.
//! `change = threshold * interval / (interval - blind)` for steady light, which is fitted; without a blind
//! time the change for an event does not depend on how fast they come, whatever the scene does.
//!
//! Limits: frames that average over a large part of their period are the business of [`super::means`]; finer
//! delays, and bandwidths that depend on light, are the business of tests that estimate the scene. Another
//! threshold than stated changes neither. Estimates have an error of up to a third.

use super::array::{half, lowest};
use super::departure::{Departure, NATS};
use super::still::noise_dn;
use photocurrent_scene::case::{Case, PixelEvent};
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::statistics::quantile;

/// Exposures longer than this share of the period say too little.
pub(super) const LONGEST_EXPOSURE: f64 = 0.25;
/// So few changes decide nothing.
pub(super) const FEWEST: usize = 1000;
/// A frame value must be so many standard deviations of its noise above black.
pub(super) const SIGNAL: f64 = 12.0;
/// And below this share of saturation.
pub(super) const FULL: f64 = 0.98;
/// Shifts that are tried, as a share of the frame period each way, and how many.
const REACH: f64 = 0.4;
const SHIFTS: i64 = 40;
/// A delay counts from 1 ms on,
pub(super) const DELAY_NS: f64 = 1e6;
/// from this share of the exposure,
const DELAY_EXPOSURES: f64 = 0.3;
/// and from this share of the period on.
const DELAY_PERIODS: f64 = 0.04;
/// Events that are early by less than this multiple of the shortest interval may be late enough, and their
/// pixels blind.
pub(super) const SHORTEST: f64 = 1.2;
/// A blind time must be longer than stated by this share of the shortest intervals,
const BLIND_INTERVALS: f64 = 0.25;
/// and by this share of the exposure.
const BLIND_EXPOSURES: f64 = 0.05;

/// Two frames that follow each other, in a pixel.
#[derive(Clone, Copy, Debug)]
struct Change {
    pixel: usize,
    /// From the middle of one exposure to that of the next, ns.
    span: (i64, i64),
    /// Of the log light.
    log: f64,
}

/// Log light and times of all frames.
struct Changes {
    all: Vec<Change>,
    period_ns: f64,
    exposure_ns: f64,
}

impl Changes {
    /// Of a recording; none where its frames are too few, or average over too much of their period. Pixels of
    /// `masked` are left out.
    fn of(case: &Case, nominal: &Nominal, masked: &[u32]) -> Option<Changes> {
        let frames = case.frames.as_ref().filter(|frames| frames.times.len() >= 5)?;
        let exposures = &frames.times.exposures;
        let count = exposures.len();
        let period_ns = frames.times.mean_period_ns()?;
        let exposure_ns = frames.times.nominal_exposure_ns()? as f64;
        if exposure_ns > LONGEST_EXPOSURE * period_ns {
            return None;
        }
        let least = f64::max(SIGNAL * noise_dn(case, frames), 2.0);
        let number = &nominal.number;
        let log = |frame: usize, pixel: usize| -> Option<f64> {
            let dn = case.dn(frame, pixel);
            let signal = dn - number.black_level;
            (dn < FULL * nominal.saturation_dn && signal > least).then(|| libm::log(signal))
        };
        let mut all = Vec::new();
        for pixel in (0..case.extent.pixels()).filter(|&pixel| {
            !case.events.of(pixel).is_empty() && masked.binary_search(&(pixel as u32)).is_err()
        }) {
            let y = case.place(pixel).1;
            let middle = |frame: usize| {
                let exposure = frames.times.exposure(frame, y);
                i64::midpoint(exposure.start.0, exposure.end.0)
            };
            for frame in 1..count {
                if let (Some(before), Some(after)) = (log(frame - 1, pixel), log(frame, pixel)) {
                    all.push(Change { pixel, span: (middle(frame - 1), middle(frame)), log: after - before });
                }
            }
        }
        Some(Changes { all, period_ns, exposure_ns })
    }
}

/// Sums for a least-squares fit of one number by up to three others.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sums {
    products: [[f64; 3]; 3],
    with: [f64; 3],
    square: f64,
    count: f64,
}

impl Sums {
    pub(super) fn add(&mut self, by: [f64; 3], value: f64) {
        for a in 0..3 {
            for b in 0..3 {
                self.products[a][b] += by[a] * by[b];
            }
            self.with[a] += by[a] * value;
        }
        self.square += value * value;
        self.count += 1.0;
    }

    pub(super) fn and(&self, other: &Sums) -> Sums {
        let mut sum = *self;
        for a in 0..3 {
            for b in 0..3 {
                sum.products[a][b] += other.products[a][b];
            }
            sum.with[a] += other.with[a];
        }
        sum.square += other.square;
        sum.count += other.count;
        sum
    }

    /// The best factors of the first `n`; none where they cannot be separated.
    pub(super) fn solve(&self, n: usize) -> Option<[f64; 3]> {
        let mut rows = self.products;
        let mut right = self.with;
        for k in 0..n {
            if rows[k][k] < 1e-9 * f64::max(self.products[k][k], 1e-12) {
                return None;
            }
            for below in k + 1..n {
                let factor = rows[below][k] / rows[k][k];
                for column in k..n {
                    rows[below][column] -= factor * rows[k][column];
                }
                right[below] -= factor * right[k];
            }
        }
        let mut factors = [0.0; 3];
        for k in (0..n).rev() {
            let known: f64 = (k + 1..n).map(|column| rows[k][column] * factors[column]).sum();
            factors[k] = (right[k] - known) / rows[k][k];
        }
        Some(factors)
    }

    /// Sum of squares that factors leave.
    pub(super) fn left(&self, factors: [f64; 3]) -> f64 {
        let mut left = self.square;
        for a in 0..3 {
            left -= 2.0 * factors[a] * self.with[a];
            left += (0..3).map(|b| factors[a] * factors[b] * self.products[a][b]).sum::<f64>();
        }
        left.max(0.0)
    }
}

/// One half of the changes predicted with what the other half says.
pub(super) struct Predicted {
    pub these: Sums,
    pub from: Sums,
    pub factors: [f64; 3],
}

impl Predicted {
    /// With the factors that are best on `from`; none where they cannot be separated.
    pub(super) fn new(these: Sums, from: Sums, n: usize) -> Option<Predicted> {
        Some(Predicted { these, from, factors: from.solve(n)? })
    }

    /// Normal errors, of the size that they have in `from`; nats.
    pub(super) fn log_likelihood(&self) -> f64 {
        let variance = f64::max(self.from.left(self.factors) / f64::max(self.from.count, 1.0), 1e-12);
        -0.5 * (self.these.count * libm::log(variance) + self.these.left(self.factors) / variance)
    }
}

/// Sums of both halves for shifts of the events, from the earliest to the latest.
pub(super) struct Shifts {
    step_ns: f64,
    tried: Vec<[Sums; 2]>,
}

impl Shifts {
    /// Adds up to each shift's sums what `add` says of it, item by item: what is known of an item is at hand
    /// for all shifts. Events are moved earlier by the shift, ns.
    pub(super) fn tried<T>(
        period_ns: f64,
        items: impl IntoIterator<Item = T>,
        add: impl Fn(&T, i64, &mut [Sums; 2]),
    ) -> Shifts {
        let step_ns = REACH * period_ns / SHIFTS as f64;
        let mut tried: Vec<(i64, [Sums; 2])> =
            (-SHIFTS..=SHIFTS).map(|k| ((k as f64 * step_ns).round() as i64, Default::default())).collect();
        for item in items {
            tried.iter_mut().for_each(|(shift_ns, sums)| add(&item, *shift_ns, sums));
        }
        Shifts { step_ns, tried: tried.into_iter().map(|(_, sums)| sums).collect() }
    }

    fn left(sums: &Sums) -> f64 {
        sums.solve(2).map_or(f64::INFINITY, |factors| sums.left(factors))
    }

    /// By how much events come late, ns; none at the rim.
    pub(super) fn best_ns(&self) -> Option<f64> {
        let curve: Vec<f64> = self.tried.iter().map(|[a, b]| Shifts::left(&a.and(b))).collect();
        Some((lowest(&curve)? - SHIFTS as f64) * self.step_ns)
    }

    /// Gain over no shift, each half predicted at the shift that is best on the other, nats.
    pub(super) fn nats(&self) -> f64 {
        let unmoved = &self.tried[SHIFTS as usize];
        let gain = |side: usize| -> Option<f64> {
            let other = 1 - side;
            let moved = self
                .tried
                .iter()
                .min_by(|a, b| Shifts::left(&a[other]).total_cmp(&Shifts::left(&b[other])))?;
            let better = Predicted::new(moved[side], moved[other], 2)?;
            Some(better.log_likelihood() - Predicted::new(unmoved[side], unmoved[other], 2)?.log_likelihood())
        };
        gain(0).zip(gain(1)).map_or(0.0, |(a, b)| a + b)
    }
}

/// Events of a pixel at the middle of the light that they stand for: what made their step before them, and
/// what is lost after them while the pixel is blind. The next interval of the same sign stands in where it is
/// shorter, and `usual_ns` where there is none.
pub(super) fn centred(events: &[PixelEvent], usual_ns: i64, blind_ns: i64) -> impl Iterator<Item = i64> {
    let interval = |a: usize, b: usize| {
        (events[a].polarity == events[b].polarity).then(|| events[b].t_in_ns - events[a].t_in_ns)
    };
    (0..events.len()).map(move |k| {
        let before = k.checked_sub(1).and_then(|before| interval(before, k));
        let after = (k + 1 < events.len()).then(|| interval(k, k + 1)).flatten();
        let way =
            [before, after].into_iter().flatten().min().map_or(2 * usual_ns, |way| way.min(3 * usual_ns));
        events[k].t_in_ns - way / 2 + blind_ns
    })
}

/// Intervals between events of one sign, rising, ns.
pub(super) fn intervals(case: &Case) -> Vec<i64> {
    let pairs = (0..case.events.pixels()).flat_map(|pixel| case.events.of(pixel).windows(2));
    let mut all: Vec<i64> = pairs
        .filter(|pair| pair[0].polarity == pair[1].polarity)
        .map(|pair| pair[1].t_in_ns - pair[0].t_in_ns)
        .collect();
    all.sort_unstable();
    all
}

/// What changes between frames show: a blind time, and a delay. The blind time does not ask for the delay
/// exactly, the delay does for the blind time.
pub(super) fn findings(case: &Case, nominal: &Nominal, masked: &[u32]) -> Vec<Departure> {
    let Some(changes) = Changes::of(case, nominal, masked) else { return Vec::new() };
    let stated_ns = nominal.pixel.refractory_ns;
    let (late_ns, as_stated) = late(case, nominal, &changes, stated_ns);
    let Some(blind) = blind(case, nominal, &changes, late_ns) else { return as_stated.into_iter().collect() };
    let blind_ns = blind.parameters.first().map_or(stated_ns, |(_, seconds)| (seconds * 1e9) as i64);
    late(case, nominal, &changes, blind_ns).1.into_iter().chain([blind]).collect()
}

/// By how much events come later than the frames say, ns (less is earlier), and the finding when that is an
/// offset; pixels are blind for `blind_ns`.
fn late(case: &Case, nominal: &Nominal, changes: &Changes, blind_ns: i64) -> (f64, Option<Departure>) {
    let usual_ns = quantile(&intervals(case), 0.5);
    let threshold = 0.5 * (nominal.pixel.threshold_on + nominal.pixel.threshold_off);
    let large: Vec<&Change> = changes.all.iter().filter(|change| change.log.abs() > threshold).collect();
    if large.len() < FEWEST {
        return (0.0, None);
    }
    // Changes come pixel by pixel: of each, the events as they are and at the middle of their ways.
    let mut plain: Vec<Vec<(i64, i8)>> = Vec::new();
    let mut middles: Vec<Vec<(i64, i8)>> = Vec::new();
    let mut place = Vec::with_capacity(large.len());
    for (k, change) in large.iter().enumerate() {
        if k == 0 || large[k - 1].pixel != change.pixel {
            let events = case.events.of(change.pixel);
            plain.push(events.iter().map(|event| (event.t_in_ns, event.polarity)).collect());
            let mut middle: Vec<(i64, i8)> = centred(events, usual_ns, blind_ns)
                .zip(events)
                .map(|(t_ns, event)| (t_ns, event.polarity))
                .collect();
            middle.sort_unstable();
            middles.push(middle);
        }
        place.push(plain.len() - 1);
    }
    let shifted = |events: &[Vec<(i64, i8)>]| {
        Shifts::tried(changes.period_ns, large.iter().zip(&place), |(change, place), shift_ns, sums| {
            let events = &events[**place];
            let at = |t_ns: i64| events.partition_point(|event| event.0 < t_ns + shift_ns);
            let within = &events[at(change.span.0)..at(change.span.1)];
            let on = within.iter().filter(|event| event.1 > 0).count() as f64;
            sums[half(case, change.pixel)].add([on, on - within.len() as f64, 0.0], change.log);
        })
    };
    let of_shift = shifted(&middles);
    let Some(late_ns) = of_shift.best_ns() else { return (0.0, None) };
    let nats = of_shift.nats();
    let least = DELAY_NS.max(DELAY_EXPOSURES * changes.exposure_ns).max(DELAY_PERIODS * changes.period_ns);
    // Light that is lost after events makes them look early by the blind time, which is at most the shortest
    // interval.
    let shortest = quantile(&intervals(case), 0.001);
    let is_loss = -late_ns > 0.0 && -late_ns < SHORTEST * (shortest - blind_ns) as f64;
    if late_ns.abs() < least || nats < NATS || is_loss {
        return (late_ns, None);
    }
    let within = |change: &Change| {
        let at = |t_ns: i64| case.events.of(change.pixel).partition_point(|event| event.t_in_ns < t_ns);
        at(change.span.1) - at(change.span.0)
    };
    let raw_ns = shifted(&plain).best_ns().unwrap_or(late_ns);
    let events = large.iter().map(|change| within(change)).sum();
    let seen = format!(
        "{} changes between frames agree best with the events when these are taken {:.2} ms {}; as \
         recorded, with the time that a threshold takes, {:.2} ms",
        large.len(),
        late_ns.abs() * 1e-6,
        if late_ns > 0.0 { "earlier" } else { "later" },
        raw_ns.abs() * 1e-6
    );
    let finding = Departure::of_halves("clock_offset", ("offset", late_ns * 1e-9), nats, events, seen);
    (late_ns, Some(finding))
}

/// Events of one sign between two frames.
struct Run {
    half: usize,
    is_on: bool,
    /// How far the log light went their way.
    log: f64,
    /// Between them, ns.
    intervals: Vec<i64>,
}

impl Run {
    /// The events, and the light that is lost for one threshold and a blind time of 1 s: the first event's is
    /// that of the others on average.
    fn terms(&self, blind_ns: f64) -> (f64, f64) {
        let events = self.intervals.len() as f64 + 1.0;
        let lost: f64 = self
            .intervals
            .iter()
            .map(|interval| 1e9 / f64::max(*interval as f64 - blind_ns, 0.25 * *interval as f64))
            .sum();
        (events, lost * events / (events - 1.0))
    }
}

/// Sums of both halves: thresholds of ON and OFF, and what is lost with a blind time that is `free`, or else
/// as it is assumed.
fn sums_of(runs: &[Run], blind_ns: f64, is_free: bool) -> [Sums; 2] {
    let mut sums = [Sums::default(); 2];
    for run in runs {
        let (events, lost) = run.terms(blind_ns);
        let seen = if is_free { events } else { events + blind_ns * 1e-9 * lost };
        let (on, off) = if run.is_on { (seen, 0.0) } else { (0.0, seen) };
        sums[run.half].add([on, off, if is_free { lost } else { 0.0 }], run.log);
    }
    sums
}

/// A blind time longer than stated: light goes further for an event where events follow each other faster.
/// `late_ns` is by how much events come late.
fn blind(case: &Case, nominal: &Nominal, changes: &Changes, late_ns: f64) -> Option<Departure> {
    let late = late_ns.round() as i64;
    let runs: Vec<Run> = changes
        .all
        .iter()
        .filter_map(|change| {
            let events = case.events.of(change.pixel);
            let at = |t_ns: i64| events.partition_point(|event| event.t_in_ns < t_ns + late);
            let within = &events[at(change.span.0)..at(change.span.1)];
            let first = within.first().filter(|first| {
                within.len() >= 3 && within.iter().all(|event| event.polarity == first.polarity)
            })?;
            let intervals: Vec<i64> =
                within.windows(2).map(|pair| pair[1].t_in_ns - pair[0].t_in_ns).collect();
            let is_on = first.polarity > 0;
            intervals.iter().all(|interval| *interval > 0).then(|| Run {
                half: half(case, change.pixel),
                is_on,
                log: if is_on { change.log } else { -change.log },
                intervals,
            })
        })
        .collect();
    if runs.len() < FEWEST {
        return None;
    }
    let mut within: Vec<i64> = runs.iter().flat_map(|run| run.intervals.iter().copied()).collect();
    within.sort_unstable();
    let short_ns = quantile(&within, 0.02) as f64;
    // What is lost goes with the interval less the blind time, which is not known before: a few rounds.
    let blind_ns = |factors: [f64; 3]| factors[2] / (0.5 * (factors[0] + factors[1])) * 1e9;
    let fit = |of: &dyn Fn([Sums; 2]) -> Sums| -> Option<(f64, f64)> {
        let (mut assumed, mut found) = (0.0, 0.0);
        for _ in 0..20 {
            found = blind_ns(of(sums_of(&runs, assumed, true)).solve(3)?);
            assumed = (0.5 * (assumed + found)).clamp(0.0, 0.9 * short_ns);
        }
        Some((found, assumed))
    };
    let (found_ns, _) = fit(&|[a, b]| a.and(&b))?;
    let stated_ns = nominal.pixel.refractory_ns as f64;
    // A blind time longer than the shortest intervals contradicts them.
    if found_ns - stated_ns < f64::max(BLIND_INTERVALS * short_ns, BLIND_EXPOSURES * changes.exposure_ns)
        || found_ns > 1.2 * short_ns
    {
        return None;
    }
    let stated = sums_of(&runs, stated_ns, false);
    let gain = |side: usize| -> Option<f64> {
        let other = 1 - side;
        let (_, assumed) = fit(&|halves| halves[other])?;
        let blind = sums_of(&runs, assumed, true);
        let better = Predicted::new(blind[side], blind[other], 3)?;
        Some(better.log_likelihood() - Predicted::new(stated[side], stated[other], 2)?.log_likelihood())
    };
    let nats = gain(0)? + gain(1)?;
    if nats < NATS {
        return None;
    }
    let shortest = quantile(&intervals(case), 0.001) as f64;
    let value_ns = f64::min(found_ns, shortest);
    let seen = format!(
        "in {} runs of events between two frames light went the further for an event the faster they came, \
         as if pixels were blind for {:.0} us after each; a thousandth of the intervals is shorter than \
         {:.0} us",
        runs.len(),
        found_ns * 1e-3,
        shortest * 1e-3
    );
    Some(Departure::of_halves(
        "refractory",
        ("refractory", value_ns * 1e-9),
        nats,
        within.len() + runs.len(),
        seen,
    ))
}
