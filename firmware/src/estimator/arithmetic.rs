//! The operations of [`model_export::fixed`] in plain Rust: each is one or a few instructions of the Cortex-M4.

use model_export::fixed::{SIGMOID, SIGMOID_STEP_BITS, TANH, TANH_STEP_BITS, Table};

/// The upper 32 bits.
#[inline]
pub fn high(value: i64) -> i32 {
    let [_, _, _, _, upper @ ..] = value.to_le_bytes();
    i32::from_le_bytes(upper)
}

/// `SMMULR`: the upper word of the product, rounded to nearest.
#[inline]
pub fn multiply_high_rounded(left: i32, right: i32) -> i32 {
    // |product| <= 2^62, so adding 2^31 cannot overflow.
    high((i64::from(left) * i64::from(right)).wrapping_add(1 << 31))
}

/// `SSAT`: clamps to a signed integer of `BITS` bits.
#[inline]
pub fn saturate<const BITS: u8>(value: i32) -> i32 {
    let limit = 1i32 << (BITS - 1);
    // Not `clamp`: it checks its bounds, and not every build sees that they are constants.
    value.max(-limit).min(limit - 1)
}

/// `SSAT` to 16 bits, as the narrow type.
#[inline]
pub fn saturate_16(value: i32) -> i16 {
    let [low, next, ..] = saturate::<16>(value).to_le_bytes();
    i16::from_le_bytes([low, next])
}

#[inline]
fn interpolate<const BITS: u8, const STEP_BITS: u8>(table: &Table, z: i32) -> i32 {
    let argument = saturate::<BITS>(z);
    let rest = argument & ((1 << STEP_BITS) - 1);
    let index = usize::try_from((argument >> STEP_BITS) + 256).unwrap_or(0);
    // Saturation keeps the index below the table's 512 segments.
    let [base, slope] = table.get(index).copied().unwrap_or_default();
    // `SMLAWB`: a 48-bit product without its lower 16 bits.
    base.wrapping_add(high((i64::from(slope) * i64::from(rest)) << 16))
}

/// Sigmoid of a pre-activation in Q15.16, in Q0.31.
#[inline]
#[must_use]
pub fn sigmoid(z: i32) -> i32 {
    interpolate::<21, SIGMOID_STEP_BITS>(&SIGMOID, z)
}

/// Hyperbolic tangent of a number in Q15.16, in Q1.30.
#[inline]
#[must_use]
pub fn tanh(z: i32) -> i32 {
    interpolate::<20, TANH_STEP_BITS>(&TANH, z)
}

/// A feature as Q1.14: times 2^14, saturated, rounded to nearest with ties to even. Not a number becomes the lower bound.
///
/// Adding 1.5 * 2^23 puts the integer into the low bits of the sum, so that no float-to-integer conversion is needed and every
/// machine with IEEE 754 addition gives the same bits.
#[inline]
#[must_use]
pub fn quantise_feature(feature: f32) -> i16 {
    const MAGIC: f32 = 12_582_912.0;
    let scaled = feature * 16_384.0;
    let scaled = if scaled > -32_768.0 { scaled } else { -32_768.0 };
    let scaled = if scaled < 32_767.0 { scaled } else { 32_767.0 };
    let integer = (scaled + MAGIC).to_bits().wrapping_sub(MAGIC.to_bits());
    let [low, next, ..] = integer.to_le_bytes();
    i16::from_le_bytes([low, next])
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use proptest::prelude::*;

    fn real(value: i32, fraction: i32) -> f64 {
        f64::from(value) * 2f64.powi(-fraction)
    }

    #[test]
    fn sigmoid_and_tanh_stay_within_the_bound_of_a_chord() {
        // step^2 / 16 times the largest second derivative: 0.0962 of the sigmoid, 0.7698 of the tanh.
        let (sigmoid_bound, tanh_bound) = (0.0962 / 4096.0, 0.7698 / 16_384.0);
        let (mut worst_sigmoid, mut worst_tanh) = (0.0f64, 0.0f64);
        for z in (-(1 << 21)..(1 << 21)).step_by(37) {
            let x = real(z, 16);
            worst_sigmoid = worst_sigmoid.max((real(sigmoid(z), 31) - 1.0 / (1.0 + (-x).exp())).abs());
            worst_tanh = worst_tanh.max((real(tanh(z), 30) - x.tanh()).abs());
        }
        assert!(worst_sigmoid < sigmoid_bound * 1.01 && worst_sigmoid > sigmoid_bound * 0.9, "{worst_sigmoid}");
        assert!(worst_tanh < tanh_bound * 1.01 && worst_tanh > tanh_bound * 0.9, "{worst_tanh}");
    }

    #[test]
    fn the_tables_never_fall_and_end_flat() {
        for table in [sigmoid as fn(i32) -> i32, tanh] {
            let mut last = i32::MIN;
            for z in (-(1 << 22)..(1 << 22)).step_by(101) {
                let value = table(z);
                assert!(value >= last, "falls at {z}");
                last = value;
            }
            assert_eq!(table(i32::MAX), table(1 << 21));
            assert_eq!(table(i32::MIN), table(-(1 << 21)));
        }
        assert_eq!((sigmoid(0), tanh(0)), (1 << 30, 0));
    }

    #[test]
    fn features_round_to_nearest_even_and_saturate() {
        let step = 1.0 / 16_384.0;
        for (feature, integer) in [
            (0.0, 0),
            (0.5 * step, 0),
            (1.5 * step, 2),
            (-0.5 * step, 0),
            (-1.5 * step, -2),
            (-2.5 * step, -2),
            (1.0, 16_384),
            (2.0, 32_767),
            (-2.0, -32_768),
            (1e9, 32_767),
            (-1e9, -32_768),
            (f32::INFINITY, 32_767),
            (f32::NEG_INFINITY, -32_768),
            (f32::NAN, -32_768),
        ] {
            assert_eq!(quantise_feature(feature), integer, "{feature}");
        }
    }

    proptest! {
        #[test]
        fn features_equal_the_exact_rounding(feature in -2.5f32..2.5) {
            let exact = (f64::from(feature) * 16_384.0).round_ties_even().clamp(-32_768.0, 32_767.0);
            prop_assert_eq!(f64::from(quantise_feature(feature)), exact);
        }

        #[test]
        fn the_rounded_high_word_is_that_of_wide_arithmetic(left: i32, right: i32) {
            let wide = (i128::from(left) * i128::from(right) + (1 << 31)) >> 32;
            prop_assert_eq!(i128::from(multiply_high_rounded(left, right)), wide);
        }
    }
}
