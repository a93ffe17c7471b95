//! What deviations mean nothing: those of recordings without an effect, weighted by how like the judged recording they are.
//!
//! Every simulator and every real sensor differs from the model in small ways that are no effect, and the way through scene and back adds its own. Both depend on the
//! kind of recording, so mean and spread of every summary are taken over nulls near by in context. Few nulls are near, so the spread is drawn to that over all.

use serde::{Deserialize, Serialize};

/// Deviations of recordings without an effect.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Floor {
    /// The nulls.
    pub nulls: Vec<Null>,
}

/// A recording without an effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Null {
    /// A name to tell it by.
    pub name: String,
    /// Kind of recording.
    pub context: Vec<f32>,
    /// Deviation of its summaries.
    pub deviation: Vec<f32>,
}

/// Mean and spread of deviations that mean nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct Level {
    /// Mean by summary.
    pub mean: Vec<f64>,
    /// Spread by summary, positive.
    pub spread: Vec<f64>,
    /// How like the nearest nulls the recording is: effective number of them.
    pub nulls: f64,
}

/// Width of the neighbourhood in context, in mean squared standard deviations.
const WIDTH: f64 = 0.5;
/// Numbers of a context that differ by less than this share are equal; they are kept in 16 bits.
const SAME: f64 = 0.004;
/// Weight of a null however far it is.
const FAR: f64 = 0.03;
/// The spread over all nulls counts as much as so many of the near ones.
const PRIOR: f64 = 3.0;
/// Added to every spread, in units of summaries: what hardly ever differs among few nulls is not therefore exact. With less, single summaries decide; measured on nulls and
/// effects of other simulators, 0.002 to 0.4 name as well, and 0.2 tells nulls from effects best.
const LEAST: f64 = 0.2;

impl Floor {
    /// Mean and standard deviation of every number of the context over nulls.
    fn context_scale(&self) -> Vec<(f64, f64)> {
        let length = self.nulls.first().map_or(0, |null| null.context.len());
        let n = self.nulls.len().max(1) as f64;
        (0..length)
            .map(|k| {
                let mean = self.nulls.iter().map(|null| f64::from(null.context[k])).sum::<f64>() / n;
                let square = self.nulls.iter().map(|null| (f64::from(null.context[k]) - mean) * (f64::from(null.context[k]) - mean)).sum::<f64>() / n;
                (mean, libm::sqrt(square) + 1e-3)
            })
            .collect()
    }

    /// Weight of every null for a recording of a context, from [`FAR`] to 1; 0 for a null of the very same context, which is the recording itself.
    pub fn weights(&self, context: &[f64]) -> Vec<f64> {
        let scale = self.context_scale();
        let weight = |null: &Null| {
            if null.context.iter().zip(context).all(|(own, c)| (f64::from(*own) - c).abs() <= SAME * c.abs()) {
                return 0.0;
            }
            let far: f64 = null.context.iter().zip(context).zip(&scale).map(|((own, c), (_, s))| (f64::from(*own) - c) * (f64::from(*own) - c) / (s * s)).sum();
            libm::exp(-far / scale.len().max(1) as f64 / WIDTH) + FAR
        };
        self.nulls.iter().map(weight).collect()
    }

    /// The floor for a recording of a context; the recording itself does not count.
    pub fn level(&self, context: &[f64]) -> Level {
        let weights = self.weights(context);
        let length = self.nulls.first().map_or(0, |null| null.deviation.len());
        let total: f64 = weights.iter().sum::<f64>() + 1e-9;
        let nulls = total * total / (weights.iter().map(|w| w * w).sum::<f64>() + 1e-9);
        let count = weights.iter().filter(|w| **w > 0.0).count().max(1) as f64;
        let (mut mean, mut spread) = (vec![0.0; length], vec![LEAST; length]);
        for k in 0..length {
            let values = || self.nulls.iter().zip(&weights).filter(|(_, w)| **w > 0.0).map(|(null, w)| (f64::from(null.deviation[k]), *w));
            let near = values().map(|(v, w)| w * v).sum::<f64>() / total;
            let middle = values().map(|(v, _)| v).sum::<f64>() / count;
            let all = values().map(|(v, _)| (v - middle) * (v - middle)).sum::<f64>() / count;
            let local = values().map(|(v, w)| w * (v - near) * (v - near)).sum::<f64>() / total;
            mean[k] = near;
            spread[k] = libm::sqrt((nulls * local + PRIOR * all) / (nulls + PRIOR)) + LEAST;
        }
        Level { mean, spread, nulls }
    }
}

impl Floor {
    /// What recordings without an effect, those like it above all, have as a root mean square of every number; for a recording of a context.
    pub fn root_mean_square(&self, context: &[f64]) -> Vec<f64> {
        let weights = self.weights(context);
        let total: f64 = weights.iter().sum::<f64>() + 1e-9;
        let length = self.nulls.first().map_or(0, |null| null.deviation.len());
        let mean = |k: usize| self.nulls.iter().zip(&weights).map(|(null, w)| w * f64::from(null.deviation[k]) * f64::from(null.deviation[k])).sum::<f64>();
        (0..length).map(|k| libm::sqrt(mean(k) / total)).collect()
    }
}

impl Level {
    /// A deviation in spreads from the mean.
    pub fn z(&self, deviation: &[f64]) -> Vec<f64> {
        deviation.iter().zip(&self.mean).zip(&self.spread).map(|((d, m), s)| (d - m) / s).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn null(name: &str, context: f32, deviation: f32) -> Null {
        Null { name: name.into(), context: vec![context], deviation: vec![deviation] }
    }

    #[test]
    fn near_nulls_decide_the_mean_and_the_recording_itself_does_not_count() {
        let near = (0..10).map(|n| null("near", 0.0, 1.0 + 0.01 * n as f32));
        let far = (0..10).map(|n| null("far", 4.0, -1.0 + 0.01 * n as f32));
        let floor = Floor { nulls: near.chain(far).chain([null("self", 0.1, 100.0)]).collect() };
        let level = floor.level(&[0.1]);
        assert!((level.mean[0] - 1.0).abs() < 0.15, "{}", level.mean[0]);
        assert!(level.spread[0] < 1.0);
        assert!(floor.level(&[0.11]).mean[0] > 5.0);
    }

    #[test]
    fn biases_are_those_of_recordings_like_it() {
        let floor = Floor { nulls: vec![null("near", 0.0, 0.1), null("near", 0.05, -0.1), null("far", 4.0, 3.0), null("far", 4.1, 3.0)] };
        // Those near by have a weight of 1.03, the others one of 0.03.
        let mean = |near: f64, far: f64| libm::sqrt((1.03 * near + 0.03 * far) / 1.06);
        assert!((floor.root_mean_square(&[0.02])[0] - mean(0.01, 9.0)).abs() < 0.01);
        assert!((floor.root_mean_square(&[4.05])[0] - mean(9.0, 0.01)).abs() < 0.01);
        let alone = Floor { nulls: vec![null("a", 0.0, 0.3), null("b", 0.001, 0.4)] };
        assert!((alone.root_mean_square(&[0.5])[0] - libm::sqrt(0.125)).abs() < 0.01);
        assert!(Floor::default().root_mean_square(&[1.0]).is_empty());
    }
}
