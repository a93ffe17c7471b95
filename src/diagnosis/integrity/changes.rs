//! Compares the change of log light between two frames with the events between them: late events
//! (`event_delay`) and light lost while pixels are blind (`blind`).
//!
//! Each event between two frames stands for one threshold of log light. Events agree best with the frames
//! when they are shifted by the delay of their clock or path. An event stands for the light before it that
//! made its step, and for the light after it that is lost. That is half an interval less a blind time; it is
//! no delay and is subtracted.
//!
//! A pixel is blind after each event. The faster its events follow each other, the larger the change of light
//! per event: `change = threshold * interval / (interval - blind)` for steady light, which is fitted. Without
//! a blind time the change per event does not depend on the interval, whatever the scene.
//!
//! Limits: frames that average over a large part of their period are evaluated by [`super::means`]; finer
//! delays, and bandwidths that depend on light, by tests that estimate the scene. A wrong threshold changes
//! neither estimate. Estimates have an error of up to a third.

use super::array::{half, lowest};
use super::departure::{Departure, NATS};
use super::still::noise_dn;
use photocurrent_scene::case::{Case, PixelEvent};
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::statistics::quantile;

/// Longest exposure that is evaluated, as a share of the frame period.
pub(super) const LONGEST_EXPOSURE: f64 = 0.25;
/// Least number of changes for a test.
pub(super) const FEWEST: usize = 1000;
/// Least signal of a frame value, standard deviations of its noise above black.
pub(super) const SIGNAL: f64 = 12.0;
/// And below this share of saturation.
pub(super) const FULL: f64 = 0.98;
/// Shifts that are tried, as a share of the frame period each way, and how many.
const REACH: f64 = 0.4;
const SHIFTS: i64 = 40;
/// Least delay that is reported, ns,
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
struct FrameChange {
    pixel: usize,
    /// From the middle of one exposure to that of the next, ns.
    span: (i64, i64),
    /// Of the log light.
    log: f64,
}

/// Log light and times of all frames.
struct FrameChanges {
    all: Vec<FrameChange>,
    period_ns: f64,
    exposure_ns: f64,
}

impl FrameChanges {
    /// From a recording, without the pixels of `masked`. `None` where its frames are too few, or their
    /// exposures too long a part of the period.
    fn from_case(case: &Case, nominal: &Nominal, masked: &[u32]) -> Option<FrameChanges> {
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
            !case.events.of_pixel(pixel).is_empty() && masked.binary_search(&(pixel as u32)).is_err()
        }) {
            let y = case.pixel_place(pixel).1;
            let middle = |frame: usize| {
                let exposure = frames.times.exposure(frame, y);
                i64::midpoint(exposure.start.0, exposure.end.0)
            };
            for frame in 1..count {
                if let (Some(before), Some(after)) = (log(frame - 1, pixel), log(frame, pixel)) {
                    all.push(FrameChange {
                        pixel,
                        span: (middle(frame - 1), middle(frame)),
                        log: after - before,
                    });
                }
            }
        }
        Some(FrameChanges { all, period_ns, exposure_ns })
    }
}

/// Sums for a least-squares fit of one number by up to three others.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RegressionSums {
    products: [[f64; 3]; 3],
    with: [f64; 3],
    square: f64,
    count: f64,
}

impl RegressionSums {
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

    pub(super) fn plus(&self, other: &RegressionSums) -> RegressionSums {
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
    pub(super) fn residual_squares(&self, factors: [f64; 3]) -> f64 {
        let mut left = self.square;
        for a in 0..3 {
            left -= 2.0 * factors[a] * self.with[a];
            left += (0..3).map(|b| factors[a] * factors[b] * self.products[a][b]).sum::<f64>();
        }
        left.max(0.0)
    }
}

/// Changes of one half, predicted with the fit of the other half.
pub(super) struct CrossPrediction {
    pub these: RegressionSums,
    pub from: RegressionSums,
    pub factors: [f64; 3],
}

impl CrossPrediction {
    /// With the factors that are best on `from`; none where they cannot be separated.
    pub(super) fn new(these: RegressionSums, from: RegressionSums, n: usize) -> Option<CrossPrediction> {
        Some(CrossPrediction { these, from, factors: from.solve(n)? })
    }

    /// Normal errors, of the size that they have in `from`; nats.
    pub(super) fn log_likelihood(&self) -> f64 {
        let variance =
            f64::max(self.from.residual_squares(self.factors) / f64::max(self.from.count, 1.0), 1e-12);
        -0.5 * (self.these.count * libm::log(variance) + self.these.residual_squares(self.factors) / variance)
    }
}

/// Sums of both halves for shifts of the events, from the earliest to the latest.
pub(super) struct ShiftSums {
    step_ns: f64,
    tried: Vec<[RegressionSums; 2]>,
}

impl ShiftSums {
    /// Accumulates the sums of every shift, item by item, with `add`. Events are moved earlier by the shift,
    /// ns.
    pub(super) fn over_shifts<T>(
        period_ns: f64,
        items: impl IntoIterator<Item = T>,
        add: impl Fn(&T, i64, &mut [RegressionSums; 2]),
    ) -> ShiftSums {
        let step_ns = REACH * period_ns / SHIFTS as f64;
        let mut tried: Vec<(i64, [RegressionSums; 2])> =
            (-SHIFTS..=SHIFTS).map(|k| ((k as f64 * step_ns).round() as i64, Default::default())).collect();
        for item in items {
            tried.iter_mut().for_each(|(shift_ns, sums)| add(&item, *shift_ns, sums));
        }
        ShiftSums { step_ns, tried: tried.into_iter().map(|(_, sums)| sums).collect() }
    }

    fn least_residual(sums: &RegressionSums) -> f64 {
        sums.solve(2).map_or(f64::INFINITY, |factors| sums.residual_squares(factors))
    }

    /// Delay of the events, ns; `None` at the end of the searched range.
    pub(super) fn best_ns(&self) -> Option<f64> {
        let curve: Vec<f64> = self.tried.iter().map(|[a, b]| ShiftSums::least_residual(&a.plus(b))).collect();
        Some((lowest(&curve)? - SHIFTS as f64) * self.step_ns)
    }

    /// Gain over no shift, each half predicted at the shift that is best on the other, nats.
    pub(super) fn nats(&self) -> f64 {
        let unmoved = &self.tried[SHIFTS as usize];
        let gain = |side: usize| -> Option<f64> {
            let other = 1 - side;
            let moved = self.tried.iter().min_by(|a, b| {
                ShiftSums::least_residual(&a[other]).total_cmp(&ShiftSums::least_residual(&b[other]))
            })?;
            let better = CrossPrediction::new(moved[side], moved[other], 2)?;
            Some(
                better.log_likelihood()
                    - CrossPrediction::new(unmoved[side], unmoved[other], 2)?.log_likelihood(),
            )
        };
        gain(0).zip(gain(1)).map_or(0.0, |(a, b)| a + b)
    }
}

/// Events of a pixel, each at the middle of the light that it stands for: its step before it, and the light
/// lost in the blind time after it. The next interval of the same sign is used where it is shorter, and
/// `usual_ns` where there is none.
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
    let pairs = (0..case.events.pixels()).flat_map(|pixel| case.events.of_pixel(pixel).windows(2));
    let mut all: Vec<i64> = pairs
        .filter(|pair| pair[0].polarity == pair[1].polarity)
        .map(|pair| pair[1].t_in_ns - pair[0].t_in_ns)
        .collect();
    all.sort_unstable();
    all
}

/// Findings from changes between frames: a blind time and a delay. The blind time is insensitive to the
/// delay; the delay depends on the blind time.
pub(super) fn findings(case: &Case, nominal: &Nominal, masked: &[u32]) -> Vec<Departure> {
    let Some(changes) = FrameChanges::from_case(case, nominal, masked) else { return Vec::new() };
    let stated_ns = nominal.pixel.refractory_ns;
    let (late_ns, as_stated) = event_delay(case, nominal, &changes, stated_ns);
    let Some(blind) = blind(case, nominal, &changes, late_ns) else { return as_stated.into_iter().collect() };
    let blind_ns = blind.parameters.first().map_or(stated_ns, |(_, seconds)| (seconds * 1e9) as i64);
    event_delay(case, nominal, &changes, blind_ns).1.into_iter().chain([blind]).collect()
}

/// Delay of events after frames, ns (negative = early), and the finding where it is an offset. Pixels are
/// blind for `blind_ns`.
fn event_delay(
    case: &Case,
    nominal: &Nominal,
    changes: &FrameChanges,
    blind_ns: i64,
) -> (f64, Option<Departure>) {
    let usual_ns = quantile(&intervals(case), 0.5);
    let threshold = 0.5 * (nominal.pixel.threshold_on + nominal.pixel.threshold_off);
    let large: Vec<&FrameChange> = changes.all.iter().filter(|change| change.log.abs() > threshold).collect();
    if large.len() < FEWEST {
        return (0.0, None);
    }
    // Changes come pixel by pixel: of each, the events as they are and at the middle of their ways.
    let mut plain: Vec<Vec<(i64, i8)>> = Vec::new();
    let mut middles: Vec<Vec<(i64, i8)>> = Vec::new();
    let mut place = Vec::with_capacity(large.len());
    for (k, change) in large.iter().enumerate() {
        if k == 0 || large[k - 1].pixel != change.pixel {
            let events = case.events.of_pixel(change.pixel);
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
        ShiftSums::over_shifts(
            changes.period_ns,
            large.iter().zip(&place),
            |(change, place), shift_ns, sums| {
                let events = &events[**place];
                let at = |t_ns: i64| events.partition_point(|event| event.0 < t_ns + shift_ns);
                let within = &events[at(change.span.0)..at(change.span.1)];
                let on = within.iter().filter(|event| event.1 > 0).count() as f64;
                sums[half(case, change.pixel)].add([on, on - within.len() as f64, 0.0], change.log);
            },
        )
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
    let within = |change: &FrameChange| {
        let at = |t_ns: i64| case.events.of_pixel(change.pixel).partition_point(|event| event.t_in_ns < t_ns);
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
    let finding = Departure::from_halves("clock_offset", ("offset", late_ns * 1e-9), nats, events, seen);
    (late_ns, Some(finding))
}

/// Events of one sign between two frames.
struct EventRun {
    half: usize,
    is_on: bool,
    /// How far the log light went their way.
    log: f64,
    /// Between them, ns.
    intervals: Vec<i64>,
}

impl EventRun {
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

/// Regression sums of both halves: ON and OFF thresholds, and the loss by a blind time that is `free` or
/// fixed.
fn sums_of(runs: &[EventRun], blind_ns: f64, is_free: bool) -> [RegressionSums; 2] {
    let mut sums = [RegressionSums::default(); 2];
    for run in runs {
        let (events, lost) = run.terms(blind_ns);
        let seen = if is_free { events } else { events + blind_ns * 1e-9 * lost };
        let (on, off) = if run.is_on { (seen, 0.0) } else { (0.0, seen) };
        sums[run.half].add([on, off, if is_free { lost } else { 0.0 }], run.log);
    }
    sums
}

/// A blind time longer than stated: the change of light per event grows with the event rate. `late_ns`: delay
/// of the events.
fn blind(case: &Case, nominal: &Nominal, changes: &FrameChanges, late_ns: f64) -> Option<Departure> {
    let late = late_ns.round() as i64;
    let runs: Vec<EventRun> = changes
        .all
        .iter()
        .filter_map(|change| {
            let events = case.events.of_pixel(change.pixel);
            let at = |t_ns: i64| events.partition_point(|event| event.t_in_ns < t_ns + late);
            let within = &events[at(change.span.0)..at(change.span.1)];
            let first = within.first().filter(|first| {
                within.len() >= 3 && within.iter().all(|event| event.polarity == first.polarity)
            })?;
            let intervals: Vec<i64> =
                within.windows(2).map(|pair| pair[1].t_in_ns - pair[0].t_in_ns).collect();
            let is_on = first.polarity > 0;
            intervals.iter().all(|interval| *interval > 0).then(|| EventRun {
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
    let fit = |of: &dyn Fn([RegressionSums; 2]) -> RegressionSums| -> Option<(f64, f64)> {
        let (mut assumed, mut found) = (0.0, 0.0);
        for _ in 0..20 {
            found = blind_ns(of(sums_of(&runs, assumed, true)).solve(3)?);
            assumed = (0.5 * (assumed + found)).clamp(0.0, 0.9 * short_ns);
        }
        Some((found, assumed))
    };
    let (found_ns, _) = fit(&|[a, b]| a.plus(&b))?;
    let stated_ns = nominal.pixel.refractory_ns as f64;
    // A blind time longer than the shortest intervals is impossible.
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
        let better = CrossPrediction::new(blind[side], blind[other], 3)?;
        Some(better.log_likelihood() - CrossPrediction::new(stated[side], stated[other], 2)?.log_likelihood())
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
    Some(Departure::from_halves(
        "refractory",
        ("refractory", value_ns * 1e-9),
        nats,
        within.len() + runs.len(),
        seen,
    ))
}
