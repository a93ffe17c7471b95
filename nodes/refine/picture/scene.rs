//! The scene of all frames, part after part of a long recording, and where it may be asked.

use crate::refine::trust::Said;
use photocurrent_diagnosis::case::Case;
use photocurrent_diagnosis::nominal::Nominal;
use photocurrent_diagnosis::picture::PictureSetting;
use photocurrent_diagnosis::residual::evidence::EvidenceSetting;
use photocurrent_diagnosis::residual::gate::Gate;
use photocurrent_diagnosis::residual::light::Light;
use photocurrent_diagnosis::residual::mosaic::{MosaicSetting, scene};

/// Neighbouring parts share so many frames.
const SHARED: usize = 2;
/// With fewer frames no motion is seen.
const FEWEST_FRAMES: usize = 3;

/// A part of the recording.
struct Part {
    span: (i64, i64),
    light: Light,
    gate: Gate,
}

/// What frames alone say of the light of all pixels.
#[derive(Default)]
pub(super) struct Pictures {
    parts: Vec<Part>,
}

impl Pictures {
    /// Fits scenes to the frames; light is worked out every `step_ns`.
    ///
    /// # Errors
    /// With the reason of the first part, when no part has a scene.
    pub fn fit(case: &Case, sensor: &Nominal, setting: &PictureSetting, step_ns: i64) -> Result<Pictures, String> {
        let (count, most) = (case.frame_count(), setting.most_values / usize::max(case.extent.pixels(), 1));
        if count < FEWEST_FRAMES || most < FEWEST_FRAMES {
            return Err(format!("{count} frames of {} pixels, of which {most} are fitted at a time; a picture needs {FEWEST_FRAMES}", case.extent));
        }
        let nominal = Nominal { row_time_ns: case.frames.as_ref().map_or(0, |frames| frames.times.row_time_ns), ..sensor.clone() };
        let EvidenceSetting { least_dn, spread, .. } = EvidenceSetting::default();
        let fit = |from: usize, to: usize| -> Result<Part, String> {
            let part = case.part(from..to);
            let parts = MosaicSetting::default();
            let parts = MosaicSetting { picture: PictureSetting { pitch: setting.pitch, ..parts.picture }, ..parts };
            let source = scene(&part, &nominal, setting, &parts)?;
            Ok(Part { span: part.span, light: source.light(&part, step_ns), gate: source.gate(&part, least_dn, spread) })
        };
        // Parts of about equal length, the last one ending with the last frame.
        let number = if count <= most { 1 } else { (count - SHARED).div_ceil(most - SHARED.min(most - 1)) };
        let length = usize::min(most, count);
        let first = |n: usize| if number == 1 { 0 } else { n * (count - length) / (number - 1) };
        let fitted: Vec<Result<Part, String>> = (0..number).map(|n| fit(first(n), first(n) + length)).collect();
        let why = fitted.iter().find_map(|part| part.as_ref().err().cloned());
        let parts: Vec<Part> = fitted.into_iter().flatten().collect();
        if parts.is_empty() { Err(why.unwrap_or_default()) } else { Ok(Pictures { parts }) }
    }

    /// What the part in whose middle an instant is nearest says of a pixel.
    pub fn predict(&self, pixel: usize, t_ns: i64) -> Option<Said> {
        let inside = self.parts.iter().filter(|part| (part.span.0..=part.span.1).contains(&t_ns));
        let part = inside.min_by_key(|part| (i64::midpoint(part.span.0, part.span.1) - t_ns).abs())?;
        if !part.gate.keeps(pixel, t_ns) {
            return None;
        }
        // Nobody contradicts it but the pixel's own events.
        part.light.at(pixel, t_ns).map(|log| Said { t_ns, log, contradiction: Some(0.0) })
    }
}
