//! From an entry of the plan to a recording's sensor, scene and timing: everything is drawn from the
//! recording's own seed.

use crate::array::Timing;
use crate::effect::{self, Setting, Size, whole_ns};
use crate::field::{self, Plain};
use crate::frames::Numbers;
use crate::law::Law;
use crate::light::NODE;
use crate::limit::Kept;
use crate::plan::{Entry, Kind, Plan, outside};
use crate::random::Random;
use crate::scene::{Family, Grid, Scene};
use crate::sensor::{Physics, Queue, Reset, Sensor};
use crate::star::Target;
use crate::views::View;
use serde_json::{Value, json};

/// Steps between two nodes of light, 32 us apart: 4 us each.
pub const STEPS: usize = 8;

/// A recording before it is made.
pub struct Draft {
    /// Columns and rows.
    pub size: [usize; 2],
    pub nominal: Sensor,
    pub physics: Physics,
    pub scene: Scene,
    pub timing: Timing,
    pub numbers: Numbers,
    pub resolution: i64,
    pub has_t_in: bool,
    pub random: Random,
    /// Effects, scene and circumstances for the list of answers.
    pub answer: Value,
    /// Strength of a single effect over the least that is drawn of it.
    pub at_limit: Option<f64>,
    /// What states the target, where it is known.
    pub target: Option<String>,
}

/// What is seen.
pub struct Picture {
    pub scene: Scene,
    /// Typical photocurrent.
    pub light: f64,
    /// Events that are to be expected.
    pub events: f64,
    pub answer: Value,
    pub target: Option<Target>,
}

/// Draws recording `index` of a plan.
///
/// # Errors
/// An effect or law that does not exist.
pub fn draw(plan: Plan, index: usize, seed: &str) -> Result<Draft, String> {
    let entry = &plan.entries()[index];
    let mut random = Random::named(&plan.seed(seed, index));
    let size = size(plan, &mut random);
    let mut nominal = sensor(index, entry, &mut random);
    match plan {
        Plan::Target => noise_of_frames(&mut nominal, index.is_multiple_of(2), &mut random),
        Plan::Field => field::noise(&mut nominal, field::is_noisy(index), entry, &mut random),
        Plan::Outside => field::noise(&mut nominal, outside::is_noisy(index), entry, &mut random),
        Plan::Short | Plan::Long => {}
    }
    let (timing, exposure, rate_hz) = timing(plan, &mut random);
    let duration = timing.end - timing.start;
    let picture = match plan {
        Plan::Short | Plan::Long => moving(plan, index, entry, &nominal, &timing, size, &mut random),
        Plan::Target => target(&nominal, &timing, size, &mut random),
        Plan::Field => {
            let name = View::NAMES[index % View::NAMES.len()];
            field::picture(name, index, entry, &nominal, &timing, size, &mut random)?
        }
        Plan::Outside => field::picture(entry.family, index, entry, &nominal, &timing, size, &mut random)?,
    };
    let Picture { scene, light, events, answer: seen, target } = picture;

    let brightest = survey(&scene, &timing, threshold(&nominal), size).1;
    suit_light(&mut nominal, entry, brightest * exposure, light, &mut random);
    nominal.per_lux = target.as_ref().map_or(0.0, |target| target.per_lux);

    let mut physics = Physics::of(nominal.clone());
    if entry.condition == "shown_queue" {
        physics.queue = Some(Queue { service: whole_ns(0.6 * duration / events), shown: true });
    }
    let setting = Setting {
        light,
        period: timing.exposures[1][0] - timing.exposures[0][0],
        readout_phase: timing.exposures[0][1],
        width: size[0],
        height: size[1],
        rate: events / duration,
    };
    let (mut effects, mut at_limit) = (Vec::new(), None);
    // Limits go with how stamps and numbers are kept, which the other plans draw after the effects.
    let form = (plan == Plan::Field).then(|| Form::draw(entry, &mut random));
    if let Some(Form { numbers, resolution, has_t_in }) = form {
        let kept = Kept { step: resolution as f64 * 1e-9, numbers };
        let plain =
            Plain { index, entry, scene: &scene, timing: &timing, size, setting: &setting, kept, has_t_in };
        effects = field::conceal_all(&plain, &mut physics, &mut random)?;
    } else {
        for id in entry.effects {
            let concealed = effect::conceal(id, &mut physics, &setting, &mut random, &mut Size::default())?;
            effects.push(concealed.answer);
            at_limit = concealed.at_limit.filter(|_| entry.kind == Kind::Single);
        }
    }
    physics.law = entry.law.map(|name| law(name, &setting, &mut random)).transpose()?;
    let form = form.unwrap_or_else(|| Form::draw(entry, &mut random));
    let Form { numbers, resolution, has_t_in } = form;
    let mut off_catalogue = physics.law.as_ref().map(Law::answer);
    if plan == Plan::Outside
        && let (Some(answer), Some(law)) = (&mut off_catalogue, &physics.law)
    {
        answer["form"] = law.form().into();
    }
    let answer = json!({
        "kind": entry.kind.name(),
        "condition": entry.condition,
        "scene": seen,
        "recording": {
            "start_s": timing.start, "end_s": timing.end, "array_reset_at_start": timing.reset_at_start,
            "frame_rate_hz": rate_hz, "exposure_s": exposure,
            "frames": timing.exposures.len(), "whole_dn": numbers == Numbers::Whole,
            "t_resolution_ns": resolution, "t_in": has_t_in,
        },
        "effects": effects,
        "off_catalogue": off_catalogue,
        "sensor_nominal": nominal.answer(),
        "sensor_actual": physics.sensor.answer(),
    });
    let target = target.map(|target| target.file(&mut random));
    Ok(Draft {
        size,
        nominal,
        physics,
        scene,
        timing,
        numbers,
        resolution,
        has_t_in,
        random,
        answer,
        at_limit,
        target,
    })
}

/// Sets gain and `alpha` by the largest charge of a pixel and the mean light.
fn suit_light(nominal: &mut Sensor, entry: &Entry, brightest: f64, light: f64, random: &mut Random) {
    // The brightest pixel reads 85 % of full scale (a dim scene: 12 %); the time constant is what `sensor`
    // says at the mean light.
    let share = if entry.condition == "dim" { 0.12 } else { 0.85 };
    nominal.gain = (share * (nominal.saturation - nominal.black) / brightest).round();
    let slow = if entry.condition == "dim" {
        random.between(500e-6, 900e-6)
    } else {
        random.between(120e-6, 250e-6)
    };
    nominal.alpha = whole_ns(slow * light);
}

/// How a recording is written.
#[derive(Clone, Copy)]
struct Form {
    numbers: Numbers,
    /// Step of the stamps, ns.
    resolution: i64,
    has_t_in: bool,
}

impl Form {
    fn draw(entry: &Entry, random: &mut Random) -> Self {
        let numbers = if random.chance(0.15) { Numbers::Whole } else { Numbers::Sixteenths };
        let needs_fine_stamps =
            entry.effects.iter().any(|id| id.starts_with("timestamp")) || entry.condition == "shown_queue";
        let resolution = match random.unit() {
            u if u < 0.14 && !needs_fine_stamps => 20_000,
            u if u < 0.3 => 1,
            _ => 1000,
        };
        let has_t_in = !random.chance(0.15) || entry.condition == "shown_queue";
        Self { numbers, resolution, has_t_in }
    }
}

/// Does what it conceals show in a scene of a wide range of light?
pub fn aims_at_light(entry: &Entry) -> bool {
    let ids = ["dark_current", "parasitic_leak", "refractory_light", "black_level"];
    entry.effects.iter().any(|id| ids.contains(id)) || matches!(entry.law, Some("light" | "dim_noise"))
}

/// Columns and rows.
fn size(plan: Plan, random: &mut Random) -> [usize; 2] {
    match plan {
        Plan::Short | Plan::Field | Plan::Outside => [72, 54],
        Plan::Long => [96, 72],
        Plan::Target => [[64, 48], [72, 54], [80, 60], [96, 72]][random.below(4)],
    }
}

pub fn threshold(nominal: &Sensor) -> f64 {
    0.5 * (nominal.on + nominal.off)
}

/// One of the fourteen families, at a pace that gives the events that are wanted.
fn moving(
    plan: Plan,
    index: usize,
    entry: &Entry,
    nominal: &Sensor,
    timing: &Timing,
    size: [usize; 2],
    random: &mut Random,
) -> Picture {
    let name = match entry.family {
        "" => Family::NAMES[random.below(Family::NAMES.len())],
        name => name,
    };
    let edge = if entry.condition == "fast" { 0.5 } else { random.between(0.7, 1.3) };
    let family = Family::draw(name, random, size[0] as f64, size[1] as f64, edge);
    let light =
        if entry.condition == "dim" { random.log_between(2.0, 6.0) } else { random.log_between(20.0, 200.0) };
    let contrast = match entry.condition {
        "fast" => 0.9,
        "wide_range" => 1.5,
        _ => random.between(0.5, 0.95),
    };
    let contrast = if aims_at_light(entry) { contrast.max(0.85) } else { contrast };
    // Half a threshold from trough to crest: it moves events, and does not fire the whole array by itself.
    let depth = 0.5 * (nominal.on + nominal.off) * random.between(0.2, 0.35);
    let flicker = (entry.condition == "flicker")
        .then(|| [depth, if index.is_multiple_of(2) { 100.0 } else { 120.0 }, random.between(0.0, 6.0)]);
    let mut scene = Scene { family, mean: libm::log(light), contrast, pace: 1.0, flicker };
    let events = match (plan, entry.condition) {
        (Plan::Long, _) => random.between(230e3, 330e3),
        (_, "few_events") => random.between(3e3, 6e3),
        (_, "still_ground" | "dim") => random.between(15e3, 25e3),
        (_, "fast") => random.between(30e3, 40e3),
        _ => random.between(36e3, 46e3),
    };
    let pace = set_pace(&mut scene, timing, threshold(nominal), events, size);
    let answer = json!({
        "family": name, "light_middle": light, "contrast_ln": contrast, "pace": pace, "edge_px": edge,
        "flicker": flicker.map(|[depth, frequency, _]| json!({ "depth": depth, "frequency_hz": frequency })),
    });
    Picture { scene, light, events, answer, target: None }
}

/// A star that turns as fast as the events want that are to come out.
fn target(nominal: &Sensor, timing: &Timing, size: [usize; 2], random: &mut Random) -> Picture {
    let mut target = Target::draw(random, size);
    let events = random.log_between(80e3, 180e3);
    let scene_of = |target: &Target| {
        let family = Family::Star(target.star.clone());
        Scene { family, mean: libm::log(target.white()), contrast: 1.0, pace: 1.0, flicker: None }
    };
    let pace = set_pace(&mut scene_of(&target), timing, threshold(nominal), events, size);
    target.turn(pace, random);
    let light = target.white() * libm::sqrt(target.star.dark * target.star.bright);
    Picture { scene: scene_of(&target), light, events, answer: target.answer(pace), target: Some(target) }
}

/// Frames with photon and read noise, which is stated, or without any.
fn noise_of_frames(nominal: &mut Sensor, noisy: bool, random: &mut Random) {
    nominal.states_frame_noise = noisy;
    nominal.read_noise =
        if noisy { (random.between(30.0, 150.0) * nominal.saturation / 1023.0).round() / 100.0 } else { 0.0 };
    nominal.full_well = if noisy { random.between(8e3, 3e4).round() } else { 0.0 };
}

/// The described sensor, but for its gain and `alpha`, which belong to the light.
pub fn sensor(index: usize, entry: &Entry, random: &mut Random) -> Sensor {
    let on = random.between(0.13, 0.3);
    let off = on * (1.0 + random.sign() * random.between(0.015, 0.08));
    let round = |v: f64| (v * 1e4).round() / 1e4;
    let resamples = entry.effects.iter().any(|id| effect::needs_resampling(id))
        || matches!(entry.law, Some("row_reset" | "slow_comparator"))
        || entry.condition == "shown_queue";
    // Four in nine of those that may, so that about a third of all do.
    let advances = !resamples && (index * 5) % 9 < 4;
    let reset = match (advances, index % 2) {
        (true, 0) => Reset::Advance,
        (true, _) => Reset::AdvanceLossy,
        _ => Reset::Resample,
    };
    let long_blind = entry.effects.iter().any(|id| id.starts_with("refractory_"));
    let refractory = match random.unit() {
        _ if long_blind => random.between(200e-6, 300e-6),
        _ if entry.effects.contains(&"refractory") => random.between(50e-6, 120e-6),
        u if u < 0.1 && !resamples => 0.0,
        _ => random.between(20e-6, 300e-6),
    };
    let (latency_min, latency_more) = match entry.condition {
        "large_latency" => (random.between(60e-6, 120e-6), random.between(15e-6, 40e-6)),
        _ => (random.between(1e-6, 6e-6), random.between(2e-6, 6.5e-6)),
    };
    let saturation = if random.chance(0.7) { 1023.0 } else { 4095.0 };
    let scale = saturation / 1023.0;
    let black = (scale * random.between(0.0, 30.0)).round();
    let strong = entry.condition == "strong_frame_noise";
    let noisy = strong || entry.condition == "dim" || random.chance(0.6);
    let read_noise = if strong { random.between(3.0, 5.0) } else { random.between(0.3, 1.5) } * scale;
    let full_well = if strong { random.between(1500.0, 3000.0) } else { random.between(8e3, 3e4) };
    let states_frame_noise = noisy && (strong || random.chance(0.75));
    Sensor {
        tau_0: whole_ns(random.between(20e-6, 60e-6)),
        alpha: 0.0,
        on: round(on),
        off: round(off),
        threshold_noise: round(random.between(0.002, 0.008)),
        states_threshold_noise: random.chance(0.6),
        reset,
        refractory: whole_ns(refractory),
        latency_min: whole_ns(latency_min),
        latency_more: whole_ns(latency_more),
        gain: 0.0,
        black,
        saturation,
        row_time: (random.between(10e-6, 40e-6) * 1e7).round() / 1e7,
        read_noise: if noisy { (read_noise * 100.0).round() / 100.0 } else { 0.0 },
        full_well: if noisy { full_well.round() } else { 0.0 },
        states_frame_noise,
        per_lux: 0.0,
    }
}

/// Frames of 100 to 150 Hz over the plan's duration; also the exposure (s) and the rate (Hz).
fn timing(plan: Plan, random: &mut Random) -> (Timing, f64, f64) {
    let rate = random.between(100.0, 150.0).round();
    let period = whole_ns(1.0 / rate);
    let exposure = (random.between(3e-3, 5e-3) * 1e6).round() / 1e6;
    let start = 2e-3;
    let duration = match plan {
        Plan::Short | Plan::Field | Plan::Outside => random.between(0.12, 0.15),
        Plan::Long => 1.0,
        Plan::Target => random.between(0.15, 0.3),
    };
    let first = whole_ns(start + random.between(0.2e-3, 1.5e-3));
    // The last row of the last frame is exposed by the end: 54 rows take 2.2 ms at most, 72 rows 2.9 ms.
    let rows = if matches!(plan, Plan::Long | Plan::Target) { 3.1e-3 } else { 2.3e-3 };
    let count = ((duration - (first - start) - exposure - rows) / period).floor() as usize + 1;
    let exposures = (0..count).map(|l| first + l as f64 * period).map(|t| [t, t + exposure]).collect();
    let reset_at_start = random.chance(0.8);
    // The edges of a star are sharp: four times as many nodes, and steps as long as ever.
    let finer = if plan == Plan::Target { 4 } else { 1 };
    (
        Timing {
            start,
            end: start + duration,
            reset_at_start,
            node: NODE / finer as f64,
            steps: STEPS / finer,
            exposures,
        },
        exposure,
        rate,
    )
}

/// How often the light itself moves by a threshold, over all pixels, and the brightest light.
pub fn survey(scene: &Scene, timing: &Timing, threshold: f64, [width, height]: [usize; 2]) -> (f64, f64) {
    let grid = Grid { left: 0.0, top: 0.0, columns: width, rows: height };
    let (mut reference, mut now) = (vec![0.0; width * height], vec![0.0; width * height]);
    let (mut count, mut brightest) = (0.0, f64::NEG_INFINITY);
    // A recording of a second has as much to see in each half of a millisecond as a short one.
    let looks = if timing.end - timing.start > 0.5 { 2000 } else { 400 };
    for k in 0..=looks {
        let t = timing.start + (timing.end - timing.start) * f64::from(k) / f64::from(looks);
        scene.log_light(t, &grid, width as f64, height as f64, &mut now);
        if k == 0 {
            reference.copy_from_slice(&now);
        }
        for (reference, now) in reference.iter_mut().zip(&now) {
            let steps = ((now - *reference) / threshold).trunc();
            *reference += steps * threshold;
            count += steps.abs();
            brightest = f64::max(brightest, *now);
        }
    }
    (count, libm::exp(brightest))
}

/// Sets the scene's pace so that about `target` events are to be expected.
fn set_pace(scene: &mut Scene, timing: &Timing, threshold: f64, target: f64, size: [usize; 2]) -> f64 {
    for _ in 0..6 {
        let expected = survey(scene, timing, threshold, size).0.max(1.0);
        scene.pace = (scene.pace * (target / expected).clamp(0.3, 3.0)).clamp(0.05, 8.0);
    }
    scene.pace
}

/// A law outside the catalogue by name, with its strengths drawn.
fn law(name: &str, setting: &Setting, random: &mut Random) -> Result<Law, String> {
    Ok(match name {
        "hysteresis" => {
            Law::Hysteresis { rise: random.log_between(0.3, 0.6), decay: random.log_between(3e-3, 8e-3) }
        }
        "frame_kick" => {
            Law::FrameKick { rise: random.log_between(0.25, 0.5), decay: random.log_between(0.8e-3, 2e-3) }
        }
        "row_parity" => Law::RowParity { skew: random.log_between(0.06, 0.12) },
        "fatigue" => {
            Law::Fatigue { rise: random.log_between(0.06, 0.12), most: 5, gap: random.between(5e-3, 8e-3) }
        }
        "column_block" => {
            let spread = random.log_between(0.07, 0.13);
            let mut factors: Vec<f64> = (0..setting.width / 8).map(|_| spread * random.normal()).collect();
            let mean = factors.iter().sum::<f64>() / factors.len() as f64;
            factors.iter_mut().for_each(|f| *f += 1.0 - mean);
            Law::ColumnBlock { width: 8, factors }
        }
        "neighbour_delay" => Law::NeighbourDelay {
            delay: random.log_between(200e-6, 400e-6),
            window: random.between(300e-6, 600e-6),
        },
        "ripple" => Law::Ripple {
            depth: random.log_between(0.1, 0.2),
            frequency: if random.chance(0.5) { 180.0 } else { 240.0 },
            phase: random.between(0.0, 6.0),
        },
        "row_reset" => Law::RowReset { per_row: whole_ns(random.log_between(10e-6, 20e-6)) },
        "spatial_gradient" => Law::SpatialGradient { rise: random.log_between(0.15, 0.3), scale: 0.1 },
        "global_rate" => Law::GlobalRate {
            rise: random.log_between(0.2, 0.35),
            memory: random.between(1e-3, 2e-3),
            mean: setting.rate,
        },
        "row_rate" => Law::RowRate {
            rise: random.log_between(0.15, 0.3),
            memory: random.between(2e-3, 4e-3),
            mean: setting.rate / setting.height as f64,
        },
        "polarity_delay" => Law::PolarityDelay { delay: whole_ns(random.log_between(200e-6, 500e-6)) },
        "light" => Law::Light { rise: random.sign() * random.log_between(0.1, 0.2), middle: setting.light },
        "radius" => Law::Radius { rise: random.sign() * random.log_between(0.08, 0.16) },
        "slow_comparator" => Law::SlowComparator { strength: random.log_between(1e-3, 2e-3), most: 1e-3 },
        "telegraph" => Law::Telegraph {
            share: random.between(0.25, 0.4),
            jump: random.log_between(0.15, 0.3),
            dwell: random.between(15e-3, 30e-3),
        },
        "lag" => Law::Lag { rise: random.log_between(0.3, 0.6) },
        "time_step" => Law::TimeStep {
            rise: random.sign() * random.log_between(0.08, 0.16),
            at: random.between(50e-3, 90e-3),
        },
        "warming" => {
            Law::Warming { rise: random.log_between(0.25, 0.5), decay: random.log_between(20e-3, 50e-3) }
        }
        "row_band" => {
            let (from, rows) = (random.between(0.15, 0.55), random.between(0.15, 0.3));
            let first = (from * setting.height as f64) as usize;
            let last = first + (rows * setting.height as f64) as usize;
            Law::RowBand { rise: random.sign() * random.log_between(0.1, 0.2), first, last }
        }
        "column_wave" => Law::ColumnWave {
            depth: random.log_between(0.08, 0.16),
            period: random.between(14.0, 40.0),
            phase: random.between(0.0, 6.0),
        },
        "radius_off" => Law::RadiusOff { rise: random.sign() * random.log_between(0.1, 0.2) },
        "row_leak" => Law::RowLeak { rate: random.log_between(6.0, 12.0) },
        "row_loss" => Law::RowLoss { most: random.log_between(0.3, 0.6) },
        "dim_noise" => Law::DimNoise { share: random.log_between(0.05, 0.1), middle: setting.light },
        "parity_delay" => Law::ParityDelay { delay: whole_ns(random.log_between(100e-6, 300e-6)) },
        "delay_wave" => Law::DelayWave {
            depth: whole_ns(random.log_between(200e-6, 500e-6)),
            frequency: random.between(60.0, 160.0).round(),
            phase: random.between(0.0, 6.0),
        },
        "column_gain" => Law::ColumnGain { slope: random.sign() * random.log_between(0.1, 0.2) },
        _ => return Err(format!("law `{name}`: no such law; see `law.rs`")),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::PLAN;
    use crate::plan::outside::OUTSIDE;

    #[test]
    fn every_entry_of_the_plan_can_be_drawn() {
        // The survey of a scene is what takes time: one entry in eight, and every effect and law below.
        for plan in Plan::ALL {
            // Limits take longer still: three of the plan `field`.
            let every = if plan == Plan::Field { 47 } else { 8 };
            for (index, entry) in plan.entries().iter().enumerate().step_by(every) {
                let draft = draw(plan, index, "test").expect("an entry of the plan");
                assert_eq!(draft.answer["effects"].as_array().map(Vec::len), Some(entry.effects.len()));
                assert_eq!(draft.answer["off_catalogue"].is_null(), entry.kind != Kind::OffCatalogue);
                assert_eq!(draft.target.is_some(), plan == Plan::Target);
                for effect in draft.answer["effects"].as_array().into_iter().flatten() {
                    let stated = ["limit", "times"].map(|key| effect[key].as_f64().is_some_and(|v| v > 0.0));
                    assert_eq!(stated, [plan == Plan::Field; 2], "{effect}");
                }
            }
        }
        let setting =
            Setting { light: 50.0, period: 0.01, readout_phase: 0.0, width: 72, height: 54, rate: 3e5 };
        for entry in PLAN.iter().chain(OUTSIDE) {
            let mut random = Random::named("strengths");
            let mut physics = Physics::of(Sensor { alpha: 1e-3, ..sensor(0, entry, &mut random) });
            for id in entry.effects {
                let concealed =
                    effect::conceal(id, &mut physics, &setting, &mut random, &mut Size::default())
                        .expect("an effect of the plan");
                assert_eq!(
                    concealed.at_limit.is_none(),
                    ["large_signal_front_end", "refractory:law"].contains(id),
                    "{id}"
                );
                assert!(
                    concealed.at_limit.is_none_or(|times| (1.0..7.0).contains(&times)),
                    "{id}: {:?}",
                    concealed.at_limit
                );
                for (key, value) in concealed.answer["parameters"].as_object().expect("an object") {
                    assert!(
                        value["actual"] != value["nominal"]
                            || ["full_scale_dn", "row_time_s", "phase_s", "every"].contains(&key.as_str()),
                        "{id}: {key} {value}"
                    );
                }
            }
            if let Some(name) = entry.law {
                law(name, &setting, &mut random).expect("a law of the plan");
            }
        }
    }
}
