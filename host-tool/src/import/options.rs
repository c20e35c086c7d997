//! What weights do not tell: channels, normalisation, period, features. It comes from the command line or from the file's metadata.
//!
//! The metadata entries are called `catheter.` and the name of the option with `_` for `-`; the Python helper writes them.

use std::collections::BTreeMap;

use model_export::schema::{MAX_DEAD_TIME_SAMPLES, MAX_FEATURES};

use super::ImportError;
pub use super::source::DenseActivation;
use crate::network::{Activation, Mode};
use crate::recording::Signal;

/// One input of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FeatureKind {
    /// The input itself.
    Input,
    /// Its change since the last sample; zero at the first.
    Difference,
    /// The input so many samples ago; before the first sample it is taken to have rested where it begins.
    Lag(u8),
}

/// What was said; nothing has a silent default but the normalisation, which is none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Options {
    /// The input's quantity and unit.
    pub input: Option<Signal>,
    /// The output's.
    pub output: Option<Signal>,
    /// Time between samples in s.
    pub sample_period_s: Option<f64>,
    /// Smallest and largest input in training.
    pub input_range: Option<[f64; 2]>,
    /// Smallest and largest output in training.
    pub output_range: Option<[f64; 2]>,
    /// The network saw `(input - offset) / scale`; 0 when absent.
    pub input_offset: Option<f64>,
    /// 1 when absent.
    pub input_scale: Option<f64>,
    /// The network gave `(output - offset) / scale`; 0 when absent.
    pub output_offset: Option<f64>,
    /// 1 when absent.
    pub output_scale: Option<f64>,
    /// The network's inputs in their order; a single one is the input when absent.
    pub features: Option<Vec<FeatureKind>>,
    /// What the difference was divided by; the input's scale when absent.
    pub difference_scale: Option<f64>,
    /// Largest change of the input from one sample to the next in training.
    pub largest_step: Option<f64>,
    /// Streaming or window.
    pub mode: Option<Mode>,
    /// The activation of the recurrent layers.
    pub activation: Option<Activation>,
    /// What follows the dense layers before the output: one for all, or one each.
    pub dense_activation: Option<Vec<DenseActivation>>,
    /// The layers in their order.
    pub layers: Option<Vec<String>>,
    /// Which framework made it.
    pub framework: Option<String>,
}

/// Reads `pressure:bar` or `pressure_bar`.
///
/// # Errors
/// When there is no quantity or no unit.
pub fn signal(text: &str) -> Result<Signal, String> {
    match text.rsplit_once(':').or_else(|| text.rsplit_once('_')) {
        Some((quantity, unit)) if !quantity.is_empty() && !unit.is_empty() => {
            Ok(Signal { quantity: quantity.to_owned(), unit: unit.to_owned() })
        }
        _ => Err(format!("`{text}` has no quantity or no unit; write for example `pressure:bar`")),
    }
}

/// Reads a finite number.
///
/// # Errors
/// For anything else.
pub fn number(text: &str) -> Result<f64, String> {
    text.trim().parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(|| format!("`{text}` is not a finite number"))
}

/// Reads a positive number.
///
/// # Errors
/// For anything else.
pub fn positive(text: &str) -> Result<f64, String> {
    number(text).ok().filter(|value| *value > 0.0).ok_or_else(|| format!("`{text}` is not a positive number"))
}

/// Reads two ascending numbers, `0,3`.
///
/// # Errors
/// For anything else.
pub fn range(text: &str) -> Result<[f64; 2], String> {
    let ends = text.split_once(',').map(|(low, high)| (number(low), number(high)));
    match ends {
        Some((Ok(low), Ok(high))) if low < high => Ok([low, high]),
        _ => Err(format!("`{text}` is not two ascending numbers such as `0,3`")),
    }
}

/// Reads a list of `input`, `difference`, `lag:N` (the input N samples ago) and `lag:N..M`, a row of them.
///
/// # Errors
/// For anything else, and for more than fit.
pub fn features(text: &str) -> Result<Vec<FeatureKind>, String> {
    let mut features = Vec::new();
    for part in text.split(',').map(str::trim) {
        match (part, part.strip_prefix("lag:")) {
            ("input", _) => features.push(FeatureKind::Input),
            ("difference", _) => features.push(FeatureKind::Difference),
            (_, Some(lags)) => features.extend(self::lags(lags)?.into_iter().map(FeatureKind::Lag)),
            _ => {
                return Err(format!(
                    "`{part}` is none of `input`, `difference`, `lag:3` and `lag:9..0`: other inputs have no place in the model"
                ));
            }
        }
    }
    if features.len() > MAX_FEATURES {
        return Err(format!("{} inputs, at most {MAX_FEATURES} fit; train with fewer", features.len()));
    }
    Ok(features)
}

/// The ages of `3`, or of `9..0` or `0..9`, both ends included.
fn lags(text: &str) -> Result<Vec<u8>, String> {
    let age = |text: &str| {
        let age = text.trim().parse().ok().filter(|age| usize::from(*age) <= MAX_DEAD_TIME_SAMPLES);
        age.ok_or_else(|| format!("`lag:{text}` is not 0 to {MAX_DEAD_TIME_SAMPLES} samples ago, which is as far as the model sees"))
    };
    let Some((first, last)) = text.split_once("..") else { return Ok(vec![age(text)?]) };
    let (first, last): (u8, u8) = (age(first)?, age(last)?);
    Ok(if first <= last { (first..=last).collect() } else { (last..=first).rev().collect() })
}

/// Reads `streaming` or the length of a window.
///
/// # Errors
/// For anything else.
pub fn mode(text: &str) -> Result<Mode, String> {
    match (text, text.parse()) {
        ("streaming", _) => Ok(Mode::Streaming),
        (_, Ok(length)) if length > 0 => Ok(Mode::Window { length }),
        _ => Err(format!("`{text}` is neither `streaming` nor a number of samples")),
    }
}

/// Reads `tanh`, `relu` or `hard`.
///
/// # Errors
/// For anything else.
pub fn activation(text: &str) -> Result<Activation, String> {
    match text {
        "tanh" => Ok(Activation::Tanh),
        "relu" => Ok(Activation::Relu),
        "hard" => Ok(Activation::Hard),
        _ => Err(format!("`{text}` is none of `tanh`, `relu` and `hard` (-1 to 1): other activations have no fixed-point form")),
    }
}

/// Reads `tanh`, `relu`, `hard`, `sigmoid` or `linear`, or several between commas.
///
/// # Errors
/// For anything else.
pub fn dense_activations(text: &str) -> Result<Vec<DenseActivation>, String> {
    let one = |name: &str| match name.trim() {
        "linear" => Ok(DenseActivation::Linear),
        "sigmoid" => Ok(DenseActivation::Sigmoid),
        name => activation(name)
            .map(DenseActivation::Ours)
            .map_err(|problem| format!("{problem}; dense layers know `sigmoid` and `linear` too")),
    };
    text.split(',').map(one).collect()
}

/// Reads names between commas.
///
/// # Errors
/// When a name is empty.
pub fn names(text: &str) -> Result<Vec<String>, String> {
    let names: Vec<String> = text.split(',').map(|name| name.trim().to_owned()).collect();
    if names.iter().any(String::is_empty) { Err(format!("`{text}` has an empty name")) } else { Ok(names) }
}

impl Options {
    /// What a file's metadata say; entries that are not ours are left alone.
    ///
    /// # Errors
    /// For an entry of ours that is unknown or makes no sense.
    pub fn from_metadata(metadata: &BTreeMap<String, String>) -> Result<Self, ImportError> {
        let mut options = Self::default();
        for (key, text) in metadata {
            if let Some(name) = key.strip_prefix("catheter.") {
                options.set(name, text).map_err(|problem| ImportError::Value { name: format!("metadata entry `{key}`"), problem })?;
            }
        }
        Ok(options)
    }

    fn set(&mut self, name: &str, text: &str) -> Result<(), String> {
        match name {
            "input" => self.input = Some(signal(text)?),
            "output" => self.output = Some(signal(text)?),
            "sample_period_s" => self.sample_period_s = Some(positive(text)?),
            "input_range" => self.input_range = Some(range(text)?),
            "output_range" => self.output_range = Some(range(text)?),
            "input_offset" => self.input_offset = Some(number(text)?),
            "input_scale" => self.input_scale = Some(positive(text)?),
            "output_offset" => self.output_offset = Some(number(text)?),
            "output_scale" => self.output_scale = Some(positive(text)?),
            "features" => self.features = Some(features(text)?),
            "difference_scale" => self.difference_scale = Some(positive(text)?),
            "largest_step" => self.largest_step = Some(positive(text)?),
            "window" => self.mode = Some(mode(text)?),
            "activation" => self.activation = Some(activation(text)?),
            "dense_activation" => self.dense_activation = Some(dense_activations(text)?),
            "layers" => self.layers = Some(names(text)?),
            "framework" => self.framework = Some(text.to_owned()),
            _ => return Err("is not known to this version of the tool; remove it, or check its spelling".to_owned()),
        }
        Ok(())
    }

    /// These options, and where they are silent those of the file; notes say where both spoke and differ.
    #[must_use]
    pub fn over(self, file: Self) -> (Self, Vec<String>) {
        let mut notes = Vec::new();
        macro_rules! merged {
            ($($field:ident),*) => {
                Self { $($field: {
                    if let (Some(ours), Some(theirs)) = (&self.$field, &file.$field) && ours != theirs {
                        notes.push(format!("`catheter.{}` of the file is replaced by the option", stringify!($field).replace("mode", "window")));
                    }
                    self.$field.or(file.$field)
                }),* }
            };
        }
        let options = merged!(
            input,
            output,
            sample_period_s,
            input_range,
            output_range,
            input_offset,
            input_scale,
            output_offset,
            output_scale,
            features,
            difference_scale,
            largest_step,
            mode,
            activation,
            dense_activation,
            layers,
            framework
        );
        (options, notes)
    }
}
