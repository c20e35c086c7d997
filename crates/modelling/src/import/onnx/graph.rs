//! Looking things up in an ONNX graph: who makes a value, what a constant holds.

use std::collections::BTreeMap;

use super::super::ImportError;
use super::super::tensors::{Tensor, half};
use super::wire::{Attribute, Constant, Graph, Node};

/// Numbers of the types in `onnx.proto`.
const FLOAT: i32 = 1;
const INT64: i32 = 7;
const FLOAT16: i32 = 10;
const DOUBLE: i32 = 11;

/// A chain of shape operations longer than this is no sensible zero.
const DEEPEST: usize = 32;

/// A graph with its tables.
pub struct Tables<'a> {
    producers: BTreeMap<&'a str, (&'a Node, usize)>,
    constants: BTreeMap<&'a str, &'a Constant>,
    inputs: Vec<&'a str>,
}

/// What an operation is called in messages: its name, or what it makes.
#[must_use]
pub fn shown(node: &Node) -> String {
    let name = node.name.as_deref().filter(|name| !name.is_empty()).or(node.outputs.first().map(String::as_str));
    format!("`{}`", name.unwrap_or("without a name"))
}

/// The operator, with its domain when it is not one of ONNX itself.
#[must_use]
pub fn operator(node: &Node) -> String {
    let name = node.operator.as_deref().unwrap_or("");
    match node.domain.as_deref() {
        None | Some("" | "ai.onnx") => name.to_owned(),
        Some(domain) => format!("{domain}.{name}"),
    }
}

/// A setting by name.
#[must_use]
pub fn attribute<'a>(node: &'a Node, name: &str) -> Option<&'a Attribute> {
    node.attributes.iter().find(|attribute| attribute.name.as_deref() == Some(name))
}

impl<'a> Tables<'a> {
    /// The tables of a graph.
    #[must_use]
    pub fn new(graph: &'a Graph) -> Self {
        let mut constants: BTreeMap<&str, &Constant> = BTreeMap::new();
        let mut producers = BTreeMap::new();
        for constant in &graph.initializers {
            constants.insert(constant.name.as_deref().unwrap_or(""), constant);
        }
        for node in &graph.nodes {
            for (index, output) in node.outputs.iter().enumerate().filter(|(_, output)| !output.is_empty()) {
                if operator(node) == "Constant"
                    && let Some(tensor) = attribute(node, "value").and_then(|value| value.tensor.as_ref())
                {
                    constants.insert(output, tensor);
                }
                producers.insert(output.as_str(), (node, index));
            }
        }
        let names = graph.inputs.iter().filter_map(|input| input.name.as_deref());
        let inputs = names.filter(|name| !constants.contains_key(name)).collect();
        Self { producers, constants, inputs }
    }

    /// The operation that makes a value, and which of its outputs it is.
    #[must_use]
    pub fn producer(&self, value: &str) -> Option<(&'a Node, usize)> {
        self.producers.get(value).copied()
    }

    /// Whether a value is fed in.
    #[must_use]
    pub fn is_input(&self, value: &str) -> bool {
        self.inputs.contains(&value)
    }

    /// Whether a value is a constant.
    #[must_use]
    pub fn is_constant(&self, value: &str) -> bool {
        self.constants.contains_key(value)
    }

    /// The numbers of a constant.
    ///
    /// # Errors
    /// When the value is computed, lies in another file, or is damaged.
    pub fn constant(&self, value: &str) -> Result<Tensor, ImportError> {
        match self.constants.get(value) {
            Some(constant) => tensor(value, constant),
            None => Err(ImportError::tensor(value, "is computed in the graph where a constant is wanted; export with constant folding")),
        }
    }

    /// Whether a value is zero whatever its shape: a constant zero, or one that shape operations stretch.
    #[must_use]
    pub fn is_zero(&self, value: &str) -> bool {
        let mut value = value;
        for _ in 0..DEEPEST {
            if self.is_constant(value) {
                return self.constant(value).is_ok_and(|tensor| tensor.values.iter().all(|number| *number == 0.0));
            }
            let Some((node, _)) = self.producer(value) else { return false };
            match operator(node).as_str() {
                "ConstantOfShape" => {
                    let filled = attribute(node, "value").and_then(|value| value.tensor.as_ref());
                    return filled
                        .is_none_or(|filled| tensor(value, filled).is_ok_and(|one| one.values.iter().all(|number| *number == 0.0)));
                }
                "Expand" | "Reshape" | "Unsqueeze" | "Squeeze" | "Identity" | "Transpose" | "Slice" | "Gather" | "Tile" | "Cast" => {
                    value = node.inputs.first().map_or("", String::as_str);
                }
                _ => return false,
            }
        }
        false
    }
}

fn tensor(name: &str, constant: &Constant) -> Result<Tensor, ImportError> {
    if constant.location == Some(1) || !constant.external.is_empty() {
        return Err(ImportError::tensor(name, "its values lie in another file; export with external_data=False, into one file"));
    }
    let shape = constant.dimensions.iter().map(|side| usize::try_from(*side)).collect::<Result<Vec<_>, _>>();
    let shape = shape.map_err(|_| ImportError::tensor(name, format!("the shape {:?} is negative", constant.dimensions)))?;
    let raw = constant.raw.as_deref().filter(|raw| !raw.is_empty());
    let values: Vec<f64> = match (constant.data_type, raw) {
        (Some(FLOAT), None) => constant.floats.iter().map(|value| f64::from(*value)).collect(),
        (Some(FLOAT), Some(raw)) => raw.as_chunks::<4>().0.iter().map(|word| f64::from(f32::from_le_bytes(*word))).collect(),
        (Some(DOUBLE), None) => constant.doubles.clone(),
        (Some(DOUBLE), Some(raw)) => raw.as_chunks::<8>().0.iter().map(|word| f64::from_le_bytes(*word)).collect(),
        (Some(FLOAT16), Some(raw)) => raw.as_chunks::<2>().0.iter().map(|word| half(u16::from_le_bytes(*word))).collect(),
        #[expect(clippy::cast_precision_loss, reason = "indices and shapes are small")]
        (Some(INT64), None) => constant.integers.iter().map(|value| *value as f64).collect(),
        #[expect(clippy::cast_precision_loss, reason = "indices and shapes are small")]
        (Some(INT64), Some(raw)) => raw.as_chunks::<8>().0.iter().map(|word| i64::from_le_bytes(*word) as f64).collect(),
        (data_type, _) => {
            let number = data_type.unwrap_or(0);
            return Err(ImportError::tensor(
                name,
                format!("its values have ONNX type {number}; export the network in float32, not quantised"),
            ));
        }
    };
    Tensor::new(name, shape, values)
}
