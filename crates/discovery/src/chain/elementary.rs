//! Elementary functions without branches, so that the compiler makes vectors of them where recordings are led side by side, with the same
//! bits on vectors of any width and on any system's library.

use std::f64::consts::{LN_2, LOG2_E, SQRT_2};

/// Adding this rounds to a whole number, which then lies in the lowest bits: `1.5 * 2^52`.
const WHOLE: f64 = 6_755_399_441_055_744.0;

/// `ln 2` in two parts, the first with so few bits that its multiples are exact (Cody and Waite 1980).
const LN_2_HIGH: f64 = 6.931_471_803_691_238e-1;

const LN_2_LOW: f64 = 1.908_214_929_270_587_7e-10;

/// The exponential function, to two units in the last place; beyond 700 it stands still.
#[inline(always)]
pub fn exp(x: f64) -> f64 {
    let x = x.clamp(-700.0, 700.0);
    let shifted = x * LOG2_E + WHOLE;
    let halvings = shifted - WHOLE;
    let r = (x - halvings * LN_2_HIGH) - halvings * LN_2_LOW;
    // Taylor's series to the thirteenth power: what follows is less than 1e-17 for |r| < 0.35. In pairs, for the sake of short chains.
    let (r2, r4) = (r * r, (r * r) * (r * r));
    let low = (1.0 + r) + r2 * (1.0 / 2.0 + r * (1.0 / 6.0));
    let middle = (1.0 / 24.0 + r * (1.0 / 120.0)) + r2 * (1.0 / 720.0 + r * (1.0 / 5_040.0));
    let high = (1.0 / 40_320.0 + r * (1.0 / 362_880.0)) + r2 * (1.0 / 3_628_800.0 + r * (1.0 / 39_916_800.0));
    let last = 1.0 / 479_001_600.0 + r * (1.0 / 6_227_020_800.0);
    let series = low + r4 * (middle + r4 * (high + r4 * last));
    series * f64::from_bits((shifted.to_bits() << 52).wrapping_add(1023 << 52))
}

/// The natural logarithm of a positive number that is not denormal, to a few units in the last place.
#[inline(always)]
pub fn ln(x: f64) -> f64 {
    // Mantissa between the root of one half and that of two, and the exponent with 2048 added to it.
    let above = x.to_bits().wrapping_sub((SQRT_2 * 0.5).to_bits()).wrapping_add(2048 << 52);
    let exponent = above >> 52;
    let mantissa = f64::from_bits(x.to_bits().wrapping_sub(exponent.wrapping_sub(2048) << 52));
    // The bits of a whole number below 2^52 behind those of 2^52.
    let doublings = f64::from_bits(0x4330_0000_0000_0000 | exponent) - (4_503_599_627_370_496.0 + 2048.0);
    let s = (mantissa - 1.0) / (mantissa + 1.0);
    // Twice the area tangent: |s| < 0.172, and what follows the twenty-first power is less than 1e-17.
    let (s2, s4) = (s * s, (s * s) * (s * s));
    let low = s2 * (1.0 / 3.0 + s2 * (1.0 / 5.0)) + s4 * s2 * (1.0 / 7.0 + s2 * (1.0 / 9.0));
    let high = (1.0 / 11.0 + s2 * (1.0 / 13.0)) + s4 * (1.0 / 15.0 + s2 * (1.0 / 17.0)) + s4 * s4 * (1.0 / 19.0 + s2 * (1.0 / 21.0));
    2.0 * s + 2.0 * s * (low + s4 * s4 * s2 * high) + doublings * LN_2
}

/// A power of a number that is not negative; that of zero is next to nothing.
#[inline(always)]
pub fn power(base: f64, exponent: f64) -> f64 {
    exp(exponent * ln(base.max(1e-300)))
}

#[cfg(test)]
mod tests {
    use crate::chain::elementary::{exp, ln, power};

    #[test]
    fn they_are_those_of_the_library() {
        for step in -4000..4000_i32 {
            let x = 0.017_3 * f64::from(step) + 1e-3 * f64::from(step).sin();
            assert!((exp(x) / x.exp() - 1.0).abs() < 1e-15, "exp {x}: {} and {}", exp(x), x.exp());
            let y = x.exp();
            assert!((ln(y) - y.ln()).abs() < 4e-16 * (1.0 + y.ln().abs()), "ln {y}: {} and {}", ln(y), y.ln());
        }
        for base in [1e-9, 0.003, 0.5, 0.999, 1.0, 1.7, 40.0] {
            for exponent in [-0.5_f64, 1.0 / 3.0, 0.7, 1.6] {
                let wanted = f64::powf(base, exponent);
                assert!((power(base, exponent) / wanted - 1.0).abs() < 8e-15, "{base} to the power of {exponent}");
            }
        }
        assert!(exp(-1e9) < 1e-300 && exp(1e9) > 1e300 && exp(0.0) == 1.0 && ln(1.0) == 0.0 && power(0.0, 0.4) < 1e-100);
    }
}
