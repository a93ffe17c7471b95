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
    /// Which level of the trigger line is an open shutter; active high unless it is stated.
    pub strobe: Option<Strobe>,
    /// The pulse of the trigger line, or the entry of the stamps, that belongs to the first picture, counted from 0; negative where the first pictures have none.
    pub first_pulse: Option<i64>,
    /// By what a missing picture, pulse or stamp is recognised.
    pub pairing: Option<Pairing>,
}

/// Which level of a trigger line is an open shutter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Strobe {
    /// A rising edge opens the shutter, a falling one closes it.
    ActiveHigh,
    /// A falling edge opens the shutter, a rising one closes it: the line is inverted, as by an opto-coupler.
    ActiveLow,
}

impl Strobe {
    /// As it stands in manifests.
    pub fn name(self) -> &'static str {
        match self {
            Strobe::ActiveHigh => "active_high",
            Strobe::ActiveLow => "active_low",
        }
    }

    /// What opens the shutter and what closes it.
    pub fn edges(self) -> &'static str {
        match self {
            Strobe::ActiveHigh => "rising opens the shutter, falling closes it",
            Strobe::ActiveLow => "falling opens the shutter, rising closes it",
        }
    }
}

/// By what a missing picture, pulse or stamp is recognised where pictures and times are paired in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Pairing {
    /// By nothing: the next picture belongs to the next time.
    Order,
    /// A hole in the numbers of the pictures' names is a missing picture.
    Numbers,
    /// A gap of whole periods between the times is a missing pulse or stamp.
    Times,
    /// Both.
    NumbersAndTimes,
}

impl Pairing {
    /// As it stands in manifests.
    pub fn name(self) -> &'static str {
        match self {
            Pairing::Order => "order",
            Pairing::Numbers => "numbers",
            Pairing::Times => "times",
            Pairing::NumbersAndTimes => "numbers_and_times",
        }
    }

    pub(crate) fn uses_numbers(self) -> bool {
        matches!(self, Pairing::Numbers | Pairing::NumbersAndTimes)
    }

    pub(crate) fn uses_times(self) -> bool {
        matches!(self, Pairing::Times | Pairing::NumbersAndTimes)
    }
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
