//! What the parts of the measurement share.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Along what the profile is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// Along the normal of the fitted edge, in bins of a quarter pixel.
    #[default]
    Normal,
    /// Along the rows, one value a column, the rows of the region averaged: a plot of DN against position on
    /// a segment, such as 40 pixels.
    Row,
}

/// What is laid through the edge's positions on the lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Fit {
    /// A straight line.
    #[default]
    Straight,
    /// A parabola, for edges that bend: rims of disks, spokes under a rolling shutter.
    Quadratic,
}

/// Why an edge has no width.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Refusal {
    /// A value is NaN.
    Unknown,
    /// The bright side is at the saturation of the sensor.
    Saturated,
    /// Less than [`super::LEAST_CONTRAST`].
    LowContrast,
    /// Less than [`super::LEAST_SNR`].
    Noisy,
    /// The lines' positions do not make a straight edge.
    NotStraight,
    /// The edge leaves the region, or is too close to its border.
    AtTheBorder,
    /// Fewer pixels across or along than needed.
    TooSmall,
    /// The edge is so parallel to the pixels that too few sub-pixel phases are seen.
    Phases,
    /// The values still change where the plateau should be.
    NoPlateau,
    /// The profile has holes, or no crossing.
    Holes,
    /// The profile crosses 50 % more than once.
    Ghosts,
}

impl Refusal {
    /// In the reader's terms.
    pub fn describe(self) -> &'static str {
        match self {
            Refusal::Unknown => "values in the region are not known (NaN)",
            Refusal::Saturated => "the bright side is saturated: clipping makes an edge look sharp",
            Refusal::LowContrast => "no edge, or too little contrast: less than 5 % of full scale",
            Refusal::Noisy => "too noisy: contrast is less than 20 times the noise",
            Refusal::NotStraight => {
                "no straight edge, nor a bent one where `fit` allows it: its positions \
                                     scatter by more than 2 pixels"
            }
            Refusal::AtTheBorder => "the edge leaves the region, or comes closer than 5 pixels to its border",
            Refusal::TooSmall => "the region has less than 20 pixels across the edge or 12 along it",
            Refusal::Phases => {
                "the edge is parallel to the pixels (less than 2 degrees) and fewer than 3 \
                                of 4 sub-pixel phases are seen"
            }
            Refusal::NoPlateau => {
                "no plateau: values still change by a tenth of the contrast near the region's border"
            }
            Refusal::Holes => "the profile has holes near the edge, or does not reach the thresholds",
            Refusal::Ghosts => "ghosts: the profile crosses 50 % more than once",
        }
    }
}

/// Lines across the edge, dark first.
pub(crate) struct Lines {
    pub(super) values: Vec<f64>,
    pub(crate) across: usize,
}

impl Lines {
    pub(crate) fn len(&self) -> usize {
        self.values.len() / self.across
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &[f64]> {
        self.values.chunks_exact(self.across)
    }
}
