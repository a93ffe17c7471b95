//! Eight pixels side by side in double precision, or one alone: a [`Scalar`] whose operations work on every
//! lane, so that a recursion that waits for its own results becomes vector instructions.
//!
//! Lanes never mix, every operation rounds as that of `f64` does, and nothing is fused: a lane holds the bits
//! that the same text gives for `f64`, whatever the other lanes hold and however wide the machine's vectors
//! are. [`crate::lanes`] is the same in single precision.

use crate::elementary;
use crate::scalar::Scalar;

/// How many lanes pixels side by side have.
pub(crate) const WIDTH: usize = 8;

/// One `f64` per lane.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub(crate) struct Wide<const W: usize>(pub [f64; W]);

/// What lanes do, as bits of a number per lane: as wide as a number of [`Wide`], so that comparisons become
/// vector instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub(crate) struct Flags<const W: usize>(pub [u64; W]);

impl<const W: usize> Flags<W> {
    /// `yes` where any of these bits is set, `no` elsewhere.
    #[inline(always)]
    pub(crate) fn choose(self, bits: u64, yes: Wide<W>, no: Wide<W>) -> Wide<W> {
        self.any(Flags([bits; W]), yes, no)
    }

    /// The same with bits for each lane.
    #[inline(always)]
    pub(crate) fn any(self, bits: Flags<W>, yes: Wide<W>, no: Wide<W>) -> Wide<W> {
        let mut out = no;
        for n in 0..W {
            out.0[n] = if self.0[n] & bits.0[n] != 0 { yes.0[n] } else { no.0[n] };
        }
        out
    }
}

impl<const W: usize> Wide<W> {
    /// Zero in every lane.
    pub(crate) const ZERO: Wide<W> = Wide([0.0; W]);
    /// One in every lane.
    pub(crate) const ONE: Wide<W> = Wide([1.0; W]);

    /// `value` in every lane.
    #[inline(always)]
    pub(crate) const fn splat(value: f64) -> Wide<W> {
        Wide([value; W])
    }

    #[inline(always)]
    fn map(self, of: impl Fn(f64) -> f64) -> Wide<W> {
        let mut out = self;
        for lane in &mut out.0 {
            *lane = of(*lane);
        }
        out
    }

    #[inline(always)]
    fn zip(self, other: Wide<W>, of: impl Fn(f64, f64) -> f64) -> Wide<W> {
        let mut out = self;
        for n in 0..W {
            out.0[n] = of(self.0[n], other.0[n]);
        }
        out
    }

    /// `yes` where `self` equals `value`, `no` elsewhere.
    #[inline(always)]
    pub(crate) fn equal(self, value: f64, yes: Wide<W>, no: Wide<W>) -> Wide<W> {
        let mut out = no;
        for n in 0..W {
            out.0[n] = if self.0[n] == value { yes.0[n] } else { no.0[n] };
        }
        out
    }

    /// `yes` where `self` is above `limit`, `no` elsewhere and where either is NaN.
    #[inline(always)]
    pub(crate) fn above(self, limit: Wide<W>, yes: Wide<W>, no: Wide<W>) -> Wide<W> {
        let mut out = no;
        for n in 0..W {
            out.0[n] = if self.0[n] > limit.0[n] { yes.0[n] } else { no.0[n] };
        }
        out
    }

    /// The magnitude of each lane.
    #[inline(always)]
    pub(crate) fn abs(self) -> Wide<W> {
        self.map(|x| f64::from_bits(x.to_bits() & 0x7FFF_FFFF_FFFF_FFFF))
    }

    /// Exponent and mantissa, 1 to 2, of normal positive numbers: each lane is two to the power of the first
    /// times the second.
    #[inline(always)]
    pub(crate) fn parts(self) -> (Wide<W>, Wide<W>) {
        // The biased exponent as a number: below 2^52 the bits are the number.
        let exponent = self.map(|x| {
            f64::from_bits(0x4330_0000_0000_0000 | (x.to_bits() >> 52)) - (4_503_599_627_370_496.0 + 1023.0)
        });
        (
            exponent,
            self.map(|x| f64::from_bits((x.to_bits() & 0x000F_FFFF_FFFF_FFFF) | 0x3FF0_0000_0000_0000)),
        )
    }

    /// The square root of each lane.
    #[inline(always)]
    pub(crate) fn sqrt(self) -> Wide<W> {
        self.map(f64::sqrt)
    }
}

impl<const W: usize> Default for Wide<W> {
    fn default() -> Self {
        Wide::ZERO
    }
}

impl<const W: usize> Default for Flags<W> {
    fn default() -> Self {
        Flags([0; W])
    }
}

crate::lanes::lanewise!(Wide<W>, const W: usize);

impl<const W: usize> Scalar for Wide<W> {
    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        Wide::splat(value)
    }

    fn value(self) -> f64 {
        self.0[0]
    }

    #[inline(always)]
    fn exp(self) -> Self {
        self.map(elementary::exp)
    }

    #[inline(always)]
    fn ln(self) -> Self {
        self.map(elementary::ln)
    }

    #[inline(always)]
    fn exp_m1(self) -> Self {
        self.map(elementary::exp_m1)
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

    #[test]
    fn every_lane_has_the_bits_of_a_number_alone() {
        let front_end = FrontEnd { tau_0_s: 30e-6, alpha_s: 1e-4 };
        let photocurrent: [f64; WIDTH] = std::array::from_fn(|n| 0.05 + 0.4 * n as f64);
        let voltage = Wide(std::array::from_fn(|n| -1.0 / (n as f64 + 3.0)));
        let lit = Wide(photocurrent);
        let wide =
            settle(voltage, settled_voltage(lit), Wide::splat(3e-4), time_constant(&front_end.lift(), lit));
        for n in 0..WIDTH {
            let i = photocurrent[n];
            assert_eq!(
                wide.0[n],
                settle(voltage.0[n], settled_voltage(i), 3e-4, time_constant(&front_end, i))
            );
        }
    }

    #[test]
    fn parts_make_the_number() {
        let (exponent, mantissa) = Wide::<WIDTH>([1.0, 0.75, 10.0, 1e300, 1e-300, 2.0, 3.5, 0.1]).parts();
        assert_eq!((exponent.0[1], mantissa.0[1]), (-1.0, 1.5));
        assert_eq!((exponent.0[2], mantissa.0[2]), (3.0, 1.25));
        for (n, x) in [1.0, 0.75, 10.0, 1e300, 1e-300, 2.0, 3.5, 0.1].into_iter().enumerate() {
            assert_eq!(mantissa.0[n] * libm::exp2(exponent.0[n]), x);
        }
    }

    #[test]
    fn choices_are_made_lane_by_lane() {
        let x = Wide(std::array::from_fn(|n| n as f64 - 4.0));
        assert_eq!(x.above(Wide::ZERO, x, -x), x.abs());
        assert_eq!(x.equal(2.0, Wide::ONE, Wide::ZERO).0, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        let flags = Flags(std::array::from_fn(|n| n as u64));
        assert_eq!(flags.choose(4, Wide::ONE, Wide::ZERO).0, [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]);
        assert_eq!(
            flags.any(Flags([0, 0, 0, 0, 0, 0, 0, 2]), Wide::ONE, Wide::ZERO).0,
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        );
        let nan = Wide::<WIDTH>::splat(f64::NAN);
        assert_eq!(nan.above(Wide::ZERO, nan, Wide::ZERO), Wide::ZERO);
        assert_eq!((x * x).sqrt(), x.abs());
    }
}
