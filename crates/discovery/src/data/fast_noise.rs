//! The fast part of a signal.

/// Median of `values`, which are reordered.
pub fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Standard deviation of white noise in `values` from their second differences, robust against motion and against outliers.
#[must_use]
pub fn fast_noise(values: &[f64]) -> f64 {
    let mut differences: Vec<f64> = values.windows(3).map(|triple| (triple[0] - 2.0 * triple[1] + triple[2]).abs()).collect();
    // Second differences of white noise have six times its variance; the median of a normal deviate's size is 0.6745.
    median(&mut differences) / 0.6745 / 6.0_f64.sqrt()
}
