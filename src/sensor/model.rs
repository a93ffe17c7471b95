//! The sensor as its description states it, in numbers that a simulation, a solution and a diagnosis share.
//!
//! The fields that the equations need stand here once, `[effects]` aside
//! ([`crate::effects::from_description`]). What a description leaves out is NaN where no number can stand for
//! it; each user asks for what it needs beforehand ([`photocurrent_core::Sensor::need_all`]).

use crate::exposure::DigitalNumber;
use crate::front_end::FrontEnd;
use crate::map::MapSensor;
use photocurrent_core::Sensor;
use photocurrent_core::quantity::Duration;
use photocurrent_core::sensor::Reset;

/// The usual step: a crossing is then exact to a part in 100,000 of the time that the light takes for the
/// step, some nanoseconds.
pub const LOG_STEP: f64 = 0.15;

/// What the simulated pixel is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pixel {
    /// The low-pass of Eq. (3).
    pub front_end: FrontEnd,
    /// Contrast threshold of an ON event, positive, natural-log units.
    pub threshold_on: f64,
    /// Contrast threshold of an OFF event, positive, natural-log units.
    pub threshold_off: f64,
    /// The part of the readout latency that is always there, nanoseconds, not negative.
    pub latency_ns: i64,
    /// Mean of the exponentially distributed part of the readout latency, nanoseconds, not negative.
    pub latency_spread_ns: f64,
    /// Refractory period after `t_off`, nanoseconds, not negative.
    pub refractory_ns: i64,
    /// The most by which ln i changes over one step of the low-pass, positive; [`LOG_STEP`] unless errors are
    /// studied.
    pub log_step: f64,
}

/// The nominal sensor, but for its `[effects]`.
#[derive(Clone, Debug)]
pub struct Model {
    /// The pixel.
    pub pixel: Pixel,
    /// What the reference does after an event.
    pub reset: Reset,
    /// Charge to DN.
    pub number: DigitalNumber,
    /// DN of a full pixel, infinite when unknown.
    pub saturation_dn: f64,
    /// Stated read noise, DN; 0 = none stated.
    pub read_noise_dn: f64,
    /// DN of one electron; 0 = photon noise not stated.
    pub dn_per_electron: f64,
    /// Stated sigma of the threshold at each reset; 0 = none stated.
    pub threshold_noise: f64,
    /// Delay from row to row, ns.
    pub row_time_ns: i64,
}

impl Model {
    /// Reads a description. Time constants, refractory period and row time that are not stated are 0,
    /// thresholds and gain NaN; the random part of the latency is 0.
    pub fn of(sensor: &Sensor) -> Model {
        let seconds = |duration: Option<Duration>| duration.map_or(0.0, |duration| duration.seconds());
        let ns = |duration: Option<Duration>| duration.map_or(0, Duration::ns);
        let black_level = sensor.frames.black_level_dn.unwrap_or(0.0);
        let saturation_dn = sensor.frames.saturation_dn.unwrap_or(f64::INFINITY);
        let electrons = sensor.frames.full_well_e.unwrap_or(0.0);
        let dn_per_electron = if electrons > 0.0 && saturation_dn.is_finite() {
            (saturation_dn - black_level) / electrons
        } else {
            0.0
        };
        Model {
            pixel: Pixel {
                front_end: FrontEnd {
                    tau_0_s: seconds(sensor.front_end.tau_0),
                    alpha_s: seconds(sensor.front_end.alpha),
                },
                threshold_on: sensor.comparator.threshold_on.unwrap_or(f64::NAN),
                threshold_off: sensor.comparator.threshold_off.unwrap_or(f64::NAN),
                latency_ns: ns(sensor.readout.latency_min),
                latency_spread_ns: 0.0,
                refractory_ns: ns(sensor.readout.refractory),
                log_step: LOG_STEP,
            },
            reset: sensor.comparator.reset,
            number: DigitalNumber { black_level, gain: sensor.frames.gain.unwrap_or(f64::NAN) },
            saturation_dn,
            read_noise_dn: sensor.frames.read_noise_dn.unwrap_or(0.0),
            dn_per_electron,
            threshold_noise: sensor.comparator.threshold_noise.unwrap_or(0.0),
            row_time_ns: ns(sensor.frames.row_time),
        }
    }

    /// For the MAP solver.
    pub fn map_sensor(&self) -> MapSensor {
        MapSensor {
            front_end: self.pixel.front_end,
            threshold_on: self.pixel.threshold_on,
            threshold_off: self.pixel.threshold_off,
            reset: self.reset,
            refractory_ns: self.pixel.refractory_ns,
            gain: self.number.gain,
            black_level_dn: self.number.black_level,
            saturation_dn: self.saturation_dn,
        }
    }

    /// Standard deviation of a frame value `signal` DN above black, DN: `sqrt(read_noise_dn^2 +
    /// dn_per_electron x signal)` by the description, and independent errors
    /// that it does not state: of standard deviations `unstated_dn`, DN, and of a `share` of the signal. A
    /// value below black has the noise of black.
    ///
    /// Source: the photon transfer relation (Janesick, Photon Transfer, 2007): the number of electrons has a
    /// Poisson distribution, and read noise adds in squares.
    pub fn frame_sigma_of_dn<const N: usize>(&self, signal: f64, unstated_dn: [f64; N], share: f64) -> f64 {
        let signal = f64::max(signal, 0.0);
        let dark = unstated_dn
            .iter()
            .fold(self.read_noise_dn * self.read_noise_dn, |variance, sigma| variance + sigma * sigma);
        let unstated = share * signal;
        libm::sqrt(dark + self.dn_per_electron * signal + unstated * unstated)
    }

    /// The same of a value `dn`, without a share.
    pub fn frame_sigma_with_dn<const N: usize>(&self, dn: f64, unstated_dn: [f64; N]) -> f64 {
        self.frame_sigma_of_dn(dn - self.number.black_level, unstated_dn, 0.0)
    }

    /// The same of a value `signal` DN above black, where `dn` and a `share` of the signal are not stated.
    pub fn frame_sigma_dn(&self, signal: f64, (dn, share): (f64, f64)) -> f64 {
        self.frame_sigma_of_dn(signal, [dn, share * signal], 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::document::Source;

    #[test]
    fn what_is_stated_is_read_and_what_is_not_is_no_number() {
        let text = "format = \"photocurrent-sensor/1\"\n[front_end]\nalpha = \"2 ms\"\n[comparator]\n\
                    threshold_on = 0.2\n[readout]\nrefractory = \"1 ms\"\n\
                    [frames]\nblack_level_dn = 10\nsaturation_dn = 1010\nfull_well_e = 2000\n\
                    read_noise_dn = 3\n";
        let model = Model::of(&Sensor::parse(&Source::new("s.toml", "", text)).unwrap());
        assert_eq!(
            (model.pixel.front_end.tau_0_s, model.pixel.front_end.alpha_s, model.pixel.refractory_ns),
            (0.0, 2e-3, 1_000_000)
        );
        assert!(model.pixel.threshold_off.is_nan() && model.number.gain.is_nan());
        // 0.5 DN an electron: 200 DN of light have a variance of 100.
        assert!((model.frame_sigma_with_dn(210.0, []) - libm::sqrt(9.0 + 100.0)).abs() < 1e-12);
        let signal = 210.0 - model.number.black_level;
        assert!(
            (model.frame_sigma_dn(signal, (4.0, 0.1))
                - libm::sqrt(9.0 + 100.0 + 16.0 + 0.01 * signal * signal))
            .abs()
                < 1e-12
        );
    }

    #[test]
    fn errors_that_are_not_stated_add_in_squares() {
        let text = "format = \"photocurrent-sensor/1\"\n[frames]\nblack_level_dn = 10\nread_noise_dn = 3\n";
        let model = Model::of(&Sensor::parse(&Source::new("s.toml", "", text)).unwrap());
        // 3^2 + 4^2 = 5^2 and 5^2 + 12^2 = 13^2, whatever the value where photon noise is not stated.
        assert_eq!([5.0, 10.0, 900.0].map(|dn| model.frame_sigma_with_dn(dn, [4.0, 12.0])), [13.0; 3]);
        assert_eq!(
            [model.frame_sigma_with_dn(900.0, []), model.frame_sigma_with_dn(900.0, [-4.0])],
            [3.0, 5.0]
        );
        assert_eq!(model.frame_sigma_dn(120.0, (4.0, 0.1)), 13.0);
    }
}
