//! What a user states because the file cannot: nothing of this is guessed silently.

use photocurrent_core::Extent;
use photocurrent_core::quantity::Duration;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Everything that may be stated. A field that is absent is taken from the file, or refused with [`crate::FormatError::undeclared`] where the file lacks it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Declared {
    /// Size of the event pixel array.
    pub extent: Option<Extent>,
    /// Unit of the stamps, where a format leaves it open: text, npz, memmap, folders.
    pub time_unit: Option<TimeUnit>,
    /// What the columns of a text file hold, from the left.
    pub columns: Option<Vec<Column>>,
    /// Stored coordinates count this many to a pixel (32 in HS-ERGB and BS-ERGB).
    pub coordinate_scale: Option<u32>,
    /// Which camera, topic or stream of a file with several, as the file names it: `left`, `/dvs/events`.
    pub camera: Option<String>,
    /// Which image topic or stream of a file with several.
    pub frame_camera: Option<String>,
    /// Frames in a place of their own: a folder of pictures, a Y4M file.
    pub frames: Option<PathBuf>,
    /// Stamps of those frames: a text file.
    pub stamps: Option<PathBuf>,
    /// The trigger line of the event file whose edges are the exposures of those frames.
    pub trigger_line: Option<u16>,
    /// Length of a frame's exposure, where it is not recorded.
    pub exposure: Option<Duration>,
    /// What a frame's one stamp means, where it is not recorded.
    pub stamp: Option<StampRole>,
    /// How stored values of pictures follow from linear ones, where it is not recorded.
    pub transfer: Option<Transfer>,
    /// Unit of the frames' stamps, where their file leaves it open; absent = [`Declared::time_unit`].
    pub stamps_unit: Option<TimeUnit>,
    /// The frames' picture is mirrored against the events.
    pub mirror: Option<Mirror>,
    /// Event pixels by which the events lie right of and below the frames' picture.
    pub shift: Option<Shift>,
    /// Frames that are left out, numbered from 0 in the order of the file.
    pub skip_frames: Option<Vec<u32>>,
    /// Are events that are there twice (one time, pixel and sign) read once?
    pub drop_duplicates: Option<bool>,
}

/// How the frames' picture lies against the events'.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Mirror {
    /// Columns run the other way.
    LeftRight,
    /// Rows run the other way.
    TopBottom,
    /// Both: turned by half a turn.
    Both,
}

/// A shift in whole event pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Shift {
    /// Columns by which events lie to the right of the frames' picture; negative = to the left.
    #[schemars(range(min = -4096, max = 4096))]
    pub right: i32,
    /// Rows by which they lie below it; negative = above.
    #[schemars(range(min = -4096, max = 4096))]
    pub down: i32,
}

/// Unit of stored stamps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum TimeUnit {
    /// Seconds.
    S,
    /// Milliseconds.
    Ms,
    /// Microseconds.
    Us,
    /// Nanoseconds.
    Ns,
}

impl TimeUnit {
    /// Nanoseconds in one.
    pub fn ns(self) -> i64 {
        match self {
            TimeUnit::S => 1_000_000_000,
            TimeUnit::Ms => 1_000_000,
            TimeUnit::Us => 1_000,
            TimeUnit::Ns => 1,
        }
    }
}

/// What a column of a text file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Column {
    /// Off-pixel time.
    T,
    /// Column of the pixel.
    X,
    /// Row of the pixel.
    Y,
    /// Polarity: 1 ON; 0 or -1 OFF.
    P,
    /// In-pixel time.
    TIn,
    /// Not read.
    Skip,
}

/// What a frame's one stamp means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum StampRole {
    /// Start of the exposure of row 0.
    Start,
    /// Middle of the exposure of row 0.
    Middle,
    /// End of the exposure of row 0.
    End,
}

/// How stored values follow from linear ones.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Transfer {
    /// They are linear.
    Linear,
    /// The curve of IEC 61966-2-1.
    Srgb,
    /// stored = linear ^ (1 / gamma), both of 0 to 1.
    Gamma(f64),
}
