//! What is expected of log light before any measurement: it moves with a speed that lasts a while and differs from place to place in time.
//!
//! The increment over segment j is `w_j = sqrt(q_j) z_j` with z of unit variance, correlated between neighbours like
//! `exp(-distance / memory)`. Its variance is the local one: `q_j = h_j^2 (floor^2 + mean square slope nearby)`, taken anew from
//! the estimate in every iteration. Quiet stretches stay quiet, edges may be steep: an empirical-Bayes relative of a heavy-tailed prior that
//! pools over time. All in terms of slopes, so that knots may stand anywhere.

/// The constants of the prior.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// Slope that is always allowed, natural-log units per second.
    pub floor_per_s: f64,
    /// How long a slope lasts, seconds.
    pub memory_s: f64,
    /// Slopes up to this far away count for the local variance, seconds.
    pub reach_s: f64,
}

impl Prior {
    /// Suits most recordings.
    pub const USUAL: Prior = Prior { floor_per_s: 6.0, memory_s: 2.0e-3, reach_s: 0.25e-3 };
}

impl Default for Prior {
    fn default() -> Prior {
        Prior::USUAL
    }
}

/// The prior of each segment of one pixel: entry j belongs to the segment that ends at knot j; entry 0 to none.
#[derive(Clone, Debug, Default)]
pub(super) struct Segments {
    /// Length, seconds.
    pub length_s: Vec<f64>,
    /// Correlation with the segment before; 0 for the first.
    pub correlation: Vec<f64>,
    /// Square root of q.
    pub scale: Vec<f64>,
    middle_s: Vec<f64>,
    energy: Vec<f64>,
}

impl Segments {
    /// Lengths and correlations of the segments between knots.
    pub fn lay(&mut self, t_ns: &[i64], prior: &Prior) {
        let seconds = |j: usize| (t_ns[j] - t_ns[0]) as f64 * 1e-9;
        for column in [&mut self.length_s, &mut self.correlation, &mut self.scale, &mut self.middle_s] {
            column.clear();
            column.resize(t_ns.len(), 0.0);
        }
        for j in 1..t_ns.len() {
            self.length_s[j] = (t_ns[j] - t_ns[j - 1]) as f64 * 1e-9;
            self.middle_s[j] = 0.5 * (seconds(j) + seconds(j - 1));
            if j > 1 {
                self.correlation[j] = libm::exp(-(self.middle_s[j] - self.middle_s[j - 1]) / prior.memory_s);
            }
        }
    }

    /// Takes the scales from the slopes of `u`.
    pub fn adapt(&mut self, u: &[f64], prior: &Prior) {
        let knots = u.len();
        self.energy.clear();
        self.energy.push(0.0);
        // energy[j] sums h slope^2 over segments 1..=j.
        for j in 1..knots {
            let w = u[j] - u[j - 1];
            self.energy.push(self.energy[j - 1] + w * w / self.length_s[j]);
        }
        let (mut low, mut high) = (1, 1);
        // Middles are rounded: a neighbour exactly at the reach counts.
        let reach_s = prior.reach_s * 1.001;
        let mut length = 0.0;
        for j in 1..knots {
            while high < knots && self.middle_s[high] <= self.middle_s[j] + reach_s {
                length += self.length_s[high];
                high += 1;
            }
            while self.middle_s[low] < self.middle_s[j] - reach_s {
                length -= self.length_s[low];
                low += 1;
            }
            let mean_square = f64::max(self.energy[high - 1] - self.energy[low - 1], 0.0) / length;
            self.scale[j] = self.length_s[j] * (prior.floor_per_s * prior.floor_per_s + mean_square).sqrt();
        }
    }
}
