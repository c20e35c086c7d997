//! One reference, several controllers, side by side; and the recordings that a virtual rig is tuned on.

use std::path::{Path, PathBuf};

use model_export::link::message::Telemetry;
use model_export::link::settings::SettingValue;

use super::rig::{self, Mover, Truth};
use super::run::{self, RunError};
use crate::control::{Controller, Figures, Reference, Sample, SettingValues, figures, setting};
use crate::export::ExportError;
use crate::link::{Client, Transport};
use crate::recording::{ExtraColumn, Recording, RecordingError, Signal};
use crate::train::TrainError;
use crate::tune::simulate::Limits;
use crate::tune::{self, TuneError, Tuned};

/// Highest pressure of the recordings that a rig is tuned on, bar.
pub const HIGHEST_BAR: f64 = 2.7;
/// Time at the beginning of a run that no figure counts: the way from rest to the reference's first point.
const SKIP_S: f64 = 1.0;

/// What the output of a simulated rig meets, as [`rig::rig_settings`] have it.
pub const RIG_LIMITS: Limits = Limits { ceiling_bar: 3.0, slew_bar_per_s: 40.0 };

/// What can go wrong.
#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    /// A run failed.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The link failed.
    #[error(transparent)]
    Link(#[from] crate::link::LinkError),
    /// Recordings could not be made.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Tuning failed.
    #[error(transparent)]
    Tune(#[from] TuneError),
    /// A network could not be trained.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// It has no blob.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// A controller or a reference that the program names itself does not exist.
    #[error("a controller or reference of the bench does not exist: this is a mistake in the program")]
    NoController,
}

/// One controller's run.
#[derive(Clone, Debug)]
pub struct Run {
    /// Its figures.
    pub figures: Figures,
    /// Every sample, the way to the first point included.
    pub samples: Vec<Sample>,
}

impl Run {
    /// The run as a recording: output and tip, with the reference, what was measured and estimated where that is known throughout, and whether
    /// the limiter held the output back.
    ///
    /// # Errors
    /// When the run has no samples.
    pub fn recording(&self, path: &Path) -> Result<Recording, RecordingError> {
        let samples = &self.samples;
        let all = |value: &dyn Fn(&Sample) -> f64| samples.iter().map(value).collect::<Vec<f64>>();
        let mut recording = Recording::new(
            path,
            Signal::pressure_bar(),
            Signal::displacement_mm(),
            all(&|sample| sample.time_s),
            all(&|sample| sample.output_bar),
            all(&|sample| sample.tip_mm),
        )?;
        let mut add = |name: &str, values: Option<Vec<f64>>| {
            recording.extra.extend(values.map(|values| ExtraColumn { name: name.to_owned(), values }));
        };
        add("reference_mm", Some(all(&|sample| sample.reference_mm)));
        add("pressure_measured_bar", samples.iter().map(|sample| sample.pressure_bar).collect());
        add("estimate_mm", samples.iter().map(|sample| sample.estimate_mm).collect());
        add("limited", Some(all(&|sample| f64::from(u8::from(sample.limited)))));
        Ok(recording)
    }
}

/// Runs a reference with a controller on a device.
///
/// # Errors
/// When the device refuses or vents.
pub fn run_one<T: Transport>(
    client: &mut Client<T>,
    truth: &Truth,
    settings: &SettingValues,
    blob: Option<&[u8]>,
    controller: Controller,
    reference: &Reference,
) -> Result<Run, CompareError> {
    run::prepare(client, settings, blob)?;
    follow(client, truth, controller, reference)
}

/// As [`run_one`], on a device that is prepared.
///
/// # Errors
/// When the device refuses or vents.
pub fn follow<T: Transport>(
    client: &mut Client<T>,
    truth: &Truth,
    controller: Controller,
    reference: &Reference,
) -> Result<Run, CompareError> {
    let telemetry = run::run(client, &reference.points_mm, &mut |_, _| {})?;
    let samples = run::samples(&telemetry, truth);
    let counted: Vec<Sample> = samples.iter().copied().filter(|sample| sample.time_s >= SKIP_S).collect();
    Ok(Run { figures: figures::of(controller.name, &counted), samples })
}

/// Runs a reference with every controller, each on a realistic rig of its own that begins at rest.
///
/// # Errors
/// When a run fails.
pub fn on_the_virtual_rig(tuned: &Tuned, seed: u64, reference: &Reference, controllers: &[Controller]) -> Result<Vec<Run>, CompareError> {
    controllers.iter().map(|controller| with_model(tuned, seed, reference, *controller, &tuned.blob, &[])).collect()
}

/// As [`on_the_virtual_rig`], one controller with this model and these settings on top of the tuned ones.
///
/// # Errors
/// When the run fails.
pub fn with_model(
    tuned: &Tuned,
    seed: u64,
    reference: &Reference,
    controller: Controller,
    blob: &[u8],
    changes: &[(u16, SettingValue)],
) -> Result<Run, CompareError> {
    let (mut client, truth) = rig::in_process(&Mover::Realistic, seed, 1)?;
    let mut settings = rig::rig_settings();
    settings.extend(tuned.settings(controller));
    settings.extend(changes);
    run_one(&mut client, &truth, &settings, Some(blob), controller, reference)
}

/// Records on a simulated rig what tuning wants to see.
///
/// # Errors
/// When a run fails.
pub fn record_for_tuning(mover: &Mover, seed: u64) -> Result<Vec<Recording>, CompareError> {
    let (mut client, _) = rig::in_process(mover, seed, 0)?;
    let mut settings = rig::rig_settings();
    settings.push(setting("telemetry.period_ms", SettingValue::Integer(20)));
    settings.extend(mover.settings());
    run::prepare(&mut client, &settings, None)?;
    let mut recordings = Vec::new();
    for (index, pressures_bar) in tune::excitation(HIGHEST_BAR, seed).iter().enumerate() {
        let telemetry = run::run(&mut client, pressures_bar, &mut |_, _| {})?;
        recordings.push(recording(index, &telemetry)?);
    }
    Ok(recordings)
}

/// Telemetry as a recording: command and displacement of the decimation filter's windows. A window without a plausible displacement is left out.
fn recording(index: usize, telemetry: &[Telemetry]) -> Result<Recording, RecordingError> {
    let rows: Vec<(f64, f64, f64)> = telemetry
        .iter()
        .filter_map(|sample| Some((sample.time_ms as f64 / 1000.0, f64::from(sample.command_bar), f64::from(sample.displacement_mm?))))
        .collect();
    let begin_s = rows.first().map_or(0.0, |row| row.0);
    Recording::new(
        &PathBuf::from(format!("tuning_{index}.csv")),
        Signal::pressure_bar(),
        Signal::displacement_mm(),
        rows.iter().map(|row| row.0 - begin_s).collect(),
        rows.iter().map(|row| row.1).collect(),
        rows.iter().map(|row| row.2).collect(),
    )
}

/// Records and tunes on a realistic rig.
///
/// # Errors
/// When a run or the tuning fails.
pub fn tune_virtual_rig(rig_seed: u64, tuning_seed: u64) -> Result<(Tuned, Vec<Recording>), CompareError> {
    tune_on(&Mover::Realistic, rig_seed, tuning_seed)
}

/// Records and tunes on a simulated rig.
///
/// # Errors
/// When a run or the tuning fails.
pub fn tune_on(mover: &Mover, rig_seed: u64, tuning_seed: u64) -> Result<(Tuned, Vec<Recording>), CompareError> {
    let recordings = record_for_tuning(mover, rig_seed)?;
    let tuned = tune::tune(&recordings, RIG_LIMITS, tuning_seed, &|_| {})?;
    Ok((tuned, recordings))
}
