//! The simulated hardware around the processor: valve, dump valve, muscle, sensors with their converter, and ways to break each.
//!
//! ```text
//! valve share ─► regulator (first order, at most the supply) ─► pressure ─► muscle ─► tip ─► laser 4-20 mA ─► code
//! dump valve released ─► pressure falls to zero                    └─► pressure sensor 4-20 mA ─► code
//! ```
//!
//! One step is one tick of 1 ms. Electrical values are those of the board: 150 ohm, 3.3 V, two conversions of 12 bits summed.

use firmware::device::exchange::DeviceOutputs;
use firmware::seam::RawSample;

use crate::plant::RunningPlant;

/// A step in s.
const STEP_S: f64 = 0.001;
/// Sum of two conversions of 12 bits at the reference voltage.
const FULL_SCALE_CODE: f64 = 8190.0;
const REFERENCE_V: f64 = 3.3;
const SHUNT_OHM: f64 = 150.0;
/// What sensors give instead of a measurement (NAMUR NE 43; 3.75 mA is the laser's fault code).
const FAULT_MA: f64 = 3.75;
const LOWEST_MA: f64 = 3.8;
const HIGHEST_MA: f64 = 20.5;

/// What moves the tip.
pub trait Muscle {
    /// Displacement in mm after another 1 ms at this pressure in bar.
    fn step(&mut self, pressure_bar: f64) -> f64;
}

impl Muscle for RunningPlant {
    fn step(&mut self, pressure_bar: f64) -> f64 {
        RunningPlant::step(self, pressure_bar, STEP_S)
    }
}

/// Numbers of the hardware.
#[derive(Clone, Debug, PartialEq)]
pub struct HardwareConfig {
    /// Supply regulator, bar; the wiring instructions ask to set it to the ceiling, so that a valve stuck open cannot exceed it.
    pub supply_bar: f64,
    /// Pressure that the valve gives at full drive, bar.
    pub valve_full_scale_bar: f64,
    /// Time constant of the regulator with its tube, ms.
    pub regulator_ms: f64,
    /// Time constant of the dump valve's exhaust, ms.
    pub dump_ms: f64,
    /// The tip's inertia as a time constant, ms: it cannot jump even if the muscle bursts.
    pub tip_ms: f64,
    /// Pressure at 20 mA, bar.
    pub pressure_range_bar: f64,
    /// Displacement at 20 mA, mm.
    pub laser_range_mm: f64,
    /// Seed of the sensors' noise of plus or minus two codes.
    pub seed: u32,
}

impl Default for HardwareConfig {
    fn default() -> Self {
        Self {
            supply_bar: 3.0,
            valve_full_scale_bar: 5.0,
            regulator_ms: 15.0,
            dump_ms: 40.0,
            tip_ms: 10.0,
            pressure_range_bar: 6.0,
            laser_range_mm: 20.0,
            seed: 1,
        }
    }
}

/// What is broken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Breakage {
    /// The laser's channel reads this code.
    LaserCode(u16),
    /// The laser's channel keeps the code it had.
    LaserFrozen,
    /// The laser jumps by this, mm.
    LaserOffsetMm(f64),
    /// The same, with noise of 2 codes.
    LaserFrozenWithNoise,
    /// The pressure channel reads this code.
    PressureCode(u16),
    /// The pressure channel keeps the code it had.
    PressureFrozen,
    /// The same, with noise of 2 codes.
    PressureFrozenWithNoise,
    /// The pressure reading jumps by this, bar.
    PressureOffsetBar(f64),
    /// The emergency stop is pressed.
    EmergencyStop,
    /// Every tick takes too long.
    EveryTickLate,
    /// This many ticks are lost before each one.
    TicksLost(u16),
    /// The muscle bursts.
    MuscleBursts,
    /// The supply fails.
    SupplyFails,
    /// The valve sticks fully open.
    ValveFullyOpen,
    /// The dump valve sticks closed.
    DumpValveStuckClosed,
}

/// The hardware, advanced by one tick a step.
pub struct Hardware {
    config: HardwareConfig,
    muscle: Box<dyn Muscle>,
    pressure_bar: f64,
    peak_bar: f64,
    displacement_mm: f64,
    noise: u32,
    energised: bool,
    drive_bar: f64,
    frozen: Option<RawSample>,
    breakage: Option<Breakage>,
}

impl Hardware {
    /// Vented hardware at rest around a muscle.
    #[must_use]
    pub fn new(config: HardwareConfig, mut muscle: Box<dyn Muscle>) -> Self {
        let displacement_mm = muscle.step(0.0);
        let noise = config.seed;
        Self {
            config,
            muscle,
            pressure_bar: 0.0,
            peak_bar: 0.0,
            displacement_mm,
            noise,
            energised: false,
            drive_bar: 0.0,
            frozen: None,
            breakage: None,
        }
    }

    /// Breaks something from now on; `None` mends it.
    pub fn set_breakage(&mut self, breakage: Option<Breakage>) {
        self.breakage = breakage;
        self.frozen = None;
    }

    /// Puts another muscle in, at rest; only sensible while vented.
    pub fn set_muscle(&mut self, muscle: Box<dyn Muscle>) {
        self.muscle = muscle;
    }

    /// What is broken.
    #[must_use]
    pub fn breakage(&self) -> Option<Breakage> {
        self.breakage
    }

    /// The true pressure, bar.
    #[must_use]
    pub fn pressure_bar(&self) -> f64 {
        self.pressure_bar
    }

    /// The highest pressure so far, bar.
    #[must_use]
    pub fn peak_bar(&self) -> f64 {
        self.peak_bar
    }

    /// The tip's true displacement, mm.
    #[must_use]
    pub fn displacement_mm(&self) -> f64 {
        self.displacement_mm
    }

    /// Whether the dump valve is energised, so that there can be pressure.
    #[must_use]
    pub fn is_energised(&self) -> bool {
        self.energised
    }

    /// What the converter reads now.
    pub fn sample(&mut self) -> RawSample {
        let (mut laser_mm, mut pressure_bar) = (self.displacement_mm, self.pressure_bar);
        match self.breakage {
            Some(Breakage::LaserOffsetMm(offset)) => laser_mm += offset,
            Some(Breakage::PressureOffsetBar(offset)) => pressure_bar += offset,
            _ => {}
        }
        let mut sample = RawSample {
            laser_code: self.code(laser_mm / self.config.laser_range_mm),
            pressure_code: self.code(pressure_bar / self.config.pressure_range_bar),
        };
        match self.breakage {
            Some(Breakage::LaserCode(code)) => sample.laser_code = code,
            Some(Breakage::PressureCode(code)) => sample.pressure_code = code,
            Some(Breakage::LaserFrozen) => sample.laser_code = self.frozen.get_or_insert(sample).laser_code,
            Some(Breakage::LaserFrozenWithNoise) => {
                let code = self.frozen.get_or_insert(sample).laser_code;
                sample.laser_code = (f64::from(code) + self.noise()).clamp(0.0, FULL_SCALE_CODE) as u16;
            }
            Some(Breakage::PressureFrozenWithNoise) => {
                let code = self.frozen.get_or_insert(sample).pressure_code;
                sample.pressure_code = (f64::from(code) + self.noise()).clamp(0.0, FULL_SCALE_CODE) as u16;
            }
            Some(Breakage::PressureFrozen) => sample.pressure_code = self.frozen.get_or_insert(sample).pressure_code,
            _ => {}
        }
        sample
    }

    /// Applies a tick's outputs.
    pub fn apply(&mut self, outputs: &DeviceOutputs) {
        self.energised = outputs.energised;
        self.drive_bar = f64::from(outputs.valve_share) / f64::from(u16::MAX) * self.config.valve_full_scale_bar;
    }

    /// What pins do while the processor is in reset: nothing is driven.
    pub fn release_pins(&mut self) {
        self.energised = false;
        self.drive_bar = 0.0;
    }

    /// Lets one tick pass.
    pub fn advance(&mut self) {
        let dump_open = !self.energised && self.breakage != Some(Breakage::DumpValveStuckClosed);
        let regulator_ms = self.config.regulator_ms;
        let (target_bar, time_constant_ms) = match self.breakage {
            Some(Breakage::MuscleBursts) => (0.0, 0.8 * regulator_ms),
            _ if dump_open => (0.0, self.config.dump_ms),
            Some(Breakage::ValveFullyOpen) => (self.config.supply_bar, regulator_ms),
            Some(Breakage::SupplyFails) => (0.0, regulator_ms),
            // A regulator that holds its pressure when asked for zero: why there is a dump valve.
            _ if !self.energised => (self.pressure_bar, regulator_ms),
            _ => (self.drive_bar.min(self.config.supply_bar), regulator_ms),
        };
        self.pressure_bar += (target_bar - self.pressure_bar) / time_constant_ms;
        self.peak_bar = self.peak_bar.max(self.pressure_bar);
        let muscle_mm = self.muscle.step(self.pressure_bar);
        self.displacement_mm += (muscle_mm - self.displacement_mm) / self.config.tip_ms;
    }

    /// The code of a quantity as share of its range, with noise.
    fn code(&mut self, share: f64) -> u16 {
        let current_ma = 4.0 + 16.0 * share;
        let measured_ma = if (LOWEST_MA..=HIGHEST_MA).contains(&current_ma) { current_ma } else { FAULT_MA };
        let code = (measured_ma * 1e-3 * SHUNT_OHM / REFERENCE_V * FULL_SCALE_CODE).round();
        (code + self.noise()).clamp(0.0, FULL_SCALE_CODE) as u16
    }

    /// Between -2 and 2 codes: half a step of a 12-bit converter's noise, summed over two conversions.
    fn noise(&mut self) -> f64 {
        self.noise = self.noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from((self.noise >> 16) % 5) - 2.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::{Plant, PlantConfig};

    fn hardware() -> Hardware {
        let plant = Plant::new(PlantConfig::default()).unwrap();
        Hardware::new(HardwareConfig::default(), Box::new(plant.start(0.0)))
    }

    fn energised(share: u16) -> DeviceOutputs {
        DeviceOutputs { energised: true, valve_share: share, ..DeviceOutputs::default() }
    }

    #[test]
    fn pressure_follows_the_valve_up_to_the_supply_and_falls_when_the_pins_are_released() {
        let mut hardware = hardware();
        hardware.apply(&energised(u16::MAX / 5));
        (0..200).for_each(|_| hardware.advance());
        assert!((hardware.pressure_bar() - 1.0).abs() < 1e-3, "{}", hardware.pressure_bar());
        hardware.apply(&energised(u16::MAX));
        (0..200).for_each(|_| hardware.advance());
        assert!((hardware.pressure_bar() - 3.0).abs() < 1e-3, "{}", hardware.pressure_bar());
        hardware.release_pins();
        (0..200).for_each(|_| hardware.advance());
        assert!(hardware.pressure_bar() < 0.03, "{}", hardware.pressure_bar());
    }

    #[test]
    fn the_sensors_read_what_the_firmware_expects_within_their_noise() {
        let settings = model_export::link::settings::Settings::default();
        let facts = super::super::in_process::FACTS;
        let tick = firmware::tick::TickConfig { settings: &settings, facts }.build().unwrap();
        let mut hardware = hardware();
        hardware.apply(&energised(u16::MAX / 5 * 2));
        (0..500).for_each(|_| hardware.advance());
        let sample = hardware.sample();
        let (pressure, laser) = (tick.pressure().calibration(), tick.laser().calibration());
        // Two codes of noise and half a code of rounding.
        let tolerance = 2.6;
        assert!((f64::from(pressure.value(sample.pressure_code)) - 2.0).abs() < tolerance * f64::from(pressure.resolution()));
        let error_mm = f64::from(laser.value(sample.laser_code)) - hardware.displacement_mm();
        assert!(error_mm.abs() < tolerance * f64::from(laser.resolution()), "{error_mm}");
        assert!(hardware.displacement_mm() > 1.0);
    }
}
