//! PyTorch: the `state_dict` of a module with LSTM, GRU and linear layers, under any prefix.
//!
//! `weight_ih_lK` has `4 * units` rows of inputs and `weight_hh_lK` as many of units, in gate order i, f, g, o, which is ours; a GRU has
//! `3 * units`, in the order r, z, n, which is ours with z for u. `torch.nn.LSTMCell` and `GRUCell` have the same names without `_lK`. What
//! follows a linear layer is not in the state.

use std::collections::BTreeMap;

use super::ImportError;
use super::options::Options;
use super::source::{SourceLayer, SourceNetwork, SourceStage, joined, joined_biases, ordered, recurrent_cell, with_activations};
use super::tensors::{State, Tensor};
use crate::network::Activation;

/// What a tensor of a state belongs to.
enum Part<'a> {
    /// `weight_ih`, `weight_hh`, `bias_ih` or `bias_hh` of a layer of a module.
    Recurrent { module: &'a str, layer: usize },
    /// `weight` or `bias` of a module.
    Dense { module: &'a str },
}

/// Whether these are names of PyTorch's recurrent layers, or of linear layers only.
#[must_use]
pub fn is_state(state: &State) -> bool {
    state.tensors.values().any(|tensor| {
        let leaf = tensor.name.rsplit('.').next().unwrap_or(&tensor.name);
        ["weight_ih", "weight_hh"].iter().any(|start| leaf.starts_with(start)) || leaf == "weight"
    })
}

fn module_and_leaf(name: &str) -> (&str, &str) {
    name.rsplit_once('.').unwrap_or(("", name))
}

fn part<'a>(tensor: &'a Tensor) -> Result<Part<'a>, ImportError> {
    let name = tensor.name.as_str();
    let (module, leaf) = module_and_leaf(name);
    let refuse = |what: &str, remedy: &str| Err(ImportError::refuse(format!("`{name}`, {what},"), remedy));
    if leaf.ends_with("_reverse") {
        return refuse("part of a bidirectional layer", "a controller does not know the future; train with bidirectional=False");
    }
    if leaf.starts_with("weight_hr") {
        return refuse("the projection of an LSTM", "train without proj_size");
    }
    if leaf.starts_with("running_") || leaf == "num_batches_tracked" {
        return refuse("part of a batch normalisation", "train without it, and normalise with --input-offset and --input-scale");
    }
    for start in ["weight_ih", "weight_hh", "bias_ih", "bias_hh"] {
        let Some(rest) = leaf.strip_prefix(start) else { continue };
        let layer = if rest.is_empty() { Some(0) } else { rest.strip_prefix("_l").and_then(|number| number.parse().ok()) };
        if let Some(layer) = layer {
            return Ok(Part::Recurrent { module, layer });
        }
    }
    match (leaf, tensor.shape.len()) {
        ("weight", 1) => refuse("the one-dimensional weight of a normalisation or a PReLU", "train without that layer"),
        ("weight", 2) | ("bias", 1) => Ok(Part::Dense { module }),
        ("weight", 3..) => refuse("the kernel of a convolution", "only LSTM, GRU and dense layers fit"),
        _ => refuse("a tensor that belongs to no LSTM, GRU or dense layer", "leave it out if the network does not use it"),
    }
}

/// The name of a module in messages: the network itself has none.
fn shown(module: &str, layer: usize) -> String {
    if module.is_empty() { format!("layer {layer}") } else { format!("{module}, layer {layer}") }
}

/// Reads the network of a state, with the order of its modules and the activations of its linear layers where somebody gave them.
///
/// # Errors
/// What is missing, does not fit, or cannot be represented, by name.
pub fn read(state: &State, options: &Options) -> Result<SourceNetwork, ImportError> {
    let mut modules: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    let mut heads: Vec<&str> = Vec::new();
    for tensor in state.tensors.values() {
        match part(tensor)? {
            Part::Recurrent { module, layer } => {
                let layers = modules.entry(module).or_default();
                if !layers.contains(&layer) {
                    layers.push(layer);
                }
            }
            Part::Dense { module } if !heads.contains(&module) => heads.push(module),
            Part::Dense { .. } => {}
        }
    }
    let mut notes = Vec::new();
    let mut found = Vec::new();
    for (module, mut numbers) in modules {
        numbers.sort_unstable();
        let layers = numbers.iter().map(|number| layer(state, module, *number, &mut notes).map(SourceStage::Recurrent));
        found.push((module.to_owned(), layers.collect::<Result<Vec<_>, _>>()?));
    }
    for module in heads {
        found.push((module.to_owned(), vec![SourceStage::Dense(dense(state, module)?, None)]));
    }
    let stages = with_activations(ordered(found, options.layers.as_deref())?, options.dense_activation.as_deref())?;
    let (layers, dense) = joined(stages, &mut notes)?;
    // PyTorch's LSTM and GRU have no other activation.
    Ok(SourceNetwork { kind: "PyTorch state", layers, dense, activation: Some(Activation::Tanh), last_step_only: None, notes })
}

fn layer(state: &State, module: &str, number: usize, notes: &mut Vec<String>) -> Result<SourceLayer, ImportError> {
    let stem = if module.is_empty() { String::new() } else { format!("{module}.") };
    let is_cell = state.tensors.keys().any(|name| *name == format!("{stem}weight_ih") || *name == format!("{stem}weight_hh"));
    let full = |name: &str| if is_cell { format!("{stem}{name}") } else { format!("{stem}{name}_l{number}") };
    let (from_input, from_hidden) = (state.get(&full("weight_ih"))?, state.get(&full("weight_hh"))?);
    let (rows, units) = from_hidden.matrix()?;
    let cell = recurrent_cell(&from_hidden.name, rows, units)?;
    let (_, inputs) = from_input.matrix()?;
    let input_weights = from_input.shaped(&[rows, inputs])?.to_vec();
    let (first, second) = (full("bias_ih"), full("bias_hh"));
    let bias = if state.tensors.contains_key(&first) || state.tensors.contains_key(&second) {
        let (first, second) = (state.get(&first)?.shaped(&[rows])?, state.get(&second)?.shaped(&[rows])?);
        joined_biases(cell, units, first, second)
    } else {
        notes.push(format!("`{}` has no biases: they are zero", shown(module, number)));
        vec![0.0; cell.gates().len() * units]
    };
    Ok(SourceLayer { name: shown(module, number), cell, inputs, units, input_weights, recurrent_weights: from_hidden.values.clone(), bias })
}

fn dense(state: &State, module: &str) -> Result<SourceLayer, ImportError> {
    let full = |name: &str| if module.is_empty() { name.to_owned() } else { format!("{module}.{name}") };
    let weight = state.get(&full("weight"))?;
    let (outputs, inputs) = weight.matrix()?;
    let bias = match state.tensors.get(&full("bias")) {
        Some(bias) => bias.shaped(&[outputs])?.to_vec(),
        None => Vec::new(),
    };
    SourceLayer::dense(weight.name.clone(), [outputs, inputs], weight.values.clone(), bias)
}
