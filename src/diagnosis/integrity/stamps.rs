//! Time stamps: a coarser grid than stated, no grid where one is stated, gaps of one length that a queue
//! leaves.

use super::array::EventsByTime;
use super::departure::Departure;
use photocurrent_scene::case::Case;
use photocurrent_scene::statistics::quantile;

/// Coarser grid than stated: the recording is then evaluated with stamps of that width.
pub(crate) const GRID: &str = "timestamp_quantization";
/// This share of the stamps must sit on a grid.
const GRID_SHARE: f64 = 0.98;
/// Least grid or gap that is reported, in stated resolutions.
const COARSER: f64 = 1.5;
/// Resolution where none is stated, ns.
const USUAL_NS: f64 = 1000.0;
/// This share of the gaps must have one length.
const GAP_SHARE: f64 = 0.3;
/// Phases on the stated grid must be at least this concentrated (1 = all equal, 0 = anywhere).
const CONCENTRATION: f64 = 0.3;

/// Findings from time stamps.
pub(crate) fn findings(case: &Case, stream: &EventsByTime) -> Vec<Departure> {
    let stated = if case.t_resolution_ns > 0 { case.t_resolution_ns as f64 } else { USUAL_NS };
    let mut unique: Vec<i64> = stream.0.iter().map(|event| event.t_ns).collect();
    unique.dedup();
    let mut found = Vec::new();
    let Some((gap, share)) = usual_gap(&unique) else { return found };
    let grid = (1..=5).find_map(|part| on_grid(&unique, gap / f64::from(part)));
    if let Some((step, on_it)) = grid.filter(|(step, _)| *step > COARSER * stated) {
        found.push(Departure {
            id: GRID,
            parameters: vec![("step", step * 1e-9)],
            statistic: step / stated,
            threshold: COARSER,
            share: on_it,
            polarity: "both",
            pixels: Vec::new(),
            seen: format!(
                "{:.1} % of the stamps sit on a grid of {:.1} us; {:.3} us is stated",
                100.0 * on_it,
                step * 1e-3,
                stated * 1e-3
            ),
            heldout: None,
            ci95: Vec::new(),
        });
        return found;
    }
    if gap > COARSER * stated && share > GAP_SHARE {
        found.extend(queue(stream, gap, share));
    }
    found.extend(off_grid(case));
    found
}

/// The most frequent gap between stamps that differ, ns, and the share of the gaps that are as long (to 0.2
/// %, at least 10 ns).
fn usual_gap(unique: &[i64]) -> Option<(f64, f64)> {
    let mut gaps: Vec<i64> = unique.windows(2).map(|pair| pair[1] - pair[0]).collect();
    gaps.sort_unstable();
    let (mut best, mut first) = ((0, 0, 0), 0);
    for last in 0..gaps.len() {
        while gaps[last] - gaps[first] > i64::max(10, gaps[last] / 500) {
            first += 1;
        }
        if last + 1 - first > best.0 {
            best = (last + 1 - first, first, last);
        }
    }
    (best.0 > 20).then(|| {
        (gaps[best.1..=best.2].iter().sum::<i64>() as f64 / best.0 as f64, best.0 as f64 / gaps.len() as f64)
    })
}

/// The grid nearest to a step on which the stamps sit: its step, ns, and the share of them; none when they do
/// not.
fn on_grid(unique: &[i64], step: f64) -> Option<(f64, f64)> {
    let tolerance = f64::max(10.0, 0.02 * step);
    if step < 4.0 * tolerance || unique.len() < 50 {
        return None;
    }
    let first = unique[0];
    let mut refined = step;
    // The further out, the better the step is known: each round uses twice as many stamps.
    let mut reach = 8;
    loop {
        let (mut up, mut down) = (0.0, 0.0);
        for &t in &unique[..reach.min(unique.len())] {
            let distance = (t - first) as f64;
            let number = (distance / refined).round();
            if (distance - number * refined).abs() <= 0.2 * refined {
                up += number * distance;
                down += number * number;
            }
        }
        if down > 0.0 {
            refined = up / down;
        }
        if reach >= unique.len() {
            break;
        }
        reach *= 2;
    }
    let hits = unique.iter().filter(|&&t| {
        let distance = (t - first) as f64;
        (distance - (distance / refined).round() * refined).abs() <= tolerance
    });
    let share = hits.count() as f64 / unique.len() as f64;
    (share >= GRID_SHARE).then_some((refined, share))
}

/// Events leave one row (or one pixel) after the other at equal distances: they waited for each other.
fn queue(stream: &EventsByTime, gap: f64, share: f64) -> Option<Departure> {
    let events = stream.0.len() as f64;
    let span = stream.span()?;
    let busy = share * gap * events / f64::max((span.1 - span.0) as f64, 1.0);
    Some(Departure {
        id: "readout_queue",
        parameters: vec![("service", gap * 1e-9)],
        statistic: share,
        threshold: GAP_SHARE,
        share: busy.min(1.0),
        polarity: "both",
        pixels: Vec::new(),
        seen: format!(
            "{:.0} % of the gaps between stamps are {:.2} us, without a common grid: one event \
                       waits for the other",
            100.0 * share,
            gap * 1e-3
        ),
        heldout: None,
        ci95: Vec::new(),
    })
}

/// Stamps that do not sit on the grid of their stated resolution, not even for moments: something shakes them
/// after they were taken.
fn off_grid(case: &Case) -> Option<Departure> {
    if case.t_resolution_ns < 100 {
        return None;
    }
    let step = case.t_resolution_ns as f64;
    let mut times: Vec<i64> =
        case.events.iter().map(|event| if case.has_t_in { event.t_in_ns } else { event.t_off_ns }).collect();
    times.sort_unstable();
    // Distances of a few steps: long enough to see their remainder, short enough that a clock of another rate
    // does not matter.
    let usual = (times.last()? - times.first()?) as f64 / times.len() as f64;
    let lag = ((5.0 * step / usual).ceil() as usize).clamp(1, times.len() - 1);
    let (mut re, mut im, mut count) = (0.0, 0.0, 0.0);
    for k in 0..times.len() - lag {
        let distance = (times[k + lag] - times[k]) as f64;
        if distance < 30.0 * step {
            let phase = std::f64::consts::TAU * distance / step;
            re += libm::cos(phase);
            im += libm::sin(phase);
            count += 1.0;
        }
    }
    if count < 300.0 {
        return None;
    }
    let concentration = libm::sqrt(re * re + im * im) / count;
    if concentration > CONCENTRATION {
        return None;
    }
    let sigma_s = jitter_s(case);
    Some(Departure {
        id: "timestamp_jitter",
        parameters: vec![("sigma", sigma_s)],
        statistic: CONCENTRATION / f64::max(concentration, 0.03),
        threshold: 1.0,
        share: 1.0,
        polarity: "both",
        pixels: Vec::new(),
        seen: format!(
            "stamps are stated to {:.3} us, and lie anywhere between: they were moved after they were taken",
            step * 1e-3
        ),
        heldout: None,
        ci95: Vec::new(),
    })
}

/// Jitter of stamps from the third differences of the fastest runs of four events of one sign, seconds: their
/// variance is 20 sigma^2 and light changes little in them.
pub(crate) fn jitter_s(case: &Case) -> f64 {
    let mut runs: Vec<(i64, i64)> = Vec::new();
    for pixel in 0..case.events.pixels() {
        for run in case.events.of_pixel(pixel).windows(4) {
            if run.iter().all(|event| event.polarity == run[0].polarity) {
                let t = |k: usize| run[k].t_in_ns;
                runs.push((t(3) - t(0), (t(3) - 3 * t(2) + 3 * t(1) - t(0)).abs()));
            }
        }
    }
    runs.sort_unstable();
    let fastest = runs.len().div_ceil(50);
    let mut differences: Vec<i64> = runs[..fastest].iter().map(|run| run.1).collect();
    differences.sort_unstable();
    1.4826 * quantile(&differences, 0.5) as f64 * 1e-9 / libm::sqrt(20.0)
}
