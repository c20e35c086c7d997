//! Correction of readings and drive for an analogue supply that is not what it should be.
//!
//! Converter and drive measure in shares of the analogue supply: at 3.6 V a drive of 3.00 bar gives 3.27 bar, and these read as 3.00. The chip's
//! reference voltage does not follow the supply, so its code tells what the supply is (RM0090 section 13.10, DS8626 table 77):
//!
//! ```text
//! supply = 3.3 V calibration / code        code at 3.3 V = code as read * calibration / reference code
//! ```
//!
//! Codes are corrected before anybody sees them, the drive behind the limiter. What is in force moves only when the supply is off by more than
//! [`DEAD_BAND`]: otherwise the reference's noise would be in every code, and a sensor whose code stays the same would look alive.

use crate::drivers::RawSample;

/// One, as a ratio of the correction.
const ONE: u32 = 1 << 16;
/// Difference of the measured ratio from the one in force that puts it into force: a quarter of a percent.
pub const DEAD_BAND: u32 = ONE / 400;
/// A reading's part in the mean: an eighth, with one reading every 2 ms.
const MEAN_SHIFT: u32 = 3;
/// Largest deviation of the supply that is corrected, in parts per thousand; beyond it nothing is believed ([`super::read_back`]).
pub const SUPPLY_TOLERANCE_PER_MILLE: u32 = 100;
/// The converter's highest code, of two conversions: there is no measurement behind it, whatever the supply.
const SATURATED_CODE: u16 = 2 * 4095;

/// The correction so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SupplyCorrection {
    calibration: Option<u16>,
    /// Nominal supply over the supply, the mean of what was read; absent before the first reading.
    mean: Option<u32>,
    /// The same, as it is in force, and its inverse.
    in_force: u32,
    inverse: u32,
}

impl SupplyCorrection {
    /// With the factory's code of the reference voltage at 3.3 V; without a plausible one nothing is corrected.
    pub fn new(calibration: Option<u16>) -> Self {
        Self { calibration, mean: None, in_force: ONE, inverse: ONE }
    }

    /// Takes in a reading of the reference voltage.
    pub fn step(&mut self, reference_code: u16) {
        let Some(calibration) = self.calibration else { return };
        // Reference code over calibration is nominal supply over supply.
        let ratio = (u32::from(reference_code) << 16).checked_div(u32::from(calibration)).unwrap_or(ONE);
        // A supply farther off is a fault; until it is raised the correction stays within its bounds.
        let most = ONE / 1000 * SUPPLY_TOLERANCE_PER_MILLE * 5 / 4;
        let ratio = ratio.max(ONE - most).min(ONE + most);
        let mean = match self.mean {
            None => ratio,
            Some(mean) if ratio >= mean => mean + ((ratio - mean) >> MEAN_SHIFT),
            Some(mean) => mean - ((mean - ratio) >> MEAN_SHIFT),
        };
        self.mean = Some(mean);
        if mean.abs_diff(self.in_force) > DEAD_BAND {
            self.in_force = mean;
            // Rounded up, so that the inverse of one is one; the ratio is never zero.
            self.inverse = u32::MAX.checked_div(mean).unwrap_or(ONE) + 1;
        }
    }

    /// The sample as it would be at the nominal supply.
    pub fn sample(&self, read: RawSample) -> RawSample {
        RawSample { laser_code: self.code(read.laser_code), pressure_code: self.code(read.pressure_code) }
    }

    fn code(&self, read: u16) -> u16 {
        if read >= SATURATED_CODE { read } else { scaled(read, self.inverse) }
    }

    /// The drive by voltage that gives at this supply what `share` gives at the nominal one.
    pub fn drive(&self, share: u16) -> u16 {
        scaled(share, self.in_force)
    }
}

/// A number times a ratio, to the nearest; no more than 16 bits hold.
fn scaled(number: u16, ratio: u32) -> u16 {
    let product = u64::from(number) * u64::from(ratio) + u64::from(ONE / 2);
    u16::try_from(product >> 16).unwrap_or(u16::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CALIBRATION: u16 = 1500;

    fn reference_code(supply_v: f64) -> u16 {
        (f64::from(CALIBRATION) * 3.3 / supply_v).round() as u16
    }

    fn corrected(supply_v: f64, readings: u32) -> SupplyCorrection {
        let mut correction = SupplyCorrection::new(Some(CALIBRATION));
        (0..readings).for_each(|_| correction.step(reference_code(supply_v)));
        correction
    }

    #[test]
    fn what_is_read_and_put_out_is_right_within_half_a_percent_at_every_supply_that_is_let_pass() {
        for tenths in 30..=36 {
            let supply_v = f64::from(tenths) / 10.0;
            let correction = corrected(supply_v, 100);
            for voltage in [0.6, 1.2, 1.98, 2.9] {
                // Both channels: what the converter makes of a voltage, and the voltage that the drive makes of its share.
                let read = (voltage / supply_v * 8190.0).round() as u16;
                let sample = correction.sample(RawSample { laser_code: read, pressure_code: read });
                assert_eq!(sample.laser_code, sample.pressure_code);
                let seen_v = f64::from(sample.pressure_code) / 8190.0 * 3.3;
                let put_out_v = f64::from(correction.drive((voltage / 3.3 * 65535.0).round() as u16)) / 65535.0 * supply_v;
                assert!((seen_v / voltage - 1.0).abs() < 0.005, "{supply_v} V: {voltage} V reads as {seen_v}");
                assert!((put_out_v / voltage - 1.0).abs() < 0.005, "{supply_v} V: {voltage} V comes out as {put_out_v}");
            }
        }
    }

    #[test]
    fn at_the_nominal_supply_with_noise_no_code_changes() {
        let mut correction = SupplyCorrection::new(Some(CALIBRATION));
        for reading in 0..10_000u32 {
            correction.step(CALIBRATION - 3 + u16::try_from(reading.wrapping_mul(0x9e37_79b9) >> 29).unwrap().min(6));
            let read = RawSample { laser_code: 1234, pressure_code: 8189 };
            assert_eq!((correction.sample(read), correction.drive(40_000)), (read, 40_000), "{reading}");
        }
    }

    #[test]
    fn a_code_that_is_no_measurement_stays_one_and_without_a_calibration_nothing_is_corrected() {
        let none = RawSample { laser_code: SATURATED_CODE, ..RawSample::MISSING };
        assert_eq!(corrected(3.0, 100).sample(none), none);
        let mut correction = SupplyCorrection::new(None);
        correction.step(1000);
        assert_eq!(correction.drive(40_000), 40_000);
    }

    #[test]
    fn a_reference_that_reads_nonsense_moves_the_drive_by_no_more_than_the_tolerance() {
        for code in [0, 1, 4095, u16::MAX] {
            let mut correction = SupplyCorrection::new(Some(CALIBRATION));
            (0..1000).for_each(|_| correction.step(code));
            assert!((35_000..=45_001).contains(&correction.drive(40_000)), "{code}: {}", correction.drive(40_000));
        }
    }

    #[test]
    fn a_step_of_the_supply_is_corrected_to_one_percent_within_40_ms() {
        let mut correction = corrected(3.3, 100);
        let ready = (1..100).find(|_| {
            correction.step(reference_code(3.6));
            (f64::from(correction.drive(40_000)) * 3.6 / 3.3 / 40_000.0 - 1.0).abs() < 0.01
        });
        assert!(ready.is_some_and(|readings| 2 * readings <= 40), "{ready:?} readings of 2 ms");
    }
}
