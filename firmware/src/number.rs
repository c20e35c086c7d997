//! Numbers that cross between `f32` and integers, with what happens at the edges spelled out.
//!
//! The `as` operator turns NaN into zero and clips without a word, so nothing here or elsewhere in the firmware uses it for that.

/// Pressure as the limiter and the valve see it: whole microbars, so that limits hold exactly and no rounding creeps through them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MicroBar(pub i32);

impl MicroBar {
    /// No pressure.
    pub const ZERO: Self = Self(0);

    /// From bar, rounded and saturated; `None` for NaN.
    pub fn from_bar(bar: f32) -> Option<Self> {
        round_to_i32(bar * 1e6).map(Self)
    }

    /// In bar, exact below 16 bar.
    pub fn bar(self) -> f32 {
        to_f32(self.0) / 1e6
    }
}

/// The nearest integer, ties away from zero, saturated; `None` for NaN.
pub fn round_to_i32(value: f32) -> Option<i32> {
    // An `f32` is `mantissa * 2^(exponent - 150)`; shifting the mantissa does the conversion in integers.
    if value.is_nan() {
        return None;
    }
    let bits = value.to_bits();
    let negative = value.is_sign_negative();
    let exponent = (bits >> MANTISSA_BITS) & 0xff;
    let mantissa = (bits & ((1 << MANTISSA_BITS) - 1)) | (1 << MANTISSA_BITS);
    let magnitude = if exponent >= UNIT_EXPONENT + 8 {
        return Some(if negative { i32::MIN } else { i32::MAX });
    } else if exponent >= UNIT_EXPONENT {
        mantissa << (exponent - UNIT_EXPONENT)
    } else {
        let shift = UNIT_EXPONENT - exponent;
        let half = 1u32.checked_shl(shift - 1).unwrap_or(0);
        (mantissa.wrapping_add(half)).checked_shr(shift).unwrap_or(0)
    };
    // Below 2^31 by the branches above.
    let magnitude = i32::try_from(magnitude).unwrap_or(i32::MAX);
    Some(if negative { magnitude.wrapping_neg() } else { magnitude })
}

/// The integer part of `value * factor`, exactly: no rounding of the product; saturated. `None` for NaN and negative values.
pub fn scaled_to_i32(value: f32, factor: u32) -> Option<i32> {
    let bits = value.to_bits();
    let exponent = bits >> MANTISSA_BITS;
    if value.is_nan() || (value.is_sign_negative() && value != 0.0) {
        return None;
    }
    // Numbers too small for the implicit bit count as zero: times any factor they stay below one.
    let mantissa = if exponent & 0xff == 0 { 0 } else { (bits & ((1 << MANTISSA_BITS) - 1)) | (1 << MANTISSA_BITS) };
    let product = u64::from(mantissa) * u64::from(factor);
    let magnitude = match UNIT_EXPONENT.checked_sub(exponent & 0xff) {
        Some(shift) => product.checked_shr(shift).unwrap_or(0),
        // 2^24 and more, times a factor that is at least a thousand wherever this is used: beyond 2^31.
        None => u64::MAX,
    };
    Some(i32::try_from(magnitude).unwrap_or(i32::MAX))
}

/// The nearest `f32`.
#[expect(clippy::cast_precision_loss, reason = "the nearest f32 is what is asked for")]
pub fn to_f32(value: i32) -> f32 {
    value as f32
}

const MANTISSA_BITS: u32 = 23;
/// Biased exponent at which the mantissa counts ones.
const UNIT_EXPONENT: u32 = 127 + MANTISSA_BITS;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn edges_convert_as_documented() {
        let cases = [
            (0.0, 0),
            (-0.0, 0),
            (0.499_999_97, 0),
            (0.5, 1),
            (-0.5, -1),
            (1.5, 2),
            (-2.5, -3),
            (8_388_607.5, 8_388_608),
            (16_777_216.0, 16_777_216),
            (2_147_483_520.0, 2_147_483_520),
            (2_147_483_648.0, i32::MAX),
            (-2_147_483_648.0, i32::MIN),
            (f32::INFINITY, i32::MAX),
            (f32::NEG_INFINITY, i32::MIN),
            (f32::MIN_POSITIVE, 0),
            (1e-45, 0),
        ];
        for (value, rounded) in cases {
            assert_eq!(round_to_i32(value), Some(rounded), "{value} rounded");
        }
        assert_eq!(round_to_i32(f32::NAN), None);
    }

    proptest! {
        #[test]
        fn a_scaled_number_is_the_floor_of_the_exact_product(bits: u32, factor in 1_000u32..=1_000_000) {
            let value = f32::from_bits(bits);
            let exact = f64::from(value) * f64::from(factor);
            // 24 and 20 bits: the product is exact in `f64`.
            let floor = exact.floor();
            let expected = (exact >= 0.0).then_some(floor as i32);
            prop_assert_eq!(scaled_to_i32(value, factor), expected, "{} times {}", value, factor);
        }

        #[test]
        fn every_bit_pattern_converts_like_the_saturating_cast(bits: u32) {
            let value = f32::from_bits(bits);
            prop_assume!(!value.is_nan());
            prop_assert_eq!(round_to_i32(value), Some(f64::from(value).round() as i32));
        }
    }
}
