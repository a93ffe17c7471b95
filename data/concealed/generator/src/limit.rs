//! The detection limit of an effect when the light is known: the size at which the expected gain in log
//! likelihood of all events and frame values reaches 12.5 nats, five standard errors.
//!
//! For most effects the gain at a size is half the sum over events and frame values of (shift / sigma)^2,
//! where the shift is the change of the event's distance from its threshold, or of the frame value, and sigma
//! its noise. Where the effect is proportional to its size this is theta = 5 / sqrt(I), I the Fisher
//! information. Something random of standard deviation s that adds to a quantity known to a variance v gains
//! (r - ln(1 + r)) / 2 with r = s^2 / v. Things that are counted and never happen otherwise have their limit
//! at 25 events, five times the root of their number.

use crate::array::Event;
use crate::effect::{Setting, Size, conceal};
use crate::frames::Numbers;
use crate::observe::{Known, Seen, observe};
use crate::random::Random;
use crate::sensor::Physics;

/// Nats at the limit.
pub const NATS: f64 = 12.5;
/// Events at the limit of what is counted: five times its root.
pub const COUNT: f64 = 25.0;
/// The least noise of an event, as a share of its threshold.
const LEAST_EVENT: f64 = 0.01;
/// The least noise of a frame value, DN.
const LEAST_FRAME: f64 = 0.3;

/// A recording of the nominal sensor, with what is known of its noise.
pub struct Reference<'a> {
    known: Known<'a>,
    nominal: &'a Physics,
    setting: &'a Setting,
    base: Seen,
    /// 1 / variance of each event's distance from its threshold; 0 for events that are left out.
    events: Vec<f64>,
    frames: Vec<Vec<f64>>,
}

/// How instants and numbers are kept.
#[derive(Clone, Copy, Debug)]
pub struct Kept {
    /// Step of the stamps, s.
    pub step: f64,
    pub numbers: Numbers,
}

/// The gain from something random: r = its variance over the variance to which it would be known.
fn random_gain(r: f64) -> f64 {
    0.5 * (r - libm::log1p(r))
}

impl<'a> Reference<'a> {
    pub fn new(known: Known<'a>, nominal: &'a Physics, setting: &'a Setting, kept: Kept) -> Self {
        let base = observe(&known, nominal);
        let sensor = &nominal.sensor;
        let late = if known.has_t_in { 0.0 } else { sensor.latency_more };
        let stamp = kept.step * kept.step / 12.0 + late * late;
        let weight = |(event, (residual, slope)): (&Event, (&f64, &f64))| {
            let threshold = if event.on { sensor.on } else { sensor.off };
            let least = LEAST_EVENT * threshold;
            let variance =
                sensor.threshold_noise * sensor.threshold_noise + slope * slope * stamp + least * least;
            // Events that fired when their blind time ended are no crossings: six standard deviations off.
            if residual * residual < 36.0 * variance { 1.0 / variance } else { 0.0 }
        };
        let events = known.events.iter().zip(base.residuals.iter().zip(&base.slopes)).map(weight).collect();
        let step = if kept.numbers == Numbers::Whole { 1.0 } else { 1.0 / 16.0 };
        let full = sensor.saturation - sensor.black;
        let weight = |dn: &f64| {
            let shot =
                if sensor.full_well > 0.0 { (dn - sensor.black) * full / sensor.full_well } else { 0.0 };
            let variance = shot.max(0.0) + sensor.read_noise * sensor.read_noise + step * step / 12.0;
            1.0 / variance.max(LEAST_FRAME * LEAST_FRAME)
        };
        let frames = base.frames.iter().map(|frame| frame.iter().map(weight).collect()).collect();
        Self { known, nominal, setting, base, events, frames }
    }

    /// Mean of the frames above black, DN.
    pub fn signal(&self) -> f64 {
        let n = self.base.frames.iter().map(Vec::len).sum::<usize>().max(1);
        self.base.frames.iter().flatten().sum::<f64>() / n as f64 - self.nominal.sensor.black
    }

    /// The size of an effect at its limit, in the unit of [`Size`]; none for an effect without a size.
    /// `random` is what the effect will be drawn with.
    ///
    /// # Errors
    /// An id that is not in the catalogue.
    pub fn limit(&self, id: &str, random: &Random) -> Result<Option<f64>, String> {
        let with = |size: Option<f64>| {
            let (mut physics, mut size) = (self.nominal.clone(), Size { set: size, ..Size::default() });
            conceal(id, &mut physics, self.setting, &mut random.clone(), &mut size)?;
            Ok::<_, String>((physics, size.range))
        };
        let (drawn, Some([least, most])) = with(None)? else { return Ok(None) };
        if let Some(limit) = self.counted(id, &drawn) {
            return Ok(Some(limit));
        }
        if let Some(information) = self.random(id, &drawn) {
            let gain = |size: f64| Ok(information.iter().map(|i| random_gain(size * size * i)).sum());
            return reach(least, f64::INFINITY, gain).map(Some);
        }
        let gain = |size: f64| {
            let (physics, _) = with(Some(size))?;
            Ok(self.shift_gain(&physics))
        };
        reach(0.1 * least, most, gain).map(Some)
    }

    /// The limit of what is counted, by the rule `size x exposure = 25 events`.
    fn counted(&self, id: &str, drawn: &Physics) -> Option<f64> {
        let [width, height] = self.known.size.map(|n| n as f64);
        let seconds = self.known.timing.end - self.known.timing.start;
        let exposure = match id {
            "background_activity" => width * height * seconds,
            "hot_pixels" => width * height * drawn.hot_share * seconds,
            "hot_rows" => width * drawn.hot_rows.len() as f64 * seconds,
            "event_loss" => self.known.events.len() as f64,
            _ => return None,
        };
        Some(COUNT / exposure)
    }

    /// For something random: the information on each of its draws, per square of the size.
    fn random(&self, id: &str, drawn: &Physics) -> Option<Vec<f64>> {
        let [width, height] = self.known.size;
        let pixels = |of: &dyn Fn(usize) -> f64| {
            let mut sums = vec![0.0; width * height];
            for (number, event) in self.known.events.iter().enumerate() {
                sums[event.pixel] += of(number);
            }
            sums
        };
        let squares = |physics: &Physics, per: f64| {
            let other = observe(&self.known, physics);
            pixels(&|number| self.shift(&other, number) / (per * per))
        };
        let slope2 = |number: usize| self.base.slopes[number] * self.base.slopes[number];
        let numbers = 0..self.events.len();
        Some(match id {
            "threshold_mismatch" => pixels(&|number| self.events[number]),
            "threshold_noise" => self.events.clone(),
            "timestamp_jitter" => numbers.map(|n| self.events[n] * slope2(n)).collect(),
            "timestamp_quantization" => numbers.map(|n| self.events[n] * slope2(n) / 12.0).collect(),
            "refractory_spread" => {
                // The spread is of the logarithm of the period.
                let mut physics = self.nominal.clone();
                physics.sensor.refractory *= libm::exp(0.02);
                squares(&physics, 0.02)
            }
            "row_skew:rows" => {
                let physics = Physics { clock_offset: 5e-6, ..self.nominal.clone() };
                squares(&physics, 5e-6).chunks(width).map(|row| row.iter().sum()).collect()
            }
            "frame_gain_steps" => {
                let black = self.nominal.sensor.black;
                let of = |(values, weights): (&Vec<f64>, &Vec<f64>)| {
                    values.iter().zip(weights).map(|(dn, w)| (dn - black) * (dn - black) * w).sum::<f64>()
                };
                let frames: Vec<f64> = self.base.frames.iter().zip(&self.frames).map(of).collect();
                frames.chunks(drawn.gain_every).map(|group| group.iter().sum()).collect()
            }
            _ => return None,
        })
    }

    /// (shift / sigma)^2 of one event; 0 where there is none.
    fn shift(&self, other: &Seen, number: usize) -> f64 {
        let shift = other.residuals[number] - self.base.residuals[number];
        if shift.is_nan() { 0.0 } else { self.events[number] * shift * shift }
    }

    /// The gain of a sensor over the nominal one.
    fn shift_gain(&self, physics: &Physics) -> f64 {
        let other = observe(&self.known, physics);
        let events: f64 = (0..self.events.len()).map(|number| self.shift(&other, number)).sum();
        let mut sum = events;
        for ((a, b), weights) in other.frames.iter().zip(&self.base.frames).zip(&self.frames) {
            sum += a.iter().zip(b).zip(weights).map(|((a, b), w)| w * (a - b) * (a - b)).sum::<f64>();
        }
        0.5 * sum
    }
}

/// The size at which a gain that rises with it reaches the limit, to some 2 %; sizes above `most` are not
/// tried, and beyond it the gain is taken to go with the square.
fn reach(start: f64, most: f64, mut gain: impl FnMut(f64) -> Result<f64, String>) -> Result<f64, String> {
    let (mut low, mut high) = (0.0f64, f64::INFINITY);
    let (mut size, mut before) = (start.min(most), None);
    for _ in 0..12 {
        let now = gain(size)?;
        let off = libm::log(NATS / now.max(1e-30));
        if off.abs() < 0.04 {
            break;
        }
        if now < NATS {
            if size >= most {
                return Ok(size * libm::exp(0.5 * off));
            }
            low = low.max(size);
        } else {
            high = high.min(size);
        }
        // The power with which the gain rises, from the latest two sizes.
        let power = before.map_or(2.0, |(other, gain): (f64, f64)| {
            libm::log(now.max(1e-30) / gain.max(1e-30)) / libm::log(size / other)
        });
        before = Some((size, now));
        let mut next = size * libm::exp((off / power.clamp(1.0, 8.0)).clamp(-5.0, 5.0));
        if next <= low || next >= high {
            next = if low > 0.0 { libm::sqrt(low * high) } else { 0.1 * high };
        }
        size = next.min(most);
    }
    Ok(size)
}

#[cfg(test)]
mod tests;
