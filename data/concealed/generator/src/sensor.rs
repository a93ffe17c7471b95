//! The paper's sensor in numbers, and everything beyond it that a recording may conceal.

use serde_json::{Value, json};

/// How the comparator's reference is renewed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reset {
    /// `V_ref := V` when the blind time ends.
    Resample,
    /// `V_ref` moves by one threshold at the event; a crossing inside the blind time fires at its end.
    Advance,
    /// The same, but a crossing inside the blind time is lost.
    AdvanceLossy,
}

impl Reset {
    pub fn name(self) -> &'static str {
        match self {
            Self::Resample => "resample",
            Self::Advance => "advance",
            Self::AdvanceLossy => "advance_lossy",
        }
    }
}

/// What a sensor description can state. SI units; voltages in natural-log units; light in photocurrent units.
#[derive(Clone, Debug)]
pub struct Sensor {
    pub tau_0: f64,
    pub alpha: f64,
    pub on: f64,
    pub off: f64,
    /// Standard deviation of a threshold, drawn at each reset.
    pub threshold_noise: f64,
    pub states_threshold_noise: bool,
    pub reset: Reset,
    pub refractory: f64,
    pub latency_min: f64,
    /// Mean of the exponential part of the latency; never stated.
    pub latency_more: f64,
    pub gain: f64,
    pub black: f64,
    pub saturation: f64,
    pub row_time: f64,
    pub read_noise: f64,
    /// Electrons at `saturation` above `black`; 0 = frames have no photon noise.
    pub full_well: f64,
    pub states_frame_noise: bool,
    /// Photocurrent of one lux; 0 = not stated.
    pub per_lux: f64,
}

/// A time as TOML text, exact to a nanosecond, which is the step of every time drawn.
fn time(seconds: f64) -> String {
    format!("\"{} ns\"", (seconds * 1e9).round() as i64)
}

impl Sensor {
    /// The description as a file of the form `photocurrent-sensor/1`.
    pub fn description(&self) -> String {
        let mut text = String::from(
            "format = \"photocurrent-sensor/1\"\nname = \"sensor of a \
                                     recording\"\n\n[front_end]\n",
        );
        text += &format!(
            "tau_0 = {}\nalpha = {}\n\n[comparator]\nthreshold_on = {}\nthreshold_off = {}\n",
            time(self.tau_0),
            time(self.alpha),
            self.on,
            self.off
        );
        if self.states_threshold_noise {
            text += &format!("threshold_noise = {}\n", self.threshold_noise);
        }
        text += &format!(
            "reset = \"{}\"\n\n[readout]\nrefractory = {}\nlatency_min = {}\n\n",
            self.reset.name(),
            time(self.refractory),
            time(self.latency_min)
        );
        text += &format!(
            "[frames]\ngain = {:?}\nblack_level_dn = {:?}\nsaturation_dn = {:?}\nrow_time = {}\n",
            self.gain,
            self.black,
            self.saturation,
            time(self.row_time)
        );
        if self.states_frame_noise {
            text += &format!("read_noise_dn = {:?}\nfull_well_e = {:?}\n", self.read_noise, self.full_well);
        }
        if self.per_lux > 0.0 {
            // In two parts, as a name that begins like those of the project's packages is refused here.
            text += &format!(concat!("\n[optics]\nphotocurrent", "_per_lux = {:?}\n"), self.per_lux);
        }
        text
    }

    /// The same numbers for the list of answers, with those that a description keeps to itself.
    pub fn answer(&self) -> Value {
        json!({
            "tau_0_s": self.tau_0, "alpha_s": self.alpha, "threshold_on": self.on,
            "threshold_off": self.off, "threshold_noise": self.threshold_noise,
            "reset": self.reset.name(), "refractory_s": self.refractory, "latency_min_s": self.latency_min,
            "latency_random_mean_s": self.latency_more,
            "gain": self.gain, "black_level_dn": self.black, "saturation_dn": self.saturation,
            "row_time_s": self.row_time, "read_noise_dn": self.read_noise,
            "full_well_e": self.full_well,
        })
    }
}

/// A readout that serves one event after the other.
#[derive(Clone, Copy, Debug)]
pub struct Queue {
    pub service: f64,
    /// Do the recorded stamps show the wait?
    pub shown: bool,
}

/// What the sensor really does: its real numbers and every effect; the neutral value of each is in
/// [`Physics::of`].
#[derive(Clone, Debug)]
pub struct Physics {
    pub sensor: Sensor,
    // Light on the way to the event pixels.
    pub shift: [f64; 2],
    pub blur: f64,
    pub crosstalk: f64,
    // Front end.
    pub dark: f64,
    pub second_tau: f64,
    pub second_light: f64,
    pub large_signal: bool,
    pub rise: f64,
    pub fall: f64,
    pub high_pass: f64,
    pub bandwidth_gradient: f64,
    pub lateral: f64,
    // Comparator and reset.
    pub drift: f64,
    pub gradient: f64,
    pub mismatch: f64,
    pub refractory_spread: f64,
    pub refractory_light: f64,
    pub memory: f64,
    pub leak: f64,
    pub parasitic: f64,
    pub background: f64,
    pub hot_share: f64,
    pub hot_rate: f64,
    pub hot_rows: Vec<usize>,
    pub hot_row_rate: f64,
    // Readout and stamps.
    pub queue: Option<Queue>,
    pub loss: f64,
    /// Step (ln), period, phase, row time of the kick that a frame readout gives.
    pub coupling: Option<[f64; 4]>,
    pub quantum: f64,
    pub jitter: f64,
    pub clock_offset: f64,
    pub clock_rate: f64,
    pub skew_per_row: f64,
    pub skew_sigma: f64,
    // Frames.
    pub exposure_more: f64,
    pub lag: f64,
    pub falloff: f64,
    pub nonlinearity: f64,
    pub gain_sigma: f64,
    pub gain_every: usize,
    /// A law outside the catalogue.
    pub law: Option<crate::law::Law>,
}

impl Physics {
    /// The sensor as described, and nothing else.
    pub fn of(sensor: Sensor) -> Self {
        Self {
            sensor,
            shift: [0.0; 2],
            blur: 0.0,
            crosstalk: 0.0,
            dark: 0.0,
            second_tau: 0.0,
            second_light: 0.0,
            large_signal: false,
            rise: f64::INFINITY,
            fall: f64::INFINITY,
            high_pass: f64::INFINITY,
            bandwidth_gradient: 0.0,
            lateral: 0.0,
            drift: 0.0,
            gradient: 0.0,
            mismatch: 0.0,
            refractory_spread: 0.0,
            refractory_light: 0.0,
            memory: 0.0,
            leak: 0.0,
            parasitic: 0.0,
            background: 0.0,
            hot_share: 0.0,
            hot_rate: 0.0,
            hot_rows: Vec::new(),
            hot_row_rate: 0.0,
            queue: None,
            loss: 0.0,
            coupling: None,
            quantum: 0.0,
            jitter: 0.0,
            clock_offset: 0.0,
            clock_rate: 0.0,
            skew_per_row: 0.0,
            skew_sigma: 0.0,
            exposure_more: 0.0,
            lag: 0.0,
            falloff: 0.0,
            nonlinearity: 0.0,
            gain_sigma: 0.0,
            gain_every: 1,
            law: None,
        }
    }
}
