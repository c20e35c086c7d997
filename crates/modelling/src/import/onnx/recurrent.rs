//! ONNX's LSTM and GRU operators: `W`, `R` and `B` with gate order i, o, f, c or z, r, h, and what of their settings our layers have no
//! place for.

use super::super::ImportError;
use super::super::source::{SourceLayer, joined_biases};
use super::graph::{Tables, attribute, operator, shown};
use super::wire::Node;
use crate::network::{Activation, Cell};

/// Rows in ONNX's gate order to ours: i, o, f, c to i, f, g, o, and z, r, h to r, u, n.
fn our_order(cell: Cell, values: &[f64], width: usize) -> Vec<f64> {
    let gate = |index: usize| &values[index * width..(index + 1) * width];
    match cell {
        Cell::Lstm => [gate(0), gate(2), gate(3), gate(1)].concat(),
        Cell::Gru => [gate(1), gate(0), gate(2)].concat(),
        Cell::Dense(_) => values.to_vec(),
    }
}

/// The activation of the setting `activations`: a GRU has one beside its gates', an LSTM two.
fn activation(node: &Node) -> Result<Activation, ImportError> {
    let texts = attribute(node, "activations").map_or(&[][..], |setting| &setting.texts);
    let names: Vec<String> = texts.iter().map(|text| String::from_utf8_lossy(text).to_lowercase()).collect();
    let known = match names.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [] | ["sigmoid", "tanh", "tanh"] | ["sigmoid", "tanh"] => Some(Activation::Tanh),
        ["sigmoid", "relu", "relu"] | ["sigmoid", "relu"] => Some(Activation::Relu),
        _ => None,
    };
    known.ok_or_else(|| {
        ImportError::refuse(
            format!("{} with the activations {}", shown(node), names.join(", ")),
            "sigmoid gates, and tanh or relu for candidate and output, are possible",
        )
    })
}

/// Reads a layer and its activation; `notes` gets what a reader should know.
///
/// # Errors
/// What cannot be represented, by name.
pub fn read(node: &Node, tables: &Tables<'_>, notes: &mut Vec<String>) -> Result<(SourceLayer, Activation), ImportError> {
    let name = shown(node);
    let cell = if operator(node) == "GRU" { Cell::Gru } else { Cell::Lstm };
    let refuse = |what: &str, remedy: &str| Err(ImportError::refuse(format!("{name} with {what}"), remedy));
    let direction = attribute(node, "direction").and_then(|setting| setting.text.as_deref()).unwrap_or(b"forward");
    if direction != b"forward" {
        let what = format!("direction {}", String::from_utf8_lossy(direction));
        return refuse(&what, "a controller does not know the future; train a forward one");
    }
    if attribute(node, "clip").is_some() {
        return refuse("a clip of its activations' inputs", "train without clip");
    }
    if attribute(node, "input_forget").and_then(|setting| setting.integer).unwrap_or(0) != 0 {
        return refuse("coupled input and forget gates (input_forget)", "train with both gates");
    }
    if cell == Cell::Gru && attribute(node, "linear_before_reset").and_then(|setting| setting.integer).unwrap_or(0) == 0 {
        let remedy = "its reset gate comes before the product; train the form of PyTorch, or of Keras with reset_after=True";
        return refuse("linear_before_reset=0", remedy);
    }
    let given = |index: usize| node.inputs.get(index).map(String::as_str).filter(|input| !input.is_empty());
    if cell == Cell::Lstm && given(7).is_some_and(|peepholes| !tables.is_zero(peepholes)) {
        return refuse("peepholes", "train an LSTM without them");
    }
    if given(4).is_some() {
        return refuse("lengths of sequences", "export without them: the model runs sample by sample");
    }
    for (index, what) in [(5, "hidden"), (6, "cell")] {
        let Some(state) = given(index) else { continue };
        if tables.is_input(state) {
            notes.push(format!("{name}: the initial {what} state `{state}` is fed in: taken as zero at the start and carried from there"));
        } else if !tables.is_zero(state) {
            return refuse(&format!("an initial {what} state that is not zero"), "the model starts from zero; train it so");
        }
    }
    let activation = activation(node)?;
    let tensor = |index: usize, what: &str| match given(index) {
        Some(value) => tables.constant(value),
        None => Err(ImportError::tensor(format!("{what} of {name}"), "is missing; export the network again")),
    };
    let (from_input, from_hidden) = (tensor(1, "W")?, tensor(2, "R")?);
    let (rows, inputs) = match from_input.shape[..] {
        [1, rows, inputs] if rows > 0 && rows % cell.input_rows() == 0 && inputs > 0 => (rows, inputs),
        _ => {
            let (shape, gates) = (&from_input.shape, cell.input_rows());
            let problem = format!("the shape {shape:?} is not 1 x {gates} units x inputs; export the network again");
            return Err(ImportError::tensor(from_input.name, problem));
        }
    };
    let units = rows / cell.input_rows();
    if let Some(size) = attribute(node, "hidden_size").and_then(|setting| setting.integer)
        && usize::try_from(size) != Ok(units)
    {
        return Err(ImportError::tensor(
            from_input.name,
            format!("it has {units} units, hidden_size says {size}; export the network again"),
        ));
    }
    let input_weights = our_order(cell, &from_input.values, units * inputs);
    let recurrent_weights = our_order(cell, from_hidden.shaped(&[1, rows, units])?, units * units);
    let bias = match given(3) {
        Some(value) => {
            let both = tables.constant(value)?;
            let (first, second) = both.shaped(&[1, 2 * rows])?.split_at(rows);
            joined_biases(cell, units, &our_order(cell, first, units), &our_order(cell, second, units))
        }
        None => {
            notes.push(format!("{name} has no biases: they are zero"));
            vec![0.0; cell.gates().len() * units]
        }
    };
    let name = name.trim_matches('`').to_owned();
    Ok((SourceLayer { name, cell, inputs, units, input_weights, recurrent_weights, bias }, activation))
}
