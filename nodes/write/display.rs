//! How linear digital numbers become pictures of 8 bits that a person can look at: black, white, and the sRGB
//! curve.
//!
//! Black is the sensor's black level. White is what 99.8 percent of the values stay below, looked for in
//! frames spread over the sequence, so that one bright pixel does not make everything else dark; it is at
//! most saturation. One black and white hold for all frames: what flickers on the screen flickered in the
//! data.
//!
//! Limits: what is brighter than white is clipped. For looking only, never for scores.

use photocurrent_core::{FrameSequence, NodeError, Sensor};

/// Share of the values that stay below white.
const BELOW_WHITE: f64 = 0.998;
/// White is looked for in so many frames, and so many values of each, at most.
const FRAMES: usize = 32;
const VALUES: usize = 1 << 17;
/// Steps of light that are distinguished on the way to 8 bits: fine enough for the steep beginning of the
/// curve.
const STEPS: usize = 1 << 14;

/// Which DN are black and white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Look {
    /// DN of black.
    pub black: f64,
    /// DN of white, more than black.
    pub white: f64,
}

impl Look {
    /// For `frames`; `white` in DN when it is stated.
    ///
    /// # Errors
    /// When frames cannot be read.
    pub(crate) fn of(
        frames: &FrameSequence,
        sensor: Option<&Sensor>,
        white: Option<f64>,
    ) -> Result<Look, NodeError> {
        let black = sensor.and_then(|sensor| sensor.frames.black_level_dn).unwrap_or(0.0);
        let most = sensor.and_then(|sensor| sensor.frames.saturation_dn).unwrap_or(f64::INFINITY);
        let white = match white {
            Some(white) => white,
            None => f64::min(percentile(frames)?, most),
        };
        Ok(Look { black, white: if white > black { white } else { black + 1.0 } })
    }

    /// A sentence that says what was done.
    pub(crate) fn about(&self) -> String {
        format!(
            "for looking only: 8 bits, sRGB, black is {} DN, white is {} DN",
            self.black,
            (self.white * 1e4).round() / 1e4
        )
    }

    /// The curve from light to 8 bits.
    pub(crate) fn curve(&self) -> Curve {
        let codes = (0..=STEPS)
            .map(|step| srgb(step as f64 / STEPS as f64))
            .map(|code| (255.0 * code).round() as u8)
            .collect();
        Curve { look: *self, codes }
    }
}

/// The value that [`BELOW_WHITE`] of those looked at stay below; 0 when none is known.
fn percentile(frames: &FrameSequence) -> Result<f64, NodeError> {
    let count = frames.len();
    let taken = count.min(FRAMES);
    let mut values = Vec::new();
    for n in 0..taken {
        let l = (2 * n + 1) * count / (2 * taken);
        let block = frames.read(l..l + 1, frames.rows())?;
        let step = block.dn.len().div_ceil(VALUES).max(1);
        values.extend(block.dn.iter().copied().step_by(step).filter(|dn| dn.is_finite()));
    }
    if values.is_empty() {
        return Ok(0.0);
    }
    let at = ((values.len() - 1) as f64 * BELOW_WHITE).round() as usize;
    Ok(f64::from(*values.select_nth_unstable_by(at, f32::total_cmp).1))
}

/// The sRGB curve (IEC 61966-2-1) from relative light, 0 to 1, to a stored value, 0 to 1.
fn srgb(light: f64) -> f64 {
    if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * libm::pow(light, 1.0 / 2.4) - 0.055 }
}

/// Codes for steps of light from black to white.
pub(crate) struct Curve {
    look: Look,
    codes: Vec<u8>,
}

impl Curve {
    /// The code of a value; what is not known (NaN) is black.
    pub(crate) fn of(&self, dn: f32) -> u8 {
        let share = (f64::from(dn) - self.look.black) / (self.look.white - self.look.black);
        // NaN becomes 0, and what lies outside is clipped.
        let step = (share * STEPS as f64 + 0.5) as usize;
        self.codes[step.min(STEPS)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Exposure, Extent, testing};

    #[test]
    fn codes_are_those_of_srgb() {
        // From the standard: 0.2140 of light is stored as 0.5, 0.0452 as 0.2351 (code 60); below 0.0031308 it
        // is a line.
        let curve = Look { black: 10.0, white: 110.0 }.curve();
        let code = |light: f64| curve.of((10.0 + 100.0 * light) as f32);
        assert_eq!(
            [code(0.0), code(1.0), code(0.214_041), code(0.045_186), code(0.001)],
            [0, 255, 128, 60, 3]
        );
        assert_eq!([curve.of(f32::NAN), curve.of(-1e9), curve.of(f32::INFINITY)], [0, 0, 255]);
    }

    #[test]
    fn one_bright_pixel_does_not_make_the_picture_dark() {
        let extent = Extent { width: 40, height: 50 };
        let exposures = (0..3).map(|l| Exposure::new(l * 1000, l * 1000 + 500)).collect();
        let frames =
            testing::captured(
                extent,
                exposures,
                0,
                |_, x, y| if (x, y) == (3, 3) { 74_000.0 } else { x as f32 },
            );
        let look = Look::of(&frames, None, None).unwrap();
        assert_eq!(look, Look { black: 0.0, white: 39.0 });
        let stated = Look::of(&frames, None, Some(80.0)).unwrap();
        assert_eq!(stated.white, 80.0);
        let mut sensor = Sensor::unknown("test");
        (sensor.frames.saturation_dn, sensor.frames.black_level_dn) = (Some(30.0), Some(2.0));
        assert_eq!(Look::of(&frames, Some(&sensor), None).unwrap(), Look { black: 2.0, white: 30.0 });
        // Nothing but black: there is a white nevertheless.
        let dark = testing::captured(extent, vec![Exposure::new(0, 1)], 0, |_, _, _| f32::NAN);
        assert_eq!(Look::of(&dark, None, None).unwrap(), Look { black: 0.0, white: 1.0 });
    }
}
