//! What commands do with a file that is none of a recording: read it, and what they would do next with what it holds.

use std::io::Write;
use std::path::PathBuf;

use host_tool::backend::{Backend, Rig, Simulated, VIRTUAL_BOARD};
use host_tool::discover::effects::of_a_file::Definition;
use host_tool::excitation::{self, Limits};
use host_tool::import::{self, CheckVectors};
use host_tool::link::{Client, FlashMemory, HardwareConfig, InProcess};
use host_tool::model::{self, Fit};
use host_tool::plant::Plant;
use host_tool::recording::Signal;
use host_tool::replay_log::{ReplayLog, story};
use host_tool::track::rig::Mover;
use host_tool::train::{CheckpointPlan, train};
use host_tool::{experiment, export, history, identify, network, setting_words, track};

use crate::seeds;

/// How an input ended other than in a sound result.
#[derive(Debug)]
pub enum Wrong {
    /// Refused, with a message: as it should be.
    Refused(String),
    /// Accepted although it is garbage.
    Garbage(String),
}

/// A refusal, whatever its type.
fn refused<E: std::fmt::Display>(error: E) -> Wrong {
    // As the command shows it.
    let message = host_tool::output::brief(&format!("{error:#}")).into_owned();
    if message.len() > 40_000 { Wrong::Garbage(format!("a refusal of {} bytes", message.len())) } else { Wrong::Refused(message) }
}

fn garbage(problem: impl Into<String>) -> Wrong {
    Wrong::Garbage(problem.into())
}

/// The bytes as a file of a name.
fn with_file<T>(name: &str, bytes: &[u8], read: impl FnOnce(&PathBuf) -> Result<T, Wrong>) -> Result<T, Wrong> {
    let folder = tempfile::tempdir().map_err(|error| garbage(error.to_string()))?;
    let path = folder.path().join(name);
    let mut file = std::fs::File::create(&path).map_err(|error| garbage(error.to_string()))?;
    file.write_all(bytes).map_err(|error| garbage(error.to_string()))?;
    drop(file);
    read(&path)
}

/// A model of any kind, run over a recording as `evaluate` does; what it is and what it gives is finite.
pub fn model(bytes: &[u8]) -> Result<(), Wrong> {
    with_file("model.toml", bytes, |path| {
        let model = model::load(path).map_err(refused)?;
        let recording = &seeds::recordings()[0];
        let predicted = model::predict(&*model, recording, Fit { resample: true, ..Fit::default() }).map_err(refused)?;
        if predicted.len() != recording.len() || predicted.iter().any(|value| value.is_nan() || value.abs() > 1e30) {
            return Err(garbage(format!("an output of {} samples that is not finite", predicted.len())));
        }
        Ok(())
    })
}

/// A network, run and taken to the microcontroller.
pub fn trained(bytes: &[u8]) -> Result<(), Wrong> {
    model(bytes)?;
    let model = network::from_bytes(bytes, "model.safetensors").map_err(refused)?;
    let made = export::export(&model, seeds::recordings()).map_err(refused)?;
    blob(&made.bytes)
}

/// An identified model, run and taken to the microcontroller.
pub fn physics(bytes: &[u8]) -> Result<(), Wrong> {
    model(bytes)?;
    with_file("physics.toml", bytes, |path| {
        let physics = identify::PhysicsModel::read(path).map_err(refused)?;
        let trained = export::from_physics(&physics).map_err(refused)?;
        blob(&export::export(&trained, seeds::recordings()).map_err(refused)?.bytes)
    })
}

/// A blob, run as `evaluate` does, uploaded and written as C.
pub fn blob(bytes: &[u8]) -> Result<(), Wrong> {
    model(bytes)?;
    let decoded = model_export::blob::decode(bytes).map_err(refused)?;
    with_file("model.c", &[], |path| {
        let files = export::c::CFiles::new(path).map_err(refused)?;
        files.write(&decoded).map_err(refused)?;
        let source = std::fs::read_to_string(path).map_err(|error| garbage(error.to_string()))?;
        // Names of the program have neither.
        let is_number = |word: &str| ["nan", "inf", "-nan", "-inf", "NaN"].contains(&word);
        if source.split([' ', ',', '(', ')', '{', '}', ';', '\n']).any(is_number) {
            return Err(garbage("C with a number that is not finite"));
        }
        Ok(())
    })?;
    FlashMemory::with_model(bytes).map(drop).map_err(refused)
}

/// A checkpoint that a training goes on from.
pub fn checkpoint(bytes: &[u8]) -> Result<(), Wrong> {
    with_file("model.checkpoint", bytes, |path| {
        let plan = CheckpointPlan { path: Some(path.clone()), resume: true, stop_after: None };
        let (model, report) = train(seeds::recordings(), &seeds::config("stream-1x32"), 1, 1, &plan, &mut |_| {}).map_err(refused)?;
        if !report.val_rmse.is_finite() {
            // The command says so and writes nothing.
            return Err(Wrong::Refused("diverged".to_owned()));
        }
        network::to_bytes(&model).map(drop).map_err(|error| garbage(error.to_string()))
    })
}

/// A replay log, replayed.
pub fn replay_log(bytes: &[u8]) -> Result<(), Wrong> {
    let replay_log = ReplayLog::from_bytes(bytes).map_err(refused)?;
    let told = story(&replay_log, Some(0.01)).map_err(refused)?;
    let text = serde_json::to_string(&told).map_err(|error| garbage(error.to_string()))?;
    if text.len() > 64 << 20 { Err(garbage("a story of more than 64 MB")) } else { Ok(()) }
}

/// A flash that a device starts from.
pub fn flash(bytes: &[u8]) -> Result<(), Wrong> {
    with_file("rig.flash", bytes, |path| {
        let flash = FlashMemory::read(path).map_err(refused)?;
        track::rig::connect(InProcess::new(flash), Mover::Realistic.hardware(1, 1), "the fuzzer's rig", None).map(drop).map_err(refused)
    })
}

/// An excitation, played to a plant.
pub fn played(bytes: &[u8]) -> Result<(), Wrong> {
    with_file("excitation.toml", bytes, |path| {
        let excitation = excitation::read(path).map_err(refused)?;
        let samples = excitation.sample_within(&Limits::default()).map_err(refused)?;
        if samples.pressure_bar.iter().any(|bar| !(-1e-6..=3.0 + 1e-6).contains(bar)) {
            return Err(garbage("a pressure beyond the limits"));
        }
        // Written again, it is the same.
        let text = excitation::to_toml(&excitation);
        if toml::from_str(&text).ok().as_ref() == Some(&excitation) {
            Ok(())
        } else {
            Err(garbage("an excitation that its own text is not"))
        }
    })
}

/// A plant, through which a pressure goes.
pub fn plant(bytes: &[u8]) -> Result<(), Wrong> {
    with_file("plant.toml", bytes, |path| {
        let plant = Plant::named(&path.display().to_string()).map_err(refused)?;
        let output = plant.simulate(&seeds::recordings()[0].input, 0.02, 1);
        if output.iter().all(|value| value.abs() <= 1e30) { Ok(()) } else { Err(garbage("a displacement that is not finite")) }
    })
}

/// Settings of a device.
pub fn settings(bytes: &[u8]) -> Result<(), Wrong> {
    with_file("settings.toml", bytes, |path| {
        let settings = setting_words::read(path).map_err(refused)?;
        let mut all = model_export::link::settings::Settings::default();
        for (info, value) in settings {
            all.set(info.number, value).map_err(|problem| Wrong::Refused(format!("{}: {problem:?}", info.name)))?;
        }
        Ok(())
    })
}

/// Numbers of a simulated rig's hardware: a device that starts with them answers.
pub fn hardware(bytes: &[u8]) -> Result<(), Wrong> {
    let text = std::str::from_utf8(bytes).map_err(refused)?;
    let hardware: HardwareConfig = toml::from_str(text).map_err(refused)?;
    hardware.problem().map_or(Ok(()), |problem| Err(Wrong::Refused(problem)))?;
    let plant = Plant::named("pi").map_err(|error| garbage(error.to_string()))?;
    let mut simulated = Simulated::around(&plant, 1, FlashMemory::default(), VIRTUAL_BOARD);
    simulated.hardware = hardware;
    let rig = Rig::open(&Backend::Virtual, || Ok(simulated)).map_err(refused)?;
    let mut client = Client::connect(rig).map_err(refused)?;
    experiment::settle(&mut client).map(drop).map_err(refused)
}

/// Effects of a lab.
pub fn effects(bytes: &[u8]) -> Result<(), Wrong> {
    with_file("effects.toml", bytes, |path| Definition::read(path).map(drop).map_err(refused))
}

/// A network of PyTorch, Keras or ONNX.
pub fn foreign(bytes: &[u8]) -> Result<(), Wrong> {
    let signal = import::options::InputOptions {
        signal: Some(Signal::pressure_bar()),
        range: Some([0.0, 3.0]),
        largest_step: Some(0.1),
        ..Default::default()
    };
    let options = import::options::Options {
        inputs: [signal, Default::default(), Default::default(), Default::default()],
        output: Some(Signal::displacement_mm()),
        sample_period_s: Some(0.02),
        output_range: Some([0.0, 12.0]),
        mode: Some(host_tool::network::Mode::Streaming),
        ..Default::default()
    };
    let mut found = import::from_bytes(bytes, options).map_err(refused)?;
    let model = found.model(None).map_err(refused)?;
    let bytes = network::to_bytes(&model).map_err(|error| garbage(error.to_string()))?;
    network::from_bytes(&bytes, "model.safetensors").map(drop).map_err(|error| garbage(format!("what was written is refused: {error}")))
}

/// Check vectors of an import.
pub fn vectors(bytes: &[u8]) -> Result<(), Wrong> {
    let signals = [Signal::pressure_bar()];
    let check = CheckVectors::parse(bytes, &PathBuf::from("check.csv"), &[Some(&signals[0])], None).map_err(refused)?;
    let finite = |range: Option<[f64; 2]>| range.is_none_or(|range| range.iter().all(|value| value.is_finite()));
    if finite(check.input_range(0)) && finite(check.output_range()) { Ok(()) } else { Err(garbage("a range that is not finite")) }
}

/// A reference to follow.
pub fn reference(bytes: &[u8]) -> Result<(), Wrong> {
    with_file("path.csv", bytes, |path| {
        let reference = track::reference::from_file(path).map_err(refused)?;
        if reference.points_mm.iter().all(|value| value.abs() <= 1e30) { Ok(()) } else { Err(garbage("a reference that is not finite")) }
    })
}

/// The dump of a rig's last seconds.
pub fn dump(bytes: &[u8]) -> Result<(), Wrong> {
    with_file("dump.csv", bytes, |path| {
        let rows = history::read(path).map_err(refused)?.ok_or_else(|| Wrong::Refused("no dump".to_owned()))?;
        let events = history::events(&rows);
        if !rows.iter().all(|row| row.time_s.is_finite()) {
            Err(garbage("a time that is not finite"))
        } else if events.len() <= 8 * rows.len() {
            Ok(())
        } else {
            Err(garbage("events of no row"))
        }
    })
}
