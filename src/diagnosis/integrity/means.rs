//! Compares frames of long exposure with the events within them: late events, thresholds, and a dark current
//! of the event path alone.
//!
//! Each event stands for one threshold of log light, between two exposures and within them. For any
//! thresholds, one frame of a pixel predicts the next by the double integral (Pan et al., CVPR 2019, Eq. 8):
//! the mean over an exposure of the exponential of the summed events. That is linear in small changes of the
//! thresholds, with events weighted by the light after them. So thresholds are a least-squares fit for every
//! shift of the clock and every dark current. With a dark current events see `ln(i + current)`, and their
//! thresholds must explain that sum. An event is placed at the middle of the light that it stands for
//! ([`super::changes::centred`]), and earlier by the delay that is stated for its pixel's light.
//!
//! Limits: one delay for all pixels, so that a front end slower than stated looks like a clock offset.
//! Thresholds have an error of up to a tenth, as lost events make them look larger. Light mixed in from
//! neighbours, and a black level that is too low, look like a dark current.

use super::array::{half, lowest};
use super::changes::{
    CrossPrediction, DELAY_NS, FEWEST, FULL, LONGEST_EXPOSURE, RegressionSums, SHORTEST, SIGNAL, ShiftSums,
    centred, intervals,
};
use super::departure::{Departure, NATS};
use super::still::noise_dn;
use photocurrent_core::sensor::Reset;
use photocurrent_scene::case::{Case, PixelEvent};
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::statistics::{median, quantile};
use photocurrent_sensor::front_end::time_constant;

/// Number of pairs above which pixels are left out.
const MOST: usize = 60_000;
/// Least delay that is reported: [`DELAY_NS`], this share of the exposure, and this share of the period.
const DELAY_EXPOSURES: f64 = 0.05;
const DELAY_PERIODS: f64 = 0.02;
/// Thresholds that differ by less than this share are not proposed.
const LEAST_SCALE: f64 = 0.05;
/// Least dark current that is reported, as a share of the median light.
const LEAST_DARK: f64 = 0.1;
/// Dark currents that are tried, as shares of the median light.
const DARK: (f64, f64) = (0.01, 2.0);
const DARKS: usize = 36;

/// Two frames of a pixel that follow each other.
#[derive(Clone, Copy, Debug)]
struct FramePair {
    /// Index of the pixel's events.
    place: usize,
    half: usize,
    /// Exposures, ns.
    exposures: [(i64, i64); 2],
    /// Mean photocurrents.
    light: [f64; 2],
}

impl FramePair {
    /// Change of the log of light and dark current.
    fn change(&self, dark: f64) -> f64 {
        libm::log((self.light[1] + dark) / (self.light[0] + dark))
    }

    /// Natural logarithm of how much denser the light lies in that.
    fn density(&self, dark: f64) -> f64 {
        0.5 * (libm::log(self.light[0] / (self.light[0] + dark))
            + libm::log(self.light[1] / (self.light[1] + dark)))
    }
}

/// An event at the middle of the light that it stands for, and that light in thresholds of its sign: 1, and
/// the loss in the blind time after it.
#[derive(Clone, Copy, Debug)]
struct EventStep {
    t_ns: i64,
    polarity: i8,
    thresholds: f64,
}

/// Events of the evaluated pixels, in order of time, and the pairs of their frames.
struct FramePairs {
    events: Vec<Vec<EventStep>>,
    all: Vec<FramePair>,
    period_ns: f64,
    exposure_ns: f64,
    /// Median photocurrent.
    median: f64,
}

impl FramePairs {
    /// Of a recording; none where its frames are few, or short enough for the tests of [`super::changes`] and
    /// [`super::steps`].
    fn from_case(case: &Case, nominal: &Nominal, masked: &[u32]) -> Option<FramePairs> {
        let frames = case.frames.as_ref().filter(|frames| frames.times.len() >= 5)?;
        let (period_ns, exposure_ns) =
            (frames.times.mean_period_ns()?, frames.times.nominal_exposure_ns()? as f64);
        if exposure_ns <= LONGEST_EXPOSURE * period_ns {
            return None;
        }
        let least = f64::max(SIGNAL * noise_dn(case, frames), 2.0);
        let usual_ns = quantile(&intervals(case), 0.5);
        let light = |frame: usize, pixel: usize, seconds: f64| -> Option<f64> {
            let dn = case.dn(frame, pixel);
            let is_known = dn < FULL * nominal.saturation_dn && dn - nominal.number.black_level > least;
            is_known.then(|| nominal.number.integral(dn) / seconds)
        };
        let pixels: Vec<usize> = (0..case.extent.pixels())
            .filter(|&pixel| {
                case.events.of_pixel(pixel).len() > 1 && masked.binary_search(&(pixel as u32)).is_err()
            })
            .collect();
        let stride = (pixels.len() * frames.times.len()).div_ceil(MOST).max(1);
        let mut pairs =
            FramePairs { events: Vec::new(), all: Vec::new(), period_ns, exposure_ns, median: 0.0 };
        let mut lights = Vec::new();
        for &pixel in pixels.iter().step_by(stride) {
            let y = case.pixel_place(pixel).1;
            let begun = pairs.all.len();
            let mut sum = (0.0, 0.0);
            let mut before: Option<((i64, i64), f64)> = None;
            for frame in 0..frames.times.len() {
                let exposure = frames.times.exposure(frame, y);
                let times = (exposure.start.0, exposure.end.0);
                let now = light(frame, pixel, exposure.length_ns() as f64 * 1e-9).map(|light| (times, light));
                if let (Some(before), Some(now)) = (before, now) {
                    pairs.all.push(FramePair {
                        place: pairs.events.len(),
                        half: half(case, pixel),
                        exposures: [before.0, now.0],
                        light: [before.1, now.1],
                    });
                }
                if let Some((_, light)) = now {
                    sum = (sum.0 + light, sum.1 + 1.0);
                }
                before = now;
            }
            if pairs.all.len() > begun {
                let mean = sum.0 / sum.1;
                lights.push(mean);
                let slow_ns = (time_constant(&nominal.pixel.front_end, mean) * 1e9).round() as i64;
                pairs.events.push(steps(case, nominal, case.events.of_pixel(pixel), usual_ns, slow_ns));
            }
        }
        pairs.median = median(&mut lights);
        (pairs.all.len() >= FEWEST).then_some(pairs)
    }

    /// Linearises the pair around `thresholds`, its events moved earlier by `shift_ns`.
    fn linearise(&self, pair: &FramePair, thresholds: (f64, f64), shift_ns: i64) -> LinearisedPair {
        let events = &self.events[pair.place];
        let [first, second] = pair.exposures;
        let from = |t_ns: i64| events.partition_point(|step| step.t_ns < t_ns + shift_ns);
        let (begin, to_second, end) = (from(first.0), from(second.0), from(second.1));
        let all = &events[begin..end];
        let mut between = StepSum::default();
        events[begin..to_second].iter().for_each(|step| between.add(step));
        let (a, b) = (
            ExposureMean::of_exposure(all, first, shift_ns, thresholds),
            ExposureMean::of_exposure(&events[to_second..end], second, shift_ns, thresholds),
        );
        let change = between.log(thresholds) + b.log - a.log;
        let (on, off) = (between.on + b.level.on - a.level.on, between.off + b.level.off - a.level.off);
        LinearisedPair {
            on,
            off,
            beyond: change - thresholds.0 * on - thresholds.1 * off,
            is_active: !all.is_empty(),
        }
    }
}

/// The steps of a pixel's events, in order of time; `slow_ns` is how late its front end is.
fn steps(
    case: &Case,
    nominal: &Nominal,
    events: &[PixelEvent],
    usual_ns: i64,
    slow_ns: i64,
) -> Vec<EventStep> {
    let is_losing = case.sensor.comparator.reset != Reset::Advance;
    let lost = |k: usize| -> f64 {
        let next = events.get(k + 1).filter(|next| is_losing && next.polarity == events[k].polarity);
        next.map_or(0.0, |next| {
            let blind = (events[k].t_off_ns - events[k].t_in_ns + nominal.pixel.refractory_ns) as f64;
            let interval = (next.t_in_ns - events[k].t_in_ns) as f64;
            blind / f64::max(interval - blind, 0.25 * interval)
        })
    };
    let middles = centred(events, usual_ns, nominal.pixel.refractory_ns);
    let mut steps: Vec<EventStep> = middles
        .enumerate()
        .map(|(k, t_ns)| EventStep {
            t_ns: t_ns - slow_ns,
            polarity: events[k].polarity,
            thresholds: 1.0 + lost(k),
        })
        .collect();
    steps.sort_by_key(|step| step.t_ns);
    steps
}

/// Of one pair: `change = beyond + on threshold_on + off threshold_off` to first order around the thresholds
/// that were assumed.
#[derive(Clone, Copy, Debug)]
struct LinearisedPair {
    on: f64,
    off: f64,
    beyond: f64,
    is_active: bool,
}

/// Summed events in thresholds, ON and OFF, that of OFF negative.
#[derive(Clone, Copy, Debug, Default)]
struct StepSum {
    on: f64,
    off: f64,
}

impl StepSum {
    fn add(&mut self, step: &EventStep) {
        if step.polarity > 0 { self.on += step.thresholds } else { self.off -= step.thresholds }
    }

    fn log(&self, thresholds: (f64, f64)) -> f64 {
        thresholds.0 * self.on + thresholds.1 * self.off
    }
}

/// Mean over an exposure, relative to the log light at its start.
struct ExposureMean {
    /// Logarithm of the mean light.
    log: f64,
    /// Its derivative by the thresholds.
    level: StepSum,
}

impl ExposureMean {
    /// Of the events from the start of an exposure on.
    fn of_exposure(
        events: &[EventStep],
        (start_ns, end_ns): (i64, i64),
        shift_ns: i64,
        thresholds: (f64, f64),
    ) -> ExposureMean {
        let length = (end_ns - start_ns) as f64;
        let (mut level, mut since, mut light, mut sum) = (StepSum::default(), 0.0, 0.0, StepSum::default());
        let mut hold = |level: &StepSum, share: f64| {
            let held = libm::exp(level.log(thresholds)) * share;
            light += held;
            sum = StepSum { on: sum.on + held * level.on, off: sum.off + held * level.off };
        };
        for step in events {
            let at = (step.t_ns - shift_ns - start_ns) as f64 / length;
            if at >= 1.0 {
                break;
            }
            hold(&level, at - since);
            since = at;
            level.add(step);
        }
        hold(&level, 1.0 - since);
        ExposureMean { log: libm::log(light), level: StepSum { on: sum.on / light, off: sum.off / light } }
    }
}

/// Proposals from pairs of frames. They are hypotheses, which held-out frames confirm or reject
/// ([`crate::judge`]).
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct PairProposals {
    /// An offset of the clock.
    pub late: Option<Departure>,
    /// Thresholds, and the same with a dark current: the simpler first, without those that gain nothing.
    pub contrast: Vec<Vec<Departure>>,
}

/// Of a recording, without the pixels of `masked`.
pub(crate) fn proposed(case: &Case, nominal: &Nominal, masked: &[u32]) -> PairProposals {
    let Some(pairs) = FramePairs::from_case(case, nominal, masked) else { return PairProposals::default() };
    let stated = (nominal.pixel.threshold_on, nominal.pixel.threshold_off);
    let (late_ns, late) = event_delay(case, nominal, &pairs, stated);
    let mut contrast = contrast(&pairs, stated, if late.is_some() { late_ns } else { 0.0 });
    contrast.retain(|findings| !findings.is_empty());
    PairProposals { late, contrast }
}

/// Delay of events after frames, ns, and the finding where it is an offset.
fn event_delay(
    case: &Case,
    nominal: &Nominal,
    pairs: &FramePairs,
    stated: (f64, f64),
) -> (f64, Option<Departure>) {
    let threshold = 0.5 * (stated.0 + stated.1);
    let large: Vec<&FramePair> = pairs.all.iter().filter(|pair| pair.change(0.0).abs() > threshold).collect();
    if large.len() < FEWEST {
        return (0.0, None);
    }
    let of_shift = ShiftSums::over_shifts(pairs.period_ns, large.iter(), |pair, shift_ns, sums| {
        let seen = pairs.linearise(pair, stated, shift_ns);
        sums[pair.half].add([seen.on, seen.off, 0.0], pair.change(0.0) - seen.beyond);
    });
    let Some(late_ns) = of_shift.best_ns() else { return (0.0, None) };
    let nats = of_shift.nats();
    let least = DELAY_NS.max(DELAY_EXPOSURES * pairs.exposure_ns).max(DELAY_PERIODS * pairs.period_ns);
    let shortest = quantile(&intervals(case), 0.001);
    let is_loss = late_ns < 0.0 && -late_ns < SHORTEST * (shortest - nominal.pixel.refractory_ns) as f64;
    if late_ns.abs() < least || nats < NATS || is_loss {
        return (late_ns, None);
    }
    let seen = format!(
        "{} pairs of frames follow from each other by their events best when these are taken {:.2} ms {}",
        large.len(),
        late_ns.abs() * 1e-6,
        if late_ns > 0.0 { "earlier" } else { "later" },
    );
    (
        late_ns,
        Some(Departure::from_halves("clock_offset", ("offset", late_ns * 1e-9), nats, large.len(), seen)),
    )
}

/// Significant changes of thresholds at a delay, without and with a dark current.
fn contrast(pairs: &FramePairs, stated: (f64, f64), late_ns: f64) -> Vec<Vec<Departure>> {
    let shift_ns = late_ns.round() as i64;
    let seen_with = |thresholds: (f64, f64)| -> Vec<(&FramePair, LinearisedPair)> {
        pairs
            .all
            .iter()
            .map(|pair| (pair, pairs.linearise(pair, thresholds, shift_ns)))
            .filter(|(_, seen)| seen.is_active)
            .collect()
    };
    let sums = |seen: &[(&FramePair, LinearisedPair)], dark: f64| -> [HalfFit; 2] {
        let mut fits = [HalfFit::default(); 2];
        for (pair, seen) in seen {
            fits[pair.half].sums.add([seen.on, seen.off, 0.0], pair.change(dark) - seen.beyond);
            fits[pair.half].density += pair.density(dark);
        }
        fits
    };
    let mut seen = seen_with(stated);
    let dark_of = |place: f64| pairs.median * DARK.0 * libm::pow(DARK.1 / DARK.0, place / (DARKS - 1) as f64);
    let darks: Vec<f64> = std::iter::once(0.0).chain((0..DARKS).map(|k| dark_of(k as f64))).collect();
    let (mut dark, mut tried) = (0.0, Vec::new());
    // Weights within exposures go with the thresholds: a second time with those that were found.
    for _ in 0..2 {
        if seen.len() < FEWEST {
            return Vec::new();
        }
        tried = darks.iter().map(|dark| sums(&seen, *dark)).collect();
        let curve: Vec<f64> = tried.iter().map(|[a, b]| -a.plus(b).log_likelihood()).collect();
        dark = lowest(&curve).filter(|place| *place > 1.0).map_or(0.0, |place| dark_of(place - 1.0));
        let [a, b] = sums(&seen, dark);
        match a.plus(&b).sums.solve(2) {
            Some([on, off, _]) if on > 0.0 && off > 0.0 => seen = seen_with((on, off)),
            _ => return Vec::new(),
        }
    }
    let best_of = |side: usize| {
        (0..tried.len())
            .max_by(|&a, &b| tried[a][side].log_likelihood().total_cmp(&tried[b][side].log_likelihood()))
    };
    let gain = |side: usize| -> Option<f64> {
        let with = &tried[best_of(1 - side)?];
        Some(with[side].predicted_by(&with[1 - side])? - tried[0][side].predicted_by(&tried[0][1 - side])?)
    };
    let nats = gain(0).zip(gain(1)).map_or(0.0, |(a, b)| a + b);
    let mut all = vec![thresholds(sums(&seen, 0.0), stated, seen.len())];
    if nats > NATS && dark > LEAST_DARK * pairs.median {
        let observation = format!(
            "in {} pairs of frames events need the more change of light the darker it is, as if {:.2} of \
             the median light were there without light",
            seen.len(),
            dark / pairs.median
        );
        let mut findings = thresholds(sums(&seen, dark), stated, seen.len());
        findings.push(Departure::from_halves(
            "dark_current",
            ("current", dark),
            nats,
            seen.len(),
            observation,
        ));
        all.push(findings);
    }
    all
}

/// Significant changes of thresholds on both halves.
fn thresholds(fits: [HalfFit; 2], stated: (f64, f64), measured: usize) -> Vec<Departure> {
    let Some([on, off, _]) = fits[0].plus(&fits[1]).sums.solve(2) else { return Vec::new() };
    let ratios = (on / stated.0, off / stated.1);
    let (scale, asymmetry) =
        (0.5 * (ratios.0 + ratios.1) - 1.0, (ratios.0 - ratios.1) / (ratios.0 + ratios.1));
    // With what is made of the thresholds that are best on the other half.
    let nats = |of: &dyn Fn([f64; 3]) -> [f64; 3], against: &dyn Fn([f64; 3]) -> [f64; 3]| -> f64 {
        let gain = |side: usize| -> Option<f64> {
            let (these, from) = (fits[side].sums, fits[1 - side].sums);
            let factors = from.solve(2)?;
            Some(
                CrossPrediction { these, from, factors: of(factors) }.log_likelihood()
                    - CrossPrediction { these, from, factors: against(factors) }.log_likelihood(),
            )
        };
        gain(0).zip(gain(1)).map_or(0.0, |(a, b)| a + b)
    };
    let scaled = |factors: [f64; 3]| {
        let scale = 0.5 * (factors[0] / stated.0 + factors[1] / stated.1);
        [scale * stated.0, scale * stated.1, 0.0]
    };
    let of_scale = nats(&scaled, &|_| [stated.0, stated.1, 0.0]);
    let apart = nats(&|factors| factors, &scaled);
    let observation = format!(
        "in {measured} pairs of frames an ON event comes for a change of {on:.3} of the log \
                        light and an OFF event for {off:.3}"
    );
    let mut all = Vec::new();
    if scale.abs() > LEAST_SCALE && of_scale > NATS {
        all.push(Departure::from_halves(
            "threshold_scale",
            ("fraction", scale),
            of_scale,
            measured,
            observation.clone(),
        ));
    }
    if asymmetry.abs() > LEAST_SCALE && apart > NATS {
        all.push(Departure::from_halves(
            "threshold_asymmetry",
            ("fraction", asymmetry),
            apart,
            measured,
            observation,
        ));
    }
    all
}

/// Sums of one half, and the log density of light in the fitted quantity.
#[derive(Clone, Copy, Debug, Default)]
struct HalfFit {
    sums: RegressionSums,
    density: f64,
}

impl HalfFit {
    fn plus(&self, other: &HalfFit) -> HalfFit {
        HalfFit { sums: self.sums.plus(&other.sums), density: self.density + other.density }
    }

    /// With the thresholds that are best on it, nats.
    fn log_likelihood(&self) -> f64 {
        self.predicted_by(self).unwrap_or(f64::NEG_INFINITY)
    }

    /// With the thresholds that are best on another one.
    fn predicted_by(&self, other: &HalfFit) -> Option<f64> {
        Some(CrossPrediction::new(self.sums, other.sums, 2)?.log_likelihood() + self.density)
    }
}
