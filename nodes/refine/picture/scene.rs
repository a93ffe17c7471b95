//! The scene of all frames, by parts of a long recording, and the places that it predicts.

use crate::refine::pseudo_measurement::PredictedLight;
use photocurrent_scene::Scene;
use photocurrent_scene::case::{Case, PixelEvents};
use photocurrent_scene::gate::{LEAST_DN, PredictionGate, SPREAD};
use photocurrent_scene::light::log_between;
use photocurrent_scene::mosaic::{PatchSetting, scene_where};
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::picture::PictureSetting;

/// Number of frames that neighbouring parts share.
const SHARED: usize = 2;
/// With fewer frames no motion is seen.
const FEWEST_FRAMES: usize = 3;
/// Where more than this share of the pixels is selected, all of them are fitted.
const MOST_SELECTED: f64 = 0.6;

/// A part of the recording.
struct FrameRange {
    /// Without its events and its frames' values.
    case: Case,
    source: Box<dyn Scene>,
    gate: PredictionGate,
}

/// The light of all pixels, predicted from frames alone.
#[derive(Default)]
pub(super) struct PredictedPictures {
    parts: Vec<FrameRange>,
    step_ns: i64,
    least_exposures: f64,
}

/// The prediction for some pixels of a row, part after part, at the steady instants of the part.
pub(super) struct PredictedRowLight {
    parts: Vec<OfPart>,
    /// Index of each column's light.
    at: Vec<Option<usize>>,
}

/// Log light of each pixel, and the number of exposures that recorded its place of the scene.
struct OfPart {
    log: Vec<Vec<f32>>,
    exposures: Vec<Vec<f32>>,
}

impl PredictedPictures {
    /// Fits scenes to the frames, to those of pixels that `selected` has between two instants;
    /// light is worked out every `step_ns`, and of places that `least_exposures`
    /// saw or more.
    ///
    /// # Errors
    /// With the reason of the first part, when no part has a scene.
    pub(crate) fn fit(
        case: &Case,
        sensor: &Nominal,
        setting: &PictureSetting,
        (step_ns, least_exposures): (i64, f64),
        selected: impl Fn((i64, i64)) -> Vec<bool>,
    ) -> Result<PredictedPictures, String> {
        let pixels = usize::max(case.extent.pixels(), 1);
        // Nothing where all are fitted.
        let selected = |span: (i64, i64)| -> Result<Option<Vec<bool>>, String> {
            let selected = selected(span);
            let count = selected.iter().filter(|is| **is).count();
            if count == 0 {
                return Err("no pixels near each other fire, so nothing is seen to move".into());
            }
            Ok((count as f64 <= MOST_SELECTED * pixels as f64).then_some(selected))
        };
        // A part of the recording may select fewer pixels, never more.
        let at_most =
            selected(case.span)?.map_or(pixels, |selected| selected.iter().filter(|is| **is).count());
        let (count, most) = (case.frame_count(), setting.most_values / at_most);
        if count < FEWEST_FRAMES || most < FEWEST_FRAMES {
            return Err(format!(
                "{count} frames of {at_most} pixels, of which {most} are fitted at a time; a \
                                picture needs {FEWEST_FRAMES}"
            ));
        }
        let nominal = Nominal {
            row_time_ns: case.frames.as_ref().map_or(0, |frames| frames.times.row_time_ns),
            ..sensor.clone()
        };
        let fit = |from: usize, to: usize| -> Result<FrameRange, String> {
            let mut part = case.frame_range(from..to);
            let parts = PatchSetting::default();
            let source = scene_where(&part, &nominal, setting, &parts, selected(part.span)?.as_deref())?;
            let gate = source.gate(&part, LEAST_DN, SPREAD);
            part.events = PixelEvents::default();
            part.frames = part.frames.map(|frames| frames.without_values());
            Ok(FrameRange { case: part, source, gate })
        };
        // Parts of about equal length, the last one ending with the last frame.
        let number = if count <= most { 1 } else { (count - SHARED).div_ceil(most - SHARED.min(most - 1)) };
        let length = usize::min(most, count);
        let first = |n: usize| if number == 1 { 0 } else { n * (count - length) / (number - 1) };
        let fitted: Vec<Result<FrameRange, String>> =
            (0..number).map(|n| fit(first(n), first(n) + length)).collect();
        let why = fitted.iter().find_map(|part| part.as_ref().err().cloned());
        let parts: Vec<FrameRange> = fitted.into_iter().flatten().collect();
        if parts.is_empty() {
            Err(why.unwrap_or_default())
        } else {
            Ok(PredictedPictures { parts, step_ns, least_exposures })
        }
    }

    /// The light of these columns of a row: kept for a row at a time, as that of all pixels would be more
    /// than everything else together.
    pub(crate) fn row_light(&self, row: usize, width: usize, columns: &[usize]) -> PredictedRowLight {
        let pixels: Vec<usize> = columns.iter().map(|x| row * width + x).collect();
        let mut at = vec![None; width];
        columns.iter().enumerate().for_each(|(n, x)| at[*x] = Some(n));
        let of = |FrameRange { case, source, .. }: &FrameRange| OfPart {
            log: source.log_light(case, self.step_ns, &pixels),
            exposures: source.exposures_seen(case, self.step_ns, &pixels),
        };
        PredictedRowLight { parts: self.parts.iter().map(of).collect(), at }
    }

    /// The prediction for pixel `x` of a row by the part whose middle is nearest to an instant.
    pub(crate) fn predict(
        &self,
        light: &PredictedRowLight,
        (x, row): (usize, usize),
        t_ns: i64,
    ) -> Option<PredictedLight> {
        let inside = self
            .parts
            .iter()
            .zip(&light.parts)
            .filter(|(part, _)| (part.case.span.0..=part.case.span.1).contains(&t_ns));
        let (part, predicted) = inside
            .min_by_key(|(part, _)| (i64::midpoint(part.case.span.0, part.case.span.1) - t_ns).abs())?;
        if !part.gate.accepts(row * light.at.len() + x, t_ns) {
            return None;
        }
        let (n, at) = (light.at[x]?, (part.case.span.0, self.step_ns));
        // Extrapolated where no exposure covers the place.
        if log_between(&predicted.exposures[n], at, t_ns)
            .is_some_and(|exposures| exposures < self.least_exposures)
        {
            return None;
        }
        // Only the pixel's own events test it.
        let log = log_between(&predicted.log[n], at, t_ns)?;
        Some(PredictedLight { t_ns, log, innovation: Some(0.0), ambiguity: 0.0 })
    }
}
