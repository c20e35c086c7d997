//! The sequence of instructions of a step.

use super::kind::Kind;
use super::plan::{Instruction, Measurement, Plan, Sample};
use crate::CalibrationError;
use crate::valve::Level;

/// A level or distance with the mean codes that belong to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Point {
    pub(super) command_bar: f64,
    pub(super) reference: f64,
    pub(super) code: f64,
}

/// A step under way.
#[derive(Clone, Debug)]
pub struct Step {
    pub(super) kind: Kind,
    pub(super) plan: Plan,
    pub(super) points: Vec<Point>,
    pub(super) codes: Option<(Vec<f64>, Vec<f64>)>,
    pub(super) course: Option<Vec<Sample>>,
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
pub(super) const RESPONSE_PERIOD_MS: u32 = 2;
/// Time at each level of the step response, ms.
pub(super) const STEP_MS: u32 = 600;
/// Steps up and down.
pub(super) const STEPS: u32 = 6;

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
                 gauge; the ceiling is {:.2} bar. You read the gauge at each. It is vented at the end, and whenever you end the step.",
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
                 away.",
                self.low_bar(),
                self.high_bar()
            ),
        }
    }

    pub(super) fn low_bar(&self) -> f64 {
        0.35 * self.plan.top_bar()
    }

    pub(super) fn high_bar(&self) -> f64 {
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

    pub(super) fn staircase(&self, dwell: u32) -> Vec<f64> {
        let count = self.plan.staircase_levels;
        let level = |index: usize| self.plan.top_bar() * index as f64 / count as f64;
        let up = (1..=count).map(level);
        let down = (1..count).rev().map(level);
        up.chain(down).flat_map(|bar| std::iter::repeat_n(bar, dwell as usize)).collect()
    }

    pub(super) fn steps(&self) -> Vec<f64> {
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
    pub(super) fn levels(&self, course: &[Sample]) -> Vec<Level> {
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
