//! Order statistics, and medians of distributions.

/// Degrees of freedom of the Student-t distribution of event misfits.
pub const NU: f64 = 3.0;
/// The median of its absolute value, in units of its scale.
pub const MEDIAN_T: f64 = 0.765;
/// The median of the absolute value of a standard normal distribution.
pub const MEDIAN_NORMAL: f64 = 0.6745;

/// The value below which a share of sorted values lies; 0 of none.
pub fn quantile<T: Copy + Default>(sorted: &[T], share: f64) -> T {
    let at = ((sorted.len() as f64 * share) as usize).min(sorted.len().saturating_sub(1));
    sorted.get(at).copied().unwrap_or_default()
}

/// The median; sorts.
pub fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    quantile(values, 0.5)
}
