//! The last two seconds before a fault: fetched from a rig, written as a recording, read again.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use firmware::calibration::Calibration;
use firmware::tick::{Tick, TickConfig};
use model_export::link::history::{HistoryRow, ROW_BYTES};
use model_export::link::message::{Baseline, Refusal, Reply, Request};
use model_export::link::settings::Settings;
use model_export::link::state::State;
use serde::{Deserialize, Serialize};

use crate::device_settings::differences;
use crate::link::{Client, FACTS, LinkError, Transport, state_name};

/// Time between two rows, s.
pub const PERIOD_S: f64 = 1e-3;

/// A row in physical units; without what the rig's sensors could not have meant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DumpRow {
    /// Time since the first row, s.
    pub time_s: f64,
    /// What went to the valve, bar.
    pub pressure_bar: f64,
    /// The laser's code as a displacement, mm.
    pub displacement_mm: f64,
    /// The pressure sensor's code as a pressure, bar.
    pub pressure_measured_bar: f64,
    /// Set-point in force, in bar or mm.
    pub set_point: Option<f64>,
    /// The model's estimate, mm.
    pub estimate_mm: Option<f64>,
    /// Code of the laser.
    pub laser_code: u16,
    /// Code of the pressure sensor.
    pub pressure_code: u16,
    /// Drive of the valve out of 65535.
    pub valve_share: u16,
    /// The state's name.
    pub state: String,
    /// Whether the dump valve was closed.
    pub dump_valve_closed: bool,
    /// Whether the emergency stop was pressed.
    pub emergency_stop: bool,
    /// Whether the tick came late.
    pub late: bool,
}

/// Fetches every row a rig keeps, the oldest first; `None` where it keeps none. A row that was torn is missing, and its time passes all the same.
///
/// # Errors
/// When the rig is gone, or begins to record anew meanwhile.
pub fn fetch<T: Transport>(rig: &mut Client<T>) -> Result<Option<Vec<(u16, HistoryRow)>>> {
    let mut rows = Vec::new();
    let mut next = 0;
    let mut whole = None;
    loop {
        let request = Request::History { from_row: next };
        let piece = match rig.ask(&request)? {
            Reply::History(piece) => piece,
            Reply::Refused(Refusal::NoRecord) if next == 0 => return Ok(None),
            Reply::Refused(refusal) => return Err(LinkError::Refused(refusal).into()),
            _ => return Err(rig.unexpected(&request).into()),
        };
        ensure!(
            *whole.get_or_insert(piece.rows) == piece.rows,
            "the rig began to record anew while its history was fetched; fetch it again"
        );
        let (pieces, _) = piece.bytes.as_chunks::<ROW_BYTES>();
        if pieces.is_empty() {
            return Ok(Some(rows));
        }
        for bytes in pieces {
            rows.extend(HistoryRow::decode(bytes).map(|row| (next, row)));
            next += 1;
        }
        if next >= piece.rows {
            return Ok(Some(rows));
        }
    }
}

/// The settings in use.
///
/// # Errors
/// When the rig is gone.
pub fn settings_in_use<T: Transport>(rig: &mut Client<T>) -> Result<Settings> {
    let mut settings = Settings::default();
    for entry in differences(rig, Baseline::Defaults)? {
        settings
            .set(entry.number, entry.in_use)
            .ok()
            .with_context(|| format!("the rig has a setting {} that this program does not know", entry.number))?;
    }
    Ok(settings)
}

/// Rows in physical units, by the settings that the rig has now.
///
/// # Errors
/// When the settings do not go together.
pub fn in_units(rows: &[(u16, HistoryRow)], settings: &Settings) -> Result<Vec<DumpRow>> {
    let tick: Tick = TickConfig { settings, facts: FACTS }
        .build()
        .map_err(|problem| anyhow::anyhow!("the rig's settings do not go together: {problem:?}"))?;
    let thousandths = |value: i16| (value != i16::MIN).then(|| f64::from(value) / 1000.0);
    let value = |calibration: &Calibration, code: u16| f64::from(calibration.value(code));
    let in_units = |(index, row): &(u16, HistoryRow)| DumpRow {
        time_s: f64::from(*index) * PERIOD_S,
        pressure_bar: f64::from(row.valve_share) / f64::from(u16::MAX) * f64::from(settings.valve_full_scale_bar),
        displacement_mm: value(tick.laser().calibration(), row.laser_code),
        pressure_measured_bar: value(tick.pressure().calibration(), row.pressure_code),
        set_point: thousandths(row.set_point_thousandths),
        estimate_mm: thousandths(row.estimate_thousandths),
        laser_code: row.laser_code,
        pressure_code: row.pressure_code,
        valve_share: row.valve_share,
        state: state_name(row.state).to_owned(),
        dump_valve_closed: row.energised,
        emergency_stop: row.emergency_stop,
        late: row.late,
    };
    Ok(rows.iter().map(in_units).collect())
}

/// Writes a recording of them: the columns of every recording first, then those of a dump.
///
/// # Errors
/// When the file cannot be written.
pub fn write(path: &Path, rows: &[DumpRow]) -> Result<()> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer.serialize(row)?;
    }
    output::write_atomic(path, &writer.into_inner().context("a buffer that cannot be written")?)
}

/// Reads a dump; `None` if the file is a CSV of another kind.
///
/// # Errors
/// When the file cannot be read, or is a dump with a line that is none.
pub fn read(path: &Path) -> Result<Option<Vec<DumpRow>>> {
    let mut reader = csv::Reader::from_path(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let headers = reader.headers()?;
    if !["laser_code", "pressure_code", "valve_share", "dump_valve_closed"].iter().all(|name| headers.iter().any(|header| header == *name))
    {
        return Ok(None);
    }
    let rows: Result<Vec<DumpRow>, _> = reader.deserialize().collect();
    let rows = rows.with_context(|| format!("{}: is no dump of a rig's last seconds", path.display()))?;
    ensure!(!rows.is_empty(), "{}: has no rows", path.display());
    // A single row rises whatever its time.
    let finite = |row: &DumpRow| {
        [row.time_s, row.pressure_bar, row.displacement_mm, row.pressure_measured_bar].iter().all(|value| value.is_finite())
    };
    ensure!(rows.iter().all(finite), "{}: has a value that is no finite number", path.display());
    ensure!(rows.is_sorted_by(|a, b| a.time_s < b.time_s), "{}: its times do not rise", path.display());
    Ok(Some(rows))
}

/// What happened in a dump, a line each: what changed between two rows, and what is missing.
#[must_use]
pub fn events(rows: &[DumpRow]) -> Vec<String> {
    let mut events = Vec::new();
    for pair in rows.windows(2) {
        let [before, now] = pair else { continue };
        let mut tell = |what: String| events.push(format!("{:.3} s  {what}", now.time_s));
        if now.time_s - before.time_s > 1.5 * PERIOD_S {
            tell(format!("{:.0} rows are missing before this one", (now.time_s - before.time_s) / PERIOD_S - 1.0));
        }
        if now.state != before.state {
            tell(format!("state `{}` after `{}`", now.state, before.state));
        }
        if now.dump_valve_closed != before.dump_valve_closed {
            tell(format!("the dump valve {}", if now.dump_valve_closed { "closes" } else { "opens" }));
        }
        if now.emergency_stop && !before.emergency_stop {
            tell("the emergency stop is pressed".to_owned());
        }
        if now.late && !before.late {
            tell("ticks come late".to_owned());
        }
    }
    events
}

/// The row in force at a moment.
#[must_use]
pub fn at(rows: &[DumpRow], time_s: f64) -> Option<&DumpRow> {
    rows.iter().rev().find(|row| row.time_s <= time_s + 1e-9)
}

/// Whether a fault ends it, as in every dump but one that a reset ended.
#[must_use]
pub fn ends_in_a_fault(rows: &[DumpRow]) -> bool {
    rows.last().is_some_and(|row| row.state == state_name(State::Fault))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dump_with_a_value_that_is_no_number_is_refused() {
        let settings = Settings::default();
        let row = in_units(&[(0, HistoryRow::default())], &settings).expect("settings that go together").remove(0);
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("dump.csv");
        write(&path, std::slice::from_ref(&row)).expect("a dump");
        assert_eq!(read(&path).expect("a dump").expect("of the right kind").len(), 1);
        for wrong in [DumpRow { time_s: f64::NAN, ..row.clone() }, DumpRow { displacement_mm: f64::INFINITY, ..row }] {
            write(&path, &[wrong]).expect("a dump");
            assert!(read(&path).unwrap_err().to_string().contains("no finite number"));
        }
    }
}
