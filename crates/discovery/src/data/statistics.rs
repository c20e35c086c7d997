//! Chances.

/// Upper tail of the normal distribution.
pub fn tail(deviations: f64) -> f64 {
    // Complementary error function, Abramowitz and Stegun 7.1.26 (absolute error below 1.5e-7).
    let x = deviations.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let poly = t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let upper = 0.5 * poly * (-x * x).exp();
    if deviations >= 0.0 { upper } else { 1.0 - upper }
}
