//! Frames against the light between events: what every effect would add, by regression.

use super::{Summaries, View, bin, quantile};
use crate::band::{Band, mean_over};
use photocurrent_sensor::elementary::exp;
use rayon::prelude::*;

/// What effects would add to log frame less log light of events; the first ones at every instant, the others by frame.
const TERMS: [&str; 24] = [
    "on",
    "off",
    "drift",
    "charge",
    "dark",
    "delay",
    "delay_time",
    "delay_row",
    "voltage_slope",
    "alpha",
    "steepness",
    "after_signed",
    "after",
    "level_sum",
    "scale_time",
    "scale",
    "scale_column",
    "bright",
    "curvature",
    "rising",
    "horizontal",
    "vertical",
    "softness",
    "lag",
];
const INSTANT: usize = 20;

/// Number of bins of the gain and delay map, by covariate: column, row, parity, light, time, radius.
const MAP: [(&str, usize); 6] = [("column", 6), ("row", 6), ("parity", 2), ("light", 4), ("time", 6), ("radius", 3)];

/// Two regressors, gain and delay, in one bin.
#[derive(Clone, Copy, Default)]
struct Pair {
    gg: f64,
    gd: f64,
    dd: f64,
    gy: f64,
    dy: f64,
}

impl Pair {
    fn add(&mut self, w: f64, g: f64, d: f64, y: f64) {
        self.gg += w * g * g;
        self.gd += w * g * d;
        self.dd += w * d * d;
        self.gy += w * g * y;
        self.dy += w * d * y;
    }
    fn merge(&mut self, other: &Pair) {
        self.gg += other.gg;
        self.gd += other.gd;
        self.dd += other.dd;
        self.gy += other.gy;
        self.dy += other.dy;
    }
    /// Gain and delay, drawn to zero where there is little.
    fn solve(&self, ridge: f64) -> (f64, f64) {
        let (gg, dd) = (self.gg + ridge, self.dd + ridge);
        let det = gg * dd - self.gd * self.gd;
        if det > 0.0 { ((self.gy * dd - self.dy * self.gd) / det, (self.dy * gg - self.gy * self.gd) / det) } else { (0.0, 0.0) }
    }
}

#[derive(Clone)]
struct Sums {
    weight: f64,
    yy: f64,
    xx: [f64; TERMS.len()],
    xy: [f64; TERMS.len()],
    maps: Vec<Pair>,
    sure: Vec<f64>,
    doubtful: Vec<f64>,
    lights: Vec<f64>,
    wiggles: Vec<f64>,
    lagged: (f64, f64),
    by_frame: Vec<Vec<f64>>,
}

/// What remains of a pixel: gain and delay from even and from odd frames, its block, and its closures.
struct PixelPart {
    halves: [Pair; 2],
    block: u32,
}

impl Sums {
    fn new(frames: usize) -> Sums {
        let maps = vec![Pair::default(); MAP.iter().map(|(_, n)| n).sum::<usize>() + 1];
        let nothing = [0.0; TERMS.len()];
        Sums {
            weight: 0.0,
            yy: 0.0,
            xx: nothing,
            xy: nothing,
            maps,
            sure: Vec::new(),
            doubtful: Vec::new(),
            lights: Vec::new(),
            wiggles: Vec::new(),
            lagged: (0.0, 0.0),
            by_frame: vec![Vec::new(); frames],
        }
    }

    fn merge(&mut self, other: Sums) {
        self.weight += other.weight;
        self.yy += other.yy;
        for n in 0..TERMS.len() {
            self.xx[n] += other.xx[n];
            self.xy[n] += other.xy[n];
        }
        for (own, pair) in self.maps.iter_mut().zip(&other.maps) {
            own.merge(pair);
        }
        self.sure.extend(other.sure);
        self.doubtful.extend(other.doubtful);
        self.lights.extend(other.lights);
        self.wiggles.extend(other.wiggles);
        self.lagged = (self.lagged.0 + other.lagged.0, self.lagged.1 + other.lagged.1);
        for (own, values) in self.by_frame.iter_mut().zip(other.by_frame) {
            own.extend(values);
        }
    }
}

pub(super) fn put(view: &View<'_>, into: &mut Summaries) {
    let places: Vec<usize> = (0..view.bands.len()).collect();
    let parts: Vec<(Sums, Vec<PixelPart>)> = places
        .par_chunks(64)
        .map(|places| {
            let mut sums = Sums::new(view.case.frame_count());
            let parts = places.iter().filter_map(|&n| pixel(view, n, &mut sums)).collect();
            (sums, parts)
        })
        .collect();
    let mut sums = Sums::new(view.case.frame_count());
    let mut pixels = Vec::new();
    for (part, more) in parts {
        sums.merge(part);
        pixels.extend(more);
    }
    let rms = libm::sqrt(sums.yy / (sums.weight + 1e-9));
    for (n, name) in TERMS.iter().enumerate() {
        let amplitude = sums.xy[n] / libm::sqrt((sums.xx[n] + 1e-12) * (sums.weight + 1e-9));
        into.put(format!("closure.{name}.size"), 100.0 * amplitude);
        into.put(format!("closure.{name}.corr"), amplitude / (rms + 1e-6));
    }
    let ridge = 1e-3 * sums.weight / 28.0;
    let (gain, delay) = sums.maps[sums.maps.len() - 1].solve(ridge);
    into.put("closure.gain", 10.0 * gain);
    into.put("closure.delay", 10.0 * delay);
    let mut first = 0;
    for (name, bins) in MAP {
        for n in 0..bins {
            let (g, d) = sums.maps[first + n].solve(ridge);
            into.put(format!("closure.gain.{name}_{n}"), 10.0 * (g - gain));
            into.put(format!("closure.delay.{name}_{n}"), 10.0 * (d - delay));
        }
        first += bins;
    }
    spreads(&pixels, into);
    for values in [&mut sums.sure, &mut sums.doubtful, &mut sums.lights, &mut sums.wiggles] {
        values.sort_by(f64::total_cmp);
    }
    let log = |x: f64| libm::log(x + 1e-3);
    into.put("closure.rms", log(rms));
    into.put("closure.scatter.sure", log(quantile(&sums.sure, 0.5)));
    into.put("closure.scatter.sure_tail", log(quantile(&sums.sure, 0.95)));
    into.put("closure.scatter.doubtful", log(quantile(&sums.doubtful, 0.5)));
    into.put("closure.scatter.doubtful_tail", log(quantile(&sums.doubtful, 0.95)));
    into.put("closure.wiggle", log(quantile(&sums.wiggles, 0.5)));
    into.put("closure.lagged", sums.lagged.0 / (sums.lagged.1 + 1e-9));
    into.put("closure.light_spread", quantile(&sums.lights, 0.9) - quantile(&sums.lights, 0.1));
    let common: Vec<f64> = sums.by_frame.iter_mut().map(|values| median(values)).collect();
    let mean = |values: &[f64]| values.iter().sum::<f64>() / (values.len().max(1)) as f64;
    let squares: Vec<f64> = common.iter().map(|y| y * y).collect();
    let bends: Vec<f64> = common.windows(3).map(|y| (y[0] - 2.0 * y[1] + y[2]) * (y[0] - 2.0 * y[1] + y[2])).collect();
    into.put("closure.common", log(libm::sqrt(mean(&squares))));
    into.put("closure.common_jumps", log(libm::sqrt(mean(&bends))));
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    quantile(values, 0.5)
}

/// How far pixels differ for good: covariance of what even and odd frames say.
fn spreads(pixels: &[PixelPart], into: &mut Summaries) {
    let ridge = 1.0;
    let found: Vec<(u32, [(f64, f64); 2])> = pixels.iter().map(|part| (part.block, part.halves.map(|half| half.solve(ridge)))).collect();
    for (name, which) in [("gain", 0), ("delay", 1)] {
        let value = |pair: (f64, f64)| f64::clamp(if which == 0 { pair.0 } else { pair.1 }, -0.6, 0.6);
        let (mut covariance, mut variance, mut count) = (0.0, 0.0, 0.0);
        let mut start = 0;
        // Pixels stand in order of place, so those of a block are gathered first.
        let mut order: Vec<usize> = (0..found.len()).collect();
        order.sort_by_key(|&n| found[n].0);
        while start < order.len() {
            let block = found[order[start]].0;
            let end = start + order[start..].iter().take_while(|n| found[**n].0 == block).count();
            let of = |half: usize| -> Vec<f64> { order[start..end].iter().map(|&n| value(found[n].1[half])).collect() };
            let (mut even, mut odd) = (of(0), of(1));
            let (e, o) = (even.clone(), odd.clone());
            let (middle_even, middle_odd) = (median(&mut even), median(&mut odd));
            for (e, o) in e.iter().zip(&o) {
                covariance += (e - middle_even) * (o - middle_odd);
                variance += 0.5 * ((e - middle_even) * (e - middle_even) + (o - middle_odd) * (o - middle_odd));
                count += 1.0;
            }
            start = end;
        }
        let root = |x: f64| f64::copysign(libm::sqrt(x.abs()), x);
        into.put(format!("closure.spread.{name}.lasting"), 10.0 * root(covariance / (count + 1.0)));
        into.put(format!("closure.spread.{name}.all"), 10.0 * root(variance / (count + 1.0)));
        into.put(format!("closure.spread.{name}.share"), covariance / (variance + 1e-3 * count + 1e-9));
    }
}

fn pixel(view: &View<'_>, n: usize, sums: &mut Sums) -> Option<PixelPart> {
    let band = &view.bands[n];
    if !band.is_known || band.frames.len() < 4 {
        return None;
    }
    let pixel = view.sample.pixels[n] as usize;
    let (x, y) = view.case.place(pixel);
    let (width, height) = (f64::from(view.case.extent.width), f64::from(view.case.extent.height));
    let (column, row) = ((f64::from(x) + 0.5) / width * 2.0 - 1.0, (f64::from(y) + 0.5) / height * 2.0 - 1.0);
    let radius2 = (column * column + row * row) / 2.0;
    let (light, instants) = instants(view, band, pixel, column, row);
    let mut rows: Vec<[f64; TERMS.len() + 1]> = band
        .frames
        .iter()
        .map(|frame| {
            let mean = f64::max(mean_over(&band.t, &light, frame.start_s, frame.end_s), 1e-300);
            let mut values = [0.0; TERMS.len() + 1];
            for (value, term) in values.iter_mut().zip(&instants) {
                *value = mean_over(&band.t, term, frame.start_s, frame.end_s) / mean;
            }
            let image = image(view, frame.frame, x, y);
            values[INSTANT..INSTANT + 4].copy_from_slice(&image);
            values[TERMS.len()] = frame.closure.clamp(-0.6, 0.6);
            values
        })
        .collect();
    let total: f64 = band.frames.iter().map(|frame| frame.weight).sum();
    for k in 0..=TERMS.len() {
        let mean: f64 = rows.iter().zip(&band.frames).map(|(row, frame)| frame.weight * row[k]).sum::<f64>() / total;
        rows.iter_mut().for_each(|row| row[k] -= mean);
    }
    let middle = libm::log(view.scales.light);
    let mut part = PixelPart { halves: [Pair::default(); 2], block: view.sample.block[n] };
    for (l, (row_values, frame)) in rows.iter().zip(&band.frames).enumerate() {
        // Weights of order one.
        let (w, value) = (frame.weight * 1e-3, row_values[TERMS.len()]);
        sums.weight += w;
        sums.yy += w * value * value;
        for k in 0..TERMS.len() {
            let term = row_values[k].clamp(-20.0, 20.0);
            sums.xx[k] += w * term * term;
            sums.xy[k] += w * term * value;
        }
        let (g, d) = (row_values[15].clamp(-3.0, 3.0), row_values[5].clamp(-3.0, 3.0));
        let share = |at: f64, bins: usize| ((at * bins as f64) as usize).min(bins - 1);
        let bins = [
            share(0.5 * (column + 1.0), 6),
            share(0.5 * (row + 1.0), 6),
            (y % 2) as usize,
            bin(frame.log_measured - middle, &[-0.5, 0.0, 0.5]),
            share(frame.start_s / view.scales.duration_s, 6),
            bin(radius2, &[0.15, 0.4]),
        ];
        let mut first = 0;
        for (at, (_, count)) in bins.iter().zip(MAP) {
            sums.maps[first + at].add(w, g, d, value);
            first += count;
        }
        sums.maps[first].add(w, g, d, value);
        part.halves[l % 2].add(w, g, d, value);
        (if frame.doubt < 0.5 { &mut sums.sure } else { &mut sums.doubtful }).push(value.abs());
        sums.by_frame[frame.frame].push(value);
        sums.lights.push(frame.log_measured);
        if l > 0 {
            let before = rows[l - 1][TERMS.len()];
            sums.lagged.0 += before * value;
            sums.lagged.1 += 0.5 * (before * before + value * value);
            if l + 1 < rows.len() {
                sums.wiggles.push((value - 0.5 * (before + rows[l + 1][TERMS.len()])).abs());
            }
        }
    }
    Some(part)
}

/// Light, and every term times light, at the knots.
fn instants(view: &View<'_>, band: &Band, pixel: usize, column: f64, row: f64) -> (Vec<f64>, Vec<Vec<f64>>) {
    let (scales, pixel_model) = (view.scales, &view.nominal.pixel);
    let n = band.t.len();
    let mut light = vec![0.0; n];
    let mut terms = vec![vec![0.0; n]; INSTANT];
    let events = view.case.events.of(pixel);
    let inside: Vec<f64> = {
        let zero = view.case.span.0;
        events.iter().filter(|e| e.t_in_ns > zero && e.t_in_ns < view.case.span.1).map(|e| f64::from(e.polarity)).collect()
    };
    let (mut on, mut off, mut charge, mut level_sum, mut next, mut polarity, mut since) = (0.0, 0.0, 0.0, 0.0, 0, 0.0, 1.0);
    let mean_level = band.frames.iter().map(|frame| frame.log_measured).sum::<f64>() / band.frames.len() as f64;
    for k in 0..n {
        let dt = if k > 0 { band.t[k] - band.t[k - 1] } else { 0.0 };
        let u = band.log_light[k].clamp(-30.0, 30.0);
        let i = exp(u);
        light[k] = i;
        charge += i / scales.light * dt / scales.duration_s;
        level_sum += (u - mean_level) * dt / scales.duration_s;
        since += dt;
        if next < band.at_event.len() && band.at_event[next] as usize == k {
            polarity = inside.get(next).copied().unwrap_or(0.0);
            if polarity > 0.0 {
                on += pixel_model.threshold_on;
            } else {
                off += pixel_model.threshold_off;
            }
            since = 0.0;
            next += 1;
        }
        let (a, b) = (k.saturating_sub(1), usize::min(k + 1, n - 1));
        let rate = if band.t[b] > band.t[a] { ((band.log_light[b] - band.log_light[a]) / (band.t[b] - band.t[a]) * 1e-3).clamp(-3.0, 3.0) } else { 0.0 };
        let slope = (band.slope[k] * 1e-3).clamp(-3.0, 3.0);
        let time = band.t[k] / scales.duration_s;
        let after = exp(-since / 3e-3);
        let dark = f64::min(scales.light / i, 20.0);
        let values = [
            on,
            -off,
            time,
            charge,
            dark,
            rate,
            (time - 0.5) * rate,
            row * rate,
            slope,
            slope * dark,
            rate.abs(),
            after * polarity,
            after,
            level_sum,
            (u - mean_level) * (time - 0.5),
            u - mean_level,
            (u - mean_level) * column,
            i / scales.light,
            (u - mean_level) * (u - mean_level),
            f64::max(rate, 0.0),
        ];
        for (term, value) in terms.iter_mut().zip(values) {
            term[k] = value * i;
        }
    }
    (light, terms)
}

/// Slopes of the log image across and down, its softness, and the change since the frame before; 0 where a neighbour is not there.
fn image(view: &View<'_>, frame: usize, x: u32, y: u32) -> [f64; 4] {
    let (case, black) = (view.case, view.nominal.number.black_level);
    let value = |l: usize, dx: i64, dy: i64| -> f64 {
        let (x, y) = (i64::from(x) + dx, i64::from(y) + dy);
        if x < 0 || y < 0 || x >= i64::from(case.extent.width) || y >= i64::from(case.extent.height) {
            return f64::NAN;
        }
        libm::log(f64::max(case.dn(l, (y * i64::from(case.extent.width) + x) as usize) - black, 0.3))
    };
    let here = value(frame, 0, 0);
    let (left, right, up, down) = (value(frame, -1, 0), value(frame, 1, 0), value(frame, 0, -1), value(frame, 0, 1));
    let finite = |x: f64| if x.is_finite() { x.clamp(-3.0, 3.0) } else { 0.0 };
    let before = if frame > 0 { value(frame - 1, 0, 0) } else { f64::NAN };
    [finite(0.5 * (right - left)), finite(0.5 * (down - up)), finite(left + right + up + down - 4.0 * here), finite(before - here)]
}
