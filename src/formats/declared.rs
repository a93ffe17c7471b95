//! What a user states because the file cannot: nothing of this is guessed silently.

use photocurrent_core::Extent;
use photocurrent_core::quantity::Duration;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Everything that may be stated. A field that is absent is taken from the file, or refused with
/// [`crate::FormatError::undeclared`] where the file lacks it.
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
    /// Are ON and OFF exchanged?
    pub invert_polarity: Option<bool>,
    /// How polarity is stored, where it is not recognised.
    pub polarity: Option<Polarity>,
    /// Which number the first column and row have: 0 or 1.
    pub origin: Option<u32>,
    /// The counter of the stamps, which begins again at its range.
    pub counter: Option<Counter>,
    /// Which level of the trigger line is an open shutter; active high unless it is stated.
    pub strobe: Option<Strobe>,
    /// The pulse of the trigger line, or the entry of the stamps, that belongs to the first picture, counted
    /// from 0; negative where the first pictures have none.
    pub first_pulse: Option<i64>,
    /// By what a missing picture, pulse or stamp is recognised.
    pub pairing: Option<Pairing>,
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

/// How polarity is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Polarity {
    /// 1 is ON; 0 or -1 is OFF; what has another value is left out.
    Signs,
    /// Every value above 0 is ON, every other OFF.
    Counts,
    /// 1 is OFF, 2 is ON: as programs of MATLAB number them.
    OneTwo,
}

/// The counter that gave the stamps: after its last value it begins again at 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Counter {
    /// None: stamps are taken as they are stored.
    None,
    /// 23 bits of microseconds, 8.39 s.
    Us23,
    /// 24 bits of microseconds, 16.8 s.
    Us24,
    /// 28 bits of microseconds, 268 s.
    Us28,
    /// 31 bits of microseconds, 35.8 min.
    Us31,
    /// 32 bits of microseconds, 71.6 min.
    Us32,
    /// 32 bits of nanoseconds, 4.29 s.
    Ns32,
}

impl Counter {
    /// Those that begin again, by their range.
    pub const ALL: [Counter; 6] =
        [Counter::Ns32, Counter::Us23, Counter::Us24, Counter::Us28, Counter::Us31, Counter::Us32];

    /// After which time it begins again, ns; 0 for [`Counter::None`].
    pub fn range_ns(self) -> i64 {
        match self {
            Counter::None => 0,
            Counter::Us23 => (1 << 23) * 1000,
            Counter::Us24 => (1 << 24) * 1000,
            Counter::Us28 => (1 << 28) * 1000,
            Counter::Us31 => (1 << 31) * 1000,
            Counter::Us32 => (1 << 32) * 1000,
            Counter::Ns32 => 1 << 32,
        }
    }

    /// For people: "32 bits of microseconds".
    pub fn name(self) -> &'static str {
        match self {
            Counter::None => "no counter",
            Counter::Us23 => "23 bits of microseconds",
            Counter::Us24 => "24 bits of microseconds",
            Counter::Us28 => "28 bits of microseconds",
            Counter::Us31 => "31 bits of microseconds",
            Counter::Us32 => "32 bits of microseconds",
            Counter::Ns32 => "32 bits of nanoseconds",
        }
    }

    /// As parameters have it: "us32".
    pub fn word(self) -> &'static str {
        match self {
            Counter::None => "none",
            Counter::Us23 => "us23",
            Counter::Us24 => "us24",
            Counter::Us28 => "us28",
            Counter::Us31 => "us31",
            Counter::Us32 => "us32",
            Counter::Ns32 => "ns32",
        }
    }
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
