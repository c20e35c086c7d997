//! What the outputs and the analogue supply really are, against what they should be.
//!
//! Converter and drive share their supply: where it is off, a wrong pressure reads as the right one, by the same factor. So the chip's own
//! reference voltage is measured against its factory calibration (DS8626 table 77), which tells the supply. The drive's pin is measured, and the
//! dump valve's pin is read.
//!
//! The tick hands the readings here; what is found goes to the background, which raises it as a fault. A few readings in a row decide.

use model_export::link::fault::{Fault, FaultSet};

use super::hardware::CONVERTER_FULL_SCALE;

/// Largest deviation of the analogue supply from the nominal, in parts per thousand: as large an error of every pressure.
pub const SUPPLY_TOLERANCE_PER_MILLE: u32 = 30;
/// Largest difference of the drive's pin from what was put out, in codes: 2 % of full scale, for settling and the converter's errors.
pub const DRIVE_TOLERANCE_CODES: u16 = CONVERTER_FULL_SCALE / 50;
/// Readings in a row that decide.
pub const READINGS: u8 = 10;
/// Codes of the reference voltage, 1.18 to 1.24 V, that a calibration at 3.3 V can have, with a margin (DS8626 table 76).
const CALIBRATIONS: core::ops::RangeInclusive<u16> = 1400..=1600;

/// What was read in a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReadBack {
    /// Code of the reference voltage, if it was converted.
    pub reference_code: Option<u16>,
    /// Code of the drive's pin, if it was converted.
    pub drive_code: Option<u16>,
    /// Whether the dump valve's pin is high.
    pub dump_is_high: bool,
}

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
    supply: u8,
    drive: u8,
    dump: u8,
}

impl ReadBackMonitor {
    /// With the factory's code of the reference voltage at 3.3 V; without a plausible one the supply is not judged.
    pub fn new(calibration: Option<u16>) -> Self {
        Self { calibration: calibration.filter(|code| CALIBRATIONS.contains(code)), supply: 0, drive: 0, dump: 0 }
    }

    /// What is wrong after this tick's readings.
    ///
    /// # Deadline
    /// No loops.
    pub fn step(&mut self, read: &ReadBack, put_out: PutOut) -> FaultSet {
        if let (Some(code), Some(calibration)) = (read.reference_code, self.calibration) {
            // The supply is 3.3 V times calibration over code: off by as much as the two differ, and a code of zero is no supply at all.
            let difference = u32::from(code.abs_diff(calibration)) * 1000;
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
            let read = ReadBack { reference_code: even.then_some(reference_code), drive_code: (!even).then_some(drive_code), dump_is_high };
            let faults = monitor.step(&read, put_out);
            (!faults.is_empty()).then(|| (tick, faults.iter().collect()))
        })
    }

    extern crate std;
    use std::vec::Vec;

    #[test]
    fn a_supply_beyond_three_percent_is_found_within_20_ms_and_one_within_is_not() {
        let idle = PutOut::default();
        for supply_v in [3.0, 3.1, 3.15, 3.45, 3.6] {
            assert_eq!(found(supply_v, idle, 0, false), Some((20, [Fault::ReferenceVoltage].to_vec())), "{supply_v} V");
        }
        for supply_v in [3.23, 3.3, 3.37] {
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
