//! Light of pixels as a sensor sees it: rounds of light, and exact fits of an effect.

use super::super::evidence::Ranked;
use super::super::prepared::Prepared;
use super::super::setting::LARGEST_EFFECT_SIZE;
use super::super::{Around, View, events_of, frames_of, median_of};
use crate::candidates::{CANDIDATES, Scales, Signs, Trial};
use photocurrent_scene::case::Case;
use photocurrent_scene::light::Light;
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::pixels::{
    Block, Noise, PixelLight, Predicted, PredictedEvent, PredictedFrame, frame_noise,
};
use photocurrent_sensor::conditional::{Conditional, Look, Quiet, Track, conditional};
use photocurrent_sensor::map::MapFrame;
use rayon::prelude::*;

/// Light is predicted this often, ns; a knot every so many.
pub(super) const STEP_NS: i64 = 100_000;
const PER_KNOT: usize = 5;
/// Events this soon after the begin have no reference that is known, ns.
const SETTLING_NS: i64 = 2_000_000;
/// Between events the voltage is held below its threshold this often, ns; and below that of the next event
/// only so long before it.
const QUIET_NS: i64 = 500_000;
const SOON_NS: i64 = 1_000_000;
/// And where it comes this near, as a share of a threshold.
const NEAR: f64 = 0.2;
/// Noise is a share of thresholds, which are at least this share of the stated ones.
const LEAST_THRESHOLD: f64 = 0.1;
/// Rounds of light between corrections of a size.
const ROUNDS_EACH: usize = 3;
/// Standard errors are this much larger than the information has them: what sound recordings show.
pub(super) const ERRORS: f64 = 3.0;
/// Pixels with fewer events bring errors of frames only.
pub(super) const FEWEST_OF_PIXEL: usize = 3;

/// What stays the same from fit to fit.
pub(super) struct Ground<'a> {
    pub case: &'a Case,
    pub nominal: &'a Nominal,
    pub scales: &'a Scales,
    /// Of each pixel whose light is estimated: numbers of its events that count.
    pub events: Vec<Vec<usize>>,
    /// And of its frames, with about how bright each is, DN above black.
    frames: Vec<Vec<(usize, f64)>>,
    /// Of each pixel the instants without an event.
    quiet: Vec<Vec<QuietInstant>>,
    begin: PixelLight,
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

/// What a sensor makes of a pixel's measurements, in the order of [`Ground`].
#[derive(Clone, Debug, Default)]
pub(super) struct Rows {
    pub excess: Vec<f64>,
    /// In the direction of the event, ln/s.
    pub slope_per_s: Vec<f64>,
    pub dn: Vec<f64>,
    /// By how much the voltage lies beyond the ON threshold, and beyond the OFF threshold, where no event
    /// fired, natural-log units; minus infinity while the pixel is held.
    pub quiet: Vec<[f64; 2]>,
}

impl<'a> Ground<'a> {
    pub(super) fn new(
        case: &'a Case,
        nominal: &'a Nominal,
        scales: &'a Scales,
        blocks: Vec<Block>,
    ) -> Result<Ground<'a>, String> {
        if case.frame_count() == 0 {
            return Err("there are no frames".to_owned());
        }
        let noise = Noise::new(frame_noise(case, nominal));
        let begin = PixelLight::begin(case, nominal, blocks, (STEP_NS, PER_KNOT), noise);
        let (events, frames, quiet) = (Vec::new(), Vec::new(), Vec::new());
        let mut ground = Ground { case, nominal, scales, events, frames, quiet, begin };
        let stated = Prepared::new(case, &Trial::stated(nominal))?;
        let light = ground.begin.light(case);
        let pixels = ground.begin.pixels().to_vec();
        let view = View { case, light: &light, pixels: Vec::new(), is_known: true };
        let end_ns = case.span.1 - 3 * STEP_NS;
        let counted = |pixel: &u32| -> (Vec<usize>, Vec<usize>) {
            let pixel = *pixel as usize;
            let frames = frames_of(case, nominal, pixel);
            let out = through(&view, &stated, pixel, (&frames, &[]), &mut Around::default());
            let events = case.events.of(pixel);
            let counts = |k: &usize| {
                out.is_armed[*k]
                    && out.is_armed[k - 1]
                    && events[k - 1].t_in_ns > case.span.0 + SETTLING_NS
                    && events[*k].t_in_ns < end_ns
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
            ground.quiet.push(instants(case, nominal, pixels[place] as usize));
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

    /// Number of events that count, in pixels that have some.
    pub(super) fn events(&self) -> usize {
        self.events.iter().map(Vec::len).filter(|count| *count >= FEWEST_OF_PIXEL).sum()
    }

    /// Median slope of the voltage at events, ln/s.
    pub(super) fn slope_per_s(&self, fit: &Fit<'_>) -> Result<f64, String> {
        let rows = fit.rows(&fit.trial, &fit.light.light(self.case))?;
        let mut slopes: Vec<f64> =
            rows.iter().flat_map(|of| of.slope_per_s.iter().map(|slope| slope.abs())).collect();
        Ok(median_of(&mut slopes))
    }
}

/// A pixel through a sensor.
fn through(
    view: &View<'_>,
    prepared: &Prepared,
    pixel: usize,
    (frames, quiet_ns): (&[MapFrame], &[i64]),
    around: &mut Around,
) -> Conditional {
    let instants: Vec<i64> = (0..view.light.count).map(|k| view.light.instant(k)).collect();
    let log: Vec<f64> = view.light.log[pixel].iter().map(|u| f64::from(*u)).collect();
    let seen = prepared.kernel().map(|kernel| view.mixed(kernel, prepared, pixel, &instants, around));
    let track = Track::new(&instants, &log, view.light.step_ns);
    let events = events_of(view.case, pixel);
    let look = Look {
        site: view.case.site(pixel, 0),
        track: &track,
        seen: seen.as_deref(),
        events: &events,
        frames,
        quiet_ns,
    };
    let mut out = Conditional::default();
    conditional(&prepared.nominal, &prepared.effects, &look, &mut out);
    out
}

/// By how much the voltage lies beyond the ON threshold and beyond the OFF threshold.
fn beyond(quiet: &Quiet) -> [f64; 2] {
    if !quiet.is_armed {
        return [f64::NEG_INFINITY; 2];
    }
    [quiet.level - quiet.thresholds.on, -quiet.level - quiet.thresholds.off]
}

/// Instants of a pixel without an event.
fn instants(case: &Case, nominal: &Nominal, pixel: usize) -> Vec<QuietInstant> {
    let events = case.events.of(pixel);
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
pub(super) struct Fit<'a> {
    pub ground: &'a Ground<'a>,
    pub trial: Trial,
    pub light: PixelLight,
    /// Effects that the trial has beyond the stated ones, with their sizes.
    pub applied: Vec<(usize, f64)>,
}

/// A fit of an effect with its size.
pub(super) struct Exact<'a> {
    pub candidate: usize,
    pub effect_size: f64,
    /// Standard error of it.
    pub error: f64,
    pub fit: Fit<'a>,
    /// Of each pixel, nats.
    pub left_out: Vec<f64>,
}

impl<'a> Fit<'a> {
    pub(super) fn begin(ground: &'a Ground<'a>, trial: &Trial) -> Fit<'a> {
        Fit { ground, trial: trial.clone(), light: ground.begin.clone(), applied: Vec::new() }
    }

    /// What a sensor makes of all pixels on a light.
    pub(super) fn rows(&self, trial: &Trial, light: &Light) -> Result<Vec<Rows>, String> {
        let found = self.conditionals(trial, light)?;
        let of = |(place, out): (usize, Conditional)| self.ground.rows(place, &self.light, &out);
        Ok(found.into_iter().enumerate().map(of).collect())
    }

    fn conditionals(&self, trial: &Trial, light: &Light) -> Result<Vec<Conditional>, String> {
        let Ground { case, nominal, .. } = *self.ground;
        let prepared = Prepared::new(case, trial)?;
        let view = View { case, light, pixels: Vec::new(), is_known: true };
        let of = |(pixel, quiet): (&u32, &Vec<QuietInstant>)| {
            let frames = frames_of(case, nominal, *pixel as usize);
            let quiet_ns: Vec<i64> = quiet.iter().map(|instant| instant.t_ns).collect();
            through(&view, &prepared, *pixel as usize, (&frames, &quiet_ns), &mut Around::default())
        };
        Ok(self.light.pixels().par_iter().zip(&self.ground.quiet).map(of).collect())
    }

    /// The same with what a round needs.
    pub(super) fn predicted(&self) -> Result<Vec<Predicted>, String> {
        let light = self.light.light(self.ground.case);
        let found = self.conditionals(&self.trial, &light)?;
        let of = |(place, out): (usize, Conditional)| self.ground.predicted(place, &self.light, &out);
        Ok(found.into_iter().enumerate().map(of).collect())
    }

    /// So many rounds of light.
    pub(super) fn rounds(&mut self, count: usize) -> Result<(), String> {
        for _ in 0..count {
            let predicted = self.predicted()?;
            self.light.round(&predicted);
        }
        Ok(())
    }

    /// Rounds of which only the last changes prior and noise.
    fn settle(&mut self, count: usize) -> Result<(), String> {
        for _ in 1..count {
            let predicted = self.predicted()?;
            self.light.settle(&predicted);
        }
        self.rounds(1)
    }

    /// The same so many times: what an effect's exact fit takes.
    pub(super) fn settled(&mut self, times: usize) -> Result<(), String> {
        (0..times).try_for_each(|_| self.settle(ROUNDS_EACH))
    }

    /// Log density of each pixel's events when the light is estimated from everything else, nats.
    pub(super) fn left_out(&self) -> Result<Vec<f64>, String> {
        Ok(self.light.left_out(&self.predicted()?))
    }

    /// The trial with an effect of a size beyond those that it has.
    pub(super) fn with(&self, candidate: usize, effect_size: f64) -> Trial {
        self.trial.and(&CANDIDATES[candidate], effect_size, self.ground.scales)
    }

    /// Does the trial mix the light of neighbours, with weights that bend where its size is nothing?
    pub(super) fn is_mixing(&self, trial: &Trial) -> bool {
        Prepared::new(self.ground.case, trial).is_ok_and(|prepared| prepared.kernel().is_some())
    }

    /// The size of an effect that the trial has; 0 where it has none.
    pub(super) fn size_of(&self, candidate: usize) -> f64 {
        self.applied.iter().find(|(n, _)| *n == candidate).map_or(0.0, |(_, size)| *size)
    }

    /// Light and size of an effect in turn; effects that are applied before keep their sizes.
    pub(super) fn exact(
        &self,
        candidate: usize,
        begin: f64,
        corrections: usize,
    ) -> Result<Exact<'a>, String> {
        let is_switch = CANDIDATES[candidate].signs == Signs::Switch;
        let mut effect_size = if is_switch { 1.0 } else { bounded(candidate, begin) };
        let mut error = 0.0;
        let mut fit = self.clone();
        for turn in 0..corrections {
            fit.trial = self.with(candidate, effect_size);
            fit.applied = self.applied.clone();
            fit.applied.push((candidate, effect_size));
            fit.settle(ROUNDS_EACH)?;
            if is_switch || turn + 1 == corrections {
                continue;
            }
            let scored = fit.score(&[candidate], None)?;
            if let Some(step) = scored.sizes[0] {
                let most = 1.0 + effect_size.abs();
                effect_size = bounded(candidate, effect_size + step.clamp(-most, most));
                error = ERRORS / scored.information[0].sqrt();
            }
        }
        let left_out = fit.left_out()?;
        Ok(Exact { candidate, effect_size, error, fit, left_out })
    }
}

/// Sizes within physics.
pub(super) fn bounded(candidate: usize, effect_size: f64) -> f64 {
    let most = LARGEST_EFFECT_SIZE;
    let least = if CANDIDATES[candidate].signs == Signs::Both { -most } else { 1e-3 };
    effect_size.clamp(least, most)
}

impl Exact<'_> {
    /// Takes the place of a first size and gain; `level`: densities without the effect.
    pub(super) fn replace(&self, one: &mut Ranked, level: &[f64], ground: &Ground<'_>) {
        let gains: Vec<f64> = self
            .left_out
            .iter()
            .zip(level)
            .zip(&ground.events)
            .filter(|(_, events)| events.len() >= FEWEST_OF_PIXEL)
            .map(|((with, without), _)| with - without)
            .collect();
        let events = ground.events() as f64;
        let sum: f64 = gains.iter().sum();
        let mean = sum / gains.len().max(1) as f64;
        let square: f64 = gains.iter().map(|gain| (gain - mean) * (gain - mean)).sum();
        one.gain = sum / events;
        one.gain_error = square.sqrt() / events;
        one.effect_size = self.effect_size;
        one.error = f64::max(self.error, one.error);
        one.value = CANDIDATES[self.candidate].value(self.effect_size, ground.scales, ground.nominal);
        one.is_exact = true;
    }
}

impl Ground<'_> {
    fn rows(&self, place: usize, light: &PixelLight, out: &Conditional) -> Rows {
        let events = self.case.events.of(light.pixels()[place] as usize);
        let slope = |k: &usize| f64::from(events[*k].polarity) * out.slope_per_s[*k];
        Rows {
            excess: self.events[place].iter().map(|k| out.excess[*k]).collect(),
            slope_per_s: self.events[place].iter().map(slope).collect(),
            dn: self.frames[place].iter().map(|(l, _)| out.dn[*l]).collect(),
            quiet: out.quiet.iter().map(beyond).collect(),
        }
    }

    /// The instants of a pixel without an event that bear on its light: of each stretch between events and
    /// each polarity that at which an event is nearest, and only where it is near.
    pub(super) fn silent(&self, place: usize, rows: &Rows) -> Vec<(usize, usize)> {
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

    fn predicted(&self, place: usize, light: &PixelLight, out: &Conditional) -> Predicted {
        let pixel = light.pixels()[place] as usize;
        let (events, frames) = (self.case.events.of(pixel), frames_of(self.case, self.nominal, pixel));
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
        Predicted {
            low_pass: out.low_pass,
            gain: self.nominal.number.gain,
            frames: self.frames[place].iter().map(frame).collect(),
            events: self.events[place].iter().map(event).collect(),
            quiet: self.silent(place, &rows).into_iter().map(quiet).collect(),
        }
    }
}
