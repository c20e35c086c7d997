//! `catheter rig hello|status|explain|vent|acknowledge`.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Result, bail};
use model_export::link::fault::Fault;
use model_export::link::message::{FaultRecord, Reply, Request, RestNoise, Status};
use model_export::link::state::{ResetCause, State};
use model_export::link::{PROTOCOL, SCHEMA_HASH};
use serde::Serialize;

use super::Which;
use super::reading::{self, Reading};
use crate::backend::Rig;
use crate::cli::Outcome;
use crate::energise;
use crate::experiment;
use crate::link::{Client, Transport, fault_in_words, in_words, state_name, version};
use crate::{history, output, say};

/// Boot takes 200 ms, the self-test of a simulated rig a tick.
const SELF_TESTED_AFTER: Duration = Duration::from_millis(250);

#[derive(Serialize)]
struct HelloWritten {
    firmware: String,
    board: String,
    protocol: u16,
    schema_hash: String,
    model_id: Option<String>,
    reset_cause: &'static str,
    understood: bool,
    source: Option<String>,
    chip: Option<String>,
    chip_number: Option<String>,
}

/// Who is there; the one command that works with every firmware.
pub fn hello(mut rig: Rig, which: &Which) -> Result<Outcome> {
    if rig.is_simulated() {
        // It has just been switched on, and knows its model once it has tested itself.
        while rig.elapsed() < SELF_TESTED_AFTER {
            rig.receive(SELF_TESTED_AFTER, &mut Vec::new())?;
        }
    }
    let client = Client::meet(rig)?;
    let hello = client.hello().clone();
    let written = HelloWritten {
        firmware: version(hello.firmware),
        board: hello.board.to_string(),
        protocol: hello.protocol,
        schema_hash: format!("{:08x}", hello.schema_hash),
        model_id: in_hexadecimal(&hello.model_id),
        reset_cause: reset_name(hello.reset_cause),
        understood: hello.protocol == PROTOCOL && hello.schema_hash == SCHEMA_HASH,
        source: in_hexadecimal(&hello.build.source),
        chip: (hello.build.chip != 0).then(|| format!("{:#05x} revision {:#06x}", hello.build.chip & 0xfff, hello.build.chip >> 16)),
        chip_number: in_hexadecimal(&hello.build.chip_number),
    };
    say!("board      {}", written.board);
    say!("firmware   {}", written.firmware);
    if let Some(source) = &written.source {
        say!("source     {source}");
    }
    if let Some(chip) = &written.chip {
        say!("chip       {chip}, number {}", written.chip_number.as_deref().unwrap_or("unknown"));
    }
    say!("protocol   {} (messages {})", written.protocol, written.schema_hash);
    say!("model      {}", written.model_id.as_deref().unwrap_or("none"));
    say!("started by {}", written.reset_cause);
    which.write(&written)?;
    client.check_protocol()?;
    Ok(Outcome::Success)
}

/// Bytes as digits; `None` where all are zero.
fn in_hexadecimal(bytes: &[u8]) -> Option<String> {
    bytes.iter().any(|byte| *byte != 0).then(|| bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

fn reset_name(cause: ResetCause) -> &'static str {
    match cause {
        ResetCause::Unknown => "unknown",
        ResetCause::PowerOn => "power-on",
        ResetCause::Pin => "reset-pin",
        ResetCause::Software => "software",
        ResetCause::Watchdog => "watchdog",
        ResetCause::BrownOut => "brown-out",
        ResetCause::Other(_) => "other",
    }
}

#[derive(Serialize)]
struct StatusWritten {
    state: &'static str,
    first_fault: Option<String>,
    faults: Vec<String>,
    blockers: Vec<&'static str>,
    notices: Vec<&'static str>,
    time_s: f64,
    late_ticks: u32,
    longest_tick_cycles: u32,
    stack_unused_bytes: u32,
    damaged_frames: u32,
    telemetry_dropped: u32,
    reset_cause: &'static str,
    settings_unsaved: bool,
    supply_v: Option<f32>,
    chip_celsius: Option<f32>,
    rest_noise: Option<RestNoise>,
    #[serde(flatten)]
    reading: Option<ReadingWritten>,
}

/// What the sensors say, beside the state.
#[derive(Serialize)]
struct ReadingWritten {
    reading: Reading,
    set_point_unit: &'static str,
}

impl StatusWritten {
    fn new(status: &Status) -> Self {
        Self {
            state: state_name(status.state),
            first_fault: (status.first_fault != 0).then(|| fault_in_words(status.first_fault)),
            faults: status.faults.iter().map(|fault| fault_in_words(fault.number())).collect(),
            blockers: status.blockers.iter().map(|blocker| blocker.explanation().name).collect(),
            notices: status.notices.iter().map(|notice| notice.explanation().name).collect(),
            time_s: status.time_ms as f64 * 1e-3,
            late_ticks: status.late_ticks,
            longest_tick_cycles: status.longest_tick_cycles,
            stack_unused_bytes: status.stack_unused_bytes,
            damaged_frames: status.damaged_frames,
            telemetry_dropped: status.telemetry_dropped,
            reset_cause: reset_name(status.reset_cause),
            settings_unsaved: status.settings_unsaved,
            supply_v: None,
            chip_celsius: None,
            rest_noise: None,
            reading: None,
        }
    }

    fn say(&self) {
        let list = |entries: &[&str]| if entries.is_empty() { "none".to_owned() } else { entries.join(", ") };
        say!("state      {}, {:.3} s after its start by {}", self.state, self.time_s, self.reset_cause);
        say!("fault      {}", self.first_fault.as_deref().unwrap_or("none"));
        say!("blockers   {}", list(&self.blockers));
        say!("notices    {}", list(&self.notices));
        say!(
            "lost       {} ticks late, {} telemetry samples, {} damaged frames",
            self.late_ticks,
            self.telemetry_dropped,
            self.damaged_frames
        );
        if self.longest_tick_cycles > 0 {
            say!("measured   longest tick {} cycles, {} bytes of stack never used", self.longest_tick_cycles, self.stack_unused_bytes);
        } else {
            say!("measured   the longest tick is not measured here");
        }
        if let Some(ReadingWritten { reading, set_point_unit }) = &self.reading {
            reading.lines(set_point_unit).iter().for_each(|line| say!("{line}"));
        }
        if let Some(noise) = &self.rest_noise {
            let RestNoise { laser_mm, pressure_bar, .. } = noise;
            say!("at rest    noise of the laser {laser_mm:.4} mm, of the pressure {pressure_bar:.5} bar (root mean square of a second)");
        }
        if self.settings_unsaved {
            say!("settings   changed and not saved");
        }
    }
}

/// The status.
pub fn status(rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    let mut written = StatusWritten::new(&experiment::status(rig)?);
    // Where no telemetry comes, the status is still the status.
    if let Ok(sample) = reading::latest(rig) {
        let reading = Reading::new(&sample, rig.transport());
        (written.supply_v, written.chip_celsius) = (reading.supply_v, reading.chip_celsius);
        written.reading = Some(ReadingWritten { reading, set_point_unit: reading::quantity(rig)? });
    }
    // A device of before this question, or one that never rested, has no answer.
    if let Ok(Reply::RestNoise(noise)) = rig.request(&Request::RestNoise) {
        written.rest_noise = Some(noise);
    }
    written.say();
    which.write(&written)?;
    Ok(Outcome::Success)
}

#[derive(Serialize)]
struct ExplainWritten {
    status: StatusWritten,
    explanations: Vec<String>,
    record: Option<RecordWritten>,
    previous_record: Option<RecordWritten>,
    dumped_rows: Option<usize>,
}

/// A fault record in words and numbers.
#[derive(Serialize)]
pub struct RecordWritten {
    first: String,
    second: Option<String>,
    time_s: f64,
    state: &'static str,
    output_bar: f64,
    pressure_bar: f32,
    displacement_mm: f32,
    estimate_mm: Option<f32>,
    set_point: f32,
    laser_code: u16,
    pressure_code: u16,
    late_ticks: u32,
}

impl RecordWritten {
    /// Of a record.
    pub fn new(record: &FaultRecord) -> Self {
        Self {
            first: fault_in_words(record.first),
            second: (record.second != 0).then(|| fault_in_words(record.second)),
            time_s: record.time_ms as f64 * 1e-3,
            state: state_name(record.state),
            output_bar: f64::from(record.output_ubar) * 1e-6,
            pressure_bar: record.pressure_bar,
            displacement_mm: record.displacement_mm,
            estimate_mm: Some(record.estimate_mm).filter(|estimate| estimate.is_finite()),
            set_point: record.set_point,
            laser_code: record.laser_code,
            pressure_code: record.pressure_code,
            late_ticks: record.late_ticks,
        }
    }

    /// One line of it.
    pub fn line(&self) -> String {
        format!(
            "{} struck {:.3} s after the start in the state `{}`: {:.3} bar to the valve, {:.3} bar and {:.3} mm measured (codes {} and {})",
            self.first,
            self.time_s,
            self.state,
            self.output_bar,
            self.pressure_bar,
            self.displacement_mm,
            self.pressure_code,
            self.laser_code
        )
    }
}

/// What to do with the last seconds before the fault.
#[derive(clap::Args)]
pub struct ExplainArguments {
    /// Write the last two seconds before the fault, of this run or the one before the last reset, as a recording: every channel once a
    /// millisecond. `catheter replay FILE` reads it.
    #[arg(long, value_name = "FILE", value_parser = output::file_argument("csv"))]
    dump: Option<PathBuf>,
}

/// Fetches the last seconds and writes them.
fn dump(path: &Path, rig: &mut Client<Rig>) -> Result<usize> {
    let Some(rows) = history::fetch(rig)? else {
        bail!(
            "the rig keeps no last seconds now: it records, or has lost its supply since; they are kept from a fault or a reset until it is armed again"
        );
    };
    let settings = history::settings_in_use(rig)?;
    let rows = history::in_units(&rows, &settings)?;
    history::write(path, &rows)?;
    say!(
        "{}: {} rows, the last one {}",
        path.display(),
        rows.len(),
        if history::ends_in_a_fault(&rows) { "that of the fault" } else { "before the reset" }
    );
    Ok(rows.len())
}

/// What is wrong and what to do.
pub fn explain(arguments: &ExplainArguments, rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    let status = experiment::status(rig)?;
    let mut explanations: Vec<String> = status.faults.iter().map(|fault| in_words('E', &fault.explanation())).collect();
    explanations.extend(status.blockers.iter().map(|blocker| in_words('B', &blocker.explanation())));
    explanations.extend(status.notices.iter().map(|notice| in_words('N', &notice.explanation())));
    let previous = match rig.ask(&Request::PreviousFaultRecord)? {
        Reply::FaultRecord(record) => Some(record),
        _ => None,
    };
    let written = ExplainWritten {
        status: StatusWritten::new(&status),
        explanations,
        record: experiment::fault_record(rig)?.as_ref().map(RecordWritten::new),
        previous_record: previous.as_ref().map(RecordWritten::new),
        dumped_rows: arguments.dump.as_deref().map(|path| dump(path, rig)).transpose()?,
    };
    say!("The state is `{}`.", written.status.state);
    if written.explanations.is_empty() {
        say!("Nothing is wrong, nothing blocks arming.");
    }
    written.explanations.iter().for_each(|line| say!("{line}"));
    if let Some(record) = &written.record {
        say!("{}", record.line());
    }
    if let Some(record) = &written.previous_record {
        say!("Before the last reset: {}", record.line());
    }
    if status.state == State::Fault {
        say!("When the cause is gone: `catheter rig ... acknowledge`.");
    }
    which.write(&written)?;
    Ok(Outcome::Success)
}

#[derive(Serialize)]
struct VentWritten {
    vented: bool,
    state: &'static str,
    faults: Vec<String>,
}

/// Vents and waits until the pressure is gone.
pub fn vent(rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    let (vented, status) = energise::vent(rig)?;
    let faults = status.faults.iter().map(|fault: Fault| fault_in_words(fault.number())).collect();
    let written = VentWritten { vented, state: state_name(status.state), faults };
    if vented {
        say!("Vented: the measured pressure is below 0.1 bar. State `{}`.", written.state);
    } else {
        say!(
            "NOT vented: the measured pressure was not seen below 0.1 bar. State `{}`, {}. Close the supply by hand.",
            written.state,
            if written.faults.is_empty() { "no fault".to_owned() } else { written.faults.join(", ") }
        );
    }
    which.write(&written)?;
    Ok(if vented { Outcome::Success } else { Outcome::CheckFailed })
}

/// Acknowledges a fault and waits for the self-test.
pub fn acknowledge(rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    rig.command(&Request::Acknowledge)?;
    let status = experiment::settle(rig)?;
    let written = StatusWritten::new(&status);
    written.say();
    which.write(&written)?;
    Ok(if status.state == State::Fault { Outcome::CheckFailed } else { Outcome::Success })
}
