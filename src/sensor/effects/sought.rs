//! What a diagnosis must know of an effect: which of its numbers may be missing from a description, how large
//! each usually is, and from which size it matters.
//!
//! An *effect size* of 1 is an effect that an engineer would care for, 0 none. Sizes go with how bright, fast
//! and busy a recording is ([`Measure`]); who has the recording says how much of a measure it has.

use crate::model::Model;
use std::fmt;

/// Whether a diagnosis looks for an effect.
#[derive(Clone, Copy, Debug)]
pub enum Search {
    /// By these numbers, at least one.
    For(&'static [Sought]),
    /// It does not, and why, as the end of a sentence: "a diagnosis does not look for it: ...".
    Not(&'static str),
}

impl Search {
    /// The numbers that are looked for.
    pub fn numbers(self) -> &'static [Sought] {
        match self {
            Search::For(numbers) => numbers,
            Search::Not(_) => &[],
        }
    }
}

/// One number of an effect that may be missing from a description.
#[derive(Clone, Copy, Debug)]
pub struct Sought {
    /// TOML key of the number; empty for an effect without one, `reset` for another reset rule.
    pub parameter: &'static str,
    /// Which signs of an effect size are physics.
    pub signs: Signs,
    /// Is what happens random, so that another seed gives another recording with the same statistics?
    pub is_random: bool,
    /// What an effect size of 1 adds to the number, in the unit of its declaration.
    pub typical: Size,
    /// The size beyond which somebody cares, in the unit of the declaration; of switches and limits, any.
    pub material: Size,
    /// How the effect follows its number.
    pub grows: Grows,
    /// The field of a description that states it; none where only `[effects]` can.
    pub field: Option<Field>,
    /// Parameters that are not sought and must be there, with a value each in the unit of its declaration.
    pub others: &'static [(&'static str, Size)],
    /// Another effect that it means nothing without.
    pub companion: Option<Companion>,
    /// Of a random number: the effect and the parameter whose sizes it spreads over pixels.
    pub spread_of: Option<(&'static str, &'static str)>,
    /// Are its events counted where nothing moves? What a direct test finds is then certain however little it
    /// is, and matters.
    pub is_counted: bool,
    /// Does it change how far the log light swings on its way from event to event? A scene that is too soft
    /// or too sharp does as well, so that its gains say less.
    pub is_of_swing: bool,
    /// Does it shift all events alike against the frames, in time or in contrast? A scene of both follows
    /// that so far that its gain to first order is below those of its look-alikes.
    pub is_followed: bool,
    /// Is a decision calibrated on recordings that are made with it? Not with what shows without any scene,
    /// nor with what looks like another number.
    pub is_made: bool,
    /// Does it come behind the numbers of all other effects? So what joins an effect later leaves the others
    /// the places that documents and made recordings count them by.
    pub comes_last: bool,
}

impl Sought {
    const fn of(parameter: &'static str, signs: Signs) -> Sought {
        Sought {
            parameter,
            signs,
            is_random: false,
            typical: Size::Fixed(1.0),
            material: Size::Fixed(0.0),
            grows: Grows::Linearly,
            field: None,
            others: &[],
            companion: None,
            spread_of: None,
            is_counted: false,
            is_of_swing: false,
            is_followed: false,
            is_made: true,
            comes_last: false,
        }
    }

    /// A number that may err either way.
    pub const fn both(parameter: &'static str) -> Sought {
        Sought::of(parameter, Signs::Both)
    }

    /// A number of which there may only be more than nothing.
    pub const fn positive(parameter: &'static str) -> Sought {
        Sought::of(parameter, Signs::Positive)
    }

    /// The size of something random.
    pub const fn random(parameter: &'static str) -> Sought {
        Sought { is_random: true, ..Sought::of(parameter, Signs::Positive) }
    }

    /// Something that is there or not.
    pub const fn switch(parameter: &'static str) -> Sought {
        Sought::of(parameter, Signs::Switch)
    }

    /// The value that the description states, or that means nothing, in the unit of the declaration.
    pub fn stated(&self, model: &Model) -> f64 {
        self.field.map_or(0.0, |field| field.stated(model))
    }
}

/// Which signs of an effect size are physics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signs {
    /// Only more than nothing.
    Positive,
    /// Either way.
    Both,
    /// There or not there.
    Switch,
}

/// How an effect follows its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grows {
    /// In proportion.
    Linearly,
    /// With its square.
    WithSquare,
    /// It is a limit or a time constant that means nothing when it is infinite, not when it is 0: an effect
    /// size divides the typical value.
    AsItFalls,
}

/// A field of a sensor description that states the number of an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Field {
    /// `front_end.tau_0`.
    Tau0,
    /// `front_end.alpha`.
    Alpha,
    /// `comparator.threshold_on` and `threshold_off`: the number is a share of the one, and so many times of
    /// the other.
    Thresholds {
        /// +1 or -1.
        off: f64,
    },
    /// `comparator.threshold_noise`.
    ThresholdNoise,
    /// `comparator.reset`: the other rule.
    Reset,
    /// `readout.refractory`.
    Refractory,
    /// `frames.row_time`.
    RowTime,
    /// `frames.black_level_dn`.
    BlackLevel,
}

impl Field {
    /// What it states, in the unit of the number's declaration; 0 where the number is a departure from what
    /// is stated, or noise.
    pub fn stated(self, model: &Model) -> f64 {
        match self {
            Field::Tau0 => model.pixel.front_end.tau_0_s,
            Field::Alpha => model.pixel.front_end.alpha_s,
            Field::Refractory => model.pixel.refractory_ns as f64 * 1e-9,
            Field::RowTime => model.row_time_ns as f64 * 1e-9,
            Field::BlackLevel => model.number.black_level,
            Field::Thresholds { .. } | Field::ThresholdNoise | Field::Reset => 0.0,
        }
    }
}

/// A time of another effect that is stated with a number, where nothing else states it.
#[derive(Clone, Copy, Debug)]
pub struct Companion {
    /// Catalogue id.
    pub id: &'static str,
    /// TOML key of the time.
    pub parameter: &'static str,
    /// The time, seconds; none where the description's own will do.
    pub seconds: fn(&Applied) -> Option<f64>,
}

/// A number as it is written into a description.
#[derive(Clone, Copy, Debug)]
pub struct Applied<'a> {
    /// Its effect size.
    pub effect_size: f64,
    /// Its value, in the unit of its declaration.
    pub value: f64,
    /// Median photocurrent of the recording.
    pub light: f64,
    /// The description.
    pub model: &'a Model,
}

/// What sizes of effects go with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measure {
    /// Median photocurrent.
    Light,
    /// Contrast threshold, natural-log units.
    Threshold,
    /// Length of the recording, seconds.
    Duration,
    /// Stated length of an exposure, seconds; 0 without frames.
    Exposure,
    /// Median frame value above black, DN; 0 without frames.
    Signal,
    /// Whole DN below which nearly all frame values lie.
    LargestDn,
    /// A fast slope of the scene, ln/s.
    Slope,
    /// Events per second of the whole array.
    EventRate,
    /// Time from frame to frame, seconds.
    FramePeriod,
    /// When in that period the readout-side exposure of row 0 ends, seconds.
    FramePhase,
    /// Width of a stamp, seconds.
    StampWidth,
    /// Rows of the array.
    Rows,
    /// The stated `alpha`, seconds times photocurrent unit.
    Alpha,
    /// The stated delay from row to row, seconds.
    RowTime,
}

impl Measure {
    /// In words.
    pub fn text(self) -> &'static str {
        match self {
            Measure::Light => "median photocurrent",
            Measure::Threshold => "threshold",
            Measure::Duration => "duration",
            Measure::Exposure => "exposure",
            Measure::Signal => "median frame value",
            Measure::LargestDn => "largest frame value",
            Measure::Slope => "fast slope",
            Measure::EventRate => "event rate",
            Measure::FramePeriod => "frame period",
            Measure::FramePhase => "frame phase",
            Measure::StampWidth => "width of a stamp",
            Measure::Rows => "rows",
            Measure::Alpha => "stated alpha",
            Measure::RowTime => "stated row time",
        }
    }
}

/// A size, as a function of [`Measure`]s; in words by its `Display`.
#[derive(Clone, Copy, Debug)]
pub enum Size {
    /// The same on every recording.
    Fixed(f64),
    /// So many times a measure.
    Of(f64, Measure),
    /// A size times a measure.
    Times(&'static Size, Measure),
    /// A size over a measure.
    Over(&'static Size, Measure),
    /// The larger of two.
    Larger(&'static Size, &'static Size),
}

impl Size {
    /// The size where `measure` says how much there is of each.
    pub fn at(&self, measure: &dyn Fn(Measure) -> f64) -> f64 {
        match self {
            Size::Fixed(size) => *size,
            Size::Of(times, of) => times * measure(*of),
            Size::Times(size, of) => size.at(measure) * measure(*of),
            Size::Over(size, of) => size.at(measure) / measure(*of),
            Size::Larger(one, other) => f64::max(one.at(measure), other.at(measure)),
        }
    }
}

impl fmt::Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Size::Fixed(size) => write!(f, "{size}"),
            Size::Of(1.0, of) => f.write_str(of.text()),
            Size::Of(times, of) => write!(f, "{times} x {}", of.text()),
            Size::Times(size, of) => write!(f, "({size}) x {}", of.text()),
            Size::Over(size @ Size::Larger(..), of) => write!(f, "({size}) / {}", of.text()),
            Size::Over(size, of) => write!(f, "{size} / {}", of.text()),
            Size::Larger(one, other) => write!(f, "the larger of {one} and {other}"),
        }
    }
}

/// A delay that somebody cares for, seconds: half a step of the stamps is none, as they may be rounded down.
pub const DELAY: Size = Size::Larger(&Size::Fixed(2e-6), &Size::Of(0.55, Measure::StampWidth));

/// Another time that somebody cares for, seconds.
pub const TIME: Size = Size::Larger(&Size::Fixed(2e-6), &Size::Of(0.1, Measure::StampWidth));

/// A rate of a pixel that somebody cares for, hertz.
pub const RATE: Size = Size::Fixed(0.01);

/// A share of thresholds, gains or light that somebody cares for.
pub const GAIN: Size = Size::Fixed(0.005);

/// Another share that somebody cares for.
pub const SHARE: Size = Size::Fixed(0.001);

/// A spread that somebody cares for, natural-log units.
pub const SPREAD: Size = Size::Of(0.005, Measure::Threshold);
