//! Where in the recording gains are.

use super::located::{Ground, Located};
use crate::candidates::CANDIDATES;
use photocurrent_sensor::effects::Stage;

/// What gains are located on.
pub(super) struct Places<'a> {
    pub(super) events: Ground<'a>,
    /// Of a known scene.
    pub(super) frames: Option<Ground<'a>>,
}

impl Places<'_> {
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
