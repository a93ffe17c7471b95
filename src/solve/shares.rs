//! What share of the event pixel's light each value of a row of frames sees, so that its problem can be posed
//! in the light that its events come from.
//!
//! A value `p` and its event pixel see `i_p = r i`, with a light ratio `r` that is taken for constant over
//! the frames of one problem. Then `DN = black + gain g r integral i dt`, with the channel's gain `g`: the
//! problem of Eq. (13) in the event pixel's light `i`, with `DN` above black over `g r` and a weight times
//! `(g r)^2`. So the front end's time constant follows the event pixel's own light, as it must, and the
//! solution times `r` is the light of the value.
//!
//! The ratio is estimated from the same frames: what the value collected, over the mixture of its block
//! ([`photocurrent_sensor::pooling`]).
//!
//! Where colours do not stay, the ratio does not: an event's step is then right for the mixture and wrong for
//! the value. How wrong on average is known from the frames, as the changes of `ln r` from frame to frame:
//! spread over the pixel's events, they are the standard deviation by which a step may be off
//! ([`RowShares::unrest`]). The MAP estimate adds this variance to that of events and of the no-event
//! constraint.
//!
//! Limits: the ratio follows colours from problem to problem, not inside one; blur hides changes that a frame
//! averages out. Neither `r` nor `g` changes what a pixel alone on its event pixel means: it is 1.

use crate::co_located::{CoLocated, channel_gains, event_weights, gain_of};
use crate::model::Model;
use photocurrent_core::{FrameBlock, NodeError, Rows, Sensor};
use photocurrent_sensor::pooling::block_weights;
use std::ops::Range;

/// A ratio outside of this is noise in the dark.
const RATIO_LIMIT: f64 = 64.0;

/// How frames lie on events, and what the sensor says of colour.
pub struct Colours {
    /// How frames lie on events.
    pub lie: CoLocated,
    gains: [f64; 3],
    seen: Option<[f64; 3]>,
}

impl Colours {
    /// Of a recording with this description.
    ///
    /// # Errors
    /// When the description's channel gains or event weights make no sense.
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
            let above = f64::from(frames.row(l, row)[value]) - model.sensor.number.black_level;
            above / gain_of(1.0, &self.gains, colour, value as u32, row)
        };
        for l in frames.frames.clone().filter(|_| !alone) {
            for column in 0..values as usize / block_values {
                let weights = block_weights(colour, ratio, (column as u32, y / ratio), self.seen);
                let first = column * block_values;
                let places =
                    block.iter().flat_map(|row| (first..first + block_values).map(move |value| (row, value)));
                let sum: f64 =
                    places.zip(&weights).map(|((row, value), weight)| weight * light(l, row, value)).sum();
                own.extend((first..first + block_values).map(|value| light(l, y, value)));
                seen.extend((0..block_values).map(|_| sum));
            }
        }
        RowShares { gain, own, seen }
    }
}

/// The shares of one row.
#[derive(Default)]
pub struct RowShares {
    /// Of each value; empty when there is one value for each event pixel, and no colour.
    gain: Vec<f64>,
    /// What a value collected in a frame, in units of gain: [frame][value]. Empty when every value has an
    /// event pixel to itself.
    own: Vec<f64>,
    /// What its event pixel collected.
    seen: Vec<f64>,
}

/// How one value's problem is posed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Share {
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
        for at in frames
            .map(|l| l * width + value)
            .filter(|at| self.own.get(*at).is_some_and(|own| (own + self.seen[*at]).is_finite()))
        {
            own += self.own[at];
            seen += self.seen[at];
        }
        let ratio =
            if own > 0.0 && seen > 0.0 { (own / seen).clamp(1.0 / RATIO_LIMIT, RATIO_LIMIT) } else { 1.0 };
        Share { ratio, scale: ratio * gain }
    }

    /// Sum over consecutive frames of the squared change of `ln r`, what noise makes of it subtracted:
    /// `noise` is the relative variance of a value whose DN is so far above black. 0 where nothing is mixed.
    pub fn unrest(&self, value: usize, noise: impl Fn(f64) -> f64) -> f64 {
        let width = self.gain.len();
        if self.own.is_empty() || value >= width {
            return 0.0;
        }
        let (mut sum, mut before) = (0.0, None);
        for (own, seen) in self
            .own
            .iter()
            .zip(&self.seen)
            .skip(value)
            .step_by(width)
            .filter(|(own, seen)| **own > 0.0 && **seen > 0.0)
        {
            let now = (libm::log(own / seen), noise(own * self.gain[value]));
            if let Some((log_ratio, variance)) = before.replace(now) {
                sum += (now.0 - log_ratio) * (now.0 - log_ratio) - variance - now.1;
            }
        }
        f64::max(sum, 0.0)
    }
}

impl Share {
    /// The digital number that the event pixel's light would have given.
    pub fn dn(&self, dn: f64, black_level: f64) -> f64 {
        // Not to be rounded where nothing is to be done.
        if self.scale == 1.0 { dn } else { black_level + (dn - black_level) / self.scale }
    }

    /// Light of the value, in units of 1 / gain, of digital numbers above black.
    pub fn light(&self, above: f64) -> f64 {
        if self.scale == 1.0 { above * self.ratio } else { above * self.ratio / self.scale }
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Two values in four frames; the second changes its colour by `e` from the second frame to the third.
    fn shares(own_again: f64) -> RowShares {
        let e = std::f64::consts::E;
        RowShares {
            gain: vec![1.0, 2.0],
            own: vec![100.0, 50.0, 200.0, 100.0, 50.0, e * 25.0, 100.0, own_again],
            seen: vec![200.0, 100.0, 400.0, 200.0, 100.0, 50.0, 200.0, 100.0],
        }
    }

    #[test]
    fn the_ratio_is_that_of_the_sums_over_the_frames_of_a_problem() {
        let shares = shares(e_times(50.0));
        assert_eq!((shares.of(0, 0..4).ratio, shares.of(1, 0..2).ratio), (0.5, 0.5));
        let later = shares.of(1, 2..4);
        assert!((later.ratio - e_times(0.5)).abs() < 1e-12);
        // DN above a black level of 10, over gain and ratio; a weight goes with the square.
        assert!((later.dn(10.0 + 4.0 * later.ratio, 10.0) - 12.0).abs() < 1e-12);
        assert!((later.weight(1.0) / (4.0 * later.ratio * later.ratio) - 1.0).abs() < 1e-12);
        // Darkness carries no colour.
        assert_eq!(RowShares { gain: vec![1.0], own: vec![-3.0], seen: vec![5.0] }.of(0, 0..1).ratio, 1.0);
    }

    fn e_times(value: f64) -> f64 {
        std::f64::consts::E * value
    }

    #[test]
    fn unrest_is_the_square_of_what_the_colour_changed_less_the_noise() {
        let shares = shares(e_times(50.0));
        // One change of ln r by 1, between frames of a relative variance of 0.1 each; noise alone is no
        // unrest.
        assert!((shares.unrest(1, |_| 0.0) - 1.0).abs() < 1e-12);
        assert!((shares.unrest(1, |_| 0.1) - (1.0 - 6.0 * 0.1)).abs() < 1e-12);
        assert_eq!((shares.unrest(0, |_| 0.0), shares.unrest(0, |_| 0.1)), (0.0, 0.0));
        // A frame in which the value is not known joins the two next to it.
        let mut holed = self::shares(e_times(50.0));
        holed.own[3] = f64::NAN;
        assert!((holed.unrest(1, |_| 0.0) - 1.0).abs() < 1e-12);
        assert_eq!(RowShares::default().unrest(0, |_| 0.0), 0.0);
    }
}
