//! `catheter rig monitor`: what the rig reads, as it comes.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result};
use clap::Args;
use model_export::link::message::Telemetry;
use model_export::link::settings::SettingValue;
use model_export::link::state::State;
use serde::Serialize;

use super::Which;
use super::motion::{rate, seconds};
use super::reading::Reading;
use crate::backend::Rig;
use crate::cli::Outcome;
use crate::device_settings;
use crate::experiment;
use crate::interrupt;
use crate::link::{Account, Client};
use crate::{output, say};

/// How long a simulated rig is watched when nobody says.
const SIMULATED_S: f64 = 2.0;
/// Lines a second on the terminal when nobody says.
const LINES_HZ: f64 = 2.0;
/// Columns of the file, in three parts: the middle one stands there where a model estimates.
const COLUMNS: [&str; 3] = [
    "time_s,pressure_bar,displacement_mm,sequence,pressure_measured_bar",
    ",estimate_mm",
    ",set_point,output_bar,pressure_code,laser_code,fault",
];

/// What to watch, how often and for how long.
#[derive(Args)]
pub struct Arguments {
    /// Write every sample to this file. Cells of what is not plausible, or not there, stay empty.
    #[arg(long, value_name = "FILE.csv", value_parser = output::file_argument(".csv"))]
    csv: Option<PathBuf>,
    /// Samples a second, on the terminal and in the file; as the device sends them when absent, of which the terminal shows two a second.
    #[arg(long, value_name = "HZ", value_parser = rate)]
    rate_hz: Option<f64>,
    /// End after this time of the rig; until Ctrl-C when absent (2 s on a simulated rig).
    #[arg(long, value_name = "S", value_parser = seconds)]
    seconds: Option<f64>,
}

#[derive(Serialize)]
struct Written<'a> {
    samples: u64,
    csv: Option<&'a Path>,
    account: &'a Account,
    last: Option<Reading>,
}

/// A row of the file; `None` is an empty cell.
fn row(sample: &Telemetry, start_ms: u64, estimates: bool) -> String {
    let cell = |value: Option<f32>| value.map_or_else(String::new, |value| value.to_string());
    let estimate = if estimates { format!(",{}", cell(sample.estimate_mm)) } else { String::new() };
    format!(
        "{},{},{},{},{}{estimate},{},{},{},{},{}",
        sample.time_ms.saturating_sub(start_ms) as f64 * 1e-3,
        sample.command_bar,
        cell(sample.displacement_mm),
        sample.sequence,
        cell(sample.pressure_bar),
        sample.set_point,
        f64::from(sample.output_ubar) * 1e-6,
        sample.pressure_code,
        sample.laser_code,
        sample.first_fault
    )
}

/// Watches.
pub fn run(arguments: &Arguments, rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    interrupt::watch();
    let period_ms = arguments.rate_hz.map(|rate_hz| (1000.0 / rate_hz).round().clamp(1.0, 10_000.0) as u32);
    let wanted: Vec<(&str, SettingValue)> =
        period_ms.map(|period| ("telemetry.period_ms", SettingValue::Integer(period))).into_iter().collect();
    // While armed settings stay; the samples then come as they do.
    let changeable = matches!(experiment::status(rig)?.state, State::Idle | State::Fault);
    let borrowed = if changeable { device_settings::borrow(rig, &wanted)? } else { device_settings::Borrowed::default() };
    let watched = watch(arguments, rig, which);
    device_settings::give_back(rig, borrowed)?;
    watched
}

fn watch(arguments: &Arguments, rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    let estimates = rig.hello().model_id != [0; 8];
    let create = |path: &PathBuf| -> Result<std::io::BufWriter<std::fs::File>> {
        let mut file =
            std::fs::File::create(path).map(std::io::BufWriter::new).with_context(|| format!("{}: cannot be written", path.display()))?;
        let [first, estimate, last] = COLUMNS;
        writeln!(file, "{first}{}{last}", if estimates { estimate } else { "" })?;
        Ok(file)
    };
    let mut file = arguments.csv.as_ref().map(create).transpose()?;
    let length_s = arguments.seconds.or_else(|| (!which.backend.is_board()).then_some(SIMULATED_S));
    rig.begin_account();
    let until = length_s.map(|length_s| rig.elapsed() + Duration::from_secs_f64(length_s));
    let (mut samples, mut start_ms, mut shown_s, mut last) = (0, None, f64::NEG_INFINITY, None);
    let period_s = arguments.rate_hz.map_or(1.0 / LINES_HZ, |_| 0.0);
    while until.is_none_or(|until| rig.elapsed() < until) && !interrupt::is_requested() {
        rig.listen(Duration::from_millis(20))?;
        while let Some(sample) = rig.take_telemetry() {
            let start_ms = *start_ms.get_or_insert(sample.time_ms);
            samples += 1;
            if let Some(file) = &mut file {
                writeln!(file, "{}", row(&sample, start_ms, estimates)).context("the file cannot be written; is the disk full?")?;
            }
            let reading = Reading::new(&sample, rig.transport());
            if reading.time_s >= shown_s + period_s - 1e-9 {
                shown_s = reading.time_s;
                say!("{}", reading.line());
            }
            last = Some(reading);
        }
    }
    if let Some(file) = &mut file {
        file.flush().context("the file cannot be written; is the disk full?")?;
    }
    let account = rig.account().clone();
    say!("{samples} samples, {} dropped by the device, {} lost on the line", account.dropped_by_device, account.lost_on_the_line);
    which.write(&Written { samples, csv: arguments.csv.as_deref(), account: &account, last })?;
    Ok(Outcome::Success)
}
