//! What the steps need to know of the rig, what they ask for and what they get.

use serde::Serialize;

/// Two points of a sensor's map as the device has them: voltages at the pin, and what they mean.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorMap {
    /// Voltage at the lower point, V.
    pub low_v: f64,
    /// What it means, in the sensor's unit.
    pub low: f64,
    /// Voltage at the upper point, V.
    pub high_v: f64,
    /// What it means, in the sensor's unit.
    pub high: f64,
}

impl SensorMap {
    /// What a voltage means.
    #[must_use]
    pub fn value(&self, volts: f64) -> f64 {
        self.low + (volts - self.low_v) / (self.high_v - self.low_v) * (self.high - self.low)
    }
}

/// What the steps need to know of the rig.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Volts per code.
    pub volts_per_code: f64,
    /// The laser's map in use.
    pub laser: SensorMap,
    /// The pressure sensor's map in use.
    pub pressure: SensorMap,
    /// Drive at which the device lets the valve begin, share of full.
    pub lowest_share: f64,
    /// Drive at full scale, share of full.
    pub highest_drive_share: f64,
    /// Pressure that the device expects there, bar.
    pub full_scale_bar: f64,
    /// No pressure may exceed this, bar.
    pub ceiling_bar: f64,
    /// How far the true pressure may come, share of the ceiling.
    pub highest_share: f64,
    /// Highest command of the steps that follow the gauge, bar; known once the pressure step was done.
    pub highest_command_bar: Option<f64>,
    /// Distances at which a target is placed before the laser, mm.
    pub distances_mm: Vec<f64>,
    /// Pressures to compare with the gauge.
    pub pressure_levels: usize,
    /// Levels of the valve's staircase, one way.
    pub staircase_levels: usize,
}

impl Plan {
    /// The drive that the device gives for a command, share of full.
    #[must_use]
    pub fn drive_share(&self, command_bar: f64) -> f64 {
        if command_bar <= 0.0 {
            return 0.0;
        }
        self.lowest_share + (self.highest_drive_share - self.lowest_share) * (command_bar / self.full_scale_bar).min(1.0)
    }

    /// Highest command of the steps that do not watch the gauge, bar.
    pub(super) fn top_bar(&self) -> f64 {
        self.highest_command_bar.unwrap_or(0.8 * self.highest_share * self.ceiling_bar)
    }
}

/// What is to be done next.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "do", rename_all = "kebab-case")]
pub enum Instruction {
    /// Listen to both channels while the rig is vented.
    Listen {
        /// For this long, s.
        seconds: f64,
    },
    /// Have a target placed at this distance of the laser's range, then listen while vented. The measurement's reference is the distance.
    PlaceTarget {
        /// Where, mm.
        distance_mm: f64,
        /// How long to listen, s.
        seconds: f64,
    },
    /// Hold a pressure, have the gauge read, then listen. The measurement's reference is what the gauge reads. A command of zero is held vented.
    HoldPressure {
        /// What to ask the device for, bar.
        command_bar: f64,
        /// How long to wait before the gauge is read, s.
        settle_s: f64,
        /// How long to listen, s.
        seconds: f64,
    },
    /// Play commands, one each period, and bring what both channels gave at each.
    Play {
        /// Milliseconds from one command to the next.
        period_ms: u32,
        /// The commands, bar.
        commands_bar: Vec<f64>,
    },
}

/// A sample of a course that was played.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Time since the first command, s.
    pub time_s: f64,
    /// What went to the valve, bar.
    pub command_bar: f64,
    /// Code of the laser.
    pub laser_code: u16,
    /// Code of the pressure sensor.
    pub pressure_code: u16,
}

/// What came of an instruction.
#[derive(Clone, Debug, PartialEq)]
pub enum Measurement {
    /// Of listening.
    Codes {
        /// Distance or gauge reading, in mm or bar; nothing where none was asked for.
        reference: Option<f64>,
        /// Codes of the laser.
        laser: Vec<u16>,
        /// Codes of the pressure sensor.
        pressure: Vec<u16>,
    },
    /// Of playing.
    Course(Vec<Sample>),
}
