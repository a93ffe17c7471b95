//! Sixteen pixels side by side: a [`Scalar`] whose operations work on every lane, so that the equations
//! become vector instructions.
//!
//! Single precision, with exponential and logarithm of its own that have no branches. Lanes never mix, every
//! operation rounds as the scalar one does, and nothing is fused: a pixel's result does not depend on its
//! neighbours in the vector, on the vector's width in the machine, or on the machine.
//!
//! Source: range reduction and polynomials of the Cephes library (`expf`, `logf`). Limits: about two units in
//! the last place; the exponential is flat beyond -87 and 88, the logarithm takes normal positive numbers.

use crate::scalar::Scalar;

/// How many lanes.
pub const LANES: usize = 16;

/// One `f32` per lane.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(64))]
pub struct Lanes(pub [f32; LANES]);

impl Lanes {
    /// Zero in every lane.
    pub const ZERO: Lanes = Lanes([0.0; LANES]);

    /// `value` in every lane.
    #[inline(always)]
    pub fn splat(value: f32) -> Lanes {
        Lanes([value; LANES])
    }

    #[inline(always)]
    fn map(self, of: impl Fn(f32) -> f32) -> Lanes {
        let mut out = self;
        for lane in &mut out.0 {
            *lane = of(*lane);
        }
        out
    }

    #[inline(always)]
    fn zip(self, other: Lanes, of: impl Fn(f32, f32) -> f32) -> Lanes {
        let mut out = self;
        for (lane, other) in out.0.iter_mut().zip(other.0) {
            *lane = of(*lane, other);
        }
        out
    }

    /// `yes` where `self` is at least `limit`, `no` elsewhere and where either is NaN.
    #[inline(always)]
    pub fn at_least(self, limit: Lanes, yes: Lanes, no: Lanes) -> Lanes {
        let mut out = no;
        for n in 0..LANES {
            out.0[n] = if self.0[n] >= limit.0[n] { yes.0[n] } else { no.0[n] };
        }
        out
    }

    /// The magnitude of each lane.
    #[inline(always)]
    pub fn abs(self) -> Lanes {
        self.map(|x| f32::from_bits(x.to_bits() & 0x7FFF_FFFF))
    }
}

/// A power of two and the rest: x = k ln 2 + r with |r| < 0.35; gives (2^k, r).
#[inline(always)]
fn reduced(x: f32) -> (f32, f32) {
    /// Adding it rounds to a whole number, which then stands in the lowest bits.
    const ROUNDER: f32 = 12_582_912.0;
    const LN_2_HIGH: f32 = 0.693_359_4;
    const LN_2_LOW: f32 = -2.121_944_4e-4;
    let x = if x < -87.0 { -87.0 } else { x };
    let x = if x > 88.0 { 88.0 } else { x };
    let rounded = x * std::f32::consts::LOG2_E + ROUNDER;
    let k = rounded - ROUNDER;
    (f32::from_bits((rounded.to_bits() << 23).wrapping_add(127 << 23)), (x - k * LN_2_HIGH) - k * LN_2_LOW)
}

/// `exp(r) - 1` for |r| < 0.35.
#[inline(always)]
fn small_exp_m1(r: f32) -> f32 {
    let r2 = r * r;
    let high = (1.987_569_1e-4 * r + 1.398_2e-3) * r2 + (8.333_452e-3 * r + 4.166_579_6e-2);
    r + r2 * ((1.666_666_5e-1 * r + 0.5) + r2 * high)
}

#[inline(always)]
fn exp(x: f32) -> f32 {
    let (power, r) = reduced(x);
    power * (1.0 + small_exp_m1(r))
}

#[inline(always)]
fn exp_m1(x: f32) -> f32 {
    let (power, r) = reduced(x);
    power * small_exp_m1(r) + (power - 1.0)
}

#[inline(always)]
fn ln(x: f32) -> f32 {
    const SQRT_HALF: u32 = 0x3F35_04F3;
    const ONE: u32 = 0x3F80_0000;
    let shifted = x.to_bits().wrapping_add(ONE - SQRT_HALF);
    // The biased exponent as a number: below 2^23 the bits are the number.
    let k = f32::from_bits(0x4B00_0000 | (shifted >> 23)) - (8_388_608.0 + 127.0);
    let m = f32::from_bits((shifted & 0x007F_FFFF).wrapping_add(SQRT_HALF));
    let f = m - 1.0;
    let z = f * f;
    let low = (-2.499_999_4e-1 * f + 3.333_333e-1) + ((-1.666_805_8e-1 * f + 2.000_071_5e-1) * z);
    let high = (-1.242_014_1e-1 * f + 1.424_932_3e-1) + ((-1.151_461e-1 * f + 1.167_699_9e-1) * z);
    let tail = f * z * (low + z * z * (high + 7.037_683_6e-2 * (z * z)));
    let value = f + (tail - 2.121_944_4e-4 * k - 0.5 * z) + 0.693_359_4 * k;
    let value = if x == 0.0 { f32::NEG_INFINITY } else { value };
    if x >= 0.0 { value } else { f32::NAN }
}

/// Arithmetic of every lane by itself, for a type with `zip` and `map`.
macro_rules! lanewise {
    ($type:ty $(, const $width:ident: usize)?) => {
        crate::lanes::lanewise!($type, Add, add, + $(, const $width: usize)?);
        crate::lanes::lanewise!($type, Sub, sub, - $(, const $width: usize)?);
        crate::lanes::lanewise!($type, Mul, mul, * $(, const $width: usize)?);
        crate::lanes::lanewise!($type, Div, div, / $(, const $width: usize)?);

        impl$(<const $width: usize>)? std::ops::Neg for $type {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                self.map(|a| -a)
            }
        }
    };
    ($type:ty, $trait:ident, $method:ident, $operator:tt $(, const $width:ident: usize)?) => {
        impl$(<const $width: usize>)? std::ops::$trait for $type {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                self.zip(other, |a, b| a $operator b)
            }
        }
    };
}
pub(crate) use lanewise;

lanewise!(Lanes);

impl Scalar for Lanes {
    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        Lanes::splat(value as f32)
    }

    fn value(self) -> f64 {
        f64::from(self.0[0])
    }

    #[inline(always)]
    fn exp(self) -> Self {
        self.map(exp)
    }

    #[inline(always)]
    fn ln(self) -> Self {
        self.map(ln)
    }

    #[inline(always)]
    fn exp_m1(self) -> Self {
        self.map(exp_m1)
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.zip(other, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| if a > b { a } else { b })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::front_end::{FrontEnd, settle, settled_voltage, time_constant};

    fn ulps(got: f32, expected: f64) -> f64 {
        if f64::from(got) == expected {
            0.0
        } else {
            (f64::from(got) - expected).abs() / (expected.abs() * f64::from(f32::EPSILON))
        }
    }

    #[test]
    fn elementary_functions_are_those_of_double_precision_to_two_last_places() {
        for n in 0..100_000 {
            let x = -80.0 + 0.0016 * n as f32;
            assert!(ulps(exp(x), libm::exp(x.into())) < 2.0, "exp {x}");
            let x = 4e-5 * n as f32 - 2.0;
            assert!(n == 50_000 || ulps(exp_m1(x), libm::expm1(x.into())) < 3.0, "expm1 {x}");
            let x = libm::exp(-50.0 + 1e-3 * f64::from(n)) as f32;
            assert!(ulps(ln(x), libm::log(x.into())) < 2.0, "ln {x}: {} {}", ln(x), libm::log(x.into()));
            let x = 1e-7 + 2e-5 * n as f32;
            assert!(
                ulps(ln(x), libm::log(x.into())) < 2.0
                    || (f64::from(ln(x)) - libm::log(x.into())).abs() < 1e-7,
                "ln {x}"
            );
        }
        assert!(
            exp(-1e9) < 1e-37
                && exp(1e9) > 1e38
                && exp_m1(-1e9) == -1.0
                && exp_m1(0.0) == 0.0
                && ln(1.0) == 0.0
        );
        assert!(ln(0.0) == f32::NEG_INFINITY && ln(-1.0).is_nan());
    }

    #[test]
    fn the_equations_give_every_lane_what_they_give_a_number() {
        let front_end = FrontEnd { tau_0_s: 30e-6, alpha_s: 1e-4 };
        let photocurrent = std::array::from_fn(|n| 0.05 + 0.4 * n as f32);
        let lit = Lanes(photocurrent);
        let lanes = settle(
            Lanes::splat(-1.0),
            settled_voltage(lit),
            Lanes::splat(3e-4),
            time_constant(&front_end.lift(), lit),
        );
        for (n, i) in photocurrent.into_iter().map(f64::from).enumerate() {
            let expected = settle(-1.0, settled_voltage(i), 3e-4, time_constant(&front_end, i));
            assert!((f64::from(lanes.0[n]) - expected).abs() < 1e-6, "{n}");
        }
    }

    #[test]
    fn choices_are_made_lane_by_lane() {
        let x = Lanes(std::array::from_fn(|n| n as f32 - 8.0));
        assert_eq!(x.at_least(Lanes::ZERO, x, -x), x.abs());
        let nan = Lanes::splat(f32::NAN);
        assert_eq!(nan.at_least(Lanes::ZERO, nan, Lanes::ZERO), Lanes::ZERO);
    }
}
