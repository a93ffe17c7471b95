//! Frame values: what one pixel's light becomes in every frame, Eq. (5), with what effects add.

use super::light::LinearLight;
use crate::effects::{Effect, Reading, RowSite, Site};
use crate::exposure::DigitalNumber;
use photocurrent_core::Exposure;

/// How frames are read, as the description states it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameReadout {
    /// Charge to digital number.
    pub number: DigitalNumber,
    /// DN of a full pixel, infinite when unknown. The value is not clipped here; a curve may need to know it.
    pub saturation: f64,
    /// Delay from one row to the next that the exposures below already contain, nanoseconds.
    pub row_time_ns: i64,
}

/// The digital numbers of one pixel, one per stated exposure of its row: not rounded, not clipped, without
/// noise.
pub fn read_frames(
    readout: &FrameReadout,
    effects: &[Box<dyn Effect>],
    site: &Site,
    light: &LinearLight<'_>,
    stated: &[Exposure],
) -> Vec<f64> {
    let mut previous_charge = 0.0;
    let values = stated.iter().enumerate().map(|(frame, &exposure)| {
        let row = RowSite { y: site.y, height: site.height, frame, row_time_ns: readout.row_time_ns };
        let exposed = effects.iter().fold(exposure, |exposure, effect| effect.exposure(&row, exposure));
        let collected = light.integral(exposed);
        let reading = Reading {
            frame,
            previous_charge,
            gain: readout.number.gain,
            black_level: readout.number.black_level,
            saturation: readout.saturation,
        };
        previous_charge = collected;
        let charge = effects.iter().fold(collected, |charge, effect| effect.charge(site, &reading, charge));
        effects.iter().fold(readout.number.of(charge), |dn, effect| effect.dn(site, &reading, dn))
    });
    values.collect()
}
