//! The steps of a calibration, each a sequence of instructions and what came of them. No input or output happens here.
//!
//! ```text
//! Step::new(kind, plan) ─► explanation() ─► next() ─► Instruction ─► (somebody carries it out) ─► take(Measurement) ─► next() ... ─► finding()
//! ```
//!
//! What a step measures above the ceiling is nothing: pressures are approached from below, each level only as far as the gauge's readings so far
//! say that the true pressure stays below [`Plan::highest_share`] of the ceiling, and a reading above the ceiling ends the step.

mod finding;
mod findings;

pub use finding::{Curve, Finding, Quantity};
use serde::Serialize;

use crate::CalibrationError;
use crate::valve::Level;

/// What is calibrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The noise of both channels while nothing moves.
    Noise,
    /// Zero and span of the laser, from targets at known distances.
    Laser,
    /// Zero and span of the pressure sensor, against a gauge.
    Pressure,
    /// Dead band, hysteresis and full scale of the valve.
    Valve,
    /// Fill and vent times, and the delay from command to laser.
    Response,
}

impl Kind {
    /// All kinds, in the order in which they build on each other.
    pub const ALL: [Self; 5] = [Self::Noise, Self::Laser, Self::Pressure, Self::Valve, Self::Response];

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Noise => "noise",
            Self::Laser => "laser",
            Self::Pressure => "pressure",
            Self::Valve => "valve",
            Self::Response => "response",
        }
    }
}

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
    fn top_bar(&self) -> f64 {
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

/// A level or distance with the mean codes that belong to it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Point {
    command_bar: f64,
    reference: f64,
    code: f64,
}

/// A step under way.
#[derive(Clone, Debug)]
pub struct Step {
    kind: Kind,
    plan: Plan,
    points: Vec<Point>,
    codes: Option<(Vec<f64>, Vec<f64>)>,
    course: Option<Vec<Sample>>,
}

/// Listening at rest, s: long enough that the mean of two codes of noise is known to a tenth of a code.
const LISTEN_S: f64 = 2.0;
/// For the noise floor, s.
const NOISE_S: f64 = 5.0;
/// A held pressure settles within this, s.
const SETTLE_S: f64 = 1.0;
/// Dwell at a level of the staircase, ms, of which the last part is used.
const DWELL_MS: u32 = 300;
/// Period of a staircase's commands, ms.
const STAIRCASE_PERIOD_MS: u32 = 20;
/// Period of the commands and samples of the step response, ms.
const RESPONSE_PERIOD_MS: u32 = 2;
/// Time at each level of the step response, ms.
const STEP_MS: u32 = 600;
/// Steps up and down.
const STEPS: u32 = 6;

impl Step {
    /// Begins a step.
    #[must_use]
    pub fn new(kind: Kind, plan: &Plan) -> Self {
        Self { kind, plan: plan.clone(), points: Vec::new(), codes: None, course: None }
    }

    /// What it calibrates.
    #[must_use]
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// Begins again.
    pub fn repeat(&mut self) {
        *self = Self::new(self.kind, &self.plan);
    }

    /// What will happen, for the person at the rig, before anything does.
    #[must_use]
    pub fn explanation(&self) -> String {
        let plan = &self.plan;
        match self.kind {
            Kind::Noise => {
                format!("Listens to both sensors for {NOISE_S} s. The rig stays vented; nothing moves. Do not touch it meanwhile.")
            }
            Kind::Laser => format!(
                "Compares the laser with {} known distances: {} mm of its range. The rig stays vented. You place a target (gauge blocks, a \
                 micrometer stage) at each.",
                plan.distances_mm.len(),
                plan.distances_mm.iter().map(f64::to_string).collect::<Vec<_>>().join(", ")
            ),
            Kind::Pressure => format!(
                "Compares the pressure sensor with your gauge at {} levels. THE RIG IS PRESSURISED, in rising steps, to at most {:.2} bar by the \
                 gauge; the ceiling is {:.2} bar. You read the gauge at each. It is vented at the end and on Ctrl-C.",
                plan.pressure_levels,
                plan.highest_share * plan.ceiling_bar,
                plan.ceiling_bar
            ),
            Kind::Valve => format!(
                "Maps the valve. THE RIG IS PRESSURISED in {} small steps up to {:.2} bar and down again, in {:.0} s, without you.",
                plan.staircase_levels,
                plan.top_bar(),
                f64::from(2 * DWELL_MS) * 1e-3 * plan.staircase_levels as f64
            ),
            Kind::Response => format!(
                "Measures fill and vent times, and the delay from command to laser. THE RIG JUMPS {STEPS} times between {:.2} and {:.2} bar; keep \
                 hands away.",
                self.low_bar(),
                self.high_bar()
            ),
        }
    }

    fn low_bar(&self) -> f64 {
        0.35 * self.plan.top_bar()
    }

    fn high_bar(&self) -> f64 {
        0.75 * self.plan.top_bar()
    }

    /// What is to be done next; `None` when the step is complete.
    #[must_use]
    pub fn next(&self) -> Option<Instruction> {
        let plan = &self.plan;
        match self.kind {
            Kind::Noise => self.codes.is_none().then_some(Instruction::Listen { seconds: NOISE_S }),
            Kind::Laser => {
                let distance_mm = *plan.distances_mm.get(self.points.len())?;
                Some(Instruction::PlaceTarget { distance_mm, seconds: LISTEN_S })
            }
            Kind::Pressure => (self.points.len() < plan.pressure_levels).then(|| Instruction::HoldPressure {
                command_bar: self.next_command_bar(),
                settle_s: SETTLE_S,
                seconds: LISTEN_S,
            }),
            Kind::Valve => self.course.is_none().then(|| Instruction::Play {
                period_ms: STAIRCASE_PERIOD_MS,
                commands_bar: self.staircase(DWELL_MS / STAIRCASE_PERIOD_MS),
            }),
            Kind::Response => {
                self.course.is_none().then(|| Instruction::Play { period_ms: RESPONSE_PERIOD_MS, commands_bar: self.steps() })
            }
        }
    }

    /// The next pressure to compare with the gauge: as far up as what the gauge said so far allows.
    fn next_command_bar(&self) -> f64 {
        let plan = &self.plan;
        let top_bar = plan.highest_share * plan.ceiling_bar;
        let count = self.points.len();
        if count == 0 {
            return 0.0;
        }
        let wanted_bar = top_bar * count as f64 / (plan.pressure_levels - 1).max(1) as f64;
        // How much more the gauge may read per commanded bar: what was seen, and in the first step twice what the data sheet says.
        let last = self.points[count - 1];
        let steepest = self
            .points
            .windows(2)
            .map(|pair| (pair[1].reference - pair[0].reference) / (pair[1].command_bar - pair[0].command_bar).max(1e-6))
            .fold(1.0, f64::max);
        let steepest = if count == 1 { 2.0 } else { 1.1 * steepest };
        wanted_bar.min(last.command_bar + (top_bar - last.reference).max(0.0) / steepest)
    }

    /// The drive that the device gave for a command while this step ran, share of full.
    #[must_use]
    pub fn drive_share(&self, command_bar: f64) -> f64 {
        self.plan.drive_share(command_bar)
    }

    /// The largest command that the gauge allows, bar; `None` before the pressure step has its levels.
    #[must_use]
    pub fn highest_command_bar(&self) -> Option<f64> {
        let last = self.points.last().filter(|_| self.kind == Kind::Pressure && self.next().is_none())?;
        Some(last.command_bar)
    }

    fn staircase(&self, dwell: u32) -> Vec<f64> {
        let count = self.plan.staircase_levels;
        let level = |index: usize| self.plan.top_bar() * index as f64 / count as f64;
        let up = (1..=count).map(level);
        let down = (1..count).rev().map(level);
        up.chain(down).flat_map(|bar| std::iter::repeat_n(bar, dwell as usize)).collect()
    }

    fn steps(&self) -> Vec<f64> {
        let length = (STEP_MS / RESPONSE_PERIOD_MS) as usize;
        // Begins low: the way there from nothing is no step of the series.
        (0..=2 * STEPS)
            .flat_map(|index| std::iter::repeat_n(if index % 2 == 0 { self.low_bar() } else { self.high_bar() }, length))
            .collect()
    }

    /// Takes what came of the instruction.
    ///
    /// # Errors
    /// When it is of another kind, not a number, or shows that something is wrong.
    pub fn take(&mut self, measurement: Measurement) -> Result<(), CalibrationError> {
        let mean = |codes: &[u16]| codes.iter().map(|code| f64::from(*code)).sum::<f64>() / codes.len() as f64;
        let enough = |codes: &[u16]| if codes.len() < 8 { Err(CalibrationError::TooFew { found: codes.len(), wanted: 8 }) } else { Ok(()) };
        match (self.kind, self.next(), measurement) {
            (Kind::Noise, Some(_), Measurement::Codes { laser, pressure, .. }) => {
                enough(&laser)?;
                enough(&pressure)?;
                let numbers = |codes: Vec<u16>| codes.into_iter().map(f64::from).collect();
                self.codes = Some((numbers(laser), numbers(pressure)));
            }
            (Kind::Laser, Some(_), Measurement::Codes { reference: Some(reference), laser, .. }) => {
                enough(&laser)?;
                if !reference.is_finite() {
                    return Err(CalibrationError::NotFinite("the distance"));
                }
                self.points.push(Point { command_bar: 0.0, reference, code: mean(&laser) });
            }
            (
                Kind::Pressure,
                Some(Instruction::HoldPressure { command_bar, .. }),
                Measurement::Codes { reference: Some(reference), pressure, .. },
            ) => {
                enough(&pressure)?;
                if !reference.is_finite() {
                    return Err(CalibrationError::NotFinite("the gauge's reading"));
                }
                if reference > self.plan.ceiling_bar {
                    return Err(CalibrationError::AboveCeiling { gauge_bar: reference, ceiling_bar: self.plan.ceiling_bar });
                }
                self.points.push(Point { command_bar, reference, code: mean(&pressure) });
            }
            (Kind::Valve | Kind::Response, Some(_), Measurement::Course(course)) => {
                if course.len() < 8 {
                    return Err(CalibrationError::TooFew { found: course.len(), wanted: 8 });
                }
                self.course = Some(course);
            }
            _ => return Err(CalibrationError::WrongKind),
        }
        Ok(())
    }

    /// The levels of the staircase: commands and the pressures at the end of each dwell.
    fn levels(&self, course: &[Sample]) -> Vec<Level> {
        let mut levels: Vec<Level> = Vec::new();
        let mut begin = 0;
        let mut highest = 0.0;
        while begin < course.len() {
            let command_bar = course[begin].command_bar;
            let length = course[begin..].iter().take_while(|sample| (sample.command_bar - command_bar).abs() < 1e-4).count().max(1);
            // The last 40 % of the dwell.
            let settled = &course[begin + length * 3 / 5..begin + length];
            if length >= 5 {
                let code = settled.iter().map(|sample| f64::from(sample.pressure_code)).sum::<f64>() / settled.len() as f64;
                let pressure_bar = self.plan.pressure.value(code * self.plan.volts_per_code);
                levels.push(Level { share: self.plan.drive_share(command_bar), pressure_bar, rising: command_bar > highest });
                highest = command_bar.max(highest);
            }
            begin += length;
        }
        levels
    }
}
