//! ONNX: from the graph's output back to its input, through a dense output and LSTM nodes.
//!
//! Only operations that change the shape, and never the order of the features, may lie between them. Everything else is refused by the
//! operator's name. The messages are decoded by `prost`, which bounds recursion and memory.

mod graph;
mod lstm;
mod wire;

#[cfg(test)]
mod tests;

use prost::Message;
use std::collections::BTreeMap;

use super::source::{LSTM_ONLY, SourceDense, SourceLayer, SourceNetwork, without_dense};
use super::tensors::transposed;
use super::{ImportError, dense};
use crate::network::Activation;
use graph::{Tables, attribute, operator, shown};
use wire::{Model, Node};

/// What the way back has met so far; layers last first.
#[derive(Default)]
struct Walk {
    layers: Vec<(SourceLayer, Activation)>,
    dense: Option<SourceDense>,
    /// The addition of a bias, before the product below it is met.
    bias: Option<(String, Vec<f64>)>,
    last_step: bool,
    notes: Vec<String>,
}

/// The network of a file, and the metadata in it.
///
/// # Errors
/// What is damaged, missing or cannot be represented, by name.
pub fn read(bytes: &[u8]) -> Result<(SourceNetwork, BTreeMap<String, String>), ImportError> {
    let damaged = |message: String| ImportError::Format { message };
    let model = Model::decode(bytes)
        .map_err(|error| damaged(format!("neither a safetensors nor an ONNX file ({error}); was it cut off? Export the network again")))?;
    let graph = model.graph.as_ref().filter(|graph| !graph.nodes.is_empty());
    let graph = graph.ok_or_else(|| {
        damaged("neither a safetensors nor an ONNX file with operations in its graph; export the network again".to_owned())
    })?;
    let metadata = model.metadata.iter().map(|entry| (entry.key.clone().unwrap_or_default(), entry.value.clone().unwrap_or_default()));
    let mut metadata: BTreeMap<String, String> = metadata.collect();
    if let Some(producer) = model.producer_name.as_deref().filter(|name| !name.is_empty()) {
        metadata.entry("catheter.framework".to_owned()).or_insert_with(|| format!("ONNX of {producer}"));
    }
    let tables = Tables::new(graph);
    let names: Vec<&str> = graph.outputs.iter().map(|output| output.name.as_deref().unwrap_or("")).collect();
    let mut walk = Walk::default();
    let mut value = names.first().copied().unwrap_or("");
    // A cycle would go on for ever; no way is longer than the graph has operations.
    for _ in 0..=graph.nodes.len() {
        if tables.is_input(value) {
            one_output(&tables, &names)?;
            return walk.finish().map(|network| (network, metadata));
        }
        let Some((node, index)) = tables.producer(value) else {
            return Err(damaged(format!("the value `{value}` is made by no operation of the graph; export the network again")));
        };
        value = walk.back(&tables, node, index)?;
    }
    Err(damaged("the graph runs in a circle; export the network again".to_owned()))
}

/// Refuses outputs beside the first, other than final states.
fn one_output(tables: &Tables<'_>, names: &[&str]) -> Result<(), ImportError> {
    match names.iter().skip(1).find(|name| !is_state(tables, name)) {
        Some(other) => {
            let what = format!("the output `{other}` beside `{}`", names[0]);
            Err(ImportError::refuse(what, "the model has one output; export only that"))
        }
        None => Ok(()),
    }
}

/// Whether an output is the final state of an LSTM, which streaming networks return beside their output.
fn is_state(tables: &Tables<'_>, value: &str) -> bool {
    let mut value = value;
    for _ in 0..4 {
        let Some((node, index)) = tables.producer(value) else { return false };
        match operator(node).as_str() {
            "LSTM" => return index > 0,
            "Squeeze" | "Unsqueeze" | "Transpose" | "Reshape" | "Identity" | "Concat" => {
                value = node.inputs.first().map_or("", String::as_str);
            }
            _ => return false,
        }
    }
    false
}

impl Walk {
    /// One operation back: gives the value that the signal comes from.
    fn back<'a>(&mut self, tables: &Tables<'a>, node: &'a Node, output: usize) -> Result<&'a str, ImportError> {
        let first = node.inputs.first().map_or("", String::as_str);
        let kind = operator(node);
        if self.bias.is_some() && kind != "MatMul" {
            return Err(ImportError::refuse(
                format!("{}, a {kind} before an addition,", shown(node)),
                "only a dense layer may be followed by one",
            ));
        }
        match kind.as_str() {
            // Flatten could join time and features, but then the dense layer would be wider than the LSTM.
            "Identity" | "Dropout" | "Squeeze" | "Unsqueeze" | "Cast" | "Flatten" => Ok(first),
            "Transpose" => self.transpose(node).map(|()| first),
            "Reshape" => self.reshape(tables, node).map(|()| first),
            "Gather" | "Slice" => self.last(tables, node).map(|()| first),
            "LSTM" => {
                match output {
                    0 => {}
                    1 if self.layers.is_empty() => self.last_step = true,
                    1 => {
                        let what = format!("{}, whose last step alone feeds the next layer,", shown(node));
                        return Err(ImportError::refuse(what, "the next layer must take every step"));
                    }
                    _ => {
                        return Err(ImportError::refuse(
                            format!("the cell state of {} as an output", shown(node)),
                            "take its output instead",
                        ));
                    }
                }
                self.layers.push(lstm::read(node, tables, &mut self.notes)?);
                Ok(first)
            }
            "Gemm" => self.gemm(tables, node).map(|()| first),
            "MatMul" => self.product(tables, node),
            "Add" => self.addition(tables, node),
            "GRU" => Err(ImportError::refuse(format!("{}, a GRU,", shown(node)), LSTM_ONLY)),
            "RNN" => Err(ImportError::refuse(format!("{}, a plain recurrent layer,", shown(node)), LSTM_ONLY)),
            "Tanh" | "Relu" | "Sigmoid" | "LeakyRelu" | "Elu" | "Softplus" | "HardSigmoid" => Err(ImportError::refuse(
                format!("{}, the activation {kind} outside of an LSTM,", shown(node)),
                "the model is LSTM layers and one linear output; train without it",
            )),
            "Sub" | "Mul" | "Div" => Err(ImportError::refuse(
                format!("{}, a {kind} in the path of the signal,", shown(node)),
                "take normalisation out of the graph and give it as --input-offset, --input-scale, --output-offset and --output-scale",
            )),
            _ => {
                Err(ImportError::refuse(format!("{}, the operator {kind},", shown(node)), "the model is LSTM layers and one linear output"))
            }
        }
    }

    /// Axes may change places as long as the last one, the features, stays.
    fn transpose(&self, node: &Node) -> Result<(), ImportError> {
        let order = attribute(node, "perm").map_or(&[][..], |setting| &setting.integers);
        let keeps = order.last().is_some_and(|last| usize::try_from(*last).ok() == order.len().checked_sub(1));
        if keeps || self.is_scalar_path() {
            return Ok(());
        }
        Err(ImportError::refuse(
            format!("{}, a Transpose that moves the features,", shown(node)),
            "export with the features as the last axis",
        ))
    }

    /// Whether nothing but the one output has been met: its shape does not matter.
    fn is_scalar_path(&self) -> bool {
        self.layers.is_empty() && self.dense.is_none()
    }

    /// A new shape must keep the features together: its last side is as wide as what is fed.
    fn reshape(&self, tables: &Tables<'_>, node: &Node) -> Result<(), ImportError> {
        if self.is_scalar_path() {
            return Ok(());
        }
        let width =
            self.layers.last().map_or_else(|| self.dense.as_ref().map_or(0, |dense| dense.weights.len()), |(layer, _)| layer.inputs);
        let shape = node.inputs.get(1).map(|shape| tables.constant(shape));
        if let Some(Ok(shape)) = shape
            && let Some(last) = shape.values.last()
            && [-1.0, 0.0, width as f64].contains(last)
        {
            return Ok(());
        }
        Err(ImportError::refuse(
            format!("{}, a Reshape to a shape that does not end in {width} features,", shown(node)),
            "export with the features as the last axis and a fixed batch size of 1",
        ))
    }

    /// Taking the last step of a sequence, between the last LSTM and the output.
    fn last(&mut self, tables: &Tables<'_>, node: &Node) -> Result<(), ImportError> {
        let number = |index: usize| {
            let values = node.inputs.get(index).map(|value| tables.constant(value));
            values.and_then(Result::ok).and_then(|tensor| (tensor.values.len() == 1).then(|| tensor.values[0]))
        };
        // Output of [batch, time, units] or [time, batch, units]: never the last axis.
        let axis = match operator(node).as_str() {
            "Gather" => attribute(node, "axis").and_then(|setting| setting.integer).unwrap_or(0) as f64,
            _ => number(3).unwrap_or(-1.0),
        };
        if self.layers.is_empty() && number(1) == Some(-1.0) && [0.0, 1.0, -2.0, -3.0].contains(&axis) {
            self.last_step = true;
            return Ok(());
        }
        Err(ImportError::refuse(
            format!("{}, a {} of something else than the last step after the last LSTM,", shown(node), operator(node)),
            "the model gives every step or the last one",
        ))
    }

    fn gemm(&mut self, tables: &Tables<'_>, node: &Node) -> Result<(), ImportError> {
        let factor = |name: &str| attribute(node, name).and_then(|setting| setting.float).unwrap_or(1.0);
        let flag = |name: &str| attribute(node, name).and_then(|setting| setting.integer).unwrap_or(0) != 0;
        if factor("alpha") != 1.0 || factor("beta") != 1.0 || flag("transA") {
            return Err(ImportError::refuse(format!("{}, a Gemm with alpha, beta or transA,", shown(node)), "export a plain dense layer"));
        }
        let input = |index: usize| node.inputs.get(index).map_or("", String::as_str);
        let weights = tables.constant(input(1))?;
        let (rows, columns) = weights.matrix()?;
        let (outputs, values) = if flag("transB") { (rows, weights.values) } else { (columns, transposed(&weights.values, rows, columns)) };
        let bias = match input(2) {
            "" => Vec::new(),
            name => tables.constant(name)?.values,
        };
        self.head(node, outputs, values, bias)
    }

    fn product<'a>(&mut self, tables: &Tables<'a>, node: &'a Node) -> Result<&'a str, ImportError> {
        let [data, weights] = &node.inputs[..] else {
            return Err(ImportError::tensor(shown(node), "a MatMul has two inputs; export the network again"));
        };
        let weights = tables.constant(weights)?;
        let (rows, outputs) = weights.matrix()?;
        let bias = self.bias.take().map_or_else(Vec::new, |(_, bias)| bias);
        self.head(node, outputs, transposed(&weights.values, rows, outputs), bias)?;
        Ok(data)
    }

    fn addition<'a>(&mut self, tables: &Tables<'a>, node: &'a Node) -> Result<&'a str, ImportError> {
        let (data, constant) = match &node.inputs[..] {
            [data, constant] if tables.is_constant(constant) => (data, constant),
            [constant, data] if tables.is_constant(constant) => (data, constant),
            _ => {
                let what = format!("{}, an addition of two signals,", shown(node));
                return Err(ImportError::refuse(what, "train without the shortcut between layers"));
            }
        };
        self.bias = Some((shown(node), tables.constant(constant)?.values));
        Ok(data)
    }

    fn head(&mut self, node: &Node, outputs: usize, weights: Vec<f64>, bias: Vec<f64>) -> Result<(), ImportError> {
        let name = shown(node).trim_matches('`').to_owned();
        if !self.layers.is_empty() {
            let what = format!("{}, a dense layer before the LSTM,", shown(node));
            return Err(ImportError::refuse(what, "the LSTM must take the input itself; train without it"));
        }
        if let Some(last) = &self.dense {
            return Err(dense::two_dense(&name, &last.name));
        }
        dense::one_output(&name, outputs)?;
        let bias = match bias[..] {
            [] => 0.0,
            [bias] => bias,
            _ => return Err(ImportError::tensor(name, format!("its bias has {} values, one output has one; export it again", bias.len()))),
        };
        self.dense = Some(SourceDense { name, weights, bias });
        Ok(())
    }

    fn finish(mut self) -> Result<SourceNetwork, ImportError> {
        if let Some((name, _)) = self.bias {
            return Err(ImportError::refuse(format!("{name}, an addition to the input,"), "give it as --input-offset"));
        }
        self.layers.reverse();
        let activation = self.layers.first().map(|(_, activation)| *activation);
        if self.layers.iter().any(|(_, other)| Some(*other) != activation) {
            return Err(ImportError::refuse("a network whose layers have different activations", "train all layers with one"));
        }
        let layers: Vec<SourceLayer> = self.layers.into_iter().map(|(layer, _)| layer).collect();
        let dense = match self.dense {
            Some(dense) if layers.is_empty() => return Err(dense::no_memory(&[&dense.name])),
            Some(dense) => dense,
            None if layers.is_empty() => return Err(ImportError::refuse("a graph without an LSTM", "export the trained network itself")),
            None => {
                let (dense, note) = without_dense(&layers)?;
                self.notes.push(note);
                dense
            }
        };
        Ok(SourceNetwork { kind: "ONNX graph", layers, dense, activation, last_step_only: Some(self.last_step), notes: self.notes })
    }
}
