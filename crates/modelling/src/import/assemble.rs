//! From a foreign network and what was said about it to our model.
//!
//! The network's inputs become features of the front end. A feature must lie within -2 to 2 for the microcontroller, whatever the
//! network saw in training, so each gets a gain that is a power of two and brings its range to within -1 to 1; the first layer's weights
//! are divided by it, which in floating point changes nothing but exponents.

use model_export::schema::{Feature, FeatureSource, FrontEnd, MAX_FEATURES, MAX_WINDOW_VALUES};

use super::ImportError;
use super::check::CheckVectors;
use super::options::{FeatureKind, InputOptions, NetworkInput, Options};
use super::source::{SourceLayer, SourceNetwork};
use crate::network::{Activation, Channel, Layer, Mode, Network, Provenance, TrainedModel};
use recording::Signal;

/// Bound of the cell state: the largest that fixed point holds, because a foreign network was trained without one.
const STATE_LIMIT: f32 = 128.0;

#[expect(clippy::cast_possible_truncation, reason = "models are f32")]
fn narrow(value: f64) -> f32 {
    value as f32
}

/// Weights as f32; a sum or quotient may have left its range.
fn weights(name: &str, values: impl IntoIterator<Item = f64>) -> Result<Vec<f32>, ImportError> {
    let values: Vec<f32> = values.into_iter().map(narrow).collect();
    match values.iter().position(|value| !value.is_finite()) {
        Some(index) => Err(ImportError::tensor(name, format!("value {index} exceeds what f32 holds; train with weight decay"))),
        None => Ok(values),
    }
}

fn known<T: Clone>(value: &Option<T>, what: &'static str, option: &'static str) -> Result<T, ImportError> {
    value.clone().ok_or(ImportError::Unknown { what, option })
}

fn channel(signal: Signal, offset: Option<f64>, scale: Option<f64>, [minimum, maximum]: [f64; 2]) -> Channel {
    Channel {
        quantity: signal.quantity,
        unit: signal.unit,
        offset: narrow(offset.unwrap_or(0.0)),
        scale: narrow(scale.unwrap_or(1.0)),
        minimum: narrow(minimum),
        maximum: narrow(maximum),
    }
}

/// The power of two that brings `largest` to between 1/2 and 1.
fn gain(largest: f64) -> f64 {
    // Beyond the bounds the model is refused as out of its domain, whatever the gain.
    #[expect(clippy::cast_possible_truncation, reason = "a whole number within the bounds")]
    let exponent = largest.log2().ceil().clamp(-300.0, 300.0) as i32;
    2f64.powi(-exponent)
}

/// A range that was given, or that of the check vectors, with a note.
fn range_or_check(
    given: Option<[f64; 2]>,
    seen: Option<[f64; 2]>,
    what: &'static str,
    option: &'static str,
    notes: &mut Vec<String>,
) -> Result<[f64; 2], ImportError> {
    if given.is_none()
        && let Some([low, high]) = seen
    {
        notes.push(format!("{what} is taken from the check vectors: {low} to {high}; {option} says otherwise"));
    }
    given.or(seen).ok_or(ImportError::Unknown { what, option })
}

/// Makes the model; `notes` gets what was taken from where.
///
/// # Errors
/// What is not known, or does not fit.
pub fn assemble(
    source: &SourceNetwork,
    options: &Options,
    check: Option<&CheckVectors>,
    notes: &mut Vec<String>,
) -> Result<TrainedModel, ImportError> {
    source.check()?;
    let count = options.named_inputs()?;
    known(&options.inputs[0].signal, "the input's quantity and unit", "--input, for example --input pressure:bar")?;
    let features = features(source, options, count)?;
    let output = known(&options.output, "the output's quantity and unit", "--output, for example --output displacement:mm")?;
    let sample_period_s = known(&options.sample_period_s, "the sample period", "--sample-period-s")?;
    let mut inputs = Vec::with_capacity(count);
    for (index, said) in options.inputs[..count].iter().enumerate() {
        inputs.push(input(index, said, check, notes)?);
    }
    let seen = check.and_then(CheckVectors::output_range);
    let output_range = range_or_check(options.output_range, seen, "the output's range in training", "--output-range LOW,HIGH", notes)?;
    let unscaled = |input: &InputOptions| input.scale.is_none() && input.offset.is_none();
    if options.inputs.iter().all(unscaled) && options.output_scale.is_none() && options.output_offset.is_none() {
        notes.push("no scaling: the network takes and gives values in the channels' units".to_owned());
    }
    let output = channel(output, options.output_offset, options.output_scale, output_range);
    let mode = mode(source, options, features.len())?;
    let activation = source.activation.or(options.activation);
    if let (Some(found), Some(said)) = (source.activation, options.activation)
        && found != said
    {
        let problem = format!("{said:?} was given, the {} has {found:?}; leave the option out", source.kind);
        return Err(ImportError::Value { name: "--activation".to_owned(), problem });
    }
    let activation = if source.has_memory() {
        known(&activation, "the recurrent layers' activation", "--activation, for example --activation tanh, Keras' default")?
    } else {
        Activation::Tanh
    };

    let mut front_end = FrontEnd { lag_coefficient: 1.0, ..FrontEnd::default() };
    let mut factors = Vec::new();
    for seen in features {
        let (feature, factor) = feature(seen, &inputs[seen.channel], &options.inputs[seen.channel], check, notes)?;
        // No more than fit were let in.
        let _ = front_end.features.push(feature);
        if count > 1 {
            let _ = front_end.feature_inputs.push(u8::try_from(seen.channel).unwrap_or(u8::MAX));
        }
        factors.push(factor);
    }
    front_end.more_input_weights.extend((1..count).map(|_| 0.0));
    let more_inputs = inputs.split_off(1);
    let input = inputs.remove(0);
    let mut layers = Vec::with_capacity(source.layers.len());
    for (index, layer) in source.layers.iter().enumerate() {
        layers.push(converted(layer, (index == 0).then_some(&factors[..]))?);
    }
    let dense_weights = weights(&source.dense.name, source.dense.weights.iter().copied())?;
    let dense_bias = weights(&source.dense.name, [source.dense.bias])?[0];
    let network = Network { activation, state_limit: STATE_LIMIT, layers, dense_weights, dense_bias };
    let framework = options.framework.as_deref().unwrap_or(source.kind);
    let model = TrainedModel {
        input,
        more_inputs,
        output,
        sample_period_s,
        mode,
        front_end,
        network: Some(network),
        provenance: Provenance {
            preset: format!("imported: {framework}"),
            tool_version: env!("CARGO_PKG_VERSION").to_owned(),
            ..Provenance::default()
        },
    };
    let invalid = |invalid: model_export::validate::Invalid| ImportError::Value {
        name: "the model".to_owned(),
        problem: format!("{invalid}; check the ranges and scales"),
    };
    model.output.as_wire().validate().map_err(invalid)?;
    model.runner().map_err(invalid)?;
    Ok(model)
}

/// An input of the plant.
fn input(index: usize, said: &InputOptions, check: Option<&CheckVectors>, notes: &mut Vec<String>) -> Result<Channel, ImportError> {
    let signal = known(&said.signal, "the input's quantity and unit", "--input")?;
    let seen = check.and_then(|check| check.input_range(index));
    let what =
        ["the input's range in training", "the range of the second input", "the range of the third input", "the range of the last input"];
    let range = range_or_check(said.range, seen, what[index.min(what.len() - 1)], "--input-range LOW,HIGH", notes)?;
    Ok(channel(signal, said.offset, said.scale, range))
}

/// What the network's inputs are; the plant has `count` of its own.
fn features(source: &SourceNetwork, options: &Options, count: usize) -> Result<Vec<NetworkInput>, ImportError> {
    let first: Option<&SourceLayer> = source.layers.first();
    let inputs = first.map_or(0, |layer| layer.inputs);
    let name = first.map_or("", |layer| layer.name.as_str());
    match (&options.features, inputs) {
        (Some(features), _) if features.len() == inputs => all_used(features, count),
        // The network's inputs are the plant's, in the order in which these were said.
        (None, _) if inputs == count => Ok((0..count).map(|channel| NetworkInput { channel, kind: FeatureKind::Input }).collect()),
        _ if inputs > MAX_FEATURES => {
            let remedy = format!("at most {MAX_FEATURES} fit; train with fewer");
            Err(ImportError::refuse(format!("`{name}` with {inputs} inputs"), remedy))
        }
        (None, _) => Err(ImportError::Unknown {
            what: "what the inputs of the network are",
            option: "--features, for example --features input,difference or, for the last ten samples, the oldest first, lag:9..0",
        }),
        (Some(features), _) => {
            let problem = format!("{} given, `{name}` takes {inputs}", features.len());
            Err(ImportError::Value { name: "--features".to_owned(), problem })
        }
    }
}

/// Every input of the plant that a feature names is there, and every one that is there has a feature.
fn all_used(features: &[NetworkInput], count: usize) -> Result<Vec<NetworkInput>, ImportError> {
    let refuse = |problem: String| Err(ImportError::Value { name: "--features".to_owned(), problem });
    if let Some(seen) = features.iter().find(|seen| seen.channel >= count) {
        return refuse(format!("names input {}, but there are {count}; give --input once for each", seen.channel + 1));
    }
    match (0..count).find(|channel| features.iter().all(|seen| seen.channel != *channel)) {
        Some(unused) => refuse(format!("the network sees nothing of input {}; leave out its --input", unused + 1)),
        None => Ok(features.to_vec()),
    }
}

fn mode(source: &SourceNetwork, options: &Options, features: usize) -> Result<Mode, ImportError> {
    if !source.has_memory() {
        return match options.mode {
            Some(Mode::Window { length }) => {
                let last = length.saturating_sub(1);
                let problem = format!("dense layers carry no state through a window; give its samples as inputs, --features lag:{last}..0");
                Err(ImportError::Value { name: "--window".to_owned(), problem })
            }
            _ => Ok(Mode::Streaming),
        };
    }
    let mode = match (options.mode, source.last_step_only) {
        (Some(mode), _) => mode,
        // State is carried where every step is an output.
        (None, Some(false)) => Mode::Streaming,
        (None, _) => {
            let what = "whether the network runs over windows";
            return Err(ImportError::Unknown { what, option: "--streaming, or --window SAMPLES if each output comes from a window" });
        }
    };
    if let Mode::Window { length } = mode
        && length.saturating_mul(features) > MAX_WINDOW_VALUES
    {
        let remedy = format!("at most {} samples fit; train with fewer", MAX_WINDOW_VALUES / features.max(1));
        return Err(ImportError::refuse(format!("a window of {length} samples"), remedy));
    }
    Ok(mode)
}

/// A feature, and what its column of the first layer's weights is multiplied by.
fn feature(
    seen: NetworkInput,
    input: &Channel,
    options: &InputOptions,
    check: Option<&CheckVectors>,
    notes: &mut Vec<String>,
) -> Result<(Feature, f64), ImportError> {
    let scale = f64::from(input.scale);
    let (source, largest, ratio) = match seen.kind {
        FeatureKind::Input | FeatureKind::Lag(_) => {
            let normalised = |value: f32| ((f64::from(value) - f64::from(input.offset)) / scale).abs();
            let source = if let FeatureKind::Lag(age) = seen.kind { FeatureSource::Past(age) } else { FeatureSource::Input };
            (source, normalised(input.minimum).max(normalised(input.maximum)), 1.0)
        }
        FeatureKind::Difference => {
            let shown = check.and_then(|check| check.largest_step(seen.channel));
            let (what, option) = ("the largest step of the input between samples", "--largest-step");
            if let (None, Some(step)) = (options.largest_step, shown) {
                notes.push(format!("{what} is taken from the check vectors: {step}; {option} says otherwise"));
            }
            let step = known(&options.largest_step.or(shown), what, option)?;
            // The front end gives the difference of the normalised input; the network may have seen it divided by something else.
            (FeatureSource::InputDifference, step / scale, options.difference_scale.map_or(1.0, |divisor| scale / divisor))
        }
    };
    let gain = gain(largest);
    Ok((Feature { source, offset: 0.0, gain: narrow(gain) }, ratio / gain))
}

/// A layer in f32; `factors` scale the columns of its input.
fn converted(layer: &SourceLayer, factors: Option<&[f64]>) -> Result<Layer, ImportError> {
    let columns = layer.inputs;
    let factor = |index: usize| factors.map_or(1.0, |factors| factors[index % columns]);
    let input_weights = layer.input_weights.iter().enumerate().map(|(index, weight)| weight * factor(index));
    Ok(Layer {
        cell: layer.cell,
        inputs: layer.inputs,
        units: layer.units,
        input_weights: weights(&layer.name, input_weights)?,
        recurrent_weights: weights(&layer.name, layer.recurrent_weights.iter().copied())?,
        bias: weights(&layer.name, layer.bias.iter().copied())?,
    })
}
