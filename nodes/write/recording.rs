//! Writes a recording in the project's own HDF5 layout, for other programs and for later runs.
//!
//! What `read/recording` reads, this writes: events with their stamps, frames with their exposures, the
//! sensor description, and for simulated data the truth. The layout is plain HDF5
//! (`photocurrent-recording/1`, docs/formats.md): h5py, xarray and MATLAB open it with nothing installed.
//!
//! Limits: events are held in memory while they are brought into time order, about 20 bytes each. A
//! compensated `step` is no part of the layout and is left out.

use photocurrent_core::extent::Extent;
use photocurrent_core::table::{Column, TableMeta};
use photocurrent_core::{
    Context, Decl, EventStream, FrameSequence, Grain, Meta, Node, NodeError, PortMetas, Sensor, Table, Truth,
};
use photocurrent_store::recording::{DnType, RecordingContent, write_recording};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// How digital numbers are stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Numbers {
    /// As they are, 32-bit floating point; NaN stays NaN.
    #[default]
    F32,
    /// Rounded to whole numbers from 0 to 65535; NaN becomes 0.
    U16,
}

/// Parameters of `write/recording`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// How digital numbers are stored.
    pub numbers: Numbers,
}

photocurrent_core::ports! {
    /// What the recording is made of; events or frames at least.
    pub struct In {
        /// The events.
        events: Option<EventStream>,
        /// The frames as captured.
        frames: Option<FrameSequence>,
        /// The sensor that recorded them, as far as it is known.
        sensor: Option<Arc<Sensor>>,
        /// True frames, of simulated data.
        truth: Option<Truth>,
    }
}

photocurrent_core::ports! {
    /// What was written.
    pub struct Out {
        /// One row: file, number of events, of frames, of true frames.
        listing: Arc<Table>,
    }
}

/// The node.
pub struct WriteRecording {
    params: Params,
}

/// The file that it writes into its folder.
const FILE: &str = "recording.h5";

impl Node for WriteRecording {
    const DECL: Decl = Decl {
        kind: "write/recording",
        about: "Writes a recording in the documented HDF5 layout.",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: true,
        sources: &["photocurrent-recording/1 (docs/formats.md)"],
        example: r#"
[nodes.recording_file]
kind   = "write/recording"
in     = { events = "scene.events", frames = "scene.frames", sensor = "sensor", truth = "scene.truth" }
params = { numbers = "u16" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(WriteRecording { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        if !inputs.has("events") && !inputs.has("frames") {
            return Err(NodeError::usage(
                "there is nothing to record: neither `events` nor `frames` is connected",
            )
            .hint("connect at least one of them"));
        }
        let sizes: Vec<(&str, Extent)> =
            inputs.iter().filter_map(|(port, meta)| Some((port, extent_of(meta)?))).collect();
        // The events' pixels are the sensor's, or else the frames'; frames and truth may have several on
        // each.
        if let Some((port, extent)) =
            sizes.iter().find(|(port, extent)| match (*port, extent.multiple_of(sizes[0].1)) {
                ("events", times) => times != Some(1),
                (_, times) => times.is_none(),
            })
        {
            return Err(NodeError::usage(format!(
                "`{port}` is {extent}, and `{}` is {}",
                sizes[0].0, sizes[0].1
            ))
            .hint(
                "one recording is of one sensor: frames have the events' extent or a whole multiple of it",
            ));
        }
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: false }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let extent = input
            .events
            .as_ref()
            .map(|events| events.meta.extent)
            .or(input.frames.as_ref().map(|frames| frames.meta.extent));
        let extent = extent.ok_or_else(|| NodeError::usage("there is nothing to record"))?;
        let sensor = input.sensor.as_deref().map(Sensor::to_toml);
        let content = RecordingContent {
            events: input.events.as_ref(),
            frames: input.frames.as_ref(),
            dn: match self.params.numbers {
                Numbers::F32 => DnType::F32,
                Numbers::U16 => DnType::U16,
            },
            sensor: sensor.as_deref(),
            truth: input.truth.as_ref(),
            ..RecordingContent::empty(extent)
        };
        let events = write_recording(&cx.export_dir()?.join(FILE), &content)? as i64;
        let count = |frames: Option<&FrameSequence>| {
            Column::Integers(vec![frames.map_or(0, |frames| frames.len() as i64)])
        };
        let listing = Table::default()
            .with("file", Column::Texts(vec![FILE.into()]))
            .with("events", Column::Integers(vec![events]))
            .with("frames", count(input.frames.as_ref()))
            .with("truth", count(input.truth.as_ref().map(|truth| &truth.0)));
        Ok(Out { listing: Arc::new(listing) })
    }
}

fn extent_of(meta: &Meta) -> Option<Extent> {
    match meta {
        Meta::Events(meta) => Some(meta.extent),
        Meta::Frames(meta) | Meta::Truth(meta) => Some(meta.extent),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::write::testing::exporting;
    use photocurrent_core::document::Source;
    use photocurrent_core::testing;
    use photocurrent_store::recording::Recording;

    #[test]
    fn what_is_written_is_read_back() {
        let (events, frames) = (testing::events(6, 5), testing::frames(6, 5, 3));
        let mut sensor = Sensor::unknown("test");
        sensor.comparator.threshold_on = Some(0.2);
        let input = In {
            events: Some(events.clone()),
            frames: Some(frames.clone()),
            sensor: Some(Arc::new(sensor.clone())),
            truth: Some(Truth(frames.clone())),
        };
        exporting(
            |cx| WriteRecording { params: Params::default() }.run(input, cx).unwrap(),
            |out, _, folder| {
                let recording = Recording::open(&folder.join(FILE)).unwrap();
                let rows = events.rows();
                assert_eq!(recording.read_events(rows).unwrap(), events.read(rows).unwrap());
                let row_time_ns = recording.row_time_ns().unwrap();
                assert_eq!(
                    recording.frames(row_time_ns).unwrap().read_rows(rows).unwrap(),
                    frames.read_rows(rows).unwrap()
                );
                let text = recording.sensor_text().unwrap();
                assert_eq!(Sensor::parse(&Source::new("/sensor", "", text)).unwrap(), sensor);
                assert_eq!(recording.truth_times().unwrap().len(), 3);
                assert_eq!(out.listing.column("events"), Some(&Column::Integers(vec![300])));
            },
        );
    }

    #[test]
    fn nothing_to_record_and_two_sizes_are_refused() {
        let node = WriteRecording { params: Params::default() };
        assert!(node.plan(&PortMetas::default()).unwrap_err().message.contains("nothing to record"));
        let events = Meta::Events(testing::events(6, 5).meta);
        let frames = Meta::Frames(testing::frames(5, 6, 1).meta);
        let inputs = PortMetas::new(
            [("events".to_string(), vec![events]), ("frames".to_string(), vec![frames])].into(),
        );
        assert_eq!(node.plan(&inputs).unwrap_err().message, "`frames` is 5 x 6, and `events` is 6 x 5");
    }
}
