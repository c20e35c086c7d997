//! Trained models on disk: safetensors, with everything but the weights as JSON in the header's metadata.

use std::collections::HashMap;
use std::path::Path;

use model_export::schema;
use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use serde::{Deserialize, Serialize};

use super::{Activation, Cell, Channel, Layer, Mode, Network, Provenance, TrainedModel};

/// Newest version of the metadata and tensor names. Version 2 added layers other than LSTM and features of past inputs, version 3 several
/// inputs, version 4 further stages of the front end; a model is written in the oldest version that has room for it.
pub const FORMAT_VERSION: u32 = 4;

const METADATA_KEY: &str = "catheter-model";

/// Why a model file was refused.
#[derive(Debug, thiserror::Error)]
pub enum ModelFileError {
    /// The file cannot be read or written.
    #[error("{path}: {message}")]
    Io {
        /// The file.
        path: String,
        /// What the system said.
        message: String,
    },
    /// Not a safetensors file, or damaged.
    #[error("{path}: not a readable safetensors file ({message}); train the model again or restore the file")]
    Format {
        /// The file.
        path: String,
        /// What is wrong.
        message: String,
    },
    /// A safetensors file, but not one of ours.
    #[error(
        "{path}: the metadata entry `catheter-model` is missing or unreadable ({message}); only files written by `catheter train` can be loaded"
    )]
    Metadata {
        /// The file.
        path: String,
        /// What is wrong.
        message: String,
    },
    /// Another version of the format.
    #[error(
        "{path}: model format version {found}, this tool reads versions 1 to {FORMAT_VERSION}; train the model again with this version of the tool"
    )]
    Version {
        /// The file.
        path: String,
        /// The file's version.
        found: u32,
    },
    /// A tensor is missing or has another shape than the metadata says.
    #[error("{path}: tensor `{tensor}`: {message}")]
    Tensor {
        /// The file.
        path: String,
        /// The tensor's name.
        tensor: String,
        /// What is wrong.
        message: String,
    },
}

#[derive(Serialize, Deserialize)]
struct Architecture {
    activation: Activation,
    state_limit: f32,
    features: usize,
    units: Vec<usize>,
    /// One for each layer; none when all are LSTM.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    cells: Vec<Cell>,
}

/// Lists of the front end for inputs beside the first; see [`schema::FrontEnd`].
#[derive(Serialize, Deserialize)]
struct SeveralInputs {
    more_input_weights: heapless::Vec<f32, { schema::MAX_MORE_INPUTS }>,
    play_inputs: heapless::Vec<u8, { schema::MAX_PLAY }>,
    feature_inputs: heapless::Vec<u8, { schema::MAX_FEATURES }>,
}

#[derive(Serialize, Deserialize)]
struct Metadata {
    format_version: u32,
    input: Channel,
    /// Inputs beside the first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    more_inputs: Vec<Channel>,
    output: Channel,
    sample_period_s: f64,
    mode: Mode,
    front_end: schema::FrontEnd,
    /// What the front end has for inputs beside the first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    several_inputs: Option<SeveralInputs>,
    /// Further stages of the front end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    stages: Option<schema::Stages>,
    network: Option<Architecture>,
    provenance: Provenance,
}

fn bytes_of(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// The model as the bytes of a safetensors file.
///
/// # Errors
/// When the model cannot be encoded, for example because a value of the front end is not finite.
pub fn to_bytes(model: &TrainedModel) -> Result<Vec<u8>, String> {
    let has_other_cells = model.network.as_ref().is_some_and(|network| !network.is_lstm());
    let sees_past = model.front_end.features.iter().any(|feature| matches!(feature.source, schema::FeatureSource::Past(_)));
    let metadata = Metadata {
        format_version: match (model.more_inputs.is_empty(), has_other_cells || sees_past) {
            _ if model.front_end.stages.is_some() => 4,
            (false, _) => 3,
            (true, true) => 2,
            (true, false) => 1,
        },
        input: model.input.clone(),
        more_inputs: model.more_inputs.clone(),
        output: model.output.clone(),
        sample_period_s: model.sample_period_s,
        mode: model.mode,
        front_end: model.front_end.clone(),
        several_inputs: (!model.more_inputs.is_empty()).then(|| SeveralInputs {
            more_input_weights: model.front_end.more_input_weights.clone(),
            play_inputs: model.front_end.play_inputs.clone(),
            feature_inputs: model.front_end.feature_inputs.clone(),
        }),
        stages: model.front_end.stages.clone(),
        network: model.network.as_ref().map(|network| Architecture {
            activation: network.activation,
            state_limit: network.state_limit,
            features: network.features(),
            units: network.layers.iter().map(|layer| layer.units).collect(),
            cells: if has_other_cells { network.layers.iter().map(|layer| layer.cell).collect() } else { Vec::new() },
        }),
        provenance: model.provenance.clone(),
    };
    let json = serde_json::to_string(&metadata).map_err(|error| error.to_string())?;
    let mut tensors: Vec<(String, Vec<usize>, Vec<u8>)> = Vec::new();
    if let Some(network) = &model.network {
        for (index, layer) in network.layers.iter().enumerate() {
            for (name, shape, values) in [
                ("input_weights", vec![layer.cell.input_rows() * layer.units, layer.inputs], &layer.input_weights),
                ("recurrent_weights", vec![layer.cell.recurrent_rows() * layer.units, layer.units], &layer.recurrent_weights),
                ("bias", vec![layer.bias.len()], &layer.bias),
            ] {
                tensors.push((format!("layers.{index}.{name}"), shape, bytes_of(values)));
            }
        }
        tensors.push(("dense.weights".to_owned(), vec![network.dense_weights.len()], bytes_of(&network.dense_weights)));
        tensors.push(("dense.bias".to_owned(), vec![1], bytes_of(&[network.dense_bias])));
    }
    let mut views = Vec::with_capacity(tensors.len());
    for (name, shape, bytes) in &tensors {
        let view = TensorView::new(Dtype::F32, shape.clone(), bytes).map_err(|error| error.to_string())?;
        views.push((name.clone(), view));
    }
    serialize(views, Some(HashMap::from([(METADATA_KEY.to_owned(), json)]))).map_err(|error| error.to_string())
}

/// Writes a model, whole or not at all.
///
/// # Errors
/// When the file cannot be written.
pub fn save(path: &Path, model: &TrainedModel) -> Result<(), ModelFileError> {
    let failed = |message: String| ModelFileError::Io { path: path.display().to_string(), message };
    let bytes = to_bytes(model).map_err(failed)?;
    output::write_atomic(path, &bytes).map_err(|error| failed(format!("{error:#}")))
}

/// Reads a model.
///
/// # Errors
/// When the file cannot be read, is damaged, is of another version, or a tensor does not fit the metadata.
pub fn load(path: &Path) -> Result<TrainedModel, ModelFileError> {
    let bytes = output::read(path).map_err(|error| ModelFileError::Io { path: path.display().to_string(), message: error.to_string() })?;
    from_bytes(&bytes, &path.display().to_string())
}

/// Reads a model from the bytes of a file; `path` is for messages.
///
/// # Errors
/// As [`load`].
pub fn from_bytes(bytes: &[u8], path: &str) -> Result<TrainedModel, ModelFileError> {
    let format = |message: String| ModelFileError::Format { path: path.to_owned(), message };
    let unreadable = |message: String| ModelFileError::Metadata { path: path.to_owned(), message };
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(|error| format(error.to_string()))?;
    let json =
        header.metadata().as_ref().and_then(|entries| entries.get(METADATA_KEY)).ok_or_else(|| unreadable("no such entry".to_owned()))?;
    // The version is read on its own first, so that a file of another version is named as such and not as damaged.
    let value: serde_json::Value = serde_json::from_str(json).map_err(|error| unreadable(error.to_string()))?;
    let found = value.get("format_version").and_then(serde_json::Value::as_u64).and_then(|version| u32::try_from(version).ok());
    match found {
        Some(1..=FORMAT_VERSION) => {}
        Some(found) => return Err(ModelFileError::Version { path: path.to_owned(), found }),
        None => return Err(unreadable("no format version".to_owned())),
    }
    let metadata: Metadata = serde_json::from_value(value).map_err(|error| unreadable(error.to_string()))?;
    let positive = |value: f64| value.is_finite() && value > 0.0;
    let checks = [
        ("sample_period_s", positive(metadata.sample_period_s)),
        ("input.scale", positive(f64::from(metadata.input.scale))),
        ("more_inputs.scale", metadata.more_inputs.iter().all(|channel| positive(f64::from(channel.scale)))),
        ("output.scale", positive(f64::from(metadata.output.scale))),
        ("state_limit", metadata.network.as_ref().is_none_or(|network| positive(f64::from(network.state_limit)))),
        ("units", metadata.network.as_ref().is_none_or(|network| !network.units.is_empty() && !network.units.contains(&0))),
        (
            "number of cells",
            metadata.network.as_ref().is_none_or(|network| network.cells.is_empty() || network.cells.len() == network.units.len()),
        ),
        ("mode.window.length", metadata.mode != Mode::Window { length: 0 }),
    ];
    if let Some((name, _)) = checks.iter().find(|(_, good)| !good) {
        return Err(unreadable(format!("{name} is not positive, or not that of the layers")));
    }
    let tensors = SafeTensors::deserialize(bytes).map_err(|error| format(error.to_string()))?;
    let network = metadata.network.map(|architecture| read_network(&tensors, &architecture, path)).transpose()?;
    if let Some(network) = &network
        && network.features() != metadata.front_end.features.len()
    {
        return Err(unreadable(format!(
            "the front end offers {} features, the network takes {}",
            metadata.front_end.features.len(),
            network.features()
        )));
    }
    let mut front_end = metadata.front_end;
    front_end.stages = metadata.stages;
    if let Some(several) = metadata.several_inputs {
        front_end.more_input_weights = several.more_input_weights;
        front_end.play_inputs = several.play_inputs;
        front_end.feature_inputs = several.feature_inputs;
    }
    // An index without its operator or a number out of its domain would otherwise be met in the middle of a run.
    front_end.validate().map_err(|invalid| unreadable(invalid.to_string()))?;
    if front_end.inputs() != 1 + metadata.more_inputs.len() {
        return Err(unreadable(format!("{} inputs and a front end of {}", 1 + metadata.more_inputs.len(), front_end.inputs())));
    }
    Ok(TrainedModel {
        input: metadata.input,
        more_inputs: metadata.more_inputs,
        output: metadata.output,
        sample_period_s: metadata.sample_period_s,
        mode: metadata.mode,
        front_end,
        network,
        provenance: metadata.provenance,
    })
}

fn read_network(tensors: &SafeTensors<'_>, architecture: &Architecture, path: &str) -> Result<Network, ModelFileError> {
    let read = |name: String, shape: &[usize]| -> Result<Vec<f32>, ModelFileError> {
        let refuse = |message: String| ModelFileError::Tensor { path: path.to_owned(), tensor: name.clone(), message };
        let tensor = tensors.tensor(&name).map_err(|error| refuse(error.to_string()))?;
        if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
            return Err(refuse(format!("{:?} {:?} where F32 {shape:?} is expected", tensor.dtype(), tensor.shape())));
        }
        let (words, _) = tensor.data().as_chunks::<4>();
        let values: Vec<f32> = words.iter().map(|&word| f32::from_le_bytes(word)).collect();
        match values.iter().position(|value| !value.is_finite()) {
            Some(index) => Err(refuse(format!("element {index} is not finite"))),
            None => Ok(values),
        }
    };
    let mut inputs = architecture.features;
    let mut layers = Vec::with_capacity(architecture.units.len());
    for (index, &units) in architecture.units.iter().enumerate() {
        let cell = architecture.cells.get(index).copied().unwrap_or_default();
        layers.push(Layer {
            cell,
            inputs,
            units,
            input_weights: read(format!("layers.{index}.input_weights"), &[cell.input_rows() * units, inputs])?,
            recurrent_weights: read(format!("layers.{index}.recurrent_weights"), &[cell.recurrent_rows() * units, units])?,
            bias: read(format!("layers.{index}.bias"), &[cell.gates().len() * units])?,
        });
        inputs = units;
    }
    Ok(Network {
        activation: architecture.activation,
        state_limit: architecture.state_limit,
        layers,
        dense_weights: read("dense.weights".to_owned(), &[inputs])?,
        dense_bias: read("dense.bias".to_owned(), &[1])?[0],
    })
}
