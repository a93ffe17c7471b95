//! The sensor as its description states it, ready to simulate and to solve.

use crate::case::Case;
use photocurrent_core::quantity::Duration;
use photocurrent_core::sensor::Reset;
use photocurrent_core::{NodeError, Sensor};
use photocurrent_sensor::effects::{Site, from_description};
use photocurrent_sensor::exposure::DigitalNumber;
use photocurrent_sensor::forward::{LOG_STEP, Pixel};
use photocurrent_sensor::front_end::FrontEnd;
use photocurrent_sensor::map::MapSensor;

/// The sensor as stated, but for its `[effects]`.
#[derive(Clone, Debug)]
pub struct Nominal {
    /// The pixel; the random part of its latency is as long as the recording's.
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

impl Nominal {
    /// The stated sensor of a recording.
    ///
    /// # Errors
    /// When the description does not state what the model needs.
    pub fn new(case: &Case) -> Result<Nominal, NodeError> {
        Nominal::of(&case.sensor, case)
    }

    /// Another description for the same recording.
    ///
    /// # Errors
    /// When it does not state what the model needs, or its effects are not understood.
    pub fn of(sensor: &Sensor, case: &Case) -> Result<Nominal, NodeError> {
        const WHO: &str = "a diagnosis";
        let with_frames = case.frames.is_some();
        sensor.need_all(
            &[
                ("front_end.tau_0", sensor.front_end.tau_0.is_some()),
                ("front_end.alpha", sensor.front_end.alpha.is_some()),
                ("comparator.threshold_on", sensor.comparator.threshold_on.is_some()),
                ("comparator.threshold_off", sensor.comparator.threshold_off.is_some()),
                ("readout.refractory", sensor.readout.refractory.is_some()),
                ("frames.gain", !with_frames || sensor.frames.gain.is_some()),
            ],
            WHO,
        )?;
        from_description(&sensor.effects).map_err(|why| NodeError::usage(why).hint("`photocurrent effects` lists what there is"))?;
        let seconds = |duration: Option<Duration>| duration.map_or(0.0, |duration| duration.seconds());
        let ns = |duration: Option<Duration>| duration.map_or(0, Duration::ns);
        let black_level = sensor.frames.black_level_dn.unwrap_or(0.0);
        let saturation_dn = sensor.frames.saturation_dn.unwrap_or(f64::INFINITY);
        let electrons = sensor.frames.full_well_e.unwrap_or(0.0);
        let dn_per_electron = if electrons > 0.0 && saturation_dn.is_finite() { (saturation_dn - black_level) / electrons } else { 0.0 };
        let latency_ns = ns(sensor.readout.latency_min);
        Ok(Nominal {
            pixel: Pixel {
                front_end: FrontEnd { tau_0_s: seconds(sensor.front_end.tau_0), alpha_s: seconds(sensor.front_end.alpha) },
                threshold_on: sensor.comparator.threshold_on.unwrap_or(f64::NAN),
                threshold_off: sensor.comparator.threshold_off.unwrap_or(f64::NAN),
                latency_ns,
                latency_spread_ns: latency_spread_ns(case, latency_ns),
                refractory_ns: ns(sensor.readout.refractory),
                log_step: LOG_STEP,
            },
            reset: sensor.comparator.reset,
            number: DigitalNumber { black_level, gain: sensor.frames.gain.unwrap_or(1.0) },
            saturation_dn,
            read_noise_dn: sensor.frames.read_noise_dn.unwrap_or(0.0),
            dn_per_electron,
            threshold_noise: sensor.comparator.threshold_noise.unwrap_or(0.0),
            row_time_ns: case.frames.as_ref().map_or(0, |frames| frames.times.row_time_ns),
        })
    }

    /// For the solver of the most probable light.
    pub fn map_sensor(&self) -> MapSensor {
        MapSensor {
            front_end: self.pixel.front_end,
            threshold_on: self.pixel.threshold_on,
            threshold_off: self.pixel.threshold_off,
            reset: self.reset,
            refractory_ns: self.pixel.refractory_ns,
            gain: self.number.gain,
            black_level_dn: self.number.black_level,
        }
    }

    /// Standard deviation of a frame value as stated, DN.
    pub fn stated_frame_sigma_dn(&self, dn: f64) -> f64 {
        let signal = f64::max(dn - self.number.black_level, 0.0);
        libm::sqrt(self.read_noise_dn * self.read_noise_dn + self.dn_per_electron * signal)
    }

    /// A pixel's place, for effects.
    pub fn site(case: &Case, pixel: usize, seed: u64) -> Site {
        let (x, y) = case.place(pixel);
        Site { x, y, width: case.extent.width, height: case.extent.height, seed }
    }
}

/// Mean of the recorded latency beyond the smallest, ns; 0 without in-pixel times.
fn latency_spread_ns(case: &Case, latency_ns: i64) -> f64 {
    let all = case.events.all();
    if !case.has_t_in || all.is_empty() {
        return 0.0;
    }
    let sum: f64 = all.iter().map(|event| (event.t_off_ns - event.t_in_ns - latency_ns).max(0) as f64).sum();
    sum / all.len() as f64
}
