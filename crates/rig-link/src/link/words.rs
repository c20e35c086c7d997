//! Refusals, faults, blockers and notices as sentences.

use model_export::link::fault::{AdaptationCondition, BlockerSet, Explanation, Fault};
use model_export::link::message::Refusal;
use model_export::link::settings::{SettingError, by_number};
use model_export::link::state::State;

/// A fault as people look it up: `E017 laser-stuck`.
#[must_use]
pub fn fault_in_words(number: u8) -> String {
    match Fault::from_number(number) {
        Some(fault) => format!("E{number:03} {}", fault.explanation().name),
        None => format!("E{number:03} (of a later version)"),
    }
}

/// Meaning and remedy behind identifier and name, `E017 laser-stuck: ...`.
#[must_use]
pub fn in_words(table: char, explanation: &Explanation) -> String {
    let Explanation { number, name, meaning, remedy } = explanation;
    format!("{table}{number:03} {name}: {meaning} {remedy}")
}

/// Name of a state as it is written everywhere.
#[must_use]
pub fn state_name(state: State) -> &'static str {
    match state {
        State::Boot => "boot",
        State::SelfTest => "self-test",
        State::Idle => "idle",
        State::Armed => "armed",
        State::Running => "running",
        State::Fault => "fault",
    }
}

fn blockers(set: BlockerSet) -> String {
    let each: Vec<String> = set.iter().map(|blocker| in_words('B', &blocker.explanation())).collect();
    each.join("\n  ")
}

/// Why a request was refused and what to do.
#[must_use]
pub fn refusal_in_words(refusal: &Refusal) -> String {
    match refusal {
        Refusal::Blocked(set) => format!("blocked by\n  {}", blockers(*set)),
        Refusal::State(state) => format!("not possible in the state `{}`; `catheter rig ... status` shows the way out", state_name(*state)),
        Refusal::NotUnderstood => "the firmware does not know this request; it is older than this program".to_owned(),
        Refusal::Busy => "the device is busy; try again".to_owned(),
        Refusal::Setting(SettingError::Unknown) => "the firmware does not know this setting".to_owned(),
        Refusal::Setting(SettingError::WrongType) => "the setting has another type".to_owned(),
        Refusal::Setting(SettingError::OutOfBounds) => "the value is outside the setting's bounds".to_owned(),
        Refusal::SettingsInconsistent(number) => {
            let name = by_number(*number).map_or_else(|| format!("number {number}"), |info| info.name.to_owned());
            format!("the settings would contradict each other; the first to blame is {name}")
        }
        Refusal::Uncertified(number) => match AdaptationCondition::from_number(*number) {
            Some(condition) => format!("adaptation has no certificate: {}", in_words('C', &condition.explanation())),
            None => format!("adaptation has no certificate: condition {number} of a later version fails"),
        },
        Refusal::WrongQuantity => "the active control law does not take this kind of set-point; see the setting control.law".to_owned(),
        Refusal::NotFinite => "the value is not a number".to_owned(),
        Refusal::PlaybackIndex(index) => format!("the playback goes on at point {index}"),
        Refusal::PlaybackFull(free) => format!("the playback buffer has room for {free} points"),
        Refusal::NoUpload => "no upload is under way; the device was restarted in between".to_owned(),
        Refusal::UploadOffset(offset) => format!("the upload goes on at byte {offset}"),
        Refusal::TooLong(capacity) => format!("the blob is longer than a slot of the flash ({capacity} bytes)"),
        Refusal::Checksum => "the blob was damaged on its way; upload it again".to_owned(),
        Refusal::PieceLength => "a piece of the upload has a wrong length".to_owned(),
        Refusal::NotAModel => {
            "the blob is no model that this firmware can run: units must be bar and mm, the sample period whole milliseconds, and its golden \
             vectors must come out right"
                .to_owned()
        }
        Refusal::ModelInputs => {
            "the model takes several inputs, and the firmware measures one pressure; fit a model of one input, or run this one on a computer \
             or by `catheter export --c`"
                .to_owned()
        }
        Refusal::ModelTooSlow => {
            "a step of the model takes more than 60 % of a millisecond on the device; train a smaller model, or one that streams instead of \
             running a window (`catheter inspect` tells the instructions of a step)"
                .to_owned()
        }
        Refusal::OtherSession => "the device has restarted, or another program has opened the port; begin again, with one program at the port".to_owned(),
        Refusal::NoOtherModel => "there is no other whole model to activate; upload one".to_owned(),
        Refusal::Storage => "the flash memory could not be written".to_owned(),
        Refusal::NoRecord => "there is no such fault record".to_owned(),
        Refusal::Traced => "not while a trace runs: the recording that it belongs to must end first".to_owned(),
        Refusal::LogFull => "this slot was activated too often; upload the model again".to_owned(),
    }
}
