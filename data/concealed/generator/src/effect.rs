//! The effects of the catalogue: for each id, how strong it is drawn and what it changes.
//!
//! Ids, parameters, units and signs are those of the project's file formats; strengths are what an engineer
//! would want to be told of.

use crate::random::Random;
use crate::sensor::{Physics, Queue, Reset};
use serde_json::{Map, Value, json};

/// What strengths are measured by.
#[derive(Clone, Copy, Debug)]
pub struct Setting {
    /// Typical photocurrent of the scene.
    pub light: f64,
    pub period: f64,
    pub readout_phase: f64,
    pub width: usize,
    pub height: usize,
    /// Events a second that are expected of the whole array.
    pub rate: f64,
}

/// Every id of the catalogue.
pub const IDS: [&str; 41] = [
    "dark_current",
    "time_constant",
    "second_pole",
    "large_signal_front_end",
    "slew_limit",
    "high_pass_front_end",
    "bandwidth_gradient",
    "threshold_scale",
    "threshold_asymmetry",
    "threshold_mismatch",
    "threshold_noise",
    "threshold_drift",
    "threshold_gradient",
    "refractory",
    "refractory_spread",
    "refractory_light",
    "reset_memory",
    "leak_events",
    "parasitic_leak",
    "background_activity",
    "hot_pixels",
    "hot_rows",
    "lateral_inhibition",
    "readout_queue",
    "event_loss",
    "timestamp_quantization",
    "timestamp_jitter",
    "clock_offset",
    "clock_drift",
    "row_skew",
    "frame_coupling",
    "misalignment",
    "blur",
    "crosstalk",
    "black_level",
    "frame_nonlinearity",
    "vignetting",
    "row_time",
    "exposure_time",
    "frame_gain_steps",
    "image_lag",
];

/// Does this effect say something only of a reset that samples the voltage?
pub fn needs_resampling(id: &str) -> bool {
    let all = [
        "refractory",
        "refractory_spread",
        "refractory_light",
        "reset_memory",
        "background_activity",
        "hot_pixels",
        "hot_rows",
        "readout_queue",
        "refractory:law",
    ];
    all.contains(&id)
}

/// Whole nanoseconds: what a text with a unit can say.
pub fn whole_ns(t: f64) -> f64 {
    (t * 1e9).round() / 1e9
}

/// An effect that was put in.
pub struct Concealed {
    /// Its entry in the list of answers.
    pub answer: Value,
    /// How many times as strong it is as the weakest that is ever drawn; none where strength is no number.
    pub at_limit: Option<f64>,
}

/// The size of an effect: drawn, or set from outside, as the plan `field` does.
#[derive(Clone, Copy, Debug, Default)]
pub struct Size {
    /// The size to be used in place of a drawn one.
    pub set: Option<f64>,
    /// The least and the largest that are drawn, in the same unit; none for an effect without a size.
    pub range: Option<[f64; 2]>,
    /// The size over the least that is drawn.
    pub at_limit: Option<f64>,
}

impl Size {
    /// Notes the range, and gives what is set or else the drawn size.
    fn take(&mut self, drawn: f64, low: f64, high: f64) -> f64 {
        self.range = Some([low, high]);
        self.set.unwrap_or(drawn)
    }

    /// Draws log-uniform in `low` .. `high` unless the size is set, and notes how far above `low` it is.
    fn log_between(&mut self, random: &mut Random, low: f64, high: f64) -> f64 {
        let size = self.take(random.log_between(low, high), low, high);
        self.at_limit = Some(size / low);
        size
    }
}

/// Changes `physics` by the effect `id` (`id:variant` for another form of it) and says what it did.
///
/// # Errors
/// An id that is not in the catalogue.
pub fn conceal(
    id: &str,
    physics: &mut Physics,
    setting: &Setting,
    random: &mut Random,
    size: &mut Size,
) -> Result<Concealed, String> {
    let mut parameters = Map::new();
    let mut equation = None;
    let mut say = |name: &str, actual: f64, nominal: f64, unit: &str| {
        parameters.insert(name.to_string(), json!({ "actual": actual, "nominal": nominal, "unit": unit }));
    };
    let sensor = &mut physics.sensor;
    let (plain, variant) = id.split_once(':').unwrap_or((id, ""));
    match plain {
        "dark_current" => {
            physics.dark = setting.light * size.log_between(random, 0.1, 0.35);
            say("current", physics.dark, 0.0, "photocurrent");
        }
        "time_constant" if variant == "tau_0" => {
            let nominal = sensor.tau_0;
            sensor.tau_0 = whole_ns(nominal + size.log_between(random, 120e-6, 350e-6));
            say("tau_0_s", sensor.tau_0, nominal, "s");
        }
        "time_constant" => {
            let nominal = sensor.alpha;
            let (factor, limit) = if variant == "less" {
                (random.between(0.3, 0.5), 0.5)
            } else {
                (random.log_between(1.8, 3.0), 1.8)
            };
            let most = if variant == "less" { 0.7 } else { 2.0 };
            let change = size.take((factor - 1.0f64).abs(), (limit - 1.0f64).abs(), most);
            let factor = if size.set.is_none() {
                factor
            } else if variant == "less" {
                1.0 - change
            } else {
                1.0 + change
            };
            size.at_limit = Some((factor - 1.0) / (limit - 1.0));
            sensor.alpha = whole_ns(nominal * factor);
            say("alpha_s", sensor.alpha, nominal, "s");
        }
        "second_pole" if variant == "light" => {
            physics.second_light = whole_ns(setting.light * size.log_between(random, 120e-6, 350e-6));
            say("tau_light_s", physics.second_light, 0.0, "s");
        }
        "second_pole" => {
            physics.second_tau = whole_ns(size.log_between(random, 100e-6, 400e-6));
            say("tau_s", physics.second_tau, 0.0, "s");
        }
        "large_signal_front_end" => physics.large_signal = true,
        "slew_limit" => {
            // The slower the stronger: the size is one over the limit.
            physics.fall = random.log_between(20.0, 45.0);
            let slow = size.take(1.0 / physics.fall, 1.0 / 45.0, 1.0 / 20.0);
            if size.set.is_some() {
                physics.fall = 1.0 / slow;
            }
            size.at_limit = Some(45.0 / physics.fall);
            say("fall", physics.fall, 1e9, "ln/s");
            if variant == "both" {
                let drawn = random.log_between(20.0, 45.0);
                physics.rise = if size.set.is_some() { physics.fall } else { drawn };
                say("rise", physics.rise, 1e9, "ln/s");
            }
        }
        "high_pass_front_end" => {
            let drawn = random.log_between(15e-3, 60e-3);
            let quick = size.take(1.0 / drawn, 1.0 / 60e-3, 1.0 / 15e-3);
            physics.high_pass = whole_ns(if size.set.is_some() { 1.0 / quick } else { drawn });
            size.at_limit = Some(60e-3 / physics.high_pass);
            say("tau_s", physics.high_pass, 1e6, "s");
        }
        "bandwidth_gradient" => {
            physics.bandwidth_gradient = random.sign() * size.log_between(random, 0.18, 0.3);
            say("fraction", physics.bandwidth_gradient, 0.0, "fraction");
        }
        "threshold_scale" => {
            let fraction = random.sign() * size.log_between(random, 0.08, 0.25);
            sensor.on *= 1.0 + fraction;
            sensor.off *= 1.0 + fraction;
            say("fraction", fraction, 0.0, "fraction");
        }
        "threshold_asymmetry" => {
            let fraction = random.sign() * size.log_between(random, 0.06, 0.18);
            sensor.on *= 1.0 + fraction;
            sensor.off *= 1.0 - fraction;
            say("fraction", fraction, 0.0, "fraction");
        }
        "threshold_mismatch" => {
            physics.mismatch = size.log_between(random, 0.02, 0.05);
            say("sigma", physics.mismatch, 0.0, "ln");
        }
        "threshold_noise" => {
            let sigma = size.log_between(random, 0.02, 0.045);
            sensor.threshold_noise =
                libm::sqrt(sensor.threshold_noise * sensor.threshold_noise + sigma * sigma);
            say("sigma", sigma, 0.0, "ln");
        }
        "threshold_drift" => {
            physics.drift = random.sign() * size.log_between(random, 0.6, 1.0);
            say("rate", physics.drift, 0.0, "1/s");
        }
        "threshold_gradient" => {
            physics.gradient = random.sign() * size.log_between(random, 0.08, 0.2);
            say("fraction", physics.gradient, 0.0, "fraction");
        }
        "refractory" if variant == "law" => {
            sensor.reset = if random.chance(0.5) { Reset::Advance } else { Reset::AdvanceLossy };
            equation = Some(format!(
                "V_ref moves by one threshold at t_in (`{}`), and not to V at t_off + \
                                     refractory",
                sensor.reset.name()
            ));
        }
        "refractory" => {
            let nominal = sensor.refractory;
            let factor = random.log_between(4.0, 10.0);
            let longer = (nominal * factor).clamp(300e-6, 1e-3);
            let most = (10.0 * nominal).clamp(300e-6, 1e-3) - nominal;
            let more = size.take(longer - nominal, (4.0 * nominal).clamp(300e-6, 1e-3) - nominal, most);
            sensor.refractory = whole_ns(if size.set.is_some() { nominal + more } else { longer });
            size.at_limit =
                Some((sensor.refractory - nominal) / ((4.0 * nominal).clamp(300e-6, 1e-3) - nominal));
            say("refractory_s", sensor.refractory, nominal, "s");
        }
        "refractory_spread" => {
            physics.refractory_spread = size.log_between(random, 0.5, 0.9);
            say("sigma", physics.refractory_spread, 0.0, "ln");
        }
        "refractory_light" => {
            physics.refractory_light = size.log_between(random, 1.0, 4.0) / setting.light;
            say("coefficient", physics.refractory_light, 0.0, "1/photocurrent");
        }
        "reset_memory" => {
            physics.memory = if variant == "over" {
                -size.log_between(random, 0.06, 0.1)
            } else {
                size.log_between(random, 0.07, 0.2)
            };
            say("fraction", physics.memory, 0.0, "fraction");
        }
        "leak_events" => {
            physics.leak = size.log_between(random, 5.0, 25.0);
            say("rate_hz", physics.leak, 0.0, "Hz");
        }
        "parasitic_leak" => {
            physics.parasitic = size.log_between(random, 6.0, 25.0) * sensor.on / setting.light;
            say("coefficient", physics.parasitic, 0.0, "1/s per photocurrent");
        }
        "background_activity" => {
            physics.background = size.log_between(random, 5.0, 20.0);
            say("rate_hz", physics.background, 0.0, "Hz");
        }
        "hot_pixels" => {
            physics.hot_share = random.log_between(0.004, 0.015);
            let drawn = random.log_between(300.0, 1200.0);
            physics.hot_rate = size.take(drawn, 300.0, 1200.0);
            size.at_limit = Some(physics.hot_share * physics.hot_rate / (0.004 * 300.0));
            say("fraction", physics.hot_share, 0.0, "fraction");
            say("rate_hz", physics.hot_rate, 0.0, "Hz");
        }
        "hot_rows" => {
            let first = 3 + random.below(setting.height / 2 - 4);
            physics.hot_rows = vec![first, first + 2 + random.below(setting.height / 2 - 4)];
            physics.hot_row_rate = size.log_between(random, 60.0, 200.0);
            say("rate_hz", physics.hot_row_rate, 0.0, "Hz");
            parameters
                .insert("rows".into(), json!({ "actual": physics.hot_rows, "nominal": [], "unit": "index" }));
        }
        "lateral_inhibition" => {
            physics.lateral = size.log_between(random, 0.15, 0.4);
            say("fraction", physics.lateral, 0.0, "fraction");
        }
        "readout_queue" => {
            // In units of the mean time between two events of the array: a load of 0.5 to 0.8, with bursts
            // above 1.
            let drawn = random.between(0.5, 0.8);
            let load = size.take(drawn, 0.5, 0.8);
            size.at_limit = Some(load / 0.5);
            let service = whole_ns(load / setting.rate);
            physics.queue = Some(Queue { service, shown: false });
            say("service_s", service, 0.0, "s");
        }
        "event_loss" => {
            physics.loss = size.log_between(random, 0.25, 0.5);
            say("fraction", physics.loss, 0.0, "fraction");
        }
        "timestamp_quantization" => {
            let step = size.log_between(random, 200e-6, 1e-3);
            physics.quantum = if size.set.is_some() { whole_ns(step) } else { (step * 1e5).round() / 1e5 };
            say("step_s", physics.quantum, 0.0, "s");
        }
        "timestamp_jitter" => {
            physics.jitter = whole_ns(size.log_between(random, 80e-6, 300e-6));
            say("sigma_s", physics.jitter, 0.0, "s");
        }
        "clock_offset" => {
            physics.clock_offset = whole_ns(random.sign() * size.log_between(random, 0.2e-3, 0.8e-3));
            say("offset_s", physics.clock_offset, 0.0, "s");
        }
        "clock_drift" => {
            physics.clock_rate = random.sign() * size.log_between(random, 0.005, 0.015);
            say("rate", physics.clock_rate, 0.0, "fraction");
        }
        "row_skew" if variant == "rows" => {
            physics.skew_sigma = whole_ns(size.log_between(random, 150e-6, 400e-6));
            say("sigma_s", physics.skew_sigma, 0.0, "s");
        }
        "row_skew" => {
            // Towards late: the first rows' stamps stay as they are, and nothing comes before the recording's
            // start.
            physics.skew_per_row = whole_ns(size.log_between(random, 6e-6, 20e-6));
            say("per_row_s", physics.skew_per_row, 0.0, "s");
        }
        "frame_coupling" => {
            let step = random.sign() * size.log_between(random, 0.4, 0.9) * sensor.on;
            let phase = whole_ns(setting.readout_phase.rem_euclid(setting.period));
            physics.coupling = Some([step, setting.period, phase, sensor.row_time]);
            say("step", step, 0.0, "ln");
            say("period_s", setting.period, 0.0, "s");
            say("phase_s", phase, 0.0, "s");
            say("row_time_s", sensor.row_time, 0.0, "s");
        }
        "misalignment" => {
            let (size, angle) =
                (size.log_between(random, 0.4, 1.0), random.between(0.0, 2.0 * std::f64::consts::PI));
            physics.shift = [size * libm::cos(angle), size * libm::sin(angle)];
            say("shift_x", physics.shift[0], 0.0, "px");
            say("shift_y", physics.shift[1], 0.0, "px");
        }
        "blur" => {
            physics.blur = size.log_between(random, 0.5, 1.0);
            say("sigma", physics.blur, 0.0, "px");
        }
        "crosstalk" => {
            physics.crosstalk = size.log_between(random, 0.15, 0.38);
            say("fraction", physics.crosstalk, 0.0, "fraction");
        }
        "black_level" => {
            let nominal = sensor.black;
            // More in a sensor with more codes: the same share of full scale.
            let black = nominal + size.log_between(random, 25.0, 45.0) * (sensor.saturation / 1023.0);
            sensor.black = if size.set.is_some() { black } else { black.round() };
            say("black_level_dn", sensor.black, nominal, "DN");
        }
        "frame_nonlinearity" => {
            physics.nonlinearity = random.sign() * size.log_between(random, 0.025, 0.07);
            say("fraction", physics.nonlinearity, 0.0, "fraction");
            say("full_scale_dn", sensor.saturation, sensor.saturation, "DN");
        }
        "vignetting" => {
            physics.falloff = size.log_between(random, 0.2, 0.55);
            say("falloff", physics.falloff, 0.0, "fraction");
        }
        "row_time" => {
            let nominal = sensor.row_time;
            let change = size.log_between(random, 8e-6, 18e-6);
            sensor.row_time = whole_ns(nominal + if nominal > 20e-6 { -change } else { change });
            say("row_time_s", sensor.row_time, nominal, "s");
        }
        "exposure_time" => {
            physics.exposure_more = whole_ns(random.sign() * size.log_between(random, 0.3e-3, 0.9e-3));
            say("difference_s", physics.exposure_more, 0.0, "s");
        }
        "frame_gain_steps" => {
            physics.gain_sigma = size.log_between(random, 0.03, 0.09);
            physics.gain_every = 1 + random.below(3);
            say("sigma", physics.gain_sigma, 0.0, "ln");
            say("every", physics.gain_every as f64, 1.0, "frames");
        }
        "image_lag" => {
            physics.lag = size.log_between(random, 0.04, 0.12);
            say("fraction", physics.lag, 0.0, "fraction");
        }
        _ => return Err(format!("effect `{id}`: no such id; the catalogue has {IDS:?}")),
    }
    let mut answer = Map::new();
    answer.insert("id".into(), json!(plain));
    answer.insert("parameters".into(), Value::Object(parameters));
    if let Some(equation) = equation {
        answer.insert("equation".into(), json!(equation));
    }
    Ok(Concealed { answer: Value::Object(answer), at_limit: size.at_limit })
}
