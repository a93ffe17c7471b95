//! Non-idealities beyond the paper's model, one file each.
//!
//! An effect lives in one place so that the simulator can add it, the solver can undo it and the diagnosis
//! can name it. Each file says what the effect is, how it enters, its parameters with unit and plausible
//! range, what it is confused with, its source, and by which numbers a diagnosis looks for it, once for
//! people and once as an [`EffectDecl`].
//!
//! To add one: write a file like [`leak_events`] (a `KIND`, a `build`, an `impl Effect` with the hooks it
//! needs), and add its line to the modules and to [`catalogue`], at its place in the chain.
//!
//! - [`effect`]: the hooks, and what passes through them.
//! - [`parameters`]: the declaration, and reading parameters from a description.
//! - [`sought`]: what a diagnosis must know of an effect.

pub(crate) mod effect;
mod parameters;
pub mod sought;

mod background_activity;
mod bandwidth_gradient;
mod black_level;
pub mod blur;
mod clock_drift;
pub mod clock_offset;
pub mod crosstalk;
mod dark_current;
mod dependence;
pub mod event_loss;
mod exposure_time;
mod frame_coupling;
mod frame_gain_steps;
mod frame_nonlinearity;
mod high_pass_front_end;
mod hot_pixels;
mod hot_rows;
mod image_lag;
mod large_signal_front_end;
pub mod lateral_inhibition;
mod leak_events;
pub mod misalignment;
mod parasitic_leak;
mod readout_queue;
mod refractory;
mod refractory_light;
mod refractory_spread;
mod reset_memory;
mod row_skew;
mod row_time;
mod second_pole;
mod slew_limit;
mod threshold_asymmetry;
mod threshold_drift;
mod threshold_gradient;
mod threshold_mismatch;
mod threshold_noise;
mod threshold_scale;
mod time_constant;
mod timestamp_jitter;
mod timestamp_quantization;
mod vignetting;

pub use crate::comparator::PixelEvent;
pub use effect::{
    ArrayEvent, BURST_GAP_NS, Chance, Domain, Drive, Effect, FrontEndModel, History, Impulse, ImpulseTarget,
    Kernel, Latency, Leak, Reading, RowSite, SecondPole, Site, Spontaneous, Tap, Thresholds, row_random,
};
pub use parameters::{EffectDecl, EffectKind, ParameterDecl, Parameters, Stage, Unit};

use photocurrent_core::document::nearest;
use serde_json::{Map, Value};
use std::collections::BTreeMap;

/// Every effect, in the order of the chain. One explicit list: what is not here does not exist.
pub fn catalogue() -> Vec<EffectKind> {
    vec![
        // Light.
        misalignment::KIND,
        blur::KIND,
        crosstalk::KIND,
        // Front end.
        dark_current::KIND,
        time_constant::KIND,
        second_pole::KIND,
        large_signal_front_end::KIND,
        slew_limit::KIND,
        high_pass_front_end::KIND,
        bandwidth_gradient::KIND,
        // Comparator and reset. What scales a threshold comes before what adds to it, so that a stated sigma
        // is the sigma.
        threshold_scale::KIND,
        threshold_asymmetry::KIND,
        threshold_drift::KIND,
        threshold_gradient::KIND,
        threshold_mismatch::KIND,
        threshold_noise::KIND,
        refractory::KIND,
        refractory_spread::KIND,
        refractory_light::KIND,
        reset_memory::KIND,
        leak_events::KIND,
        parasitic_leak::KIND,
        background_activity::KIND,
        hot_pixels::KIND,
        hot_rows::KIND,
        lateral_inhibition::KIND,
        dependence::KIND,
        // Readout and time. Recorded = true x (1 + drift) + offset, and the grid comes last.
        frame_coupling::KIND,
        readout_queue::KIND,
        event_loss::KIND,
        row_skew::KIND,
        timestamp_jitter::KIND,
        clock_drift::KIND,
        clock_offset::KIND,
        timestamp_quantization::KIND,
        // Exposure.
        row_time::KIND,
        exposure_time::KIND,
        image_lag::KIND,
        vignetting::KIND,
        frame_nonlinearity::KIND,
        frame_gain_steps::KIND,
        black_level::KIND,
    ]
}

/// The effects of a sensor description's `[effects]`, in the order of the catalogue.
///
/// # Errors
/// With every mistake, one a line: an id that is not in the catalogue, an unknown key, a wrong value.
pub fn from_description(
    described: &BTreeMap<String, Map<String, Value>>,
) -> Result<Vec<Box<dyn Effect>>, String> {
    let kinds = catalogue();
    let mut problems: Vec<String> = described.keys().filter_map(|id| unknown_id(&kinds, id)).collect();
    let mut effects = Vec::new();
    for kind in &kinds {
        match described.get(kind.decl.id).map(|given| kind.read(given)) {
            Some(Ok(effect)) => effects.push(effect),
            Some(Err(problem)) => problems.push(problem),
            None => {}
        }
    }
    if problems.is_empty() { Ok(effects) } else { Err(problems.join("\n")) }
}

fn unknown_id(kinds: &[EffectKind], id: &str) -> Option<String> {
    let ids = || kinds.iter().map(|kind| kind.decl.id);
    if ids().any(|known| known == id) {
        return None;
    }
    let hint = nearest(id, ids()).map(|near| format!("; did you mean `{near}`?")).unwrap_or_default();
    Some(format!("`effects.{id}`: the simulator knows no such effect{hint}"))
}

#[cfg(test)]
pub(crate) mod simulated;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
