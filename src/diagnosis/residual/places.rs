//! Where in the recording gains are.

use super::laid::Laid;
use super::located::{Ground, Located, LocatedSetting, Values};
use super::{FrameValues, Residuals};
use crate::candidates::CANDIDATES;
use photocurrent_scene::case::Case;
use photocurrent_sensor::effects::Stage;

/// What gains are located on.
pub(super) struct Places<'a> {
    pub(super) events: Ground<'a>,
    /// Of a known scene.
    pub(super) frames: Option<Ground<'a>>,
}

impl<'a> Places<'a> {
    /// Of events and frame values with the blocks of both, and their covariates.
    pub(super) fn new(
        case: &'a Case,
        events: &'a Residuals,
        frames: &'a FrameValues,
        block: &'a [u32],
        laid: &[Vec<Laid>; 2],
        setting: &'a LocatedSetting,
    ) -> Places<'a> {
        let (of_events, of_frames) = block.split_at(events.pixel.len());
        let on_events = Values {
            pixel: &events.pixel,
            t_ns: &events.t_ns,
            polarity: &events.polarity,
            log_light: &events.log_light,
            block: of_events,
        };
        let on_frames = Values {
            pixel: &frames.pixel,
            t_ns: &frames.t_ns,
            polarity: &[],
            log_light: &frames.log_signal,
            block: of_frames,
        };
        let ground = |on, laid| Ground::new(case, on, laid, setting);
        Places {
            events: ground(on_events, &laid[0]),
            frames: (!frames.pixel.is_empty()).then(|| ground(on_frames, &laid[1])),
        }
    }

    /// Where the gains of an effect are: of events, or of frame values where the effect is one of frames and
    /// they were evaluated.
    pub(super) fn locate(&self, gains: &[f64], candidate: usize) -> Located {
        let decl = CANDIDATES[candidate].decl();
        let (of_events, of_frames) = gains.split_at(self.events.on.pixel.len());
        match &self.frames {
            Some(frames) if decl.stage == Stage::Exposure => frames.locate(of_frames, decl.covariate),
            _ => self.events.locate(of_events, decl.covariate),
        }
    }
}
