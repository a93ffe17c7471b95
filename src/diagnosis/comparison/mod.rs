//! The loop closed on events: what each description makes of the recording's own light, before and after each effect that is claimed.
//!
//! For the description as stated, and again with each claimed effect put on, the light is estimated as that sensor must have seen it ([`crate::under`]), the sensor looks at that light,
//! and what it records is held against the recording: by pixel, over time, over what the effect depends on ([`dependence`]), and as exactly rescaled intervals ([`calibration`]).
//! All of this is of pixels at which refits did not look, so a strength that was fitted to chance does not improve them; intervals are from block to block.
//!
//! Limits: an effect that is random has no events of its own to agree with, and shows in the calibration alone. Hot pixels and rows are left out with their pixels. An array
//! that is too small for blocks apart from those of the refit is looked at as a whole ([`Comparison::is_apart`]).

pub mod calibration;
pub mod dependence;

use crate::candidates::{CANDIDATES, Scales, Trial};
use crate::case::{Case, PixelEvents, Recorded};
use crate::deviation::unstated_frame_noise;
use crate::faithful::faithful;
use crate::fitted::put_beside;
use crate::heldout::kept_back;
use crate::mismatch::{Mismatch, for_each_cost, mismatch};
use crate::nominal::Nominal;
use crate::record::{Conditions, record};
use crate::refit::Refit;
use crate::report::six_digits;
use crate::sample::Sample;
use crate::scene::{Scene, SceneSetting};
use crate::search::SearchSetting;
use crate::under::Under;
use crate::verdict::{Claim, Valued};
use calibration::Calibration;
use dependence::{Dependence, Looked};
use photocurrent_sensor::likelihood::Interval;
use photocurrent_sensor::map::Prior;
use rayon::prelude::*;

/// Parts of the recording in which mismatch over time is told.
pub const TIME_BINS: usize = 60;
/// Corrections of the light.
const TURNS: usize = 1;
/// Seed of the control's noise.
const CONTROL: u64 = 2;
/// Fewest blocks that intervals are made of.
const FEWEST_BLOCKS: usize = 4;
/// An array of at most so many pixels is looked at as a whole where there are no blocks.
const MOST_PIXELS: usize = 600;
/// Threshold noise that intervals are rescaled with where none is stated, as a share of the ON threshold; recording and control alike.
const USUAL_SIGMA: f64 = 0.1;

/// A description, and how it fares.
#[derive(Clone, Debug)]
pub struct Step {
    /// The effect that was put on last; none as stated.
    pub id: Option<&'static str>,
    /// Has that effect no events of its own to agree with? Then all but the calibration is that of the step before.
    pub is_random: bool,
    /// Mismatch of each pixel of the sample.
    pub by_pixel: Vec<Mismatch>,
    /// Mismatch of each block.
    pub blocks: Vec<Mismatch>,
    /// Of [`TIME_BINS`] equal parts of the recording, the cost of the events of both and their number, both halved.
    pub by_time: Vec<(f64, f64)>,
    /// Rescaled intervals against those of a simulated recording that was treated alike; none with too few events.
    pub calibration: Option<Calibration>,
    /// Frames that were kept back, predicted from the events and the other frames as this sensor must have seen them: peak signal to noise, dB. None with fewer than five
    /// frames, and where frames are compared as mixtures of neighbours.
    pub kept_psnr_db: Option<f64>,
    /// The light that this description must have seen.
    pub light: Scene,
    /// What it fires at that light.
    pub fired: PixelEvents,
}

impl Step {
    /// All pixels together.
    pub fn all(&self) -> Mismatch {
        self.blocks.iter().fold(Mismatch::default(), |sum, of| sum.and(of))
    }

    /// Cost of an event, 0 to 1.
    pub fn cost_per_event(&self) -> f64 {
        let all = self.all();
        all.events / f64::max(all.count, 1.0)
    }

    /// Root mean square of frame residuals, in standard deviations.
    pub fn frame_residual(&self) -> f64 {
        let all = self.all();
        libm::sqrt(all.frames / f64::max(all.frame_count, 1.0))
    }

    /// Log of how well an event is foretold, nats.
    pub fn nats_per_event(&self) -> f64 {
        let all = self.all();
        all.nats / f64::max(all.recorded, 1.0)
    }

    /// What this gains over another description.
    pub fn gain_over(&self, before: &Step) -> Gain {
        let (old, new) = (&before.blocks, &self.blocks);
        let used: Vec<usize> = (0..old.len()).filter(|&block| old[block].count + new[block].count > 0.0).collect();
        let n = used.len() as f64;
        let share = |left_out: Option<usize>| {
            // An event: a sensor that fires less has fewer events that can be wrong.
            let an_event = |of: &[Mismatch]| {
                let rest = used.iter().filter(|&&block| Some(block) != left_out);
                let (cost, count) = rest.fold((0.0, 0.0), |sum, &block| (sum.0 + of[block].cost(), sum.1 + of[block].count));
                cost / f64::max(count, 1.0)
            };
            1.0 - an_event(new) / f64::max(an_event(old), 1e-12)
        };
        let all = share(None);
        let left_out: Vec<f64> = used.iter().map(|&block| share(Some(block))).collect();
        let mean = left_out.iter().sum::<f64>() / f64::max(n, 1.0);
        let error = libm::sqrt((n - 1.0) / f64::max(n, 1.0) * left_out.iter().map(|one| (one - mean) * (one - mean)).sum::<f64>());
        let nats: Vec<f64> = used.iter().map(|&block| new[block].nats - old[block].nats).collect();
        let sum: f64 = nats.iter().sum();
        let spread: f64 = nats.iter().map(|one| (one - sum / n) * (one - sum / n)).sum();
        let nats_error = libm::sqrt(n / f64::max(n - 1.0, 1.0) * spread);
        let around = |value: f64, error: f64| [value - 1.96 * error, value + 1.96 * error];
        Gain {
            share: all,
            share_ci95: around(all, error),
            nats: sum,
            nats_ci95: around(sum, nats_error),
            nats_per_event: sum / f64::max(before.all().recorded, 1.0),
        }
    }
}

/// What a step gains over another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gain {
    /// Share of the other's mismatch an event (events and frames) that it takes away, and its 95 % interval from block to block.
    pub share: f64,
    /// See there.
    pub share_ci95: [f64; 2],
    /// Nats that recorded events are better foretold by, all together, and their 95 % interval.
    pub nats: f64,
    /// See there.
    pub nats_ci95: [f64; 2],
    /// The same an event.
    pub nats_per_event: f64,
}

/// The description as stated, and with one effect after the other.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// The pixels.
    pub sample: Sample,
    /// Did refits not look at any of them?
    pub is_apart: bool,
    /// As stated first.
    pub steps: Vec<Step>,
    /// How mismatch depends on what the first effect depends on, as stated and as fitted.
    pub dependences: Vec<Dependence>,
}

impl Comparison {
    /// As stated.
    pub fn before(&self) -> &Step {
        &self.steps[0]
    }

    /// With everything that is claimed; none when nothing is.
    pub fn after(&self) -> Option<&Step> {
        self.steps.last().filter(|_| self.steps.len() > 1)
    }

    /// What a step gains over an earlier one.
    pub fn gain(&self, from: usize, to: usize) -> Gain {
        self.steps[to].gain_over(&self.steps[from])
    }
}

/// A recording (without pixels that direct tests exclude) and its pixels that are compared, as stated.
pub struct Ground<'a> {
    case: &'a Case,
    nominal: &'a Nominal,
    scales: &'a Scales,
    /// The pixels.
    sample: Sample,
    /// Did refits not look at any of them?
    pub is_apart: bool,
    scene: SceneSetting,
    priors: Vec<Prior>,
    frame_noise: f64,
    stated: Trial,
    before: (Step, Option<View>),
}

impl<'a> Ground<'a> {
    /// Looks at the recording as stated. None where no pixels can be compared.
    ///
    /// # Errors
    /// When effects cannot be combined.
    pub fn new(case: &'a Case, nominal: &'a Nominal, scales: &'a Scales) -> Result<Option<Ground<'a>>, String> {
        let Some((sample, is_apart)) = pixels(case) else { return Ok(None) };
        let frame_noise = unstated_frame_noise(case, nominal)?;
        let usual = SceneSetting::close();
        let scene = SceneSetting { frame_share: libm::sqrt(usual.frame_share * usual.frame_share + frame_noise * frame_noise), ..usual };
        let priors = faithful(case, nominal, &sample, &scene)?.priors;
        let stated = Trial::stated(nominal);
        let refit = Refit { case, base: &stated, scales, sample: &sample, scene: &scene, priors: &priors, frame_noise, turns: TURNS };
        let before = look(&refit, &Described::stated(case, &stated), None, None)?;
        Ok(Some(Ground { case, nominal, scales, sample, is_apart, scene, priors, frame_noise, stated, before }))
    }

    fn refit(&self) -> Refit<'_> {
        let Ground { case, scales, sample, scene, priors, frame_noise, stated, .. } = self;
        Refit { case, base: stated, scales, sample, scene, priors, frame_noise: *frame_noise, turns: TURNS }
    }

    /// As stated.
    pub fn before(&self) -> &Step {
        &self.before.0
    }

    /// With values of effects put on that are not random.
    ///
    /// # Errors
    /// When effects cannot be combined.
    pub fn with(&self, values: &[Valued]) -> Result<Step, String> {
        let mut described = Described::stated(self.case, &self.stated);
        described.put(values, self.nominal, self.scales);
        Ok(look(&self.refit(), &described, None, None)?.0)
    }

    /// Compares the recording with its description as stated and with each claim put on.
    ///
    /// # Errors
    /// When effects cannot be combined.
    pub fn compare(self, claims: &[Claim]) -> Result<Comparison, String> {
        let mut described = Described::stated(self.case, &self.stated);
        let mut steps: Vec<(Step, Option<View>)> = Vec::new();
        for claim in claims.iter().filter(|claim| !claim.values.is_empty() && !matches!(claim.id, "hot_pixels" | "hot_rows")) {
            let is_random = described.put(&claim.values, self.nominal, self.scales);
            if let Some(finding) = &claim.finding {
                let Described { seen, whole, .. } = &mut described;
                [seen, whole].into_iter().for_each(|trial| put_beside(&mut trial.effects, finding.id, &finding.parameters));
            }
            let (before, _) = steps.last().unwrap_or(&self.before);
            let step = look(&self.refit(), &described, Some(claim.id), Some(before).filter(|_| is_random))?;
            steps.push(step);
        }
        steps.insert(0, self.before);
        let views: Vec<&View> = steps.iter().filter_map(|(_, view)| view.as_ref()).collect();
        let dependences = match (claims.iter().find_map(|claim| dependence::covariate(claim.id)), views.first(), views.last()) {
            (Some(of), Some(before), Some(after)) if views.len() > 1 => {
                let [before, after] = [before, after].map(|view| Looked::new(&view.case, &self.sample, &view.light, &view.recording, self.nominal));
                dependence::dependences(of, &before, &after)
            }
            _ => Vec::new(),
        };
        Ok(Comparison { steps: steps.into_iter().map(|(step, _)| step).collect(), sample: self.sample, is_apart: self.is_apart, dependences })
    }
}

/// Blocks like those of the refit, and apart from them where the array has room; a small array as a whole.
fn pixels(case: &Case) -> Option<(Sample, bool)> {
    let SearchSetting { zones, side, events, .. } = SearchSetting::default();
    let taken = Sample::blocks(case, zones, side, 0, events);
    let apart = Sample::blocks_apart(case, zones, side, 0, events, &taken);
    let blocks = |sample: &Sample| sample.len() / (side * side) as usize;
    if blocks(&apart) >= FEWEST_BLOCKS {
        Some((apart, true))
    } else if blocks(&taken) >= FEWEST_BLOCKS {
        Some((taken, false))
    } else {
        (case.extent.pixels() <= MOST_PIXELS).then(|| (Sample::all(case, 4), false))
    }
}

/// A description that grows by one effect after the other.
struct Described {
    /// What has events of its own: this is undone.
    seen: Trial,
    /// Everything: this is what the control is recorded with.
    whole: Trial,
    t_resolution_ns: i64,
}

impl Described {
    fn stated(case: &Case, stated: &Trial) -> Described {
        Described { seen: stated.clone(), whole: stated.clone(), t_resolution_ns: case.t_resolution_ns }
    }

    /// Puts values of an effect on; is it all random?
    fn put(&mut self, values: &[Valued], nominal: &Nominal, scales: &Scales) -> bool {
        let mut is_random = true;
        for &(which, value, _) in values {
            let candidate = &CANDIDATES[which];
            let value = six_digits(value);
            let strength = candidate.strength(value, scales, nominal);
            candidate.put_on(&mut self.whole, strength, scales);
            if !candidate.is_random {
                candidate.put_on(&mut self.seen, strength, scales);
                is_random = false;
            }
            if candidate.id == "timestamp_quantization" {
                self.t_resolution_ns = (value * 1e9).round() as i64;
            }
        }
        is_random
    }
}

/// What a step was made of.
struct View {
    /// The recording as the description compares it.
    case: Case,
    light: Scene,
    recording: Case,
}

/// One description; of a random effect, what `before` has stands.
fn look(refit: &Refit<'_>, described: &Described, id: Option<&'static str>, before: Option<&Step>) -> Result<(Step, Option<View>), String> {
    let (sample, scene, priors) = (refit.sample, refit.scene, refit.priors);
    let case = Case { t_resolution_ns: described.t_resolution_ns, ..refit.case.clone() };
    let under = Under::new(&case, &described.seen, refit.frame_noise)?;
    let (light, recording) = under.corrected(sample, scene, priors, refit.turns)?;
    // A recording of the whole description, to be treated alike: what estimation leaves where nothing is missing.
    let conditions = Conditions { seed: CONTROL, frame_share: refit.frame_noise, is_mixed: true, ..Conditions::default() };
    let control = record(under.case(), &described.whole.nominal, sample, &light, &described.whole.effects, &conditions)?;
    let own = Refit { base: &described.seen, ..*refit }.behind_mixing();
    let behind = Under::new(&control, &own, refit.frame_noise)?;
    // Light that believes events too closely bends to them, and hides what is wrong.
    let loose = SceneSetting { noise: SceneSetting::default().noise, ..*scene };
    let own_light = under.estimate(under.case(), sample, &loose, priors);
    let again = behind.estimate(&control, sample, &loose, priors);
    let nominal = &refit.base.nominal;
    let sigma = if nominal.threshold_noise > 0.0 { nominal.threshold_noise } else { USUAL_SIGMA * nominal.pixel.threshold_on };
    let rescaled = |under: &Under<'_>, recorded: &Case, light: &Scene| -> Vec<(u32, f64)> {
        let uniform = |n: usize| -> Vec<(u32, f64)> {
            let told = under.rescaled(recorded, scene, sample, light, n, sigma);
            let block = sample.block[n];
            told.iter().filter(|interval: &&Interval| interval.event.is_some()).map(|interval| (block, interval.uniform)).collect()
        };
        (0..sample.len()).into_par_iter().with_min_len(16).flat_map_iter(uniform).collect()
    };
    let calibration = Calibration::new(&rescaled(&under, under.case(), &own_light), &rescaled(&behind, &control, &again));
    if let Some(before) = before {
        return Ok((Step { id, is_random: true, calibration, ..before.clone() }, None));
    }
    let by_pixel = mismatch(under.case(), &recording, sample, nominal, scene.frame_share);
    let mut blocks = vec![Mismatch::default(); sample.block_count];
    for (of, &block) in by_pixel.iter().zip(&sample.block) {
        blocks[block as usize] = blocks[block as usize].and(of);
    }
    let by_time = over_time(under.case(), &recording, sample);
    let kept_psnr_db = kept_psnr_db(refit, &under, &described.seen)?;
    let view = View { case: under.case().clone(), light: light.clone(), recording: recording.clone() };
    Ok((Step { id, is_random: false, by_pixel, blocks, by_time, calibration, kept_psnr_db, light, fired: recording.events }, Some(view)))
}

/// Frames that are kept back, as a trial would have read them; the noise that the description states stands in them.
fn kept_psnr_db(refit: &Refit<'_>, under: &Under<'_>, trial: &Trial) -> Result<Option<f64>, String> {
    let Some((rest, kept)) = kept_back(under.case()).filter(|_| !under.has_mixed_frames()) else { return Ok(None) };
    let sample = refit.sample;
    let light = under.estimate(&rest, sample, refit.scene, refit.priors);
    let read = record(under.case(), &trial.nominal, sample, &light, &trial.effects, &Conditions { seed: CONTROL, is_mixed: true, ..Conditions::default() })?;
    let saturation_dn = trial.nominal.saturation_dn;
    let (mut squares, mut count, mut largest) = (0.0, 0.0, 0.0_f64);
    for (&pixel, _) in sample.pixels.iter().zip(&light.is_known).filter(|(_, is_known)| **is_known) {
        for &frame in &kept {
            let (here, there) = (under.case().dn(frame, pixel as usize), read.dn(frame, pixel as usize));
            if here.is_finite() && here < saturation_dn && there.is_finite() {
                squares += (there - here) * (there - here);
                count += 1.0;
                largest = largest.max(here);
            }
        }
    }
    let peak_dn = if saturation_dn.is_finite() { saturation_dn } else { largest };
    Ok((count > 0.0).then(|| 10.0 * libm::log10(peak_dn * peak_dn / f64::max(squares / count, 1e-12))))
}

/// Cost and number of the events of both recordings, halved, in equal parts of the time.
fn over_time(case: &Case, other: &Case, sample: &Sample) -> Vec<(f64, f64)> {
    let mut bins = vec![(0.0, 0.0); TIME_BINS];
    let (start_ns, end_ns) = case.span;
    let mut add = |events: &[Recorded], others: &[Recorded]| {
        let mut at = events.iter();
        for_each_cost(events, others, |cost| {
            let t_ns = at.next().map_or(start_ns, |event| event.t_in_ns);
            let bin = ((t_ns - start_ns).max(0) as f64 / (end_ns - start_ns).max(1) as f64 * TIME_BINS as f64) as usize;
            let bin = &mut bins[bin.min(TIME_BINS - 1)];
            *bin = (bin.0 + 0.5 * cost, bin.1 + 0.5);
        });
    };
    for &pixel in &sample.pixels {
        let (here, there) = (case.events.of(pixel as usize), other.events.of(pixel as usize));
        add(here, there);
        add(there, here);
    }
    bins
}

#[cfg(test)]
mod tests;
