//! Where a mismatch is: in which rows, columns, instants, light, slopes, at which load, after which history.
//!
//! Three things are compared with a control, the simulation treated like the recording: the share of recorded events that the simulation has not (`extra`),
//! the share of simulated ones that the recording has not (`missing`), how late recorded events are (`delay`), and the logarithm of frame values (`frames`). Each is
//! averaged over bins of every covariate, and the difference from the control is divided by its error, found from small squares of pixels, which are independent of
//! each other as events of one pixel are not.
//!
//! Significance is family-wise: signs of whole squares are flipped at random, and the largest statistic over all bins, covariates and channels of each draw says how
//! large one gets by chance.

use crate::covariates::{Covariate, Surroundings};
use crate::differences::{EventDifference, Fate, FrameDifference};
use photocurrent_core::random::Random;
use serde::{Deserialize, Serialize};

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Channel {
    /// Share of recorded events that the simulation has not.
    Extra,
    /// Share of simulated events that the recording has not.
    Missing,
    /// Recorded less simulated time of paired events, seconds.
    Delay,
    /// Log of recorded over simulated frame values, less the pixel's own mean.
    Frames,
}

impl Channel {
    /// Differences below this do not matter: shares, 2 us, or half a percent of light; added to every error in squares.
    pub fn immaterial(self) -> f64 {
        match self {
            Channel::Extra | Channel::Missing => 2e-3,
            Channel::Delay => 2e-6,
            Channel::Frames => 5e-3,
        }
    }
}

/// A covariate in bins, recording less control.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// What is compared.
    pub channel: Channel,
    /// On what it is laid out.
    pub covariate: Covariate,
    /// Middle of each bin: mean of the covariate in it.
    pub at: Vec<f64>,
    /// Recording less control.
    pub value: Vec<f64>,
    /// Standard error of it.
    pub error: Vec<f64>,
    /// Largest |value less the mean of all bins| over its error.
    pub statistic: f64,
    /// Chance of so large a statistic anywhere, over all curves together.
    pub p_value: f64,
    /// Share of the variance between bins that is not error.
    pub explained: f64,
}

/// What was measured on one side: the recording or the control.
pub struct Side<'a> {
    /// Its events against its simulation.
    pub events: &'a [EventDifference],
    /// Its frames against its simulation.
    pub frames: &'a [FrameDifference],
    /// What covariates are computed from.
    pub surroundings: &'a Surroundings<'a>,
}

/// Squares of pixels as numbers from 0.
struct Squares {
    width: usize,
    side: usize,
    across: usize,
}

impl Squares {
    fn of(surroundings: &Surroundings<'_>) -> Squares {
        let (extent, pixels) = surroundings.size();
        let side = usize::max(1, libm::sqrt(pixels as f64 / SQUARES as f64) as usize);
        let width = extent.width as usize;
        Squares { width, side, across: width.div_ceil(side) }
    }

    fn number(&self, pixel: u32) -> u32 {
        let (x, y) = (pixel as usize % self.width, pixel as usize / self.width);
        (y / self.side * self.across + x / self.side) as u32
    }
}

/// Bins of a covariate on a scale.
const BINS: usize = 10;
/// Fewest values in a bin, of either side.
const LEAST: f64 = 30.0;
/// Draws of signs.
const DRAWS: usize = 199;
/// About so many squares hold the pixels of the sample.
const SQUARES: usize = 150;
/// Fewest squares that a bin is made of: flipped signs of fewer say little.
const LEAST_SQUARES: f64 = 9.0;

/// One number to be averaged.
#[derive(Clone, Copy)]
struct Value {
    at: f64,
    square: u32,
    value: f64,
}

/// All curves, the most significant first.
pub fn scan(recording: &Side<'_>, control: &Side<'_>, seed: u64) -> Vec<Curve> {
    let mut curves = Vec::new();
    let squares = Squares::of(recording.surroundings);
    // Of each curve, per draw, the statistic with flipped signs.
    let mut largest = vec![0.0_f64; DRAWS];
    for channel in [Channel::Extra, Channel::Missing, Channel::Delay, Channel::Frames] {
        for covariate in Covariate::ALL {
            let (here, there) = (values(recording, &squares, channel, covariate), values(control, &squares, channel, covariate));
            let Some(binned) = Binned::new(&here, &there, channel, covariate) else { continue };
            curves.push(binned.curve(channel, covariate));
            for (draw, most) in largest.iter_mut().enumerate() {
                *most = f64::max(*most, binned.flipped(seed, draw as u64));
            }
        }
    }
    for curve in &mut curves {
        let above = largest.iter().filter(|most| **most >= curve.statistic).count();
        curve.p_value = (1 + above) as f64 / (1 + DRAWS) as f64;
    }
    curves.sort_by(|a, b| b.statistic.total_cmp(&a.statistic));
    curves
}

fn values(side: &Side<'_>, squares: &Squares, channel: Channel, covariate: Covariate) -> Vec<Value> {
    let of_event = |event: &EventDifference| -> Option<Value> {
        let value = match (channel, event.fate) {
            (Channel::Extra, Fate::Missing) | (Channel::Missing, Fate::Extra) | (Channel::Delay, Fate::Extra | Fate::Missing) => return None,
            (Channel::Extra, Fate::Extra) | (Channel::Missing, Fate::Missing) => 1.0,
            (Channel::Delay, Fate::Paired(by_ns)) => by_ns as f64 * 1e-9,
            _ => 0.0,
        };
        let at = side.surroundings.value(covariate, event.pixel as usize, event.t_ns, event.polarity)?;
        Some(Value { at, square: squares.number(event.pixel), value })
    };
    let of_frame = |frame: &FrameDifference| -> Option<Value> {
        let is_of_events = matches!(
            covariate,
            Covariate::Polarity | Covariate::PreviousPolarity | Covariate::BurstIndex | Covariate::TimeSinceLastEvent | Covariate::FramePhase
        );
        let at = (!is_of_events).then(|| side.surroundings.value(covariate, frame.pixel as usize, frame.t_ns, 1)).flatten()?;
        Some(Value { at, square: squares.number(frame.pixel), value: frame.log_ratio })
    };
    match channel {
        Channel::Frames => side.frames.iter().filter_map(of_frame).collect(),
        Channel::Extra | Channel::Missing | Channel::Delay => side.events.iter().filter_map(of_event).collect(),
    }
}

/// Sums over bins and squares.
struct Binned {
    at: Vec<f64>,
    /// Per bin, recording less control.
    value: Vec<f64>,
    /// Per bin, what each square adds to the value.
    parts: Vec<Vec<f64>>,
    /// The error of each value.
    error: Vec<f64>,
}

impl Binned {
    fn new(here: &[Value], there: &[Value], channel: Channel, covariate: Covariate) -> Option<Binned> {
        let mut all: Vec<f64> = here.iter().map(|value| value.at).collect();
        all.sort_by(f64::total_cmp);
        let mut edges: Vec<f64> = if covariate.is_class() {
            all.dedup();
            all.iter().skip(1).copied().collect()
        } else {
            (1..BINS).filter_map(|n| all.get(n * all.len() / BINS).copied()).collect()
        };
        edges.dedup();
        let bins = edges.len() + 1;
        let squares = here.iter().chain(there).map(|value| value.square as usize + 1).max()?;
        let mut binned = Binned { at: Vec::new(), value: Vec::new(), parts: Vec::new(), error: Vec::new() };
        let bin = |value: &Value| edges.partition_point(|edge| *edge <= value.at);
        let mut sums = vec![vec![[0.0_f64; 2]; squares]; 2 * bins];
        let mut places = vec![[0.0_f64; 2]; bins];
        for (side, values) in [here, there].into_iter().enumerate() {
            for value in values.iter().filter(|value| value.value.is_finite() && value.at.is_finite()) {
                let sum = &mut sums[2 * bin(value) + side][value.square as usize];
                *sum = [sum[0] + 1.0, sum[1] + value.value];
                let place = &mut places[bin(value)];
                *place = [place[0] + 1.0, place[1] + value.at];
            }
        }
        for n in 0..bins {
            let mut parts = vec![0.0; squares];
            let (mut value, mut enough) = (0.0, true);
            for side in 0..2 {
                let of_squares = &sums[2 * n + side];
                let count: f64 = of_squares.iter().map(|sum| sum[0]).sum();
                let mean = of_squares.iter().map(|sum| sum[1]).sum::<f64>() / f64::max(count, 1.0);
                let sign = if side == 0 { 1.0 } else { -1.0 };
                value += sign * mean;
                enough &= count >= LEAST;
                for (part, sum) in parts.iter_mut().zip(of_squares) {
                    *part += sign * (sum[1] - sum[0] * mean) / f64::max(count, 1.0);
                }
            }
            let involved = parts.iter().filter(|part| **part != 0.0).count() as f64;
            // Of few squares, the spread around their own mean is too small.
            let correction = involved / f64::max(involved - 1.0, 1.0);
            let floor = channel.immaterial();
            let error = libm::sqrt(correction * parts.iter().map(|part| part * part).sum::<f64>() + floor * floor);
            if enough && involved >= LEAST_SQUARES {
                binned.at.push(places[n][1] / places[n][0]);
                binned.value.push(value);
                binned.parts.push(parts);
                binned.error.push(error);
            }
        }
        (binned.at.len() >= 2).then_some(binned)
    }

    /// The largest deviation of a bin from the mean of all over its error.
    fn statistic(&self, values: &[f64]) -> f64 {
        let weights: Vec<f64> = self.error.iter().map(|error| 1.0 / (error * error)).collect();
        let mean = weights.iter().zip(values).map(|(weight, value)| weight * value).sum::<f64>() / weights.iter().sum::<f64>();
        values.iter().zip(&self.error).map(|(value, error)| (value - mean).abs() / error).fold(0.0, f64::max)
    }

    /// The statistic of a draw of signs.
    fn flipped(&self, seed: u64, draw: u64) -> f64 {
        let squares = self.parts[0].len();
        let mut random = Random::new(seed, &[draw, 0x10ca]);
        let signs: Vec<f64> = (0..squares).map(|_| if random.uniform() < 0.5 { -1.0 } else { 1.0 }).collect();
        let values: Vec<f64> = self.parts.iter().map(|parts| parts.iter().zip(&signs).map(|(part, sign)| part * sign).sum()).collect();
        self.statistic(&values)
    }

    fn curve(self: &Binned, channel: Channel, covariate: Covariate) -> Curve {
        let n = self.value.len() as f64;
        let mean = self.value.iter().sum::<f64>() / n;
        let between = self.value.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / n;
        let noise = self.error.iter().map(|error| error * error).sum::<f64>() / n;
        Curve {
            channel,
            covariate,
            at: self.at.clone(),
            value: self.value.clone(),
            error: self.error.clone(),
            statistic: self.statistic(&self.value),
            p_value: 1.0,
            explained: if between > 0.0 { f64::max(1.0 - noise / between, 0.0) } else { 0.0 },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::Case;
    use crate::sample::Sample;
    use crate::testing;

    /// Events of all pixels at random instants; the chance of an extra one, and the delay of a pair, are told by the pixel's column and the instant.
    fn events(case: &Case, sample: &Sample, seed: u64, extra: impl Fn(u32, i64) -> f64, delay_ns: impl Fn(u32, i64) -> f64) -> Vec<EventDifference> {
        let mut random = Random::new(seed, &[]);
        let mut found = Vec::new();
        for &pixel in &sample.pixels {
            let (x, _) = case.place(pixel as usize);
            for _ in 0..60 {
                let t_ns = (random.uniform() * 50e6) as i64;
                let polarity = if random.uniform() < 0.5 { 1 } else { -1 };
                let fate = if random.uniform() < extra(x, t_ns) { Fate::Extra } else { Fate::Paired((delay_ns(x, t_ns) + 20_000.0 * random.normal()) as i64) };
                found.push(EventDifference { pixel, t_ns, polarity, fate });
            }
        }
        found
    }

    fn curves(seed: u64, extra: impl Fn(u32, i64) -> f64, delay_ns: impl Fn(u32, i64) -> f64) -> Vec<Curve> {
        let case = testing::case();
        let sample = Sample::all(&case, 2);
        let scene = testing::scene(&case);
        let surroundings = Surroundings::new(&case, &sample, &scene, (30e-6, 5e-3));
        let here = events(&case, &sample, seed, extra, delay_ns);
        let there = events(&case, &sample, seed + 1000, |_, _| 0.1, |_, _| 0.0);
        let side = |events| Side { events, frames: &[], surroundings: &surroundings };
        scan(&side(&here), &side(&there), seed)
    }

    #[test]
    fn extra_events_of_one_side_of_the_array_and_a_delay_that_grows_with_time_are_found_there() {
        let found = curves(1, |x, _| if x >= 8 { 0.3 } else { 0.1 }, |_, t_ns| t_ns as f64 * 2e-3);
        let of = |channel: Channel| found.iter().find(|curve| curve.channel == channel).unwrap();
        let (extra, delay) = (of(Channel::Extra), of(Channel::Delay));
        assert!(matches!(extra.covariate, Covariate::Column | Covariate::ColumnBlock) && extra.p_value < 0.01, "{extra:?}");
        assert!(delay.covariate == Covariate::Time && delay.p_value < 0.01, "{delay:?}");
        // The curve is what was put in: 2 us a millisecond.
        for (at, value) in delay.at.iter().zip(&delay.value) {
            assert!((value - 2e-3 * at).abs() < 6e-6, "{value} at {at}");
        }
    }

    #[test]
    fn nothing_is_found_where_nothing_is() {
        // At one in twenty, six of ten false alarms happen once in ten million.
        let alarms = (0..10).filter(|seed| curves(*seed, |_, _| 0.1, |_, _| 0.0)[0].p_value <= 0.05).count();
        assert!(alarms < 4, "{alarms}");
    }
}
