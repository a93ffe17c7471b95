//! One pixel through time: steps, crossings, resets, and every place where an effect may enter.

use super::light::{EventLight, LinearLight, Piece};
use super::numeric::{NumericResponse, State, System, TOLERANCE};
use super::response::{Response, StepResponse};
use super::steps::Steps;
use crate::comparator::{fired_polarity, signed_step};
use crate::effects::{
    BURST_GAP_NS, Effect, FrontEndModel, History, Impulse, ImpulseTarget, Leak, PixelEvent, Site,
    Spontaneous, Thresholds, effect::Streams,
};
use crate::elementary;
use crate::front_end::settled_voltage;
use crate::model::Pixel;
use photocurrent_core::sensor::Reset;

/// A threshold never falls below this, whatever noise is added: at zero a pixel would fire without end.
const THRESHOLD_FLOOR: f64 = 1e-6;
/// Thresholds that change while a pixel waits are constant over this part of the wait, and at least over so
/// many nanoseconds.
const WAITING_PARTS: i64 = 64;
const WAITING_LEAST_NS: i64 = 10_000;

/// Where the simulated pixel gets its randomness from; the methods' defaults are "none".
pub trait PixelNoise {
    /// A number of [0, 1) for the next readout latency. Zero gives the constant latency alone.
    fn uniform(&mut self) -> f64 {
        0.0
    }

    /// Added to both thresholds from one event to the next, natural-log units.
    fn threshold_offset(&mut self) -> f64 {
        0.0
    }
}

/// A pixel without noise.
#[derive(Clone, Copy, Debug, Default)]
pub struct Noiseless;

impl PixelNoise for Noiseless {}

/// A pixel as a description states it, its reset rule, and what goes beyond.
#[derive(Clone, Copy)]
pub struct Chain<'a> {
    /// The stated pixel.
    pub pixel: Pixel,
    /// What the reference does after an event.
    pub reset: Reset,
    /// In the order of the catalogue.
    pub effects: &'a [Box<dyn Effect>],
    /// Error allowed per step where the front end is integrated by numbers, natural-log units:
    /// [`TOLERANCE`] moves a crossing by 0.1 us at 1 ln/s.
    pub tolerance: f64,
}

/// An event that a pixel fired.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fired {
    /// With true times; `t_off_ns` shows what stamps show, without hidden latency.
    pub event: PixelEvent,
    /// When it really left the array.
    pub left_ns: i64,
    /// As it is recorded, or nothing when it is lost.
    pub recorded: Option<PixelEvent>,
}

/// The events of one pixel from `start_ns` to `end_ns`, in order of true in-pixel time; `light` is what falls
/// on it, neighbours' parts included.
///
/// The pixel starts settled, armed, and with the reference at its voltage. `noise` is asked for thresholds
/// and latencies as in [`simulate_events`]; effects draw from streams of their own.
///
/// # Panics
///
/// When `log_step` is not positive, or an effect makes a photocurrent that is not positive.
pub fn simulate(
    chain: &Chain<'_>,
    site: &Site,
    light: &LinearLight<'_>,
    start_ns: i64,
    end_ns: i64,
    noise: &mut impl PixelNoise,
) -> Vec<Fired> {
    assert!(chain.pixel.log_step > 0.0, "the step of the simulation is positive");
    let seen = EventLight::new(chain.effects, site, *light, start_ns, end_ns);
    let seen = seen.get();
    let mut model = FrontEndModel::plain(chain.pixel.front_end);
    let stated = Thresholds { on: chain.pixel.threshold_on, off: chain.pixel.threshold_off };
    let mut leak = Leak::default();
    let (mut impulses, mut spontaneous): (Vec<Impulse>, Vec<Spontaneous>) = (Vec::new(), Vec::new());
    let mut streams: Vec<Streams> =
        chain.effects.iter().map(|effect| Streams::new(site, effect.id())).collect();
    for (effect, streams) in chain.effects.iter().zip(&mut streams) {
        effect.front_end(site, &mut model);
        let more = effect.leak(site, &stated);
        leak.constant_per_s += more.constant_per_s;
        leak.per_photocurrent_per_s += more.per_photocurrent_per_s;
        effect.impulses(site, start_ns, end_ns, &mut impulses);
        effect.spontaneous(site, &mut streams.spontaneous, start_ns, end_ns, &mut spontaneous);
    }
    impulses.retain(|impulse| impulse.t_ns >= start_ns && impulse.t_ns < end_ns);
    impulses.sort_by_key(|impulse| impulse.t_ns);
    spontaneous.retain(|event| event.t_ns >= start_ns && event.t_ns < end_ns);
    spontaneous.sort_by_key(|event| event.t_ns);
    let start_voltage = settled_voltage(seen.at(start_ns));
    let front = if model.is_plain() {
        Front::Plain(start_voltage)
    } else {
        Front::Numeric { state: [start_voltage; 3], guess_s: 1e-7 }
    };
    let mut run = Run {
        chain,
        site,
        light: *light,
        seen,
        model,
        leak,
        noise,
        streams,
        offsets: chain.effects.iter().map(|effect| effect.offsets(site)).collect(),
        front,
        drift: 0.0,
        reference: 0.0,
        before: 0.0,
        thresholds: stated,
        drawn: stated,
        waits: chain.effects.iter().any(|effect| effect.waits()),
        change_ns: i64::MAX,
        threshold_offset: 0.0,
        blind_until_ns: None,
        history: History { light: seen.at(start_ns), ..History::default() },
        fired: Vec::new(),
    };
    run.reference = run.input();
    run.threshold_offset = run.noise.threshold_offset();
    run.draw_thresholds(start_ns);
    run.run(start_ns, end_ns, &impulses, &spontaneous);
    run.fired
}

/// The events of one pixel of the paper's model from `start_ns` to `end_ns`, in time order: [`simulate`]
/// without effects.
///
/// The pixel starts settled (Eq. 6), armed, and with the reference at its voltage. Events whose `t_in` lies
/// in the span are put out even when their `t_off` does not.
///
/// # Panics
///
/// When `log_step` is not positive.
pub fn simulate_events(
    pixel: &Pixel,
    light: &LinearLight<'_>,
    start_ns: i64,
    end_ns: i64,
    noise: &mut impl PixelNoise,
) -> Vec<PixelEvent> {
    let chain = Chain { pixel: *pixel, reset: Reset::Resample, effects: &[], tolerance: TOLERANCE };
    let site = Site { x: 0, y: 0, width: 1, height: 1, seed: 0 };
    simulate(&chain, &site, light, start_ns, end_ns, noise).into_iter().map(|fired| fired.event).collect()
}

enum Front {
    Plain(f64),
    Numeric { state: State, guess_s: f64 },
}

/// Where a response's seconds start: whole nanoseconds, and seconds past them.
#[derive(Clone, Copy)]
struct Origin {
    ns: i64,
    past_s: f64,
}

impl Origin {
    fn seconds_to(self, t_ns: i64) -> f64 {
        (t_ns - self.ns) as f64 / 1e9 - self.past_s
    }

    fn nanoseconds_at(self, t_s: f64) -> i64 {
        self.ns + elementary::nearest((self.past_s + t_s) * 1e9) as i64
    }
}

struct Run<'a, N> {
    chain: &'a Chain<'a>,
    site: &'a Site,
    light: LinearLight<'a>,
    seen: LinearLight<'a>,
    model: FrontEndModel,
    leak: Leak,
    noise: &'a mut N,
    streams: Vec<Streams>,
    /// [`Effect::offsets`] of each effect.
    offsets: Vec<Option<Thresholds>>,
    front: Front,
    /// Leaks and impulses of the comparator's input so far; the reference is held in the same units, drift
    /// included.
    drift: f64,
    reference: f64,
    /// The reference at the last event.
    before: f64,
    thresholds: Thresholds,
    /// As they were at the reset, and when they change next where they do while the pixel waits.
    drawn: Thresholds,
    waits: bool,
    change_ns: i64,
    threshold_offset: f64,
    blind_until_ns: Option<i64>,
    history: History,
    fired: Vec<Fired>,
}

impl<N: PixelNoise> Run<'_, N> {
    fn run(&mut self, start_ns: i64, end_ns: i64, impulses: &[Impulse], spontaneous: &[Spontaneous]) {
        let (mut impulses, mut spontaneous) = (impulses.iter().peekable(), spontaneous.iter().peekable());
        let mut steps = Steps::new();
        let (mut from, mut next) = (start_ns, 0);
        while from < end_ns {
            while let Some(impulse) = impulses.next_if(|impulse| impulse.t_ns <= from) {
                self.impulse(impulse);
            }
            while let Some(event) = spontaneous.next_if(|event| event.t_ns <= from) {
                if self.blind_until_ns.is_none() {
                    let value = self.input();
                    self.fire(from, event.polarity, value, Cause::Spontaneous);
                }
            }
            let limit =
                [impulses.peek().map(|impulse| impulse.t_ns), spontaneous.peek().map(|event| event.t_ns)]
                    .into_iter()
                    .flatten()
                    .min();
            let limit = limit.unwrap_or(end_ns).min(end_ns);
            from = match self.front {
                Front::Plain(_) => {
                    steps.fill(&self.seen, &mut next, from, limit, self.chain.pixel.log_step);
                    steps.prepare(&self.model.low_pass);
                    self.follow(&steps);
                    steps.t_ns[steps.count]
                }
                Front::Numeric { .. } => {
                    let piece = self.seen.piece(from);
                    let to = piece.end_ns.min(limit);
                    self.integrate(&piece, from, to);
                    to
                }
            };
        }
    }

    /// Through prepared steps, with as many events as fit.
    fn follow(&mut self, steps: &Steps) {
        let Front::Plain(mut voltage) = self.front else { return };
        let is_leaking = self.leak != Leak::default();
        for n in 0..steps.count {
            let (from_ns, to_ns) = (steps.t_ns[n], steps.t_ns[n + 1]);
            let end = steps.end_voltage(n, voltage);
            let drift_per_s =
                if is_leaking { self.leak_per_s(|| from_ns + (to_ns - from_ns) / 2) } else { 0.0 };
            let drift_end = self.drift + drift_per_s * steps.length_s[n];
            let may_fire = match self.blind_until_ns {
                Some(until_ns) => until_ns <= to_ns || self.chain.reset == Reset::AdvanceLossy,
                None => {
                    let (low, high) =
                        (self.reference - self.thresholds.off, self.reference + self.thresholds.on);
                    let ends = [voltage + self.drift, end + drift_end];
                    let (first, last) = (steps.settled[n], steps.settled[n + 1]);
                    // The voltage runs after the light. While it does so in one direction, a crossing shows
                    // at the end; and it stays between where it is and where the light goes.
                    let is_outside = ends.iter().any(|input| *input >= high || *input <= low);
                    let turns = || {
                        let [first_slope, last_slope] = steps
                            .end_slopes(n, voltage - first)
                            .map(|slope| slope + drift_per_s * steps.length_s[n]);
                        (first_slope > 0.0) != (last_slope > 0.0)
                    };
                    let reach = drift_per_s.abs() * steps.length_s[n];
                    is_outside
                        || self.waits
                        || (first.max(last).max(voltage) + self.drift + reach >= high
                            || first.min(last).min(voltage) + self.drift - reach <= low)
                            && turns()
                }
            };
            if may_fire {
                let response = StepResponse::new(steps, n, voltage, end, self.drift, drift_per_s);
                self.front = Front::Plain(voltage);
                self.walk(&response, Origin { ns: from_ns, past_s: 0.0 }, steps.length_s[n]);
            }
            self.drift = drift_end;
            voltage = end;
        }
        self.front = Front::Plain(voltage);
    }

    /// The comparator's input now, drift included.
    fn input(&self) -> f64 {
        match &self.front {
            Front::Plain(voltage) => *voltage + self.drift,
            Front::Numeric { state, .. } => {
                System { model: &self.model, first: 1.0, slope_per_s: 0.0, tolerance: self.chain.tolerance }
                    .output(state)
                    + self.drift
            }
        }
    }

    fn impulse(&mut self, impulse: &Impulse) {
        let pushed = self.input() + impulse.change;
        match (impulse.target, &mut self.front) {
            (ImpulseTarget::Comparator, _) => self.drift += impulse.change,
            (ImpulseTarget::FrontEnd, Front::Plain(voltage)) => *voltage += impulse.change,
            // The impulse arrives behind the poles: it is what the comparator sees that jumps.
            (ImpulseTarget::FrontEnd, Front::Numeric { state, .. }) => {
                state[0] += impulse.change;
                state[1] += impulse.change;
            }
        }
        if self.blind_until_ns.is_none()
            && let Some(polarity) =
                fired_polarity(pushed, self.reference, self.thresholds.on, self.thresholds.off)
        {
            self.fire(impulse.t_ns, polarity, pushed, Cause::Crossing);
        }
    }

    /// From one instant of a piece of light to another by numbers, with as many events as fit.
    fn integrate(&mut self, piece: &Piece, from_ns: i64, to_ns: i64) {
        let Front::Numeric { mut state, mut guess_s } = self.front else { return };
        let length_s = (to_ns - from_ns) as f64 / 1e9;
        let first = piece.at(from_ns);
        let model = self.model;
        let system = System {
            model: &model,
            first,
            slope_per_s: (piece.at(to_ns) - first) / length_s,
            tolerance: self.chain.tolerance,
        };
        let mut now_s = 0.0;
        while now_s < length_s {
            let (end, step_s) = system.controlled_step(now_s, &state, length_s - now_s, &mut guess_s);
            let drift_per_s = self.leak_per_s(|| from_ns + ((now_s + 0.5 * step_s) * 1e9) as i64);
            let response = NumericResponse::new(system, now_s, state, &end, step_s, self.drift, drift_per_s);
            self.walk(&response, Origin { ns: from_ns, past_s: now_s }, step_s);
            self.drift += drift_per_s * step_s;
            state = end;
            // The last step ends the piece, whatever rounding says.
            now_s = if step_s >= length_s - now_s { length_s } else { now_s + step_s };
        }
        self.front = Front::Numeric { state, guess_s };
    }

    fn leak_per_s(&self, middle_ns: impl FnOnce() -> i64) -> f64 {
        let per_light = self.leak.per_photocurrent_per_s;
        self.leak.constant_per_s + if per_light == 0.0 { 0.0 } else { per_light * self.light.at(middle_ns()) }
    }

    /// Finds the events of one step.
    fn walk(&mut self, response: &impl Response, origin: Origin, length_s: f64) {
        let mut now_s = 0.0;
        let mut value = response.value(now_s);
        loop {
            if let Some(until_ns) = self.blind_until_ns {
                let until_s = origin.seconds_to(until_ns);
                if self.chain.reset == Reset::AdvanceLossy {
                    (now_s, value) = self.lose(response, (now_s, value), f64::min(until_s, length_s));
                }
                if until_s > length_s {
                    break;
                }
                // Latched at a whole nanosecond, which can lie a fraction of one before `now`.
                if until_s > now_s {
                    (now_s, value) = (until_s, response.value(until_s));
                }
                self.blind_until_ns = None;
                if self.chain.reset == Reset::Resample {
                    self.take_reference(value, until_ns);
                }
            }
            let Thresholds { on, off } = self.thresholds;
            let change_s = f64::max(origin.seconds_to(self.change_ns), now_s);
            let until_s = if self.waits { f64::min(change_s, length_s) } else { length_s };
            let Some((fired_s, polarity)) =
                response.first_crossing((now_s, value), until_s, self.reference, on, off)
            else {
                if until_s >= length_s {
                    break;
                }
                (now_s, value) = (until_s, response.value(until_s));
                self.wait(self.change_ns);
                continue;
            };
            let is_late = fired_s == now_s;
            if !is_late {
                (now_s, value) = (fired_s, self.reference + signed_step(polarity, on, off));
            }
            self.fire(origin.nanoseconds_at(fired_s), polarity, value, Cause::Crossing);
            if is_late && self.blind_until_ns.is_none() {
                // A reference that stays behind the voltage fires again at once; a nanosecond is the fastest
                // that stamps can resolve.
                now_s += 1e-9;
                if now_s >= length_s {
                    break;
                }
                value = response.value(now_s);
            }
        }
    }

    /// Moves the reference for crossings inside the blind time, without events; gives the instant of the last
    /// and the input there.
    fn lose(&mut self, response: &impl Response, from: (f64, f64), to_s: f64) -> (f64, f64) {
        let mut now = from;
        let Thresholds { on, off } = self.thresholds;
        while now.0 < to_s
            && let Some((crossed_s, polarity)) = response.first_crossing(now, to_s, self.reference, on, off)
        {
            self.reference += signed_step(polarity, on, off);
            // One already exceeded leaves the input where it is, beyond the threshold.
            if crossed_s > now.0 {
                now = (crossed_s, self.reference);
            }
        }
        now
    }

    /// The pixel fires: stamps, latency, and the start of the reset.
    fn fire(&mut self, t_in_ns: i64, polarity: i8, value: f64, cause: Cause) {
        let pixel = &self.chain.pixel;
        let spread_ns = -pixel.latency_spread_ns * elementary::ln(1.0 - self.noise.uniform());
        let mut t_off_ns = t_in_ns + pixel.latency_ns + elementary::nearest(spread_ns) as i64;
        let mut left_ns = t_off_ns;
        let effects = self.chain.effects.iter();
        for (effect, streams) in effects.clone().zip(&mut self.streams) {
            let more = effect.latency(self.site, &mut streams.latency, t_in_ns);
            t_off_ns += more.shown_ns;
            left_ns += more.shown_ns + more.hidden_ns;
        }
        let event = PixelEvent { t_in_ns, t_off_ns, polarity };
        let mut recorded = Some(event);
        for (effect, streams) in effects.clone().zip(&mut self.streams) {
            let is_kept = effect.keeps(self.site, &self.history, &mut streams.keeps, &event);
            recorded = recorded.filter(|_| is_kept);
            if let Some(stamped) = &mut recorded {
                effect.stamp(self.site, &mut streams.stamp, stamped);
            }
        }
        self.fired.push(Fired { event, left_ns, recorded });
        let light = if self.chain.effects.is_empty() { 0.0 } else { self.seen.at(left_ns) };
        self.history = self.history.with(PixelEvent { t_in_ns, t_off_ns: left_ns, polarity }, light);
        let refractory_ns = effects.fold(pixel.refractory_ns, |refractory_ns, effect| {
            effect.refractory_ns(self.site, light, refractory_ns)
        });
        let armed_ns = left_ns + refractory_ns;
        self.before = self.reference;
        self.threshold_offset = self.noise.threshold_offset();
        // Without blind time the reference is the threshold itself: no error adds up from rounded stamps.
        let moved = match cause {
            Cause::Crossing => {
                self.reference + signed_step(polarity, self.thresholds.on, self.thresholds.off)
            }
            Cause::Spontaneous => value,
        };
        if armed_ns > t_in_ns {
            self.blind_until_ns = Some(armed_ns);
        }
        if self.chain.reset != Reset::Resample || armed_ns <= t_in_ns {
            self.take_reference(moved, t_in_ns);
        }
    }

    /// The reset: a new reference and new thresholds.
    fn take_reference(&mut self, ideal: f64, t_reset_ns: i64) {
        self.reference = ideal;
        for (effect, streams) in self.chain.effects.iter().zip(&mut self.streams) {
            self.reference = effect.reference(
                self.site,
                &self.history,
                &mut streams.reference,
                self.reference,
                self.before,
            );
        }
        self.draw_thresholds(t_reset_ns);
    }

    fn draw_thresholds(&mut self, t_reset_ns: i64) {
        let pixel = &self.chain.pixel;
        let mut thresholds = Thresholds {
            on: pixel.threshold_on + self.threshold_offset,
            off: pixel.threshold_off + self.threshold_offset,
        };
        for ((effect, streams), offsets) in
            self.chain.effects.iter().zip(&mut self.streams).zip(&self.offsets)
        {
            if let Some(offsets) = offsets {
                thresholds.on += offsets.on;
                thresholds.off += offsets.off;
                continue;
            }
            effect.thresholds(self.site, &self.history, &mut streams.thresholds, t_reset_ns, &mut thresholds);
        }
        self.drawn = thresholds;
        self.thresholds = floored(thresholds);
        if self.waits {
            self.wait(t_reset_ns);
        }
    }

    /// Thresholds from `t_ns` on until they change next: constant over a short part of the time since the
    /// last event, as in its middle.
    fn wait(&mut self, t_ns: i64) {
        let last_ns = self.history.last_event.map(|last| last.t_in_ns);
        let length_ns = last_ns.map(|last_ns| {
            let part_ns = i64::max((t_ns - last_ns) / WAITING_PARTS, WAITING_LEAST_NS);
            let burst_ends_ns = last_ns + BURST_GAP_NS + 1 - t_ns;
            if burst_ends_ns > 0 { i64::min(part_ns, burst_ends_ns) } else { part_ns }
        });
        let mut thresholds = self.drawn;
        for effect in self.chain.effects {
            let middle_ns = t_ns + length_ns.unwrap_or(0) / 2;
            effect.waiting(self.site, &self.history, middle_ns, &mut thresholds);
        }
        self.thresholds = floored(thresholds);
        self.change_ns = length_ns.map_or(i64::MAX, |length_ns| t_ns + length_ns);
    }
}

fn floored(thresholds: Thresholds) -> Thresholds {
    Thresholds {
        on: f64::max(thresholds.on, THRESHOLD_FLOOR),
        off: f64::max(thresholds.off, THRESHOLD_FLOOR),
    }
}

/// Why a pixel fires.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Cause {
    Crossing,
    Spontaneous,
}
