//! Synthetic problems of one pixel, for benches: steps near +-0.2 at random instants, three frames over 25
//! ms.
//!
//! Counts and times only: the digital numbers are drawn, not simulated, so a solution need not resemble any
//! light.

use photocurrent_sensor::front_end::{FrontEnd, TauRule};
use photocurrent_sensor::inverse::{FrameSample, PixelProblem};

/// The seed of the first pixel; pixel `n` has `SEED + n`.
pub const SEED: u64 = 20_240_607;

/// What is measured at one pixel, owned; fields as in [`PixelProblem`].
pub struct Columns {
    pub t_s: Vec<f64>,
    pub steps: Vec<f64>,
    pub frames: Vec<FrameSample>,
}

/// `knots` events at random instants, whose steps bring the pixel back to its level now and then.
pub fn columns(knots: usize, seed: u64) -> Columns {
    let mut state = seed;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let mut now = 0.0;
    let mut gaps: Vec<f64> = (0..knots).map(|_| 0.3 + uniform()).collect();
    let total: f64 = gaps.iter().sum();
    for gap in &mut gaps {
        *gap *= 25e-3 / total;
    }
    let t_s = gaps.iter().map(|gap| {
        now += gap;
        now
    });
    let t_s = t_s.collect();
    let mut level = 0.0;
    let steps = (0..knots).map(|_| {
        let sign = if level * 0.5 + uniform() - 0.5 > 0.0 { -1.0 } else { 1.0 };
        let step = sign * (0.18 + 0.04 * uniform());
        level += step;
        step
    });
    let steps = steps.collect();
    let frames = (0..3)
        .map(|l| {
            let start_s = 0.5e-3 + 8.33e-3 * l as f64;
            FrameSample { start_s, end_s: start_s + 6.5e-3, dn: 330.0 + 60.0 * uniform(), weight: 0.04 }
        })
        .collect();
    Columns { t_s, steps, frames }
}

impl Columns {
    /// A bright pixel; noise of 5 DN in frames and of a tenth of a threshold in steps.
    pub fn problem(&self, tau_rule: TauRule) -> PixelProblem<'_> {
        PixelProblem {
            t_s: &self.t_s,
            steps: &self.steps,
            frames: &self.frames,
            evs_weight: 2500.0,
            front_end: FrontEnd { tau_0_s: 30e-6, alpha_s: 5e-6 },
            tau_rule,
            black_level: 0.0,
            gain: 153_846.0,
        }
    }
}
