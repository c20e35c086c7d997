//! The networks that the bench tracks with, trained on a rig's tuning recordings alone.

use model_export::link::settings::SettingValue;

use super::compare::CompareError;
use crate::control::{PERIOD_S, setting};
use crate::export;
use crate::recording::Recording;
use crate::train::{CheckpointPlan, TrainConfig, train};
use crate::tune::Tuned;

/// Play operators in front of a network: two minutes of recordings are too little for it to learn what those remember.
const PRESET: &str = "hybrid";
/// How far ahead of the pressure an inverse sees the displacement, s: dead time and lags, and enough of what follows to tell a rate from.
const LOOK_AHEAD_S: f64 = 0.2;

/// A network in its blob, and the settings that go with it.
#[derive(Clone, Debug)]
pub struct Learned {
    /// The blob, with the tuned actuator in it.
    pub blob: Vec<u8>,
    /// Settings that it needs.
    pub settings: [(u16, SettingValue); 1],
}

/// An inverse, trained for so many nominal CPU seconds.
///
/// # Errors
/// When training or export fails.
pub fn inverse(tuned: &Tuned, recordings: &[Recording], cpu_s: f64, seed: u64) -> Result<Learned, CompareError> {
    let exchanged = recordings.iter().map(|recording| recording.exchanged(LOOK_AHEAD_S)).collect::<Result<Vec<_>, _>>()?;
    let blob = trained(&exchanged, tuned, cpu_s, seed)?;
    // The device shows the inverse the reference as it will be, the recordings what it was on average over a sample.
    let look_ahead_ms = (1e3 * LOOK_AHEAD_S + 500.0 * PERIOD_S).round() as u32;
    Ok(Learned { blob, settings: [setting("control.learned_look_ahead_ms", SettingValue::Integer(look_ahead_ms))] })
}

/// An estimator, and the setting that makes the controllers listen to it instead of the modelled actuator.
///
/// # Errors
/// When training or export fails.
pub fn estimator(tuned: &Tuned, recordings: &[Recording], cpu_s: f64, seed: u64) -> Result<Learned, CompareError> {
    let blob = trained(recordings, tuned, cpu_s, seed)?;
    Ok(Learned { blob, settings: [setting("control.estimate_by_physics", SettingValue::Flag(false))] })
}

fn trained(recordings: &[Recording], tuned: &Tuned, cpu_s: f64, seed: u64) -> Result<Vec<u8>, CompareError> {
    let Some(preset) = TrainConfig::preset(PRESET) else { return Err(CompareError::NoController) };
    let config = TrainConfig { budget_cpu_s: cpu_s, ..preset };
    let (model, _) = train(recordings, &config, seed, 1, &CheckpointPlan::default(), &mut |_| {})?;
    Ok(export::export_with(&model, recordings, Some(tuned.fitted.compensation.clone()))?.bytes)
}
