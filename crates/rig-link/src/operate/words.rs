//! Telemetry, status and explanations of the link as the dashboard has them.

use dashboard::{Explained, Phase, Sample};
use model_export::link::fault::{Explanation, Fault, Notice};
use model_export::link::message::{FaultRecord, Telemetry};
use model_export::link::settings::SettingValue;
use model_export::link::state::{ResetCause, State};
use serde_json::{Value, json};

use crate::link::{fault_in_words, state_name};

/// A state as the dashboard names it.
pub fn phase(state: State) -> Phase {
    match state {
        State::Boot => Phase::Boot,
        State::SelfTest => Phase::SelfTest,
        State::Idle => Phase::Idle,
        State::Armed => Phase::Armed,
        State::Running => Phase::Running,
        State::Fault => Phase::Fault,
    }
}

/// A sample of telemetry.
pub fn sample(told: &Telemetry) -> Sample {
    Sample {
        sequence: told.sequence,
        time_ms: told.time_ms,
        phase: phase(told.state),
        fault: told.first_fault,
        // Notices have numbers below 32.
        notices: told.notices.0 as u32,
        laser_code: told.laser_code,
        pressure_code: told.pressure_code,
        command_bar: told.command_bar,
        output_bar: told.output_ubar as f32 * 1e-6,
        set_point: told.set_point,
        pressure_bar: told.pressure_bar,
        displacement_mm: told.displacement_mm,
        estimate_mm: told.estimate_mm,
        late_ticks: told.late_ticks,
        longest_tick_cycles: told.longest_tick_cycles,
    }
}

/// An entry of the tables of faults (`E`), blockers (`B`) or notices (`N`).
pub fn explained(table: char, explanation: &Explanation) -> Explained {
    let Explanation { number, name, meaning, remedy } = explanation;
    let (name, meaning, remedy) = ((*name).to_owned(), (*meaning).to_owned(), (*remedy).to_owned());
    Explained { id: format!("{table}{number:03}"), number: *number, name, meaning, remedy }
}

/// Every fault.
pub fn fault_table() -> Vec<Explained> {
    Fault::ALL.iter().map(|fault| explained('E', &fault.explanation())).collect()
}

/// Every notice.
pub fn notice_table() -> Vec<Explained> {
    Notice::ALL.iter().map(|notice| explained('N', &notice.explanation())).collect()
}

/// The circumstances of a fault in a sentence.
pub fn record(record: &FaultRecord) -> String {
    format!(
        "{} struck {:.3} s after the start in the state {}: {:.3} bar to the valve, {:.3} bar and {:.3} mm measured (codes {} and {}).",
        fault_in_words(record.first),
        record.time_ms as f64 * 1e-3,
        state_name(record.state),
        f64::from(record.output_ubar) * 1e-6,
        record.pressure_bar,
        record.displacement_mm,
        record.pressure_code,
        record.laser_code
    )
}

/// Why the device last started.
pub fn reset_cause(cause: ResetCause) -> &'static str {
    match cause {
        ResetCause::Unknown | ResetCause::Other(_) => "unknown",
        ResetCause::PowerOn => "power-on",
        ResetCause::Pin => "reset pin",
        ResetCause::Software => "software",
        ResetCause::Watchdog => "watchdog",
        ResetCause::BrownOut => "brown-out",
    }
}

/// A setting's value as JSON has it: the shortest decimal that is the same number.
pub fn value(value: SettingValue) -> Value {
    match value {
        SettingValue::Float(number) => json!(number.to_string().parse::<f64>().unwrap_or_else(|_| f64::from(number))),
        SettingValue::Integer(number) => json!(number),
        SettingValue::Flag(flag) => json!(flag),
    }
}

/// A value of JSON as a setting of that kind takes it.
pub fn setting_value(like: SettingValue, value: &Value) -> Option<SettingValue> {
    match like {
        SettingValue::Float(_) => value.as_f64().map(|number| SettingValue::Float(number as f32)),
        SettingValue::Integer(_) => value.as_u64().and_then(|number| u32::try_from(number).ok()).map(SettingValue::Integer),
        SettingValue::Flag(_) => value.as_bool().map(SettingValue::Flag),
    }
}
