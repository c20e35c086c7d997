//! Keras: the weights of LSTM, GRU and Dense layers, under any prefix.
//!
//! `kernel` is `inputs x 4 units`, `recurrent_kernel` `units x 4 units`: columns, not rows, in gate order i, f, c, o, which is ours with
//! c for g. There is one `bias` of `4 units`. A GRU has three columns a unit, in the order z, r, h of our u, r and n; with `reset_after`
//! its bias has two rows, that of the input and that of the hidden state. What follows a Dense layer is not in the state.

use std::collections::BTreeMap;

use super::ImportError;
use super::options::Options;
use super::source::{SourceLayer, SourceNetwork, SourceStage, joined, joined_biases, ordered, recurrent_cell, with_activations};
use super::tensors::{State, Tensor, transposed};
use crate::network::Cell;

#[derive(Default)]
struct Group<'a> {
    kernel: Option<&'a Tensor>,
    recurrent: Option<&'a Tensor>,
    bias: Option<&'a Tensor>,
}

/// Whether these are names of Keras' layers.
#[must_use]
pub fn is_state(state: &State) -> bool {
    state.tensors.keys().any(|name| ["recurrent_kernel", "kernel"].contains(&split(name).1))
}

/// Layer and weight of a name such as `lstm/lstm_cell/kernel`; TensorFlow adds `:0`.
fn split(name: &str) -> (&str, &str) {
    let name = name.strip_suffix(":0").unwrap_or(name);
    name.rsplit_once(['/', '.']).unwrap_or(("", name))
}

/// The layer without the name of its cell: `lstm` of `lstm/lstm_cell`.
fn short(layer: &str) -> &str {
    match layer.rsplit_once(['/', '.']) {
        Some((outer, inner)) if inner.ends_with("_cell") || inner == "cell" => outer,
        _ => layer,
    }
}

fn groups(state: &State) -> Result<BTreeMap<&str, Group<'_>>, ImportError> {
    let mut groups: BTreeMap<&str, Group<'_>> = BTreeMap::new();
    for tensor in state.tensors.values() {
        let (layer, weight) = split(&tensor.name);
        let name = &tensor.name;
        let refuse = |what: &str, remedy: &str| Err(ImportError::refuse(format!("`{name}`, {what},"), remedy));
        if ["bidirectional", "backward_"].iter().any(|word| layer.contains(word)) {
            return refuse("part of a bidirectional layer", "a controller does not know the future; train without Bidirectional");
        }
        let group = groups.entry(short(layer)).or_default();
        let slot = match weight {
            "kernel" => &mut group.kernel,
            "recurrent_kernel" => &mut group.recurrent,
            "bias" => &mut group.bias,
            "gamma" | "beta" | "moving_mean" | "moving_variance" => {
                return refuse("part of a normalisation layer", "train without it, and normalise with --input-offset and --input-scale");
            }
            "mean" | "variance" | "count" => {
                return refuse("part of a Normalization layer", "take the layer out and give --input-offset and --input-scale");
            }
            _ => return refuse("a tensor that belongs to no LSTM, GRU or dense layer", "leave it out if the network does not use it"),
        };
        *slot = Some(tensor);
    }
    Ok(groups)
}

/// Reads the network of a state, with the order of its layers and the activations of its Dense layers where somebody gave them.
///
/// # Errors
/// What is missing, does not fit, or cannot be represented, by name.
pub fn read(state: &State, options: &Options) -> Result<SourceNetwork, ImportError> {
    let mut notes = Vec::new();
    let mut modules = Vec::new();
    for (name, group) in groups(state)? {
        let stage = match group.recurrent {
            Some(recurrent) => SourceStage::Recurrent(layer(name, &group, recurrent, &mut notes)?),
            None => SourceStage::Dense(dense(name, &group)?, None),
        };
        modules.push((name.to_owned(), vec![stage]));
    }
    let stages = with_activations(ordered(modules, options.layers.as_deref())?, options.dense_activation.as_deref())?;
    let (layers, dense) = joined(stages, &mut notes)?;
    Ok(SourceNetwork { kind: "Keras state", layers, dense, activation: None, last_step_only: None, notes })
}

fn missing(layer: &str, weight: &str) -> ImportError {
    ImportError::tensor(format!("{layer}/{weight}"), "is missing; save the whole state of the network")
}

fn layer(name: &str, group: &Group<'_>, recurrent: &Tensor, notes: &mut Vec<String>) -> Result<SourceLayer, ImportError> {
    let kernel = group.kernel.ok_or_else(|| missing(name, "kernel"))?;
    let (units, columns) = recurrent.matrix()?;
    let cell = recurrent_cell(&recurrent.name, columns, units)?;
    let (inputs, _) = kernel.matrix()?;
    let bias = match (cell, group.bias) {
        (Cell::Gru, Some(bias)) if bias.shape == [2, columns] => {
            let (of_input, of_hidden) = bias.values.split_at(columns);
            joined_biases(cell, units, &our_order(of_input, units), &our_order(of_hidden, units))
        }
        (Cell::Gru, Some(bias)) if bias.shape == [columns] => {
            let what = format!("`{}`, of a GRU with reset_after=False,", bias.name);
            return Err(ImportError::refuse(what, "its reset gate comes before the product; train with reset_after=True, Keras' default"));
        }
        (Cell::Gru, None) => {
            let what = format!("`{name}`, a GRU without biases, which does not tell where its reset gate is,");
            return Err(ImportError::refuse(what, "train with use_bias=True"));
        }
        (_, Some(bias)) => bias.shaped(&[columns])?.to_vec(),
        (_, None) => {
            notes.push(format!("`{name}` has no bias: it is zero"));
            vec![0.0; columns]
        }
    };
    let rows = |values: &[f64], width: usize| {
        let rows = transposed(values, width, columns);
        if cell == Cell::Gru { our_order(&rows, units * width) } else { rows }
    };
    Ok(SourceLayer {
        name: name.to_owned(),
        cell,
        inputs,
        units,
        input_weights: rows(kernel.shaped(&[inputs, columns])?, inputs),
        recurrent_weights: rows(&recurrent.values, units),
        bias,
    })
}

/// Rows of a GRU in the order z, r, h to r, u, n.
pub fn our_order(values: &[f64], width: usize) -> Vec<f64> {
    let gate = |index: usize| &values[index * width..(index + 1) * width];
    [gate(1), gate(0), gate(2)].concat()
}

fn dense(name: &str, group: &Group<'_>) -> Result<SourceLayer, ImportError> {
    let kernel = group.kernel.ok_or_else(|| missing(name, "kernel"))?;
    let (inputs, outputs) = kernel.matrix()?;
    let bias = group.bias.map_or(Ok(Vec::new()), |bias| bias.shaped(&[outputs]).map(<[f64]>::to_vec))?;
    SourceLayer::dense(kernel.name.clone(), [outputs, inputs], transposed(&kernel.values, inputs, outputs), bias)
}
