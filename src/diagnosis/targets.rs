//! Known targets simulated for training: a turning star or discs before a plain wall whose place, speed,
//! phase and light are free within a range, as a user states them.
//!
//! The scene, the sensor and its frames are those of [`crate::scenes`]; thresholds and frames have noise,
//! which most descriptions state and some do not.

use crate::scenes::SimulatedScene;
use photocurrent_core::random::Random;
use photocurrent_scene::closed::ClosedScene;
use photocurrent_scene::closed::sketch::Sketch;
use photocurrent_scene::target::TargetForm;

/// Free parameters: speed (a factor), dark and bright light (factors), time since the start (s), shifts
/// (pixels).
const FREE: usize = 6;

/// Neutral value of each parameter.
const NEUTRAL: [f64; FREE] = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0];

/// A simulated scene with values of its free parameters.
struct LitSketch {
    sketch: Sketch,
    values: [f64; FREE],
}

impl ClosedScene for LitSketch {
    fn light(&self, x: f64, y: f64, t_ns: i64) -> f64 {
        let [speed, _, _, start_s, shift_x, shift_y] = self.values;
        libm::exp(self.sketch.log_light(x - shift_x, y - shift_y, speed * (t_ns as f64 * 1e-9 + start_s)))
    }

    fn speed(&self, x: f64, y: f64) -> f64 {
        self.values[0] * self.sketch.px_per_s(x - self.values[4], y - self.values[5]) * 1e-9
    }
}

/// A family of targets, with ranges of its parameters that contain the true ones.
pub struct SketchFamily {
    sketch: Sketch,
    ranges: [(f64, f64); FREE],
}

impl SketchFamily {
    /// Ranges around a scene, and where in them it is, as shares.
    pub fn ranges_around(scene: &SimulatedScene, seed: u64, index: u64) -> (SketchFamily, Vec<f64>) {
        let mut random = Random::new(seed, &[index, 0x7c]);
        // Half the time from one spoke to the next: more would be another star.
        let widths = [0.1, 0.4, 0.6, 0.5 * scene.sketch.period_s(), 3.0, 3.0];
        let shares: Vec<f64> = (0..FREE).map(|_| 0.1 + 0.8 * random.uniform()).collect();
        let ranges = std::array::from_fn(|k| {
            let from = NEUTRAL[k] - widths[k] * shares[k];
            (from, from + widths[k])
        });
        (SketchFamily { sketch: scene.sketch.clone(), ranges }, shares)
    }
}

impl TargetForm for SketchFamily {
    fn count(&self) -> usize {
        FREE
    }

    fn at(&self, shares: &[f64]) -> Option<Box<dyn ClosedScene>> {
        let values: [f64; FREE] = std::array::from_fn(|k| {
            self.ranges[k].0 + (self.ranges[k].1 - self.ranges[k].0) * shares.get(k).copied().unwrap_or(0.5)
        });
        Some(Box::new(LitSketch { sketch: self.sketch.clone().lit(values[1], values[2]), values }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::Extent;

    #[test]
    fn the_true_shares_give_the_scene_itself() {
        for index in 0..6 {
            let scene = SimulatedScene::target(4, index, Extent { width: 24, height: 18 }, 0.05);
            let (sketches, shares) = SketchFamily::ranges_around(&scene, 4, index);
            let shown = sketches.at(&shares).unwrap();
            for (x, y, t_ns) in [(3.0, 4.0, 0), (12.0, 9.0, 7_000_000), (20.0, 2.0, 31_000_000)] {
                let truth = libm::exp(scene.sketch.log_light(x, y, t_ns as f64 * 1e-9));
                assert!((shown.light(x, y, t_ns) / truth - 1.0).abs() < 1e-6, "scene {index}");
            }
        }
    }
}
