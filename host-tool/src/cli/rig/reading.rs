//! What a rig reads now, as text and JSON: pressures, laser, estimate, set-point, codes, supply, and the pins of a simulated board.

use std::time::Duration;

use anyhow::{Context, Result, bail};
use model_export::link::message::Telemetry;
use model_export::link::settings::SettingValue;
use serde::Serialize;

use crate::backend::Rig;
use crate::device_settings;
use crate::link::{Client, fault_in_words, state_name};

/// Reference of the simulated board's converters, V.
const REFERENCE_V: f64 = 3.3;

/// Voltages at the pins of a simulated board, as a voltmeter shows them on a real one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Pins {
    /// The dump valve's driver.
    pub dump_valve_v: f64,
    /// The valve's analogue drive, and the share of the pulse width.
    pub valve_v: f64,
    /// The valve's drive, share of full.
    pub valve_share: f64,
}

impl Pins {
    /// Of a simulated rig.
    pub fn of(rig: &mut Rig) -> Option<Self> {
        let hardware = rig.hardware()?;
        let valve_share = hardware.drive_share();
        let dump_valve_v = if hardware.is_energised() { REFERENCE_V } else { 0.0 };
        Some(Self { dump_valve_v, valve_v: REFERENCE_V * valve_share, valve_share })
    }
}

/// A sample with what belongs to it.
#[derive(Clone, Debug, Serialize)]
pub struct Reading {
    /// Time since the device started, s.
    pub time_s: f64,
    /// State.
    pub state: &'static str,
    /// What goes to the valve at this moment, bar.
    pub output_bar: f64,
    /// What went to the valve, filtered like the measured channels, bar.
    pub command_bar: f32,
    /// Measured pressure, bar; nothing while not plausible.
    pub pressure_bar: Option<f32>,
    /// Displacement by the laser, mm; nothing while not plausible.
    pub displacement_mm: Option<f32>,
    /// The model's estimate, mm; nothing without one.
    pub estimate_mm: Option<f32>,
    /// Set-point in force, in bar or, where the control law tracks, mm.
    pub set_point: f32,
    /// Code of the pressure sensor.
    pub pressure_code: u16,
    /// Code of the laser.
    pub laser_code: u16,
    /// Analogue supply, V; nothing where it is not measured.
    pub supply_v: Option<f32>,
    /// Temperature of the chip; nothing where it is not measured.
    pub chip_celsius: Option<f32>,
    /// Longest tick since the start, processor cycles; 0 if not measured.
    pub longest_tick_cycles: u32,
    /// First fault.
    pub first_fault: Option<String>,
    /// Notices.
    pub notices: Vec<&'static str>,
    /// Pins of a simulated board.
    pub pins: Option<Pins>,
}

/// What rounds to zero is zero, without a sign.
fn unsigned_zero(value: f32) -> f32 {
    if value.abs() < 0.000_5 { 0.0 } else { value }
}

impl Reading {
    /// Of a sample.
    pub fn new(sample: &Telemetry, rig: &mut Rig) -> Self {
        Self {
            time_s: sample.time_ms as f64 * 1e-3,
            state: state_name(sample.state),
            output_bar: f64::from(sample.output_ubar) * 1e-6,
            command_bar: sample.command_bar,
            pressure_bar: sample.pressure_bar,
            displacement_mm: sample.displacement_mm,
            estimate_mm: sample.estimate_mm,
            set_point: sample.set_point,
            pressure_code: sample.pressure_code,
            laser_code: sample.laser_code,
            supply_v: sample.supply_v,
            chip_celsius: sample.chip_celsius,
            longest_tick_cycles: sample.longest_tick_cycles,
            first_fault: (sample.first_fault != 0).then(|| fault_in_words(sample.first_fault)),
            notices: sample.notices.iter().map(|notice| notice.explanation().name).collect(),
            pins: Pins::of(rig),
        }
    }

    /// One line, for a rig that is watched.
    pub fn line(&self) -> String {
        let value = |value: Option<f32>, digits: usize, unit: &str| {
            value.map_or_else(
                || format!("{:>1$}", "-", digits + 4 + unit.len()),
                |value| format!("{:>width$.digits$} {unit}", unsigned_zero(value), width = digits + 3),
            )
        };
        let mut line = format!(
            "{:>9.3} s  {:<7}  output {:.3} bar  pressure {}  laser {}  estimate {}",
            self.time_s,
            self.state,
            self.output_bar,
            value(self.pressure_bar, 3, "bar"),
            value(self.displacement_mm, 3, "mm"),
            value(self.estimate_mm, 3, "mm"),
        );
        if let Some(pins) = &self.pins {
            line.push_str(&format!("  PB1 {:.1} V  PA4 {:.2} V", pins.dump_valve_v, pins.valve_v));
        }
        if let Some(fault) = &self.first_fault {
            line.push_str(&format!("  {fault}"));
        }
        if !self.notices.is_empty() {
            line.push_str(&format!("  ({})", self.notices.join(", ")));
        }
        line
    }

    /// Several lines, for a status.
    pub fn lines(&self, quantity: &str) -> Vec<String> {
        let value = |value: Option<f32>, unit: &str, without: &str| {
            value.map_or_else(|| without.to_owned(), |value| format!("{:.3} {unit}", unsigned_zero(value)))
        };
        let mut lines = vec![
            format!(
                "pressure   {} (code {}), {:.3} bar to the valve",
                value(self.pressure_bar, "bar measured", "not plausible"),
                self.pressure_code,
                self.output_bar
            ),
            format!("laser      {} (code {})", value(self.displacement_mm, "mm", "not plausible"), self.laser_code),
            format!("estimate   {}", value(self.estimate_mm, "mm", "none, there is no model")),
            format!("set-point  {:.3} {quantity}", self.set_point),
        ];
        match (self.supply_v, self.chip_celsius) {
            (None, None) => lines.push("board      supply and temperature are not measured here".to_owned()),
            (supply_v, celsius) => {
                let supply = supply_v.map_or_else(|| "not measured".to_owned(), |volts| format!("{volts:.3} V"));
                let chip = celsius.map_or_else(|| "not measured".to_owned(), |celsius| format!("{celsius:.0} degrees"));
                lines.push(format!("board      analogue supply {supply}, chip {chip}"));
            }
        }
        if let Some(pins) = &self.pins {
            lines.push(format!(
                "pins       PB1 {:.2} V (dump valve), PA4 {:.2} V, PA6 {:.0} % (valve), by the simulation",
                pins.dump_valve_v,
                pins.valve_v,
                100.0 * pins.valve_share
            ));
        }
        lines
    }
}

/// The unit of the set-point in force.
pub fn quantity(rig: &mut Client<Rig>) -> Result<&'static str> {
    Ok(if device_settings::setting(rig, "control.law")? == SettingValue::Integer(2) { "mm" } else { "bar" })
}

/// The newest sample, or the next one.
pub(super) fn latest(rig: &mut Client<Rig>) -> Result<Telemetry> {
    let SettingValue::Integer(period_ms) = device_settings::setting(rig, "telemetry.period_ms")? else {
        bail!("telemetry.period_ms is no time")
    };
    // What waited was heard before; one period, and one for the way.
    let until = rig.elapsed() + Duration::from_millis(u64::from(period_ms)) * 2 + Duration::from_millis(200);
    let mut newest = None;
    while newest.is_none() && rig.elapsed() < until {
        rig.listen(Duration::from_millis(20))?;
        while let Some(sample) = rig.take_telemetry() {
            newest = Some(sample);
        }
    }
    newest.context("no telemetry comes; `settings get telemetry.period_ms` says how often it should")
}
