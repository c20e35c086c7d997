//! `catheter rig`: speaks to a board, to a model of it, to the emulator or to a rig in this process.

mod adaptation;
mod calibrate;
mod firmware;
mod log;
mod model;
mod monitor;
mod motion;
mod reading;
mod record;
mod settings;
mod state;
mod which;

use std::io::Write;
use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Subcommand};
use model_export::link::message::Request;

use which::{Which, open};

pub(crate) use calibrate::today;
pub(crate) use which::read_hardware;

use super::Outcome;
use crate::experiment;
use crate::link::Client;
use crate::output;

/// Speak to a rig: who is there, what state it is in, settings, models, recordings.
#[derive(Args)]
pub struct Arguments {
    #[command(flatten)]
    which: Which,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Who is there: firmware, board, protocol, model, cause of the last reset. Works with every version of the firmware.
    Hello,
    /// The state, what is latched, what would refuse arming, what the sensors read, counters.
    Status,
    /// What the rig reads, as it comes; to a file too.
    Monitor(monitor::Arguments),
    /// Idle to armed: the dump valve closes, the output stays zero. A board stays armed until arming.timeout_s is over.
    Arm(motion::ArmArguments),
    /// To idle, vented.
    Disarm,
    /// Armed to running, with a control law for set-points; the set-point stays where it is. Vents at the end and on Ctrl-C.
    Start(motion::While),
    /// Running to armed, the output to zero at the slew limit.
    Stop,
    /// Hold a pressure. Vents at the end and on Ctrl-C.
    Hold(motion::HoldArguments),
    /// Go to a displacement and stay there, by the controller that the settings choose. Vents at the end and on Ctrl-C.
    Move(motion::MoveArguments),
    /// Change the pressure in small steps, by keys or by the lines of a script on standard input. Vents at the end and on Ctrl-C.
    Jog(motion::JogArguments),
    /// Calibrate laser, pressure sensor and valve, step by step, with a page of curves and intervals.
    Calibrate(calibrate::Arguments),
    /// What is wrong and what to do: faults with their record, blockers, notices.
    Explain(state::ExplainArguments),
    Log(log::Arguments),
    /// Put a new program onto a board.
    #[command(subcommand)]
    Firmware(firmware::Command),
    /// Go to idle with the dump valve released, and wait until the pressure is gone; exit code 1 if it is not within 1.5 s.
    Vent,
    /// Confirm that a fault was read and its cause removed; the device tests itself again.
    Acknowledge,
    /// What adaptation learned from the laser: zero and gain of the estimate, and why it stands still if it does.
    Adaptation,
    /// Read, change and save settings.
    #[command(subcommand)]
    Settings(settings::Command),
    /// Upload, activate and roll back models.
    #[command(subcommand)]
    Model(model::Command),
    /// Play an excitation and record what the rig does.
    Record(record::Arguments),
}

/// How long a command waits for another one on the same flash file.
const PATIENCE: std::time::Duration = std::time::Duration::from_secs(30);

/// Runs the command.
///
/// # Errors
/// When the rig cannot be reached or refuses.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let which = &arguments.which;
    if let Command::Record(record) = &arguments.command {
        record.check(which)?;
    }
    if let Command::Calibrate(calibrate) = &arguments.command {
        calibrate.check(which)?;
    }
    if let Command::Settings(settings::Command::Export { file }) = &arguments.command {
        let inputs: Vec<PathBuf> = which.flash.iter().chain(&which.hardware).cloned().collect();
        output::refuse_overwriting(&inputs, &[file])?;
    }
    if let Command::Firmware(firmware::Command::Update(update)) = &arguments.command {
        return firmware::update(update, which);
    }
    // Read, changed and written back: what another command writes meanwhile would be lost.
    let _locked = which.flash.as_deref().map(|path| output::lock(path, PATIENCE)).transpose()?;
    let rig = open(which)?;
    if let Command::Hello = arguments.command {
        return state::hello(rig, which);
    }
    let mut rig = Client::connect(rig)?;
    if rig.transport().is_simulated() {
        // It has just been switched on; a board has been for long.
        experiment::settle(&mut rig)?;
    }
    let outcome = match &arguments.command {
        Command::Hello | Command::Firmware(_) => Outcome::Success,
        Command::Log(log) => return log::run(log, &mut rig, which),
        Command::Status => state::status(&mut rig, which)?,
        Command::Monitor(monitor) => monitor::run(monitor, &mut rig, which)?,
        Command::Arm(arm) => motion::arm(*arm, &mut rig, which)?,
        Command::Disarm => motion::simple(&Request::Disarm, "Disarmed.", &mut rig, which)?,
        Command::Start(time) => motion::start(*time, &mut rig, which)?,
        Command::Stop => motion::simple(&Request::Stop, "Stopped.", &mut rig, which)?,
        Command::Hold(hold) => motion::hold(*hold, &mut rig, which)?,
        Command::Move(to) => motion::move_to(*to, &mut rig, which)?,
        Command::Jog(jog) => motion::jog(*jog, &mut rig, which)?,
        Command::Calibrate(calibrate) => calibrate::run(calibrate, &mut rig, which)?,
        Command::Explain(explain) => state::explain(explain, &mut rig, which)?,
        Command::Vent => state::vent(&mut rig, which)?,
        Command::Acknowledge => state::acknowledge(&mut rig, which)?,
        Command::Adaptation => adaptation::run(&mut rig, which)?,
        Command::Settings(command) => settings::run(command, &mut rig, which)?,
        Command::Model(command) => model::run(command, &mut rig, which)?,
        Command::Record(record) => record::run(record, &mut rig, which)?,
    };
    // As a debug probe would show it, beside what the command says.
    for line in rig.transport().log().into_iter().flat_map(str::lines) {
        let _ = writeln!(std::io::stderr(), "log: {line}");
    }
    if let (Some(path), Some(flash)) = (&which.flash, rig.transport().flash()?) {
        flash.write(path)?;
    }
    Ok(outcome)
}
