//! What the device tells of its measurements: the samples it sends unasked, and the noise of its channels at rest.
//!
//! # Example
//! ```
//! use model_export::link::message::Message;
//! use model_export::link::telemetry::{RestNoise, Telemetry};
//!
//! let sample = Telemetry { sequence: 1000, time_ms: 20_000, command_bar: 1.25, estimate_mm: Some(6.5), ..Telemetry::default() };
//! assert_eq!(sample.displacement_mm, None, "the laser has no measurement");
//! assert!(sample.to_wire().is_ok());
//!
//! let noise = RestNoise { laser_codes: 1.5, laser_mm: 0.005, pressure_codes: 2.25, pressure_bar: 0.002 };
//! assert!(noise.laser_mm < 0.01);
//! ```

use serde::{Deserialize, Serialize};

use super::fault::NoticeSet;
use super::state::State;

/// One sample of what the rig does. Best effort: a full queue drops samples, and the sequence numbers and the count show it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Telemetry {
    /// Counts samples made, dropped ones included.
    pub sequence: u32,
    /// Device time of the sample, ms since the start.
    pub time_ms: u64,
    /// Samples dropped since the start.
    pub dropped: u32,
    /// State.
    pub state: State,
    /// Number of the first fault, 0 without one.
    pub first_fault: u8,
    /// What is limited or degraded.
    pub notices: NoticeSet,
    /// Laser code as sampled.
    pub laser_code: u16,
    /// Pressure code as sampled.
    pub pressure_code: u16,
    /// What goes to the valve at this moment.
    pub output_ubar: i32,
    /// What went to the valve, filtered like the measured channels.
    pub command_bar: f32,
    /// Set-point in force, in the control law's quantity.
    pub set_point: f32,
    /// Filtered measured pressure; `None` while not plausible.
    pub pressure_bar: Option<f32>,
    /// Filtered displacement; `None` while not plausible.
    pub displacement_mm: Option<f32>,
    /// The model's estimate; `None` without one.
    pub estimate_mm: Option<f32>,
    /// Index of the playback point in force.
    pub playback_index: u32,
    /// Ticks that came late or were lost since the start: missed deadlines.
    pub late_ticks: u32,
    /// Longest tick since the start, in processor cycles; 0 if not measured.
    pub longest_tick_cycles: u32,
    /// Bytes of stack never used since the start; 0 if not measured.
    pub stack_unused_bytes: u32,
    /// Analogue supply by the chip's reference voltage; `None` where it is not measured.
    pub supply_v: Option<f32>,
    /// Temperature of the chip; `None` where it is not measured.
    pub chip_celsius: Option<f32>,
}

/// How much a measured channel scatters while the rig is vented: root mean square about the mean, over the last whole second at rest. Mains hum
/// and a bad ground show here before they show in a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RestNoise {
    /// Of the laser, in codes.
    pub laser_codes: f32,
    /// Of the laser, in mm.
    pub laser_mm: f32,
    /// Of the measured pressure, in codes.
    pub pressure_codes: f32,
    /// Of the measured pressure, in bar.
    pub pressure_bar: f32,
}
