//! Carries out the instructions of a calibration ([`calibration::step`]) on a rig. Who places targets and reads the gauge is a [`Person`]: somebody at
//! a terminal, a file of answers, a page in a browser, or the simulation itself.

use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use calibration::step::{Finding, Instruction, Kind, Measurement, Plan, Sample, SensorMap, Step};
use model_export::link::message::{Quantity, Request, Telemetry};
use model_export::link::settings::{SettingValue, by_name};

use crate::backend::Rig;
use crate::device_settings;
use crate::energise::{self, Ended, Next};
use crate::experiment;
use crate::interrupt;
use crate::link::{Client, FACTS, Hardware, Transport, fault_in_words};

/// Telemetry of a quiet rig that is listened to, ms.
pub const LISTEN_PERIOD_MS: u32 = 5;
/// A target that was touched comes to rest, s.
pub const REST_S: f64 = 0.3;
/// Difference of command and measured pressure that is borne while that difference is what is measured, bar.
pub const BORNE_MISMATCH_BAR: f32 = 1.0;

/// What a person is asked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Question {
    /// To place a target at this distance of the laser's range, mm, and to say where it is.
    Target {
        /// Where, mm.
        distance_mm: f64,
    },
    /// To read the gauge, bar.
    Gauge {
        /// What the device was asked for, bar.
        command_bar: f64,
    },
}

/// Whoever places targets and reads gauges.
pub trait Person {
    /// Looks for the answer; called again and again until there is one, while the rig is kept alive. `hardware` is that of a simulated rig.
    ///
    /// # Errors
    /// When there will be no answer.
    fn answer(&mut self, question: &Question, hardware: Option<&mut Hardware>) -> Result<Option<f64>>;
}

/// What an operator may choose of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Choices {
    /// Distances at which a target is placed, mm.
    pub distances_mm: Vec<f64>,
    /// Pressures to compare with the gauge.
    pub pressure_levels: usize,
    /// How far the true pressure may come, share of the ceiling.
    pub highest_share: f64,
}

impl Default for Choices {
    fn default() -> Self {
        Self { distances_mm: vec![2.0, 6.0, 10.0, 14.0, 18.0], pressure_levels: 6, highest_share: 0.85 }
    }
}

/// Levels of the valve's staircase, one way.
const STAIRCASE_LEVELS: usize = 32;

/// The plan of a calibration with the settings that a rig has now. `highest_command_bar` is what an earlier pressure step allows.
///
/// # Errors
/// When the device is gone.
pub fn plan(rig: &mut Client<impl Transport>, choices: &Choices, highest_command_bar: Option<f64>) -> Result<Plan> {
    let mut number = |name: &str| -> Result<f64> {
        match device_settings::setting(rig, name)? {
            SettingValue::Float(value) => Ok(f64::from(value)),
            _ => bail!("{name} is no quantity"),
        }
    };
    let mut map = |sensor: &str, unit: &str| -> Result<SensorMap> {
        Ok(SensorMap {
            low_v: number(&format!("{sensor}.low_v"))?,
            low: number(&format!("{sensor}.low_{unit}"))?,
            high_v: number(&format!("{sensor}.high_v"))?,
            high: number(&format!("{sensor}.high_{unit}"))?,
        })
    };
    let (laser, pressure) = (map("laser", "mm")?, map("pressure", "bar")?);
    Ok(Plan {
        volts_per_code: f64::from(FACTS.converter.full_scale_v) / f64::from(FACTS.converter.full_scale_code),
        laser,
        pressure,
        lowest_share: number("valve.lowest_share")?,
        highest_drive_share: number("valve.highest_share")?,
        full_scale_bar: number("valve.full_scale_bar")?,
        ceiling_bar: number("limits.ceiling_bar")?,
        highest_share: choices.highest_share,
        highest_command_bar,
        distances_mm: choices.distances_mm.clone(),
        pressure_levels: choices.pressure_levels,
        staircase_levels: STAIRCASE_LEVELS,
    })
}

/// Carries out one instruction. The rig is idle and vented before and after, whatever happens in between.
///
/// # Errors
/// When the person has no answer, the device refuses or faults, samples are lost, or Ctrl-C was pressed.
pub fn carry_out(rig: &mut Client<Rig>, instruction: &Instruction, person: &mut dyn Person) -> Result<Measurement> {
    match instruction {
        Instruction::Listen { seconds } => listen(rig, *seconds, None),
        Instruction::PlaceTarget { distance_mm, seconds } => {
            let reference = wait_for(rig, person, &Question::Target { distance_mm: *distance_mm })?;
            rig.listen_for(Duration::from_secs_f64(REST_S))?;
            listen(rig, *seconds, Some(reference))
        }
        Instruction::HoldPressure { command_bar, settle_s, seconds } if *command_bar <= 0.0 => {
            rig.listen_for(Duration::from_secs_f64(*settle_s))?;
            let reference = wait_for(rig, person, &Question::Gauge { command_bar: 0.0 })?;
            listen(rig, *seconds, Some(reference))
        }
        Instruction::HoldPressure { command_bar, settle_s, seconds } => {
            let wanted = [
                ("telemetry.period_ms", SettingValue::Integer(LISTEN_PERIOD_MS)),
                ("control.law", SettingValue::Integer(1)),
                ("mismatch.pressure_bar", borne_mismatch(rig)?),
            ];
            safely(rig, &wanted, |rig| hold(rig, *command_bar as f32, *settle_s, *seconds, person))
        }
        Instruction::Play { period_ms, commands_bar } => {
            let wanted = [("mismatch.pressure_bar", borne_mismatch(rig)?)];
            safely(rig, &wanted, |rig| play(rig, *period_ms, commands_bar))
        }
    }
}

fn borne_mismatch(rig: &mut Client<Rig>) -> Result<SettingValue> {
    let name = "mismatch.pressure_bar";
    let SettingValue::Float(now_bar) = device_settings::setting(rig, name)? else { bail!("{name} is no pressure") };
    Ok(SettingValue::Float(now_bar.max(BORNE_MISMATCH_BAR)))
}

/// Does something with settings changed for its time; vents at the end and sets them back.
fn safely<R>(rig: &mut Client<Rig>, wanted: &[(&str, SettingValue)], work: impl FnOnce(&mut Client<Rig>) -> Result<R>) -> Result<R> {
    let borrowed = device_settings::borrow(rig, wanted)?;
    let done = work(rig);
    let vented = energise::vent(rig);
    let returned = device_settings::give_back(rig, borrowed);
    let done = done?;
    let (vented, _) = vented?;
    ensure!(vented, "the measured pressure was not seen below 0.1 bar after venting: close the supply by hand");
    returned?;
    Ok(done)
}

/// Asks, and lets time pass until there is an answer.
fn wait_for(rig: &mut Client<Rig>, person: &mut dyn Person, question: &Question) -> Result<f64> {
    loop {
        ensure!(!interrupt::is_requested(), "interrupted");
        if let Some(answer) = person.answer(question, rig.transport().hardware())? {
            return Ok(answer);
        }
        rig.listen(Duration::from_millis(20))?;
        rig.begin_account();
    }
}

/// The codes of a vented rig.
fn listen(rig: &mut Client<Rig>, seconds: f64, reference: Option<f64>) -> Result<Measurement> {
    let borrowed = device_settings::borrow(rig, &[("telemetry.period_ms", SettingValue::Integer(LISTEN_PERIOD_MS))])?;
    rig.listen_for(Duration::from_millis(50))?;
    rig.begin_account();
    let until = rig.elapsed() + Duration::from_secs_f64(seconds);
    let (mut laser, mut pressure) = (Vec::new(), Vec::new());
    while rig.elapsed() < until && !interrupt::is_requested() {
        rig.listen(Duration::from_millis(20))?;
        while let Some(sample) = rig.take_telemetry() {
            laser.push(sample.laser_code);
            pressure.push(sample.pressure_code);
        }
    }
    device_settings::give_back(rig, borrowed)?;
    ensure!(!interrupt::is_requested(), "interrupted");
    Ok(Measurement::Codes { reference, laser, pressure })
}

/// Holds a pressure, has the gauge read, listens.
fn hold(rig: &mut Client<Rig>, command_bar: f32, settle_s: f64, seconds: f64, person: &mut dyn Person) -> Result<Measurement> {
    energise::arm(rig)?;
    let question = Question::Gauge { command_bar: f64::from(command_bar) };
    let (mut laser, mut pressure) = (Vec::new(), Vec::new());
    let (mut begin_ms, mut read): (Option<u64>, Option<(f64, u64)>) = (None, None);
    let mut each = |transport: &mut Rig, sample: &Telemetry| -> Result<Next> {
        let since_s = |from_ms: u64| sample.time_ms.saturating_sub(from_ms) as f64 * 1e-3;
        if since_s(*begin_ms.get_or_insert(sample.time_ms)) < settle_s {
            return Ok(Next::Hold(command_bar));
        }
        let Some((_, from_ms)) = read else {
            read = person.answer(&question, transport.hardware())?.map(|gauge_bar| (gauge_bar, sample.time_ms));
            return Ok(Next::Hold(command_bar));
        };
        laser.push(sample.laser_code);
        pressure.push(sample.pressure_code);
        Ok(if since_s(from_ms) >= seconds { Next::End } else { Next::Hold(command_bar) })
    };
    match energise::run(rig, Quantity::Pressure, command_bar, &mut each)? {
        Ended::AsAsked => Ok(Measurement::Codes { reference: read.map(|(gauge_bar, _)| gauge_bar), laser, pressure }),
        Ended::Interrupted => bail!("interrupted; the rig was vented"),
        Ended::Fault(record) => {
            bail!("the rig vented with {}; `catheter explain` with that number says what to do", fault_in_words(record.first))
        }
        Ended::Left(_) => bail!("the rig stopped by itself"),
    }
}

fn play(rig: &mut Client<Rig>, period_ms: u32, commands_bar: &[f64]) -> Result<Measurement> {
    let points: Vec<f32> = commands_bar.iter().map(|bar| *bar as f32).collect();
    let outcome = experiment::record_points(rig, &points, period_ms, None)?;
    if let Some(record) = &outcome.fault {
        bail!("the rig vented with {}; `catheter explain` with that number says what to do", fault_in_words(record.first));
    }
    let lost = outcome.account.dropped_by_device + outcome.account.lost_on_the_line;
    ensure!(lost == 0, "{lost} samples were lost on the way; repeat the step");
    let begin_ms = outcome.samples.first().context("no sample arrived")?.time_ms;
    let sample = |sample: &Telemetry| Sample {
        time_s: (sample.time_ms - begin_ms) as f64 * 1e-3,
        command_bar: f64::from(sample.output_ubar) * 1e-6,
        laser_code: sample.laser_code,
        pressure_code: sample.pressure_code,
    };
    Ok(Measurement::Course(outcome.samples.iter().map(sample).collect()))
}

/// Settings of a device before and after.
pub type Change = (&'static str, SettingValue, SettingValue);

/// Puts what a step found into use, without saving it; gives what changed.
///
/// # Errors
/// When the device refuses; then nothing is changed.
pub fn apply(rig: &mut Client<impl Transport>, finding: &Finding) -> Result<Vec<Change>> {
    let mut changes: Vec<Change> = Vec::new();
    for (name, value) in &finding.settings {
        let info = by_name(name).with_context(|| format!("there is no setting {name}"))?;
        let (before, after) = (device_settings::setting(rig, name)?, SettingValue::Float(*value as f32));
        if let Err(error) = rig.command(&Request::SettingSet { number: info.number, value: after }) {
            for (name, before, _) in changes.iter().rev() {
                let number = by_name(name).map_or(0, |info| info.number);
                rig.command(&Request::SettingSet { number, value: *before })?;
            }
            return Err(error).with_context(|| format!("{name} = {value}"));
        }
        changes.push((info.name, before, after));
    }
    Ok(changes)
}

/// How far the steps behind this one may ask, in what a command means to the device once the finding is in use, bar; `before_bar` is what the steps
/// before it said.
#[must_use]
pub fn highest_command_bar(step: &Step, finding: &Finding, before_bar: Option<f64>) -> Option<f64> {
    let calibrated = |name: &str| finding.settings.iter().find(|(known, _)| *known == name).map(|(_, value)| *value);
    match finding.kind {
        Kind::Pressure => step.highest_command_bar(),
        // From here on a command is a pressure, and the same pressure is asked for.
        Kind::Valve => before_bar.zip(calibrated("valve.full_scale_bar")).map(|(command_bar, full_scale_bar)| {
            let share = step.drive_share(command_bar);
            let begin = calibrated("valve.lowest_share").unwrap_or(0.0);
            (full_scale_bar * (share - begin) / (1.0 - begin)).max(0.0)
        }),
        _ => before_bar,
    }
}

/// Adds a step's changes to those of the steps before it: each setting once, with what it was before all of them.
pub fn merge(changes: &mut Vec<Change>, more: Vec<Change>) {
    for change in more {
        match changes.iter_mut().find(|(name, ..)| *name == change.0) {
            Some(known) => known.2 = change.2,
            None => changes.push(change),
        }
    }
}
