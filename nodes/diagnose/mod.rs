//! The stages of a diagnosis as nodes: differences between a recording and its description, and the missing
//! physics.
//!
//! Each stage calls one function of `photocurrent_diagnosis`; the stages exchange documents with a kind. The
//! wiring of a whole diagnosis is `pipelines/diagnose/recording.toml`; docs/diagnosis.md explains the stages.

pub mod confirm;
pub mod decide;
pub mod evidence;
pub mod integrity;
pub mod target;

use crate::spans::check_one_clock;
use photocurrent_core::{
    DataType, Diagnosis, EventStream, EventsMeta, FrameSequence, FramesMeta, Meta, NodeError, PortMetas,
    Sensor,
};
use photocurrent_diagnosis::integrity::Integrity;
use photocurrent_diagnosis::stages::read_integrity;
use photocurrent_scene::case::Case;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Findings of direct tests that are applied before the next stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum KnownFindings {
    /// It is put into the description, and pixels that they exclude are left out.
    #[default]
    Findings,
    /// None: the recording and its description stay as they are.
    Nothing,
}

impl KnownFindings {
    /// Selects findings from a document of direct tests; none without a document.
    fn select_from(self, document: Option<&Diagnosis>) -> Result<Integrity, NodeError> {
        let found = document.map(read_integrity).transpose()?.unwrap_or_default();
        Ok(match self {
            KnownFindings::Findings => found,
            KnownFindings::Nothing => Integrity { findings: Vec::new(), masked: Vec::new(), ..found },
        })
    }
}

/// The recording at the ports `events` and `frames`, in memory.
fn case(
    events: Option<&EventStream>,
    frames: Option<&FrameSequence>,
    sensor: &Sensor,
) -> Result<Case, NodeError> {
    Ok(Case::read(events, frames, sensor)?)
}

/// Refuses inputs that cannot be diagnosed before their data are read: no stream, frames of another form than
/// the events, a description that lacks what the model needs.
fn check(inputs: &PortMetas) -> Result<&Arc<Sensor>, NodeError> {
    empty(inputs)?;
    inputs.sensor("sensor")
}

/// The recording as far as it is known before its data; refuses as [`check`] does.
fn empty(inputs: &PortMetas) -> Result<Case, NodeError> {
    let (events, frames): (Option<&Arc<EventsMeta>>, Option<&Arc<FramesMeta>>) =
        (inputs.events("events").ok(), inputs.frames("frames").ok());
    let sensor = inputs.sensor("sensor")?;
    if events.is_none() && frames.is_none() {
        return Err(NodeError::usage("there is nothing to diagnose: neither `events` nor `frames` is there")
            .hint("connect at least one of them"));
    }
    let empty = Case::before_data(events.map(|events| &**events), frames.map(|frames| &**frames), sensor)
        .map_err(|error| {
            NodeError::usage(error.message)
                .hint("crop or bin the frames to the pixels of the event sensor")
                .blames(DataType::Frames)
        })?;
    if let (Some(events), Some(frames)) = (events, frames) {
        check_one_clock(events, frames, Some(sensor))?;
    }
    empty.nominal().map_err(|error| error.blames(DataType::Sensor))?;
    Ok(empty)
}

/// A description that is not known yet is planned as the stated one, as a diagnosis changes few fields. A
/// node whose outputs depend on the change (another row time, say) reports it when it runs.
fn planned(sensor: &Arc<Sensor>) -> Meta {
    Meta::Sensor(sensor.clone())
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Colour, Extent, testing};

    fn metas(sensor: Sensor, frames: Option<FramesMeta>) -> PortMetas {
        let mut metas = vec![("sensor".to_string(), vec![Meta::Sensor(Arc::new(sensor))])];
        metas.push(("events".to_string(), vec![Meta::Events(testing::events(6, 5).meta)]));
        metas.extend(frames.map(|frames| ("frames".to_string(), vec![Meta::Frames(Arc::new(frames))])));
        PortMetas::new(metas.into_iter().collect())
    }

    #[test]
    fn what_cannot_be_diagnosed_is_refused_before_any_data() {
        let frames = (*testing::frames(6, 5, 3).meta).clone();
        let error = check(&metas(Sensor::unknown("blank"), Some(frames.clone()))).unwrap_err();
        assert!(
            error.message.contains("`comparator.threshold_on`") && error.message.contains("`frames.gain`"),
            "{}",
            error.message
        );
        assert!(error.hint.is_some_and(|hint| hint.contains("photocurrent init")));
        let larger = FramesMeta { extent: Extent { width: 13, height: 10 }, ..frames };
        let error = check(&metas(Sensor::unknown("blank"), Some(larger))).unwrap_err();
        assert!(
            error.message.contains("frames of 6 x 5 pixels") && error.message.contains("13 x 10"),
            "{}",
            error.message
        );
        let nothing = PortMetas::new(
            [("sensor".to_string(), vec![Meta::Sensor(Arc::new(Sensor::unknown("blank")))])].into(),
        );
        assert!(check(&nothing).unwrap_err().message.contains("nothing to diagnose"));
    }

    #[test]
    fn thresholds_and_gain_are_enough_and_frames_may_be_in_colour_or_finer() {
        let mut sensor = Sensor::unknown("as `photocurrent init` writes it");
        (sensor.comparator.threshold_on, sensor.comparator.threshold_off, sensor.frames.gain) =
            (Some(0.2), Some(0.2), Some(100.0));
        let frames = (*testing::frames(6, 5, 3).meta).clone();
        let finer = FramesMeta { extent: Extent { width: 12, height: 10 }, ..frames.clone() };
        for frames in [frames.clone(), finer, FramesMeta { colour: Colour::Rgb, ..frames }] {
            assert!(check(&metas(sensor.clone(), Some(frames))).is_ok());
        }
    }
}
