//! Chances.

/// Upper tail of the normal distribution.
pub fn tail(deviations: f64) -> f64 {
    0.5 * statrs::function::erf::erfc(deviations / std::f64::consts::SQRT_2)
}
