//! Coupling of the frame readout into the events: the readout of a row shifts the voltage of its pixels, and
//! those near a threshold fire.
//!
//! Where nothing moves ([`super::still`]) nearly all events are of that kind. Elsewhere those of a strong
//! impulse stand out. Event times since the start of the frame, less a delay per row, are tested for all
//! delays at which the readout ends within a period. The delay that concentrates the events is the readout's,
//! and the peak is the instant. One half of the array selects, the other is predicted. Source: Brandli et al.
//! (2014), the shared readout of DAVIS pixels.
//!
//! The size of an impulse follows where light changes steadily. Between two events of one sign the distance
//! to the threshold is uniform, so an impulse of `step` fires `step / threshold` of the pixels. Limit: a slow
//! front end, or an impulse that lasts, fires later events as well; they are not counted.

use super::array::half;
use super::departure::{Departure, HalvesGain};
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::statistics::quantile;

/// Parts of a frame period.
const BINS: usize = 50;
/// Delays of rows that are tried, each way: the last is a readout that takes the whole period.
const DELAYS: i64 = 2 * BINS as i64;
/// Least number of events of one sign.
const FEWEST_EVENTS: usize = 30;
/// Least gain on the half that was not selected on, nats per event, where nothing moves: as if half of the
/// events came in a fifth of the time.
const NATS_AN_EVENT: f64 = 0.3;
/// And in all.
const NATS: f64 = 20.0;
/// Least ratio of the fullest bin to the mean.
const PEAK: f64 = 5.0;
/// Least share of the frames, or of the events where these are fewer, with an event in the bin.
const FRAMES: f64 = 0.4;
/// Least ratio of events of one sign to the other where the delay per row is 0: flicker in step with the
/// frames looks alike.
const LEAN: usize = 4;
/// Number of events of moving pixels that are evaluated.
const ENOUGH_EVENTS: usize = 40_000;
/// Least duration of the readout, in parts of a period, for a delay per row.
const SOME_ROWS: i64 = 3;

/// Instants since the start of the frame, by row.
struct ReadoutPhases {
    /// Row, time since the start of the frame before it (ns), frame, half of the array.
    events: Vec<(f64, f64, usize, usize)>,
    period: f64,
    height: f64,
}

impl ReadoutPhases {
    /// Delay of a row, ns: `number` of [`DELAYS`].
    fn delay(&self, number: i64) -> f64 {
        number as f64 * self.period / (DELAYS as f64 * self.height)
    }

    /// Counts by part of the period with a delay of rows, of the events that are kept.
    fn counts(&self, delay: f64, keep: impl Fn(usize) -> bool) -> [f64; BINS] {
        let mut counts = [0.0; BINS];
        for &(row, phase, _, half) in self.events.iter().filter(|event| keep(event.3)) {
            debug_assert!(half < 2);
            counts[self.bin(phase - row * delay)] += 1.0;
        }
        counts
    }

    fn bin(&self, phase: f64) -> usize {
        ((phase.rem_euclid(self.period) / self.period * BINS as f64) as usize).min(BINS - 1)
    }

    /// The delay that piles up most.
    fn sharpest(&self, keep: impl Fn(usize) -> bool + Copy) -> i64 {
        let sharpness = |number: i64| {
            self.counts(self.delay(number), keep).iter().map(|count| count * count).sum::<f64>()
        };
        let mut best = (0, sharpness(0));
        for number in (-DELAYS..=DELAYS).filter(|number| *number != 0) {
            let here = sharpness(number);
            if here > best.1 {
                best = (number, here);
            }
        }
        best.0
    }

    /// Nats that one half gains when it is predicted from the other.
    fn heldout(&self) -> f64 {
        (0..2)
            .map(|side| {
                let delay = self.delay(self.sharpest(|half| half != side));
                let seen = self.counts(delay, |half| half != side);
                let total: f64 = seen.iter().sum::<f64>() + BINS as f64;
                let there = self.counts(delay, |half| half == side);
                seen.iter()
                    .zip(there)
                    .map(|(seen, there)| there * libm::log((seen + 1.0) * BINS as f64 / total))
                    .sum::<f64>()
            })
            .sum()
    }

    /// Delay of a row and instant of row 0, ns, from the events about a pile: a straight line through them.
    fn line(&self, delay: f64, peak: usize) -> (f64, f64) {
        let (mut delay, mut middle) = (delay, (peak as f64 + 0.5) * self.period / BINS as f64);
        let width = 1.5 * self.period / BINS as f64;
        let rest = |phase: f64, at: f64| {
            (phase - at + 0.5 * self.period).rem_euclid(self.period) - 0.5 * self.period
        };
        let near = |delay: f64, middle: f64| -> Vec<(f64, f64)> {
            let all = self.events.iter().map(|&(row, phase, ..)| (row, rest(phase, middle + row * delay)));
            all.filter(|(_, rest)| rest.abs() < width).collect()
        };
        for _ in 0..4 {
            let near = near(delay, middle);
            let n = near.len() as f64;
            let (row, off) = (
                near.iter().map(|one| one.0).sum::<f64>() / n,
                near.iter().map(|one| one.1).sum::<f64>() / n,
            );
            let spread: f64 = near.iter().map(|one| (one.0 - row) * (one.0 - row)).sum();
            let slope =
                near.iter().map(|one| (one.0 - row) * (one.1 - off)).sum::<f64>() / f64::max(spread, 1.0);
            delay += slope;
            middle += off - slope * row;
        }
        // Events come after what makes them: the instant is where the first tenth of them stands.
        let mut rests: Vec<f64> = near(delay, middle).iter().map(|one| one.1).collect();
        rests.sort_by(f64::total_cmp);
        (delay, (middle + quantile(&rests, 0.1)).rem_euclid(self.period))
    }
}

/// Events in step with the row readout. `still`: pixels in which nothing moves; where these are too few, all
/// pixels are tested. `masked`: pixels left out.
pub(super) fn coupling(case: &Case, nominal: &Nominal, still: &[u32], masked: &[u32]) -> Option<Departure> {
    let count = |pixels: &[u32], polarity: i8| -> usize {
        let events = pixels.iter().map(|&pixel| case.events.of_pixel(pixel as usize));
        events.map(|events| events.iter().filter(|event| event.polarity == polarity).count()).sum()
    };
    let (on, off) = (count(still, 1), count(still, -1));
    let prevails = if on >= off { 1 } else { -1 };
    let found = test_polarity(case, nominal, still, prevails, on.min(off), masked, "where nothing moves");
    found.or_else(|| {
        let all: Vec<u32> =
            (0..case.extent.pixels() as u32).filter(|pixel| masked.binary_search(pixel).is_err()).collect();
        // A share of the pixels without a pattern, for rows and columns alike.
        let share = ENOUGH_EVENTS as f64 / case.events.len().max(1) as f64;
        let is_drawn =
            |pixel: u32| f64::from(pixel.wrapping_mul(2_654_435_761)) < share * f64::from(u32::MAX);
        let some: Vec<u32> = all.into_iter().filter(|&pixel| is_drawn(pixel)).collect();
        let strongest = [1, -1].into_iter().filter_map(|polarity| {
            test_polarity(case, nominal, &some, polarity, count(&some, -polarity), masked, "of all pixels")
        });
        strongest.max_by(|a, b| a.statistic.total_cmp(&b.statistic))
    })
}

/// The test on events of one sign of `pixels`, which have `other` events of the other sign. `where_from`
/// names these pixels in the report.
fn test_polarity(
    case: &Case,
    nominal: &Nominal,
    pixels: &[u32],
    polarity: i8,
    other: usize,
    masked: &[u32],
    where_from: &str,
) -> Option<Departure> {
    let starts: Vec<i64> =
        case.frames.as_ref()?.times.exposures.iter().map(|exposure| exposure.start.0).collect();
    let frames = starts.len();
    if frames < 5 {
        return None;
    }
    let period = (starts[frames - 1] - starts[0]) as f64 / (frames - 1) as f64;
    let is_regular = starts
        .windows(2)
        .all(|pair| ((pair[1] - pair[0]) as f64 - period).abs() < 0.25 * period / BINS as f64);
    if !is_regular {
        return None;
    }
    let phases = phases_of(case, pixels, polarity, &starts, period);
    if phases.events.len() < FEWEST_EVENTS {
        return None;
    }
    let number = phases.sharpest(|_| true);
    let counts = phases.counts(phases.delay(number), |_| true);
    let peak = (0..BINS).max_by(|&a, &b| counts[a].total_cmp(&counts[b]).then(b.cmp(&a)))?;
    let ratio = counts[peak] * BINS as f64 / phases.events.len() as f64;
    let mut in_step: Vec<usize> = phases
        .events
        .iter()
        .filter(|&&(row, phase, ..)| phases.bin(phase - row * phases.delay(number)) == peak)
        .map(|event| event.2)
        .collect();
    in_step.sort_unstable();
    in_step.dedup();
    let nats = phases.heldout();
    let is_row_wise = number.abs() >= SOME_ROWS * DELAYS / BINS as i64;
    if nats < f64::max(NATS, NATS_AN_EVENT * phases.events.len() as f64)
        || ratio < PEAK
        || (in_step.len() as f64) < FRAMES * f64::min(counts[peak], frames as f64)
        || !(is_row_wise || phases.events.len() >= LEAN * other)
    {
        return None;
    }
    let (delay, since_start) = phases.line(phases.delay(number), peak);
    let phase = (starts[0] as f64 + since_start).rem_euclid(period);
    let mut parameters = vec![("period", period * 1e-9), ("phase", phase * 1e-9), ("row_time", delay * 1e-9)];
    if let Some(step) = impulse(case, nominal, masked, polarity, &starts, (since_start, delay, period)) {
        parameters.insert(0, ("step", step));
    }
    let sign = if polarity > 0 { "ON" } else { "OFF" };
    Some(Departure {
        id: "frame_coupling",
        parameters,
        statistic: ratio,
        threshold: PEAK,
        share: counts[peak] / case.events.len() as f64,
        polarity: if polarity > 0 { "on" } else { "off" },
        pixels: Vec::new(),
        seen: format!(
            "of {} {sign} events {where_from}, {:.0} come in one fiftieth of the frame period, {:.2} ms \
             after the start of the exposure and {:.2} us later from row to row: {ratio:.0} times their \
             share",
            phases.events.len(),
            counts[peak],
            since_start * 1e-6,
            delay * 1e-3
        ),
        heldout: Some(HalvesGain { nats, events: phases.events.len() }),
        ci95: Vec::new(),
    })
}

/// Instants of the events of one sign of some pixels since the start of the frame.
fn phases_of(case: &Case, pixels: &[u32], polarity: i8, starts: &[i64], period: f64) -> ReadoutPhases {
    let width = case.extent.width as usize;
    let mut phases = ReadoutPhases { events: Vec::new(), period, height: f64::from(case.extent.height) };
    for &pixel in pixels {
        for event in case.events.of_pixel(pixel as usize).iter().filter(|event| event.polarity == polarity) {
            let frame = starts.partition_point(|start| *start <= event.t_off_ns);
            if (1..starts.len()).contains(&frame) {
                let since = (event.t_off_ns - starts[frame - 1]) as f64;
                phases.events.push((
                    (pixel as usize / width) as f64,
                    since,
                    frame - 1,
                    half(case, pixel as usize),
                ));
            }
        }
    }
    phases
}

/// Step of the front-end voltage at a readout, natural-log units, signed. `None` where events of moving
/// pixels are not more frequent at readouts than around them.
///
/// `readout` is (time of row 0 since the start of a frame, delay per row, period), ns.
fn impulse(
    case: &Case,
    nominal: &Nominal,
    masked: &[u32],
    polarity: i8,
    starts: &[i64],
    readout: (f64, f64, f64),
) -> Option<f64> {
    let (since_start, delay, period) = readout;
    let window = period / BINS as f64;
    let (mut hits, mut around, mut chances) = (0.0, 0.0, 0.0);
    for pixel in (0..case.events.pixels()).filter(|&pixel| masked.binary_search(&(pixel as u32)).is_err()) {
        let row = f64::from(case.pixel_place(pixel).1);
        // Time since the readout of row 0 of the first frame, in readouts of the own row.
        let readouts = |t_ns: i64| ((t_ns - starts[0]) as f64 - since_start - row * delay) / period;
        for pair in case
            .events
            .of_pixel(pixel)
            .windows(2)
            .filter(|pair| pair[0].polarity == polarity && pair[1].polarity == polarity)
        {
            let (before, after) = (readouts(pair[0].t_off_ns), readouts(pair[1].t_off_ns));
            // Slower light keeps step with the impulses: the way that is left at one is no longer anywhere in
            // the threshold.
            if after - before > 0.5 {
                continue;
            }
            chances += f64::max(after.floor() - before.floor(), 0.0);
            let since = (after - after.floor()) * period;
            if since < window {
                hits += 1.0;
            } else if (2.0 * window..4.0 * window).contains(&since)
                || (period - 3.0 * window..period - window).contains(&since)
            {
                around += 0.25;
            }
        }
    }
    let excess = hits - around;
    let threshold = if polarity > 0 { nominal.pixel.threshold_on } else { nominal.pixel.threshold_off };
    (chances >= 100.0 && excess > 5.0 * libm::sqrt(hits + around))
        .then(|| f64::from(polarity) * threshold * excess / chances)
}
