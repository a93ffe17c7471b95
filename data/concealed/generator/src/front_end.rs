//! The front end of all pixels: one step of time, each low-pass by its exact exponential for an input that is
//! a straight line.

use crate::light::{Node, cubic};
use crate::sensor::Physics;

/// Voltages of all pixels at both ends of the latest step, natural-log units.
pub struct FrontEnd {
    /// The settled voltage at the step's end.
    pub settled: Vec<f64>,
    /// Behind the first low-pass.
    pub first: Vec<f64>,
    before_first: Vec<f64>,
    /// Behind the second low-pass, where there is one.
    second: Vec<f64>,
    /// What the comparator sees at the step's start and end.
    pub before: Vec<f64>,
    pub now: Vec<f64>,
    /// The same at the start of the step before: the three ends give the curve inside a step.
    earlier: Vec<f64>,
    /// Photocurrent at the event pixels in the step's middle.
    pub light: Vec<f64>,
    /// 1 / relative time constant of each pixel.
    speed: Vec<f64>,
    rest: Vec<f64>,
    /// Does a jump of the first low-pass reach the comparator as a jump?
    unfiltered: bool,
}

/// 1 / n!, with alternating signs, from n = 9 down.
const SERIES: [f64; 10] = [
    -1.0 / 362_880.0,
    1.0 / 40_320.0,
    -1.0 / 5040.0,
    1.0 / 720.0,
    -1.0 / 120.0,
    1.0 / 24.0,
    -1.0 / 6.0,
    0.5,
    -1.0,
    1.0,
];

/// `exp(-z)` for 0 <= z < 0.3: the series to the ninth power, wrong by 2e-12 at most; without a call the
/// loops run on lanes.
#[inline]
fn decay(z: f64) -> f64 {
    let mut sum = SERIES[0];
    for factor in &SERIES[1..] {
        sum = sum * z + factor;
    }
    sum
}

/// The end of a step of a low-pass whose input runs from `from` to `to`, with `z` = step / time constant.
#[inline]
fn follow(v: f64, from: f64, to: f64, z: f64) -> f64 {
    let behind = (to - from) / z;
    to - behind + (v - from + behind) * decay(z)
}

impl FrontEnd {
    /// All pixels settled at `node`.
    pub fn settled(node: &Node, physics: &Physics, width: usize) -> Self {
        let n = node.settled.len();
        let across = |p: usize| 2.0 * (p % width) as f64 / (width - 1) as f64 - 1.0;
        let rest = if physics.high_pass.is_finite() { node.settled.clone() } else { vec![0.0; n] };
        let now: Vec<f64> = node.settled.iter().zip(&rest).map(|(v, rest)| v - rest).collect();
        Self {
            settled: node.settled.clone(),
            first: node.settled.clone(),
            before_first: node.settled.clone(),
            second: node.settled.clone(),
            before: now.clone(),
            earlier: now.clone(),
            now,
            light: node.events.clone(),
            speed: (0..n).map(|p| 1.0 + physics.bandwidth_gradient * across(p)).collect(),
            rest,
            unfiltered: physics.second_tau + physics.second_light == 0.0,
        }
    }

    /// One step of `h` seconds that ends at `u` (0 .. 1) between the nodes 1 and 2 of `nodes` and began at
    /// `from`.
    pub fn step(&mut self, nodes: &[Node; 4], from: f64, u: f64, h: f64, physics: &Physics) {
        let n = self.first.len();
        let (end, middle) = (cubic(u), cubic(0.5 * (from + u)));
        let [a, b, c, d] = [0, 1, 2, 3].map(|k| &nodes[k].settled[..n]);
        let [ia, ib, ic, id] = [0, 1, 2, 3].map(|k| &nodes[k].events[..n]);
        let (tau_0, alpha, dark) = (physics.sensor.tau_0, physics.sensor.alpha, physics.dark);
        std::mem::swap(&mut self.first, &mut self.before_first);
        let (old, new) = (&self.before_first[..n], &mut self.first[..n]);
        let (settled, light, speed) = (&mut self.settled[..n], &mut self.light[..n], &self.speed[..n]);
        for p in 0..n {
            let i = middle[0] * ia[p] + middle[1] * ib[p] + middle[2] * ic[p] + middle[3] * id[p];
            let to = end[0] * a[p] + end[1] * b[p] + end[2] * c[p] + end[3] * d[p];
            let z = h * speed[p] * (i + dark) / (tau_0 * (i + dark) + alpha);
            light[p] = i;
            new[p] = if physics.large_signal { old[p] } else { follow(old[p], settled[p], to, z) };
            if physics.large_signal {
                // dx/dt = -(1 - exp(-x)) / tau for x = settled - V is solved by exp(x) - 1 ~ exp(-t / tau);
                // input at mid-step.
                let input = 0.5 * (settled[p] + to);
                new[p] = input - libm::log1p(libm::expm1(input - old[p]) * decay(z));
            }
            settled[p] = to;
        }
        if physics.rise.is_finite() || physics.fall.is_finite() {
            for (new, old) in new.iter_mut().zip(old) {
                *new = old + (*new - old).clamp(-physics.fall * h, physics.rise * h);
            }
        }
        std::mem::swap(&mut self.before, &mut self.earlier);
        std::mem::swap(&mut self.before, &mut self.now);
        let output = &mut self.now[..n];
        if physics.second_tau + physics.second_light > 0.0 {
            for p in 0..n {
                let z = h * light[p] / (physics.second_tau * light[p] + physics.second_light);
                output[p] = follow(self.second[p], old[p], new[p], z);
            }
            std::mem::swap(&mut self.second, &mut self.now);
            self.now.copy_from_slice(&self.second);
        } else {
            output.copy_from_slice(new);
        }
        if physics.high_pass.is_finite() {
            // The comparator sees what is left after the resting value, a slow low-pass of the voltage, is
            // taken away: U = V - rest with d rest/dt = U / tau is dU/dt = dV/dt - U / tau.
            let z = h / physics.high_pass;
            for p in 0..n {
                let (v_old, v_new) = (self.before[p] + self.rest[p], self.now[p]);
                self.rest[p] = follow(self.rest[p], v_old, v_new, z);
                self.now[p] = v_new - self.rest[p];
            }
        }
    }

    /// What the comparator of pixel `p` sees at `u` (0 .. 1) inside the latest step: the parabola through
    /// three ends of steps.
    pub fn within(&self, p: usize, u: f64) -> f64 {
        let (before, now) = (self.before[p], self.now[p]);
        before + (now - before) * u + 0.5 * (now - 2.0 * before + self.earlier[p]) * u * (u - 1.0)
    }

    /// Shakes the voltage of the pixels `range` by `jump`, between the latest step and the next.
    pub fn kick(&mut self, range: std::ops::Range<usize>, jump: f64) {
        self.first[range.clone()].iter_mut().for_each(|v| *v += jump);
        if self.unfiltered {
            [&mut self.now, &mut self.before]
                .into_iter()
                .flat_map(|of| &mut of[range.clone()])
                .for_each(|v| *v += jump);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_series_is_the_exponential() {
        for z in [0.0, 1e-6, 0.1, 0.2, 0.3] {
            assert!((decay(z) - libm::exp(-z)).abs() < 3e-12, "{z}");
        }
    }

    #[test]
    fn a_low_pass_follows_a_ramp_as_its_closed_form_says() {
        // dv/dt = (s t - v) / tau from rest: v = s (t - tau) + s tau exp(-t / tau).
        let (tau, slope, h) = (100e-6, 30.0, 2.5e-6);
        let mut v = 0.0;
        for k in 0..200 {
            v = follow(v, slope * h * f64::from(k), slope * h * f64::from(k + 1), h / tau);
        }
        let t = 200.0 * h;
        assert!((v - (slope * (t - tau) + slope * tau * libm::exp(-t / tau))).abs() < 1e-12);
    }
}
