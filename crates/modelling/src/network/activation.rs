//! Vectorisable activations: branch-free, the same bits on every machine, within 3e-7 of the exact functions.
//!
//! Products and sums are written apart (no fused multiply-add), because a machine without that instruction would have to emulate it.

/// `x` held between two bounds. The standard library's `clamp` checks its bounds and treats NaN apart, which keeps the compiler from
/// using vector registers.
#[inline(always)]
#[must_use]
pub fn bound(x: f32, low: f32, high: f32) -> f32 {
    let x = if x > low { x } else { low };
    if x < high { x } else { high }
}

/// Logistic function.
///
/// `1 / (1 + 2^t)` with `t = -x / ln 2`; `2^t` is split into a whole power, which goes straight into the exponent bits, and a
/// fraction in -1/2 to 1/2, which a polynomial covers to 8e-8 (Lawson-weighted least squares on Chebyshev nodes).
#[inline(always)]
#[must_use]
pub fn sigmoid(x: f32) -> f32 {
    // Adding 1.5 * 2^23 leaves the nearest integer in the low bits of the significand.
    const ROUND: f32 = 12_582_912.0;
    // Beyond +-125 the exponent would leave its field, and the result has long been 0 or 1 in f32.
    let t = bound(x * -std::f32::consts::LOG2_E, -125.0, 125.0);
    let shifted = t + ROUND;
    let f = t - (shifted - ROUND);
    let fraction = 1.0 + f * (0.693_146_94 + f * (0.240_221_2 + f * (0.055_507_13 + f * (0.009_675_541 + f * 0.001_327_647_1))));
    let power = f32::from_bits(fraction.to_bits().wrapping_add(shifted.to_bits() << 23));
    1.0 / (1.0 + power)
}

/// Hyperbolic tangent, `2 sigmoid(2x) - 1`; the error near zero is absolute, not relative.
#[inline(always)]
#[must_use]
pub fn tanh(x: f32) -> f32 {
    2.0 * sigmoid(2.0 * x) - 1.0
}

/// A cell activation as a type, so that the inner loops are compiled once for each.
pub trait CellActivation {
    /// The value at `x`; `limit` is the state limit.
    fn value(x: f32, limit: f32) -> f32;
    /// The derivative where the value is `a`.
    fn slope(a: f32, limit: f32) -> f32;
}

/// [`super::Activation::Tanh`].
pub struct Tanh;
/// [`super::Activation::Relu`].
pub struct Relu;
/// [`super::Activation::Hard`].
pub struct Hard;

impl CellActivation for Tanh {
    #[inline(always)]
    fn value(x: f32, _limit: f32) -> f32 {
        tanh(x)
    }
    #[inline(always)]
    fn slope(a: f32, _limit: f32) -> f32 {
        1.0 - a * a
    }
}

impl CellActivation for Relu {
    #[inline(always)]
    fn value(x: f32, limit: f32) -> f32 {
        bound(x, 0.0, limit)
    }
    #[inline(always)]
    fn slope(a: f32, limit: f32) -> f32 {
        if a > 0.0 && a < limit { 1.0 } else { 0.0 }
    }
}

impl CellActivation for Hard {
    #[inline(always)]
    fn value(x: f32, _limit: f32) -> f32 {
        bound(x, -1.0, 1.0)
    }
    #[inline(always)]
    fn slope(a: f32, _limit: f32) -> f32 {
        if a > -1.0 && a < 1.0 { 1.0 } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sigmoid_and_tanh_stay_within_3e_7_of_the_exact_functions() {
        for step in -400_000..=400_000 {
            let x = step as f32 * 1e-4;
            let exact = 1.0 / (1.0 + (-f64::from(x)).exp());
            assert!((f64::from(sigmoid(x)) - exact).abs() < 1.5e-7, "sigmoid({x})");
            assert!((f64::from(tanh(x)) - f64::from(x).tanh()).abs() < 3e-7, "tanh({x})");
        }
    }

    #[test]
    fn extreme_arguments_saturate_without_becoming_non_finite() {
        for x in [f32::MAX, 1e30, 200.0, 88.0] {
            assert!((sigmoid(x) - 1.0).abs() < 1e-7, "{x}");
            assert!(sigmoid(-x) < 1e-30, "{x}");
            assert!((tanh(x) - 1.0).abs() < 3e-7 && (tanh(-x) + 1.0).abs() < 3e-7, "{x}");
        }
    }
}
