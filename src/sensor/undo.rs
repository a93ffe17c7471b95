//! What effects did to the measurements of a pixel, undone, so that the stated sensor explains what is left.
//!
//! Every effect is asked by its own hooks, the ones the simulator asks: nothing here knows any effect.
//!
//! - Stamps: `recorded = stamp(true)` is solved to first order.
//! - Frames: charge and digital number are monotone in the light, so the charge behind a value is found by
//!   secants, frame after frame with the charge of the one before; exposures are those of the effect.
//! - A photocurrent that is added to the event path (a dark current) makes it see the sum: that is then what
//!   is solved for, without any approximation ([`Undo::added`]).
//! - All that acts between light and comparator: given a first estimate of the light, a slower front end is a
//!   delay of its events, and the effects say by how much more or less than its threshold each event's step
//!   is than the stated sensor would have it ([`crate::conditional`]); that is given to the solver as known
//!   ([`crate::map::MapProblem::beyond`]) and the light is solved again (defect correction; Stetter,
//!   Numerische Mathematik 29, 1978).
//!
//! What is drawn cannot be undone: measurements are trusted that much less ([`Chance`]).
//!
//! - Waits that depend on the load of the array: the recorded events of all pixels are the load
//!   ([`Undo::inform`]); before it is given, such effects stand in [`Undo::left_out`].
//!
//! - Photocurrent that neighbours mix in ([`crate::mixing`]): the voltage of the stated sensor follows the
//!   pixel's own estimate, that of the actual one what the event pixel sees of the estimates of all
//!   ([`Estimate::seen`]). Each round multiplies what is wrong by what the kernel takes from the pixel
//!   itself, so a strong mixture of fine detail needs more rounds.
//!
//! Limits: effects of which everything is drawn, and kernels that act before and behind the logarithm at
//! once, are left out and named in [`Undo::left_out`]; events that were lost are missing in the load; an
//! event that a sudden impulse fires passed its threshold by an unknown part of the impulse, and is taken as
//! if it had met it.

use crate::conditional::{Conditional, Look, Track, at, conditional};
use crate::effects::{ArrayEvent, Chance, Effect, FrontEndModel, PixelEvent, Reading, RowSite, Site};
use crate::elementary::{exp, ln};
use crate::forward::neighbours::TwoDomains;
use crate::map::MapFrame;
use crate::mixing::Mixing;
use crate::model::Model;
use multiversion::multiversion;
use photocurrent_core::Exposure;
use photocurrent_core::random::Random;

/// The longest step of light, ns.
const STEP_NS: i64 = 500_000;
/// Steps are known to be further from their thresholds than this only where the first estimate is no use,
/// natural-log units.
const FURTHEST: f64 = 1.0;
/// A pixel's own photocurrent is no less than this share of what effects add to it.
const DARKEST: f64 = 1e-3;
/// Secants for a charge, and how near they come, as a share.
const SECANTS: usize = 12;
const NEAR: f64 = 1e-10;

/// A set of effects to be undone.
pub struct Undo {
    effects: Vec<Box<dyn Effect>>,
    /// Effects that need the load of the array before they say anything.
    coupled: Vec<Box<dyn Effect>>,
    mixing: Option<Mixing>,
    /// What effects add to the photocurrent of the event path.
    added: f64,
    /// Standard deviations that chance adds; `known` is empty.
    pub chance: Chance,
    /// Ids of effects about which nothing is done.
    pub left_out: Vec<&'static str>,
}

/// A frame value without effects.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Undone {
    /// When the row was really exposed.
    exposure: Exposure,
    /// What the stated sensor would have read, DN.
    dn: f64,
    /// How much that changes with the recorded value.
    per_dn: f64,
    /// Photocurrent times seconds.
    charge: f64,
}

/// An estimate of a pixel's log photocurrent at rising instants, linear between.
#[derive(Clone, Copy, Debug)]
pub struct Estimate<'a> {
    /// The instants, ns.
    pub t_ns: &'a [i64],
    /// Its own.
    pub own: &'a [f64],
    /// What its event pixel sees where neighbours mix in; none = its own.
    pub seen: Option<&'a [f64]>,
}

/// What is known of a pixel's events once its light is known, about.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Known {
    /// The events as the stated front end would have fired them.
    pub events: Vec<PixelEvent>,
    /// By how much each step is beyond its threshold ([`crate::map::MapProblem::beyond`]); empty = nothing.
    pub beyond: Vec<f64>,
    /// Standard deviation over time of the pixel's own log photocurrent around what its event pixel sees,
    /// where neighbours mix in: without an event, the one may have moved so much further than the other.
    pub apart: f64,
}

/// Memory that is kept from pixel to pixel.
#[derive(Default)]
pub struct Memory {
    with: Conditional,
    without: Conditional,
}

/// What is left of the log of a sum without what was added, above 0.
#[inline(always)]
fn own(added: f64, log_sum: f64) -> f64 {
    let (left, least) = (exp(log_sum) - added, DARKEST * added);
    ln(if left > least { left } else { least })
}

/// Replaces the log of each sum by [`own`].
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
fn all_own(added: f64, logs: &mut [f64]) {
    for log in logs {
        *log = own(added, *log);
    }
}

/// The log photocurrent of a pixel's own and what is added to it.
pub fn sum(added: f64, log_own: f64) -> f64 {
    if added == 0.0 { log_own } else { libm::log(exp(log_own) + added) }
}

impl Undo {
    /// Of the effects of a description ([`crate::effects::from_description`]).
    pub fn new(effects: Vec<Box<dyn Effect>>) -> Undo {
        let mut undo = Undo {
            effects: Vec::new(),
            coupled: Vec::new(),
            mixing: None,
            added: 0.0,
            chance: Chance::default(),
            left_out: Vec::new(),
        };
        let mut mixing: Vec<Box<dyn Effect>> = Vec::new();
        let add = |sum: &mut f64, sigma: f64| *sum = libm::hypot(*sum, sigma);
        for effect in effects {
            undo.added += effect.added_photocurrent();
            if effect.kernel().is_some() {
                mixing.push(effect);
                continue;
            }
            if effect.informed(&[]).is_some() {
                undo.left_out.push(effect.id());
                undo.coupled.push(effect);
                continue;
            }
            let Some(Chance { of_pixels, of_events, of_stamps_s, of_frames, known }) = effect.chance() else {
                undo.effects.push(effect);
                continue;
            };
            if known.is_none()
                && [of_pixels, of_events, of_stamps_s, of_frames].iter().all(|sigma| *sigma == 0.0)
            {
                undo.left_out.push(effect.id());
            }
            add(&mut undo.chance.of_pixels, of_pixels);
            add(&mut undo.chance.of_events, of_events);
            add(&mut undo.chance.of_stamps_s, of_stamps_s);
            add(&mut undo.chance.of_frames, of_frames);
            undo.effects.extend(known);
        }
        match Mixing::new(&mixing) {
            Ok(joined) => undo.mixing = joined,
            Err(TwoDomains) => undo.left_out.extend(mixing.iter().map(|effect| effect.id())),
        }
        // Ahead of the others, as in the chain: what else they do is asked like any other effect.
        mixing.append(&mut undo.effects);
        undo.effects = mixing;
        undo
    }

    /// How the photocurrent of neighbours is mixed where the effects do so; whoever solves gives it to
    /// [`Undo::at_light`], or it is ignored.
    pub fn mixing(&self) -> Option<&Mixing> {
        self.mixing.as_ref()
    }

    /// The id of an effect that needs [`Undo::inform`], if there is one.
    pub fn couples(&self) -> Option<&'static str> {
        self.coupled.first().map(|effect| effect.id())
    }

    /// Gives effects that depend on the load the events of the whole array, as recorded and in any order;
    /// from then on they are undone as well. Does nothing the second time.
    pub fn inform(&mut self, recorded: impl Iterator<Item = (Site, PixelEvent)>) {
        if self.coupled.is_empty() {
            return;
        }
        let of = |(site, event): (Site, PixelEvent)| ArrayEvent {
            x: site.x,
            y: site.y,
            event: self.event(&site, &event),
        };
        let mut load: Vec<ArrayEvent> = recorded.map(of).collect();
        load.sort_unstable_by_key(|asked| (asked.event.t_off_ns, asked.event.t_in_ns, asked.y, asked.x));
        for effect in std::mem::take(&mut self.coupled) {
            self.left_out.retain(|id| *id != effect.id());
            self.effects.push(effect.informed(&load).unwrap_or(effect));
        }
    }

    /// The effects that are undone: their known parts.
    pub fn known(&self) -> &[Box<dyn Effect>] {
        &self.effects
    }

    /// Is there nothing to undo?
    pub fn is_none(&self) -> bool {
        self.effects.is_empty()
    }

    /// Is there anything to undo that an estimate of the light must be known for ([`Undo::at_light`])?
    pub fn needs_light(&self) -> bool {
        self.effects.iter().any(|effect| effect.added_photocurrent() == 0.0)
    }

    /// What effects add to the photocurrent of the event path, at least 0. Problems are posed in the sum: the
    /// frame values with it added ([`Undo::raise`]), the solution without it again ([`Undo::own`]).
    pub fn added(&self) -> f64 {
        self.added
    }

    /// Adds to a frame value what the added photocurrent would have read in its exposure.
    pub fn raise(&self, model: &Model, frame: &mut MapFrame) {
        frame.dn += model.number.gain * self.added * ((frame.end_ns - frame.start_ns) as f64 * 1e-9);
    }

    /// The pixel's own log photocurrent, that of the sum given; where the sum is no more than what was added,
    /// that of a small share of it ([`DARKEST`]).
    pub fn own(&self, log_sum: f64) -> f64 {
        if self.added == 0.0 { log_sum } else { own(self.added, log_sum) }
    }

    /// [`Undo::own`] of each.
    pub fn own_of(&self, log_sum: &[f64], log_own: &mut Vec<f64>) {
        log_own.clear();
        log_own.extend_from_slice(log_sum);
        if self.added != 0.0 {
            all_own(self.added, log_own);
        }
    }

    /// The log photocurrent of the sum, the pixel's own given.
    pub fn sum(&self, log_own: f64) -> f64 {
        sum(self.added, log_own)
    }

    /// When an event really fired and left, its recorded stamps given.
    pub fn event(&self, site: &Site, event: &PixelEvent) -> PixelEvent {
        let mut random = Random::new(0, &[]);
        let mut recorded = *event;
        for effect in &self.effects {
            effect.stamp(site, &mut random, &mut recorded);
        }
        let t_in_ns = 2 * event.t_in_ns - recorded.t_in_ns;
        let hidden_ns: i64 =
            self.effects.iter().map(|effect| effect.latency(site, &mut random, t_in_ns).hidden_ns).sum();
        PixelEvent {
            t_in_ns,
            t_off_ns: i64::max(2 * event.t_off_ns - recorded.t_off_ns + hidden_ns, t_in_ns),
            ..*event
        }
    }

    /// A value of frame number `frame`, whose stated exposure is given; `before` is the charge of the last
    /// frame, and whether another one is missing in between: the missing one is taken as half of each side.
    fn frame(
        &self,
        model: &Model,
        site: &Site,
        frame: usize,
        stated: Exposure,
        dn: f64,
        before: (f64, bool),
    ) -> Undone {
        let row = RowSite { y: site.y, height: site.height, frame, row_time_ns: model.row_time_ns };
        let exposure = self.effects.iter().fold(stated, |exposure, effect| effect.exposure(&row, exposure));
        let number = model.number;
        let through = |charge: f64| {
            let previous_charge = if before.1 { 0.5 * (before.0 + charge) } else { before.0 };
            let reading = Reading {
                frame,
                previous_charge,
                gain: number.gain,
                black_level: number.black_level,
                saturation: model.saturation_dn,
            };
            let charge =
                self.effects.iter().fold(charge, |charge, effect| effect.charge(site, &reading, charge));
            self.effects.iter().fold(number.of(charge), |dn, effect| effect.dn(site, &reading, dn))
        };
        // The stated sensor's own charge, and one a little more.
        let unit = f64::max((dn - number.black_level).abs(), 1.0) / number.gain;
        let (mut a, mut b) =
            ((dn - number.black_level) / number.gain, (dn - number.black_level) / number.gain + 0.05 * unit);
        let (mut fa, mut fb) = (through(a) - dn, through(b) - dn);
        for _ in 0..SECANTS {
            let next = b - fb * (b - a) / (fb - fa);
            if !next.is_finite() || (next - b).abs() <= NEAR * unit {
                break;
            }
            (a, fa) = (b, fb);
            b = next.clamp(b - 2.0 * unit, b + 2.0 * unit);
            fb = through(b) - dn;
        }
        // Beyond what the effects can read, nothing is better than the value itself.
        let charge = if fb.is_finite() && fb.abs() <= 1e-6 * f64::max(dn.abs(), 1.0) {
            b
        } else {
            (dn - number.black_level) / number.gain
        };
        let step = 1e-3 * unit;
        let slope = (through(charge + step) - through(charge - step)) / (2.0 * step * number.gain);
        Undone {
            exposure,
            dn: number.of(charge),
            per_dn: if slope > 1e-3 { 1.0 / slope } else { 1.0 },
            charge,
        }
    }

    /// The frame values of a pixel without effects, in order of time; a frame that is missing between two is
    /// taken as half of each side. Exposures that effects make longer end where they end and begin where the
    /// one before ends.
    pub fn frames(&self, model: &Model, site: &Site, frames: &mut Vec<MapFrame>) {
        if self.is_none() {
            return;
        }
        let shortest_ns =
            frames.windows(2).map(|pair| pair[1].start_ns - pair[0].start_ns).min().unwrap_or(0);
        let (mut previous_charge, mut begun_ns, mut over_ns) = (0.0, i64::MIN, i64::MIN);
        for (l, frame) in frames.iter_mut().enumerate() {
            let stated = Exposure::new(frame.start_ns, frame.end_ns);
            let is_missing = l > 0 && 2 * (frame.start_ns - begun_ns) > 3 * shortest_ns;
            begun_ns = frame.start_ns;
            let undone = self.frame(model, site, l, stated, frame.dn, (previous_charge, is_missing));
            previous_charge = undone.charge;
            let (start_ns, end_ns) = (i64::max(undone.exposure.start.0, over_ns), undone.exposure.end.0);
            over_ns = end_ns;
            *frame = MapFrame {
                start_ns,
                end_ns,
                dn: undone.dn,
                sigma_dn: frame.sigma_dn * undone.per_dn,
                ..*frame
            };
        }
        frames.retain(|frame| frame.start_ns < frame.end_ns);
    }

    /// What the effects say of the events at an estimate of the light, what effects add to it included: when
    /// the stated front end would have fired them, which is earlier where theirs is slower, and by how much
    /// each step is then beyond its threshold.
    ///
    /// `recorded` are the events with their stamps as recorded, `events` the same without effects
    /// ([`Undo::event`]); the new ones are in `known`.
    pub fn at_light(
        &self,
        model: &Model,
        site: &Site,
        light: Estimate<'_>,
        recorded: &[PixelEvent],
        events: &[PixelEvent],
        known: &mut Known,
        memory: &mut Memory,
    ) {
        known.beyond.clear();
        known.events.clear();
        known.events.extend_from_slice(events);
        let Estimate { t_ns, own, seen } = light;
        known.apart = seen.map_or(0.0, |seen| apart(own, seen));
        if events.is_empty() || t_ns.is_empty() {
            return;
        }
        let mut front_end = FrontEndModel::plain(model.pixel.front_end);
        self.effects.iter().for_each(|effect| effect.front_end(site, &mut front_end));
        let stated = model.pixel.front_end;
        let mut before_ns = i64::MIN;
        for event in &mut known.events {
            let per_light = exp(-at(t_ns, own, event.t_in_ns));
            let per_seen = seen.map_or(per_light, |seen| exp(-at(t_ns, seen, event.t_in_ns)));
            let (first, second) = (front_end.low_pass, front_end.second_pole);
            let slower_s = first.tau_0_s - stated.tau_0_s
                + (first.alpha_s - stated.alpha_s) * per_light
                + first.alpha_s * (per_seen - per_light)
                + second.map_or(0.0, |pole| pole.tau_s + pole.tau_light_s * per_seen);
            let slower_ns = (slower_s * 1e9).round() as i64;
            // In the order in which they came.
            let moved_ns = i64::max(event.t_in_ns - slower_ns, before_ns);
            event.t_off_ns += moved_ns - event.t_in_ns;
            event.t_in_ns = moved_ns;
            before_ns = moved_ns + 1;
        }
        let track = Track::new(t_ns, own, STEP_NS);
        // To the event path, what it sees is the light. Effects that add to it are among those that are
        // asked.
        let without_added: Vec<f64> = if self.added > 0.0 {
            seen.unwrap_or(own).iter().map(|log| self.own(*log)).collect()
        } else {
            Vec::new()
        };
        let light = if self.added > 0.0 { Some(without_added.as_slice()) } else { seen };
        let mixed = light.map(|light| Track::new(t_ns, light, STEP_NS));
        let Memory { with, without } = memory;
        let look = Look {
            site: *site,
            track: mixed.as_ref().unwrap_or(&track),
            seen: None,
            events: recorded,
            frames: &[],
            quiet_ns: &[],
        };
        conditional(model, &self.effects, &look, with);
        conditional(model, &[], &Look { track: &track, events: &known.events, ..look }, without);
        known.beyond.extend((0..events.len()).map(|k| {
            let by = without.excess[k] - with.excess[k];
            if with.is_armed[k] && without.is_armed[k] && by.abs() < FURTHEST { by } else { 0.0 }
        }));
    }
}

/// Standard deviation of the differences.
fn apart(own: &[f64], seen: &[f64]) -> f64 {
    let count = own.len() as f64;
    let mean = own.iter().zip(seen).map(|(own, seen)| own - seen).sum::<f64>() / count;
    let square =
        own.iter().zip(seen).map(|(own, seen)| (own - seen - mean) * (own - seen - mean)).sum::<f64>();
    libm::sqrt(square / count)
}

#[cfg(test)]
#[path = "undo_tests.rs"]
mod tests;
