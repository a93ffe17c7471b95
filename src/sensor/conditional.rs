//! The recorded events and frames of one pixel, seen through any set of effects, when its light is given.
//!
//! Nothing is simulated: events stand where they were recorded, and the question is by how much voltage less
//! reference missed the threshold at each. So a pixel whose events an effect explains has residuals of
//! nothing when it is seen through that effect. The hooks of an effect are asked as the simulator asks them;
//! only what is random about them is left away.
//!
//! The voltage follows log-linear light in short steps with the time constant of their middle: exact for
//! low-pass, second pole and the exponential transistor at constant time constants, and to the step where a
//! slew limit cuts it.
//!
//! Limits: a stamp is undone to first order; events that come without a crossing and lost ones have no place
//! here; a pixel that an effect blinds beyond its next event takes its reference at that event.

use crate::comparator::signed_step;
use crate::effects::{
    Drive, Effect, FrontEndModel, History, Impulse, ImpulseTarget, Leak, PixelEvent, Reading, RowSite, Site,
    Thresholds,
};
use crate::elementary::{exp, exp_m1, ln};
use crate::exposure::log_linear_mean;
use crate::front_end::FrontEnd;
use crate::map::MapFrame;
use crate::model::Model;
use multiversion::multiversion;
use photocurrent_core::random::Random;
use photocurrent_core::sensor::Reset;
use photocurrent_core::{Exposure, Timestamp};
use std::sync::OnceLock;

/// An event this soon after the blind time may be one that was held back, ns: as in the MAP solver.
const LATE_NS: i64 = 1_000;
/// Time constants below this are taken as that, seconds.
const TAU_LEAST_S: f64 = 1e-9;

/// Light of one pixel, log-linear between instants, cut into short steps.
#[derive(Clone, Debug, Default)]
pub struct Track {
    /// Instants, ns, rising.
    pub t_ns: Vec<i64>,
    /// Log light.
    pub log_light: Vec<f64>,
    /// Light; from its logarithm when it is asked for.
    light: OnceLock<Vec<f64>>,
    /// Collected since the first instant, photocurrent times seconds; summed up when it is asked for.
    collected: OnceLock<Vec<f64>>,
}

impl Track {
    /// Of knots, cut into steps of at most `step_ns`.
    pub fn new(t_ns: &[i64], log_light: &[f64], step_ns: i64) -> Track {
        let mut track = Track { t_ns: vec![t_ns[0]], log_light: vec![log_light[0]], ..Track::default() };
        for k in 1..t_ns.len() {
            let length = t_ns[k] - t_ns[k - 1];
            let pieces = (length + step_ns - 1) / step_ns;
            for piece in 1..=pieces {
                let share = piece as f64 / pieces as f64;
                let at = if piece == pieces { t_ns[k] } else { t_ns[k - 1] + (length as f64 * share) as i64 };
                track.t_ns.push(at);
                track.log_light.push(
                    log_light[k - 1]
                        + (log_light[k] - log_light[k - 1]) * (at - t_ns[k - 1]) as f64 / length as f64,
                );
            }
        }
        track
    }

    fn light(&self) -> &[f64] {
        self.light.get_or_init(|| self.log_light.iter().map(|u| exp(*u)).collect())
    }

    fn collected(&self) -> &[f64] {
        self.collected.get_or_init(|| {
            let mut collected = vec![0.0; self.t_ns.len()];
            for k in 1..self.t_ns.len() {
                let mean = log_linear_mean(self.log_light[k - 1], self.log_light[k]);
                collected[k] = collected[k - 1] + mean * (self.t_ns[k] - self.t_ns[k - 1]) as f64 * 1e-9;
            }
            collected
        })
    }

    /// Light collected in an exposure, photocurrent times seconds; constant light beyond either end.
    pub fn collected_in(&self, exposure: Exposure) -> f64 {
        self.collected_until(exposure.end.0) - self.collected_until(exposure.start.0)
    }

    /// Light collected from the first instant to `t_ns`, photocurrent times seconds; constant light beyond
    /// either end.
    fn collected_until(&self, t_ns: i64) -> f64 {
        let collected = self.collected();
        let (last, after) = (self.t_ns.len() - 1, self.t_ns.partition_point(|&t| t <= t_ns));
        if after == 0 {
            return (t_ns - self.t_ns[0]) as f64 * 1e-9 * self.light()[0];
        }
        if after > last {
            return collected[last] + (t_ns - self.t_ns[last]) as f64 * 1e-9 * self.light()[last];
        }
        let share = (t_ns - self.t_ns[after - 1]) as f64 / (self.t_ns[after] - self.t_ns[after - 1]) as f64;
        let (from, to) = (self.log_light[after - 1], self.log_light[after]);
        collected[after - 1]
            + log_linear_mean(from, from + (to - from) * share) * (t_ns - self.t_ns[after - 1]) as f64 * 1e-9
    }
}

/// One pixel of a recording.
#[derive(Clone, Copy, Debug)]
pub struct Look<'a> {
    /// Its place.
    pub site: Site,
    /// Its own light: what frames collect.
    pub track: &'a Track,
    /// Log light that the event path sees at the instants of the track; none = its own.
    pub seen: Option<&'a [f64]>,
    /// Events as recorded.
    pub events: &'a [PixelEvent],
    /// Frames as recorded; one that is missing in the recording is missing here.
    pub frames: &'a [MapFrame],
    /// Instants between events, rising, at which the comparator's input is wanted as well.
    pub quiet_ns: &'a [i64],
}

/// What the comparator has at an instant between events.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quiet {
    /// The instant, ns.
    pub t_ns: i64,
    /// When the reference was taken, ns.
    pub reference_ns: i64,
    /// Voltage less reference, natural-log units.
    pub level: f64,
    /// Thresholds that it is compared with.
    pub thresholds: Thresholds,
    /// How fast the voltage moves, ln/s.
    pub slope_per_s: f64,
    /// No event before holds the pixel.
    pub is_armed: bool,
}

/// What the model says of the measurements of a pixel.
#[derive(Clone, Debug, Default)]
pub struct Conditional {
    /// Of each event: voltage less reference less the signed threshold when it fired, natural-log units.
    pub excess: Vec<f64>,
    /// Of each event: its threshold, positive, natural-log units.
    pub threshold: Vec<f64>,
    /// Of each event: how fast the voltage moved, ln/s.
    pub slope_per_s: Vec<f64>,
    /// Of each event: was the comparator watching, as the description has it?
    pub is_armed: Vec<bool>,
    /// Of each event: when it fired, ns.
    pub fired_ns: Vec<i64>,
    /// Of each event: when the reference was taken that its step counts from, ns.
    pub reference_ns: Vec<i64>,
    /// The low-pass of the front end, with what effects change of it.
    pub low_pass: FrontEnd,
    /// Of each frame: its value, DN.
    pub dn: Vec<f64>,
    /// Of each instant between events.
    pub quiet: Vec<Quiet>,
    /// Room.
    settling: Settling,
}

impl Conditional {
    /// Makes room for events, with what is known before the voltage is.
    fn begin(&mut self, times: &[Times], start_ns: i64, low_pass: FrontEnd) {
        for values in [&mut self.excess, &mut self.threshold, &mut self.slope_per_s] {
            values.clear();
            values.resize(times.len(), 0.0);
        }
        self.is_armed.clear();
        self.is_armed.extend(times.iter().map(|time| time.is_armed));
        self.fired_ns.clear();
        self.fired_ns.extend(times.iter().map(|time| time.fired_ns));
        self.reference_ns.clear();
        self.reference_ns.resize(times.len(), start_ns);
        self.quiet.clear();
        self.low_pass = low_pass;
    }
}

/// The low-pass over each whole step of a track.
#[derive(Clone, Debug, Default)]
struct Settling {
    /// Its time constant, seconds.
    tau_s: Vec<f64>,
    /// The share of a lag that it makes up for.
    settled: Vec<f64>,
    /// Of which low-pass, instants and log light they are.
    of: (Option<FrontEnd>, Vec<i64>, Vec<f64>),
}

impl Settling {
    fn fill(&mut self, low_pass: &FrontEnd, t_ns: &[i64], seen: &[f64]) {
        if self.of.0 == Some(*low_pass) && self.of.1 == t_ns && self.of.2 == seen {
            return;
        }
        let (of, instants, light) = &mut self.of;
        *of = Some(*low_pass);
        instants.clear();
        instants.extend_from_slice(t_ns);
        light.clear();
        light.extend_from_slice(seen);
        let steps = t_ns.len() - 1;
        self.tau_s.resize(steps, 0.0);
        self.settled.resize(steps, 0.0);
        settle((low_pass.tau_0_s, low_pass.alpha_s), t_ns, seen, &mut self.tau_s, &mut self.settled);
    }
}

/// Time constants and shares made up for of whole steps.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
fn settle(
    (tau_0_s, alpha_s): (f64, f64),
    t_ns: &[i64],
    seen: &[f64],
    tau_s: &mut [f64],
    settled: &mut [f64],
) {
    let steps = tau_s.len();
    let (t_ns, seen, settled) = (&t_ns[..=steps], &seen[..=steps], &mut settled[..steps]);
    for k in 0..steps {
        tau_s[k] = time_constant(tau_0_s, alpha_s, exp(-0.5 * (seen[k] + seen[k + 1])));
        settled[k] = -exp_m1(-((t_ns[k + 1] - t_ns[k]) as f64 * 1e-9) / tau_s[k]);
    }
}

#[inline(always)]
fn time_constant(tau_0_s: f64, alpha_s: f64, one_over_light: f64) -> f64 {
    f64::max(tau_0_s + alpha_s * one_over_light, TAU_LEAST_S)
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Mark {
    Impulse(usize),
    Latch(usize),
    Fire(usize),
    Quiet,
}

/// What happens in a pixel, in order: when, order at one instant, what.
fn marks(reset: Reset, impulses: &[Impulse], times: &[Times], quiet_ns: &[i64]) -> Vec<(i64, u8, Mark)> {
    let mut marks: Vec<(i64, u8, Mark)> =
        impulses.iter().enumerate().map(|(n, impulse)| (impulse.t_ns, 1, Mark::Impulse(n))).collect();
    for (k, time) in times.iter().enumerate() {
        marks.push((time.fired_ns, 3, Mark::Fire(k)));
        if reset == Reset::Resample {
            marks.push((time.latch_ns, if time.latch_ns > time.fired_ns { 2 } else { 4 }, Mark::Latch(k)));
        }
    }
    marks.extend(quiet_ns.iter().map(|t_ns| (*t_ns, 5, Mark::Quiet)));
    marks.sort_unstable_by_key(|(t, order, mark)| (*t, *order, matches!(mark, Mark::Fire(_))));
    marks
}

/// What effects make of the circuits before the comparator.
struct Analog {
    front_end: FrontEndModel,
    leak: Leak,
    /// Within the light of the pixel.
    impulses: Vec<Impulse>,
}

impl Analog {
    fn of(model: &Model, effects: &[Box<dyn Effect>], look: &Look<'_>) -> Analog {
        let (site, track) = (&look.site, look.track);
        let mut front_end = FrontEndModel::plain(model.pixel.front_end);
        let stated = Thresholds { on: model.pixel.threshold_on, off: model.pixel.threshold_off };
        let mut leak = Leak::default();
        let mut impulses: Vec<Impulse> = Vec::new();
        let (start_ns, end_ns) = (track.t_ns[0], track.t_ns[track.t_ns.len() - 1]);
        for effect in effects {
            effect.front_end(site, &mut front_end);
            let more = effect.leak(site, &stated);
            leak.constant_per_s += more.constant_per_s;
            leak.per_photocurrent_per_s += more.per_photocurrent_per_s;
            effect.impulses(site, start_ns, end_ns, &mut impulses);
        }
        impulses.retain(|impulse| impulse.t_ns >= start_ns && impulse.t_ns < end_ns);
        Analog { front_end, leak, impulses }
    }
}

/// Sees a pixel through a sensor with effects.
pub fn conditional(model: &Model, effects: &[Box<dyn Effect>], look: &Look<'_>, out: &mut Conditional) {
    frame_values(model, effects, look, out);
    let (site, track) = (&look.site, look.track);
    let changed = seen_light(effects, look);
    let seen: &[f64] = changed.as_deref().or(look.seen).unwrap_or(&track.log_light);
    let mut random = Random::new(0, &[]);
    let stated = Thresholds { on: model.pixel.threshold_on, off: model.pixel.threshold_off };
    let start_ns = track.t_ns[0];
    let Analog { front_end, leak, impulses } = Analog::of(model, effects, look);
    let times = times(model, effects, look, seen, &mut random);
    let marks = marks(model.reset, &impulses, &times, look.quiet_ns);
    if look.events.is_empty() {
        out.settling = Settling::default();
    } else {
        out.settling.fill(&front_end.low_pass, &track.t_ns, seen);
    }
    out.begin(&times, start_ns, front_end.low_pass);
    let mut walk = Walk::new(front_end, &out.settling, leak, track, seen);
    let (mut taken_ns, mut held_until_ns) = (start_ns, start_ns);
    let draw = |history: &History, t_ns: i64, random: &mut Random| {
        let mut thresholds = stated;
        for effect in effects {
            effect.thresholds(site, history, random, t_ns, &mut thresholds);
        }
        thresholds
    };
    let mut history = History { light: exp(seen[0]), ..History::default() };
    let mut reference = walk.input();
    let mut before = reference;
    let mut thresholds = draw(&history, start_ns, &mut random);
    let mut reset = |ideal: f64, t_ns: i64, before: f64, history: &History| {
        let reference = effects
            .iter()
            .fold(ideal, |reference, effect| effect.reference(site, history, &mut random, reference, before));
        (reference, draw(history, t_ns, &mut random))
    };
    for (t_ns, _, mark) in marks {
        walk.go_to(t_ns);
        let thresholds_now = waited(effects, site, &history, t_ns, thresholds);
        match mark {
            Mark::Impulse(n) => walk.impulse(&impulses[n]),
            Mark::Quiet => out.quiet.push(Quiet {
                t_ns,
                reference_ns: taken_ns,
                level: walk.input() - reference,
                thresholds: thresholds_now,
                slope_per_s: walk.rate_per_s(),
                is_armed: t_ns >= held_until_ns,
            }),
            Mark::Latch(_) => {
                (reference, thresholds) = reset(walk.input(), t_ns, before, &history);
                taken_ns = t_ns;
            }
            Mark::Fire(k) => {
                let (event, time) = (&look.events[k], &times[k]);
                let step = signed_step(event.polarity, thresholds_now.on, thresholds_now.off);
                let value = walk.input();
                out.excess[k] = value - reference - step;
                out.threshold[k] = step.abs();
                out.reference_ns[k] = taken_ns;
                out.slope_per_s[k] = walk.rate_per_s();
                held_until_ns = time.latch_ns;
                let now = PixelEvent { t_in_ns: t_ns, t_off_ns: time.left_ns, polarity: event.polarity };
                history = history.with(now, time.light);
                before = reference;
                if model.reset != Reset::Resample {
                    // A reference that moves by one threshold is the voltage of the event, unless the event
                    // was held back.
                    let moved = if time.is_armed { value } else { reference + step };
                    (reference, thresholds) = reset(moved, t_ns, before, &history);
                    if time.is_armed {
                        taken_ns = t_ns;
                    }
                }
            }
        }
    }
}

/// Thresholds of a reset as they are at an instant before the next event.
fn waited(
    effects: &[Box<dyn Effect>],
    site: &Site,
    history: &History,
    t_ns: i64,
    mut thresholds: Thresholds,
) -> Thresholds {
    effects.iter().for_each(|effect| effect.waiting(site, history, t_ns, &mut thresholds));
    thresholds
}

/// Digital numbers of the frames; leaves what is said of events alone.
pub fn frame_values(model: &Model, effects: &[Box<dyn Effect>], look: &Look<'_>, out: &mut Conditional) {
    let Look { site, track, .. } = look;
    let mut previous_charge = 0.0;
    out.dn.clear();
    for (frame, stated) in look.frames.iter().enumerate() {
        let row = RowSite { y: site.y, height: site.height, frame, row_time_ns: model.row_time_ns };
        let stated = Exposure { start: Timestamp(stated.start_ns), end: Timestamp(stated.end_ns) };
        let exposed = effects.iter().fold(stated, |exposure, effect| effect.exposure(&row, exposure));
        let collected = track.collected_in(exposed);
        let number = model.number;
        let reading = Reading {
            frame,
            previous_charge,
            gain: number.gain,
            black_level: number.black_level,
            saturation: model.saturation_dn,
        };
        previous_charge = collected;
        let charge = effects.iter().fold(collected, |charge, effect| effect.charge(site, &reading, charge));
        out.dn.push(effects.iter().fold(number.of(charge), |dn, effect| effect.dn(site, &reading, dn)));
    }
}

/// Log light of the event path where effects change it pixel by pixel; none where they do not.
fn seen_light(effects: &[Box<dyn Effect>], look: &Look<'_>) -> Option<Vec<f64>> {
    let track = look.track;
    let through =
        |t_ns: i64, i: f64| effects.iter().fold(i, |i, effect| effect.event_light(&look.site, t_ns, i));
    // Such a change is linear and constant in time, or it says how finely it must be asked: two lights show
    // it.
    let start_ns = track.t_ns[0];
    let is_none = effects.iter().all(|effect| effect.light_step_ns().is_none())
        && [1.0, 2.0].iter().all(|&i| through(start_ns, i) == i);
    let of = |k: usize| match look.seen {
        Some(seen) => exp(seen[k]),
        None => track.light()[k],
    };
    (!is_none).then(|| {
        (0..track.t_ns.len())
            .map(|k| ln(f64::max(through(track.t_ns[k], of(k)), f64::MIN_POSITIVE)))
            .collect()
    })
}

/// When an event really happened, under a trial.
#[derive(Clone, Copy, Debug)]
struct Times {
    fired_ns: i64,
    left_ns: i64,
    latch_ns: i64,
    /// As the description has it, with recorded stamps.
    is_armed: bool,
    /// Photocurrent in the logarithm when it left.
    light: f64,
}

fn times(
    model: &Model,
    effects: &[Box<dyn Effect>],
    look: &Look<'_>,
    seen: &[f64],
    random: &mut Random,
) -> Vec<Times> {
    let (site, track) = (&look.site, look.track);
    let (first_ns, last_ns) = (track.t_ns[0], track.t_ns[track.t_ns.len() - 1]);
    let mut all: Vec<Times> = Vec::with_capacity(look.events.len());
    let (mut blind_until, mut before) = (i64::MIN, i64::MIN);
    for (k, event) in look.events.iter().enumerate() {
        // The rules of the MAP solver.
        let is_armed = match model.reset {
            Reset::Resample => event.t_in_ns >= blind_until && event.t_in_ns > before,
            Reset::Advance | Reset::AdvanceLossy => {
                let is_last = look.events.get(k + 1).is_none_or(|next| next.t_in_ns != event.t_in_ns);
                is_last
                    && (model.pixel.refractory_ns == 0 || event.t_in_ns > blind_until.saturating_add(LATE_NS))
            }
        };
        blind_until = i64::max(blind_until, event.t_off_ns + model.pixel.refractory_ns);
        before = event.t_in_ns;
        let mut recorded = *event;
        for effect in effects {
            effect.stamp(site, random, &mut recorded);
        }
        let fired_ns = (2 * event.t_in_ns - recorded.t_in_ns).clamp(first_ns, last_ns);
        let hidden_ns: i64 =
            effects.iter().map(|effect| effect.latency(site, random, fired_ns).hidden_ns).sum();
        let left_ns = i64::max(2 * event.t_off_ns - recorded.t_off_ns + hidden_ns, fired_ns);
        let light = exp(at(&track.t_ns, seen, left_ns));
        let refractory_ns = effects.iter().fold(model.pixel.refractory_ns, |refractory_ns, effect| {
            effect.refractory_ns(site, light, refractory_ns)
        });
        if let Some(last) = all.last_mut()
            && is_armed
        {
            last.latch_ns = i64::min(last.latch_ns, fired_ns);
        }
        all.push(Times { fired_ns, left_ns, latch_ns: left_ns + refractory_ns, is_armed, light });
    }
    for time in &mut all {
        time.latch_ns = i64::min(time.latch_ns, last_ns);
    }
    all
}

/// The value at an instant of what is linear between instants.
pub fn at(t_ns: &[i64], values: &[f64], instant: i64) -> f64 {
    between(t_ns, values, t_ns.partition_point(|&t| t <= instant), instant)
}

/// The same, where `after` is the first instant behind `instant`. Rounds in another order than
/// [`photocurrent_core::time::between`].
fn between(t_ns: &[i64], values: &[f64], after: usize, instant: i64) -> f64 {
    match (after.checked_sub(1), t_ns.get(after)) {
        (None, _) => values[0],
        (Some(last), None) => values[last],
        (Some(k), Some(&next)) => {
            values[k] + (values[after] - values[k]) * (instant - t_ns[k]) as f64 / (next - t_ns[k]) as f64
        }
    }
}

/// Appends the values at rising instants of what is linear between rising `t_ns`: [`at`] for each, in one
/// pass.
pub fn at_each(t_ns: &[i64], values: &[f64], instants: &[i64], out: &mut Vec<f64>) {
    let mut after = 0;
    out.extend(instants.iter().map(|&instant| {
        while t_ns.get(after).is_some_and(|&t| t <= instant) {
            after += 1;
        }
        between(t_ns, values, after, instant)
    }));
}

/// The front end on its way through the light.
struct Walk<'a> {
    model: FrontEndModel,
    /// Of its whole steps; nothing where there are no events.
    settling: &'a Settling,
    leak: Leak,
    track: &'a Track,
    seen: &'a [f64],
    /// The step of the track in which it stands.
    at: usize,
    t_ns: i64,
    /// Log light there.
    now: f64,
    /// Voltage behind the low-pass, behind the second pole, and the level that the high-pass subtracts.
    low: f64,
    second: f64,
    level: f64,
    /// Leaks and impulses of the comparator so far.
    drift: f64,
}

impl<'a> Walk<'a> {
    /// At the beginning of the light, settled.
    fn new(
        model: FrontEndModel,
        settling: &'a Settling,
        leak: Leak,
        track: &'a Track,
        seen: &'a [f64],
    ) -> Walk<'a> {
        Walk {
            model,
            settling,
            leak,
            track,
            seen,
            at: 0,
            t_ns: track.t_ns[0],
            now: seen[0],
            low: seen[0],
            second: seen[0],
            level: seen[0],
            drift: 0.0,
        }
    }

    fn go_to(&mut self, t_ns: i64) {
        while self.t_ns < t_ns {
            let Some(&next) = self.track.t_ns.get(self.at + 1) else { return };
            let (to_ns, to) = if next <= t_ns {
                (next, self.seen[self.at + 1])
            } else {
                (
                    t_ns,
                    self.now
                        + (self.seen[self.at + 1] - self.now) * (t_ns - self.t_ns) as f64
                            / (next - self.t_ns) as f64,
                )
            };
            let is_whole = to_ns == next && self.t_ns == self.track.t_ns[self.at];
            let known =
                self.settling.tau_s.get(self.at).zip(self.settling.settled.get(self.at)).filter(|_| is_whole);
            self.step((to_ns - self.t_ns) as f64 * 1e-9, to, known.map(|(tau, settled)| (*tau, *settled)));
            (self.t_ns, self.now) = (to_ns, to);
            if to_ns == next {
                self.at += 1;
            }
        }
    }

    fn before_high_pass(&self) -> f64 {
        if self.model.second_pole.is_some() { self.second } else { self.low }
    }

    fn input(&self) -> f64 {
        self.before_high_pass() + self.drift
            - if self.model.high_pass_s.is_finite() { self.level } else { 0.0 }
    }

    fn impulse(&mut self, impulse: &Impulse) {
        match impulse.target {
            ImpulseTarget::Comparator => self.drift += impulse.change,
            ImpulseTarget::FrontEnd => {
                self.low += impulse.change;
                self.second += impulse.change;
            }
        }
    }

    /// How fast the comparator's input moves, ln/s.
    fn rate_per_s(&self) -> f64 {
        let one_over_light = exp(-self.now);
        let low_pass = self.model.low_pass;
        let lag = self.now - self.low;
        let drive = if self.model.drive == Drive::LargeSignal { -exp_m1(-lag) } else { lag };
        let low = drive / f64::max(low_pass.tau_0_s + low_pass.alpha_s * one_over_light, TAU_LEAST_S);
        let low = low.clamp(-self.model.slew_down_per_s, self.model.slew_up_per_s);
        match self.model.second_pole {
            Some(pole) => {
                (self.low - self.second)
                    / f64::max(pole.tau_s + pole.tau_light_s * one_over_light, TAU_LEAST_S)
            }
            None => low,
        }
    }

    /// Over one piece of light that rises to `to`; `known`: time constant and what it makes up for.
    fn step(&mut self, h: f64, to: f64, known: Option<(f64, f64)>) {
        let (from, rise) = (self.now, to - self.now);
        let one_over_light = || exp(-0.5 * (from + to));
        let low_pass = self.model.low_pass;
        let (tau, settled) = known.unwrap_or_else(|| {
            let tau = time_constant(low_pass.tau_0_s, low_pass.alpha_s, one_over_light());
            (tau, -exp_m1(-h / tau))
        });
        let was = (self.low, self.before_high_pass());
        let slope = rise / h;
        let end = match self.model.drive {
            Drive::SmallSignal => self.low + settled * (from - self.low) + (1.0 - settled * tau / h) * rise,
            Drive::LargeSignal => {
                // With x = L - V, exp(x) - 1 obeys a linear equation on a ramp.
                let rate = 1.0 / tau - slope;
                let gone = -exp_m1(-rate * h);
                let rest = exp_m1(from - self.low) * (1.0 - gone)
                    + slope * if (rate * h).abs() < 1e-9 { h } else { gone / rate };
                to - ln(f64::max(1.0 + rest, 1e-12))
            }
        };
        self.low =
            end.clamp(self.low - self.model.slew_down_per_s * h, self.low + self.model.slew_up_per_s * h);
        if let Some(pole) = self.model.second_pole {
            let mut tau_2 = f64::max(pole.tau_s + pole.tau_light_s * one_over_light(), TAU_LEAST_S);
            let is_plain = self.model.drive == Drive::SmallSignal && self.low == end;
            if is_plain {
                if (tau_2 / tau - 1.0).abs() < 1e-3 {
                    tau_2 = tau * 1.001;
                }
                // The low-pass is a ramp behind by tau and what decays; the second pole follows each.
                let decaying = was.0 - (from - slope * tau);
                let shared = decaying * tau / (tau - tau_2);
                let begin = from - slope * (tau + tau_2);
                let own = self.second - begin - shared;
                self.second = begin + rise + shared * (1.0 - settled) + own * exp(-h / tau_2);
            } else {
                let settled_2 = -exp_m1(-h / tau_2);
                self.second +=
                    settled_2 * (was.0 - self.second) + (1.0 - settled_2 * tau_2 / h) * (self.low - was.0);
            }
        }
        if self.model.high_pass_s.is_finite() {
            let middle = 0.5 * (was.1 + self.before_high_pass());
            self.level += -exp_m1(-h / self.model.high_pass_s) * (middle - self.level);
        }
        if self.leak != Leak::default() {
            // Of the light that falls on the pixel, not of what is added behind it.
            let own = 0.5 * (self.track.light()[self.at] + self.track.light()[self.at + 1]);
            self.drift += h * (self.leak.constant_per_s + self.leak.per_photocurrent_per_s * own);
        }
    }
}

#[cfg(test)]
#[path = "conditional_tests.rs"]
mod tests;
