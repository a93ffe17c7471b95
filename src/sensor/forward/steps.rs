//! The plain front end over many steps at once: everything about a step that does not depend on the voltage
//! it starts from.
//!
//! The low-pass is linear in its voltage, so the voltage at a step's end is `kept` times that at its start
//! plus a part that the light alone decides. Both are worked out for [`CHUNK`] steps in one loop without
//! branches (structure of arrays, vector instructions); what is left from step to step is a multiplication
//! and an addition, and the search for a crossing in the few steps that can hold one.
//!
//! Time is counted in time constants: with `theta = integral of dt / tau` the low-pass is
//! `dV / dtheta = u - V`, `u = ln i`, for any course of `tau`. Light is linear in time within a step. `1 /
//! tau` is taken at five instants a quarter of the step apart, and as the polynomial through them (Boole's
//! rule gives theta); `u` as the polynomial in theta through the same instants; for it the voltage has a
//! closed form. The error of a step is of fifth order in the change of `ln i`; constant light is exact over
//! any length, and so is a time constant of zero.

use super::light::LinearLight;
use crate::elementary;
use crate::front_end::{FrontEnd, settled_voltage, settling_rate};
use multiversion::multiversion;

/// Steps prepared in one go: their arrays stay in the first-level cache.
pub(super) const CHUNK: usize = 64;

/// Where light changes by a smaller share in all steps of a chunk, `ln i` is taken as a parabola in theta,
/// with an error of 1e-6 at most.
const FINE: f64 = 0.025;

/// Steps one after another, and how the low-pass answers to each. Entry `n` is of a step; `n` and `n + 1` are
/// of its ends, whose arrays are a whole number of vectors long.
pub(super) struct Steps {
    pub count: usize,
    /// Does light change by less than [`FINE`] in each?
    is_fine: bool,
    pub t_ns: [i64; CHUNK + 8],
    photocurrent: [f64; CHUNK + 8],
    /// ln i at the ends.
    pub settled: [f64; CHUNK + 8],
    /// Inverse time constant at the ends, 1/s.
    pub rate: [f64; CHUNK + 8],
    pub length_s: [f64; CHUNK],
    /// Inverse time constant at each quarter inside, 1/s.
    pub inside: [[f64; CHUNK]; 3],
    /// Length in time constants.
    pub theta: [f64; CHUNK],
    /// `u = settled + sum of course[k] sigma^(k + 1)`, sigma the share of theta.
    pub course: [[f64; CHUNK]; 4],
    /// What is left at the end of a difference between voltage and light at the start.
    pub kept: [f64; CHUNK],
    /// What the change of the light adds to the voltage at the end, and to its slope over the step's time
    /// there.
    pub driven: [f64; CHUNK],
    driven_slope: [f64; CHUNK],
    /// The same for the second derivative over sigma.
    driven_bend: [f64; CHUNK],
}

impl Steps {
    pub(super) fn new() -> Steps {
        let (ends, each) = ([1.0; CHUNK + 8], [0.0; CHUNK]);
        Steps {
            count: 0,
            is_fine: true,
            t_ns: [0; CHUNK + 8],
            photocurrent: ends,
            settled: ends,
            rate: ends,
            length_s: each,
            inside: [each; 3],
            theta: each,
            course: [each; 4],
            kept: each,
            driven: each,
            driven_slope: each,
            driven_bend: each,
        }
    }

    /// The voltage at the end of step `n` that starts at `voltage`.
    pub(super) fn end_voltage(&self, n: usize, voltage: f64) -> f64 {
        self.settled[n] + (voltage - self.settled[n]) * self.kept[n] + self.driven[n]
    }

    /// The voltage's slope at the start and the end of step `n`, over the share of its time, when it starts
    /// `ahead` of the settled one.
    pub(super) fn end_slopes(&self, n: usize, ahead: f64) -> [f64; 2] {
        let pull = self.length_s[n] * ahead;
        [-pull * self.rate[n], self.driven_slope[n] - pull * self.kept[n] * self.rate[n + 1]]
    }

    /// The voltage's second derivative over sigma at the start and the end of step `n`.
    pub(super) fn end_bends(&self, n: usize, ahead: f64) -> [f64; 2] {
        let theta = self.theta[n];
        let pull = theta * theta * ahead;
        [theta * self.course[0][n] + pull, self.driven_bend[n] + pull * self.kept[n]]
    }

    /// The light's second derivative over sigma, in `ln i`, at the start and the end of step `n`.
    pub(super) fn light_bends(&self, n: usize) -> [f64; 2] {
        let [second, third, fourth] = [1, 2, 3].map(|k| self.course[k][n]);
        [2.0 * second, 2.0 * second + 6.0 * third + 12.0 * fourth]
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
        let mut largest = 0.0;
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
            // Of a piece that is cut, its parts change by less: those are fine only if all of it is.
            largest = if rise.abs() > largest * least { rise.abs() / least } else { largest };
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
        (self.count, self.is_fine) = (n, largest < FINE);
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
    if steps.is_fine {
        prepare_all::<true>(steps, front_end, count);
    } else {
        prepare_all::<false>(steps, front_end, count);
    }
}

/// The answer to each of `count` steps; `IS_FINE` where light hardly bends in any, and a parabola is enough.
#[inline(always)]
fn prepare_all<const IS_FINE: bool>(steps: &mut Steps, front_end: &FrontEnd, count: usize) {
    for n in 0..count {
        let (from, to) = (steps.photocurrent[n], steps.photocurrent[n + 1]);
        let (first, last) = (steps.rate[n], steps.rate[n + 1]);
        let change = steps.settled[n + 1] - steps.settled[n];
        let rate = |share: f64| settling_rate(front_end, from + (to - from) * share);
        let middle = rate(0.5);
        let rates = if IS_FINE {
            let bend = 0.125 * (middle - 0.5 * (first + last));
            let mean = |near: f64| 0.5 * (near + middle) + bend;
            [first, mean(first), middle, mean(last), last]
        } else {
            [first, rate(0.25), middle, rate(0.75), last]
        };
        let sum = ninetieths(rates);
        let per_sum = 1.0 / sum;
        let sigma = sigma_of_quarters(rates, per_sum);
        let theta = steps.length_s[n] * sum * (1.0 / 90.0);
        let weights = Weights::after(theta);
        let [one, two, three, four] = weights.powers;
        let (course, mut driven, mut slope, mut bend);
        if IS_FINE {
            course = parabola(sigma[1], change);
            (driven, slope, bend) = (0.0, 0.0, 0.0);
        } else {
            course = through(sigma, ln_of_quarters(from, to, change), change);
            driven = course[2] * three + course[3] * four;
            slope = 3.0 * course[2] * two + 4.0 * course[3] * three;
            bend = 6.0 * course[2] * one + 12.0 * course[3] * two;
        }
        driven += course[0] * one + course[1] * two;
        slope += course[0] * weights.constant + 2.0 * course[1] * one;
        bend += 2.0 * course[1] * weights.constant + theta * weights.kept * course[0];
        for (to, rate) in steps.inside.iter_mut().zip(&rates[1..4]) {
            to[n] = *rate;
        }
        for (to, factor) in steps.course.iter_mut().zip(course) {
            to[n] = factor;
        }
        steps.theta[n] = theta;
        steps.kept[n] = weights.kept;
        steps.driven[n] = driven;
        steps.driven_slope[n] = slope * last * (90.0 * per_sum);
        steps.driven_bend[n] = bend;
    }
}

/// The parabola in place of [`through`], from `sigma` at half the time: there `ln i` lies above the mean of
/// its ends by ln cosh of half the change.
#[inline(always)]
fn parabola(sigma: f64, change: f64) -> [f64; 4] {
    let z = 0.25 * change * change;
    let middle = 0.5 * change + z * (1.0 / 2.0 - z * (1.0 / 12.0 - z * (1.0 / 45.0)));
    let bend = (change * sigma - middle) / (sigma * (1.0 - sigma));
    [change - bend, bend, 0.0, 0.0]
}

/// 90 times the mean of what has these values at the quarters of a step: Boole's rule.
#[inline(always)]
fn ninetieths(rates: [f64; 5]) -> f64 {
    7.0 * (rates[0] + rates[4]) + 32.0 * (rates[1] + rates[3]) + 12.0 * rates[2]
}

/// Which share of theta has passed at each quarter inside: the integral of the polynomial through the rates;
/// `per_sum` is one over their [`ninetieths`].
#[inline(always)]
fn sigma_of_quarters(rates: [f64; 5], per_sum: f64) -> [f64; 3] {
    let [a, b, c, d, e] = rates;
    [
        (251.0 * a + 646.0 * b - 264.0 * c + 106.0 * d - 19.0 * e) * (1.0 / 32.0) * per_sum,
        (29.0 * a + 124.0 * b + 24.0 * c + 4.0 * d - e) * 0.25 * per_sum,
        (9.0 * a + 34.0 * b + 24.0 * c + 14.0 * d - e) * (27.0 / 32.0) * per_sum,
    ]
}

/// By how much `ln i` has changed at each quarter inside of a step from `from` to `to`, over which it changes
/// by `change`.
#[inline(always)]
fn ln_of_quarters(from: f64, to: f64, change: f64) -> [f64; 3] {
    // The mean of both ends lies above their geometric mean, by -ln(1 - d^2) / 2; the other quarters are
    // 1 -+ d / 2 times the mean.
    let d = (to - from) / (to + from);
    let half = 0.5 * d;
    let middle = 0.5 * change - half_ln_1m(d * d);
    let (even, odd) = (half_ln_1m(half * half), atanh(half));
    let is_small = if d < 0.0 { -d } else { d } < 0.5;
    // A jump within a nanosecond is a straight line.
    [
        if is_small { middle + even - odd } else { 0.25 * change },
        if is_small { middle } else { 0.5 * change },
        if is_small { middle + even + odd } else { 0.75 * change },
    ]
}

/// `ln(1 - z) / 2` for `z` well below one: its series.
#[inline(always)]
fn half_ln_1m(z: f64) -> f64 {
    -z * (1.0 / 2.0 + z * (1.0 / 4.0 + z * (1.0 / 6.0 + z * (1.0 / 8.0 + z * (1.0 / 10.0)))))
}

/// `atanh(y)` for |y| well below one: its series.
#[inline(always)]
fn atanh(y: f64) -> f64 {
    let z = y * y;
    y * (1.0 + z * (1.0 / 3.0 + z * (1.0 / 5.0 + z * (1.0 / 7.0 + z * (1.0 / 9.0)))))
}

/// The polynomial that is 0 at 0, has `values` at `places` and `last` at 1: its factors from the first power
/// on, by Newton's divided differences.
#[inline(always)]
fn through(places: [f64; 3], values: [f64; 3], last: f64) -> [f64; 4] {
    let ([a, b, c], [at_a, at_b, at_c]) = (places, values);
    let (first, second) = (at_a / a, (at_b - at_a) / (b - a));
    let (third, fourth) = ((at_c - at_b) / (c - b), (last - at_c) / (1.0 - c));
    let (twice, twice_second, twice_third) =
        ((second - first) / b, (third - second) / (c - a), (fourth - third) / (1.0 - b));
    let (thrice, thrice_second) = ((twice_second - twice) / c, (twice_third - twice_second) / (1.0 - a));
    let highest = thrice_second - thrice;
    [
        first - twice * a + thrice * (a * b) - highest * (a * b * c),
        twice - thrice * (a + b) + highest * (a * b + (a + b) * c),
        thrice - highest * (a + b + c),
        highest,
    ]
}

/// How the share sigma of theta grows with the share `s` of a step's time: factors of `1, s, s^2 ...` of its
/// slope, when these are the rates at its quarters.
#[inline(always)]
pub(super) fn pace(rates: [f64; 5]) -> [f64; 5] {
    let per_mean = 90.0 / ninetieths(rates);
    let [a, b, c, d, e] = rates.map(|rate| rate * per_mean);
    // Forward differences, as a polynomial in quarters.
    let (one, two) = (b - a, c - 2.0 * b + a);
    let (three, four) = (d - 3.0 * (c - b) - a, e - 4.0 * (d + b) + 6.0 * c + a);
    [
        a,
        4.0 * (one - two / 2.0 + three / 3.0 - four / 4.0),
        16.0 * (two / 2.0 - three / 2.0 + four * (11.0 / 24.0)),
        64.0 * (three / 6.0 - four / 4.0),
        256.0 * (four / 24.0),
    ]
}

/// How much of each part of the light a low-pass has taken up after a time `x` in time constants.
#[derive(Clone, Copy)]
pub(super) struct Weights {
    /// exp(-x): of the difference at the start, what is left.
    pub kept: f64,
    /// 1 - exp(-x): of a constant.
    pub constant: f64,
    /// Of sigma to the powers 1 to 4: the response to `sigma^k`, over `sigma^k`.
    pub powers: [f64; 4],
}

impl Weights {
    /// Times shorter than this are short.
    const SHORT: f64 = 0.25;

    /// After `x`: [`Weights::after_short`] or [`Weights::after_long`], without a branch.
    #[inline(always)]
    fn after(x: f64) -> Weights {
        let is_short = x < Weights::SHORT;
        let short = Weights::after_short(x);
        let long = Weights::after_long(if is_short { Weights::SHORT } else { x });
        let either = |short: f64, long: f64| if is_short { short } else { long };
        Weights {
            kept: either(short.kept, long.kept),
            constant: either(short.constant, long.constant),
            powers: [0, 1, 2, 3].map(|k| either(short.powers[k], long.powers[k])),
        }
    }

    /// The same weights, for one time alone.
    #[inline(always)]
    pub(super) fn after_one(x: f64) -> Weights {
        if x < Weights::SHORT { Weights::after_short(x) } else { Weights::after_long(x) }
    }

    /// `w_k = 1 - k w_(k-1) / x`.
    #[inline(always)]
    fn after_long(x: f64) -> Weights {
        let constant = -elementary::exp_m1(-x);
        let per_x = 1.0 / x;
        let one = 1.0 - constant * per_x;
        let two = 1.0 - 2.0 * one * per_x;
        let three = 1.0 - 3.0 * two * per_x;
        Weights { kept: 1.0 - constant, constant, powers: [one, two, three, 1.0 - 4.0 * three * per_x] }
    }

    /// `w_(k-1) = x (1 - w_k) / k`, from the series of `w_4 = 24 x sum of (-x)^n / (n + 5)!` on.
    #[inline(always)]
    fn after_short(x: f64) -> Weights {
        // Factors: -1 / 6, 1 / (6 7), -1 / (6 7 8) ...
        let (y, z) = (x * x, (x * x) * (x * x));
        let series = (1.0 - x * (1.0 / 6.0))
            + y * (1.0 / 42.0 - x * (1.0 / 336.0))
            + z * ((1.0 / 3_024.0 - x * (1.0 / 30_240.0)) + y * (1.0 / 332_640.0 - x * (1.0 / 3_991_680.0)));
        let four = x * (1.0 / 5.0) * series;
        let three = x * (1.0 / 4.0) * (1.0 - four);
        let two = x * (1.0 / 3.0) * (1.0 - three);
        let one = x * (1.0 / 2.0) * (1.0 - two);
        let constant = x * (1.0 - one);
        Weights { kept: 1.0 - constant, constant, powers: [one, two, three, four] }
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
        for x in [1e-9, 1e-4, 0.01, 0.049, 0.051, 0.249, 0.251, 1.0, 4.0, 30.0] {
            let weights = Weights::after(x);
            let [one, two, three, four] = weights.powers;
            let all = [(0, weights.constant), (1, one), (2, two), (3, three), (4, four)];
            for (power, weight) in all {
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
