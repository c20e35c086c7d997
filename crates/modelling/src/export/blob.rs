//! A blob of a model: calibrated, quantised, with golden vectors, and measured.

use firmware::estimator::{Estimator, EstimatorState, MAX_PACKED_WORDS};
use model_export::blob::{self, BlobError, crc32};
use model_export::certificate::certificate;
use model_export::compensation::{Compensation, Extension};
use model_export::quantise::{LayerCalibration, QuantisedNetwork, quantise};
use model_export::schema;

use super::calibrate::{self, Calibration};
use super::error::ExportError;
use super::forms::float_network;
use super::reference::Reference;
use super::report::{self, Comparison};
use super::work::Work;
use crate::model::PERIOD_TOLERANCE;
use crate::network::{Channel, Mode, Network, TrainedModel, narrowed};
use recording::{Recording, RecordingError};

/// A finished export.
#[derive(Clone, Debug)]
pub struct Export {
    /// The blob.
    pub bytes: Vec<u8>,
    /// Fixed point against `f32` and the reference over the calibration data.
    pub comparison: Comparison,
    /// `nearest`, `error feedback`, or `none` without a network.
    pub rounding: &'static str,
    /// Room left in the tightest sum; infinite without a network.
    pub headroom: f64,
    /// Recordings calibrated with.
    pub recordings: usize,
}

/// Recordings to calibrate a model with. An inverse is calibrated on the recordings it was trained on, with input and output exchanged;
/// their ranges do not depend on how far it looks ahead.
///
/// # Errors
/// When a recording is too short to be exchanged.
pub fn as_the_model_sees(model: &TrainedModel, recordings: Vec<Recording>) -> Result<Vec<Recording>, RecordingError> {
    if (model.input.unit.as_str(), model.output.unit.as_str()) == ("mm", "bar") {
        return recordings.iter().map(|recording| recording.exchanged(0.0)).collect();
    }
    Ok(recordings)
}

/// Samples in the golden vectors: enough for several reversals, few enough to replay at every boot.
pub(super) const GOLDEN_SAMPLES: usize = 200;

/// Golden tolerance over the error measured when the vectors were made: rounding is the same everywhere, so little is needed.
const GOLDEN_MARGIN: f32 = 1.5;

/// Smallest golden tolerance in normalised output: the rounding of the `f32` front end.
const GOLDEN_FLOOR: f32 = 1e-5;

/// Multiply-accumulates that calibration may spend; beyond it, it takes every n-th recording.
const CALIBRATION_MACS: usize = 4_000_000_000;

/// Makes a blob of a model.
///
/// # Errors
/// When the data do not belong to the model, or the model has no fixed-point form.
pub fn export(model: &TrainedModel, data: &[Recording]) -> Result<Export, ExportError> {
    export_with(model, data, None)
}

/// Makes a blob of a model with what the controllers need of the actuator in it.
///
/// # Errors
/// As [`export`].
pub fn export_with(model: &TrainedModel, data: &[Recording], compensation: Option<Compensation>) -> Result<Export, ExportError> {
    export_told(model, data, compensation, &|_, _| {})
}

/// As [`export_with`]; `told` hears how much of the work is done, and of how much.
///
/// # Errors
/// As [`export`].
pub fn export_told(
    model: &TrainedModel,
    data: &[Recording],
    compensation: Option<Compensation>,
    told: &dyn Fn(u64, u64),
) -> Result<Export, ExportError> {
    for recording in data {
        check(model, recording)?;
    }
    let macs = model.network.as_ref().map_or(100, Network::macs_per_step);
    let steps = if let Mode::Window { length } = model.mode { length } else { 1 };
    let data = calibrate::choose(data, CALIBRATION_MACS / (macs * steps).max(1));
    if data.iter().all(|recording| recording.is_empty()) {
        return Err(ExportError::NoData);
    }
    let work = Work::of(model, data.iter().map(Recording::len).sum(), told);
    let calibration = Calibration::worked_out(model, &data, &work);
    let extension = Extension { compensation, domain: Some(calibration.domain) }.encode();
    let (golden_input, golden_output) = golden(model, &data);
    let golden_bytes: Vec<u8> = golden_output.iter().flat_map(|y| y.to_le_bytes()).collect();

    let mut candidates: Vec<(&'static str, Option<QuantisedNetwork>)> = Vec::new();
    match &model.network {
        None => candidates.push(("none", None)),
        Some(network) => {
            let float = float_network(network);
            let layers = |with_moments: bool| -> Vec<LayerCalibration> {
                let seen = calibration.layers.iter().cloned();
                seen.map(|layer| LayerCalibration { moments: layer.moments.filter(|_| with_moments), ..layer }).collect()
            };
            let (nearest, feedback) = (quantise(&float, &layers(false))?, quantise(&float, &layers(true))?);
            let is_certified = |network: &QuantisedNetwork| certificate(&network.as_wire(), 1.0).is_some_and(|found| found.holds());
            // Error feedback moves weights by many steps; a network that was trained to be certified shall stay so.
            let loses_certificate = is_certified(&nearest) && !is_certified(&feedback);
            candidates.push(("nearest", Some(nearest)));
            if !loses_certificate {
                candidates.push(("error feedback", Some(feedback)));
            }
        }
    }
    work.expect(candidates.len() as u64, model.network.is_some());
    let mut best: Option<Export> = None;
    for (rounding, network) in &candidates {
        let mut parts = Parts {
            model,
            network: network.as_ref(),
            calibration: &calibration,
            extension: &extension,
            golden_input: &golden_input,
            golden_output: &golden_bytes,
            metrics: schema::Metrics::default(),
            tolerance: 0.0,
            digest: 0,
        };
        let wire = parts.wire()?;
        // As the board builds it: what does not fit there is refused here.
        Estimator::with_kernel(&wire, vec![0; MAX_PACKED_WORDS].as_mut_slice()).map_err(BlobError::from)?;
        let comparison = report::compare(model, &wire, &data, &work).map_err(BlobError::from)?;
        let (worst, digest) = replay(&wire, &golden_output)?;
        parts.metrics = schema::Metrics {
            validation_rmse: model.provenance.validation_rmse as f32,
            rmse_f32_vs_fixed: comparison.rmse as f32,
            max_abs_f32_vs_fixed: comparison.max_abs as f32,
            calibration_samples: u32::try_from(comparison.samples).unwrap_or(u32::MAX),
        };
        parts.tolerance = (worst * GOLDEN_MARGIN).max(GOLDEN_FLOOR * model.output.scale);
        parts.digest = digest;
        let bytes = blob::encode(&parts.wire()?)?;
        let headroom = network.as_ref().map_or(f64::INFINITY, |network| model_export::headroom::headroom(&network.as_wire()).least());
        if best.as_ref().is_none_or(|best| comparison.rmse < best.comparison.rmse) {
            best = Some(Export { bytes, comparison, rounding, headroom, recordings: data.len() });
        }
    }
    best.ok_or(ExportError::NoData)
}

fn check(model: &TrainedModel, recording: &Recording) -> Result<(), ExportError> {
    let path = || recording.path.display().to_string();
    let mut channels = vec![
        ("input", &recording.input_signal, &model.input), //
        ("output", &recording.output_signal, &model.output),
    ];
    if recording.more_inputs.len() < model.more_inputs.len() {
        return Err(ExportError::Inputs { path: path(), found: recording.inputs().len(), expected: model.inputs().count() });
    }
    channels.extend(recording.more_inputs.iter().zip(&model.more_inputs).map(|(found, expected)| ("input", &found.signal, expected)));
    for (channel, signal, expected) in channels {
        if signal.quantity != expected.quantity || signal.unit != expected.unit {
            return Err(ExportError::Signal {
                path: path(),
                channel,
                found: format!("{} in {}", signal.quantity, signal.unit),
                expected: format!("{} in {}", expected.quantity, expected.unit),
            });
        }
    }
    if (recording.sample_period_s / model.sample_period_s - 1.0).abs() > PERIOD_TOLERANCE {
        return Err(ExportError::SamplePeriod { path: path(), found: recording.sample_period_s, expected: model.sample_period_s });
    }
    Ok(())
}

/// Input as the device gets it, in `f32`, and the reference's output, of the recording that spans the most.
fn golden(model: &TrainedModel, data: &[Recording]) -> (Vec<u8>, Vec<f32>) {
    let span = |recording: &Recording| -> f64 {
        let one = |(values, channel): (&[f64], &Channel)| {
            let part = values.iter().take(GOLDEN_SAMPLES);
            (part.clone().copied().fold(f64::MIN, f64::max) - part.copied().fold(f64::MAX, f64::min)) / f64::from(channel.scale)
        };
        recording.inputs().into_iter().zip(model.inputs()).map(one).sum()
    };
    let widest = data.iter().filter(|recording| !recording.is_empty()).max_by(|a, b| span(a).total_cmp(&span(b)));
    let mut reference = Reference::new(model);
    let count = model.inputs().count();
    let mut input: Vec<f32> = Vec::new();
    if let Some(recording) = widest {
        let inputs = recording.inputs();
        (0..recording.len().min(GOLDEN_SAMPLES)).for_each(|sample| input.extend(narrowed(&inputs[..count], sample)));
    }
    let wide = |sample: &[f32]| sample.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>();
    let output = input.chunks(count).map(|sample| reference.step(&wide(sample), &mut |_| {}) as f32).collect();
    (input.iter().flat_map(|x| x.to_le_bytes()).collect(), output)
}

/// Largest difference of the estimator from the golden output, and the digest of its bits.
fn replay(model: &schema::Model<'_>, golden_output: &[f32]) -> Result<(f32, u32), ExportError> {
    let estimator = Estimator::new(model).map_err(BlobError::from)?;
    let mut state = EstimatorState::default();
    let (mut worst, mut digest) = (0.0f32, 0);
    for (bytes, expected) in model.golden.input.as_chunks::<4>().0.chunks(estimator.inputs()).zip(golden_output) {
        let raw: Vec<f32> = bytes.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        let value = estimator.step_all(&mut state, &raw).value;
        worst = worst.max((value - expected).abs());
        digest = crc32(digest, &value.to_le_bytes());
    }
    Ok((worst, digest))
}

/// What a blob is made of.
struct Parts<'a> {
    model: &'a TrainedModel,
    network: Option<&'a QuantisedNetwork>,
    calibration: &'a Calibration,
    extension: &'a [u8],
    golden_input: &'a [u8],
    golden_output: &'a [u8],
    metrics: schema::Metrics,
    tolerance: f32,
    digest: u32,
}

impl<'a> Parts<'a> {
    fn wire(&self) -> Result<schema::Model<'a>, ExportError> {
        let model = self.model;
        let mode = match model.mode {
            Mode::Streaming => schema::Mode::Streaming,
            Mode::Window { length } => schema::Mode::Window { length: u16::try_from(length).map_err(|_| ExportError::Window { length })? },
        };
        let provenance = &model.provenance;
        Ok(schema::Model {
            more_inputs: model.more_inputs.iter().map(Channel::as_wire).collect(),
            sample_period_s: model.sample_period_s as f32,
            mode,
            input: model.input.as_wire(),
            output: model.output.as_wire(),
            front_end: model.front_end.clone(),
            network: self.network.map(QuantisedNetwork::as_wire),
            provenance: schema::Provenance {
                preset: &provenance.preset,
                tool_version: &provenance.tool_version,
                training_data_sha256: &provenance.training_data_sha256,
                seed: provenance.seed,
                training_recordings: u32::try_from(provenance.training_recordings).unwrap_or(u32::MAX),
                optimiser_steps: provenance.optimiser_steps,
            },
            metrics: self.metrics,
            envelope: self.calibration.envelope,
            golden: schema::Golden { input: self.golden_input, output: self.golden_output, tolerance: self.tolerance, digest: self.digest },
            extension: self.extension,
        })
    }
}
