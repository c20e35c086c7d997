//! Calibration: raw codes to mm and bar, and which codes are measurements at all.
//!
//! Terms. A **code** is the sum of a channel's conversions in one tick. The map is the straight line through two points that the settings
//! give as voltage at the pin and physical value. Sensors signal their own faults inside the electrical range (3.75 mA on a 4-20 mA
//! loop, 5.5 V on a 0-5 V output), so codes outside two further voltages are no measurement.

use crate::number::{round_to_i32, to_f32};

/// Electrical facts of a board's converter, the same for both channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConverterConfig {
    /// Code at the reference voltage: full scale of one conversion times the number of conversions summed.
    pub full_scale_code: u16,
    /// Reference voltage.
    pub full_scale_v: f32,
}

/// A channel's calibration in volts and physical units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationConfig {
    /// Voltage of the first point.
    pub low_v: f32,
    /// Physical value of the first point.
    pub low_value: f32,
    /// Voltage of the second point, above the first.
    pub high_v: f32,
    /// Physical value of the second point, different from the first.
    pub high_value: f32,
    /// Lower voltages are no measurement.
    pub fault_below_v: f32,
    /// Higher voltages are no measurement.
    pub fault_above_v: f32,
}

/// The two points or the two limits of a calibration do not make a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotAMap;

/// A channel's calibration, ready to run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    offset: f32,
    gain_per_code: f32,
    lowest_code: u16,
    highest_code: u16,
}

impl CalibrationConfig {
    /// Builds the map for a converter.
    ///
    /// # Errors
    /// [`NotAMap`] if the points coincide, the limits cross, or anything is not finite.
    pub fn build(&self, converter: &ConverterConfig) -> Result<Calibration, NotAMap> {
        let codes_per_v = f32::from(converter.full_scale_code) / converter.full_scale_v;
        let gain_per_code = (self.high_value - self.low_value) / ((self.high_v - self.low_v) * codes_per_v);
        let offset = self.low_value - gain_per_code * (self.low_v * codes_per_v);
        let code = |v: f32| round_to_i32(v * codes_per_v).and_then(|code| u16::try_from(code).ok()).ok_or(NotAMap);
        let (lowest_code, highest_code) = (code(self.fault_below_v)?, code(self.fault_above_v)?);
        let ordered = self.low_v < self.high_v && lowest_code < highest_code && highest_code <= converter.full_scale_code;
        if ordered && offset.is_finite() && gain_per_code.is_finite() && gain_per_code != 0.0 {
            Ok(Calibration { offset, gain_per_code, lowest_code, highest_code })
        } else {
            Err(NotAMap)
        }
    }
}

impl Calibration {
    /// The physical value of a code.
    pub fn value(&self, code: u16) -> f32 {
        self.offset + self.gain_per_code * f32::from(code)
    }

    /// Whether a code is a measurement rather than a fault signal, a broken wire or a short.
    pub fn is_measurement(&self, code: u16) -> bool {
        (self.lowest_code..=self.highest_code).contains(&code)
    }

    /// The code nearest to a physical value, for simulated sensors; clipped to the 16-bit range.
    pub fn code(&self, value: f32) -> u16 {
        let code = round_to_i32((value - self.offset) / self.gain_per_code).unwrap_or(0).max(0).min(i32::from(u16::MAX));
        u16::try_from(code).unwrap_or(0)
    }

    /// The physical value of one code step.
    pub fn resolution(&self) -> f32 {
        if self.gain_per_code < 0.0 { -self.gain_per_code } else { self.gain_per_code }
    }

    /// From the lowest to the highest value that is a measurement.
    pub fn measured_range(&self) -> f32 {
        self.resolution() * f32::from(self.highest_code.saturating_sub(self.lowest_code))
    }

    /// Highest code of the converter that is still a measurement.
    pub fn highest_value(&self) -> f32 {
        self.offset + self.gain_per_code * to_f32(i32::from(self.highest_code))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONVERTER: ConverterConfig = ConverterConfig { full_scale_code: 8190, full_scale_v: 3.3 };
    const LASER: CalibrationConfig =
        CalibrationConfig { low_v: 0.6, low_value: 0.0, high_v: 3.0, high_value: 20.0, fault_below_v: 0.567, fault_above_v: 3.12 };

    fn code_of_current_ma(current_ma: f32) -> u16 {
        u16::try_from(round_to_i32(current_ma * 0.15 / 3.3 * 8190.0).unwrap()).unwrap()
    }

    #[test]
    fn the_two_points_map_to_their_values_within_half_a_code() {
        let calibration = LASER.build(&CONVERTER).unwrap();
        assert!((calibration.value(code_of_current_ma(4.0)) - 0.0).abs() <= 0.51 * calibration.resolution());
        assert!((calibration.value(code_of_current_ma(20.0)) - 20.0).abs() <= 0.51 * calibration.resolution());
        for code in (1500..7400).step_by(37) {
            assert_eq!(calibration.code(calibration.value(code)), code);
        }
    }

    #[test]
    fn the_sensors_own_fault_currents_are_no_measurement() {
        let calibration = LASER.build(&CONVERTER).unwrap();
        for current_ma in [0.0, 3.6, 3.75, 21.0, 21.9] {
            assert!(!calibration.is_measurement(code_of_current_ma(current_ma)), "{current_ma} mA");
        }
        for current_ma in [3.81, 4.0, 12.0, 20.0, 20.5] {
            assert!(calibration.is_measurement(code_of_current_ma(current_ma)), "{current_ma} mA");
        }
    }

    #[test]
    fn settings_that_make_no_map_are_refused() {
        let swapped = CalibrationConfig { low_v: 3.0, high_v: 0.6, ..LASER };
        let point = CalibrationConfig { high_value: 0.0, ..LASER };
        let crossed = CalibrationConfig { fault_below_v: 3.2, ..LASER };
        let not_finite = CalibrationConfig { high_value: f32::NAN, ..LASER };
        let beyond = CalibrationConfig { fault_above_v: 3.4, ..LASER };
        for config in [swapped, point, crossed, not_finite, beyond] {
            assert_eq!(config.build(&CONVERTER), Err(NotAMap), "{config:?}");
        }
    }
}
