//! What share of the event pixel's light each value of a row of frames sees, so that its problem can be posed in the light that its events come from.
//!
//! A value `p` and its event pixel see `i_p = r i`, with a light ratio `r` that is taken for constant over the frames of one problem. Then `DN = black + gain g r
//! integral i dt`, with the channel's gain `g`: the problem of Eq. (13) in the event pixel's light `i`, with `DN` above black over `g r` and a weight times
//! `(g r)^2`. So the front end's time constant follows the event pixel's own light, as it must, and the solution times `r` is the light of the value.
//!
//! The ratio is estimated from the same frames: what the value collected, over the mixture of its block ([`photocurrent_sensor::pooling`]).
//!
//! Limits: the ratio follows colours from problem to problem, not inside one. Neither `r` nor `g` changes what a pixel alone on its event pixel means: it is 1.

use super::Model;
use crate::co_located::{CoLocated, channel_gains, event_weights, gain_of};
use photocurrent_core::{FrameBlock, NodeError, Rows, Sensor};
use photocurrent_sensor::pooling::block_weights;
use std::ops::Range;

/// A ratio outside of this is noise in the dark.
const RATIO_LIMIT: f64 = 64.0;

/// How frames lie on events, and what the sensor says of colour.
pub(super) struct Colours {
    pub lie: CoLocated,
    gains: [f64; 3],
    seen: Option<[f64; 3]>,
}

impl Colours {
    pub fn new(lie: CoLocated, sensor: &Sensor) -> Result<Colours, NodeError> {
        Ok(Colours { lie, gains: channel_gains(sensor)?, seen: event_weights(sensor)? })
    }

    /// Rows above and below that belong to the same block at most.
    pub fn halo(&self) -> u32 {
        self.lie.ratio - 1
    }

    /// The shares of row `y`; `frames` must hold all rows of its block.
    pub fn row(&self, model: &Model, frames: &FrameBlock, y: u32) -> RowShares {
        if self.lie.is_plain() {
            return RowShares::default();
        }
        let CoLocated { ratio, colour } = self.lie;
        let (values, block_values) = (frames.row_values as u32, (ratio * colour.channels()) as usize);
        let gain: Vec<f64> = (0..values).map(|value| gain_of(1.0, &self.gains, colour, value, y)).collect();
        let block = Rows { start: y / ratio * ratio, end: (y / ratio + 1) * ratio };
        let alone = ratio == 1 && colour.channels() == 1;
        let (mut own, mut seen) = (Vec::new(), Vec::new());
        let light = |l: usize, row: u32, value: usize| {
            let above = f64::from(frames.row(l, row)[value]) - model.black_level;
            above / gain_of(1.0, &self.gains, colour, value as u32, row)
        };
        for l in frames.frames.clone().filter(|_| !alone) {
            for column in 0..values as usize / block_values {
                let weights = block_weights(colour, ratio, (column as u32, y / ratio), self.seen);
                let first = column * block_values;
                let places = block.iter().flat_map(|row| (first..first + block_values).map(move |value| (row, value)));
                let sum: f64 = places.zip(&weights).map(|((row, value), weight)| weight * light(l, row, value)).sum();
                own.extend((first..first + block_values).map(|value| light(l, y, value)));
                seen.extend((0..block_values).map(|_| sum));
            }
        }
        RowShares { gain, own, seen }
    }
}

/// The shares of one row.
#[derive(Default)]
pub(crate) struct RowShares {
    /// Of each value; empty when there is one value for each event pixel, and no colour.
    gain: Vec<f64>,
    /// What a value collected in a frame, in units of gain: [frame][value]. Empty when every value has an event pixel to itself.
    own: Vec<f64>,
    /// What its event pixel collected.
    seen: Vec<f64>,
}

/// How one value's problem is posed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Share {
    /// Light of the value over light of the event pixel.
    pub ratio: f64,
    /// The same times the channel's gain.
    scale: f64,
}

impl RowShares {
    /// Of a value, from some of the frames.
    pub fn of(&self, value: usize, frames: Range<usize>) -> Share {
        let Some(gain) = self.gain.get(value) else { return Share { ratio: 1.0, scale: 1.0 } };
        let width = self.gain.len();
        let (mut own, mut seen) = (0.0, 0.0);
        // Where one of them is not known, neither counts.
        for at in frames.map(|l| l * width + value).filter(|at| self.own.get(*at).is_some_and(|own| (own + self.seen[*at]).is_finite())) {
            own += self.own[at];
            seen += self.seen[at];
        }
        let ratio = if own > 0.0 && seen > 0.0 { (own / seen).clamp(1.0 / RATIO_LIMIT, RATIO_LIMIT) } else { 1.0 };
        Share { ratio, scale: ratio * gain }
    }
}

impl Share {
    /// The digital number that the event pixel's light would have given.
    pub fn dn(&self, dn: f64, black_level: f64) -> f64 {
        // Not to be rounded where nothing is to be done.
        if self.scale == 1.0 { dn } else { black_level + (dn - black_level) / self.scale }
    }

    /// The standard deviation of that.
    pub fn sigma(&self, sigma_dn: f64) -> f64 {
        sigma_dn / self.scale
    }

    /// The weight of its square.
    pub fn weight(&self, weight: f64) -> f64 {
        weight * self.scale * self.scale
    }
}
