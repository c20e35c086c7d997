//! ONNX: from the graph's output back to its input, through dense layers, LSTM and GRU nodes.
//!
//! Only operations that change the shape, and never the order of the features, may lie between them. Everything else is refused by the
//! operator's name. The messages are decoded by `prost`, which bounds recursion and memory.

mod graph;
mod recurrent;
mod wire;

#[cfg(test)]
mod tests;

use prost::Message;
use std::collections::BTreeMap;

use super::ImportError;
use super::source::{CELLS, DenseActivation, SourceLayer, SourceNetwork, SourceStage, joined};
use super::tensors::transposed;
use crate::network::Activation;
use graph::{Tables, attribute, operator, shown};
use wire::{Model, Node};

/// What the way back has met so far; layers last first.
#[derive(Default)]
struct Walk {
    stages: Vec<SourceStage>,
    /// Of the recurrent layers.
    activations: Vec<Activation>,
    /// What follows the dense layer that must come next.
    activation: Option<(String, DenseActivation)>,
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

/// Whether an output is the final state of a recurrent layer, which streaming networks return beside their output.
fn is_state(tables: &Tables<'_>, value: &str) -> bool {
    let mut value = value;
    for _ in 0..4 {
        let Some((node, index)) = tables.producer(value) else { return false };
        match operator(node).as_str() {
            "LSTM" | "GRU" => return index > 0,
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
        if let Some((name, _)) = &self.activation
            && self.bias.is_none()
            && ["LSTM", "GRU"].contains(&kind.as_str())
        {
            let what = format!("{name}, an activation behind a recurrent layer,");
            return Err(ImportError::refuse(what, "only a dense layer has one of its own; train without it"));
        }
        if self.bias.is_some() && kind != "MatMul" {
            return Err(ImportError::refuse(
                format!("{}, a {kind} before an addition,", shown(node)),
                "only a dense layer may be followed by one",
            ));
        }
        match kind.as_str() {
            // Flatten could join time and features, but then the dense layer would be wider than what it takes.
            "Identity" | "Dropout" | "Squeeze" | "Unsqueeze" | "Cast" | "Flatten" => Ok(first),
            "Transpose" => self.transpose(node).map(|()| first),
            "Reshape" => self.reshape(tables, node).map(|()| first),
            "Gather" | "Slice" => self.last(tables, node).map(|()| first),
            "LSTM" | "GRU" => {
                match output {
                    0 => {}
                    1 if self.activations.is_empty() => self.last_step = true,
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
                let (layer, activation) = recurrent::read(node, tables, &mut self.notes)?;
                self.stages.push(SourceStage::Recurrent(layer));
                self.activations.push(activation);
                Ok(first)
            }
            "Gemm" => self.gemm(tables, node).map(|()| first),
            "MatMul" => self.product(tables, node),
            "Add" => self.addition(tables, node),
            "RNN" => Err(ImportError::refuse(format!("{}, a plain recurrent layer,", shown(node)), CELLS)),
            "Tanh" | "Relu" | "Sigmoid" | "Clip" => self.behind_dense(tables, node).map(|()| first),
            "LeakyRelu" | "Elu" | "Softplus" | "HardSigmoid" => Err(ImportError::refuse(
                format!("{}, the activation {kind},", shown(node)),
                "dense layers know tanh, relu, sigmoid and a clip to -1 to 1; train with one of these",
            )),
            "Sub" | "Mul" | "Div" => Err(ImportError::refuse(
                format!("{}, a {kind} in the path of the signal,", shown(node)),
                "take normalisation out of the graph and give it as --input-offset, --input-scale, --output-offset and --output-scale",
            )),
            _ => Err(ImportError::refuse(format!("{}, the operator {kind},", shown(node)), "the model is LSTM, GRU and dense layers")),
        }
    }

    /// An activation, whose dense layer comes next on the way back.
    fn behind_dense(&mut self, tables: &Tables<'_>, node: &Node) -> Result<(), ImportError> {
        let activation = match operator(node).as_str() {
            "Tanh" => DenseActivation::Ours(Activation::Tanh),
            "Relu" => DenseActivation::Ours(Activation::Relu),
            "Sigmoid" => DenseActivation::Sigmoid,
            _ => {
                let end = |index: usize| node.inputs.get(index).and_then(|value| tables.constant(value).ok()).map(|ends| ends.values);
                if end(1).as_deref() != Some(&[-1.0]) || end(2).as_deref() != Some(&[1.0]) {
                    let what = format!("{}, a Clip to something else than -1 to 1,", shown(node));
                    return Err(ImportError::refuse(what, "train with tanh, relu or a hard tanh from -1 to 1"));
                }
                DenseActivation::Ours(Activation::Hard)
            }
        };
        if self.activation.is_some() {
            let what = format!("{}, one of two activations behind each other,", shown(node));
            return Err(ImportError::refuse(what, "a dense layer has one; train without the other"));
        }
        self.activation = Some((shown(node), activation));
        Ok(())
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
        self.stages.is_empty()
    }

    /// A new shape must keep the features together: its last side is as wide as what is fed.
    fn reshape(&self, tables: &Tables<'_>, node: &Node) -> Result<(), ImportError> {
        if self.is_scalar_path() {
            return Ok(());
        }
        let width = self.stages.last().map_or(0, |stage| stage.layer().inputs);
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

    /// Taking the last step of a sequence, between the last recurrent layer and the output.
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
        if self.activations.is_empty() && number(1) == Some(-1.0) && [0.0, 1.0, -2.0, -3.0].contains(&axis) {
            self.last_step = true;
            return Ok(());
        }
        Err(ImportError::refuse(
            format!("{}, a {} of something else than the last step after the last recurrent layer,", shown(node), operator(node)),
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
        self.dense(node, outputs, values, bias)
    }

    fn product<'a>(&mut self, tables: &Tables<'a>, node: &'a Node) -> Result<&'a str, ImportError> {
        let [data, weights] = &node.inputs[..] else {
            return Err(ImportError::tensor(shown(node), "a MatMul has two inputs; export the network again"));
        };
        let weights = tables.constant(weights)?;
        let (rows, outputs) = weights.matrix()?;
        let bias = self.bias.take().map_or_else(Vec::new, |(_, bias)| bias);
        self.dense(node, outputs, transposed(&weights.values, rows, outputs), bias)?;
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

    fn dense(&mut self, node: &Node, outputs: usize, weights: Vec<f64>, bias: Vec<f64>) -> Result<(), ImportError> {
        let name = shown(node).trim_matches('`').to_owned();
        let inputs = weights.len() / outputs.max(1);
        let activation = self.activation.take().map_or(DenseActivation::Linear, |(_, activation)| activation);
        self.stages.push(SourceStage::Dense(SourceLayer::dense(name, [outputs, inputs], weights, bias)?, Some(activation)));
        Ok(())
    }

    fn finish(mut self) -> Result<SourceNetwork, ImportError> {
        if let Some((name, _)) = self.bias {
            return Err(ImportError::refuse(format!("{name}, an addition to the input,"), "give it as --input-offset"));
        }
        if let Some((name, _)) = self.activation {
            return Err(ImportError::refuse(format!("{name}, an activation of the input,"), "train without it"));
        }
        if self.stages.is_empty() {
            return Err(ImportError::refuse("a graph without a layer", "export the trained network itself"));
        }
        let activation = self.activations.first().copied();
        if self.activations.iter().any(|other| Some(*other) != activation) {
            return Err(ImportError::refuse("a network whose recurrent layers have different activations", "train all of them with one"));
        }
        self.stages.reverse();
        let (layers, dense) = joined(self.stages, &mut self.notes)?;
        Ok(SourceNetwork { kind: "ONNX graph", layers, dense, activation, last_step_only: Some(self.last_step), notes: self.notes })
    }
}
