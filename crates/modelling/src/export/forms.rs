//! Models in the forms that the exporter takes.

use model_export::quantise::{FloatLayer, FloatNetwork};
use model_export::schema;
use sha2::{Digest, Sha256};

use super::error::ExportError;
use crate::network::{Channel, Mode, Network, Provenance, TrainedModel};
use crate::physics::{FittedModel, ModelError, PhysicsModel, chip};

/// The network as the quantiser takes it.
#[must_use]
pub fn float_network(network: &Network) -> FloatNetwork<'_> {
    let layers = network.layers.iter().map(|layer| FloatLayer {
        cell: layer.cell,
        inputs: layer.inputs,
        units: layer.units,
        input_weights: &layer.input_weights,
        recurrent_weights: &layer.recurrent_weights,
        bias: &layer.bias,
    });
    FloatNetwork {
        activation: network.activation,
        state_limit: network.state_limit,
        layers: layers.collect(),
        dense_weights: &network.dense_weights,
        dense_bias: network.dense_bias,
    }
}

/// A physics model as a model without a network.
///
/// # Errors
/// When the microcontroller's front end cannot represent it.
pub fn from_physics(physics: &PhysicsModel) -> Result<TrainedModel, ModelError> {
    let (input, output, front_end) = physics.front_end()?;
    let channel = |wire: schema::Channel<'_>| Channel {
        quantity: wire.quantity.to_owned(),
        unit: wire.unit.to_owned(),
        offset: wire.offset,
        scale: wire.scale,
        minimum: wire.minimum,
        maximum: wire.maximum,
    };
    // One hash for all files: that of their hashes, in order.
    let hashes: String = physics.provenance.data.iter().map(|source| source.sha256.as_str()).collect();
    let training_data_sha256 = Sha256::digest(hashes).iter().map(|byte| format!("{byte:02x}")).collect();
    let provenance = Provenance {
        preset: physics.provenance.method.clone(),
        tool_version: physics.provenance.program.clone(),
        training_data_sha256,
        training_recordings: physics.provenance.data.len(),
        // What recordings that took no part have shown, where some were left out.
        validation_rmse: physics.expected.as_ref().map_or(physics.provenance.rmse, |expected| expected.rmse),
        ..Provenance::default()
    };
    Ok(TrainedModel {
        more_inputs: Vec::new(),
        input: channel(input),
        output: channel(output),
        sample_period_s: physics.sample_period_s,
        mode: Mode::Streaming,
        front_end,
        network: None,
        provenance,
    })
}

/// A model of `catheter fit` as a model without a network.
///
/// # Errors
/// When the microcontroller has no form for it.
pub fn from_fitted(fitted: &FittedModel) -> Result<TrainedModel, ExportError> {
    let physics = chip::of_file(fitted).ok_or_else(|| ExportError::NoForm { name: fitted.name.clone() })?;
    Ok(from_physics(&physics)?)
}
