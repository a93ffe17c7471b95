//! What the description's `[effects]` do to frames that are rendered as the camera would have captured them:
//! the exposures they really have, and what is read of the charge.
//!
//! A frame that is rendered at a captured one stands for the same reading, so the same effects act on it
//! ([`photocurrent_sensor::effects`]); frames at instants that nobody captured show the light itself. What is
//! drawn (gains of frames) has no prediction and is left out.
//!
//! Limit: the frame before one that is asked for is taken as exposed right before it, which matters to image
//! lag alone.

use photocurrent_core::{Exposure, FrameScale, NodeError, Sensor};
use photocurrent_sensor::effects::{Reading, RowSite, Site, from_description};
use photocurrent_sensor::exposure::DigitalNumber;
use photocurrent_sensor::model::Model;
use photocurrent_sensor::undo::Undo;

/// The effects that act on frames.
pub(super) struct Readout {
    undo: Undo,
    model: Model,
}

impl Readout {
    /// Of frames of a scale; none where no effect acts on them.
    ///
    /// # Errors
    /// When an effect is not understood.
    pub(crate) fn new(sensor: &Sensor, scale: FrameScale) -> Result<Option<Readout>, NodeError> {
        if scale != FrameScale::Captured || sensor.effects.is_empty() {
            return Ok(None);
        }
        let effects = from_description(&sensor.effects)
            .map_err(|why| NodeError::usage(why).hint("`photocurrent effects` lists what there is"))?;
        let undo = Undo::new(effects);
        Ok((!undo.is_none()).then(|| Readout { undo, model: Model::of(sensor) }))
    }

    /// When row `y` of `height` is really exposed.
    pub(crate) fn exposure(&self, (y, height): (u32, u32), frame: usize, exposure: Exposure) -> Exposure {
        let row = RowSite { y, height, frame, row_time_ns: self.model.row_time_ns };
        self.undo.known().iter().fold(exposure, |exposure, effect| effect.exposure(&row, exposure))
    }

    /// The digital number that is read where the stated sensor would read `dn`, and would have read `before`
    /// of the frame before.
    pub(crate) fn read(&self, number: DigitalNumber, site: &Site, frame: usize, dn: f64, before: f64) -> f64 {
        let charge = |dn: f64| (dn - number.black_level) / number.gain;
        let reading = Reading {
            frame,
            previous_charge: charge(before),
            gain: number.gain,
            black_level: number.black_level,
            saturation: self.model.saturation_dn,
        };
        let read =
            self.undo.known().iter().fold(charge(dn), |charge, effect| effect.charge(site, &reading, charge));
        self.undo.known().iter().fold(number.of(read), |dn, effect| effect.dn(site, &reading, dn))
    }
}
