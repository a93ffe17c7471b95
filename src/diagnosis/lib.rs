//! Where a recording and the sensor model differ, and which physics is missing.
//!
//! The scene is unknown: it is estimated with the nominal model, and an effect shows in what that scene
//! cannot explain. Everything physical is called from [`photocurrent_sensor`]: an effect that is added to the
//! catalogue there is a candidate here.
//!
//! In reading order:
//!
//! - [`photocurrent_scene`]: what is diagnosed, a recording in memory ([`photocurrent_scene::case`]), and the
//!   scene that its frames state.
//! - [`unstated`]: what a description leaves out, and which tests that excludes.
//! - [`integrity`]: what shows without a scene: broken data, stamps, hot rows and pixels, lost events,
//!   flicker.
//! - [`candidates`]: every effect of the catalogue, how large it usually is, and how it is applied.
//! - [`residual`]: by how much events miss their thresholds on a scene, and what each effect explains of
//!   that.
//! - [`covariates`], `dependence`, `rhythm`: what may depend on what, where no effect has a name for it.
//! - [`decide`]: probabilities from that, and where their numbers come from ([`scenes`],
//!   [`targets`]: made-up recordings).
//! - [`verdict`]: one answer from direct tests and from what was decided; `finding`: what it consists of.
//! - [`fitted`]: the description with what was found put in.
//! - `heldout`: held-out frames, before and after; `sample` (the pixels that are evaluated), `curves`
//!   (their light).
//! - `record`: what a sensor with effects would have recorded of a light.
//! - `advice`: what to record next; `limits`: which effects would have been seen.
//! - [`mod@diagnose`]: direct tests and confirmation; [`whole`]: all stages in one call ([`diagnose()`]).
//! - [`stages`]: what passes between them, as documents.
//! - [`unknowns`]: numbers that a description states as a range; [`unstated`]: those it lacks.
//! - [`report`]: the results of a diagnosis, as `diagnosis.json`; [`units`]: its numbers for people.
//! - [`page`]: the same as a page of HTML.
//!
//! The crate uses no files and no graphs. It never reads true light.

#![cfg_attr(not(test), warn(unreachable_pub))]

mod advice;
pub mod candidates;
pub mod covariates;
mod curves;
pub mod decide;
mod dependence;
pub mod diagnose;
mod finding;
pub mod fitted;
mod formula;
mod heldout;
pub mod integrity;
pub mod judge;
mod limits;
pub mod page;
mod record;
pub mod report;
pub mod residual;
mod rhythm;
mod rivals;
mod sample;
#[cfg(any(test, feature = "simulated"))]
pub mod scenes;
pub mod stages;
#[cfg(any(test, feature = "simulated"))]
pub mod targets;
pub mod units;
pub mod unknowns;
pub mod unstated;
pub mod verdict;
pub mod whole;

pub use whole::{DiagnosisOptions, diagnose};

#[cfg(test)]
mod testing;
