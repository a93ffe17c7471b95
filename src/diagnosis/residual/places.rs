//! Location of gains in the recording.

use super::laid::CovariateColumns;
use super::located::{GainingValues, LocatedEffect, LocatedSetting, LocationData};
use super::{EventResiduals, FrameValues};
use crate::candidates::CANDIDATES;
use photocurrent_scene::case::Case;
use photocurrent_sensor::effects::Stage;

/// Data for the location of gains: events, and frame values.
pub(super) struct GainLocator<'a> {
    pub(super) events: LocationData<'a>,
    /// Of a known scene.
    pub(super) frames: Option<LocationData<'a>>,
}

impl<'a> GainLocator<'a> {
    /// Of events and frame values with the blocks of both, and their covariates.
    pub(super) fn new(
        case: &'a Case,
        events: &'a EventResiduals,
        frames: &'a FrameValues,
        block: &'a [u32],
        laid: &[Vec<CovariateColumns>; 2],
        setting: &'a LocatedSetting,
    ) -> GainLocator<'a> {
        let (of_events, of_frames) = block.split_at(events.pixel.len());
        let on_events = GainingValues {
            pixel: &events.pixel,
            t_ns: &events.t_ns,
            polarity: &events.polarity,
            log_light: &events.log_light,
            block: of_events,
        };
        let on_frames = GainingValues {
            pixel: &frames.pixel,
            t_ns: &frames.t_ns,
            polarity: &[],
            log_light: &frames.log_signal,
            block: of_frames,
        };
        let ground = |on, laid| LocationData::new(case, on, laid, setting);
        GainLocator {
            events: ground(on_events, &laid[0]),
            frames: (!frames.pixel.is_empty()).then(|| ground(on_frames, &laid[1])),
        }
    }

    /// Locates the gains of an effect: of events, or of frame values where it is an effect of frames and
    /// these were evaluated.
    pub(super) fn locate(&self, gains: &[f64], candidate: usize) -> LocatedEffect {
        let decl = CANDIDATES[candidate].decl();
        let (of_events, of_frames) = gains.split_at(self.events.on.pixel.len());
        match &self.frames {
            Some(frames) if decl.stage == Stage::Exposure => frames.locate(of_frames, decl.covariate),
            _ => self.events.locate(of_events, decl.covariate),
        }
    }
}
