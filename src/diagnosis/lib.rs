//! Where a recording and the sensor model differ, and which physics is missing.
//!
//! The scene is unknown: it is estimated with the model as stated, and an effect shows in what that scene cannot explain. Everything physical is called
//! from [`photocurrent_sensor`]: an effect that is added to the catalogue there is a candidate here.
//!
//! In reading order:
//!
//! - [`case`]: what is diagnosed: events by pixel, frames, the description.
//! - [`nominal`]: the sensor as the description states it, ready to simulate and to solve.
//! - [`sample`]: which pixels are looked at.
//! - [`scene`]: the light of those pixels, estimated with the nominal sensor.
//! - [`band`]: the same light quicker, by a thread through the events, anchored to the frames.
//! - [`record`]: what a sensor with effects would have recorded of that light.
//! - [`faithful`]: the prior that gives each pixel a light which fires its events again.
//! - [`light`]: that light as a value by itself, to be handed on and taken back.
//! - [`residuals`]: what the stated sensor makes of it, against the recording.
//! - [`likelihood`]: how far effects explain, event by event, what the estimated light does not.
//! - [`summaries`]: a recording in some three hundred numbers.
//! - [`deviation`]: how it differs in them from the nominal sensor's recording of the same scene, and how it would with an effect.
//! - [`candidates`]: every effect of the catalogue, how large it usually is, and how it is put on.
//! - [`covariates`], [`differences`], [`locate`]: where a recording and a simulation of it differ.
//! - [`synthesis`]: recognition: [`floor`] (what means nothing), [`proposer`] (a small net), [`matching`] (templates against the deviation), [`knowledge`] (the file).
//! - [`scenes`], [`train`]: made-up recordings, and what the recogniser learns from.
//! - [`integrity`]: what shows without a scene: broken data, stamps, hot rows and pixels, lost events, flicker.
//! - [`roads`]: the tests that estimate the scene, in one form.
//! - [`picture`], [`residual`], [`decide`]: a scene that frames alone state, residuals of events on it, and what they say.
//! - [`contest`]: what refits propose, on pixels at which none of them looked.
//! - [`verdict`]: one answer from all tests.
//! - [`fitted`]: the description with what was found put in.
//! - [`heldout`]: frames that were kept back, before and after.
//! - [`comparison`]: events, before and after: mismatch by place and time, gain of each effect, calibration.
//! - [`advice`]: what to record next.
//! - [`diagnose`]: all of it, in order.
//! - [`stages`]: what passes between its stages, as documents.
//! - [`page`]: the same as a page of HTML.
//! - [`report`]: what a diagnosis says, as `diagnosis.json`.
//!
//! The crate knows no files and no graphs. It never sees true light.

pub mod advice;
pub mod band;
pub mod candidates;
pub mod case;
pub mod closures;
pub mod comparison;
pub mod components;
pub mod contest;
pub mod covariates;
pub mod decide;
pub mod deviation;
pub mod diagnose;
pub mod differences;
pub mod faithful;
pub mod first_order;
pub mod fitted;
pub mod floor;
pub mod heldout;
pub mod integrity;
pub mod knowledge;
pub mod law;
pub mod light;
pub mod likelihood;
pub mod linear;
pub mod locate;
pub mod made;
pub mod matching;
pub mod mismatch;
pub mod nominal;
pub mod onnx;
pub mod open;
pub mod page;
pub mod picture;
pub mod proposer;
pub mod record;
pub mod refit;
pub mod regression;
pub mod report;
pub mod residual;
pub mod residuals;
pub mod rhythm;
pub mod roads;
pub mod sample;
pub mod scene;
pub mod scenes;
pub mod search;
pub mod stages;
pub mod summaries;
pub mod synthesis;
pub mod train;
pub mod under;
pub mod verdict;

mod instants;
mod side;

#[cfg(test)]
mod testing;
