//! What the stream is like without any model: intervals, runs, reversals, counts, isolated events, stamps, rows and pixels that stand out.

use super::{Summaries, View, bin, quantile};
use crate::case::Recorded;

const INTERVALS_S: [f64; 12] = [8e-6, 16e-6, 32e-6, 64e-6, 128e-6, 256e-6, 512e-6, 1e-3, 2e-3, 4e-3, 8e-3, 16e-3];

pub(super) fn put(view: &View<'_>, into: &mut Summaries) {
    let events_of = |pixel: u32| view.case.events.of(pixel as usize);
    let pixels = view.sample.len().max(1) as f64;
    let (mut on, mut off, mut silent) = (0.0, 0.0, 0.0);
    let (mut same, mut turned) = ([0.0; 13], [0.0; 13]);
    let blind_s = f64::max((view.nominal.pixel.refractory_ns + view.nominal.pixel.latency_ns) as f64 * 1e-9, 10e-6);
    let (mut by_blind, mut runs, mut phases, mut alternations) = ([0.0; 6], [0.0; 5], [[0.0; 8]; 2], 0.0);
    let mut latencies: Vec<f64> = Vec::new();
    for pixel in &view.sample.pixels {
        let events = events_of(*pixel);
        if events.is_empty() {
            silent += 1.0;
        }
        let mut run = 1_usize;
        for (k, event) in events.iter().enumerate() {
            if event.polarity > 0 {
                on += 1.0;
            } else {
                off += 1.0;
            }
            let t_s = (event.t_in_ns - view.case.span.0) as f64 * 1e-9;
            let phase = ((t_s - view.scales.frame_phase_s) / view.scales.frame_period_s).rem_euclid(1.0);
            phases[usize::from(event.polarity > 0)][((8.0 * phase) as usize).min(7)] += 1.0;
            if k % 8 == 0 {
                latencies.push((event.t_off_ns - event.t_in_ns) as f64 * 1e-6);
            }
            if k == 0 {
                continue;
            }
            let gap_s = (event.t_in_ns - events[k - 1].t_in_ns) as f64 * 1e-9;
            if event.polarity == events[k - 1].polarity {
                same[bin(gap_s, &INTERVALS_S)] += 1.0;
                by_blind[bin(gap_s / blind_s, &[0.5, 0.98, 1.1, 1.5, 3.0])] += 1.0;
                run += 1;
            } else {
                turned[bin(gap_s, &INTERVALS_S)] += 1.0;
                runs[bin(run as f64, &[2.0, 3.0, 5.0, 9.0])] += 1.0;
                run = 1;
                if k >= 2 && events[k - 2].polarity == event.polarity && (event.t_in_ns - events[k - 2].t_in_ns) < 2_000_000 {
                    alternations += 1.0;
                }
            }
        }
        runs[bin(run as f64, &[2.0, 3.0, 5.0, 9.0])] += if events.is_empty() { 0.0 } else { 1.0 };
    }
    let all = on + off;
    into.put("native.on", libm::log((on + 1.0) / pixels));
    into.put("native.off", libm::log((off + 1.0) / pixels));
    into.put("native.silent", libm::sqrt(silent / pixels));
    let shares = |name: &str, counts: &[f64], into: &mut Summaries| {
        for (n, count) in counts.iter().enumerate() {
            into.put(format!("native.{name}_{n}"), 10.0 * libm::sqrt(count / (all + 20.0)));
        }
    };
    shares("same", &same, into);
    shares("turned", &turned, into);
    shares("blind", &by_blind, into);
    shares("runs", &runs, into);
    shares("phase_off", &phases[0], into);
    shares("phase_on", &phases[1], into);
    into.put("native.reversals", 10.0 * libm::sqrt(turned.iter().sum::<f64>() / (all + 20.0)));
    into.put("native.alternations", 10.0 * libm::sqrt(alternations / (all + 20.0)));
    latencies.sort_by(f64::total_cmp);
    into.put("native.latency", libm::log(1e-2 + quantile(&latencies, 0.5).max(0.0)));
    into.put("native.latency_tail", libm::log(1e-2 + quantile(&latencies, 0.95).max(0.0)));
    isolated(view, into);
    stamps(view, all, into);
    outliers(view, into);
}

/// Events without another one of the pixel within 4 ms, and how many of them have no neighbour's within 1 ms either.
fn isolated(view: &View<'_>, into: &mut Summaries) {
    const OWN_NS: i64 = 4_000_000;
    const OTHERS_NS: i64 = 1_000_000;
    let width = view.case.extent.width;
    let (mut alone, mut lone, mut inner) = ([0.0; 2], [0.0; 2], 0.0);
    for (n, pixel) in view.sample.pixels.iter().enumerate() {
        if !view.sample.is_inner[n] {
            continue;
        }
        inner += 1.0;
        let events = view.case.events.of(*pixel as usize);
        for (k, event) in events.iter().enumerate() {
            let far = |other: Option<&Recorded>| other.is_none_or(|other| (other.t_in_ns - event.t_in_ns).abs() > OWN_NS);
            if !far(k.checked_sub(1).and_then(|k| events.get(k))) || !far(events.get(k + 1)) {
                continue;
            }
            let sign = usize::from(event.polarity > 0);
            alone[sign] += 1.0;
            let neighbours = [pixel - 1, pixel + 1, pixel - width, pixel + width];
            let near = |other: u32| {
                let of = view.case.events.of(other as usize);
                let at = of.partition_point(|e| e.t_in_ns < event.t_in_ns - OTHERS_NS);
                of[at..].iter().take_while(|e| e.t_in_ns <= event.t_in_ns + OTHERS_NS).any(|e| e.polarity == event.polarity)
            };
            if !neighbours.into_iter().any(near) {
                lone[sign] += 1.0;
            }
        }
    }
    for (sign, name) in ["off", "on"].into_iter().enumerate() {
        let rate = |count: f64| libm::log(count / ((inner + 1.0) * view.scales.duration_s) + 0.1);
        into.put(format!("native.alone_{name}"), rate(alone[sign]));
        into.put(format!("native.lone_{name}"), rate(lone[sign]));
    }
}

/// How many different stamps there are, on which grids they lie, and how events pile up in short windows.
fn stamps(view: &View<'_>, all: f64, into: &mut Summaries) {
    let mut stamps: Vec<i64> = view.sample.pixels.iter().flat_map(|pixel| view.case.events.of(*pixel as usize).iter().map(|e| e.t_off_ns)).collect();
    stamps.sort_unstable();
    for grid_us in [10, 20, 50, 100] {
        let on_it = stamps.iter().filter(|t| (*t / 1000) % grid_us == 0).count() as f64;
        into.put(format!("native.grid_{grid_us}"), on_it / (all + 20.0));
    }
    for (name, window_ns) in [("100us", 100_000), ("1ms", 1_000_000)] {
        let windows = ((view.case.span.1 - view.case.span.0) / window_ns + 1).clamp(1, 1 << 22) as usize;
        let mut counts = vec![0.0; windows];
        for t in &stamps {
            if let Some(count) = usize::try_from((t - view.case.span.0) / window_ns).ok().and_then(|at| counts.get_mut(at)) {
                *count += 1.0;
            }
        }
        let mean = all / windows as f64;
        let variance = counts.iter().map(|n| (n - mean) * (n - mean)).sum::<f64>() / windows as f64;
        counts.sort_by(f64::total_cmp);
        let (middle, high, top) = (quantile(&counts, 0.5), quantile(&counts, 0.9), quantile(&counts, 0.99));
        into.put(format!("native.windows_{name}.spread"), libm::log(0.1 + libm::sqrt(variance) / (mean + 1.0)));
        into.put(format!("native.windows_{name}.high"), libm::log((high + 1.0) / (middle + 1.0)));
        into.put(format!("native.windows_{name}.top"), libm::log((top + 1.0) / (high + 1.0)));
    }
    stamps.dedup();
    into.put("native.distinct_stamps", libm::log((stamps.len() as f64 + 1.0) / (all + 1.0)));
    let mut steps: Vec<f64> = stamps.windows(2).map(|t| (t[1] - t[0]) as f64 * 1e-3).collect();
    steps.sort_by(f64::total_cmp);
    into.put("native.stamp_step", libm::log(0.1 + quantile(&steps, 0.1)));
}

/// Rows, columns and pixels that fire more than those around them.
fn outliers(view: &View<'_>, into: &mut Summaries) {
    let (width, height) = (view.case.extent.width as usize, view.case.extent.height as usize);
    // Excess of a pixel's ON and OFF events over the median of its block.
    let blocks = view.sample.block.iter().copied().max().map_or(0, |most| most as usize + 1);
    let mut by_block: Vec<Vec<(usize, f64)>> = vec![Vec::new(); blocks];
    for (n, pixel) in view.sample.pixels.iter().enumerate() {
        by_block[view.sample.block[n] as usize].push((*pixel as usize, view.case.events.of(*pixel as usize).len() as f64));
    }
    let (mut excess, mut rows, mut columns): (Vec<f64>, Vec<Vec<f64>>, Vec<Vec<f64>>) = (Vec::new(), vec![Vec::new(); height], vec![Vec::new(); width]);
    for block in &by_block {
        let mut counts: Vec<f64> = block.iter().map(|(_, count)| *count).collect();
        counts.sort_by(f64::total_cmp);
        let middle = quantile(&counts, 0.5);
        for (pixel, count) in block {
            let more = (count - middle) / view.scales.duration_s;
            excess.push(more);
            rows[pixel / width].push(more);
            columns[pixel % width].push(more);
        }
    }
    excess.sort_by(f64::total_cmp);
    let root = |x: f64| libm::sqrt(x.max(0.0));
    into.put("native.pixels.top", root(quantile(&excess, 1.0)));
    into.put("native.pixels.p99", root(quantile(&excess, 0.99)));
    into.put("native.pixels.p90", root(quantile(&excess, 0.9)));
    into.put("native.pixels.low", root(-quantile(&excess, 0.03)));
    for (name, lines) in [("rows", &mut rows), ("columns", &mut columns)] {
        let mut medians: Vec<f64> = lines
            .iter_mut()
            .filter(|line| line.len() >= 6)
            .map(|line| {
                line.sort_by(f64::total_cmp);
                quantile(line, 0.5)
            })
            .collect();
        medians.sort_by(f64::total_cmp);
        into.put(format!("native.{name}.top"), root(quantile(&medians, 1.0)));
        into.put(format!("native.{name}.p90"), root(quantile(&medians, 0.9)));
    }
}
