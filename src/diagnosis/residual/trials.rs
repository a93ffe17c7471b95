//! Residuals of several trials on the same events and frame values.

use super::fit::EffectColumn;
use super::{EventResiduals, FrameValues};

/// Residuals of trials.
pub(super) struct EvaluatedTrials {
    /// Of the first trial; empty where they are a table's.
    pub events: EventResiduals,
    pub frames: FrameValues,
    /// Residuals for each trial: of events, then of frame values.
    pub left: Vec<Vec<f32>>,
    /// Logarithms of the events' slopes for each trial.
    pub log_slope: Vec<Vec<f32>>,
}

impl EvaluatedTrials {
    /// Change between two trials that differ by a step `by`, per unit size.
    pub(super) fn column(&self, trial: usize, from: usize, by: f64) -> EffectColumn {
        let change = |values: &[Vec<f32>]| {
            values[trial]
                .iter()
                .zip(&values[from])
                .map(|(with, before)| (with - before) / by as f32)
                .collect()
        };
        EffectColumn { of: change(&self.left), log_slope: change(&self.log_slope) }
    }
}
