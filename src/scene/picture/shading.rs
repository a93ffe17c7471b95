//! Static shading of the array: the exponential of a polynomial in the pixel's place, without its constant.

/// Coefficients: all monomials of x and y up to the fourth degree but the constant.
pub(crate) const TERMS: usize = 14;

/// The monomials at a place in units of half of the array's longer side.
#[inline]
pub(crate) fn basis(x: f64, y: f64) -> [f64; TERMS] {
    let (xx, yy, xy) = (x * x, y * y, x * y);
    [x, y, xx, xy, yy, xx * x, xx * y, x * yy, yy * y, xx * xx, xx * xy, xx * yy, xy * yy, yy * yy]
}

/// The factor that light at a place is multiplied with.
#[inline]
pub(crate) fn factor(terms: &[f64; TERMS], basis: &[f64; TERMS]) -> f64 {
    libm::exp(terms.iter().zip(basis).map(|(a, b)| a * b).sum())
}
