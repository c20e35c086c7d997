//! The simulated hardware around the processor: valve, dump valve, muscle, sensors with their converter, and ways to break each.
//!
//! ```text
//! valve share ─► regulator (first order, at most the supply) ─► pressure ─► muscle ─► tip ─► laser 4-20 mA ─► code
//! dump valve released ─► pressure falls to zero                    └─► pressure sensor 4-20 mA ─► code
//! ```
//!
//! One step is one tick of 1 ms. Electrical values are those of the board: 150 ohm, 3.3 V, two conversions of 12 bits summed.

use std::collections::VecDeque;

use firmware::device::exchange::DeviceOutputs;
use firmware::drivers::RawSample;
use serde::Deserialize;

use super::breakage::Breakage;
use super::inject::Injection;
use simulation::plant::RunningPlant;

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
pub trait Muscle: Send {
    /// Displacement in mm after another 1 ms at this pressure in bar.
    fn step(&mut self, pressure_bar: f64) -> f64;
}

impl Muscle for RunningPlant {
    fn step(&mut self, pressure_bar: f64) -> f64 {
        RunningPlant::step(self, pressure_bar, STEP_S)
    }
}

impl Muscle for virtual_rig::live::RealisticRig {
    fn step(&mut self, pressure_bar: f64) -> f64 {
        self.advance_ms(pressure_bar)
    }
}

/// How a sensor differs from its data sheet: it reads `gain` times the truth plus `zero`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SensorError {
    /// Reading where the truth is zero, in the sensor's unit.
    pub zero: f64,
    /// Reading per truth.
    pub gain: f64,
}

impl Default for SensorError {
    fn default() -> Self {
        Self { zero: 0.0, gain: 1.0 }
    }
}

/// How the valve differs from a straight line through zero.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ValveError {
    /// Share of full drive below which no pressure comes.
    pub dead_band_share: f64,
    /// Width of the valve's own hysteresis, share of full drive.
    pub hysteresis_share: f64,
    /// Pressure per what the data sheet says.
    pub gain: f64,
}

impl Default for ValveError {
    fn default() -> Self {
        Self { dead_band_share: 0.0, hysteresis_share: 0.0, gain: 1.0 }
    }
}

/// Numbers of the hardware.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
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
    /// Time constant of the regulator when the pressure falls, ms; as when it rises if absent.
    pub regulator_falling_ms: Option<f64>,
    /// Dead time of valve and tube, ms.
    pub dead_time_ms: u16,
    /// Where the tip at rest lies in the laser's range, mm.
    pub rest_mm: f64,
    /// How the laser errs.
    pub laser: SensorError,
    /// How the pressure sensor errs.
    pub pressure: SensorError,
    /// How the valve errs.
    pub valve: ValveError,
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
            regulator_falling_ms: None,
            dead_time_ms: 0,
            rest_mm: 0.0,
            laser: SensorError::default(),
            pressure: SensorError::default(),
            valve: ValveError::default(),
        }
    }
}

impl HardwareConfig {
    /// The first number that no hardware has, by its name, and what is wanted.
    #[must_use]
    pub fn problem(&self) -> Option<String> {
        let within = |name: &str, value: f64, low: f64, high: f64| {
            (!(low..=high).contains(&value)).then(|| format!("{name} is {value}; {low} to {high} is wanted"))
        };
        // Far beyond any bench; a time constant of nothing is a division by zero.
        [
            within("supply_bar", self.supply_bar, 0.0, 100.0),
            within("valve_full_scale_bar", self.valve_full_scale_bar, 0.01, 100.0),
            within("regulator_ms", self.regulator_ms, 0.1, 1e5),
            within("regulator_falling_ms", self.regulator_falling_ms.unwrap_or(self.regulator_ms), 0.1, 1e5),
            within("dump_ms", self.dump_ms, 0.1, 1e5),
            within("tip_ms", self.tip_ms, 0.1, 1e5),
            within("pressure_range_bar", self.pressure_range_bar, 0.01, 1e3),
            within("laser_range_mm", self.laser_range_mm, 0.01, 1e4),
            within("rest_mm", self.rest_mm, -1e4, 1e4),
            within("laser.zero", self.laser.zero, -1e4, 1e4),
            within("laser.gain", self.laser.gain, -100.0, 100.0),
            within("pressure.zero", self.pressure.zero, -1e3, 1e3),
            within("pressure.gain", self.pressure.gain, -100.0, 100.0),
            within("valve.dead_band_share", self.valve.dead_band_share, 0.0, 1.0),
            within("valve.hysteresis_share", self.valve.hysteresis_share, 0.0, 1.0),
            within("valve.gain", self.valve.gain, -100.0, 100.0),
        ]
        .into_iter()
        .flatten()
        .next()
    }
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
    drive_share: f64,
    /// The drive behind the valve's own hysteresis.
    spool_share: f64,
    delayed_shares: VecDeque<f64>,
    frozen: Option<RawSample>,
    breakages: Vec<Breakage>,
    injections: Vec<Injection>,
    time_ms: u64,
    target_mm: Option<f64>,
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
            drive_share: 0.0,
            spool_share: 0.0,
            delayed_shares: VecDeque::new(),
            frozen: None,
            breakages: Vec::new(),
            injections: Vec::new(),
            time_ms: 0,
            target_mm: None,
        }
    }

    /// Breaks something from now on; `None` mends everything.
    pub fn set_breakage(&mut self, breakage: Option<Breakage>) {
        self.breakages.clear();
        self.breakages.extend(breakage);
        self.frozen = None;
    }

    /// Puts another muscle in, at rest; only sensible while vented.
    pub fn set_muscle(&mut self, muscle: Box<dyn Muscle>) {
        self.muscle = muscle;
    }

    /// Its numbers.
    #[must_use]
    pub fn config(&self) -> &HardwareConfig {
        &self.config
    }

    /// What [`Self::set_breakage`] broke.
    #[must_use]
    pub fn breakage(&self) -> Option<Breakage> {
        self.breakages.first().copied()
    }

    /// Breaks things in their time, beside what is broken already.
    pub fn inject(&mut self, injections: &[Injection]) {
        self.injections.extend_from_slice(injections);
    }

    /// Whether this is broken now.
    #[must_use]
    pub fn has(&self, breakage: Breakage) -> bool {
        self.broken().any(|broken| broken == breakage)
    }

    /// What is broken now.
    pub fn broken(&self) -> impl Iterator<Item = Breakage> + '_ {
        let injected = self.injections.iter().filter(|injection| injection.holds_at(self.time_ms)).map(|injection| injection.breakage);
        self.breakages.iter().copied().chain(injected)
    }

    /// Puts a target of known distance before the laser, in mm of its range, instead of the tip; `None` takes it away.
    pub fn place_target(&mut self, distance_mm: Option<f64>) {
        self.target_mm = distance_mm;
    }

    /// Drive of the valve, share of full.
    #[must_use]
    pub fn drive_share(&self) -> f64 {
        self.drive_share
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
        let distance_mm = self.target_mm.unwrap_or(self.config.rest_mm + self.displacement_mm);
        let read = |error: SensorError, truth: f64| error.gain * truth + error.zero;
        let mut laser_mm = read(self.config.laser, distance_mm);
        let mut pressure_bar = read(self.config.pressure, self.pressure_bar);
        let broken: Vec<Breakage> = self.broken().collect();
        for breakage in &broken {
            match breakage {
                Breakage::LaserOffsetMm(offset) => laser_mm += offset,
                Breakage::PressureOffsetBar(offset) => pressure_bar += offset,
                Breakage::PressureGain(gain) => pressure_bar *= gain,
                _ => {}
            }
        }
        let mut sample = RawSample {
            laser_code: self.code(laser_mm / self.config.laser_range_mm),
            pressure_code: self.code(pressure_bar / self.config.pressure_range_bar),
        };
        for breakage in broken {
            match breakage {
                Breakage::LaserCode(code) => sample.laser_code = code,
                Breakage::PressureCode(code) => sample.pressure_code = code,
                Breakage::LaserFrozen => sample.laser_code = self.frozen.get_or_insert(sample).laser_code,
                Breakage::LaserFrozenWithNoise => {
                    let code = self.frozen.get_or_insert(sample).laser_code;
                    sample.laser_code = (f64::from(code) + self.noise()).clamp(0.0, FULL_SCALE_CODE) as u16;
                }
                Breakage::PressureFrozenWithNoise => {
                    let code = self.frozen.get_or_insert(sample).pressure_code;
                    sample.pressure_code = (f64::from(code) + self.noise()).clamp(0.0, FULL_SCALE_CODE) as u16;
                }
                Breakage::PressureFrozen => sample.pressure_code = self.frozen.get_or_insert(sample).pressure_code,
                _ => {}
            }
        }
        sample
    }

    /// Applies a tick's outputs.
    pub fn apply(&mut self, outputs: &DeviceOutputs) {
        self.energised = outputs.energised;
        self.drive_share = f64::from(outputs.valve_share) / f64::from(u16::MAX);
    }

    /// What pins do while the processor is in reset: nothing is driven.
    pub fn release_pins(&mut self) {
        self.energised = false;
        self.drive_share = 0.0;
    }

    /// Lets one tick pass.
    pub fn advance(&mut self) {
        let dump_open = !self.energised && !self.has(Breakage::DumpValveStuckClosed);
        let drive_bar = self.driven_bar();
        let rising_ms = self.config.regulator_ms;
        let regulator_ms = if drive_bar < self.pressure_bar { self.config.regulator_falling_ms.unwrap_or(rising_ms) } else { rising_ms };
        let (mut supply_bar, mut kept_share) = (self.config.supply_bar, 1.0);
        for breakage in self.broken() {
            match breakage {
                Breakage::SupplyBar(bar) => supply_bar = bar,
                Breakage::LineLeaks(share) => kept_share = 1.0 - share,
                _ => {}
            }
        }
        let (target_bar, time_constant_ms) = if self.has(Breakage::LineBlocked) {
            (self.pressure_bar, rising_ms)
        } else if self.has(Breakage::MuscleBursts) {
            (0.0, 0.8 * rising_ms)
        } else if dump_open {
            (0.0, self.config.dump_ms)
        } else if self.has(Breakage::ValveFullyOpen) {
            (supply_bar, rising_ms)
        } else if self.has(Breakage::SupplyFails) {
            (0.0, rising_ms)
        } else if !self.energised {
            // A regulator that holds its pressure when asked for zero: why there is a dump valve.
            (self.pressure_bar, rising_ms)
        } else {
            (kept_share * drive_bar.min(supply_bar), regulator_ms)
        };
        self.pressure_bar += (target_bar - self.pressure_bar) / time_constant_ms;
        self.peak_bar = self.peak_bar.max(self.pressure_bar);
        let muscle_mm = self.muscle.step(self.pressure_bar);
        self.displacement_mm += (muscle_mm - self.displacement_mm) / self.config.tip_ms;
        self.time_ms += 1;
    }

    /// The pressure that the valve's drive asks for, after dead time, the valve's hysteresis and its dead band.
    fn driven_bar(&mut self) -> f64 {
        let mut share = self.drive_share;
        if self.config.dead_time_ms > 0 {
            self.delayed_shares.push_back(share);
            let is_filled = self.delayed_shares.len() > usize::from(self.config.dead_time_ms);
            share = if is_filled { self.delayed_shares.pop_front().unwrap_or(share) } else { 0.0 };
        }
        let ValveError { dead_band_share, hysteresis_share, gain } = self.config.valve;
        let half = 0.5 * hysteresis_share;
        // Friction of the spool: it follows the drive at a distance.
        self.spool_share = self.spool_share.clamp(share - half, share + half);
        let full_scale_bar = gain * self.config.valve_full_scale_bar;
        full_scale_bar * ((self.spool_share - dead_band_share) / (1.0 - dead_band_share)).max(0.0)
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
    use simulation::plant::{Plant, PlantConfig};

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
