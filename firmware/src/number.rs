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
    convert(value, true)
}

/// The integer part, saturated; `None` for NaN.
pub fn truncate_to_i32(value: f32) -> Option<i32> {
    convert(value, false)
}

/// The nearest `f32`.
#[expect(clippy::cast_precision_loss, reason = "the nearest f32 is what is asked for")]
pub fn to_f32(value: i32) -> f32 {
    value as f32
}

/// An `f32` is `mantissa * 2^(exponent - 150)`; shifting the mantissa does the conversion in integers.
fn convert(value: f32, to_nearest: bool) -> Option<i32> {
    const MANTISSA_BITS: u32 = 23;
    const UNIT_EXPONENT: u32 = 127 + MANTISSA_BITS;
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
        let half = if to_nearest { 1u32.checked_shl(shift - 1).unwrap_or(0) } else { 0 };
        (mantissa.wrapping_add(half)).checked_shr(shift).unwrap_or(0)
    };
    // Below 2^31 by the branches above.
    let magnitude = i32::try_from(magnitude).unwrap_or(i32::MAX);
    Some(if negative { magnitude.wrapping_neg() } else { magnitude })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn edges_convert_as_documented() {
        let cases = [
            (0.0, 0, 0),
            (-0.0, 0, 0),
            (0.499_999_97, 0, 0),
            (0.5, 1, 0),
            (-0.5, -1, 0),
            (1.5, 2, 1),
            (-2.5, -3, -2),
            (8_388_607.5, 8_388_608, 8_388_607),
            (16_777_216.0, 16_777_216, 16_777_216),
            (2_147_483_520.0, 2_147_483_520, 2_147_483_520),
            (2_147_483_648.0, i32::MAX, i32::MAX),
            (-2_147_483_648.0, i32::MIN, i32::MIN),
            (f32::INFINITY, i32::MAX, i32::MAX),
            (f32::NEG_INFINITY, i32::MIN, i32::MIN),
            (f32::MIN_POSITIVE, 0, 0),
            (1e-45, 0, 0),
        ];
        for (value, rounded, truncated) in cases {
            assert_eq!(round_to_i32(value), Some(rounded), "{value} rounded");
            assert_eq!(truncate_to_i32(value), Some(truncated), "{value} truncated");
        }
        assert_eq!(round_to_i32(f32::NAN), None);
        assert_eq!(truncate_to_i32(-f32::NAN), None);
    }

    proptest! {
        #[test]
        fn every_bit_pattern_converts_like_the_saturating_cast(bits: u32) {
            let value = f32::from_bits(bits);
            prop_assume!(!value.is_nan());
            prop_assert_eq!(round_to_i32(value), Some(f64::from(value).round() as i32));
            prop_assert_eq!(truncate_to_i32(value), Some(value as i32));
        }
    }
}
