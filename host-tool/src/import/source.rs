//! A network as it was found in a foreign file, in our gate order, before anybody said what its channels are.

use model_export::schema::{MAX_LAYERS, MAX_UNITS};

use super::ImportError;
use crate::network::Activation;

/// What every refusal of a recurrent layer that is no LSTM says.
pub const LSTM_ONLY: &str = "the firmware runs LSTM layers only; train an LSTM of as many units instead";

/// One LSTM layer; matrices row-major, rows in gate order i, f, g, o.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceLayer {
    /// Its name in the file.
    pub name: String,
    /// Width of the input.
    pub inputs: usize,
    /// Hidden units.
    pub units: usize,
    /// `4 * units` rows of `inputs`.
    pub input_weights: Vec<f64>,
    /// `4 * units` rows of `units`.
    pub recurrent_weights: Vec<f64>,
    /// `4 * units`.
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
    /// The cell activation where the file tells it.
    pub activation: Option<Activation>,
    /// Whether the network gives only the last step of a sequence; none when the file does not tell.
    pub last_step_only: Option<bool>,
    /// What a reader should know of how the file was understood.
    pub notes: Vec<String>,
}

/// What a recurrent layer with this many rows of recurrent weights is, if it is no LSTM.
///
/// # Errors
/// For anything but four rows a unit.
pub fn expect_lstm(name: &str, rows: usize, units: usize) -> Result<(), ImportError> {
    let kind = match rows.checked_div(units) {
        Some(4) if rows == 4 * units => return Ok(()),
        Some(3) if rows == 3 * units => "a GRU",
        Some(1) if rows == units => "a plain recurrent layer",
        _ => {
            let problem =
                format!("{rows} rows for {units} units fit no recurrent layer: an LSTM has four rows a unit; save the network again");
            return Err(ImportError::tensor(name, problem));
        }
    };
    Err(ImportError::refuse(format!("`{name}`, {kind},"), LSTM_ONLY))
}

/// Groups of layers (modules), in the order in which the signal passes them.
///
/// `named` is the order somebody gave; without it, it must follow from the widths.
///
/// # Errors
/// When the names do not fit, or the widths leave a choice.
pub fn ordered(
    mut modules: Vec<(String, Vec<SourceLayer>)>,
    named: Option<&[String]>,
    outputs_from: Option<usize>,
) -> Result<Vec<SourceLayer>, ImportError> {
    let count: usize = modules.iter().map(|(_, layers)| layers.len()).sum();
    if count > MAX_LAYERS {
        let remedy = format!("at most {MAX_LAYERS} fit; train with fewer layers");
        return Err(ImportError::refuse(format!("a network of {count} LSTM layers"), remedy));
    }
    if let Some(named) = named {
        let found: Vec<&str> = modules.iter().map(|(name, _)| name.as_str()).collect();
        let same = named.len() == found.len() && found.iter().all(|name| named.iter().any(|other| other == name));
        if !same {
            let problem = format!("`{}` are not the LSTM layers of the file, which are `{}`", named.join(","), found.join(","));
            return Err(ImportError::Value { name: "--layers".to_owned(), problem });
        }
        modules.sort_by_key(|(name, _)| named.iter().position(|other| other == name));
    } else if modules.len() == 2 {
        let fits = |first: usize, second: usize| {
            let units = |module: usize| modules[module].1.last().map_or(0, |layer| layer.units);
            modules[second].1.first().is_some_and(|layer| layer.inputs == units(first))
                && outputs_from.is_none_or(|width| width == units(second))
        };
        match (fits(0, 1), fits(1, 0)) {
            (true, false) => {}
            (false, true) => modules.reverse(),
            (true, true) => {
                let problem = format!(
                    "`{}` and `{}` fit together either way; give their order, for example --layers {},{}",
                    modules[0].0, modules[1].0, modules[0].0, modules[1].0
                );
                return Err(ImportError::Value { name: "the order of the LSTM layers".to_owned(), problem });
            }
            (false, false) => {
                let what = format!("`{}` and `{}`, two LSTM layers that do not feed each other,", modules[0].0, modules[1].0);
                return Err(ImportError::refuse(what, "only layers one after the other fit; train such a network"));
            }
        }
    }
    Ok(modules.into_iter().flat_map(|(_, layers)| layers).collect())
}

impl SourceNetwork {
    /// Checks that the layers fit each other, the output and the microcontroller.
    ///
    /// # Errors
    /// What does not fit, by name.
    pub fn check(&self) -> Result<(), ImportError> {
        let refuse = |what: String, remedy: String| Err(ImportError::refuse(what, remedy));
        if self.layers.len() > MAX_LAYERS {
            let remedy = format!("at most {MAX_LAYERS} fit; train with fewer layers");
            return refuse(format!("a network of {} LSTM layers", self.layers.len()), remedy);
        }
        for layer in &self.layers {
            if layer.units > MAX_UNITS {
                let remedy = format!("at most {MAX_UNITS} fit; train with fewer units");
                return refuse(format!("`{}`, an LSTM layer of {} units,", layer.name, layer.units), remedy);
            }
        }
        for pair in self.layers.windows(2) {
            if pair[1].inputs != pair[0].units {
                let what =
                    format!("`{}` with {} inputs after `{}` with {} units", pair[1].name, pair[1].inputs, pair[0].name, pair[0].units);
                return refuse(what, "each layer must take what the layer before gives".to_owned());
            }
        }
        let last = self.layers.last().map_or(0, |layer| layer.units);
        if self.dense.weights.len() != last {
            let what = format!("`{}` with {} inputs after a layer of {last} units", self.dense.name, self.dense.weights.len());
            return refuse(what, "the dense output must take what the last LSTM layer gives, and nothing else".to_owned());
        }
        Ok(())
    }
}

/// The output of a network whose last layer has one unit and no dense layer after it, and a note that says so.
///
/// # Errors
/// When there are more units than one.
pub fn without_dense(layers: &[SourceLayer]) -> Result<(SourceDense, String), ImportError> {
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
