//! A trial ready to be evaluated: its effects built and given the load of the recording, and the mixture of
//! neighbours that they make.

use crate::candidates::Trial;
use crate::record::effects_of;
use photocurrent_scene::case::Case;
use photocurrent_scene::nominal::Nominal;
use photocurrent_sensor::effects::{Effect, Kernel};
use photocurrent_sensor::forward::neighbours::joined;

/// A trial with its effects built and given the load of the recording.
pub(super) struct PreparedTrial {
    /// The base fields.
    pub nominal: Nominal,
    /// The effects that the description states, and those of the trial.
    pub effects: Vec<Box<dyn Effect>>,
    kernel: Option<Kernel>,
}

impl PreparedTrial {
    /// The mixture of neighbours that the event path sees.
    pub(super) fn kernel(&self) -> Option<&Kernel> {
        self.kernel.as_ref()
    }

    /// Of a trial on a recording.
    ///
    /// # Errors
    /// When an effect or its parameters are not understood, or effects cannot be combined.
    pub(super) fn new(case: &Case, trial: &Trial) -> Result<PreparedTrial, String> {
        let effects = effects_of(case, &trial.effects)?;
        let kernel = joined(&effects).map_err(|why| why.to_string())?;
        Ok(PreparedTrial { nominal: trial.nominal.clone(), effects, kernel })
    }
}
