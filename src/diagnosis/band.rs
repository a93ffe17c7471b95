//! The light of a pixel by threads through its events: quick, and every recorded event is met.
//!
//! Events say by how much the voltage moved: one threshold from the reference, plus what it moved while the pixel was blind. A cubic goes through these knots
//! with slopes that have the events' signs, and silence keeps it within the band of both thresholds. Undoing the front end gives log light but for its
//! level; the frames give the level, and what they say beyond it is the *closure*: the logarithm of each frame over the exposure's mean of that light. Anchored to the
//! frames (closures are interpolated in time and added) the light meets all frames, and nearly all events.
//!
//! In contrast to the most probable light ([`crate::scene::Scene::estimate`]) extrema are not damped, so the nominal sensor records nearly as many events of it as were
//! recorded; and it costs a tenth. It holds no uncertainty but the share of an exposure that lies in long silence ([`BandFrame::doubt`]).

use crate::case::{Case, Recorded};
use crate::nominal::Nominal;
use crate::sample::Sample;
use crate::scene::{Found, Scene};
use photocurrent_core::sensor::Reset;
use photocurrent_sensor::elementary::{exp, ln};
use rayon::prelude::*;

/// A frame value against the light between events.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BandFrame {
    /// Number of the frame.
    pub frame: usize,
    /// Exposure of the pixel's row, seconds from the start of the recording.
    pub start_s: f64,
    /// Its end.
    pub end_s: f64,
    /// Log of the measured light over the exposure's mean of the light through the events; the weighted mean over frames is 0.
    pub closure: f64,
    /// Log of the measured mean photocurrent.
    pub log_measured: f64,
    /// Share of the exposure that lies in intervals whose level the events leave open, 0 to 1.
    pub doubt: f64,
    /// Weight in fits.
    pub weight: f64,
}

/// The light of a pixel through its events.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Band {
    /// Knots, seconds from the start of the recording.
    pub t: Vec<f64>,
    /// Voltage of the front end at each, natural-log units, level included.
    pub v: Vec<f64>,
    /// Its slope, 1/s.
    pub slope: Vec<f64>,
    /// Log photocurrent, not anchored.
    pub log_light: Vec<f64>,
    /// What anchoring adds.
    pub anchor: Vec<f64>,
    /// Place among the knots of each event.
    pub at_event: Vec<u32>,
    /// Usable frames.
    pub frames: Vec<BandFrame>,
    /// Is there a level?
    pub is_known: bool,
}

/// Longest step between knots inside silence, seconds.
const LONG_STEP_S: f64 = 400e-6;
/// Shortest.
const SHORT_STEP_S: f64 = 100e-6;

impl Band {
    /// The light of every pixel of a sample.
    pub fn all(case: &Case, nominal: &Nominal, sample: &Sample) -> Vec<Band> {
        (0..sample.len()).into_par_iter().with_min_len(32).map(|n| Band::of(case, nominal, sample.pixels[n] as usize)).collect()
    }

    /// The light of a pixel.
    pub fn of(case: &Case, nominal: &Nominal, pixel: usize) -> Band {
        let zero = case.span.0;
        let end_s = (case.span.1 - zero) as f64 * 1e-9;
        let events = case.events.of(pixel);
        let path = Path::through(events, nominal, zero, end_s);
        let mut band = path.sampled(end_s);
        let (_, row) = case.place(pixel);
        let Some(frames) = &case.frames else {
            return band;
        };
        for l in 0..frames.times.len() {
            let dn = case.dn(l, pixel);
            let exposure = frames.times.exposure(l, row);
            let (start_s, stop_s) = ((exposure.start.0 - zero) as f64 * 1e-9, (exposure.end.0 - zero) as f64 * 1e-9);
            let charge = nominal.number.integral(dn);
            if dn.is_finite() && dn < nominal.saturation_dn && charge > 0.0 && stop_s > start_s && start_s >= 0.0 && stop_s <= end_s {
                let log_measured = ln(f64::max(charge, 1e-12) / (stop_s - start_s));
                let doubt = path.doubt(start_s, stop_s);
                let weight = 1.0 / (1e-4 + 4e-3 * doubt * doubt);
                band.frames.push(BandFrame { frame: l, start_s, end_s: stop_s, closure: 0.0, log_measured, doubt, weight });
            }
        }
        band.level(nominal);
        band
    }

    /// Finds the level, undoes the front end, and fills closures and anchor.
    fn level(&mut self, nominal: &Nominal) {
        let weights: f64 = self.frames.iter().map(|frame| frame.weight).sum();
        if weights <= 0.0 {
            return;
        }
        self.is_known = true;
        let front_end = nominal.pixel.front_end;
        let mut level = 0.0;
        let (least, most) = self.frames.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), frame| (a.min(frame.log_measured), b.max(frame.log_measured)));
        let (darkest, brightest) = (least - 0.7, most + 0.7);
        self.log_light.clone_from(&self.v);
        for round in 0..3 {
            let light: Vec<f64> = self.log_light.iter().map(|u| exp(*u)).collect();
            let mut sum = 0.0;
            for frame in &mut self.frames {
                frame.closure = frame.log_measured - ln(f64::max(mean_over(&self.t, &light, frame.start_s, frame.end_s), 1e-300));
                sum += frame.weight * frame.closure;
            }
            let offset = sum / weights;
            level += offset;
            if round == 2 {
                for frame in &mut self.frames {
                    frame.closure -= offset;
                }
                for u in &mut self.log_light {
                    *u += offset;
                }
                break;
            }
            // The time constant is that of the light as the frames have it: sums of thresholds may have drifted far from it.
            let closures: Vec<f64> = self.frames.iter().map(|frame| frame.closure - offset).collect();
            self.interpolate(&closures);
            for n in 0..self.t.len() {
                let seen = (self.v[n] + level + self.anchor[n]).clamp(darkest, brightest);
                let tau = front_end.tau_0_s + front_end.alpha_s * exp(-seen);
                self.log_light[n] = self.v[n] + level + (tau * self.slope[n]).clamp(-3.0, 3.0);
            }
        }
        for v in &mut self.v {
            *v += level;
        }
        // Anchoring is not linear in light: once more with what is left.
        let mut values: Vec<f64> = self.frames.iter().map(|frame| frame.closure).collect();
        for _ in 0..2 {
            self.interpolate(&values);
            let light: Vec<f64> = self.log_light.iter().zip(&self.anchor).map(|(u, more)| exp(u + more)).collect();
            for (value, frame) in values.iter_mut().zip(&self.frames) {
                *value += frame.log_measured - ln(f64::max(mean_over(&self.t, &light, frame.start_s, frame.end_s), 1e-300));
            }
        }
        self.interpolate(&values);
    }

    fn interpolate(&mut self, values: &[f64]) {
        let mids: Vec<f64> = self.frames.iter().map(|frame| 0.5 * (frame.start_s + frame.end_s)).collect();
        let mut at = 0;
        for n in 0..self.t.len() {
            let t = self.t[n];
            while at + 1 < mids.len() && mids[at + 1] <= t {
                at += 1;
            }
            self.anchor[n] = match mids.get(at + 1) {
                Some(next) if t > mids[at] => values[at] + (values[at + 1] - values[at]) * (t - mids[at]) / (next - mids[at]),
                _ => values[at],
            };
        }
    }

    /// What anchoring adds to the voltage at a knot: its log light through the front end, to first order in the time constant.
    pub fn anchored_voltage(&self, nominal: &Nominal, n: usize) -> f64 {
        let last = self.t.len() - 1;
        let (a, b) = (n.saturating_sub(1), usize::min(n + 1, last));
        let rate = if self.t[b] > self.t[a] { (self.anchor[b] - self.anchor[a]) / (self.t[b] - self.t[a]) } else { 0.0 };
        let tau = nominal.pixel.front_end.tau_0_s + nominal.pixel.front_end.alpha_s * exp(-f64::max(self.v[n] + self.anchor[n], -10.0));
        self.v[n] + self.anchor[n] - f64::min(tau, 5e-3) * rate
    }

    /// As a pixel of a scene, anchored.
    fn found(&self, case: &Case) -> Found {
        let (mut t_ns, mut log_light): (Vec<i64>, Vec<f64>) = (Vec::with_capacity(self.t.len()), Vec::with_capacity(self.t.len()));
        // Light is not far from what frames saw of it.
        let far = |sign: f64| self.frames.iter().map(|frame| sign * frame.log_measured).fold(f64::NEG_INFINITY, f64::max);
        let (least, most) = if self.frames.is_empty() { (-30.0, 30.0) } else { (-far(-1.0) - 3.0, far(1.0) + 3.0) };
        for n in 0..self.t.len() {
            let t = case.span.0 + (self.t[n] * 1e9).round() as i64;
            if t_ns.last().is_none_or(|last| t > *last) {
                t_ns.push(t);
                log_light.push((self.log_light[n] + self.anchor[n]).clamp(least, most));
            }
        }
        (t_ns, log_light, self.is_known)
    }

    /// The anchored light of a sample.
    pub fn scene(case: &Case, bands: &[Band]) -> Scene {
        Scene::from_pixels(bands.iter().map(|band| band.found(case)))
    }
}

/// Mean of a function that is linear between knots over an interval.
pub fn mean_over(t: &[f64], values: &[f64], start: f64, end: f64) -> f64 {
    let value = |n: usize, at: f64| {
        let (a, b) = (t[n], t[n + 1]);
        values[n] + (values[n + 1] - values[n]) * if b > a { (at - a) / (b - a) } else { 0.0 }
    };
    let last = t.len() - 1;
    let mut n = t.partition_point(|knot| *knot <= start).clamp(1, last) - 1;
    let mut sum = 0.0;
    let mut from = start;
    loop {
        let to = if n + 1 >= last { end } else { f64::min(t[n + 1], end) };
        sum += 0.5 * (value(n, from) + value(n, to)) * (to - from);
        from = to;
        n += 1;
        if from >= end || n >= last {
            break;
        }
    }
    sum / (end - start)
}

/// Voltage at events, with slopes.
struct Path {
    t: Vec<f64>,
    v: Vec<f64>,
    slope: Vec<f64>,
    /// Which knots are events (the first and last are the ends of the recording).
    polarity: Vec<f64>,
    on: f64,
    off: f64,
}

impl Path {
    fn through(events: &[Recorded], nominal: &Nominal, zero: i64, end_s: f64) -> Path {
        let (on, off) = (nominal.pixel.threshold_on, nominal.pixel.threshold_off);
        let mut path = Path { t: vec![0.0], v: vec![0.0], slope: vec![0.0], polarity: vec![0.0], on, off };
        let mut blind: Vec<f64> = vec![0.0];
        for event in events {
            let t = (event.t_in_ns - zero) as f64 * 1e-9;
            if t <= 0.0 || t >= end_s {
                continue;
            }
            // Stamps of one and the same instant still need an order.
            let last = path.t[path.t.len() - 1];
            path.t.push(f64::max(t, last + 1e-9));
            path.polarity.push(f64::from(event.polarity));
            let rest = (event.t_off_ns.max(event.t_in_ns) - event.t_in_ns + nominal.pixel.refractory_ns) as f64 * 1e-9;
            blind.push(if nominal.reset == Reset::Resample { rest } else { 0.0 });
        }
        let n = path.t.len();
        let mut step: Vec<f64> = (0..n).map(|k| path.polarity[k] * if path.polarity[k] > 0.0 { on } else { off }).collect();
        let thresholds = step.clone();
        path.set(&step, end_s);
        if nominal.reset == Reset::Resample {
            for _ in 0..4 {
                for k in 2..n {
                    // The reference is latched when the blind time is over: the voltage has moved on by then.
                    let gap = path.t[k] - path.t[k - 1];
                    let share = f64::min(blind[k - 1] / gap, 0.8);
                    let moved = if path.polarity[k] == path.polarity[k - 1] {
                        // As on a straight line where the interval is mostly blind; along the cubic else.
                        let straight = thresholds[k] * share / (1.0 - share);
                        let cubic = path.at(k - 1, path.t[k - 1] + share * gap) - path.v[k - 1];
                        if share > 0.4 { straight } else { cubic.clamp(-2.0 * straight.abs(), 2.0 * straight.abs()) }
                    } else {
                        (path.slope[k - 1] * share * gap * (1.0 - share)).clamp(-0.7 * on, 0.7 * on)
                    };
                    step[k] = thresholds[k] + moved;
                }
                path.t.truncate(n);
                path.set(&step, end_s);
            }
        }
        path
    }

    /// Voltages from steps, slopes at events, and the end of the recording.
    fn set(&mut self, step: &[f64], end_s: f64) {
        let n = step.len();
        self.v = Vec::with_capacity(n + 1);
        self.v.push(0.0);
        for k in 1..n {
            self.v.push(self.v[k - 1] + step[k]);
        }
        let secant = |k: usize| (self.v[k + 1] - self.v[k]) / (self.t[k + 1] - self.t[k]);
        self.slope = vec![0.0; n];
        for k in 1..n {
            let (before, width) = (secant(k - 1), self.t[k] - self.t[k - 1]);
            let p = self.polarity[k];
            let mut slope = if k + 1 < n {
                let (after, next) = (secant(k), self.t[k + 1] - self.t[k]);
                (before * next + after * width) / (width + next)
            } else {
                0.5 * before
            };
            // At an event the voltage moves in the event's direction; not faster than both neighbours allow.
            let most = 3.0 * f64::max(p * before, if k + 1 < n { p * secant(k) } else { 0.0 });
            let least = 0.1 * f64::max(p * before, 0.0);
            slope = p * (p * slope).clamp(f64::min(least, most), f64::max(most, least));
            self.slope[k] = slope;
        }
        let last = self.v[n - 1];
        self.t.push(end_s);
        let reach = if self.slope[n - 1] >= 0.0 { 0.4 * self.on } else { -0.4 * self.off };
        let drift = 0.5 * self.slope[n - 1] * (end_s - self.t[n - 1]);
        self.v.push(last + if drift.abs() < reach.abs() { drift } else { reach });
        self.slope.push(0.0);
        if self.polarity.len() == n {
            self.polarity.push(0.0);
        }
    }

    /// The cubic of interval `k`, kept within the band.
    fn at(&self, k: usize, t: f64) -> f64 {
        let h = self.t[k + 1] - self.t[k];
        let s = if h > 0.0 { (t - self.t[k]) / h } else { 0.0 };
        let (a, b) = (s * s * (3.0 - 2.0 * s), s * (1.0 - s));
        let value = self.v[k] + (self.v[k + 1] - self.v[k]) * a + h * b * ((1.0 - s) * self.slope[k] - s * self.slope[k + 1]);
        let (low, high) = self.limits(k);
        if value > high.0 {
            high.0 + high.1 * (1.0 - exp(-(value - high.0) / high.1))
        } else if value < low.0 {
            low.0 - low.1 * (1.0 - exp(-(low.0 - value) / low.1))
        } else {
            value
        }
    }

    /// From where on the cubic is bent, and how far it gets beyond, below and above: it must not fire between its ends.
    fn limits(&self, k: usize) -> ((f64, f64), (f64, f64)) {
        let (low, high) = (f64::min(self.v[k], self.v[k + 1]), f64::max(self.v[k], self.v[k + 1]));
        ((low - 0.5 * self.off, 0.35 * self.off), (high + 0.5 * self.on, 0.35 * self.on))
    }

    /// Knots between events, with voltage and slope.
    fn sampled(&self, end_s: f64) -> Band {
        let mut band = Band::default();
        for k in 0..self.t.len() - 1 {
            let (start, h) = (self.t[k], self.t[k + 1] - self.t[k]);
            if k > 0 {
                band.at_event.push(band.t.len() as u32);
            }
            band.t.push(start);
            band.v.push(self.v[k]);
            band.slope.push(self.slope[k]);
            let mut at = f64::min(0.5 * h, SHORT_STEP_S);
            while at < h - 0.25 * f64::min(SHORT_STEP_S, h) {
                let width = 1e-6;
                let (value, next) = (self.at(k, start + at), self.at(k, start + at + width));
                band.t.push(start + at);
                band.v.push(value);
                band.slope.push((next - value) / width);
                let edge = f64::min(at, h - at);
                at += f64::clamp(0.6 * edge, SHORT_STEP_S, LONG_STEP_S).min(f64::max(0.5 * h, 1e-6));
            }
        }
        band.t.push(end_s);
        band.v.push(self.v[self.v.len() - 1]);
        band.slope.push(0.0);
        band.anchor = vec![0.0; band.t.len()];
        band.log_light.clone_from(&band.v);
        band
    }

    /// Share of an exposure in reversals and long silence, where only the band is known.
    fn doubt(&self, start: f64, end: f64) -> f64 {
        let mut sum = 0.0;
        let first = self.t.partition_point(|t| *t <= start).max(1) - 1;
        for k in first..self.t.len() - 1 {
            if self.t[k] >= end {
                break;
            }
            let width = f64::min(self.t[k + 1], end) - f64::max(self.t[k], start);
            let h = self.t[k + 1] - self.t[k];
            let turns = self.polarity[k] != self.polarity[k + 1];
            let is_end = k == 0 || k + 2 == self.t.len();
            let share = if is_end { 1.0 } else { f64::min(if turns { 0.3 + h / 4e-3 } else { h / 5e-3 }, 1.0) };
            sum += width * share;
        }
        (sum / (end - start)).clamp(0.0, 1.0)
    }
}
