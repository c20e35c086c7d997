//! Profiles: what a valve or a sensor that labs buy wants of the settings, with the data sheet it comes from.
//!
//! A profile is data: the settings that make the rig fit one device, and what stands between the device and the board's pin. The safe state is
//! the same for all: the valve's drive at zero, which is below every live zero and every dead band, and the dump valve without current. Whoever buys
//! another device copies a row. `catheter rig settings profile NAME` applies one.
//!
//! | circuit | from the device to the board |
//! |---|---|
//! | [`Circuit::Loop`] | 4 to 20 mA over 150 ohm: 0.6 to 3.0 V |
//! | [`Circuit::Divider`] | a divider from the device's full voltage to 3.0 V |
//! | [`Circuit::Shifted`] | a divider to a reference of 3.3 V: -10 to 10 V become 0.3 to 3.0 V |
//! | [`Circuit::Amplifier`] | an amplifier from 3.3 V to 10 V |
//! | [`Circuit::Transmitter`] | a converter from 3.3 V to 20 mA, 0 V is 0 mA |
//! | [`Circuit::Switch`] | a transistor that switches the coil |
//!
//! # Example
//! ```
//! use model_export::link::profiles::{Circuit, PROFILES, Profile};
//! use model_export::link::settings::Settings;
//!
//! let valve = Profile::named("smc-itv-0-10v").expect("a profile");
//! assert!(!valve.is_sensor());
//! let mut settings = Settings::default();
//! valve.apply(&mut settings).expect("every profile fits");
//! assert_eq!(settings.valve_full_scale_bar, 5.0);
//!
//! // 12 mA of a current loop are 1.8 V at the pin.
//! assert!((Circuit::Loop.pin_v(12.0) - 1.8).abs() < 1e-6);
//! assert!(PROFILES.iter().any(Profile::is_sensor));
//! ```

use super::settings::SettingValue::{Float, Integer};
use super::settings::{SettingError, SettingValue, Settings};

/// What lies between the device and the board's pin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Circuit {
    /// A current loop over 150 ohm.
    Loop,
    /// A divider; volts at the device that are one volt at the pin.
    Divider(f32),
    /// A divider that also shifts; volts at the device for 0 V at the pin, and volts at the device that are one volt at the pin.
    Shifted {
        /// Volts at the device for 0 V at the pin.
        zero_v: f32,
        /// Volts at the device that are one volt at the pin.
        volts: f32,
    },
    /// An amplifier to 10 V.
    Amplifier,
    /// A converter to 20 mA.
    Transmitter,
    /// A transistor.
    Switch,
}

/// A device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Profile {
    /// Its name, for the command line.
    pub name: &'static str,
    /// What it is, and which of its variants.
    pub device: &'static str,
    /// Where its numbers come from.
    pub data_sheet: &'static str,
    /// What lies between it and the pin.
    pub circuit: Circuit,
    /// The settings, by name.
    pub settings: &'static [(&'static str, SettingValue)],
    /// What a sensor gives when it has no measurement: volts, or milliamperes of a loop.
    pub error_signals: &'static [f32],
}

impl Circuit {
    /// Voltage at the pin of a signal at the device, V or mA; the pin's own limits clip it.
    pub fn pin_v(self, signal: f32) -> f32 {
        let volts = match self {
            Self::Loop => signal * 0.15,
            Self::Divider(device_v) => signal / device_v,
            Self::Shifted { zero_v, volts } => (signal - zero_v) / volts,
            Self::Amplifier | Self::Transmitter | Self::Switch => 0.0,
        };
        volts.clamp(0.0, 3.3)
    }
}

impl Profile {
    /// The profile of this name.
    pub fn named(name: &str) -> Option<&'static Self> {
        PROFILES.iter().find(|profile| profile.name == name)
    }

    /// Whether it is a sensor's.
    pub fn is_sensor(&self) -> bool {
        matches!(self.circuit, Circuit::Loop | Circuit::Divider(_) | Circuit::Shifted { .. })
    }

    /// Puts its settings among the others.
    ///
    /// # Errors
    /// When a setting does not exist or does not take the value; a test holds that there is no such row.
    pub fn apply(&self, settings: &mut Settings) -> Result<(), SettingError> {
        self.settings.iter().try_for_each(|(name, value)| {
            let info = super::settings::by_name(name).ok_or(SettingError::Unknown)?;
            settings.set(info.number, *value)
        })
    }
}

/// All profiles.
pub const PROFILES: &[Profile] = &[
    Profile {
        name: "smc-itv-0-10v",
        device: "SMC ITV1030/2030, 0.005 to 0.5 MPa, input 0 to 10 V",
        data_sheet: "SMC, Electro-Pneumatic Regulator, Series ITV, CAT.ES60-23",
        circuit: Circuit::Amplifier,
        settings: &[
            ("valve.drive", Integer(0)),
            ("valve.full_scale_bar", Float(5.0)),
            ("valve.lowest_share", Float(0.0)),
            ("valve.highest_share", Float(1.0)),
        ],
        error_signals: &[],
    },
    Profile {
        name: "smc-itv-4-20ma",
        device: "SMC ITV1030/2030, 0.005 to 0.5 MPa, input 4 to 20 mA",
        data_sheet: "SMC, Electro-Pneumatic Regulator, Series ITV, CAT.ES60-23",
        circuit: Circuit::Transmitter,
        settings: &[
            ("valve.drive", Integer(0)),
            ("valve.full_scale_bar", Float(5.0)),
            // 4 of 20 mA; without a demand the current is zero, which is below the live zero.
            ("valve.lowest_share", Float(0.2)),
            ("valve.highest_share", Float(1.0)),
        ],
        error_signals: &[],
    },
    Profile {
        name: "matrix-821-100hz",
        device: "Matrix 821, 2/2 normally closed, opening time 1 ms; pulses of 100 Hz, supply at 3 bar",
        data_sheet: "Matrix, series 820; opening time as in R. Van Ham, Lucy, VUB, lucy.vub.ac.be/gendes/actuators/valves.htm",
        circuit: Circuit::Switch,
        settings: &[
            ("valve.drive", Integer(1)),
            ("valve.pulse_hz", Integer(100)),
            ("valve.full_scale_bar", Float(3.0)),
            // A pulse of 1 ms of 10 does not open it, a pause of 1 ms does not close it.
            ("valve.lowest_share", Float(0.1)),
            ("valve.highest_share", Float(0.9)),
        ],
        error_signals: &[],
    },
    Profile {
        name: "fast-switching-20hz",
        device: "any 2/2 or 3/2 switching valve that opens and closes within 5 ms; pulses of 20 Hz, supply at 3 bar",
        data_sheet: "none: measure opening and closing, and put their shares of 50 ms here",
        circuit: Circuit::Switch,
        settings: &[
            ("valve.drive", Integer(1)),
            ("valve.pulse_hz", Integer(20)),
            ("valve.full_scale_bar", Float(3.0)),
            ("valve.lowest_share", Float(0.1)),
            ("valve.highest_share", Float(0.9)),
        ],
        error_signals: &[],
    },
    Profile {
        name: "fast-switching-500hz",
        device: "any 2/2 or 3/2 switching valve that opens and closes within 0.4 ms; pulses of 500 Hz, supply at 3 bar",
        data_sheet: "none: measure opening and closing, and put their shares of 2 ms here",
        circuit: Circuit::Switch,
        settings: &[
            ("valve.drive", Integer(1)),
            ("valve.pulse_hz", Integer(500)),
            ("valve.full_scale_bar", Float(3.0)),
            ("valve.lowest_share", Float(0.2)),
            ("valve.highest_share", Float(0.8)),
        ],
        error_signals: &[],
    },
    Profile {
        name: "optoncdt-1402-20-4-20ma",
        device: "Micro-Epsilon optoNCDT 1402-20, range 20 mm, 4 to 20 mA",
        data_sheet: "Micro-Epsilon, optoNCDT 1402 instruction manual, section 7.1: error value 3.75 mA",
        circuit: Circuit::Loop,
        settings: &[
            ("laser.low_v", Float(0.6)),
            ("laser.low_mm", Float(0.0)),
            ("laser.high_v", Float(3.0)),
            ("laser.high_mm", Float(20.0)),
            ("laser.fault_below_v", Float(0.567)),
            ("laser.fault_above_v", Float(3.12)),
        ],
        error_signals: &[3.75, 0.0, 22.0],
    },
    Profile {
        name: "keyence-il-4-20ma",
        device: "Keyence IL amplifier, 4 to 20 mA, scaled to 20 mm",
        data_sheet: "Keyence, DL-RS1A user manual (IL series), page 12 note 7: 3.00 mA in the error state",
        circuit: Circuit::Loop,
        settings: &[
            ("laser.low_v", Float(0.6)),
            ("laser.low_mm", Float(0.0)),
            ("laser.high_v", Float(3.0)),
            ("laser.high_mm", Float(20.0)),
            ("laser.fault_below_v", Float(0.567)),
            ("laser.fault_above_v", Float(3.12)),
        ],
        error_signals: &[3.0, 0.0, 22.0],
    },
    Profile {
        name: "keyence-il-1-5v",
        device: "Keyence IL amplifier, analogue output 1 to 5 V, scaled to 20 mm",
        data_sheet: "Keyence, DL-RS1A user manual (IL series), page 12 note 7: 5.500 V in the error state",
        circuit: Circuit::Divider(5.0 / 3.0),
        settings: &[
            ("laser.low_v", Float(0.6)),
            ("laser.low_mm", Float(0.0)),
            ("laser.high_v", Float(3.0)),
            ("laser.high_mm", Float(20.0)),
            ("laser.fault_below_v", Float(0.5)),
            ("laser.fault_above_v", Float(3.12)),
        ],
        error_signals: &[5.5, 0.0],
    },
    Profile {
        name: "laser-0-10v",
        device: "any laser with 0 to 10 V, of which 0.5 to 10 V are scaled to 19 of 20 mm; a broken wire is no measurement",
        data_sheet: "none: its error voltage must lie below 0.4 or above 10.3 V",
        circuit: Circuit::Divider(10.0 / 3.0),
        settings: &[
            ("laser.low_v", Float(0.15)),
            ("laser.low_mm", Float(1.0)),
            ("laser.high_v", Float(3.0)),
            ("laser.high_mm", Float(20.0)),
            ("laser.fault_below_v", Float(0.12)),
            ("laser.fault_above_v", Float(3.09)),
        ],
        error_signals: &[10.5, 0.0],
    },
    Profile {
        name: "laser-pm10v",
        device: "any laser with -10 to 10 V for 20 mm",
        data_sheet: "none: its error voltage must lie below -10.4 or above 10.4 V",
        circuit: Circuit::Shifted { zero_v: -10.0 - 0.3 * 20.0 / 2.7, volts: 20.0 / 2.7 },
        settings: &[
            ("laser.low_v", Float(0.3)),
            ("laser.low_mm", Float(0.0)),
            ("laser.high_v", Float(3.0)),
            ("laser.high_mm", Float(20.0)),
            ("laser.fault_below_v", Float(0.25)),
            ("laser.fault_above_v", Float(3.05)),
        ],
        error_signals: &[-10.5, 10.5, -13.0],
    },
];
