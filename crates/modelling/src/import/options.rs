//! What weights do not tell: channels, normalisation, period, features. It comes from the command line or from the file's metadata.
//!
//! The metadata entries are called `catheter.` and the name of the option with `_` for `-`; the Python helper writes them. What is said of
//! the second input has a 2 in its name: `catheter.input2`, `catheter.input2_range`, `catheter.difference2_scale`, `catheter.largest_step2`.

use std::collections::BTreeMap;

use model_export::schema::{MAX_DEAD_TIME_SAMPLES, MAX_FEATURES, MAX_MORE_INPUTS};

use super::ImportError;
pub use super::source::DenseActivation;
use crate::network::{Activation, Mode};
use recording::Signal;

/// Inputs of the plant at most.
pub const MAX_INPUTS: usize = 1 + MAX_MORE_INPUTS;

/// One input of the network: what it sees of one input of the plant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NetworkInput {
    /// Which input of the plant, from zero.
    pub channel: usize,
    /// What of it.
    pub kind: FeatureKind,
}

/// What a network sees of an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FeatureKind {
    /// The input itself.
    Input,
    /// Its change since the last sample; zero at the first.
    Difference,
    /// The input so many samples ago; before the first sample it is taken to have rested where it begins.
    Lag(u8),
}

/// What was said of one input of the plant.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InputOptions {
    /// Its quantity and unit.
    pub signal: Option<Signal>,
    /// Smallest and largest value in training.
    pub range: Option<[f64; 2]>,
    /// The network saw `(input - offset) / scale`; 0 when absent.
    pub offset: Option<f64>,
    /// 1 when absent.
    pub scale: Option<f64>,
    /// What its difference was divided by; its scale when absent.
    pub difference_scale: Option<f64>,
    /// Largest change from one sample to the next in training.
    pub largest_step: Option<f64>,
}

/// What was said; nothing has a silent default but the normalisation, which is none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Options {
    /// The plant's inputs in their order; those without a signal are not there.
    pub inputs: [InputOptions; MAX_INPUTS],
    /// The output's quantity and unit.
    pub output: Option<Signal>,
    /// Time between samples in s.
    pub sample_period_s: Option<f64>,
    /// Smallest and largest output in training.
    pub output_range: Option<[f64; 2]>,
    /// The network gave `(output - offset) / scale`; 0 when absent.
    pub output_offset: Option<f64>,
    /// 1 when absent.
    pub output_scale: Option<f64>,
    /// The network's inputs in their order; the plant's in theirs when absent and as many.
    pub features: Option<Vec<NetworkInput>>,
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

/// Reads a list of `input`, `difference`, `lag:N` (the input N samples ago) and `lag:N..M`, a row of them; `input2`, `difference2` and `lag2:N`
/// are those of the second input of the plant.
///
/// # Errors
/// For anything else, and for more than fit.
pub fn features(text: &str) -> Result<Vec<NetworkInput>, String> {
    let mut features = Vec::new();
    for part in text.split(',').map(str::trim) {
        let (name, lags) = part.split_once(':').map_or((part, None), |(name, lags)| (name, Some(lags)));
        let (word, channel) = numbered(name);
        let seen = |kind| NetworkInput { channel, kind };
        match (word.as_str(), lags) {
            ("input", None) => features.push(seen(FeatureKind::Input)),
            ("difference", None) => features.push(seen(FeatureKind::Difference)),
            ("lag", Some(lags)) => features.extend(self::lags(lags)?.into_iter().map(|age| seen(FeatureKind::Lag(age)))),
            _ => {
                return Err(format!(
                    "`{part}` is none of `input`, `difference`, `lag:3` and `lag:9..0`, or of `input2` to `input{MAX_INPUTS}` and so on: it has no place in the \
                     model"
                ));
            }
        }
    }
    if features.len() > MAX_FEATURES {
        return Err(format!("{} inputs, at most {MAX_FEATURES} fit; train with fewer", features.len()));
    }
    Ok(features)
}

/// A name without the number of its input, and that input, from zero: `input2_range` is `input_range` of the second.
fn numbered(name: &str) -> (String, usize) {
    let number = name.char_indices().find_map(|(at, found)| {
        let number = usize::try_from(found.to_digit(10)?).ok().filter(|number| (2..=MAX_INPUTS).contains(number))?;
        Some((at, number))
    });
    match number {
        Some((at, number)) => (format!("{}{}", &name[..at], &name[at + 1..]), number - 1),
        None => (name.to_owned(), 0),
    }
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
        let (word, channel) = numbered(name);
        let input = &mut self.inputs[channel];
        match word.as_str() {
            "input" => input.signal = Some(signal(text)?),
            "input_range" => input.range = Some(range(text)?),
            "input_offset" => input.offset = Some(number(text)?),
            "input_scale" => input.scale = Some(positive(text)?),
            "difference_scale" => input.difference_scale = Some(positive(text)?),
            "largest_step" => input.largest_step = Some(positive(text)?),
            _ => return self.set_of_all(name, text),
        }
        Ok(())
    }

    /// What is no single input's.
    fn set_of_all(&mut self, name: &str, text: &str) -> Result<(), String> {
        match name {
            "output" => self.output = Some(signal(text)?),
            "sample_period_s" => self.sample_period_s = Some(positive(text)?),
            "output_range" => self.output_range = Some(range(text)?),
            "output_offset" => self.output_offset = Some(number(text)?),
            "output_scale" => self.output_scale = Some(positive(text)?),
            "features" => self.features = Some(features(text)?),
            "window" => self.mode = Some(mode(text)?),
            "activation" => self.activation = Some(activation(text)?),
            "dense_activation" => self.dense_activation = Some(dense_activations(text)?),
            "layers" => self.layers = Some(names(text)?),
            "framework" => self.framework = Some(text.to_owned()),
            _ => return Err("is not known to this version of the tool; remove it, or check its spelling".to_owned()),
        }
        Ok(())
    }

    /// Inputs of the plant that have a name: the first ones.
    ///
    /// # Errors
    /// When something was said of one that has none.
    pub fn named_inputs(&self) -> Result<usize, ImportError> {
        let named = self.inputs.iter().take_while(|input| input.signal.is_some()).count();
        match self.inputs.iter().enumerate().skip(named.max(1)).find(|(_, input)| **input != InputOptions::default()) {
            Some((index, _)) => {
                let problem = format!("something is said of input {}, but there are {named}; give --input once for each", index + 1);
                Err(ImportError::Value { name: "--input".to_owned(), problem })
            }
            None => Ok(named),
        }
    }

    /// These options, and where they are silent those of the file; notes say where both spoke and differ.
    #[must_use]
    pub fn over(self, file: Self) -> (Self, Vec<String>) {
        let mut notes = Vec::new();
        let mut numbers = 1..;
        let mut pairs = self.inputs.into_iter().zip(file.inputs);
        let inputs = std::array::from_fn(|_| {
            let (ours, theirs) = pairs.next().unwrap_or_default();
            let number = numbers.next().filter(|number| *number > 1).map_or_else(String::new, |number| number.to_string());
            InputOptions {
                signal: either(ours.signal, theirs.signal, &format!("input{number}"), &mut notes),
                range: either(ours.range, theirs.range, &format!("input{number}_range"), &mut notes),
                offset: either(ours.offset, theirs.offset, &format!("input{number}_offset"), &mut notes),
                scale: either(ours.scale, theirs.scale, &format!("input{number}_scale"), &mut notes),
                difference_scale: either(ours.difference_scale, theirs.difference_scale, &format!("difference{number}_scale"), &mut notes),
                largest_step: either(ours.largest_step, theirs.largest_step, &format!("largest_step{number}"), &mut notes),
            }
        });
        let options = Self {
            inputs,
            output: either(self.output, file.output, "output", &mut notes),
            sample_period_s: either(self.sample_period_s, file.sample_period_s, "sample_period_s", &mut notes),
            output_range: either(self.output_range, file.output_range, "output_range", &mut notes),
            output_offset: either(self.output_offset, file.output_offset, "output_offset", &mut notes),
            output_scale: either(self.output_scale, file.output_scale, "output_scale", &mut notes),
            features: either(self.features, file.features, "features", &mut notes),
            mode: either(self.mode, file.mode, "window", &mut notes),
            activation: either(self.activation, file.activation, "activation", &mut notes),
            dense_activation: either(self.dense_activation, file.dense_activation, "dense_activation", &mut notes),
            layers: either(self.layers, file.layers, "layers", &mut notes),
            framework: either(self.framework, file.framework, "framework", &mut notes),
        };
        (options, notes)
    }
}

/// The option, or else what the file says; a note where both spoke and differ.
fn either<T: PartialEq>(option: Option<T>, file: Option<T>, name: &str, notes: &mut Vec<String>) -> Option<T> {
    if let (Some(ours), Some(theirs)) = (&option, &file)
        && ours != theirs
    {
        notes.push(format!("`catheter.{name}` of the file is replaced by the option"));
    }
    option.or(file)
}
