//! What each input of a network is, and which frames and events belong to a wanted instant.

use super::voxel::{Grid, Normalise, Signs, Stretch};
use crate::onnx::Sockets;
use photocurrent_core::{Exposure, FramesMeta, NodeError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Which of the two frames around the instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// The one before.
    #[default]
    Before,
    /// The one after.
    After,
}

/// An input that is a captured frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FrameInput {
    /// Its name.
    pub input: String,
    /// Which of the two frames around the instant.
    pub take: Side,
    /// Channels, each the grey frame.
    #[serde(default = "one")]
    #[schemars(range(min = 1, max = 3))]
    pub channels: u32,
    /// Values of black and of white.
    #[serde(default = "zero_to_one")]
    pub range: [f64; 2],
}

/// An input that is a voxel grid of events.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct VoxelInput {
    /// Its name.
    pub input: String,
    /// Bins of time.
    #[serde(default = "five")]
    #[schemars(range(min = 1, max = 1000))]
    pub bins: u32,
    /// From when to when events count.
    #[serde(default)]
    pub window: Window,
    /// How ON and OFF events are distinguished.
    #[serde(default)]
    pub polarity: Signs,
    /// What cells are divided by.
    #[serde(default)]
    pub normalise: Normalise,
    /// Between which instants bins are spread.
    #[serde(default)]
    pub stretch: Stretch,
    /// Time runs backward, and ON counts as OFF.
    #[serde(default)]
    pub reversed: bool,
}

impl VoxelInput {
    /// How its grid is made.
    pub fn grid(&self) -> Grid {
        let VoxelInput { bins, polarity, normalise, stretch, reversed, .. } = *self;
        Grid { bins: bins as usize, signs: polarity, normalise, stretch, reversed }
    }
}

/// What a network remembers: an output of one picture that is an input of the next.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StateInput {
    /// Name of the input; all 0 for the first picture.
    pub input: String,
    /// Name of the output.
    pub output: String,
    /// Channels.
    #[schemars(range(min = 1, max = 10000))]
    pub channels: u32,
    /// Width and height of the frames over those of the state.
    #[serde(default = "one")]
    #[schemars(range(min = 1, max = 1024))]
    pub downscale: u32,
}

fn one() -> u32 {
    1
}

fn five() -> u32 {
    5
}

fn zero_to_one() -> [f64; 2] {
    [0.0, 1.0]
}

/// From when to when events count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Window {
    /// From the frame before to the frame after.
    #[default]
    Between,
    /// From the frame before to the instant.
    BeforeToInstant,
    /// From the instant to the frame after.
    InstantToAfter,
    /// From the start of the exposure before to the end of the exposure after.
    Exposures,
    /// From the picture before to this one; for the first one, from the first event.
    SinceLast,
}

impl Window {
    /// The window of a moment, ns; `last` is the instant of the picture before, `events` are the first and
    /// last stamp of all.
    pub fn of(self, moment: &Moment, last: Option<i64>, events: Option<(i64, i64)>) -> Range<i64> {
        let (before, after) =
            moment.pair.map_or((moment.t, moment.t), |pair| (pair.before_ns, pair.after_ns));
        match self {
            Window::Between => before..after,
            Window::BeforeToInstant => before..moment.t,
            Window::InstantToAfter => moment.t..after,
            Window::Exposures => moment.pair.map_or(moment.t..moment.t, |pair| pair.start_ns..pair.end_ns),
            Window::SinceLast => {
                last.or(events.map(|(first, _)| first)).map_or(moment.t, |start| i64::min(start, moment.t))
                    ..moment.t
            }
        }
    }
}

/// The captured frames on either side of an instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pair {
    /// Index of the frame before; the next one is that after.
    pub before: usize,
    /// Middle of its exposure, ns.
    pub before_ns: i64,
    /// Middle of the next exposure, ns.
    pub after_ns: i64,
    /// Start of its exposure, ns.
    pub start_ns: i64,
    /// End of the next exposure, ns.
    pub end_ns: i64,
}

/// A wanted picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Moment {
    /// Its number among the wanted ones.
    pub wanted: usize,
    /// The middle of its exposure at the middle row, ns.
    pub t: i64,
    /// The frames around it, where there are two.
    pub pair: Option<Pair>,
}

impl Moment {
    /// Its place between the frames: 0 at the one before, 1 at the one after.
    pub fn share(&self) -> f64 {
        self.pair.map_or(0.0, |pair| {
            (self.t - pair.before_ns) as f64 / i64::max(pair.after_ns - pair.before_ns, 1) as f64
        })
    }
}

/// The wanted instants among the captured frames, in their order.
pub fn moments(captured: &FramesMeta, wanted: &FramesMeta) -> Vec<Moment> {
    let row = captured.extent.height / 2;
    let exposures: Vec<Exposure> =
        (0..captured.times.len()).map(|l| captured.times.exposure(l, row)).collect();
    let middles: Vec<i64> = exposures.iter().map(|exposure| exposure.mid().0).collect();
    let moment = |n: usize| {
        let t = wanted.times.exposure(n, row).mid().0;
        // The last frame's own instant belongs to the last pair.
        let after =
            usize::min(middles.partition_point(|&middle| middle <= t), middles.len().saturating_sub(1));
        let pair = after.checked_sub(1).filter(|&before| middles[before] <= t && t <= middles[after]);
        let pair = pair.map(|before| Pair {
            before,
            before_ns: middles[before],
            after_ns: middles[after],
            start_ns: exposures[before].start.0,
            end_ns: exposures[after].end.0,
        });
        Moment { wanted: n, t, pair }
    };
    (0..wanted.times.len()).map(moment).collect()
}

/// All inputs of a network.
#[derive(Clone, Copy)]
pub struct Layout<'a> {
    /// Captured frames.
    pub frames: &'a [FrameInput],
    /// Events.
    pub voxels: &'a [VoxelInput],
    /// The instant's place.
    pub time: Option<&'a str>,
    /// What it remembers.
    pub states: &'a [StateInput],
}

impl Layout<'_> {
    /// Does anything hang on the frames around an instant?
    pub fn needs_pairs(&self) -> bool {
        !self.frames.is_empty()
            || self.time.is_some()
            || self.voxels.iter().any(|voxel| voxel.window != Window::SinceLast)
    }

    /// (parameter, input).
    fn inputs(&self) -> Vec<(&'static str, &str)> {
        let frames = self.frames.iter().map(|frame| ("frames", frame.input.as_str()));
        let voxels = self.voxels.iter().map(|voxel| ("voxels", voxel.input.as_str()));
        let states = self.states.iter().map(|state| ("states", state.input.as_str()));
        frames.chain(voxels).chain(self.time.map(|time| ("time", time))).chain(states).collect()
    }

    /// Refuses an input that is said to be two things, and ranges without an extent.
    ///
    /// # Errors
    /// With the parameter that says it the second time.
    pub fn check_names(&self) -> Result<(), NodeError> {
        let inputs = self.inputs();
        for (n, (param, name)) in inputs.iter().enumerate() {
            if let Some((first, _)) = inputs[..n].iter().find(|(_, other)| other == name) {
                return Err(NodeError::usage(format!(
                    "the input `{name}` stands in `{first}` and again in `{param}`"
                ))
                .hint("each input of the network is one thing: take one of them out")
                .param(*param));
            }
        }
        match self.frames.iter().find(|frame| {
            !(frame.range[0].is_finite() && frame.range[1].is_finite() && frame.range[0] != frame.range[1])
        }) {
            Some(frame) => Err(NodeError::usage(format!(
                "black and white of `{}` are {} and {}",
                frame.input, frame.range[0], frame.range[1]
            ))
            .hint("state two different numbers: range = [0.0, 1.0]")
            .param("frames")),
            None => Ok(()),
        }
    }

    /// Holds the layout against what the network takes and gives.
    ///
    /// # Errors
    /// When an input or an output is not there, or an input of the network is not in the layout; with the
    /// names that are there.
    pub fn check(&self, network: &str, sockets: &Sockets, output: &str) -> Result<(), NodeError> {
        let list =
            |names: &[String]| names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
        let has = |error: NodeError| {
            error
                .note(format!("its inputs: {}", list(&sockets.inputs)))
                .note(format!("its outputs: {}", list(&sockets.outputs)))
        };
        let given = self.inputs();
        if let Some((param, name)) =
            given.iter().find(|(_, name)| !sockets.inputs.iter().any(|input| input == name))
        {
            return Err(has(NodeError::input(format!("the network {network} has no input `{name}`")))
                .hint("name an input that it has")
                .param(*param));
        }
        let outputs = std::iter::once(("output", output))
            .chain(self.states.iter().map(|state| ("states", state.output.as_str())));
        if let Some((param, name)) =
            outputs.into_iter().find(|(_, name)| !sockets.outputs.iter().any(|output| output == name))
        {
            return Err(has(NodeError::input(format!("the network {network} has no output `{name}`")))
                .hint("name an output that it has")
                .param(param));
        }
        if let Some(missing) =
            sockets.inputs.iter().find(|input| !given.iter().any(|(_, name)| name == input))
        {
            return Err(has(NodeError::input(format!(
                "the network {network} takes `{missing}`, and nothing says what that is"
            )))
            .hint("say so in `frames`, `voxels`, `time` or `states`")
            .param("network"));
        }
        Ok(())
    }
}
