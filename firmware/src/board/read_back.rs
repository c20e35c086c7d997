//! What the outputs and the analogue supply really are, against what they should be.
//!
//! The chip's own reference voltage is measured against its factory calibration, which tells the supply: what is off by little is corrected
//! ([`super::supply`]), what is off by more is a fault. The drive's pin is measured, and the dump
//! valve's pin is read.
//!
//! The tick hands the readings here; what is found goes to the background, which raises it as a fault. A few readings in a row decide.

use model_export::link::fault::{Fault, FaultSet};

use super::converter::CONVERTER_FULL_SCALE;
use super::supply::SUPPLY_TOLERANCE_PER_MILLE;
use crate::drivers::ReadBack;

/// Largest difference of the drive's pin from what was put out, in codes: 2 % of full scale, for settling and the converter's errors.
pub const DRIVE_TOLERANCE_CODES: u16 = CONVERTER_FULL_SCALE / 50;
/// Supply at which the factory calibrates (DS8626 table 77).
const NOMINAL_MV: u32 = 3300;
/// Readings in a row that decide.
pub const READINGS: u8 = 10;
/// Codes of the reference voltage, 1.18 to 1.24 V, that a calibration at 3.3 V can have, with a margin (DS8626 table 76).
const CALIBRATIONS: core::ops::RangeInclusive<u16> = 1400..=1600;

/// What was put out when the readings were taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PutOut {
    /// The drive by voltage, out of 65535.
    pub share: u16,
    /// Whether the dump valve was closed.
    pub closes: bool,
}

/// The comparison so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadBackMonitor {
    calibration: Option<u16>,
    supply_mv: u16,
    supply: u8,
    drive: u8,
    dump: u8,
}

impl ReadBackMonitor {
    /// The factory's code, where it is plausible.
    pub fn calibration(&self) -> Option<u16> {
        self.calibration
    }

    /// With the factory's code of the reference voltage at 3.3 V; without a plausible one the supply is not judged.
    pub fn new(calibration: Option<u16>) -> Self {
        Self { calibration: calibration.filter(|code| CALIBRATIONS.contains(code)), supply_mv: 0, supply: 0, drive: 0, dump: 0 }
    }

    /// The analogue supply by the last reading of the reference voltage, mV; zero before there is one.
    pub fn supply_mv(&self) -> u16 {
        self.supply_mv
    }

    /// What is wrong after this tick's readings.
    ///
    /// # Deadline
    /// No loops.
    pub fn step(&mut self, read: &ReadBack, put_out: PutOut) -> FaultSet {
        if let (Some(code), Some(calibration)) = (read.reference_code, self.calibration) {
            // The supply is 3.3 V times calibration over code: off by as much as the two differ, and a code of zero is no supply at all.
            let difference = u32::from(code.abs_diff(calibration)) * 1000;
            let supply_mv = (NOMINAL_MV * u32::from(calibration)).checked_div(u32::from(code)).unwrap_or(0);
            self.supply_mv = u16::try_from(supply_mv).unwrap_or(u16::MAX);
            self.supply = count(self.supply, difference > u32::from(code) * SUPPLY_TOLERANCE_PER_MILLE);
        }
        if let Some(code) = read.drive_code {
            self.drive = count(self.drive, code.abs_diff(put_out.share >> 4) > DRIVE_TOLERANCE_CODES);
        }
        self.dump = count(self.dump, read.dump_is_high != put_out.closes);
        let mut faults = FaultSet::EMPTY;
        faults.insert_if(self.supply >= READINGS, Fault::ReferenceVoltage);
        faults.insert_if(self.drive >= READINGS || self.dump >= READINGS, Fault::OutputMismatch);
        faults
    }
}

/// The factory's two points of the chip's temperature sensor, taken at 3.3 V (DS8626 table 74): 30 and 110 degrees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChipThermometer {
    /// Code at 30 degrees.
    pub code_30: u16,
    /// Code at 110 degrees; another than that at 30.
    pub code_110: u16,
}

impl ChipThermometer {
    /// Two plausible points; `None` otherwise, as on a chip that is none.
    #[must_use]
    pub fn new(code_30: u16, code_110: u16) -> Option<Self> {
        // 0.76 V at 25 degrees and 2.5 mV a degree are 958 and 1206 codes (DS8626 table 73), with a wide margin.
        let plausible = (700..=1200).contains(&code_30) && (100..=400).contains(&code_110.saturating_sub(code_30));
        plausible.then_some(Self { code_30, code_110 })
    }

    /// The temperature of a code that was taken at this supply, in degrees Celsius; some 1.5 degrees true.
    #[must_use]
    pub fn celsius(&self, code: u16, supply_mv: u16) -> f32 {
        let at_nominal = f32::from(code) * f32::from(supply_mv) / 3300.0;
        30.0 + 80.0 * (at_nominal - f32::from(self.code_30)) / f32::from(self.code_110 - self.code_30)
    }
}

fn count(before: u8, is_wrong: bool) -> u8 {
    if is_wrong { before.saturating_add(1) } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CALIBRATION: u16 = 1500;

    /// Codes with this supply, drive and pin, and the ticks until something is found.
    fn found(supply_v: f64, put_out: PutOut, drive_code: u16, dump_is_high: bool) -> Option<(u32, Vec<Fault>)> {
        let mut monitor = ReadBackMonitor::new(Some(CALIBRATION));
        let reference_code = (f64::from(CALIBRATION) * 3.3 / supply_v).round() as u16;
        (1..1_000).find_map(|tick| {
            // One conversion a tick, in turn.
            let even = tick % 2 == 0;
            let read = ReadBack {
                reference_code: even.then_some(reference_code),
                drive_code: (!even).then_some(drive_code),
                chip_code: None,
                dump_is_high,
            };
            let faults = monitor.step(&read, put_out);
            (!faults.is_empty()).then(|| (tick, faults.iter().collect()))
        })
    }

    extern crate std;
    use std::vec::Vec;

    #[test]
    fn a_supply_beyond_ten_percent_is_found_within_20_ms_and_one_within_is_not() {
        let idle = PutOut::default();
        for supply_v in [2.5, 2.9, 2.95, 3.7, 3.9] {
            assert_eq!(found(supply_v, idle, 0, false), Some((20, [Fault::ReferenceVoltage].to_vec())), "{supply_v} V");
        }
        for supply_v in [3.02, 3.3, 3.6] {
            assert_eq!(found(supply_v, idle, 0, false), None, "{supply_v} V");
        }
    }

    #[test]
    fn a_drive_that_is_stuck_and_a_pin_that_does_not_obey_are_found_within_20_ms() {
        let running = PutOut { share: 0x8000, closes: true };
        assert_eq!(found(3.3, running, 0x800, true), None);
        assert_eq!(found(3.3, running, 0x800 + DRIVE_TOLERANCE_CODES, true), None);
        for stuck in [0, 0x7a0, 0x860, 4095] {
            assert_eq!(found(3.3, running, stuck, true), Some((19, [Fault::OutputMismatch].to_vec())), "{stuck}");
        }
        assert_eq!(found(3.3, running, 0x800, false), Some((10, [Fault::OutputMismatch].to_vec())));
        assert_eq!(found(3.3, PutOut::default(), 0, true), Some((10, [Fault::OutputMismatch].to_vec())));
    }

    #[test]
    fn without_a_plausible_calibration_the_supply_is_not_judged() {
        for calibration in [None, Some(0), Some(u16::MAX)] {
            let mut monitor = ReadBackMonitor::new(calibration);
            let read = ReadBack { reference_code: Some(1000), ..ReadBack::default() };
            assert!((0..100).all(|_| monitor.step(&read, PutOut::default()).is_empty()));
        }
    }
}
