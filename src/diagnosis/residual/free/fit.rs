//! Predicts events and frames of light through a sensor, and runs rounds of the light's estimate.

use super::super::prepared::PreparedTrial;
use super::super::{NeighbourCache, SampleView, events_of, frames_of, median_of};
use super::own::PixelThresholds;
use crate::candidates::{CANDIDATES, EffectScales, Trial};
use photocurrent_scene::case::Case;
use photocurrent_scene::free::{FreeScene, PixelPrediction, PredictedEvent, PredictedFrame};
use photocurrent_scene::light::LogLight;
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::statistics::MEDIAN_NORMAL;
use photocurrent_sensor::conditional::{Conditional, Look, Quiet, Track, conditional, frame_values};
use photocurrent_sensor::map::{MapFrame, PixelEvent};
use rayon::prelude::*;
use std::sync::Arc;

/// Step of the predicted light, ns; and its number of steps per knot.
pub(super) const STEP_NS: i64 = 100_000;
/// Events this soon after the begin have no reference that is known, ns.
const SETTLING_NS: i64 = 2_000_000;
/// Between events the voltage is held below its threshold this often, ns; and below that of the next event
/// only so long before it.
const QUIET_NS: i64 = 500_000;
const SOON_NS: i64 = 1_000_000;
/// Largest distance to a threshold, as a share of it, at which an instant without an event is used.
const NEAR: f64 = 0.2;
/// Noise is a share of thresholds, which are at least this share of the stated ones.
const LEAST_THRESHOLD: f64 = 0.1;
/// Standard errors that are subtracted from a gain: a convention; the decision is calibrated on the rest.
pub(super) const BY_CHANCE: f64 = 2.0;

/// Data that all fits share: pixels, events and settings.
pub(super) struct FitData<'a, L> {
    pub case: &'a Case,
    pub nominal: &'a Nominal,
    pub scales: &'a EffectScales,
    /// Indices of the evaluated events of each estimated pixel.
    pub events: Vec<Vec<usize>>,
    /// And of its frames, with about how bright each is, DN above black.
    frames: Vec<Vec<(usize, f64)>>,
    /// Of each pixel the instants without an event.
    quiet: Vec<Vec<QuietInstant>>,
    /// Steps of the scene between corrections of a size.
    pub steps: usize,
    begin: L,
}

/// An instant at which a pixel has no event.
#[derive(Clone, Copy, Debug)]
struct QuietInstant {
    t_ns: i64,
    /// The event before it.
    after: usize,
    /// Polarity of an event that follows so soon that its own voltage is the closer bound; 0: none.
    before: i8,
}

/// Predicted measurements of a pixel, in the order of [`FitData`].
#[derive(Clone, Debug, Default)]
pub(super) struct PixelRows {
    pub excess: Vec<f64>,
    /// In the direction of the event, ln/s.
    pub slope_per_s: Vec<f64>,
    pub dn: Vec<f64>,
    /// Excess of the voltage over the ON threshold, and over the OFF threshold, at instants without an event,
    /// natural-log units; minus infinity while the pixel is held.
    pub quiet: Vec<[f64; 2]>,
}

impl<'a, L: FreeScene> FitData<'a, L> {
    /// From an initial scene. `keeps`: may an event of a pixel at an instant be evaluated? `with_quiet`: are
    /// instants without an event used?
    pub(super) fn new(
        case: &'a Case,
        nominal: &'a Nominal,
        scales: &'a EffectScales,
        begin: L,
        keeps: impl Fn(usize, i64) -> bool + Sync,
        (steps, with_quiet): (usize, bool),
    ) -> Result<FitData<'a, L>, String> {
        let (events, frames, quiet) = (Vec::new(), Vec::new(), Vec::new());
        let mut ground = FitData { case, nominal, scales, events, frames, quiet, steps, begin };
        let stated = PreparedTrial::new(case, &Trial::nominal(nominal))?;
        let light = ground.begin.light(case);
        let pixels = ground.begin.pixels().to_vec();
        let view = SampleView { case, light: &light, pixels: Vec::new(), is_known: true };
        let end_ns = case.span.1 - 3 * STEP_NS;
        let instants: Vec<i64> = (0..light.count).map(|k| light.instant(k)).collect();
        let counted = |pixel: &u32| -> (Vec<usize>, Vec<usize>) {
            let pixel = *pixel as usize;
            let frames = frames_of(case, nominal, pixel);
            let mut through = PixelResponse::new(&view, &instants, pixel, frames.clone(), Vec::new());
            let out = through.evaluate(&stated);
            let events = case.events.of_pixel(pixel);
            let counts = |k: &usize| {
                out.is_armed[*k]
                    && out.is_armed[k - 1]
                    && events[k - 1].t_in_ns > case.span.0 + SETTLING_NS
                    && events[*k].t_in_ns < end_ns
                    && keeps(pixel, events[*k].t_in_ns)
                    && keeps(pixel, events[k - 1].t_in_ns)
            };
            let is_within = |l: &usize| {
                !frames[*l].saturated
                    && frames[*l].start_ns >= case.span.0
                    && frames[*l].end_ns <= case.span.1
            };
            ((1..events.len()).filter(counts).collect(), (0..frames.len()).filter(is_within).collect())
        };
        let counted: Vec<(Vec<usize>, Vec<usize>)> = pixels.par_iter().map(counted).collect();
        let signals = ground.signals(&pixels);
        for (place, (events, frames)) in counted.into_iter().enumerate() {
            ground.events.push(events);
            ground.frames.push(frames.into_iter().map(|l| (l, signals[place][l])).collect());
            let quiet =
                if with_quiet { quiet_instants(case, nominal, pixels[place] as usize) } else { Vec::new() };
            ground.quiet.push(quiet);
        }
        Ok(ground)
    }

    /// Mean frame values of 5 x 5 pixels around each, DN above black, for every known frame value.
    fn signals(&self, pixels: &[u32]) -> Vec<Vec<f64>> {
        const AROUND: i64 = 2;
        let (width, height) = (i64::from(self.case.extent.width), i64::from(self.case.extent.height));
        let of = |pixel: &u32| -> Vec<f64> {
            let (x, y) = (i64::from(*pixel) % width, i64::from(*pixel) / width);
            let known =
                (0..self.case.frame_count()).filter(|l| self.case.dn(*l, *pixel as usize).is_finite());
            known
                .map(|l| {
                    let (mut sum, mut count) = (0.0, 0.0);
                    for ny in (y - AROUND).max(0)..=(y + AROUND).min(height - 1) {
                        for nx in (x - AROUND).max(0)..=(x + AROUND).min(width - 1) {
                            let dn = self.case.dn(l, (ny * width + nx) as usize);
                            if dn.is_finite() {
                                (sum, count) = (sum + dn, count + 1.0);
                            }
                        }
                    }
                    f64::max(sum / count - self.nominal.number.black_level, 1.0)
                })
                .collect()
        };
        pixels.par_iter().map(of).collect()
    }

    /// Does a pixel, by its place, have enough events?
    pub(super) fn has_events(&self, place: usize) -> bool {
        self.events[place].len() >= L::FEWEST_EVENTS
    }

    /// Are gains measured on its events?
    pub(super) fn is_measured(&self, place: usize) -> bool {
        self.has_events(place) && self.begin.is_measured(place)
    }

    /// Number of events that gains are measured on.
    pub(super) fn events(&self) -> usize {
        self.count(|place| self.is_measured(place))
    }

    /// Number of events that scores are of.
    pub(super) fn scored_events(&self) -> usize {
        self.count(|place| self.has_events(place) && self.begin.takes_part(place))
    }

    fn count(&self, is: impl Fn(usize) -> bool) -> usize {
        (0..self.events.len()).filter(|place| is(*place)).map(|place| self.events[place].len()).sum()
    }

    /// Noise of thresholds that the description states, as a share of them.
    pub(super) fn stated_noise(&self) -> f64 {
        self.nominal.threshold_noise / self.scales.threshold
    }

    /// Part of a median misfit, as a share of a threshold, above the stated threshold noise.
    pub(super) fn beyond_stated(&self, left: f64) -> f64 {
        let stated = MEDIAN_NORMAL * self.stated_noise();
        libm::sqrt(f64::max(left * left - stated * stated, 0.0))
    }

    /// Median slope of the voltage at events, ln/s.
    pub(super) fn slope_per_s(&self, fit: &SceneFit<'_, L>) -> Result<f64, String> {
        let rows = fit.rows(&[fit.prepared(&fit.trial)?], &fit.prediction()?.light);
        let mut slopes: Vec<f64> =
            rows.iter().flatten().flat_map(|of| of.slope_per_s.iter().map(|slope| slope.abs())).collect();
        Ok(median_of(&mut slopes))
    }
}

/// A pixel of a view, ready to be seen through one sensor after another.
struct PixelResponse<'a> {
    view: &'a SampleView<'a>,
    instants: &'a [i64],
    pixel: usize,
    track: Track,
    events: Vec<PixelEvent>,
    frames: Vec<MapFrame>,
    quiet_ns: Vec<i64>,
    around: NeighbourCache,
    out: Conditional,
}

impl<'a> PixelResponse<'a> {
    fn new(
        view: &'a SampleView<'a>,
        instants: &'a [i64],
        pixel: usize,
        frames: Vec<MapFrame>,
        quiet_ns: Vec<i64>,
    ) -> PixelResponse<'a> {
        let mut log: Vec<f64> = view.light.log[pixel].iter().map(|u| f64::from(*u)).collect();
        // A step that leads off the picture explains no event, and is taken back.
        if log.is_empty() {
            log = vec![0.0; instants.len()];
        }
        PixelResponse {
            view,
            instants,
            pixel,
            track: Track::new(instants, &log, view.light.step_ns),
            events: events_of(view.case, pixel),
            frames,
            quiet_ns,
            around: NeighbourCache::default(),
            out: Conditional::default(),
        }
    }

    /// Its events and frame values.
    fn evaluate(&mut self, prepared: &PreparedTrial) -> &Conditional {
        let (view, pixel) = (self.view, self.pixel);
        let seen = prepared
            .kernel()
            .map(|kernel| view.mixed_log_light(kernel, prepared, pixel, self.instants, &mut self.around));
        let look = Look {
            site: view.case.site(pixel, 0),
            track: &self.track,
            seen: seen.as_deref(),
            events: &self.events,
            frames: &self.frames,
            quiet_ns: &self.quiet_ns,
        };
        conditional(&prepared.nominal, &prepared.effects, &look, &mut self.out);
        &self.out
    }

    /// Its frame values alone.
    fn see_frames(&mut self, prepared: &PreparedTrial) -> &Conditional {
        let look = Look {
            site: self.view.case.site(self.pixel, 0),
            track: &self.track,
            seen: None,
            events: &[],
            frames: &self.frames,
            quiet_ns: &[],
        };
        frame_values(&prepared.nominal, &prepared.effects, &look, &mut self.out);
        &self.out
    }
}

/// Excess of the voltage over the ON threshold and over the OFF threshold, natural-log units.
fn threshold_excess(quiet: &Quiet) -> [f64; 2] {
    if !quiet.is_armed {
        return [f64::NEG_INFINITY; 2];
    }
    [quiet.level - quiet.thresholds.on, -quiet.level - quiet.thresholds.off]
}

/// Instants of a pixel without an event.
fn quiet_instants(case: &Case, nominal: &Nominal, pixel: usize) -> Vec<QuietInstant> {
    let events = case.events.of_pixel(pixel);
    let mut found = Vec::new();
    for (after, event) in events.iter().enumerate() {
        if event.t_in_ns <= case.span.0 + SETTLING_NS {
            continue;
        }
        let next = events.get(after + 1);
        let begin_ns = event.t_off_ns + nominal.pixel.refractory_ns + STEP_NS;
        let end_ns = next.map_or(case.span.1 - 3 * STEP_NS, |next| next.t_in_ns);
        let mut t_ns = begin_ns.div_euclid(QUIET_NS) * QUIET_NS + QUIET_NS;
        while t_ns < end_ns {
            let before = next.filter(|next| next.t_in_ns - t_ns < SOON_NS).map_or(0, |next| next.polarity);
            found.push(QuietInstant { t_ns, after, before });
            t_ns += QUIET_NS;
        }
    }
    found
}

/// Light of the pixels under a sensor.
#[derive(Clone)]
pub(super) struct SceneFit<'a, L> {
    pub ground: &'a FitData<'a, L>,
    pub trial: Trial,
    pub light: L,
    /// Effects that the trial has beyond the stated ones, with their sizes.
    pub applied: Vec<(usize, f64)>,
    /// Thresholds of each pixel's own, where these are estimated.
    pub own: Option<PixelThresholds>,
    /// Kept while neither light nor sensor change.
    pub current: Option<Arc<SensorPrediction>>,
}

/// A sensor's prediction for a light, with the same thresholds in all pixels.
pub(super) struct SensorPrediction {
    pub light: LogLight,
    predicted: Vec<PixelPrediction>,
}

impl<'a, L: FreeScene> SceneFit<'a, L> {
    pub(super) fn new(ground: &'a FitData<'a, L>, trial: &Trial) -> SceneFit<'a, L> {
        let light = ground.begin.clone();
        SceneFit { ground, trial: trial.clone(), light, applied: Vec::new(), own: None, current: None }
    }

    /// Takes another sensor.
    pub(super) fn apply(&mut self, trial: Trial) {
        self.trial = trial;
        self.current = None;
    }

    /// Frees buffers that can be recomputed.
    pub(super) fn release(&mut self) {
        self.light.release();
        self.current = None;
    }

    /// Prediction of the fit's own sensor.
    pub(super) fn prediction(&self) -> Result<Arc<SensorPrediction>, String> {
        if let Some(prediction) = &self.current {
            return Ok(prediction.clone());
        }
        let light = self.light.light(self.ground.case);
        let prepared = self.prepared(&self.trial)?;
        let of = |place: usize, out: &Conditional| self.ground.predicted(place, &self.light, out);
        let predicted = self.map_pixels(&[prepared], &light, of).pop().unwrap_or_default();
        Ok(Arc::new(SensorPrediction { light, predicted }))
    }

    /// The same, and it is kept until light or sensor change.
    pub(super) fn predict(&mut self) -> Result<Arc<SensorPrediction>, String> {
        let prediction = self.prediction()?;
        self.current = Some(prediction.clone());
        Ok(prediction)
    }

    /// Predictions of all pixels by several sensors: [sensor][place].
    pub(super) fn rows(&self, prepared: &[PreparedTrial], light: &LogLight) -> Vec<Vec<PixelRows>> {
        self.map_pixels(prepared, light, |place, out| self.ground.rows(place, &self.light, out))
    }

    /// Maps the predictions of each pixel with `of`: [sensor][place].
    fn map_pixels<T: Send>(
        &self,
        prepared: &[PreparedTrial],
        light: &LogLight,
        of: impl Fn(usize, &Conditional) -> T + Sync,
    ) -> Vec<Vec<T>> {
        let FitData { case, nominal, .. } = *self.ground;
        let view = SampleView { case, light, pixels: Vec::new(), is_known: true };
        let instants: Vec<i64> = (0..light.count).map(|k| light.instant(k)).collect();
        let of_pixel = |(place, pixel): (usize, &u32)| -> Vec<T> {
            let frames = frames_of(case, nominal, *pixel as usize);
            let quiet_ns: Vec<i64> = self.ground.quiet[place].iter().map(|instant| instant.t_ns).collect();
            let is_of_frames = quiet_ns.is_empty() && self.ground.events[place].is_empty();
            let mut through = PixelResponse::new(&view, &instants, *pixel as usize, frames, quiet_ns);
            prepared
                .iter()
                .map(|prepared| match is_of_frames {
                    true => of(place, through.see_frames(prepared)),
                    false => of(place, through.evaluate(prepared)),
                })
                .collect()
        };
        let found: Vec<Vec<T>> = self.light.pixels().par_iter().enumerate().map(of_pixel).collect();
        let mut by_sensor: Vec<Vec<T>> = prepared.iter().map(|_| Vec::with_capacity(found.len())).collect();
        for of_pixel in found {
            by_sensor.iter_mut().zip(of_pixel).for_each(|(to, of)| to.push(of));
        }
        by_sensor
    }

    /// A sensor, ready to be applied.
    pub(super) fn prepared(&self, trial: &Trial) -> Result<PreparedTrial, String> {
        PreparedTrial::new(self.ground.case, trial)
    }

    /// Predictions of all pixels by the fit's own sensor, with the derivatives of a round.
    pub(super) fn predicted(&self) -> Result<Vec<PixelPrediction>, String> {
        let mut predicted = self.prediction()?.predicted.clone();
        if let Some(own) = &self.own {
            own.apply(&mut predicted);
        }
        Ok(predicted)
    }

    /// The same with each pixel's own thresholds re-estimated, where they are free; for a light that is about
    /// to change.
    fn predicted_anew(&mut self) -> Result<Vec<PixelPrediction>, String> {
        let prediction = self.prediction()?;
        self.current = None;
        let mut predicted = Arc::try_unwrap(prediction)
            .map_or_else(|kept| kept.predicted.clone(), |prediction| prediction.predicted);
        if let Some(own) = &mut self.own {
            own.estimate(&mut predicted);
        }
        Ok(predicted)
    }

    /// Runs `count` rounds of the light's estimate.
    pub(super) fn rounds(&mut self, count: usize) -> Result<(), String> {
        for _ in 0..count {
            let predicted = self.predicted_anew()?;
            self.light.newton_and_noise(&predicted);
            if self.light.has_settled() {
                break;
            }
        }
        self.shorten()
    }

    /// Takes the last step again by less where it was too long.
    fn shorten(&mut self) -> Result<(), String> {
        if L::IS_ONE {
            self.predict()?;
            while self.light.shorten_step(&self.predicted()?) {
                self.current = None;
                self.predict()?;
            }
        }
        Ok(())
    }

    /// Runs Newton steps; only the last one also updates prior and noise.
    pub(super) fn newton_rounds(&mut self, count: usize) -> Result<(), String> {
        for _ in 1..count {
            let predicted = self.predicted_anew()?;
            self.light.newton_step(&predicted);
        }
        self.rounds(1)
    }

    /// Runs `times` such rounds, as an exact fit needs.
    pub(super) fn settled(&mut self, times: usize) -> Result<(), String> {
        (0..times).try_for_each(|_| self.newton_rounds(self.ground.steps))
    }

    /// Median misfit of the events, as a share of their thresholds.
    pub(super) fn median_event_misfit(&self) -> Result<f64, String> {
        Ok(self.light.median_event_misfit(&self.predicted()?))
    }

    /// The part of [`SceneFit::median_event_misfit`] that is due to the scene: the part in common with events
    /// of other pixels at the same place of it. All of it where too few share a place.
    pub(super) fn scene_misfit(&self) -> Result<f64, String> {
        let predicted = self.predicted()?;
        Ok(self.light.median_event_misfit(&predicted)
            * libm::sqrt(1.0 - self.white_share(&predicted).unwrap_or(0.0)))
    }

    /// The trial with one more effect of a given size.
    pub(super) fn trial_with(&self, candidate: usize, effect_size: f64) -> Trial {
        self.trial.with_effect(&CANDIDATES[candidate], effect_size, self.ground.scales)
    }

    /// The size of an effect that the trial has; 0 where it has none.
    pub(super) fn size_of(&self, candidate: usize) -> f64 {
        self.applied.iter().find(|(n, _)| *n == candidate).map_or(0.0, |(_, size)| *size)
    }
}

impl<L: FreeScene> FitData<'_, L> {
    fn rows(&self, place: usize, light: &L, out: &Conditional) -> PixelRows {
        let events = self.case.events.of_pixel(light.pixels()[place] as usize);
        let slope = |k: &usize| f64::from(events[*k].polarity) * out.slope_per_s[*k];
        PixelRows {
            excess: self.events[place].iter().map(|k| out.excess[*k]).collect(),
            slope_per_s: self.events[place].iter().map(slope).collect(),
            dn: self.frames[place].iter().map(|(l, _)| out.dn[*l]).collect(),
            quiet: out.quiet.iter().map(threshold_excess).collect(),
        }
    }

    /// Instants without an event that constrain a pixel's light: in each interval between events and for each
    /// polarity the one nearest to a threshold, where it is near.
    pub(super) fn no_event_instants(&self, place: usize, rows: &PixelRows) -> Vec<(usize, usize)> {
        let threshold = self.scales.threshold;
        let instants = &self.quiet[place];
        let mut chosen: Vec<(usize, usize)> = Vec::new();
        let mut begin = 0;
        while begin < instants.len() {
            let after = instants[begin].after;
            let end = begin + instants[begin..].iter().take_while(|one| one.after == after).count();
            for (side, polarity) in [(0, 1), (1, -1)] {
                let nearest = (begin..end)
                    .filter(|n| instants[*n].before != polarity && rows.quiet[*n][side] > -NEAR * threshold)
                    .max_by(|a, b| rows.quiet[*a][side].total_cmp(&rows.quiet[*b][side]));
                chosen.extend(nearest.map(|n| (n, side)));
            }
            begin = end;
        }
        chosen
    }

    fn predicted(&self, place: usize, light: &L, out: &Conditional) -> PixelPrediction {
        let pixel = light.pixels()[place] as usize;
        let (events, frames) = (self.case.events.of_pixel(pixel), frames_of(self.case, self.nominal, pixel));
        let least = LEAST_THRESHOLD * self.scales.threshold;
        let event = |&k: &usize| PredictedEvent {
            t_ns: out.fired_ns[k],
            reference_ns: out.reference_ns[k],
            polarity: f64::from(events[k].polarity),
            threshold: f64::max(out.threshold[k], least),
            excess: out.excess[k],
            slope_per_s: libm::hypot(out.slope_per_s[k], out.slope_per_s[k - 1]),
            rise_per_s: f64::from(events[k].polarity) * out.slope_per_s[k],
        };
        let rows = self.rows(place, light, out);
        let quiet = |(n, side): (usize, usize)| {
            let instant = &out.quiet[n];
            let (polarity, threshold) =
                if side == 0 { (1.0, instant.thresholds.on) } else { (-1.0, instant.thresholds.off) };
            PredictedEvent {
                t_ns: instant.t_ns,
                reference_ns: instant.reference_ns,
                polarity,
                threshold: f64::max(threshold, least),
                excess: polarity * rows.quiet[n][side],
                slope_per_s: instant.slope_per_s.abs(),
                rise_per_s: polarity * instant.slope_per_s,
            }
        };
        let frame = |&(l, signal_dn): &(usize, f64)| PredictedFrame {
            start_ns: frames[l].start_ns,
            end_ns: frames[l].end_ns,
            residual_dn: out.dn[l] - frames[l].dn,
            signal_dn,
        };
        PixelPrediction {
            low_pass: out.low_pass,
            gain: self.nominal.number.gain,
            frames: self.frames[place].iter().map(frame).collect(),
            events: self.events[place].iter().map(event).collect(),
            quiet: self.no_event_instants(place, &rows).into_iter().map(quiet).collect(),
        }
    }
}
