//! The numbers the sensor's equations are written over.
//!
//! An equation written once over [`Scalar`] can be evaluated with `f64` (simulate, solve) and with
//! [`Dual`] numbers (the same text then yields an exact derivative, which checks every hand-written one).
//!
//! Idea: forward-mode automatic differentiation. A dual number carries a value and its derivative along
//! one direction; nesting `Dual<Dual<f64>>` gives second derivatives.
//!
//! Limits: functions over `Scalar` must not branch on [`Scalar::value`], only use [`Scalar::min`] and
//! [`Scalar::max`]: lanes ([`crate::lanes`]), each of which would branch differently, are a `Scalar` too, and
//! their `value` is lane 0.

use crate::elementary;
use std::fmt::Debug;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// A real number the equations can be evaluated on.
///
/// Implementations must give the same bits on every machine: no fused multiply-add, no platform
/// transcendental functions.
pub trait Scalar:
    Copy
    + Debug
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// The constant `value`, with zero derivative where the type carries one.
    fn from_f64(value: f64) -> Self;
    /// The number without its derivative. For tests and messages, not for branches.
    fn value(self) -> f64;
    /// e to the power `self`.
    fn exp(self) -> Self;
    /// Natural logarithm; NaN below zero.
    fn ln(self) -> Self;
    /// `exp(self) - 1`, accurate near zero, where a settling factor of a short interval lives.
    fn exp_m1(self) -> Self;
    /// The smaller of both; `other` where they are equal or `self` is NaN.
    fn min(self, other: Self) -> Self;
    /// The larger of both; `other` where they are equal or `self` is NaN.
    fn max(self, other: Self) -> Self;
}

impl Scalar for f64 {
    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn value(self) -> f64 {
        self
    }

    #[inline(always)]
    fn exp(self) -> Self {
        elementary::exp(self)
    }

    #[inline(always)]
    fn ln(self) -> Self {
        elementary::ln(self)
    }

    #[inline(always)]
    fn exp_m1(self) -> Self {
        elementary::exp_m1(self)
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        if self < other { self } else { other }
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        if self > other { self } else { other }
    }
}

/// A value and its derivative along one direction.
///
/// ```
/// # use photocurrent_sensor::scalar::{Dual, Scalar};
/// let x = Dual::variable(2.0);
/// let y = x * x * x;
/// assert_eq!((y.primal, y.tangent), (8.0, 12.0)); // x^3 and 3 x^2
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual<S> {
    /// The value.
    pub primal: S,
    /// The derivative of the value along the direction.
    pub tangent: S,
}

impl<S: Scalar> Dual<S> {
    /// The variable to differentiate by, at `primal`: its derivative is one.
    pub fn variable(primal: S) -> Self {
        Dual { primal, tangent: S::from_f64(1.0) }
    }

    /// A quantity that does not depend on the variable.
    pub fn constant(primal: S) -> Self {
        Dual { primal, tangent: S::from_f64(0.0) }
    }
}

impl<S: Scalar> Add for Dual<S> {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Dual { primal: self.primal + other.primal, tangent: self.tangent + other.tangent }
    }
}

impl<S: Scalar> Sub for Dual<S> {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Dual { primal: self.primal - other.primal, tangent: self.tangent - other.tangent }
    }
}

impl<S: Scalar> Mul for Dual<S> {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Dual {
            primal: self.primal * other.primal,
            tangent: self.tangent * other.primal + self.primal * other.tangent,
        }
    }
}

impl<S: Scalar> Div for Dual<S> {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let quotient = self.primal / other.primal;
        // Not (a'b - ab') / b^2: the square underflows for the tiny time constants of an ideal front end.
        Dual { primal: quotient, tangent: (self.tangent - quotient * other.tangent) / other.primal }
    }
}

impl<S: Scalar> Neg for Dual<S> {
    type Output = Self;
    fn neg(self) -> Self {
        Dual { primal: -self.primal, tangent: -self.tangent }
    }
}

impl<S: Scalar> Scalar for Dual<S> {
    fn from_f64(value: f64) -> Self {
        Dual::constant(S::from_f64(value))
    }

    fn value(self) -> f64 {
        self.primal.value()
    }

    fn exp(self) -> Self {
        let primal = self.primal.exp();
        Dual { primal, tangent: primal * self.tangent }
    }

    fn ln(self) -> Self {
        Dual { primal: self.primal.ln(), tangent: self.tangent / self.primal }
    }

    fn exp_m1(self) -> Self {
        Dual { primal: self.primal.exp_m1(), tangent: self.primal.exp() * self.tangent }
    }

    // A dual number is one lane, so choosing by value is allowed here.
    fn min(self, other: Self) -> Self {
        if self.value() < other.value() { self } else { other }
    }

    fn max(self, other: Self) -> Self {
        if self.value() > other.value() { self } else { other }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A formula that uses every operation of the trait.
    fn mixture<S: Scalar>(x: S) -> S {
        let two = S::from_f64(2.0);
        ((x * x + two).ln() / (x.exp() - two)).max(x.exp_m1() * two).min(-x + S::from_f64(9.0))
    }

    #[test]
    fn dual_numbers_agree_with_central_differences() {
        for x in [-1.3, 0.2, 0.9, 1.7, 4.0] {
            let step = 1e-6;
            let expected = (mixture(x + step) - mixture(x - step)) / (2.0 * step);
            let got = mixture(Dual::variable(x)).tangent;
            // Central differences lose about 1e-10 to rounding and 1e-11 to the third derivative here.
            assert!(
                (got - expected).abs() < 1e-7 * expected.abs().max(1.0),
                "at {x}: {got} against {expected}"
            );
        }
    }

    #[test]
    fn nested_duals_give_the_second_derivative() {
        let x = Dual { primal: Dual::variable(0.5), tangent: Dual::constant(1.0) };
        let y = x.exp() * x;
        let expected = 2.5 * libm::exp(0.5); // (x e^x)'' = (x + 2) e^x
        assert!((y.tangent.tangent - expected).abs() < 1e-14);
    }

    #[test]
    fn constants_have_no_derivative() {
        assert_eq!(mixture(Dual::constant(0.7)).tangent, 0.0);
    }
}
