//! A network as it was found in a foreign file, in our gate order, before anybody said what its channels are.

use model_export::schema::{Activation, Cell, MAX_LAYERS, MAX_UNITS};

use super::ImportError;

/// What every refusal of another recurrent layer says.
pub const CELLS: &str = "the firmware runs LSTM, GRU and dense layers; train one of these instead";

/// One layer; matrices row-major, rows in the order of [`Cell::gates`].
#[derive(Clone, Debug, PartialEq)]
pub struct SourceLayer {
    /// Its name in the file.
    pub name: String,
    /// What it computes.
    pub cell: Cell,
    /// Width of the input.
    pub inputs: usize,
    /// Units, or outputs of a dense layer.
    pub units: usize,
    /// Rows of `inputs`.
    pub input_weights: Vec<f64>,
    /// Rows of `units`.
    pub recurrent_weights: Vec<f64>,
    /// One a gate and unit.
    pub bias: Vec<f64>,
}

/// The dense output.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceDense {
    /// Its name in the file.
    pub name: String,
    /// One per unit of the last layer.
    pub weights: Vec<f64>,
    /// Constant.
    pub bias: f64,
}

/// Layers and output.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceNetwork {
    /// `PyTorch state`, `Keras state` or `ONNX graph`.
    pub kind: &'static str,
    /// First layer first.
    pub layers: Vec<SourceLayer>,
    /// The output.
    pub dense: SourceDense,
    /// The activation of the recurrent layers where the file tells it.
    pub activation: Option<Activation>,
    /// Whether the network gives only the last step of a sequence; none when the file does not tell.
    pub last_step_only: Option<bool>,
    /// What a reader should know of how the file was understood.
    pub notes: Vec<String>,
}

/// What a dense layer of a framework does with its sums. Two of these are no layers of ours: they go into the weights of the next one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DenseActivation {
    /// As one of ours.
    Ours(Activation),
    /// Nothing.
    Linear,
    /// `1 / (1 + e^-x) = (1 + tanh(x/2)) / 2`.
    Sigmoid,
}

/// A layer of a framework.
#[derive(Clone, Debug, PartialEq)]
pub enum SourceStage {
    /// LSTM or GRU.
    Recurrent(SourceLayer),
    /// `activation(W x + b)`; nothing is known of the activation where a file does not tell it.
    Dense(SourceLayer, Option<DenseActivation>),
}

impl SourceStage {
    /// The layer.
    #[must_use]
    pub fn layer(&self) -> &SourceLayer {
        match self {
            Self::Recurrent(layer) | Self::Dense(layer, _) => layer,
        }
    }
}

impl SourceLayer {
    /// A dense layer with rows of weights, and biases or none.
    ///
    /// # Errors
    /// When the biases are not as many as the outputs.
    pub fn dense(name: String, [outputs, inputs]: [usize; 2], weights: Vec<f64>, bias: Vec<f64>) -> Result<Self, ImportError> {
        let bias = if bias.is_empty() { vec![0.0; outputs] } else { bias };
        if bias.len() != outputs {
            let problem = format!("its bias has {} values, its {outputs} outputs want as many; export it again", bias.len());
            return Err(ImportError::tensor(name, problem));
        }
        let cell = Cell::Dense(Activation::Tanh);
        Ok(Self { name, cell, inputs, units: outputs, input_weights: weights, recurrent_weights: Vec::new(), bias })
    }

    /// Makes up for an input that is `scale * new + offset`, or, with the layer `before`, that times its weights.
    fn absorb(&mut self, before: &Self, scale: f64, offset: f64, through_weights: bool) {
        let gates = self.cell.gates();
        let old = std::mem::take(&mut self.input_weights);
        let rows: Vec<&[f64]> = old.chunks(self.inputs.max(1)).collect();
        for (number, gate) in gates.iter().enumerate() {
            let Some(of_gate) = gate.input else { continue };
            for unit in 0..self.units {
                let row = rows[of_gate * self.units + unit];
                let added: f64 = if through_weights {
                    row.iter().zip(&before.bias).map(|(weight, bias)| weight * bias).sum()
                } else {
                    offset * row.iter().sum::<f64>()
                };
                self.bias[number * self.units + unit] += added;
            }
        }
        if through_weights {
            let column = |row: &[f64], column: usize| -> f64 {
                row.iter().enumerate().map(|(index, weight)| weight * before.input_weights[index * before.inputs + column]).sum()
            };
            self.input_weights = rows.iter().flat_map(|row| (0..before.inputs).map(|index| column(row, index))).collect();
            self.inputs = before.inputs;
        } else {
            self.input_weights = old.iter().map(|weight| scale * weight).collect();
        }
    }
}

/// The recurrent layer that has this many rows of recurrent weights.
///
/// # Errors
/// For anything but four or three rows a unit.
pub fn recurrent_cell(name: &str, rows: usize, units: usize) -> Result<Cell, ImportError> {
    match rows.checked_div(units) {
        Some(4) if rows == 4 * units => Ok(Cell::Lstm),
        Some(3) if rows == 3 * units => Ok(Cell::Gru),
        Some(1) if rows == units => Err(ImportError::refuse(format!("`{name}`, a plain recurrent layer,"), CELLS)),
        _ => {
            let problem = format!(
                "{rows} rows for {units} units fit no recurrent layer: an LSTM has four rows a unit, a GRU three; save the network again"
            );
            Err(ImportError::tensor(name, problem))
        }
    }
}

/// The biases of a recurrent layer, one a gate and unit, from those of the input and of the hidden state. They are added where they are
/// used, except in a GRU's candidate.
#[must_use]
pub fn joined_biases(cell: Cell, units: usize, of_input: &[f64], of_hidden: &[f64]) -> Vec<f64> {
    let part = |biases: &[f64], gate: Option<usize>, unit: usize| gate.map_or(0.0, |gate| biases[gate * units + unit]);
    let gates = cell.gates().iter();
    let both = |unit: usize, gate: &model_export::schema::Gate| part(of_input, gate.input, unit) + part(of_hidden, gate.recurrent, unit);
    gates.flat_map(|gate| (0..units).map(move |unit| both(unit, gate))).collect()
}

/// Most modules whose order is looked for: beyond it, it must be said.
const MOST_UNORDERED: usize = 6;

/// Modules, each of one or more layers, in the order in which the signal passes them.
///
/// `named` is the order somebody gave, in which the output may be left out; without it, it must follow from the widths, or from the numbers
/// that are the names in a sequence.
///
/// # Errors
/// When the names do not fit, or the widths leave a choice.
pub fn ordered(modules: Vec<(String, Vec<SourceStage>)>, named: Option<&[String]>) -> Result<Vec<SourceStage>, ImportError> {
    let found: Vec<&str> = modules.iter().map(|(name, _)| name.as_str()).collect();
    let order = match named {
        Some(named) => by_names(&modules, named).ok_or_else(|| {
            let problem = format!("`{}` are not the layers of the file, which are `{}`", named.join(","), found.join(","));
            ImportError::Value { name: "--layers".to_owned(), problem }
        })?,
        None => by_widths(&modules)?,
    };
    let mut modules: Vec<Option<Vec<SourceStage>>> = modules.into_iter().map(|(_, stages)| Some(stages)).collect();
    Ok(order.into_iter().filter_map(|index| modules[index].take()).flatten().collect())
}

fn by_names(modules: &[(String, Vec<SourceStage>)], named: &[String]) -> Option<Vec<usize>> {
    let mut order: Vec<usize> = named.iter().map(|name| modules.iter().position(|(other, _)| other == name)).collect::<Option<Vec<_>>>()?;
    let left: Vec<usize> = (0..modules.len()).filter(|index| !order.contains(index)).collect();
    if let [last] = left[..]
        && matches!(modules[last].1[..], [SourceStage::Dense(..)])
    {
        order.push(last);
    }
    (order.len() == modules.len()).then_some(order)
}

fn by_widths(modules: &[(String, Vec<SourceStage>)]) -> Result<Vec<usize>, ImportError> {
    let ends: Vec<(usize, usize)> = modules
        .iter()
        .map(|(_, stages)| (stages.first().map_or(0, |stage| stage.layer().inputs), stages.last().map_or(0, |stage| stage.layer().units)))
        .collect();
    let names = || modules.iter().map(|(name, _)| format!("`{name}`")).collect::<Vec<_>>().join(" and ");
    if modules.len() > MOST_UNORDERED {
        let problem = format!("{} are many; give their order with --layers", names());
        return Err(ImportError::Value { name: "the order of the layers".to_owned(), problem });
    }
    let fits = |order: &[usize]| order.windows(2).all(|pair| ends[pair[0]].1 == ends[pair[1]].0);
    let has_output = |order: &[usize]| order.last().is_some_and(|last| ends[*last].1 == 1);
    let mut found: Vec<Vec<usize>> = permutations(modules.len()).into_iter().filter(|order| fits(order)).collect();
    if ends.iter().any(|(_, units)| *units == 1) {
        found.retain(|order| has_output(order));
    }
    match &found[..] {
        // What does not fit is named when the layers are joined.
        [] if modules.len() < 3 && modules.iter().any(|(_, stages)| matches!(stages[..], [SourceStage::Dense(..)])) => {
            let is_dense = |index: &usize| matches!(modules[*index].1[..], [SourceStage::Dense(..)]);
            let mut order: Vec<usize> = (0..modules.len()).collect();
            order.sort_by_key(is_dense);
            Ok(order)
        }
        [] => {
            let what = format!("{}, layers that do not feed each other,", names());
            Err(ImportError::refuse(what, "only layers one after the other fit; train such a network"))
        }
        [order] => Ok(order.clone()),
        [first, ..] => {
            // The names in a sequence are the places in it.
            let number = |index: &usize| modules[*index].0.rsplit(['.', '_', '/']).next().and_then(|end| end.parse::<u32>().ok());
            let stem = |index: &usize| modules[*index].0.trim_end_matches(|letter: char| letter.is_ascii_digit());
            let counted = found.iter().find(|order| {
                let numbers: Option<Vec<u32>> = order.iter().map(number).collect();
                numbers.is_some_and(|numbers| numbers.is_sorted()) && order.iter().all(|index| stem(index) == stem(&order[0]))
            });
            counted.cloned().ok_or_else(|| {
                let example = first.iter().map(|index| modules[*index].0.as_str()).collect::<Vec<_>>().join(",");
                let problem = format!("{} fit together in several ways; give their order, for example --layers {example}", names());
                ImportError::Value { name: "the order of the layers".to_owned(), problem }
            })
        }
    }
}

/// All orders of so many things.
fn permutations(count: usize) -> Vec<Vec<usize>> {
    let mut orders = vec![Vec::new()];
    for _ in 0..count {
        let longer = |order: &Vec<usize>| {
            let free: Vec<usize> = (0..count).filter(|index| !order.contains(index)).collect();
            free.into_iter().map(|index| [order.as_slice(), &[index]].concat()).collect::<Vec<_>>()
        };
        orders = orders.iter().flat_map(longer).collect();
    }
    orders
}

/// Says which activation each dense layer but the last has, where the file does not: one for all of them, or one each.
///
/// # Errors
/// When it is not known, or the number is another.
pub fn with_activations(stages: Vec<SourceStage>, said: Option<&[DenseActivation]>) -> Result<Vec<SourceStage>, ImportError> {
    let is_dense = |stage: &SourceStage| matches!(stage, SourceStage::Dense(_, None));
    let output = stages.iter().rposition(|stage| matches!(stage, SourceStage::Dense(..))).filter(|last| last + 1 == stages.len());
    let hidden: Vec<usize> = (0..stages.len()).filter(|index| is_dense(&stages[*index]) && Some(*index) != output).collect();
    let activation = |place: usize| match said {
        None => Err(ImportError::Unknown {
            what: "what follows the dense layers before the output",
            option: "--dense-activation, for example --dense-activation tanh",
        }),
        Some([all]) => Ok(*all),
        Some(each) if each.len() == hidden.len() => Ok(each[place]),
        Some(each) => {
            let problem = format!("{} given, there are {} dense layers before the output", each.len(), hidden.len());
            Err(ImportError::Value { name: "--dense-activation".to_owned(), problem })
        }
    };
    let mut known = Vec::with_capacity(stages.len());
    for (index, stage) in stages.into_iter().enumerate() {
        known.push(match (stage, hidden.iter().position(|hidden| *hidden == index)) {
            (SourceStage::Dense(layer, None), Some(place)) => SourceStage::Dense(layer, Some(activation(place)?)),
            (SourceStage::Dense(layer, None), None) => SourceStage::Dense(layer, Some(DenseActivation::Linear)),
            (stage, _) => stage,
        });
    }
    Ok(known)
}

/// Our layers and the output of a framework's: what is linear, and what a sigmoid adds to a tanh, goes into the weights behind it.
///
/// # Errors
/// What does not fit, by name.
pub fn joined(stages: Vec<SourceStage>, notes: &mut Vec<String>) -> Result<(Vec<SourceLayer>, SourceDense), ImportError> {
    for pair in stages.windows(2) {
        let [first, second] = [pair[0].layer(), pair[1].layer()];
        if second.inputs != first.units {
            let what = format!("`{}` with {} inputs after `{}` with {} units", second.name, second.inputs, first.name, first.units);
            return Err(ImportError::refuse(what, "each layer must take what the layer before gives, and nothing else"));
        }
    }
    let mut layers: Vec<SourceLayer> = Vec::new();
    // What the next layer has yet to make up for.
    let mut pending: Option<(SourceLayer, DenseActivation)> = None;
    for stage in stages {
        let (mut layer, activation) = match stage {
            SourceStage::Recurrent(layer) => (layer, None),
            SourceStage::Dense(layer, activation) => (layer, activation),
        };
        if let Some((before, activation)) = pending.take() {
            match activation {
                DenseActivation::Linear => {
                    notes.push(format!("`{}` has no activation: its weights are joined with those of `{}`", before.name, layer.name));
                    layer.absorb(&before, 1.0, 0.0, true);
                }
                DenseActivation::Sigmoid => {
                    notes.push(format!("the sigmoid of `{}` is computed as a tanh of half its sum", before.name));
                    layer.absorb(&before, 0.5, 0.5, false);
                    let halved = |values: Vec<f64>| values.into_iter().map(|value| 0.5 * value).collect();
                    let (input_weights, bias) = (halved(before.input_weights), halved(before.bias));
                    layers.push(SourceLayer { input_weights, bias, ..before });
                }
                DenseActivation::Ours(own) => layers.push(SourceLayer { cell: Cell::Dense(own), ..before }),
            }
        }
        match activation {
            None => layers.push(layer),
            Some(activation) => pending = Some((layer, activation)),
        }
    }
    match pending {
        Some((output, DenseActivation::Linear)) if output.units == 1 => {
            let bias = output.bias.iter().sum();
            Ok((layers, SourceDense { name: output.name, weights: output.input_weights, bias }))
        }
        Some((output, DenseActivation::Linear)) => Err(ImportError::refuse(
            format!("`{}`, a dense layer of {} outputs,", output.name, output.units),
            "the model has one output; train one network for each, or one with a single output",
        )),
        Some((output, _)) => Err(ImportError::refuse(
            format!("`{}`, an output with an activation,", output.name),
            "the output must be linear; train without the activation behind it",
        )),
        None => {
            let (dense, note) = without_dense(&layers)?;
            notes.push(note);
            Ok((layers, dense))
        }
    }
}

impl SourceNetwork {
    /// Whether a layer carries a state from step to step.
    #[must_use]
    pub fn has_memory(&self) -> bool {
        self.layers.iter().any(|layer| !matches!(layer.cell, Cell::Dense(_)))
    }

    /// Checks that the network fits the microcontroller.
    ///
    /// # Errors
    /// What does not fit, by name.
    pub fn check(&self) -> Result<(), ImportError> {
        let refuse = |what: String, remedy: String| Err(ImportError::refuse(what, remedy));
        if self.layers.is_empty() {
            let what = format!("`{}`, a linear map without a layer before it,", self.dense.name);
            return refuse(what, "it has neither memory nor shape; `catheter identify` fits such models".to_owned());
        }
        if self.layers.len() > MAX_LAYERS {
            let remedy = format!("at most {MAX_LAYERS} fit before the output; train with fewer layers");
            return refuse(format!("a network of {} layers", self.layers.len()), remedy);
        }
        for layer in &self.layers {
            if layer.units > MAX_UNITS {
                let remedy = format!("at most {MAX_UNITS} fit; train with fewer units");
                return refuse(format!("`{}`, a layer of {} units,", layer.name, layer.units), remedy);
            }
        }
        Ok(())
    }
}

/// The output of a network whose last layer has one unit and no dense layer after it, and a note that says so.
fn without_dense(layers: &[SourceLayer]) -> Result<(SourceDense, String), ImportError> {
    match layers.last() {
        Some(layer) if layer.units == 1 => {
            let dense = SourceDense { name: layer.name.clone(), weights: vec![1.0], bias: 0.0 };
            Ok((dense, format!("there is no dense layer: the one unit of `{}` is the output", layer.name)))
        }
        last => {
            let (name, units) = last.map_or(("", 0), |layer| (layer.name.as_str(), layer.units));
            Err(ImportError::refuse(
                format!("a network without a dense output after the {units} units of `{name}`"),
                "give it one linear layer with one output",
            ))
        }
    }
}
