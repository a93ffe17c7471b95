//! Event counts of the whole array in windows of time: one count that repeats (events beyond it are lost),
//! and bursts in step with the frames.

use super::array::EventsByTime;
use super::departure::Departure;
use photocurrent_scene::case::Case;

/// Lengths of windows that are tried, ns: those that programs use, and the resolutions of buffers.
const WINDOWS_NS: [i64; 8] = [50_000, 100_000, 200_000, 500_000, 1_000_000, 2_000_000, 5_000_000, 10_000_000];
/// Least number of windows with the most frequent count.
const FULL_WINDOWS: usize = 10;
/// Least ratio to the mean number of windows with the counts within five of it.
const FULL_OVER_NEXT: f64 = 5.0;
/// Largest share of windows with more events: latencies carry events into the next window.
const OVERFULL: f64 = 0.2;

/// Event loss: windows do not exceed a maximum count.
pub(super) fn loss(case: &Case, stream: &EventsByTime) -> Option<Departure> {
    let (first, last) = stream.span()?;
    let mut found: Vec<(f64, Departure)> = Vec::new();
    for window in WINDOWS_NS.into_iter().filter(|window| (last - first) / window >= 30) {
        // Windows are counted from 0 or from the first stamp.
        for origin in [0, first] {
            found.extend(full(case, stream, window, origin));
        }
    }
    // Parts of the buffer's own window are full sometimes, and its multiples as often as itself: the shortest
    // of those that are full most often.
    let most = found.iter().map(|(share, _)| *share).fold(0.0, f64::max);
    found.into_iter().find(|(share, _)| *share >= 0.9 * most).map(|(_, finding)| finding)
}

/// Windows of one length at their maximum: their share, and the implied limit; `None` without such a count.
fn full(case: &Case, stream: &EventsByTime, window: i64, origin: i64) -> Option<(f64, Departure)> {
    let counts = windows(stream, origin, window);
    let most = counts.iter().map(|count| count.0).max().unwrap_or(0);
    let mut with = vec![0_usize; most + 6];
    counts.iter().for_each(|count| with[count.0] += 1);
    let cap = (20..=most).max_by_key(|&count| (with[count], count))?;
    let around = (cap - 5..=cap + 5).filter(|&count| count != cap).map(|count| with[count]).sum::<usize>()
        as f64
        / 10.0;
    let ratio = with[cap] as f64 / f64::max(around, 1.0);
    let over = with[cap + 1..].iter().sum::<usize>();
    if with[cap] < FULL_WINDOWS || ratio < FULL_OVER_NEXT || over as f64 > OVERFULL * counts.len() as f64 {
        return None;
    }
    // Where the last event of a full window stands shows how much more would have come.
    let step = case.t_resolution_ns.max(1);
    let lost =
        |last: i64| cap as f64 * (window as f64 / ((last + step).clamp(window / 10, window)) as f64 - 1.0);
    let lost: f64 = counts.iter().filter(|count| count.0 == cap).map(|count| lost(count.1)).sum();
    let fraction = lost / (lost + stream.0.len() as f64);
    let finding = Departure {
        id: "event_loss",
        parameters: vec![("fraction", fraction)],
        statistic: ratio,
        threshold: FULL_OVER_NEXT,
        share: fraction,
        polarity: "both",
        pixels: Vec::new(),
        seen: format!(
            "{} of {} windows of {} us hold exactly {cap} events: what is beyond is lost",
            with[cap],
            counts.len(),
            window / 1000
        ),
        heldout: None,
        ci95: Vec::new(),
    };
    Some((with[cap] as f64 / counts.len() as f64, finding))
}

/// For each window with events: their number, and the time of the last one since its start, ns.
fn windows(stream: &EventsByTime, origin: i64, window: i64) -> Vec<(usize, i64)> {
    let mut counts: Vec<(usize, i64)> = Vec::new();
    let mut at = i64::MIN;
    for event in &stream.0 {
        let number = (event.t_ns - origin).div_euclid(window);
        let inside = event.t_ns - origin - number * window;
        match counts.last_mut() {
            Some(count) if number == at => *count = (count.0 + 1, inside),
            _ => counts.push((1, inside)),
        }
        at = number;
    }
    counts
}

/// Bins of the time from a frame's start to the next one's.
const BINS: usize = 50;

/// Bursts at one phase of the frames, of one sign, in nearly every frame.
pub(super) fn frame_coupling(case: &Case, stream: &EventsByTime) -> Option<Departure> {
    let frames = case.frames.as_ref()?;
    let starts: Vec<i64> = frames.times.exposures.iter().map(|exposure| exposure.start.0).collect();
    let (first, last) = stream.span()?;
    let mut counts = vec![[0_usize; BINS]; starts.len().saturating_sub(1)];
    let mut signs = [0_i64; BINS];
    for event in &stream.0 {
        let frame = starts.partition_point(|start| *start <= event.t_ns);
        if frame == 0 || frame >= starts.len() {
            continue;
        }
        let period = starts[frame] - starts[frame - 1];
        let bin = (((event.t_ns - starts[frame - 1]) as i128 * BINS as i128 / i128::from(period.max(1)))
            as usize)
            .min(BINS - 1);
        counts[frame - 1][bin] += 1;
        signs[bin] += i64::from(event.polarity);
    }
    let whole: Vec<usize> =
        (0..counts.len()).filter(|&frame| starts[frame] >= first && starts[frame + 1] <= last).collect();
    if whole.len() < 5 {
        return None;
    }
    let total = |bin: usize| whole.iter().map(|&frame| counts[frame][bin]).sum::<usize>();
    let bin = (0..BINS).max_by_key(|&bin| (total(bin), BINS - bin))?;
    // The scene's own ups and downs are slower than a fiftieth of a period: compare with bins a little away.
    let away: Vec<usize> =
        [bin + BINS - 4, bin + BINS - 3, bin + 3, bin + 4].iter().map(|bin| bin % BINS).collect();
    let around =
        |frame: usize| away.iter().map(|&bin| counts[frame][bin]).sum::<usize>() as f64 / away.len() as f64;
    let in_step =
        whole.iter().filter(|&&frame| counts[frame][bin] as f64 > 1.5 * around(frame) + 5.0).count();
    let level = whole.iter().map(|&frame| around(frame)).sum::<f64>();
    let ratio = total(bin) as f64 / f64::max(level, 1.0);
    let everywhere: usize = counts.iter().map(|bins| bins[bin]).sum();
    let lean = signs[bin] as f64 / everywhere.max(1) as f64;
    if ratio < FRAME_RATIO || in_step * 10 < whole.len() * 8 || lean.abs() < 0.5 {
        return None;
    }
    Some(Departure {
        id: "frame_coupling",
        parameters: Vec::new(),
        statistic: ratio,
        threshold: FRAME_RATIO,
        share: (total(bin) as f64 - level) / stream.0.len() as f64,
        polarity: if lean > 0.0 { "on" } else { "off" },
        pixels: Vec::new(),
        seen: format!(
            "in {in_step} of {} frame periods {ratio:.1} times as many events as around come at {:.0} % of \
             the period, {:.0} % of them {}",
            whole.len(),
            100.0 * (bin as f64 + 0.5) / BINS as f64,
            50.0 * (1.0 + lean.abs()),
            if lean > 0.0 { "ON" } else { "OFF" }
        ),
        heldout: None,
        ci95: Vec::new(),
    })
}

/// Least ratio of the events of a burst to those of the bins around it.
const FRAME_RATIO: f64 = 2.0;
