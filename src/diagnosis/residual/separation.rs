//! Predicts by simulation which recording would separate two explanations.
//!
//! Both sensors are simulated on the light of the recording, unchanged and under conditions that a user can
//! set: faster, slower, dimmer, brighter, other thresholds, at rest, lens covered. Each simulated recording
//! is explained by both with the light known: the right one as it is, the other at its best size. The
//! difference in nats per second compares conditions.
//!
//! The required time follows from the present recording. There the gain of one over the other has a standard
//! error by blocks, which includes what the estimated scene absorbs and gets wrong. Three standard errors
//! need the square of their ratio, times the length of the recording. With a known target, and at rest, light
//! is known. The simulated gain itself counts then: half of nine nats.
//!
//! Limits: the load of a readout is that of the recording; noise is the stated one; frames saturate as in ten
//! times the light. The scene is assumed to absorb the same share at another speed or light.

use super::SampleView;
use super::fit::{ResidualRows, ResidualsAndSlopes, fit, gain_of};
use super::setting::LEAST_SLOPE;
use crate::candidates::{EffectScales, Trial};
use crate::curves::LogLightCurves;
use crate::record::{SimulatedConditions, record};
use crate::sample::PixelSample;
use photocurrent_core::{NodeError, Sensor};
use photocurrent_scene::case::Case;
use photocurrent_scene::light::LogLight;
use photocurrent_sensor::elementary::ln;

/// Light is taken this often where it moves, and where it is at rest, ns.
const STEP_NS: [i64; 2] = [100_000, 2_000_000];
/// Length of recordings at rest, ns.
const REST_NS: i64 = 2_000_000_000;
/// Pixels that are simulated; more are not needed for two digits.
const MOST_PIXELS: usize = 640;
/// Fewer evaluated events are no estimate of a gain.
const LEAST_EVENTS: usize = 60;
/// Least noise of events, shares of a threshold: that of an estimated scene.
const NOISE_FLOOR: f64 = 0.01;
/// Standard errors of a significant difference.
const CERTAIN: f64 = 3.0;
/// The shortest recording that is advised, frames.
const LEAST_FRAMES: f64 = 3.0;
/// Another condition is advised where it takes so much less time.
const WORTH_A_CHANGE: f64 = 0.8;
/// The longest recording that is advised, seconds.
const LONGEST_S: f64 = 3600.0;

/// A condition that a user can change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RecordingCondition {
    /// In words.
    pub name: &'static str,
    /// How many times as fast the scene moves; 0 at rest.
    speed: f64,
    /// Times the light.
    light: f64,
    /// Times the thresholds.
    thresholds: f64,
}

/// As the recording is.
const AS_IT_IS: RecordingCondition =
    RecordingCondition { name: "the same again", speed: 1.0, light: 1.0, thresholds: 1.0 };

const CHANGED: [RecordingCondition; 9] = [
    RecordingCondition { name: "the same scene twice as fast", speed: 2.0, ..AS_IT_IS },
    RecordingCondition { name: "the same scene four times as fast", speed: 4.0, ..AS_IT_IS },
    RecordingCondition { name: "the same scene half as fast", speed: 0.5, ..AS_IT_IS },
    RecordingCondition { name: "the same scene in a tenth of the light", light: 0.1, ..AS_IT_IS },
    RecordingCondition { name: "the same scene in ten times the light", light: 10.0, ..AS_IT_IS },
    RecordingCondition {
        name: "the same scene with thresholds a third lower",
        thresholds: 2.0 / 3.0,
        ..AS_IT_IS
    },
    RecordingCondition {
        name: "the same scene with thresholds half as high again",
        thresholds: 1.5,
        ..AS_IT_IS
    },
    RecordingCondition { name: "the same scene at rest", speed: 0.0, ..AS_IT_IS },
    RecordingCondition { name: "a covered lens", speed: 0.0, light: 1e-4, ..AS_IT_IS },
];

/// A recording that separates two explanations, and how long it has to be for three standard errors, seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SeparatingRecording {
    /// Name of the condition.
    pub name: &'static str,
    /// Required length, seconds; infinite where it does not separate them.
    pub seconds: f64,
}

/// Recordings that separate two explanations.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Separation {
    /// The shortest recording of all conditions; the unchanged condition where none is much shorter.
    pub best: SeparatingRecording,
    /// The unchanged condition.
    pub again: SeparatingRecording,
    /// The same before a scene that is known (`--scene`).
    pub known: SeparatingRecording,
    /// Share of the gain with known light that is left with an estimated scene.
    pub left: f64,
}

/// Two explanations of a recording: descriptions, and by how much the first one explains events better, nats
/// an event, with its standard error.
pub(crate) struct ExplanationPair<'a> {
    /// The better one first.
    pub sensors: [&'a Sensor; 2],
    /// Its gain over the other one on held-out events.
    pub gain: f64,
    /// Its standard error.
    pub gain_error: f64,
}

/// Gain of the right explanation over the other one.
#[derive(Clone, Copy, Debug, Default)]
struct ExpectedGain {
    /// Nats a second of the whole array.
    per_s: f64,
    /// And an event.
    per_event: f64,
}

/// The recording that separates a pair. `None` where too few events are simulated for the present condition,
/// or the two do not differ there.
///
/// # Errors
/// When a description does not state what the model needs, or effects cannot be combined.
pub(crate) fn separation(
    case: &Case,
    (sample, light): (&PixelSample, &LogLightCurves),
    pair: &ExplanationPair<'_>,
    seed: u64,
) -> Result<Option<Separation>, NodeError> {
    let (sample, places) = few_known_blocks(sample, light);
    if sample.is_empty() {
        return Ok(None);
    }
    let scene = SampledScene { case, sample: &sample, light, places: &places, seed };
    let again = scene.gain(&AS_IT_IS, pair)?;
    if again.per_event <= 0.0 {
        return Ok(None);
    }
    let left = (pair.gain / again.per_event).clamp(0.0, 1.0);
    let recorded_s = (case.span.1 - case.span.0) as f64 * 1e-9;
    let shortest_s = LEAST_FRAMES * EffectScales::from_case(case, &case.nominal()?).frame_period_s;
    let errors = pair.gain / pair.gain_error.max(f64::MIN_POSITIVE);
    let again_s =
        recorded_s * if errors > 0.0 { (CERTAIN / errors) * (CERTAIN / errors) } else { f64::INFINITY };
    let advised = |name: &'static str, seconds: f64| {
        let is_short = seconds.is_finite() && seconds <= LONGEST_S;
        SeparatingRecording { name, seconds: if is_short { seconds.max(shortest_s) } else { f64::INFINITY } }
    };
    // Half the square of standard errors is a gain in nats.
    let of_known_light = |gain: ExpectedGain| 0.5 * CERTAIN * CERTAIN / gain.per_s;
    let as_recorded = advised(AS_IT_IS.name, again_s);
    let known = advised("a known target", of_known_light(again));
    let mut best = as_recorded;
    for condition in &CHANGED {
        let gain = scene.gain(condition, pair)?;
        // Light at rest is known from frames.
        let is_known = condition.speed == 0.0;
        let seconds = if is_known { of_known_light(gain) } else { again_s * again.per_s / gain.per_s };
        let found = advised(condition.name, seconds);
        if found.seconds < WORTH_A_CHANGE * best.seconds {
            best = found;
        }
    }
    Ok(Some(Separation { best, again: as_recorded, known, left }))
}

/// Blocks of a sample with known light, about [`MOST_PIXELS`] pixels at most, and the indices of their
/// pixels.
fn few_known_blocks(sample: &PixelSample, light: &LogLightCurves) -> (PixelSample, Vec<usize>) {
    let each = sample.len().div_ceil(MOST_PIXELS).max(1) as u32;
    let is_known = |block: u32| {
        (0..sample.len()).filter(|n| sample.block[*n] == block).all(|n| light.is_known.get(n) == Some(&true))
    };
    let mut blocks: Vec<u32> = sample.block.clone();
    blocks.sort_unstable();
    blocks.dedup();
    blocks.retain(|block| is_known(*block));
    let kept: Vec<u32> = blocks.into_iter().step_by(each as usize).collect();
    sample.select_blocks(|block| kept.binary_search(&block).is_ok())
}

/// A recording with the light of some of its pixels.
struct SampledScene<'a> {
    case: &'a Case,
    sample: &'a PixelSample,
    light: &'a LogLightCurves,
    /// Where pixels of the sample are in the light.
    places: &'a [usize],
    seed: u64,
}

impl SampledScene<'_> {
    /// Gain of the right explanation of a pair under a condition; the smaller of both ways round.
    fn gain(
        &self,
        condition: &RecordingCondition,
        pair: &ExplanationPair<'_>,
    ) -> Result<ExpectedGain, NodeError> {
        let is_still = condition.speed == 0.0;
        let (start, end) = self.case.span;
        let span = if is_still { (start, start + REST_NS) } else { (start, end) };
        let described = |sensor: &Sensor| {
            let mut sensor = sensor.clone();
            let thresholds = [&mut sensor.comparator.threshold_on, &mut sensor.comparator.threshold_off];
            for threshold in thresholds {
                *threshold = threshold.map(|threshold| threshold * condition.thresholds);
            }
            sensor
        };
        let case = Case { span, sensor: described(&self.case.sensor), ..self.case.clone() };
        let sensors = pair.sensors.map(described);
        let trial = |sensor: &Sensor| -> Result<Trial, NodeError> {
            Ok(Trial { nominal: case.described(sensor)?, effects: sensor.effects.clone() })
        };
        let trials = [trial(&case.sensor)?, trial(&sensors[0])?, trial(&sensors[1])?];
        let light = self.light_of(&case, condition, STEP_NS[usize::from(is_still)]);
        let recorded = [1, 2].map(|k: usize| {
            let curves = LogLightCurves::from_pixels(self.sample.pixels.iter().map(|pixel| {
                let log = light.log[*pixel as usize].iter().map(|u| f64::from(*u)).collect();
                ((0..light.count).map(|n| light.instant(n)).collect(), log, true)
            }));
            let conditions =
                SimulatedConditions { seed: self.seed + k as u64, ..SimulatedConditions::default() };
            let trial = &trials[k];
            record(&case, &trial.nominal, self.sample, &curves, &trial.effects, &conditions)
                .map_err(NodeError::failed)
        });
        let [one, other] = recorded;
        let recorded = [one?, other?];
        let counts = recorded.each_ref().map(|case| case.events.len() as f64);
        let array = self.case.extent.pixels() as f64 / self.sample.len() as f64;
        let seconds = f64::max((span.1 - span.0) as f64 * 1e-9, 1e-9);
        let mut least: Option<ExpectedGain> = None;
        for (k, recorded) in recorded.iter().enumerate() {
            let pair = [&trials[0], &trials[1 + k], &trials[2 - k]].map(Clone::clone);
            let (per_event, events) = self.held_out_gain(recorded, &light, &pair)?;
            let mut nats = per_event * events as f64;
            if is_still {
                // Where nothing moves how many events there are is what is known.
                let [right, wrong] = [counts[k] + 0.5, counts[1 - k] + 0.5];
                nats += right * libm::log(right / wrong) - right + wrong;
            }
            let gain = ExpectedGain { per_s: nats * self.of_array(array, condition) / seconds, per_event };
            if least.is_none_or(|least| gain.per_s < least.per_s) {
                least = Some(gain);
            }
        }
        Ok(least.unwrap_or_default())
    }

    /// Pixels of the array per pixel of the sample. Blocks are the busiest ones: where something moves, as
    /// many as have its events.
    fn of_array(&self, array: f64, condition: &RecordingCondition) -> f64 {
        if condition.speed == 0.0 {
            return array;
        }
        let own: usize =
            self.sample.pixels.iter().map(|pixel| self.case.events.of_pixel(*pixel as usize).len()).sum();
        self.case.events.len() as f64 / f64::max(own as f64, 1.0)
    }

    /// Light under a condition: played forwards and backwards where it is faster, and from the middle on at
    /// rest.
    fn light_of(&self, case: &Case, condition: &RecordingCondition, step_ns: i64) -> LogLight {
        let mut light = LogLight::blank(case, step_ns);
        let (start, end) = self.case.span;
        let length = (end - start).max(1) as f64;
        let at = |k: usize| -> i64 {
            let share = if condition.speed == 0.0 {
                0.5
            } else {
                let there = condition.speed * (light.instant(k) - start) as f64 / length;
                let within = there - 2.0 * libm::floor(0.5 * there);
                if within > 1.0 { 2.0 - within } else { within }
            };
            start + (share * length) as i64
        };
        let instants: Vec<i64> = (0..light.count).map(at).collect();
        for (pixel, place) in self.sample.pixels.iter().zip(self.places) {
            let of = |t: &i64| (self.light.at(*place, *t) + ln(condition.light)) as f32;
            light.log[*pixel as usize] = instants.iter().map(of).collect();
        }
        light
    }

    /// Held-out gain of the second trial over the third at its best size, nats per evaluated event, and the
    /// number of events. The first trial is the stated sensor.
    fn held_out_gain(
        &self,
        case: &Case,
        light: &LogLight,
        trials: &[Trial; 3],
    ) -> Result<(f64, usize), NodeError> {
        let view = SampleView { case, light, pixels: self.sample.pixels.clone(), is_known: true };
        let (events, of) = view.residuals(trials, |_, _| true).map_err(NodeError::failed)?;
        let count = events.pixel.len();
        if count < LEAST_EVENTS {
            return Ok((0.0, 0));
        }
        let (frames, of_frames) = view.frames(trials).map_err(NodeError::failed)?;
        let whole = |k: usize| -> Vec<f64> {
            of[k].excess.iter().chain(&of_frames[k]).map(|value| f64::from(*value)).collect()
        };
        let [stated, right, wrong] = [whole(0), whole(1), whole(2)];
        let blocks = self.blocks();
        let block_of = |pixel: &u32| self.sample.index_of(*pixel as usize).map_or(0, |place| blocks[place]);
        let block: Vec<u32> = events.pixel.iter().chain(&frames.pixel).map(block_of).collect();
        let slope: Vec<f64> = events.slope_per_s.iter().chain(&frames.signal_dn).copied().collect();
        let pixel = &trials[0].nominal.pixel;
        let threshold = 0.5 * (pixel.threshold_on + pixel.threshold_off);
        let least = NOISE_FLOOR * threshold;
        let rows = ResidualRows { slope: &slope, block: &block, events: count, least, soft: None, free: &[] };
        let column: Vec<f32> =
            wrong.iter().zip(&stated).map(|(with, without)| (with - without) as f32).collect();
        let size = fit(&stated, &rows, &[&column], |_| true).0[0];
        let fitted: Vec<f64> =
            stated.iter().zip(&column).map(|(left, column)| left + size * f64::from(*column)).collect();
        let floor = LEAST_SLOPE * threshold / f64::max((case.span.1 - case.span.0) as f64 * 1e-9, 1e-6);
        let log = |k: usize| -> Vec<f32> {
            of[k].slope_per_s.iter().map(|slope| ln(f64::max(f64::from(slope.abs()), floor)) as f32).collect()
        };
        let (of_right, of_wrong) = (log(1), log(2));
        let right = ResidualsAndSlopes { residual: &right, log_slope: &of_right, rows: &rows };
        let wrong = ResidualsAndSlopes { residual: &fitted, log_slope: &of_wrong, rows: &rows };
        Ok((gain_of(wrong, right).0.max(0.0), count))
    }

    /// Number of the block of each pixel of the sample, without gaps.
    fn blocks(&self) -> Vec<u32> {
        let mut numbers: Vec<u32> = self.sample.block.clone();
        numbers.sort_unstable();
        numbers.dedup();
        let number = |block: &u32| numbers.partition_point(|one| one < block) as u32;
        self.sample.block.iter().map(number).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::EffectParameters;
    use crate::testing;
    use serde_json::json;

    /// A description with one more effect.
    fn with(id: &str, parameters: &serde_json::Value) -> Sensor {
        let effects: EffectParameters = [(id.to_owned(), parameters.as_object().unwrap().clone())].into();
        Sensor { effects, ..testing::sensor() }
    }

    /// Separation of the present pair, which gains `gain` with a standard error `error`, nats per event.
    fn separated(sensors: [&Sensor; 2], gain: f64, error: f64) -> Option<Separation> {
        let case = testing::case();
        let (sample, light) = (PixelSample::every_pixel(&case, 4), testing::scene(&case));
        let pair = ExplanationPair { sensors, gain, gain_error: error };
        separation(&case, (&sample, &light), &pair, 3).unwrap()
    }

    #[test]
    fn a_leak_shows_best_where_nothing_else_fires() {
        // 20 ON events a second and a pixel: over the 2 s of 120 pixels some 4,800, where unequal thresholds
        // fire none.
        let leak = with("leak_events", &json!({ "rate": "20 Hz" }));
        let asymmetry = with("threshold_asymmetry", &json!({ "fraction": -0.05 }));
        let found = separated([&leak, &asymmetry], 0.02, 0.01).unwrap();
        assert_eq!(found.best.name, "the same scene at rest", "{found:?}");
        // Two standard errors in 60 ms are three in 135 ms.
        assert!((found.again.seconds - 0.06 * 2.25).abs() < 1e-9, "{found:?}");
        assert!(found.best.seconds < found.again.seconds);
    }

    #[test]
    fn a_time_constant_and_a_late_clock_differ_more_in_dim_light() {
        // 5 ms over the light is 90 us at light 55, and 0.9 ms in a tenth of it; a clock is as late as ever.
        let slow = Sensor {
            front_end: photocurrent_core::sensor::FrontEnd {
                alpha: Some(photocurrent_core::quantity::Duration::new(10_000_000)),
                ..testing::sensor().front_end
            },
            ..testing::sensor()
        };
        let late = with("clock_offset", &json!({ "offset": "90 us" }));
        let case = testing::case();
        let (sample, light) = (PixelSample::every_pixel(&case, 4), testing::scene(&case));
        let places: Vec<usize> = (0..sample.len()).collect();
        let scene = SampledScene { case: &case, sample: &sample, light: &light, places: &places, seed: 3 };
        let pair = ExplanationPair { sensors: [&slow, &late], gain: 0.01, gain_error: 0.01 };
        let per_event = |condition: &RecordingCondition| scene.gain(condition, &pair).unwrap().per_event;
        let [again, dim, bright] =
            [1.0, 0.1, 10.0].map(|light| per_event(&RecordingCondition { light, ..AS_IT_IS }));
        assert!(dim > again && again > 2.0 * bright, "{dim} {again} {bright}");
        let found = separated([&slow, &late], 0.01, 0.01).unwrap();
        // One standard error in 60 ms: nine times as long.
        assert!((found.again.seconds - 0.54).abs() < 1e-9);
        assert!(found.best.seconds < 0.5 * found.again.seconds && found.known.seconds < 0.2, "{found:?}");
    }

    #[test]
    fn what_gains_nothing_at_hand_is_separated_by_known_light_alone() {
        let leak = with("leak_events", &json!({ "rate": "20 Hz" }));
        let late = with("clock_offset", &json!({ "offset": "200 us" }));
        let found = separated([&late, &leak], -0.001, 0.01).unwrap();
        assert!(found.again.seconds.is_infinite() && found.known.seconds.is_finite(), "{found:?}");
        // The same description twice.
        assert_eq!(separated([&leak, &leak.clone()], 0.01, 0.01), None);
    }

    #[test]
    fn known_light_takes_half_of_nine_nats() {
        // What a clock that is late moves no leak of any size explains, and the other way round.
        let late = with("clock_offset", &json!({ "offset": "60 us" }));
        let leak = with("leak_events", &json!({ "rate": "10 Hz" }));
        let case = testing::case();
        let (sample, light) = (PixelSample::every_pixel(&case, 4), testing::scene(&case));
        let places: Vec<usize> = (0..sample.len()).collect();
        let scene = SampledScene { case: &case, sample: &sample, light: &light, places: &places, seed: 3 };
        let gain = scene
            .gain(&AS_IT_IS, &ExplanationPair { sensors: [&late, &leak], gain: 1.0, gain_error: 1.0 })
            .unwrap();
        let found = separated([&late, &leak], 0.5, 0.5).unwrap();
        let shortest = LEAST_FRAMES * 8e-3;
        assert!((found.known.seconds - f64::max(4.5 / gain.per_s, shortest)).abs() < 1e-12);
        assert!(gain.per_event > 0.0 && gain.per_s > 0.0);
    }
}
