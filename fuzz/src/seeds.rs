//! Valid files of the kinds that the program itself writes, small, made by its own code where they are not texts.

use std::path::Path;
use std::sync::OnceLock;

use host_tool::excitation::sets::SetConfig;
use host_tool::link::{FlashMemory, InProcess};
use host_tool::network;
use host_tool::recording::{self, ColumnMap, Recording};
use host_tool::track::rig::Mover;
use host_tool::train::{CheckpointPlan, TrainConfig, train};
use host_tool::{export, track};
use model_export::link::message::Request;

/// A file of this package.
pub fn file(name: &str) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("files").join(name);
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// A file among the vectors of the import.
pub fn vector(name: &str) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/vectors/import").join(name);
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Two short recordings of a bent loop, 20 ms apart.
pub fn recordings() -> &'static [Recording] {
    static RECORDINGS: OnceLock<Vec<Recording>> = OnceLock::new();
    RECORDINGS.get_or_init(|| [0.5, 0.7].map(recording).to_vec())
}

fn recording(frequency_hz: f64) -> Recording {
    let mut text = "time_s,pressure_bar,displacement_mm\n".to_owned();
    let mut state = 0.0_f64;
    for sample in 0..400 {
        let time_s = f64::from(sample) * 0.02;
        let pressure_bar = 1.0 - (std::f64::consts::TAU * frequency_hz * time_s).cos();
        state = (pressure_bar - 0.2).max((pressure_bar + 0.2).min(state));
        text.push_str(&format!("{time_s:.2},{pressure_bar},{}\n", 2.0 * (state + 0.5 * pressure_bar).tanh()));
    }
    recording::parse(Path::new("run.csv"), text.as_bytes(), &ColumnMap::own()).expect("a recording")
}

/// The smallest networks of two presets.
pub fn config(preset: &str) -> TrainConfig {
    let preset = TrainConfig::preset(preset).expect("a preset");
    TrainConfig { units: vec![3], lanes: 2, chunk: 20, longest_visit: 100, settling_samples: 5, synthetic: 0, epochs: Some(1.0), ..preset }
}

/// Networks in safetensors.
pub fn networks() -> Vec<Vec<u8>> {
    let one = |preset| {
        let (model, _) = train(recordings(), &config(preset), 1, 1, &CheckpointPlan::default(), &mut |_| {}).expect("a training");
        network::to_bytes(&model).expect("bytes")
    };
    vec![one("hybrid"), one("stream-1x32")]
}

/// Blobs.
pub fn blobs() -> Vec<Vec<u8>> {
    let blob = |bytes: Vec<u8>| {
        let model = network::from_bytes(&bytes, "seed").expect("a network");
        export::export(&model, recordings()).expect("a blob").bytes
    };
    networks().into_iter().map(blob).collect()
}

/// A checkpoint of [`config`]'s `stream-1x32`.
pub fn checkpoints() -> Vec<Vec<u8>> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("model.checkpoint");
    let plan = CheckpointPlan { path: Some(path.clone()), resume: false, stop_after: Some(2) };
    train(recordings(), &config("stream-1x32"), 1, 1, &plan, &mut |_| {}).expect("a training that is interrupted");
    vec![std::fs::read(path).expect("the checkpoint")]
}

/// A flash with a model and settings.
pub fn flashes() -> Vec<Vec<u8>> {
    let flash = FlashMemory::with_model(&blobs()[0]).and_then(|flash| flash.with_settings(&Default::default())).expect("a flash");
    vec![flash.to_bytes()]
}

/// The replay log of a device that is asked a few things.
pub fn journals() -> Vec<Vec<u8>> {
    let recorder = track::rig::recorder("virtual", &Mover::Realistic, 1);
    let processor = InProcess::new(FlashMemory::default());
    let (mut client, _) =
        track::rig::connect(processor, Mover::Realistic.hardware(1, 1), "the fuzzer's rig", Some(recorder)).expect("a rig");
    for request in [Request::Status, Request::Arm, Request::Status] {
        client.ask(&request).expect("an answer");
    }
    let rig = client.into_transport();
    vec![rig.observer().replay_log().expect("a replay log").to_bytes().expect("bytes")]
}

/// Excitations of a set.
pub fn excitations() -> Vec<Vec<u8>> {
    let set = host_tool::excitation::sets::rich_training(&SetConfig::default());
    set.iter().step_by(17).map(|named| host_tool::excitation::to_toml(&named.excitation).into_bytes()).collect()
}
