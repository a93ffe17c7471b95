//! Light that no frame of its pixel comes near: marked, and held where it leaves the plausible.
//!
//! Between frames, events alone say how bright a pixel is: twenty ON events of 0.5 in a row mean a factor of
//! 20,000. A glint may do that, and so do a hot pixel, a burst of noise, or thresholds that are lower at
//! strong change than stated; the recording does not say which. So light is compared with the brightest frame
//! of its pixel: what is brighter by more than `plausible_range` (natural-log units) is held there, the pixel
//! is counted, and the plane `implausible` of the output `map` says how far it went.
//!
//! Limits: light that is too dark is not held: no reading of it is far from the frames, at worst 0 DN. A
//! saturated value counts as the light of saturation, so light that is far beyond what the frames can say is
//! held too. A frame value below 1 DN counts as 1 DN: noise decides there.

use crate::model::Model;
use crate::options::LEAST_FRAME_SIGMA_DN;
use crate::shares::Share;

/// How bright a pixel may get.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plausible {
    /// Photocurrent of its brightest frame.
    brightest: f64,
    /// The most that is not held.
    most: f64,
}

impl Plausible {
    /// For a value whose frames read `dn` in exposures of so many seconds; what is not known (NaN) does not
    /// count.
    pub(crate) fn new(model: &Model, share: Share, frames: impl Iterator<Item = (f64, f64)>) -> Plausible {
        let above = |dn: f64| {
            f64::max(
                f64::min(dn, model.sensor.saturation_dn) - model.sensor.number.black_level,
                LEAST_FRAME_SIGMA_DN,
            )
        };
        let light = frames
            .filter(|(dn, _)| dn.is_finite())
            .map(|(dn, seconds)| share.light(above(dn)) / (model.sensor.number.gain * seconds));
        let brightest = light.fold(0.0, f64::max);
        Plausible { brightest, most: brightest * libm::exp(model.plausible_range) }
    }

    /// `photocurrent`, or the most that is plausible.
    pub(crate) fn held(&self, photocurrent: f64) -> f64 {
        f64::min(photocurrent, self.most)
    }

    /// What stands in the plane `implausible` for a pixel that gets as bright as `photocurrent`: natural
    /// logarithm of that over the brightest frame, or 0 where it is plausible.
    pub(crate) fn excess(&self, photocurrent: f64) -> f64 {
        if photocurrent > self.most { libm::log(photocurrent / self.brightest) } else { 0.0 }
    }
}

/// What the note on such pixels says.
pub(crate) fn note(range: f64) -> String {
    format!(
        "pixels get brighter than their brightest frame by more than a factor of {:.0} (`plausible_range` = \
         {range}) and are held there: see plane `implausible` of `map`",
        libm::exp(range)
    )
}
