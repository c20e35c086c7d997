//! One instruction of a calibration on an operated rig, from the samples that come anyway. It sends nothing: a device whose operator is silent gets no
//! word from here.

use anyhow::{Result, ensure};
use calibration::step::{Instruction, Measurement, Sample};
use model_export::link::message::Telemetry;
use model_export::link::state::State;

use crate::calibrate::{LISTEN_PERIOD_MS, Question, REST_S};

/// What an instruction has so far.
pub struct Measuring {
    instruction: Instruction,
    question: Option<Question>,
    /// From the first sample to the question, s.
    before_s: f64,
    /// From the answer to the first sample that counts, s.
    after_s: f64,
    /// Time over which codes are collected, s.
    seconds: f64,
    begin_ms: Option<u64>,
    asks: bool,
    answer: Option<f64>,
    answered_ms: Option<u64>,
    laser: Vec<u16>,
    pressure: Vec<u16>,
    course: Vec<Sample>,
    course_ms: Option<u64>,
    last_sequence: Option<u32>,
    lost: u32,
    complete: bool,
}

impl Measuring {
    /// Nothing of it is done yet.
    pub fn new(instruction: Instruction) -> Self {
        let (question, before_s, after_s, seconds) = match &instruction {
            Instruction::Listen { seconds } => (None, 0.05, 0.0, *seconds),
            Instruction::PlaceTarget { distance_mm, seconds } => {
                (Some(Question::Target { distance_mm: *distance_mm }), 0.0, REST_S, *seconds)
            }
            Instruction::HoldPressure { command_bar, settle_s, seconds } => {
                (Some(Question::Gauge { command_bar: *command_bar }), *settle_s, 0.0, *seconds)
            }
            Instruction::Play { .. } => (None, 0.0, 0.0, f64::INFINITY),
        };
        Self {
            instruction,
            question,
            before_s,
            after_s,
            seconds,
            begin_ms: None,
            asks: false,
            answer: None,
            answered_ms: None,
            laser: Vec::new(),
            pressure: Vec::new(),
            course: Vec::new(),
            course_ms: None,
            last_sequence: None,
            lost: 0,
            complete: false,
        }
    }

    /// Whether the rig has to be under pressure.
    pub fn energises(&self) -> bool {
        match &self.instruction {
            Instruction::HoldPressure { command_bar, .. } => *command_bar > 0.0,
            Instruction::Play { .. } => true,
            Instruction::Listen { .. } | Instruction::PlaceTarget { .. } => false,
        }
    }

    /// What a person is asked now.
    pub fn asks(&self) -> Option<Question> {
        self.question.filter(|_| self.asks)
    }

    /// The answer.
    ///
    /// # Errors
    /// When nothing is asked, or it is no number.
    pub fn answer(&mut self, value: f64) -> Result<()> {
        ensure!(self.asks, "nothing is asked now");
        ensure!(value.is_finite(), "a number is wanted");
        (self.asks, self.answer, self.answered_ms) = (false, Some(value), None);
        Ok(())
    }

    /// Whether all of it is measured.
    pub fn is_complete(&self) -> bool {
        self.complete
    }

    /// The device stopped at the end of what it was given to play.
    pub fn has_played(&mut self) {
        if matches!(self.instruction, Instruction::Play { .. }) && !self.course.is_empty() {
            self.complete = true;
        }
    }

    /// How far it is, 0 to 1; waiting for a person is no progress.
    pub fn share(&self) -> f64 {
        match &self.instruction {
            Instruction::Play { period_ms, commands_bar } => {
                let length_s = f64::from(*period_ms) * 1e-3 * commands_bar.len() as f64;
                self.course.last().map_or(0.0, |sample| sample.time_s / length_s).min(1.0)
            }
            _ => (self.laser.len() as f64 * f64::from(LISTEN_PERIOD_MS) * 1e-3 / self.seconds).min(1.0),
        }
    }

    /// Takes a sample; those of a rig that is not in the state that the instruction wants do not count.
    pub fn see(&mut self, told: &Telemetry) {
        if self.complete || (self.energises() && told.state != State::Running) {
            return;
        }
        if let Instruction::Play { period_ms, .. } = self.instruction {
            return self.see_played(told, period_ms);
        }
        let since_s = |from_ms: u64| told.time_ms.saturating_sub(from_ms) as f64 * 1e-3;
        if since_s(*self.begin_ms.get_or_insert(told.time_ms)) < self.before_s {
            return;
        }
        if self.question.is_some() && self.answer.is_none() {
            self.asks = true;
            return;
        }
        let rest_ms = (self.after_s * 1e3) as u64;
        let answered_ms = *self.answered_ms.get_or_insert(told.time_ms);
        let Some(since_ms) = told.time_ms.checked_sub(answered_ms + rest_ms) else { return };
        // As often as `rig calibrate` listens.
        if since_ms % u64::from(LISTEN_PERIOD_MS) == 0 {
            self.laser.push(told.laser_code);
            self.pressure.push(told.pressure_code);
        }
        self.complete = since_s(answered_ms + rest_ms) >= self.seconds;
    }

    /// Keeps one sample a period, as `rig calibrate` has them: what follows counts samples.
    fn see_played(&mut self, told: &Telemetry, period_ms: u32) {
        if let Some(last) = self.last_sequence {
            self.lost += told.sequence.wrapping_sub(last).wrapping_sub(1).min(1000);
        }
        self.last_sequence = Some(told.sequence);
        if told.playback_index == 0 {
            return;
        }
        let since_ms = told.time_ms.saturating_sub(*self.course_ms.get_or_insert(told.time_ms));
        if since_ms.is_multiple_of(u64::from(period_ms)) {
            self.course.push(Sample {
                time_s: since_ms as f64 * 1e-3,
                command_bar: f64::from(told.output_ubar) * 1e-6,
                laser_code: told.laser_code,
                pressure_code: told.pressure_code,
            });
        }
    }

    /// What came of it.
    ///
    /// # Errors
    /// When samples of a course were lost, or its commands came late.
    pub fn finish(self) -> Result<Measurement> {
        if let Instruction::Play { commands_bar, .. } = &self.instruction {
            ensure!(self.lost == 0, "{} samples were lost on the way; repeat the step", self.lost);
            let (found, wanted) = (self.course.len(), commands_bar.len());
            ensure!(
                found.abs_diff(wanted) <= 2 + wanted / 100,
                "the device played {found} periods instead of {wanted}: commands came late, this computer is busy; repeat the step"
            );
            return Ok(Measurement::Course(self.course));
        }
        Ok(Measurement::Codes { reference: self.answer, laser: self.laser, pressure: self.pressure })
    }
}
