//! What is special about the plan `field`: ten families of views, noise in half of the frames, and effects of
//! a stated multiple of their detection limit.

use crate::array::{Timing, run};
use crate::draw::{Picture, aims_at_light, survey, threshold};
use crate::effect::{Setting, Size, conceal};
use crate::limit::{Kept, Reference};
use crate::observe::Known;
use crate::plan::{Entry, Plan};
use crate::random::Random;
use crate::scene::{Family, Scene};
use crate::sensor::{Physics, Sensor};
use crate::views::View;
use serde_json::{Value, json};

/// Effects are drawn at these multiples of their limit, a third each.
const TIMES: [f64; 3] = [2.0, 5.0, 10.0];

/// Are the frames of a recording noisy, and does its description state it? Of a family's twelve recordings
/// six are noisy and three state it.
pub fn is_noisy(index: usize) -> [bool; 2] {
    let round_of_families = index / View::NAMES.len();
    [(round_of_families + index).is_multiple_of(2), (round_of_families / 2).is_multiple_of(2)]
}

/// Comparator noise of 0 to 3 % of the threshold; frames with noise, which the description states, where
/// `noisy` is so.
pub fn noise(sensor: &mut Sensor, [noisy, stated]: [bool; 2], entry: &Entry, random: &mut Random) {
    let round = |v: f64, digits: f64| (v * digits).round() / digits;
    sensor.threshold_noise = round(random.between(0.0, 0.03) * threshold(sensor), 1e5);
    let (electrons, read) = (random.between(5.0, 20.0), random.between(1.0, 2.0));
    if entry.condition == "strong_frame_noise" {
        return;
    }
    sensor.read_noise = if noisy { round(read, 100.0) } else { 0.0 };
    sensor.full_well = if noisy { (electrons * (sensor.saturation - sensor.black)).round() } else { 0.0 };
    sensor.states_frame_noise = noisy && stated;
}

/// One of the ten families by `name`, at a pace between 0.4 and 4 that comes near the events that are wanted.
pub fn picture(
    name: &str,
    index: usize,
    entry: &Entry,
    sensor: &Sensor,
    timing: &Timing,
    size: [usize; 2],
    random: &mut Random,
) -> Result<Picture, String> {
    let sigma = random.log_between(0.35, 1.0);
    let view = View::draw(name, random, size.map(|n| n as f64), sigma)
        .ok_or_else(|| format!("view `{name}`: no such family"))?;
    let light = random.log_between(20.0, 200.0);
    let contrast = random.between(if aims_at_light(entry) { 0.85 } else { 0.5 }, 0.95);
    let depth = threshold(sensor) * random.between(0.2, 0.35);
    let flicker = (entry.condition == "flicker")
        .then(|| [depth, if index.is_multiple_of(2) { 100.0 } else { 120.0 }, random.between(0.0, 6.0)]);
    let family = Family::View(Box::new(view.clone()));
    let mut scene = Scene { family, mean: libm::log(light), contrast, pace: 1.0, flicker };
    let wanted = random.between(30e3, 46e3);
    let mut events = 0.0;
    for _ in 0..4 {
        events = survey(&scene, timing, threshold(sensor), size).0.max(1.0);
        let factor: f64 = wanted / events;
        if (0.95..1.05).contains(&factor) {
            break;
        }
        scene.pace = (scene.pace * factor.clamp(0.3, 4.0)).clamp(0.4, 4.0);
    }
    let answer = json!({
        "family": name, "light_middle": light, "contrast_ln": contrast, "pace": scene.pace, "edge_px": sigma,
        "motion": view.answer(scene.pace),
        "flicker": flicker.map(|[depth, frequency, _]| json!({ "depth": depth, "frequency_hz": frequency })),
    });
    Ok(Picture { scene, light, events, answer, target: None })
}

/// A recording before its effects are concealed.
pub struct Plain<'a> {
    pub index: usize,
    pub entry: &'a Entry,
    pub scene: &'a Scene,
    pub timing: &'a Timing,
    pub size: [usize; 2],
    pub setting: &'a Setting,
    pub kept: Kept,
    pub has_t_in: bool,
}

/// Conceals the effects of an entry, each at a multiple of its limit with the nominal sensor alone; gives
/// their answers.
///
/// # Errors
/// An effect that does not exist.
pub fn conceal_all(plain: &Plain, physics: &mut Physics, random: &mut Random) -> Result<Vec<Value>, String> {
    if plain.entry.effects.is_empty() {
        return Ok(Vec::new());
    }
    let nominal = physics.clone();
    let [width, height] = plain.size;
    let mut events = run(plain.scene, &nominal, width, height, plain.timing, &mut random.split()).0;
    events.sort_by(|a, b| a.t_in.total_cmp(&b.t_in));
    let known = Known {
        scene: plain.scene,
        timing: plain.timing,
        size: plain.size,
        events: &events,
        has_t_in: plain.has_t_in,
    };
    let reference = Reference::new(known, &nominal, plain.setting, plain.kept);
    let mut answers = Vec::new();
    for (k, id) in plain.entry.effects.iter().enumerate() {
        let drawn = random.split();
        let limit = reference.limit(id, &drawn)?;
        let mut size = Size::default();
        let mut probe = nominal.clone();
        conceal(id, &mut probe, plain.setting, &mut drawn.clone(), &mut size)?;
        let times = limit.zip(size.range).map(|(limit, [_, most])| {
            let material = material(id, plain, &nominal, reference.signal());
            times(ordinal(plain.index, k), limit, material, most)
        });
        size.set = limit.zip(times).map(|(limit, times)| limit * times);
        let mut answer = conceal(id, physics, plain.setting, &mut drawn.clone(), &mut size)?.answer;
        answer["limit"] = times.and_then(|times| at_limit(&answer, times)).into();
        answer["times"] = times.into();
        answers.push(answer);
    }
    Ok(answers)
}

/// The number of an effect among all of the plan.
fn ordinal(index: usize, k: usize) -> usize {
    Plan::Field.entries()[..index].iter().map(|entry| entry.effects.len()).sum::<usize>() + k
}

/// The multiple of the limit: one of three by turns, or the next of 2, 5, 10, 20, 50 ... that makes the
/// effect material, or the one before that is no larger than `most`; where there is none, what makes it
/// `most`, or material.
fn times(ordinal: usize, limit: f64, material: f64, most: f64) -> f64 {
    let series = (0..12).map(|k| [1.0, 2.0, 5.0][k % 3] * libm::pow(10.0, (k / 3) as f64)).skip(1);
    let fits: Vec<f64> = series.filter(|times| (material..=most).contains(&(times * limit))).collect();
    let wanted = TIMES[ordinal % 3];
    let above = fits.iter().find(|times| **times >= wanted);
    let near = above.or(fits.last()).copied();
    near.unwrap_or_else(|| (2.0 * limit).clamp(material.min(most), most) / limit)
}

/// The limit in the unit of the effect's parameter: its distance from nominal, or, for what is stronger where
/// it is smaller, the parameter itself.
fn at_limit(answer: &Value, times: f64) -> Option<f64> {
    let parameters = answer["parameters"].as_object()?;
    let of = |key: &str| {
        let parameter = parameters.get(key)?;
        Some((parameter["actual"].as_f64()?, parameter["nominal"].as_f64()?))
    };
    match answer["id"].as_str()? {
        "slew_limit" => of("fall").map(|(actual, _)| actual * times),
        "high_pass_front_end" => of("tau_s").map(|(actual, _)| actual * times),
        "misalignment" => {
            let ((x, _), (y, _)) = (of("shift_x")?, of("shift_y")?);
            Some(libm::sqrt(x * x + y * y) / times)
        }
        "hot_pixels" => of("rate_hz").map(|(actual, _)| actual / times),
        _ => {
            let first = parameters.keys().next()?;
            of(first).map(|(actual, nominal)| (actual - nominal).abs() / times)
        }
    }
}

/// The size from which the catalogue counts an effect, in the unit of its [`Size`]; 0 where any counts.
fn material(id: &str, plain: &Plain, nominal: &Physics, signal: f64) -> f64 {
    let (step, setting, sensor) = (plain.kept.step, plain.setting, &nominal.sensor);
    let seconds = plain.timing.end - plain.timing.start;
    let (delay, time) = (f64::max(2e-6, 0.55 * step), f64::max(2e-6, 0.1 * step));
    let (share, spread, gain) = (0.001, 0.005 * sensor.on, 0.005);
    match id {
        "dark_current" => 0.005,
        "time_constant:tau_0" | "second_pole" | "second_pole:light" | "clock_offset" => delay,
        "time_constant" | "time_constant:less" => delay * setting.light / sensor.alpha,
        "threshold_scale" | "threshold_asymmetry" | "threshold_gradient" | "frame_nonlinearity" => gain,
        "threshold_drift" => gain / seconds,
        "threshold_mismatch" | "threshold_noise" | "refractory_spread" | "frame_gain_steps" => spread,
        // In thresholds.
        "frame_coupling" => 0.005,
        "refractory" | "timestamp_quantization" | "timestamp_jitter" | "row_skew:rows" => time,
        "row_skew" => time / setting.height as f64,
        "row_time" => 2e-6 / setting.height as f64,
        "exposure_time" => f64::max(4e-6, 1.1 * step),
        // As a load.
        "readout_queue" => time * setting.rate,
        "clock_drift" => time / seconds,
        "leak_events" | "background_activity" => 0.01,
        "black_level" => 0.005 * signal * 1023.0 / sensor.saturation,
        "bandwidth_gradient" | "reset_memory" | "reset_memory:over" | "lateral_inhibition" | "event_loss"
        | "crosstalk" | "vignetting" | "image_lag" => share,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn half_of_the_frames_are_noisy_and_half_of_those_say_so() {
        let entries = Plan::Field.entries();
        let mut counts: BTreeMap<&str, [usize; 3]> = BTreeMap::new();
        for (index, entry) in entries.iter().enumerate() {
            let mut random = Random::named("noise");
            let mut sensor = crate::draw::sensor(index, entry, &mut random);
            noise(&mut sensor, is_noisy(index), entry, &mut random);
            assert!((0.0..=0.031).contains(&(sensor.threshold_noise / threshold(&sensor))));
            let counts = counts.entry(View::NAMES[index % 10]).or_default();
            counts[0] += 1;
            counts[1] += usize::from(sensor.full_well > 0.0);
            counts[2] += usize::from(sensor.states_frame_noise);
            if sensor.full_well > 0.0 && entry.condition != "strong_frame_noise" {
                let electrons = sensor.full_well / (sensor.saturation - sensor.black);
                assert!((4.9..20.1).contains(&electrons) && (1.0..=2.0).contains(&sensor.read_noise));
            }
        }
        // Traps with strong noise, which is stated, change two of the families by one.
        assert!(counts.values().all(|[all, noisy, stated]| {
            *all == 12 && (6..=7).contains(noisy) && (3..=4).contains(stated)
        }));
    }

    #[test]
    fn multiples_of_the_limit_are_a_third_each_and_stay_within_bounds() {
        assert_eq!([0, 1, 2].map(|k| times(k, 1e-3, 0.0, 1.0)), [2.0, 5.0, 10.0]);
        // What is not material yet takes the next, what is larger than any that is drawn the one before.
        assert_eq!(times(0, 1e-3, 0.012, 1.0), 20.0);
        assert_eq!(times(2, 0.1, 0.0, 0.6), 5.0);
        assert!((0.1 * times(1, 0.1, 0.0, 0.15) - 0.15).abs() < 1e-12);
        assert!((0.1 * times(1, 0.1, 0.3, 0.4) - 0.3).abs() < 1e-12);
        let sized = Plan::Field.entries().iter().map(|entry| entry.effects.len()).sum::<usize>();
        assert_eq!(ordinal(Plan::Field.entries().len(), 0), sized);
    }
}
