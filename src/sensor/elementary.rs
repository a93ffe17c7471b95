//! Exponential and logarithm of `f64` without branches, so that a loop over them becomes vector instructions.
//!
//! Plain additions, multiplications and divisions in a fixed order: the same bits on every machine and at
//! every vector width. Accurate to about one unit in the last place (tests compare with `libm`), several
//! times faster than it in a loop.
//!
//! Source: range reduction and the polynomial of the logarithm as in FDLIBM's `e_log.c`; the exponential is
//! its Taylor series after reduction to |r| < 0.35. Limits: the logarithm takes normal positive numbers; the
//! exponential is flat beyond the range of normal numbers.

use multiversion::multiversion;

/// ln 2 in two parts; the first has trailing zeros, so that a whole multiple of it is exact.
const LN_2_HIGH: f64 = 6.931_471_803_691_238e-1;
const LN_2_LOW: f64 = 1.908_214_929_270_587_7e-10;

/// Adding it rounds to a whole number, which then stands in the lowest bits.
const ROUNDER: f64 = 6_755_399_441_055_744.0;

/// 2^52 as bits: below it stands a whole number.
const WHOLE: u64 = 0x4330_0000_0000_0000;

/// One over the factorials from 2 on.
const INVERSE_FACTORIAL: [f64; 12] = [
    1.0 / 2.0,
    1.0 / 6.0,
    1.0 / 24.0,
    1.0 / 120.0,
    1.0 / 720.0,
    1.0 / 5_040.0,
    1.0 / 40_320.0,
    1.0 / 362_880.0,
    1.0 / 3_628_800.0,
    1.0 / 39_916_800.0,
    1.0 / 479_001_600.0,
    1.0 / 6_227_020_800.0,
];

/// The nearest whole number, halves to the even one, of a number below 2^51.
#[inline(always)]
pub fn nearest(x: f64) -> f64 {
    (x + ROUNDER) - ROUNDER
}

/// A power of two and the rest: x = k ln 2 + r with |r| < 0.35; gives (2^k, r).
#[inline(always)]
fn reduced(x: f64) -> (f64, f64) {
    // Beyond the range of normal numbers the answer stays at its end. Not `clamp`: a comparison and a choice
    // are one instruction each.
    let x = if x < -708.0 { -708.0 } else { x };
    let x = if x > 709.0 { 709.0 } else { x };
    let rounded = x * std::f64::consts::LOG2_E + ROUNDER;
    let k = rounded - ROUNDER;
    let r = (x - k * LN_2_HIGH) - k * LN_2_LOW;
    (f64::from_bits((rounded.to_bits() << 52).wrapping_add(1023 << 52)), r)
}

/// `exp(r) - 1` for |r| < 0.35.
#[inline(always)]
fn small_exp_m1(r: f64) -> f64 {
    let f = &INVERSE_FACTORIAL;
    let (r2, r4) = (r * r, (r * r) * (r * r));
    // Estrin's scheme: short chains, so that a single evaluation is quick as well.
    let low = (f[0] + f[1] * r) + (f[2] + f[3] * r) * r2;
    let middle = (f[4] + f[5] * r) + (f[6] + f[7] * r) * r2;
    let high = (f[8] + f[9] * r) + (f[10] + f[11] * r) * r2;
    r + r2 * (low + r4 * (middle + r4 * high))
}

/// e to the power `x`; below -708 and above 709 the value there.
#[inline(always)]
pub fn exp(x: f64) -> f64 {
    let (power, r) = reduced(x);
    power * (1.0 + small_exp_m1(r))
}

/// `exp(x) - 1`, accurate near zero.
#[inline(always)]
pub fn exp_m1(x: f64) -> f64 {
    let (power, r) = reduced(x);
    power * small_exp_m1(r) + (power - 1.0)
}

/// Natural logarithm of a normal positive number; NaN for anything that is not above zero, infinity for
/// infinity.
#[inline(always)]
pub fn ln(x: f64) -> f64 {
    const SQRT_HALF: u64 = 0x3FE6_A09E_0000_0000;
    const ONE: u64 = 0x3FF0_0000_0000_0000;
    // x = 2^k m with m from sqrt(1/2) to sqrt(2).
    let shifted = x.to_bits().wrapping_add(ONE - SQRT_HALF);
    let k = f64::from_bits(WHOLE | (shifted >> 52)) - (f64::from_bits(WHOLE) + 1023.0);
    let m = f64::from_bits((shifted & 0x000F_FFFF_FFFF_FFFF) + SQRT_HALF);
    let f = m - 1.0;
    let s = f / (2.0 + f);
    let (z, w) = (s * s, (s * s) * (s * s));
    let even =
        w * (3.999_999_999_940_942e-1 + w * (2.222_219_843_214_978_4e-1 + w * 1.531_383_769_920_937_3e-1));
    let odd = z
        * (6.666_666_666_666_735e-1
            + w * (2.857_142_874_366_239e-1
                + w * (1.818_357_216_161_805e-1 + w * 1.479_819_860_511_658_6e-1)));
    let half_square = 0.5 * f * f;
    let value = k * LN_2_HIGH - ((half_square - (s * (half_square + (even + odd)) + k * LN_2_LOW)) - f);
    let value = if x == f64::INFINITY { x } else { value };
    let value = if x == 0.0 { f64::NEG_INFINITY } else { value };
    if x >= 0.0 { value } else { f64::NAN }
}

/// Replaces each number by its exponential.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub fn exp_all(values: &mut [f64]) {
    for value in values {
        *value = exp(*value);
    }
}

/// Replaces each number by its natural logarithm.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
pub fn ln_all(values: &mut [f64]) {
    for value in values {
        *value = ln(*value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Distance in units of the last place of `expected`.
    fn ulps(got: f64, expected: f64) -> f64 {
        (got - expected).abs() / (expected.abs() * f64::EPSILON)
    }

    #[test]
    fn logarithms_are_those_of_libm_to_two_last_places() {
        for n in 0..200_000 {
            let x = libm::exp(-600.0 + 0.006 * f64::from(n)) * (1.0 + f64::from(n % 97) * 0.01);
            assert!(ulps(ln(x), libm::log(x)) < 2.0, "{x}: {} {}", ln(x), libm::log(x));
        }
        for n in 1..10_000 {
            let x = 1.0 + 1e-12 * f64::from(n * n);
            assert!(ulps(ln(x), libm::log(x)) < 2.0, "{x}");
            let x = 1.0 - 1e-12 * f64::from(n * n);
            assert!(ulps(ln(x), libm::log(x)) < 2.0, "{x}");
        }
        assert_eq!(ln(1.0), 0.0);
    }

    #[test]
    fn exponentials_are_those_of_libm_to_two_last_places() {
        for n in 0..200_000 {
            let x = -700.0 + 0.007 * f64::from(n);
            assert!(ulps(exp(x), libm::exp(x)) < 2.0, "{x}: {} {}", exp(x), libm::exp(x));
            let x = -3.0 + 3e-5 * f64::from(n);
            assert!(ulps(exp(x), libm::exp(x)) < 2.0, "{x}");
            assert!(
                n == 100_000 || ulps(exp_m1(x), libm::expm1(x)) < 3.0,
                "{x}: {} {}",
                exp_m1(x),
                libm::expm1(x)
            );
        }
        for n in 1..300 {
            let x = libm::exp(-f64::from(n) / 3.0);
            assert!(ulps(exp_m1(x), libm::expm1(x)) < 3.0 && ulps(exp_m1(-x), libm::expm1(-x)) < 3.0, "{x}");
        }
        assert_eq!((exp(0.0), exp_m1(0.0)), (1.0, 0.0));
    }

    #[test]
    fn nearest_rounds_halves_to_even() {
        for (x, whole) in
            [(0.4, 0.0), (0.5, 0.0), (1.5, 2.0), (-0.6, -1.0), (-2.5, -2.0), (1e14 + 0.7, 1e14 + 1.0)]
        {
            assert_eq!(nearest(x), whole);
        }
    }

    #[test]
    fn ends_of_the_range_are_ordinary() {
        assert!(exp(-1e30) < 1e-300 && exp(f64::NEG_INFINITY) < 1e-300 && exp_m1(-1e30) == -1.0);
        assert!(exp(1e30) > 1e300 && exp(f64::NAN).is_nan());
        assert_eq!(ln(0.0), f64::NEG_INFINITY);
        assert!(ln(-1.0).is_nan() && ln(f64::NAN).is_nan() && ln(f64::INFINITY) == f64::INFINITY);
    }
}
