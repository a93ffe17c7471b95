//! The sensor as the description states it, for a recording.

use crate::case::Case;
use photocurrent_core::{NodeError, Sensor};
use photocurrent_sensor::effects::{Site, from_description};
use photocurrent_sensor::exposure::DigitalNumber;
pub use photocurrent_sensor::model::Model as Nominal;

impl Case {
    /// The stated sensor of the recording; the random part of its latency is as long as the recording's, the
    /// row time that of its frames. Without a front end it is the ideal one, without a refractory period
    /// pixels are not blind.
    ///
    /// # Errors
    /// When the description does not state what the model needs, or its effects are not understood.
    pub fn nominal(&self) -> Result<Nominal, NodeError> {
        self.described(&self.sensor)
    }

    /// Another description for the same recording.
    ///
    /// # Errors
    /// When it does not state what the model needs, or its effects are not understood.
    pub fn described(&self, sensor: &Sensor) -> Result<Nominal, NodeError> {
        const WHO: &str = "a diagnosis";
        let with_frames = self.frames.is_some();
        sensor
            .need_all(
                &[
                    ("comparator.threshold_on", sensor.comparator.threshold_on.is_some()),
                    ("comparator.threshold_off", sensor.comparator.threshold_off.is_some()),
                    ("frames.gain", !with_frames || sensor.frames.gain.is_some()),
                ],
                WHO,
            )
            .map_err(|error| {
                let add = error.hint.clone().unwrap_or_default();
                error.hint(format!("{add}; `photocurrent init` writes one with values to begin with"))
            })?;
        from_description(&sensor.effects)
            .map_err(|why| NodeError::usage(why).hint("`photocurrent effects` lists what there is"))?;
        let mut nominal = Nominal::of(sensor);
        nominal.pixel.latency_spread_ns = latency_spread_ns(self, nominal.pixel.latency_ns);
        nominal.row_time_ns = self.frames.as_ref().map_or(0, |frames| frames.times.row_time_ns);
        if !with_frames {
            nominal.number = DigitalNumber { gain: sensor.frames.gain.unwrap_or(1.0), ..nominal.number };
        }
        Ok(nominal)
    }

    /// A pixel's place, for effects.
    pub fn site(&self, pixel: usize, seed: u64) -> Site {
        let (x, y) = self.pixel_place(pixel);
        Site { x, y, width: self.extent.width, height: self.extent.height, seed }
    }
}

/// Mean of the recorded latency beyond the smallest, ns; 0 without in-pixel times.
fn latency_spread_ns(case: &Case, latency_ns: i64) -> f64 {
    if !case.has_t_in || case.events.is_empty() {
        return 0.0;
    }
    let sum: f64 =
        case.events.iter().map(|event| (event.t_off_ns - event.t_in_ns - latency_ns).max(0) as f64).sum();
    sum / case.events.len() as f64
}
