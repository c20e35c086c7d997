//! Keras: the weights of LSTM and Dense layers, under any prefix.
//!
//! `kernel` is `inputs x 4 units`, `recurrent_kernel` `units x 4 units`: columns, not rows, in gate order i, f, c, o, which is ours with
//! c for g. There is one `bias` of `4 units`. A GRU has three columns a unit.

use std::collections::BTreeMap;

use super::source::{SourceDense, SourceLayer, SourceNetwork, expect_lstm, ordered, without_dense};
use super::tensors::{State, Tensor, transposed};
use super::{ImportError, dense};

#[derive(Default)]
struct Group<'a> {
    kernel: Option<&'a Tensor>,
    recurrent: Option<&'a Tensor>,
    bias: Option<&'a Tensor>,
}

/// Whether these are names of Keras' recurrent layers.
#[must_use]
pub fn is_state(state: &State) -> bool {
    state.tensors.keys().any(|name| split(name).1 == "recurrent_kernel")
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
            _ => return refuse("a tensor that belongs to no LSTM and no dense layer", "leave it out if the network does not use it"),
        };
        *slot = Some(tensor);
    }
    Ok(groups)
}

/// Reads the network of a state; `named` is the order of its LSTM layers where somebody gave it.
///
/// # Errors
/// What is missing, does not fit, or cannot be represented, by name.
pub fn read(state: &State, named: Option<&[String]>) -> Result<SourceNetwork, ImportError> {
    let mut notes = Vec::new();
    let mut modules = Vec::new();
    let mut heads: Vec<(&str, Group<'_>)> = Vec::new();
    for (name, group) in groups(state)? {
        match group.recurrent {
            Some(recurrent) => modules.push((name.to_owned(), vec![layer(name, &group, recurrent, &mut notes)?])),
            None => heads.push((name, group)),
        }
    }
    let dense = match &heads[..] {
        [] => None,
        [(name, group)] => Some(head(name, group)?),
        [(first, _), (second, _), ..] => return Err(dense::two_dense(first, second)),
    };
    let layers = ordered(modules, named, dense.as_ref().map(|dense| dense.weights.len()))?;
    let dense = match dense {
        Some(dense) => dense,
        None => {
            let (dense, note) = without_dense(&layers)?;
            notes.push(note);
            dense
        }
    };
    Ok(SourceNetwork { kind: "Keras state", layers, dense, activation: None, last_step_only: None, notes })
}

fn missing(layer: &str, weight: &str) -> ImportError {
    ImportError::tensor(format!("{layer}/{weight}"), "is missing; save the whole state of the network")
}

fn layer(name: &str, group: &Group<'_>, recurrent: &Tensor, notes: &mut Vec<String>) -> Result<SourceLayer, ImportError> {
    let kernel = group.kernel.ok_or_else(|| missing(name, "kernel"))?;
    let (units, columns) = recurrent.matrix()?;
    expect_lstm(&recurrent.name, columns, units)?;
    let (inputs, _) = kernel.matrix()?;
    let bias = match group.bias {
        Some(bias) => bias.shaped(&[columns])?.to_vec(),
        None => {
            notes.push(format!("`{name}` has no bias: it is zero"));
            vec![0.0; columns]
        }
    };
    Ok(SourceLayer {
        name: name.to_owned(),
        inputs,
        units,
        input_weights: transposed(kernel.shaped(&[inputs, columns])?, inputs, columns),
        recurrent_weights: transposed(&recurrent.values, units, columns),
        bias,
    })
}

fn head(name: &str, group: &Group<'_>) -> Result<SourceDense, ImportError> {
    let kernel = group.kernel.ok_or_else(|| missing(name, "kernel"))?;
    let (inputs, outputs) = kernel.matrix()?;
    dense::one_output(&kernel.name, outputs)?;
    let bias = group.bias.map_or(Ok(0.0), |bias| bias.shaped(&[1]).map(|values| values[0]))?;
    Ok(SourceDense { name: kernel.name.clone(), weights: kernel.shaped(&[inputs, 1])?.to_vec(), bias })
}
