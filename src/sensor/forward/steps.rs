//! The plain front end over many steps at once: everything about a step that does not depend on the voltage
//! it starts from.
//!
//! The low-pass is linear in its voltage, so the voltage at a step's end is `kept` times that at its start
//! plus a part that the light alone decides. Both are worked out for [`CHUNK`] steps in one loop without
//! branches (structure of arrays, vector instructions); what is left from step to step is a multiplication
//! and an addition, and the search for a crossing in the few steps that can hold one.
//!
//! Time is counted in time constants: with `theta = integral of dt / tau` the low-pass is
//! `dV / dtheta = u - V`, `u = ln i`, for any course of `tau`. Light is linear in time within a step. `tau`
//! along the step enters by Simpson's rule, `u` as the parabola in theta through the step's start, middle and
//! end; for that parabola the voltage has a closed form. The error of a step is of third order in the change
//! of `ln i`; constant light is exact over any length, and so is a time constant of zero.

use super::light::LinearLight;
use crate::elementary;
use crate::front_end::{FrontEnd, settled_voltage, settling_rate};
use multiversion::multiversion;

/// Steps prepared in one go: their arrays stay in the first-level cache.
pub(super) const CHUNK: usize = 64;

/// Steps one after another, and how the low-pass answers to each. Entry `n` is of a step; `n` and `n + 1` are
/// of its ends, whose arrays are a whole number of vectors long.
pub(super) struct Steps {
    pub count: usize,
    pub t_ns: [i64; CHUNK + 8],
    photocurrent: [f64; CHUNK + 8],
    /// ln i at the ends.
    pub settled: [f64; CHUNK + 8],
    /// Inverse time constant at the ends, 1/s.
    pub rate: [f64; CHUNK + 8],
    pub length_s: [f64; CHUNK],
    /// Length in time constants.
    pub theta: [f64; CHUNK],
    /// Which share of theta the first half of the time takes.
    pub middle: [f64; CHUNK],
    /// `u = settled + slope sigma + bend sigma^2`, sigma the share of theta.
    pub slope: [f64; CHUNK],
    pub bend: [f64; CHUNK],
    /// What is left at the end of a difference between voltage and light at the start.
    pub kept: [f64; CHUNK],
    /// What the change of the light adds to the voltage at the end, and to its slope over sigma there.
    pub driven: [f64; CHUNK],
    driven_slope: [f64; CHUNK],
}

impl Steps {
    pub(super) fn new() -> Steps {
        let (ends, each) = ([1.0; CHUNK + 8], [0.0; CHUNK]);
        Steps {
            count: 0,
            t_ns: [0; CHUNK + 8],
            photocurrent: ends,
            settled: ends,
            rate: ends,
            length_s: each,
            theta: each,
            middle: each,
            slope: each,
            bend: each,
            kept: each,
            driven: each,
            driven_slope: each,
        }
    }

    /// The voltage at the end of step `n` that starts at `voltage`.
    pub(super) fn end_voltage(&self, n: usize, voltage: f64) -> f64 {
        self.settled[n] + (voltage - self.settled[n]) * self.kept[n] + self.driven[n]
    }

    /// The voltage's slope over sigma at the start and the end of step `n`, when it starts `ahead` of the
    /// settled one.
    pub(super) fn end_slopes(&self, n: usize, ahead: f64) -> [f64; 2] {
        let pull = self.theta[n] * ahead;
        [-pull, self.driven_slope[n] - pull * self.kept[n]]
    }

    /// Takes as many steps as fit from `from_ns` on, none beyond `limit_ns`. `next` is the first of the
    /// light's instants after `from_ns`.
    ///
    /// In a step the light changes by at most the factor `1 + change`, unless a nanosecond does more.
    pub(super) fn fill(
        &mut self,
        light: &LinearLight<'_>,
        next: &mut usize,
        from_ns: i64,
        limit_ns: i64,
        change: f64,
    ) {
        let (instants, values) = (light.t_ns, light.photocurrent);
        while *next < instants.len() && instants[*next] <= from_ns {
            *next += 1;
        }
        let (mut t, mut i) = (from_ns, light.between(*next, from_ns));
        (self.t_ns[0], self.photocurrent[0]) = (t, i);
        let mut n = 0;
        while n < CHUNK && t < limit_ns {
            // A run of equal values is one step.
            while *next + 1 < instants.len()
                && values[*next] == i
                && values[*next + 1] == i
                && instants[*next] < limit_ns
            {
                *next += 1;
            }
            let (end_ns, end) =
                if *next < instants.len() { (instants[*next], values[*next]) } else { (i64::MAX, i) };
            let piece = (t, i);
            let (rise, least) = (end - i, if end < i { end } else { i });
            if rise.abs() > change * least {
                // Towards the darker side the same factor is a smaller part of what is there.
                let share = if rise > 0.0 { change } else { change / (1.0 + change) };
                let ns_per_light = (end_ns - t) as f64 / rise.abs();
                let slope = rise / (end_ns - t) as f64;
                while n < CHUNK && t < limit_ns {
                    let to = i64::min(t + i64::max(1, (i * share * ns_per_light) as i64), limit_ns);
                    if to >= end_ns {
                        break;
                    }
                    i = piece.1 + slope * (to - piece.0) as f64;
                    n = self.push(n, t, to, i);
                    t = to;
                }
            }
            if n < CHUNK && t < limit_ns {
                let to = end_ns.min(limit_ns);
                i = if to == end_ns { end } else { light.between(*next, to) };
                n = self.push(n, t, to, i);
                t = to;
                *next += usize::from(t == end_ns);
            }
        }
        self.count = n;
    }

    /// Step `n` from `from_ns` to `to_ns`, where the light is `i`; gives the number of the next.
    #[inline(always)]
    fn push(&mut self, n: usize, from_ns: i64, to_ns: i64, i: f64) -> usize {
        self.length_s[n] = (to_ns - from_ns) as f64 * 1e-9;
        (self.t_ns[n + 1], self.photocurrent[n + 1]) = (to_ns, i);
        n + 1
    }

    /// Works out the answer of the low-pass to every step.
    pub(super) fn prepare(&mut self, front_end: &FrontEnd) {
        prepare(self, front_end);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
fn prepare(steps: &mut Steps, front_end: &FrontEnd) {
    let count = steps.count.min(CHUNK);
    let ends = steps.settled.iter_mut().zip(&mut steps.rate).zip(&steps.photocurrent);
    // One end more than steps, up to whole vectors: what stands beyond is never read.
    for ((settled, rate), &i) in ends.take((count + 8) & !7) {
        *settled = settled_voltage(i);
        *rate = settling_rate(front_end, i);
    }
    for n in 0..count {
        let (first, last) = (steps.rate[n], steps.rate[n + 1]);
        let halfway = settling_rate(front_end, 0.5 * (steps.photocurrent[n] + steps.photocurrent[n + 1]));
        let sum = first + 4.0 * halfway + last;
        let theta = steps.length_s[n] * sum * (1.0 / 6.0);
        // The integral of the rate over the first half, by the same parabola, and its share of the whole.
        let half = 1.25 * first + 2.0 * halfway - 0.25 * last;
        let middle = half / sum;
        let change = steps.settled[n + 1] - steps.settled[n];
        // ln of the mean of both ends lies above the mean of their ln by ln cosh of half the change.
        let to_middle = 0.5 * change + ln_cosh(0.5 * change);
        let bend = (change * middle - to_middle) / (middle * (1.0 - middle));
        let slope = change - bend;
        let weights = Weights::after(theta);
        steps.theta[n] = theta;
        steps.middle[n] = middle;
        steps.slope[n] = slope;
        steps.bend[n] = bend;
        steps.kept[n] = weights.kept;
        steps.driven[n] = slope * weights.slope + bend * weights.bend;
        steps.driven_slope[n] = slope * weights.constant + 2.0 * bend * weights.slope;
    }
}

/// ln cosh y for |y| well below one: its series.
#[inline(always)]
fn ln_cosh(y: f64) -> f64 {
    let z = y * y;
    z * (1.0 / 2.0 - z * (1.0 / 12.0 - z * (1.0 / 45.0 - z * (17.0 / 2520.0))))
}

/// How much of each part of the light a low-pass has taken up after a time `x` in time constants.
#[derive(Clone, Copy)]
pub(super) struct Weights {
    /// exp(-x): of the difference at the start, what is left.
    pub kept: f64,
    /// 1 - exp(-x): of a constant.
    pub constant: f64,
    /// Of a slope: the response to sigma, over sigma.
    pub slope: f64,
    /// Of a parabola: the response to sigma^2, over sigma^2.
    pub bend: f64,
}

impl Weights {
    /// `w_0 = 1 - exp(-x)`, `w_k = 1 - k w_(k-1) / x`; for short times upwards from the series of
    /// `w_2 = 2 x sum of (-x)^n / (n + 3)!`.
    #[inline(always)]
    pub(super) fn after(x: f64) -> Weights {
        const SHORT: f64 = 0.05;
        let constant = -elementary::exp_m1(-x);
        let per_long = 1.0 / if x < SHORT { SHORT } else { x };
        let slope = 1.0 - constant * per_long;
        let bend = 1.0 - 2.0 * slope * per_long;
        let series = 1.0 / 6.0
            - x * (1.0 / 24.0
                - x * (1.0 / 120.0 - x * (1.0 / 720.0 - x * (1.0 / 5_040.0 - x * (1.0 / 40_320.0)))));
        let short_bend = 2.0 * x * series;
        let short_slope = 0.5 * x * (1.0 - short_bend);
        let is_short = x < SHORT;
        Weights {
            kept: 1.0 - constant,
            constant,
            slope: if is_short { short_slope } else { slope },
            bend: if is_short { short_bend } else { bend },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same weights by adding up the low-pass in 20,000 small steps (midpoint rule of the convolution).
    fn by_sum(x: f64, power: i32) -> f64 {
        let n = 20_000;
        let part = |k: usize| {
            let sigma = (k as f64 + 0.5) / n as f64;
            x / n as f64 * libm::exp(-x * (1.0 - sigma)) * libm::pow(sigma, f64::from(power))
        };
        (0..n).map(part).sum()
    }

    #[test]
    fn weights_are_the_convolution_of_a_low_pass_with_powers() {
        for x in [1e-9, 1e-4, 0.01, 0.049, 0.051, 0.3, 1.0, 4.0, 30.0] {
            let weights = Weights::after(x);
            for (power, weight) in [(0, weights.constant), (1, weights.slope), (2, weights.bend)] {
                let expected = by_sum(x, power);
                assert!(
                    (weight - expected).abs() < 2e-7 * expected,
                    "x = {x}, power {power}: {weight} {expected}"
                );
            }
        }
    }

    #[test]
    fn steps_end_at_instants_of_the_light_and_change_it_a_little() {
        let (t_ns, photocurrent) =
            (vec![0, 1000, 5000, 6000, 7000, 9000], vec![1.0, 1.0, 8.0, 8.0, 8.0, 2.0]);
        let light = LinearLight::new(&t_ns, &photocurrent);
        let mut steps = Steps::new();
        let (mut next, mut from, mut ends, mut values) = (0, -500, vec![-500], vec![1.0]);
        while from < 12_000 {
            steps.fill(&light, &mut next, from, 12_000, 0.3);
            ends.extend_from_slice(&steps.t_ns[1..=steps.count]);
            values.extend_from_slice(&steps.photocurrent[1..=steps.count]);
            from = *ends.last().unwrap();
        }
        assert!(
            ends.is_sorted_by(|a, b| a < b) && [1000, 5000, 9000, 12_000].iter().all(|t| ends.contains(t)),
            "{ends:?}"
        );
        // Constant light needs no instants of its own: 5000 to 7000 is one step.
        assert!(!ends.contains(&6000) && ends.contains(&7000), "{ends:?}");
        for (&t, &i) in ends.iter().zip(&values) {
            assert!((i / light.at(t) - 1.0).abs() < 1e-14);
        }
        assert!(
            values.windows(2).all(|pair| pair[1] / pair[0] < 1.301 && pair[0] / pair[1] < 1.301),
            "{values:?}"
        );
    }
}
