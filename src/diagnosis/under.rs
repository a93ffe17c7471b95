//! The light of the sampled pixels as a sensor with effects would have had to see it, to record what was recorded.
//!
//! The solver knows one front end with one time constant, two thresholds, a refractory period and a gain. Everything of a trial that can be brought to that form is, through the
//! hooks that the simulator uses: stamps and exposures are taken back to true times, digital numbers to charge, the faster of two poles counts as a delay, light that is added
//! behind the lens is taken off again, drifts and memories are told event by event, and frames are mixed where neighbours are. What is left is corrected by turns: the trial looks at the light, its recording is
//! estimated in the same way, and the light moves by what that differs.

use crate::candidates::Trial;
use crate::case::{Case, CaseFrames};
use crate::nominal::Nominal;
use crate::record::{Conditions, effects_of, record};
use crate::sample::Sample;
use crate::scene::{Scene, SceneSetting, Told, pixel_data, task};
use photocurrent_core::random::Random;
use photocurrent_core::sensor::Reset;
use photocurrent_core::{Exposure, Timestamp};
use photocurrent_sensor::comparator::signed_step;
use photocurrent_sensor::effects::{
    BURST_GAP_NS, Effect, FrontEndModel, History, Kernel, Kick, KickTarget, LastEvent, PixelEvent, Reading, RowSite, Site, Tap, Thresholds,
};
use photocurrent_sensor::forward::neighbours::{joined, mixed, stand_in};
use photocurrent_sensor::front_end::FrontEnd;
use photocurrent_sensor::likelihood::{BaseNoise, Interval, Since, intervals_since};
use photocurrent_sensor::map::{MapEvent, MapSensor, Prior};
use rayon::prelude::*;
use std::borrow::Cow;

/// One correction moves log light by at most this.
const LARGEST_CORRECTION: f64 = 0.5;
/// Knots nearer than this are one, ns.
const SAME_KNOT_NS: i64 = 20_000;
/// Seed of the noise that mixing takes away.
const MIXING: u64 = 0x0b1a;
/// Seed of the draws within rounded stamps.
const RESCALING: u64 = 0x1e51;
/// Signals that are mixed are at least this, DN.
const LEAST_SIGNAL_DN: f64 = 0.5;
/// What a kick fires is stamped no more than this, and a step of the stamps, before it, ns.
const KICKED_NS: i64 = 2_000;
/// A kick of the front end fades in so many steps.
const FADING: i32 = 12;
/// Light behind the lens is at least this share of what the pixel sees.
const LEAST_SHARE: f64 = 0.02;

/// A trial that looks at a recording.
pub struct Under<'a> {
    /// The recording; where the event path sees a mixture of neighbours, its frames are mixed alike, so that both are of one light.
    case: Cow<'a, Case>,
    trial: &'a Trial,
    effects: Vec<Box<dyn Effect>>,
}

impl<'a> Under<'a> {
    /// A trial with what the description states. Frame values have noise of `frame_share` of the signal beyond what is stated.
    ///
    /// # Errors
    /// When an effect or its parameters are not understood.
    pub fn new(case: &'a Case, trial: &'a Trial, frame_share: f64) -> Result<Under<'a>, String> {
        let effects = effects_of(case, &trial.effects)?;
        let kernel = joined(&effects).map_err(|why| why.to_string())?;
        let case = kernel.map_or(Cow::Borrowed(case), |kernel| Cow::Owned(with_mixed_frames(case, &trial.nominal, &kernel, frame_share)));
        Ok(Under { case, trial, effects })
    }

    /// The recording as this trial compares it.
    pub fn case(&self) -> &Case {
        &self.case
    }

    /// Are the frames that it compares mixtures of neighbours?
    pub fn has_mixed_frames(&self) -> bool {
        matches!(self.case, Cow::Owned(_))
    }

    /// The light that the trial must have seen to record `recorded`, as far as the solver can tell.
    pub fn estimate(&self, recorded: &Case, sample: &Sample, setting: &SceneSetting, priors: &[Prior]) -> Scene {
        let stated = Scene::estimate_from(
            sample,
            priors,
            |n| self.told(recorded, setting, sample.pixels[n] as usize).0,
            |told| task(recorded, setting, &told.data, told.sensor, &told.beyond),
            recorded.span.0,
        );
        let pixels = (0..stated.len()).map(|n| {
            let (t, u) = stated.pixel(n);
            let (factor, added) = self.seen(&self.case.site(sample.pixels[n] as usize, 1));
            let own = |u: f64| {
                let seen = libm::exp(u);
                libm::log(f64::max(seen - added, LEAST_SHARE * seen) / factor)
            };
            let is_plain = factor == 1.0 && added == 0.0;
            (t.to_vec(), if is_plain { u.to_vec() } else { u.iter().map(|u| own(*u)).collect() }, stated.is_known[n])
        });
        let mut scene = Scene::from_pixels(pixels);
        scene.log_evidence.clone_from(&stated.log_evidence);
        scene
    }

    /// Light behind the lens: what the pixel sees of a photocurrent `i` is `factor * i + added`.
    fn seen(&self, site: &Site) -> (f64, f64) {
        let t_ns = i64::midpoint(self.case.span.0, self.case.span.1);
        let through = |i: f64| self.effects.iter().fold(i, |i, effect| effect.event_light(site, t_ns, i));
        let (one, two) = (through(1.0), through(2.0));
        let factor = two - one;
        if factor > 1e-6 { (factor, f64::max(one - factor, 0.0)) } else { (1.0, 0.0) }
    }

    /// What the solver is told of a pixel, and what its intervals have of their own.
    fn told(&self, recorded: &Case, setting: &SceneSetting, pixel: usize) -> (Told, Vec<Since>) {
        let Trial { nominal, .. } = self.trial;
        let site = self.case.site(pixel, 1);
        let mut random = Random::new(0, &[]);
        let t_ns = i64::midpoint(recorded.span.0, recorded.span.1);
        let (factor, added) = self.seen(&site);
        let (mut events, mut frames) = pixel_data(recorded, nominal, setting, pixel);
        let (first_ns, last_ns) = recorded.span;
        for event in &mut events {
            let stamp = PixelEvent { t_in_ns: event.t_in_ns, t_off_ns: event.t_off_ns, polarity: event.polarity };
            let mut moved = stamp;
            for effect in &self.effects {
                effect.stamp(&site, &mut random, &mut moved);
            }
            event.t_in_ns = 2 * stamp.t_in_ns - moved.t_in_ns;
            let hidden_ns: i64 = self.effects.iter().map(|effect| effect.latency(&site, &mut random, event.t_in_ns).hidden_ns).sum();
            event.t_off_ns = i64::max(2 * stamp.t_off_ns - moved.t_off_ns + hidden_ns, event.t_in_ns);
        }
        events.retain(|event| (first_ns..last_ns).contains(&event.t_in_ns));
        let number = nominal.number;
        let mut previous_charge = 0.0;
        for (frame, at) in frames.iter_mut().enumerate() {
            let row = RowSite { y: site.y, height: site.height, frame, row_time_ns: nominal.row_time_ns };
            let stated = Exposure { start: Timestamp(at.start_ns), end: Timestamp(at.end_ns) };
            let exposed = self.effects.iter().fold(stated, |exposure, effect| effect.exposure(&row, exposure));
            (at.start_ns, at.end_ns) = (exposed.start.0, exposed.end.0);
            let reading = Reading { frame, previous_charge, gain: number.gain, black_level: number.black_level, saturation: nominal.saturation_dn };
            let through = |charge: f64| {
                let read = self.effects.iter().fold(charge, |charge, effect| effect.charge(&site, &reading, charge));
                self.effects.iter().fold(number.of(read), |dn, effect| effect.dn(&site, &reading, dn))
            };
            let stated_charge = number.integral(at.dn);
            let charge = inverse(through, stated_charge, at.dn);
            // What a DN of noise is in charge, as the solver is told of it.
            let noisier = inverse(through, stated_charge + at.sigma_dn / number.gain, at.dn + at.sigma_dn);
            previous_charge = charge;
            let seconds = (at.end_ns - at.start_ns) as f64 * 1e-9;
            at.dn = number.of(factor * charge + added * seconds);
            at.sigma_dn = f64::max(number.gain * factor * (noisier - charge), 0.1 * at.sigma_dn);
        }
        let mut model = FrontEndModel::plain(nominal.pixel.front_end);
        let mut thresholds = Thresholds { on: nominal.pixel.threshold_on, off: nominal.pixel.threshold_off };
        for effect in &self.effects {
            effect.front_end(&site, &mut model);
            effect.thresholds(&site, &History::default(), &mut random, t_ns, &mut thresholds);
        }
        let mut light: Vec<f64> =
            frames.iter().map(|frame| number.integral(frame.dn) / f64::max((frame.end_ns - frame.start_ns) as f64 * 1e-9, 1e-9)).collect();
        light.sort_by(f64::total_cmp);
        let usual = light.get(light.len() / 2).copied().unwrap_or(1.0).max(1e-9);
        let (front_end, delay_ns) = slower_and_delay(&model, usual);
        if delay_ns > 0 {
            events.iter_mut().for_each(|event| (event.t_in_ns, event.t_off_ns) = (event.t_in_ns - delay_ns, event.t_off_ns - delay_ns));
            events.retain(|event| event.t_in_ns >= first_ns);
        }
        let refractory_ns = self.effects.iter().fold(nominal.pixel.refractory_ns, |refractory_ns, effect| effect.refractory_ns(&site, usual, refractory_ns));
        let since = self.since(&site, &events, &front_end, refractory_ns, usual);
        let beyond = beyond(&since, &events, &thresholds);
        let sensor = MapSensor { front_end, threshold_on: thresholds.on, threshold_off: thresholds.off, refractory_ns, ..nominal.map_sensor() };
        (Told { data: (events, frames), sensor, beyond }, since)
    }

    /// The intervals between the events of pixel `n` of a sample, exactly rescaled with this trial and the light that it was estimated to see; none where that is not known.
    /// The solver's front end stands for the trial's. `sigma` is the threshold's standard deviation at each reset, natural-log units.
    pub fn rescaled(&self, recorded: &Case, setting: &SceneSetting, sample: &Sample, scene: &Scene, n: usize, sigma: f64) -> Vec<Interval> {
        let pixel = sample.pixels[n] as usize;
        if !scene.is_known[n] {
            return Vec::new();
        }
        let (told, since) = self.told(recorded, setting, pixel);
        let (factor, added) = self.seen(&self.case.site(pixel, 1));
        let (t_ns, own) = scene.pixel(n);
        let log_light: Vec<f64> = own.iter().map(|u| libm::log(factor * libm::exp(*u) + added)).collect();
        let noise = BaseNoise { sigma, shared: false, background_hz: 0.0, stamp_width_ns: recorded.t_resolution_ns };
        let mut random = Random::new(RESCALING, &[pixel as u64]);
        intervals_since((t_ns, &log_light), &told.sensor, &noise, &told.data.0, |k| &since[k], recorded.span, &mut random)
    }

    /// What the interval before each event has of its own, and the silent end: thresholds of that moment, what the reset left, drift and kicks since then.
    fn since(&self, site: &Site, events: &[MapEvent], front_end: &FrontEnd, refractory_ns: i64, light: f64) -> Vec<Since> {
        let nominal = &self.trial.nominal;
        let (start_ns, end_ns) = self.case.span;
        let mut random = Random::new(0, &[]);
        let stated = Thresholds { on: nominal.pixel.threshold_on, off: nominal.pixel.threshold_off };
        let mut kicks: Vec<Kick> = Vec::new();
        let mut drift_per_s = 0.0;
        for effect in &self.effects {
            let leak = effect.leak(site, &stated);
            drift_per_s += leak.constant_per_s + leak.per_photocurrent_per_s * light;
            effect.kicks(site, start_ns, end_ns, &mut kicks);
        }
        let kicks = standing(&kicks, (front_end.tau_0_s + front_end.alpha_s / light) * 1e9);
        let late_ns = self.case.t_resolution_ns + KICKED_NS;
        let mut told = 0;
        let mut history = History::default();
        let mut reset_ns = start_ns;
        let mut left = 0.0;
        let mut all = Vec::with_capacity(events.len() + 1);
        for end in events.iter().map(Some).chain([None]) {
            let mut now = stated;
            for effect in &self.effects {
                effect.thresholds(site, &history, &mut random, reset_ns, &mut now);
            }
            let until_ns = end.map_or(end_ns, |event| event.t_in_ns);
            // What a kick fires comes with it, and the stamps of both are rounded.
            let next = kicks.partition_point(|kick| kick.0 < until_ns + late_ns).max(told);
            let mut within: Vec<(i64, f64)> = kicks[told..next].iter().filter(|kick| kick.0 >= reset_ns).copied().collect();
            told = next;
            // Of a kick that fires, half was still missing on average.
            let mut unused = 0.0;
            if let Some(event) = end
                && let Some(kick) = within.last_mut().filter(|kick| (kick.0 - until_ns).abs() <= late_ns && kick.1 * f64::from(event.polarity) > 0.0)
            {
                unused = 0.5 * kick.1;
                kick.1 -= unused;
            }
            all.push(Since { thresholds: [now.on, now.off], left, drift_per_s, kicks: within, reset_ns });
            let Some(event) = end else { break };
            let step = signed_step(event.polarity, now.on, now.off);
            let burst_index = match history.last_event {
                Some(last) if event.t_in_ns - last.t_in_ns <= BURST_GAP_NS => history.burst_index + 1,
                _ => 1,
            };
            let last_event = Some(LastEvent { t_in_ns: event.t_in_ns, t_off_ns: event.t_off_ns, polarity: event.polarity, overshoot: 0.0 });
            history = History { last_event, events: history.events + 1, burst_index };
            left = self.effects.iter().fold(step, |reference, effect| effect.reference(site, &history, &mut random, reference, 0.0)) - step;
            if nominal.reset != Reset::Resample {
                left -= unused;
            }
            reset_ns = if nominal.reset == Reset::Resample { event.t_off_ns + refractory_ns } else { event.t_in_ns };
        }
        all
    }

    /// Estimates the light and corrects it `turns` times by what the trial's own recording of it differs.
    ///
    /// # Errors
    /// When effects cannot be combined.
    pub fn corrected(&self, sample: &Sample, setting: &SceneSetting, priors: &[Prior], turns: usize) -> Result<(Scene, Case), String> {
        let wanted = self.estimate(&self.case, sample, setting, priors);
        let look = |scene: &Scene| {
            let conditions = Conditions { seed: 1, is_mixed: true, ..Conditions::default() };
            record(&self.case, &self.trial.nominal, sample, scene, &self.trial.effects, &conditions)
        };
        let mut scene = wanted.clone();
        let mut recording = look(&scene)?;
        for _turn in 0..turns {
            let found = self.estimate(&recording, sample, setting, priors);
            scene = moved(&scene, &wanted, &found);
            recording = look(&scene)?;
        }
        Ok((scene, recording))
    }
}

/// Kicks in order of time (ns, change of what is compared). One of the front end fades with its time constant, here in equal steps down at the middles of equal parts.
fn standing(kicks: &[Kick], tau_ns: f64) -> Vec<(i64, f64)> {
    let steps = |kick: &Kick| {
        let fades = if kick.target == KickTarget::FrontEnd { FADING } else { 0 };
        let (t_ns, step) = (kick.t_ns, kick.change / f64::from(FADING));
        let down = (0..fades).map(move |n| (t_ns - (tau_ns * libm::log(1.0 - (f64::from(n) + 0.5) / f64::from(FADING))).round() as i64, -step));
        std::iter::once((t_ns, kick.change)).chain(down)
    };
    let mut all: Vec<(i64, f64)> = kicks.iter().flat_map(steps).collect();
    all.sort_by_key(|kick| kick.0);
    all
}

/// The slower of two poles, and the faster as a delay, ns, at some light: their squares add up, and one pole of their sum would be softer by twice their product.
fn slower_and_delay(model: &FrontEndModel, light: f64) -> (FrontEnd, i64) {
    let first = model.low_pass;
    let Some(pole) = model.second_pole else { return (first, 0) };
    let second = FrontEnd { tau_0_s: pole.tau_s, alpha_s: pole.tau_light_s };
    let at = |pole: &FrontEnd| pole.tau_0_s + pole.alpha_s / light;
    let (slower, faster) = if at(&second) > at(&first) { (second, first) } else { (first, second) };
    (slower, (at(&faster) * 1e9).round() as i64)
}

/// By how much the signed step of each event is more than its usual threshold; empty where none is.
fn beyond(since: &[Since], events: &[MapEvent], usual: &Thresholds) -> Vec<f64> {
    let of = |(since, event): (&Since, &MapEvent)| {
        let (step, usual) = (signed_step(event.polarity, since.thresholds[0], since.thresholds[1]), signed_step(event.polarity, usual.on, usual.off));
        let drift = since.drift_per_s * f64::max((event.t_in_ns - since.reset_ns) as f64 * 1e-9, 0.0);
        let kicked: f64 = since.kicks.iter().map(|(_, change)| change).sum();
        step - usual + since.left - drift - kicked
    };
    let beyond: Vec<f64> = since.iter().zip(events).map(of).collect();
    if beyond.iter().all(|more| *more == 0.0) { Vec::new() } else { beyond }
}

/// A recording whose frames are mixtures of neighbours, as the event path sees their light. A mixture has less noise than its parts: what is gone is put back, or every
/// mixture would agree better than none.
fn with_mixed_frames(case: &Case, nominal: &Nominal, kernel: &Kernel, frame_share: f64) -> Case {
    let Some(frames) = &case.frames else { return case.clone() };
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let black_level = nominal.number.black_level;
    let lost = f64::max(1.0 - kernel.taps.iter().map(|tap| tap.weight * tap.weight).sum::<f64>(), 0.0);
    let dn = (0..frames.dn.len()).into_par_iter().with_min_len(1 << 12).map(|n| {
        let (frame, pixel) = (n / (width * height), n % (width * height));
        let (x, y) = (pixel % width, pixel / width);
        let signal = |tap: &Tap| {
            let (x, y) = (stand_in(x, tap.dx, width), stand_in(y, tap.dy, height));
            f64::max(f64::from(frames.dn[frame * width * height + y * width + x]) - black_level, LEAST_SIGNAL_DN)
        };
        let signal = mixed(kernel, signal);
        let (stated, share) = (nominal.stated_frame_sigma_dn(black_level + signal), frame_share * signal);
        let gone = libm::sqrt(lost * (stated * stated + share * share));
        let noise = if gone > 0.0 { gone * Random::new(MIXING, &[n as u64]).normal() } else { 0.0 };
        (black_level + signal + noise) as f32
    });
    Case { frames: Some(CaseFrames { times: frames.times.clone(), dn: dn.collect() }), ..case.clone() }
}

/// Light that moves by what was wanted less what was found of it.
fn moved(light: &Scene, wanted: &Scene, found: &Scene) -> Scene {
    let mut scene = Scene::from_pixels((0..light.len()).map(|n| {
        let (t, u) = light.pixel(n);
        if !wanted.is_known[n] || !found.is_known[n] {
            return (t.to_vec(), u.to_vec(), light.is_known[n]);
        }
        let mut knots: Vec<i64> = t.iter().chain(wanted.pixel(n).0).copied().collect();
        knots.sort_unstable();
        knots.dedup_by(|a, b| *a - *b < SAME_KNOT_NS);
        let at = |&knot: &i64| light.at(n, knot) + (wanted.at(n, knot) - found.at(n, knot)).clamp(-LARGEST_CORRECTION, LARGEST_CORRECTION);
        let u = knots.iter().map(at).collect();
        (knots, u, true)
    }));
    scene.log_evidence.clone_from(&wanted.log_evidence);
    scene
}

/// The argument at which a rising function has a value: secant steps from a guess.
fn inverse(of: impl Fn(f64) -> f64, guess: f64, value: f64) -> f64 {
    const STEPS: usize = 12;
    let mut x = (guess, guess * 1.01 + 1e-9);
    let mut y = (of(x.0), of(x.1));
    for _step in 0..STEPS {
        if (y.0 - value).abs() < 1e-6 || y.1 == y.0 {
            return x.0;
        }
        let next = x.0 - (y.0 - value) * (x.1 - x.0) / (y.1 - y.0);
        (x, y) = ((next, x.0), (of(next), y.0));
    }
    if x.0.is_finite() { x.0 } else { guess }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mismatch::{Mismatch, mismatch};
    use crate::scene::SceneSetting;
    use crate::testing;
    use serde_json::json;

    /// What a recording with effects costs when it is looked at as stated, and with the effects on the sensor.
    fn costs(effects: serde_json::Value) -> (f64, f64) {
        let effects: std::collections::BTreeMap<_, _> =
            effects.as_object().unwrap().iter().map(|(id, of)| (id.clone(), of.as_object().unwrap().clone())).collect();
        let case = testing::case_with(&effects);
        let nominal = case.nominal().unwrap();
        let sample = Sample::all(&case, 4);
        let setting = SceneSetting::close();
        let priors = vec![Prior::Glide { per_s3: 1e7, nu: 4.0 }; sample.len()];
        let cost = |trial: &Trial| {
            let under = Under::new(&case, trial, 0.0).unwrap();
            let (_, recording) = under.corrected(&sample, &setting, &priors, 1).unwrap();
            let all = mismatch(under.case(), &recording, &sample, &nominal, 0.004);
            all.iter().fold(Mismatch::default(), |sum, of| sum.and(of)).cost()
        };
        let stated = Trial::stated(&nominal);
        (cost(&stated), cost(&Trial { effects, ..stated.clone() }))
    }

    #[test]
    fn a_recording_agrees_with_the_sensor_that_made_it() {
        let tried = [
            json!({"clock_offset": {"offset": "500 us"}}),
            json!({"threshold_drift": {"rate": 6.0}}),
            json!({"black_level": {"black_level_dn": 30.0}}),
            json!({"leak_events": {"rate": "25 Hz"}}),
            json!({"reset_memory": {"fraction": 0.4}}),
            json!({"dark_current": {"current": 25.0}}),
            json!({"time_constant": {"tau_0": "400 us"}}),
            json!({"second_pole": {"tau": "300 us"}}),
            json!({"blur": {"sigma": 1.2}}),
        ];
        for effects in tried {
            let (stated, own) = costs(effects.clone());
            assert!(own < 0.6 * stated, "{effects}: {own} against {stated}");
        }
    }

    #[test]
    fn a_strong_kick_at_the_readout_is_undone() {
        // A weak one fires what a small error of the light decides, and agrees no better than none.
        let (stated, own) = costs(json!({"frame_coupling": {"step": 0.15, "period": "8 ms", "phase": "3 ms", "row_time": "20 us"}}));
        assert!(own < 0.8 * stated, "{own} against {stated}");
    }

    #[test]
    fn a_kick_of_the_front_end_fades() {
        let kick = |t_ns: i64, target| Kick { t_ns, change: 0.2, target };
        let all = standing(&[kick(5_000, KickTarget::FrontEnd), kick(1_000, KickTarget::Comparator)], 1e6);
        assert_eq!(all[..2], [(1_000, 0.2), (5_000, 0.2)]);
        // After one time constant 0.37 of it stands, and in the end nothing; the area is that of the exponential.
        let at = |t_ns: i64| all.iter().skip(1).filter(|step| step.0 <= t_ns).map(|step| step.1).sum::<f64>();
        assert!((at(1_005_000) - 0.2 * libm::exp(-1.0)).abs() < 0.2 / 8.0 && at(9_000_000).abs() < 1e-12);
        let area: f64 = all.iter().skip(1).map(|step| -step.1 * (step.0 - 5_000) as f64).sum();
        assert!((area / 0.2e6 - 1.0).abs() < 0.1, "{area}");
    }

    #[test]
    fn a_rising_function_is_turned_round() {
        let square = |x: f64| 3.0 * x * x + x;
        let found = inverse(square, 1.0, square(2.5));
        assert!((found - 2.5).abs() < 1e-6, "{found}");
    }
}
