//! By how much every event missed its threshold when the scene is given, and what each effect would change of
//! that.
//!
//! For an event of polarity p: e = V(t) - V_ref - p theta, with V the front end's answer to the pixel's light
//! and V_ref what the reset rule gives from the event before. Events stand where they were recorded, so
//! nothing needs to be matched; every effect is evaluated by its own hooks
//! ([`photocurrent_sensor::conditional`]). An effect of frames changes the light that frames imply:
//! `through_frames` takes it off.
//!
//! - [`photocurrent_scene`]: the scene, and which events count: those whose frames it predicts.
//! - `fit`: size and gain of each effect.
//! - `components`: random effects; `chance`: counted from what there is without them.
//! - `open`: what no effect of the catalogue has; `steps`: between which rows and columns; `formulas`: which
//!   formula it follows.
//! - `control`: what is found where nothing is.
//! - `located`: where the gain of an effect is.
//! - `separation`: which recording would separate two explanations.
//! - [`free`]: scenes of frames and events together: one moving picture, and the light of pixels free in
//!   time, where nothing moves as one.
//! - [`ranking`]: all of it on one scene; [`evidence`]: what comes of it.

mod axis;
mod chance;
mod components;
mod control;
pub mod evidence;
mod fit;
mod formulas;
pub mod free;
mod laid;
pub(crate) mod located;
pub(crate) mod open;
mod places;
mod prepared;
pub mod ranking;
pub(crate) mod separation;
mod setting;
mod steps;
mod table;
mod trials;

use crate::candidates::Trial;
use photocurrent_core::{Exposure, Timestamp};
use photocurrent_scene::case::Case;
use photocurrent_scene::light::LogLight;
use photocurrent_scene::nominal::Nominal;
use photocurrent_sensor::conditional::{Conditional, Look, Track, conditional, frame_values};
use photocurrent_sensor::effects::{Domain, Effect, Kernel, Reading, RowSite, Site};
use photocurrent_sensor::elementary::{exp, ln};
use photocurrent_sensor::forward::neighbours::stand_in;
use photocurrent_sensor::map::{MapFrame, PixelEvent};
use prepared::PreparedTrial;
use rayon::prelude::*;

/// Events of some pixels with their residuals, in order of pixel and time.
#[derive(Clone, Debug, Default)]
pub struct EventResiduals {
    /// The pixel of each event.
    pub pixel: Vec<u32>,
    /// Its number among the recording's events of that pixel.
    pub number: Vec<u32>,
    /// When it fired, ns.
    pub t_ns: Vec<i64>,
    /// +1 or -1.
    pub polarity: Vec<i8>,
    /// Polarity of the event before, +1 or -1.
    pub previous: Vec<i8>,
    /// Time since the event before, ns.
    pub since_ns: Vec<i64>,
    /// Voltage less reference less signed threshold, natural-log units.
    pub excess: Vec<f64>,
    /// How fast the voltage moves, ln/s.
    pub slope_per_s: Vec<f64>,
    /// And at the event before, from which the reference is.
    pub slope_before_per_s: Vec<f64>,
    /// Log photocurrent.
    pub log_light: Vec<f64>,
}

/// A trial's residual of each event.
#[derive(Clone, Debug, Default)]
pub struct TrialResiduals {
    /// Its residual, natural-log units.
    pub excess: Vec<f32>,
    /// How fast the voltage moves there, ln/s.
    pub slope_per_s: Vec<f32>,
}

/// Evaluated pixels, and the light of all pixels.
pub struct SampleView<'a> {
    /// The recording.
    pub case: &'a Case,
    /// The scene.
    pub light: &'a LogLight,
    /// Pixels, rising.
    pub pixels: Vec<u32>,
    /// Is the scene known independently of the frames? Otherwise it follows from them, and effects of frames
    /// change it.
    pub is_known: bool,
}

/// Frame values of some pixels, in order of pixel and time.
#[derive(Clone, Debug, Default)]
pub struct FrameValues {
    /// The pixel of each.
    pub pixel: Vec<u32>,
    /// Middle of its exposure, ns.
    pub t_ns: Vec<i64>,
    /// How bright it is recorded, DN above the black level.
    pub signal_dn: Vec<f64>,
    /// The logarithm of that, 0 below one DN.
    pub log_signal: Vec<f64>,
}

/// Pixels per task of a thread.
const CHUNK: usize = 16;

/// Events that are evaluated.
enum ChosenEvents<'a, K> {
    /// Armed ones, by the first trial, where this keeps them.
    By(&'a K),
    /// These.
    Before(&'a EventResiduals),
}

impl SampleView<'_> {
    /// Residuals of the armed events after the first of each pixel, and those of each trial.
    ///
    /// # Errors
    /// When a trial's effects are not understood or cannot be combined.
    pub fn residuals(
        &self,
        trials: &[Trial],
        keeps: impl Fn(usize, i64) -> bool + Sync,
    ) -> Result<(EventResiduals, Vec<TrialResiduals>), String> {
        let prepared = trials
            .iter()
            .map(|trial| PreparedTrial::new(self.case, trial))
            .collect::<Result<Vec<_>, String>>()?;
        let parts: Vec<(EventResiduals, Vec<TrialResiduals>)> = self
            .pixels
            .par_chunks(CHUNK)
            .map(|pixels| self.evaluate_block(pixels, &prepared, &ChosenEvents::By(&keeps)))
            .collect();
        let mut all = EventResiduals::default();
        let mut of_trials: Vec<TrialResiduals> = vec![TrialResiduals::default(); trials.len()];
        for (part, values) in parts {
            let EventResiduals {
                pixel,
                number,
                t_ns,
                polarity,
                previous,
                since_ns,
                excess,
                slope_per_s,
                slope_before_per_s,
                log_light,
            } = part;
            all.pixel.extend(pixel);
            all.number.extend(number);
            all.t_ns.extend(t_ns);
            all.polarity.extend(polarity);
            all.previous.extend(previous);
            all.since_ns.extend(since_ns);
            all.excess.extend(excess);
            all.slope_per_s.extend(slope_per_s);
            all.slope_before_per_s.extend(slope_before_per_s);
            all.log_light.extend(log_light);
            for (all, values) in of_trials.iter_mut().zip(values) {
                all.excess.extend(values.excess);
                all.slope_per_s.extend(values.slope_per_s);
            }
        }
        Ok((all, of_trials))
    }

    /// Residuals of each trial for events that were selected before.
    ///
    /// # Errors
    /// When a trial's effects are not understood or cannot be combined.
    pub fn evaluate_trials(
        &self,
        trials: &[Trial],
        events: &EventResiduals,
    ) -> Result<Vec<TrialResiduals>, String> {
        let prepared = trials
            .iter()
            .map(|trial| PreparedTrial::new(self.case, trial))
            .collect::<Result<Vec<_>, String>>()?;
        let chosen: ChosenEvents<'_, fn(usize, i64) -> bool> = ChosenEvents::Before(events);
        let parts: Vec<Vec<TrialResiduals>> = self
            .pixels
            .par_chunks(CHUNK)
            .map(|pixels| self.evaluate_block(pixels, &prepared, &chosen).1)
            .collect();
        let mut of_trials: Vec<TrialResiduals> = vec![TrialResiduals::default(); trials.len()];
        for part in parts {
            for (all, values) in of_trials.iter_mut().zip(part) {
                all.excess.extend(values.excess);
                all.slope_per_s.extend(values.slope_per_s);
            }
        }
        Ok(of_trials)
    }

    /// The frame values of the pixels, and for each trial what it leaves of them, DN: recorded less
    /// predicted. Saturated and unknown values are left out.
    ///
    /// # Errors
    /// When a trial's effects are not understood or cannot be combined.
    pub fn frames(&self, trials: &[Trial]) -> Result<(FrameValues, Vec<Vec<f32>>), String> {
        let prepared = trials
            .iter()
            .map(|trial| PreparedTrial::new(self.case, trial))
            .collect::<Result<Vec<_>, String>>()?;
        let instants: Vec<i64> = (0..self.light.count).map(|k| self.light.instant(k)).collect();
        let of_pixel = |&pixel: &u32| {
            let (mut values, mut left) = (FrameValues::default(), vec![Vec::new(); prepared.len()]);
            let log: Vec<f64> = self.light.log[pixel as usize].iter().map(|u| f64::from(*u)).collect();
            if log.is_empty() {
                return (values, left);
            }
            let track = Track::new(&instants, &log, self.light.step_ns);
            let frames = frames_of(self.case, &prepared[0].nominal, pixel as usize);
            let look = Look {
                site: self.case.site(pixel as usize, 0),
                track: &track,
                seen: None,
                events: &[],
                frames: &frames,
                quiet_ns: &[],
            };
            let counts: Vec<usize> = (0..frames.len()).filter(|&l| !frames[l].saturated).collect();
            values.pixel = vec![pixel; counts.len()];
            values.t_ns =
                counts.iter().map(|&l| i64::midpoint(frames[l].start_ns, frames[l].end_ns)).collect();
            values.signal_dn =
                counts.iter().map(|&l| frames[l].dn - prepared[0].nominal.number.black_level).collect();
            values.log_signal = values.signal_dn.iter().map(|signal| ln(signal.max(1.0))).collect();
            let mut out = Conditional::default();
            for (left, prepared) in left.iter_mut().zip(&prepared) {
                frame_values(&prepared.nominal, &prepared.effects, &look, &mut out);
                left.extend(counts.iter().map(|&l| (frames[l].dn - out.dn[l]) as f32));
            }
            (values, left)
        };
        let parts: Vec<(FrameValues, Vec<Vec<f32>>)> = self.pixels.par_iter().map(of_pixel).collect();
        let (mut all, mut of_trials) = (FrameValues::default(), vec![Vec::new(); trials.len()]);
        for (values, left) in parts {
            all.pixel.extend(values.pixel);
            all.t_ns.extend(values.t_ns);
            all.signal_dn.extend(values.signal_dn);
            all.log_signal.extend(values.log_signal);
            of_trials.iter_mut().zip(left).for_each(|(all, left)| all.extend(left));
        }
        Ok((all, of_trials))
    }

    fn evaluate_block(
        &self,
        pixels: &[u32],
        prepared: &[PreparedTrial],
        chosen: &ChosenEvents<'_, impl Fn(usize, i64) -> bool + Sync>,
    ) -> (EventResiduals, Vec<TrialResiduals>) {
        let (mut all, mut of_trials) =
            (EventResiduals::default(), vec![TrialResiduals::default(); prepared.len()]);
        let mut out = Conditional::default();
        let instants: Vec<i64> = (0..self.light.count).map(|k| self.light.instant(k)).collect();
        for &pixel in pixels {
            let pixel = pixel as usize;
            let log: Vec<f64> = self.light.log[pixel].iter().map(|u| f64::from(*u)).collect();
            if log.is_empty() {
                continue;
            }
            let site = self.case.site(pixel, 0);
            let events = events_of(self.case, pixel);
            let mut kept: Vec<usize> = Vec::new();
            if let ChosenEvents::Before(events) = chosen {
                let from = events.pixel.partition_point(|of| (*of as usize) < pixel);
                let to = events.pixel.partition_point(|of| (*of as usize) <= pixel);
                kept.extend(events.number[from..to].iter().map(|number| *number as usize));
                if kept.is_empty() {
                    continue;
                }
            }
            let mut plain: Option<Track> = None;
            let mut around = NeighbourCache::default();
            for (n, prepared) in prepared.iter().enumerate() {
                let seen = prepared
                    .kernel()
                    .map(|kernel| self.mixed_log_light(kernel, prepared, pixel, &instants, &mut around));
                let changed = if self.is_known {
                    None
                } else {
                    through_frames(self.case, prepared, &site, &instants, &log)
                };
                let track = match changed {
                    Some((t, log)) => &Track::new(&t, &log, self.light.step_ns),
                    None => &*plain.get_or_insert_with(|| Track::new(&instants, &log, self.light.step_ns)),
                };
                let seen = seen.filter(|seen| seen.len() == track.t_ns.len());
                let look =
                    Look { site, track, seen: seen.as_deref(), events: &events, frames: &[], quiet_ns: &[] };
                conditional(&prepared.nominal, &prepared.effects, &look, &mut out);
                if let (0, ChosenEvents::By(keeps)) = (n, chosen) {
                    kept = (1..events.len())
                        .filter(|&k| {
                            out.is_armed[k]
                                && out.is_armed[k - 1]
                                && keeps(pixel, events[k].t_in_ns)
                                && keeps(pixel, events[k - 1].t_in_ns)
                        })
                        .collect();
                    for &k in &kept {
                        self.push_pixel_events(&mut all, pixel, k, &events, &out, &log);
                    }
                }
                of_trials[n].excess.extend(kept.iter().map(|&k| out.excess[k] as f32));
                of_trials[n].slope_per_s.extend(kept.iter().map(|&k| out.slope_per_s[k] as f32));
            }
        }
        (all, of_trials)
    }

    fn push_pixel_events(
        &self,
        all: &mut EventResiduals,
        pixel: usize,
        k: usize,
        events: &[PixelEvent],
        out: &Conditional,
        log: &[f64],
    ) {
        let (event, before) = (&events[k], &events[k - 1]);
        all.pixel.push(pixel as u32);
        all.number.push(k as u32);
        all.t_ns.push(event.t_in_ns);
        all.polarity.push(event.polarity);
        all.previous.push(before.polarity);
        all.since_ns.push(event.t_in_ns - before.t_in_ns);
        all.excess.push(out.excess[k]);
        all.slope_per_s.push(out.slope_per_s[k]);
        all.slope_before_per_s.push(out.slope_per_s[k - 1]);
        let at = ((event.t_in_ns - self.light.start_ns) / self.light.step_ns).clamp(0, log.len() as i64 - 1)
            as usize;
        all.log_light.push(log[at]);
    }

    /// Log light that the event path sees where neighbours mix in, each as its frames imply it.
    fn mixed_log_light(
        &self,
        kernel: &Kernel,
        prepared: &PreparedTrial,
        pixel: usize,
        instants: &[i64],
        around: &mut NeighbourCache,
    ) -> Vec<f64> {
        let (x, y) = self.case.pixel_place(pixel);
        let (width, height) = (self.case.extent.width as usize, self.case.extent.height as usize);
        let is_linear = kernel.domain == Domain::Linear;
        let taps: Vec<(usize, Option<Vec<f64>>)> = kernel
            .taps
            .iter()
            .map(|tap| {
                let neighbour =
                    stand_in(y as usize, tap.dy, height) * width + stand_in(x as usize, tap.dx, width);
                let neighbour = if self.light.log[neighbour].is_empty() { pixel } else { neighbour };
                let at = around.find(neighbour, &self.light.log[neighbour]);
                let site = self.case.site(neighbour, 0);
                let log = &around.seen[at].log;
                let changed = if self.is_known {
                    None
                } else {
                    through_frames(self.case, prepared, &site, instants, log)
                };
                (at, changed.map(|(_, log)| log))
            })
            .collect();
        let is_plain = taps.iter().all(|(_, changed)| changed.is_none());
        if let Some((_, mixed)) = around.mixed.as_ref().filter(|(of, _)| is_plain && of == kernel) {
            return mixed.clone();
        }
        let mut sum = vec![0.0; self.light.count];
        for (tap, (at, changed)) in kernel.taps.iter().zip(&taps) {
            let values = match changed {
                Some(log) if is_linear => &log.iter().map(|u| exp(*u)).collect(),
                Some(log) => log,
                None => around.seen[*at].log_light(is_linear),
            };
            sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += tap.weight * value);
        }
        if is_linear {
            sum.iter_mut().for_each(|sum| *sum = ln(f64::max(*sum, f64::MIN_POSITIVE)));
        }
        if is_plain {
            around.mixed = Some((kernel.clone(), sum.clone()));
        }
        sum
    }
}

/// The events of a pixel, with stamps as recorded.
fn events_of(case: &Case, pixel: usize) -> Vec<PixelEvent> {
    let event = |event: &PixelEvent| PixelEvent { t_off_ns: event.t_off_ns.max(event.t_in_ns), ..*event };
    case.events.of_pixel(pixel).iter().map(event).collect()
}

/// The known frame values of a pixel; their noise does not enter a residual.
fn frames_of(case: &Case, nominal: &Nominal, pixel: usize) -> Vec<MapFrame> {
    let (_, y) = case.pixel_place(pixel);
    let frame = |l: usize| -> Option<MapFrame> {
        let (dn, exposure) = (case.dn(l, pixel), case.frames.as_ref()?.times.exposure(l, y));
        let (start_ns, end_ns) = (exposure.start.0, exposure.end.0);
        dn.is_finite().then_some(MapFrame {
            start_ns,
            end_ns,
            dn,
            sigma_dn: 1.0,
            saturated: dn >= nominal.saturation_dn,
        })
    };
    (0..case.frame_count()).filter_map(frame).collect()
}

/// The median; 0 of nothing.
fn median_of(values: &mut [f64]) -> f64 {
    if values.is_empty() { 0.0 } else { photocurrent_scene::statistics::median(values) }
}

/// Light of a pixel's neighbours, kept from trial to trial.
#[derive(Default)]
struct NeighbourCache {
    seen: Vec<NeighbourLight>,
    /// The last mixture of light that no effect of frames changes.
    mixed: Option<(Kernel, Vec<f64>)>,
}

struct NeighbourLight {
    pixel: usize,
    log: Vec<f64>,
    light: Vec<f64>,
}

impl NeighbourCache {
    fn find(&mut self, pixel: usize, log: &[f32]) -> usize {
        self.seen.iter().position(|one| one.pixel == pixel).unwrap_or_else(|| {
            self.seen.push(NeighbourLight {
                pixel,
                log: log.iter().map(|u| f64::from(*u)).collect(),
                light: Vec::new(),
            });
            self.seen.len() - 1
        })
    }
}

impl NeighbourLight {
    fn log_light(&mut self, is_linear: bool) -> &Vec<f64> {
        if !is_linear {
            return &self.log;
        }
        if self.light.is_empty() {
            self.light = self.log.iter().map(|u| exp(*u)).collect();
        }
        &self.light
    }
}

/// Light that frames imply through effects: instants and log light; `None` where no effect changes frames.
///
/// The scene was fitted to frames as the description exposes and reads them. Through effects the same DN at
/// the same stated exposure is light of another instant and size. Exposures overlap as the mean of a moving
/// scene, so both are evaluated at the middle of an exposure.
fn through_frames(
    case: &Case,
    prepared: &PreparedTrial,
    site: &Site,
    instants: &[i64],
    log: &[f64],
) -> Option<(Vec<i64>, Vec<f64>)> {
    let frames = case.frames.as_ref()?;
    let nominal = &prepared.nominal;
    let effects: &[Box<dyn Effect>] = &prepared.effects;
    let exposure_ns = frames.times.nominal_exposure_ns()?.max(1);
    let period_ns = frames.times.mean_period_ns().map_or(exposure_ns, |period| period as i64);
    let row = RowSite { y: site.y, height: site.height, frame: 1, row_time_ns: nominal.row_time_ns };
    let stated =
        Exposure { start: Timestamp(-exposure_ns / 2), end: Timestamp(exposure_ns - exposure_ns / 2) };
    let exposed = effects.iter().fold(stated, |exposure, effect| effect.exposure(&row, exposure));
    let shift_ns =
        i64::midpoint(exposed.start.0, exposed.end.0) - i64::midpoint(stated.start.0, stated.end.0);
    let (seconds, real_s) =
        (exposure_ns as f64 * 1e-9, f64::max((exposed.end.0 - exposed.start.0) as f64 * 1e-9, 1e-9));
    let number = nominal.number;
    let through = |charge: f64, previous_charge: f64| {
        let reading = Reading {
            frame: 1,
            previous_charge,
            gain: number.gain,
            black_level: number.black_level,
            saturation: nominal.saturation_dn,
        };
        let read = effects.iter().fold(charge, |charge, effect| effect.charge(site, &reading, charge));
        effects.iter().fold(number.of(read), |dn, effect| effect.dn(site, &reading, dn))
    };
    let some = exp(log[log.len() / 2]) * seconds;
    let probes = [(some, some), (2.0 * some, some), (some, 3.0 * some)]
        .map(|(charge, before)| through(charge, before) - number.of(charge));
    let touches = probes.iter().any(|change| change.abs() > 1e-9 * number.of(some).abs());
    if !touches && exposed == stated {
        return None;
    }
    // Log light that reads the same as one of log light `u`, `before` the frame before.
    let implied = |u: f64, before: f64| {
        let charge = exp(u) * seconds;
        let (target, before) = (number.of(charge), before * seconds);
        // A few secant steps: effects of frames are smooth and near the identity.
        let (mut a, mut b) = (charge, charge * 1.05);
        let mut fa = through(a, before) - target;
        for _ in 0..4 {
            let fb = through(b, before) - target;
            if (fb - fa).abs() < 1e-12 || fb.abs() < 1e-9 * target.abs() {
                break;
            }
            let next = b - fb * (b - a) / (fb - fa);
            (a, fa, b) = (b, fb, if next.is_finite() { next.clamp(0.02 * charge, 50.0 * charge) } else { b });
        }
        ln(b / real_s)
    };
    let found = if !touches {
        let longer = ln(real_s / seconds);
        log.iter().map(|u| u - longer).collect()
    } else if probes[0] == probes[2] {
        tabulated(log, |u| implied(u, 0.0))
    } else {
        let step_ns = instants.get(1).map_or(1, |next| next - instants[0]);
        let back = (period_ns / step_ns.max(1)) as usize;
        (0..log.len()).map(|k| implied(log[k], exp(log[k.saturating_sub(back)]))).collect()
    };
    Some((instants.iter().map(|t| t + shift_ns).collect(), found))
}

/// A smooth function of many values by linear interpolation between few: steps of a fiftieth, errors of a
/// twenty-thousandth of its curvature.
fn tabulated(values: &[f64], of: impl Fn(f64) -> f64) -> Vec<f64> {
    const STEP: f64 = 0.02;
    let (low, high) = values
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), u| (f64::min(low, *u), f64::max(high, *u)));
    let count = ((high - low) / STEP) as usize + 2;
    if count >= values.len() {
        return values.iter().map(|u| of(*u)).collect();
    }
    let table: Vec<f64> = (0..count).map(|k| of(low + STEP * k as f64)).collect();
    let at = |u: f64| {
        let place = (u - low) / STEP;
        let k = (place as usize).min(count - 2);
        table[k] + (table[k + 1] - table[k]) * (place - k as f64)
    };
    values.iter().map(|u| at(*u)).collect()
}

#[cfg(test)]
mod scene_tests;
#[cfg(test)]
mod target_tests;
