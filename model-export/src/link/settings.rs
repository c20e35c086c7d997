//! Settings: every number an operator may change, with its unit, bounds and safe default.
//!
//! A setting has a stable number, a dotted name that ends in its unit, and one of three types. On the wire and in flash settings travel
//! as pairs of number and value, so that a firmware that knows fewer or more of them still reads the rest: unknown numbers are
//! skipped, missing ones take their default. What a single value may be is checked here; what values may be together is checked where
//! the firmware builds its parts from them.
//!
//! # Example
//! ```
//! use model_export::link::settings::{Entry, INFO, NUMBERS, SettingError, SettingInfo, SettingValue, Settings, by_name, by_number};
//!
//! let mut settings = Settings::default();
//! let ceiling: &SettingInfo = by_number(1).expect("the ceiling");
//! assert_eq!(by_name(ceiling.name), Some(ceiling));
//! assert_eq!((settings.get(1), ceiling.unit), (Some(ceiling.default), "bar"));
//!
//! settings.set(1, SettingValue::Float(2.0))?;
//! assert_eq!(settings.set(1, SettingValue::Flag(true)), Err(SettingError::WrongType));
//! let differences: Vec<_> = settings.differences(&Settings::DEFAULT).collect();
//! assert_eq!(differences, [(1, SettingValue::Float(2.0), ceiling.default)]);
//!
//! // As flash keeps it.
//! let entry = Entry { number: 1, value: SettingValue::Float(2.0) };
//! assert!(NUMBERS.contains(&entry.number) && NUMBERS.len() == INFO.len());
//! # Ok::<(), SettingError>(())
//! ```

use serde::{Deserialize, Serialize};

/// Value of one setting.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SettingValue {
    /// A quantity in the setting's unit.
    Float(f32),
    /// A count, a duration or a choice.
    Integer(u32),
    /// Yes or no.
    Flag(bool),
}

impl Default for SettingValue {
    fn default() -> Self {
        Self::Float(0.0)
    }
}

/// A setting with its number, as flash keeps it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// Its number.
    pub number: u16,
    /// Its value.
    pub value: SettingValue,
}

/// What there is to know about one setting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SettingInfo {
    /// Stable number, never reused.
    pub number: u16,
    /// Dotted name, its last word the unit where there is one.
    pub name: &'static str,
    /// Unit, empty for flags, counts and choices.
    pub unit: &'static str,
    /// Value of a device nobody has set up.
    pub default: SettingValue,
    /// Smallest allowed value.
    pub minimum: SettingValue,
    /// Largest allowed value.
    pub maximum: SettingValue,
    /// What it does.
    pub meaning: &'static str,
}

/// Why a setting was not changed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SettingError {
    /// No setting has this number.
    #[default]
    Unknown,
    /// The value has another type than the setting.
    WrongType,
    /// The value is not a number or outside the setting's bounds.
    OutOfBounds,
}

/// A type a setting can have.
trait SettingType: Copy + PartialEq {
    fn wrap(self) -> SettingValue;
    fn unwrap_within(value: SettingValue, minimum: Self, maximum: Self) -> Result<Self, SettingError>;
}

impl SettingType for f32 {
    fn wrap(self) -> SettingValue {
        SettingValue::Float(self)
    }
    fn unwrap_within(value: SettingValue, minimum: Self, maximum: Self) -> Result<Self, SettingError> {
        match value {
            // A NaN is in no range.
            SettingValue::Float(number) if (minimum..=maximum).contains(&number) => Ok(number),
            SettingValue::Float(_) => Err(SettingError::OutOfBounds),
            _ => Err(SettingError::WrongType),
        }
    }
}

impl SettingType for u32 {
    fn wrap(self) -> SettingValue {
        SettingValue::Integer(self)
    }
    fn unwrap_within(value: SettingValue, minimum: Self, maximum: Self) -> Result<Self, SettingError> {
        match value {
            SettingValue::Integer(number) if (minimum..=maximum).contains(&number) => Ok(number),
            SettingValue::Integer(_) => Err(SettingError::OutOfBounds),
            _ => Err(SettingError::WrongType),
        }
    }
}

impl SettingType for bool {
    fn wrap(self) -> SettingValue {
        SettingValue::Flag(self)
    }
    fn unwrap_within(value: SettingValue, _minimum: Self, _maximum: Self) -> Result<Self, SettingError> {
        match value {
            SettingValue::Flag(flag) => Ok(flag),
            _ => Err(SettingError::WrongType),
        }
    }
}

macro_rules! settings {
    ($($number:literal $field:ident: $type:ident = $default:literal, $minimum:literal ..= $maximum:literal, $name:literal, $unit:literal, $meaning:literal;)*) => {
        /// All settings of a device.
        #[derive(Clone, Debug, PartialEq)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub struct Settings {
            $(#[doc = $meaning] pub $field: $type,)*
        }

        impl Settings {
            /// What a device nobody has set up has.
            pub const DEFAULT: Self = Self { $($field: $default,)* };
        }

        impl Default for Settings {
            fn default() -> Self {
                Self::DEFAULT
            }
        }

        /// Every setting, by number.
        pub const INFO: &[SettingInfo] = &[$(SettingInfo {
            number: $number,
            name: $name,
            unit: $unit,
            default: value_of!($type, $default),
            minimum: value_of!($type, $minimum),
            maximum: value_of!($type, $maximum),
            meaning: $meaning,
        },)*];

        /// The numbers of all settings, ascending: what a device needs of [`INFO`] without its texts.
        pub const NUMBERS: &[u16] = &[$($number,)*];

        impl Settings {
            /// The value of the setting with this number.
            pub fn get(&self, number: u16) -> Option<SettingValue> {
                match number {
                    $($number => Some(SettingType::wrap(self.$field)),)*
                    _ => None,
                }
            }

            /// Changes the setting with this number; on an error nothing changes.
            ///
            /// # Errors
            /// See [`SettingError`].
            pub fn set(&mut self, number: u16, value: SettingValue) -> Result<(), SettingError> {
                match number {
                    $($number => self.$field = <$type as SettingType>::unwrap_within(value, $minimum, $maximum)?,)*
                    _ => return Err(SettingError::Unknown),
                }
                Ok(())
            }
        }
    };
}

macro_rules! value_of {
    (f32, $value:literal) => {
        SettingValue::Float($value)
    };
    (u32, $value:literal) => {
        SettingValue::Integer($value)
    };
    (bool, $value:literal) => {
        SettingValue::Flag($value)
    };
}

settings! {
    1 ceiling_bar: f32 = 3.0, 0.0 ..= 4.0, "limits.ceiling_bar", "bar",
        "No output asks for more pressure than this.";
    2 slew_up_bar_per_s: f32 = 20.0, 0.1 ..= 100.0, "limits.slew_up_bar_per_s", "bar/s",
        "The output rises at most this fast.";
    3 slew_down_bar_per_s: f32 = 20.0, 0.1 ..= 100.0, "limits.slew_down_bar_per_s", "bar/s",
        "The output falls at most this fast, except when venting, which is immediate.";
    4 output_time_to_live_ms: u32 = 100, 1 ..= 1000, "limits.output_time_to_live_ms", "ms",
        "The control law must renew its demand within this time, or the device vents.";
    5 host_timeout_ms: u32 = 250, 10 ..= 5000, "limits.host_timeout_ms", "ms",
        "While running, a set-point must come from the host within this time, or the device vents.";
    6 over_pressure_margin_bar: f32 = 0.2, 0.01 ..= 0.5, "limits.over_pressure_margin_bar", "bar",
        "Measured pressure this far above the ceiling vents.";
    7 arming_timeout_s: u32 = 60, 1 ..= 3600, "arming.timeout_s", "s",
        "An armed device disarms itself after this time without a start.";
    10 laser_low_v: f32 = 0.6, 0.0 ..= 3.3, "laser.low_v", "V",
        "Voltage at the pin for laser.low_mm; 4 mA through 150 ohm is 0.6 V.";
    11 laser_low_mm: f32 = 0.0, -1000.0 ..= 1000.0, "laser.low_mm", "mm",
        "Displacement at laser.low_v.";
    12 laser_high_v: f32 = 3.0, 0.0 ..= 3.3, "laser.high_v", "V",
        "Voltage at the pin for laser.high_mm; 20 mA through 150 ohm is 3.0 V.";
    13 laser_high_mm: f32 = 20.0, -1000.0 ..= 1000.0, "laser.high_mm", "mm",
        "Displacement at laser.high_v.";
    14 laser_fault_below_v: f32 = 0.567, 0.0 ..= 3.3, "laser.fault_below_v", "V",
        "A lower voltage is no measurement; 3.78 mA through 150 ohm, between the fault code 3.75 mA and the lowest measured value 3.8 mA (NAMUR NE 43).";
    15 laser_fault_above_v: f32 = 3.12, 0.0 ..= 3.3, "laser.fault_above_v", "V",
        "A higher voltage is no measurement; 20.8 mA through 150 ohm, between the highest measured value 20.5 mA and the fault code 21 mA (NAMUR NE 43).";
    16 laser_maximum_rate_mm_per_s: f32 = 500.0, 1.0 ..= 100000.0, "laser.maximum_rate_mm_per_s", "mm/s",
        "The tip cannot move faster than this.";
    17 laser_required: bool = true, false ..= true, "laser.required", "",
        "Whether a laser that is not plausible vents; without it the rig works by pressure alone.";
    20 pressure_low_v: f32 = 0.6, 0.0 ..= 3.3, "pressure.low_v", "V",
        "Voltage at the pin for pressure.low_bar; 4 mA through 150 ohm is 0.6 V.";
    21 pressure_low_bar: f32 = 0.0, -1.0 ..= 20.0, "pressure.low_bar", "bar",
        "Pressure at pressure.low_v.";
    22 pressure_high_v: f32 = 3.0, 0.0 ..= 3.3, "pressure.high_v", "V",
        "Voltage at the pin for pressure.high_bar; 20 mA through 150 ohm is 3.0 V.";
    23 pressure_high_bar: f32 = 6.0, -1.0 ..= 20.0, "pressure.high_bar", "bar",
        "Pressure at pressure.high_v.";
    24 pressure_fault_below_v: f32 = 0.567, 0.0 ..= 3.3, "pressure.fault_below_v", "V",
        "A lower voltage is no measurement; see laser.fault_below_v.";
    25 pressure_fault_above_v: f32 = 3.12, 0.0 ..= 3.3, "pressure.fault_above_v", "V",
        "A higher voltage is no measurement; see laser.fault_above_v.";
    26 pressure_maximum_rate_bar_per_s: f32 = 200.0, 1.0 ..= 10000.0, "pressure.maximum_rate_bar_per_s", "bar/s",
        "The pneumatics cannot move the pressure faster than this.";
    30 rejected_ms: u32 = 5, 1 ..= 20, "plausibility.rejected_ms", "ms",
        "This long without an acceptable sample, a sensor is not plausible.";
    31 stuck_ms: u32 = 40, 5 ..= 10000, "plausibility.stuck_ms", "ms",
        "This long with the very same code, while the command moved, a sensor is stuck.";
    32 stuck_command_bar: f32 = 0.05, 0.001 ..= 4.0, "plausibility.stuck_command_bar", "bar",
        "Movement of the command that a live sensor cannot sleep through.";
    33 still_command_bar: f32 = 1.2, 0.1 ..= 4.0, "plausibility.still_command_bar", "bar",
        "Movement of the command, as the rig can follow it, during which a live sensor moves by more than 1 % of its range.";
    34 still_response_ms: f32 = 200.0, 1.0 ..= 10000.0, "plausibility.still_response_ms", "ms",
        "Time constant with which the rig is expected to follow for plausibility.still_command_bar.";
    40 mismatch_pressure_bar: f32 = 0.3, 0.01 ..= 4.0, "mismatch.pressure_bar", "bar",
        "Tolerated difference between measured and expected pressure.";
    41 mismatch_pressure_ms: u32 = 25, 1 ..= 10000, "mismatch.pressure_ms", "ms",
        "The pressure difference must last this long to be a fault.";
    42 pressure_response_ms: f32 = 20.0, 0.0 ..= 1000.0, "mismatch.pressure_response_ms", "ms",
        "Time constant of the first-order response expected between command and measured pressure.";
    43 mismatch_displacement_mm: f32 = 5.0, 0.0 ..= 1000.0, "mismatch.displacement_mm", "mm",
        "Tolerated difference between laser and model; 0 switches the check off.";
    44 mismatch_displacement_steps: u32 = 1, 1 ..= 1000, "mismatch.displacement_steps", "",
        "The difference must last this many model steps to be a fault.";
    50 valve_full_scale_bar: f32 = 5.0, 0.1 ..= 20.0, "valve.full_scale_bar", "bar",
        "Pressure that the valve gives at full drive.";
    51 valve_drive: u32 = 0, 0 ..= 1, "valve.drive", "",
        "How the valve is driven: 0 analogue (DAC), 1 pulse width (PWM).";
    52 pulse_hz: u32 = 20000, 20 ..= 20000, "valve.pulse_hz", "Hz",
        "Frequency of the pulse width: 20 kHz for a proportional valve's driver, 20 to 500 Hz for a fast switching valve.";
    53 valve_lowest_share: f32 = 0.0, 0.0 ..= 0.9, "valve.lowest_share", "",
        "Drive at which the valve begins to give pressure: a current's live zero, a switching valve's dead band; no demand is no drive at all.";
    54 valve_highest_share: f32 = 1.0, 0.1 ..= 1.0, "valve.highest_share", "",
        "Drive at which the valve gives valve.full_scale_bar.";
    60 control_law: u32 = 0, 0 ..= 2, "control.law", "",
        "What makes the demand: 0 playback of pressures, 1 pressure set-point, 2 tracking of displacements.";
    61 playback_period_ms: u32 = 20, 1 ..= 1000, "playback.period_ms", "ms",
        "Time from one playback point to the next; each is held until then.";
    62 feed_forward: u32 = 3, 0 ..= 4, "control.feed_forward", "",
        "What turns a displacement into a pressure: 0 nothing, 1 linear map, 2 inverse of the PI model, 3 inverse of the physics, 4 learned inverse.";
    63 feedback_sensor: u32 = 0, 0 ..= 3, "control.sensor", "",
        "What the feedback listens to: 0 nothing, 1 laser, 2 estimate, 3 both blended.";
    64 linear_mm_per_bar: f32 = 4.0, 0.01 ..= 1000.0, "control.linear_mm_per_bar", "mm/bar",
        "Slope of the linear map.";
    65 linear_offset_mm: f32 = 0.0, -1000.0 ..= 1000.0, "control.linear_offset_mm", "mm",
        "Displacement of the linear map at zero pressure.";
    66 learned_look_ahead_ms: u32 = 0, 0 ..= 500, "control.learned_look_ahead_ms", "ms",
        "How far ahead of now a learned inverse is shown the reference.";
    67 transfer_s: f32 = 0.2, 0.001 ..= 10.0, "control.transfer_s", "s",
        "Time constant with which the jump between two control laws fades.";
    68 outside_domain: u32 = 1, 0 ..= 2, "control.outside_domain", "",
        "Outside of what the model was trained on: 0 only say so, 1 fall back to the physics, 2 hold.";
    69 estimate_by_physics: bool = true, false ..= true, "control.estimate_by_physics", "",
        "Whether the estimate that stands in for the laser is that of the compensation's physics instead of the model's network.";
    70 estimator_input_measured: bool = false, false ..= true, "estimator.input_measured", "",
        "Whether the model sees the measured pressure instead of the commanded one.";
    80 telemetry_period_ms: u32 = 20, 1 ..= 10000, "telemetry.period_ms", "ms",
        "Time from one telemetry sample to the next.";
    90 maximum_late_ticks: u32 = 3, 1 ..= 20, "loop.maximum_late_ticks", "",
        "One more late or lost tick in a row than this vents.";
    100 pid_proportional: f32 = 0.0, 0.0 ..= 100.0, "pid.proportional", "",
        "Correction per error.";
    101 pid_integral_per_s: f32 = 0.0, 0.0 ..= 1000.0, "pid.integral_per_s", "1/s",
        "Correction rate per error.";
    102 pid_derivative_s: f32 = 0.0, 0.0 ..= 10.0, "pid.derivative_s", "s",
        "Correction per error rate.";
    103 pid_derivative_filter_s: f32 = 0.05, 0.0 ..= 10.0, "pid.derivative_filter_s", "s",
        "Time constant of the derivative's filter.";
    104 pid_limit_mm: f32 = 2.0, 0.0 ..= 1000.0, "pid.limit_mm", "mm",
        "Largest correction.";
    110 observer_time_constant_s: f32 = 0.3, 0.001 ..= 100.0, "observer.time_constant_s", "s",
        "How fast the blend of laser and model follows the laser.";
    111 observer_estimate_bound_mm: f32 = 1.0, 0.0 ..= 1000.0, "observer.estimate_bound_mm", "mm",
        "Bound on the error of the estimate alone.";
    112 observer_widening_mm_per_s: f32 = 0.01, 0.0 ..= 1000.0, "observer.widening_mm_per_s", "mm/s",
        "How fast the bound widens without the laser.";
    120 adaptation: bool = false, false ..= true, "adaptation.enabled", "",
        "Whether zero and gain of the estimate follow the laser; refused unless the conditions of its certificate hold.";
    121 adaptation_pivot_mm: f32 = 7.0, -1000.0 ..= 1000.0, "adaptation.pivot_mm", "mm",
        "Displacement about which the gain turns: the middle of the range in use.";
    122 adaptation_span_mm: f32 = 10.0, 0.1 ..= 1000.0, "adaptation.span_mm", "mm",
        "Length of the range in use.";
    123 adaptation_zero_limit_share: f32 = 0.15, 0.0 ..= 0.25, "adaptation.zero_limit_share", "",
        "Largest zero, share of the span.";
    124 adaptation_gain_minimum: f32 = 0.85, 0.8 ..= 1.0, "adaptation.gain_minimum", "",
        "Smallest gain.";
    125 adaptation_gain_maximum: f32 = 1.15, 1.0 ..= 1.25, "adaptation.gain_maximum", "",
        "Largest gain.";
    126 adaptation_time_constant_s: f32 = 60.0, 10.0 ..= 600.0, "adaptation.time_constant_s", "s",
        "How fast the zero follows the laser.";
    127 adaptation_gate_share: f32 = 0.05, 0.005 ..= 0.25, "adaptation.gate_share", "",
        "Difference of laser and adapted estimate that is still believed, share of the span; wider after a time without the laser.";
    128 adaptation_excitation_share: f32 = 0.1, 0.01 ..= 1.0, "adaptation.excitation_share", "",
        "Standard deviation of the estimate, share of the span, from which on the gain is adapted.";
    129 adaptation_loop_delay_ms: u32 = 120, 20 ..= 600, "adaptation.loop_delay_ms", "ms",
        "Delay from the feedback's correction to the estimate that the certificate is computed for; `catheter tune` knows it.";
}

/// The information on the setting with this name, for example `limits.ceiling_bar`.
pub fn by_name(name: &str) -> Option<&'static SettingInfo> {
    INFO.iter().find(|info| info.name == name)
}

/// The information on the setting with this number.
pub fn by_number(number: u16) -> Option<&'static SettingInfo> {
    INFO.iter().find(|info| info.number == number)
}

impl Settings {
    /// Numbers and values of the settings that differ from `other`, with `other`'s value behind.
    pub fn differences<'a>(&'a self, other: &'a Self) -> impl Iterator<Item = (u16, SettingValue, SettingValue)> + 'a {
        NUMBERS.iter().filter_map(|number| {
            let (mine, theirs) = (self.get(*number)?, other.get(*number)?);
            (mine != theirs).then_some((*number, mine, theirs))
        })
    }
}
